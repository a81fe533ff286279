//! Settings of the task.

use riglab_augment::Recipe;
use riglab_geom::CloudConfig;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::skeleton::SkeletonModelConfig;
use riglab_token::{Limits, Parents, TokenizerConfig, Vocabulary};
use riglab_train::TrainConfig;
use serde::{Deserialize, Serialize};

use super::agree::Agreement;
use crate::assets::DataConfig;
use crate::sequences::Sequences;
use crate::settings::{TaskSettings, own_settings, weights};

/// Everything a run of UniRig's skeleton stage is made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkeletonTaskConfig {
    /// The task's name: `unirig_skeleton`.
    pub task: String,
    /// The class that every skeleton begins with whose joints' names tell none: those drawn freely, and those of the corpora;
    /// empty for none.
    pub class: String,
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
    /// Points that the network sees of each mesh for which skeletons are drawn; 0 takes as many as in training
    /// (`sampling.cloud`).
    pub points: usize,
    /// So many of these are vertices, as far as there are any; 0 takes as many as in training.
    pub vertices: usize,
    /// How skeletons are drawn. While training, beams are left out: validations then take the likeliest tokens.
    pub generate: GenerateConfig,
    /// Skeletons that `riglab eval` samples for each mesh, of which it takes the one that the others agree with most
    /// (see [`riglab_metric::consensus`]); 1: the one that `generate` gives.
    pub consensus: usize,
    /// Point clouds of each mesh that these draws are shared out to, each sampled anew.
    pub clouds: usize,
    /// Whether every other cloud is seen in the mirror, x for -x: for models that were trained so (`augment.flip`). What is
    /// drawn after it votes and is not taken.
    pub mirror: bool,
    /// Rounds in which the joints of the one that is taken move to where the others have them (see
    /// [`riglab_metric::refined`]).
    pub refine: usize,
    /// Where branches may come from.
    pub parents: Parents,
    /// Skeletons drawn at once; as many more as keep their keys and values below 1 GiB.
    pub rows: usize,
    /// Assets of the validation split that are generated while training, of each corpus by `data.weights`; 0 takes all.
    pub validation_assets: usize,
    /// Points that the baseline compares shapes by.
    pub retrieval_points: usize,
    /// Seeds the points that the encoder sees, and the draws.
    pub seed: u64,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            points: 0,
            vertices: 0,
            generate: GenerateConfig::default(),
            consensus: 1,
            clouds: 1,
            mirror: false,
            refine: 0,
            parents: Parents::default(),
            rows: 16,
            validation_assets: 32,
            retrieval_points: 512,
            seed: 0,
        }
    }
}

impl EvalConfig {
    /// How one skeleton is made of several.
    pub(crate) fn agreement(&self) -> Agreement {
        Agreement { draws: self.consensus, clouds: self.clouds, mirror: self.mirror, refine: self.refine }
    }
}

impl SkeletonTaskConfig {
    /// The points that the network sees of a mesh for which skeletons are drawn.
    pub fn eval_cloud(&self) -> CloudConfig {
        let (cloud, eval) = (&self.sampling.cloud, &self.eval);
        let or = |own: usize, trained: usize| if own == 0 { trained } else { own };
        CloudConfig { points: or(eval.points, cloud.points), vertices: or(eval.vertices, cloud.vertices), by: cloud.by }
    }

    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let bad = |key: &str, message: String| Err((key.to_owned(), message));
        self.data.validate()?;
        self.model.validate().map_err(|(key, message)| (format!("model.{key}"), message))?;
        self.augment.validate().map_err(|(key, message)| (format!("augment.{key}"), message))?;
        Sequences {
            class: &self.class,
            tokenizer: &self.tokenizer,
            limits: self.limits,
            shape: &self.model.shape,
            cloud: &self.sampling.cloud,
            rigs: self.sampling.rigs,
            class_dropout: self.sampling.class_dropout,
            generate: &self.eval.generate,
            parents: self.eval.parents,
            rows: self.eval.rows,
            retrieval_points: self.eval.retrieval_points,
            spread: self.loss.spread,
        }
        .validate()?;
        let (seen, asked) = (self.eval_cloud(), self.model.shape.tokens * self.model.shape.drawn);
        if seen.points < asked {
            let points = seen.points;
            return bad("eval.points", format!("{points} points, and model.shape draws {asked} of them: give more"));
        }
        if self.eval.vertices > seen.points {
            let (vertices, points) = (self.eval.vertices, seen.points);
            return bad("eval.vertices", format!("{vertices} vertices of {points} points: give fewer"));
        }
        let ids = Vocabulary::new(&self.tokenizer).len();
        if let Some(token) = self.model.decoder.frozen_token.filter(|token| *token as usize >= ids) {
            let message =
                format!("{token} is no token of the tokenizer: it has 0 to {}; leave it out to freeze none", ids - 1);
            return bad("model.decoder.frozen_token", message);
        }
        self.eval.agreement().validate().map_err(|(key, message)| (key.to_owned(), message))?;
        weights(&[("loss.next", self.loss.next), ("loss.distance", self.loss.distance)])?;
        if self.loss.next == 0.0 && self.loss.distance == 0.0 {
            return bad("loss.next", "next and distance are weights, and one of them is above 0".into());
        }
        let longest = self.limits.tokens + self.model.shape.tokens;
        if longest > self.model.decoder.positions {
            let positions = self.model.decoder.positions;
            return bad(
                "model.decoder.positions",
                format!("{positions} positions for {} tokens and model.shape.tokens", self.limits.tokens),
            );
        }
        self.train.validate().map_err(|(key, message)| (format!("train.{key}"), message))
    }
}

impl TaskSettings for SkeletonTaskConfig {
    const TASK: &'static str = "unirig_skeleton";

    own_settings!();

    fn limits(&self) -> Option<Limits> {
        Some(self.limits)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evaluations_see_what_training_does_unless_they_are_told_otherwise() {
        let mut c = SkeletonTaskConfig::default();
        c.sampling.cloud.vertices = 7;
        assert_eq!(c.eval_cloud(), c.sampling.cloud);
        c.sampling.cloud = CloudConfig::unirig_ar_training();
        c.eval.vertices = 8_192;
        assert_eq!((c.eval_cloud(), c.validate()), (CloudConfig::unirig_ar(), Ok(())));
        c.eval.points = 8;
        assert_eq!(c.validate().unwrap_err().0, "eval.points");
        (c.eval.points, c.eval.vertices) = (65_536, 65_537);
        assert_eq!(c.validate().unwrap_err().0, "eval.vertices");
    }

    #[test]
    fn a_frozen_token_is_one_of_the_vocabulary() {
        let ids = Vocabulary::new(&TokenizerConfig::default()).len() as u32;
        let of = |token| {
            let mut c = SkeletonTaskConfig::default();
            c.model.decoder.frozen_token = token;
            c.validate().map_err(|(key, _)| key)
        };
        assert_eq!([None, Some(1), Some(ids - 1)].map(of), [Ok(()), Ok(()), Ok(())]);
        assert_eq!(of(Some(ids)), Err("model.decoder.frozen_token".into()));
    }
}
