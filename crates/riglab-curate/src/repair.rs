//! Repairs of rigs that are valid, but hold what nothing can be learnt from.
//!
//! What makes a file no rig at all is mended or refused where files are read: weights that do not sum to 1,
//! negative weights, joints named twice in a vertex, vertices without weight, loose roots. What is left to
//! do here are joints: control and IK bones without weight, and bones of length zero, unless motions that
//! are kept tell their two joints apart. Each repair is a sentence in the asset's notes.

use riglab_core::{Asset, Clip, Humanoid, Joint, JointId, JointMap, Rig, RigError, Skeleton, SkinWeights, Springs};

use crate::config::RepairConfig;

/// Mends a rig; gives a sentence for each kind of repair, which it also adds to the asset's notes.
///
/// # Errors
/// When what is left would be no rig; nothing that can be read gives one.
pub fn repair(asset: &mut Asset, config: &RepairConfig) -> Result<Vec<String>, RigError> {
    let mut told = Vec::new();
    if config.control_bones || config.end_bones {
        let gone = weightless(&asset.rig, config);
        if !gone.is_empty() {
            told.push(format!("{} left out: {}", count(gone.len(), "joint without weight"), named(&asset.rig, &gone)));
            remove(asset, &gone)?;
        }
    }
    if config.zero_length {
        let (apart, gone): (Vec<_>, Vec<_>) =
            coincident(&asset.rig, config.zero_length_share).into_iter().partition(|&joint| moves_apart(asset, joint));
        if !apart.is_empty() {
            let what = count(apart.len(), "joint of a bone without length");
            let (it, its) = if apart.len() == 1 { ("it", "its parent") } else { ("them", "their parents") };
            let why = format!("{what} left, as motions take {it} from {its}: {}", named(&asset.rig, &apart));
            asset.provenance.notes.push(why);
        }
        if !gone.is_empty() {
            let what = count(gone.len(), "joint of a bone without length");
            let its = if gone.len() == 1 { "its parent" } else { "their parents" };
            told.push(format!("{what} folded into {its}: {}", named(&asset.rig, &gone)));
            remove(asset, &gone)?;
        }
    }
    asset.provenance.notes.extend(told.iter().cloned());
    Ok(told)
}

/// Joints of branches without weight.
fn weightless(rig: &Rig, config: &RepairConfig) -> Vec<JointId> {
    let skeleton = rig.skeleton();
    let mut own = vec![false; skeleton.len()];
    rig.weights().joints().iter().for_each(|&j| own[usize::from(j)] = true);
    // Joints whose branch carries weight, or something else that has a meaning.
    let mut needed = own.clone();
    kept_for_meaning(rig, &mut needed);
    for joint in skeleton.ids().rev() {
        if let (true, Some(parent)) = (needed[joint.index()], skeleton.parent(joint)) {
            needed[parent.index()] = true;
        }
    }
    let mut gone = vec![false; skeleton.len()];
    for joint in skeleton.ids().skip(1).filter(|j| !needed[j.index()]) {
        let Some(parent) = skeleton.parent(joint) else { continue };
        gone[joint.index()] = if gone[parent.index()] {
            true
        } else if own[parent.index()] {
            // The end of a chain says where its last bone points; a control says nothing.
            config.end_bones || (config.control_bones && is_control(skeleton.name(joint)))
        } else if needed[parent.index()] {
            // Below a joint that is there for others alone, as the root.
            config.control_bones
        } else {
            // Further along a chain of ends.
            config.end_bones
        };
    }
    skeleton.ids().filter(|j| gone[j.index()]).collect()
}

/// Human bones, and what swings.
fn kept_for_meaning(rig: &Rig, kept: &mut [bool]) {
    rig.humanoid().iter().for_each(|(_, joint)| kept[joint.index()] = true);
    for spring in rig.springs().springs() {
        spring.joints.iter().for_each(|j| kept[j.joint.index()] = true);
        spring.center.iter().for_each(|j| kept[j.index()] = true);
    }
    rig.springs().colliders().iter().for_each(|c| kept[c.joint.index()] = true);
}

/// Whether a name says that a joint drives others: as words, so that "pole" is one and "tadpole" is none.
fn is_control(name: &str) -> bool {
    const WORDS: [&str; 14] = [
        "ik",
        "ctrl",
        "control",
        "controller",
        "pole",
        "poletarget",
        "target",
        "mch",
        "fk",
        "handle",
        "helper",
        "aim",
        "locator",
        "effector",
    ];
    crate::words::words(name).iter().any(|w| WORDS.contains(&w.as_str()))
}

