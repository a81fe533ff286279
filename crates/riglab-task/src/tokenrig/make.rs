//! A rig for a mesh: the whole way, in the mesh's own units.

use riglab_core::{Mesh, Similarity, Skeleton, SkinWeights};
use riglab_geom::Yaw;
use riglab_reward::{RewardConfig, Rewards, Scorer};
use riglab_token::{Bones, Encoded, Template};

use super::facing::Facing;
use super::stage::Settled;
use super::template::{Anatomy, FindHuman, Placed};
use super::{RigSample, Rigger};
use crate::grpo::{JudgeSettings, Subject, rewards};
use crate::sequences::{NO_SKELETON, of_class};
use crate::unirig_skeleton::agree::{Agreement, Chosen};
use crate::unirig_skeleton::batch::class_of;

/// By what the best of several rigs is told.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Rank {
    /// How likely the model holds it, a token.
    Likelihood,
    /// The rewards of SkinTokens 3.4.1: by its geometry alone.
    Rewards,
    /// How well its skeleton agrees with the others ([`riglab_metric::consensus`]); how likely it is where the skeleton
    /// is given.
    #[default]
    Consensus,
}

/// Vertices at which weights are asked to be judged, at most; the others are told by those around them.
const JUDGED: usize = 4096;

/// What is wanted.
#[derive(Clone, Default)]
pub struct RigRequest<'a> {
    /// A skeleton that stays as it is: only its weights are made.
    pub skeleton: Option<&'a Skeleton>,
    /// Whether that skeleton is a beginning: the model adds the joints that it lacks, after those that are given.
    pub complete: bool,
    /// A class of skeletons to begin with, by its name: its named parts then come first.
    pub class: Option<&'a str>,
    /// What tells the human bones of a skeleton: where they are in free draws is where the joints of a template (the class is
    /// its name) are put if the model loses its way with it and draws are chosen by agreement.
    pub human: Option<&'a FindHuman<'a>>,
    /// How many are drawn, of which the best is taken; the first as the model's `eval.generate` says, which mostly takes the
    /// likeliest token each time, the others sampled. Where it is not told, as many as the model's `eval.consensus`, and one
    /// where the skeleton is given and not completed.
    pub samples: Option<usize>,
    /// Which is the best.
    pub rank: Rank,
    /// Temperature of the draws, where there are several; as the model's config says where it is not told.
    pub temperature: Option<f32>,
    /// Skins that are drawn for the skeleton, of whose weights the mean is taken; as the model's config says where it is
    /// not told.
    pub skins: Option<usize>,
    /// Joints that hold a vertex, at most; four where it is not told.
    pub influences: Option<usize>,
    /// Of each joint of `skeleton`, which is not completed then, whether it may hold anything; any may where it is not told.
    pub holders: Option<&'a [bool]>,
    /// Seeds the points that the encoders see, and the draws.
    pub seed: u64,
}

/// What came of it, in the mesh's units.
#[derive(Clone, Debug)]
pub struct GeneratedRig {
    /// The joints.
    pub skeleton: Skeleton,
    /// Weights of every vertex.
    pub weights: SkinWeights,
    /// How the mesh was turned to be looked at, where it was; joints and weights are of the mesh as it is.
    pub yaw: Yaw,
    /// What became of the template, where one was asked for and [`RigRequest::human`] tells bodies.
    pub placed: Option<Placed>,
    /// How many of the draws are human bodies, where [`RigRequest::human`] tells them and one of free ones was chosen by
    /// agreement.
    pub bodies: Option<usize>,
    /// Whether the skeleton is a human body, where [`RigRequest::human`] tells them and it is not given.
    pub human: bool,
    /// How many pieces of surface were left out while the skeleton was made, as draws showed bodies without them only
    /// (`tokenrig/beside.rs`).
    pub beside: Option<usize>,
    /// How far the skeleton is from the draws on average, where one of several was chosen by agreement: the mean of J2J, J2B
    /// and B2B ([`riglab_metric::apart_from`]). What is far from them is mostly far from what an artist would make.
    pub apart: Option<f64>,
    /// How many joints of a given skeleton stood for all of those that may hold something, where it has more of them than the
    /// model reads: what these hold was shared out to the others by how near their bones are.
    pub thinned: Option<usize>,
    /// Which of the draws it is.
    pub sample: usize,
    /// All draws, in their order.
    pub draws: Vec<Draw>,
}

