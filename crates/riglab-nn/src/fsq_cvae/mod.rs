//! The FSQ-CVAE of SkinTokens: a bone's skinning weights as a few discrete tokens, given the mesh.
//!
//! E_M reads uniform surface points into shape tokens (the condition), E_W reads points with a
//! bone's weights into T_D latents, FSQ rounds each to one of a few thousand codes, and the decoder
//! gives the weight at any point from the first k codes and the shape. Any k works, since training
//! cuts the code list at random (nested dropout).
//!
//! Shapes: r rigs, m bones (m / r of each rig, rig by rig), n points of a cloud, p points asked,
//! t skin tokens, s shape tokens, l latent channels. A cloud is [.., 6]: position, unit normal.

mod config;
mod decoder;
mod encoder;

use tch::{Kind, Tensor};

pub use config::{Extensions, FsqCvaeConfig, SkinQueries};
pub use decoder::{BONE_FEATURES, BONE_POINT_FEATURES, BoneGeometry};

use crate::NnError;
use crate::embed::Embedding;
use crate::fsq::{Fsq, ProjectedFsq};
use crate::layers::{BlockConfig, Linear};
use crate::params::{Role, Scope, Weights};
use decoder::{Decoder, Sites};
use encoder::{Encoder, Queries, picked};

/// Weights above this count as held by the bone (SkinTokens' metric threshold).
pub const ACTIVE: f64 = 0.01;

/// The network.
pub struct FsqCvae {
    config: FsqCvaeConfig,
    embedding: Embedding,
    cond_encoder: Encoder,
    cond_quant: Linear,
    encoder: Encoder,
    quant: Linear,
    fsq: ProjectedFsq,
    post_quant: Linear,
    decoder: Decoder,
}

/// A rig's shape, encoded.
pub struct Shape {
    /// [r, s, l]
    pub tokens: Tensor,
    /// [r, s, 3]: the points they started from.
    pub positions: Tensor,
}

/// Points with the weights of one bone each.
pub struct SkinCloud {
    /// [m, n, 6]
    pub points: Tensor,
    /// [m, n]
    pub weights: Tensor,
    /// [m, t]: which points are queries, in token order; unused with learned queries.
    pub queries: Option<Tensor>,
}

impl FsqCvae {
    /// Builds the network; the config was validated.
    ///
    /// # Errors
    /// [`NnError::Config`] for impossible levels.
    pub fn new(mut at: Scope, config: &FsqCvaeConfig) -> Result<Self, NnError> {
        let c = config;
        let embedding = Embedding::new(&c.embed);
        let point = embedding.width() + 3;
        let block = BlockConfig {
            width: c.encoder_width,
            context_width: c.encoder_width,
            heads: c.heads,
            mlp_ratio: c.mlp_ratio,
            split: c.head_split,
            distance: c.extensions.distance_bias,
        };
        let learned = if c.skin_queries == SkinQueries::Farthest { 0 } else { c.skin_tokens };
        let skin_input = point + 1 + usize::from(c.extensions.active_bit);
        let to_latent = |at: Scope| {
            Linear::normal(at, Role::Projection, c.encoder_width, c.latent, 0.25 / (c.encoder_width as f64).sqrt(), 0.0)
        };
        Ok(Self {
            encoder: Encoder::new(at.sub("encoder"), block, skin_input, c.encoder_layers, learned),
            cond_encoder: Encoder::new(at.sub("cond_encoder"), block, point, c.encoder_layers, 0),
            decoder: Decoder::new(at.sub("decoder"), c, point),
            cond_quant: to_latent(at.sub("cond_quant")),
            quant: to_latent(at.sub("quant")),
            post_quant: Linear::normal(
                at.sub("post_quant"),
                Role::Projection,
                c.latent,
                c.decoder_width,
                0.25 / (c.latent as f64).sqrt(),
                0.0,
            ),
            fsq: ProjectedFsq::new(at.sub("FSQ"), &c.levels, c.latent, c.extensions.code_octaves)?,
            embedding,
            config: c.clone(),
        })
    }

    /// Its sizes.
    pub fn config(&self) -> &FsqCvaeConfig {
        &self.config
    }

    /// Its quantiser.
    pub fn fsq(&self) -> &Fsq {
        self.fsq.fsq()
    }

    /// The shape tokens of clouds [r, n, 6]; `queries` [r, s] are farthest points among them.
    pub fn encode_shape(&self, w: &Weights, cloud: &Tensor, queries: &Tensor) -> Shape {
        let positions = cloud.narrow(-1, 0, 3);
        let known = self.config.extensions.distance_bias.then_some(&positions);
        let features = self.features(w, cloud, &[]);
        let tokens = self.cond_encoder.forward(w, &features, &Queries::Points(queries), known);
        Shape { tokens: self.cond_quant.forward(w, &tokens), positions: picked(&positions, queries) }
    }

