//! Attributes of spring bones.

use tch::{Kind, Tensor};

use super::SkinModelConfig;
use super::block::{Mapped, PostBlock};
use crate::layers::Linear;
use crate::params::{Role, Scope, Weights};

/// Numbers of a bone: stiffness, drag, power of gravity, its direction (3), hit radius, as VRM's spring bones define
/// them.
pub const ATTRIBUTES: usize = 7;

/// Attention the other way round (UniRig 4.2, E_A): each bone reads the points, and what it found becomes a row.
pub struct AttributeHead {
    read: PostBlock,
    layer: Mapped,
    out: Linear,
}

impl AttributeHead {
    /// The config was validated.
    pub fn new(mut at: Scope, c: &SkinModelConfig) -> Self {
        let mut net = at.sub("net");
        let layer = Mapped::new(net.sub("hidden"), 0, c.width, c.width);
        let out = Linear::new(net.sub("out"), Role::Projection, c.width, ATTRIBUTES, true);
        Self { read: PostBlock::new(at.sub("read"), c.width, c.heads), layer, out }
    }

    /// A row a bone [b, j, 7], from bones [b, j, d] and points [b, n, d].
    pub fn forward(&self, w: &Weights, bones: &Tensor, points: &Tensor) -> Tensor {
        let x = self.layer.forward(w, &self.read.forward(w, bones, points));
        let wide = if w.kind() == Kind::Double { Kind::Double } else { Kind::Float };
        self.out.forward(w, &x).to_kind(wide)
    }
}
