//! `cargo xtask demo`: the main job at small scale, by the product's own commands.
//!
//! Each step leaves a file, and a step whose file is there is not done again: a demo that was
//! stopped goes on where it was. The folder says which files it is of: it is not gone on with for others.

use std::ffi::OsString;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
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
/// What a demo's folder says it is of: a whole path, or for the default demo words that are none.
const SOURCE: &str = "input.txt";
const MADE: &str = "creatures that riglab makes itself";

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
    let source = input.as_deref().map_or(MADE.into(), shown);
    check(out, &source)?;
    if report.exists() {
        println!("{} is there already. Remove {} to run the demo again.", shown(&report), shown(out));
        return Ok(());
    }
    shell::cargo(&["build", "--release", "--bin", "riglab"])?;
    std::fs::create_dir_all(out).with_context(|| format!("{} cannot be made", shown(out)))?;
    let note = out.join(SOURCE);
    std::fs::write(&note, &source).with_context(|| format!("{} cannot be written", shown(&note)))?;
    // Ctrl-C goes to the running command, which saves its work and ends.
    ctrlc::set_handler(|| ()).context("cannot listen to Ctrl-C")?;
    let start = Instant::now();

    let folder = match input {
        Some(folder) => folder.clone(),
        None => {
            let folder = out.join("files");
            if !folder.join("manifest.json").exists() {
                // It goes on where it was stopped, and refuses a folder that holds anything else.
                say("1/6", &format!("rigged files: {MADE}"));
                riglab(&["synth", "-o", &shown(&folder), "--count", CREATURES])?;
            }
            folder
        }
    };
    let corpus = out.join("corpus.h5");
    if !corpus.exists() {
        say("2/6", "a corpus: one HDF5 file, checked, with splits");
        // Under its name once it is known to do.
        let begun = out.join("begun.h5");
        riglab(&["dataset", "import", &shown(&folder), "-o", &shown(&begun)])?;
        let lacks = lacking(&output(&["dataset", "stats", &shown(&begun), "--json"])?);
        if !lacks.is_empty() {
            bail!(
                "{}: too few kinds of skeletons to train on some and look at others: no model is in {}; give the demo more \
                 models, or beside them a split.json that says which are for what (data_prep/README.md)",
                shown(&folder),
                lacks.join(" and ")
            );
        }
        std::fs::rename(&begun, &corpus).with_context(|| format!("{} cannot be written", shown(&corpus)))?;
        riglab(&["dataset", "stats", &shown(&corpus)])?;
    }
    let run = out.join("run");
    say("3/6", "training: a tiny skin auto-encoder (FSQ-CVAE)");
    if run.join("config.toml").exists() {
        riglab(&["--threads", "1", "train", "--resume", &shown(&run)])?;
    } else {
        let corpora = as_corpora(&corpus);
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
    say("6/6", "GRPO: the model that comes with riglab, refined by geometric rewards on these meshes");
    if refined.join("config.toml").exists() {
        riglab(&["train", "--resume", &shown(&refined)])?;
    } else {
        let corpora = as_corpora(&corpus);
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

/// The splits that training and evaluation need and a corpus lacks, by what `riglab dataset stats --json` says of it.
fn lacking(stats: &str) -> Vec<&'static str> {
    let has = |split: &str| stats.contains(&format!("\"{split}\":"));
    let tests = ["test_seen", "test_new"].into_iter().any(has);
    let needed = [("train", has("train")), ("val", has("val")), ("test_seen or test_new", tests)];
    needed.into_iter().filter(|(_, there)| !there).map(|(split, _)| split).collect()
}

/// What a demo makes in its folder, all of it under the names of somebody else's work, too.
const MAKES: [&str; 4] = ["files", "corpus.h5", "run", "refined"];

/// Refuses a folder with a demo of other files, as folders of input that end in the same name share one by default, and one
/// with something in the demo's places that no demo made.
fn check(out: &Path, source: &str) -> Result<()> {
    let there = match std::fs::read_to_string(out.join(SOURCE)) {
        Ok(there) => there,
        Err(_) if out.join("files/manifest.json").exists() => MADE.into(),
        Err(_) if out.join("corpus.h5").exists() => "files that it does not name".into(),
        Err(_) => {
            return match MAKES.iter().find(|name| out.join(name).exists()) {
                Some(name) => bail!(
                    "{} is there already, and no demo's ({SOURCE} beside it would say so); give the demo a folder of its own \
                     with --out DIR",
                    shown(&out.join(name))
                ),
                None => Ok(()),
            };
        }
    };
    if there != source {
        bail!(
            "{0} holds a demo of other files ({there}; here: {source}); give this one a folder of its own with --out DIR, \
             or remove {0}",
            shown(out)
        );
    }
    Ok(())
}

fn ending([report, gains]: &[&Path; 2], corpus: &Path, took: Duration, own: bool) {
    println!("\nDone in {:.1} minutes. Report on the auto-encoder: {}", took.as_secs_f64() / 60.0, shown(report));
    println!("Report on rigs before and after GRPO: {}", shown(gains));
    println!("\nTry next:");
    println!("  cargo run --release --bin riglab -- rig MODEL -o rigged.glb --preview");
    println!("                                        rig your own GLB, FBX, OBJ, PLY or STL with riglab's model");
    if !own {
        println!("  cargo xtask demo --input DIR          the same on your own GLB, glTF, VRM and FBX files");
    }
    println!(
        "  cargo run --release --bin riglab -- train quickstart/fsq_cvae.toml --set {}",
        quoted(&as_corpora(corpus))
    );
    println!("                                        a quarter of an hour, a much better model");
    println!("  cargo run --release --bin riglab -- help");
    println!("                                        all other commands");
}

fn say(step: &str, what: &str) {
    println!("\n[{step}] {what}");
}

/// A command of the product.
fn product(args: &[&str]) -> Command {
    let cargo = std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into());
    let mut all: Vec<OsString> = ["run", "--quiet", "--release", "--bin", "riglab", "--"].map(Into::into).into();
    all.extend(args.iter().map(Into::into));
    let mut command = Command::new(cargo);
    command.args(all).current_dir(shell::root());
    command
}

