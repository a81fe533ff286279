//! What drawn rigs are worth.

use std::collections::HashMap;

use riglab_core::Segment;
use riglab_random::stream;
use riglab_reward::{Candidate, RawWeights, Rewards};

use super::batch::Subject;
use crate::fsq_cvae::Frozen;
use crate::tokenrig::{RigSample, Skinner};

/// How codes become the weights that are judged.
#[derive(Clone, Copy)]
pub struct JudgeSettings {
    /// Codes are asked for weights at so many vertices at most.
    pub vertices: usize,
    /// Raw shares below it are dropped, as they are from a rig.
    pub cut: f32,
    /// Whether the auto-encoder computes in bfloat16.
    pub half: bool,
    /// Seeds the points that the mesh's shape is read by.
    pub seed: u64,
}

/// The rewards of rigs drawn for a mesh, in their order; 0 for one that says no rig. Rigs of the same tokens are judged
/// once. Weights are taken raw, as the auto-encoder gives them: what no joint claims is what one of the rewards is about.
/// Without an auto-encoder skeletons alone are judged.
///
/// # Errors
/// When the mesh makes no rig.
pub fn rewards(
    vae: Option<&Frozen>,
    subject: &Subject,
    drawn: &[RigSample],
    how: &JudgeSettings,
) -> Result<Vec<Rewards>, String> {
    let (candidates, place) = candidates(vae, subject, drawn, how)?;
    let scores = subject.scorer.score_group(&candidates);
    Ok(place.into_iter().map(|at| scores[at]).collect())
}

/// What [`rewards`] judges: the different rigs among those drawn, with their weights, and which of them each is.
///
/// # Errors
/// When the mesh makes no rig.
pub fn candidates(
    vae: Option<&Frozen>,
    subject: &Subject,
    drawn: &[RigSample],
    how: &JudgeSettings,
) -> Result<(Vec<Option<Candidate>>, Vec<usize>), String> {
    let skinner = vae.map(|vae| {
        let mut random = stream(how.seed, "skin rewards", &[subject.key]);
        let skinner = Skinner::new(vae, &subject.mesh, how.vertices, &mut random)?;
        Ok::<_, String>(if how.half { skinner.half() } else { skinner })
    });
    let skinner = skinner.transpose()?;
    let (mut first, mut place): (HashMap<&[i64], usize>, Vec<usize>) = Default::default();
    let mut different = Vec::new();
    for own in drawn {
        let at = *first.entry(&own.ids).or_insert(different.len());
        if at == different.len() {
            different.push(own);
        }
        place.push(at);
    }
    let candidates = match &skinner {
        Some(skinner) => skinner.each(&different, |own, drawn| candidate(Some(own), subject, drawn, how.cut)),
        None => different.iter().map(|drawn| candidate(None, subject, drawn, how.cut)).collect(),
    };
    Ok((candidates, place))
}

/// A drawn rig with its raw weights; `None` where there is no rig.
fn candidate(skinner: Option<&Skinner>, subject: &Subject, drawn: &RigSample, cut: f32) -> Option<Candidate> {
    let decoded = drawn.decoded.as_ref().ok()?;
    let skeleton = decoded.skeleton().ok()?;
    let heads = skeleton.heads().iter().map(|p| p.map(f64::from)).collect();
    let Some(skinner) = skinner else { return Candidate::skeleton(heads, decoded.parents.clone()).ok() };
    if drawn.codes.len() != skeleton.len() {
        return None;
    }
    let all = skeleton.segments();
    let claimed: Vec<u16> = (0..all.len() as u16).filter(|&j| drawn.codes[usize::from(j)].is_some()).collect();
    let segments: Vec<Vec<Segment>> = claimed.iter().map(|&j| all[usize::from(j)].clone()).collect();
    let codes: Vec<&[i64]> = drawn.codes.iter().flatten().map(Vec::as_slice).collect();
    let raw = skinner.raw(&segments, &codes, skinner.prior(&segments).as_ref());
    let row = |row: &[f32]| -> Vec<(u16, f64)> {
        row.iter().zip(&claimed).filter(|(w, _)| **w >= cut).map(|(w, &j)| (j, f64::from(*w))).collect()
    };
    let weights = if raw.is_empty() {
        RawWeights::new(vec![Vec::new(); subject.mesh.positions().len()])
    } else {
        RawWeights::new(raw.chunks_exact(claimed.len()).map(row))
    };
    Candidate::new(heads, decoded.parents.clone(), weights).ok()
}
