//! Noise on vertices, normals and joints.

use glam::Vec3A;
use riglab_core::{Mesh, RigError, Vec3};
use riglab_geom::{normals_by_angle, triangle_normals};
use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::draft::{Draft, Normals};
use crate::rules::{Fault, inside, probability, range};

/// Gaussian noise on vertices (SkinTokens, 4.1.2: deviation 1e-3) and on the normals that are
/// sampled (public code only). Noise on normals is added to those that the surface has before its
/// vertices move, as there: on fine meshes little noise on vertices turns normals far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JitterConfig {
    /// How often.
    pub probability: f32,
    /// Deviation of each coordinate of a vertex, in normalised units.
    pub sigma: f32,
    /// Most that a coordinate changes. 0 for no limit.
    pub clip: f32,
    /// Deviation of each component of a unit normal. 0 leaves normals to the geometry: they are then
    /// those of the surface whose vertices have moved.
    pub normal_sigma: f32,
    /// Most that a component changes. 0 for no limit.
    pub normal_clip: f32,
    /// Smallest and largest strength: one number a time, and one for normals, by which deviation and
    /// limit are multiplied. [1, 1] for steady noise, [0, 1] in the public code.
    pub strength: [f32; 2],
}

impl Default for JitterConfig {
    fn default() -> Self {
        Self { probability: 0.0, sigma: 1e-3, clip: 0.0, normal_sigma: 0.0, normal_clip: 0.0, strength: [1.0, 1.0] }
    }
}

/// Gaussian noise on joints (SkinTokens, 4.1.2: deviation 1e-2; UniRig's `joint_perturb`).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct JointNoiseConfig {
    /// How often.
    pub probability: f32,
    /// Deviation of each coordinate, in normalised units.
    pub sigma: f32,
    /// Most that a coordinate changes. 0 for no limit.
    pub clip: f32,
}

impl Default for JointNoiseConfig {
    fn default() -> Self {
        Self { probability: 0.0, sigma: 1e-2, clip: 0.0 }
    }
}

/// Largest deviation: half the cube.
pub(crate) const MOST: f32 = 1.0;

impl JitterConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        inside("sigma", self.sigma, 0.0, MOST)?;
        inside("clip", self.clip, 0.0, MOST)?;
        inside("normal_sigma", self.normal_sigma, 0.0, MOST)?;
        inside("normal_clip", self.normal_clip, 0.0, MOST)?;
        range("strength", self.strength, 0.0, 1.0)
    }

    /// Draws whether and how much, and adds it.
    ///
    /// # Errors
    /// None that a draft of valid parts can give.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) -> Result<(), RigError> {
        if !random.chance(self.probability) {
            return Ok(());
        }
        let [low, high] = self.strength;
        let (vertices, normals) = (random.within(low, high), random.within(low, high));
        let still = if self.normal_sigma > 0.0 { Some(draft.current_normals()?) } else { None };
        if self.sigma > 0.0 {
            let noise = Noise { sigma: self.sigma * vertices, clip: self.clip * vertices };
            draft.positions.iter_mut().for_each(|p| *p = noise.on(*p, gaussian(random)));
        }
        if let Some(mut now) = still {
            let noise = Noise { sigma: self.normal_sigma * normals, clip: self.normal_clip * normals };
            for n in now.vertices.iter_mut().chain(&mut now.triangles) {
                *n = unit(noise.on(*n, gaussian(random)));
            }
            draft.normals = Some(now);
        }
        Ok(())
    }
}

impl JointNoiseConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        inside("sigma", self.sigma, 0.0, MOST)?;
        inside("clip", self.clip, 0.0, MOST)
    }

    /// Draws whether and how much, and adds it.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) {
        if !random.chance(self.probability) {
            return;
        }
        let noise = Noise { sigma: self.sigma, clip: self.clip };
        draft.heads.iter_mut().for_each(|h| *h = noise.on(*h, gaussian(random)));
    }
}

impl Draft {
    /// The normals as they are now: with noise, or the geometry's.
    ///
    /// # Errors
    /// None that a draft of valid parts can give.
    pub fn current_normals(&mut self) -> Result<Normals, RigError> {
        if let Some(normals) = self.normals.take() {
            return Ok(normals);
        }
        // Lent to a mesh and taken back: a copy would cost as much as the normals of the triangles.
        let mesh = Mesh::new(std::mem::take(&mut self.positions), std::mem::take(&mut self.triangles))?;
        let normals = Normals { vertices: normals_by_angle(&mesh), triangles: triangle_normals(&mesh) };
        (self.positions, self.triangles) = mesh.into_parts();
        Ok(normals)
    }
}

