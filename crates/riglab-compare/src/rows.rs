//! A row for every true asset.

use std::collections::BTreeSet;
use std::path::Path;

use rayon::prelude::*;
use riglab_core::{Asset, Bounds, Rig};
use riglab_geom::voxel::SolidConfig;
use riglab_metric::{Joints, Measure, Rows, SkinBaseline, Truth};
use serde::{Serialize, Serializer};

use crate::keys::Called;
use crate::{CompareError, Predictions, Truths, fit};

/// How assets count for which there is nothing to measure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Failures {
    /// Apart: counted beside the means.
    #[default]
    Apart,
    /// As the worst that a figure's definition allows, which of weights is one bone for each vertex, a wrong one; of
    /// distances between skeletons, which have no bound, as if one joint had been predicted at the centre of the box.
    /// Formulas that need a bone are given one there of no length, or of the least that they do not merge away.
    Worst,
}

/// A bone of this share of the longest side is the shortest that MagicArticulate does not merge into a joint, with some room:
/// its own limit is 0.0025.
const MERGED: f64 = 0.003;

/// Files that could not be read, with the reason.
pub type Unread = Vec<(String, String)>;

/// What became of an asset.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "status", content = "reason", rename_all = "lowercase")]
pub enum Status {
    /// It was measured.
    Scored,
    /// There is a prediction, but it cannot be read or is of another mesh.
    Failed(String),
    /// There is no prediction.
    Missing,
}

/// One asset of one system.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// The true asset's name.
    pub asset: String,
    /// What became of it.
    #[serde(flatten)]
    pub status: Status,
    /// Predicted joints.
    pub joints: usize,
    /// Joints of the truth.
    pub true_joints: usize,
    /// Why there are no figures of weights; empty where there are.
    pub without_weights: String,
    /// What was moved, scaled or matched by position.
    pub notes: Vec<String>,
    /// The figures.
    #[serde(serialize_with = "by_name")]
    pub measures: Vec<Measure>,
}

/// A system with its rows.
#[derive(Clone, Debug, Serialize)]
pub struct System {
    /// Its name in tables.
    pub name: String,
    /// Where its predictions are.
    pub folder: String,
    /// Whether it is a baseline, which binds the true skeletons.
    pub baseline: bool,
    /// A row for each true asset.
    pub rows: Vec<Row>,
    /// Predictions of no true asset, nor of one in another split of the corpus.
    pub unmatched: Vec<String>,
    /// Files that could not be looked into, with the reason.
    pub unread: Unread,
}

/// Scores systems against the true rigs, and after them baselines, which bind the true skeletons and have figures of
/// weights alone; also gives true files that could not be read. `progress` is told how many assets are done.
///
/// # Errors
/// When no true rig can be read, or a system has no prediction named as one.
pub fn score(
    truths: &Truths,
    systems: &[(String, Predictions)],
    baselines: &[SkinBaseline],
    failures: Failures,
    mut progress: impl FnMut(usize),
) -> Result<(Vec<System>, Unread), CompareError> {
    let mut out: Vec<System> = systems.iter().map(|(name, p)| System::empty(name, p)).collect();
    out.extend(baselines.iter().map(System::of_baseline));
    let (mut broken, mut done) = (truths.unread.clone(), 0);
    let mut used: Vec<BTreeSet<String>> = vec![Default::default(); systems.len()];
    let mut example = String::new();
    let elsewhere = || truths.elsewhere.iter().map(String::as_str);
    let names = truths.names()?;
    let asked = Called::of(names.iter().map(String::as_str)).beside(elsewhere());
    truths.each(|some| {
        let rows: Vec<Result<Vec<Row>, (String, String)>> = some
            .par_iter()
            .map(|(name, asset)| match asset {
                Ok(asset) => Ok(rows((name, &asked), asset, systems, baselines, failures)),
                Err(e) => Err((name.clone(), e.clone())),
            })
            .collect();
        for ((name, _), rows) in some.iter().zip(rows) {
            done += 1;
            match rows {
                Ok(rows) => {
                    example.clone_from(name);
                    for (k, row) in rows.into_iter().enumerate() {
                        if let Some((_, predictions)) = systems.get(k) {
                            used[k].extend(predictions.key_of(name, &asked).map(String::from));
                        }
                        out[k].rows.push(row);
                    }
                }
                Err(fault) => broken.push(fault),
            }
        }
        progress(done);
    });
    out.iter_mut().for_each(System::leave_what_none_has);
    let others = Called::of(elsewhere());
    for ((system, (_, predictions)), used) in out.iter_mut().zip(systems).zip(used) {
        // Those of the corpus' other splits are not asked for, and no fault.
        let elsewhere: BTreeSet<&str> = elsewhere().filter_map(|name| predictions.key_of(name, &others)).collect();
        let unmatched = predictions.keys().filter(|k| !used.contains(*k) && !elsewhere.contains(k));
        system.unmatched = unmatched.map(String::from).collect();
        if let (true, Some(theirs)) = (used.is_empty() && !system.rows.is_empty(), predictions.keys().next()) {
            return Err(CompareError::NothingMatches {
                folder: predictions.folder().into(),
                found: match predictions.len() {
                    1 => "1 prediction".into(),
                    n => format!("{n} predictions"),
                },
                theirs: theirs.into(),
                ours: crate::key(&example),
                elsewhere: match elsewhere.len() {
                    0 => String::new(),
                    n => format!("; {n} of them are of other splits of the corpus: --split chooses one"),
                },
            });
        }
    }
    if out.iter().any(|s| s.rows.is_empty()) {
        let first = broken.first().map(|(name, e)| first_fault(truths.path(), name, e)).unwrap_or_default();
        return Err(CompareError::NoTruth(truths.path().into(), first));
    }
    Ok((out, broken))
}

