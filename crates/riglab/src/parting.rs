//! What is told when a command is asked to leave that does so at once.

use std::sync::{Mutex, PoisonError};

static WORDS: Mutex<String> = Mutex::new(String::new());

/// What is told from now on; nothing where it is empty.
pub fn set(words: String) {
    *WORDS.lock().unwrap_or_else(PoisonError::into_inner) = words;
}

/// Tells it, below a bar that may be there.
pub fn tell() {
    let words = WORDS.lock().unwrap_or_else(PoisonError::into_inner);
    if !words.is_empty() {
        tell!("\n{words}");
    }
}
