//! Numbers that others published, to be shown beside measured ones and marked as published.

use std::sync::LazyLock;

use toml::{Table as Toml, Value};

use crate::{Cell, Table};

/// As printed in the two papers and in two peers' READMEs.
static TABLES: LazyLock<Toml> = LazyLock::new(|| include_str!("published.toml").parse().expect("the file is TOML"));

/// The tables that there are, such as `skintokens.table3`.
pub fn names() -> Vec<String> {
    let below = |(group, tables): (&String, &Value)| {
        let tables = tables.as_table().into_iter().flat_map(Toml::keys);
        tables.map(|table| format!("{group}.{table}")).collect::<Vec<_>>()
    };
    TABLES.iter().flat_map(below).collect()
}

/// A published table by its name, every cell marked as published. Distances between skeletons are × 100 in all tables,
/// as in those of measured ones, with as many digits as were printed.
pub fn table(name: &str) -> Option<Table> {
    let mut table = read(name)?;
    let share =
        |key: &str| name.split_once('.').and_then(|(group, own)| TABLES.get(group)?.get(own)?.get(key)?.as_bool());
    if share("share") == Some(true) {
        for (k, _) in table.head.iter().enumerate().skip(1).filter(|(_, column)| is_distance(&place(name, column).1)) {
            table.rows.iter_mut().for_each(|row| row[k].text = times_100(&row[k].text));
        }
        table.note = format!("Distances × 100; printed with the {}", table.note);
    }
    table.head.iter_mut().skip(1).for_each(|column| *column = headed(name, column));
    Some(table)
}

/// Whether a metric is a distance between skeletons.
fn is_distance(metric: &str) -> bool {
    matches!(metric, "j2j" | "j2b" | "b2b")
}

/// A number as printed, times 100: its point two places on.
fn times_100(printed: &str) -> String {
    let digits = printed.split_once('.').map_or(0, |(_, d)| d.len());
    printed
        .parse::<f64>()
        .map_or_else(|_| printed.to_owned(), |v| format!("{:.*}", digits.saturating_sub(2), 100.0 * v))
}

/// What stands above a column.
fn headed(table: &str, column: &str) -> String {
    let (data, metric) = place(table, column);
    let metric = match metric.as_str() {
        own if is_distance(own) => format!("{} × 100", own.to_uppercase()),
        "l1" => "L1".into(),
        "l1_var" => "L1 variance".into(),
        "iou" => "IoU".into(),
        // The table is called after it.
        "skin_l1" => "L1".into(),
        other => other.replace('_', " "),
    };
    format!("{data} {metric}").trim().into()
}

/// A published table with its columns as they are named in the file.
fn read(name: &str) -> Option<Table> {
    let (group, own) = name.split_once('.')?;
    let from = TABLES.get(group)?.get(own)?;
    let rows = from.get("rows")?.as_table()?;
    let text = |key: &str| from.get(key).and_then(Value::as_str).unwrap_or_default();
    let columns = from.get("columns").and_then(Value::as_array);
    let mut head = vec!["published".to_owned()];
    match columns {
        Some(columns) => head.extend(columns.iter().filter_map(Value::as_str).map(String::from)),
        None => head.push("value".into()),
    }
    let said = caveats(from).map(|(_, _, sentence)| format!(" {sentence}")).collect::<String>();
    let mut table = Table { caption: format!("Published: {name}. {}{said}", text("what")), head, ..Table::default() };
    for (row, values) in rows {
        let values = values.as_array().cloned().unwrap_or_else(|| vec![values.clone()]);
        let cells = values.iter().map(|v| Cell { published: true, ..number(v) });
        table.row(std::iter::once(Cell::text(row)).chain(cells).collect());
    }
    if !text("unit").is_empty() {
        table.note = format!("unit: {}", text("unit"));
    }
    Some(table)
}

/// What has to be known of rows to read them right: the row, a few words, a sentence.
fn caveats(table: &Value) -> impl Iterator<Item = (&str, &str, &str)> {
    let rows = table.get("caveats").and_then(Value::as_table).into_iter().flatten();
    rows.filter_map(|(row, said)| Some((row.as_str(), said.get(0)?.as_str()?, said.get(1)?.as_str()?)))
}

