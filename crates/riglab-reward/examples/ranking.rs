//! Do rewards rank true rigs above perturbed ones, and those above broken ones? And which exponents and scale
//! spread them best?
//!
//! `cargo run --release -p riglab-reward --example ranking -- RIGS [RESOLUTION [SEED]]`: a folder of rigged
//! files, and a seed of what is made worse.
//!
//! Perturbed, as where part of a skeleton is misplaced: two joints of three (of two or three joints all but the root)
//! are shifted together, by 60 % of the box's longest side in some direction, with a normal error of 1 %; seven
//! vertices of 150 are held by another joint by a half, and three by nothing. Broken, as a skeleton in other units: all
//! joints at a tenth of their size about a corner of the box, a third of the vertices held by some joint alone, and a
//! third by nothing.

use std::path::Path;

use riglab_asset::{ImportOptions, import};
use riglab_core::Rig;
use riglab_random::{Draw, Stream, stream};
use riglab_reward::{Candidate, Faults, RawWeights, RewardConfig, Rewards, Scorer};

/// What the columns are.
fn names() -> impl Iterator<Item = &'static str> {
    Rewards::PARTS.iter().map(|part| part.name).chain(["total"])
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut args = std::env::args().skip(1);
    let folder = args.next().ok_or("which folder of rigs?")?;
    let resolution = args.next().map_or(Ok(196), |r| r.parse())?;
    let seed: u64 = args.next().map_or(Ok(0), |s| s.parse())?;
    let config = RewardConfig { resolution, ..RewardConfig::default() };
    let mut files: Vec<_> = std::fs::read_dir(folder)?.filter_map(|e| Some(e.ok()?.path())).collect();
    files.sort();
    let mut found: Vec<[Sample; 3]> = Vec::new();
    for (number, file) in files.iter().enumerate() {
        let Some(rig) = read(file) else { continue };
        let rigs = [0, 1, 2].map(|kind| worse(&rig, kind, [seed, number as u64]));
        let scorer = Scorer::new(rig.mesh(), &config);
        let samples =
            rigs.map(|rig| Sample { rewards: scorer.score(&rig), faults: Faults::of(rig.weights(), config.beta) });
        for (part, name) in names().enumerate() {
            let [a, b, c] = [0, 1, 2].map(|kind: usize| samples[kind].parts()[part]);
            if !(a > b && b > c) {
                println!("{name}: {a:.4} {b:.4} {c:.4}: {}", file.display());
            }
        }
        found.push(samples);
    }
    println!(
        "\n{} rigs; true > perturbed > broken, means of each\n\n| reward | ranked | true | perturbed | broken |",
        found.len()
    );
    println!("|---|---|---|---|---|");
    for (part, name) in names().enumerate() {
        let of = |s: &[Sample; 3]| [0, 1, 2].map(|kind: usize| s[kind].parts()[part]);
        print_row(name, &found, of);
    }
    println!("\n| constant | ranked | true | perturbed | broken |\n|---|---|---|---|---|");
    for exponent in [0.125, 0.25, 0.5, 1.0, 2.0] {
        let of = |s: &[Sample; 3]| {
            [0, 1, 2].map(|k: usize| {
                let Faults { unbound, crowded } = s[k].faults;
                1.0 - 0.5 * unbound.powf(exponent) - 0.5 * crowded.powf(exponent)
            })
        };
        print_row(&format!("α_z = α_m = {exponent}"), &found, of);
    }
    for scale in [0.003, 0.01, 0.03, 0.1, 0.3, 1.0] {
        // The stretch, from the reward at the config's scale.
        let of = |s: &[Sample; 3]| {
            [0, 1, 2].map(|k: usize| {
                let stretch = (1.0 / s[k].rewards.motion - 1.0) / config.stretch_scale;
                1.0 / (1.0 + scale * stretch)
            })
        };
        print_row(&format!("s = {scale}"), &found, of);
    }
    Ok(())
}

struct Sample {
    rewards: Rewards,
    faults: Faults,
}

impl Sample {
    /// All of them, then their total.
    fn parts(&self) -> Vec<f64> {
        self.rewards.parts().into_iter().chain([self.rewards.total]).collect()
    }
}

fn print_row(name: &str, found: &[[Sample; 3]], of: impl Fn(&[Sample; 3]) -> [f64; 3]) {
    let values: Vec<[f64; 3]> = found.iter().map(of).collect();
    let n = values.len() as f64;
    let ranked = values.iter().filter(|[a, b, c]| a > b && b > c).count() as f64 / n;
    let mean = |k: usize| values.iter().map(|v| v[k]).sum::<f64>() / n;
    println!("| {name} | {:.1} % | {:.3} | {:.3} | {:.3} |", 100.0 * ranked, mean(0), mean(1), mean(2));
}

fn read(file: &Path) -> Option<Rig> {
    let imported = import(file, &ImportOptions::default()).ok()?;
    Some(imported.rig()?.normalized().0)
}

fn normal(random: &mut Stream) -> f64 {
    // Twelve uniform numbers have a variance of 1.
    (0..12).map(|_| f64::from(random.unit())).sum::<f64>() - 6.0
}

/// The rig as it is, perturbed or broken.
fn worse(rig: &Rig, kind: u8, [seed, number]: [u64; 2]) -> Candidate {
    let sound = Candidate::of(rig);
    let mut random = stream(seed, "example/ranking", &[number, u64::from(kind)]);
    let joints = sound.heads().len();
    let bounds = rig.bounds();
    let way = [(); 3].map(|()| normal(&mut random));
    let length = way.iter().map(|x| x * x).sum::<f64>().sqrt();
    let shift = way.map(|x| 1.2 * x / length);
    let heads = sound.heads().iter().enumerate().map(|(j, head)| match kind {
        0 => *head,
        1 if j % 3 == 0 && joints > 1 => *head,
        1 => std::array::from_fn(|k| head[k] + shift[k] + 0.02 * normal(&mut random)),
        _ => std::array::from_fn(|k| f64::from(bounds.max[k]) + 0.1 * head[k]),
    });
    let heads = heads.collect();
    let rows = (0..sound.weights().rows()).map(|v| {
        let (columns, weights) = sound.weights().row(v);
        let row: Vec<(u16, f64)> = columns.iter().copied().zip(weights.iter().copied()).collect();
        let other = random.below(joints) as u16;
        match (kind, v % 150) {
            (1, 0..3) | (2, 0..50) => row.into_iter().map(|(j, w)| (j, 0.05 * w)).collect(),
            (1, 3..10) => {
                let mut mixed: Vec<(u16, f64)> = row.into_iter().map(|(j, w)| (j, 0.5 * w)).collect();
                match mixed.iter_mut().find(|(j, _)| *j == other) {
                    Some((_, w)) => *w += 0.5,
                    None => mixed.push((other, 0.5)),
                }
                mixed
            }
            (2, 50..100) => vec![(other, 1.0)],
            _ => row,
        }
    });
    let weights = RawWeights::new(rows.collect::<Vec<_>>());
    Candidate::new(heads, sound.parents().to_vec(), weights).expect("a changed rig is a candidate")
}
