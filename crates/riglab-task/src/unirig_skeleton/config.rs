//! Settings of the task.

use riglab_augment::Recipe;
use riglab_geom::CloudConfig;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::skeleton::SkeletonModelConfig;
use riglab_token::{Limits, Merge, Parents, TokenizerConfig};
use riglab_train::TrainConfig;
use serde::{Deserialize, Serialize};

use crate::assets::DataConfig;

/// Everything a run of UniRig's skeleton stage is made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkeletonTaskConfig {
    /// The task's name: `unirig_skeleton`.
    pub task: String,
    /// Corpora and splits.
    pub data: DataConfig,
    /// How skeletons become tokens.
    pub tokenizer: TokenizerConfig,
    /// Longest sequences: assets beyond are not trained on, and none is generated.
    pub limits: Limits,
    /// The network.
    pub model: SkeletonModelConfig,
    /// What a batch is made of.
    pub sampling: SamplingConfig,
    /// How rigs are varied. The result is set into the cube from -1 to 1.
    pub augment: Recipe,
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
    /// The points of each.
    pub cloud: CloudConfig,
    /// How often a rig's class is not told: its joints are then written as any other's.
    pub class_dropout: f32,
}

impl Default for SamplingConfig {
    fn default() -> Self {
        Self { rigs: 12, cloud: CloudConfig::default(), class_dropout: 0.0 }
    }
}

/// Cross-entropy of the next token, and what goes with it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Weight of the cross-entropy.
    pub next: f64,
    /// Weight of the expected distance of coordinates (`dis_loss` of the release, where it is 0).
    pub distance: f64,
    /// Standard deviation, in cells, of what a coordinate's target is spread by (an extension): a cell
    /// beside the true one is not as wrong as one far away. 0 is one cell alone.
    pub spread: f64,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self { next: 1.0, distance: 0.0, spread: 0.0 }
    }
}

/// Evaluation by generating.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvalConfig {
    /// How skeletons are drawn.
    pub generate: GenerateConfig,
    /// Where branches may come from.
    pub parents: Parents,
    /// Meshes at once.
    pub rows: usize,
    /// Assets of the validation split that are generated while training; 0 takes all.
    pub validation_assets: usize,
    /// Points that the baseline compares shapes by.
    pub retrieval_points: usize,
    /// Seeds the points that the encoder sees, and the draws.
    pub seed: u64,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            generate: GenerateConfig::default(),
            parents: Parents::default(),
            rows: 16,
            validation_assets: 32,
            retrieval_points: 512,
            seed: 0,
        }
    }
}

impl SkeletonTaskConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let bad = |key: &str, message: String| Err((key.to_owned(), message));
        self.model.validate().map_err(|(key, message)| (format!("model.{key}"), message))?;
        self.augment.validate().map_err(|(key, message)| (format!("augment.{key}"), message))?;
        self.eval.generate.validate().map_err(|(key, message)| (format!("eval.generate.{key}"), message))?;
        if self.eval.generate.beams > 1 {
            return bad("eval.generate.beams", "evaluation draws without beams: give 1".into());
        }
        if self.sampling.rigs == 0 || self.eval.rows == 0 {
            return bad("sampling.rigs", "rigs of a batch and eval.rows must be at least 1".into());
        }
        if !(0.0..=1.0).contains(&self.sampling.class_dropout) {
            return bad("sampling.class_dropout", format!("{} must lie in [0, 1]", self.sampling.class_dropout));
        }
        let (points, asked) = (self.sampling.cloud.points, self.model.shape.tokens * self.model.shape.drawn);
        if points < asked {
            let of = format!("{} tokens × {} drawn", self.model.shape.tokens, self.model.shape.drawn);
            return bad("sampling.cloud.points", format!("{points} points for model.shape's {of}"));
        }
        let [low, high] = self.tokenizer.range;
        if self.tokenizer.bins < 2 || !(low <= -1.0 && high >= 1.0 && low.is_finite() && high.is_finite()) {
            return bad(
                "tokenizer.range",
                "rigs are set between -1 and 1: the range must hold that, with 2 bins or more".into(),
            );
        }
        let least = self.tokenizer.least_joints.max(1);
        // Start, class, a spring token, joints, end.
        let shortest = 3 * least + 4;
        if self.limits.tokens < shortest || self.limits.joints < least {
            return bad(
                "limits.tokens",
                format!("a skeleton takes at least {shortest} tokens and limits.joints = {least}"),
            );
        }
        if self.eval.generate.tokens < shortest {
            return bad("eval.generate.tokens", format!("a skeleton takes at least {shortest} tokens"));
        }
        if self.eval.retrieval_points == 0 {
            return bad("eval.retrieval_points", "shapes are compared by at least 1 point".into());
        }
        if self.eval.parents == Parents::Anywhere && matches!(self.tokenizer.merge, Merge::Within(_)) {
            return bad("eval.parents", "`anywhere` needs tokenizer.merge = \"nearest\"".into());
        }
        let weights = [self.loss.next, self.loss.distance];
        if !weights.iter().all(|w| w.is_finite() && *w >= 0.0) || weights == [0.0, 0.0] {
            return bad("loss.next", "next and distance are weights from 0 on, and one of them is above".into());
        }
        let longest = self.limits.tokens + self.model.shape.tokens;
        if longest > self.model.decoder.positions {
            let positions = self.model.decoder.positions;
            return bad(
                "model.decoder.positions",
                format!("{positions} positions for {} tokens and model.shape.tokens", self.limits.tokens),
            );
        }
        if !(self.loss.spread >= 0.0 && self.loss.spread < 64.0) {
            return bad("loss.spread", format!("{} must lie in [0, 64)", self.loss.spread));
        }
        self.train.validate().map_err(|(key, message)| (format!("train.{key}"), message))
    }
}
