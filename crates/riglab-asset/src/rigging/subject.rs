//! A model as input of rigging.

use std::borrow::Cow;
use std::collections::HashSet;
use std::path::{Path, PathBuf};

use riglab_core::{JointId, Mesh, Rig, RigError, Skeleton, SkinWeights, Springs, Vec3};

use super::looks::{Motions, Row, Unrigged};
use super::pieces::pieces;
use super::stand::stand;
use super::{SubjectNote, UpAxis, doubts, seams};
use crate::assemble::ordered_sets;
use crate::export::{self, ExportError, ExportOptions, Exported};
use crate::nearest::nearest_others;
use crate::{
    Binding, Fault, Format, ImportError, ImportOptions, Imported, Reading, Warning, gltf, import, import_from,
};

/// How a model is read.
#[derive(Clone, Debug)]
pub struct SubjectOptions {
    /// Whether a rig that is there stays. Then the mesh is what that rig binds, and [`Subject::rig`] gives the
    /// rig. Else all surfaces of the file are the mesh, standing where the rest pose shows them, but for
    /// colliders by name, which stay as they are; a rig that cannot be read is no hindrance then.
    pub keep_rig: bool,
    /// The axis that points up.
    pub up: UpAxis,
    /// Whether a model of a format whose models face -z is turned round in the mesh, so that what expects a model to
    /// face +z tells its left from its right. Not where a rig is kept.
    pub to_front: bool,
    /// The most triangles.
    pub max_triangles: usize,
    /// How the file is read; motions are not.
    pub import: ImportOptions,
}

impl Default for SubjectOptions {
    fn default() -> Self {
        let import = ImportOptions::default();
        Self { keep_rig: false, up: UpAxis::Y, to_front: false, max_triangles: 5_000_000, import }
    }
}

/// A model to be rigged: a mesh in riglab's axes (y up, as glTF), and all it takes to write the file again with a
/// rig for that mesh.
///
/// Units are those of the file. Blend shapes are applied as the file shows them. Vertices that no triangle uses are left out, and so are triangles that name
/// a vertex twice; triangles without area stay.
#[derive(Clone, Debug)]
pub struct Subject {
    file: PathBuf,
    name: String,
    mesh: Mesh,
    rig: Option<Rig>,
    bound: Option<Bound>,
    /// The joints of that rig that stand beside its root in the file, where the document is none of the file's.
    loose: Vec<JointId>,
    twins: Vec<u32>,
    notes: Vec<SubjectNote>,
    source: Source,
    turn: Turn,
    /// What a file that is no glTF has of motions: those of the rig that is kept.
    motions: Option<Motions>,
    /// How many animations such a file has.
    animations: usize,
}

/// From the document's axes to the mesh's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Turn {
    /// What points up in the document.
    up: UpAxis,
    /// Whether the model, once it stands, is turned round.
    about: bool,
}

impl From<UpAxis> for Turn {
    fn from(up: UpAxis) -> Self {
        Self { up, about: false }
    }
}

impl Turn {
    const NONE: Self = Self { up: UpAxis::Y, about: false };

    /// A point or direction, as the mesh has it. No number is rounded, and left and right stay what they are.
    pub(super) fn onto_mesh(self, p: Vec3) -> Vec3 {
        self.round(self.up.to_y(p))
    }

    /// The turn back.
    fn off_mesh(self, p: Vec3) -> Vec3 {
        self.up.from_y(self.round(p))
    }

    fn round(self, [x, y, z]: Vec3) -> Vec3 {
        if self.about { [-x, y, -z] } else { [x, y, z] }
    }
}

/// What the rig that is kept says of the vertices of the mesh.
#[derive(Clone, Debug)]
struct Bound {
    /// Their weights; `None` where the rig numbers them as the mesh does.
    weights: Option<SkinWeights>,
    /// Which of them are of parts that hang on one joint without a skin.
    rigid: Vec<bool>,
}

impl Bound {
    /// Of a rig that was read with the mesh.
    fn alike(reading: &Reading) -> Self {
        let sets = ordered_sets(reading).into_iter().map(|(_, set)| set);
        let rigid = sets.flat_map(|set| std::iter::repeat_n(set.binding == Binding::Rigid, set.positions.len()));
        Self { weights: None, rigid: rigid.collect() }
    }

