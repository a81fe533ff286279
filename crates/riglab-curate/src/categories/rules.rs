//! The rules, from what says most to what says least.

use super::{Category, Guess, Traits};

/// From here on a surface moves in rigid pieces, as machines do and few bodies.
const RIGID: f64 = 0.93;

/// The category that traits speak for.
pub(super) fn judge(t: &Traits) -> Guess {
    let rules =
        [avatar, named_after, machine, insect, swimmer, winged, four_legs, two_legs_and_arms, upper_body, two_legs];
    let found = rules.iter().find_map(|rule| rule(t)).or_else(|| limbless(t)).or_else(|| shape(t));
    let (category, because) = found.unwrap_or((Category::MechanicalOther, "nothing speaks for a creature"));
    Guess { category, because }
}

type Verdict = Option<(Category, &'static str)>;

fn avatar(t: &Traits) -> Verdict {
    if t.vrm {
        return Some((Category::AnimeVrm, "the file maps its joints to VRM's human bones"));
    }
    t.avatar_names.then_some((Category::AnimeVrm, "its joints are named as avatars' are"))
}

/// Whether arms are front legs: pairs of limbs stand on the ground before and behind.
fn on_all_fours(t: &Traits) -> bool {
    (t.limb_pairs_down >= 2 && t.lying > 0.0) || (t.limbs.lying > 0.4 && t.lying > 0.0 && t.feet >= 3)
}

/// A tail as dinosaurs have: long, and a good part of the body.
fn heavy_tail(t: &Traits) -> bool {
    t.tails >= 4 && t.tail_share >= 0.08 && t.ears == 0
}

fn named_after(t: &Traits) -> Verdict {
    let (category, _) = t.named_after.filter(|(_, share)| *share >= 0.5)?;
    Some((category, "its joints are named after a creature"))
}

fn machine(t: &Traits) -> Verdict {
    (t.machine >= 0.3).then_some((Category::MechanicalOther, "its joints are named after parts of things"))
}

fn insect(t: &Traits) -> Verdict {
    if t.legs >= 6 {
        return Some((Category::Arthropod, "six legs or more"));
    }
    (t.insect >= 2 && t.fingers == 0).then_some((Category::Arthropod, "joints named after parts of insects"))
}

fn swimmer(t: &Traits) -> Verdict {
    (t.fins >= 2 && t.legs == 0 && t.arms == 0).then_some((Category::Aquatic, "fins and no legs"))
}

fn winged(t: &Traits) -> Verdict {
    if t.wings == 0 && t.feathers == 0 {
        return None;
    }
    Some(if t.feathers == 0 && t.legs >= 2 && (t.tails >= 3 || t.hands > 0) {
        (Category::Reptile, "wings with a long tail, or with hands")
    } else if t.feathers == 0 && t.legs == 0 && t.tails == 0 && t.arms == 0 && t.joints <= 16 {
        (Category::Arthropod, "wings on a body without legs or tail")
    } else {
        (Category::BirdFlying, "wings")
    })
}

fn four_legs(t: &Traits) -> Verdict {
    if t.legs < 4 {
        return None;
    }
    Some(if t.heads + t.tails + t.ears == 0 || (t.rigidity >= RIGID && t.feet == 2 && t.tails == 0) {
        (Category::MechanicalOther, "four legs without a head")
    } else if t.ears > 0 {
        (Category::Quadruped, "four legs, and ears")
    } else if heavy_tail(t) {
        (Category::Reptile, "four legs and a thick, long tail")
    } else if t.tails == 0 && t.size[0] >= 0.8 * t.size[2] && t.rigidity < RIGID && t.size[1] < 0.6 {
        (Category::Reptile, "four legs spread wide, no tail")
    } else {
        (Category::Quadruped, "four legs")
    })
}

fn two_legs_and_arms(t: &Traits) -> Verdict {
    if t.legs < 2 || t.arms < 2 {
        return None;
    }
    Some(if on_all_fours(t) && t.fingers < 16 {
        if heavy_tail(t) {
            (Category::Reptile, "it stands on arms and legs and has a thick, long tail")
        } else {
            (Category::Quadruped, "it stands on arms and legs")
        }
    } else if t.tails >= 4 && t.lying > 0.0 && t.ears == 0 {
        (Category::Reptile, "arms, legs and a long tail on a lying body")
    } else if t.rigidity >= 0.955 && t.skinned >= 12 && t.spines <= 2 {
        (Category::MechanicalOther, "arms and legs of rigid pieces on a short spine")
    } else {
        (Category::Humanoid, "arms and legs")
    })
}

fn upper_body(t: &Traits) -> Verdict {
    if t.fingers >= 6 {
        return Some((Category::Humanoid, "fingers"));
    }
    if t.legs > 0 || t.arms < 2 || t.heads == 0 {
        return None;
    }
    Some(if t.rigidity >= RIGID {
        (Category::MechanicalOther, "arms of rigid pieces and no legs")
    } else {
        (Category::Humanoid, "arms and a head")
    })
}

fn two_legs(t: &Traits) -> Verdict {
    if t.legs != 2 {
        return None;
    }
    Some(if t.rigidity >= RIGID {
        (Category::MechanicalOther, "legs of rigid pieces and no arms")
    } else if t.tails >= 4 {
        (Category::Reptile, "two legs and a long tail")
    } else if t.heads > 0 && t.lying > -0.4 {
        (Category::BirdFlying, "two legs, no arms, a lying body")
    } else {
        (Category::Humanoid, "two legs")
    })
}

/// Of bodies that are named, but without legs and arms.
fn limbless(t: &Traits) -> Verdict {
    if t.legs > 0 || t.arms > 0 || t.heads + t.tails == 0 || t.spines + t.tails < 2 {
        return None;
    }
    if t.ears >= 2 && t.tails > 0 {
        return Some((Category::Quadruped, "ears and a tail"));
    }
    let axis = t.heads + t.spines + t.tails;
    if axis >= 10 {
        return Some((Category::Reptile, "a long spine without limbs"));
    }
    let named = t.heads > 0 && t.spines >= 2;
    if t.rigidity >= RIGID && !named {
        return None;
    }
    if t.lying > 0.5 && (named || !thin(t)) {
        return Some((Category::Aquatic, "a lying body without limbs"));
    }
    (t.tails >= 3 || (thin(t) && t.lying > 0.5)).then_some((Category::Reptile, "a long body without limbs"))
}

/// By shape alone.
fn shape(t: &Traits) -> Verdict {
    if t.nameless < 0.7 {
        return None;
    }
    if (4..=6).contains(&t.fan.0) && t.fan.1 >= 0.6 && t.symmetry < 0.5 && t.rigidity < RIGID {
        return Some((Category::Humanoid, "chains like fingers on a palm"));
    }
    if t.rigidity >= RIGID {
        return None;
    }
    limbs(t).or_else(|| chain(t))
}

/// By pairs of limbs, in the tree or mirrored.
fn limbs(t: &Traits) -> Verdict {
    let wide = t.size[0] > 0.95 && t.size[1] < 0.6 * t.size[0];
    let l = &t.limbs;
    match (l.down, l.up) {
        (3.., _) => return Some((Category::Arthropod, "three pairs of limbs on the ground")),
        (2, 1..) if wide => return Some((Category::Reptile, "four limbs on the ground and wide ones above")),
        (2, _) | (1, 1) | (0, 2) if on_all_fours(t) && !wide => {
            return Some((Category::Quadruped, "two pairs of limbs on the ground"));
        }
        (2, _) if l.lying > 0.0 => return Some((Category::Quadruped, "two pairs of limbs on the ground")),
        (1, 1..) if l.hands > 0 || l.lying < -0.2 => {
            return Some((Category::Humanoid, "limbs down, limbs up, upright"));
        }
        (0, 1..) if l.hands > 0 => return Some((Category::Humanoid, "limbs that end in hands")),
        _ => {}
    }
    if t.symmetry < 0.75 || t.limb_pairs_down + t.limb_pairs_up == 0 {
        return None;
    }
    match (t.limb_pairs_down, t.limb_pairs_up) {
        (4.., _) => Some((Category::Arthropod, "four pairs of limbs on the ground")),
        (2, 1..) if wide => Some((Category::Reptile, "four limbs on the ground and wide ones above")),
        (_, 1..) if wide => Some((Category::BirdFlying, "wide limbs above the ground")),
        (2.., _) if t.lying > -0.1 => Some((Category::Quadruped, "two pairs of limbs on the ground")),
        (1, 1..) if t.lying < -0.3 => Some((Category::Humanoid, "an upright body with limbs down and up")),
        (1, _) if t.lying > 0.3 && t.lying < 0.7 => Some((Category::BirdFlying, "a lying body on one pair of limbs")),
        _ => None,
    }
}

/// By one long chain.
fn chain(t: &Traits) -> Verdict {
    if t.chain >= 0.3 && t.lying > 0.6 && (4..=12).contains(&t.joints) {
        return Some(if thin(t) {
            (Category::Reptile, "a thin lying chain")
        } else {
            (Category::Aquatic, "a lying chain in a thick body")
        });
    }
    None
}

fn thin(t: &Traits) -> bool {
    let mut size = t.size;
    size.sort_unstable_by(f64::total_cmp);
    size[1] < 0.2
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Rig, Skeleton};
    use riglab_synth::{Options, Plan, creature};

    use super::*;

    fn rig(plan: Plan, number: u64, name: impl Fn(&str, u16) -> String) -> Rig {
        let rig = creature(2, number, &Options { plans: vec![plan], ..Options::default() }).rig;
        let s = rig.skeleton();
        let joints = s.ids().map(|j| Joint { name: name(s.name(j), j.0), parent: s.parent(j), head: s.head(j) });
        let skeleton = Skeleton::new(joints.collect()).unwrap();
        Rig::new(skeleton, rig.mesh().clone(), rig.weights().clone()).unwrap()
    }

    fn judged(rig: &Rig) -> Category {
        judge(&Traits::of(rig)).category
    }

    #[test]
    fn creatures_are_known_by_their_shape_alone() {
        let bare = |_: &str, j: u16| format!("joint{j}");
        // Rigid pieces without names are a machine, and some creatures are put together from blocks.
        let soft = |rig: &Rig| rig.weights().nonzero() > rig.weights().rows() * 21 / 20;
        for (plan, category) in [(Plan::Biped, Category::Humanoid), (Plan::Quadruped, Category::Quadruped)] {
            let rigs = (0..40).map(|k| rig(plan, k, bare)).filter(soft).take(10);
            let right = rigs.filter(|rig| judged(rig) == category).count();
            assert!(right >= 8, "{category}: {right} of 10");
        }
    }

    #[test]
    fn names_help_where_shape_says_little() {
        let biped = |name: fn(&str, u16) -> String| judged(&rig(Plan::Biped, 0, name));
        assert_eq!(biped(|_, j| format!("J_Bip_C_{j}")), Category::AnimeVrm);
        assert_eq!(biped(|_, j| format!("CHICKEN_{j}")), Category::BirdFlying);
        assert_eq!(biped(|_, j| format!("wheel_{j}")), Category::MechanicalOther);
        assert_eq!(
            biped(|_, j| format!("Leg{}.{}", j / 2 + 1, if j % 2 == 0 { "L" } else { "R" })),
            Category::Humanoid
        );
    }

    #[test]
    fn human_bones_make_an_avatar_in_a_vrm_alone() {
        let whole = rig(Plan::Biped, 0, |name, _| name.into());
        let mut human = riglab_core::Humanoid::default();
        let required = riglab_core::HumanBone::all().filter(|bone| bone.is_required());
        required.zip(whole.skeleton().ids()).for_each(|(bone, joint)| _ = human.insert(bone, joint));
        let whole = whole.with_humanoid(human).unwrap();
        assert!(whole.humanoid().is_complete());
        let judged = |vrm| crate::by_rules(&whole, vrm).category;
        assert_eq!((judged(true), judged(false)), (Category::AnimeVrm, Category::Humanoid));
    }

    #[test]
    fn legs_go_by_front_and_hind_alone() {
        let legs = ["front_upper.L", "front_lower.L", "front_upper.R", "front_lower.R", "hind_upper.L", "hind_lower.L"];
        let rest = ["hind_upper.R", "hind_lower.R", "ear.L", "ear.R", "tail_1", "tail_2", "head"];
        let names: Vec<&str> = legs.into_iter().chain(rest).collect();
        let whole = rig(Plan::Biped, 0, |_, j| names.get(usize::from(j)).map_or(format!("b{j}"), |n| (*n).to_owned()));
        assert_eq!(Traits::of(&whole).legs, 4);
        assert_eq!(judged(&whole), Category::Quadruped);
    }

    #[test]
    fn a_single_joint_is_something_else() {
        let mut joints = vec![Joint { name: "a".into(), parent: None, head: [0.0; 3] }];
        let whole = rig(Plan::Fish, 0, |n, _| n.into());
        let weights =
            riglab_core::SkinWeights::normalized(vec![vec![(0u16, 1.0)]; whole.mesh().positions().len()]).unwrap();
        let one = Rig::new(Skeleton::new(joints.clone()).unwrap(), whole.mesh().clone(), weights.clone()).unwrap();
        assert_eq!(judged(&one), Category::MechanicalOther);
        joints.push(Joint { name: "b".into(), parent: Some(JointId(0)), head: [0.0; 3] });
        let two = Rig::new(Skeleton::new(joints).unwrap(), whole.mesh().clone(), weights).unwrap();
        assert_eq!(judged(&two), Category::MechanicalOther);
    }
}
