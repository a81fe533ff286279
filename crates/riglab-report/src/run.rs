//! A run folder as a page.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use riglab_config::Config;
use serde_json::Value;
use thiserror::Error;

use crate::glossary::glossary;
use crate::shell::command;
use crate::unit::{TIMES_100, in_unit};
use crate::{Block, Chart, Series, shell};

/// Why a folder cannot be read as a run.
#[derive(Debug, Error)]
pub enum RunError {
    /// There is no config: no run begins without one.
    #[error("{0}: no run here (there is no config.toml); `riglab train` makes one")]
    NoRun(PathBuf),
    /// The run ended before it began to train, or was copied in part.
    #[error(
        "{0}: half-written run: there is config.toml but no run.json, so it ended before its first step or was copied in \
         part; copy it whole, or repeat it with `{again}`",
        again = command(["train", &.0.join("config.toml").to_string_lossy()])
    )]
    NoInfo(PathBuf),
    /// A file that is no JSON, such as one that was cut off.
    #[error("{path}: half-written run: {message}; copy the file again, or repeat the run")]
    Broken {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
    },
    /// A file that is there but cannot be read.
    #[error("{path} cannot be read: {source}")]
    Unread {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}

/// What every run folder holds, whatever was trained: read once, shown as blocks.
#[derive(Clone, Debug)]
pub struct RunView {
    info: Value,
    config: String,
    metrics: Vec<Value>,
    perf: Vec<Value>,
    /// Lines of the logs that are no JSON: cut off when the run was.
    cut_off: usize,
    /// Whether a process is training in the folder.
    held: bool,
    /// Whether there is a checkpoint.
    saved: bool,
}

impl RunView {
    /// Reads `run.json`, `config.toml`, `metrics.jsonl` and `perf.jsonl`. Logs may be missing: nothing was logged yet;
    /// lines of them that are cut off are left out and counted.
    ///
    /// # Errors
    /// As [`RunError`] tells: no run, or half of one.
    pub fn read(dir: &Path) -> Result<Self, RunError> {
        let text = |name: &str| match std::fs::read_to_string(dir.join(name)) {
            Ok(text) => Ok(Some(text)),
            Err(e) if matches!(e.kind(), std::io::ErrorKind::NotFound | std::io::ErrorKind::NotADirectory) => Ok(None),
            Err(source) => Err(RunError::Unread { path: dir.join(name), source }),
        };
        let config = text("config.toml")?.ok_or_else(|| RunError::NoRun(dir.into()))?;
        let info = text("run.json")?.ok_or_else(|| RunError::NoInfo(dir.into()))?;
        let broken = |message: String| RunError::Broken { path: dir.join("run.json"), message };
        let info: Value = serde_json::from_str(&info).map_err(|e| broken(e.to_string()))?;
        if !info["task"].is_string() {
            return Err(broken("it names no task".into()));
        }
        let mut cut_off = 0;
        let mut lines = |name: &str| -> Result<Vec<Value>, RunError> {
            let text = text(name)?.unwrap_or_default();
            let read = text.lines().filter_map(|l| serde_json::from_str(l).map_err(|_| cut_off += 1).ok());
            Ok(read.collect())
        };
        let (metrics, perf) = (lines("metrics.jsonl")?, lines("perf.jsonl")?);
        let held = riglab_files::is_locked(&dir.join(".lock"));
        // It is a link to a checkpoint that is whole.
        let saved = dir.join("checkpoints").join("last").exists();
        Ok(Self { info, config, metrics, perf, cut_off, held, saved })
    }

    /// The task's name.
    pub fn task(&self) -> String {
        self.word("task")
    }

    /// How it ended, or how far it is. One that was killed could not say so.
    pub fn outcome(&self) -> String {
        match (self.word("outcome"), self.last_step()) {
            (told, _) if !told.is_empty() => told,
            _ if self.held => "still running".into(),
            (_, Some(step)) if self.saved => format!("cut off after step {step}"),
            (_, Some(step)) => format!("cut off after step {step}, before the first checkpoint"),
            (_, None) => "cut off before the first step".into(),
        }
    }

