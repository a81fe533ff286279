//! Halves of a pre-norm transformer block as one op each, with a backward pass as one op.
//!
//! In f32 and bfloat16 on the CPU: a block of a laptop's size is some forty small ops, and libtorch's bookkeeping of them
//! for the backward pass takes as long as what they compute. The same kernels are called in the same order; attention in
//! bfloat16 is plain products, which need memory for all scores, since the backward pass of libtorch's fused kernel is up
//! to ten times slower.
//!
//! Shapes: b rows of x, t tokens, r rows of keys, s keys, d width. There are no second derivatives.

use std::os::raw::c_int;
use std::ptr::{null, null_mut};

use tch::{Device, Kind, Tensor};
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;

unsafe extern "C" {
    fn rl_block_feed_forward(
        x: *const C_tensor,
        gain: *const C_tensor,
        bias: *const C_tensor,
        up: *const C_tensor,
        up_bias: *const C_tensor,
        down: *const C_tensor,
        down_bias: *const C_tensor,
        out: *mut *mut C_tensor,
    ) -> c_int;
    fn rl_block_own(
        x: *const C_tensor,
        gain: *const C_tensor,
        bias: *const C_tensor,
        q: *const C_tensor,
        k: *const C_tensor,
        v: *const C_tensor,
        all_bias: *const C_tensor,
        o: *const C_tensor,
        o_bias: *const C_tensor,
        heads: i64,
        fused: c_int,
        out: *mut *mut C_tensor,
    ) -> c_int;
    fn rl_block_keys(
        y: *const C_tensor,
        gain: *const C_tensor,
        bias: *const C_tensor,
        k: *const C_tensor,
        v: *const C_tensor,
        both_bias: *const C_tensor,
        out: *mut *mut C_tensor,
    ) -> c_int;
    fn rl_block_other(
        x: *const C_tensor,
        gain: *const C_tensor,
        bias: *const C_tensor,
        q: *const C_tensor,
        q_bias: *const C_tensor,
        keys: *const C_tensor,
        o: *const C_tensor,
        o_bias: *const C_tensor,
        heads: i64,
        fused: c_int,
        out: *mut *mut C_tensor,
    ) -> c_int;
}

/// Gain and bias of a layer norm, eps 1e-5.
#[derive(Clone, Copy)]
pub struct Norm<'a> {
    /// [d]
    pub gain: &'a Tensor,
    /// [d]
    pub bias: &'a Tensor,
}

/// Weight [n, d] and bias [n] of an affine map.
#[derive(Clone, Copy)]
pub struct Map<'a> {
    /// The weight.
    pub weight: &'a Tensor,
    /// The bias.
    pub bias: &'a Tensor,
}

/// What query, key and value, or the last two, are made by.
#[derive(Clone, Copy)]
pub struct Heads<'a> {
    /// A weight each, or one whose rows are all of them.
    pub weights: &'a [&'a Tensor],
    /// The bias of all.
    pub bias: Option<&'a Tensor>,
    /// How many heads.
    pub count: i64,
    /// Whether rows come head by head, each with its part of all, rather than part by part.
    pub fused: bool,
}

/// Whether x may go through these ops.
pub fn has_block(x: &Tensor) -> bool {
    x.device() == Device::Cpu && matches!(x.kind(), Kind::Float | Kind::BFloat16) && x.dim() == 3
}

/// x + W₂ gelu(W₁ LN(x) + b₁) + b₂, with GELU by erf; x [b, t, d].
///
/// # Errors
/// libtorch's message, as where shapes do not fit.
pub fn feed_forward(x: &Tensor, norm: Norm, up: Map, down: Map) -> Result<Tensor, TorchError> {
    // SAFETY: live tensors, and a place for the result.
    made(|out| unsafe {
        rl_block_feed_forward(
            x.as_ptr(),
            norm.gain.as_ptr(),
            norm.bias.as_ptr(),
            up.weight.as_ptr(),
            up.bias.as_ptr(),
            down.weight.as_ptr(),
            down.bias.as_ptr(),
            out,
        )
    })
}

