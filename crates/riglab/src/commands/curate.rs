//! `riglab curate`

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::{Context, Result, bail};
use riglab_curate::decisions::Decisions;
use riglab_curate::{
    CurateConfig, CurateError, Funnel, Places, Shard, SplitBy, SplitConfig, Tell, curate, listed, merge_shards,
};
use riglab_report::shell::{command, quoted};
use riglab_review::Review;
use riglab_slurm::SlurmConfig;
use riglab_train::Progress;

use super::earlier::Earlier;
use super::slurm::{Desk, On, apart, curate as on_slurm, settings as slurm_settings};
use super::{file_to_write, shown, some_of, train_on};
use crate::presets;

/// Make a clean corpus of files of mixed quality: repaired, filtered, without duplicates, labelled.
///
/// Splits are those of the folder's split.json, where there is one and no setting says otherwise; else they are made by
/// topology. Merged shards keep splits that came from a split.json. Likely typing errors in split.json and manifest.json are
/// reported. Beside the corpus, OUT.curation/ holds the funnel report (report.html, funnel.json), a line per asset
/// (assets.jsonl), and the journal by which an interrupted run goes on. A file that cannot be read is a line of the report.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab curate models/ -o corpus.h5
  riglab curate avatars/ -o avatars.h5 --config curation/vroid.toml --set bones.max=500
  riglab curate models/ -o part1.h5 --shard 1/8
  riglab curate --merge part*.h5 -o corpus.h5
  riglab curate models/ -o corpus.h5 --on slurm --parts 16 --set slurm.time=2:00:00

Shards find the duplicates within themselves. `--merge` finds those between them too, by the journals beside the \
corpora, and what it makes can be merged again; `riglab dataset merge` leaves out what is equal byte by byte.")]
pub struct Args {
    /// Folder of files, with those below it; with --merge the corpora of its shards.
    #[arg(required = true, value_name = "FOLDER")]
    inputs: Vec<PathBuf>,
    /// The corpus to write.
    #[arg(long, short, value_name = "FILE", value_parser = file_to_write())]
    out: PathBuf,
    /// Settings: a file, or one of those built in: curation/rig_xl.toml, curation/vroid.toml,
    /// curation/any.toml.
    #[arg(long, default_value = "curation/rig_xl.toml", value_name = "TOML")]
    config: String,
    /// Change a setting: `--set bones.min=4`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// A file of decisions, applied to what it names, as `riglab review` writes it: lines of name, digest, verdict
    /// (accept, reject, -), category, faults and comment, parted by tabs.
    #[arg(long, value_name = "FILE")]
    decisions: Option<PathBuf>,
    /// Curate only one of several parts of the files: 1/8 is the first of eight.
    #[arg(long, value_name = "I/N", value_parser = shard, conflicts_with_all = ["merge", "on"])]
    shard: Option<Shard>,
    /// Merge the corpora of shards into one.
    #[arg(long, conflicts_with = "on")]
    merge: bool,
    /// Hand the parts to a cluster, and a job that merges them, instead of looking at the files here.
    #[arg(long, value_name = "WHERE")]
    on: Option<On>,
    /// With --on: parts of the files, each a task.
    #[arg(long, default_value_t = 8, value_name = "N", requires = "on", value_parser = clap::value_parser!(u16).range(1..))]
    parts: u16,
    /// With --on: follow the jobs until the corpus is there.
    #[arg(long, requires = "on")]
    wait: bool,
    /// Print the funnel as JSON.
    #[arg(long, conflicts_with = "on")]
    json: bool,
}

impl Args {
    /// Whether it waits for jobs of a cluster.
    pub fn waits(&self) -> bool {
        self.wait
    }
}

fn shard(text: &str) -> Result<Shard, String> {
    let parts = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parts {
        Some((number, of)) if (1..=of).contains(&number) => Ok(Shard { number, of }),
        _ => Err("give the number of the part and how many there are, as 1/8".into()),
    }
}

