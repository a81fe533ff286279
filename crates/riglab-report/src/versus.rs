//! Several runs side by side.
//!
//! The one idea: only what is of the same assets is compared. Runs of other corpora, other splits or other assets are
//! refused with the difference named; what is left can be tested asset by asset.

use std::collections::{BTreeMap, BTreeSet};

use riglab_metric::statistics::Paired;
use thiserror::Error;

use crate::findings::{PUBLISHED, conventions};
use crate::{Block, Cell, Chart, Findings, Metric, RunView, Series, Single, Table};

/// A run to be compared.
pub struct Compared {
    /// What tables call it.
    pub name: String,
    /// Its folder.
    pub view: RunView,
    /// The corpora its evaluation saw: path and checksum.
    pub corpora: Vec<(String, String)>,
    /// What its evaluation found.
    pub findings: Vec<Findings>,
}

/// Why runs are not compared.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    /// They saw other corpora.
    #[error(
        "{first} and {other} cannot be compared: they were evaluated on different corpora ({difference}); evaluate both \
         on the same ones, for instance with `riglab eval RUN --set data.corpora='[\"FILE\"]'`"
    )]
    Corpora {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// What one has and the other has not.
        difference: String,
    },
    /// They were evaluated on other splits.
    #[error(
        "{first} and {other} cannot be compared: {first} was evaluated on the splits {own}, {other} on {theirs}; \
         evaluate both on the same, for instance with `riglab eval RUN --set data.test='[\"test_new\"]'`"
    )]
    Splits {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// The first's splits.
        own: String,
        /// The other's.
        theirs: String,
    },
    /// A split has other assets in one than in the other.
    #[error(
        "{first} and {other} cannot be compared: their assets of `{split}` differ ({difference}); evaluate both anew \
         with `riglab eval`"
    )]
    Assets {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// The split.
        split: String,
        /// What one has and the other has not.
        difference: String,
    },
    /// Nothing is measured by both.
    #[error("{first} and {other} cannot be compared: {first} measures {own}, {other} {theirs}")]
    Nothing {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// What the first measures.
        own: String,
        /// What the other measures.
        theirs: String,
    },
}

/// The comparison of runs, at least two of them: settings, tables side by side with published numbers, paired tests
/// against the first, categories, curves.
///
/// # Errors
/// As [`Refusal`] tells.
pub fn versus(runs: &[Compared]) -> Result<Vec<Block>, Refusal> {
    let Some((first, others)) = runs.split_first() else { return Ok(Vec::new()) };
    others.iter().try_for_each(|other| same(first, other))?;
    let mut blocks = vec![Block::Table(facts(runs)), Block::Table(settings(runs))];
    for about in first.findings.iter().map(|f| f.about.as_str()) {
        let of: Option<Vec<&Findings>> = runs.iter().map(|r| find(r, about)).collect();
        let Some(of) = of else { continue };
        blocks.push(Block::Heading(about.into()));
        blocks.extend(side_by_side(runs, &of).into_iter().map(Block::Table));
        blocks.extend(tests(runs, &of).map(Block::Table));
        blocks.extend(groups(runs, &of).map(Block::Table));
    }
    let curves = curves(runs);
    if !curves.is_empty() {
        blocks.push(Block::Heading("Training".into()));
        blocks.push(Block::Charts(curves));
    }
    Ok(blocks)
}

fn find<'a>(run: &'a Compared, about: &str) -> Option<&'a Findings> {
    run.findings.iter().find(|f| f.about == about)
}

