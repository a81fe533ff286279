//! A rig described by numbers that stay when it is turned, moved, scaled, recoloured, renamed, or written
//! again with its vertices in another order, split or welded.
//!
//! Nothing is aligned: every number is an integral over the surface, or a sum over joints, of functions of
//! distances. Surface integrals are taken by area, at the middles of small triangles, so that they do not
//! depend on how the surface is cut up, and nothing is drawn at random. Joints count by their mass, the
//! share of the surface's area that moves with them: joints without weight count nothing. All functions are
//! continuous, so that rounded positions and weights move the numbers a little and never make them jump.
//! Lengths are in units of the surface's radius of gyration.
//!
//! Mirror images are told apart unless the rig is its own mirror image: a left hand is not a right hand.
//! Two numbers change their sign with the mirror ([`CHIRALITY`]).

use glam::DVec3;
use riglab_core::Rig;
use serde::{Deserialize, Serialize};

/// How far apart two descriptions of one rig may be, in the largest difference of their numbers.
pub const TOLERANCE: f32 = 4e-3;

const QUANTILES: usize = 24;
/// Hats over distances from 0 on, the last one open to infinity.
const REACH: Hats = Hats { count: 14, step: 0.2 };
const RADIAL: Hats = Hats { count: 12, step: 0.25 };
const PAIRS: Hats = Hats { count: 12, step: 0.35 };
const PARENTS: Hats = Hats { count: 10, step: 0.15 };

/// Where the numbers of each kind begin.
const AXES: usize = QUANTILES;
const SHELLS: usize = AXES + 3;
/// The two numbers that change their sign in a mirror.
pub const CHIRALITY: usize = SHELLS + 3;
const REACH_AT: usize = CHIRALITY + 2;
const RADIAL_AT: usize = REACH_AT + REACH.count;
const PAIRS_AT: usize = RADIAL_AT + RADIAL.count;
const PARENTS_AT: usize = PAIRS_AT + PAIRS.count;
const SHARING: usize = PARENTS_AT + PARENTS.count;
/// How many numbers.
pub const LEN: usize = SHARING + 2;

/// Sorted by these the fine comparison finds its candidates: quantiles, an axis, joints, that vary most and
/// depend on each other least.
pub(crate) const KEYS: [usize; 4] = [2, 14, AXES, REACH_AT + 1];

/// The least share of the surface that makes a joint count in [`Shape::joints`].
const LEAST_MASS: f64 = 1e-4;
/// Middles of triangles that the surface is cut into come to about this many.
const POINTS: f64 = 4000.0;
/// Along an edge of a triangle, at most this many pieces: bounds the work for any mesh.
const MOST_CUTS: f64 = 64.0;

/// A rig described.
#[derive(Clone, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub struct Shape {
    /// Joints that move a visible part of the surface.
    pub joints: u32,
    /// The numbers, in millionths: [`LEN`] of them.
    pub values: Vec<i32>,
}

impl Shape {
    /// Describes a rig.
    pub fn of(rig: &Rig) -> Self {
        let points = surface(rig);
        let frame = Frame::of(&points);
        let masses = masses(rig, &points);
        let mut values = vec![0.0f64; LEN];
        quantiles(&points, &frame, &mut values);
        let axes = axes(&points, &frame, &mut values[AXES..]);
        shells(&points, &frame, &mut values[SHELLS..CHIRALITY]);
        values[CHIRALITY] = handedness(&axes, points.iter().map(|p| (frame.place(p.at), p.area)));
        let heads = rig.skeleton().heads().iter().map(|h| frame.place(DVec3::from(h.map(f64::from))));
        values[CHIRALITY + 1] = handedness(&axes, heads.zip(masses.iter().copied()));
        skin(rig, &points, &frame, &mut values);
        skeleton(rig, &masses, &frame, &mut values);
        let joints = masses.iter().filter(|m| **m >= LEAST_MASS).count() as u32;
        let micro = |v: f64| if v.is_finite() { (v * 1e6).round().clamp(-2e9, 2e9) as i32 } else { 0 };
        Self { joints, values: values.into_iter().map(micro).collect() }
    }

