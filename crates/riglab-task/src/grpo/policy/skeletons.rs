//! UniRig's skeleton model as a policy: it draws skeletons alone, which are judged by where their joints and bones are.

use riglab_core::{Mesh, Rig};
use riglab_geom::CloudConfig;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::grpo::{entropy, log_softmax_within};
use riglab_nn::params::{Params, Weights};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::tokenrig::Likelihood;
use riglab_random::Stream;
use riglab_token::{Grammar, Mask};
use riglab_train::Task;
use tch::{Device, Kind, Tensor};

use super::{Flat, Policy, Pool, bits, counts};
use crate::assets::Up;
use crate::experiment::Experiment;
use crate::grpo::rollout::Sequence;
use crate::tokenrig::RigSample;
use crate::unirig_skeleton::gallery::bound;
use crate::unirig_skeleton::generate::{Likely, each};
use crate::unirig_skeleton::{Batch as Shapes, SkeletonTask, shape_of};

/// Walks the grammar along a sequence whose first `prompt` tokens were given: of each target, whether it was chosen; of
/// those that were, which of all `ids` were allowed.
fn free(mut grammar: Grammar, sequence: &[i64], prompt: usize, ids: usize) -> (Vec<bool>, Vec<bool>) {
    let (mut chosen, mut allowed, mut mask) = (Vec::new(), Vec::new(), Mask::none(ids));
    for (at, &id) in sequence.iter().enumerate() {
        if at > 0 {
            grammar.allowed(&mut mask);
            let before = allowed.len();
            allowed.extend((0..ids as u32).map(|k| mask.allows(k)));
            let free = at >= prompt && allowed[before..].iter().filter(|a| **a).count() > 1;
            chosen.push(free);
            if !free {
                allowed.truncate(before);
            }
        }
        grammar.accept(id as u32);
    }
    (chosen, allowed)
}

impl Policy for SkeletonTask {
    fn params(&self) -> &Params {
        Task::params(self)
    }

    fn device(&self) -> Device {
        self.device
    }

    fn pool(&self) -> Pool<'_> {
        Pool { assets: &self.assets, train: &self.train_assets, validate: &self.validation_assets }
    }

    fn notes(&self) -> Vec<String> {
        Experiment::notes(self)
    }

    fn reads(&self) -> (CloudConfig, &PerceiverConfig) {
        (self.config().eval_cloud(), &self.config().model.shape)
    }

    fn up(&self) -> Up {
        self.config().data.up
    }

    fn prefix(&self, w: &Weights, shapes: &Shapes) -> Tensor {
        let (cloud, picks) = shape_of(self.config(), shapes, self.device);
        self.net().condition(w, &cloud, &picks)
    }

    fn draw(
        &self,
        w: &Weights,
        (prefix, _): (&Tensor, &[&Mesh]),
        how: &GenerateConfig,
        streams: &mut [Stream],
    ) -> Result<Vec<RigSample>, String> {
        let _no_grad = tch::no_grad_guard();
        let mut likelihood = vec![Likely::default(); streams.len()];
        let of = each(prefix, streams.len());
        let drawn = self.drawer().draw_told(w, (prefix, &of), streams, how, Some(&mut likelihood))?;
        let whole = drawn.into_iter().zip(likelihood).map(|(own, likelihood)| RigSample {
            ids: own.ids.iter().map(|&id| i64::from(id)).collect(),
            skeleton: own.ids,
            decoded: own.decoded,
            codes: Vec::new(),
            joints: Vec::new(),
            likelihood: (likelihood.sum, likelihood.tokens),
            said: likelihood.said,
        });
        Ok(whole.collect())
    }

    fn told(&self, _: &RigSample) -> Vec<f32> {
        Vec::new()
    }

    fn likely(&self, w: &Weights, shapes: &Shapes, all: &[&Sequence], temperature: f64) -> (Likelihood, Vec<i64>) {
        let Flat { ids, targets, lengths, meshes } = Flat::of(all, self.device);
        // Without dropout: the policy is what draws.
        let scores = self.net().logits_behind(w, &self.prefix(w, shapes), &meshes, &ids, &lengths);
        let (vocabulary, prompt) = (scores.size()[1] as usize, self.drawer().start().len());
        let (mut chosen, mut allowed) = (Vec::new(), Vec::new());
        for own in all {
            let (of_targets, of_chosen) =
                free(self.drawer().grammar(self.config().limits.tokens), &own.ids, prompt, vocabulary);
            chosen.extend(of_targets);
            allowed.extend(of_chosen);
        }
        let at = bits(&chosen, self.device).nonzero().squeeze_dim(1);
        let scores = scores.index_select(0, &at);
        let scores = if scores.kind() == Kind::Double { scores } else { scores.to_kind(Kind::Float) };
        let allowed = bits(&allowed, self.device).view([-1, vocabulary as i64]);
        let likely = log_softmax_within(&scores, Some(&allowed), temperature);
        let log = likely.gather(1, &targets.index_select(0, &at).unsqueeze(1), false).squeeze_dim(1);
        (Likelihood { log, entropy: entropy(&likely).to_kind(Kind::Float) }, counts(all, &chosen))
    }

    fn rig(&self, mesh: &Mesh, drawn: &RigSample, _key: u64) -> Result<Option<Rig>, String> {
        Ok(drawn.decoded.as_ref().ok().and_then(|d| d.skeleton().ok()).and_then(|own| bound(&own, mesh)))
    }
}

#[cfg(test)]
mod tests {
    use riglab_token::{Limits, Parents, Tokenizer, TokenizerConfig};

    use super::*;

    #[test]
    fn what_was_drawn_was_allowed_and_what_was_forced_was_no_choice() {
        let tokenizer = Tokenizer::new(TokenizerConfig::default());
        let vocabulary = tokenizer.vocabulary();
        // Too few joints for a class of any template; one joint, then room for the end alone.
        let ids = [vocabulary.bos(), vocabulary.no_class(), 3, 4, 5, vocabulary.eos()].map(i64::from);
        let grammar = || Grammar::new(&tokenizer, Limits { joints: 1, tokens: 16 }, Parents::Existing);
        let (chosen, allowed) = free(grammar(), &ids, 1, vocabulary.len());
        assert_eq!(chosen, [false, true, true, true, false]);
        for (row, id) in allowed.chunks_exact(vocabulary.len()).zip(&ids[2..]) {
            assert!(row[*id as usize] && row.iter().filter(|a| **a).count() > 1);
        }
        let (chosen, allowed) = free(grammar(), &ids, 3, vocabulary.len());
        assert_eq!((chosen, allowed.len()), (vec![false, false, true, true, false], 2 * vocabulary.len()));
    }
}