/// Whether two runs are of the same corpora, splits and assets.
fn same(first: &Compared, other: &Compared) -> Result<(), Refusal> {
    let (a, b) = (first.name.clone(), other.name.clone());
    let sums = |run: &Compared| run.corpora.iter().map(|(_, sum)| sum.clone()).collect::<BTreeSet<_>>();
    if sums(first) != sums(other) {
        let difference = corpora(first, other);
        return Err(Refusal::Corpora { first: a, other: b, difference });
    }
    let shared: Vec<(&Findings, &Findings)> =
        first.findings.iter().filter_map(|f| Some((f, find(other, &f.about)?))).collect();
    if shared.is_empty() {
        let measured = |run: &Compared| run.findings.iter().map(|f| f.about.clone()).collect::<Vec<_>>().join(" and ");
        return Err(Refusal::Nothing { own: measured(first), theirs: measured(other), first: a, other: b });
    }
    for (f, g) in shared {
        let set = |f: &Findings| f.splits().into_iter().map(String::from).collect::<BTreeSet<_>>();
        let (own, theirs) = (set(f), set(g));
        if own != theirs {
            let list = |s: BTreeSet<String>| s.into_iter().collect::<Vec<_>>().join(", ");
            return Err(Refusal::Splits { first: a, other: b, own: list(own), theirs: list(theirs) });
        }
        for split in f.splits() {
            let names = |f: &Findings| -> Vec<String> {
                let mut names: Vec<String> =
                    f.singles.iter().filter(|s| s.split == split).map(|s| s.name.clone()).collect();
                names.sort();
                names
            };
            let (own, theirs) = (names(f), names(g));
            if own != theirs {
                let difference = apart(&first.name, &own, &other.name, &theirs);
                return Err(Refusal::Assets { first: a, other: b, split: split.into(), difference });
            }
        }
    }
    Ok(())
}

/// The corpora that only one of two runs has.
fn corpora(first: &Compared, other: &Compared) -> String {
    let only = |run: &Compared, without: &Compared| -> Vec<String> {
        let missing = run.corpora.iter().filter(|(_, sum)| !without.corpora.iter().any(|(_, s)| s == sum));
        missing.map(|(path, sum)| format!("{path} ({})", sum.chars().take(12).collect::<String>())).collect()
    };
    let said = |run: &Compared, only: Vec<String>| match only.is_empty() {
        true => None,
        false => Some(format!("only {} has {}", run.name, only.join(", "))),
    };
    let both = [said(first, only(first, other)), said(other, only(other, first))];
    both.into_iter().flatten().collect::<Vec<_>>().join("; ")
}

/// What two sorted lists do not share: counts, and a few names.
fn apart(first: &str, own: &[String], other: &str, theirs: &[String]) -> String {
    let only =
        |a: &[String], b: &[String]| a.iter().filter(|n| b.binary_search(n).is_err()).cloned().collect::<Vec<_>>();
    let said = |name: &str, only: Vec<String>| {
        let more = if only.len() > 3 { format!(" and {} more", only.len() - 3) } else { String::new() };
        let few: Vec<_> = only.iter().take(3).cloned().collect();
        (!only.is_empty()).then(|| format!("only {name} has {}{more}", few.join(", ")))
    };
    let mut out = vec![format!("{} and {} assets", own.len(), theirs.len())];
    out.extend(said(first, only(own, theirs)));
    out.extend(said(other, only(theirs, own)));
    out.join("; ")
}

/// A column a run: what it is.
fn facts(runs: &[Compared]) -> Table {
    let mut table = columns("Runs", "fact", runs);
    let lists: Vec<BTreeMap<String, String>> = runs
        .iter()
        .map(|r| {
            let mut of: BTreeMap<_, _> = r.view.fact_list().into_iter().collect();
            of.insert("task".into(), r.view.task());
            of.insert("ended".into(), r.view.outcome());
            of
        })
        .collect();
    let mut names = vec!["task".to_owned(), "ended".into()];
    let more = runs.iter().flat_map(|r| r.view.fact_list()).map(|(name, _)| name).filter(|n| n != "corpus");
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

/// The settings in which the runs differ.
fn settings(runs: &[Compared]) -> Table {
    let mut table = columns("Settings that differ", "setting", runs);
    let flat: Vec<BTreeMap<String, String>> = runs
        .iter()
        .map(|r| {
            let mut out = BTreeMap::new();
            let read: toml::Table = r.view.config().parse().unwrap_or_default();
            flatten("", &toml::Value::Table(read), &mut out);
            out
        })
        .collect();
    let keys: BTreeSet<&String> = flat.iter().flat_map(BTreeMap::keys).collect();
    for key in keys {
        let values: Vec<&str> = flat.iter().map(|of| of.get(key).map_or("", String::as_str)).collect();
        if values.iter().any(|v| *v != values[0]) {
            table.row(std::iter::once(Cell::text(key)).chain(values.into_iter().map(Cell::text)).collect());
        }
    }
    if table.rows.is_empty() {
        table.note = "None: the runs have the same config.".into();
    }
    table
}

fn flatten(path: &str, value: &toml::Value, out: &mut BTreeMap<String, String>) {
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                let below = if path.is_empty() { key.clone() } else { format!("{path}.{key}") };
                flatten(&below, value, out);
            }
        }
        value => {
            out.insert(path.into(), value.to_string());
        }
    }
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

