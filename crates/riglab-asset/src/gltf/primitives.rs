//! Primitives: triangles, and which vertices they draw from.
//!
//! Primitives of one node that name the same accessors share a set of vertices, as strips or
//! materials over one surface do; each vertex is then read once. Those whose morph targets move it
//! otherwise do not. What a primitive has compressed (Draco) takes the place of what its accessors claim,
//! before they are asked.

use std::collections::{HashMap, HashSet};
use std::ops::Range;
use std::rc::Rc;

use glam::DVec3;
use serde_json::Value;

use super::accessor::Accessors;
use super::document::{Document, Primitive};
use super::{draco, extensions};
use crate::budget::{PART, RIGID_ROW, TRIANGLE, USED, VERTEX, row};
use crate::maps::SkinBox;
use crate::{Fault, Part, Place, Warning, triangles};

/// Triangles and vertices of one file. Sharing lets a small file ask for any number.
const MAX_TOTAL: usize = 1 << 24;

/// Sets of four influences on a vertex. The most seen is two.
const MAX_SETS: u64 = 32;

/// What the primitives of a file ask for, before vertices are placed.
#[derive(Default)]
pub(super) struct Sources {
    pub(super) sets: Vec<SourceSet>,
    /// By node; their `vertex_set` counts in `sets`.
    pub(super) parts: Vec<Part>,
    /// How many primitives are no surface.
    pub(super) without_surface: usize,
    /// The nodes without a skin that hold such primitives alone.
    pub(super) bare: Vec<usize>,
    /// The nodes with a skin that hold such primitives alone, of which one at least has weights; with the skin.
    pub(super) bound: Vec<(usize, usize)>,
}

/// Vertices that primitives of one node share.
pub(super) struct SourceSet {
    /// The first of the primitives.
    pub(super) place: Place,
    /// What binds the vertices, where the node has a skin and the primitive weights.
    pub(super) skin: Option<usize>,
    attributes: Attributes,
    /// The vertices that are used, rising.
    pub(super) numbers: Vec<u32>,
    /// All vertices, in mesh space.
    pub(super) positions: Rc<[[f32; 3]]>,
}

/// The accessors of a primitive that matter here.
#[derive(Clone, PartialEq, Eq, Hash)]
struct Attributes {
    position: usize,
    /// JOINTS_n and WEIGHTS_n; none for unskinned primitives.
    influences: Vec<(usize, usize)>,
}

