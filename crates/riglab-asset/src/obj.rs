//! Wavefront OBJ: plain meshes, as input of inference. Polygons become triangles; materials, normals
//! and texture coordinates are not looked at, and nothing beside the file is opened.
//!
//! Vertices come in the order in which the faces of each object first name them. RigNet's pairs of
//! OBJ and `rig.txt`, whose weights count vertices of the file, need a reader of their own.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use riglab_core::{Rig, Vec3};
use tobj::{LoadError, LoadOptions};

use crate::assemble::ordered_sets;
use crate::format::Reads;
use crate::influences::Repairs;
use crate::peers::{Assets, Input, Source, beside_obj, one, open_pair};
use crate::rigging::{Looks, Row, RowsOf, SubjectNote, Unrigged, obj_model, stood};
use crate::wavefront::{self, Asked};
use crate::{
    Binding, Fault, Format, ImportError, ImportOptions, Part, PeerFault, Reading, Rights, VertexSet, Warning, triangles,
};

/// Wavefront OBJ: the mesh of the rig text beside it, or a mesh alone. In a folder such a pair counts once, as its text.
pub(crate) struct Obj;

impl Reads for Obj {
    fn name(&self) -> &'static str {
        "OBJ"
    }

    fn endings(&self) -> &'static [&'static str] {
        &["obj"]
    }

    fn beside(&self, path: &Path, folder: &Path) -> Vec<PathBuf> {
        beside_obj(path, folder).into_iter().collect()
    }

    fn in_arrays(&self, path: &Path, folder: Option<&Path>) -> bool {
        folder.is_some_and(|folder| beside_obj(path, folder).is_some())
    }

    fn open<'a>(&self, file: &Source<'a>, _: bool) -> Result<Box<dyn Assets + 'a>, Fault> {
        open_pair(file)
    }

    fn read(&self, bytes: &[u8], _: Option<&Path>, _: &ImportOptions) -> Result<(Reading, Rights), Fault> {
        Ok((read(bytes)?, Rights::default()))
    }

    fn looks(&self, file: &Unrigged<'_>, notes: &mut Vec<SubjectNote>) -> Result<Looks, Fault> {
        let model = obj_model(&file.name, file.bytes, file.folder, notes)?;
        match rig_beside(file)? {
            Some(rig) => Ok(Looks { rows: Some(rows(&rig)), rig: Some(rig), ..model.into() }),
            None => Ok(model.into()),
        }
    }
}

/// The rig of the text beside an OBJ, where it is kept.
fn rig_beside(file: &Unrigged<'_>) -> Result<Option<Rig>, Fault> {
    let options = file.options;
    if !(options.keep_rig && Obj.in_arrays(file.path, file.folder)) {
        return Ok(None);
    }
    let (path, folder) = (file.path, file.folder);
    let source = Source { path, format: Format::of(path, file.bytes)?, input: Input::Bytes(file.bytes), folder };
    match one(&source, &ImportOptions { clips: None, ..options.import.clone() }) {
        Ok(pair) => Ok(pair.rig().map(|rig| stood(rig, options.up)).transpose()?),
        // Joints alone are none.
        Err(ImportError { fault: Fault::Peer(PeerFault::NoWeights), .. }) => Ok(None),
        Err(e) => Err(e.fault),
    }
}

/// Rows of vertices by their places: the model has them in an order of its own.
fn rows(rig: &Rig) -> RowsOf {
    let mut at: HashMap<[u32; 3], usize> = HashMap::new();
    for (number, place) in rig.mesh().positions().iter().enumerate() {
        at.entry(bits(place)).or_insert(number);
    }
    Box::new(move |document| {
        let places = ordered_sets(document).into_iter().flat_map(|(_, set)| &set.positions);
        places.map(|place| Some(Row { number: *at.get(&bits(place))?, rigid: false })).collect()
    })
}

/// -0 and 0 are one value.
fn bits(place: &Vec3) -> [u32; 3] {
    place.map(|x| (x + 0.0).to_bits())
}

