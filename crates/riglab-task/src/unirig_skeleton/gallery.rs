//! Pictures of what an evaluation saw: true and generated skeletons of single assets.

use riglab_core::{Mesh, Rig, RigError, Skeleton, SkinWeights};
use riglab_geom::voxel::SolidConfig;
use riglab_metric::{Baseline, SkinBaseline};
use riglab_render::{Theme, View, contact_sheet, render_skeleton};
use riglab_report::Turntable;
use serde::{Deserialize, Serialize};

use super::SkeletonTask;
use super::batch::normalized;
use super::evaluate::Report;
use super::generate::SkeletonSample;
use crate::assets::AssetId;
use crate::experiment::{Sheet, places, sheet_file};

/// Side of one picture of a sheet, in pixels.
const SIDE: u32 = 280;

/// One asset's sheet.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShownAsset {
    /// The PNG file, in the folder of the evaluation's pictures.
    pub file: String,
    /// The split.
    pub split: String,
    /// The asset.
    pub name: String,
    /// Why it is shown: `best`, `median` or `worst` of its split by J2J.
    pub why: String,
    /// That J2J.
    pub j2j: f64,
}

impl SkeletonTask {
    /// Sheets of a few assets of each test split: the true skeleton and the generated one, from two sides.
    pub(super) fn gallery(
        &self,
        report: &Report,
        skeletons: &[(AssetId, SkeletonSample)],
        each: usize,
    ) -> Result<Vec<(ShownAsset, Sheet)>, String> {
        let mut out: Vec<(ShownAsset, Sheet)> = Vec::new();
        if each == 0 {
            return Ok(out);
        }
        for split in &self.config.data.test {
            let rows =
                report.assets.iter().zip(skeletons).filter(|(a, _)| a.split == *split && a.model.j2j.is_finite());
            let mut ranked: Vec<_> = rows.collect();
            ranked.sort_by(|(a, _), (b, _)| a.model.j2j.total_cmp(&b.model.j2j));
            for (why, k) in places(ranked.len(), each) {
                let (row, (id, drawn)) = ranked[k];
                let Ok(decoded) = &drawn.decoded else { continue };
                let skeleton = decoded.skeleton().map_err(|e| e.to_string())?;
                let (up, rig) = (self.config.data.up, normalized(&self.assets, &self.cache, *id)?);
                let upright = || Ok((up.upright(&rig)?, up.upright_skeleton(&skeleton)?));
                let (rig, skeleton) = upright().map_err(|e: RigError| e.to_string())?;
                let view = View::square(SIDE).framed(rig.bounds());
                let side = view.clone().turned(90.0, 0.0);
                let over = |view: &View, skeleton| {
                    riglab_render::Scene::of(rig.mesh())
                        .skeleton(skeleton, riglab_render::BoneColors::default())
                        .draw(view)
                };
                let cells = [
                    (format!("true, {} joints", row.true_joints), render_skeleton(&rig, &view)),
                    (format!("generated, {}", row.joints), over(&view, &skeleton)),
                    ("true, from the side".to_owned(), over(&side, rig.skeleton())),
                    ("generated".to_owned(), over(&side, &skeleton)),
                ];
                let file = sheet_file(out.len() + 1, split, why);
                let shown = ShownAsset {
                    file,
                    split: split.clone(),
                    name: row.name.clone(),
                    why: why.into(),
                    j2j: row.model.j2j,
                };
                let view = bound(&skeleton, rig.mesh())
                    .and_then(|own| Turntable::of(&[("true", &rig), ("generated, nearest bone", &own)]));
                out.push((shown, Sheet { png: contact_sheet(&cells, 4, Theme::Light).to_png(), view }));
            }
        }
        Ok(out)
    }
}

/// A mesh bound to a generated skeleton, which has no weights of its own: each vertex to the bone nearest to it.
pub(crate) fn bound(skeleton: &Skeleton, mesh: &Mesh) -> Option<Rig> {
    let rows = (0..mesh.positions().len()).map(|_| [(0u16, 1.0)]);
    let root = Rig::new(skeleton.clone(), mesh.clone(), SkinWeights::normalized(rows).ok()?).ok()?;
    let weights = SkinBaseline::Straight(Baseline::Nearest).weights(&root, &SolidConfig::DEFAULT);
    root.with_weights(weights).ok()
}
