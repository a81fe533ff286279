//! Settings of the task.

use std::path::{Path, PathBuf};

use riglab_augment::Recipe;
use riglab_geom::CloudConfig;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::tokenrig::{Head, TokenRigConfig};
use riglab_token::{Limits, Parents, TokenizerConfig};
use riglab_train::TrainConfig;
use serde::{Deserialize, Serialize};

use super::Rigger;
use crate::assets::DataConfig;
use crate::fsq_cvae::cells;
use crate::sequences::Sequences;
use crate::settings::{TaskSettings, distinct, own_settings, weights};
use crate::unirig_skeleton::agree::Agreement;

/// Everything a run of TokenRig is made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TokenRigTaskConfig {
    /// The task's name: `tokenrig`.
    pub task: String,
    /// The class that every skeleton begins with whose joints' names tell none: those drawn freely, those that are given, and
    /// those of the corpora; empty for none. Published models that always had a class in training need one.
    pub class: String,
    /// Corpora and splits.
    pub data: DataConfig,
    /// How skeletons become tokens.
    pub tokenizer: TokenizerConfig,
    /// Longest skeletons: assets beyond are not trained on, and none is generated.
    pub limits: Limits,
    /// How skin weights become codes.
    pub skin: SkinConfig,
    /// The network.
    pub model: TokenRigConfig,
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

/// The auto-encoder of skin weights, which stays as it is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkinConfig {
    /// The folder of its run (task `fsq_cvae`); or a file of `riglab checkpoint`: an auto-encoder or a model that rigs;
    /// or `shipped_with_prior`, that of the model that comes with riglab; or `shipped`, that of the model before it.
    pub run: PathBuf,
    /// Codes of a bone, T_D: the first so many of those it was trained with. The paper: 4.
    pub codes: usize,
    /// A joint that holds no vertex has one token in place of its codes (an extension, with
    /// `model.head = "levels"`); otherwise it has codes of a bone without weights.
    pub empty: bool,
}

impl Default for SkinConfig {
    fn default() -> Self {
        Self { run: PathBuf::new(), codes: 4, empty: false }
    }
}

/// What a batch is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SamplingConfig {
    /// Rigs of a batch.
    pub rigs: usize,
    /// The points of each.
    pub cloud: CloudConfig,
    /// How often a rig's class is left out: its joints are then written like any other's.
    pub class_dropout: f32,
    /// Ways in which each rig is varied; the codes of each are made once, from points that stay the same, and kept. 0
    /// varies every rig anew each time.
    pub variants: u64,
}

impl Default for SamplingConfig {
    fn default() -> Self {
        Self { rigs: 12, cloud: CloudConfig::default(), class_dropout: 0.0, variants: 16 }
    }
}

/// Cross-entropy of the next token (SkinTokens 3.3), in both parts.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Weight of the skeleton's tokens.
    pub skeleton: f64,
    /// Weight of the skin codes.
    pub skin: f64,
    /// The skin's weight is 0 up to the first of these shares of the steps, grows as a half cosine, and is whole from
    /// the second on. As long as it is 0, skeletons alone are read: steps are shorter.
    pub skin_warmup: [f64; 2],
    /// Standard deviation, in cells, of what a coordinate's target is spread by (an extension).
    pub spread: f64,
}

impl Default for LossConfig {
    fn default() -> Self {
        Self { skeleton: 1.0, skin: 1.0, skin_warmup: [0.0, 0.0], spread: 0.0 }
    }
}

impl LossConfig {
    /// The skin's weight at a share of the steps.
    pub fn skin_weight(&self, done: f64) -> f64 {
        let [from, to] = self.skin_warmup;
        if done >= to {
            return self.skin;
        }
        let along = ((done - from) / (to - from)).clamp(0.0, 1.0);
        self.skin * (1.0 - (std::f64::consts::PI * along).cos()) / 2.0
    }

    /// Whether codes are asked for, and have no weight in any of so many steps.
    pub fn never_trains_codes(&self, steps: u64) -> bool {
        let last = steps.saturating_sub(1) as f64 / steps.max(1) as f64;
        self.skin > 0.0 && self.skin_weight(last) == 0.0
    }
}

