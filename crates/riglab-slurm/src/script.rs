//! What `sbatch` is given.

use std::fmt::Write;
use std::path::Path;

use crate::{SlurmConfig, SlurmError};

/// A job script: options for `sbatch`, the prologue, one command.
#[derive(Clone, Debug)]
pub struct Script<'a> {
    /// Its name in the queue.
    pub name: &'a str,
    /// What it asks for.
    pub config: &'a SlurmConfig,
    /// Where it begins.
    pub folder: &'a Path,
    /// Where its messages go, a folder: `<job>_<task>.log`, or `<job>.log` without an array.
    pub logs: &'a Path,
    /// Numbers of the array's tasks, in order; none is a job without an array.
    pub tasks: &'a [usize],
    /// The job that must have ended well before.
    pub after: Option<&'a str>,
    /// Whether several processes may be started in it.
    pub parallel: bool,
    /// The program with its arguments.
    pub command: &'a [&'a str],
}

impl Script<'_> {
    /// The script's text.
    ///
    /// # Errors
    /// When a path cannot stand in one.
    pub fn text(&self) -> Result<String, SlurmError> {
        let c = self.config;
        let mut text = String::from("#!/bin/bash\n");
        let mut option = |name: &str, value: &str| {
            if !value.is_empty() {
                let _ = writeln!(text, "#SBATCH --{name}={}", quoted(value));
            }
        };
        let count = |n: usize| if n == 0 { String::new() } else { n.to_string() };
        option("job-name", self.name);
        option("chdir", path(self.folder)?);
        let log = if self.tasks.is_empty() { "%j.log" } else { "%A_%a.log" };
        // In names of logs a sign of per cent begins a pattern.
        option("output", &format!("{}/{log}", path(self.logs)?.replace('%', "%%")));
        option("open-mode", "append");
        option("partition", &c.partition);
        option("account", &c.account);
        option("qos", &c.qos);
        option("constraint", &c.constraint);
        option("time", &c.time);
        option("mem", &c.memory);
        option("nodes", &count(c.nodes));
        if self.parallel && c.processes > 1 {
            option("ntasks", &c.processes.to_string());
        }
        option("cpus-per-task", &count(c.cpus));
        option("signal", &format!("B:TERM@{}", c.signal_seconds));
        if !self.tasks.is_empty() {
            let limit = if c.at_a_time == 0 { String::new() } else { format!("%{}", c.at_a_time) };
            option("array", &(ranges(self.tasks) + &limit));
        }
        if let Some(job) = self.after {
            option("dependency", &format!("afterok:{job}"));
            // What can never begin does not wait for ever.
            option("kill-on-invalid-dep", "yes");
        }
        text += "#SBATCH --requeue\n";
        c.options.iter().for_each(|o| text += &format!("#SBATCH {o}\n"));
        if !c.prologue.is_empty() {
            text += "set -e\n";
            c.prologue.iter().for_each(|line| text += &format!("{line}\n"));
        }
        // In the place of the shell, so that the signal of `B:` comes to the program.
        let words: Vec<String> = self.command.iter().map(|w| shell_word(w)).collect();
        text += &format!("exec {}\n", words.join(" "));
        Ok(text)
    }
}

fn path(path: &Path) -> Result<&str, SlurmError> {
    let plain = path.to_str().filter(|p| !p.contains(['\n', '\r']));
    plain.ok_or_else(|| SlurmError::Unnamable(path.into()))
}

/// A value behind `#SBATCH`, where quotes and backslashes work as in a shell and `#` begins a comment.
fn quoted(value: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:@%+=[]&|*".contains(c);
    match value.chars().all(plain) {
        true => value.to_owned(),
        false => format!("\"{}\"", value.replace('\\', "\\\\").replace('"', "\\\"")),
    }
}

/// A word as bash takes it.
fn shell_word(word: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,:@%+=".contains(c);
    match !word.is_empty() && word.chars().all(plain) {
        true => word.to_owned(),
        false => format!("'{}'", word.replace('\'', "'\\''")),
    }
}

/// `0-3,7,9-10`, of numbers in order.
fn ranges(numbers: &[usize]) -> String {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    for &n in numbers {
        match runs.last_mut() {
            Some((_, last)) if *last + 1 == n => *last = n,
            _ => runs.push((n, n)),
        }
    }
    let shown = |(a, b): &(usize, usize)| if a == b { a.to_string() } else { format!("{a}-{b}") };
    runs.iter().map(shown).collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scripts_text() {
        let config = SlurmConfig {
            partition: "cpu".into(),
            account: "rigging".into(),
            time: "4:00:00".into(),
            memory: "16G".into(),
            cpus: 8,
            at_a_time: 12,
            options: vec!["--exclude=node[07-08]".into()],
            prologue: vec!["module load gcc/13".into()],
            ..SlurmConfig::default()
        };
        let script = Script {
            name: "table5_dice",
            config: &config,
            folder: Path::new("/home/kim/rigs"),
            logs: Path::new("/home/kim/my rigs/50%/slurm/logs"),
            tasks: &[0, 1, 2, 5, 7, 8],
            after: None,
            parallel: true,
            command: &["/opt/riglab", "slurm-task", "sweep", "/home/kim/it's here"],
        };
        let want = "\
#!/bin/bash
#SBATCH --job-name=table5_dice
#SBATCH --chdir=/home/kim/rigs
#SBATCH --output=\"/home/kim/my rigs/50%%/slurm/logs/%A_%a.log\"
#SBATCH --open-mode=append
#SBATCH --partition=cpu
#SBATCH --account=rigging
#SBATCH --time=4:00:00
#SBATCH --mem=16G
#SBATCH --cpus-per-task=8
#SBATCH --signal=B:TERM@120
#SBATCH --array=0-2,5,7-8%12
#SBATCH --requeue
#SBATCH --exclude=node[07-08]
set -e
module load gcc/13
exec /opt/riglab slurm-task sweep '/home/kim/it'\\''s here'
";
        assert_eq!(script.text().unwrap(), want);
    }

    #[test]
    fn what_is_not_said_is_left_to_the_cluster() {
        let script = Script {
            name: "merge",
            config: &SlurmConfig { processes: 4, mpi: "pmix".into(), ..SlurmConfig::default() },
            folder: Path::new("/w"),
            logs: Path::new("/w/logs"),
            tasks: &[],
            after: Some("17"),
            parallel: false,
            command: &["/opt/riglab", "slurm-task", "merge", "out.h5"],
        };
        let want = "\
#!/bin/bash
#SBATCH --job-name=merge
#SBATCH --chdir=/w
#SBATCH --output=/w/logs/%j.log
#SBATCH --open-mode=append
#SBATCH --signal=B:TERM@120
#SBATCH --dependency=afterok:17
#SBATCH --kill-on-invalid-dep=yes
#SBATCH --requeue
exec /opt/riglab slurm-task merge out.h5
";
        assert_eq!(script.text().unwrap(), want);
        assert!(Script { parallel: true, ..script.clone() }.text().unwrap().contains("#SBATCH --ntasks=4\n"));
        let said = Script { folder: Path::new("/a\nb"), ..script }.text().unwrap_err().to_string();
        assert!(said.contains("cannot stand in a job script"), "{said}");
    }
}
