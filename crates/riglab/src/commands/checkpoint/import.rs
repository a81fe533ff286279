//! `riglab checkpoint import`

use std::io::{ErrorKind, Read};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, anyhow, bail};
use riglab_config::Config;
use riglab_task::bundle::{Card, Stored, kind};
use riglab_task::released::{Fit, FoundModel, Imported, Model, Offered, import as read, recognise};
use riglab_train::{Spinner, State};
use tch::{Device, Kind};

use super::super::place_to_write;
use crate::offered::open;
use crate::presets;
use riglab_report::counted;
use riglab_report::shell::{command, quoted};

/// Take over weights that UniRig's or SkinTokens' authors published.
///
/// Reads checkpoints of torch and Lightning (nothing in them is run) and safetensors, finds out which model it is,
/// compares every tensor's name and shape with riglab's network, and lists what fits, what is missing and what is left
/// over. Sizes are taken from the shapes; what shapes do not tell is the release's.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab checkpoint import grpo_1400.ckpt
  riglab checkpoint import grpo_1400.ckpt -o tokenrig.safetensors
  riglab rig model.glb -o rigged.glb --checkpoint tokenrig.safetensors
  riglab checkpoint import last.ckpt -o runs/released_vae
  riglab eval runs/released_vae --set data.corpora='[\"corpus.h5\"]'")]
pub struct ImportArgs {
    /// The published file.
    file: PathBuf,
    /// What to write: a file (.safetensors) for `riglab rig` and `skin`, `grpo` and `skin.run`, or a run's folder for `riglab eval`.
    /// Without it, the file is only looked at.
    #[arg(long, short, value_name = "OUT", value_parser = place_to_write())]
    out: Option<PathBuf>,
    /// Which model it is: unirig_skeleton, unirig_skin, fsq_cvae or tokenrig [default: by its names].
    #[arg(long = "as", value_name = "MODEL")]
    model: Option<Model>,
    /// For TokenRig: take its auto-encoder from this file [default: from the same].
    #[arg(long, value_name = "FILE")]
    skin: Option<PathBuf>,
    /// Change a setting that shapes do not tell, as `model.heads=8`; `auto_encoder.` before it for TokenRig's
    /// auto-encoder.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Its name [default: the file's].
    #[arg(long)]
    name: Option<String>,
    /// List every tensor that does not fit.
    #[arg(long)]
    all: bool,
}

/// Tensors of a kind that are listed, unless all are.
const LISTED: usize = 12;

pub fn import(args: &ImportArgs) -> Result<ExitCode> {
    let shown = args.file.display();
    if let Some(kind) = kind(&args.file) {
        bail!("{}", already(&args.file, &kind));
    }
    no_checkpoint(&args.file)?;
    if let Some(out) = &args.out
        && super::ready(out, [Some(args.file.as_path()), args.skin.as_deref()])?
        && args.name.is_some()
    {
        bail!(
            "--name is for files; a run is called by its folder (--out {})",
            out.with_extension("safetensors").display()
        );
    }
    let mut offered = open(&args.file)?;
    let found = recognise(offered.shapes.keys(), args.model).ok_or_else(|| unknown(args, &offered))?;
    if let (Some(skin), false) = (&args.skin, found.model == Model::TokenRig) {
        bail!("--skin {}: only TokenRig has an auto-encoder beside its own network", skin.display());
    }
    let (config, skin) = settings(found.model, args.skin.as_deref(), &args.sets)?;
    let mut other = args.skin.as_deref().map(open).transpose()?;
    let skin = skin.as_ref().map(|config| (config, other.as_mut()));
    let reading = Spinner::new(&format!("reading {shown}"));
    let outcome = read(&mut offered, &found, &config, skin, Device::Cpu);
    drop(reading);
    // What the file's reader says names it already.
    let outcome =
        outcome.map_err(|e| if e.starts_with(&shown.to_string()) { anyhow!(e) } else { anyhow!("{shown}: {e}") })?;
    for fit in &outcome.fits {
        fit.lines(if args.all { usize::MAX } else { LISTED }).iter().for_each(|line| say!("{line}"));
    }
    for sizes in &outcome.sizes {
        tell!("note: other sizes than the release's. {sizes}. What shapes do not show (heads) stays: check it");
    }
    let Some(model) = outcome.model else { bail!("{shown}: {}", refused(&found, &outcome.fits)) };
    if let Imported::TokenRig(rigger) = &model
        && let Some(fault) = rigger.mismatch()
    {
        tell!("warning: {fault}; --skin takes another");
    }
    let Some(out) = &args.out else {
        tell!("all that is needed is there; -o OUT.safetensors writes it");
        return Ok(ExitCode::SUCCESS);
    };
    let state = State {
        task: model.task().into(),
        step: offered.step.unwrap_or(0),
        seed: 0,
        skipped: 0,
        skipped_in_a_row: 0,
        best: None,
    };
    let own = args.file.file_stem().map_or_else(|| model.task().into(), |n| n.to_string_lossy().into_owned());
    let text = card(found.model, &args.file, &outcome.fits);
    let card = Card { name: args.name.clone().unwrap_or(own), text, state };
    if !super::into_folder(out)? {
        let kind = if outcome.half { Kind::BFloat16 } else { Kind::Float };
        super::write(out, &model.bundle(&card).map_err(|e| anyhow!(e))?, kind)?;
    } else {
        super::planted::folder(out, &model, &card, "imported")?;
        say!("{}", out.display());
    }
    if let Some(how) = model.draws() {
        let faster = if how.contains(" beams") { "; `riglab rig --beams 1` is faster" } else { "" };
        tell!("draws as published: {how}{faster}");
    }
    tell!("next: {}", next(&model, out));
    Ok(ExitCode::SUCCESS)
}

