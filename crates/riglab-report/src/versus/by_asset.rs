//! Runs compared asset by asset: paired tests against the first, and means by category.

use std::collections::{BTreeMap, BTreeSet};

use riglab_metric::statistics::Paired;

use super::{Compared, shared};
use crate::findings::{conventions, is_total_of, per_rig};
use crate::forms::figure;
use crate::{Cell, Findings, Metric, Single, Table, Total};

/// What tells an asset from others: its split, its name, and of equal names the first, the second, ...
pub(super) type Key<'a> = (&'a str, &'a str, usize);

/// The single assets of a run, each by what tells it from the others.
pub(super) fn keyed(f: &Findings) -> Vec<(Key<'_>, &Single)> {
    let mut seen: BTreeMap<(&str, &str), usize> = BTreeMap::new();
    let of = |s| {
        let Single { split, name, .. }: &Single = s;
        let count = seen.entry((split, name)).or_default();
        *count += 1;
        ((split.as_str(), name.as_str(), *count - 1), s)
    };
    f.singles.iter().map(of).collect()
}

/// A figure of a run's single assets, those of a split or all.
fn values<'a>(f: &'a Findings, split: Option<&str>, place: usize) -> BTreeMap<Key<'a>, f64> {
    let own = keyed(f).into_iter().filter(|(key, _)| split.is_none_or(|split| key.0 == split));
    own.map(|(key, s)| (key, s.values[place])).collect()
}

/// The assets of a split for which a run has a figure of what stands in a column of totals; `None` where figures by asset
/// are not known.
pub(super) fn defined<'a>(f: &'a Findings, split: &str, total: &Metric) -> Option<BTreeSet<Key<'a>>> {
    let place = f.singles_of.iter().position(|single| is_total_of(total, single))?;
    let own = values(f, Some(split), place);
    Some(own.into_iter().filter(|(_, v)| v.is_finite()).map(|(key, _)| key).collect())
}

/// Paired tests of each run against the first, asset by asset. `None` where nothing is known by asset.
pub(super) fn tests(runs: &[Compared], of: &[&Findings]) -> Option<Table> {
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
    let names: Vec<Metric> = metrics.iter().map(|(m, _)| m.clone()).collect();
    let caption = format!("{}: paired tests against {first}, asset by asset, {}", of[0].about, conventions(&names));
    let mut table = Table::new(caption, &head);
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
                table.row(vec![
                    Cell::text(&runs[k].name),
                    Cell::text(split.unwrap_or("all splits")),
                    Cell::text(per_rig(metric)),
                    Cell::count(total),
                    Cell::count(total - paired.n),
                    Cell::number(mean(&a), digits),
                    Cell::number(mean(&b), digits),
                    Cell::difference(paired.difference, digits),
                    Cell::difference(paired.low, digits),
                    Cell::difference(paired.high, digits),
                    Cell::count(better),
                    Cell::count(equal),
                    Cell::count(worse),
                    chance(paired.p),
                ]);
            }
        }
    }
    table.note = format!(
        "{}Means over the assets where both runs have a value; undefined: assets where one has none, such as failures. \
         from, to: 95 % interval of the difference by bootstrap over assets. p: how often a difference this large \
         would arise if the two runs were interchangeable on every asset (sign-flip test). It says nothing about \
         other seeds: train several of each run with `riglab sweep`, whose report has the differences seed by seed \
         with their intervals.",
        tested(of[0], &names)
    );
    Some(table)
}

/// What is tested: of which rows, and which totals of the same name are other figures.
fn tested(of: &Findings, metrics: &[Metric]) -> String {
    let rows = tested_rows(of);
    let mut methods: Vec<String> = rows.iter().map(|t| format!("`{}`", t.method)).collect();
    methods.sort();
    methods.dedup();
    let is_pooled = |m: &&Metric| rows.iter().any(|row| is_mean(of, row, m, &m.name) == Some(false));
    let pooled: Vec<&str> = metrics.iter().filter(is_pooled).map(|m| m.name.as_str()).collect();
    let mut out = String::new();
    if !methods.is_empty() {
        out += &format!("Tested: what each run trained, row {} in the tables above. ", methods.join(" and "));
    }
    if !pooled.is_empty() {
        let are = if pooled.len() == 1 { "is a different metric" } else { "are different metrics" };
        out += &format!(
            "per rig: the mean of each asset's own figure; {} in the tables above {are}, pooled over all assets, so that \
             large ones count more. ",
            pooled.join(" and ")
        );
    }
    out
}

/// The rows that the single assets are of: of what was trained those with the assets' means, such as the one with all
/// codes of several numbers of codes; all where none has.
fn tested_rows(of: &Findings) -> Vec<&Total> {
    let own = || of.totals.iter().filter(|t| t.own);
    let has = |t: &&Total| {
        let is = |m: &Metric, total: &Metric| is_total_of(total, m) && is_mean(of, t, m, &total.name) == Some(true);
        of.singles_of.iter().any(|m| of.totals_of.iter().any(|total| is(m, total)))
    };
    let found: Vec<&Total> = own().filter(has).collect();
    if found.is_empty() { own().collect() } else { found }
}

