//! What is written reads back equal, here and in Python's own readers.

mod common;

use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::Command;

use riglab_asset::{
    Array, Filling, ImportOptions, Target, files_of, import, import_each, is_rig_file, read_arrays, write,
    written_paths,
};
use riglab_core::{Asset, Bounds, Joint, JointId, Mesh, Provenance, Rig, Similarity, Skeleton, SkinWeights};

/// All rigs of the golden samples, one of each name.
fn rigs() -> Option<Vec<Asset>> {
    let root = common::data("RIGLAB_GOLDEN", "golden")?.join("formats");
    let mut out: Vec<Asset> = Vec::new();
    let files = [
        "rignet/biped_rig.txt",
        "rignet/single_rig.txt",
        "rignet/odd_rig.txt",
        "puppeteer/articulation_test.h5",
        "articulation_xl/row_numpy2.npz",
        "unirig/tail_f16/raw_data.npz",
        "skintokens/tail.npz",
        "anymate/Anymate_test.pt",
    ];
    for file in files {
        import_each(root.join(file), &ImportOptions::default(), |asset| {
            let mut asset = asset.unwrap().into_asset().unwrap();
            asset.name = format!("{}-{}", out.len(), asset.name);
            out.push(asset);
            ControlFlow::Continue(())
        });
    }
    Some(out)
}

#[test]
fn weights_of_each_joint_for_each_vertex_have_a_bound() {
    const JOINTS: u16 = 4096;
    const VERTICES: usize = 65_537;
    let joints = (0..JOINTS).map(|j| Joint {
        name: format!("j{j}"),
        parent: j.checked_sub(1).map(|_| JointId(0)),
        head: [f32::from(j), 0.0, 0.0],
    });
    let positions = (0..VERTICES).map(|v| [v as f32, (v % 7) as f32, (v % 5) as f32]).collect();
    let mesh = Mesh::new(positions, vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]).unwrap();
    let weights = SkinWeights::normalized((0..VERTICES).map(|_| [(0, 1.0)])).unwrap();
    let rig = Rig::new(Skeleton::new(joints.collect()).unwrap(), mesh, weights).unwrap();
    let asset = Asset { name: "vast".into(), rig, clips: Vec::new(), provenance: Provenance::default() };
    let dir = tempfile::tempdir().unwrap();
    for target in [Target::UNIRIG, Target::SKINTOKENS, Target::PUPPETEER_H5] {
        let path = dir.path().join(format!("vast{}", target.suffix()));
        let said = write(std::slice::from_ref(&asset), &path, target).unwrap_err().to_string();
        assert!(said.starts_with(&format!("`vast` cannot be written as {target}: 65537 vertices")), "{said}");
        assert!(!path.exists() && target.holds(&asset).is_err());
    }
}

/// Compares up to `weights` in each weight; names where the format has them.
fn assert_same(what: &str, found: &Asset, wanted: &Asset, names: bool, tolerance: f32) {
    let (a, b) = (&found.rig, &wanted.rig);
    // Zeros may change their sign when axes turn, which equality does not see.
    assert_eq!(a.mesh(), b.mesh(), "{what}");
    assert_eq!(a.skeleton().heads(), b.skeleton().heads(), "{what}");
    assert_eq!(a.skeleton().parents(), b.skeleton().parents(), "{what}");
    if names {
        assert_eq!(a.skeleton().names(), b.skeleton().names(), "{what}");
    }
    for vertex in 0..b.weights().rows() {
        let dense = |asset: &Asset| {
            let mut row = vec![0.0; b.skeleton().len()];
            asset.rig.weights().row(vertex).for_each(|(JointId(j), w)| row[usize::from(j)] = w);
            row
        };
        for (found, wanted) in dense(found).into_iter().zip(dense(wanted)) {
            assert!((found - wanted).abs() <= tolerance, "{what}: vertex {vertex}: {found} {wanted}");
        }
    }
}

fn path(folder: &Path, asset: &Asset, target: Target) -> PathBuf {
    folder.join(format!("{}{}", asset.name.replace('/', "_"), target.suffix()))
}

