//! FBX in and out: files as text for what a reader must get right, and the corpus for the way there and back.
#![cfg(feature = "fbx")]

#[path = "common/ascii_fbx.rs"]
mod ascii_fbx;
mod common;
#[path = "common/peak.rs"]
mod peak;

use ascii_fbx::{Ascii, Cluster, SIDES, TETRAHEDRON, moved, scaled_and_moved, tiny};
use riglab_asset::export::ExportOptions;
use riglab_asset::rigging::{Subject, SubjectNote, SubjectOptions, dressed};
use riglab_asset::{
    Character, Fault, ImportOptions, Imported, Resample, Warning, glb_to_fbx, import, import_bytes, to_glb,
};
use riglab_core::{Asset, Rig, Springs, Vec3, skin};

fn read(file: &Ascii) -> Result<Imported, Fault> {
    import_bytes("test.fbx", &file.bytes(), &ImportOptions::default()).map_err(|e| e.fault)
}

fn rig(file: &Ascii) -> (Rig, Vec<Warning>) {
    let imported = read(file).unwrap();
    (imported.rig().unwrap().clone(), imported.warnings().to_vec())
}

/// Joints by name, parent and head.
fn joints(rig: &Rig) -> Vec<(&str, Option<&str>, Vec3)> {
    let s = rig.skeleton();
    s.ids().map(|j| (s.name(j), s.parent(j).map(|p| s.name(p)), s.head(j))).collect()
}

fn assert_near(found: &[Vec3], wanted: &[Vec3]) {
    assert_eq!(found.len(), wanted.len());
    let far = |(a, b): (&Vec3, &Vec3)| (0..3).any(|k| (a[k] - b[k]).abs() > 1e-6);
    assert!(!found.iter().zip(wanted).any(far), "{found:?}, not {wanted:?}");
}

const CORNERS: [Vec3; 4] = [[0.0; 3], [0.1, 0.0, 0.0], [0.0, 0.25, 0.0], [0.0, 0.0, 0.1]];

/// Six times the volume, which is above 0 where sides face outwards.
fn volume(rig: &Rig) -> f32 {
    let p = rig.mesh().positions();
    let term = |[a, b, c]: [Vec3; 3]| {
        a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) + a[2] * (b[0] * c[1] - b[1] * c[0])
    };
    rig.mesh().triangles().iter().map(|t| term(t.map(|v| p[v as usize]))).sum()
}

#[test]
fn a_file_in_centimetres_comes_out_in_metres() {
    let (rig, warnings) = rig(&tiny(Ascii::new()));
    assert_eq!(warnings, []);
    assert_eq!(joints(&rig), [("hips", None, [0.0, 0.1, 0.0]), ("tip", Some("hips"), [0.0, 0.2, 0.0])]);
    assert_near(rig.mesh().positions(), &CORNERS);
    let row: Vec<f32> = rig.weights().row(3).map(|(_, w)| w).collect();
    assert_eq!(row, [0.25, 0.75]);
}

/// The hips turn by a quarter about z within a second, and rise within the next; the tip does nothing.
fn turning(file: Ascii) -> Ascii {
    let turn = (1, "Lcl Rotation", "d|Z", &[(0.0, 0.0), (1.0, 90.0)][..]);
    let rise = (1, "Lcl Translation", "d|Y", &[(1.0, 10.0), (2.0, 30.0)][..]);
    // What moves no joint is no motion of the rig.
    let other = (10, "Lcl Translation", "d|Y", &[(0.0, 0.0), (9.0, 10.0)][..]);
    tiny(file).motion("turn", Some([0.0, 2.0]), &[turn, rise, other]).motion("mesh", None, &[other])
}

/// Where vertices stand in a frame.
fn posed(imported: &Imported, frame: usize) -> Vec<Vec3> {
    skin(imported.rig().unwrap(), &imported.clips[0].frame(frame)).unwrap()
}

fn with_clips(name: &str, bytes: &[u8], rate: f32) -> Imported {
    let clips = Some(Resample { rate, ..Resample::default() });
    import_bytes(name, bytes, &ImportOptions { clips, ..ImportOptions::default() }).unwrap()
}

