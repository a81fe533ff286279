//! Several runs side by side.
//!
//! The one idea: only what is of the same assets is compared. Runs of other corpora, other splits or other assets are
//! refused with the difference named; what is left can be tested asset by asset.

mod by_asset;
mod changed;
mod curves;
mod refusal;
mod tables;

use std::collections::{BTreeMap, BTreeSet};

use by_asset::{groups, tests};
pub use refusal::Refusal;
use refusal::same;
use riglab_config::{Config, Loader};
use tables::side_by_side;

use crate::{Block, Cell, Findings, Metric, RunView, Table};

/// A run to be compared.
pub struct Compared {
    /// What tables call it.
    pub name: String,
    /// Its folder.
    pub view: RunView,
    /// The corpora its evaluation saw: path and checksum.
    pub corpora: Vec<(String, String)>,
    /// The step of the checkpoint that was evaluated.
    pub step: Option<u64>,
    /// Settings of that evaluation that are not the run's, as KEY=VALUE.
    pub sets: Vec<String>,
    /// What a reader must know of its figures, as that it was trained on what it was tested on.
    pub warning: Option<String>,
    /// What its evaluation found.
    pub findings: Vec<Findings>,
}

/// The comparison of runs, at least two of them: settings, tables side by side with published numbers, paired tests
/// against the first, the assets that changed most, categories, curves, and a sheet of all assets.
///
/// # Errors
/// As [`Refusal`] tells.
pub fn versus(runs: &[Compared]) -> Result<Vec<Block>, Refusal> {
    let Some((first, others)) = runs.split_first() else { return Ok(Vec::new()) };
    others.iter().try_for_each(|other| same(first, other))?;
    let warned = |run: &Compared| Some(Block::Text(format!("{}: {}", run.name, run.warning.as_ref()?)));
    let mut blocks: Vec<Block> = runs.iter().filter_map(warned).collect();
    let settings = settings(runs)?;
    let differ = settings.rows.iter().map(|row| row[0].text.clone()).collect();
    blocks.extend([Block::Table(facts(runs)), Block::Table(settings)]);
    let found = |f: &Findings| runs.iter().map(|r| Some(find(r, &f.about)?.comparable(&differ))).collect();
    let found: Vec<Vec<Findings>> = first.findings.iter().filter_map(found).collect();
    let mut measured = Vec::new();
    for of in &found {
        let of: Vec<&Findings> = of.iter().collect();
        blocks.push(Block::Heading(of[0].about.clone()));
        blocks.extend(side_by_side(runs, &of, &differ).into_iter().map(Block::Table));
        blocks.extend(tests(runs, &of).map(Block::Table));
        blocks.extend(changed::most(runs, &of).map(Block::Table));
        blocks.extend(groups(runs, &of).map(Block::Table));
        measured.push(of);
    }
    blocks.extend(changed::all(runs, &measured).map(Block::Sheet));
    let curves = curves::curves(runs);
    if !curves.is_empty() {
        blocks.push(Block::Heading("Training".into()));
        blocks.push(Block::Charts(curves));
    }
    Ok(blocks)
}

fn find<'a>(run: &'a Compared, about: &str) -> Option<&'a Findings> {
    run.findings.iter().find(|f| f.about == about)
}

