//! What a sweep found.

use std::collections::BTreeSet;
use std::fs::read_to_string;
use std::path::Path;

use riglab_report::{Block, Cell, Losses, Page, PageKind, Table, shell};
use serde::{Deserialize, Serialize};

use crate::figures::{figures, learning, spread};
use crate::seeds::Spread;
use crate::settle::write;
use crate::unit::{column, factor};
use crate::values::{EVALUATION, Numbers};
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
    /// The columns, by the names and with the digits that are shown.
    pub(crate) metrics: Vec<MetricOf>,
    /// In the order of the jobs.
    pub outcomes: Vec<Outcome>,
    /// Steps done of those that run.
    states: Vec<State>,
    /// What the finished ones found; nothing for others.
    pub(crate) numbers: Vec<Numbers>,
    /// What the finished ones minimise and maximise.
    pub(crate) losses: Losses,
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
        let finished = plan.jobs.iter().zip(&states).filter(|(_, state)| matches!(state, State::Finished));
        let config = |(job, _): (&Job, &State)| read_to_string(folder.join(&job.folder).join("config.toml")).ok();
        let configs: Vec<String> = finished.filter_map(config).collect();
        let losses = Losses::of(configs.iter().map(String::as_str));
        Self { plan: plan.clone(), metrics, outcomes, states, numbers, losses }
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
        let leads: Vec<Option<(&str, Spread)>> = (0..self.metrics.len()).map(|k| self.lead(k)).collect();
        for point in self.plan.names() {
            let [finished, failed] = ["finished", "failed"].map(|state| Cell::count(self.runs(point, state)));
            let mut cells = vec![Cell::text(point), finished, failed];
            for (k, metric) in self.metrics.iter().enumerate() {
                let own = self.spread(point, k);
                let mut text = with_deviation(Cell::number, own, metric.digits);
                if own.n > 0 && !self.is_whole(point, k) {
                    text.text += &format!(" (n = {})", own.n);
                }
                let best = leads[k].is_some_and(|(best, lead)| {
                    best == point && metric.better.is_some_and(|better| lead.is_beyond_noise(better))
                });
                cells.push(text.strong_if(best));
            }
            table.row(cells);
        }
        let several = self.plan.names().iter().any(|p| (0..self.metrics.len()).any(|k| self.spread(p, k).n > 1));
        let none = self.plan.names().iter().all(|p| (0..self.metrics.len()).all(|k| self.spread(p, k).n == 0));
        table.note = match several {
            true => "Mean over seeds ± standard deviation over seeds (n - 1).".into(),
            false if none => "No run has a value in this table.".into(),
            false => "At most one run per point: the spread over seeds is not known.".into(),
        };
        let marked = table.rows.iter().flatten().any(|cell| cell.strong);
        if marked {
            table.note += " Marked: the best of a column, where the 95 % interval of its difference from the next best, \
                           seed by seed, excludes 0.";
        } else if leads.iter().flatten().any(|(_, lead)| lead.n > 1) {
            table.note += " No best is marked: none differs from the next best by more than seeds do, as far as these \
                           seeds tell.";
        } else if leads.iter().flatten().next().is_some() {
            table.note +=
                " No best is marked: telling a difference from the noise of seeds takes two seeds of both points.";
        }
        if self.plan.sweep.evaluate && self.plan.sweep.metrics.is_empty() {
            table.note += " Columns are those of the last validation, as the sweep's file has no [[sweep.metrics]]: these name \
                           figures of the evaluations, too (`eval.json:`).";
        }
        if let Some(sentence) = self.valueless() {
            table.note += &format!(
                " n: runs in a mean, where others have no finite value: {sentence}; a point of such a mean is not marked as \
                 the best."
            );
        }
        if let Some(sentence) = self.not_comparable() {
            table.note += &format!(" No best is marked of what is not comparable between points: {sentence}.");
        }
        if let Some(sentence) = self.without_best() {
            table.note += &format!(" {sentence}.");
        }
        for sentence in self.mixed().into_iter().chain(self.retrained()) {
            table.note += &format!(" {}.", sentence.replacen('n', "N", 1));
        }
        let sets = self.plan.sweep.evaluation_sets();
        if !sets.is_empty() && self.metrics.iter().any(|metric| metric.of.starts_with(EVALUATION)) {
            table.note += &format!(" Settings of the evaluations that are not the runs': {}.", sets.join("; "));
        }
        for sentence in self.not_their_own() {
            table.note += &format!(" {}.", sentence.replacen('e', "E", 1));
        }
        table
    }

    /// Which columns lack finished runs of a point, as these have no finite value there.
    fn valueless(&self) -> Option<String> {
        let of = |(k, metric): (usize, &MetricOf)| {
            let partly = |point: &&str| !self.is_whole(point, k) && self.spread(point, k).n > 0;
            let points: Vec<&str> = self.plan.names().into_iter().filter(partly).collect();
            let own = self.outcomes.iter().filter(|o| o.state == "finished" && o.values[k].is_none());
            let own = own.filter(|o| points.contains(&o.point.as_str()));
            let own: Vec<String> = own.map(|o| format!("{}, seed {}", o.point, o.seed)).collect();
            (!own.is_empty()).then(|| format!("{} ({})", metric.head(), own.join("; ")))
        };
        let own: Vec<String> = self.metrics.iter().enumerate().filter_map(of).collect();
        (!own.is_empty()).then(|| own.join(", "))
    }

    /// Whether every finished run of a point has a value of a metric.
    fn is_whole(&self, point: &str, metric: usize) -> bool {
        self.spread(point, metric).n == self.runs(point, "finished")
    }

    /// Which runs were evaluated at their last step, as they have no best one.
    pub fn without_best(&self) -> Option<String> {
        let of = self.outcomes.iter().zip(&self.numbers).filter(|(_, numbers)| numbers.without_best);
        let runs: Vec<String> = of.map(|(o, _)| format!("{}, seed {}", o.point, o.seed)).collect();
        (!runs.is_empty()).then(|| {
            format!(
                "Evaluated at the last step, as no checkpoint was the best (guard.worse refused all, or what they are chosen \
                 by was never finite): {}",
                runs.join("; ")
            )
        })
    }

    /// The point that is first by a metric, and its difference from the next: the best where that is beyond the noise of
    /// seeds.
    fn lead(&self, metric: usize) -> Option<(&str, Spread)> {
        let better = self.metrics[metric].better.filter(|_| self.comparable(metric))?;
        let means = self.plan.names().into_iter().map(|point| (point, self.spread(point, metric).mean));
        let mut means: Vec<(&str, f64)> = means.filter(|(_, m)| m.is_finite()).collect();
        means.sort_by(|a, b| match better {
            Better::Higher => b.1.total_cmp(&a.1),
            Better::Lower => a.1.total_cmp(&b.1),
        });
        let [(best, _), (next, _), ..] = means[..] else { return None };
        // Runs without a value may be its worst, or those that tell how far runs differ.
        if ![best, next].iter().all(|point| self.is_whole(point, metric)) {
            return None;
        }
        Some((best, self.difference(best, next, metric)))
    }

    /// For each metric and other point the difference from the first point, seed by seed: its mean, its spread and its
    /// interval. `None` with a single point, and where no metric is comparable.
    pub fn differences(&self) -> Option<Table> {
        let names = self.plan.names();
        let (first, others) = names.split_first().filter(|(_, others)| !others.is_empty())?;
        let head = ["metric", "point", "difference", "95 % interval", "n"];
        let mut table = Table::new(format!("Differences from {first}, seed by seed"), &head);
        for (k, metric) in self.metrics.iter().enumerate().filter(|(k, _)| self.comparable(*k)) {
            if !table.rows.is_empty() {
                table.line();
            }
            for point in others {
                let (own, digits) = (self.difference(point, first, k), metric.digits);
                let (low, high) = own.interval;
                let interval = match low.is_finite() {
                    true => [low, high].map(|v| Cell::difference(v, digits).text).join(" .. "),
                    false => "–".into(),
                };
                let numbers = [with_deviation(Cell::difference, own, digits), Cell::none().with_text(interval)];
                let texts = [metric.head(), *point].map(Cell::text);
                table.row(texts.into_iter().chain(numbers).chain([Cell::count(own.n)]).collect());
            }
        }
        table.note = "Mean ± standard deviation over n seeds of a point's value minus the first point's, seed by seed. \
                      95 % interval: where the mean of many seeds lies, by Student's t over seeds; it needs at least two, \
                      and is wide with few. A difference whose interval excludes 0 is more than the noise of seeds; of \
                      many intervals one in twenty excludes 0 by chance."
            .into();
        if let Some(sentence) = self.not_comparable() {
            table.note += &format!(" Left out, as not comparable between points: {sentence}.");
        }
        (!table.rows.is_empty()).then_some(table)
    }

    /// What both tables show, a row a point and metric, each number in a column of its own with all digits.
    fn sheet(&self) -> Table {
        let head = [
            "point",
            "metric",
            "runs",
            "failed",
            "n",
            "mean",
            "sd",
            "difference from",
            "paired n",
            "difference",
            "difference sd",
            "95 % from",
            "95 % to",
        ];
        let mut table = Table::new("Points", &head);
        let names = self.plan.names();
        let digits = |v: f64| Cell::none().with_text(if v.is_finite() { v.to_string() } else { "–".into() });
        for point in &names {
            for (k, metric) in self.metrics.iter().enumerate() {
                let own = self.spread(point, k);
                let [finished, failed] = ["finished", "failed"].map(|state| Cell::count(self.runs(point, state)));
                let mut cells =
                    vec![Cell::text(*point), Cell::text(metric.head()), finished, failed, Cell::count(own.n)];
                cells.extend([own.mean, own.deviation].map(digits));
                match names.first().filter(|first| *first != point && self.comparable(k)) {
                    Some(first) => {
                        let apart = self.difference(point, first, k);
                        let (low, high) = apart.interval;
                        cells.extend([Cell::text(*first), Cell::count(apart.n)]);
                        cells.extend([apart.mean, apart.deviation, low, high].map(digits));
                    }
                    None => cells.extend([Cell::text(""), Cell::none()].into_iter().chain([f64::NAN; 4].map(digits))),
                }
                table.row(cells);
            }
        }
        table
    }

    /// How many runs of a point are in a state.
    fn runs(&self, point: &str, state: &str) -> usize {
        self.outcomes.iter().filter(|o| o.point == point && o.state == state).count()
    }

    /// A metric of a point over its finished runs, as it is shown.
    fn spread(&self, point: &str, metric: usize) -> Spread {
        let own = self.outcomes.iter().filter(|o| o.point == point && o.state == "finished");
        let factor = factor(&self.metrics[metric].of);
        Spread::of(&own.filter_map(|o| Some(factor * o.values[metric]?)).collect::<Vec<_>>())
    }

    /// What a point has more of a metric than another, over the seeds that both have.
    fn difference(&self, point: &str, other: &str, metric: usize) -> Spread {
        let factor = factor(&self.metrics[metric].of);
        let of = |p: &str, seed| self.outcomes.iter().find(|o| o.point == p && o.seed == seed)?.values[metric];
        let apart = |seed: &u64| of(point, *seed).zip(of(other, *seed)).map(|(a, b)| factor * (a - b));
        Spread::of(&self.plan.sweep.seeds.iter().filter_map(apart).collect::<Vec<_>>())
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

    /// Writes `results.jsonl`, which is the truth, and the tables as `table.md`, `table.tex` and `report.html`; in
    /// `table.csv` each number has a column of its own.
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
        write(&folder.join("table.csv"), &self.sheet().to_csv())?;
        let html = self.page(folder).to_html().map_err(|e| SweepError::Invalid(e.to_string()))?;
        write(&folder.join("report.html"), &html)
    }

    /// The report: tables, charts, and how to repeat the jobs, whose runs lie in the folder.
    pub fn page(&self, folder: &Path) -> Page {
        let mut tables: Vec<Table> = std::iter::once(self.table()).chain(self.differences()).collect();
        let mut blocks = Vec::new();
        if !self.plan.sweep.expected.is_empty() {
            blocks.push(Block::Text(format!("Expected: {}", self.plan.sweep.expected)));
        }
        // The question is the page's title already.
        tables[0].caption = "Points".into();
        blocks.extend(tables.into_iter().map(Block::Table));
        let (plan, outcomes) = (&self.plan, &self.outcomes);
        let means = |title: &str| match plan.sweep.seeds.len() {
            1 => title.to_owned(),
            _ => format!("{title}: means over seeds"),
        };
        for (title, pictures) in [
            (means("Figures"), figures(plan, outcomes, &self.numbers)),
            ("All seeds".into(), spread(plan, &self.metrics, outcomes)),
            (means("Learning"), learning(folder, plan, &self.metrics, outcomes)),
        ] {
            blocks.extend(pictures.into_iter().flat_map(|own| [Block::Heading(title.clone()), own]));
        }
        if self.outcomes.iter().any(|o| o.state != "finished") {
            blocks.push(Block::Table(self.status()));
        }
        blocks.push(Block::Heading("To repeat it".into()));
        let jobs = self.plan.jobs.iter().zip(&self.numbers).map(|(job, numbers)| self.commands(job, numbers));
        blocks.push(Block::Folded("Jobs".into(), jobs.collect::<Vec<_>>().join("\n")));
        let subtitle = format!(
            "{} {}: {} finished, {} failed",
            self.outcomes.len(),
            if self.outcomes.len() == 1 { "job" } else { "jobs" },
            self.count("finished"),
            self.count("failed")
        );
        let question = &self.plan.sweep.question;
        let title = if question.is_empty() { "Sweep".to_owned() } else { question.clone() };
        Page { kind: PageKind::Sweep, title, subtitle, blocks }
    }

    /// What trains a job by hand and, where the sweep does so, evaluates the run that this makes.
    fn commands(&self, job: &Job, numbers: &Numbers) -> String {
        let with = |words: &[&str], sets: &[String]| {
            let sets = sets.iter().flat_map(|set| ["--set", set.as_str()]);
            shell::command(words.iter().copied().chain(sets))
        };
        let train = format!("# {}, seed {}\n{}", job.point, job.seed, with(&["train", &job.base], &job.sets));
        let words: &[&str] =
            if numbers.without_best { &["eval", "RUN", "--checkpoint", "last"] } else { &["eval", "RUN"] };
        match self.plan.sweep.evaluate {
            true => format!("{train}\n{}", with(words, &self.plan.sweep.evaluation_sets())),
            false => train,
        }
    }
}

