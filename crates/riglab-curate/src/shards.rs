//! One corpus of the corpora that the shards of a folder gave.

use std::collections::btree_map::Entry;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::{Path, PathBuf};

use riglab_data::{Corpus, DataError, same};

use crate::CurateError;
use crate::config::{CurateConfig, SplitBy};
use crate::funnel::Funnel;
use crate::journal::{key, records, settings, text};
use crate::record::Record;
use crate::run::{Places, Reading, Shard, Tell, begin, finish, tell_shard};
use crate::source::Source;
use crate::stages::StageName;
use crate::store::store;

/// Whether a curation has looked at all its files, and nothing passed: it has a report and no corpus.
pub fn nothing_left(places: &Places) -> bool {
    let text = std::fs::read_to_string(places.funnel()).unwrap_or_default();
    let funnel: serde_json::Value = serde_json::from_str(&text).unwrap_or_default();
    !places.out.exists() && funnel["kept"] == 0
}

/// Makes one corpus of the corpora that the shards of a folder gave, without the duplicates between them. One of which
/// nothing passed has none, and counts with what was dropped. What is made can be merged with others in its turn.
///
/// The assets of the corpora in `keep` keep their splits; the others get theirs as the config says, among themselves.
///
/// # Errors
/// As [`crate::curate`], when a corpus has no journal beside it or one of later files ([`CurateError::Older`]),
/// [`CurateError::Unlike`] for assets of one name and different files, and when `places` are those of one of the corpora.
pub fn merge_shards(
    corpora: &[PathBuf],
    keep: &[PathBuf],
    places: &Places,
    config: &CurateConfig,
    tell: Tell,
) -> Result<Funnel, CurateError> {
    let inputs: Vec<Places> = corpora.iter().map(|path| Places::of(path)).collect();
    if inputs.iter().any(|input| same(&input.out, &places.out) || same(&input.work, &places.work)) {
        // Its journal and report would be lost with it.
        return Err(DataError::Same(places.out.clone()).into());
    }
    begin(places)?;
    if let Some(missing) = missing(corpora) {
        tell(&missing, 0, 0);
    }
    let all = gather(&inputs).inspect_err(|_| drop(std::fs::remove_dir(&places.work)))?;
    let looked_at = looked_at(&inputs, config, tell);
    let checksums: HashMap<&str, &str> = all.iter().map(|record| (record.name.as_str(), record.checksum())).collect();
    let mut open = Vec::new();
    let mut splits = HashMap::new();
    for input in &inputs {
        let corpus = if nothing_left(input) { None } else { Some(Corpus::open(&input.out)?) };
        if let Some(corpus) = &corpus {
            of_its_journal(corpus, input, &checksums)?;
        }
        if let Some(corpus) = corpus.as_ref().filter(|_| keep.contains(&input.out)) {
            splits.extend(corpus.names()?.iter().cloned().zip(corpus.texts("split")?));
        }
        open.extend(corpus);
        take_answers(&input.work.join("answers"), &places.work.join("answers"))?;
    }
    let config = CurateConfig { stages: passed(&inputs, config), ..config.clone() };
    let there: Vec<Vec<Shard>> = corpora.iter().map(|path| shards(path)).collect();
    // One that does not say which it is may be all of them.
    let known = if there.iter().any(Vec::is_empty) { Vec::new() } else { there.concat() };
    places.own()?;
    let done = finish(&Source::Corpora(&open, &splits, &known), &all, places, &known, &config, tell);
    if matches!(done, Ok(_) | Err(CurateError::NothingLeft { .. })) {
        store(&places.journal(), text(&all, &looked_at).as_bytes())?;
        tell_shard(places, Some(&known))?;
        tell_reading(&inputs, places)?;
    }
    done
}

/// The records of all inputs, by name. Of an asset in several inputs it is that of the first that could read it, as the
/// asset itself is then that of the first that has it.
fn gather(inputs: &[Places]) -> Result<Vec<Record>, CurateError> {
    let mut all: BTreeMap<String, (Record, &Places)> = BTreeMap::new();
    for input in inputs {
        for record in records(&input.journal())? {
            match all.entry(record.name.clone()) {
                Entry::Vacant(free) => drop(free.insert((record, input))),
                Entry::Occupied(mut taken) => {
                    let checksum = |record: &Record| record.facts.as_ref().map(|facts| facts.checksum.clone());
                    let (known, of) = taken.get();
                    match (checksum(known), checksum(&record)) {
                        (Some(a), Some(b)) if a != b => {
                            let (first, second) = (of.out.clone(), input.out.clone());
                            return Err(CurateError::Unlike { name: record.name, first, second });
                        }
                        (None, Some(_)) => drop(taken.insert((record, input))),
                        _ => {}
                    }
                }
            }
        }
    }
    Ok(all.into_values().map(|(record, _)| record).collect())
}

