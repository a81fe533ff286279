//! How far the reading of files is, of which some hold thousands of assets.

use std::sync::atomic::{AtomicUsize, Ordering};

/// Counts assets as they are read. A file counts as one until it is opened and says how many it holds.
pub struct Tally<'a> {
    done: AtomicUsize,
    total: AtomicUsize,
    tell: &'a (dyn Fn(usize, usize) + Sync),
}

impl<'a> Tally<'a> {
    /// Of `files` files, of which `done` are done. `tell` is given how many assets are done, and of how many.
    pub fn new(files: usize, done: usize, tell: &'a (dyn Fn(usize, usize) + Sync)) -> Self {
        Self { done: done.into(), total: files.max(done).into(), tell }
    }

    /// A file is opened, which holds so many assets by its own word.
    pub fn open(&self, assets: usize) -> OpenFile<'_> {
        let left = assets.max(1);
        self.total.fetch_add(left - 1, Ordering::Relaxed);
        OpenFile { tally: self, left }
    }

    fn add(&self, assets: usize) {
        let done = self.done.fetch_add(assets, Ordering::Relaxed) + assets;
        (self.tell)(done, self.total.load(Ordering::Relaxed));
    }
}

/// A file of a [`Tally`]: whatever of it was not read counts as done when this is dropped.
pub struct OpenFile<'a> {
    tally: &'a Tally<'a>,
    left: usize,
}

impl OpenFile<'_> {
    /// One more asset is read. Beyond what the file said, none counts.
    pub fn one(&mut self) {
        if self.left > 0 {
            self.left -= 1;
            self.tally.add(1);
        }
    }
}

impl Drop for OpenFile<'_> {
    fn drop(&mut self) {
        if self.left > 0 {
            self.tally.add(self.left);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;

    use super::*;

    #[test]
    fn a_file_of_several_counts_as_many() {
        let told = Mutex::new(Vec::new());
        let tell = |done, total| told.lock().unwrap().push((done, total));
        let tally = Tally::new(4, 1, &tell);
        // One asset; three, of which the last cannot be read; and none.
        tally.open(1).one();
        let mut file = tally.open(3);
        file.one();
        file.one();
        drop(file);
        drop(tally.open(0));
        assert_eq!(*told.lock().unwrap(), [(2, 4), (3, 6), (4, 6), (5, 6), (6, 6)]);
    }

    #[test]
    fn no_more_count_than_a_file_said() {
        let told = Mutex::new(Vec::new());
        let tell = |done, total| told.lock().unwrap().push((done, total));
        let tally = Tally::new(1, 0, &tell);
        let mut file = tally.open(2);
        (0..4).for_each(|_| file.one());
        drop(file);
        assert_eq!(*told.lock().unwrap(), [(1, 2), (2, 2)]);
    }
}
