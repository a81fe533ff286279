//! Multi-head attention.

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use super::{LayerNorm, Linear, affine, taken};
use crate::params::{Role, Scope, Weights};

/// How projected channels are dealt to heads.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum HeadSplit {
    /// Each of query, key and value is cut into heads: head 0 takes the first rows of each matrix.
    #[default]
    Separate,
    /// SkinTokens' released code: \[q|k|v\] (in cross-attention \[k|v\]) is cut into heads as one, and
    /// each head takes its own thirds (halves). The same functions with rows of the matrices dealt
    /// otherwise; needed to read released weights.
    Fused,
}

/// Attention of queries x over keys and values y; without y over x itself. The projections of
/// query, key and value have no bias, the output has one. No mask.
#[derive(Clone)]
pub struct Attention {
    to_q: Linear,
    to_k: Linear,
    to_v: Linear,
    to_out: Linear,
    heads: i64,
    split: HeadSplit,
}

/// Keys and values of b rows.
pub struct KeyValue(Keys);

enum Keys {
    /// Each [b, h, s, d / h].
    Apart(Tensor, Tensor),
    /// As [`riglab_torch::keys`] makes them.
    Together(Tensor),
}

impl KeyValue {
    /// How many batch rows.
    pub fn rows(&self) -> i64 {
        match &self.0 {
            Keys::Apart(t, _) | Keys::Together(t) => t.size()[0],
        }
    }
}

impl Attention {
    /// `context` is the width of y.
    pub fn new(mut at: Scope, width: usize, context: usize, heads: usize, split: HeadSplit) -> Self {
        assert!(width.is_multiple_of(heads), "width {width} is not divisible by {heads} heads: check the config first");
        let role = Role::Attention;
        Self {
            to_q: Linear::new(at.sub("to_q"), role, width, width, false),
            to_k: Linear::new(at.sub("to_k"), role, context, width, false),
            to_v: Linear::new(at.sub("to_v"), role, context, width, false),
            to_out: Linear::new(at.sub("to_out").sub(0), role, width, width, true),
            heads: heads as i64,
            split,
        }
    }

    /// x [b, t, d] over itself.
    pub fn over_itself(&self, w: &Weights, x_btd: &Tensor) -> Tensor {
        // One product for all three: the weights are small beside the activations.
        let all = Tensor::cat(&[&w[self.to_q.weight()], &w[self.to_k.weight()], &w[self.to_v.weight()]], 0);
        let parts = self.heads_of(&affine(x_btd, &all, None), 3);
        self.attend(w, &parts[0], &parts[1], &parts[2])
    }

    /// Keys and values of y [b, s, c]: computed once where several queries share them.
    pub fn keys(&self, w: &Weights, y_bsc: &Tensor) -> KeyValue {
        let both = Tensor::cat(&[&w[self.to_k.weight()], &w[self.to_v.weight()]], 0);
        let mut parts = self.heads_of(&affine(y_bsc, &both, None), 2).into_iter();
        match (parts.next(), parts.next()) {
            (Some(k), Some(v)) => KeyValue(Keys::Apart(k, v)),
            _ => unreachable!("two parts were asked for"),
        }
    }

    /// As [`Self::keys`] of LN(y).
    pub fn keys_of(&self, w: &Weights, norm: &LayerNorm, y_bsc: &Tensor) -> KeyValue {
        if !riglab_torch::has_block(y_bsc) {
            return self.keys(w, &norm.forward(w, y_bsc));
        }
        let weights = [&w[self.to_k.weight()], &w[self.to_v.weight()]];
        KeyValue(Keys::Together(taken(riglab_torch::keys(y_bsc, norm.norm(w), self.dealt(&weights)))))
    }

    /// x + [`Self::over_itself`] of LN(x).
    pub fn added_over_itself(&self, w: &Weights, norm: &LayerNorm, x: &Tensor) -> Tensor {
        match self.to_out.map(w).filter(|_| riglab_torch::has_block(x)) {
            Some(out) => {
                let weights = [&w[self.to_q.weight()], &w[self.to_k.weight()], &w[self.to_v.weight()]];
                taken(riglab_torch::own_attention(x, norm.norm(w), self.dealt(&weights), out))
            }
            None => x + self.over_itself(w, &norm.forward(w, x)),
        }
    }

