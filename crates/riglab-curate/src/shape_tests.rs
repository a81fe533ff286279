use riglab_core::{Joint, Mesh, Rig, Skeleton, SkinWeights};
use riglab_synth::{Options, creature};

use super::*;

fn rig(seed: u64, number: u64) -> Rig {
    creature(seed, number, &Options::default()).rig
}

/// The rig with its points moved and its vertices in another order, corners turned.
fn again(rig: &Rig, place: impl Fn(glam::Vec3) -> glam::Vec3) -> Rig {
    let n = rig.mesh().positions().len();
    // A step that meets every vertex once.
    let step = (n / 2 + 1..).find(|s| gcd(*s, n) == 1).unwrap();
    let order: Vec<usize> = (0..n).map(|i| i * step % n).collect();
    let mut new = vec![0u32; n];
    order.iter().enumerate().for_each(|(at, &old)| new[old] = at as u32);
    let map = |p: [f32; 3]| place(p.into()).to_array();
    let positions = order.iter().map(|&v| map(rig.mesh().positions()[v])).collect();
    let triangles = rig.mesh().triangles().iter().rev().map(|t| [t[1], t[2], t[0]].map(|v| new[v as usize])).collect();
    let s = rig.skeleton();
    let joints = s.ids().map(|j| Joint { name: format!("b{}", j.0), parent: s.parent(j), head: map(s.head(j)) });
    let rows = order.iter().map(|&v| rig.weights().row(v).map(|(j, w)| (j.0, f64::from(w))).collect::<Vec<_>>());
    let weights = SkinWeights::normalized(rows).unwrap();
    Rig::new(Skeleton::new(joints.collect()).unwrap(), Mesh::new(positions, triangles).unwrap(), weights).unwrap()
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[test]
fn a_rig_turned_scaled_moved_renamed_and_shuffled_is_the_same() {
    let turn = glam::Quat::from_euler(glam::EulerRot::XYZ, 0.3, 1.1, -2.0);
    for k in 0..6 {
        let rig = rig(3, k);
        let other = again(&rig, |p| turn * p * 37.0 + glam::Vec3::new(5.0, -80.0, 3.0));
        let d = Shape::of(&rig).distance(&Shape::of(&other));
        assert!(d < TOLERANCE / 10.0, "creature {k}: {d}");
    }
}

#[test]
fn split_and_halved_triangles_change_nothing() {
    let rig = rig(3, 1);
    let (mesh, weights) = (rig.mesh(), rig.weights());
    // Every triangle with corners of its own, and cut in two at the middle of a side.
    let (mut positions, mut triangles, mut rows) = (Vec::new(), Vec::new(), Vec::new());
    for t in 0..mesh.triangles().len() {
        let corners = mesh.triangles()[t];
        let row = |v: u32| weights.row(v as usize).map(|(j, w)| (j.0, f64::from(w))).collect::<Vec<_>>();
        let [a, b, c] = mesh.corners(t).map(glam::Vec3::from);
        let at = positions.len() as u32;
        positions.extend([a, b, c, 0.5 * (a + b)].map(|p| p.to_array()));
        rows.extend(corners.map(row));
        rows.push([row(corners[0]), row(corners[1])].concat());
        triangles.extend([[at, at + 3, at + 2], [at + 3, at + 1, at + 2]]);
    }
    let weights = SkinWeights::normalized(rows).unwrap();
    let other = Rig::new(rig.skeleton().clone(), Mesh::new(positions, triangles).unwrap(), weights).unwrap();
    let d = Shape::of(&rig).distance(&Shape::of(&other));
    assert!(d < TOLERANCE / 2.0, "{d}");
}

#[test]
fn other_creatures_other_proportions_and_other_joints_are_not_the_same() {
    let all: Vec<Shape> = (0..12).map(|k| Shape::of(&rig(3, k))).collect();
    for i in 0..12 {
        for j in 0..i {
            assert!(all[i].distance(&all[j]) > 2.0 * TOLERANCE, "{i} and {j}");
        }
    }
    let one = rig(3, 0);
    let stretched = again(&one, |p| p * glam::Vec3::new(1.0, 1.1, 1.0));
    assert!(Shape::of(&one).distance(&Shape::of(&stretched)) > 2.0 * TOLERANCE);
    let heads = one
        .skeleton()
        .heads()
        .iter()
        .enumerate()
        .map(|(j, h)| if j == 1 { [h[0] + 0.05 * one.bounds().diagonal(), h[1], h[2]] } else { *h });
    let moved = one.skeleton().with_heads(heads.collect()).unwrap();
    let moved = Rig::new(moved, one.mesh().clone(), one.weights().clone()).unwrap();
    assert!(Shape::of(&one).distance(&Shape::of(&moved)) > TOLERANCE);
}

#[test]
fn a_mirror_image_changes_signs_and_nothing_else() {
    let one = rig(3, 0);
    let lean = again(&one, |p| p + glam::Vec3::new(0.9 * p.y * p.y + 0.3 * p.z, 0.0, 0.8 * p.x * p.y));
    let mirrored = again(&lean, |p| p * glam::Vec3::new(-1.0, 1.0, 1.0));
    let (a, b) = (Shape::of(&lean), Shape::of(&mirrored));
    for k in [CHIRALITY, CHIRALITY + 1] {
        assert!((a.values[k] + b.values[k]).abs() < 50, "{:?}", (a.values[k], b.values[k]));
    }
    assert!(a.distance(&b) > TOLERANCE, "{}", a.distance(&b));
    let others = |s: &Shape| {
        s.values
            .iter()
            .enumerate()
            .filter(|(k, _)| *k != CHIRALITY && *k != CHIRALITY + 1)
            .map(|(_, v)| *v)
            .collect::<Vec<_>>()
    };
    let most = others(&a).iter().zip(others(&b)).map(|(x, y)| x.abs_diff(y)).max();
    assert!(most < Some(400), "{most:?}");
}

#[test]
fn rigs_without_area_or_size_are_described_too() {
    let joint = |p| Joint { name: "a".into(), parent: None, head: p };
    let rig = |points: Vec<[f32; 3]>, head| {
        let n = points.len() as u32;
        let mesh = Mesh::new(points, vec![[0, n / 2, n - 1]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0u16, 1.0)]; n as usize]).unwrap();
        Rig::new(Skeleton::new(vec![joint(head)]).unwrap(), mesh, weights).unwrap()
    };
    for points in [vec![[1.0; 3]], vec![[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]], vec![[f32::MAX; 3], [f32::MIN; 3]]]
    {
        for head in [[0.0; 3], [f32::MAX; 3]] {
            assert_eq!(Shape::of(&rig(points.clone(), head)).values.len(), LEN);
        }
    }
}
