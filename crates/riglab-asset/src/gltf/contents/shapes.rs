//! Blend shapes of a mesh.

use std::collections::HashSet;

use serde_json::Value;

use super::meshes::Reader;
use super::{Mesh, Shape};
use crate::{Fault, Part};

/// Bytes of a point that a shape moves: its number, and what is added to it and to its normal.
const MOVED: usize = 4 + 12 + 12;

impl Reader<'_, '_> {
    /// How many shapes a mesh has.
    pub(super) fn shape_count(&self, mesh: usize) -> usize {
        let primitives = &self.places.document.meshes[mesh].primitives;
        primitives.iter().filter_map(|of| of.targets.as_array()).map(Vec::len).max().unwrap_or(0)
    }

    /// Adds the shapes of a mesh on a node, which may say how much of each is seen; `start` gives where the points of a part's
    /// set begin.
    pub(super) fn shapes(
        &mut self,
        own: &mut Mesh,
        (node, mesh): (usize, usize),
        parts: &[&Part],
        start: impl Fn(&Part) -> u32,
    ) -> Result<(), Fault> {
        let document = self.places.document;
        let weights = document.nodes[node].weights.as_array().or(document.meshes[mesh].weights.as_array());
        let weight = |number: usize| weights.and_then(|all| all.get(number)).and_then(Value::as_f64).unwrap_or(0.0);
        let count = self.shape_count(mesh);
        // Each of a part's first primitive: those that share points are moved by the same targets.
        let mut seen = HashSet::new();
        let parts: Vec<&Part> = parts.iter().copied().filter(|part| seen.insert(part.vertex_set)).collect();
        own.shapes = (0..count)
            .map(|number| Shape { name: self.shape_name(mesh, number), weight: weight(number), ..Shape::default() })
            .collect();
        for part in parts {
            let set = &self.sources.sets[part.vertex_set];
            let targets = document.meshes[mesh].primitives[part.primitive].targets.as_array();
            for (shape, target) in own.shapes.iter_mut().zip(targets.into_iter().flatten()) {
                let mut of = |name: &str| {
                    let accessor = target[name].as_u64().and_then(|n| usize::try_from(n).ok())?;
                    self.directions(accessor, set.positions.len())
                };
                let (offsets, normals) = (of("POSITION"), of("NORMAL"));
                self.accessors.budget().show((set.numbers.len() * MOVED) as u64, 1)?;
                shape.has_normals |= normals.is_some();
                for (&v, point) in set.numbers.iter().zip(start(part)..) {
                    let by =
                        |all: &Option<std::rc::Rc<[[f32; 3]]>>| all.as_ref().map_or([0.0; 3], |all| all[v as usize]);
                    let (offset, normal) = (by(&offsets), by(&normals));
                    if offset != [0.0; 3] || normal != [0.0; 3] {
                        shape.points.push(point);
                        shape.offsets.push(offset);
                        shape.normals.push(normal);
                    }
                }
            }
        }
        Ok(())
    }

    /// As files name it, of the mesh or, as older ones do, of its first primitive.
    fn shape_name(&self, mesh: usize, number: usize) -> String {
        let own = &self.json["meshes"][mesh];
        let places = [&own["extras"], &own["primitives"][0]["extras"]];
        let name = places.into_iter().find_map(|extras| extras["targetNames"][number].as_str());
        name.filter(|name| !name.is_empty()).map_or_else(|| format!("shape {number}"), str::to_owned)
    }
}
