//! What a run writes down.

use std::collections::BTreeMap;
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Write};
use std::path::{Path, PathBuf};

use riglab_config::{Config, Leaf};
use serde_json::{Map, Value, json};

use crate::TrainError;
use crate::progress::tell;
use crate::run::Run;
use crate::tensorboard::TensorBoard;

/// `metrics.jsonl`, `perf.jsonl` and TensorBoard's view.
pub(crate) struct Logs {
    metrics: Lines,
    perf: Lines,
    board: Option<TensorBoard>,
}

impl Logs {
    /// Opens the logs of a run that has done `step` steps: lines of later steps, which a killed run
    /// wrote after its last checkpoint, are cut off.
    pub fn open(run: &Run, step: u64) -> Result<Self, TrainError> {
        let board = TensorBoard::create(&run.path("tensorboard"), step);
        if let Err(e) = &board {
            tell(format_args!("warning: no TensorBoard view ({e}); metrics.jsonl has everything"));
        }
        Ok(Self {
            metrics: Lines::open(run.path("metrics.jsonl"), step)?,
            perf: Lines::open(run.path("perf.jsonl"), step)?,
            board: board.ok(),
        })
    }

    /// One line of metrics: what a step or validation gave.
    pub fn metrics(&mut self, step: u64, values: &[(String, f64)]) -> Result<(), TrainError> {
        self.metrics.add(step, values)
    }

    /// One line of what depends on the clock.
    pub fn perf(&mut self, step: u64, values: &[(String, f64)]) -> Result<(), TrainError> {
        self.perf.add(step, values)
    }

    /// The run's settings, for TensorBoard: as a text, and as a row of the table of runs, whose result
    /// is the curve `objective`.
    pub fn settings(&mut self, config: &str, objective: &str) {
        let values = values(config);
        self.board(|b| {
            b.text("config", &format!("```toml\n{config}\n```"), 0)?;
            b.hparams(&values, &[objective])
        });
    }

    /// Something for TensorBoard. A view that cannot be written is given up with a warning: it is not
    /// worth a run.
    pub fn board(&mut self, write: impl FnOnce(&mut TensorBoard) -> std::io::Result<()>) {
        if let Some(board) = &mut self.board
            && let Err(e) = write(board)
        {
            tell(format_args!("warning: TensorBoard's view ends here ({e})"));
            self.board = None;
        }
    }

    /// Makes all lines durable.
    pub fn sync(&mut self) -> Result<(), TrainError> {
        self.metrics.sync()?;
        self.perf.sync()?;
        self.board(TensorBoard::flush);
        Ok(())
    }
}

/// The values of a config by their path, `a.b.c`; none of what is no config.
fn values(config: &str) -> BTreeMap<String, String> {
    // TOML's own reader takes no seed beyond 63 bits.
    let Ok(config) = Config::from_toml_str("config.toml", config) else { return BTreeMap::new() };
    let leaves = config.leaves().into_iter();
    // Texts without their quotes.
    leaves.map(|Leaf { path, value, .. }| (path.clone(), config.get_at(&path).unwrap_or(value))).collect()
}

/// A file of JSON lines with a `step` each.
struct Lines {
    path: PathBuf,
    file: File,
}

impl Lines {
    fn open(path: PathBuf, step: u64) -> Result<Self, TrainError> {
        if path.exists() {
            cut(&path, step).map_err(|e| TrainError::io(&path, "be cut back to the checkpoint", &e))?;
        }
        let file = OpenOptions::new().create(true).append(true).open(&path);
        Ok(Self { file: file.map_err(|e| TrainError::io(&path, "be opened", &e))?, path })
    }

    fn add(&mut self, step: u64, values: &[(String, f64)]) -> Result<(), TrainError> {
        let mut line = Map::new();
        line.insert("step".into(), json!(step));
        for (name, value) in values {
            // JSON has no NaN: null says that there was no number.
            line.insert(name.clone(), serde_json::Number::from_f64(*value).map_or(Value::Null, Value::Number));
        }
        // One write a line: a killed run leaves whole lines, or one part of the last.
        let text = Value::Object(line).to_string() + "\n";
        self.file.write_all(text.as_bytes()).map_err(|e| TrainError::io(&self.path, "be written", &e))
    }

    fn sync(&mut self) -> Result<(), TrainError> {
        self.file.sync_data().map_err(|e| TrainError::io(&self.path, "be synced", &e))
    }
}

/// Keeps the whole lines of the first `step` steps.
fn cut(path: &Path, step: u64) -> std::io::Result<()> {
    let mut kept = Vec::new();
    for line in BufReader::new(File::open(path)?).split(b'\n') {
        let line = line?;
        let of: Option<u64> = serde_json::from_slice::<Value>(&line).ok().and_then(|v| v["step"].as_u64());
        if of.is_some_and(|s| s <= step) {
            kept.extend(line);
            kept.push(b'\n');
        }
    }
    riglab_files::write(path, &kept)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_value_of_a_config_is_a_row_whatever_the_seed() {
        let text = "task = \"a b\"\n[train]\nseed = 18446744073709551615\nrates = [0.5, 1]\n[train.slow]\non = true\n";
        let wanted = [
            ("task", "a b"),
            ("train.rates", "[0.5, 1]"),
            ("train.seed", "18446744073709551615"),
            ("train.slow.on", "true"),
        ];
        assert_eq!(values(text), wanted.map(|(path, value)| (path.to_owned(), value.to_owned())).into());
        assert!(values("no config").is_empty());
    }

    #[test]
    fn lines_after_the_checkpoint_and_broken_ones_are_cut() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("m.jsonl");
        std::fs::write(&path, "{\"step\":1}\n{\"step\":2,\"a\":0.5}\n{\"step\":3}\n{\"st").unwrap();
        let mut lines = Lines::open(path.clone(), 2).unwrap();
        lines.add(3, &[("b".into(), f64::NAN), ("a".into(), 0.1)]).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(text, "{\"step\":1}\n{\"step\":2,\"a\":0.5}\n{\"a\":0.1,\"b\":null,\"step\":3}\n");
    }
}
