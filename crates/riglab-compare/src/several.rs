//! Tables of three systems and more, which stay as narrow as a terminal: a column a system.

use riglab_metric::Preset;
use riglab_report::{Cell, Table};

use crate::Comparison;
use crate::tables::{EQUAL, Line, number};

impl Line {
    /// What is said of the last column of [`Comparison::means_of`].
    pub const COUNTS: &str = "n: assets that the means are of, where systems differ from the fewest to the most";

    /// How many assets its means are of, those that there are.
    fn counts(&self) -> Cell {
        let of = || self.means.iter().map(|m| m.n).filter(|n| *n > 0);
        match (of().min().unwrap_or(0), of().max().unwrap_or(0)) {
            (least, most) if least == most => Cell::count(most),
            (least, most) => Cell::none().with_text(format!("{least} .. {most}")),
        }
    }
}

impl Comparison {
    /// The means of a preset.
    pub(crate) fn means_of(&self, preset: Preset, lines: &[&Line]) -> Table {
        let systems = self.systems.iter().map(|system| system.name.clone());
        let head = [format!("metric @{}", preset.name()), "better".into()].into_iter().chain(systems);
        let (caption, head) = (format!("Convention {}", preset.name()), head.chain(["n".into()]).collect());
        let mut table = Table { caption, head, ..Table::default() };
        for line in lines {
            let means = line.means.iter().zip(&line.best).map(|(m, best)| number(m.mean).strong_if(*best));
            table.row(line.named().into_iter().chain(means).chain([line.counts()]).collect());
        }
        table
    }

    /// The intervals of these means.
    pub(crate) fn intervals_of(&self, preset: Preset, lines: &[&Line]) -> Table {
        let systems = self.systems.iter().map(|system| system.name.clone());
        let head = std::iter::once(format!("metric @{}", preset.name())).chain(systems).collect();
        let caption = format!("Convention {}, 95 % intervals of the means", preset.name());
        let mut table = Table { caption, head, ..Table::default() };
        for line in lines {
            let [name, _] = line.named();
            let intervals = line.means.iter().map(|m| match m.low.is_finite() {
                true => Cell::none().with_text(format!("{} .. {}", short(m.low), short(m.high))),
                false => number(f64::NAN),
            });
            table.row(std::iter::once(name).chain(intervals).collect());
        }
        table
    }
}

/// A bound of an interval, with a digit less than means have.
fn short(value: f64) -> String {
    match value.abs() {
        a if a < EQUAL => "0".into(),
        a if a < 1e-3 => format!("{value:.0e}"),
        a if a < 1.0 => format!("{value:.3}"),
        a if a < 10.0 => format!("{value:.2}"),
        a if a < 100.0 => format!("{value:.1}"),
        _ => format!("{value:.0}"),
    }
}

#[cfg(test)]
mod tests {
    use riglab_metric::Measure;

    use super::*;
    use crate::unit::SAID;
    use crate::{Failures, Row, Status, System};

    fn system(name: &str, values: &[f64]) -> System {
        let row = |(k, value): (usize, &f64)| Row {
            asset: format!("a{k}"),
            status: if value.is_finite() { Status::Scored } else { Status::Missing },
            joints: 3,
            true_joints: 3,
            without_weights: String::new(),
            notes: Vec::new(),
            measures: [Preset::Rignet, Preset::Unirig]
                .into_iter()
                .flat_map(|preset| ["j2j", "iou"].map(|metric| Measure { metric, preset, value: *value }))
                .collect(),
        };
        let rows = values.iter().enumerate().map(row).collect();
        let (name, folder) = (name.into(), name.into());
        System { name, folder, baseline: false, rows, unmatched: Vec::new(), unread: Vec::new() }
    }

    fn of(systems: Vec<System>) -> Comparison {
        Comparison { truth: "t".into(), failures: Failures::Apart, unread_truth: Vec::new(), systems }
    }

    fn texts(table: &Table, row: usize) -> Vec<&str> {
        table.rows[row].iter().map(|cell| cell.text.as_str()).collect()
    }

    #[test]
    fn each_system_has_a_column_of_means_and_one_of_intervals() {
        let all = of(vec![system("one", &[0.1, 0.2]), system("two", &[0.3, 0.3]), system("three", &[0.125, f64::NAN])]);
        let tables = all.summary(&[Preset::Rignet]).tables();
        let [means, intervals] = &tables[..] else { panic!("{tables:?}") };
        assert_eq!(means.head, ["metric @rignet", "better", "one", "two", "three", "n"]);
        assert_eq!(texts(means, 0), ["j2j × 100", "lower", "15.00", "30.00", "12.50", "1 .. 2"]);
        assert_eq!(intervals.head, ["metric @rignet", "one", "two", "three"]);
        let bounds = texts(intervals, 0);
        assert_eq!((bounds[0], bounds[2]), ("j2j × 100", "30.0 .. 30.0"));
        assert!(bounds[1].starts_with("10.0 .. 20"), "{bounds:?}");
        assert!(means.note.ends_with(Line::COUNTS) && intervals.note.is_empty());
        let same = of(vec![system("one", &[0.1]), system("two", &[0.3]), system("three", &[0.2])]);
        let means = same.summary(&[Preset::Rignet]).tables().remove(0);
        assert_eq!(texts(&means, 1)[5], "1");
        let none = of(vec![system("one", &[0.1]), system("two", &[0.3]), system("none", &[f64::NAN])]);
        assert_eq!(texts(&none.summary(&[Preset::Rignet]).tables()[0], 0)[4..], ["–", "1"]);
        assert_eq!(means.rows[1].iter().map(|cell| cell.strong).collect::<Vec<_>>()[2..5], [false, true, false]);
    }

    #[test]
    fn tables_of_six_systems_fit_a_terminal() {
        let systems = ["rignet", "unirig", "puppeteer", "anymate", "skintokens", "ours"];
        let all = of(systems.map(|name| system(name, &[0.0123, 0.9876, 0.00012])).to_vec());
        for table in all.summary(&Preset::ALL).tables() {
            let text = table.to_text();
            // Notes are sentences, which a terminal breaks.
            let rows = text.lines().filter(|line| !line.trim_start().starts_with(&table.note) || table.note.is_empty());
            let widest = rows.map(|line| line.chars().count()).max().unwrap_or(0);
            assert!(widest <= 120, "{widest}: {text}");
        }
    }

    #[test]
    fn the_unit_of_distances_is_said_once() {
        for count in 1..=3 {
            let all = of((0..count).map(|k| system(&format!("s{k}"), &[0.1])).collect());
            let said = all.summary(&Preset::ALL).tables().iter().filter(|table| table.note.contains(SAID)).count();
            assert_eq!(said, 1, "{count} systems");
        }
    }

    #[test]
    fn bounds_have_three_digits_that_count() {
        assert_eq!(
            [0.0, -3.83e-17, 4.83e-5, 0.15, 2.857, 12.3456, 512.34].map(short),
            ["0", "0", "5e-5", "0.150", "2.86", "12.3", "512"]
        );
    }
}
