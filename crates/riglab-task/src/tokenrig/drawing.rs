//! Drawing rigs: sequences under the grammar of whole rigs, and what they say.

use std::sync::{Mutex, PoisonError};

use riglab_nn::decoder::QwenConfig;
use riglab_nn::generate::{
    GenerateConfig, Grammar as Rules, argmax, beam_chooser, beams, best_of, draw, likely_rows, shares,
};
use riglab_nn::params::Weights;
use riglab_nn::tokenrig::{JointTold, JointsOf, Reader};
use riglab_random::{Stream, stream};
use riglab_token::{DecodeFault, Decoded, Grammar, Limits, Mask, RigGrammar, SkinIds, SkinRule};
use tch::Kind;

use super::Rigger;
use super::condition::Condition;
use super::skin::Codes;
use super::told::Sight;
use crate::unirig_skeleton::agree::{Agreed, Agreement, Chosen};
use crate::unirig_skeleton::generate::rows_at_once;

/// A rig as it was drawn, in the cube.
#[derive(Clone, Debug)]
pub struct RigSample {
    /// Ids of the skeleton, with its end.
    pub skeleton: Vec<u32>,
    /// What they say.
    pub decoded: Result<Decoded, DecodeFault>,
    /// Of each joint its codes; `None` for all where the skeleton alone was drawn.
    pub codes: Codes,
    /// What each joint's codes were told; none where the skeleton alone was drawn.
    pub joints: Vec<JointTold>,
    /// The whole sequence, or that of the skeleton alone, prompt and end with it, in ids of the network.
    pub ids: Vec<i64>,
    /// The sum of log-probabilities that the network has for what was drawn, within the grammar, and of how many numbers:
    /// draws are compared by it, whatever their temperature and filters.
    pub likelihood: (f64, usize),
    /// The same sum of the distribution that it was drawn from: after temperature, filters and penalty.
    pub said: f64,
}

/// Where drawing ends.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Until {
    Skeleton,
    Whole,
}

/// What is drawn: after which prompts, which are of one length, and of which shapes, one or as many as there are prompts.
#[derive(Clone, Copy)]
struct Draws<'a> {
    until: Until,
    w: &'a Weights,
    seen: &'a Condition,
    prompts: &'a [Vec<u32>],
    how: &'a GenerateConfig,
}

/// The grammar of whole rigs, for a decoder.
#[derive(Clone)]
pub(crate) struct Strict {
    grammar: RigGrammar<Grammar>,
    end: u32,
}

impl Strict {
    /// Writes which numbers may follow.
    pub fn write_allowed(&self, mask: &mut Mask) {
        self.grammar.allowed(mask);
    }

    /// Takes a number that may follow.
    pub fn take(&mut self, number: u32) {
        self.grammar.accept(number);
    }
}

