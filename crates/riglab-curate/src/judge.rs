//! What stays: the stages' word on each asset, a person's decisions, and duplicates among the rest.

use std::collections::HashMap;

use riglab_core::Asset;
use serde_json::json;

use crate::Category;
use crate::config::{CurateConfig, Labeller};
use crate::decisions::{Decision, Decisions, Match, Verdict, item};
use crate::duplicates::groups;
use crate::record::{READ, Record};
use crate::shape::Shape;
use crate::stages::StageName;

/// The stage of what a person rejected.
pub const DECISION: &str = "decision";
/// The stage of categories that are not wanted.
pub const CATEGORY: &str = "category";

/// Where a category comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum By {
    /// A person decided.
    Decision,
    /// The source states it.
    Source,
    /// A vision-language model.
    Vlm,
    /// Rules.
    Rules,
    /// Rules, as a model was to be asked and gave no answer.
    RulesInstead,
}

impl By {
    /// In words.
    pub fn name(self) -> &'static str {
        match self {
            Self::Decision => "decision",
            Self::Source => "source",
            Self::Vlm => "vlm",
            Self::Rules => "rules",
            Self::RulesInstead => "rules (no answer)",
        }
    }
}

/// What became of each record, by its number.
pub struct Judgement {
    /// The stage that dropped it and why; `None` for what is kept.
    pub dropped: Vec<Option<(String, String)>>,
    /// Decisions about it.
    pub decisions: HashMap<usize, (Decision, Match)>,
    /// Sentences on decisions that are about none.
    pub told: Vec<String>,
    /// Groups of duplicates, the one that is kept first.
    pub duplicates: Vec<Vec<usize>>,
    /// Its category, once it has one; by name, for assets that are read again.
    pub labels: HashMap<String, Label>,
}

/// A category and what says so.
#[derive(Clone, Debug, PartialEq)]
pub struct Label {
    /// The category.
    pub category: Category,
    /// What says so.
    pub by: By,
    /// Why, where rules say so; or why there is no answer.
    pub because: String,
    /// The person's comment and marks, if there are any.
    pub remark: String,
}

/// Judges records, which are in order of their names. They may be of a part of all files: see [`Decisions::applied`].
pub(crate) fn judge(
    records: &[Record],
    decisions: &Decisions,
    config: &CurateConfig,
    is_of_it: impl Fn(&str) -> bool,
    is_there: impl Fn(&str) -> bool,
) -> Judgement {
    let keys: Vec<(&str, &str)> = records.iter().map(|r| (r.name.as_str(), r.digest())).collect();
    let (found, mut told) = decisions.applied(&keys, is_of_it, is_there);
    let decided = |i: usize| found.get(&i).map_or(Verdict::Open, |(d, _)| d.verdict);
    let mut dropped: Vec<Option<(String, String)>> = records.iter().map(|r| r.dropped.clone()).collect();
    for (i, drop) in dropped.iter_mut().enumerate() {
        match (decided(i), &drop) {
            // Nobody can accept what cannot be read.
            (_, Some((stage, _))) if stage == READ => {}
            (Verdict::Accept, _) => *drop = None,
            (Verdict::Reject, _) => {
                let decision = &found[&i].0;
                let why = [decision.faults.join(", "), decision.comment.clone()].join(" ");
                let why = why.trim();
                let why =
                    if why.is_empty() { "a person rejected it".into() } else { format!("a person rejected it: {why}") };
                *drop = Some((DECISION.into(), why));
            }
            (Verdict::Open, _) => {}
        }
    }
    // By what is known before a model is asked.
    let unwanted = |i: usize| {
        let stated = records[i].facts.as_ref().and_then(|f| f.stated.parse().ok());
        let stated = stated.filter(|_| config.categories.trust_source);
        let rules = records[i].facts.as_ref().map(|f| f.rules).filter(|_| config.categories.by == Labeller::Rules);
        let category = found.get(&i).and_then(|(d, _)| d.category).or(stated).or(rules);
        !config.categories.keep.is_empty() && category.is_some_and(|c: Category| !config.categories.keep.contains(&c))
    };
    let mut duplicates = Vec::new();
    if config.stages.contains(&StageName::Duplicates) {
        let left: Vec<usize> = (0..records.len()).filter(|&i| dropped[i].is_none()).collect();
        let shapes: Vec<Shape> = left.iter().filter_map(|&i| Some(records[i].facts.as_ref()?.shape.clone())).collect();
        for group in groups(&shapes, config.duplicates.tolerance) {
            let mut group: Vec<usize> = group.into_iter().map(|k| left[k]).collect();
            // Which of them stays: one that a person accepted, else one of no category that is not wanted, else the one with
            // least to be said of it, else the first by name.
            group.sort_by_key(|&i| (decided(i) != Verdict::Accept, unwanted(i), records[i].notes.len(), i));
            for &other in group[1..].iter().filter(|&&i| decided(i) != Verdict::Accept) {
                let why = format!("it has the shape and the skeleton of `{}`", records[group[0]].name);
                dropped[other] = Some((StageName::Duplicates.name().into(), why));
            }
            duplicates.push(group);
        }
    }
    // Without the one that was rejected its copies are no duplicates any more. Whether it was for what it shows, or for being
    // one of them, a person knows.
    let rejected = (0..records.len()).filter(|&i| decided(i) == Verdict::Reject && !records[i].digest().is_empty());
    let rejected: HashMap<(&str, &str), &str> = rejected.map(|i| ((item(keys[i].0), keys[i].1), keys[i].0)).collect();
    for i in (0..records.len()).filter(|&i| dropped[i].is_none() && decided(i) == Verdict::Open) {
        if let Some(other) = rejected.get(&(item(keys[i].0), keys[i].1)) {
            told.push(format!(
                "`{}` is kept, and is byte for byte `{other}`, which a person rejected: decide about it, too",
                keys[i].0
            ));
        }
    }
    let decisions = found.into_iter().map(|(i, (d, how))| (i, (d.clone(), how))).collect();
    Judgement { dropped, decisions, told, duplicates, labels: HashMap::new() }
}