/// What a published system reached on a data set.
#[derive(Clone, Debug, PartialEq)]
pub struct Line {
    /// The table it is of, such as `skintokens.table3`.
    pub table: String,
    /// The system, and who measured it.
    pub system: String,
    /// The data set; empty where the table has one alone.
    pub data: String,
    /// Its numbers by metric, as printed.
    pub values: Vec<(String, f64)>,
    /// What has to be known to read them right, in a few words and as a sentence.
    pub caveat: Option<(String, String)>,
}

impl Line {
    /// A metric's cell in another unit: what was printed, times a power of ten, with as many digits as were printed;
    /// empty where the table does not have it.
    pub fn cell(&self, metric: &str, factor: f64) -> Cell {
        let Some((_, value)) = self.values.iter().find(|(name, _)| name == metric) else {
            return Cell { published: true, ..Cell::none() };
        };
        let printed = value.to_string();
        let digits = printed.split_once('.').map_or(0, |(_, d)| d.len()) as i32 - factor.log10().round() as i32;
        Cell { published: true, ..Cell::number(value * factor, digits.max(0) as usize) }
    }

    /// What stands before its numbers.
    pub fn name(&self) -> String {
        let on = if self.data.is_empty() { String::new() } else { format!(", {}", self.data) };
        // Beside the name, as a note below is no part of comma-separated values.
        let caveat = self.caveat.as_ref().map_or(String::new(), |(short, _)| format!("; {short}"));
        format!("published: {}{on} ({}{caveat})", self.system, self.table)
    }
}

/// The data sets that columns name, as `mr_j2j` or `vroid_aug` do.
const DATA: [(&str, &str); 8] = [
    ("mr", "ModelsResource"),
    ("art", "Articulation-XL 2.0"),
    ("vroid", "VRoid"),
    ("mixamo", "Mixamo"),
    ("rigxl", "Rig-XL"),
    ("vroid_aug", "VRoid augmented"),
    ("mixamo_aug", "Mixamo augmented"),
    ("rigxl_aug", "Rig-XL augmented"),
];

/// The data set and the metric of a table's column; without a data set, an empty one.
fn place(table: &str, column: &str) -> (String, String) {
    let data = |key: &str| DATA.iter().find(|(k, _)| *k == key).map(|(_, name)| (*name).to_owned());
    let split = column.split_once('_').and_then(|(first, metric)| Some((data(first)?, metric.to_owned())));
    match data(column) {
        Some(data) => (data, table.rsplit('.').next().unwrap_or(table).to_owned()),
        None => split.unwrap_or_else(|| (String::new(), column.to_owned())),
    }
}

/// A published table by system and data set: columns such as `mr_j2j` are a data set's metric, columns that are data
/// sets have the metric that the table is called after. Empty where there is no such table.
pub fn lines(name: &str) -> Vec<Line> {
    let Some(table) = read(name) else { return Vec::new() };
    let from = name.split_once('.').and_then(|(group, own)| TABLES.get(group)?.get(own));
    let caveat_of = |system: &str| {
        let (_, short, sentence) = caveats(from?).find(|(row, ..)| *row == system)?;
        Some((short.to_owned(), sentence.to_owned()))
    };
    let mut out: Vec<Line> = Vec::new();
    for row in &table.rows {
        let start = out.len();
        for (column, cell) in table.head.iter().zip(row).skip(1) {
            let (data, metric) = place(name, column);
            let Ok(value) = cell.text.parse::<f64>() else { continue };
            match out[start..].iter_mut().find(|l| l.data == data) {
                Some(line) => line.values.push((metric, value)),
                None => {
                    let (table, system) = (name.to_owned(), row[0].text.clone());
                    let caveat = caveat_of(&system);
                    out.push(Line { table, system, data, values: vec![(metric, value)], caveat });
                }
            }
        }
    }
    out
}

