//! TokenRig as a policy: it draws skeletons and skin codes as one sequence.

use riglab_core::{Mesh, Rig};
use riglab_geom::CloudConfig;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::{Params, Weights};
use riglab_nn::perceiver::PerceiverConfig;
use riglab_nn::tokenrig::{Choices, Layout, Likelihood, NextTokens, Sequences};
use riglab_random::Stream;
use riglab_token::Mask;
use riglab_train::Task;
use tch::{Device, Tensor};

use super::{Flat, Policy, Pool, bits, counts, dealt};
use crate::assets::Up;
use crate::experiment::Experiment;
use crate::grpo::rollout::Sequence;
use crate::tokenrig::{RigSample, Rigger, Strict, TokenRigTask};
use crate::unirig_skeleton::{Batch as Shapes, shape_tensors};

/// Which of a sequence's targets could have been others, and what they could have been.
#[derive(Default)]
struct Free {
    /// See [`Choices::skeleton`].
    skeleton: Vec<bool>,
    /// See [`Choices::empty`].
    empty: Vec<bool>,
    /// Of each target, whether it was chosen.
    chosen: Vec<bool>,
}

/// Walks the grammar along a sequence; the first `prompt` tokens were given.
fn free(layout: &Layout, mut grammar: Strict, ids: &[i64], prompt: usize, out: &mut Free) {
    let first = layout.skeleton();
    let mut mask = Mask::none(layout.drawn());
    for (at, &id) in ids.iter().enumerate() {
        grammar.write_allowed(&mut mask);
        if at > 0 {
            let mut chosen = at >= prompt && id != layout.end();
            if id < first {
                let allowed = (0..first as u32).map(|k| mask.allows(k));
                let before = out.skeleton.len();
                out.skeleton.extend(allowed);
                chosen &= out.skeleton[before..].iter().filter(|a| **a).count() > 1;
            } else if id != layout.end() {
                out.empty.push(mask.allows(layout.drawn_empty()));
            }
            out.chosen.push(chosen);
        }
        layout.drawn_of(&[id]).into_iter().for_each(|number| grammar.take(number));
    }
}

impl Policy for TokenRigTask {
    fn params(&self) -> &Params {
        Task::params(self)
    }

    fn device(&self) -> Device {
        self.rigger().device()
    }

