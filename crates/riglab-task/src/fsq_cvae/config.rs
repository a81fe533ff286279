//! Settings of the task.

use riglab_augment::AffineConfig;
use riglab_nn::fsq_cvae::{Bottleneck, FsqCvaeConfig, SkinQueries};
use riglab_train::TrainConfig;
use serde::{Deserialize, Serialize};

use crate::assets::DataConfig;
use crate::settings::{TaskSettings, distinct, own_settings, weights};

/// Everything a run of the FSQ-CVAE is made of.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FsqCvaeTaskConfig {
    /// The task's name: `fsq_cvae`.
    pub task: String,
    /// Corpora and splits.
    pub data: DataConfig,
    /// The network.
    pub model: FsqCvaeConfig,
    /// What a batch is made of.
    pub sampling: SamplingConfig,
    /// How batches are varied.
    pub augment: AffineConfig,
    /// What is minimised.
    pub loss: LossConfig,
    /// How it is trained.
    pub train: TrainConfig,
    /// How it is evaluated.
    pub eval: EvalConfig,
}

/// Points of a batch (SkinTokens 4.1.3, hybrid importance sampling): the condition encoder sees
/// uniform points only; the skin encoder and the decoder also see points dense where a bone's
/// weights are not zero.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SamplingConfig {
    /// Rigs of a batch.
    pub rigs: usize,
    /// Bones of each rig.
    pub bones: usize,
    /// Points of the condition encoder, uniform on the surface.
    pub shape_points: usize,
    /// Of these, so many times as there are shape tokens are drawn, from which the tokens then start, each as far from the
    /// others as it can be; 0: from all of them.
    pub shape_drawn: usize,
    /// Points of the skin encoder.
    pub encoder: PointMix,
    /// Points the decoder is asked at.
    pub decoder: PointMix,
    /// Share of the skin encoder's and decoder's points that are vertices rather than points of the
    /// surface. Evaluation is on vertices.
    pub vertex_share: f32,
    /// How the number of codes given to the decoder is drawn, once a batch (nested dropout).
    pub prefix: PrefixConfig,
    /// How often each learned axis of a code that the decoder is given is one level off (an extension): codes that a model
    /// writes for a mesh are seldom exact.
    pub code_noise: f32,
    /// How far off the frames are that codes tell the decoder, with `model.extensions.frame` (an extension): the deviation
    /// of the centre, in deviations of the points, and of the size, in e-folds.
    pub frame_noise: f32,
    /// Rigs are drawn by their number of joints to this power: 0 all alike, 1 about every bone alike.
    pub bone_power: f32,
}

/// How many points of each kind, for each bone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PointMix {
    /// Where the bone's weights are not zero.
    pub active: usize,
    /// Where they are, but right beside those: the vertices that are easiest to get wrong (an extension).
    pub near: usize,
    /// Anywhere.
    pub uniform: usize,
}

impl PointMix {
    /// All of them.
    pub fn total(&self) -> usize {
        self.active + self.near + self.uniform
    }
}

/// Nested dropout: how many of the codes a batch keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PrefixConfig {
    /// Probability of all codes.
    pub full: f32,
    /// Else one of these, alike; empty: any number from 1 to all, from 0 with `model.extensions.prior`.
    pub lengths: Vec<usize>,
}

/// λ_BCE·BCE + λ_MSE·MSE + λ_Dice·Dice (SkinTokens 3.2.3; the λ are not published) and an extension.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LossConfig {
    /// Weight of the cross-entropy.
    pub bce: f64,
    /// Weight of the squared error.
    pub mse: f64,
    /// Weight of the Dice term, mean over bones.
    pub dice: f64,
    /// Weight of the cross-entropy of "passes the metric's threshold" (an extension).
    pub support: f64,
    /// Weight of how far codes are from filling their codebook (an extension).
    pub spread: f64,
    /// Weight of what a code tells, in nats, with `model.bottleneck = "gaussian"` (an extension); at 0 that is a plain
    /// auto-encoder.
    pub kl: f64,
}