/// Evaluation by generating.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvalConfig {
    /// How sequences are drawn; beams are of networks with `model.head = "flat"`. While training, they are left out:
    /// validations then take the likeliest tokens.
    pub generate: GenerateConfig,
    /// Skeletons that `riglab eval` and `riglab rig` make of each mesh, of which they take the one that the others agree
    /// with most (see [`riglab_metric::consensus`]): the one that `generate` gives, which is that of the likeliest tokens
    /// unless it samples, and others that are sampled; 1: the first alone.
    pub consensus: usize,
    /// Point clouds of each mesh that these draws are shared out to, each sampled anew.
    pub clouds: usize,
    /// Whether every other cloud is seen in the mirror, x for -x: for models that were trained so (`augment.flip`). What is
    /// drawn after it votes and is not taken.
    pub mirror: bool,
    /// Rounds in which the joints of the one that is taken move to where the others have them (see
    /// [`riglab_metric::refined`]).
    pub refine: usize,
    /// Whether a mesh that would be its own mirror image if it were turned about the vertical is looked at turned so, where
    /// what is drawn then agrees far better (an extension): for models that learned from rigs that mostly look one way.
    pub turn: bool,
    /// Whether, on a mesh that is its own mirror image, the joints of both sides are made mirror images of each other
    /// where there are several samples (an extension; see [`riglab_metric::symmetrised`]). For mirrored motions.
    pub symmetric: bool,
    /// Shares of each true skeleton's joints, the root with them, that are given to the model to be completed, as `riglab rig
    /// --complete` does: each has its rows among the skeletons. None: that is not evaluated.
    pub complete: Vec<f64>,
    /// Where branches may come from.
    pub parents: Parents,
    /// Rigs drawn at once; as many more as keep their keys and values below 1 GiB.
    pub rows: usize,
    /// Assets of the validation split that are generated while training, of each corpus by `data.weights`; 0 takes all.
    pub validation_assets: usize,
    /// Points that the baseline compares shapes by.
    pub retrieval_points: usize,
    /// Skins sampled for a skeleton, whose weights are averaged: the likeliest and random samples, so many in all. 1,
    /// the likeliest only, is the paper's.
    pub skins: usize,
    /// Share s of the auto-encoder's prediction without any code beside that mean (an extension): weights are the mean
    /// to the power of 1 - s, times that prediction to the power of s. On a mesh unlike the training ones, codes say
    /// less than geometry does. Auto-encoders without `model.extensions.prior` have no such prediction: it is then 0.
    pub without_codes: f32,
    /// How far weights that codes say are spread over the surface before they are cut, in distances of each vertex from
    /// its nearest bone; 0 leaves them as they are said vertex by vertex. Not in the paper.
    pub spread: f32,
    /// Shares below it are cut, then the four largest of a vertex are kept.
    pub cut: f32,
    /// Codes are asked for weights at so many vertices at most; the others of a larger mesh are told by the eight
    /// nearest of those, as released.
    pub vertices: usize,
    /// Cells along the longest side of the body for the baselines without learning.
    pub baseline_resolution: usize,
    /// Seeds the points that the encoders see, and the draws.
    pub seed: u64,
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            generate: GenerateConfig::default(),
            consensus: 1,
            clouds: 1,
            mirror: false,
            refine: 0,
            turn: false,
            symmetric: false,
            complete: Vec::new(),
            parents: Parents::default(),
            rows: 16,
            validation_assets: 32,
            retrieval_points: 512,
            skins: 1,
            without_codes: 0.0,
            spread: 0.0,
            cut: 0.05,
            vertices: 32_768,
            baseline_resolution: 128,
            seed: 0,
        }
    }
}

impl EvalConfig {
    /// How one skeleton is made of several.
    pub(crate) fn agreement(&self) -> Agreement {
        Agreement { draws: self.consensus, clouds: self.clouds, mirror: self.mirror, refine: self.refine }
    }

    /// Checks what is not a matter of all sequences.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub(crate) fn validate(&self) -> Result<(), (String, String)> {
        let bad = |key: &str, message: String| Err((key.to_owned(), message));
        self.agreement().validate().map_err(|(key, message)| (key.to_owned(), message))?;
        if let Some(share) = self.complete.iter().find(|share| !(0.0..1.0).contains(*share)) {
            return bad("eval.complete", format!("{share} is no share of joints to complete: give 0 up to below 1"));
        }
        distinct("eval.complete", &self.complete)?;
        if self.vertices == 0 {
            return bad("eval.vertices", "weights are made at 1 vertex or more".into());
        }
        cells("eval.baseline_resolution", self.baseline_resolution)?;
        if !(1..=1024).contains(&self.skins) {
            return bad("eval.skins", format!("skins = {} must lie in [1, 1024]", self.skins));
        }
        if !(0.0..=1.0).contains(&self.without_codes) {
            let message = format!("without_codes = {} is a share: give 0 to 1", self.without_codes);
            return bad("eval.without_codes", message);
        }
        if !(0.0..=10.0).contains(&self.spread) {
            let message = format!("spread = {} must lie in [0, 10], in distances to the nearest bone", self.spread);
            return bad("eval.spread", message);
        }
        if !(0.0..1.0).contains(&self.cut) {
            return bad("eval.cut", format!("cut = {} must lie in [0, 1)", self.cut));
        }
        Ok(())
    }
}