#[test]
fn every_format_reads_back_equal() {
    let Some(rigs) = rigs() else { return };
    let dir = tempfile::tempdir().unwrap();
    for target in Target::ALL.iter().copied().filter(|t| *t != Target::OBJ) {
        let named = ![Target::PUPPETEER_H5, Target::ANYMATE].contains(&target);
        // Weights of Anymate have sixteen bits.
        let tolerance = if target == Target::ANYMATE { 1e-3 } else { 1e-6 };
        for asset in &rigs {
            let path = path(dir.path(), asset, target);
            let what = format!("{target} {}", asset.name);
            write(std::slice::from_ref(asset), &path, target).unwrap_or_else(|e| panic!("{what}: {e}"));
            let read = import(&path, &ImportOptions::default()).unwrap_or_else(|e| panic!("{what}: {e}"));
            assert_same(&what, &read.into_asset().unwrap(), asset, named, tolerance);
            assert!(written_paths(&path, target).iter().all(|path| target.is_at(path)), "{what}");
            assert!(written_paths(&path, target).iter().all(|path| target.is_own(path)), "{what}");
            // The same rig, the same bytes.
            let bytes = std::fs::read(&path).unwrap();
            write(std::slice::from_ref(asset), &path, target).unwrap();
            assert!(bytes == std::fs::read(&path).unwrap(), "{what}");
        }
    }
    assert!(rigs.len() >= 11);
}

#[test]
fn several_assets_go_into_one_file_and_come_out_in_order() {
    let Some(rigs) = rigs() else { return };
    let dir = tempfile::tempdir().unwrap();
    for &target in Target::ALL {
        let path = dir.path().join(format!("all{}", target.suffix()));
        let written = write(&rigs, &path, target);
        if !target.holds_several() {
            assert!(written.unwrap_err().to_string().contains("holds one asset a file, not"));
            continue;
        }
        written.unwrap();
        let mut seen = 0;
        import_each(&path, &ImportOptions::default(), |asset| {
            let asset = asset.unwrap().into_asset().unwrap();
            assert_eq!(asset.name, rigs[seen].name);
            assert_same(&format!("{target}#{seen}"), &asset, &rigs[seen], false, 1e-3);
            seen += 1;
            ControlFlow::Continue(())
        });
        assert_eq!(seen, rigs.len());
    }
}

#[test]
fn files_of_others_and_texts_that_were_changed_are_not_riglabs() {
    let Some(root) = common::data("RIGLAB_GOLDEN", "golden") else { return };
    let formats = root.join("formats");
    for (file, target) in [
        ("rignet/biped_rig.txt", Target::RIGNET),
        ("puppeteer/articulation_test.h5", Target::PUPPETEER_H5),
        ("articulation_xl/row_numpy2.npz", Target::ARTICULATION_XL),
        ("unirig/tail_f16/raw_data.npz", Target::UNIRIG),
        ("skintokens/tail.npz", Target::SKINTOKENS),
        ("anymate/Anymate_test.pt", Target::ANYMATE),
    ] {
        let file = formats.join(file);
        assert!(target.is_at(&file) && !target.is_own(&file), "{target}");
    }
    let Some(rigs) = rigs() else { return };
    let dir = tempfile::tempdir().unwrap();
    let [text, mesh] = ["a_rig.txt", "a.obj"].map(|name| dir.path().join(name));
    write(&rigs[..1], &text, Target::RIGNET).unwrap();
    let changed = std::fs::read_to_string(&text).unwrap().replacen("joints ", "joints changed_", 1);
    std::fs::write(&text, changed).unwrap();
    assert!(Target::RIGNET.is_at(&text) && !Target::RIGNET.is_own(&text) && Target::RIGNET.is_own(&mesh));
    std::fs::remove_file(&mesh).unwrap();
    assert!(!Target::RIGNET.is_own(&text));
}

