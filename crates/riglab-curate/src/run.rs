//! A curation from a folder to a corpus and its report.

use std::collections::{HashMap, HashSet};
use std::ops::ControlFlow;
use std::path::{Path, PathBuf};
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use rayon::prelude::*;
use riglab_data::{CorpusWriter, Splitter, Tally, copies_told, same};
use serde::{Deserialize, Serialize};

use crate::config::{CurateConfig, ImportConfig, RepairConfig, SplitBy};
use crate::decisions::Decisions;
use crate::funnel::Funnel;
use crate::journal::{Journal, JournalContent, Other, Stamp};
use crate::judge::{Judgement, judge};
use crate::label::label;
use crate::pictures::Pictures;
use crate::read::{Folder, ReadOutcome};
use crate::record::Record;
use crate::shards::SHARD;
use crate::source::Source;
use crate::store::store;
use crate::{CurateError, report};

/// A part of the files, 1 to `of`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// Which.
    pub number: u64,
    /// Of how many.
    pub of: u64,
}

impl Shard {
    /// Whether a file is in this part: by its name alone, so that files may come and go.
    pub fn has(&self, file: &str) -> bool {
        self.number_of(file) == self.number
    }

    /// Whether a file is in any of these parts; no parts are the whole.
    pub fn any_has(parts: &[Self], file: &str) -> bool {
        parts.is_empty() || parts.iter().any(|part| part.has(file))
    }

    /// The part of as many that a file is in.
    fn number_of(&self, file: &str) -> u64 {
        let hash = blake3::hash(file.as_bytes());
        let first = hash.as_bytes().first_chunk::<8>().copied().unwrap_or_default();
        u64::from_le_bytes(first) % self.of.max(1) + 1
    }
}

/// What corpora are called by. The folder's own name is told as such where the corpus is begun.
const ENDINGS: [&str; 3] = ["h5", "hdf5", "curation"];

/// Where results go.
#[derive(Clone, Debug)]
pub struct Places {
    /// The corpus.
    pub out: PathBuf,
    /// The folder of journal, report and answers.
    pub work: PathBuf,
}

impl Places {
    /// For a corpus `rigs.h5`, the folder `rigs.curation` beside it; for one named otherwise, as `part.1`, `part.1.curation`.
    pub fn of(out: &Path) -> Self {
        Self { out: out.into(), work: riglab_files::beside(out, &ENDINGS, "curation") }
    }

    /// Where a review keeps decisions: `rigs.decisions.tsv` beside `rigs.h5`, and `part.1.decisions.tsv` beside `part.1`.
    pub fn decisions(&self) -> PathBuf {
        let own = riglab_files::beside(&self.out, &ENDINGS, "decisions.tsv");
        // Earlier versions took what stands behind the last point for an ending, whatever it was.
        let earlier = self.out.with_extension("decisions.tsv");
        let is_of_another = || ["h5", "hdf5", ""].iter().any(|ending| self.out.with_extension(ending).is_file());
        if !own.exists() && earlier.is_file() && !is_of_another() { earlier } else { own }
    }

    /// The journal.
    pub fn journal(&self) -> PathBuf {
        self.work.join("journal.jsonl")
    }

    /// The page.
    pub fn report(&self) -> PathBuf {
        self.work.join("report.html")
    }

    /// The same for machines.
    pub fn funnel(&self) -> PathBuf {
        self.work.join("funnel.json")
    }

    /// A line an asset, for machines.
    pub fn assets(&self) -> PathBuf {
        self.work.join("assets.jsonl")
    }

    /// How these assets were read, for whoever reads them again.
    pub(crate) fn reading(&self) -> PathBuf {
        self.work.join("reading.json")
    }

    /// The name of the corpus that the folder is of.
    fn owner(&self) -> PathBuf {
        self.work.join("corpus.txt")
    }

