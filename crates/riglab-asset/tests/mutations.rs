//! Broken bytes end in an error or a rig, never in a panic, soon, and within memory that the file may ask for.
//!
//! Mutations come from a counter, so that a failure can be repeated from its number alone.

#[cfg(feature = "fbx")]
#[path = "common/ascii_fbx.rs"]
mod ascii_fbx;
mod common;
#[path = "common/peak.rs"]
mod peak;

use std::panic::catch_unwind;
use std::time::{Duration, Instant};

use common::Tiny;
use riglab_asset::export::{self, ExportOptions};
use riglab_asset::rigging::{Subject, SubjectOptions};
use riglab_asset::{Content, ImportOptions, Imported, Resample, Target, import_bytes};
use riglab_core::{Joint, Skeleton, SkinWeights};
use serde_json::{Value, json};

/// Mutations of each kind and seed.
const ROUNDS: u64 = 1500;

/// One file of a few kilobytes, in a debug build on a busy machine.
const LIMIT: Duration = Duration::from_secs(2);

/// Numbers that have broken readers before.
const NUMBERS: [&str; 14] = [
    "0",
    "1",
    "2",
    "3",
    "-1",
    "255",
    "65536",
    "4294967295",
    "4294967296",
    "18446744073709551608",
    "1e999",
    "1e38",
    "-0.0",
    "null",
];

/// Random numbers by position: SplitMix64 of seed and counter.
struct Numbers {
    seed: u64,
    counter: u64,
}

impl Numbers {
    fn below(&mut self, limit: usize) -> usize {
        self.counter += 1;
        let mut x = (self.seed << 20 ^ self.counter).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        x = (x ^ x >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        x = (x ^ x >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((x ^ x >> 31) % limit.max(1) as u64) as usize
    }
}

/// Seeds: the tiny rig in several forms, and the small hard files where they are.
fn seeds() -> Vec<(String, Vec<u8>)> {
    let tiny = Tiny::new();
    let sparse = Tiny::new().with_accessor(5121, "SCALAR", 1, &[2, 0, 0, 0]).with(
        "/accessors/0/sparse",
        json!({"count": 1, "indices": {"bufferView": 5, "componentType": 5121}, "values": {"bufferView": 0}}),
    );
    let data = {
        use base64::Engine;
        let uri = base64::engine::general_purpose::STANDARD.encode(&tiny.binary);
        let uri = format!("data:application/octet-stream;base64,{uri}");
        Tiny::new().with("/buffers/0/uri", json!(uri)).document.to_string().into_bytes()
    };
    let vrm = json!({"VRM": {"meta": {"licenseName": "CC_BY", "author": "A"}}});
    let rigid = Tiny::new()
        .with("/extensions", vrm)
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"mesh": 1, "matrix": [1, 0, 0, 0, 0, 2, 0, 0, 0, 0, 3, 0, 4, 5, 6, 1]}))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": 0}, "mode": 5}]}));
    let floats = |all: &[f32]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
    let moving = Tiny::new()
        .with_accessor(5126, "SCALAR", 2, &floats(&[0.0, 1.5]))
        .with_accessor(5126, "VEC4", 2, &floats(&[0.0, 0.0, 0.0, 1.0, 0.6, 0.0, 0.0, 0.8]))
        .with(
            "/animations",
            json!([{"name": "nod", "samplers": [{"input": 5, "output": 6, "interpolation": "LINEAR"}],
                    "channels": [{"sampler": 0, "target": {"node": 2, "path": "rotation"}}]}]),
        );
    let mut seeds = vec![
        ("moving.glb".to_owned(), moving.glb()),
        ("tiny.glb".to_owned(), tiny.glb()),
        ("sparse.glb".to_owned(), sparse.glb()),
        ("data.gltf".to_owned(), data),
        ("rigid.vrm".to_owned(), rigid.glb()),
    ];
    #[cfg(feature = "fbx")]
    {
        let turn = (1, "Lcl Rotation", "d|Z", &[(0.0, 0.0), (1.0, 90.0)][..]);
        let text = ascii_fbx::tiny(ascii_fbx::Ascii::new()).shape(10, 30, 2, [0.0, 10.0, 0.0]);
        let talk = (30, "DeformPercent", "d|DeformPercent", &[(0.0, 0.0), (1.0, 100.0)][..]);
        let text = text.motion("turn", Some([0.0, 1.0]), &[turn, talk]).bytes();
        let imported = import_bytes("tiny.fbx", &text, &ImportOptions::default()).unwrap();
        let binary = riglab_asset::glb_to_fbx(&riglab_asset::to_glb(&imported.into_asset().unwrap())).unwrap().bytes;
        seeds.extend([("text.fbx".to_owned(), text), ("binary.fbx".to_owned(), binary)]);
    }
    if let Some(folder) = common::data("RIGLAB_RIGS_HARD", "rigs_hard") {
        let names = [
            "ok_tube.glb",
            "ok_quantized.glb",
            "ok_strips_and_fans.glb",
            "warn_two_characters.glb",
            "reject_draco.glb",
            "reject_meshopt.glb",
            "warn_no_rig.obj",
        ];
        seeds.extend(names.map(|name| (name.to_owned(), std::fs::read(folder.join(name)).unwrap())));
    }
    seeds.extend(peers());
    seeds.extend(surfaces());
    seeds
}

