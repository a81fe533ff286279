//! `riglab eval`

use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, anyhow, bail, ensure};
use riglab_config::{Config, Difference, Loader};
use riglab_data::SplitNames;
use riglab_files::{Unfinished, make_folder_of};
use riglab_report::shell::command;
use riglab_report::{OwnCut, own_cut, own_cuts};
use riglab_sweep::hold_evaluation;
use riglab_task::Experiment;
use riglab_task::assets::{Assets, DataConfig};
use riglab_task::seen::{built_on, seen, warning};
use riglab_task::settings::places as places_of;
use riglab_train::{Checkpoint, Progress, RunInfo, named_by, other_companions, same_companions};

use super::device::DeviceArgs;
use super::earlier::{Written, keep_others};
use super::train::{other_data, reached, tell_untested, untested, whole};
use super::{file_to_write, shown};
use crate::presets;
use crate::registry::{TaskConfig, Visitor, pictures};

/// Evaluate a run's checkpoint on whole meshes of the test splits.
///
/// Prints the table; writes eval.json and pictures of the best and the worst into the run's folder.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab eval runs/fsq_cvae/001
  riglab eval runs/fsq_cvae/001 --checkpoint last --set eval.prefixes='[4, 32]' --json
  riglab eval runs/tokenrig/001 --set eval.consensus=16    # samples, as `riglab rig`")]
pub struct Args {
    /// The run's folder, or that of one of its checkpoints (RUN/checkpoints/last).
    run: PathBuf,
    /// Which checkpoint: best, last or step-N [default: best, or the one that is named].
    #[arg(long, value_name = "NAME")]
    checkpoint: Option<String>,
    /// Change a value of the run's config that says what is evaluated and how, such as data.* and eval.*.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Print eval.json instead of the table.
    #[arg(long)]
    json: bool,
    /// Where to write the result [default: RUN/eval.json]; pictures go into a folder beside it, named as FILE without
    /// .json (or FILE.pictures).
    #[arg(long, short, value_name = "FILE", value_parser = file_to_write())]
    out: Option<PathBuf>,
    /// How many best and how many worst assets of each split to show.
    #[arg(long, default_value_t = 2, value_name = "N")]
    pictures: usize,
    #[command(flatten)]
    device: DeviceArgs,
}

pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    super::alone("eval")?;
    let (run, named) = named_by(&args.run);
    if let Some(other) = args.checkpoint.as_ref().filter(|other| run != args.run && **other != named) {
        bail!("{} names a checkpoint and --checkpoint {other} another; give one of them", args.run.display());
    }
    let (path, folder) = places(args, &run)?;
    if run.is_file() {
        let file = run.display();
        bail!(
            "{file} is a file; a model that was exported is evaluated as a run's folder, which `{} FOLDER` makes of it",
            command(["checkpoint", "export", &shown(&run), "-o"])
        );
    }
    if !run.join("config.toml").is_file() {
        let (shown, below) = (run.display(), riglab_train::below(&run));
        bail!("{shown}: no run here (there is no config.toml){below}; `riglab train` makes one");
    }
    // Before anything that takes time: a sweep that looks at the run is to find it held.
    let _held = if is_own(&path, &run) { hold_evaluation(&run)? } else { None };
    riglab_torch::init(riglab_torch::Settings { threads });
    let device = args.device.device()?;
    let load = |sets: &[String]| presets::load(&run.join("config.toml").to_string_lossy(), sets);
    // What it names from the folder where it was begun is found from any other.
    let there = places_of(&run, &load(&[])?);
    let read = |sets: &[String]| TaskConfig::read(&load(&[&there, sets].concat())?);
    let sets = with_their_weights(&args.sets);
    let name = args.checkpoint.as_ref().unwrap_or(&named);
    let checkpoint = Checkpoint::open(&run.join("checkpoints").join(name))?;
    let config = read(&with_its_cut((&run, &checkpoint), sets, &read)?)?;
    let own = read(&[])?;
    fits(&own, &config)?;
    let config = config.of_run(&run);
    if config.data().corpora == own.data().corpora {
        let again = || {
            let sets = args.sets.iter().flat_map(|set| ["--set".into(), set.clone()]);
            ["eval".into(), whole(&args.run)].into_iter().chain(sets).collect()
        };
        reached(&run, &config, again, ", or say where it is now: --set data.corpora=...")?;
    }
    // There is such a run.
    try_writing(&path)?;
    if own.data().corpora.is_empty() {
        tell!(
            "note: whether these assets were trained on is not known: the model names no corpora; {} may say what it learned \
             from",
            run.join("card.md").display()
        );
    }
    let seen = trained_on(&config, &own)?;
    let data = config.data();
    if let Some(split) = data.test.iter().find(|split| data.train.contains(split)) {
        tell!(
            "warning: `{split}` is both in data.train and in data.test: baselines from training assets, such as retrieval, \
             take its other assets"
        );
    }
    let data = config.data().clone();
    config.with(device, Examination { args, run, checkpoint, data, seen, path, folder })
}

