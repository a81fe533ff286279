//! Models in, the same models with a rig out: the true skeleton and weights attached to what is left when
//! they were taken out.

mod common;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use riglab_asset::export::{self, ExportNote, ExportOptions, Influences, JointFrames};
use riglab_asset::rigging::{Subject, SubjectNote, SubjectOptions, UpAxis};
use riglab_asset::{Fault, ImportOptions, NodeName, Warning, import, import_bytes};
use riglab_core::{Rig, Skeleton, SkinWeights, Vec3};
use serde_json::{Value, json};

/// JSON and binary chunk.
fn parts(bytes: &[u8]) -> (Value, Vec<u8>) {
    let length = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
    let json = serde_json::from_slice(&bytes[20..20 + length(12)]).unwrap();
    (json, bytes.get(28 + length(12)..).unwrap_or_default().to_vec())
}

/// Pictures by number, where they are in the file.
fn pictures((json, binary): &(Value, Vec<u8>)) -> Vec<Vec<u8>> {
    let images = json["images"].as_array().into_iter().flatten();
    let view = |number: u64| {
        let view = &json["bufferViews"][number as usize];
        let at = |key: &str| view.get(key).map_or(0, |v| v.as_u64().unwrap() as usize);
        binary[at("byteOffset")..at("byteOffset") + at("byteLength")].to_vec()
    };
    images.filter_map(|i| Some(view(i.get("bufferView")?.as_u64()?))).collect()
}

/// The rows of a rig for the mesh of a subject: those of the vertex that is moved `by` so much to the same place, else the
/// root's.
fn true_rig(subject: &Subject, rig: &Rig, by: Vec3) -> Rig {
    let key = |p: &[f32; 3]| p.map(|x| (x + 0.0).to_bits());
    let shown = |p: &Vec3| -> Vec3 { std::array::from_fn(|k| p[k] + by[k]) };
    let at: HashMap<_, _> = rig.mesh().positions().iter().map(shown).enumerate().map(|(v, p)| (key(&p), v)).collect();
    let rows = subject.mesh().positions().iter().map(|p| match at.get(&key(p)) {
        Some(&v) => rig.weights().row(v).map(|(j, w)| (j.0, f64::from(w))).collect(),
        None => vec![(0, 1.0)],
    });
    let weights = SkinWeights::normalized(rows).unwrap();
    subject.rigged(rig.skeleton().clone(), weights).unwrap().with_humanoid(rig.humanoid().clone()).unwrap()
}

/// That what was written reads back as the rig that was attached. Vertices whose weights change move by less than is
/// seen where the joints of the file have maps that differ a little.
fn reads_back(name: &str, bytes: &[u8], rig: &Rig, kept: bool) {
    // Blend shapes are applied where the rig is not the file's own.
    let options = ImportOptions { shaped: !kept, ..ImportOptions::default() };
    let back = import_bytes("back.glb", bytes, &options).unwrap();
    let own = back.rig().unwrap_or_else(|| panic!("{name}: no rig"));
    assert_eq!(own.skeleton(), rig.skeleton(), "{name}");
    let unseen = 1e-6 * rig.bounds().diagonal();
    let apart = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).map(|k| (a[k] - b[k]).abs()).fold(0.0, f32::max);
    assert_eq!(own.mesh().positions().len(), rig.mesh().positions().len(), "{name}");
    let most = own.mesh().positions().iter().zip(rig.mesh().positions()).map(apart).fold(0.0, f32::max);
    assert!(most <= if kept { unseen } else { 0.0 }, "{name}: {most}");
    for v in 0..own.mesh().positions().len() {
        let rows = [own, rig].map(|r| r.weights().row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>());
        let near = rows[0].iter().zip(&rows[1]).all(|(a, b)| a.0 == b.0 && (a.1 - b.1).abs() < 1e-6);
        assert!(near && rows[0].len() == rows[1].len(), "{name}, vertex {v}: {rows:?}");
    }
}

/// That each mesh that a node shows is skinned, and has weights wherever it has positions; and that of the others, which are
/// colliders by name, none has.
fn every_shown_primitive_is_bound(name: &str, json: &Value) {
    for node in json["nodes"].as_array().unwrap().iter().filter(|node| node.get("mesh").is_some()) {
        let mesh = &json["meshes"][node["mesh"].as_u64().unwrap() as usize];
        if node.get("skin").is_none() && node["name"].as_str().is_some_and(|n| n.contains("_collider")) {
            let bare = |p: &Value| p["attributes"].get("JOINTS_0").is_none();
            assert!(mesh["primitives"].as_array().unwrap().iter().all(bare), "{name}: {node}");
            continue;
        }
        for attributes in mesh["primitives"].as_array().unwrap().iter().map(|p| &p["attributes"]) {
            let count =
                |key: &str| Some(json["accessors"][attributes[key].as_u64()? as usize]["count"].as_u64().unwrap());
            assert!(node.get("skin").is_some(), "{name}: {node}");
            assert_eq!(count("POSITION"), count("WEIGHTS_0"), "{name}");
            assert_eq!(count("POSITION"), count("JOINTS_0"), "{name}");
        }
    }
}

fn all_influences() -> ExportOptions {
    ExportOptions { influences: Influences::All, ..ExportOptions::default() }
}

