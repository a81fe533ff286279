//! Geometry moved into the scene: positions, normals, tangents and morph targets of primitives.

use std::collections::HashMap;
use std::rc::Rc;

use glam::{DAffine3, DMat3, DVec3};
use serde_json::{Value, json};

use super::super::accessor::Accessors;
use super::draft::{ARRAY, Draft, VEC4, index};
use crate::Fault;
use crate::maps::is_mirrored;

/// Moves the primitives of one node by one map.
pub(super) struct Baker<'a, 'd> {
    accessors: &'a Accessors<'d>,
    map: DAffine3,
    /// For normals.
    across: DMat3,
    /// What was moved already, by accessor and what it is used as: primitives share accessors.
    done: HashMap<(usize, Use), usize>,
    /// How long the vectors become that morph targets add to: all targets of a primitive have them in common.
    lengths: HashMap<Use, Rc<[f64]>>,
}

#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum Use {
    Point,
    /// What a morph target adds to a point.
    Offset,
    /// What it adds to the normals of an accessor.
    NormalOffset(usize),
    /// What it adds to the tangents of an accessor.
    TangentOffset(usize),
    Normal,
    Tangent,
}

impl<'a, 'd> Baker<'a, 'd> {
    pub(super) fn new(accessors: &'a Accessors<'d>, map: DAffine3) -> Self {
        // The cofactors: the inverse transposed, but for a factor, also where there is no inverse.
        let [x, y, z] = [map.matrix3.x_axis, map.matrix3.y_axis, map.matrix3.z_axis];
        let across = DMat3::from_cols(y.cross(z), z.cross(x), x.cross(y));
        let across = if map.matrix3.determinant() < 0.0 { -across } else { across };
        Self { accessors, map, across, done: HashMap::new(), lengths: HashMap::new() }
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
        let [normals, tangents] = ["NORMAL", "TANGENT"].map(|name| own["attributes"].get(name).and_then(index));
        if let Some(attributes) = own.get_mut("attributes") {
            self.attribute(draft, attributes, "POSITION", Use::Point, positions)?;
            self.attribute(draft, attributes, "NORMAL", Use::Normal, None)?;
            self.attribute(draft, attributes, "TANGENT", Use::Tangent, None)?;
        }
        for target in own.get_mut("targets").and_then(Value::as_array_mut).into_iter().flatten() {
            self.attribute(draft, target, "POSITION", Use::Offset, None)?;
            // Nothing is added to what is not there: the format asks for both or none.
            if let Some(normals) = normals {
                self.attribute(draft, target, "NORMAL", Use::NormalOffset(normals), None)?;
            }
            if let Some(tangents) = tangents {
                self.attribute(draft, target, "TANGENT", Use::TangentOffset(tangents), None)?;
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

    fn moved(&mut self, draft: &mut Draft, accessor: usize, used: Use) -> Result<usize, Fault> {
        self.accessors.check(accessor, || "a primitive".into())?;
        let linear = self.map.matrix3;
        let finite = |v: DVec3| if v.as_vec3().is_finite() { v.as_vec3() } else { glam::Vec3::ZERO }.to_array();
        let of = |v: [f32; 3]| glam::Vec3::from(v).as_dvec3();
        if used == Use::Tangent {
            // The bitangent is the cross product of normal and tangent times the side, and a mirrored map takes such products
            // to the opposite of what it takes the bitangent to.
            let hand = if is_mirrored(&self.map) { -1.0 } else { 1.0 };
            let tangents = self.accessors.tangents(accessor)?;
            let mut bytes = Vec::with_capacity(16 * tangents.len());
            for [x, y, z, side] in tangents {
                let along = finite((linear * of([x, y, z])).normalize_or(DVec3::X));
                bytes.extend([along[0], along[1], along[2], hand * side].iter().flat_map(|x| x.to_le_bytes()));
            }
            return Ok(draft.accessor(&bytes, VEC4, Some(ARRAY)));
        }
        let lengths = self.lengths(used)?;
        let mut vectors = match used {
            Use::Point => self.accessors.positions(accessor)?.to_vec(),
            _ => self.accessors.directions(accessor)?,
        };
        // What is added to a vector is shortened or drawn out as that vector is by its new length: so their sum, at whatever
        // weight, looks where the map takes the sum of the old ones.
        let added = |map: DMat3, v: [f32; 3], number: usize| match lengths.get(number) {
            Some(&length) if length > 0.0 => map * of(v) / length,
            _ => DVec3::ZERO,
        };
        for (number, v) in vectors.iter_mut().enumerate() {
            *v = finite(match used {
                Use::Point => self.map.transform_point3(of(*v)),
                Use::Normal => (self.across * of(*v)).normalize_or(DVec3::Y),
                Use::Offset | Use::Tangent => linear * of(*v),
                Use::NormalOffset(_) => added(self.across, *v, number),
                Use::TangentOffset(_) => added(linear, *v, number),
            });
        }
        // Morph targets of positions have bounds, too.
        Ok(draft.vectors(&vectors, matches!(used, Use::Point | Use::Offset), Some(ARRAY)))
    }

    /// How long the vectors that something is added to are once they are moved; none of other uses.
    fn lengths(&mut self, used: Use) -> Result<Rc<[f64]>, Fault> {
        if let Some(known) = self.lengths.get(&used) {
            return Ok(known.clone());
        }
        let length = |map: DMat3, v: [f32; 3]| (map * glam::Vec3::from(v).as_dvec3()).length();
        let found: Rc<[f64]> = match used {
            Use::NormalOffset(normals) => {
                self.accessors.directions(normals)?.into_iter().map(|v| length(self.across, v)).collect()
            }
            Use::TangentOffset(tangents) => {
                let all = self.accessors.tangents(tangents)?.into_iter();
                all.map(|[x, y, z, _]| length(self.map.matrix3, [x, y, z])).collect()
            }
            Use::Point | Use::Offset | Use::Normal | Use::Tangent => Rc::default(),
        };
        self.lengths.insert(used, found.clone());
        Ok(found)
    }
}

#[cfg(test)]
mod tests {
    use glam::{DQuat, Vec3};

    use super::super::super::buffers::Buffers;
    use super::*;
    use crate::budget::Budget;

    /// Numbers of an accessor of floats that was written, by element.
    fn numbers(draft: &Draft, accessor: &Value) -> Vec<Vec<f32>> {
        let accessor = &draft.json["accessors"][accessor.as_u64().unwrap() as usize];
        let view = &draft.json["bufferViews"][accessor["bufferView"].as_u64().unwrap() as usize];
        let [from, length] = ["byteOffset", "byteLength"].map(|key| view[key].as_u64().unwrap() as usize);
        let bytes = &draft.binary[from - draft.base..from - draft.base + length];
        let wide = if accessor["type"] == "VEC4" { 4 } else { 3 };
        let numbers: Vec<f32> = bytes.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        numbers.chunks(wide).map(<[f32]>::to_vec).collect()
    }

    fn vector(v: &[f32]) -> DVec3 {
        Vec3::new(v[0], v[1], v[2]).as_dvec3()
    }

    fn vectors(draft: &Draft, accessor: &Value) -> Vec<DVec3> {
        numbers(draft, accessor).iter().map(|v| vector(v)).collect()
    }

    const NORMALS: [[f32; 3]; 2] = [[0.0, 1.0, 0.0], [0.6, 0.0, 0.8]];
    const TANGENTS: [[f32; 4]; 2] = [[1.0, 0.0, 0.0, 1.0], [0.8, 0.0, -0.6, -1.0]];

    /// Mirrored, sheared, both, and neither.
    fn maps() -> [DAffine3; 4] {
        let turn = DQuat::from_rotation_z(0.8);
        let mirrored = DAffine3::from_scale_rotation_translation(DVec3::new(-2.0, 3.0, 1.4), turn, DVec3::ONE);
        let sheared = DAffine3::from_cols_array_2d(&[[1.0, 0.0, 0.0], [0.3, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]]);
        [mirrored, sheared, mirrored * sheared, DAffine3::from_translation(DVec3::ONE)]
    }

    /// [`NORMALS`] and [`TANGENTS`] with what a morph target adds to both, moved by each of the maps.
    fn moved(offsets: [[f32; 3]; 2]) -> Vec<(DAffine3, Draft)> {
        let mut draft = Draft::new(json!({}));
        let floats = |all: &[f32]| all.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>();
        let normal = draft.vectors(&NORMALS, false, None);
        let tangent = draft.accessor(&floats(TANGENTS.as_flattened()), VEC4, None);
        let offset = draft.vectors(&offsets, false, None);
        draft.json["meshes"] = json!([{"primitives": [{
            "attributes": {"NORMAL": normal, "TANGENT": tangent}, "targets": [{"NORMAL": offset, "TANGENT": offset}],
        }]}]);
        draft.json["buffers"] = json!([{"byteLength": draft.binary.len()}]);
        draft.json["asset"] = json!({"version": "2.0"});
        let base = draft.freeze();
        let document = super::super::super::document::Document::parse(draft.json.to_string().as_bytes()).unwrap();
        let accessors = Accessors::new(&document, Buffers::new(&document, Some(&base), None, Budget::new(base.len())));

        let baked = |map: DAffine3| {
            let mut own = Draft { json: draft.json.clone(), base: draft.base, binary: Vec::new() };
            Baker::new(&accessors, map).primitive(&mut own, (0, 0), None).unwrap();
            (map, own)
        };
        maps().map(baked).into()
    }

    #[test]
    fn bitangents_of_normal_maps_keep_their_side_where_a_map_mirrors() {
        for (map, own) in moved([[0.0; 3]; 2]) {
            let attributes = &own.list("meshes")[0]["primitives"][0]["attributes"];
            let (normals, tangents) = (vectors(&own, &attributes["NORMAL"]), numbers(&own, &attributes["TANGENT"]));
            for v in 0..2 {
                let across = |normal: DVec3, tangent: &[f32]| normal.cross(vector(tangent)) * f64::from(tangent[3]);
                let wanted = map.matrix3 * across(vector(&NORMALS[v]), &TANGENTS[v]);
                let is = across(normals[v], &tangents[v]);
                assert!(wanted.normalize().dot(is) > 0.5, "{v}: {is} for {wanted} by {map}");
            }
        }
    }

    #[test]
    fn morphed_normals_and_tangents_look_where_the_map_takes_them_at_every_weight() {
        let offsets = [[0.3, -0.4, 0.2], [-0.1, 0.7, 0.05f32]];
        for (map, own) in moved(offsets) {
            let baked = &own.list("meshes")[0]["primitives"][0];
            let to_normal = map.matrix3.inverse().transpose();
            for (name, old, through) in [
                ("NORMAL", NORMALS.to_vec(), to_normal),
                ("TANGENT", TANGENTS.map(|[x, y, z, _]| [x, y, z]).to_vec(), map.matrix3),
            ] {
                let new = vectors(&own, &baked["attributes"][name]);
                let added = vectors(&own, &baked["targets"][0][name]);
                for v in 0..2 {
                    assert!((new[v].length() - 1.0).abs() < 1e-6);
                    for weight in [0.0, 0.4, 1.0] {
                        let before = Vec3::from(old[v]).as_dvec3() + weight * Vec3::from(offsets[v]).as_dvec3();
                        let (wanted, is) = ((through * before).normalize(), (new[v] + weight * added[v]).normalize());
                        assert!(is.abs_diff_eq(wanted, 1e-6), "{name} {v} at {weight}: {is} for {wanted}");
                    }
                }
                // What is only moved stays as it is.
                if map == maps()[3] {
                    assert_eq!(added, offsets.map(|v| Vec3::from(v).as_dvec3()));
                }
            }
        }
    }
}