/// The names of the assets to evaluate that the model was trained on, or one that it builds on, which `config` says where it
/// is now; tells of them.
fn trained_on(config: &TaskConfig, own: &TaskConfig) -> Result<Vec<String>> {
    let (data, mut all, mut known) = (config.data(), Vec::new(), HashSet::new());
    let trainings = std::iter::once((None, own.training()));
    let before = built_on(&config.to_toml()?).into_iter().map(|(key, trained)| (Some(key), trained));
    for (by, trained) in trainings.chain(before) {
        match seen(data, &data.test, &trained) {
            Ok(seen) => {
                if let Some(warning) = warning(&seen, by) {
                    tell!("warning: {warning}");
                }
                all.extend(seen.names.into_iter().filter(|name| known.insert(name.clone())));
            }
            // Corpora may be gone or moved: no fault of an evaluation on others.
            Err(e) => {
                let by = by.map_or(String::new(), |key| format!(" by what {key} names"));
                tell!("note: whether these assets were trained on{by} is not known: {e}");
            }
        }
    }
    Ok(all)
}

/// Refuses settings that no evaluation of a run can have.
pub fn fits(own: &TaskConfig, config: &TaskConfig) -> Result<()> {
    trained_so(own, config)?;
    ensure!(
        !config.data().test.is_empty(),
        "data.test names no split to evaluate; give one: --set data.test='[\"test_new\"]'"
    );
    Ok(())
}

/// Settings with those that follow: weights of the training's corpora say nothing of others.
pub fn with_their_weights(sets: &[String]) -> Vec<String> {
    let mut all = sets.to_vec();
    if sets_key(sets, "data.corpora") && !sets_key(sets, "data.weights") {
        all.push("data.weights=[]".into());
    }
    all
}

/// Settings with the cut of the decode rule that the run's own evaluation chose for this checkpoint, where these corpora have
/// nothing to choose one by.
fn with_its_cut(
    (run, checkpoint): (&Path, &Checkpoint),
    mut sets: Vec<String>,
    read: &impl Fn(&[String]) -> Result<TaskConfig>,
) -> Result<Vec<String>> {
    let config = read(&sets)?.of_run(run);
    if !config.chooses_a_cut() || sets_key(&sets, "eval.cuts") || !sets_key(&sets, "data.corpora") {
        return Ok(sets);
    }
    // What is wrong with the corpora is told where they are opened for good.
    let none = Assets::open(&config.data().corpora)
        .is_ok_and(|assets| assets.split(&config.data().validate).is_ok_and(|validation| validation.is_empty()));
    let own = own_cut(run, checkpoint.state().step).map(|own| own.cut);
    if let (true, Some(cut)) = (none, own) {
        tell!(
            "note: these corpora have no asset to choose a cut by (eval.cuts); {cut:.4} is taken from {}",
            run.join("eval.json").display()
        );
        sets.push(format!("eval.cuts=[{cut}]"));
    }
    Ok(sets)
}

