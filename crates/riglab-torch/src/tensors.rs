//! Ops over lists of tensors.

use std::borrow::Borrow;
use std::os::raw::c_int;

use tch::Tensor;
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;

unsafe extern "C" {
    #[allow(clippy::too_many_arguments)]
    fn rl_fused_adamw(
        params: *const *const C_tensor,
        grads: *const *const C_tensor,
        m: *const *const C_tensor,
        v: *const *const C_tensor,
        steps: *const *const C_tensor,
        n: usize,
        lr: f64,
        beta1: f64,
        beta2: f64,
        weight_decay: f64,
        eps: f64,
        grad_scale: *const C_tensor,
    ) -> c_int;
    fn rl_foreach_mul(tensors: *const *const C_tensor, n: usize, factor: f64) -> c_int;
    fn rl_foreach_add_scalar(tensors: *const *const C_tensor, n: usize, value: f64) -> c_int;
    fn rl_foreach_add(tensors: *const *const C_tensor, other: *const *const C_tensor, n: usize, alpha: f64) -> c_int;
    fn rl_foreach_lerp(tensors: *const *const C_tensor, other: *const *const C_tensor, n: usize, weight: f64) -> c_int;
    fn rl_global_norm(tensors: *const *const C_tensor, n: usize, out: *mut f64) -> c_int;
}

fn pointers<T: Borrow<Tensor>>(tensors: &[T]) -> Vec<*const C_tensor> {
    tensors.iter().map(|t| t.borrow().as_ptr()).collect()
}

/// Lists for one fused AdamW step, all of one length; tensors are changed in place.
pub struct AdamwStep<'a> {
    /// Parameters.
    pub params: &'a [Tensor],
    /// Their gradients.
    pub grads: &'a [Tensor],
    /// First moments.
    pub m: &'a [Tensor],
    /// Second moments.
    pub v: &'a [Tensor],
    /// Step counts (one f32 a parameter), already counted up for this step.
    pub steps: &'a [Tensor],
    /// Learning rate.
    pub lr: f64,
    /// Decay of the moments.
    pub betas: (f64, f64),
    /// Decoupled weight decay.
    pub weight_decay: f64,
    /// Added to the denominator.
    pub eps: f64,
    /// Divides the gradients, if given: one f32.
    pub grad_scale: Option<&'a Tensor>,
}

/// One AdamW step over many tensors in one call (libtorch's `_fused_adamw_`).
///
/// # Errors
/// libtorch's message, and lists of different lengths.
pub fn fused_adamw(step: &AdamwStep) -> Result<(), TorchError> {
    let n = step.params.len();
    if [step.grads.len(), step.m.len(), step.v.len(), step.steps.len()].iter().any(|&k| k != n) {
        return Err(TorchError("lists of different lengths for AdamW".into()));
    }
    if n == 0 {
        return Ok(());
    }
    let lists = [step.params, step.grads, step.m, step.v, step.steps].map(pointers);
    // SAFETY: five lists of n live tensors.
    check(unsafe {
        rl_fused_adamw(
            lists[0].as_ptr(),
            lists[1].as_ptr(),
            lists[2].as_ptr(),
            lists[3].as_ptr(),
            lists[4].as_ptr(),
            n,
            step.lr,
            step.betas.0,
            step.betas.1,
            step.weight_decay,
            step.eps,
            step.grad_scale.map_or(std::ptr::null(), |t| t.as_ptr()),
        )
    })
}

/// tensors *= factor
///
/// # Errors
/// libtorch's message.
pub fn foreach_mul(tensors: &[Tensor], factor: f64) -> Result<(), TorchError> {
    if tensors.is_empty() {
        return Ok(());
    }
    let list = pointers(tensors);
    // SAFETY: a list of live tensors.
    check(unsafe { rl_foreach_mul(list.as_ptr(), list.len(), factor) })
}

/// tensors += value
///
/// # Errors
/// libtorch's message.
pub fn foreach_add_scalar(tensors: &[Tensor], value: f64) -> Result<(), TorchError> {
    if tensors.is_empty() {
        return Ok(());
    }
    let list = pointers(tensors);
    // SAFETY: a list of live tensors.
    check(unsafe { rl_foreach_add_scalar(list.as_ptr(), list.len(), value) })
}

