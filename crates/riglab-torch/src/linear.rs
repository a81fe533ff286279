//! Affine maps by the faster of libtorch's libraries.

use std::os::raw::c_int;
use std::ptr::{null, null_mut};

use tch::Tensor;
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;

unsafe extern "C" {
    fn rl_linear(x: *const C_tensor, w: *const C_tensor, bias: *const C_tensor, out: *mut *mut C_tensor) -> c_int;
    #[cfg(test)]
    fn rl_linear_is_ours() -> c_int;
}

/// x wᵀ + bias, x [.., k] and w [n, k] to [.., n], as libtorch's `linear`, which it is but for f32 with many rows on
/// processors of AMD with AVX-512: there sums of at most 192 terms, and x's gradient, are oneDNN's, which takes an
/// eighth less time for them than MKL. What it gives is the same to the last bit, a gradient nearly. Those have no
/// second derivative.
///
/// # Errors
/// libtorch's message, as where shapes do not fit.
pub fn linear(x: &Tensor, w: &Tensor, bias: Option<&Tensor>) -> Result<Tensor, TorchError> {
    let mut out = null_mut();
    let bias = bias.map_or(null(), Tensor::as_ptr);
    // SAFETY: live tensors, a null for none, and a place for the result.
    check(unsafe { rl_linear(x.as_ptr(), w.as_ptr(), bias, &mut out) })?;
    // SAFETY: made by `new` for the caller, on success alone.
    Ok(unsafe { Tensor::from_ptr(out) })
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;
    use crate::count_flops;

    /// y, and the gradients of a sum of its squares.
    fn passed(kind: Kind, inputs: &[Tensor], map: impl Fn(&[Tensor]) -> Tensor) -> Vec<Tensor> {
        let inputs: Vec<Tensor> = inputs.iter().map(|t| t.to_kind(kind).detach().set_requires_grad(true)).collect();
        let y = map(&inputs);
        let mut all = Tensor::run_backward(&[y.square().sum(kind)], &inputs, false, false);
        all.push(y);
        all
    }

    fn apart(a: &Tensor, b: &Tensor) -> f64 {
        let b = b.to_kind(Kind::Double);
        ((a.to_kind(Kind::Double) - &b).abs().max() / b.abs().max()).double_value(&[])
    }

    fn of(inputs: &[Tensor]) -> Tensor {
        linear(&inputs[0], &inputs[1], inputs.get(2)).unwrap()
    }

    /// x [.., k], w [n, k] and a bias.
    fn inputs(x: &[i64], n: i64) -> Vec<Tensor> {
        let k = x[x.len() - 1];
        [x, &[n, k], &[n]].iter().map(|shape| Tensor::randn(*shape, (Kind::Float, Device::Cpu))).collect()
    }

    #[test]
    fn it_is_libtorchs_with_its_gradients() {
        // Of few rows and of many, of several axes.
        for (x, n) in [(&[3, 5][..], 7), (&[700, 256], 300), (&[2, 600, 128], 512), (&[5, 9, 31, 192], 192)] {
            let inputs = inputs(x, n);
            for inputs in [&inputs[..], &inputs[..2]] {
                let exact = passed(Kind::Double, inputs, |t| t[0].linear(&t[1], t.get(2)));
                for (kind, most) in [(Kind::Double, 1e-12), (Kind::Float, 1e-5), (Kind::BFloat16, 0.03)] {
                    for (found, exact) in passed(kind, inputs, of).iter().zip(&exact) {
                        assert_eq!((found.size(), found.kind()), (exact.size(), kind));
                        assert!(apart(found, exact) < most, "{x:?} to {n}, {kind:?}: {}", apart(found, exact));
                    }
                }
            }
        }
    }

    #[test]
    fn rows_may_lie_apart_and_weights_be_turned() {
        let inputs = inputs(&[800, 256], 256);
        let turned: Vec<Tensor> =
            inputs.iter().map(|t| if t.dim() == 2 { t.tr().contiguous().tr() } else { t.shallow_clone() }).collect();
        assert!(!turned[0].is_contiguous());
        for (a, b) in passed(Kind::Float, &turned, of).iter().zip(&passed(Kind::Float, &inputs, of)) {
            assert!(apart(a, b) < 1e-5);
        }
    }

    #[test]
    fn it_gives_the_bits_of_libtorch_however_many_rows() {
        // SAFETY: asks for a flag.
        if unsafe { rl_linear_is_ours() } == 0 {
            eprintln!("skipped: products of this processor are libtorch's");
            return;
        }
        let before = tch::get_num_threads();
        for threads in [1, 2, 8] {
            tch::set_num_threads(threads);
            for (k, n) in [(64, 2048), (192, 551), (100, 768), (255, 640), (1024, 130)] {
                let inputs = inputs(&[2000, k], n);
                let all = inputs[0].linear(&inputs[1], Some(&inputs[2]));
                for rows in [256, 700, 2000] {
                    let few = linear(&inputs[0].narrow(0, 0, rows), &inputs[1], Some(&inputs[2])).unwrap();
                    assert!(few.equal(&all.narrow(0, 0, rows)), "{rows} rows, {k} to {n}, {threads} threads");
                }
            }
        }
        tch::set_num_threads(before);
    }

    #[test]
    fn second_derivatives_are_right_or_refused() {
        let of_sum = |x: &[i64]| {
            let inputs: Vec<Tensor> = inputs(x, 512).iter().map(|t| t.set_requires_grad(true)).collect();
            Tensor::f_run_backward(&[of(&inputs).square().sum(Kind::Float)], &inputs[..1], true, true).map(|_| ())
        };
        assert!(of_sum(&[4, 128]).is_ok());
        // SAFETY: asks for a flag.
        let ours = unsafe { rl_linear_is_ours() } != 0;
        assert_eq!(of_sum(&[1200, 128]).is_err(), ours, "of many rows, by oneDNN");
    }

    #[test]
    fn gradients_are_of_what_is_asked_for() {
        let inputs = inputs(&[2, 600, 128], 512);
        let exact = passed(Kind::Double, &inputs, of);
        for asked in 0..8 {
            let leaves: Vec<Tensor> =
                (0..3).map(|k| inputs[k].detach().set_requires_grad(asked >> k & 1 == 1)).collect();
            let mut y = of(&leaves);
            assert_eq!(y.requires_grad(), asked > 0);
            if asked == 0 {
                continue;
            }
            // Added to in place, as convolutions do.
            let _ = y.g_add_(&Tensor::zeros([512], (Kind::Float, Device::Cpu)));
            let wanted: Vec<usize> = (0..3).filter(|k| asked >> k & 1 == 1).collect();
            let of_leaves: Vec<&Tensor> = wanted.iter().map(|&k| &leaves[k]).collect();
            let found = Tensor::run_backward(&[y.square().sum(Kind::Float)], &of_leaves, false, false);
            for (k, found) in wanted.iter().zip(&found) {
                assert!(apart(found, &exact[*k]) < 1e-5, "{asked}: {k}");
            }
        }
    }

    #[test]
    fn its_products_are_counted_and_its_faults_told() {
        let inputs = inputs(&[1024, 256], 128);
        let _counted = crate::flops::COUNTED.lock().unwrap_or_else(|e| e.into_inner());
        let (_, count) = count_flops(|| passed(Kind::Float, &inputs, of)).unwrap();
        assert_eq!(count, 3 * 2 * 1024 * 256 * 128);
        assert!(linear(&inputs[0], &inputs[2], None).is_err());
        assert!(linear(&inputs[0], &inputs[1].tr(), None).is_err());
    }
}
