//! What a process does when it is asked to leave.

use std::sync::atomic::{AtomicBool, Ordering};

/// What asked a process to leave.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Signal(u8);

impl Signal {
    /// Ctrl-C.
    pub const INTERRUPT: Self = Self(2);
    const TERMINATE: Self = Self(15);
    const HANG_UP: Self = Self(1);

    /// What a process ends with that leaves for it, as shells and schedulers count: 130 for Ctrl-C, 143 for SIGTERM.
    pub fn code(self) -> u8 {
        128 + self.0
    }
}

/// Whether a process that ended with this code left because it was asked to.
pub fn was_asked(code: Option<i32>) -> bool {
    [Signal::INTERRUPT, Signal::TERMINATE, Signal::HANG_UP].iter().any(|signal| code == Some(signal.code().into()))
}

/// Whether somebody listens.
static HEARD: AtomicBool = AtomicBool::new(false);

/// Calls `f`, on a thread of its own, at each SIGINT, SIGTERM and SIGHUP from now on; false where signals cannot be
/// listened to, as from the second call on: what was before stays then. A SIGHUP that whoever started the process had it
/// pass over, as `nohup` does, stays passed over.
///
/// What a signal interrupts is not written upon: libtorch's products of f32 keep numbers where a signal would put what it
/// interrupts, and the process would die of that. It is put on the stack for such cases that Rust gives to its threads, the first of
/// which the system tells.
pub fn on_signals(f: impl FnMut(Signal) + Send + 'static) -> bool {
    !HEARD.swap(true, Ordering::SeqCst) && listen(f).is_ok()
}

#[cfg(unix)]
fn listen(mut f: impl FnMut(Signal) + Send + 'static) -> std::io::Result<()> {
    let all = [Signal::INTERRUPT, Signal::TERMINATE, Signal::HANG_UP];
    // Of SIGINT shells do so to whatever they start in the background, where `kill -INT` is meant all the same.
    let heard = all.into_iter().filter(|signal| *signal != Signal::HANG_UP || !is_ignored(signal.0.into()));
    let numbers: Vec<libc::c_int> = heard.map(|signal| signal.0.into()).collect();
    let mut signals = signal_hook::iterator::Signals::new(&numbers)?;
    numbers.into_iter().for_each(aside);
    let each = move || signals.forever().filter_map(|number| u8::try_from(number).ok()).for_each(|n| f(Signal(n)));
    std::thread::Builder::new().name("signals".into()).spawn(each).map(drop)
}

/// Which signal it is cannot be told here.
#[cfg(not(unix))]
fn listen(mut f: impl FnMut(Signal) + Send + 'static) -> Result<(), ctrlc::Error> {
    ctrlc::set_handler(move || f(Signal::INTERRUPT))
}

/// What a signal does now.
#[cfg(unix)]
fn action(signal: libc::c_int) -> Option<libc::sigaction> {
    // SAFETY: an action of zeros is one, and it is only written.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        (libc::sigaction(signal, std::ptr::null(), &mut action) == 0).then_some(action)
    }
}

#[cfg(unix)]
fn is_ignored(signal: libc::c_int) -> bool {
    action(signal).is_some_and(|action| action.sa_sigaction == libc::SIG_IGN)
}

/// Has a signal's handler run on a thread's stack for signals, where it has one.
#[cfg(unix)]
fn aside(signal: libc::c_int) {
    if let Some(mut action) = action(signal) {
        action.sa_flags |= libc::SA_ONSTACK;
        // SAFETY: it is set as it was but for a flag.
        unsafe { libc::sigaction(signal, &action, std::ptr::null_mut()) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_shells() {
        assert_eq!([Signal::INTERRUPT, Signal::TERMINATE, Signal::HANG_UP].map(Signal::code), [130, 143, 129]);
        assert!(was_asked(Some(143)) && was_asked(Some(130)));
        assert!(![None, Some(0), Some(1), Some(137)].into_iter().any(was_asked));
    }
}