    /// The last step that was logged.
    fn last_step(&self) -> Option<u64> {
        self.metrics.iter().filter_map(|line| line["step"].as_u64()).max()
    }

    /// The corpora: path and checksum.
    pub fn corpora(&self) -> Vec<(String, String)> {
        let word = |v: &Value| v.as_str().unwrap_or_default().to_owned();
        self.data().map(|d| (word(&d[0]), word(&d[1]))).collect()
    }

    /// The resolved config.
    pub fn config(&self) -> &str {
        &self.config
    }

    /// With its config written in another way, as by another version.
    pub fn with_config(self, config: String) -> Self {
        Self { config, ..self }
    }

    /// One sentence: what was trained on what, when, and how it ended.
    pub fn subtitle(&self) -> String {
        let (task, state, started) = (self.task(), self.outcome(), self.word("started"));
        if !self.was_trained() {
            return format!("{task}, {state} {started}");
        }
        let assets: u64 = self.data().map(|d| d[2].as_u64().unwrap_or(0)).sum();
        format!("{task} on a corpus of {assets} assets, begun {started}, {state}")
    }

    /// Whether the folder is a training's. One that was made of a model's file does not know what that was trained on, where
    /// or for how long: its machine and times are those of the command that made the folder.
    fn was_trained(&self) -> bool {
        !["exported", "imported"].contains(&self.word("outcome").as_str())
    }

    /// The facts that make the numbers repeatable, and others after them.
    pub fn facts(&self, more: impl IntoIterator<Item = (String, String)>) -> Block {
        Block::Facts(self.fact_list().into_iter().chain(more).collect())
    }

    /// The same as names and values.
    pub(crate) fn fact_list(&self) -> Vec<(String, String)> {
        let mut facts: Vec<(String, String)> = Vec::new();
        let mut add = |name: &str, value: String| {
            if !value.is_empty() {
                facts.push((name.into(), value));
            }
        };
        if let Some(n) = self.info["parameters"].as_f64() {
            add("parameters", format!("{:.2} M", n / 1e6));
        }
        add("steps", self.last_step().map_or(String::new(), |s| s.to_string()));
        let extended = self.extended().map(|e| format!("at step {} from {} to {}", e["at"], e["from"], e["to"]));
        add("extended", extended.collect::<Vec<_>>().join(", then "));
        if let Some(s) = self.info["seconds"].as_f64().filter(|_| self.was_trained()) {
            add("time of training", format!("{:.0} min {:02.0} s", (s / 60.0).floor(), (s % 60.0).floor()));
        }
        let column = |name: &str| self.perf.iter().filter_map(|l| l[name].as_f64()).collect::<Vec<f64>>();
        if let Some(speed) = self.speed() {
            add("steps a second", pace(speed));
        }
        if let Some(mb) = column("perf/peak_memory_mb").into_iter().reduce(f64::max) {
            add("peak memory", format!("{mb:.0} MB"));
        }
        let of_training = ["threads", "device", "machine", "libtorch"];
        for key in of_training.into_iter().filter(|_| self.was_trained()).chain(["riglab", "commit"]) {
            add(key, self.along(key));
        }
        for d in self.data() {
            let checksum: String = d[1].as_str().unwrap_or_default().chars().take(12).collect();
            add("corpus", format!("{} ({checksum})", d[0].as_str().unwrap_or_default()));
        }
        for (key, file, checksum) in self.companions() {
            let file = if file.is_empty() { "the model that comes with riglab" } else { &file };
            add(&key, format!("{file} ({checksum})"));
        }
        if self.cut_off > 0 {
            add("lines cut off in the logs", self.cut_off.to_string());
        }
        facts
    }

    /// The models that the run was made with: the key that names each, what stands there, and the begin of its checksum.
    fn companions(&self) -> Vec<(String, String, String)> {
        let Ok(config) = Config::from_toml_str("config.toml", &self.config) else { return Vec::new() };
        let word = |v: &Value| v.as_str().unwrap_or_default().to_owned();
        let of = |pair: &Value| {
            let key = word(&pair[0]);
            let file = config.get_at(&key).ok()?;
            Some((key, file, word(&pair[1]).chars().take(12).collect()))
        };
        self.info["companions"].as_array().into_iter().flatten().filter_map(of).collect()
    }