/// A column a run: what it is.
fn facts(runs: &[Compared]) -> Table {
    let mut table = columns("Runs", "fact", runs);
    let lists: Vec<BTreeMap<String, String>> = runs
        .iter()
        .map(|r| {
            let (corpora, facts): (Vec<_>, Vec<_>) = r.view.fact_list().into_iter().partition(|(n, _)| n == CORPUS);
            let mut of: BTreeMap<_, _> = facts.into_iter().collect();
            let corpora: Vec<String> = corpora.into_iter().map(|(_, corpus)| corpus).collect();
            of.insert(TRAINED_ON.into(), corpora.join(", "));
            of.insert("task".into(), r.view.task());
            of.insert("ended".into(), r.view.outcome());
            of.insert(STEP.into(), r.step.map_or(String::new(), |step| step.to_string()));
            of
        })
        .collect();
    let mut names = vec!["task".to_owned(), TRAINED_ON.into(), "ended".into(), STEP.into()];
    let more = runs.iter().flat_map(|r| r.view.fact_list()).map(|(name, _)| name).filter(|n| n != CORPUS);
    for name in more {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    for name in names {
        let values = lists.iter().map(|of| Cell::text(of.get(&name).cloned().unwrap_or_default()));
        table.row(std::iter::once(Cell::text(&name)).chain(values).collect());
    }
    table
}

/// What the step of the checkpoint is called.
const STEP: &str = "step evaluated";

/// What a corpus is called among the facts of a run, and all of them in the table: runs that are tested on the same may have
/// learned from others.
const CORPUS: &str = "corpus";
const TRAINED_ON: &str = "trained on";

/// Settings that say what was learned from. An evaluation on other corpora, which are the same for all runs here, changes
/// nothing of that.
const OF_TRAINING: [&str; 3] = ["data.corpora", "data.weights", "data.train"];

/// The settings in which the runs, as they were evaluated, differ.
fn settings(runs: &[Compared]) -> Result<Table, Refusal> {
    let mut table = columns("Settings that differ", "setting", runs);
    let flat = runs.iter().map(settings_of).collect::<Result<Vec<_>, _>>()?;
    let keys: BTreeSet<&String> = flat.iter().flat_map(BTreeMap::keys).collect();
    for key in keys {
        let values: Vec<&str> = flat.iter().map(|of| of.get(key).map_or("", String::as_str)).collect();
        if values.iter().any(|v| *v != values[0]) {
            table.row(std::iter::once(Cell::text(key)).chain(values.into_iter().map(Cell::text)).collect());
        }
    }
    if table.rows.is_empty() {
        table.note = "None: the runs have the same config, and were evaluated with it.".into();
    }
    Ok(table)
}

/// The settings that a run was evaluated with, by key.
fn settings_of(run: &Compared) -> Result<BTreeMap<String, String>, Refusal> {
    // As the command reads it: a seed may be any 64 bits, which is more than TOML's own integers hold.
    let read = Config::from_toml_str(&format!("config.toml of {}", run.name), run.view.config());
    let read = read.map_err(|e| Refusal::Config { run: run.name.clone(), fault: e.to_string() })?;
    let values = |config: Config| config.leaves().into_iter().map(|leaf| (leaf.path, leaf.value));
    let mut out: BTreeMap<String, String> = values(read).collect();
    let key = |set: &str| set.split('=').next().unwrap_or_default().trim().to_owned();
    for set in run.sets.iter().filter(|set| !OF_TRAINING.contains(&key(set).as_str())) {
        match (Loader::new().parse("", "", &[set]), set.split_once('=')) {
            (Ok(own), _) => out.extend(values(own)),
            // An evaluation was made with it all the same.
            (Err(_), Some((key, value))) => drop(out.insert(key.trim().into(), value.trim().into())),
            (Err(_), None) => {}
        }
    }
    Ok(out)
}

fn columns(caption: &str, first: &str, runs: &[Compared]) -> Table {
    let head = std::iter::once(first).chain(runs.iter().map(|r| r.name.as_str())).collect::<Vec<_>>();
    Table::new(caption, &head)
}

/// The columns that all have, each with its place in every run's totals (or singles).
fn shared(of: &[&Findings], metrics: fn(&Findings) -> &[Metric]) -> Vec<(Metric, Vec<usize>)> {
    let Some((first, _)) = of.split_first() else { return Vec::new() };
    let place = |f: &Findings, m: &Metric| {
        metrics(f).iter().position(|other| other.name == m.name && other.convention == m.convention)
    };
    let all = metrics(first).iter();
    all.filter_map(|m| Some((m.clone(), of.iter().map(|f| place(f, m)).collect::<Option<Vec<_>>>()?))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings::tests::findings;

    fn run(name: &str, shift: f64, sum: &str) -> Compared {
        trained_by(&format!("task = 't'\n[train]\nsteps = 5\nseed = {}\n", name.len()), name, shift, sum)
    }

    fn trained_by(config: &str, name: &str, shift: f64, sum: &str) -> Compared {
        let dir = tempfile::tempdir().unwrap();
        let write = |file: &str, text: &str| std::fs::write(dir.path().join(file), text).unwrap();
        write("config.toml", config);
        write("run.json", "{\"task\": \"t\", \"outcome\": \"finished\"}");
        write(
            "metrics.jsonl",
            "{\"step\":1,\"train/loss\":2.0}\n{\"step\":2,\"train/loss\":1.0,\"eval/iou@val\":0.5}\n",
        );
        let corpora = vec![("c.h5".into(), sum.into())];
        let view = RunView::read(dir.path()).unwrap();
        let findings = vec![findings(shift)];
        Compared { name: name.into(), view, corpora, step: Some(5), sets: Vec::new(), warning: None, findings }
    }

    fn table<'a>(blocks: &'a [Block], caption: &str) -> &'a Table {
        let found = blocks.iter().find_map(|b| match b {
            Block::Table(t) if t.caption.contains(caption) => Some(t),
            _ => None,
        });
        found.unwrap_or_else(|| panic!("no table `{caption}`"))
    }

    #[test]
    fn runs_stand_side_by_side_with_tests_and_published_numbers() {
        let blocks = versus(&[run("a", 0.0, "1"), run("long", 0.05, "1")]).unwrap();
        let text = |t: &Table, k: usize| t.rows[k].iter().map(|c| c.text.clone()).collect::<Vec<_>>();
        let settings = table(&blocks, "Settings");
        assert_eq!((settings.rows.len(), text(settings, 0)), (1, vec!["train.seed".into(), "1".into(), "4".into()]));
        let seen = table(&blocks, "test_seen: convention skintokens");
        assert_eq!(text(seen, 0), ["a", "rule", "5", "0.7000", "0.01000"]);
        assert_eq!(text(seen, 1), ["long", "rule", "5", "0.7500", "0.01000"]);
        assert_eq!(text(seen, 2), ["baseline", "nearest bone", "5", "0.6000", "0.01000"]);
        assert!(seen.rows[1][3].strong && !seen.rows[0][3].strong);
        assert!(seen.rows.len() == 3 && seen.note.is_empty());
        // Once, not below each split.
        let named = |b: &&Block| matches!(b, Block::Table(t) if t.caption.contains("published numbers"));
        assert_eq!(blocks.iter().filter(named).count(), 1);
        let published = table(&blocks, "skin weights: published numbers");
        assert!(published.rows[0][1].published && !published.note.is_empty());
        let tests = table(&blocks, "paired tests against a");
        // Five assets, all better: of 32 flips two reach it.
        assert_eq!(text(tests, 0)[..5], ["long", "test_seen", "IoU per rig", "5", "0"]);
        assert_eq!(text(tests, 0)[7..], ["+0.0500", "+0.0500", "+0.0500", "5", "0", "0", "0.062"]);
        assert_eq!(text(tests, 1)[1..5], ["test_new", "IoU per rig", "3", "1"]);
        assert_eq!(text(tests, 2)[1..5], ["all splits", "IoU per rig", "8", "1"]);
        let groups = table(&blocks, "by category");
        assert_eq!(text(groups, 0), ["IoU per rig", "test_seen", "bird", "2", "0.5400", "0.5900"]);
        let Some(Block::Charts(charts)) = blocks.last() else { panic!("no curves") };
        assert_eq!(charts.iter().map(|c| c.title.as_str()).collect::<Vec<_>>(), ["train/loss", "eval/iou@val"]);
        assert_eq!(charts[0].series.len(), 2);
    }

    #[test]
    fn losses_of_other_weights_are_not_compared_without_a_word() {
        let of = |dice: &str, name: &str| {
            let config = format!("task = 't'\n[loss]\nbce = 1.0\ndice = {dice}\n");
            let mut run = trained_by(&config, name, 0.0, "1");
            let dir = tempfile::tempdir().unwrap();
            let write = |file: &str, text: &str| std::fs::write(dir.path().join(file), text).unwrap();
            write("config.toml", &config);
            write("run.json", "{\"task\": \"t\"}");
            let line = "{\"step\":1,\"train/loss\":2.0,\"train/bce\":1.0,\"train/dice\":0.5,\"train/tokens\":7,\"eval/j2j@val\":0.5}\n";
            write("metrics.jsonl", line);
            run.view = RunView::read(dir.path()).unwrap();
            run
        };
        let charts = |runs: [Compared; 2]| {
            let Some(Block::Charts(charts)) = versus(&runs).unwrap().pop() else { panic!("no curves") };
            charts.into_iter().map(|c| (c.title, c.note)).collect::<Vec<_>>()
        };
        let same = charts([of("1.0", "a"), of("1.0", "b")]);
        let said: Vec<(&str, &str)> = same.iter().map(|(t, n)| (t.as_str(), n.as_str())).collect();
        assert_eq!(said, [("train/loss", ""), ("eval/j2j × 100@val", "")]);
        let other = charts([of("1.0", "a"), of("0.5", "b")]);
        let titles: Vec<&str> = other.iter().map(|(title, _)| title.as_str()).collect();
        assert_eq!(titles, ["train/loss", "train/bce", "train/dice", "eval/j2j × 100@val"]);
        assert!(other[0].1.starts_with("Not comparable") && other[1].1.contains("without its weight"), "{other:?}");
    }

    #[test]
    fn quantities_that_settings_define_otherwise_are_not_ranked_or_tested() {
        let of = |weights: &str, name: &str, shift: f64| {
            let config = format!("task = 't'\n[reward]\nweights = {weights}\nalpha = 0.5\n");
            let mut run = trained_by(&config, name, shift, "1");
            let reward = || Metric::higher("reward", "riglab", 4).defined_by(&["reward"]);
            let own = &mut run.findings[0];
            own.totals_of.push(reward());
            own.totals.iter_mut().for_each(|t| t.values.push(t.values[0]));
            own.singles_of.insert(0, reward());
            own.singles.iter_mut().for_each(|s| s.values.insert(0, 5.0));
            run
        };
        let seen = |runs: [Compared; 2]| {
            let blocks = versus(&runs).unwrap();
            let totals = table(&blocks, "test_seen: convention");
            let tested = table(&blocks, "paired tests").rows.iter().map(|row| row[2].text.clone()).collect::<Vec<_>>();
            (totals.rows[1][3].strong, totals.rows[1][5].strong, totals.note.clone(), tested, blocks)
        };
        let (iou, reward, note, tested, _) = seen([of("[5.0]", "a", 0.0), of("[5.0]", "b", 0.1)]);
        assert!(iou && reward && note.is_empty() && tested.iter().any(|m| m == "reward per rig"), "{tested:?}");
        let (iou, reward, note, tested, blocks) = seen([of("[5.0]", "a", 0.0), of("[1.0]", "b", 0.1)]);
        assert!(iou && !reward && tested.iter().all(|m| m == "IoU per rig") && !tested.is_empty(), "{tested:?}");
        assert_eq!(note, "Not comparable between lines, being defined differently (reward.weights): reward.");
        // The figures of what is left stay with their names.
        assert_eq!(table(&blocks, "paired tests").rows[0][5].text, "0.5400");
    }

    #[test]
    fn runs_that_were_evaluated_otherwise_differ_in_that() {
        let (mut a, mut b) = (run("a", 0.0, "1"), run("b", 0.0, "1"));
        let differ = |a: Compared, b: Compared| {
            let blocks = versus(&[a, b]).unwrap();
            let rows = |caption: &str| -> Vec<Vec<String>> {
                let rows = table(&blocks, caption).rows.iter();
                rows.map(|row| row.iter().map(|c| c.text.clone()).collect()).collect()
            };
            (rows("Settings"), rows("Runs"))
        };
        a.sets = vec!["train.steps=5".into()];
        (b.sets, b.step) = (vec!["train.steps = 7".into(), "eval.name=x".into()], Some(3));
        let (settings, runs) = differ(a, b);
        assert_eq!(settings, [["eval.name", "", "\"x\""], ["train.steps", "5", "7"]]);
        assert!(runs.iter().any(|row| row[..] == ["step evaluated", "5", "3"]), "{runs:?}");
        assert!(differ(run("a", 0.0, "1"), run("b", 0.0, "1")).0.is_empty());
    }

    #[test]
    fn runs_that_learned_from_other_corpora_differ_in_that() {
        let learned = |name: &str, corpus: &str| {
            let config = format!("task = 't'\n[data]\ncorpora = ['{corpus}']\n");
            let mut run = trained_by(&config, name, 0.0, "1");
            let dir = tempfile::tempdir().unwrap();
            std::fs::write(dir.path().join("config.toml"), config).unwrap();
            let info = format!("{{\"task\": \"t\", \"data\": [[\"{corpus}\", \"0123456789abcdef\", 7]]}}");
            std::fs::write(dir.path().join("run.json"), info).unwrap();
            run.view = RunView::read(dir.path()).unwrap();
            run.sets = vec!["data.corpora=['mine.h5']".into()];
            run
        };
        let (a, mut b) = (learned("a", "x.h5"), learned("b", "y.h5"));
        b.warning = Some("3 assets are trained on, too.".into());
        let blocks = versus(&[a, b]).unwrap();
        assert!(
            matches!(&blocks[0], Block::Text(said) if said == "b: 3 assets are trained on, too."),
            "{:?}",
            blocks[0]
        );
        let row = |caption: &str, first: &str| -> Vec<String> {
            let row = table(&blocks, caption).rows.iter().find(|row| row[0].text == first).unwrap();
            row.iter().skip(1).map(|c| c.text.clone()).collect()
        };
        assert_eq!(row("Runs", "trained on"), ["x.h5 (0123456789ab)", "y.h5 (0123456789ab)"]);
        assert_eq!(row("Settings", "data.corpora"), ["[\"x.h5\"]", "[\"y.h5\"]"]);
    }

    #[test]
    fn settings_are_read_as_the_command_reads_them() {
        let settings = |b: &str| {
            // A seed may be any 64 bits, which the crate `toml` reads up to half of alone.
            let a = "[train]\nsteps = 5\nseed = 18446744073709551615\n";
            versus(&[trained_by(a, "a", 0.0, "1"), trained_by(b, "b", 0.0, "1")]).map(|blocks| {
                let rows = table(&blocks, "Settings").rows.iter();
                rows.map(|row| row.iter().map(|c| c.text.clone()).collect::<Vec<_>>()).collect::<Vec<_>>()
            })
        };
        let rows = settings("[train]\nsteps = 7\nseed = 9223372036854775808\n").unwrap();
        let seeds = ["train.seed", "18446744073709551615", "9223372036854775808"];
        assert_eq!(rows, [seeds, ["train.steps", "5", "7"]]);
        let said = settings("[train\n").unwrap_err().to_string();
        assert!(said.starts_with("the settings of b cannot be read") && said.contains("config.toml of b:1:"), "{said}");
        assert!(said.contains("put back"), "{said}");
    }

    #[test]
    fn assets_of_equal_names_stay_apart_in_categories() {
        let of = |name: &str, shift: f64| {
            let mut run = run(name, shift, "1");
            // A fish and a bird.
            run.findings[0].singles[..2].iter_mut().for_each(|s| s.name = "model".into());
            run
        };
        let blocks = versus(&[of("a", 0.0), of("b", 0.1)]).unwrap();
        let groups = table(&blocks, "by category");
        let rows: Vec<Vec<&str>> =
            groups.rows[..2].iter().map(|row| row[2..].iter().map(|c| c.text.as_str()).collect()).collect();
        // Birds are assets 1 and 3, fish 0, 2 and 4.
        assert_eq!(rows, [["bird", "2", "0.5400", "0.6400"], ["fish", "3", "0.5400", "0.6400"]]);
    }

    #[test]
    fn a_run_that_fails_on_some_assets_is_not_marked_as_the_best() {
        let strong = |blocks: &[Block], split: &str| -> Vec<bool> {
            let rows = &table(blocks, &format!("{split}: convention skintokens")).rows;
            rows.iter().take(3).map(|row| row[3].strong).collect()
        };
        let mut fails = run("b", 0.1, "1");
        fails.findings[0].singles[0].values[0] = f64::NAN;
        let blocks = versus(&[run("a", 0.0, "1"), fails]).unwrap();
        assert_eq!(strong(&blocks, "test_seen"), [false; 3]);
        let note = &table(&blocks, "test_seen: convention").note;
        assert_eq!(note, "No best marked, as runs have values for different assets: IoU.");
        // Of the other split both lack the same asset; what stands beside them may have it.
        assert_eq!(strong(&blocks, "test_new"), [false, true, false]);
        let groups = table(&blocks, "by category");
        let fish = groups.rows.iter().find(|row| row[2].text == "fish").unwrap();
        assert!(!fish[4].strong && !fish[5].strong);
        assert!(groups.rows[0][5].strong, "birds have figures in both");
        // Of means over assets, which stand beside what is pooled, it is as true.
        let per_rig = |mut run: Compared| {
            let own = &mut run.findings[0];
            own.totals_of.insert(1, Metric::higher("IoU per rig", "skintokens", 4));
            own.totals.iter_mut().for_each(|t| t.values.insert(1, t.values[0]));
            run
        };
        let mut fails = per_rig(run("b", 0.1, "1"));
        fails.findings[0].singles[0].values[0] = f64::NAN;
        let blocks = versus(&[per_rig(run("a", 0.0, "1")), fails]).unwrap();
        let seen = table(&blocks, "test_seen: convention");
        assert_eq!(seen.head[3..], ["IoU", "IoU per rig", "L1"]);
        assert!(seen.rows.iter().all(|row| !row[3].strong && !row[4].strong));
        assert!(seen.note.ends_with("different assets: IoU, IoU per rig."), "{}", seen.note);
        let new = table(&blocks, "test_new: convention");
        assert_eq!(new.rows.iter().take(3).map(|row| row[4].strong).collect::<Vec<_>>(), [false, true, false]);
    }

    #[test]
    fn tests_say_what_they_are_of() {
        let mut run = [run("a", 0.0, "1"), run("b", 0.1, "1")];
        let said = |run: &[Compared]| {
            let blocks = versus(run).unwrap();
            let tests = table(&blocks, "paired tests against a");
            (tests.caption.clone(), tests.note.clone())
        };
        let (caption, note) = said(&run);
        assert!(caption.ends_with("asset by asset, convention skintokens"), "{caption}");
        assert!(
            note.starts_with(
                "Tested: what each run trained, row `rule` in the tables above. per rig: the mean of each asset's own"
            ),
            "{note}"
        );
        assert!(note.contains("IoU in the tables above is a different metric, pooled over all assets"), "{note}");
        // Totals that are these means are the same figure.
        for total in run[0].findings[0].totals.iter_mut().filter(|t| t.own) {
            total.values[0] = if total.split == "test_seen" { 0.54 } else { 0.61 };
        }
        let mut few = run[0].findings[0].totals[0].clone();
        (few.method, few.values[0]) = ("rule, 4 codes".into(), 0.5);
        run[0].findings[0].totals.push(few);
        let note = said(&run).1;
        assert!(!note.contains("pooled") && !note.contains("4 codes"), "{note}");
    }

    #[test]
    fn assets_that_changed_most_are_named_and_all_stand_in_the_sheet() {
        let mut other = run("b", 0.0, "1");
        let own = |k: usize| 0.5 + 0.02 * k as f64;
        let moved = [0.1, -0.2, 0.0, 0.3, -0.05, 0.0, f64::NAN, 1.0];
        other.findings[0].singles.iter_mut().zip(moved).enumerate().for_each(|(k, (s, by))| s.values[0] = own(k) + by);
        let blocks = versus(&[run("a", 0.0, "1"), other]).unwrap();
        let most = table(&blocks, "changed most against a, by IoU per rig, convention skintokens");
        let rows: Vec<Vec<&str>> = most.rows.iter().map(|row| row.iter().map(|c| c.text.as_str()).collect()).collect();
        let order: Vec<[&str; 2]> = rows.iter().map(|row| [row[1], row[3]]).collect();
        let worse = [["worse", "asset 6"], ["worse", "asset 1"], ["worse", "asset 4"]];
        assert_eq!(order[..3], worse, "a failure first");
        assert_eq!(order[3..], [["better", "asset 7"], ["better", "asset 3"], ["better", "asset 0"]]);
        assert_eq!(rows[0][5..], ["0.6200", "–", "–"]);
        assert_eq!(rows[1], ["b", "worse", "test_seen", "asset 1", "bird", "0.5200", "0.3200", "-0.2000"]);
        assert_eq!(most.breaks, [3]);
        let page = crate::Page { kind: crate::PageKind::Report, title: "t".into(), subtitle: "s".into(), blocks };
        let sheet = page.sheet().unwrap();
        assert_eq!(sheet.lines().count(), 1 + 8);
        let line = "skin weights,IoU per rig,skintokens,higher,a,b,test_seen,asset 2,fish,0.54,0.54,0,equal";
        assert!(sheet.lines().any(|l| l == line), "{sheet}");
        assert!(sheet.contains("asset 6,fish,0.62,,,worse"), "{sheet}");
        assert!(!page.to_html().unwrap().contains("asset 2") && !page.to_csv().contains("asset 2"));
    }

    #[test]
    fn what_stands_beside_is_told_apart_where_runs_found_other_numbers_of_it() {
        let mut other = run("b", 0.05, "1");
        let before = other.findings[0].totals.iter_mut().find(|t| !t.own && t.split == "test_seen").unwrap();
        before.values[0] += 0.25;
        let blocks = versus(&[run("a", 0.0, "1"), other]).unwrap();
        let heads = |split: &str| -> Vec<String> {
            let rows = &table(&blocks, &format!("{split}: convention skintokens")).rows;
            rows.iter().map(|r| r[0].text.clone()).collect()
        };
        assert_eq!(heads("test_seen")[..4], ["a", "b", "baseline of a", "baseline of b"]);
        assert_eq!(heads("test_new").iter().filter(|h| *h == "baseline").count(), 1);
    }

    #[test]
    fn what_totals_are_over_stands_above_their_number() {
        let of = |over| {
            let both = ["a", "b"].map(|name| {
                let mut run = run(name, 0.0, "1");
                run.findings[0].over = over;
                run
            });
            table(&versus(&both).unwrap(), "test_seen: convention").head[2].clone()
        };
        assert_eq!([of(None), of(Some("rigs"))], ["assets", "rigs"]);
    }

    #[test]
    fn what_is_not_of_the_same_assets_is_refused_with_the_difference() {
        let said = |change: fn(&mut Compared)| {
            let mut other = run("b", 0.1, "1");
            change(&mut other);
            versus(&[run("a", 0.0, "1"), other]).unwrap_err().to_string()
        };
        let corpora = said(|r| r.corpora[0].1 = "2".into());
        assert!(corpora.contains("only a has c.h5 (1); only b has c.h5 (2)"), "{corpora}");
        let splits = said(|r| {
            r.findings[0].totals.retain(|t| t.split == "test_new");
            r.findings[0].singles.retain(|t| t.split == "test_new");
        });
        assert!(splits.contains("splits test_new, test_seen, b on test_new;"), "{splits}");
        let assets = said(|r| {
            r.findings[0].singles.pop();
        });
        assert!(assets.contains("`test_new` differ (3 and 2 assets; only a has asset 7)"), "{assets}");
        // Other corpora would be told only to be refused for this.
        let nothing = said(|r| {
            r.findings[0].about = "skeletons".into();
            r.corpora[0].1 = "2".into();
        });
        assert!(nothing.contains("a measures skin weights, b skeletons"), "{nothing}");
    }
}
