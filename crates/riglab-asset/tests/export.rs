//! What is written reads back: every rig, written in every way.

mod common;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use riglab_asset::export::{self, ExportOptions, Influences, JointFrames};
use riglab_asset::{Binding, ImportOptions, Imported, VertexSet, import, import_bytes};
use riglab_core::{JointId, Rig, SkinWeights, Vec3};

/// Weights after normalisation.
const WEIGHT: f32 = 1e-6;

const ALL: ExportOptions = ExportOptions { influences: Influences::All, frames: JointFrames::Parallel };

/// What went wrong with a file, if anything.
type Check = fn(&Path, &Imported, &Rig) -> Result<(), String>;

/// Runs a check over all rigs, on all cores.
fn over_all_rigs(check: Check) {
    let folders =
        [("RIGLAB_RIGS", "rigs"), ("RIGLAB_RIGS_ORIGINAL", "rigs_original"), ("RIGLAB_RIGS_HARD", "rigs_hard")];
    let folders = folders.into_iter().filter_map(|(variable, name)| common::data(variable, name));
    let mut files: Vec<PathBuf> = folders.flat_map(|folder| common::files(&folder, &["glb", "gltf", "vrm"])).collect();
    // Made to be refused.
    let refused = |name: &str| name.starts_with("malformed_") || name.starts_with("reject_");
    files.retain(|f| !f.file_name().is_some_and(|name| refused(&name.to_string_lossy())));
    let next = AtomicUsize::new(0);
    let wrong = Mutex::new(BTreeMap::new());
    let work = || {
        while let Some(path) = files.get(next.fetch_add(1, Ordering::Relaxed)) {
            let imported = import(path, &ImportOptions::default()).unwrap();
            if let Some(Err(fault)) = imported.rig().map(|rig| check(path, &imported, rig)) {
                wrong.lock().unwrap().insert(path.clone(), fault);
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..std::thread::available_parallelism().map_or(1, usize::from) {
            scope.spawn(work);
        }
    });
    let wrong = wrong.into_inner().unwrap();
    let told: Vec<String> = wrong.iter().map(|(path, fault)| format!("{}: {fault}", path.display())).collect();
    println!("{} of {} files as they should be", files.len() - told.len(), files.len());
    assert!(told.is_empty(), "{} of {} files differ:\n{}", told.len(), files.len(), told.join("\n"));
}

fn read(bytes: &[u8]) -> Result<Imported, String> {
    import_bytes("back.glb", bytes, &ImportOptions::default()).map_err(|e| e.to_string())
}

/// In what two rigs differ; positions must be equal bit for bit.
fn compare(back: &Rig, rig: &Rig) -> Result<(), String> {
    same_skeletons(back, rig)?;
    if back.mesh().triangles() != rig.mesh().triangles() {
        return Err("other triangles".into());
    }
    if bits(back.mesh().positions()) != bits(rig.mesh().positions()) {
        let pairs = bits(back.mesh().positions()).into_iter().zip(bits(rig.mesh().positions()));
        let off = pairs.filter(|(a, b)| a != b).count();
        return Err(format!("{off} positions of {} differ", rig.mesh().positions().len()));
    }
    (0..rig.weights().rows()).try_for_each(|v| same_rows(back, v, rig, v))
}

fn bits(positions: &[[f32; 3]]) -> Vec<[u32; 3]> {
    positions.iter().map(|p| p.map(f32::to_bits)).collect()
}

fn same_skeletons(back: &Rig, rig: &Rig) -> Result<(), String> {
    let (a, b) = (back.skeleton(), rig.skeleton());
    if (a.names(), a.parents()) != (b.names(), b.parents()) {
        return Err("other joints".into());
    }
    // Heads are sums of f32 in f64: equal, but for those a billion times nearer to 0 than their parents.
    let most = 1e-9 * rig.bounds().diagonal();
    let off = |(a, b): (&[f32; 3], &[f32; 3])| (0..3).any(|k| (a[k] - b[k]).abs() > most);
    match a.heads().iter().zip(b.heads()).position(off) {
        Some(joint) => Err(format!("head of joint {joint} is {:?}, not {:?}", a.heads()[joint], b.heads()[joint])),
        None => Ok(()),
    }
}

fn same_rows(back: &Rig, at: usize, rig: &Rig, v: usize) -> Result<(), String> {
    let mut joints: BTreeMap<JointId, f32> = back.weights().row(at).collect();
    for (joint, weight) in rig.weights().row(v) {
        *joints.entry(joint).or_default() -= weight;
    }
    match joints.iter().find(|(_, off)| off.abs() > WEIGHT) {
        Some((joint, off)) => Err(format!("weight of joint {} on vertex {v} off by {off:e}", joint.0)),
        None => Ok(()),
    }
}

/// Vertices that stay together, in their order: a vertex set.
struct Block {
    first: usize,
    positions: Vec<[u32; 3]>,
    triangles: Vec<[u32; 3]>,
}

fn blocks(of: &Imported) -> Vec<Block> {
    let mesh = of.mesh();
    let mut sets: Vec<_> = of.reading.vertex_sets.iter().collect();
    sets.sort_by_key(|set| set.binding == Binding::Rigid);
    let mut first = 0;
    let own = |set: &VertexSet| {
        let range = first..first + set.positions.len();
        first = range.end;
        let inside = |t: &&[u32; 3]| range.contains(&(t[0] as usize));
        let local = |t: &[u32; 3]| t.map(|v| v - range.start as u32);
        Block {
            first: range.start,
            positions: bits(&mesh.positions()[range.clone()]),
            triangles: mesh.triangles().iter().filter(inside).map(local).collect(),
        }
    };
    sets.into_iter().map(own).collect()
}

/// Where each block of the original, moved `by` so much, is in what came back, whatever their order; nothing twice.
fn matched(back: &Imported, original: &Imported, by: Vec3) -> Result<Vec<(Block, Block)>, String> {
    let mut left = blocks(back);
    let find = |block: Block| {
        let same = |b: &Block| b.positions == block.positions && b.triangles == block.triangles;
        match left.iter().position(same) {
            Some(at) => Ok((left.remove(at), block)),
            None => Err(format!("{} vertices from {} on are not there", block.positions.len(), block.first)),
        }
    };
    // Bit for bit where nothing is shown elsewhere: 0 added would make 0 of -0.
    let moved = |p: [u32; 3]| match by == [0.0; 3] {
        true => p,
        false => std::array::from_fn(|k| (f32::from_bits(p[k]) + by[k]).to_bits()),
    };
    let shown = |block: Block| Block { positions: block.positions.into_iter().map(moved).collect(), ..block };
    blocks(original).into_iter().map(shown).map(find).collect()
}

#[test]
fn unchanged_rigs_read_back_from_their_own_documents() {
    over_all_rigs(|path, imported, rig| {
        let exported = export::onto(path, imported, rig, &ALL).map_err(|e| e.to_string())?;
        compare(read(&exported.bytes)?.rig().ok_or("no rig")?, rig)
    });
}

#[test]
fn rigs_alone_read_back() {
    over_all_rigs(|_, imported, rig| {
        let exported = export::alone("back", rig, &imported.provenance, &ALL).map_err(|e| e.to_string())?;
        compare(read(&exported.bytes)?.rig().ok_or("no rig")?, rig)
    });
}

#[test]
fn new_skeletons_read_back_from_old_documents() {
    over_all_rigs(|path, imported, rig| {
        let new = common::renamed(rig);
        let exported = export::onto(path, imported, &new, &ALL).map_err(|e| e.to_string())?;
        let back = read(&exported.bytes)?;
        let rig = back.rig().ok_or("no rig")?;
        same_skeletons(rig, &new)?;
        // Rigid parts are bound like all else now, so their vertices may come earlier.
        for (a, b) in matched(&back, imported, [0.0; 3])? {
            (0..b.positions.len()).try_for_each(|v| same_rows(rig, a.first + v, &new, b.first + v))?;
        }
        Ok(())
    });
}

#[test]
fn stripped_files_show_the_rest_pose_and_can_be_rigged_again() {
    over_all_rigs(|path, imported, rig| {
        let bare = export::strip(path, &ImportOptions::default()).map_err(|e| e.to_string())?;
        let stripped = read(&bare.bytes)?;
        if !stripped.reading.joints.is_empty() {
            return Err("joints are left".into());
        }
        // Meshes that hung on no joint are there, too; here they go with the root.
        let mut rows = vec![vec![(0u16, 1.0)]; stripped.mesh().positions().len()];
        for (a, b) in matched(&stripped, imported, imported.reading.shown_off)? {
            for v in 0..b.positions.len() {
                rows[a.first + v] = rig.weights().row(b.first + v).map(|(j, w)| (j.0, w.into())).collect();
            }
        }
        let weights = SkinWeights::normalized(rows).unwrap();
        let rig = Rig::new(rig.skeleton().clone(), stripped.mesh().clone(), weights).unwrap();
        let again = export::onto_bytes("back.glb", &bare.bytes, None, &stripped, &rig, &ALL);
        let again = again.map_err(|e| e.to_string())?;
        compare(read(&again.bytes)?.rig().ok_or("no rig")?, &rig)
    });
}