/// What is known of a draw.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Draw {
    /// Mean log-probability of what was drawn, a token.
    pub likelihood: f64,
    /// What it is worth, with [`Rank::Rewards`].
    pub rewards: Option<Rewards>,
}

impl GeneratedRig {
    /// The draw that was taken.
    pub fn taken(&self) -> &Draw {
        &self.draws[self.sample]
    }
}

impl Rigger {
    /// Makes a skeleton and weights for a mesh.
    ///
    /// # Errors
    /// A sentence: a skeleton that the model cannot write, a class that it does not know.
    pub fn make(&self, mesh: &Mesh, wish: &RigRequest<'_>) -> Result<GeneratedRig, String> {
        // From here on in the network's axes.
        let up = self.config.data.up;
        let mesh = up.mesh(mesh).map_err(|e| e.to_string())?;
        let turned = wish.skeleton.map(|s| up.skeleton(s)).transpose().map_err(|e| e.to_string())?;
        let facing = self.facing(self.params.weights(), &mesh, wish.seed)?;
        self.make_facing(&mesh, turned, wish, facing)
    }

    /// The same of a mesh and a given skeleton in the network's axes, turned to be looked at.
    pub(super) fn make_facing(
        &self,
        mesh: &Mesh,
        turned: Option<Skeleton>,
        wish: &RigRequest<'_>,
        facing: Facing,
    ) -> Result<GeneratedRig, String> {
        let (w, eval) = (self.params.weights(), &self.config.eval);
        let (stage, turned) = self.stage(mesh, turned, wish, facing)?;
        let turned = match turned {
            Some(begun) if wish.complete => {
                let draws = wish.samples.unwrap_or(eval.consensus).max(1);
                let agreement = Agreement { draws, ..eval.agreement() };
                let how = (agreement, wish.seed);
                Some(self.completed(w, &stage.clouds, (&begun, stage.map), &stage.how, how)?)
            }
            turned => turned,
        };
        let samples = match wish.samples {
            Some(samples) if !wish.complete => samples.max(1),
            None if turned.is_none() => eval.consensus.max(1),
            _ => 1,
        };
        let read = |skeleton| Ok::<_, String>((skeleton, self.read(skeleton, stage.map, wish.holders_of(skeleton))?));
        let given = turned.as_ref().map(read).transpose()?;
        let prompt = match (&given, wish.class) {
            (Some((_, read)), _) => read.encoded.ids.clone(),
            (None, Some(class)) => self.of_class(class)?,
            (None, None) => self.free(),
        };
        let plane = if given.is_none() { self.mirror_plane(&stage.cube, wish.seed) } else { None };
        let agreement = Agreement { draws: samples, ..eval.agreement() };
        let agree = Some(agreement).filter(|_| wish.rank == Rank::Consensus && given.is_none() && samples > 1);
        let drawn = self.candidates(w, &stage, (prompt, samples), agree.as_ref(), wish.seed)?;
        let draws = self.judged(&stage.cube, &drawn, wish)?;
        let human = wish.human.filter(|_| given.is_none());
        let anatomy = human.map(|human| Anatomy { plane, ..self.anatomy(&stage, human) });
        let template = anatomy.and_then(|anatomy| Some((wish.class.and_then(Template::of)?, anatomy)));
        let bodies = anatomy.zip(agree).filter(|_| wish.class.is_none());
        let bodies = bodies.map(|(anatomy, agreement)| anatomy.bodies(&drawn, &agreement));
        let written = template.zip(agree);
        let written =
            written.map(|((template, anatomy), agreement)| anatomy.written_ones(template, &drawn, &agreement));
        // Those alone are taken and have a say, if there is one that may be taken.
        let only = written.as_deref().filter(|of| of.iter().zip(agreement.draws_mirrored()).any(|(w, m)| *w && !m));
        let best = if let Some(agreement) = &agree {
            let may = |place: usize| only.is_none_or(|written| written[place]);
            let taken = self.agreed_of(w, &stage.clouds.first(1), (agreement, plane), drawn, may)?;
            Some(taken).filter(|taken| taken.drawn.decoded.is_ok())
        } else {
            let worth = |at: usize| match (wish.rank, draws[at].rewards) {
                (Rank::Rewards, Some(rewards)) => rewards.total,
                _ => draws[at].likelihood,
            };
            // The first of equals.
            let whole = (0..drawn.len()).filter(|&at| drawn[at].decoded.is_ok());
            let best = whole.min_by(|a, b| worth(*b).total_cmp(&worth(*a)));
            best.and_then(|place| Some(Chosen { place, apart: None, drawn: drawn.into_iter().nth(place)? }))
        };
        let best = best.ok_or(NO_SKELETON)?;
        if let (Some(anatomy), Some(agreement), None) = (anatomy, &agree, wish.class)
            && let Some(made) = self.without_beside(&stage, wish, anatomy, (agreement, &best))?
        {
            return Ok(made);
        }
        let Chosen { place: sample, apart, drawn } = best;
        let human = anatomy.zip(drawn.decoded.as_ref().ok()).is_some_and(|(anatomy, own)| anatomy.is_body(own));
        let agree = agree.zip(written.as_deref());
        let placed = match template.map(|template| self.settled(&stage, wish, template, &drawn, agree)).transpose()? {
            // One of the draws, less what the template does not have; what is voted on is none of them.
            Some(Settled::Instead(made)) if matches!(made.placed, Some(Placed::Written { .. })) => {
                return Ok(GeneratedRig { human, apart, sample, draws, ..*made });
            }
            Some(Settled::Instead(made)) => return Ok(*made),
            Some(Settled::Stays(placed)) => Some(placed),
            None => None,
        };
        let (skeleton, weights, thinned) = self.finished(&stage, wish, given.as_ref(), drawn)?;
        Ok(GeneratedRig {
            skeleton,
            weights,
            yaw: facing.yaw(),
            placed,
            bodies,
            human,
            beside: None,
            apart,
            thinned,
            sample,
            draws,
        })
    }

