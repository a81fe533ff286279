//! Evaluation on whole meshes, given the true skeletons.

use std::collections::BTreeMap;

use riglab_core::{Asset, JointId};
use riglab_geom::voxel::SolidConfig;
use riglab_metric::statistics::Mean;
use riglab_metric::{
    Frames, Joints, Poses, PrecisionRecall, Rows, SkinMetrics, SkinTally, clip_frames, every_rule, motion,
    motion_of_frames, motion_poses, nan_for_null,
};
use riglab_nn::params::Weights;
use riglab_nn::skin_stage::{ATTRIBUTE_SCALE, ATTRIBUTES};
use riglab_random::stream;
use riglab_ranks::Ranks;
use riglab_train::Validation;
use serde::{Deserialize, Serialize};

use super::SkinTask;
use super::predict::{Predicted, Predictor};
use super::ready::{Ready, pool, row};
use crate::assets::AssetId;
use crate::fsq_cvae::evaluate::{Sums, Truth};
use crate::fsq_cvae::{Prepared, ruled};

/// Metrics of one way to get weights, over a split.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// The split.
    pub split: String,
    /// `raw` (the network's output), `rule` (after the decode rule) or the name of a rule without learning.
    pub method: String,
    /// Whether it was learned.
    pub learned: bool,
    /// Assets.
    pub assets: usize,
    /// Numerators and denominators summed over all assets.
    pub pooled: SkinMetrics,
    /// Mean of the assets' own metrics; undefined ones left out.
    pub per_rig: SkinMetrics,
    /// Motion loss: how far vertices are off in ten random poses, in the cube of side 2; the mean of the assets' means.
    #[serde(default = "unknown", deserialize_with = "riglab_metric::nan_for_null")]
    pub motion: f64,
    /// How far vertices are off in frames of the assets' own clips, in the cube of side 2; the mean of the assets' means.
    /// NaN where no asset of the split has clips.
    #[serde(default = "unknown", deserialize_with = "riglab_metric::nan_for_null")]
    pub clips: f64,
    /// Assets with clips.
    #[serde(default)]
    pub clip_assets: usize,
    /// Precision of the network's raw weights, pooled, counted from the threshold at which their recall is this
    /// method's; of the network's own rows NaN.
    #[serde(default = "unknown", deserialize_with = "riglab_metric::nan_for_null")]
    pub ours_at_recall: f64,
}

/// What files of evaluations from before a metric say of it.
fn unknown() -> f64 {
    f64::NAN
}

/// How well an attribute of spring bones is told, over a split.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AttributeRow {
    /// The split.
    pub split: String,
    /// Its name, or `all`: each times its [`ATTRIBUTE_SCALE`].
    pub name: String,
    /// Bones that swing.
    pub bones: usize,
    /// Root of the mean squared error of the network.
    pub model: f64,
    /// The same of the mean over these very bones: the best that one number can do.
    pub mean: f64,
}

/// One asset's own metrics, after the decode rule.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AssetRow {
    /// The split.
    pub split: String,
    /// The asset's name.
    pub name: String,
    /// Its category; empty where it has none.
    #[serde(default)]
    pub category: String,
    /// Vertices.
    pub vertices: usize,
    /// Bones that hold something.
    pub bones: usize,
    /// IoU.
    #[serde(deserialize_with = "nan_for_null")]
    pub iou: f64,
    /// L1.
    #[serde(deserialize_with = "nan_for_null")]
    pub l1: f64,
    /// Motion loss, see [`Row::motion`].
    #[serde(default = "unknown", deserialize_with = "nan_for_null")]
    pub motion: f64,
    /// The same of the rule without learning that has the least over the split.
    #[serde(default = "unknown", deserialize_with = "nan_for_null")]
    pub rule_motion: f64,
    /// The same over its clips, see [`Row::clips`]; NaN without any.
    #[serde(default = "unknown", deserialize_with = "nan_for_null")]
    pub clips: f64,
}

