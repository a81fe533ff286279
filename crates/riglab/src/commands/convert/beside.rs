//! What stands beside files in lists, as they have no place for it: sources, licences, authors, categories and splits.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use riglab_core::Provenance;
use riglab_data::{Manifest, Splitter, name_below};

use crate::commands::shown;

/// What the lists of a folder say of its files.
pub struct Known<'a> {
    folder: &'a Path,
    manifest: Manifest,
    splits: Option<Splitter>,
}

impl<'a> Known<'a> {
    /// Nothing where there are no lists.
    ///
    /// # Errors
    /// Where a split file is none: `riglab dataset import` refuses it, too.
    pub fn of(folder: &'a Path) -> Result<Self> {
        let list = folder.join("split.json");
        let splits = list.is_file().then(|| Splitter::read(&list)).transpose()?;
        let manifest = Manifest::read(folder);
        manifest.told().iter().for_each(|told| tell!("note: {told}"));
        Ok(Self { folder, manifest, splits })
    }

    /// The split of an asset, and what is known of it: the only one of its file, or one of several by its own name. That the
    /// file is its source need not be said.
    pub fn about(&self, file: &Path, own: Option<&str>, from: &Provenance) -> (String, Provenance) {
        let file = name_below(self.folder, file);
        let name = own.map_or_else(|| file.clone(), |own| format!("{file}#{own}"));
        let mut about = Provenance { source: String::new(), ..from.clone() };
        self.manifest.describe(&name, &file, &mut about);
        let split = self.splits.as_ref().and_then(|splits| splits.given(&name));
        (split.unwrap_or_default().to_owned(), about)
    }
}

/// What importing calls an asset of a file of as many.
pub fn name_in(file: &Path, own: &str, many: usize) -> String {
    let file = file.file_name().unwrap_or_default().to_string_lossy();
    if many > 1 { format!("{file}#{}", own.trim()) } else { file.into_owned() }
}

/// What is known of assets and their files cannot say: `manifest.json` and `split.json`, as `riglab dataset import` and
/// `riglab curate` read them.
#[derive(Default)]
pub struct Beside {
    entries: Vec<serde_json::Value>,
    splits: BTreeMap<String, Vec<String>>,
}

impl Beside {
    /// Of an asset, by the name that importing gives to it: its file's path below the folder, and its own in a file of several.
    pub fn add(&mut self, name: &str, split: &str, from: &Provenance) {
        let all = [
            ("source", &from.source),
            ("licence", &from.licence),
            ("author", &from.author),
            ("category", &from.category),
        ];
        let said = all.into_iter().filter(|(_, value)| !value.is_empty());
        let mut entry: serde_json::Map<_, _> =
            said.map(|(key, value)| (key.to_owned(), value.as_str().into())).collect();
        if !entry.is_empty() {
            entry.insert("file".into(), name.into());
            self.entries.push(entry.into());
        }
        if !split.is_empty() {
            self.splits.entry(split.to_owned()).or_default().push(name.to_owned());
        }
    }

    /// Of a file below `folder`.
    pub fn add_file(&mut self, folder: &Path, file: &Path, split: &str, from: &Provenance) {
        let steps = file.strip_prefix(folder).unwrap_or(file).iter().map(|step| step.to_string_lossy());
        self.add(&steps.collect::<Vec<_>>().join("/"), split, from);
    }

    /// Gives the files that were written into a folder. `whose` it is that knew it stands in what is told.
    pub fn write(&self, folder: &Path, whose: &str) -> Result<Vec<PathBuf>> {
        let mut written = Vec::new();
        let all = [
            ("manifest.json", self.entries.is_empty(), serde_json::to_string_pretty(&self.entries)?),
            ("split.json", self.splits.is_empty(), serde_json::to_string_pretty(&self.splits)?),
        ];
        for (name, _, text) in all.iter().filter(|(_, empty, _)| !empty) {
            let path = folder.join(name);
            if path.exists() {
                tell!("note: {} is there already and stays; what {whose} knows is not written", path.display());
                continue;
            }
            riglab_files::write(&path, (text.clone() + "\n").as_bytes())
                .with_context(|| format!("{}", path.display()))?;
            written.push(path);
        }
        Ok(written)
    }

    /// Writes it beside a file of several assets, and says so.
    pub fn write_beside(&self, out: &Path, whose: &str) -> Result<()> {
        self.write_in(out.parent().unwrap_or(Path::new("")), whose)
    }

    /// Writes it into the folder that its files are named below, and says so.
    pub fn write_in(&self, folder: &Path, whose: &str) -> Result<()> {
        let written = self.write(folder, whose)?;
        if !written.is_empty() {
            // Whoever imports the folder gets these splits for all that is in it.
            let written: Vec<String> = written.iter().map(|path| shown(path)).collect();
            tell!(
                "note: what {whose} knows of sources, licences, categories and splits is in {}",
                written.join(" and ")
            );
        }
        Ok(())
    }
}
