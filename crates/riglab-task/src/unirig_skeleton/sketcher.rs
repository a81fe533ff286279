//! A trained skeleton model at work on meshes that are no part of a corpus.

use std::path::Path;

use riglab_core::{Bounds, Mesh, Similarity, Skeleton};
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::Params;
use riglab_random::{Stream, stream};
use riglab_token::Tokenizer;
use riglab_train::named_by;
use tch::Device;

use super::agree::Chosen;
use super::generate::{Drawer, Likely, SkeletonSample};
use super::{SkeletonTaskConfig, Trained};
use crate::bundle::{self, Card};
use crate::grpo::{descends, refined};
use crate::sequences::{NO_SKELETON, may_begin, of_class};
use crate::settings::{Settings, TaskSettings};
use crate::tokenrig::{Draw, Rank};

/// A network that writes skeletons, with its weights.
pub struct Sketcher {
    own: Trained,
    tokenizer: Tokenizer,
    device: Device,
}

/// What is wanted.
#[derive(Clone, Copy, Default)]
pub struct Sketch<'a> {
    /// A class of skeletons to begin with, by its name; as the model's config says where it is not told.
    pub class: Option<&'a str>,
    /// How many are drawn, of which the best is taken; as the model's `eval.consensus` where it is not told.
    pub samples: Option<usize>,
    /// Which is the best: by agreement or by likelihood. With the latter the first is as the model's `eval.generate` says,
    /// which mostly takes the likeliest token each time.
    pub rank: Rank,
    /// Temperature of the draws; as the model's config says where it is not told.
    pub temperature: Option<f32>,
    /// Seeds the points that the encoder sees, and the draws.
    pub seed: u64,
}

/// What came of it.
#[derive(Clone, Debug)]
pub struct Sketched {
    /// The joints, in the mesh's units.
    pub skeleton: Skeleton,
    /// As [`GeneratedRig::apart`](crate::tokenrig::GeneratedRig::apart).
    pub apart: Option<f64>,
    /// Which of the draws it is.
    pub sample: usize,
    /// All draws, in their order.
    pub draws: Vec<Draw>,
}

impl Sketcher {
    /// Reads a run's folder, that of one of its checkpoints, or a file of `riglab checkpoint import`; `None` where that is no
    /// model of this task, nor one that rewards refined.
    ///
    /// # Errors
    /// A sentence: what is wrong with it.
    pub fn open(path: &Path, device: Device) -> Result<Option<(Self, Card)>, String> {
        Self::open_with(path, &[], device)
    }

