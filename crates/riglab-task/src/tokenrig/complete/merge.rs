//! A skeleton that was drawn and joints that are given, as one tree.

use glam::DVec3;
use riglab_metric::Joints;

/// A drawn skeleton with every given joint in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Merged {
    /// In the cube: first the drawn joints in their order, those that are given ones at their places; then what was not
    /// drawn.
    pub tree: Joints,
    /// Which of the given joints each is.
    pub given: Vec<Option<usize>>,
    /// How far it was moved from where it was drawn; `None` where nothing was drawn in its place.
    pub moved: Vec<Option<DVec3>>,
}

/// Finds given joints, parents before children, among those of a skeleton that was drawn freely. From the first pair on
/// ([`first`]) a given joint is looked for among the children of the joint that its parent was found to be: it is the one that
/// begins the same limb, the most alike first, or one further along it that is much nearer, where the given limb has fewer
/// joints. A limb that is left and was drawn to hang on a given joint hangs on the one that is much nearer to where it begins, if
/// there is one. What was drawn around given joints follows them.
pub fn grafted(given: &Joints, drawn: &Joints) -> Merged {
    let (own, mut other) = (Limbs::new(given), Limbs::new(drawn));
    let mut found: Vec<Option<usize>> = vec![None; drawn.positions.len()];
    let mut place = vec![None; given.positions.len()];
    let (root, at) = first(&own, &other);
    while let Some(above) = other.parents[at] {
        other.leave_out(above, at);
    }
    (found[at], place[root]) = (Some(root), Some(at));
    // Parents stand before their children in both, so that a parent's place is known when its children are looked for.
    for parent in 0..given.positions.len() {
        let Some(from) = place[parent] else { continue };
        loop {
            let open = other.children[from].iter().filter(|&&c| found[c].is_none());
            let pairs = open.flat_map(|&c| own.children[parent].iter().map(move |&g| (g, c)));
            let pairs = pairs.filter(|&(g, _)| place[g].is_none());
            let pairs = pairs.filter_map(|(g, c)| Some((alike((&own, g), (&other, c))?, g, c)));
            let Some((_, g, c)) = pairs.min_by(|a, b| a.0.total_cmp(&b.0)) else { break };
            let c = other.further_along(c, own.heads[g]);
            let mut between = other.parents[c];
            while let Some(joint) = between.filter(|&above| above != from) {
                between = other.parents[joint];
                other.leave_out(joint, from);
            }
            (place[g], found[c]) = (Some(c), Some(g));
        }
    }
    let mut all = whole(&own, &other, &found, place);
    follow(&mut all);
    all.in_order()
}

/// The pair of a given and a drawn joint that the others are found from: the given joint that is nearest to where the drawn
/// skeleton begins, where what is given above it has no part in that; or, where that is far, the drawn joint nearest to where
/// the given one begins, as some are drawn with a root on the ground.
fn first(own: &Limbs, other: &Limbs) -> (usize, usize) {
    let nearest = |among: &[DVec3], to: DVec3| {
        let off = among.iter().enumerate().map(|(joint, p)| (joint, p.distance(to)));
        off.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f64::INFINITY))
    };
    let (given, off) = nearest(&own.heads, other.heads[0]);
    let (drawn, apart) = nearest(&other.heads, own.heads[0]);
    if off > FAR && apart < MUCH * off { (0, drawn) } else { (given, 0) }
}

/// The drawn joints that are left, given ones at their places, and those that were not drawn.
fn whole(own: &Limbs, other: &Limbs, found: &[Option<usize>], mut place: Vec<Option<usize>>) -> Merged {
    let mut number = vec![None; found.len()];
    let (mut positions, mut given, mut moved) = (Vec::new(), Vec::new(), Vec::new());
    let stays: Vec<usize> = (0..found.len()).filter(|&c| !other.left_out[c]).collect();
    for &c in &stays {
        number[c] = Some(positions.len());
        let stands = found[c].map_or(other.heads[c], |g| own.heads[g]);
        positions.push(stands.to_array());
        given.push(found[c]);
        moved.push(Some(stands - other.heads[c]));
    }
    // What hung on a given joint: it may have more joints on its way than were drawn.
    let hung = |from: usize, to: DVec3| {
        let off = |g: &usize| own.heads[*g].distance(to);
        let nearest = (0..own.heads.len()).min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(from);
        if off(&nearest) < MUCH * off(&from) { nearest } else { from }
    };
    for (g, place) in place.iter_mut().enumerate() {
        *place = place.and_then(|c| number[c]);
        if place.is_none() {
            *place = Some(positions.len());
            positions.push(own.heads[g].to_array());
            given.push(Some(g));
            moved.push(None);
        }
    }
    let parent = |at: usize| match (given[at], stays.get(at)) {
        (Some(g), _) => own.parents[g].and_then(|above| place[above]),
        (None, Some(&c)) => other.parents[c].and_then(|above| match found[above] {
            Some(g) => place[hung(g, other.heads[c])],
            None => number[above],
        }),
        (None, None) => None,
    };
    let parents = (0..positions.len()).map(parent).collect();
    Merged { tree: Joints { positions, parents }, given, moved }
}