/// What an evaluation found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Which formulas.
    pub convention: String,
    /// How far the decode rule spreads weights over the surface, see `eval.spread`.
    #[serde(default)]
    pub spread: f32,
    /// The decode rule's cut, chosen on the validation split by pooled L1.
    pub cut: f32,
    /// Tables.
    pub rows: Vec<Row>,
    /// Attributes of spring bones, where there are any.
    pub attributes: Vec<AttributeRow>,
    /// Assets.
    pub assets: Vec<AssetRow>,
}

/// Names of attributes, in the order of their columns.
const NAMES: [&str; ATTRIBUTES] =
    ["stiffness", "drag", "gravity power", "gravity x", "gravity y", "gravity z", "hit radius"];

/// An asset to be evaluated: what the network sees of it, and the vertices after.
pub struct Subject {
    /// The rig, its seen points and vertices.
    pub ready: Ready,
    /// How many points are seen.
    pub seen: usize,
    /// True weights of the vertices, a row each.
    pub truth: Vec<f32>,
}

/// Squared errors of attributes, and sums for their mean.
#[derive(Default, Serialize, Deserialize)]
struct Springs {
    bones: usize,
    errors: [f64; ATTRIBUTES],
    sums: [f64; ATTRIBUTES],
    squares: [f64; ATTRIBUTES],
}

impl Springs {
    fn add(&mut self, ready: &Ready, predicted: &Predicted) {
        for (seat, found) in ready.seats.iter().zip(&predicted.attributes) {
            let Some(swing) = &seat.swing else { continue };
            self.bones += 1;
            for (k, (t, p)) in row(swing).into_iter().zip(found).enumerate() {
                let (t, p) = (f64::from(t), f64::from(*p));
                self.errors[k] += (t - p).powi(2);
                self.sums[k] += t;
                self.squares[k] += t * t;
            }
        }
    }

    fn merge(&mut self, other: &Self) {
        self.bones += other.bones;
        let both =
            [(&mut self.errors, &other.errors), (&mut self.sums, &other.sums), (&mut self.squares, &other.squares)];
        both.into_iter().flat_map(|(own, more)| own.iter_mut().zip(more)).for_each(|(own, more)| *own += more);
    }

    /// A row an attribute, and one of all, each times its [`ATTRIBUTE_SCALE`]: whatever a run weighs them by, so that
    /// runs can be compared.
    fn rows(&self, split: &str) -> Vec<AttributeRow> {
        if self.bones == 0 {
            return Vec::new();
        }
        let n = self.bones as f64;
        let model: Vec<f64> = self.errors.iter().map(|e| e / n).collect();
        let mean: Vec<f64> =
            (0..ATTRIBUTES).map(|k| (self.squares[k] / n - (self.sums[k] / n).powi(2)).max(0.0)).collect();
        let of = |name: &str, model: f64, mean: f64| AttributeRow {
            split: split.into(),
            name: name.into(),
            bones: self.bones,
            model: model.sqrt(),
            mean: mean.sqrt(),
        };
        let mut rows: Vec<_> = (0..ATTRIBUTES).map(|k| of(NAMES[k], model[k], mean[k])).collect();
        let all = |of: &[f64]| of.iter().zip(ATTRIBUTE_SCALE).map(|(e, s)| e * s * s).sum::<f64>() / ATTRIBUTES as f64;
        rows.push(of("all", all(&model), all(&mean)));
        rows
    }
}

impl SkinTask {
    fn predictor<'a>(&'a self, weights: &'a Weights) -> Predictor<'a> {
        Predictor { config: &self.config, net: &self.net, weights, device: self.device }
    }

    /// An asset with all its vertices, or at most so many drawn by a seed.
    pub(super) fn subject(&self, id: AssetId, limit: Option<(usize, u64)>) -> Result<Subject, String> {
        let rig = Prepared::new(self.assets.read(id).map_err(|e| e.to_string())?);
        let truth = Truth::new(&rig, limit);
        let (s, cloud) = (&self.config.sampling, self.config.eval_cloud());
        let mut random = stream(self.config.eval.seed, "skin evaluation", &[id.key()]);
        let mut points = pool(&rig, &cloud, &mut random);
        points.extend(truth.points);
        Ok(Subject { ready: Ready::new(rig, points, s.measured()), seen: cloud.points, truth: truth.dense })
    }

