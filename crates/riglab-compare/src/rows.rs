//! A row for every true asset.

use std::collections::BTreeSet;
use std::ops::ControlFlow;
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;
use riglab_core::{Asset, Bounds, Rig};
use riglab_geom::voxel::SolidConfig;
use riglab_metric::{Joints, Measure, Rows, SkinBaseline, Truth};
use serde::{Serialize, Serializer};

use crate::keys::Called;
use crate::predictions::Claims;
use crate::{CompareError, Named, Predictions, Truths, fit};

/// How assets count for which there is nothing to measure.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Failures {
    /// Apart: counted beside the means, as are figures that a prediction leaves undefined.
    #[default]
    Apart,
    /// As the worst that a figure's definition allows, which of weights is one bone for each vertex, a wrong one; of
    /// distances between skeletons, which have no bound, as if one joint had been predicted at the centre of the box.
    /// Formulas that need a bone are given one there of no length, or of the least that they do not merge away. So do single
    /// figures that a prediction leaves undefined: those of bones where it has one joint, those of weights where it has none on
    /// the true joints.
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
    /// Predictions of no true asset, nor of one in another split of the corpus or of a bare mesh.
    pub unmatched: Vec<String>,
    /// Files that could not be looked into, with the reason.
    pub unread: Unread,
}

/// Scores systems against the true rigs, and after them baselines, which bind the true skeletons and have figures of
/// weights alone; also gives true files that could not be read. `progress` is told how many assets are done.
///
/// # Errors
/// When no true rig can be read, or a system has no prediction named as one: before anything is scored where names are known
/// without reading files.
pub fn score(
    truths: &Truths,
    systems: &[(String, Predictions)],
    baselines: &[SkinBaseline],
    failures: Failures,
    progress: impl FnMut(usize) + Send,
) -> Result<(Vec<System>, Unread), CompareError> {
    let mut out: Vec<System> = systems.iter().map(|(name, p)| System::empty(name, p)).collect();
    out.extend(baselines.iter().map(System::of_baseline));
    let mut worst: Vec<Vec<Vec<Measure>>> = vec![Vec::new(); out.len()];
    let mut broken = truths.unread.clone();
    let mut used: Vec<BTreeSet<String>> = vec![Default::default(); systems.len()];
    let mut example = String::new();
    let elsewhere = || truths.elsewhere.iter().map(String::as_str);
    let names = truths.names()?;
    let asked = Called::of(names.iter().map(String::as_str)).beside(elsewhere());
    // Of a file of several it is not known what they are called.
    let asked = if truths.are_named() { asked.all() } else { asked };
    let is_strange = |p: &&Predictions| !p.is_empty() && names.iter().all(|name| p.of_asset(name, &asked).is_empty());
    let strange = systems.iter().map(|(_, p)| p).find(is_strange).filter(|_| truths.are_named());
    let known = truths.names_of_assets()?;
    let mut claims: Vec<Claims> =
        systems.iter().map(|(_, p)| Claims::of(p, &known, &truths.elsewhere, &asked)).collect();
    let told = Mutex::new((0, progress));
    truths.each(|some| {
        if let (Some(_), Some((name, _))) = (strange, some.iter().find(|(_, asset)| asset.is_ok())) {
            example.clone_from(name);
            return ControlFlow::Break(());
        }
        // Of a file of several they are known only now: the first that is called so has what a later one asks for.
        for (name, _) in &some {
            claims.iter_mut().zip(systems).for_each(|(claims, (_, p))| claims.add(&p.of_asset(name, &asked), name));
        }
        let of = |(name, asset): &Named| {
            let rows = match asset {
                Ok(asset) => Ok(rows((name, &asked), asset, (systems, &claims), baselines, failures)),
                Err(e) => Err((name.clone(), e.clone())),
            };
            let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
            told.0 += 1;
            let done = told.0;
            (told.1)(done);
            rows
        };
        for ((name, _), rows) in some.iter().zip(some.par_iter().map(of).collect::<Vec<_>>()) {
            match rows {
                Ok(rows) => {
                    example.clone_from(name);
                    for (k, (row, lacking)) in rows.into_iter().enumerate() {
                        if let Some((_, predictions)) = systems.get(k) {
                            used[k].extend(predictions.of_asset(name, &asked).into_iter().map(String::from));
                        }
                        out[k].rows.push(row);
                        worst[k].push(lacking);
                    }
                }
                Err(fault) => broken.push(fault),
            }
        }
        ControlFlow::Continue(())
    });
    let others = Called::of(elsewhere());
    // Those of the corpus' other splits are not asked for, and no fault; nor are those of its bare meshes.
    let of_these = |predictions: &Predictions, names: &[String]| -> BTreeSet<String> {
        names.iter().flat_map(|name| predictions.of_asset(name, &others)).map(String::from).collect()
    };
    let of_splits = |predictions: &Predictions| of_these(predictions, &truths.elsewhere[..truths.of_splits]).len();
    if let Some(predictions) = strange.filter(|_| !example.is_empty()) {
        return Err(nothing_matches(predictions, &example, of_splits(predictions)));
    }
    out.iter_mut().zip(worst).for_each(|(system, worst)| system.count_worst(worst));
    for ((system, (_, predictions)), used) in out.iter_mut().zip(systems).zip(used) {
        let elsewhere = of_these(predictions, &truths.elsewhere);
        let unmatched = predictions.names().filter(|k| !used.contains(*k) && !elsewhere.contains(*k));
        system.unmatched = unmatched.map(String::from).collect();
        if used.is_empty() && !system.rows.is_empty() && !predictions.is_empty() {
            return Err(nothing_matches(predictions, &example, of_splits(predictions)));
        }
    }
    if out.iter().any(|s| s.rows.is_empty()) {
        let first = broken.first().map(|(name, e)| first_fault(truths.path(), name, e)).unwrap_or_default();
        return Err(CompareError::NoTruth(truths.path().into(), first));
    }
    Ok((out, broken))
}