#[test]
fn true_rigs_of_bare_models_read_back_and_looks_stay() {
    let mut files: Vec<PathBuf> = Vec::new();
    if let Some(folder) = common::data("RIGLAB_RIGS", "rigs") {
        files.extend(common::files(&folder, &["glb", "vrm"]).into_iter().step_by(4));
    }
    if let Some(folder) = common::data("RIGLAB_RIGS_ORIGINAL", "rigs_original") {
        files.extend(common::files(&folder, &["glb", "vrm"]));
    }
    if let Some(folder) = common::data("RIGLAB_RIGS_HARD", "rigs_hard") {
        files.extend(common::files(&folder, &["glb", "gltf", "vrm"]));
    }
    let folder = tempfile::tempdir().unwrap();
    let mut done = 0;
    for path in files {
        let Ok(imported) = import(&path, &ImportOptions::default()) else { continue };
        let Some(rig) = imported.rig() else { continue };
        let name = path.display().to_string();
        // Bare beforehand, and with the old rig that is to be ignored.
        let bare = folder.path().join("bare.glb");
        let stripped = export::strip(&path, &ImportOptions::default()).unwrap();
        std::fs::write(&bare, &stripped.bytes).unwrap();
        for input in [&bare, &path] {
            let before = std::fs::read(input).unwrap();
            let subject = Subject::read(input, &SubjectOptions::default()).unwrap();
            let rig = true_rig(&subject, rig, imported.reading.shown_off);
            let exported = subject.attach(&rig, &all_influences()).unwrap();
            assert_eq!(exported, subject.attach(&rig, &all_influences()).unwrap(), "{name}");
            reads_back(&name, &exported.bytes, &rig, false);
            assert_eq!(std::fs::read(input).unwrap(), before, "{name}: the input is as it was");
            if before.starts_with(b"glTF") {
                let [before, after] = [parts(&stripped.bytes), parts(&exported.bytes)];
                for key in ["materials", "textures", "samplers", "asset", "cameras", "extras"] {
                    assert_eq!(before.0.get(key), after.0.get(key), "{key} of {name}");
                }
                assert_eq!(pictures(&before), pictures(&after), "pictures of {name}");
            }
            every_shown_primitive_is_bound(&name, &parts(&exported.bytes).0);
        }
        done += 1;
    }
    println!("{done} files");
}

#[test]
fn rigid_parts_keep_their_joint_and_the_file_its_motions_under_other_weights() {
    let Some(folder) = common::data("RIGLAB_RIGS_ORIGINAL", "rigs_original") else { return };
    let path = folder.join("kaykit_knight_meshopt.glb");
    let subject = Subject::read(&path, &SubjectOptions { keep_rig: true, ..Default::default() }).unwrap();
    let old = subject.old_rig().unwrap();
    // Equal shares of the joints that a vertex has; one on a single joint moves to the root, as a network may have it.
    let shares = |v: usize| {
        let own: Vec<(u16, f64)> = old.weights().row(v).map(|(joint, _)| (joint.0, 1.0)).collect();
        if own.len() == 1 { vec![(own[0].0, 3.0), (0, 1.0)] } else { own }
    };
    let other = SkinWeights::normalized((0..old.weights().rows()).map(shares)).unwrap();
    let kept = subject.with_rigid_parts(other.clone());
    let same = |v: &usize| kept.row(*v).eq(old.weights().row(*v));
    let rigid = (0..kept.rows()).filter(same).count();
    assert!(rigid > 0 && rigid < kept.rows(), "{rigid} of {}", kept.rows());
    let motions = |weights: &SkinWeights| {
        let rig = subject.rigged(old.skeleton().clone(), weights.clone()).unwrap();
        let exported = subject.attach(&rig, &ExportOptions::default()).unwrap();
        parts(&exported.bytes).0["animations"].as_array().map_or(0, Vec::len)
    };
    assert_eq!((motions(&kept), motions(&other)), (26, 0), "with a shield held by its own joint, and by two");
}

#[test]
fn a_kept_rig_under_other_weights_stands_where_the_file_shows_it() {
    let Some(folder) = common::data("RIGLAB_RIGS_HARD", "rigs_hard") else { return };
    // Its inverse bind matrices bring quantised positions to size, so that its rig is held elsewhere than it is shown.
    let path = folder.join("ok_quantized.glb");
    let subject = Subject::read(&path, &SubjectOptions { keep_rig: true, ..Default::default() }).unwrap();
    let (old, by) = (subject.old_rig().unwrap(), subject.shown_off());
    assert!(by[1] > 0.4, "{by:?}");
    // As the file has them, and all on one joint.
    let one = SkinWeights::normalized((0..subject.mesh().positions().len()).map(|_| [(0, 1.0)])).unwrap();
    for weights in [old.weights().clone(), one] {
        let rig = subject.rigged(old.skeleton().clone(), weights).unwrap();
        let bytes = subject.attach(&rig, &all_influences()).unwrap().bytes;
        let back = import_bytes("back.glb", &bytes, &ImportOptions::default()).unwrap();
        let (own, off) = (back.rig().unwrap(), back.reading.shown_off);
        let pairs = own.mesh().positions().iter().zip(rig.mesh().positions());
        let heads = own.skeleton().heads().iter().zip(rig.skeleton().heads());
        for (a, b) in pairs.chain(heads) {
            assert!((0..3).all(|k| (a[k] + off[k] - b[k] - by[k]).abs() < 1e-5), "{a:?} {b:?}");
        }
    }
}

#[test]
fn a_kept_skeleton_stays_with_its_nodes() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let file = "khronos_fox.glb";
    let path = folder.join(file);
    let subject = Subject::read(&path, &SubjectOptions { keep_rig: true, ..Default::default() }).unwrap();
    let old = subject.old_rig().unwrap();
    let rows = (0..subject.mesh().positions().len()).map(|v| [((v % 3) as u16, 1.0)]);
    let rig = subject.rigged(old.skeleton().clone(), SkinWeights::normalized(rows).unwrap()).unwrap();
    let exported = subject.attach(&rig, &ExportOptions::default()).unwrap();
    reads_back(file, &exported.bytes, &rig, true);
    let [before, after] = [std::fs::read(&path).unwrap(), exported.bytes].map(|bytes| parts(&bytes).0);
    for key in ["nodes", "animations", "scenes"] {
        let count = |json: &Value| json[key].as_array().map(Vec::len);
        assert_eq!(count(&before), count(&after), "{key} of {file}");
    }
    assert_eq!(before["nodes"], after["nodes"], "{file}");
}