#[test]
fn motions_are_read_where_they_are_asked_for() {
    let bytes = turning(Ascii::new()).bytes();
    assert!(import_bytes("a.fbx", &bytes, &ImportOptions::default()).unwrap().clips.is_empty());
    let imported = with_clips("a.fbx", &bytes, 4.0);
    assert_eq!(imported.warnings(), []);
    let [clip] = &imported.clips[..] else { panic!("{:?}", imported.clips) };
    assert_eq!((clip.name(), clip.rate(), clip.joints(), clip.frames()), ("turn", 4.0, 2, 9));
    assert_near(&posed(&imported, 0), &CORNERS);
    // The corner that the tip holds goes round the hips, which stand at .1.
    let half = 0.5f32.sqrt();
    assert_near(&posed(&imported, 2)[2..3], &[[-0.15 * half, 0.1 + 0.15 * half, 0.0]]);
    assert_near(&posed(&imported, 4)[2..3], &[[-0.15, 0.1, 0.0]]);
    assert_near(&posed(&imported, 8)[2..3], &[[-0.15, 0.3, 0.0]]);
    // In metres, z up, what goes up goes up, too: the file's x, y and z are x, -z and y.
    let other = with_clips("a.fbx", &turning(Ascii::with_space([(2, 1), (1, -1), (0, 1)], 100.0)).bytes(), 4.0);
    assert_near(&posed(&other, 8)[2..3], &[[-15.0, 0.0, -30.0]]);
    // A part of the keys is the motion, where the file says so.
    let part = Ascii::new();
    let part = tiny(part).motion("", Some([1.0, 1.5]), &[(1, "Lcl Translation", "d|Y", &[(0.0, 10.0), (2.0, 30.0)])]);
    let part = with_clips("a.fbx", &part.bytes(), 4.0);
    assert_eq!((part.clips[0].name(), part.clips[0].frames()), ("animation 0", 3));
    assert_near(&posed(&part, 2)[2..3], &[[0.0, 0.4, 0.0]]);
}

#[test]
fn nodes_that_inherit_scales_otherwise_move_alike() {
    // The tip does not grow with the hips, which are twice as large in the end.
    let file = |inherit: u32| {
        let more = format!("P: \"InheritType\", \"enum\", \"\", \"\",{inherit}");
        let grow = (1, "Lcl Scaling", "d|Y", &[(0.0, 1.0), (1.0, 2.0)][..]);
        let turn = (1, "Lcl Rotation", "d|Z", &[(0.0, 0.0), (1.0, 90.0)][..]);
        let [hips, tip] = [[0.0, 10.0, 0.0], [0.0, 20.0, 0.0]];
        let link =
            |bone, weights, at: [f64; 3]| Cluster { bone, weights, transform: moved(at.map(|x| -x)), link: moved(at) };
        Ascii::new()
            .bone(1, "hips", 0, hips)
            .node(2, "tip", "LimbNode", 1, hips, &more)
            .mesh(10, 0, &TETRAHEDRON, &SIDES, "")
            .skin(10, &[link(1, &[(0, 1.0), (1, 1.0), (3, 1.0)], hips), link(2, &[(2, 1.0)], tip)])
            .motion("grow", None, &[grow, turn])
    };
    let top = |inherit| posed(&with_clips("a.fbx", &file(inherit).bytes(), 4.0), 4)[2];
    // The corner stands .05 above the tip, which stands .1 above the hips and is .2 from them then.
    assert_near(&[top(1), top(2)], &[[-0.3, 0.1, 0.0], [-0.25, 0.1, 0.0]]);
}

#[test]
fn motions_beyond_measure_are_cut_or_left_out() {
    let long = |end: f64| {
        let keys = [(0.0, 10.0), (end, 30.0)];
        with_clips(
            "a.fbx",
            &tiny(Ascii::new()).motion("long", None, &[(1, "Lcl Translation", "d|Y", &keys)]).bytes(),
            30.0,
        )
    };
    let cut = long(3600.0);
    assert_eq!(cut.clips[0].frames(), Resample::default().frames);
    assert!(matches!(cut.warnings(), [Warning::ClipsCut { .. }]), "{:?}", cut.warnings());
    let endless = Ascii::new();
    let keys = [(0.0, 10.0), (1e8, 30.0)];
    let endless = tiny(endless).motion("endless", None, &[(1, "Lcl Translation", "d|Y", &keys)]).bytes();
    let all = ImportOptions { clips: Some(Resample { rate: 1000.0, frames: usize::MAX }), ..ImportOptions::default() };
    let imported = import_bytes("a.fbx", &endless, &all).unwrap();
    assert!(imported.clips.is_empty());
    assert!(matches!(imported.warnings(), [Warning::ClipsLeftOut { .. }]), "{:?}", imported.warnings());
}