    /// As [`Self::open`], with settings of a run changed as `--set` does: where the model lies now that it started from.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn open_with(path: &Path, sets: &[String], device: Device) -> Result<Option<(Self, Card)>, String> {
        if !is_one(path, sets) {
            return Ok(None);
        }
        let Some(own) = Trained::open_with(path, sets, device)? else { return Ok(None) };
        let (tokenizer, card) = (Tokenizer::new(own.config.tokenizer.clone()), own.card.clone());
        Ok(Some((Self { own, tokenizer, device }, card)))
    }

    /// Its settings and weights.
    pub fn into_parts(self) -> (SkeletonTaskConfig, Params) {
        (self.own.config, self.own.params)
    }

    /// Keeps so many beams whenever it draws (`eval.generate.beams`).
    pub fn keep_beams(&mut self, beams: usize) {
        self.own.config.eval.generate.beams = beams;
    }

    /// Joints of a skeleton that it writes, at most.
    pub fn most_joints(&self) -> usize {
        self.own.config.limits.joints
    }

    /// The name of the class that is meant, in whatever case it is told; `None` where there is none.
    pub fn class_meant(&self, told: &str) -> Option<&str> {
        self.tokenizer.vocabulary().class_meant(told)
    }

    /// Whether skeletons can begin as those of a class.
    ///
    /// # Errors
    /// A sentence: there is no such class, or no room for its joints.
    pub fn may_begin_with(&self, class: &str) -> Result<(), String> {
        let config = &self.own.config;
        let may_begin = |ids: &[u32]| may_begin(&self.tokenizer, config.limits, config.eval.parents, ids);
        of_class(self.tokenizer.vocabulary(), class, config.limits, may_begin).map(drop)
    }

    /// Draws a skeleton for a mesh.
    ///
    /// # Errors
    /// A sentence: a class that the model does not know, or none that is a skeleton.
    pub fn skeleton(&self, mesh: &Mesh, wish: &Sketch<'_>) -> Result<Sketched, String> {
        let mut config = self.own.config.clone();
        config.eval.consensus = wish.samples.unwrap_or(config.eval.consensus).max(1);
        config.eval.generate.temperature = wish.temperature.unwrap_or(config.eval.generate.temperature);
        if let Some(class) = wish.class {
            self.may_begin_with(class)?;
            class.clone_into(&mut config.class);
        }
        // From here on in the network's axes.
        let up = config.data.up;
        let mesh = up.mesh(mesh).map_err(|e| e.to_string())?;
        let bounds = Bounds::of(mesh.positions().iter().copied()).ok_or("a mesh without vertices")?;
        let map = Similarity::into_cube(bounds);
        let cube = mesh.positions().iter().map(|&p| map.apply(p)).collect();
        let cube = mesh.with_positions(cube).map_err(|e| e.to_string())?;
        let (net, device) = (&self.own.net, self.device);
        let drawer = Drawer { config: &config, tokenizer: &self.tokenizer, net, device };
        let mut likelihood = vec![Likely::default(); config.eval.consensus];
        let Chosen { place: sample, apart, drawn } = match wish.rank {
            Rank::Rewards => return Err("rewards judge whole rigs, and this model draws skeletons alone".into()),
            Rank::Consensus if config.eval.consensus > 1 => {
                let w = self.own.params.weights();
                drawer.agreed(drawer.draw_several(w, &[(&cube, wish.seed)], Some(&mut likelihood))?)
            }
            Rank::Consensus | Rank::Likelihood => {
                self.likeliest(&drawer, &cube, wish.seed, &mut likelihood)?.ok_or(NO_SKELETON)?
            }
        };
        let in_cube = drawn.decoded.map_err(|_| NO_SKELETON)?.skeleton().map_err(|e| e.to_string())?;
        let heads = in_cube.heads().iter().map(|&p| up.back(map.inverse().apply(p))).collect();
        let skeleton = in_cube.with_heads(heads).map_err(|e| e.to_string())?;
        let draw = |own: &Likely| Draw { likelihood: own.mean(), rewards: None };
        Ok(Sketched { skeleton, apart, sample, draws: likelihood.iter().map(draw).collect() })
    }

    /// The likeliest of as many draws as there are places for their likelihoods: one as `eval.generate` says, and samples.
    fn likeliest(
        &self,
        drawer: &Drawer<'_>,
        cube: &Mesh,
        seed: u64,
        likelihood: &mut [Likely],
    ) -> Result<Option<Chosen<SkeletonSample>>, String> {
        let w = self.own.params.weights();
        let prefix = drawer.prefix_of(w, &drawer.shapes_of(&[(cube, seed)]));
        let mut streams: Vec<Stream> =
            (0..likelihood.len() as u64).map(|k| stream(seed, "skeleton draws", &[k])).collect();
        let how = |sample| GenerateConfig { sample, ..drawer.config.eval.generate.clone() };
        let (first, others) = streams.split_at_mut(1);
        let (of_first, of_others) = likelihood.split_at_mut(1);
        let sampled = drawer.config.eval.generate.sample;
        let mut drawn = drawer.draw_told(w, (&prefix, &[0]), first, &how(sampled), Some(of_first))?;
        if !others.is_empty() {
            let of = vec![0; others.len()];
            drawn.extend(drawer.draw_told(w, (&prefix, &of), others, &how(true), Some(of_others))?);
        }
        let whole = (0..drawn.len()).filter(|&at| drawn[at].decoded.is_ok());
        // The first of equals.
        let best = whole.min_by(|&a, &b| likelihood[b].mean().total_cmp(&likelihood[a].mean()));
        Ok(best.map(|best| Chosen { place: best, apart: None, drawn: drawn.swap_remove(best) }))
    }
}

/// Whether a path is of a model of this task. What cannot be read is not: who looks for another kind says what is wrong.
fn is_one(path: &Path, sets: &[String]) -> bool {
    let (run, _) = named_by(path);
    if !run.is_dir() {
        return bundle::kind(path).is_some_and(|kind| kind == SkeletonTaskConfig::TASK);
    }
    let (Ok(()), Ok(settings)) = (descends(&run), Settings::of_run_with(&run, sets)) else { return false };
    match refined(&settings) {
        Ok(Some(start)) => !start.as_os_str().is_empty() && is_one(&start, &[]),
        _ => settings.are::<SkeletonTaskConfig>(),
    }
}

#[cfg(test)]
mod tests {
    use riglab_token::Limits;
    use riglab_train::State;

    use super::*;
    use crate::tokenrig::testing::tetrahedron;
    use crate::unirig_skeleton::SkeletonTask;

