//! What a comparison found, as tables.

use std::sync::OnceLock;

use riglab_metric::statistics::{Mean, Paired};
use riglab_metric::{Preset, lower_is_better, trades};
use riglab_report::{Cell, Table};
use serde::Serialize;
use serde_json::{Value, json};

use crate::figures::{Figures, Judged, judged};
use crate::unit::{SAID, factor};
use crate::{Failures, Status, System, Unread};

/// Values that are no further apart than this are equal: what lies between them is rounding.
pub(crate) const EQUAL: f64 = 1e-9;

/// Said where baselines stand beside systems: an evaluation of a run has them under the same names.
const BASELINES: &str = " Baselines here may bind vertices to every joint of the true skeleton, as a system may; those of \
                         `riglab eval` are told which joints move something and are scored on these alone, and those \
                         through the body see it more coarsely (eval.baseline_resolution, by default 128 cells of its \
                         longest side; here 196), so that their figures differ a little.";

/// Systems over the same assets.
#[derive(Clone, Debug, Serialize)]
pub struct Comparison {
    /// The corpus or folder of true rigs.
    pub truth: String,
    /// How failures count.
    pub failures: Failures,
    /// True files that could not be read, with the reason: they are in no mean.
    pub unread_truth: Unread,
    /// The systems.
    pub systems: Vec<System>,
}

impl Comparison {
    /// What is made of its figures under some presets.
    pub fn summary<'a>(&'a self, presets: &'a [Preset]) -> Summary<'a> {
        let figures = Figures::of(&self.systems, presets);
        Summary { all: self, presets, figures, judged: OnceLock::new(), lines: OnceLock::new() }
    }

    /// What became of the assets, a row a system.
    pub fn counts(&self) -> Table {
        let head = ["system", "assets", "scored", "with weights", "failed", "missing", "predictions without truth"];
        let mut table = Table::new(format!("Assets of {}", self.truth), &head);
        for system in &self.systems {
            let [scored, failed, missing] = system.counts();
            let weights = |r: &&crate::Row| r.status == Status::Scored && r.without_weights.is_empty();
            let skinned = system.rows.iter().filter(weights).count();
            let counts = [system.rows.len(), scored, skinned, failed, missing, system.unmatched.len()];
            let cells = counts.map(Cell::count);
            table.row([vec![Cell::text(&system.name)], cells.to_vec()].concat());
        }
        table.note = match self.failures {
            Failures::Apart => "Means below are over the assets scored; failed and missing ones are counted only here.",
            Failures::Worst => {
                "Failed and missing assets count in the means as the worst case: shares as 0, weights as each vertex \
                 on one wrong bone, skeletons, for which there is no worst case, as one joint at the centre of the box \
                 (where a formula needs a bone, one of almost no length); the note below a table says which metrics \
                 leave them out. So does each figure that a prediction leaves undefined: those of bones where it has \
                 one joint, those of weights where it has other joints than the truth."
            }
        }
        .into();
        if self.systems.iter().any(|system| system.baseline) {
            table.note += BASELINES;
        }
        table
    }

    /// Everything of one system or two.
    fn whole_of(&self, preset: Preset, lines: &[&Line]) -> Table {
        let mut head = vec![format!("metric @{}", preset.name()), "better".into()];
        for system in &self.systems {
            head.extend([system.name.clone(), "95 % interval".into(), "n".into()]);
        }
        let pair = self.systems.len() == 2;
        if pair {
            head.extend(["difference".into(), "95 % interval".into(), "p".into()]);
        }
        let mut table = Table { caption: format!("Convention {}", preset.name()), head, ..Table::default() };
        for line in lines {
            let mut cells = line.named().to_vec();
            for (m, best) in line.means.iter().zip(&line.best) {
                cells.extend([number(m.mean).strong_if(*best), interval(m.low, m.high), Cell::count(m.n)]);
            }
            if let Some(p) = line.pair {
                cells.extend([number(p.difference), interval(p.low, p.high), number(p.p)]);
            }
            table.row(cells);
        }
        table
    }
}

/// A comparison under some presets: what all forms of it share is computed once, when it is first asked for.
pub struct Summary<'a> {
    all: &'a Comparison,
    presets: &'a [Preset],
    figures: Figures,
    /// A metric each, as the presets print them.
    judged: OnceLock<Vec<Judged>>,
    /// A metric each, in the units of tables.
    lines: OnceLock<Vec<Line>>,
}

