//! Group relative policy optimisation (SkinTokens 3.4.2): advantages within groups, the clipped objective, and the
//! divergence from a reference.
//!
//! Shapes: S sequences, T tokens of all of them one after another. Only tokens that were chosen freely are among
//! them: what a prompt or a grammar has set is nobody's choice.

use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

/// Added to a deviation, so that groups with hardly any spread do not blow up.
pub const LEAST_SPREAD: f64 = 1e-4;

/// What advantages are divided by.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Scale {
    /// The standard deviation of the sequence's group by n - 1 (the paper's; it does not say by which).
    #[default]
    Group,
    /// The same by n.
    Population,
    /// The standard deviation of what is left of all rewards without their groups' means: easy and hard meshes then
    /// count by how much there is to gain.
    Batch,
    /// Nothing.
    None,
}

/// How tokens and sequences are averaged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Norm {
    /// The mean over a sequence's tokens, then over its group, then over groups (the paper's).
    #[default]
    Sequence,
    /// The mean over all tokens: long sequences count more.
    Token,
    /// Sums over sequences divided by a constant length: no sequence gains by being long or short.
    Constant,
}

/// What factors, bounds of ratios and lengths in tokens may be: beyond, gradients pass what single precision holds, or
/// vanish.
const MOST: f64 = 1e6;

/// The objective's settings. Defaults are the paper's.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectiveConfig {
    /// ε: how far from 1 a ratio may count.
    pub clip: f64,
    /// ε above 1, where it is another; 0 takes `clip`.
    pub clip_high: f64,
    /// β, of the divergence from the reference.
    pub beta: f64,
    /// What advantages are divided by.
    pub scale: Scale,
    /// How tokens and sequences are averaged.
    pub norm: Norm,
    /// The length of [`Norm::Constant`], in tokens.
    pub length: f64,
}

impl Default for ObjectiveConfig {
    fn default() -> Self {
        Self { clip: 0.2, clip_high: 0.0, beta: 0.1, scale: Scale::Group, norm: Norm::Sequence, length: 256.0 }
    }
}

impl ObjectiveConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        if !(self.clip > 0.0 && self.clip < 1.0) {
            return Err(("clip", format!("clip = {} must lie between 0 and 1", self.clip)));
        }
        for (key, value, least) in
            [("clip_high", self.clip_high, 0.0), ("beta", self.beta, 0.0), ("length", self.length, 1.0)]
        {
            if !(least..=MOST).contains(&value) {
                return Err((key, format!("{key} = {value:?} must lie in [{least}, {MOST}]")));
            }
        }
        Ok(())
    }
}

/// A_i = (R_i - mean) / (deviation + 1e-4), means and deviations of each group; exactly 0 in a group whose
/// rewards are equal, and in one of a single sequence. `groups`: the group of each sequence.
pub fn advantages(rewards: &[f64], groups: &[usize], scale: Scale) -> Vec<f64> {
    let count = groups.iter().max().map_or(0, |g| g + 1);
    let of = |group: usize| rewards.iter().zip(groups).filter(move |(_, g)| **g == group).map(|(r, _)| *r);
    let mut left = vec![0.0; rewards.len()];
    let mut spreads = vec![0.0; count];
    let (mut squares, mut freedom) = (0.0, 0.0);
    for (group, spread) in spreads.iter_mut().enumerate() {
        let n = of(group).count() as f64;
        let (least, most) = of(group).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), r| (a.min(r), b.max(r)));
        if n < 2.0 || least == most {
            continue;
        }
        let mean = of(group).sum::<f64>() / n;
        let sum: f64 = of(group).map(|r| (r - mean).powi(2)).sum();
        *spread = (sum / if scale == Scale::Population { n } else { n - 1.0 }).sqrt();
        squares += sum;
        freedom += n - 1.0;
        for ((left, r), _) in left.iter_mut().zip(rewards).zip(groups).filter(|(_, g)| **g == group) {
            *left = r - mean;
        }
    }
    let all = if freedom > 0.0 { (squares / freedom).sqrt() } else { 0.0 };
    let by = |group: usize| match scale {
        Scale::Group | Scale::Population => spreads[group] + LEAST_SPREAD,
        Scale::Batch => all + LEAST_SPREAD,
        Scale::None => 1.0,
    };
    left.iter().zip(groups).map(|(l, &g)| l / by(g)).collect()
}

