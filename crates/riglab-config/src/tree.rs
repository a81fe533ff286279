//! Values that know where they were written, and how layers of them merge.

use std::collections::BTreeMap;

use crate::key::{self, Step};
use crate::{Fault, FaultKind, Origin};

/// A value and where it was written.
#[derive(Clone, Debug)]
pub(crate) struct Node {
    pub value: Value,
    /// For a table: where it was last opened.
    pub origin: Origin,
}

#[derive(Clone, Debug)]
pub(crate) enum Value {
    String(String),
    /// From `i64::MIN` to `u64::MAX`.
    Integer(i128),
    Float(f64),
    Boolean(bool),
    Array(Vec<Node>),
    Table(Table),
}

/// Keys in alphabetical order.
#[derive(Clone, Debug, Default)]
pub(crate) struct Table {
    pub entries: BTreeMap<String, Entry>,
    /// Replaces what a lower layer has here instead of adding to it: the table said `extends`, or
    /// took the place of a value that is no table. The second keeps merging associative.
    pub anew: bool,
}

/// A value under its key.
#[derive(Clone, Debug)]
pub(crate) struct Entry {
    /// Where the key was last written.
    pub key: Origin,
    pub node: Node,
}

/// Values are equal wherever they were written; a NaN equals itself, so that what was saved and
/// loaded again is the same.
impl PartialEq for Value {
    fn eq(&self, other: &Self) -> bool {
        match (self, other) {
            (Self::String(a), Self::String(b)) => a == b,
            (Self::Integer(a), Self::Integer(b)) => a == b,
            (Self::Float(a), Self::Float(b)) => a.to_bits() == b.to_bits(),
            (Self::Boolean(a), Self::Boolean(b)) => a == b,
            (Self::Array(a), Self::Array(b)) => a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.value == b.value),
            (Self::Table(a), Self::Table(b)) => a == b,
            _ => false,
        }
    }
}

impl PartialEq for Table {
    fn eq(&self, other: &Self) -> bool {
        self.entries.len() == other.entries.len()
            && self.entries.iter().zip(&other.entries).all(|(a, b)| a.0 == b.0 && a.1.node.value == b.1.node.value)
    }
}

impl Node {
    fn tell_choice(&mut self) {
        match &mut self.value {
            Value::Table(table) if table.anew => {
                let node = Self { value: Value::Array(Vec::new()), origin: self.origin.clone() };
                table.entries.insert("extends".into(), Entry { key: self.origin.clone(), node });
            }
            value => value.tell_choices(),
        }
    }
}

impl Value {
    /// Has the tables inside say `extends = []` that were chosen anew, which goes without saying in one that was itself.
    pub fn tell_choices(&mut self) {
        match self {
            Self::Table(table) => table.entries.values_mut().for_each(|entry| entry.node.tell_choice()),
            Self::Array(nodes) => nodes.iter_mut().for_each(Node::tell_choice),
            _ => {}
        }
    }

    /// For "should be .., but is ..".
    pub fn described(&self) -> String {
        match self {
            Self::Array(a) => format!("an array of {}", counted(a.len(), "value")),
            Self::Table(_) => "a table".into(),
            Self::String(s) if s.chars().count() > 40 => {
                format!("the string \"{}...\"", s.chars().take(40).collect::<String>().escape_debug())
            }
            Self::String(s) => format!("the string {}", key::quoted_string(s)),
            scalar => crate::write::inline(scalar),
        }
    }
}

/// "1 value", "2 values".
pub(crate) fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

impl Table {
    /// Puts a layer over this one: tables merge key by key, everything else replaces.
    pub fn merge(&mut self, over: Self) {
        if over.anew {
            *self = over;
            return;
        }
        for (key, mut entry) in over.entries {
            let below = self.entries.remove(&key);
            if let Value::Table(table) = &mut entry.node.value {
                match below.map(|b| b.node.value) {
                    Some(Value::Table(mut merged)) => {
                        merged.merge(std::mem::take(table));
                        *table = merged;
                    }
                    Some(_) => table.anew = true,
                    None => {}
                }
            }
            self.entries.insert(key, entry);
        }
    }