#[test]
fn a_motion_that_is_left_out_takes_no_room_from_others() {
    // What inherits scales otherwise is posed with the whole scene, which is too much of the first motion.
    let hips = [0.0, 10.0, 0.0];
    let link = |bone| Cluster { bone, weights: &[(0, 1.0)], transform: moved(hips.map(|x| -x)), link: moved(hips) };
    let keys = |end: f64| [(0.0, 10.0), (end, 30.0)];
    let (long, short) = (keys(1048.0), keys(1.0));
    let [long, short] = [&long, &short].map(|keys| (1, "Lcl Translation", "d|Y", &keys[..]));
    let file = Ascii::new()
        .bone(1, "hips", 0, hips)
        .node(2, "tip", "LimbNode", 1, hips, "P: \"InheritType\", \"enum\", \"\", \"\",2")
        .mesh(10, 0, &TETRAHEDRON, &SIDES, "")
        .skin(10, &[link(1), link(2)])
        .motion("long", None, &[long])
        .motion("short", None, &[short]);
    let all = ImportOptions { clips: Some(Resample { rate: 1000.0, frames: usize::MAX }), ..ImportOptions::default() };
    let imported = import_bytes("a.fbx", &file.bytes(), &all).unwrap();
    let told = imported.warnings().iter().any(|told| matches!(told, Warning::ClipsLeftOut { .. }));
    let clips: Vec<_> = imported.clips.iter().map(|clip| (clip.name(), clip.frames())).collect();
    assert_eq!((clips, told), (vec![("short", 1001)], true));
}

#[test]
fn motions_of_parts_that_hang_on_joints_are_told_to_be_lost() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.fbx");
    let turn = (1, "Lcl Rotation", "d|Z", &[(0.0, 0.0), (1.0, 90.0)][..]);
    let told = |to: f64| {
        let keys = [(0.0, 0.0), (1.0, to)];
        let own = (20, "Lcl Translation", "d|Y", &keys[..]);
        let file = tiny(Ascii::new()).mesh(20, 2, &TETRAHEDRON, &SIDES, "").motion("go", None, &[turn, own]);
        std::fs::write(&path, file.bytes()).unwrap();
        dressed(&path, &ImportOptions::default(), &Springs::default(), &ExportOptions::default()).unwrap().1
    };
    assert_eq!(told(300.0), [SubjectNote::ThingsLeft(vec!["the object motions of 1 animation".into()])]);
    // Exporters write curves of what is still, too.
    assert_eq!(told(0.0), []);
}

#[test]
fn as_glb_it_keeps_looks_rig_and_motions() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.fbx");
    let free = turning(Ascii::new()).mesh(20, 0, &TETRAHEDRON, &SIDES, "");
    let bytes = free.bytes();
    std::fs::write(&path, &bytes).unwrap();
    let (exported, notes) =
        dressed(&path, &ImportOptions::default(), &Springs::default(), &ExportOptions::default()).unwrap();
    // Of the mesh, which moves alone.
    assert_eq!(notes, [SubjectNote::ThingsLeft(vec!["1 animation".into()])]);
    let (fbx, glb) = (with_clips("a.fbx", &bytes, 30.0), with_clips("a.glb", &exported.bytes, 30.0));
    let [before, after] = [&fbx, &glb].map(|of| of.rig().unwrap());
    assert_eq!(joints(before), joints(after));
    // The free mesh is none of the rig's.
    let count = after.mesh().positions().len();
    assert_eq!((before.mesh().triangles().len(), after.mesh().triangles().len()), (4, 4));
    let row = |rig: &Rig, v: usize| rig.weights().row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
    let twin = |v: usize| before.mesh().positions().iter().position(|p| *p == after.mesh().positions()[v]).unwrap();
    assert!((0..count).all(|v| row(after, v) == row(before, twin(v))));
    let names = glb.clips.iter().map(riglab_core::Clip::name).collect::<Vec<_>>();
    assert_eq!((names, glb.clips[0].frames()), (vec!["turn"], 61));
    for frame in 0..61 {
        let (found, wanted) = (posed(&glb, frame), posed(&fbx, frame));
        assert_near(&found, &(0..count).map(|v| wanted[twin(v)]).collect::<Vec<_>>());
    }
}

