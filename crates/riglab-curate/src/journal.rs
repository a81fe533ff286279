//! The journal of a curation: a line for each asset that has been looked at, so that a run that was broken
//! off goes on where it was.
//!
//! JSON lines: a head with what the results depend on, then records, then, after those of a file, a line
//! that the file is done. Lines are appended whole; one that was cut off is cut away when the journal is
//! opened. A file that has changed since, by size or time, is looked at again. A journal of other settings, or of another
//! version of riglab, is put away beside the one that begins, and taken again when its settings come back. What
//! `manifest.json` says of a file is part of it: what was found hangs on both.
//!
//! What is kept is what was found, not the assets: these are read again when the corpus is written, which
//! takes a second reading but no second copy of the data.

use std::collections::{BTreeMap, HashMap};
use std::fs::{File, OpenOptions};
use std::io::{BufRead, BufReader, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::{SystemTime, UNIX_EPOCH};

use serde::{Deserialize, Serialize};

use crate::record::Record;
use crate::{CurateConfig, CurateError};

/// Raised when what a record means changes.
const VERSION: u32 = 3;
/// Raised when another record would be made of the same file and settings: by rules of import, repair and stages.
const RULES: u32 = 1;
/// Journals of other settings that are kept: those that took longest to make, and of such as long the last.
const KEPT: usize = 4;
/// How the names of those begin.
const AWAY: &str = "journal-";
/// Appends between two syncs: what a loss of power may cost. A kill costs nothing that was appended.
const SYNC_EVERY: usize = 256;

#[derive(Clone, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Head {
        version: u32,
        config: String,
        /// What of riglab the records are by; empty in journals of versions that did not say it.
        #[serde(default)]
        by: String,
    },
    Asset(Box<Record>),
    /// What was found of a file does not hold any more.
    Again {
        file: String,
    },
    Done {
        file: String,
        stamp: Stamp,
    },
}

/// When a file is the same: its size and time, with those of the files that are read with it (a rig text's OBJ, a glTF's
/// buffers), and what the manifest says of it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Stamp {
    bytes: u64,
    modified_ns: u64,
    said: u64,
}

impl Stamp {
    /// Of what is no file that can be read.
    pub const NONE: Self = Self { bytes: 0, modified_ns: 0, said: 0 };

    /// Of a file, with those beside it; zeros for one that cannot be asked. `said` is a number for what the manifest says.
    pub fn of(path: &Path, said: u64) -> Self {
        let mut stamp = Self { bytes: 0, modified_ns: 0, said };
        for file in riglab_asset::files_read(path) {
            // One that is not there any more, or comes back as it was before another, is told by the turn.
            stamp.modified_ns = stamp.modified_ns.rotate_left(7);
            let Ok(meta) = std::fs::metadata(file) else { continue };
            stamp.bytes += meta.len();
            let since = meta.modified().ok().and_then(|m| m.duration_since(UNIX_EPOCH).ok());
            stamp.modified_ns ^= since.map_or(0, |d| d.as_nanos() as u64);
        }
        stamp
    }
}

/// An open journal.
pub struct Journal {
    path: PathBuf,
    file: File,
    appended: usize,
}

/// What a journal holds.
#[derive(Default)]
pub struct JournalContent {
    /// Files that are done, with their records.
    pub done: HashMap<String, (Stamp, Vec<Record>)>,
    /// Records of files that are not: some of many assets, broken off.
    pub begun: HashMap<String, Vec<Record>>,
    /// What there was instead of a journal of these settings.
    pub other: Option<Other>,
    /// Where that is put away.
    away: Option<PathBuf>,
    /// Whether this is one that had been put away.
    pub again: bool,
}

/// A journal whose records are not those that would be made now.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Other {
    /// It is of other settings.
    Settings,
    /// It is of other rules: the version of riglab that has them.
    Version(String),
    /// It is of an earlier version, which said neither.
    Either,
    /// Its beginning cannot be read, and nothing of it is kept.
    Broken,
}

