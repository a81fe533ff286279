//! Batches of a step side by side, each on a thread of its own.
//!
//! A network of a laptop's size cannot keep two processors busy with one small product after another; two batches can.
//! What they give does not hang on where they are computed: it is that of one after another on as many threads each.

use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use riglab_nn::params::Weights;
use riglab_ranks::{ALONE, Ranks};

use crate::config::TrainConfig;
use crate::error::TrainError;
use crate::step::{Given, given};
use crate::task::{At, LossOf, Task};

/// A batch of a step and what its loss is to be computed with.
struct Job<B> {
    /// The weights, as leaves of this batch alone.
    leaves: Weights,
    batch: B,
    seed: u64,
    step: u64,
    number: u64,
    share: f64,
}

/// A thread that computes losses and gradients.
struct Hand<B> {
    begun: Receiver<()>,
    jobs: Option<Sender<Job<B>>>,
    done: Receiver<Result<Given, TrainError>>,
    thread: Option<JoinHandle<()>>,
}

/// Threads that compute batches beside the one that asks for them.
pub(crate) struct Hands<B> {
    hands: Vec<Hand<B>>,
    /// Threads within an op as long as a batch is computed alone.
    all: i32,
    /// Threads within an op of each batch while they are side by side.
    each: i32,
}

impl<B: Send + 'static> Hands<B> {
    /// As many as [`sides`] says but for this thread, or as the system allows.
    pub fn of<T: Task<Batch = B>>(task: &T, config: &TrainConfig, ranks: &Ranks) -> Self {
        let all = tch::get_num_threads().max(1);
        let sides = sides(task, config, ranks);
        let each = all / sides as i32;
        let hands = (1..sides).map_while(|_| Hand::new(task.beside()?, each));
        let hands: Vec<_> = hands.collect();
        // The last number that a thread asks for is what new threads begin with.
        hands.iter().for_each(Hand::ready);
        tch::set_num_threads(all);
        let each = if hands.is_empty() { all } else { each };
        Self { hands, all, each }
    }

    /// How many batches can be computed at a time.
    pub fn sides(&self) -> usize {
        self.hands.len() + 1
    }

    /// What batches give that follow each other from number `at.batch` on, as many as there are sides at most. `first`
    /// computes the first of them, on this thread.
    pub fn compute(
        &self,
        weights: &Weights,
        batches: Vec<B>,
        at: At,
        share: f64,
        first: impl FnOnce(B) -> Result<Given, TrainError>,
    ) -> Vec<Result<Given, TrainError>> {
        let mut batches = batches.into_iter();
        let Some(own) = batches.next() else { return Vec::new() };
        if self.each != self.all {
            tch::set_num_threads(self.each);
        }
        let busy: Vec<&Hand<B>> = (1..)
            .zip(batches)
            .zip(&self.hands)
            .map(|((k, batch), hand)| {
                let leaves = weights.cast(weights.kind()).recomputing(weights.recomputes());
                hand.give(Job { leaves, batch, seed: at.seed, step: at.step, number: at.batch + k, share });
                hand
            })
            .collect();
        let own = first(own);
        let mut given = vec![own];
        given.extend(busy.into_iter().map(Hand::take));
        if self.each != self.all {
            tch::set_num_threads(self.all);
        }
        given
    }
}

/// Gives this thread its number of threads within an op, which it would otherwise take, once it needs it, from the last
/// that any thread was given.
fn settle(threads: i32) {
    let _ = tch::get_num_threads();
    tch::set_num_threads(threads);
}

/// How many batches of a step are computed at a time with the threads there are: 1 where each is computed by itself.
pub fn sides<T: Task>(task: &T, config: &TrainConfig, ranks: &Ranks) -> usize {
    // Of several ranks each has its own processors, and gradients that meet while they come.
    let sides = if ranks.size() > 1 { 1 } else { sides_of(config.accumulate, allowed(config)) };
    if sides > 1 && task.beside().is_none() { 1 } else { sides as usize }
}

/// Threads, as far as batches may share them.
fn allowed(config: &TrainConfig) -> u64 {
    let all = tch::get_num_threads().max(1) as u64;
    if config.side_by_side == 0 { all } else { config.side_by_side.min(all) }
}

/// Batches at a time: as few as need no more rounds than with a thread for each.
fn sides_of(batches: u64, threads: u64) -> u64 {
    batches.div_ceil(batches.div_ceil(threads.max(1)).max(1)).max(1)
}

impl<B: Send + 'static> Hand<B> {
    /// `None` where the system allows no further thread.
    fn new(loss: LossOf<B>, threads: i32) -> Option<Self> {
        let (jobs, asked) = channel::<Job<B>>();
        let (tell, done) = channel();
        let (begin, begun) = channel();
        let work = move || {
            settle(threads);
            let _ = begin.send(());
            for job in asked {
                tch::set_num_threads(threads);
                let at = At { seed: job.seed, step: job.step, batch: job.number, ranks: &ALONE };
                let one = || {
                    riglab_torch::own_generator(at.generator_seed()).map_err(|e| e.to_string())?;
                    loss(&job.leaves, &job.batch, at)
                };
                let found = riglab_torch::counted_along(|| given(&job.leaves, job.share, one));
                let found = found.unwrap_or_else(|e| Err(TrainError::Task(e.to_string())));
                if tell.send(found).is_err() {
                    return;
                }
            }
        };
        let thread = std::thread::Builder::new().spawn(work).ok()?;
        Some(Self { begun, jobs: Some(jobs), done, thread: Some(thread) })
    }

    /// Waits until it has its number of threads.
    fn ready(&self) {
        let _ = self.begun.recv();
    }

    fn give(&self, job: Job<B>) {
        // A thread that has ended says so when it is asked for what it made.
        let _ = self.jobs.as_ref().map(|jobs| jobs.send(job));
    }

    fn take(&self) -> Result<Given, TrainError> {
        let ended = || Err(TrainError::Task("a thread that computed a batch ended unexpectedly".into()));
        self.done.recv().unwrap_or_else(|_| ended())
    }
}

impl<B> Drop for Hand<B> {
    fn drop(&mut self) {
        self.jobs = None;
        if let Some(thread) = self.thread.take() {
            // A thread that panicked has said so; there is nothing to add.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_lie_side_by_side_in_as_few_rounds_as_possible() {
        let found: Vec<_> = [(1, 8), (2, 2), (3, 2), (4, 3), (4, 16), (5, 1), (6, 4), (8, 3)]
            .map(|(batches, threads)| sides_of(batches, threads))
            .to_vec();
        assert_eq!(found, [1, 2, 2, 2, 4, 1, 3, 3]);
    }
}