/// A table a split: what each run trained, what stands beside it, published numbers. What is not trained stands once
/// where all runs found the same of it; where a run found something else (its model before GRPO, say), under its name.
fn side_by_side(runs: &[Compared], of: &[&Findings]) -> Vec<Table> {
    let metrics = shared(of, |f| &f.totals_of);
    let names: Vec<Metric> = metrics.iter().map(|(m, _)| m.clone()).collect();
    let mut tables = Vec::new();
    for split in of[0].splits() {
        let mut head = vec!["run".to_owned(), "method".into(), "assets".into()];
        head.extend(names.iter().map(|m| m.name.clone()));
        let mut table =
            Table { caption: format!("{}, {split}: {}", of[0].about, conventions(&names)), head, ..Table::default() };
        let mut rows: Vec<(Vec<Cell>, Vec<f64>)> = Vec::new();
        let mut own_rows = 0;
        for own in [true, false] {
            let mut beside: Vec<(&str, usize, Vec<f64>, usize)> = Vec::new();
            for (k, f) in of.iter().enumerate() {
                for total in f.totals.iter().filter(|t| t.split == split && t.own == own) {
                    let values: Vec<f64> = metrics.iter().map(|(_, at)| total.values[at[k]]).collect();
                    beside.push((&total.method, total.assets, values, k));
                }
            }
            for (method, assets, values, k) in &beside {
                let alike = |other: &(&str, usize, Vec<f64>, usize)| {
                    other.0 == *method && other.1 == *assets && same_numbers(&other.2, values)
                };
                let name = match own {
                    true => runs[*k].name.clone(),
                    false if beside.iter().filter(|o| o.0 == *method).all(alike) => {
                        if beside.iter().find(|o| alike(o)).is_some_and(|first| first.3 != *k) {
                            continue;
                        }
                        "beside".into()
                    }
                    false => format!("beside {}", runs[*k].name),
                };
                let cells = vec![Cell::text(name), Cell::text(*method), Cell::count(*assets)];
                rows.push((cells, values.clone()));
            }
            own_rows = if own { rows.len() } else { own_rows };
        }
        let best: Vec<Option<usize>> = names
            .iter()
            .enumerate()
            .map(|(c, m)| m.best(&rows.iter().map(|(_, values)| values[c]).collect::<Vec<_>>()))
            .collect();
        for (n, (mut cells, values)) in rows.into_iter().enumerate() {
            if n == own_rows {
                table.line();
            }
            let numbers = values.iter().zip(&names).zip(&best);
            cells.extend(numbers.map(|((v, m), best)| Cell::number(*v, m.digits).strong_if(*best == Some(n))));
            table.row(cells);
        }
        let published = of[0].published_rows();
        if !published.is_empty() {
            table.line();
            table.note = PUBLISHED.into();
        }
        for (line, cells) in published {
            let place = |(_, at): &(Metric, Vec<usize>)| cells[at[0]].clone();
            let numbers: Vec<Cell> = metrics.iter().map(place).collect();
            if numbers.iter().any(|c| !c.text.is_empty()) {
                let first = [Cell::text("published"), Cell::text(line.name()), Cell::none()];
                table.row(first.into_iter().chain(numbers).collect());
            }
        }
        tables.push(table);
    }
    tables
}

/// Whether two lists hold the same numbers; what is undefined equals what is undefined.
fn same_numbers(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
}

/// Single assets of a run by split and name, those of a split or all; of equal names the first, the second, ...
fn values<'a>(f: &'a Findings, split: Option<&str>, place: usize) -> BTreeMap<(&'a str, &'a str, usize), f64> {
    let mut out = BTreeMap::new();
    for s in f.singles.iter().filter(|s| split.is_none_or(|split| s.split == split)) {
        let nth = (0..).find(|&n| !out.contains_key(&(&*s.split, &*s.name, n))).unwrap_or(0);
        out.insert((s.split.as_str(), s.name.as_str(), nth), s.values[place]);
    }
    out
}