impl Journal {
    /// Opens the journal of these settings, or begins it. The one at the path gives way to it where it is of others.
    ///
    /// # Errors
    /// When it cannot be read or written, or another run has it.
    pub fn open(path: &Path, config: &CurateConfig) -> Result<(Self, JournalContent), CurateError> {
        let key = key(config);
        let mut file = locked(path)?;
        let take = |file: &mut File| read(file, path, Some(&key)).map_err(|e| CurateError::io(path, e));
        let (mut held, mut sound) = take(&mut file)?;
        // Also where a kill came between putting one away and taking the other.
        if sound == 0 {
            let (other, away) = (held.other, held.away);
            file = changed(path, file, away, &away_from(path, VERSION, &key))?;
            (held, sound) = take(&mut file)?;
            held = if sound == 0 { JournalContent::default() } else { JournalContent { again: true, ..held } };
            held.other = other;
        }
        file.set_len(sound).and_then(|()| file.seek(SeekFrom::End(0))).map_err(|e| CurateError::write(path, &e))?;
        let mut journal = Self { path: path.into(), file, appended: 0 };
        if sound == 0 {
            journal.append(&[Line::Head { version: VERSION, config: key, by: by() }])?;
        }
        Ok((journal, held))
    }

    /// Adds a file's records and that it is done.
    ///
    /// # Errors
    /// When the disk is full; the records before stay.
    pub fn add(&mut self, file: &str, stamp: Stamp, records: &[Record]) -> Result<(), CurateError> {
        let lines: Vec<Line> = records.iter().map(|r| Line::Asset(Box::new(r.clone()))).collect();
        self.append(&lines)?;
        self.done(file, stamp)
    }

    /// Adds one record of a file of many.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn add_one(&mut self, record: &Record) -> Result<(), CurateError> {
        self.append(&[Line::Asset(Box::new(record.clone()))])
    }

    /// Says that what was found of a file does not hold: it is looked at again.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn forget(&mut self, file: &str) -> Result<(), CurateError> {
        self.append(&[Line::Again { file: file.into() }])
    }

    /// Says that what was added of a file does not hold, and adds what does.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn replace(&mut self, file: &str, records: &[Record]) -> Result<(), CurateError> {
        let again = Line::Again { file: file.into() };
        let lines: Vec<Line> = records.iter().map(|r| Line::Asset(Box::new(r.clone()))).collect();
        self.append(&[vec![again], lines].concat())
    }

    /// Says that a file is done.
    ///
    /// # Errors
    /// As [`Self::add`].
    pub fn done(&mut self, file: &str, stamp: Stamp) -> Result<(), CurateError> {
        self.append(&[Line::Done { file: file.into(), stamp }])
    }

    fn append(&mut self, lines: &[Line]) -> Result<(), CurateError> {
        let text: String = lines.iter().map(line).collect();
        self.appended += 1;
        let mut put = || -> std::io::Result<()> {
            self.file.write_all(text.as_bytes())?;
            if self.appended.is_multiple_of(SYNC_EVERY) { self.file.sync_data() } else { Ok(()) }
        };
        put().map_err(|e| CurateError::write(&self.path, &e))
    }

    /// Makes all of it durable.
    ///
    /// # Errors
    /// The file system's.
    pub fn sync(&self) -> Result<(), CurateError> {
        self.file.sync_all().map_err(|e| CurateError::write(&self.path, &e))
    }
}

/// The file at a path, made where it is not there, for this run alone.
fn locked(path: &Path) -> Result<File, CurateError> {
    let opened = OpenOptions::new().read(true).write(true).create(true).truncate(false).open(path);
    let file = opened.map_err(|e| CurateError::write(path, &e))?;
    // Freed when the process ends, however it ends.
    if matches!(file.try_lock(), Err(std::fs::TryLockError::WouldBlock)) {
        return Err(CurateError::Busy(path.into()));
    }
    Ok(file)
}

/// Puts a journal away, if it has a place to go to, and takes the one that was put away at `own` instead, if it is there.
fn changed(path: &Path, file: File, away: Option<PathBuf>, own: &Path) -> Result<File, CurateError> {
    let moved = || -> std::io::Result<bool> {
        if let Some(away) = &away {
            file.set_modified(SystemTime::now())?;
            std::fs::rename(path, away)?;
        }
        let again = own.is_file();
        if again {
            std::fs::rename(own, path)?;
        }
        Ok(away.is_some() || again)
    };
    if !moved().map_err(|e| CurateError::write(path, &e))? {
        return Ok(file);
    }
    // The first is held until this one is.
    let new = locked(path)?;
    forget_least(path);
    Ok(new)
}

