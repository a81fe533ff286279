//! The numbers of a curation.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use crate::Category;
use crate::config::{CurateConfig, SplitBy};
use crate::judge::{CATEGORY, DECISION, Judgement};
use crate::label::Labels;
use crate::record::{READ, Record};
use crate::stages::StageName;

/// From files to a corpus, in numbers. As JSON it stands beside the corpus.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Funnel {
    /// `riglab-curation`.
    pub format: String,
    /// Assets looked at, those that cannot be read included.
    pub assets: usize,
    /// Assets kept.
    pub kept: usize,
    /// The stages in order, with what each dropped.
    pub stages: Vec<StageCount>,
    /// Names of duplicates, a group each, the one that is kept first.
    pub duplicates: Vec<Vec<String>>,
    /// Kept assets by category (UniRig's Figure 3).
    pub categories: BTreeMap<String, usize>,
    /// Kept assets by what names their category.
    pub labelled_by: BTreeMap<String, usize>,
    /// Kept assets by number of bones, in steps of [`BONES_STEP`] (UniRig's Figure 4); the last is open.
    pub bones: Vec<usize>,
    /// Statistics of the kept assets by category, and of all (SkinTokens' Table 1).
    pub statistics: Vec<Row>,
    /// Assets that were repaired here.
    pub repaired: usize,
    /// Kept assets by split.
    pub splits: BTreeMap<String, usize>,
    /// How these were made; `list` where any are those of a list, which stay where parts are merged.
    #[serde(default)]
    pub split_by: SplitBy,
    /// What the rules say against what sources state, of all that could be read and state one of the eight.
    pub agreement: Agreement,
    /// Decisions that were applied.
    pub decisions: usize,
    /// Sentences: decisions that are about none of the assets, what looks mistaken in the manifest and the splits, a model
    /// that gave no answers.
    pub warnings: Vec<String>,
    /// How a vision-language model did, if it was asked.
    pub vlm: Option<crate::vlm::VlmReport>,
}

/// Bones of a bar.
pub const BONES_STEP: usize = 10;
/// Bars; the last holds all beyond.
const BONES_BARS: usize = 27;

/// What a stage did.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StageCount {
    /// Its name.
    pub stage: String,
    /// Assets that came to it.
    pub came: usize,
    /// Assets that it dropped: name, and why.
    pub dropped: Vec<(String, String)>,
}

/// Means over assets.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Row {
    /// A category, or `all`.
    pub of: String,
    /// How many assets.
    pub assets: usize,
    /// How many trees of joints.
    pub topologies: usize,
    /// Mean number of vertices.
    pub vertices: f64,
    /// Mean number of triangles.
    pub triangles: f64,
    /// Mean number of joints, and the least and the most.
    pub joints: f64,
    /// The least joints.
    pub joints_min: usize,
    /// The most joints.
    pub joints_max: usize,
    /// Mean over assets of the share of non-zero entries in the vertex × joint matrix, in percent.
    pub sparsity_percent: f64,
}

/// Rules against what sources state.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Agreement {
    /// Assets whose source states one of the eight.
    pub of: usize,
    /// Those for which rules say the same.
    pub same: usize,
    /// Counts by stated category, then by the rules'.
    pub confusion: BTreeMap<Category, BTreeMap<Category, usize>>,
}

