//! Progress on standard error: a bar with the time left on a terminal, plain lines elsewhere.

use std::fmt::Arguments;
use std::io::{IsTerminal, Write};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use indicatif::{HumanDuration, ProgressBar, ProgressStyle};

/// Time between plain lines.
const EVERY: Duration = Duration::from_secs(15);

/// Time between turns of a spinner.
const TICK: Duration = Duration::from_millis(200);

/// Writes a line on standard error. One that takes no more, such as a full disk, ends nothing: `eprintln!` would panic.
pub fn tell(text: Arguments<'_>) {
    let _ = writeln!(std::io::stderr(), "{}", plain(text));
}

/// A text whose letters are all shown: names from files may hold sequences that a terminal would obey. Lines that end as CSV
/// asks for stay.
pub fn plain(text: Arguments<'_>) -> String {
    let text = text.to_string();
    let shown = |(at, c): (usize, char)| match c {
        '\n' | '\t' => c,
        '\r' if text[at + 1..].starts_with('\n') => c,
        c if c.is_control() => '\u{fffd}',
        c => c,
    };
    text.char_indices().map(shown).collect()
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

    /// As [`Self::set`], where it shows on the way how many parts there are.
    pub fn set_of(&mut self, done: u64, total: u64) {
        if self.total != total {
            self.total = total;
            if let Some(bar) = &self.bar {
                bar.set_length(total);
            }
        }
        self.set(done, String::new);
    }

    /// Whether no part was done since it began.
    pub fn is_new(&self) -> bool {
        self.at == self.begun_at
    }

    /// One part takes long and cannot tell how far it is, as long as this lives: what it is, and on a terminal that time
    /// goes on, elsewhere a line now and then.
    pub fn during(&self, what: &str) -> During<'_> {
        During(match &self.bar {
            Some(bar) => {
                bar.set_message(what.to_owned());
                bar.enable_steady_tick(TICK);
                Told::Bar(bar)
            }
            None => Told::Lines((!self.silent).then(|| Lines::new(what))),
        })
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

/// A part of a job that takes long: [`Progress::during`].
pub struct During<'a>(Told<'a>);

enum Told<'a> {
    Bar(&'a ProgressBar),
    Lines(#[expect(dead_code, reason = "it tells until it is dropped")] Option<Lines>),
}

impl Drop for During<'_> {
    fn drop(&mut self) {
        if let Told::Bar(bar) = self.0 {
            bar.disable_steady_tick();
        }
    }
}

/// Something that is worked on and whose end cannot be told, as long as this lives: what it is and the time so far. On a
/// terminal nothing is to be printed meanwhile.
pub struct Spinner(Shown);

enum Shown {
    Bar(ProgressBar),
    Lines(#[expect(dead_code, reason = "it tells until it is dropped")] Lines),
}

impl Spinner {
    /// Of what is done, such as "reading fox.obj".
    pub fn new(what: &str) -> Self {
        Self(if std::io::stderr().is_terminal() {
            let style = ProgressStyle::with_template("{spinner} {msg}, {elapsed}");
            let bar = ProgressBar::new_spinner().with_message(what.to_string());
            bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
            bar.enable_steady_tick(TICK);
            Shown::Bar(bar)
        } else {
            Shown::Lines(Lines::new(what))
        })
    }
}

impl Drop for Spinner {
    fn drop(&mut self) {
        if let Shown::Bar(bar) = &self.0 {
            bar.finish_and_clear();
        }
    }
}

/// Lines of a thread that say what is worked on and the time so far, as long as this lives. The thread ends with the
/// sender.
struct Lines(Option<(Sender<()>, JoinHandle<()>)>);

impl Lines {
    fn new(what: &str) -> Self {
        let (ends, ended) = channel();
        let what = what.to_owned();
        let lines = move || so_far(&ended, EVERY, |time| tell(format_args!("{what}: {time} so far")));
        let thread = std::thread::Builder::new().name("progress".into()).spawn(lines);
        // Without one more thread it goes on in silence.
        Self(thread.ok().map(|thread| (ends, thread)))
    }
}

impl Drop for Lines {
    fn drop(&mut self) {
        if let Some((ends, thread)) = self.0.take() {
            drop(ends);
            let _ = thread.join();
        }
    }
}

/// Says how long it has taken: after `every` for the first time, then after twice as long each time, until it has `ended`.
fn so_far(ended: &Receiver<()>, every: Duration, mut say: impl FnMut(HumanDuration)) {
    let (start, mut wait) = (Instant::now(), every);
    while ended.recv_timeout(wait) == Err(RecvTimeoutError::Timeout) {
        say(HumanDuration(start.elapsed()));
        wait *= 2;
    }
}

impl Drop for Progress {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_name_in_a_line_moves_the_cursor() {
        assert_eq!(plain(format_args!("a\x1b[2Jb\r\tc\nd\r")), "a\u{fffd}[2Jb\u{fffd}\tc\nd\u{fffd}");
        assert_eq!(plain(format_args!("a,b\r\n1,2\r\n")), "a,b\r\n1,2\r\n", "lines of CSV");
    }

    #[test]
    fn what_takes_long_is_told_now_and_then_and_ends_at_once() {
        let (ends, ended) = channel();
        let (said, hears) = channel();
        let thread = std::thread::spawn(move || so_far(&ended, Duration::from_millis(1), |_| _ = said.send(())));
        assert!((0..3).all(|_| hears.recv_timeout(Duration::from_secs(60)).is_ok()));
        drop(ends);
        thread.join().unwrap();
        // What is short says nothing and is not waited for.
        let start = Instant::now();
        drop(Spinner::new("x"));
        drop(Progress::new("x", 1, 0).during("y"));
        drop(Progress::silent().during("y"));
        assert!(start.elapsed() < EVERY);
    }
}
