//! Curves of several runs, laid over each other.

use std::collections::BTreeSet;

use super::Compared;
use crate::glossary::glossary;
use crate::{Chart, Losses, Series};

/// What at least two runs logged, a line a run: the loss and everything validated, and the parts of the loss where the
/// runs weight them otherwise.
pub(super) fn curves(runs: &[Compared]) -> Vec<Chart> {
    let losses = Losses::of(runs.iter().map(|r| r.view.config()));
    let logs: Vec<_> = runs.iter().map(|r| r.view.shown()).collect();
    let names: BTreeSet<&String> = logs.iter().flat_map(|l| l.keys()).collect();
    let wanted = |n: &&&String| **n == "train/loss" || n.starts_with("eval/") || losses.replaces(n);
    let mut charts = Vec::new();
    for name in names.iter().filter(wanted) {
        let both = runs.iter().zip(&logs);
        let series: Vec<Series> = both
            .filter_map(|(r, log)| Some(Series { name: r.name.clone(), points: log.get(*name)?.clone() }))
            .collect();
        if series.len() > 1 {
            let said = glossary(&runs[0].view.task(), &[name]);
            let (title, note) = ((*name).clone(), format!("{} {said}", losses.note(name)).trim().to_owned());
            charts.push(Chart {
                title,
                x: "step".into(),
                series,
                log: *name == "train/loss",
                note,
                ..Chart::default()
            });
        }
    }
    // The loss first, then its parts.
    charts.sort_by_key(|c| (!c.log, !c.title.starts_with("train/")));
    charts
}