#[test]
fn a_model_that_lies_is_rigged_as_it_stands_and_written_as_it_lies() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let upright = import(folder.join("khronos_fox.glb"), &ImportOptions::default()).unwrap();
    let rig = upright.rig().unwrap();
    for up in UpAxis::ALL {
        let lying = rig.mesh().positions().iter().map(|p| up.from_y(*p)).collect();
        let lying = rig.mesh().with_positions(lying).unwrap();
        let lying = Rig::new(rig.skeleton().clone(), lying, rig.weights().clone()).unwrap();
        let bytes = export::alone("fox", &lying, &upright.provenance, &all_influences()).unwrap().bytes;
        let options = SubjectOptions { up, ..SubjectOptions::default() };
        let subject = Subject::from_bytes("fox.glb", &bytes, None, &options).unwrap();
        assert_eq!(subject.mesh().positions(), rig.mesh().positions());
        let attached = subject.rigged(rig.skeleton().clone(), rig.weights().clone()).unwrap();
        let exported = subject.attach(&attached, &all_influences()).unwrap();
        let back = import_bytes("back.glb", &exported.bytes, &ImportOptions::default()).unwrap();
        assert_eq!(back.mesh(), lying.mesh());
        let heads: Vec<_> = back.rig().unwrap().skeleton().heads().iter().map(|p| up.to_y(*p)).collect();
        assert_eq!(heads, rig.skeleton().heads());
    }
}

/// An OBJ of a rig's mesh, with coordinates, normals and two materials, in a folder.
fn write_obj(folder: &Path, rig: &Rig) -> PathBuf {
    use std::fmt::Write;
    let mut text = String::from("mtllib fox.mtl\no fox\n");
    for [x, y, z] in rig.mesh().positions() {
        writeln!(text, "v {x} {y} {z}\nvt {x} {y}").unwrap();
    }
    for [x, y, z] in rig.mesh().vertex_normals() {
        writeln!(text, "vn {x} {y} {z}").unwrap();
    }
    for (t, [a, b, c]) in rig.mesh().triangles().iter().map(|t| t.map(|v| v + 1)).enumerate() {
        if t == 0 || t == rig.mesh().triangles().len() / 2 {
            writeln!(text, "usemtl m{}", usize::from(t > 0)).unwrap();
        }
        writeln!(text, "f {a}/{a}/{a} {b}/{b}/{b} {c}/{c}/{c}").unwrap();
    }
    std::fs::write(folder.join("fox.mtl"), "newmtl m0\nKd 1 0 0\nnewmtl m1\nmap_Kd fur.png\n").unwrap();
    std::fs::write(folder.join("fur.png"), b"\x89PNG\r\n\x1a\nfur").unwrap();
    let path = folder.join("fox.obj");
    std::fs::write(&path, text).unwrap();
    path
}

#[test]
fn an_obj_takes_its_materials_along() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let fox = import(folder.join("khronos_fox.glb"), &ImportOptions::default()).unwrap();
    let temp = tempfile::tempdir().unwrap();
    let path = write_obj(temp.path(), fox.rig().unwrap());
    let subject = Subject::read(&path, &SubjectOptions::default()).unwrap();
    assert!(subject.notes().iter().all(|n| !matches!(n, SubjectNote::FileMissing(_))), "{:?}", subject.notes());
    let rig = true_rig(&subject, fox.rig().unwrap(), [0.0; 3]);
    let exported = subject.attach(&rig, &all_influences()).unwrap();
    reads_back("fox.obj", &exported.bytes, &rig, false);
    let after = parts(&exported.bytes);
    assert_eq!(pictures(&after), [b"\x89PNG\r\n\x1a\nfur"]);
    let primitives = after.0["meshes"][0]["primitives"].as_array().unwrap();
    let looks: Vec<_> = primitives.iter().map(|p| p["material"].as_u64()).collect();
    assert_eq!(looks, [Some(0), Some(1)]);
    for primitive in primitives {
        for attribute in ["POSITION", "NORMAL", "TEXCOORD_0", "JOINTS_0", "WEIGHTS_0"] {
            assert!(primitive["attributes"][attribute].is_u64(), "{attribute}");
        }
    }
    // Seams between the materials are copies of one place, and agree.
    let twins = subject.twins();
    let seams = twins.iter().zip(0..).filter(|(first, v)| *first != v).count();
    assert!(seams > 0);
    let agreed = subject.agreed(rig.weights());
    let row = |v: usize| agreed.row(v).collect::<Vec<_>>();
    assert!(twins.iter().enumerate().all(|(v, first)| row(v) == row(*first as usize)));
    let origins = subject.origins();
    assert_eq!(origins.len(), subject.mesh().positions().len());
    assert_eq!((origins[0].node, origins[0].primitive, origins[0].vertex), (0, 0, 0));
    assert_eq!(origins.last().unwrap().primitive, 1);
    // z up becomes y up, in the file too.
    let options = SubjectOptions { up: UpAxis::Z, ..SubjectOptions::default() };
    let turned = Subject::read(&path, &options).unwrap();
    let stood: Vec<_> = subject.mesh().positions().iter().map(|p| UpAxis::Z.to_y(*p)).collect();
    assert_eq!(turned.mesh().positions(), stood);
    let rig = turned.rigged(rig.skeleton().clone(), rig.weights().clone()).unwrap();
    reads_back("turned", &turned.attach(&rig, &all_influences()).unwrap().bytes, &rig, false);
}