impl Judgement {
    /// The numbers of what is kept.
    pub fn kept(&self) -> impl Iterator<Item = usize> + '_ {
        (0..self.dropped.len()).filter(|&i| self.dropped[i].is_none())
    }

    /// Writes an asset's category and where it comes from into its provenance.
    pub fn describe(&self, asset: &mut Asset) {
        let Some(label) = self.labels.get(&asset.name) else { return };
        let from = &mut asset.provenance;
        from.category = label.category.name().into();
        // Of a shard's corpus it is said already.
        from.notes.retain(|n| !n.starts_with("category by ") && !n.starts_with("a person remarked: "));
        from.notes.push(match label.because.as_str() {
            "" => format!("category by {}", label.by.name()),
            because => format!("category by {}: {because}", label.by.name()),
        });
        if !label.remark.is_empty() {
            from.notes.push(format!("a person remarked: {}", label.remark));
        }
    }

    /// A line of JSON for each asset, in order of their names.
    pub fn lines(&self, records: &[Record], splits: &[String]) -> String {
        let mut splits = splits.iter();
        let mut text = String::new();
        for (i, record) in records.iter().enumerate() {
            let label = self.labels.get(&record.name);
            let facts = record.facts.as_ref();
            let (stage, reason) = self.dropped[i].clone().map_or((None, None), |(s, r)| (Some(s), Some(r)));
            let split = if stage.is_none() { splits.next() } else { None };
            let line = json!({
                "name": record.name, "digest": record.digest(), "file": record.file,
                "kept": stage.is_none(), "stage": stage, "reason": reason, "split": split,
                "category": label.map(|l| l.category.name()), "by": label.map(|l| l.by.name()),
                "because": label.map(|l| &l.because), "stated": facts.map(|f| &f.stated),
                "rules": facts.map(|f| f.rules.name()),
                "joints": facts.map(|f| f.joints), "vertices": facts.map(|f| f.vertices),
                "triangles": facts.map(|f| f.triangles), "notes": record.notes,
                "verdict": self.decisions.get(&i).map(|(d, _)| d.verdict.to_string()),
            });
            text += &line.to_string();
            text.push('\n');
        }
        text
    }
}
