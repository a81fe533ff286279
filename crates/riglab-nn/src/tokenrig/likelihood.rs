//! How likely each token of a sequence was, to the one who drew it.

use tch::{Kind, Tensor};

use super::loss::{Freely, float};
use super::{NextTokens, TokenRig};
use crate::grpo::{entropy, log_softmax_within};
use crate::layers::affine;
use crate::params::Weights;

/// What could have stood in the places of some targets.
#[derive(Clone, Copy)]
pub struct Choices<'a> {
    /// For each target that is a skeleton id, in their order, which skeleton ids a grammar allowed: [k, ids], bool.
    pub skeleton: &'a Tensor,
    /// For each target that is a code or an empty bone, in their order, whether an empty bone was allowed: [m], bool.
    pub empty: &'a Tensor,
}

/// Of each target, [M].
pub struct Likelihood {
    /// Its log-probability among what could have stood there; a code's is the sum of its levels'.
    pub log: Tensor,
    /// The entropy of that choice; a code's is the sum of its levels', each given those drawn before it. No gradient.
    pub entropy: Tensor,
}

impl TokenRig {
    /// The log-probabilities with which targets are drawn by sampling with a grammar and a temperature, and by nothing
    /// else: what a policy's gradient is taken of. `choices`: `None` for one softmax over everything, without a
    /// grammar. With [`super::Head::Levels`], the end follows by the grammar alone and has log-probability 0.
    pub fn likelihood(
        &self,
        w: &Weights,
        asked: &NextTokens,
        choices: Option<&Choices>,
        temperature: f64,
    ) -> Likelihood {
        let first = self.layout.skeleton();
        let in_skeleton = asked.targets.lt(first);
        let is_end = asked.targets.eq(self.layout.end());
        let places = |mask: &Tensor| mask.nonzero().squeeze_dim(1);
        let (of_skeleton, of_end) = (places(&in_skeleton), places(&is_end));
        let of_skin = places(&in_skeleton.logical_or(&is_end).logical_not());
        let pick = |t: &Tensor, rows: &Tensor| t.index_select(0, rows);
        let own = |likely: &Tensor, targets: &Tensor| likely.gather(1, &targets.unsqueeze(1), false).squeeze_dim(1);
        let (targets, hidden) = (pick(asked.targets, &of_skeleton), pick(asked.hidden, &of_skeleton));
        // Of the skeleton, of the codes, of the ends.
        let mut log: Vec<Tensor> = Vec::with_capacity(3);
        let mut entropies: Vec<Tensor> = Vec::with_capacity(3);
        match &self.levels {
            None => {
                let mut add = |mut found: Vec<Tensor>| {
                    entropies.extend(found.pop().map(|t| t.detach()));
                    log.append(&mut found);
                };
                let both = move |likely: Tensor, targets: &Tensor| {
                    let own = likely.gather(1, &targets.unsqueeze(1), false).squeeze_dim(1);
                    vec![own, entropy(&likely)]
                };
                match choices {
                    None => {
                        for rows in [&of_skeleton, &of_skin, &of_end] {
                            let rows = [&pick(asked.hidden, rows), &pick(asked.targets, rows)];
                            add(self
                                .scored(w, &rows, move |s, t| both(log_softmax_within(s, None, temperature), &t[0])));
                        }
                    }
                    Some(choices) => {
                        // Each part is drawn from its own ids, which are those that need scores.
                        add(self.scored(w, &[&hidden, &targets, choices.skeleton], move |s, t| {
                            both(log_softmax_within(&s.narrow(1, 0, first), Some(&t[1]), temperature), &t[0])
                        }));
                        let codes = self.layout.codes();
                        let rows = [&pick(asked.hidden, &of_skin), &(pick(asked.targets, &of_skin) - first)];
                        add(self.scored(w, &rows, move |s, t| {
                            both(log_softmax_within(&s.narrow(1, first, codes), None, temperature), &t[0])
                        }));
                    }
                }
            }
            Some(levels) => {
                let table = w[self.decoder.table()].narrow(0, 0, first);
                let scores = float(&affine(&hidden, &table, None));
                let likely = log_softmax_within(&scores, choices.map(|c| c.skeleton), temperature);
                log.push(own(&likely, &targets));
                entropies.push(entropy(&likely));
                let freely = Freely { empty: choices.map(|c| c.empty), temperature, entropies: true };
                let ids = pick(asked.targets, &of_skin);
                let (sum, own) = self.level_likelihood(w, levels, &pick(asked.hidden, &of_skin), &ids, &freely);
                entropies.push(own.unwrap_or_else(|| sum.detach().zeros_like()));
                log.push(sum);
            }
        }
        if log.len() < 3 {
            let none = Tensor::zeros([of_end.size()[0]], (log[0].kind(), log[0].device()));
            log.push(none.shallow_clone());
            entropies.push(none);
        }
        // Back into the order of the targets.
        let order = Tensor::cat(&[of_skeleton, of_skin, of_end], 0).argsort(0, false);
        let join = |parts: &[Tensor]| Tensor::cat(parts, 0).index_select(0, &order);
        Likelihood { log: join(&log), entropy: join(&entropies).to_kind(Kind::Float) }
    }
}
