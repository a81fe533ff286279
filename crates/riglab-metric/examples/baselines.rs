//! Weights without learning, by straight distances and by those through the body, on real rigs.
//!
//! `cargo run --release -p riglab-metric --example baselines -- RIGS [SPLIT]`: a folder of rigged files with a
//! `split.json`, and which part of it (`test` unless told). Prints SkinTokens' metrics pooled over the rigs,
//! with the geodesic distances' share of the time.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::{Duration, Instant};

use riglab_asset::{ImportOptions, import};
use riglab_core::{JointId, Rig};
use riglab_geom::voxel::SolidConfig;
use riglab_metric::{Baseline, SkinTally, bone_distances, geodesic_distances};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let folder = args.next().ok_or("which folder of rigs?")?;
    let split = args.next().unwrap_or_else(|| "test".into());
    let splits: BTreeMap<String, Vec<String>> =
        serde_json::from_str(&std::fs::read_to_string(Path::new(&folder).join("split.json"))?)?;
    let names = splits.get(&split).ok_or("no such split")?;
    let powers = [1, 2, 3, 4, 6, 8, 12, 16];
    let cuts = [0.05f32, 0.1, 0.15].into_iter();
    let cut = cuts.flat_map(|cut| powers.map(|power| Baseline::InverseCut { power, cut }));
    let rules: Vec<Baseline> =
        std::iter::once(Baseline::Nearest).chain(powers.map(|power| Baseline::Inverse { power })).chain(cut).collect();
    let mut sums = vec![[SkinTally::default(), SkinTally::default()]; rules.len()];
    let (mut time, mut rigs) = (Duration::ZERO, 0);
    for name in names {
        let Ok(imported) = import(Path::new(&folder).join(name), &ImportOptions::default()) else { continue };
        let Some(rig) = imported.rig() else { continue };
        let (rig, _) = rig.normalized();
        let joints = rig.skinned_joints(0.0);
        let truth = dense(&rig, &joints);
        let straight = bone_distances(&rig, &joints);
        let start = Instant::now();
        let ways = geodesic_distances(rig.mesh(), rig.skeleton(), &joints, &SolidConfig::default());
        let took = start.elapsed();
        if took.as_secs_f64() > 1.0 {
            println!(
                "{name}: {:.2} s, {} vertices, {} bones",
                took.as_secs_f64(),
                rig.mesh().positions().len(),
                joints.len()
            );
        }
        (time, rigs) = (time + took, rigs + 1);
        for (sums, rule) in sums.iter_mut().zip(&rules) {
            for (sum, distances) in sums.iter_mut().zip([&straight, &ways]) {
                sum.add(&SkinTally::of(&truth, &rule.weights(distances, joints.len()), joints.len()));
            }
        }
    }
    println!("{rigs} rigs of {split}; geodesic distances {:.3} s a rig", time.as_secs_f64() / f64::from(rigs));
    println!("| rule | distance | IoU | L1 | precision | recall |\n|---|---|---|---|---|---|");
    for (sums, rule) in sums.iter().zip(&rules) {
        for (sum, kind) in sums.iter().zip(["straight", "geodesic"]) {
            let m = sum.metrics();
            println!(
                "| {} | {kind} | {:.4} | {:.5} | {:.3} | {:.3} |",
                rule.name(),
                m.iou,
                m.l1,
                m.precision,
                m.recall
            );
        }
    }
    Ok(())
}

fn dense(rig: &Rig, joints: &[JointId]) -> Vec<f32> {
    let mut table = vec![0.0; rig.weights().rows() * joints.len()];
    for (v, row) in table.chunks_exact_mut(joints.len().max(1)).enumerate() {
        for (joint, w) in rig.weights().row(v) {
            if let Ok(at) = joints.binary_search(&joint) {
                row[at] = w;
            }
        }
    }
    table
}
