//! `riglab review`

use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode, Stdio};

use anyhow::Result;
use riglab_report::counted;
use riglab_report::shell::command;
use riglab_review::{Review, Server};

use super::file_to_write;

/// Look at the assets of a corpus in a browser: accept, reject, re-categorise, mark faults, comment.
///
/// Prints the address of a page that this machine alone can open, with a secret token in it, and serves it
/// until Ctrl-C. Each decision is written at once to a text file made for version control, which the next
/// `riglab curate --decisions FILE` applies. One server at a time keeps its decisions in a file.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab review corpus.h5 --open
  riglab review corpus.h5 --files models/ --decisions decisions.tsv
  riglab curate models/ -o corpus.h5 --decisions decisions.tsv

What `riglab curate` wrote beside the corpus (corpus.curation/) is shown too: why assets were \
dropped, and, with --files, pictures of them. On another machine, forward the port: \
ssh -L 8000:127.0.0.1:8000 HOST, then riglab review corpus.h5 --port 8000 there.")]
pub struct Args {
    /// The corpus, as `riglab curate` or `riglab dataset import` made it.
    #[arg(value_name = "CORPUS")]
    corpus: PathBuf,
    /// The folder that was curated: shows what is not in the corpus.
    #[arg(long, value_name = "FOLDER")]
    files: Option<PathBuf>,
    /// The file of decisions; it need not be there yet. Without: corpus.decisions.tsv beside corpus.h5.
    #[arg(long, value_name = "FILE", value_parser = file_to_write())]
    decisions: Option<PathBuf>,
    /// The port on 127.0.0.1; 0 takes one that is free.
    #[arg(long, default_value_t = 0, value_name = "N")]
    port: u16,
    /// Open the page in the desktop's browser.
    #[arg(long)]
    open: bool,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let decisions = args.decisions.clone().unwrap_or_else(|| Review::decisions_of(&args.corpus));
    let review = Review::open(&args.corpus, args.files.as_deref(), &decisions)?;
    let (tally, unreadable, told) = (review.tally(), review.unreadable(), review.told());
    for sentence in told {
        tell!("warning: {sentence}");
    }
    if unreadable > 0 {
        tell!("note: {}; the curation's report lists them", without_card(unreadable));
    }
    if let (Some((gone, of)), Some(folder)) = (review.gone(), &args.files) {
        let files = if of == 1 { "file" } else { "files" };
        tell!(
            "warning: {}: {gone} of {of} {files} with assets that are not in the corpus are not there, so these have no \
             pictures; is it the folder that was curated?",
            folder.display()
        );
    }
    let server = Server::bind(review, args.port)?;
    let stop = server.stop();
    // Where signals cannot be listened to, the default ends the process; nothing is lost by that.
    let _ = riglab_files::on_signals(move |_| stop.stop());
    tell!("{} of {} decided; decisions are kept in {}", tally.decided, tally.of, decisions.display());
    let url = server.url();
    say!("{url}");
    tell!("Ctrl-C ends the review; everything is saved as it is decided.");
    if args.open {
        open(&url);
    }
    server.run();
    let tally = server.review().tally();
    tell!("\n{} of {} decided", tally.decided, tally.of);
    if tally.decided > 0 {
        tell!("hint: {}", apply(&args.corpus, args.files.as_deref(), &decisions));
    }
    Ok(ExitCode::SUCCESS)
}

/// What is said of files that have no card.
fn without_card(files: usize) -> String {
    format!("{} could not be read and {} no card", counted(files, "file"), if files == 1 { "has" } else { "have" })
}

/// The command that applies decisions.
fn apply(corpus: &Path, files: Option<&Path>, decisions: &Path) -> String {
    let shown = |path: &Path| path.display().to_string();
    let (folder, corpus, decisions) = (files.map_or("FOLDER".into(), shown), shown(corpus), shown(decisions));
    format!("`{}` applies them", command(["curate", &folder, "-o", &corpus, "--decisions", &decisions]))
}

/// Asks the desktop for its browser. A machine without one has printed the address all the same.
fn open(url: &str) {
    let opener = if cfg!(target_os = "macos") { "open" } else { "xdg-open" };
    let begun = Command::new(opener).arg(url).stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null()).spawn();
    match begun {
        // It ends by itself; nobody waits for it but this thread.
        Ok(mut child) => drop(std::thread::spawn(move || child.wait())),
        Err(e) => tell!("warning: {opener} cannot be started ({e}); open the address yourself"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_without_a_card_are_counted() {
        assert_eq!(without_card(1), "1 file could not be read and has no card");
        assert_eq!(without_card(2), "2 files could not be read and have no card");
    }
}
