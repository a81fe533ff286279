//! The time of writing a run's report: HTML with pictures and rigs to be turned, Markdown, LaTeX and CSV.
//!
//! What is measured is the program as a user starts it. The run is made by it too: creatures, a few steps of training,
//! an evaluation with pictures of eleven assets a split. Nothing usual writes such a page, so there is no other side.

use std::path::Path;
use std::process::Command;
use std::time::Instant;

use anyhow::{Context as _, Result, ensure};

use super::Context;
use super::rig::program;
use crate::rounds::median;
use crate::row::Row;

const NAME: &str = "report";
const CREATURES: &str = "160";

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let program = program()?;
    let folder = context.path("report");
    std::fs::create_dir_all(&folder)?;
    let call = |args: &[&str]| -> Result<()> {
        let mut command = Command::new(&program);
        let out = command.current_dir(&folder).arg("--threads").arg(context.threads.to_string()).args(args).output()?;
        ensure!(out.status.success(), "riglab {}: {}", args.join(" "), String::from_utf8_lossy(&out.stderr));
        Ok(())
    };
    call(&["synth", "-o", "files", "--count", CREATURES])?;
    call(&["dataset", "import", "files", "-o", "corpus.h5"])?;
    let corpora = "data.corpora=['corpus.h5']";
    call(&["train", "quickstart/demo.toml", "--run", "run", "--set", corpora, "--set", "train.steps=20"])?;
    call(&["eval", "run", "--pictures", "5"])?;
    let mut seconds = Vec::new();
    for _ in 0..context.rounds(5) {
        let start = Instant::now();
        call(&["report", "run"])?;
        seconds.push(start.elapsed().as_secs_f64());
    }
    let size = |file: &str| -> Result<u64> { Ok(std::fs::metadata(folder.join("run").join(file))?.len()) };
    let bytes = size("report.html")?;
    let views = count(&folder.join("run/report.html"))?;
    ensure!(bytes <= 15 << 20, "the page has {bytes} bytes, more than 15 MB");
    ensure!(views > 0, "the page has no rigs to be turned");
    let note = format!(
        "{} rounds; report.html has {:.1} MB with {views} rigs to be turned, beside it .md, .tex and .csv",
        seconds.len(),
        bytes as f64 / 1e6
    );
    Ok(vec![Row::alone(NAME, median(&seconds), "s").note(note)])
}

/// Rigs to be turned in a page.
fn count(page: &Path) -> Result<usize> {
    let text = std::fs::read_to_string(page).with_context(|| format!("{} cannot be read", page.display()))?;
    Ok(text.matches("<figure class=\"view\">").count())
}