    /// Whether the folder beside the corpus may be written to: `x.h5` and `x.hdf5` have the same.
    ///
    /// # Errors
    /// [`CurateError::OfAnother`] where it is that of another corpus, which is still there.
    pub fn check(&self) -> Result<(), CurateError> {
        let own = |other: &PathBuf| *other == self.out || same(other, &self.out);
        // Folders of earlier versions do not say whose they are: of any corpus there that has such a one.
        let others = match std::fs::read_to_string(self.owner()) {
            Ok(name) => vec![self.out.with_file_name(name)],
            Err(_) if !self.work.is_dir() || self.out.is_file() => return Ok(()),
            Err(_) => ["h5", "hdf5", ""].map(|ending| self.work.with_extension(ending)).to_vec(),
        };
        // One whose folder was moved or copied with another has its own.
        let there = |other: &PathBuf| !own(other) && other.is_file() && Self::of(other).work == self.work;
        match others.into_iter().find(there) {
            Some(other) => Err(CurateError::OfAnother { path: self.out.clone(), work: self.work.clone(), other }),
            None => Ok(()),
        }
    }

    /// Says in the folder beside the corpus whose it is.
    pub(crate) fn own(&self) -> Result<(), CurateError> {
        let name = self.out.file_name().unwrap_or_default().to_string_lossy();
        store(&self.owner(), name.as_bytes())
    }
}

/// By which settings files become assets, beside what each file says. Kept with a curation, so that an asset that is read
/// again is the one that was looked at.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Reading {
    /// How files are read.
    pub import: ImportConfig,
    /// What is mended.
    pub repair: RepairConfig,
}

impl Reading {
    /// That of the assets of a curation, if it is told.
    pub fn of(places: &Places) -> Option<Self> {
        std::fs::read(places.reading()).ok().and_then(|text| serde_json::from_slice(&text).ok())
    }

    /// Keeps it beside a corpus.
    pub(crate) fn store(&self, places: &Places) -> Result<(), CurateError> {
        store(&places.reading(), &serde_json::to_vec_pretty(self).unwrap_or_default())
    }
}

/// Shards without a file that are named at most.
const EMPTY: usize = 1 << 16;

/// What a run tells while it goes: what it does, how much of it is done, and of how much.
pub type Tell<'a> = &'a (dyn Fn(&str, usize, usize) + Sync);

/// Curates a folder.
///
/// # Errors
/// When files cannot be listed, results not be written, or nothing passes.
pub fn curate(
    folder: &Path,
    places: &Places,
    shard: Option<Shard>,
    config: &CurateConfig,
    tell: Tell,
) -> Result<Funnel, CurateError> {
    begin(places)?;
    // Before hours of work, not after them.
    riglab_files::make_folder_of(&places.out).map_err(|e| CurateError::write(&places.out, &e))?;
    let files = Folder::open(folder, &[&places.out, &places.work], &config.import);
    // Of a folder that is not there, or has no such file, nothing is left; what holds something stays.
    let mut files = files.inspect_err(|_| drop(std::fs::remove_dir(&places.work)))?;
    if let Some(hidden) = files.hidden() {
        tell(hidden, 0, 0);
    }
    let there: Option<Vec<Shard>> = shard.map(|shard| {
        let mut filled = HashSet::new();
        files.retain(|name| {
            filled.insert(shard.number_of(name));
            shard.has(name)
        });
        // Parts that no file falls into are as good as there: they have no corpus.
        let empty = (1..=shard.of).filter(|number| *number != shard.number && !filled.contains(number));
        let empty = empty.take(EMPTY).map(|number| Shard { number, ..shard });
        std::iter::once(shard).chain(empty).collect()
    });
    places.own()?;
    let (records, journal) = look(&files, places, config, tell)?;
    let done = finish(&Source::Folder(&files, config), &records, places, shard.as_slice(), config, tell);
    match &done {
        // As long as the journal is this run's: of which shard the corpus is, and not which was begun.
        Ok(_) | Err(CurateError::NothingLeft { .. }) => tell_shard(places, there.as_deref())?,
        // Whatever it was that changed: the next run does not rely on what this one saw.
        Err(CurateError::Changed { files, .. }) => {
            files.iter().try_for_each(|file| locked(&journal).forget(file))?;
        }
        Err(_) => {}
    }
    done
}

