//! What an evaluation found, in the form in which runs are compared.
//!
//! A task fills [`Findings`] from its own evaluation; tables of spread, of categories and of published numbers come from
//! it without knowing the task.

use std::collections::{BTreeMap, BTreeSet};

use riglab_metric::statistics::Mean;

use crate::published::{Line, lines};
use crate::{Block, Cell, Table};

/// A column of numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Metric {
    /// Its name in tables, with the unit where it is not plain, such as `J2J × 100`.
    pub name: String,
    /// Whose formula.
    pub convention: String,
    /// Whether large values are the good ones.
    pub higher: bool,
    /// Whether the best of several is told by it alone. Not by precision, recall or what else rises when another falls:
    /// whoever says yes to everything has the best recall.
    pub ranked: bool,
    /// Digits after the point.
    pub digits: usize,
    /// Settings, or tables of them, that say what it is: runs that differ in these have other quantities under its name.
    pub defined_by: Vec<String>,
}

impl Metric {
    /// One of which large values are good.
    pub fn higher(name: &str, convention: &str, digits: usize) -> Self {
        let (name, convention, defined_by) = (name.into(), convention.into(), Vec::new());
        Self { name, convention, higher: true, ranked: true, digits, defined_by }
    }

    /// One of which small values are good.
    pub fn lower(name: &str, convention: &str, digits: usize) -> Self {
        Self { higher: false, ..Self::higher(name, convention, digits) }
    }

    /// One side of a trade-off, of which large values are good but none is marked as the best.
    pub fn traded(name: &str, convention: &str, digits: usize) -> Self {
        Self { ranked: false, ..Self::higher(name, convention, digits) }
    }

    /// The same as what these settings, or tables of them, define it.
    pub fn defined_by(self, settings: &[&str]) -> Self {
        Self { defined_by: settings.iter().map(|s| (*s).to_owned()).collect(), ..self }
    }

    /// Those of some settings that say what it is.
    pub(crate) fn among<'a>(&self, settings: &'a BTreeSet<String>) -> Vec<&'a str> {
        let defines = |key: &&String| {
            let of = |own: &String| key.strip_prefix(own).is_some_and(|rest| rest.is_empty() || rest.starts_with('.'));
            self.defined_by.iter().any(of)
        };
        settings.iter().filter(defines).map(String::as_str).collect()
    }

    /// Of some values which are the best: all that are shown with the best one's digits; none that is no number, and none
    /// that is the only one. None of a metric that is not ranked.
    pub(crate) fn best(&self, values: &[f64]) -> Vec<bool> {
        if !self.ranked || values.iter().filter(|v| v.is_finite()).count() < 2 {
            return vec![false; values.len()];
        }
        let finite = values.iter().copied().filter(|v| v.is_finite());
        let best = if self.higher { finite.reduce(f64::max) } else { finite.reduce(f64::min) };
        let shown = |v: f64| format!("{v:.*}", self.digits);
        let is_best = |v: f64| v.is_finite() && best.is_some_and(|best| shown(v) == shown(best));
        // Where all are alike, none is better than others.
        let all = values.iter().filter(|v| v.is_finite()).all(|v| is_best(*v));
        values.iter().map(|&v| !all && is_best(v)).collect()
    }
}

/// A method's numbers over a split.
#[derive(Clone, Debug, PartialEq)]
pub struct Total {
    /// The split.
    pub split: String,
    /// The method.
    pub method: String,
    /// Whether it is what the run trained, and no rule or reference beside it.
    pub own: bool,
    /// Assets, or what else its values are over: see [`Findings::over`].
    pub assets: usize,
    /// A value for each of [`Findings::totals_of`].
    pub values: Vec<f64>,
}

/// One asset's numbers, of what the run trained.
#[derive(Clone, Debug, PartialEq)]
pub struct Single {
    /// The split.
    pub split: String,
    /// The asset's name.
    pub name: String,
    /// Its category; empty where it has none.
    pub category: String,
    /// A value for each of [`Findings::singles_of`]; NaN where it is undefined, as for an asset that failed.
    pub values: Vec<f64>,
}

/// Published numbers that belong beside the totals.
#[derive(Clone, Copy, Debug)]
pub struct Beside {
    /// The published table.
    pub table: &'static str,
    /// Names of [`Findings::totals_of`], of the table's metrics, and what a printed number is to be multiplied by.
    pub columns: &'static [(&'static str, &'static str, f64)],
}

