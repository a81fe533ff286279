//! Whether a checkpoint's tensors are those of a network.

use std::collections::{BTreeMap, BTreeSet};

use riglab_nn::params::Builder;

use super::Offered;
use super::names::{self, FoundModel, KnownAs, Model};

/// How a checkpoint's tensors fit a network, by the names of the network.
#[derive(Clone, Debug, PartialEq)]
pub struct Fit {
    /// Which network.
    pub model: Model,
    /// What stands before its names in the checkpoint.
    pub prefix: String,
    /// Parameters that are there with their shape, and how many numbers they are.
    pub fitting: (usize, usize),
    /// Parameters that are not there, with their shapes.
    pub missing: Vec<(String, Vec<i64>)>,
    /// Parameters that are there, but as no tensor that can be read.
    pub unread: Vec<String>,
    /// Where most of what is missing stands instead, below another prefix, and how many.
    pub elsewhere: Option<(String, usize)>,
    /// Parameters of another shape: found, expected.
    pub unlike: Vec<(String, Vec<i64>, Vec<i64>)>,
    /// What is there and known, but not needed, and why not.
    pub unneeded: Vec<(String, &'static str)>,
    /// What is there and has no place, with its shape.
    pub left_over: Vec<(String, Vec<i64>)>,
    /// Sentences about what fits by its shape, but not by what it is.
    pub wrong: Vec<String>,
    /// Sentences about what has its shape, but holds numbers that are no weights.
    pub unsound: Vec<String>,
}

impl Fit {
    /// Of a network that is being built. `names`: by the network's name the checkpoint's.
    pub(super) fn of(
        found: &FoundModel,
        network: &Builder,
        names: &BTreeMap<String, String>,
        offered: &Offered<'_>,
    ) -> Self {
        let shapes = &offered.shapes;
        let unread = found.names(offered.unread.iter());
        let mut fit = Self {
            model: found.model,
            prefix: found.prefix.clone(),
            fitting: (0, 0),
            missing: Vec::new(),
            unread: Vec::new(),
            elsewhere: None,
            unlike: Vec::new(),
            unneeded: Vec::new(),
            left_over: Vec::new(),
            wrong: Vec::new(),
            unsound: Vec::new(),
        };
        let mut own = BTreeSet::new();
        for (name, wanted) in network.shapes() {
            own.insert(name);
            match names.get(name).and_then(|name| shapes.get(name)) {
                None if unread.contains_key(name) => fit.unread.push(name.into()),
                None => fit.missing.push((name.into(), wanted.to_vec())),
                Some(shape) if shape != wanted => fit.unlike.push((name.into(), shape.clone(), wanted.to_vec())),
                Some(_) => {
                    fit.fitting.0 += 1;
                    let numbers = wanted.iter().try_fold(1i64, |all, n| all.checked_mul(*n));
                    fit.fitting.1 += numbers.and_then(|n| usize::try_from(n).ok()).unwrap_or(0);
                }
            }
        }
        fit.elsewhere = elsewhere(&fit.missing, shapes);
        let known: BTreeMap<String, KnownAs> = names::known(found.model, names).into_iter().collect();
        for (own_name, name) in names.iter().filter(|(n, _)| !own.contains(n.as_str())) {
            match known.get(own_name) {
                // Told where the auto-encoder is.
                Some(KnownAs::Unused) => {}
                Some(KnownAs::Tied) => fit.unneeded.push((own_name.clone(), "the same as the embedding")),
                Some(KnownAs::Derived) => fit.unneeded.push((own_name.clone(), "made from the settings")),
                None => fit.left_over.push((own_name.clone(), shapes.get(name).cloned().unwrap_or_default())),
            }
        }
        fit
    }

    /// Tells that a tensor is not what the network takes it for.
    pub(super) fn differs(&mut self, name: &str, from: &str) {
        self.wrong.push(format!("`{name}` is not `{from}`, as this network has it"));
    }

    /// Tells that a tensor's numbers are no weights.
    pub(super) fn unsound(&mut self, name: &str, fault: &str) {
        self.unsound.push(format!("`{name}` {fault}"));
    }

