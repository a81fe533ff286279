//! Balls and ellipsoids: eyes, buns of hair, bobbles.

use glam::Vec3;

use super::{Limits, PieceMesh};
use crate::turn::{across, sin_cos, turned};

/// An ellipsoid that moves with one joint.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ball {
    pub joint: u16,
    pub center: Vec3,
    /// Half extents along side, up and axis, in metres.
    pub radii: Vec3,
    side: Vec3,
    up: Vec3,
    axis: Vec3,
}

impl Ball {
    /// A sphere.
    pub fn new(joint: u16, center: Vec3, radius: f32) -> Self {
        Self::oval(joint, center, Vec3::Z, Vec3::splat(radius))
    }

    /// An ellipsoid with half extents to the side, up and along `axis`.
    pub fn oval(joint: u16, center: Vec3, axis: Vec3, radii: Vec3) -> Self {
        let side = across(axis, Vec3::X);
        Self { joint, center, radii, side, up: axis.cross(side), axis }
    }

    /// Mean half extent.
    pub fn mean(&self) -> f32 {
        self.radii.element_sum() / 3.0
    }

    pub fn turn(&mut self, moves: &dyn Fn(u16) -> bool, center: Vec3, axis: Vec3, degrees: f32) {
        if moves(self.joint) {
            self.center = center + turned(self.center - center, axis, degrees);
            for v in [&mut self.side, &mut self.up, &mut self.axis] {
                *v = turned(*v, axis, degrees);
            }
        }
    }

    pub fn mesh(&self, edge: f32, limits: Limits) -> PieceMesh {
        let rings = ((std::f32::consts::PI * self.mean() / edge + 0.5) as u32).clamp(3, limits.rings);
        let around = 2 * rings;
        let mut out = PieceMesh::default();
        let place = |v: Vec3| {
            let v = v * self.radii;
            self.center + self.side * v.x + self.up * v.y + self.axis * v.z
        };
        // Poles along the axis, where a pupil would be.
        out.positions.push(place(Vec3::Z));
        for ring in 1..rings {
            let (sin, cos) = sin_cos(180.0 * ring as f32 / rings as f32);
            for k in 0..around {
                let (s, c) = sin_cos(360.0 * k as f32 / around as f32);
                out.positions.push(place(Vec3::new(sin * c, sin * s, cos)));
            }
        }
        out.positions.push(place(-Vec3::Z));
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
