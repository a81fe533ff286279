//! Muon: momentum whose matrices are orthogonalised before they are applied.
//!
//! buf = μ buf + g; d = g + μ buf (Nesterov) or buf; O = Newton-Schulz(d); W = W (1 - lr λ) - lr s O,
//! after Keller Jordan; s by shape, see [`MuonScale`]. Matrices of one shape are kept stacked, so
//! that one batched product serves them all.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

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
///
/// Each step is x = p x with p = a + b g + c g², g = x xᵀ. Where rows are long against their number, p and g are followed
/// instead, which are smaller: g = p g p, and x is multiplied by the product of all p in the end. That takes squares
/// of singular values, for which bfloat16 is too coarse.
pub fn newton_schulz(x: &Tensor) -> Tensor {
    let size = x.size();
    let (m, n) = (size[size.len() - 2], size[size.len() - 1]);
    // One batch axis, the wide way.
    let x = x.reshape([-1, m, n]);
    let mut x = if m > n { x.transpose(1, 2) } else { x };
    let norm = x.square().sum_dim_intlist([1i64, 2].as_slice(), true, None::<Kind>).sqrt();
    x = &x / norm.clamp_min(1e-7);
    if x.size()[2] >= 2 * x.size()[1] && x.kind() != Kind::BFloat16 {
        x = product_of_steps(&x.bmm(&x.transpose(1, 2))).bmm(&x);
    } else {
        let (a, b, c) = NS;
        for _ in 0..NS_STEPS {
            let gram = x.bmm(&x.transpose(1, 2));
            let poly = gram.baddbmm(&gram, &gram, b, c);
            x = x.baddbmm(&poly, &x, a, 1.0);
        }
    }
    let x = if m > n { x.transpose(1, 2) } else { x };
    x.reshape(size)
}

/// What all steps together multiply a matrix by, of its g = x xᵀ [k, m, m].
fn product_of_steps(gram: &Tensor) -> Tensor {
    let (a, b, c) = NS;
    let identity = Tensor::eye(gram.size()[1], (gram.kind(), gram.device())) * a;
    let (mut gram, mut product) = (gram.shallow_clone(), None::<Tensor>);
    for step in 0..NS_STEPS {
        let poly = gram.baddbmm(&gram, &gram, b, c) + &identity;
        if step + 1 < NS_STEPS {
            gram = poly.bmm(&gram).bmm(&poly);
        }
        product = Some(product.map_or_else(|| poly.shallow_clone(), |product| poly.bmm(&product)));
    }
    product.unwrap_or(identity)
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

    /// Moves its matrices along the gradients times `shrink`, at a rate of `factor` times the config's; `beside` is done
    /// meanwhile by a thread that has less to do.
    pub fn step(
        &mut self,
        params: &Params,
        grads: &[Tensor],
        c: &OptimConfig,
        (factor, shrink): (f64, f64),
        beside: impl FnOnce() -> Result<(), NnError> + Send,
    ) -> Result<(), NnError> {
        let rows: Vec<Vec<Row>> = self.stacks.iter().map(|stack| stack.rows(params, grads)).collect();
        // Threads take some matrices of every stack, while there are enough of those that are most work.
        let work = |rows: &&Vec<Row>| rows.iter().map(|row| row.gradient.numel() as i64 * row.least()).sum::<i64>();
        let most = rows.iter().max_by_key(work).map_or(0, Vec::len);
        let device = params.weights().tensors().first().map_or(Device::Cpu, Tensor::device);
        let threads = riglab_torch::threads_on(device).min(most / 2).max(1);
        let mut jobs: Vec<(i64, Vec<Vec<Row>>)> = (0..threads).map(|_| (0, Vec::new())).collect();
        for mut stack in rows {
            let each = stack.first().map_or(0, |row| row.gradient.numel() as i64 * row.least());
            let (even, mut over) = (stack.len() / threads, stack.len() % threads);
            // Those that do not come out even go to who has least to do.
            jobs.sort_by_key(|(work, _)| *work);
            for (work, job) in &mut jobs {
                let own = stack.split_off(stack.len() - even - usize::from(over > 0));
                over = over.saturating_sub(1);
                *work += each * own.len() as i64;
                job.push(own);
            }
        }
        jobs.sort_by_key(|(work, _)| *work);
        let mut beside = Some(beside);
        let jobs = jobs.into_iter().map(|(_, job)| {
            let beside = beside.take();
            move || {
                let mut stacks = job.into_iter().filter(|rows| !rows.is_empty());
                stacks.try_for_each(|rows| step(rows, c, factor, shrink))?;
                beside.map_or(Ok(()), |work| work())
            }
        });
        riglab_torch::side_by_side(jobs.collect::<Vec<_>>()).into_iter().collect()
    }

    pub fn state(&self, params: &Params) -> BTreeMap<String, Tensor> {
        let each = self.stacks.iter().flat_map(|s| s.ids.iter().zip(s.momentum.unbind(0)));
        each.map(|(&id, t)| (format!("muon.{}", params.name(id)), t)).collect()
    }

    pub fn load(
        &mut self,
        params: &Params,
        read: &mut impl FnMut(&str) -> Result<Tensor, NnError>,
    ) -> Result<(), NnError> {
        for s in &mut self.stacks {
            for (&id, mut row) in s.ids.iter().zip(s.momentum.unbind(0)) {
                row.copy_(&read(&format!("muon.{}", params.name(id)))?);
            }
        }
        Ok(())
    }
}

