//! Bones as features.

use tch::Tensor;

use super::SkinModelConfig;
use super::block::{Mapped, PostBlock};
use crate::embed::{EmbedConfig, EmbedKind, Embedding};
use crate::params::{Scope, Weights};

/// Where bones are, encoded; then blocks in which they read each other and the shape.
pub struct BoneEncoder {
    embedding: Embedding,
    layers: [Mapped; 3],
    blocks: Vec<PostBlock>,
    from_corner: bool,
}

impl BoneEncoder {
    /// The config was validated.
    pub fn new(mut at: Scope, c: &SkinModelConfig) -> Self {
        let kind =
            EmbedConfig { kind: EmbedKind::Fourier, frequencies: c.bones.frequencies, base: std::f64::consts::PI };
        let embedding = Embedding::new(&kind);
        let (input, e) = (c.bones.seen.points() * embedding.width(), c.bones.embed);
        let mut layer = |first, input, output| Mapped::new(at.sub("bone_encoder"), first, input, output);
        let layers = [layer(1, input, e), layer(4, e, 4 * e), layer(7, 4 * e, c.width)];
        let mut attn = at.sub("attn");
        let blocks = (0..c.bones.layers).map(|k| PostBlock::new(attn.sub(k), c.width, c.heads)).collect();
        Self { embedding, layers, blocks, from_corner: c.bones.from_corner }
    }

    /// Bones [b, j, 3 k], the points that are seen of each, and the cloud [b, n, 6] they lie in, to [b, j, d].
    pub fn embed(&self, w: &Weights, bones: &Tensor, cloud: &Tensor) -> Tensor {
        let (b, j, c) = bones.size3().expect("three axes");
        let points = bones.view([b, j, c / 3, 3]);
        let corner = || cloud.narrow(2, 0, 3).amin([1], true).unsqueeze(1);
        // Into memory of its own, as a view shares the caller's.
        let points = if self.from_corner { &points - corner() } else { points };
        let x = self.embedding.forward(&points).flatten(2, 3).to_kind(w.kind());
        self.layers.iter().fold(x, |x, layer| layer.forward(w, &x))
    }

    /// Embedded bones [b, j, d] that read themselves as they were at first, and the shape [b, t, d].
    pub fn forward(&self, w: &Weights, embedded: &Tensor, shape: &Tensor) -> Tensor {
        let keys = Tensor::cat(&[embedded, shape], 1);
        self.blocks.iter().fold(embedded.shallow_clone(), |x, block| block.forward(w, &x, &keys))
    }
}