    pub(super) fn predicted(&self, w: &Weights, subject: &Subject) -> Result<Predicted, String> {
        self.predictor(w).predict(&subject.ready, subject.seen)
    }

    /// Weights of a whole mesh as the decode rule cuts them.
    pub(super) fn spread(&self, w: &Weights, subject: &Subject, found: &Predicted) -> Vec<f32> {
        self.predictor(w).spread(&subject.ready, subject.seen, found.dense.clone())
    }

    /// Validation: raw and after the rule, on a sample of vertices that is the same every time. Ranks share the assets.
    pub(super) fn validation(&self, w: &Weights, ranks: &Ranks) -> Result<Validation, String> {
        let mut raw = Sums::default();
        let mut rules: Vec<Sums> = self.config.eval.cuts.iter().map(|_| Sums::default()).collect();
        let mut springs = Springs::default();
        let limit = self.config.eval.validation_vertices;
        let (data, eval) = (&self.config.data, &self.config.eval);
        let ids = data.some_of(&self.validation_assets, eval.validation_assets, eval.seed);
        let found = |k: usize| {
            let id = ids[k];
            let subject = self.validated.get(id, || {
                let made = self.subject(id, Some((limit, self.config.eval.seed ^ id.key())))?;
                let bytes = made.ready.bytes() + 4 * made.truth.len();
                Ok::<_, String>((made, bytes))
            })?;
            let found = self.predicted(w, &subject)?;
            let mut own = Springs::default();
            own.add(&subject.ready, &found);
            // Of some of the vertices, which nothing can spread over.
            let (tally, ruled) = self.tallies(&subject, &found.dense, &found.dense);
            Ok((tally, ruled, own))
        };
        let shared = ranks.share::<(SkinTally, Vec<SkinTally>, Springs)>(ids.len(), found, |_| {});
        for (tally, ruled, own) in shared.map_err(|e| e.to_string())? {
            raw.add(&tally);
            rules.iter_mut().zip(&ruled).for_each(|(sums, tally)| sums.add(tally));
            springs.merge(&own);
        }
        let (raw, rule) = (raw.metrics(), rules[best(&rules)].metrics());
        let mut metrics = vec![
            ("l1_rule@val".to_string(), rule.0.l1),
            ("iou_rule@val".into(), rule.0.iou),
            ("iou_rule_per_rig@val".into(), rule.1.iou),
            ("precision_rule@val".into(), rule.0.precision),
            ("recall_rule@val".into(), rule.0.recall),
            ("l1_raw@val".into(), raw.0.l1),
        ];
        let rows = springs.rows("val");
        if let Some(all) = rows.iter().find(|r| r.name == "all" && r.mean > 0.0 && self.config.model.attributes) {
            metrics.push(("attributes_vs_mean@val".into(), all.model / all.mean));
        }
        Ok(Validation { metrics, ..Validation::default() })
    }

    /// Raw, and after the rule with each cut of weights that it cuts.
    fn tallies(&self, subject: &Subject, raw: &[f32], spread: &[f32]) -> (SkinTally, Vec<SkinTally>) {
        let joints = subject.ready.seats.len();
        let rule = |&cut: &f32| SkinTally::of(&subject.truth, &ruled(spread, joints, cut), joints);
        let ruled = self.config.eval.cuts.iter().map(rule).collect();
        (SkinTally::of(&subject.truth, raw, joints), ruled)
    }

    /// How many assets [`Self::evaluate`] goes over.
    pub(super) fn examined_assets(&self) -> Result<usize, String> {
        let mut all = self.validation_assets.len();
        for split in &self.config.data.test {
            all += self.assets.split(split).map_err(|e| e.to_string())?.len();
        }
        Ok(all)
    }

