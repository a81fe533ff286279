//! Multi-head attention.

use serde::{Deserialize, Serialize};
use tch::{Device, Kind, Tensor};

use super::Linear;
use crate::params::{Init, ParamId, Role, Scope, Weights};

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
pub struct Attention {
    to_q: Linear,
    to_k: Linear,
    to_v: Linear,
    to_out: Linear,
    heads: i64,
    split: HeadSplit,
    slopes: Option<ParamId>,
}

/// Keys and values, each [b, h, s, d / h].
pub struct KeyValue {
    k: Tensor,
    v: Tensor,
}

impl KeyValue {
    /// How many batch rows.
    pub fn rows(&self) -> i64 {
        self.k.size()[0]
    }
}

impl Attention {
    /// `context` is the width of y. With `distance`, scores fall with the squared distance between
    /// query and key, each head by a learned slope (an extension).
    pub fn new(mut at: Scope, width: usize, context: usize, heads: usize, split: HeadSplit, distance: bool) -> Self {
        assert!(width.is_multiple_of(heads), "width {width} is not divisible by {heads} heads: check the config first");
        let role = Role::Attention;
        Self {
            to_q: Linear::new(at.sub("to_q"), role, width, width, false),
            to_k: Linear::new(at.sub("to_k"), role, context, width, false),
            to_v: Linear::new(at.sub("to_v"), role, context, width, false),
            to_out: Linear::new(at.sub("to_out").sub(0), role, width, width, true),
            slopes: distance.then(|| {
                at.add("log_slopes", Role::Vector, &[heads as i64], Init::Ramp { from: SLOPES.0, to: SLOPES.1 })
            }),
            heads: heads as i64,
            split,
        }
    }

    /// x [b, t, d] over itself. `distances` [b, t, t] are squared.
    pub fn over_itself(&self, w: &Weights, x_btd: &Tensor, distances: Option<&Tensor>) -> Tensor {
        // One product for all three: the weights are small beside the activations.
        let all = Tensor::cat(&[&w[self.to_q.weight()], &w[self.to_k.weight()], &w[self.to_v.weight()]], 0);
        let parts = self.heads_of(&x_btd.linear(&all, None::<&Tensor>), 3);
        self.attend(w, &parts[0], &parts[1], &parts[2], distances)
    }

    /// Keys and values of y [b, s, c]: computed once where several queries share them.
    pub fn keys(&self, w: &Weights, y_bsc: &Tensor) -> KeyValue {
        let both = Tensor::cat(&[&w[self.to_k.weight()], &w[self.to_v.weight()]], 0);
        let mut parts = self.heads_of(&y_bsc.linear(&both, None::<&Tensor>), 2).into_iter();
        match (parts.next(), parts.next()) {
            (Some(k), Some(v)) => KeyValue { k, v },
            _ => unreachable!("two parts were asked for"),
        }
    }

    /// x [b, t, d] over keys made by [`Self::keys`], to [b', t, d]; see `Block::forward` for keys with
    /// other than b rows. `distances` [b'', t, s] are squared; like x where the keys have fewer rows,
    /// like the keys where they have more.
    pub fn over(&self, w: &Weights, x_btd: &Tensor, y: &KeyValue, distances: Option<&Tensor>) -> Tensor {
        let (b, t, d) = x_btd.size3().expect("three axes");
        let rows = y.rows();
        let q = self.to_q.forward(w, x_btd);
        let heads = |q: Tensor, b: i64, t: i64| q.view([b, t, self.heads, d / self.heads]).transpose(1, 2);
        if rows < b {
            let q = heads(q, rows, b * t / rows);
            let distances = distances.map(|x| x.view([rows, b * t / rows, -1]));
            return self.attend(w, &q, &y.k, &y.v, distances.as_ref()).view([b, t, d]);
        }
        let mut q = heads(q, b, t);
        if rows > b {
            q = q.unsqueeze(1).expand([-1, rows / b, -1, -1, -1], false).flatten(0, 1);
        }
        self.attend(w, &q, &y.k, &y.v, distances)
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

    fn attend(&self, w: &Weights, q: &Tensor, k: &Tensor, v: &Tensor, distances: Option<&Tensor>) -> Tensor {
        let bias = self.slopes.zip(distances).map(|(slopes, distances)| {
            let slopes = w[slopes].exp().view([1, self.heads, 1, 1]);
            -(distances.unsqueeze(1).to_kind(q.kind()) * slopes)
        });
        let mixed = mix(q, k, v, bias.as_ref());
        let size = q.size();
        let (b, t) = (size[0], size[2]);
        self.to_out.forward(w, &mixed.transpose(1, 2).reshape([b, t, size[1] * size[3]]))
    }
}

/// The slopes with which heads start, from far-sighted to near-sighted: in [-1, 1]³, a score of -1 at
/// distances of 2 and 1/8.
const SLOPES: (f64, f64) = (-1.386, 4.159);

/// softmax(q kᵀ / √d + bias) v, each [b, h, t, d].
///
/// libtorch's fused kernel is the fastest in fp32 on the CPU, but its bfloat16 backward pass is up to
/// ten times slower than the plain products, and it takes no bias with a gradient. The products need
/// memory for all scores, which the sequences here have room for.
fn mix(q: &Tensor, k: &Tensor, v: &Tensor, bias: Option<&Tensor>) -> Tensor {
    let plain = bias.is_some() || (q.kind() == Kind::BFloat16 && q.device() == Device::Cpu);
    if !plain {
        return Tensor::scaled_dot_product_attention(q, k, v, None::<&Tensor>, 0.0, false, None, false);
    }
    let scale = 1.0 / (q.size()[3] as f64).sqrt();
    let mut scores = (q * scale).matmul(&k.transpose(-2, -1));
    if let Some(bias) = bias {
        scores += bias;
    }
    scores.softmax(-1, None::<Kind>).matmul(v)
}

/// Squared distances of points a [b, t, 3] and b [b, s, 3], as [b, t, s].
pub fn squared_distances(a: &Tensor, b: &Tensor) -> Tensor {
    let norm = |x: &Tensor| x.square().sum_dim_intlist([-1i64].as_slice(), true, None::<Kind>);
    (norm(a) + norm(b).transpose(1, 2) - a.matmul(&b.transpose(1, 2)) * 2.0).clamp_min(0.0)
}
