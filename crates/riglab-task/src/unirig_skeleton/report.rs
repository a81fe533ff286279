//! An evaluation as a file, as lines, and as a part of a report.

use riglab_report::{Beside, Block, Cell, Columns, Findings, Metric, Single, Table, Total, counted};
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

const HEAD: [&str; 11] = [
    "split",
    "method",
    "assets",
    "compared",
    "J2J × 100",
    "J2B × 100",
    "B2B × 100",
    "valid %",
    "joints, mean",
    "true joints, mean",
    "joints off %",
];

fn splits(report: &Report) -> Vec<&str> {
    let mut splits: Vec<&str> = report.rows.iter().map(|r| r.split.as_str()).collect();
    splits.dedup();
    splits
}

/// Which of several draws is the model's, where there were several.
fn drawn(report: &Report) -> Option<String> {
    let n = report.consensus;
    if n == 1 && !report.draws.is_empty() {
        return Some(format!("model: a skeleton for each mesh ({})", report.draws));
    }
    let draws = if report.draws.is_empty() { String::new() } else { format!(" ({})", report.draws) };
    (n > 1).then(|| format!("model: the one of {n} sampled skeletons{draws} that the others agree with most"))
}

/// The tables of all splits.
pub fn lines(report: &Report) -> Vec<String> {
    let mut out = vec![format!("convention {}, distances × 100", report.convention)];
    out.extend(drawn(report));
    for split in splits(report) {
        let rows: Vec<&Row> = report.rows.iter().filter(|r| r.split == split).collect();
        let width = rows.iter().map(|r| r.method.chars().count()).max().unwrap_or(0).max(12);
        out.push(format!("\n{split} ({})", counted(rows.first().map_or(0, |r| r.assets), "asset")));
        out.push(format!(
            "{:width$} {:>8} {:>7} {:>7} {:>7} {:>7} {:>9} {:>6} {:>9}",
            "method", "compared", "J2J", "J2B", "B2B", "valid", "joints", "true", "off"
        ));
        for r in rows {
            out.push(format!(
                "{:width$} {:>8} {:>7.2} {:>7.2} {:>7.2} {:>6.1}% {:>9.1} {:>6.1} {:>8.1}%",
                r.method,
                r.compared,
                100.0 * r.j2j,
                100.0 * r.j2b,
                100.0 * r.b2b,
                100.0 * r.valid,
                r.joints,
                r.true_joints,
                100.0 * r.joints_off
            ));
        }
    }
    out
}

/// Columns of a table of skeletons, out of a row's J2J, J2B and B2B: shares of the cube's edge times 100.
pub(crate) fn skeleton_columns<R: 'static>(
    convention: &str,
    of: impl Fn(&R) -> [f64; 3] + Copy + 'static,
) -> Columns<R> {
    let column = |name| Metric::lower(name, convention, 3);
    Columns::default()
        .with(column("J2J × 100"), move |r| 100.0 * of(r)[0])
        .with(column("J2B × 100"), move |r| 100.0 * of(r)[1])
        .with(column("B2B × 100"), move |r| 100.0 * of(r)[2])
}

/// What an evaluation of skeletons found, in the form in which runs are compared.
pub(crate) fn skeleton_findings(report: &Report) -> Findings {
    let of = report.convention.as_str();
    let totals_of = skeleton_columns(of, |r: &Row| [r.j2j, r.j2b, r.b2b])
        .with(Metric::higher("valid %", of, 1), |r| 100.0 * r.valid)
        .with(Metric::lower("joints in all, off %", of, 1), |r| 100.0 * (r.joints / r.true_joints - 1.0).abs())
        .with(Metric::lower("joints off %", of, 1), |r| 100.0 * r.joints_off);
    let singles_of = skeleton_columns(of, |a: &AssetRow| [a.model.j2j, a.model.j2b, a.model.b2b]);
    let total = |r: &Row| Total {
        split: r.split.clone(),
        method: format!("{}, {} compared", r.method, r.compared),
        own: r.method == "model",
        assets: r.assets,
        values: totals_of.values(r),
    };
    let single = |a: &AssetRow| Single {
        split: a.split.clone(),
        name: a.name.clone(),
        category: a.category.clone(),
        values: singles_of.values(a),
    };
    Findings {
        about: "Skeletons".into(),
        over: None,
        totals_of: totals_of.metrics(),
        totals: report.rows.iter().map(total).collect(),
        singles_of: singles_of.metrics(),
        singles: report.assets.iter().map(single).collect(),
        published: vec![SKELETONS_OF_UNIRIG],
    }
}

/// UniRig's published skeletons, in fractions of the cube's side.
pub(crate) const SKELETONS_OF_UNIRIG: Beside = Beside { table: "unirig.j2j", columns: &[("J2J × 100", "j2j", 100.0)] };

/// SkinTokens' published skeletons, in percent of the longest side.
pub(crate) const SKELETONS_OF_SKINTOKENS: Beside = Beside {
    table: "skintokens.table3",
    columns: &[("J2J × 100", "j2j", 1.0), ("J2B × 100", "j2b", 1.0), ("B2B × 100", "b2b", 1.0)],
};

