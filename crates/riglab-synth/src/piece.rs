//! Pieces apart from the skin: eyes, and thin sheets such as fins and feathers.
//!
//! A sheet thinner than a cell would cost more triangles than the rest of the body, so it is laid
//! out as a grid instead, as an artist would: open with one layer, or closed with two that meet at
//! the rim.

use glam::Vec3;

/// A component of the mesh that is not part of the skin.
#[derive(Clone, Debug)]
pub(crate) enum Piece {
    Ball(Ball),
    Sheet(Sheet),
}

/// A sphere that moves with one joint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ball {
    pub joint: u16,
    pub center: Vec3,
    /// In metres.
    pub radius: f32,
}

/// A control point of a sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Control {
    pub at: Vec3,
    /// The joint that holds the sheet here.
    pub joint: u16,
}

/// A surface through ribs of control points; every rib has as many points as the others.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    pub ribs: Vec<Vec<Control>>,
    /// Greatest thickness in metres of a closed sheet; 0 makes it open, of one layer.
    pub thickness: f32,
}

/// The triangles of a piece, with up to four weights a vertex.
#[derive(Clone, Debug, Default)]
pub(crate) struct PieceMesh {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub weights: Vec<Vec<(u16, f32)>>,
}

impl Piece {
    /// Triangles with edges of about `edge` metres.
    pub fn mesh(&self, edge: f32) -> PieceMesh {
        match self {
            Self::Ball(ball) => ball.mesh(edge),
            Self::Sheet(sheet) => sheet.mesh(edge),
        }
    }

    /// Scales the piece about the origin.
    pub fn scale_by(&mut self, by: f32) {
        match self {
            Self::Ball(ball) => (ball.center, ball.radius) = (ball.center * by, ball.radius * by),
            Self::Sheet(sheet) => {
                sheet.thickness *= by;
                sheet.ribs.iter_mut().flatten().for_each(|control| control.at *= by);
            }
        }
    }

    /// Roughly its area in square metres, both layers of a closed sheet counted.
    pub fn area(&self) -> f32 {
        match self {
            Self::Ball(ball) => 4.0 * std::f32::consts::PI * ball.radius * ball.radius,
            Self::Sheet(sheet) => {
                let (u, v) = sheet.extent();
                u * v * if sheet.thickness > 0.0 { 2.0 } else { 1.0 }
            }
        }
    }

    /// The size a cell of the skin would have beside it, in metres.
    pub fn scale(&self) -> f32 {
        match self {
            Self::Ball(ball) => ball.radius,
            Self::Sheet(sheet) => {
                let (u, v) = sheet.extent();
                0.25 * u.min(v)
            }
        }
    }
}

impl Ball {
    fn mesh(&self, edge: f32) -> PieceMesh {
        let rings = ((std::f32::consts::PI * self.radius / edge + 0.5) as u32).clamp(3, 16);
        let around = 2 * rings;
        let mut out = PieceMesh::default();
        // Poles along z, where a pupil would be.
        out.positions.push(self.center + self.radius * Vec3::Z);
        for ring in 1..rings {
            let (sin, cos) = crate::turn::sin_cos(180.0 * ring as f32 / rings as f32);
            for k in 0..around {
                let (s, c) = crate::turn::sin_cos(360.0 * k as f32 / around as f32);
                out.positions.push(self.center + self.radius * Vec3::new(sin * c, sin * s, cos));
            }
        }
        out.positions.push(self.center - self.radius * Vec3::Z);
        let last = out.positions.len() as u32 - 1;
        let at = |ring: u32, k: u32| 1 + (ring - 1) * around + k % around;
        for k in 0..around {
            out.triangles.push([0, at(1, k), at(1, k + 1)]);
            for ring in 1..rings - 1 {
                let (a, b, c, d) = (at(ring, k), at(ring + 1, k), at(ring + 1, k + 1), at(ring, k + 1));
                out.triangles.extend([[a, b, c], [a, c, d]]);
            }
            out.triangles.push([at(rings - 1, k), last, at(rings - 1, k + 1)]);
        }
        out.weights = vec![vec![(self.joint, 1.0)]; out.positions.len()];
        out
    }
}

