//! Bones as rows of points, and how far points are from the nearest of them.

/// Relative to the largest coordinate: more than rounding moves any of the distances compared here.
const ROUNDING: f64 = 1e-12;
/// Points that are worked on at once, so that the compiler takes several in an instruction.
const LANES: usize = 16;

/// How a convention takes points of a bone.
#[derive(Clone, Copy)]
pub(super) enum Cut {
    /// At steps of this length as nearly as the bone's length allows, both ends among them.
    Every(f64),
    /// So many steps from the child; the parent's end is no point.
    Into(usize),
}

/// A bone with points at equal steps along it.
struct Bone {
    /// The end where counting begins.
    from: [f64; 3],
    /// To the other end.
    along: [f64; 3],
    /// 1 / length², or 0.
    inverse2: f64,
    /// Steps of the whole bone.
    steps: f64,
    /// The share of a step.
    share: f64,
    /// The number of the last point.
    last: usize,
    /// From any place of the bone to its nearest point it is no farther than this.
    step: f64,
}

impl Bone {
    fn new(parent: [f64; 3], child: [f64; 3], cut: Cut) -> Self {
        let (from, to) = if matches!(cut, Cut::Into(_)) { (child, parent) } else { (parent, child) };
        let along: [f64; 3] = std::array::from_fn(|k| to[k] - from[k]);
        let length2 = dot(along, along);
        let (steps, last) = match cut {
            Cut::Into(steps) => (steps, steps - 1),
            Cut::Every(step) => {
                // No rig is so long in its cube; a broken one must not fill the memory.
                let steps = (length2.sqrt() / step).round_ties_even().min(100_000.0) as usize;
                (steps, steps)
            }
        };
        let inverse2 = if length2 > 0.0 { 1.0 / length2 } else { 0.0 };
        let share = 1.0 / steps.max(1) as f64;
        Self { from, along, inverse2, steps: steps as f64, share, last, step: length2.sqrt() * share }
    }

    fn point(&self, i: usize) -> [f64; 3] {
        self.at(i as f64 * self.share)
    }

    fn at(&self, share: f64) -> [f64; 3] {
        std::array::from_fn(|k| self.from[k] + self.along[k] * share)
    }

    /// The share of the way at which the bone is nearest to `p`; 0 where that is not a number.
    #[inline(always)]
    fn foot(&self, p: [f64; 3]) -> f64 {
        let share = dot(std::array::from_fn(|k| p[k] - self.from[k]), self.along) * self.inverse2;
        // Not `clamp`: these two are one instruction each.
        let share = if share > 0.0 { share } else { 0.0 };
        if share < 1.0 { share } else { 1.0 }
    }

    /// Squared distance to the nearest place of the bone.
    #[inline(always)]
    fn squared_exact(&self, p: [f64; 3]) -> f64 {
        apart2(p, self.at(self.foot(p)))
    }

    /// Squared distance to the nearest of the bone's points, which is the one nearest to the foot.
    #[inline(always)]
    fn squared(&self, p: [f64; 3]) -> f64 {
        // Added and taken away, it leaves a whole number: rounding that needs no call.
        const WHOLE: f64 = (1u64 << 52) as f64;
        let (i, last) = ((self.foot(p) * self.steps + WHOLE) - WHOLE, self.last as f64);
        apart2(p, self.at(if i < last { i } else { last } * self.share))
    }
}

/// The bones of a skeleton.
pub(super) struct Bones {
    bones: Vec<Bone>,
    /// Whether distances are to any place of a bone, else to its points.
    exact: bool,
    /// The largest coordinate.
    reach: f64,
}

impl Bones {
    /// Of the positions of (parent, child).
    pub(super) fn new(ends: impl Iterator<Item = [[f64; 3]; 2]>, cut: Cut, exact: bool) -> Self {
        let mut reach: f64 = 0.0;
        let bone = |ends: [[f64; 3]; 2]| {
            reach = ends.as_flattened().iter().fold(reach, |most, x| most.max(x.abs()));
            Bone::new(ends[0], ends[1], cut)
        };
        Self { bones: ends.map(bone).collect(), exact, reach }
    }

    /// The points of all bones.
    #[cfg(test)]
    pub(super) fn points(&self) -> Vec<[f64; 3]> {
        self.bones.iter().flat_map(|b| (0..=b.last).map(|i| b.point(i))).collect()
    }

    /// The mean distance of `points` to the nearest bone.
    pub(super) fn mean_apart(&self, points: &[[f64; 3]]) -> f64 {
        let all: Vec<&Bone> = self.bones.iter().collect();
        let sum: f64 = points.chunks(LANES).map(|row| self.sum_apart(row.len(), |i| row[i], &all)).sum();
        sum / points.len() as f64
    }

    /// The mean distance of another's points to the nearest bone.
    ///
    /// Points of one bone lie close together, so that most bones are out of question for all of them: those are
    /// sorted out for a bone as a whole, then for a few of its points at a time. What is left out cannot be nearest.
    pub(super) fn mean_apart_of(&self, other: &Self) -> f64 {
        let rounding = ROUNDING * self.reach.max(other.reach);
        let all: Vec<&Bone> = self.bones.iter().collect();
        let (mut of_bone, mut of_row, mut room) = (Vec::new(), Vec::new(), Vec::new());
        let (mut count, mut sum) = (0, 0.0);
        for bone in &other.bones {
            self.choose(bone.point(0), bone.point(bone.last), rounding, &all, &mut of_bone, &mut room);
            for first in (0..=bone.last).step_by(LANES) {
                let last = (first + LANES - 1).min(bone.last);
                self.choose(bone.point(first), bone.point(last), rounding, &of_bone, &mut of_row, &mut room);
                sum += self.sum_apart(last + 1 - first, |i| bone.point(first + i), &of_row);
            }
            count += bone.last + 1;
        }
        sum / count as f64
    }

