//! Settings of the task.

use riglab_augment::{AffineConfig, Recipe};
use riglab_geom::{By, CloudConfig};
use riglab_nn::skin_stage::{ATTRIBUTE_SCALE, SkinModelConfig};
use riglab_train::TrainConfig;
use serde::{Deserialize, Serialize};

use super::pairs::PairInput;
use super::ready::Measured;
use crate::assets::DataConfig;
use crate::fsq_cvae::{cells, cuts};
use crate::settings::{TaskSettings, own_settings, weights};

/// Everything a run of UniRig's skin stage is made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkinTaskConfig {
    /// The task's name: `unirig_skin`.
    pub task: String,
    /// Corpora and splits.
    pub data: DataConfig,
    /// The network.
    pub model: SkinModelConfig,
    /// What a batch is made of.
    pub sampling: SamplingConfig,
    /// How rigs are varied before their points are taken and ways through their bodies measured: poses, proportions,
    /// joints moved. `sampling.variants` of each are made and kept.
    pub recipe: Recipe,
    /// How batches are varied after that. Ways through the body change by the scale alone.
    pub augment: AffineConfig,
    /// What is minimised.
    pub loss: LossConfig,
    /// How it is trained.
    pub train: TrainConfig,
    /// How it is evaluated.
    pub eval: EvalConfig,
}

/// What a batch is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SamplingConfig {
    /// Rigs of a batch.
    pub rigs: usize,
    /// Points of each that the network sees.
    pub points: usize,
    /// So many of them have weights to be told.
    pub queries: usize,
    /// At most so many pairs of query and bone: of rigs with many bones there are fewer queries. Bounds memory.
    pub pairs: usize,
    /// Points that are kept of each asset, with their distances from bones; batches take theirs from them.
    pub pool: usize,
    /// Ways in which `recipe` varies each rig; each is made once and kept while `data.cache_mb` has room. 0 varies every
    /// rig anew each time. Of no matter where the recipe changes nothing.
    pub variants: u64,
    /// Share of them that are vertices, as far as there are any, rather than points of the surface. Evaluation is on
    /// vertices.
    pub vertex_share: f32,
    /// What triangles are weighted by where points of the surface are drawn, for evaluations too.
    pub by: By,
    /// What the network is told of each pair of point and bone.
    pub told: PairInput,
    /// Cells along the longest side of the body that distances go through.
    pub resolution: usize,
    /// Bones become part of those above them, for other skeletons than the corpus has.
    pub merge: MergeConfig,
}

/// How bones are merged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MergeConfig {
    /// Probability that some of a rig's are.
    pub probability: f32,
    /// Probability of each bone then.
    pub share: f32,
}

/// λ_W·KL(W ‖ Ŵ) + λ_A·(squared error of attributes) + λ_X·(squared error of a skin in motion) (UniRig 4.3), and the
/// release's losses.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// λ_W: weight of the divergence.
    pub skin: f64,
    /// λ_A: weight of the squared error of attributes, over bones that swing.
    pub attributes: f64,
    /// What each attribute is multiplied by before: stiffness, drag, power of gravity, its direction, hit radius.
    /// Evaluations sum errors up by [`ATTRIBUTE_SCALE`] whatever this is.
    pub attribute_scale: [f64; 7],
    /// Whether every bone counts alike in the divergence, rather than every point.
    pub bone_centric: bool,
    /// Which bones keep their true weights.
    pub freeze: FreezeConfig,
    /// The skin in motion.
    pub physics: PhysicsConfig,
    /// What the public code minimises instead.
    pub released: ReleasedConfig,
}

/// λ_X·Σ_t ‖X_t - X̂_t‖², over the number of points: with spring bones simulated behind a random motion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PhysicsConfig {
    /// λ_X; 0 does without.
    pub weight: f64,
    /// T: poses of the motion after that at rest.
    pub frames: usize,
    /// Between two of them.
    pub seconds: f64,
    /// Largest turn of a joint about each axis in the last, in degrees.
    pub degrees: f32,
    /// Largest way of the whole rig along each axis by then; the rig lies in a cube of side 2.
    pub shift: f32,
}

/// Random freezing: some bones keep their true weights and have no gradient.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FreezeConfig {
    /// Probability that some of a rig's are.
    pub probability: f32,
    /// Up to this share of them, drawn evenly from 0; one is always free.
    pub share: f32,
}

