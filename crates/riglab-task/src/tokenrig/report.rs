//! An evaluation as a file, as lines, and as a part of a report.

use riglab_report::{Beside, Block, Cell, Findings, Single, Table, Total, counted};
use riglab_train::State;
use serde::{Deserialize, Serialize};

use super::evaluate::{Report, SkinAsset};
use crate::fsq_cvae::{Row, asset_columns, skin_columns};
use crate::unirig_skeleton::report::{SKELETONS_OF_SKINTOKENS, skeleton_findings};
use crate::unirig_skeleton::{Evaluation as SkeletonEvaluation, ShownAsset, lines as skeleton_lines};

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

fn splits(report: &Report) -> Vec<&str> {
    let mut splits: Vec<&str> = report.skin.iter().map(|r| r.split.as_str()).collect();
    splits.dedup();
    splits
}

fn rows<'a>(report: &'a Report, split: &str) -> Vec<&'a Row> {
    report.skin.iter().filter(|r| r.split == split).collect()
}

/// The tables of all splits.
pub fn lines(report: &Report) -> Vec<String> {
    let mut out = skeleton_lines(&report.skeletons);
    out.push(format!("\nskin weights, convention {}", report.convention));
    for split in splits(report) {
        out.push(format!("\n{split}"));
        let head = ("method", "assets", "IoU", "per rig", "L1", "prec.", "recall");
        let (method, assets, iou, per_rig, l1, precision, recall) = head;
        out.push(format!("{method:44} {assets:>6} {iou:>7} {per_rig:>8} {l1:>8} {precision:>6} {recall:>6}"));
        for r in rows(report, split) {
            let p = &r.pooled;
            out.push(format!(
                "{:44} {:>6} {:>7.4} {:>8.4} {:>8.5} {:>6.3} {:>6.3}",
                r.method, r.assets, p.iou, r.per_rig.iou, p.l1, p.precision, p.recall
            ));
        }
    }
    out
}

impl Evaluation {
    /// Its part of a report; `picture` finds the bytes of a file of the gallery.
    pub fn blocks(&self, picture: impl Fn(&str) -> Option<Vec<u8>>) -> Vec<Block> {
        let skeletons = SkeletonEvaluation {
            checkpoint: self.checkpoint.clone(),
            report: self.report.skeletons.clone(),
            gallery: self.gallery.clone(),
        };
        let mut blocks = skeletons.blocks(picture);
        blocks.push(Block::Heading("Skin weights".into()));
        blocks.extend(splits(&self.report).into_iter().filter_map(|s| self.verdict(s)).map(Block::Text));
        blocks.extend(splits(&self.report).into_iter().map(|s| Block::Table(self.table(s))));
        blocks
    }

    /// What it found, in the form in which runs are compared.
    pub fn findings(&self) -> Vec<Findings> {
        let mut skeletons = skeleton_findings(&self.report.skeletons);
        skeletons.published.insert(0, SKELETONS_OF_SKINTOKENS);
        vec![
            skeletons,
            self.skin("generated", "Skin weights of generated skeletons"),
            self.skin("given", "Skin weights of given skeletons"),
        ]
    }

    fn skin(&self, mode: &str, about: &str) -> Findings {
        let of = self.report.convention.as_str();
        let totals_of = skin_columns(of, |r: &Row| (&r.pooled, &r.per_rig));
        let singles_of = asset_columns(of, |a: &SkinAsset| [a.iou, a.l1]);
        let total = |r: &Row| {
            let (own, method) = r.method.split_once(": ").filter(|(own, _)| *own == mode)?;
            Some(Total {
                split: r.split.clone(),
                method: method.into(),
                own: r.method == format!("{own}: model"),
                assets: r.assets,
                values: totals_of.values(r),
            })
        };
        let singles = self.report.skin_assets.iter().filter(|a| a.mode == mode);
        Findings {
            about: about.into(),
            over: None,
            totals_of: totals_of.metrics(),
            totals: self.report.skin.iter().filter_map(total).collect(),
            singles_of: singles_of.metrics(),
            singles: singles
                .map(|a| Single {
                    split: a.split.clone(),
                    name: a.name.clone(),
                    category: a.category.clone(),
                    values: singles_of.values(a),
                })
                .collect(),
            published: vec![Beside {
                table: "skintokens.table4",
                columns: &[("L1", "l1", 1.0), ("precision", "precision", 0.01), ("recall", "recall", 0.01)],
            }],
        }
    }

