//! Joints in a tree, by depth.

use tch::Tensor;

use super::Maps;

/// A tree of joints, so that all of one depth are moved at once.
///
/// It may have several roots: a batch of rigs is one such, and costs little more than one of them.
#[derive(Debug)]
pub struct Tree {
    /// By depth, from the root: numbers of the joints, and where in the depth above their parents are.
    pub(super) levels: Vec<Level>,
    /// Where each joint is when depths stand one after another.
    back: Tensor,
    joints: i64,
}

#[derive(Debug)]
pub(super) struct Level {
    pub(super) joints: Tensor,
    pub(super) parents: Tensor,
}

impl Tree {
    /// By the parent of each joint; those without are roots.
    ///
    /// # Panics
    /// When a parent does not come before its child.
    pub fn new(parents: &[Option<usize>]) -> Self {
        let mut levels: Vec<(Vec<i64>, Vec<i64>)> = Vec::new();
        // Depth, and place in it.
        let mut places: Vec<(usize, i64)> = Vec::with_capacity(parents.len());
        for (joint, parent) in parents.iter().enumerate() {
            let (depth, above) = match parent {
                Some(parent) => (places[*parent].0 + 1, places[*parent].1),
                None => (0, 0),
            };
            if depth == levels.len() {
                levels.push(Default::default());
            }
            let (joints, above_of) = &mut levels[depth];
            places.push((depth, joints.len() as i64));
            joints.push(joint as i64);
            above_of.push(above);
        }
        let mut starts = vec![0];
        for (joints, _) in &levels {
            starts.push(starts[starts.len() - 1] + joints.len() as i64);
        }
        let back: Vec<i64> = places.iter().map(|(depth, place)| starts[*depth] + place).collect();
        let levels = levels.into_iter().map(|(joints, parents)| Level {
            joints: Tensor::from_slice(&joints),
            parents: Tensor::from_slice(&parents),
        });
        Self { levels: levels.collect(), back: Tensor::from_slice(&back), joints: parents.len() as i64 }
    }

    /// How many joints.
    pub fn joints(&self) -> i64 {
        self.joints
    }

    /// Forward kinematics: map[i] = map[parent] local[i]. `local` are maps [.., j] of the whole space at rest, such as
    /// turns about a head ([`Maps::about`]) or frame · basis · frame⁻¹.
    ///
    /// # Panics
    /// When there is not a map for each joint.
    pub fn compose(&self, local: &Maps) -> Maps {
        let device = local.shift.device();
        let mut all: Vec<Maps> = Vec::with_capacity(self.levels.len());
        for level in &self.levels {
            let own = local.select(-1, &level.joints.to_device(device));
            all.push(match all.last() {
                Some(above) => above.select(-1, &level.parents.to_device(device)).after(&own),
                None => own,
            });
        }
        self.in_order(&all)
    }

    /// Maps by depth as maps by joint.
    pub(super) fn in_order(&self, by_level: &[Maps]) -> Maps {
        let all = Maps::cat(by_level, -1);
        let back = self.back.to_device(all.shift.device());
        all.select(-1, &back)
    }
}
