//! The peers' formats against golden samples: every array as other readers have it, every refusal in a
//! sentence.

mod common;

use std::collections::{BTreeMap, BTreeSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};

use riglab_asset::{
    ArrayRig, ImportError, ImportOptions, Imported, export, import, import_bytes, import_each, read_arrays,
};
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;

const TOLERANCE: f32 = 1e-6;

/// All files below a folder, sorted.
fn below(folder: &Path) -> Vec<PathBuf> {
    let (mut files, mut open) = (Vec::new(), vec![folder.to_path_buf()]);
    while let Some(dir) = open.pop() {
        for entry in std::fs::read_dir(&dir).unwrap().map(|e| e.unwrap().path()) {
            if entry.is_dir() { open.push(entry) } else { files.push(entry) }
        }
    }
    files.sort();
    files
}

fn name(path: &Path) -> String {
    path.file_name().unwrap().to_string_lossy().into_owned()
}

fn ends_with(path: &Path, endings: &[&str]) -> bool {
    path.extension().is_some_and(|e| endings.iter().any(|ending| e == *ending))
}

/// Whether a file, by its own name or its folder's, is to be refused.
fn is_refused(root: &Path, path: &Path) -> bool {
    path.strip_prefix(root).unwrap().to_string_lossy().contains("refuse")
}

/// The files that hold assets, those of a kind that no test knows being a fault. OBJs belong to texts.
fn asset_files(root: &Path) -> Vec<PathBuf> {
    let files: Vec<PathBuf> = below(root).into_iter().filter(|path| !is_refused(root, path)).collect();
    for path in &files {
        let known = ["npz", "h5", "pt", "txt", "obj", "json", "safetensors", "md"];
        assert!(ends_with(path, &known), "{}: of no known kind", path.display());
    }
    let lists: Vec<String> = lists(root).into_iter().map(|(path, _)| name(&path)).collect();
    let holds = |path: &PathBuf| ends_with(path, &["npz", "h5", "pt", "txt"]) && !lists.contains(&name(path));
    files.into_iter().filter(holds).collect()
}

/// What is expected of files, by the path of the expectation.
fn expectations(root: &Path) -> Vec<(PathBuf, Value)> {
    let files = below(root).into_iter().filter(|path| name(path).ends_with("expected.json"));
    files.map(|path| (path.clone(), serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap())).collect()
}

/// Lists of folders, with the folders.
fn lists(root: &Path) -> Vec<(PathBuf, Vec<String>)> {
    let told = expectations(root).into_iter().filter(|(_, notes)| notes["entries"].is_array());
    told.map(|(path, notes)| (path.with_file_name(&strings(&notes["files"])[0]), strings(&notes["entries"]))).collect()
}

/// The folders that are formats.
fn formats(root: &Path) -> BTreeSet<String> {
    let entries = std::fs::read_dir(root).unwrap().map(|e| e.unwrap().path());
    entries.filter(|path| path.is_dir()).map(|path| name(&path)).collect()
}

/// The format of a file: its folder below the root.
fn format_of(root: &Path, path: &Path) -> String {
    name(Path::new(path.strip_prefix(root).unwrap().iter().next().unwrap()))
}

/// The arrays of an asset under the names the expectations have.
fn arrays(rig: &ArrayRig) -> BTreeMap<String, (Vec<usize>, Vec<f32>)> {
    let rows = |points: &[[f32; 3]]| (vec![points.len(), 3], points.as_flattened().to_vec());
    let mut out = BTreeMap::from([
        ("vertices".to_owned(), rows(&rig.vertices)),
        ("joints".to_owned(), rows(&rig.joints)),
        ("tails".to_owned(), rows(&rig.tails)),
        ("bone_heads".to_owned(), rows(&rig.joints)),
        ("bone_tails".to_owned(), rows(&rig.tails)),
    ]);
    let faces = rig.faces.as_flattened().iter().map(|v| *v as f32).collect();
    out.insert("faces".into(), (vec![rig.faces.len(), 3], faces));
    let parents: Vec<f32> = rig.parents.iter().map(|p| p.map_or(-1.0, |p| p as f32)).collect();
    out.insert("parents".into(), (vec![parents.len()], parents.clone()));
    out.insert("bone_parents".into(), (vec![parents.len()], parents));
    if let Some(weights) = &rig.weights {
        let joints = rig.joints.len();
        let mut dense = vec![0.0; weights.rows() * joints];
        for vertex in 0..weights.rows() {
            for (joint, weight) in weights.row(vertex) {
                dense[vertex * joints + *joint as usize] += weight;
            }
        }
        out.insert("weights".into(), (vec![weights.rows(), joints], dense));
    }
    // Extra arrays of the file go last: Anymate has joints of its own beside its bones.
    out.extend(rig.extras.iter().map(|(name, array)| (name.clone(), (array.shape.clone(), array.data.clone()))));
    out
}

