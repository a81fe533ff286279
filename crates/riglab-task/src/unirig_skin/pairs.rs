//! What the network is told of a pair of point and bone.

use riglab_core::{Segment, Vec3};
use serde::{Deserialize, Serialize};

/// What is told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PairInput {
    /// Their distance through the body (the paper).
    #[default]
    Distance,
    /// The weight that the release makes of it: (1 / ((1 - α) d + α d²))² with α = 1/2, made to sum to 1 over bones.
    Weight,
    /// An extension: that distance, its logarithm and its share among the bones' in soft and sharp forms; the straight
    /// distance with its share; how far along the bone the nearest place is; the point as seen from the joint.
    Features,
    /// An extension: those features, the bone's heat at the point and its logarithm (Pinocchio's weights, which know how the
    /// surface hangs together).
    FeaturesAndHeat,
}

/// A point as the bones know it: of each bone its distance from the point through the body and, where it is told, its
/// heat there.
#[derive(Clone, Copy)]
pub struct Around<'a> {
    /// Distances, one a bone.
    pub distances: &'a [f32],
    /// Shares of heat, one a bone; empty where [`PairInput::heat`] is false.
    pub heat: &'a [f32],
}

/// Nearer than this is as near as can be.
const NEAR: f32 = 1e-4;
/// Less heat than this is none.
const COLD: f32 = 1e-4;

/// How many numbers [`PairInput::Features`] tells.
const FEATURES: usize = 12;

impl PairInput {
    /// Numbers of a pair.
    pub fn width(self) -> usize {
        match self {
            Self::Distance | Self::Weight => 1,
            Self::Features => FEATURES,
            Self::FeaturesAndHeat => FEATURES + 2,
        }
    }

    /// Whether heat is told.
    pub fn heat(self) -> bool {
        self == Self::FeaturesAndHeat
    }

    /// Adds what is told of a point and each bone, given by segments.
    pub fn tell(self, p: Vec3, bones: &[Vec<Segment>], around: Around, out: &mut Vec<f32>) {
        let distances = around.distances;
        match self {
            Self::Distance => out.extend_from_slice(distances),
            Self::Weight => {
                // Against the nearest bone's, so that no sum of far ones vanishes.
                let closeness = |d: f32| {
                    let d = f64::from(d.max(NEAR));
                    (1.0 / (0.5 * d + 0.5 * d * d)).powi(2)
                };
                let most = closeness(distances.iter().copied().fold(f32::INFINITY, f32::min));
                let share = |d: &f32| closeness(*d) / most;
                let sum: f64 = distances.iter().map(share).sum();
                out.extend(distances.iter().map(|d| (share(d) / sum) as f32));
            }
            Self::Features => features(p, bones, distances, |row, _| out.extend(row)),
            Self::FeaturesAndHeat => features(p, bones, distances, |row, b| {
                let heat = around.heat[b];
                out.extend(row);
                out.extend([heat, heat.max(COLD).ln() / 4.0]);
            }),
        }
    }
}

/// Gives the features of each bone, and which it is.
fn features(p: Vec3, bones: &[Vec<Segment>], distances: &[f32], mut give: impl FnMut([f32; FEATURES], usize)) {
    let straight: Vec<(f32, f32)> = bones.iter().map(|b| Segment::nearest_of(b, p)).collect();
    let ways = Shares::new(distances.iter().copied());
    let lines = Shares::new(straight.iter().map(|(_, d)| *d));
    for (b, bone) in bones.iter().enumerate() {
        let (d, (t, s)) = (distances[b].max(NEAR), straight[b]);
        let sharp = ways.share8(d);
        let head = bone.first().map_or([0.0; 3], |s| s.a);
        let ways = [d, d.ln(), ways.least / d, ways.share2(d), sharp, sharp.max(1e-6).ln() / 4.0];
        let lines = [s, lines.share8(s.max(NEAR)), t];
        let [x, y, z] = [0, 1, 2].map(|k| p[k] - head[k]);
        give([ways[0], ways[1], ways[2], ways[3], ways[4], ways[5], lines[0], lines[1], lines[2], x, y, z], b);
    }
}

/// Sums over bones of (least / d)ᵖ for p = 2 and 8.
struct Shares {
    least: f32,
    sums: [f32; 2],
}

impl Shares {
    fn new(distances: impl Iterator<Item = f32> + Clone) -> Self {
        let least = distances.clone().fold(f32::INFINITY, f32::min).max(NEAR);
        let mut sums = [0.0; 2];
        for d in distances {
            let square = (least / d.max(NEAR)).powi(2);
            sums[0] += square;
            sums[1] += square.powi(4);
        }
        Self { least, sums }
    }

    fn share2(&self, d: f32) -> f32 {
        (self.least / d).powi(2) / self.sums[0]
    }

    fn share8(&self, d: f32) -> f32 {
        (self.least / d).powi(8) / self.sums[1]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bones() -> Vec<Vec<Segment>> {
        let along = |y: f32| vec![Segment { a: [0.0, y, 0.0], b: [0.0, y + 1.0, 0.0] }];
        vec![along(0.0), along(1.0), vec![Segment { a: [0.0; 3], b: [0.0; 3] }]]
    }

    #[test]
    fn as_many_numbers_as_announced_all_finite() {
        for told in [PairInput::Distance, PairInput::Weight, PairInput::Features, PairInput::FeaturesAndHeat] {
            for (p, d) in [([0.1, 0.5, 0.0], [0.1, 0.6, 0.5]), ([0.0; 3], [0.0; 3]), ([1e18; 3], [1e18; 3])] {
                let mut out = Vec::new();
                told.tell(p, &bones(), Around { distances: &d, heat: &[0.7, 0.3, 0.0] }, &mut out);
                assert_eq!(out.len(), 3 * told.width());
                assert!(out.iter().all(|x| x.is_finite()), "{told:?} {p:?}: {out:?}");
            }
        }
    }

    #[test]
    fn shares_tell_the_near_bone_from_the_far_one() {
        let mut out = Vec::new();
        let around = Around { distances: &[0.1, 0.6, 0.5], heat: &[0.7, 0.3, 0.0] };
        PairInput::Features.tell([0.1, 0.5, 0.0], &bones(), around, &mut out);
        assert!(out[4] > 0.99 && out[12 + 4] < 0.01);
        let mut out = Vec::new();
        PairInput::Weight.tell([0.1, 0.5, 0.0], &bones(), around, &mut out);
        assert!((out.iter().sum::<f32>() - 1.0).abs() < 1e-6 && out[0] > out[2] && out[2] > out[1]);
        let (mut with, mut without) = (Vec::new(), Vec::new());
        PairInput::FeaturesAndHeat.tell([0.1, 0.5, 0.0], &bones(), around, &mut with);
        PairInput::Features.tell([0.1, 0.5, 0.0], &bones(), around, &mut without);
        for (b, (with, without)) in with.chunks(FEATURES + 2).zip(without.chunks(FEATURES)).enumerate() {
            assert_eq!((&with[..FEATURES], with[FEATURES]), (without, around.heat[b]));
        }
    }
}
