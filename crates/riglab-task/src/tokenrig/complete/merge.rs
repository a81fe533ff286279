//! A skeleton that was drawn and joints that are given, as one tree.

use glam::DVec3;
use riglab_token::Decoded;

/// Joints as arrays.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tree {
    /// Positions in the cube, J × 3.
    pub joints: Vec<[f64; 3]>,
    /// Of each joint.
    pub parents: Vec<Option<usize>>,
}

/// A drawn skeleton with every given joint in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Merged {
    /// First the drawn joints in their order, those that are given ones at their places; then what was not drawn.
    pub tree: Tree,
    /// Which of the given joints each is.
    pub given: Vec<Option<usize>>,
    /// How far each stands from where it was drawn: infinitely far if nothing was drawn in its place, and 0 for drawn
    /// joints.
    pub off: Vec<f64>,
}

/// Finds given joints, the root first and parents before children, among those of a skeleton that was drawn freely. Its root
/// is the given joint nearest to it: what is above that one it has no part in. From there on a given joint is looked for
/// among the children of the joint that its parent was found to be: it is the one that begins the same limb, the most
/// alike first. A limb that is left hangs on the given joint that is nearest to where it begins, if it was drawn to hang on
/// one.
pub fn grafted(given: &Tree, drawn: &Decoded) -> Merged {
    let nearest = |to: [f32; 3]| {
        let off = |g: &usize| DVec3::from(given.joints[*g]).distance(at(to));
        (0..given.joints.len()).min_by(|a, b| off(a).total_cmp(&off(b)))
    };
    let mut all = merged(given, drawn, nearest(drawn.joints[0]).unwrap_or(0));
    let place = |g: usize| all.given.iter().position(|own| *own == Some(g));
    let hung = |c: usize| {
        let parent = drawn.parents[c].filter(|&parent| all.given[c].is_none() && all.given[parent].is_some());
        parent.and_then(|_| nearest(drawn.joints[c])).and_then(place)
    };
    let hung: Vec<Option<usize>> = (0..drawn.joints.len()).map(hung).collect();
    for (parent, hung) in all.tree.parents.iter_mut().zip(hung) {
        *parent = hung.or(*parent);
    }
    all
}

/// Limb by limb, where the drawn root is the given joint `root`.
fn merged(given: &Tree, drawn: &Decoded, root: usize) -> Merged {
    let mut found: Vec<Option<usize>> = vec![None; drawn.joints.len()];
    let mut place = vec![None; given.joints.len()];
    (found[0], place[root]) = (Some(root), Some(0));
    let own = Limbs::new(given.joints.iter().map(|&p| p.into()).collect(), &given.parents);
    let other = Limbs::new(drawn.joints.iter().map(|&p| at(p)).collect(), &drawn.parents);
    // Parents stand before their children in both, so that a parent's place is known when its children are looked for.
    for parent in 0..given.joints.len() {
        let Some(from) = place[parent] else { continue };
        let pairs = other.children[from].iter().flat_map(|&c| own.children[parent].iter().map(move |&g| (g, c)));
        let mut pairs: Vec<_> = pairs.filter_map(|(g, c)| Some((alike((&own, g), (&other, c))?, g, c))).collect();
        pairs.sort_by(|a, b| a.0.total_cmp(&b.0));
        for (_, g, c) in pairs {
            if place[g].is_none() && found[c].is_none() {
                (place[g], found[c]) = (Some(c), Some(g));
            }
        }
    }
    let (mut tree, mut off) = (Tree { parents: drawn.parents.clone(), ..Tree::default() }, Vec::new());
    for (c, own) in found.iter().enumerate() {
        let was = drawn.joints[c].map(f64::from);
        let stands = own.map_or(was, |g| given.joints[g]);
        tree.joints.push(stands);
        off.push(DVec3::from(was).distance(DVec3::from(stands)));
    }
    for g in 0..given.joints.len() {
        if place[g].is_none() {
            place[g] = Some(tree.joints.len());
            tree.joints.push(given.joints[g]);
            tree.parents.push(given.parents[g].and_then(|p| place[p]));
            found.push(Some(g));
            off.push(f64::INFINITY);
        }
    }
    Merged { tree, given: found, off }
}

fn at(p: [f32; 3]) -> DVec3 {
    DVec3::from(p.map(f64::from))
}

/// What lies so near is not told apart, in the cube: five cells of 256.
const NEAR: f64 = 0.04;
/// How far limbs may lie apart, on average, to be one: somewhat more than what the joints of a draw are off.
const APART: f64 = 0.15;

/// A skeleton by its limbs: a joint with all below it.
struct Limbs<'a> {
    heads: Vec<DVec3>,
    parents: &'a [Option<usize>],
    children: Vec<Vec<usize>>,
}