/// Where a journal of such a version and config is put away, beside the one in use.
fn away_from(path: &Path, version: u32, config: &str) -> PathBuf {
    let hash = blake3::hash(format!("{version} {config}").as_bytes()).to_hex();
    path.with_file_name(format!("{AWAY}{}.jsonl", &hash[..16]))
}

/// Removes all journals that were put away but [`KEPT`]: after a few tries with other settings, not that of a whole folder. One
/// that cannot be removed stays.
fn forget_least(path: &Path) {
    let folder = path.parent().and_then(|folder| folder.read_dir().ok()).into_iter().flatten().flatten();
    let away = folder.filter(|entry| entry.file_name().to_string_lossy().starts_with(AWAY));
    let sized = away.filter_map(|entry| {
        let meta = entry.metadata().ok()?;
        Some((meta.len(), meta.modified().ok(), entry.path()))
    });
    let mut away: Vec<_> = sized.collect();
    away.sort_by(|a, b| b.cmp(a));
    away.into_iter().skip(KEPT).for_each(|(.., path)| drop(std::fs::remove_file(path)));
}

/// What of riglab makes records as they are.
fn by() -> String {
    format!("riglab {}, rules {RULES}", env!("CARGO_PKG_VERSION"))
}

/// All records of the files that are done by a journal of whatever config, for merging shards.
///
/// # Errors
/// When it cannot be read.
pub fn records(path: &Path) -> Result<Vec<Record>, CurateError> {
    let mut file = File::open(path).map_err(|e| match e.kind() {
        std::io::ErrorKind::NotFound => CurateError::NoJournal(path.into()),
        _ => CurateError::io(path, e),
    })?;
    let (held, _) = read(&mut file, path, None).map_err(|e| CurateError::io(path, e))?;
    Ok(held.done.into_values().flat_map(|(_, records)| records).collect())
}

/// What a journal says of the settings by which files were looked at: a text that is equal for equal ones. Empty where it
/// cannot be read.
pub fn settings(path: &Path) -> String {
    let mut first = String::new();
    let _ = File::open(path).and_then(|file| BufReader::new(file).read_line(&mut first));
    match serde_json::from_str(&first) {
        Ok(Line::Head { config, .. }) => config,
        _ => String::new(),
    }
}

/// A whole journal of records that were looked at elsewhere, for whoever merges them again. A curation of the files looks at
/// them itself: no file is as old and as long as these say. `config` is what [`settings`] is to say of it.
pub fn text(records: &[Record], config: &str) -> String {
    let mut files: BTreeMap<&str, Vec<&Record>> = BTreeMap::new();
    records.iter().for_each(|record| files.entry(&record.file).or_default().push(record));
    let stamp = Stamp::NONE;
    let mut text = line(&Line::Head { version: VERSION, config: config.into(), by: by() });
    for (file, own) in files {
        own.into_iter().for_each(|record| text += &line(&Line::Asset(Box::new(record.clone()))));
        text += &line(&Line::Done { file: file.into(), stamp });
    }
    text
}

/// Records are numbers and texts: nothing that JSON cannot hold.
fn line(line: &Line) -> String {
    serde_json::to_string(line).unwrap_or_default() + "\n"
}

/// What is held, and how many bytes of it are sound: 0 for a journal of another config.
fn read(file: &mut File, path: &Path, key: Option<&str>) -> std::io::Result<(JournalContent, u64)> {
    let mut held = JournalContent::default();
    file.rewind()?;
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    let mut sound = 0;
    loop {
        line.clear();
        let n = reader.read_until(b'\n', &mut line)?;
        if n == 0 || line.last() != Some(&b'\n') {
            return Ok((held, sound));
        }
        match serde_json::from_slice(&line) {
            Ok(Line::Head { version, config, by: made }) if sound == 0 => {
                if version != VERSION || key.is_some_and(|k| k != config) {
                    held.away = Some(away_from(path, version, &config));
                    held.other = Some(match made {
                        made if made.is_empty() => Other::Either,
                        made if made != by() => Other::Version(made),
                        _ => Other::Settings,
                    });
                    return Ok((held, 0));
                }
            }
            Ok(Line::Asset(record)) if sound > 0 => held.begun.entry(record.file.clone()).or_default().push(*record),
            Ok(Line::Again { file }) if sound > 0 => {
                held.begun.remove(&file);
                held.done.remove(&file);
            }
            Ok(Line::Done { file, stamp }) if sound > 0 => {
                let records = held.begun.remove(&file).unwrap_or_default();
                held.done.insert(file, (stamp, records));
            }
            _ if sound == 0 => {
                held.other = Some(Other::Broken);
                return Ok((held, 0));
            }
            // A line that is none: a disk that was full in its middle. What follows is looked at again.
            _ => return Ok((held, sound)),
        }
        sound += n as u64;
    }
}