/// Weights of the release's losses; its own are [`ReleasedConfig::unirig`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReleasedConfig {
    /// Squared error of positions in one random pose.
    pub vertex: f64,
    /// The same with every bone counting alike.
    pub normalization: f64,
    /// Absolute error of weights.
    pub l1: f64,
    /// Binary cross-entropy of weights.
    pub bce: f64,
    /// Absolute error where a bone holds nothing, every bone counting alike.
    pub zero_l1: f64,
    /// Absolute error where it holds something.
    pub non_zero_l1: f64,
    /// Largest turn of a joint about each axis in that pose, in degrees.
    pub degrees: f32,
}

impl ReleasedConfig {
    /// As the release trains for RigNet's data.
    pub fn unirig() -> Self {
        Self { vertex: 5.0, normalization: 10.0, l1: 0.3, bce: 1.0, zero_l1: 1.0, non_zero_l1: 1.0, degrees: 30.0 }
    }

    /// Names and weights.
    pub fn weights(&self) -> [(&'static str, f64); 6] {
        [
            ("vertex", self.vertex),
            ("normalization", self.normalization),
            ("l1", self.l1),
            ("bce", self.bce),
            ("zero_l1", self.zero_l1),
            ("non_zero_l1", self.non_zero_l1),
        ]
    }

    /// Whether any of them counts.
    pub fn is_on(&self) -> bool {
        self.weights().iter().any(|(_, w)| *w > 0.0)
    }
}

/// Evaluation on whole meshes, given the true skeletons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvalConfig {
    /// Points of each asset that the network sees; 0 takes as many as in training.
    pub points: usize,
    /// So many of these are vertices, as far as there are any; 0 takes the share of training (`sampling.vertex_share`).
    pub vertices: usize,
    /// Vertices of each asset that validation looks at while training.
    pub validation_vertices: usize,
    /// Assets of the validation split that it looks at while training, of each corpus by `data.weights`; 0 takes all.
    pub validation_assets: usize,
    /// How far the decode rule spreads weights over the surface before it cuts, in distances of each vertex from its
    /// nearest bone; 0 leaves them as told vertex by vertex. Not in the paper.
    pub spread: f32,
    /// Cuts among which the decode rule's is chosen, on the validation split; where there is but one, weights of files are
    /// cut there, too.
    pub cuts: Vec<f32>,
    /// Pairs of bone and point at once: bounds memory.
    pub chunk: usize,
    /// Cells along the longest side of the body for the baselines without learning.
    pub baseline_resolution: usize,
    /// Seeds the points that the network sees.
    pub seed: u64,
}

impl Default for SamplingConfig {
    /// The release's numbers of points; the paper tells a point and a bone their distance, at 196 cells.
    fn default() -> Self {
        Self {
            rigs: 4,
            points: 16_384,
            queries: 512,
            pairs: 1 << 16,
            pool: 16_384,
            variants: 4,
            vertex_share: 0.5,
            by: By::Area,
            told: PairInput::Distance,
            resolution: 196,
            merge: MergeConfig::default(),
        }
    }
}

impl SamplingConfig {
    /// The points that are kept of each asset.
    pub(super) fn kept(&self) -> CloudConfig {
        self.cloud(self.pool)
    }

    fn cloud(&self, points: usize) -> CloudConfig {
        CloudConfig { points, vertices: (points as f32 * self.vertex_share) as usize, by: self.by }
    }

    /// What of a body is measured for it.
    pub fn measured(&self) -> Measured {
        Measured { resolution: self.resolution, heat: self.told.heat() }
    }
}

impl Default for LossConfig {
    /// The paper's terms; it does not tell the λ.
    fn default() -> Self {
        Self {
            skin: 1.0,
            attributes: 1.0,
            attribute_scale: ATTRIBUTE_SCALE,
            bone_centric: true,
            freeze: FreezeConfig { probability: 0.5, share: 0.5 },
            physics: PhysicsConfig { weight: 1.0, ..PhysicsConfig::default() },
            released: ReleasedConfig::default(),
        }
    }
}

impl Default for PhysicsConfig {
    /// The paper's number of poses, left out. In a tenth of a second what swings falls behind visibly.
    fn default() -> Self {
        Self { weight: 0.0, frames: 3, seconds: 0.1, degrees: 30.0, shift: 0.1 }
    }
}

impl Default for FreezeConfig {
    fn default() -> Self {
        Self { probability: 0.0, share: 0.5 }
    }
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            points: 0,
            vertices: 0,
            validation_vertices: 800,
            validation_assets: 64,
            spread: 0.0,
            cuts: vec![0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.16, 0.2, 0.25],
            chunk: 1 << 16,
            baseline_resolution: 128,
            seed: 1,
        }
    }
}