    /// x + [`Self::over`] of LN(x), of x as often as keys are read by it.
    pub fn added_over(&self, w: &Weights, norm: &LayerNorm, x: &Tensor, y: &KeyValue) -> Tensor {
        match (&y.0, self.to_out.map(w)) {
            (Keys::Together(keys), Some(out)) if riglab_torch::has_block(x) && y.rows() <= x.size()[0] => {
                let weights = [&w[self.to_q.weight()]];
                taken(riglab_torch::other_attention(x, norm.norm(w), self.dealt(&weights), keys, out))
            }
            _ => {
                let read = self.over(w, &norm.forward(w, x), y);
                if read.size()[0] == x.size()[0] { x + read } else { repeated(x, read.size()[0]) + read }
            }
        }
    }

    fn dealt<'a>(&self, weights: &'a [&'a Tensor]) -> riglab_torch::Heads<'a> {
        riglab_torch::Heads { weights, bias: None, count: self.heads, fused: self.split == HeadSplit::Fused }
    }

    /// x [b, t, d] over keys made by [`Self::keys`], to [b', t, d]; see `Block::forward` for keys with
    /// other than b rows.
    pub fn over(&self, w: &Weights, x_btd: &Tensor, y: &KeyValue) -> Tensor {
        let (b, t, d) = x_btd.size3().expect("three axes");
        let rows = y.rows();
        let [k, v] = match &y.0 {
            Keys::Apart(k, v) => [k.shallow_clone(), v.shallow_clone()],
            Keys::Together(both) => <[Tensor; 2]>::try_from(self.heads_of(both, 2)).expect("two parts"),
        };
        let q = self.to_q.forward(w, x_btd);
        let heads = |q: Tensor, b: i64, t: i64| q.view([b, t, self.heads, d / self.heads]).transpose(1, 2);
        if rows < b {
            let q = heads(q, rows, b * t / rows);
            return self.attend(w, &q, &k, &v).view([b, t, d]);
        }
        let mut q = heads(q, b, t);
        if rows > b {
            q = q.unsqueeze(1).expand([-1, rows / b, -1, -1, -1], false).flatten(0, 1);
        }
        self.attend(w, &q, &k, &v)
    }

    /// [b, t, n * d] to n tensors [b, h, t, d / h].
    fn heads_of(&self, x: &Tensor, n: i64) -> Vec<Tensor> {
        let (b, t, nd) = x.size3().expect("three axes");
        let per_head = nd / n / self.heads;
        match self.split {
            HeadSplit::Separate => x.view([b, t, n, self.heads, per_head]).permute([2, 0, 3, 1, 4]).unbind(0),
            HeadSplit::Fused => x.view([b, t, self.heads, n, per_head]).permute([3, 0, 2, 1, 4]).unbind(0),
        }
    }

    fn attend(&self, w: &Weights, q: &Tensor, k: &Tensor, v: &Tensor) -> Tensor {
        let mixed = mix(q, k, v, false);
        let size = q.size();
        let (b, t) = (size[0], size[2]);
        self.to_out.forward(w, &mixed.transpose(1, 2).reshape([b, t, size[1] * size[3]]))
    }
}

/// x [b, t, d] with each row `rows / b` times in a row.
fn repeated(x: &Tensor, rows: i64) -> Tensor {
    x.unsqueeze(1).expand([-1, rows / x.size()[0], -1, -1], false).flatten(0, 1)
}

/// softmax(q kᵀ / √d) v, each [b, h, t, d]; `causal`: the last query sees all keys, the one before it all
/// but the last, and so on.
///
/// libtorch's fused kernel is the fastest in fp32 on the CPU, but its bfloat16 backward pass is up to
/// ten times slower than the plain products. Those need memory for all scores, which the sequences here have
/// room for; of long ones a run of queries at a time asks the keys that it may see, half of all pairs.
pub(crate) fn mix(q: &Tensor, k: &Tensor, v: &Tensor, causal: bool) -> Tensor {
    let (t, s) = (q.size()[2], k.size()[2]);
    if !(q.kind() == Kind::BFloat16 && q.device() == Device::Cpu) {
        // The kernel's own rule counts places from the first key, so it fits where there are as many.
        let seen = (causal && s != t).then(|| Tensor::ones([t, s], (Kind::Bool, q.device())).tril(s - t));
        return Tensor::scaled_dot_product_attention(q, k, v, seen.as_ref(), 0.0, causal && s == t, None, false);
    }
    let q = q * (1.0 / (q.size()[3] as f64).sqrt());
    if !causal {
        return q.matmul(&k.transpose(-2, -1)).softmax(-1, None::<Kind>).matmul(v);
    }
    let run = |from: i64| {
        let to = (from + RUN).min(t);
        let seen = s - t + to;
        let [k, v] = [k, v].map(|x| if seen < s { x.narrow(2, 0, seen) } else { x.shallow_clone() });
        let own = if to - from < t { q.narrow(2, from, to - from) } else { q.shallow_clone() };
        let mut scores = own.matmul(&k.transpose(-2, -1));
        // Keys after a query's own place.
        let hidden = Tensor::full([to - from, seen], f64::NEG_INFINITY, (q.kind(), q.device())).triu(s - t + from + 1);
        let _ = scores.g_add_(&hidden);
        scores.softmax(-1, None::<Kind>).matmul(&v)
    };
    let mut runs: Vec<Tensor> = (0..t).step_by(RUN as usize).map(run).collect();
    if runs.len() == 1 { runs.remove(0) } else { Tensor::cat(&runs, 2) }
}

/// Heads of keys or values [b, g, s, e] for every head of queries, so many over each: [b, h, s, e].
pub(crate) fn shared_heads(x: &Tensor, group: i64) -> Tensor {
    if group == 1 { x.shallow_clone() } else { x.repeat_interleave_self_int(group, 1, None::<i64>) }
}

/// Queries of [`mix`]'s runs.
const RUN: i64 = 256;

#[cfg(test)]
mod tests {
    use super::*;

