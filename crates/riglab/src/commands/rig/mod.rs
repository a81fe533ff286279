//! `riglab rig` and `riglab skin`

mod given;
mod model;
mod one;

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, anyhow, bail};
use riglab_asset::export::ExportOptions;
use riglab_asset::rigging::{NameStyle, UpAxis};
use riglab_asset::{Target, is_model_file, is_vrm, model_endings};
use riglab_nn::generate::drawable_at;
use riglab_task::tokenrig::Rank;
use riglab_train::{Progress, Spinner};

use super::device::DeviceArgs;
use super::earlier::{Overwrite, Written};
use super::glb::{Frames, Most};
use super::{in_line, is_fbx, place_to_write, some_of};
use model::Model;
use riglab_report::counted;
use riglab_report::shell::command;

/// Rig a model: a skeleton and skin weights for a mesh.
///
/// Reads GLB, glTF, VRM, FBX, OBJ, PLY and STL, and writes a GLB, or an FBX if OUT ends so: meshes, materials, textures,
/// transforms and names stay; an armature, a skin and weights are added. A rig that the file already has is removed first.
/// The network used is the small one that comes with riglab, or another (--checkpoint). The input is never changed.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab rig creature.obj -o creature.glb
  riglab rig avatar.glb -o rigged.glb --preview
  riglab rig scan.ply -o scan.glb --up z
  riglab rig avatar.glb -o rigged.glb --samples 8 --rank rewards --seed 1
  riglab rig avatar.glb -o rigged.glb --skeleton bones_of.glb
  riglab rig dragon.glb -o rigged.glb --skeleton spine_and_wings.txt --complete
  riglab rig models/ -o rigged/
  riglab rig models/ -o rigged/ --to fbx --skip-existing
  riglab rig fox.obj -o fox.glb --checkpoint runs/tokenrig/001
  riglab rig fox.obj -o fox.glb --checkpoint runs/unirig_skeleton/001 --weights runs/unirig_skin/001")]
pub struct RigArgs {
    #[command(flatten)]
    common: Common,
    /// Where the skeleton comes from: `predict`, `keep` (the file's own, or that of the rig text beside an OBJ), or another file
    /// in the same space: a rigged one, or a rig text of joints alone (lines `joints NAME X Y Z`, `hier PARENT CHILD` and `root NAME`).
    #[arg(long, default_value = "predict", value_name = "predict|keep|FILE")]
    skeleton: String,
    /// The given skeleton (--skeleton keep or FILE) is a beginning: its joints stay as they are, and the model adds those that
    /// are missing. Its root is the root of the whole.
    #[arg(long)]
    complete: bool,
    /// Begin with the named joints of a convention: `mixamo` or `vroid`. If what the model then writes is no body, they go
    /// where its samples without the template show a human body.
    #[arg(long, value_name = "NAME")]
    template: Option<String>,
    /// Names of predicted joints: `mixamo` and `vrm` give human bones the names of those conventions and name other joints by
    /// position; `plain` names all by position (`spine_1`); `keep` leaves them as the model wrote them [default: mixamo; with
    /// --template the template's names, and others by position].
    #[arg(long, value_name = "mixamo|vrm|plain|keep")]
    names: Option<NameStyle>,
    /// What makes the weights where --checkpoint is of UniRig's skeleton stage, which writes skeletons alone: the folder of a
    /// run or a file, of task unirig_skin, tokenrig or grpo [default: the model that comes with riglab].
    #[arg(long, value_name = "PATH")]
    weights: Option<PathBuf>,
}

/// Make new weights for the skeleton that a model has.
///
/// As `riglab rig --skeleton keep`: joints stay as they are, with what hangs on them, human bones, springs and motions, and
/// joints of the file's own rig that influence no vertex stay without weights. Only where a skin's joints stand so that other
/// weights would move the mesh, the joints are made anew in their places, and what goes with the old ones is told. Networks
/// have a limit of joints: 100 for the one that comes with riglab.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab skin avatar.glb -o again.glb
  riglab skin mesh.obj -o rigged.glb --skeleton bones_of.glb
  riglab skin avatar.glb -o again.glb --checkpoint runs/unirig_skin/001")]