    /// Steps a second, of all that the log tells of: its lines are of as many steps as lie between them.
    fn speed(&self) -> Option<f64> {
        let (mut steps, mut seconds, mut before) = (0.0, 0.0, 0.0);
        for line in &self.perf {
            let (Some(step), Some(rate)) = (line["step"].as_f64(), line["perf/steps_per_s"].as_f64()) else { continue };
            if rate > 0.0 && step > before {
                (steps, seconds) = (steps + step - before, seconds + (step - before) / rate);
            }
            before = step;
        }
        (seconds > 0.0).then(|| steps / seconds)
    }

    /// What `run.json` says under a key, and what it was afterwards where the run went on with something else.
    fn along(&self, key: &str) -> String {
        let word =
            |v: &Value| v.as_str().map_or_else(|| v.as_u64().map_or(String::new(), |n| n.to_string()), str::to_owned);
        let resumed = self.info["resumed"].as_array().into_iter().flatten();
        let mut words: Vec<String> = std::iter::once(&self.info).chain(resumed).map(|v| word(&v[key])).collect();
        words.retain(|w| !w.is_empty());
        words.dedup();
        words.join(", then ")
    }

    /// Everything that was logged, by name: steps and values.
    pub fn logged(&self) -> BTreeMap<&str, Vec<(f64, f64)>> {
        let mut of: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
        for line in &self.metrics {
            let (Some(step), Some(values)) = (line["step"].as_f64(), line.as_object()) else { continue };
            for (name, value) in values {
                if let Some(value) = value.as_f64().filter(|_| name != "step") {
                    of.entry(name).or_default().push((step, value));
                }
            }
        }
        of
    }

    /// The same by the names and in the units of tables.
    pub(crate) fn shown(&self) -> BTreeMap<String, Vec<(f64, f64)>> {
        let shown = |(name, points): (&str, Vec<(f64, f64)>)| {
            let (name, factor) = in_unit(name);
            (name, points.into_iter().map(|(x, y)| (x, factor * y)).collect())
        };
        self.logged().into_iter().map(shown).collect()
    }

    /// Curves: the loss; its parts and what else was noted in a step, and every validated metric, each beside those of
    /// its size; gradient norm and learning rate. Of one quantity the title is its name, as where runs are compared.
    pub fn curves(&self) -> Block {
        let shown = self.shown();
        let of: BTreeMap<&str, &Vec<(f64, f64)>> = shown.iter().map(|(name, points)| (name.as_str(), points)).collect();
        let task = self.task();
        let chart = |title: String, names: &[&str], log: bool| {
            let found = names.iter().filter_map(|n| of.get_key_value(*n));
            let series =
                found.map(|(n, p)| Series { name: n.rsplit('/').next().unwrap_or(n).into(), points: p.to_vec() });
            let note = glossary(&task, names);
            Chart { title, x: "step".into(), series: series.collect(), log, note, ..Chart::default() }
        };
        let together = |what: &str, names: &[&str], by_ratio: bool| {
            let single = |name: &&str| chart((*name).to_owned(), &[*name], by_ratio);
            match names {
                [name] => single(name),
                _ => {
                    let apart = names.iter().map(single).collect();
                    Chart { apart, ..chart(format!("{what}: {}", listed(names)), names, by_ratio) }
                }
            }
        };
        let noted = of.keys().copied().filter(|n| {
            let rest = n.strip_prefix("train/").unwrap_or("loss");
            // A part alone is the loss again; what never was tells nothing.
            !["loss", "grad_norm", "lr_factor", "prefix"].contains(&rest)
                && of.get("train/loss") != Some(&of[n])
                && of[n].iter().any(|p| p.1 != 0.0)
        });
        let mut charts = vec![chart("train/loss".into(), &["train/loss"], true)];
        charts.extend(of_a_size(&of, noted.collect()).iter().map(|names| together("in a step", names, true)));
        let validated = of.keys().copied().filter(|n| n.starts_with("eval/"));
        charts.extend(of_a_size(&of, validated.collect()).iter().map(|names| together("validation", names, false)));
        charts.push(chart("gradient norm".into(), &["train/grad_norm"], true));
        charts.push(chart("learning rate, share of the highest".into(), &["train/lr_factor"], false));
        charts.retain(|c| !c.series.is_empty());
        Block::Charts(charts)
    }

