//! Memory of freed tensors is kept for the next one: a process of its own, as other tests' tensors would take it.

use riglab_torch::{Settings, init};
use tch::{Device, Kind, Tensor};

#[test]
fn freed_memory_is_taken_again_up_to_a_bound() {
    init(Settings::default());
    let made = |n: i64| Tensor::zeros([n], (Kind::Float, Device::Cpu));
    let place = |t: &Tensor| t.data_ptr() as usize;
    let first = made(300_000);
    let (kept, other) = (place(&first), made(300_000));
    assert_eq!(kept % 64, 0);
    assert_ne!(place(&other), kept, "what is in use is nobody else's");
    drop(first);
    // A little less takes a block of the same size; what was there before is not seen.
    let second = made(290_000);
    assert_eq!(place(&second), kept);
    let _ = second.shallow_clone().fill_(3.0);
    drop(second);
    let third = made(300_000);
    assert_eq!((place(&third), third.abs().max().double_value(&[])), (kept, 0.0));
    // Larger than all that is kept.
    assert_eq!(made(140_000_000).abs().max().double_value(&[]), 0.0);
    // Hundreds of sizes, small ones and none, from several threads.
    std::thread::scope(|scope| {
        for k in 0..4i64 {
            scope.spawn(move || {
                for n in (0..300).map(|i| (i * 7919 + k) % 40_000).chain([0, 1]) {
                    let t = Tensor::full([n], k as f64, (Kind::Float, Device::Cpu));
                    assert_eq!(t.sum(Kind::Double).double_value(&[]), (n * k) as f64);
                }
            });
        }
    });
}
