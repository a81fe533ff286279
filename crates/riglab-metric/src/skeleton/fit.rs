//! A skeleton fitted to a shape without learning: that of another shape, carried along as that shape's surface is bent
//! onto the new one.

use riglab_core::{Bounds, Vec3};

/// How far points move together, in the cube [-1, 1]³: at first as good as all, at last a limb. Of six pairs the
/// one that brings retrieved skeletons nearest to the true ones on the validation split of real rigs.
const REACH: [f32; 2] = [0.8, 0.3];
const ROUNDS: usize = 24;
/// Below this share of the largest side a box is flat, and is not stretched.
const FLAT: f32 = 0.02;

/// Bends a template's points onto a shape's and gives where its joints have come; all in the cube [-1, 1]³.
///
/// The template's box is first made the shape's. Then, in rounds, each point is drawn to the nearest of the other
/// shape, both ways, and everything moves by the mean of these pulls, weighted by a Gaussian that narrows from the whole
/// body to a limb: non-rigid registration by smoothed nearest points, coarse to fine. Joints, which lie inside, move by
/// the mean of the surface around them. `None` where a side has no points.
pub fn fit(template: &[Vec3], joints: &[[f64; 3]], shape: &[Vec3]) -> Option<Vec<[f64; 3]>> {
    let (from, to) = (Bounds::of(template.iter().copied())?, Bounds::of(shape.iter().copied())?);
    let place = stretch(&from, &to);
    let mut points: Vec<Vec3> = template.iter().map(|p| place(*p)).collect();
    let mut carried: Vec<Vec3> = joints.iter().map(|p| place(p.map(|x| x as f32))).collect();
    for round in 0..ROUNDS {
        let reach = REACH[0] * (REACH[1] / REACH[0]).powf(round as f32 / (ROUNDS - 1) as f32);
        let pulls = pulls(&points, shape);
        let moved = |all: &[Vec3]| all.iter().map(|p| add(*p, mean(&pulls, *p, reach))).collect::<Vec<_>>();
        (points, carried) = (moved(&points), moved(&carried));
    }
    Some(carried.into_iter().map(|p| p.map(f64::from)).collect())
}

/// One box to the other, side by side; flat sides keep the scale of the largest.
fn stretch(from: &Bounds, to: &Bounds) -> impl Fn(Vec3) -> Vec3 {
    let (a, b) = (from.size(), to.size());
    let largest = |s: &[f32; 3]| s.iter().copied().fold(0.0, f32::max);
    let (long, wide) = (largest(&a), largest(&b));
    let whole = if long > 0.0 { wide / long } else { 1.0 };
    let scale: Vec3 =
        std::array::from_fn(|k| if a[k] > FLAT * long && b[k] > FLAT * wide { b[k] / a[k] } else { whole });
    let middle = |x: &Bounds| -> Vec3 { std::array::from_fn(|k| 0.5 * (x.min[k] + x.max[k])) };
    let (at, onto) = (middle(from), middle(to));
    move |p| std::array::from_fn(|k| (p[k] - at[k]) * scale[k] + onto[k])
}

/// Where something pulls, and how far: each point to the nearest of the shape, then each of the shape's to itself, at
/// the nearest point.
fn pulls(points: &[Vec3], shape: &[Vec3]) -> Vec<(Vec3, Vec3)> {
    let by = |from: Vec3, to: Vec3| (from, std::array::from_fn(|k| to[k] - from[k]));
    let there = points.iter().map(|p| by(*p, *nearest(*p, shape)));
    let back = shape.iter().map(|q| by(*nearest(*q, points), *q));
    there.chain(back).collect()
}

/// Of points, of which there are some.
fn nearest(p: Vec3, all: &[Vec3]) -> &Vec3 {
    let mut best = (f32::INFINITY, 0);
    for (k, q) in all.iter().enumerate() {
        let d = apart(p, *q);
        if d < best.0 {
            best = (d, k);
        }
    }
    &all[best.1]
}

