//! AdamW by libtorch's fused kernel.

use std::collections::BTreeMap;

use riglab_torch::{AdamwStep, fused_adamw};
use tch::{Kind, Tensor};

use super::{OptimConfig, Pace};
use crate::NnError;
use crate::params::{ParamId, Params};

/// First and second moments and step counts, one group with decay and one without.
pub(super) struct Adamw {
    groups: [Group; 2],
}

#[derive(Default)]
struct Group {
    ids: Vec<ParamId>,
    m: Vec<Tensor>,
    v: Vec<Tensor>,
    steps: Vec<Tensor>,
}

/// Tensors of a step, by parameter.
pub(super) struct Lists {
    weights: Vec<Tensor>,
    grads: Vec<Tensor>,
    m: Vec<Tensor>,
    v: Vec<Tensor>,
    steps: Vec<Tensor>,
}

impl Lists {
    /// Moves the weights along the gradients times `shrink`.
    pub fn step(&self, c: &OptimConfig, weight_decay: f64, pace: Pace, shrink: f64) -> Result<(), NnError> {
        let Some(first) = self.weights.first() else { return Ok(()) };
        riglab_torch::foreach_add_scalar(&self.steps, 1.0)?;
        // The kernel divides gradients by the scale.
        let grad_scale =
            (shrink != 1.0).then(|| Tensor::from(1.0 / shrink).to_kind(Kind::Float).to_device(first.device()));
        let double = first.kind() == Kind::Double;
        if double && shrink != 1.0 {
            riglab_torch::foreach_mul(&self.grads, shrink)?;
        }
        fused_adamw(&AdamwStep {
            params: &self.weights,
            grads: &self.grads,
            m: &self.m,
            v: &self.v,
            steps: &self.steps,
            lr: c.adamw_lr * pace.factor,
            betas: (pace.beta1.unwrap_or(c.adamw_betas[0]), c.adamw_betas[1]),
            weight_decay,
            eps: c.adamw_eps,
            grad_scale: grad_scale.as_ref().filter(|_| !double),
        })?;
        Ok(())
    }
}

impl Adamw {
    pub fn new(params: &Params, ids: Vec<ParamId>, decayed: impl Fn(ParamId) -> bool) -> Self {
        let mut groups = [Group::default(), Group::default()];
        for id in ids {
            let weight = &params.weights()[id];
            let group = &mut groups[usize::from(!decayed(id))];
            group.ids.push(id);
            group.m.push(weight.detach().zeros_like());
            group.v.push(weight.detach().zeros_like());
            // The fused kernel counts in f32, on the parameter's device.
            group.steps.push(Tensor::zeros([], (Kind::Float, weight.device())));
        }
        Self { groups }
    }

    /// What has gradients, of those that are decayed and of those that are not.
    pub fn lists(&self, params: &Params, grads: &[Tensor]) -> [Lists; 2] {
        self.groups.each_ref().map(|group| {
            let live: Vec<usize> = (0..group.ids.len()).filter(|&i| grads[group.ids[i].index()].defined()).collect();
            let pick = |list: &[Tensor]| live.iter().map(|&i| list[i].shallow_clone()).collect::<Vec<_>>();
            Lists {
                weights: live.iter().map(|&i| params.weights()[group.ids[i]].detach()).collect(),
                grads: live.iter().map(|&i| grads[group.ids[i].index()].shallow_clone()).collect(),
                m: pick(&group.m),
                v: pick(&group.v),
                steps: pick(&group.steps),
            }
        })
    }

    pub fn state(&self, params: &Params) -> BTreeMap<String, Tensor> {
        let mut state = BTreeMap::new();
        for group in &self.groups {
            for (i, &id) in group.ids.iter().enumerate() {
                let name = params.name(id);
                state.insert(format!("adamw.m.{name}"), group.m[i].shallow_clone());
                state.insert(format!("adamw.v.{name}"), group.v[i].shallow_clone());
                state.insert(format!("adamw.step.{name}"), group.steps[i].shallow_clone());
            }
        }
        state
    }

    pub fn load(
        &mut self,
        params: &Params,
        read: &mut impl FnMut(&str) -> Result<Tensor, NnError>,
    ) -> Result<(), NnError> {
        for group in &mut self.groups {
            for (i, &id) in group.ids.iter().enumerate() {
                let name = params.name(id);
                group.m[i].copy_(&read(&format!("adamw.m.{name}"))?);
                group.v[i].copy_(&read(&format!("adamw.v.{name}"))?);
                group.steps[i].copy_(&read(&format!("adamw.step.{name}"))?);
            }
        }
        Ok(())
    }
}
