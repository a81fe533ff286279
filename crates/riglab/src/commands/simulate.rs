//! `riglab simulate`

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, anyhow, bail};
use clap::ValueEnum;
use riglab_asset::export::{self, ExportOptions, Influences};
#[cfg(feature = "fbx")]
use riglab_asset::rigging::dressed;
use riglab_asset::{ImportOptions, Imported, Resample, Warning, import, import_bytes, is_gltf};
use riglab_core::{Bounds, Clip, Rig, skin};
use riglab_render::{Theme, View, contact_sheet, render_parts};
use riglab_report::counted;
use riglab_report::shell::command;
use riglab_simulate::{Lengths, Motion, MotionKind, generate, guess, play};
use riglab_task::unirig_skin::Skinner;
use riglab_train::named_by;
use tch::Device;

use super::earlier::{Overwrite, Written};
use super::file_to_write;
#[cfg(feature = "fbx")]
use super::is_fbx;

/// Play a motion with spring bones: hair, tails and clothes swing behind the body.
///
/// Writes the file again with one more motion (one key per frame), placed first; meshes, materials and other
/// motions stay. Spring bones are those of the file (VRM 0.x or 1.0, or creatures of `riglab synth`) and follow VRM's rule,
/// in which stiffness and gravity are lengths a second in the file's units. A motion is one of the file, or one of
/// `shake`, `turn` and `hop`, in which the whole body moves and then stands. The input is never changed.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab simulate avatar.vrm -o swinging.glb --png sheet.png
  riglab simulate avatar.vrm -o walk.glb --motion Walk
  riglab simulate dog.glb -o dog-swings.glb --springs guess --motion hop --seed 3
  riglab simulate avatar.vrm -o learned.glb --attributes runs/unirig_skin/001")]
pub struct Args {
    /// A rigged model.
    input: PathBuf,
    /// The GLB to write.
    #[arg(long, short, value_name = "OUT.glb", value_parser = file_to_write())]
    out: PathBuf,
    /// A motion of the file by its name, or `shake`, `turn` or `hop` [default: the file's first, or `shake`].
    #[arg(long, value_name = "NAME")]
    motion: Option<String>,
    /// Which spring bones.
    #[arg(long, value_enum, default_value = "file")]
    springs: Source,
    /// A run of task unirig_skin, which tells how they swing: stiffness, drag, gravity and hit radius are what it
    /// makes of mesh and skeleton. Which joints swing stays. They are written, too.
    #[arg(long, value_name = "RUN")]
    attributes: Option<PathBuf>,
    /// Frames a second, and steps of the simulation.
    #[arg(long, default_value_t = 60.0, value_name = "N")]
    fps: f32,
    /// For how long; motions of the file are cut there [default: 4, or the whole motion].
    #[arg(long, value_name = "S")]
    seconds: Option<f64>,
    /// Seeds how fast, how far and which way `shake`, `turn` and `hop` go, and the points by which --attributes looks at the
    /// model: same seed, same file.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Which length bones have while they move.
    #[arg(long, value_enum, default_value = "rest")]
    lengths: Length,
    /// A picture of frames in a row.
    #[arg(long, value_name = "FILE.png", value_parser = file_to_write())]
    png: Option<PathBuf>,
    /// Say on standard output what was made, as a line of JSON.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    overwrite: Overwrite,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Source {
    /// Those of the file.
    File,
    /// By names of joints: hair, skirt, tail, ear and the like swing as artists set them. They are written, too.
    Guess,
}

#[derive(Clone, Copy, ValueEnum)]
enum Length {
    /// That at rest, as VRM says.
    Rest,
    /// To where the tail was a frame before, as three-vrm measures; to compare with it.
    Lagging,
}

/// Frames of a second at most, seconds at most, and joints times frames at most.
const MOST_FPS: f32 = 1000.0;
const MOST_SECONDS: f64 = 600.0;
const MOST_KEYS: f64 = 2e6;
/// What is added to the name of a motion.
const OWN: &str = " with springs";
/// Pictures of a sheet.
const PICTURES: usize = 12;