#[test]
fn an_obj_keeps_the_rig_of_the_text_beside_it_and_its_looks() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    std::fs::write(at("e.mtl"), "newmtl cloth\nKd 0.25 0.5 0.75\n").unwrap();
    let points = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 1\n";
    std::fs::write(at("e.obj"), format!("mtllib e.mtl\n{points}usemtl cloth\nf 3 2 1\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"))
        .unwrap();
    let rig = "joints hips 0 0 0\njoints tip 0 1 0\nroot hips\nhier hips tip\nskin 0 hips 1\nskin 1 hips 1\nskin 2 tip 1\n\
        skin 3 hips 0.25 tip 0.75\n";
    std::fs::write(at("e_rig.txt"), rig).unwrap();
    // Joints alone are no rig to keep.
    std::fs::write(at("joints.obj"), points.to_owned() + "f 3 2 1\n").unwrap();
    std::fs::write(at("joints_rig.txt"), "joints hips 0 0 0\nroot hips\n").unwrap();
    let keep = SubjectOptions { keep_rig: true, ..Default::default() };
    assert!(Subject::read(at("joints.obj"), &keep).unwrap().old_rig().is_none());
    let read = |keep_rig| Subject::read(at("e.obj"), &SubjectOptions { keep_rig, ..Default::default() }).unwrap();
    let bare = read(false);
    assert!(bare.old_rig().is_none() && bare.notes().is_empty(), "{:?}", bare.notes());
    let kept = read(true);
    assert_eq!(kept.old_rig().unwrap().skeleton().names(), ["hips", "tip"]);
    let weights = kept.old_weights().unwrap().clone();
    for (v, place) in kept.mesh().positions().iter().enumerate() {
        let wanted: &[f32] = match place {
            [_, _, 1.0] => &[0.25, 0.75],
            _ => &[1.0],
        };
        assert_eq!(weights.row(v).map(|(_, share)| share).collect::<Vec<_>>(), wanted, "{place:?}");
    }
    let rig = kept.rigged(kept.old_rig().unwrap().skeleton().clone(), weights).unwrap();
    let made = kept.attach(&rig, &ExportOptions::default()).unwrap();
    let (json, _) = parts(&made.bytes);
    assert_eq!((json["skins"].as_array().unwrap().len(), &json["materials"][0]["name"]), (1, &Value::from("cloth")));
}