    fn verdict(&self, split: &str) -> Option<String> {
        let rows = rows(&self.report, split);
        let of = |method: &str| rows.iter().find(|r| r.method == method).map(|r| r.pooled.iou);
        let (given, own) = (of("given: model")?, of("given: auto-encoder").filter(|own| *own > 0.0)?);
        Some(format!(
            "{split}: for the true skeleton the model's codes give IoU {given:.3}, {:.0} % of the {own:.3} that the \
             auto-encoder reaches with the codes of the true weights.",
            100.0 * given / own
        ))
    }

    fn table(&self, split: &str) -> Table {
        let head = ["method", "assets", "IoU", "IoU per rig", "L1", "L1 per rig", "precision", "recall"];
        let mut table = Table::new(format!("{split}: all vertices, convention {}", self.report.convention), &head);
        let mut mode = "";
        for r in rows(&self.report, split) {
            let own = r.method.split(':').next().unwrap_or_default();
            if !mode.is_empty() && own != mode {
                table.line();
            }
            mode = own;
            let p = &r.pooled;
            table.row(vec![
                Cell::text(&r.method),
                Cell::count(r.assets),
                Cell::number(p.iou, 4),
                Cell::number(r.per_rig.iou, 4),
                Cell::number(p.l1, 5),
                Cell::number(r.per_rig.l1, 5),
                Cell::number(p.precision, 3),
                Cell::number(p.recall, 3),
            ]);
        }
        table.note =
            "All but the columns per rig pool all vertex-bone pairs of the split; per rig: means of each asset's \
                      own values. generated: on the model's own skeleton, against the true weights, each joint's moved \
                      to the nearest generated joint; the baselines get the same skeleton and the joints that the \
                      model gave codes. given: on the true skeleton; auto-encoder: from the codes of the true weights."
                .into();
        table.note += &lacking(&self.report.skin_assets, split);
        table
    }
}

/// Sentences on assets of a split that have no weights.
fn lacking(assets: &[SkinAsset], split: &str) -> String {
    let without = |mode: &str, written: bool| -> Vec<&SkinAsset> {
        let own = assets.iter().filter(|a| a.split == split && a.mode == mode && a.iou.is_nan());
        own.filter(|a| a.unwritten.is_empty() == written).collect()
    };
    let sentence = |mode: &str, own: &[&SkinAsset], why: &str| match own.len() {
        0 => String::new(),
        count => format!(" Not in {mode}: {}, as {why}.", counted(count, "asset")),
    };
    let unwritten = without("given", false);
    let fault = unwritten.first().map_or(String::new(), |first| format!(" ({}: {})", first.name, first.unwritten));
    [
        sentence("generated", &without("generated", true), "no skeleton came out"),
        sentence(
            "given",
            &without("given", true),
            "their true skeletons are longer than limits.joints or limits.tokens",
        ),
        sentence("given", &unwritten, &format!("their true skeletons cannot be written as tokens{fault}")),
    ]
    .concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn assets_without_weights_are_told_with_the_reason() {
        let of = |split: &str, mode: &str, iou| {
            let (name, category) = Default::default();
            SkinAsset { split: split.into(), name, category, mode: mode.into(), iou, l1: iou, unwritten: String::new() }
        };
        let nan = f64::NAN;
        let all = [of("a", "given", nan), of("a", "given", 0.5), of("a", "generated", 0.5), of("b", "generated", nan)];
        let long = " Not in given: 1 asset, as their true skeletons are longer than limits.joints or limits.tokens.";
        assert_eq!(lacking(&all, "a"), long);
        // What no limit helps is told as it is.
        let twice = SkinAsset { name: "x".into(), unwritten: "two hips".into(), ..of("a", "given", nan) };
        let unwritten = " Not in given: 1 asset, as their true skeletons cannot be written as tokens (x: two hips).";
        assert_eq!(lacking(&[&all[..], &[twice]].concat(), "a"), format!("{long}{unwritten}"));
        assert_eq!(lacking(&all, "b"), " Not in generated: 1 asset, as no skeleton came out.");
        assert_eq!(lacking(&all, "c"), "");
    }
}