fn floats(tensor: &safetensors::tensor::TensorView<'_>) -> Vec<f32> {
    match tensor.dtype() {
        Dtype::F32 => tensor.data().as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect(),
        Dtype::I64 => tensor.data().as_chunks().0.iter().map(|b| i64::from_le_bytes(*b) as f32).collect(),
        other => panic!("{other:?}"),
    }
}

fn strings(value: &Value) -> Vec<String> {
    value.as_array().unwrap().iter().map(|v| v.as_str().unwrap().to_owned()).collect()
}

/// Compares an asset with the expectations that start with `prefix`.
fn compare(what: &str, rig: &ArrayRig, expected: &SafeTensors<'_>, prefix: &str) -> usize {
    let arrays = arrays(rig);
    let mut compared = 0;
    for (key, tensor) in expected.iter() {
        let Some(key) = key.strip_prefix(prefix) else { continue };
        let (shape, found) = arrays.get(key).unwrap_or_else(|| panic!("{what}: nothing read as {key}"));
        let wanted = floats(&tensor);
        // Points of which the expectations hold the first only.
        let cut = ["points", "point_weights"].contains(&key);
        assert!(shape[..] == *tensor.shape() || cut && shape[1..] == tensor.shape()[1..], "{what}: {key} {shape:?}");
        let exact = tensor.dtype() == Dtype::I64;
        for (at, (found, wanted)) in found.iter().zip(&wanted).enumerate() {
            let near = if exact { found == wanted } else { (found - wanted).abs() <= TOLERANCE };
            assert!(near, "{what}: {key}[{at}] is {found}, not {wanted}");
        }
        assert!(found.len() >= wanted.len(), "{what}: {key}");
        compared += 1;
    }
    compared
}

/// Which file of the list is to be opened for the whole: a rig text rather than its OBJ.
fn opened(folder: &Path, files: &[String]) -> PathBuf {
    let text = files.iter().find(|f| f.ends_with(".txt")).unwrap_or(&files[0]);
    folder.join(text)
}

