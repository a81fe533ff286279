//! Trees back to TOML.

use std::sync::Arc;

use serde::Serialize;

use crate::key::{self, Step, quoted, quoted_string};
use crate::origin::{Source, SourceKind};
use crate::tree::{Entry, Node, Table, Value};
use crate::{Config, ConfigError, Fault, FaultKind, Origin, parse};

/// One value of a configuration that is no table (or an empty one), and where it was written.
#[derive(Clone, Debug)]
pub struct Leaf {
    /// Path of keys, such as `model.width`.
    pub path: String,
    /// The value as TOML on one line.
    pub value: String,
    /// Where it was written.
    pub origin: Origin,
}

impl Config {
    /// Every value, in the order of paths.
    pub fn leaves(&self) -> Vec<Leaf> {
        let mut leaves = Vec::new();
        collect(self.root(), "", &mut leaves);
        leaves
    }

    /// The resolved configuration: keys sorted, nothing extended. Loads back to an equal tree.
    pub fn to_toml(&self) -> String {
        document(self.root(), false)
    }

    /// [`Config::to_toml`] with a comment behind each value that says where it was written.
    pub fn to_toml_with_origins(&self) -> String {
        document(self.root(), true)
    }

    /// Adds what nothing set: the values of the table at `path` (empty for the whole) as they were
    /// read, defaults included. A config saved after this repeats its run even where defaults change.
    ///
    /// # Errors
    /// A value that TOML cannot hold, such as a number above `i64::MAX` that is not set here.
    pub fn fill(&mut self, path: &str, value: &impl Serialize) -> Result<(), ConfigError> {
        let text = toml::to_string(value).map_err(|e| {
            Fault::new(FaultKind::Invalid, format!("the defaults of `{path}` cannot be written: {e}"), None)
        })?;
        let source = Arc::new(Source { name: "default".into(), kind: SourceKind::Label, text });
        let mut defaults = parse::document(&source)?;
        for step in key::steps(path).into_iter().rev() {
            let Step::Key(key) = step else { continue };
            let origin = Origin::whole(&source);
            let node = Node { value: Value::Table(std::mem::take(&mut defaults)), origin: origin.clone() };
            defaults.entries.insert(key, Entry { key: origin, node });
        }
        let mut set = self.root().clone();
        set.add_everywhere();
        defaults.merge(set);
        self.set_root(defaults);
        Ok(())
    }
}

fn collect(table: &Table, path: &str, leaves: &mut Vec<Leaf>) {
    for (key, entry) in &table.entries {
        let path = key::join(path, key);
        match &entry.node.value {
            Value::Table(inner) if !inner.entries.is_empty() => collect(inner, &path, leaves),
            value => leaves.push(Leaf { path, value: inline(value), origin: entry.node.origin.clone() }),
        }
    }
}

fn document(root: &Table, origins: bool) -> String {
    let mut out = String::new();
    write_table(root, "", origins, &mut out);
    out
}

/// Values first, then the tables inside under their headers: TOML gives no way back to a table.
fn write_table(table: &Table, path: &str, origins: bool, out: &mut String) {
    let inner = |node: &Node| matches!(node.value, Value::Table(_));
    let has_values = table.entries.values().any(|e| !inner(&e.node));
    if !path.is_empty() && (has_values || table.entries.is_empty()) {
        if !out.is_empty() {
            out.push('\n');
        }
        *out += &format!("[{path}]\n");
    }
    for (key, entry) in table.entries.iter().filter(|(_, e)| !inner(&e.node)) {
        *out += &format!("{} = {}", quoted(key), block(&entry.node.value));
        if origins {
            *out += &format!(" # {}", entry.node.origin.brief());
        }
        out.push('\n');
    }
    for (key, entry) in &table.entries {
        if let Value::Table(inner) = &entry.node.value {
            write_table(inner, &key::join(path, key), origins, out);
        }
    }
}

/// A value as it stands behind its key: an array of tables or arrays takes a line for each.
fn block(value: &Value) -> String {
    match value {
        Value::Array(nodes) if nodes.iter().any(|n| matches!(n.value, Value::Table(_) | Value::Array(_))) => {
            let lines: String = nodes.iter().map(|n| format!("    {},\n", inline(&n.value))).collect();
            format!("[\n{lines}]")
        }
        value => inline(value),
    }
}

/// A value on one line.
pub(crate) fn inline(value: &Value) -> String {
    match value {
        Value::String(s) => quoted_string(s),
        Value::Integer(n) => n.to_string(),
        Value::Boolean(b) => b.to_string(),
        // Rust writes the shortest digits that read back as the same number, always with point or exponent.
        Value::Float(x) => format!("{x:?}").to_lowercase(),
        Value::Array(nodes) => {
            format!("[{}]", nodes.iter().map(|n| inline(&n.value)).collect::<Vec<_>>().join(", "))
        }
        Value::Table(t) if t.entries.is_empty() => "{}".into(),
        Value::Table(t) => {
            let entries = t.entries.iter().map(|(key, e)| format!("{} = {}", quoted(key), inline(&e.node.value)));
            format!("{{ {} }}", entries.collect::<Vec<_>>().join(", "))
        }
    }
}