#[test]
fn groups_and_sockets_stay_and_what_does_not_is_told() {
    let file = tiny(Ascii::new())
        .node(5, "group", "Null", 0, [10.0, 0.0, 0.0], "")
        .mesh(20, 5, &TETRAHEDRON, &SIDES, "")
        .node(6, "socket", "Null", 5, [0.0, 10.0, 0.0], "")
        .node(7, "tip of it", "Null", 6, [0.0, 5.0, 0.0], "")
        .node(8, "grip", "Null", 2, [0.0, 1.0, 0.0], "")
        .node(9, "below", "Null", 20, [0.0, 1.0, 0.0], "")
        .node(12, "view", "Camera", 0, [0.0; 3], "")
        .node(13, "sun", "Light", 0, [0.0; 3], "");
    let subject = Subject::from_bytes("a.fbx", &file.bytes(), None, &SubjectOptions::default()).unwrap();
    let things = ["1 camera", "1 light", "1 empty node below a joint", "1 node's place below a mesh"];
    let told = SubjectNote::ThingsLeft(things.map(String::from).to_vec());
    assert!(subject.notes().contains(&told), "{:?}", subject.notes());

    let joint = riglab_core::Joint { name: "new".into(), parent: None, head: [0.0; 3] };
    let skeleton = riglab_core::Skeleton::new(vec![joint]).unwrap();
    let rows = subject.mesh().positions().iter().map(|_| [(0u16, 1.0)]);
    let rig = subject.rigged(skeleton, riglab_core::SkinWeights::normalized(rows).unwrap()).unwrap();
    let glb = gltf(&subject.attach(&rig, &ExportOptions::default()).unwrap().bytes);
    let nodes = glb["nodes"].as_array().unwrap();
    let named = |name: &str| nodes.iter().position(|node| node["name"] == name).unwrap();
    let [group, socket] = ["group", "socket"].map(|name| &nodes[named(name)]);
    // Meshes are in the scene's space, so what holds them moves nothing.
    assert!(group.get("translation").is_none(), "{group}");
    assert_eq!(group["children"], serde_json::json!([named("mesh20"), named("below"), named("socket")]));
    assert_eq!(socket["children"], serde_json::json!([named("tip of it")]));
    let at =
        |node: &serde_json::Value| -> Vec3 { std::array::from_fn(|k| node["translation"][k].as_f64().unwrap() as f32) };
    assert_near(&[at(socket), at(&nodes[named("tip of it")])], &[[0.1, 0.1, 0.0], [0.0, 0.05, 0.0]]);
}

#[test]
fn as_glb_motions_of_blend_shapes_go_with_those_of_joints() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.fbx");
    let turn = (1, "Lcl Rotation", "d|Z", &[(1.0, 0.0), (2.0, 90.0)][..]);
    let talk = (30, "DeformPercent", "d|DeformPercent", &[(1.5, 0.0), (2.5, 100.0)][..]);
    // A mesh that hangs on no joint comes before the one that does, and its blend shape moves, too.
    let other = (31, "DeformPercent", "d|DeformPercent", &[(0.0, 0.0), (1.0, 100.0)][..]);
    let file = Ascii::new().mesh(40, 0, &TETRAHEDRON, &SIDES, "").shape(40, 31, 0, [1.0, 0.0, 0.0]);
    let file = tiny(file).shape(10, 30, 2, [0.0, 10.0, 0.0]);
    // Open and shut before the joints begin.
    let early = (30, "DeformPercent", "d|DeformPercent", &[(0.0, 0.0), (0.5, 100.0), (1.0, 0.0)][..]);
    let file = file.motion("turn", None, &[turn, talk, other]).motion("early", None, &[turn, early]);
    let file = file.motion("wink", None, &[talk]).motion("wave", None, &[turn]);
    std::fs::write(&path, file.bytes()).unwrap();
    let (exported, notes) =
        dressed(&path, &ImportOptions::default(), &Springs::default(), &ExportOptions::default()).unwrap();
    assert_eq!(notes, []);
    let glb = gltf(&exported.bytes);
    let animations = glb["animations"].as_array().unwrap();
    let names: Vec<&str> = animations.iter().map(|own| own["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["turn", "early", "wave", "wink"]);
    let of_weights = |own: &serde_json::Value| {
        let channels = own["channels"].as_array().unwrap().iter();
        let found: Vec<_> = channels.filter(|channel| channel["target"]["path"] == "weights").cloned().collect();
        found.first().map(|first| {
            let sampler = &own["samplers"][first["sampler"].as_u64().unwrap() as usize];
            let accessor = |key: &str| &glb["accessors"][sampler[key].as_u64().unwrap() as usize];
            let node = &glb["nodes"][first["target"]["node"].as_u64().unwrap() as usize];
            (
                found.len(),
                node["name"].clone(),
                accessor("output")["count"].clone(),
                accessor("input")["max"][0].clone(),
            )
        })
    };
    // All of an animation begins with its first key: the other mesh moves from 0 on, the joints from 1, and the mouth is open at
    // 2.5. By itself that begins at 1.5. A file that says none has 24 frames a second.
    let [turn, early, wave, wink] = [0, 1, 2, 3].map(|n| of_weights(&animations[n]));
    assert_eq!(turn, Some((1, "mesh10".into(), 61.into(), 2.5.into())));
    assert_eq!(early, Some((1, "mesh10".into(), 25.into(), 1.0.into())));
    assert_eq!((wave, wink), (None, Some((1, "mesh10".into(), 25.into(), 1.0.into()))));
    let clips = with_clips("a.glb", &exported.bytes, 30.0);
    assert_eq!(
        clips.clips.iter().map(|clip| (clip.name(), clip.frames())).collect::<Vec<_>>(),
        [("turn", 61), ("early", 61), ("wave", 31)]
    );
    // Joints stand still until they move, and go where they do without.
    let tops = [0, 30, 60].map(|frame| skin(clips.rig().unwrap(), &clips.clips[1].frame(frame)).unwrap());
    let alone = [0, 30].map(|frame| skin(clips.rig().unwrap(), &clips.clips[2].frame(frame)).unwrap());
    assert_near(&tops.concat(), &[&alone[0][..], &alone[0], &alone[1]].concat());
}

#[test]
fn of_animations_called_the_same_each_keeps_its_own_shapes() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.fbx");
    let turn = (1, "Lcl Rotation", "d|Z", &[(0.0, 0.0), (1.0, 90.0)][..]);
    let talk = |to| [(0.0, 0.0), (to, 100.0)];
    let [short, long] = [talk(1.0), talk(2.0)];
    let talks = [&short, &long].map(|keys| (30, "DeformPercent", "d|DeformPercent", &keys[..]));
    let file = tiny(Ascii::new()).shape(10, 30, 2, [0.0, 10.0, 0.0]);
    let file = file.motion("Take", None, &[turn, talks[0]]).motion("Take", None, &[turn, talks[1]]);
    std::fs::write(&path, file.bytes()).unwrap();
    let (exported, _) =
        dressed(&path, &ImportOptions::default(), &Springs::default(), &ExportOptions::default()).unwrap();
    let glb = gltf(&exported.bytes);
    let counts: Vec<usize> = glb["animations"]
        .as_array()
        .unwrap()
        .iter()
        .map(|own| {
            let channels = own["channels"].as_array().unwrap().iter();
            channels.filter(|channel| channel["target"]["path"] == "weights").count()
        })
        .collect();
    assert_eq!(counts, [1, 1]);
}

