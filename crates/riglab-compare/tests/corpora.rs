//! Corpora, as truths and as predictions, and their splits.

use std::path::{Path, PathBuf};

use riglab_compare::{CompareError, Failures, Kind, Predictions, Status, System, Truths, score};
use riglab_core::{Asset, Joint, JointId, Mesh, Provenance, Rig, Skeleton, SkinWeights};
use riglab_data::CorpusWriter;
use riglab_metric::SkinBaseline;

/// A tetrahedron on two joints, the second at a height.
fn asset(name: &str, height: f32) -> Asset {
    let joint = |k: u16, head| Joint { name: format!("{k}"), parent: k.checked_sub(1).map(JointId), head };
    let skeleton = Skeleton::new(vec![joint(0, [0.0; 3]), joint(1, [0.0, height, 0.0])]).unwrap();
    let corners = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let mesh = Mesh::new(corners, vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]).unwrap();
    let weights = SkinWeights::normalized((0..4u16).map(|v| [(v % 2, 1.0)])).unwrap();
    let rig = Rig::new(skeleton, mesh, weights).unwrap();
    Asset { name: name.into(), rig, clips: Vec::new(), provenance: Provenance::default() }
}

fn corpus(path: PathBuf, assets: &[(&str, &str, f32)]) -> PathBuf {
    let mut writer = CorpusWriter::create(&path).unwrap();
    assets.iter().for_each(|(name, _, height)| writer.add(&asset(name, *height)).unwrap());
    writer.finish(&assets.iter().map(|(_, split, _)| *split).collect::<Vec<_>>()).unwrap();
    path
}

fn of_a_split(predictions: &Path, truth: &Path, split: &str) -> Result<System, CompareError> {
    let systems = [("it".to_owned(), Predictions::find(predictions, Kind::AUTO)?)];
    let (mut found, _) = score(&Truths::open(truth, Some(split))?, &systems, &[], Failures::Apart, |_| ())?;
    Ok(found.remove(0))
}

const ALL: [(&str, &str, f32); 3] = [("a.glb", "train", 0.5), ("b.glb", "test_new", 0.6), ("c.glb", "test_new", 0.7)];

#[test]
fn a_corpus_is_a_system_as_files_are() {
    let dir = tempfile::tempdir().unwrap();
    let truth = corpus(dir.path().join("truth.h5"), &ALL);
    let other = [("a.glb", "train", 0.5), ("b.glb", "test_new", 0.8), ("strange.glb", "", 0.7), ALL[2]];
    let other = corpus(dir.path().join("other.h5"), &other);
    let found = of_a_split(&other, &truth, "test_new").unwrap();
    assert_eq!(found.counts(), [2, 0, 0], "{found:?}");
    // Of two joints of the first one is off by a fifth of the cube's edge.
    let off = found.values("j2j@riglab");
    assert!((off[0] - 0.1).abs() < 1e-6 && off[1] == 0.0, "{off:?}");
    assert_eq!(found.values("iou@skintokens")[1], 1.0);
    assert_eq!(found.unmatched, ["strange"], "the training asset is of another split");
}

#[test]
fn a_file_for_a_file_needs_no_name() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str| {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, riglab_asset::to_glb(&asset(name, 0.5))).unwrap();
        path
    };
    let (truth, out, other) = (write("true/hero.glb"), write("out/rigged.glb"), write("true/more.glb"));
    let of = |predictions: &Path, truth: &Path| {
        let systems = [("it".to_owned(), Predictions::find(predictions, Kind::AUTO).unwrap())];
        let (found, _) = score(&Truths::open(truth, None)?, &systems, &[], Failures::Apart, |_| ())?;
        Ok::<_, CompareError>((found[0].counts(), found[0].unmatched.len()))
    };
    assert_eq!(of(&out, &truth).unwrap(), ([1, 0, 0], 0));
    // Of a folder, or for several, the name tells.
    assert!(matches!(of(out.parent().unwrap(), &truth), Err(CompareError::NothingMatches { .. })));
    assert!(matches!(of(&out, other.parent().unwrap()), Err(CompareError::NothingMatches { .. })));
    let set = dir.path().join("set.npz");
    riglab_asset::write(&[asset("a", 0.5), asset("b", 0.6)], &set, riglab_asset::Target::ARTICULATION_XL).unwrap();
    assert!(matches!(of(&out, &set), Err(CompareError::NothingMatches { .. })));
}