    /// The largest difference of two descriptions; infinite where the joints that count are not about as many.
    pub fn distance(&self, other: &Self) -> f32 {
        let (a, b) = (self.joints.min(other.joints), self.joints.max(other.joints));
        // One of fifty may be on the edge of counting.
        if b - a > b / 50 || self.values.len() != other.values.len() {
            return f32::INFINITY;
        }
        let most = self.values.iter().zip(&other.values).map(|(x, y)| x.abs_diff(*y)).max().unwrap_or(0);
        most as f32 * 1e-6
    }
}

/// A small part of the surface.
pub(crate) struct Point {
    pub(crate) at: DVec3,
    /// Its share of the whole.
    pub(crate) area: f64,
    pub(crate) triangle: u32,
    /// Shares of the triangle's corners.
    pub(crate) of: [f64; 3],
}

/// The surface in small parts.
pub(crate) fn surface(rig: &Rig) -> Vec<Point> {
    let mesh = rig.mesh();
    let corners = |t: usize| mesh.corners(t).map(|p| DVec3::from(p.map(f64::from)));
    let areas: Vec<f64> = (0..mesh.triangles().len())
        .map(|t| {
            let [a, b, c] = corners(t);
            0.5 * (b - a).cross(c - a).length()
        })
        .collect();
    let total: f64 = areas.iter().sum();
    let mut points = Vec::with_capacity(areas.len() + 2 * POINTS as usize);
    for (t, &area) in areas.iter().enumerate() {
        // Without area anywhere, all triangles count alike.
        let area = if total > 0.0 { area / total } else { 1.0 / areas.len() as f64 };
        let cuts = (area * POINTS).sqrt().ceil().clamp(1.0, MOST_CUTS) as usize;
        let [a, b, c] = corners(t);
        let n = cuts as f64;
        // Rows of triangles, those upright and those upside down between them.
        for row in 0..cuts {
            for column in 0..2 * (cuts - row) - 1 {
                let (i, third) = (column / 2, if column % 2 == 0 { 1.0 / 3.0 } else { 2.0 / 3.0 });
                let (u, v) = ((i as f64 + third) / n, (row as f64 + third) / n);
                let of = [1.0 - u - v, u, v];
                points.push(Point {
                    at: a * of[0] + b * of[1] + c * of[2],
                    area: area / (n * n),
                    triangle: t as u32,
                    of,
                });
            }
        }
    }
    points
}

/// Middle and size of the surface.
struct Frame {
    center: DVec3,
    scale: f64,
}

impl Frame {
    fn of(points: &[Point]) -> Self {
        let center: DVec3 = points.iter().map(|p| p.at * p.area).sum();
        let spread: f64 = points.iter().map(|p| p.area * p.at.distance_squared(center)).sum();
        let scale = spread.sqrt();
        Self { center, scale: if scale > 0.0 && scale.is_finite() { scale } else { 1.0 } }
    }

    /// In units of the surface, from its middle.
    fn place(&self, p: DVec3) -> DVec3 {
        (p - self.center) / self.scale
    }
}

/// Mean distance from the middle of each twenty-fourth of the surface, from the inmost to the outmost. Means,
/// as a distance that so much lies within jumps where the surface has a gap.
fn quantiles(points: &[Point], frame: &Frame, values: &mut [f64]) {
    let mut radii: Vec<(f64, f64)> = points.iter().map(|p| (frame.place(p.at).length(), p.area)).collect();
    radii.sort_unstable_by(|a, b| a.0.total_cmp(&b.0));
    let bins = QUANTILES as f64;
    let mut below = 0.0;
    for (radius, area) in radii {
        let mut rest = area;
        while rest > 0.0 {
            let bin = ((below * bins) as usize).min(QUANTILES - 1);
            let room = if bin + 1 == QUANTILES { rest } else { ((bin + 1) as f64 / bins - below).max(1e-12) };
            let part = rest.min(room);
            values[bin] += radius * part * bins;
            below += part;
            rest -= part;
        }
    }
}