/// log softmax of scores [.., v] over those that are allowed [.., v] (all where `None`), after division by a
/// temperature. Where one alone is allowed it is 0, without a gradient.
pub fn log_softmax_within(scores: &Tensor, allowed: Option<&Tensor>, temperature: f64) -> Tensor {
    let scores = if temperature == 1.0 { scores.shallow_clone() } else { scores / temperature };
    let scores = match allowed {
        Some(allowed) => scores.masked_fill(&allowed.logical_not(), f64::NEG_INFINITY),
        None => scores,
    };
    scores.log_softmax(-1, None::<Kind>)
}

/// -Σ p ln p of log-probabilities [.., v], without what is impossible. No gradient.
pub fn entropy(likely: &Tensor) -> Tensor {
    let likely = likely.detach();
    let terms = (likely.exp() * &likely).masked_fill(&likely.eq(f64::NEG_INFINITY), 0.0);
    -terms.sum_dim_intlist(-1, false, None::<Kind>)
}

/// Log-probabilities of the chosen tokens, by whom.
pub struct Policies<'a> {
    /// The policy that learns, [T].
    pub now: &'a Tensor,
    /// The policy that chose, [T].
    pub old: &'a Tensor,
    /// The policy that it is held to, [T].
    pub reference: &'a Tensor,
}

/// The objective, and what it is made of.
pub struct Objective {
    /// To be minimised.
    pub loss: Tensor,
    /// The part of it that rewards make; the rest is β times the divergence.
    pub policy: Tensor,
    /// Of each sequence what it adds to the sum to be maximised, [S].
    pub per_sequence: Tensor,
    /// now / old, [T].
    pub ratio: Tensor,
    /// The k3 estimate of the divergence from the reference, [T].
    pub k3: Tensor,
    /// Tokens whose ratio was clipped, of all.
    pub clip_fraction: f64,
}