    /// The resolved config and the command line, to repeat the run.
    pub fn repeat(&self) -> Vec<Block> {
        let command = self.info["command"].as_array().into_iter().flatten().skip(1).filter_map(Value::as_str);
        let mut lines = vec![shell::command(command)];
        for e in self.extended() {
            lines.push(format!("# then, after {} of its {} steps:", e["at"], e["from"]));
            let steps = format!("train.steps={}", e["to"]);
            lines.push(shell::command(["train", "--resume", "RUN", "--set", &steps]));
        }
        match self.extended().last() {
            Some(last) if last["as_from_start"] != true => lines.push(format!(
                "# The config below, which has {} steps from the start, gives another run: what depends on them\n\
                 # (such as the learning rate, train.schedule), or the threads or device, was different before.",
                last["to"]
            )),
            // Its config alone does not give a model that was trained elsewhere.
            _ if !self.was_trained() => {}
            _ => lines.push("# or, from the resolved config below:\nriglab train config.toml".into()),
        }
        vec![
            Block::Heading("To repeat it".into()),
            Block::Code(lines.join("\n")),
            Block::Folded("config.toml".into(), self.config.clone()),
        ]
    }

    /// Where it was given other steps.
    fn extended(&self) -> impl Iterator<Item = &Value> {
        self.info["extended"].as_array().into_iter().flatten()
    }

    fn data(&self) -> impl Iterator<Item = &Value> {
        self.info["data"].as_array().into_iter().flatten()
    }

    fn word(&self, key: &str) -> String {
        self.info[key].as_str().unwrap_or_default().into()
    }
}

/// Metrics whose last values differ by so much at most share a chart: smaller ones would lie on its floor.
const OF_A_SIZE: f64 = 6.0;
/// Lines of a chart at most.
const LINES: usize = 6;
/// Letters of names in a title.
const ROOM: usize = 44;

/// Metrics by how large they are in the end, those of a chart by name and in one unit.
fn of_a_size<'a>(of: &BTreeMap<&str, &Vec<(f64, f64)>>, mut names: Vec<&'a str>) -> Vec<Vec<&'a str>> {
    let size = |name: &&str| of[name].last().map_or(0.0, |p| p.1.abs());
    let unit = |name: &&str| name.contains(TIMES_100);
    names.sort_by(|a, b| unit(a).cmp(&unit(b)).then(size(a).total_cmp(&size(b))));
    let mut groups: Vec<Vec<&str>> = Vec::new();
    for name in names {
        match groups.last_mut() {
            Some(group)
                if size(&name) <= OF_A_SIZE * size(&group[0])
                    && unit(&name) == unit(&group[0])
                    && group.len() < LINES =>
            {
                group.push(name);
            }
            _ => groups.push(vec![name]),
        }
    }
    groups.iter_mut().for_each(|group| group.sort_unstable());
    groups.sort();
    groups
}

/// Names of a title: what follows `train/` or `eval/`, as many as there is room for.
fn listed(names: &[&str]) -> String {
    let bare: Vec<&str> = names.iter().map(|n| n.rsplit('/').next().unwrap_or(n)).collect();
    let split = |name: &str| name.split_once('@').map(|(_, split)| split.to_owned());
    let all = split(bare[0]).filter(|s| bare.iter().all(|n| split(n).as_ref() == Some(s)));
    let unit = if bare[0].contains(TIMES_100) { TIMES_100 } else { "" };
    let bare: Vec<String> = bare.iter().map(|n| n.replace(TIMES_100, "")).collect();
    let on = all.as_ref().map_or(unit.to_owned(), |s| format!("{unit} on {s}"));
    let mut text = String::new();
    for (k, name) in bare.iter().enumerate() {
        let name = if all.is_some() { name.split('@').next().unwrap_or_default() } else { name };
        if k > 0 && text.len() + name.len() > ROOM {
            return format!("{text} and {} more{on}", bare.len() - k);
        }
        text += if k > 0 { ", " } else { "" };
        text += name;
    }
    text + &on
}

