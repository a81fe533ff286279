//! Rotations, equal to the bit on every machine.
//!
//! glam's own call the platform's sine, whose last bit differs from one machine to another.

use glam::{DMat3, DVec3, Mat3A};

/// The rotation of a rotation vector: its axis times its angle in radians, by the right-hand rule.
pub fn rotation(vector: [f32; 3]) -> Mat3A {
    let v = DVec3::from_array(vector.map(f64::from));
    let angle = v.length();
    if !(angle > 0.0 && angle.is_finite()) {
        return Mat3A::IDENTITY;
    }
    let (sin, cos, u) = (libm::sin(angle), libm::cos(angle), v / angle);
    // Rodrigues: cos I + sin [u]x + (1 - cos) u uᵀ, by columns.
    let column = |e: DVec3| e * cos + u.cross(e) * sin + u * (u.dot(e) * (1.0 - cos));
    DMat3::from_cols(column(DVec3::X), column(DVec3::Y), column(DVec3::Z)).as_mat3().into()
}

/// The rotation about one axis (0 = x, 1 = y, 2 = z), in degrees, by the right-hand rule.
pub fn about(axis: usize, degrees: f32) -> Mat3A {
    let mut vector = [0.0; 3];
    vector[axis] = radians(degrees);
    rotation(vector)
}

/// Degrees to radians.
pub fn radians(degrees: f32) -> f32 {
    (f64::from(degrees) * (std::f64::consts::PI / 180.0)) as f32
}

#[cfg(test)]
mod tests {
    use glam::Vec3A;

    use super::*;

    #[test]
    fn turns_follow_the_right_hand() {
        assert!((about(2, 90.0) * Vec3A::X - Vec3A::Y).length() < 1e-6);
        assert!((about(0, 90.0) * Vec3A::Y - Vec3A::Z).length() < 1e-6);
        let vector = [0.3, -0.5, 0.9];
        let own = rotation(vector);
        assert!((own * Vec3A::from(vector) - Vec3A::from(vector)).length() < 1e-6);
        assert!((own * own.transpose()).abs_diff_eq(Mat3A::IDENTITY, 1e-6) && own.determinant() > 0.0);
        assert_eq!((rotation([0.0; 3]), rotation([f32::NAN; 3])), (Mat3A::IDENTITY, Mat3A::IDENTITY));
    }
}
