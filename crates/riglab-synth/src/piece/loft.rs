//! Lofts: cross-sections joined by a skin. Boxes, cylinders, wheels, horns, strands of hair, barrels.

use glam::Vec3;

use super::{Limits, PieceMesh, blended, smooth, spline};
use crate::part::Ring;
use crate::turn::{across, sin_cos, turned};

/// A cross-section.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Section {
    pub at: Vec3,
    pub ring: Ring,
    /// The joint that holds the loft here.
    pub joint: u16,
    side: Vec3,
    up: Vec3,
}

/// Cross-sections in a row with a skin around them.
#[derive(Clone, Debug)]
pub(crate) struct Loft {
    pub sections: Vec<Section>,
    /// 0 for elliptical sections, 1 for rectangular ones.
    square: f32,
    /// Whether the way between sections is curved.
    curved: bool,
    /// Whether both ends are closed.
    capped: bool,
}

impl Loft {
    /// Through points with their cross-sections, held by one joint each; `hint` is the direction
    /// nearest to which the rings' side lies.
    pub fn through(points: &[(Vec3, Ring, u16)], hint: Vec3) -> Self {
        let n = points.len();
        let sections = (0..n).map(|k| {
            let way = points[(k + 1).min(n - 1)].0 - points[k.saturating_sub(1)].0;
            let axis = way.try_normalize().unwrap_or(Vec3::Y);
            let side = across(axis, hint);
            let (at, ring, joint) = points[k];
            Section { at, ring, joint, side, up: axis.cross(side) }
        });
        Self { sections: sections.collect(), square: 0.0, curved: true, capped: true }
    }

    /// A box from `a` to `b` with half extents `ring`, its edges taken off by the share `bevel`.
    pub fn cuboid(joint: u16, a: Vec3, b: Vec3, hint: Vec3, ring: Ring, bevel: f32) -> Self {
        Self::tapered(joint, a, b, hint, [ring, ring], bevel).squared(1.0)
    }

    /// A cylinder or truncated cone, its edges taken off by the share `bevel`.
    pub fn tapered(joint: u16, a: Vec3, b: Vec3, hint: Vec3, rings: [Ring; 2], bevel: f32) -> Self {
        let cut = (bevel * rings[0].min().min(rings[1].min())).min(0.45 * a.distance(b));
        let along = (b - a).try_normalize().unwrap_or(Vec3::Y);
        let less = |ring: Ring| Ring::oval(ring.side - cut, ring.up - cut);
        let points = match bevel > 0.0 {
            true => vec![
                (a, less(rings[0]), joint),
                (a + along * cut, rings[0], joint),
                (b - along * cut, rings[1], joint),
                (b, less(rings[1]), joint),
            ],
            false => vec![(a, rings[0], joint), (b, rings[1], joint)],
        };
        Self { curved: false, ..Self::through(&points, hint) }
    }

    pub fn squared(self, square: f32) -> Self {
        Self { square, ..self }
    }

    /// Without lids, as a sleeve or a cup.
    pub fn open(self) -> Self {
        Self { capped: false, ..self }
    }

    pub fn scale_by(&mut self, by: f32) {
        for section in &mut self.sections {
            (section.at, section.ring) = (section.at * by, section.ring.scaled(by));
        }
    }

    pub fn turn(&mut self, moves: &dyn Fn(u16) -> bool, center: Vec3, axis: Vec3, degrees: f32) {
        for section in self.sections.iter_mut().filter(|section| moves(section.joint)) {
            section.at = center + turned(section.at - center, axis, degrees);
            section.side = turned(section.side, axis, degrees);
            section.up = turned(section.up, axis, degrees);
        }
    }

    pub fn area(&self) -> f32 {
        let around = |ring: Ring| (2.0 * std::f32::consts::PI + 1.7 * self.square) * ring.mean();
        let sides =
            self.sections.windows(2).map(|w| w[0].at.distance(w[1].at) * 0.5 * (around(w[0].ring) + around(w[1].ring)));
        let lid = |section: &Section| 3.2 * section.ring.side * section.ring.up;
        let lids = if self.capped { lid(&self.sections[0]) + self.sections.last().map_or(0.0, lid) } else { 0.0 };
        sides.sum::<f32>() + lids
    }

    /// Mean half extent.
    pub fn thickness(&self) -> f32 {
        let widest = self.sections.iter().map(|s| s.ring.mean()).fold(0.0, f32::max);
        let mean = self.sections.iter().map(|s| s.ring.mean()).sum::<f32>() / self.sections.len() as f32;
        0.5 * (mean + widest)
    }

    /// Mean half extent from the first section that a joint holds to the one after the last, where its bone ends.
    pub fn thickness_at(&self, joint: u16) -> Option<f32> {
        let first = self.sections.iter().position(|s| s.joint == joint)?;
        let last = self.sections.iter().rposition(|s| s.joint == joint)?;
        let held = &self.sections[first..(last + 2).min(self.sections.len())];
        Some(held.iter().map(|s| s.ring.mean()).sum::<f32>() / held.len() as f32)
    }

