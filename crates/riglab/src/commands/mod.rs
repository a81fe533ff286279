//! One module a command.

mod alike;
mod charts;
pub mod checkpoint;
pub mod compare;
pub mod completions;
pub mod convert;
pub mod curate;
pub mod dataset;
mod device;
pub mod doctor;
mod earlier;
pub mod eval;
mod forms;
mod glb;
mod inputs;
pub mod inspect;
mod longer;
mod of_files;
pub mod report;
pub mod review;
pub mod rewards;
pub mod rig;
pub mod simulate;
pub mod slurm;
pub mod strip;
pub mod sweep;
pub mod synth;
pub mod tokens;
pub mod train;
pub mod view;
mod whose;

use std::path::PathBuf;

/// Reads an argument that names a file to write: one that ends as a folder's name does would be refused after the work, and `-`
/// would be a file of that name.
fn file_to_write() -> impl clap::builder::TypedValueParser<Value = PathBuf> {
    file_or("`-` does not stand for standard output here: give the name of a file (./- for one that is called so)")
}

/// The same where a folder may be written as well.
fn place_to_write() -> impl clap::builder::TypedValueParser<Value = PathBuf> {
    use clap::builder::{PathBufValueParser, TypedValueParser};
    let dash = "`-` does not stand for standard output here: give the name of a file or folder (./- for one that is called so)";
    PathBufValueParser::new().try_map(move |path| if path.as_os_str() == "-" { Err(dash) } else { Ok(path) })
}

/// The same where what is written goes to standard output without a file.
fn file_instead_of_output() -> impl clap::builder::TypedValueParser<Value = PathBuf> {
    file_or("without this option, all goes to standard output: leave it out, or give the name of a file")
}

/// `dash`: what is said of a `-`.
fn file_or(dash: &'static str) -> impl clap::builder::TypedValueParser<Value = PathBuf> {
    use clap::builder::{PathBufValueParser, TypedValueParser};
    PathBufValueParser::new().try_map(move |path| match riglab_files::is_as_of_folder(&path) {
        true => {
            Err(format!("it names a folder, and one file is written: give it a name there, as {}NAME", shown(&path)))
        }
        false if path.as_os_str() == "-" => Err(dash.to_owned()),
        false => Ok(path),
    })
}

/// A name that stands in a line: a control character, a line break among them, would be taken for one of the line's own.
fn in_line(name: impl std::fmt::Display) -> String {
    name.to_string().chars().map(|c| if c.is_control() { '\u{fffd}' } else { c }).collect()
}

/// A path in a text, or as an argument.
fn shown(path: &std::path::Path) -> String {
    path.display().to_string()
}

/// Whether a file is an FBX, by its name, where riglab reads and writes any.
fn is_fbx(path: &std::path::Path) -> bool {
    cfg!(feature = "fbx") && path.extension().is_some_and(|of| of.eq_ignore_ascii_case("fbx"))
}

/// How many lines of one kind are shown.
const SHOWN: usize = 5;

/// The lines to show of many: some, and how many more there are.
fn some_lines(lines: impl ExactSizeIterator<Item = String>, more: &str) -> Vec<String> {
    let count = lines.len();
    // The last line is worth one of its kind.
    let shown = if count > SHOWN + 1 { SHOWN } else { count };
    let mut some: Vec<String> = lines.take(shown).collect();
    if count > shown {
        some.push(format!("{} {more}", count - shown));
    }
    some
}

/// How many names are shown in a line.
const SOME: usize = 3;

/// Some names of many.
fn some_of(names: &[String]) -> String {
    match names.len() {
        n if n > SOME + 1 => format!("{} and {} more", names[..SOME].join(", "), n - SOME),
        _ => names.join(", "),
    }
}

/// Refuses a folder of models for the many files of a new run or sweep: they would lie among them. Of a run or sweep that is
/// there already others say more.
fn keep_apart(folder: &std::path::Path) -> anyhow::Result<()> {
    if folder.join("config.toml").is_file() {
        return Ok(());
    }
    let model = |path: &std::path::PathBuf| path.is_file() && riglab_asset::is_model_file(path);
    let entries = folder.read_dir().into_iter().flatten().flatten();
    match entries.map(|entry| entry.path()).filter(model).min() {
        Some(file) => anyhow::bail!(
            "{} holds models, such as {}: give a folder of its own, empty or not there yet",
            folder.display(),
            file.file_name().unwrap_or_default().to_string_lossy()
        ),
        None => Ok(()),
    }
}

/// Refuses to write over a corpus, which takes long to make, what is none.
fn keep_corpus(out: &std::path::Path) -> anyhow::Result<()> {
    if out.is_file() && riglab_data::Corpus::open(out).is_ok() {
        anyhow::bail!("{} is a corpus, which only another corpus may replace; give another name", out.display());
    }
    Ok(())
}

/// The command that trains on a new corpus.
fn train_on(corpus: &std::path::Path) -> String {
    riglab_report::shell::command(["train", "quickstart/fsq_cvae.toml", "--set", &as_corpora(corpus)])
}

