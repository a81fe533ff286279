//! Sizes and switches of the FSQ-CVAE.

use serde::{Deserialize, Serialize};

use super::decoder::{BONE_FEATURES, BONE_POINT_FEATURES, PRIOR, REGION};
use crate::embed::EmbedConfig;
use crate::layers::HeadSplit;

/// The skin auto-encoder of SkinTokens 3.2 and 4.1.3. The default is the paper's; what goes beyond
/// it stands in [`Extensions`] and is off there.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FsqCvaeConfig {
    /// Encoding of positions, for both encoders and the decoder's points.
    pub embed: EmbedConfig,
    /// Width of the condition encoder E_M and the skin encoder E_W.
    pub encoder_width: usize,
    /// Width of the decoder.
    pub decoder_width: usize,
    /// Attention heads, everywhere; divides both widths.
    pub heads: usize,
    /// Inner width of feed-forward layers over the width.
    pub mlp_ratio: f64,
    /// Self-attention blocks of each encoder, after its cross-attention block.
    pub encoder_layers: usize,
    /// Self-attention blocks of the decoder, before its cross-attention block.
    pub decoder_layers: usize,
    /// Channels of latent tokens, of the shape and of the skin before and after quantisation.
    pub latent: usize,
    /// FSQ levels of each axis. The paper: [8,8,8,5,5,5] = 64,000 codes; also [8,8,8,5,6] and, in
    /// the released weights, [8,8,8,8,8]. Axes that are learned have three or more.
    pub levels: Vec<i64>,
    /// What codes are made of.
    pub bottleneck: Bottleneck,
    /// Shape tokens T_W of the condition.
    pub shape_tokens: usize,
    /// Skin tokens T_D of a bone, at most.
    pub skin_tokens: usize,
    /// Where the skin encoder's queries come from.
    pub skin_queries: SkinQueries,
    /// How channels are dealt to heads; the released weights need `fused`.
    pub head_split: HeadSplit,
    /// What goes beyond the paper.
    pub extensions: Extensions,
}

/// What stands between encoder and decoder.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Bottleneck {
    /// Codes rounded to `levels`: numbers that a decoder can write as tokens.
    #[default]
    Fsq,
    /// Real numbers, one for each axis of `levels` that is learned, whose KL to N(0, 1) is a term of the loss: the
    /// continuous latent that SkinTokens leaves open. To be compared with; no tokens can be made of them.
    Gaussian,
}

/// Where the queries of the skin encoder come from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SkinQueries {
    /// A learned vector for each token: token k means the same for every bone, as nested dropout
    /// wants it.
    #[default]
    Learned,
    /// Farthest points of the skin encoder's cloud.
    Farthest,
    /// An extension: farthest points among those that the bone moves, from their weighted centre
    /// outwards, each with a learned vector of its slot. Coarse to fine, and where the weights are.
    Active,
}

/// Switches beyond the paper, all off by default. What each brought at small scale stands in
/// `experiments/README.md`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Extensions {
    /// Skin tokens reach the shape by cross-attention, whose keys are computed once a rig, instead
    /// of being joined with the shape tokens bone by bone.
    pub cross_condition: bool,
    /// Blocks in which the decoder's points attend to the shape alone, before any bone is known:
    /// computed once a rig for all its bones.
    pub shape_point_layers: usize,
    /// Blocks in which the decoder's points attend to a bone's tokens. The paper: 1.
    pub point_layers: usize,
    /// Inner width of those blocks' feed-forward layers over the width. 0 takes `mlp_ratio`.
    pub point_mlp_ratio: f64,
    /// The skin encoder is also told which points' weights pass the metric's threshold.
    pub active_bit: bool,
    /// The first three axes are told, not learned (needs `skin_queries = "active"` or `"farthest"`):
    /// of the first four codes, where the bone is and how large; of the others, where in that frame
    /// their query point lies. All points are also seen in the frame: a finger then looks like an arm.
    pub frame: bool,
    /// A weaker form of `frame`, and without it only: this times a query point's position is added to
    /// the first three quantised axes. 0 is off.
    pub anchor_skip: f64,
    /// Octaves of Fourier features with which codes enter the decoder. 0 is off.
    pub code_octaves: usize,
    /// The logit gains the product of a point's vector with one made from the bone's tokens.
    pub dot_head: bool,
    /// Start of the logit's bias: most weights are 0. The paper's code: 0.
    pub logit_bias: f64,
    /// The decoder is told the bone's own geometry: a token of its joints, and for each point how it
    /// lies to the bone and to its rivals.
    pub bone_geometry: bool,
    /// What geometry alone says of a bone's weights is told beside its codes, which are left to say what differs from it
    /// (needs `bone_geometry`): to the decoder, heat's weight at each point and how far the piece of surface around it
    /// belongs to the bone; to encoder and decoder the region nearest to the bone, in whose frame all points are seen.
    /// The decoder may then be asked without any code. With `frame`, the encoder sees points in the frame that codes
    /// tell, and the decoder in both; without any code the region is the frame.
    pub prior: bool,
}