impl Merged {
    /// The same with parents before their children.
    fn in_order(self) -> Self {
        let depth = |mut joint: usize| {
            let mut above = 0;
            while let Some(parent) = self.tree.parents[joint] {
                (joint, above) = (parent, above + 1);
            }
            above
        };
        let mut order: Vec<usize> = (0..self.given.len()).collect();
        order.sort_by_key(|&joint| depth(joint));
        let mut place = vec![0; order.len()];
        order.iter().enumerate().for_each(|(at, &joint)| place[joint] = at);
        Self {
            tree: Joints {
                positions: order.iter().map(|&joint| self.tree.positions[joint]).collect(),
                parents: order.iter().map(|&joint| self.tree.parents[joint].map(|parent| place[parent])).collect(),
            },
            given: order.iter().map(|&joint| self.given[joint]).collect(),
            moved: order.iter().map(|&joint| self.moved[joint]).collect(),
        }
    }
}

/// How far what a given joint says of the joints around it reaches, in the cube: a normal density's deviation.
const REACH: f64 = 0.4;
/// How much speaks for a joint to stay where it was drawn, where a given joint at its place counts 1.
const STAYS: f64 = 0.3;

/// Draws err alike in joints that are near each other: what was drawn around joints that are known goes with them.
fn follow(all: &mut Merged) {
    let came = |joint: usize| all.moved[joint].map(|by| (DVec3::from(all.tree.positions[joint]) - by, by));
    let known = (0..all.given.len()).filter(|&joint| all.given[joint].is_some());
    let known: Vec<(DVec3, DVec3)> = known.filter_map(came).collect();
    for joint in (0..all.given.len()).filter(|&joint| all.given[joint].is_none()) {
        let place = DVec3::from(all.tree.positions[joint]);
        let (mut sum, mut weight) = (DVec3::ZERO, STAYS);
        for &(from, by) in &known {
            let own = libm::exp(-from.distance_squared(place) / (2.0 * REACH * REACH));
            sum += own * by;
            weight += own;
        }
        let by = sum / weight;
        all.tree.positions[joint] = (place + by).to_array();
        all.moved[joint] = Some(by);
    }
}

/// What lies so near is not told apart, in the cube: five cells of 256.
const NEAR: f64 = 0.04;
/// How far limbs may lie apart, on average, to be one: somewhat more than what the joints of a draw are off.
const APART: f64 = 0.15;

/// How far where a drawn skeleton begins may lie from all given joints, before it is asked whether it begins elsewhere.
const FAR: f64 = 0.3;
/// What is nearer than this share of another distance is much nearer.
const MUCH: f64 = 0.5;

/// A skeleton by its limbs: a joint with all below it.
struct Limbs {
    heads: Vec<DVec3>,
    parents: Vec<Option<usize>>,
    children: Vec<Vec<usize>>,
    left_out: Vec<bool>,
}

impl Limbs {
    fn new(Joints { positions, parents }: &Joints) -> Self {
        let mut children = vec![Vec::new(); positions.len()];
        parents.iter().enumerate().for_each(|(joint, parent)| parent.iter().for_each(|&p| children[p].push(joint)));
        let heads = positions.iter().map(|&p| p.into()).collect();
        Self { heads, parents: parents.clone(), children, left_out: vec![false; positions.len()] }
    }

    /// Takes a joint out; what hangs on it hangs on `heir`, which itself comes to hang where the joint did, if it is one of
    /// those.
    fn leave_out(&mut self, joint: usize, heir: usize) {
        let above = self.parents[joint];
        self.left_out[joint] = true;
        if let Some(above) = above {
            self.children[above].retain(|&c| c != joint);
        }
        for child in std::mem::take(&mut self.children[joint]) {
            let to = if child == heir { above } else { Some(heir) };
            self.parents[child] = to;
            if let Some(to) = to {
                self.children[to].push(child);
            }
        }
    }

    /// The joint of the limb that `joint` begins which is nearest to a place, if it is much nearer than `joint` is.
    fn further_along(&self, joint: usize, to: DVec3) -> usize {
        let off = |&c: &usize| self.heads[c].distance(to);
        let nearest = self.below(joint).into_iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(joint);
        if off(&nearest) < MUCH * off(&joint) { nearest } else { joint }
    }

    /// The joints of the limb that a joint begins.
    fn below(&self, joint: usize) -> Vec<usize> {
        let mut all = vec![joint];
        let mut next = 0;
        while let Some(&joint) = all.get(next) {
            all.extend(&self.children[joint]);
            next += 1;
        }
        all
    }

