//! The table `[slurm]`.

use std::fmt;

use serde::de::{self, Deserializer, Visitor};
use serde::{Deserialize, Serialize};

/// What a job asks of the cluster: the table `[slurm]` of an experiment, a sweep or a curation. Whatever is empty is
/// left to the cluster's own default, and so are counts of 0.
///
/// ```toml
/// [slurm]
/// partition = "cpu"
/// account = "rigging"
/// time = "4:00:00"
/// memory = "16G"
/// cpus = 8
/// options = ["--exclude=node[07-08]"]
/// prologue = ["module load gcc/13"]
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SlurmConfig {
    /// Partition, or several with commas between.
    pub partition: String,
    /// Account that is charged.
    pub account: String,
    /// Quality of service.
    pub qos: String,
    /// Features that nodes must have, as `--constraint` takes them.
    pub constraint: String,
    /// Time limit of a task as Slurm writes it: minutes, `minutes:seconds`, `hours:minutes:seconds`, `days-hours` or
    /// `days-hours:minutes[:seconds]`. What is not done by then goes on in the next round. 0 and `UNLIMITED` ask for no
    /// limit.
    #[serde(deserialize_with = "text_or_number")]
    pub time: String,
    /// Memory of a node: a number with K, M, G or T; without a letter megabytes.
    #[serde(deserialize_with = "text_or_number")]
    pub memory: String,
    /// Processors of a process.
    pub cpus: usize,
    /// Nodes of a task.
    pub nodes: usize,
    /// Processes of a training. With more than one it is started by `srun`.
    pub processes: usize,
    /// How `srun` starts several processes (`--mpi`): `pmix`, `pmi2`.
    pub mpi: String,
    /// Tasks of an array that run at a time.
    pub at_a_time: usize,
    /// Seconds before the time limit at which a task is told to save and leave, 1 to 65535. Slurm may tell it a minute
    /// earlier. It must cover the longest of a step, a validation and the writing of a checkpoint.
    pub signal_seconds: u64,
    /// Starts of a task at the same place, without a step between, after which it is given up. At least 1.
    pub patience: usize,
    /// Seconds between looks at the queue with `--wait`. At least 1.
    pub look_seconds: u64,
    /// Further options of `sbatch`, one each, but for those that a key above is for: `--gres=gpu:1`, `--exclusive`.
    pub options: Vec<String>,
    /// Lines of bash that each task runs before anything else: modules, environment.
    pub prologue: Vec<String>,
}

impl Default for SlurmConfig {
    fn default() -> Self {
        let word = String::new;
        Self {
            partition: word(),
            account: word(),
            qos: word(),
            constraint: word(),
            time: word(),
            memory: word(),
            cpus: 0,
            nodes: 0,
            processes: 1,
            mpi: word(),
            at_a_time: 0,
            signal_seconds: 120,
            patience: 3,
            look_seconds: 10,
            options: Vec::new(),
            prologue: Vec::new(),
        }
    }
}

/// Seconds by which Slurm may give a signal too early.
const EARLIER: u64 = 60;

/// Options of `sbatch` that the table has a key for or job scripts have already, with what to say instead.
const TAKEN: [(&str, &str); 31] = [
    ("--partition", "use `partition`"),
    ("-p", "use `partition`"),
    ("--account", "use `account`"),
    ("-A", "use `account`"),
    ("--qos", "use `qos`"),
    ("-q", "use `qos`"),
    ("--constraint", "use `constraint`"),
    ("-C", "use `constraint`"),
    ("--time", "use `time`"),
    ("-t", "use `time`"),
    ("--mem", "use `memory`"),
    ("--cpus-per-task", "use `cpus`"),
    ("-c", "use `cpus`"),
    ("--nodes", "use `nodes`"),
    ("-N", "use `nodes`"),
    ("--job-name", "jobs are called by what they do"),
    ("-J", "jobs are called by what they do"),
    ("--array", "it is listed from what is to be done; `at_a_time` limits it"),
    ("-a", "it is listed from what is to be done; `at_a_time` limits it"),
    ("--output", "logs lie in the folder of the work, slurm/logs"),
    ("-o", "logs lie in the folder of the work, slurm/logs"),
    ("--open-mode", "logs of a task that was requeued go on"),
    ("--signal", "use `signal_seconds`"),
    ("--requeue", "it is always given"),
    ("--no-requeue", "tasks go on by being requeued"),
    ("--chdir", "tasks begin where you are"),
    ("-D", "tasks begin where you are"),
    ("--dependency", "tasks depend on one another as the work needs it"),
    ("-d", "tasks depend on one another as the work needs it"),
    ("--ntasks", "use `processes`"),
    ("-n", "use `processes`"),
];

