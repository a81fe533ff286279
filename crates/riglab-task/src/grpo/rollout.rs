//! Rigs drawn by the policy, with what they are worth and how likely they were.

use std::collections::BTreeMap;

use riglab_nn::grpo::advantages;
use riglab_nn::params::Weights;
use riglab_nn::tokenrig::GEOMETRY;
use riglab_random::stream;
use riglab_reward::Rewards;
use riglab_train::Precision;
use tch::{Kind, Tensor};

use super::GrpoTask;
use super::batch::{Batch, Subject};
use super::config::Dead;
use super::judges;
use super::score::{JudgeSettings, rewards};
use crate::tokenrig::RigSample;
use crate::unirig_skeleton::Batch as Shapes;

/// A drawn rig.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sequence {
    /// Its mesh among those of the rollout.
    pub mesh: usize,
    /// Its tokens, the prompt with them.
    pub ids: Vec<i64>,
    /// What they are told, one after another: see [`riglab_nn::tokenrig::Sequences::told`].
    pub told: Vec<f32>,
    /// What it is worth beside the others of its mesh.
    pub advantage: f64,
    /// Whether the loss looks at it.
    pub counts: bool,
    /// The sum of log-probabilities of what was drawn, as the sampler has it; not kept.
    pub said: f64,
    /// Log-probabilities of its free tokens to the policy that drew it; none before that was asked.
    pub old: Vec<f32>,
    /// The same to the policy that it is held to.
    pub reference: Vec<f32>,
}

/// All that is drawn at once.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rollout {
    /// Clouds and picks of the meshes.
    pub shapes: Shapes,
    /// The rigs.
    pub sequences: Vec<Sequence>,
    /// What is logged of it, in the order of [`noted`].
    pub notes: Vec<f64>,
}

/// What is logged of a rollout: means over its rigs, but for `spread`, the mean deviation within groups, `dead`, the
/// share of groups without any, and `sampler_gap`, how far the log-probability of a token differs between the sampler
/// and the trainer.
pub fn noted() -> impl Iterator<Item = &'static str> {
    let parts = Rewards::PARTS.iter().map(|part| part.name);
    let others = ["valid", "spread", "dead", "distinct", "length", "joints", GAP];
    std::iter::once("reward").chain(parts).chain(others)
}

/// What is known once the trainer has looked.
pub(super) const GAP: &str = "sampler_gap";

/// How often a dead group is drawn anew.
const TRIES: u64 = 3;

impl GrpoTask {
    /// Draws a group of rigs for each mesh and judges them; one mesh's rigs are judged while those of the next are
    /// drawn. `w`: the policy as the trainer computes with it.
    pub(super) fn roll(&self, w: &Weights, batch: &Batch, number: u64) -> Result<Rollout, String> {
        let _no_grad = tch::no_grad_guard();
        let (c, policy) = (&self.config, &*self.policy);
        // The sampler takes the master weights: it computes in single precision.
        let prefix = policy.prefix(policy.params().weights(), &batch.shapes);
        let (vae, judged) = (policy.vae(), self.judged(c.rollout.vertices, c.train.seed));
        let jobs = batch.subjects.iter().enumerate().map(|(k, subject)| {
            let draw = |attempt: u64| self.group(&prefix.narrow(0, k as i64, 1), subject, number, attempt);
            let judge = move |drawn: &[RigSample]| rewards(vae, subject, drawn, &judged);
            let (mut drawn, mut known) = (draw(0)?, None);
            if c.rollout.dead == Dead::Resample {
                // Whether a group is drawn anew hangs on its rewards: nothing else can be done meanwhile.
                let told = |e: String| format!("{}: {e}", subject.name);
                let mut found = judge(&drawn).map_err(told)?;
                for attempt in 1..=TRIES {
                    if !is_dead(&found) {
                        break;
                    }
                    drawn = draw(attempt)?;
                    found = judge(&drawn).map_err(told)?;
                }
                known = Some(found);
            }
            let job = move || Ok((known.map_or_else(|| judge(&drawn), Ok)?, drawn));
            Ok((subject.name.clone(), job))
        });
        let threads = rayon::current_num_threads().min(batch.subjects.len());
        let groups: Vec<(Vec<Rewards>, Vec<RigSample>)> = judges::judged(threads, jobs)?;
        Ok(self.rollout_of(w, batch, &groups))
    }