impl Args {
    /// Whether a network computes.
    pub fn computes(&self) -> bool {
        self.attributes.is_some()
    }
}

/// `threads`: of the network that tells attributes.
pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    check(args)?;
    let shown = args.input.display();
    // Which motions there are is told by one frame of each; the one that is played is read when it is known.
    let imported = import(&args.input, &reading(args, Some(1), None))?;
    // Motions that are not played are as long as they were.
    for warning in imported.warnings().iter().filter(|w| !matches!(w, Warning::ClipsCut { .. })) {
        tell!("warning: {shown}: {warning}");
    }
    let about = if imported.reading.faces_back { 180.0 } else { 0.0 };
    let names: Vec<String> = imported.clips.iter().map(|clip| clip.name().to_owned()).collect();
    let rig = with_springs(args, &imported)?;
    let chosen = chosen(args, &names, imported.warnings())?;
    let rig = with_attributes(args, rig, threads)?;
    let (bytes, source) = document(args, &imported, &rig, chosen.own())?;
    let clip = match &chosen {
        Chosen::Own(name) => own(args, &source, name)?,
        Chosen::Made(kind) => made(args, *kind, &rig)?,
    };
    let lengths = match args.lengths {
        Length::Rest => Lengths::Rest,
        Length::Lagging => Lengths::Lagging,
    };
    let played = play(&rig, &clip, lengths).with_context(|| format!("{shown}, motion `{}`", clip.name()))?;
    let played = named(&played, &free_name(clip.name(), |name| names.iter().any(|there| there == name)))?;
    let folder = args.input.parent();
    let out = export::animate(&bytes, folder, &source, rig.skeleton(), &played)?;
    for note in &out.notes {
        tell!("note: {shown}: {note}");
    }
    let sheet = args.png.as_ref().map(|_| sheet(&rig, &played, about)).transpose()?;
    riglab_files::make_folder_of(&args.out)?;
    export::write(&args.out, &out.bytes).with_context(|| format!("{} cannot be written", args.out.display()))?;
    if let (Some(path), Some(sheet)) = (&args.png, sheet) {
        riglab_files::make_folder_of(path)?;
        riglab_files::write(path, &sheet).with_context(|| format!("{} cannot be written", path.display()))?;
    }
    say_what(args, &rig, &clip, &played);
    Ok(ExitCode::SUCCESS)
}

/// What the motion of another is called: numbered where an earlier call made one of it.
fn free_name(of: &str, taken: impl Fn(&str) -> bool) -> String {
    let own = format!("{}{OWN}", base(of));
    let numbered = |k: usize| if k == 1 { own.clone() } else { format!("{own} {k}") };
    (1..).map(numbered).find(|name| !taken(name)).unwrap_or(own.clone())
}

/// Of a motion that an earlier call made, what it was made of; of others the whole name.
fn base(name: &str) -> &str {
    let number = |rest: &str| rest.chars().all(|c| c == ' ' || c.is_ascii_digit());
    name.rfind(OWN).filter(|at| number(&name[at + OWN.len()..])).map_or(name, |at| &name[..at])
}

fn check(args: &Args) -> Result<()> {
    let (out, input) = (&args.out, &args.input);
    if !out.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb")) {
        bail!("{}: only GLB is written; name it .glb", out.display());
    }
    for path in [Some(out), args.png.as_ref()].into_iter().flatten() {
        if export::same_file(input, path) {
            bail!("{} is the input itself, which is never changed; give another name", path.display());
        }
    }
    if let Some(png) = args.png.as_ref().filter(|p| !p.extension().is_some_and(|e| e.eq_ignore_ascii_case("png"))) {
        bail!("{}: pictures are PNG; name it .png", png.display());
    }
    args.overwrite.keep_others(out, Written::Glb)?;
    args.png.as_deref().map_or(Ok(()), |png| args.overwrite.keep_others(png, Written::Picture))?;
    if !(args.fps > 0.0 && args.fps <= MOST_FPS) {
        bail!("--fps {}: give a number above 0, up to {MOST_FPS}", args.fps);
    }
    match args.seconds {
        Some(s) if !(s > 0.0 && s <= MOST_SECONDS) => {
            bail!("--seconds {s}: give a number above 0, up to {MOST_SECONDS}")
        }
        _ => Ok(()),
    }
}