#[test]
fn a_prediction_is_of_one_asset() {
    let dir = tempfile::tempdir().unwrap();
    let all = [("x/a.glb", "test_new", 0.5), ("y/a.glb", "test_new", 0.5), ("x/b.glb", "test_new", 0.5)];
    let truth = corpus(dir.path().join("truth.h5"), &[&all[..], &[("z/b.glb", "train", 0.5)]].concat());
    let of = |name: &str, predictions: &[(&str, &str, f32)]| {
        let found = of_a_split(&corpus(dir.path().join(name), predictions), &truth, "test_new").unwrap();
        (found.counts(), found.unmatched)
    };
    // `a` may be either, and `x/a` is not y's; the only `b` in another folder is x's, unless it is that of another split.
    assert_eq!(of("1.h5", &[("a.glb", "", 0.5), ("w/b.glb", "", 0.5)]), ([1, 0, 2], vec!["a".to_owned()]));
    assert_eq!(of("2.h5", &[("x/a.glb", "", 0.5), ("z/b.glb", "", 0.5)]), ([1, 0, 2], vec![]));
}

#[test]
fn predictions_of_other_splits_alone_are_told() {
    let dir = tempfile::tempdir().unwrap();
    let truth = corpus(dir.path().join("truth.h5"), &ALL);
    let trained = corpus(dir.path().join("trained.h5"), &ALL[..1]);
    let said = of_a_split(&trained, &truth, "test_new").unwrap_err().to_string();
    assert!(said.contains("it has for instance `a`") && said.contains("1 of them are of other splits"), "{said}");
}

#[test]
fn a_split_that_is_not_there_is_told_with_those_that_are() {
    let dir = tempfile::tempdir().unwrap();
    let truth = corpus(dir.path().join("truth.h5"), &ALL);
    let said = |truth: &Path| Truths::open(truth, Some("test")).err().unwrap().to_string();
    assert!(
        said(&truth).ends_with("no split `test` in this corpus; there are `test_new`, `train`"),
        "{}",
        said(&truth)
    );
    // A folder has none.
    std::fs::write(dir.path().join("a.glb"), b"glTF").unwrap();
    for files in [dir.path().to_path_buf(), dir.path().join("a.glb")] {
        assert!(said(&files).contains("only a corpus has splits") && said(&files).contains("leave --split out"));
    }
}

#[test]
fn a_corpus_that_was_cut_off_says_so_once() {
    let dir = tempfile::tempdir().unwrap();
    let truth = corpus(dir.path().join("truth.h5"), &ALL);
    let cut = dir.path().join("cut.h5");
    std::fs::write(&cut, &std::fs::read(&truth).unwrap()[..4000]).unwrap();
    for said in [Truths::open(&cut, None).err().unwrap(), Predictions::find(&cut, Kind::AUTO).err().unwrap()] {
        let said = said.to_string();
        assert_eq!(said.matches("cut.h5").count(), 1, "{said}");
        assert!(said.contains("eof = 4000") && said.contains("cut off"), "{said}");
    }
    // Below a folder it is the prediction of an asset, which failed.
    std::fs::remove_file(dir.path().join("truth.h5")).unwrap();
    let other = tempfile::tempdir().unwrap();
    let truth = corpus(other.path().join("truth.h5"), &[("cut.glb", "val", 0.5)]);
    let found = of_a_split(dir.path(), &truth, "val").unwrap();
    assert!(matches!(&found.rows[0].status, Status::Failed(why) if why.contains("HDF5")), "{found:?}");
    // And true files that cannot be read are named once.
    let text = other.path().join("x.glb");
    std::fs::write(&text, b"glTF").unwrap();
    let systems = [("it".to_owned(), Predictions::find(&truth, Kind::AUTO).unwrap())];
    let said = score(&Truths::open(&text, None).unwrap(), &systems, &[], Failures::Apart, |_| ()).unwrap_err();
    assert_eq!(said.to_string().matches("x.glb").count(), 1, "{said}");
}

