//! Numbers that others published, to be shown beside measured ones and marked as published.

use std::sync::LazyLock;

use toml::de::{DeTable, DeValue};

use crate::{Cell, Table};

/// As printed in the two papers and in two peers' READMEs. Not read as values: those forget that 3.390 has three digits.
static TABLES: LazyLock<DeTable<'static>> =
    LazyLock::new(|| DeTable::parse(include_str!("published.toml")).expect("the file is TOML").into_inner());

/// The tables that there are, such as `skintokens.table3`.
pub fn names() -> Vec<String> {
    let mut out = Vec::new();
    for (group, tables) in TABLES.iter() {
        let tables = tables.get_ref().as_table().into_iter().flatten();
        out.extend(tables.map(|(table, _)| format!("{}.{}", group.get_ref(), table.get_ref())));
    }
    out
}

/// A table as it stands in the file.
fn raw(name: &str) -> Option<&'static DeTable<'static>> {
    let (group, own) = name.split_once('.')?;
    TABLES.get(group)?.get_ref().get(own)?.get_ref().as_table()
}

fn entry(table: &'static DeTable<'static>, key: &str) -> Option<&'static DeValue<'static>> {
    Some(table.get(key)?.get_ref())
}

/// A published table by its name, every cell marked as published. Distances between skeletons are × 100 in all tables,
/// as in those of measured ones, with as many digits as were printed.
pub fn table(name: &str) -> Option<Table> {
    let mut table = read(name)?;
    if entry(raw(name)?, "share").and_then(DeValue::as_bool) == Some(true) {
        for (k, _) in table.head.iter().enumerate().skip(1).filter(|(_, column)| is_distance(&place(name, column).1)) {
            table.rows.iter_mut().for_each(|row| row[k].text = moved(&row[k].text, 2));
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

/// A number as printed with its point some places on, and without an exponent; what is none stays as it is.
fn moved(printed: &str, places: i32) -> String {
    let Some(value) = printed.parse::<f64>().ok().filter(|v| v.is_finite()) else { return printed.to_owned() };
    let (digits, exponent) = printed.split_once(['e', 'E']).unwrap_or((printed, "0"));
    let behind = digits.split_once('.').map_or(0, |(_, d)| d.len() as i32);
    let left = behind - exponent.parse::<i32>().unwrap_or(0) - places;
    format!("{:.*}", left.max(0) as usize, value * 10f64.powi(places))
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
    let from = raw(name)?;
    let rows = entry(from, "rows")?.as_table()?;
    let text = |key: &str| entry(from, key).and_then(DeValue::as_str).unwrap_or_default();
    let columns = entry(from, "columns").and_then(DeValue::as_array);
    let mut head = vec!["published".to_owned()];
    match columns {
        Some(columns) => head.extend(columns.iter().filter_map(|c| c.get_ref().as_str()).map(String::from)),
        None => head.push("value".into()),
    }
    let said = caveats(from).map(|(_, _, sentence)| format!(" {sentence}")).collect::<String>();
    let mut table = Table { caption: format!("Published: {name}. {}{said}", text("what")), head, ..Table::default() };
    for (row, values) in rows {
        let values = match values.get_ref() {
            DeValue::Array(values) => values.iter().map(|v| printed(v.get_ref())).collect(),
            value => vec![printed(value)],
        };
        table.row(std::iter::once(Cell::text(row.get_ref().as_ref())).chain(values).collect());
    }
    if !text("unit").is_empty() {
        table.note = format!("unit: {}", text("unit"));
    }
    Some(table)
}

/// What has to be known of rows to read them right: the row, a few words, a sentence.
fn caveats(table: &'static DeTable<'static>) -> impl Iterator<Item = (&'static str, &'static str, &'static str)> {
    let rows = entry(table, "caveats").and_then(DeValue::as_table).into_iter().flatten();
    rows.filter_map(|(row, said)| {
        let part = |k: usize| said.get_ref().get(k)?.get_ref().as_str();
        Some((row.get_ref().as_ref(), part(0)?, part(1)?))
    })
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
    /// Its numbers by metric, with the digits that were printed.
    pub values: Vec<(String, String)>,
    /// What has to be known to read them right, in a few words and as a sentence.
    pub caveat: Option<(String, String)>,
}

impl Line {
    /// A metric's cell in another unit: what was printed, times a power of ten, with as many digits as were printed;
    /// empty where the table does not have it.
    pub fn cell(&self, metric: &str, factor: f64) -> Cell {
        let found = self.values.iter().find(|(name, _)| name == metric);
        let text = found.map_or(String::new(), |(_, printed)| moved(printed, factor.log10().round() as i32));
        Cell { published: true, ..Cell::none().with_text(text) }
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
    let (Some(table), Some(from)) = (read(name), raw(name)) else { return Vec::new() };
    let caveat_of = |system: &str| {
        let (_, short, sentence) = caveats(from).find(|(row, ..)| *row == system)?;
        Some((short.to_owned(), sentence.to_owned()))
    };
    let mut out: Vec<Line> = Vec::new();
    for row in &table.rows {
        let start = out.len();
        for (column, cell) in table.head.iter().zip(row).skip(1) {
            let (data, metric) = place(name, column);
            // What was not reported is no number.
            if cell.plain().is_empty() {
                continue;
            }
            let value = cell.text.clone();
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

/// A published number with all its digits, zeros at the end included.
fn printed(value: &DeValue) -> Cell {
    let shown = match value {
        DeValue::Float(x) if x.as_str().ends_with("nan") => "–".to_owned(),
        DeValue::Float(x) => moved(x.as_str(), 0),
        DeValue::Integer(x) => x.as_str().to_owned(),
        _ => String::new(),
    };
    Cell { published: true, ..Cell::none().with_text(shown) }
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
        let texts = |line: &Line| line.values.iter().map(|(m, v)| format!("{m} {v}")).collect::<Vec<_>>();
        assert_eq!(texts(&full), ["l1 0.0138", "iou 91.1", "mask 83.9"]);
        // As many digits as were printed, in the unit asked for.
        assert_eq!(full.cell("iou", 0.01).text, "0.911");
        assert_eq!((full.cell("j2j", 1.0).text.as_str(), full.cell("j2j", 1.0).published), ("", true));
        let unirig = of("unirig.j2j", "UniRig (its paper)", "VRoid augmented");
        assert_eq!(texts(&unirig), ["j2j 0.0101"]);
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
            let rows = read(&name).unwrap().rows;
            for (row, ..) in caveats(raw(&name).unwrap()) {
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
        // Zeros at the end are digits, too, whatever the unit.
        let row = table.rows.iter().find(|r| r[0].text.starts_with("UniRig")).unwrap();
        assert_eq!(row[1..4].iter().map(|c| c.text.as_str()).collect::<Vec<_>>(), ["3.390", "2.592", "1.890"]);
        let of = |table: &str, system: &str, data: &str, metric: &str, factor: f64| {
            let line = lines(table).into_iter().find(|l| l.system == system && l.data == data).unwrap();
            line.cell(metric, factor).text
        };
        assert_eq!(of("skintokens.table3", "UniRig (SkinTokens paper)", "ModelsResource", "j2j", 1.0), "3.390");
        assert_eq!(of("skintokens.table3", "UniRig (SkinTokens paper)", "ModelsResource", "j2j", 0.01), "0.03390");
        let full = "FSQ-CVAE (SkinTokens paper)";
        assert_eq!(of("skintokens.table5", full, "Articulation-XL 2.0", "l1", 1.0), "0.0140");
        assert_eq!(of("skintokens.table5", full, "Articulation-XL 2.0", "iou", 0.01), "0.840");
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
        assert_eq!(["7", "1.40e-2", "5e3", "–"].map(|text| moved(text, 2)), ["700", "1.40", "500000", "–"]);
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
