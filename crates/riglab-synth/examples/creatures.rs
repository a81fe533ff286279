//! Makes creatures of each plan, prints what they are like, and draws them.
//!
//! `cargo run --release -p riglab-synth --example creatures -- FOLDER [SEED [COUNT [PLAN,..]]]` draws COUNT
//! creatures of each plan onto one sheet a plan and writes their GLB files beside it; with COUNT 0 it
//! only times and counts 1,000 creatures of the default mixture.

use std::path::PathBuf;
use std::time::Instant;

use riglab_core::Asset;
use riglab_render::{Theme, View, contact_sheet, render_mesh, render_parts, render_skeleton};
use riglab_synth::{Options, Plan, creatures};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let folder = PathBuf::from(args.first().map_or("gallery", String::as_str));
    let seed = args.get(1).map_or(Ok(1), |s| s.parse())?;
    let count = args.get(2).map_or(Ok(6), |s| s.parse())?;
    std::fs::create_dir_all(&folder)?;
    println!("{:<12} {:>4} {:>13} {:>7} {:>7} {:>6}", "plan", "n", "joints", "tris", "sparse", "infl");
    if count == 0 {
        let start = Instant::now();
        let all = creatures(seed, 0..1000, &Options::default());
        report("mixture", &all);
        println!("{:.1} s on {} threads", start.elapsed().as_secs_f64(), std::thread::available_parallelism()?);
        return Ok(());
    }
    let plans: Vec<Plan> = match args.get(3) {
        Some(names) => names.split(',').map(str::parse).collect::<Result<_, _>>()?,
        None => Plan::ALL.to_vec(),
    };
    for plan in plans {
        let made = creatures(seed, 0..count, &Options { plans: vec![plan], ..Options::default() });
        report(plan.name(), &made);
        let mut cells = Vec::new();
        for asset in &made {
            let view = View::square(300).framed(asset.rig.bounds());
            let facts = format!("{} j {} t", asset.rig.skeleton().len(), asset.rig.mesh().triangles().len());
            cells.push((facts, render_mesh(asset.rig.mesh(), &view)));
            cells.push((String::new(), render_skeleton(&asset.rig, &view.clone().turned(-60.0, 20.0))));
            cells.push((asset.name.clone(), render_parts(&asset.rig, &view)));
            std::fs::write(folder.join(format!("{}.glb", asset.name)), riglab_asset::to_glb(asset))?;
        }
        let sheet = contact_sheet(&cells, 6, Theme::Light);
        std::fs::write(folder.join(format!("{}.png", plan.name())), sheet.to_png())?;
    }
    Ok(())
}

/// Joints, triangles, share of weights that are not zero in percent, influences a vertex.
fn report(name: &str, made: &[Asset]) {
    let n = made.len() as f64;
    let joints: Vec<usize> = made.iter().map(|a| a.rig.skeleton().len()).collect();
    let mean = |of: &dyn Fn(&Asset) -> f64| made.iter().map(of).sum::<f64>() / n;
    let triangles = mean(&|a| a.rig.mesh().triangles().len() as f64);
    let influences = mean(&|a| a.rig.weights().nonzero() as f64 / a.rig.weights().rows() as f64);
    let sparsity =
        mean(&|a| a.rig.weights().nonzero() as f64 / (a.rig.weights().rows() * a.rig.skeleton().len()) as f64);
    println!(
        "{name:<12} {:>4} {:>3} {:>4.1} {:>4} {triangles:>7.0} {:>7.2} {influences:>6.2}",
        made.len(),
        joints.iter().min().unwrap_or(&0),
        joints.iter().sum::<usize>() as f64 / n,
        joints.iter().max().unwrap_or(&0),
        100.0 * sparsity,
    );
}
