//! Pictures of what an evaluation saw: true and predicted weights of single assets.

use riglab_core::{Segment, SkinWeights, Vec3};
use riglab_nn::params::Weights;
use riglab_render::{
    Palette, Picture, Theme, View, contact_sheet, joint_weights, misplaced_weight, render_errors, render_parts,
    render_skeleton, render_weights,
};
use riglab_report::Turntable;
use serde::{Deserialize, Serialize};

use super::FsqCvaeTask;
use super::evaluate::{Encoded, Report, Truth, ruled};
use super::prepare::{Bone, Prepared};
use crate::assets::AssetId;
use crate::experiment::{Sheet, places, sheet_file};

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
    /// Why it is shown: `best`, `median` or `worst` of its split by IoU after the decode rule.
    pub why: String,
    /// That IoU.
    pub iou: f64,
    /// The bone in the second row: the one whose weights are off by most.
    pub bone: String,
}

impl FsqCvaeTask {
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
            let mut ranked: Vec<(AssetId, f64)> = ids.into_iter().zip(rows.map(|a| a.iou)).collect();
            ranked.retain(|(_, iou)| iou.is_finite());
            ranked.sort_by(|a, b| b.1.total_cmp(&a.1));
            for (why, k) in places(ranked.len(), each) {
                let (id, iou) = ranked[k];
                let encoded = self.encode(w, id)?;
                let (bone, picture, view) = self.sheet(w, &encoded, (report.cut, self.ranked()))?;
                let name = encoded.rig.name.clone();
                let file = sheet_file(out.len() + 1, split, why);
                let shown = ShownAsset { file, split: split.clone(), name, why: why.into(), iou, bone };
                out.push((shown, Sheet { png: picture.to_png(), view }));
            }
        }
        Ok(out)
    }

    /// Of how many codes assets are ranked and shown: of the most that are evaluated.
    pub(super) fn ranked(&self) -> usize {
        self.config.eval.prefixes.iter().copied().max().unwrap_or(self.config.model.skin_tokens)
    }

    /// The sheet of one asset, of `most` codes: above, skeleton, true parts, predicted parts and misplaced weight;
    /// below, the worst bone, true, from the fewest codes, from the most, and its error. With that bone's name, and both
    /// rigs to turn.
    pub(super) fn sheet(
        &self,
        w: &Weights,
        encoded: &Encoded,
        (cut, most): (f32, usize),
    ) -> Result<(String, Picture, Option<Turntable>), String> {
        let (rig, joints) = (&encoded.rig, encoded.rig.bones.len());
        let truth = Truth::new(rig, None);
        let few = self.config.eval.prefixes.iter().copied().min().unwrap_or(most);
        let weights = |k: usize| {
            let raw = self.decode(w, encoded, &self.codes(w, encoded, k), &truth.points)?;
            let dense = ruled(&raw, joints, cut);
            sparse(rig, &dense).map(|sparse| (dense, sparse))
        };
        let ((dense, predicted), (_, rough)) = (weights(most)?, weights(few)?);
        let worst = worst_bone(&truth.dense, &dense, joints);
        let joint = rig.bones[worst].joint;
        let name = rig.rig.skeleton().name(joint).to_string();

        let drawn = self.config.data.up.upright(&rig.rig).map_err(|e| e.to_string())?;
        let (mesh, view) = (drawn.mesh(), View::square(SIDE).framed(drawn.bounds()));
        let shown = drawn.with_weights(predicted.clone()).map_err(|e| e.to_string())?;
        let of = |weights: &SkinWeights| joint_weights(weights, joint);
        let (t, p) = (of(rig.rig.weights()), of(&predicted));
        let errors: Vec<f32> = t.iter().zip(&p).map(|(a, b)| (a - b).abs()).collect();
        let misplaced = misplaced_weight(rig.rig.weights(), &predicted);
        let column = |values: &[f32]| render_weights(mesh, values, &view, Palette::Dusk);
        let cells = [
            ("skeleton".to_string(), render_skeleton(&drawn, &view)),
            ("true parts".into(), render_parts(&drawn, &view)),
            (format!("predicted, {}", codes(most)), render_parts(&shown, &view)),
            ("misplaced weight".into(), render_errors(mesh, &misplaced, ERROR_SHOWN, &view)),
            (format!("true: {name}"), column(&t)),
            (codes(few), column(&of(&rough))),
            (codes(most), column(&p)),
            ("error".into(), render_errors(mesh, &errors, ERROR_SHOWN, &view)),
        ];
        let view = Turntable::of(&[("true", &drawn), ("predicted", &shown)]);
        Ok((name, contact_sheet(&cells, 4, Theme::Light), view))
    }
}

