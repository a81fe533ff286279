//! Settings of the task.

use std::path::PathBuf;

use riglab_augment::{CubeConfig, Recipe};
use riglab_nn::generate::{self, GenerateConfig};
use riglab_nn::grpo::{Norm, ObjectiveConfig};
use riglab_reward::RewardConfig;
use riglab_token::{Parents, TokenizerConfig};
use riglab_train::{Precision, TrainConfig};
use serde::{Deserialize, Serialize};

use crate::assets::{DataConfig, Up};
use crate::sequences::drawable;
use crate::settings::{TaskSettings, own_settings};
use crate::tokenrig::EvalConfig;

/// Everything a run of GRPO is made of (SkinTokens 3.4).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GrpoTaskConfig {
    /// The task's name: `grpo`.
    pub task: String,
    /// Where the policy starts; it is also what the policy is held to.
    pub start: StartConfig,
    /// Corpora and splits. Rigs of the training split are not looked at, only their meshes, set into the cube as `riglab rig`
    /// sets them; skeletons are where steps of `augment` need them.
    pub data: DataConfig,
    /// How meshes are varied, in the frame of their own boxes. `delete`, `part` and `pose` do it by their skeletons.
    pub augment: Recipe,
    /// How rigs are drawn.
    pub rollout: RolloutConfig,
    /// What they are worth.
    pub reward: RewardConfig,
    /// What is minimised.
    pub objective: ObjectiveConfig,
    /// When a run stops or warns.
    pub guard: GuardConfig,
    /// What is drawn of meshes that are not trained on.
    pub held_out: HeldOutConfig,
    /// How it is trained.
    pub train: TrainConfig,
    /// How it is evaluated.
    pub eval: EvalConfig,
}

/// Where the policy starts.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct StartConfig {
    /// The folder of a run of task `tokenrig` or of one of its checkpoints (of a run: `checkpoints/best`), or a file made
    /// by `riglab checkpoint export` or `import`; empty: the model that comes with riglab. Also a run, or an imported file,
    /// of task `unirig_skeleton`: its skeletons are refined by the rewards of joints and bones.
    pub model: PathBuf,
}

/// What is done with a group whose rewards are equal: it has nothing to teach.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dead {
    /// It stays: the divergence alone pulls (the paper's, which says nothing else).
    #[default]
    Keep,
    /// It is left out of the loss.
    Mask,
    /// It is drawn anew, three times at most.
    Resample,
}

/// How rigs are drawn: by sampling within the grammar, at a temperature, and by nothing else. Filters such as top-k would
/// make what was drawn another distribution than what is trained.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RolloutConfig {
    /// Meshes of a rollout.
    pub meshes: usize,
    /// Rigs of a mesh, G. The paper's 24.
    pub group: usize,
    /// Scores are divided by it, when drawing and when training.
    pub temperature: f32,
    /// Passes over the rigs of a rollout.
    pub epochs: usize,
    /// Steps in each pass, among which the rigs of a rollout are divided.
    pub minibatches: usize,
    /// What is done with groups without spread.
    pub dead: Dead,
    /// Codes are asked for weights at so many vertices of a mesh at most; the others are told by their neighbours. Held-out
    /// meshes are judged at no more, either, whatever `eval.vertices` is.
    pub vertices: usize,
    /// What the auto-encoder computes with when rigs are judged.
    pub precision: Precision,
}

impl Default for RolloutConfig {
    fn default() -> Self {
        Self {
            meshes: 1,
            group: 24,
            temperature: 1.0,
            epochs: 1,
            minibatches: 1,
            dead: Dead::Keep,
            vertices: 1024,
            precision: Precision::Auto,
        }
    }
}

impl RolloutConfig {
    /// Steps of a rollout.
    pub fn updates(&self) -> u64 {
        (self.epochs * self.minibatches) as u64
    }
}

/// What is drawn of meshes that are not trained on.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HeldOutConfig {
    /// Rigs of each that are sampled as in training, whose mean counts: that is what training raises, and one rig a
    /// mesh is too few to see it. 0: one of each counts, made as `eval.generate` says.
    pub draws: usize,
}

impl Default for HeldOutConfig {
    fn default() -> Self {
        Self { draws: 4 }
    }
}