/// Whether the assets of a corpus are those that its journal is about: this may be of a later curation, which was broken off
/// before it wrote a corpus. `checksums` are those of the files of all inputs' records, by asset.
fn of_its_journal(corpus: &Corpus, input: &Places, checksums: &HashMap<&str, &str>) -> Result<(), CurateError> {
    let known: HashSet<String> = records(&input.journal())?.into_iter().map(|record| record.name).collect();
    let own = corpus.names()?.iter().zip(corpus.texts("checksum")?);
    // What could not be read then is not taken from the corpus either.
    let is_other = |name: &str, own: &str| checksums.get(name).is_some_and(|now| !now.is_empty() && *now != own);
    match own.into_iter().find(|(name, own)| !known.contains(*name) || is_other(name, own)) {
        Some((name, _)) => Err(CurateError::Older { path: input.out.clone(), name: name.clone() }),
        None => Ok(()),
    }
}

/// The stages that what is merged has passed, as the reports of its parts say, and that of duplicates where the config asks for
/// it; those of the config where nothing is said.
fn passed(inputs: &[Places], config: &CurateConfig) -> Vec<StageName> {
    let funnels: Vec<Funnel> = inputs.iter().filter_map(|input| funnel(&input.funnel())).collect();
    if funnels.is_empty() {
        return config.stages.clone();
    }
    let mut stages: Vec<StageName> = Vec::new();
    for stage in funnels.iter().flat_map(|funnel| &funnel.stages) {
        let known = StageName::ALL.into_iter().find(|known| known.name() == stage.stage);
        stages.extend(known.filter(|known| *known != StageName::Duplicates && !stages.contains(known)));
    }
    stages.extend(config.stages.contains(&StageName::Duplicates).then_some(StageName::Duplicates));
    stages
}

/// The numbers of a curation, if they are there.
fn funnel(path: &Path) -> Option<Funnel> {
    std::fs::read(path).ok().and_then(|text| serde_json::from_slice(&text).ok())
}

/// What the settings and the version were, as journals say it, by which the inputs' files were looked at; told where they were
/// not those of `config` alone, as merging looks at no file.
fn looked_at(inputs: &[Places], config: &CurateConfig, tell: Tell) -> String {
    let keys: Vec<String> = inputs.iter().map(|input| settings(&input.journal())).collect();
    let first = keys.first().cloned().unwrap_or_default();
    if let Some(other) = keys.iter().position(|key| *key != first) {
        let [a, b] = [&inputs[0], &inputs[other]].map(|input| input.out.display());
        let how = "were made with different settings or versions of riglab";
        tell(&format!("{a} and {b} {how}, so their assets passed different stages"), 0, 0);
        return keys.concat();
    }
    if first != key(config) {
        let told = "the parts were made with other settings than these, or by another version of riglab: merging looks at no \
                    file, so settings of import and repair have no effect, and of stages that of duplicates alone; curate the \
                    files again for that";
        tell(told, 0, 0);
    }
    first
}

/// Those corpora of curations whose splits a list gave, as their reports say.
pub fn listed(corpora: &[PathBuf]) -> Vec<PathBuf> {
    let by_list =
        |path: &&PathBuf| funnel(&Places::of(path).funnel()).is_some_and(|funnel| funnel.split_by == SplitBy::List);
    corpora.iter().filter(by_list).cloned().collect()
}

/// The file beside a corpus that says which shards it is of.
pub(crate) const SHARD: &str = "shard.json";

/// Says how the assets were read, where it is the same for all.
fn tell_reading(inputs: &[Places], places: &Places) -> Result<(), CurateError> {
    let mut all = inputs.iter().map(Reading::of);
    match all.next().flatten().filter(|first| all.all(|other| other.as_ref() == Some(first))) {
        Some(reading) => reading.store(places),
        None => {
            // That of an earlier merge; mostly there is none.
            let _ = std::fs::remove_file(places.reading());
            Ok(())
        }
    }
}

/// The shards that a corpus is of, as far as that is said; none of the whole.
pub fn shards(corpus: &Path) -> Vec<Shard> {
    let text = std::fs::read(Places::of(corpus).work.join(SHARD)).unwrap_or_default();
    // Earlier there was one.
    let one = || serde_json::from_slice(&text).map_or(Vec::new(), |one| vec![one]);
    serde_json::from_slice(&text).unwrap_or_else(|_| one())
}

/// Missing shards that are named.
const NAMED: usize = 10;

/// Tells which shards are not among these, as far as they say of how many they are.
fn missing(corpora: &[PathBuf]) -> Option<String> {
    let there: Vec<Shard> = corpora.iter().flat_map(|path| shards(path)).collect();
    let of = there.first()?.of;
    let known: HashSet<u64> = there.iter().filter(|shard| shard.of == of).map(|shard| shard.number).collect();
    let lacking = (1..=of).filter(|number| !known.contains(number));
    let count = of.saturating_sub(known.iter().filter(|number| (1..=of).contains(*number)).count() as u64);
    let mut named: Vec<String> = lacking.take(NAMED).map(|number| format!("{number}/{of}")).collect();
    let more = count.saturating_sub(named.len() as u64);
    if more > 0 {
        named.push(format!("and {more} more"));
    }
    let (is, s) = if count == 1 { ("is", "") } else { ("are", "s") };
    (count > 0).then(|| format!("shard{s} {} {is} missing: the corpus is not whole", named.join(", ")))
}

