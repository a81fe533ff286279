//! A trained run at work on rigs that are no part of a corpus.

use std::path::Path;

use riglab_core::{DecodeRule, Rig, SkinWeights, Springs, Swing};
use riglab_nn::params::Params;
use riglab_nn::skin_stage::SkinModel;
use riglab_random::stream;
use riglab_report::own_cut;
use riglab_train::{Checkpoint, State, named_by};
use tch::Device;

use super::SkinTask;
use super::config::SkinTaskConfig;
use super::predict::{Predicted, Predictor};
use super::ready::{Ready, pool};
use crate::assets::Up;
use crate::bundle::{self, Card, Stored};
use crate::fsq_cvae::Prepared;
use crate::settings::{Settings, TaskSettings};

/// The decode rule's cut of a model that was not evaluated.
const CUT: f32 = 0.05;

/// The network of a run, with its weights.
pub struct Skinner {
    config: SkinTaskConfig,
    net: SkinModel,
    params: Params,
    device: Device,
    /// Where its evaluation found that the decode rule cuts best.
    cut: Option<f32>,
}

/// Which joints may hold something.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holders {
    /// Those that hold something already.
    Same,
    /// All.
    All,
}

impl Skinner {
    /// Reads a run's folder, that of one of its checkpoints, or a file of `riglab checkpoint export` or `import`; `None` where
    /// that is of another task. What cannot be read is, too: who looks for another kind says what is wrong.
    ///
    /// # Errors
    /// A sentence: what is wrong with it.
    pub fn open(path: &Path, device: Device) -> Result<Option<(Self, Card)>, String> {
        let (run, checkpoint) = named_by(path);
        if run.is_dir() {
            if !Settings::of_run(&run).is_ok_and(|settings| settings.are::<SkinTaskConfig>()) {
                return Ok(None);
            }
            let (own, state) = Self::of_run(&run, &checkpoint, device)?;
            return Ok(Some((own, Card::of_run(&run, &state))));
        }
        if bundle::kind(path).is_none_or(|kind| kind != SkinTaskConfig::TASK) {
            return Ok(None);
        }
        let stored = Stored::open(path)?;
        let own = Self::blank(&Settings::of_text(&path.display().to_string(), &stored.settings)?, device)?;
        stored.load("", &own.params)?;
        Ok(Some((own, stored.card)))
    }

    /// Of a run's checkpoint: `best`, `last` or `step-N`. The decode rule cuts where the run's evaluation found it best.
    ///
    /// # Errors
    /// A sentence: no run, or one of another task.
    pub fn of_run(run: &Path, checkpoint: &str, device: Device) -> Result<(Self, State), String> {
        let own = Self::blank(&Settings::of_run(run)?, device)?;
        let checkpoint = Checkpoint::open(&run.join("checkpoints").join(checkpoint)).map_err(|e| e.to_string())?;
        checkpoint.load_weights(&own.params).map_err(|e| e.to_string())?;
        let cut = own_cut(run, checkpoint.state().step).map(|own| own.cut as f32).or(own.cut);
        Ok((Self { cut, ..own }, checkpoint.state().clone()))
    }

    /// Without weights yet.
    fn blank(settings: &Settings, device: Device) -> Result<Self, String> {
        if !settings.are::<SkinTaskConfig>() {
            let (name, task, own) = (settings.name(), settings.task(), SkinTaskConfig::TASK);
            return Err(format!("{name}: a run of task `{task}`; give one of `{own}`"));
        }
        let config: SkinTaskConfig = settings.get()?;
        let (net, params) = SkinTask::blank(&config, device).map_err(|e| e.to_string())?;
        let cut = match config.eval.cuts[..] {
            [only] => Some(only),
            _ => None,
        };
        Ok(Self { config, net, params, device, cut })
    }

    /// Its settings and weights. Where its evaluation found a cut that is the only one of `eval.cuts`, so that what is made of
    /// them cuts there.
    pub fn into_parts(mut self) -> (SkinTaskConfig, Params) {
        if let Some(cut) = self.cut {
            self.config.eval.cuts = vec![cut];
        }
        (self.config, self.params)
    }