    pub fn mesh(&self, edge: f32, limits: Limits) -> PieceMesh {
        let widest = self.sections.iter().map(|s| s.ring.mean()).fold(0.0, f32::max);
        let quarters = ((0.5 * std::f32::consts::PI * widest / edge + 0.3) as u32).clamp(1, limits.quarters);
        // A box may do with its corners; what is round and not tiny needs six sides to look so.
        let round = self.square < 0.5 && widest > 0.3 * edge;
        let around = if round && quarters == 1 { 6 } else { 4 * quarters };
        let mut out = PieceMesh::default();
        let spans = self.sections.len() - 1;
        let mut rows = 0;
        for span in 0..spans {
            let length = self.sections[span].at.distance(self.sections[span + 1].at);
            let steps = ((length / edge + 0.5) as u32).clamp(1, limits.steps);
            for step in 0..steps {
                self.row(span, step as f32 / steps as f32, around, &mut out);
                rows += 1;
            }
        }
        self.row(spans - 1, 1.0, around, &mut out);
        let at = |row: u32, k: u32| row * around + k % around;
        for row in 0..rows {
            for k in 0..around {
                let (a, b, c, d) = (at(row, k), at(row, k + 1), at(row + 1, k + 1), at(row + 1, k));
                out.triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        if self.capped {
            for (row, section) in [(0, self.sections[0]), (rows, self.sections[spans])] {
                let middle = out.positions.len() as u32;
                out.positions.push(section.at);
                out.weights.push(vec![(section.joint, 1.0)]);
                for k in 0..around {
                    let (a, b) = (at(row, k), at(row, k + 1));
                    out.triangles.push(if row == 0 { [b, a, middle] } else { [a, b, middle] });
                }
            }
        }
        out
    }

    /// The vertices around a place of a span.
    fn row(&self, span: usize, t: f32, around: u32, out: &mut PieceMesh) {
        let last = self.sections.len() - 1;
        let [s0, s1] = [self.sections[span], self.sections[span + 1]];
        let four = [span.saturating_sub(1), span, span + 1, (span + 2).min(last)].map(|k| self.sections[k].at);
        let center = if self.curved { spline(t, four) } else { s0.at + (s1.at - s0.at) * t };
        let mix = |a: f32, b: f32| a + (b - a) * t;
        let (side, up) = (s0.side + (s1.side - s0.side) * t, s0.up + (s1.up - s0.up) * t);
        let (u, v) = (mix(s0.ring.side, s1.ring.side), mix(s0.ring.up, s1.ring.up));
        let (side, up) = (side.try_normalize().unwrap_or(s0.side) * u, up.try_normalize().unwrap_or(s0.up) * v);
        let share = smooth(t);
        for k in 0..around {
            // From a corner on, so that boxes have corners whatever the number of sides.
            let (sin, cos) = sin_cos(45.0 + 360.0 * k as f32 / around as f32);
            let stretch = 1.0 + self.square * (1.0 / sin.abs().max(cos.abs()) - 1.0);
            out.positions.push(center + side * (cos * stretch) + up * (sin * stretch));
            out.weights.push(blended([(s0.joint, 1.0 - share), (s1.joint, share)]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn volume(mesh: &PieceMesh) -> f32 {
        let six = mesh.triangles.iter().map(|t| {
            let [a, b, c] = t.map(|v| mesh.positions[v as usize]);
            a.dot(b.cross(c))
        });
        six.sum::<f32>() / 6.0
    }

    #[test]
    fn a_box_has_its_volume_and_faces_outwards() {
        let coarse = Loft::cuboid(0, Vec3::ZERO, Vec3::Y, Vec3::X, Ring::oval(0.5, 0.25), 0.0);
        for edge in [9.0, 0.1] {
            assert!((volume(&coarse.mesh(edge, Limits::of(4_000))) - 0.5).abs() < 1e-4);
        }
        assert_eq!(coarse.mesh(9.0, Limits::of(4_000)).triangles.len(), 16);
    }

    #[test]
    fn a_strand_passes_from_joint_to_joint() {
        let points =
            [(Vec3::ZERO, Ring::round(0.1), 0), (Vec3::Y, Ring::round(0.1), 1), (2.0 * Vec3::Y, Ring::round(0.02), 1)];
        let mesh = Loft::through(&points, Vec3::X).mesh(0.1, Limits::of(4_000));
        let sums = mesh.weights.iter().map(|row| row.iter().map(|(_, w)| w).sum::<f32>());
        assert!(sums.into_iter().all(|sum| (sum - 1.0).abs() < 1e-6));
        assert!(mesh.weights.iter().any(|row| row.len() == 2));
        assert!(volume(&mesh) > 0.0);
    }
}
