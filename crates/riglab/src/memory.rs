//! What is said where memory ends.

/// Ends the process with a sentence where libtorch gets no memory, in place of a panic and a C++ backtrace: that a batch is
/// too large for a GPU is a setting to change, and no fault of the program.
pub fn ends_in_a_sentence() {
    let usual = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let said = panic.payload().downcast_ref::<String>();
        let Some(sentence) = said.and_then(|text| riglab_torch::out_of_memory(text)) else { return usual(panic) };
        tell!("error: {sentence}");
        riglab_files::leave(1);
    }));
}