#[test]
fn every_sample_is_read_as_expected() {
    let Some(root) = common::data("RIGLAB_GOLDEN", "golden") else { return };
    let root = root.join("formats");
    let (mut assets, mut seen) = (0, BTreeSet::new());
    let told = expectations(&root).into_iter();
    let told: Vec<(PathBuf, Value)> = told
        .filter(|(path, notes)| !is_refused(&root, path) && !notes["entries"].is_array())
        .map(|(json, notes)| (json.with_extension("safetensors"), notes))
        .collect();
    for path in below(&root).into_iter().filter(|path| ends_with(path, &["safetensors"])) {
        assert!(told.iter().any(|(of, _)| *of == path), "{}: without its JSON", path.display());
    }
    for (path, notes) in &told {
        let folder = path.parent().unwrap();
        let bytes = std::fs::read(path).ok();
        let expected = bytes.as_ref().map(|bytes| SafeTensors::deserialize(bytes).unwrap());
        if expected.is_none() {
            println!("{}: told of without its arrays", path.display());
        }
        let files = strings(&notes["files"]);
        let file = opened(folder, &files);
        let what = file.display().to_string();
        let read: Vec<ArrayRig> = read_arrays(&file).unwrap().into_iter().map(|rig| rig.unwrap()).collect();
        assert_eq!(read.len() as u64, notes["count"].as_u64().unwrap_or(1), "{what}");
        for (item, rig) in read.iter().enumerate() {
            if let Some(expected) = &expected {
                let prefixes = [format!("item_{item}."), format!("sample_{item}."), String::new()];
                let is_there = |p: &&String| expected.names().iter().any(|n| n.starts_with(p.as_str()));
                let compared =
                    compare(&format!("{what}#{item}"), rig, expected, prefixes.iter().find(is_there).unwrap());
                assert!(compared > 0, "{what}: no arrays");
            }
            let names = &notes["names"];
            let names = if names[0].is_array() { &names[item] } else { names };
            if names.is_array() {
                assert_eq!(rig.names, strings(names), "{what}#{item}");
            }
            for key in ["uuid", "file_name", "name"] {
                if let Some(wanted) = notes[key][item].as_str() {
                    assert_eq!(rig.name, wanted, "{what}");
                }
            }
            assert_eq!(rig.up == riglab_asset::Up::Z, is_z_up(path), "{what}");
            assets += 1;
        }
        // A pair is found from either half.
        if let [obj, _] = &files[..] {
            let other = read_arrays(folder.join(obj)).unwrap().remove(0).unwrap();
            assert_eq!(other, read[0], "{what}");
        }
        if expected.is_some() {
            seen.insert(format_of(&root, path));
        }
    }
    println!("{} samples, {assets} assets", told.len());
    assert_eq!(seen, formats(&root), "formats with a sample");
}

fn is_z_up(path: &Path) -> bool {
    ["unirig", "skintokens"].contains(&name(path.parent().unwrap()).as_str())
}

/// Positions, names, parents and weights of the rig are those of the arrays, under the new numbers.
#[test]
fn rigs_are_those_of_the_arrays() {
    let Some(root) = common::data("RIGLAB_GOLDEN", "golden") else { return };
    let root = root.join("formats");
    let (mut rigs, mut whole, mut seen) = (0, 0, BTreeSet::new());
    for path in asset_files(&root) {
        let arrays: Vec<ArrayRig> = read_arrays(&path).unwrap().into_iter().map(Result::unwrap).collect();
        assert!(!arrays.is_empty(), "{}: nothing in it", path.display());
        let is_whole = |rig: &&ArrayRig| !rig.faces.is_empty() && rig.weights.is_some() && !rig.joints.is_empty();
        whole += arrays.iter().filter(is_whole).count();
        let mut item = 0;
        import_each(&path, &ImportOptions::default(), |imported| {
            let array = &arrays[item];
            item += 1;
            let imported = match imported {
                Ok(imported) => imported,
                Err(e) => {
                    let whole = !array.faces.is_empty() && array.weights.is_some();
                    assert!(!whole, "{e}");
                    assert!(e.to_string().contains("skeleton") || e.to_string().contains("no faces"), "{e}");
                    return ControlFlow::Continue(());
                }
            };
            assert_eq!(imported.mesh().positions().len(), array.vertices.len());
            let turned: Vec<_> = array.vertices.iter().map(|p| array.up.to_y(*p)).collect();
            assert_eq!(imported.mesh().positions(), turned);
            let Some(rig) = imported.rig() else {
                assert!(array.joints.is_empty());
                return ControlFlow::Continue(());
            };
            let joints = &imported.reading.joints;
            assert_eq!(joints.len(), array.joints.len());
            for (number, joint) in joints.iter().enumerate() {
                assert_eq!(rig.skeleton().heads()[number], array.up.to_y(array.joints[joint.node]));
                assert_eq!(joint.parent.map(|p| joints[p].node), array.parents[joint.node]);
            }
            let mut names = vec![""; joints.len()];
            joints.iter().for_each(|joint| names[joint.node] = &joint.name);
            for (joint, stored) in array.names.iter().enumerate() {
                assert!(is_named_so(stored, &names, joint), "{}: {} of {stored}", path.display(), names[joint]);
            }
            assert_eq!(names.iter().collect::<BTreeSet<_>>().len(), names.len(), "{}", path.display());
            let rows = array.weights.as_ref().unwrap();
            for vertex in 0..rows.rows() {
                let mut wanted = vec![0.0f64; joints.len()];
                for (joint, weight) in rows.row(vertex) {
                    wanted[*joint as usize] += f64::from(*weight);
                }
                let sum: f64 = wanted.iter().sum();
                for (joint, weight) in rig.weights().row(vertex).filter(|_| sum > 0.0) {
                    let wanted = wanted[joints[joint.index()].node] / sum;
                    assert!((f64::from(weight) - wanted).abs() < 1e-6, "{}: vertex {vertex}", path.display());
                }
            }
            rigs += 1;
            seen.insert(format_of(&root, &path));
            ControlFlow::Continue(())
        });
        assert_eq!(item, arrays.len(), "{}", path.display());
    }
    println!("{rigs} rigs");
    assert_eq!(rigs, whole, "rigs of those that have all of one");
    assert_eq!(seen, formats(&root), "formats with a rig");
}

