//! Skeletons as solids: a ball for each joint, a tapered bone for each link to a child.

use glam::Vec3;
use riglab_core::Skeleton;

use crate::Rgb;
use crate::color::joint_color;
use crate::shade::{Paint, Solid};
use crate::view::Projector;

/// The colours of a skeleton.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum BoneColors {
    /// Each joint and its bones in [`joint_color`], as in a picture of parts.
    #[default]
    ByJoint,
    /// All alike: for one skeleton against another.
    Plain(Rgb),
}

/// Radius of the largest joint, as a share of the picture.
const JOINT: f32 = 0.0095;
/// Radius of the smallest, in samples: two make a pixel.
const SMALLEST: f32 = 2.4;

/// Skeletons in samples of a picture whose shorter side has `side` of them.
///
/// Leaves are joints only: where their bones end is not part of a skeleton.
pub(crate) fn solid(skeletons: &[(&Skeleton, BoneColors)], projector: &Projector, side: usize) -> Solid {
    let mut build = Build::default();
    for (skeleton, colors) in skeletons {
        let heads: Vec<Vec3> = skeleton.heads().iter().map(|&h| projector.project(h)).collect();
        let radii = radii(skeleton, &heads, side as f32 * JOINT);
        let color = |joint: usize| match colors {
            BoneColors::ByJoint => joint_color(joint).linear(),
            BoneColors::Plain(color) => color.linear(),
        };
        for joint in skeleton.ids() {
            let at = joint.index();
            build.ball(heads[at], radii[at], color(at));
            if let Some(parent) = skeleton.parent(joint).map(|p| p.index()) {
                build.bone(heads[parent], heads[at], radii[parent], color(parent));
            }
        }
    }
    let Build { mut solid, colors } = build;
    solid.paint = Paint::Colors(colors);
    solid
}

/// Joints shrink where bones are short: fingers stay apart.
fn radii(skeleton: &Skeleton, heads: &[Vec3], largest: f32) -> Vec<f32> {
    let largest = largest.max(SMALLEST);
    let mut radii = vec![largest; heads.len()];
    for joint in skeleton.ids() {
        if let Some(parent) = skeleton.parent(joint) {
            let length = heads[joint.index()].distance(heads[parent.index()]);
            for end in [joint.index(), parent.index()] {
                radii[end] = radii[end].min((0.28 * length).max(SMALLEST));
            }
        }
    }
    radii
}

#[derive(Default)]
struct Build {
    solid: Solid,
    colors: Vec<Vec3>,
}

impl Build {
    fn vertex(&mut self, position: Vec3, normal: Vec3, color: Vec3) -> u32 {
        self.solid.positions.push(position);
        self.solid.normals.push(normal);
        self.colors.push(color);
        self.solid.positions.len() as u32 - 1
    }

    /// A triangle of one flat face.
    fn facet(&mut self, corners: [Vec3; 3], color: Vec3) {
        let [a, b, c] = corners;
        let normal = (b - a).cross(c - a).normalize_or(Vec3::Z);
        let corners = corners.map(|p| self.vertex(p, normal, color));
        self.solid.triangles.push(corners);
    }

    /// An octahedron twice split and rounded.
    fn ball(&mut self, center: Vec3, radius: f32, color: Vec3) {
        // Only the half towards the viewer: the other is never seen.
        for [x, y] in [[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]] {
            self.patch([Vec3::X * x, Vec3::Y * y, Vec3::Z], 2, &|n| center + radius * n, color);
        }
    }

    fn patch(&mut self, [a, b, c]: [Vec3; 3], splits: u32, place: &dyn Fn(Vec3) -> Vec3, color: Vec3) {
        if splits == 0 {
            let corners = [a, b, c].map(|n| self.vertex(place(n), n, color));
            self.solid.triangles.push(corners);
            return;
        }
        let [ab, bc, ca] = [a + b, b + c, c + a].map(Vec3::normalize);
        for corners in [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]] {
            self.patch(corners, splits - 1, place, color);
        }
    }

    /// An octahedron drawn out along the bone, widest near its head: shows which way it points.
    fn bone(&mut self, head: Vec3, tail: Vec3, radius: f32, color: Vec3) {
        let along = tail - head;
        let Some(direction) = along.try_normalize() else { return };
        let (u, v) = direction.any_orthonormal_pair();
        let width = (0.09 * along.length()).clamp(0.55 * radius, 1.5 * radius);
        let waist = head + 0.16 * along;
        let ring = [u, v, -u, -v].map(|side| waist + width * side);
        for k in 0..4 {
            let (a, b) = (ring[k], ring[(k + 1) % 4]);
            self.facet([head, a, b], color);
            self.facet([a, tail, b], color);
        }
    }
}
