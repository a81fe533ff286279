//! Sizes and switches of the skin stage.

use serde::{Deserialize, Serialize};

use super::attributes::{ATTRIBUTE_SCALE, ATTRIBUTES};
use super::ptv3::Ptv3Config;
use crate::perceiver::PerceiverConfig;

/// UniRig's skin stage (4.2). The default is the paper's, with the sizes of the release, which is silent on
/// none of them; [`Self::released`] is the public code.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SkinModelConfig {
    /// Width F of points, bones and latents.
    pub width: usize,
    /// Heads H, of all attentions here and of the weights.
    pub heads: usize,
    /// Inner width of the network that makes a logit of each pair of point and bone.
    pub mlp: usize,
    /// Its hidden layers.
    pub mlp_layers: usize,
    /// Numbers that are told of each pair of point and bone. The paper: 1, their distance.
    pub pair: usize,
    /// An extension: what is told of a pair also goes past the heads, through a layer of this width into the network
    /// and by a linear map into the logit. 0 is off: it then passes a layer as wide as there are heads, with a norm.
    pub pair_width: usize,
    /// The shape as tokens that points and bones read.
    pub shape: PerceiverConfig,
    /// How bones become features.
    pub bones: BoneConfig,
    /// How points become features.
    pub points: PointConfig,
    /// Whether attributes of spring bones are predicted.
    pub attributes: bool,
    /// What the network tells of each attribute is this many times it: stiffness, drag, power of gravity, its direction,
    /// hit radius. About one over their spread, so that a step of an optimizer moves all of them alike; in their own
    /// units a step that is small for stiffness throws the hit radius about.
    pub attribute_scale: [f64; ATTRIBUTES],
    /// Weights are multiplied by the mask that comes with a prediction to this power (the release: 3). 0 is off.
    pub mask_power: f64,
}

/// How bones become features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BoneConfig {
    /// What of a bone is seen.
    pub seen: BoneInput,
    /// Whether positions count from the least corner of the cloud, as in the release, rather than from the
    /// middle of the cube.
    pub from_corner: bool,
    /// Frequencies of their encoding, from π.
    pub frequencies: usize,
    /// Width of the first layer; the second is four times as wide.
    pub embed: usize,
    /// Blocks in which bones read each other and the shape.
    pub layers: usize,
}

/// What the encoder sees of a bone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BoneInput {
    /// The joint (the release).
    Joint,
    /// The parent joint and the joint (the paper).
    #[default]
    ParentAndJoint,
    /// An extension: both and the tail.
    ParentJointAndTail,
}

impl BoneInput {
    /// How many points that is.
    pub fn points(self) -> usize {
        match self {
            Self::Joint => 1,
            Self::ParentAndJoint => 2,
            Self::ParentJointAndTail => 3,
        }
    }
}

/// How points become features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PointConfig {
    /// What reads them first.
    pub encoder: PointEncoder,
    /// Frequencies of positions, from π, of the light encoder.
    pub frequencies: usize,
    /// Sizes of the backbone.
    pub ptv3: Ptv3Config,
    /// Blocks in which points read bones and shape.
    pub layers: usize,
}

/// What reads points first.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PointEncoder {
    /// The backbone: points see those around them. Weights are then known at the cloud's points.
    #[default]
    Ptv3,
    /// A layer for each point alone, which learns of the shape by reading its tokens. Weights are then known
    /// wherever one asks.
    Light,
}

impl Default for SkinModelConfig {
    fn default() -> Self {
        Self {
            width: 768,
            heads: 16,
            mlp: 512,
            mlp_layers: 4,
            pair: 1,
            pair_width: 0,
            shape: PerceiverConfig::default(),
            bones: BoneConfig::default(),
            points: PointConfig::default(),
            attributes: true,
            attribute_scale: ATTRIBUTE_SCALE,
            mask_power: 0.0,
        }
    }
}

impl Default for BoneConfig {
    fn default() -> Self {
        Self { seen: BoneInput::default(), from_corner: false, frequencies: 6, embed: 1024, layers: 8 }
    }
}

impl Default for PointConfig {
    fn default() -> Self {
        Self { encoder: PointEncoder::default(), frequencies: 6, ptv3: Ptv3Config::default(), layers: 16 }
    }
}

impl SkinModelConfig {
    /// UniRig's public code.
    pub fn released() -> Self {
        let bones = BoneConfig { seen: BoneInput::Joint, from_corner: true, ..BoneConfig::default() };
        let ptv3 = Ptv3Config { norm: super::ptv3::Norm::Batch, ..Ptv3Config::default() };
        let points = PointConfig { ptv3, ..PointConfig::default() };
        Self { bones, points, attributes: false, mask_power: 3.0, ..Self::default() }
    }

    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let sizes = [
            ("width", self.width),
            ("heads", self.heads),
            ("mlp", self.mlp),
            ("mlp_layers", self.mlp_layers),
            ("pair", self.pair),
            ("bones.embed", self.bones.embed),
        ];
        if let Some((key, _)) = sizes.iter().find(|(_, n)| *n == 0) {
            return Err((key.to_string(), format!("{key} must be at least 1")));
        }
        if !self.width.is_multiple_of(self.heads) {
            let (width, heads) = (self.width, self.heads);
            return Err(("width".into(), format!("width = {width} is not divisible by heads = {heads}")));
        }
        for (key, n) in [("bones.frequencies", self.bones.frequencies), ("points.frequencies", self.points.frequencies)]
        {
            if n > 24 {
                return Err((key.into(), format!("{n} frequencies: give at most 24")));
            }
        }
        if let Some(s) = self.attribute_scale.iter().find(|s| !(1e-6..=1e6).contains(*s)) {
            return Err(("attribute_scale".into(), format!("attribute_scale has {s:?}: each must lie in [1e-6, 1e6]")));
        }
        if !(0.0..=64.0).contains(&self.mask_power) {
            return Err(("mask_power".into(), format!("mask_power = {} must lie in [0, 64]", self.mask_power)));
        }
        self.shape.validate().map_err(|(key, message)| (format!("shape.{key}"), message))?;
        if self.shape.sorted {
            return Err(("shape.sorted".into(), "the skin stage reads its tokens in no order: leave it off".into()));
        }
        if self.points.encoder == PointEncoder::Ptv3 {
            self.points.ptv3.validate().map_err(|(key, message)| (format!("points.ptv3.{key}"), message))?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scales_and_grids_tell_attributes_and_points_apart() {
        let key = |change: fn(&mut SkinModelConfig)| {
            let mut config = SkinModelConfig::default();
            config.points.encoder = PointEncoder::Ptv3;
            change(&mut config);
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(key(|_| ()), Ok(()));
        for wrong in [0.0, 1e-40, 1e300, f64::NAN] {
            let mut config = SkinModelConfig::default();
            config.attribute_scale[3] = wrong;
            assert_eq!(config.validate().unwrap_err().0, "attribute_scale");
        }
        assert_eq!(key(|c| c.points.ptv3.grid = 1e-9), Err("points.ptv3.grid".into()));
        assert_eq!(key(|c| c.points.ptv3.grid = 1e6), Err("points.ptv3.grid".into()));
    }
}