    fn from(&self, joint: usize) -> DVec3 {
        self.parents[joint].map_or(self.heads[joint], |parent| self.heads[parent])
    }

    /// The distance of a point from the bones that end in these joints.
    fn distance(&self, joints: &[usize], p: DVec3) -> f64 {
        let to = |&joint: &usize| {
            let (a, bone) = (self.from(joint), self.heads[joint] - self.from(joint));
            p.distance(a + share(p - a, bone) * bone)
        };
        joints.iter().map(to).fold(f64::INFINITY, f64::min)
    }
}

/// How far along a bone the nearest point to one lies.
fn share(p: DVec3, bone: DVec3) -> f64 {
    if bone == DVec3::ZERO { 0.0 } else { (p.dot(bone) / bone.length_squared()).clamp(0.0, 1.0) }
}

/// How far a given limb is from a drawn one that may be it: the mean distance of its joints from the other's bones. They
/// are one where their first bones lie along each other, or where that is little and the drawn one begins near the given one.
fn alike((own, g): (&Limbs, usize), (other, c): (&Limbs, usize)) -> Option<f64> {
    let (limb, its) = (own.below(g), other.below(c));
    let mean = limb.iter().map(|&joint| other.distance(&its, own.heads[joint])).sum::<f64>() / limb.len() as f64;
    let first = along(own.heads[g] - own.from(g), other.heads[c] - other.from(c));
    (first || mean <= APART && own.distance(&limb, other.heads[c]) <= APART).then_some(mean)
}

