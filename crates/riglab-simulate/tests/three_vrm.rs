//! Against three-vrm, an independent implementation of VRM's spring bones: 300 frames of random scenes.
//!
//! `tests/three/recorded.json` holds what the npm package said, so that this is checked without Node. Where Node
//! and the package are there (`RIGLAB_NODE_MODULES` names a `node_modules` with `@pixiv/three-vrm-springbone` and
//! `three`), it is asked again, every frame of it. `RIGLAB_RECORD=1` writes the file anew.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use glam::{DAffine3, DQuat, DVec3};
use riglab_core::{Collider, Joint, JointId, Shape, Skeleton, Spring, SpringJoint, Springs, Swing, Vec3};
use riglab_random::{Draw, Stream, stream};
use riglab_simulate::{Lengths, Simulation};
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};

const FRAMES: usize = 300;
/// Frames that are recorded: one in so many.
const EVERY: usize = 30;
const SCENES: u64 = 8;
/// How far a tail may be from where the package says it is, as a share of its bone's length: rounding alone.
const ASKED: f64 = 1e-12;
/// The same of what was recorded, which is rounded to a ten-millionth of a metre; bones are some centimetres long.
const RECORDED: f64 = 5e-6;
/// Another rule for a bone's length differs by more.
const APART: f64 = 1e-3;

/// A body of a few joints that is thrown about, with chains that swing.
struct Scene {
    skeleton: Skeleton,
    springs: Springs,
    seconds: f64,
    /// Shift of the first joint and turns of some.
    frames: Vec<(DVec3, Vec<(usize, DQuat)>)>,
}

fn point(draw: &mut Stream, reach: f32) -> Vec3 {
    std::array::from_fn(|_| draw.within(-reach, reach))
}

fn unit(draw: &mut Stream) -> DVec3 {
    let p = DVec3::from(point(draw, 1.0).map(f64::from));
    p.try_normalize().unwrap_or(DVec3::Y)
}

impl Scene {
    fn new(seed: u64) -> Self {
        let mut draw = stream(seed, "three-vrm", &[]);
        let mut joints = vec![Joint { name: "0".into(), parent: None, head: point(&mut draw, 0.2) }];
        let add = |joints: &mut Vec<Joint>, parent: usize, by: Vec3| {
            let head = std::array::from_fn(|k| joints[parent].head[k] + by[k]);
            joints.push(Joint { name: joints.len().to_string(), parent: Some(JointId(parent as u16)), head });
            joints.len() - 1
        };
        let body: Vec<usize> = (0..3).map(|k| add(&mut joints, k, [0.0, 0.3, draw.within(-0.1, 0.1)])).collect();
        let mut springs = Vec::new();
        for _ in 0..3 + draw.below(3) {
            let mut above = body[draw.below(body.len())];
            let way = unit(&mut draw).as_vec3();
            let length = draw.within(0.05, 0.2);
            let mut own = Vec::new();
            let count = 1 + draw.below(4);
            let mut tails = Vec::new();
            above = add(&mut joints, above, (0.1 * way).into());
            for _ in 0..count {
                own.push(above);
                let bend = glam::Vec3::from(point(&mut draw, 0.3));
                let next = (length * (way + bend)).into();
                above = add(&mut joints, above, next);
                tails.push(joints[above].head);
            }
            let swing = Swing {
                stiffness: draw.within(0.0, 3.0),
                drag: draw.within(0.05, 0.9),
                gravity_power: draw.within(0.0, 1.5),
                gravity_direction: unit(&mut draw).as_vec3().into(),
                hit_radius: draw.within(0.0, 0.05),
            };
            let joint = |(joint, tail): (&usize, &Vec3)| SpringJoint {
                joint: JointId(*joint as u16),
                tail: Some(*tail),
                swing,
            };
            let joints = own.iter().zip(&tails).map(joint).collect();
            let groups = if draw.chance(0.7) { vec![draw.below(2)] } else { vec![] };
            let center = draw.chance(0.3).then(|| JointId(draw.below(3) as u16));
            springs.push(Spring { name: String::new(), joints, groups, center });
        }
        let colliders: Vec<Collider> = (0..4)
            .map(|k| {
                let joint = JointId(draw.below(4) as u16);
                let near = joints[joint.index()].head;
                let mut at = || std::array::from_fn(|k| near[k] + draw.within(-0.15, 0.15));
                let (from, to) = (at(), at());
                let radius = draw.within(0.03, 0.12);
                let ball = Shape::Sphere { center: from, radius };
                Collider { joint, shape: if k % 2 == 0 { ball } else { Shape::Capsule { from, to, radius } } }
            })
            .collect();
        let springs = Springs::new(springs, colliders, vec![vec![0, 1], vec![2, 3]]).unwrap();
        let wave = |draw: &mut Stream| (f64::from(draw.within(0.3, 2.5)), f64::from(draw.within(0.0, 6.3)));
        let (sway, axes) = (0.2, [unit(&mut draw), unit(&mut draw)]);
        let waves: Vec<(f64, f64)> = (0..5).map(|_| wave(&mut draw)).collect();
        let seconds = 1.0 / if seed.is_multiple_of(2) { 60.0 } else { 30.0 };
        let frame = |f: usize| {
            // From rest, without a jump.
            let time = f as f64 * seconds;
            let of = |k: usize| {
                (libm::sin(waves[k].0 * std::f64::consts::TAU * time + waves[k].1) - libm::sin(waves[k].1))
                    * time.min(1.0)
            };
            let shift = sway * DVec3::new(of(0), of(1), of(2));
            let turn = |axis: DVec3, angle: f64| {
                let (sin, cos) = (libm::sin(0.5 * angle), libm::cos(0.5 * angle));
                DQuat::from_xyzw(axis.x * sin, axis.y * sin, axis.z * sin, cos)
            };
            (shift, vec![(0, turn(axes[0], 0.8 * of(3))), (2, turn(axes[1], 0.5 * of(4)))])
        };
        Self { skeleton: Skeleton::new(joints).unwrap(), springs, seconds, frames: (0..FRAMES).map(frame).collect() }
    }