    /// The cut that it takes where no evaluation chose one.
    pub fn usual_cut(&self) -> Option<f32> {
        self.cut.is_none().then_some(CUT)
    }

    /// Whether it tells attributes of spring bones.
    pub fn has_attributes(&self) -> bool {
        self.config.model.attributes
    }

    /// New weights for a rig's skeleton: at most so many joints hold a vertex, four where it is not told. `seed` draws the
    /// points that the network sees.
    ///
    /// # Errors
    /// When no joint may hold anything, or the network gives what is no number.
    pub fn weights(
        &self,
        rig: &Rig,
        holders: Holders,
        influences: Option<usize>,
        seed: u64,
    ) -> Result<SkinWeights, String> {
        let (ready, found) = self.predict(rig, holders, seed)?;
        let bones = &ready.rig.bones;
        let rule = DecodeRule { cut: self.cut.unwrap_or(CUT), influences: influences.unwrap_or(4).max(1) };
        let dense = self.predictor().spread(&ready, self.config.eval_cloud().points, found.dense);
        let rows = dense.chunks_exact(bones.len()).map(|row| {
            let mut row = row.to_vec();
            rule.apply(&mut row);
            let held = row.into_iter().zip(bones).filter(|(w, _)| *w > 0.0);
            held.map(|(w, bone)| (bone.joint.0, f64::from(w))).collect::<Vec<_>>()
        });
        SkinWeights::normalized(rows).map_err(|e| e.to_string())
    }

    /// The rig's springs with attributes as the network tells them. What swings, and what stops it, stays; so do the
    /// attributes of joints that hold nothing, which the network does not know.
    ///
    /// # Errors
    /// For a network without attributes, for a rig without springs, and when the network gives what is no number.
    pub fn springs(&self, rig: &Rig, seed: u64) -> Result<Springs, String> {
        if !self.has_attributes() {
            return Err("the run has model.attributes = false: it predicts weights only".into());
        }
        if rig.springs().springs().is_empty() {
            return Err("there are no spring bones whose attributes could be told".into());
        }
        let (ready, found) = self.predict(rig, Holders::Same, seed)?;
        let (_, map) = rig.normalized();
        let mut told: Vec<Option<Swing>> = vec![None; rig.skeleton().len()];
        for (bone, row) in ready.rig.bones.iter().zip(&found.attributes) {
            told[bone.joint.index()] = Some(swing(row, 1.0 / map.scale, self.config.data.up));
        }
        let (mut springs, colliders, groups) = rig.springs().clone().into_parts();
        for joint in springs.iter_mut().flat_map(|s| &mut s.joints) {
            joint.swing = told[joint.joint.index()].unwrap_or(joint.swing);
        }
        Springs::new(springs, colliders, groups).map_err(|e| e.to_string())
    }

    fn predict(&self, rig: &Rig, holders: Holders, seed: u64) -> Result<(Ready, Predicted), String> {
        // In the network's axes.
        let (cube, _) = self.config.data.up.rig(rig).map_err(|e| e.to_string())?.normalized();
        let prepared = Prepared::of(String::new(), cube, holders == Holders::All);
        if prepared.bones.is_empty() {
            return Err("no joint holds a vertex".into());
        }
        let (c, cloud) = (&self.config, self.config.eval_cloud());
        let mut points = pool(&prepared, &cloud, &mut stream(seed, "skin of a file", &[]));
        points.extend((0..prepared.rig.mesh().positions().len() as u32).map(|v| prepared.vertex(v)));
        let ready = Ready::new(prepared, points, c.sampling.measured());
        let found = self.predictor().predict(&ready, cloud.points)?;
        Ok((ready, found))
    }

    fn predictor(&self) -> Predictor<'_> {
        Predictor { config: &self.config, net: &self.net, weights: self.params.weights(), device: self.device }
    }
}