/// Writes beside the corpus which shards it is of; of none where the whole folder was curated.
pub(crate) fn tell_shard(places: &Places, there: Option<&[Shard]>) -> Result<(), CurateError> {
    let path = places.work.join(SHARD);
    match there {
        Some(there) => store(&path, &serde_json::to_vec(there).unwrap_or_default()),
        // The folder may have been a shard's before; mostly there is none.
        None => {
            let _ = std::fs::remove_file(&path);
            Ok(())
        }
    }
}

/// Makes the folder beside the corpus, if the corpus may be where it is to be: told before hours of work, not after them.
pub(crate) fn begin(places: &Places) -> Result<(), CurateError> {
    if places.out == places.work {
        let message = "is the name of the folder beside the corpus; give the corpus another, such as corpus.h5".into();
        return Err(CurateError::Io { path: places.out.clone(), message });
    }
    places.check()?;
    CorpusWriter::may_take(&places.out)?;
    let folder = places.out.parent().unwrap_or(Path::new(""));
    riglab_files::may_write(folder).map_err(|e| CurateError::write(&places.out, &e))?;
    std::fs::create_dir_all(&places.work).map_err(|e| CurateError::write(&places.work, &e))
}

/// Looks at all files, those of the journal excepted.
fn look(
    files: &Folder,
    places: &Places,
    config: &CurateConfig,
    tell: Tell,
) -> Result<(Vec<Record>, Mutex<Journal>), CurateError> {
    let (journal, mut held) = Journal::open(&places.journal(), config)?;
    if let Some(told) = told(&held) {
        tell(&told, 0, 0);
    }
    let mut journal = journal;
    let mut all: Vec<Record> = Vec::new();
    for (name, why) in files.unread() {
        let own = vec![Record::refused(name.clone(), name.clone(), why.clone())];
        if held.done.remove(name) != Some((Stamp::NONE, own.clone())) {
            journal.replace(name, &own)?;
            journal.done(name, Stamp::NONE)?;
        }
        all.extend(own);
    }
    let mut open: Vec<Open> = Vec::new();
    for path in files.files() {
        let name = files.name(path);
        let stamp = Stamp::of(path, files.said(&name));
        match held.done.remove(&name) {
            Some((then, records)) if then == stamp => all.extend(records),
            _ => {
                // Whether a file that was broken off is still the same, its assets' checksums say.
                let begun = held.begun.remove(&name).unwrap_or_default();
                let begun = begun.into_iter().map(|r| (r.name.clone(), r)).collect();
                open.push(Open { path, name, stamp, begun });
            }
        }
    }
    // What is not there any more: whoever merges this with others reads the journal, not the folder.
    for name in held.done.keys().chain(held.begun.keys()) {
        journal.forget(name)?;
    }
    let total = files.files().len();
    let known = total - open.len();
    tell("looking", known, total);
    let looking = |done, of| tell("looking", done, of);
    let tally = Tally::new(total, known, &looking);
    let journal = Mutex::new(journal);
    let found = open
        .into_par_iter()
        .map(|file| look_at(files, &file, config, &journal, &tally))
        .collect::<Result<Vec<_>, CurateError>>()?;
    all.extend(found.into_iter().flatten());
    locked(&journal).sync()?;
    all.sort_by(|a, b| a.name.cmp(&b.name));
    Ok((all, journal))
}