/// A mean as a cell, with its deviation where there is one.
fn with_deviation(cell: fn(f64, usize) -> Cell, own: Spread, digits: usize) -> Cell {
    let mean = cell(own.mean, digits);
    let text = format!("{} ± {:.digits$}", mean.text, own.deviation);
    if own.n > 1 { mean.with_text(text) } else { mean }
}

/// The columns: those asked for, or all that the finished runs' last validations have.
fn metrics(plan: &Plan, numbers: &[Numbers]) -> Vec<MetricOf> {
    if !plan.sweep.metrics.is_empty() {
        return plan.sweep.metrics.iter().cloned().map(column).collect();
    }
    let all = numbers.iter().flat_map(|n| n.last.keys()).filter(|n| n.starts_with("eval/"));
    all.collect::<BTreeSet<_>>().into_iter().map(|n| column(MetricOf::plain(n))).collect()
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
            let best = if k == 1 { "null" } else { "[1, 0.5]" };
            let eval = format!(
                "{{\"checkpoint\": {{\"best\": {best}}}, \"rows\": [{{\"k\": 4, \"iou\": {iou}}}, {{\"k\": 8, \"iou\": 0.9}}]}}"
            );
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
        let evaluated = "Evaluated at the last step, as no checkpoint was the best";
        assert!(table.note.contains(evaluated) && table.note.contains("finite): with, seed 2."), "{}", table.note);
        // Both have a run of seed 1 alone.
        assert!(!table.rows[0][3].strong && table.note.contains("takes two seeds of both points"), "{}", table.note);
        assert!(table.note.starts_with("Mean over seeds ±") && !table.note.contains("as far as"), "{}", table.note);
        let apart = results.differences().unwrap().rows.remove(0);
        assert_eq!(apart.iter().map(|c| c.text.as_str()).collect::<Vec<_>>(), ["IoU", "without", "-0.10", "–", "1"]);
        results.write(dir.path()).unwrap();
        let lines = std::fs::read_to_string(dir.path().join("results.jsonl")).unwrap();
        assert!(lines.contains("\"eval/iou@val\":0.5") && lines.contains("\"reason\":\"train: x\""), "{lines}");
        let html = std::fs::read_to_string(dir.path().join("report.html")).unwrap();
        assert!(html.contains("Does x help?") && html.contains("0.60 ± 0.14"));
        assert!(html.contains("riglab train b --set") && !html.contains("--set x="), "quoted for a shell");
        assert_eq!(html.matches("<circle").count(), 3 + 1, "a dot a finished run, and one in the key");
        assert!(html.contains("by k") && html.contains("<polyline"), "a line a point");
        assert!(std::fs::read_to_string(dir.path().join("table.md")).unwrap().contains("| 0.60 ± 0.14 |"));
        let csv = std::fs::read_to_string(dir.path().join("table.csv")).unwrap();
        let lines: Vec<&str> = csv.lines().collect();
        assert!(
            lines[0].starts_with("point,metric,runs,failed,n,mean,sd,difference from,paired n,difference,"),
            "{csv}"
        );
        assert!(lines[1].starts_with("with,IoU,2,0,2,0.6,0.1414") && lines[1].ends_with(",,,,,,"), "{csv}");
        assert!(lines[2].starts_with("without,IoU,1,1,1,0.4,,with,1,-0.0999"), "{csv}");
    }

    #[test]
    fn a_mean_of_fewer_runs_says_so_and_is_not_the_best() {
        let of = |b: [f64; 3]| {
            let dir = tempfile::tempdir().unwrap();
            let text = "[sweep]\nbase = 'b'\nseeds = [1, 2, 3]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\n\
                [[sweep.metrics]]\nof = 'eval/iou@val'\nname = 'IoU'\nbetter = 'higher'\n\
                [[sweep.figures]]\ntitle = 'by k'\nx = 'k'\nat = [4, 8]\nof = 'eval.json:rows[k={}].iou'\n";
            let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
            let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
            for (job, iou) in plan.jobs.iter().zip([0.1, 0.2, 0.3].into_iter().chain(b)) {
                let run = dir.path().join(&job.folder);
                std::fs::create_dir_all(&run).unwrap();
                // A value that is not finite is written as null.
                let line = serde_json::json!({"step": 1, "eval/iou@val": iou}).to_string() + "\n";
                std::fs::write(run.join("metrics.jsonl"), line).unwrap();
                std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
                let eval = serde_json::json!({"rows": [{"k": 4, "iou": 0.5}, {"k": 8, "iou": iou}]});
                std::fs::write(run.join("eval.json"), eval.to_string()).unwrap();
            }
            let results = Results::read(dir.path(), &plan);
            let (table, drawn) = (results.table(), figures(&plan, &results.outcomes, &results.numbers));
            let Some(Block::Charts(charts)) = drawn else { panic!("a figure is drawn") };
            let lines = charts[0].series.iter().map(|line| line.points.len()).collect::<Vec<_>>();
            let marked = table.rows[0][3].strong;
            (table.rows[1][3].clone(), table.note, lines, (results.gaps(), marked))
        };
        let (cell, note, lines, (gaps, _)) = of([0.5, 0.6, 0.7]);
        assert!(cell.strong && cell.text == "0.6000 ± 0.1000" && !note.contains("n:"), "{note}");
        assert_eq!((lines, gaps.len()), (vec![2, 2], 0));
        let (cell, note, lines, (gaps, _)) = of([0.5, f64::NAN, 0.6]);
        assert!(!cell.strong && cell.text == "0.5500 ± 0.0707 (n = 2)", "{}", cell.text);
        assert!(note.contains("no finite value: IoU (b, seed 2); a point") && !note.contains("none differs"), "{note}");
        // Nor is a place of a figure the mean of some.
        assert_eq!(lines, [2, 1]);
        assert_eq!(gaps, ["the figure `by k` leaves out 8 of `b`: not all of its finished runs have it"]);
        // Nor is a whole one the best beside it, whose runs that are left may differ alike from it.
        let marked = |b: [f64; 3]| of(b).3.1;
        assert!(marked([-0.9, -0.8, -0.7]) && !marked([-0.9, f64::NAN, -0.7]));
        // Where none has any there is no mean to tell of.
        let (cell, note, ..) = of([f64::NAN; 3]);
        assert!(cell.text == "–" && !note.contains("n:"), "{note}");
    }

    #[test]
    fn distances_are_shown_as_runs_show_them_and_kept_as_they_are() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\n\
            [[sweep.metrics]]\nof = 'eval/j2j@val'\nname = 'J2J, val'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        for (job, j2j) in plan.jobs.iter().zip([0.25, 0.75, 0.5, 1.0]) {
            let run = dir.path().join(&job.folder);
            std::fs::create_dir_all(&run).unwrap();
            std::fs::write(run.join("metrics.jsonl"), format!("{{\"step\":1,\"eval/j2j@val\":{j2j}}}\n")).unwrap();
            std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        }
        let results = Results::read(dir.path(), &plan);
        let table = results.table();
        assert_eq!((table.head[3].as_str(), table.rows[0][3].text.as_str()), ("J2J × 100, val", "50.00 ± 35.36"));
        assert_eq!(results.differences().unwrap().rows[0][2].text, "+25.00 ± 0.00");
        results.write(dir.path()).unwrap();
        let read = |name: &str| std::fs::read_to_string(dir.path().join(name)).unwrap();
        assert!(read("table.csv").contains("a,\"J2J × 100, val\",2,0,2,50,35.35"), "{}", read("table.csv"));
        assert!(read("results.jsonl").contains("{\"eval/j2j@val\":0.25}"));
    }

    #[test]
    fn a_sweep_that_evaluates_and_asks_for_nothing_of_it_says_how_to() {
        let note = |more: &str| {
            let text = format!("[sweep]\nbase = 'b'\nseeds = [1]\n{more}");
            let config = riglab_config::Config::from_toml_str("s.toml", &text).unwrap();
            let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
            Results::read(tempfile::tempdir().unwrap().path(), &plan).table().note
        };
        assert!(note("evaluate = true\n").contains("has no [[sweep.metrics]]"));
        for more in ["", "evaluate = true\n[[sweep.metrics]]\nof = 'eval/iou@val'\n"] {
            assert!(!note(more).contains("sweep.metrics"), "{more}");
        }
    }

    #[test]
    fn what_evaluations_were_made_with_stands_below_the_table_and_beside_the_jobs() {
        let dir = tempfile::tempdir().unwrap();
        let page = |evaluation: &str, best: &str| {
            let text = format!(
                "[sweep]\nbase = 'b'\nseeds = [1]\n{evaluation}\n[[sweep.metrics]]\nof = 'eval.json:iou'\nname = 'IoU'\n"
            );
            let config = riglab_config::Config::from_toml_str("s.toml", &text).unwrap();
            let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
            let run = dir.path().join(&plan.jobs[0].folder);
            std::fs::create_dir_all(&run).unwrap();
            std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
            let sets = serde_json::json!(plan.sweep.evaluation_sets());
            let eval = format!("{{\"checkpoint\": {{\"best\": {best}}}, \"set\": {sets}, \"iou\": 0.5}}");
            std::fs::write(run.join("eval.json"), eval).unwrap();
            let results = Results::read(dir.path(), &plan);
            let jobs = results.page(dir.path()).blocks.into_iter().find_map(|block| match block {
                Block::Folded(_, text) => Some(text),
                _ => None,
            });
            (results.table().note, jobs.unwrap())
        };
        let (note, jobs) = page("evaluate = true\nevaluate_with = { 'eval.x' = 8, 'data.test' = ['a b'] }", "[1, 0.5]");
        assert!(
            note.ends_with(" Settings of the evaluations that are not the runs': data.test=[\"a b\"]; eval.x=8."),
            "{note}"
        );
        let wanted = "riglab eval RUN --set 'data.test=[\"a b\"]' --set 'eval.x=8'";
        assert!(jobs.contains("riglab train b --set 'train.seed=1'\n") && jobs.ends_with(wanted), "{jobs}");
        let (note, jobs) = page("evaluate = true", "null");
        assert!(jobs.ends_with("\nriglab eval RUN --checkpoint last") && !note.contains("Settings of"), "{jobs}");
        assert!(page("", "[1, 0.5]").1.ends_with("riglab train b --set 'train.seed=1'"));
    }

    #[test]
    fn of_one_seed_nothing_is_said_about_seeds() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [0]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\n\
            [[sweep.metrics]]\nof = 'eval/iou@val'\nbetter = 'higher'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        for (job, iou) in plan.jobs.iter().zip([0.43, 0.14]) {
            let run = dir.path().join(&job.folder);
            std::fs::create_dir_all(&run).unwrap();
            std::fs::write(run.join("metrics.jsonl"), format!("{{\"step\":1,\"eval/iou@val\":{iou}}}\n")).unwrap();
            std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
        }
        assert_eq!(
            Results::read(dir.path(), &plan).table().note,
            "At most one run per point: the spread over seeds is not known. No best is marked: telling a difference \
             from the noise of seeds takes two seeds of both points."
        );
    }

    #[test]
    fn the_best_is_marked_where_seeds_alone_would_not_make_it_so() {
        let of = |a: [f64; 3], b: [f64; 3]| {
            let dir = tempfile::tempdir().unwrap();
            let text = "[sweep]\nbase = 'b'\nseeds = [1, 2, 3]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\n\
                [[sweep.metrics]]\nof = 'eval/l1@val'\nbetter = 'lower'\ndigits = 3\n";
            let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
            let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
            for (job, l1) in plan.jobs.iter().zip(a.into_iter().chain(b)).filter(|(_, l1)| l1.is_finite()) {
                let run = dir.path().join(&job.folder);
                std::fs::create_dir_all(&run).unwrap();
                std::fs::write(run.join("metrics.jsonl"), format!("{{\"step\":1,\"eval/l1@val\":{l1}}}\n")).unwrap();
                std::fs::write(run.join("run.json"), "{\"outcome\": \"finished\"}").unwrap();
            }
            let results = Results::read(dir.path(), &plan);
            let table = results.table();
            let strong = table.rows.iter().map(|row| row[3].strong).collect::<Vec<_>>();
            let apart = results.differences().unwrap().rows.remove(0);
            assert_eq!(table.note.contains("none differs from the next best"), !strong.contains(&true));
            (strong, apart.into_iter().skip(2).map(|c| c.text).collect::<Vec<_>>())
        };
        let (strong, apart) = of([0.1, 0.2, 0.3], [0.05, 0.151, 0.249]);
        assert_eq!(
            (strong, apart),
            (vec![false, true], ["-0.050 ± 0.001", "-0.052 .. -0.048", "3"].map(String::from).to_vec())
        );
        assert_eq!(of([0.1, 0.2, 0.3], [0.3, 0.1, 0.15]).0, [false, false]);
        // Better on the mean of its own seeds, and worse on those that both have.
        assert_eq!(of([0.3, 0.2, 0.9], [0.301, 0.2011, f64::NAN]).0, [false, false]);
        assert_eq!(of([0.1; 3], [0.09999; 3]).1[0], "0.000 ± 0.000", "no -0.000");
    }
}