/// `threads`: at work on files at once, here or in each task; 0 takes all processors.
pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    if let (None, Some(set)) = (args.on, apart(&args.sets).0.first()) {
        bail!("`--set {set}` is about a cluster; add --on slurm");
    }
    let (mut config, slurm, told) = settings(&args.config, &args.sets)?;
    if let ([folder], false) = (args.inputs.as_slice(), args.merge) {
        follow_list(&mut config.split, told, folder)?;
    }
    let keep = if args.merge { keep_lists(&config.split, told, &args.inputs) } else { Vec::new() };
    if let Some(path) = &args.decisions {
        if !path.is_file() {
            bail!("{}: no such file of decisions", path.display());
        }
        // Before hours of looking at files, not after them.
        Decisions::read(path)?;
        config.decisions = path.display().to_string();
    }
    // Where `riglab review` keeps them.
    let beside = Review::decisions_of(&args.out);
    if config.decisions.is_empty() && beside.is_file() {
        let path = shown(&beside);
        tell!("note: {path} holds decisions, which are not applied: --decisions {} applies them", quoted(&path));
    }
    let places = Places::of(&args.out);
    if args.on == Some(On::Slurm) {
        let [folder] = args.inputs.as_slice() else { bail!("give one folder") };
        places.check()?;
        let desk = Desk::new(&places.work, slurm)?.for_threads(threads)?;
        let request = on_slurm::Request { parts: args.parts.into(), threads, wait: args.wait };
        return on_slurm::run(folder, &args.out, &config, &desk, &request);
    }
    rayon::ThreadPoolBuilder::new().num_threads(threads).build_global().context("no threads can be started")?;
    let bar: Mutex<Option<(String, Progress)>> = Mutex::new(None);
    let journal = places.journal();
    let begun = AtomicBool::new(false);
    let tell: Tell = &|what, done, total| {
        // Ctrl-C ends the process where it is.
        if what == "looking" && done < total && !begun.swap(true, Ordering::Relaxed) {
            tell!("note: if it is interrupted, the same command continues from {}", journal.display());
        }
        progress(&bar, what, done, total);
    };
    let before = Earlier::at(&args.out);
    let done = if args.merge {
        merge_shards(&args.inputs, &keep, &places, &config, tell)
    } else {
        let [folder] = args.inputs.as_slice() else {
            bail!("give one folder, or --merge with the corpora of shards");
        };
        curate(folder, &places, args.shard, &config, tell)
    };
    if let Some((_, mut bar)) = bar.lock().ok().and_then(|mut b| b.take()) {
        bar.finish();
    }
    match (done, args.shard) {
        (Ok(funnel), _) => {
            before.tell_replaced(&args.out);
            if let Some(next) = next(args) {
                tell!("next: {next}");
            }
            show(&funnel, &places, args.json)?;
            Ok(ExitCode::SUCCESS)
        }
        // A small folder leaves some of many parts without a file.
        (Err(CurateError::NothingLeft { assets: 0, .. }), Some(Shard { number, of })) => {
            let out = shown(&places.out);
            tell!("note: no file falls into part {number} of {of}: {out} is not written, and --merge does without it");
            Ok(ExitCode::SUCCESS)
        }
        (Err(e @ CurateError::NothingLeft { .. }), _) => {
            tell!("error: {e}");
            Ok(ExitCode::FAILURE)
        }
        (Err(e), _) => Err(e.into()),
    }
}

/// The command that goes on with a corpus: a person looks at it, and it is trained on when that was done. Parts wait for one
/// another.
fn next(args: &Args) -> Option<String> {
    let next = || match &args.decisions {
        Some(_) => train_on(&args.out),
        None => command(["review", &shown(&args.out)]),
    };
    (args.shard.is_none() && !args.json).then(next)
}

/// The settings, and whether they say how splits are made.
fn settings(name: &str, sets: &[String]) -> Result<(CurateConfig, SlurmConfig, bool)> {
    let loaded = presets::load_block(name, sets)?;
    let slurm = slurm_settings(&loaded)?;
    let loaded = loaded.without("slurm");
    let config: CurateConfig = loaded.get()?;
    config.validate().map_err(|(path, message)| loaded.invalid(path, message))?;
    let told = loaded.contains("split.by");
    Ok((config, slurm, told))
}