    /// Of a rig whose rows those of vertices are; the others go with the nearest that has one.
    fn by_rows(rows: &[Option<Row>], weights: &SkinWeights, mesh: &Mesh) -> Option<Self> {
        let lacking: Vec<u32> = (0u32..).zip(rows).filter(|(_, row)| row.is_none()).map(|(v, _)| v).collect();
        let mut numbers: Vec<Option<usize>> = rows.iter().map(|row| row.map(|row| row.number)).collect();
        for (&v, nearest) in lacking.iter().zip(nearest_others(mesh.positions(), &lacking)) {
            numbers[v as usize] = nearest.and_then(|n| numbers[n as usize]);
        }
        let (mut offsets, mut joints, mut shares) = (vec![0u32], Vec::new(), Vec::new());
        for number in numbers {
            for (joint, share) in weights.row(number?) {
                joints.push(joint.0);
                shares.push(share);
            }
            offsets.push(joints.len() as u32);
        }
        let rigid = rows.iter().map(|row| row.is_some_and(|row| row.rigid)).collect();
        Some(Self { weights: Some(SkinWeights::new(offsets, joints, shares).ok()?), rigid })
    }
}

/// What is written again.
#[derive(Clone, Debug)]
struct Source {
    /// A document, and the folder of what lies beside it; `None` for formats of arrays, which have no looks.
    document: Option<(Vec<u8>, Option<PathBuf>)>,
    /// What the importer reads of that.
    imported: Imported,
}

/// Where a vertex of a subject comes from: numbers in the document that [`Subject::attach`] starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Origin {
    /// The node that holds the mesh.
    pub node: usize,
    /// The first primitive of that mesh that uses the vertex.
    pub primitive: usize,
    /// Its number in the accessor of positions.
    pub vertex: u32,
}

impl Subject {
    /// Reads the model at `path`: anything riglab imports, rigged or not.
    ///
    /// glTF and VRM keep their document; OBJ (with its materials), FBX, PLY and STL become one. Formats of arrays have a
    /// mesh and nothing else.
    ///
    /// ```no_run
    /// use riglab_asset::rigging::Subject;
    ///
    /// let subject = Subject::read("statue.obj", &Default::default())?;
    /// for note in subject.notes() {
    ///     eprintln!("statue.obj: {note}");
    /// }
    /// println!("{} vertices", subject.mesh().positions().len());
    /// # Ok::<(), riglab_asset::ImportError>(())
    /// ```
    ///
    /// # Errors
    /// What is wrong with the file, with its path before it; [`Fault::NoMesh`] without triangles,
    /// [`Fault::Triangles`] for more of them than asked for.
    pub fn read(path: impl AsRef<Path>, options: &SubjectOptions) -> Result<Self, ImportError> {
        let path = path.as_ref();
        let fail = |fault| ImportError::new(&path.to_string_lossy(), fault);
        let format = format(path).map_err(fail)?;
        if !format.reads().has_models() {
            return Self::of_arrays(path, options);
        }
        let bytes = std::fs::read(path).map_err(|e| fail(Fault::unreadable(&e)))?;
        Self::from_bytes(path, &bytes, Some(export::folder(path)), options)
    }

