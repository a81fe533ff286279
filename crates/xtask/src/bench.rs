//! `cargo xtask bench`: hands over to the benchmarks' own binary.

use anyhow::Result;

use crate::shell;

/// Runs the benchmarks named in `args`.
pub fn run(args: &[String]) -> Result<()> {
    let mut all = vec!["run", "--release", "--package", "riglab-bench", "--"];
    all.extend(args.iter().map(String::as_str));
    shell::cargo(&all)
}