    /// Evaluates on whole meshes of the test splits, raw and after the decode rule, beside rules by straight distances
    /// and by those through the body, and heat. `progress` is told how many assets are done.
    ///
    /// # Errors
    /// When an asset cannot be read, none is there to choose a cut by, or the network gives what is no number.
    pub fn evaluate(&self, w: &Weights, mut progress: impl FnMut(usize)) -> Result<Report, String> {
        self.config.data.can_choose(&self.config.eval.cuts, &self.validation_assets)?;
        let mut rules: Vec<Sums> = self.config.eval.cuts.iter().map(|_| Sums::default()).collect();
        let mut done = 0;
        for &id in &self.validation_assets {
            let subject = self.subject(id, None)?;
            let found = self.predicted(w, &subject)?;
            let (_, ruled) = self.tallies(&subject, &found.dense, &self.spread(w, &subject, &found));
            rules.iter_mut().zip(&ruled).for_each(|(sums, tally)| sums.add(tally));
            done += 1;
            progress(done);
        }
        let cut = self.config.eval.cuts[best(&rules)];
        let mut report = Report {
            convention: "skintokens".into(),
            spread: self.config.eval.spread,
            cut,
            rows: Vec::new(),
            attributes: Vec::new(),
            assets: Vec::new(),
        };
        for split in &self.config.data.test {
            self.evaluate_split(w, split, &mut report, || {
                done += 1;
                progress(done);
            })?;
        }
        Ok(report)
    }

    fn evaluate_split(
        &self,
        w: &Weights,
        split: &str,
        report: &mut Report,
        mut progress: impl FnMut(),
    ) -> Result<(), String> {
        // By place in the table, so that the order is kept.
        let mut methods: BTreeMap<usize, (String, Sums, [Vec<f64>; 2])> = BTreeMap::new();
        let mut springs = Springs::default();
        let mut curve = PrecisionRecall::default();
        let ids = self.assets.split(split).map_err(|e| e.to_string())?;
        for &id in &ids {
            let subject = self.subject(id, None)?;
            let (rig, joints) = (&subject.ready.rig, subject.ready.seats.len());
            let in_motion = InMotion::new(&subject, &self.assets.read(id).map_err(|e| e.to_string())?);
            let mut place = 0;
            let mut tally = |name: String, weights: &[f32]| {
                let tally = SkinTally::of(&subject.truth, weights, joints);
                let (_, sums, moved) =
                    methods.entry(place).or_insert_with(|| (name, Sums::default(), Default::default()));
                sums.add(&tally);
                let off = in_motion.off(weights);
                moved.iter_mut().zip(off).for_each(|(all, off)| all.push(off));
                place += 1;
                (tally.metrics(), off)
            };
            let found = self.predicted(w, &subject)?;
            springs.add(&subject.ready, &found);
            curve.add(&subject.truth, &found.dense);
            tally("raw".into(), &found.dense);
            let (rule, [motion, clips]) =
                tally("rule".into(), &ruled(&self.spread(w, &subject, &found), joints, report.cut));
            report.assets.push(AssetRow {
                split: split.into(),
                name: rig.name.clone(),
                category: self.assets.category(id)?,
                vertices: rig.rig.mesh().positions().len(),
                bones: joints,
                iou: rule.iou,
                l1: rule.l1,
                motion,
                rule_motion: f64::NAN,
                clips,
            });
            let ids: Vec<JointId> = rig.bones.iter().map(|b| b.joint).collect();
            let config = SolidConfig { resolution: self.config.eval.baseline_resolution, ..SolidConfig::DEFAULT };
            every_rule(&rig.rig, &ids, &config, |name, weights| {
                tally(name, weights);
            });
            progress();
        }
        if let Some(best) = best_in_motion(methods.values().map(|(name, _, [motion, _])| (name.as_str(), &motion[..])))
        {
            let own = report.assets.iter_mut().filter(|a| a.split == split);
            own.zip(best).for_each(|(asset, motion)| asset.rule_motion = *motion);
        }
        report.rows.extend(methods.into_values().map(|(method, sums, moved)| {
            let (pooled, per_rig) = sums.metrics();
            let learned = is_learned(&method);
            let [motion, clips] = moved.map(|moved| Mean::of(&moved));
            let ours_at_recall = if learned { f64::NAN } else { curve.precision_at(pooled.recall) };
            Row {
                split: split.into(),
                learned,
                assets: ids.len(),
                pooled,
                per_rig,
                motion: motion.mean,
                clips: clips.mean,
                clip_assets: clips.n,
                ours_at_recall,
                method,
            }
        }));
        if self.config.model.attributes {
            report.attributes.extend(springs.rows(split));
        }
        Ok(())
    }
}

