//! Pictures of rigs, drawn when they are asked for and kept while there is room.

use std::collections::{BTreeSet, HashMap};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

use riglab_core::{Asset, Rig};
use riglab_curate::{Folder, ImportConfig, ReadOutcome, Reading, RepairConfig, repair};
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
    files: Option<Files>,
    kept: Mutex<Kept>,
}

/// The files that were curated, and how.
struct Files {
    /// One folder as it is read; where nothing says how, as it may be, one after another.
    folders: Vec<Arc<Folder>>,
    repair: RepairConfig,
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
    /// Of a corpus' rigs, and of those in files of a folder, which are read as they were for the curation, if that is told.
    ///
    /// # Errors
    /// When there is no such folder, or no file in it.
    pub fn new(corpus: Option<Corpus>, folder: Option<&Path>, reading: Option<Reading>) -> Result<Self, ReviewError> {
        let files = folder.map(|folder| Files::open(folder, reading)).transpose()?;
        Ok(Self { corpus, files, kept: Mutex::default() })
    }

    /// The folder of the files, if it was given.
    pub fn folder(&self) -> Option<Arc<Folder>> {
        self.files.as_ref().map(|files| files.folders[0].clone())
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
        let folder = self.folder()?;
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
            (Place::File(file), _, Some(files)) => files.read(file, card),
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

impl Files {
    fn open(folder: &Path, reading: Option<Reading>) -> Result<Self, ReviewError> {
        let own = reading.clone().unwrap_or_default();
        let mut ways = vec![own.import.clone()];
        if reading.is_none() {
            // Whether characters of one file were parted is known by the names alone.
            ways.push(ImportConfig { split_characters: true, ..own.import });
        }
        let folders = ways.iter().map(|import| Ok(Arc::new(Folder::open(folder, &[], import)?)));
        Ok(Self { folders: folders.collect::<Result<_, ReviewError>>()?, repair: own.repair })
    }

    /// The asset of a card, repaired as its curation did, or as curations do by themselves.
    fn read(&self, file: &str, card: &Card) -> Result<Asset, String> {
        let Some(mut asset) = self.folders.iter().find_map(|folder| read(folder, file, &card.name)) else {
            return Err(format!("{file}: it is not there any more, or another file"));
        };
        if !card.digest.is_empty() && !asset.provenance.checksum.starts_with(&card.digest) {
            return Err(format!("{file}: it has changed since it was curated; curate the folder again to see it"));
        }
        // What cannot be repaired is shown as it is.
        let _ = repair(&mut asset, &self.repair);
        Ok(asset)
    }
}

/// An asset of a file of a folder.
fn read(folder: &Folder, file: &str, name: &str) -> Option<Asset> {
    let mut found = None;
    folder.each(&folder.path(file), None, |one| match one {
        ReadOutcome::Asset(read) if read.asset.name == name => {
            found = Some(read.asset);
            ControlFlow::Break(())
        }
        _ => ControlFlow::Continue(()),
    });
    found
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
    use riglab_core::{Joint, JointId, Mesh, Provenance, Skeleton, SkinWeights};

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

    /// A file of a triangle on two joints, and a third joint that nothing hangs on.
    fn file(folder: &Path, height: f32) {
        let joint = |name: &str, parent, y| Joint { name: name.into(), parent, head: [0.0, y, 0.0] };
        let root = Some(JointId(0));
        let joints = vec![joint("a", None, 0.0), joint("b", root, height), joint("ik_control", root, 3.0)];
        let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, height, 0.5]], vec![[0, 1, 2]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0u16, 1.0)], vec![(0, 0.5), (1, 0.5)], vec![(1, 1.0)]]);
        let rig = Rig::new(Skeleton::new(joints).unwrap(), mesh, weights.unwrap()).unwrap();
        let asset = Asset { name: "a".into(), rig, clips: vec![], provenance: Provenance::default() };
        std::fs::write(folder.join("a.glb"), riglab_asset::to_glb(&asset)).unwrap();
    }

    #[test]
    fn a_card_is_drawn_from_its_file_as_it_was_curated_and_from_no_other() {
        let dir = tempfile::tempdir().unwrap();
        file(dir.path(), 1.0);
        let card = |digest: &str| Card {
            name: "a.glb".into(),
            digest: digest.into(),
            stage: None,
            reason: String::new(),
            category: String::new(),
            by: String::new(),
            counts: [0; 3],
            notes: Vec::new(),
            place: Place::File("a.glb".into()),
        };
        let read = |reading: Option<Reading>, digest: &str| {
            Files::open(dir.path(), reading).unwrap().read("a.glb", &card(digest))
        };
        let asset = read(None, "").unwrap();
        let digest = &asset.provenance.checksum[..16];
        let repair = |control_bones| RepairConfig { control_bones, ..RepairConfig::default() };
        let joints = |control_bones| {
            let reading = Reading { repair: repair(control_bones), ..Reading::default() };
            read(Some(reading), digest).unwrap().rig.skeleton().len()
        };
        assert_eq!([joints(false), joints(true)], [3, 2]);
        file(dir.path(), 2.0);
        let said = read(None, digest).unwrap_err();
        assert!(said.contains("a.glb: it has changed since it was curated"), "{said}");
    }
}
