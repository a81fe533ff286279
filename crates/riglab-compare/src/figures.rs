//! All figures of some systems, by metric: rows have them by asset.

use std::collections::HashMap;

use riglab_metric::Preset;
use riglab_metric::statistics::{Mean, Paired};

use crate::System;

/// Figures in the order of tables.
pub(crate) struct Figures(Vec<Column>);

struct Column {
    metric: &'static str,
    preset: Preset,
    /// A list a system, in it a value an asset; NaN where there is none.
    values: Vec<Vec<f64>>,
}

impl Figures {
    /// Those of some presets: a preset's metrics stay together, in the order in which rows have them.
    pub fn of(systems: &[System], presets: &[Preset]) -> Self {
        let empty = || systems.iter().map(|s| vec![f64::NAN; s.rows.len()]).collect::<Vec<_>>();
        let mut columns: Vec<Column> = Vec::new();
        let mut places: HashMap<(&str, &str), usize> = HashMap::new();
        for (k, system) in systems.iter().enumerate() {
            for (asset, row) in system.rows.iter().enumerate() {
                for m in row.measures.iter().filter(|m| presets.contains(&m.preset)) {
                    let at = *places.entry((m.metric, m.preset.name())).or_insert_with(|| {
                        columns.push(Column { metric: m.metric, preset: m.preset, values: empty() });
                        columns.len() - 1
                    });
                    columns[at].values[k][asset] = m.value;
                }
            }
        }
        columns.sort_by_key(|c| presets.iter().position(|preset| *preset == c.preset));
        Self(columns)
    }

    /// How many metrics.
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// A metric's name with its preset's, as [`riglab_metric::Measure::name`].
    pub fn name(&self, at: usize) -> String {
        format!("{}@{}", self.0[at].metric, self.0[at].preset.name())
    }

    /// Whose formula a metric is.
    pub fn preset(&self, at: usize) -> Preset {
        self.0[at].preset
    }

    /// A metric's values: a list a system.
    pub fn values(&self, at: usize) -> &[Vec<f64>] {
        &self.0[at].values
    }
}

/// What is said of a metric's values.
#[derive(Clone)]
pub(crate) struct Judged {
    /// A mean a system.
    pub means: Vec<Mean>,
    /// The first of two systems against the second; `None` of one or more.
    pub pair: Option<Paired>,
}

/// What is said of metrics, each a list a system.
pub(crate) fn judged(metrics: &[&[Vec<f64>]]) -> Vec<Judged> {
    let lists: Vec<&[f64]> = metrics.iter().flat_map(|of| of.iter()).map(Vec::as_slice).collect();
    let pairs: Vec<(&[f64], &[f64])> = metrics.iter().filter_map(|of| both(of)).collect();
    let (mut means, mut pairs) = (Mean::of_each(&lists).into_iter(), Paired::of_each(&pairs).into_iter());
    let of = |of: &&[Vec<f64>]| Judged {
        means: means.by_ref().take(of.len()).collect(),
        pair: both(of).and_then(|_| pairs.next()),
    };
    metrics.iter().map(of).collect()
}

/// The lists of two systems.
fn both(of: &[Vec<f64>]) -> Option<(&[f64], &[f64])> {
    match of {
        [a, b] => Some((a, b)),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use riglab_metric::Measure;

    use super::*;
    use crate::{Row, Status};

    #[test]
    fn metrics_stand_by_preset_in_the_order_of_rows_and_lack_nothing() {
        let (unirig, rignet) = (Preset::Unirig, Preset::Rignet);
        let system = |rows: &[&[(&'static str, Preset, f64)]]| {
            let measure = |&(metric, preset, value): &(&'static str, Preset, f64)| Measure { metric, preset, value };
            let row = |of: &&[(&'static str, Preset, f64)]| Row {
                asset: "a".into(),
                status: Status::Scored,
                joints: 1,
                true_joints: 1,
                without_weights: String::new(),
                notes: Vec::new(),
                measures: of.iter().map(measure).collect(),
            };
            let (name, folder, rows) = ("s".into(), "f".into(), rows.iter().map(row).collect());
            System { name, folder, baseline: false, rows, unmatched: Vec::new(), unread: Vec::new() }
        };
        let systems = [
            system(&[&[("l1", unirig, 1.0), ("j2j", rignet, 2.0)], &[("j2j", unirig, 3.0)]]),
            system(&[&[("iou", rignet, 4.0), ("l1", Preset::Anymate, 5.0)], &[]]),
        ];
        let figures = Figures::of(&systems, &[rignet, unirig]);
        let names: Vec<String> = (0..figures.len()).map(|at| figures.name(at)).collect();
        assert_eq!(names, ["j2j@rignet", "iou@rignet", "l1@unirig", "j2j@unirig"]);
        let text = format!("{:?}", (0..4).map(|at| figures.values(at)).collect::<Vec<_>>());
        let wanted = ["[[2.0, NaN], [NaN, NaN]]", "[[NaN, NaN], [4.0, NaN]]", "[[1.0, NaN], [NaN, NaN]]"];
        assert_eq!(text, format!("[{}, [[NaN, 3.0], [NaN, NaN]]]", wanted.join(", ")));
        for (at, name) in names.iter().enumerate() {
            let own = systems.iter().map(|s| s.values(name)).collect::<Vec<_>>();
            assert_eq!(format!("{own:?}"), format!("{:?}", figures.values(at)));
        }
    }
}