    /// What is kept of drawn groups.
    fn rollout_of(&self, w: &Weights, batch: &Batch, groups: &[(Vec<Rewards>, Vec<RigSample>)]) -> Rollout {
        let c = &self.config;
        let (mut sequences, mut totals, mut mesh_of, mut parts) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (mut spread, mut dead, mut distinct) = (0.0, 0usize, 0usize);
        let (mut valid, mut joints) = (0usize, 0usize);
        for (mesh, (rewards, drawn)) in groups.iter().enumerate() {
            let still = is_dead(rewards);
            dead += usize::from(still);
            let mean = rewards.iter().map(|r| r.total).sum::<f64>() / rewards.len() as f64;
            let sum: f64 = rewards.iter().map(|r| (r.total - mean).powi(2)).sum();
            spread += (sum / (rewards.len() as f64 - 1.0)).sqrt();
            distinct += drawn.iter().map(|d| &d.ids).collect::<std::collections::HashSet<_>>().len();
            for (own, reward) in drawn.iter().zip(rewards) {
                valid += usize::from(own.decoded.is_ok());
                joints += own.decoded.as_ref().map_or(0, |d| d.joints.len());
                let told = self.policy.told(own);
                let counts = !(still && c.rollout.dead == Dead::Mask);
                let (ids, said) = (own.ids.clone(), own.said);
                sequences.push(Sequence { mesh, ids, told, counts, said, ..Sequence::default() });
                totals.push(reward.total);
                parts.push(*reward);
                mesh_of.push(mesh);
            }
        }
        for (own, a) in sequences.iter_mut().zip(advantages(&totals, &mesh_of, c.objective.scale)) {
            own.advantage = a;
        }
        let gap = self.remember(w, &batch.shapes, &mut sequences);
        let n = sequences.len().max(1) as f64;
        let rewards = if parts.is_empty() { Rewards::default() } else { Rewards::mean(&parts) };
        let tokens: usize = sequences.iter().map(|s| s.ids.len()).sum();
        let (groups, joints) = (groups.len().max(1) as f64, joints as f64 / n);
        let others = [
            valid as f64 / n,
            spread / groups,
            dead as f64 / groups,
            distinct as f64 / n,
            tokens as f64 / n,
            joints,
            gap,
        ];
        let notes = std::iter::once(rewards.total).chain(rewards.parts()).chain(others).collect();
        Rollout { shapes: batch.shapes.clone(), sequences, notes }
    }

    /// Asks the reference how likely the sequences were, and the policy where they are gone over more than once: else
    /// that is the one that learns, and what it says then is remembered. Gives how far the sampler and the trainer
    /// differ by token, NaN where that is not known yet.
    fn remember(&self, w: &Weights, shapes: &Shapes, sequences: &mut [Sequence]) -> f64 {
        let temperature = f64::from(self.config.rollout.temperature);
        let asked = |w: &Weights, sequences: &[Sequence]| {
            let all: Vec<&Sequence> = sequences.iter().collect();
            let (found, counts) = self.policy.likely(w, shapes, &all, temperature);
            (floats(&found.log), counts)
        };
        let (reference, counts) = asked(&self.start, sequences);
        let mut left = reference.as_slice();
        for (own, &n) in sequences.iter_mut().zip(&counts) {
            let (first, rest) = left.split_at(n as usize);
            (own.reference, left) = (first.to_vec(), rest);
        }
        if self.config.rollout.updates() == 1 {
            return f64::NAN;
        }
        let (old, counts) = asked(w, sequences);
        let all: Vec<usize> = (0..sequences.len()).collect();
        settle(sequences, &all, &old, &counts)
    }