/// What there was instead of a journal of these settings, and what comes of it.
fn told(held: &JournalContent) -> Option<String> {
    let why = match held.other.as_ref()? {
        Other::Settings => "with other settings".to_owned(),
        Other::Version(by) => format!("by another version of riglab ({by})"),
        Other::Either => "with other settings, or by an earlier version of riglab".into(),
        Other::Broken => return Some("the journal's beginning cannot be read: all files are read again".into()),
    };
    Some(match held.again {
        true => format!("the journal was written {why}; the one that these settings left goes on"),
        false => format!("the journal was written {why}: all files are read again, and it is kept for who goes back"),
    })
}

fn locked(journal: &Mutex<Journal>) -> std::sync::MutexGuard<'_, Journal> {
    journal.lock().unwrap_or_else(std::sync::PoisonError::into_inner)
}

/// A file to look at.
struct Open<'a> {
    path: &'a Path,
    name: String,
    stamp: Stamp,
    /// The assets that the journal has of it, by their names, where it was broken off.
    begun: HashMap<String, Record>,
}

/// Looks at one file's assets, adding each to the journal.
fn look_at(
    files: &Folder,
    file: &Open<'_>,
    config: &CurateConfig,
    journal: &Mutex<Journal>,
    tally: &Tally<'_>,
) -> Result<Vec<Record>, CurateError> {
    let mut records: Vec<Record> = Vec::new();
    let mut names = HashSet::new();
    let (mut done, mut taken_over, mut renamed) = (Ok(()), 0, false);
    files.each(file.path, Some(tally), |found| {
        let mut record = match found {
            ReadOutcome::Asset(read) => {
                let from = &read.asset.provenance;
                let now = (&from.checksum, &from.source, &from.category);
                let same =
                    |known: &&Record| known.facts.as_ref().is_some_and(|f| (&f.checksum, &f.source, &f.stated) == now);
                match file.begun.get(&read.asset.name).filter(same) {
                    Some(known) => {
                        taken_over += 1;
                        let (record, changed) = take_over(known, &mut records, &mut names);
                        renamed |= changed;
                        records.push(record);
                        return ControlFlow::Continue(());
                    }
                    None => Record::of(*read, file.name.clone(), config),
                }
            }
            ReadOutcome::Refused(name, reason) => Record::refused(name, file.name.clone(), reason),
        };
        renamed |= name_apart(&mut record, &mut records, &mut names);
        done = locked(journal).add_one(&record);
        records.push(record);
        if done.is_err() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    done?;
    let mut journal = locked(journal);
    if taken_over < file.begun.len() || renamed {
        // The file has changed since it was begun, or begins with what could not be read; or names were given anew.
        journal.replace(&file.name, &records)?;
    }
    journal.done(&file.name, file.stamp)?;
    Ok(records)
}

/// The record of an asset that the journal has, by a name that none before it has; tells whether the journal has it, or one of
/// those before, otherwise now.
fn take_over(known: &Record, before: &mut [Record], names: &mut HashSet<String>) -> (Record, bool) {
    let mut record = known.clone();
    let gave_way = name_apart(&mut record, before, names);
    let changed = gave_way || record != *known;
    (record, changed)
}

/// Gives a record of a file a name that none before it has; tells whether one of those before gave way.
///
/// Refusals within a file share its name, and may be called anything; an asset is found again by its own.
fn name_apart(record: &mut Record, before: &mut [Record], names: &mut HashSet<String>) -> bool {
    let is_refused = |record: &Record| record.facts.is_none();
    if names.insert(record.name.clone()) {
        return false;
    }
    let file = &record.file;
    let free = (2..).map(|n| format!("{file}#{n}")).find(|name| !names.contains(name)).unwrap_or_default();
    names.insert(free.clone());
    match before.iter_mut().find(|known| known.name == record.name) {
        Some(known) if is_refused(known) && !is_refused(record) => {
            known.name = free;
            return true;
        }
        _ if is_refused(record) => record.name = free,
        _ => {
            let why = format!("another asset of the file is called `{}`, too; give each its own name", record.name);
            *record = Record::refused(free, file.clone(), why);
        }
    }
    false
}

/// From records to corpus and report.
pub(crate) fn finish(
    source: &Source,
    records: &[Record],
    places: &Places,
    shards: &[Shard],
    config: &CurateConfig,
    tell: Tell,
) -> Result<Funnel, CurateError> {
    let decisions = match config.decisions.as_str() {
        "" => Decisions::default(),
        path => Decisions::read(Path::new(path))?,
    };
    tell("comparing", 0, records.len());
    // What other parts hold is theirs to tell.
    let own = |name: &str| Shard::any_has(shards, source.file(name));
    let names: HashSet<&str> = records.iter().flat_map(|r| [r.name.as_str(), r.file.as_str()]).collect();
    let is_there = |name: &str| names.contains(name) || names.contains(source.file(name)) || source.is_there(name);
    let mut judged: Judgement = judge(records, &decisions, config, own, is_there);
    tell("comparing", records.len(), records.len());
    let labels = label(records, &mut judged, config, &places.work, |wanted, each| {
        let done = AtomicUsize::new(0);
        tell("asking", 0, wanted.len());
        source.each_chunk(wanted, |assets| {
            let n = assets.len();
            each(assets)?;
            tell("asking", done.fetch_add(n, Ordering::Relaxed) + n, wanted.len());
            Ok(())
        })
    })?;
    let kept: Vec<&Record> = judged.kept().map(|i| &records[i]).collect();
    let mut pictures = Pictures::choose(records, &judged, &config.report);
    let mut splits = Vec::new();
    let mut doubts = source.doubts();
    if !kept.is_empty() {
        let open: Vec<&Record> = kept.iter().copied().filter(|r| source.split(&r.name).is_none()).collect();
        // Before the corpus is written, not after it.
        let splitter = if open.is_empty() { None } else { Some(splitter(config)?) };
        let (writer, digests) = write(source, &kept, &judged, &mut pictures, places, tell)?;
        let contents = contents(records, &judged, &digests);
        let mut made = Vec::new();
        if let Some(splitter) = splitter {
            let keys = keys(&open, config);
            made = splitter.assign_equal(&keys, &open.iter().map(|r| contents[r.name.as_str()]).collect::<Vec<_>>());
            doubts.extend(splitter.doubts(&keys, &made, is_there));
        }
        let mut made = made.into_iter();
        let own = |r: &&Record| source.split(&r.name).cloned().or_else(|| made.next()).unwrap_or_default();
        splits = kept.iter().map(own).collect();
        let names: Vec<&str> = kept.iter().map(|r| r.name.as_str()).collect();
        let contents: Vec<&str> = names.iter().map(|name| contents[name]).collect();
        doubts.extend(copies_told(&names, &contents, &splits));
        let split_of: HashMap<&str, &String> = names.into_iter().zip(&splits).collect();
        let of: Vec<String> = digests.iter().map(|(name, _)| split_of[name.as_str()].clone()).collect();
        writer.finish(&of)?;
    }
    let others = pictures.missing(records);
    source.each_chunk(&others, |assets| {
        assets.iter().for_each(|a| pictures.draw(a));
        Ok(())
    })?;
    let mut funnel = Funnel::of(records, &judged, labels, &splits, config);
    funnel.warnings.extend(doubts);
    if kept.iter().any(|r| source.split(&r.name).is_some()) {
        funnel.split_by = SplitBy::List;
    }
    if let Source::Folder(_, config) = source {
        Reading { import: config.import.clone(), repair: config.repair.clone() }.store(places)?;
    }
    store(&places.assets(), judged.lines(records, &splits).as_bytes())?;
    store(&places.funnel(), &serde_json::to_vec_pretty(&funnel).unwrap_or_default())?;
    store(&places.report(), report::page(&funnel, &pictures, config).to_html()?.as_bytes())?;
    if kept.is_empty() {
        return Err(CurateError::NothingLeft {
            assets: records.len(),
            report: places.report(),
            older: places.out.exists().then(|| places.out.clone()),
        });
    }
    Ok(funnel)
}

/// What gives the splits.
fn splitter(config: &CurateConfig) -> Result<Splitter, CurateError> {
    Ok(match config.split.by {
        SplitBy::Topology | SplitBy::Source => Splitter::ByTopology(config.split.seed),
        SplitBy::List => Splitter::read(Path::new(&config.split.file))?,
    })
}

/// What the splits of the kept assets go by.
fn keys(kept: &[&Record], config: &CurateConfig) -> Vec<(String, u64)> {
    let of = |key: fn(&Record) -> u64| kept.iter().map(|r| (r.name.clone(), key(r))).collect();
    match config.split.by {
        SplitBy::Topology | SplitBy::List => of(|r| r.facts.as_ref().map_or(0, |f| f.topology)),
        SplitBy::Source => of(|r| {
            let hash = blake3::hash(r.facts.as_ref().map_or("", |f| f.source.as_str()).as_bytes());
            u64::from_le_bytes(hash.as_bytes().first_chunk::<8>().copied().unwrap_or_default())
        }),
    }
}

/// What assets are equal by, by name: digests, and for those that comparing shapes found to be the same one of them.
fn contents<'a>(
    records: &'a [Record],
    judged: &Judgement,
    digests: &'a [(String, String)],
) -> HashMap<&'a str, &'a str> {
    let mut of: HashMap<&str, &str> = digests.iter().map(|(name, digest)| (name.as_str(), digest.as_str())).collect();
    for group in &judged.duplicates {
        let names = group.iter().map(|&i| records[i].name.as_str());
        let kept: Vec<&str> = names.filter(|name| of.contains_key(name)).collect();
        let first = kept.first().map(|name| of[name]);
        of.extend(kept.into_iter().zip(first.into_iter().cycle()));
    }
    of
}

/// Writes the assets of the corpus, all but their splits, and gives the name and digest of each.
fn write(
    source: &Source,
    kept: &[&Record],
    judged: &Judgement,
    pictures: &mut Pictures,
    places: &Places,
    tell: Tell,
) -> Result<(CorpusWriter, Vec<(String, String)>), CurateError> {
    let mut writer = CorpusWriter::create(&places.out)?;
    let mut written: Vec<String> = Vec::with_capacity(kept.len());
    source.each_chunk(kept, |assets| {
        for mut asset in assets {
            pictures.draw(&asset);
            judged.describe(&mut asset);
            writer.add(&asset)?;
            written.push(asset.name);
        }
        tell("writing", written.len(), kept.len());
        Ok(())
    })?;
    if written.len() < kept.len() {
        let there: HashSet<&str> = written.iter().map(String::as_str).collect();
        let gone: Vec<&&Record> = kept.iter().filter(|r| !there.contains(r.name.as_str())).collect();
        let (n, path) = (kept.len() - written.len(), places.out.clone());
        let first = gone.first().map_or(String::new(), |r| r.name.clone());
        let count = format!("{n} {}", if n == 1 { "asset" } else { "assets" });
        return Err(match source {
            Source::Folder(..) => {
                let files = gone.iter().map(|r| r.file.clone()).collect();
                CurateError::Changed { path, count, first, files }
            }
            Source::Corpora(..) => {
                let are = if n == 1 { "is" } else { "are" };
                let message = format!(
                    "{count} {are} in none of the corpora, `{first}` for one; merge with the settings and decisions that the shards had"
                );
                CurateError::Io { path, message }
            }
        });
    }
    let digests: Vec<String> = writer.digests().into_iter().map(str::to_owned).collect();
    Ok((writer, written.into_iter().zip(digests).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::facts;

    fn refused(name: &str) -> Record {
        Record::refused(name.into(), "set.npz".into(), "no rig".into())
    }

    fn asset(name: &str) -> Record {
        Record { dropped: None, facts: Some(facts(name, "")), ..refused(name) }
    }

    /// The names that records get, and whether any gave way.
    fn names(records: Vec<Record>) -> (Vec<String>, bool) {
        let (mut all, mut names, mut gave_way) = (Vec::new(), HashSet::new(), false);
        for mut record in records {
            gave_way |= name_apart(&mut record, &mut all, &mut names);
            all.push(record);
        }
        (all.into_iter().map(|r| r.name).collect(), gave_way)
    }

    #[test]
    fn refusals_of_a_file_never_take_the_name_of_an_asset() {
        let (own, gave_way) =
            names(vec![asset("set.npz#3"), refused("set.npz"), refused("set.npz"), refused("set.npz")]);
        assert_eq!((own.join(" "), gave_way), ("set.npz#3 set.npz set.npz#2 set.npz#4".into(), false));
        // Assets come under their own names, whatever came before.
        let (own, gave_way) =
            names(vec![refused("set.npz"), refused("set.npz"), asset("set.npz#2"), asset("set.npz#3")]);
        assert_eq!((own.join(" "), gave_way), ("set.npz set.npz#4 set.npz#2 set.npz#3".into(), true));
    }

    #[test]
    fn a_second_asset_of_a_name_is_refused() {
        let mut second = asset("set.npz#a");
        let mut before = vec![asset("set.npz#a")];
        let mut names: HashSet<String> = [before[0].name.clone()].into();
        assert!(!name_apart(&mut second, &mut before, &mut names));
        assert!(second.dropped.unwrap().1.contains("called `set.npz#a`, too") && second.name == "set.npz#2");
    }

    #[test]
    fn what_the_journal_has_is_named_apart_too() {
        let mut before = vec![refused("set.npz"), refused("set.npz#2")];
        let mut names: HashSet<String> = before.iter().map(|record| record.name.clone()).collect();
        let mut take = |name: &str| take_over(&asset(name), &mut before, &mut names);
        assert_eq!(take("set.npz#1"), (asset("set.npz#1"), false));
        // A refusal that was not there before the break gives way.
        assert_eq!(take("set.npz#2"), (asset("set.npz#2"), true));
        assert_eq!(before[1].name, "set.npz#3");
        before.push(asset("set.npz#2"));
        let (second, changed) = take_over(&asset("set.npz#2"), &mut before, &mut names);
        assert!(changed && second.facts.is_none() && second.name == "set.npz#4", "{second:?}");
    }

    #[test]
    fn each_corpus_has_a_folder_of_its_own() {
        let work = |out: &str| Places::of(Path::new(out)).work.display().to_string();
        assert_eq!(["a/b.h5", "b.HDF5"].map(work), ["a/b.curation", "b.curation"]);
        assert_eq!(["part.1", "part.2", "part"].map(work), ["part.1.curation", "part.2.curation", "part.curation"]);
    }

    #[test]
    fn each_corpus_has_decisions_of_its_own_and_those_of_earlier_versions_are_found() {
        let dir = tempfile::tempdir().unwrap();
        let of = |name: &str| {
            let path = Places::of(&dir.path().join(name)).decisions();
            path.file_name().unwrap().to_string_lossy().into_owned()
        };
        let names = ["a.h5", "b.HDF5", "part.1", "part.2", "part"];
        let own = ["a", "b", "part.1", "part.2", "part"].map(|name| format!("{name}.decisions.tsv"));
        assert_eq!(names.map(of), own);
        std::fs::write(dir.path().join("part.decisions.tsv"), "").unwrap();
        assert_eq!((of("part.1"), of("part")), (own[4].clone(), own[4].clone()));
        std::fs::write(dir.path().join("part.1.decisions.tsv"), "").unwrap();
        assert_eq!(of("part.1"), own[2]);
        // Those of a corpus that is there are nobody else's.
        std::fs::write(dir.path().join("part.h5"), "").unwrap();
        assert_eq!((of("part.2"), of("part.h5")), (own[3].clone(), own[4].clone()));
    }
}