    fn json(&self) -> Value {
        let of = |s: &Spring, j: &SpringJoint| {
            json!({
                "joint": j.joint.0, "tail": j.tail, "stiffness": j.swing.stiffness, "drag": j.swing.drag,
                "power": j.swing.gravity_power, "direction": j.swing.gravity_direction, "radius": j.swing.hit_radius,
                "groups": s.groups, "center": s.center.map_or(-1, |c| i32::from(c.0)),
            })
        };
        let springs: Vec<Value> =
            self.springs.springs().iter().flat_map(|s| s.joints.iter().map(|j| of(s, j))).collect();
        let collider = |c: &usize| {
            let Collider { joint, shape } = self.springs.colliders()[*c];
            match shape {
                Shape::Sphere { center, radius } => json!({"joint": joint.0, "from": center, "radius": radius}),
                Shape::Capsule { from, to, radius } => {
                    json!({"joint": joint.0, "from": from, "to": to, "radius": radius})
                }
            }
        };
        let groups: Vec<Vec<Value>> = self.springs.groups().iter().map(|g| g.iter().map(collider).collect()).collect();
        let frame = |(shift, turns): &(DVec3, Vec<(usize, DQuat)>)| {
            let turns: Vec<_> = turns.iter().map(|(joint, q)| json!([joint, q.to_array()])).collect();
            json!({"shift": shift.to_array(), "turns": turns})
        };
        json!({
            "parents": self.skeleton.parents().iter().map(|p| p.map_or(-1, |p| i32::from(p.0))).collect::<Vec<_>>(),
            "heads": self.skeleton.heads(), "springs": springs, "groups": groups, "dt": self.seconds,
            "frames": self.frames.iter().map(frame).collect::<Vec<_>>(),
        })
    }

    /// The maps of a frame, from rest.
    fn pose(&self, frame: usize) -> Vec<DAffine3> {
        let (shift, turns) = &self.frames[frame];
        let mut maps: Vec<DAffine3> = Vec::new();
        for joint in self.skeleton.ids() {
            let head = glam::Vec3::from(self.skeleton.head(joint)).as_dvec3();
            let turn = turns.iter().find(|(j, _)| *j == joint.index()).map_or(DQuat::IDENTITY, |(_, q)| *q);
            let local = DAffine3::from_rotation_translation(turn, head - turn * head);
            let above = self.skeleton.parent(joint).map(|p| maps[p.index()]);
            maps.push(above.unwrap_or(DAffine3::from_translation(*shift)) * local);
        }
        maps
    }

    /// Length of each bone that swings.
    fn bones(&self) -> Vec<(usize, DVec3, f64)> {
        let all = self.springs.springs().iter().flat_map(|s| &s.joints);
        all.map(|j| {
            let tail = glam::Vec3::from(j.tail.unwrap()).as_dvec3();
            let head = glam::Vec3::from(self.skeleton.head(j.joint)).as_dvec3();
            (j.joint.index(), tail, tail.distance(head))
        })
        .collect()
    }

