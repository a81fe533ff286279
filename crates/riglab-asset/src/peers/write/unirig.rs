//! UniRig's `raw_data.npz`: exactly the thirteen members its loader knows, z up.

use std::path::Path;

use riglab_core::{Asset, Mesh, Rig, Vec3};

use super::super::array_rig::Up;
use super::npz::{self, Npz, corners, turned};
use super::target::{Writes, Written};
use super::{WriteError, WriteNote, tails};

/// UniRig's `raw_data.npz`.
pub(super) struct UniRig;

impl Writes for UniRig {
    fn name(&self) -> &'static str {
        "unirig"
    }

    fn suffix(&self) -> &'static str {
        ".npz"
    }

    /// Others are npz, too.
    fn is_told_by(&self, name: &str) -> bool {
        name == "raw_data.npz"
    }

    fn lacks(&self, rig: &Rig) -> Option<String> {
        npz::too_many_weights(rig)
    }

    fn is_at(&self, _: &Path, start: &[u8]) -> bool {
        start.starts_with(b"PK")
    }

    fn is_own(&self, path: &Path, _: &[u8]) -> bool {
        npz::is_own(path)
    }

    fn files(&self, assets: &[Asset], _: &mut Vec<WriteNote>) -> Result<Written, WriteError> {
        Ok(file(&assets[0].rig).into())
    }
}

fn file(rig: &Rig) -> Vec<u8> {
    let (mesh, skeleton) = (rig.mesh(), rig.skeleton());
    let heads = turned(Up::Z, skeleton.heads());
    let ends = turned(Up::Z, &tails::tails(skeleton));
    let rest: Vec<f32> = heads.iter().zip(&ends).flat_map(|(h, t)| tails::rest(*h, *t)).collect();
    let joints = skeleton.len();
    let mut npz = Npz::new(false);
    npz.points("vertices", &turned(Up::Z, mesh.positions()));
    npz.points("vertex_normals", &turned(Up::Z, &mesh.vertex_normals()));
    npz.ints("faces", &[mesh.triangles().len(), 3], corners(rig));
    npz.points("face_normals", &turned(Up::Z, &face_normals(mesh)));
    npz.points("joints", &heads);
    npz.weights("skin", rig);
    npz.objects("parents", &[joints], |out| {
        for parent in skeleton.parents() {
            match parent {
                Some(parent) => out.int(parent.index()),
                None => out.op(b"N"),
            };
        }
    });
    npz.texts("names", &[joints], skeleton.names());
    npz.floats("matrix_local", &[joints, 4, 4], &rest);
    npz.points("tails", &ends);
    for name in ["no_skin", "path", "cls"] {
        npz.objects(name, &[], |out| {
            out.op(b"N");
        });
    }
    npz.end()
}

fn face_normals(mesh: &Mesh) -> Vec<Vec3> {
    let normal = |t| glam::Vec3::from(mesh.area_vector(t)).try_normalize().unwrap_or(glam::Vec3::Y).into();
    (0..mesh.triangles().len()).map(normal).collect()
}
