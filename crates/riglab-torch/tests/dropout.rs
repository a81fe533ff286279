//! Dropout and libtorch's generator, which all threads of a process share: a process of its own.

use riglab_torch::{dropout, rng_state, set_rng_state};
use tch::{Device, Kind, Tensor};

#[test]
fn the_generator_decides_and_goes_on_whatever_the_threads() {
    let drawn = || dropout(&Tensor::ones([701, 301], (Kind::Float, Device::Cpu)), 0.5).unwrap();
    tch::set_num_threads(4);
    let state = rng_state(Device::Cpu).unwrap();
    let (first, second) = (drawn(), drawn());
    assert_ne!(first, second);
    set_rng_state(Device::Cpu, &state).unwrap();
    tch::set_num_threads(1);
    assert_eq!((drawn(), drawn()), (first, second));
}