    /// What draws for a mesh in the cube are worth.
    fn judged(&self, cube: &Mesh, drawn: &[RigSample], wish: &RigRequest<'_>) -> Result<Vec<Draw>, String> {
        let worth = match wish.rank {
            Rank::Likelihood | Rank::Consensus => vec![None; drawn.len()],
            Rank::Rewards => {
                let scorer = Scorer::new(cube, &RewardConfig::default());
                let subject = Subject { key: wish.seed, name: String::new(), mesh: cube.clone(), scorer };
                let eval = &self.config.eval;
                let vertices = eval.vertices.min(JUDGED);
                let how = JudgeSettings { vertices, cut: eval.cut, half: false, seed: eval.seed };
                rewards(Some(&self.vae), &subject, drawn, &how)?.into_iter().map(Some).collect()
            }
        };
        let mean = |d: &RigSample| d.likelihood.0 / d.likelihood.1.max(1) as f64;
        Ok(drawn.iter().zip(worth).map(|(d, rewards)| Draw { likelihood: mean(d), rewards }).collect())
    }

    /// A skeleton's sequence.
    ///
    /// # Errors
    /// A sentence: it cannot be written as tokens, or has more joints or tokens than the model reads.
    pub(super) fn given(&self, skeleton: &Skeleton, map: Similarity) -> Result<Encoded, String> {
        let (encoded, c) = (self.encoded(skeleton, map)?, &self.config.limits);
        if self.reads(&encoded, skeleton.len()) {
            return Ok(encoded);
        }
        Err(format!(
            "the given skeleton has {} joints and takes {} tokens; this model reads at most {} joints and {} tokens. Remove \
             joints that move nothing, or use a model with larger limits",
            skeleton.len(),
            encoded.ids.len(),
            c.joints,
            c.tokens
        ))
    }

