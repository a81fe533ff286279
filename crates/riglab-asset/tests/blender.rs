//! Our reading of rigs against Blender's.
//!
//! `blender.json.xz` holds what Blender's importer reads: bones, counts, sums of weights, and forty
//! vertices a file. Where Blender is wrong or cannot read a file, a reference reading decides; where
//! there is none, joints stand to each other as the file's nodes do, or a warning says that no reading is right.

mod common;

use std::collections::HashMap;
use std::path::Path;

use glam::{DAffine3, DQuat, DVec3};
use riglab_asset::{ImportOptions, Imported, Inspection, Warning, import};
use serde::Deserialize;
use serde_json::Value;

/// Heads and vertices, of the diagonal.
const NEAR: f64 = 1e-4;
const WEIGHT: f64 = 1e-3;

/// One reading. A bone is name, parent or -1, head, node, and 1 for a joint.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Golden {
    bones: Vec<(String, i64, [f64; 3], usize, u8)>,
    vertices: usize,
    triangles: usize,
    weight_totals: HashMap<usize, f64>,
    samples: Vec<GoldenSample>,
    bbox: Option<[[f64; 3]; 2]>,
    error: Option<String>,
}

/// Node, primitive and vertex; position; weights by bone.
type GoldenSample = ([usize; 3], [f64; 3], HashMap<usize, f64>);

struct Readings {
    files: HashMap<String, Value>,
    references: HashMap<String, Value>,
    exceptions: HashMap<String, String>,
}

impl Readings {
    fn load(folder: &Path) -> Self {
        let packed = std::fs::File::open(folder.join("blender/blender.json.xz")).unwrap();
        let unpacked = lzma_rust2::XzReader::new(std::io::BufReader::new(packed), false);
        let mut files: HashMap<String, Value> = serde_json::from_reader(std::io::BufReader::new(unpacked)).unwrap();
        let mut take = |key: &str| files.remove(key).unwrap();
        let exceptions = serde_json::from_value(take("_exceptions")).unwrap();
        let references = serde_json::from_value(take("_reference")).unwrap();
        Self { files, references, exceptions }
    }
}

#[derive(Debug, PartialEq)]
enum Verdict {
    Agrees,
    /// With the reference reading, where Blender is not to be followed.
    AgreesWithReference,
    /// With the file's nodes, which show each skin in its bind pose, in whatever space its mesh is; but for the place of all.
    AgreesWithNodes,
    /// No reading is right; imported with a warning.
    Free,
    NoGolden,
}

#[test]
fn every_rig_is_read_as_blender_or_the_reference_reads_it() {
    let Some(golden) = common::data("RIGLAB_GOLDEN", "golden") else { return };
    let folders =
        [("RIGLAB_RIGS", "rigs"), ("RIGLAB_RIGS_ORIGINAL", "rigs_original"), ("RIGLAB_RIGS_HARD", "rigs_hard")];
    let readings = Readings::load(&golden);
    let mut wrong = Vec::new();
    for (variable, name) in folders {
        let Some(folder) = common::data(variable, name) else { continue };
        let mut counts: HashMap<String, usize> = HashMap::new();
        for path in common::files(&folder, &["glb", "gltf", "vrm"]) {
            let key = format!("{name}/{}", path.file_name().unwrap().to_string_lossy());
            match judge(&readings, &key, &path) {
                Ok(verdict) => *counts.entry(format!("{verdict:?}")).or_default() += 1,
                Err(differences) => wrong.push(format!("{key}: {}", differences.join("; "))),
            }
        }
        println!("{name}: {counts:?}");
    }
    assert!(wrong.is_empty(), "{} files differ:\n{}", wrong.len(), wrong.join("\n"));
}

fn judge(readings: &Readings, key: &str, path: &Path) -> Result<Verdict, Vec<String>> {
    let Some(value) = readings.files.get(key) else { return Ok(Verdict::NoGolden) };
    let parse = |value: &Value| Golden::deserialize(value).unwrap();
    let blender = parse(value);
    let imported = match import(path, &ImportOptions::default()) {
        Ok(imported) => imported,
        Err(error) => return Err(vec![error.to_string()]),
    };
    let found = match &blender.error {
        Some(error) => vec![error.clone()],
        None => differences(&blender, &imported),
    };
    match (found.is_empty(), readings.exceptions.get(key), readings.references.get(key)) {
        (true, _, _) => Ok(Verdict::Agrees),
        (false, Some(_), Some(reference)) => match differences(&parse(reference), &imported) {
            found if found.is_empty() => Ok(Verdict::AgreesWithReference),
            found => Err(found),
        },
        (false, Some(why), None) => {
            let warned =
                imported.warnings().iter().any(|w| matches!(w, Warning::Bent { .. } | Warning::Unweighted { .. }));
            match warned {
                true => Ok(Verdict::Free),
                false if stands_as_shown(path, &imported) => Ok(Verdict::AgreesWithNodes),
                false => Err(vec![format!("no warning, though {why}")]),
            }
        }
        (false, None, _) => Err(found),
    }
}

