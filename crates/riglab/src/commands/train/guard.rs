//! Memory that a training takes before anyone knows how much it is.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use riglab_torch::memory_gb;
use riglab_train::Run;

use super::dry_run::time;

/// Ends the process before it has taken what the machine has left: the system would end it, or another program, without a
/// word.
pub(super) struct Guard(Arc<AtomicBool>);

/// How often memory is looked at: a batch of a large network takes gigabytes in a second.
const LOOKS: Duration = Duration::from_millis(50);

impl Guard {
    /// Watches until it is dropped, or until `enough`, which is asked each time that memory is looked at.
    pub(super) fn until(enough: impl Fn() -> bool + Send + 'static) -> Self {
        let done = Arc::new(AtomicBool::new(false));
        let (seen, begin) = (done.clone(), Instant::now());
        std::thread::spawn(move || {
            while !seen.load(Ordering::Relaxed) && !enough() {
                if is_short(memory_gb("MemAvailable"), memory_gb("MemTotal")) {
                    tell!("error: {}", too_much(begin.elapsed().as_secs_f64(), memory_gb("MemTotal").unwrap_or(0.0)));
                    riglab_files::leave(1);
                }
                std::thread::sleep(LOOKS);
            }
        });
        Self(done)
    }

    /// Watches a run until its first step is written down: what a step takes has been taken then, and a run that is going
    /// well is not ended for what other programs take. One that goes on has none where it was ended before it.
    pub(super) fn of_first_step(run: &Run) -> Self {
        let metrics = run.path("metrics.jsonl");
        Self::until(move || metrics.metadata().is_ok_and(|file| file.len() > 0))
    }
}

impl Drop for Guard {
    fn drop(&mut self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Whether so little of all memory is left, in GB, that programs are about to be ended. Where the system does not say it is
/// not.
fn is_short(left: Option<f64>, all: Option<f64>) -> bool {
    left.zip(all).is_some_and(|(left, all)| left < (0.04 * all).min(1.0))
}

fn too_much(seconds: f64, all: f64) -> String {
    format!(
        "stopped after {}, as next to nothing is left of this machine's {all:.0} GB: the run takes more than is free; make \
         its batches smaller (`sampling`, train.accumulate) or its network, or give it a machine with more memory",
        time(seconds)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_short_before_none_is_left() {
        let of = |left, all| is_short(Some(left), Some(all));
        assert_eq!([of(0.9, 24.0), of(1.1, 24.0), of(0.1, 2.0), of(0.0, 2.0)], [true, false, false, true]);
        assert!(of(0.07, 2.0) && of(0.99, 512.0) && !of(1.0, 512.0));
        assert!(!is_short(None, Some(24.0)) && !is_short(Some(0.0), None));
        assert!(
            too_much(75.0, 24.4).starts_with("stopped after 75 s, as next to nothing is left of this machine's 24 GB")
        );
    }

    #[test]
    fn a_run_is_watched_until_its_first_step_is_written_down() {
        let dir = tempfile::tempdir().unwrap();
        let place = dir.path().join("run");
        drop(Run::create(&place, "").unwrap());
        let watched = |guard: &Guard| Arc::strong_count(&guard.0) == 2;
        let ends = |guard: &Guard| {
            let begin = Instant::now();
            while watched(guard) {
                assert!(begin.elapsed() < Duration::from_secs(60));
                std::thread::sleep(LOOKS);
            }
        };
        // As one that was ended before its first step.
        let run = Run::open(&place).unwrap();
        let guard = Guard::of_first_step(&run);
        std::thread::sleep(2 * LOOKS);
        assert!(watched(&guard));
        std::fs::write(run.path("metrics.jsonl"), "{\"step\":1}\n").unwrap();
        ends(&guard);
        ends(&Guard::of_first_step(&run));
    }
}
