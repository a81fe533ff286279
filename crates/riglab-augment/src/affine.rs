//! Rotation, mirroring and scale about the origin of normalised coordinates.

use std::f32::consts::PI;

use glam::{Mat3, Quat, Vec3};
use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::jitter::MOST;
use crate::rules::{inside, range};
use crate::turn::rotation;

/// What is drawn. The default changes nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct AffineConfig {
    /// Deviation of the turn about the axis that points up (`data.up`), in radians; at most π.
    pub yaw: f32,
    /// Deviation of the turns about both other axes, in radians; at most π.
    pub tilt: f32,
    /// Probability of a turn to any orientation, all alike, before the other turns: some files lie on their back.
    pub tumble: f32,
    /// Probability of mirroring left and right.
    pub mirror: f32,
    /// Smallest and largest uniform scale.
    pub scale: [f32; 2],
    /// Largest relative change of each axis besides.
    pub stretch: f32,
    /// Deviation of noise on positions, in normalised units; at most 1, half the cube.
    pub noise: f32,
}

impl Default for AffineConfig {
    fn default() -> Self {
        Self { yaw: 0.0, tilt: 0.0, tumble: 0.0, mirror: 0.0, scale: [1.0, 1.0], stretch: 0.0, noise: 0.0 }
    }
}

impl AffineConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        range("scale", self.scale, 0.01, 100.0)?;
        if !(0.0..1.0).contains(&self.stretch) {
            return Err(("stretch", format!("stretch = {} must be at least 0 and below 1", self.stretch)));
        }
        for (key, p) in [("mirror", self.mirror), ("tumble", self.tumble)] {
            if !(0.0..=1.0).contains(&p) {
                return Err((key, format!("{key} = {p} must lie in [0, 1]")));
            }
        }
        for (key, v) in [("yaw", self.yaw), ("tilt", self.tilt)] {
            // Degrees would turn everything anyhow, without a word.
            if !(0.0..=PI).contains(&v) {
                let degrees = if (PI..=180.0).contains(&v) {
                    format!(": {v} degrees are {:.3}", v.to_radians())
                } else {
                    String::new()
                };
                return Err((key, format!("{key} = {v} must be in radians, from 0 to π{degrees}")));
            }
        }
        inside("noise", self.noise, 0.0, MOST)
    }

    /// Draws a map; `up` is the axis that points up: 0 for x, 1 for y, 2 for z. The same numbers are taken from the stream
    /// whatever the config, but for those of `tumble`, which are taken where it is on.
    pub fn draw(&self, up: usize, random: &mut Stream) -> AffineMap {
        let [x, y, z]: [f32; 3] =
            std::array::from_fn(|axis| if axis == up { self.yaw } else { self.tilt } * random.normal());
        let turned = Mat3::from(rotation([x, 0.0, 0.0]) * rotation([0.0, y, 0.0]) * rotation([0.0, 0.0, z]));
        let scale = random.within(self.scale[0], self.scale[1]);
        let mut axes =
            Vec3::from_array(std::array::from_fn(|_| scale * (1.0 + random.within(-self.stretch, self.stretch))));
        if random.chance(self.mirror) {
            axes.x = -axes.x;
        }
        let mut any = Mat3::IDENTITY;
        if self.tumble > 0.0 {
            let tumbled = random.chance(self.tumble);
            // A normal point of four dimensions lies on the sphere of quaternions anywhere alike.
            let q: [f32; 4] = std::array::from_fn(|_| random.normal());
            if tumbled && q.iter().map(|x| x * x).sum::<f32>() > 1e-6 {
                any = Mat3::from_quat(Quat::from_array(q).normalize());
            }
        }
        AffineMap::new(turned * any * Mat3::from_diagonal(axes), self.noise)
    }
}

/// A linear map with noise.
#[derive(Clone, Copy, Debug)]
pub struct AffineMap {
    matrix: Mat3,
    normals: Mat3,
    noise: f32,
}

impl AffineMap {
    fn new(matrix: Mat3, noise: f32) -> Self {
        // Normals go with the inverse transpose; under a reflection the surface is turned inside
        // out by its winding, not by its normals, so their side is kept.
        Self { matrix, normals: matrix.inverse().transpose(), noise }
    }

    /// The image of a position, with noise from the stream.
    pub fn position(&self, p: [f32; 3], random: &mut Stream) -> [f32; 3] {
        let mut q = self.matrix * Vec3::from(p);
        if self.noise > 0.0 {
            q += self.noise * Vec3::new(random.normal(), random.normal(), random.normal());
        }
        q.into()
    }

    /// The image of a position without noise.
    pub fn exact(&self, p: [f32; 3]) -> [f32; 3] {
        (self.matrix * Vec3::from(p)).into()
    }

    /// The image of a unit normal.
    pub fn normal(&self, n: [f32; 3]) -> [f32; 3] {
        (self.normals * Vec3::from(n)).try_normalize().unwrap_or(Vec3::Y).into()
    }
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;

    fn wild() -> AffineConfig {
        AffineConfig { yaw: 1.0, tilt: 0.5, tumble: 0.5, mirror: 0.5, scale: [0.5, 2.0], stretch: 0.5, noise: 0.0 }
    }