#[test]
fn what_cannot_be_rigged_is_told_in_a_sentence() {
    let fault = |name: &str, bytes: &[u8], options: &SubjectOptions| {
        Subject::from_bytes(name, bytes, None, options).unwrap_err().fault
    };
    let all = SubjectOptions::default();
    assert_eq!(fault("a.obj", b"v 0 0 0\n", &all), Fault::NoMesh);
    assert_eq!(fault("a.gltf", br#"{"asset":{"version":"2.0"}}"#, &all), Fault::NoMesh);
    let two = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\nf 1 2 4\n";
    let few = SubjectOptions { max_triangles: 1, ..SubjectOptions::default() };
    let said = fault("a.obj", two, &few).to_string();
    assert!(said.starts_with("2 triangles are more than the 1 that are read; `--max-triangles 2`"), "{said}");
    assert_eq!(fault("a.obj", b"v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n", &all), Fault::NoArea);
    assert!(matches!(fault("a.obj", b"", &all), Fault::Empty));
    assert!(matches!(fault("a.png", b"\x89PNG", &all), Fault::NotAModel(_)));
    let Some(folder) = common::data("RIGLAB_RIGS_HARD", "rigs_hard") else { return };
    for path in common::files(&folder, &["glb", "gltf", "vrm", "obj", "fbx"]) {
        // What is broken beyond its rig is refused, and nothing panics.
        match Subject::read(&path, &all) {
            Ok(subject) => assert!(!subject.mesh().triangles().is_empty()),
            Err(e) => assert!(e.to_string().starts_with(&path.display().to_string()), "{e}"),
        }
    }
    let subject = Subject::read(folder.join("warn_no_rig.obj"), &all).unwrap();
    let other = Subject::from_bytes("a.obj", two, None, &all).unwrap();
    let joint = riglab_core::Joint { name: "root".into(), parent: None, head: [0.0; 3] };
    let skeleton = riglab_core::Skeleton::new(vec![joint]).unwrap();
    let rig = other.rigged(skeleton, SkinWeights::normalized(vec![[(0, 1.0)]; 4]).unwrap()).unwrap();
    assert!(subject.attach(&rig, &ExportOptions::default()).unwrap_err().to_string().contains("another mesh"));
    // A rig of which nothing is bound is no hindrance.
    let bare = Subject::read(folder.join("reject_skeleton_without_mesh.glb"), &all);
    println!("{:?}", bare.map(|s| s.notes().to_vec()));
}

#[test]
fn the_preview_bends_every_joint_and_changes_nothing_else() {
    use riglab_asset::Resample;
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let clips = ImportOptions { clips: Some(Resample::default()), ..ImportOptions::default() };
    for file in ["khronos_fox.glb", "quaternius_rts_archer.glb"] {
        let subject = Subject::read(folder.join(file), &SubjectOptions::default()).unwrap();
        let rig = import(folder.join(file), &ImportOptions::default()).unwrap();
        let rig = true_rig(&subject, rig.rig().unwrap(), [0.0; 3]);
        for frames in [JointFrames::Parallel, JointFrames::AlongBone] {
            let options = ExportOptions { frames, ..all_influences() };
            let bare = subject.attach(&rig, &options).unwrap().bytes;
            let moved = export::preview(&bare).unwrap().bytes;
            assert_eq!(moved, export::preview(&bare).unwrap().bytes);
            let [before, after] = [&bare, &moved].map(|b| import_bytes("x.glb", b, &clips).unwrap());
            assert_eq!(before.content, after.content);
            let clip = after.clips.last().unwrap();
            assert_eq!((clip.name(), after.clips.len()), ("riglab preview", before.clips.len() + 1));
            for joint in 0..clip.joints() {
                let turned = |frame: usize| {
                    clip.maps()[frame * clip.joints() + joint][0][0] < 0.999
                        || clip.maps()[frame * clip.joints() + joint][1][1] < 0.999
                };
                assert!((0..clip.frames()).any(turned), "joint {joint} of {file} stands still");
            }
        }
    }
    // Nothing to bend.
    let bare = export::strip(folder.join("khronos_fox.glb"), &ImportOptions::default()).unwrap().bytes;
    assert!(parts(&export::preview(&bare).unwrap().bytes).0.get("animations").is_none());
}

#[test]
fn doubts_are_rare_where_there_is_nothing_to_doubt() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    // As they are, and put down as if z were up.
    let mut told: [HashMap<&str, usize>; 2] = Default::default();
    let mut files = 0;
    for path in common::files(&folder, &["glb", "vrm"]).into_iter().step_by(2) {
        files += 1;
        for (up, told) in [UpAxis::Y, UpAxis::MinusZ].into_iter().zip(&mut told) {
            let Ok(subject) = Subject::read(&path, &SubjectOptions { up, ..Default::default() }) else { continue };
            for note in subject.notes() {
                let kind = match note {
                    // Of those that were put down y is to be told, as it is up in the file.
                    SubjectNote::LiesDown { axis, .. } if up == UpAxis::Y || *axis == UpAxis::Y => "lies",
                    SubjectNote::StandApart { .. } => "apart",
                    SubjectNote::InsideOut { .. } => "inside out",
                    _ => continue,
                };
                *told.entry(kind).or_default() += 1;
                println!("{} {up}: {note}", path.file_name().unwrap().display());
            }
        }
    }
    println!("{files} files: {told:?}");
    let share = |of: &HashMap<&str, usize>, kind: &str| of.get(kind).copied().unwrap_or(0) as f64 / files as f64;
    assert!(share(&told[0], "lies") < 0.03 && share(&told[1], "lies") > 0.2);
    assert!(share(&told[0], "apart") < 0.1 && share(&told[0], "inside out") < 0.1);
}

#[cfg(feature = "fbx")]
#[test]
fn an_fbx_is_rigged_anew_or_keeps_its_skeleton() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let fox = import(folder.join("khronos_fox.glb"), &ImportOptions::default()).unwrap().into_asset().unwrap();
    let bytes = riglab_asset::glb_to_fbx(&riglab_asset::to_glb(&fox)).unwrap().bytes;
    let keep = SubjectOptions { keep_rig: true, ..SubjectOptions::default() };
    for options in [SubjectOptions::default(), keep] {
        let subject = Subject::from_bytes("fox.fbx", &bytes, None, &options).unwrap();
        assert_eq!(subject.old_rig().is_some(), options.keep_rig);
        assert_eq!(subject.mesh().triangles().len(), fox.rig.mesh().triangles().len());
        let read = import_bytes("fox.fbx", &bytes, &ImportOptions::default()).unwrap();
        let rig = true_rig(&subject, read.rig().unwrap(), [0.0; 3]);
        let bound = (0..rig.mesh().positions().len()).filter(|&v| rig.weights().row(v).any(|(j, _)| j.0 > 0));
        assert!(10 * bound.count() > 9 * rig.mesh().positions().len(), "vertices stand where the importer has them");
        reads_back("fox.fbx", &subject.attach(&rig, &all_influences()).unwrap().bytes, &rig, false);
    }
}

#[cfg(feature = "fbx")]
#[test]
fn rigid_parts_of_an_fbx_keep_their_joint() {
    // A blade on the tip, without a skin, whose last corner no triangle of the FBX shares.
    let tiny = common::Tiny::new()
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"name": "blade", "mesh": 1, "translation": [0, 0.5, 0]}))
        .with(
            "/meshes/-",
            json!({"primitives": [{"attributes": {"POSITION": common::POSITION}, "indices": common::INDICES}]}),
        );
    let bytes = riglab_asset::glb_to_fbx(&tiny.glb()).unwrap().bytes;
    let keep = SubjectOptions { keep_rig: true, ..SubjectOptions::default() };
    let subject = Subject::from_bytes("a.fbx", &bytes, None, &keep).unwrap();
    let count = subject.mesh().positions().len();
    let old = subject.old_weights().unwrap();
    assert_eq!(old.rows(), count);
    let halves = SkinWeights::normalized((0..count).map(|_| [(0, 0.5), (1, 0.5)])).unwrap();
    let kept = subject.with_rigid_parts(halves.clone());
    // What stands higher than the body is of the blade alone, and so is what the rig holds by the tip alone beside that.
    let positions = subject.mesh().positions();
    let blade = |v: &usize| positions[*v][1] > 2.6 || kept.row(*v).ne(halves.row(*v));
    let all: Vec<usize> = (0..count).filter(blade).collect();
    assert!(all.len() >= 4 && all.len() < count, "{} of {count}", all.len());
    assert!(all.iter().all(|&v| kept.row(v).map(|(j, w)| (j.0, w)).eq([(1, 1.0)])));
    assert!(all.iter().all(|&v| old.row(v).map(|(j, w)| (j.0, w)).eq([(1, 1.0)])));
}