#[test]
fn baselines_may_stand_alone() {
    let dir = tempfile::tempdir().unwrap();
    let truths = Truths::open(&corpus(dir.path().join("truth.h5"), &ALL), None).unwrap();
    let baselines: Vec<SkinBaseline> = SkinBaseline::compared().take(2).collect();
    let (found, _) = score(&truths, &[], &baselines, Failures::Apart, |_| ()).unwrap();
    assert_eq!(
        found.iter().map(|system| system.name.as_str()).collect::<Vec<_>>(),
        ["nearest bone", "1/d^4, top 4, cut 0.15"]
    );
    assert!(found.iter().all(|system| system.baseline && system.counts() == [3, 0, 0]), "{found:?}");
}

#[test]
fn names_that_are_the_same_come_before_those_without_what_systems_add() {
    let dir = tempfile::tempdir().unwrap();
    let both = [("warrior.glb", "val", 0.5), ("warrior_skeleton.glb", "val", 0.7), ("Hero #3.glb", "val", 0.6)];
    let truth = corpus(dir.path().join("truth.h5"), &both);
    let of = |name: &str, predictions: &[(&str, &str, f32)]| {
        of_a_split(&corpus(dir.path().join(name), predictions), &truth, "val").unwrap()
    };
    let found = of("same.h5", &both);
    assert_eq!((found.counts(), found.values("j2j@riglab")), ([3, 0, 0], vec![0.0; 3]), "{found:?}");
    let added = [("warrior_rig.glb", "", 0.5), ("warrior_skeleton_pred.glb", "", 0.7), ("x/Hero #3_rig.glb", "", 0.6)];
    let found = of("added.h5", &added);
    assert_eq!((found.counts(), found.values("j2j@riglab")), ([3, 0, 0], vec![0.0; 3]), "{found:?}");
    // Which of two is meant cannot be told, and no choice of a format would.
    let found = of("twice.h5", &[("warrior_rig.glb", "", 0.5), ("warrior_pred.glb", "", 0.5)]);
    let Status::Failed(why) = &found.rows[0].status else { panic!("{found:?}") };
    assert!(why.contains("several files") && why.ends_with("call the one that is meant `warrior`"), "{why}");
    assert_eq!(found.counts(), [0, 1, 2]);
}

#[test]
fn one_joint_is_worth_no_more_than_nothing() {
    let dir = tempfile::tempdir().unwrap();
    let truth = corpus(dir.path().join("truth.h5"), &ALL);
    let lone = |name: &str| {
        let (_, mesh, _) = asset(name, 0.5).rig.into_parts();
        let joint = Joint { name: "0".into(), parent: None, head: [0.9, 0.9, 0.9] };
        let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
        let rig = Rig::new(Skeleton::new(vec![joint]).unwrap(), mesh, weights).unwrap();
        Asset { rig, ..asset(name, 0.5) }
    };
    let of = |file: &str, second: Option<Asset>| {
        let path = dir.path().join(file);
        let mut writer = CorpusWriter::create(&path).unwrap();
        let all: Vec<Asset> = std::iter::once(asset("b.glb", 0.6)).chain(second).collect();
        all.iter().for_each(|one| writer.add(one).unwrap());
        writer.finish(&vec!["test_new"; all.len()]).unwrap();
        let systems = [("it".to_owned(), Predictions::find(&path, Kind::AUTO).unwrap())];
        let truths = Truths::open(&truth, Some("test_new")).unwrap();
        score(&truths, &systems, &[], Failures::Worst, |_| ()).unwrap().0.remove(0)
    };
    let (nothing, one) = (of("nothing.h5", None), of("one.h5", Some(lone("c.glb"))));
    assert_eq!((nothing.counts(), one.counts()), ([1, 0, 1], [2, 0, 0]));
    for name in ["j2b@riglab", "b2b@riglab", "b2b@magicarticulate", "iou@skintokens", "l1@rignet", "motion@rignet"] {
        let [missing, lone] = [&nothing, &one].map(|system| system.values(name)[1]);
        assert!(missing.is_finite() && lone.is_finite(), "{name}: {missing} {lone}");
    }
    assert_eq!(one.values("iou@skintokens")[1], 0.0);
    assert!(!one.rows[1].without_weights.is_empty());
}

