//! The implicit function whose zero set is the skin: parts, joined with a fillet to the parts they
//! grow from and to nothing else.
//!
//! Two thighs, two fingers, or an arm beside the chest are no neighbours in the tree: they meet in
//! a hard crease or stay apart, and never fuse over an air gap. The fillet is wide where two parts
//! face each other and nothing where they run the same way, so joints of a straight limb do not
//! bulge, while crotch, armpit and the crook of the knee round off.

use glam::Vec3;

use crate::body::Body;
use crate::part::{Distance, Part};

/// The parts of a body as one function.
pub(crate) struct Field<'a> {
    parts: &'a [Part],
    /// `parts.len()` squared: whether two parts are joined with a fillet.
    joined: Vec<bool>,
}

/// The function at a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sample {
    /// Distance to the skin in metres, to first order; negative inside.
    pub d: f32,
    /// Unit direction in which it grows.
    pub gradient: Vec3,
}

/// Room for the distances of the parts near a point; reused from point to point.
pub(crate) type Scratch = Vec<Distance>;

impl<'a> Field<'a> {
    pub fn new(body: &'a Body) -> Self {
        let above = body.fleshy_parents();
        let parts = &body.parts;
        let related = |a: u16, b: u16| a == b || above[usize::from(a)] == Some(b) || above[usize::from(b)] == Some(a);
        let joined = parts.iter().flat_map(|p| parts.iter().map(move |q| related(p.joint, q.joint))).collect();
        Self { parts, joined }
    }

    pub fn parts(&self) -> &'a [Part] {
        self.parts
    }

    /// The function at `p`, made by the parts `near` alone; `scratch` keeps their distances, in the
    /// order of `near`.
    pub fn sample(&self, p: Vec3, near: &[u16], scratch: &mut Scratch) -> Sample {
        scratch.clear();
        scratch.extend(near.iter().map(|&i| self.parts[usize::from(i)].distance(p)));
        // A fillet lowers a part by at most a quarter of its blend for each part it is joined to.
        let lowest = scratch.iter().map(|d| d.d).fold(f32::INFINITY, f32::min);
        let mut best = Sample { d: f32::INFINITY, gradient: Vec3::Y };
        for (k, &i) in near.iter().enumerate() {
            if scratch[k].d - self.parts[usize::from(i)].blend < lowest {
                let (d, gradient) = self.filleted(k, near, scratch);
                if d < best.d {
                    best = Sample { d, gradient };
                }
            }
        }
        best
    }

    /// The distance of one part, lowered where it meets the parts it is joined to.
    fn filleted(&self, k: usize, near: &[u16], all: &[Distance]) -> (f32, Vec3) {
        let i = usize::from(near[k]);
        let here = all[k];
        let (mut d, mut gradient) = (here.d, here.gradient);
        for (m, &j) in near.iter().enumerate() {
            let j = usize::from(j);
            if m == k || !self.joined[i * self.parts.len() + j] {
                continue;
            }
            let there = all[m];
            let blend = self.parts[i].blend.min(self.parts[j].blend);
            let gap = here.d - there.d;
            let q = 1.0 - gap.abs() / blend;
            if q <= 0.0 {
                continue;
            }
            // 0 where both surfaces face the same way, 1 in a right angle or sharper.
            let facing = (1.0 - here.gradient.dot(there.gradient)).min(1.0);
            d -= 0.25 * blend * q * q * facing;
            gradient += (here.gradient - there.gradient) * (0.5 * q * facing * gap.signum());
        }
        (d, gradient.try_normalize().unwrap_or(here.gradient))
    }

    /// The parts among `near` that can matter within `radius` of `center`, given their distances at
    /// `center`.
    pub fn prune(&self, center: Vec3, radius: f32, near: &[u16], distances: &[Distance], kept: &mut Vec<u16>) {
        let lowest = distances.iter().map(|d| d.d).fold(f32::INFINITY, f32::min);
        let limit = lowest + 2.0 * radius;
        kept.extend(near.iter().zip(distances).filter_map(|(&i, d)| {
            let part = &self.parts[usize::from(i)];
            // The distance is only to first order away from the surface; the axis gives a bound.
            let sure = part.axis_distance(center) - part.reach();
            (sure.max(0.6 * d.d.max(0.0)).min(d.d) <= limit + 1.5 * part.blend).then_some(i)
        }));
    }
}
