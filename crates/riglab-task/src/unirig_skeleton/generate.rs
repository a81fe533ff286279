//! Skeletons drawn from the model.

use riglab_core::Rig;
use riglab_geom::CloudSampler;
use riglab_metric::consensus;
use riglab_nn::decoder::Cache;
use riglab_nn::generate::{Decoder, GenerateConfig, Grammar as Rules, chooser, log_softmax, rows};
use riglab_nn::params::Weights;
use riglab_nn::skeleton::SkeletonModel;
use riglab_random::{Stream, stream};
use riglab_token::{DecodeFault, Decoded, Grammar, Limits, Mask};
use tch::{Kind, Tensor};

use super::batch::{Batch, shape};
use super::evaluate::joints;
use super::{SkeletonTask, shape_of};

/// What draws for assets are seeded by: one a key, or `each` of several.
pub(crate) fn streams(seed: u64, keys: impl Iterator<Item = u64>, each: usize) -> Vec<Stream> {
    let of = |index: &[u64]| stream(seed, "skeleton draws", index);
    if each == 1 {
        return keys.map(|key| of(&[key])).collect();
    }
    keys.flat_map(|key| (0..each as u64).map(move |k| [key, k])).map(|index| of(&index)).collect()
}

/// The strict grammar, for a decoder.
#[derive(Clone)]
struct Strict {
    grammar: Grammar,
    ids: usize,
    end: u32,
}

impl Rules for Strict {
    fn allowed(&self) -> Vec<u64> {
        let mut mask = Mask::none(self.ids);
        self.grammar.allowed(&mut mask);
        mask.words().to_vec()
    }

    fn accept(&mut self, id: u32) {
        self.grammar.accept(id);
    }

    fn ends(&self, id: u32) -> bool {
        id == self.end
    }
}

/// The model after a prompt.
struct Reader<'a> {
    net: &'a SkeletonModel,
    weights: &'a Weights,
    cache: Cache,
}

fn floats(scores: &Tensor) -> Vec<Vec<f32>> {
    let width = scores.size()[1] as usize;
    let flat = Vec::<f32>::try_from(scores.to_kind(Kind::Float).contiguous().view([-1])).unwrap_or_default();
    flat.chunks(width).map(<[f32]>::to_vec).collect()
}

impl Decoder for Reader<'_> {
    fn next(&mut self, ids: &[u32]) -> Vec<Vec<f32>> {
        let ids: Vec<i64> = ids.iter().map(|&id| i64::from(id)).collect();
        let device = self.weights.tensors()[0].device();
        let ids = Tensor::from_slice(&ids).view([ids.len() as i64, 1]).to_device(device);
        floats(&self.net.next(self.weights, &ids, &mut self.cache))
    }

    fn select(&mut self, rows: &[usize]) {
        self.cache.select(&rows.iter().map(|&r| r as i64).collect::<Vec<_>>());
    }
}

/// A skeleton that was drawn.
pub struct Drawn {
    /// The sequence.
    pub ids: Vec<u32>,
    /// What it says, in the cube.
    pub decoded: Result<Decoded, DecodeFault>,
}

/// Of every `each` draws, which are for one mesh, the one whose skeleton the others agree with most; the first where none
/// is a skeleton.
pub(crate) fn agreed<D>(mut drawn: Vec<D>, each: usize, said: impl Fn(&D) -> Option<&Decoded>) -> Vec<D> {
    let mut out = Vec::with_capacity(drawn.len() / each);
    while !drawn.is_empty() {
        let rest = drawn.split_off(each);
        let taken = most_agreed(drawn.iter().map(&said)).unwrap_or(0);
        out.push(drawn.swap_remove(taken));
        drawn = rest;
    }
    out
}

/// The place of the draw for one mesh whose skeleton the others agree with most.
pub(crate) fn most_agreed<'a>(drawn: impl Iterator<Item = Option<&'a Decoded>>) -> Option<usize> {
    let whole = drawn.enumerate().filter_map(|(k, decoded)| Some((k, joints(decoded?))));
    let (places, skeletons): (Vec<usize>, Vec<_>) = whole.unzip();
    consensus(&skeletons).map(|at| places[at])
}

impl SkeletonTask {
    /// What every skeleton begins with.
    pub(crate) fn start(&self) -> Vec<u32> {
        let vocabulary = self.tokenizer.vocabulary();
        let class = vocabulary.class_named(&self.config.class).map(|number| vocabulary.class(number));
        std::iter::once(vocabulary.bos()).chain(class).collect()
    }

    /// The grammar of skeletons of so many tokens at most.
    pub(crate) fn grammar(&self, tokens: usize) -> Grammar {
        let c = &self.config;
        Grammar::new(&self.tokenizer, Limits { tokens, ..c.limits }, c.eval.parents)
    }

    /// Draws a skeleton for each rig's mesh; `keys` seed its points and its draws, so that a rig's skeleton does
    /// not depend on those beside it.
    pub fn draw(&self, w: &Weights, rigs: &[(&Rig, u64)]) -> Vec<Drawn> {
        let c = &self.config;
        let mut streams = streams(c.eval.seed, rigs.iter().map(|(_, key)| *key), 1);
        self.draw_with(w, &self.prefix_of(w, &self.shapes_of(rigs)), &mut streams, &c.eval.generate)
    }