/// Takes the splits of a folder's `split.json`, as `riglab dataset import` does, unless the settings say otherwise: what its
/// makers tested on must not be trained on unasked.
fn follow_list(split: &mut SplitConfig, told: bool, folder: &Path) -> Result<()> {
    let list = folder.join("split.json");
    if !list.is_file() {
        return Ok(());
    }
    if told {
        if split.by != SplitBy::List {
            tell!("note: {} is left aside, since the settings say split.by", list.display());
        }
        return Ok(());
    }
    let list = std::path::absolute(&list).with_context(|| format!("{} has no place", list.display()))?;
    (split.by, split.file) = (SplitBy::List, list.display().to_string());
    tell!("note: splits are those of {}; --set split.by=topology makes others", list.display());
    Ok(())
}

/// The parts whose splits stay, which are those that a list gave, unless the settings say otherwise; and what to say of it.
fn keep_lists(split: &SplitConfig, told: bool, parts: &[PathBuf]) -> Vec<PathBuf> {
    let keep = listed(parts);
    let named = |parts: &[&PathBuf]| some_of(&parts.iter().map(|part| shown(part)).collect::<Vec<_>>());
    let (theirs, others): (Vec<&PathBuf>, Vec<&PathBuf>) = parts.iter().partition(|part| keep.contains(part));
    if keep.is_empty() {
        return keep;
    }
    if told {
        if split.by != SplitBy::List {
            let are = named(&theirs);
            tell!("note: the splits that a list gave {are} are left aside, since the settings say split.by");
        }
        return Vec::new();
    }
    let makes = "--set split.by=topology makes others";
    match others.is_empty() {
        true => tell!("note: splits are those of the parts, which a list gave; {makes}"),
        false => tell!(
            "warning: the splits of {} are kept, as a list gave them; none gave those of {}, which are made by topology \
             among themselves, so that trees of joints of their test_new may be trained on in the others; {makes} for all",
            named(&theirs),
            named(&others)
        ),
    }
    keep
}

/// Shows how far a phase is; another phase ends the bar of the one before.
fn progress(bar: &Mutex<Option<(String, Progress)>>, what: &str, done: usize, total: usize) {
    let Ok(mut bar) = bar.lock() else { return };
    if total == 0 {
        tell!("note: {what}");
        return;
    }
    if bar.as_ref().is_none_or(|(name, _)| name != what) {
        if let Some((_, mut old)) = bar.take() {
            old.finish();
        }
        *bar = Some((what.to_owned(), Progress::new(what, total as u64, done as u64)));
    }
    if let Some((_, bar)) = bar.as_mut() {
        bar.set_of(done as u64, total as u64);
    }
}

fn show(funnel: &Funnel, places: &Places, json: bool) -> Result<()> {
    if json {
        say!("{}", serde_json::to_string(funnel).context("the funnel cannot be printed")?);
        return Ok(());
    }
    for warning in &funnel.warnings {
        tell!("warning: {warning}");
    }
    say!("{:12} {:>8} {:>8} {:>8}", "stage", "came", "dropped", "left");
    for stage in &funnel.stages {
        let dropped = stage.dropped.len();
        say!("{:12} {:>8} {:>8} {:>8}", stage.stage, stage.came, dropped, stage.came - dropped);
    }
    let splits: Vec<String> =
        funnel.splits.iter().map(|(name, n)| format!("{} {n}", if name.is_empty() { "none" } else { name })).collect();
    say!("{}: {} of {} assets ({})", shown(&places.out), funnel.kept, funnel.assets, splits.join(", "));
    say!("{}", shown(&places.report()));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_corpus_is_looked_at_and_then_trained_on() {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: Args,
        }
        let of = |more: &str| {
            let line = format!("curate models -o c.h5 {more}");
            next(&<Line as clap::Parser>::parse_from(line.split_whitespace()).args)
        };
        assert_eq!(of("").unwrap(), "riglab review c.h5");
        assert!(of("--decisions d.tsv").unwrap().starts_with("riglab train quickstart/fsq_cvae.toml --set"));
        assert_eq!([of("--shard 1/8"), of("--json")], [None, None]);
    }
}