/// With the motion of a name, or all: as many frames as are played, or less.
fn reading(args: &Args, frames: Option<usize>, motion: Option<&str>) -> ImportOptions {
    let seconds = args.seconds.unwrap_or(MOST_SECONDS);
    let frames = frames.unwrap_or((seconds * f64::from(args.fps)).round() as usize + 1);
    let (clips, motion) = (Some(Resample { rate: args.fps, frames }), motion.map(str::to_owned));
    ImportOptions { clips, motion, ..ImportOptions::default() }
}

fn with_springs(args: &Args, imported: &Imported) -> Result<Rig> {
    let shown = args.input.display();
    let rig = imported.rig().with_context(|| {
        let rig = command(["rig", &args.input.to_string_lossy(), "-o", "RIGGED.glb"]);
        format!("{shown} has no skeleton; `{rig}` makes one")
    })?;
    let swing = |rig: &Rig| rig.springs().by_joint(rig.skeleton().len()).iter().any(Option::is_some);
    match args.springs {
        Source::File if swing(rig) => Ok(rig.clone()),
        Source::File => {
            bail!("{shown} has no spring bones\n\nhint: `--springs guess` makes some by the names of joints")
        }
        Source::Guess => {
            let springs = guess(rig);
            if springs.is_empty() {
                bail!(
                    "{shown}: no joint is named after something that swings (hair, skirt, tail, ear ..)\n\nhint: \
                     rename some, or take a file with spring bones"
                );
            }
            Ok(rig.clone().with_springs(springs)?)
        }
    }
}

/// With attributes that a run tells.
fn with_attributes(args: &Args, rig: Rig, threads: usize) -> Result<Rig> {
    let Some(run) = &args.attributes else { return Ok(rig) };
    riglab_torch::init(riglab_torch::Settings { threads });
    let (folder, checkpoint) = named_by(run);
    let (skinner, state) = Skinner::of_run(&folder, &checkpoint, Device::Cpu).map_err(|e| anyhow!(e))?;
    tell!("attributes: {}, {} steps", run.display(), state.step);
    let springs = skinner.springs(&rig, args.seed).map_err(|e| anyhow!("{}: {e}", args.input.display()))?;
    Ok(rig.with_springs(springs)?)
}

/// The glTF that gets the motion, and what is read from it, with the motion of a name.
fn document(args: &Args, imported: &Imported, rig: &Rig, motion: Option<&str>) -> Result<(Vec<u8>, Imported)> {
    let path = &args.input;
    let gltf = is_gltf(path);
    // A file with the rig that it has stays as it is, but that weights which compression rounded sum to 1.
    let options = ExportOptions { influences: Influences::All, ..ExportOptions::default() };
    let made = match gltf {
        true => export::onto(path, imported, rig, &options)?,
        #[cfg(feature = "fbx")]
        false if is_fbx(path) => {
            let (made, notes) = dressed(path, &ImportOptions::default(), rig.springs(), &options)?;
            notes.iter().for_each(|note| tell!("note: {}: {note}", path.display()));
            made
        }
        false => export::alone(&imported.name, rig, &imported.provenance, &options)?,
    };
    for note in &made.notes {
        tell!("note: {}: {note}", path.display());
    }
    let options = motion.map_or_else(ImportOptions::default, |name| reading(args, None, Some(name)));
    let again = import_bytes(&path.with_extension("glb").to_string_lossy(), &made.bytes, &options)?;
    // A document has its own.
    if let (Some(name), false, true) = (motion, gltf, again.clips.is_empty()) {
        let whole = import(path, &reading(args, None, Some(name)))?;
        let mut reading = again.reading;
        reading.warnings = whole.reading.warnings;
        return Ok((made.bytes, Imported { clips: whole.clips, reading, ..again }));
    }
    Ok((made.bytes, again))
}

