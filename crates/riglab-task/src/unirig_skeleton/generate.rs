//! Skeletons drawn from the model.

use riglab_core::Mesh;
use riglab_geom::CloudSampler;
use riglab_nn::decoder::Cache;
use riglab_nn::generate::{
    Decoder, GenerateConfig, Grammar as Rules, beam_chooser, beams, best_of, chooser, likely_rows, log_softmax,
};
use riglab_nn::params::Weights;
use riglab_nn::skeleton::SkeletonModel;
use riglab_random::{Stream, stream};
use riglab_token::{DecodeFault, Decoded, Grammar, Limits, Mask, Tokenizer};
use tch::{Device, Kind, Tensor};

use super::agree::{Agreed, Chosen};
use super::batch::{Batch, shape};
use super::{SkeletonTaskConfig, shape_of};

/// What draws for assets are seeded by: one a key, or `each` of several.
pub(crate) fn streams(seed: u64, keys: impl Iterator<Item = u64>, each: usize) -> Vec<Stream> {
    let of = |index: &[u64]| stream(seed, "skeleton draws", index);
    if each == 1 {
        return keys.map(|key| of(&[key])).collect();
    }
    keys.flat_map(|key| (0..each as u64).map(move |k| [key, k])).map(|index| of(&index)).collect()
}

/// Which prefix each draw is after, of prefixes [b, p, d]: all after one, or each after its own.
pub(crate) fn each(prefix: &Tensor, draws: usize) -> Vec<usize> {
    if prefix.size()[0] == 1 { vec![0; draws] } else { (0..draws).collect() }
}

/// The same of prefixes [s · b, p, d], each of which is drawn after as often as its place among the s clouds of a mesh says.
fn shared(prefix: &Tensor, shares: &[usize]) -> Vec<usize> {
    let rows = (0..prefix.size()[0] as usize).zip(shares.iter().cycle());
    rows.flat_map(|(row, &n)| std::iter::repeat_n(row, n)).collect()
}

/// Those prefixes alone that are drawn after, and which of them each draw is after.
fn needed(prefix: &Tensor, of: &[usize]) -> (Tensor, Vec<usize>) {
    let mut rows = of.to_vec();
    rows.sort_unstable();
    rows.dedup();
    let places = of.iter().map(|row| rows.partition_point(|other| other < row)).collect();
    let rows: Vec<i64> = rows.into_iter().map(|row| row as i64).collect();
    (prefix.index_select(0, &Tensor::from_slice(&rows).to_device(prefix.device())), places)
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
pub struct SkeletonSample {
    /// The sequence.
    pub ids: Vec<u32>,
    /// What it says, in the cube.
    pub decoded: Result<Decoded, DecodeFault>,
}

/// How likely a draw is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Likely {
    /// The sum of log-probabilities that the network has for what was drawn, within the grammar: draws are compared by it,
    /// whatever their temperature and filters.
    pub sum: f64,
    /// The same sum of the distribution that it was drawn from: after temperature, filters and penalty.
    pub said: f64,
    /// Of how many tokens.
    pub tokens: usize,
}

impl Likely {
    /// The mean log-probability of a token to the network.
    pub fn mean(&self) -> f64 {
        self.sum / self.tokens.max(1) as f64
    }
}

/// What draws skeletons: a network with what is to be known of its sequences.
#[derive(Clone, Copy)]
pub struct Drawer<'a> {
    /// Limits, and how is drawn.
    pub config: &'a SkeletonTaskConfig,
    /// What sequences say.
    pub tokenizer: &'a Tokenizer,
    /// The network.
    pub net: &'a SkeletonModel,
    /// Where it computes.
    pub device: Device,
}