    /// The sum of the distances of some points, no more than there are lanes, to the nearest of some bones.
    #[inline(always)]
    fn sum_apart(&self, count: usize, point: impl Fn(usize) -> [f64; 3], among: &[&Bone]) -> f64 {
        let mut lanes = [[0.0; LANES]; 3];
        for (i, p) in (0..count).map(point).enumerate() {
            (0..3).for_each(|k| lanes[k][i] = p[k]);
        }
        let mut best = [f64::INFINITY; LANES];
        for bone in among {
            if self.exact {
                nearer(&lanes, &mut best, |p| bone.squared_exact(p));
            } else {
                nearer(&lanes, &mut best, |p| bone.squared(p));
            }
        }
        best[..count].iter().map(|squared| squared.sqrt()).sum()
    }

    /// Those of some bones that can be nearest to a place between `first` and `last`.
    fn choose<'a>(
        &self,
        first: [f64; 3],
        last: [f64; 3],
        rounding: f64,
        among: &[&'a Bone],
        kept: &mut Vec<&'a Bone>,
        apart: &mut Vec<f64>,
    ) {
        kept.clear();
        if among.len() == 1 {
            kept.extend(among);
            return;
        }
        let middle: [f64; 3] = std::array::from_fn(|k| (first[k] + last[k]) / 2.0);
        apart.clear();
        apart.extend(among.iter().map(|b| b.squared_exact(middle).sqrt()));
        // To one bone's points all places between are as near as `near`; what is farther from all is out.
        let step = |b: &Bone| if self.exact { 0.0 } else { b.step };
        let near = among.iter().zip(&*apart).map(|(b, d)| d + step(b)).fold(f64::INFINITY, f64::min);
        let most = near + apart2(first, last).sqrt() + rounding;
        let far = |d: f64| d > most; // what is not a number is kept
        kept.extend(among.iter().zip(&*apart).filter(|(_, d)| !far(**d)).map(|(b, _)| *b));
    }
}

/// Takes over what is less than the best so far.
#[inline(always)]
fn nearer(lanes: &[[f64; LANES]; 3], best: &mut [f64; LANES], squared: impl Fn([f64; 3]) -> f64) {
    let [x, y, z] = lanes;
    for i in 0..LANES {
        let d = squared([x[i], y[i], z[i]]);
        best[i] = if d < best[i] { d } else { best[i] };
    }
}

#[inline(always)]
fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

#[inline(always)]
fn apart2(a: [f64; 3], b: [f64; 3]) -> f64 {
    let d: [f64; 3] = std::array::from_fn(|k| a[k] - b[k]);
    dot(d, d)
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    const CUTS: [(Cut, bool); 3] = [(Cut::Every(0.005), false), (Cut::Every(0.005), true), (Cut::Into(100), false)];

    /// Bones of all lengths, some of none, around `far`.
    fn bones(seed: u64, count: usize, far: f64, (cut, exact): (Cut, bool)) -> Bones {
        let mut random = stream(seed, "test", &[]);
        let mut end = |from: [f64; 3], by: f64| from.map(|x| x + by * (2.0 * f64::from(random.unit()) - 1.0));
        let ends: Vec<[[f64; 3]; 2]> = (0..count)
            .map(|k| {
                let parent = end([far; 3], 1.0);
                [parent, end(parent, [0.3, 0.0, 0.004, 1.0][k % 4])]
            })
            .collect();
        Bones::new(ends.into_iter(), cut, exact)
    }

    #[test]
    fn the_nearest_bone_is_what_trying_all_finds() {
        for (far, cut) in [0.0, 1e4].into_iter().flat_map(|far| CUTS.map(|cut| (far, cut))) {
            let (a, b) = (bones(1, 60, far, cut), bones(2, 45, far, cut));
            let apart = |p: &[f64; 3]| {
                let every = |b: &Bone| (0..=b.last).map(|i| apart2(*p, b.point(i))).fold(f64::INFINITY, f64::min);
                let of = |b: &Bone| if cut.1 { b.squared_exact(*p) } else { every(b) };
                b.bones.iter().map(of).fold(f64::INFINITY, f64::min).sqrt()
            };
            let points = a.points();
            let all = points.iter().map(apart).sum::<f64>() / points.len() as f64;
            let room = 1e-14 * (1.0 + far);
            assert!((b.mean_apart_of(&a) - all).abs() < room, "{far} {}", b.mean_apart_of(&a) - all);
            assert!((b.mean_apart(&points) - all).abs() < room, "{far} {}", b.mean_apart(&points) - all);
            assert!(a.mean_apart_of(&a) <= if cut.1 { room } else { 0.0 });
        }
    }

    #[test]
    fn broken_bones_count_as_far_and_leave_the_others() {
        for cut in CUTS {
            let (whole, mut broken) = (bones(1, 9, 0.0, cut), bones(1, 9, 0.0, cut));
            for x in [f64::NAN, f64::INFINITY, 1e300] {
                let odd = Bones::new([[[x, 0.0, 0.0], [0.0; 3]]].into_iter(), cut.0, cut.1);
                broken.reach = broken.reach.max(odd.reach);
                broken.bones.extend(odd.bones);
            }
            assert!(broken.mean_apart_of(&whole) < 1e-12);
            assert!(!whole.mean_apart_of(&broken).is_finite());
        }
    }
}