impl Default for FsqCvaeConfig {
    fn default() -> Self {
        Self {
            embed: EmbedConfig::default(),
            encoder_width: 768,
            decoder_width: 768,
            heads: 12,
            mlp_ratio: 4.0,
            encoder_layers: 2,
            decoder_layers: 10,
            latent: 512,
            levels: vec![8, 8, 8, 5, 5, 5],
            bottleneck: Bottleneck::default(),
            shape_tokens: 384,
            skin_tokens: 32,
            skin_queries: SkinQueries::default(),
            head_split: HeadSplit::default(),
            extensions: Extensions::default(),
        }
    }
}

impl Default for Extensions {
    fn default() -> Self {
        Self {
            cross_condition: false,
            shape_point_layers: 0,
            point_layers: 1,
            point_mlp_ratio: 0.0,
            active_bit: false,
            frame: false,
            anchor_skip: 0.0,
            code_octaves: 0,
            dot_head: false,
            logit_bias: 0.0,
            bone_geometry: false,
            prior: false,
        }
    }
}

impl Extensions {
    /// Whether points are seen in a frame of each bone.
    pub(super) fn framed(&self) -> bool {
        self.frame || self.prior
    }

    /// Whether points are seen in the frame that codes tell and in the region that geometry tells.
    pub(super) fn framed_twice(&self) -> bool {
        self.frame && self.prior
    }

    /// Numbers per bone of [`super::BoneGeometry::bones`].
    pub fn bone_features(&self) -> usize {
        BONE_FEATURES + if self.prior { REGION } else { 0 }
    }

    /// Numbers per bone and point of [`super::BoneGeometry::points`].
    pub fn point_features(&self) -> usize {
        BONE_POINT_FEATURES + if self.prior { PRIOR } else { 0 }
    }
}

impl FsqCvaeConfig {
    /// The fewest codes that the decoder may be given: 0 with a prior, unless what codes tell is a term of the loss.
    pub fn fewest_codes(&self) -> usize {
        usize::from(!self.extensions.prior || self.bottleneck == Bottleneck::Gaussian)
    }