/// Refuses what is plainly none: no file, nothing in it, or a text.
fn no_checkpoint(file: &Path) -> Result<()> {
    let (shown, mut start) = (file.display(), Vec::new());
    match std::fs::File::open(file).and_then(|opened| opened.take(512).read_to_end(&mut start)) {
        Err(e) if e.kind() == ErrorKind::NotFound => bail!("{shown}: there is no such file"),
        // Who opens it tells what cannot be read.
        Err(_) => return Ok(()),
        Ok(_) => {}
    }
    if start.is_empty() {
        bail!("{shown} is empty: it was never written, or not copied to its end; fetch or save it again");
    }
    if file.to_string_lossy().ends_with(".safetensors.index.json") {
        bail!(
            "{shown} lists the files over which a model's tensors are spread; put them into one: in Python, \
             `safetensors.torch.save_file` of what `load_file` gives of each"
        );
    }
    let text = |b: &u8| b.is_ascii_graphic() || b.is_ascii_whitespace();
    if !start.starts_with(b"PK") && !start.starts_with(b"version https://git-lfs") && start.iter().all(text) {
        bail!("{shown} is a text file, no checkpoint of torch or safetensors; was a web page saved instead?");
    }
    Ok(())
}

/// What to do with such a file.
fn already(file: &Path, kind: &str) -> String {
    let shown = file.display();
    let used = match kind {
        "tokenrig" | "unirig_skeleton" => format!("`{}` rigs with it", rigging(file)),
        "unirig_skin" => format!("`{}` makes weights with it", skinning(file)),
        "fsq_cvae" => {
            let up = Stored::open(file).ok().and_then(|stored| super::axis_of(&stored));
            let with = up.map_or_else(String::new, |up| format!(", with data.up = \"{up}\""));
            format!("`--set {}` trains with it{with}", setting(file))
        }
        _ => format!("it is a model of task {kind}"),
    };
    format!(
        "{shown}: it is riglab's already, there is nothing to import; {used}, `{}` tells what it is",
        command(["checkpoint", "show", &file.to_string_lossy()])
    )
}

/// The command that rigs with a model.
fn rigging(model: &Path) -> String {
    command(["rig", "MODEL.glb", "-o", "RIGGED.glb", "--checkpoint", &model.to_string_lossy()])
}

/// What makes new weights with a model.
fn skinning(model: &Path) -> String {
    command(["skin", "MODEL.glb", "-o", "AGAIN.glb", "--checkpoint", &model.to_string_lossy()])
}

/// What makes a training take an auto-encoder, as a shell reads it.
fn setting(auto_encoder: &Path) -> String {
    quoted(&format!("skin.run=\"{}\"", auto_encoder.display()))
}

/// The settings of a release, and for TokenRig those of its auto-encoder: that file's own, where riglab made it.
fn settings(model: Model, skin: Option<&Path>, sets: &[String]) -> Result<(Config, Option<Config>)> {
    const WITHIN: &str = "auto_encoder.";
    let of_skin: Vec<String> = sets.iter().filter_map(|s| s.strip_prefix(WITHIN)).map(String::from).collect();
    let own: Vec<String> = sets.iter().filter(|s| !s.starts_with(WITHIN)).cloned().collect();
    let name = match model {
        Model::UnirigSkeleton => "unirig/skeleton_released.toml",
        Model::UnirigSkin => "unirig/skin_released.toml",
        Model::FsqCvae => "skintokens/fsq_cvae_released.toml",
        Model::TokenRig => "skintokens/tokenrig_released.toml",
    };
    let config = presets::load(name, &own)?;
    if model != Model::TokenRig {
        if let Some(set) = of_skin.first() {
            bail!("--set {WITHIN}{set}: only TokenRig has an auto-encoder beside its own network");
        }
        return Ok((config, None));
    }
    let own = skin.filter(|file| kind(file).is_some()).map(|file| Stored::open(file).map_err(|e| anyhow!(e)));
    let skin = match (own.transpose()?, skin) {
        (Some(stored), Some(file)) => {
            let text = if stored.skin.is_empty() { &stored.settings } else { &stored.skin };
            presets::parse(&file.display().to_string(), text, &of_skin)?
        }
        _ => presets::load("skintokens/fsq_cvae_released.toml", &of_skin)?,
    };
    Ok((config, Some(skin)))
}

