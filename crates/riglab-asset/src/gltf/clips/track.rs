//! One property of one node over time.

use glam::{DQuat, DVec4};
use serde::Deserialize;

use super::Accessors;
use crate::Fault;

#[derive(Deserialize)]
pub(in crate::gltf) struct Sampler {
    input: usize,
    output: usize,
    #[serde(default)]
    interpolation: Interpolation,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Deserialize)]
#[serde(rename_all = "UPPERCASE")]
enum Interpolation {
    Step,
    #[default]
    Linear,
    CubicSpline,
}

/// Which property.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Path {
    Translation,
    Rotation,
    Scale,
}

impl Path {
    /// `None` for what moves no node.
    pub(in crate::gltf) fn of(name: &str) -> Option<Self> {
        Some(match name {
            "translation" => Self::Translation,
            "rotation" => Self::Rotation,
            "scale" => Self::Scale,
            _ => return None,
        })
    }
}

/// Keys, and how to go from one to the next.
#[derive(Debug)]
pub(crate) struct Track {
    path: Path,
    interpolation: Interpolation,
    /// Rising, at least one.
    times: Vec<f64>,
    /// One a key; in cubic splines three: in-tangent, value, out-tangent. Three numbers for
    /// translation and scale, then 0.
    values: Vec<DVec4>,
}

/// What is wrong with a track: an accessor, or the keys.
pub(in crate::gltf) enum Wrong {
    Accessor(Fault),
    Keys(&'static str),
}

impl Wrong {
    pub(in crate::gltf) fn either<T>(
        self,
        accessor: impl FnOnce(Fault) -> T,
        keys: impl FnOnce(&'static str) -> T,
    ) -> T {
        match self {
            Self::Accessor(fault) => accessor(fault),
            Self::Keys(what) => keys(what),
        }
    }
}

impl Track {
    pub(in crate::gltf) fn read(sampler: &Sampler, path: Path, accessors: &Accessors<'_>) -> Result<Self, Wrong> {
        let four = |v: [f32; 4]| DVec4::from_array(v.map(f64::from));
        let values: Vec<DVec4> = match path {
            Path::Rotation => accessors.rotations(sampler.output).map(|all| all.into_iter().map(four).collect()),
            _ => accessors
                .vectors(sampler.output)
                .map(|all| all.into_iter().map(|[x, y, z]| four([x, y, z, 0.0])).collect()),
        }
        .map_err(Wrong::Accessor)?;
        let times = accessors.times(sampler.input).map_err(Wrong::Accessor)?;
        Self::new(sampler.interpolation, path, times, values)
    }

    /// The weights of so many shapes: a track of one number for each.
    #[cfg(feature = "fbx")]
    pub(in crate::gltf) fn of_shapes(
        sampler: &Sampler,
        shapes: usize,
        accessors: &Accessors<'_>,
    ) -> Result<Vec<Self>, Wrong> {
        let times = accessors.times(sampler.input).map_err(Wrong::Accessor)?;
        let weights = accessors.shares(sampler.output).map_err(Wrong::Accessor)?;
        if !weights.len().is_multiple_of(shapes) {
            return Err(Wrong::Keys("has another number of values than of keys and shapes"));
        }
        let of_shape = |shape: usize| {
            let own = weights.iter().skip(shape).step_by(shapes);
            // A number goes from key to key as a place does.
            let own = own.map(|&weight| DVec4::new(weight.into(), 0.0, 0.0, 0.0)).collect();
            Self::new(sampler.interpolation, Path::Translation, times.clone(), own)
        };
        (0..shapes).map(of_shape).collect()
    }

    /// Checks the keys.
    fn new(interpolation: Interpolation, path: Path, times: Vec<f32>, values: Vec<DVec4>) -> Result<Self, Wrong> {
        let times: Vec<f64> = times.into_iter().map(f64::from).collect();
        let (interpolation, each) = match interpolation {
            Interpolation::CubicSpline => (Interpolation::CubicSpline, 3),
            other => (other, 1),
        };
        let wrong = |what| Err(Wrong::Keys(what));
        if times.is_empty() || values.len() != each * times.len() {
            return wrong("has another number of values than of keys");
        }
        if !times.iter().all(|t| t.is_finite()) || times.windows(2).any(|w| w[0] > w[1]) {
            return wrong("has times that do not rise");
        }
        if !values.iter().all(|v| v.is_finite()) {
            return wrong("has values that are not finite");
        }
        Ok(Self { path, interpolation, times, values })
    }

    /// Of each key, rising.
    #[cfg(feature = "fbx")]
    pub(crate) fn times(&self) -> &[f64] {
        &self.times
    }

    /// Whether values stay until the next key.
    #[cfg(feature = "fbx")]
    pub(crate) fn is_stepped(&self) -> bool {
        self.interpolation == Interpolation::Step
    }