/// Paired tests of each run against the first, asset by asset. `None` where nothing is known by asset.
fn tests(runs: &[Compared], of: &[&Findings]) -> Option<Table> {
    let metrics = shared(of, |f| &f.singles_of);
    if metrics.is_empty() || of.iter().any(|f| f.singles.is_empty()) {
        return None;
    }
    let first = &runs[0].name;
    let head = [
        "run",
        "split",
        "metric",
        "assets",
        "undefined",
        first,
        "the run",
        "difference",
        "from",
        "to",
        "better",
        "equal",
        "worse",
        "p",
    ];
    let mut table = Table::new(format!("{}: paired tests against {first}, asset by asset", of[0].about), &head);
    let splits = of[0].splits();
    let all = (splits.len() > 1).then_some(None);
    for k in 1..runs.len() {
        if k > 1 {
            table.line();
        }
        for split in splits.iter().map(|s| Some(*s)).chain(all) {
            for (metric, at) in &metrics {
                let (a, b) = (values(of[0], split, at[0]), values(of[k], split, at[k]));
                let total = a.len();
                let pairs: Vec<(f64, f64)> = a
                    .iter()
                    .filter_map(|(name, a)| Some((*a, *b.get(name)?)))
                    .filter(|(a, b)| a.is_finite() && b.is_finite())
                    .collect();
                let (a, b): (Vec<f64>, Vec<f64>) = pairs.into_iter().unzip();
                let paired = Paired::of(&b, &a);
                let mean = |v: &[f64]| v.iter().sum::<f64>() / v.len() as f64;
                let [smaller, equal, larger] = paired.smaller_equal_larger;
                let (better, worse) = if metric.higher { (larger, smaller) } else { (smaller, larger) };
                let digits = metric.digits;
                let signed = |v: f64| match v.is_finite() {
                    true => Cell::none().with_text(format!("{v:+.digits$}")),
                    false => Cell::number(v, digits),
                };
                table.row(vec![
                    Cell::text(&runs[k].name),
                    Cell::text(split.unwrap_or("all splits")),
                    Cell::text(&metric.name),
                    Cell::count(total),
                    Cell::count(total - paired.n),
                    Cell::number(mean(&a), digits),
                    Cell::number(mean(&b), digits),
                    signed(paired.difference),
                    signed(paired.low),
                    signed(paired.high),
                    Cell::count(better),
                    Cell::count(equal),
                    Cell::count(worse),
                    chance(paired.p),
                ]);
            }
        }
    }
    table.note =
        "Means over the assets where both have a figure; undefined: those where one has none, such as failures. \
                  from, to: 95 % interval of the difference by bootstrap over assets. p: how often a difference as \
                  large would come about if the two runs were interchangeable on every asset (sign flips). It says \
                  nothing about other seeds: for that, train several and use `riglab sweep`."
            .into();
    Some(table)
}

/// A probability: no more digits than mean something, and never 0.
fn chance(p: f64) -> Cell {
    let text = match p {
        p if !p.is_finite() => "–".into(),
        p if p < 0.001 => "< 0.001".into(),
        p => format!("{p:.3}"),
    };
    Cell::none().with_text(text)
}

/// Means by split and category, a column a run. `None` where no asset has a category of its own.
fn groups(runs: &[Compared], of: &[&Findings]) -> Option<Table> {
    let metrics = shared(of, |f| &f.singles_of);
    let categories: BTreeSet<&str> = of[0].singles.iter().map(|s| s.category.as_str()).collect();
    if metrics.is_empty() || categories.len() < 2 {
        return None;
    }
    let head = ["metric", "split", "category", "assets"].into_iter().chain(runs.iter().map(|r| r.name.as_str()));
    let head: Vec<&str> = head.collect();
    let mut table = Table::new(format!("{}: means by category", of[0].about), &head);
    for (metric, at) in &metrics {
        if !table.rows.is_empty() {
            table.line();
        }
        for split in of[0].splits() {
            for category in &categories {
                let is = |s: &&Single| s.split == split && s.category == *category;
                let names: BTreeSet<&str> = of[0].singles.iter().filter(is).map(|s| s.name.as_str()).collect();
                if names.is_empty() {
                    continue;
                }
                let means: Vec<f64> = of
                    .iter()
                    .zip(at)
                    .map(|(f, &at)| {
                        let own = f.singles.iter().filter(|s| s.split == split && names.contains(s.name.as_str()));
                        let finite: Vec<f64> = own.map(|s| s.values[at]).filter(|v| v.is_finite()).collect();
                        finite.iter().sum::<f64>() / finite.len() as f64
                    })
                    .collect();
                let best = metric.best(&means);
                let mut cells = vec![
                    Cell::text(&metric.name),
                    Cell::text(split),
                    Cell::text(if category.is_empty() { "without" } else { category }),
                    Cell::count(names.len()),
                ];
                cells.extend(
                    means.iter().enumerate().map(|(k, m)| Cell::number(*m, metric.digits).strong_if(best == Some(k))),
                );
                table.row(cells);
            }
        }
    }
    table.note = "Means over the assets with a figure.".into();
    Some(table)
}