    /// Outputs and gradients of queries, keys and values.
    fn passed(inputs: &[Tensor], kind: Kind, causal: bool) -> Vec<Tensor> {
        let own: Vec<Tensor> = inputs.iter().map(|x| x.to_kind(kind).set_requires_grad(true)).collect();
        let out = mix(&own[0], &own[1], &own[2], causal);
        let ramp = Tensor::arange(out.size()[2], (Kind::Float, Device::Cpu)).view([1, 1, -1, 1]).sin();
        let loss = (out.to_kind(Kind::Float) * ramp).sum(Kind::Float);
        let grads = Tensor::run_backward(&[loss], &own.iter().collect::<Vec<_>>(), false, false);
        std::iter::once(out.detach()).chain(grads).collect()
    }

    #[test]
    fn plain_products_agree_with_the_fused_kernel() {
        tch::manual_seed(0);
        // Shorter than a run, of several, and with keys before the first query.
        for (t, s, causal) in [(40, 40, true), (40, 70, false), (600, 600, true), (256, 300, true), (300, 900, true)] {
            let of = |n: i64| Tensor::randn([2, 3, n, 16], (Kind::Float, Device::Cpu)).to_kind(Kind::BFloat16);
            let inputs = [of(t), of(s), of(s)];
            let (exact, found) = (passed(&inputs, Kind::Float, causal), passed(&inputs, Kind::BFloat16, causal));
            for (k, (exact, found)) in exact.iter().zip(&found).enumerate() {
                let off = (found.to_kind(Kind::Float) - exact).norm() / exact.norm();
                assert!(off.double_value(&[]) < 0.02, "{t} {s} {k}: {off:?}");
            }
        }
    }
}
