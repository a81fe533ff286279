//! An evaluation as a file, and as a part of a report.

use std::collections::BTreeSet;

use riglab_metric::SkinMetrics;
use riglab_report::{Beside, Block, Cell, Chart, Columns, Findings, Metric, Series, Single, Table, Total, counted};
use riglab_train::State;
use serde::{Deserialize, Serialize};

use super::evaluate::{AssetRow, Report, Row};
use super::gallery::ShownAsset;
use crate::experiment::{of_splits, pictures, views};

/// What `riglab eval` writes.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Evaluation {
    /// The checkpoint that was evaluated.
    pub checkpoint: State,
    /// The numbers.
    pub report: Report,
    /// The pictures, in the folder beside the file.
    pub gallery: Vec<ShownAsset>,
}

impl Evaluation {
    /// Its part of a report; `picture` finds the bytes of a file of the gallery.
    pub fn blocks(&self, picture: impl Fn(&str) -> Option<Vec<u8>>) -> Vec<Block> {
        let report = &self.report;
        let mut blocks = vec![Block::Heading(of_splits("Skin weights", self.splits()))];
        blocks.extend(self.splits().map(|split| Block::Text(verdict(report, split))));
        blocks.extend(self.splits().map(|split| Block::Table(table(report, split))));
        blocks.push(Block::Charts(self.splits().map(|split| by_tokens(report, split)).collect()));
        blocks.push(Block::Heading("Codes".into()));
        blocks.push(Block::Table(self.codes()));
        if !self.gallery.is_empty() {
            blocks.push(Block::Heading("Pictures".into()));
            blocks.push(Block::Text(
                "Top row: skeleton, the true weights as coloured parts, the predicted ones, and the share of each \
                 vertex's weight that is on a wrong bone. Bottom row: the bone whose weights have the largest error."
                    .into(),
            ));
            let caption =
                |s: &ShownAsset| format!("{} of {}: {}, IoU {:.3}; bone {}", s.why, s.split, s.name, s.iou, s.bone);
            blocks.push(pictures(self.gallery.iter().map(|s| (s.file.as_str(), caption(s))), &picture));
            blocks.extend(views(self.gallery.iter().map(|s| (s.file.as_str(), caption(s))), &picture));
        }
        blocks.push(Block::Folded("Every asset".into(), self.assets()));
        blocks
    }

    /// What it found, in the form in which runs are compared: after the decode rule.
    pub fn findings(&self) -> Vec<Findings> {
        let report = &self.report;
        let of = report.convention.as_str();
        let totals_of = skin_columns(of, |r: &Row| (&r.pooled, &r.per_rig));
        let total = |r: &Row| Total {
            split: r.split.clone(),
            method: named(r),
            own: r.own(),
            assets: r.assets,
            values: totals_of.values(r),
        };
        let shown = |r: &&Row| !r.own() || r.method == "rule";
        let singles_of = asset_columns(of, |a: &AssetRow| [a.iou, a.l1]);
        let single = |a: &AssetRow| Single {
            split: a.split.clone(),
            name: a.name.clone(),
            category: a.category.clone(),
            values: singles_of.values(a),
        };
        vec![Findings {
            about: "Skin weights from their codes".into(),
            over: None,
            totals_of: totals_of.metrics(),
            totals: report.rows.iter().filter(shown).map(total).collect(),
            singles_of: singles_of.metrics(),
            singles: report.assets.iter().map(single).collect(),
            published: vec![Beside {
                table: "skintokens.table5",
                columns: &[("IoU", "iou", 0.01), ("L1", "l1", 1.0), ("mask", "mask", 0.01)],
            }],
        }]
    }

    /// The splits that have assets, in the order in which they were evaluated.
    fn splits(&self) -> impl Iterator<Item = &str> {
        let mut seen = BTreeSet::new();
        self.report.rows.iter().map(|row| row.split.as_str()).filter(move |split| seen.insert(*split))
    }