    /// As [`Self::read`], with the bytes of a glTF, FBX, OBJ, PLY or STL file; `folder` is where what belongs to it is looked
    /// for, if at all.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn from_bytes(
        path: impl AsRef<Path>,
        bytes: &[u8],
        folder: Option<&Path>,
        options: &SubjectOptions,
    ) -> Result<Self, ImportError> {
        let path = path.as_ref();
        let fail = |fault| ImportError::new(&path.to_string_lossy(), fault);
        let mut notes = Vec::new();
        let mut keeps = options.import.clone();
        keeps.clips = None;
        let mut turn = Turn::from(options.up);
        let (mut rig, mut rows) = (None, None);
        let (mut loose, mut motions, mut animations) = (Vec::new(), None, 0);
        let format = Format::of(path, bytes).map_err(fail)?;
        let (document, beside) = if format != Format::GLTF {
            let file = Unrigged { path, name: stem(path), bytes, folder, options };
            let looks = format.reads().looks(&file, &mut notes).map_err(fail)?;
            (rig, loose, motions, animations) = (looks.rig, looks.loose, looks.motions, looks.animations);
            rows = looks.rows;
            let mut model = looks.model;
            let parts = model.drop_unplaced_pictures();
            if parts > 0 {
                notes.push(SubjectNote::Unplaced { parts });
            }
            stand(&mut model, options.up);
            turn = Turn::NONE;
            let document = model.into_glb();
            let too_long = |found: usize| too_large("bytes of the file as GLB", found, u32::MAX as usize);
            (Cow::Owned(document.map_err(|found| fail(too_long(found)))?), None)
        } else if options.keep_rig {
            (Cow::Borrowed(bytes), folder)
        } else {
            // A rig that goes need not be one that can be read.
            let (reading, bare) = match gltf::read(bytes, folder, &keeps) {
                Ok((reading, _)) => (reading, None),
                Err(of) => {
                    let bare = gltf::export::strip_broken(bytes, folder, &keeps, of);
                    let (reading, bare) = bare.map_err(|e| fail(fault(e)))?;
                    (reading, Some(bare))
                }
            };
            if reading.faces_back && options.to_front {
                turn.about = true;
                notes.push(SubjectNote::FacesBack);
            }
            if let Some(bare) = bare {
                notes.extend(bare.notes.into_iter().map(SubjectNote::Stripped));
                (Cow::Owned(bare.bytes), None)
            } else if reading.joints.is_empty() {
                (Cow::Borrowed(bytes), folder)
            } else {
                notes.push(SubjectNote::RigIgnored { joints: reading.joints.len() });
                // The model stands as it was bound then, not as the file shows it.
                let moved = reading.warnings.iter().filter(|w| {
                    matches!(w, Warning::RestIsNotBind { .. } | Warning::Bent { .. } | Warning::Reshaped { .. })
                });
                notes.extend(moved.cloned().map(SubjectNote::Read));
                let bare = gltf::export::strip(bytes, folder, &reading).map_err(|e| fail(fault(e)))?;
                notes.extend(bare.notes.into_iter().map(SubjectNote::Stripped));
                (Cow::Owned(bare.bytes), None)
            }
        };
        // All of the model that is seen, whoever it was that the old rig moved.
        if !options.keep_rig {
            keeps.character = None;
            keeps.shown = true;
        }
        let imported = import_from(path, &document, beside, &keeps)?;
        let mut bound = None;
        if let (true, Some(own)) = (options.keep_rig, imported.rig()) {
            rig = Some(own.clone());
            bound = Some(Bound::alike(&imported.reading));
        } else if let (Some(own), Some(rows)) = (&rig, rows) {
            bound = Bound::by_rows(&rows(&imported.reading), own.weights(), imported.mesh());
        }
        // Looked at as the file shows it; the rig is for what is stored.
        let mut looks = None;
        if !imported.reading.shaped.is_empty() {
            let shown = import_from(path, &document, beside, &ImportOptions { shaped: true, ..keeps });
            let whole = |shown: &Imported| {
                shown.reading.shaped.is_empty() && shown.mesh().triangles() == imported.mesh().triangles()
            };
            looks = shown.ok().filter(whole).map(|shown| shown.mesh().clone());
        }
        let source = Source { document: Some((document.into_owned(), beside.map(Path::to_path_buf))), imported };
        Ok(Self { bound, loose, motions, animations, ..Self::new(path, source, rig, (turn, looks), notes, options)? })
    }

    /// A model of a format that has no looks.
    fn of_arrays(path: &Path, options: &SubjectOptions) -> Result<Self, ImportError> {
        let imported = import(path, &ImportOptions { clips: None, ..options.import.clone() })?;
        let mut notes = Vec::new();
        let mut rig = imported.rig().cloned();
        if let (Some(own), false) = (&rig, options.keep_rig) {
            notes.push(SubjectNote::RigIgnored { joints: own.skeleton().len() });
            rig = None;
        }
        let bound = rig.as_ref().map(|_| Bound::alike(&imported.reading));
        let source = Source { document: None, imported };
        Ok(Self { bound, ..Self::new(path, source, rig, (options.up.into(), None), notes, options)? })
    }

    fn new(
        path: &Path,
        source: Source,
        rig: Option<Rig>,
        (turn, looks): (Turn, Option<Mesh>),
        mut notes: Vec<SubjectNote>,
        options: &SubjectOptions,
    ) -> Result<Self, ImportError> {
        let fail = |fault| ImportError::new(&path.to_string_lossy(), fault);
        let own = source.imported.mesh();
        let count = own.triangles().len();
        if count > options.max_triangles {
            return Err(fail(Fault::Triangles { found: count, limit: options.max_triangles }));
        }
        let warnings = source.imported.warnings().iter();
        notes.extend(warnings.filter(|w| !matches!(w, Warning::NoSkeleton)).cloned().map(SubjectNote::Read));
        let reading = &source.imported.reading;
        let holders: HashSet<usize> = reading.parts.iter().map(|part| part.node).collect();
        let mut shaped = reading.shaped.clone();
        shaped.retain(|shown| holders.contains(&shown.node));
        // One mesh on several nodes is told once.
        let mut told = HashSet::new();
        shaped.retain(|shown| told.insert((shown.mesh.clone(), shown.weighted, shown.shapes)));
        if !shaped.is_empty() && looks.is_none() {
            notes.push(SubjectNote::Shaped(shaped));
        }
        let mesh = turned_mesh(looks.as_ref().unwrap_or(own), turn).map_err(|e| fail(e.into()))?;
        let rig = match rig {
            Some(rig) => Some(turned_rig(&rig, turn, Turn::onto_mesh).map_err(|e| fail(e.into()))?),
            None => None,
        };
        let twins = seams::twins(mesh.positions());
        // Which object each vertex is of. What the mesh was put together from is numbered in this order.
        let sets = ordered_sets(reading).into_iter().zip(0u32..);
        let sets: Vec<u32> = sets.flat_map(|((_, set), n)| std::iter::repeat_n(n, set.positions.len())).collect();
        let welded = seams::welded(&mesh, &sets);
        let pieces = pieces(&mesh, &twins);
        doubts::doubts(&mesh, &pieces, options.up, turn.about, &mut notes);
        if notes.contains(&SubjectNote::Flat { triangles: mesh.triangles().len() }) {
            return Err(fail(Fault::NoArea));
        }
        let mesh = doubts::facing_out(mesh, &pieces, &mut notes);
        let name = stem(path);
        Ok(Self {
            file: path.to_path_buf(),
            name,
            mesh,
            rig,
            bound: None,
            loose: Vec::new(),
            twins: welded,
            notes,
            source,
            turn,
            motions: None,
            animations: 0,
        })
    }

    /// The file's name without folder and ending.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// What is to be rigged: y up, closed surfaces facing outwards, and, where that was asked for, its front to +z as far as
    /// the format tells.
    pub fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// The rig that the file has, where it is kept. Its skeleton is in the space of [`Self::mesh`]; its mesh may
    /// be numbered otherwise, where the file is no glTF.
    pub fn old_rig(&self) -> Option<&Rig> {
        self.rig.as_ref()
    }

    /// The weights of that rig, by vertex of [`Self::mesh`]. What it does not hold goes with the nearest vertex that it does.
    pub fn old_weights(&self) -> Option<&SkinWeights> {
        let bound = self.bound.as_ref()?;
        bound.weights.as_ref().or(self.rig.as_ref().map(Rig::weights))
    }

    /// How far the file shows the model from where the rig that is kept holds it, in the axes of [`Self::mesh`]; see
    /// [`crate::Reading::shown_off`]. A model that is read without its rig stands where the file shows it.
    pub fn shown_off(&self) -> Vec3 {
        self.turn.onto_mesh(self.source.imported.reading.shown_off)
    }

    /// What a person may want to know before and after.
    pub fn notes(&self) -> &[SubjectNote] {
        &self.notes
    }

    /// For each vertex the first one in the same place, by [`super::twins`], or as near as makes no difference: what rounding
    /// put apart, or the borders of two objects that are one surface.
    pub fn twins(&self) -> &[u32] {
        &self.twins
    }

    /// How many animations the file has that its document does not: those of formats which become one.
    pub fn animations_left(&self) -> usize {
        self.animations
    }

    /// The weights with those of vertices in one place made one, so that no seam opens.
    pub fn agreed(&self, weights: &SkinWeights) -> SkinWeights {
        seams::agreed(weights, &self.twins)
    }

    /// The weights with those of rigid parts as the rig has them that is kept: a weapon or a hat that hangs on a joint
    /// without a skin stays there, and the file's own skeleton and motions with it.
    pub fn with_rigid_parts(&self, weights: SkinWeights) -> SkinWeights {
        let (Some(old), Some(Bound { rigid, .. })) = (self.old_weights(), &self.bound) else { return weights };
        let count = weights.rows();
        if old.rows() != count || rigid.len() != count || !rigid.contains(&true) {
            return weights;
        }
        let (mut offsets, mut joints, mut shares) = (vec![0u32], Vec::new(), Vec::new());
        for (v, &rigid) in rigid.iter().enumerate() {
            let own = if rigid { old } else { &weights };
            for (joint, share) in own.row(v) {
                joints.push(joint.0);
                shares.push(share);
            }
            offsets.push(joints.len() as u32);
        }
        SkinWeights::new(offsets, joints, shares).unwrap_or(weights)
    }

    /// Where each vertex comes from, by vertex of [`Self::mesh`]. Empty for formats of arrays.
    pub fn origins(&self) -> Vec<Origin> {
        if self.source.document.is_none() {
            return Vec::new();
        }
        let reading = &self.source.imported.reading;
        let mut all = Vec::with_capacity(self.mesh.positions().len());
        for (number, set) in ordered_sets(reading) {
            let parts: Vec<_> = reading.parts.iter().filter(|part| part.vertex_set == number).collect();
            for (at, &vertex) in (0u32..).zip(&set.numbers) {
                let uses = |part: &&&crate::Part| part.used.binary_search(&at).is_ok();
                let part = parts.iter().find(uses).or(parts.first());
                let (node, primitive) = part.map_or((0, 0), |part| (part.node, part.primitive));
                all.push(Origin { node, primitive, vertex });
            }
        }
        all
    }

    /// The document that a rig is attached to, where the format has looks: the file itself, or the GLB that it was
    /// made into.
    pub fn document(&self) -> Option<&[u8]> {
        self.source.document.as_ref().map(|(bytes, _)| bytes.as_slice())
    }

    /// A skeleton and weights for this mesh as a rig.
    ///
    /// # Errors
    /// As [`Rig::new`].
    pub fn rigged(&self, skeleton: Skeleton, weights: SkinWeights) -> Result<Rig, RigError> {
        Rig::new(skeleton, self.mesh.clone(), weights)
    }

    /// The model as a GLB with `rig`, which has the mesh of this subject.
    ///
    /// Meshes, materials, pictures, morph targets, placement and names of nodes, extras and motions of what is no
    /// joint stay as they are, and so do the file's axes. An armature (`Armature`, with a node a joint) and one
    /// skin are added, JOINTS_0 and WEIGHTS_0 on every primitive; points and lines go with the nearest vertex. With
    /// the skeleton that a kept rig has (by names, tree and heads) the file's own nodes and skins stay and only weights
    /// are written, as far as each mesh has a skin that has the joints which it needs or can take them in, and no vertex is seen
    /// to move; the motions of an FBX come along with it, and
    /// joints that are roots in it stand beside each other in the armature, whatever tree the rig makes of them. The
    /// same subject, rig and options give the same bytes.
    ///
    /// glTF ignores the transform of a node whose mesh is skinned: a mesh that its nodes do not leave where it
    /// is stored has its vertices moved to where they were shown. All stands where the file shows it: a kept rig that is
    /// held elsewhere is shifted by [`Self::shown_off`].
    ///
    /// # Errors
    /// [`crate::ExportFault::OtherMesh`] for a rig of another mesh; what [`export::onto`] says.
    pub fn attach(&self, rig: &Rig, options: &ExportOptions) -> Result<Exported, ExportError> {
        let Source { document, imported } = &self.source;
        let fail = |fault| ExportError { file: self.file.to_string_lossy().into_owned(), fault };
        if rig.mesh() != &self.mesh {
            let (found, wanted) = (rig.mesh().positions().len(), self.mesh.positions().len());
            return Err(fail(crate::ExportFault::OtherMesh { found, wanted }));
        }
        let invalid = |e: RigError| fail(crate::ExportFault::Source(e.into()));
        // The mesh as the document has it, and heads in its axes.
        let back = Rig::new(
            turned_skeleton(rig.skeleton(), self.turn, Turn::off_mesh).map_err(invalid)?,
            imported.mesh().clone(),
            rig.weights().clone(),
        );
        let back = back.and_then(|r| r.with_humanoid(rig.humanoid().clone())).map_err(invalid)?;
        let springs = if self.turn == Turn::NONE { rig.springs().clone() } else { Springs::default() };
        let back = back.with_springs(springs).map_err(invalid)?;
        match document {
            Some((bytes, folder)) => {
                // What is not of the rig stays where it was, so the rig is to be where the file shows it.
                let off = imported.reading.shown_off;
                let is_kept = self.rig.as_ref().is_some_and(|old| old.skeleton() == rig.skeleton());
                let loose = if is_kept { &self.loose[..] } else { &[] };
                let exported = gltf::export::onto(bytes, folder.as_deref(), imported, &back, off, loose, options);
                let exported = exported.map_err(fail)?;
                match &self.motions {
                    Some(Motions { skeleton, clips }) if skeleton == back.skeleton() => {
                        gltf::export::with_motions(exported, skeleton, clips).map_err(fail)
                    }
                    _ => Ok(exported),
                }
            }
            None => gltf::export::alone(&self.name, &back, &imported.provenance, options).map_err(fail),
        }
    }
}