    /// A mesh's group.
    fn group(&self, prefix: &Tensor, subject: &Subject, number: u64, attempt: u64) -> Result<Vec<RigSample>, String> {
        let (c, policy) = (&self.config, &*self.policy);
        let seed = c.train.seed;
        let each = 0..c.rollout.group as u64;
        let mut streams: Vec<_> =
            each.map(|k| stream(seed, "rollout draws", &[number, subject.key, attempt, k])).collect();
        policy.draw(policy.params().weights(), (prefix, &[&subject.mesh]), &c.draws(), &mut streams)
    }

    pub(super) fn judged(&self, vertices: usize, seed: u64) -> JudgeSettings {
        let half = self.config.rollout.precision.resolved() == Precision::Bf16;
        JudgeSettings { vertices, cut: self.config.eval.cut, half, seed }
    }
}

/// Remembers log-probabilities `old` of the free tokens of the sequences at some places one after another, of which each
/// has so many; gives how far the sum differs from what the sampler said, a token.
pub(super) fn settle(sequences: &mut [Sequence], places: &[usize], old: &[f32], counts: &[i64]) -> f64 {
    let (mut left, mut gap) = (old, 0.0);
    for (&k, &n) in places.iter().zip(counts) {
        let ((first, rest), own) = (left.split_at(n as usize), &mut sequences[k]);
        (own.old, left) = (first.to_vec(), rest);
        gap += (first.iter().map(|x| f64::from(*x)).sum::<f64>() - own.said).abs();
    }
    gap / old.len().max(1) as f64
}

/// Numbers of a tensor.
pub(super) fn floats(t: &Tensor) -> Vec<f32> {
    Vec::<f32>::try_from(t.detach().to_kind(Kind::Float).contiguous()).unwrap_or_default()
}

/// Whether nothing can be learnt from a group.
fn is_dead(rewards: &[Rewards]) -> bool {
    rewards.windows(2).all(|pair| pair[0].total == pair[1].total)
}

impl Rollout {
    /// As tensors, for a checkpoint.
    pub(super) fn tensors(&self) -> BTreeMap<String, Tensor> {
        let s = &self.sequences;
        let ids: Vec<i64> = s.iter().flat_map(|s| &s.ids).copied().collect();
        let told: Vec<f32> = s.iter().flat_map(|s| &s.told).copied().collect();
        let old: Vec<f32> = s.iter().flat_map(|s| &s.old).copied().collect();
        let reference: Vec<f32> = s.iter().flat_map(|s| &s.reference).copied().collect();
        let heads: Vec<i64> = s
            .iter()
            .flat_map(|s| [s.mesh as i64, s.ids.len() as i64, s.old.len() as i64, i64::from(s.counts)])
            .collect();
        let advantages: Vec<f64> = s.iter().map(|s| s.advantage).collect();
        let all = [
            ("cloud", Tensor::from_slice(&self.shapes.cloud)),
            ("picks", Tensor::from_slice(&self.shapes.picks)),
            ("meshes", Tensor::from(self.shapes.rigs as i64)),
            ("heads", Tensor::from_slice(&heads)),
            ("ids", Tensor::from_slice(&ids)),
            ("told", Tensor::from_slice(&told)),
            ("advantages", Tensor::from_slice(&advantages)),
            ("old", Tensor::from_slice(&old)),
            ("reference", Tensor::from_slice(&reference)),
            ("notes", Tensor::from_slice(&self.notes)),
        ];
        all.into_iter().map(|(name, t)| (format!("rollout.{name}"), t)).collect()
    }