/// When a run stops or warns.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct GuardConfig {
    /// A step whose mean divergence from the start passes this ends the run with an explanation.
    pub divergence: f64,
    /// A checkpoint whose J2J on the validation split passes that of the start by this factor cannot become the best,
    /// whatever its reward.
    pub worse: f64,
}

impl Default for GuardConfig {
    fn default() -> Self {
        Self { divergence: 4.0, worse: 1.05 }
    }
}

impl GrpoTaskConfig {
    /// How rigs are drawn.
    pub fn draws(&self) -> GenerateConfig {
        GenerateConfig {
            tokens: usize::MAX,
            sample: true,
            temperature: self.rollout.temperature,
            ..GenerateConfig::default()
        }
    }

    /// Checks that evaluation can draw what the model to start from writes.
    ///
    /// # Errors
    /// A sentence on the first fault.
    pub(super) fn suits(&self, tokenizer: &TokenizerConfig) -> Result<(), String> {
        let checked = drawable(&self.eval.generate, self.eval.parents, tokenizer);
        checked.map_err(|(key, message)| format!("{key}: {message} (of the model in start.model)"))
    }

    /// Checks sizes and their relations.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (String, String)> {
        let bad = |key: &str, message: String| Err((key.to_owned(), message));
        self.data.validate()?;
        self.augment.validate().map_err(|(key, message)| (format!("augment.{key}"), message))?;
        self.train.validate().map_err(|(key, message)| (format!("train.{key}"), message))?;
        if !self.train.start.is_none() {
            return bad("train.start", "GRPO starts from a trained policy: name it in start.model".into());
        }
        self.reward.validate().map_err(|(key, message)| (format!("reward.{key}"), message))?;
        self.objective.validate().map_err(|(key, message)| (format!("objective.{key}"), message))?;
        if self.eval.generate.beams > 1 {
            return bad(
                "eval.generate.beams",
                "what GRPO draws and judges is drawn without beams: leave it at 1; `riglab eval` draws as the model to \
                 start from says"
                    .into(),
            );
        }
        // What every model asks; `suits` knows the one to start from.
        drawable(&self.eval.generate, Parents::Existing, &TokenizerConfig::default())?;
        let r = &self.rollout;
        for (key, value) in [
            ("rollout.meshes", r.meshes),
            ("rollout.epochs", r.epochs),
            ("rollout.minibatches", r.minibatches),
            ("rollout.vertices", r.vertices),
            ("eval.rows", self.eval.rows),
            ("eval.vertices", self.eval.vertices),
        ] {
            if value == 0 {
                return bad(key, "must be at least 1".into());
            }
        }
        if r.group < 2 {
            return bad("rollout.group", "rigs are compared within a group: give 2 or more".into());
        }
        if r.minibatches > r.meshes * r.group {
            let all = r.meshes * r.group;
            return bad(
                "rollout.minibatches",
                format!("{all} rigs cannot be split into {} minibatches", r.minibatches),
            );
        }
        if let Err(why) = generate::drawable_at(r.temperature) {
            return bad("rollout.temperature", format!("temperature = {why}"));
        }
        // Each batch of a step is a rollout of its own; one that is gone over several times is kept from step to step.
        if self.train.accumulate != 1 && r.updates() != 1 {
            let updates = r.updates();
            return bad(
                "train.accumulate",
                format!(
                    "must be 1 where a rollout is used for {updates} steps: raise rollout.meshes for more rigs, or set \
                     rollout.epochs = 1 and rollout.minibatches = 1 for several rollouts a step"
                ),
            );
        }
        self.eval.validate()?;
        if self.eval.consensus != 1 {
            return bad("eval.consensus", "GRPO is judged by `held_out.draws` rigs a mesh: leave it at 1".into());
        }
        let GuardConfig { divergence, worse } = self.guard;
        if divergence.is_nan() || divergence <= 0.0 {
            return bad("guard.divergence", format!("divergence = {divergence} must be above 0"));
        }
        if worse.is_nan() || worse < 1.0 {
            return bad("guard.worse", format!("worse = {worse} is a factor: give 1 or more"));
        }
        Ok(())
    }
}

