//! riglab against what a user would use instead.
//!
//! The one idea: **both sides in one run.** Each side of a case is a process of its own that answers
//! requests; the two are asked in turn, over several rounds, and medians are compared. So what else
//! the machine does meets both, and peak memory is each side's own.
//!
//! Holds: both sides get the same files, batches, weights and threads; where both compute the same,
//! the results are compared before times are. What the other side needs is installed once into the
//! user's cache.
//!
//! Leaves out: single operations; benchmarks of those stand beside their code.

mod cases;
mod json;
mod node;
mod python;
mod recipe;
mod rounds;
mod row;
mod side;

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, bail};
use clap::Parser;

use cases::{CASES, Context, wanted};
use row::Row;

/// riglab against what it replaces, both sides in turn.
///
/// A ratio above 1 means that riglab is better. Exit code 0 when everything was measured (the table
/// says which bars were missed), 1 when a case failed, 2 for wrong use. A case without its data, or
/// that of MPI without MPI, is skipped with a message.
#[derive(Parser)]
#[command(
    name = "cargo xtask bench",
    bin_name = "cargo xtask bench",
    max_term_width = 100,
    after_help = "\
Examples:
  cargo xtask bench --list
  cargo xtask bench step --json step.json

Environment: RIGLAB_RIGS           folder of rigged files (default: ../shared/rigs)
             RIGLAB_BENCH_PYTHON   a Python that has what the other side needs, instead of an
                                   environment of our own in ~/.cache/riglab"
)]
struct Cli {
    /// Cases, beginnings of their names, or rows of theirs; all without.
    names: Vec<String>,
    /// List the cases.
    #[arg(long)]
    list: bool,
    /// Write the rows to a file.
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Draw what a case has a picture of (`corpus`) into a folder that is there.
    #[arg(long, value_name = "FOLDER")]
    pictures: Option<PathBuf>,
    /// Threads of both sides; 0 takes all processors.
    #[arg(long, default_value_t = 0, value_name = "N")]
    threads: usize,
    /// How often each side is asked; 0 takes the case's own number.
    #[arg(long, default_value_t = 0, value_name = "N")]
    rounds: usize,
    /// `import`: every file, not a sample of 60.
    #[arg(long)]
    all: bool,
    /// `step`: leave out `torch.compile`, which takes minutes.
    #[arg(long)]
    no_compile: bool,
    /// Answer requests as riglab's side of a case.
    #[arg(long, hide = true, value_name = "CASE")]
    side: Option<String>,
}

fn main() -> ExitCode {
    match run(&Cli::parse()) {
        Ok(code) => code,
        Err(e) => {
            eprintln!("error: {e:#}");
            ExitCode::FAILURE
        }
    }
}

fn run(cli: &Cli) -> Result<ExitCode> {
    if let Some(case) = &cli.side {
        // Of all cases: decoders, preparation and geometry share out their work by this pool.
        rayon::ThreadPoolBuilder::new().num_threads(cli.threads).build_global()?;
        cases::serve(case)?;
        return Ok(ExitCode::SUCCESS);
    }
    if cli.list {
        let width = CASES.iter().map(|c| c.name.len()).max().unwrap_or(0) + 2;
        CASES.iter().for_each(|c| println!("{:<width$}{}", c.name, c.about));
        return Ok(ExitCode::SUCCESS);
    }
    if let Some(unknown) = cli.names.iter().find(|name| wanted(name).is_empty()) {
        let names: Vec<_> = CASES.iter().map(|c| c.name).collect();
        eprintln!("error: no case `{unknown}`; there is: {}", names.join(", "));
        return Ok(ExitCode::from(2));
    }
    let asked: Vec<&str> = cli.names.iter().flat_map(|name| wanted(name)).map(|case| case.name).collect();
    let mut context = Context::new(cli.threads, cli.rounds, cli.all, !cli.no_compile)?;
    context.pictures.clone_from(&cli.pictures);
    let (mut rows, mut failed): (Vec<Row>, Vec<&str>) = Default::default();
    for case in CASES.iter().filter(|case| cli.names.is_empty() || asked.contains(&case.name)) {
        eprintln!("{}: {}", case.name, case.about);
        let found = found(case.name, (case.run)(&mut context));
        if found.iter().any(|row| row.failed) {
            failed.push(case.name);
        }
        rows.extend(found);
        // After every case: what was measured stays, whatever comes next.
        if let Some(path) = &cli.json {
            json::write(path, &rows)?;
        }
    }
    print!("{}", row::table(&rows));
    if !failed.is_empty() {
        bail!("{} of the cases failed: {}", failed.len(), failed.join(", "));
    }
    Ok(ExitCode::SUCCESS)
}

/// The rows of a case, each fault told in full and kept in its first line, which is the sentence: what a side printed
/// follows.
fn found(case: &str, ran: Result<Vec<Row>>) -> Vec<Row> {
    let mut rows = ran.unwrap_or_else(|e| vec![Row::failed(case, format!("{e:#}"))]);
    for row in rows.iter_mut().filter(|row| row.failed) {
        eprintln!("error: {}: {}", row.name, row.note);
        row.note = row.note.lines().next().unwrap_or_default().into();
    }
    rows
}

#[cfg(test)]
mod tests {
    use anyhow::anyhow;

    use super::*;

    #[test]
    fn what_failed_is_told_from_what_was_skipped() {
        let of = |ran| found("case", ran).iter().map(|row| (row.failed, row.note.clone())).collect::<Vec<_>>();
        assert_eq!(of(Err(anyhow!("it died\n    why"))), [(true, "it died".to_owned())]);
        let part =
            vec![Row::alone("a", 1.0, "s"), Row::failed("b", "error: no mesh\nhint"), Row::skipped("c", "no rigs")];
        assert_eq!(of(Ok(part)), [(false, String::new()), (true, "error: no mesh".into()), (false, "no rigs".into())]);
    }
}