/// A triangle and a quad in the formats of scans and prints.
fn surfaces() -> Vec<(String, Vec<u8>)> {
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 2\n\
             property list uchar int vertex_indices\nend_header\n"
        )
    };
    let corners = [[0u8, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]];
    let mut text = head("ascii");
    let (mut binary, mut solid) = (head("binary_big_endian").into_bytes(), String::from("solid a\n"));
    for [x, y, z] in corners {
        text += &format!("{x} {y} {z} 255 0 9\n");
        binary.extend([x, y, z].into_iter().flat_map(|x| f32::from(x).to_be_bytes()).chain([255, 0, 9]));
    }
    text += "4 0 1 2 3\n3 0 1 2\n";
    for face in [&[0i32, 1, 2, 3][..], &[0, 1, 2]] {
        binary.push(face.len() as u8);
        binary.extend(face.iter().flat_map(|v| v.to_be_bytes()));
    }
    let mut facets = [[0; 80].as_slice(), &2u32.to_le_bytes()].concat();
    for face in [[0, 1, 2], [0, 2, 3]] {
        let of = face.map(|v: usize| corners[v]);
        let vertices: String = of.iter().map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).collect();
        solid += &format!("facet normal 0 0 1\nouter loop\n{vertices}endloop\nendfacet\n");
        facets.extend([0, 0, 1].into_iter().chain(of.concat()).flat_map(|x| f32::from(x).to_le_bytes()));
        facets.extend([0, 0]);
    }
    solid += "endsolid a\n";
    vec![
        ("text.ply".to_owned(), text.into_bytes()),
        ("binary.ply".to_owned(), binary),
        ("text.stl".to_owned(), solid.into_bytes()),
        ("binary.stl".to_owned(), facets),
    ]
}

/// The tiny rig in the peers' formats, and their own samples where they are.
fn peers() -> Vec<(String, Vec<u8>)> {
    let tiny = import_bytes("tiny.glb", &Tiny::new().glb(), &ImportOptions::default()).unwrap().into_asset().unwrap();
    let dir = tempfile::tempdir().unwrap();
    let mut seeds = Vec::new();
    for target in Target::ALL.iter().copied().filter(|t| *t != Target::GLB) {
        let name = format!("{target}{}", target.suffix());
        let path = dir.path().join(&name);
        riglab_asset::write(std::slice::from_ref(&tiny), &path, target).unwrap();
        seeds.push((name, std::fs::read(path).unwrap()));
    }
    seeds.push(("skeleton.txt".to_owned(), b"0 hips 0 1 0 None\n1 tip 0 2 0 hips 0\n".to_vec()));
    if let Some(folder) = common::data("RIGLAB_GOLDEN", "golden") {
        let names = ["articulation_xl/row_scalars.npz", "unirig/tail_f16/raw_data.npz", "rignet/odd_rig.txt"];
        seeds.extend(names.map(|name| (name.to_owned(), std::fs::read(folder.join("formats").join(name)).unwrap())));
    }
    seeds
}