/// A skeleton of one joint, and all of a subject's mesh on it.
fn on_one_joint(subject: &Subject, head: [f32; 3]) -> Rig {
    let joint = riglab_core::Joint { name: "one".into(), parent: None, head };
    let rows = subject.mesh().positions().iter().map(|_| [(0, 1.0)]);
    subject.rigged(Skeleton::new(vec![joint]).unwrap(), SkinWeights::normalized(rows).unwrap()).unwrap()
}

#[test]
fn colliders_are_not_rigged_and_stay_as_they_are() {
    let corners: Vec<u8> = [0u16, 1, 2].iter().flat_map(|v| v.to_le_bytes()).collect();
    let tiny = common::Tiny::new().with_accessor(5123, "SCALAR", 3, &corners);
    let indices = tiny.accessors() - 1;
    let triangle = json!({"primitives": [{"attributes": {"POSITION": common::POSITION}, "indices": indices}]});
    let bare = tiny.with("/skins", json!([])).with("/nodes/0", json!({"mesh": 0})).with("/meshes/-", triangle);
    let subject = |name: &str| {
        let bytes = bare.clone().with("/nodes/-", json!({"mesh": 1, "name": name})).glb();
        Subject::from_bytes("a.glb", &bytes, None, &SubjectOptions::default()).unwrap()
    };
    let (plain, own) = (subject("Tiny"), subject("Tiny_collider"));
    assert_eq!((plain.mesh().triangles().len(), own.mesh().triangles().len()), (5, 4));
    let note =
        SubjectNote::Read(Warning::Colliders { nodes: vec![NodeName { number: 3, name: "Tiny_collider".into() }] });
    assert!(own.notes().contains(&note) && !plain.notes().contains(&note), "{:?}", own.notes());
    for (subject, skinned) in [(plain, true), (own, false)] {
        let rig = on_one_joint(&subject, [0.0; 3]);
        let bytes = subject.attach(&rig, &all_influences()).unwrap().bytes;
        let (json, _) = parts(&bytes);
        every_shown_primitive_is_bound("collider", &json);
        let nodes = json["nodes"].as_array().unwrap();
        let node = nodes.iter().find(|n| n["name"].as_str().is_some_and(|n| n.starts_with("Tiny"))).unwrap();
        assert_eq!(node["skin"].is_u64(), skinned, "{json}");
        reads_back("collider", &bytes, &rig, false);
    }
    // Where all of a file is called so, it is the model.
    let all = bare.with("/nodes/0/name", json!("UCX_all")).glb();
    let all = Subject::from_bytes("a.glb", &all, None, &SubjectOptions::default()).unwrap();
    assert_eq!(all.mesh().triangles().len(), 4);
}

/// [`common::Tiny`] without its skin, below two nodes, and an animation that moves one node.
fn walking(moved: usize) -> common::Tiny {
    let floats = |all: &[f32]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let tiny = common::Tiny::new().with_accessor(5126, "SCALAR", 2, &floats(&[0.0, 1.0]));
    let tiny = tiny.with_accessor(5126, "VEC3", 2, &floats(&[0.0, 0.0, 0.0, 2.0, 0.0, 0.0]));
    let output = tiny.accessors() - 1;
    let target = json!({"node": moved, "path": "translation"});
    let walk =
        json!({"channels": [{"sampler": 0, "target": target}], "samplers": [{"input": output - 1, "output": output}]});
    let nodes = json!([
        {"name": "body", "mesh": 0},
        {"name": "walker", "children": [0], "scale": [2, 2, 2], "translation": [0, 3, 0]},
        {"name": "world", "children": [1]},
    ]);
    tiny.with("/skins", json!([])).with("/nodes", nodes).with("/animations", json!([walk]))
}

#[test]
fn a_motion_that_carries_the_model_carries_its_skeleton() {
    let subject =
        |moved| Subject::from_bytes("a.glb", &walking(moved).glb(), None, &SubjectOptions::default()).unwrap();
    for (moved, above) in [(1, Some("walker")), (2, Some("world")), (0, None)] {
        let subject = subject(moved);
        let rig = on_one_joint(&subject, [0.5, 4.0, 0.0]);
        let exported = subject.attach(&rig, &all_influences()).unwrap();
        reads_back("walking", &exported.bytes, &rig, false);
        let (json, _) = parts(&exported.bytes);
        let nodes = json["nodes"].as_array().unwrap();
        let armature = nodes.iter().position(|n| n["name"] == "Armature").unwrap();
        let holds = |n: &&Value| n["children"].as_array().is_some_and(|c| c.contains(&json!(armature)));
        assert_eq!(nodes.iter().find(holds).and_then(|n| n["name"].as_str()), above);
        // A mesh that is moved by itself stays behind, and that is said.
        let idle = ExportNote::MotionIdle { nodes: 1, above: 0 };
        assert_eq!(exported.notes.contains(&idle), above.is_none(), "{:?}", exported.notes);
        assert_eq!(
            json["animations"][0]["channels"][0]["target"]["node"].as_u64().map(|n| nodes[n as usize]["name"].clone()),
            Some(json!(above.unwrap_or("body")))
        );
    }
}