/// Whether bones from one joint lie along each other: the shorter ends within half its length of the other.
fn along(a: DVec3, b: DVec3) -> bool {
    let (short, long) = if a.length() <= b.length() { (a, b) } else { (b, a) };
    short.distance(share(short, long) * long) <= (0.5 * short.length()).max(NEAR)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tree(joints: &[[f64; 3]], parents: &[Option<usize>]) -> Joints {
        Joints { positions: joints.to_vec(), parents: parents.to_vec() }
    }

    #[test]
    fn given_joints_take_the_places_of_drawn_ones_whose_bones_lie_along_theirs() {
        // Hips, a leg to each side and a spine are drawn; hips, the right leg and a spine of one bone that is as long are given.
        let drawn = tree(
            &[[0.0, 0.0, 0.0], [-0.2, -0.5, 0.0], [0.2, -0.5, 0.0], [0.0, 0.3, 0.0], [0.0, 0.6, 0.0]],
            &[None, Some(0), Some(0), Some(0), Some(3)],
        );
        let given = tree(&[[0.0, 0.1, 0.0], [0.0, 0.4, 0.0], [0.25, -0.4, 0.0]], &[None, Some(0), Some(0)]);
        let all = grafted(&given, &drawn);
        assert_eq!(all.given, [Some(0), None, Some(2), Some(1), None]);
        assert_eq!(all.tree.positions[..1], given.positions[..1]);
        assert_eq!((all.tree.positions[2], all.tree.positions[3]), (given.positions[2], given.positions[1]));
        assert_eq!(all.tree.parents, drawn.parents);
        let wanted = [(0, [0.0, 0.1, 0.0]), (2, [0.05, 0.1, 0.0]), (3, [0.0, 0.1, 0.0])];
        let near = |&(joint, wanted): &(usize, [f64; 3])| all.moved[joint].unwrap().distance(wanted.into()) < 1e-9;
        assert!(wanted.iter().all(near), "{:?}", all.moved);
    }

    #[test]
    fn drawn_joints_between_given_ones_are_left_out() {
        // A spine in three with arms from its second joint are drawn; hips, a head and one arm that hangs on the hips are given.
        let drawn = tree(
            &[[0.0; 3], [0.0, 0.2, 0.0], [0.0, 0.4, 0.0], [0.0, 0.6, 0.0], [0.3, 0.4, 0.0], [-0.3, 0.4, 0.0]],
            &[None, Some(0), Some(1), Some(2), Some(2), Some(2)],
        );
        let given = tree(&[[0.0; 3], [0.0, 0.62, 0.0], [0.31, 0.4, 0.0]], &[None, Some(0), Some(0)]);
        let all = grafted(&given, &drawn);
        assert_eq!(all.given, [Some(0), Some(1), Some(2), None], "the other arm is left");
        // It began nearest to the hips.
        assert_eq!(all.tree.parents, [None, Some(0), Some(0), Some(0)]);
    }

    #[test]
    fn a_root_on_the_ground_that_nobody_gave_is_left_out() {
        let drawn =
            tree(&[[0.0, -1.0, 0.0], [0.0; 3], [0.0, 0.5, 0.0], [0.1, -0.9, 0.0]], &[None, Some(0), Some(1), Some(0)]);
        let given = tree(&[[0.0, 0.02, 0.0]], &[None]);
        let all = grafted(&given, &drawn);
        assert_eq!((all.given, all.tree.parents), (vec![Some(0), None, None], vec![None, Some(0), Some(0)]));
        assert!(DVec3::from(all.tree.positions[1]).distance(DVec3::new(0.0, 0.5, 0.0)) < 0.02);
        // One that is near begins where the given one does.
        let low = tree(&[[0.0, -0.2, 0.0], [0.0; 3]], &[None, Some(0)]);
        assert_eq!(grafted(&given, &low).given, [Some(0), None]);
    }

    #[test]
    fn what_is_drawn_around_given_joints_goes_with_them() {
        // An arm in three is drawn too low, and a foot far away; the shoulder and elbow are given higher up.
        let drawn = tree(
            &[[0.0, 0.5, 0.0], [0.3, 0.5, 0.0], [0.6, 0.5, 0.0], [0.0, -2.0, 0.0]],
            &[None, Some(0), Some(1), Some(0)],
        );
        let given = tree(&[[0.0, 0.7, 0.0], [0.3, 0.7, 0.0]], &[None, Some(0)]);
        let all = grafted(&given, &drawn);
        assert_eq!(all.given, [Some(0), Some(1), None, None]);
        let moved =
            |joint: usize, from: usize| DVec3::from(all.tree.positions[joint]) - DVec3::from(drawn.positions[from]);
        let (foot, hand) = (moved(2, 3), moved(3, 2));
        // Densities at distances of .6 and .3 of the deviation .4, beside what speaks for its staying.
        let (far, near) = ((-1.125f64).exp(), (-0.28125f64).exp());
        let wanted = 0.2 * (far + near) / (far + near + 0.3);
        assert!((hand.y - wanted).abs() < 1e-12 && hand.x == 0.0 && foot.length() < 1e-6, "{hand} {foot}");
        assert!(all.moved[3].unwrap().distance(hand) < 1e-12);
        // A joint at which nothing is off moves nothing.
        let same = tree(&drawn.positions[..2], &[None, Some(0)]);
        assert_eq!(grafted(&same, &drawn).tree.positions[..2], drawn.positions[..2]);
        assert!(grafted(&same, &drawn).moved.iter().all(|by| *by == Some(DVec3::ZERO)));
    }

    #[test]
    fn what_was_not_drawn_is_added_with_all_below_it() {
        let drawn = tree(&[[0.0; 3], [0.0, 0.5, 0.0]], &[None, Some(0)]);
        let given = tree(&[[0.0; 3], [0.5, 0.0, 0.0], [0.9, 0.0, 0.0]], &[None, Some(0), Some(1)]);
        let all = grafted(&given, &drawn);
        assert_eq!(all.given, [Some(0), None, Some(1), Some(2)]);
        assert_eq!(all.tree.parents, [None, Some(0), Some(0), Some(2)]);
        assert_eq!(all.moved, [Some(DVec3::ZERO), Some(DVec3::ZERO), None, None]);
    }

    #[test]
    fn bones_along_each_other_are_told_by_the_shorter_one() {
        let v = |x: f64, y: f64| DVec3::new(x, y, 0.0);
        assert!(along(v(0.0, 1.0), v(0.0, 0.4)) && !along(v(0.0, 1.0), v(0.0, -0.4)));
        assert!(along(v(0.0, 1.0), v(0.2, 0.4)) && !along(v(0.0, 1.0), v(0.4, 0.4)));
        // Ends that are nearly in one place, and bones of no length.
        assert!(along(v(0.0, 0.01), v(0.01, -0.01)) && along(v(0.0, 0.0), v(0.0, 0.0)));
    }

    #[test]
    fn a_limb_that_begins_another_way_is_the_same_if_it_goes_to_the_same_place() {
        // The drawn spine goes straight to the head, the given one rises first; a tail goes the other way.
        let drawn =
            tree(&[[0.0; 3], [0.3, 0.0, 0.0], [0.6, 0.1, 0.0], [-0.3, 0.0, 0.0]], &[None, Some(0), Some(1), Some(0)]);
        let given = tree(
            &[[0.0; 3], [0.05, 0.14, 0.0], [0.35, 0.12, 0.0], [0.62, 0.14, 0.0]],
            &[None, Some(0), Some(1), Some(2)],
        );
        let all = grafted(&given, &drawn);
        assert_eq!(all.given, [Some(0), Some(1), None, Some(2), Some(3)]);
        // Alone, its first bone is no limb that goes there.
        let given = tree(&[[0.0; 3], [0.0, 0.4, 0.0]], &[None, Some(0)]);
        assert_eq!(grafted(&given, &drawn).given[..4], [Some(0), None, None, Some(1)]);
    }
}