    /// A model that has learnt nothing, of the smallest sizes.
    fn untrained() -> Sketcher {
        let mut config = SkeletonTaskConfig::default();
        let (shape, decoder) = (&mut config.model.shape, &mut config.model.decoder);
        (shape.tokens, shape.drawn, shape.layers, shape.width, shape.heads) = (4, 2, 1, 16, 2);
        (decoder.width, decoder.layers, decoder.heads, decoder.ffn) = (16, 1, 2, 16);
        config.sampling.cloud.points = 32;
        config.limits = Limits { joints: 12, tokens: 64 };
        (config.eval.consensus, config.eval.clouds, config.eval.mirror, config.eval.refine) = (6, 2, true, 2);
        let (net, params) = SkeletonTask::network(&config, Device::Cpu).unwrap();
        let state = State { task: String::new(), step: 0, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
        let card = Card { name: "untrained".into(), state, text: String::new() };
        let tokenizer = Tokenizer::new(config.tokenizer.clone());
        Sketcher { own: Trained { config, net, params, card }, tokenizer, device: Device::Cpu }
    }

    #[test]
    fn a_mesh_gets_the_skeleton_that_an_evaluation_draws_for_it_in_its_own_units() {
        let own = untrained();
        let far: Vec<_> = tetrahedron().positions().iter().map(|p| p.map(|x| 50.0 * x + 7.0)).collect();
        let mesh = tetrahedron().with_positions(far).unwrap();
        let map = Similarity::into_cube(Bounds::of(mesh.positions().iter().copied()).unwrap());
        let cube = mesh.with_positions(mesh.positions().iter().map(|&p| map.apply(p)).collect()).unwrap();
        let w = own.own.params.weights();
        for consensus in [1, 6] {
            let mut config = own.own.config.clone();
            config.eval.consensus = consensus;
            let drawer = Drawer { config: &config, tokenizer: &own.tokenizer, net: &own.own.net, device: Device::Cpu };
            let want = drawer.draw_agreed(w, &[(&cube, 3)]).unwrap().remove(0).drawn.decoded.unwrap();
            let wish = Sketch { samples: Some(consensus), seed: 3, ..Sketch::default() };
            let made = own.skeleton(&mesh, &wish).unwrap();
            assert_eq!((made.draws.len(), made.skeleton.len()), (consensus, want.joints.len()));
            assert!(made.draws.iter().all(|d| d.likelihood.is_finite() && d.likelihood < 0.0), "{:?}", made.draws);
            for (head, joint) in made.skeleton.heads().iter().zip(&want.joints) {
                assert!((0..3).all(|k| (map.apply(*head)[k] - joint[k]).abs() < 1e-4), "{head:?} {joint:?}");
            }
        }
        let usual = own.skeleton(&mesh, &Sketch::default()).unwrap();
        assert_eq!(usual.draws.len(), 6, "as its config says");
    }

    #[test]
    fn of_draws_by_likelihood_the_likeliest_is_taken() {
        let own = untrained();
        let wish = Sketch { samples: Some(5), rank: Rank::Likelihood, temperature: Some(1.5), ..Sketch::default() };
        let made = own.skeleton(&tetrahedron(), &wish).unwrap();
        let best = made.draws.iter().map(|d| d.likelihood).fold(f64::NEG_INFINITY, f64::max);
        assert_eq!((made.draws.len(), made.draws[made.sample].likelihood), (5, best));
        // So cool that all are drawn as the first is, which takes the likeliest tokens: they are as likely.
        let cool = own.skeleton(&tetrahedron(), &Sketch { temperature: Some(0.001), ..wish }).unwrap();
        let off = |draw: &Draw| (draw.likelihood - cool.draws[0].likelihood).abs();
        assert!(cool.draws.iter().all(|draw| off(draw) < 1e-4) && cool.draws[0].likelihood < -0.1, "{:?}", cool.draws);
        let rewards = own.skeleton(&tetrahedron(), &Sketch { rank: Rank::Rewards, ..wish }).unwrap_err();
        assert!(rewards.contains("skeletons alone"), "{rewards}");
    }

    #[test]
    fn with_beams_one_skeleton_is_the_best_of_them() {
        let mut own = untrained();
        own.keep_beams(4);
        let generate = &mut own.own.config.eval.generate;
        // As UniRig draws.
        (generate.sample, generate.temperature, generate.top_k, generate.top_p) = (true, 1.5, 5, 0.95);
        generate.repetition_penalty = 3.0;
        for (samples, rank) in [(1, Rank::Consensus), (3, Rank::Likelihood), (3, Rank::Consensus)] {
            let wish = Sketch { samples: Some(samples), rank, seed: 3, ..Sketch::default() };
            let made = own.skeleton(&tetrahedron(), &wish).unwrap();
            assert_eq!(made.draws.len(), samples);
            assert!(made.draws.iter().all(|d| d.likelihood.is_finite() && d.likelihood < 0.0), "{:?}", made.draws);
            assert_eq!(made.skeleton, own.skeleton(&tetrahedron(), &wish).unwrap().skeleton);
        }
    }

    #[test]
    fn a_class_is_begun_with_where_it_is_known_and_has_room() {
        let mut own = untrained();
        let ask = |own: &Sketcher, class| own.skeleton(&tetrahedron(), &Sketch { class, ..Sketch::default() });
        assert!(ask(&own, Some("mixamo")).unwrap_err().contains("more than this model writes (12 joints, 64 tokens)"));
        assert!(ask(&own, Some("unknown")).unwrap_err().contains("there are: "));
        own.own.config.limits = Limits { joints: 100, tokens: 600 };
        own.own.config.model.decoder.positions = 640;
        let made = ask(&own, Some("mixamo")).unwrap();
        assert!(made.skeleton.names().iter().any(|name| name.starts_with("mixamorig:")), "{:?}", made.skeleton.names());
    }
}