/// Names of one pair may be those of another: `fox_rig.txt` could have `fox_rig.obj` as its mesh, and `fox.obj` the text
/// `fox_skin.txt`.
#[test]
fn pairs_that_are_written_side_by_side_are_read_as_they_were_written() {
    let Some(rigs) = rigs() else { return };
    for (target, names) in [
        (Target::RIGNET, ["fox_rig.txt", "fox_rig_rig.txt"]),
        (Target::PUPPETEER, ["fox.txt", "fox_skin.txt"]),
        (Target::PUPPETEER, ["fox_skin.txt", "fox.txt"]),
    ] {
        let dir = tempfile::tempdir().unwrap();
        for (asset, name) in rigs.iter().zip(names) {
            write(std::slice::from_ref(asset), dir.path().join(name), target).unwrap();
        }
        for (asset, name) in rigs.iter().zip(names) {
            let [text, mesh] = &written_paths(dir.path().join(name), target)[..] else { panic!("a pair") };
            assert!(is_rig_file(text), "{name} counts");
            for half in [text, mesh] {
                let read = import(half, &ImportOptions::default()).unwrap();
                assert_eq!(read.rig().unwrap().skeleton().names(), asset.rig.skeleton().names(), "{}", half.display());
                assert_eq!(read.mesh().positions(), asset.rig.mesh().positions(), "{}", half.display());
            }
            assert_eq!(files_of(mesh), [mesh.clone(), text.clone()]);
        }
        // One whose mesh is gone does not take the other's.
        let [text, mesh] = &written_paths(dir.path().join(names[0]), target)[..] else { panic!("a pair") };
        std::fs::remove_file(mesh).unwrap();
        let said = import(text, &ImportOptions::default()).unwrap_err().to_string();
        assert!(said.contains("mesh that belongs to the rig text is missing"), "{said}");
    }
}

/// Numpy, torch and h5py as the peers use them, where a Python with them is.
#[test]
fn python_reads_what_is_written() {
    let Some(rigs) = rigs() else { return };
    let python = std::env::var("RIGLAB_PYTHON").unwrap_or_else(|_| "python3".into());
    let has = Command::new(&python).args(["-c", "import numpy, torch, h5py"]).output();
    if !has.is_ok_and(|o| o.status.success()) {
        println!("skipped: {python} has not numpy, torch and h5py (set RIGLAB_PYTHON)");
        return;
    }
    let dir = tempfile::tempdir().unwrap();
    let asset = rigs.iter().find(|a| a.name.contains("biped")).unwrap();
    for &target in Target::ALL {
        write(std::slice::from_ref(asset), dir.path().join(format!("{target}{}", target.suffix())), target).unwrap();
    }
    let skeleton = asset.rig.skeleton();
    let expected = serde_json::json!({
        "vertices": asset.rig.mesh().positions(),
        "faces": asset.rig.mesh().triangles(),
        "joints": skeleton.heads(),
        "names": skeleton.names(),
        "parents": skeleton.parents().iter().map(|p| p.map_or(-1, |p| i64::from(p.0))).collect::<Vec<_>>(),
        "weights": (0..asset.rig.weights().rows())
            .map(|v| asset.rig.weights().row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>())
            .collect::<Vec<_>>(),
    });
    std::fs::write(dir.path().join("expected.json"), expected.to_string()).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/python/read_written.py");
    let out = Command::new(python).arg(script).arg(dir.path()).output().unwrap();
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
}

#[test]
fn rigs_fill_the_cube_of_a_format_on_request_and_are_told_where_they_leave_it() {
    let Some(rigs) = rigs() else { return };
    let dir = tempfile::tempdir().unwrap();
    // None of the golden samples is as large, wherever they are.
    let far = Similarity { scale: 7.0, shift: [3.0, -2.0, 5.0] };
    let asset = Asset { rig: rigs[0].rig.transformed(far).unwrap(), ..rigs[0].clone() };
    let cubes = [(Target::ARTICULATION_XL, 0.5), (Target::PUPPETEER_H5, 0.9995), (Target::ANYMATE, 1.0)];
    for (target, half) in cubes {
        let told = |asset: &Asset| {
            let notes = write(std::slice::from_ref(asset), path(dir.path(), asset, target), target).unwrap();
            let mut notes = notes.iter().map(ToString::to_string);
            notes.any(|note| note.contains(&format!("beyond the {half}")) && note.contains("`--fit`"))
        };
        assert!(told(&asset), "{target}");
        let fitted = Asset { rig: target.fitted(&asset.rig).unwrap(), ..asset.clone() };
        assert!(!told(&fitted), "{target}");
        let back = import(path(dir.path(), &asset, target), &ImportOptions::default()).unwrap().into_asset().unwrap();
        let Bounds { min, max } = back.rig.bounds();
        for axis in 0..3 {
            assert!((min[axis] + max[axis]).abs() < 1e-5 && max[axis] < half + 1e-5, "{target}: {min:?} {max:?}");
        }
        let longest = (0..3).map(|axis| max[axis] - min[axis]).fold(0.0, f32::max);
        assert!((longest - 2.0 * half).abs() < 1e-5, "{target}: {longest}");
    }
    assert!(Target::UNIRIG.fitted(&asset.rig).is_none() && !Target::UNIRIG.has_cube() && Target::ANYMATE.has_cube());
}