/// A sentence on settings that say how other evaluations make rigs and are not as they are by default: GRPO passes over them.
pub(super) fn unread(eval: &EvalConfig) -> Option<String> {
    let own = EvalConfig::default();
    let EvalConfig {
        // What is read.
        generate: _,
        parents: _,
        rows: _,
        validation_assets: _,
        cut: _,
        vertices: _,
        seed: _,
        consensus: _,
        clouds,
        mirror,
        refine,
        turn,
        symmetric,
        complete,
        retrieval_points,
        skins,
        without_codes,
        spread,
        baseline_resolution,
    } = eval;
    let same = [
        ("clouds", *clouds == own.clouds),
        ("mirror", *mirror == own.mirror),
        ("refine", *refine == own.refine),
        ("turn", *turn == own.turn),
        ("symmetric", *symmetric == own.symmetric),
        ("complete", *complete == own.complete),
        ("retrieval_points", *retrieval_points == own.retrieval_points),
        ("skins", *skins == own.skins),
        ("without_codes", *without_codes == own.without_codes),
        ("spread", *spread == own.spread),
        ("baseline_resolution", *baseline_resolution == own.baseline_resolution),
    ];
    let keys: Vec<String> = same.into_iter().filter(|(_, same)| !same).map(|(key, _)| format!("eval.{key}")).collect();
    (!keys.is_empty()).then(|| {
        format!(
            "GRPO does not read {}: its rigs are single draws, judged by `held_out.draws` of them a mesh; \
             `riglab checkpoint export` makes a folder of the refined model, of which `riglab eval` reads them",
            keys.join(", ")
        )
    })
}

/// Sentences on settings that were changed and have no effect beside others; `weighs`: whether the model that is refined
/// says weights, not skeletons alone; `up`: the axis that points up for it.
pub(super) fn idle(config: &GrpoTaskConfig, weighs: bool, up: Up) -> Vec<String> {
    let (own, default) = (&config.objective, ObjectiveConfig::default());
    let (used, asked) = (config.rollout.vertices, config.eval.vertices);
    let clips =
        [("objective.clip", own.clip != default.clip), ("objective.clip_high", own.clip_high != default.clip_high)];
    let mut notes = Vec::new();
    if config.data.up != Up::default() && config.data.up != up {
        notes.push(format!("data.up has no effect: the model that is refined was trained with data.up = \"{up}\""));
    }
    let (augment, bare) = (&config.augment, !config.augment.reads_skeletons());
    let of_joints = [
        ("joint_noise", augment.joint_noise.probability > 0.0),
        ("discretise", augment.discretise.probability > 0.0),
        // Steps that go by joints go by those that these leave.
        ("trim", bare && augment.trim.enabled),
        ("reconnect", bare && augment.reconnect.probability > 0.0),
    ];
    for (key, _) in of_joints.iter().filter(|(_, set)| *set) {
        notes.push(format!("augment.{key} has no effect: it changes joints alone, and GRPO looks at meshes"));
    }
    let (cube, plain) = (&config.augment.cube, CubeConfig::default());
    let of_cube = [
        ("scale_probability", cube.scale_probability != plain.scale_probability),
        ("shift_probability", cube.shift_probability != plain.shift_probability),
        ("into", cube.into != plain.into),
    ];
    // Noise on vertices is the smaller the larger a mesh is: after the cube's own sizes, and after a scale without the cube.
    let noise = augment.jitter.probability > 0.0;
    let of_sizes = of_cube.into_iter().filter(|(key, set)| *set && !(noise && *key != "shift_probability"));
    let mut undone: Vec<String> = of_sizes.map(|(key, _)| format!("augment.cube.{key}")).collect();
    if augment.scale.uniform && augment.scale.probability > 0.0 && (cube.enabled || !noise) {
        undone.push("augment.scale, uniform as it is,".into());
    }
    for what in undone {
        notes
            .push(format!("{what} has no effect: each mesh is set into the cube by its own box, as `riglab rig` does"));
    }
    for (key, _) in clips.iter().filter(|(_, set)| *set && config.rollout.updates() == 1) {
        notes.push(format!(
            "{key} has no effect: each rollout is used for one step, in which all ratios are 1; raise rollout.epochs or \
             rollout.minibatches"
        ));
    }
    if own.length != default.length && own.norm != Norm::Constant {
        notes.push("objective.length has no effect: only objective.norm = \"constant\" reads it".into());
    }
    if !weighs {
        let (eval, default) = (&config.eval, EvalConfig::default());
        let of_weights = [
            ("rollout.vertices", used != RolloutConfig::default().vertices),
            ("eval.vertices", asked != default.vertices),
            ("eval.cut", eval.cut != default.cut),
        ];
        let set = of_weights.into_iter().filter(|(_, set)| *set);
        notes.extend(
            set.map(|(key, _)| format!("{key} has no effect: the model draws skeletons alone, without weights")),
        );
    } else if asked != EvalConfig::default().vertices && asked > used {
        notes.push(format!(
            "eval.vertices = {asked} is for pictures alone: rewards are judged at rollout.vertices = {used} of them at most, \
             as in training"
        ));
    }
    notes
}

