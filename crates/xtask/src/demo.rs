//! `cargo xtask demo`: the main job at small scale, by the product's own commands.
//!
//! Each step leaves a file, and a step whose file is there is not done again: a demo that was
//! stopped goes on where it was.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};

use crate::shell;

/// What to run the demo on, and where to put it.
pub struct Options {
    input: Option<PathBuf>,
    out: PathBuf,
}

/// Creatures of the default demo.
const CREATURES: &str = "120";

impl Options {
    /// Reads `[--input DIR] [--out DIR]`.
    pub fn parse(args: &[String]) -> Result<Self> {
        let (mut input, mut out) = (None, None);
        let mut args = args.iter();
        while let Some(arg) = args.next() {
            let mut value = || args.next().map(PathBuf::from);
            match (arg.as_str(), value()) {
                ("--input", Some(dir)) => input = Some(dir),
                ("--out", Some(dir)) => out = Some(dir),
                _ => bail!("usage: cargo xtask demo [--input DIR] [--out DIR]"),
            }
        }
        let input = match input {
            Some(dir) => {
                Some(dir.canonicalize().with_context(|| format!("--input {}: no such folder", dir.display()))?)
            }
            None => None,
        };
        let name = input.as_deref().and_then(Path::file_name).map_or("creatures".into(), |n| n.to_os_string());
        let out = out.unwrap_or_else(|| PathBuf::from("demo").join(name));
        Ok(Self { input, out: std::path::absolute(out)? })
    }
}

/// Runs it, with the binary that it builds first.
pub fn run(options: &Options) -> Result<()> {
    let Options { input, out } = options;
    let report = out.join("report.html");
    if report.exists() {
        println!("{} is there already. Remove {} to run the demo again.", shown(&report), shown(out));
        return Ok(());
    }
    shell::cargo(&["build", "--release", "--bin", "riglab"])?;
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", shown(out)))?;
    // Ctrl-C goes to the running command, which saves its work and ends.
    ctrlc::set_handler(|| ()).context("cannot listen to Ctrl-C")?;
    let start = Instant::now();

    let folder = match input {
        Some(folder) => folder.clone(),
        None => {
            let folder = out.join("files");
            if !folder.join("manifest.json").exists() {
                if folder.exists() {
                    std::fs::remove_dir_all(&folder)
                        .with_context(|| format!("{} cannot be removed", shown(&folder)))?;
                }
                say("1/6", "rigged files: creatures that riglab makes itself");
                riglab(&["synth", "-o", &shown(&folder), "--count", CREATURES])?;
            }
            folder
        }
    };
    let corpus = out.join("corpus.h5");
    if !corpus.exists() {
        say("2/6", "a corpus: one HDF5 file, checked, with splits");
        riglab(&["dataset", "import", &shown(&folder), "-o", &shown(&corpus)])?;
        riglab(&["dataset", "stats", &shown(&corpus)])?;
    }
    let run = out.join("run");
    say("3/6", "training: a tiny skin auto-encoder (FSQ-CVAE)");
    if run.join("config.toml").exists() {
        riglab(&["--threads", "1", "train", "--resume", &shown(&run)])?;
    } else {
        let corpora = format!("data.corpora=[{:?}]", shown(&corpus));
        // A network this small gains nothing from a second thread.
        riglab(&["--threads", "1", "train", "quickstart/demo.toml", "--set", &corpora, "--run", &shown(&run)])?;
    }
    say("4/6", "evaluation on whole meshes that training has not seen");
    riglab(&["eval", &shown(&run)])?;
    say("5/6", "the report");
    let name = input.as_deref().and_then(Path::file_name).map_or("creatures".into(), |n| n.to_string_lossy());
    let title = format!("riglab demo on {name}");
    let written = out.join("auto-encoder.html");
    riglab(&["report", &shown(&run), "-o", &shown(&written), "--title", &title])?;
    let (refined, gains) = (out.join("refined"), out.join("refined.html"));
    say("6/6", "GRPO: the model that comes along, refined by geometric rewards on these meshes");
    if refined.join("config.toml").exists() {
        riglab(&["train", "--resume", &shown(&refined)])?;
    } else {
        let corpora = format!("data.corpora=[{:?}]", shown(&corpus));
        riglab(&["train", "quickstart/grpo.toml", "--set", &corpora, "--run", &shown(&refined)])?;
    }
    riglab(&["eval", &shown(&refined), "--checkpoint", "last"])?;
    riglab(&[
        "report",
        &shown(&refined),
        "-o",
        &shown(&gains),
        "--title",
        &format!("{title}: rigs refined by rewards"),
    ])?;
    // The report is there when all is.
    std::fs::rename(&written, &report).with_context(|| format!("{} cannot be written", shown(&report)))?;
    ending(&[&report, &gains], &corpus, start.elapsed(), input.is_some());
    Ok(())
}

fn ending([report, gains]: &[&Path; 2], corpus: &Path, took: Duration, own: bool) {
    println!("\nDone in {:.1} minutes. The report: {}", took.as_secs_f64() / 60.0, shown(report));
    println!("and of the rigs before and after rewards: {}", shown(gains));
    println!("\nTry next:");
    println!("  cargo run --release --bin riglab -- rig MODEL -o rigged.glb --preview");
    println!("                                        rig a GLB, FBX or OBJ of yours with the model that comes along");
    if !own {
        println!("  cargo xtask demo --input DIR          the same on your own GLB, glTF, VRM and FBX files");
    }
    println!(
        "  cargo run --release --bin riglab -- train quickstart/fsq_cvae.toml --set data.corpora='[{:?}]'",
        shown(corpus)
    );
    println!("                                        a quarter of an hour, a much better model");
    println!("  cargo run --release --bin riglab -- help what else there is");
}

fn say(step: &str, what: &str) {
    println!("\n[{step}] {what}");
}

/// Runs a command of the product as a user would, and shows it.
fn riglab(args: &[&str]) -> Result<()> {
    println!("$ riglab {}", args.iter().map(|a| quoted(a)).collect::<Vec<_>>().join(" "));
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut all: Vec<OsString> = ["run", "--quiet", "--release", "--bin", "riglab", "--"].map(Into::into).into();
    all.extend(args.iter().map(Into::into));
    let status = Command::new(cargo).args(all).current_dir(shell::root()).status().context("cannot start cargo")?;
    match status.code() {
        Some(0) => Ok(()),
        Some(130) => bail!("stopped; the same command goes on from here"),
        _ => bail!("`riglab {}` failed; its message is above", args.join(" ")),
    }
}

/// An argument as one would type it.
fn quoted(arg: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,=:".contains(c);
    if arg.chars().all(plain) { arg.into() } else { format!("'{arg}'") }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}
