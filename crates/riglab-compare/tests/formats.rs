//! Peers' prediction files, scored end to end: each golden sample against the same rig in another format.

use std::path::{Path, PathBuf};

use riglab_compare::{CompareError, Failures, Kind, Predictions, Row, Status, System, Truths, score};
use riglab_metric::{Baseline, SkinBaseline};

fn golden() -> Option<PathBuf> {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/golden");
    let folder = std::env::var_os("RIGLAB_GOLDEN").map_or(shared, PathBuf::from).join("formats");
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no such folder {} (set RIGLAB_GOLDEN)", folder.display());
    None
}

fn kind(named: &str) -> Kind {
    Kind::all().find(|(name, _)| *name == named).unwrap().1
}

fn scored(predictions: &Path, truth: &Path, kind: Kind, failures: Failures) -> Result<System, CompareError> {
    let truths = Truths::open(truth, None)?;
    let systems = [("system".to_owned(), Predictions::find(predictions, kind)?)];
    let (mut systems, _) = score(&truths, &systems, &[], failures, |_| ())?;
    Ok(systems.remove(0))
}

fn row<'a>(system: &'a System, asset: &str) -> &'a Row {
    system.rows.iter().find(|r| r.asset == asset).unwrap_or_else(|| panic!("{asset}: {:?}", system.rows))
}

fn value(row: &Row, name: &str) -> f64 {
    row.measures.iter().find(|m| m.name() == name).unwrap_or_else(|| panic!("{}: no {name}", row.asset)).value
}

/// The same rig but for what 16-bit numbers and printed decimals do to it.
fn same(row: &Row) {
    assert_eq!(row.status, Status::Scored, "{row:?}");
    assert_eq!(row.without_weights, "", "{}", row.asset);
    for (name, want, room) in [
        ("j2j@rignet", 0.0, 5e-4),
        ("b2b@magicarticulate", 0.0, 1e-3),
        ("ted@riglab", 0.0, 0.0),
        ("l1@rignet", 0.0, 1e-3),
        ("iou@skintokens", 1.0, 1e-2),
        ("precision@puppeteer", 1.0, 1e-2),
        ("motion@skintokens", 0.0, 1e-3),
        ("connectivity_recall@anymate", 1.0, 0.0),
    ] {
        let found = value(row, name);
        assert!((found - want).abs() <= room, "{} {name}: {found}", row.asset);
    }
}

/// What files of a folder are called before an ending, sorted.
fn names(folder: &Path, ending: &str) -> Vec<String> {
    let files = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name().into_string().unwrap());
    let mut names: Vec<String> = files.filter_map(|file| Some(file.strip_suffix(ending)?.to_owned())).collect();
    names.sort();
    names
}

#[test]
fn every_format_is_the_rig_that_it_is() {
    let Some(formats) = golden() else { return };
    let of = |system: &str, truth: &str| {
        scored(&formats.join(system), &formats.join(truth), Kind::AUTO, Failures::Apart).unwrap()
    };
    let puppeteer = of("puppeteer", "rignet");
    same(row(&puppeteer, "biped_rig.txt"));
    assert_eq!(row(&puppeteer, "single_rig.txt").status, Status::Missing);
    // A file by itself: several may hold a rig of one name.
    let mut held = 0;
    for file in names(&formats.join("anymate"), ".pt").into_iter().filter(|file| !file.starts_with("refuse")) {
        let truth = formats.join("rignet");
        let file = formats.join(format!("anymate/{file}.pt"));
        let anymate = match scored(&file, &truth, Kind::AUTO, Failures::Apart) {
            Ok(found) => found,
            // One with other rigs alone.
            Err(e) if e.to_string().contains("matched by their path") => continue,
            Err(e) => panic!("{}: {e}", file.display()),
        };
        let biped = row(&anymate, "biped_rig.txt");
        if biped.status == Status::Missing {
            continue;
        }
        same(biped);
        assert!(biped.notes[0].contains("scaled by 0.500"), "{}: {:?}", file.display(), biped.notes);
        held += 1;
    }
    assert!(held > 0, "no file of anymate has the biped");
    let set = of("articulation_xl/row_numpy2.npz", "puppeteer/articulation_test.h5");
    same(row(&set, "articulation_test.h5#b1p3d"));
    assert_eq!(set.counts(), [1, 0, 1]);
    assert_eq!(set.unmatched.len(), 2);
    // UniRig's stages, points and all, against what they were given; and its own file where there are none.
    let unirig = of("unirig", "unirig");
    same(row(&unirig, "biped_f32/raw_data.npz"));
    assert!(row(&unirig, "biped_f32/raw_data.npz").joints == 19);
    same(row(&unirig, "tail_f16/raw_data.npz"));
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("tail")).unwrap();
    std::fs::copy(formats.join("unirig/tail_f16/raw_data.npz"), dir.path().join("tail/raw_data.npz")).unwrap();
    let tail = scored(&formats.join("skintokens"), dir.path(), kind("npz"), Failures::Apart).unwrap();
    same(row(&tail, "tail/raw_data.npz"));
}

