//! Assets read a second time, for those that are kept.

use std::collections::HashMap;
use std::ops::ControlFlow;

use rayon::prelude::*;
use riglab_asset::file_and_item;
use riglab_core::Asset;
use riglab_data::Corpus;

use crate::CurateError;
use crate::config::CurateConfig;
use crate::read::{Folder, ReadOutcome};
use crate::record::Record;
use crate::repair::repair;
use crate::run::Shard;

/// Assets read before they are written: bounds memory.
const AT_ONCE: usize = 64;

/// Names of assets of a file, with the checksum that it had when they were looked at.
type Wanted<'a> = HashMap<&'a str, &'a str>;

/// Where assets are read again from.
pub(crate) enum Source<'a> {
    /// The folder's files, repaired as by these settings.
    Folder(&'a Folder, &'a CurateConfig),
    /// The corpora of its shards, with the splits of theirs that stay, by asset, and which shards they are.
    Corpora(&'a [Corpus], &'a HashMap<String, String>, &'a [Shard]),
}

impl Source<'_> {
    /// Sentences on what looks mistaken in the folder's manifest.
    pub(crate) fn doubts(&self) -> Vec<String> {
        match self {
            Self::Folder(folder, _) => folder.doubts(),
            Self::Corpora(..) => Vec::new(),
        }
    }

    /// The split of an asset, where it stays as it is.
    pub(crate) fn split(&self, name: &str) -> Option<&String> {
        match self {
            Self::Corpora(_, splits, _) => splits.get(name),
            Self::Folder(..) => None,
        }
    }

    /// Whether a name is that of a file of the folder, or may be, as it is of a shard that is not here; of those that are, the
    /// records know.
    pub(crate) fn is_there(&self, name: &str) -> bool {
        match self {
            Self::Folder(folder, _) => folder.is_there(name),
            Self::Corpora(_, _, shards) => !Shard::any_has(shards, self.file(name)),
        }
    }

    /// The file that a name means: its own, or that of the asset of a file of several.
    pub(crate) fn file<'n>(&self, name: &'n str) -> &'n str {
        match self {
            Self::Folder(folder, _) => folder.file_of(name),
            Self::Corpora(..) => file_and_item(name).0,
        }
    }

    /// Gives the wanted assets, repaired, in the order of the records, a chunk at a time. Those of files that are not what the
    /// records are about any more are left out.
    pub(crate) fn each_chunk(
        &self,
        wanted: &[&Record],
        mut each: impl FnMut(Vec<Asset>) -> Result<(), CurateError>,
    ) -> Result<(), CurateError> {
        match self {
            Self::Corpora(corpora, ..) => {
                let mut at = HashMap::new();
                for (c, corpus) in corpora.iter().enumerate() {
                    for (i, name) in corpus.names()?.iter().enumerate() {
                        at.entry(name.clone()).or_insert((c, i));
                    }
                }
                for chunk in wanted.chunks(AT_ONCE) {
                    let places = chunk.iter().filter_map(|r| at.get(&r.name));
                    each(places.map(|&(c, i)| corpora[c].verified(i)).collect::<Result<_, _>>()?)?;
                }
                Ok(())
            }
            Self::Folder(folder, config) => {
                let again = |file: &str, wanted: &Wanted<'_>, give: &mut dyn FnMut(Asset) -> ControlFlow<()>| {
                    // The first of a name.
                    let mut wanted = wanted.clone();
                    folder.each(&folder.path(file), None, |found| match found {
                        ReadOutcome::Asset(mut read)
                            if wanted.remove(read.asset.name.as_str())
                                == Some(read.asset.provenance.checksum.as_str()) =>
                        {
                            // It was repaired before, so it can be.
                            let _ = repair(&mut read.asset, &config.repair);
                            give(read.asset)
                        }
                        _ => ControlFlow::Continue(()),
                    });
                };
                // Runs of records of one file, and runs of files of one record.
                let mut files: Vec<(&str, Wanted<'_>)> = Vec::new();
                for record in wanted {
                    match files.last_mut().filter(|(file, _)| *file == record.file) {
                        Some((_, names)) => drop(names.insert(&record.name, record.checksum())),
                        None => files.push((&record.file, Wanted::from([(record.name.as_str(), record.checksum())]))),
                    }
                }
                let mut rest = files.as_slice();
                while let Some((first, names)) = rest.first() {
                    if names.len() > 1 {
                        // More than memory may hold: streamed.
                        let (mut chunk, mut done) = (Vec::new(), Ok(()));
                        again(first, names, &mut |asset| {
                            chunk.push(asset);
                            if chunk.len() == AT_ONCE {
                                done = each(std::mem::take(&mut chunk));
                            }
                            if done.is_err() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
                        });
                        done?;
                        each(chunk)?;
                        rest = &rest[1..];
                        continue;
                    }
                    let run = rest.iter().take(AT_ONCE).take_while(|(_, names)| names.len() == 1).count();
                    let read = |(file, names): &(&str, Wanted<'_>)| {
                        let mut own = Vec::new();
                        again(file, names, &mut |asset| {
                            own.push(asset);
                            ControlFlow::Break(())
                        });
                        own
                    };
                    each(rest[..run].par_iter().flat_map_iter(read).collect())?;
                    rest = &rest[run..];
                }
                Ok(())
            }
        }
    }
}
