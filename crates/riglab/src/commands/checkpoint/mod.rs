//! `riglab checkpoint`

mod import;
mod planted;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, anyhow, bail};
use riglab_asset::export::same_file;
use riglab_files::{is_as_of_folder, make_folder_of};
use riglab_task::assets::{DataConfig, Up};
use riglab_task::bundle::{Bundle, RIG, SKIN, Stored};
use riglab_task::fsq_cvae::{Frozen, FsqCvaeTaskConfig};
use riglab_task::grpo::{GrpoTask, GrpoTaskConfig};
use riglab_task::released::Imported;
use riglab_task::settings::{MODELS, Settings, TaskSettings};
use riglab_task::tokenrig::{Card, Rigger, TokenRigTaskConfig};
use riglab_task::unirig_skeleton::Sketcher;
use riglab_task::unirig_skin::{SkinTaskConfig, Skinner};
use riglab_train::{Checkpoint, Spinner, StartConfig, TrainConfig, named_by};
use tch::{Device, Kind};

use super::earlier::{Written, keep_others};
use super::place_to_write;
use riglab_report::counted;
use riglab_report::shell::command;

/// Trained models as single files: make one, look at one, take over what others published.
#[derive(clap::Args)]
pub struct Args {
    #[command(subcommand)]
    what: What,
}

#[derive(clap::Subcommand)]
enum What {
    Export(ExportArgs),
    Import(import::ImportArgs),
    Show(ShowArgs),
}

/// Export a run's checkpoint with its auto-encoder and settings: as one file for `riglab rig` (one of UniRig's stages: for
/// `riglab rig` and `riglab skin`; an auto-encoder: for `skin.run`), or as a new run's folder, for `riglab eval`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab checkpoint export runs/tokenrig/001 -o model.safetensors
  riglab checkpoint export runs/tokenrig/001 -o model.safetensors --half --name ours --card card.md

An auto-encoder, to train with --set skin.run=auto.safetensors:
  riglab checkpoint export runs/fsq_cvae/001 -o auto.safetensors

The model that comes with riglab, to be evaluated:
  riglab checkpoint export -o runs/small
  riglab eval runs/small --set data.corpora='[\"corpus.h5\"]'")]
struct ExportArgs {
    /// The folder of a run, or a file of a model that rigs, of one of UniRig's stages or of an auto-encoder [default: the
    /// model that comes with riglab].
    run: Option<PathBuf>,
    /// What to write: a file (.safetensors), or a new folder of a run for `riglab eval`.
    #[arg(long, short, value_name = "OUT", value_parser = place_to_write())]
    out: PathBuf,
    /// Which checkpoint of the run: best, last or step-N [default: best].
    #[arg(long)]
    checkpoint: Option<String>,
    /// Numbers of 16 bits: half the size.
    #[arg(long)]
    half: bool,
    /// The model's name in the file [default: that of the source file, or the run's folder: a number gets the name of the
    /// folder above it before it, as tokenrig-001].
    #[arg(long)]
    name: Option<String>,
    /// Of a run: where a model lies now that it builds on, as start.model=PATH or skin.run=PATH. One of other weights than
    /// those of the training is refused.
    #[arg(long = "set", value_name = "KEY=PATH")]
    sets: Vec<String>,
    /// Markdown that says what it learned from, how good it is, and its licence [default: what the model has].
    #[arg(long, value_name = "FILE")]
    card: Option<PathBuf>,
}

/// Show what is known about a model: its card, sizes and limits.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab checkpoint show
  riglab checkpoint show model.safetensors")]
struct ShowArgs {
    /// A file of `riglab checkpoint export` or `import`, or a run's folder [default: the model that comes with riglab].
    file: Option<PathBuf>,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    riglab_torch::init(riglab_torch::Settings { threads: 1 });
    match &args.what {
        What::Export(args) => export(args),
        What::Import(args) => import::import(args),
        What::Show(args) => show(args),
    }
}

