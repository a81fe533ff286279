use glam::{DAffine3, DMat3, DVec3};
use riglab_core::{Collider, Joint, JointId, Shape, Skeleton, Spring, SpringJoint, Swing};
use riglab_random::{Draw, stream};
use riglab_simulate::Simulation;
use tch::Device;

use super::*;

const CPU64: (Kind, Device) = (Kind::Double, Device::Cpu);
/// So few that each can be moved a little.
const POINTS: i64 = 5;
const SECONDS: f64 = 1.0 / 30.0;

/// A body of three joints with two chains that swing, one of which branches; the last joint has no length.
const PARENTS: [Option<usize>; 10] =
    [None, Some(0), Some(1), Some(1), Some(3), Some(4), Some(2), Some(6), Some(6), Some(8)];
const SWINGS: [bool; 10] = [false, false, false, true, true, true, true, true, true, true];
const HEADS: [[f64; 3]; 10] = [
    [0.0, 0.0, 0.0],
    [0.0, 0.5, 0.0],
    [0.0, 0.9, 0.1],
    [0.25, 0.5, 0.0],
    [0.5, 0.5, 0.125],
    [0.75, 0.375, 0.125],
    [0.0, 1.125, 0.0],
    [0.125, 1.25, 0.0],
    [-0.125, 1.25, 0.125],
    [-0.25, 1.5, 0.125],
];

fn tails() -> [[f64; 3]; 10] {
    let mut tails = HEADS.map(|[x, y, z]| [x + 0.125, y + 0.125, z]);
    (tails[3], tails[4], tails[6], tails[8], tails[9]) = (HEADS[4], HEADS[5], HEADS[7], HEADS[9], HEADS[9]);
    tails
}

fn table(rows: &[[f64; 3]]) -> Tensor {
    Tensor::from_slice(rows.as_flattened()).view([-1, 3])
}

fn random(purpose: &str, shape: &[i64], scale: f64) -> Tensor {
    let mut draw = stream(1, purpose, &[]);
    let all: Vec<f64> = (0..shape.iter().product()).map(|_| f64::from(draw.normal())).collect();
    Tensor::from_slice(&all).view(shape) * scale
}

/// Poses [t + 1, j], all at rest in the first.
fn motion(frames: i64) -> Maps {
    let turns = random("turns", &[frames, 10, 3], 0.4);
    let fade = (Tensor::arange(frames, CPU64) / 2.0).clamp_max(1.0).view([-1, 1, 1]);
    let mut local = Maps::about(&rotations_of_vectors(&(turns * &fade)), &table(&HEADS));
    let shift = random("shift", &[frames, 1, 3], 0.05) * fade;
    local.shift = Tensor::cat(&[local.shift.narrow(1, 0, 1) + shift, local.shift.narrow(1, 1, 9)], 1);
    Tree::new(&PARENTS).compose(&local)
}

/// Rows of attributes that bend and push.
fn attributes() -> Tensor {
    let rows = random("attributes", &[10, ATTRIBUTES], 1.0).sigmoid();
    let scale = Tensor::from_slice(&[3.0, 0.8, 1.0, 0.5, -1.0, 0.3, 0.05]);
    rows * scale
}

fn obstacles() -> Vec<(Obstacle, Vec<bool>)> {
    let ball = Obstacle { joint: 1, from: [0.5, 0.4375, 0.0625], to: [0.5, 0.4375, 0.0625], radius: 0.125 };
    let rod = Obstacle { joint: 2, from: [-0.25, 1.0, 0.0], to: [0.25, 1.25, 0.0], radius: 0.0625 };
    let of = |ball: bool| (0..10).map(|j| (j < 6) == ball).collect();
    vec![(ball, of(true)), (rod, of(false))]
}

fn centers() -> Vec<Option<usize>> {
    (0..10).map(|j| (j > 5).then_some(1)).collect()
}

