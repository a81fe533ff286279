//! An evaluation as a file, as lines, and as a part of a report.

use riglab_report::{Beside, Block, Cell, Findings, Metric, Single, Table, Total, counted};
use riglab_train::State;
use serde::{Deserialize, Serialize};

use super::evaluate::{AssetRow, AttributeRow, Report, Row};
use super::gallery::ShownAsset;
use crate::experiment::{of_splits, pictures, views};
use crate::fsq_cvae::{BONES_KNOWN, asset_columns, skin_columns};

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
    let mut splits: Vec<&str> = report.rows.iter().map(|r| r.split.as_str()).collect();
    splits.dedup();
    splits
}

/// Assets with clips of a split, whose rows these are.
fn with_clips(rows: &[&Row]) -> usize {
    rows.iter().map(|r| r.clip_assets).max().unwrap_or(0)
}

/// The tables of all splits.
pub fn lines(report: &Report) -> Vec<String> {
    let mut out = vec![format!(
        "given the true skeletons; convention {}, decode rule: {}cut {}, top 4",
        report.convention,
        if report.spread > 0.0 { format!("spread {}, ", report.spread) } else { String::new() },
        report.cut
    )];
    for split in splits(report) {
        let rows: Vec<&Row> = report.rows.iter().filter(|r| r.split == split).collect();
        out.push(format!("\n{split} ({})", counted(rows.first().map_or(0, |r| r.assets), "asset")));
        let clips = with_clips(&rows);
        out.push(format!(
            "{:34} {:>8} {:>8} {:>6} {:>6} {:>6} {:>7} {:>8} {:>7}{}",
            "method",
            "L1",
            "per rig",
            "prec.",
            "recall",
            "(ours)",
            "IoU",
            "per rig",
            "motion",
            if clips > 0 { "   clips" } else { "" }
        ));
        for r in rows {
            let (p, e) = (&r.pooled, &r.per_rig);
            let moved = if clips > 0 { format!(" {:>7.5}", r.clips) } else { String::new() };
            let ours = Some(r.ours_at_recall).filter(|p| p.is_finite()).map_or(String::new(), |p| format!("{p:.3}"));
            out.push(format!(
                "{:34} {:>8.5} {:>8.5} {:>6.3} {:>6.3} {:>6} {:>7.4} {:>8.4} {:>7.5}{moved}",
                r.method, p.l1, e.l1, p.precision, p.recall, ours, p.iou, e.iou, r.motion
            ));
        }
        out.push("(ours): precision of the raw weights at the threshold where their recall equals the row's".into());
        if clips > 0 {
            out.push(format!(
                "motion: in random poses; clips: in frames of their own clips, of {} with any",
                counted(clips, "asset")
            ));
        }
        out.extend(of_attributes(&report.attributes, split));
    }
    out
}

/// What the attributes of a split's spring bones have for errors, a line each below one that says of what.
fn of_attributes(rows: &[AttributeRow], split: &str) -> Vec<String> {
    let rows: Vec<&AttributeRow> = rows.iter().filter(|a| a.split == split).collect();
    let head = rows.first().map(|a| {
        format!(
            "attributes of spring bones in {split} ({}), hit radius in the normalised cube; the mean of these bones is the \
             best that one constant could do",
            swinging(a.bones)
        )
    });
    let line = |a: &&AttributeRow| {
        let all = if a.name == "all" { " (each attribute divided by its usual spread)" } else { "" };
        format!("{:14} rms error {:>8.4}, predicting the mean {:>8.4}{all}", a.name, a.model, a.mean)
    };
    head.into_iter().chain(rows.iter().map(line)).collect()
}

fn swinging(bones: usize) -> String {
    format!("{} that {}", counted(bones, "bone"), if bones == 1 { "swings" } else { "swing" })
}

