//! What a sweep found.

use std::collections::BTreeSet;
use std::path::Path;

use riglab_metric::statistics::Mean;
use riglab_report::{Block, Cell, Page, Table, shell};
use serde::{Deserialize, Serialize};

use crate::figures::{figures, learning, spread};
use crate::plan::write;
use crate::values::Numbers;
use crate::{Better, FigureOf, Job, MetricOf, Plan, State, SweepError, attempts};

/// A job with its numbers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Outcome {
    /// The point of the sweep.
    pub point: String,
    /// The seed.
    pub seed: u64,
    /// `finished`, `failed`, or how far it is.
    pub state: String,
    /// Why it failed; else empty.
    pub reason: String,
    /// A value for each column of the table; null where there is none.
    pub values: Vec<Option<f64>>,
}

/// All jobs of a sweep with their numbers.
#[derive(Clone, Debug)]
pub struct Results {
    pub(crate) plan: Plan,
    metrics: Vec<MetricOf>,
    /// In the order of the jobs.
    pub outcomes: Vec<Outcome>,
    /// Steps done of those that run.
    states: Vec<State>,
    /// What the finished ones found; nothing for others.
    pub(crate) numbers: Vec<Numbers>,
}

impl Results {
    /// Reads the runs of a sweep's folder as they are now. Only finished runs have numbers.
    pub fn read(folder: &Path, plan: &Plan) -> Self {
        let failed = attempts(folder);
        let states: Vec<State> = plan.jobs.iter().map(|j| State::of(folder, plan, j, &failed)).collect();
        let columns = plan.sweep.metrics.iter().map(|m| m.of.clone());
        let asked: Vec<String> = columns.chain(plan.sweep.figures.iter().flat_map(FigureOf::places)).collect();
        let read = |(job, state): (&Job, &State)| match state {
            State::Finished => Numbers::read(&folder.join(&job.folder), &asked),
            _ => Numbers::default(),
        };
        let numbers: Vec<Numbers> = plan.jobs.iter().zip(&states).map(read).collect();
        let metrics = metrics(plan, &numbers);
        let outcome = |((job, state), numbers): ((&Job, &State), &Numbers)| {
            let values = metrics.iter().map(|m| numbers.value(&m.of).filter(|v| v.is_finite())).collect();
            let (state, reason) = match state {
                State::Finished => ("finished", String::new()),
                State::Failed(reason) => ("failed", reason.clone()),
                State::Waiting => ("waiting", String::new()),
                State::Running(_) => ("running", String::new()),
                State::Interrupted(_) => ("interrupted", String::new()),
                State::Trained => ("trained", String::new()),
            };
            Outcome { point: job.point.clone(), seed: job.seed, state: state.into(), reason, values }
        };
        let outcomes = plan.jobs.iter().zip(&states).zip(&numbers).map(outcome).collect();
        Self { plan: plan.clone(), metrics, outcomes, states, numbers }
    }

    /// How many jobs are in a state of that name.
    pub fn count(&self, state: &str) -> usize {
        self.outcomes.iter().filter(|o| o.state == state).count()
    }

    /// A row a point: for each metric the mean over seeds and the standard deviation, and how many runs they are of.
    pub fn table(&self) -> Table {
        let mut head = vec!["point".to_owned(), "runs".into(), "failed".into()];
        head.extend(self.metrics.iter().map(|m| m.head().to_owned()));
        let caption = if self.plan.sweep.question.is_empty() { "Sweep" } else { &self.plan.sweep.question };
        let mut table = Table { caption: caption.into(), head, ..Table::default() };
        let means: Vec<Vec<Mean>> = self.plan.names().iter().map(|p| self.means(p)).collect();
        for (point, own) in self.plan.names().iter().zip(&means) {
            let of = |state: &str| self.outcomes.iter().filter(|o| o.point == *point && o.state == state).count();
            let mut cells = vec![Cell::text(*point), Cell::count(of("finished")), Cell::count(of("failed"))];
            for (k, (m, metric)) in own.iter().zip(&self.metrics).enumerate() {
                let all = means.iter().map(|row| row[k].mean).filter(|v| v.is_finite());
                let best = match metric.better {
                    Some(Better::Higher) => all.reduce(f64::max),
                    Some(Better::Lower) => all.reduce(f64::min),
                    None => None,
                };
                let digits = metric.digits;
                let text = match m.n {
                    0 => "–".into(),
                    1 => format!("{:.digits$}", m.mean),
                    _ => format!("{:.digits$} ± {:.digits$}", m.mean, m.deviation),
                };
                cells.push(Cell::none().with_text(text).strong_if(means.len() > 1 && best == Some(m.mean)));
            }
            table.row(cells);
        }
        table.note = "Mean over seeds ± standard deviation (n - 1).".into();
        if table.rows.iter().flatten().any(|cell| cell.strong) {
            table.note += " Marked: the best of a column.";
        }
        if let Some(sentence) = self.mixed() {
            table.note += &format!(" {}.", sentence.replacen('n', "N", 1));
        }
        table
    }

