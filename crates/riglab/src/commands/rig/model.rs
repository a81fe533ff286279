//! What rigs: a model that writes skeleton and weights, or one of either.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail, ensure};
use riglab_asset::rigging::Subject;
use riglab_core::{Rig, SkinWeights};
use riglab_report::shell::command;
use riglab_task::tokenrig::{Card, Draw, GeneratedRig, Rank, RigRequest, Rigger, Yaw};
use riglab_task::unirig_skeleton::{Sketch, Sketcher};
use riglab_task::unirig_skin::{Holders, Skinner};
use tch::Device;

use super::{Bones, Common, Ranked};
use crate::commands::shown;

/// A model with what to know about it.
pub struct Model {
    made_of: Kind,
    pub card: Card,
}

enum Kind {
    Whole(Box<Rigger>),
    Weights(Box<Skinner>),
    /// One that writes skeletons, and one that makes weights for them.
    Stages(Box<Sketcher>, Box<Model>),
}

impl Model {
    /// Of the folder of a run or of one of its checkpoints, or a file; without, the one that comes along. `weights`: of what
    /// makes the weights of skeletons that a model of skeletons alone writes.
    pub fn open(path: Option<&Path>, weights: Option<&Path>, device: Device) -> Result<Self> {
        let Some(path) = path else {
            ensure!(weights.is_none(), "{ALONE}");
            return Self::whole(Rigger::shipped(device));
        };
        if let Some((sketcher, card)) = Sketcher::open(path, device).map_err(|e| anyhow!(e))? {
            let weights = Self::open(weights, None, device)?;
            if let Kind::Stages(..) = weights.made_of {
                bail!("--weights: {} writes skeletons alone; give a model that makes weights", weights.card.name);
            }
            return Ok(Self { made_of: Kind::Stages(Box::new(sketcher), Box::new(weights)), card });
        }
        ensure!(weights.is_none(), "{ALONE}");
        match Skinner::open(path, device).map_err(|e| anyhow!(e))? {
            Some((skinner, card)) => {
                if let Some(cut) = skinner.usual_cut().filter(|_| path.is_dir()) {
                    tell!(
                        "note: {}: no evaluation chose a cut for this checkpoint, so weights below {cut} are dropped, as is \
                         usual; `{}` chooses one",
                        path.display(),
                        command(["eval", &shown(path)])
                    );
                }
                Ok(Self { made_of: Kind::Weights(Box::new(skinner)), card })
            }
            None => Self::whole(Rigger::open(path, device)),
        }
    }

    fn whole(opened: Result<(Rigger, Card), String>) -> Result<Self> {
        let (rigger, card) = opened.map_err(|e| anyhow!(e))?;
        if let Some(fault) = rigger.mismatch() {
            tell!("warning: {}: {fault}", card.name);
        }
        Ok(Self { made_of: Kind::Whole(Box::new(rigger)), card })
    }

    /// Has it keep so many beams whenever it draws.
    pub fn keep_beams(&mut self, beams: usize) -> Result<()> {
        match &mut self.made_of {
            Kind::Whole(rigger) => rigger.keep_beams(beams).map_err(|why| anyhow!("--beams: {why}")),
            Kind::Stages(sketcher, _) => {
                sketcher.keep_beams(beams);
                Ok(())
            }
            Kind::Weights(_) => {
                bail!("{} is of task unirig_skin, which draws nothing: leave --beams out", self.card.name)
            }
        }
    }

    /// Whether it draws what it makes.
    pub fn draws(&self) -> bool {
        !matches!(self.made_of, Kind::Weights(_))
    }

    /// What makes the weights, where that is another model.
    pub fn of_weights(&self) -> Option<&Card> {
        match &self.made_of {
            Kind::Stages(_, weights) => Some(&weights.card),
            _ => None,
        }
    }

    /// Joints of a skeleton that it writes, at most.
    pub fn most_joints(&self) -> usize {
        match &self.made_of {
            Kind::Whole(rigger) => rigger.most_joints(),
            Kind::Stages(sketcher, _) => sketcher.most_joints(),
            Kind::Weights(_) => usize::MAX,
        }
    }

    /// The name of the template that is meant; one that it does not know as it is told.
    pub fn template<'a>(&'a self, told: &'a str) -> &'a str {
        match &self.made_of {
            Kind::Whole(rigger) => rigger.class_meant(told).unwrap_or(told),
            Kind::Stages(sketcher, _) => sketcher.class_meant(told).unwrap_or(told),
            Kind::Weights(_) => told,
        }
    }