fn export(args: &ExportArgs) -> Result<ExitCode> {
    let folder = ready(&args.out, [args.run.as_deref(), args.card.as_deref()])?;
    if folder {
        let file = args.out.with_extension("safetensors");
        if args.half {
            bail!("--half is for files; a run's folder holds numbers of 32 bits (--out {})", file.display());
        }
        if args.name.is_some() {
            bail!("--name is for files; a run is called by its folder (--out {})", file.display());
        }
    }
    let folder_of = args.run.as_ref().filter(|run| !run.is_file()).map(|run| named_by(run));
    if let (Some((run, named)), Some(other)) = (&folder_of, &args.checkpoint)
        && args.run.as_ref() != Some(run)
        && other != named
    {
        bail!(
            "{} names a checkpoint and --checkpoint {other} another; give one of them",
            args.run.as_deref().unwrap_or(run).display()
        );
    }
    let run = folder_of.as_ref().map(|(run, _)| run);
    if let (None, Some(checkpoint)) = (run, &args.checkpoint) {
        bail!("--checkpoint {checkpoint} is for runs' folders; a file holds one checkpoint");
    }
    if let (None, Some(set)) = (run, args.sets.first()) {
        bail!("--set {set} is for runs' folders; a file has its settings");
    }
    if let Some(set) = args.sets.iter().find(|set| !MODELS.iter().any(|key| set.trim_start().starts_with(key))) {
        bail!(
            "--set {set}: a model is exported as it was trained; only start.model and skin.run can be given, of models that were moved"
        );
    }
    let of_run = args.checkpoint.as_deref().or(folder_of.as_ref().map(|(_, named)| named.as_str())).unwrap_or("best");
    let reading = args.run.as_ref().map(|path| Spinner::new(&format!("reading {}", path.display())));
    let opened = match (&args.run, run) {
        (_, Some(run)) => of_folder(run, of_run, &args.sets),
        (Some(file), None) => of_file(file),
        (None, None) => Rigger::shipped(Device::Cpu).map(rigs),
    };
    drop(reading);
    let (model, found) = opened.map_err(|e| anyhow!(e))?;
    let read =
        |path: &Path| std::fs::read_to_string(path).with_context(|| format!("{} cannot be read", path.display()));
    let text = match &args.card {
        Some(path) => read(path)?,
        None => found.text,
    };
    // A folder's path is of use on one machine only.
    let own = run.and_then(|run| called(run)).unwrap_or(found.name);
    // One of nothing is none: who reads the file is told where a model has no card.
    let text = if text.trim().is_empty() { String::new() } else { text };
    let mut card = Card { name: args.name.clone().unwrap_or(own), text, state: found.state };
    if folder {
        // Of a policy that rewards refined, what evaluates it is the task that it was.
        card.state.task = model.task().into();
        planted::folder(&args.out, &model, &card, "exported")?;
        say!("{}", args.out.display());
        tell!("next: {} --set data.corpora='[\"CORPUS.h5\"]'", command(["eval", &args.out.to_string_lossy()]));
        return Ok(ExitCode::SUCCESS);
    }
    let kind = if args.half { Kind::Half } else { Kind::Float };
    write(&args.out, &model.bundle(&card).map_err(|e| anyhow!(e))?, kind)?;
    Ok(ExitCode::SUCCESS)
}

/// Writes a model's file, numbers as `kind`.
fn write(out: &Path, bundle: &Bundle, kind: Kind) -> Result<()> {
    make_folder_of(out)?;
    let writing = Spinner::new(&format!("writing {}", out.display()));
    let written = riglab_files::write_with(out, |file| bundle.write_to(file, kind));
    drop(writing);
    written.with_context(|| format!("{} cannot be written", out.display()))?;
    say!("{}: {:.1} MB", out.display(), out.metadata()?.len() as f64 / 1e6);
    Ok(())
}

fn rigs((rigger, card): (Rigger, Card)) -> (Imported, Card) {
    (Imported::TokenRig(Box::new(rigger)), card)
}

/// Takes away where a model learned from, which is of no use elsewhere, and says more of a machine than it should.
fn anywhere(data: &mut DataConfig, train: &mut TrainConfig) {
    (data.corpora, data.weights) = (Vec::new(), Vec::new());
    train.start = StartConfig::default();
}

/// One of UniRig's stages, at a run's checkpoint or in a file; `None` where it is another model.
fn stage(at: &Path, sets: &[String]) -> Result<Option<(Imported, Card)>, String> {
    if let Some((sketcher, card)) = Sketcher::open_with(at, sets, Device::Cpu)? {
        let (mut config, params) = sketcher.into_parts();
        anywhere(&mut config.data, &mut config.train);
        return Ok(Some((Imported::Skeleton(Box::new(config), params), card)));
    }
    let Some((skinner, card)) = Skinner::open(at, Device::Cpu)? else { return Ok(None) };
    let (mut config, params) = skinner.into_parts();
    anywhere(&mut config.data, &mut config.train);
    Ok(Some((Imported::Skin(Box::new(config), params), card)))
}

/// The model of a file.
fn of_file(file: &Path) -> Result<(Imported, Card), String> {
    if let Some(found) = stage(file, &[])? {
        return Ok(found);
    }
    let stored = Stored::open(file)?;
    if stored.kind != FsqCvaeTaskConfig::TASK {
        return Rigger::open(file, Device::Cpu).map(rigs);
    }
    Ok(auto_encoder(Frozen::open(file, Device::Cpu)?, stored.card))
}