impl Drawer<'_> {
    /// What every skeleton begins with.
    pub(crate) fn start(&self) -> Vec<u32> {
        let vocabulary = self.tokenizer.vocabulary();
        let class = vocabulary.class_named(&self.config.class).map(|number| vocabulary.class(number));
        std::iter::once(vocabulary.bos()).chain(class).collect()
    }

    /// The grammar of skeletons of so many tokens at most.
    pub(crate) fn grammar(&self, tokens: usize) -> Grammar {
        let c = self.config;
        Grammar::new(self.tokenizer, Limits { tokens, ..c.limits }, c.eval.parents)
    }

    /// Draws a skeleton for each mesh in the cube; keys seed its points and its draws, so that a mesh's skeleton does not
    /// depend on those beside it.
    ///
    /// # Errors
    /// A sentence: the network diverged. So all of these.
    pub fn draw(&self, w: &Weights, meshes: &[(&Mesh, u64)]) -> Result<Vec<SkeletonSample>, String> {
        self.draw_as(w, meshes, &self.config.eval.generate)
    }

    /// As [`Self::draw`], but how is told.
    ///
    /// # Errors
    /// As [`Self::draw`].
    pub fn draw_as(
        &self,
        w: &Weights,
        meshes: &[(&Mesh, u64)],
        how: &GenerateConfig,
    ) -> Result<Vec<SkeletonSample>, String> {
        let mut streams = streams(self.config.eval.seed, meshes.iter().map(|(_, key)| *key), 1);
        self.draw_with(w, &self.prefix_of(w, &self.shapes_of(meshes)), &mut streams, how)
    }

    /// As [`Self::draw`], but with `eval.consensus` several are sampled for each mesh, and the one is given that the
    /// others agree with most, refined as `eval.refine` says.
    pub(crate) fn draw_agreed(
        &self,
        w: &Weights,
        meshes: &[(&Mesh, u64)],
    ) -> Result<Vec<Chosen<SkeletonSample>>, String> {
        let each = self.config.eval.agreement().draws;
        if each == 1 {
            let alone = |drawn| Chosen { place: 0, apart: None, drawn };
            return Ok(self.draw(w, meshes)?.into_iter().map(alone).collect());
        }
        let mut drawn = self.draw_several(w, meshes, None)?;
        let mut out = Vec::with_capacity(meshes.len());
        while !drawn.is_empty() {
            let rest = drawn.split_off(each);
            out.push(self.agreed(drawn));
            drawn = rest;
        }
        Ok(out)
    }

    /// `eval.consensus` skeletons for each mesh, those of one cloud after those of another; `likelihood` as of
    /// [`Self::draw_told`].
    pub(crate) fn draw_several(
        &self,
        w: &Weights,
        meshes: &[(&Mesh, u64)],
        likelihood: Option<&mut [Likely]>,
    ) -> Result<Vec<SkeletonSample>, String> {
        let (c, agreement) = (self.config, self.config.eval.agreement());
        let (shares, mut shapes) = (agreement.shares(), Batch::default());
        for (mesh, key) in meshes {
            let how = (&c.eval_cloud(), &c.model.shape);
            agreement.shapes(how, mesh, (c.eval.seed, *key), shares.len(), &mut shapes);
        }
        let prefix = self.prefix_of(w, &shapes);
        let mut streams = streams(c.eval.seed, meshes.iter().map(|(_, key)| *key), agreement.draws);
        let how = GenerateConfig { sample: true, ..c.eval.generate.clone() };
        self.draw_told(w, (&prefix, &shared(&prefix, &shares)), &mut streams, &how, likelihood)
    }

    /// Of the draws for a mesh the one that the others agree with most; the first where none is a skeleton.
    pub(crate) fn agreed(&self, mut drawn: Vec<SkeletonSample>) -> Chosen<SkeletonSample> {
        let decoded = drawn.iter().map(|d| d.decoded.as_ref().ok());
        let fits = |ids: &[u32]| ids.len() <= self.config.limits.tokens;
        let agreed = self.config.eval.agreement().of(self.tokenizer, decoded, None, fits);
        let Agreed { place, apart, refined } = agreed.unwrap_or_default();
        let drawn = match refined {
            Some((ids, decoded)) => SkeletonSample { ids, decoded: Ok(decoded) },
            None => drawn.swap_remove(place),
        };
        Chosen { place, apart, drawn }
    }

    /// The shapes of meshes, as the decoder's prefix is made of.
    pub(crate) fn shapes_of(&self, meshes: &[(&Mesh, u64)]) -> Batch {
        let (c, mut batch) = (self.config, Batch::default());
        for (mesh, key) in meshes {
            let mut random = stream(c.eval.seed, "skeleton evaluation", &[*key]);
            let cloud = c.eval_cloud();
            let sampler = CloudSampler::new(mesh, &cloud);
            shape(&cloud, &c.model.shape, &sampler, &mut random, &mut batch);
        }
        batch
    }

    /// What the decoder reads of each shape of a batch before its skeleton [b, p, d].
    pub fn prefix_of(&self, w: &Weights, batch: &Batch) -> Tensor {
        let _no_grad = tch::no_grad_guard();
        let (cloud, picks) = shape_of(self.config, batch, self.device);
        self.net.condition(w, &cloud, &picks)
    }

    /// Draws a skeleton by each stream, after a prefix of its own of [b, p, d], or all after the only one.
    ///
    /// # Errors
    /// As [`Self::draw`].
    pub fn draw_with(
        &self,
        w: &Weights,
        prefix: &Tensor,
        streams: &mut [Stream],
        generate: &GenerateConfig,
    ) -> Result<Vec<SkeletonSample>, String> {
        self.draw_told(w, (prefix, &each(prefix, streams.len())), streams, generate, None)
    }

    /// As [`Self::draw_with`], each after the prefix that `of` names; `likelihood` is given how likely each
    /// draw is.
    pub(crate) fn draw_told(
        &self,
        w: &Weights,
        (prefix, of): (&Tensor, &[usize]),
        streams: &mut [Stream],
        generate: &GenerateConfig,
        mut likelihood: Option<&mut [Likely]>,
    ) -> Result<Vec<SkeletonSample>, String> {
        let _no_grad = tch::no_grad_guard();
        let vocabulary = self.tokenizer.vocabulary();
        // The grammar ends each sequence before the tokens do.
        let tokens = self.config.limits.tokens.min(generate.tokens.saturating_add(1));
        let (mut grammar, start) = (self.grammar(tokens), self.start());
        start.iter().for_each(|&id| grammar.accept(id));
        let strict = Strict { grammar, ids: vocabulary.len(), end: vocabulary.eos() };
        let mut config = generate.clone();
        config.tokens = tokens - start.len();
        let whole = |own: Vec<u32>| {
            let ids: Vec<u32> = start.iter().copied().chain(own).collect();
            SkeletonSample { decoded: self.tokenizer.decode(&ids), ids }
        };
        if config.beams > 1 {
            let mut all = Vec::with_capacity(streams.len());
            for (row, random) in streams.iter_mut().enumerate() {
                let own = prefix.narrow(0, of[row] as i64, 1);
                let mut cache = self.net.start(w, &own, tokens as i64);
                cache.select(&vec![0; config.beams]);
                let mut reader = Reader { net: self.net, weights: w, cache };
                let mut first = Vec::new();
                for &id in &start {
                    first = reader.next(&vec![id; config.beams]);
                }
                let first = first.first().ok_or("a sequence begins with a token")?;
                let best = best_of(beams(&mut reader, first, &strict, &config, beam_chooser(&config, random))?);
                if let Some(all) = likelihood.as_deref_mut() {
                    let tokens = best.ids.len();
                    all[row] = Likely { sum: best.likelihood, said: f64::from(best.score) * tokens as f64, tokens };
                }
                all.push(whole(best.ids));
            }
            return Ok(all);
        }
        let most = self.rows_at_once(w, prefix, tokens);
        if streams.len() > most {
            return self.draw_in_runs(most, w, (prefix, of), streams, generate, likelihood);
        }
        // What several are drawn after is read once.
        let mut cache = self.net.start(w, prefix, tokens as i64);
        cache.select(&of.iter().map(|&row| row as i64).collect::<Vec<_>>());
        let mut reader = Reader { net: self.net, weights: w, cache };
        let mut first = Vec::new();
        for &id in &start {
            first = reader.next(&vec![id; streams.len()]);
        }
        let grammars = vec![strict; streams.len()];
        let mut choose = chooser(&config, streams);
        // Where nothing is changed, what is drawn from is the network's own.
        let changed = config.changes();
        let mut sums = vec![0.0; likelihood.as_ref().map_or(0, |all| all.len())];
        let told = (changed && likelihood.is_some()).then_some(&mut sums[..]);
        let choose = |row: usize, step: usize, scores: &[f32]| {
            let id = choose(row, step, scores);
            if let Some(own) = likelihood.as_deref_mut().map(|all| &mut all[row]) {
                let mut scores = scores.to_vec();
                log_softmax(&mut scores);
                (own.said, own.tokens) = (own.said + f64::from(scores[id as usize]), own.tokens + 1);
            }
            id
        };
        let all = likely_rows(&mut reader, first, grammars, &config, choose, told)?;
        for (own, sum) in likelihood.into_iter().flatten().zip(sums) {
            own.sum = if changed { sum } else { own.said };
        }
        Ok(all.into_iter().map(whole).collect())
    }

    /// As [`Self::draw_told`], so many at a time.
    fn draw_in_runs(
        &self,
        most: usize,
        w: &Weights,
        (prefix, of): (&Tensor, &[usize]),
        streams: &mut [Stream],
        generate: &GenerateConfig,
        mut likelihood: Option<&mut [Likely]>,
    ) -> Result<Vec<SkeletonSample>, String> {
        let mut all = Vec::with_capacity(streams.len());
        for (streams, of) in streams.chunks_mut(most).zip(of.chunks(most)) {
            let (own, of) = needed(prefix, of);
            let told = likelihood.as_deref_mut().map(|told| &mut told[all.len()..][..streams.len()]);
            all.extend(self.draw_told(w, (&own, &of), streams, generate, told)?);
        }
        Ok(all)
    }

    /// How many rows of so many tokens behind a prefix are drawn at once.
    fn rows_at_once(&self, w: &Weights, prefix: &Tensor, tokens: usize) -> usize {
        let decoder = &self.config.model.decoder;
        let length = prefix.size()[1] as usize + tokens;
        rows_at_once(self.config.eval.rows, 2 * decoder.layers * decoder.width * length * w.kind().elt_size_in_bytes())
    }
}

