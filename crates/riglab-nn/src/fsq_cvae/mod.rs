//! The FSQ-CVAE of SkinTokens: a bone's skinning weights as a few discrete tokens, given the mesh.
//!
//! E_M reads uniform surface points into shape tokens (the condition), E_W reads points with a
//! bone's weights into T_D latents, FSQ rounds each to one of a few thousand codes, and the decoder
//! gives the weight at any point from k codes and the shape. Any k works, since training draws how
//! many E_W is asked for (nested dropout).
//!
//! Shapes: r rigs, m bones (m / r of each rig, rig by rig), n points of a cloud, p points asked,
//! t skin tokens, s shape tokens, l latent channels. A cloud is [.., 6]: position, unit normal.

mod config;
mod decoder;
mod encoder;
mod frame;
mod gaussian;

use tch::{Kind, Tensor};

pub use config::{Bottleneck, Extensions, FsqCvaeConfig, SkinQueries};
pub use decoder::{BONE_FEATURES, BONE_POINT_FEATURES, BoneGeometry, PRIOR, REGION, ReadBones};
pub use frame::SIZES as FRAME_SIZES;
pub use gaussian::{Coded, GaussianCode};

use crate::NnError;
use crate::embed::Embedding;
use crate::fsq::{Fsq, ProjectedFsq};
use crate::layers::{BlockConfig, Linear, picked};
use crate::params::{Role, Scope, Weights};
use decoder::Decoder;
use encoder::{Encoder, Queries};
use frame::{Frame, FrameCoder};
use gaussian::Gaussian;

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
    gaussian: Option<Gaussian>,
    frame: Option<FrameCoder>,
    post_quant: Linear,
    decoder: Decoder,
}

/// Points with the weights of one bone each.
pub struct SkinCloud {
    /// [m, n, 6]
    pub points: Tensor,
    /// [m, n]
    pub weights: Tensor,
    /// [m, t]: which points are queries, in token order; unused with learned queries.
    pub queries: Option<Tensor>,
    /// [m, [`REGION`]]: each bone's region, with the extension `prior`; unused with `frame`.
    pub regions: Option<Tensor>,
    /// [m, [`REGION`]]: how far off the frame is that codes tell, in deviations and in e-folds of size; with the
    /// extension `frame`, where it is not told as it is.
    pub off: Option<Tensor>,
}

impl SkinCloud {
    /// [m, n, 3]
    fn positions(&self) -> Tensor {
        self.points.narrow(-1, 0, 3)
    }

