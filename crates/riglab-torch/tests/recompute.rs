//! Blocks that are computed again, where memory's peak and libtorch's generator are seen: both are the process's, so
//! these tests have a process of their own and go one by one.

use std::sync::{Mutex, PoisonError};

use riglab_torch::{recompute, rng_state};
use tch::{Device, Kind, Tensor};

static ONE_BY_ONE: Mutex<()> = Mutex::new(());

const WIDTH: i64 = 256;
const ROWS: i64 = 4096;
const LAYERS: usize = 16;

fn block(t: &[Tensor]) -> Vec<Tensor> {
    let inner = t[0].linear(&t[1], None::<&Tensor>).gelu("none").linear(&t[1], None::<&Tensor>).tanh();
    vec![&t[0] + inner]
}

/// MB that the process had at most while `work` ran, over what it had before.
fn peak(work: impl FnOnce()) -> f64 {
    let status = |key: &str| {
        let text = std::fs::read_to_string("/proc/self/status").unwrap();
        let line = text.lines().find_map(|l| l.strip_prefix(key)).unwrap().to_string();
        line.trim().split(' ').next().unwrap().parse::<f64>().unwrap() / 1e3
    };
    // What was freed counts as long as the allocator keeps it.
    // SAFETY: gives memory back that nobody uses.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::malloc_trim(0);
    }
    std::fs::write("/proc/self/clear_refs", "5").unwrap();
    let before = status("VmRSS:");
    work();
    status("VmHWM:") - before
}

#[test]
fn a_deep_stack_needs_a_fraction_of_the_memory() {
    let _alone = ONE_BY_ONE.lock().unwrap_or_else(PoisonError::into_inner);
    // Each tensor a mapping of its own, which ends with it: in the heap, freed ones would count as long as one above lives.
    // SAFETY: a plain number for the allocator.
    #[cfg(target_env = "gnu")]
    unsafe {
        libc::mallopt(libc::M_MMAP_THRESHOLD, 1 << 20);
    }
    let of = |shape: [i64; 2]| (Tensor::randn(shape, (Kind::Float, Device::Cpu)) * 0.05).set_requires_grad(true);
    let (x, weights) = (of([ROWS, WIDTH]), (0..LAYERS).map(|_| of([WIDTH, WIDTH])).collect::<Vec<_>>());
    let leaves: Vec<&Tensor> = std::iter::once(&x).chain(&weights).collect();
    let step = |again: bool| {
        let mut y = x.shallow_clone();
        for w in &weights {
            let read = [y.shallow_clone(), w.shallow_clone()];
            y = if again {
                recompute(&[&read[0]], (), |()| (block(&read), vec![w.shallow_clone()]), |(), t| block(t))
                    .unwrap()
                    .remove(0)
            } else {
                block(&read).remove(0)
            };
        }
        Tensor::run_backward(&[y.square().sum(Kind::Float)], &leaves, false, false)
    };
    // Kernels and threads take memory of their own when they first run.
    let (mut plain, mut again) = (step(false), step(true));
    // What one block makes, and what each reads: 4 MB a layer in place of 16. What lies scattered comes on top, more or
    // less each time: the least of a few tries is what is needed.
    let least = |work: &mut dyn FnMut()| (0..4).map(|_| peak(&mut *work)).fold(f64::INFINITY, f64::min);
    let second = least(&mut || again = step(true));
    let first = least(&mut || plain = step(false));
    assert!(plain.iter().zip(&again).all(|(a, b)| a.equal(b)));
    // Libraries take workspaces besides, as large as the processor has them: what is saved is told by the difference.
    let (made, kept) = (4.0 * (ROWS * WIDTH * 4) as f64 / 1e6, (ROWS * WIDTH * 4) as f64 / 1e6);
    let saved = (made - kept) * LAYERS as f64;
    assert!(first - second > 0.7 * saved, "{second:.0} MB in place of {first:.0} MB");
}

#[test]
fn what_was_drawn_is_drawn_again_and_the_generator_goes_on() {
    let _alone = ONE_BY_ONE.lock().unwrap_or_else(PoisonError::into_inner);
    let x = Tensor::randn([64, 64], (Kind::Float, Device::Cpu)).set_requires_grad(true);
    let dropped = |t: &Tensor| vec![t.dropout(0.5, true)];
    tch::manual_seed(5);
    let out = recompute(&[&x], (), |()| (dropped(&x), vec![]), move |(), t| dropped(&t[0])).unwrap().remove(0);
    let now = rng_state(Device::Cpu).unwrap();
    let grad = Tensor::run_backward(&[out.sum(Kind::Float)], &[&x], false, false).remove(0);
    // The gradient is 2 where it was kept, and 0 where it was dropped.
    assert!(grad.equal(&(out.not_equal(0.0).to_kind(Kind::Float) * 2.0)));
    assert!(rng_state(Device::Cpu).unwrap() == now);
}
