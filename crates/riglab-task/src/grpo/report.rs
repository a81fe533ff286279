//! An evaluation as a file, as lines, and as a part of a report.

use riglab_metric::statistics::Paired;
use riglab_metric::{SkeletonDistances, nan_for_null};
use riglab_report::{Block, Cell, Columns, Findings, Metric, Single, Table, Total};
use riglab_reward::{Part, RewardWeights, Rewards};
use riglab_train::State;
use serde::{Deserialize, Serialize};

use crate::experiment::{pictures, views};
use crate::unirig_skeleton::Row as SkeletonRow;
use crate::unirig_skeleton::report::{SKELETONS_OF_SKINTOKENS, SKELETONS_OF_UNIRIG, skeleton_columns, too_many};

/// Means of a model on a split.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Row {
    /// Of the rewards; a rig that cannot be decoded counts as 0.
    pub rewards: Rewards,
    /// Of the skeletons; `method` is `before` or `after`, with how rigs were made where that is not as in training.
    pub skeletons: SkeletonRow,
}

/// What an evaluation found.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Report {
    /// Which formulas, of the distances.
    pub convention: String,
    /// Of coverage, containment, skinning and motion, in the reward; nothing where an earlier version wrote it.
    #[serde(default)]
    pub reward_weights: Option<RewardWeights>,
    /// Whether the model draws skeletons alone: there are no skin weights that rewards could judge.
    #[serde(default)]
    pub without_weights: bool,
    /// Before and after, of each split and way to make rigs.
    pub rows: Vec<Row>,
    /// What became of each such pair.
    #[serde(default)]
    pub gains: Vec<Gain>,
    /// Assets, by the last of these ways.
    #[serde(default)]
    pub assets: Vec<AssetRow>,
}

/// After minus before, mesh by mesh.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Gain {
    /// The split.
    pub split: String,
    /// Of the reward: above 0 is better.
    pub reward: Paired,
    /// Of J2J: below 0 is better.
    pub j2j: Paired,
}

/// What a model made of one asset.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AssetScore {
    /// The reward; 0 for a rig that cannot be decoded.
    pub reward: f64,
    /// What the reward is made of; nothing where an earlier version wrote it.
    #[serde(default)]
    pub rewards: Option<Rewards>,
    /// The distances.
    pub distances: SkeletonDistances,
}

/// One asset, before and after.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct AssetRow {
    /// The split.
    pub split: String,
    /// The asset's name.
    pub name: String,
    /// Its category; empty where it has none.
    pub category: String,
    /// By the model that the run started from.
    pub before: AssetScore,
    /// By this checkpoint.
    pub after: AssetScore,
}

/// A sheet of pictures of an asset.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct ShownAsset {
    /// File name in the run's folder `eval`.
    pub file: String,
    /// The split.
    pub split: String,
    /// The asset.
    pub name: String,
    /// Its place between the most gained and the most lost: best, median or worst.
    pub why: String,
    /// What the reward gained.
    #[serde(deserialize_with = "nan_for_null")]
    pub gain: f64,
    /// What J2J gained: above 0 it is worse.
    #[serde(deserialize_with = "nan_for_null")]
    pub j2j: f64,
}

/// What `riglab eval` writes.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Evaluation {
    /// The checkpoint that was evaluated.
    pub checkpoint: State,
    /// The numbers.
    pub report: Report,
    /// The pictures, in the folder beside the file.
    pub gallery: Vec<ShownAsset>,
    /// What `riglab eval` says where it was given another start than the run's.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_models: Vec<String>,
}

/// The table of all splits.
pub fn lines(report: &Report) -> Vec<String> {
    // As wide as their heads, and as four digits are.
    let rewards = |of: &dyn Fn(usize) -> String| -> String {
        let wide = |(k, part): (usize, &riglab_reward::Part)| format!(" {:>1$}", of(k), part.name.len().max(7));
        Rewards::PARTS.iter().enumerate().map(wide).collect()
    };
    let names = rewards(&|k| Rewards::PARTS[k].name.into());
    let mut out = vec![format!(
        "{:12} {:15} {:>6} {:>7}{names} {:>7} {:>8} {:>7} {:>7} {:>7} {:>7} {:>7}",
        "split", "model", "rigs", "reward", "valid %", "compared", "J2J", "J2B", "B2B", "joints", "true"
    )];
    for Row { rewards: r, skeletons: s } in &report.rows {
        out.push(format!(
            "{:12} {:15} {:>6} {:>7.4}{} {:>7.1} {:>8} {:>7.3} {:>7.3} {:>7.3} {:>7.1} {:>7.1}",
            s.split,
            s.method,
            s.assets,
            r.total,
            rewards(&|k| Cell::number(report.parts(*r)[k], 4).text),
            100.0 * s.valid,
            s.compared,
            100.0 * s.j2j,
            100.0 * s.j2b,
            100.0 * s.b2b,
            s.joints,
            s.true_joints
        ));
    }
    let [names, symbols] = [|p: &riglab_reward::Part| p.name, |p: &riglab_reward::Part| p.symbol]
        .map(|of| Rewards::PARTS.iter().map(of).collect::<Vec<_>>().join(", "));
    out.push(format!("{names}: {symbols}"));
    out.push(format!(
        "distances × 100, convention {}, means over the rigs that can be compared (those with a bone)",
        report.convention
    ));
    out.extend(report.gains.iter().zip(report.rows.chunks_exact(2)).map(|(gain, pair)| verdict(gain, pair)));
    out
}

