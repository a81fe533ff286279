//! Files to one tree: finding them, `extends`, `--set`.

use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use crate::nearest::nearest;
use crate::origin::{Source, SourceKind};
use crate::tree::{Node, Table, Value};
use crate::{Config, ConfigError, Fault, FaultKind, Origin, parse, set};

/// Where configurations are looked for.
///
/// ```
/// # use riglab_config::Loader;
/// let presets = [("train/fast.toml", "steps = 100\n")];
/// let config = Loader::new().built_in(&presets).parse("a.toml", "extends = 'train/fast.toml'", &[] as &[&str])?;
/// assert_eq!(config.get_at::<u32>("steps")?, 100);
/// # Ok::<(), riglab_config::ConfigError>(())
/// ```
#[derive(Clone, Copy, Debug, Default)]
pub struct Loader<'a> {
    roots: &'a [PathBuf],
    built_in: &'a [(&'a str, &'a str)],
}

impl<'a> Loader<'a> {
    /// Looks beside the file that says `extends`, and nowhere else.
    pub fn new() -> Self {
        Self::default()
    }

    /// Looks in these folders too, in this order.
    #[must_use]
    pub fn search(mut self, roots: &'a [PathBuf]) -> Self {
        self.roots = roots;
        self
    }

    /// Looks among these texts last: pairs of a name with forward slashes, such as
    /// `model/fsq_cvae/small.toml`, and TOML. They see each other by relative names too.
    #[must_use]
    pub fn built_in(mut self, files: &'a [(&'a str, &'a str)]) -> Self {
        self.built_in = files;
        self
    }

    /// Reads a file with all it extends, then applies `--set` arguments in order. A path that does
    /// not exist as given is looked up like the names in `extends`.
    ///
    /// # Errors
    /// A file that cannot be found, read or parsed, a cycle, or a bad argument, each with its place.
    pub fn load(&self, path: impl AsRef<Path>, sets: &[impl AsRef<str>]) -> Result<Config, ConfigError> {
        let name = path.as_ref().to_string_lossy();
        let place = self.find(&name, None).map_err(|missing| {
            if Path::new(&*name).is_dir() {
                let fault = Fault::new(FaultKind::Unreadable, format!("{name}: a folder, not a file"), None);
                let own = path.as_ref().join("config.toml");
                let hint = match own.is_file() {
                    true => format!("its config is `{}`", own.display()),
                    false => "give a TOML file, or the name of a built-in one".into(),
                };
                return fault.hint(hint);
            }
            Fault::new(FaultKind::Unreadable, format!("{name}: no such file"), None).hint(missing.hint(&name))
        })?;
        let source = self.read(&place, None)?;
        self.finish(&source, &place, sets)
    }

    /// The same for a text already read. `name` is how messages call it; names in `extends` are
    /// looked up as if it were built in.
    ///
    /// # Errors
    /// As [`Loader::load`].
    pub fn parse(&self, name: &str, text: &str, sets: &[impl AsRef<str>]) -> Result<Config, ConfigError> {
        let source = Arc::new(Source { name: name.to_owned(), kind: SourceKind::File, text: text.to_owned() });
        self.finish(&source, &Place::BuiltIn(cleaned(Path::new(name))), sets)
    }

    fn finish(&self, source: &Arc<Source>, place: &Place, sets: &[impl AsRef<str>]) -> Result<Config, ConfigError> {
        let mut chain = Chain::default();
        let mut root = self.layer(source, place, &mut chain)?;
        for text in sets {
            let mut layer = set::layer(text.as_ref())?;
            set::check_path(&root, &layer)?;
            self.resolve(&mut layer, None, &mut chain)?;
            root.merge(layer);
        }
        Ok(Config::new(root, Origin::whole(source)))
    }

    /// A file's content with what it extends.
    fn layer(&self, source: &Arc<Source>, place: &Place, chain: &mut Chain) -> Result<Table, ConfigError> {
        chain.open.push((place.identity(), source.name.clone()));
        let mut table = parse::document(source)?;
        self.resolve(&mut table, Some(place), chain)?;
        // A file as a whole adds to what it is merged into; only a table inside chooses anew.
        table.anew = false;
        chain.open.pop();
        Ok(table)
    }