/// The setting that names one corpus.
fn as_corpora(corpus: &std::path::Path) -> String {
    format!("data.corpora=[{}]", serde_json::Value::from(shown(corpus)))
}

/// As much of a checksum as tells it from others.
fn short(sum: &str) -> &str {
    sum.get(..12).unwrap_or(sum)
}

/// Refuses what several processes would do all over again, each into the same files.
fn alone(command: &str) -> anyhow::Result<()> {
    match riglab_ranks::launched() {
        0 | 1 => Ok(()),
        n => anyhow::bail!(
            "{n} processes were started, but `riglab {command}` is one; start it without mpirun (of all commands \
             `riglab train` alone is shared by several)"
        ),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_stay_out_of_folders_of_models() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str| std::fs::write(folder.path().join(name), "").unwrap();
        assert!(keep_apart(&folder.path().join("none")).is_ok());
        ["corpus.h5", "note.txt", "job.sh"].into_iter().for_each(write);
        assert!(keep_apart(folder.path()).is_ok());
        write("Fox.GLB");
        let said = keep_apart(folder.path()).unwrap_err().to_string();
        assert!(said.contains("holds models, such as Fox.GLB"), "{said}");
        write("config.toml");
        assert!(keep_apart(folder.path()).is_ok(), "a run's folder is another's to refuse");
    }

    #[test]
    fn a_file_to_write_has_no_folders_name() {
        use clap::Parser;

        for line in [
            "eval RUN --out O/",
            "dataset import models -o O/",
            "dataset merge a.h5 b.h5 -o O/",
            "dataset vary a.h5 -o O/",
            "curate models -o O/",
            "compare out --truth a.h5 --json -o O/",
            "rewards out -o O/",
            "report RUN -o O/",
            "simulate a.glb -o O/",
            "simulate a.glb -o b.glb --png O/",
            "view a.glb --png O/",
            "strip a.glb O/",
            "review a.h5 --decisions O/",
        ] {
            let said = crate::Cli::try_parse_from(["riglab"].into_iter().chain(line.split(' '))).err();
            let said = said.unwrap_or_else(|| panic!("{line} is taken")).to_string();
            assert!(said.contains("it names a folder") && said.contains("as O/NAME"), "{line}: {said}");
            let dash = line.replace("O/", "-");
            let said = crate::Cli::try_parse_from(["riglab"].into_iter().chain(dash.split(' '))).err();
            let said = said.unwrap_or_else(|| panic!("{dash} is taken")).to_string();
            let all = line.starts_with("compare") || line.starts_with("rewards");
            assert!(said.contains("standard output") && said.contains("leave it out") == all, "{dash}: {said}");
            let named = line.replace("O/", "O/n.png");
            let words = ["riglab"].into_iter().chain(named.split(' '));
            assert!(crate::Cli::try_parse_from(words).is_ok(), "{named}");
        }
    }

    #[test]
    fn a_place_to_write_is_not_standard_output() {
        use clap::Parser;

        for line in [
            "checkpoint export RUN -o -",
            "checkpoint import a.ckpt -o -",
            "convert models - --to glb",
            "synth -o -",
            "rig a.glb -o -",
            "skin a.glb -o -",
            "train a.toml --run -",
            "sweep a.toml -o -",
            "sweep a.toml --charts -",
            "report RUN --charts -",
        ] {
            let parse = |line: &str| crate::Cli::try_parse_from(["riglab"].into_iter().chain(line.split(' ')));
            let said = parse(line).err().unwrap_or_else(|| panic!("{line} is taken")).to_string();
            assert!(said.contains("`-` does not stand for standard output here"), "{line}: {said}");
            let place = format!("{line} ").replace(" - ", " ./- ");
            assert!(parse(place.trim_end()).is_ok(), "{place}");
        }
    }

    #[test]
    fn a_name_stays_in_its_line() {
        assert_eq!(in_line("a\nb\t\u{1b}[2J ü.glb"), "a\u{fffd}b\u{fffd}\u{fffd}[2J ü.glb");
    }

    #[test]
    fn examples_of_help_fit_into_its_width() {
        use clap::CommandFactory;

        fn of(command: &clap::Command) {
            let help = command.get_after_help().map(ToString::to_string).unwrap_or_default();
            // A wider one is broken in the middle, and cannot be copied.
            let wide = help.lines().find(|line| line.starts_with(' ') && line.chars().count() > 100);
            assert_eq!(wide, None, "of `riglab {}`", command.get_name());
            command.get_subcommands().for_each(of);
        }
        of(&crate::Cli::command());
    }

    #[test]
    fn many_lines_are_some_and_a_count() {
        let of = |count: usize| some_lines((0..count).map(|k| format!("line {k}")), "more lines");
        assert_eq!(of(6).len(), 6);
        let some = of(311);
        assert_eq!((some.len(), some[4].as_str(), some[5].as_str()), (6, "line 4", "306 more lines"));
        assert!(of(0).is_empty());
    }
}