fn auto_encoder(auto: Frozen, card: Card) -> (Imported, Card) {
    let (mut config, params) = auto.into_parts();
    anywhere(&mut config.data, &mut config.train);
    (Imported::FsqCvae(Box::new(config), params), card)
}

/// The model of a run.
fn of_folder(run: &Path, checkpoint: &str, sets: &[String]) -> Result<(Imported, Card), String> {
    if let Some(set) = sets.first() {
        let settings = Settings::of_run(run)?;
        if settings.are::<FsqCvaeTaskConfig>() || settings.are::<SkinTaskConfig>() {
            return Err(format!("--set {set}: a run of task `{}` builds on no other model", settings.task()));
        }
    }
    if let Some(found) = stage(&run.join("checkpoints").join(checkpoint), sets)? {
        return Ok(found);
    }
    if !Settings::of_run(run)?.are::<FsqCvaeTaskConfig>() {
        return Rigger::of_run_with(run, checkpoint, sets, Device::Cpu).map(rigs);
    }
    let (auto, state) = Frozen::of_run(run, checkpoint, Device::Cpu)?;
    Ok(auto_encoder(auto, Card { name: String::new(), state, text: known(run) }))
}

/// The card that lies in a run's folder; none where it was trained there.
fn known(run: &Path) -> String {
    std::fs::read_to_string(run.join("card.md")).unwrap_or_default()
}

/// A card's text, or that there is none.
fn written(text: String) -> String {
    if text.trim().is_empty() { "No card was written for this model.".into() } else { text }
}

/// Whether a model goes into a run's folder there, and not into a file.
fn into_folder(out: &Path) -> Result<bool> {
    match out.extension() {
        None => Ok(true),
        Some(_) if is_as_of_folder(out) => Ok(true),
        Some(ending) if ending.eq_ignore_ascii_case("safetensors") => Ok(false),
        Some(_) if out.is_dir() => Ok(true),
        Some(_) => bail!(
            "{}: a model's file ends in .safetensors, and the name of a run's folder has no ending",
            out.display()
        ),
    }
}

/// Refuses a place where a model cannot be written, before it is read, and that of a file that is read; whether it is that of a
/// run's folder.
fn ready<'a>(out: &Path, read: impl IntoIterator<Item = Option<&'a Path>>) -> Result<bool> {
    let folder = into_folder(out)?;
    if read.into_iter().flatten().any(|file| file.is_file() && same_file(file, out)) {
        bail!("{} is the input itself, which is never changed; give another name", out.display());
    }
    keep_others(out, Written::Model)?;
    if folder {
        planted::free(out)?;
    }
    let above = out.parent().unwrap_or(out);
    riglab_files::may_write(above)
        .map_err(|e| anyhow!("nothing can be written into {e}; give --out a place where you may write"))?;
    Ok(folder)
}

fn show(args: &ShowArgs) -> Result<ExitCode> {
    let found = match args.file.as_deref() {
        Some(file) if file.is_file() => of_stored(file)?,
        Some(run) => match part_of_run(run)? {
            Some(part) => Known::Part(part),
            None => Known::of_rigger(Rigger::open(run, Device::Cpu))?,
        },
        None => Known::of_rigger(Rigger::shipped(Device::Cpu))?,
    };
    let millions = |n: usize| n as f64 / 1e6;
    let (card, limits) = match found {
        Known::Part(Part { kind, card, numbers, up }) => {
            say!("{}", card.name);
            say!("{:.2} M parameters, of task {kind}: {}", millions(numbers), use_of(&kind));
            if let Some(up) = up {
                say!("skin.run takes it in training with data.up = \"{up}\"");
            }
            (card, String::new())
        }
        Known::Whole { card, config, own, skin } => {
            say!("{}", card.name);
            say!("{:.2} M parameters, and {:.2} M of its auto-encoder", millions(own), millions(skin));
            let codes = counted(config.skin.codes, "code");
            (card, format!(", up to {} joints, {codes} a bone", config.limits.joints))
        }
    };
    say!("{}{limits}", counted(card.state.step as usize, "step"));
    say!("\n{}", written(card.text).trim_end());
    Ok(ExitCode::SUCCESS)
}

/// What is known about a model.
enum Known {
    Part(Part),
    /// One that rigs, with the numbers of its own network and of its auto-encoder.
    Whole {
        card: Card,
        config: Box<TokenRigTaskConfig>,
        own: usize,
        skin: usize,
    },
}