/// The document of a GLB.
fn gltf(glb: &[u8]) -> serde_json::Value {
    let length = u32::from_le_bytes(glb[12..16].try_into().unwrap()) as usize;
    serde_json::from_slice(&glb[20..20 + length]).unwrap()
}

#[test]
fn other_axes_and_units_are_undone() {
    // Z up, looking along y, in metres: what was (x, y, z) is (x, z, -y).
    let (turned, _) = rig(&tiny(Ascii::with_space([(2, 1), (1, -1), (0, 1)], 100.0)));
    assert_near(turned.skeleton().heads(), &[[0.0, 0.0, -10.0], [0.0, 0.0, -20.0]]);
    assert_near(&turned.mesh().positions()[3..], &[[0.0, 10.0, 0.0]]);
    assert!(volume(&turned) > 0.0);
    // Left-handed: mirrored, and the sides turned over so that they still face outwards.
    let (mirrored, _) = rig(&tiny(Ascii::with_space([(1, 1), (2, -1), (0, 1)], 1.0)));
    assert_near(&mirrored.mesh().positions()[3..], &[[0.0, 0.0, -0.1]]);
    assert!(volume(&mirrored) > 0.0);
    // Axes that are no space, and a unit that is none, are left out.
    let (odd, _) = rig(&tiny(Ascii::with_space([(1, 1), (1, 1), (0, 1)], 1.0)));
    assert_near(odd.mesh().positions(), &CORNERS);
}

#[test]
fn rest_is_where_the_skin_was_bound() {
    // The bones stand elsewhere now, under a scaled and moved empty.
    let scaled = "P: \"Lcl Scaling\", \"Lcl Scaling\", \"\", \"A\",3,3,3";
    let clusters = |place: [f64; 3]| {
        [(1, 10.0), (2, 20.0)].map(|(bone, y)| Cluster {
            bone,
            weights: if bone == 1 { &[(0, 1.0), (1, 1.0)] } else { &[(2, 1.0), (3, 1.0)] },
            transform: scaled_and_moved(0.5, [0.0, -0.5 * y, 0.0]),
            link: scaled_and_moved(2.0, [place[0], place[1] + y, place[2]]),
        })
    };
    let file = |place| {
        Ascii::new()
            .node(5, "Armature", "Null", 0, [7.0, 0.0, 0.0], scaled)
            .bone(1, "hips", 5, [0.0, 10.0, 0.0])
            .bone(2, "tip", 1, [0.0, 30.0, 0.0])
            .mesh(10, 0, &TETRAHEDRON, &SIDES, "")
            .skin(10, &clusters(place))
    };
    let (rig, warnings) = rig(&file([0.0; 3]));
    assert!(matches!(warnings[..], [Warning::RestIsNotBind { .. }]), "{warnings:?}");
    assert_near(rig.skeleton().heads(), &[[0.0, 0.1, 0.0], [0.0, 0.2, 0.0]]);
    assert_near(rig.mesh().positions(), &CORNERS);
}