/// Evaluation on whole meshes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvalConfig {
    /// Numbers of codes.
    pub prefixes: Vec<usize>,
    /// Vertices of each asset that validation looks at while training.
    pub validation_vertices: usize,
    /// Assets of the validation split that it looks at while training, of each corpus by `data.weights`; 0 takes all.
    pub validation_assets: usize,
    /// Cuts among which the decode rule's is chosen, on the validation split.
    pub cuts: Vec<f32>,
    /// Pairs of bone and vertex decoded at once: bounds memory.
    pub chunk: usize,
    /// Cells along the longest side of the body for the baselines without learning.
    pub baseline_resolution: usize,
    /// Seeds the points that the encoders see.
    pub seed: u64,
}

impl Default for SamplingConfig {
    fn default() -> Self {
        Self {
            rigs: 4,
            bones: 4,
            shape_points: 2048,
            shape_drawn: 0,
            encoder: PointMix { active: 512, near: 0, uniform: 512 },
            decoder: PointMix { active: 512, near: 0, uniform: 512 },
            vertex_share: 0.0,
            prefix: PrefixConfig::default(),
            code_noise: 0.0,
            frame_noise: 0.0,
            bone_power: 0.0,
        }
    }
}

impl Default for PrefixConfig {
    fn default() -> Self {
        Self { full: 0.0, lengths: Vec::new() }
    }
}

impl Default for LossConfig {
    fn default() -> Self {
        Self { bce: 1.0, mse: 0.1, dice: 1.0, support: 0.0, spread: 0.0, kl: 0.0 }
    }
}

impl Default for EvalConfig {
    fn default() -> Self {
        Self {
            prefixes: vec![4, 8, 16, 32],
            validation_vertices: 800,
            validation_assets: 64,
            cuts: vec![0.01, 0.02, 0.03, 0.05, 0.08, 0.12, 0.16, 0.2, 0.25],
            chunk: 1 << 13,
            baseline_resolution: 128,
            seed: 1,
        }
    }
}

