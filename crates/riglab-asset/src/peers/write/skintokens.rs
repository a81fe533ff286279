//! SkinTokens' npz: what its public loader takes, z up.

use std::path::Path;

use riglab_core::{Asset, Rig};

use super::super::array_rig::Up;
use super::npz::{self, Npz, corners, turned};
use super::target::{Writes, Written};
use super::{WriteError, WriteNote, tails};

/// SkinTokens' npz.
pub(super) struct SkinTokens;

impl Writes for SkinTokens {
    fn name(&self) -> &'static str {
        "skintokens"
    }

    fn suffix(&self) -> &'static str {
        ".npz"
    }

    /// Others are npz, too.
    fn is_told_by(&self, _: &str) -> bool {
        false
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
        Ok(file(&assets[0]).into())
    }
}

fn file(asset: &Asset) -> Vec<u8> {
    let rig = &asset.rig;
    let (mesh, skeleton) = (rig.mesh(), rig.skeleton());
    let joints = skeleton.len();
    let heads = turned(Up::Z, skeleton.heads());
    let ends = turned(Up::Z, &tails::tails(skeleton));
    let lengths: Vec<f32> = heads.iter().zip(&ends).map(|(h, t)| glam::Vec3::from(*h).distance((*t).into())).collect();
    let rest: Vec<f32> = heads.iter().zip(&ends).flat_map(|(h, t)| tails::rest(*h, *t)).collect();
    let mut npz = Npz::new(true);
    npz.points("vertices", &turned(Up::Z, mesh.positions()));
    npz.ints("faces", &[mesh.triangles().len(), 3], corners(rig));
    npz.texts("mesh_names", &[1], std::slice::from_ref(&asset.name));
    npz.texts("joint_names", &[joints], skeleton.names());
    npz.ints("parents", &[joints], skeleton.parents().iter().map(|p| p.map_or(-1, |p| p.0.into())));
    npz.floats("lengths", &[joints], &lengths);
    npz.floats("matrix_world", &[4, 4], &glam::Mat4::IDENTITY.to_cols_array());
    npz.floats("matrix_local", &[joints, 4, 4], &rest);
    npz.texts("armature_name", &[], &["Armature".to_owned()]);
    npz.weights("skin", rig);
    npz.end()
}