#[test]
fn bind_matrices_that_contradict_each_other_do_not_bend_the_mesh() {
    let file = Ascii::new()
        .bone(1, "hips", 0, [0.0, 10.0, 0.0])
        .bone(2, "tip", 1, [0.0, 10.0, 0.0])
        .mesh(10, 0, &TETRAHEDRON, &SIDES, "")
        .skin(
            10,
            &[
                Cluster {
                    bone: 1,
                    weights: &[(0, 1.0), (1, 1.0)],
                    transform: moved([0.0, -10.0, 0.0]),
                    link: moved([0.0, 10.0, 0.0]),
                },
                // Bound at 20, says that it was at 50.
                Cluster {
                    bone: 2,
                    weights: &[(2, 1.0), (3, 1.0)],
                    transform: moved([0.0, -20.0, 0.0]),
                    link: moved([0.0, 50.0, 0.0]),
                },
            ],
        );
    let (rig, warnings) = rig(&file);
    assert!(matches!(warnings[..], [Warning::Bent { .. }]), "{warnings:?}");
    assert_near(rig.skeleton().heads(), &[[0.0, 0.1, 0.0], [0.0, 0.2, 0.0]]);
    assert_near(rig.mesh().positions(), &CORNERS);
}

#[test]
fn bones_above_joints_are_joints_and_ends_are_not() {
    let file = Ascii::new()
        .node(5, "Armature", "Null", 0, [0.0; 3], "")
        .bone(1, "root", 5, [0.0, 0.0, 0.0])
        .bone(2, "hips", 1, [0.0, 10.0, 0.0])
        .bone(3, "hips", 2, [0.0, 10.0, 0.0])
        .bone(4, "end", 3, [0.0, 10.0, 0.0])
        .mesh(10, 0, &TETRAHEDRON, &SIDES, "")
        .skin(
            10,
            &[Cluster {
                bone: 3,
                weights: &[(0, 1.0), (1, 1.0), (2, 1.0), (3, 1.0)],
                // Bound a step to the side of where the bones stand: those without cluster go with it.
                transform: moved([0.0, -20.0, 0.0]),
                link: moved([100.0, 20.0, 0.0]),
            }],
        );
    let (rig, warnings) = rig(&file);
    let wanted = [
        ("root", None, [1.0, 0.0, 0.0]),
        ("hips", Some("root"), [1.0, 0.1, 0.0]),
        ("hips.001", Some("hips"), [1.0, 0.2, 0.0]),
    ];
    assert_eq!(joints(&rig), wanted);
    assert!(
        matches!(warnings[..], [Warning::RestIsNotBind { .. }, Warning::Renamed { joints: 1, .. }]),
        "{warnings:?}"
    );
}

#[test]
fn unskinned_meshes_hang_on_bones() {
    // A geometric translation moves the mesh, not what hangs below its node.
    let geometric = "P: \"GeometricTranslation\", \"Vector3D\", \"Vector\", \"\",0,0,5";
    let file = |parent| tiny(Ascii::new()).mesh(20, parent, &TETRAHEDRON, &SIDES, geometric);
    let (held, warnings) = rig(&file(2));
    assert!(matches!(&warnings[..], [Warning::RigidParts { joints, .. }] if joints == &["tip"]), "{warnings:?}");
    assert_near(&held.mesh().positions()[4..5], &[[0.0, 0.2, 0.05]]);
    let (free, warnings) = rig(&file(0));
    assert!(matches!(warnings[..], [Warning::LeftOut { .. }]), "{warnings:?}");
    assert_eq!(free.mesh().positions().len(), 4);
    // Without any skin: bones that hold meshes are the skeleton.
    let file = Ascii::new()
        .bone(1, "hips", 0, [0.0, 10.0, 0.0])
        .bone(2, "tip", 1, [0.0, 10.0, 0.0])
        .bone(3, "end", 2, [0.0, 10.0, 0.0])
        .mesh(20, 2, &TETRAHEDRON, &SIDES, "");
    let (robot, _) = rig(&file);
    assert_eq!(joints(&robot), [("hips", None, [0.0, 0.1, 0.0]), ("tip", Some("hips"), [0.0, 0.2, 0.0])]);
    // And without bones a mesh is a mesh.
    let bare = read(&Ascii::new().mesh(20, 0, &TETRAHEDRON, &SIDES, "")).unwrap();
    assert!(bare.rig().is_none());
    assert_near(bare.mesh().positions(), &CORNERS);
}

