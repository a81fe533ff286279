//! Progress over files, of which some hold thousands of assets.

use std::sync::Mutex;

use riglab_train::Progress;

/// A [`Progress`] that a [`riglab_data::Tally`] tells, from any thread.
pub struct OfFiles(Mutex<Progress>);

impl OfFiles {
    /// Of so many files, none of them read.
    pub fn new(name: &str, files: usize) -> Self {
        Self(Mutex::new(Progress::new(name, files as u64, 0)))
    }

    /// So many assets are done, of as many as are known of by now.
    pub fn set(&self, done: usize, of: usize) {
        self.with(|progress| progress.set_of(done as u64, of as u64));
    }

    /// All are done.
    pub fn finish(&self) {
        self.with(Progress::finish);
    }

    fn with(&self, tell: impl FnOnce(&mut Progress)) {
        if let Ok(mut progress) = self.0.lock() {
            tell(&mut progress);
        }
    }
}