#[test]
fn what_is_known_from_names_is_told_before_anything_is_scored() {
    let dir = tempfile::tempdir().unwrap();
    let truth = corpus(dir.path().join("truth.h5"), &ALL);
    let other = corpus(dir.path().join("other.h5"), &[("x.glb", "", 0.5)]);
    let told = |predictions: &[&Path]| {
        let found = |(k, path): (usize, &&Path)| (format!("s{k}"), Predictions::find(path, Kind::AUTO).unwrap());
        let systems: Vec<_> = predictions.iter().enumerate().map(found).collect();
        let mut told = Vec::new();
        let found = score(&Truths::open(&truth, None).unwrap(), &systems, &[], Failures::Apart, |done| told.push(done));
        (found.map(|_| ()).map_err(|e| e.to_string()), told)
    };
    let (found, done) = told(&[&truth, &other]);
    let said = found.unwrap_err();
    assert!(said.contains("other.h5") && said.contains("for instance `x`") && said.contains("the truth `a`"), "{said}");
    assert!(done.is_empty(), "{done:?}");
    // Else each asset is told.
    assert_eq!(told(&[&truth]), (Ok(()), vec![1, 2, 3]));
}

#[test]
fn what_stages_predict_is_no_true_rig_and_told() {
    let dir = tempfile::tempdir().unwrap();
    let file = |name: &str| std::fs::write(dir.path().join(name), b"none").unwrap();
    file("predict_skin.npz");
    let said = Truths::open(dir.path(), None).err().unwrap().to_string();
    assert!(said.contains("but what UniRig's stages predict"), "{said}");
    ["predict_a.glb", "predict_skeleton.npz"].into_iter().for_each(file);
    let truths = Truths::open(dir.path(), None).unwrap();
    assert_eq!(truths.len(), 1, "other names that begin so are those of assets");
    let names: Vec<&str> = truths.unread.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names, ["predict_skeleton.npz", "predict_skin.npz"]);
    assert!(truths.unread[0].1.contains("a part of a rig"));
}

/// Scored, failed and missing, how far the joints of each are off, and what is of no true asset.
fn of_all(predictions: &Path, truths: &Truths) -> ([usize; 3], Vec<f64>, Vec<String>) {
    let systems = [("it".to_owned(), Predictions::find(predictions, Kind::AUTO).unwrap())];
    let (mut found, _) = score(truths, &systems, &[], Failures::Apart, |_| ()).unwrap();
    let found = found.remove(0);
    (found.counts(), found.values("j2j@riglab"), found.unmatched)
}

#[test]
fn meshes_without_a_rig_are_no_true_rigs() {
    let dir = tempfile::tempdir().unwrap();
    let bare = |name: &str| {
        let (_, mesh, _) = asset(name, 0.5).rig.into_parts();
        let joint = Joint { name: riglab_asset::LONE_JOINT.into(), parent: None, head: [0.0; 3] };
        let weights = SkinWeights::normalized((0..4).map(|_| [(0u16, 1.0)])).unwrap();
        Asset { rig: Rig::new(Skeleton::new(vec![joint]).unwrap(), mesh, weights).unwrap(), ..asset(name, 0.5) }
    };
    let path = dir.path().join("truth.h5");
    let mut writer = CorpusWriter::create(&path).unwrap();
    [asset("y/a.glb", 0.5), bare("x/a.glb"), bare("c.glb")].iter().for_each(|a| writer.add(a).unwrap());
    writer.finish(&["val", "val", "test"]).unwrap();
    for (split, told) in [(None, "2 meshes"), (Some("val"), "1 mesh")] {
        let truths = Truths::open(&path, split).unwrap();
        assert_eq!((truths.len(), truths.notes.len()), (1, 1));
        assert!(truths.notes[0].ends_with(&format!("{told} without a rig left out")), "{:?}", truths.notes);
    }
    let said = Truths::open(&path, Some("test")).err().unwrap().to_string();
    assert!(said.ends_with("no true rig to compare with: all it has there is 1 mesh without a rig"), "{said}");
    // What is predicted for one is no other's, and no fault.
    let other = corpus(dir.path().join("other.h5"), &[("x/a.glb", "", 0.9), ("y/a.glb", "", 0.5)]);
    let found = of_all(&other, &Truths::open(&path, None).unwrap());
    assert_eq!(found, ([1, 0, 0], vec![0.0], vec![]));
}

