//! `--set a.b=c`.

use std::sync::Arc;

use toml::de::{DeTable, DeValue};

use crate::origin::{Source, SourceKind};
use crate::tree::{Entry, Node, Table, Value};
use crate::{ConfigError, Fault, FaultKind, Origin, key, parse};

/// Parses one argument into a layer. The value is TOML, or else a bare word that is taken as a
/// string: `lr=1e-4`, `layers=[1, 2]`, `name="a b"`, `name=word`.
pub(crate) fn layer(text: &str) -> Result<Table, ConfigError> {
    let source = Arc::new(Source { name: format!("--set {text}"), kind: SourceKind::Label, text: text.to_owned() });
    let whole = Origin::whole(&source);
    let refuse =
        |message: &str, hint: &str| Err(ConfigError::from(Fault::at(FaultKind::BadSet, &whole, message).hint(hint)));
    let Some(equals) = equals_sign(text) else {
        return refuse("there is no `=`", "write `--set key.path=value`");
    };
    let Some(keys) = key_path(&text[..equals]) else {
        return refuse(
            "this is no path of keys before the `=`",
            "write `--set key.path=value`, such as `model.width=384`",
        );
    };
    if keys == ["extends"] {
        return refuse("the experiment's own `extends` cannot be set", "name the other file as the experiment");
    }
    let after = &text[equals + 1..];
    let start = equals + 1 + (after.len() - after.trim_start().len());
    let span = start..start + after.trim().len();
    let word = &text[span.clone()];
    let node = match parse::value(&source, span.clone()) {
        Some(node) => node?,
        None if word.is_empty() => {
            return refuse("there is no value after the `=`", "write `\"\"` for an empty string");
        }
        None if word.starts_with(['[', '{', '"', '\'']) || word.contains(char::is_control) => {
            return refuse("this value is not TOML", "quote it for the shell: `--set 'layers=[1, 2]'`");
        }
        None => Node { value: Value::String(word.to_owned()), origin: Origin::new(&source, span) },
    };
    let nested = keys.into_iter().rev().fold(node, |node, key| {
        let entries = [(key, Entry { key: whole.clone(), node })].into();
        Node { value: Value::Table(Table { entries, anew: false }), origin: whole.clone() }
    });
    match nested.value {
        Value::Table(table) => Ok(table),
        _ => unreachable!("a path has at least one key"),
    }
}

/// The first `=` outside quotes.
fn equals_sign(text: &str) -> Option<usize> {
    let mut quote = None;
    text.char_indices().find_map(|(at, c)| {
        match (c, quote) {
            ('=', None) => return Some(at),
            ('"' | '\'', None) => quote = Some(c),
            (c, Some(q)) if c == q => quote = None,
            _ => {}
        }
        None
    })
}

/// The keys of a dotted path, as TOML reads them.
fn key_path(text: &str) -> Option<Vec<String>> {
    if text.contains(char::is_control) {
        return None;
    }
    let line = format!("{text}=0");
    let mut table = DeTable::parse(&line).ok()?.into_inner();
    let mut keys = Vec::new();
    loop {
        // Not one key: a comment, say.
        let (key, value) = Some(table.into_iter()).filter(|t| t.len() == 1)?.next()?;
        keys.push(key.into_inner().into_owned());
        match value.into_inner() {
            DeValue::Table(inner) => table = inner,
            DeValue::Integer(_) => return Some(keys),
            _ => return None,
        }
    }
}

/// Refuses a layer whose path goes through a value that is no table: merging would drop that value.
pub(crate) fn check_path(config: &Table, layer: &Table) -> Result<(), ConfigError> {
    let (mut below, mut over, mut path) = (config, layer, String::new());
    while let Some((key, entry)) = over.entries.iter().next() {
        path = key::join(&path, key);
        let Value::Table(inner) = &entry.node.value else { break };
        match below.entries.get(key).map(|e| &e.node) {
            Some(Node { value: Value::Table(table), .. }) => (below, over) = (table, inner),
            // Only a dotted path is refused: an inline table as the value replaces knowingly.
            Some(node) if entry.node.origin.is_whole() => {
                let message =
                    format!("`{path}` is {} (set at {}) and has no keys", node.value.described(), node.origin);
                let fault = Fault::at(FaultKind::BadSet, &entry.key, message);
                let array = matches!(node.value, Value::Array(_));
                let hint = if array { format!("set the whole array: `--set '{path}=[..]'`") } else { String::new() };
                return Err(fault.hint(hint).into());
            }
            _ => break,
        }
    }
    Ok(())
}
