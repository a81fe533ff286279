//! Optimizers with state that can be saved.
//!
//! [`Optimizer`] gives each parameter to Muon or AdamW by its role and keeps plain tensors, named
//! after the parameters, so that a checkpoint holds all there is. A parameter without gradient in a
//! step is left alone: neither moved nor decayed.

mod adamw;
mod ema;
mod muon;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use tch::Tensor;

pub use ema::Ema;
pub use muon::{MuonScale, newton_schulz};

use crate::NnError;
use crate::params::{Params, Role};

/// What the optimizers reckon with in single precision, with room on both sides: an ε that is 0 there divides 0 by 0.
const SMALLEST: f64 = 1e-30;
const LARGEST: f64 = 1e30;

/// Which optimizer moves what, and how.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OptimConfig {
    /// Roles of the matrices that Muon moves; AdamW moves the rest. The paper: `["attention"]`.
    pub muon: Vec<Role>,
    /// Peak learning rate of Muon's parameters.
    pub muon_lr: f64,
    /// Muon's momentum.
    pub muon_momentum: f64,
    /// Whether Muon looks ahead by one momentum step.
    pub muon_nesterov: bool,
    /// How Muon's step depends on a matrix's shape.
    pub muon_scale: MuonScale,
    /// Newton-Schulz in bfloat16 on processors that multiply it faster (AMX, or AMD's `avx512_bf16`): 2.5 to 4 times as
    /// fast there, off by up to 1e-3.
    pub muon_bf16: bool,
    /// Peak learning rate of AdamW's parameters.
    pub adamw_lr: f64,
    /// AdamW's decay of first and second moments.
    pub adamw_betas: [f64; 2],
    /// AdamW's ε.
    pub adamw_eps: f64,
    /// Decoupled weight decay of both, times the learning rate.
    pub weight_decay: f64,
    /// Roles that are decayed.
    pub decayed: Vec<Role>,
    /// Gradients are scaled down to this norm over all parameters; 0 leaves them.
    pub clip: f64,
}

impl Default for OptimConfig {
    /// The proposed values for what the papers leave open (`peers_skintokens`, section 11).
    fn default() -> Self {
        use Role::{Attention, Embedding, FeedForward, Projection, Vector};
        Self {
            muon: vec![Attention],
            muon_lr: 8e-4,
            muon_momentum: 0.95,
            muon_nesterov: true,
            muon_scale: MuonScale::MatchAdamw,
            muon_bf16: true,
            adamw_lr: 8e-4,
            adamw_betas: [0.9, 0.95],
            adamw_eps: 1e-8,
            weight_decay: 0.1,
            decayed: vec![Attention, FeedForward, Projection, Embedding, Vector],
            clip: 1.0,
        }
    }
}

impl OptimConfig {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        for (key, value) in [("muon_lr", self.muon_lr), ("adamw_lr", self.adamw_lr)] {
            if !(value > 0.0 && value <= LARGEST) {
                return Err((key, format!("{key} = {value:?} must be above 0, and at most {LARGEST:?}")));
            }
        }
        if !(SMALLEST..=LARGEST).contains(&self.adamw_eps) {
            let eps = self.adamw_eps;
            return Err(("adamw_eps", format!("adamw_eps = {eps:?} must lie in [{SMALLEST:?}, {LARGEST:?}]")));
        }
        for (key, value) in [
            ("muon_momentum", self.muon_momentum),
            ("adamw_betas", self.adamw_betas[0]),
            ("adamw_betas", self.adamw_betas[1]),
        ] {
            if !(0.0..1.0).contains(&value) {
                return Err((key, format!("{key}: {value} must be at least 0 and below 1")));
            }
        }
        for (key, value) in [("weight_decay", self.weight_decay), ("clip", self.clip)] {
            if !(0.0..=LARGEST).contains(&value) {
                return Err((key, format!("{key} = {value:?} must lie in [0, {LARGEST:?}]")));
            }
        }
        if let Some(role) = self.muon.iter().find(|r| matches!(r, Role::Vector)) {
            return Err(("muon", format!("muon orthogonalises matrices, it cannot move {role:?} parameters")));
        }
        Ok(())
    }
}

/// Where a run stands in its schedule.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pace {
    /// Of the peak learning rates.
    pub factor: f64,
    /// AdamW's decay of first moments, in place of the config's.
    pub beta1: Option<f64>,
}

/// What a step found and did.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepStats {
    /// Norm of all gradients before clipping.
    pub grad_norm: f64,
    /// Whether the step was taken; not if the norm was not finite.
    pub taken: bool,
}

/// Muon and AdamW over the parameters of one network.
pub struct Optimizer {
    config: OptimConfig,
    muon: muon::Muon,
    adamw: adamw::Adamw,
}

impl Optimizer {
    /// Fresh state, of the parameters that learn.
    pub fn new(params: &Params, config: OptimConfig) -> Self {
        let is_muon = |id| config.muon.contains(&params.role(id)) && params.shape(id).len() == 2;
        let (muon, adamw): (Vec<_>, Vec<_>) = params.ids().filter(|&id| params.learns(id)).partition(|&id| is_muon(id));
        let decayed = |id| config.decayed.contains(&params.role(id));
        Self { muon: muon::Muon::new(params, muon, decayed), adamw: adamw::Adamw::new(params, adamw, decayed), config }
    }

