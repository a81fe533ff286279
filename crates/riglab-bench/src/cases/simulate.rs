//! Spring bones over 300 frames, against three-vrm in Node.
//!
//! The rig is a creature's with the most spring bones of some, colliders included, and its body is shaken. Both sides get
//! the body's motion as numbers; skinning and drawing are no part of it. Node's side updates what three-vrm's
//! manager does; riglab's takes bones' lengths as that does, so that tails can be compared.

use std::time::Instant;

use anyhow::{Context as _, Result, ensure};
use glam::DAffine3;
use riglab_core::{Rig, Shape};
use riglab_simulate::{Lengths, Motion, MotionKind, Simulation, generate};
use riglab_synth::{Options, Plan, creature};
use serde::Deserialize;
use serde_json::{Value, json};

use super::Context;
use crate::node;
use crate::rounds::in_turn;
use crate::row::{Better, Row};
use crate::side;

const FRAMES: usize = 300;
const SECONDS: f64 = 1.0 / 60.0;
/// The same creatures on both sides.
const SEED: u64 = 7;
const CREATURES: u64 = 24;
/// Played so often a round.
const TIMES: usize = 10;
/// How far tails may be apart, in metres; bones are centimetres long.
const APART: f64 = 1e-6;

#[derive(Deserialize)]
struct Played {
    seconds: f64,
    /// Where each tail is at the end.
    tails: Vec<f64>,
}

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let rig = rig()?;
    let (mut ours, mut theirs) = (context.ours("simulate")?, node::start("Node", "simulate.mjs")?);
    for side in [&mut ours, &mut theirs] {
        side.ask::<Value>(&json!({"do": "load", "scene": scene(&rig)}))?;
    }
    let ask = json!({"do": "play", "times": TIMES});
    // The first time warms up: JavaScript is compiled while it runs.
    let (a, b): (Played, Played) = (ours.ask(&ask)?, theirs.ask(&ask)?);
    let apart = a.tails.iter().zip(&b.tails).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
    ensure!(a.tails.len() == b.tails.len() && apart <= APART, "tails are {apart:.1e} m apart at the end");
    let found = in_turn(
        context.rounds(7),
        || Ok(1e3 * ours.ask::<Played>(&ask)?.seconds / TIMES as f64),
        || Ok(1e3 * theirs.ask::<Played>(&ask)?.seconds / TIMES as f64),
    )?;
    let (a, b) = found.medians();
    let springs = rig.springs();
    let note = format!(
        "{FRAMES} frames of {} joints, {} of which swing, {} colliders; {}",
        rig.skeleton().len(),
        Simulation::new(rig.skeleton(), springs).swinging(),
        springs.colliders().len(),
        found.spread()
    );
    Ok(vec![Row::new("simulate/300", a, b, "ms", Better::Lower).note(note)])
}

/// The creature with the most bones that swing.
fn rig() -> Result<Rig> {
    let options = Options { plans: vec![Plan::Anime], triangles: 500..=800 };
    let all = (0..CREATURES).map(|k| creature(SEED, k, &options).rig);
    let swinging = |rig: &Rig| Simulation::new(rig.skeleton(), rig.springs()).swinging();
    all.max_by_key(swinging).context("some creatures")
}

/// The maps of the body's motion; all joints have the same.
fn poses(rig: &Rig) -> Vec<DAffine3> {
    let motion = Motion { kind: MotionKind::Shake, seconds: (FRAMES - 1) as f64 * SECONDS, rate: 60.0, seed: SEED };
    let clip = generate(rig, &motion);
    (0..FRAMES).map(|frame| DAffine3::from_translation(clip.frame(frame)[0].translation.as_dvec3())).collect()
}

/// What `simulate.mjs` reads.
fn scene(rig: &Rig) -> Value {
    let (skeleton, springs) = (rig.skeleton(), rig.springs());
    let bones = springs.springs().iter().flat_map(|spring| {
        spring.joints.iter().filter_map(move |j| {
            let s = j.swing;
            Some(json!({
                "joint": j.joint.0, "tail": j.tail?, "stiffness": s.stiffness, "drag": s.drag, "power": s.gravity_power,
                "direction": s.gravity_direction, "radius": s.hit_radius, "groups": spring.groups,
            }))
        })
    });
    let collider = |&c: &usize| {
        let collider = springs.colliders()[c];
        match collider.shape {
            Shape::Sphere { center, radius } => json!({"joint": collider.joint.0, "from": center, "radius": radius}),
            Shape::Capsule { from, to, radius } => {
                json!({"joint": collider.joint.0, "from": from, "to": to, "radius": radius})
            }
        }
    };
    let groups = springs.groups().iter().map(|g| g.iter().map(collider).collect::<Vec<_>>());
    json!({
        "parents": skeleton.parents().iter().map(|p| p.map_or(-1, |p| i32::from(p.0))).collect::<Vec<_>>(),
        "heads": skeleton.heads(), "springs": bones.collect::<Vec<_>>(), "groups": groups.collect::<Vec<_>>(),
        "dt": SECONDS, "shifts": poses(rig).iter().map(|m| m.translation.to_array()).collect::<Vec<_>>(),
    })
}

#[derive(Deserialize)]
#[serde(tag = "do", rename_all = "snake_case")]
enum Request {
    /// riglab makes the scene itself.
    Load {},
    Play {
        times: usize,
    },
}

/// riglab's side.
pub fn serve() -> Result<()> {
    let rig = rig()?;
    let poses: Vec<Vec<DAffine3>> = poses(&rig).into_iter().map(|map| vec![map; rig.skeleton().len()]).collect();
    side::serve(|request| match request {
        Request::Load {} => Ok(json!(poses.len())),
        Request::Play { times } => {
            let mut simulation = Simulation::new(rig.skeleton(), rig.springs()).with_lengths(Lengths::Lagging);
            let start = Instant::now();
            for _ in 0..times {
                simulation.reset(&vec![DAffine3::IDENTITY; rig.skeleton().len()])?;
                for pose in &poses {
                    simulation.step(pose, SECONDS)?;
                }
            }
            let seconds = start.elapsed().as_secs_f64();
            let all = rig.springs().springs().iter().flat_map(|s| &s.joints);
            let tails = all.filter_map(|j| {
                let tail = glam::Vec3::from(j.tail?).as_dvec3();
                Some(simulation.maps()[j.joint.index()].transform_point3(tail).to_array())
            });
            Ok(json!({"seconds": seconds, "tails": tails.flatten().collect::<Vec<f64>>()}))
        }
    })
}