impl Rules for Strict {
    fn allowed(&self) -> Vec<u64> {
        let mut mask = Mask::none(self.grammar.len());
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

impl Rigger {
    /// Draws a sequence after each prompt; all prompts are of one length, and `seen` is of one shape or of as many as there
    /// are prompts. `streams`: one a prompt.
    ///
    /// # Errors
    /// When a prompt is no beginning of a sequence, or a mesh is missing that codes are told of.
    pub fn draw(
        &self,
        w: &Weights,
        seen: &Condition,
        prompts: &[Vec<u32>],
        how: &GenerateConfig,
        streams: &mut [Stream],
    ) -> Result<Vec<RigSample>, String> {
        self.draw_until(Draws { until: Until::Whole, w, seen, prompts, how }, streams)
    }

    /// Skeletons without codes of each shape, as many as its share says, the shares in turn, whose number divides that of the
    /// shapes: one as `how` says, that of the likeliest tokens unless it samples, then others that are sampled. `streams`:
    /// one a skeleton.
    ///
    /// # Errors
    /// As [`Self::draw`].
    pub fn draw_skeletons(
        &self,
        w: &Weights,
        seen: &Condition,
        (prompt, shares): (&[u32], &[usize]),
        how: &GenerateConfig,
        streams: &mut [Stream],
    ) -> Result<Vec<RigSample>, String> {
        let shapes = seen.rows();
        let (mut firsts, mut others): (Vec<Stream>, Vec<Stream>) = (Vec::new(), Vec::new());
        let (mut left, shares) = (&*streams, shares.iter().copied().cycle().take(shapes));
        for share in shares.clone() {
            let (own, rest) = left.split_at(share);
            firsts.extend_from_slice(&own[..1]);
            others.extend_from_slice(&own[1..]);
            left = rest;
        }
        let prompts = vec![prompt.to_vec(); firsts.len().max(others.len())];
        let asked = Draws { until: Until::Skeleton, w, seen, prompts: &prompts[..firsts.len()], how };
        let firsts = self.draw_until(asked, &mut firsts)?;
        if others.is_empty() {
            return Ok(firsts);
        }
        let wide = match shapes {
            1 => seen.first(1),
            _ => {
                let rows = shares.clone().enumerate().flat_map(|(row, n)| std::iter::repeat_n(row, n - 1));
                seen.some(&rows.collect::<Vec<_>>())
            }
        };
        let how = GenerateConfig { sample: true, ..how.clone() };
        let asked = Draws { seen: &wide, prompts: &prompts[..others.len()], how: &how, ..asked };
        let mut others = self.draw_until(asked, &mut others)?.into_iter();
        let mut all = Vec::with_capacity(streams.len());
        for (first, share) in firsts.into_iter().zip(shares) {
            all.push(first);
            all.extend(others.by_ref().take(share - 1));
        }
        Ok(all)
    }

    /// A skeleton of one shape that was drawn alone, with the likeliest codes for it.
    ///
    /// # Errors
    /// As [`Self::draw`].
    pub fn with_codes(&self, w: &Weights, seen: &Condition, drawn: RigSample) -> Result<RigSample, String> {
        if drawn.decoded.is_err() {
            return Ok(drawn);
        }
        let how = GenerateConfig { sample: false, ..self.config.eval.generate.clone() };
        let streams = &mut [stream(self.config.eval.seed, "codes", &[])];
        let mut whole = self.draw(w, seen, std::slice::from_ref(&drawn.skeleton), &how, streams)?;
        let Some(whole) = whole.pop() else { return Ok(drawn) };
        let ((a, m), (b, n)) = (drawn.likelihood, whole.likelihood);
        Ok(RigSample { likelihood: (a + b, m + n), said: drawn.said + whole.said, ..whole })
    }

    /// The skeleton of one mesh that its draws agree on, refined, and its own image in the mirror at x = `plane` where there is
    /// one, with the likeliest codes for it after that one shape, and which of the draws it is; the first as it is where none
    /// is a skeleton.
    ///
    /// # Errors
    /// As [`Self::draw`].
    pub(crate) fn agreed(
        &self,
        w: &Weights,
        seen: &Condition,
        (agreement, plane): (&Agreement, Option<f64>),
        drawn: Vec<RigSample>,
    ) -> Result<Chosen<RigSample>, String> {
        self.agreed_of(w, seen, (agreement, plane), drawn, |_| true)
    }

    /// As [`Self::agreed`], of the draws that `may` be taken and have a say.
    pub(super) fn agreed_of(
        &self,
        w: &Weights,
        seen: &Condition,
        (agreement, plane): (&Agreement, Option<f64>),
        mut drawn: Vec<RigSample>,
        may: impl Fn(usize) -> bool,
    ) -> Result<Chosen<RigSample>, String> {
        let decoded = drawn.iter().enumerate().map(|(at, d)| d.decoded.as_ref().ok().filter(|_| may(at)));
        let agreed = agreement.of(&self.tokenizer, decoded, plane, |ids| self.may_begin(ids));
        let Agreed { place, apart, refined } = agreed.unwrap_or_default();
        let mut taken = drawn.swap_remove(place);
        if let Some((skeleton, decoded)) = refined {
            let ids = skeleton.iter().map(|&id| i64::from(id)).collect();
            taken = RigSample { skeleton, decoded: Ok(decoded), ids, ..taken };
        }
        Ok(Chosen { place, apart, drawn: self.with_codes(w, seen, taken)? })
    }

    /// Whether a skeleton may stand at the beginning of a sequence.
    pub(super) fn may_begin(&self, ids: &[u32]) -> bool {
        ids.len() <= self.config.limits.tokens && self.after(self.grammar(self.config.limits.tokens), ids).is_some()
    }

    /// The grammar after a prompt; `None` where no sequence begins so.
    fn after(&self, mut strict: Strict, prompt: &[u32]) -> Option<Strict> {
        let mut mask = Mask::none(self.net.layout().drawn());
        for &id in prompt {
            strict.grammar.allowed(&mut mask);
            if !mask.allows(id) {
                return None;
            }
            strict.grammar.accept(id);
        }
        Some(strict)
    }

    /// Whether a sequence that is drawn so may begin with this.
    pub(super) fn draws_after(&self, prompt: &[u32], how: &GenerateConfig) -> bool {
        self.after(self.grammar_after(prompt.len(), how), prompt).is_some()
    }

    /// The grammar of what is drawn after a prompt of so many tokens.
    fn grammar_after(&self, prompt: usize, how: &GenerateConfig) -> Strict {
        self.grammar(self.config.limits.tokens.min(how.tokens.saturating_add(1)).max(prompt))
    }

    fn draw_until(&self, asked: Draws<'_>, streams: &mut [Stream]) -> Result<Vec<RigSample>, String> {
        let most = self.most_at_once(asked.w, asked.seen);
        // Beams are of one row after another.
        if asked.how.beams > 1 || asked.prompts.len() <= most {
            return self.draw_at_once(asked, streams);
        }
        self.draw_in_runs(most, asked, streams)
    }

    /// How many rows are drawn at once.
    fn most_at_once(&self, w: &Weights, seen: &Condition) -> usize {
        let c = &self.config;
        let longest = seen.prefix().size()[1] as usize + c.longest();
        rows_at_once(c.eval.rows, bytes_of_row(&c.model.decoder, longest, w.kind()))
    }

    /// So many at a time.
    fn draw_in_runs(&self, most: usize, asked: Draws<'_>, streams: &mut [Stream]) -> Result<Vec<RigSample>, String> {
        let (mut all, seen) = (Vec::with_capacity(asked.prompts.len()), asked.seen);
        for (run, (streams, prompts)) in streams.chunks_mut(most).zip(asked.prompts.chunks(most)).enumerate() {
            let own: Vec<usize> = (run * most..).take(prompts.len()).collect();
            let seen = if seen.rows() == 1 { seen.first(1) } else { seen.some(&own) };
            all.extend(self.draw_at_once(Draws { seen: &seen, prompts, ..asked }, streams)?);
        }
        Ok(all)
    }

    fn draw_at_once(&self, asked: Draws<'_>, streams: &mut [Stream]) -> Result<Vec<RigSample>, String> {
        let Draws { until, w, seen, prompts, how } = asked;
        let _no_grad = tch::no_grad_guard();
        let (c, vocabulary) = (&self.config, self.tokenizer.vocabulary());
        let mut strict = self.grammar_after(prompts.first().map_or(0, Vec::len), how);
        if until == Until::Skeleton {
            strict.end = vocabulary.eos();
        }
        let grammars: Option<Vec<Strict>> = prompts.iter().map(|prompt| self.after(strict.clone(), prompt)).collect();
        let grammars = grammars.ok_or("the given skeleton is no beginning of a sequence of this model")?;
        if until == Until::Whole && Sight::asked(&c.model) && seen.sight(0).is_none() {
            return Err("codes of this model are told of the mesh at their joints: give the meshes".into());
        }
        let (teller, tokenizer) = (self.teller(), &self.tokenizer);
        let sights: Vec<Option<&Sight>> = (0..prompts.len()).map(|row| seen.sight(row)).collect();
        let joints = |row: usize, ids: &[u32]| {
            let sight = sights[row];
            let make = || tokenizer.decode(ids).map_or_else(|_| Vec::new(), |d| teller.joints(&d, sight));
            match sight {
                Some(sight) => sight.once(ids, make),
                None => make(),
            }
        };
        // A whole sequence begins with the prompt.
        let begun = prompts.iter().map(Vec::len).min().unwrap_or(0);
        let room = c.longest().saturating_sub(begun).max(1);
        if how.beams > 1 {
            let how = GenerateConfig { tokens: room, ..how.clone() };
            let each = prompts.iter().zip(&grammars).zip(streams).enumerate();
            return each
                .map(|(row, ((prompt, grammar), random))| {
                    let own = |_: usize, ids: &[u32]| joints(row, ids);
                    let shape = if seen.rows() == 1 { 0 } else { row };
                    self.beamed(w, &seen.some(&[shape]), (prompt, grammar), &how, random, &own)
                })
                .collect();
        }
        let told = Mutex::new(vec![Vec::new(); prompts.len()]);
        let joints = |row: usize, ids: &[u32]| {
            let own = joints(row, ids);
            told.lock().unwrap_or_else(PoisonError::into_inner)[row].clone_from(&own);
            own
        };
        let started = Reader::start(&self.net, w, seen.prefix(), prompts, (room, vocabulary.eos()), &joints);
        let (mut reader, first) = started.ok_or("a prompt ends within a code")?;
        let config = GenerateConfig { tokens: room, ..how.clone() };
        let (mut said, mut likelihood) = (vec![0.0; prompts.len()], vec![0.0; prompts.len()]);
        let choose = |row: usize, _: usize, scores: &[f32]| {
            let (shares, off) = shares(scores);
            let id = if config.sample { draw(&shares, &mut streams[row]) } else { argmax(scores) };
            said[row] += f64::from(scores[id as usize] - off);
            id
        };
        // Where nothing is changed, what is drawn from is the network's own.
        let sums = config.changes().then_some(&mut likelihood[..]);
        let all = likely_rows(&mut reader, first, grammars, &config, choose, sums)?;
        let likelihood = if config.changes() { likelihood } else { said.clone() };
        drop(reader);
        let told = told.into_inner().unwrap_or_else(PoisonError::into_inner);
        let whole = all.into_iter().zip(prompts).enumerate().zip(told).map(|((row, (own, prompt)), joints)| {
            let likelihood = (likelihood[row], own.len());
            let drawn: Vec<u32> = prompt.iter().copied().chain(own).collect();
            RigSample { joints, said: said[row], ..self.said(&drawn, likelihood) }
        });
        Ok(whole.collect())
    }

    /// The best of the beams after one prompt and one shape.
    fn beamed(
        &self,
        w: &Weights,
        seen: &Condition,
        (prompt, grammar): (&[u32], &Strict),
        how: &GenerateConfig,
        random: &mut Stream,
        joints: &JointsOf<'_>,
    ) -> Result<RigSample, String> {
        let eos = self.tokenizer.vocabulary().eos();
        let prompts = vec![prompt.to_vec(); how.beams];
        let started = Reader::start(&self.net, w, seen.prefix(), &prompts, (how.tokens, eos), joints);
        let (mut reader, first) = started.ok_or("a prompt ends within a code")?;
        let first = first.first().ok_or("no beams")?;
        let best = best_of(beams(&mut reader, first, grammar, how, beam_chooser(how, random))?);
        drop(reader);
        let drawn: Vec<u32> = prompt.iter().copied().chain(best.ids.iter().copied()).collect();
        let said = f64::from(best.score) * best.ids.len() as f64;
        let own = RigSample { said, ..self.said(&drawn, (best.likelihood, best.ids.len())) };
        // Of a whole rig: the beams had theirs, and may have been told of others last.
        let whole = self.config.model.tell_joint && grammar.end != eos;
        let joints = if whole { joints(0, &own.skeleton) } else { Vec::new() };
        Ok(RigSample { joints, ..own })
    }

    /// The grammar of whole rigs whose skeletons have so many tokens at most.
    pub(crate) fn grammar(&self, tokens: usize) -> Strict {
        let (c, layout) = (&self.config, self.net.layout());
        let grammar = Grammar::new(&self.tokenizer, Limits { tokens, ..c.limits }, c.eval.parents);
        let skin = SkinIds {
            parts: layout.ranges(),
            end: layout.drawn_end(),
            empty: c.skin.empty.then(|| layout.drawn_empty()),
            codes: c.skin.codes,
            len: layout.drawn(),
        };
        let eos = self.tokenizer.vocabulary().eos();
        Strict { grammar: RigGrammar::new(grammar, eos, skin, SkinRule::Exact), end: layout.drawn_end() }
    }

    /// What a whole sequence says; [`RigSample::said`] and what its joints were told are not known here.
    fn said(&self, drawn: &[u32], likelihood: (f64, usize)) -> RigSample {
        let (layout, c) = (self.net.layout(), &self.config);
        let eos = self.tokenizer.vocabulary().eos();
        let end = drawn.iter().position(|&id| id == eos).map_or(drawn.len(), |at| at + 1);
        let (skeleton, skin) = drawn.split_at(end);
        let decoded = self.tokenizer.decode(skeleton);
        let skin = layout.ids(skin).unwrap_or_default();
        let mut codes = Vec::new();
        let mut left = skin.as_slice();
        for _ in 0..decoded.as_ref().map_or(0, |d| d.joints.len()) {
            codes.push(match left.split_first() {
                Some((&first, rest)) if first == layout.empty() => {
                    left = rest;
                    None
                }
                _ => left.split_at_checked(c.skin.codes).map(|(own, rest)| {
                    left = rest;
                    own.iter().map(|id| id - layout.code(0)).collect()
                }),
            });
        }
        let ids = skeleton.iter().map(|&id| i64::from(id)).chain(skin).collect();
        RigSample { skeleton: skeleton.to_vec(), decoded, codes, joints: Vec::new(), ids, likelihood, said: 0.0 }
    }

    /// The prompt from which a skeleton is drawn freely.
    pub fn free(&self) -> Vec<u32> {
        let ids = self.tokenizer.vocabulary();
        std::iter::once(ids.bos()).chain(ids.class_named(&self.config.class).map(|number| ids.class(number))).collect()
    }
}

/// Bytes of the keys and values of a row of so many tokens, those of its shape with them.
fn bytes_of_row(decoder: &QwenConfig, tokens: usize, kind: Kind) -> usize {
    2 * decoder.layers * decoder.kv_heads * decoder.head_width * tokens * kind.elt_size_in_bytes()
}

#[cfg(test)]
mod tests {
    use riglab_core::Mesh;
    use riglab_nn::tokenrig::Head;

    use super::*;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    #[test]
    fn a_thousand_draws_of_untrained_models_are_rigs() {
        let mesh = tetrahedron();
        for (head, empty) in [(Head::Flat, false), (Head::Levels, true)] {
            let rigger = untrained(head, empty);
            let w = rigger.params().weights();
            let prefix = rigger.condition(w, &[(&mesh, 0)]);
            let how = GenerateConfig { sample: true, ..GenerateConfig::default() };
            for batch in 0..5 {
                let mut streams: Vec<_> = (0..100).map(|k| stream(batch, "test", &[k])).collect();
                let drawn = rigger.draw(w, &prefix, &vec![rigger.free(); 100], &how, &mut streams).unwrap();
                for drawn in &drawn {
                    let decoded = drawn.decoded.as_ref().unwrap();
                    assert!((1..=6).contains(&decoded.joints.len()));
                    assert_eq!(drawn.codes.len(), decoded.joints.len());
                    assert!(
                        drawn.codes.iter().flatten().all(|c| c.len() == 2 && c.iter().all(|c| (0..12).contains(c)))
                    );
                    assert!(empty || drawn.codes.iter().all(Option::is_some));
                    assert!(drawn.likelihood.0 < 0.0 && drawn.likelihood.0.is_finite());
                }
                // Some become weights: finite ones that sum to 1.
                let skeleton = drawn[0].decoded.as_ref().unwrap().skeleton().unwrap();
                let weights = rigger.skin(&mesh, &skeleton, std::slice::from_ref(&drawn[0].codes), 0).unwrap();
                assert_eq!(weights.rows(), 4);
            }
        }
    }

    #[test]
    fn the_best_of_beams_is_a_rig_and_no_matter_of_those_beside_it() {
        let mesh = tetrahedron();
        let wide = mesh.with_positions(mesh.positions().iter().map(|p| [1.5 * p[0], p[1], p[2]]).collect()).unwrap();
        let rigger = untrained(Head::Flat, false);
        let w = rigger.params().weights();
        let draw = |meshes: &[(&Mesh, u64)], keys: &[u64], prompt: &[u32], how: &GenerateConfig| {
            let mut streams: Vec<_> = keys.iter().map(|k| stream(5, "test", &[*k])).collect();
            rigger.draw(w, &rigger.condition(w, meshes), &vec![prompt.to_vec(); keys.len()], how, &mut streams).unwrap()
        };
        for sample in [false, true] {
            // As SkinTokens draws.
            let how = GenerateConfig {
                sample,
                beams: 4,
                top_k: 5,
                top_p: 0.95,
                repetition_penalty: 2.0,
                ..GenerateConfig::default()
            };
            let two = draw(&[(&mesh, 0), (&wide, 0)], &[0, 1], &rigger.free(), &how);
            for own in &two {
                let decoded = own.decoded.as_ref().unwrap();
                assert_eq!(own.codes.len(), decoded.joints.len());
                assert!(own.codes.iter().flatten().all(|c| c.len() == 2 && c.iter().all(|c| (0..12).contains(c))));
                assert_eq!(own.likelihood.1, own.ids.len() - rigger.free().len());
                assert!(own.likelihood.0.is_finite() && own.likelihood.0 < 0.0);
            }
            let alone = draw(&[(&wide, 0)], &[1], &rigger.free(), &how);
            assert_eq!((&alone[0].ids, &alone[0].codes), (&two[1].ids, &two[1].codes));
            // Several of one shape.
            let same = draw(&[(&wide, 0)], &[0, 1], &rigger.free(), &how);
            assert_eq!(same[1].ids, two[1].ids);
            // Codes alone, after a skeleton.
            let codes = draw(&[(&mesh, 0)], &[2], &two[0].skeleton, &how).remove(0);
            assert_eq!((&codes.skeleton, codes.codes.len()), (&two[0].skeleton, two[0].codes.len()));
        }
    }

    #[test]
    fn a_rig_is_as_likely_at_any_temperature() {
        let (mesh, rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let w = rigger.params().weights();
        let prefix = rigger.condition(w, &[(&mesh, 0)]);
        let draw = |how: &GenerateConfig| {
            rigger.draw(w, &prefix, &[rigger.free()], how, &mut [stream(0, "test", &[])]).unwrap().remove(0)
        };
        let likeliest = draw(&GenerateConfig::default());
        // So cool that the likeliest tokens alone are drawn.
        let cool = GenerateConfig { sample: true, temperature: 0.001, ..GenerateConfig::default() };
        let filtered = GenerateConfig { sample: true, top_k: 1, ..GenerateConfig::default() };
        for own in [cool, filtered].map(|how| draw(&how)) {
            assert_eq!(own.ids, likeliest.ids);
            assert!((own.likelihood.0 - likeliest.likelihood.0).abs() < 1e-3 && own.likelihood.0 < -1.0);
            assert!(own.said > own.likelihood.0 + 1.0, "{} {}", own.said, own.likelihood.0);
        }
    }

    #[test]
    fn rows_in_runs_are_those_at_once() {
        let (mesh, rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let wide = mesh.with_positions(mesh.positions().iter().map(|p| [1.5 * p[0], p[1], p[2]]).collect()).unwrap();
        let w = rigger.params().weights();
        let how = GenerateConfig { sample: true, ..GenerateConfig::default() };
        let shapes = [(&mesh, 0), (&wide, 0), (&mesh, 1), (&wide, 1), (&mesh, 2)];
        for seen in [rigger.condition(w, &shapes), rigger.condition(w, &shapes[..1])] {
            let draw = |most: usize| {
                let mut streams: Vec<_> = (0..5).map(|k| stream(0, "test", &[k])).collect();
                let asked = Draws { until: Until::Whole, w, seen: &seen, prompts: &vec![rigger.free(); 5], how: &how };
                rigger.draw_in_runs(most, asked, &mut streams).unwrap()
            };
            let of = |all: Vec<RigSample>| all.into_iter().map(|d| (d.ids, d.codes)).collect::<Vec<_>>();
            assert_eq!(of(draw(2)), of(draw(5)));
        }
        // The four tokens of a shape have keys and values, too: of two layers, with one head of eight.
        let row = 2 * 2 * 8 * (4 + rigger.config.longest()) * 4;
        assert_eq!(rigger.most_at_once(w, &rigger.condition(w, &shapes[..1])), (1 << 30) / row);
        assert_eq!([rows_at_once(32, 1 << 25), rows_at_once(8, 1 << 26), rows_at_once(0, usize::MAX)], [32, 16, 1]);
    }

    #[test]
    fn where_no_draw_is_a_skeleton_the_first_is_given_as_it_is() {
        let (mesh, rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let w = rigger.params().weights();
        let prefix = rigger.condition(w, &[(&mesh, 0)]);
        let mut streams: Vec<_> = (0..3).map(|k| stream(0, "test", &[k])).collect();
        let how = GenerateConfig::default();
        let mut drawn = rigger.draw_skeletons(w, &prefix, (&rigger.free(), &[3]), &how, &mut streams).unwrap();
        let agreement = Agreement { draws: 3, clouds: 1, mirror: false, refine: 5 };
        let of = |drawn: &[RigSample]| rigger.agreed(w, &prefix, (&agreement, None), drawn.to_vec()).unwrap();
        assert!(of(&drawn).drawn.decoded.is_ok() && of(&drawn).apart.is_some());
        drawn.iter_mut().for_each(|d| d.decoded = Err(DecodeFault::NoEos));
        let none = of(&drawn);
        assert_eq!((none.place, none.apart, none.drawn.decoded.is_err()), (0, None, true));
        assert_eq!(none.drawn.ids, drawn[0].ids);
    }

    #[test]
    fn one_skeleton_on_several_meshes_is_told_of_each() {
        let (mesh, rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let wide = mesh.with_positions(mesh.positions().iter().map(|p| [1.5 * p[0], p[1], p[2]]).collect()).unwrap();
        let w = rigger.params().weights();
        let how = GenerateConfig::default();
        let draw = |meshes: &[(&Mesh, u64)], prompts: &[Vec<u32>]| {
            let mut streams: Vec<_> = prompts.iter().map(|_| stream(0, "test", &[])).collect();
            rigger.draw(w, &rigger.condition(w, meshes), prompts, &how, &mut streams).unwrap()
        };
        let skeleton = draw(&[(&mesh, 0)], &[rigger.free()]).remove(0).skeleton;
        let both = draw(&[(&mesh, 0), (&wide, 0)], &[skeleton.clone(), skeleton.clone()]);
        let alone = [&mesh, &wide].map(|m| draw(&[(m, 0)], std::slice::from_ref(&skeleton)).remove(0).joints);
        assert!(both[0].joints == alone[0] && both[1].joints == alone[1] && alone[0] != alone[1]);
    }

    #[test]
    fn a_batch_equals_its_members() {
        let mesh = tetrahedron();
        let rigger = untrained(Head::Levels, true);
        let w = rigger.params().weights();
        let prefix = rigger.condition(w, &[(&mesh, 0)]);
        let how = GenerateConfig { sample: true, ..GenerateConfig::default() };
        let draw = |keys: &[u64]| {
            let mut streams: Vec<_> = keys.iter().map(|&k| stream(3, "test", &[k])).collect();
            rigger.draw(w, &prefix, &vec![rigger.free(); keys.len()], &how, &mut streams).unwrap()
        };
        let all = draw(&[0, 1, 2, 3, 4, 5]);
        for (key, whole) in all.iter().enumerate() {
            let alone = &draw(&[key as u64])[0];
            assert_eq!((&alone.skeleton, &alone.codes), (&whole.skeleton, &whole.codes));
        }
    }
}
