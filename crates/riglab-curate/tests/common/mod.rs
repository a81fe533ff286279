//! What tests of whole curations share.
#![allow(dead_code)] // each test takes its part

use std::path::{Path, PathBuf};

use riglab_core::{Asset, Joint, Mesh, Rig, Skeleton, SkinWeights};
use riglab_curate::{CurateConfig, CurateError, Funnel, Places, Shard, curate};
use riglab_synth::{Options, creature};

/// A folder of shared data, if it is there.
pub fn folder(variable: &str, usual: &str) -> Option<PathBuf> {
    let named = std::env::var_os(variable).map(PathBuf::from);
    let path = named.unwrap_or_else(|| Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(usual));
    if path.is_dir() {
        return Some(path);
    }
    eprintln!("skipped: no such folder {}", path.display());
    None
}

/// The first creatures of a seed, small ones.
pub fn creatures(n: u64) -> Vec<Asset> {
    (0..n).map(|k| creature(11, k, &Options { triangles: 300..=500, ..Options::default() })).collect()
}

/// Writes assets as GLB files under their names.
pub fn write(folder: &Path, assets: &[Asset]) {
    for asset in assets {
        std::fs::write(folder.join(format!("{}.glb", asset.name)), riglab_asset::to_glb(asset)).unwrap();
    }
}

/// A copy turned, scaled, moved, its vertices in another order, under another name.
pub fn copy(asset: &Asset, name: &str) -> Asset {
    let turn = glam::Quat::from_euler(glam::EulerRot::ZYX, 0.7, -1.9, 0.4);
    let place = |p: [f32; 3]| (turn * glam::Vec3::from(p) * 12.5 + glam::Vec3::new(3.0, -7.0, 40.0)).to_array();
    let rig = &asset.rig;
    let n = rig.mesh().positions().len();
    let back = |v: usize| n - 1 - v;
    let positions = (0..n).map(|v| place(rig.mesh().positions()[back(v)])).collect();
    let triangles = rig.mesh().triangles().iter().rev().map(|t| [t[2], t[0], t[1]].map(|v| back(v as usize) as u32));
    let s = rig.skeleton();
    let joints = s.ids().map(|j| Joint { name: s.name(j).into(), parent: s.parent(j), head: place(s.head(j)) });
    let rows = (0..n).map(|v| rig.weights().row(back(v)).map(|(j, w)| (j.0, f64::from(w))).collect::<Vec<_>>());
    let rig = Rig::new(
        Skeleton::new(joints.collect()).unwrap(),
        Mesh::new(positions, triangles.collect()).unwrap(),
        SkinWeights::normalized(rows).unwrap(),
    );
    Asset { name: name.into(), rig: rig.unwrap(), clips: vec![], provenance: asset.provenance.clone() }
}

/// Its mirror image.
pub fn mirrored(asset: &Asset) -> Asset {
    let flip = |p: &[f32; 3]| [-p[0], p[1], p[2]];
    let rig = &asset.rig;
    let skeleton = rig.skeleton().with_heads(rig.skeleton().heads().iter().map(flip).collect()).unwrap();
    let triangles = rig.mesh().triangles().iter().map(|t| [t[0], t[2], t[1]]).collect();
    let mesh = Mesh::new(rig.mesh().positions().iter().map(flip).collect(), triangles).unwrap();
    Asset { rig: Rig::new(skeleton, mesh, rig.weights().clone()).unwrap(), ..asset.clone() }
}

/// Curates a folder into `out/corpus.h5`.
pub fn run(folder: &Path, out: &Path, config: &CurateConfig) -> Result<Funnel, CurateError> {
    run_shard(folder, &out.join("corpus.h5"), None, config)
}

/// Curates a part of a folder.
pub fn run_shard(
    folder: &Path,
    out: &Path,
    shard: Option<Shard>,
    config: &CurateConfig,
) -> Result<Funnel, CurateError> {
    curate(folder, &Places::of(out), shard, config, &|_, _, _| ())
}

/// Without pictures.
pub fn plain() -> CurateConfig {
    let mut config = CurateConfig::default();
    config.report.kept = 0;
    config.report.dropped = 0;
    config
}

/// The names that a stage dropped.
pub fn dropped<'a>(funnel: &'a Funnel, stage: &str) -> Vec<&'a str> {
    funnel.stage(stage).map_or(vec![], |s| s.dropped.iter().map(|(name, _)| name.as_str()).collect())
}