impl Known {
    fn of_rigger(opened: Result<(Rigger, Card), String>) -> Result<Self> {
        let (rigger, card) = opened.map_err(|e| anyhow!(e))?;
        let skin = rigger.vae().tensors().iter().map(|(_, t)| t.numel()).sum();
        Ok(Self::Whole { card, config: Box::new(rigger.config().clone()), own: rigger.params().numel(), skin })
    }
}

/// What the head of a file says, however large the rest is.
fn of_stored(file: &Path) -> Result<Known> {
    let stored = Stored::open(file).map_err(|e| anyhow!(e))?;
    if stored.kind != TokenRigTaskConfig::TASK {
        let numbers = stored.numbers("");
        let up = axis_of(&stored);
        return Ok(Known::Part(Part { kind: stored.kind, card: stored.card, numbers, up }));
    }
    let settings = Settings::of_text(&file.display().to_string(), &stored.settings);
    let config = Box::new(settings.and_then(|settings| settings.get()).map_err(|e| anyhow!(e))?);
    Ok(Known::Whole { own: stored.numbers(RIG), skin: stored.numbers(SKIN), card: stored.card, config })
}

/// A model that makes no rigs.
struct Part {
    kind: String,
    card: Card,
    numbers: usize,
    /// Of an auto-encoder, the axis that is up in what it sees.
    up: Option<Up>,
}

/// The axis that is up in what an auto-encoder sees; `None` of other models, or where its settings cannot be understood.
fn axis_of(stored: &Stored) -> Option<Up> {
    let is_one = stored.kind == FsqCvaeTaskConfig::TASK;
    axis(&Settings::of_text(&stored.kind, &stored.settings).ok().filter(|_| is_one)?)
}

/// As [`axis_of`], by the settings of an auto-encoder.
fn axis(settings: &Settings) -> Option<Up> {
    settings.get::<FsqCvaeTaskConfig>().ok().map(|config| config.data.up)
}

/// What it is for.
fn use_of(kind: &str) -> &'static str {
    match kind {
        "unirig_skin" => "it makes weights for given skeletons",
        "unirig_skeleton" | "grpo" => "it makes skeletons, without weights",
        _ => "a part, which makes no rigs by itself",
    }
}

/// What a run is called by its folder, `001` of `runs/tokenrig` as `tokenrig-001`: each experiment has one of that number.
fn called(run: &Path) -> Option<String> {
    let run = std::path::absolute(run).ok()?;
    let name = |folder: &Path| Some(folder.file_name()?.to_string_lossy().into_owned());
    let own = name(&run)?;
    match run.parent().and_then(name) {
        Some(above) if own.chars().all(|c| c.is_ascii_digit()) => Some(format!("{above}-{own}")),
        _ => Some(own),
    }
}

/// A model that makes no rigs, of the folder of a run or of one of its checkpoints.
fn part_of_run(folder: &Path) -> Result<Option<Part>> {
    let (run, checkpoint) = named_by(folder);
    let settings = Settings::of_run(&run).map_err(|e| anyhow!(e))?;
    let refines_skeletons = || GrpoTask::of_skeletons(&settings, Device::Cpu);
    let rigs = settings.are::<TokenRigTaskConfig>()
        || settings.are::<GrpoTaskConfig>() && !refines_skeletons().map_err(|e| anyhow!(e))?;
    if rigs {
        return Ok(None);
    }
    let checkpoint = Checkpoint::open(&run.join("checkpoints").join(checkpoint))?;
    let shapes = riglab_nn::io::Reader::open(&checkpoint.weights())?.shapes();
    let numbers = shapes.values().map(|shape| shape.iter().product::<i64>() as usize).sum();
    let card = Card { name: run.display().to_string(), state: checkpoint.state().clone(), text: known(&run) };
    let up = axis(&settings).filter(|_| settings.are::<FsqCvaeTaskConfig>());
    Ok(Some(Part { kind: settings.task(), card, numbers, up }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_read_is_not_written_over() {
        let dir = tempfile::tempdir().unwrap();
        let [own, other] = ["own.safetensors", "other.safetensors"].map(|name| dir.path().join(name));
        std::fs::write(&own, "").unwrap();
        let read = [None, Some(own.as_path())];
        assert!(!ready(&other, read).unwrap());
        let said = ready(&dir.path().join("./own.safetensors"), read).unwrap_err().to_string();
        assert!(said.contains("is the input itself"), "{said}");
    }

    #[test]
    fn a_run_that_is_a_number_is_called_by_the_folder_above_it_too() {
        let of = |run: &str| called(Path::new(run)).unwrap_or_default();
        assert_eq!([of("runs/trig/001"), of("/runs/trig/001/"), of("/runs/mine")], ["trig-001", "trig-001", "mine"]);
        assert_eq!([of("/001"), of("/runs/v2/small-3"), of("/")], ["001", "small-3", ""]);
    }
}
