//! A process that is asked to leave while it computes goes on computing.
//!
//! A process of its own: what goes wrong here is its death.

#![cfg(unix)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::time::{Duration, Instant};

use riglab_files::on_signals;
use tch::{Device, Kind, Tensor};

#[test]
fn signals_leave_products_alone() {
    let heard = Arc::new(AtomicUsize::new(0));
    let counted = heard.clone();
    assert!(on_signals(move |_| {
        counted.fetch_add(1, Ordering::SeqCst);
    }));
    assert!(!on_signals(|_| ()), "one a process");
    let options = (Kind::Float, Device::Cpu);
    // As in a training in f32: sums of so few terms over so many rows are oneDNN's on some processors.
    let (x, w) = (Tensor::randn([3840, 128], options), Tensor::randn([512, 128], options));
    let product = || riglab_torch::linear(&x, &w, None).unwrap();
    let exact = product();
    let done = Arc::new(AtomicBool::new(false));
    // SAFETY: of the calling thread, always.
    let (ended, target) = (done.clone(), unsafe { libc::pthread_self() });
    let sender = std::thread::spawn(move || {
        let mut sent = 0;
        while !ended.load(Ordering::SeqCst) {
            // SAFETY: the thread is there until it has heard that this one ended. (SIGHUP is passed over below `nohup`.)
            assert_eq!(unsafe { libc::pthread_kill(target, libc::SIGTERM) }, 0);
            sent += 1;
            std::thread::sleep(Duration::from_micros(300));
        }
        sent
    });
    let (start, mut same) = (Instant::now(), true);
    while start.elapsed() < Duration::from_secs(2) {
        same &= product().equal(&exact);
    }
    done.store(true, Ordering::SeqCst);
    let sent: usize = sender.join().unwrap();
    assert!(same && sent > 100, "{sent} signals");
    let start = Instant::now();
    while heard.load(Ordering::SeqCst) == 0 {
        assert!(start.elapsed() < Duration::from_secs(20), "nothing was heard");
        std::thread::yield_now();
    }
}
