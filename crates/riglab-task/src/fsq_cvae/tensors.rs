//! Batches as tensors.

use riglab_core::Segment;
use riglab_nn::fsq_cvae::{BoneGeometry, REGION, SkinCloud};
use tch::{Device, Tensor};

use super::batch::{Batch, bone_features, point_features};
use super::config::FsqCvaeTaskConfig;
use super::prepare::Point;
use super::prior::SurfacePrior;

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
        regions: (!b.regions.is_empty()).then(|| tensor(&b.regions, &[b.bones, REGION], device)),
        off: (!b.frames_off.is_empty()).then(|| tensor(&b.frames_off, &[b.bones, REGION], device)),
    }
}

/// What codes are drawn with [m, k, axes], where they are.
pub fn noise(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> Option<Tensor> {
    (!b.noise.is_empty()).then(|| tensor(&b.noise, &[b.bones, b.prefix, c.model.learned_axes()], device))
}

/// How many levels off the codes are that the decoder is given [m, k, axes], where some are.
pub fn off(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> Option<Tensor> {
    (!b.off.is_empty()).then(|| tensor(&b.off, &[b.bones, b.prefix, c.model.levels.len()], device))
}

/// The true weights at the decoder's points [m, p].
pub fn targets(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> Tensor {
    tensor(&b.targets, &[b.bones, c.sampling.decoder.total()], device)
}

/// The decoder's points [m, p, 6] and the bones' geometry.
pub fn asked(c: &FsqCvaeTaskConfig, b: &Batch, device: Device) -> (Tensor, Option<BoneGeometry>) {
    let (p, x) = (c.sampling.decoder.total(), &c.model.extensions);
    let geometry = (!b.bone_points.is_empty()).then(|| BoneGeometry {
        bones: tensor(&b.bone_features, &[b.bones, x.bone_features()], device),
        points: tensor(&b.bone_points, &[b.bones, p, x.point_features()], device),
    });
    (tensor(&b.points, &[b.bones, p, 6], device), geometry)
}

/// The geometry of some bones at points that they share; `told`: what it alone says of all.
pub fn geometry(
    c: &FsqCvaeTaskConfig,
    bones: &[usize],
    points: &[Point],
    segments: &[Vec<Segment>],
    told: Option<SurfacePrior<'_>>,
    device: Device,
) -> BoneGeometry {
    use rayon::prelude::*;
    let x = &c.model.extensions;
    let mut of_bones = Vec::new();
    for &b in bones {
        bone_features(&segments[b], &mut of_bones);
        of_bones.extend(told.iter().flat_map(|told| told.prior.regions()[b]));
    }
    let distances: Vec<Vec<f32>> = points
        .par_iter()
        .map(|p| segments.iter().map(|bone| Segment::nearest_of(bone, p.position).1).collect())
        .collect();
    let rows: Vec<Vec<f32>> = bones
        .par_iter()
        .map(|&b| {
            let mut out = Vec::with_capacity(points.len() * x.point_features());
            for (p, d) in points.iter().zip(&distances) {
                point_features(p.position, b, &segments[b], d, &mut out);
                if let Some(told) = told {
                    told.tell(&p.at, b, &mut out);
                }
            }
            out
        })
        .collect();
    BoneGeometry {
        bones: tensor(&of_bones, &[bones.len(), x.bone_features()], device),
        points: tensor(&rows.concat(), &[bones.len(), points.len(), x.point_features()], device),
    }
}
