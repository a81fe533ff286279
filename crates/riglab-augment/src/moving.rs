//! Moving a draft: vertices, joints, springs and colliders together.

use glam::{Affine3A, Vec3A};
use riglab_core::{Collider, Shape, Vec3};

use crate::draft::{Draft, moderate};

impl Draft {
    /// Moves all by an affine map. Normals are those of the geometry afterwards, triangles keep
    /// their winding.
    pub(crate) fn transform(&mut self, map: Affine3A) {
        for p in self.positions.iter_mut().chain(&mut self.heads) {
            *p = apply(map, *p);
        }
        let size = size(map);
        for spring in self.springs.iter_mut().flat_map(|s| &mut s.joints) {
            spring.tail = spring.tail.map(|t| apply(map, t));
            spring.swing.hit_radius = (spring.swing.hit_radius * size).min(FAR);
            // Gravity turns with the space, its strength is a number of its own.
            let pull = Vec3A::from(spring.swing.gravity_direction);
            let turned = (map.matrix3 * pull).normalize_or_zero() * pull.length();
            if turned.is_finite() {
                spring.swing.gravity_direction = turned.into();
            }
        }
        for collider in &mut self.colliders {
            *collider = moved(collider, map, size);
        }
        self.motion.rest.iter_mut().for_each(|rest| *rest = map * *rest);
        self.motion.world = map * self.motion.world;
        self.normals = None;
    }

    /// Moves what each joint holds by the joint's map, and the joints too: linear blend skinning
    /// whose result is the new rest. Gives back whether it did: nothing changes when a coordinate
    /// would leave the range of safe numbers.
    pub(crate) fn deform(&mut self, maps: &[Affine3A]) -> bool {
        let posed = |(v, &p): (usize, &Vec3)| {
            let p = Vec3A::from(p);
            let (sum, total) = self.row(v).fold((Vec3A::ZERO, 0.0), |(sum, total), (joint, w)| {
                (sum + w * maps[joint].transform_point3a(p), total + w)
            });
            Vec3::from(sum / total)
        };
        let positions: Vec<Vec3> = self.positions.iter().enumerate().map(posed).collect();
        let heads: Vec<Vec3> = self.heads.iter().zip(maps).map(|(&h, &map)| apply(map, h)).collect();
        let before = (self.springs.clone(), self.colliders.clone());
        for spring in self.springs.iter_mut().flat_map(|s| &mut s.joints) {
            let map = maps[spring.joint.index()];
            spring.tail = spring.tail.map(|t| apply(map, t));
            spring.swing.hit_radius *= size(map);
        }
        for collider in &mut self.colliders {
            let map = maps[collider.joint.index()];
            *collider = moved(collider, map, size(map));
        }
        if !(moderate(&positions) && moderate(&heads) && self.springs_are_moderate()) {
            (self.springs, self.colliders) = before;
            return false;
        }
        (self.positions, self.heads, self.normals) = (positions, heads, None);
        self.motion.rest.iter_mut().zip(maps).for_each(|(rest, map)| *rest = *map * *rest);
        true
    }

    /// Whether tails, colliders and radii are of a size that no step makes overflow.
    pub(crate) fn springs_are_moderate(&self) -> bool {
        let tails = self.springs.iter().flat_map(|s| &s.joints);
        tails.into_iter().all(|j| moderate(j.tail.as_slice()) && moderate(&[[j.swing.hit_radius; 3]]))
            && self.colliders.iter().all(|c| match c.shape {
                Shape::Sphere { center, radius } => moderate(&[center, [radius; 3]]),
                Shape::Capsule { from, to, radius } => moderate(&[from, to, [radius; 3]]),
            })
    }
}

/// What a coordinate beside the body, such as a tail, may be at most: far from overflow.
const FAR: f32 = 1e30;

pub(crate) fn apply(map: Affine3A, p: Vec3) -> Vec3 {
    map.transform_point3a(p.into()).clamp(Vec3A::splat(-FAR), Vec3A::splat(FAR)).into()
}

/// How much a map enlarges lengths: the cube root of what it does to volumes.
fn size(map: Affine3A) -> f32 {
    libm::cbrtf(map.matrix3.determinant().abs())
}

fn moved(collider: &Collider, map: Affine3A, size: f32) -> Collider {
    let shape = match collider.shape {
        Shape::Sphere { center, radius } => {
            Shape::Sphere { center: apply(map, center), radius: (radius * size).min(FAR) }
        }
        Shape::Capsule { from, to, radius } => {
            Shape::Capsule { from: apply(map, from), to: apply(map, to), radius: (radius * size).min(FAR) }
        }
    };
    Collider { shape, ..*collider }
}