/// That no prediction is named like a true asset, such as `example`; `elsewhere`: how many are named like those of other splits.
fn nothing_matches(predictions: &Predictions, example: &str, elsewhere: usize) -> CompareError {
    CompareError::NothingMatches {
        folder: predictions.folder().into(),
        found: match predictions.len() {
            1 => "1 prediction".into(),
            n => format!("{n} predictions"),
        },
        theirs: predictions.names().next().unwrap_or_default().into(),
        ours: crate::key(example),
        elsewhere: match elsewhere {
            0 => String::new(),
            n => format!("; {n} of them are of other splits of the corpus: --split chooses one"),
        },
    }
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

    /// Gives each row the figures that it lacks, by what is the worst for its asset; not those that no scored asset has: of a
    /// system whose weights cannot be compared anywhere, worst weights would be all there is.
    fn count_worst(&mut self, worst: Vec<Vec<Measure>>) {
        let scored = self.rows.iter().filter(|row| row.status == Status::Scored);
        let had: BTreeSet<(&str, &str)> =
            scored.clone().flat_map(|row| &row.measures).map(|m| (m.metric, m.preset.name())).collect();
        let any = scored.count() > 0;
        for (row, worst) in self.rows.iter_mut().zip(worst) {
            for m in worst.into_iter().filter(|m| !any || had.contains(&(m.metric, m.preset.name()))) {
                match row.measures.iter_mut().find(|own| (own.metric, own.preset) == (m.metric, m.preset)) {
                    Some(own) if own.value.is_nan() => own.value = m.value,
                    Some(_) => {}
                    None => row.measures.push(m),
                }
            }
        }
    }

    /// Scored, failed and missing assets.
    pub fn counts(&self) -> [usize; 3] {
        let count = |f: fn(&Status) -> bool| self.rows.iter().filter(|r| f(&r.status)).count();
        [count(|s| *s == Status::Scored), count(|s| matches!(s, Status::Failed(_))), count(|s| *s == Status::Missing)]
    }

    /// The values of a metric, a value an asset; NaN where there is none.
    pub fn values(&self, name: &str) -> Vec<f64> {
        let is = |m: &&Measure| name.split_once('@') == Some((m.metric, m.preset.name()));
        self.rows.iter().map(|row| row.measures.iter().find(is).map_or(f64::NAN, |m| m.value)).collect()
    }
}

