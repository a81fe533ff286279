//! All rewards of many candidates of one mesh.

use rayon::prelude::*;
use riglab_core::{Mesh, Similarity};
use riglab_geom::sorted_by_place;
use riglab_geom::voxel::{MOST_CELLS, SolidConfig, Voxels, solid};
use serde::{Deserialize, Serialize};

use crate::coverage::Coverage;
use crate::motion::stretches_by;
use crate::{Candidate, RewardWeights, Rewards, containment, maps, random_poses, skinning};

/// Steps along a bone, and poses, at most: each pose holds a map for every joint, and time grows with both while the reward's
/// mean hardly changes any more.
const MOST_STEPS: usize = 1000;
const MOST_POSES: usize = 1000;

/// Exponents and scales beyond it make of all rewards one, or nothing.
const MOST: f64 = 1e6;

/// How rewards are taken and added up. Defaults are the paper's where it gives a value, else chosen on true,
/// perturbed and broken rigs (see `experiments/README.md`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RewardConfig {
    /// Cells along the mesh's longest side, r. The paper's 196.
    pub resolution: usize,
    /// α of coverage, by edges of a cell. The paper's 0.05.
    pub alpha: f64,
    /// s of containment: a bone has one more point. Not published.
    pub bone_steps: usize,
    /// β: weights above hold. The paper's 0.1.
    pub beta: f64,
    /// α_z, of the share of vertices that nothing holds. Not published.
    pub unbound_exponent: f64,
    /// α_m, of the share of vertices that more than four bones hold. Not published.
    pub crowded_exponent: f64,
    /// s of motion. Not published.
    pub stretch_scale: f64,
    /// Poses of motion. The paper's 5.
    pub poses: usize,
    /// Components of a pose's rotation vectors lie within so many degrees. Not published; those of SkinTokens'
    /// augmentation by poses.
    pub pose_degrees: f64,
    /// Seed of the poses.
    pub seed: u64,
    /// What each reward counts in the total. The paper's 5 for coverage, and 1.
    pub weights: RewardWeights,
}

impl Default for RewardConfig {
    fn default() -> Self {
        Self {
            resolution: 196,
            alpha: 0.05,
            bone_steps: 10,
            beta: 0.1,
            unbound_exponent: 0.25,
            crowded_exponent: 0.25,
            stretch_scale: 0.01,
            poses: 5,
            pose_degrees: 30.0,
            seed: 0,
            weights: RewardWeights::default(),
        }
    }
}

impl RewardConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        if !(4..=MOST_CELLS).contains(&self.resolution) {
            let resolution = self.resolution;
            return Err(("resolution", format!("resolution = {resolution} must lie between 4 and {MOST_CELLS} cells")));
        }
        if !(1..=MOST_STEPS).contains(&self.bone_steps) {
            let steps = self.bone_steps;
            return Err(("bone_steps", format!("bone_steps = {steps}: a bone has 1 to {MOST_STEPS} steps")));
        }
        if self.poses == 0 {
            return Err((
                "poses",
                "motion is judged in 1 pose or more; reward.weights leaves it out of the total".into(),
            ));
        }
        if self.poses > MOST_POSES {
            let poses = self.poses;
            return Err(("poses", format!("poses = {poses}: motion is judged in {MOST_POSES} at most")));
        }
        if !(self.beta > 0.0 && self.beta < 1.0) {
            return Err(("beta", format!("beta = {} must lie between 0 and 1", self.beta)));
        }
        if !(0.0..=180.0).contains(&self.pose_degrees) {
            return Err(("pose_degrees", format!("pose_degrees = {} must lie between 0 and 180", self.pose_degrees)));
        }
        let positive = [
            ("alpha", self.alpha),
            ("unbound_exponent", self.unbound_exponent),
            ("crowded_exponent", self.crowded_exponent),
            ("stretch_scale", self.stretch_scale),
        ];
        for (key, value) in positive {
            if !(value > 0.0 && value <= MOST) {
                return Err((key, format!("{key} = {value:?} must be above 0, and {MOST:?} at most")));
            }
        }
        self.weights.validate()
    }
}

/// A mesh prepared for scoring: voxels and edges are made once.
pub struct Scorer {
    config: RewardConfig,
    voxels: Voxels,
    cells: Coverage,
    /// Into the cube of side 2.
    map: Similarity,
    positions: Vec<[f64; 3]>,
    edges: Vec<[u32; 2]>,
    /// 1 / (l + 1e-6)² by edge.
    inverse: Vec<f64>,
}

impl Scorer {
    /// Voxelises the mesh. Its units do not matter; candidates are in the same.
    pub fn new(mesh: &Mesh, config: &RewardConfig) -> Self {
        let solid_config = SolidConfig { resolution: config.resolution, ..SolidConfig::DEFAULT };
        Self::with_voxels(mesh, solid(mesh, &solid_config), config)
    }