/// What an evaluation found about one thing, such as skin weights.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// What it is about.
    pub about: String,
    /// What totals are over, where that is not assets: several rigs of each, say.
    pub over: Option<&'static str>,
    /// The columns of totals.
    pub totals_of: Vec<Metric>,
    /// Methods over splits.
    pub totals: Vec<Total>,
    /// The columns of single assets.
    pub singles_of: Vec<Metric>,
    /// Single assets.
    pub singles: Vec<Single>,
    /// Published numbers.
    pub published: Vec<Beside>,
}

impl Findings {
    /// The splits, in the order of the totals.
    pub fn splits(&self) -> Vec<&str> {
        let mut out: Vec<&str> = Vec::new();
        let all = self.totals.iter().map(|t| &t.split).chain(self.singles.iter().map(|s| &s.split));
        for split in all {
            if !out.contains(&split.as_str()) {
                out.push(split);
            }
        }
        out
    }

    /// Without those figures of single assets that are other quantities where these settings are others.
    pub(crate) fn comparable(&self, differ: &BTreeSet<String>) -> Self {
        let kept: Vec<bool> = self.singles_of.iter().map(|m| m.among(differ).is_empty()).collect();
        let mut own = self.clone();
        let mut keep = kept.iter();
        own.singles_of.retain(|_| keep.next() == Some(&true));
        for single in &mut own.singles {
            let mut keep = kept.iter();
            single.values.retain(|_| keep.next() == Some(&true));
        }
        own
    }

    /// A row a split and a category in it: means over assets with their intervals. `None` without assets.
    pub fn spread(&self) -> Option<Table> {
        if self.singles.is_empty() {
            return None;
        }
        let mut head = vec!["split".to_owned(), "category".into(), "assets".into(), "undefined".into()];
        for m in &self.singles_of {
            let name = per_rig(m);
            head.extend([format!("{name} from"), format!("{name} to")]);
            head.insert(head.len() - 2, name);
        }
        let caption = format!("{}: mean over assets, {}", self.about, conventions(&self.singles_of));
        let mut table = Table { caption, head, ..Table::default() };
        for split in self.splits() {
            let own: Vec<&Single> = self.singles.iter().filter(|s| s.split == split).collect();
            if own.is_empty() {
                continue;
            }
            if !table.rows.is_empty() {
                table.line();
            }
            table.row(self.means(split, "all", &own));
            for (category, of) in by_category(&own) {
                table.row(self.means(split, category, &of));
            }
        }
        table.note = format!(
            "{PER_RIG}{} from, to: 95 % bootstrap interval of the mean, over assets. \
                      undefined: assets whose first metric is undefined, such as failures; the mean is without them.",
            self.pooled()
        );
        Some(table)
    }

    /// What is said where totals have figures of nearly the same name over all pairs of a split.
    fn pooled(&self) -> String {
        let has = |m: &&Metric| self.totals_of.iter().any(|other| other.name == format!("{} per rig", m.name));
        let names: Vec<&str> = self.totals_of.iter().filter(has).map(|m| m.name.as_str()).collect();
        if names.is_empty() {
            return String::new();
        }
        let are = if names.len() == 1 { "is a different metric" } else { "are different metrics" };
        let names = names.join(" and ");
        format!(
            " {names} without `per rig` {are}, over all vertex-bone pairs of a split, so that large assets count more."
        )
    }

    fn means(&self, split: &str, category: &str, of: &[&Single]) -> Vec<Cell> {
        let means: Vec<Mean> =
            (0..self.singles_of.len()).map(|k| Mean::of(&of.iter().map(|s| s.values[k]).collect::<Vec<_>>())).collect();
        let undefined = means.first().map_or(0, |m| m.undefined);
        let mut cells = vec![Cell::text(split), Cell::text(category), Cell::count(of.len()), Cell::count(undefined)];
        for (m, metric) in means.iter().zip(&self.singles_of) {
            cells.extend([m.mean, m.low, m.high].map(|v| Cell::number(v, metric.digits)));
        }
        cells
    }

    /// What others published, in those columns of the totals that anyone published. `None` where there is nothing.
    pub fn published_table(&self) -> Option<Table> {
        self.published_in(&self.totals_of)
    }

