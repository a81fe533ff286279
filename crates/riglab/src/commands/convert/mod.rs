//! `riglab convert`

mod beside;
mod corpus;
mod lost;
mod store;

use std::collections::{HashMap, HashSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Result, anyhow, bail};
use riglab_asset::export::{self, ExportOptions, Influences, JointFrames};
use riglab_asset::{
    Character, Filling, ImportOptions, Imported, Target, count_assets, files_read, import, import_each, is_gltf,
    is_model_file, is_rig_file, written_paths,
};
use riglab_core::Asset;
use riglab_data::Tally;
use riglab_files::make_folder_of;

use super::alike::Notes;
use super::earlier::{Overwrite, Written};
use super::glb::{Frames, Most};
use super::inputs;
use super::of_files::OfFiles;
use super::{in_line, place_to_write};
use beside::{Beside, Known, name_in};
use lost::Lost;
use riglab_report::counted;
use store::{note_place, spare, spare_inputs, store, warn};

/// Turn rigged files of any format that is read into any that is written.
///
/// Written are glb (.vrm, where what is written is one), obj (the mesh alone), rignet (text and OBJ), puppeteer (text and OBJ),
/// puppeteer-h5, articulation-xl, unirig (raw_data.npz), skintokens, anymate and fbx. The name of OUT tells
/// which; an npz that is not called raw_data.npz, a txt that does not end in _rig.txt, and an h5 made of a corpus need
/// --to. A folder or a file of several assets goes into a folder, a file an asset, or into one file of a format that
/// holds several, where names keep the folders of their files, which come again when it goes into a folder. Where a format has Z up, axes are turned.
/// glTF and VRM become a GLB with all they had: materials, pictures, morph targets, motions, extensions.
/// Into an FBX go nodes, meshes, weights, materials with their pictures, morph targets and motions of a glTF, VRM or FBX; of
/// corpora mesh, skeleton, weights and motions.
/// Anything a format cannot hold is reported on standard error, and so are coordinates beyond what the format's own loaders
/// expect (see --fit). A corpus is written as its assets; a manifest.json and a split.json beside them, where none are yet, say
/// what it knows of sources, licences, authors, categories and splits, and so they do beside what a folder with such lists is
/// written to.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab convert fox.glb fox/raw_data.npz
  riglab convert fox_rig.txt fox.glb
  riglab convert fox.gltf fox.glb --influences 4
  riglab convert articulation_xlv2_test.npz rigs/ --to glb
  riglab convert rigs/ rigs.npz --to articulation-xl --fit
  riglab convert Anymate_test.pt horse.glb --item 12
  riglab convert corpus.h5 rigs/ --to glb")]
pub struct Args {
    /// A file, a folder of files with those below it, or a corpus.
    input: PathBuf,
    /// The file or folder to write.
    #[arg(value_parser = place_to_write())]
    out: PathBuf,
    /// The format to write, where the ending of OUT does not tell.
    #[arg(long, value_name = "FORMAT")]
    to: Option<Target>,
    /// Of a corpus or a file of several assets this one, counted from 0.
    #[arg(long, value_name = "N")]
    item: Option<usize>,
    /// Of a file of several characters this one: its number, from 0, or the name of its root.
    #[arg(long, value_name = "WHICH")]
    character: Option<Character>,
    /// Repair what takes a guess: joints of a rig text beside its tree go below the root, `NAME_dup_K`
    /// joints of RigNet's predictions back into NAME.
    #[arg(long)]
    repair: bool,
    /// For GLB and FBX: most joints that may influence a vertex; the largest weights stay [default: all].
    #[arg(long, value_enum, ignore_case = true)]
    influences: Option<Most>,
    /// For GLB and FBX from other formats than glTF and VRM, whose joints stay turned as they are: orientation of the joints at
    /// rest [default: parallel].
    #[arg(long, value_enum, ignore_case = true)]
    frames: Option<Frames>,
    /// Move and scale each asset as a whole into the cube that the format's own loaders expect, which is 0.5 in each
    /// direction for articulation-xl, 0.9995 for puppeteer-h5 and 1 for anymate. Without it all coordinates stay.
    #[arg(long)]
    fit: bool,
    #[command(flatten)]
    overwrite: Overwrite,
}