    /// Whether a skeleton of so many joints is within the limits.
    pub(super) fn reads(&self, encoded: &Encoded, joints: usize) -> bool {
        self.config.limits.hold(joints, encoded.ids.len())
    }

    /// A skeleton's sequence, however long.
    ///
    /// # Errors
    /// A sentence: it cannot be written as tokens.
    pub(super) fn encoded(&self, skeleton: &Skeleton, map: Similarity) -> Result<Encoded, String> {
        let joints: Vec<_> = skeleton.heads().iter().map(|&p| map.apply(p).map(f64::from)).collect();
        let parents: Vec<_> = skeleton.parents().iter().map(|p| p.map(riglab_core::JointId::index)).collect();
        let names = skeleton.names();
        let class = class_of(&self.tokenizer, &self.config.class, names);
        let bones = Bones { joints: &joints, parents: &parents, names };
        let encoded = self.tokenizer.encode_bones(&bones, class);
        encoded.map_err(|e| format!("the given skeleton cannot be written as tokens: {e}"))
    }

    /// Whether skeletons can begin as those of a class.
    ///
    /// # Errors
    /// A sentence: there is no such class, or no room for its joints.
    pub fn may_begin_with(&self, class: &str) -> Result<(), String> {
        self.of_class(class).map(drop)
    }