    fn pool(&self) -> Pool<'_> {
        Pool { assets: &self.assets, train: &self.train_assets, validate: &self.validation_assets }
    }

    fn notes(&self) -> Vec<String> {
        Experiment::notes(self)
    }

    fn reads(&self) -> (CloudConfig, &PerceiverConfig) {
        let c = self.rigger().config();
        (c.sampling.cloud.clone(), &c.model.shape)
    }

    fn up(&self) -> Up {
        self.rigger().config().data.up
    }

    fn rigger(&self) -> Option<&Rigger> {
        Some(Self::rigger(self))
    }

    fn prefix(&self, w: &Weights, shapes: &Shapes) -> Tensor {
        self.rigger().prefix(w, shapes)
    }

    fn draw(
        &self,
        w: &Weights,
        (prefix, meshes): (&Tensor, &[&Mesh]),
        how: &GenerateConfig,
        streams: &mut [Stream],
    ) -> Result<Vec<RigSample>, String> {
        let rigger = self.rigger();
        let seen = rigger.with_meshes(prefix.shallow_clone(), meshes.iter().copied());
        rigger.draw(w, &seen, &vec![rigger.free(); streams.len()], how, streams)
    }

    fn told(&self, drawn: &RigSample) -> Vec<f32> {
        self.rigger().teller().places(&drawn.ids, drawn.skeleton.len(), &drawn.joints)
    }

    fn likely(&self, w: &Weights, shapes: &Shapes, all: &[&Sequence], temperature: f64) -> (Likelihood, Vec<i64>) {
        let rigger = self.rigger();
        let (c, net, layout, device) = (rigger.config(), rigger.net(), rigger.layout(), rigger.device());
        let (grammar, prompt) = (rigger.grammar(c.limits.tokens), rigger.free().len());
        let parts = dealt(all, device);
        let parts: Vec<_> = parts
            .into_iter()
            .map(|own| {
                let mut found = Free::default();
                own.iter().for_each(|s| free(layout, grammar.clone(), &s.ids, prompt, &mut found));
                let counts = counts(own, &found.chosen);
                (own, found, counts, shape_tensors(shapes, c.model.shape.tokens, device))
            })
            .collect();
        let jobs = parts.iter().map(|(own, found, _, (cloud, picks))| {
            let (cloud, picks) = (cloud.shallow_clone(), picks.shallow_clone());
            move |w: &Weights| {
                let Flat { ids, targets, lengths, meshes } = Flat::of(own, device);
                let prefix = net.condition(w, &cloud, &picks);
                let told = c.model.tell_joint.then(|| {
                    let flat: Vec<f32> = own.iter().flat_map(|s| &s.told).copied().collect();
                    Tensor::from_slice(&flat).view([ids.size()[0], -1]).to_device(device)
                });
                let sequences = Sequences { ids: &ids, lengths: &lengths, told: told.as_ref() };
                // Without dropout: the policy is what draws.
                let hidden = net.forward_behind(w, &prefix, &meshes, &sequences);
                let skeleton = bits(&found.skeleton, device).view([-1, layout.skeleton()]);
                let empty = bits(&found.empty, device);
                let asked =
                    NextTokens { hidden: &hidden, targets: &targets, bins: i64::from(c.tokenizer.bins), spread: 0.0 };
                let choices = Choices { skeleton: &skeleton, empty: &empty };
                let Likelihood { log, entropy } = net.likelihood(w, &asked, Some(&choices), temperature);
                let chosen = bits(&found.chosen, device).nonzero().squeeze_dim(1);
                vec![log.index_select(0, &chosen), entropy.index_select(0, &chosen)]
            }
        });
        let told = w.side_by_side(jobs.collect::<Vec<_>>());
        let joined = |k: usize| Tensor::cat(&told.iter().map(|own| &own[k]).collect::<Vec<_>>(), 0);
        let counts = parts.into_iter().flat_map(|(_, _, counts, _)| counts).collect();
        (Likelihood { log: joined(0), entropy: joined(1) }, counts)
    }

    fn rig(&self, mesh: &Mesh, drawn: &RigSample, key: u64) -> Result<Option<Rig>, String> {
        let Ok(decoded) = &drawn.decoded else { return Ok(None) };
        self.rigged(mesh, decoded, std::slice::from_ref(&drawn.codes), key).map(Some)
    }
}

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::Head;
    use riglab_random::stream;

    use super::*;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    #[test]
    fn what_was_drawn_was_allowed_and_what_was_forced_was_no_choice() {
        for (head, empty) in [(Head::Levels, true), (Head::Flat, false)] {
            let rigger = untrained(head, empty);
            let (mesh, w) = (tetrahedron(), rigger.params().weights());
            let prefix = rigger.condition(w, &[(&mesh, 0)]);
            let how = GenerateConfig { sample: true, ..GenerateConfig::default() };
            let mut streams: Vec<_> = (0..4).map(|k| stream(1, "test", &[k])).collect();
            let drawn = rigger.draw(w, &prefix, &vec![rigger.free(); 4], &how, &mut streams).unwrap();
            let first = rigger.layout().skeleton();
            for own in drawn {
                let (mut found, grammar) = (Free::default(), rigger.grammar(rigger.config().limits.tokens));
                free(rigger.layout(), grammar.clone(), &own.ids, 1, &mut found);
                let targets = &own.ids[1..];
                assert_eq!(found.chosen.len(), targets.len());
                let of_skeleton: Vec<i64> = targets.iter().copied().filter(|&id| id < first).collect();
                let masks: Vec<&[bool]> = found.skeleton.chunks_exact(first as usize).collect();
                assert_eq!(masks.len(), of_skeleton.len());
                assert!(masks.iter().zip(&of_skeleton).all(|(mask, &id)| mask[id as usize]));
                assert!(found.empty.iter().all(|&may| empty || !may), "flat sequences have no empty bones");
                assert_eq!(found.chosen.last(), Some(&false), "the end is forced");
                assert!(found.chosen.iter().filter(|c| **c).count() > 3);
                // What is given is no choice.
                let mut given = Free::default();
                free(rigger.layout(), grammar, &own.ids, own.skeleton.len(), &mut given);
                assert!(given.chosen[..own.skeleton.len() - 1].iter().all(|c| !c));
                assert_eq!(given.chosen[own.skeleton.len() - 1..], found.chosen[own.skeleton.len() - 1..]);
            }
        }
    }
}