#[test]
fn a_motion_above_some_of_the_meshes_is_told_to_be_lost() {
    // A second body hangs on nothing that moves, so the skeleton cannot go with the node above the first.
    let mut tiny = walking(1).with("/nodes/-", json!({"name": "other", "mesh": 0}));
    let attached = |tiny: &common::Tiny| {
        let subject = Subject::from_bytes("a.glb", &tiny.glb(), None, &SubjectOptions::default()).unwrap();
        subject.attach(&on_one_joint(&subject, [0.5, 4.0, 0.0]), &all_influences()).unwrap().notes
    };
    let idle = ExportNote::MotionIdle { nodes: 0, above: 1 };
    assert_eq!(attached(&tiny), std::slice::from_ref(&idle));
    assert_eq!(
        idle.to_string(),
        "animations of a node above a mesh move no mesh any more: skinned meshes go with their joints"
    );
    // Above both it carries all.
    tiny.document["nodes"][1]["children"] = json!([0, 3]);
    assert_eq!(attached(&tiny), []);
}

#[test]
fn blend_shapes_that_are_shown_are_looked_at_or_told() {
    // The third vertex goes up by 4 at full weight.
    let mut by = [0f32; 12];
    by[7] = 4.0;
    let by: Vec<u8> = by.iter().flat_map(|x| x.to_le_bytes()).collect();
    let tiny = common::Tiny::new().with_accessor(5126, "VEC3", 4, &by);
    let offsets = json!([{"POSITION": tiny.accessors() - 1}, {"POSITION": tiny.accessors() - 1}]);
    let tiny = tiny.with("/meshes/0/primitives/0/targets", offsets).with("/meshes/0/name", json!("face"));
    let read = |weights: &[f64], keep_rig: bool| {
        let shown = tiny.clone().with("/meshes/0/weights", json!(weights)).glb();
        let options = SubjectOptions { keep_rig, ..SubjectOptions::default() };
        Subject::from_bytes("a.glb", &shown, None, &options).unwrap()
    };
    let told = |subject: &Subject| -> Vec<String> {
        let notes = subject.notes().iter().filter(|note| matches!(note, SubjectNote::Shaped(_)));
        notes.map(ToString::to_string).collect()
    };
    let (plain, shaped, kept) = (read(&[0.0, 0.0], false), read(&[0.5, 0.25], false), read(&[0.5, 0.25], true));
    assert!([&plain, &shaped, &kept].iter().all(|subject| told(subject).is_empty()));
    let mut wanted = plain.mesh().positions().to_vec();
    wanted[2][1] += 3.0;
    assert_eq!((shaped.mesh().positions(), kept.mesh().positions()), (&wanted[..], &wanted[..]));
    // One that cannot be applied, as it is no list of vectors, is told.
    let mut broken = tiny.clone().with("/meshes/0/weights", json!([0.0, 0.5]));
    broken.document["meshes"][0]["primitives"][0]["targets"][1]["POSITION"] = json!(common::INVERSE_BIND);
    let broken = Subject::from_bytes("a.glb", &broken.glb(), None, &SubjectOptions::default()).unwrap();
    assert!(told(&broken)[0].starts_with("`face` is shown with blend shapes at 1 of 2"), "{:?}", told(&broken));

    // A kept rig is written on what is stored.
    let rig =
        kept.rigged(kept.old_rig().unwrap().skeleton().clone(), kept.old_rig().unwrap().weights().clone()).unwrap();
    let bytes = kept.attach(&rig, &all_influences()).unwrap().bytes;
    let again = import_bytes("a.glb", &bytes, &ImportOptions::default()).unwrap();
    assert_eq!((again.mesh().positions(), again.reading.shaped.len()), (plain.mesh().positions(), 1));

    // What is stored stays, and so do the shapes: the file shows them once.
    let written = shaped.attach(&on_one_joint(&shaped, [0.5, 4.0, 0.0]), &all_influences()).unwrap().bytes;
    let again = import_bytes("a.glb", &written, &ImportOptions::default()).unwrap();
    assert_eq!((again.mesh().positions(), again.reading.shaped.len()), (plain.mesh().positions(), 1));
}

#[test]
fn what_hangs_on_joints_stays_on_them_where_weights_change() {
    // The inverse bind matrix of the tip has a scale that rounding left: other weights move vertices by next to nothing.
    let matrix = |scale: f32, y: f32| {
        let mut m = [0.0f32; 16];
        (m[0], m[5], m[10], m[15], m[13]) = (scale, scale, scale, 1.0, y);
        m
    };
    let binds = [matrix(1.0, -1.0), matrix(1.000_000_2, -2.000_000_5)].concat();
    let binds: Vec<u8> = binds.iter().flat_map(|x| x.to_le_bytes()).collect();
    let tiny = common::Tiny::new().with_accessor(5126, "MAT4", 2, &binds);
    let own = tiny.accessors() - 1;
    let plain = tiny.with("/skins/0/inverseBindMatrices", json!(own));
    let hung = |name: &str| plain.clone().with("/nodes/2/children", json!([3])).with("/nodes/-", json!({"name": name}));
    for (tiny, hung) in [(plain.clone(), 0), (hung("tip_end"), 1), (hung("socket"), 1)] {
        let keep = SubjectOptions { keep_rig: true, ..SubjectOptions::default() };
        let subject = Subject::from_bytes("a.glb", &tiny.glb(), None, &keep).unwrap();
        let rows = [[(0, 0.5), (1, 0.5)]; 4].into_iter();
        let weights = SkinWeights::normalized(rows).unwrap();
        let rig = subject.rigged(subject.old_rig().unwrap().skeleton().clone(), weights).unwrap();
        let bytes = subject.attach(&rig, &all_influences()).unwrap().bytes;
        reads_back("hung", &bytes, &rig, true);
        let (json, _) = parts(&bytes);
        let nodes = json["nodes"].as_array().unwrap();
        assert!(!nodes.iter().any(|n| n["name"] == "Armature"), "{json}");
        let on_tip = |n: &&Value| n["name"] == "tip" && n["children"].as_array().is_some_and(|c| c.len() == 1);
        assert_eq!(nodes.iter().filter(on_tip).count(), hung, "{json}");
    }
}

