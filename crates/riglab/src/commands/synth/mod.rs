//! `riglab synth`

mod begun;

use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use rayon::prelude::*;
use riglab_asset::{ImportOptions, import_bytes, to_glb};
use riglab_core::Asset;
use riglab_data::{CorpusWriter, Splitter, copies_told};
use riglab_files::{is_as_of_folder, make_folder_of};
use riglab_report::shell::command;
use riglab_synth::{Options, Plan, creature, name, provenance};
use riglab_train::Progress;

use super::earlier::Earlier;
use super::{place_to_write, train_on};
use begun::Begun;
use riglab_report::counted;

/// Make rigged creatures: files to try everything on, without any of your own.
///
/// Each is drawn by seed and number, so the same command makes the same files. Plans are people,
/// avatars with spring bones, animals of many kinds, monsters, machines and props; unless some are
/// given, they come about as often as in corpora of real rigs. They become GLB files in a folder, with a
/// manifest.json that states source, licence (CC0) and category, or at once a corpus, split by topology. An
/// interrupted folder is continued when the same command is given again; a corpus starts over.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab synth -o creatures --count 120
  riglab synth -o creatures.h5 --count 10000
  riglab synth -o fish --plans fish --seed 7 --triangles 500..2000")]
pub struct Args {
    /// Folder to write GLB files into, made if there is none, else it must be empty or of the same command, broken off; or a
    /// corpus (.h5).
    #[arg(long, short, value_name = "DIR|FILE.h5", value_parser = place_to_write())]
    out: PathBuf,
    /// How many.
    #[arg(long, default_value_t = 60, value_name = "N", value_parser = clap::value_parser!(u64).range(1..=10_000_000))]
    count: u64,
    /// Seed.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[arg(long, value_delimiter = ',', value_name = "PLAN,..", help = plans_help())]
    plans: Vec<String>,
    /// Triangles of a creature, chosen at random between these; 500 to 50000 make sense. A target: thin parts (fingers,
    /// tails, ears) need more where few are asked for, up to twice as many for 4000 and five times for 500.
    #[arg(long, default_value = "1000..14000", value_name = "MIN..MAX", value_parser = range)]
    triangles: RangeInclusive<u32>,
}

fn plans_help() -> String {
    let (mixed, asked): (Vec<Plan>, Vec<Plan>) = Plan::ALL.into_iter().partition(|plan| Plan::MIXTURE.contains(plan));
    let [mixed, asked] = [mixed, asked].map(|plans| plans.into_iter().map(Plan::name).collect::<Vec<_>>().join(", "));
    format!(
        "Body plans, used in turn; one may be named several times [default: a mixture of {mixed}]; only on request: \
         {asked}"
    )
}

fn range(text: &str) -> Result<RangeInclusive<u32>, String> {
    let parts: Option<Vec<u32>> = text.split("..").map(|n| n.trim_start_matches('=').trim().parse().ok()).collect();
    match parts.as_deref() {
        Some(&[least, most]) if (100..=most).contains(&least) && most <= 1_000_000 => Ok(least..=most),
        Some(&[most, least]) if least < most => {
            Err(format!("the smaller number comes first, as {least}..{most}; both are from 100 to 1000000"))
        }
        _ => Err("give two numbers from 100 to 1000000, as 2000..8000".into()),
    }
}

/// Creatures made before they are written: bounds memory.
const AT_ONCE: usize = 64;

pub fn run(args: &Args) -> Result<ExitCode> {
    let plans: Result<Vec<Plan>, String> = args.plans.iter().map(|p| p.parse()).collect();
    let plans = plans.map_err(anyhow::Error::msg)?;
    let plans = if plans.is_empty() { Plan::MIXTURE.to_vec() } else { plans };
    let options = Options { plans, triangles: args.triangles.clone() };
    let out = &args.out;
    if !is_as_of_folder(out)
        && out.extension().is_some_and(|e| e.eq_ignore_ascii_case("h5") || e.eq_ignore_ascii_case("hdf5"))
    {
        return corpus(args, &options);
    }
    let begun = Begun::open(out, &settings(args, &options))?;
    let file = |k: u64| format!("{}.glb", name(args.seed, k, &options));
    let there = begun.files((0..args.count).map(file))?;
    let open: Vec<u64> = (0..args.count).filter(|k| !there.contains(&file(*k))).collect();
    let mut done = args.count - open.len() as u64;
    if done > 0 {
        tell!("note: {done} of {} are there already; going on", counted(args.count as usize, "creature"));
    }
    let mut progress = Progress::new("making creatures", args.count, done);
    for these in open.chunks(AT_ONCE) {
        let write = |&k: &u64| put(&out.join(file(k)), &to_glb(&creature(args.seed, k, &options)));
        these.into_par_iter().map(write).collect::<Result<()>>()?;
        done += these.len() as u64;
        progress.set(done, String::new);
    }
    progress.finish();
    let entry = |k: u64| {
        let from = provenance(args.seed, k, &options);
        serde_json::json!({"file": file(k), "source": from.source, "licence": from.licence, "category": from.category})
    };
    let manifest: Vec<serde_json::Value> = (0..args.count).map(entry).collect();
    // Written last: a folder with a manifest is complete.
    put(&out.join(MANIFEST), (serde_json::to_string_pretty(&manifest)? + "\n").as_bytes())?;
    begun.finish()?;
    tell!("next: {}", command(["dataset", "import", &out.to_string_lossy(), "-o", "corpus.h5"]));
    say!("{}: {}", out.display(), counted(manifest.len(), "creature"));
    Ok(ExitCode::SUCCESS)
}

