//! Rigs as files of the peers' formats.
//!
//! Coordinates are written as they are, turned where the format has z up; scale is kept, though a
//! peer's networks may want their own, which is told, and which [`Target::fitted`] gives. What a format
//! cannot hold is told, not dropped in silence.

mod anymate;
mod articulation;
mod filling;
mod note;
mod npz;
mod pickle;
mod plain;
mod puppeteer;
mod skintokens;
mod surface;
mod tails;
mod target;
mod text;
mod unirig;

use std::path::{Path, PathBuf};

use riglab_core::{Asset, Mesh};
use thiserror::Error;

pub use filling::Filling;
pub use note::WriteNote;
pub use target::Target;
pub(crate) use text::{is_mesh_of, same_lines};

/// Why something cannot be written.
#[derive(Debug, Error)]
pub enum WriteError {
    /// No format has this ending, or several.
    #[error("{0}: the ending does not tell the format; say which of {names} it is (`--to`)", names = Target::names_of(.0))]
    WhichFormat(String),
    /// No format has this name.
    #[error("there is no format `{0}`; there are {names}", names = Target::names())]
    NoFormat(String),
    /// A format of one asset a file.
    #[error("{format} holds one asset a file, not {count}; give a folder")]
    One {
        /// The format.
        format: Target,
        /// How many there are.
        count: usize,
    },
    /// The format cannot say it.
    #[error("`{asset}` cannot be written as {format}: {reason}")]
    Cannot {
        /// Which asset.
        asset: String,
        /// The format.
        format: Target,
        /// Why.
        reason: String,
    },
    /// A mesh of another make stands where that of a rig text goes.
    #[error(
        "{path} is there already and is not the mesh of a rig text here; give another name or folder",
        path = path.display()
    )]
    Taken {
        /// The mesh.
        path: PathBuf,
    },
    /// The file system refused.
    #[error("{path}: {message}", path = path.display())]
    Io {
        /// Which file.
        path: PathBuf,
        /// What happened.
        message: String,
    },
}

/// The files that [`write()`] makes at a path: the file, and the mesh beside a rig text.
pub fn written_paths(path: impl AsRef<Path>, target: Target) -> Vec<PathBuf> {
    let path = path.as_ref();
    std::iter::once(path.to_path_buf()).chain(target.writes().beside(path)).collect()
}

/// Writes assets to `path`, and tells what the format does not hold. Nothing is left
/// half-written: a file is complete or absent.
///
/// A rig text has its mesh beside it: `x_rig.txt` and `x.obj`. Where there is such a mesh, but no such text, it is someone's
/// own and stays.
///
/// # Errors
/// [`WriteError::Taken`] then;
/// [`WriteError::One`] for several assets in a format of one, [`WriteError::Cannot`] for a rig that the
/// format has no form for, [`WriteError::Io`] when the file system refuses.
pub fn write(assets: &[Asset], path: impl AsRef<Path>, target: Target) -> Result<Vec<WriteNote>, WriteError> {
    let path = path.as_ref();
    if target.holds_several() {
        let mut filling = Filling::new(path, target)?;
        assets.iter().try_for_each(|asset| filling.add(asset))?;
        return filling.end();
    }
    let [asset] = assets else { return Err(WriteError::One { format: target, count: assets.len() }) };
    target.holds(asset)?;
    let mut reach = target::Reach::default();
    reach.add(target, &asset.rig);
    let mut notes: Vec<WriteNote> = target.beyond(&reach).into_iter().collect();
    let written = target.writes().files(assets, &mut notes)?;
    if let (Some(beside), Some(bytes)) = (target.writes().beside(path), written.beside) {
        // One that was cut off between the two has the same.
        let own = |there: Vec<u8>| text::bare_obj(&there) == text::bare_obj(&bytes);
        if !path.exists() && beside.exists() && !std::fs::read(&beside).is_ok_and(own) {
            return Err(WriteError::Taken { path: beside });
        }
        store(&beside, &bytes)?;
    }
    store(path, &written.file)?;
    Ok(notes)
}

/// Writes a mesh without skeleton as OBJ.
///
/// # Errors
/// [`WriteError::Io`] when the file system refuses.
pub fn write_mesh(mesh: &Mesh, path: impl AsRef<Path>) -> Result<(), WriteError> {
    store(path.as_ref(), text::obj(mesh).as_bytes())
}

/// Writes under a temporary name in the same folder, syncs and renames.
fn store(path: &Path, bytes: &[u8]) -> Result<(), WriteError> {
    riglab_files::write(path, bytes).map_err(|e| WriteError::Io { path: path.into(), message: e.to_string() })
}