    /// For each other point and metric the difference from the first point, seed by seed: its mean and spread. `None`
    /// with a single point.
    pub fn differences(&self) -> Option<Table> {
        let names = self.plan.names();
        let (first, others) = names.split_first().filter(|(_, others)| !others.is_empty())?;
        let mut head = vec![format!("difference from {first}")];
        head.extend(self.metrics.iter().map(|m| m.head().to_owned()));
        let mut table = Table { caption: "Differences, seed by seed".into(), head, ..Table::default() };
        for point in others {
            let mut cells = vec![Cell::text(*point)];
            for (k, metric) in self.metrics.iter().enumerate() {
                let of = |p: &str, seed| {
                    self.outcomes.iter().find(|o| o.point == p && o.seed == seed).and_then(|o| o.values[k])
                };
                let apart = |seed: &u64| of(point, *seed).zip(of(first, *seed)).map(|(a, b)| a - b);
                let pairs: Vec<f64> = self.plan.sweep.seeds.iter().filter_map(apart).collect();
                let (m, digits) = (Mean::of(&pairs), metric.digits);
                let text = match m.n {
                    0 => "–".into(),
                    1 => format!("{:+.digits$}", m.mean),
                    _ => format!("{:+.digits$} ± {:.digits$}", m.mean, m.deviation),
                };
                cells.push(Cell::none().with_text(text));
            }
            table.row(cells);
        }
        Some(table)
    }

    /// A row a job: what it has come to.
    pub fn status(&self) -> Table {
        let mut table = Table::new("Jobs", &["point", "seed", "state", "step", "reason"]);
        for (outcome, state) in self.outcomes.iter().zip(&self.states) {
            let step = match state {
                State::Running(step) | State::Interrupted(step) => Cell::count(*step as usize),
                _ => Cell::none(),
            };
            let cells = [&outcome.state, &outcome.reason].map(Cell::text);
            let [state, reason] = cells;
            table.row(vec![
                Cell::text(&outcome.point),
                Cell::none().with_text(outcome.seed.to_string()),
                state,
                step,
                reason,
            ]);
        }
        table
    }

    fn means(&self, point: &str) -> Vec<Mean> {
        let of = |k: usize| {
            let own = self.outcomes.iter().filter(|o| o.point == point && o.state == "finished");
            Mean::of(&own.map(|o| o.values[k].unwrap_or(f64::NAN)).collect::<Vec<_>>())
        };
        (0..self.metrics.len()).map(of).collect()
    }

    /// Writes `results.jsonl`, which is the truth, and the tables as `table.md`, `table.tex`, `table.csv` and
    /// `report.html`.
    ///
    /// # Errors
    /// When the folder cannot be written.
    pub fn write(&self, folder: &Path) -> Result<(), SweepError> {
        let names: Vec<&str> = self.metrics.iter().map(|m| m.of.as_str()).collect();
        let line = |o: &Outcome| {
            let values: serde_json::Map<String, serde_json::Value> =
                names.iter().zip(&o.values).map(|(n, v)| ((*n).to_owned(), serde_json::json!(v))).collect();
            let line = serde_json::json!({
                "point": o.point, "seed": o.seed, "state": o.state, "reason": o.reason, "values": values,
            });
            line.to_string() + "\n"
        };
        write(&folder.join("results.jsonl"), &self.outcomes.iter().map(line).collect::<String>())?;
        let tables: Vec<Table> = std::iter::once(self.table()).chain(self.differences()).collect();
        let all = |form: fn(&Table) -> String| tables.iter().map(form).collect::<Vec<_>>().join("\n");
        write(&folder.join("table.md"), &all(Table::to_markdown))?;
        write(&folder.join("table.tex"), &all(Table::to_latex))?;
        write(&folder.join("table.csv"), &self.table().to_csv())?;
        let mut blocks = Vec::new();
        if !self.plan.sweep.expected.is_empty() {
            blocks.push(Block::Text(format!("Expected: {}", self.plan.sweep.expected)));
        }
        // The question is the page's title already.
        let mut tables = tables;
        tables[0].caption = "Points".into();
        blocks.extend(tables.into_iter().map(Block::Table));
        let (plan, outcomes) = (&self.plan, &self.outcomes);
        for (title, pictures) in [
            ("Figures", figures(plan, outcomes, &self.numbers)),
            ("All seeds", spread(plan, &self.metrics, outcomes)),
            ("Learning", learning(folder, plan, &self.metrics, outcomes)),
        ] {
            blocks.extend(pictures.into_iter().flat_map(|own| [Block::Heading(title.into()), own]));
        }
        if self.outcomes.iter().any(|o| o.state != "finished") {
            blocks.push(Block::Table(self.status()));
        }
        blocks.push(Block::Heading("To repeat it".into()));
        let changes = |j: &Job| {
            let sets = j.sets.iter().flat_map(|set| ["--set", set.as_str()]);
            let command = shell::command(["train", j.base.as_str()].into_iter().chain(sets));
            format!("# {}, seed {}\n{command}", j.point, j.seed)
        };
        blocks.push(Block::Folded("Jobs".into(), self.plan.jobs.iter().map(changes).collect::<Vec<_>>().join("\n")));
        let subtitle = format!(
            "{} {}: {} finished, {} failed",
            self.outcomes.len(),
            if self.outcomes.len() == 1 { "job" } else { "jobs" },
            self.count("finished"),
            self.count("failed")
        );
        let question = &self.plan.sweep.question;
        let title = if question.is_empty() { "Sweep".to_owned() } else { question.clone() };
        let page = Page { title, subtitle, blocks };
        let html = page.to_html().map_err(|e| SweepError::Invalid(e.to_string()))?;
        write(&folder.join("report.html"), &html)
    }
}