    /// The first `k` skin tokens before quantisation, [m, k, l].
    ///
    /// Queries attend to each other, so the k first of all are not the same as the first k alone;
    /// this is the second.
    pub fn encode_skin(&self, w: &Weights, cloud: &SkinCloud, k: usize) -> Tensor {
        let weights = cloud.weights.unsqueeze(-1);
        let bit = self.config.extensions.active_bit.then(|| weights.gt(ACTIVE).to_kind(weights.kind()));
        let extra: Vec<&Tensor> = std::iter::once(&weights).chain(&bit).collect();
        let features = self.features(w, &cloud.points, &extra);
        let k = k as i64;
        let positions = cloud.points.narrow(-1, 0, 3);
        let known = self.config.extensions.distance_bias.then_some(&positions);
        let tokens = match (self.config.skin_queries, &cloud.queries) {
            (SkinQueries::Learned, _) => self.encoder.forward(w, &features, &Queries::Learned(k), None),
            (_, Some(index)) => self.encoder.forward(w, &features, &Queries::Points(&index.narrow(1, 0, k)), known),
            (_, None) => panic!("queries that are points were not given"),
        };
        self.quant.forward(w, &tokens)
    }

    /// Latents [m, k, l] to codes [m, k, axes] in [-1, 1], gradients straight through.
    pub fn quantize(&self, w: &Weights, latent: &Tensor, cloud: &SkinCloud) -> Tensor {
        let anchors = self.anchors(cloud, latent.size()[1]);
        let keep = self.config.extensions.anchor_only.then(|| {
            let axes = self.config.levels.len();
            let keep: Vec<f32> = (0..axes).map(|i| if i < 3 { 0.0 } else { 1.0 }).collect();
            Tensor::from_slice(&keep).to_device(latent.device())
        });
        self.fsq.encode(w, latent, anchors.as_ref(), keep.as_ref())
    }

    /// Codes to latents [m, k, l], as the decoder's first layer reads them.
    pub fn dequantize(&self, w: &Weights, codes: &Tensor) -> Tensor {
        self.fsq.decode(w, codes)
    }

    /// Logits [m, p] of the weight at points [m, p, 6] (each bone's own) or [r, p, 6] (shared by a
    /// rig's bones), from codes [m, k, axes] and the shape. The weight is their sigmoid.
    pub fn decode(
        &self,
        w: &Weights,
        codes: &Tensor,
        shape: &Shape,
        points: &Tensor,
        geometry: Option<&BoneGeometry>,
    ) -> Tensor {
        let z = self.post_quant.forward(w, &self.dequantize(w, codes));
        let cond = self.post_quant.forward(w, &shape.tokens);
        let sites = self.config.extensions.distance_bias.then(|| Sites {
            // Where codes stand is told, not learned: no gradient.
            tokens: self.fsq().unbound(&codes.detach(), 3) / self.config.extensions.anchor_skip,
            shape: shape.positions.shallow_clone(),
            points: points.narrow(-1, 0, 3),
        });
        self.decoder.forward(w, &z, &cond, &self.features(w, points, &[]), geometry, sites.as_ref())
    }

    /// Encoded positions, normals and further columns, in the weights' kind.
    fn features(&self, w: &Weights, cloud: &Tensor, extra: &[&Tensor]) -> Tensor {
        let (positions, normals) = (cloud.narrow(-1, 0, 3), cloud.narrow(-1, 3, 3));
        let encoded = self.embedding.forward(&positions);
        let mut parts = vec![&encoded, &normals];
        parts.extend(extra);
        Tensor::cat(&parts, -1).to_kind(w.kind())
    }

    /// What `anchor_skip` adds before rounding: the queries' positions on the first three axes.
    fn anchors(&self, cloud: &SkinCloud, k: i64) -> Option<Tensor> {
        let factor = self.config.extensions.anchor_skip;
        let index = cloud.queries.as_ref().filter(|_| factor != 0.0)?.narrow(1, 0, k);
        let picked = picked(&cloud.points.narrow(-1, 0, 3), &index);
        let axes = self.config.levels.len() as i64;
        Some((&picked * factor).constant_pad_nd([0, axes - 3]).to_kind(if picked.kind() == Kind::Double {
            Kind::Double
        } else {
            Kind::Float
        }))
    }
}