fn springs(heads: &Tensor, tails: &Tensor) -> Springs {
    let springs = Springs::new(Tree::new(&PARENTS), heads, tails, &SWINGS);
    springs.with_obstacles(obstacles()).with_centers(&centers())
}

/// The same scene for the simulation without tensors.
fn plain() -> Simulation {
    let f32s = |p: [f64; 3]| p.map(|x| x as f32);
    let joint =
        |j: usize| Joint { name: j.to_string(), parent: PARENTS[j].map(|p| JointId(p as u16)), head: f32s(HEADS[j]) };
    let skeleton = Skeleton::new((0..10).map(joint).collect()).unwrap();
    let rows = attributes();
    let value = |j: usize, k: i64| rows.double_value(&[j as i64, k]) as f32;
    let swing = |j: usize| Swing {
        stiffness: value(j, 0),
        drag: value(j, 1),
        gravity_power: value(j, 2),
        gravity_direction: [value(j, 3), value(j, 4), value(j, 5)],
        hit_radius: value(j, 6),
    };
    let bone = |j: usize| SpringJoint { joint: JointId(j as u16), tail: Some(f32s(tails()[j])), swing: swing(j) };
    let chain = |joints: std::ops::Range<usize>, group: usize, center: Option<u16>| Spring {
        name: String::new(),
        joints: joints.map(bone).collect(),
        groups: vec![group],
        center: center.map(JointId),
    };
    let shape = |o: &Obstacle| Shape::Capsule { from: f32s(o.from), to: f32s(o.to), radius: o.radius as f32 };
    let colliders =
        obstacles().iter().map(|(o, _)| Collider { joint: JointId(o.joint as u16), shape: shape(o) }).collect();
    let all = vec![chain(3..6, 0, None), chain(6..10, 1, Some(1))];
    Simulation::new(&skeleton, &riglab_core::Springs::new(all, colliders, vec![vec![0], vec![1]]).unwrap())
}

/// Attributes as f32 holds them, so that both simulations have the same.
fn rounded(t: &Tensor) -> Tensor {
    t.to_kind(Kind::Float).to_kind(Kind::Double)
}

#[test]
fn springs_move_as_without_tensors() {
    let mut heads = HEADS;
    heads.as_flattened_mut().iter_mut().for_each(|x| *x = f64::from(*x as f32));
    let motion = motion(60);
    let found = springs(&table(&heads), &rounded(&table(&tails()))).run(&motion, &rounded(&attributes()), SECONDS);
    let mut plain = plain();
    let (mut swung, mut worst): (f64, f64) = (0.0, 0.0);
    for frame in 0..60 {
        let pose: Vec<DAffine3> = (0..10)
            .map(|j| {
                let m = |i: i64, k: i64| motion.matrix.double_value(&[frame, j, i, k]);
                let column = |k: i64| DVec3::new(m(0, k), m(1, k), m(2, k));
                let shift = |k: i64| motion.shift.double_value(&[frame, j, k]);
                let matrix3 = DMat3::from_cols(column(0), column(1), column(2));
                DAffine3 { matrix3, translation: DVec3::new(shift(0), shift(1), shift(2)) }
            })
            .collect();
        if frame == 0 {
            plain.reset(&pose).unwrap();
            continue;
        }
        let maps = plain.step(&pose, SECONDS).unwrap();
        for (j, map) in maps.iter().enumerate() {
            let own = |k: i64| found.shift.double_value(&[frame - 1, j as i64, k]);
            let shift = DVec3::new(own(0), own(1), own(2));
            worst = worst.max(shift.distance(map.translation));
            swung = swung.max(shift.distance(pose[j].translation));
        }
    }
    assert!(worst < 1e-9, "{worst:.2e}");
    assert!(swung > 0.1, "{swung}");
}

