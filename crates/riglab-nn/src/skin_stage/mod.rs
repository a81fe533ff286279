//! UniRig's skin stage (4.2): weights and attributes of bones, given mesh and skeleton.
//!
//! The shape is read into tokens; bones, told by their joints, read the tokens; points read bones and tokens. For
//! each pair of point and bone, attention in every head and what is told of their distance become a logit.
//! Attributes come from attention the other way round.
//!
//! Names of parameters are those of the released weights, so far as the release has the part.
//! Shapes: b rigs, n points, j bones, t tokens, h heads, d width, p numbers told of a pair. Rigs of one
//! call have as many bones each: callers go rig by rig, so that no rig is seen by another, unless bones are filled
//! up as in the release, where they take part in all attentions and get no weight in the end.

mod attributes;
mod block;
mod bones;
mod config;
mod head;
pub mod loss;
pub mod ptv3;

use tch::{Kind, Tensor};

pub use attributes::{ATTRIBUTE_SCALE, ATTRIBUTES, AttributeHead};
pub use block::PostBlock;
pub use bones::BoneEncoder;
pub use config::{BoneConfig, BoneInput, PointConfig, PointEncoder, SkinModelConfig};
pub use head::Head;

use crate::embed::{EmbedConfig, EmbedKind, Embedding};
use crate::params::{Scope, Weights};
use crate::perceiver::Perceiver;
use block::Mapped;
use ptv3::{INPUT, Places, Ptv3};

/// The network.
pub struct SkinModel {
    shape: Perceiver,
    to_width: Mapped,
    bones: BoneEncoder,
    encoder: Encoder,
    to_points: Mapped,
    blocks: Vec<PostBlock>,
    head: Head,
    attributes: Option<AttributeHead>,
    mask_power: f64,
}

/// What reads points first.
enum Encoder {
    Ptv3(Box<Ptv3>),
    Light(Embedding),
}

/// A rig as the network has read it.
pub struct EncodedRig {
    /// The shape, [b, t, d].
    pub shape: Tensor,
    /// Bones before they read anything, [b, j, d].
    pub embedded: Tensor,
    /// Bones, [b, j, d].
    pub bones: Tensor,
    /// What points read: bones and shape, [b, j + t, d].
    pub context: Tensor,
}

impl SkinModel {
    /// The config was validated.
    pub fn new(mut at: Scope, c: &SkinModelConfig) -> Self {
        let shape = Perceiver::new(at.sub("global_encoder").sub("encoder"), &c.shape);
        let to_width = Mapped::new(at.sub("out_proj"), 0, c.shape.width, c.width);
        let bones = BoneEncoder::new(at.sub("bone_encoder"), c);
        let (encoder, width) = match c.points.encoder {
            PointEncoder::Ptv3 => {
                let net = Ptv3::new(at.sub("mesh_encoder"), &c.points.ptv3, INPUT);
                (Encoder::Ptv3(Box::new(net)), c.points.ptv3.output())
            }
            PointEncoder::Light => {
                let frequencies = c.points.frequencies;
                let config = EmbedConfig { kind: EmbedKind::Fourier, frequencies, base: std::f64::consts::PI };
                let embedding = Embedding::new(&config);
                let width = embedding.width() + 3;
                (Encoder::Light(embedding), width)
            }
        };
        let to_points = Mapped::new(at.sub("feat_map"), 0, width, c.width);
        let mut attn = at.sub("mesh_bone_attn");
        let blocks = (0..c.points.layers).map(|k| PostBlock::new(attn.sub(k), c.width, c.heads)).collect();
        let attributes = c.attributes.then(|| AttributeHead::new(at.sub("attributes"), c));
        let head = Head::new(at, c);
        let mask_power = c.mask_power;
        Self { shape, to_width, bones, encoder, to_points, blocks, head, attributes, mask_power }
    }

    /// Reads shape and bones: a cloud [b, n, 6] of positions and normals, those picked [b, t], and the points that are
    /// seen of each bone [b, j, 3 k].
    pub fn read(&self, w: &Weights, cloud: &Tensor, picks: &Tensor, bones: &Tensor) -> EncodedRig {
        self.read_shape(w, self.shape(w, cloud, picks), cloud, bones)
    }

    /// Shapes [b, t, d] of clouds [b, n, 6] with those picked [b, t].
    pub fn shape(&self, w: &Weights, cloud: &Tensor, picks: &Tensor) -> Tensor {
        self.to_width.forward(w, &self.shape.forward(w, cloud, picks))
    }

    /// As [`Self::read`], with the shape [b, t, d] as [`Self::shape`] gives it: of rigs that go on one by one, shapes can
    /// be read together.
    pub fn read_shape(&self, w: &Weights, shape: Tensor, cloud: &Tensor, bones: &Tensor) -> EncodedRig {
        let embedded = self.bones.embed(w, bones, cloud);
        let bones = self.bones.forward(w, &embedded, &shape);
        let context = Tensor::cat(&[&bones, &shape], 1);
        EncodedRig { shape, embedded, bones, context }
    }