impl<'a> Limbs<'a> {
    fn new(heads: Vec<DVec3>, parents: &'a [Option<usize>]) -> Self {
        let mut children = vec![Vec::new(); heads.len()];
        parents.iter().enumerate().for_each(|(joint, parent)| parent.iter().for_each(|&p| children[p].push(joint)));
        Self { heads, parents, children }
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
fn alike((own, g): (&Limbs<'_>, usize), (other, c): (&Limbs<'_>, usize)) -> Option<f64> {
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

    fn drawn(joints: &[[f32; 3]], parents: &[Option<usize>]) -> Decoded {
        Decoded {
            joints: joints.to_vec(),
            parents: parents.to_vec(),
            names: (0..joints.len()).map(|k| format!("bone_{k}")).collect(),
            class: None,
            parts: Vec::new(),
        }
    }

    fn tree(joints: &[[f64; 3]], parents: &[Option<usize>]) -> Tree {
        Tree { joints: joints.to_vec(), parents: parents.to_vec() }
    }

    #[test]
    fn given_joints_take_the_places_of_drawn_ones_whose_bones_lie_along_theirs() {
        // Hips, a leg to each side and a spine are drawn; hips, the right leg and a longer spine are given.
        let drawn = drawn(
            &[[0.0, 0.0, 0.0], [-0.2, -0.5, 0.0], [0.2, -0.5, 0.0], [0.0, 0.3, 0.0], [0.0, 0.6, 0.0]],
            &[None, Some(0), Some(0), Some(0), Some(3)],
        );
        let given = tree(&[[0.0, 0.1, 0.0], [0.0, 0.7, 0.0], [0.25, -0.4, 0.0]], &[None, Some(0), Some(0)]);
        let all = merged(&given, &drawn, 0);
        assert_eq!(all.given, [Some(0), None, Some(2), Some(1), None]);
        assert_eq!(all.tree.joints[..1], given.joints[..1]);
        assert_eq!((all.tree.joints[2], all.tree.joints[3]), (given.joints[2], given.joints[1]));
        assert_eq!(all.tree.parents, drawn.parents);
        let wanted = [0.1, 0.0, (0.05f64.powi(2) + 0.1f64.powi(2)).sqrt(), 0.4, 0.0];
        assert!(all.off.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{:?}", all.off);
    }

    #[test]
    fn a_free_skeleton_is_grafted_where_it_fits() {
        // Hips, a spine in two, and an arm from its end are drawn; a root on the ground, hips and a spine in one are given.
        let drawn = drawn(
            &[[0.0, 0.0, 0.0], [0.0, 0.3, 0.0], [0.0, 0.6, 0.0], [0.3, 0.6, 0.0]],
            &[None, Some(0), Some(1), Some(2)],
        );
        let given = tree(&[[0.0, -0.8, 0.0], [0.0, 0.05, 0.0], [0.0, 0.65, 0.0]], &[None, Some(0), Some(1)]);
        let all = grafted(&given, &drawn);
        let of = |joint: usize| all.tree.parents[joint].and_then(|parent| all.given[parent]);
        assert_eq!(all.given, [Some(1), Some(2), None, None, Some(0)]);
        // What was drawn to hang on a given joint hangs on the nearest of these, and the arm on what it did.
        assert_eq!((of(2), all.tree.parents[3]), (Some(2), Some(2)));
    }

    #[test]
    fn what_was_not_drawn_is_added_with_all_below_it() {
        let drawn = drawn(&[[0.0; 3], [0.0, 0.5, 0.0]], &[None, Some(0)]);
        let given = tree(&[[0.0; 3], [0.5, 0.0, 0.0], [0.9, 0.0, 0.0]], &[None, Some(0), Some(1)]);
        let all = merged(&given, &drawn, 0);
        assert_eq!(all.given, [Some(0), None, Some(1), Some(2)]);
        assert_eq!(all.tree.parents, [None, Some(0), Some(0), Some(2)]);
        assert_eq!(all.off, [0.0, 0.0, f64::INFINITY, f64::INFINITY]);
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
            drawn(&[[0.0; 3], [0.3, 0.0, 0.0], [0.6, 0.1, 0.0], [-0.3, 0.0, 0.0]], &[None, Some(0), Some(1), Some(0)]);
        let given = tree(
            &[[0.0; 3], [0.05, 0.14, 0.0], [0.35, 0.12, 0.0], [0.62, 0.14, 0.0]],
            &[None, Some(0), Some(1), Some(2)],
        );
        let all = merged(&given, &drawn, 0);
        assert_eq!(all.given[..4], [Some(0), Some(1), Some(2), None]);
        // Alone, its first bone is no limb that goes there.
        let given = tree(&[[0.0; 3], [0.0, 0.4, 0.0]], &[None, Some(0)]);
        assert_eq!(merged(&given, &drawn, 0).given[..4], [Some(0), None, None, None]);
    }
}