impl Report {
    /// Parts of a reward, in the order of [`Rewards::PARTS`]; NaN of those that nothing was there to judge by.
    fn parts(&self, rewards: Rewards) -> Vec<f64> {
        let judged = |part: &Part| !(self.without_weights && part.of_weights);
        Rewards::PARTS.iter().zip(rewards.parts()).map(|(part, r)| if judged(part) { r } else { f64::NAN }).collect()
    }
}

impl Evaluation {
    /// Its part of a report; `picture` finds the bytes of a file of the gallery.
    pub fn blocks(&self, picture: impl Fn(&str) -> Option<Vec<u8>>) -> Vec<Block> {
        let mut blocks = vec![Block::Heading("Before and after".into())];
        let pairs = self.report.gains.iter().zip(self.report.rows.chunks_exact(2));
        blocks.extend(pairs.map(|(gain, pair)| Block::Text(verdict(gain, pair))));
        blocks.push(Block::Table(self.table()));
        if let Some(last) = self.report.rows.last() {
            let how = last.skeletons.method.strip_prefix("after").unwrap_or_default();
            blocks.push(Block::Text(format!(
                "Pictures, their rewards and the spread over assets are of rows \"before{how}\" and \"after{how}\"."
            )));
        }
        if !self.gallery.is_empty() {
            blocks.push(Block::Heading("Rigs before and after, from the largest gain to the largest loss".into()));
        }
        let caption = |shown: &ShownAsset| {
            format!(
                "{} ({}, {}): reward {}, J2J × 100 {}",
                shown.name,
                shown.split,
                shown.why,
                Cell::difference(shown.gain, 3).text,
                Cell::difference(100.0 * shown.j2j, 2).text
            )
        };
        blocks.push(pictures(self.gallery.iter().map(|s| (s.file.as_str(), caption(s))), &picture));
        blocks.extend(views(self.gallery.iter().map(|s| (s.file.as_str(), caption(s))), &picture));
        blocks
    }

    /// What it found, in the form in which runs are compared: of this checkpoint, with the start beside it.
    pub fn findings(&self) -> Vec<Findings> {
        let of = self.report.convention.as_str();
        let reward = || Metric::higher("reward", "riglab", 4).defined_by(&["reward"]);
        let totals_of = skeleton_columns(of, |r: &Row| [r.skeletons.j2j, r.skeletons.j2b, r.skeletons.b2b])
            .with(reward(), |r| r.rewards.total);
        let totals_of = with_parts(totals_of, self.report.without_weights, |r| Some(r.rewards))
            .with(Metric::higher("valid %", of, 1), |r| 100.0 * r.skeletons.valid);
        let after = |a: &AssetRow| [a.after.distances.j2j, a.after.distances.j2b, a.after.distances.b2b];
        let mut singles_of = skeleton_columns(of, after).with(reward(), |a| a.after.reward);
        if self.report.assets.iter().all(|a| a.after.rewards.is_some()) {
            singles_of = with_parts(singles_of, self.report.without_weights, |a| a.after.rewards);
        }
        let total = |r: &Row| {
            let s = &r.skeletons;
            Total {
                split: s.split.clone(),
                method: format!("{}, {} compared", s.method, s.compared),
                own: s.method.starts_with("after"),
                assets: s.assets,
                values: totals_of.values(r),
            }
        };
        let single = |a: &AssetRow| Single {
            split: a.split.clone(),
            name: a.name.clone(),
            category: a.category.clone(),
            values: singles_of.values(a),
        };
        vec![Findings {
            about: "Skeletons".into(),
            // Several of a mesh, where they are sampled as in training.
            over: Some("rigs"),
            totals_of: totals_of.metrics(),
            totals: self.report.rows.iter().map(total).collect(),
            singles_of: singles_of.metrics(),
            singles: self.report.assets.iter().map(single).collect(),
            published: vec![SKELETONS_OF_SKINTOKENS, SKELETONS_OF_UNIRIG],
        }]
    }