#[test]
fn several_characters_are_told_apart() {
    // The second stands a metre aside, bound there.
    let (hips, tip) = ([100.0, 10.0, 0.0], [100.0, 20.0, 0.0]);
    let cluster = |bone, head: [f64; 3], weights| Cluster {
        bone,
        weights,
        transform: moved([0.0, -head[1], 0.0]),
        link: moved(head),
    };
    let file = tiny(Ascii::new())
        .bone(3, "hips", 0, hips)
        .bone(4, "tip", 3, [0.0, 10.0, 0.0])
        .mesh(20, 0, &TETRAHEDRON, &SIDES, "")
        .skin(20, &[cluster(3, hips, &[(0, 1.0), (1, 1.0)]), cluster(4, tip, &[(2, 1.0), (3, 1.0)])]);
    let all = read(&file).unwrap();
    assert_eq!(all.reading.joints.iter().map(|j| j.skeleton).collect::<Vec<_>>(), [0, 0, 1, 1]);
    assert!(all.warnings().iter().any(|w| matches!(w, Warning::SeparateSkeletons { skeletons: 2, .. })));
    let options = ImportOptions { character: Some(Character::Number(1)), ..ImportOptions::default() };
    let second = import_bytes("test.fbx", &file.bytes(), &options).unwrap();
    let rig = second.rig().unwrap();
    assert_near(rig.skeleton().heads(), &[[1.0, 0.1, 0.0], [1.0, 0.2, 0.0]]);
    assert_near(rig.mesh().positions(), &CORNERS.map(|[x, y, z]| [x + 1.0, y, z]));
}

#[test]
fn polygons_become_triangles_over_their_control_points() {
    let points = [[0.0; 3], [9.0; 3], [10.0, 0.0, 0.0], [10.0, 10.0, 0.0], [0.0, 10.0, 0.0], [5.0, 20.0, 0.0]];
    // A quad, a line, and a pentagon with a corner that points inwards; vertex 1 is in none.
    let file = Ascii::new().mesh(20, 0, &points, &[&[0, 2, 3, 4], &[0, 2], &[0, 2, 3, 5, 4]], "");
    let imported = read(&file).unwrap();
    assert_eq!(imported.reading.vertex_sets[0].numbers, [0, 2, 3, 4, 5]);
    assert_eq!(imported.reading.parts[0].stored, 2 + 3);
    // A polygon beyond any use comes soon, too.
    let round: Vec<[f64; 3]> = (0..20_000).map(|i| [f64::from(i).sin(), f64::from(i % 7), f64::from(i)]).collect();
    let corners: Vec<i32> = (0..20_000).collect();
    let imported = read(&Ascii::new().mesh(20, 0, &round, &[&corners], "")).unwrap();
    assert_eq!(imported.reading.parts[0].stored, 20_000 - 2);
}

#[test]
fn any_number_of_influences_up_to_a_limit() {
    let count = |bones: u32| {
        let mut file = Ascii::new().mesh(10_000, 0, &TETRAHEDRON, &SIDES, "");
        let mut clusters = Vec::new();
        for bone in 1..=bones {
            file = file.bone(bone, &format!("b{bone}"), bone - 1, [0.0, 1.0, 0.0]);
            let y = f64::from(bone);
            let (transform, link) = (moved([0.0, -y, 0.0]), moved([0.0, y, 0.0]));
            clusters.push(Cluster { bone, weights: &[(0, 0.125), (1, 1.0), (2, 1.0), (3, 1.0)], transform, link });
        }
        read(&file.skin(10_000, &clusters))
    };
    let eight = count(8).unwrap();
    assert_eq!(eight.rig().unwrap().weights().row(0).count(), 8);
    assert!(matches!(count(300).unwrap_err(), Fault::TooLarge { count: 300, limit: 256, .. }));
}

