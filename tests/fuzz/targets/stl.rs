#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| riglab_fuzz::asset("fuzz.stl", bytes));
