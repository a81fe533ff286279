//! Ctrl-C: the first asks the run to save and leave, the second ends the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicU8, Ordering};
use std::time::{Duration, Instant};

use riglab_files::Signal;
use riglab_ranks::Ranks;

use crate::progress::tell;

/// Signals so close together are one wish: a cluster tells every process of a job, and those that run others pass it on.
const ONE_WISH: Duration = Duration::from_secs(1);

/// A wish to stop, shared by whoever has it: the code that the process then ends with, or 0 where there is none.
#[derive(Clone, Default)]
pub struct Interrupt(Arc<AtomicU8>);

impl Interrupt {
    /// Listens for SIGINT and SIGTERM. Only the first call of a process can; later ones give an
    /// interrupt that nobody raises.
    pub fn listening() -> Self {
        Self::listen(Some("saving after this step"))
    }

    /// As [`Self::listening`], where something else than a training is asked to leave: `what` happens then.
    pub fn listening_for(what: &'static str) -> Self {
        Self::listen(Some(what))
    }

    /// As [`Self::listening`], where all of `ranks` hear the signal: the leading one says so for all.
    pub fn listening_with(ranks: &Ranks) -> Self {
        Self::listen(ranks.leads().then_some("saving after this step"))
    }

    fn listen(says: Option<&'static str>) -> Self {
        let interrupt = Self::default();
        let raised = interrupt.0.clone();
        let mut first: Option<Instant> = None;
        let _ = riglab_files::on_signals(move |signal| {
            if is_the_same_wish(&mut first, Instant::now()) {
                return;
            }
            if raised.swap(signal.code(), Ordering::SeqCst) != 0 {
                riglab_files::leave(signal.code().into());
            }
            if let Some(what) = says {
                tell(format_args!("\ninterrupted: {what} (Ctrl-C again to quit at once)"));
            }
        });
        interrupt
    }

    /// Raises it.
    pub fn raise(&self) {
        self.0.store(Signal::INTERRUPT.code(), Ordering::SeqCst);
    }

    /// Whether it was raised.
    pub fn raised(&self) -> bool {
        self.0.load(Ordering::SeqCst) != 0
    }

    /// What the process ends with that has left for it: by the signal, and as by Ctrl-C where another process heard that.
    pub fn code(&self) -> u8 {
        match self.0.load(Ordering::SeqCst) {
            0 => Signal::INTERRUPT.code(),
            code => code,
        }
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
    fn the_code_is_that_of_the_signal() {
        let interrupt = Interrupt::default();
        assert!(!interrupt.raised());
        assert_eq!(interrupt.code(), 130);
        interrupt.0.store(143, Ordering::SeqCst);
        assert!(interrupt.raised() && interrupt.clone().code() == 143);
    }

    #[test]
    fn signals_of_one_moment_are_one_wish() {
        let (mut first, start) = (None, Instant::now());
        let mut told = |ms: u64| is_the_same_wish(&mut first, start + Duration::from_millis(ms));
        assert!(!told(0), "the first asks to save");
        assert!(told(3) && told(900), "what others pass on");
        assert!(!told(1000) && !told(5000), "whoever insists");
    }
}
