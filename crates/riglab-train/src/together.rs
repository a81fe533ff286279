//! Gradients of all ranks, summed while the backward pass goes on.
//!
//! Gradients lie in flat buckets, the last parameters first, as a backward pass comes to them. A bucket that is complete
//! is summed over the ranks by a thread of its own while the pass computes the next. Buckets go out in their order, so
//! that all ranks speak of the same one.

use std::ops::Range;
use std::sync::mpsc::{Sender, channel};

use riglab_nn::params::{Params, Weights};
use riglab_ranks::{Ranks, RanksError};
use riglab_torch::backward;
use tch::{Device, Kind, Tensor};

use crate::error::TrainError;
use crate::prefetch::Source;

/// Numbers in a bucket, but for a parameter that is larger: enough that sending takes longer than beginning to send.
const BUCKET: usize = 1 << 20;

/// The batches of a rank: of each step's `accumulate` a share of its own, side by side.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Deal {
    accumulate: u64,
    own: Range<u64>,
}

impl Deal {
    /// # Errors
    /// (key, message) where the batches of a step cannot be dealt out evenly.
    pub fn new(accumulate: u64, ranks: &Ranks) -> Result<Self, (String, String)> {
        let (rank, size) = (ranks.rank() as u64, ranks.size() as u64);
        if !accumulate.is_multiple_of(size) {
            let same = if size.is_power_of_two() {
                format!(" (the run is then the same on one rank and on {size}, with a thread each)")
            } else {
                String::new()
            };
            let message = format!(
                "accumulate = {accumulate} batches a step cannot be shared by {size} ranks; make it a multiple of {size}{same}"
            );
            return Err(("accumulate".into(), message));
        }
        let each = accumulate / size;
        Ok(Self { accumulate, own: rank * each..(rank + 1) * each })
    }

    /// Those of a step that this rank takes, by their place in the step.
    pub fn own(&self) -> Range<u64> {
        self.own.clone()
    }

    /// How many this rank takes in a step.
    pub fn each(&self) -> u64 {
        self.own.end - self.own.start
    }

    /// The number of the batch that is this rank's n-th.
    fn number(&self, nth: u64) -> u64 {
        nth / self.each() * self.accumulate + self.own.start + nth % self.each()
    }
}

/// A source of the batches that are a rank's own.
pub(crate) struct Dealt<S: ?Sized> {
    pub deal: Deal,
    pub source: std::sync::Arc<S>,
}

impl<S: Source + ?Sized> Source for Dealt<S> {
    type Batch = S::Batch;

    fn batch(&self, number: u64) -> Result<Self::Batch, String> {
        self.source.batch(self.deal.number(number))
    }
}

/// Of parts `0..n` that are folded by halves: how many folds are complete with part `k`, beyond the part itself.
pub(crate) fn folds(n: u64, k: u64) -> usize {
    let (mut parts, mut complete) = (0..n, 0);
    while parts.end - parts.start > 1 {
        let middle = parts.start + (parts.end - parts.start) / 2;
        if k < middle {
            (parts.end, complete) = (middle, 0);
        } else {
            (parts.start, complete) = (middle, complete + 1);
        }
    }
    complete
}

/// The buckets of a network.
pub(crate) struct Buckets {
    flat: Vec<Tensor>,
    /// Of each parameter, its bucket and its gradient's place there.
    views: Vec<(usize, Tensor)>,
}

impl Buckets {
    pub fn new(params: &Params) -> Self {
        let mut lengths: Vec<i64> = Vec::new();
        let mut places = Vec::with_capacity(params.len());
        for weight in params.weights().tensors().iter().rev() {
            let n = weight.numel() as i64;
            match lengths.last_mut() {
                Some(length) if (*length + n) as usize <= BUCKET => *length += n,
                _ => lengths.push(n),
            }
            let bucket = lengths.len() - 1;
            places.push((bucket, lengths[bucket] - n, weight));
        }
        let flat: Vec<Tensor> = lengths.iter().map(|n| Tensor::zeros([*n], (Kind::Float, Device::Cpu))).collect();
        let view = |(bucket, start, weight): (usize, i64, &Tensor)| {
            (bucket, flat[bucket].narrow(0, start, weight.numel() as i64).view(&weight.size()[..]))
        };
        let views = places.into_iter().rev().map(view).collect();
        Self { flat, views }
    }

