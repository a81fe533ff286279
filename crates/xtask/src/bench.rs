//! `cargo xtask bench`: hands over to the benchmarks' own binary.

use std::process::Command;

use anyhow::Result;

use crate::{mpi, shell};

/// Runs the benchmarks named in `args`.
pub fn run(args: &[String]) -> Result<()> {
    if args.iter().any(|name| name.starts_with("mpi")) {
        // It starts the program itself as several processes.
        mpi::prepare()?;
        shell::cargo(&["build", "--release", "--workspace", "--features", "riglab/mpi"])?;
        // Not by cargo: it would build the program again, without MPI.
        return shell::run(Command::new(shell::built("riglab-bench")).args(args).env_remove("CARGO"));
    }
    let mut all = vec!["run", "--release", "--package", "riglab-bench", "--"];
    all.extend(args.iter().map(String::as_str));
    shell::cargo(&all)
}