impl Args {
    /// An asset as it is written: with --fit in the cube of the format.
    fn placed(&self, asset: Asset, target: Target) -> Asset {
        match self.fit.then(|| target.fitted(&asset.rig)).flatten() {
            Some(rig) => Asset { rig, ..asset },
            None => asset,
        }
    }

    /// Refuses to write over what riglab did not write.
    fn keep_others(&self, out: &Path, target: Target) -> Result<()> {
        let keep = |path: &PathBuf| self.overwrite.keep_others(path, Written::Format(target));
        written_paths(out, target).iter().try_for_each(keep)
    }

    /// An option that is given and says how models are read.
    fn of_models(&self) -> Option<&'static str> {
        let given = [(self.character.is_some(), "--character"), (self.repair, "--repair")];
        given.into_iter().find(|(given, _)| *given).map(|(_, option)| option)
    }

    /// Where --frames turns no joint: a glTF keeps its own, but for one of several characters, which is written alone.
    fn frames_left(&self, files: &[PathBuf]) -> Option<String> {
        self.frames.filter(|_| self.character.is_none())?;
        let own: Vec<_> = files.iter().filter(|file| is_gltf(file)).collect();
        let whose = match own[..] {
            [] => return None,
            [one] => one.display().to_string(),
            _ => counted(own.len(), "glTF file"),
        };
        Some(format!("--frames is for files of other formats: the joints of {whose} stay turned as they are"))
    }

    fn import(&self) -> ImportOptions {
        let (item, character, repair) = (self.item, self.character.clone(), self.repair);
        ImportOptions { item, character, repair, ..ImportOptions::default() }
    }

    fn export(&self) -> ExportOptions {
        let influences = self.influences.map_or(Influences::All, Into::into);
        let frames = self.frames.map_or(JointFrames::Parallel, Into::into);
        ExportOptions { influences, frames }
    }
}