/// What is played.
enum Chosen {
    /// A motion of the file, by its name.
    Own(String),
    Made(MotionKind),
}

impl Chosen {
    fn own(&self) -> Option<&str> {
        match self {
            Self::Own(name) => Some(name),
            Self::Made(_) => None,
        }
    }
}

/// Which motion is asked for, of a file that has some of these names and warns of others.
fn chosen(args: &Args, names: &[String], warnings: &[Warning]) -> Result<Chosen> {
    let shown = args.input.display();
    let left_out = || warnings.iter().filter_map(left_out).flatten();
    let Some(wanted) = &args.motion else {
        // What an earlier call made is of a motion that is there, too.
        let first = names.iter().find(|name| base(name) == **name).or(names.first());
        return match (first, left_out().next()) {
            (Some(name), _) => Ok(Chosen::Own(name.clone())),
            (None, None) => Ok(Chosen::Made(MotionKind::Shake)),
            (None, Some(why)) => bail!("{shown}: its motions cannot be read: {why}; --motion shake makes one"),
        };
    };
    if names.contains(wanted) {
        return Ok(Chosen::Own(wanted.clone()));
    }
    if let Some((_, kind)) = MotionKind::ALL.iter().find(|(name, _)| name == wanted) {
        return Ok(Chosen::Made(*kind));
    }
    if let Some(why) = left_out().find(|why| why.starts_with(&format!("`{wanted}` ("))) {
        bail!("{shown}: a motion cannot be read: {why}");
    }
    let own: Vec<String> = names.iter().map(|name| format!("`{name}`")).collect();
    let own = if own.is_empty() { "none".into() } else { own.join(", ") };
    bail!("{shown} has no motion `{wanted}`; it has {own}, and there are `shake`, `turn` and `hop`")
}

/// The motions that a warning is of, each with the reason why it is not read.
fn left_out(warning: &Warning) -> Option<&Vec<String>> {
    if let Warning::ClipsLeftOut { clips } = warning { Some(clips) } else { None }
}

/// A motion of the file, as it was read for being played.
fn own(args: &Args, source: &Imported, name: &str) -> Result<Clip> {
    let shown = args.input.display();
    let Some(clip) = source.clips.iter().find(|clip| clip.name() == name) else {
        let why = source.warnings().iter().filter_map(left_out).flatten().next().map_or(name, String::as_str);
        bail!("{shown}: a motion cannot be played: {why}; a lower --fps makes it shorter, and so does --seconds");
    };
    if source.warnings().iter().any(|w| matches!(w, Warning::ClipsCut { .. })) && args.seconds.is_none() {
        tell!("warning: {shown}: the motion `{name}` is cut after {}", counted(clip.frames(), "frame"));
    }
    Ok(clip.clone())
}

/// A motion that is made, of joints of the rig.
fn made(args: &Args, kind: MotionKind, rig: &Rig) -> Result<Clip> {
    let seconds = args.seconds.unwrap_or(4.0);
    if seconds * f64::from(args.fps) * rig.skeleton().len() as f64 > MOST_KEYS {
        bail!(
            "{} has {} joints, too many for {seconds} s at {} frames a second; lower --seconds or --fps",
            args.input.display(),
            rig.skeleton().len(),
            args.fps
        );
    }
    Ok(generate(rig, &Motion { kind, seconds, rate: args.fps, seed: args.seed }))
}

fn named(clip: &Clip, name: &str) -> Result<Clip> {
    Ok(Clip::new(name.into(), clip.rate(), clip.joints(), clip.maps().to_vec())?)
}

