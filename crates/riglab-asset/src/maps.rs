//! What readers ask of maps of space.

use glam::{DAffine3, DMat3, DVec3};

/// A transform that shrinks one direction to less than this share of another is left out.
pub(crate) const FLAT: f64 = 1e-6;

/// How far apart two maps of a skin may take its bounding box, as a share of its size.
pub(crate) const SAME: f64 = 1e-3;

/// The box around the vertices of a skin in mesh space: smallest and largest corner.
pub(crate) type SkinBox = Option<(DVec3, DVec3)>;

/// Whether a matrix maps space to a plane, a line or a point: its smallest stretch is less than
/// `share` of its largest, or it is not finite.
pub(crate) fn is_flat(m: &DMat3, share: f64) -> bool {
    // |det| / |adjugate| is the smallest stretch within a factor of 3; no unit of length enters.
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis];
    let squared = |a: DVec3, b: DVec3, c: DVec3| a.length_squared() + b.length_squared() + c.length_squared();
    let adjugate = squared(x.cross(y), y.cross(z), z.cross(x)).sqrt();
    let largest = squared(x, y, z).sqrt();
    let enough = m.determinant().abs() > share * adjugate * largest;
    !enough || !largest.is_finite()
}

/// Whether a map turns left into right, and with it surfaces inside out.
pub(crate) fn is_mirrored(map: &DAffine3) -> bool {
    map.matrix3.determinant() < 0.0
}

/// What a map does to a shape, beside turning it and making all of it larger or smaller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Reshaped {
    pub(crate) squashed: bool,
    pub(crate) mirrored: bool,
}

impl Reshaped {
    pub(crate) fn by(map: &DAffine3) -> Self {
        /// A stretch of a hundredth more than in another direction.
        const SEEN: f64 = 0.02;
        // Of a turn times a size this is the square of the size, in all directions alike.
        let squares = map.matrix3.transpose() * map.matrix3;
        let mean = (squares.x_axis.x + squares.y_axis.y + squares.z_axis.z) / 3.0;
        let squashed = !squares.abs_diff_eq(DMat3::from_diagonal(DVec3::splat(mean)), SEEN * mean);
        Self { squashed, mirrored: is_mirrored(map) }
    }

    pub(crate) fn is_any(&self) -> bool {
        self.squashed || self.mirrored
    }
}

/// Tells whether two maps do the same to a mesh, as far as its bounding box shows.
pub(crate) struct Likeness {
    corners: [DVec3; 8],
    /// Of the box in the scene.
    size: f64,
}

impl Likeness {
    /// How like other maps are to `map`.
    pub(crate) fn under(map: &DAffine3, corners: [DVec3; 8]) -> Self {
        let size = (map.transform_point3(corners[7]) - map.transform_point3(corners[0])).length();
        Self { corners, size }
    }

    /// Whether both take the box to the same place.
    pub(crate) fn same(&self, a: &DAffine3, b: &DAffine3) -> bool {
        let apart = |c: &DVec3| (a.transform_point3(*c) - b.transform_point3(*c)).abs().max_element();
        // In a box without size nothing can bend.
        self.size == 0.0 || self.corners.iter().all(|c| apart(c) <= SAME * self.size)
    }

    /// How far apart two points of the scene are, as a share of the box's size there.
    pub(crate) fn apart(&self, a: DVec3, b: DVec3) -> f64 {
        if self.size > 0.0 { (a - b).length() / self.size } else { 0.0 }
    }

    /// How far `a` takes the first corner from where `b` takes it.
    pub(crate) fn shift(&self, a: &DAffine3, b: &DAffine3) -> DVec3 {
        a.transform_point3(self.corners[0]) - b.transform_point3(self.corners[0])
    }
}

/// The eight corners of a box.
pub(crate) fn corners((low, high): (DVec3, DVec3)) -> [DVec3; 8] {
    std::array::from_fn(|i| {
        let pick = |axis: usize| if i >> axis & 1 == 0 { low[axis] } else { high[axis] };
        DVec3::new(pick(0), pick(1), pick(2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn flatness_does_not_hang_on_units() {
        for unit in [1e-30, 1.0, 1e30] {
            assert!(!is_flat(&DMat3::from_diagonal(DVec3::new(1.0, 1e-3, 1.0) * unit), 1e-6));
            assert!(is_flat(&DMat3::from_diagonal(DVec3::new(1.0, 1e-7, 1.0) * unit), 1e-6));
        }
        assert!(
            is_flat(&DMat3::ZERO, 1e-6)
                && is_flat(&DMat3::NAN, 1e-6)
                && is_flat(&(DMat3::IDENTITY * f64::INFINITY), 1e-6)
        );
    }
}