/// tensors += alpha * other
///
/// # Errors
/// libtorch's message, and lists of different lengths.
pub fn foreach_add(tensors: &[Tensor], other: &[Tensor], alpha: f64) -> Result<(), TorchError> {
    binary(tensors, other, alpha, rl_foreach_add)
}

/// tensors += weight * (other - tensors)
///
/// # Errors
/// libtorch's message, and lists of different lengths.
pub fn foreach_lerp(tensors: &[Tensor], other: &[Tensor], weight: f64) -> Result<(), TorchError> {
    binary(tensors, other, weight, rl_foreach_lerp)
}

type Binary = unsafe extern "C" fn(*const *const C_tensor, *const *const C_tensor, usize, f64) -> c_int;

fn binary(tensors: &[Tensor], other: &[Tensor], scalar: f64, op: Binary) -> Result<(), TorchError> {
    if tensors.len() != other.len() {
        return Err(TorchError(format!("lists of {} and {} tensors", tensors.len(), other.len())));
    }
    if tensors.is_empty() {
        return Ok(());
    }
    let (a, b) = (pointers(tensors), pointers(other));
    // SAFETY: two lists of live tensors of one length.
    check(unsafe { op(a.as_ptr(), b.as_ptr(), a.len(), scalar) })
}

/// The Euclidean norm over all elements of all tensors.
///
/// # Errors
/// libtorch's message.
pub fn global_norm<T: Borrow<Tensor>>(tensors: &[T]) -> Result<f64, TorchError> {
    if tensors.is_empty() {
        return Ok(0.0);
    }
    let list = pointers(tensors);
    let mut out = 0.0;
    // SAFETY: a list of live tensors; `out` outlives the call.
    check(unsafe { rl_global_norm(list.as_ptr(), list.len(), &mut out) })?;
    Ok(out)
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind};

    use super::*;

    fn values(t: &Tensor) -> Vec<f32> {
        Vec::try_from(t).unwrap()
    }

    #[test]
    fn adamw_follows_its_formula() {
        let one = |x: f32| vec![Tensor::from_slice(&[x, 2.0 * x])];
        let (p, g, m, v) = (one(1.0), one(0.5), one(0.0), one(0.0));
        let steps = vec![Tensor::from(1.0f32)];
        let (lr, wd, eps) = (0.1, 0.01, 1e-8);
        let step = AdamwStep {
            params: &p,
            grads: &g,
            m: &m,
            v: &v,
            steps: &steps,
            lr,
            betas: (0.9, 0.95),
            weight_decay: wd,
            eps,
            grad_scale: None,
        };
        fused_adamw(&step).unwrap();
        // The first step moves by lr whatever the gradient's size.
        let want = [1.0 * (1.0 - lr * wd) - lr, 2.0 * (1.0 - lr * wd) - lr];
        assert!(values(&p[0]).iter().zip(want).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6), "{:?}", values(&p[0]));
        assert!((values(&m[0])[0] - 0.05).abs() < 1e-7);
    }

    #[test]
    fn lists_of_different_lengths_are_refused() {
        let a = vec![Tensor::from(1.0f32)];
        assert!(foreach_add(&a, &[], 1.0).is_err());
    }

    #[test]
    fn shape_errors_are_one_line() {
        let (a, b) = (vec![Tensor::from_slice(&[1.0f32, 2.0])], vec![Tensor::from_slice(&[1.0f32, 2.0, 3.0])]);
        let text = foreach_lerp(&a, &b, 0.5).unwrap_err().to_string();
        assert!(text.contains("size") && !text.contains('\n'), "{text}");
    }

    #[test]
    fn norm_spans_all_tensors() {
        let list = vec![Tensor::from_slice(&[3.0f32, 0.0]), Tensor::from_slice(&[4.0f32])];
        assert_eq!(global_norm(&list).unwrap(), 5.0);
        assert_eq!(global_norm::<Tensor>(&[]).unwrap(), 0.0);
        foreach_mul(&list, 2.0).unwrap();
        assert_eq!(global_norm(&list).unwrap(), 10.0);
        let _ = Tensor::zeros([1], (Kind::Float, Device::Cpu));
    }
}