/// What a command of the product prints.
fn output(args: &[&str]) -> Result<String> {
    let out = product(args).stderr(Stdio::inherit()).output().context("cannot start cargo")?;
    if !out.status.success() {
        bail!("`riglab {}` failed; its message is above", args.join(" "));
    }
    Ok(String::from_utf8_lossy(&out.stdout).into_owned())
}

/// Runs a command of the product as a user would, and shows it.
fn riglab(args: &[&str]) -> Result<()> {
    let command = args.iter().map(|a| quoted(a)).collect::<Vec<_>>().join(" ");
    println!("$ riglab {command}");
    let status = product(args).status().context("cannot start cargo")?;
    match status.code() {
        Some(0) => Ok(()),
        // Ctrl-C, a terminal that hung up, a system that ends programs.
        Some(129 | 130 | 143) => bail!("stopped; run the same command again to continue from here"),
        _ => bail!("`riglab {command}` failed; its message is above"),
    }
}

/// The setting that names one corpus, as TOML: what Rust's `{:?}` writes of other signs is none.
fn as_corpora(corpus: &Path) -> String {
    let mut text = String::from("data.corpora=[\"");
    for c in shown(corpus).chars() {
        match c {
            '"' | '\\' => text.extend(['\\', c]),
            c if c.is_control() => text += &format!("\\u{:04x}", u32::from(c)),
            c => text.push(c),
        }
    }
    text + "\"]"
}

/// An argument as one would type it.
fn quoted(arg: &str) -> String {
    let plain = |c: char| c.is_ascii_alphanumeric() || "-_./,=:".contains(c);
    match !arg.is_empty() && arg.chars().all(plain) {
        true => arg.into(),
        // Within quotes a shell takes everything as it is, but the quote that ends them.
        false => format!("'{}'", arg.replace('\'', "'\\''")),
    }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corpus_is_named_in_toml_whatever_its_path_is() {
        let of = |path: &str| as_corpora(Path::new(path));
        assert_eq!(of("/a/corpus.h5"), r#"data.corpora=["/a/corpus.h5"]"#);
        // A mark that stands over the sign before it, and a space that breaks no line.
        assert_eq!(of("/e\u{301}\u{a0}x.h5"), "data.corpora=[\"/e\u{301}\u{a0}x.h5\"]");
        assert_eq!(of("/a\"b\\c\n\u{7f}"), r#"data.corpora=["/a\"b\\c\u000a\u007f"]"#);
    }

    #[test]
    fn a_corpus_of_a_demo_has_something_to_train_on_and_something_to_look_at() {
        let of = |splits: &[&str]| {
            let rows: Vec<String> = splits.iter().map(|split| format!("\"{split}\":{{\"assets\":1}}")).collect();
            lacking(&format!("{{{}}}", rows.join(",")))
        };
        assert!(of(&["all", "train", "val", "test_new"]).is_empty());
        assert_eq!(of(&["all", "train"]), ["val", "test_seen or test_new"]);
        assert_eq!(of(&["all", "train_extra", "val", "test_seen"]), ["train"]);
    }

    #[test]
    fn a_demo_is_not_gone_on_with_for_other_files() {
        let dir = tempfile::tempdir().unwrap();
        let out = dir.path();
        let refused = |source: &str| check(out, source).unwrap_err().to_string();
        check(out, "/a/rigs").unwrap();
        std::fs::write(out.join("corpus.h5"), "").unwrap();
        assert!(refused("/a/rigs").contains("files that it does not name"), "a folder that says nothing");
        std::fs::write(out.join(SOURCE), "/a/rigs").unwrap();
        check(out, "/a/rigs").unwrap();
        let said = refused("/b/rigs");
        assert!(said.contains("(/a/rigs; here: /b/rigs)") && said.contains("--out DIR, or remove"), "{said}");
        assert!(refused(MADE).contains("(/a/rigs; here: creatures"), "input may be called as the default is");
        std::fs::remove_file(out.join(SOURCE)).unwrap();
        std::fs::remove_file(out.join("corpus.h5")).unwrap();
        for name in ["run", "files"] {
            std::fs::create_dir(out.join(name)).unwrap();
            assert!(refused(MADE).contains(&format!("{name} is there already, and no demo's")), "{name}");
        }
        std::fs::write(out.join("files/manifest.json"), "").unwrap();
        check(out, MADE).unwrap();
        assert!(refused("/x/creatures").contains("(creatures that"));
    }

    #[test]
    fn a_shell_reads_back_what_is_shown() {
        assert_eq!(quoted("data.corpora=a.h5"), "data.corpora=a.h5");
        for odd in ["it's", "a b", "", "data.corpora=[\"/home/o'neil/rigs/corpus.h5\"]", "'"] {
            let script = format!("printf %s {}", quoted(odd));
            let said = Command::new("sh").args(["-c", &script]).output().unwrap();
            assert_eq!(String::from_utf8(said.stdout).unwrap(), odd);
        }
    }
}