pub struct SkinArgs {
    #[command(flatten)]
    common: Common,
    /// Where the skeleton comes from: `keep` (the file's own, or that of the rig text beside an OBJ), or another file in the same
    /// space: a rigged one, or a rig text of joints alone.
    #[arg(long, default_value = "keep", value_name = "keep|FILE")]
    skeleton: String,
}

#[derive(clap::Args)]
struct Common {
    /// A model, or a folder of models, subfolders included.
    input: PathBuf,
    /// The GLB or FBX to write (or a VRM, if the input is one); a folder, if the input is one.
    #[arg(long, short, value_name = "OUT", value_parser = place_to_write())]
    out: PathBuf,
    /// What is written into a folder [default: glb].
    #[arg(long, value_name = "glb|fbx", value_parser = scene)]
    to: Option<Target>,
    /// The network: a run's folder (its best checkpoint is used), the folder of one checkpoint (RUN/checkpoints/last), or a
    /// file of `riglab checkpoint export` or `import`. Its task is tokenrig or grpo; unirig_skeleton, for the skeleton; or
    /// unirig_skin, where the skeleton is given [default: the model that comes with riglab].
    #[arg(long, value_name = "PATH")]
    checkpoint: Option<PathBuf>,
    /// Number of rigs to sample, of which the best is taken (--rank); the first is decoded as eval.generate of the model's
    /// config says, mostly greedily [default: eval.consensus of that config, 64 for the one that comes with riglab; 1 where
    /// the skeleton is given and not completed].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    samples: Option<u16>,
    /// Which sample is the best. consensus: the skeleton closest to the others, its joints moved to where these have them
    /// (eval.refine of the model's config). rewards: the highest geometric rewards (SkinTokens 3.4.1: joints within the body,
    /// weights that hold every vertex, motions that tear nothing). likelihood: the likeliest, which consensus also takes
    /// where the skeleton is given.
    #[arg(long, value_enum, ignore_case = true, default_value = "consensus")]
    rank: Ranked,
    /// Sampling temperature [default: eval.generate of the model's config].
    #[arg(long, value_name = "T")]
    temperature: Option<f32>,
    /// Number of beams: sequences kept beside each other for each sample. The published networks were run with 10
    /// (SkinTokens) and 15 (UniRig); 1 is faster [default: eval.generate of the model's config].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    beams: Option<u16>,
    /// Number of skins to sample for the skeleton; their mean weights are written: more reliable than the likeliest alone,
    /// and as many times slower [default: eval.skins of the model's config, 8 for the one that comes with riglab].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    skins: Option<u16>,
    /// Seeds the points that are looked at and the draws: same seed, same file.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Most joints that may influence a vertex.
    #[arg(long, value_enum, ignore_case = true, default_value = "4")]
    influences: Most,
    /// Orientation of the joints at rest; joints of the file's own that stay keep theirs.
    #[arg(long, value_enum, ignore_case = true, default_value = "bone")]
    frames: Frames,
    /// The axis that points up in the file; in PLY and STL, which do not say, it often is z.
    #[arg(long, default_value = "y", value_name = "AXIS", allow_hyphen_values = true)]
    up: UpAxis,
    /// The axis that points up in the file of --skeleton [default: as --up, as long as its joints then lie within the
    /// model; else y, where they lie within it so].
    #[arg(long, value_name = "AXIS", allow_hyphen_values = true)]
    skeleton_up: Option<UpAxis>,
    /// Refuse models with more triangles.
    #[arg(long, default_value_t = 5_000_000, value_name = "N")]
    max_triangles: usize,
    /// Add a short motion that bends every joint, to see whether the rig works.
    #[arg(long)]
    preview: bool,
    /// Of a folder: leave models out whose result is there already and whole, as after a run that was interrupted. One that
    /// says it was made of another file does not count; with what options it was made is not asked.
    #[arg(long)]
    skip_existing: bool,
    /// Print a line of JSON per file to standard output: what was made, or why it was left out or skipped.
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    overwrite: Overwrite,
    #[command(flatten)]
    device: DeviceArgs,
}