impl SlurmConfig {
    /// Checks values.
    ///
    /// # Errors
    /// The key below `slurm` that is wrong, with a sentence.
    pub fn validate(&self) -> Result<(), (String, String)> {
        self.validate_after(&Self { options: Vec::new(), ..self.clone() })
    }

    /// As [`Self::validate`], of what jobs were submitted with, `kept`, and what was changed of it: an earlier version took
    /// more options, and they go on by these, but for those that would take the place of a change.
    ///
    /// # Errors
    /// As [`Self::validate`].
    pub fn validate_after(&self, kept: &Self) -> Result<(), (String, String)> {
        self.validate_values()?;
        let refused = |message| Err::<Vec<String>, _>(("slurm.options".into(), message));
        for option in &self.options {
            let is_kept = kept.options.contains(option);
            let words = match is_kept {
                true => shell_words::split(option).unwrap_or_default(),
                false => words_of(option).or_else(refused)?,
            };
            for name in words.iter().filter(|word| word.starts_with('-')).map(|word| name_of(word)) {
                match self.instead(name) {
                    Some(why) if !is_kept => return refused(format!("`{name}` is not for this list: {why}")).map(drop),
                    Some(why) if self.differs(kept, why) => {
                        let hides = "which an earlier version took, would count in the place of the change";
                        let remedy = "give the list without it, too, such as --set slurm.options='[]'";
                        return refused(format!("`{name}`, {hides}: {why}, and {remedy}")).map(drop);
                    }
                    _ => {}
                }
            }
        }
        Ok(())
    }

    /// What to say instead of an option of this name, where it is not for the list.
    fn instead(&self, name: &str) -> Option<&'static str> {
        // Slurm takes one of the two, by its own rules.
        if name.starts_with("--mem-per-") && !self.memory.is_empty() {
            return Some("use `memory` or this, not both");
        }
        // Slurm takes a long name by its beginning, too.
        let is = |taken: &str| taken == name || (name.len() > 2 && taken.starts_with(name));
        TAKEN.iter().find(|(taken, _)| is(taken)).map(|(_, why)| *why)
    }

    /// Whether the key that is to be used instead of an option has another value than before.
    fn differs(&self, kept: &Self, why: &str) -> bool {
        let key = why.strip_prefix("use `").and_then(|rest| rest.split('`').next()).unwrap_or_default();
        let value = |of: &Self| serde_json::to_value(of).ok().and_then(|all| all.get(key).cloned());
        value(self) != value(kept)
    }

    /// Whether it says how much memory jobs ask for.
    pub fn asks_for_memory(&self) -> bool {
        let asks = |name: &str| name == "--mem" || name.starts_with("--mem-per-");
        !self.memory.is_empty() || self.options.iter().any(|option| asks(name_of(option)))
    }

    /// Checks all but what options are for.
    fn validate_values(&self) -> Result<(), (String, String)> {
        let fault = |key: &str, message: String| Err((format!("slurm.{key}"), message));
        let words = [
            ("partition", &self.partition),
            ("account", &self.account),
            ("qos", &self.qos),
            ("constraint", &self.constraint),
            ("mpi", &self.mpi),
        ];
        if let Some((key, word)) =
            words.into_iter().find(|(_, w)| w.contains(|c: char| c.is_whitespace() || c.is_control()))
        {
            return fault(key, format!("{word:?} should be one word"));
        }
        if !self.time.is_empty() && !is_unlimited(&self.time) && seconds(&self.time).is_none() {
            let forms = "give minutes, `minutes:seconds`, `hours:minutes:seconds`, `days-hours` or \
                         `days-hours:minutes:seconds`, such as \"90\", \"4:00:00\" or \"2-12\", or \"UNLIMITED\"";
            return fault("time", format!("`{}` is no time as Slurm takes it; {forms}", self.time));
        }
        // Without a limit nothing is told to leave before it.
        if let Some(limit) = seconds(&self.time).filter(|s| *s > 0)
            && limit <= self.signal_seconds + EARLIER
        {
            let lead = self.signal_seconds;
            let message = format!("{limit} seconds are no more than `signal_seconds` ({lead}) and the minute by which");
            return fault("time", message + " Slurm may be early; a task would be told to leave before it begins");
        }
        if !self.memory.is_empty() && !is_memory(&self.memory) {
            let message = format!("`{}` is no amount of memory; give a whole number with K, M, G or T", self.memory);
            return fault("memory", message + ", such as \"16G\"");
        }
        if self.processes == 0 {
            return fault("processes", "a training has at least 1".into());
        }
        if !(1..=65535).contains(&self.signal_seconds) {
            return fault("signal_seconds", format!("{} is not within 1 to 65535", self.signal_seconds));
        }
        if self.patience == 0 {
            return fault("patience", "a task must be begun at least once".into());
        }
        if self.look_seconds == 0 {
            return fault("look_seconds", "a look takes the controller's time; give at least 1".into());
        }
        for option in &self.options {
            let name = name_of(option);
            if !name.starts_with('-') || option.contains(['\n', '\r']) {
                return fault("options", format!("{option:?} is no option of sbatch; write it as \"--name=value\""));
            }
        }
        Ok(())
    }
}