impl FsqCvaeTaskConfig {
    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key path, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let at = |part: &str, e: (&str, String)| (format!("{part}.{}", e.0), e.1);
        self.data.validate()?;
        self.model.validate().map_err(|e| at("model", e))?;
        self.augment.validate().map_err(|e| at("augment", e))?;
        self.train.validate().map_err(|(k, m)| (format!("train.{k}"), m))?;
        let s = &self.sampling;
        let fault = |key: &str, message: String| Err((key.to_string(), message));
        for (key, n) in [
            ("sampling.rigs", s.rigs),
            ("sampling.bones", s.bones),
            ("sampling.encoder", s.encoder.total()),
            ("sampling.decoder", s.decoder.total()),
            ("eval.chunk", self.eval.chunk),
            ("eval.validation_vertices", self.eval.validation_vertices),
        ] {
            if n == 0 {
                return fault(key, format!("{key} must be at least 1"));
            }
        }
        if s.shape_points < self.model.shape_tokens {
            let (points, tokens) = (s.shape_points, self.model.shape_tokens);
            return fault(
                "sampling.shape_points",
                format!("{points} shape points are fewer than model.shape_tokens = {tokens}: each starts at a point"),
            );
        }
        let needed = match self.model.skin_queries {
            SkinQueries::Learned => 0,
            SkinQueries::Farthest => s.encoder.total(),
            SkinQueries::Active => s.encoder.active,
        };
        if self.model.skin_queries != SkinQueries::Learned && needed < self.model.skin_tokens {
            let tokens = self.model.skin_tokens;
            return fault(
                "sampling.encoder",
                format!("{needed} points for model.skin_tokens = {tokens} queries: each starts at a point"),
            );
        }
        if !(-4.0..=4.0).contains(&s.bone_power) {
            return fault("sampling.bone_power", format!("bone_power = {} must lie in [-4, 4]", s.bone_power));
        }
        if !(0.0..=1.0).contains(&s.vertex_share) {
            return fault("sampling.vertex_share", format!("vertex_share = {} must lie in [0, 1]", s.vertex_share));
        }
        if !(0.0..=1.0).contains(&s.prefix.full) {
            return fault("sampling.prefix.full", format!("full = {} must lie in [0, 1]", s.prefix.full));
        }
        let fewest = self.model.fewest_codes();
        if s.prefix.lengths.iter().any(|&k| k < fewest) {
            let message = "a prefix of 0 codes needs model.extensions.prior = true and model.bottleneck = \"fsq\"";
            return fault("sampling.prefix.lengths", message.into());
        }
        if let Some(k) = s.prefix.lengths.iter().find(|&&k| k > self.model.skin_tokens) {
            let most = self.model.skin_tokens;
            return fault("sampling.prefix.lengths", format!("{k} codes are more than model.skin_tokens = {most}"));
        }
        if !(0.0..=1.0).contains(&s.code_noise) {
            return fault("sampling.code_noise", format!("code_noise = {} must lie in [0, 1]", s.code_noise));
        }
        if s.code_noise > 0.0 && self.model.bottleneck == Bottleneck::Gaussian {
            let message = "real numbers have no levels: set code_noise = 0, or model.bottleneck = \"fsq\"";
            return fault("sampling.code_noise", message.into());
        }
        if !(0.0..=2.0).contains(&s.frame_noise) {
            return fault("sampling.frame_noise", format!("frame_noise = {} must lie in [0, 2]", s.frame_noise));
        }
        if s.frame_noise > 0.0 && !self.model.extensions.frame {
            let message = "no code tells a frame: set frame_noise = 0, or model.extensions.frame = true";
            return fault("sampling.frame_noise", message.into());
        }
        let l = &self.loss;
        weights(&[
            ("loss.bce", l.bce),
            ("loss.mse", l.mse),
            ("loss.dice", l.dice),
            ("loss.support", l.support),
            ("loss.spread", l.spread),
            ("loss.kl", l.kl),
        ])?;
        if [l.bce, l.mse, l.dice, l.support].iter().all(|&v| v == 0.0) {
            return fault("loss", "every part of the loss has weight 0".into());
        }
        match self.model.bottleneck {
            Bottleneck::Fsq if l.kl != 0.0 => {
                let message = "rounded codes have no divergence: set kl = 0, or model.bottleneck = \"gaussian\"";
                return fault("loss.kl", message.into());
            }
            Bottleneck::Gaussian if l.spread != 0.0 => {
                let message = "real numbers have no codebook to fill: set spread = 0, or model.bottleneck = \"fsq\"";
                return fault("loss.spread", message.into());
            }
            _ => {}
        }
        if let Some(k) = self.eval.prefixes.iter().find(|&&k| k < fewest || k > self.model.skin_tokens) {
            return fault(
                "eval.prefixes",
                format!("a prefix of {k} codes, the model has {fewest} to {}", self.model.skin_tokens),
            );
        }
        distinct("eval.prefixes", &self.eval.prefixes)?;
        if self.eval.prefixes.is_empty() {
            return fault("eval.prefixes", "give at least one prefix".into());
        }
        cuts("eval.cuts", &self.eval.cuts)?;
        cells("eval.baseline_resolution", self.eval.baseline_resolution)
    }
}

impl TaskSettings for FsqCvaeTaskConfig {
    const TASK: &'static str = "fsq_cvae";

    own_settings!();

    fn chooses_a_cut(&self) -> bool {
        self.eval.cuts.len() > 1
    }
}

/// Checks the cuts that a decode rule's is chosen among.
///
/// # Errors
/// (key path, message).
pub(crate) fn cuts(key: &str, all: &[f32]) -> Result<(), (String, String)> {
    match all.iter().find(|cut| !(0.0..1.0).contains(*cut)) {
        Some(cut) => Err((key.into(), format!("a cut of {cut} must lie in [0, 1): weights below it are dropped"))),
        None if all.is_empty() => Err((key.into(), "give at least one cut".into())),
        None => Ok(()),
    }
}

