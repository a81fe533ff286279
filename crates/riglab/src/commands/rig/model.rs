//! What rigs: a model that writes skeleton and weights, or one of weights alone.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use riglab_asset::rigging::Subject;
use riglab_core::{Rig, SkinWeights};
use riglab_task::tokenrig::{Card, Draw, Made, Rigger, Wish, Yaw};
use riglab_task::unirig_skin::{Holders, Skinner};
use riglab_train::named_by;
use tch::Device;

use super::{Bones, Common};

/// A model with what to know about it.
pub struct Model {
    made_of: Kind,
    pub card: Card,
}

enum Kind {
    Whole(Box<Rigger>),
    Weights(Box<Skinner>),
}

impl Model {
    /// Of the folder of a run or of one of its checkpoints, or a file; without, the one that comes along.
    pub fn open(path: Option<&Path>, device: Device) -> Result<Self> {
        let whole = |(rigger, card)| Self { made_of: Kind::Whole(Box::new(rigger)), card };
        let weights = |path: &Path| {
            let (run, checkpoint) = named_by(path);
            Skinner::is_run(&run).then(|| Skinner::of_run(&run, &checkpoint, device).map(|own| (run, own)))
        };
        match path {
            None => Rigger::shipped(device).map(whole),
            Some(path) => match weights(path) {
                Some(found) => found.map(|(run, (skinner, state))| {
                    let name = run.display().to_string();
                    let card = Card { text: format!("The run {name}."), name, state };
                    Self { made_of: Kind::Weights(Box::new(skinner)), card }
                }),
                None => Rigger::open(path, device).map(whole),
            },
        }
        .map_err(|e| anyhow!(e))
    }

    /// Whether it draws what it makes.
    pub fn draws(&self) -> bool {
        matches!(self.made_of, Kind::Whole(_))
    }

    /// Joints of a skeleton that it writes, at most.
    pub fn most_joints(&self) -> usize {
        match &self.made_of {
            Kind::Whole(rigger) => rigger.most_joints(),
            Kind::Weights(_) => usize::MAX,
        }
    }

    /// Refuses what it cannot do.
    pub fn suits(&self, args: &Common, bones: &Bones) -> Result<()> {
        if self.draws() {
            return Ok(());
        }
        if matches!(bones, Bones::Predicted { .. }) {
            bail!(
                "{} is a run of task unirig_skin, which makes weights for a skeleton that is given: take `riglab skin`, or \
                 --skeleton keep or FILE",
                self.card.name
            );
        }
        if bones.completed() {
            bail!(
                "{} is a run of task unirig_skin, which adds no joints: leave --complete out, or take a model that writes \
                 skeletons",
                self.card.name
            );
        }
        if args.samples.is_some_and(|n| n > 1) {
            bail!("{} is a run of task unirig_skin, which draws nothing: leave --samples out", self.card.name);
        }
        if args.skins.is_some() {
            bail!("{} is a run of task unirig_skin, which draws nothing: leave --skins out", self.card.name);
        }
        Ok(())
    }

    /// A skeleton and weights for a model.
    pub fn make(&self, subject: &Subject, wish: &Wish<'_>, kept: bool) -> Result<Made> {
        match &self.made_of {
            Kind::Whole(rigger) => rigger.make(subject.mesh(), wish).map_err(|e| anyhow!(e)),
            Kind::Weights(skinner) => {
                let skeleton = wish.skeleton.context("no skeleton")?.clone();
                let mesh = subject.mesh();
                // Joints that hold nothing, such as ends and roots on the ground, go on so where they are known.
                let known = subject.old_rig().filter(|old| kept && old.weights().rows() == mesh.positions().len());
                let (weights, holders) = match known {
                    Some(old) => (old.weights().clone(), Holders::Same),
                    None => (SkinWeights::normalized(mesh.positions().iter().map(|_| [(0, 1.0)]))?, Holders::All),
                };
                let rig = Rig::new(skeleton.clone(), mesh.clone(), weights)?;
                let weights = skinner.weights(&rig, holders, wish.seed).map_err(|e| anyhow!(e))?;
                let draws = vec![Draw { likelihood: f64::NAN, rewards: None }];
                Ok(Made { skeleton, weights, yaw: Yaw::NONE, placed: None, bodies: None, sample: 0, draws })
            }
        }
    }
}