/// What is said where the run's own evaluation, which is there, was of other corpora.
fn replaced(path: &Path, corpora: &[(String, String, usize)]) -> Option<String> {
    let text = fs::read_to_string(path).ok()?;
    let before: serde_json::Value = serde_json::from_str(&text).ok()?;
    let word = |of: &serde_json::Value, k: usize| of[k].as_str().map(String::from);
    let before: Option<Vec<(String, String)>> =
        before["data"].as_array()?.iter().map(|of| Some((word(of, 0)?, word(of, 1)?))).collect();
    let before = before.filter(|of| !of.is_empty())?;
    let same = before.iter().map(|(_, sum)| sum).eq(corpora.iter().map(|(_, sum, _)| sum));
    let names = || before.iter().map(|(name, _)| name.as_str()).collect::<Vec<_>>().join(", ");
    (!same).then(|| format!("the evaluation on {} is replaced; --out FILE keeps both", names()))
}

/// Whether a setting of this key is given, by its path or in a table of several.
pub fn sets_key(sets: &[String], key: &str) -> bool {
    sets.iter().any(|set| match Loader::new().parse("--set", "", &[set]) {
        Ok(own) => own.leaves().iter().any(|leaf| leaf.path == key),
        // One that takes a building block, say.
        Err(_) => set.split('=').next().is_some_and(|k| k.trim() == key),
    })
}

/// Settings by which a network was made or trained: other ones are another network, or mean nothing here.
const OF_TRAINING: [&str; 26] = [
    "task",
    "model",
    "train",
    "loss",
    "tokenizer",
    "objective",
    "guard",
    "augment",
    "recipe",
    "data.up",
    "skin.codes",
    "skin.empty",
    "sampling.told",
    // What batches of a training are made of.
    "sampling.rigs",
    "sampling.bones",
    "sampling.class_dropout",
    "sampling.variants",
    "sampling.decoder",
    "sampling.prefix",
    "sampling.code_noise",
    "sampling.frame_noise",
    "sampling.bone_power",
    "sampling.queries",
    "sampling.pairs",
    "sampling.pool",
    "sampling.merge",
];

/// Refuses settings of an evaluation that are the training's.
fn trained_so(own: &TaskConfig, config: &TaskConfig) -> Result<()> {
    let read = |config: &TaskConfig| Ok::<_, anyhow::Error>(Config::from_toml_str("config", &config.to_toml()?)?);
    let of_training = |path: &str| {
        OF_TRAINING.iter().any(|key| path.strip_prefix(key).is_some_and(|r| r.is_empty() || r.starts_with('.')))
    };
    match read(own)?.diff(&read(config)?).into_iter().find(|d| of_training(&d.path)) {
        Some(Difference { path, before, after }) => {
            let shown = |value: Option<String>| value.unwrap_or_else(|| "nothing".into());
            bail!(
                "--set {path}={}: the run was trained with {}, which an evaluation cannot change; data.* and eval.* say what \
                 is evaluated, and how",
                shown(after),
                shown(before)
            )
        }
        None => Ok(()),
    }
}

/// Where the numbers go, and the folder of the pictures.
///
/// # Errors
/// Where something else is in their place: told before the work, not after it.
fn places(args: &Args, run: &Path) -> Result<(PathBuf, PathBuf)> {
    let path = args.out.clone().unwrap_or_else(|| run.join("eval.json"));
    let folder = pictures(&path);
    if path.is_dir() {
        bail!("{} is a folder; give --out a file", path.display());
    }
    if args.pictures > 0 && folder.exists() && !folder.is_dir() {
        bail!(
            "{} is a file, where the pictures' folder is to be; give another --out, or --pictures 0",
            folder.display()
        );
    }
    // The run's own is replaced, whatever has become of it.
    if !is_own(&path, run) {
        keep_others(&path, Written::Evaluation)?;
    }
    Ok((path, folder))
}

/// Whether a path is that of the run's own evaluation, however it is written.
fn is_own(path: &Path, run: &Path) -> bool {
    let whole = |folder: &Path| match folder.as_os_str().is_empty() {
        true => Path::new(".").canonicalize().ok(),
        false => folder.canonicalize().ok(),
    };
    let folder = path.parent().and_then(whole);
    path.file_name().is_some_and(|name| name == "eval.json") && folder.is_some() && folder == whole(run)
}

/// Tries whether a file can be written: before the work, not after it.
fn try_writing(path: &Path) -> Result<()> {
    // One that is not finished goes away by itself.
    let tried = make_folder_of(path).and_then(|()| Unfinished::beside(path));
    tried.with_context(|| format!("{} cannot be written; give another --out", path.display()))?;
    Ok(())
}