    /// Replaces `extends` in a table and all tables inside by what it names.
    fn resolve(&self, table: &mut Table, from: Option<&Place>, chain: &mut Chain) -> Result<(), ConfigError> {
        let extends = table.entries.remove("extends");
        for entry in table.entries.values_mut() {
            self.resolve_node(&mut entry.node, from, chain)?;
        }
        let Some(extends) = extends else { return Ok(()) };
        let mut below = Table::default();
        for (name, origin) in names(&extends.node)? {
            below.merge(self.extended(name, origin, from, chain)?);
        }
        below.merge(std::mem::take(table));
        *table = below;
        table.anew = true;
        Ok(())
    }

    fn resolve_node(&self, node: &mut Node, from: Option<&Place>, chain: &mut Chain) -> Result<(), ConfigError> {
        match &mut node.value {
            Value::Table(table) => self.resolve(table, from, chain),
            Value::Array(nodes) => nodes.iter_mut().try_for_each(|node| self.resolve_node(node, from, chain)),
            _ => Ok(()),
        }
    }

    /// The content of one file named in `extends`.
    fn extended(
        &self,
        name: &str,
        origin: &Origin,
        from: Option<&Place>,
        chain: &mut Chain,
    ) -> Result<Table, ConfigError> {
        let place = self.find(name, from).map_err(|missing| {
            Fault::at(FaultKind::BadExtends, origin, format!("`extends` names `{name}`, which does not exist"))
                .hint(missing.hint(name))
        })?;
        chain.check(&place, origin)?;
        let whole = place.whole();
        if let Some(table) = chain.known.get(&whole) {
            return Ok(table.clone());
        }
        let source = self.read(&place, Some(origin))?;
        let table = self.layer(&source, &place, chain)?;
        chain.known.insert(whole, table.clone());
        Ok(table)
    }

    /// Looks a name up: beside `from` (or in the working folder), in the roots, among the built-in.
    fn find(&self, name: &str, from: Option<&Place>) -> Result<Place, Missing> {
        let mut tried = Vec::new();
        let beside = match from {
            None => Some(PathBuf::from(name)),
            Some(Place::Disk(path)) => Some(path.parent().unwrap_or(Path::new("")).join(name)),
            Some(Place::BuiltIn(from)) => {
                let sibling = cleaned(&Path::new(from).parent().unwrap_or(Path::new("")).join(name));
                if self.text(&sibling).is_some() {
                    return Ok(Place::BuiltIn(sibling));
                }
                None
            }
        };
        for path in beside.into_iter().chain(self.roots.iter().map(|root| root.join(name))) {
            if path.metadata().is_ok_and(|m| !m.is_dir()) {
                return Ok(Place::Disk(path));
            }
            tried.push(path);
        }
        let name = cleaned(Path::new(name));
        if self.text(&name).is_some() {
            return Ok(Place::BuiltIn(name));
        }
        Err(Missing { known: self.built_in.iter().map(|(name, _)| name.to_string()).collect(), tried })
    }

    fn text(&self, name: &str) -> Option<&'a str> {
        self.built_in.iter().find(|(n, _)| *n == name).map(|(_, text)| *text)
    }

    fn read(&self, place: &Place, said_at: Option<&Origin>) -> Result<Arc<Source>, ConfigError> {
        let (kind, name, text) = match place {
            Place::BuiltIn(name) => (SourceKind::BuiltIn, name.clone(), self.text(name).map(str::to_owned)),
            Place::Disk(path) => {
                let name = cleaned(path);
                let unreadable = |why: String| Fault::new(FaultKind::Unreadable, why, said_at.cloned());
                let bytes = std::fs::read(path).map_err(|e| unreadable(format!("{name}: cannot be read: {e}")))?;
                if bytes.starts_with(b"\x89HDF\r\n\x1a\n") {
                    return Err(unreadable(format!(
                        "{name}: an HDF5 file such as a corpus, not a config; configs are TOML and name corpora in \
                         data.corpora"
                    ))
                    .into());
                }
                if bytes.contains(&0) {
                    return Err(unreadable(format!("{name}: a binary file, not a config; configs are TOML")).into());
                }
                let text = String::from_utf8(bytes).map_err(|e| {
                    let line = e.as_bytes()[..e.utf8_error().valid_up_to()].iter().filter(|b| **b == b'\n').count() + 1;
                    unreadable(format!("{name}:{line}: a letter that is not UTF-8; save the file as UTF-8"))
                })?;
                (SourceKind::File, name, Some(text))
            }
        };
        let text = text.expect("a built-in place was found by its name");
        Ok(Arc::new(Source { name, kind, text }))
    }
}