/// Takes over answers that shards have paid for.
fn take_answers(from: &Path, to: &Path) -> Result<(), CurateError> {
    let Ok(entries) = std::fs::read_dir(from) else { return Ok(()) };
    std::fs::create_dir_all(to).map_err(|e| CurateError::write(to, &e))?;
    for entry in entries.flatten().filter(|e| e.path().extension().is_some_and(|e| e == "json")) {
        let bytes = std::fs::read(entry.path()).map_err(|e| CurateError::io(&entry.path(), e))?;
        store(&to.join(entry.file_name()), &bytes)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::journal::Journal;
    use crate::record::facts;

    /// A curation whose journal has one asset, of a file of this checksum; without one it could not be read.
    fn part(dir: &Path, name: &str, config: &CurateConfig, checksum: Option<&str>) -> Places {
        let places = Places::of(&dir.join(name));
        std::fs::create_dir_all(&places.work).unwrap();
        let mut record = Record::refused("x.glb".into(), "x.glb".into(), "no rig".into());
        record.facts = checksum.map(|sum| facts(sum, name));
        let (mut journal, _) = Journal::open(&places.journal(), config).unwrap();
        journal.add("x.glb", crate::Stamp::of(dir, 0), &[record]).unwrap();
        places
    }

    #[test]
    fn unlike_assets_of_one_name_are_refused_and_like_ones_come_once() {
        let dir = tempfile::tempdir().unwrap();
        let part = |name: &str, sum| part(dir.path(), name, &CurateConfig::default(), sum);
        let [a, b, again] = [part("a.h5", Some("1")), part("b.h5", Some("2")), part("again.h5", Some("1"))];
        let unread = part("unread.h5", None);
        let said = gather(&[a.clone(), b.clone()]).unwrap_err().to_string();
        assert!(said.contains("a.h5") && said.contains("b.h5") && said.contains("`x.glb`"), "{said}");
        assert!(said.contains("riglab dataset merge --prefix"), "{said}");
        for inputs in [[&a, &again], [&a, &unread], [&unread, &a]] {
            let all = gather(&inputs.map(Clone::clone)).unwrap();
            let sources: Vec<_> = all.iter().map(|record| record.facts.as_ref().unwrap().source.as_str()).collect();
            assert_eq!(sources, ["a.h5"]);
        }
    }

    #[test]
    fn settings_that_differ_are_told() {
        let dir = tempfile::tempdir().unwrap();
        let own = CurateConfig::default();
        let mut other = own.clone();
        other.bones.min = 20;
        let [a, b, c] = [("a.h5", &own), ("b.h5", &own), ("c.h5", &other)]
            .map(|(name, config)| part(dir.path(), name, config, Some("1")));
        let told = |inputs: &[&Places], config: &CurateConfig| {
            let said = std::sync::Mutex::new(String::new());
            let inputs: Vec<Places> = inputs.iter().map(|&input| input.clone()).collect();
            looked_at(&inputs, config, &|text, _, _| said.lock().unwrap().push_str(text));
            said.into_inner().unwrap()
        };
        assert_eq!(told(&[&a, &b], &own), "");
        assert!(told(&[&a, &b], &other).contains("have no effect"));
        let said = told(&[&a, &b, &c], &own);
        assert!(said.contains("a.h5 and ") && said.contains("c.h5 were made with different settings"), "{said}");
    }

    #[test]
    fn an_input_is_not_written_over() {
        let dir = tempfile::tempdir().unwrap();
        let a = part(dir.path(), "a.h5", &CurateConfig::default(), Some("1"));
        std::fs::write(&a.out, "a corpus").unwrap();
        // The folder beside it is that of a.h5, too.
        for out in [a.out.clone(), dir.path().join("a.hdf5")] {
            let done = merge_shards(
                std::slice::from_ref(&a.out),
                &[],
                &Places::of(&out),
                &CurateConfig::default(),
                &|_, _, _| (),
            );
            assert!(done.unwrap_err().to_string().contains("is the input"), "{}", out.display());
        }
        assert_eq!(records(&a.journal()).unwrap().len(), 1);
    }

    #[test]
    fn shards_that_are_not_there_are_told() {
        let dir = tempfile::tempdir().unwrap();
        let part = |number: u64, of: u64| {
            let path = dir.path().join(format!("part{number}.h5"));
            let work = Places::of(&path).work;
            std::fs::create_dir_all(&work).unwrap();
            std::fs::write(work.join(SHARD), serde_json::to_vec(&Shard { number, of }).unwrap()).unwrap();
            path
        };
        let parts: Vec<PathBuf> = (1..=4).map(|number| part(number, 4)).collect();
        assert_eq!(missing(&parts), None);
        let told = missing(&parts[1..3]).unwrap();
        assert!(told.contains("1/4, 4/4 are missing"), "{told}");
        let told = missing(&[part(7, u64::from(u32::MAX))]).unwrap();
        assert!(told.contains("10/4294967295, 11/4294967295, and 4294967284 more are missing"), "{told}");
        // What does not say that it is a shard is asked nothing.
        assert_eq!(missing(&[dir.path().join("whole.h5")]), None);
    }
}
