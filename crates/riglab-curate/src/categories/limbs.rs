//! Limbs by the tree of joints: two branches of one shape that hang on one joint are a pair, in any pose.

use glam::DVec3;
use riglab_core::Skeleton;

/// Pairs of limbs.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Limbs {
    /// Pairs that end near the ground.
    pub down: usize,
    /// Pairs that end above it.
    pub up: usize,
    /// From the joint that one pair hangs on to that of another, how much more along than up: 1 for a body
    /// that lies, -1 for one that stands. 0 without two pairs.
    pub lying: f64,
    /// Pairs above the ground that end in three or more chains, as hands do.
    pub hands: usize,
}

/// Limbs are at least this long, as a share of the skeleton.
const LONG: f64 = 0.15;
/// What ends below this share of the height ends on the ground.
const GROUND: f64 = 0.2;

impl Limbs {
    /// Finds the limbs of a skeleton over a mesh from `ground` to `top`.
    pub fn of(skeleton: &Skeleton, heads: &[DVec3], ground: f64, top: f64) -> Self {
        let children = skeleton.children();
        let (low, high) = heads.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
        let long = LONG * (high - low).max_element();
        let height = (top - ground).max(f64::MIN_POSITIVE);
        let branches = branches(skeleton, heads);
        let mut within = vec![false; heads.len()];
        let mut found = Self::default();
        // Where pairs hang, those on the ground and those above apart.
        let (mut hung_down, mut hung_up) = (Vec::new(), Vec::new());
        for joint in skeleton.ids().map(|j| j.index()) {
            if within[joint] {
                children[joint].iter().for_each(|c| within[c.index()] = true);
                continue;
            }
            let mut left: Vec<usize> = children[joint]
                .iter()
                .map(|c| c.index())
                .filter(|&c| branches[c].joints >= 2 && branches[c].length + heads[c].distance(heads[joint]) >= long)
                .collect();
            while let Some(one) = left.pop() {
                let Some(at) = left.iter().position(|&o| alike(&branches[one], &branches[o])) else { continue };
                let other = left.remove(at);
                within[one] = true;
                within[other] = true;
                let end = branches[one].end.y.max(branches[other].end.y);
                if (end - ground) / height < GROUND {
                    found.down += 1;
                    hung_down.push(heads[one].midpoint(heads[other]));
                } else {
                    found.up += 1;
                    found.hands += usize::from(branches[one].ends >= 3);
                    hung_up.push(heads[one].midpoint(heads[other]));
                }
            }
        }
        let ends = match (hung_down.as_slice(), hung_up.as_slice()) {
            ([a, .., b], []) | ([a, ..], [b, ..]) | ([], [a, .., b]) => Some(*b - *a),
            _ => None,
        };
        if let Some(way) = ends {
            let (along, up) = (way.x.hypot(way.z), way.y.abs());
            found.lying = if along + up > 0.0 { (along - up) / (along + up) } else { 0.0 };
        }
        found
    }
}

/// What hangs on a joint, with itself.
struct Branch {
    shape: u64,
    joints: usize,
    ends: usize,
    /// Along bones to the farthest end, and where that is.
    length: f64,
    end: DVec3,
}

/// Of one shape; or nearly as many joints and ends and nearly as long, as where one hand lacks a finger.
fn alike(a: &Branch, b: &Branch) -> bool {
    let near = |x: f64, y: f64| (x - y).abs() <= 0.1 * x.max(y);
    a.shape == b.shape
        || (a.joints.min(b.joints) >= 4 && near(a.joints as f64, b.joints as f64) && near(a.length, b.length))
}

fn branches(skeleton: &Skeleton, heads: &[DVec3]) -> Vec<Branch> {
    let children = skeleton.children();
    let mut all: Vec<Branch> =
        heads.iter().map(|h| Branch { shape: 0, joints: 1, ends: 1, length: 0.0, end: *h }).collect();
    // From the back: children come after their parents.
    for joint in (0..heads.len()).rev() {
        let mut shapes: Vec<u64> = children[joint].iter().map(|c| all[c.index()].shape).collect();
        shapes.sort_unstable();
        // FNV-1a, as of whole skeletons.
        let shape = shapes.iter().fold(0xcbf2_9ce4_8422_2325u64, |h, s| {
            s.to_le_bytes().iter().fold(h, |h, &b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3))
        });
        let mut own = Branch { shape, joints: 1, ends: 0, length: 0.0, end: heads[joint] };
        for child in children[joint].iter().map(|c| c.index()) {
            own.joints += all[child].joints;
            own.ends += all[child].ends;
            let length = all[child].length + heads[child].distance(heads[joint]);
            if length > own.length {
                (own.length, own.end) = (length, all[child].end);
            }
        }
        own.ends = own.ends.max(1);
        all[joint] = own;
    }
    all
}

#[cfg(test)]
mod tests {
    use riglab_synth::{Options, Plan, creature};

    use super::*;

    fn limbs(plan: Plan) -> Limbs {
        let rig = creature(1, 0, &Options { plans: vec![plan], ..Options::default() }).rig;
        let heads: Vec<DVec3> = rig.skeleton().heads().iter().map(|h| DVec3::from(h.map(f64::from))).collect();
        let b = rig.bounds();
        Limbs::of(rig.skeleton(), &heads, b.min[1].into(), b.max[1].into())
    }

    #[test]
    fn two_legs_stand_and_four_lie() {
        let biped = limbs(Plan::Biped);
        assert!(biped.down == 1 && biped.up == 1 && biped.lying < -0.5, "{biped:?}");
        let quadruped = limbs(Plan::Quadruped);
        assert!(quadruped.down == 2 && quadruped.lying > 0.3, "{quadruped:?}");
    }
}