    fn table(&self) -> Table {
        let parts = Rewards::PARTS.iter().map(|part| format!("{} {}", part.name, part.symbol));
        let before = ["split", "model", "rigs", "reward"].map(String::from).into_iter();
        let after =
            ["valid %", "compared", "J2J × 100", "J2B × 100", "B2B × 100", "joints", "true joints"].map(String::from);
        let head: Vec<String> = before.chain(parts).chain(after).collect();
        let title = format!("Rewards, and distances × 100 (of the cube's edge; convention {})", self.report.convention);
        let mut table = Table { caption: title, head, ..Table::default() };
        for (k, Row { rewards: r, skeletons: s }) in self.report.rows.iter().enumerate() {
            if k > 0 && k % 2 == 0 {
                table.line();
            }
            let mut cells = vec![Cell::text(&s.split), Cell::text(&s.method), Cell::count(s.assets)];
            cells.extend(std::iter::once(r.total).chain(self.report.parts(*r)).map(|x| Cell::number(x, 4)));
            cells.extend([Cell::number(100.0 * s.valid, 1), Cell::count(s.compared)]);
            cells.extend([s.j2j, s.j2b, s.b2b].map(|x| Cell::number(100.0 * x, 3)));
            cells.extend([s.joints, s.true_joints].map(|x| Cell::number(x, 1)));
            table.row(cells);
        }
        let weights = match self.report.reward_weights {
            Some(weights) => {
                let named: Vec<_> = weights.named().map(|(name, weight)| format!("{name} {weight}")).collect();
                format!("reward.weights ({})", named.join(", "))
            }
            None => "reward.weights".into(),
        };
        let before = match self.other_models.is_empty() {
            true => "the model that the run started from",
            false => "another model than the run started from, which was named for this evaluation",
        };
        let asked = Rewards::PARTS.map(|part| format!("{} ({}), {}", part.name, part.symbol, part.asks)).join("; ");
        table.note = format!(
            "before: {before}; after: this checkpoint. Both rig the same meshes, with the same \
             points and random numbers: several rigs a mesh sampled as in training, or one (greedy: the likeliest token). \
             The reward is higher, the distances are lower for a better rig; a rig that cannot be decoded has reward 0. \
             Distances are means over the rigs that can be compared, those with a bone; the sentences above are over meshes \
             with such rigs before and after. The reward is the sum of these, each from 0 to 1, weighted by the run's \
             {weights}: {asked}.{}",
            if self.report.without_weights {
                " The model makes no skin weights that skinning and motion could judge."
            } else {
                ""
            }
        );
        table
    }
}

/// With a column for each part of the reward, which are comparable where its weights are not the same.
/// `without_weights`: as in [`Report`].
fn with_parts<R>(columns: Columns<R>, without_weights: bool, of: fn(&R) -> Option<Rewards>) -> Columns<R>
where
    R: 'static,
{
    let judged = |part: &Part| !(without_weights && part.of_weights);
    let with = |columns: Columns<R>, (k, part): (usize, &Part)| {
        let settings: Vec<String> = part.settings.iter().map(|key| format!("reward.{key}")).collect();
        let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
        let metric = Metric::higher(&format!("{} {}", part.name, part.symbol), "riglab", 4).defined_by(&settings);
        columns.with(metric, move |row| of(row).map_or(f64::NAN, |r| r.parts()[k]))
    };
    Rewards::PARTS.iter().enumerate().filter(|(_, part)| judged(part)).fold(columns, with)
}

fn verdict(gain: &Gain, pair: &[Row]) -> String {
    let [before, after] = pair else { return String::new() };
    let how = after.skeletons.method.strip_prefix("after").unwrap_or_default();
    // Without an interval, no more is said than what the figures are.
    let moved = |was: f64, is: f64| format!("{:.3}, {:.3} before", 100.0 * is, 100.0 * was);
    let (s, t) = (&before.skeletons, &after.skeletons);
    let reward = format!(
        "{}{how}: over {} the mean reward changed by {}",
        gain.split,
        if gain.reward.n == 1 { "1 mesh".into() } else { format!("{} meshes", gain.reward.n) },
        change(&gain.reward, 1.0)
    );
    // Meshes without a rig have nothing to be far from.
    if gain.j2j.n == 0 {
        return reward + ".";
    }
    format!(
        "{reward}, J2J × 100 by {}; J2B × 100 is {}, B2B × 100 {}.{}",
        change(&gain.j2j, 100.0),
        moved(s.j2b, t.j2b),
        moved(s.b2b, t.b2b),
        too_many(t)
    )
}

