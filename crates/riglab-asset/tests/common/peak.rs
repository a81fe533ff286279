//! How much memory a piece of work takes at most.
#![allow(dead_code)] // each test uses a part

use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    /// Bytes this thread holds; those it frees for others count as less than none.
    static HELD: Cell<isize> = const { Cell::new(0) };
    static PEAK: Cell<isize> = const { Cell::new(0) };
    /// The largest piece asked for.
    static LARGEST: Cell<usize> = const { Cell::new(0) };
}

/// The system's allocator, counting by thread. Memory that C code takes for itself is not seen.
struct Counting;

#[global_allocator]
static COUNTING: Counting = Counting;

/// `size` bytes are asked for where `before` were held.
fn count(size: usize, before: usize) {
    let held = HELD.get() + size as isize - before as isize;
    LARGEST.set(LARGEST.get().max(size));
    HELD.set(held);
    PEAK.set(PEAK.get().max(held));
}

// SAFETY: all is done by the system's allocator; the counters have no destructor and allocate nothing.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        count(layout.size(), 0);
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        count(layout.size(), 0);
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        count(0, layout.size());
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        count(size, layout.size());
        unsafe { System.realloc(pointer, layout, size) }
    }
}

/// Bytes that work took.
#[derive(Clone, Copy, Debug)]
pub struct Peak {
    /// The most it held at once.
    pub total: usize,
    /// The most it asked for in one piece.
    pub largest: usize,
}

impl Peak {
    /// Whether a file of so many bytes may take this: in one piece 20 times its bytes, in all 64 times (a compressed
    /// file comes to 58), and 64 MiB if it is small.
    pub fn is_fair(&self, file: usize) -> bool {
        let small = 64 << 20;
        self.largest <= small.max(20 * file) && self.total <= small.max(64 * file)
    }

    /// The same for formats of plain arrays: in one piece 20 times its bytes, in all 40 times. If it is
    /// small, half a MiB for the tables of what unpacks it, and 8 MiB for an h5, whose chunks of up to 2 MiB
    /// are unpacked whole.
    pub fn is_lean(&self, name: &str, file: usize) -> bool {
        let small = if name.ends_with(".h5") { 8 << 20 } else { 512 << 10 };
        self.largest <= small.max(20 * file) && self.total <= small.max(40 * file)
    }
}

/// What `work` gives, and the memory it took.
pub fn of<T>(work: impl FnOnce() -> T) -> (T, Peak) {
    let before = HELD.get();
    PEAK.set(before);
    LARGEST.set(0);
    let result = work();
    (result, Peak { total: (PEAK.get() - before) as usize, largest: LARGEST.get() })
}
