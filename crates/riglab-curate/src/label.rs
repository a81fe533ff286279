//! The category of each asset that is kept: a person's, else the source's, else a model's or the rules'.

use std::path::Path;

use riglab_core::{Asset, Rig};
use serde::{Deserialize, Serialize};

use crate::config::{CurateConfig, Labeller};
use crate::decisions::Verdict;
use crate::judge::{By, CATEGORY, Judgement, Label};
use crate::record::Record;
use crate::vlm::{Asker, VlmReport};
use crate::{Category, CurateError};

/// How labels were found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Labels {
    /// How the model did, if it was asked.
    pub vlm: Option<VlmReport>,
    /// A sentence, if it gave no answers.
    pub fault: Option<String>,
}

/// Labels what is kept, and drops categories that are not wanted, but for what a person accepted. `read` gives the assets of records again,
/// a chunk at a time.
pub fn label(
    records: &[Record],
    judged: &mut Judgement,
    config: &CurateConfig,
    work: &Path,
    read: impl Fn(&[&Record], &mut dyn FnMut(Vec<Asset>) -> Result<(), CurateError>) -> Result<(), CurateError>,
) -> Result<Labels, CurateError> {
    let mut labels = Labels::default();
    let kept: Vec<usize> = judged.kept().collect();
    let mut open = Vec::new();
    for &i in &kept {
        let Some(facts) = &records[i].facts else { continue };
        let decision = judged.decisions.get(&i).map(|(d, _)| d);
        let remark = decision.map_or(String::new(), |d| {
            [d.faults.join(", "), d.comment.clone()]
                .into_iter()
                .filter(|t| !t.is_empty())
                .collect::<Vec<_>>()
                .join("; ")
        });
        let stated = facts.stated.parse::<Category>().ok().filter(|_| config.categories.trust_source);
        let (category, by) = match (decision.and_then(|d| d.category), stated) {
            (Some(decided), _) => (decided, By::Decision),
            (None, Some(stated)) => (stated, By::Source),
            (None, None) => {
                if config.categories.by == Labeller::Vlm {
                    open.push(&records[i]);
                }
                (facts.rules, By::Rules)
            }
        };
        let because = if by == By::Rules { facts.because.clone() } else { String::new() };
        judged.labels.insert(records[i].name.clone(), Label { category, by, because, remark });
    }
    if !open.is_empty() {
        let asker = Asker::new(&config.categories.vlm, &work.join("answers"))?;
        read(&open, &mut |assets| {
            let rigs: Vec<&Rig> = assets.iter().map(|a| &a.rig).collect();
            for (asset, answer) in assets.iter().zip(asker.ask(&rigs)?) {
                let Some(label) = judged.labels.get_mut(&asset.name) else { continue };
                match answer {
                    Ok(category) => {
                        label.category = category;
                        label.by = By::Vlm;
                        label.because = String::new();
                    }
                    Err(why) => {
                        label.by = By::RulesInstead;
                        label.because = format!("{}; {why}", label.because);
                    }
                }
            }
            Ok(())
        })?;
        labels.vlm = Some(asker.report());
        let without =
            open.iter().filter(|r| judged.labels.get(&r.name).is_some_and(|l| l.by == By::RulesInstead)).count();
        if without > 0 {
            let (of, model) = (open.len(), &config.categories.vlm.model);
            let failed = asker.report().failed;
            let (requests, first) = (if failed == 1 { "request" } else { "requests" }, asker.first_fault());
            let first = first.map_or(String::new(), |why| format!(", the first: {why}"));
            labels.fault = Some(format!(
                "the model `{model}` named no category for {without} of {of} assets, which keep that of the rules \
                 ({failed} {requests} failed{first})"
            ));
        }
    }
    if !config.categories.keep.is_empty() {
        let accepted = |i: &usize| judged.decisions.get(i).is_some_and(|(d, _)| d.verdict == Verdict::Accept);
        let others: Vec<usize> = kept.into_iter().filter(|i| !accepted(i)).collect();
        for i in others {
            let category = judged.labels.get(&records[i].name).map(|l| l.category);
            if let Some(category) = category.filter(|c| !config.categories.keep.contains(c)) {
                judged.dropped[i] = Some((CATEGORY.into(), format!("its category is {category}, which is not kept")));
            }
        }
    }
    Ok(labels)
}