    /// The beginning of sequences of a class.
    fn of_class(&self, class: &str) -> Result<Vec<u32>, String> {
        of_class(self.tokenizer.vocabulary(), class, self.config.limits, |ids| self.may_begin(ids))
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::Bounds;
    use riglab_nn::tokenrig::Head;
    use riglab_random::stream;

    use super::*;
    use crate::tokenrig::testing::{tetrahedron, untrained};

    #[test]
    fn the_best_by_rewards_has_the_largest_total() {
        let (mesh, rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let wish = |rank| RigRequest { samples: Some(6), rank, ..RigRequest::default() };
        let by_rewards = rigger.make(&mesh, &wish(Rank::Rewards)).unwrap();
        let totals: Vec<f64> = by_rewards.draws.iter().map(|d| d.rewards.unwrap().total).collect();
        let best = totals.iter().copied().fold(f64::MIN, f64::max);
        assert_eq!(totals[by_rewards.sample], best, "{totals:?}");
        assert!(totals.iter().any(|t| *t < best) && totals.iter().all(|t| (0.0..=8.0).contains(t)), "{totals:?}");
        // The same draws, ranked otherwise.
        let likely = rigger.make(&mesh, &wish(Rank::Likelihood)).unwrap();
        let of = |made: &GeneratedRig| made.draws.iter().map(|d| d.likelihood).collect::<Vec<_>>();
        assert_eq!(of(&likely), of(&by_rewards));
        assert_eq!(likely.taken().likelihood, of(&likely).into_iter().fold(f64::MIN, f64::max));
        assert!(likely.taken().rewards.is_none());
        // The first of several is what one is, whatever the temperature of the others.
        let one = rigger.make(&mesh, &RigRequest { samples: Some(1), ..wish(Rank::Likelihood) }).unwrap();
        assert_eq!(one.taken().likelihood, of(&likely)[0]);
    }

    #[test]
    fn the_skeleton_that_draws_agree_on_gets_the_likeliest_codes() {
        let (mesh, mut rigger) = (tetrahedron(), untrained(Head::Levels, true));
        rigger.config.eval.consensus = 6;
        let made = rigger.make(&mesh, &RigRequest::default()).unwrap();
        assert!(made.draws.len() == 6 && made.taken().rewards.is_none());
        // The same skeletons as those of whole rigs from the same streams, of which it is the medoid.
        let w = rigger.params().weights();
        let map = Similarity::into_cube(Bounds::of(mesh.positions().iter().copied()).unwrap());
        let moved = mesh.positions().iter().map(|&p| map.apply(p)).collect();
        let prefix = rigger.condition(w, &[(&mesh.with_positions(moved).unwrap(), 0)]);
        let mut streams: Vec<_> = (0..6).map(|k| stream(0, "rig draws", &[k])).collect();
        let mut how = rigger.config.eval.generate.clone();
        how.tokens = rigger.config.limits.tokens;
        let prompts = vec![rigger.free(); 6];
        let mut whole = rigger.draw(w, &prefix, &prompts[..1], &how, &mut streams[..1]).unwrap();
        how.sample = true;
        whole.extend(rigger.draw(w, &prefix, &prompts[1..], &how, &mut streams[1..]).unwrap());
        let agreement = rigger.config.eval.agreement();
        let at = agreement
            .of(&rigger.tokenizer, whole.iter().map(|d| d.decoded.as_ref().ok()), None, |_| true)
            .unwrap()
            .place;
        assert_eq!(at, made.sample);
        let heads = |of: &riglab_token::Decoded| of.skeleton().unwrap().heads().to_vec();
        let back = |p: &[f32; 3]| map.inverse().apply(*p);
        let want: Vec<_> = heads(whole[at].decoded.as_ref().unwrap()).iter().map(back).collect();
        assert_eq!(made.skeleton.heads(), want);
        how.sample = false;
        let alone = rigger.draw_skeletons(w, &prefix, (&prompts[0], &[1]), &how, &mut streams[..1]).unwrap().remove(0);
        assert!(alone.codes.iter().all(Option::is_none));
        let coded = rigger.with_codes(w, &prefix, alone).unwrap();
        // Greedy all the way, or first to the skeleton's end and then on.
        assert_eq!((&coded.ids, &coded.codes), (&whole[0].ids, &whole[0].codes));
        assert!((coded.likelihood.0 - whole[0].likelihood.0).abs() < 1e-3);
        assert_eq!(coded.likelihood.1, whole[0].likelihood.1);
    }

    #[test]
    fn draws_after_several_clouds_are_refined_and_the_same_each_time() {
        let (mesh, mut rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let eval = &mut rigger.config.eval;
        (eval.consensus, eval.clouds, eval.mirror, eval.refine, eval.skins) = (7, 4, true, 5, 3);
        let make = |samples| rigger.make(&mesh, &RigRequest { samples, ..RigRequest::default() }).unwrap();
        let (made, again) = (make(None), make(None));
        assert_eq!((made.draws.len(), &made.skeleton, &made.weights), (7, &again.skeleton, &again.weights));
        // Two after each of the first three clouds, the second of which is a mirror.
        assert!(![2, 3, 6].contains(&made.sample), "{}", made.sample);
        assert_eq!(made.weights.rows(), mesh.positions().len());
        assert_eq!([1, 2, 3].map(|n| make(Some(n)).draws.len()), [1, 2, 3], "fewer than clouds");
    }

    #[test]
    fn a_skeleton_that_is_given_comes_back_and_its_weights_are_ranked() {
        let (mesh, mut rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let joint = |name: &str, parent, head| riglab_core::Joint { name: name.into(), parent, head };
        let joints =
            vec![joint("a", None, [0.1, 0.2, 0.3]), joint("b", Some(riglab_core::JointId(0)), [0.1, 0.7, 0.3])];
        let skeleton = Skeleton::new(joints).unwrap();
        for up in [crate::assets::Up::Y, crate::assets::Up::Z] {
            rigger.config.data.up = up;
            let wish = RigRequest {
                skeleton: Some(&skeleton),
                samples: Some(3),
                rank: Rank::Rewards,
                ..RigRequest::default()
            };
            let made = rigger.make(&mesh, &wish).unwrap();
            assert_eq!(made.skeleton, skeleton);
            assert!(made.draws.len() == 3 && made.draws.iter().all(|d| d.rewards.is_some()));
        }
    }
}
