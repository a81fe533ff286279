//! `cargo xtask demo`: the main job at small scale, by the product's own commands.

use std::path::PathBuf;

use anyhow::{Result, bail};

/// What to run the demo on, and where to put it.
pub struct Options {
    input: Option<PathBuf>,
    out: PathBuf,
}

impl Options {
    /// Reads `[--input DIR] [--out DIR]`.
    pub fn parse(args: &[String]) -> Result<Self> {
        let mut options = Self { input: None, out: PathBuf::from("demo") };
        let mut args = args.iter();
        while let Some(arg) = args.next() {
            let mut value = || args.next().map(PathBuf::from);
            match (arg.as_str(), value()) {
                ("--input", Some(dir)) => options.input = Some(dir),
                ("--out", Some(dir)) => options.out = dir,
                _ => bail!("usage: cargo xtask demo [--input DIR] [--out DIR]"),
            }
        }
        Ok(options)
    }
}

/// Runs it.
pub fn run(options: &Options) -> Result<()> {
    let _ = (&options.input, &options.out);
    bail!("the demo is not there yet")
}