fn unknown(args: &ImportArgs, offered: &Offered<'_>) -> anyhow::Error {
    let some: Vec<String> = offered.shapes.keys().take(3).map(|n| format!("`{n}`")).collect();
    let what = match args.model {
        Some(model) => format!("no {} is in it: no tensor's name ends in `{}`", model.title(), model.sign()),
        None => "none of the published models is in it".into(),
    };
    anyhow!(
        "{}: {what}; it has {}{}{}",
        args.file.display(),
        counted(offered.shapes.len(), "tensor"),
        if some.is_empty() { "" } else { ", as " },
        some.join(", ")
    )
}

fn refused(found: &FoundModel, fits: &[Fit]) -> String {
    let unsound: Vec<&String> = fits.iter().flat_map(|fit| &fit.unsound).collect();
    if let [first, others @ ..] = unsound.as_slice() {
        let more =
            if others.is_empty() { String::new() } else { format!(", and {} more are no weights", others.len()) };
        return format!(
            "{first}{more} (listed above): the training that it comes from diverged, or the file was changed on its way; \
             fetch it again, or take an earlier checkpoint of that training"
        );
    }
    let count = |of: fn(&Fit) -> usize| fits.iter().map(of).sum::<usize>();
    let kinds = [
        (count(|f| f.missing.len()), "missing"),
        (count(|f| f.unread.len()), "of a type that is not read"),
        (count(|f| f.unlike.len()), "of another shape"),
        (count(|f| f.wrong.len()), "not what they should be"),
    ];
    let counts: Vec<String> = kinds.iter().filter(|(n, _)| *n > 0).map(|(n, what)| format!("{n} {what}")).collect();
    format!(
        "not {} as published: of its tensors {} (listed above). Settings that shapes do not tell can be given, as \
         --set model.heads=8; --as takes it for another model",
        found.model.title(),
        counts.join(", ")
    )
}

/// What is known about weights that others trained.
fn card(model: Model, file: &Path, fits: &[Fit]) -> String {
    let file = file.file_name().unwrap_or_default().to_string_lossy();
    let lines: Vec<String> = fits.iter().flat_map(|fit| fit.lines(LISTED)).collect();
    format!(
        "{}, as its authors published it, read from `{file}` by `riglab checkpoint import`. riglab neither trained nor \
         measured it. Its licence is that of the place where the file comes from.\n\n```\n{}\n```",
        model.title(),
        lines.join("\n")
    )
}

fn next(model: &Imported, out: &Path) -> String {
    let shown = out.to_string_lossy();
    match model {
        Imported::TokenRig(_) => rigging(out),
        Imported::Skeleton(..) if out.is_file() => rigging(out),
        Imported::Skin(..) if out.is_file() => skinning(out),
        Imported::FsqCvae(c, _) if out.is_file() => {
            let whole = command(["checkpoint", "import", "TOKENRIG.ckpt", "--skin", &shown]);
            format!("{whole}, or --set {} in training with data.up = \"{}\"", setting(out), c.data.up)
        }
        _ if out.is_file() => command(["checkpoint", "show", &shown]),
        _ => format!("{} --set data.corpora='[\"corpus.h5\"]'", command(["eval", &shown])),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_plainly_no_checkpoint_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let said = |name: &str, bytes: &[u8]| {
            std::fs::write(dir.path().join(name), bytes).unwrap();
            no_checkpoint(&dir.path().join(name)).map_err(|e| e.to_string())
        };
        assert!(said("empty.ckpt", b"").unwrap_err().contains("is empty"));
        assert!(said("page.ckpt", b"<html>\n").unwrap_err().contains("was a web page saved"));
        assert!(said("some.ckpt", b"PK\x03\x04").is_ok());
        for absent in ["absent.ckpt", "absent.pt", "absent.safetensors", "absent/a.pt"] {
            let fault = no_checkpoint(&dir.path().join(absent)).unwrap_err().to_string();
            assert!(fault.ends_with(&format!("{absent}: there is no such file")), "{fault}");
        }
        let index = said("model.safetensors.index.json", b"{}").unwrap_err();
        assert!(index.contains("spread") && index.contains("save_file"), "{index}");
        // What opens it says that it is a folder.
        assert!(no_checkpoint(dir.path()).is_ok());
    }
}
