//! Numbers of a config that no machine computes with.
//!
//! What sizes mean and how they must fit each other is for their tasks to say. That 10¹² layers are none, and that
//! infinity and NaN are nowhere what is meant, holds of every key of a task's or a recipe's settings, and is said before any
//! memory is asked for.

use crate::tree::{Node, Value};
use crate::{Config, ConfigError};

/// Layers of one kind at most.
const LAYERS: i128 = 10_000;
/// What one axis of a tensor may be long, and what may be worked on at a time.
const SIZE: i128 = 10_000_000;
/// Keys that count steps or say how much there is at most: memory does not grow with them.
const FREE: [&str; 13] = [
    "steps",
    "warmup",
    "patience",
    "log_every",
    "save_every",
    "validate_every",
    "histogram_every",
    "cache_mb",
    "chunk",
    "vertices",
    "validation_assets",
    "validation_vertices",
    "keep",
];

impl Config {
    /// Refuses the first number of a task's or a recipe's settings that cannot be meant, at the place where it was
    /// written.
    ///
    /// # Errors
    /// What it is, and what can be.
    pub fn bounded(self) -> Result<Self, ConfigError> {
        for leaf in self.leaves() {
            let key = leaf.path.rsplit('.').next().unwrap_or_default();
            if let Some(message) = self.root().find(&leaf.path).and_then(|node| fault(key, node)) {
                return Err(self.invalid(&leaf.path, message));
            }
        }
        Ok(self)
    }
}

fn most(key: &str) -> i128 {
    match key {
        "seed" => u64::MAX.into(),
        _ if FREE.contains(&key) || key.starts_with("max_") => i64::MAX.into(),
        _ if key.ends_with("layers") || key == "depths" => LAYERS,
        _ => SIZE,
    }
}

fn fault(key: &str, node: &Node) -> Option<String> {
    match &node.value {
        Value::Float(x) if !x.is_finite() => Some(format!("{x} is no number to compute with")),
        Value::Integer(n) if *n > most(key) => Some(too_large(*n, most(key))),
        Value::Array(all) => all.iter().find_map(|v| fault(key, v)),
        Value::Table(all) => all.entries.iter().find_map(|(key, entry)| fault(key, &entry.node)),
        _ => None,
    }
}

fn too_large(n: i128, most: i128) -> String {
    format!("{n} is more than any machine holds; at most {most}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn said(text: &str) -> String {
        let config = Config::from_toml_str("a.toml", text).unwrap();
        config.bounded().err().map_or_else(String::new, |e| e.to_string())
    }

    #[test]
    fn what_no_machine_holds_is_refused_where_it_was_written() {
        for (text, wanted) in [
            ("[model]\nwidth = 400000000000", "a.toml:2:9: `model.width`: 400000000000 is more than any machine holds"),
            ("[model.encoder]\ndepths = [2, 1000000]", "`model.encoder.depths`: 1000000 is more"),
            ("layers = 18446744073709551615", "at most 10000"),
            ("steps = 18446744073709551615", "at most 9223372036854775807"),
            ("depths = [18446744073709551615, 3]", "`depths`: 18446744073709551615 is more"),
            ("list = [{ seed = 18446744073709551615 }, { points = 18446744073709551615 }]", "at most 10000000"),
            ("scale = [1.0, inf]", "`scale`: inf is no number"),
            ("base = nan", "NaN is no number"),
            ("list = [{ points = 99999999 }]", "99999999 is more"),
        ] {
            let said = said(text);
            assert!(said.contains(wanted), "{text}: {said}");
        }
    }

    #[test]
    fn what_costs_nothing_may_be_large() {
        let text = "seed = 18446744073709551615\nsteps = 1000000000000\nsave_every = 9223372036854775807\n\
                    vertices = 4294967296\nmax_joints = 1000000000\nkeep = 1000000000\nwidth = 10000000\nname = 'nan'\nrate = 1e300\nlayers = 10000";
        assert_eq!(said(text), "");
    }
}
