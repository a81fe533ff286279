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

/// A published table by its name, every cell marked as published.
pub fn table(name: &str) -> Option<Table> {
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
    let mut table = Table { caption: format!("Published: {name}. {}", text("what")), head, ..Table::default() };
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
    fn numbers_are_as_printed() {
        let table = table("skintokens.table3").unwrap();
        let row = table.rows.iter().find(|r| r[0].text == "tokenrig_4").unwrap();
        assert_eq!(row[1..4].iter().map(|c| c.text.as_str()).collect::<Vec<_>>(), ["2.857", "2.025", "1.568"]);
    }
}
