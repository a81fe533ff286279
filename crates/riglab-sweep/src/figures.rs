//! A sweep's pictures: the seeds of each point beside each other, numbers over a number, and curves of learning.

use std::collections::BTreeMap;
use std::path::Path;

use riglab_metric::statistics::Mean;
use riglab_report::{Block, By, Chart, Dots, Losses, RunView, Series, figure_name, in_unit};

use crate::unit::{column, factor, named};
use crate::values::Numbers;
use crate::{FigureOf, MetricOf, Outcome, Plan};

/// Names whose curves are drawn at most.
const CURVES: usize = 16;

/// For each column of the table the values of all seeds, a line a point.
pub(crate) fn spread(plan: &Plan, metrics: &[MetricOf], outcomes: &[Outcome]) -> Option<Block> {
    let names = plan.names();
    let of = |(k, metric): (usize, &MetricOf)| {
        let factor = factor(&metric.of);
        let own = |p: &str| -> (Vec<f64>, Vec<String>) {
            let of = outcomes.iter().filter(|o| o.point == p);
            of.filter_map(|o| Some((factor * o.values[k]?, o.seed.to_string()))).unzip()
        };
        let own = names.iter().map(|p| ((*p).to_owned(), own(p)));
        let (lines, of): (Vec<_>, Vec<_>) = own.map(|(name, (own, seeds))| ((name, own), seeds)).unzip();
        let found = lines.iter().map(|(_, own)| own.len()).sum::<usize>();
        let by = Some(By { name: "seed".into(), of });
        (found > 1).then(|| Dots { title: metric.head().into(), lines, digits: metric.digits, by })
    };
    let dots: Vec<Dots> = metrics.iter().enumerate().filter_map(of).collect();
    (!dots.is_empty()).then_some(Block::Dots(dots))
}

/// The figures that the sweep's file asks for, a line a point, each place the mean over seeds, of all finished ones: where
/// one is missing, others would bend the line.
pub(crate) fn figures(plan: &Plan, outcomes: &[Outcome], numbers: &[Numbers]) -> Option<Block> {
    let chart = |figure: &FigureOf| {
        let line = |point: &str| {
            let both = outcomes.iter().zip(numbers).filter(|(o, _)| o.point == point && o.state == "finished");
            let runs: Vec<&Numbers> = both.map(|(_, numbers)| numbers).collect();
            let mean = |(x, of): (&f64, String)| {
                let own: Vec<f64> = runs.iter().filter_map(|run| run.value(&of)).filter(|v| v.is_finite()).collect();
                (!own.is_empty() && own.len() == runs.len()).then(|| (*x, factor(&of) * Mean::of(&own).mean))
            };
            let points: Vec<_> = figure.at.iter().zip(figure.places()).filter_map(mean).collect();
            (!points.is_empty()).then(|| Series { name: point.into(), points })
        };
        let series: Vec<Series> = plan.names().into_iter().filter_map(line).collect();
        (!series.is_empty()).then(|| Chart {
            title: named(&figure.title, &figure.of),
            x: figure.x.clone(),
            series,
            ..Chart::default()
        })
    };
    let charts: Vec<Chart> = plan.sweep.figures.iter().filter_map(chart).collect();
    (!charts.is_empty()).then_some(Block::Charts(charts))
}

/// The loss and what was validated over steps, a line a point, each place the mean over seeds; the parts of the loss, too,
/// where points weight them otherwise.
pub(crate) fn learning(folder: &Path, plan: &Plan, metrics: &[MetricOf], outcomes: &[Outcome]) -> Option<Block> {
    let mut of: BTreeMap<String, Vec<Series>> = BTreeMap::new();
    let read = |point: &str| -> Vec<RunView> {
        finished(folder, plan, outcomes, point).iter().filter_map(|run| RunView::read(run).ok()).collect()
    };
    let points: Vec<(&str, Vec<RunView>)> = plan.names().into_iter().map(|point| (point, read(point))).collect();
    let losses = Losses::of(points.iter().flat_map(|(_, views)| views).map(RunView::config));
    for (point, views) in &points {
        let logs: Vec<_> = views.iter().map(RunView::logged).collect();
        let Some(first) = logs.first() else { continue };
        for name in first.keys().filter(|n| **n == "train/loss" || n.starts_with("eval/") || losses.replaces(n)) {
            // Means of the same seeds at each place: a step that one of them has not would bend the line.
            let mut at: BTreeMap<u64, Vec<f64>> = BTreeMap::new();
            let own = logs.iter().filter_map(|l| l.get(name)).flatten();
            own.for_each(|(step, v)| at.entry(*step as u64).or_default().push(*v));
            let whole = at.into_iter().filter(|(_, own)| own.len() == logs.len());
            let points: Vec<_> = whole.map(|(step, own)| (step as f64, Mean::of(&own).mean)).collect();
            if !points.is_empty() {
                of.entry((*name).to_owned()).or_default().push(Series { name: (*point).into(), points });
            }
        }
    }
    let asked = |name: &str| metrics.iter().any(|m| m.of == name);
    let mut names: Vec<String> = of.keys().cloned().collect();
    // The loss first, with its parts, then the table's columns.
    names.sort_by_key(|n| (n != "train/loss", !losses.replaces(n), !asked(n)));
    names.truncate(CURVES + names.iter().filter(|n| losses.replaces(n)).count());
    let chart = |name: String| {
        let series = of.remove(&name).unwrap_or_default();
        let (log, note) = (name == "train/loss", losses.note(&name));
        // In the unit of the runs' own curves, which have the same title.
        let (title, factor) = in_unit(&name);
        let scaled =
            |line: Series| Series { points: line.points.iter().map(|(x, y)| (*x, factor * y)).collect(), ..line };
        let series = series.into_iter().map(scaled).collect();
        Chart { title, x: "step".into(), series, log, note, ..Chart::default() }
    };
    let charts: Vec<Chart> = names.into_iter().map(chart).collect();
    (!charts.is_empty()).then_some(Block::Charts(charts))
}