#[test]
fn assets_of_one_name_in_two_files_have_their_own_predictions() {
    let dir = tempfile::tempdir().unwrap();
    let both = [("a.npz#tom", "val", 0.5), ("b.npz#tom", "val", 0.8)];
    let truth = corpus(dir.path().join("truth.h5"), &both);
    let truths = Truths::open(&truth, None).unwrap();
    let own = ([2, 0, 0], vec![0.0; 2], vec![]);
    assert_eq!(of_all(&truth, &truths), own);
    let folder = |name: &str, files: &[(&str, f32)]| {
        let folder = dir.path().join(name);
        for (file, height) in files {
            let path = folder.join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, riglab_asset::to_glb(&asset(file, *height))).unwrap();
        }
        folder
    };
    // As `riglab convert` calls what it makes of such a corpus, with what systems add, and below another folder.
    for (name, [a, b]) in [
        ("plain", ["a.npz#tom.glb", "b.npz#tom.glb"]),
        ("added", ["a.npz#tom_rig.glb", "b.npz#tom_rig.glb"]),
        ("deep", ["x/a.npz#tom.glb", "x/b.npz#tom.glb"]),
    ] {
        assert_eq!(of_all(&folder(name, &[(a, 0.5), (b, 0.8)]), &truths), own, "{name}");
    }
    // That of one is not the other's, in the same split or not.
    let one = folder("one", &[("b.npz#tom.glb", 0.8)]);
    assert_eq!(of_all(&one, &truths).0, [1, 0, 1]);
    let split = corpus(dir.path().join("split.h5"), &[("a.npz#tom", "val", 0.5), ("b.npz#tom", "train", 0.8)]);
    let (counts, off, _) = of_all(&dir.path().join("plain"), &Truths::open(&split, Some("val")).unwrap());
    assert_eq!((counts, off), ([1, 0, 0], vec![0.0]));
    // Files of several as they are.
    let sets = dir.path().join("sets");
    std::fs::create_dir(&sets).unwrap();
    for (file, height) in [("a.npz", 0.5), ("b.npz", 0.8)] {
        let all = [asset("tom", height), asset("cat", height)];
        riglab_asset::write(&all, sets.join(file), riglab_asset::Target::ARTICULATION_XL).unwrap();
    }
    let (counts, off, _) = of_all(&sets, &truths);
    assert!(counts == [2, 0, 0] && off.iter().all(|off| *off < 1e-6), "{counts:?} {off:?}");
}

#[test]
fn predictions_below_the_true_rigs_are_none_of_them() {
    let dir = tempfile::tempdir().unwrap();
    let write = |name: &str| {
        let path = dir.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, riglab_asset::to_glb(&asset(name, 0.5))).unwrap();
    };
    ["a.glb", "b.glb", "rigged/a.glb", "rigged/b.glb", ".old/a.glb", "rigged/.old/a.glb"].into_iter().for_each(write);
    let rigged = dir.path().join("rigged");
    let mut truths = Truths::open(dir.path(), None).unwrap();
    assert!(truths.notes.len() == 1 && truths.notes[0].starts_with("hidden and not taken: "), "{:?}", truths.notes);
    assert!(Predictions::find(&rigged, Kind::AUTO).unwrap().hidden.unwrap().contains(".old"));
    // The folder itself, compared with itself, stays.
    truths.leave_out([dir.path()]).unwrap();
    assert_eq!(truths.len(), 4);
    truths.leave_out([rigged.as_path()]).unwrap();
    assert_eq!(truths.len(), 2);
    assert!(truths.notes[1].starts_with("no true rigs, but predictions: 2 files in "), "{:?}", truths.notes);
    assert_eq!(of_all(&rigged, &truths).0, [2, 0, 0]);
    // One that lies elsewhere, and that a link leads to; whoever gives a folder above compares all with itself.
    #[cfg(unix)]
    {
        let elsewhere = tempfile::tempdir().unwrap();
        let link = dir.path().join("rigged/link");
        std::fs::copy(dir.path().join("a.glb"), elsewhere.path().join("c.glb")).unwrap();
        std::os::unix::fs::symlink(elsewhere.path(), &link).unwrap();
        for system in [link.as_path(), elsewhere.path()] {
            let mut truths = Truths::open(dir.path(), None).unwrap();
            truths.leave_out([dir.path().parent().unwrap()]).unwrap();
            assert_eq!(truths.len(), 5);
            truths.leave_out([system]).unwrap();
            assert!(truths.len() == 4 && truths.notes[1].contains("but predictions: 1 file in "), "{:?}", truths.notes);
        }
        std::fs::remove_file(link).unwrap();
        // What single links of a folder lead to is meant, unless predictions lie below it.
        let chosen = tempfile::tempdir().unwrap();
        let link = |name: &str| std::os::unix::fs::symlink(rigged.join("a.glb"), chosen.path().join(name)).unwrap();
        link("a.glb");
        std::fs::copy(dir.path().join("b.glb"), chosen.path().join("b.glb")).unwrap();
        for systems in [vec![rigged.as_path()], vec![rigged.as_path(), elsewhere.path(), dir.path()]] {
            let mut truths = Truths::open(chosen.path(), None).unwrap();
            truths.leave_out(systems).unwrap();
            assert_eq!((truths.len(), &truths.notes[..]), (2, &[][..]));
        }
        std::os::unix::fs::symlink(rigged.join("b.glb"), dir.path().join("c.glb")).unwrap();
        let mut truths = Truths::open(dir.path(), None).unwrap();
        truths.leave_out([rigged.as_path()]).unwrap();
        assert!(truths.len() == 2 && truths.notes[1].contains("but predictions: 3 files in "), "{:?}", truths.notes);
        std::fs::remove_file(dir.path().join("c.glb")).unwrap();
    }
    ["a.glb", "b.glb"].iter().for_each(|name| std::fs::remove_file(dir.path().join(name)).unwrap());
    let said = Truths::open(dir.path(), None).unwrap().leave_out([rigged.as_path()]).unwrap_err().to_string();
    assert!(said.contains("all that is below it are the predictions in"), "{said}");
}