/// An asset's vertices in the poses of the motion loss, and in frames of its own clips.
struct InMotion {
    vertices: Vec<[f64; 3]>,
    joints: Joints,
    poses: Poses,
    frames: Frames,
    /// The joint of each bone.
    columns: Vec<u32>,
    truth: Rows,
}

impl InMotion {
    /// Of a subject, and the asset that it was made of.
    fn new(subject: &Subject, asset: &Asset) -> Self {
        let rig = &subject.ready.rig;
        let (_, to_cube) = asset.rig.normalized();
        let joints = Joints::of(rig.rig.skeleton());
        let columns: Vec<u32> = rig.bones.iter().map(|b| b.joint.index() as u32).collect();
        let asked = &subject.ready.points[subject.seen..];
        Self {
            vertices: asked.iter().map(|p| p.position.map(f64::from)).collect(),
            poses: motion_poses(&rig.name, &joints.parents),
            frames: clip_frames(&asset.clips, f64::from(to_cube.scale), to_cube.shift.map(f64::from)),
            truth: over_joints(&subject.truth, &columns, joints.positions.len()),
            joints,
            columns,
        }
    }

    /// The mean distances from where they belong, in poses and in frames, of dense rows of weights on the bones.
    fn off(&self, weights: &[f32]) -> [f64; 2] {
        let rows = over_joints(weights, &self.columns, self.joints.positions.len());
        let posed = motion(&self.vertices, &self.joints, &self.poses, &self.truth, &rows);
        [posed.mean, motion_of_frames(&self.vertices, &self.frames, &self.truth, &rows).mean]
    }
}

/// Dense rows over bones as rows over `joints` joints.
fn over_joints(weights: &[f32], columns: &[u32], joints: usize) -> Rows {
    let row = |row: &[f32]| columns.iter().copied().zip(row.to_vec()).filter(|(_, w)| *w > 0.0).collect::<Vec<_>>();
    Rows::new(weights.chunks_exact(columns.len()).map(row), joints)
}

/// Whether a method of the tables is the network's.
fn is_learned(method: &str) -> bool {
    ["raw", "rule"].contains(&method)
}

/// Of methods by name, each with the motion loss of every asset, that without learning whose mean is least.
fn best_in_motion<'a>(methods: impl Iterator<Item = (&'a str, &'a [f64])>) -> Option<&'a [f64]> {
    let rules = methods.filter(|(name, _)| !is_learned(name)).map(|(_, motion)| motion);
    rules.min_by(|a, b| Mean::of(a).mean.total_cmp(&Mean::of(b).mean))
}

/// The rule of least pooled L1, the first of equals.
fn best(rules: &[Sums]) -> usize {
    let l1 = |k: usize| rules[k].metrics().0.l1;
    (0..rules.len()).min_by(|&a, &b| l1(a).total_cmp(&l1(b)).then(a.cmp(&b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rule_shown_beside_each_asset_is_the_best_of_the_split() {
        let methods: [(&str, &[f64]); 4] =
            [("rule", &[0.1, 0.1]), ("far", &[0.2, 0.9]), ("heat", &[0.4, 0.2]), ("near", &[0.3, 0.5])];
        assert_eq!(best_in_motion(methods.into_iter()), Some(&[0.4, 0.2][..]));
        assert_eq!(best_in_motion(methods[..1].iter().copied()), None);
    }

    #[test]
    fn the_mean_is_the_best_of_one_number() {
        // Two bones, stiffness 1 and 3, told as 1 and 2.
        let mut s = Springs { bones: 2, ..Springs::default() };
        (s.errors[0], s.sums[0], s.squares[0]) = (1.0, 4.0, 10.0);
        let rows = s.rows("x");
        assert_eq!((rows[0].name.as_str(), rows[0].mean), ("stiffness", 1.0));
        assert!((rows[0].model - 0.5f64.sqrt()).abs() < 1e-12);
        let all = rows.last().unwrap();
        assert!((all.model / all.mean - 0.5f64.sqrt()).abs() < 1e-12 && all.name == "all");
        assert!(Springs::default().rows("x").is_empty());
    }
}