/// Extents along the principal axes, largest first; and the axes, as a right hand's fingers, with 0 for those
/// that are hardly told apart.
fn axes(points: &[Point], frame: &Frame, values: &mut [f64]) -> [(DVec3, f64); 3] {
    let mut m = [[0.0f64; 3]; 3];
    for p in points {
        let q = frame.place(p.at).to_array();
        for (i, row) in m.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                *sum += p.area * q[i] * q[j];
            }
        }
    }
    let mut axes = eigen(m);
    axes.sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
    let extents = axes.map(|(e, _)| e.max(0.0).sqrt());
    values[..3].copy_from_slice(&extents);
    let gap = (extents[0] - extents[1]).min(extents[1] - extents[2]);
    let sure = (gap / 0.02).clamp(0.0, 1.0);
    let [a, b] = [axes[0].1, axes[1].1];
    [(a, sure), (b, sure), (a.cross(b), sure)]
}

/// Eigenvalues and vectors of a symmetric matrix, by Jacobi's rotations: square roots alone, the same on any
/// machine.
fn eigen(mut m: [[f64; 3]; 3]) -> [(f64, DVec3); 3] {
    let mut v = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    for _ in 0..24 {
        for (p, q) in [(0, 1), (0, 2), (1, 2)] {
            if m[p][q] == 0.0 {
                continue;
            }
            let theta = (m[q][q] - m[p][p]) / (2.0 * m[p][q]);
            let t = theta.signum() / (theta.abs() + (theta * theta + 1.0).sqrt());
            let c = 1.0 / (t * t + 1.0).sqrt();
            let s = t * c;
            for row in m.iter_mut().chain(&mut v) {
                (row[p], row[q]) = (c * row[p] - s * row[q], s * row[p] + c * row[q]);
            }
            let (above, below) = m.split_at_mut(q);
            for (x, y) in above[p].iter_mut().zip(&mut below[0]) {
                (*x, *y) = (c * *x - s * *y, s * *x + c * *y);
            }
        }
    }
    [0, 1, 2].map(|k| (m[k][k], DVec3::new(v[0][k], v[1][k], v[2][k])))
}

/// Where parts of the surface, from the inmost outwards, have their middles: how far out each.
fn shells(points: &[Point], frame: &Frame, values: &mut [f64]) {
    let hats = Hats { count: 3, step: 0.5 };
    let mut sums = [DVec3::ZERO; 3];
    for p in points {
        let q = frame.place(p.at);
        hats.each(q.length() - 0.25, |k, share| sums[k] += q * (p.area * share));
    }
    // Not divided by a shell's own area, which may be next to nothing.
    values.copy_from_slice(&sums.map(DVec3::length));
}

/// How lopsided things are, with the sign of their handedness: along each principal axis the mean of the
/// cube, which is 0 across a plane of symmetry; of the three the least, with the sign of their product. An
/// axis turned round takes another with it and leaves the product.
fn handedness(axes: &[(DVec3, f64); 3], parts: impl Iterator<Item = (DVec3, f64)> + Clone) -> f64 {
    let skew = axes.map(|(axis, sure)| {
        let third: f64 = parts.clone().map(|(at, share)| share * cube(at.dot(axis))).sum();
        third * sure
    });
    // Small as it is, it is hardly moved by rounding: by 1e-6, where weights are bytes by 1e-4.
    let least = 10.0 * skew.iter().map(|s| s.abs()).fold(f64::INFINITY, f64::min);
    if skew.iter().product::<f64>() < 0.0 { -least } else { least }
}

fn cube(x: f64) -> f64 {
    x * x * x
}

/// The share of the surface that each joint moves.
fn masses(rig: &Rig, points: &[Point]) -> Vec<f64> {
    let mut masses = vec![0.0; rig.skeleton().len()];
    each_influence(rig, points, |p, joint, weight| masses[joint] += p.area * weight);
    masses
}