impl Evaluation {
    /// Its part of a report; `picture` finds the bytes of a file of the gallery.
    pub fn blocks(&self, picture: impl Fn(&str) -> Option<Vec<u8>>) -> Vec<Block> {
        let report = &self.report;
        let mut blocks = vec![Block::Heading(of_splits("Skin weights, given the skeletons,", splits(report)))];
        blocks.extend(splits(report).into_iter().filter_map(|s| verdict(report, s)).map(Block::Text));
        blocks.extend(splits(report).into_iter().map(|s| Block::Table(table(report, s))));
        if !report.attributes.is_empty() {
            blocks.push(Block::Heading("Attributes of spring bones".into()));
            blocks.push(Block::Table(attributes(report)));
        }
        if !self.gallery.is_empty() {
            blocks.push(Block::Heading("Pictures".into()));
            blocks.push(Block::Text(
                "Top row: skeleton, the true weights as coloured parts, the predicted ones, and the share of each \
                 vertex's weight that is on a wrong bone. Bottom row: the bone whose weights have the largest error."
                    .into(),
            ));
            let caption =
                |s: &ShownAsset| format!("{} of {}: {}, L1 {:.4}; bone {}", s.why, s.split, s.name, s.l1, s.bone);
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
        let [motion, clips] = ["motion", "clips"].map(|name| Metric::lower(name, of, 5));
        let moves = report.rows.iter().any(|r| r.clip_assets > 0);
        let totals_of = skin_columns(of, |r: &Row| (&r.pooled, &r.per_rig)).with(motion.clone(), |r| r.motion).with_if(
            moves,
            clips.clone(),
            |r| r.clips,
        );
        let singles_of =
            asset_columns(of, |a: &AssetRow| [a.iou, a.l1])
                .with(motion, |a| a.motion)
                .with_if(moves, clips, |a| a.clips);
        let total = |r: &Row| Total {
            split: r.split.clone(),
            method: r.method.clone(),
            own: r.learned,
            assets: r.assets,
            values: totals_of.values(r),
        };
        let single = |a: &AssetRow| Single {
            split: a.split.clone(),
            name: a.name.clone(),
            category: a.category.clone(),
            values: singles_of.values(a),
        };
        let mut found = vec![Findings {
            // TokenRig's are of all joints, those that move nothing too, which no rule is told there.
            about: "Skin weights of given skeletons, of joints that hold some".into(),
            over: None,
            totals_of: totals_of.metrics(),
            totals: report.rows.iter().filter(|r| r.method != "raw").map(total).collect(),
            singles_of: singles_of.metrics(),
            singles: report.assets.iter().map(single).collect(),
            published: vec![Beside { table: "unirig.skin_l1", columns: &[("L1", "skin_l1", 1.0)] }],
        }];
        found.extend(of_springs(&report.attributes));
        found
    }

    fn assets(&self) -> String {
        let clips = self.report.assets.iter().any(|a| a.clips.is_finite());
        let shown = |text: String| if clips { format!("{text:>8}") } else { String::new() };
        let mut text = format!(
            "{:12} {:>8} {:>7} {:>7} {:>13}{} {:>8} {:>6}  name\n",
            "split",
            "L1",
            "IoU",
            "motion",
            "best baseline",
            shown("clips".into()),
            "vertices",
            "bones"
        );
        for a in &self.report.assets {
            let known = |of: f64| if of.is_finite() { format!("{of:.5}") } else { "–".into() };
            text += &format!(
                "{:12} {:>8.5} {:>7.4} {:>7.5} {:>13}{} {:>8} {:>6}  {}\n",
                a.split,
                a.l1,
                a.iou,
                a.motion,
                known(a.rule_motion),
                shown(known(a.clips)),
                a.vertices,
                a.bones,
                a.name
            );
        }
        text += "best baseline: the motion of the baseline without learning whose mean over the split is lowest\n";
        text
    }
}

/// The sentence that says how good it is.
fn verdict(report: &Report, split: &str) -> Option<String> {
    let rows = || report.rows.iter().filter(move |r| r.split == split);
    let ours = rows().find(|r| r.method == "rule")?;
    let by_l1 = rows().filter(|r| !r.learned).min_by(|a, b| a.pooled.l1.total_cmp(&b.pooled.l1))?;
    let by_iou = rows().filter(|r| !r.learned).max_by(|a, b| a.pooled.iou.total_cmp(&b.pooled.iou))?;
    let than = |better: bool| if better { "better" } else { "not better" };
    Some(format!(
        "{split}: over {}, L1 {:.4}, {} than the best baseline without learning ({}, {:.4}), and IoU {:.3}, {} than \
         the best baseline by IoU ({}, {:.3}).",
        counted(ours.assets, "asset"),
        ours.pooled.l1,
        than(ours.pooled.l1 < by_l1.pooled.l1),
        by_l1.method,
        by_l1.pooled.l1,
        ours.pooled.iou,
        than(ours.pooled.iou > by_iou.pooled.iou),
        by_iou.method,
        by_iou.pooled.iou
    ))
}

fn table(report: &Report, split: &str) -> Table {
    let rows: Vec<&Row> = report.rows.iter().filter(|r| r.split == split).collect();
    let assets = rows.first().map_or(0, |r| r.assets);
    let clips = with_clips(&rows);
    let mut head =
        ["method", "L1", "L1 per rig", "precision", "recall", "ours at recall", "IoU", "IoU per rig"].to_vec();
    head.push("motion");
    if clips > 0 {
        head.push("clips");
    }
    let mut table = Table::new(format!("{split}: {}, all vertices", counted(assets, "asset")), &head);
    let least = |of: fn(&Row) -> f64| rows.iter().map(|r| of(r)).fold(f64::NAN, f64::min);
    let most = |of: fn(&Row) -> f64| rows.iter().map(|r| of(r)).fold(f64::NAN, f64::max);
    // Of a column: its value in a row, the best one, and how many digits are shown.
    type Column = (fn(&Row) -> f64, f64, usize);
    let mut columns: Vec<Column> = vec![
        (|r| r.pooled.l1, least(|r| r.pooled.l1), 5),
        (|r| r.per_rig.l1, least(|r| r.per_rig.l1), 5),
        // No best one: one rises as the other falls, and the third is to be read beside the precision of its row.
        (|r| r.pooled.precision, f64::NAN, 3),
        (|r| r.pooled.recall, f64::NAN, 3),
        (|r| r.ours_at_recall, f64::NAN, 3),
        (|r| r.pooled.iou, most(|r| r.pooled.iou), 4),
        (|r| r.per_rig.iou, most(|r| r.per_rig.iou), 4),
        (|r| r.motion, least(|r| r.motion), 5),
    ];
    if clips > 0 {
        columns.push((|r| r.clips, least(|r| r.clips), 5));
    }
    let mut learned = true;
    for r in &rows {
        if learned && !r.learned {
            table.line();
        }
        learned = r.learned;
        let cells = columns.iter().map(|(of, best, digits)| Cell::number(of(r), *digits).strong_if(of(r) == *best));
        table.row(std::iter::once(Cell::text(&r.method)).chain(cells).collect());
    }
    table.note = format!(
        "Convention {}: weights above 0.01 are active; all but the columns per rig pool all vertex-bone pairs of the \
         split, bones that move nothing left out. No best is marked for precision and recall: one rises as the other \
         falls. raw: the network's output; rule: the same after the decode rule ({}cut at {}, the four largest kept, \
         rows normalised to sum to 1). ours at recall: precision of the raw weights at the threshold where their \
         recall equals this row's. motion: how far vertices are from where the true weights take \
         them, mean over ten poses with random turns up to 30 degrees about each axis, then over rigs; the rig fills a \
         cube of side 2. {}Below the line: baselines without learning, from distances to the bones, straight or \
         through the body, or from heat diffused over the surface; {BONES_KNOWN}",
        report.convention,
        if report.spread > 0.0 {
            format!("spread over the surface as heat, over {} of the way to the nearest bone, ", report.spread)
        } else {
            String::new()
        },
        report.cut,
        match clips {
            0 => String::new(),
            n =>
                format!("clips: the same over up to 30 frames of a rig's own clips, over the {n} rigs that have any. "),
        }
    );
    table
}

/// Attributes of spring bones, a column each; `None` where a model tells none. What they are of single assets is not known.
fn of_springs(attributes: &[AttributeRow]) -> Option<Findings> {
    let mut out = Findings {
        about: "Attributes of spring bones, root of the mean squared error".into(),
        over: Some("bones"),
        ..Findings::default()
    };
    // Attributes of a split stand one after another, those of the next behind them, in the same order.
    for of in attributes.chunk_by(|a, b| a.split == b.split) {
        let total = |method: &str, own: bool, value: fn(&AttributeRow) -> f64| Total {
            split: of[0].split.clone(),
            method: method.into(),
            own,
            assets: of[0].bones,
            values: of.iter().map(value).collect(),
        };
        out.totals_of = of.iter().map(|a| Metric::lower(&a.name, "riglab", 4)).collect();
        out.totals.extend([total("model", true, |a| a.model), total("mean of these bones", false, |a| a.mean)]);
    }
    (!out.totals.is_empty()).then_some(out)
}

fn attributes(report: &Report) -> Table {
    let mut table = Table::new(
        "Root of the mean squared error; of all together, each over its usual spread",
        &["split", "attribute", "bones", "model", "mean of these bones"],
    );
    for a in &report.attributes {
        table.row(vec![
            Cell::text(&a.split),
            Cell::text(&a.name),
            Cell::count(a.bones),
            Cell::number(a.model, 4).strong_if(a.model < a.mean),
            Cell::number(a.mean, 4).strong_if(a.mean < a.model),
        ]);
    }
    table.note = "all: all attributes, each divided by its usual spread. The right column is the best that one \
                  constant for all bones could do. Hit radius is in the normalised cube."
        .into();
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_of_single_assets_stand_below_their_heads() {
        let row = |clips| AssetRow {
            split: "test_new".into(),
            name: "name".into(),
            category: String::new(),
            vertices: 1_234,
            bones: 20,
            iou: 0.5,
            l1: 0.01,
            motion: 0.02,
            rule_motion: 0.03,
            clips,
        };
        let state = State { task: String::new(), step: 0, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
        for clips in [f64::NAN, 0.04] {
            let report = Report {
                convention: String::new(),
                spread: 0.0,
                cut: 0.1,
                rows: Vec::new(),
                attributes: Vec::new(),
                assets: vec![row(clips)],
            };
            let text = Evaluation { checkpoint: state.clone(), report, gallery: Vec::new() }.assets();
            let ends = |line: &str| -> Vec<usize> {
                // Of each column the place of its last letter; `best baseline` is one.
                let line = line.replace("best baseline", "best_baseline");
                let last = |(k, c): (usize, char)| c != ' ' && line[k + 1..].starts_with([' ', '\n']);
                line.char_indices().filter(|&at| last(at)).map(|(k, _)| k).collect()
            };
            let mut lines = text.split_inclusive('\n').map(ends);
            // The first column stands to the left.
            assert_eq!(lines.next().unwrap()[1..], lines.next().unwrap()[1..], "{text}");
        }
    }

    #[test]
    fn bones_that_swing_are_counted_in_words() {
        assert_eq!([swinging(1), swinging(2)], ["1 bone that swings", "2 bones that swing"]);
    }

    #[test]
    fn attributes_of_spring_bones_are_compared_like_other_findings() {
        let row = |split: &str, name: &str, model: f64| AttributeRow {
            split: split.into(),
            name: name.into(),
            bones: 6,
            model,
            mean: 0.5,
        };
        let rows = [row("a", "drag", 0.25), row("a", "all", 1.0), row("b", "drag", 0.75), row("b", "all", 2.0)];
        let said = of_attributes(&rows, "b");
        assert!(said[0].contains("spring bones in b (6 bones that swing)"), "{said:?}");
        assert_eq!(said[1], "drag           rms error   0.7500, predicting the mean   0.5000");
        assert!(said.len() == 3 && said[2].contains("usual spread") && of_attributes(&rows, "c").is_empty());
        let found = of_springs(&rows).unwrap();
        assert_eq!(found.totals_of.iter().map(|m| m.name.as_str()).collect::<Vec<_>>(), ["drag", "all"]);
        assert_eq!(found.splits(), ["a", "b"]);
        let own: Vec<&Vec<f64>> = found.totals.iter().filter(|t| t.own).map(|t| &t.values).collect();
        assert_eq!(own, [&vec![0.25, 1.0], &vec![0.75, 2.0]]);
        assert!(found.blocks().is_empty() && of_springs(&[]).is_none());
    }
}