/// What records depend on.
pub fn key(config: &CurateConfig) -> String {
    key_by(config, RULES)
}

fn key_by(config: &CurateConfig, rules: u32) -> String {
    let c = config;
    let parts = (&c.import, &c.repair, &c.stages, &c.bones, &c.tree, &c.weights, &c.size, &c.objects);
    let all = (parts, &c.outside, &c.humanoid, env!("CARGO_PKG_VERSION"), rules);
    blake3::hash(serde_json::to_string(&all).unwrap_or_default().as_bytes()).to_hex()[..32].into()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(name: &str, file: &str) -> Record {
        Record::refused(name.into(), file.into(), "no rig".into())
    }

    #[test]
    fn what_was_added_is_held_and_a_torn_line_is_cut_away() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let config = CurateConfig::default();
        let stamp = Stamp { bytes: 3, modified_ns: 4, said: 5 };
        let (mut journal, held) = Journal::open(&path, &config).unwrap();
        assert!(held.done.is_empty() && held.other.is_none());
        assert!(matches!(Journal::open(&path, &config), Err(CurateError::Busy(_))));
        journal.add("a.glb", stamp, &[record("a.glb", "a.glb")]).unwrap();
        journal.add_one(&record("set.npz#1", "set.npz")).unwrap();
        drop(journal);
        let whole = std::fs::read(&path).unwrap();
        for cut in 0..=whole.len() {
            std::fs::write(&path, &whole[..cut]).unwrap();
            let (mut journal, held) = Journal::open(&path, &config).unwrap();
            let all: usize = held.done.values().map(|d| d.1.len()).chain(held.begun.values().map(Vec::len)).sum();
            // A head, a record, that its file is done, another record.
            let lines = whole[..cut].iter().filter(|b| **b == b'\n').count();
            assert_eq!(all, [0, 0, 1, 1, 2][lines]);
            journal.add("b.glb", stamp, &[record("b.glb", "b.glb")]).unwrap();
            drop(journal);
            assert_eq!(Journal::open(&path, &config).unwrap().1.done["b.glb"].0, stamp);
        }
        assert_eq!(records(&path).unwrap().len(), 2);
    }

    #[test]
    fn a_journal_written_at_once_holds_its_records_and_says_no_file_is_done() {
        let dir = tempfile::tempdir().unwrap();
        let (path, config) = (dir.path().join("journal.jsonl"), CurateConfig::default());
        let all = [record("a.glb", "a.glb"), record("set.npz#1", "set.npz"), record("set.npz#2", "set.npz")];
        std::fs::write(&path, text(&all, &key(&config))).unwrap();
        assert_eq!(settings(&path), key(&config));
        let mut held = records(&path).unwrap();
        held.sort_by(|a, b| a.name.cmp(&b.name));
        assert_eq!(held, all);
        std::fs::write(dir.path().join("a.glb"), "").unwrap();
        let (_, held) = Journal::open(&path, &config).unwrap();
        assert_ne!(held.done["a.glb"].0, Stamp::of(&dir.path().join("a.glb"), 0));
    }

    #[test]
    fn what_is_forgotten_is_looked_at_again() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let config = CurateConfig::default();
        let mut journal = Journal::open(&path, &config).unwrap().0;
        for name in ["a", "b"] {
            journal.add(name, Stamp::of(&path, 0), &[record(name, name)]).unwrap();
        }
        journal.forget("a").unwrap();
        drop(journal);
        let (_, held) = Journal::open(&path, &config).unwrap();
        assert!(!held.done.contains_key("a") && held.done.contains_key("b"));
        let said = records(&dir.path().join("no.jsonl")).unwrap_err().to_string();
        assert!(said.contains("no journal") && said.contains("riglab dataset merge"), "{said}");
    }

    #[test]
    fn a_stamp_changes_with_what_is_read_and_said() {
        let dir = tempfile::tempdir().unwrap();
        let (path, buffer) = (dir.path().join("a.gltf"), dir.path().join("a.bin"));
        std::fs::write(&path, r#"{"buffers": [{"uri": "a.bin"}]}"#).unwrap();
        std::fs::write(&buffer, "1234").unwrap();
        let whole = Stamp::of(&path, 0);
        assert_eq!(whole, Stamp::of(&path, 0));
        assert_ne!(whole, Stamp::of(&path, 1));
        // As old as ever and as long, which a copy may be.
        let old = UNIX_EPOCH + std::time::Duration::from_secs(1);
        File::options().write(true).open(&buffer).unwrap().set_modified(old).unwrap();
        assert_ne!(whole, Stamp::of(&path, 0));
        std::fs::remove_file(&buffer).unwrap();
        assert_ne!(whole, Stamp::of(&path, 0));
    }

    #[test]
    fn journals_are_put_away_and_taken_again_with_their_settings() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let of = |min: usize| {
            let mut config = CurateConfig::default();
            config.bones.min = min;
            config
        };
        let add =
            |min: usize| Journal::open(&path, &of(min)).unwrap().0.add("a", Stamp::NONE, &[record("a", "a")]).unwrap();
        let open = |min: usize| {
            let held = Journal::open(&path, &of(min)).unwrap().1;
            (held.other, held.again, held.done.len())
        };
        add(1);
        assert_eq!(open(2), (Some(Other::Settings), false, 0));
        assert!(matches!(Journal::open(&path, &of(2)), Ok((_, held)) if held.other.is_none() && !held.again));
        assert_eq!(open(1), (Some(Other::Settings), true, 1));
        // A kill between putting one away and taking the other.
        assert_eq!(open(2), (Some(Other::Settings), true, 0));
        std::fs::remove_file(&path).unwrap();
        assert_eq!(open(1), (None, true, 1));
        // Tries that looked at nothing cost no other, and are forgotten, the first of them first.
        for min in 3..=4 + KEPT {
            open(min);
        }
        assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1 + KEPT);
        assert_eq!([3 + KEPT, 3, 1].map(|min| open(min).1), [true, false, true]);
        assert_eq!(open(1), (None, false, 1));
    }

    #[test]
    fn what_a_journal_is_of_is_told() {
        let dir = tempfile::tempdir().unwrap();
        let (path, config) = (dir.path().join("journal.jsonl"), CurateConfig::default());
        let own = text(&[record("a", "a")], "0123");
        let other = |text: &str| {
            std::fs::write(&path, text).unwrap();
            Journal::open(&path, &config).unwrap().1.other
        };
        assert_eq!(other(&own), Some(Other::Settings));
        let earlier = Some(Other::Version("riglab 0.0.1, rules 0".into()));
        assert_eq!(other(&own.replace(&by(), "riglab 0.0.1, rules 0")), earlier);
        assert_eq!(other(&own.replace(&format!(",\"by\":\"{}\"", by()), "")), Some(Other::Either));
        assert_eq!(other("x\n"), Some(Other::Broken));
        assert_eq!(
            std::fs::read_dir(dir.path()).unwrap().count(),
            2,
            "one journal in all was put away, as all say the same config"
        );
    }

    #[test]
    fn a_journal_of_another_config_starts_anew() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("journal.jsonl");
        let mut config = CurateConfig::default();
        Journal::open(&path, &config).unwrap().0.add("a", Stamp::of(&path, 0), &[record("a", "a")]).unwrap();
        // What records do not depend on changes nothing.
        config.duplicates.tolerance = 0.01;
        assert_eq!(Journal::open(&path, &config).unwrap().1.done.len(), 1);
        config.bones.min = 5;
        let (_, held) = Journal::open(&path, &config).unwrap();
        assert!(held.other.is_some() && held.done.is_empty());
        std::fs::write(&path, text(&[record("a", "a")], &key_by(&config, RULES - 1))).unwrap();
        let (_, held) = Journal::open(&path, &config).unwrap();
        assert!(held.other.is_some() && held.done.is_empty(), "by earlier rules");
    }
}