#[test]
fn a_batch_is_a_forest() {
    let heads = table(&HEADS);
    let rows = attributes();
    let alone = Springs::new(Tree::new(&PARENTS), &heads, &table(&tails()), &SWINGS).run(&motion(4), &rows, SECONDS);
    // Two of them, one behind the other, of which one has other attributes.
    let parents: Vec<Option<usize>> =
        PARENTS.iter().copied().chain(PARENTS.iter().map(|p| p.map(|p| p + 10))).collect();
    let twice = |t: &Tensor, dim: i64| Tensor::cat(&[t, t], dim);
    let swings = [SWINGS, SWINGS].concat();
    let springs = Springs::new(Tree::new(&parents), &twice(&heads, 0), &twice(&table(&tails()), 0), &swings);
    let motion = Maps { matrix: twice(&motion(4).matrix, 1), shift: twice(&motion(4).shift, 1) };
    let both = springs.run(&motion, &Tensor::cat(&[&(&rows * 0.5), &rows], 0), SECONDS);
    let off = |from: i64| (both.shift.narrow(1, from, 10) - &alone.shift).abs().max().double_value(&[]);
    assert!(off(10) < 1e-12 && off(0) > 1e-3, "{} {}", off(10), off(0));
}

/// The loss of some weights and attributes against others, over T = 3.
fn loss(weights: &Tensor, rows: &Tensor, heads: &Tensor) -> Tensor {
    let points = random("points", &[POINTS, 3], 0.5);
    let springs = springs(heads, &table(&tails()));
    let truth = random("truth", &[3, POINTS, 3], 0.3);
    physics_loss(&skin(&points, &weights.softmax(-1, None), &springs.run(&motion(4), rows, SECONDS)), &truth)
}

/// How far the gradient by an input is from finite differences, over its size.
fn error(of: impl Fn(&Tensor) -> Tensor, at: &Tensor) -> f64 {
    let leaf = at.copy().set_requires_grad(true);
    let gradient = Tensor::run_backward(&[of(&leaf)], &[&leaf], false, false).remove(0).view(-1);
    let step = 1e-5;
    let along = |k: i64| {
        let moved = |by: f64| {
            let there = at.copy();
            let _ = there.view(-1).get(k).f_add_scalar_(by).unwrap();
            of(&there).double_value(&[])
        };
        (moved(step) - moved(-step)) / (2.0 * step)
    };
    let numeric: Vec<f64> = (0..at.numel() as i64).map(along).collect();
    let numeric = Tensor::from_slice(&numeric);
    assert!(numeric.norm().double_value(&[]) > 1e-6, "nothing depends on it");
    (gradient - &numeric).norm().double_value(&[]) / numeric.norm().double_value(&[])
}

#[test]
fn gradients_match_finite_differences() {
    let (weights, rows, heads) = (random("weights", &[POINTS, 10], 1.0), attributes(), table(&HEADS));
    for (name, off) in [
        ("weights", error(|w| loss(w, &rows, &heads), &weights)),
        ("attributes", error(|r| loss(&weights, r, &heads), &rows)),
        // The last has no length, and would have one.
        (
            "heads",
            error(|h| loss(&weights, &rows, &Tensor::cat(&[h, &heads.narrow(0, 9, 1)], 0)), &heads.narrow(0, 0, 9)),
        ),
    ] {
        println!("{name}: relative error {off:.1e}");
        assert!(off <= 1e-6, "{name}: {off:.2e}");
    }
    // Each of the seven attributes has a say.
    let leaf = rows.copy().set_requires_grad(true);
    let gradient = Tensor::run_backward(&[loss(&weights, &leaf, &heads)], &[&leaf], false, false).remove(0);
    for k in 0..ATTRIBUTES {
        assert!(gradient.select(1, k).abs().max().double_value(&[]) > 1e-9, "attribute {k}");
    }
    // The body and the bone without length have none.
    for j in [0, 1, 2, 9] {
        assert_eq!(gradient.get(j).abs().max().double_value(&[]), 0.0);
    }
}

