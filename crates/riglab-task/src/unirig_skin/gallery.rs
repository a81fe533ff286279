//! Pictures of what an evaluation saw: true and predicted weights of single assets.

use riglab_nn::params::Weights;
use riglab_render::{
    Palette, Picture, Theme, View, contact_sheet, joint_weights, misplaced_weight, render_errors, render_parts,
    render_skeleton, render_weights,
};
use riglab_report::Turntable;
use serde::{Deserialize, Serialize};

use super::SkinTask;
use super::evaluate::Report;
use crate::assets::AssetId;
use crate::experiment::{Sheet, places, sheet_file};
use crate::fsq_cvae::gallery::{sparse, worst_bone};
use crate::fsq_cvae::ruled;

/// Side of one picture of a sheet, in pixels.
const SIDE: u32 = 280;
/// Misplaced weight at the end of the colour scale.
const ERROR_SHOWN: f32 = 0.5;

/// One asset's sheet.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShownAsset {
    /// The PNG file, in the folder of the evaluation's pictures.
    pub file: String,
    /// The split.
    pub split: String,
    /// The asset.
    pub name: String,
    /// Why it is shown: `best`, `median` or `worst` of its split by L1 after the decode rule.
    pub why: String,
    /// That L1.
    pub l1: f64,
    /// The bone in the second row: the one whose weights are off by most.
    pub bone: String,
}

impl SkinTask {
    /// Sheets of a few assets of each test split: `best` and `worst` of each, one in the middle.
    ///
    /// # Errors
    /// When an asset cannot be read.
    pub(super) fn gallery(
        &self,
        w: &Weights,
        report: &Report,
        each: usize,
    ) -> Result<Vec<(ShownAsset, Sheet)>, String> {
        let mut out: Vec<(ShownAsset, Sheet)> = Vec::new();
        for split in &self.config.data.test {
            let ids = self.assets.split(split).map_err(|e| e.to_string())?;
            let rows = report.assets.iter().filter(|a| a.split == *split);
            let mut ranked: Vec<(AssetId, f64)> = ids.into_iter().zip(rows.map(|a| a.l1)).collect();
            ranked.sort_by(|a, b| a.1.total_cmp(&b.1));
            for (why, k) in places(ranked.len(), each) {
                let (id, l1) = ranked[k];
                let (name, bone, picture, view) = self.sheet(w, id, report.cut)?;
                let file = sheet_file(out.len() + 1, split, why);
                let shown = ShownAsset { file, split: split.clone(), name, why: why.into(), l1, bone };
                out.push((shown, Sheet { png: picture.to_png(), view }));
            }
        }
        Ok(out)
    }

    /// The sheet of one asset: above, skeleton, true parts, predicted parts and misplaced weight; below, the bone that
    /// is off by most, true, predicted, and its error.
    fn sheet(
        &self,
        w: &Weights,
        id: AssetId,
        cut: f32,
    ) -> Result<(String, String, Picture, Option<Turntable>), String> {
        let subject = self.subject(id, None)?;
        let (rig, joints) = (&subject.ready.rig, subject.ready.seats.len());
        let dense = ruled(&self.spread(w, &subject, &self.predicted(w, &subject)?), joints, cut);
        let predicted = sparse(rig, &dense)?;
        let joint = rig.bones[worst_bone(&subject.truth, &dense, joints)].joint;
        let bone = rig.rig.skeleton().name(joint).to_string();

        let drawn = self.config.data.up.upright(&rig.rig).map_err(|e| e.to_string())?;
        let (mesh, view) = (drawn.mesh(), View::square(SIDE).framed(drawn.bounds()));
        let shown = drawn.with_weights(predicted.clone()).map_err(|e| e.to_string())?;
        let (t, p) = (joint_weights(rig.rig.weights(), joint), joint_weights(&predicted, joint));
        let errors: Vec<f32> = t.iter().zip(&p).map(|(a, b)| (a - b).abs()).collect();
        let column = |values: &[f32]| render_weights(mesh, values, &view, Palette::Dusk);
        let misplaced = misplaced_weight(rig.rig.weights(), &predicted);
        let cells = [
            ("skeleton".to_string(), render_skeleton(&drawn, &view)),
            ("true parts".into(), render_parts(&drawn, &view)),
            ("predicted".into(), render_parts(&shown, &view)),
            ("misplaced weight".into(), render_errors(mesh, &misplaced, ERROR_SHOWN, &view)),
            (format!("true: {bone}"), column(&t)),
            ("predicted".into(), column(&p)),
            ("error".into(), render_errors(mesh, &errors, ERROR_SHOWN, &view)),
        ];
        let turned = Turntable::of(&[("true", &drawn), ("predicted", &shown)]);
        Ok((rig.name.clone(), bone, contact_sheet(&cells, 4, Theme::Light), turned))
    }
}
