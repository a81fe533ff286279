//! A run folder as a page.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use crate::{Block, Chart, Series};

/// What every run folder holds, whatever was trained: read once, shown as blocks.
pub struct RunView {
    info: Value,
    config: String,
    metrics: Vec<Value>,
    perf: Vec<Value>,
}

impl RunView {
    /// Reads `run.json`, `config.toml`, `metrics.jsonl` and `perf.jsonl`. What is missing is left
    /// out; lines that are cut off are skipped.
    pub fn read(dir: &Path) -> Self {
        let text = |name: &str| std::fs::read_to_string(dir.join(name)).unwrap_or_default();
        let lines = |name: &str| text(name).lines().filter_map(|l| serde_json::from_str(l).ok()).collect();
        Self {
            info: serde_json::from_str(&text("run.json")).unwrap_or_default(),
            config: text("config.toml"),
            metrics: lines("metrics.jsonl"),
            perf: lines("perf.jsonl"),
        }
    }

    /// The task's name.
    pub fn task(&self) -> String {
        self.word("task")
    }

    /// One sentence: what was trained on what, when, and how it ended.
    pub fn subtitle(&self) -> String {
        let assets: u64 = self.data().map(|d| d[2].as_u64().unwrap_or(0)).sum();
        let state = match self.word("outcome") {
            o if o.is_empty() => "still running or cut off".to_string(),
            o => o,
        };
        format!("{} on a corpus of {assets} assets, begun {}, {state}", self.task(), self.word("started"))
    }

    /// The facts that make the numbers repeatable.
    pub fn facts(&self) -> Block {
        let mut facts: Vec<(String, String)> = Vec::new();
        let mut add = |name: &str, value: String| {
            if !value.is_empty() {
                facts.push((name.into(), value));
            }
        };
        if let Some(n) = self.info["parameters"].as_f64() {
            add("parameters", format!("{:.2} M", n / 1e6));
        }
        let steps = self.metrics.iter().filter_map(|l| l["step"].as_u64()).max();
        add("steps", steps.map_or(String::new(), |s| s.to_string()));
        if let Some(s) = self.info["seconds"].as_f64() {
            add("time of training", format!("{:.0} min {:02.0} s", (s / 60.0).floor(), (s % 60.0).floor()));
        }
        let column = |name: &str| self.perf.iter().filter_map(|l| l[name].as_f64()).collect::<Vec<f64>>();
        let speed = column("perf/steps_per_s");
        if !speed.is_empty() {
            add("steps a second", format!("{:.1}", speed.iter().sum::<f64>() / speed.len() as f64));
        }
        if let Some(mb) = column("perf/peak_memory_mb").into_iter().reduce(f64::max) {
            add("peak memory", format!("{mb:.0} MB"));
        }
        add("threads", self.info["threads"].as_u64().map_or(String::new(), |t| t.to_string()));
        for key in ["machine", "libtorch", "riglab", "commit"] {
            add(key, self.word(key));
        }
        for d in self.data() {
            let checksum: String = d[1].as_str().unwrap_or_default().chars().take(12).collect();
            add("corpus", format!("{} ({checksum})", d[0].as_str().unwrap_or_default()));
        }
        Block::Facts(facts)
    }

    /// Curves: the loss and its parts, every validated metric, gradient norm and learning rate.
    pub fn curves(&self) -> Block {
        let mut of: BTreeMap<&str, Vec<(f64, f64)>> = BTreeMap::new();
        for line in &self.metrics {
            let (Some(step), Some(values)) = (line["step"].as_f64(), line.as_object()) else { continue };
            for (name, value) in values {
                if let Some(value) = value.as_f64().filter(|_| name != "step") {
                    of.entry(name).or_default().push((step, value));
                }
            }
        }
        let series = |names: &[&str]| -> Vec<Series> {
            let found = names.iter().filter_map(|n| of.get_key_value(*n));
            found.map(|(n, p)| Series { name: n.rsplit('/').next().unwrap_or(n).into(), points: p.clone() }).collect()
        };
        let chart = |title: &str, names: &[&str], log: bool| Chart {
            title: title.into(),
            x: "step".into(),
            series: series(names),
            log,
        };
        let parts: Vec<&str> = of
            .keys()
            .copied()
            .filter(|n| {
                n.strip_prefix("train/").is_some_and(|n| !["loss", "grad_norm", "lr_factor", "prefix"].contains(&n))
            })
            .collect();
        let mut charts = vec![chart("loss", &["train/loss"], true), chart("parts of the loss", &parts, true)];
        let (ious, others): (Vec<&str>, Vec<&str>) =
            of.keys().copied().filter(|n| n.starts_with("eval/")).partition(|n| n.contains("iou"));
        if !ious.is_empty() {
            charts.push(chart("validation: IoU", &ious, false));
        }
        if !others.is_empty() {
            charts.push(chart("validation: others", &others, false));
        }
        charts.push(chart("gradient norm", &["train/grad_norm"], true));
        charts.push(chart("learning rate, share of the highest", &["train/lr_factor"], false));
        charts.retain(|c| !c.series.is_empty());
        Block::Charts(charts)
    }

    /// The resolved config and the command line, to repeat the run.
    pub fn repeat(&self) -> Vec<Block> {
        let command: Vec<&str> =
            self.info["command"].as_array().into_iter().flatten().filter_map(Value::as_str).collect();
        vec![
            Block::Heading("To repeat it".into()),
            Block::Code(format!(
                "{}\n# or, from the resolved config below:\nriglab train config.toml",
                command.join(" ")
            )),
            Block::Folded("config.toml".into(), self.config.clone()),
        ]
    }

    fn data(&self) -> impl Iterator<Item = &Value> {
        self.info["data"].as_array().into_iter().flatten()
    }

    fn word(&self, key: &str) -> String {
        self.info[key].as_str().unwrap_or_default().into()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cut_off_run_and_an_empty_folder_give_pages_too() {
        let dir = tempfile::tempdir().unwrap();
        let empty = RunView::read(dir.path());
        assert!(matches!(empty.curves(), Block::Charts(c) if c.is_empty()));
        std::fs::write(dir.path().join("run.json"), "{\"task\": \"t\", \"data\": [[\"c.h5\", \"abcdef\", 7]]}")
            .unwrap();
        let lines = "{\"step\":1,\"train/loss\":2.0}\n{\"step\":2,\"train/loss\":null}\n{\"eval/iou@val\":0.5,\"step\":2}\n{\"st";
        std::fs::write(dir.path().join("metrics.jsonl"), lines).unwrap();
        let run = RunView::read(dir.path());
        assert!(run.subtitle().contains("7 assets") && run.subtitle().contains("cut off"));
        let Block::Charts(charts) = run.curves() else { panic!("charts") };
        assert_eq!(charts.len(), 2);
        assert_eq!(charts[0].series[0].points, [(1.0, 2.0)]);
    }
}