/// Frames in a row, evenly apart, all in one frame, seen from so many degrees further around.
fn sheet(rig: &Rig, clip: &Clip, about: f32) -> Result<Vec<u8>> {
    let count = clip.frames().min(PICTURES);
    let frames: Vec<usize> = (0..count).map(|k| k * (clip.frames() - 1) / (count - 1).max(1)).collect();
    let poses = frames.iter().map(|&f| {
        let mesh = rig.mesh().with_positions(skin(rig, &clip.frame(f))?)?;
        Ok(Rig::new(rig.skeleton().clone(), mesh, rig.weights().clone())?)
    });
    let poses: Vec<Rig> = poses.collect::<Result<_>>()?;
    let bounds = Bounds::of(poses.iter().flat_map(|p| p.mesh().positions()).copied()).context("a rig has a vertex")?;
    let view = View::square(256).framed(bounds);
    let (yaw, pitch) = (view.yaw_deg, view.pitch_deg);
    let view = view.turned(yaw + about, pitch);
    let cell =
        |(frame, pose): (&usize, &Rig)| (format!("{:.2} s", *frame as f32 / clip.rate()), render_parts(pose, &view));
    let cells: Vec<_> = frames.iter().zip(&poses).map(cell).collect();
    Ok(contact_sheet(&cells, 4, Theme::Light).to_png())
}

fn say_what(args: &Args, rig: &Rig, before: &Clip, after: &Clip) {
    let swings = rig.springs().by_joint(rig.skeleton().len());
    let count = swings.iter().flatten().count();
    // How far a tail is from where the body alone would take it.
    let tails: Vec<_> = swings.iter().flatten().filter_map(|s| Some((s.joint.index(), s.tail?))).collect();
    let most = (0..after.frames()).flat_map(|frame| {
        let (body, moved) = (before.frame(frame), after.frame(frame));
        tails
            .iter()
            .map(|&(j, tail)| moved[j].transform_point3(tail.into()).distance(body[j].transform_point3(tail.into())))
            .collect::<Vec<f32>>()
    });
    let most = most.fold(0.0, f32::max);
    let seconds = (after.frames() - 1) as f32 / after.rate();
    let out = Path::new(&args.out).display();
    if args.json {
        let line = serde_json::json!({
            "file": args.input.to_string_lossy(), "out": args.out.to_string_lossy(),
            "png": args.png.as_ref().map(|png| png.to_string_lossy()), "motion": before.name(), "frames": after.frames(),
            "fps": after.rate(), "seconds": seconds, "joints": rig.skeleton().len(), "swinging": count,
            "springs": rig.springs().springs().len(), "colliders": rig.springs().colliders().len(), "farthest": most,
        });
        say!("{line}");
    } else {
        say!(
            "{out}: `{}` for {seconds:.1} s, {count} of {} joints swing, {} from where the body alone takes them",
            before.name(),
            rig.skeleton().len(),
            far(most, rig.bounds().size().into_iter().fold(0.0, f32::max))
        );
    }
}

/// A distance in the file's units, and what it is of the model's longest side.
fn far(distance: f32, side: f32) -> String {
    format!("up to {distance:.3} units ({:.1} % of the model's size)", 100.0 * distance / side.max(f32::MIN_POSITIVE))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distances_have_a_unit() {
        assert_eq!(far(25.4894, 154.72), "up to 25.489 units (16.5 % of the model's size)");
        assert_eq!(far(0.0, 0.0), "up to 0.000 units (0.0 % of the model's size)");
    }

    #[test]
    fn motions_of_earlier_calls_keep_their_names() {
        assert_eq!(free_name("Walk", |_| false), "Walk with springs");
        let there = ["Walk", "Walk with springs", "Walk with springs 2"];
        assert_eq!(free_name("Walk with springs 2", |name| there.contains(&name)), "Walk with springs 3");
        assert_eq!([base("Walk with springs"), base("Bed with springs creaks")], ["Walk", "Bed with springs creaks"]);
    }
}