impl SkinTaskConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key path, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let fault = |key: &str, message: String| Err((key.to_string(), message));
        self.data.validate()?;
        self.model.validate().map_err(|(k, m)| (format!("model.{k}"), m))?;
        self.recipe.validate().map_err(|(k, m)| (format!("recipe.{k}"), m))?;
        self.augment.validate().map_err(|(k, m)| (format!("augment.{k}"), m))?;
        self.train.validate().map_err(|(k, m)| (format!("train.{k}"), m))?;
        let s = &self.sampling;
        let sizes = [
            ("sampling.rigs", s.rigs),
            ("sampling.queries", s.queries),
            ("sampling.pairs", s.pairs),
            ("eval.chunk", self.eval.chunk),
            ("eval.validation_vertices", self.eval.validation_vertices),
        ];
        if let Some((key, _)) = sizes.iter().find(|(_, n)| *n == 0) {
            return fault(key, format!("{key} must be at least 1"));
        }
        let picked = self.model.shape.tokens * self.model.shape.drawn;
        let seen = self.eval_cloud();
        for (key, n) in [("sampling.points", s.points), ("eval.points", seen.points)] {
            if n < picked {
                return fault(key, format!("{n} points, and model.shape draws {picked} of them"));
            }
        }
        if self.eval.vertices > seen.points {
            let (vertices, points) = (self.eval.vertices, seen.points);
            return fault("eval.vertices", format!("{vertices} vertices of {points} points: give fewer"));
        }
        if s.queries > s.points || s.points > s.pool {
            let (q, n, p) = (s.queries, s.points, s.pool);
            // The larger of the two is the one that is more likely meant otherwise.
            let key = if q > n { "sampling.queries" } else { "sampling.pool" };
            return fault(key, format!("queries <= points <= pool must hold; they are {q}, {n}, {p}"));
        }
        for (key, p) in [
            ("sampling.vertex_share", s.vertex_share),
            ("sampling.merge.probability", s.merge.probability),
            ("sampling.merge.share", s.merge.share),
            ("loss.freeze.probability", self.loss.freeze.probability),
            ("loss.freeze.share", self.loss.freeze.share),
        ] {
            if !(0.0..=1.0).contains(&p) {
                return fault(key, format!("{p} must lie in [0, 1]"));
            }
        }
        cells("sampling.resolution", s.resolution)?;
        cells("eval.baseline_resolution", self.eval.baseline_resolution)?;
        if s.told.width() != self.model.pair {
            let (width, pair) = (s.told.width(), self.model.pair);
            return fault(
                "model.pair",
                format!(
                    "sampling.told tells {width} numbers of a pair and model.pair has room for {pair}: set it to {width}"
                ),
            );
        }
        self.validate_loss()?;
        if !(0.0..=10.0).contains(&self.eval.spread) {
            let message =
                format!("spread = {} must lie in [0, 10], in distances to the nearest bone", self.eval.spread);
            return fault("eval.spread", message);
        }
        cuts("eval.cuts", &self.eval.cuts)
    }

    fn validate_loss(&self) -> Result<(), (String, String)> {
        let l = &self.loss;
        weights(&[
            ("loss.skin", l.skin),
            ("loss.attributes", l.attributes),
            ("loss.physics.weight", l.physics.weight),
        ])?;
        for (name, weight) in l.released.weights() {
            weights(&[(&format!("loss.released.{name}"), weight)])?;
        }
        weights(&l.attribute_scale.map(|scale| ("loss.attribute_scale", scale)))?;
        if !(0.0..=180.0).contains(&l.released.degrees) {
            return Err(("loss.released.degrees".into(), "degrees must lie in [0, 180]".into()));
        }
        let p = &l.physics;
        for (key, value, most) in [
            ("frames", p.frames as f64, 1000.0),
            ("seconds", p.seconds, 1.0),
            ("degrees", f64::from(p.degrees), 180.0),
            ("shift", f64::from(p.shift), 10.0),
        ] {
            let least = if key == "frames" { 1.0 } else { 0.0 };
            if !(least..=most).contains(&value) {
                return Err((format!("loss.physics.{key}"), format!("{key} must lie in [{least}, {most}]")));
            }
        }
        let r = &l.released;
        if r.degrees == 0.0 && (r.vertex > 0.0 || r.normalization > 0.0) {
            let message =
                "vertex and normalization compare skins in a pose, and without a turn there is none: give degrees";
            return Err(("loss.released.degrees".into(), message.into()));
        }
        if p.weight > 0.0 && p.degrees == 0.0 && p.shift == 0.0 {
            let message = "nothing moves, so physics has nothing to compare: give degrees, or weight = 0";
            return Err(("loss.physics.degrees".into(), message.into()));
        }
        if l.skin == 0.0 && p.weight == 0.0 && !l.released.is_on() {
            return Err(("loss.skin".into(), "no term of the loss trains weights: set loss.skin above 0".into()));
        }
        if l.attributes > 0.0 && !self.model.attributes {
            let message = "the network has no attributes: set model.attributes = true, or loss.attributes = 0";
            return Err(("loss.attributes".into(), message.into()));
        }
        if l.attributes > 0.0 && l.attribute_scale.iter().all(|&scale| scale == 0.0) {
            let message = "every attribute is multiplied by 0, so none is learnt: give scales, or loss.attributes = 0";
            return Err(("loss.attribute_scale".into(), message.into()));
        }
        Ok(())
    }

    /// What the network sees of a rig in evaluation.
    pub fn eval_cloud(&self) -> CloudConfig {
        let points = if self.eval.points == 0 { self.sampling.points } else { self.eval.points };
        let cloud = self.sampling.cloud(points);
        if self.eval.vertices == 0 { cloud } else { CloudConfig { vertices: self.eval.vertices, ..cloud } }
    }
}