/// An evaluation of a run's checkpoint.
struct Examination<'a> {
    args: &'a Args,
    run: PathBuf,
    checkpoint: Checkpoint,
    data: DataConfig,
    /// Assets that were trained on.
    seen: Vec<String>,
    path: PathBuf,
    folder: PathBuf,
}

impl Visitor for Examination<'_> {
    type Out = ExitCode;

    fn visit<T: Experiment>(self, task: T) -> Result<ExitCode> {
        let Self { args, run, checkpoint, data, seen, path, folder } = self;
        checkpoint.load_weights(task.params())?;
        let (companions, begun) = RunInfo::read(&run)?.map_or_else(Default::default, |i| (i.companions, i.data));
        if !sets_key(&args.sets, "data.corpora")
            && let Some(other) = other_data(&begun, &task.assets().summary()?)
        {
            tell!("warning: {other}: results on other corpora are not comparable with this run's");
        }
        task.warnings().iter().for_each(|warning| tell!("warning: {warning}"));
        // Others that were asked for are meant: that they are others is told with the figures.
        let now = task.companions();
        let (named, same): (Vec<_>, Vec<_>) = companions.into_iter().partition(|(key, _)| sets_key(&args.sets, key));
        let others: Vec<String> = other_companions(&named, &now).into_iter().map(other_model).collect();
        others.iter().for_each(|sentence| tell!("warning: {sentence}"));
        same_companions(&same, &now).map_err(|e| anyhow!(e)).with_context(|| run.display().to_string())?;
        let without = untested(&data, task.assets())?;
        if let Some(note) = tell_untested(&without, task.assets())? {
            ensure!(without.len() < data.test.len(), note);
            // Corpora of one's own need not have each of the usual ones.
            let usual = without.iter().all(|split| SplitNames::KNOWN.contains(&split.as_str()));
            tell!("{}: {note}", if usual { "note" } else { "warning" });
        }
        let total = task.examination_steps().map_err(|e| anyhow!(e))? as u64;
        let mut progress = Progress::new("evaluating", total, 0);
        let weights = task.params().weights();
        let examined = task.examine(weights, checkpoint.state(), args.pictures, &mut |done| {
            progress.set(done as u64, String::new);
        });
        progress.finish();
        let examined = examined.map_err(|e| anyhow!(e))?;
        if let Some(note) = replaced(&path, &task.assets().summary()?) {
            tell!("note: {}: {note}", path.display());
        }
        let lists = [("set", args.sets.as_slice()), ("trained_on", &seen), ("other_models", &others)];
        // This one may choose anew for its own checkpoint.
        let (step, anew) = (checkpoint.state().step, args.sets.is_empty());
        let mut kept = own_cuts(&run);
        kept.retain(|own| own.step != step || !anew);
        let json = with_data(&examined.json, &looked_at(task.assets(), &data)?, &lists, &kept)?;
        // The numbers first: they took longest.
        write(&path, json.as_bytes())?;
        let draw = || -> Result<()> {
            for (file, png) in &examined.pictures {
                fs::create_dir_all(&folder).with_context(|| format!("{} cannot be made", folder.display()))?;
                write(&folder.join(file), png)?;
            }
            Ok(())
        };
        let drawn = draw();
        if args.json {
            say!("{}", json.trim_end());
        } else {
            examined.text.iter().for_each(|line| say!("{line}"));
            match is_own(&path, &run) {
                true => tell!("next: {}", command(["report", &shown(&run)])),
                // A report is of the run's own alone.
                false => {
                    let report = ["report", &shown(&run), "--eval", &shown(&path), "-o"];
                    tell!("next: {} REPORT", command(report));
                }
            }
        }
        drawn?;
        Ok(ExitCode::SUCCESS)
    }
}

/// A corpus of an evaluation: path, checksum, number of assets, and how many of these were looked at.
type LookedAt = (String, String, usize, usize);

/// The corpora, with the number of assets that are tested on or chosen by: an evaluation of a run that trains on more corpora,
/// such as bare meshes, is of the same assets.
fn looked_at(assets: &Assets, data: &DataConfig) -> Result<Vec<LookedAt>> {
    let splits: Vec<&str> = data.test.iter().chain([&data.validate]).map(String::as_str).collect();
    let corpora = assets.summary()?.into_iter().zip(assets.in_splits(&splits)?);
    Ok(corpora.map(|((path, sum, all), count)| (path, sum, all, count)).collect())
}