/// Scaled and bounded noise.
#[derive(Clone, Copy, Debug)]
pub struct Noise {
    /// Deviation.
    pub sigma: f32,
    /// Most that a coordinate changes; 0 for no limit.
    pub clip: f32,
}

impl Noise {
    /// A point with noise from standard normal numbers.
    pub fn on(&self, p: Vec3, draws: Vec3) -> Vec3 {
        let limit = if self.clip > 0.0 { self.clip } else { f32::INFINITY };
        std::array::from_fn(|k| p[k] + (self.sigma * draws[k]).clamp(-limit, limit))
    }
}

fn gaussian(random: &mut Stream) -> Vec3 {
    // One by one: a closure for `from_fn` is not inlined here.
    let x = random.normal();
    let y = random.normal();
    [x, y, random.normal()]
}

/// A vector at length 1; +y where it has none.
pub fn unit(v: Vec3) -> Vec3 {
    Vec3A::from(v).try_normalize().unwrap_or(Vec3A::Y).into()
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::draft::tests::{after, chain};

    #[test]
    fn noise_has_its_deviation_and_its_limit() {
        let mut random = stream(1, "test", &[]);
        let noise = Noise { sigma: 0.01, clip: 0.02 };
        let all: Vec<f32> = (0..2000).flat_map(|_| noise.on([0.0; 3], gaussian(&mut random))).collect();
        assert!(all.iter().all(|x| x.abs() <= 0.02) && all.contains(&0.02));
        let deviation = (all.iter().map(|x| x * x).sum::<f32>() / all.len() as f32).sqrt();
        // Of a normal distribution cut at two deviations, with what is cut at the limit: 0.96 of it.
        assert!((deviation - 0.0096).abs() < 2e-4, "{deviation}");
    }

    #[test]
    fn normals_get_noise_of_their_own_and_only_if_asked() {
        let config = JitterConfig { probability: 1.0, normal_sigma: 0.1, sigma: 0.0, ..JitterConfig::default() };
        let done = after(|d| config.apply(d, &mut stream(1, "test", &[])).unwrap());
        let normals = done.normals.unwrap();
        assert_eq!((normals.vertices.len(), normals.triangles.len(), done.rig), (18, 16, chain()));
        assert!(normals.vertices.iter().all(|n| n[2] > 0.5 && *n != [0.0, 0.0, 1.0]));
        let config = JitterConfig { normal_sigma: 0.0, sigma: 0.1, ..config };
        let done = after(|d| config.apply(d, &mut stream(1, "test", &[])).unwrap());
        assert!(done.normals.is_none() && done.rig.mesh() != chain().mesh());
    }

    #[test]
    fn noise_on_normals_is_on_those_from_before_the_vertices_move() {
        let config = JitterConfig {
            probability: 1.0,
            sigma: 0.3,
            normal_sigma: 0.01,
            normal_clip: 0.02,
            ..JitterConfig::default()
        };
        let done = after(|d| config.apply(d, &mut stream(1, "test", &[])).unwrap());
        // The strip is flat.
        let flat = |n: &Vec3| n[2] > 0.999;
        assert!(!normals_by_angle(done.rig.mesh()).iter().any(flat));
        let normals = done.normals.unwrap();
        assert!(normals.vertices.iter().chain(&normals.triangles).all(flat));
    }

    #[test]
    fn joints_move_and_the_mesh_does_not() {
        let config = JointNoiseConfig { probability: 1.0, sigma: 0.5, clip: 0.1 };
        let rig = after(|d| config.apply(d, &mut stream(1, "test", &[]))).rig;
        assert_eq!(rig.mesh(), chain().mesh());
        let (new, old) = (rig.skeleton().heads().as_flattened().to_vec(), chain());
        let moved = new.iter().zip(old.skeleton().heads().as_flattened());
        assert!(moved.clone().all(|(a, b)| (a - b).abs() < 0.1001) && moved.clone().all(|(a, b)| a != b));
    }
}