/// A column of distances: its name, and the distance of an asset.
type Column = (&'static str, fn(&AssetRow) -> f64);

/// A sentence, with a space before it, where a model's skeletons have far more or fewer joints than the true ones: a network
/// that has not learned when to stop covers a mesh with joints, which distances like.
pub(crate) fn too_many(model: &Row) -> String {
    if (0.5..=2.0).contains(&(model.joints / model.true_joints)) {
        return String::new();
    }
    format!(
        " Its skeletons have {:.1} joints on average, the true ones {:.1}: look at them before you trust these distances.",
        model.joints, model.true_joints
    )
}

impl Evaluation {
    /// What it found, in the form in which runs are compared.
    pub fn findings(&self) -> Vec<Findings> {
        vec![skeleton_findings(&self.report)]
    }

    /// Its part of a report; `picture` finds the bytes of a file of the gallery.
    pub fn blocks(&self, picture: impl Fn(&str) -> Option<Vec<u8>>) -> Vec<Block> {
        let mut blocks = vec![Block::Heading(of_splits("Skeletons", splits(&self.report)))];
        blocks.extend(splits(&self.report).into_iter().filter_map(|s| self.verdict(s)).map(Block::Text));
        blocks.push(Block::Table(self.table()));
        if !self.gallery.is_empty() {
            blocks.push(Block::Heading("Pictures".into()));
            let caption =
                |s: &ShownAsset| format!("{} of {}: {}, J2J × 100 {:.2}", s.why, s.split, s.name, 100.0 * s.j2j);
            blocks.push(pictures(self.gallery.iter().map(|s| (s.file.as_str(), caption(s))), &picture));
            blocks.extend(views(self.gallery.iter().map(|s| (s.file.as_str(), caption(s))), &picture));
        }
        blocks.push(Block::Folded("Every asset".into(), self.assets()));
        blocks
    }

    fn verdict(&self, split: &str) -> Option<String> {
        let of = |method: &str| self.report.rows.iter().find(|r| r.split == split && r.method == method);
        let model = of("model")?;
        let Some(rival) = of("retrieval") else {
            return Some(format!(
                "{split}: J2J × 100 is {:.2}; there is no training shape here to compare with.",
                100.0 * model.j2j
            ));
        };
        let fitted =
            of("template fit").map(|r| format!(", fitted to the mesh {:.2}", 100.0 * r.j2j)).unwrap_or_default();
        let better = [(model.j2j, rival.j2j), (model.j2b, rival.j2b), (model.b2b, rival.b2b)];
        let better = better.iter().filter(|(a, b)| a < b).count();
        let better = ["none", "one", "two", "all three"][better];
        let many = too_many(model);
        Some(format!(
            "{split}: J2J × 100 is {:.2}; the skeleton of the nearest training shape gives {:.2}{fitted}. The model is \
             better than retrieval in {better} of the distances J2J, J2B and B2B.{many}",
            100.0 * model.j2j,
            100.0 * rival.j2j
        ))
    }

    fn table(&self) -> Table {
        let mut table = Table::new("Distances × 100 (of the cube's edge), convention unirig", &HEAD);
        for r in &self.report.rows {
            table.row(vec![
                Cell::text(&r.split),
                Cell::text(&r.method),
                Cell::count(r.assets),
                Cell::count(r.compared),
                Cell::number(100.0 * r.j2j, 2),
                Cell::number(100.0 * r.j2b, 2),
                Cell::number(100.0 * r.b2b, 2),
                Cell::number(100.0 * r.valid, 1),
                Cell::number(r.joints, 1),
                Cell::number(r.true_joints, 1),
                Cell::number(100.0 * r.joints_off, 1),
            ]);
        }
        table.note = "Distances: means over the assets that can be compared, those with a bone on both sides. Joints: \
                      means over all assets, 0 where nothing could be decoded; joints off: mean of |joints - true \
                      joints| / true joints."
            .into();
        if self.report.rows.iter().any(|r| r.method == "retrieval") {
            table.note += " retrieval: the skeleton of the nearest training shape, by chamfer distance of points. template \
                           fit: the same, moved along as that shape is deformed onto the mesh.";
        }
        if let Some(drawn) = drawn(&self.report) {
            table.note = format!("{} {drawn}.", table.note);
        }
        table
    }

    fn assets(&self) -> String {
        // Distances that nothing has are no columns.
        let all: [Column; 3] =
            [("J2J", |a| a.model.j2j), ("retrieval", |a| a.retrieval.j2j), ("template", |a| a.template_fit.j2j)];
        let known = |of: fn(&AssetRow) -> f64| self.report.assets.iter().any(|a| of(a).is_finite());
        let columns: Vec<_> = all.into_iter().filter(|(name, of)| *name == "J2J" || known(*of)).collect();
        let mut text = format!("{:12}", "split");
        columns.iter().for_each(|(name, _)| text += &format!(" {name:>9}"));
        text += &format!(" {:>7} {:>7}  name\n", "joints", "true");
        for a in &self.report.assets {
            text += &format!("{:12}", a.split);
            columns.iter().for_each(|(_, of)| text += &format!(" {:>9.2}", 100.0 * of(a)));
            text += &format!(" {:>7} {:>7}  {}\n", a.joints, a.true_joints, a.name);
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_stand_below_each_other_whatever_methods_are_called() {
        let row = |method: &str| Row {
            split: "test".into(),
            method: method.into(),
            assets: 3,
            compared: 3,
            j2j: 0.05,
            j2b: 0.04,
            b2b: 0.03,
            valid: 1.0,
            joints: 20.0,
            true_joints: 21.0,
            joints_off: 0.1,
        };
        let of = |methods: &[&str]| {
            let rows = methods.iter().map(|method| row(method)).collect();
            let report =
                Report { convention: "unirig".into(), consensus: 1, draws: String::new(), rows, assets: Vec::new() };
            let table = lines(&report).split_off(2);
            assert!(table.iter().all(|line| line.len() == table[0].len()), "{table:#?}");
            table[0].clone()
        };
        assert!(of(&["model", "retrieval"]).starts_with("method       compared"));
        of(&["model", "model, 50 % of joints given", "50 % of joints given, alone"]);
    }
}