/// By what the best of several rigs is told.
#[derive(Clone, Copy, clap::ValueEnum)]
enum Ranked {
    Likelihood,
    Rewards,
    Consensus,
}

impl From<Ranked> for Rank {
    fn from(rank: Ranked) -> Self {
        match rank {
            Ranked::Likelihood => Self::Likelihood,
            Ranked::Rewards => Self::Rewards,
            Ranked::Consensus => Self::Consensus,
        }
    }
}

/// A format that a rig is written in.
fn scene(told: &str) -> Result<Target, String> {
    let most = if cfg!(feature = "fbx") { "glb or fbx" } else { "glb" };
    match told.to_lowercase().parse::<Target>() {
        Ok(target) if target.holds_scenes() => Ok(target),
        Ok(target) => Err(format!("a rig is written as {most}; `riglab convert` then makes {target} of it")),
        Err(_) if told.eq_ignore_ascii_case("vrm") => Err(format!(
            "a folder's rigs are written as {most}; a VRM is written of one VRM, to an OUT that ends in .vrm, and a GLB of one \
             holds the same"
        )),
        Err(_) => Err(format!("a rig is written as {most}")),
    }
}

/// Which skeleton a rig gets.
enum Bones {
    Predicted { template: Option<String>, names: Option<NameStyle> },
    Given { from: Given, complete: bool },
}

/// Where a skeleton that is given comes from.
enum Given {
    Kept,
    File(PathBuf),
}

impl Given {
    fn of(told: &str) -> Self {
        if is_word(told, "keep") { Self::Kept } else { Self::File(told.into()) }
    }
}

/// Whether a word is meant where a file may stand, too: in another case as long as no file is called so.
fn is_word(told: &str, word: &str) -> bool {
    told == word || (told.eq_ignore_ascii_case(word) && !Path::new(told).exists())
}

impl Bones {
    /// Whether the rig of the input stays, and is given other weights.
    fn keeps_rig(&self) -> bool {
        matches!(self, Self::Given { from: Given::Kept, complete: false })
    }

    fn completed(&self) -> bool {
        matches!(self, Self::Given { complete: true, .. })
    }
}

pub fn rig(args: &RigArgs, threads: usize) -> Result<ExitCode> {
    told(&args.common, || run(&args.common, &bones(args)?, args.weights.as_deref(), threads))
}

pub fn skin(args: &SkinArgs, threads: usize) -> Result<ExitCode> {
    let bones = Bones::Given { from: Given::of(&args.skeleton), complete: false };
    told(&args.common, || run(&args.common, &bones, None, threads))
}

/// With --json, what ends all is a line of it, too.
fn told(args: &Common, work: impl FnOnce() -> Result<ExitCode>) -> Result<ExitCode> {
    work().inspect_err(|e| {
        if args.json {
            say!("{}", serde_json::json!({ "file": args.input.to_string_lossy(), "error": format!("{e:#}") }));
        }
    })
}

fn bones(args: &RigArgs) -> Result<Bones> {
    let predict = is_word(&args.skeleton, "predict");
    Ok(match args.skeleton.as_str() {
        _ if predict && args.complete => {
            bail!(
                "--complete adds joints to a skeleton that is given: say which with --skeleton keep or --skeleton FILE"
            )
        }
        _ if predict => Bones::Predicted { template: args.template.clone(), names: args.names },
        _ if args.template.is_some() => bail!("--template begins a predicted skeleton; leave --skeleton out"),
        _ if args.names.is_some() => {
            bail!("--names is for a predicted skeleton: one that is given keeps its joints' names; leave it out")
        }
        _ if args.complete && !matches!(args.common.rank, Ranked::Consensus) => {
            bail!("--complete takes the joints that draws agree on; leave --rank out")
        }
        given => Bones::Given { from: Given::of(given), complete: args.complete },
    })
}

