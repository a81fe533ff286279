//! `riglab report`

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_report::{Block, Page, RunView};

use crate::registry;

/// Write a run's report: curves, tables and pictures in one HTML file.
///
/// A view of the run's folder; what is not there yet (an evaluation) is left out.
#[derive(clap::Args)]
#[command(after_help = "Example: riglab report runs/fsq_cvae/001 -o report.html")]
pub struct Args {
    /// The run's folder.
    run: PathBuf,
    /// Where to write it [default: RUN/report.html].
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Title of the page [default: the run's folder].
    #[arg(long)]
    title: Option<String>,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    if !args.run.join("config.toml").is_file() {
        bail!("{}: no run here (there is no config.toml); `riglab train` makes one", args.run.display());
    }
    let view = RunView::read(&args.run);
    let mut blocks = vec![view.facts()];
    let evaluation = registry::evaluation_blocks(&view.task(), &args.run)?;
    if evaluation.is_empty() {
        let text = format!("Not evaluated yet: riglab eval {}", args.run.display());
        blocks.push(Block::Text(text.clone()));
        eprintln!("note: {text}");
    }
    blocks.extend(evaluation);
    blocks.push(Block::Heading("Training".into()));
    blocks.push(view.curves());
    blocks.extend(view.repeat());
    let title = args.title.clone().unwrap_or_else(|| args.run.display().to_string());
    let html = Page { title, subtitle: view.subtitle(), blocks }.to_html()?;
    let path = args.out.clone().unwrap_or_else(|| args.run.join("report.html"));
    riglab_files::write(&path, html.as_bytes()).with_context(|| format!("{} cannot be written", path.display()))?;
    say!("{}", path.display());
    Ok(ExitCode::SUCCESS)
}