    fn codes(&self) -> Table {
        let head =
            ["split", "tokens", "distinct", "utilisation", "perplexity", "bits", "compression", "(2 bytes a code)"];
        let mut table = Table::new("How the codebook is used, all codes kept", &head);
        for (split, c) in self.splits().filter_map(|split| self.report.codebook.get_key_value(split)) {
            table.row(vec![
                Cell::text(split),
                Cell::count(c.tokens as usize),
                if c.distinct == 0 { Cell::none() } else { Cell::count(c.distinct) },
                Cell::number(c.utilisation, 4),
                Cell::number(c.perplexity, 0),
                Cell::number(c.bits, 2),
                Cell::number(c.compression_ratio, 1),
                Cell::number(c.compression_ratio_16_bit, 1),
            ]);
        }
        table.note = "Compression: bits of 16-bit weights at every vertex / bits of the codes, mean over assets; last \
                      column: with 2 bytes a code. Few tokens cannot use many codes: read utilisation beside the \
                      number of tokens. Bits: at most what a code holds, the entropies of its axes summed; for real \
                      axes (model.bottleneck = \"gaussian\") their divergence from N(0, 1): what sampled codes hold \
                      (\"rule, drawn\"), not the means."
            .into();
        table
    }

    fn assets(&self) -> String {
        let mut text =
            format!("{:12} {:>7} {:>8} {:>7} {:>8} {:>6}  name\n", "split", "IoU", "L1", "raw", "vertices", "bones");
        for a in &self.report.assets {
            text += &format!(
                "{:12} {:>7.4} {:>8.5} {:>7.4} {:>8} {:>6}  {}\n",
                a.split, a.iou, a.l1, a.raw_iou, a.vertices, a.bones, a.name
            );
        }
        text
    }
}

/// A row's method, with its codes where there are rows of several numbers of them.
fn named(row: &Row) -> String {
    match row.method.as_str() {
        "raw" | "rule" => format!("{}, {}", row.method, counted(row.tokens, "code")),
        other => other.to_owned(),
    }
}

/// Columns of a table of skin weights, out of a row's figures over all vertices and as means over rigs.
pub(crate) fn skin_columns<R: 'static>(
    convention: &str,
    of: impl Fn(&R) -> (&SkinMetrics, &SkinMetrics) + Copy + 'static,
) -> Columns<R> {
    Columns::default()
        .with(Metric::higher("IoU", convention, 4), move |r| of(r).0.iou)
        .with(Metric::higher("IoU per rig", convention, 4), move |r| of(r).1.iou)
        .with(Metric::lower("L1", convention, 5), move |r| of(r).0.l1)
        .with(Metric::lower("L1 per rig", convention, 5), move |r| of(r).1.l1)
        .with(Metric::traded("precision", convention, 3), move |r| of(r).0.precision)
        .with(Metric::traded("recall", convention, 3), move |r| of(r).0.recall)
        // The share of bones whose influence lies within the predicted one: who says yes to everything has them all.
        .with(Metric::traded("mask", convention, 3), move |r| of(r).1.mask_cover_bone)
}

/// Columns of single assets' skin weights, out of an asset's IoU and L1.
pub(crate) fn asset_columns<R: 'static>(convention: &str, of: impl Fn(&R) -> [f64; 2] + Copy + 'static) -> Columns<R> {
    Columns::default()
        .with(Metric::higher("IoU", convention, 4), move |a| of(a)[0])
        .with(Metric::lower("L1", convention, 5), move |a| of(a)[1])
}

/// What is said of baselines in an evaluation.
pub(crate) const BONES_KNOWN: &str = "they are told which bones move something, as those of `riglab compare --baselines` \
                                      are not.";

/// What is said of columns that have no best.
pub(crate) const TRADED: &str =
    "No best is marked for precision, recall and mask: predicting more, or less, raises one and lowers another.";

/// The sentence that says how good it is.
fn verdict(report: &Report, split: &str) -> String {
    let rows = || report.rows.iter().filter(move |r| r.split == split);
    let ours = rows().filter(|r| r.method == "rule").max_by_key(|r| r.tokens);
    let other = rows().filter(|r| !r.own()).max_by(|a, b| a.pooled.iou.total_cmp(&b.pooled.iou));
    let Some(ours) = ours else { return format!("{split}: nothing was evaluated.") };
    let said = format!(
        "{split}: over {}, {} a bone {} IoU {:.3} ({:.3} per rig) and L1 {:.4}",
        counted(ours.assets, "asset"),
        counted(ours.tokens, "code"),
        if ours.tokens == 1 { "gives" } else { "give" },
        ours.pooled.iou,
        ours.per_rig.iou,
        ours.pooled.l1
    );
    match other {
        Some(b) => {
            let than = if ours.pooled.iou > b.pooled.iou { "above" } else { "not above" };
            format!("{said}; its IoU is {than} the best baseline without learning ({}, {:.3}).", b.method, b.pooled.iou)
        }
        None => said + ".",
    }
}