fn codes(n: usize) -> String {
    format!("{n} code{}", if n == 1 { "" } else { "s" })
}

/// The bone whose weights are off by most, summed over vertices; the first of equals.
pub(crate) fn worst_bone(truth: &[f32], predicted: &[f32], joints: usize) -> usize {
    let mut errors = vec![0.0f64; joints];
    for (t, p) in truth.chunks_exact(joints).zip(predicted.chunks_exact(joints)) {
        for (error, (t, p)) in errors.iter_mut().zip(t.iter().zip(p)) {
            *error += f64::from((t - p).abs());
        }
    }
    (0..joints).max_by(|&a, &b| errors[a].total_cmp(&errors[b]).then(b.cmp(&a))).unwrap_or(0)
}

/// Refuses what a network says whose own weights are no numbers any more.
pub(crate) fn finite(dense: &[f32]) -> Result<(), String> {
    match dense.iter().all(|x| x.is_finite()) {
        true => Ok(()),
        false => Err("the network gives no finite weights: its training diverged; lower train.optim.muon_lr and \
                      train.optim.adamw_lr, and train anew"
            .into()),
    }
}

/// Dense shares of all vertices, a column a bone, as weights of the rig's joints. A vertex without any is given to the bone
/// that it is nearest to, as where rigs are made.
pub(crate) fn sparse(rig: &Prepared, dense: &[f32]) -> Result<SkinWeights, String> {
    finite(dense)?;
    let nearest = |p: Vec3| {
        let far = |bone: &Bone| Segment::nearest_of(&bone.segments, p).1;
        rig.bones.iter().min_by(|a, b| far(a).total_cmp(&far(b))).map(|bone| (bone.joint.0, 1.0))
    };
    let rows = dense.chunks_exact(rig.bones.len()).zip(rig.rig.mesh().positions()).map(|(row, &p)| {
        let held = row.iter().zip(&rig.bones).filter(|(w, _)| **w > 0.0);
        let mut own: Vec<(u16, f64)> = held.map(|(&w, bone)| (bone.joint.0, f64::from(w))).collect();
        if own.is_empty() {
            own.extend(nearest(p));
        }
        own
    });
    SkinWeights::normalized(rows).map_err(|e| {
        format!(
            "{}: what the network gives are no weights ({e}): its training diverged, or has hardly begun; lower \
             train.optim.muon_lr and train.optim.adamw_lr, or train longer",
            rig.name
        )
    })
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Rig, Skeleton};

    use super::*;

    #[test]
    fn a_vertex_that_no_bone_claims_is_given_to_the_nearest() {
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: k.checked_sub(1).map(JointId),
            head: [f32::from(k), 0.0, 0.0],
        };
        // The last joint holds nothing: it is no bone, but ends one.
        let corners = vec![[0.0, 0.1, 0.0], [1.5, 0.1, 0.0], [0.9, 0.2, 0.0]];
        let weights = SkinWeights::normalized([0, 1, 1].map(|j| [(j, 1.0)])).unwrap();
        let skeleton = Skeleton::new((0..3).map(joint).collect()).unwrap();
        let rig = Rig::new(skeleton, Mesh::new(corners, vec![[0, 1, 2]]).unwrap(), weights).unwrap();
        let prepared = Prepared::of("a".into(), rig, false);
        let found = sparse(&prepared, &[0.25, 0.75, 0.0, 0.0, 1.0, 0.0]).unwrap();
        let row = |v| found.row(v).map(|(j, w)| (j.0, w)).collect::<Vec<_>>();
        assert_eq!([row(0), row(1), row(2)], [vec![(0, 0.25), (1, 0.75)], vec![(1, 1.0)], vec![(0, 1.0)]]);
    }

    #[test]
    fn the_worst_bone_is_found() {
        // Two vertices, three bones: what the third should hold, the first half holds.
        let (truth, predicted) = ([0.5, 0.5, 0.0, 0.0, 0.2, 0.8], [0.5, 0.5, 0.0, 0.3, 0.2, 0.5]);
        assert_eq!(worst_bone(&truth, &predicted, 3), 0);
        assert_eq!(worst_bone(&truth, &[0.5, 0.5, 0.0, 0.2, 0.4, 0.4], 3), 2);
    }

    #[test]
    fn a_network_that_gives_no_numbers_is_told_as_such() {
        assert!(finite(&[0.0, -1.0, 1e30]).is_ok());
        for wrong in [f32::NAN, f32::INFINITY] {
            assert!(finite(&[0.5, wrong]).unwrap_err().contains("train.optim"));
        }
    }
}
