//! Human bones by structure against those that rigs name.

mod common;

use std::collections::BTreeMap;

use riglab_asset::rigging::humanoid;
use riglab_asset::{ImportOptions, import};
use riglab_core::{Bounds, HumanBone, JointId, Rig};

/// The human bones that a rig says it has: by VRM, else by the names of Mixamo.
fn told(rig: &Rig) -> BTreeMap<HumanBone, JointId> {
    if !rig.humanoid().is_empty() {
        return rig.humanoid().iter().collect();
    }
    let skeleton = rig.skeleton();
    let by_name = skeleton.ids().filter_map(|joint| {
        let name = skeleton.name(joint);
        let (prefix, own) = name.rsplit_once(':')?;
        prefix.starts_with("mixamorig").then_some(())?;
        Some((bone(own)?.parse().ok()?, joint))
    });
    by_name.collect()
}

/// A name of Mixamo's as one of VRM's.
fn bone(own: &str) -> Option<String> {
    let (side, rest) = match (own.strip_prefix("Left"), own.strip_prefix("Right")) {
        (Some(rest), _) => ("left", rest),
        (_, Some(rest)) => ("right", rest),
        _ => ("", own),
    };
    let known = match rest {
        "Hips" => "hips",
        "Spine" => "spine",
        "Spine1" => "chest",
        "Spine2" => "upperChest",
        "Neck" => "neck",
        "Head" => "head",
        "UpLeg" => "UpperLeg",
        "Leg" => "LowerLeg",
        "Foot" => "Foot",
        "ToeBase" => "Toes",
        "Shoulder" => "Shoulder",
        "Arm" => "UpperArm",
        "ForeArm" => "LowerArm",
        "Hand" => "Hand",
        _ => {
            let finger = rest.strip_prefix("Hand")?;
            let (finger, number) = finger.split_at(finger.len().checked_sub(1)?);
            let finger = if finger == "Pinky" { "Little" } else { finger };
            let parts = if finger == "Thumb" {
                ["Metacarpal", "Proximal", "Distal"]
            } else {
                ["Proximal", "Intermediate", "Distal"]
            };
            let part = parts.get(number.parse::<usize>().ok()?.checked_sub(1)?)?;
            return Some(format!("{side}{finger}{part}"));
        }
    };
    Some(format!("{side}{known}"))
}

#[test]
fn human_bones_by_structure_are_those_that_rigs_name() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    // Fingers and the rest of the body apart: right, wrong, missed.
    let mut counts: BTreeMap<bool, [usize; 3]> = BTreeMap::new();
    let (mut bodies, mut found_bodies, mut wrong_bodies) = (0, 0, Vec::new());
    for path in common::files(&folder, &["glb", "vrm"]) {
        let Ok(imported) = import(&path, &ImportOptions::default()) else { continue };
        let Some(rig) = imported.rig() else { continue };
        let told = told(rig);
        let required: Vec<HumanBone> = HumanBone::all().filter(|b| b.is_required()).collect();
        if required.iter().any(|b| !told.contains_key(b)) {
            continue;
        }
        bodies += 1;
        let mesh = Bounds::of(rig.mesh().positions().iter().copied());
        let found = humanoid(rig.skeleton(), mesh).unwrap_or_default();
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let mut wrong = Vec::new();
        for bone in HumanBone::all() {
            let is_finger = ["Thumb", "Index", "Middle", "Ring", "Little"].iter().any(|f| bone.name().contains(f));
            let count = counts.entry(is_finger).or_default();
            match (told.get(&bone).copied(), found.joint(bone)) {
                (Some(a), Some(b)) if a == b => count[0] += 1,
                (Some(a), Some(b)) => {
                    count[1] += 1;
                    let name = |joint| rig.skeleton().name(joint);
                    wrong.push(format!("{bone}: {} is {}", name(b), name(a)));
                }
                (Some(_), None) => {
                    count[2] += 1;
                    if !is_finger {
                        wrong.push(format!("no {bone}"));
                    }
                }
                (None, _) => {}
            }
        }
        found_bodies += usize::from(found.is_complete());
        let essential = |b: HumanBone| found.joint(b) != told.get(&b).copied();
        wrong_bodies.extend(required.iter().copied().any(essential).then(|| name.clone()));
        if !wrong.is_empty() {
            println!("{name}: {}", wrong.join(", "));
        }
    }
    let share = |of: &[usize; 3]| of[0] as f64 / of.iter().sum::<usize>().max(1) as f64;
    println!("{bodies} bodies, {found_bodies} found whole, with a wrong bone that VRM asks for: {wrong_bodies:?}");
    for (fingers, count) in &counts {
        println!("fingers {fingers}: right, wrong, missed {count:?}, {:.3}", share(count));
    }
    // Those that sit or lie are no upright bodies.
    assert!(bodies > 30 && 5 * found_bodies >= 4 * bodies, "{found_bodies} of {bodies}");
    let [body, fingers] = [counts[&false], counts[&true]];
    assert!(100 * body[1] <= body[0], "{body:?}");
    assert!(50 * fingers[1] <= fingers[0] && share(&fingers) > 0.7, "{fingers:?}");
}

#[test]
fn animals_and_machines_are_no_humanoids() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let manifest = std::fs::read_to_string(folder.join("manifest.json")).unwrap();
    let manifest: Vec<serde_json::Value> = serde_json::from_str(&manifest).unwrap();
    let mut taken: BTreeMap<String, (usize, Vec<String>)> = BTreeMap::new();
    for entry in &manifest {
        let [file, category] = ["file", "category"].map(|key| entry[key].as_str().unwrap());
        let Ok(imported) = import(folder.join(file), &ImportOptions::default()) else { continue };
        let Some(rig) = imported.rig() else { continue };
        let mesh = Bounds::of(rig.mesh().positions().iter().copied());
        let of = taken.entry(category.into()).or_default();
        of.0 += 1;
        of.1.extend(humanoid(rig.skeleton(), mesh).map(|_| file.to_owned()));
    }
    for (category, (all, found)) in &taken {
        println!("{category}: {} of {all}", found.len());
        if !matches!(category.as_str(), "humanoid" | "anime_vrm") {
            println!("  {found:?}");
        }
    }
    for category in ["quadruped", "aquatic", "arthropod"] {
        let (all, found) = &taken[category];
        assert!(20 * found.len() <= *all, "{category}: {found:?}");
    }
}
