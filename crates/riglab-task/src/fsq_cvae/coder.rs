//! A trained auto-encoder at work: bones to codes, codes to weights.

use riglab_core::Segment;
use riglab_nn::fsq_cvae::{Coded, FsqCvae, GaussianCode};
use riglab_nn::params::Weights;
use riglab_random::Stream;
use tch::{Device, Kind, Tensor};

use super::batch::{Batch, Maker};
use super::config::FsqCvaeTaskConfig;
use super::prepare::{Point, Prepared};
use super::prior::SurfacePrior;
use super::tensors;

/// Bones encoded at once.
const BONES_AT_ONCE: usize = 64;

/// A network with the weights it computes with.
#[derive(Clone, Copy)]
pub struct Coder<'a> {
    /// The settings it was trained with.
    pub config: &'a FsqCvaeTaskConfig,
    /// The network.
    pub net: &'a FsqCvae,
    /// Its weights.
    pub weights: &'a Weights,
    /// Where they lie.
    pub device: Device,
}

impl Coder<'_> {
    /// The shape tokens of a mesh, [1, s, l].
    pub fn shape(&self, rig: &Prepared, random: &mut Stream) -> Tensor {
        let _no_grad = tch::no_grad_guard();
        let mut batch = Batch::default();
        Maker::new(self.config, rig, None, random).shape(&mut batch);
        let (cloud, queries) = tensors::shape(self.config, &batch, self.device);
        self.net.encode_shape(self.weights, &cloud, &queries)
    }

    /// The first `k` codes of every bone, [m, k, axes], means where they are real numbers. The k first of all are not the
    /// same as the k first alone: see `FsqCvae::encode_skin`.
    pub fn encode(&self, rig: &Prepared, k: usize, random: &mut Stream) -> Coded {
        let _no_grad = tch::no_grad_guard();
        let mut make = Maker::new(self.config, rig, None, random);
        let mut parts = Vec::new();
        let all: Vec<usize> = (0..rig.bones.len()).collect();
        for chunk in all.chunks(BONES_AT_ONCE) {
            let mut batch = Batch::default();
            for &b in chunk {
                make.skin(b, &mut batch);
            }
            let cloud = tensors::skin(self.config, &batch, self.device);
            let latent = self.net.encode_skin(self.weights, &cloud, k);
            parts.push(self.net.code(self.weights, &latent, &cloud, None));
        }
        let join = |of: fn(&Coded) -> Option<&Tensor>| {
            let all: Option<Vec<&Tensor>> = parts.iter().map(of).collect();
            all.map(|all| Tensor::cat(&all, 0))
        };
        let deviation = join(|part| part.said.as_ref().map(|said| &said.deviation));
        let divergence = join(|part| part.said.as_ref().map(|said| &said.divergence));
        let said = deviation.zip(divergence).map(|(deviation, divergence)| GaussianCode { deviation, divergence });
        let codes: Vec<&Tensor> = parts.iter().map(|part| &part.codes).collect();
        Coded { codes: Tensor::cat(&codes, 0), said }
    }

    /// Raw shares at points, a row a point, a column a bone, from codes [m, k, axes] and the mesh's shape tokens.
    /// `segments`: those of each bone; `told`: what geometry alone says of them, for an auto-encoder with a prior.
    pub fn decode(
        &self,
        shape: &Tensor,
        codes: &Tensor,
        points: &[Point],
        segments: &[Vec<Segment>],
        told: Option<SurfacePrior<'_>>,
    ) -> Vec<f32> {
        let _no_grad = tch::no_grad_guard();
        let bones = segments.len();
        let mut out = vec![0.0; points.len() * bones];
        if bones == 0 {
            return out;
        }
        let geometry = self.config.model.extensions.bone_geometry;
        let bones_at_once = (self.config.eval.chunk / 256).clamp(1, bones);
        let points_at_once = (self.config.eval.chunk / bones_at_once).max(1);
        let all: Vec<usize> = (0..bones).collect();
        for part in all.chunks(bones_at_once) {
            let m = part.len();
            let codes = codes.narrow(0, part[0] as i64, m as i64);
            let mut read = None;
            for (c, chunk) in points.chunks(points_at_once).enumerate() {
                let flat: Vec<f32> = chunk.iter().flat_map(|p| p.position.into_iter().chain(p.normal)).collect();
                let cloud = Tensor::from_slice(&flat).view([1, chunk.len() as i64, 6]).to_device(self.device);
                let geometry =
                    geometry.then(|| tensors::geometry(self.config, part, chunk, segments, told, self.device));
                let (of_bones, beside) = geometry.map(|g| (g.bones, g.points)).unzip();
                // The bones are read once for all points.
                let read = read.get_or_insert_with(|| self.net.read(self.weights, &codes, shape, of_bones.as_ref()));
                let raw = self.net.ask(self.weights, read, &cloud, beside.as_ref()).sigmoid();
                let raw = Vec::<f32>::try_from(raw.to_kind(Kind::Float).transpose(0, 1).contiguous().view([-1]))
                    .unwrap_or_default();
                for (row, values) in raw.chunks_exact(m).enumerate() {
                    let at = (c * points_at_once + row) * bones + part[0];
                    out[at..at + m].copy_from_slice(values);
                }
            }
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::super::FsqCvaeTask;
    use super::super::prepare::Place;
    use super::*;

    #[test]
    fn parts_of_bones_and_points_give_what_all_at_once_give() {
        tch::manual_seed(1);
        let mut config = FsqCvaeTaskConfig::default();
        let m = &mut config.model;
        (m.encoder_width, m.decoder_width, m.heads, m.latent) = (16, 16, 2, 8);
        (m.encoder_layers, m.decoder_layers, m.shape_tokens, m.skin_tokens) = (1, 1, 4, 4);
        m.levels = vec![4, 3];
        let (net, params) = FsqCvaeTask::network(&config, Device::Cpu).unwrap();
        let shape = Tensor::randn([1, 4, 8], (Kind::Float, Device::Cpu));
        let codes = Tensor::rand([5, 4, 2], (Kind::Float, Device::Cpu)) * 2.0 - 1.0;
        let place = |k: usize| [0.01 * k as f32, 0.5, -0.02 * k as f32];
        let points: Vec<Point> = (0..700)
            .map(|k| Point { position: place(k), normal: [0.0, 1.0, 0.0], at: Place::Vertex(k as u32) })
            .collect();
        let decoded = |chunk: usize| {
            let mut config = config.clone();
            config.eval.chunk = chunk;
            let coder = Coder { config: &config, net: &net, weights: params.weights(), device: Device::Cpu };
            coder.decode(&shape, &codes, &points, &vec![Vec::new(); 5], None)
        };
        // Two bones at a time, 256 points of each.
        let (whole, parts) = (decoded(1 << 16), decoded(512));
        assert!(whole.iter().zip(&parts).all(|(a, b)| (a - b).abs() < 1e-5) && whole.len() == 3500);
        assert!(whole.chunks(5).any(|row| row.iter().any(|w| (w - row[0]).abs() > 1e-3)), "bones differ");
    }
}