    #[test]
    fn normals_stay_perpendicular_to_their_surface() {
        for seed in 0..50 {
            let mut random = stream(seed, "test", &[]);
            let map = wild().draw(1, &mut random);
            // A tangent of the plane with normal (1, 2, 3) / √14.
            let n = Vec3::new(1.0, 2.0, 3.0).normalize();
            let tangent = map.matrix * Vec3::new(3.0, 0.0, -1.0);
            assert!(tangent.dot(map.normal(n.into()).into()).abs() < 1e-4);
            // Outwards stays outwards: the image of n lies on the normal's side.
            assert!((map.matrix * n).dot(map.normal(n.into()).into()) > 0.0);
        }
    }

    #[test]
    fn tumbled_rigs_lie_anyhow_as_often_as_they_are_told() {
        let config = AffineConfig { tumble: 0.25, ..AffineConfig::default() };
        let up = |seed| Vec3::from(config.draw(1, &mut stream(seed, "test", &[])).exact([0.0, 1.0, 0.0]));
        let all: Vec<Vec3> = (0..2_000).map(up).collect();
        assert!(all.iter().all(|up| (up.length() - 1.0).abs() < 1e-5), "nothing is stretched");
        let turned: Vec<Vec3> = all.into_iter().filter(|up| up.y < 1.0).collect();
        assert!((450..550).contains(&turned.len()), "{}", turned.len());
        let mean = turned.iter().sum::<Vec3>() / turned.len() as f32;
        assert!(mean.length() < 0.1, "{mean}: no way is up more than others");
        assert!(AffineConfig { tumble: 1.5, ..config }.validate().is_err());
    }

    #[test]
    fn turns_are_about_x_then_y_then_z_of_what_is_turned() {
        let config = AffineConfig { yaw: 1.0, tilt: 0.5, ..AffineConfig::default() };
        for seed in 0..20 {
            let mut random = stream(seed, "test", &[]);
            let [x, y, z] = [0.5, 1.0, 0.5].map(|s: f32| s * random.normal());
            let wanted = Mat3::from_euler(glam::EulerRot::XYZ, x, y, z);
            let map = config.draw(1, &mut stream(seed, "test", &[]));
            assert!(map.matrix.abs_diff_eq(wanted, 1e-6), "{seed}: {} {wanted}", map.matrix);
        }
    }

    #[test]
    fn yaw_is_about_the_axis_that_points_up_and_tilt_about_the_others() {
        let drawn = |config: &AffineConfig, up, seed| config.draw(up, &mut stream(seed, "test", &[])).matrix;
        let yaw = AffineConfig { yaw: 1.0, ..AffineConfig::default() };
        let tilt = AffineConfig { tilt: 0.5, ..AffineConfig::default() };
        for (up, axis) in [(1, Vec3::Y), (2, Vec3::Z)] {
            for seed in 0..20 {
                let turned = drawn(&yaw, up, seed);
                assert!((turned * axis).abs_diff_eq(axis, 1e-6) && turned != Mat3::IDENTITY, "{up} {seed}: {turned}");
                let angles: [f32; 3] = {
                    let mut random = stream(seed, "test", &[]);
                    std::array::from_fn(|k| if k == up { 0.0 } else { 0.5 } * random.normal())
                };
                let wanted = Mat3::from_euler(glam::EulerRot::XYZ, angles[0], angles[1], angles[2]);
                assert!(drawn(&tilt, up, seed).abs_diff_eq(wanted, 1e-6), "{up} {seed}");
            }
        }
    }

    #[test]
    fn the_default_changes_nothing() {
        let mut random = stream(1, "test", &[]);
        let map = AffineConfig::default().draw(1, &mut random);
        assert_eq!(map.position([1.0, 2.0, 3.0], &mut random), [1.0, 2.0, 3.0]);
        assert!(AffineConfig::default().validate().is_ok() && wild().validate().is_ok());
        assert!(AffineConfig { scale: [2.0, 1.0], ..wild() }.validate().is_err());
        assert!(AffineConfig { scale: [1e-30, 1.0], ..wild() }.validate().is_err());
    }

    #[test]
    fn angles_are_radians_and_noise_stays_in_the_cube() {
        let said = |config: AffineConfig| config.validate().unwrap_err();
        let (key, message) = said(AffineConfig { yaw: 45.0, ..wild() });
        assert_eq!((key, message.as_str()), ("yaw", "yaw = 45 must be in radians, from 0 to π: 45 degrees are 0.785"));
        for (key, config) in [
            ("tilt", AffineConfig { tilt: 3.2, ..wild() }),
            ("tilt", AffineConfig { tilt: -0.1, ..wild() }),
            ("yaw", AffineConfig { yaw: f32::NAN, ..wild() }),
            ("yaw", AffineConfig { yaw: 720.0, ..wild() }),
            ("noise", AffineConfig { noise: 1.5, ..wild() }),
        ] {
            let (at, message) = said(config);
            assert!(at == key && message.contains(key), "{at}: {message}");
        }
        assert!(AffineConfig { yaw: PI, tilt: 0.0, noise: 1.0, ..wild() }.validate().is_ok());
    }
}