    /// First features of points [b, n, c]: of a cloud [b, n, 6], with its places where the backbone reads it (its points
    /// of all clouds, one after another).
    pub fn encode(&self, w: &Weights, cloud: &Tensor, places: Option<&Places>) -> Tensor {
        match &self.encoder {
            Encoder::Ptv3(net) => {
                let places = places.expect("the backbone is told where points are");
                let features = cloud.constant_pad_nd([0, INPUT as i64 - 6]).flatten(0, 1);
                net.forward(w, &features, places).view([cloud.size()[0], cloud.size()[1], -1])
            }
            Encoder::Light(embedding) => {
                let at = embedding.forward(&cloud.narrow(2, 0, 3));
                Tensor::cat(&[at, cloud.narrow(2, 3, 3)], -1).to_kind(w.kind())
            }
        }
    }

    /// Points [b, n, c] as [`Self::encode`] gives them, before they read the rig, [b, n, d].
    pub fn map(&self, w: &Weights, encoded: &Tensor) -> Tensor {
        self.to_points.forward(w, &encoded.to_kind(w.kind()))
    }

    /// Points [b, n, c] as [`Self::encode`] gives them that read the rig, [b, n, d].
    pub fn points(&self, w: &Weights, read: &EncodedRig, encoded: &Tensor) -> Tensor {
        self.blocks.iter().fold(self.map(w, encoded), |x, block| block.forward(w, &x, &read.context))
    }

    /// Logits [b, n, j] of points [b, n, d] as [`Self::points`] gives them, with what is told of each pair [b, n, j, p].
    /// The weights are their softmax over the bones there are.
    pub fn logits(&self, w: &Weights, read: &EncodedRig, points: &Tensor, pairs: &Tensor) -> Tensor {
        self.head.logits(w, points, &read.bones, pairs)
    }

    /// Attributes [b, j, 7]; `None` without their head.
    pub fn attributes(&self, w: &Weights, read: &EncodedRig, points: &Tensor) -> Option<Tensor> {
        Some(self.attributes.as_ref()?.forward(w, &read.bones, points))
    }

    /// Weights [n, j] of one rig at any number of points, in memory for `pairs_at_once` pairs of point and bone beside
    /// the result: points [n, d] as [`Self::points`] gives them; `pairs` makes what is told of some of them [n', j, p].
    /// With a mask [n, j] where the config has a power for it.
    pub fn predict(
        &self,
        w: &Weights,
        read: &EncodedRig,
        points: &Tensor,
        pairs: impl Fn(i64, i64) -> Tensor,
        mask: Option<&Tensor>,
        pairs_at_once: usize,
    ) -> Tensor {
        let _guard = tch::no_grad_guard();
        let (n, j) = (points.size()[0], read.bones.size()[1]);
        let step = (pairs_at_once as i64 / j.max(1)).max(1);
        let parts = (0..n).step_by(step as usize).map(|start| {
            let count = step.min(n - start);
            let own = points.narrow(0, start, count).unsqueeze(0);
            let logits = self.logits(w, read, &own, &pairs(start, count).unsqueeze(0)).squeeze_dim(0);
            let weights = logits.softmax(-1, None::<Kind>);
            match mask.filter(|_| self.mask_power > 0.0) {
                Some(mask) => masked(&weights, &mask.narrow(0, start, count), self.mask_power),
                None => weights,
            }
        });
        Tensor::cat(&parts.collect::<Vec<_>>(), 0)
    }
}

/// softmax over the first `counts[b]` bones of rig b; those that only fill up get 0. Logits [b, n, j].
pub fn shares(logits: &Tensor, counts: &[i64]) -> Tensor {
    let bones = logits.size()[2];
    let each = counts.iter().enumerate().map(|(b, &count)| {
        let own = logits.get(b as i64).narrow(1, 0, count).softmax(-1, None::<Kind>);
        own.constant_pad_nd([0, bones - count])
    });
    Tensor::stack(&each.collect::<Vec<_>>(), 0)
}

/// Weights [.., j] times maskᵖ, rows summing to 1 again; a row that nothing would be left of stays as it was (as
/// released it would be undefined).
pub fn masked(weights: &Tensor, mask: &Tensor, power: f64) -> Tensor {
    let product = weights * mask.pow_tensor_scalar(power);
    let sum = product.sum_dim_intlist(-1, true, None::<Kind>);
    (&product / &sum).where_self(&sum.gt(0.0), weights)
}

/// The release's mask: a bone's own voxel weight and those of its direct children. `voxel` [n, j].
pub fn with_children(voxel: &Tensor, parents: &[Option<usize>]) -> Tensor {
    let (children, of): (Vec<i64>, Vec<i64>) =
        parents.iter().enumerate().filter_map(|(j, p)| Some((j as i64, (*p)? as i64))).unzip();
    let index = |v: &[i64]| Tensor::from_slice(v).to_device(voxel.device());
    voxel.index_add(1, &index(&of), &voxel.index_select(1, &index(&children)))
}

#[cfg(test)]
mod tests;