impl TokenRigTaskConfig {
    /// Tokens of a whole sequence at most, from `bos` to the last end.
    pub fn longest(&self) -> usize {
        self.limits.tokens.saturating_add(self.skin.codes.saturating_mul(self.limits.joints)).saturating_add(1)
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
        self.train.validate().map_err(|(key, message)| (format!("train.{key}"), message))?;
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
        self.eval.validate()?;
        if self.eval.generate.beams > 1 && self.model.head != Head::Flat {
            let why = "beams are of whole codes, and model.head = \"levels\" draws them level by level: give 1";
            return bad("eval.generate.beams", why.into());
        }
        if self.skin.codes == 0 {
            return bad("skin.codes", "a bone has at least 1 code".into());
        }
        if self.skin.empty && self.model.head != Head::Levels {
            return bad("skin.empty", "bones without codes need model.head = \"levels\"".into());
        }
        let l = &self.loss;
        weights(&[("loss.skeleton", l.skeleton), ("loss.skin", l.skin)])?;
        if l.skeleton == 0.0 && l.skin == 0.0 {
            return bad("loss.skeleton", "skeleton and skin are weights, and one of them is above 0".into());
        }
        let [from, to] = l.skin_warmup;
        if !(0.0 <= from && from <= to && to <= 1.0) {
            return bad("loss.skin_warmup", "give two shares of the steps, the first not above the second".into());
        }
        let longest = self.longest() + self.model.shape.tokens;
        if longest > self.model.decoder.positions {
            let positions = self.model.decoder.positions;
            return bad(
                "model.decoder.positions",
                format!(
                    "{positions} positions for up to {longest}: model.shape.tokens, limits.tokens, skin.codes × \
                     limits.joints and the end"
                ),
            );
        }
        Ok(())
    }
}

impl TaskSettings for TokenRigTaskConfig {
    const TASK: &'static str = "tokenrig";

    own_settings!();

    fn limits(&self) -> Option<Limits> {
        Some(self.limits)
    }

    fn in_run(&mut self, run: &Path) {
        Rigger::own_auto_encoder(run, self);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn beams_ask_for_codes_that_are_drawn_whole() {
        let of = |head, beams| {
            let mut c = TokenRigTaskConfig::default();
            c.model.decoder.positions = 1 << 16;
            c.skin.empty = head == Head::Levels;
            (c.model.head, c.eval.generate.beams) = (head, beams);
            c.validate().map_err(|(key, _)| key)
        };
        assert_eq!([of(Head::Flat, 1), of(Head::Flat, 10), of(Head::Levels, 1)], [Ok(()), Ok(()), Ok(())]);
        assert_eq!(of(Head::Levels, 2), Err("eval.generate.beams".into()));
    }

    #[test]
    fn the_skin_part_warms_up_as_a_half_cosine() {
        let loss = LossConfig { skin_warmup: [0.2, 0.6], ..LossConfig::default() };
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        near(loss.skin_weight(0.1), 0.0);
        near(loss.skin_weight(0.4), 0.5);
        near(loss.skin_weight(0.6), 1.0);
        near(LossConfig::default().skin_weight(0.0), 1.0);
        // The last of 60 steps stands at .983.
        let never = |skin, skin_warmup| {
            let loss = LossConfig { skin, skin_warmup, ..LossConfig::default() };
            loss.never_trains_codes(60)
        };
        assert_eq!([[0.0, 1.0], [0.5, 0.5], [0.98, 0.98], [0.9, 1.0]].map(|own| never(1.0, own)), [false; 4]);
        assert_eq!([[1.0, 1.0], [0.99, 1.0], [0.99, 0.99]].map(|own| never(1.0, own)), [true; 3]);
        assert!(!never(0.0, [1.0, 1.0]), "codes are not asked for");
    }
}
