//! Batches as tensors.

use riglab_core::Segment;
use riglab_nn::fsq_cvae::{BONE_FEATURES, BONE_POINT_FEATURES, BoneGeometry, SkinCloud};
use tch::{Device, Tensor};

use super::batch::{Batch, bone_features, point_features};
use super::config::FsqCvaeTaskConfig;
use super::prepare::Point;

fn tensor(values: &[f32], size: &[usize], device: Device) -> Tensor {
    let size: Vec<i64> = size.iter().map(|&n| n as i64).collect();
    Tensor::from_slice(values).view(size.as_slice()).to_device(device)
}

/// The condition encoder's clouds [r, n, 6] and queries [r, s].
pub fn shape(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> (Tensor, Tensor) {
    let queries = Tensor::from_slice(&b.shape_queries).view([b.rigs as i64, c.model.shape_tokens as i64]);
    (tensor(&b.shape, &[b.rigs, c.sampling.shape_points, 6], device), queries.to_device(device))
}

/// The skin encoder's clouds.
pub fn skin(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> SkinCloud {
    let n = c.sampling.encoder.total();
    let queries = (!b.skin_queries.is_empty()).then(|| {
        Tensor::from_slice(&b.skin_queries).view([b.bones as i64, c.model.skin_tokens as i64]).to_device(device)
    });
    SkinCloud {
        points: tensor(&b.skin, &[b.bones, n, 6], device),
        weights: tensor(&b.skin_weights, &[b.bones, n], device),
        queries,
    }
}

/// What codes are drawn with [m, k, axes], where they are.
pub fn noise(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> Option<Tensor> {
    (!b.noise.is_empty()).then(|| tensor(&b.noise, &[b.bones, b.prefix, c.model.learned_axes()], device))
}

/// The true weights at the decoder's points [m, p].
pub fn targets(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> Tensor {
    tensor(&b.targets, &[b.bones, c.sampling.decoder.total()], device)
}

/// The decoder's points [m, p, 6] and the bones' geometry.
pub fn asked(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> (Tensor, Option<BoneGeometry>) {
    let p = c.sampling.decoder.total();
    let geometry = (!b.bone_points.is_empty()).then(|| BoneGeometry {
        bones: tensor(&b.bone_features, &[b.bones, BONE_FEATURES], device),
        points: tensor(&b.bone_points, &[b.bones, p, BONE_POINT_FEATURES], device),
    });
    (tensor(&b.points, &[b.bones, p, 6], device), geometry)
}

/// The geometry of some bones at points that they share.
pub fn geometry(bones: &[usize], points: &[Point], segments: &[Vec<Segment>], device: Device) -> BoneGeometry {
    use rayon::prelude::*;
    let mut of_bones = Vec::new();
    for &b in bones {
        bone_features(&segments[b], &mut of_bones);
    }
    let distances: Vec<Vec<f32>> = points
        .par_iter()
        .map(|p| {
            segments.iter().map(|s| s.iter().map(|s| s.distance(p.position)).fold(f32::INFINITY, f32::min)).collect()
        })
        .collect();
    let rows: Vec<Vec<f32>> = bones
        .par_iter()
        .map(|&b| {
            let mut out = Vec::with_capacity(points.len() * BONE_POINT_FEATURES);
            for (p, d) in points.iter().zip(&distances) {
                point_features(p.position, b, &segments[b], d, &mut out);
            }
            out
        })
        .collect();
    BoneGeometry {
        bones: tensor(&of_bones, &[bones.len(), BONE_FEATURES], device),
        points: tensor(&rows.concat(), &[bones.len(), points.len(), BONE_POINT_FEATURES], device),
    }
}