    /// Lets all tables inside add to what is below, whatever they said.
    pub fn add_everywhere(&mut self) {
        self.anew = false;
        for entry in self.entries.values_mut() {
            if let Value::Table(table) = &mut entry.node.value {
                table.add_everywhere();
            }
        }
    }

    /// The value at a path.
    pub fn find(&self, path: &str) -> Option<&Node> {
        let mut steps = key::steps(path).into_iter();
        let Step::Key(first) = steps.next()? else { return None };
        steps.try_fold(&self.entries.get(&first)?.node, |node, step| match (&node.value, step) {
            (Value::Table(t), Step::Key(key)) => t.entries.get(&key).map(|e| &e.node),
            (Value::Array(a), Step::Index(at)) => a.get(at),
            _ => None,
        })
    }

    /// The value at a path, to be changed.
    pub fn find_mut(&mut self, path: &str) -> Option<&mut Node> {
        let mut steps = key::steps(path).into_iter();
        let Step::Key(first) = steps.next()? else { return None };
        steps.try_fold(&mut self.entries.get_mut(&first)?.node, |node, step| match (&mut node.value, step) {
            (Value::Table(t), Step::Key(key)) => t.entries.get_mut(&key).map(|e| &mut e.node),
            (Value::Array(a), Step::Index(at)) => a.get_mut(at),
            _ => None,
        })
    }

    /// The nearest value above a path that exists, if any.
    pub fn find_above(&self, path: &str) -> Option<&Node> {
        let cuts = path.rmatch_indices(['.', '[']).map(|(at, _)| at);
        cuts.filter_map(|at| self.find(&path[..at])).next()
    }

    /// Faults for the keys that are not among `known`.
    pub fn unknown_keys<'a>(&'a self, path: &'a str, known: &'a [&'a str]) -> impl Iterator<Item = Fault> + 'a {
        self.entries.iter().filter(|(key, _)| !known.contains(&key.as_str())).map(move |(key, entry)| {
            Fault::at(FaultKind::UnknownKey, &entry.key, format!("unknown key `{}`", key::join(path, key)))
                .hint(crate::nearest::suggestion(key, known, "keys"))
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::origin::{Source, SourceKind};

    fn anywhere() -> Origin {
        Origin::whole(&std::sync::Arc::new(Source { name: "a".into(), kind: SourceKind::File, text: String::new() }))
    }

    /// Trees over few keys, so that layers meet.
    fn tree() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            any::<bool>().prop_map(Value::Boolean),
            (0i128..3).prop_map(Value::Integer),
            "[ab]".prop_map(Value::String),
        ];
        leaf.prop_recursive(3, 24, 3, |inner| {
            let array = prop::collection::vec(inner.clone(), 0..3).prop_map(|values| {
                Value::Array(values.into_iter().map(|value| Node { value, origin: anywhere() }).collect())
            });
            prop_oneof![array, table(inner).prop_map(Value::Table)]
        })
    }

    fn table(of: impl Strategy<Value = Value>) -> impl Strategy<Value = Table> {
        (prop::collection::btree_map("[abc]", of, 0..3), prop::bool::weighted(0.2)).prop_map(|(map, anew)| Table {
            entries: map
                .into_iter()
                .map(|(key, value)| (key, Entry { key: anywhere(), node: Node { value, origin: anywhere() } }))
                .collect(),
            anew,
        })
    }

    fn merged(mut below: Table, over: &Table) -> Table {
        below.merge(over.clone());
        below
    }

    proptest! {
        #[test]
        fn merging_is_associative(a in table(tree()), b in table(tree()), c in table(tree())) {
            prop_assert_eq!(merged(merged(a.clone(), &b), &c), merged(a, &merged(b, &c)));
        }

        #[test]
        fn a_layer_over_itself_or_nothing_is_itself(a in table(tree())) {
            prop_assert_eq!(merged(a.clone(), &a), a.clone());
            prop_assert_eq!(merged(Table::default(), &a), a.clone());
            prop_assert_eq!(merged(a.clone(), &Table::default()), a);
        }
    }
}