    /// The gradients of a loss by leaves, added to `before` (sums to be folded, the innermost last), summed over all
    /// ranks. One that no rank has is not defined.
    pub fn sum(
        &mut self,
        ranks: &Ranks,
        loss: &Tensor,
        leaves: &Weights,
        before: &[Vec<Tensor>],
    ) -> Result<Vec<Tensor>, TrainError> {
        let mut left = vec![0usize; self.flat.len()];
        self.views.iter().for_each(|(bucket, _)| left[*bucket] += 1);
        let slices: Vec<Slice> = self.flat.iter().map(Slice::of).collect();
        let summed = std::thread::scope(|scope| {
            let (send, receive) = channel::<usize>();
            let sums = scope.spawn(move || -> Result<(), RanksError> {
                for bucket in receive {
                    // SAFETY: a bucket is sent once, when all of it is written, and not looked at before this thread
                    // has ended.
                    ranks.sum(unsafe { slices[bucket].values() })?;
                }
                Ok(())
            });
            let mut filling =
                Filling { views: &self.views, before, left, has: vec![0f32; self.views.len()], next: 0, send };
            let passed = backward(loss, leaves.tensors(), &mut |k, gradient| filling.add(k, Some(&gradient)));
            // What the pass did not come to.
            for k in (0..self.views.len()).rev() {
                if filling.has[k] == 0.0 {
                    filling.add(k, None);
                }
            }
            let has = filling.has;
            drop(filling.send);
            let summed = sums.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            passed.map_err(|e| TrainError::Task(e.to_string()))?;
            summed.map_err(TrainError::from)?;
            Ok::<_, TrainError>(has)
        });
        let mut has = summed?;
        has.iter_mut().for_each(|h| *h = h.max(0.0));
        ranks.sum(&mut has)?;
        let device = leaves.tensors().first().map_or(Device::Cpu, Tensor::device);
        let gradient = |((_, view), has): (&(usize, Tensor), f32)| match has > 0.0 {
            true => view.to_device(device),
            false => Tensor::new(),
        };
        Ok(self.views.iter().zip(has).map(gradient).collect())
    }
}

/// The numbers of a bucket, for another thread.
struct Slice(*mut f32, usize);

// SAFETY: whoever has it is the only one to use it, as `Buckets::sum` sees to.
unsafe impl Send for Slice {}

impl Slice {
    fn of(flat: &Tensor) -> Self {
        Self(flat.data_ptr().cast(), flat.numel())
    }

    /// # Safety
    /// The tensor lives, is of contiguous f32 on the CPU, and nobody else looks at it meanwhile.
    #[allow(clippy::mut_from_ref)]
    unsafe fn values(&self) -> &mut [f32] {
        // SAFETY: as the caller promises.
        unsafe { std::slice::from_raw_parts_mut(self.0, self.1) }
    }
}

/// Buckets while they are filled.
struct Filling<'a> {
    views: &'a [(usize, Tensor)],
    before: &'a [Vec<Tensor>],
    /// Gradients that a bucket still lacks.
    left: Vec<usize>,
    /// Of each parameter: 0 before it was come to, 1 with a gradient, -1 without.
    has: Vec<f32>,
    /// The bucket to be sent next.
    next: usize,
    send: Sender<usize>,
}

impl Filling<'_> {
    fn add(&mut self, k: usize, gradient: Option<&Tensor>) {
        let _no_grad = tch::no_grad_guard();
        let (bucket, view) = &self.views[k];
        let (mut view, mut has) = (view.shallow_clone(), false);
        let earlier = self.before.iter().rev().map(|sums| &sums[k]).filter(|t| t.defined());
        for part in gradient.into_iter().chain(earlier) {
            if has {
                let _ = view.g_add_(part);
            } else {
                view.copy_(part);
            }
            has = true;
        }
        if !has {
            let _ = view.zero_();
        }
        self.has[k] = if has { 1.0 } else { -1.0 };
        self.left[*bucket] -= 1;
        while self.left.get(self.next) == Some(&0) {
            // The other side ends early where another rank is gone; it says so itself.
            let _ = self.send.send(self.next);
            self.next += 1;
        }
    }
}

#[cfg(test)]
mod tests {
    use riglab_ranks::{halves, on_threads};

    use super::*;

    #[test]
    fn batches_are_dealt_out_once_each() {
        let deals = on_threads(3, |ranks| Deal::new(6, &ranks).unwrap());
        let numbers = |k: usize| (0..4).map(|n| deals[k].number(n)).collect::<Vec<_>>();
        assert_eq!([numbers(0), numbers(1), numbers(2)], [[0, 1, 6, 7], [2, 3, 8, 9], [4, 5, 10, 11]]);
        let (key, message) = on_threads(2, |ranks| Deal::new(3, &ranks).unwrap_err()).remove(0);
        assert!(key == "accumulate" && message.contains("multiple of 2"), "{message}");
        assert_eq!(Deal::new(5, &Ranks::alone()).unwrap().number(13), 13);
    }

    #[test]
    fn parts_in_order_fold_like_the_tree() {
        for n in 1..20u64 {
            let mut stack: Vec<String> = Vec::new();
            for k in 0..n {
                let mut sum = k.to_string();
                for _ in 0..folds(n, k) {
                    sum = format!("({},{sum})", stack.pop().unwrap());
                }
                stack.push(sum);
            }
            let tree = halves(0..n as usize, &mut |k| k.to_string(), &mut |a, b| format!("({a},{b})"));
            assert_eq!(stack, [tree]);
        }
    }
}
