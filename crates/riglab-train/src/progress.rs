//! Progress on standard error: a bar with the time left on a terminal, plain lines elsewhere.

use std::fmt::Arguments;
use std::io::{IsTerminal, Write};
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

/// Time between plain lines.
const EVERY: Duration = Duration::from_secs(15);

/// Time between turns of a spinner.
const TICK: Duration = Duration::from_millis(200);

/// Writes a line on standard error. One that takes no more, such as a full disk, ends nothing: `eprintln!` would panic.
pub fn tell(text: Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "{text}");
}

/// Progress of one job.
pub struct Progress {
    name: String,
    total: u64,
    begun_at: u64,
    at: u64,
    start: Instant,
    last: Instant,
    bar: Option<ProgressBar>,
    silent: bool,
}

impl Progress {
    /// A job of `total` parts, of which `done` are done already.
    pub fn new(name: &str, total: u64, done: u64) -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let bar = ProgressBar::new(total).with_position(done);
            let style = "{prefix:10} {wide_bar} {pos}/{len}  {elapsed} elapsed, {eta} left  {msg}";
            bar.set_style(ProgressStyle::with_template(style).unwrap_or_else(|_| ProgressStyle::default_bar()));
            bar.set_prefix(name.to_string());
            bar.reset_eta();
            bar
        });
        let now = Instant::now();
        Self { name: name.into(), total, begun_at: done, at: done, start: now, last: now, bar, silent: false }
    }

    /// A job of which another process tells.
    pub fn silent() -> Self {
        let now = Instant::now();
        Self { name: String::new(), total: 0, begun_at: 0, at: 0, start: now, last: now, bar: None, silent: true }
    }

    /// `done` parts are done; `message` says how it goes.
    pub fn set(&mut self, done: u64, message: impl FnOnce() -> String) {
        self.at = done;
        match &self.bar {
            Some(bar) => {
                bar.set_position(done);
                bar.set_message(message());
            }
            None if !self.silent && self.last.elapsed() >= EVERY => {
                self.last = Instant::now();
                let (message, left) = (message(), self.left());
                tell(format_args!("{}: {done}/{} ({left} left) {message}", self.name, self.total));
            }
            None => {}
        }
    }

    /// Prints a line above the bar.
    pub fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.suspend(|| tell(format_args!("{text}"))),
            None if !self.silent => tell(format_args!("{text}")),
            None => {}
        }
    }

    /// The job is done: the bar goes, a line with the time stays.
    pub fn finish(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
        if self.silent {
            return;
        }
        tell(format_args!("{}: {}/{} in {}", self.name, self.at, self.total, HumanDuration(self.start.elapsed())));
    }

    fn left(&self) -> String {
        let done = self.at.saturating_sub(self.begun_at);
        if done == 0 {
            return "?".into();
        }
        let per = self.start.elapsed().as_secs_f64() / done as f64;
        let left = per * self.total.saturating_sub(self.at) as f64;
        HumanDuration(Duration::from_secs_f64(left.min(1e9))).to_string()
    }
}

/// Something that is worked on and whose end cannot be told: what it is and the time so far, on a terminal alone, as long
/// as this lives. Nothing is to be printed meanwhile.
pub struct Spinner(Option<ProgressBar>);

impl Spinner {
    /// Of what is done, such as "reading fox.obj".
    pub fn new(what: &str) -> Self {
        Self(std::io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
            let bar = ProgressBar::new_spinner().with_message(what.to_string());
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            bar.enable_steady_tick(TICK);
            bar
        }))
    }
}

impl Drop for Spinner {
    fn drop(&mut self) {
        if let Some(bar) = self.0.take() {
            bar.finish_and_clear();
        }
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}
