//! Ctrl-C: the first asks the run to save and leave, the second ends the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use riglab_ranks::Ranks;

use crate::progress::tell;

/// Signals so close together are one wish: a cluster tells every process of a job, and those that run others pass it on.
const ONE_WISH: Duration = Duration::from_secs(1);

/// A wish to stop, shared by whoever has it.
#[derive(Clone, Default)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Listens for SIGINT and SIGTERM. Only the first call of a process can; later ones give an
    /// interrupt that nobody raises.
    pub fn listening() -> Self {
        Self::listen(true)
    }

    /// As [`Self::listening`], where all of `ranks` hear the signal: the leading one says so for all.
    pub fn listening_with(ranks: &Ranks) -> Self {
        Self::listen(ranks.leads())
    }

    fn listen(says: bool) -> Self {
        let interrupt = Self::default();
        let raised = interrupt.0.clone();
        let mut first: Option<Instant> = None;
        let _ = riglab_files::on_signals(move || {
            if is_the_same_wish(&mut first, Instant::now()) {
                return;
            }
            if raised.swap(true, Ordering::SeqCst) {
                riglab_files::leave(130);
            }
            if says {
                tell(format_args!("\ninterrupted: saving after this step (Ctrl-C again to quit at once)"));
            }
        });
        interrupt
    }

    /// Raises it.
    pub fn raise(&self) {
        self.0.store(true, Ordering::SeqCst);
    }

    /// Whether it was raised.
    pub fn raised(&self) -> bool {
        self.0.load(Ordering::SeqCst)
    }
}

/// Whether a signal says again what the first one said.
fn is_the_same_wish(first: &mut Option<Instant>, now: Instant) -> bool {
    match first {
        Some(at) => now.duration_since(*at) < ONE_WISH,
        None => {
            *first = Some(now);
            false
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signals_of_one_moment_are_one_wish() {
        let (mut first, start) = (None, Instant::now());
        let mut told = |ms: u64| is_the_same_wish(&mut first, start + Duration::from_millis(ms));
        assert!(!told(0), "the first asks to save");
        assert!(told(3) && told(900), "what others pass on");
        assert!(!told(1000) && !told(5000), "whoever insists");
    }
}
