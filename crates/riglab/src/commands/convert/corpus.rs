//! The assets of a corpus as files.

use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_asset::{Filling, Format, ImportOptions, Target, export, write, write_mesh, written_paths};
use riglab_core::{Asset, Provenance};
use riglab_data::{Corpus, checksums};
use riglab_files::make_folder_of;
use riglab_train::Progress;

use super::beside::{Beside, name_in};
use super::store::keep_vrm;
use super::{Args, Lost, Notes, file_name, in_line, is_io, numbered};

/// The corpus at `path`, if it is one.
pub fn open(path: &Path) -> Option<Corpus> {
    Corpus::open(path).ok()
}

/// Every asset into a file of its own, named as the asset without the ending that its file had.
pub fn into(corpus: &Corpus, args: &Args, target: Target) -> Result<ExitCode> {
    let (mut written, mut failed, mut lost, mut notes) = (0, 0, Lost::default(), Notes::default());
    let (splits, bare) = (corpus.texts("split")?, HashSet::<usize>::from_iter(corpus.bare()?));
    let originals = Originals::of(corpus)?;
    let mut told = Beside::default();
    let mut taken: HashSet<PathBuf> = HashSet::new();
    let own = corpus.names()?.iter().filter_map(|name| own_path(name, &args.out, target));
    let own: HashSet<PathBuf> = own.collect();
    let mut progress = Progress::new("writing", corpus.len() as u64, 0);
    for (index, split) in splits.iter().enumerate() {
        let stored = corpus.verified(index).map_err(anyhow::Error::from).and_then(|asset| {
            let bare = bare.contains(&index);
            if bare && !holds_bare(target) {
                bail!("{}: {NO_RIG}", asset.name);
            }
            let (folder, stem) = place(&asset.name);
            let named = |again| args.out.join(&folder).join(numbered(&stem, again, target));
            let has = own_path(&asset.name, &args.out, target);
            let kept = |path: &PathBuf| own.contains(path) && has.as_ref() != Some(path);
            let free = |path: &PathBuf| !kept(path) && !written_paths(path, target).iter().any(|p| taken.contains(p));
            let path = (1..).map(named).find(free).context("no name is left")?;
            if path != named(1) {
                tell!("note: {}: written as {}, as another asset has its name", asset.name, in_line(path.display()));
            }
            taken.extend(written_paths(&path, target));
            originals.keep(&path, target, args)?;
            make_folder_of(&path)?;
            let asset = args.placed(asset, target);
            store(&asset, bare, &path, target, args, &mut notes)?;
            told.add_file(&args.out, &path, split, &asset.provenance);
            lost = std::mem::take(&mut lost).with_asset(&asset, target);
            Ok(())
        });
        match stored {
            Ok(()) => written += 1,
            // The disk: the next will not go either.
            Err(e) if is_io(&e) => return Err(e),
            Err(e) => {
                tell!("left out: {e:#}");
                failed += 1;
            }
        }
        progress.set(index as u64 + 1, String::new);
    }
    progress.finish();
    told.write(&args.out, "the corpus")?;
    notes.tell();
    lost.tell(&args.input, target);
    say!("{written} written to {}, {failed} left out", args.out.display());
    Ok(if failed > 0 || written == 0 { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// Where an asset lands whose file had the target's ending already: it keeps its name, whichever comes first.
fn own_path(name: &str, out: &Path, target: Target) -> Option<PathBuf> {
    let (folder, stem) = place(name);
    let file = file_name(&stem, target);
    (Path::new(name).file_name()? == file.as_str()).then(|| out.join(folder).join(file))
}

/// One asset.
pub fn to(corpus: &Corpus, args: &Args, into_folder: bool, target: Target) -> Result<ExitCode> {
    let index = match args.item {
        Some(item) if item >= corpus.len() => {
            bail!("{}: there is no asset {item}: the corpus has {}", args.input.display(), corpus.len())
        }
        Some(item) => item,
        None if corpus.is_empty() => bail!("{}: the corpus has no asset", args.input.display()),
        None => 0,
    };
    let bare = corpus.bare()?.contains(&index);
    if bare && !holds_bare(target) {
        tell!("left out: {}: {NO_RIG}", corpus.names()?[index]);
        bail!("{}: the corpus has no rig to write", args.input.display());
    }
    let asset = args.placed(corpus.verified(index)?, target);
    let out = match into_folder {
        true => {
            let (folder, stem) = place(&asset.name);
            args.out.join(folder).join(file_name(&stem, target))
        }
        false => args.out.clone(),
    };
    Originals::of(corpus)?.keep(&out, target, args)?;
    make_folder_of(&out)?;
    let mut notes = Notes::default();
    store(&asset, bare, &out, target, args, &mut notes)?;
    // A single file may go anywhere, where others' lists stand or would be astray.
    if args.item.is_none() && into_folder {
        let mut told = Beside::default();
        told.add_file(&args.out, &out, &corpus.texts("split")?[index], &asset.provenance);
        told.write_in(&args.out, "the corpus")?;
    }
    notes.tell();
    Lost::default().with_asset(&asset, target).tell(&args.input, target);
    say!("{}", in_line(out.display()));
    Ok(ExitCode::SUCCESS)
}

/// All into one file, written as they are read. What the format has no form for is left out.
pub fn together(corpus: &Corpus, args: &Args, target: Target) -> Result<ExitCode> {
    let (out, count) = (&args.out, corpus.len());
    Originals::of(corpus)?.keep(out, target, args)?;
    make_folder_of(out)?;
    let (bare, names) = (HashSet::<usize>::from_iter(corpus.bare()?), corpus.names()?);
    let mut filling = Filling::new(out, target)?;
    let (mut written, mut lost) = (Vec::new(), Lost::default());
    let mut progress = Progress::new("reading", count as u64, 0);
    for (index, name) in names.iter().enumerate() {
        if bare.contains(&index) && !holds_bare(target) {
            tell!("left out: {name}: {NO_RIG}");
        } else {
            // As it is written: rounding may put joints into one place that were a hair apart.
            let asset = args.placed(corpus.verified(index)?, target);
            match target.holds(&asset) {
                Ok(()) => {
                    filling.add(&asset)?;
                    lost = lost.with_asset(&asset, target);
                    written.push((index, asset.name, asset.provenance));
                }
                Err(e) => tell!("left out: {e}"),
            }
        }
        progress.set(index as u64 + 1, String::new);
    }
    progress.finish();
    if written.is_empty() {
        bail!("{}: the corpus has no rig to write", args.input.display());
    }
    for note in filling.end()? {
        tell!("note: {note}");
    }
    beside(corpus, &written, out)?;
    lost.tell(&args.input, target);
    say!("{}", in_line(out.display()));
    Ok(if written.len() == count { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Writes beside a file of these assets of a corpus, by their numbers there, what the file cannot say of them.
fn beside(corpus: &Corpus, assets: &[(usize, String, Provenance)], out: &Path) -> Result<()> {
    let splits = corpus.texts("split")?;
    let mut told = Beside::default();
    for (number, name, from) in assets {
        told.add(&name_in(out, name, assets.len()), &splits[*number], from);
    }
    told.write_beside(out, "the corpus")
}

const NO_RIG: &str = "a mesh without a rig, which only glb, fbx and obj can hold";

/// Whether a mesh without a rig can be written so.
fn holds_bare(target: Target) -> bool {
    target.holds_scenes() || target == Target::OBJ
}

/// The files that a corpus was made of, by their checksums: they may have looks and motions that no corpus holds.
struct Originals(HashSet<String>);

impl Originals {
    fn of(corpus: &Corpus) -> Result<Self> {
        Ok(Self(corpus.texts("checksum")?.into_iter().filter(|sum| !sum.is_empty()).collect()))
    }

    /// Refuses to write over one of them, and over what riglab did not write.
    fn keep(&self, out: &Path, target: Target, args: &Args) -> Result<()> {
        let original = |path: &Path| checksums(path).iter().any(|sum| self.0.contains(sum));
        match written_paths(out, target).iter().find(|path| path.is_file() && original(path)) {
            Some(path) => bail!(
                "{} is there already and is what the corpus was made of; give another name or folder to write, or take it \
                 away first",
                path.display()
            ),
            None => args.keep_others(out, target),
        }
    }
}

/// `bare`: what a corpus holds of a mesh without a rig is a joint for all of it, which is nobody's.
fn store(asset: &Asset, bare: bool, out: &Path, target: Target, args: &Args, notes: &mut Notes) -> Result<()> {
    if target.holds_scenes() {
        let exported = export::moving(asset, &args.export())?;
        let exported = match bare {
            true => export::strip_bytes("mesh.glb", &exported.bytes, None, &ImportOptions::default())?,
            false => exported,
        };
        let bytes = in_format(exported.bytes, target).with_context(|| asset.name.clone())?;
        keep_vrm(out, &bytes, &asset.name)?;
        riglab_files::write(out, &bytes).with_context(|| format!("{}", out.display()))?;
        exported.notes.iter().for_each(|note| notes.exported(&asset.name, note));
    } else if target == Target::OBJ && bare {
        write_mesh(asset.rig.mesh(), out)?;
    } else {
        let told = write(std::slice::from_ref(asset), out, target)?;
        told.iter().for_each(|note| notes.written(&asset.name, note));
    }
    Ok(())
}

/// A GLB in a format of scenes.
#[cfg(feature = "fbx")]
fn in_format(glb: Vec<u8>, target: Target) -> Result<Vec<u8>> {
    Ok(if target == Target::FBX { riglab_asset::glb_to_fbx(&glb)?.bytes } else { glb })
}

#[cfg(not(feature = "fbx"))]
fn in_format(glb: Vec<u8>, _: Target) -> Result<Vec<u8>> {
    Ok(glb)
}

/// Folders and name of an asset: those of the file it was imported from, without the file's ending.
/// Steps that lead out of the folder are dropped.
fn place(name: &str) -> (PathBuf, String) {
    let mut steps: Vec<&str> = name.split('/').filter(|s| !["", ".", ".."].contains(s)).collect();
    let own = without_ending(steps.pop().unwrap_or("asset"));
    (steps.into_iter().collect(), own.to_owned())
}

/// A name without the ending of the file that it is of.
pub(super) fn without_ending(name: &str) -> &str {
    let of_file = Format::by_ending(Path::new(name)).is_some();
    name.rsplit_once('.').filter(|(stem, _)| of_file && !stem.is_empty()).map_or(name, |(stem, _)| stem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_become_places_below_the_folder() {
        assert_eq!(place("a/b.v2.glb"), ("a".into(), "b.v2".into()));
        assert_eq!(place("../../etc/x"), ("etc".into(), "x".into()));
        assert_eq!(place("set.npz#horse"), ("".into(), "set.npz#horse".into()));
        assert_eq!(place(""), ("".into(), "asset".into()));
    }
}
