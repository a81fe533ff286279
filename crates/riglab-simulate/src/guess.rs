//! Springs for rigs that have none.

use riglab_core::{HumanBone, JointId, Rig, Skeleton, Spring, SpringJoint, Springs, Swing, Vec3};

/// A height at which attributes are what artists give an avatar, in metres; others have them in proportion, for
/// stiffness and gravity are lengths a second.
const HEIGHT: f32 = 1.6;

/// What swings, by words in names of joints, with stiffness, drag and gravity as artists set them.
const KINDS: [(&[&str], [f32; 3]); 5] = [
    (
        &[
            "hair", "bang", "bangs", "ponytail", "pony", "braid", "pigtail", "ahoge", "fringe", "mane", "whisker",
            "beard",
        ],
        [0.8, 0.45, 0.1],
    ),
    (
        &[
            "skirt", "cape", "cloak", "coat", "cloth", "dress", "scarf", "ribbon", "sash", "robe", "tassel", "strap",
            "hood", "tie", "sleeve", "mantle",
        ],
        [1.0, 0.45, 0.3],
    ),
    (&["tail", "tentacle", "trunk", "chain", "rope"], [1.1, 0.4, 0.05]),
    (&["ear", "ears", "antenna", "antennae", "feeler"], [1.7, 0.4, 0.05]),
    (&["bust", "breast", "boob", "belly", "jiggle"], [2.5, 0.55, 0.0]),
];

/// Springs for a rig by the names of its joints: hair, cloth, tails, ears and the like, with what hangs on
/// them. Human bones do not swing. Joints that end a chain swing about a point that goes on from their parent.
/// Attributes are those of an avatar, in proportion to the rig's height; nothing stops what swings.
///
/// Empty where no name tells.
pub fn guess(rig: &Rig) -> Springs {
    let skeleton = rig.skeleton();
    let kinds = kinds(rig);
    let children = skeleton.children();
    let size = rig.bounds().size()[1] / HEIGHT;
    let size = if size > 0.0 && size.is_finite() { size } else { 1.0 };
    // The spring that each joint is of.
    let mut spring_of: Vec<Option<usize>> = vec![None; skeleton.len()];
    let mut springs: Vec<Spring> = Vec::new();
    for joint in skeleton.ids() {
        let Some(kind) = kinds[joint.index()] else { continue };
        let above = skeleton.parent(joint).and_then(|p| spring_of[p.index()]);
        let number = above.unwrap_or_else(|| {
            springs.push(Spring { name: skeleton.name(joint).into(), ..Spring::default() });
            springs.len() - 1
        });
        spring_of[joint.index()] = Some(number);
        let next = children[joint.index()].first().copied();
        let [stiffness, drag, gravity] = KINDS[kind].1;
        let swing = Swing { stiffness: stiffness * size, drag, gravity_power: gravity * size, ..Swing::default() };
        springs[number].joints.push(SpringJoint { joint, tail: tail(skeleton, joint, next), swing });
    }
    Springs::new(springs, Vec::new(), Vec::new()).unwrap_or_default()
}

/// What each joint is, by its own name or that of one above.
fn kinds(rig: &Rig) -> Vec<Option<usize>> {
    let skeleton = rig.skeleton();
    let mut kinds: Vec<Option<usize>> = vec![None; skeleton.len()];
    let human: Vec<JointId> = rig.humanoid().iter().map(|(_, joint): (HumanBone, JointId)| joint).collect();
    for joint in skeleton.ids() {
        if human.contains(&joint) {
            continue;
        }
        let words = words(skeleton.name(joint));
        let own = KINDS.iter().position(|(names, _)| words.iter().any(|w| names.contains(&w.as_str())));
        // The root has nothing to swing from.
        let parent = skeleton.parent(joint);
        kinds[joint.index()] = parent.and_then(|p| own.or(kinds[p.index()]));
    }
    // A head with ears may hang on a tail's end, but what carries a human bone does not swing.
    for &joint in &human {
        for above in std::iter::successors(skeleton.parent(joint), |j| skeleton.parent(*j)) {
            kinds[above.index()] = None;
        }
    }
    kinds
}