fn read(bytes: &[u8]) -> Result<Reading, Fault> {
    let options = LoadOptions { triangulate: true, ignore_points: true, ignore_lines: true, ..Default::default() };
    // What a material library holds does not matter.
    let lines = wavefront::obj(bytes, Asked::Surface);
    let (models, _) = tobj::load_obj_buf(&mut &lines[..], &options, |_| Err(LoadError::OpenFileFailed))
        .map_err(|e| wavefront::explain(bytes, &e.to_string()))?;
    let mut reading = Reading::default();
    let (mut collapsed, mut repeated) = (0, 0);
    for (node, model) in models.into_iter().enumerate() {
        let positions: Vec<[f32; 3]> = model.mesh.positions.as_chunks().0.to_vec();
        if positions.as_flattened().iter().any(|x| !x.is_finite()) {
            let reason = format!("object `{}` has a coordinate that is not finite", model.name);
            return Err(wavefront::explain(bytes, &reason));
        }
        let count = positions.len() as u32;
        if let Some(v) = model.mesh.indices.iter().find(|v| **v >= count) {
            return Err(wavefront::explain(bytes, &format!("object `{}` names vertex {v} of {count}", model.name)));
        }
        let mut triangles = triangles::from_indices(&model.mesh.indices, 4);
        if triangles.is_empty() {
            continue;
        }
        let stored = triangles.len();
        let mut used = model.mesh.indices;
        used.sort_unstable();
        used.dedup();
        let dropped = triangles::keep_proper(&mut triangles, positions.len());
        collapsed += dropped.collapsed;
        repeated += dropped.repeated;
        reading.parts.push(Part { node, primitive: 0, vertex_set: reading.vertex_sets.len(), used, triangles, stored });
        reading.vertex_sets.push(VertexSet {
            numbers: (0..count).collect(),
            repairs: Repairs::default(),
            stored: positions.len(),
            positions,
            weights: None,
            unweighted: Vec::new(),
            binding: Binding::Free,
        });
    }
    if collapsed + repeated > 0 {
        reading.warnings.push(Warning::Degenerate { collapsed, repeated });
    }
    Ok(reading)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn polygons_become_triangles_and_relative_numbers_count_back() {
        let text = "mtllib none.mtl\no a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf -4//1 -2 -1\nl 1 2\n";
        let reading = read(text.as_bytes()).unwrap();
        assert_eq!(reading.parts.len(), 1);
        assert_eq!(reading.vertex_sets[0].positions.len(), 4);
        assert_eq!(reading.parts[0].stored, 3);
        assert!(read(b"v 0 0 0\n").unwrap().parts.is_empty());
    }

    #[test]
    fn triangles_that_are_left_out_are_told() {
        let text = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 3 1 2\nf 1 1 2\n";
        let reading = read(text).unwrap();
        assert_eq!(reading.parts[0].triangles.len(), 1);
        assert_eq!(reading.warnings, [Warning::Degenerate { collapsed: 1, repeated: 1 }]);
    }

    #[test]
    fn texture_coordinates_and_comments_are_of_no_matter() {
        let text = b"# \xe9t\xe9\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5\n  vn 1\nf 1 2 3\nf -1/-1/-1 -2/7/7 -3/9/9\n";
        let reading = read(text).unwrap();
        assert_eq!((reading.parts[0].stored, reading.parts[0].triangles.len()), (2, 1));
    }

    #[test]
    fn curves_are_no_surface_and_materials_no_reason_to_refuse_one() {
        let text = b"v 0 0 0 1 0 0\nv 1 0 0\nv 0 1 0 0 0 1 1\nusemtl\nusemtl\tx\nl 1 2 3\nf 1 2 3\no caf\xe9\n";
        let reading = read(text).unwrap();
        assert_eq!((reading.parts.len(), reading.parts[0].stored), (1, 1));
    }

    #[test]
    fn broken_lines_are_errors() {
        for text in
            ["v 0 0\n", "v 0 0 nan\nv 0 0 0\nv 1 0 0\nf 1 2 3\n", "v 0 0 0\nf 1 2 3\n", "f 0 0 0\n", "v a b c\n"]
        {
            assert!(matches!(read(text.as_bytes()), Err(Fault::Obj(_))), "{text}");
        }
    }
}