/// What is said of a model that a setting names in the place of another: the key, and what tells both.
fn other_model((key, now, then): (&str, &str, &str)) -> String {
    format!(
        "{key} names another model ({now}) than the run was trained with ({then}): the figures are of both together"
    )
}

/// An evaluation's file with the corpora it is of; and by name, where they have something, the lists of the settings that
/// are not the run's, of the assets that were trained on, and of what is said of other models; and the cuts that the run's own
/// assets have chosen, where these or the checkpoint are others.
fn with_data(json: &str, data: &[LookedAt], lists: &[(&str, &[String])], kept: &[OwnCut]) -> Result<String> {
    let Some(rest) = json.strip_prefix("{\n") else { bail!("the task's evaluation is no object over several lines") };
    let named = |name: &str, of: &[String]| match of {
        [] => Ok(String::new()),
        some => serde_json::to_string(some).map(|list| format!("  \"{name}\": {list},\n")),
    };
    let lists = lists.iter().map(|(name, of)| named(name, of)).collect::<Result<String, _>>()?;
    let kept = match kept {
        [] => String::new(),
        some => format!("  \"own_cuts\": {},\n", serde_json::to_string(some)?),
    };
    Ok(format!("{{\n  \"data\": {},\n{lists}{kept}{rest}", serde_json::to_string(data)?))
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    riglab_files::write(path, bytes).with_context(|| format!("{} cannot be written", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_evaluation_with_another_model_says_so_in_its_file() {
        let said = other_model(("start.model", "ab", "cd"));
        assert!(said.starts_with("start.model names another model (ab) than the run was trained with (cd)"), "{said}");
        let json = with_data(
            "{\n  \"report\": 1\n}\n",
            &[],
            &[("set", &[]), ("other_models", std::slice::from_ref(&said))],
            &[OwnCut { step: 5, cut: 0.25 }, OwnCut { step: 8, cut: 0.5 }],
        )
        .unwrap();
        let read: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert!(read["other_models"][0] == said && read["report"] == 1 && read["set"].is_null(), "{json}");
        assert_eq!(read["own_cuts"][1], serde_json::json!({"step": 8, "cut": 0.5}));
    }

    #[test]
    fn settings_are_known_by_path_and_in_tables_and_those_of_training_stay() {
        let sets = |text: &str| [text.to_owned()];
        assert!(sets_key(&sets("data.corpora=['a.h5']"), "data.corpora"));
        assert!(sets_key(&sets("data={corpora=['a.h5'], weights=[]}"), "data.corpora"));
        assert!(!sets_key(&sets("data.corporas=1"), "data.corpora") && !sets_key(&sets("data={}"), "data.corpora"));
        assert!(
            sets_key(&sets("model={extends='model/tokenrig/tiny.toml'}"), "model"),
            "what a block holds is not asked"
        );
        let read = |set: &[&str]| {
            let set: Vec<String> = set.iter().map(|s| (*s).to_owned()).collect();
            TaskConfig::read(&presets::load("quickstart/tokenrig.toml", &set).unwrap()).unwrap()
        };
        for set in ["skin.empty=false", "skin.codes=3", "tokenizer.bins=64", "sampling.class_dropout=0.25"] {
            assert!(trained_so(&read(&[]), &read(&[set])).unwrap_err().to_string().contains(set), "{set}");
        }
        trained_so(&read(&[]), &read(&["eval.skins=1"])).unwrap();
    }

    #[test]
    fn the_runs_own_evaluation_is_known_however_it_is_written() {
        let dir = tempfile::tempdir().unwrap();
        let run = dir.path().join("run");
        fs::create_dir_all(run.join("checkpoints")).unwrap();
        assert!(is_own(&run.join("eval.json"), &run) && is_own(&run.join("checkpoints/../eval.json"), &run));
        for other in ["run/other.json", "eval.json", "run/checkpoints/eval.json", "nowhere/eval.json"] {
            assert!(!is_own(&dir.path().join(other), &run), "{other}");
        }
    }
}