    /// Refuses what it cannot do.
    pub fn suits(&self, args: &Common, bones: &Bones) -> Result<()> {
        let name = &self.card.name;
        let may_begin = |begin: &dyn Fn(&str) -> Result<(), String>| match bones {
            Bones::Predicted { template: Some(told), .. } => begin(self.template(told)).map_err(|e| anyhow!(e)),
            _ => Ok(()),
        };
        match &self.made_of {
            Kind::Whole(rigger) => may_begin(&|class| rigger.may_begin_with(class)),
            Kind::Stages(sketcher, weights) => {
                may_begin(&|class| sketcher.may_begin_with(class))?;
                if let Bones::Given { .. } = bones {
                    bail!(
                        "{name} is of task unirig_skeleton, which writes skeletons and makes no weights for one that is given: \
                         leave --checkpoint out, or take a model of tokenrig or unirig_skin"
                    );
                }
                if let Ranked::Rewards = args.rank {
                    bail!(
                        "{name} is of task unirig_skeleton; rewards judge rigs with their weights, which it does not draw: leave \
                         --rank out"
                    );
                }
                if args.skins.is_some() && !weights.draws() {
                    bail!("{} is of task unirig_skin, which draws nothing: leave --skins out", weights.card.name);
                }
                Ok(())
            }
            Kind::Weights(_) => {
                let task = format!("{name} is of task unirig_skin");
                if matches!(bones, Bones::Predicted { .. }) {
                    bail!(
                        "{task}, which makes weights for a skeleton that is given: take `riglab skin`, or --skeleton keep or \
                         FILE; or give it as --weights beside a --checkpoint of unirig_skeleton"
                    );
                }
                if bones.completed() {
                    bail!("{task}, which adds no joints: leave --complete out, or take a model that writes skeletons");
                }
                if args.samples.is_some_and(|n| n > 1) {
                    bail!("{task}, which draws nothing: leave --samples out");
                }
                if args.skins.is_some() {
                    bail!("{task}, which draws nothing: leave --skins out");
                }
                if args.temperature.is_some() {
                    bail!("{task}, which draws nothing: leave --temperature out");
                }
                if let Ranked::Rewards = args.rank {
                    bail!("{task}, which draws nothing to choose from: leave --rank out");
                }
                Ok(())
            }
        }
    }

    /// A skeleton and weights for a model.
    pub fn make(&self, subject: &Subject, wish: &RigRequest<'_>, kept: bool) -> Result<GeneratedRig> {
        match &self.made_of {
            Kind::Whole(rigger) => rigger.make(subject.mesh(), wish).map_err(|e| anyhow!(e)),
            Kind::Stages(sketcher, weights) => {
                let RigRequest { class, samples, rank, temperature, seed, .. } = *wish;
                let asked = Sketch { class, samples, rank, temperature, seed };
                let own = sketcher.skeleton(subject.mesh(), &asked).map_err(|e| anyhow!(e))?;
                let (skeleton, rank) = (Some(&own.skeleton), Rank::Likelihood);
                let given =
                    RigRequest { skeleton, class: None, samples: None, temperature: None, rank, ..wish.clone() };
                let made = weights.make(subject, &given, false)?;
                Ok(GeneratedRig { apart: own.apart, sample: own.sample, draws: own.draws, ..made })
            }
            Kind::Weights(skinner) => {
                let skeleton = wish.skeleton.context("no skeleton")?.clone();
                let mesh = subject.mesh();
                // Joints that hold nothing, such as ends and roots on the ground, go on so where they are known.
                let (weights, holders) = match subject.old_weights().filter(|_| kept) {
                    Some(old) => (old.clone(), Holders::Same),
                    None => (SkinWeights::normalized(mesh.positions().iter().map(|_| [(0, 1.0)]))?, Holders::All),
                };
                let rig = Rig::new(skeleton.clone(), mesh.clone(), weights)?;
                let weights = skinner.weights(&rig, holders, wish.influences, wish.seed).map_err(|e| anyhow!(e))?;
                let draws = vec![Draw { likelihood: f64::NAN, rewards: None }];
                Ok(GeneratedRig {
                    skeleton,
                    weights,
                    yaw: Yaw::NONE,
                    placed: None,
                    bodies: None,
                    apart: None,
                    human: false,
                    beside: None,
                    thinned: None,
                    sample: 0,
                    draws,
                })
            }
        }
    }
}

const ALONE: &str = "--weights is for a --checkpoint that writes skeletons only (a run or a file of task unirig_skeleton); \
                     for the skeleton that a file has, use `riglab skin`";