#[test]
fn broken_predictions_are_rows_with_a_reason() {
    let Some(formats) = golden() else { return };
    let (truth, theirs) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    for name in ["whole", "cut", "hostile", "gone"] {
        let copy = |from: &str, to: String| std::fs::copy(formats.join(from), truth.path().join(to)).unwrap();
        copy("rignet/biped_rig.txt", format!("{name}_rig.txt"));
        copy("rignet/biped.obj", format!("{name}.obj"));
    }
    std::fs::copy(formats.join("anymate/refuse_call.pt"), theirs.path().join("hostile.pt")).unwrap();
    let bytes = std::fs::read(formats.join("unirig/biped_f32/predict_skeleton.npz")).unwrap();
    std::fs::write(theirs.path().join("cut.npz"), &bytes[..bytes.len() / 2]).unwrap();
    // A skeleton alone: joints, but no weights.
    std::fs::write(theirs.path().join("whole.npz"), &bytes).unwrap();
    for failures in [Failures::Apart, Failures::Worst] {
        let found = scored(theirs.path(), truth.path(), Kind::AUTO, failures).unwrap();
        assert_eq!(found.counts(), [1, 2, 1], "{found:?}");
        for name in ["cut", "hostile"] {
            let Status::Failed(reason) = &row(&found, &format!("{name}_rig.txt")).status else { panic!("{found:?}") };
            assert!(reason.contains(name), "{reason}");
        }
        let whole = row(&found, "whole_rig.txt");
        assert!(value(whole, "j2j@skintokens") < 0.1, "{whole:?}");
        assert!(whole.without_weights.contains("no vertices") && whole.notes[0].contains("no mesh"), "{whole:?}");
        let defined = found.values("j2j@skintokens").iter().filter(|v| v.is_finite()).count();
        assert_eq!(defined, if failures == Failures::Worst { 4 } else { 1 });
    }
}

#[test]
fn baselines_stand_beside_systems() {
    let Some(formats) = golden() else { return };
    let truths = Truths::open(&formats.join("rignet"), None).unwrap();
    let systems = [("puppeteer".to_owned(), Predictions::find(&formats.join("puppeteer"), Kind::AUTO).unwrap())];
    let baselines = [SkinBaseline::Straight(Baseline::Nearest), SkinBaseline::Heat];
    let (found, _) = score(&truths, &systems, &baselines, Failures::Apart, |_| ()).unwrap();
    assert_eq!(found.len(), 3);
    let rigs = names(&formats.join("rignet"), "_rig.txt").len();
    for system in &found[1..] {
        assert_eq!(system.counts(), [rigs, 0, 0], "{}", system.name);
        let iou = value(row(system, "biped_rig.txt"), "iou@skintokens");
        // Tubes around bones: any of them is a fair guess, and none is the truth.
        assert!(iou > 0.2 && iou < 0.999, "{}: {iou}", system.name);
        assert!(!row(system, "biped_rig.txt").measures.iter().any(|m| m.metric == "j2j"));
    }
}

#[test]
fn what_cannot_begin_says_why() {
    let Some(formats) = golden() else { return };
    let fails = |theirs: &str, truth: &str, kind| {
        scored(&formats.join(theirs), &formats.join(truth), kind, Failures::Apart).unwrap_err().to_string()
    };
    assert!(fails("nowhere", "rignet", Kind::AUTO).contains("no such folder or file of predictions"));
    assert!(fails("rignet", "nowhere", Kind::AUTO).contains("no such corpus or folder"));
    assert!(fails("rignet", "unirig", kind("glb")).contains("no glb file below it"));
    let empty = tempfile::tempdir().unwrap();
    assert!(fails(empty.path().to_str().unwrap(), "unirig", Kind::AUTO).contains("no rigged file below it"));
    let other = fails("skintokens", "rignet", Kind::AUTO);
    let first = format!("for instance `{}`", names(&formats.join("skintokens"), ".npz")[0]);
    assert!(other.contains(&first) && other.contains("matched by their path"), "{other}");
}
