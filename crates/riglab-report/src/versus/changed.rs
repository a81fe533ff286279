//! Which assets became worse and which better against the first run: those that changed most for a reader, all of them
//! for a spreadsheet.

use std::cmp::Ordering;
use std::collections::BTreeMap;

use super::by_asset::{Key, keyed};
use super::{Compared, shared};
use crate::findings::{conventions, per_rig};
use crate::{Cell, Findings, Metric, Single, Table};

/// Assets shown in each direction.
const SHOWN: usize = 10;

/// One asset under a metric in the first run and in another.
struct Pair<'a> {
    key: Key<'a>,
    single: &'a Single,
    first: f64,
    run: f64,
}

/// What became of an asset.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Change {
    Worse,
    Equal,
    Better,
    Undefined,
}

impl Change {
    fn name(self) -> &'static str {
        match self {
            Self::Worse => "worse",
            Self::Equal => "equal",
            Self::Better => "better",
            Self::Undefined => "undefined",
        }
    }
}

impl Pair<'_> {
    /// An asset that has a figure in one run alone failed in the other.
    fn change(&self, metric: &Metric) -> Change {
        let order = match (self.first.is_finite(), self.run.is_finite()) {
            (false, false) => return Change::Undefined,
            (true, false) => return Change::Worse,
            (false, true) => return Change::Better,
            (true, true) => self.run.total_cmp(&self.first),
        };
        match if metric.higher { order } else { order.reverse() } {
            Ordering::Less => Change::Worse,
            Ordering::Equal => Change::Equal,
            Ordering::Greater => Change::Better,
        }
    }

    /// How far apart; a failure is further than any figure.
    fn apart(&self) -> f64 {
        let apart = (self.run - self.first).abs();
        if apart.is_finite() { apart } else { f64::INFINITY }
    }

    fn name(&self) -> String {
        let (_, name, before) = self.key;
        if before == 0 { name.into() } else { format!("{name} ({})", before + 1) }
    }
}

fn pairs<'a>(first: &'a Findings, run: &Findings, places: (usize, usize)) -> Vec<Pair<'a>> {
    let theirs: BTreeMap<Key, f64> = keyed(run).into_iter().map(|(key, s)| (key, s.values[places.1])).collect();
    let pair = |(key, single): (Key<'a>, &'a Single)| {
        let run = *theirs.get(&key)?;
        Some(Pair { key, single, first: single.values[places.0], run })
    };
    keyed(first).into_iter().filter_map(pair).collect()
}

/// The assets that changed most against the first run by the first metric, in both directions. `None` where nothing is
/// known by asset, or nothing changed.
pub(super) fn most(runs: &[Compared], of: &[&Findings]) -> Option<Table> {
    let (metric, at) = shared(of, |f| &f.singles_of).into_iter().next()?;
    let first = &runs[0].name;
    let head = ["run", "change", "split", "asset", "category", first, "the run", "difference"];
    let (about, name) = (&of[0].about, per_rig(&metric));
    let by = conventions(std::slice::from_ref(&metric));
    let caption = format!("{about}: assets that changed most against {first}, by {name}, {by}");
    let mut table = Table::new(caption, &head);
    for k in 1..runs.len() {
        let mut pairs = pairs(of[0], of[k], (at[0], at[k]));
        // Of equals the first by name.
        pairs.sort_by(|a, b| b.apart().total_cmp(&a.apart()).then(a.key.cmp(&b.key)));
        for change in [Change::Worse, Change::Better] {
            // A change that no digit shows is none to a reader.
            let seen = |p: &Pair| p.apart() >= 0.5 * 10f64.powi(-(metric.digits as i32));
            let of_change = pairs.iter().filter(|p| p.change(&metric) == change && seen(p));
            for (n, pair) in of_change.take(SHOWN).enumerate() {
                if n == 0 && !table.rows.is_empty() {
                    table.line();
                }
                let digits = metric.digits;
                let apart = pair.run - pair.first;
                table.row(vec![
                    Cell::text(&runs[k].name),
                    Cell::text(change.name()),
                    Cell::text(&pair.single.split),
                    Cell::text(pair.name()),
                    Cell::text(&pair.single.category),
                    Cell::number(pair.first, digits),
                    Cell::number(pair.run, digits),
                    Cell::difference(apart, digits),
                ]);
            }
        }
    }
    table.note = format!(
        "At most {SHOWN} in each direction, the largest change first; –: no value, such as a failure, which ranks \
         before any change. NAME.assets.csv, which `riglab report` writes beside NAME.csv, has all assets under all \
         metrics."
    );
    (!table.rows.is_empty()).then_some(table)
}

/// Every asset of every run but the first under every metric, a row each, with all digits.
pub(super) fn all(runs: &[Compared], about: &[Vec<&Findings>]) -> Option<Table> {
    let head = [
        "about",
        "metric",
        "convention",
        "better",
        "first run",
        "run",
        "split",
        "asset",
        "category",
        "first",
        "value",
        "difference",
        "change",
    ];
    let mut table = Table::new("Every asset against the first run", &head);
    let digits = |v: f64| Cell::none().with_text(if v.is_finite() { v.to_string() } else { "–".into() });
    for of in about {
        for (metric, at) in shared(of, |f| &f.singles_of) {
            for k in 1..runs.len() {
                for pair in pairs(of[0], of[k], (at[0], at[k])) {
                    let better = if metric.higher { "higher" } else { "lower" };
                    let (name, asset) = (per_rig(&metric), pair.name());
                    let metric_of = [&*of[0].about, &name, &metric.convention, better];
                    let asset_of = [&runs[0].name, &*runs[k].name, &pair.single.split, &asset, &pair.single.category];
                    let texts = metric_of.into_iter().chain(asset_of).map(Cell::text);
                    let numbers = [pair.first, pair.run, pair.run - pair.first].map(digits);
                    let change = Cell::text(pair.change(&metric).name());
                    table.row(texts.chain(numbers).chain([change]).collect());
                }
            }
        }
    }
    (!table.rows.is_empty()).then_some(table)
}