/// How far the surface is from the joints that move it, and how much they share it.
fn skin(rig: &Rig, points: &[Point], frame: &Frame, values: &mut [f64]) {
    let heads: Vec<DVec3> = rig.skeleton().heads().iter().map(|h| frame.place(DVec3::from(h.map(f64::from)))).collect();
    let mut reach = [0.0; REACH.count];
    let mut sharing = 0.0;
    each_influence(rig, points, |p, joint, weight| {
        let far = frame.place(p.at).distance(heads[joint]);
        REACH.each(far, |k, share| reach[k] += p.area * weight * share);
        sharing += p.area * weight * weight;
    });
    values[REACH_AT..RADIAL_AT].copy_from_slice(&reach);
    values[SHARING] = sharing;
}

/// Calls with each joint's weight at each part of the surface, interpolated between the corners.
fn each_influence(rig: &Rig, points: &[Point], mut each: impl FnMut(&Point, usize, f64)) {
    let (triangles, weights) = (rig.mesh().triangles(), rig.weights());
    let mut row: Vec<(usize, f64)> = Vec::new();
    for p in points {
        row.clear();
        for (&vertex, of) in triangles[p.triangle as usize].iter().zip(p.of) {
            for (joint, weight) in weights.row(vertex as usize) {
                let weight = of * f64::from(weight);
                match row.iter_mut().find(|(j, _)| *j == joint.index()) {
                    Some((_, sum)) => *sum += weight,
                    None => row.push((joint.index(), weight)),
                }
            }
        }
        row.iter().for_each(|&(joint, weight)| each(p, joint, weight));
    }
}

/// How joints with mass lie: to the middle, to each other, to those they hang on.
fn skeleton(rig: &Rig, masses: &[f64], frame: &Frame, values: &mut [f64]) {
    let skeleton = rig.skeleton();
    let heads: Vec<DVec3> = skeleton.heads().iter().map(|h| frame.place(DVec3::from(h.map(f64::from)))).collect();
    // Roots lifted out of small masses: fingers count more than their skin does.
    let lifted: Vec<f64> = masses.iter().map(|m| m.sqrt()).collect();
    let total = lifted.iter().sum::<f64>().max(f64::MIN_POSITIVE);
    let with_mass: Vec<usize> = (0..masses.len()).filter(|&j| masses[j] > 0.0).collect();
    // The nearest ancestor with mass: a root without weight, put on top by an exporter, changes nothing.
    let mut above: Vec<Option<usize>> = vec![None; masses.len()];
    for joint in skeleton.ids() {
        if let Some(parent) = skeleton.parent(joint).map(|p| p.index()) {
            above[joint.index()] = if masses[parent] >= LEAST_MASS { Some(parent) } else { above[parent] };
        }
    }
    for &j in &with_mass {
        let share = lifted[j] / total;
        RADIAL.each(heads[j].length(), |k, s| values[RADIAL_AT + k] += share * s);
        let bone = above[j].map_or(0.0, |p| heads[j].distance(heads[p]));
        PARENTS.each(bone, |k, s| values[PARENTS_AT + k] += share * s);
        for &i in &with_mass {
            let share = share * lifted[i] / total;
            PAIRS.each(heads[j].distance(heads[i]), |k, s| values[PAIRS_AT + k] += share * s);
        }
    }
    values[SHARING + 1] = masses.iter().map(|m| m * m).sum();
}

/// Hat functions over 0, step, 2 step, …: at any place their values sum to 1.
#[derive(Clone, Copy)]
struct Hats {
    count: usize,
    step: f64,
}

impl Hats {
    /// Calls with the one or two that are not 0 at a place.
    fn each(self, at: f64, mut each: impl FnMut(usize, f64)) {
        let at = (at / self.step).clamp(0.0, (self.count - 1) as f64);
        let low = (at as usize).min(self.count - 1);
        let share = at - low as f64;
        each(low, 1.0 - share);
        if share > 0.0 {
            each(low + 1, share);
        }
    }
}

#[cfg(test)]
#[path = "shape_tests.rs"]
mod tests;
