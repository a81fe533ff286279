//! What is computed beside libtorch where that has one thread.

use riglab_torch::{Settings, init};

#[test]
fn rayon_has_two_threads_beside_one_of_libtorch_however_many_processors_there_are() {
    assert_eq!(init(Settings { threads: 1 }), 1);
    assert_eq!(rayon::current_num_threads(), 2);
}
