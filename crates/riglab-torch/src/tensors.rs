//! Ops over lists of tensors. Each tensor is one thread's: threads meet once a list.

use std::borrow::Borrow;
use std::ops::Range;
use std::os::raw::c_int;

use tch::{Device, Tensor};
use torch_sys::C_tensor;

use crate::TorchError;
use crate::error::check;
use crate::parts::{side_by_side, threads_on};

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
    fn rl_squares(tensors: *const *const C_tensor, n: usize, out: *mut f64) -> c_int;
}

/// Fewer elements than this for each thread are done before another would have begun.
const ENOUGH: usize = 1 << 17;

/// Tensors of a list by their addresses.
struct Pointers(Vec<*const C_tensor>);

// SAFETY: the tensors outlive the call that lists them, and no two threads are given the same one.
unsafe impl Sync for Pointers {}

impl Pointers {
    fn of<T: Borrow<Tensor>>(tensors: &[T]) -> Self {
        Self(tensors.iter().map(|t| t.borrow().as_ptr()).collect())
    }

    fn first(&self) -> *const C_tensor {
        self.0.first().copied().unwrap_or(std::ptr::null())
    }

    fn at(&self, some: &Range<usize>) -> *const *const C_tensor {
        self.0[some.clone()].as_ptr()
    }
}

/// Runs of a list, about as many elements each, for as many threads as there are; one run of little, and on other devices.
fn runs<T: Borrow<Tensor>>(tensors: &[T]) -> Vec<Range<usize>> {
    let sizes = tensors.iter().map(|t| t.borrow().numel());
    let all: usize = sizes.clone().sum();
    let elsewhere = tensors.iter().map(|t| t.borrow().device()).find(|d| *d != Device::Cpu);
    let threads = threads_on(elsewhere.unwrap_or(Device::Cpu)).min(all / ENOUGH).max(1);
    let mut ends = Vec::with_capacity(threads);
    let mut before = 0;
    for (k, size) in sizes.enumerate() {
        // A tensor belongs to the run that its middle lies in.
        while ends.len() + 1 < threads && (before + size / 2) * threads >= (ends.len() + 1) * all {
            ends.push(k);
        }
        before += size;
    }
    ends.push(tensors.len());
    let starts = std::iter::once(0).chain(ends.clone());
    starts.zip(ends).map(|(start, end)| start..end).filter(|run| !run.is_empty()).collect()
}

/// Does `op` for each of some runs, at the same time.
fn by_runs(runs: &[Range<usize>], op: impl Fn(&Range<usize>) -> c_int + Sync) -> Result<(), TorchError> {
    // A message belongs to the thread that it came up in.
    let jobs = runs.iter().map(|run| || check(op(run)));
    side_by_side(jobs.collect::<Vec<_>>()).into_iter().collect()
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
    let lists = [step.params, step.grads, step.m, step.v, step.steps].map(Pointers::of);
    let scale = Pointers(step.grad_scale.iter().map(|t| t.as_ptr()).collect());
    let (lr, betas, weight_decay, eps) = (step.lr, step.betas, step.weight_decay, step.eps);
    // SAFETY: five lists of n live tensors, of which a run is given; the scale is only read.
    by_runs(&runs(step.params), |run| unsafe {
        rl_fused_adamw(
            lists[0].at(run),
            lists[1].at(run),
            lists[2].at(run),
            lists[3].at(run),
            lists[4].at(run),
            run.len(),
            lr,
            betas.0,
            betas.1,
            weight_decay,
            eps,
            scale.first(),
        )
    })
}

/// tensors *= factor
///
/// # Errors
/// libtorch's message.
pub fn foreach_mul(tensors: &[Tensor], factor: f64) -> Result<(), TorchError> {
    let list = Pointers::of(tensors);
    // SAFETY: a run of live tensors.
    by_runs(&runs(tensors), |run| unsafe { rl_foreach_mul(list.at(run), run.len(), factor) })
}

/// tensors += value
///
/// # Errors
/// libtorch's message.
pub fn foreach_add_scalar(tensors: &[Tensor], value: f64) -> Result<(), TorchError> {
    let list = Pointers::of(tensors);
    // SAFETY: a run of live tensors.
    by_runs(&runs(tensors), |run| unsafe { rl_foreach_add_scalar(list.at(run), run.len(), value) })
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
    let (a, b) = (Pointers::of(tensors), Pointers::of(other));
    // SAFETY: runs of two lists of live tensors of one length.
    by_runs(&runs(tensors), |run| unsafe { op(a.at(run), b.at(run), run.len(), scalar) })
}

/// The Euclidean norm over all elements of all tensors: the same bits on any number of threads.
///
/// # Errors
/// libtorch's message.
pub fn global_norm<T: Borrow<Tensor>>(tensors: &[T]) -> Result<f64, TorchError> {
    let list = Pointers::of(tensors);
    let squares = runs(tensors).into_iter().map(|run| {
        let list = &list;
        move || {
            let mut squares = vec![0.0; run.len()];
            // SAFETY: a run of live tensors, and a place for each.
            check(unsafe { rl_squares(list.at(&run), run.len(), squares.as_mut_ptr()) }).map(|()| squares)
        }
    });
    let squares: Result<Vec<Vec<f64>>, TorchError> = side_by_side(squares.collect::<Vec<_>>()).into_iter().collect();
    Ok(squares?.into_iter().flatten().sum::<f64>().sqrt())
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
    fn threads_share_lists_and_change_nothing() {
        let before = tch::get_num_threads();
        let made = |threads: i32| {
            tch::set_num_threads(threads);
            // Not drawn: the generator is that of all tests, which run at the same time.
            let sizes = [1i64, 300_000, 5, 70_000, 200_000, 64, 400_000];
            let of = |n: i64, step: f64| ((Tensor::arange(n, (Kind::Float, Device::Cpu)) + 1.0) * step).sin();
            let list = |step: f64| sizes.map(|n| of(n, step)).into_iter().collect::<Vec<_>>();
            let (a, b) = (list(1.7), list(0.9));
            assert_eq!(runs(&a).len(), (threads as usize).clamp(1, 6));
            assert_eq!(runs(&a).into_iter().flatten().collect::<Vec<_>>(), (0..7).collect::<Vec<_>>());
            foreach_lerp(&a, &b, 0.25).unwrap();
            foreach_add(&a, &b, -0.5).unwrap();
            let norm = global_norm(&a).unwrap();
            tch::set_num_threads(before);
            (a, norm)
        };
        let (want, norm) = made(1);
        for threads in [2, 3] {
            let (found, same) = made(threads);
            assert!(same == norm && found.iter().zip(&want).all(|(a, b)| a.equal(b)), "{threads}");
        }
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
