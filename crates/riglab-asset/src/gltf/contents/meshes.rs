//! Surfaces with what their corners have, and their skins.

use std::collections::HashMap;
use std::rc::Rc;

use glam::{DAffine3, DMat3};
use serde_json::Value;

use super::{Cluster, Contents, Layer, Look, Mesh, Places, Skin, looks};
use crate::gltf::accessor::Accessors;
use crate::gltf::influences;
use crate::gltf::primitives::{SourceSet, Sources};
use crate::influences::Repairs;
use crate::maps::is_mirrored;
use crate::{Fault, Part, triangles};

/// Sets of coordinates, or of colours, that are read of a mesh: as many as programs have places for.
const MAX_SETS: usize = 8;

/// Bytes of a corner: its vertex and point, its normal, and an index and values of each of two layers.
const CORNER: usize = 2 * 4 + 12 + 2 * (4 + 8);

/// Reads meshes node by node.
pub(super) struct Reader<'a, 'd> {
    pub(super) places: &'a Places<'a>,
    pub(super) json: &'a Value,
    pub(super) accessors: &'a Accessors<'d>,
    pub(super) sources: &'a Sources,
    /// The place of each node among those of the contents.
    number: &'a [usize],
    /// Parts of each node, one after the other.
    parts: HashMap<usize, Vec<&'a Part>>,
    /// Meshes that several nodes may show.
    shared: HashMap<usize, usize>,
    /// How many materials the document has, and the one that stands for none.
    materials: usize,
    plain: Option<usize>,
    directions: Decoded<3>,
    coordinates: Decoded<2>,
    colours: Decoded<4>,
    /// How many of those could not be read.
    pub(super) unread: usize,
}

/// Decoded accessors; none where one cannot be read.
type Decoded<const N: usize> = HashMap<usize, Option<Rc<[[f32; N]]>>>;

/// A mesh that is being put together.
#[derive(Default)]
struct Growing {
    mesh: Mesh,
    /// The triangles of each part, by the file's vertices.
    corners: Vec<Vec<[u32; 3]>>,
    /// Where the points of each set begin.
    starts: HashMap<usize, u32>,
    /// Where the values of an accessor begin in a layer, for the points of a set: by set, accessor and layer.
    of_coordinates: HashMap<(usize, usize, usize), u32>,
    of_colours: HashMap<(usize, usize, usize), u32>,
}

impl<'a, 'd> Reader<'a, 'd> {
    pub(super) fn new(
        places: &'a Places<'a>,
        json: &'a Value,
        accessors: &'a Accessors<'d>,
        sources: &'a Sources,
        number: &'a [usize],
    ) -> Self {
        let mut parts: HashMap<usize, Vec<&Part>> = HashMap::new();
        sources.parts.iter().for_each(|part| parts.entry(part.node).or_default().push(part));
        let materials = json["materials"].as_array().map_or(0, Vec::len);
        let (shared, plain, directions, coordinates, colours, unread) = Default::default();
        Self {
            places,
            json,
            accessors,
            sources,
            number,
            parts,
            shared,
            materials,
            plain,
            directions,
            coordinates,
            colours,
            unread,
        }
    }

    /// The mesh of a node among those of the contents, to which it is added where it is not there yet.
    pub(super) fn mesh(&mut self, node: usize, contents: &mut Contents) -> Result<Option<usize>, Fault> {
        let Some(mesh) = self.places.document.nodes[node].mesh else { return Ok(None) };
        let Some(parts) = self.parts.remove(&node).filter(|parts| !parts.is_empty()) else { return Ok(None) };
        let skin = parts.iter().find_map(|part| self.sources.sets[part.vertex_set].skin);
        let is_shared = skin.is_none() && self.shape_count(mesh) == 0;
        if let Some(&known) = self.shared.get(&mesh).filter(|_| is_shared) {
            return Ok(Some(known));
        }
        let corners: usize = parts.iter().map(|part| 3 * part.stored).sum();
        self.accessors.budget().show((corners * CORNER) as u64, 1)?;
        let mut growing = Growing::default();
        let name = self.json["meshes"][mesh]["name"].as_str().filter(|name| !name.is_empty());
        growing.mesh.name = name.map_or_else(|| format!("mesh {mesh}"), str::to_owned);
        let turned = skin.is_some_and(|skin| self.is_turned(node, skin));
        for part in &parts {
            self.part(&mut growing, mesh, part, turned)?;
        }
        if growing.mesh.triangles.is_empty() {
            return Ok(None);
        }
        self.looks(&mut growing, mesh, &parts, &mut contents.looks);
        self.layers(&mut growing, mesh, &parts);
        if let Some(skin) = skin {
            growing.mesh.skin = Some(self.skin(&growing, skin, &parts)?);
        }
        let starts = std::mem::take(&mut growing.starts);
        self.shapes(&mut growing.mesh, (node, mesh), &parts, |part| starts[&part.vertex_set])?;
        if let Some(skin) = skin.filter(|skin| !self.is_bound(*skin)) {
            growing.mesh.put_at_rest(self.places.binds.maps(skin));
        }
        let own = contents.meshes.len();
        contents.meshes.push(growing.mesh);
        if is_shared {
            self.shared.insert(mesh, own);
        }
        Ok(Some(own))
    }