impl TaskSettings for GrpoTaskConfig {
    const TASK: &'static str = "grpo";

    own_settings!();

    fn precisions(&mut self) -> Vec<&mut Precision> {
        vec![&mut self.train.precision, &mut self.rollout.precision]
    }

    fn takes_bare_meshes(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use riglab_token::Merge;

    use super::*;

    #[test]
    fn settings_without_effect_are_told() {
        let of = |change: fn(&mut GrpoTaskConfig)| {
            let mut c = GrpoTaskConfig::default();
            change(&mut c);
            idle(&c, true, Up::Y)
                .iter()
                .map(|note| note.split(' ').next().unwrap_or_default().to_owned())
                .collect::<Vec<_>>()
        };
        assert!(of(|_| ()).is_empty());
        let clips = |c: &mut GrpoTaskConfig| (c.objective.clip, c.objective.clip_high) = (0.1, 0.3);
        assert_eq!(of(clips), ["objective.clip", "objective.clip_high"]);
        assert!(of(|c| (c.objective.clip, c.rollout.minibatches) = (0.1, 2)).is_empty());
        assert_eq!(of(|c| c.objective.length = 100.0), ["objective.length"]);
        let cube = ["scale_probability", "shift_probability"].map(|key| format!("augment.cube.{key}"));
        assert_eq!(of(|c| c.augment.cube = Recipe::unirig_ar().cube), cube);
        // Noise on vertices counts less on a larger mesh.
        assert_eq!(of(|c| c.augment = Recipe::unirig_ar()), cube[1..]);
        assert_eq!(of(|c| c.augment.cube.into = [0.0, 1.0]), ["augment.cube.into"]);
        assert_eq!(of(|c| c.data.up = Up::Z), ["data.up"]);
        let joints = ["joint_noise", "discretise", "trim", "reconnect"].map(|key| format!("augment.{key}"));
        fn of_joints(c: &mut GrpoTaskConfig) {
            let Recipe { joint_noise, discretise, trim, reconnect, .. } = &mut c.augment;
            (joint_noise.probability, discretise.probability) = (1.0, 1.0);
            (trim.enabled, reconnect.probability) = (true, 1.0);
        }
        assert_eq!(of(of_joints), joints);
        // Poses are of the joints that there are.
        let posed = |c: &mut GrpoTaskConfig| {
            of_joints(c);
            c.augment.pose.probability = 1.0;
        };
        assert_eq!(of(posed), joints[..2]);
        fn uniform(c: &mut GrpoTaskConfig) {
            (c.augment.scale.probability, c.augment.scale.uniform) = (1.0, true);
        }
        assert_eq!(of(uniform), ["augment.scale,"]);
        let noisy = |c: &mut GrpoTaskConfig| {
            uniform(c);
            (c.augment.cube.enabled, c.augment.jitter.probability) = (false, 1.0);
        };
        assert!(of(noisy).is_empty());
        assert!(of(|c| c.augment.scale.probability = 1.0).is_empty());
        assert!(of(|c| (c.objective.length, c.objective.norm) = (100.0, Norm::Constant)).is_empty());
        assert_eq!(of(|c| c.eval.vertices = 2048), ["eval.vertices"]);
        assert!(of(|c| c.eval.vertices = 64).is_empty());
        let mut skeletons = GrpoTaskConfig::default();
        skeletons.data.up = Up::Z;
        assert!(idle(&skeletons, false, Up::Z).is_empty(), "it is as the model has it");
        skeletons.data.up = Up::Y;
        assert!(idle(&skeletons, false, Up::Z).is_empty());
        (skeletons.rollout.vertices, skeletons.eval.vertices, skeletons.eval.cut) = (7, 2048, 0.5);
        let said = idle(&skeletons, false, Up::Y);
        let keys = ["rollout.vertices has no effect", "eval.vertices has no effect", "eval.cut has no effect"];
        assert!(said.len() == 3 && said.iter().zip(keys).all(|(said, key)| said.starts_with(key)), "{said:?}");
    }

    #[test]
    fn what_the_start_asks_of_draws_is_told() {
        let mut c = GrpoTaskConfig::default();
        let plain = TokenizerConfig::default();
        (c.eval.generate.tokens, c.eval.parents) = (7, Parents::Anywhere);
        assert_eq!(c.validate(), Ok(()));
        assert_eq!(c.suits(&TokenizerConfig { merge: Merge::Nearest, ..plain.clone() }), Ok(()));
        let said = c.suits(&TokenizerConfig { least_joints: 2, ..plain.clone() }).unwrap_err();
        assert!(said.starts_with("eval.generate.tokens: a skeleton takes at least 10 tokens"), "{said}");
        let said = c.suits(&TokenizerConfig { merge: Merge::Within(0.1), ..plain }).unwrap_err();
        assert!(said.starts_with("eval.parents: "), "{said}");
    }

    #[test]
    fn faults_name_their_key() {
        let of = |change: fn(&mut GrpoTaskConfig)| {
            let mut c = GrpoTaskConfig::default();
            change(&mut c);
            c.validate().map_err(|(key, _)| key)
        };
        assert_eq!(of(|_| ()), Ok(()));
        assert_eq!(of(|c| c.rollout.group = 1), Err("rollout.group".into()));
        assert_eq!(of(|c| c.rollout.minibatches = 25), Err("rollout.minibatches".into()));
        assert_eq!(of(|c| c.train.accumulate = 2), Ok(()));
        let twice = |c: &mut GrpoTaskConfig| (c.train.accumulate, c.rollout.epochs) = (2, 2);
        assert_eq!(of(twice), Err("train.accumulate".into()));
        assert_eq!(
            of(|c| c.reward.weights = riglab_reward::RewardWeights::new([5.0, -1.0, 1.0, 1.0])),
            Err("reward.weights".into())
        );
        assert_eq!(of(|c| c.train.start.from = "a".into()), Err("train.start".into()));
        assert_eq!(of(|c| c.reward.poses = 0), Err("reward.poses".into()));
        assert_eq!(of(|c| c.objective.clip = 0.0), Err("objective.clip".into()));
        assert_eq!(of(|c| c.guard.worse = 0.5), Err("guard.worse".into()));
        assert_eq!(of(|c| c.guard.divergence = 0.0), Err("guard.divergence".into()));
        assert_eq!(of(|c| c.rollout.temperature = 1e30), Err("rollout.temperature".into()));
        assert_eq!(of(|c| c.rollout.temperature = 1e-30), Err("rollout.temperature".into()));
        assert_eq!(of(|c| c.data.test = vec!["a".into(), "a".into()]), Err("data.test".into()));
        // What would change the rewards, or nothing.
        assert_eq!(of(|c| c.eval.cut = 2.0), Err("eval.cut".into()));
        assert_eq!(of(|c| c.eval.rows = 0), Err("eval.rows".into()));
        assert_eq!(of(|c| c.eval.consensus = 8), Err("eval.consensus".into()));
        assert_eq!(of(|c| c.eval.generate.beams = 4), Err("eval.generate.beams".into()));
        assert_eq!(of(|c| c.eval.generate.tokens = 6), Err("eval.generate.tokens".into()));
        assert_eq!(of(|c| c.eval.skins = 8), Ok(()), "a run that was begun with it goes on");
        let note = |change: fn(&mut EvalConfig)| {
            let mut eval = EvalConfig::default();
            change(&mut eval);
            unread(&eval)
        };
        assert_eq!(note(|eval| (eval.cut, eval.rows) = (0.1, 2)), None);
        assert!(
            note(|eval| (eval.skins, eval.mirror) = (8, true)).unwrap().contains("not read eval.mirror, eval.skins:")
        );
        assert_eq!(of(|c| (c.eval.cut, c.eval.seed, c.eval.vertices) = (0.1, 3, 64)), Ok(()));
    }
}
