//! Attributes of spring bones.

use tch::{Kind, Tensor};

use super::SkinModelConfig;
use super::block::{Mapped, PostBlock};
use crate::layers::Linear;
use crate::params::{Role, Scope, Weights};

/// Numbers of a bone: stiffness, drag, power of gravity, its direction (3), hit radius, as VRM's spring bones define
/// them.
pub const ATTRIBUTES: usize = 7;
/// About one over the spread of each attribute among creatures' springs: stiffness, drag, power of gravity, its
/// direction, which is down in nearly all, and the hit radius of a rig of size 2.
pub const ATTRIBUTE_SCALE: [f64; ATTRIBUTES] = [2.5, 12.0, 9.0, 1.0, 1.0, 1.0, 20.0];

/// Attention the other way round (UniRig 4.2, E_A): each bone reads the points, and what it found becomes a row.
pub struct AttributeHead {
    read: PostBlock,
    layer: Mapped,
    out: Linear,
    scale: [f32; ATTRIBUTES],
}

impl AttributeHead {
    /// The config was validated.
    pub fn new(mut at: Scope, c: &SkinModelConfig) -> Self {
        let mut net = at.sub("net");
        let layer = Mapped::new(net.sub("hidden"), 0, c.width, c.width);
        let out = Linear::new(net.sub("out"), Role::Projection, c.width, ATTRIBUTES, true);
        let scale = c.attribute_scale.map(|s| s as f32);
        Self { read: PostBlock::new(at.sub("read"), c.width, c.heads), layer, out, scale }
    }

    /// A row a bone [b, j, 7], from bones [b, j, d] and points [b, n, d].
    pub fn forward(&self, w: &Weights, bones: &Tensor, points: &Tensor) -> Tensor {
        let x = self.layer.forward(w, &self.read.forward(w, bones, points));
        let wide = if w.kind() == Kind::Double { Kind::Double } else { Kind::Float };
        let row = self.out.forward(w, &x).to_kind(wide);
        &row / Tensor::from_slice(&self.scale).to_device(row.device()).to_kind(wide)
    }
}
