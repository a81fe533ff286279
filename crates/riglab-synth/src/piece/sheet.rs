//! Sheets: fins, feathers, membranes, and cloth that hangs around a limb.

use glam::Vec3;

use super::{Control, Limits, PieceMesh, blended, smooth, spline};
use crate::turn::turned;

/// A surface through ribs of control points; every rib has as many points as the others.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    pub ribs: Vec<Vec<Control>>,
    /// Greatest thickness in metres of a closed sheet; 0 makes it open, of one layer.
    pub thickness: f32,
    /// Whether the last rib is followed by the first, as around a skirt or sleeve. Such a sheet is open.
    pub round: bool,
}

impl Sheet {
    /// Mean lengths across and along the ribs.
    pub fn extent(&self) -> (f32, f32) {
        let (n, m) = (self.ribs.len(), self.ribs[0].len());
        let gap = |a: &Control, b: &Control| a.at.distance(b.at);
        let along: f32 = self.ribs.iter().flat_map(|r| r.windows(2).map(|w| gap(&w[0], &w[1]))).sum();
        let pairs = (0..self.gaps()).map(|k| (&self.ribs[k], &self.ribs[(k + 1) % n]));
        let across: f32 = pairs.flat_map(|(a, b)| a.iter().zip(b).map(|(a, b)| gap(a, b))).sum();
        (across / m as f32, along / n as f32)
    }

    /// Whether a joint holds some of it.
    pub fn holds(&self, joint: u16) -> bool {
        self.ribs.iter().flatten().any(|control| control.joint == joint)
    }

    /// Mean way to the next rib from where a joint holds the sheet.
    pub fn spacing_at(&self, joint: u16) -> Option<f32> {
        let n = self.ribs.len();
        let (mut sum, mut count) = (0.0, 0);
        for (a, b) in (0..self.gaps()).map(|k| (&self.ribs[k], &self.ribs[(k + 1) % n])) {
            for (a, b) in a.iter().zip(b).filter(|(a, b)| a.joint == joint || b.joint == joint) {
                sum += a.at.distance(b.at);
                count += 1;
            }
        }
        (count > 0).then(|| sum / count as f32)
    }

    pub fn mesh(&self, edge: f32, limits: Limits) -> PieceMesh {
        let (across, along) = self.extent();
        let m = self.ribs[0].len();
        // At least a quad per control patch, so that the outline keeps its points.
        let steps = |length: f32, patches: usize| {
            let per_patch = (length / (edge * patches as f32) + 0.5) as usize;
            patches * per_patch.clamp(1, limits.patch)
        };
        let (nu, nv) = (steps(across, self.gaps()).max(2), steps(along, m - 1).max(2));
        let columns = if self.round { nu } else { nu + 1 };
        let mut out = PieceMesh::default();
        for j in 0..=nv {
            for i in 0..columns {
                let (p, row) = self.at(i as f32 / nu as f32, j as f32 / nv as f32);
                out.positions.push(p);
                out.weights.push(row);
            }
        }
        let at = |i: usize, j: usize| (j * columns + i % columns) as u32;
        for j in 0..nv {
            for i in 0..nu {
                let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
                // At every corner of the sheet one end of the diagonal is inside: a triangle whose
                // corners all lie on the rim would be the same in both layers.
                let other = (i + 1 == nu && j == 0) || (i == 0 && j + 1 == nv);
                out.triangles.extend(if other { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] });
            }
        }
        if self.thickness > 0.0 && !self.round {
            self.close(&mut out, nu, nv);
        }
        out
    }

    /// Turns one layer into two that share their rim.
    fn close(&self, out: &mut PieceMesh, nu: usize, nv: usize) {
        let normals = normals(&out.positions, &out.triangles);
        let width = nu + 1;
        let mut under: Vec<u32> = (0..out.positions.len() as u32).collect();
        for j in 1..nv {
            for i in 1..nu {
                let v = j * width + i;
                let (u, w) = (i as f32 / nu as f32, j as f32 / nv as f32);
                // Thick in the middle and towards the root, sharp at the rim.
                let rise = 4.0 * u * (1.0 - u) * (1.0 - 0.6 * w) * (6.0 * w).min(1.0) * (6.0 * (1.0 - w)).min(1.0);
                let offset = 0.5 * self.thickness * rise.max(0.08) * normals[v];
                under[v] = out.positions.len() as u32;
                out.positions.push(out.positions[v] - offset);
                out.positions[v] += offset;
                out.weights.push(out.weights[v].clone());
            }
        }
        let lower: Vec<_> = out.triangles.iter().map(|&[a, b, c]| [a, c, b].map(|v| under[v as usize])).collect();
        out.triangles.extend(lower);
    }

    /// A point of the sheet and the joints that hold it; `u` runs across the ribs, `v` along them.
    fn at(&self, u: f32, v: f32) -> (Vec3, Vec<(u16, f32)>) {
        let (n, m) = (self.ribs.len(), self.ribs[0].len());
        let (i, s) = span(u, self.gaps());
        let (j, t) = span(v, m - 1);
        let along = |rib: usize| {
            let rib = &self.ribs[rib];
            spline(t, [j.saturating_sub(1), j, j + 1, (j + 2).min(m - 1)].map(|k| rib[k].at))
        };
        let around = match self.round {
            true => [i + n - 1, i, i + 1, i + 2].map(|k| k % n),
            false => [i.saturating_sub(1), i, i + 1, (i + 2).min(n - 1)],
        };
        let p = spline(s, around.map(along));
        let (s, t) = (smooth(s), smooth(t));
        let held = |rib: usize, k: usize| self.ribs[rib][k].joint;
        let corners = [(around[1], 1.0 - s), (around[2], s)]
            .into_iter()
            .flat_map(|(rib, ws)| [(held(rib, j), ws * (1.0 - t)), (held(rib, j + 1), ws * t)]);
        (p, blended(corners))
    }

    /// Gaps between ribs.
    fn gaps(&self) -> usize {
        self.ribs.len() - usize::from(!self.round)
    }

    pub fn turn(&mut self, moves: &dyn Fn(u16) -> bool, center: Vec3, axis: Vec3, degrees: f32) {
        for control in self.ribs.iter_mut().flatten().filter(|control| moves(control.joint)) {
            control.at = center + turned(control.at - center, axis, degrees);
        }
    }
}

/// Which of `gaps` spans a parameter in 0..=1 lies in, and where.
fn span(x: f32, gaps: usize) -> (usize, f32) {
    let x = x * gaps as f32;
    let k = (x as usize).min(gaps - 1);
    (k, x - k as f32)
}

fn normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        t.iter().for_each(|&v| sums[v as usize] += (b - a).cross(c - a));
    }
    sums.into_iter().map(|n| n.try_normalize().unwrap_or(Vec3::Y)).collect()
}