/// A matrix at a step.
struct Row {
    gradient: Tensor,
    weight: Tensor,
    /// Of the stack's memory.
    momentum: Tensor,
    decayed: bool,
}

impl Row {
    /// The smaller of its sides.
    fn least(&self) -> i64 {
        self.gradient.size().into_iter().min().unwrap_or(0)
    }
}

impl Stack {
    /// The matrices that have gradients.
    fn rows(&self, params: &Params, grads: &[Tensor]) -> Vec<Row> {
        let all = self.ids.iter().zip(&self.decayed).zip(self.momentum.unbind(0));
        let live = all.filter(|((id, _), _)| grads[id.index()].defined());
        live.map(|((&id, &decayed), momentum)| Row {
            gradient: grads[id.index()].shallow_clone(),
            weight: params.weights()[id].detach(),
            momentum,
            decayed,
        })
        .collect()
    }
}

/// A step of some matrices of one shape.
fn step(rows: Vec<Row>, c: &OptimConfig, factor: f64, shrink: f64) -> Result<(), NnError> {
    let each = |of: fn(&Row) -> &Tensor| rows.iter().map(|row| of(row).shallow_clone()).collect::<Vec<_>>();
    let (momentum, weights) = (each(|row| &row.momentum), each(|row| &row.weight));
    riglab_torch::foreach_mul(&momentum, c.muon_momentum)?;
    riglab_torch::foreach_add(&momentum, &each(|row| &row.gradient), shrink)?;
    let mut direction = Tensor::stack(&momentum, 0);
    if c.muon_nesterov {
        let _ = direction.g_mul_scalar_(c.muon_momentum);
        riglab_torch::foreach_add(&direction.unbind(0), &each(|row| &row.gradient), shrink)?;
    }
    let (kind, device) = (direction.kind(), direction.device());
    let half = c.muon_bf16 && kind == Kind::Float && (device != Device::Cpu || riglab_torch::multiplies_bf16());
    let update =
        if half { newton_schulz(&direction.to_kind(Kind::BFloat16)).to_kind(kind) } else { newton_schulz(&direction) };
    let (m, n) = (update.size()[1] as f64, update.size()[2] as f64);
    let scale = match c.muon_scale {
        MuonScale::Spectral => (m / n).max(1.0).sqrt(),
        MuonScale::MatchAdamw => 0.2 * m.max(n).sqrt(),
    };
    let lr = c.muon_lr * factor;
    if c.weight_decay > 0.0 {
        let held = rows.iter().filter(|row| row.decayed).map(|row| row.weight.shallow_clone());
        riglab_torch::foreach_mul(&held.collect::<Vec<_>>(), 1.0 - lr * c.weight_decay)?;
    }
    riglab_torch::foreach_add(&weights, &update.unbind(0), -lr * scale)?;
    Ok(())
}
