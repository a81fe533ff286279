//! Weights and attributes of whole meshes.

use rayon::prelude::*;
use riglab_core::Vec3;
use riglab_geom::{ReskinConfig, reskin, spread_weights};
use riglab_nn::params::Weights;
use riglab_nn::skin_stage::ptv3::{Layout, Places};
use riglab_nn::skin_stage::{EncodedRig, PointEncoder, SkinModel, with_children};
use tch::{Device, Tensor};

use super::batch::{Bones, picks};
use super::config::SkinTaskConfig;
use super::pairs::PairInput;
use super::ready::Ready;
use crate::fsq_cvae::gallery::finite;
use crate::fsq_cvae::{Place, Point};

/// Points that read the rig at once.
const POINTS_AT_ONCE: usize = 4096;

/// What was predicted of a rig.
pub struct Predicted {
    /// A row of shares for each point asked, a column a bone; rows sum to 1.
    pub dense: Vec<f32>,
    /// A row of attributes a bone, where the network has them.
    pub attributes: Vec<[f32; 7]>,
}

/// Predicts with some weights.
pub struct Predictor<'a> {
    /// The task's settings.
    pub config: &'a SkinTaskConfig,
    /// The network.
    pub net: &'a SkinModel,
    /// Its weights.
    pub weights: &'a Weights,
    /// Where it computes.
    pub device: Device,
}

impl Predictor<'_> {
    /// Of a rig whose first `seen` points are what the network sees, at the points after them, which are vertices.
    ///
    /// With the backbone, weights are known at the points that are seen, and come from there to vertices as in the
    /// release.
    ///
    /// # Errors
    /// When the network gives what is no number.
    pub fn predict(&self, ready: &Ready, seen: usize) -> Result<Predicted, String> {
        let _guard = tch::no_grad_guard();
        let (c, w) = (self.config, self.weights);
        let bones = Bones::all(ready);
        let mut told = Vec::new();
        ready.seats.iter().for_each(|seat| seat.seen(c.model.bones.seen, |p| p, &mut told));
        let told = Tensor::from_slice(&told).view([1, ready.seats.len() as i64, -1]).to_device(self.device);
        let positions: Vec<Vec3> = ready.points[..seen].iter().map(|p| p.position).collect();
        let cloud = self.cloud(&ready.points[..seen]);
        let picks = Tensor::from_slice(&picks(c, &positions)).unsqueeze(0).to_device(self.device);
        let read = self.net.read(w, &cloud, &picks, &told);
        let (dense, of_cloud) = match c.model.points.encoder {
            PointEncoder::Light => {
                let starts = (seen..ready.points.len()).step_by(POINTS_AT_ONCE);
                let dense = starts.flat_map(|start| {
                    let end = (start + POINTS_AT_ONCE).min(ready.points.len());
                    let encoded = self.net.encode(w, &self.cloud(&ready.points[start..end]), None);
                    let points = self.net.points(w, &read, &encoded);
                    self.shares(ready, &bones, &read, &points, start)
                });
                let dense = dense.collect();
                let of_cloud = c.model.attributes.then(|| self.net.points(w, &read, &self.net.encode(w, &cloud, None)));
                (dense, of_cloud)
            }
            PointEncoder::Ptv3 => {
                let config = &c.model.points.ptv3;
                let places =
                    Places::new(&Layout::new(&positions, &[seen], config.grid), config, [0, 1, 2, 3], self.device);
                let points = self.net.points(w, &read, &self.net.encode(w, &cloud, Some(&places)));
                let known = self.shares(ready, &bones, &read, &points, 0);
                (self.at_vertices(ready, &positions, &known, seen), Some(points))
            }
        };
        let attributes = of_cloud.and_then(|points| self.net.attributes(w, &read, &points));
        let attributes = attributes.map_or_else(Vec::new, |a| floats(&a).as_chunks::<7>().0.to_vec());
        finite(&dense)?;
        finite(attributes.as_flattened())?;
        Ok(Predicted { dense, attributes })
    }

    /// Predicted weights of all vertices of a mesh, the points of a rig after those seen, as the decode rule cuts them:
    /// spread over the surface by `eval.spread`.
    pub fn spread(&self, ready: &Ready, seen: usize, dense: Vec<f32>) -> Vec<f32> {
        let far = f64::from(self.config.eval.spread);
        if far == 0.0 {
            return dense;
        }
        let nearest = |k: usize| ready.around(k).distances.iter().copied().fold(f32::INFINITY, f32::min);
        let distance: Vec<f64> = (seen..ready.points.len()).map(|k| far * f64::from(nearest(k))).collect();
        spread_weights(ready.rig.rig.mesh(), &dense, &distance)
    }

    fn cloud(&self, points: &[Point]) -> Tensor {
        let rows: Vec<f32> = points.iter().flat_map(|p| p.position.into_iter().chain(p.normal)).collect();
        Tensor::from_slice(&rows).view([1, points.len() as i64, 6]).to_device(self.device)
    }

    /// Shares of points [1, n, d] that are those of the rig from `first` on.
    fn shares(&self, ready: &Ready, bones: &Bones, read: &EncodedRig, points: &Tensor, first: usize) -> Vec<f32> {
        let (c, n, b) = (self.config, points.size()[1], bones.of.len());
        let pairs = |start: i64, count: i64| {
            let rows = first + start as usize..first + (start + count) as usize;
            let tell = |k: usize| {
                let mut out = Vec::with_capacity(b * c.model.pair);
                c.sampling.told.tell(ready.points[k].position, &bones.segments, ready.around(k), &mut out);
                out
            };
            let all: Vec<Vec<f32>> = rows.into_par_iter().map(tell).collect();
            Tensor::from_slice(&all.concat()).view([count, b as i64, c.model.pair as i64]).to_device(self.device)
        };
        let mask = (c.model.mask_power > 0.0).then(|| {
            let own = first..first + n as usize;
            let mut rows = Vec::with_capacity(own.len() * b);
            own.for_each(|k| {
                PairInput::Weight.tell(ready.points[k].position, &bones.segments, ready.around(k), &mut rows)
            });
            let above: Vec<Option<usize>> = ready.seats.iter().map(|s| s.above).collect();
            with_children(&Tensor::from_slice(&rows).view([n, b as i64]).to_device(self.device), &above)
        });
        floats(&self.net.predict(self.weights, read, &points.squeeze_dim(0), pairs, mask.as_ref(), c.eval.chunk))
    }

    /// Weights known at points, told for the vertices that are asked.
    fn at_vertices(&self, ready: &Ready, positions: &[Vec3], known: &[f32], seen: usize) -> Vec<f32> {
        let (mesh, b) = (ready.rig.rig.mesh(), ready.seats.len());
        let above: Vec<Option<usize>> = ready.seats.iter().map(|s| s.above).collect();
        let all = reskin(positions, known, &above, mesh.positions(), mesh.triangles(), &ReskinConfig::default());
        let of = |p: &Point| match p.at {
            Place::Vertex(v) => v as usize,
            Place::Surface(_) => unreachable!("vertices are asked"),
        };
        ready.points[seen..].iter().flat_map(|p| all[of(p) * b..(of(p) + 1) * b].iter().copied()).collect()
    }
}

fn floats(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.to_device(Device::Cpu).contiguous().flatten(0, -1)).expect("floats")
}