#[test]
fn gradients_of_odd_input_are_finite() {
    // All heads and tails in one place, flat and mirrored poses, weights of 0.
    let heads = Tensor::zeros([10, 3], CPU64).set_requires_grad(true);
    let rows = attributes().set_requires_grad(true);
    let motion = motion(4);
    let flat =
        Maps { matrix: &motion.matrix * Tensor::from_slice(&[1.0, 0.0, -1.0]).view([3, 1]), shift: motion.shift };
    for tails in [heads.copy(), &heads + 1.0, table(&HEADS)] {
        let springs = springs(&heads, &tails);
        let weights = Tensor::zeros([POINTS, 10], CPU64).set_requires_grad(true);
        let found = skin(&random("points", &[POINTS, 3], 0.5), &weights, &springs.run(&flat, &rows, SECONDS));
        let loss = physics_loss(&found, &random("truth", &[3, POINTS, 3], 1.0));
        assert!(loss.double_value(&[]).is_finite());
        for g in Tensor::run_backward(&[loss], &[&heads, &rows, &weights], true, false) {
            // Where nothing swings, attributes have no say.
            assert!(!g.defined() || g.isfinite().all().int64_value(&[]) == 1);
        }
    }
}

#[test]
fn at_rest_skinning_changes_nothing() {
    let points = random("points", &[POINTS, 3], 0.5);
    let weights = random("weights", &[POINTS, 10], 1.0).softmax(-1, None);
    let still = Tree::new(&PARENTS)
        .compose(&Maps::about(&rotations_of_vectors(&Tensor::zeros([2, 10, 3], CPU64)), &table(&HEADS)));
    let found = skin(&points, &weights, &still);
    assert_eq!(found.size(), [2, POINTS, 3]);
    // But for what is added to sums of weights.
    assert!((found - &points).abs().max().double_value(&[]) < 1e-7);
    assert_eq!(physics_loss(&points.unsqueeze(0), &(&points + 1.0).unsqueeze(0)).double_value(&[]), 3.0);
}

#[test]
fn rotations_come_back() {
    let vectors = Tensor::cat(
        &[
            random("turns", &[20, 3], 1.0),
            Tensor::zeros([1, 3], CPU64),
            table(&[[3.1, 0.2, 0.0], [0.0, -3.0, 0.5], [0.1, 0.1, 3.1]]),
        ],
        0,
    );
    let quaternions = quaternions_of_vectors(&vectors);
    let rotations = rotations_of_quaternions(&quaternions);
    let sign = quaternions.narrow(-1, 0, 1).sign();
    let off = quaternions_of_rotations(&rotations) - &quaternions * sign.where_self(&sign.ne(0.0), &sign.ones_like());
    assert!(off.abs().max().double_value(&[]) < 1e-9);
    let product = rotations.matmul(&rotations.transpose(-2, -1)) - Tensor::eye(3, CPU64);
    assert!(product.abs().max().double_value(&[]) < 1e-12);
    // A quarter turn about z takes x to y.
    let quarter = rotations_of_vectors(&table(&[[0.0, 0.0, std::f64::consts::FRAC_PI_2]]));
    assert!((quarter.double_value(&[0, 1, 0]) - 1.0).abs() < 1e-12);
}

#[test]
fn inverse_maps_undo_and_flat_ones_are_left() {
    let maps = motion(4);
    let both = maps.inverse().after(&maps);
    assert!((both.matrix - Tensor::eye(3, CPU64)).abs().max().double_value(&[]) < 1e-12);
    assert!(both.shift.abs().max().double_value(&[]) < 1e-12);
    let flat = Maps { matrix: Tensor::zeros([1, 3, 3], CPU64), shift: Tensor::ones([1, 3], CPU64) }.inverse();
    assert_eq!((flat.matrix.double_value(&[0, 1, 1]), flat.shift.double_value(&[0, 1])), (1.0, 0.0));
}
