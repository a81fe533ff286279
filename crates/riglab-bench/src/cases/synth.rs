//! A thousand creatures, against the time asked for.
//!
//! Nothing usual makes rigged creatures, so there is no other side: its column holds the bar of a
//! minute, and the ratio is how many times over it is met. Files are made in memory, as `riglab synth`
//! does before it writes them.

use std::time::Instant;

use anyhow::{Result, ensure};
use rayon::prelude::*;
use riglab_synth::{Options, creature};

use super::Context;
use crate::rounds::median;
use crate::row::{Better, Row};

const NAME: &str = "synth/1000";
const COUNT: u64 = 1000;
/// Seconds that making them may take on two threads.
const ASKED: f64 = 60.0;
/// Triangles of a creature on average, at least, for the time to count.
const TRIANGLES: f64 = 5000.0;

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let options = Options::default();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(context.threads).build()?;
    let mut seconds = Vec::new();
    let (mut triangles, mut bytes) = (0, 0);
    for round in 0..context.rounds(3) {
        let start = Instant::now();
        let made = |index| {
            let asset = creature(round as u64, index, &options);
            (asset.rig.mesh().triangles().len(), riglab_asset::to_glb(&asset).len())
        };
        (triangles, bytes) =
            pool.install(|| (0..COUNT).into_par_iter().map(made).reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1)));
        seconds.push(start.elapsed().as_secs_f64());
    }
    let mean = triangles as f64 / COUNT as f64;
    ensure!(mean >= TRIANGLES, "creatures of {mean:.0} triangles on average; the bar is for {TRIANGLES}");
    let note = format!(
        "{} threads, {mean:.0} triangles on average, {:.0} MB of GLB; the other side is the bar, as nothing usual makes \
         such creatures",
        context.threads,
        bytes as f64 / 1e6
    );
    Ok(vec![Row::new(NAME, median(&seconds), ASKED, "s", Better::Lower).bar(1.0).note(note)])
}
