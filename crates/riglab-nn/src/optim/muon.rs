//! Muon: momentum whose matrices are orthogonalised before they are applied.
//!
//! buf = μ buf + g; d = g + μ buf (Nesterov) or buf; O = Newton-Schulz(d); W = W (1 - lr λ) - lr s O,
//! after Keller Jordan; s by shape, see [`MuonScale`]. Matrices of one shape are kept stacked, so
//! that one batched product serves them all.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

use super::OptimConfig;
use crate::NnError;
use crate::params::{ParamId, Params};

/// How the step of an [rows, columns] matrix is scaled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum MuonScale {
    /// √max(1, rows / columns), Keller Jordan's.
    Spectral,
    /// 0.2 √max(rows, columns): the step's RMS is AdamW's, so both share a learning rate (Moonshot,
    /// cited by SkinTokens).
    MatchAdamw,
}

/// Coefficients of the quintic iteration.
const NS: (f64, f64, f64) = (3.4445, -4.7750, 2.0315);
const NS_STEPS: usize = 5;

/// The orthogonal factor of each matrix of x [.., m, n], approximately: singular values end between
/// 0.7 and 1.2.
pub fn newton_schulz(x: &Tensor) -> Tensor {
    let size = x.size();
    let (m, n) = (size[size.len() - 2], size[size.len() - 1]);
    // One batch axis, the wide way.
    let x = x.reshape([-1, m, n]);
    let mut x = if m > n { x.transpose(1, 2) } else { x };
    let norm = x.square().sum_dim_intlist([1i64, 2].as_slice(), true, None::<Kind>).sqrt();
    x = &x / norm.clamp_min(1e-7);
    let (a, b, c) = NS;
    for _ in 0..NS_STEPS {
        let gram = x.bmm(&x.transpose(1, 2));
        let poly = gram.baddbmm(&gram, &gram, b, c);
        x = x.baddbmm(&poly, &x, a, 1.0);
    }
    let x = if m > n { x.transpose(1, 2) } else { x };
    x.reshape(size)
}

/// Momenta of all matrices, one stack per shape.
pub(super) struct Muon {
    stacks: Vec<Stack>,
}

struct Stack {
    ids: Vec<ParamId>,
    decayed: Vec<bool>,
    /// [k, m, n]
    momentum: Tensor,
}

impl Muon {
    pub fn new(params: &Params, ids: Vec<ParamId>, decayed: impl Fn(ParamId) -> bool) -> Self {
        let mut by_shape: BTreeMap<Vec<i64>, Vec<ParamId>> = BTreeMap::new();
        for id in ids {
            by_shape.entry(params.shape(id).to_vec()).or_default().push(id);
        }
        let stacks = by_shape.into_iter().map(|(shape, ids)| {
            let weight = &params.weights()[ids[0]];
            let size = [ids.len() as i64, shape[0], shape[1]];
            let momentum = Tensor::zeros(size, (weight.kind(), weight.device()));
            Stack { decayed: ids.iter().map(|&id| decayed(id)).collect(), ids, momentum }
        });
        Self { stacks: stacks.collect() }
    }

    pub fn step(
        &mut self,
        params: &Params,
        grads: &[Tensor],
        c: &OptimConfig,
        factor: f64,
        shrink: f64,
    ) -> Result<(), NnError> {
        for stack in &mut self.stacks {
            stack.step(params, grads, c, factor, shrink)?;
        }
        Ok(())
    }

    pub fn state(&self, params: &Params) -> BTreeMap<String, Tensor> {
        let each = self.stacks.iter().flat_map(|s| s.ids.iter().zip(s.momentum.unbind(0)));
        each.map(|(&id, t)| (format!("muon.{}", params.name(id)), t)).collect()
    }

    pub fn load(&mut self, params: &Params, state: &BTreeMap<String, Tensor>) {
        for s in &mut self.stacks {
            for (&id, mut row) in s.ids.iter().zip(s.momentum.unbind(0)) {
                row.copy_(&state[&format!("muon.{}", params.name(id))]);
            }
        }
    }
}

impl Stack {
    fn step(
        &mut self,
        params: &Params,
        grads: &[Tensor],
        c: &OptimConfig,
        factor: f64,
        shrink: f64,
    ) -> Result<(), NnError> {
        let live: Vec<usize> = (0..self.ids.len()).filter(|&i| grads[self.ids[i].index()].defined()).collect();
        if live.is_empty() {
            return Ok(());
        }
        let g = Tensor::stack(&live.iter().map(|&i| &grads[self.ids[i].index()]).collect::<Vec<_>>(), 0);
        let mu = c.muon_momentum;
        // All at once, or the rows that have gradients.
        let (mut momentum, rows) = if live.len() == self.ids.len() {
            (self.momentum.shallow_clone(), None)
        } else {
            let rows = Tensor::from_slice(&live.iter().map(|&i| i as i64).collect::<Vec<_>>()).to_device(g.device());
            (self.momentum.index_select(0, &rows), Some(rows))
        };
        let g = if shrink == 1.0 { g } else { g * shrink };
        let _ = momentum.g_mul_scalar_(mu);
        let _ = momentum.g_add_(&g);
        let direction = if c.muon_nesterov { g + &momentum * mu } else { momentum.shallow_clone() };
        if let Some(rows) = rows {
            let _ = self.momentum.index_copy_(0, &rows, &momentum);
        }
        let kind = direction.kind();
        let update = if c.muon_bf16 && kind == Kind::Float {
            newton_schulz(&direction.to_kind(Kind::BFloat16)).to_kind(kind)
        } else {
            newton_schulz(&direction)
        };
        let (m, n) = (update.size()[1] as f64, update.size()[2] as f64);
        let scale = match c.muon_scale {
            MuonScale::Spectral => (m / n).max(1.0).sqrt(),
            MuonScale::MatchAdamw => 0.2 * m.max(n).sqrt(),
        };
        let lr = c.muon_lr * factor;
        let weights: Vec<Tensor> = live.iter().map(|&i| params.weights()[self.ids[i]].detach()).collect();
        if c.weight_decay > 0.0 {
            let held: Vec<Tensor> =
                live.iter().zip(&weights).filter(|(i, _)| self.decayed[**i]).map(|(_, w)| w.shallow_clone()).collect();
            riglab_torch::foreach_mul(&held, 1.0 - lr * c.weight_decay)?;
        }
        riglab_torch::foreach_add(&weights, &update.unbind(0), -lr * scale)?;
        Ok(())
    }
}