/// Whether the column `name` of a row is the mean of the single assets' metric; `None` where there is no such column or
/// no mean.
fn is_mean(of: &Findings, row: &Total, metric: &Metric, name: &str) -> Option<bool> {
    let total = of.totals_of.iter().position(|m| m.name == name && m.convention == metric.convention)?;
    let single = of.singles_of.iter().position(|m| m.name == metric.name && m.convention == metric.convention)?;
    let own = of.singles.iter().filter(|s| s.split == row.split).map(|s| s.values[single]);
    let finite: Vec<f64> = own.filter(|v| v.is_finite()).collect();
    let mean = finite.iter().sum::<f64>() / finite.len() as f64;
    mean.is_finite().then(|| (mean - row.values[total]).abs() <= 1e-6 * mean.abs())
}

/// A probability: no more digits than mean something, and never 0.
fn chance(p: f64) -> Cell {
    match p {
        p if !p.is_finite() => Cell::none().with_text("–"),
        // What reads numbers has the number.
        p if p < 0.001 => Cell::none().with_text("< 0.001").with_digits(figure(p)),
        p => Cell::none().with_text(format!("{p:.3}")),
    }
}

/// Means by split and category, a column a run. `None` where no asset has a category of its own.
pub(super) fn groups(runs: &[Compared], of: &[&Findings]) -> Option<Table> {
    let metrics = shared(of, |f| &f.singles_of);
    let categories: BTreeSet<&str> = of[0].singles.iter().map(|s| s.category.as_str()).collect();
    if metrics.is_empty() || categories.len() < 2 {
        return None;
    }
    let names: Vec<Metric> = metrics.iter().map(|(m, _)| m.clone()).collect();
    let head = ["metric", "split", "category", "assets"].into_iter().chain(runs.iter().map(|r| r.name.as_str()));
    let head: Vec<&str> = head.collect();
    let mut table = Table::new(format!("{}: means by category, {}", of[0].about, conventions(&names)), &head);
    let all: Vec<Vec<(Key, &Single)>> = of.iter().map(|f| keyed(f)).collect();
    for (metric, at) in &metrics {
        if !table.rows.is_empty() {
            table.line();
        }
        for split in of[0].splits() {
            for category in &categories {
                // The first run's categories are those of all: the assets are the same.
                let is = |(_, s): &&(Key, &Single)| s.split == split && s.category == *category;
                let keys: BTreeSet<Key> = all[0].iter().filter(is).map(|(key, _)| *key).collect();
                if keys.is_empty() {
                    continue;
                }
                let found: Vec<BTreeMap<Key, f64>> = all
                    .iter()
                    .zip(at)
                    .map(|(singles, &at)| {
                        let own = singles.iter().filter(|(key, s)| keys.contains(key) && s.values[at].is_finite());
                        own.map(|(key, s)| (*key, s.values[at])).collect()
                    })
                    .collect();
                let means: Vec<f64> = found.iter().map(|of| of.values().sum::<f64>() / of.len() as f64).collect();
                let alike = found.iter().all(|of| of.keys().eq(found[0].keys()));
                let best = if alike { metric.best(&means) } else { vec![false; means.len()] };
                let mut cells = vec![
                    Cell::text(per_rig(metric)),
                    Cell::text(split),
                    Cell::text(if category.is_empty() { "without" } else { category }),
                    Cell::count(keys.len()),
                ];
                cells.extend(means.iter().enumerate().map(|(k, m)| Cell::number(*m, metric.digits).strong_if(best[k])));
                table.row(cells);
            }
        }
    }
    table.note =
        "Means over the assets with a figure; the best is marked where all runs have one for the same assets.".into();
    Some(table)
}

#[cfg(test)]
mod tests {
    use super::chance;

    #[test]
    fn a_small_chance_is_a_bound_to_readers_and_a_number_to_programs() {
        let both = [0.0625, 0.001, 0.0002, 0.00012345, f64::NAN].map(|p| {
            let cell = chance(p);
            assert!(cell.plain().is_empty() || cell.plain().parse::<f64>().is_ok_and(|p| p > 0.0), "{}", cell.plain());
            (cell.text.clone(), cell.plain().to_owned())
        });
        let shown = both.each_ref().map(|(text, plain)| (text.as_str(), plain.as_str()));
        let small = [("< 0.001", "2.000e-4"), ("< 0.001", "1.234e-4")];
        assert_eq!(shown, [("0.062", "0.062"), ("0.001", "0.001"), small[0], small[1], ("–", "")]);
    }
}
