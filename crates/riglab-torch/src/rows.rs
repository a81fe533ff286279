//! What a Qwen layer does row by row between its products, each as one op with a backward pass as one op.
//!
//! On the CPU: a layer has some thirty such small ops of libtorch, each of which goes through memory by itself. Numbers are computed in at least f32 and rounded once. There are no second derivatives.

use std::os::raw::c_int;
use std::ptr::null_mut;

use tch::{Device, Kind, Tensor};
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;

unsafe extern "C" {
    fn rl_norm_rows(x: *const C_tensor, gain: *const C_tensor, eps: f64, out: *mut *mut C_tensor) -> c_int;
    fn rl_turned_heads(
        x: *const C_tensor,
        gains: *const C_tensor,
        cos: *const C_tensor,
        sin: *const C_tensor,
        queries: i64,
        eps: f64,
        out: *mut *mut C_tensor,
    ) -> c_int;
    fn rl_gated(x: *const C_tensor, out: *mut *mut C_tensor) -> c_int;
}

/// Whether there are these ops for a tensor.
pub fn has_rows(x: &Tensor) -> bool {
    x.device() == Device::Cpu && matches!(x.kind(), Kind::Float | Kind::BFloat16 | Kind::Double)
}

/// The root-mean-square norm x / √(mean x² + eps) · gain, x [.., d], gain [d].
///
/// # Errors
/// libtorch's message; without [`has_rows`].
pub fn norm_rows(x: &Tensor, gain: &Tensor, eps: f64) -> Result<Tensor, TorchError> {
    let mut out = null_mut();
    // SAFETY: live tensors, and a place for the result.
    check(unsafe { rl_norm_rows(x.as_ptr(), gain.as_ptr(), eps, &mut out) })?;
    // SAFETY: made by `new` for the caller, on success alone.
    Ok(unsafe { Tensor::from_ptr(out) })
}

/// Queries [t, h, e], keys and values [t, kv, e] of x [t, h + 2 kv, e]: queries and keys normed, each head with its own of
/// the gains [h + kv, e], then turned, channel k with k + e / 2, by the angles of their place, [p, .., e] of row t mod p.
///
/// # Errors
/// libtorch's message; when sizes do not fit, or without [`has_rows`].
pub fn turned_heads(
    x: &Tensor,
    gains: &Tensor,
    (cos, sin): (&Tensor, &Tensor),
    queries: i64,
    eps: f64,
) -> Result<[Tensor; 3], TorchError> {
    let mut out = [null_mut(); 3];
    // SAFETY: live tensors, and three places for the results.
    check(unsafe {
        rl_turned_heads(x.as_ptr(), gains.as_ptr(), cos.as_ptr(), sin.as_ptr(), queries, eps, out.as_mut_ptr())
    })?;
    // SAFETY: each made by `new` for the caller, on success alone.
    Ok(out.map(|own| unsafe { Tensor::from_ptr(own) }))
}

/// silu(a) · b of x = [a, b] along the last axis, half as wide.
///
/// # Errors
/// libtorch's message; without [`has_rows`].
pub fn gated(x: &Tensor) -> Result<Tensor, TorchError> {
    let mut out = null_mut();
    // SAFETY: a live tensor, and a place for the result.
    check(unsafe { rl_gated(x.as_ptr(), &mut out) })?;
    // SAFETY: made by `new` for the caller, on success alone.
    Ok(unsafe { Tensor::from_ptr(out) })
}

#[cfg(test)]
mod tests {
    use super::*;

    const EPS: f64 = 1e-6;

    fn rms(x: &Tensor, gain: &Tensor) -> Tensor {
        x * (x.square().mean_dim([-1i64].as_slice(), true, None::<Kind>) + EPS).rsqrt() * gain
    }

    /// Results and gradients of a sum of them.
    fn passed(of: impl Fn(&[Tensor]) -> Vec<Tensor>, inputs: &[Tensor], kind: Kind) -> Vec<Tensor> {
        let inputs: Vec<Tensor> = inputs.iter().map(|x| x.to_kind(kind).set_requires_grad(true)).collect();
        let out = of(&inputs);
        let weigh = |(k, x): (usize, &Tensor)| {
            let weight = (Tensor::arange(x.numel() as i64, (Kind::Float, Device::Cpu)) * (0.7 + k as f64)).sin();
            (x.to_kind(Kind::Float) * weight.view_as(x)).sum(Kind::Float)
        };
        let loss = out.iter().enumerate().map(weigh).reduce(|a, b| a + b).unwrap();
        let gradients = Tensor::run_backward(&[loss], &inputs, false, false);
        out.iter().map(Tensor::detach).chain(gradients).collect()
    }

