//! `riglab checkpoint`

mod import;
mod planted;

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, anyhow, bail};
use riglab_files::make_folder_of;
use riglab_task::bundle::Bundle;
use riglab_task::fsq_cvae::{Frozen, FsqCvaeTaskConfig};
use riglab_task::released::Imported;
use riglab_task::settings::Settings;
use riglab_task::tokenrig::{Card, Rigger};
use tch::{Device, Kind};

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

/// Put a run's checkpoint, its auto-encoder and their settings into one file for `riglab rig`, or into a run's folder of
/// its own, to be evaluated; or a run of an auto-encoder into a file for `skin.run`.
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
    /// The folder of a run of task tokenrig, grpo or fsq_cvae, or a file of a model that rigs [default: the model that
    /// comes with riglab].
    run: Option<PathBuf>,
    /// What to write: a file (.safetensors), or a new folder of a run for `riglab eval`.
    #[arg(long, short, value_name = "OUT")]
    out: PathBuf,
    /// Which checkpoint of the run: best, last or step-N [default: best].
    #[arg(long)]
    checkpoint: Option<String>,
    /// Numbers of 16 bits: half the size.
    #[arg(long)]
    half: bool,
    /// The file's name for it [default: that of the file it came from, or of the run's folder].
    #[arg(long)]
    name: Option<String>,
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
    let folder = into_folder(&args.out)?;
    let run = args.run.as_ref().filter(|run| !run.is_file());
    if let (None, Some(checkpoint)) = (run, &args.checkpoint) {
        bail!("--checkpoint {checkpoint} is for runs' folders; a file holds one checkpoint");
    }
    let of_run = args.checkpoint.as_deref().unwrap_or("best");
    let opened = match (&args.run, run) {
        (_, Some(run)) => of_folder(run, of_run),
        (Some(file), None) => Rigger::open(file, Device::Cpu).map(rigs),
        (None, None) => Rigger::shipped(Device::Cpu).map(rigs),
    };
    let (model, found) = opened.map_err(|e| anyhow!(e))?;
    let read =
        |path: &Path| std::fs::read_to_string(path).with_context(|| format!("{} cannot be read", path.display()));
    // One that was exported into its folder before.
    let card = run.map(|run| run.join("card.md")).filter(|card| card.is_file());
    let text = match args.card.as_ref().or(card.as_ref()) {
        Some(path) => read(path)?,
        None if run.is_none() => found.text,
        None => "No card was written for this model.".into(),
    };
    // A folder's path is of use on one machine only.
    let own = match run.and_then(|run| run.file_name()) {
        Some(run) => run.to_string_lossy().into_owned(),
        None => found.name,
    };
    let mut card = Card { name: args.name.clone().unwrap_or(own), text, state: found.state };
    if folder {
        let file = args.out.with_extension("safetensors");
        if args.half {
            bail!("--half is for files; a run's folder holds numbers of 32 bits (--out {})", file.display());
        }
        if args.name.is_some() {
            bail!("--name is for files; a run is called by its folder (--out {})", file.display());
        }
        // Of a policy that rewards refined, what evaluates it is the task that it was.
        card.state.task = model.task().into();
        planted::folder(&args.out, &model, &card, "exported")?;
        say!("{}", args.out.display());
        tell!("next: riglab eval {} --set data.corpora='[\"CORPUS.h5\"]'", args.out.display());
        return Ok(ExitCode::SUCCESS);
    }
    let kind = if args.half { Kind::Half } else { Kind::Float };
    let bytes = model.bundle(&card, kind).map_err(|e| anyhow!(e))?;
    crate::commands::keep_corpus(&args.out)?;
    make_folder_of(&args.out)?;
    riglab_files::write(&args.out, &bytes).with_context(|| format!("{} cannot be written", args.out.display()))?;
    say!("{}: {:.1} MB", args.out.display(), bytes.len() as f64 / 1e6);
    Ok(ExitCode::SUCCESS)
}

fn rigs((rigger, card): (Rigger, Card)) -> (Imported, Card) {
    (Imported::TokenRig(Box::new(rigger)), card)
}

/// The model of a run that rigs, or of an auto-encoder.
fn of_folder(run: &Path, checkpoint: &str) -> Result<(Imported, Card), String> {
    if !Settings::of_run(run)?.are::<FsqCvaeTaskConfig>() {
        return Rigger::of_run(run, checkpoint, Device::Cpu).map(rigs);
    }
    let (auto, state) = Frozen::of_run(run, checkpoint, Device::Cpu)?;
    let (mut config, params) = auto.into_parts();
    // Where it learned from is of no use elsewhere, and says more of a machine than it should.
    (config.data.corpora, config.data.weights) = (Vec::new(), Vec::new());
    let card = Card { name: String::new(), state, text: String::new() };
    Ok((Imported::FsqCvae(Box::new(config), params), card))
}

/// Whether a model goes into a run's folder there, and not into a file.
fn into_folder(out: &Path) -> Result<bool> {
    match out.extension() {
        None => Ok(true),
        Some(ending) if ending.eq_ignore_ascii_case("safetensors") => Ok(false),
        Some(_) if out.is_dir() => Ok(true),
        Some(_) => bail!(
            "{}: a model's file ends in .safetensors, and the name of a run's folder has no ending",
            out.display()
        ),
    }
}

fn show(args: &ShowArgs) -> Result<ExitCode> {
    let part = args.file.as_deref().filter(|file| file.is_file()).map(part).transpose()?.flatten();
    if let Some(Bundle { kind, card, tensors, .. }) = part {
        let numbers: usize = tensors.values().map(tch::Tensor::numel).sum();
        say!("{}", card.name);
        say!("{:.2} M parameters, of task {kind}: a part, which makes no rigs by itself", numbers as f64 / 1e6);
        say!("{} steps", card.state.step);
        say!("\n{}", card.text.trim_end());
        return Ok(ExitCode::SUCCESS);
    }
    let opened = match &args.file {
        Some(path) => Rigger::open(path, Device::Cpu),
        None => Rigger::shipped(Device::Cpu),
    };
    let (rigger, card) = opened.map_err(|e| anyhow!(e))?;
    let (c, skin) = (rigger.config(), rigger.vae());
    let millions = |n: usize| n as f64 / 1e6;
    let own: usize = skin.tensors().iter().map(|(_, t)| t.numel()).sum();
    say!("{}", card.name);
    say!("{:.2} M parameters, {:.2} M of its auto-encoder", millions(rigger.params().numel()), millions(own));
    say!("{} steps, up to {} joints, {} codes a bone", card.state.step, c.limits.joints, c.skin.codes);
    say!("\n{}", card.text.trim_end());
    Ok(ExitCode::SUCCESS)
}

/// What a file holds, if that is a model that makes no rigs.
fn part(file: &Path) -> Result<Option<Bundle>> {
    let name = file.display().to_string();
    let bytes = std::fs::read(file).with_context(|| format!("{name} cannot be read"))?;
    let bundle = Bundle::of_bytes(&bytes, &name).map_err(|e| anyhow!(e))?;
    Ok((bundle.kind != "tokenrig").then_some(bundle))
}