/// Whether a joint has the name that the file has for it; where that is empty or an earlier joint has it, another one
/// is made of it.
fn is_named_so(stored: &str, names: &[&str], joint: usize) -> bool {
    let name = names[joint];
    if stored.is_empty() {
        return name == format!("joint_{joint}");
    }
    if !names[..joint].contains(&stored) {
        return name == stored;
    }
    let number = name.strip_prefix(stored).and_then(|rest| rest.strip_prefix('.'));
    number.is_some_and(|digits| digits.len() >= 3 && digits.bytes().all(|b| b.is_ascii_digit()))
}

/// The last of what a file gives.
fn last(path: &Path) -> Result<Imported, ImportError> {
    let mut found = None;
    import_each(path, &ImportOptions::default(), |imported| {
        found = Some(imported);
        ControlFlow::Continue(())
    });
    found.unwrap()
}

/// The words of a refusal that its expectation names.
fn refusal(path: &Path) -> ImportError {
    match last(path) {
        Ok(_) => panic!("{} was read", path.display()),
        Err(e) => e,
    }
}

/// Whether an order of joints that the expectations allow to be mended was: the same tree, parents first.
fn is_ordered_anew(path: &Path) -> bool {
    if !reason(path).is_some_and(|reason| reason.contains("may re-order")) {
        return false;
    }
    let Ok(imported) = last(path) else { return false };
    let array = read_arrays(path).unwrap().remove(0).unwrap();
    let joints = &imported.reading.joints;
    assert_eq!(joints.len(), array.joints.len());
    for (number, joint) in joints.iter().enumerate() {
        assert!(joint.parent.is_none_or(|parent| parent < number), "{}: {}", path.display(), joint.name);
        assert_eq!(joint.parent.map(|p| joints[p].node), array.parents[joint.node]);
    }
    true
}

