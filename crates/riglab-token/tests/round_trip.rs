//! Skeletons of real files and of creatures, written and read.

use std::path::{Path, PathBuf};

use riglab_asset::{ImportOptions, import};
use riglab_core::Skeleton;
use riglab_synth::{Options, creature};
use riglab_token::{DecodeFault, Grammar, Limits, Parents, Preset, Tokenizer};

/// Half the diagonal of a cell.
const HALF: f64 = 1.732_050_9 / 256.0;

fn folder(variable: &str, default: &str) -> Option<PathBuf> {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared");
    let folder = std::env::var_os(variable).map_or_else(|| shared.join(default), PathBuf::from);
    if folder.is_dir() {
        return Some(folder);
    }
    println!("skipped: no such folder: {} (set {variable})", folder.display());
    None
}

/// Distances of joints from where they were.
#[derive(Default)]
struct Errors {
    sum: f64,
    joints: usize,
}

impl Errors {
    fn check(&self) {
        let mean = self.sum / self.joints as f64;
        println!("{mean:.5} from their places on average, of {HALF:.5}");
        assert!(mean <= HALF, "{mean}");
    }
}

/// Writes and reads a skeleton that stands in the cube: the same tree, and joints within half a cell of where they
/// were, but for those that moved because their cell would give another tree.
fn comes_back(tokenizer: &Tokenizer, skeleton: &Skeleton, what: &str, errors: &mut Errors) {
    let encoded = tokenizer.encode(skeleton, None).unwrap_or_else(|e| panic!("{what}: {e}"));
    let limits = Limits { joints: skeleton.len(), tokens: encoded.ids.len() };
    let mut grammar = Grammar::new(tokenizer, limits, Parents::Existing);
    for &id in &encoded.ids {
        grammar.advance(id).unwrap_or_else(|e| panic!("{what}: {e}"));
    }
    assert!(grammar.is_done(), "{what}");
    let decoded = tokenizer.decode(&encoded.ids).unwrap_or_else(|e| panic!("{what}: {e}"));
    let mut place = vec![0; encoded.order.len()];
    encoded.order.iter().enumerate().for_each(|(at, &joint)| place[joint] = at);
    let mut far = 0;
    for (at, &joint) in encoded.order.iter().enumerate() {
        let wanted = skeleton.parents()[joint].map(|p| place[p.index()]);
        assert_eq!(decoded.parents[at], wanted, "{what}: joint {joint}");
        let (was, is) = (skeleton.heads()[joint], decoded.joints[at]);
        let error = (0..3).map(|k| f64::from(is[k] - was[k]).powi(2)).sum::<f64>().sqrt();
        errors.sum += error;
        far += usize::from(error > HALF + 1e-6);
    }
    errors.joints += skeleton.len();
    assert!(far <= encoded.moved, "{what}: {far} joints are far from their places, {} moved", encoded.moved);
}

#[test]
fn creatures_come_back() {
    let tokenizer = Tokenizer::new(Preset::Riglab.config());
    let options = Options { triangles: 500..=600, ..Options::default() };
    let mut errors = Errors::default();
    for index in 0..300 {
        let (rig, _) = creature(13, index, &options).rig.normalized();
        comes_back(&tokenizer, rig.skeleton(), &format!("creature {index}"), &mut errors);
    }
    errors.check();
}

#[test]
fn real_rigs_and_hard_files_come_back() {
    let tokenizer = Tokenizer::new(Preset::Riglab.config());
    for (variable, default, least) in [("RIGLAB_RIGS", "rigs", 100), ("RIGLAB_RIGS_HARD", "rigs_hard", 30)] {
        let Some(folder) = folder(variable, default) else { continue };
        let mut files: Vec<PathBuf> = std::fs::read_dir(&folder).unwrap().map(|e| e.unwrap().path()).collect();
        files.retain(|f| f.extension().is_some_and(|e| ["glb", "gltf", "vrm"].iter().any(|k| e == *k)));
        files.sort();
        let (mut compared, mut errors) = (0, Errors::default());
        for file in &files {
            // What the importer refuses has no skeleton; plain meshes have none either.
            let Ok(asset) = import(file, &ImportOptions::default()).and_then(riglab_asset::Imported::into_asset) else {
                continue;
            };
            let (rig, _) = asset.rig.normalized();
            comes_back(&tokenizer, rig.skeleton(), &file.display().to_string(), &mut errors);
            compared += 1;
        }
        errors.check();
        assert!(compared >= least, "{compared} of {} files were compared", files.len());
    }
}

#[test]
fn a_sequence_cut_anywhere_is_refused() {
    let options = Options { triangles: 500..=600, ..Options::default() };
    for preset in [Preset::Riglab, Preset::Paper, Preset::UnirigReleased, Preset::SkintokensReleased] {
        let tokenizer = Tokenizer::new(preset.config());
        let (rig, _) = creature(13, 4, &options).rig.normalized();
        let ids = tokenizer.encode(rig.skeleton(), None).unwrap().ids;
        let eos = tokenizer.vocabulary().eos();
        let whole = tokenizer.decode(&ids).unwrap();
        for cut in 0..ids.len() {
            let fault = tokenizer.decode(&ids[..cut]).unwrap_err();
            assert!(matches!(fault, DecodeFault::NoBos | DecodeFault::NoEos), "{preset:?} cut at {cut}: {fault}");
            // With an end behind it, a joint that is not whole is told; what is whole is a smaller tree.
            let mut ended = ids[..cut].to_vec();
            ended.push(eos);
            match tokenizer.decode(&ended) {
                Ok(found) => {
                    found.skeleton().unwrap();
                    assert!(found.joints.len() <= whole.joints.len());
                }
                Err(fault) => assert!(!fault.to_string().is_empty()),
            }
        }
    }
}