    fn same(
        name: &str,
        own: impl Fn(&[Tensor]) -> Vec<Tensor>,
        plain: impl Fn(&[Tensor]) -> Vec<Tensor>,
        inputs: &[Tensor],
    ) {
        for (kind, most) in [(Kind::Double, 1e-12), (Kind::Float, 1e-6), (Kind::BFloat16, 0.01)] {
            // From the same numbers, rounded as they are.
            let rounded: Vec<Tensor> = inputs.iter().map(|x| x.to_kind(kind).to_kind(Kind::Double)).collect();
            let (found, exact) = (passed(&own, &rounded, kind), passed(&plain, &rounded, Kind::Double));
            for (k, (found, exact)) in found.iter().zip(&exact).enumerate() {
                assert_eq!((found.kind(), found.size()), (kind, exact.size()), "{name} {k}");
                let off = ((found.to_kind(Kind::Double) - exact).norm() / exact.norm()).double_value(&[]);
                assert!(off < most, "{name} {k} in {kind:?}: {off}");
            }
        }
    }

    /// As if drawn; the generator is that of all tests, which run at the same time.
    fn random(sizes: &[i64]) -> Tensor {
        let n = Tensor::arange(sizes.iter().product::<i64>(), (Kind::Double, Device::Cpu));
        ((n * 12.9898).sin() * 43_758.545_3).sin().view(sizes) * 1.5
    }

    #[test]
    fn they_are_the_formulas_with_their_gradients() {
        // Widths that lanes divide and do not; several runs of rows.
        for width in [32, 37, 192] {
            let inputs = [random(&[5, 41, width]), random(&[width])];
            same("norm", |x| vec![norm_rows(&x[0], &x[1], EPS).unwrap()], |x| vec![rms(&x[0], &x[1])], &inputs);
            let own = |x: &[Tensor]| vec![gated(&x[0]).unwrap()];
            let plain = |x: &[Tensor]| {
                let halves = x[0].chunk(2, -1);
                vec![halves[0].silu() * &halves[1]]
            };
            same("gate", own, plain, &[random(&[3, 70, 2 * width]) * 4.0]);
        }
        // Three rows of each of 50 places.
        let (h, kv, e, rows, places) = (4, 2, 24, 150, 50);
        let angles = (random(&[places, 1, e / 2])).repeat([1, 1, 2]);
        let turns = |x: &Tensor| [angles.cos(), angles.sin()].map(|t| t.to_kind(x.kind()));
        let own = |x: &[Tensor]| {
            let [cos, sin] = turns(&x[0]);
            turned_heads(&x[0], &x[1], (&cos, &sin), h, EPS).map(Vec::from).unwrap()
        };
        let plain = |x: &[Tensor]| {
            let [cos, sin] = turns(&x[0]).map(|t| t.repeat([rows / places, 1, 1]));
            let both = rms(&x[0].narrow(1, 0, h + kv), &x[1]);
            let halves = both.chunk(2, -1);
            let turned = &both * cos + Tensor::cat(&[halves[1].neg(), halves[0].shallow_clone()], -1) * sin;
            vec![turned.narrow(1, 0, h), turned.narrow(1, h, kv), x[0].narrow(1, h + kv, kv)]
        };
        same("heads", own, plain, &[random(&[rows, h + 2 * kv, e]), random(&[h + kv, e])]);
    }

    #[test]
    fn rows_do_not_depend_on_those_beside_them_and_gates_hold_at_the_ends() {
        let (x, gain) = (random(&[200, 40]).to_kind(Kind::Float), random(&[40]).to_kind(Kind::Float));
        let all = norm_rows(&x, &gain, EPS).unwrap();
        let one = norm_rows(&x.narrow(0, 77, 1), &gain, EPS).unwrap();
        assert_eq!(all.narrow(0, 77, 1), one);
        let ends = Tensor::from_slice(&[-1e4f32, -90.0, 0.0, 90.0, 1e4, 1.0, 1.0, 1.0, 1.0, 1.0]);
        let found = Vec::<f32>::try_from(gated(&ends).unwrap()).unwrap();
        assert!(found[0].abs() < 1e-30 && found[1].abs() < 1e-30 && found[2] == 0.0, "{found:?}");
        assert_eq!(found[3..], [90.0, 1e4]);
        let nan = gated(&Tensor::from_slice(&[f32::NAN, 1.0]).to_kind(Kind::BFloat16)).unwrap();
        assert!(nan.to_kind(Kind::Float).double_value(&[0]).is_nan());
        let nan = norm_rows(&Tensor::from_slice(&[f32::NAN, 1.0]), &Tensor::from_slice(&[1f32, 1.0]), EPS).unwrap();
        assert!(nan.double_value(&[1]).is_nan());
        assert!(
            norm_rows(&x, &gain.narrow(0, 0, 3), EPS).is_err()
                && norm_rows(&x, &gain.to_kind(Kind::Double), EPS).is_err()
        );
        assert!(has_rows(&x) && !has_rows(&x.to_kind(Kind::Half)));
    }
}