/// Why the first true file cannot be read, with no name that is said already: that of the only file, or what its reader names.
fn first_fault(truth: &Path, name: &str, fault: &str) -> String {
    match fault.strip_prefix(&format!("{}: ", truth.display())) {
        Some(rest) => format!(": {rest}"),
        None if fault.starts_with(&truth.join(name).display().to_string()) => format!(": {fault}"),
        None => format!(": {name}: {fault}"),
    }
}

impl System {
    fn empty(name: &str, predictions: &Predictions) -> Self {
        let unread = predictions.unread.iter().map(|(file, why)| (file.display().to_string(), why.clone())).collect();
        Self {
            name: name.into(),
            folder: predictions.folder().display().to_string(),
            baseline: false,
            rows: Vec::new(),
            unmatched: Vec::new(),
            unread,
        }
    }

    fn of_baseline(baseline: &SkinBaseline) -> Self {
        let (name, folder) = (baseline.name(), "the true skeleton".to_owned());
        Self { name, folder, baseline: true, rows: Vec::new(), unmatched: Vec::new(), unread: Vec::new() }
    }

    /// Takes from failures the figures that no scored asset has: of a system whose weights cannot be compared anywhere, worst
    /// weights would be all there is.
    fn leave_what_none_has(&mut self) {
        let scored = self.rows.iter().filter(|row| row.status == Status::Scored);
        let had: BTreeSet<String> = scored.clone().flat_map(|row| row.measures.iter().map(Measure::name)).collect();
        if scored.count() > 0 {
            let failed = self.rows.iter_mut().filter(|row| row.status != Status::Scored);
            failed.for_each(|row| row.measures.retain(|m| had.contains(&m.name())));
        }
    }

    /// Scored, failed and missing assets.
    pub fn counts(&self) -> [usize; 3] {
        let count = |f: fn(&Status) -> bool| self.rows.iter().filter(|r| f(&r.status)).count();
        [count(|s| *s == Status::Scored), count(|s| matches!(s, Status::Failed(_))), count(|s| *s == Status::Missing)]
    }

    /// The values of a metric, a value an asset; NaN where there is none.
    pub fn values(&self, name: &str) -> Vec<f64> {
        let of = |row: &Row| row.measures.iter().find(|m| m.name() == name).map_or(f64::NAN, |m| m.value);
        self.rows.iter().map(of).collect()
    }
}

/// The rows of one asset, one a system, then one a baseline.
fn rows(
    (name, asked): (&str, &Called),
    asset: &Asset,
    systems: &[(String, Predictions)],
    baselines: &[SkinBaseline],
    failures: Failures,
) -> Vec<Row> {
    let rig = &asset.rig;
    let empty = || Row {
        asset: name.into(),
        status: Status::Missing,
        joints: 0,
        true_joints: rig.skeleton().len(),
        without_weights: String::new(),
        notes: Vec::new(),
        measures: Vec::new(),
    };
    // Preparing the truth takes most of the time: not where there is nothing to measure.
    let mut prepared: Option<Truth> = None;
    let prepare = || Truth::new(name, rig).moving(&asset.clips);
    let mut row = |predictions: &Predictions| {
        let mut row = empty();
        let read = predictions.key_of(name, asked).map(|key| predictions.read(key).and_then(|p| fit(&p, rig)));
        match read {
            None if failures == Failures::Apart => return row,
            None => {}
            Some(Err(reason)) => row.status = Status::Failed(reason),
            Some(Ok(fitted)) => {
                let truth = prepared.get_or_insert_with(prepare);
                row.status = Status::Scored;
                row.joints = fitted.joints.positions.len();
                row.measures = truth.skeleton(&fitted.joints);
                if let Some(parents) = &fitted.parents {
                    row.measures.extend(truth.parents(parents));
                }
                match fitted.weights {
                    Ok(weights) => row.measures.extend(truth.skin(&weights).unwrap_or_default()),
                    Err(reason) => row.without_weights = reason,
                }
                row.notes = fitted.notes;
                return row;
            }
        }
        if failures == Failures::Worst {
            row.measures = worst(prepared.get_or_insert_with(prepare), rig);
        }
        row
    };
    let mut out: Vec<Row> = systems.iter().map(|(_, predictions)| row(predictions)).collect();
    for baseline in baselines {
        let truth = prepared.get_or_insert_with(prepare);
        let weights = Rows::of(&baseline.weights(rig, &SolidConfig::DEFAULT), rig.skeleton().len());
        let measures = truth.skin(&weights).unwrap_or_default();
        out.push(Row { status: Status::Scored, joints: rig.skeleton().len(), measures, ..empty() });
    }
    out
}