/// Checks cells along the longest side of a body.
///
/// # Errors
/// (key path, message).
pub(crate) fn cells(key: &str, n: usize) -> Result<(), (String, String)> {
    if (8..=512).contains(&n) { Ok(()) } else { Err((key.into(), format!("{n} cells: give 8 to 512"))) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_would_count_twice_and_cuts_that_keep_nothing_are_refused() {
        let key = |change: fn(&mut FsqCvaeTaskConfig)| {
            let mut config = FsqCvaeTaskConfig::default();
            change(&mut config);
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(key(|c| c.eval.prefixes = vec![16, 4, 16]), Err("eval.prefixes".into()));
        assert_eq!(key(|c| c.eval.prefixes.clear()), Err("eval.prefixes".into()));
        assert_eq!(key(|c| c.eval.cuts = vec![0.1, 2.0]), Err("eval.cuts".into()));
        assert_eq!(key(|c| c.eval.cuts.clear()), Err("eval.cuts".into()));
        assert_eq!(key(|c| c.data.test = vec!["a".into(), "a".into()]), Err("data.test".into()));
        assert_eq!(key(|c| c.data.corpora = vec!["a.h5".into(), "".into()]), Err("data.corpora".into()));
        assert_eq!(key(|c| c.data.train = vec!["a".into(), "b".into(), "a".into()]), Err("data.train".into()));
        // How often a length is drawn is said by how often it is named.
        assert_eq!(key(|c| c.sampling.prefix.lengths = vec![4, 4, 8]), Ok(()));
        for wrong in [f32::NAN, 1000.0, -50.0] {
            let mut config = FsqCvaeTaskConfig::default();
            config.sampling.bone_power = wrong;
            assert_eq!(config.validate().unwrap_err().0, "sampling.bone_power");
        }
        let beyond = |c: &mut FsqCvaeTaskConfig| c.sampling.prefix.lengths = vec![4, c.model.skin_tokens + 1];
        assert_eq!(key(beyond), Err("sampling.prefix.lengths".into()));
    }

    #[test]
    fn no_code_at_all_needs_a_prior_and_noise_needs_levels() {
        let told = |prior: bool, change: fn(&mut FsqCvaeTaskConfig)| {
            let mut config = FsqCvaeTaskConfig::default();
            (config.model.extensions.prior, config.model.extensions.bone_geometry) = (prior, prior);
            change(&mut config);
            config.validate().map_err(|(key, _)| key)
        };
        let lengths: fn(&mut FsqCvaeTaskConfig) = |c| c.sampling.prefix.lengths = vec![0, 4];
        let prefixes: fn(&mut FsqCvaeTaskConfig) = |c| c.eval.prefixes = vec![0, 4];
        assert_eq!([told(true, lengths), told(true, prefixes)], [Ok(()), Ok(())]);
        assert_eq!(told(false, lengths).unwrap_err(), "sampling.prefix.lengths");
        assert_eq!(told(false, prefixes).unwrap_err(), "eval.prefixes");
        assert_eq!(told(false, |c| c.sampling.code_noise = 0.2), Ok(()));
        for wrong in [-0.1, 1.1, f32::NAN] {
            let mut config = FsqCvaeTaskConfig::default();
            config.sampling.code_noise = wrong;
            assert_eq!(config.validate().unwrap_err().0, "sampling.code_noise");
        }
        let real: fn(&mut FsqCvaeTaskConfig) = |c| {
            c.sampling.code_noise = 0.2;
            c.model.bottleneck = Bottleneck::Gaussian;
        };
        assert_eq!(told(false, real).unwrap_err(), "sampling.code_noise");
        let frames: fn(&mut FsqCvaeTaskConfig) = |c| {
            c.sampling.frame_noise = 0.2;
            (c.model.extensions.frame, c.model.skin_queries) = (true, SkinQueries::Active);
        };
        assert_eq!([told(false, frames), told(true, frames)], [Ok(()), Ok(())]);
        assert_eq!(told(true, |c| c.sampling.frame_noise = 0.2).unwrap_err(), "sampling.frame_noise");
        let none: fn(&mut FsqCvaeTaskConfig) = |c| {
            c.sampling.prefix.lengths = vec![0];
            c.model.bottleneck = Bottleneck::Gaussian;
        };
        assert_eq!(told(true, none).unwrap_err(), "sampling.prefix.lengths");
    }
}