impl Summary<'_> {
    /// The means of each preset, a row a metric. Of one system or two they stand in a table with their 95 % intervals and the
    /// assets that they are of; of two also the difference. Of more systems means and intervals have a table each, a column
    /// a system.
    pub fn tables(&self) -> Vec<Table> {
        let mut tables = Vec::new();
        let mut said = false;
        for preset in self.presets {
            let lines: Vec<&Line> =
                self.lines().iter().filter(|line| self.figures.preset(line.at) == *preset).collect();
            if lines.is_empty() {
                continue;
            }
            let several = self.all.systems.len() > 2;
            let mut table =
                if several { self.all.means_of(*preset, &lines) } else { self.all.whole_of(*preset, &lines) };
            let mut notes = Vec::new();
            // Once: it is the same in every convention.
            if !said && lines.iter().any(|line| factor(&line.name).is_some()) {
                notes.push(SAID.to_owned());
                said = true;
            }
            if let [a, b] = &self.all.systems[..] {
                notes.push(format!(
                    "difference: mean of {} - {} over assets where both are defined; p: share of sign flips over \
                     assets that give a mean at least as far from 0",
                    a.name, b.name
                ));
            }
            let without = self.without_failures(&lines);
            if !without.is_empty() {
                notes.push(format!("Without failed and missing assets: {}", without.join(", ")));
            }
            notes.extend(self.marked(&lines));
            if several {
                notes.push(Line::COUNTS.to_owned());
            }
            table.note = notes.join(". ");
            tables.push(table);
            if several {
                tables.push(self.all.intervals_of(*preset, &lines));
            }
        }
        tables
    }

    /// Metrics that have no value for a failure, though failures are to count.
    fn without_failures<'l>(&self, lines: &[&'l Line]) -> Vec<&'l str> {
        if self.all.failures != Failures::Worst {
            return Vec::new();
        }
        let systems = self.all.systems.iter().enumerate();
        let failures = systems.flat_map(|(system, s)| {
            let failed = s.rows.iter().enumerate().filter(|(_, row)| row.status != Status::Scored);
            failed.map(move |(asset, _)| (system, asset))
        });
        let failures: Vec<(usize, usize)> = failures.collect();
        let lacks = |line: &&&Line| {
            let values = self.figures.values(line.at);
            let has = |system: usize, asset: usize| values[system].get(asset).is_some_and(|v| v.is_finite());
            // What no system has of an asset is not there to be had, as clips that it lacks.
            let is_there = |asset: usize| (0..values.len()).any(|system| has(system, asset));
            !failures.is_empty()
                && (failures.iter().any(|&(system, asset)| !has(system, asset) && is_there(asset))
                    || failures.iter().all(|&(system, asset)| !has(system, asset)))
        };
        lines.iter().filter(lacks).map(|line| line.metric()).collect()
    }

    /// Which means are marked, and why some are not; nothing of a single system.
    fn marked(&self, lines: &[&Line]) -> Option<String> {
        if self.all.systems.len() < 2 {
            return None;
        }
        let judged = || lines.iter().filter(|line| is_judged(&line.name));
        let apart: Vec<&str> = judged().filter(|line| line.over == Over::Different).map(|line| line.metric()).collect();
        let any = judged().any(|line| line.over == Over::Same);
        let traded = any && lines.iter().any(|line| trades(&line.name));
        let marked = match (any, apart.is_empty()) {
            (true, true) => Some("Marked: the better mean, where several systems have one".into()),
            (true, false) => Some(format!(
                "Marked: the better mean, where the systems are scored on the same assets; they are not for {}",
                apart.join(", ")
            )),
            (false, false) => {
                let advice = match self.all.failures {
                    Failures::Apart => "; compare with `--failures worst`, which counts every asset",
                    Failures::Worst => "",
                };
                Some(format!(
                    "No mean is marked as the better one: the systems are scored on different assets (see n){advice}"
                ))
            }
            (false, true) => None,
        };
        let but =
            if traded { "; none of precision, recall, covered masks, as each rises when another falls" } else { "" };
        marked.map(|marked| marked + but)
    }

    fn judged(&self) -> &[Judged] {
        self.judged.get_or_init(|| {
            let all: Vec<&[Vec<f64>]> = (0..self.figures.len()).map(|at| self.figures.values(at)).collect();
            judged(&all)
        })
    }

    fn lines(&self) -> &[Line] {
        self.lines.get_or_init(|| {
            let names: Vec<String> = (0..self.figures.len()).map(|at| self.figures.name(at)).collect();
            // Means of numbers in another unit are other numbers in their last digits.
            let in_unit: Vec<(usize, f64)> =
                names.iter().enumerate().filter_map(|(at, name)| Some((at, factor(name)?))).collect();
            let scaled = |&(at, factor): &(usize, f64)| {
                let of = |values: &Vec<f64>| values.iter().map(|v| factor * v).collect();
                self.figures.values(at).iter().map(of).collect()
            };
            let scaled: Vec<Vec<Vec<f64>>> = in_unit.iter().map(scaled).collect();
            let mut all = self.judged().to_vec();
            let shown = judged(&scaled.iter().map(Vec::as_slice).collect::<Vec<_>>());
            in_unit.iter().zip(shown).for_each(|((at, _), shown)| all[*at] = shown);
            names.into_iter().zip(all).enumerate().map(|(at, (name, of))| self.line(at, name, of)).collect()
        })
    }

    fn line(&self, at: usize, name: String, Judged { means, pair }: Judged) -> Line {
        let lower = lower_is_better(&name);
        let over = Over::of(self.figures.values(at));
        let comparable = is_judged(&name) && over == Over::Same;
        // One that failed everywhere is the better one in nothing, whatever a failure counts.
        let found = self.all.systems.iter().map(|s| s.rows.iter().any(|r| r.status == Status::Scored));
        let found: Vec<bool> = found.collect();
        let defined = || means.iter().zip(&found).filter(|(o, _)| o.mean.is_finite());
        let others = defined().filter(|(_, found)| **found).map(|(o, _)| o.mean);
        let best = if lower == Some(true) { others.reduce(f64::min) } else { others.reduce(f64::max) };
        // Where all are equal none is the better one.
        let near = |a: f64| best.is_some_and(|best| (a - best).abs() <= EQUAL);
        let differ = defined().any(|(o, _)| !near(o.mean));
        let best = |(m, found): (&Mean, &bool)| comparable && *found && differ && near(m.mean);
        let best = means.iter().zip(&found).map(best).collect();
        Line { at, name, means, best, over, pair }
    }

    /// A row an asset and system, with all figures; with all their digits and as the presets print them, if `whole`.
    pub fn assets(&self, whole: bool) -> Table {
        let names: Vec<String> = (0..self.figures.len()).map(|at| self.figures.name(at)).collect();
        let factors: Vec<Option<f64>> = names.iter().map(|name| factor(name)).collect();
        let mut head: Vec<String> = ["system", "asset", "status", "joints", "true joints"].map(String::from).to_vec();
        head.extend(names.iter().map(|name| if whole { name.clone() } else { headed(name, name) }));
        // Sentences come last: figures stay beside the asset that they are of.
        head.push("notes".into());
        let mut table = Table { caption: "Assets".into(), head, ..Table::default() };
        if !whole && factors.iter().any(Option::is_some) {
            table.note = format!("{SAID}.");
        }
        for (k, system) in self.all.systems.iter().enumerate() {
            for (asset, row) in system.rows.iter().enumerate() {
                let (status, reason) = match &row.status {
                    Status::Scored => ("scored", row.without_weights.clone()),
                    Status::Failed(reason) => ("failed", reason.clone()),
                    Status::Missing => ("missing", String::new()),
                };
                let told = std::iter::once(reason).chain(row.notes.iter().cloned()).filter(|s| !s.is_empty());
                let mut cells = vec![
                    Cell::text(&system.name),
                    Cell::text(&row.asset),
                    Cell::text(status),
                    Cell::count(row.joints),
                    Cell::count(row.true_joints),
                ];
                let cell = |value: f64| match whole && value.is_finite() {
                    true => number(value).with_text(value.to_string()),
                    false => number(value),
                };
                let scale = |factor: &Option<f64>| if whole { 1.0 } else { factor.unwrap_or(1.0) };
                let values = factors.iter().enumerate().map(|(at, f)| scale(f) * self.figures.values(at)[k][asset]);
                cells.extend(values.map(cell));
                cells.push(Cell::text(told.collect::<Vec<_>>().join("; ")));
                table.row(cells);
            }
        }
        table
    }

    /// Everything: rows, means, and the differences of two systems.
    pub fn to_json(&self) -> Value {
        let judged = self.judged();
        let by_name = |of: &dyn Fn(&Judged) -> Value| -> serde_json::Map<String, Value> {
            judged.iter().enumerate().map(|(at, own)| (self.figures.name(at), of(own))).collect()
        };
        let means = |(k, s): (usize, &System)| json!({"system": s.name, "means": by_name(&|own| json!(own.means[k]))});
        let mut out = json!(self.all);
        out["means"] = self.all.systems.iter().enumerate().map(means).collect();
        if self.all.systems.len() == 2 {
            out["paired"] = by_name(&|own| json!(own.pair)).into();
        }
        out
    }
}

