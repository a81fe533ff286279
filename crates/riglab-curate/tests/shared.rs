//! Curation of the shared rigs, and of odd and broken files.

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use common::{copy, dropped, folder, plain, run};
use riglab_asset::{ImportOptions, import};
use riglab_core::Asset;
use riglab_curate::{Category, Funnel, Places, Shape, TOLERANCE, by_rules, pairs, repair};
use serde_json::Value;

fn manifest(folder: &Path) -> Vec<Value> {
    serde_json::from_str(&std::fs::read_to_string(folder.join("manifest.json")).unwrap()).unwrap()
}

fn read(folder: &Path, file: &str) -> Asset {
    let mut asset = import(folder.join(file), &ImportOptions::default()).unwrap().into_asset().unwrap();
    repair(&mut asset, &Default::default()).unwrap();
    asset.name = file.into();
    asset
}

#[test]
fn each_hard_file_goes_as_its_manifest_says() {
    let Some(folder) = folder("RIGLAB_RIGS_HARD", "rigs_hard") else { return };
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.stages.retain(|s| s.name() != "duplicates");
    let funnel = run(&folder, out.path(), &config).unwrap();
    let refused: BTreeMap<&str, &str> =
        funnel.stage("read").unwrap().dropped.iter().map(|(name, why)| (name.as_str(), why.as_str())).collect();
    let mut looked_at = 0;
    for entry in manifest(&folder) {
        let file = entry["file"].as_str().unwrap();
        // What is a mesh without a rig is good for inference, and nothing to learn from.
        let rig = entry["joints"] != 0;
        if entry["optional"] == true || (!rig && file.ends_with(".obj")) {
            continue;
        }
        looked_at += 1;
        let why = refused.get(file);
        match entry["expect"].as_str().unwrap() {
            "reject" => {
                let why = why.unwrap_or_else(|| panic!("{file} was kept")).to_lowercase();
                let words = entry["reason_contains"].as_str().unwrap_or("");
                assert!(words.split('|').any(|w| why.contains(&w.to_lowercase())), "{file}: {why} / {words}");
            }
            _ if !rig => assert!(why.is_some_and(|w| w.contains("skin")), "{file}: {why:?}"),
            _ => assert_eq!(why, None, "{file}"),
        }
    }
    assert!(looked_at > 50);
    assert_eq!(funnel.kept + refused.len(), funnel.assets);
}

#[test]
fn copies_of_hard_and_of_real_rigs_are_found_and_nothing_else_is() {
    let (Some(rigs), Some(hard)) = (folder("RIGLAB_RIGS", "rigs"), folder("RIGLAB_RIGS_HARD", "rigs_hard")) else {
        return;
    };
    let files: Vec<String> = manifest(&rigs).iter().map(|e| e["file"].as_str().unwrap().to_owned()).collect();
    let mut shapes: Vec<(String, Shape)> = Vec::new();
    let mut truth = BTreeSet::new();
    for file in &files {
        let asset = read(&rigs, file);
        let name = format!("copy of {file}");
        shapes.push((file.clone(), Shape::of(&asset.rig)));
        shapes.push((name.clone(), Shape::of(&copy(&asset, &name).rig)));
        truth.insert((file.clone(), name));
    }
    for entry in manifest(&hard).iter().filter(|e| e["same_as"].is_string() && e["expect"] != "reject") {
        let (file, same) = (entry["file"].as_str().unwrap(), entry["same_as"].as_str().unwrap());
        for name in [file, same] {
            if !shapes.iter().any(|(n, _)| n == name) {
                shapes.push((name.into(), Shape::of(&read(&hard, name).rig)));
            }
        }
        truth.insert((same.to_owned(), file.to_owned()));
    }
    let all: Vec<Shape> = shapes.iter().map(|(_, s)| s.clone()).collect();
    let found: BTreeSet<(usize, usize)> = pairs(&all, TOLERANCE).into_iter().collect();
    let number = |name: &str| shapes.iter().position(|(n, _)| n == name).unwrap();
    for (a, b) in &truth {
        let (a, b) = (number(a), number(b));
        assert!(found.contains(&(a.min(b), a.max(b))), "{} and {} were not found", shapes[a].0, shapes[b].0);
    }
    // These two are one model in two files; all other pairs of the rigs differ.
    let known = ["dcl_antrom_skeletonpvp_1.glb", "dcl_antrom_skeletonpvp_old.glb"];
    let original = |name: &str| name.strip_prefix("copy of ").unwrap_or(name).to_owned();
    for (a, b) in found {
        let (a, b) = (original(&shapes[a].0), original(&shapes[b].0));
        let of_rigs = files.contains(&a) && files.contains(&b);
        let wanted = a == b || (known.contains(&a.as_str()) && known.contains(&b.as_str()));
        assert!(!of_rigs || wanted, "{a} and {b} were taken for one");
        assert_eq!(files.contains(&a), files.contains(&b), "{a} and {b} were taken for one");
    }
}

#[test]
fn a_left_hand_is_no_right_hand() {
    let Some(rigs) = folder("RIGLAB_RIGS", "rigs") else { return };
    for file in
        ["aframe_lefthand.glb", "aframe_lefthandlow.glb", "webxr_hand_left.glb", "dcl_cemetery_npc_cat_lover.glb"]
    {
        let left = read(&rigs, file);
        let mirrored = common::mirrored(&left);
        let apart = Shape::of(&left.rig).distance(&Shape::of(&mirrored.rig));
        assert!(apart > TOLERANCE, "{file}: {apart}");
        // Mirrored twice and turned it is itself.
        let twice = copy(&common::mirrored(&mirrored), "twice");
        assert!(Shape::of(&left.rig).distance(&Shape::of(&twice.rig)) < 0.1 * TOLERANCE, "{file}");
    }
}

#[test]
fn rules_agree_with_the_manifest_on_both_halves() {
    let Some(rigs) = folder("RIGLAB_RIGS", "rigs") else { return };
    let mut halves = [[0usize; 2]; 2];
    for entry in manifest(&rigs) {
        let asset = read(&rigs, entry["file"].as_str().unwrap());
        let stated: Category = entry["category"].as_str().unwrap().parse().unwrap();
        // Half of the trees of joints, and the other.
        let half = usize::from_str_radix(&entry["topology_hash"].as_str().unwrap()[..1], 16).unwrap() % 2;
        halves[half][usize::from(by_rules(&asset.rig, true).category == stated)] += 1;
    }
    for [wrong, right] in halves {
        eprintln!("{right} of {}", right + wrong);
        assert!(right as f64 >= 0.85 * (right + wrong) as f64, "{right} of {}", right + wrong);
    }
}

#[test]
fn the_whole_of_the_rigs_is_curated_with_a_confusion_table() {
    let Some(rigs) = folder("RIGLAB_RIGS", "rigs") else { return };
    let out = tempfile::tempdir().unwrap();
    let funnel: Funnel = run(&rigs, out.path(), &plain()).unwrap();
    assert_eq!((funnel.assets, funnel.agreement.of), (311, 311));
    assert!(funnel.agreement.same >= 265);
    assert_eq!(dropped(&funnel, "duplicates").len(), 1);
    let page = std::fs::read_to_string(Places::of(&out.path().join("corpus.h5")).report()).unwrap();
    assert!(page.contains("stated by the source"));
}
