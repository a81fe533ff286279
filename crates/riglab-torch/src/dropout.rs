//! Dropout whose draws are shared among threads.

use std::os::raw::c_int;
use std::ptr::null_mut;

use tch::{Device, Tensor};
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;

unsafe extern "C" {
    fn rl_dropout_mask(x: *const C_tensor, p: f64, out: *mut *mut C_tensor) -> c_int;
}

/// Elements of x are 0 with probability `p` and 1 / (1 - p) times as large otherwise, by this thread's generator (of
/// which it takes one number: a generator that is set back gives the same again, on any number of threads). On the CPU
/// `p` is met to 1 in 65,536.
///
/// # Errors
/// libtorch's message; when `p` is not in [0, 1).
pub fn dropout(x: &Tensor, p: f64) -> Result<Tensor, TorchError> {
    if x.device() != Device::Cpu {
        return Ok(x.f_dropout(p, true)?);
    }
    let mut out = null_mut();
    // SAFETY: a live tensor, and a place for the result.
    check(unsafe { rl_dropout_mask(x.as_ptr(), p, &mut out) })?;
    // SAFETY: made by `new` for the caller, on success alone.
    Ok(x * unsafe { Tensor::from_ptr(out) })
}

#[cfg(test)]
mod tests {
    use tch::Kind;

    use super::*;

    /// Of a matrix of ones, and the gradient of its sum.
    fn ones(kind: Kind, p: f64) -> [Vec<f64>; 2] {
        let x = Tensor::ones([701, 301], (kind, Device::Cpu)).set_requires_grad(true);
        let out = dropout(&x, p).unwrap();
        let grad = Tensor::run_backward(&[out.sum(Kind::Float)], &[&x], false, false).remove(0);
        [out, grad].map(|t| Vec::try_from(t.to_kind(Kind::Double).flatten(0, 1)).unwrap())
    }

    #[test]
    fn as_many_fall_as_are_asked_to_and_no_row_is_like_another() {
        for (kind, p) in [(Kind::Float, 0.1), (Kind::BFloat16, 0.25), (Kind::Double, 0.5)] {
            let [out, grad] = ones(kind, p);
            assert_eq!(out, grad, "what is dropped gets no gradient");
            let dropped = out.iter().filter(|x| **x == 0.0).count() as f64;
            let (n, left) = (out.len() as f64, 1.0 / (1.0 - p));
            assert!((dropped - p * n).abs() < 5.0 * (n * p * (1.0 - p)).sqrt(), "{dropped} of {n} for {p}");
            assert!(out.iter().all(|x| *x == 0.0 || (x - left).abs() < 0.004 * left));
            // Neighbours, blocks and rows are independent: both fall with probability p².
            for apart in [1, 2, 301, 1024, 2048] {
                let both = out.iter().zip(&out[apart..]).filter(|(a, b)| **a == 0.0 && **b == 0.0).count() as f64;
                assert!((both - p * p * n).abs() < 6.0 * p * n.sqrt() + p * p * apart as f64, "{both} at {apart}");
            }
        }
        assert_eq!(ones(Kind::Float, 0.0)[0], vec![1.0; 701 * 301]);
        // Something is left of any.
        assert!(ones(Kind::Double, 0.999_995)[0].iter().any(|x| *x > 0.0));
        assert!(dropout(&Tensor::ones([2], (Kind::Float, Device::Cpu)), 1.0).is_err());
    }
}
