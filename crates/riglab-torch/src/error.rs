//! Errors of libtorch, cut to the sentence that says what is wrong.

use std::any::Any;
use std::ffi::CStr;
use std::os::raw::{c_char, c_int};

use thiserror::Error;

/// libtorch refused.
#[derive(Debug, Error)]
#[error("libtorch: {0}")]
pub struct TorchError(pub String);

impl From<tch::TchError> for TorchError {
    fn from(e: tch::TchError) -> Self {
        Self(first_line(&e.to_string()))
    }
}

/// The first line of a libtorch message; the rest is a C++ backtrace.
pub fn first_line(message: &str) -> String {
    let line = message.lines().next().unwrap_or_default();
    line.trim_start_matches("Internal torch error: ").trim().to_string()
}

unsafe extern "C" {
    fn rl_error() -> *const c_char;
}

/// The result of a shim function.
pub(crate) fn check(code: c_int) -> Result<(), TorchError> {
    if code == 0 {
        return Ok(());
    }
    // SAFETY: the shim keeps the message of this thread until its next error.
    let text = unsafe { CStr::from_ptr(rl_error()) }.to_string_lossy();
    Err(TorchError(first_line(&text)))
}

/// What a panic said, on one line.
pub fn said(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<String>().map(String::as_str).or(panic.downcast_ref::<&str>().copied());
    first_line(text.unwrap_or("without words"))
}