    /// Whether the triangles of a skinned mesh face outwards when they are turned round: its node says so where it mirrors
    /// (3.7.4 of glTF 2.0), and so does rest where it mirrors what is shown; in lists what binds it.
    fn is_turned(&self, node: usize, skin: usize) -> bool {
        let bound = self.is_bound(skin) && self.places.binds.maps(skin).first().is_some_and(is_mirrored);
        is_mirrored(self.places.nodes.global(node)) ^ self.places.binds.mirrors(skin) ^ bound
    }

    /// Whether a skin says where its mesh was bound. Else points are given in the spaces of their joints.
    fn is_bound(&self, skin: usize) -> bool {
        self.places.skins.get(skin).is_some_and(|skin| skin.inverse_binds.is_some())
    }

    /// Adds the points and triangles of a part, these turned round where it is said so.
    fn part(&mut self, growing: &mut Growing, mesh: usize, part: &Part, turned: bool) -> Result<(), Fault> {
        let set = &self.sources.sets[part.vertex_set];
        let points = &mut growing.mesh.points;
        let start = *growing.starts.entry(part.vertex_set).or_insert_with(|| {
            let start = points.len() as u32;
            points.extend(set.numbers.iter().map(|&v| set.positions[v as usize]));
            start
        });
        let point = |v: &u32| set.numbers.binary_search(v).map_or(start, |at| start + at as u32);
        let mut corners = self.corners(mesh, part, set)?;
        if turned {
            corners.iter_mut().for_each(|corners| corners.swap(1, 2));
        }
        growing.mesh.triangles.extend(corners.iter().map(|triangle| triangle.each_ref().map(point)));
        growing.corners.push(corners);
        Ok(())
    }

    /// The slot of each triangle. What has no material gets the format's plain one, where others of the mesh have one.
    fn looks(&mut self, growing: &mut Growing, mesh: usize, parts: &[&Part], all: &mut Vec<Look>) {
        let of = |part: &&Part| {
            let look = self.json["meshes"][mesh]["primitives"][part.primitive]["material"].as_u64();
            look.and_then(|look| usize::try_from(look).ok()).filter(|look| *look < self.materials)
        };
        let own: Vec<Option<usize>> = parts.iter().map(of).collect();
        if own.iter().all(Option::is_none) {
            return;
        }
        for (look, corners) in own.into_iter().zip(&growing.corners) {
            let look = look.unwrap_or_else(|| {
                *self.plain.get_or_insert_with(|| {
                    all.push(looks::plain());
                    all.len() - 1
                })
            });
            let slots = &mut growing.mesh.looks;
            let slot = slots.iter().position(|known| *known == look).unwrap_or_else(|| {
                slots.push(look);
                slots.len() - 1
            });
            growing.mesh.slots.extend(std::iter::repeat_n(slot, corners.len()));
        }
    }

    /// The triangles of a part by the file's vertices. Those that name one twice are nothing to be seen; repeated ones may
    /// be the back of a surface.
    fn corners(&self, mesh: usize, part: &Part, set: &SourceSet) -> Result<Vec<[u32; 3]>, Fault> {
        let primitive = &self.places.document.meshes[mesh].primitives[part.primitive];
        let indices = match primitive.indices {
            Some(indices) => self.accessors.indices(indices)?,
            None => (0..set.positions.len() as u32).collect(),
        };
        let mut corners = triangles::from_indices(&indices, primitive.mode.unwrap_or(4));
        corners.retain(|[a, b, c]| a != b && b != c && c != a);
        Ok(corners)
    }