/// What lists the creatures of a folder.
const MANIFEST: &str = "manifest.json";

/// What a folder's creatures follow from, by the options that say it.
fn settings(args: &Args, options: &Options) -> Vec<(String, String)> {
    let plans: Vec<&str> = options.plans.iter().map(|plan| plan.name()).collect();
    let (least, most) = (args.triangles.start(), args.triangles.end());
    [
        ("--count", args.count.to_string()),
        ("--seed", args.seed.to_string()),
        ("--plans", plans.join(",")),
        ("--triangles", format!("{least}..{most}")),
        ("riglab", crate::VERSION.into()),
    ]
    .map(|(name, value)| (name.to_owned(), value))
    .into()
}

/// Writes the creatures to a corpus as they are made.
fn corpus(args: &Args, options: &Options) -> Result<ExitCode> {
    make_folder_of(&args.out)?;
    let before = Earlier::at(&args.out);
    let mut writer = CorpusWriter::create(&args.out)?;
    let mut progress = Progress::new("making creatures", args.count, 0);
    let mut keys = Vec::new();
    let mut from = 0;
    while from < args.count {
        let to = args.count.min(from + AT_ONCE as u64);
        let make = |k| as_imported(creature(args.seed, k, options));
        let made: Vec<Asset> = (from..to).into_par_iter().map(make).collect::<Result<_>>()?;
        for asset in &made {
            writer.add(asset)?;
            keys.push(Splitter::key(asset));
        }
        from = to;
        progress.set(from, String::new);
    }
    let (splits, warnings) = split(args.seed, &keys, &writer.digests());
    writer.finish(&splits)?;
    progress.finish();
    before.tell_replaced(&args.out);
    warnings.iter().for_each(|warning| tell!("warning: {warning}"));
    tell!("next: {}", train_on(&args.out));
    say!("{}: {}", args.out.display(), counted(keys.len(), "creature"));
    Ok(ExitCode::SUCCESS)
}

/// Splits of creatures as importing their files makes them, which it reads by name; with what it would warn of.
fn split(seed: u64, keys: &[(String, u64)], digests: &[&str]) -> (Vec<String>, Vec<String>) {
    let mut order: Vec<usize> = (0..keys.len()).collect();
    order.sort_by_key(|&k| file_of(&keys[k].0));
    let sorted: Vec<(String, u64)> = order.iter().map(|&k| keys[k].clone()).collect();
    let contents: Vec<&str> = order.iter().map(|&k| digests[k]).collect();
    let splitter = Splitter::ByTopology(seed);
    let of = splitter.assign_equal(&sorted, &contents);
    let mut warnings = splitter.doubts(&sorted, &of, |_| true);
    let names: Vec<&str> = sorted.iter().map(|(name, _)| name.as_str()).collect();
    warnings.extend(copies_told(&names, &contents, &of));
    let mut splits = vec![String::new(); keys.len()];
    order.into_iter().zip(of).for_each(|(k, split)| splits[k] = split);
    (splits, warnings)
}

/// The file of a creature.
fn file_of(name: &str) -> String {
    format!("{name}.glb")
}

/// A creature as importing its file gives it, which has its joints in the file's order: corpora of the same creatures are
/// equal, whether they were made at once or of files, and merging them leaves each in once.
fn as_imported(creature: Asset) -> Result<Asset> {
    let read = import_bytes(&file_of(&creature.name), &to_glb(&creature), &ImportOptions::default())?.into_asset()?;
    Ok(Asset { rig: read.rig, ..creature })
}

fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    riglab_files::write(path, bytes).with_context(|| format!("{} cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splits_do_not_hang_on_the_order_of_creatures_and_are_doubted() {
        let keys: Vec<(String, u64)> = (0..40u64).map(|k| (format!("creature-{k}"), k % 5)).collect();
        let digests: Vec<String> = (0..40).map(|k| k.to_string()).collect();
        let digests: Vec<&str> = digests.iter().map(String::as_str).collect();
        let (splits, warnings) = split(0, &keys, &digests);
        assert_eq!(warnings, Vec::<String>::new());
        let turned: Vec<(String, u64)> = keys.iter().rev().cloned().collect();
        let (other, _) = split(0, &turned, &digests);
        assert!(other.iter().rev().eq(&splits) && splits.iter().any(|s| s == "val"));
        // Two creatures have nothing to validate on, and of equal ones one is enough.
        let (_, told) = split(0, &keys[..2], &["x", "x"]);
        assert!(told.len() == 2 && told[0].contains("a split `val`") && told[1].contains("equal"), "{told:?}");
    }

    #[test]
    fn numbers_of_triangles_rise() {
        assert_eq!(range("500..2000"), Ok(500..=2000));
        assert_eq!(range("500..500"), Ok(500..=500));
        assert!(range("1000..200").unwrap_err().starts_with("the smaller number comes first, as 200..1000"));
        for wrong in ["10..2000", "500", "500..2000000", "a..b"] {
            assert!(range(wrong).unwrap_err().contains("from 100 to 1000000"), "{wrong}");
        }
    }
}