    /// Moves the master weights along the gradients, given in parameter order; undefined ones are
    /// skipped. `lr_factor` is the schedule's, 1 at the peak. Gradients of another kind (bfloat16)
    /// are widened.
    ///
    /// # Errors
    /// libtorch's message.
    pub fn step(&mut self, params: &Params, grads: Vec<Tensor>, lr_factor: f64) -> Result<StepStats, NnError> {
        self.step_at(params, grads, Pace { factor: lr_factor, beta1: None })
    }

    /// As [`Self::step`], with a momentum that is the schedule's too.
    ///
    /// # Errors
    /// libtorch's message.
    pub fn step_at(&mut self, params: &Params, mut grads: Vec<Tensor>, pace: Pace) -> Result<StepStats, NnError> {
        let _no_grad = tch::no_grad_guard();
        let kind = params.weights().kind();
        for g in &mut grads {
            if g.defined() && g.kind() != kind {
                *g = g.to_kind(kind);
            }
        }
        let defined: Vec<&Tensor> = grads.iter().filter(|g| g.defined()).collect();
        let grad_norm = riglab_torch::global_norm(&defined)?;
        if !grad_norm.is_finite() {
            return Ok(StepStats { grad_norm, taken: false });
        }
        let c = &self.config;
        let shrink = if c.clip > 0.0 && grad_norm > c.clip { c.clip / (grad_norm + 1e-6) } else { 1.0 };
        let others = self.adamw.lists(params, &grads);
        self.muon.step(params, &grads, c, (pace.factor, shrink), move || {
            others.into_iter().zip([c.weight_decay, 0.0]).try_for_each(|(own, decay)| own.step(c, decay, pace, shrink))
        })?;
        Ok(StepStats { grad_norm, taken: true })
    }

    /// All state by name, for a checkpoint.
    pub fn state(&self, params: &Params) -> BTreeMap<String, Tensor> {
        let mut state = self.muon.state(params);
        state.extend(self.adamw.state(params));
        state
    }

    /// Takes state that [`Self::state`] gave.
    ///
    /// # Errors
    /// [`NnError::Mismatch`] when it is that of another network or config.
    pub fn load_state(&mut self, params: &Params, state: &BTreeMap<String, Tensor>) -> Result<(), NnError> {
        let shapes = state.iter().map(|(name, t)| (name.clone(), t.size())).collect();
        self.load_each(params, &shapes, |name| Ok(state[name].shallow_clone()))
    }

    /// As [`Self::load_state`], of tensors of these shapes that are read one at a time: they are never in memory beside the
    /// optimizer's own.
    ///
    /// # Errors
    /// As [`Self::load_state`], before anything is read, and those of `read`.
    pub fn load_each(
        &mut self,
        params: &Params,
        shapes: &BTreeMap<String, Vec<i64>>,
        mut read: impl FnMut(&str) -> Result<Tensor, NnError>,
    ) -> Result<(), NnError> {
        self.check(params, shapes)?;
        let _no_grad = tch::no_grad_guard();
        self.muon.load(params, &mut read)?;
        self.adamw.load(params, &mut read)
    }

    /// Whether names and shapes are those of this optimizer's state.
    fn check(&self, params: &Params, shapes: &BTreeMap<String, Vec<i64>>) -> Result<(), NnError> {
        let own = self.state(params);
        let missing: Vec<_> = own
            .iter()
            .filter(|(name, t)| shapes.get(*name).is_none_or(|s| *s != t.size()))
            .map(|(name, _)| format!("`{name}` is missing or of another shape"))
            .collect();
        let unknown = shapes.keys().filter(|k| !own.contains_key(*k)).map(|k| format!("`{k}` is unknown"));
        let faults: Vec<_> = missing.into_iter().chain(unknown).collect();
        if !faults.is_empty() {
            let first = faults.iter().take(3).cloned().collect::<Vec<_>>().join(", ");
            return Err(NnError::Mismatch { count: faults.len(), tensors: own.len(), first });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_keep_within_single_precision() {
        let key = |change: fn(&mut OptimConfig)| {
            let mut config = OptimConfig::default();
            change(&mut config);
            config.validate().map_err(|(key, _)| key)
        };
        assert_eq!(key(|c| (c.muon_lr, c.adamw_lr, c.clip) = (1e-30, 1e30, 0.0)), Ok(()));
        assert_eq!(key(|c| c.muon_lr = 1e300), Err("muon_lr"));
        assert_eq!(key(|c| c.adamw_lr = 0.0), Err("adamw_lr"));
        assert_eq!([key(|c| c.adamw_eps = 1e-40), key(|c| c.adamw_eps = f64::NAN)], [Err("adamw_eps"); 2]);
        assert_eq!([key(|c| c.weight_decay = 1e300), key(|c| c.weight_decay = -0.1)], [Err("weight_decay"); 2]);
        assert_eq!(key(|c| c.clip = 1e300), Err("clip"));
    }
}