    /// Whether every parameter is there as it should be.
    pub fn is_whole(&self) -> bool {
        self.missing.is_empty()
            && self.unread.is_empty()
            && self.unlike.is_empty()
            && self.wrong.is_empty()
            && self.unsound.is_empty()
    }

    /// A line for each thing that there is to say; at most `most` of each kind.
    pub fn lines(&self, most: usize) -> Vec<String> {
        let (count, numbers) = self.fitting;
        let before = if self.prefix.is_empty() { String::new() } else { format!(" (names after `{}`)", self.prefix) };
        let title = self.model.title();
        let fit = if count == 1 { "tensor fits" } else { "tensors fit" };
        let mut out = vec![format!("{title}{before}: {count} {fit}, {:.2} M numbers", numbers as f64 / 1e6)];
        let shape = |s: &[i64]| format!("{s:?}");
        let missing = self.missing.iter().map(|(n, s)| format!("`{n}` {}", shape(s)));
        let unlike = self.unlike.iter().map(|(n, f, w)| format!("`{n}` is {}, expected {}", shape(f), shape(w)));
        let unneeded = self.unneeded.iter().map(|(n, why)| format!("`{n}`: {why}"));
        let left_over = self.left_over.iter().map(|(n, s)| format!("`{n}` {}", shape(s)));
        list(&mut out, "missing", missing.collect(), most);
        if let Some((prefix, count)) = &self.elsewhere {
            out.push(format!("    {count} of them stand after `{prefix}`: save the file with one prefix for all"));
        }
        let unread = self.unread.iter().map(|n| format!("`{n}`")).collect();
        list(
            &mut out,
            "of a type that is not read (float8, complex, quantized, sparse, or on no device)",
            unread,
            most,
        );
        list(&mut out, "of another shape", unlike.collect(), most);
        list(&mut out, "other than they should be", self.wrong.clone(), most);
        list(&mut out, "no weights", self.unsound.clone(), most);
        list(&mut out, "left over, without a place", left_over.collect(), most);
        list(&mut out, "not needed", unneeded.collect(), most);
        out
    }
}

/// What stands before most of the names that are missing, where they stand behind something else.
fn elsewhere(missing: &[(String, Vec<i64>)], shapes: &BTreeMap<String, Vec<i64>>) -> Option<(String, usize)> {
    let wanted: BTreeSet<&str> = missing.iter().map(|(name, _)| name.as_str()).collect();
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for name in shapes.keys().map(|name| names::plain(name)) {
        let cuts = name.match_indices('.').map(|(at, _)| at + 1);
        for cut in std::iter::once(0).chain(cuts).filter(|cut| wanted.contains(&name[*cut..])) {
            *counts.entry(name[..cut].to_owned()).or_default() += 1;
        }
    }
    // Short names such as `weight` end many others.
    counts
        .into_iter()
        .max_by_key(|(_, count)| *count)
        .filter(|(prefix, count)| !prefix.is_empty() && 2 * count > wanted.len())
}

fn list(out: &mut Vec<String>, title: &str, all: Vec<String>, most: usize) {
    if all.is_empty() {
        return;
    }
    out.push(format!("  {title}: {}", all.len()));
    let more = all.len().saturating_sub(most);
    out.extend(all.into_iter().take(most).map(|line| format!("    {line}")));
    if more > 0 {
        out.push(format!("    and {more} more (--all lists them)"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_stands_after_another_prefix_is_told_and_chance_is_not() {
        let missing: Vec<_> = ["a.weight", "b.0.weight", "b.0.bias"].map(|n| (n.to_string(), vec![1])).into();
        let there = |names: &[&str]| {
            let shapes = names.iter().map(|n| ((*n).to_string(), vec![1])).collect();
            elsewhere(&missing, &shapes)
        };
        assert_eq!(there(&["model.b.0.bias", "net.a.weight", "module.net.b.0.weight"]), Some(("net.".into(), 2)));
        assert_eq!(there(&["model.b.0.bias", "net.a.weight", "c.weight"]), None);
        assert_eq!(there(&[]), None);
    }
}