#[test]
fn hostile_and_broken_samples_are_refused_in_a_sentence() {
    let Some(root) = common::data("RIGLAB_GOLDEN", "golden") else { return };
    let root = root.join("formats");
    let words = [
        ("dup_joint_rig.txt", "duplicate joint name `a`"),
        ("no_root_rig.txt", "no line names the root"),
        ("cycle_rig.txt", "joint `b` is not reachable"),
        ("two_parents_rig.txt", "joint `c` has two parents"),
        ("unknown_joint_rig.txt", "unknown joint `z`"),
        ("unknown_hier_rig.txt", "unknown joint `z`"),
        ("odd_tokens_rig.txt", "the weight after `a` is missing"),
        ("bad_number_rig.txt", "`zero` is not a number"),
        ("nan_rig.txt", "`nan` is not finite"),
        ("negative_weight_rig.txt", "negative weight `-0.2`"),
        // The joint is put below one of its own children.
        ("parent_after_child.npz", "joint `spine` is not reachable from a root: it lies in a cycle"),
        ("refuse_call.npz", "`builtins.print`"),
        ("refuse_call.pt", "`builtins.print`"),
        ("refuse_index.npz", "face 0 names vertex 9, which is out of range: there are 3"),
        ("refuse_truncated.npz", "zip archive"),
        ("refuse_legacy.pt", "save it again"),
        ("refuse_nan.pt", "not finite"),
        ("vertex_out_of_range_rig.txt", "vertex 99 is out of range, the OBJ has 5 vertices"),
    ];
    let (mut files, mut worded) = (0, 0);
    let dir = tempfile::tempdir().unwrap();
    for path in below(&root).into_iter().filter(|path| is_refused(&root, path) && !ends_with(path, &["json"])) {
        files += 1;
        let file = name(&path);
        // Where the expectation names a mesh, the fault shows beside it.
        let path = match mesh_for(&path) {
            None => path,
            Some(mesh) => {
                std::fs::copy(mesh, dir.path().join(file.replace("_rig.txt", ".obj"))).unwrap();
                std::fs::copy(&path, dir.path().join(&file)).unwrap();
                dir.path().join(&file)
            }
        };
        if !is_ordered_anew(&path) {
            let text = refusal(&path).to_string();
            assert!(text.contains(&file) && !text.contains('\n') && text.len() < 1000, "{text}");
            if let Some((_, wanted)) = words.iter().find(|(known, _)| *known == file) {
                assert!(text.contains(wanted), "{text} / {wanted}");
                worded += 1;
            }
        }
    }
    assert!(files > 0 && worded > 0, "of {files} files {worded} are known");
}

/// What the expectations of a folder, or those beside it, say of a file that is to be refused.
fn reason(path: &Path) -> Option<String> {
    let folder = path.parent().unwrap();
    let beside =
        [folder.join("expected.json"), folder.join("refuse.expected.json"), folder.with_extension("expected.json")];
    beside.iter().find_map(|notes| {
        let notes: Value = serde_json::from_slice(&std::fs::read(notes).ok()?).unwrap();
        let named = [name(path), format!("refuse/{}", name(path))];
        Some(named.iter().find_map(|name| notes[name].as_str())?.to_owned())
    })
}

/// The mesh that the reason names: "vertex 99, but the OBJ has 5 vertices (odd.obj)".
fn mesh_for(path: &Path) -> Option<PathBuf> {
    let reason = reason(path)?;
    let mesh = reason.split(|c: char| c.is_whitespace() || "()".contains(c)).find(|word| word.ends_with(".obj"))?;
    let folders = path.ancestors().skip(1).take(2);
    folders.map(|folder| folder.join(mesh)).find(|mesh| mesh.exists())
}

#[test]
fn lists_of_folders_give_an_asset_each() {
    let Some(root) = common::data("RIGLAB_GOLDEN", "golden") else { return };
    let lists = lists(&root.join("formats"));
    assert!(!lists.is_empty(), "no list of folders");
    for (list, entries) in lists {
        let mut seen = Vec::new();
        import_each(&list, &ImportOptions::default(), |asset| {
            seen.push(asset.map(|a| a.name).map_err(|e| e.to_string()));
            ControlFlow::Continue(())
        });
        assert_eq!(seen.len(), entries.len(), "{seen:?}");
        for (entry, seen) in entries.iter().zip(seen) {
            if list.with_file_name(entry).join("raw_data.npz").exists() {
                assert_eq!(seen.as_deref().map(|name| name.ends_with(entry.as_str())), Ok(true), "{entry}: {seen:?}");
            } else {
                assert!(seen.as_ref().unwrap_err().contains(&format!("`{entry}` is listed")), "{seen:?}");
            }
        }
    }
}