/// The format of the file at `path`.
fn format(path: &Path) -> Result<Format, Fault> {
    use std::io::Read;
    crate::no_pipe(path)?;
    let mut start = Vec::new();
    let read = std::fs::File::open(path).and_then(|f| f.take(4096).read_to_end(&mut start));
    read.map_err(|e| Fault::unreadable(&e))?;
    Format::of(path, &start)
}

fn stem(path: &Path) -> String {
    path.file_stem().unwrap_or_default().to_string_lossy().into_owned()
}

fn too_large(what: &str, count: usize, limit: usize) -> Fault {
    Fault::TooLarge { what: what.into(), count: count as u64, limit: limit as u64 }
}

/// What may fail where a rig is taken out, as a fault of the file.
fn fault(of: crate::ExportFault) -> Fault {
    match of {
        crate::ExportFault::Source(fault) => fault,
        crate::ExportFault::TooLong(found) => too_large("bytes of the file as GLB", found, u32::MAX as usize),
        other => Fault::Unreadable(other.to_string()),
    }
}

fn turned_mesh(mesh: &Mesh, by: Turn) -> Result<Mesh, RigError> {
    mesh.with_positions(mesh.positions().iter().map(|p| by.onto_mesh(*p)).collect())
}

fn turned_skeleton(skeleton: &Skeleton, by: Turn, turn: fn(Turn, Vec3) -> Vec3) -> Result<Skeleton, RigError> {
    skeleton.with_heads(skeleton.heads().iter().map(|p| turn(by, *p)).collect())
}

/// A rig of a file with some axis up, as its document has it.
pub(crate) fn stood(rig: &Rig, up: UpAxis) -> Result<Rig, RigError> {
    turned_rig(rig, up.into(), Turn::onto_mesh)
}

/// A rig in other axes. Springs, whose directions are told in more ways than one, go along only where nothing turns;
/// the document keeps its own.
fn turned_rig(rig: &Rig, by: Turn, turn: fn(Turn, Vec3) -> Vec3) -> Result<Rig, RigError> {
    if by == Turn::NONE {
        return Ok(rig.clone());
    }
    let mesh = rig.mesh().with_positions(rig.mesh().positions().iter().map(|p| turn(by, *p)).collect())?;
    let skeleton = turned_skeleton(rig.skeleton(), by, turn)?;
    Rig::new(skeleton, mesh, rig.weights().clone())?.with_humanoid(rig.humanoid().clone())
}
