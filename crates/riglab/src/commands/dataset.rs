//! `riglab dataset`

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result};
use clap::Subcommand;
use riglab_asset::rigging::UpAxis;
use riglab_asset::{ImportOptions, Resample, RootPolicy};
use riglab_augment::Recipe;
use riglab_core::Asset;
use riglab_data::{
    Corpus, Member, Place, Repeated, Splitter, Stats, import_folder, import_meshes, merge, models_below, rewrite,
    rigged_below, stats,
};
use riglab_report::shell::command;
use riglab_train::Progress;

use riglab_report::counted;

use super::convert::bare_names;
use super::earlier::Earlier;
use super::inspect::vertices;
use super::of_files::OfFiles;
use super::{as_corpora, file_to_write, in_line, shown, some_lines, some_of, train_on};

/// Make and look at corpora: HDF5 files of many rigs.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Import(Import),
    Merge(Merge),
    Vary(Vary),
    Inspect(Inspect),
    Stats(StatsArgs),
    Verify(Verify),
}

/// Import a folder of GLB, glTF, VRM and FBX files, and of the peers' formats, into a corpus.
///
/// Rig texts are read with the OBJ beside them, and each asset of an npz, h5 or pt file of several.
///
/// A `manifest.json` in the folder adds licences and authors, a `split.json` says which asset is
/// trained on; without one, splits are made by skeleton topology, with equal assets in one split. Files that give no rig are listed
/// and left out; likely typing errors in either file are reported.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab dataset import models/ -o corpus.h5
  riglab dataset import mine/ -o mine.h5 --all-in test_new
  riglab eval runs/fsq_cvae/001 --set data.corpora='[\"mine.h5\"]' --out mine.json
  riglab dataset import scans/ -o meshes.h5 --meshes")]