/// A row of attributes as VRM may have them, told by a network that has `up` up; `size` takes lengths of the cube to the
/// rig's own.
fn swing(row: &[f32; 7], size: f32, up: Up) -> Swing {
    let finite = |x: f32| if x.is_finite() { x } else { 0.0 };
    let [stiffness, drag, power, x, y, z, radius] = row.map(finite);
    let direction = glam::Vec3::new(x, y, z).try_normalize();
    Swing {
        stiffness: stiffness.max(0.0),
        drag: drag.clamp(0.0, 1.0),
        gravity_power: power.max(0.0),
        gravity_direction: direction.map_or(Swing::default().gravity_direction, |d| up.back(d.into())),
        hit_radius: radius.max(0.0) * size,
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Skeleton};
    use riglab_nn::skin_stage::{PointEncoder, SkinModelConfig};

    use super::*;
    use crate::tokenrig::testing::tetrahedron;

    #[test]
    fn any_row_is_a_sound_swing() {
        let told = swing(&[0.5, 0.25, 2.0, 0.0, -3.0, 4.0, 0.1], 2.0, Up::Y);
        assert_eq!((told.stiffness, told.drag, told.gravity_power, told.hit_radius), (0.5, 0.25, 2.0, 0.2));
        assert!((told.gravity_direction[1] + 0.6).abs() < 1e-6 && (told.gravity_direction[2] - 0.8).abs() < 1e-6);
        let down = swing(&[0.5, 0.25, 2.0, 0.0, 0.0, -2.0, 0.1], 2.0, Up::Z).gravity_direction;
        assert_eq!(down, [0.0, -1.0, 0.0]);
        // What has no direction pulls down, whichever way is up in the network's axes.
        for up in [Up::Y, Up::Z] {
            let odd = swing(&[-1.0, 7.0, f32::NAN, 0.0, 0.0, 0.0, -2.0], 1.0, up);
            assert_eq!(odd, Swing { stiffness: 0.0, drag: 1.0, ..Swing::default() });
        }
    }

    #[test]
    fn what_is_made_of_an_evaluated_run_cuts_where_that_found_it_best() {
        let of = |config: &SkinTaskConfig| {
            let text = toml::to_string(config).unwrap();
            Skinner::blank(&Settings::of_text("test", &text).unwrap(), Device::Cpu).unwrap()
        };
        let config = SkinTaskConfig { task: SkinTaskConfig::TASK.into(), ..SkinTaskConfig::default() };
        assert_eq!(of(&config).cut, None);
        assert_eq!(of(&config).into_parts().0.eval.cuts, config.eval.cuts, "nothing was found");
        let (evaluated, _) = Skinner { cut: Some(0.16), ..of(&config) }.into_parts();
        assert_eq!(of(&evaluated).cut, Some(0.16));
    }

    #[test]
    fn a_diverged_network_is_told_as_such() {
        let joint =
            |k: u16| Joint { name: format!("{k}"), parent: (k > 0).then_some(JointId(0)), head: [f32::from(k); 3] };
        let skeleton = Skeleton::new((0..2).map(joint).collect()).unwrap();
        let weights = SkinWeights::normalized((0..4u16).map(|v| [(v % 2, 1.0)])).unwrap();
        let rig = Rig::new(skeleton, tetrahedron(), weights).unwrap();
        let mut config = SkinTaskConfig { task: SkinTaskConfig::TASK.into(), ..SkinTaskConfig::default() };
        let SkinModelConfig { width, heads, mlp, pair_width, shape, bones, points, .. } = &mut config.model;
        (*width, *heads, *mlp, *pair_width) = (16, 2, 16, 8);
        (shape.tokens, shape.drawn, shape.layers, shape.width, shape.heads) = (4, 2, 1, 16, 2);
        (bones.embed, bones.layers, points.encoder, points.layers) = (8, 1, PointEncoder::Light, 1);
        (config.eval.points, config.sampling.resolution) = (32, 16);
        let (net, params) = SkinTask::network(&config, Device::Cpu).unwrap();
        let own = Skinner { config, net, params, device: Device::Cpu, cut: None };
        assert!(own.weights(&rig, Holders::All, None, 0).is_ok());
        let _no_grad = tch::no_grad_guard();
        own.params.weights().tensors().iter().for_each(|t| drop(t.shallow_clone().fill_(f64::NAN)));
        let error = own.weights(&rig, Holders::All, None, 0).unwrap_err();
        assert!(error.contains("its training diverged"), "{error}");
    }
}