/// Joints that stand where their parent stands, and mean nothing of their own.
fn coincident(rig: &Rig, share: f32) -> Vec<JointId> {
    let skeleton = rig.skeleton();
    let mut kept = vec![false; skeleton.len()];
    kept_for_meaning(rig, &mut kept);
    let near = rig.bounds().diagonal() * share;
    let at = |j: JointId| glam::Vec3::from(skeleton.head(j));
    let folds =
        |j: &JointId| skeleton.parent(*j).is_some_and(|parent| !kept[j.index()] && at(*j).distance(at(parent)) <= near);
    skeleton.ids().filter(folds).collect()
}

/// How far a motion may take two joints from each other anywhere in the box, as a share of its diagonal, that are one joint.
const TOGETHER: f32 = 1e-4;

/// Whether a motion takes what hangs on a joint elsewhere than what hangs on its parent.
fn moves_apart(asset: &Asset, joint: JointId) -> bool {
    let Some(parent) = asset.rig.skeleton().parent(joint) else { return false };
    let bounds = asset.rig.bounds();
    let reach = bounds.diagonal() * TOGETHER;
    let [center, half] = [bounds.center(), bounds.size().map(|side| 0.5 * side)].map(glam::Vec3::from);
    let apart = |own: &JointMap, above: &JointMap| {
        let [x, y, z, shift] = [0, 1, 2, 3].map(|k| glam::Vec3::from(own[k]) - glam::Vec3::from(above[k]));
        // At the corner where it is most.
        let middle = x * center.x + y * center.y + z * center.z + shift;
        middle.length() + x.length() * half.x + y.length() * half.y + z.length() * half.z
    };
    let mut frames = asset.clips.iter().flat_map(|clip| clip.maps().chunks(clip.joints().max(1)));
    frames.any(|frame| {
        let by = apart(&frame[joint.index()], &frame[parent.index()]);
        // What goes beyond the greatest numbers is no number, and apart.
        by.is_nan() || by > reach
    })
}

/// Leaves out joints (not the root): their children and weights go to their nearest ancestor that stays.
fn remove(asset: &mut Asset, gone: &[JointId]) -> Result<(), RigError> {
    let rig = &asset.rig;
    let skeleton = rig.skeleton();
    let mut leaves = vec![false; skeleton.len()];
    gone.iter().for_each(|j| leaves[j.index()] = true);
    // Parents come first, so each joint's heir is known when it is asked for.
    let mut heir = vec![JointId(0); skeleton.len()];
    let mut joints = Vec::with_capacity(skeleton.len() - gone.len());
    for joint in skeleton.ids() {
        let parent = skeleton.parent(joint).map(|p| heir[p.index()]);
        heir[joint.index()] = match parent {
            Some(parent) if leaves[joint.index()] => parent,
            _ => {
                let name = skeleton.name(joint).to_owned();
                joints.push(Joint { name, parent, head: skeleton.head(joint) });
                JointId((joints.len() - 1) as u16)
            }
        };
    }
    let weights = rig.weights();
    let weights = if weights.joints().iter().any(|&j| leaves[usize::from(j)]) {
        let row = |v| weights.row(v).map(|(j, w)| (heir[j.index()].0, f64::from(w))).collect::<Vec<_>>();
        SkinWeights::normalized((0..weights.rows()).map(row))?
    } else {
        // The order of joints stays, so rows stay rising.
        let joints = weights.joints().iter().map(|&j| heir[usize::from(j)].0).collect();
        SkinWeights::new(weights.offsets().to_vec(), joints, weights.weights().to_vec())?
    };
    let mut humanoid = Humanoid::default();
    rig.humanoid().iter().for_each(|(bone, joint)| {
        humanoid.insert(bone, heir[joint.index()]);
    });
    let springs: Springs = rig.springs().clone().renumbered(|j| heir[j.index()]);
    let clips = asset.clips.iter().map(|clip| {
        let kept = |frame: &[JointMap]| {
            frame.iter().zip(&leaves).filter(|(_, gone)| !**gone).map(|(map, _)| *map).collect::<Vec<_>>()
        };
        let maps = clip.maps().chunks(clip.joints().max(1)).flat_map(kept).collect();
        Clip::new(clip.name().to_owned(), clip.rate(), joints.len(), maps)
    });
    let clips = clips.collect::<Result<_, _>>()?;
    let rig = Rig::new(Skeleton::new(joints)?, rig.mesh().clone(), weights)?;
    asset.rig = rig.with_humanoid(humanoid)?.with_springs(springs)?;
    asset.clips = clips;
    Ok(())
}

fn count(n: usize, what: &str) -> String {
    // "1 joint without weight was", "2 joints without weight were".
    let (head, tail) = what.split_once(' ').unwrap_or((what, ""));
    if n == 1 { format!("1 {head} {tail} was") } else { format!("{n} {head}s {tail} were") }
}