/// The paths in `extends`, with their places.
fn names(node: &Node) -> Result<Vec<(&str, &Origin)>, ConfigError> {
    match &node.value {
        Value::Array(nodes) => nodes.iter().map(name).collect(),
        _ => Ok(vec![name(node)?]),
    }
}

fn name(node: &Node) -> Result<(&str, &Origin), ConfigError> {
    match &node.value {
        Value::String(name) => Ok((name, &node.origin)),
        value => {
            let message = format!("`extends` should be a path or an array of paths, but is {}", value.described());
            Err(Fault::at(FaultKind::BadExtends, &node.origin, message).into())
        }
    }
}

/// A file that exists.
#[derive(Clone, Debug)]
enum Place {
    Disk(PathBuf),
    BuiltIn(String),
}

impl Place {
    /// Equal for equal files.
    fn identity(&self) -> PathBuf {
        match self {
            Self::Disk(path) => path.canonicalize().unwrap_or_else(|_| path.clone()),
            Self::BuiltIn(name) => Path::new("built-in").join(name),
        }
    }

    /// Equal where a file extends the same: a link's names are looked up beside the link.
    fn whole(&self) -> (PathBuf, PathBuf) {
        let folder = match self {
            Self::Disk(path) => {
                let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
                folder.canonicalize().unwrap_or_else(|_| folder.into())
            }
            Self::BuiltIn(_) => PathBuf::new(),
        };
        (self.identity(), folder)
    }
}

/// What one load has come through.
#[derive(Debug, Default)]
struct Chain {
    /// The files being read, outermost first: identity and name.
    open: Vec<(PathBuf, String)>,
    /// The content of those that were extended already, with all that they extend: read anew each time it is named, a file
    /// that each of a few dozen others names twice would never come to an end.
    known: BTreeMap<(PathBuf, PathBuf), Table>,
}

impl Chain {
    fn check(&self, place: &Place, origin: &Origin) -> Result<(), ConfigError> {
        let identity = place.identity();
        let Some(start) = self.open.iter().position(|(id, _)| *id == identity) else { return Ok(()) };
        let mut names: Vec<&str> = self.open[start..].iter().map(|(_, name)| name.as_str()).collect();
        names.push(names[0]);
        let message = format!("`extends` goes in a circle: {}", names.join(" -> "));
        Err(Fault::at(FaultKind::Cycle, origin, message).into())
    }
}

/// Where a file was not found.
struct Missing {
    tried: Vec<PathBuf>,
    known: Vec<String>,
}

impl Missing {
    fn hint(&self, name: &str) -> String {
        let mut known: BTreeSet<String> = self.known.iter().cloned().collect();
        for path in &self.tried {
            let folder = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
            let above = Path::new(name).parent().unwrap_or(Path::new(""));
            let files = folder.read_dir().into_iter().flatten().flatten();
            // No config is a folder.
            for file in files.filter(|file| file.path().is_file()) {
                known.insert(above.join(file.file_name()).to_string_lossy().into_owned());
            }
        }
        if let Some(near) = nearest(name, known.iter().map(String::as_str)) {
            return format!("did you mean `{near}`?");
        }
        // A name without its folder, or without its ending.
        let stem = Path::new(name).file_stem();
        if let Some(same) = known.iter().find(|known| Path::new(known).file_stem() == stem) {
            return format!("did you mean `{same}`?");
        }
        let mut places: Vec<String> = self.tried.iter().map(|p| format!("`{}`", cleaned(p))).collect();
        if !self.known.is_empty() {
            places.push("the built-in files".into());
        }
        places.dedup();
        if places.is_empty() {
            "a text can only extend built-in files".into()
        } else {
            format!("looked for {}", places.join(", "))
        }
    }
}