    /// As [`Self::draw`], but with `eval.consensus` several are sampled for each rig, and the one is given that the
    /// others agree with most.
    pub fn draw_agreed(&self, w: &Weights, rigs: &[(&Rig, u64)]) -> Vec<Drawn> {
        let (c, each) = (&self.config, self.config.eval.consensus);
        if each == 1 {
            return self.draw(w, rigs);
        }
        let mut streams = streams(c.eval.seed, rigs.iter().map(|(_, key)| *key), each);
        let prefix = self.prefix_of(w, &self.shapes_of(rigs)).repeat_interleave_self_int(each as i64, 0, None);
        let how = GenerateConfig { sample: true, ..c.eval.generate.clone() };
        agreed(self.draw_with(w, &prefix, &mut streams, &how), each, |drawn| drawn.decoded.as_ref().ok())
    }

    /// The shapes of rigs, as the decoder's prefix is made of.
    fn shapes_of(&self, rigs: &[(&Rig, u64)]) -> Batch {
        let (c, mut batch) = (&self.config, Batch::default());
        for (rig, key) in rigs {
            let mut random = stream(c.eval.seed, "skeleton evaluation", &[*key]);
            let sampler = CloudSampler::new(rig.mesh(), &c.sampling.cloud);
            shape(&c.sampling.cloud, &c.model.shape, &sampler, &mut random, &mut batch);
        }
        batch
    }

    /// What the decoder reads of each shape of a batch before its skeleton [b, p, d].
    pub fn prefix_of(&self, w: &Weights, batch: &Batch) -> Tensor {
        let _no_grad = tch::no_grad_guard();
        let (cloud, picks) = shape_of(&self.config, batch, self.device);
        self.net.condition(w, &cloud, &picks)
    }

    /// Draws a skeleton after each prefix [b, p, d], each by its stream.
    pub fn draw_with(
        &self,
        w: &Weights,
        prefix: &Tensor,
        streams: &mut [Stream],
        generate: &GenerateConfig,
    ) -> Vec<Drawn> {
        self.draw_told(w, prefix, streams, generate, None)
    }

    /// As [`Self::draw_with`]; `likelihood` is given the sum of log-probabilities of what was drawn of each, and of how
    /// many tokens.
    pub(crate) fn draw_told(
        &self,
        w: &Weights,
        prefix: &Tensor,
        streams: &mut [Stream],
        generate: &GenerateConfig,
        mut likelihood: Option<&mut [(f64, usize)]>,
    ) -> Vec<Drawn> {
        let _no_grad = tch::no_grad_guard();
        let vocabulary = self.tokenizer.vocabulary();
        // The grammar ends each sequence before the tokens do.
        let tokens = self.config.limits.tokens.min(generate.tokens.saturating_add(1));
        let (mut grammar, start) = (self.grammar(tokens), self.start());
        start.iter().for_each(|&id| grammar.accept(id));
        let strict = Strict { grammar, ids: vocabulary.len(), end: vocabulary.eos() };
        let mut config = generate.clone();
        config.tokens = tokens - start.len();
        let cache = self.net.start(w, prefix, tokens as i64);
        let mut reader = Reader { net: &self.net, weights: w, cache };
        let mut first = Vec::new();
        for &id in &start {
            first = reader.next(&vec![id; streams.len()]);
        }
        let grammars = vec![strict; streams.len()];
        let mut choose = chooser(&config, streams);
        let all = rows(&mut reader, first, grammars, &config, |row, step, scores| {
            let id = choose(row, step, scores);
            if let Some(own) = likelihood.as_deref_mut().map(|all| &mut all[row]) {
                let mut scores = scores.to_vec();
                log_softmax(&mut scores);
                *own = (own.0 + f64::from(scores[id as usize]), own.1 + 1);
            }
            id
        });
        let whole = |own: Vec<u32>| {
            let ids: Vec<u32> = start.iter().copied().chain(own).collect();
            Drawn { decoded: self.tokenizer.decode(&ids), ids }
        };
        all.into_iter().map(whole).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain(length: f32) -> Decoded {
        let joints = (0..3).map(|k| [0.0, length * k as f32 / 2.0, 0.0]).collect();
        let names = (0..3).map(|k| format!("bone_{k}")).collect();
        Decoded { joints, parents: vec![None, Some(0), Some(1)], names, class: None, parts: Vec::new() }
    }

    #[test]
    fn of_the_draws_for_each_mesh_the_medoid_is_given() {
        let of = |lengths: [f32; 3]| lengths.map(|l| (l > 0.0).then(|| chain(l)));
        // The middle one; the only one; none at all.
        let drawn = [of([0.1, 0.9, 0.5]), of([0.0, 0.0, 0.7]), of([0.0; 3])].concat();
        let taken = agreed(drawn, 3, |d| d.as_ref());
        assert_eq!(taken, [Some(chain(0.5)), Some(chain(0.7)), None]);
    }
}