impl Sheet {
    /// Mean lengths across and along the ribs.
    fn extent(&self) -> (f32, f32) {
        let (n, m) = (self.ribs.len(), self.ribs[0].len());
        let gap = |a: &Control, b: &Control| a.at.distance(b.at);
        let along: f32 = self.ribs.iter().flat_map(|r| r.windows(2).map(|w| gap(&w[0], &w[1]))).sum();
        let across: f32 = self.ribs.windows(2).flat_map(|r| r[0].iter().zip(&r[1]).map(|(a, b)| gap(a, b))).sum();
        (across / m as f32, along / n as f32)
    }

    fn mesh(&self, edge: f32) -> PieceMesh {
        let (across, along) = self.extent();
        let (n, m) = (self.ribs.len(), self.ribs[0].len());
        // At least a quad per control patch, so that the outline keeps its points.
        let steps = |length: f32, patches: usize| {
            let per_patch = (length / (edge * patches as f32) + 0.5) as usize;
            patches * per_patch.clamp(1, 64)
        };
        let (nu, nv) = (steps(across, n - 1).max(2), steps(along, m - 1).max(2));
        let mut out = PieceMesh::default();
        for j in 0..=nv {
            for i in 0..=nu {
                let (p, row) = self.at(i as f32 / nu as f32, j as f32 / nv as f32);
                out.positions.push(p);
                out.weights.push(row);
            }
        }
        let width = nu as u32 + 1;
        let at = |i: usize, j: usize| j as u32 * width + i as u32;
        for j in 0..nv {
            for i in 0..nu {
                let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
                // At every corner of the sheet one end of the diagonal is inside: a triangle whose
                // corners all lie on the rim would be the same in both layers.
                let other = (i + 1 == nu && j == 0) || (i == 0 && j + 1 == nv);
                out.triangles.extend(if other { [[a, b, d], [b, c, d]] } else { [[a, b, c], [a, c, d]] });
            }
        }
        if self.thickness > 0.0 {
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
        let (i, s) = span(u, n);
        let (j, t) = span(v, m);
        let along = |rib: usize| {
            let rib = &self.ribs[rib];
            spline(t, [j.saturating_sub(1), j, j + 1, (j + 2).min(m - 1)].map(|k| rib[k].at))
        };
        let p = spline(s, [i.saturating_sub(1), i, i + 1, (i + 2).min(n - 1)].map(along));
        let (s, t) = (smooth(s), smooth(t));
        let mut row: Vec<(u16, f32)> = Vec::with_capacity(4);
        for (rib, ws) in [(i, 1.0 - s), (i + 1, s)] {
            for (k, wt) in [(j, 1.0 - t), (j + 1, t)] {
                let joint = self.ribs[rib][k].joint;
                match row.iter_mut().find(|(known, _)| *known == joint) {
                    Some((_, w)) => *w += ws * wt,
                    None => row.push((joint, ws * wt)),
                }
            }
        }
        (p, row)
    }
}

/// Which of n - 1 spans a parameter in 0..=1 lies in, and where.
fn span(x: f32, n: usize) -> (usize, f32) {
    let x = x * (n - 1) as f32;
    let k = (x as usize).min(n - 2);
    (k, x - k as f32)
}

fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// Catmull-Rom between the middle two of four points.
fn spline(t: f32, [a, b, c, d]: [Vec3; 4]) -> Vec3 {
    let (t2, t3) = (t * t, t * t * t);
    0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t2 + (3.0 * b - a - 3.0 * c + d) * t3)
}

fn normals(positions: &[Vec3], triangles: &[[u32; 3]]) -> Vec<Vec3> {
    let mut sums = vec![Vec3::ZERO; positions.len()];
    for t in triangles {
        let [a, b, c] = t.map(|v| positions[v as usize]);
        t.iter().for_each(|&v| sums[v as usize] += (b - a).cross(c - a));
    }
    sums.into_iter().map(|n| n.try_normalize().unwrap_or(Vec3::Y)).collect()
}