#[test]
fn what_makes_no_rig_is_told() {
    let reason = |file: &Ascii| match read(file).unwrap_err() {
        Fault::Fbx(reason) => reason,
        other => panic!("{other:?}"),
    };
    let text = reason(&Ascii::new().mesh(20, 0, &TETRAHEDRON, &[&[0, 1, 2], &[0, 1, 9]], ""));
    assert!(text.contains("out of range"), "{text}");
    let skinned = |transform, weights| {
        let cluster = Cluster { bone: 1, weights, transform, link: moved([0.0; 3]) };
        Ascii::new().bone(1, "hips", 0, [0.0; 3]).mesh(10, 0, &TETRAHEDRON, &SIDES, "").skin(10, &[cluster])
    };
    let text = reason(&skinned(scaled_and_moved(0.0, [0.0, 1.0, 0.0]), &[(0, 1.0)]));
    assert!(text.contains("singular"), "{text}");
    // What f64 or f32 cannot hold.
    let with = |file: &Ascii, from: &str, to: &str| {
        let text = String::from_utf8(file.bytes()).unwrap().replace(from, to);
        import_bytes("test.fbx", text.as_bytes(), &ImportOptions::default()).unwrap_err().fault
    };
    let fault = with(&skinned(moved([0.0; 3]), &[(0, 77.0)]), "77", "1e999").to_string();
    assert!(fault.contains("weight of vertex 0 is not finite"), "{fault}");
    let far = with(&Ascii::new().mesh(20, 0, &TETRAHEDRON, &SIDES, ""), "25", "1e60");
    assert!(matches!(far, Fault::VertexNotFinite { vertex: 2, .. }));
    let binary = to_fbx(&rig(&tiny(Ascii::new())).0);
    let cut = import_bytes("test.fbx", &binary[..binary.len() / 2], &ImportOptions::default());
    assert!(matches!(cut.unwrap_err().fault, Fault::Fbx(_)));
    assert_eq!(read(&Ascii::new()).unwrap_err(), Fault::NoMesh);
}

/// Geometry and tree to the bit, heads but for products of doubles, which show where one is all but 0, and weights but for
/// another division by their sum.
fn assert_same(name: &str, back: &Rig, rig: &Rig) {
    assert_eq!(back.mesh(), rig.mesh(), "{name}");
    let (found, wanted) = (back.skeleton(), rig.skeleton());
    assert!(found.names().eq(wanted.names()), "{name}");
    assert!(found.ids().all(|joint| found.parent(joint) == wanted.parent(joint)), "{name}");
    let size = f64::from(rig.bounds().diagonal());
    let (found, wanted) = (found.heads().as_flattened(), wanted.heads().as_flattened());
    let off = found.iter().zip(wanted).map(|(a, b)| (f64::from(*a) - f64::from(*b)).abs()).fold(0.0, f64::max);
    assert!(off <= 1e-12 * size, "{name}: {off} of {size}");
    assert_eq!(back.weights().joints(), rig.weights().joints(), "{name}");
    let apart = back.weights().weights().iter().zip(rig.weights().weights()).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) <= 1e-6, "{name}");
}

/// A rig alone as FBX.
fn to_fbx(rig: &Rig) -> Vec<u8> {
    let (clips, provenance) = Default::default();
    let asset = Asset { name: "rig".into(), rig: rig.clone(), clips, provenance };
    glb_to_fbx(&to_glb(&asset)).unwrap().bytes
}

fn there_and_back(rig: &Rig) -> Rig {
    let bytes = to_fbx(rig);
    let back = import_bytes("back.fbx", &bytes, &ImportOptions::default()).unwrap();
    back.rig().unwrap().clone()
}

#[test]
fn what_is_written_is_read_back() {
    let (rig, _) = rig(&tiny(Ascii::new()));
    assert_same("tiny", &there_and_back(&rig), &rig);
    assert_eq!(to_fbx(&rig), to_fbx(&rig.clone()));
}

#[test]
fn the_corpus_comes_back_as_it_was() {
    let Some(folder) = common::data("RIGLAB_RIGS", "rigs") else { return };
    let mut compared = 0;
    for path in common::files(&folder, &["glb", "vrm"]) {
        let name = path.display().to_string();
        let imported = import(&path, &ImportOptions::default()).unwrap();
        let Some(rig) = imported.rig() else { continue };
        let used: std::collections::HashSet<u32> = rig.mesh().triangles().iter().flatten().copied().collect();
        // Vertices of triangles that were dropped are not read again.
        if used.len() < rig.mesh().positions().len() {
            continue;
        }
        assert_same(&name, &there_and_back(rig), rig);
        compared += 1;
    }
    println!("{compared} rigs are the same after FBX");
    assert!(compared > 0);
}

#[test]
fn a_mesh_on_many_nodes_keeps_within_memory() {
    let sides: Vec<&[i32]> = (0..20_000).map(|i| SIDES[i % 4]).collect();
    let mut file = Ascii::new().mesh(20, 0, &TETRAHEDRON, &sides, "");
    for node in 100..2_000 {
        file = file.node(node, "more", "Null", 0, [0.0; 3], "").connect(21, node);
    }
    let bytes = file.bytes();
    let (result, peak) = peak::of(|| import_bytes("test.fbx", &bytes, &ImportOptions::default()));
    assert!(matches!(result.unwrap_err().fault, Fault::Shown { .. }));
    assert!(peak.is_fair(bytes.len()), "{peak:?} for {}", bytes.len());
}