impl TaskSettings for SkinTaskConfig {
    const TASK: &'static str = "unirig_skin";

    own_settings!();

    fn chooses_a_cut(&self) -> bool {
        self.eval.cuts.len() > 1
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_papers_settings_are_sound_and_faults_name_their_key() {
        SkinTaskConfig::default().validate().unwrap();
        let fault = |change: fn(&mut SkinTaskConfig)| {
            let mut c = SkinTaskConfig::default();
            change(&mut c);
            c.validate().unwrap_err().0
        };
        assert_eq!(fault(|c| c.sampling.told = PairInput::Features), "model.pair");
        assert_eq!(fault(|c| c.sampling.points = 100), "sampling.points");
        assert_eq!(fault(|c| c.sampling.pool = 5000), "sampling.pool");
        assert_eq!(fault(|c| c.sampling.queries = 999_999), "sampling.queries");
        assert_eq!(fault(|c| (c.loss.skin, c.loss.physics.weight) = (0.0, 0.0)), "loss.skin");
        assert_eq!(fault(|c| c.loss.physics.frames = 0), "loss.physics.frames");
        assert_eq!(fault(|c| c.loss.physics.seconds = f64::NAN), "loss.physics.seconds");
        assert_eq!(fault(|c| c.loss.released.l1 = f64::NAN), "loss.released.l1");
        assert_eq!(fault(|c| c.loss.attribute_scale[2] = 1e30), "loss.attribute_scale");
        assert_eq!(fault(|c| c.loss.released.vertex = 1.0), "loss.released.degrees");
        assert_eq!(fault(|c| (c.loss.physics.degrees, c.loss.physics.shift) = (0.0, 0.0)), "loss.physics.degrees");
        assert_eq!(fault(|c| c.model.attributes = false), "loss.attributes");
        assert_eq!(fault(|c| c.loss.freeze.share = 1.5), "loss.freeze.share");
        assert_eq!(fault(|c| c.loss.attribute_scale = [0.0; 7]), "loss.attribute_scale");
        assert_eq!(fault(|c| c.eval.cuts = vec![2.0]), "eval.cuts");
        assert_eq!(fault(|c| c.data.test = vec!["a".into(), "a".into()]), "data.test");
        assert_eq!(fault(|c| (c.eval.points, c.eval.vertices) = (8192, 8193)), "eval.vertices");
    }

    #[test]
    fn evaluations_see_what_training_does_unless_they_are_told_otherwise() {
        let mut c = SkinTaskConfig::default();
        let (points, vertices) = (16_384, 8_192);
        assert_eq!(c.eval_cloud(), CloudConfig { points, vertices, by: By::Area });
        assert_eq!(c.sampling.kept(), c.eval_cloud());
        c.eval.points = 32_768;
        assert_eq!(c.eval_cloud(), CloudConfig { points: 2 * points, vertices: 2 * vertices, by: By::Area });
        (c.eval.vertices, c.sampling.by) = (vertices, By::SquaredArea);
        assert_eq!(c.eval_cloud(), CloudConfig::unirig_skin());
    }

    #[test]
    fn the_releases_losses_alone_are_sound() {
        let mut c = SkinTaskConfig { model: SkinModelConfig::released(), ..SkinTaskConfig::default() };
        c.sampling.told = PairInput::Weight;
        c.loss = LossConfig { skin: 0.0, attributes: 0.0, released: ReleasedConfig::unirig(), ..c.loss };
        c.validate().unwrap();
    }
}