/// The mean pull around a place.
fn mean(pulls: &[(Vec3, Vec3)], at: Vec3, reach: f32) -> Vec3 {
    // Relative to the nearest: where nothing is near, the nearest pull alone remains.
    let scale = -0.5 / (reach * reach);
    let least = pulls.iter().map(|(from, _)| apart(at, *from)).fold(f32::INFINITY, f32::min);
    let (mut sum, mut total) = ([0.0f32; 3], 0.0f32);
    for (from, by) in pulls {
        let share = (scale * (apart(at, *from) - least)).exp();
        total += share;
        (0..3).for_each(|k| sum[k] += share * by[k]);
    }
    sum.map(|x| x / total)
}

fn add(a: Vec3, b: Vec3) -> Vec3 {
    std::array::from_fn(|k| a[k] + b[k])
}

/// Squared.
fn apart(a: Vec3, b: Vec3) -> f32 {
    (0..3).map(|k| (a[k] - b[k]) * (a[k] - b[k])).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The sides of a bar along an axis, `rings` of eight points.
    fn bar(length: f32, width: f32, rings: usize) -> Vec<Vec3> {
        let ring = |r: usize| {
            (0..8).map(move |k| {
                let turn = std::f32::consts::TAU * k as f32 / 8.0;
                [width * turn.cos(), length * (r as f32 / (rings - 1) as f32 - 0.5), width * turn.sin()]
            })
        };
        (0..rings).flat_map(ring).collect()
    }

    #[test]
    fn a_template_on_itself_stays_and_one_of_other_sides_is_stretched() {
        let joints = [[0.0, -0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.5, 0.0]];
        let near = |found: &[[f64; 3]], wanted: &[[f64; 3]], by: f64| {
            found.iter().zip(wanted).all(|(a, b)| (0..3).all(|k| (a[k] - b[k]).abs() < by))
        };
        let own = bar(1.6, 0.2, 20);
        assert!(near(&fit(&own, &joints, &own).unwrap(), &joints, 1e-5));
        let long = fit(&own, &joints, &bar(2.0, 0.1, 20)).unwrap();
        assert!(near(&long, &joints.map(|p| p.map(|x| 1.25 * x)), 1e-2), "{long:?}");
    }

    #[test]
    fn joints_go_where_the_surface_around_them_goes() {
        let joints = [[0.0, -0.7, 0.0], [0.0, 0.7, 0.0]];
        let (straight, mut bent) = (bar(1.6, 0.15, 30), bar(1.6, 0.15, 30));
        // The upper end leans over, by up to .3.
        let lean = |y: f32| 0.3 * (y / 0.8).max(0.0);
        bent.iter_mut().for_each(|p| p[0] += lean(p[1]));
        let found = fit(&straight, &joints, &bent).unwrap();
        let before = f64::from(lean(0.7));
        assert!((found[1][0] - before).abs() < 0.3 * before, "{found:?}");
        assert!(found[0][0].abs() < 0.05, "{found:?}");
    }

    #[test]
    fn without_points_there_is_none_and_flat_shapes_are_no_fault() {
        let flat: Vec<Vec3> = bar(1.0, 0.3, 5).into_iter().map(|p| [p[0], p[1], 0.0]).collect();
        assert_eq!(fit(&[], &[[0.0; 3]], &flat), None);
        assert_eq!(fit(&flat, &[[0.0; 3]], &[]), None);
        for shape in [flat.clone(), vec![[0.1; 3]; 4], bar(1.0, 0.3, 5)] {
            assert!(fit(&flat, &[[0.0; 3]], &shape).unwrap().iter().flatten().all(|x| x.is_finite()));
            assert!(fit(&shape, &[[0.0; 3]], &flat).unwrap().iter().flatten().all(|x| x.is_finite()));
        }
    }
}