/// Whether all joints stand to each other as the nodes of a GLB do: told by how far they are from some of them.
fn stands_as_shown(path: &Path, imported: &Imported) -> bool {
    let glb = std::fs::read(path).unwrap();
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    let document: Value = serde_json::from_slice(&glb[20..20 + length]).unwrap();
    let nodes = document["nodes"].as_array().unwrap();
    let children = |node: usize| nodes[node]["children"].as_array().into_iter().flatten();
    let mut parents = vec![None; nodes.len()];
    (0..nodes.len()).for_each(|node| children(node).for_each(|c| parents[c.as_u64().unwrap() as usize] = Some(node)));
    let local = |node: &Value| {
        assert!(node["matrix"].is_null());
        let part = |name: &str, k: usize, usual: f64| node[name][k].as_f64().unwrap_or(usual);
        DAffine3::from_scale_rotation_translation(
            DVec3::from_array(std::array::from_fn(|k| part("scale", k, 1.0))),
            DQuat::from_array(std::array::from_fn(|k| part("rotation", k, [0.0, 0.0, 0.0, 1.0][k]))),
            DVec3::from_array(std::array::from_fn(|k| part("translation", k, 0.0))),
        )
    };
    let size = f64::from(imported.rig().unwrap().bounds().diagonal());
    let places: Vec<([f64; 3], [f64; 3])> = imported
        .reading
        .joints
        .iter()
        .map(|joint| {
            let up = std::iter::successors(Some(joint.node), |&node| parents[node]);
            let shown = up.fold(DVec3::ZERO, |at, node| local(&nodes[node]).transform_point3(at));
            (shown.to_array(), joint.head.map(f64::from))
        })
        .collect();
    let apart = |a: usize, b: usize| distance(places[a].0, places[b].0) - distance(places[a].1, places[b].1);
    let count = places.len();
    (0..count).all(|a| [0, count / 3, count / 2, count - 1].iter().all(|&b| apart(a, b).abs() <= NEAR * size))
}

/// In what our reading differs from another.
fn differences(golden: &Golden, imported: &Imported) -> Vec<String> {
    let mut found = Vec::new();
    let ours: Inspection<'_> = imported.inspect(false);
    let diagonal = golden.bbox.map_or(1.0, |[low, high]| distance(low, high));
    let joints: Vec<usize> = (0..golden.bones.len()).filter(|&b| golden.bones[b].4 == 1).collect();
    let by_node: HashMap<usize, usize> = joints.iter().map(|&b| (golden.bones[b].3, b)).collect();
    if joints.len() != ours.joints.len() {
        found.push(format!("{} joints, not {}", ours.joints.len(), joints.len()));
        return found;
    }
    // Bones that are no joints are skipped on the way up.
    let above = |mut bone: usize| loop {
        let parent = usize::try_from(golden.bones[bone].1).ok()?;
        if golden.bones[parent].4 == 1 {
            return Some(parent);
        }
        bone = parent;
    };
    for joint in &ours.joints {
        let Some(&bone) = by_node.get(&joint.node) else {
            found.push(format!("node {} is no joint there", joint.node));
            continue;
        };
        let off = distance(joint.head.map(f64::from), golden.bones[bone].2) / diagonal;
        if off.is_nan() || off > NEAR {
            found.push(format!("head of {} off by {off:.2e}", joint.name));
        }
        if joint.parent.map(|p| ours.joints[p].node) != above(bone).map(|b| golden.bones[b].3) {
            found.push(format!("parent of {}", joint.name));
        }
    }
    // A file without skeleton has no counts of skinned vertices there.
    if !ours.joints.is_empty() && (ours.vertices, ours.triangles) != (golden.vertices, golden.triangles) {
        let (ours, theirs) = ((ours.vertices, ours.triangles), (golden.vertices, golden.triangles));
        found.push(format!("vertices and triangles {ours:?}, not {theirs:?}"));
    }
    let bone_of: HashMap<&str, usize> =
        ours.joints.iter().filter_map(|j| Some((j.name, *by_node.get(&j.node)?))).collect();
    let totals: HashMap<usize, f64> = ours.weight_totals.iter().map(|(name, total)| (bone_of[name], *total)).collect();
    for bone in joints {
        let (a, b) = (value(&totals, bone), value(&golden.weight_totals, bone));
        if (a - b).abs() > WEIGHT * b.max(1.0) {
            found.push(format!("weight total of {} is {a}, not {b}", golden.bones[bone].0));
        }
    }
    let samples: HashMap<[usize; 3], _> =
        ours.samples.iter().map(|s| ([s.node, s.primitive, s.vertex as usize], s)).collect();
    for (at, position, weights) in &golden.samples {
        let Some(sample) = samples.get(at) else {
            found.push(format!("vertex {at:?} is not among our samples"));
            continue;
        };
        let off = distance(sample.position.map(f64::from), *position) / diagonal;
        if off.is_nan() || off > NEAR {
            found.push(format!("vertex {at:?} off by {off:.2e}"));
        }
        let ours: HashMap<usize, f64> = sample.weights.iter().map(|(n, w)| (bone_of[n], f64::from(*w))).collect();
        if ours.keys().chain(weights.keys()).any(|&b| (value(&ours, b) - value(weights, b)).abs() > WEIGHT) {
            found.push(format!("weights of vertex {at:?}"));
        }
    }
    found
}

fn value(of: &HashMap<usize, f64>, bone: usize) -> f64 {
    of.get(&bone).copied().unwrap_or(0.0)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}