/// Whether a chart of a sweep's report may get this name as a file ([`riglab_report::Figure::name`]), as far as that can be
/// told before a job has run: what is logged is not known then, but how its name begins.
pub fn may_be_called(plan: &Plan, name: &str) -> bool {
    let figures = plan.sweep.figures.iter().map(|f| figure_name(&named(&f.title, &f.of)));
    let columns = plan.sweep.metrics.iter().cloned().map(column);
    let known: Vec<String> = figures.chain(columns.map(|m| figure_name(m.head()) + "-dots")).collect();
    known.iter().any(|k| k == name) || ["train-", "eval-"].iter().any(|logged| name.starts_with(logged))
}

/// Folders of a point's finished runs.
fn finished(folder: &Path, plan: &Plan, outcomes: &[Outcome], point: &str) -> Vec<std::path::PathBuf> {
    let both = plan.jobs.iter().zip(outcomes);
    both.filter(|(j, o)| j.point == point && o.state == "finished").map(|(j, _)| folder.join(&j.folder)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_are_means_where_all_seeds_are() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2]\n[[sweep.metrics]]\nof = 'eval/z@val'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let logs = [
            "{\"step\":1,\"eval/a@val\":4.0,\"eval/j2j@val\":0.25,\"eval/z@val\":1.0,\"train/loss\":2.0}\n{\"step\":2,\"eval/z@val\":3.0}\n",
            "{\"step\":1,\"eval/a@val\":6.0,\"eval/j2j@val\":0.5,\"eval/z@val\":2.0,\"train/loss\":4.0}\n",
        ];
        for (job, log) in plan.jobs.iter().zip(logs) {
            let run = dir.path().join(&job.folder);
            std::fs::create_dir_all(&run).unwrap();
            std::fs::write(run.join("metrics.jsonl"), log).unwrap();
            std::fs::write(run.join("config.toml"), "").unwrap();
            std::fs::write(run.join("run.json"), "{\"task\": \"fsq_cvae\", \"outcome\": \"finished\"}").unwrap();
        }
        let results = crate::Results::read(dir.path(), &plan);
        let Some(Block::Charts(charts)) = learning(dir.path(), &plan, &plan.sweep.metrics, &results.outcomes) else {
            panic!("charts are drawn")
        };
        let titles: Vec<&str> = charts.iter().map(|c| c.title.as_str()).collect();
        let wanted = ["train/loss", "eval/z@val", "eval/a@val", "eval/j2j × 100@val"];
        assert_eq!(titles, wanted, "the loss, then what was asked for");
        assert_eq!(charts[1].series[0].points, [(1.0, 1.5)], "step 2 has one seed alone");
        assert_eq!(charts[3].series[0].points, [(1.0, 37.5)], "as the curves of runs");
        assert!(figures(&plan, &results.outcomes, &results.numbers).is_none(), "none was asked for");
        let Some(Block::Dots(dots)) = spread(&plan, &plan.sweep.metrics, &results.outcomes) else {
            panic!("dots are drawn")
        };
        assert_eq!(dots[0].lines[0].1, [3.0, 2.0]);
        assert_eq!(dots[0].by, Some(By { name: "seed".into(), of: vec![vec!["1".into(), "2".into()]] }));
    }

    #[test]
    fn totals_of_other_weights_come_with_their_parts_and_a_word() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1]\n[[sweep.arms]]\nname = 'low'\nset = { 'loss.dice' = 0.5 }\n\
                    [[sweep.arms]]\nname = 'high'\nset = { 'loss.dice' = 2.0 }\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        for (job, dice) in plan.jobs.iter().zip(["0.5", "2.0"]) {
            let run = dir.path().join(&job.folder);
            std::fs::create_dir_all(&run).unwrap();
            let evals: String = (0..2 * CURVES).map(|k| format!(",\"eval/m{k}@val\":1.0")).collect();
            let line = format!("{{\"step\":1,\"train/loss\":2.0,\"train/dice\":0.5,\"train/bce\":0.25{evals}}}\n");
            std::fs::write(run.join("metrics.jsonl"), line).unwrap();
            std::fs::write(run.join("config.toml"), format!("[loss]\nbce = 1.0\ndice = {dice}\n")).unwrap();
            std::fs::write(run.join("run.json"), "{\"task\": \"fsq_cvae\", \"outcome\": \"finished\"}").unwrap();
        }
        let results = crate::Results::read(dir.path(), &plan);
        let Some(Block::Charts(charts)) = learning(dir.path(), &plan, &plan.sweep.metrics, &results.outcomes) else {
            panic!("charts are drawn")
        };
        let titles: Vec<&str> = charts.iter().map(|c| c.title.as_str()).collect();
        assert_eq!(titles[..4], ["train/loss", "train/bce", "train/dice", "eval/m0@val"]);
        assert_eq!(titles.len(), CURVES + 2);
        assert!(charts[0].note.contains("loss.dice") && charts[1].note.contains("without its weight"));
        assert!(charts[3].note.is_empty());
    }
}