    /// The same in some of these columns. Lines that have none of them are left out.
    pub(crate) fn published_in(&self, metrics: &[Metric]) -> Option<Table> {
        let mut head = vec!["published".to_owned()];
        head.extend(metrics.iter().map(|m| m.name.clone()));
        let mut table = Table { caption: format!("{}: published numbers", self.about), head, ..Table::default() };
        for beside in &self.published {
            for line in lines(beside.table) {
                let cell = |m: &Metric| {
                    let found = beside.columns.iter().find(|(own, ..)| *own == m.name);
                    found.map_or(Cell { published: true, ..Cell::none() }, |(_, name, factor)| line.cell(name, *factor))
                };
                let cells: Vec<Cell> = metrics.iter().map(cell).collect();
                if cells.iter().any(|c| !c.text.is_empty()) {
                    say(&mut table.note, &line);
                    table.row(std::iter::once(Cell::text(line.name())).chain(cells).collect());
                }
            }
        }
        table.note = format!("{PUBLISHED}{}", table.note);
        (!table.rows.is_empty()).then(|| table.without_empty_columns())
    }

    /// Spread, categories and published numbers, for the report of one run.
    pub fn blocks(&self) -> Vec<Block> {
        [self.spread(), self.published_table()].into_iter().flatten().map(Block::Table).collect()
    }
}

/// What is said below published numbers.
const PUBLISHED: &str = "Published numbers are as printed, but in the column's unit. Others measured them, \
                                    on other assets and with other amounts of training; no test here uses them.";

/// Adds what has to be known of a published line to what is said below a table, once.
fn say(note: &mut String, line: &Line) {
    if let Some((_, sentence)) = line.caveat.as_ref().filter(|(_, sentence)| !note.contains(sentence)) {
        *note += &format!(" {sentence}");
    }
}

/// What a metric is called where it is the mean of the assets' own figures. Totals of the same name may be pooled over
/// all assets, which is another number.
pub(crate) fn per_rig(metric: &Metric) -> String {
    if metric.name.ends_with("per rig") { metric.name.clone() } else { format!("{} per rig", metric.name) }
}

/// Whether a column of totals is of a metric of single assets: it has the metric's name, or that of the assets' mean where
/// the metric's own is that of what is pooled.
pub(crate) fn is_total_of(total: &Metric, single: &Metric) -> bool {
    total.convention == single.convention && (total.name == single.name || total.name == per_rig(single))
}

/// What is said below means of assets.
const PER_RIG: &str = "per rig: the mean of each asset's own figure.";

/// Assets by category, the largest first; nothing where all have the same.
fn by_category<'a>(of: &[&'a Single]) -> Vec<(&'a str, Vec<&'a Single>)> {
    let mut groups: BTreeMap<&str, Vec<&Single>> = BTreeMap::new();
    for single in of {
        let name = if single.category.is_empty() { "without" } else { single.category.as_str() };
        groups.entry(name).or_default().push(single);
    }
    if groups.len() < 2 {
        return Vec::new();
    }
    let mut groups: Vec<_> = groups.into_iter().collect();
    groups.sort_by_key(|(_, of)| std::cmp::Reverse(of.len()));
    groups
}