/// A metric of all systems.
pub(crate) struct Line {
    /// Its place among the figures.
    at: usize,
    name: String,
    /// In the unit of tables, as all here.
    pub means: Vec<Mean>,
    /// Which of them are marked.
    pub best: Vec<bool>,
    over: Over,
    /// The first of two systems against the second.
    pair: Option<Paired>,
}

impl Line {
    /// What the metric is called, and which of its values are better.
    pub fn named(&self) -> [Cell; 2] {
        let arrow = match lower_is_better(&self.name) {
            Some(true) => "lower",
            Some(false) => "higher",
            None => "",
        };
        [Cell::text(headed(self.metric(), &self.name)), Cell::text(arrow)]
    }

    /// Its name without that of the preset.
    fn metric(&self) -> &str {
        self.name.split('@').next().unwrap_or(&self.name)
    }
}

/// What the means of a metric are over. A system that fails on what is hard has an easy mean: none is the better one
/// then.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Over {
    /// At most one system has a figure.
    One,
    /// All systems that have figures have them for the same assets.
    Same,
    /// They have figures for different assets.
    Different,
}

impl Over {
    /// Of a value an asset, a list a system.
    fn of(values: &[Vec<f64>]) -> Self {
        let defined = values.iter().map(|v| v.iter().map(|x| x.is_finite()).collect::<Vec<_>>());
        let with: Vec<Vec<bool>> = defined.filter(|own| own.contains(&true)).collect();
        match &with[..] {
            [] | [_] => Self::One,
            [first, others @ ..] if others.iter().all(|own| own == first) => Self::Same,
            _ => Self::Different,
        }
    }
}

