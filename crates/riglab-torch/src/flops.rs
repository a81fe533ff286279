//! How much networks compute.

use std::sync::atomic::{AtomicUsize, Ordering};

use crate::error::{TorchError, check};

unsafe extern "C" {
    fn rl_flops_begin(handle: *mut u64, before: *mut u64) -> i32;
    fn rl_flops_end(handle: u64, count: *mut u64) -> i32;
}

/// What `work` gives, and the operations of all products of matrices that libtorch did meanwhile, backward passes
/// included: 2 n k m for a product of [n, k] and [k, m], those of attention as if nothing were masked. Ops that go over
/// tensors element by element are not counted.
///
/// Only what this thread asks for is counted, and what other threads do within [`counted_along`]; two countings at a
/// time, on two threads, would add up.
///
/// # Errors
/// libtorch's message, if it refuses.
pub fn count_flops<R>(work: impl FnOnce() -> R) -> Result<(R, u64), TorchError> {
    let (mut handle, mut before, mut count) = (0, 0, 0);
    // SAFETY: both places outlive the call.
    check(unsafe { rl_flops_begin(&mut handle, &mut before) })?;
    COUNTINGS.fetch_add(1, Ordering::Relaxed);
    let guard = Ending(handle);
    let made = work();
    std::mem::forget(guard);
    COUNTINGS.fetch_sub(1, Ordering::Relaxed);
    // SAFETY: the handle is of the call above; `count` outlives this one.
    check(unsafe { rl_flops_end(handle, &mut count) })?;
    Ok((made, count - before))
}

/// Countings that go on.
static COUNTINGS: AtomicUsize = AtomicUsize::new(0);

/// What `work` gives. Where a thread that waits for it counts, what it computes counts along.
///
/// # Errors
/// As [`count_flops`].
pub fn counted_along<R>(work: impl FnOnce() -> R) -> Result<R, TorchError> {
    if COUNTINGS.load(Ordering::Relaxed) == 0 {
        return Ok(work());
    }
    count_flops(work).map(|(made, _)| made)
}

/// Ends the counting where `work` panics.
struct Ending(u64);

impl Drop for Ending {
    fn drop(&mut self) {
        let mut count = 0;
        COUNTINGS.fetch_sub(1, Ordering::Relaxed);
        // SAFETY: the handle is of the call that began.
        unsafe { rl_flops_end(self.0, &mut count) };
    }
}

/// Tests that count: one at a time.
#[cfg(test)]
pub(crate) static COUNTED: std::sync::Mutex<()> = std::sync::Mutex::new(());

#[cfg(test)]
mod tests {
    use tch::{Device, Kind, Tensor};

    use super::*;

    #[test]
    fn products_are_counted_forward_and_backward() {
        let _guard = COUNTED.lock().unwrap_or_else(|e| e.into_inner());
        let of = |shape: &[i64]| Tensor::randn(shape, (Kind::Float, Device::Cpu)).set_requires_grad(true);
        let (x, w, b) = (of(&[6, 8]), of(&[4, 8]), of(&[4]));
        let (_, linear) = count_flops(|| x.linear(&w, Some(&b))).unwrap();
        assert_eq!(linear, 2 * 6 * 8 * 4);
        let leaves = [&x, &w];
        let both = || Tensor::run_backward(&[x.linear(&w, Some(&b)).sum(Kind::Float)], &leaves, false, false);
        let (_, both) = count_flops(both).unwrap();
        assert_eq!(both, 3 * linear, "one product forward, two backward");
        let (q, k) = (of(&[2, 3, 5, 16]), of(&[2, 3, 7, 16]));
        let attention = || Tensor::scaled_dot_product_attention(&q, &k, &k, None::<&Tensor>, 0.0, false, None, false);
        let (_, attention) = count_flops(attention).unwrap();
        assert_eq!(attention, 4 * 2 * 3 * 5 * 7 * 16);
        let _ = x.matmul(&w.transpose(0, 1));
        assert_eq!(count_flops(|| &x + 1.0).unwrap().1, 0);
    }
}
