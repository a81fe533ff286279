//! Batches made ahead by threads, in order.

use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Gives batches by number. A batch depends on its number only, so it does not matter which thread
/// makes it, or when.
pub trait Source: Send + Sync {
    /// What is made.
    type Batch: Send;

    /// The batch of that number.
    ///
    /// # Errors
    /// A sentence; the run ends with it.
    fn batch(&self, number: u64) -> Result<Self::Batch, String>;
}

/// What a thread does.
type Work = Box<dyn FnOnce() + Send>;
/// A thread; `None` where the system allows no further one.
type Begun = Option<JoinHandle<()>>;

/// Batches each thread may be ahead.
const AHEAD: usize = 2;

/// Batches `from..` in order, made by `workers` threads; each thread makes every n-th.
pub struct Prefetch<B: Send + 'static> {
    source: Arc<dyn Source<Batch = B>>,
    queues: Vec<Receiver<Result<B, String>>>,
    threads: Vec<JoinHandle<()>>,
    next: u64,
    from: u64,
    waited: Duration,
}

impl<B: Send + 'static> Prefetch<B> {
    /// Starts the threads, or as many of them as the system allows. Without any, batches are made when they are asked for.
    pub fn new(source: Arc<dyn Source<Batch = B>>, from: u64, workers: usize) -> Self {
        Self::begun(source, from, workers, |work| std::thread::Builder::new().spawn(work).ok())
    }

    fn begun(source: Arc<dyn Source<Batch = B>>, from: u64, workers: usize, begin: impl Fn(Work) -> Begun) -> Self {
        let mut queues = Vec::with_capacity(workers);
        let mut threads = Vec::with_capacity(workers);
        let mut strides = Vec::with_capacity(workers);
        for w in 0..workers as u64 {
            let (send, receive) = sync_channel(AHEAD);
            let (tell, told) = channel();
            let (ready, waiting) = channel();
            let source = source.clone();
            let work = move || {
                // Batches may be computed with libtorch: with the number of threads that is set now, whatever others
                // are given later.
                let _ = tch::get_num_threads();
                let _ = ready.send(());
                // How many share the batches is known once all have begun.
                let Ok(stride) = told.recv() else { return };
                let mut number = from + w;
                // The receiver is gone when the run ends.
                while send.send(source.batch(number)).is_ok() {
                    number += stride;
                }
            };
            let Some(thread) = begin(Box::new(work)) else { break };
            let _ = waiting.recv();
            threads.push(thread);
            queues.push(receive);
            strides.push(tell);
        }
        for tell in strides {
            let _ = tell.send(threads.len() as u64);
        }
        Self { source, queues, threads, next: from, from, waited: Duration::ZERO }
    }

    /// The next batch.
    ///
    /// # Errors
    /// The source's sentence.
    pub fn take(&mut self) -> Result<B, String> {
        let start = Instant::now();
        let number = self.next;
        self.next += 1;
        let batch = match self.queues.len() {
            0 => self.source.batch(number),
            n => {
                let queue = &self.queues[((number - self.from) % n as u64) as usize];
                queue.recv().unwrap_or_else(|_| Err("a loader thread ended unexpectedly".into()))
            }
        };
        self.waited += start.elapsed();
        batch
    }

    /// Time spent in [`Self::take`] since the last call of this.
    pub fn take_waited(&mut self) -> Duration {
        std::mem::take(&mut self.waited)
    }
}

impl<B: Send + 'static> Drop for Prefetch<B> {
    fn drop(&mut self) {
        self.queues.clear();
        for thread in self.threads.drain(..) {
            // A thread that panicked has said so; there is nothing to add.
            let _ = thread.join();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Squares;
    impl Source for Squares {
        type Batch = u64;
        fn batch(&self, number: u64) -> Result<u64, String> {
            // Later batches are ready first.
            std::thread::sleep(Duration::from_millis(10 - number % 10));
            if number == 30 { Err("no thirty".into()) } else { Ok(number * number) }
        }
    }

    #[test]
    fn order_does_not_depend_on_workers() {
        for workers in [0, 1, 3, 4] {
            let mut batches = Prefetch::new(Arc::new(Squares), 5, workers);
            let got: Vec<u64> = (0..10).map(|_| batches.take().unwrap()).collect();
            assert_eq!(got, (5..15).map(|n| n * n).collect::<Vec<_>>());
        }
    }

    #[test]
    fn fewer_threads_than_workers_make_the_same_batches() {
        for allowed in [0, 1, 2] {
            let left = std::cell::Cell::new(allowed);
            let begin = |work: Work| {
                left.set(left.get() - 1);
                (left.get() >= 0).then(|| std::thread::spawn(work))
            };
            let mut batches = Prefetch::begun(Arc::new(Squares), 5, 4, begin);
            assert_eq!(batches.threads.len(), allowed as usize);
            let got: Vec<u64> = (0..10).map(|_| batches.take().unwrap()).collect();
            assert_eq!(got, (5..15).map(|n| n * n).collect::<Vec<_>>());
        }
    }

    #[test]
    fn errors_arrive_in_order_too() {
        let mut batches = Prefetch::new(Arc::new(Squares), 28, 2);
        assert_eq!((batches.take(), batches.take()), (Ok(784), Ok(841)));
        assert_eq!(batches.take(), Err("no thirty".to_string()));
    }
}