impl Common {
    fn export(&self) -> ExportOptions {
        ExportOptions { influences: self.influences.into(), frames: self.frames.into() }
    }
}

fn run(args: &Common, bones: &Bones, weights: Option<&Path>, threads: usize) -> Result<ExitCode> {
    if let Some(Err(why)) = args.temperature.map(drawable_at) {
        bail!("--temperature {why}");
    }
    if args.skeleton_up.is_some() && !matches!(bones, Bones::Given { from: Given::File(_), .. }) {
        bail!("--skeleton-up is about the file of --skeleton FILE, which is not given");
    }
    if args.skip_existing && !args.input.is_dir() {
        bail!("--skip-existing is for a folder of models, and {} is none; leave it out", args.input.display());
    }
    let skeleton = match bones {
        Bones::Given { from: Given::File(file), .. } => Some(file.as_path()),
        _ => None,
    };
    let (jobs, unread) = jobs(&args.input, &args.out, args.to)?;
    spare_inputs(&jobs, skeleton)?;
    let (there, jobs): (Vec<_>, Vec<_>) =
        jobs.into_iter().partition(|(from, to)| args.skip_existing && is_there(from, to));
    jobs.iter().try_for_each(|(_, to)| args.overwrite.keep_others(to, written(to)))?;
    if jobs.is_empty() {
        tell_left(args, &there, &unread);
        let all =
            if there.len() == 1 { "the only result is".into() } else { format!("all {} results are", there.len()) };
        let left = if unread.is_empty() { String::new() } else { format!(", {} left out", unread.len()) };
        tell_counts(args, &format!("nothing to do: {all} there already in {}{left}", args.out.display()));
        return Ok(if unread.is_empty() { ExitCode::SUCCESS } else { ExitCode::FAILURE });
    }
    let into = if args.input.is_dir() { Some(args.out.as_path()) } else { jobs[0].1.parent() };
    let remedy = "give --out a place where you may write, or make this one so";
    into.map_or(Ok(()), riglab_files::may_write).map_err(|e| anyhow!("nothing can be written into {e}; {remedy}"))?;
    riglab_torch::init(riglab_torch::Settings { threads });
    let device = args.device.device()?;
    // Before the network is read, which may take long.
    if !args.input.exists() {
        bail!("{}: there is no such file or folder", args.input.display());
    }
    let given = skeleton.map(given::read).transpose()?;
    let reading = args.checkpoint.as_ref().map(|path| Spinner::new(&format!("reading {}", path.display())));
    let mut model = Model::open(args.checkpoint.as_deref(), weights, device)?;
    drop(reading);
    if let Some(beams) = args.beams {
        model.keep_beams(usize::from(beams))?;
    }
    model.suits(args, bones)?;
    let of = args.checkpoint.as_ref().map(|path| path.to_string_lossy());
    let show = command(["checkpoint", "show"].into_iter().chain(of.as_deref()));
    let hint = match (model.draws(), model.card.text.trim().is_empty()) {
        (true, false) => format!("; `{show}` says how far to trust it"),
        // A run of one's own.
        (true, true) => "; `riglab eval` of its run measures how far to trust it".into(),
        (false, _) => String::new(),
    };
    let by =
        model.of_weights().map_or(String::new(), |own| format!("; weights by {}, {} steps", own.name, own.state.step));
    tell!("model: {}, {} steps{by}{hint}", model.card.name, model.card.state.step);
    if !args.input.is_dir() {
        let (from, to) = &jobs[0];
        return one::rig(args, (bones, given.as_ref()), &model, from, to).map(|()| ExitCode::SUCCESS);
    }
    tell_left(args, &there, &unread);
    let mut progress = Progress::new("rigging", jobs.len() as u64, 0);
    let mut failed = 0;
    for (done, (from, to)) in jobs.iter().enumerate() {
        crate::parting::set(format!(
            "interrupted: {done} of {} are done; the same command with --skip-existing goes on",
            counted(jobs.len(), "model")
        ));
        if let Err(e) = one::rig(args, (bones, given.as_ref()), &model, from, to) {
            progress.line(&format!("left out: {e:#}"));
            tell_fault(args, from, &format!("{e:#}"));
            failed += 1;
        }
        progress.set(done as u64 + 1, String::new);
    }
    progress.finish();
    crate::parting::set(String::new());
    let earlier = if there.is_empty() { String::new() } else { format!(", {} already there", there.len()) };
    let (rigged, left) = (jobs.len() - failed, failed + unread.len());
    tell_counts(args, &format!("{rigged} rigged in {}, {left} left out{earlier}", args.out.display()));
    Ok(if left > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Tells who reads lines of JSON which results are there already, and what could not be looked at.
fn tell_left(args: &Common, there: &[(PathBuf, PathBuf)], unread: &[(PathBuf, String)]) {
    for (from, to) in there.iter().filter(|_| args.json) {
        let why = format!("{} is there already", to.display());
        say!("{}", serde_json::json!({ "file": from.to_string_lossy(), "skipped": why }));
    }
    unread.iter().for_each(|(path, why)| tell_fault(args, path, why));
}

/// Tells who reads lines of JSON why a file is left out.
fn tell_fault(args: &Common, file: &Path, why: &str) {
    if args.json {
        say!("{}", serde_json::json!({ "file": file.to_string_lossy(), "error": why }));
    }
}

/// Says what became of a folder; who reads lines of JSON is told it beside them, having each file as one.
fn tell_counts(args: &Common, counts: &str) {
    if args.json { tell!("{counts}") } else { say!("{counts}") }
}

/// What is read and where each is written; and what below a folder cannot be looked at, with the reason.
type Jobs = (Vec<(PathBuf, PathBuf)>, Vec<(PathBuf, String)>);

/// What is written to a file, by its name.
fn written(to: &Path) -> Written {
    match Target::of(to) {
        Ok(target) if is_fbx(to) => Written::Format(target),
        _ => Written::Glb,
    }
}

/// Whether a model's result is there, to its end. Which of several that are called alike has which name depends on the others,
/// so a result of another one, by what it says, is not this one's.
fn is_there(from: &Path, to: &Path) -> bool {
    let target = if is_fbx(to) { Target::of(to).unwrap_or(Target::GLB) } else { Target::GLB };
    target.is_whole(to) && target.made_of(to).is_none_or(|of| of == file_name(from))
}

/// What a result says that it was made of.
fn file_name(from: &Path) -> String {
    from.file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// Refuses to write over a model that is read, or over the file of the skeleton.
fn spare_inputs(jobs: &[(PathBuf, PathBuf)], skeleton: Option<&Path>) -> Result<()> {
    let read = jobs.iter().map(|(from, _)| from.as_path()).chain(skeleton);
    let read: HashSet<PathBuf> = read.filter_map(|file| file.canonicalize().ok()).collect();
    match jobs.iter().find(|(_, to)| to.canonicalize().is_ok_and(|real| read.contains(&real))) {
        Some((from, to)) => bail!(
            "{}, to which the rig of {} would be written, is an input itself, and inputs are never changed; give another --out",
            to.display(),
            from.display()
        ),
        None => Ok(()),
    }
}

fn jobs(input: &Path, out: &Path, to: Option<Target>) -> Result<Jobs> {
    let ending = to.unwrap_or(Target::GLB).ending();
    let same = |a: &Path, b: &Path| a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b));
    if !input.is_dir() {
        let into = out.is_dir() || riglab_files::is_as_of_folder(out);
        let mut name = input.file_stem().unwrap_or_default().to_owned();
        name.push(format!(".{ending}"));
        let told = to;
        let to = if into { out.join(name) } else { out.to_path_buf() };
        let ends = |path: &Path, with: &str| path.extension().is_some_and(|e| e.eq_ignore_ascii_case(with));
        // A VRM is a GLB by another name, and may be called like one.
        let of_vrm = || ends(input, "vrm") || std::fs::read(input).is_ok_and(|bytes| is_vrm(&bytes));
        if !(ends(&to, "glb") || is_fbx(&to) || ends(&to, "vrm") && of_vrm()) {
            bail!(
                "{}: only GLB and FBX are written, and VRM of a VRM; name it .glb (`riglab convert` then makes other formats \
                 of it)",
                to.display()
            );
        }
        if let Some(told) = told.filter(|told| !Target::of(&to).is_ok_and(|of| of == *told)) {
            bail!("{} is no name for a file of {told} (--to): give one that ends in .{ending}", to.display());
        }
        if same(input, &to) {
            bail!("{} is the input itself, which is never changed; give another name", to.display());
        }
        return Ok((vec![(input.to_path_buf(), to)], Vec::new()));
    }
    if out.is_file() || !out.is_dir() && is_model_file(out) {
        bail!("{} is a file, or is called like one; for a folder of models give a folder", out.display());
    }
    if same(input, out) {
        bail!("{} is the folder of the inputs, which are never changed; give another", out.display());
    }
    let found = super::inputs::below(input, out, "model", is_model_file);
    if found.files.is_empty() {
        bail!("{}: no model with the ending {}", input.display(), model_endings().collect::<Vec<_>>().join(", "));
    }
    let jobs = targets(found.files, input, out, ending)?;
    let longer = jobs.iter().filter(|(file, to)| to.file_name() != file.with_extension(ending).file_name());
    let longer: Vec<String> = longer.map(|(_, to)| to.strip_prefix(out).unwrap_or(to).display().to_string()).collect();
    if !longer.is_empty() {
        tell!("note: of models that are called alike, the others are written with their ending: {}", some_of(&longer));
    }
    Ok((jobs, found.unread))
}

/// Where each file of a folder is written: below `out` as it lies below `input`, with the ending of what is written. Of those
/// called alike the one that has it keeps its name, or else the first one; the others keep their ending, too, so that none
/// overwrites another.
fn targets(files: Vec<PathBuf>, input: &Path, out: &Path, ending: &str) -> Result<Vec<(PathBuf, PathBuf)>> {
    let below = |file: &Path| file.strip_prefix(input).map(Path::to_path_buf).context("a file below its folder");
    let has_it = |file: &Path| file.extension().is_some_and(|e| e == ending);
    let with_it: Result<Vec<PathBuf>> = files.iter().filter(|file| has_it(file)).map(|file| below(file)).collect();
    let mut taken: HashSet<PathBuf> = with_it?.into_iter().collect();
    let mut jobs = Vec::with_capacity(files.len());
    for file in files {
        let own = below(&file)?;
        let mut name = own.with_extension(ending);
        if !has_it(&file) && taken.contains(&name) {
            name = own;
            while taken.contains(&name) || !has_it(&name) {
                name.as_mut_os_string().push(format!(".{ending}"));
            }
        }
        taken.insert(name.clone());
        jobs.push((file, out.join(name)));
    }
    Ok(jobs)
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Called {
        #[command(flatten)]
        args: RigArgs,
    }

    #[test]
    fn models_that_are_called_alike_overwrite_none() {
        let in_format = |names: &[&str], ending: &str| {
            let files = names.iter().map(|name| Path::new("in").join(name)).collect();
            let jobs = targets(files, Path::new("in"), Path::new("out"), ending).unwrap();
            jobs.iter().map(|(_, to)| to.strip_prefix("out").unwrap().display().to_string()).collect::<Vec<_>>()
        };
        let of = |names: &[&str]| in_format(names, "glb");
        assert_eq!(of(&["fox.fbx", "fox.glb", "fox.obj"]), ["fox.fbx.glb", "fox.glb", "fox.obj.glb"]);
        assert_eq!(of(&["a/fox.fbx", "a/fox.obj", "fox.obj"]), ["a/fox.glb", "a/fox.obj.glb", "fox.glb"]);
        assert_eq!(of(&["fox.FBX", "fox.v2.obj"]), ["fox.glb", "fox.v2.glb"]);
        assert_eq!(of(&["fox.fbx", "fox.fbx.glb", "fox.glb"]), ["fox.fbx.glb.glb", "fox.fbx.glb", "fox.glb"]);
        assert_eq!(in_format(&["fox.fbx", "fox.glb", "hen.obj"], "fbx"), ["fox.fbx", "fox.glb.fbx", "hen.fbx"]);
    }

    #[test]
    fn what_is_written_is_told_by_name_or_by_option() {
        let dir = tempfile::tempdir().unwrap();
        let (input, folder) = (dir.path().join("fox.v2.obj"), dir.path().join("out/"));
        let name = |out: &Path, to| jobs(&input, out, to).map(|(jobs, _)| jobs[0].1.display().to_string());
        assert!(name(&folder.join(""), None).unwrap().ends_with("/out/fox.v2.glb"));
        let said = |told| scene(told).unwrap_err();
        assert!(
            scene("GLB").is_ok_and(|target| target == Target::GLB)
                && said("blend").starts_with("a rig is written as glb")
        );
        assert!(said("obj").ends_with("`riglab convert` then makes obj of it"), "{}", said("obj"));
        assert!(said("VRM").contains("an OUT that ends in .vrm"), "{}", said("VRM"));
        #[cfg(feature = "fbx")]
        {
            assert!(name(&folder.join(""), Some(Target::FBX)).unwrap().ends_with("/out/fox.v2.fbx"));
            let said = name(Path::new("a.glb"), Some(Target::FBX)).unwrap_err().to_string();
            assert!(said.ends_with("give one that ends in .fbx"), "{said}");
            assert_eq!(name(Path::new("a.FBX"), Some(Target::FBX)).unwrap(), "a.FBX");
        }
    }

    #[test]
    fn a_vrm_is_one_by_what_is_in_it() {
        let dir = tempfile::tempdir().unwrap();
        let (avatar, out) = (dir.path().join("avatar.glb"), dir.path().join("again.vrm"));
        std::fs::write(&avatar, r#"{"asset": {"version": "2.0"}, "extensions": {"VRM": {}}}"#).unwrap();
        assert_eq!(jobs(&avatar, &out, None).unwrap().0[0].1, out);
        std::fs::write(&avatar, r#"{"asset": {"version": "2.0"}, "nodes": [{"name": "VRM"}]}"#).unwrap();
        assert!(jobs(&avatar, &out, None).unwrap_err().to_string().contains("VRM of a VRM"));
    }

    #[cfg(unix)]
    #[test]
    fn no_input_is_written_over_by_whatever_way() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        for name in ["m/sub/a.glb", "m/sub/sub/a.glb", "in/b.glb", "out/none"] {
            std::fs::create_dir_all(at(name).parent().unwrap()).unwrap();
            std::fs::write(at(name), b"glTF").unwrap();
        }
        std::os::unix::fs::symlink("../in/b.glb", at("out/b.glb")).unwrap();
        let spared = |input: &str, out: &str, skeleton: Option<&str>| {
            let (jobs, _) = jobs(&at(input), &at(out), None).unwrap();
            spare_inputs(&jobs, skeleton.map(at).as_deref()).map_err(|e| e.to_string())
        };
        assert!(spared("m/sub", "m", None).unwrap_err().contains("m/sub/a.glb, to which"));
        assert!(spared("in", "out", None).unwrap_err().contains("inputs are never changed"));
        // Nor the skeleton, of a folder or of one model.
        assert_eq!(spared("in", "m/sub", Some("m/sub/a.glb")), Ok(()));
        for (input, out) in [("m/sub/sub", "m/sub"), ("in/b.glb", "m/sub/a.glb")] {
            assert!(spared(input, out, Some("m/sub/a.glb")).unwrap_err().contains("m/sub/a.glb, to which"));
        }
    }

    #[test]
    fn a_result_that_is_cut_off_or_made_of_another_file_is_not_there() {
        let dir = tempfile::tempdir().unwrap();
        let (from, to) = (Path::new("in/fox.obj"), dir.path().join("fox.glb"));
        let json = br#"{"asset":{"version":"2.0"}} "#;
        let length = (20 + json.len()) as u32;
        let head: [&[u8]; 5] =
            [b"glTF", &2u32.to_le_bytes(), &length.to_le_bytes(), &(json.len() as u32).to_le_bytes(), b"JSON"];
        let glb = [&head.concat()[..], json].concat();
        std::fs::write(&to, &glb).unwrap();
        assert!(is_there(from, &to), "it says nothing of what it is of");
        std::fs::write(&to, &glb[..glb.len() - 1]).unwrap();
        assert!(!is_there(from, &to));
        let made = riglab_asset::export::made_of(glb, "fox.obj");
        std::fs::write(&to, &made).unwrap();
        assert!(is_there(from, &to) && !is_there(Path::new("in/fox.glb"), &to));
        // One that has a mark of its own keeps it.
        assert!(riglab_asset::Target::GLB.made_of(&to).is_some_and(|of| of == "fox.obj"));
    }

    #[test]
    fn choices_are_known_in_any_case() {
        let given = ["rig", "a.obj", "-o", "a.glb", "--rank", "Rewards", "--influences", "ALL", "--frames", "Parallel"];
        let args = Called::try_parse_from(given.into_iter().chain(["--names", "VRM", "--up", "Z"])).unwrap().args;
        assert!(matches!(args.common.rank, Ranked::Rewards) && matches!(args.common.influences, Most::All));
        assert!(matches!(args.common.frames, Frames::Parallel));
        assert_eq!((args.names, args.common.up), (Some(NameStyle::Vrm), UpAxis::Z));
        assert!(matches!(Given::of("Keep"), Given::Kept) && matches!(Given::of("keeper"), Given::File(_)));
        // A file is what it is called.
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("KEEP");
        std::fs::write(&file, "").unwrap();
        assert!(!is_word(file.to_str().unwrap(), file.to_str().unwrap().to_lowercase().as_str()));
        assert!(is_word("Predict", "predict") && !is_word("predicted", "predict"));
    }

    #[test]
    fn outputs_never_meet_inputs_or_each_other() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a.obj", "a.glb", "sub/b.FBX", "notes.txt", "out/a.glb"] {
            let path = dir.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"x").unwrap();
        }
        let out = dir.path().join("out");
        let jobs = |input: &Path, out: &Path| super::jobs(input, out, None);
        let (all, _) = jobs(dir.path(), &out).unwrap();
        let mut to: Vec<_> = all.iter().map(|(_, to)| to.strip_prefix(&out).unwrap().to_str().unwrap()).collect();
        to.sort_unstable();
        assert!(to == ["a.glb", "a.glb.glb", "sub/b.glb"] || to == ["a.glb", "a.obj.glb", "sub/b.glb"], "{to:?}");
        let a = dir.path().join("a.glb");
        assert!(jobs(&a, &a).unwrap_err().to_string().contains("never changed"));
        assert!(jobs(&a, &dir.path().join("a.npz")).unwrap_err().to_string().contains("only GLB"));
        assert_eq!(jobs(&dir.path().join("a.obj"), dir.path()).unwrap().0[0].1, a);
        let (avatar, again) = (dir.path().join("a.vrm"), dir.path().join("again.vrm"));
        assert_eq!(jobs(&avatar, &again).unwrap().0[0].1, again);
        assert!(jobs(&a, &again).unwrap_err().to_string().contains("VRM of a VRM"));
        assert!(jobs(dir.path(), dir.path()).unwrap_err().to_string().contains("give another"));
        // Results may go to above the inputs.
        let sub = dir.path().join("sub");
        assert_eq!(jobs(&sub, dir.path()).unwrap().0, [(sub.join("b.FBX"), dir.path().join("b.glb"))]);
    }
}