/// The words of a name: runs of letters, cut also where a capital follows a small one.
fn words(name: &str) -> Vec<String> {
    let mut words = vec![String::new()];
    let mut small = false;
    for c in name.chars() {
        if !c.is_alphabetic() || (c.is_uppercase() && small) {
            words.push(String::new());
        }
        if c.is_alphabetic() {
            words.last_mut().expect("never empty").extend(c.to_lowercase());
        }
        small = c.is_lowercase();
    }
    words.retain(|w| !w.is_empty());
    words
}

/// Where a bone ends: at its first child, or as far on as it is from its parent.
fn tail(skeleton: &Skeleton, joint: JointId, next: Option<JointId>) -> Option<Vec3> {
    let head = skeleton.head(joint);
    let tail = match (next, skeleton.parent(joint)) {
        (Some(next), _) => skeleton.head(next),
        (None, Some(parent)) => {
            let above = skeleton.head(parent);
            std::array::from_fn(|k| 2.0 * head[k] - above[k])
        }
        (None, None) => return None,
    };
    tail.iter().all(|x| x.is_finite()).then_some(tail)
}

#[cfg(test)]
mod tests {
    use riglab_core::{Humanoid, Joint, Mesh, SkinWeights};

    use super::*;

    fn rig(joints: &[(&str, u16)]) -> Rig {
        let joint = |(k, (name, parent)): (usize, &(&str, u16))| Joint {
            name: (*name).into(),
            parent: (k > 0).then_some(JointId(*parent)),
            head: [0.0, 1.6 * k as f32, 0.0],
        };
        let skeleton = Skeleton::new(joints.iter().enumerate().map(joint).collect()).unwrap();
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        Rig::new(skeleton, mesh, SkinWeights::normalized(vec![vec![(0, 1.0)]; 3]).unwrap()).unwrap()
    }

    #[test]
    fn names_are_cut_into_words() {
        assert_eq!(words("J_Sec_Hair1_01"), ["j", "sec", "hair"]);
        assert_eq!(words("leftEarTip"), ["left", "ear", "tip"]);
        assert_eq!(words("forearm.L"), ["forearm", "l"]);
        assert!(words("12").is_empty());
    }

    #[test]
    fn what_hangs_swings_and_what_carries_does_not() {
        let rig =
            rig(&[("hips", 0), ("head", 0), ("hair_1", 1), ("bone_7", 2), ("Skirt", 0), ("tail", 0), ("hand", 5)]);
        let springs = guess(&rig);
        let found: Vec<(&str, Vec<u16>)> =
            springs.springs().iter().map(|s| (s.name.as_str(), s.joints.iter().map(|j| j.joint.0).collect())).collect();
        assert_eq!(found, [("hair_1", vec![2, 3]), ("Skirt", vec![4]), ("tail", vec![5, 6])]);
        let hair = &springs.springs()[0].joints;
        assert!((hair[0].tail.unwrap()[1] - 4.8).abs() < 1e-5 && (hair[1].tail.unwrap()[1] - 6.4).abs() < 1e-5);
        // Six times the height of an avatar.
        assert!((hair[0].swing.stiffness - 0.8 * 6.0).abs() < 1e-4);
        // The hand is a human bone, so what it hangs on is no tail.
        let mut human = Humanoid::default();
        human.insert(HumanBone::all().last().unwrap(), JointId(6));
        let springs = guess(&rig.with_humanoid(human).unwrap());
        assert_eq!(springs.springs().iter().map(|s| s.name.as_str()).collect::<Vec<_>>(), ["hair_1", "Skirt"]);
    }

    #[test]
    fn a_rig_that_tells_nothing_has_none() {
        assert!(guess(&rig(&[("hair", 0), ("bone_1", 0), ("forearm", 1), ("detail", 2)])).is_empty());
    }
}
