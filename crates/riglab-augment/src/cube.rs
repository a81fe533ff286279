//! Into the cube that networks see.

use glam::{Affine3A, Mat3A, Vec3A};
use riglab_core::Bounds;
use riglab_random::{Draw, Stream};
use serde::{Deserialize, Serialize};

use crate::draft::Draft;
use crate::rules::{Fault, inside, probability, range};

/// Scales and shifts the rig such that the box around vertices *and* joints is centred in a cube and
/// fills its longest side; then scales and shifts it at random (`affine` of the public code).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CubeConfig {
    /// Whether to normalise at all. Networks see rigs in [-1, 1]³: where this is off, they are set there last.
    pub enabled: bool,
    /// From where to where the cube's sides run.
    pub into: [f32; 2],
    /// How often the normalised rig is scaled.
    pub scale_probability: f32,
    /// Smallest and largest scale, one for all axes. 0.01 to 100.
    pub scale: [f32; 2],
    /// How often it is shifted.
    pub shift_probability: f32,
    /// How far it is shifted.
    pub shift: Shift,
}

/// How far a normalised rig is shifted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Shift {
    /// As far as it stays in the cube (SkinTokens).
    Inside,
    /// Up to this much along each axis, to both sides (UniRig).
    UpTo(f32),
}

impl Default for CubeConfig {
    fn default() -> Self {
        Self {
            enabled: true,
            into: [-1.0, 1.0],
            scale_probability: 0.0,
            scale: [1.0, 1.0],
            shift_probability: 0.0,
            shift: Shift::Inside,
        }
    }
}

impl CubeConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), Fault> {
        range("into", self.into, -1000.0, 1000.0)?;
        if self.into[0] == self.into[1] {
            return Err(("into", "into is a cube without extent".into()));
        }
        probability("scale_probability", self.scale_probability)?;
        range("scale", self.scale, 0.01, 100.0)?;
        probability("shift_probability", self.shift_probability)?;
        match self.shift {
            Shift::UpTo(most) => inside("shift", most, 0.0, 1000.0),
            Shift::Inside => Ok(()),
        }
    }

    /// Normalises if enabled, with what is drawn. Scale and shift are of the normalised rig, so
    /// nothing is drawn without.
    pub fn apply(&self, draft: &mut Draft, random: &mut Stream) {
        if !self.enabled {
            return;
        }
        let scaled = random.chance(self.scale_probability);
        let scale = if scaled { random.within(self.scale[0], self.scale[1]) } else { 1.0 };
        let mut shift = [0.0; 3];
        if random.chance(self.shift_probability) {
            let half = 0.5 * (self.into[1] - self.into[0]);
            let size = normalizing(draft.bounds(), self.into).1;
            shift = std::array::from_fn(|k| {
                let most = match self.shift {
                    Shift::UpTo(most) => most,
                    Shift::Inside => (half - 0.5 * scale * size[k]).max(0.0),
                };
                let drawn = random.within(-most, most);
                // A cube that does not lie about the origin was scaled away from its own middle.
                match self.shift {
                    Shift::UpTo(_) => drawn,
                    Shift::Inside => drawn + 0.5 * (self.into[0] + self.into[1]) * (1.0 - scale),
                }
            });
        }
        into_cube(draft, self.into, scale, shift);
    }
}

/// Normalises into the cube, then scales about the origin, then shifts.
pub fn into_cube(draft: &mut Draft, into: [f32; 2], scale: f32, shift: [f32; 3]) {
    let (map, _) = normalizing(draft.bounds(), into);
    let after = Affine3A { matrix3: Mat3A::from_diagonal([scale; 3].into()), translation: shift.into() };
    // A uniform scale leaves normals as they are, with their noise.
    let normals = draft.normals.take();
    draft.transform(after * map);
    draft.normals = normals;
}

/// The map into the cube, and the size of the box after it.
fn normalizing(bounds: Bounds, [low, high]: [f32; 2]) -> (Affine3A, [f32; 3]) {
    let longest = bounds.size().into_iter().fold(0.0f32, f32::max);
    let fit = (high - low) / longest;
    let scale = if longest > 0.0 && fit.is_finite() { fit } else { 1.0 };
    let middle = 0.5 * (low + high);
    let translation = bounds.center().map(|c| middle - c * scale);
    let map = Affine3A { matrix3: Mat3A::from_diagonal([scale; 3].into()), translation: Vec3A::from(translation) };
    (map, bounds.size().map(|s| s * scale))
}

#[cfg(test)]
mod tests {
    use riglab_random::stream;

    use super::*;
    use crate::draft::tests::after;

    #[test]
    fn what_is_shifted_inside_stays_inside_and_gets_everywhere() {
        for into in [[-1.0, 1.0], [0.0, 1.0], [-3.0, 1.0]] {
            let scaled = CubeConfig { scale_probability: 1.0, scale: [0.5, 1.0], ..CubeConfig::default() };
            let config = CubeConfig { into, shift_probability: 1.0, ..scaled };
            let box_of = |k| after(|d| config.apply(d, &mut stream(1, "test", &[k]))).rig.bounds();
            let all: Vec<_> = (0..500).map(box_of).collect();
            let [low, high] = into;
            let ends = |of: fn(&Bounds) -> f32| {
                let ends = all.iter().map(of);
                ends.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)))
            };
            let near = 0.05 * (high - low);
            for (axis, (low_end, high_end)) in
                [(0, (ends(|b| b.min[0]).0, ends(|b| b.max[0]).1)), (1, (ends(|b| b.min[1]).0, ends(|b| b.max[1]).1))]
            {
                assert!(low_end > low - 1e-5 && high_end < high + 1e-5, "{into:?}, {axis}: {low_end} to {high_end}");
                assert!(
                    axis == 0 || (low_end < low + near && high_end > high - near),
                    "{into:?}: {low_end} to {high_end}"
                );
            }
        }
    }

    #[test]
    fn a_shift_up_to_a_limit_may_leave_the_cube() {
        let config = CubeConfig { shift_probability: 1.0, shift: Shift::UpTo(0.1), ..CubeConfig::default() };
        let right = |k| after(|d| config.apply(d, &mut stream(1, "test", &[k]))).rig.bounds().max[0];
        let most = (0..200).map(right).fold(0.0f32, f32::max);
        assert!((1.05..1.1001).contains(&most), "{most}");
    }
}