/// What at least two runs logged, a line a run: the loss and everything validated.
fn curves(runs: &[Compared]) -> Vec<Chart> {
    let logs: Vec<_> = runs.iter().map(|r| r.view.logged()).collect();
    let names: BTreeSet<&str> = logs.iter().flat_map(|l| l.keys().copied()).collect();
    let wanted = names.into_iter().filter(|n| *n == "train/loss" || n.starts_with("eval/"));
    let mut charts = Vec::new();
    for name in wanted {
        let series: Vec<Series> = runs
            .iter()
            .zip(&logs)
            .filter_map(|(r, log)| Some(Series { name: r.name.clone(), points: log.get(name)?.clone() }))
            .collect();
        if series.len() > 1 {
            charts.push(Chart { title: name.into(), x: "step".into(), series, log: name == "train/loss" });
        }
    }
    // The loss first.
    charts.sort_by_key(|c| !c.log);
    charts
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::findings::tests::findings;

    fn run(name: &str, shift: f64, sum: &str) -> Compared {
        let dir = tempfile::tempdir().unwrap();
        let write = |file: &str, text: &str| std::fs::write(dir.path().join(file), text).unwrap();
        write("config.toml", &format!("task = 't'\n[train]\nsteps = 5\nseed = {}\n", name.len()));
        write("run.json", "{\"task\": \"t\", \"outcome\": \"finished\"}");
        write(
            "metrics.jsonl",
            "{\"step\":1,\"train/loss\":2.0}\n{\"step\":2,\"train/loss\":1.0,\"eval/iou@val\":0.5}\n",
        );
        let corpora = vec![("c.h5".into(), sum.into())];
        let view = RunView::read(dir.path()).unwrap();
        Compared { name: name.into(), view, corpora, findings: vec![findings(shift)] }
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
        assert_eq!(text(seen, 2), ["beside", "nearest bone", "5", "0.6000", "0.01000"]);
        assert!(seen.rows[1][3].strong && !seen.rows[0][3].strong);
        assert!(text(seen, 3)[0] == "published" && seen.rows[3][3].published && !seen.note.is_empty());
        let tests = table(&blocks, "paired tests against a");
        // Five assets, all better: of 32 flips two reach it.
        assert_eq!(text(tests, 0)[..5], ["long", "test_seen", "IoU", "5", "0"]);
        assert_eq!(text(tests, 0)[7..], ["+0.0500", "+0.0500", "+0.0500", "5", "0", "0", "0.062"]);
        assert_eq!(text(tests, 1)[1..5], ["test_new", "IoU", "3", "1"]);
        assert_eq!(text(tests, 2)[1..5], ["all splits", "IoU", "8", "1"]);
        let groups = table(&blocks, "by category");
        assert_eq!(text(groups, 0), ["IoU", "test_seen", "bird", "2", "0.5400", "0.5900"]);
        let Some(Block::Charts(charts)) = blocks.last() else { panic!("no curves") };
        assert_eq!(charts.iter().map(|c| c.title.as_str()).collect::<Vec<_>>(), ["train/loss", "eval/iou@val"]);
        assert_eq!(charts[0].series.len(), 2);
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
        assert_eq!(heads("test_seen")[..4], ["a", "b", "beside a", "beside b"]);
        assert_eq!(heads("test_new").iter().filter(|h| *h == "beside").count(), 1);
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
        let nothing = said(|r| r.findings[0].about = "skeletons".into());
        assert!(nothing.contains("a measures skin weights, b skeletons"), "{nothing}");
    }
}