/// Whether a metric tells which of several systems is the better one.
fn is_judged(name: &str) -> bool {
    lower_is_better(name).is_some() && !trades(name)
}

/// What stands for a metric, with its unit.
fn headed(text: &str, name: &str) -> String {
    if factor(name).is_some() { format!("{text} × 100") } else { text.into() }
}

pub(crate) fn number(value: f64) -> Cell {
    Cell::number(value, 0).with_text(shown(value))
}

fn interval(low: f64, high: f64) -> Cell {
    let text = if low.is_finite() { format!("{} .. {}", shown(low), shown(high)) } else { "–".into() };
    Cell::none().with_text(text)
}

/// Four digits that count; powers of ten below a thousandth. What is smaller than rounding is 0.
fn shown(value: f64) -> String {
    match value.abs() {
        a if !a.is_finite() => "–".into(),
        a if a < EQUAL => "0".into(),
        a if a < 1e-3 => format!("{value:.2e}"),
        a if a < 1.0 => format!("{value:.4}"),
        a if a < 10.0 => format!("{value:.3}"),
        a if a < 100.0 => format!("{value:.2}"),
        _ => format!("{value:.1}"),
    }
}

#[cfg(test)]
mod tests {
    use riglab_metric::Measure;

    use super::*;
    use crate::Row;

    fn system(name: &str, values: &[Option<f64>]) -> System {
        let row = |(k, value): (usize, &Option<f64>)| Row {
            asset: format!("a{k}"),
            status: if value.is_some() { Status::Scored } else { Status::Missing },
            joints: 3,
            true_joints: 3,
            without_weights: String::new(),
            notes: Vec::new(),
            measures: value.map(|value| Measure { metric: "j2j", preset: Preset::Rignet, value }).into_iter().collect(),
        };
        System {
            name: name.into(),
            folder: name.into(),
            baseline: false,
            rows: values.iter().enumerate().map(row).collect(),
            unmatched: Vec::new(),
            unread: Vec::new(),
        }
    }

