#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| riglab_fuzz::checkpoint(bytes));

libfuzzer_sys::fuzz_mutator!(|data: &mut [u8], size: usize, most: usize, seed: u32| {
    riglab_fuzz::mutate_archive(data, size, most, seed)
});
