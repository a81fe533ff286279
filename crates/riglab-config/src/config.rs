//! A resolved configuration.

use std::path::{Path, PathBuf};

use serde::Deserialize;

use crate::tree::{Node, Table, Value};
use crate::{ConfigError, Fault, FaultKind, Loader, Origin, de, key, nearest};

/// A table of a configuration, every layer merged, every value with its place.
///
/// Two are equal when their values are, wherever those were written.
#[derive(Clone, Debug)]
pub struct Config {
    root: Node,
    /// Path of this table in the whole; empty for the whole. Messages name keys from the top.
    prefix: String,
}

impl PartialEq for Config {
    fn eq(&self, other: &Self) -> bool {
        self.root.value == other.root.value
    }
}

impl Config {
    pub(crate) fn new(root: Table, origin: Origin) -> Self {
        Self { root: Node { value: Value::Table(root), origin }, prefix: String::new() }
    }

    /// Reads a file with all it extends, then applies `--set a.b=c` arguments in order. Names are
    /// looked up beside the file that says them, then in the `search` folders. For files built into
    /// the program see [`Loader::built_in`].
    ///
    /// # Errors
    /// A file that cannot be found, read or parsed, a cycle, or a bad argument, each with its place.
    pub fn load(path: impl AsRef<Path>, sets: &[impl AsRef<str>], search: &[PathBuf]) -> Result<Self, ConfigError> {
        Loader::new().search(search).load(path, sets)
    }

    /// Parses one text, called `name` in messages.
    ///
    /// # Errors
    /// A text that is not TOML, with the place.
    pub fn from_toml_str(name: &str, text: &str) -> Result<Self, ConfigError> {
        Loader::new().parse(name, text, &[] as &[&str])
    }

    pub(crate) fn root(&self) -> &Table {
        match &self.root.value {
            Value::Table(table) => table,
            _ => unreachable!("a config is a table"),
        }
    }

    pub(crate) fn set_root(&mut self, table: Table) {
        self.root.value = Value::Table(table);
    }

    /// The keys of this table, in alphabetical order.
    pub fn keys(&self) -> impl Iterator<Item = &str> {
        self.root().entries.keys().map(String::as_str)
    }

    /// Whether something is set at a path such as `model.width` or `sources[1].path`.
    pub fn contains(&self, path: &str) -> bool {
        self.root().find(path).is_some()
    }

    /// Where the value at a path was written; `None` if nothing set it.
    pub fn origin(&self, path: &str) -> Option<Origin> {
        self.root().find(path).map(|node| node.origin.clone())
    }

    /// This table as a type. Unknown keys are refused, all of them at once.
    ///
    /// # Errors
    /// Unknown, missing or wrong values, with their places.
    pub fn get<'a, T: Deserialize<'a>>(&'a self) -> Result<T, ConfigError> {
        de::from_node(&self.root, &self.prefix)
    }

    /// The value at a path as a type.
    ///
    /// # Errors
    /// As [`Config::get`]; nothing at the path.
    pub fn get_at<'a, T: Deserialize<'a>>(&'a self, path: &str) -> Result<T, ConfigError> {
        let node = self.root().find(path).ok_or_else(|| self.missing(path))?;
        de::from_node(node, &self.full(path))
    }

    /// The table at a path, for reading by whoever knows its type. Messages keep naming whole paths.
    ///
    /// # Errors
    /// Nothing, or no table, at the path.
    pub fn table(&self, path: &str) -> Result<Self, ConfigError> {
        let node = self.root().find(path).ok_or_else(|| self.missing(path))?;
        if !matches!(node.value, Value::Table(_)) {
            let message = format!("`{}` should be a table, but is {}", self.full(path), node.value.described());
            return Err(Fault::at(FaultKind::WrongType, &node.origin, message).into());
        }
        Ok(Self { root: node.clone(), prefix: self.full(path) })
    }

    /// The same without one of the keys of this table: for one that somebody else reads.
    #[must_use]
    pub fn without(mut self, key: &str) -> Self {
        let mut table = self.root().clone();
        table.entries.remove(key);
        self.set_root(table);
        self
    }

    /// The same where each table inside the one at a path says by `extends = []` that it was chosen anew, if it was: what
    /// is read there and set over another config replaces what that one has, as it would have here.
    ///
    /// ```
    /// # use riglab_config::{Config, Loader};
    /// let presets = [("small.toml", "width = 256\n")];
    /// let text = "[changes]\nmodel = { extends = 'small.toml' }\n";
    /// let config = Loader::new().built_in(&presets).parse("a.toml", text, &[] as &[&str])?;
    /// let changes: toml::Table = config.with_choices("changes").get_at("changes")?;
    /// assert_eq!(changes["model"].to_string(), "{ extends = [], width = 256 }");
    /// # Ok::<(), riglab_config::ConfigError>(())
    /// ```
    #[must_use]
    pub fn with_choices(mut self, path: &str) -> Self {
        let mut table = self.root().clone();
        if let Some(node) = table.find_mut(path) {
            node.value.tell_choices();
        }
        self.set_root(table);
        self
    }

