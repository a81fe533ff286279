//! Geometry moved into the scene: positions, normals, tangents and morph targets of primitives.

use std::collections::HashMap;

use glam::{DAffine3, DMat3, DVec3};
use serde_json::{Value, json};

use super::super::accessor::Accessors;
use super::draft::{ARRAY, Draft, VEC4, index};
use crate::Fault;

/// Moves the primitives of one node by one map.
pub(super) struct Baker<'a, 'd> {
    accessors: &'a Accessors<'d>,
    map: DAffine3,
    /// For normals.
    across: DMat3,
    /// What was moved already, by accessor and what it is used as: primitives share accessors.
    done: HashMap<(usize, Use), usize>,
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Use {
    Point,
    /// What a morph target adds to a point.
    Offset,
    /// What it adds to a normal or tangent.
    Turn,
    Normal,
    Tangent,
}

impl<'a, 'd> Baker<'a, 'd> {
    pub(super) fn new(accessors: &'a Accessors<'d>, map: DAffine3) -> Self {
        // The cofactors: the inverse transposed, but for a factor, also where there is no inverse.
        let [x, y, z] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis];
        let across = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
        let across = if map.matrix3.determinant() < 0.0 { -across } else { across };
        Self { accessors, map, across, done: HashMap::new() }
    }

    /// Moves everything of a primitive that lies or points somewhere. `positions` are where its vertices
    /// are to lie, if that is known better than by the map.
    pub(super) fn primitive(
        &mut self,
        draft: &mut Draft,
        (mesh, primitive): (usize, usize),
        positions: Option<usize>,
    ) -> Result<(), Fault> {
        let mut own = draft.list("meshes")[mesh]["primitives"][primitive].clone();
        if let Some(attributes) = own.get_mut("attributes") {
            self.attribute(draft, attributes, "POSITION", Use::Point, positions)?;
            self.attribute(draft, attributes, "NORMAL", Use::Normal, None)?;
            self.attribute(draft, attributes, "TANGENT", Use::Tangent, None)?;
        }
        for target in own.get_mut("targets").and_then(Value::as_array_mut).into_iter().flatten() {
            for (name, used) in [("POSITION", Use::Offset), ("NORMAL", Use::Turn), ("TANGENT", Use::Turn)] {
                self.attribute(draft, target, name, used, None)?;
            }
        }
        draft.list_mut("meshes")[mesh]["primitives"][primitive] = own;
        Ok(())
    }

    fn attribute(
        &mut self,
        draft: &mut Draft,
        attributes: &mut Value,
        name: &str,
        used: Use,
        known: Option<usize>,
    ) -> Result<(), Fault> {
        let Some(accessor) = attributes.get(name).and_then(index) else { return Ok(()) };
        let moved = match (known, self.done.get(&(accessor, used))) {
            (Some(known), _) => known,
            (None, Some(&done)) => done,
            (None, None) => {
                let moved = self.moved(draft, accessor, used)?;
                self.done.insert((accessor, used), moved);
                moved
            }
        };
        attributes[name] = json!(moved);
        Ok(())
    }

    fn moved(&self, draft: &mut Draft, accessor: usize, used: Use) -> Result<usize, Fault> {
        self.accessors.check(accessor, || "a primitive".into())?;
        let linear = self.map.matrix3;
        // Normals keep their length.
        let scale = linear.determinant().abs().cbrt().max(f64::MIN_POSITIVE);
        let finite = |v: DVec3| if v.as_vec3().is_finite() { v.as_vec3() } else { glam::Vec3::ZERO }.to_array();
        let of = |v: [f32; 3]| glam::Vec3::from(v).as_dvec3();
        if used == Use::Tangent {
            let tangents = self.accessors.tangents(accessor)?;
            let mut bytes = Vec::with_capacity(16 * tangents.len());
            for [x, y, z, side] in tangents {
                let along = finite((linear * of([x, y, z])).normalize_or(DVec3::X));
                bytes.extend([along[0], along[1], along[2], side].iter().flat_map(|x| x.to_le_bytes()));
            }
            return Ok(draft.accessor(&bytes, VEC4, Some(ARRAY)));
        }
        let mut vectors = match used {
            Use::Point => self.accessors.positions(accessor)?.to_vec(),
            _ => self.accessors.directions(accessor)?,
        };
        for v in &mut vectors {
            *v = finite(match used {
                Use::Point => self.map.transform_point3(of(*v)),
                Use::Normal => (self.across * of(*v)).normalize_or(DVec3::Y),
                Use::Offset => linear * of(*v),
                Use::Turn | Use::Tangent => linear * of(*v) / scale,
            });
        }
        // Morph targets of positions have bounds, too.
        Ok(draft.vectors(&vectors, matches!(used, Use::Point | Use::Offset), Some(ARRAY)))
    }
}