    /// With voxels made otherwise.
    pub fn with_voxels(mesh: &Mesh, voxels: Voxels, config: &RewardConfig) -> Self {
        let bounds = riglab_core::Bounds::of(mesh.positions().iter().copied());
        let map = bounds.map_or(Similarity { scale: 1.0, shift: [0.0; 3] }, Similarity::into_cube);
        let positions: Vec<[f64; 3]> = mesh.positions().iter().map(|p| apply(&map, p.map(f64::from))).collect();
        let mut edges: Vec<[u32; 2]> =
            mesh.triangles().iter().flat_map(|[a, b, c]| [[*a, *b], [*b, *c], [*c, *a]]).collect();
        edges.iter_mut().for_each(|e| e.sort_unstable());
        let mut edges = sorted_by_place(edges, positions.len(), |e| e[0] as usize);
        edges.dedup();
        let length = |e: &[u32; 2]| {
            let [a, b] = e.map(|v| glam::DVec3::from(positions[v as usize]));
            a.distance(b)
        };
        // Edges so short would be stretched a million times by nothing anyone sees.
        edges.retain(|e| length(e) > SHORTEST);
        let inverse = edges.iter().map(|e| (1.0 / (length(e) + 1e-6)).powi(2)).collect();
        let cells = Coverage::new(&voxels);
        Self { config: config.clone(), voxels, cells, map, positions, edges, inverse }
    }

    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        let of_mesh = size_of_val(&*self.positions) + size_of_val(&*self.edges) + size_of_val(&*self.inverse);
        self.voxels.lattice().cells() / 8 + self.cells.bytes() + of_mesh
    }

    /// The body's cells.
    pub fn voxels(&self) -> &Voxels {
        &self.voxels
    }

    /// The rewards of one candidate; all 0 where its rows of weights are not those of the mesh. Where it has none, a
    /// skeleton alone, skinning and motion are 0.
    pub fn score(&self, candidate: &Candidate) -> Rewards {
        let (c, rows) = (&self.config, candidate.weights().rows());
        if rows != 0 && rows != self.positions.len() {
            return Rewards::default();
        }
        let (heads, parents) = (candidate.heads(), candidate.parents());
        let bones = [self.cells.of(heads, c.alpha), containment(&self.voxels, heads, parents, c.bone_steps, true)];
        let weights = if rows == 0 { [0.0; 2] } else { self.of_weights(candidate) };
        let parts = [bones[0], bones[1], weights[0], weights[1]];
        Rewards::of(parts, c.weights.all())
    }

    /// Those of skinning and motion.
    fn of_weights(&self, candidate: &Candidate) -> [f64; 2] {
        let (c, heads, parents) = (&self.config, candidate.heads(), candidate.parents());
        let inner: Vec<[f64; 3]> = heads.iter().map(|p| apply(&self.map, *p)).collect();
        let poses: Vec<_> = random_poses(heads.len(), c.poses, c.pose_degrees, c.seed)
            .iter()
            .map(|turns| maps(&inner, parents, turns))
            .collect();
        let stretch = stretches_by(&self.positions, &self.edges, &self.inverse, candidate.weights(), &poses);
        let mean = stretch.iter().sum::<f64>() / stretch.len().max(1) as f64;
        [
            skinning(candidate.weights(), c.beta, [c.unbound_exponent, c.crowded_exponent]),
            if stretch.is_empty() { 0.0 } else { 1.0 / (1.0 + c.stretch_scale * mean) },
        ]
    }

    /// The rewards of a group, scored in parallel. `None` is a sequence that could not be decoded: 0.
    pub fn score_group(&self, candidates: &[Option<Candidate>]) -> Vec<Rewards> {
        candidates.par_iter().map(|c| c.as_ref().map_or_else(Rewards::default, |c| self.score(c))).collect()
    }
}

/// Shortest edge of motion, in the cube of side 2.
const SHORTEST: f64 = 1e-5;

fn apply(map: &Similarity, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| f64::from(map.scale) * p[k] + f64::from(map.shift[k]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_keep_within_what_a_machine_holds() {
        let key = |change: fn(&mut RewardConfig)| {
            let mut config = RewardConfig::default();
            change(&mut config);
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(key(|c| (c.bone_steps, c.poses) = (1000, 1000)), Ok(()));
        assert_eq!(key(|c| c.bone_steps = 0), Err("bone_steps"));
        assert_eq!(key(|c| c.bone_steps = 1001), Err("bone_steps"));
        assert_eq!([key(|c| c.alpha = 0.0), key(|c| c.alpha = f64::NAN)], [Err("alpha"); 2]);
        // As good as nothing is a way to leave a reward out.
        assert_eq!(key(|c| c.stretch_scale = 1e-30), Ok(()));
        assert_eq!(key(|c| c.stretch_scale = 1e30), Err("stretch_scale"));
        assert_eq!(key(|c| c.poses = 0), Err("poses"));
        assert_eq!(key(|c| c.poses = 10_000_000), Err("poses"));
    }
}