struct Import {
    /// Folder of files, with those below it.
    folder: PathBuf,
    /// The corpus to write.
    #[arg(long, short, value_name = "FILE", value_parser = file_to_write())]
    out: PathBuf,
    /// JSON object of lists of file names by split [default: FOLDER/split.json if there is one].
    #[arg(long, value_name = "FILE", conflicts_with = "seed")]
    split: Option<PathBuf>,
    /// Put all assets into this split instead, as a test set of your own: test_new, say.
    #[arg(long, value_name = "SPLIT", value_parser = clap::builder::NonEmptyStringValueParser::new(), conflicts_with_all = ["split", "seed"])]
    all_in: Option<String>,
    /// Seed of the splits made without a split file [default: 0].
    #[arg(long)]
    seed: Option<u64>,
    /// What becomes of loose roots: reattach makes them children of the largest tree's root, virtual puts all below a new one.
    #[arg(long, value_enum, default_value = "reattach")]
    roots: Roots,
    /// Take models as bare meshes, rigged or not, OBJ, PLY and STL too: for GRPO, which needs no rigs. All are of the split
    /// `meshes`; train on them with --set data.train='["meshes"]'.
    #[arg(long, conflicts_with_all = ["split", "all_in", "seed", "roots", "clips", "repair"])]
    meshes: bool,
    /// With --meshes, the axis that points up in the files, where that is not y as in glTF: z in most scans and prints.
    #[arg(long, default_value = "y", value_name = "AXIS", requires = "meshes", allow_hyphen_values = true)]
    up: UpAxis,
    /// Take each of several characters in a file as an asset of its own.
    #[arg(long)]
    split_characters: bool,
    /// Keep the files' motions, sampled at so many frames a second [default rate: 30].
    #[arg(long, value_name = "RATE", num_args = 0..=1, default_missing_value = "30", value_parser = rate)]
    clips: Option<f32>,
    /// Make repairs that need a guess: joints of a rig text outside its tree become children of the root, `NAME_dup_K`
    /// joints of RigNet's predictions are merged back into NAME.
    #[arg(long)]
    repair: bool,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

fn rate(text: &str) -> Result<f32, String> {
    let rate = text.parse::<f32>().ok().filter(|r| (0.01..=1000.0).contains(r));
    rate.ok_or_else(|| match text.parse::<f32>() {
        Ok(_) => "a rate is between 0.01 and 1000 frames a second".into(),
        // The word after the option is taken for its rate.
        Err(_) => format!("it is no rate; write `{text} --clips`, or --clips=30"),
    })
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Roots {
    Reattach,
    Virtual,
}

/// Write the assets of several corpora to one.
///
/// Assets keep their splits unless --split or --seed splits them anew; equal ones come once, in the split of the first.
/// Each is compared with its digest while it is read: damage is not merged.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab dataset merge part-*.h5 -o all.h5 --seed 0
  riglab dataset merge rigs.h5 creatures.h5 -o mixed.h5 --prefix")]
struct Merge {
    /// The corpora.
    #[arg(required = true)]
    corpora: Vec<PathBuf>,
    /// The corpus to write.
    #[arg(long, short, value_name = "FILE", value_parser = file_to_write())]
    out: PathBuf,
    /// Put the name of its corpus before each asset's, with folders where corpora are named alike.
    #[arg(long)]
    prefix: bool,
    /// Split all assets by this file, as import does.
    #[arg(long, value_name = "FILE", conflicts_with = "seed")]
    split: Option<PathBuf>,
    /// Split all assets by topology, with this seed.
    #[arg(long)]
    seed: Option<u64>,
}

/// Write a corpus whose test rigs are posed, scaled and turned at random: UniRig's test sets with a star.
///
/// Any recipe of `configs/augment/` or of a file of one's own can vary them instead. Assets of other splits stay as
/// they are, so that a run can be evaluated on what is written: `riglab eval RUN --set data.corpora='["starred.h5"]'`.
/// Weights, names and motions come along; the same seed gives an asset the same draws, whatever else is in the corpus.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab dataset vary rigs.h5 -o starred.h5
  riglab dataset vary rigs.h5 -o noisy.h5 --recipe noise.toml --split test_new --seed 1")]
struct Vary {
    /// The corpus.
    corpus: PathBuf,
    /// The corpus to write.
    #[arg(long, short, value_name = "FILE", value_parser = file_to_write())]
    out: PathBuf,
    /// How: a TOML file with the keys of a recipe, as configs/augment/ has them, or one of those by its name.
    #[arg(long, value_name = "TOML", default_value = "augment/unirig_starred.toml")]
    recipe: String,
    /// Change a value of the recipe.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Vary the assets of this split, as often as needed [default: those whose name begins with `test`].
    #[arg(long = "split", value_name = "NAME")]
    splits: Vec<String>,
    /// Seed of the draws.
    #[arg(long, default_value_t = 0)]
    seed: u64,
}

/// List a corpus' assets, or show one.
#[derive(clap::Args)]
#[command(after_help = "Examples:\n  riglab dataset inspect corpus.h5\n  riglab dataset inspect corpus.h5 fox.glb")]
struct Inspect {
    /// The corpus.
    corpus: PathBuf,
    /// Show this asset.
    asset: Option<String>,
    /// One JSON object an asset.
    #[arg(long)]
    json: bool,
}

/// Statistics by split: the columns of SkinTokens' Table 1.
///
/// Means over assets: N vertices, tri triangles, J joints, W > 0 pairs of vertex and joint with a weight. Sparsity is the
/// share of all such pairs that hold one, in percent, as the paper prints it: few where skins are sparse. Bare assets are
/// meshes without a rig. The row `all` is of the whole corpus, and `none` of assets without a split; splits that are called so
/// themselves are `split all` and `split none`.
#[derive(clap::Args)]
#[command(after_help = "Example: riglab dataset stats corpus.h5 --json")]
struct StatsArgs {
    /// The corpus.
    corpus: PathBuf,
    /// Print as JSON.
    #[arg(long)]
    json: bool,
}

/// Read every asset and compare it with the digest it was written with.
#[derive(clap::Args)]
#[command(after_help = "Example: riglab dataset verify corpus.h5")]
struct Verify {
    /// The corpus.
    corpus: PathBuf,
}

/// How many assets are named that a mistyped name may mean.
const MEANT: usize = 3;

pub fn run(args: &Args) -> Result<ExitCode> {
    match &args.command {
        Command::Import(a) => run_import(a),
        Command::Merge(a) => run_merge(a),
        Command::Vary(a) => run_vary(a),
        Command::Inspect(a) => run_inspect(a),
        Command::Stats(a) => run_stats(a),
        Command::Verify(a) => run_verify(a),
    }
}

fn run_import(args: &Import) -> Result<ExitCode> {
    let beside = args.folder.join("split.json");
    let beside = (beside.is_file() && !args.meshes && args.all_in.is_none()).then_some(beside);
    let file = args.split.clone().or(beside);
    let splitter = match (&file, &args.all_in) {
        (Some(path), _) => Splitter::read(path)?,
        (None, Some(split)) => Splitter::All(split.clone()),
        (None, None) => Splitter::ByTopology(args.seed.unwrap_or(0)),
    };
    let usual = ["train", "val", "test_seen", "test_new"];
    if let Some(split) = args.all_in.as_ref().filter(|split| !usual.contains(&split.as_str())) {
        tell!("note: no experiment that comes with riglab reads a split `{split}`: name it in data.train or data.test");
    }
    if let (Some(list), None) = (&file, &args.split) {
        let seed = if args.seed.is_some() { "--seed has no effect on them, and " } else { "" };
        tell!("note: splits are those of {}; {seed}--split or --all-in gives others", list.display());
    }
    let roots = match args.roots {
        Roots::Reattach => RootPolicy::Reattach,
        Roots::Virtual => RootPolicy::Virtual,
    };
    let found = if args.meshes { models_below(&args.folder)? } else { rigged_below(&args.folder)? };
    if let Some(hidden) = found.left_aside() {
        tell!("note: {hidden}");
    }
    // A folder without any is no fault of rigged files.
    let models = if args.meshes { Vec::new() } else { models_below(&args.folder).map_or(Vec::new(), |all| all.files) };
    let rigged: HashSet<&PathBuf> = found.files.iter().collect();
    let models: Vec<PathBuf> = models.into_iter().filter(|path| !rigged.contains(path)).collect();
    // What rigged files have beside them is asked for where it may matter: it takes a look into each.
    let bare = if models.is_empty() { Vec::new() } else { bare_names(&args.folder, &found.files, models) };
    if !bare.is_empty() {
        let named = some_of(&bare);
        tell!("note: not imported, as their formats hold no rig: {named}; --meshes imports the meshes of a folder");
    }
    let progress = OfFiles::new("importing", found.files.len());
    let clips = args.clips.map(|rate| Resample { rate, ..Resample::default() });
    let (split, repair) = (args.split_characters, args.repair);
    let options = ImportOptions { roots, clips, split, repair, up: args.up, ..ImportOptions::default() };
    let tell = |done, of| progress.set(done, of);
    let before = Earlier::at(&args.out);
    let report = if args.meshes {
        import_meshes(&args.folder, &args.out, &options, &tell)?
    } else {
        import_folder(&args.folder, &args.out, &splitter, &options, &tell)?
    };
    progress.finish();
    before.tell_replaced(&args.out);
    report.warnings.iter().for_each(|warning| tell!("warning: {warning}"));
    if args.json {
        let refused: Vec<_> =
            report.refused.iter().map(|r| serde_json::json!({"file": r.name, "reason": r.reason})).collect();
        let notes: BTreeMap<_, _> = report.notes.iter().cloned().collect();
        let value = serde_json::json!({"imported": report.imported, "refused": refused, "notes": notes, "splits": report.splits,
            "clips": report.clips, "warnings": report.warnings});
        say!("{value}");
        return Ok(ExitCode::SUCCESS);
    }
    if let (Some(path), true) = (&file, report.splits.keys().all(String::is_empty)) {
        tell!(
            "warning: {} names none of the assets, so none has a split; it names files by their path below {}",
            path.display(),
            args.folder.display()
        );
    }
    for r in &report.refused {
        tell!("left out: {}", r.reason);
    }
    if args.clips.is_some() {
        tell!("{}", kept_motions(report.clips));
    }
    if !report.notes.is_empty() {
        tell!(
            "{} with notes (repairs, doubts); `{} NAME` shows them",
            counted(report.notes.len(), "file"),
            command(["dataset", "inspect", &shown(&args.out)])
        );
    }
    if let Some(next) = next(&args.out, report.splits.keys()) {
        tell!("next: {next}");
    }
    let splits: Vec<String> =
        report.splits.iter().map(|(name, n)| format!("{} {n}", if name.is_empty() { "none" } else { name })).collect();
    say!(
        "{}: {} ({}), {} left out",
        args.out.display(),
        counted(report.imported, "asset"),
        splits.join(", "),
        counted(report.refused.len(), "file")
    );
    Ok(ExitCode::SUCCESS)
}

/// The command that uses a new corpus of such splits: training on it, where there is something to validate on, or what is
/// trained already on its tests. Meshes wait for rigs beside them.
fn next<'a>(out: &Path, splits: impl IntoIterator<Item = &'a String>) -> Option<String> {
    let splits: BTreeSet<&str> = splits.into_iter().map(String::as_str).collect();
    let tests = || splits.iter().any(|split| split.starts_with("test"));
    match splits.contains("train") {
        true => splits.contains("val").then(|| train_on(out)),
        // Its figures beside those of the run's own corpora, not in their place.
        false => tests().then(|| command(["eval", "RUN", "--set", &as_corpora(out), "--out", "FILE.json"])),
    }
}

/// What --clips came to.
fn kept_motions(clips: usize) -> String {
    match clips {
        0 => "note: --clips: none of the files has a motion; they are read from GLB, glTF, VRM and FBX".into(),
        n => format!("{} kept", counted(n, "motion")),
    }
}

fn run_merge(args: &Merge) -> Result<ExitCode> {
    let splitter = match (&args.split, args.seed) {
        (Some(path), _) => Some(Splitter::read(path)?),
        (None, seed) => seed.map(Splitter::ByTopology),
    };
    let mut total = 0;
    for path in &args.corpora {
        total += Corpus::open(path)?.len();
    }
    let mut progress = Progress::new("merging", total as u64, 0);
    let before = Earlier::at(&args.out);
    let report = merge(&args.corpora, &args.out, args.prefix, splitter.as_ref(), |done| {
        progress.set(done as u64, String::new);
    })?;
    progress.finish();
    before.tell_replaced(&args.out);
    report.warnings.iter().for_each(|warning| tell!("warning: {warning}"));
    let lines = report.repeated.iter().map(|repeated| left_out(repeated, splitter.is_some()));
    some_lines(lines, "more are left out, each equal to another").iter().for_each(|line| tell!("{line}"));
    let (assets, repeated) = (counted(report.assets, "asset"), counted(report.repeated.len(), "repeated one"));
    say!("{}: {assets}, {repeated} left out", shown(&args.out));
    Ok(ExitCode::SUCCESS)
}

/// What is said of an asset that is equal to one before it. It is of that one's split, unless all are split anew.
fn left_out(Repeated { left_out, kept }: &Repeated, anew: bool) -> String {
    let split = |own: &Member| if own.split.is_empty() { "none".to_owned() } else { own.split.clone() };
    let of = |member: &Member| format!("`{}` of {}", member.name, shown(&member.corpus));
    let other = !anew && left_out.split != kept.split;
    let but = if other { format!(", in split {}, not {}", split(kept), split(left_out)) } else { String::new() };
    format!("left out: {} is equal to {}{but}", of(left_out), of(kept))
}

fn run_vary(args: &Vary) -> Result<ExitCode> {
    let config = crate::presets::load_block(&args.recipe, &args.sets)?.bounded()?;
    let recipe: Recipe = config.get()?;
    recipe.validate().map_err(|(key, message)| config.invalid(&key, message))?;
    let corpus = Corpus::open(&args.corpus)?;
    let known: BTreeSet<String> = corpus.texts("split")?.into_iter().collect();
    let wanted = |split: &str| match args.splits.is_empty() {
        true => split.starts_with("test"),
        false => args.splits.iter().any(|s| s == split),
    };
    let missing = args.splits.iter().find(|s| !known.contains(*s));
    if missing.is_some() || !known.iter().any(|s| wanted(s)) {
        let names: Vec<_> = known.iter().map(|s| format!("`{s}`")).collect();
        let what = missing.map_or("no split begins with `test`".into(), |s| format!("no split `{s}`"));
        anyhow::bail!("{}: {what}; it has {}: name one by --split", shown(&args.corpus), names.join(", "));
    }
    let total = corpus.len() as u64;
    drop(corpus);
    let mut varied = 0;
    let change = |asset: Asset, place: Place| {
        if !wanted(place.split) {
            return Ok(asset);
        }
        varied += 1;
        let mut asset = recipe.apply_to_asset(asset, args.seed, &[place.key]).map_err(|e| e.to_string())?;
        asset.provenance.notes.push(how_varied(args));
        Ok(asset)
    };
    let mut progress = Progress::new("varying", total, 0);
    let before = Earlier::at(&args.out);
    let written = rewrite(&args.corpus, &args.out, change, |done| progress.set(done as u64, String::new))?;
    progress.finish();
    before.tell_replaced(&args.out);
    say!("{}: {}, {varied} of them varied", shown(&args.out), counted(written, "asset"));
    Ok(ExitCode::SUCCESS)
}

/// What a varied asset keeps of the recipe.
fn how_varied(args: &Vary) -> String {
    let but = if args.sets.is_empty() { String::new() } else { format!(" ({})", args.sets.join(", ")) };
    format!("varied by {}{but} with seed {}", args.recipe, args.seed)
}

fn run_inspect(args: &Inspect) -> Result<ExitCode> {
    let corpus = Corpus::open(&args.corpus)?;
    let names = corpus.names()?.to_vec();
    let [splits, licences, categories] = ["split", "licence", "category"].map(|c| corpus.texts(c));
    let (splits, licences, categories) = (splits?, licences?, categories?);
    let bare: BTreeSet<usize> = corpus.bare()?.into_iter().collect();
    // A mesh without a rig is held by a joint that nobody made.
    let counts = |index: usize| match corpus.counts(index) {
        [v, f, ..] if bare.contains(&index) => [v, f, 0, 0],
        counts => counts,
    };
    if let Some(wanted) = &args.asset {
        let index = names.iter().position(|n| n == wanted);
        let index = index.with_context(|| format!("{}: {}", args.corpus.display(), no_asset(wanted, &names)))?;
        let asset = corpus.asset(index)?;
        let from = &asset.provenance;
        let ([v, f, j, w], bare) = (counts(index), bare.contains(&index));
        if args.json {
            let names: &[String] = if bare { &[] } else { asset.rig.skeleton().names() };
            let value = serde_json::json!({"name": asset.name, "split": splits[index], "vertices": v, "triangles": f, "joints": j, "bare": bare,
                "nonzero_weights": w, "source": from.source, "licence": from.licence, "author": from.author, "category": from.category,
                "checksum": from.checksum, "notes": from.notes, "joint_names": names,
                "humanoid": asset.rig.humanoid(), "springs": asset.rig.springs(), "clips": clips(&asset)});
            say!("{value}");
            return Ok(ExitCode::SUCCESS);
        }
        let triangles = counted(f, "triangle");
        let rig = if bare { "bare".into() } else { format!("{}, {}", counted(j, "joint"), counted(w, "weight")) };
        say!("{}  ({}, {triangles}, {rig}, split `{}`)", in_line(&asset.name), vertices(v), in_line(&splits[index]));
        for (key, value) in [
            ("source", &from.source),
            ("licence", &from.licence),
            ("author", &from.author),
            ("category", &from.category),
            ("checksum", &from.checksum),
        ] {
            say!("  {key:9} {}", in_line(value));
        }
        for line in crate::commands::inspect::body(&asset.rig) {
            say!("  {line}");
        }
        for clip in &asset.clips {
            let seconds = clip.frames() as f32 / clip.rate();
            say!("  clip      {} ({} frames, {seconds:.1} s)", in_line(clip.name()), clip.frames());
        }
        from.notes.iter().for_each(|n| say!("  note      {}", in_line(n)));
        return Ok(ExitCode::SUCCESS);
    }
    let width = names.iter().map(String::len).max().unwrap_or(0).min(60);
    for (i, name) in names.iter().enumerate() {
        let ([v, f, j, w], bare) = (counts(i), bare.contains(&i));
        if args.json {
            say!(
                "{}",
                serde_json::json!({"name": name, "split": splits[i], "vertices": v, "triangles": f, "joints": j, "bare": bare, "nonzero_weights": w, "licence": licences[i], "category": categories[i]})
            );
        } else {
            let joints = if bare { "bare".into() } else { format!("{j} j") };
            let [name, split, category, licence] = [name, &splits[i], &categories[i], &licences[i]].map(in_line);
            say!("{name:width$}  {split:10} {v:>7} v {f:>7} t {joints:>6}  {category:18} {licence}");
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// What is said of a name that no asset has: those that it is the end or the stem of are probably meant.
fn no_asset(wanted: &str, names: &[String]) -> String {
    let stem = |name: &str| Path::new(name).file_stem().map(|stem| stem.to_string_lossy().to_lowercase());
    let meant = stem(wanted);
    let near: Vec<String> =
        names.iter().filter(|name| meant.is_some() && stem(name) == meant).map(|name| format!("`{name}`")).collect();
    match &near[..] {
        [] => format!("no asset `{wanted}`; without a name all are listed"),
        near => format!("no asset `{wanted}`; did you mean {}?", near[..near.len().min(MEANT)].join(" or ")),
    }
}

fn clips(asset: &riglab_core::Asset) -> Vec<serde_json::Value> {
    let shown = |c: &riglab_core::Clip| serde_json::json!({"name": c.name(), "rate": c.rate(), "frames": c.frames()});
    asset.clips.iter().map(shown).collect()
}

fn run_stats(args: &StatsArgs) -> Result<ExitCode> {
    let corpus = Corpus::open(&args.corpus)?;
    let mut of: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for (i, split) in corpus.texts("split")?.into_iter().enumerate() {
        of.entry(row_of(split)).or_default().push(i);
    }
    let bare = corpus.bare()?;
    let mut rows: Vec<(String, Stats)> = of.into_iter().map(|(name, of)| (name, stats(&corpus, of, &bare))).collect();
    rows.push((ALL.into(), stats(&corpus, 0..corpus.len(), &bare)));
    if args.json {
        say!("{}", serde_json::to_string(&rows.into_iter().collect::<BTreeMap<_, _>>())?);
        return Ok(ExitCode::SUCCESS);
    }
    say!(
        "{:12} {:>7} {:>9} {:>9} {:>8} {:>10} {:>12} {:>7}",
        "split",
        "assets",
        "mean N",
        "mean tri",
        "mean J",
        "mean W > 0",
        "sparsity %",
        "bare"
    );
    let mean = |value: Option<f64>| value.map_or("–".into(), |v| format!("{v:.2}"));
    for (name, s) in rows {
        say!(
            "{name:12} {:>7} {:>9.2} {:>9.2} {:>8} {:>10} {:>12} {:>7}",
            s.assets,
            s.vertices,
            s.triangles,
            mean(s.joints),
            mean(s.active),
            mean(s.sparsity_percent),
            s.bare
        );
    }
    if !bare.is_empty() {
        say!("bare: meshes without a rig; joints and weights are means over the others");
    }
    Ok(ExitCode::SUCCESS)
}

/// The rows that are of no one split: of the whole corpus, and of assets without any.
const ALL: &str = "all";
const NONE: &str = "none";

/// What the row of a split is called.
fn row_of(split: String) -> String {
    match split.as_str() {
        "" => NONE.into(),
        ALL | NONE => format!("split {split}"),
        _ => split,
    }
}

fn run_verify(args: &Verify) -> Result<ExitCode> {
    let corpus = Corpus::open(&args.corpus)?;
    let names = corpus.names()?.to_vec();
    let mut progress = Progress::new("verifying", corpus.len() as u64, 0);
    let faults = corpus.verify(|done| progress.set(done as u64, String::new))?;
    progress.finish();
    for fault in &faults {
        tell!("damaged: {}: {}", names[fault.index], fault.message);
    }
    say!("{}: {}, {} damaged", shown(&args.corpus), counted(corpus.len(), "asset"), faults.len());
    Ok(if faults.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_comes_next_is_told_by_the_splits() {
        let of = |splits: &[&str]| {
            let splits: Vec<String> = splits.iter().map(|split| (*split).to_owned()).collect();
            next(Path::new("my rigs.h5"), &splits)
        };
        let train = r#"riglab train quickstart/fsq_cvae.toml --set 'data.corpora=["my rigs.h5"]'"#;
        assert_eq!(of(&["train", "val", "test_new"]).unwrap(), train);
        assert_eq!(
            of(&["test_new"]).unwrap(),
            r#"riglab eval RUN --set 'data.corpora=["my rigs.h5"]' --out FILE.json"#
        );
        // Training needs something to validate on.
        assert_eq!([of(&["meshes"]), of(&[""]), of(&["train", "test_new"])], [None, None, None]);
    }

    #[test]
    fn rows_of_splits_are_none_of_the_whole_corpus() {
        let rows = ["", "train", "all", "none"].map(|split| row_of(split.into()));
        assert_eq!(rows, ["none", "train", "split all", "split none"]);
    }

    #[test]
    fn what_a_merge_leaves_out_is_told_with_its_corpus_and_split() {
        let member =
            |corpus: &str, split: &str| Member { name: "fox.glb".into(), corpus: corpus.into(), split: split.into() };
        let said = |split: &str, anew| {
            left_out(&Repeated { left_out: member("b.h5", split), kept: member("a.h5", "train") }, anew)
        };
        let equal = "left out: `fox.glb` of b.h5 is equal to `fox.glb` of a.h5";
        assert_eq!([said("train", false), said("val", true)], [equal, equal]);
        assert_eq!(said("val", false), format!("{equal}, in split train, not val"));
        assert_eq!(said("", false), format!("{equal}, in split train, not none"));
    }

    #[test]
    fn a_folder_after_clips_is_no_rate() {
        assert_eq!((rate("24"), rate("0.01")), (Ok(24.0), Ok(0.01)));
        assert!(rate("0").unwrap_err().contains("between 0.01 and 1000"));
        assert!(rate("rigs/").unwrap_err().contains("write `rigs/ --clips`"));
    }

    #[test]
    fn names_without_folder_or_ending_are_told_in_full() {
        let names = ["animals/Fox.glb", "fox.fbx", "bear.glb"].map(String::from);
        assert_eq!(no_asset("fox", &names), "no asset `fox`; did you mean `animals/Fox.glb` or `fox.fbx`?");
        assert_eq!(no_asset("bear.gltf", &names), "no asset `bear.gltf`; did you mean `bear.glb`?");
        assert!(
            no_asset("cow", &names).ends_with("all are listed") && no_asset("", &names).ends_with("all are listed")
        );
    }

    #[test]
    fn motions_that_were_asked_for_are_counted() {
        assert!(kept_motions(0).contains("none of the files has a motion"));
        assert_eq!(kept_motions(2), "2 motions kept");
    }
}