/// The columns: those asked for, or all that the finished runs' last validations have.
fn metrics(plan: &Plan, numbers: &[Numbers]) -> Vec<MetricOf> {
    if !plan.sweep.metrics.is_empty() {
        return plan.sweep.metrics.clone();
    }
    let all = numbers.iter().flat_map(|n| n.last.keys()).filter(|n| n.starts_with("eval/"));
    all.collect::<BTreeSet<_>>().into_iter().map(|n| MetricOf::plain(n)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_have_spread_and_count_failures() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nquestion = 'Does x help?'\nbase = 'b'\nseeds = [1, 2]\nset = { x = ['a'] }\n\
            [[sweep.arms]]\nname = 'with'\n[[sweep.arms]]\nname = 'without'\n\
            [[sweep.metrics]]\nof = 'eval/iou@val'\nname = 'IoU'\nbetter = 'higher'\ndigits = 2\n\
            [[sweep.figures]]\ntitle = 'by k'\nx = 'k'\nat = [4, 8]\nof = 'eval.json:rows[k={}].iou'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        for (k, iou) in [Some(0.5), Some(0.7), Some(0.4), None].into_iter().enumerate() {
            let run = dir.path().join(&plan.jobs[k].folder);
            std::fs::create_dir_all(&run).unwrap();
            let Some(iou) = iou else { continue };
            std::fs::write(run.join("metrics.jsonl"), format!("{{\"step\":1,\"eval/iou@val\":{iou}}}\n")).unwrap();
            std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
            let eval = format!("{{\"rows\": [{{\"k\": 4, \"iou\": {iou}}}, {{\"k\": 8, \"iou\": 0.9}}]}}");
            std::fs::write(run.join("eval.json"), eval).unwrap();
        }
        for _ in 0..2 {
            let failed = crate::Attempt { job: 3, stage: "train".into(), reason: "x".into(), given_up: false };
            crate::attempts::record(dir.path(), &failed).unwrap();
        }
        let results = Results::read(dir.path(), &plan);
        // Evaluations may be large: what is asked of them was read at once.
        for job in &plan.jobs[..3] {
            std::fs::remove_file(dir.path().join(&job.folder).join("eval.json")).unwrap();
        }
        assert!(results.absent(dir.path()).is_empty());
        let table = results.table();
        let row = |k: usize| table.rows[k].iter().map(|c| c.text.as_str()).collect::<Vec<_>>();
        assert_eq!(row(0), ["with", "2", "0", "0.60 ± 0.14"]);
        assert_eq!(row(1), ["without", "1", "1", "0.40"]);
        assert!(table.rows[0][3].strong && !table.rows[1][3].strong);
        assert_eq!(results.differences().unwrap().rows[0][1].text, "-0.10");
        results.write(dir.path()).unwrap();
        let lines = std::fs::read_to_string(dir.path().join("results.jsonl")).unwrap();
        assert!(lines.contains("\"eval/iou@val\":0.5") && lines.contains("\"reason\":\"train: x\""), "{lines}");
        let html = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
        assert!(html.contains("Does x help?") && html.contains("0.60 ± 0.14"));
        assert!(html.contains("riglab train b --set") && !html.contains("--set x="), "quoted for a shell");
        assert_eq!(html.matches("<circle").count(), 3, "a dot a finished run");
        assert!(html.contains("by k") && html.contains("<polyline"), "a line a point");
        assert!(std::fs::read_to_string(dir.path().join("table.md")).unwrap().contains("**0.60 ± 0.14**"));
    }
}
