//! A skeleton as branches: what hangs below each joint.

use glam::DVec3;
use riglab_core::Skeleton;

/// What hangs on a joint, with itself.
#[derive(Clone, Debug)]
pub(super) struct Branch {
    pub(super) joints: usize,
    /// Along bones to the farthest end, and where that is.
    pub(super) length: f64,
    pub(super) end: DVec3,
}

/// The joints of a skeleton by number.
pub(super) struct Tree {
    pub(super) heads: Vec<DVec3>,
    pub(super) parents: Vec<Option<usize>>,
    pub(super) children: Vec<Vec<usize>>,
    pub(super) branches: Vec<Branch>,
    /// The longest side of the box around all joints.
    pub(super) size: f64,
}

impl Tree {
    pub(super) fn new(skeleton: &Skeleton) -> Self {
        let heads: Vec<DVec3> = skeleton.heads().iter().map(|h| glam::Vec3::from(*h).as_dvec3()).collect();
        let children: Vec<Vec<usize>> =
            skeleton.children().into_iter().map(|c| c.into_iter().map(|j| j.index()).collect()).collect();
        let parents = skeleton.parents().iter().map(|p| p.map(|p| p.index())).collect();
        let mut branches: Vec<Branch> = heads.iter().map(|h| Branch { joints: 1, length: 0.0, end: *h }).collect();
        // From the back: children come after their parents.
        for joint in (0..heads.len()).rev() {
            for &child in &children[joint] {
                let length = branches[child].length + heads[child].distance(heads[joint]);
                branches[joint].joints += branches[child].joints;
                if length > branches[joint].length {
                    (branches[joint].length, branches[joint].end) = (length, branches[child].end);
                }
            }
        }
        let (low, high) = heads.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| (l.min(*p), h.max(*p)));
        Self { heads, parents, children, branches, size: (high - low).max_element() }
    }

    /// How long the branch of a child is, from where it hangs.
    pub(super) fn reach(&self, child: usize) -> f64 {
        let above = self.parents[child].map_or(self.heads[child], |p| self.heads[p]);
        self.branches[child].length + self.heads[child].distance(above)
    }

    /// The child with the most joints below, of equals the one with the longest way; the first of equals again.
    pub(super) fn main_child(&self, joint: usize) -> Option<usize> {
        let key = |c: usize| (self.branches[c].joints, self.reach(c));
        self.children[joint].iter().copied().reduce(|best, c| {
            let ((n, length), (most, longest)) = (key(c), key(best));
            if n > most || (n == most && length > longest) { c } else { best }
        })
    }

    /// From a joint along main children to an end.
    pub(super) fn chain(&self, joint: usize) -> Vec<usize> {
        std::iter::successors(Some(joint), |&j| self.main_child(j)).collect()
    }

    /// Whether a joint parts into branches of one kind, as a palm does into fingers; joints that only turn with
    /// their parent, as twists, make none.
    pub(super) fn is_fan(&self, joint: usize) -> bool {
        let mut sizes: Vec<usize> = self.children[joint].iter().map(|&c| self.branches[c].joints).collect();
        sizes.sort_unstable_by(|a, b| b.cmp(a));
        sizes.len() > 1 && 4 * sizes[1] >= sizes[0] && sizes[0] > 1
    }

    /// Whether `joint` is `above` or hangs below it.
    pub(super) fn is_below(&self, joint: usize, above: usize) -> bool {
        std::iter::successors(Some(joint), |&j| self.parents[j]).any(|j| j == above)
    }

    /// From below `from` down to `to`, which hangs below it.
    pub(super) fn path(&self, from: usize, to: usize) -> Vec<usize> {
        let mut path: Vec<usize> =
            std::iter::successors(Some(to), |&j| self.parents[j]).take_while(|&j| j != from).collect();
        path.reverse();
        path
    }

    /// Pairs of children of a joint that mirror each other across its plane to `side`, the longest first.
    pub(super) fn pairs(&self, joint: usize, side: DVec3) -> Vec<(usize, usize)> {
        let own = &self.children[joint];
        let mut pairs: Vec<(f64, usize, usize)> = Vec::new();
        for (i, &a) in own.iter().enumerate() {
            for &b in &own[i + 1..] {
                let (x, y) = (self.reach(a), self.reach(b));
                let offset =
                    |c: usize| [self.heads[c], self.branches[c].end].map(|p| (p - self.heads[joint]).dot(side));
                let apart =
                    offset(a).iter().zip(offset(b)).any(|(p, q)| p * q < 0.0 && (p - q).abs() > 0.02 * self.size);
                let mirror = |p: DVec3| p - 2.0 * side * (p - self.heads[joint]).dot(side);
                let off = mirror(self.heads[a]).distance(self.heads[b])
                    + mirror(self.branches[a].end).distance(self.branches[b].end);
                if apart && x.min(y) > 0.7 * x.max(y) && off < 0.8 * x.max(y) {
                    pairs.push((x + y - off, a, b));
                }
            }
        }
        pairs.sort_by(|p, q| q.0.total_cmp(&p.0));
        pairs.into_iter().map(|(_, a, b)| (a, b)).collect()
    }
}