/// x + W Attn(LN(x)) + b over itself, x [b, t, d]; `heads` makes query, key and value.
///
/// # Errors
/// libtorch's message, as where shapes do not fit.
pub fn own_attention(x: &Tensor, norm: Norm, heads: Heads, out: Map) -> Result<Tensor, TorchError> {
    let [q, k, v] = places(heads.weights);
    // SAFETY: live tensors, nulls for none, and a place for the result.
    made(|place| unsafe {
        rl_block_own(
            x.as_ptr(),
            norm.gain.as_ptr(),
            norm.bias.as_ptr(),
            q,
            k,
            v,
            heads.bias.map_or(null(), Tensor::as_ptr),
            out.weight.as_ptr(),
            out.bias.as_ptr(),
            heads.count,
            c_int::from(heads.fused),
            place,
        )
    })
}

/// Keys and values of LN(y), y [r, s, c], as [`other_attention`] reads them: [r, s, 2 d]; `heads` makes the two.
///
/// # Errors
/// libtorch's message, as where shapes do not fit.
pub fn keys(y: &Tensor, norm: Norm, heads: Heads) -> Result<Tensor, TorchError> {
    let [k, v, _] = places(heads.weights);
    // SAFETY: live tensors, nulls for none, and a place for the result.
    made(|place| unsafe {
        let bias = heads.bias.map_or(null(), Tensor::as_ptr);
        rl_block_keys(y.as_ptr(), norm.gain.as_ptr(), norm.bias.as_ptr(), k, v, bias, place)
    })
}

/// x + W Attn(q LN(x), keys) + b, x [b, t, d]. Of r rows of keys each is read by b / r rows of x; `heads`: as the keys
/// were made, with the weight of the queries.
///
/// # Errors
/// libtorch's message, as where shapes do not fit.
pub fn other_attention(x: &Tensor, norm: Norm, heads: Heads, keys: &Tensor, out: Map) -> Result<Tensor, TorchError> {
    let [q, ..] = places(heads.weights);
    // SAFETY: live tensors, a null for none, and a place for the result.
    made(|place| unsafe {
        rl_block_other(
            x.as_ptr(),
            norm.gain.as_ptr(),
            norm.bias.as_ptr(),
            q,
            heads.bias.map_or(null(), Tensor::as_ptr),
            keys.as_ptr(),
            out.weight.as_ptr(),
            out.bias.as_ptr(),
            heads.count,
            c_int::from(heads.fused),
            place,
        )
    })
}

/// Addresses of up to three tensors.
fn places(weights: &[&Tensor]) -> [*const C_tensor; 3] {
    std::array::from_fn(|k| weights.get(k).map_or(null(), |t| t.as_ptr()))
}

