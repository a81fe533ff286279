//! `cargo xtask bench`: hands over to the benchmarks' own binary.

use std::path::Path;
use std::process::Command;

use anyhow::Result;

use crate::{mpi, shell};

/// Runs the benchmarks named in `args`.
pub fn run(args: &[String]) -> Result<()> {
    let args = &placed(args, &std::env::current_dir()?);
    if names(args).any(|name| name.starts_with("mpi")) {
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

/// The benchmarks' options that name a file or a folder.
const PLACES: [&str; 2] = ["--json", "--pictures"];

/// The benchmarks' options whose next word is a value.
const VALUED: [&str; 4] = ["--json", "--pictures", "--threads", "--rounds"];

/// The same arguments with files and folders as they are meant from `here`: cargo starts the program elsewhere.
fn placed(args: &[String], here: &Path) -> Vec<String> {
    let whole = |path: &str| here.join(path).display().to_string();
    let mut before = "";
    let mut out = Vec::with_capacity(args.len());
    for arg in args {
        out.push(match arg.split_once('=') {
            _ if PLACES.contains(&before) => whole(arg),
            Some((option, path)) if PLACES.contains(&option) => format!("{option}={}", whole(path)),
            _ => arg.clone(),
        });
        before = arg;
    }
    out
}

/// The words that name cases.
fn names(args: &[String]) -> impl Iterator<Item = &str> {
    let before = std::iter::once("").chain(args.iter().map(String::as_str));
    let words = args.iter().map(String::as_str).zip(before);
    words.filter(|(word, before)| !word.starts_with('-') && !VALUED.contains(before)).map(|(word, _)| word)
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::{names, placed};

    #[test]
    fn values_of_options_name_no_case() {
        let of = |line: &str| {
            let args: Vec<String> = line.split(' ').map(String::from).collect();
            names(&args).map(String::from).collect::<Vec<_>>()
        };
        assert_eq!(of("step --json mpi.json --no-compile mpi/2ranks"), ["step", "mpi/2ranks"]);
        assert_eq!(of("--json=mpi.json --threads 2 m"), ["m"]);
        let line = |args: Vec<String>| args.join(" ");
        let here = |of: &str| line(placed(&of.split(' ').map(String::from).collect::<Vec<_>>(), Path::new("/here")));
        assert_eq!(
            here("step --json a.json --pictures=p --threads 2 m=x"),
            "step --json /here/a.json --pictures=/here/p --threads 2 m=x"
        );
        assert_eq!(here("--json /b/a.json"), "--json /b/a.json");
        // Each option of the benchmarks that takes a value is known here.
        let cli = include_str!("../../riglab-bench/src/main.rs");
        let fields = cli.split("struct Cli {").nth(1).and_then(|rest| rest.split("\n}").next()).unwrap_or_default();
        let options = fields.split("#[arg(long").skip(1).filter(|field| !field.contains(": bool"));
        let field = |text: &str| Some(text.split(")]").nth(1)?.trim().split(':').next()?.to_owned());
        let told: Vec<String> = options.filter(|f| !f.contains("hide")).filter_map(field).collect();
        assert_eq!(told.len(), super::VALUED.len(), "{told:?}");
        assert!(told.iter().all(|name| super::VALUED.contains(&&*format!("--{name}"))), "{told:?}");
    }
}