#[test]
fn one_of_several_is_chosen_by_number() {
    let Some(root) = common::data("RIGLAB_GOLDEN", "golden") else { return };
    let mut several = 0;
    for path in asset_files(&root.join("formats")) {
        let arrays: Vec<ArrayRig> = read_arrays(&path).unwrap().into_iter().map(Result::unwrap).collect();
        if arrays.len() < 2 {
            continue;
        }
        several += 1;
        let item = |item| import(&path, &ImportOptions { item, ..Default::default() });
        let error = item(None).unwrap_err().to_string();
        assert!(error.contains(" assets; `--item N` of `riglab view`, `inspect` and `convert` takes one"), "{error}");
        let (first, second) = (item(Some(0)).unwrap(), item(Some(1)).unwrap());
        assert_eq!(first.name == second.name, arrays[0].name == arrays[1].name, "{}", path.display());
        assert_eq!(first.content == second.content, arrays[0] == arrays[1], "{}", path.display());
        let behind = arrays.len() + 6;
        assert!(item(Some(behind)).unwrap_err().to_string().contains(&format!("there is no asset {behind}")));
    }
    assert!(several > 0, "no file of several assets");
}

/// A pair of rig text and OBJ, imported with and without repair.
#[test]
fn joints_beside_the_tree_are_refused_or_repaired() {
    let dir = tempfile::tempdir().unwrap();
    let text = dir.path().join("x_rig.txt");
    let joints = "joints hips 0 0 0\njoints hips_dup_0 0 0.03 0\njoints leg 0 1 0\njoints ik 1 0 0\nroot hips\n";
    let rows = "skin 0 hips 1\nskin 1 hips_dup_0 0.5 hips 0.5\nskin 2 leg 1\nskin 3 ik 1\n";
    std::fs::write(&text, format!("{joints}hier hips hips_dup_0\nhier hips_dup_0 leg\n{rows}")).unwrap();
    let mesh = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
    std::fs::write(dir.path().join("x.obj"), mesh).unwrap();

    let refused = import(&text, &ImportOptions::default()).unwrap_err().to_string();
    assert!(refused.contains("joint `ik` is not reachable") && refused.contains("--repair"), "{refused}");
    let repaired = import(&text, &ImportOptions { repair: true, ..ImportOptions::default() }).unwrap();
    let told: Vec<String> = repaired.warnings().iter().map(ToString::to_string).collect();
    assert!(told[0].contains("(`ik`) became children of `hips`"), "{told:?}");
    assert!(told[1].contains("copies of branching joints (`hips_dup_0`)"), "{told:?}");
    assert!(!told.iter().any(|t| t.contains("duplicate joints")), "{told:?}");
    let rig = repaired.rig().unwrap();
    let skeleton = rig.skeleton();
    assert_eq!(skeleton.ids().map(|j| skeleton.name(j)).collect::<Vec<_>>(), ["hips", "leg", "ik"]);
    assert_eq!(rig.weights().row(1).map(|(j, w)| (j.index(), w)).collect::<Vec<_>>(), [(0, 1.0)]);
    assert_eq!(repaired.provenance.notes, told);
}

/// Two octahedra as Blender compresses them: the accessor of indices is one, what Draco decodes for it are two.
#[test]
fn compressed_geometry_that_shares_an_accessor_is_told_apart() {
    let bytes = include_bytes!("data/two_draco.glb");
    let imported = import_bytes("two.glb", bytes, &Default::default()).unwrap();
    let mesh = imported.mesh();
    assert_eq!((mesh.positions().len(), mesh.triangles().len()), (12, 16));
    // An octahedron's triangles never join opposite corners, and each of its 12 edges is one of two triangles.
    for triangles in mesh.triangles().chunks(8) {
        let edges = triangles.iter().flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]]);
        let opposite = |[a, b]: [u32; 2]| {
            let [p, q] = [a, b].map(|v| mesh.positions()[v as usize]);
            let middle = if p[0] + q[0] < 0.0 { -0.3 } else { 0.3 };
            (p[0] + q[0] - 2.0 * middle).abs() + (p[1] + q[1]).abs() + (p[2] + q[2]).abs() < 1e-3
        };
        assert!(!edges.clone().any(opposite));
        assert_eq!(edges.map(|[a, b]| [a.min(b), a.max(b)]).collect::<BTreeSet<_>>().len(), 12);
    }
    // What is written plain is the same.
    let plain = export::strip_bytes("two.glb", bytes, None, &Default::default()).unwrap();
    let again = import_bytes("two.glb", &plain.bytes, &Default::default()).unwrap();
    assert_eq!(again.mesh(), mesh);
}