/// How many rows are drawn at once where `rows` are asked for, and each has so many bytes of keys and values: more of small
/// models, whose rows cost next to nothing beside each other.
pub(crate) fn rows_at_once(rows: usize, bytes: usize) -> usize {
    /// Bytes of keys and values that any machine has.
    const CACHE: usize = 1 << 30;
    rows.max(CACHE / bytes.max(1)).max(1)
}

#[cfg(test)]
mod tests {
    use riglab_nn::params::Params;

    use super::*;
    use crate::tokenrig::testing::tetrahedron;
    use crate::unirig_skeleton::SkeletonTask;

    /// A model that has learnt nothing, of the smallest sizes that are drawn from a token at a time.
    fn untrained() -> (SkeletonTaskConfig, SkeletonModel, Params) {
        let mut config = SkeletonTaskConfig::default();
        let (shape, decoder) = (&mut config.model.shape, &mut config.model.decoder);
        (shape.tokens, shape.drawn, shape.layers, shape.width, shape.heads) = (20, 2, 1, 16, 2);
        (decoder.width, decoder.layers, decoder.heads, decoder.ffn, decoder.init_std) = (16, 2, 2, 32, 0.3);
        config.sampling.cloud.points = 64;
        config.limits = Limits { joints: 12, tokens: 64 };
        let (net, params) = SkeletonTask::network(&config, Device::Cpu).unwrap();
        (config, net, params)
    }