/// The names of the metrics' conventions.
pub(crate) fn conventions(metrics: &[Metric]) -> String {
    let mut names: Vec<&str> = Vec::new();
    for m in metrics {
        if !names.contains(&m.convention.as_str()) {
            names.push(&m.convention);
        }
    }
    format!("convention {}", names.join(", "))
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// Findings of eight assets whose IoU is moved by `shift`; the last one failed.
    pub(crate) fn findings(shift: f64) -> Findings {
        let single = |k: usize| Single {
            split: if k < 5 { "test_seen" } else { "test_new" }.into(),
            name: format!("asset {k}"),
            category: if k.is_multiple_of(2) { "fish" } else { "bird" }.into(),
            values: vec![if k == 7 { f64::NAN } else { 0.5 + 0.02 * k as f64 + shift }],
        };
        let total = |split: &str, own: bool, iou: f64| Total {
            split: split.into(),
            method: if own { "rule" } else { "nearest bone" }.into(),
            own,
            assets: if split == "test_seen" { 5 } else { 3 },
            values: vec![iou, 0.01],
        };
        Findings {
            about: "skin weights".into(),
            over: None,
            totals_of: vec![Metric::higher("IoU", "skintokens", 4), Metric::lower("L1", "skintokens", 5)],
            totals: vec![
                total("test_seen", true, 0.7 + shift),
                total("test_seen", false, 0.6),
                total("test_new", true, 0.65 + shift),
                total("test_new", false, 0.55),
            ],
            singles_of: vec![Metric::higher("IoU", "skintokens", 4)],
            singles: (0..8).map(single).collect(),
            published: vec![Beside { table: "skintokens.table5", columns: &[("IoU", "iou", 0.01), ("L1", "l1", 1.0)] }],
        }
    }

    #[test]
    fn spread_counts_failures_and_has_rows_by_split_and_category() {
        let table = findings(0.0).spread().unwrap();
        let row = |k: usize| table.rows[k].iter().map(|c| c.text.clone()).collect::<Vec<_>>();
        assert_eq!(table.head[4..], ["IoU per rig", "IoU per rig from", "IoU per rig to"]);
        // The totals' column `IoU` is this one or another: as long as there are not both, it is not said.
        assert!(table.note.starts_with("per rig: the mean of each asset's own figure. from, to:"), "{}", table.note);
        let mut both = findings(0.0);
        both.totals_of[1].name = "IoU per rig".into();
        assert!(both.spread().unwrap().note.contains("figure. IoU without `per rig` is a different metric, over all"));
        assert_eq!(row(0)[..5], ["test_seen", "all", "5", "0", "0.5400"]);
        assert_eq!(row(1)[..5], ["test_seen", "fish", "3", "0", "0.5400"]);
        assert_eq!(row(3)[..5], ["test_new", "all", "3", "1", "0.6100"]);
        let [low, high] = [5, 6].map(|k| table.rows[0][k].text.parse::<f64>().unwrap());
        assert!(low < 0.54 && high > 0.54 && low >= 0.5 && high <= 0.58);
        assert_eq!(table.breaks, [3]);
        assert!(Findings::default().spread().is_none() && Findings::default().published_table().is_none());
    }

    #[test]
    fn published_numbers_come_in_the_unit_of_the_column() {
        let table = findings(0.0).published_table().unwrap();
        let row = table.rows.iter().find(|r| r[0].text.contains("FSQ-CVAE (SkinTokens paper), VRoid")).unwrap();
        assert_eq!([&row[1].text, &row[2].text], ["0.871", "0.00541"]);
        assert!(row[1].published && row[2].published && row[0].text.starts_with("published"));
        // What nobody published is no column.
        let mut more = findings(0.0);
        more.totals_of.insert(0, Metric::higher("valid %", "skintokens", 1));
        assert_eq!(more.published_table().unwrap().head, ["published", "IoU", "L1"]);
    }

    #[test]
    fn a_published_row_that_misleads_says_so_in_every_form() {
        let beside = Beside { table: "skintokens.table3", columns: &[("J2J × 100", "j2j", 1.0)] };
        let totals_of = vec![Metric::lower("J2J × 100", "skintokens", 3)];
        let found = Findings { about: "skeletons".into(), totals_of, published: vec![beside], ..Findings::default() };
        let table = found.published_table().unwrap();
        let swapped = "the row of MagicArticulate has its two data sets swapped";
        assert_eq!(table.note.matches(swapped).count(), 1, "{}", table.note);
        let (title, subtitle, blocks) = ("t".into(), "s".into(), vec![Block::Table(table)]);
        let page = crate::Page { kind: crate::PageKind::Report, title, subtitle, blocks };
        for form in [page.to_html().unwrap(), page.to_markdown(), page.to_latex()] {
            assert!(form.contains(swapped), "{form}");
        }
        assert_eq!(page.to_csv().matches("MagicArticulate").count(), 2);
        assert_eq!(page.to_csv().matches("data sets swapped").count(), 2, "{}", page.to_csv());
    }

    #[test]
    fn the_best_is_by_the_metric_and_never_undefined() {
        let values = [f64::NAN, 2.0, 1.0, 2.0];
        assert_eq!(Metric::higher("x", "c", 1).best(&values), [false, true, false, true], "equals are alike");
        assert_eq!(Metric::lower("x", "c", 1).best(&values), [false, false, true, false]);
        assert_eq!(Metric::lower("x", "c", 1).best(&[f64::NAN]), [false]);
        assert_eq!(Metric::lower("x", "c", 1).best(&[f64::NAN, 1.0]), [false, false], "the only one is not the best");
        assert_eq!(Metric::traded("x", "c", 1).best(&[1.0, 2.0]), [false, false], "none is by one side of a trade-off");
        // What a reader cannot tell apart.
        assert_eq!(Metric::higher("x", "c", 1).best(&[2.04, 2.01, 1.9]), [true, true, false]);
    }
}
