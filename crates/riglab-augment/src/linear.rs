//! One matrix for the whole rig: rotation, mirroring, quarter turns, scale, exchange of axes.

use glam::{Affine3A, Mat3A, Vec3A};
use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::draft::Draft;
use crate::rules::{Fault, inside, probability, range};
use crate::turn::{about, radians, rotation};

/// A rotation by a random vector (SkinTokens, 4.1.2: probability 0.2, 15 degrees; UniRig: 0.5, 90).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RotateConfig {
    /// How often.
    pub probability: f32,
    /// Largest turn about each principal axis: the component of the rotation vector, in degrees.
    pub degrees: f32,
}

impl Default for RotateConfig {
    fn default() -> Self {
        Self { probability: 0.0, degrees: 15.0 }
    }
}

/// Mirroring.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct FlipConfig {
    /// How often each of x, y and z is negated.
    pub probability: [f32; 3],
    /// Keeps the triangles' winding, so that normals point inwards after an odd number of flips, as
    /// in the public code.
    pub keep_winding: bool,
}

/// Turns about one axis by one of a few angles, such as quarter turns.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TurnConfig {
    /// How often.
    pub probability: f32,
    /// The angles, in degrees, clockwise for who looks against the axis, as in the public code.
    pub degrees: Vec<f32>,
}

/// Scale by axis (SkinTokens, 4.1.2: probability 0.5; UniRig: 0.5, a third to threefold).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ScaleConfig {
    /// How often.
    pub probability: f32,
    /// Smallest and largest, drawn for each axis. 0.01 to 100.
    pub range: [f32; 2],
    /// One scale for all axes.
    pub uniform: bool,
}

impl Default for ScaleConfig {
    fn default() -> Self {
        Self { probability: 0.0, range: [0.7, 1.3], uniform: false }
    }
}

/// Exchange of axes: one of the 24 rotations of a cube.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AxesConfig {
    /// How often.
    pub probability: f32,
}

impl RotateConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        inside("degrees", self.degrees, 0.0, 180.0)
    }

    /// Draws a matrix.
    pub fn draw(&self, random: &mut Stream) -> Mat3A {
        if !random.chance(self.probability) {
            return Mat3A::IDENTITY;
        }
        let angle = radians(self.degrees);
        rotation(std::array::from_fn(|_| random.within(-angle, angle)))
    }
}

impl FlipConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        self.probability.iter().try_for_each(|&p| probability("probability", p))
    }

    /// Draws a matrix.
    pub fn draw(&self, random: &mut Stream) -> Mat3A {
        let signs = self.probability.map(|p| if random.chance(p) { -1.0 } else { 1.0 });
        Mat3A::from_diagonal(signs.into())
    }
}

impl TurnConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        if self.probability > 0.0 && self.degrees.is_empty() {
            return Err(("degrees", "degrees names no angle to turn by".into()));
        }
        self.degrees.iter().try_for_each(|&d| inside("degrees", d, -360.0, 360.0))
    }

    /// Draws a matrix; `axis` is 0 for x, 1 for y, 2 for z.
    pub fn draw(&self, axis: usize, random: &mut Stream) -> Mat3A {
        if !random.chance(self.probability) || self.degrees.is_empty() {
            return Mat3A::IDENTITY;
        }
        about(axis, -self.degrees[random.below(self.degrees.len())])
    }
}

impl ScaleConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)?;
        range("range", self.range, 0.01, 100.0)
    }

    /// Draws a matrix.
    pub fn draw(&self, random: &mut Stream) -> Mat3A {
        if !random.chance(self.probability) {
            return Mat3A::IDENTITY;
        }
        let mut scale: [f32; 3] = std::array::from_fn(|_| random.within(self.range[0], self.range[1]));
        if self.uniform {
            scale = [scale[0]; 3];
        }
        Mat3A::from_diagonal(scale.into())
    }
}

impl AxesConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        probability("probability", self.probability)
    }

    /// Draws a matrix.
    pub fn draw(&self, random: &mut Stream) -> Mat3A {
        if !random.chance(self.probability) {
            return Mat3A::IDENTITY;
        }
        let mut order = [0, 1, 2];
        random.shuffled(&mut order);
        let mut signs = [1.0; 3];
        signs[..2].iter_mut().for_each(|s| *s = if random.chance(0.5) { -1.0 } else { 1.0 });
        let mut matrix = signed_axes(order, signs);
        if matrix.determinant() < 0.0 {
            signs[2] = -1.0;
            matrix = signed_axes(order, signs);
        }
        matrix
    }
}