/// The figures of an asset that failed, where failures are to count.
fn worst(truth: &Truth, rig: &Rig) -> Vec<Measure> {
    let mut measures = truth.worst();
    let box_of = Bounds::of(rig.mesh().positions().iter().copied());
    let (center, longest) =
        box_of.map_or(([0.0; 3], 0.0), |b| (b.center().map(f64::from), b.size().into_iter().fold(0.0, f32::max)));
    for share in [0.0, MERGED] {
        let end = [center[0], center[1] + share * f64::from(longest), center[2]];
        let bone = Joints { positions: vec![center, end], parents: vec![None, Some(0)] };
        let with = truth.skeleton(&bone);
        for m in measures.iter_mut().filter(|m| m.value.is_nan() && ["j2j", "j2b", "b2b"].contains(&m.metric)) {
            let other = with.iter().find(|o| (o.metric, o.preset) == (m.metric, m.preset));
            m.value = other.map_or(f64::NAN, |o| o.value);
        }
    }
    measures
}

fn by_name<S: Serializer>(measures: &[Measure], serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_map(measures.iter().map(|m| (m.name(), m.value)))
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Skeleton, SkinWeights};
    use riglab_metric::Preset;

    use super::*;

    #[test]
    fn failures_have_no_figure_that_no_other_asset_has() {
        let row = |status: Status, metrics: &[&'static str]| Row {
            asset: "a".into(),
            status,
            joints: 2,
            true_joints: 2,
            without_weights: String::new(),
            notes: Vec::new(),
            measures: metrics.iter().map(|m| Measure { metric: m, preset: Preset::Unirig, value: 1.0 }).collect(),
        };
        let left = |first: Row| {
            let failed = row(Status::Failed("no".into()), &["j2j", "l1"]);
            let mut system = System {
                name: "s".into(),
                folder: String::new(),
                baseline: false,
                rows: vec![first, failed, row(Status::Missing, &["j2j", "l1"])],
                unmatched: Vec::new(),
                unread: Vec::new(),
            };
            system.leave_what_none_has();
            system.rows[1..].iter().map(|r| r.measures.len()).collect::<Vec<_>>()
        };
        assert_eq!(left(row(Status::Scored, &["j2j"])), [1, 1]);
        assert_eq!(left(row(Status::Scored, &["j2j", "l1"])), [2, 2]);
        // A system that failed everywhere has the worst of all.
        assert_eq!(left(row(Status::Missing, &["j2j", "l1"])), [2, 2]);
    }

    #[test]
    fn a_failure_has_every_distance() {
        let joint = |k: u16, head| Joint { name: format!("{k}"), parent: k.checked_sub(1).map(JointId), head };
        let joints = vec![joint(0, [0.0; 3]), joint(1, [0.0, 4.0, 0.0]), joint(2, [0.0, 10.0, 0.0])];
        let corners = [[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 10.0, 1.0], [0.0, 5.0, -1.0]];
        let mesh = Mesh::new(corners.to_vec(), vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0u16, 1.0)]; 4]).unwrap();
        let rig = Rig::new(Skeleton::new(joints).unwrap(), mesh, weights).unwrap();
        let found = worst(&Truth::new("a", &rig), &rig);
        let value = |metric: &str, preset: Preset| {
            found.iter().find(|m| m.metric == metric && m.preset == preset).unwrap().value
        };
        for preset in Preset::ALL {
            // Of the unit cube, as all but two count.
            let scale = match preset {
                Preset::Skintokens => 100.0,
                Preset::Anymate => 2.0,
                _ => 1.0,
            };
            let [j2j, j2b, b2b] = ["j2j", "j2b", "b2b"].map(|metric| value(metric, preset) / scale);
            // From the middle to joints at 0, 4 and 10 of 10: a mean of 11/30, back 1/10.
            assert!((0.2..0.3).contains(&j2j), "{}: {j2j}", preset.name());
            assert!(j2b > 0.0 && j2b < j2j && b2b > 0.0 && b2b < j2j, "{}: {j2b} {b2b}", preset.name());
        }
        // What one joint says is kept.
        assert_eq!(value("joints_off", Preset::Riglab), 2.0 / 3.0);
    }
}