/// Members of an archive, in order.
fn members(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    use std::io::Read;
    let mut zip = zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap();
    let mut member = |at| {
        let mut file = zip.by_index(at).unwrap();
        let mut content = Vec::new();
        file.read_to_end(&mut content).unwrap();
        (file.name().to_owned(), content)
    };
    (0..zip_len(bytes)).map(&mut member).collect()
}

fn zip_len(bytes: &[u8]) -> usize {
    zip::ZipArchive::new(std::io::Cursor::new(bytes)).unwrap().len()
}

/// An archive of these members.
fn zipped(members: &[(String, Vec<u8>)]) -> Vec<u8> {
    use std::io::Write;
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    let stored = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    for (name, content) in members {
        zip.start_file(name.as_str(), stored).unwrap();
        zip.write_all(content).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

/// Imports, looks at everything, and gives whether a rig came out.
fn survives(what: &str, bytes: &[u8]) -> bool {
    let start = Instant::now();
    let work = || {
        // Of files of several assets the first, which asks for more than their number.
        let options = ImportOptions { item: Some(0), clips: Some(Resample::default()), ..ImportOptions::default() };
        let imported = import_bytes(what, bytes, &options);
        imported.map(|i| {
            let shown = i.inspect(true);
            assert!(shown.samples.iter().all(|s| s.position.iter().all(|x| x.is_finite())));
            written(what, bytes, &i);
            matches!(i.content, Content::Rigged(_))
        })
    };
    let (result, peak) = peak::of(|| catch_unwind(work));
    assert!(peak.is_fair(bytes.len()), "{what}: {peak:?} for a file of {}", bytes.len());
    if is_one_in_five(what) {
        let (anew, peak) = peak::of(|| catch_unwind(|| rigged_anew(what, bytes)));
        assert!(anew.is_ok(), "{what} cannot be rigged anew");
        assert!(peak.is_fair(bytes.len()), "{what}, rigged anew: {peak:?} for a file of {}", bytes.len());
    }
    assert!(start.elapsed() < LIMIT, "{what} took {:?}", start.elapsed());
    match result {
        Ok(Ok(rigged)) => rigged,
        Ok(Err(error)) => {
            let text = error.to_string();
            assert!(text.starts_with(what) && text.len() < 1000, "{text}");
            false
        }
        Err(_) => panic!("{what} made the importer panic"),
    }
}

/// What takes long is done to some, the same ones each time.
fn is_one_in_five(what: &str) -> bool {
    what.bytes().map(usize::from).sum::<usize>().is_multiple_of(5)
}

/// What was imported is written, or refused; what is written reads back.
fn written(what: &str, bytes: &[u8], imported: &Imported) {
    let bare = export::strip_bytes(what, bytes, None, &ImportOptions::default());
    let mut all = vec![bare];
    for rig in imported.rig().into_iter().flat_map(|rig| [rig.clone(), common::renamed(rig)]) {
        all.push(export::onto_bytes(what, bytes, None, imported, &rig, &ExportOptions::default()));
    }
    for exported in all {
        match exported {
            Ok(exported) => reads_back(what, &exported.bytes),
            Err(error) => assert!(error.to_string().starts_with(what)),
        }
    }
}

/// What was written can be read. The FBX that it becomes is written, too, and read or, as of bind matrices all but flat,
/// refused.
fn reads_back(what: &str, glb: &[u8]) {
    let back = import_bytes("back.glb", glb, &ImportOptions::default());
    assert!(back.is_ok(), "{what}: what was written: {}", back.unwrap_err());
    #[cfg(feature = "fbx")]
    if is_one_in_five(what) {
        let file = riglab_asset::glb_to_fbx(glb);
        assert!(file.is_ok(), "{what}: no FBX of what was written: {}", file.unwrap_err());
        let back = import_bytes("back.fbx", &file.unwrap().bytes, &ImportOptions::default());
        assert!(back.map_or_else(|error| error.to_string().starts_with("back.fbx"), |_| true), "{what}");
    }
}

/// A model gets a rig of one joint, or is refused.
fn rigged_anew(what: &str, bytes: &[u8]) {
    let Ok(subject) = Subject::from_bytes(what, bytes, None, &SubjectOptions::default()) else { return };
    let joint = Joint { name: "all".into(), parent: None, head: [0.0; 3] };
    let weights = vec![[(0, 1.0)]; subject.mesh().positions().len()];
    let rig = subject.rigged(Skeleton::new(vec![joint]).unwrap(), SkinWeights::normalized(weights).unwrap()).unwrap();
    match subject.attach(&rig, &ExportOptions::default()) {
        Ok(exported) => reads_back(what, &exported.bytes),
        Err(error) => assert!(error.to_string().starts_with(what)),
    }
}

#[test]
fn files_cut_anywhere_survive() {
    for (name, bytes) in seeds() {
        let step = (bytes.len() / 1000).max(1);
        for cut in (0..bytes.len()).step_by(step) {
            survives(&format!("cut at {cut} of {name}"), &bytes[..cut]);
            // The same with a header that tells the new length, so that the cut hits chunks.
            let mut mended = bytes[..cut].to_vec();
            if let Some(length) = mended.get_mut(8..12).filter(|_| bytes.starts_with(b"glTF")) {
                length.copy_from_slice(&(cut as u32).to_le_bytes());
                survives(&format!("mended after a cut at {cut} of {name}"), &mended);
            }
        }
    }
}

#[test]
fn files_with_changed_bytes_survive() {
    let mut rigs = 0;
    for (number, (name, bytes)) in (0u64..).zip(seeds()) {
        for round in 0..ROUNDS {
            let mut n = Numbers { seed: number << 32 | round, counter: 0 };
            let mut changed = bytes.clone();
            for _ in 0..1 + n.below(8) {
                let at = n.below(changed.len());
                changed[at] = match n.below(4) {
                    0 => changed[at] ^ 1 << n.below(8),
                    1 => [0, 0x7f, 0x80, 0xff][n.below(4)],
                    2 => b"[]{},:\"0-e"[n.below(10)],
                    _ => n.below(256) as u8,
                };
            }
            rigs += usize::from(survives(&format!("round {round} of {name}"), &changed));
        }
    }
    println!("{rigs} mutants still made a rig");
    assert!(rigs > 0);
}

/// Numbers of the text exchanged, chunk lengths kept right: this reaches the checks behind the parser.
#[test]
fn files_with_changed_numbers_survive() {
    let mut rigs = 0;
    for (number, (name, bytes)) in (0u64..).zip(seeds()) {
        let (json, binary) = match bytes.starts_with(b"glTF") {
            true => {
                let length = u32::from_le_bytes(bytes[12..16].try_into().unwrap()) as usize;
                (&bytes[20..20 + length], &bytes[20 + length + 8..])
            }
            false => (&bytes[..], &[][..]),
        };
        // Binary formats have no text.
        let Ok(text) = std::str::from_utf8(json) else { continue };
        for round in 0..ROUNDS {
            let mut n = Numbers { seed: number << 32 | round, counter: 1 << 16 };
            let mut changed = text.to_owned();
            for _ in 0..1 + n.below(3) {
                exchange_number(&mut changed, &mut n);
            }
            let changed =
                if binary.is_empty() { changed.into_bytes() } else { common::glb(changed.as_bytes(), binary) };
            rigs += usize::from(survives(&format!("number round {round} of {name}"), &changed));
        }
    }
    println!("{rigs} mutants still made a rig");
    assert!(rigs > 0);
}

/// A rig with all that a VRM says of a body, with what is hidden, and with a mesh on a joint.
fn body() -> Tiny {
    let bone = |node: usize| json!({"node": node});
    let follows = json!({"VRMC_node_constraint": {"constraint": {"roll": {"source": 1, "rollAxis": "X"}}}});
    let springs = json!({
        "colliders": [{"node": 3, "shape": {"sphere": {"offset": [0, 1, 0], "radius": 0.5}}}],
        "colliderGroups": [{"colliders": [0]}],
        "springs": [{"joints": [bone(2), bone(3)], "colliderGroups": [0], "center": 1}],
    });
    let vrm = json!({
        "humanoid": {"humanBones": {"hips": bone(1), "head": bone(2), "leftEye": bone(3)}},
        "lookAt": {"offsetFromHeadBone": [0, 0.1, 0]},
        "firstPerson": {"meshAnnotations": [{"node": 0, "type": "auto"}]},
    });
    Tiny::new()
        .with("/nodes/1/extensions", json!({"KHR_node_visibility": {"visible": false}}))
        .with("/nodes/2/extensions", follows)
        .with("/nodes/2/children", json!([3]))
        .with("/nodes/-", json!({"mesh": 1, "extensions": {}, "extras": {}}))
        .with("/meshes/-", json!({"primitives": [{"attributes": {"POSITION": 0}, "targets": [{"POSITION": 0}]}]}))
        .with("/scenes", json!([{"nodes": [0, 1]}]))
        .with("/extensions", json!({"VRMC_vrm": vrm, "VRMC_springBone": springs}))
        .with("/extensionsUsed", json!(["VRMC_vrm", "VRMC_springBone", "KHR_node_visibility"]))
}

/// The pointers to all values below one.
fn pointers(value: &Value, at: String, all: &mut Vec<String>) {
    match value {
        Value::Array(list) => list.iter().enumerate().for_each(|(n, own)| pointers(own, format!("{at}/{n}"), all)),
        Value::Object(members) => members.iter().for_each(|(key, own)| pointers(own, format!("{at}/{key}"), all)),
        _ => {}
    }
    all.push(at);
}

/// Objects where lists belong, and the other way round: an object's members in their order are what some readers take for it.
#[test]
fn files_with_structures_of_another_kind_survive() {
    let mut rigs = 0;
    for (name, tiny) in [("tiny.glb", Tiny::new()), ("body.vrm", body())] {
        assert!(survives(name, &tiny.glb()));
        let mut all = Vec::new();
        pointers(&tiny.document, String::new(), &mut all);
        for pointer in all {
            let own = tiny.document.pointer(&pointer).unwrap();
            let mut others = vec![json!([]), json!({}), json!("x"), json!([own]), json!({ "own": own })];
            others.extend(own.as_object().map(|members| members.values().cloned().collect()));
            for (round, other) in others.into_iter().enumerate() {
                let mut changed = tiny.clone();
                *changed.document.pointer_mut(&pointer).unwrap() = other;
                rigs += usize::from(survives(&format!("other {round} at {pointer} of {name}"), &changed.glb()));
            }
        }
    }
    // All that a view has, in its order.
    let view = json!([0, 0, 48, null, {}]);
    let listed = Tiny::new().with("/bufferViews/0", view);
    let said = import_bytes("listed.glb", &listed.glb(), &ImportOptions::default()).unwrap_err().to_string();
    assert!(said.contains("bufferViews[0]") && said.contains("expected an object"), "{said}");
    assert!(rigs > 0);
}

/// Corners of a byte each are the least that a triangle can take.
#[test]
fn polygons_of_many_corners_keep_within_what_their_file_may_ask_for() {
    let head = "ply\nformat binary_little_endian 1.0\nelement vertex 4\nproperty uchar x\nproperty uchar y\n\
        property uchar z\n";
    for (faces, corners) in [(1usize, 5_000_000u32), (1000, 5001), (70_000, 72)] {
        let list = format!("element face {faces}\nproperty list uint uchar vertex_indices\nend_header\n");
        let mut bytes = [head.as_bytes(), list.as_bytes(), &[0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1]].concat();
        for face in 0..faces {
            bytes.extend(corners.to_le_bytes());
            bytes.extend((0..corners).map(|k| (k as usize + face) as u8 % 4));
        }
        let (read, peak) = peak::of(|| import_bytes("a.ply", &bytes, &ImportOptions::default()));
        assert!(peak.is_fair(bytes.len()), "{faces} faces: {peak:?} for a file of {}", bytes.len());
        // Of all fans over four corners there are few unlike triangles.
        assert_eq!(read.unwrap().mesh().triangles().len(), if faces == 1 { 2 } else { 4 });
    }
}

/// Bytes of one member exchanged, sums of the archive kept right: this reaches arrays and pickles.
#[test]
fn archives_with_changed_members_survive() {
    let mut rigs = 0;
    let seeds = peers().into_iter().filter(|(name, _)| name.ends_with(".npz") || name.ends_with(".pt"));
    for (number, (name, bytes)) in (0u64..).zip(seeds) {
        let members = members(&bytes);
        for round in 0..ROUNDS {
            let mut n = Numbers { seed: number << 32 | round, counter: 1 << 17 };
            let mut changed = members.clone();
            let one = n.below(changed.len());
            // Large arrays are all data; what says what they are stands at their start, or is small.
            let content = &mut changed[one].1;
            let reach = if n.below(2) == 0 { content.len().min(200) } else { content.len() };
            for _ in 0..1 + n.below(4) {
                let at = n.below(reach);
                content[at] = match n.below(4) {
                    0 => content[at] ^ 1 << n.below(8),
                    1 => [0, 0x7f, 0x80, 0xff][n.below(4)],
                    2 => b"().,'<8]}NRbtuh"[n.below(15)],
                    _ => n.below(256) as u8,
                };
            }
            let (what, changed) = (format!("member round {round} of {name}"), zipped(&changed));
            rigs += usize::from(survives(&what, &changed));
            let options = ImportOptions { item: Some(0), ..ImportOptions::default() };
            let (_, peak) = peak::of(|| import_bytes(&what, &changed, &options));
            assert!(peak.is_lean(&name, changed.len()), "{what}: {peak:?} for a file of {}", changed.len());
        }
    }
    println!("{rigs} mutants still made a rig");
    assert!(rigs > 0);
}

/// Exchanges one run of digits outside of strings.
fn exchange_number(text: &mut String, n: &mut Numbers) {
    let mut runs = Vec::new();
    let (mut quoted, mut start) = (false, None);
    for (at, c) in text.char_indices() {
        quoted ^= c == '"';
        match (c.is_ascii_digit() && !quoted, start) {
            (true, None) => start = Some(at),
            (false, Some(from)) => {
                runs.push(from..at);
                start = None;
            }
            _ => {}
        }
    }
    if !runs.is_empty() {
        let run = runs.swap_remove(n.below(runs.len()));
        text.replace_range(run, NUMBERS[n.below(NUMBERS.len())]);
    }
}

/// What fuzzing found, each kept under what was wrong.
#[test]
fn files_that_once_did_not_survive() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/regressions");
    let files = common::files(&folder, &["glb", "gltf", "vrm", "obj", "ply", "stl", "fbx", "npz", "pt", "h5", "txt"]);
    assert!(!files.is_empty());
    for path in files {
        survives(&path.file_name().unwrap().to_string_lossy(), &std::fs::read(&path).unwrap());
    }
}

/// Reading plain arrays takes less than the rest may.
#[test]
fn peers_files_that_once_took_too_much_memory() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/regressions");
    let files = common::files(&folder, &["npz", "pt", "h5", "txt"]);
    assert!(!files.is_empty());
    for path in files {
        let (name, bytes) = (path.file_name().unwrap().to_string_lossy(), std::fs::read(&path).unwrap());
        let options = ImportOptions { item: Some(0), ..ImportOptions::default() };
        let (_, peak) = peak::of(|| import_bytes(&name, &bytes, &options));
        assert!(peak.is_lean(&name, bytes.len()), "{name}: {peak:?} for a file of {}", bytes.len());
    }
}
