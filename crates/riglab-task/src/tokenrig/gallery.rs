//! Pictures of what an evaluation saw: true and generated rigs of single assets.

use riglab_core::Rig;
use riglab_render::{Theme, View, contact_sheet, render_parts, render_skeleton};
use riglab_report::Turntable;

use super::TokenRigTask;
use super::evaluate::{Report, Rigged};
use crate::experiment::{Sheet, places, sheet_file};
use crate::unirig_skeleton::ShownAsset;

/// Side of one picture of a sheet, in pixels.
const SIDE: u32 = 280;

impl TokenRigTask {
    /// Sheets of a few assets of each test split: the true rig and the generated one, skeleton and weights as parts.
    pub(super) fn gallery(
        &self,
        report: &Report,
        rigs: &[Rigged],
        each: usize,
    ) -> Result<Vec<(ShownAsset, Sheet)>, String> {
        let mut out: Vec<(ShownAsset, Sheet)> = Vec::new();
        if each == 0 {
            return Ok(out);
        }
        for split in &self.rigger.config.data.test {
            let rows = report.skeletons.assets.iter().zip(rigs);
            let rows = rows.filter(|(a, r)| a.split == *split && a.model.j2j.is_finite() && r.drawn.is_some());
            let mut ranked: Vec<_> = rows.collect();
            ranked.sort_by(|(a, _), (b, _)| a.model.j2j.total_cmp(&b.model.j2j));
            for (why, k) in places(ranked.len(), each) {
                let (row, rigged) = ranked[k];
                let Some((truth, rig)) = self.seen_again(rigged)? else { continue };
                let upright = |rig: &Rig| self.rigger.config.data.up.upright(rig).map_err(|e| e.to_string());
                let (truth, rig) = (upright(&truth)?, upright(&rig)?);
                let view = View::square(SIDE).framed(truth.bounds());
                let cells = [
                    (format!("true, {} joints", row.true_joints), render_skeleton(&truth, &view)),
                    (format!("generated, {}", row.joints), render_skeleton(&rig, &view)),
                    ("true parts".to_owned(), render_parts(&truth, &view)),
                    ("generated parts".to_owned(), render_parts(&rig, &view)),
                ];
                let file = sheet_file(out.len() + 1, split, why);
                let shown = ShownAsset {
                    file,
                    split: split.clone(),
                    name: row.name.clone(),
                    why: why.into(),
                    j2j: row.model.j2j,
                };
                let view = Turntable::of(&[("true", &truth), ("generated", &rig)]);
                out.push((shown, Sheet { png: contact_sheet(&cells, 4, Theme::Light).to_png(), view }));
            }
        }
        Ok(out)
    }
}
