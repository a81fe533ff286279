//! A table a split, with all runs side by side and what stands beside them, and one of published numbers.

use std::collections::BTreeSet;

use super::by_asset::defined;
use super::{Compared, shared};
use crate::findings::conventions;
use crate::{Cell, Findings, Metric, Table};

/// A table a split: what each run trained, and what stands beside it. What is not trained stands once where all runs found
/// the same of it; where a run found something else (its model before GRPO, say), under its name. Below them, published
/// numbers. `differ`: settings in which the runs differ.
pub(super) fn side_by_side(runs: &[Compared], of: &[&Findings], differ: &BTreeSet<String>) -> Vec<Table> {
    let metrics = shared(of, |f| &f.totals_of);
    let names: Vec<Metric> = metrics.iter().map(|(m, _)| m.clone()).collect();
    let mut tables = Vec::new();
    for split in of[0].splits() {
        let over = of.iter().find_map(|f| f.over).unwrap_or("assets");
        let mut head = vec!["run".to_owned(), "method".into(), over.into()];
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
                        "baseline".into()
                    }
                    false => format!("baseline of {}", runs[*k].name),
                };
                let cells = vec![Cell::text(name), Cell::text(*method), Cell::count(*assets)];
                rows.push((cells, values.clone()));
            }
            own_rows = if own { rows.len() } else { own_rows };
        }
        let mut apart: Vec<&str> = Vec::new();
        let other: Vec<bool> = names.iter().map(|m| !m.among(differ).is_empty()).collect();
        let mut best: Vec<Vec<bool>> = Vec::new();
        for (c, m) in names.iter().enumerate() {
            if other[c] {
                best.push(vec![false; rows.len()]);
                continue;
            }
            let rivals = rivals(of, split, m);
            if rivals == Rivals::None && m.ranked {
                apart.push(&m.name);
            }
            let may = |n: usize| rivals == Rivals::All || (rivals == Rivals::Runs && n < own_rows);
            let value = |(n, (_, values)): (usize, &(Vec<Cell>, Vec<f64>))| if may(n) { values[c] } else { f64::NAN };
            best.push(m.best(&rows.iter().enumerate().map(value).collect::<Vec<_>>()));
        }
        if !apart.is_empty() {
            table.note = format!("No best marked, as runs have values for different assets: {}. ", apart.join(", "));
        }
        table.note += &not_comparable(&names, differ);
        let traded: Vec<&str> = names.iter().filter(|m| !m.ranked).map(|m| m.name.as_str()).collect();
        if !traded.is_empty() {
            table.note += &format!("No best marked, as one rises when another falls: {}. ", traded.join(", "));
        }
        for (n, (mut cells, values)) in rows.into_iter().enumerate() {
            if n == own_rows {
                table.line();
            }
            let numbers = values.iter().zip(&names).zip(&best);
            cells.extend(numbers.map(|((v, m), best)| Cell::number(*v, m.digits).strong_if(best[n])));
            table.row(cells);
        }
        table.note.truncate(table.note.trim_end().len());
        tables.push(table);
    }
    // Once: others' numbers are of no split here.
    tables.extend(of[0].published_in(&names));
    tables
}

/// What is said of metrics that are other quantities in each run, by the settings that make them so.
fn not_comparable(metrics: &[Metric], differ: &BTreeSet<String>) -> String {
    let own = metrics.iter().map(|m| (m.name.as_str(), m.among(differ))).filter(|(_, keys)| !keys.is_empty());
    let (names, keys): (Vec<&str>, Vec<Vec<&str>>) = own.unzip();
    if names.is_empty() {
        return String::new();
    }
    let keys: BTreeSet<&str> = keys.into_iter().flatten().collect();
    let keys = keys.into_iter().collect::<Vec<_>>().join(", ");
    format!("Not comparable between lines, being defined differently ({keys}): {}. ", names.join(", "))
}

/// Among which rows a metric has a best.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Rivals {
    /// All: every run has a figure for every asset, or figures by asset are not known.
    All,
    /// The runs, which have figures for the same assets; what stands beside them may have others.
    Runs,
    /// None: the runs have figures for different assets, and one that fails on what is hard would win.
    None,
}

fn rivals(of: &[&Findings], split: &str, metric: &Metric) -> Rivals {
    let known: Option<Vec<_>> = of.iter().map(|f| defined(f, split, metric)).collect();
    let Some(sets) = known else { return Rivals::All };
    let all = of[0].singles.iter().filter(|s| s.split == split).count();
    match sets.iter().all(|own| *own == sets[0]) {
        true if sets[0].len() == all => Rivals::All,
        true => Rivals::Runs,
        false => Rivals::None,
    }
}

/// Whether two lists hold the same numbers; what is undefined equals what is undefined.
fn same_numbers(a: &[f64], b: &[f64]) -> bool {
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a == b || (a.is_nan() && b.is_nan()))
}