/// The words of an option as Slurm reads a line of a script, where quotes and backslashes work as in a shell.
///
/// # Errors
/// A sentence, where they are none or more than one option: the second would not be looked at.
fn words_of(option: &str) -> Result<Vec<String>, String> {
    let words = shell_words::split(option).map_err(|_| format!("{option:?} has a quote that is not closed"))?;
    // A value may be a word of its own.
    let most = if words.first().is_some_and(|word| word.starts_with("--") && word.contains('=')) { 1 } else { 2 };
    match words.len() > most || words.iter().skip(1).any(|word| word.starts_with('-')) {
        true => Err(format!(
            "{option:?} is more than one option; write each as a text of its own, and a value of several words in quotes, \
             such as '--comment=\"two words\"'"
        )),
        false => Ok(words),
    }
}

/// The name of an option as it is written: of a short one, whose value may follow at once, a letter.
fn name_of(option: &str) -> &str {
    let name = option.split(['=', ' ']).next().unwrap_or_default();
    match name.char_indices().nth(2) {
        Some((end, _)) if !name.starts_with("--") => &name[..end],
        _ => name,
    }
}

/// A text, or a whole number as Slurm takes it without a unit.
fn text_or_number<'de, D: Deserializer<'de>>(deserializer: D) -> Result<String, D::Error> {
    struct Either;
    impl Visitor<'_> for Either {
        type Value = String;

        fn expecting(&self, f: &mut fmt::Formatter) -> fmt::Result {
            f.write_str("a string or a whole number")
        }

        fn visit_str<E: de::Error>(self, text: &str) -> Result<String, E> {
            Ok(text.to_owned())
        }

        fn visit_u64<E: de::Error>(self, number: u64) -> Result<String, E> {
            Ok(number.to_string())
        }

        fn visit_i64<E: de::Error>(self, number: i64) -> Result<String, E> {
            Ok(number.to_string())
        }
    }
    deserializer.deserialize_any(Either)
}

/// Whether a time limit is a word for none, of which Slurm takes capitals and small letters.
fn is_unlimited(text: &str) -> bool {
    ["unlimited", "infinite"].iter().any(|word| text.eq_ignore_ascii_case(word))
}