    /// Adds what the corners have: of each layer for all corners, where any part has it.
    fn layers(&mut self, growing: &mut Growing, mesh: usize, parts: &[&Part]) {
        let primitives = &self.places.document.meshes[mesh].primitives;
        let any = |name: &str| parts.iter().any(|part| primitives[part.primitive].attributes.contains_key(name));
        let count = |kind: &str| (0..MAX_SETS).take_while(|n| any(&format!("{kind}_{n}"))).count();
        let (has_normals, coordinates, colours) = (any("NORMAL"), count("TEXCOORD"), count("COLOR"));
        let (coordinates, colours) = (0..coordinates, 0..colours);
        growing.mesh.coordinates = coordinates.clone().map(|_| Layer::new()).collect();
        growing.mesh.colours = colours.clone().map(|_| Layer::new()).collect();
        for (part, corners) in parts.iter().zip(std::mem::take(&mut growing.corners)) {
            let set = &self.sources.sets[part.vertex_set];
            let attributes = &primitives[part.primitive].attributes;
            let count = set.positions.len();
            if has_normals {
                let normals = attributes.get("NORMAL").and_then(|&own| self.directions(own, count));
                match normals {
                    Some(own) => growing.mesh.normals.extend(corners.iter().flatten().map(|&v| unit(own[v as usize]))),
                    // Flat, as the format says.
                    None => growing.mesh.normals.extend(corners.iter().flat_map(|t| [flat(t, &set.positions); 3])),
                }
            }
            for n in coordinates.clone() {
                let accessor = attributes.get(&format!("TEXCOORD_{n}")).copied();
                let values = accessor.and_then(|own| self.coordinates(own, count));
                let source = accessor.zip(values.as_deref());
                let known = &mut growing.of_coordinates;
                growing.mesh.coordinates[n].add(known, (n, part.vertex_set), source, set, &corners, [0.0; 2]);
            }
            for n in colours.clone() {
                let accessor = attributes.get(&format!("COLOR_{n}")).copied();
                let values = accessor.and_then(|own| self.colours(own, count));
                let source = accessor.zip(values.as_deref());
                let known = &mut growing.of_colours;
                growing.mesh.colours[n].add(known, (n, part.vertex_set), source, set, &corners, [1.0; 4]);
            }
        }
    }

    /// Normals or what is added to something, if there are as many as wanted.
    pub(super) fn directions(&mut self, accessor: usize, count: usize) -> Option<Rc<[[f32; 3]]>> {
        let read = || self.accessors.directions(accessor);
        decoded(&mut self.directions, accessor, count, &mut self.unread, read)
    }

    fn coordinates(&mut self, accessor: usize, count: usize) -> Option<Rc<[[f32; 2]]>> {
        let read = || self.accessors.coordinates(accessor);
        decoded(&mut self.coordinates, accessor, count, &mut self.unread, read)
    }

    fn colours(&mut self, accessor: usize, count: usize) -> Option<Rc<[[f32; 4]]>> {
        let read = || self.accessors.colours(accessor);
        decoded(&mut self.colours, accessor, count, &mut self.unread, read)
    }

    /// Clusters for all joints of a skin, those that hold nothing too.
    fn skin(&self, growing: &Growing, skin: usize, parts: &[&Part]) -> Result<Skin, Fault> {
        let (skins, maps) = (self.places.skins, self.places.binds.maps(skin));
        let joints = skins.get(skin).map_or(&[][..], |skin| &skin.joints);
        let inverse = skins.get(skin).and_then(|skin| skin.inverse_binds.as_deref());
        let cluster = |(slot, &node): (usize, &usize)| {
            // What is in the space of its joints stands in the scene once it is put at rest.
            let (to_joint, bind) = match inverse {
                Some(all) => (all[slot], maps[slot] * all[slot].inverse()),
                None => (maps[slot].inverse(), maps[slot]),
            };
            let (points, weights) = Default::default();
            Cluster { node: self.number[node], points, weights, to_joint, bind }
        };
        let mut clusters: Vec<Cluster> = joints.iter().enumerate().map(cluster).collect();
        let mut done = Vec::new();
        for part in parts {
            let set = &self.sources.sets[part.vertex_set];
            if set.skin != Some(skin) || done.contains(&part.vertex_set) {
                continue;
            }
            done.push(part.vertex_set);
            let rows = influences::read(set, skin, self.accessors, skins, &mut Repairs::default())?;
            let start = growing.starts[&part.vertex_set];
            for at in 0..set.numbers.len() {
                let row = rows.row(at);
                let sum: f64 = row.iter().map(|(_, weight)| weight).sum();
                for &(slot, weight) in row {
                    clusters[usize::from(slot)].add(start + at as u32, weight / sum);
                }
            }
        }
        let map = maps.first().copied().filter(|_| inverse.is_some()).unwrap_or(DAffine3::IDENTITY);
        Ok(Skin { clusters, map })
    }
}