#[test]
fn a_fitted_cloud_goes_by_the_map_of_the_vertices() {
    let Some(rigs) = rigs() else { return };
    let dir = tempfile::tempdir().unwrap();
    for (target, half) in [(Target::ARTICULATION_XL, 0.5), (Target::PUPPETEER_H5, 0.9995)] {
        let asset = Asset { rig: target.fitted(&rigs[0].rig).unwrap(), ..rigs[0].clone() };
        let file = path(dir.path(), &asset, target);
        write(std::slice::from_ref(&asset), &file, target).unwrap();
        let arrays = read_arrays(&file).unwrap().remove(0).unwrap();
        let Array { data, .. } = &arrays.extras["points"];
        let mesh = asset.rig.mesh();
        let bounds = Bounds::of(mesh.positions().iter().copied()).unwrap();
        // On the mesh's own box, but for halves of floats and what lies between the points.
        for (column, (low, high)) in bounds.min.iter().zip(bounds.max).enumerate() {
            let all = || data.chunks(6).map(|row| row[column]);
            let (min, max) = (all().fold(f32::MAX, f32::min), all().fold(f32::MIN, f32::max));
            let (low, high) = (low * 0.9995 / half, high * 0.9995 / half);
            assert!(min >= low - 1e-3 && max <= high + 1e-3 && min < low + 0.1 && max > high - 0.1, "{target}");
        }
    }
}

#[test]
fn what_a_format_has_no_form_for_is_known_before() {
    let Some(rigs) = rigs() else { return };
    assert!(Target::ALL.iter().all(|target| target.holds(&rigs[0]).is_ok()));
    // More heads and ends of bones than the format has numbers for.
    let mut joints: Vec<Joint> = (0..200u16)
        .map(|k| Joint {
            name: format!("j{k}"),
            parent: (k > 0).then(|| JointId(k - 1)),
            head: [f32::from(k), 0.0, 0.0],
        })
        .collect();
    let asset = |joints: &[Joint]| {
        let (_, mesh, weights) = rigs[1].rig.clone().into_parts();
        let rig = Rig::new(Skeleton::new(joints.to_vec()).unwrap(), mesh, weights).unwrap();
        Asset { rig, ..rigs[1].clone() }
    };
    let fault = Target::ANYMATE.holds(&asset(&joints)).unwrap_err().to_string();
    assert!(fault.contains("cannot be written as anymate") && fault.contains("up to 127"), "{fault}");
    // More bones than it has numbers for, in a few places.
    for joint in &mut joints[1..] {
        (joint.parent, joint.head) = (Some(JointId(0)), [1.0, 0.0, 0.0]);
    }
    let fault = Target::ANYMATE.holds(&asset(&joints)).unwrap_err().to_string();
    assert!(fault.contains("200 bones; the format numbers up to 128"), "{fault}");
    joints.truncate(100);
    assert!(Target::ANYMATE.holds(&asset(&joints)).is_ok());
}

#[test]
fn a_file_that_is_not_filled_to_its_end_leaves_what_was_there() {
    let Some(rigs) = rigs() else { return };
    let dir = tempfile::tempdir().unwrap();
    for &target in Target::ALL {
        let path = dir.path().join(format!("all{}", target.suffix()));
        std::fs::write(&path, "earlier").unwrap();
        let Ok(mut filling) = Filling::new(&path, target) else {
            assert!(!target.holds_several());
            continue;
        };
        filling.add(&rigs[0]).unwrap();
        drop(filling);
        assert_eq!(std::fs::read(&path).unwrap(), b"earlier", "{target}");
    }
    // Some formats share an ending.
    let endings: std::collections::BTreeSet<_> = Target::ALL.iter().map(|target| target.suffix()).collect();
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), endings.len(), "nothing unfinished is left");
}