pub fn run(args: &Args) -> Result<ExitCode> {
    if args.input.is_dir() && args.item.is_some() {
        bail!("{} is a folder: --item chooses an asset of a corpus or of one file; give that", args.input.display());
    }
    let options = args.import();
    let corpus = corpus::open(&args.input);
    if let (Some(_), Some(option)) = (&corpus, args.of_models()) {
        bail!("{option} is for files of models: the assets of a corpus were read before");
    }
    let several = args.input.is_dir()
        || args.item.is_none()
            && match &corpus {
                Some(corpus) => corpus.len() > 1,
                None => count_assets(&args.input)? > 1,
            };
    let into_folder = args.out.is_dir() || riglab_files::is_as_of_folder(&args.out);
    let target = match args.to {
        Some(target) => target,
        None if into_folder => bail!("{} is a folder; say with --to which format to write", args.out.display()),
        None if corpus.is_some() && Target::of(&args.out).is_ok_and(|of| of == Target::PUPPETEER_H5) => bail!(
            "{} could be a corpus or a file of Puppeteer's: say --to puppeteer-h5 for the latter; corpora are put together by \
             `riglab dataset merge`",
            args.out.display()
        ),
        None => Target::of(&args.out)?,
    };
    let (files, unread) =
        if args.input.is_dir() { rigged(&args.input, &args.out, target)? } else { (vec![args.input.clone()], 0) };
    // A VRM is a GLB, and what has no ending may be a folder.
    let fits = |of: &std::ffi::OsStr| {
        of.eq_ignore_ascii_case(target.ending()) || target == Target::GLB && of.eq_ignore_ascii_case("vrm")
    };
    if !into_folder && args.out.extension().is_some_and(|of| !fits(of)) {
        let (out, ending) = (args.out.display(), target.ending());
        bail!("{out} is no name for a file of {target} (--to): give a name that ends in .{ending}");
    }
    // A file without an ending would not be known again.
    if !into_folder && args.out.extension().is_none() && (!several || target.holds_several()) {
        let (out, ending) = (args.out.display(), target.ending());
        bail!("{out} has no ending: give a name that ends in .{ending}, or a folder with / at its end");
    }
    if !target.holds_scenes() && (args.influences.is_some() || args.frames.is_some()) {
        bail!("--influences and --frames are for GLB and FBX; {target} is written as the rig is");
    }
    if let Some(note) = args.frames_left(&files) {
        tell!("note: {note}");
    }
    if args.fit && !target.has_cube() {
        let with: Vec<_> = Target::ALL.iter().filter(|of| of.has_cube()).map(|of| of.name()).collect();
        bail!("--fit is for formats whose own loaders expect a cube: {}; {target} is of any size", with.join(", "));
    }
    let own_folder = into_folder || several && !target.holds_several();
    // A name without an ending is a folder's where a file cannot be meant.
    if own_folder && !into_folder && args.out.extension().is_some() {
        bail!(
            "{} is a file, but {target} holds one asset a file; give a folder, or choose one with --item",
            args.out.display()
        );
    }
    let place = if own_folder { Some(args.out.as_path()) } else { args.out.parent() };
    let remedy = "give OUT a place where you may write, or make this one so";
    place.map_or(Ok(()), riglab_files::may_write).map_err(|e| anyhow!("nothing can be written into {e}; {remedy}"))?;
    // What is read is never written over, nor the other half of a pair.
    let inputs: HashSet<PathBuf> =
        files.iter().flat_map(|file| files_read(file)).filter_map(|file| file.canonicalize().ok()).collect();
    if several && own_folder {
        return match &corpus {
            Some(corpus) => corpus::into(corpus, args, target),
            None => into(args, (&files, unread), target, &options, &inputs),
        };
    }
    if let Some(corpus) = &corpus {
        spare_inputs(&inputs, &args.out, target)?;
        return match several {
            true => corpus::together(corpus, args, target),
            false => corpus::to(corpus, args, into_folder, target),
        };
    }
    if several {
        return together(args, (&files, unread), target, &options, &inputs);
    }
    let imported = import(&args.input, &options)?;
    let own = own_name(&imported, &args.input);
    let out = if into_folder { place_of(&args.out, own, 1, target) } else { args.out.clone() };
    make_folder_of(&out)?;
    let (mut lost, mut notes) = (Lost::default(), Notes::default());
    store(imported, &out, target, args, &inputs, (&mut lost, &mut notes))?;
    notes.tell();
    lost.tell(&args.input, target);
    written_paths(&out, target).iter().for_each(|path| say!("{}", in_line(path.display())));
    Ok(ExitCode::SUCCESS)
}