fn made(call: impl FnOnce(*mut *mut C_tensor) -> c_int) -> Result<Tensor, TorchError> {
    let mut out = null_mut();
    check(call(&raw mut out))?;
    // SAFETY: made by `new` for the caller, on success alone.
    Ok(unsafe { Tensor::from_ptr(out) })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::count_flops;

    const D: i64 = 24;
    const HEADS: i64 = 3;

    fn leaf(kind: Kind, shape: &[i64]) -> Tensor {
        (Tensor::randn(shape, (Kind::Float, Device::Cpu)) * 0.4).to_kind(kind).set_requires_grad(true)
    }

    fn norm<'a>(t: &'a [Tensor]) -> Norm<'a> {
        Norm { gain: &t[0], bias: &t[1] }
    }

    fn normed(x: &Tensor, n: Norm) -> Tensor {
        x.layer_norm([x.size()[2]], Some(n.gain), Some(n.bias), 1e-5, false)
    }

    /// Parts [b, h, t, e] of [b, t, n d].
    fn parts(x: &Tensor, rows: i64, n: i64, fused: bool) -> Vec<Tensor> {
        let e = x.size()[2] / n / HEADS;
        let x = if fused {
            x.view([rows, -1, HEADS, n, e]).permute([3, 0, 2, 1, 4])
        } else {
            x.view([rows, -1, n, HEADS, e]).permute([2, 0, 3, 1, 4])
        };
        x.unbind(0)
    }

    fn mixed(q: &Tensor, k: &Tensor, v: &Tensor, like: &Tensor) -> Tensor {
        let y = match q.kind() {
            Kind::Float => Tensor::scaled_dot_product_attention(q, k, v, None::<&Tensor>, 0.0, false, None, false),
            _ => (q / (q.size()[3] as f64).sqrt()).matmul(&k.transpose(2, 3)).softmax(-1, None::<Kind>).matmul(v),
        };
        y.transpose(1, 2).reshape(like.size())
    }

    /// Whether two ways give the same, and the same gradients of all leaves.
    fn same(what: &str, leaves: &[Tensor], a: impl Fn() -> Tensor, b: impl Fn() -> Tensor) {
        // Of the two ways in bfloat16 either rounds elsewhere, to eight bits.
        let most = if leaves[0].kind() == Kind::Float { 2e-6 } else { 0.02 };
        let pass = |f: &dyn Fn() -> Tensor| {
            let y = f();
            let loss = (&y * y.detach().sin()).sum(Kind::Float);
            let mut all = Tensor::run_backward(&[loss], leaves, false, false);
            all.push(y);
            all
        };
        let (found, want) = (pass(&a), pass(&b));
        for (k, (found, want)) in found.iter().zip(&want).enumerate() {
            assert_eq!((found.size(), found.kind()), (want.size(), want.kind()));
            let (found, want) = (found.to_kind(Kind::Double), want.to_kind(Kind::Double));
            let off = ((found - &want).norm() / (want.norm() + 1e-9)).double_value(&[]);
            assert!(off < most, "{what}, {k}: {off}");
        }
        let (_, ours) = count_flops(|| pass(&a)).unwrap();
        let (_, theirs) = count_flops(|| pass(&b)).unwrap();
        assert_eq!(ours, theirs, "{what}: products");
        assert!(tch::no_grad(&a).equal(&a().detach()));
    }

    #[test]
    fn halves_of_a_block_are_the_plain_ops_with_their_gradients() {
        let _guard = crate::flops::COUNTED.lock().unwrap_or_else(|e| e.into_inner());
        tch::manual_seed(2);
        halves(|shape| leaf(Kind::Float, shape));
        halves(|shape| leaf(Kind::BFloat16, shape));
    }

    fn halves(leaf: impl Fn(&[i64]) -> Tensor) {
        let x = leaf(&[4, 5, D]);
        // What comes out of other ops need not lie in order.
        for x in [x.shallow_clone(), leaf(&[5, 4, D]).transpose(0, 1).detach().set_requires_grad(true)] {
            let t = [leaf(&[D]), leaf(&[D]), leaf(&[2 * D, D]), leaf(&[2 * D]), leaf(&[D, 2 * D]), leaf(&[D]), x];
            let x = &t[6];
            let (up, down) = (Map { weight: &t[2], bias: &t[3] }, Map { weight: &t[4], bias: &t[5] });
            same(
                "feed forward",
                &t,
                || feed_forward(x, norm(&t), up, down).unwrap(),
                || x + normed(x, norm(&t)).linear(&t[2], Some(&t[3])).gelu("none").linear(&t[4], Some(&t[5])),
            );
        }
        for (fused, apart, biased) in
            [(false, true, false), (true, false, true), (true, true, false), (false, false, true)]
        {
            let rows = if apart { D } else { 3 * D };
            let t = [
                leaf(&[D]),
                leaf(&[D]),
                leaf(&[rows, D]),
                leaf(&[D, D]),
                leaf(&[D, D]),
                leaf(&[D, D]),
                leaf(&[D]),
                leaf(&[3 * D]),
                leaf(&[4, 5, D]),
            ];
            let used: Vec<Tensor> = (0..9)
                .filter(|&k| (apart || !(3..5).contains(&k)) && (biased || k != 7))
                .map(|k| t[k].shallow_clone())
                .collect();
            let x = &t[8];
            let weights: Vec<&Tensor> = if apart { t[2..5].iter().collect() } else { vec![&t[2]] };
            let bias = biased.then_some(&t[7]);
            let heads = Heads { weights: &weights, bias, count: HEADS, fused };
            same(
                "own",
                &used,
                || own_attention(x, norm(&t), heads, Map { weight: &t[5], bias: &t[6] }).unwrap(),
                || {
                    let all = normed(x, norm(&t)).linear(&Tensor::cat(&weights, 0), bias);
                    let p = parts(&all, 4, 3, fused);
                    x + mixed(&p[0], &p[1], &p[2], x).linear(&t[5], Some(&t[6]))
                },
            );
        }
        // Keys of as many rows, and of fewer.
        for (rows, fused, apart, biased) in [(4, false, true, false), (2, true, false, true), (1, false, true, false)] {
            let n = if apart { D } else { 2 * D };
            let t = [
                leaf(&[D]),
                leaf(&[D]),
                leaf(&[D, D]),
                leaf(&[D]),
                leaf(&[D, D]),
                leaf(&[D]),
                leaf(&[4, 5, D]),
                leaf(&[16]),
                leaf(&[16]),
                leaf(&[n, 16]),
                leaf(&[D, 16]),
                leaf(&[2 * D]),
                leaf(&[rows, 7, 16]),
            ];
            let used: Vec<Tensor> = (0..13)
                .filter(|&k| (apart || k != 10) && (biased || !(k == 3 || k == 11)))
                .map(|k| t[k].shallow_clone())
                .collect();
            let (x, y) = (&t[6], &t[12]);
            let weights: Vec<&Tensor> = if apart { t[9..11].iter().collect() } else { vec![&t[9]] };
            let (bias, q_bias) = (biased.then_some(&t[11]), biased.then_some(&t[3]));
            same(
                "other",
                &used,
                || {
                    let own = Heads { weights: &weights, bias, count: HEADS, fused };
                    let keys = keys(y, norm(&t[7..]), own).unwrap();
                    let asking = Heads { weights: &[&t[2]], bias: q_bias, ..own };
                    other_attention(x, norm(&t), asking, &keys, Map { weight: &t[4], bias: &t[5] }).unwrap()
                },
                || {
                    let q = parts(&normed(x, norm(&t)).linear(&t[2], q_bias), rows, 1, false);
                    let p = parts(&normed(y, norm(&t[7..])).linear(&Tensor::cat(&weights, 0), bias), rows, 2, fused);
                    x + mixed(&q[0], &p[0], &p[1], x).linear(&t[4], Some(&t[5]))
                },
            );
        }
    }

    #[test]
    fn faults_are_sentences_and_second_derivatives_are_refused() {
        let leaf = |shape: &[i64]| leaf(Kind::Float, shape);
        let t = [leaf(&[D]), leaf(&[D]), leaf(&[2 * D, D]), leaf(&[2 * D]), leaf(&[D, 2 * D]), leaf(&[D])];
        let x = leaf(&[4, 5, D]);
        let (up, down) = (Map { weight: &t[2], bias: &t[3] }, Map { weight: &t[4], bias: &t[5] });
        assert!(feed_forward(&x, norm(&t), down, up).is_err());
        let y = feed_forward(&x, norm(&t), up, down).unwrap();
        let error = Tensor::f_run_backward(&[y.square().sum(Kind::Float)], &[&x], true, true).unwrap_err();
        assert!(TorchError::from(error).to_string().contains("no second derivative"));
        assert!(has_block(&x) && has_block(&x.to_kind(Kind::BFloat16)) && !has_block(&x.to_kind(Kind::Double)));
    }
}