/// A path without `.` and `a/..`, for showing and for built-in names; never opened, since `..` may
/// cross a link.
fn cleaned(path: &Path) -> String {
    let mut parts: Vec<Component<'_>> = Vec::new();
    for part in path.components() {
        match (part, parts.last()) {
            (Component::CurDir, _) => {}
            (Component::ParentDir, Some(Component::Normal(_))) => {
                parts.pop();
            }
            _ => parts.push(part),
        }
    }
    let clean: PathBuf = parts.into_iter().collect();
    clean.to_string_lossy().into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_text_is_told_as_what_it_is() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("corpus.h5");
        let said = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Loader::new().load(&path, &[] as &[&str]).unwrap_err().to_string()
        };
        let of = said(b"\x89HDF\r\n\x1a\n\0\xff");
        assert!(of.contains("corpus.h5: an HDF5 file") && of.contains("TOML") && of.contains("data.corpora"), "{of}");
        assert!(said(b"glTF\x02\0\0\0").contains("configs are TOML"));
    }

    #[test]
    fn text_in_another_encoding_is_told_once_and_with_its_line() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("latin1.toml");
        std::fs::write(&path, b"task = 'x'\n# caf\xe9\n").unwrap();
        let said = Loader::new().load(&path, &[] as &[&str]).unwrap_err().to_string();
        assert!(said.ends_with("latin1.toml:2: a letter that is not UTF-8; save the file as UTF-8"), "{said}");
    }

    #[test]
    fn a_file_that_is_extended_again_and_again_is_read_once() {
        // Twice each: read anew each time, the last would be read 2^60 times.
        let text = |k: usize| {
            format!("k{k} = {k}\nextends = ['f{0}.toml', 'f{0}.toml']\n[t{k}]\nextends = 'end.toml'\n", k + 1)
        };
        let files: Vec<(String, String)> = (0..60).map(|k| (format!("f{k}.toml"), text(k))).collect();
        let mut files: Vec<(&str, &str)> = files.iter().map(|(name, text)| (name.as_str(), text.as_str())).collect();
        files.extend([("f60.toml", "k60 = 60"), ("end.toml", "x = 1")]);
        let config = Loader::new().built_in(&files).load("f0.toml", &["t0.x=2", "s.extends='f0.toml'"]).unwrap();
        assert_eq!((config.keys().count(), config.get_at::<u32>("k60").unwrap()), (61 + 60 + 1, 60));
        let at = |path: &str| config.get_at::<u32>(path).unwrap();
        assert_eq!([at("t0.x"), at("t59.x"), at("s.k60"), at("s.t0.x")], [2, 1, 60, 1]);
        // A circle is one however often a file of it was come through.
        let circle =
            [("a.toml", "extends = ['b.toml', 'b.toml', 'c.toml']"), ("b.toml", ""), ("c.toml", "extends = 'a.toml'")];
        let said = Loader::new().built_in(&circle).load("a.toml", &[] as &[&str]).unwrap_err().to_string();
        assert!(said.contains("in a circle: a.toml -> c.toml -> a.toml"), "{said}");
    }

    #[cfg(unix)]
    #[test]
    fn a_link_extends_what_lies_beside_it() {
        let dir = tempfile::tempdir().unwrap();
        for (folder, x) in [("a", 1), ("b", 2)] {
            std::fs::create_dir(dir.path().join(folder)).unwrap();
            std::fs::write(dir.path().join(folder).join("own.toml"), format!("x = {x}")).unwrap();
        }
        std::fs::write(dir.path().join("a/block.toml"), "extends = 'own.toml'").unwrap();
        std::os::unix::fs::symlink(dir.path().join("a/block.toml"), dir.path().join("b/block.toml")).unwrap();
        let both = "[a]\nextends = 'a/block.toml'\n[b]\nextends = 'b/block.toml'\n";
        std::fs::write(dir.path().join("both.toml"), both).unwrap();
        let config = Config::load(dir.path().join("both.toml"), &[] as &[&str], &[]).unwrap();
        assert_eq!(["a.x", "b.x"].map(|path| config.get_at::<u32>(path).unwrap()), [1, 2]);
    }
}