/// Less the mean over groups of the mean over sequences of
///
/// ```text
/// 1/|o| Σ_t [ min(r A, clip(r, 1 - ε, 1 + ε) A) - β k3 ],
/// r = exp(now - old),   k3 = exp(ref - now) - (ref - now) - 1
/// ```
///
/// `lengths`, `groups`, `advantages`: of each sequence. A sequence without tokens adds 0, and counts in its group.
pub fn objective(
    policies: &Policies,
    lengths: &[i64],
    groups: &[usize],
    advantages: &[f64],
    c: &ObjectiveConfig,
) -> Objective {
    let now = policies.now;
    let (kind, device) = (now.kind(), now.device());
    let per_token = |of: &dyn Fn(usize) -> f64| {
        let values: Vec<f64> =
            lengths.iter().enumerate().flat_map(|(s, &n)| std::iter::repeat_n(of(s), n as usize)).collect();
        Tensor::from_slice(&values).to_kind(kind).to_device(device)
    };
    let mut sizes = vec![0usize; groups.iter().max().map_or(0, |g| g + 1)];
    groups.iter().for_each(|&g| sizes[g] += 1);
    let present = sizes.iter().filter(|n| **n > 0).count().max(1) as f64;
    let all_tokens = lengths.iter().sum::<i64>().max(1) as f64;
    // Of a sequence's sum over tokens: what it is divided by, and its share of the whole.
    let own = |s: usize| match c.norm {
        Norm::Sequence | Norm::Token => lengths[s].max(1) as f64,
        Norm::Constant => c.length,
    };
    let share = |s: usize| match c.norm {
        Norm::Sequence | Norm::Constant => 1.0 / (present * sizes[groups[s]] as f64),
        Norm::Token => lengths[s].max(1) as f64 / all_tokens,
    };
    let advantage = per_token(&|s| advantages[s]);
    let ratio = (now - policies.old).exp();
    let high = if c.clip_high > 0.0 { c.clip_high } else { c.clip };
    let clipped = ratio.clamp(1.0 - c.clip, 1.0 + high);
    let surrogate = (&ratio * &advantage).minimum(&(clipped * &advantage));
    let log = policies.reference - now;
    let k3 = log.exp() - log - 1.0;
    let place: Vec<i64> =
        lengths.iter().enumerate().flat_map(|(s, &n)| std::iter::repeat_n(s as i64, n as usize)).collect();
    let place = Tensor::from_slice(&place).to_device(device);
    let weight = per_token(&|s| 1.0 / own(s));
    let sum =
        |terms: &Tensor| Tensor::zeros([lengths.len() as i64], (kind, device)).index_add(0, &place, &(terms * &weight));
    let shares: Vec<f64> = (0..lengths.len()).map(share).collect();
    let shares = Tensor::from_slice(&shares).to_kind(kind).to_device(device);
    let (gain, divergence) = (sum(&surrogate), sum(&k3));
    let per_sequence = &gain - &divergence * c.beta;
    let beyond = ratio.gt(1.0 + high).logical_and(&advantage.gt(0.0));
    let below = ratio.lt(1.0 - c.clip).logical_and(&advantage.lt(0.0));
    let clipped = beyond.logical_or(&below).sum(Kind::Int64).int64_value(&[]) as f64;
    Objective {
        loss: -(&per_sequence * &shares).sum(None::<Kind>),
        policy: -(gain * &shares).sum(None::<Kind>),
        per_sequence,
        ratio: ratio.detach(),
        k3: k3.detach(),
        clip_fraction: clipped / all_tokens,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn factors_and_bounds_keep_within_what_gradients_hold() {
        let key = |change: fn(&mut ObjectiveConfig)| {
            let mut config = ObjectiveConfig::default();
            change(&mut config);
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(key(|c| (c.clip_high, c.beta, c.length) = (0.0, 0.0, 1.0)), Ok(()));
        assert_eq!([key(|c| c.beta = 1e30), key(|c| c.beta = -0.1), key(|c| c.beta = f64::NAN)], [Err("beta"); 3]);
        assert_eq!([key(|c| c.clip_high = 1e30), key(|c| c.clip = 0.0)], [Err("clip_high"), Err("clip")]);
        assert_eq!([key(|c| c.length = 0.5), key(|c| c.length = 1e300)], [Err("length"); 2]);
    }

    #[test]
    fn groups_are_measured_by_themselves() {
        let near = |a: &[f64], b: &[f64]| {
            assert!(a.len() == b.len() && a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12), "{a:?} {b:?}");
        };
        let (rewards, groups) = ([1.0, 3.0, 10.0, 10.0, 7.0], [0, 0, 1, 1, 2]);
        let d = 2f64.sqrt() + LEAST_SPREAD;
        near(&advantages(&rewards, &groups, Scale::Group), &[-1.0 / d, 1.0 / d, 0.0, 0.0, 0.0]);
        near(&advantages(&rewards, &groups, Scale::Batch), &[-1.0 / d, 1.0 / d, 0.0, 0.0, 0.0]);
        near(&advantages(&rewards, &groups, Scale::None), &[-1.0, 1.0, 0.0, 0.0, 0.0]);
        let d = 1.0 + LEAST_SPREAD;
        near(&advantages(&rewards, &groups, Scale::Population), &[-1.0 / d, 1.0 / d, 0.0, 0.0, 0.0]);
        // Rewards whose mean is not one of them to the last bit are still equal.
        assert_eq!(advantages(&[0.1; 3], &[0; 3], Scale::Group), [0.0; 3]);
        assert_eq!(advantages(&[], &[], Scale::Group), [0.0; 0]);
    }

    #[test]
    fn averages_are_what_they_say() {
        let now = Tensor::zeros([3], (Kind::Double, tch::Device::Cpu));
        let same = Policies { now: &now, old: &now, reference: &now };
        let of = |norm: Norm| {
            let c = ObjectiveConfig { norm, length: 4.0, ..ObjectiveConfig::default() };
            // One token of advantage 1, two of advantage -1.
            objective(&same, &[1, 2], &[0, 0], &[1.0, -1.0], &c).loss.double_value(&[])
        };
        assert_eq!(of(Norm::Sequence), 0.0);
        assert!((of(Norm::Token) - 1.0 / 3.0).abs() < 1e-12);
        assert!((of(Norm::Constant) - 0.125).abs() < 1e-12);
    }

    #[test]
    fn what_has_no_choice_has_no_gradient() {
        let scores = Tensor::from_slice(&[0.3f64, -2.0, 5.0]).view([1, 3]).set_requires_grad(true);
        let allowed = Tensor::from_slice(&[false, true, false]).view([1, 3]);
        let likely = log_softmax_within(&scores, Some(&allowed), 0.7);
        let own = likely.select(1, 1).sum(None::<Kind>);
        assert_eq!(own.double_value(&[]), 0.0);
        assert_eq!(entropy(&likely).double_value(&[0]), 0.0);
        let grads = Tensor::run_backward(&[own], &[&scores], false, false);
        assert_eq!(Vec::<f64>::try_from(grads[0].view([-1])).unwrap(), [0.0; 3]);
    }
}