impl Mesh {
    /// Takes all from the spaces of its joints to where these hold it at rest; `maps` are those of its clusters. One that each
    /// joint takes elsewhere has no one map of its own, which lists of nodes ask for.
    fn put_at_rest(&mut self, maps: &[DAffine3]) {
        let mut of_points = vec![DAffine3::ZERO; self.points.len()];
        for (cluster, map) in self.skin.iter().flat_map(|skin| &skin.clusters).zip(maps) {
            for (&point, &weight) in cluster.points.iter().zip(&cluster.weights) {
                let sum = &mut of_points[point as usize];
                sum.matrix3 += map.matrix3 * weight;
                sum.translation += map.translation * weight;
            }
        }
        let vector = |v: [f32; 3]| glam::Vec3::from(v).as_dvec3();
        let of_normals: Vec<DMat3> = of_points.iter().map(|map| map.matrix3.inverse().transpose()).collect();
        for (point, map) in self.points.iter_mut().zip(&of_points) {
            *point = map.transform_point3(vector(*point)).as_vec3().into();
        }
        for (normal, &point) in self.normals.iter_mut().zip(self.triangles.as_flattened()) {
            let turned = (of_normals[point as usize] * vector(*normal)).normalize_or(vector(*normal));
            *normal = turned.as_vec3().into();
        }
        for shape in &mut self.shapes {
            for ((&point, offset), normal) in shape.points.iter().zip(&mut shape.offsets).zip(&mut shape.normals) {
                let turned = of_normals[point as usize] * vector(*normal);
                *normal = if turned.is_finite() { turned.as_vec3().into() } else { *normal };
                *offset = (of_points[point as usize].matrix3 * vector(*offset)).as_vec3().into();
            }
        }
    }
}

/// What an accessor holds, if it is as much as wanted; what cannot be used is counted once in `unread`.
fn decoded<const N: usize>(
    known: &mut Decoded<N>,
    accessor: usize,
    count: usize,
    unread: &mut usize,
    read: impl FnOnce() -> Result<Vec<[f32; N]>, Fault>,
) -> Option<Rc<[[f32; N]]>> {
    let all = known.entry(accessor).or_insert_with(|| {
        let all = read().ok().filter(|all| all.len() == count).map(Rc::from);
        *unread += usize::from(all.is_none());
        all
    });
    all.clone().filter(|all| all.len() == count)
}

impl Cluster {
    /// Rows may name a joint twice.
    fn add(&mut self, point: u32, weight: f64) {
        match self.points.last() == Some(&point) {
            true => *self.weights.last_mut().expect("as many as points") += weight,
            false => {
                self.points.push(point);
                self.weights.push(weight);
            }
        }
    }
}

impl<const N: usize> Layer<N> {
    fn new() -> Self {
        Self { values: Vec::new(), indices: Vec::new() }
    }

    /// Adds the corners of a part of layer `layer` and of set `set`; `source` is the accessor of its values, by vertex of the
    /// file. Without one all corners have the value `else_`.
    fn add(
        &mut self,
        known: &mut HashMap<(usize, usize, usize), u32>,
        (layer, set_number): (usize, usize),
        source: Option<(usize, &[[f32; N]])>,
        set: &SourceSet,
        corners: &[[u32; 3]],
        else_: [f32; N],
    ) {
        let Some((accessor, values)) = source else {
            self.indices.extend(std::iter::repeat_n(self.values.len() as u32, 3 * corners.len()));
            self.values.push(else_);
            return;
        };
        let own = &mut self.values;
        let start = *known.entry((set_number, accessor, layer)).or_insert_with(|| {
            let start = own.len() as u32;
            own.extend(set.numbers.iter().map(|&v| values[v as usize].map(finite)));
            start
        });
        let at = |v: &u32| start + set.numbers.binary_search(v).map_or(0, |at| at as u32);
        self.indices.extend(corners.as_flattened().iter().map(at));
    }
}

fn finite(x: f32) -> f32 {
    if x.is_finite() { x } else { 0.0 }
}

/// Of unit length; up where it points nowhere.
fn unit(normal: [f32; 3]) -> [f32; 3] {
    glam::Vec3::from(normal).try_normalize().unwrap_or(glam::Vec3::Y).into()
}

/// The normal of a triangle.
fn flat(triangle: &[u32; 3], positions: &[[f32; 3]]) -> [f32; 3] {
    let [a, b, c] = triangle.map(|v| glam::Vec3::from(positions[v as usize]).as_dvec3());
    unit((b - a).cross(c - a).normalize_or_zero().as_vec3().into())
}
