//! All tests, and which of them were skipped: what these say is lost among what passing tests say, which nobody reads.

use std::collections::BTreeMap;
use std::io::{BufRead, BufReader};
use std::process::Stdio;

use anyhow::{Context, Result, bail};

use crate::shell;

/// Runs tests with `--show-output`, shows what a run without it shows, and at the end what was skipped.
pub fn tests(args: &[&str]) -> Result<()> {
    let mut command = shell::cargo_command(args);
    let mut child = command.stdout(Stdio::piped()).spawn().context("cannot start cargo")?;
    let mut shown = Shown::default();
    for line in BufReader::new(child.stdout.take().context("cargo has no output")?).split(b'\n') {
        let line = line.context("cargo's output cannot be read")?;
        let line = String::from_utf8_lossy(&line);
        if shown.takes(line.trim_end_matches('\r')) {
            println!("{line}");
        }
    }
    let status = child.wait().context("cargo was lost")?;
    shown.skipped.iter().for_each(|(why, count)| println!("{count} × {why}"));
    if !status.success() {
        bail!("`cargo` ended with {status}");
    }
    Ok(())
}

/// What is shown of a test program's output.
#[derive(Default)]
struct Shown {
    /// Within what passing tests said.
    of_passing: bool,
    /// Why tests were skipped, and how many lines say so.
    skipped: BTreeMap<String, usize>,
}

impl Shown {
    /// Whether the next line is shown.
    fn takes(&mut self, line: &str) -> bool {
        match line {
            "successes:" => self.of_passing = true,
            "failures:" => self.of_passing = false,
            _ if line.starts_with("test result: ") => self.of_passing = false,
            _ => {}
        }
        if self.of_passing && line.starts_with("skipped: ") {
            *self.skipped.entry(line.to_owned()).or_default() += 1;
        }
        !self.of_passing
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_passing_tests_say_is_passed_over_but_for_what_was_skipped() {
        let output = "running 3 tests\ntest a ... ok\ntest b ... FAILED\n\nsuccesses:\n\n---- a stdout ----\nskipped: no folder\n\
                      step 1\n\n\nsuccesses:\n    a\n\nfailures:\n\n---- b stdout ----\nskipped: no folder\nwrong\n\nfailures:\n    \
                      b\n\ntest result: FAILED. 1 passed\n\nrunning 1 test\ntest c ... ok\n\nsuccesses:\nskipped: no folder\n\
                      test result: ok. 1 passed";
        let mut shown = Shown::default();
        let lines: Vec<&str> = output.lines().filter(|line| shown.takes(line)).collect();
        assert!(!lines.contains(&"step 1") && !lines.contains(&"    a") && lines.contains(&"wrong"), "{lines:?}");
        assert_eq!(lines.last(), Some(&"test result: ok. 1 passed"));
        assert_eq!(shown.skipped, BTreeMap::from([("skipped: no folder".to_owned(), 2)]));
    }
}
