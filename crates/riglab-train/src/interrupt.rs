//! Ctrl-C: the first asks the run to save and leave, the second ends the process.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// Signals so close together are one wish: a cluster tells every process of a job, and those that run others pass it on.
const ONE_WISH: Duration = Duration::from_secs(1);

/// A wish to stop, shared by whoever has it.
#[derive(Clone, Default)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// Listens for SIGINT and SIGTERM. Only the first call of a process can; later ones give an
    /// interrupt that nobody raises.
    pub fn listening() -> Self {
        let interrupt = Self::default();
        let raised = interrupt.0.clone();
        let mut told: Option<Instant> = None;
        let _ = ctrlc::set_handler(move || {
            let close = told.is_some_and(|at| at.elapsed() < ONE_WISH);
            told.get_or_insert_with(Instant::now);
            if close {
                return;
            }
            if raised.swap(true, Ordering::SeqCst) {
                riglab_files::leave(130);
            }
            eprintln!("\ninterrupted: saving after this step (once more to leave at once)");
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