fn named(rig: &Rig, joints: &[JointId]) -> String {
    let names: Vec<String> = joints.iter().take(3).map(|&j| format!("`{}`", rig.skeleton().name(j))).collect();
    let more = joints.len() - names.len();
    names.join(", ") + &if more > 0 { format!(" and {more} more") } else { String::new() }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Mesh, Provenance};

    use super::*;

    /// Joints by name, parent and height, weights on those named `w…`.
    fn asset(joints: &[(&str, Option<u16>, f32)]) -> Asset {
        let own: Vec<u16> = (0..joints.len() as u16).filter(|&j| joints[usize::from(j)].0.starts_with('w')).collect();
        let joints = joints.iter().map(|&(name, parent, y)| Joint {
            name: name.into(),
            parent: parent.map(JointId),
            head: [0.0, y, 0.0],
        });
        let skeleton = Skeleton::new(joints.collect()).unwrap();
        let rows: Vec<Vec<(u16, f64)>> = (0..4).map(|_| own.iter().map(|&j| (j, 1.0)).collect()).collect();
        let mesh = Mesh::new(
            vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
            vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]],
        )
        .unwrap();
        let rig = Rig::new(skeleton, mesh, SkinWeights::normalized(rows).unwrap()).unwrap();
        Asset { name: "a".into(), rig, clips: vec![], provenance: Provenance::default() }
    }

    fn names(asset: &Asset) -> Vec<&str> {
        asset.rig.skeleton().names().iter().map(String::as_str).collect()
    }

    #[test]
    fn controls_go_ends_and_the_root_stay() {
        let joints = [
            ("root", None, 0.0),
            ("w_hips", Some(0), 1.0),
            ("w_leg", Some(1), 0.5),
            ("leg_end", Some(2), 0.1),
            ("leg_end_end", Some(3), 0.05),
            ("PoleTarget.L", Some(2), 0.2),
            ("foot_ctl", Some(0), 0.3),
            ("toe_ctl", Some(6), 0.2),
        ];
        let mut a = asset(&joints);
        let told = repair(&mut a, &RepairConfig::default()).unwrap();
        assert_eq!(names(&a), ["root", "w_hips", "w_leg", "leg_end", "leg_end_end"]);
        assert_eq!(told, ["3 joints without weight were left out: `PoleTarget.L`, `foot_ctl`, `toe_ctl`"]);
        assert_eq!(a.provenance.notes, told);
        let mut b = asset(&joints);
        repair(&mut b, &RepairConfig { end_bones: true, ..RepairConfig::default() }).unwrap();
        assert_eq!(names(&b), ["root", "w_hips", "w_leg"]);
    }

    #[test]
    fn bones_without_length_give_weights_and_children_to_their_parent() {
        let mut a = asset(&[("w0", None, 0.0), ("w1", Some(0), 0.0), ("w2", Some(1), 1.0)]);
        let told = repair(&mut a, &RepairConfig::default()).unwrap();
        assert_eq!(names(&a), ["w0", "w2"]);
        assert_eq!(a.rig.skeleton().parent(JointId(1)), Some(JointId(0)));
        let row: Vec<_> = a.rig.weights().row(0).map(|(j, w)| (j.0, w)).collect();
        assert!((row[0].1 - 2.0 / 3.0).abs() < 1e-6 && row[1].0 == 1, "{row:?}");
        assert!(told[0].contains("1 joint of a bone without length was folded into its parent: `w1`"));
    }

    #[test]
    fn bones_without_length_stay_where_a_motion_takes_them_from_their_parent() {
        const STILL: JointMap = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
        const UP: JointMap = [STILL[0], STILL[1], STILL[2], [0.0, 3.0, 0.0]];
        let moving = |second: [JointMap; 3]| {
            let mut a = asset(&[("w0", None, 0.0), ("w1", Some(0), 0.0), ("w2", Some(1), 1.0)]);
            let maps = [[STILL; 3], second].concat();
            a.clips = vec![Clip::new("rise".into(), 30.0, 3, maps).unwrap()];
            let told = repair(&mut a, &RepairConfig::default()).unwrap();
            (a, told)
        };
        let (a, told) = moving([STILL, UP, UP]);
        assert_eq!((names(&a), told.len()), (vec!["w0", "w1", "w2"], 0));
        assert!(a.provenance.notes[0].contains("length was left, as motions take it from its parent: `w1`"));
        let (b, told) = moving([UP, UP, STILL]);
        assert_eq!((names(&b), told.len(), b.clips[0].joints()), (vec!["w0", "w2"], 1, 2));
    }

    #[test]
    fn nothing_is_said_of_a_sound_rig() {
        let mut a = asset(&[("w0", None, 0.0), ("w1", Some(0), 0.5), ("end", Some(1), 1.0)]);
        let before = a.clone();
        assert!(repair(&mut a, &RepairConfig::default()).unwrap().is_empty());
        assert_eq!(a, before);
    }
}