#[test]
fn no_prediction_serves_two_assets() {
    let dir = tempfile::tempdir().unwrap();
    let both = [("bird.fbx", "test", 0.5), ("bird.glb", "test", 0.6), ("hen.obj", "train", 0.7)];
    let truth = corpus(dir.path().join("truth.h5"), &both);
    // The joints of each are at a height of their own, so that another's prediction is off.
    let system = |folder: &str, files: &[(&str, f32)]| {
        let folder = dir.path().join(folder);
        for (file, height) in files {
            let path = folder.join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, riglab_asset::to_glb(&asset(file, *height))).unwrap();
        }
        of_a_split(&folder, &truth, "test").unwrap()
    };
    let hits = |found: &System| {
        let off = found.values("j2j@riglab");
        found.rows.iter().zip(off).map(|(row, off)| (row.asset.clone(), off < 1e-6)).collect::<Vec<_>>()
    };
    let all = [("bird.fbx".to_owned(), true), ("bird.glb".to_owned(), true)];
    for (folder, files) in [
        // As `riglab rig` calls what it makes of a folder with both, to GLB and to FBX.
        ("glb", [("bird.glb", 0.6), ("bird.fbx.glb", 0.5)]),
        ("deep", [("deep/bird.glb", 0.6), ("deep/bird.fbx.glb", 0.5)]),
        ("added", [("bird.glb", 0.6), ("bird.fbx_rig.glb", 0.5)]),
        ("whole", [("bird.glb.glb", 0.6), ("bird.fbx.glb", 0.5)]),
    ] {
        let found = system(folder, &files);
        assert_eq!(hits(&found), all, "{folder}");
        assert!(found.unmatched.is_empty(), "{folder}: {:?}", found.unmatched);
    }
    let one = system("one", &[("bird.glb", 0.6)]);
    assert_eq!([&one.rows[0].status, &one.rows[1].status], [&Status::Missing, &Status::Scored]);
    let other = system("other", &[("bird.fbx.glb", 0.5)]);
    assert_eq!([&other.rows[0].status, &other.rows[1].status], [&Status::Scored, &Status::Missing]);
    let unclear = system("unclear", &[("bird_rig.glb", 0.5)]);
    for (row, rival) in unclear.rows.iter().zip(["bird.glb", "bird.fbx"]) {
        let Status::Failed(why) = &row.status else { panic!("{row:?}") };
        assert!(why.contains(&format!("that of `{rival}`")) && why.ends_with(&format!("{}.glb", row.asset)), "{why}");
    }
}