    /// Whether the numbers go from key to key in a straight line, or stay.
    #[cfg(feature = "fbx")]
    pub(crate) fn is_straight(&self) -> bool {
        let is_line = self.interpolation == Interpolation::Linear && self.path != Path::Rotation;
        is_line || self.is_stepped()
    }

    /// Whether the numbers go from key to key along tangents.
    #[cfg(feature = "fbx")]
    pub(crate) fn is_spline(&self) -> bool {
        self.interpolation == Interpolation::CubicSpline
    }

    pub(crate) fn path(&self) -> Path {
        self.path
    }

    /// The time of the first key.
    pub(super) fn start(&self) -> f64 {
        self.times[0]
    }

    /// The time of the last key.
    pub(super) fn end(&self) -> f64 {
        self.times[self.times.len() - 1]
    }

    /// The value at a time; before the first and after the last key theirs.
    pub(crate) fn at(&self, time: f64) -> [f64; 4] {
        let next = self.times.partition_point(|t| *t <= time);
        let value = if next == 0 || next == self.times.len() || self.interpolation == Interpolation::Step {
            self.key(next.saturating_sub(1))
        } else {
            let (a, b) = (next - 1, next);
            let step = self.times[b] - self.times[a];
            self.between(a, b, (time - self.times[a]) / step, step)
        };
        match self.path {
            Path::Rotation => unit(value).to_array(),
            _ => value.to_array(),
        }
    }

    fn key(&self, key: usize) -> DVec4 {
        match self.interpolation {
            Interpolation::CubicSpline => self.values[3 * key + 1],
            _ => self.values[key],
        }
    }

    fn between(&self, a: usize, b: usize, t: f64, step: f64) -> DVec4 {
        let (from, to) = (self.key(a), self.key(b));
        match (self.interpolation, self.path) {
            // Hermite: tangents are given per second.
            (Interpolation::CubicSpline, _) => {
                let (out, into) = (self.values[3 * a + 2] * step, self.values[3 * b] * step);
                let (t2, t3) = (t * t, t * t * t);
                from * (2.0 * t3 - 3.0 * t2 + 1.0)
                    + out * (t3 - 2.0 * t2 + t)
                    + to * (3.0 * t2 - 2.0 * t3)
                    + into * (t3 - t2)
            }
            (_, Path::Rotation) => unit(from).slerp(unit(to), t).into(),
            _ => from.lerp(to, t),
        }
    }
}

/// As a rotation; none for 0.
fn unit(q: DVec4) -> DQuat {
    q.try_normalize().map_or(DQuat::IDENTITY, DQuat::from_vec4)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn track(path: Path, interpolation: Interpolation, times: &[f64], values: &[[f64; 4]]) -> Track {
        Track { path, interpolation, times: times.to_vec(), values: values.iter().map(|v| DVec4::from(*v)).collect() }
    }

    #[test]
    fn values_between_keys() {
        let keys = [[0.0; 4], [2.0, 0.0, 0.0, 0.0]];
        let linear = track(Path::Translation, Interpolation::Linear, &[1.0, 2.0], &keys);
        assert_eq!([0.0, 1.25, 5.0].map(|t| linear.at(t)[0]), [0.0, 0.5, 2.0]);
        let step = track(Path::Scale, Interpolation::Step, &[1.0, 2.0], &keys);
        assert_eq!([1.0, 1.99, 2.0].map(|t| step.at(t)[0]), [0.0, 0.0, 2.0]);
    }

    #[test]
    fn a_cubic_spline_goes_through_its_keys_along_its_tangents() {
        // x = t³ from 0 to 2: tangents 0 and 12 a second.
        let keys = [[0.0; 4], [0.0; 4], [0.0; 4], [12.0, 0.0, 0.0, 0.0], [8.0, 0.0, 0.0, 0.0], [0.0; 4]];
        let cubic = track(Path::Translation, Interpolation::CubicSpline, &[0.0, 2.0], &keys);
        for t in [0.0, 0.5, 1.0, 1.7, 2.0] {
            assert!((cubic.at(t)[0] - t * t * t).abs() < 1e-12, "{t}");
        }
    }

    #[test]
    fn rotations_take_the_short_way_at_a_steady_pace() {
        // Half a turn of 120 degrees about z; the second key with the other sign.
        let (s, c) = 60f64.to_radians().sin_cos();
        let keys = [[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, -s, -c]];
        let turn = track(Path::Rotation, Interpolation::Linear, &[0.0, 1.0], &keys);
        let at = turn.at(0.25);
        let (s, c) = 15f64.to_radians().sin_cos();
        assert!((at[2].abs() - s).abs() < 1e-9 && (at[3].abs() - c).abs() < 1e-9 && at[2] * at[3] > 0.0, "{at:?}");
    }
}
