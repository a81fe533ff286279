//! Directions and rotations, in degrees, equal to the bit on every machine.
//!
//! glam's own rotations call the platform's sine; two machines may differ in its last bit, and a
//! bit is enough to move a vertex over a cell's border. `libm` is one implementation for all.

use glam::Vec3;

/// Sine and cosine of an angle in degrees.
pub(crate) fn sin_cos(degrees: f32) -> (f32, f32) {
    let radians = f64::from(degrees) * (std::f64::consts::PI / 180.0);
    (libm::sin(radians) as f32, libm::cos(radians) as f32)
}

/// `base` to the power `exponent`.
pub(crate) fn pow(base: f32, exponent: f32) -> f32 {
    libm::pow(f64::from(base), f64::from(exponent)) as f32
}

/// `v` turned about a unit axis by the right-hand rule.
pub(crate) fn turned(v: Vec3, axis: Vec3, degrees: f32) -> Vec3 {
    let (sin, cos) = sin_cos(degrees);
    v * cos + axis.cross(v) * sin + axis * (axis.dot(v) * (1.0 - cos))
}

/// The unit direction `elevation` degrees above the ground plane, `yaw` degrees from +z towards +x.
pub(crate) fn direction(yaw: f32, elevation: f32) -> Vec3 {
    let ((sy, cy), (se, ce)) = (sin_cos(yaw), sin_cos(elevation));
    Vec3::new(sy * ce, se, cy * ce)
}

/// The unit vector nearest to `hint` at right angles to the unit vector `axis`.
pub(crate) fn across(axis: Vec3, hint: Vec3) -> Vec3 {
    let flat = hint - axis * axis.dot(hint);
    if flat.length_squared() > 1e-6 {
        return flat.normalize();
    }
    // The hint runs along the axis: any perpendicular will do.
    let other = if axis.x.abs() < 0.7 { Vec3::X } else { Vec3::Y };
    (other - axis * axis.dot(other)).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_follow_the_right_hand() {
        assert!((turned(Vec3::X, Vec3::Z, 90.0) - Vec3::Y).length() < 1e-6);
        assert!((direction(90.0, 0.0) - Vec3::X).length() < 1e-6);
        assert!((direction(0.0, 90.0) - Vec3::Y).length() < 1e-6);
    }

    #[test]
    fn across_is_a_unit_normal_even_along_the_axis() {
        for hint in [Vec3::X, Vec3::new(0.3, -2.0, 1.0), Vec3::ZERO] {
            let v = across(Vec3::X, hint);
            assert!((v.length() - 1.0).abs() < 1e-6 && v.x.abs() < 1e-6);
        }
    }
}
