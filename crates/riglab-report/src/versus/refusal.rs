//! What is not of the same assets is not compared.

use std::collections::BTreeSet;

use thiserror::Error;

use super::{Compared, find};
use crate::Findings;

/// Why runs are not compared.
#[derive(Debug, Error, PartialEq, Eq)]
pub enum Refusal {
    /// They saw other corpora.
    #[error(
        "{first} and {other} cannot be compared: they were evaluated on different corpora ({difference}); evaluate both \
         on the same ones, for instance with `riglab eval RUN --set data.corpora='[\"FILE\"]'`"
    )]
    Corpora {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// What one has and the other has not.
        difference: String,
    },
    /// They were evaluated on other splits.
    #[error(
        "{first} and {other} cannot be compared: {first} was evaluated on the splits {own}, {other} on {theirs}; \
         evaluate both on the same, for instance with `riglab eval RUN --set data.test='[\"test_new\"]'`"
    )]
    Splits {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// The first's splits.
        own: String,
        /// The other's.
        theirs: String,
    },
    /// A split has other assets in one than in the other.
    #[error(
        "{first} and {other} cannot be compared: their assets of `{split}` differ ({difference}); evaluate both anew \
         with `riglab eval`"
    )]
    Assets {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// The split.
        split: String,
        /// What one has and the other has not.
        difference: String,
    },
    /// One's config makes no sense: whether settings differ is not known.
    #[error(
        "the settings of {run} cannot be read, so they cannot be compared; put back its config.toml as it was written \
         when the run was made: {fault}"
    )]
    Config {
        /// The run.
        run: String,
        /// Where, and what is wrong.
        fault: String,
    },
    /// Nothing is measured by both.
    #[error(
        "{first} and {other} cannot be compared: {first} measures {own}, {other} {theirs}; `riglab compare` measures the \
         rigs of both by the same metrics"
    )]
    Nothing {
        /// A run.
        first: String,
        /// Another.
        other: String,
        /// What the first measures.
        own: String,
        /// What the other measures.
        theirs: String,
    },
}

/// Whether two runs are of the same corpora, splits and assets.
pub(super) fn same(first: &Compared, other: &Compared) -> Result<(), Refusal> {
    let (a, b) = (first.name.clone(), other.name.clone());
    let sums = |run: &Compared| run.corpora.iter().map(|(_, sum)| sum.clone()).collect::<BTreeSet<_>>();
    let shared: Vec<(&Findings, &Findings)> =
        first.findings.iter().filter_map(|f| Some((f, find(other, &f.about)?))).collect();
    if shared.is_empty() {
        let measured = |run: &Compared| run.findings.iter().map(|f| f.about.clone()).collect::<Vec<_>>().join(" and ");
        return Err(Refusal::Nothing { own: measured(first), theirs: measured(other), first: a, other: b });
    }
    if sums(first) != sums(other) {
        let difference = corpora(first, other);
        return Err(Refusal::Corpora { first: a, other: b, difference });
    }
    for (f, g) in shared {
        let set = |f: &Findings| f.splits().into_iter().map(String::from).collect::<BTreeSet<_>>();
        let (own, theirs) = (set(f), set(g));
        if own != theirs {
            let list = |s: BTreeSet<String>| s.into_iter().collect::<Vec<_>>().join(", ");
            return Err(Refusal::Splits { first: a, other: b, own: list(own), theirs: list(theirs) });
        }
        for split in f.splits() {
            let names = |f: &Findings| -> Vec<String> {
                let mut names: Vec<String> =
                    f.singles.iter().filter(|s| s.split == split).map(|s| s.name.clone()).collect();
                names.sort();
                names
            };
            let (own, theirs) = (names(f), names(g));
            if own != theirs {
                let difference = apart(&first.name, &own, &other.name, &theirs);
                return Err(Refusal::Assets { first: a, other: b, split: split.into(), difference });
            }
        }
    }
    Ok(())
}

/// The corpora that only one of two runs has.
fn corpora(first: &Compared, other: &Compared) -> String {
    let only = |run: &Compared, without: &Compared| -> Vec<String> {
        let missing = run.corpora.iter().filter(|(_, sum)| !without.corpora.iter().any(|(_, s)| s == sum));
        missing.map(|(path, sum)| format!("{path} ({})", sum.chars().take(12).collect::<String>())).collect()
    };
    let said = |run: &Compared, only: Vec<String>| match only.is_empty() {
        true => None,
        false => Some(format!("only {} has {}", run.name, only.join(", "))),
    };
    let both = [said(first, only(first, other)), said(other, only(other, first))];
    both.into_iter().flatten().collect::<Vec<_>>().join("; ")
}

/// What two sorted lists do not share: counts, and a few names.
fn apart(first: &str, own: &[String], other: &str, theirs: &[String]) -> String {
    let only =
        |a: &[String], b: &[String]| a.iter().filter(|n| b.binary_search(n).is_err()).cloned().collect::<Vec<_>>();
    let said = |name: &str, only: Vec<String>| {
        let more = if only.len() > 3 { format!(" and {} more", only.len() - 3) } else { String::new() };
        let few: Vec<_> = only.iter().take(3).cloned().collect();
        (!only.is_empty()).then(|| format!("only {name} has {}{more}", few.join(", ")))
    };
    let mut out = vec![format!("{} and {} assets", own.len(), theirs.len())];
    out.extend(said(first, only(own, theirs)));
    out.extend(said(other, only(theirs, own)));
    out.join("; ")
}