    /// Refuses keys of this table that are not among `known`: for tables that are read one
    /// [`Config::table`] at a time.
    ///
    /// # Errors
    /// The unknown keys, with their places and nearest known keys.
    pub fn check_keys(&self, known: &[&str]) -> Result<(), ConfigError> {
        let faults: Vec<Fault> = self.root().unknown_keys(&self.prefix, known).collect();
        if faults.is_empty() { Ok(()) } else { Err(ConfigError::new(faults)) }
    }

    /// The error for a value that is wrong in a way only its reader knows, at the place of the value.
    /// One that nothing set has its default: the place is that of the table around it. Where it is
    /// built in, the hint is what the person set instead, of what the message names.
    ///
    /// ```
    /// # use riglab_config::Config;
    /// let config = Config::from_toml_str("small.toml", "[model]\nwidth = 100\n")?;
    /// let error = config.invalid("model.width", "100 is not divisible by the 3 heads");
    /// assert!(error.to_string().starts_with("small.toml:2:9: `model.width`: 100 is not divisible by the 3 heads"));
    /// # Ok::<(), riglab_config::ConfigError>(())
    /// ```
    pub fn invalid(&self, path: &str, message: impl std::fmt::Display) -> ConfigError {
        let full = self.full(path);
        let fault = match self.root().find(path) {
            Some(node) => {
                let message = message.to_string();
                let hint = if node.origin.is_built_in() { self.own(path, &message) } else { String::new() };
                Fault::at(FaultKind::Invalid, &node.origin, format!("`{full}`: {message}")).hint(hint)
            }
            None => {
                let above = self.root().find_above(path).unwrap_or(&self.root);
                Fault::at(FaultKind::Invalid, &above.origin, format!("`{full}` (not set, its default): {message}"))
            }
        };
        fault.into()
    }

    /// The error for a key that somebody has to set and nothing sets, at the place of the table that lacks it, with what
    /// to do.
    ///
    /// ```
    /// # use riglab_config::Config;
    /// let config = Config::from_toml_str("small.toml", "width = 100\n")?;
    /// let error = config.lacks("task", "add for instance task = \"copy\"");
    /// assert_eq!(error.to_string(), "small.toml: nothing sets `task`\n\nhint: add for instance task = \"copy\"");
    /// # Ok::<(), riglab_config::ConfigError>(())
    /// ```
    pub fn lacks(&self, path: &str, hint: impl std::fmt::Display) -> ConfigError {
        let above = self.root().find_above(path).unwrap_or(&self.root);
        let message = format!("nothing sets `{}`", self.full(path));
        Fault::at(FaultKind::MissingKey, &above.origin, message).hint(hint.to_string()).into()
    }

    /// Of a fault between values, at one that is built in: those that a person set, as far as the message names them.
    fn own(&self, path: &str, message: &str) -> String {
        let words: Vec<&str> = message.split(|c: char| !(c.is_alphanumeric() || "_.-".contains(c))).collect();
        let said = |name: &str| words.iter().any(|word| word.trim_matches('.') == name);
        let part = |path: &str| path.split('.').next().unwrap_or_default().to_owned();
        let near = |other: &str| part(other) == part(path) && said(other.rsplit('.').next().unwrap_or_default());
        let set = self.leaves().into_iter().filter(|leaf| {
            leaf.path != path && !leaf.origin.is_built_in() && (said(&self.full(&leaf.path)) || near(&leaf.path))
        });
        let set = set.map(|leaf| format!("`{} = {}` is from {}", self.full(&leaf.path), leaf.value, leaf.origin));
        set.collect::<Vec<_>>().join("; ")
    }

    fn full(&self, path: &str) -> String {
        match (self.prefix.as_str(), path) {
            (prefix, "") => prefix.to_owned(),
            ("", path) => path.to_owned(),
            (prefix, path) => format!("{prefix}.{path}"),
        }
    }

    fn missing(&self, path: &str) -> ConfigError {
        let above = self.root().find_above(path).unwrap_or(&self.root);
        let message = format!("nothing sets `{}`", self.full(path));
        let Value::Table(table) = &above.value else {
            return Fault::at(FaultKind::MissingKey, &above.origin, message).into();
        };
        let keys: Vec<&str> = table.entries.keys().map(String::as_str).collect();
        let last = match key::steps(path).pop() {
            Some(key::Step::Key(key)) => key,
            _ => String::new(),
        };
        let hint =
            nearest::nearest(&last, keys.iter().copied()).map(|near| format!("there is `{near}`; is it misspelt?"));
        Fault::at(FaultKind::MissingKey, &above.origin, message).hint(hint.unwrap_or_default()).into()
    }
}