/// The rows of one asset, one a system, then one a baseline, each with the worst figures for the asset where these are to count.
fn rows(
    (name, asked): (&str, &Called),
    asset: &Asset,
    (systems, claims): (&[(String, Predictions)], &[Claims]),
    baselines: &[SkinBaseline],
    failures: Failures,
) -> Vec<(Row, Vec<Measure>)> {
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
    let mut row = |(predictions, claims): (&Predictions, &Claims)| {
        let mut row = empty();
        let found = predictions.of_asset(name, asked);
        let read = predictions.read(&found, name, &claims.rivals(&found, name));
        match read.and_then(|p| p.map(|p| fit(&p, rig)).transpose()) {
            Ok(None) => {}
            Err(reason) => row.status = Status::Failed(reason),
            Ok(Some(fitted)) => {
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
            }
        }
        row
    };
    let found: Vec<Row> = systems.iter().map(|(_, predictions)| predictions).zip(claims).map(&mut row).collect();
    let lacking = match failures {
        Failures::Worst if !found.is_empty() => worst(prepared.get_or_insert_with(prepare), rig),
        _ => Vec::new(),
    };
    let mut out: Vec<(Row, Vec<Measure>)> = found.into_iter().map(|row| (row, lacking.clone())).collect();
    for baseline in baselines {
        let truth = prepared.get_or_insert_with(prepare);
        let weights = Rows::of(&baseline.weights(rig, &SolidConfig::DEFAULT), rig.skeleton().len());
        let measures = truth.skin(&weights).unwrap_or_default();
        out.push((Row { status: Status::Scored, joints: rig.skeleton().len(), measures, ..empty() }, Vec::new()));
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
    fn rows_lack_no_figure_that_another_asset_has() {
        let measure = |metric: &'static str, value| Measure { metric, preset: Preset::Unirig, value };
        let row = |status: Status, measures: &[(&'static str, f64)]| Row {
            asset: "a".into(),
            status,
            joints: 2,
            true_joints: 2,
            without_weights: String::new(),
            notes: Vec::new(),
            measures: measures.iter().map(|&(metric, value)| measure(metric, value)).collect(),
        };
        let worst = [("j2j", 9.0), ("j2b", 8.0), ("l1", 7.0)].map(|(metric, value)| measure(metric, value)).to_vec();
        let of = |first: &[(&'static str, f64)], status: Status| {
            let second = row(Status::Scored, &[("j2j", 2.0), ("j2b", f64::NAN)]);
            let mut system = System {
                name: "s".into(),
                folder: String::new(),
                baseline: false,
                rows: vec![
                    row(status.clone(), first),
                    if status == Status::Scored { second } else { row(status, &[]) },
                ],
                unmatched: Vec::new(),
                unread: Vec::new(),
            };
            system.rows.push(row(Status::Failed("no".into()), &[]));
            system.count_worst(vec![worst.clone(); 3]);
            ["j2j@unirig", "j2b@unirig", "l1@unirig"].map(|name| system.values(name))
        };
        let same = |found: [Vec<f64>; 3], wanted: [[f64; 3]; 3]| {
            let text = |all: &dyn Fn(usize) -> Vec<f64>| (0..3).map(|k| format!("{:?}", all(k))).collect::<Vec<_>>();
            assert_eq!(text(&|k| found[k].clone()), text(&|k| wanted[k].to_vec()));
        };
        let nan = f64::NAN;
        // What is undefined is the worst, and what is found stays.
        same(
            of(&[("j2j", 1.0), ("j2b", 1.5), ("l1", 0.5)], Status::Scored),
            [[1.0, 2.0, 9.0], [1.5, 8.0, 8.0], [0.5, 7.0, 7.0]],
        );
        // No asset has weights that can be compared: nor have failures.
        same(of(&[("j2j", 1.0), ("j2b", 1.5)], Status::Scored), [[1.0, 2.0, 9.0], [1.5, 8.0, 8.0], [nan; 3]]);
        // A system that failed everywhere has the worst of all.
        same(of(&[], Status::Missing), [[9.0; 3], [8.0; 3], [7.0; 3]]);
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