/// Steps a second with a digit behind the point, and of slow runs with as many as give two that tell something.
fn pace(speed: f64) -> String {
    let zeros = if speed > 0.0 { (-speed.log10().floor()).clamp(0.0, 4.0) as usize } else { 0 };
    format!("{speed:.*}", zeros + 1)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn metrics_share_a_chart_with_those_of_their_size() {
        let last =
            [("eval/iou@a", 0.7), ("eval/iou@b", 0.6), ("eval/j2j@a", 0.08), ("eval/l1@a", 0.06), ("eval/n@a", 0.0)];
        let points = last.map(|(_, v)| vec![(1.0, 9.0), (2.0, v)]);
        let of: BTreeMap<&str, &Vec<(f64, f64)>> = last.iter().map(|(n, _)| *n).zip(&points).collect();
        let groups = of_a_size(&of, of.keys().copied().collect());
        assert_eq!(groups, [vec!["eval/iou@a", "eval/iou@b"], vec!["eval/j2j@a", "eval/l1@a"], vec!["eval/n@a"]]);
        let titles: Vec<String> = groups.iter().map(|g| listed(g)).collect();
        assert_eq!(titles, ["iou@a, iou@b", "j2j, l1 on a", "n on a"]);
        let many = ["eval/precision_of_it@v", "eval/recall_of_it@v", "eval/something@v", "eval/another@v"];
        assert_eq!(listed(&many), "precision_of_it, recall_of_it, something and 1 more on v");
    }

    #[test]
    fn slow_runs_have_a_speed() {
        assert_eq!([23.456, 1.06, 0.0734, 0.5, 0.0].map(pace), ["23.5", "1.1", "0.073", "0.50", "0.0"]);
        // The last line is of one step, and holds the end of the run: 121 steps in 2 + 2 + 1 seconds.
        let line = |step: u32, rate: f64| format!("{}\n", json!({"step": step, "perf/steps_per_s": rate}));
        let lines = line(60, 30.0) + &line(120, 30.0) + &line(121, 1.0);
        let dir = folder(&[("config.toml", ""), ("run.json", INFO), ("perf.jsonl", &lines)]);
        let facts = RunView::read(dir.path()).unwrap().fact_list();
        assert!(facts.contains(&("steps a second".into(), "24.2".into())), "{facts:?}");
    }

    #[test]
    fn notes_of_a_step_stand_beside_those_of_their_size() {
        let line = |step: u32, loss: f64| {
            let noted = json!({"step": step, "train/loss": loss, "train/all": loss, "train/bce": 1.5, "train/mse": 0.5,
                               "train/tokens": 900.25, "train/skipped": 0});
            format!("{noted}\n")
        };
        let lines = line(1, 2.0) + &line(2, 1.5);
        let dir = folder(&[("config.toml", ""), ("run.json", INFO), ("metrics.jsonl", &lines)]);
        let Block::Charts(charts) = RunView::read(dir.path()).unwrap().curves() else { panic!("charts") };
        let shown: Vec<(&str, Vec<&str>)> =
            charts.iter().map(|c| (c.title.as_str(), c.series.iter().map(|s| s.name.as_str()).collect())).collect();
        let parts = ("in a step: bce, mse", vec!["bce", "mse"]);
        assert_eq!(shown, [("train/loss", vec!["loss"]), parts, ("train/tokens", vec!["tokens"])]);
        let apart: Vec<&str> = charts[1].apart.iter().map(|c| c.title.as_str()).collect();
        assert_eq!(apart, ["train/bce", "train/mse"]);
        assert!(charts[0].apart.is_empty() && charts[1].apart.iter().all(|c| c.series.len() == 1 && c.log));
    }

    #[test]
    fn distances_have_the_unit_of_tables() {
        let lines = "{\"step\":1,\"eval/j2j@val\":0.25,\"eval/b2b@val\":0.125,\"eval/iou@val\":0.5}\n";
        let dir = folder(&[("config.toml", ""), ("run.json", INFO), ("metrics.jsonl", lines)]);
        let run = RunView::read(dir.path()).unwrap();
        let Block::Charts(charts) = run.curves() else { panic!("charts") };
        let titles: Vec<&str> = charts.iter().map(|c| c.title.as_str()).collect();
        assert_eq!(titles, ["validation: b2b, j2j × 100 on val", "eval/iou@val"]);
        let apart: Vec<&str> = charts[0].apart.iter().map(|c| c.title.as_str()).collect();
        assert_eq!(apart, ["eval/b2b × 100@val", "eval/j2j × 100@val"], "as where runs are compared");
        assert_eq!(charts[0].series[1].name, "j2j × 100@val");
        assert_eq!(charts[0].series[1].points, [(1.0, 25.0)]);
        assert_eq!(run.logged()["eval/j2j@val"], [(1.0, 0.25)], "what was logged is as it was");
    }

    /// A run's folder with these files.
    fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        files.iter().for_each(|(name, text)| std::fs::write(dir.path().join(name), text).unwrap());
        dir
    }

    // Runs of before told when they were resumed, alone.
    const INFO: &str = "{\"task\": \"t\", \"command\": [\"/bin/riglab\", \"train\", \"a b.toml\"], \"data\": [[\"c.h5\", \"abcdef\", 7]], \"threads\": 2, \"device\": \"cpu\", \"resumed\": \
        [\"2026-01-01T00:00:00Z\", {\"threads\": 8, \"device\": \"cuda:0\"}, {\"threads\": 8, \"device\": \"cpu\"}]}";

    #[test]
    fn a_run_that_was_cut_off_gives_a_page_too() {
        let lines = "{\"step\":1,\"train/loss\":2.0}\n{\"step\":2,\"train/loss\":null}\n{\"eval/iou@val\":0.5,\"step\":2}\n{\"st";
        let dir = folder(&[("config.toml", "a = 1\n"), ("run.json", INFO), ("metrics.jsonl", lines)]);
        let run = RunView::read(dir.path()).unwrap();
        assert!(run.subtitle().contains("7 assets") && run.subtitle().contains("cut off"));
        let Block::Charts(charts) = run.curves() else { panic!("charts") };
        assert_eq!(charts.len(), 2);
        assert_eq!(charts[0].series[0].points, [(1.0, 2.0)]);
        let Block::Facts(facts) = run.facts([]) else { panic!("facts") };
        assert!(facts.contains(&("lines cut off in the logs".into(), "1".into())));
        let fact = |name: &str| facts.iter().find(|(n, _)| n == name).map(|(_, v)| v.as_str());
        assert_eq!((fact("threads"), fact("device")), (Some("2, then 8"), Some("cpu, then cuda:0, then cpu")));
        assert!(matches!(&run.repeat()[1], Block::Code(c) if c.starts_with("riglab train 'a b.toml'\n")));
        // What it was made with is told by the key that names it.
        let mut info: Value = serde_json::from_str(INFO).unwrap();
        info["companions"] =
            json!([["start.model", "0123456789abcdef"], ["skin.run", "fedcba9876543210"], ["other", "0"]]);
        let config = "[start]\nmodel = 'runs/\"a\"'\n[skin]\nrun = \"\"\n";
        let dir = folder(&[("config.toml", config), ("run.json", &info.to_string())]);
        let facts = RunView::read(dir.path()).unwrap().fact_list();
        let made: Vec<_> = facts.iter().filter(|(name, _)| name.contains('.')).map(|(n, v)| (&**n, &**v)).collect();
        let ours = "the model that comes with riglab (fedcba987654)";
        assert_eq!(made, [("start.model", "runs/\"a\" (0123456789ab)"), ("skin.run", ours)]);
        // Before the first line there is nothing to draw.
        let dir = folder(&[("config.toml", ""), ("run.json", INFO)]);
        assert!(matches!(RunView::read(dir.path()).unwrap().curves(), Block::Charts(c) if c.is_empty()));
    }

    #[test]
    fn an_extended_run_is_repeated_by_both_commands() {
        let of = |as_from_start: bool| {
            let mut info: Value = serde_json::from_str(INFO).unwrap();
            info["extended"] = json!([{"at": 40, "from": 90, "to": 120, "as_from_start": as_from_start}]);
            let dir = folder(&[("config.toml", ""), ("run.json", &info.to_string())]);
            let run = RunView::read(dir.path()).unwrap();
            let Block::Facts(facts) = run.facts([]) else { panic!("facts") };
            assert!(facts.contains(&("extended".into(), "at step 40 from 90 to 120".into())), "{facts:?}");
            let [_, Block::Code(code), ..] = &run.repeat()[..] else { panic!("code") };
            code.clone()
        };
        let begun = "riglab train 'a b.toml'\n# then, after 40 of its 90 steps:\n\
                     riglab train --resume RUN --set 'train.steps=120'\n";
        assert_eq!(of(true), format!("{begun}# or, from the resolved config below:\nriglab train config.toml"));
        let other = of(false);
        assert!(other.starts_with(begun) && other.contains("gives another run"), "{other}");
        assert!(!other.contains("train config.toml"), "{other}");
    }

    #[test]
    fn the_folder_of_an_exported_model_says_nothing_of_its_training() {
        let info = json!({"task": "t", "command": ["/bin/riglab", "checkpoint", "export", "a", "-o", "b"], "data": [],
            "parameters": 90000, "threads": 1, "device": "cpu", "machine": "m", "riglab": "0.1.0", "steps": 0,
            "started": "2026-01-01T00:00:00Z", "outcome": "exported", "seconds": 0.0});
        let dir = folder(&[("config.toml", ""), ("run.json", &info.to_string())]);
        let run = RunView::read(dir.path()).unwrap();
        assert_eq!(run.subtitle(), "t, exported 2026-01-01T00:00:00Z");
        let facts = [("parameters", "0.09 M"), ("riglab", "0.1.0")].map(|(name, value)| (name.into(), value.into()));
        assert_eq!(run.fact_list(), facts);
        assert!(matches!(&run.repeat()[1], Block::Code(c) if c == "riglab checkpoint export a -o b"));
    }

    #[test]
    fn a_run_that_could_not_say_how_it_ended_is_told_by_what_it_left() {
        let step = "{\"step\": 3, \"train/loss\": 1.0}\n";
        let dir = folder(&[("config.toml", ""), ("run.json", "{\"task\": \"t\", \"outcome\": \"\"}")]);
        let outcome = || RunView::read(dir.path()).unwrap().outcome();
        assert_eq!(outcome(), "cut off before the first step");
        std::fs::write(dir.path().join("metrics.jsonl"), step).unwrap();
        assert_eq!(outcome(), "cut off after step 3, before the first checkpoint");
        std::fs::create_dir_all(dir.path().join("checkpoints/last")).unwrap();
        assert_eq!(outcome(), "cut off after step 3");
        let lock = std::fs::File::create(dir.path().join(".lock")).unwrap();
        lock.lock().unwrap();
        assert_eq!(outcome(), "still running");
        std::fs::write(dir.path().join("run.json"), "{\"task\": \"t\", \"outcome\": \"interrupted\"}").unwrap();
        assert_eq!(outcome(), "interrupted");
    }

    #[test]
    fn half_of_a_run_is_told_by_what_is_missing() {
        let said = |files: &[(&str, &str)]| RunView::read(folder(files).path()).unwrap_err().to_string();
        assert!(said(&[]).contains("no run here"));
        assert!(said(&[("config.toml", "")]).contains("half-written run: there is config.toml but no run.json"));
        let cut = said(&[("config.toml", ""), ("run.json", &INFO[..20])]);
        assert!(cut.contains("run.json: half-written run: EOF") && cut.contains("repeat"), "{cut}");
        assert!(said(&[("config.toml", ""), ("run.json", "{}")]).contains("names no task"));
        let file = tempfile::NamedTempFile::new().unwrap();
        assert!(matches!(RunView::read(file.path()), Err(RunError::NoRun(_))));
    }
}
