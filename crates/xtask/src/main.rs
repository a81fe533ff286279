//! Chores of the workspace: `cargo xtask demo`, `cargo xtask test` and what they need.
//!
//! Every command does the set-up it needs first. Set-up is idempotent and atomic: whatever is
//! fetched is checked against a checksum, unpacked under a temporary name and renamed into place,
//! so that a break at any moment leaves nothing half-installed.
//!
//! Holds: no shell scripts, no root, nothing outside the workspace and the user's cache folder.
//! Leaves out: everything about rigging. The product's own commands are called as a user would
//! call them, and printed, so that the demo can be repeated by hand.

mod bench;
mod demo;
mod fetch;
mod libtorch;
mod mpi;
mod notebooks;
mod preflight;
mod shell;
mod skipped;
mod tools;
mod venv;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};

const HELP: &str = "\
Chores of riglab. Each command does the set-up it needs.

Usage: cargo xtask <COMMAND>

  demo [--input DIR] [--out DIR]   train a small model and write its report; on generated
                                   creatures, or on the GLB, glTF, VRM and FBX files of DIR
  test [-- ARGS]                   all tests (ARGS go to cargo test)
  bench [NAME...] [--list] [--json FILE]
                                   riglab against what it replaces, both sides in turn
  notebooks                        install what the notebooks need, and run them all
  mpi                              riglab that trains as several processes: build and test it;
                                   MPICH and libclang are installed where there are none
  ci                               formatting, lints, tests
  setup [--wheels DIR]             only the set-up: libtorch, cmake, release build;
                                   DIR holds wheels fetched elsewhere (no network needed)

Environment: XDG_CACHE_HOME   where libtorch is kept (default ~/.cache), shared by all clones
             LIBTORCH, CMAKE  use these instead of fetching
";

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    match run(&args) {
        Ok(code) => code,
        Err(e) => {
            eprintln!("error: {e:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(args: &[String]) -> Result<ExitCode> {
    let Some((command, rest)) = args.split_first() else {
        print!("{HELP}");
        return Ok(ExitCode::from(2));
    };
    match command.as_str() {
        "help" | "--help" | "-h" => print!("{HELP}"),
        "setup" => {
            let wheels = match rest {
                [] => None,
                [flag, dir] if flag == "--wheels" => Some(PathBuf::from(dir)),
                _ => bail!("usage: cargo xtask setup [--wheels DIR]"),
            };
            setup(wheels)?;
            shell::cargo(&["build", "--release", "--workspace"])?;
        }
        "demo" => {
            let options = demo::Options::parse(rest)?;
            setup(None)?;
            demo::run(&options)?;
        }
        "test" => {
            setup(None)?;
            test(rest)?;
        }
        "bench" => {
            setup(None)?;
            bench::run(rest)?;
        }
        "notebooks" => {
            setup(None)?;
            notebooks::run()?;
        }
        "mpi" => {
            setup(None)?;
            mpi::run()?;
        }
        "ci" => {
            setup(None)?;
            shell::cargo(&["fmt", "--all", "--check"])?;
            shell::cargo(&["clippy", "--workspace", "--all-targets", "--release", "--", "-D", "warnings"])?;
            test(&[])?;
        }
        other => bail!("no command `{other}`; `cargo xtask help` lists them"),
    }
    Ok(ExitCode::SUCCESS)
}

/// Everything a plain `cargo build` needs afterwards.
fn setup(wheels: Option<PathBuf>) -> Result<()> {
    let found = preflight::check()?;
    let source = match wheels {
        Some(dir) => fetch::Source::Folder(dir),
        None => fetch::Source::Pip,
    };
    tools::ensure(&found, &source)?;
    libtorch::ensure(&source)
}

/// All tests, in the release profile: one build serves the demo and the tests, and the learning
/// tests run at the speed users get.
fn test(extra: &[String]) -> Result<()> {
    let extra = match extra {
        [dashes, rest @ ..] if dashes == "--" => rest,
        all => all,
    };
    let mut args = vec!["test", "--release", "--workspace"];
    if !extra.is_empty() {
        args.extend(extra.iter().map(String::as_str));
        return shell::cargo(&args);
    }
    // Passing tests say nothing then, those that were skipped neither.
    skipped::tests(&[&args[..], &["--", "--show-output"]].concat())
}