    #[test]
    fn missing_assets_are_counted_and_win_nothing() {
        let comparison = Comparison {
            truth: "t".into(),
            failures: Failures::Apart,
            unread_truth: Vec::new(),
            systems: vec![
                system("one", &[Some(0.1), Some(0.2), None]),
                system("two", &[Some(0.3), Some(f64::NAN), Some(0.5)]),
            ],
        };
        let tables = comparison.summary(&Preset::ALL).tables();
        assert_eq!(tables.len(), 1);
        let cells = &tables[0].rows[0];
        let texts: Vec<&str> = cells.iter().map(|c| c.text.as_str()).collect();
        assert_eq!((texts[0], texts[2], texts[4], texts[5], texts[7]), ("j2j × 100", "15.00", "2", "40.00", "2"));
        assert!(!cells[2].strong && !cells[5].strong, "they are over different assets");
        assert!(tables[0].note.contains("No mean is marked") && tables[0].note.contains("--failures worst"));
        // It is no advice to who did so.
        let worst = Comparison { failures: Failures::Worst, ..comparison.clone() }
            .summary(&Preset::ALL)
            .tables()
            .remove(0)
            .note;
        assert!(worst.contains("No mean is marked") && !worst.contains("--failures"), "{worst}");
        // Both are defined on the first asset alone.
        assert_eq!(texts[8], "-20.00");
        assert_eq!(comparison.counts().rows[0][5].text, "1");
        let json = comparison.summary(&Preset::ALL).to_json();
        assert_eq!(
            (json["paired"]["j2j@rignet"]["n"].as_u64(), json["means"][0]["means"]["j2j@rignet"]["n"].as_u64()),
            (Some(1), Some(2))
        );
        assert_eq!(json["systems"][1]["rows"][1]["measures"]["j2j@rignet"], Value::Null);
        // A program reads what the preset prints.
        assert_eq!(json["systems"][0]["rows"][0]["measures"]["j2j@rignet"], 0.1);
        let of = |whole| {
            let assets = comparison.summary(&Preset::ALL).assets(whole);
            assert_eq!(assets.head.last().map(String::as_str), Some("notes"));
            (assets.head[5].clone(), assets.rows[0][5].text.clone(), assets.note)
        };
        assert_eq!(of(true), ("j2j@rignet".into(), "0.1".into(), String::new()));
        assert_eq!(of(false), ("j2j@rignet × 100".into(), "10.00".into(), format!("{SAID}.")));
        assert!(tables[0].note.starts_with(SAID));
    }

    #[test]
    fn a_mean_is_better_than_another_over_the_same_assets_alone() {
        let of = |systems: &[&[Option<f64>]]| {
            let systems = systems.iter().enumerate().map(|(k, values)| system(&format!("s{k}"), values)).collect();
            let all = Comparison { truth: "t".into(), failures: Failures::Apart, unread_truth: Vec::new(), systems };
            let table = all.summary(&Preset::ALL).tables().remove(0);
            let apart = if all.systems.len() > 2 { 1 } else { 3 };
            let means = table.rows[0].iter().skip(2).step_by(apart).take(all.systems.len());
            (means.map(|c| c.strong).collect::<Vec<bool>>(), table.note)
        };
        let (two, some) = ([Some(0.1), Some(0.2)], [Some(0.3), Some(0.1)]);
        let (strong, note) = of(&[&two, &some]);
        assert_eq!(strong, [true, false]);
        assert!(note.ends_with("Marked: the better mean, where several systems have one"), "{note}");
        assert_eq!(of(&[&two, &[None, Some(f64::NAN)]]).0, [false, false], "the only one with figures is not the best");
        assert_eq!(of(&[&two, &some, &[None, Some(0.01)]]).0, [false; 3], "the third has the easy asset alone");
        assert_eq!(of(&[&two]), (vec![false], SAID.to_owned()));
    }

    #[test]
    fn what_differs_by_rounding_alone_has_no_best() {
        let strong = |means: [f64; 3]| {
            let named = |(k, mean): (usize, &f64)| system(&format!("s{k}"), &[Some(*mean)]);
            let systems = means.iter().enumerate().map(named).collect();
            let all = Comparison { truth: "t".into(), failures: Failures::Apart, unread_truth: Vec::new(), systems };
            let table = all.summary(&Preset::ALL).tables().remove(0);
            [2, 3, 4].map(|column| table.rows[0][column].strong)
        };
        assert_eq!(strong([0.0, 3.8e-17, -1e-13]), [false; 3]);
        assert_eq!(strong([0.1, 0.1 + 1e-13, 0.2]), [true, true, false]);
        assert_eq!(strong([0.1, 0.1 + 1e-8, 0.2]), [true, false, false]);
    }