/// What a morph target moves: its number, which attribute, and the accessor of what it adds.
type Moved = (usize, &'static str, u64);

/// All that the morph targets of a primitive move, of what is read.
fn moved(primitive: &Primitive) -> Vec<Moved> {
    let targets = primitive.targets.as_array().into_iter().flatten().enumerate();
    let of = |(number, target): (usize, &Value)| {
        ["POSITION", "NORMAL"].map(|name| Some((number, name, target.get(name)?.as_u64()?)))
    };
    targets.flat_map(of).flatten().collect()
}

impl SourceSet {
    /// The accessor of POSITION.
    pub(super) fn position_accessor(&self) -> usize {
        self.attributes.position
    }

    /// The accessors of JOINTS_n and WEIGHTS_n.
    pub(super) fn influences(&self) -> &[(usize, usize)] {
        &self.attributes.influences
    }
}

impl Sources {
    /// The boxes around the vertices each of `skins` skins binds.
    pub(super) fn skin_boxes(&self, skins: usize) -> Vec<SkinBox> {
        let mut boxes: Vec<SkinBox> = vec![None; skins];
        for set in &self.sets {
            let Some(skin) = set.skin else { continue };
            for &v in &set.numbers {
                let p = glam::Vec3::from(set.positions[v as usize]).as_dvec3();
                let (low, high): &mut (DVec3, DVec3) = boxes[skin].get_or_insert((p, p));
                *low = low.min(p);
                *high = high.max(p);
            }
        }
        boxes
    }
}

/// Reads the triangles of all meshes on nodes, in the order of nodes.
pub(super) fn collect(
    document: &Document,
    accessors: &Accessors<'_>,
    warnings: &mut Vec<Warning>,
) -> Result<Sources, Fault> {
    let mut collector = Collector {
        accessors,
        sources: Sources::default(),
        total: 0,
        dropped: (0, 0),
        decoded: HashSet::new(),
        rigid: !document.skins.is_empty(),
    };
    // A mesh as it was read for the first of the nodes that show it, with a skin or without.
    let mut read: HashMap<(usize, bool), Read> = HashMap::new();
    let mut shown: HashMap<(usize, bool), usize> = HashMap::new();
    for node in &document.nodes {
        let Some(mesh) = node.mesh else { continue };
        *shown.entry((mesh, node.skin.is_some())).or_default() += 1;
    }
    for (number, node) in document.nodes.iter().enumerate() {
        let Some(mesh) = node.mesh else { continue };
        let reference = |to, index, count| Fault::Reference { from: format!("node {number}"), to, index, count };
        let primitives =
            &document.meshes.get(mesh).ok_or_else(|| reference("mesh", mesh, document.meshes.len()))?.primitives;
        if let Some(skin) = node.skin.filter(|s| *s >= document.skins.len()) {
            return Err(reference("skin", skin, document.skins.len()));
        }
        let place = Place { node: number, mesh, primitive: 0 };
        let key = (mesh, node.skin.is_some());
        let before = collector.sources.without_surface;
        match read.get(&key) {
            Some(known) => collector.again(place, node.skin, known),
            None => {
                read.insert(key, collector.mesh(place, node.skin, primitives, shown[&key])?);
            }
        }
        let sources = &mut collector.sources;
        if !primitives.is_empty() && sources.without_surface - before == primitives.len() {
            match node.skin {
                None => sources.bare.push(number),
                Some(skin) if primitives.iter().any(|own| own.attributes.contains_key("WEIGHTS_0")) => {
                    sources.bound.push((number, skin));
                }
                Some(_) => {}
            }
        }
    }
    let Collector { sources, dropped: (collapsed, repeated), .. } = collector;
    if collapsed + repeated > 0 {
        warnings.push(Warning::Degenerate { collapsed, repeated });
    }
    Ok(sources)
}

struct Collector<'c, 'a> {
    accessors: &'c Accessors<'a>,
    sources: Sources,
    /// Indices read so far.
    total: usize,
    /// Triangles, collapsed and repeated.
    dropped: (usize, usize),
    /// What is decoded and in place already: by accessor, the view and the number of the attribute, none for triangles.
    decoded: HashSet<(usize, usize, Option<u32>)>,
    /// Whether meshes without a skin may hang on joints.
    rigid: bool,
}

/// What came of a mesh.
struct Read {
    sets: Range<usize>,
    parts: Range<usize>,
    without_surface: usize,
    dropped: (usize, usize),
}

impl Collector<'_, '_> {
    /// Adds the primitives of one mesh on the first of the `nodes` that show it.
    fn mesh(
        &mut self,
        mesh: Place,
        skin: Option<usize>,
        primitives: &[Primitive],
        nodes: usize,
    ) -> Result<Read, Fault> {
        let (without_surface, dropped) = (self.sources.without_surface, self.dropped);
        let first_set = self.sources.sets.len();
        let first_part = self.sources.parts.len();
        let mut known: HashMap<(Attributes, Vec<Moved>), usize> = HashMap::new();
        for (number, primitive) in primitives.iter().enumerate() {
            let place = Place { primitive: number, ..mesh };
            let Some(position) = self.surface(place, primitive)? else {
                self.sources.without_surface += 1;
                continue;
            };
            let one_by_one = self.decode(place, primitive, position)?;
            let influences = match skin {
                Some(_) => influences(place, primitive, self.accessors)?,
                None => Vec::new(),
            };
            let attributes = Attributes { position, influences };
            let key = (attributes, moved(primitive));
            let set = match known.get(&key) {
                Some(&set) => set,
                None => {
                    let set = self.sources.sets.len();
                    let attributes = key.0.clone();
                    known.insert(key, set);
                    let positions = self.accessors.positions(position)?;
                    let skin = skin.filter(|_| !attributes.influences.is_empty());
                    self.sources.sets.push(SourceSet { place, skin, attributes, numbers: Vec::new(), positions });
                    set
                }
            };
            let mode = if one_by_one { 4 } else { primitive.mode.unwrap_or(4) };
            self.primitive(place, primitive, mode, set, nodes)?;
        }
        self.number_vertices(first_set, first_part);
        for set in &self.sources.sets[first_set..] {
            let row = match set.influences().len() as u64 {
                0 if self.rigid => RIGID_ROW,
                0 => 0,
                sets => row(4 * sets),
            };
            self.accessors.budget().show(set.numbers.len() as u64 * (VERTEX + row), nodes)?;
        }
        Ok(Read {
            sets: first_set..self.sources.sets.len(),
            parts: first_part..self.sources.parts.len(),
            without_surface: self.sources.without_surface - without_surface,
            dropped: (self.dropped.0 - dropped.0, self.dropped.1 - dropped.1),
        })
    }

    /// Adds a mesh on one more of its nodes: it asked for them all when it was read.
    fn again(&mut self, mesh: Place, skin: Option<usize>, read: &Read) {
        let Sources { sets, parts, without_surface, .. } = &mut self.sources;
        let shift = sets.len() - read.sets.start;
        for at in read.sets.clone() {
            let SourceSet { place, attributes, numbers, positions, .. } = &sets[at];
            let place = Place { primitive: place.primitive, ..mesh };
            let skin = skin.filter(|_| !attributes.influences.is_empty());
            let (attributes, positions) = (attributes.clone(), Rc::clone(positions));
            let copy = SourceSet { place, skin, attributes, numbers: numbers.clone(), positions };
            sets.push(copy);
        }
        for at in read.parts.clone() {
            let part = &parts[at];
            parts.push(Part { node: mesh.node, vertex_set: part.vertex_set + shift, ..part.clone() });
        }
        *without_surface += read.without_surface;
        self.dropped.0 += read.dropped.0;
        self.dropped.1 += read.dropped.1;
    }

    /// Decodes a compressed primitive. True where its triangles stand one by one, whatever its mode.
    fn decode(&mut self, place: Place, primitive: &Primitive, position: usize) -> Result<bool, Fault> {
        let Some(settings) = primitive.extensions.get(extensions::DRACO) else { return Ok(false) };
        // With a plain copy beside, the compressed one is not needed.
        if self.accessors.has_bytes(position)? {
            return Ok(false);
        }
        let failed = |reason| Fault::Compressed { what: place.to_string(), extension: extensions::DRACO, reason };
        let settings = draco::Settings::read(settings).map_err(failed)?;
        let Some(indices) = primitive.indices else { return Err(failed("the primitive has no indices".into())) };
        let view = settings.buffer_view;
        let attributes = settings.attributes.iter();
        let named = attributes.filter_map(|(name, &number)| Some((name, number, *primitive.attributes.get(name)?)));
        // The same mesh on a second node, or the same geometry in another mesh.
        let known = named.clone().all(|(_, number, own)| self.decoded.contains(&(own, view, Some(number))));
        if known && self.decoded.contains(&(indices, view, None)) {
            return Ok(true);
        }
        let bytes = self.accessors.view(view, || place.to_string())?.bytes;
        // Each has three numbers of four bytes.
        let mesh = draco::Decoded::new(bytes, self.accessors.budget().left(12)).map_err(failed)?;
        let mut put = true;
        if self.decoded.insert((indices, view, None)) {
            put &= self.accessors.put_indices(indices, mesh.corners())?;
        }
        for (name, number, accessor) in named {
            self.accessors.check(accessor, || place.to_string())?;
            if !self.decoded.insert((accessor, view, Some(number))) {
                continue;
            }
            let normalized = self.accessors.normalized(accessor)?;
            put &= if name == "POSITION" {
                let values = mesh.attribute(number, normalized).map_err(failed)?;
                self.accessors.put_positions(accessor, values)?
            } else if name.starts_with("WEIGHTS_") {
                let values = mesh.attribute(number, normalized).map_err(failed)?;
                self.accessors.put_weights(accessor, values)?
            } else if name.starts_with("JOINTS_") {
                let values = mesh.attribute::<4>(number, false).map_err(failed)?;
                self.accessors.put_joints(accessor, values.iter().map(|v| v.map(|x| x as u32)).collect())?
            } else {
                true
            };
        }
        if !put {
            return Err(failed("another primitive's geometry is for the same accessors".into()));
        }
        Ok(true)
    }

    /// The accessor of the positions, where the primitive is a surface.
    fn surface(&self, place: Place, primitive: &Primitive) -> Result<Option<usize>, Fault> {
        let mode = primitive.mode.unwrap_or(4);
        if mode > 6 {
            return Err(Fault::Mode { place, mode });
        }
        let position = primitive.attributes.get("POSITION").copied().filter(|_| mode >= 4);
        for accessor in position.iter().chain(&primitive.indices) {
            self.accessors.check(*accessor, || place.to_string())?;
        }
        Ok(position)
    }

    /// Adds one primitive: its triangles count in `used`, which still has the numbers of the file.
    fn primitive(
        &mut self,
        place: Place,
        primitive: &Primitive,
        mode: u32,
        set: usize,
        nodes: usize,
    ) -> Result<(), Fault> {
        let count = self.sources.sets[set].positions.len();
        let corners = match primitive.indices {
            Some(indices) => self.accessors.index_count(indices)?,
            None => count,
        };
        let budget = self.accessors.budget();
        let triangles = if mode == 4 { corners / 3 } else { corners };
        budget.piece(corners, size_of::<u32>())?;
        budget.show(PART + triangles as u64 * TRIANGLE, nodes)?;
        self.total = self.total.saturating_add(corners.saturating_mul(nodes));
        if self.total > MAX_TOTAL * 3 {
            let (count, limit) = (self.total as u64, MAX_TOTAL as u64 * 3);
            return Err(Fault::TooLarge { what: "the triangle corners of all meshes".into(), count, limit });
        }
        let indices = match primitive.indices {
            Some(indices) => self.accessors.indices(indices)?,
            None => (0..count as u32).collect(),
        };
        let mut triangles = triangles::from_indices(&indices, mode);
        if let Some(&vertex) = triangles.as_flattened().iter().find(|v| **v as usize >= count) {
            return Err(Fault::VertexIndex { place, vertex, count });
        }
        let stored = triangles.len();
        let used = triangles::renumber(&mut triangles, count);
        budget.show(used.len() as u64 * USED, nodes)?;
        let dropped = triangles::keep_proper(&mut triangles, used.len());
        triangles.shrink_to_fit();
        // Strips turn corners by collapsed triangles, so there they are no fault.
        self.dropped.0 += if mode == 4 { dropped.collapsed } else { 0 };
        self.dropped.1 += dropped.repeated;
        let Place { node, primitive, .. } = place;
        self.sources.parts.push(Part { node, primitive, vertex_set: set, used, triangles, stored });
        Ok(())
    }

    /// Numbers the vertices of a mesh's sets from 0, leaving out those that no part uses.
    fn number_vertices(&mut self, first_set: usize, first_part: usize) {
        let Sources { sets, parts, .. } = &mut self.sources;
        let mut parts_of: Vec<Vec<&mut Part>> = sets[first_set..].iter().map(|_| Vec::new()).collect();
        for part in &mut parts[first_part..] {
            parts_of[part.vertex_set - first_set].push(part);
        }
        for (set, mut own) in sets[first_set..].iter_mut().zip(parts_of) {
            if let [part] = &mut own[..] {
                // Its triangles count so already.
                let own = (0..part.used.len() as u32).collect();
                set.numbers = std::mem::replace(&mut part.used, own);
                continue;
            }
            let mut number = vec![0u32; set.positions.len()];
            own.iter().flat_map(|p| &p.used).for_each(|v| number[*v as usize] = 1);
            set.numbers = (0u32..).zip(&number).filter(|(_, used)| **used > 0).map(|(v, _)| v).collect();
            (0u32..).zip(&set.numbers).for_each(|(new, old)| number[*old as usize] = new);
            for part in own {
                part.used.iter_mut().for_each(|v| *v = number[*v as usize]);
                part.triangles.as_flattened_mut().iter_mut().for_each(|v| *v = part.used[*v as usize]);
            }
        }
    }
}

/// JOINTS_n and WEIGHTS_n from 0 as far as they go.
fn influences(place: Place, primitive: &Primitive, accessors: &Accessors<'_>) -> Result<Vec<(usize, usize)>, Fault> {
    let mut influences = Vec::new();
    for set in 0.. {
        let names = [format!("JOINTS_{set}"), format!("WEIGHTS_{set}")];
        match names.each_ref().map(|name| primitive.attributes.get(name).copied()) {
            [Some(joints), Some(weights)] => {
                accessors.check(joints.max(weights), || place.to_string())?;
                influences.push((joints, weights));
            }
            [None, None] => break,
            [found, _] => {
                let [joints, weights] = names;
                let missing = if found.is_some() { weights } else { joints };
                return Err(Fault::AttributeMissing { place, missing });
            }
        }
    }
    let (count, limit) = (influences.len() as u64, MAX_SETS);
    if count > limit {
        return Err(Fault::TooLarge { what: format!("{place}: JOINTS and WEIGHTS"), count, limit });
    }
    Ok(influences)
}