    #[test]
    fn draws_after_one_prefix_are_those_after_one_each() {
        let ((config, net, params), mesh) = (untrained(), tetrahedron());
        let tokenizer = Tokenizer::new(config.tokenizer.clone());
        let drawer = Drawer { config: &config, tokenizer: &tokenizer, net: &net, device: Device::Cpu };
        let w = params.weights();
        let prefix = drawer.prefix_of(w, &drawer.shapes_of(&[(&mesh, 0), (&mesh, 1), (&mesh, 2)]));
        let how = GenerateConfig { sample: true, ..GenerateConfig::default() };
        let draw = |most: usize, prefix: &Tensor, of: &[usize]| {
            let mut streams = streams(0, 0..of.len() as u64, 1);
            let mut told = vec![Likely::default(); of.len()];
            let drawn = drawer.draw_in_runs(most, w, (prefix, of), &mut streams, &how, Some(&mut told)).unwrap();
            (drawn.into_iter().map(|d| d.ids).collect::<Vec<_>>(), told)
        };
        for of in [vec![1; 5], shared(&prefix, &[3, 1, 2]), vec![0, 1, 2]] {
            let rows: Vec<i64> = of.iter().map(|&row| row as i64).collect();
            let each = prefix.index_select(0, &Tensor::from_slice(&rows));
            let (ids, likelihood) = draw(of.len(), &each, &(0..of.len()).collect::<Vec<_>>());
            for most in [2, of.len()] {
                let (own, told) = draw(most, &prefix, &of);
                assert_eq!(own, ids, "{of:?}, {most} at a time");
                let same = |(a, b): (&Likely, &Likely)| (a.sum - b.sum).abs() < 1e-3 && a.tokens == b.tokens;
                assert!(told.iter().zip(&likelihood).all(same), "{told:?}");
                assert!(told.iter().all(|own| (own.said - own.sum).abs() < 1e-3), "nothing was changed: {told:?}");
            }
        }
        assert_eq!(each(&prefix.narrow(0, 0, 1), 2), [0, 0]);
    }