    /// Where the first `k` queries are, [m, k, 3]; the config was checked to have queries that are points.
    fn places(&self, k: i64) -> Tensor {
        let queries = self.queries.as_ref().expect("queries that are points");
        picked(&self.positions(), &queries.narrow(1, 0, k))
    }
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
        };
        let learned = if c.skin_queries == SkinQueries::Farthest { 0 } else { c.skin_tokens };
        let framed = if c.extensions.framed() { frame::POINT } else { 0 };
        let skin_input = point + 1 + usize::from(c.extensions.active_bit) + framed;
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
            gaussian: (c.bottleneck == Bottleneck::Gaussian)
                .then(|| Gaussian::new(at.sub("log_variance"), c.latent, c.learned_axes())),
            frame: c.extensions.frame.then(|| FrameCoder::new(&c.levels)),
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

    /// The shape tokens [r, s, l] of clouds [r, n, 6]; `queries` [r, s] are farthest points among them.
    pub fn encode_shape(&self, w: &Weights, cloud: &Tensor, queries: &Tensor) -> Tensor {
        let tokens = self.cond_encoder.forward(w, &self.features(w, cloud, &[]), &Queries::Points(queries));
        self.cond_quant.forward(w, &tokens)
    }

    /// The first `k` skin tokens before quantisation, [m, k, l].
    ///
    /// Queries attend to each other, so the k first of all are not the same as the first k alone;
    /// this is the second.
    pub fn encode_skin(&self, w: &Weights, cloud: &SkinCloud, k: usize) -> Tensor {
        let weights = cloud.weights.unsqueeze(-1);
        let bit = self.config.extensions.active_bit.then(|| weights.gt(ACTIVE).to_kind(weights.kind()));
        let known = || cloud.regions.as_ref().map(|regions| Frame::known(regions, k as i64));
        let told = self.frame.as_ref().map(|coder| coder.of(&cloud.positions(), &cloud.weights));
        let frame = told.or_else(known).map(|f| f.point_features(&cloud.positions()));
        let extra: Vec<&Tensor> = std::iter::once(&weights).chain(&bit).chain(&frame).collect();
        let features = self.features(w, &cloud.points, &extra);
        let k = k as i64;
        let tokens = match (self.config.skin_queries, &cloud.queries) {
            (SkinQueries::Learned, _) => self.encoder.forward(w, &features, &Queries::Learned(k)),
            (_, Some(index)) => self.encoder.forward(w, &features, &Queries::Points(&index.narrow(1, 0, k))),
            (_, None) => panic!("queries that are points were not given"),
        };
        self.quant.forward(w, &tokens)
    }

    /// Latents [m, k, l] to codes [m, k, axes]: rounded, in [-1, 1], gradients straight through; or real numbers, drawn
    /// with `noise` [m, k, [`FsqCvaeConfig::learned_axes`]] from N(0, 1), their means without.
    pub fn code(&self, w: &Weights, latent: &Tensor, cloud: &SkinCloud, noise: Option<&Tensor>) -> Coded {
        let k = latent.size()[1];
        let learned = match &self.gaussian {
            Some(gaussian) => gaussian.code(w, &self.unrounded(w, latent), latent, noise),
            None => {
                let codes = self.fsq.encode(w, latent, self.anchors(cloud, k).as_ref());
                Coded { codes: self.learned(codes), said: None }
            }
        };
        let Some(coder) = &self.frame else { return learned };
        let told = coder.tell(&cloud.positions(), &cloud.weights, &cloud.places(k), cloud.off.as_ref());
        Coded { codes: Tensor::cat(&[told, learned.codes], 2), ..learned }
    }

    /// As [`Self::code`], the codes alone and nothing drawn.
    pub fn quantize(&self, w: &Weights, latent: &Tensor, cloud: &SkinCloud) -> Tensor {
        self.code(w, latent, cloud, None).codes
    }

    /// Of the learned axes, what is rounded, without anchors [m, k, axes]: for [`crate::loss::spread`].
    pub fn unrounded(&self, w: &Weights, latent: &Tensor) -> Tensor {
        self.learned(self.fsq.project(w, latent))
    }

    /// Of all axes [m, k, axes] those that are learned.
    fn learned(&self, all: Tensor) -> Tensor {
        let learned = self.config.learned_axes() as i64;
        let told = all.size()[2] - learned;
        if told == 0 { all } else { all.narrow(-1, told, learned) }
    }

    /// Codes to latents [m, k, l], as the decoder's first layer reads them.
    pub fn dequantize(&self, w: &Weights, codes: &Tensor) -> Tensor {
        self.fsq.decode(w, codes)
    }

    /// Logits [m, p] of the weight at points [m, p, 6] (each bone's own) or [r, p, 6] (shared by a
    /// rig's bones), from codes [m, k, axes] and shape tokens [r, s, l]. The weight is their sigmoid. With the extension
    /// `prior`, k may be 0.
    pub fn decode(
        &self,
        w: &Weights,
        codes: &Tensor,
        shape: &Tensor,
        points: &Tensor,
        geometry: Option<&BoneGeometry>,
    ) -> Tensor {
        let read = self.read(w, codes, shape, geometry.map(|g| &g.bones));
        self.ask(w, &read, points, geometry.map(|g| &g.points))
    }

    /// The first half of [`Self::decode`]: all but the points. With many points it serves part after part of them.
    /// `bones`: [`BoneGeometry::bones`].
    pub fn read(&self, w: &Weights, codes: &Tensor, shape: &Tensor, bones: Option<&Tensor>) -> ReadBones {
        let z = self.post_quant.forward(w, &self.dequantize(w, codes));
        let cond = self.post_quant.forward(w, shape);
        let count = codes.size()[1];
        let region = || {
            let bones = bones.filter(|_| self.config.extensions.prior)?;
            Some(Frame::known(&bones.narrow(1, BONE_FEATURES as i64, REGION as i64), count))
        };
        let told = self.frame.as_ref().filter(|_| count > 0).map(|coder| coder.hear(codes));
        let second = self.frame.as_ref().and_then(|_| region());
        self.decoder.read(w, &z, cond, [told.or_else(region), second], bones)
    }

    /// The second half of [`Self::decode`]. `beside`: [`BoneGeometry::points`].
    pub fn ask(&self, w: &Weights, read: &ReadBones, points: &Tensor, beside: Option<&Tensor>) -> Tensor {
        self.decoder.ask(w, read, (points, &self.features(w, points, &[])), beside)
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
        if factor == 0.0 || cloud.queries.is_none() {
            return None;
        }
        let picked = cloud.places(k);
        let axes = self.config.levels.len() as i64;
        Some((&picked * factor).constant_pad_nd([0, axes - 3]).to_kind(if picked.kind() == Kind::Double {
            Kind::Double
        } else {
            Kind::Float
        }))
    }
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::params::Builder;

    #[test]
    fn codes_that_tell_frames_stand_beside_what_geometry_says() {
        tch::manual_seed(1);
        let extensions = Extensions { frame: true, prior: true, bone_geometry: true, ..Extensions::default() };
        let config = FsqCvaeConfig {
            encoder_width: 16,
            decoder_width: 16,
            heads: 2,
            encoder_layers: 1,
            decoder_layers: 1,
            latent: 8,
            levels: vec![8, 8, 8, 5, 5],
            shape_tokens: 4,
            skin_tokens: 6,
            skin_queries: SkinQueries::Farthest,
            extensions,
            ..FsqCvaeConfig::default()
        };
        config.validate().unwrap();
        let mut builder = Builder::default();
        let net = FsqCvae::new(builder.root(), &config).unwrap();
        let params = builder.finish(1, Kind::Float, Device::Cpu).unwrap();
        let (w, float) = (params.weights(), (Kind::Float, Device::Cpu));
        let cloud = SkinCloud {
            points: Tensor::rand([3, 20, 6], float),
            weights: Tensor::rand([3, 20], float),
            queries: Some(Tensor::arange(6, (Kind::Int64, Device::Cpu)).repeat([3, 1])),
            regions: Some(Tensor::rand([3, REGION as i64], float)),
            off: None,
        };
        let codes = net.quantize(w, &net.encode_skin(w, &cloud, 6), &cloud);
        let shape = Tensor::randn([1, 4, 8], float);
        let points = Tensor::rand([1, 9, 6], float);
        let beside = Tensor::rand([3, 9, config.extensions.point_features() as i64], float);
        let bones = Tensor::rand([3, config.extensions.bone_features() as i64], float);
        let positions = points.narrow(-1, 0, 3);
        let same = |a: &Tensor, b: &Tensor| (a - b).abs().max().double_value(&[]) < 1e-6;
        let seen = |frame: &Option<Frame>| frame.as_ref().unwrap().point_features(&positions);
        let known = |bones: &Tensor| Frame::known(&bones.narrow(1, BONE_FEATURES as i64, REGION as i64), 0);
        let region = known(&bones).point_features(&positions);
        let other = || Some(known(&(&bones * 0.5)));
        for k in [0, 1, 4, 6] {
            let codes = codes.narrow(1, 0, k);
            let mut read = net.read(w, &codes, &shape, Some(&bones));
            assert!(same(&seen(&read.region), &region));
            if k == 0 {
                assert!(same(&seen(&read.frame), &region), "without codes the region is the frame");
            } else {
                let told = net.frame.as_ref().unwrap().hear(&codes).point_features(&positions);
                assert!(same(&seen(&read.frame), &told) && !same(&told, &region), "{k} codes");
            }
            // Each is read, and by itself.
            let said = |read: &ReadBones| net.ask(w, read, &points, Some(&beside));
            let both = said(&read);
            assert_eq!(both.size(), [3, 9]);
            let frame = std::mem::replace(&mut read.frame, other());
            let off = said(&read);
            (read.frame, read.region) = (frame, other());
            assert!(!same(&both, &off) && !same(&both, &said(&read)) && !same(&off, &said(&read)), "{k} codes");
        }
        // The encoder sees the frame that codes tell, whatever the region is.
        let latent = net.encode_skin(w, &cloud, 6);
        let without = SkinCloud { regions: None, ..cloud };
        assert!(same(&latent, &net.encode_skin(w, &without, 6)));
    }
}
