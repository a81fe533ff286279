//! Weights as an artist would paint them.
//!
//! A vertex belongs first to the joint whose part is nearest to it, then to that part's neighbours
//! in the tree, the less the further their parts are, then to their neighbours. The way to a joint
//! is counted along the tree: the distances of all the parts passed on the way add up. A thigh
//! that happens to be near the other thigh, or a hand beside the hip, is far by that count, so
//! weights cannot jump an air gap, and yet they run softly over shoulders and hips. When the
//! nearest part changes from one to its neighbour both are equally near, and the count changes
//! continuously.

use glam::Vec3;

use crate::body::Body;
use crate::part::Part;
use crate::surface::Surface;

/// Most influences a vertex may have: one set of glTF's.
pub(crate) const INFLUENCES: usize = 4;

/// Shares below this are dropped: painters' tools and exporters do so too.
const FAINT: f32 = 0.015;

/// One vertex's joints and shares.
pub(crate) type Row = Vec<(u16, f32)>;

/// The weights of a surface's vertices. `softness` is the reach of a joint along a limb, in radii
/// of that limb; 0 gives each vertex to one joint.
pub(crate) fn weights(body: &Body, surface: &Surface, softness: f32) -> Vec<Row> {
    let tree = Tree::new(body, softness);
    let mut rows: Vec<Row> =
        (surface.positions.iter().zip(&surface.near)).map(|(&p, near)| tree.row(p, near)).collect();
    if softness > 0.0 {
        let around = neighbours(surface);
        for _ in 0..SMOOTHINGS {
            rows = smoothed(&rows, &around);
        }
    }
    rows.iter().map(|row| sparse(row)).collect()
}

/// How often each vertex takes on the mean of its neighbours: the brush with which painters end.
const SMOOTHINGS: usize = 2;

struct Tree<'a> {
    parts: &'a [Part],
    /// The parts of each joint.
    of_joint: Vec<Vec<u16>>,
    /// Fleshy neighbours of each joint, with the distance over which a weight fades between the
    /// two, in metres.
    next: Vec<Vec<(u16, f32)>>,
    softness: f32,
}

impl<'a> Tree<'a> {
    fn new(body: &'a Body, softness: f32) -> Self {
        let joints = body.joints.len();
        let mut of_joint = vec![Vec::new(); joints];
        for (i, part) in body.parts.iter().enumerate() {
            of_joint[usize::from(part.joint)].push(i as u16);
        }
        let mut next = vec![Vec::new(); joints];
        for (child, parent) in body.fleshy_parents().into_iter().enumerate() {
            let (Some(parent), Some(&own)) = (parent, of_joint[child].first()) else { continue };
            let main = |i: u16| &body.parts[usize::from(i)];
            let (own, other) = (main(own), main(of_joint[usize::from(parent)][0]));
            // A thick short bone must leave its neighbours room.
            let width = |part: &Part| part.mean().min((part.b - part.a).length().max(0.7 * part.mean()));
            let soft = body.soft.iter().find(|(joint, _)| joint.index() == child).map_or(1.0, |(_, by)| *by);
            let fade = softness * soft * width(own).min(width(other));
            next[child].push((parent, fade));
            next[usize::from(parent)].push((child as u16, fade));
        }
        Self { parts: &body.parts, of_joint, next, softness }
    }

    /// Distance to the nearest part of a joint.
    fn distance(&self, joint: u16, p: Vec3) -> f32 {
        let parts = self.of_joint[usize::from(joint)].iter();
        parts.map(|&i| self.parts[usize::from(i)].distance(p).d).fold(f32::INFINITY, f32::min)
    }

    fn row(&self, p: Vec3, near: &[u16]) -> Row {
        let (d, own) = (near.iter().map(|&i| &self.parts[usize::from(i)]))
            .map(|part| (part.distance(p).d, part.joint))
            .reduce(|best, this| if this.0 < best.0 { this } else { best })
            .expect("a vertex lies near a part");
        let mut row = vec![(own, 1.0)];
        if self.softness > 0.0 {
            self.spread(p, d, (own, None, 0.0), &mut row);
        }
        row
    }

    /// Adds what lies beyond `joint`, reached from `from` after a way of `way` (1 is too far).
    fn spread(&self, p: Vec3, nearest: f32, (joint, from, way): (u16, Option<u16>, f32), row: &mut Row) {
        for &(next, fade) in &self.next[usize::from(joint)] {
            if Some(next) == from {
                continue;
            }
            let way = way + (self.distance(next, p) - nearest).max(0.0) / fade;
            if way < 1.0 {
                row.push((next, falloff(way)));
                self.spread(p, nearest, (next, Some(joint), way), row);
            }
        }
    }
}

/// From 1 next to a joint's part to 0 where its reach ends.
///
/// Along a straight limb the distance to the next part grows with the square of the way along it,
/// so the root of `way` runs evenly along the limb; the constant keeps creases soft, where the
/// distance grows evenly at once.
fn falloff(way: f32) -> f32 {
    const EVEN: f32 = 0.15;
    let along = ((way + EVEN * EVEN).sqrt() - EVEN) / ((1.0 + EVEN * EVEN).sqrt() - EVEN);
    (1.0 - along) * (1.0 - along)
}

fn neighbours(surface: &Surface) -> Vec<Vec<u32>> {
    let mut around = vec![Vec::new(); surface.positions.len()];
    for t in &surface.triangles {
        for k in 0..3 {
            around[t[k] as usize].push(t[(k + 1) % 3]);
        }
    }
    around
}

fn smoothed(rows: &[Row], around: &[Vec<u32>]) -> Vec<Row> {
    (rows.iter().zip(around))
        .map(|(row, around)| {
            let total: f32 = row.iter().map(|(_, w)| w).sum();
            let mut out: Row = row.iter().map(|&(j, w)| (j, 0.5 * w / total)).collect();
            for &v in around {
                let other = &rows[v as usize];
                let share = 0.5 / (around.len() as f32 * other.iter().map(|(_, w)| w).sum::<f32>());
                for &(joint, w) in other {
                    add(&mut out, joint, share * w);
                }
            }
            out
        })
        .collect()
}

fn add(row: &mut Row, joint: u16, weight: f32) {
    match row.iter_mut().find(|(j, _)| *j == joint) {
        Some((_, w)) => *w += weight,
        None => row.push((joint, weight)),
    }
}

/// At most four influences, none faint, summing to 1.
///
/// What is dropped is subtracted from the rest, so that a share fades out instead of jumping when
/// another becomes the fourth.
fn sparse(row: &[(u16, f32)]) -> Row {
    let mut row = row.to_vec();
    row.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    let total: f32 = row.iter().map(|(_, w)| w).sum();
    let cut = row.get(INFLUENCES).map_or(0.0, |(_, w)| *w).max(FAINT * total);
    row.truncate(INFLUENCES);
    let first = row[0].0;
    row.iter_mut().for_each(|(_, w)| *w -= cut);
    row.retain(|(_, w)| *w > 0.0);
    if row.is_empty() {
        row.push((first, 1.0));
    }
    let total: f32 = row.iter().map(|(_, w)| w).sum();
    row.iter_mut().for_each(|(_, w)| *w /= total);
    row.sort_unstable_by_key(|(j, _)| *j);
    row
}