impl Funnel {
    /// Counts.
    pub fn of(
        records: &[Record],
        judged: &Judgement,
        labels: Labels,
        splits: &[String],
        config: &CurateConfig,
    ) -> Self {
        // Parts that are merged may have passed stages that are not of the config.
        let own = |stage: &StageName| config.stages.contains(stage);
        let dropped_by = |stage: &StageName| judged.dropped.iter().flatten().any(|(by, _)| by == stage.name());
        let others = StageName::ALL.into_iter().filter(|stage| !own(stage) && dropped_by(stage));
        let names = [READ, DECISION]
            .into_iter()
            .chain(config.stages.iter().filter(|s| **s != StageName::Duplicates).map(|s| s.name()))
            .chain(others.map(StageName::name))
            .chain(config.stages.iter().filter(|s| **s == StageName::Duplicates).map(|s| s.name()))
            .chain((!config.categories.keep.is_empty()).then_some(CATEGORY));
        let mut came = records.len();
        let stages = names
            .map(|stage| {
                let of = |i: usize| judged.dropped[i].as_ref().filter(|(s, _)| s == stage);
                let dropped: Vec<(String, String)> =
                    (0..records.len()).filter_map(|i| Some((records[i].name.clone(), of(i)?.1.clone()))).collect();
                let count = StageCount { stage: stage.into(), came, dropped };
                came -= count.dropped.len();
                count
            })
            .collect();
        let kept: Vec<usize> = judged.kept().collect();
        let mut categories = BTreeMap::from(Category::ALL.map(|c| (c.name().to_owned(), 0)));
        let (mut labelled_by, mut split_counts) = (BTreeMap::new(), BTreeMap::new());
        let mut bones = vec![0; BONES_BARS];
        for &i in &kept {
            if let Some(label) = judged.labels.get(&records[i].name) {
                *categories.entry(label.category.name().to_owned()).or_default() += 1;
                *labelled_by.entry(label.by.name().to_owned()).or_default() += 1;
            }
            if let Some(facts) = &records[i].facts {
                bones[(facts.joints / BONES_STEP).min(BONES_BARS - 1)] += 1;
            }
        }
        splits.iter().for_each(|s| *split_counts.entry(s.clone()).or_default() += 1);
        let duplicates =
            judged.duplicates.iter().map(|g| g.iter().map(|&i| records[i].name.clone()).collect()).collect();
        Self {
            format: "riglab-curation".into(),
            assets: records.len(),
            kept: kept.len(),
            stages,
            duplicates,
            categories,
            labelled_by,
            bones,
            statistics: statistics(records, judged, &kept),
            repaired: records.iter().filter(|r| r.facts.as_ref().is_some_and(|f| f.repairs > 0)).count(),
            splits: split_counts,
            split_by: config.split.by,
            agreement: agreement(records),
            decisions: judged.decisions.len(),
            warnings: judged.told.iter().cloned().chain(labels.fault).collect(),
            vlm: labels.vlm,
        }
    }

    /// The stage of a name.
    pub fn stage(&self, name: &str) -> Option<&StageCount> {
        self.stages.iter().find(|s| s.stage == name)
    }
}

fn statistics(records: &[Record], judged: &Judgement, kept: &[usize]) -> Vec<Row> {
    let label = |i: usize| judged.labels.get(&records[i].name).map(|l| l.category);
    let row = |name: &str, of: Option<Category>| {
        let facts: Vec<_> = kept
            .iter()
            .filter(|&&i| of.is_none() || label(i) == of)
            .filter_map(|&i| records[i].facts.as_ref())
            .collect();
        let n = facts.len().max(1) as f64;
        let mean = |value: &dyn Fn(&crate::record::Facts) -> f64| facts.iter().map(|f| value(f)).sum::<f64>() / n;
        let topologies: std::collections::BTreeSet<u64> = facts.iter().map(|f| f.topology).collect();
        Row {
            of: name.into(),
            assets: facts.len(),
            topologies: topologies.len(),
            vertices: mean(&|f| f.vertices as f64),
            triangles: mean(&|f| f.triangles as f64),
            joints: mean(&|f| f.joints as f64),
            joints_min: facts.iter().map(|f| f.joints).min().unwrap_or(0),
            joints_max: facts.iter().map(|f| f.joints).max().unwrap_or(0),
            sparsity_percent: mean(&|f| 100.0 * f.weights as f64 / (f.vertices * f.joints).max(1) as f64),
        }
    };
    let by_category = Category::ALL.iter().map(|c| row(c.name(), Some(*c))).filter(|r| r.assets > 0);
    by_category.chain([row("all", None)]).collect()
}

fn agreement(records: &[Record]) -> Agreement {
    let mut agreement = Agreement::default();
    for facts in records.iter().filter_map(|r| r.facts.as_ref()) {
        let Ok(stated) = facts.stated.parse::<Category>() else { continue };
        agreement.of += 1;
        agreement.same += usize::from(stated == facts.rules);
        *agreement.confusion.entry(stated).or_default().entry(facts.rules).or_default() += 1;
    }
    agreement
}
