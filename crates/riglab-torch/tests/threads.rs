//! How many threads there are, of libtorch and beside it.

use riglab_torch::{Settings, init};

#[test]
fn rayon_has_as_many_threads_as_libtorch() {
    // Another number than there are processors.
    let asked = 1 + std::thread::available_parallelism().map_or(1, usize::from);
    assert_eq!(init(Settings { threads: asked }), asked);
    assert_eq!(rayon::current_num_threads(), asked);
    assert_eq!(init(Settings { threads: 1 }), asked, "only the first call counts");
}