    #[test]
    fn baselines_are_told_to_differ_from_those_of_evaluations() {
        let of = |baseline| {
            let systems = vec![System { baseline, ..system("nearest bone", &[Some(0.1)]) }];
            let all = Comparison { truth: "t".into(), failures: Failures::Apart, unread_truth: Vec::new(), systems };
            all.counts().note.contains("`riglab eval`")
        };
        assert!(of(true) && !of(false));
    }

    #[test]
    fn a_system_that_failed_everywhere_is_the_best_in_nothing() {
        let mut failed = system("none", &[Some(0.1), Some(0.2)]);
        failed.rows.iter_mut().for_each(|row| row.status = Status::Missing);
        let systems = vec![system("one", &[Some(0.3), Some(0.4)]), failed];
        let all = Comparison { truth: "t".into(), failures: Failures::Worst, unread_truth: Vec::new(), systems };
        let table = all.summary(&Preset::ALL).tables().remove(0);
        assert!(table.rows[0][2].strong && !table.rows[0][5].strong);
    }

    #[test]
    fn none_is_the_best_by_precision_or_recall_alone() {
        let of = |metric: &'static str| {
            let mut systems = vec![system("one", &[Some(0.1)]), system("two", &[Some(0.2)])];
            let measures = systems.iter_mut().flat_map(|s| &mut s.rows).flat_map(|r| &mut r.measures);
            let (mut iou, preset) = (Vec::new(), Preset::Skintokens);
            for m in measures {
                (m.metric, m.preset) = (metric, preset);
                iou.push(m.value);
            }
            for (system, value) in systems.iter_mut().zip(iou) {
                system.rows[0].measures.push(Measure { metric: "iou", preset, value });
            }
            let all = Comparison { truth: "t".into(), failures: Failures::Apart, unread_truth: Vec::new(), systems };
            let table = all.summary(&Preset::ALL).tables().remove(0);
            let strong: Vec<bool> = table.rows.iter().flatten().filter(|c| c.strong).map(|c| c.number).collect();
            (strong.len(), table.rows[0][1].text.clone(), table.note)
        };
        for metric in ["precision", "recall", "joint_recall", "mask_cover_bone"] {
            let (strong, better, note) = of(metric);
            assert_eq!((strong, better.as_str()), (1, "higher"), "{metric}: IoU alone is marked");
            assert!(note.ends_with("none of precision, recall, covered masks, as each rises when another falls"));
        }
        let (strong, _, note) = of("l1");
        assert!(strong == 2 && note.ends_with("where several systems have one"), "{note}");
    }

    #[test]
    fn metrics_that_leave_failures_out_are_named() {
        let of = |failures| {
            let systems = vec![system("one", &[Some(0.1), None])];
            Comparison { truth: "t".into(), failures, unread_truth: Vec::new(), systems }
        };
        let note = |failures| of(failures).summary(&Preset::ALL).tables()[0].note.clone();
        assert_eq!(note(Failures::Worst), format!("{SAID}. Without failed and missing assets: j2j"));
        // Of two failures one has it, and of the other no system has: the asset has no such thing.
        let mut other = system("two", &[Some(0.3), None, Some(0.2)]);
        other.rows[2].status = Status::Missing;
        let systems = vec![system("one", &[Some(0.1), None, Some(0.4)]), other];
        let both = Comparison { systems, ..of(Failures::Worst) };
        assert!(
            !both.summary(&Preset::ALL).tables()[0].note.contains("Without"),
            "{}",
            both.summary(&Preset::ALL).tables()[0].note
        );
        assert_eq!(note(Failures::Apart), SAID);
    }

    #[test]
    fn numbers_have_four_digits_that_count() {
        assert_eq!(
            [0.0, -3.83e-17, 1.2e-9, 4.83e-5, 0.15, 2.857, 12.3456, 512.34].map(shown),
            ["0", "0", "1.20e-9", "4.83e-5", "0.1500", "2.857", "12.35", "512.3"]
        );
    }
}