/// A mean difference with its interval, in a unit.
fn change(p: &Paired, by: f64) -> String {
    let values = [p.difference, p.low, p.high].map(|v| by * v);
    let digits = digits(&values);
    let [difference, low, high] = values.map(|v| Cell::difference(v, digits).text);
    // One mesh has no interval.
    match p.low.is_finite() {
        true => format!("{difference} (95 % interval {low} to {high})"),
        false => difference,
    }
}

/// Digits after the point that differences take: three, and more where the largest would have fewer than two of its own.
fn digits(values: &[f64]) -> usize {
    let most = values.iter().filter(|v| v.is_finite()).fold(0.0, |most: f64, v| most.max(v.abs()));
    let own = if most > 0.0 { 1.0 - most.log10().floor() } else { 0.0 };
    own.clamp(3.0, 7.0) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_meshes_without_a_rig_rewards_alone_are_told() {
        let row = |method: &str, j2b: f64| -> Row {
            let skeletons = serde_json::json!({"split": "meshes", "method": method, "assets": 7, "compared": 7, "j2j": null,
                "j2b": j2b, "b2b": j2b, "valid": 1.0, "joints": 9.0, "true_joints": 1.0, "joints_off": 8.0});
            let rewards =
                serde_json::json!({"coverage": 0.5, "containment": 0.5, "skinning": 0.5, "motion": 0.5, "total": 4.0});
            serde_json::from_value(serde_json::json!({"rewards": rewards, "skeletons": skeletons})).unwrap()
        };
        let paired = |n| Paired { n, difference: 0.1, low: 0.05, high: 0.2, smaller_equal_larger: [1, 0, 6], p: 0.1 };
        let said = |n| {
            let gain = Gain { split: "meshes".into(), reward: paired(7), j2j: paired(n) };
            verdict(&gain, &[row("before", 0.1), row("after", 0.2)])
        };
        let bare = "meshes: over 7 meshes the mean reward changed by +0.100 (95 % interval +0.050 to +0.200)";
        assert_eq!(said(0), format!("{bare}."));
        assert!(said(7).starts_with(&format!("{bare}, J2J × 100 by +10.000")), "{}", said(7));
        // Many joints lie near everything.
        let told = "J2B × 100 is 20.000, 10.000 before, B2B × 100 20.000, 10.000 before. Its skeletons have 9.0 joints on average, \
                    the true ones 1.0: look at them before you trust these distances.";
        assert!(said(7).ends_with(told), "{}", said(7));
    }

    #[test]
    fn every_reward_is_shown_and_explained() {
        let rewards = Rewards::of([0.125, 0.25, 0.5, 0.75], [5.0, 1.0, 1.0, 1.0]);
        let skeletons = serde_json::json!({"split": "val", "method": "before", "assets": 7, "compared": 7, "j2j": 0.1,
            "j2b": 0.1, "b2b": 0.1, "valid": 1.0, "joints": 9.0, "true_joints": 1.0, "joints_off": 8.0});
        let row = Row { rewards, skeletons: serde_json::from_value(skeletons).unwrap() };
        let (convention, reward_weights) = ("unirig".into(), Some(RewardWeights::default()));
        let mut report = Report {
            convention,
            reward_weights,
            without_weights: false,
            rows: vec![row],
            gains: Vec::new(),
            assets: Vec::new(),
        };
        let shown = lines(&report);
        // Of a model without skin weights two of them cannot be judged.
        report.without_weights = true;
        let alone = lines(&report);
        assert!(
            alone[1].contains("0.2500") && !alone[1].contains("0.5000") && !alone[1].contains("0.7500"),
            "{alone:?}"
        );
        report.without_weights = false;
        let lines = shown;
        // Heads stand above their figures.
        let ends = |line: &str, word: &str| line.find(word).unwrap() + word.len();
        for (part, value) in Rewards::PARTS.iter().zip(rewards.parts()) {
            assert_eq!(ends(&lines[0], part.name), ends(&lines[1], &format!("{value:.4}")), "{lines:?}");
            assert!(lines[2].contains(part.name) && lines[2].contains(part.symbol), "{}", lines[2]);
            assert_eq!(riglab_report::explained("grpo", &format!("eval/{}@val", part.name)), Some(part.symbol));
        }
        let checkpoint = State { task: "grpo".into(), step: 1, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
        let mut evaluation = Evaluation { checkpoint, report, gallery: Vec::new(), other_models: Vec::new() };
        let table = evaluation.table();
        assert!(table.head.len() == table.rows[0].len() && table.head[4] == "coverage R_vj", "{:?}", table.head);
        assert!(table.note.contains("reward.weights (coverage 5, containment 1, skinning 1, motion 1): coverage (R_vj), joints near all of the body; "));
        assert!(table.note.starts_with("before: the model that the run started from; "), "{}", table.note);
        evaluation.report.without_weights = true;
        let bare = evaluation.table();
        assert_eq!(bare.rows[0][6..8].iter().map(|cell| &*cell.text).collect::<Vec<_>>(), ["–"; 2]);
        assert!(bare.note.ends_with("makes no skin weights that skinning and motion could judge."), "{}", bare.note);
        assert!(!table.note.contains("makes no skin weights"));
        let names: Vec<String> = evaluation.findings()[0].totals_of.iter().map(|m| m.name.clone()).collect();
        assert!(
            names.iter().any(|n| n == "containment R_vk") && !names.iter().any(|n| n == "motion R_mo"),
            "{names:?}"
        );
        evaluation.other_models.push("start.model names another model".into());
        assert!(evaluation.table().note.starts_with("before: another model than the run started from, "));
    }

    #[test]
    fn findings_have_every_reward_of_each_asset_that_is_known() {
        let rewards = Rewards::of([0.125, 0.25, 0.5, 0.75], [5.0, 1.0, 1.0, 1.0]);
        let asset = |rewards: Option<Rewards>| {
            let distances = serde_json::json!({"j2j": 0.1, "j2b": 0.1, "b2b": 0.1});
            let score = AssetScore { reward: 2.125, rewards, distances: serde_json::from_value(distances).unwrap() };
            let (split, name, category) = ("val".into(), "a".into(), String::new());
            AssetRow { split, name, category, before: score.clone(), after: score }
        };
        let findings = |assets: Vec<AssetRow>| {
            let (convention, reward_weights) = ("unirig".into(), Some(RewardWeights::default()));
            let (rows, gains) = (Vec::new(), Vec::new());
            let report = Report { convention, reward_weights, without_weights: false, rows, gains, assets };
            let checkpoint =
                State { task: "grpo".into(), step: 1, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
            Evaluation { checkpoint, report, gallery: Vec::new(), other_models: Vec::new() }.findings().remove(0)
        };
        let all = findings(vec![asset(Some(rewards))]);
        let names: Vec<&str> = all.singles_of.iter().map(|m| m.name.as_str()).collect();
        let at = names.iter().position(|name| *name == "reward").unwrap();
        assert_eq!(names[at + 1..], ["coverage R_vj", "containment R_vk", "skinning R_sc", "motion R_mo"]);
        assert_eq!(all.singles[0].values[at..], [2.125, 0.125, 0.25, 0.5, 0.75]);
        // The total is of all settings, a part of its own alone.
        assert_eq!(all.singles_of[at].defined_by, ["reward"]);
        assert_eq!(all.singles_of[at + 1].defined_by, ["reward.resolution", "reward.alpha"]);
        let before = findings(vec![asset(Some(rewards)), asset(None)]);
        assert_eq!((before.singles_of.len(), before.totals_of.len()), (at + 1, all.totals_of.len()));
    }

    #[test]
    fn changes_have_digits_enough_and_nothing_has_no_sign() {
        let paired = |difference: f64, low: f64, high: f64| {
            change(&Paired { n: 7, difference, low, high, smaller_equal_larger: [1, 6, 0], p: 1.0 }, 1.0)
        };
        assert_eq!(paired(0.0219, -0.0024, 0.0687), "+0.022 (95 % interval -0.002 to +0.069)");
        assert_eq!(paired(-5.29e-5, -1.59e-4, 0.0), "-0.00005 (95 % interval -0.00016 to 0.00000)");
        assert_eq!(paired(-0.0, 0.0, 0.0), "0.000 (95 % interval 0.000 to 0.000)");
        assert_eq!(paired(12.5, f64::NAN, f64::NAN), "+12.500");
        assert_eq!(paired(1e-300, -1e-300, 0.0), "0.0000000 (95 % interval 0.0000000 to 0.0000000)");
    }
}