    #[test]
    fn meshes_are_seen_as_evaluations_are_told() {
        let ((mut config, net, params), mesh) = (untrained(), tetrahedron());
        let tokenizer = Tokenizer::new(config.tokenizer.clone());
        (config.eval.points, config.eval.vertices) = (96, 3);
        let drawer = Drawer { config: &config, tokenizer: &tokenizer, net: &net, device: Device::Cpu };
        let seen = drawer.shapes_of(&[(&mesh, 0), (&mesh, 1)]);
        let corners = seen.cloud.chunks(6).filter(|row| mesh.positions().contains(&[row[0], row[1], row[2]])).count();
        assert_eq!((seen.cloud.len(), corners), (2 * 96 * 6, 2 * 3));
        assert_eq!(drawer.prefix_of(params.weights(), &seen).size()[0], 2);
        assert!(drawer.draw_several(params.weights(), &[(&mesh, 0)], None).is_ok());
    }

    #[test]
    fn rows_are_counted_with_what_they_are_drawn_after() {
        let (config, net, params) = untrained();
        let tokenizer = Tokenizer::new(config.tokenizer.clone());
        let drawer = Drawer { config: &config, tokenizer: &tokenizer, net: &net, device: Device::Cpu };
        let prefix = Tensor::zeros([1, 20, 16], (Kind::Float, Device::Cpu));
        // Keys and values of two layers.
        let row = 2 * 2 * 16 * (20 + 44) * 4;
        assert_eq!(drawer.rows_at_once(params.weights(), &prefix, 44), (1 << 30) / row);
    }
}