    /// The largest distance of a tail from where they say it is, in lengths of its bone.
    fn compare(&self, theirs: &Tails, every: usize, lengths: Lengths) -> f64 {
        let mut simulation = Simulation::new(&self.skeleton, &self.springs).with_lengths(lengths);
        let bones = self.bones();
        let mut worst: f64 = 0.0;
        for frame in 0..FRAMES {
            let maps = simulation.step(&self.pose(frame), self.seconds).unwrap();
            if frame % every != every - 1 {
                continue;
            }
            let row = &theirs.0[frame / every];
            assert_eq!(row.len(), 3 * bones.len());
            for ((joint, tail, length), their) in bones.iter().zip(row.chunks_exact(3)) {
                let off = maps[*joint].transform_point3(*tail).distance(DVec3::from_slice(their));
                assert!(off.is_finite());
                worst = worst.max(off / length);
            }
        }
        worst
    }
}

/// By frame, of each spring x, y and z.
#[derive(Serialize, Deserialize)]
struct Tails(Vec<Vec<f64>>);

#[derive(Serialize, Deserialize)]
struct Recorded {
    package: String,
    /// By scene: bones of their length, and as the manager measures them.
    scenes: Vec<[Tails; 2]>,
}

#[derive(Deserialize)]
struct Reply {
    package: String,
    tails: Tails,
}

const KINDS: [(&str, Lengths); 2] = [("", Lengths::Rest), ("manager", Lengths::Lagging)];

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/three")
}

fn ask(modules: &Path, scene: &Scene, kind: &str) -> Reply {
    let mut command = Command::new("node");
    command.arg(folder().join("run.mjs")).arg(kind).env("RIGLAB_NODE_MODULES", modules);
    let mut child = command.stdin(Stdio::piped()).stdout(Stdio::piped()).stderr(Stdio::null()).spawn().unwrap();
    child.stdin.take().unwrap().write_all(scene.json().to_string().as_bytes()).unwrap();
    serde_json::from_slice(&child.wait_with_output().unwrap().stdout).expect("node answers")
}

#[test]
fn recorded_frames_agree() {
    let text = std::fs::read_to_string(folder().join("recorded.json")).unwrap();
    let recorded: Recorded = serde_json::from_str(&text).unwrap();
    assert_eq!(recorded.scenes.len() as u64, SCENES);
    for (seed, theirs) in recorded.scenes.iter().enumerate() {
        let scene = Scene::new(seed as u64);
        for ((_, lengths), tails) in KINDS.iter().zip(theirs) {
            let worst = scene.compare(tails, EVERY, *lengths);
            println!("{}, scene {seed}: off by {worst:.2e} of a bone at most", recorded.package);
            assert!(worst <= RECORDED, "{}, scene {seed}: off by {worst:.2e} of a bone", recorded.package);
        }
        // The scene moves what swings, so that agreement means something.
        let swap = scene.compare(&theirs[0], EVERY, Lengths::Lagging);
        assert!(swap > APART, "scene {seed}: {swap:.2e}");
    }
}

#[test]
fn the_package_agrees_in_every_frame() {
    let modules = std::env::var_os("RIGLAB_NODE_MODULES").map(PathBuf::from);
    let Some(modules) = modules.filter(|m| m.join("@pixiv/three-vrm-springbone").is_dir()) else {
        println!("skipped: RIGLAB_NODE_MODULES names no folder with @pixiv/three-vrm-springbone");
        return;
    };
    let node = Command::new("node").arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if !node.is_ok_and(|s| s.success()) {
        println!("skipped: `node` is not on the path");
        return;
    }
    let mut recorded = Recorded { package: String::new(), scenes: Vec::new() };
    for seed in 0..SCENES {
        let scene = Scene::new(seed);
        let of_scene = KINDS.map(|(kind, lengths)| {
            let reply = ask(&modules, &scene, kind);
            let worst = scene.compare(&reply.tails, 1, lengths);
            println!("{}, scene {seed} {kind}: off by {worst:.2e} of a bone at most", reply.package);
            assert!(worst <= ASKED);
            recorded.package = reply.package;
            let frames = reply.tails.0.into_iter().skip(EVERY - 1).step_by(EVERY);
            // What is lost is within what is asked of the recorded ones.
            Tails(frames.map(|row| row.iter().map(|x| (x * 1e7).round() / 1e7).collect()).collect())
        });
        recorded.scenes.push(of_scene);
    }
    if std::env::var_os("RIGLAB_RECORD").is_some() {
        std::fs::write(folder().join("recorded.json"), serde_json::to_string(&recorded).unwrap() + "\n").unwrap();
    }
}
