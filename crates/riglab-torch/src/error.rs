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

/// How the sentence of [`out_of_memory`] begins.
const NO_MEMORY: &str = "no memory is left for another ";

/// A sentence with a remedy for what libtorch says, or a panic of it, where the machine or the GPU has no memory left;
/// nothing for other messages.
pub fn out_of_memory(message: &str) -> Option<String> {
    if let Some(at) = message.find(NO_MEMORY) {
        return message[at..].lines().next().map(str::to_owned);
    }
    if !message.contains("can't allocate memory") && !message.contains("out of memory") {
        return None;
    }
    // `you tried to allocate 2684354624 bytes. Error code 12`, `Tried to allocate 20.00 GiB. GPU 0 has a total capacity of`.
    let asked = message.split_once("ried to allocate ")?.1;
    let asked = asked.split(". ").next().unwrap_or_default().lines().next().unwrap_or_default();
    let bytes = asked.strip_suffix(" bytes").and_then(|n| n.parse::<f64>().ok());
    let asked = bytes.map_or_else(|| asked.to_owned(), |n| format!("{:.3} GB", n / 1e9));
    let whose = if message.contains("CUDA") { "the GPU's" } else { "the machine's" };
    Some(format!(
        "{NO_MEMORY}{asked} of {whose}: make batches smaller (`sampling`, train.accumulate; in evaluations eval.rows, \
         eval.chunk) or the network; `riglab train CONFIG --dry-run` says what a run takes"
    ))
}

/// The first line of a libtorch message, whose rest is a C++ backtrace; a sentence where memory is what is missing.
pub fn first_line(message: &str) -> String {
    if let Some(sentence) = out_of_memory(message) {
        return sentence;
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn where_memory_is_missing_a_sentence_says_how_much_and_what_to_do() {
        let cpu = "[enforce fail at alloc_cpu.cpp:127] err == 0. DefaultCPUAllocator: can't allocate memory: you tried to \
                   allocate 2684354624 bytes. Error code 12 (Cannot allocate memory)\nframe #0: c10::";
        let said = first_line(cpu);
        assert!(said.starts_with("no memory is left for another 2.684 GB of the machine's: make batches"), "{said}");
        let gpu = "called `Result::unwrap()` on an `Err` value: Torch(\"CUDA out of memory. Tried to allocate 20.00 GiB. \
                   GPU 0 has a total capacity of 139.81 GiB of which 3.20 GiB is free.\\nframe #0: c10::";
        let said = out_of_memory(gpu).unwrap();
        assert!(said.starts_with("no memory is left for another 20.00 GiB of the GPU's: make batches"), "{said}");
        // What was said once stays as it is.
        let error = TorchError(first_line(cpu)).to_string();
        assert_eq!(out_of_memory(&error), Some(first_line(cpu)));
        assert_eq!(out_of_memory("index out of range"), None);
        assert_eq!(first_line("Internal torch error: shapes differ\nframe #0"), "shapes differ");
    }
}