#[test]
fn what_a_file_does_not_show_is_not_rigged() {
    let bare = common::Tiny::new().with("/skins", json!([])).with("/nodes/0", json!({"mesh": 0}));
    let other = json!({"primitives": [{"attributes": {"POSITION": common::POSITION}, "indices": common::INDICES}]});
    let two =
        bare.with("/meshes/-", other).with("/nodes/-", json!({"mesh": 1, "name": "widget", "translation": [9, 0, 0]}));
    let shown = |scenes: Value| {
        let bytes = two.clone().with("/scenes", scenes).glb();
        Subject::from_bytes("a.glb", &bytes, None, &SubjectOptions::default()).unwrap()
    };
    let (own, both) = (shown(json!([{"nodes": [0]}, {"nodes": [3]}])), shown(json!([{"nodes": [0, 3]}])));
    assert_eq!((own.mesh().triangles().len(), both.mesh().triangles().len()), (4, 8));
    let note = SubjectNote::Read(Warning::Unseen { nodes: vec![NodeName { number: 3, name: "widget".into() }] });
    assert!(own.notes().contains(&note) && !both.notes().contains(&note), "{:?}", own.notes());
    let bytes = own.attach(&on_one_joint(&own, [0.0; 3]), &all_influences()).unwrap().bytes;
    let (json, _) = parts(&bytes);
    let widget = json["nodes"].as_array().unwrap().iter().find(|n| n["name"] == "widget").unwrap();
    assert!(widget.get("skin").is_none() && widget["translation"] == json!([9, 0, 0]), "{json}");
}

#[test]
fn a_vrm_without_its_humanoid_says_what_it_lost() {
    let vrm = json!({"VRMC_vrm": {"humanoid": {"humanBones": {"hips": {"node": 1}}}, "lookAt": {}, "meta": {}}});
    let bytes = common::Tiny::new().with("/extensions", vrm).glb();
    let subject = Subject::from_bytes("a.vrm", &bytes, None, &SubjectOptions::default()).unwrap();
    let lost = SubjectNote::Stripped(ExportNote::VrmDropped { parts: vec!["humanoid", "lookAt"] });
    assert!(subject.notes().contains(&lost), "{:?}", subject.notes());
    let exported = subject.attach(&on_one_joint(&subject, [0.0; 3]), &all_influences()).unwrap();
    let lacking =
        |n: &ExportNote| matches!(n, ExportNote::NotHuman { lacking } if lacking.len() == 15 && lacking[0] == "hips");
    let told = exported.notes.iter().find(|n| lacking(n)).map(ToString::to_string);
    assert!(
        told.as_deref().is_some_and(|told| told.starts_with("its joints are no human body")),
        "{:?}",
        exported.notes
    );
    // What is no VRM lacks nothing.
    let subject = Subject::from_bytes("a.glb", &common::Tiny::new().glb(), None, &SubjectOptions::default()).unwrap();
    assert_eq!(subject.attach(&on_one_joint(&subject, [0.0; 3]), &all_influences()).unwrap().notes, []);
}

#[test]
fn the_boxes_around_real_models_are_not_rigged() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    for file in ["dcl_antrom_bear.glb", "dcl_antrom_dragon.glb"] {
        let subject = Subject::read(folder.join(file), &SubjectOptions::default()).unwrap();
        let rigged = import(folder.join(file), &ImportOptions::default()).unwrap();
        assert_eq!(subject.mesh().positions().len(), rigged.mesh().positions().len(), "{file}");
    }
}

#[test]
fn a_model_that_faces_back_is_looked_at_from_its_front_and_written_as_it_was() {
    let (tiny, vrm) = (common::Tiny::new(), |name: &str| json!({name: {"humanoid": {"humanBones": []}}}));
    let read = |extensions: Value, to_front| {
        let options = SubjectOptions { to_front, ..SubjectOptions::default() };
        Subject::from_bytes("a.vrm", &tiny.clone().with("/extensions", extensions).glb(), None, &options).unwrap()
    };
    let (back, front) = (read(vrm("VRM"), false), read(vrm("VRM"), true));
    let round = |p: &[f32; 3]| [-p[0], p[1], -p[2]];
    assert_eq!(front.mesh().positions(), back.mesh().positions().iter().map(round).collect::<Vec<_>>());
    let told = |subject: &Subject| subject.notes().contains(&SubjectNote::FacesBack);
    assert!(told(&front) && !told(&back) && !told(&read(vrm("VRMC_vrm"), true)) && !told(&read(json!({}), true)));
    let rig = on_one_joint(&front, [0.25, 1.0, 0.5]);
    let bytes = front.attach(&rig, &all_influences()).unwrap().bytes;
    let written = import_bytes("back.vrm", &bytes, &ImportOptions::default()).unwrap();
    assert_eq!(written.mesh(), back.mesh());
    assert_eq!(written.rig().unwrap().skeleton().heads(), [[-0.25, 1.0, -0.5]]);
}

#[test]
fn a_model_that_stands_otherwise_than_it_was_bound_says_so() {
    let notes = |tip: [f32; 3]| {
        let bytes = common::Tiny::new().with("/nodes/2/translation", json!(tip)).glb();
        Subject::from_bytes("a.glb", &bytes, None, &SubjectOptions::default()).unwrap().notes().to_vec()
    };
    let told = |notes: &[SubjectNote]| notes.iter().any(|n| n.to_string().contains("another pose than the bind pose"));
    assert!(told(&notes([0.0, 5.0, 0.0])) && !told(&notes([0.0, 1.0, 0.0])));
}
