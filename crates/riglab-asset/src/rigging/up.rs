//! Which way a model stands.

use std::fmt;
use std::str::FromStr;

use riglab_core::Vec3;

/// The axis of a file that points up in truth. glTF has y up by definition; files made by programs with
/// other axes, and exported without a turn, do not keep to it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum UpAxis {
    /// +x.
    X,
    /// +y, as glTF asks for.
    #[default]
    Y,
    /// +z, as in Blender and in CAD.
    Z,
    /// -x.
    MinusX,
    /// -y.
    MinusY,
    /// -z.
    MinusZ,
}

impl UpAxis {
    /// All of them.
    pub const ALL: [Self; 6] = [Self::X, Self::Y, Self::Z, Self::MinusX, Self::MinusY, Self::MinusZ];

    /// A point or direction, turned so that this axis becomes +y. No number is rounded, and left and right
    /// stay what they are.
    pub fn to_y(self, [x, y, z]: Vec3) -> Vec3 {
        match self {
            Self::X => [-y, x, z],
            Self::Y => [x, y, z],
            Self::Z => [x, z, -y],
            Self::MinusX => [y, -x, z],
            Self::MinusY => [-x, -y, z],
            Self::MinusZ => [x, -z, y],
        }
    }

    /// The turn back.
    pub fn from_y(self, [x, y, z]: Vec3) -> Vec3 {
        match self {
            Self::X => [y, -x, z],
            Self::Y => [x, y, z],
            Self::Z => [x, -z, y],
            Self::MinusX => [-y, x, z],
            Self::MinusY => [-x, -y, z],
            Self::MinusZ => [x, z, -y],
        }
    }
}

impl fmt::Display for UpAxis {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::X => "x",
            Self::Y => "y",
            Self::Z => "z",
            Self::MinusX => "-x",
            Self::MinusY => "-y",
            Self::MinusZ => "-z",
        })
    }
}

impl FromStr for UpAxis {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let name = text.strip_prefix('+').unwrap_or(text).to_ascii_lowercase();
        let known = Self::ALL.into_iter().find(|axis| axis.to_string() == name);
        known.ok_or_else(|| format!("`{text}` is no axis: one of x, y, z, -x, -y, -z"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turns_take_their_axis_up_go_back_exactly_and_do_not_mirror() {
        for (axis, up) in UpAxis::ALL.into_iter().zip([
            [1.0, 0.0, 0.0],
            [0.0, 1.0, 0.0],
            [0.0, 0.0, 1.0],
            [-1.0, 0.0, 0.0],
            [0.0, -1.0, 0.0],
            [0.0, 0.0, -1.0],
        ]) {
            assert_eq!(glam::Vec3::from(axis.to_y(up)), glam::Vec3::Y, "{axis}");
            let p = [0.1, 2e-30, -7e30];
            assert_eq!(axis.from_y(axis.to_y(p)), p, "{axis}");
            let columns = [glam::Vec3::X, glam::Vec3::Y, glam::Vec3::Z].map(|v| axis.to_y(v.into()).into());
            assert_eq!(glam::Mat3::from_cols(columns[0], columns[1], columns[2]).determinant(), 1.0, "{axis}");
            assert_eq!(axis.to_string().parse(), Ok(axis));
        }
        assert_eq!("+Z".parse(), Ok(UpAxis::Z));
        assert!("up".parse::<UpAxis>().is_err());
    }
}