/// Every asset into a file of its own. `unread`: how many files could not be looked at, which was told.
fn into(
    args: &Args,
    (files, unread): (&[PathBuf], usize),
    target: Target,
    options: &ImportOptions,
    inputs: &HashSet<PathBuf>,
) -> Result<ExitCode> {
    let (out, input) = (&args.out, &args.input);
    let (mut written, mut failed, mut lost, mut notes) = (0, unread, Lost::default(), Notes::default());
    let (known, mut beside) = (input.is_dir().then(|| Known::of(input)).transpose()?, Beside::default());
    let mut taken: HashSet<PathBuf> = HashSet::new();
    // Where files land that have the target's ending already: they keep their names, whichever come first.
    let below =
        |file: &Path| file.parent().and_then(|f| f.strip_prefix(input).ok()).map_or(out.clone(), |f| out.join(f));
    let of = |file: &Path| Some(below(file).join(file_name(&file.file_stem()?.to_string_lossy(), target)));
    let has = |file: &Path| of(file).filter(|place| place.file_name() == file.file_name());
    let kept: HashSet<PathBuf> = files.iter().filter_map(|file| has(file)).collect();
    let mut broken = Ok(());
    let progress = OfFiles::new("converting", files.len());
    let set = |done, of| progress.set(done, of);
    let tally = Tally::new(files.len(), 0, &set);
    for file in files {
        let count = count_assets(file).unwrap_or(1);
        let mut open = tally.open(count);
        // Folders below the input come again below the output.
        let (folder, has) = (below(file), has(file));
        import_each(file, options, |imported| {
            open.one();
            let imported = match imported {
                Ok(imported) => imported,
                Err(e) => {
                    tell!("left out: {e}");
                    failed += 1;
                    return ControlFlow::Continue(());
                }
            };
            let own = own_name(&imported, file).to_owned();
            let about = known.as_ref().map(|known| {
                let its = (count > 1).then_some(imported.name.as_str());
                known.about(file, its, &imported.provenance)
            });
            let mut place = place_of(&folder, &own, 1, target);
            // Two assets of one name, as a.glb and a.vrm make, do not overwrite each other.
            let mut again = 1;
            let free = |place: &Path| {
                let others = kept.contains(place) && has.as_deref() != Some(place);
                !others && !written_paths(place, target).iter().any(|path| taken.contains(path))
            };
            while !free(&place) {
                again += 1;
                place = place_of(&folder, &own, again, target);
            }
            if again > 1 {
                let name = in_line(place.strip_prefix(&folder).unwrap_or(&place).display());
                tell!("note: {}: written as {name}, as another file has its name", file.display());
            }
            taken.extend(written_paths(&place, target));
            let stored = make_folder_of(&place)
                .map_err(anyhow::Error::from)
                .and_then(|()| store(imported, &place, target, args, inputs, (&mut lost, &mut notes)));
            match stored {
                Ok(()) => {
                    written += 1;
                    if let Some((split, from)) = &about {
                        beside.add_file(out, &place, split, from);
                    }
                }
                // The disk: the next will not go either.
                Err(e) if is_io(&e) => {
                    broken = Err(e);
                    return ControlFlow::Break(());
                }
                Err(e) => {
                    tell!("left out: {e:#}");
                    failed += 1;
                }
            }
            ControlFlow::Continue(())
        });
        if broken.is_err() {
            break;
        }
    }
    progress.finish();
    broken?;
    beside.write(out, "the folder")?;
    notes.tell();
    lost.tell(input, target);
    say!("{written} written to {}, {failed} left out", out.display());
    Ok(if failed > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

fn is_io(e: &anyhow::Error) -> bool {
    e.chain().any(|cause| {
        cause.is::<std::io::Error>() || matches!(cause.downcast_ref(), Some(riglab_asset::WriteError::Io { .. }))
    })
}

/// All assets into one file, written as they are read.
fn together(
    args: &Args,
    (files, unread): (&[PathBuf], usize),
    target: Target,
    options: &ImportOptions,
    inputs: &HashSet<PathBuf>,
) -> Result<ExitCode> {
    let out = &args.out;
    spare(inputs, out, target, args)?;
    make_folder_of(out)?;
    let mut filling = Filling::new(out, target)?;
    let (mut failed, mut broken) = (unread, Ok(()));
    let known = args.input.is_dir().then(|| Known::of(&args.input)).transpose()?;
    // The names that were written, with what is known of each.
    let (mut written, mut about) = (Vec::new(), Vec::new());
    let (mut lost, mut notes) = (Lost::default(), Notes::default());
    let mut names = Names::default();
    let progress = OfFiles::new("reading", files.len());
    let set = |done, of| progress.set(done, of);
    let tally = Tally::new(files.len(), 0, &set);
    for file in files {
        let count = count_assets(file).unwrap_or(1);
        let (one_of_several, mut open) = (known.is_some() && count > 1, tally.open(count));
        import_each(file, options, |imported| {
            open.one();
            let mut with = None;
            if let Ok(imported) = &imported {
                warn(imported);
                if imported.rig().is_some() {
                    note_place(imported, &mut notes);
                    with = Some(lost.clone().with(imported, target));
                }
            }
            let placed = imported.and_then(Imported::into_asset).map(|asset| args.placed(asset, target));
            let held = |asset: Asset| target.holds(&asset).map(|()| asset).map_err(anyhow::Error::from);
            match placed.map_err(anyhow::Error::from).and_then(held) {
                Ok(mut asset) => {
                    let its = one_of_several.then_some(asset.name.as_str());
                    about.extend(known.as_ref().map(|known| known.about(file, its, &asset.provenance)));
                    let below = if known.is_some() { with_folders(&args.input, file, &asset.name) } else { asset.name };
                    asset.name = names.free(&below);
                    if asset.name != below {
                        let file = file.display();
                        tell!("note: {file}: written as `{}`, as another one is called `{below}`", asset.name);
                    }
                    broken = filling.add(&asset);
                    if broken.is_err() {
                        return ControlFlow::Break(());
                    }
                    written.push(asset.name);
                    // Of what is left out nothing else is lost.
                    lost = with.unwrap_or_else(|| std::mem::take(&mut lost));
                }
                Err(e) => {
                    tell!("left out: {e}");
                    failed += 1;
                }
            }
            ControlFlow::Continue(())
        });
        if broken.is_err() {
            break;
        }
    }
    broken?;
    progress.finish();
    if written.is_empty() {
        bail!("none of {} gave a rig", counted(files.len(), "file"));
    }
    for note in filling.end()? {
        tell!("note: {note}");
    }
    notes.tell();
    let mut beside = Beside::default();
    for (name, (split, from)) in written.iter().zip(&about) {
        beside.add(&name_in(out, name, written.len()), split, from);
    }
    beside.write_beside(out, "the folder")?;
    lost.tell(&args.input, target);
    say!("{}: {}, {failed} left out", out.display(), counted(written.len(), "asset"));
    Ok(if failed > 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// What an asset of a folder's file is called among those of other files: folders below the input stay before its name, as a
/// corpus of the folder has them. One that is called as its folder, as those of UniRig are, has that once.
fn with_folders(input: &Path, file: &Path, name: &str) -> String {
    let is_folders = |folder: &&Path| {
        folder.file_name().is_some_and(|own| own == name) && file.file_stem().is_some_and(|stem| stem != name)
    };
    let folder = file.parent().and_then(|folder| Some(folder).filter(is_folders).map_or(Some(folder), Path::parent));
    let folders = folder.and_then(|folder| folder.strip_prefix(input).ok());
    let folders = folders.into_iter().flat_map(Path::iter).map(|step| step.to_string_lossy().into_owned());
    folders.chain([name.to_owned()]).collect::<Vec<_>>().join("/")
}

/// Names that are taken, with the last number that was put behind each.
#[derive(Default)]
struct Names(HashMap<String, usize>);

impl Names {
    /// A name, with a number where it is taken.
    fn free(&mut self, name: &str) -> String {
        let mut again = self.0.get(name).copied().unwrap_or(0);
        loop {
            again += 1;
            let free = if again > 1 { format!("{name}-{again}") } else { name.to_owned() };
            if again == 1 || !self.0.contains_key(&free) {
                self.0.insert(name.to_owned(), again);
                self.0.entry(free.clone()).or_insert(1);
                return free;
            }
        }
    }
}

/// What an asset of a file is called as a file. One of several has the name that it was given there, which is that of a file
/// where riglab wrote it.
fn own_name<'a>(imported: &'a Imported, file: &Path) -> &'a str {
    match *imported.provenance.source == *file.to_string_lossy() {
        true => &imported.name,
        false => corpus::without_ending(&imported.name),
    }
}

/// Where the `again`th asset of a name is written: one file of a folder's assets calls them by the folders that they had.
/// Names come from files and may lead anywhere: steps out of the folder are dropped.
fn place_of(folder: &Path, name: &str, again: usize, target: Target) -> PathBuf {
    let mut steps: Vec<&str> = name.split('/').filter(|step| !["", ".", ".."].contains(step)).collect();
    let own = steps.pop().unwrap_or_default();
    let folders: PathBuf = steps.into_iter().map(plain).collect();
    folder.join(folders).join(numbered(own, again, target))
}

/// A file name for an asset.
fn file_name(name: &str, target: Target) -> String {
    numbered(name, 1, target)
}

/// The same for the `again`th asset of a name.
fn numbered(name: &str, again: usize, target: Target) -> String {
    // After what was cut off, or names that begin alike would stay alike.
    let number = if again > 1 { format!("-{again}") } else { String::new() };
    format!("{}{number}{}", plain(name), target.suffix())
}

/// A name as that of a file or folder.
fn plain(name: &str) -> String {
    let plain = |c: char| if c.is_control() || "/\\:*?\"<>|".contains(c) { '_' } else { c };
    let mut plain: String = name.chars().map(plain).collect();
    // File systems take 255 bytes.
    plain.truncate((0..=150.min(plain.len())).rev().find(|at| plain.is_char_boundary(*at)).unwrap_or(0));
    if plain.is_empty() || plain.starts_with('.') {
        plain.insert(0, '_');
    }
    plain
}

/// Rigged files of a folder and those below it, without those that an earlier call wrote there; and how many could not be
/// looked at.
fn rigged(folder: &Path, out: &Path, target: Target) -> Result<(Vec<PathBuf>, usize)> {
    let found = inputs::below(folder, out, "file", |path| is_rig_file(path) || is_model_file(path));
    let (files, bare): (Vec<PathBuf>, Vec<PathBuf>) = found.files.into_iter().partition(|path| is_rig_file(path));
    let bare = bare_names(folder, &files, bare);
    if !bare.is_empty() {
        let named = super::some_of(&bare);
        tell!("note: {}: not converted, as their formats hold no rig: {named}; give them one by one", folder.display());
    }
    if files.is_empty() {
        bail!("{}: no rigged file in this folder or below it", folder.display());
    }
    let files = if export::same_file(folder, out) { to_convert(files, target) } else { files };
    Ok((files, found.unread.len()))
}

/// Of the files of a folder that is converted into itself those to be converted: what riglab wrote there in the format is
/// there already. Where there is nothing else, that is all.
fn to_convert(files: Vec<PathBuf>, target: Target) -> Vec<PathBuf> {
    let (own, others): (Vec<PathBuf>, Vec<PathBuf>) = files.into_iter().partition(|file| target.is_own(file));
    let Some(first) = own.first().filter(|_| !others.is_empty()) else { return [own, others].concat() };
    tell!(
        "note: not taken as input: {} of {target} that riglab wrote, such as {}",
        counted(own.len(), "file"),
        first.display()
    );
    others
}

/// Which of `bare` belong to none of the rigged files, as the OBJ of a rig text does: by their places below the folder.
pub(super) fn bare_names(folder: &Path, rigged: &[PathBuf], mut bare: Vec<PathBuf>) -> Vec<String> {
    let read: HashSet<PathBuf> = rigged.iter().flat_map(|file| files_read(file)).collect();
    bare.retain(|path| !read.contains(path));
    bare.iter().map(|path| path.strip_prefix(folder).unwrap_or(path).display().to_string()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn meshes_without_a_rig_are_named_and_those_of_rig_texts_are_not() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        std::fs::create_dir(at("sub")).unwrap();
        for name in ["a.glb", "sub/b.obj", "c.obj", "d.stl"] {
            std::fs::write(at(name), "v 0 0 0\n").unwrap();
        }
        std::fs::write(at("c_rig.txt"), "joints a 0 0 0\nroot a\n").unwrap();
        let (rigged, unread) = rigged(dir.path(), &at("out"), Target::GLB).unwrap();
        assert_eq!(unread, 0);
        assert_eq!(rigged, [at("a.glb"), at("c_rig.txt")]);
        let bare = ["c.obj", "d.stl", "sub/b.obj"].map(at).to_vec();
        assert_eq!(bare_names(dir.path(), &rigged, bare), ["d.stl", "sub/b.obj"]);
    }

    #[test]
    fn frames_that_turn_no_joint_are_told() {
        #[derive(clap::Parser)]
        struct Line {
            #[command(flatten)]
            args: Args,
        }
        let dir = tempfile::tempdir().unwrap();
        let files = ["a.glb", "b.glb", "c_rig.txt"].map(|name| dir.path().join(name));
        files.iter().for_each(|file| std::fs::write(file, b"glTF").unwrap());
        std::fs::write(&files[2], "joints a 0 0 0\nroot a\n").unwrap();
        let told = |options: &[&str], files: &[PathBuf]| {
            let line = ["convert", "in", "out.glb"].iter().chain(options);
            <Line as clap::Parser>::parse_from(line).args.frames_left(files)
        };
        assert!(told(&["--frames", "bone"], &files[..1]).unwrap().contains("the joints of /"));
        assert!(told(&["--frames", "parallel"], &files).unwrap().contains("the joints of 2 glTF files"));
        assert_eq!([told(&[], &files), told(&["--frames", "bone"], &files[2..])], [None, None]);
        assert_eq!(told(&["--frames", "bone", "--character", "1"], &files), None);
    }

    #[test]
    fn assets_of_one_name_keep_their_folders_or_get_numbers() {
        let of = |file: &str| with_folders(Path::new("in"), Path::new(file), "fox");
        assert_eq!([of("in/fox.glb"), of("in/a/fox.glb"), of("in/a/b/fox.glb")], ["fox", "a/fox", "a/b/fox"]);
        assert_eq!([of("in/fox/raw_data.npz"), of("in/a/fox/raw_data.npz")], ["fox", "a/fox"]);
        assert_eq!([of("in/fox/fox.glb"), of("fox/raw_data.npz")], ["fox/fox", "fox"]);
        let mut names = Names::default();
        let free = ["fox", "fox-2", "fox", "fox", "fox-2", "cat"].map(|name| names.free(name));
        assert_eq!(free, ["fox", "fox-2", "fox-3", "fox-4", "fox-2-2", "cat"]);
    }

    #[test]
    fn names_from_files_stay_in_their_folder() {
        assert_eq!(file_name("ab/../biped", Target::GLB), "ab_.._biped.glb");
        assert_eq!(file_name("..", Target::RIGNET), "_.._rig.txt");
        assert_eq!(file_name("", Target::ANYMATE), "_.pt");
        let long = "骨".repeat(100);
        assert_eq!(file_name(&long, Target::GLB).len(), 154);
        assert_eq!(numbered(&long, 2, Target::GLB), file_name(&long, Target::GLB).replace(".glb", "-2.glb"));
        assert_eq!(numbered("a", 3, Target::RIGNET), "a-3_rig.txt");
        let at = |name: &str| place_of(Path::new("out"), name, 1, Target::GLB).to_string_lossy().into_owned();
        assert_eq!([at("a/b/fox"), at("/etc/./../fox")], ["out/a/b/fox.glb", "out/etc/fox.glb"]);
        assert_eq!([at("a\\..:/.x/\u{0}y"), at("a/.."), at("")], ["out/a_.._/_.x/_y.glb", "out/a.glb", "out/_.glb"]);
        assert_eq!(at(&format!("{long}/fox")).len(), "out/".len() + 150 + "/fox.glb".len());
    }
}