fn table(report: &Report, split: &str) -> Table {
    let rows: Vec<&Row> = report.rows.iter().filter(|r| r.split == split).collect();
    let assets = rows.first().map_or(0, |r| r.assets);
    let head = ["method", "IoU", "IoU per rig", "L1", "L1 per rig", "precision", "recall", "mask"];
    let mut table = Table::new(format!("{split}: {}, all vertices", counted(assets, "asset")), &head);
    let most = rows.iter().map(|r| r.pooled.iou).fold(f64::NAN, f64::max);
    let most_each = rows.iter().map(|r| r.per_rig.iou).fold(f64::NAN, f64::max);
    let least = rows.iter().map(|r| r.pooled.l1).fold(f64::NAN, f64::min);
    let least_each = rows.iter().map(|r| r.per_rig.l1).fold(f64::NAN, f64::min);
    let mut learned = true;
    for r in rows {
        if learned && !r.own() {
            table.line();
        }
        learned = r.own();
        let p = &r.pooled;
        table.row(vec![
            Cell::text(named(r)),
            Cell::number(p.iou, 4).strong_if(p.iou == most),
            Cell::number(r.per_rig.iou, 4).strong_if(r.per_rig.iou == most_each),
            Cell::number(p.l1, 5).strong_if(p.l1 == least),
            Cell::number(r.per_rig.l1, 5).strong_if(r.per_rig.l1 == least_each),
            Cell::number(p.precision, 3),
            Cell::number(p.recall, 3),
            Cell::number(r.per_rig.mask_cover_bone, 3),
        ]);
    }
    table.note = format!(
        "Convention {}: weights above 0.01 are active; IoU, L1, precision and recall pool all vertex-bone pairs of the \
         split, bones that move nothing left out; mask: share of bones all of whose vertices are predicted; mask and \
         per rig: means over assets. {TRADED} raw: the network's output; rule: the same after the decode rule (cut at \
         {}, the four largest kept, rows normalised to sum to 1). codes exchanged: each bone decoded from all of \
         the next one's codes, where there are two: the lower, the more the codes hold. Below the line: baselines without learning, from distances \
         to the bones, straight or through the body, or from heat diffused over the surface; {BONES_KNOWN}",
        report.convention, report.cut
    );
    table
}

fn by_tokens(report: &Report, split: &str) -> Chart {
    let line = |method: &str| Series {
        name: method.into(),
        points: report
            .rows
            .iter()
            .filter(|r| r.split == split && r.method == method)
            .map(|r| (r.tokens as f64, r.pooled.iou))
            .collect(),
    };
    Chart {
        title: format!("IoU by codes kept, {split}"),
        x: "codes".into(),
        series: vec![line("rule"), line("raw")],
        y: "IoU, pooled".into(),
        ..Chart::default()
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use riglab_metric::SkinTally;

    use super::*;

    #[test]
    fn rows_of_several_numbers_of_codes_have_names_of_their_own() {
        let metrics = SkinTally::of(&[1.0, 0.0], &[1.0, 0.0], 2).metrics();
        let row = |method: &str, tokens: usize| Row {
            split: "test_new".into(),
            method: method.into(),
            tokens,
            assets: 1,
            pooled: metrics,
            per_rig: metrics,
        };
        let rows = vec![
            row("raw", 1),
            row("rule", 1),
            row("raw", 4),
            row("rule", 4),
            row("rule, codes exchanged", 4),
            row("1/d^2", 0),
        ];
        let report = Report {
            convention: "skintokens".into(),
            cut: 0.1,
            rows,
            assets: Vec::new(),
            codebook: BTreeMap::new(),
            codes: Vec::new(),
        };
        let names: Vec<String> = table(&report, "test_new").rows.iter().map(|row| row[0].text.clone()).collect();
        let all = ["raw, 1 code", "rule, 1 code", "raw, 4 codes", "rule, 4 codes", "rule, codes exchanged", "1/d^2"];
        assert_eq!(names, all);
    }
}