    /// Axes of a code that are learned; the first three are told with `extensions.frame`.
    pub fn learned_axes(&self) -> usize {
        self.levels.len() - if self.extensions.frame { 3 } else { 0 }
    }

    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let sizes = [
            ("encoder_width", self.encoder_width),
            ("decoder_width", self.decoder_width),
            ("heads", self.heads),
            ("latent", self.latent),
            ("shape_tokens", self.shape_tokens),
            ("skin_tokens", self.skin_tokens),
            ("extensions.point_layers", self.extensions.point_layers),
        ];
        if let Some((key, _)) = sizes.iter().find(|(_, n)| *n == 0) {
            return Err((key, format!("{key} must be at least 1")));
        }
        for (key, width) in [("encoder_width", self.encoder_width), ("decoder_width", self.decoder_width)] {
            if width % self.heads != 0 {
                return Err((key, format!("{key} = {width} is not divisible by heads = {}", self.heads)));
            }
        }
        if !(self.mlp_ratio > 0.0 && self.mlp_ratio <= 64.0) {
            return Err(("mlp_ratio", format!("mlp_ratio = {} must lie in (0, 64]", self.mlp_ratio)));
        }
        if self.embed.frequencies == 0 || self.embed.frequencies > 24 {
            return Err(("embed.frequencies", format!("{} frequencies: give 1 to 24", self.embed.frequencies)));
        }
        // Slower, all points look alike; faster, neighbours have nothing in common.
        if !(1e-3..=1e3).contains(&self.embed.base) {
            return Err(("embed.base", format!("base = {:?} must lie in [0.001, 1000]", self.embed.base)));
        }
        if let Err(e) = crate::fsq::Fsq::new(&self.levels) {
            return Err(("levels", e.to_string()));
        }
        let x = &self.extensions;
        // With two, bound(0) = tanh(3.8) · 0.5005 - 0.5: one of them from the start, and hardly a gradient.
        let told = if x.frame { 3 } else { 0 };
        if self.bottleneck == Bottleneck::Fsq && self.levels.iter().skip(told).any(|&l| l < 3) {
            let message = format!("levels {:?}: an axis of two levels does not learn; give three or more", self.levels);
            return Err(("levels", message));
        }
        for (key, on) in [("extensions.frame", x.frame), ("extensions.anchor_skip", x.anchor_skip != 0.0)] {
            if on && self.skin_queries == SkinQueries::Learned {
                let message = format!("{key} needs queries that are points: skin_queries = \"active\" or \"farthest\"");
                return Err((key, message));
            }
        }
        if !(-64.0..=64.0).contains(&x.anchor_skip) {
            let message = format!("anchor_skip = {:?} must lie in [-64, 64]", x.anchor_skip);
            return Err(("extensions.anchor_skip", message));
        }
        if x.anchor_skip != 0.0 && self.bottleneck == Bottleneck::Gaussian {
            let message = "anchor_skip adds to what is rounded: set it to 0, or bottleneck = \"fsq\"".into();
            return Err(("extensions.anchor_skip", message));
        }
        if x.anchor_skip != 0.0 && self.levels.len() < 3 {
            return Err((
                "extensions.anchor_skip",
                "anchor_skip writes to three axes: give at least three levels".into(),
            ));
        }
        if x.frame && x.anchor_skip != 0.0 {
            let message = "frame already tells where query points are: set anchor_skip = 0".into();
            return Err(("extensions.anchor_skip", message));
        }
        if x.prior && !x.bone_geometry {
            let message = "prior is told with the bone's geometry: set bone_geometry = true".into();
            return Err(("extensions.prior", message));
        }
        if x.frame && self.levels.len() < 4 {
            let message = "frame takes three axes: give at least four levels, so that something is learned".into();
            return Err(("extensions.frame", message));
        }
        if !(0.0..=64.0).contains(&x.point_mlp_ratio) {
            return Err((
                "extensions.point_mlp_ratio",
                format!("point_mlp_ratio = {} must lie in [0, 64]", x.point_mlp_ratio),
            ));
        }
        // Feed-forward layers round what they are wide inside.
        let narrow = |ratio: f64| (ratio * self.encoder_width.min(self.decoder_width) as f64).round() < 1.0;
        let ratios = [("mlp_ratio", self.mlp_ratio), ("extensions.point_mlp_ratio", x.point_mlp_ratio)];
        if let Some((key, ratio)) = ratios.into_iter().find(|(_, ratio)| *ratio > 0.0 && narrow(*ratio)) {
            return Err((key, format!("{ratio} of the width leaves feed-forward layers no channel: give more")));
        }
        // Beyond, sigmoids are 0 or 1 to the last bit, and nothing is learned.
        if !(-16.0..=16.0).contains(&x.logit_bias) {
            let message = format!("logit_bias = {} must lie in [-16, 16]", x.logit_bias);
            return Err(("extensions.logit_bias", message));
        }
        if x.code_octaves > 16 {
            return Err(("extensions.code_octaves", format!("code_octaves = {}: at most 16", x.code_octaves)));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn learned_axes_of_two_levels_are_refused() {
        let told = |levels: &[i64], frame| {
            let mut config =
                FsqCvaeConfig { levels: levels.to_vec(), skin_queries: SkinQueries::Farthest, ..Default::default() };
            config.extensions.frame = frame;
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(told(&[2, 3, 3, 3], false), Err("levels"));
        assert_eq!(told(&[2, 2, 2, 3], true), Ok(()), "what is told needs no gradient");
        assert_eq!(told(&[8, 8, 8, 2], true), Err("levels"));
        assert_eq!(told(&[3, 3], false), Ok(()));
    }

    #[test]
    fn embeddings_tell_points_apart() {
        let told = |base| {
            let mut config = FsqCvaeConfig::default();
            config.embed.base = base;
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(told(std::f64::consts::PI), Ok(()));
        assert_eq!([0.0, -1.0, 1e-40, 1e300, f64::NAN].map(told), [Err("embed.base"); 5]);
    }

    #[test]
    fn anchors_move_codes_by_a_few_levels() {
        let told = |skip| {
            let mut config = FsqCvaeConfig { skin_queries: SkinQueries::Active, ..Default::default() };
            config.extensions.anchor_skip = skip;
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!([told(1.0), told(-1.0)], [Ok(()); 2]);
        assert_eq!([1e30, -1e30, f64::NAN].map(told), [Err("extensions.anchor_skip"); 3]);
    }

    #[test]
    fn feed_forward_layers_have_a_channel() {
        let told = |ratio, point| {
            let mut config = FsqCvaeConfig { mlp_ratio: ratio, ..Default::default() };
            (config.encoder_width, config.decoder_width, config.heads) = (64, 128, 2);
            config.extensions.point_mlp_ratio = point;
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(told(1.0 / 64.0, 0.0), Ok(()));
        assert_eq!(told(0.001, 0.0), Err("mlp_ratio"));
        assert_eq!(told(4.0, 0.001), Err("extensions.point_mlp_ratio"));
    }

    #[test]
    fn weights_begin_where_they_can_be_learned() {
        let told = |bias| {
            let mut config = FsqCvaeConfig::default();
            config.extensions.logit_bias = bias;
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!([told(0.0), told(-2.5)], [Ok(()); 2]);
        assert_eq!([told(1e30), told(f64::NAN)], [Err("extensions.logit_bias"); 2]);
    }

    #[test]
    fn a_prior_is_told_with_geometry() {
        let told = |bone_geometry, frame| {
            let mut config = FsqCvaeConfig { skin_queries: SkinQueries::Active, ..Default::default() };
            config.extensions = Extensions { prior: true, bone_geometry, frame, ..Extensions::default() };
            config.validate().map_err(|(key, _)| key).map(|()| config.fewest_codes())
        };
        assert_eq!(told(true, false), Ok(0));
        assert_eq!(told(false, false), Err("extensions.prior"));
        assert_eq!(told(true, true), Ok(0));
        assert_eq!(FsqCvaeConfig::default().fewest_codes(), 1);
        let mut real = FsqCvaeConfig { bottleneck: Bottleneck::Gaussian, ..Default::default() };
        real.extensions.prior = true;
        assert_eq!(real.fewest_codes(), 1);
    }
}
