//! Pictures of rigs, drawn when they are asked for and kept while there is room.

use std::collections::{BTreeSet, HashMap};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use riglab_core::{Asset, Rig};
use riglab_curate::{CurateConfig, Folder, ImportConfig, ReadOutcome, repair};
use riglab_data::Corpus;
use riglab_render::{Picture, Theme, View, render_parts, render_skeleton};

use crate::ReviewError;
use crate::deck::{Card, Place};

/// Bytes of pictures that are kept.
const ROOM: usize = 256 << 20;
/// Degrees around the rig: three quarters from the front, and what that does not show.
const SIDES: [f32; 2] = [32.0, 212.0];

/// Which picture of a rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Kind {
    /// Skeleton and parts from two sides each; otherwise the skeleton from the front and the parts from
    /// behind.
    pub large: bool,
    /// On near-black.
    pub dark: bool,
}

/// Draws cards.
pub struct Pictures {
    corpus: Option<Corpus>,
    files: Option<[Folder; 2]>,
    kept: Mutex<Kept>,
}

#[derive(Default)]
struct Kept {
    of: HashMap<(usize, Kind), Drawn>,
    bytes: usize,
    asked: u64,
}

struct Drawn {
    png: Arc<Vec<u8>>,
    /// When it was last asked for, counted in pictures.
    asked: u64,
}

impl Pictures {
    /// Of a corpus' rigs, and of those in files of a folder.
    ///
    /// # Errors
    /// When there is no such folder, or no file in it.
    pub fn new(corpus: Option<Corpus>, folder: Option<&Path>) -> Result<Self, ReviewError> {
        // Whether characters of one file were parted is known by the names alone.
        let open = |folder: &Path, split_characters: bool| {
            let import = ImportConfig { split_characters, ..ImportConfig::default() };
            Folder::open(folder, &[], &import)
        };
        let files = match folder {
            Some(folder) => Some([open(folder, false)?, open(folder, true)?]),
            None => None,
        };
        Ok(Self { corpus, files, kept: Mutex::default() })
    }

    /// Whether a card can be drawn at all.
    pub fn can(&self, card: &Card) -> bool {
        match card.place {
            Place::Corpus(_) => self.corpus.is_some(),
            Place::File(_) => self.files.is_some(),
        }
    }

    /// Of the files of cards that are in no corpus, how many are not in the folder, and how many there are.
    pub fn gone(&self, cards: &[Card]) -> Option<(usize, usize)> {
        let [folder, _] = self.files.as_ref()?;
        let of = |card: &Card| match &card.place {
            Place::File(file) => Some(folder.path(file)),
            Place::Corpus(_) => None,
        };
        let files: BTreeSet<PathBuf> = cards.iter().filter_map(of).collect();
        let gone = files.iter().filter(|file| !file.is_file()).count();
        (gone > 0).then_some((gone, files.len()))
    }

    /// A picture as PNG.
    ///
    /// # Errors
    /// A sentence, when the rig cannot be read any more.
    pub fn png(&self, index: usize, card: &Card, kind: Kind) -> Result<Arc<Vec<u8>>, String> {
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.asked += 1;
        let now = kept.asked;
        if let Some(drawn) = kept.of.get_mut(&(index, kind)) {
            drawn.asked = now;
            return Ok(drawn.png.clone());
        }
        drop(kept);
        let png = Arc::new(draw(&self.asset(card)?.rig, kind).to_png());
        let mut kept = self.kept.lock().unwrap_or_else(PoisonError::into_inner);
        kept.keep((index, kind), png.clone(), now, ROOM);
        Ok(png)
    }

    fn asset(&self, card: &Card) -> Result<Asset, String> {
        match (&card.place, &self.corpus, &self.files) {
            (Place::Corpus(index), Some(corpus), _) => corpus.asset(*index).map_err(|e| e.to_string()),
            (Place::File(file), _, Some(folders)) => folders
                .iter()
                .find_map(|folder| read(folder, file, &card.name))
                .ok_or_else(|| format!("{file}: it is not there any more, or another file")),
            (Place::File(_), _, None) => {
                Err("it is in no corpus; give --files with the folder that was curated".into())
            }
            (Place::Corpus(_), None, _) => Err("there is no corpus".into()),
        }
    }
}

impl Kept {
    /// Keeps a picture, in place of those that were asked for longest ago.
    fn keep(&mut self, key: (usize, Kind), png: Arc<Vec<u8>>, now: u64, room: usize) {
        self.bytes += png.len();
        if let Some(old) = self.of.insert(key, Drawn { png, asked: now }) {
            self.bytes -= old.png.len();
        }
        while self.bytes > room {
            let Some(oldest) = self.of.iter().min_by_key(|(_, drawn)| drawn.asked).map(|(key, _)| *key) else { return };
            if let Some(old) = self.of.remove(&oldest) {
                self.bytes -= old.png.len();
            }
        }
    }
}

/// An asset of a curated folder, repaired as curation does it.
fn read(folder: &Folder, file: &str, name: &str) -> Option<Asset> {
    let mut found = None;
    folder.each(&folder.path(file), None, |one| match one {
        ReadOutcome::Asset(read) if read.asset.name == name => {
            found = Some(read.asset);
            ControlFlow::Break(())
        }
        _ => ControlFlow::Continue(()),
    });
    let mut asset = found?;
    // What cannot be repaired is shown as it is.
    let _ = repair(&mut asset, &CurateConfig::default().repair);
    Some(asset)
}

fn draw(rig: &Rig, kind: Kind) -> Picture {
    let theme = if kind.dark { Theme::Dark } else { Theme::Light };
    let view = |side: f32, size: u32| View::square(size).turned(side, 14.0).themed(theme);
    if !kind.large {
        let size = 220;
        return beside(&[render_skeleton(rig, &view(SIDES[0], size)), render_parts(rig, &view(SIDES[1], size))], 2);
    }
    let size = 400;
    let skeletons = SIDES.map(|side| render_skeleton(rig, &view(side, size)));
    let parts = SIDES.map(|side| render_parts(rig, &view(side, size)));
    let [a, b] = skeletons;
    let [c, d] = parts;
    beside(&[a, b, c, d], 2)
}

/// Pictures of one size in rows.
fn beside(cells: &[Picture], columns: usize) -> Picture {
    let (width, height) = (cells[0].width(), cells[0].height());
    let rows = cells.len().div_ceil(columns);
    let mut sheet = Picture::filled(columns * width, rows * height, Theme::Light.background());
    for (at, cell) in cells.iter().enumerate() {
        sheet.paste(cell, at % columns * width, at / columns * height);
    }
    sheet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_pictures_asked_for_longest_ago_make_room() {
        let mut kept = Kept::default();
        let kind = Kind { large: false, dark: false };
        for index in 0..5 {
            kept.keep((index, kind), Arc::new(vec![0; 10]), index as u64, 30);
        }
        let mut left: Vec<usize> = kept.of.keys().map(|k| k.0).collect();
        left.sort_unstable();
        assert_eq!((left, kept.bytes), (vec![2, 3, 4], 30));
        // One that is larger than the room is not kept, and its bytes are not counted.
        kept.keep((9, kind), Arc::new(vec![0; 99]), 9, 30);
        assert_eq!((kept.of.len(), kept.bytes), (0, 0));
        kept.keep((1, kind), Arc::new(vec![0; 10]), 10, 30);
        kept.keep((1, kind), Arc::new(vec![0; 20]), 11, 30);
        assert_eq!(kept.bytes, 20);
    }
}