    /// What [`Self::tensors`] gave; `None` where it was none.
    pub(super) fn of(kept: &BTreeMap<String, Tensor>) -> Option<Self> {
        let get = |name: &str| kept.get(&format!("rollout.{name}")).map(|t| t.contiguous().view([-1]));
        let whole = |name: &str| Vec::<i64>::try_from(get(name)?.to_kind(Kind::Int64)).ok();
        let single = |name: &str| Vec::<f32>::try_from(get(name)?.to_kind(Kind::Float)).ok();
        let double = |name: &str| Vec::<f64>::try_from(get(name)?.to_kind(Kind::Double)).ok();
        let (heads, ids) = (whole("heads")?, whole("ids")?);
        let told = told_of(single("told")?, ids.len())?;
        let width = told.len() / ids.len().max(1);
        let (old, reference, advantages) = (single("old")?, single("reference")?, double("advantages")?);
        let (mut token, mut free) = (0usize, 0usize);
        let mut sequences = Vec::new();
        for (head, &advantage) in heads.chunks_exact(4).zip(&advantages) {
            let &[mesh, tokens, chosen, counts] = head else { return None };
            let (tokens, chosen) =
                (token..token + usize::try_from(tokens).ok()?, free..free + usize::try_from(chosen).ok()?);
            (token, free) = (tokens.end, chosen.end);
            sequences.push(Sequence {
                mesh: usize::try_from(mesh).ok()?,
                told: told.get(width * tokens.start..width * tokens.end)?.to_vec(),
                ids: ids.get(tokens)?.to_vec(),
                advantage,
                counts: counts != 0,
                said: 0.0,
                old: old.get(chosen.clone())?.to_vec(),
                reference: reference.get(chosen)?.to_vec(),
            });
        }
        let shapes = Shapes {
            rigs: usize::try_from(*whole("meshes")?.first()?).ok()?,
            cloud: single("cloud")?,
            picks: whole("picks")?,
            ..Shapes::default()
        };
        // Of a version with other rewards they would be logged by names that are not theirs.
        let notes = double("notes").filter(|notes| notes.len() == noted().count())?;
        Some(Self { shapes, sequences, notes })
    }
}

/// What so many places are told. Those kept before regions were told have a joint, its parent and the place alone.
fn told_of(kept: Vec<f32>, places: usize) -> Option<Vec<f32>> {
    const BEFORE: usize = 7;
    if kept.len() != BEFORE * places {
        // None at all for skeletons, which are told nothing.
        let whole = places > 0 && kept.len().is_multiple_of(places);
        return (whole && (kept.is_empty() || kept.len() > GEOMETRY * places)).then_some(kept);
    }
    let mut told = vec![0.0; (GEOMETRY + 1) * places];
    for (row, own) in told.chunks_exact_mut(GEOMETRY + 1).zip(kept.chunks_exact(BEFORE)) {
        row[..BEFORE - 1].copy_from_slice(&own[..BEFORE - 1]);
        row[GEOMETRY] = own[BEFORE - 1];
    }
    Some(told)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_told_before_there_were_regions_is_read() {
        let told = told_of(vec![1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 2.0], 1).unwrap();
        assert_eq!((&told[..6], told[GEOMETRY]), (&[1.0, 2.0, 3.0, 4.0, 5.0, 6.0][..], 2.0));
        assert!(told[6..GEOMETRY].iter().all(|&x| x == 0.0) && told.len() == GEOMETRY + 1);
        let now: Vec<f32> = (0..2 * (GEOMETRY + 6)).map(|k| k as f32).collect();
        assert_eq!(told_of(now.clone(), 2), Some(now.clone()));
        assert_eq!((told_of(vec![0.0; 16], 2), told_of(Vec::new(), 2)), (None, Some(Vec::new())));
        assert_eq!((told_of(now, 3), told_of(Vec::new(), 0)), (None, Some(Vec::new())));
    }

    #[test]
    fn a_rollout_comes_back_from_a_checkpoint() {
        let own = |mesh: usize, n: usize| Sequence {
            mesh,
            ids: (0..n as i64).collect(),
            told: (0..(GEOMETRY + 6) * n).map(|k| k as f32).collect(),
            advantage: 0.1 * n as f64,
            counts: mesh == 0,
            said: 0.0,
            old: vec![-0.5; n - 2],
            reference: vec![-0.25; n - 2],
        };
        let shapes = Shapes { rigs: 2, cloud: vec![0.5; 24], picks: vec![1, 0], ..Shapes::default() };
        let all = Rollout {
            shapes,
            sequences: vec![own(0, 5), own(1, 2), own(1, 4)],
            notes: vec![1.0 / 3.0; noted().count()],
        };
        assert_eq!(Rollout::of(&all.tensors()), Some(all));
        assert_eq!(Rollout::of(&BTreeMap::new()), None);
    }
}