/// The matrix whose row i has `signs[i]` in column `order[i]`.
pub fn signed_axes(order: [usize; 3], signs: [f32; 3]) -> Mat3A {
    let mut columns = [[0.0; 3]; 3];
    for row in 0..3 {
        columns[order[row]][row] = signs[row];
    }
    Mat3A::from_cols_array_2d(&columns)
}

/// The parts of the one matrix, in the order of the public code.
pub struct LinearParts {
    /// By a random vector.
    pub rotate: Mat3A,
    /// Mirroring.
    pub flip: Mat3A,
    /// About x, y and z.
    pub turns: [Mat3A; 3],
    /// By axis.
    pub scale: Mat3A,
    /// Exchange of axes; applied last.
    pub axes: Mat3A,
}

impl LinearParts {
    /// The matrix: scale first, then turns about z, y and x, mirroring, rotation, exchange of axes.
    pub fn matrix(&self) -> Mat3A {
        let [x, y, z] = self.turns;
        self.axes * self.rotate * self.flip * x * y * z * self.scale
    }
}

/// Moves all by a matrix about the origin. Where it mirrors, triangles are wound the other way round
/// unless `keep_winding`, and human bones change sides.
pub fn linear(draft: &mut Draft, matrix: Mat3A, keep_winding: bool) {
    if matrix == Mat3A::IDENTITY {
        return;
    }
    draft.transform(Affine3A { matrix3: matrix, translation: Vec3A::ZERO });
    if matrix.determinant() < 0.0 {
        draft.mirror_humanoid();
        if !keep_winding {
            draft.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
    }
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::draft::tests::{after, chain};

    #[test]
    fn axes_are_exchanged_in_all_24_ways_without_mirroring() {
        let config = AxesConfig { probability: 1.0 };
        let mut seen = std::collections::BTreeSet::new();
        for k in 0..400 {
            let m = config.draw(&mut stream(1, "test", &[k]));
            assert_eq!(m.determinant(), 1.0);
            seen.insert(m.to_cols_array().map(|x| x as i32));
        }
        assert_eq!(seen.len(), 24);
    }

    #[test]
    fn every_draw_stays_in_its_range() {
        let (rotate, scale) = (
            RotateConfig { probability: 1.0, degrees: 15.0 },
            ScaleConfig { probability: 1.0, ..ScaleConfig::default() },
        );
        let mut steepest = 1.0f32;
        for k in 0..500 {
            let mut random = stream(1, "test", &[k]);
            // The cosine of the angle is (trace - 1) / 2; three components of 15 degrees make 26.
            let m = rotate.draw(&mut random);
            steepest = steepest.min(0.5 * (m.x_axis.x + m.y_axis.y + m.z_axis.z - 1.0));
            let diagonal = scale.draw(&mut random) * Vec3A::ONE;
            assert!(diagonal.cmpge(Vec3A::splat(0.7)).all() && diagonal.cmple(Vec3A::splat(1.3)).all());
        }
        assert!((24.0f32..26.0).contains(&steepest.acos().to_degrees()), "{}", steepest.acos().to_degrees());
    }

    #[test]
    fn a_mirror_turns_triangles_round_unless_asked_not_to() {
        let flip = FlipConfig { probability: [1.0, 0.0, 0.0], keep_winding: false };
        let m = flip.draw(&mut stream(1, "test", &[]));
        let normal = |keep| after(|d| linear(d, m, keep)).rig.mesh().area_vector(0)[2].signum();
        assert_eq!((normal(false), normal(true)), (1.0, -1.0));
        let sides = after(|d| linear(d, m, false)).rig;
        assert!(sides.humanoid().iter().any(|(b, j)| b.name() == "rightFoot" && j.0 == 4));
        assert_eq!(after(|d| linear(d, Mat3A::IDENTITY, false)).rig, chain());
    }

    #[test]
    fn gravity_turns_and_radii_scale_with_the_rig() {
        let rig = after(|d| linear(d, about(0, 90.0) * 2.0, false)).rig;
        let swing = rig.springs().springs()[0].joints[0].swing;
        assert!((swing.gravity_direction[2] + 1.0).abs() < 1e-6, "{swing:?}");
        let riglab_core::Shape::Sphere { radius, .. } = rig.springs().colliders()[0].shape else { panic!("a ball") };
        assert!((radius - 0.5).abs() < 1e-6);
    }
}