/// Seconds of a time limit, 0 for none; `None` where Slurm would not take it, or it is a word.
fn seconds(text: &str) -> Option<u64> {
    let number = |t: &str| if t.bytes().all(|b| b.is_ascii_digit()) { t.parse::<u64>().ok() } else { None };
    let parts = |t: &str| t.split(':').map(number).collect::<Option<Vec<u64>>>();
    let total = match text.split_once('-') {
        Some((days, rest)) => {
            let [h, m, s] = match parts(rest)?.as_slice() {
                [h] => [*h, 0, 0],
                [h, m] => [*h, *m, 0],
                [h, m, s] => [*h, *m, *s],
                _ => return None,
            };
            [(number(days)?, 86_400), (h, 3600), (m, 60), (s, 1)]
        }
        None => {
            let [h, m, s] = match parts(text)?.as_slice() {
                [m] => [0, *m, 0],
                [m, s] => [0, *m, *s],
                [h, m, s] => [*h, *m, *s],
                _ => return None,
            };
            [(0, 86_400), (h, 3600), (m, 60), (s, 1)]
        }
    };
    total.into_iter().try_fold(0u64, |sum, (n, unit)| sum.checked_add(n.checked_mul(unit)?))
}

fn is_memory(text: &str) -> bool {
    let digits = text.strip_suffix(|c: char| "KMGTkmgt".contains(c)).unwrap_or(text);
    digits.bytes().all(|b| b.is_ascii_digit()) && digits.parse::<u64>().is_ok_and(|n| n > 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<SlurmConfig, String> {
        let config = riglab_config::Config::from_toml_str("c.toml", text).map_err(|e| e.to_string())?;
        let slurm: SlurmConfig = config.get_at("slurm").map_err(|e| e.to_string())?;
        slurm.validate().map_err(|(key, message)| format!("{key}: {message}"))?;
        Ok(slurm)
    }

    #[test]
    fn nothing_said_asks_for_nothing() {
        let plain = read("[slurm]\n").unwrap();
        assert_eq!(plain, SlurmConfig::default());
        assert!(plain.partition.is_empty() && plain.time.is_empty() && plain.cpus == 0 && plain.options.is_empty());
    }

    #[test]
    fn times_are_slurms() {
        for (text, want) in
            [("90", 5400), ("1:30", 90), ("4:00:00", 14_400), ("2-12", 216_000), ("1-0:30", 88_200), ("0-0:0:5", 5)]
        {
            assert_eq!(seconds(text), Some(want), "{text}");
        }
        for text in ["", "2h", "1:2:3:4", "-1", "1-", "+5", "1-2-3", "99999999999999999999", "18446744073709551615"] {
            assert_eq!(seconds(text), None, "{text}");
        }
    }

    #[test]
    fn faults_are_sentences() {
        let fault = |line: &str| read(&format!("[slurm]\n{line}\n")).unwrap_err();
        assert!(fault("time = '2h'").starts_with("slurm.time: `2h` is no time as Slurm takes it; give minutes"));
        for none in ["'0'", "0", "'0:00'", "'UNLIMITED'", "'unlimited'", "'INFINITE'"] {
            assert!(read(&format!("[slurm]\ntime = {none}\n")).is_ok(), "{none} asks for no limit");
        }
        assert!(fault("time = '2'").contains("120 seconds are no more than `signal_seconds` (120)"));
        assert!(fault("time = 3").contains("180 seconds are no more"));
        assert!(read("[slurm]\ntime = 2\nsignal_seconds = 50\n").is_ok());
        assert!(fault("memory = '1.5G'").contains("whole number"));
        assert!(fault("memory = 'G'").contains("whole number") && fault("memory = '0'").contains("whole number"));
        assert!(fault("partition = 'a b'").contains("one word"));
        assert!(fault("options = ['gres=gpu:1']").contains("no option of sbatch"));
        for array in ["--array=1-3", "-a 1-3", "-a0-99", "--arr=1-3"] {
            assert!(fault(&format!("options = ['{array}']")).contains("`at_a_time` limits it"), "{array}");
        }
        assert!(fault("options = ['-n4']").contains("`-n` is not for this list: use `processes`"));
        // What has a key goes by it, and is checked there.
        let by_keys = [
            ("partition", "-pcpu --partition=cpu"),
            ("account", "-Arig --account=rig"),
            ("qos", "-qlong --qos=long"),
            ("constraint", "-Cavx --constraint=avx"),
            ("time", "-t2 --time=2 --ti=2"),
            ("memory", "--mem=4G"),
            ("cpus", "-c1 --cpus-per-task=1 --cpus=1"),
            ("nodes", "-N2 --nodes=2"),
        ];
        for (key, options) in by_keys {
            for option in options.split(' ') {
                let said = fault(&format!("options = ['{option}']"));
                assert!(said.contains(&format!("is not for this list: use `{key}`")), "{option}: {said}");
            }
        }
        assert!(fault("options = ['-J x']").contains("jobs are called by what they do"));
        // Behind a first option Slurm would take a second.
        for several in ["--exclusive --time=2", "--gres=gpu:1 -p x", "-w n1 -t2", "--comment=two words", "-w n1 n2"] {
            let said = fault(&format!("options = ['{several}']"));
            assert!(said.contains(&format!("{several:?} is more than one option; write each")), "{said}");
        }
        assert!(fault("options = ['--comment=\"two']").contains("a quote that is not closed"));
        assert!(fault("options = ['--\"ti\"me=2']").contains("`--time` is not for this list"));
        let said = fault("memory = '4G'\noptions = ['--mem-per-cpu=2G']");
        assert!(said.contains("`--mem-per-cpu` is not for this list: use `memory` or this, not both"), "{said}");
        let quoted = "'--comment=\"two words\"', '--comment \"two -p words\"', '-w n1', '--mem-per-cpu=2G'";
        assert!(read(&format!("[slurm]\noptions = [{quoted}]\n")).unwrap().asks_for_memory());
        let others =
            "'--ntasks-per-node=2', '-w n1', '-wn1', '--no-kill', '--time-min=60', '--nodelist=n1', '--mem-bind=local'";
        assert!(read(&format!("[slurm]\noptions = [{others}]\n")).is_ok());
        assert!(fault("processes = 0").contains("at least 1") && fault("patience = 0").contains("at least once"));
        assert!(fault("partitoin = 'a'").contains("did you mean `partition`?"));
        assert!(fault("time = -3").contains("`-3` is no time") && fault("memory = 1.5").contains("memory"));
        assert_eq!(read("[slurm]\ntime = 90\nmemory = 4000\n").unwrap().time, "90");
        assert!(read("[slurm]\ntime = '4:00:00'\nmemory = '16G'\noptions = ['--gres=gpu:1']\n").is_ok());
    }

    #[test]
    fn options_of_an_earlier_version_stay_until_they_would_hide_a_change() {
        let of = |options: &[&str]| SlurmConfig {
            options: options.iter().map(|option| (*option).to_owned()).collect(),
            ..SlurmConfig::default()
        };
        let kept = of(&["-pcpu", "--exclusive --nice"]);
        assert_eq!(kept.validate_after(&kept), Ok(()));
        assert_eq!(SlurmConfig { time: "4:00:00".into(), ..kept.clone() }.validate_after(&kept), Ok(()));
        assert!(
            SlurmConfig { time: "4:00:00".into(), ..of(&["--nice -t2"]) }.validate_after(&of(&["--nice -t2"])).is_err()
        );
        let said = SlurmConfig { partition: "gpu".into(), ..kept.clone() }.validate_after(&kept).unwrap_err();
        let wanted =
            "`-p`, which an earlier version took, would count in the place of the change: use `partition`, and";
        assert!(said.0 == "slurm.options" && said.1.starts_with(wanted), "{said:?}");
        // What is added is looked at, beside them too.
        let said = of(&["-pcpu", "-t2"]).validate_after(&kept).unwrap_err();
        assert_eq!(said.1, "`-t` is not for this list: use `time`");
        assert!(SlurmConfig { time: "soon".into(), ..kept.clone() }.validate_after(&kept).is_err());
    }
}
