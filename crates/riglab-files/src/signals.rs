//! What a process does when it is asked to leave.

/// Calls `f`, on a thread of its own, at each SIGINT, SIGTERM and SIGHUP from now on; false where signals cannot be
/// listened to, as from the second call on: what was before stays then.
///
/// What a signal interrupts is not written upon: libtorch's products of f32 keep numbers where a signal would put what it
/// interrupts, and the process would die of that. It is put on the stack for such cases that Rust gives to its threads, the first of
/// which the system tells.
pub fn on_signals(f: impl FnMut() + Send + 'static) -> bool {
    let heard = ctrlc::set_handler(f).is_ok();
    #[cfg(unix)]
    if heard {
        [libc::SIGINT, libc::SIGTERM, libc::SIGHUP].into_iter().for_each(aside);
    }
    heard
}

/// Has a signal's handler run on a thread's stack for signals, where it has one.
#[cfg(unix)]
fn aside(signal: libc::c_int) {
    // SAFETY: an action of zeros is one; it is written before it is read, and set as it was but for a flag.
    unsafe {
        let mut action: libc::sigaction = std::mem::zeroed();
        if libc::sigaction(signal, std::ptr::null(), &mut action) == 0 {
            action.sa_flags |= libc::SA_ONSTACK;
            libc::sigaction(signal, &action, std::ptr::null_mut());
        }
    }
}