/// With the digits that were printed, or nearly so.
fn number(value: &Value) -> Cell {
    let shown = match value {
        Value::Float(x) if !x.is_finite() => "–".to_owned(),
        Value::Float(x) => x.to_string(),
        other => other.to_string(),
    };
    Cell::none().with_text(shown)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_table_has_as_many_values_as_columns() {
        let names = names();
        assert!(names.len() >= 10, "{names:?}");
        for name in names {
            let table = table(&name).unwrap_or_else(|| panic!("{name}"));
            assert!(!table.rows.is_empty(), "{name}");
            for row in &table.rows {
                assert_eq!(row.len(), table.head.len(), "{name} {}", row[0].text);
                assert!(row[1..].iter().all(|c| c.published && c.number));
            }
        }
        assert!(table("skintokens.table99").is_none() && table("x").is_none());
    }

    #[test]
    fn lines_are_by_system_and_data_set() {
        let of = |name: &str, system: &str, data: &str| {
            lines(name).into_iter().find(|l| l.system == system && l.data == data).unwrap_or_else(|| panic!("{name}"))
        };
        let full = of("skintokens.table5", "FSQ-CVAE (SkinTokens paper)", "ModelsResource");
        assert_eq!(full.values, [("l1".to_owned(), 0.0138), ("iou".into(), 91.1), ("mask".into(), 83.9)]);
        // As many digits as were printed, in the unit asked for.
        assert_eq!(full.cell("iou", 0.01).text, "0.911");
        assert_eq!((full.cell("j2j", 1.0).text.as_str(), full.cell("j2j", 1.0).published), ("", true));
        let unirig = of("unirig.j2j", "UniRig (its paper)", "VRoid augmented");
        assert_eq!(unirig.values, [("j2j".to_owned(), 0.0101)]);
        assert_eq!(unirig.cell("j2j", 100.0).text, "1.01");
        assert_eq!(unirig.name(), "published: UniRig (its paper), VRoid augmented (unirig.j2j)");
        // What was not reported is no number.
        assert!(
            !lines("unirig.j2j").iter().any(|l| l.system.starts_with("Neural Blend") && l.data == "Rig-XL augmented")
        );
        assert_eq!(of("skintokens.table2", "8-8-8-8-8", "").values.len(), 3);
        assert!(lines("nowhere").is_empty());
    }

    #[test]
    fn caveats_are_of_rows_that_there_are_and_stand_in_their_names() {
        for name in names() {
            let (group, own) = name.split_once('.').unwrap();
            let rows = read(&name).unwrap().rows;
            for (row, ..) in caveats(&TABLES[group][own]) {
                assert!(rows.iter().any(|r| r[0].text == row), "{name}: {row}");
            }
        }
        let own = lines("skintokens.table3").into_iter().filter(|l| l.caveat.is_some()).map(|l| l.name());
        let swapped = ["ModelsResource", "Articulation-XL 2.0"].map(|data| {
            format!("published: MagicArticulate (SkinTokens paper), {data} (skintokens.table3; data sets swapped)")
        });
        assert_eq!(own.collect::<Vec<_>>(), swapped);
        assert!(table("skintokens.table3").unwrap().caption.contains("has its two data sets swapped: its authors'"));
    }

    #[test]
    fn numbers_are_as_printed() {
        let table = table("skintokens.table3").unwrap();
        let row = table.rows.iter().find(|r| r[0].text.starts_with("TokenRig, 4 tokens a bone (")).unwrap();
        assert_eq!(row[1..4].iter().map(|c| c.text.as_str()).collect::<Vec<_>>(), ["2.857", "2.025", "1.568"]);
        assert_eq!(table.head[..3], ["published", "ModelsResource J2J × 100", "ModelsResource J2B × 100"]);
    }

    #[test]
    fn distances_are_in_one_unit() {
        let table = table("unirig.j2j").unwrap();
        let row = table.rows.iter().find(|r| r[0].text == "UniRig (its paper)").unwrap();
        assert_eq!((table.head[1].as_str(), row[1].text.as_str()), ("Mixamo J2J × 100", "1.01"));
        assert_eq!(row[5].text, "5.49");
        assert!(table.note.starts_with("Distances × 100; printed with the unit: fraction"), "{}", table.note);
        let undefined = table.rows.iter().find(|r| r[0].text.starts_with("Neural Blend")).unwrap();
        assert_eq!(undefined[5].text, "–");
        // Weights are no distances.
        assert_eq!(super::table("unirig.skin_l1").unwrap().rows[0][1].text, "0.07898");
        assert_eq!(times_100("7"), "700");
    }

    #[test]
    fn names_and_notes_can_be_read_without_the_papers_or_other_files() {
        for name in names() {
            let table = table(&name).unwrap();
            assert!(!table.caption.contains(".md"), "{name}: {}", table.caption);
            for row in &table.rows {
                let text = &row[0].text;
                let short = ["ours", "full", "nbs"].contains(&text.as_str()) || text.contains('_');
                assert!(!short, "{name}: `{text}` does not say whose it is");
            }
        }
    }
}
