//! What `riglab inspect` prints.

use std::collections::BTreeMap;

use riglab_core::{Humanoid, Springs, Vec3};
use serde::Serialize;

use crate::{Binding, Imported, Part, Reading};

/// How many vertices are shown unless all are asked for.
const SAMPLES: usize = 40;

/// What was read, for people and scripts: serialises to the JSON of `riglab inspect --json`.
///
/// Counts and samples are of skinned primitives, or of all where the file has no skeleton. A vertex
/// counts once for each primitive that uses it.
#[derive(Clone, Debug, Serialize)]
pub struct Inspection<'a> {
    /// The path as given.
    pub file: &'a str,
    /// All joints, possibly with several roots.
    pub joints: Vec<InspectedJoint<'a>>,
    /// Vertices that triangles use.
    pub vertices: usize,
    /// Triangles with three different vertices, repeated ones counted once.
    pub triangles: usize,
    /// The sum of the weights of every joint that has some.
    pub weight_totals: BTreeMap<&'a str, f64>,
    /// Vertices, sorted by node, primitive and number, evenly picked.
    pub samples: Vec<Sample<'a>>,
    /// What was repaired or is doubtful.
    pub warnings: Vec<String>,
    /// Vertices as stored: once for primitives that share them, used or not.
    pub file_vertices: usize,
    /// Triangles as stored.
    pub file_triangles: usize,
    /// Stored vertices of unskinned meshes that became rigid parts.
    pub rigid_vertices: usize,
    /// Stored triangles of unskinned meshes that became rigid parts.
    pub rigid_triangles: usize,
    /// The joint of each human bone, by index in the list.
    pub humanoid: &'a Humanoid,
    /// Springs, colliders and groups of colliders.
    #[serde(flatten)]
    pub springs: &'a Springs,
    /// Licence, as an SPDX name where known.
    pub licence: &'a str,
    /// Who is to be credited.
    pub author: &'a str,
    /// How far the file shows the model from where joints and vertices are told to be; see [`Reading::shown_off`].
    pub shown_off: Vec3,
}

/// A joint.
#[derive(Clone, Debug, Serialize)]
pub struct InspectedJoint<'a> {
    /// Unique.
    pub name: &'a str,
    /// Its node's number in the file.
    pub node: usize,
    /// Index of its parent in the list.
    pub parent: Option<usize>,
    /// Position at rest.
    pub head: Vec3,
}

/// A vertex.
#[derive(Clone, Debug, Serialize)]
pub struct Sample<'a> {
    /// Number of the node that holds the mesh.
    pub node: usize,
    /// Number of the primitive in the mesh.
    pub primitive: usize,
    /// Number of the vertex in the primitive.
    pub vertex: u32,
    /// Rest position.
    pub position: Vec3,
    /// Joint names and weights above 0.
    pub weights: BTreeMap<&'a str, f32>,
}

impl Imported {
    /// What was read; with every vertex as a sample if `all_vertices`.
    pub fn inspect(&self, all_vertices: bool) -> Inspection<'_> {
        let reading = &self.reading;
        let shown = if reading.joints.is_empty() { Binding::Free } else { Binding::Skinned };
        let parts: Vec<&Part> = reading.parts.iter().filter(|p| reading.binding(p) == shown).collect();
        let vertices = parts.iter().map(|p| p.used.len()).sum();
        let (file_vertices, file_triangles) = stored(reading, shown);
        let (rigid_vertices, rigid_triangles) = stored(reading, Binding::Rigid);
        Inspection {
            file: &self.provenance.source,
            joints: reading
                .joints
                .iter()
                .map(|j| InspectedJoint {
                    name: &j.name,
                    node: j.node,
                    parent: j.parent,
                    head: reading.up.to_y(j.head),
                })
                .collect(),
            vertices,
            triangles: parts.iter().map(|p| p.triangles.len()).sum(),
            weight_totals: weight_totals(reading, &parts),
            samples: samples(reading, &parts, vertices, if all_vertices { vertices } else { SAMPLES }),
            warnings: reading.warnings.iter().map(ToString::to_string).collect(),
            file_vertices,
            file_triangles,
            rigid_vertices,
            rigid_triangles,
            humanoid: &reading.body.humanoid,
            springs: &reading.body.springs,
            licence: &self.provenance.licence,
            author: &self.provenance.author,
            shown_off: reading.up.to_y(reading.shown_off),
        }
    }
}

fn stored(reading: &Reading, binding: Binding) -> (usize, usize) {
    let sets = reading.vertex_sets.iter().filter(|s| s.binding == binding);
    let parts = reading.parts.iter().filter(|p| reading.binding(p) == binding);
    (sets.map(|s| s.stored).sum(), parts.map(|p| p.stored).sum())
}

fn weight_totals<'a>(reading: &'a Reading, parts: &[&Part]) -> BTreeMap<&'a str, f64> {
    let mut totals = vec![0.0; reading.joints.len()];
    for part in parts {
        let Some(weights) = &reading.vertex_sets[part.vertex_set].weights else { continue };
        for &v in &part.used {
            for (joint, weight) in weights.row(v as usize) {
                totals[joint.index()] += f64::from(weight);
            }
        }
    }
    let named = reading.joints.iter().zip(totals).filter(|(_, total)| *total > 0.0);
    named.map(|(joint, total)| (joint.name.as_str(), total)).collect()
}

/// The vertices at floor(i * vertices / wanted) of all parts in a row.
fn samples<'a>(reading: &'a Reading, parts: &[&Part], vertices: usize, wanted: usize) -> Vec<Sample<'a>> {
    let mut samples = Vec::new();
    let mut next = (0..wanted).map(|i| i * vertices / wanted).peekable();
    let mut start = 0;
    for part in parts {
        let set = &reading.vertex_sets[part.vertex_set];
        while let Some(at) = next.next_if(|&at| at < start + part.used.len()) {
            // Fewer vertices than samples: some come up again.
            while next.next_if_eq(&at).is_some() {}
            let v = part.used[at - start] as usize;
            let row = set.weights.iter().flat_map(|w| w.row(v));
            samples.push(Sample {
                node: part.node,
                primitive: part.primitive,
                vertex: set.numbers[v],
                position: reading.up.to_y(set.positions[v]),
                weights: row.map(|(joint, weight)| (reading.joints[joint.index()].name.as_str(), weight)).collect(),
            });
        }
        start += part.used.len();
    }
    samples
}
