//! What a benchmark tells.

use serde::Serialize;

/// One comparison.
#[derive(Clone, Debug, Serialize)]
pub struct Row {
    /// `case` or `case/part`.
    pub name: String,
    /// riglab's value; null when it was not measured.
    pub ours: Option<f64>,
    /// The other side's.
    pub theirs: Option<f64>,
    /// Of both values.
    pub unit: &'static str,
    /// How many times better riglab is.
    pub ratio: Option<f64>,
    /// The ratio that is asked for; null where none is.
    pub bar: Option<f64>,
    /// Why a value is missing, or what has to be known about it.
    #[serde(skip_serializing_if = "String::is_empty")]
    pub note: String,
    /// Whether it should have been measured and could not be.
    #[serde(skip)]
    pub failed: bool,
}

/// Which of two values is better.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Better {
    /// The larger: rates, shares.
    Higher,
    /// The smaller: times, memory.
    Lower,
}

impl Row {
    /// Both sides were measured.
    pub fn new(name: impl Into<String>, ours: f64, theirs: f64, unit: &'static str, better: Better) -> Self {
        let ratio = match better {
            Better::Higher => ours / theirs,
            Better::Lower => theirs / ours,
        };
        let (ours, theirs, ratio) = (Some(ours), Some(theirs), Some(ratio));
        Self { ours, theirs, unit, ratio, ..Self::skipped(name, "") }
    }

    /// Nothing usual does it: riglab's value stands alone.
    pub fn alone(name: impl Into<String>, ours: f64, unit: &'static str) -> Self {
        Self { ours: Some(ours), unit, ..Self::skipped(name, "") }
    }

    /// Nothing was measured, as something is not there that has to be, and what.
    pub fn skipped(name: impl Into<String>, note: impl Into<String>) -> Self {
        let (name, note) = (name.into(), note.into());
        Self { name, ours: None, theirs: None, unit: "", ratio: None, bar: None, note, failed: false }
    }

    /// Measuring came to an error.
    pub fn failed(name: impl Into<String>, note: impl Into<String>) -> Self {
        Self { failed: true, ..Self::skipped(name, note) }
    }

    /// With the ratio that is asked for.
    pub fn bar(mut self, bar: f64) -> Self {
        self.bar = Some(bar);
        self
    }

    /// With a remark.
    pub fn note(mut self, note: impl Into<String>) -> Self {
        self.note = note.into();
        self
    }
}

/// The rows as a table, and the notes under it.
pub fn table(rows: &[Row]) -> String {
    let number = |x: Option<f64>| x.map_or("-".into(), short);
    let mut lines = vec![["name", "ours", "theirs", "unit", "ratio", "bar", ""].map(String::from)];
    for r in rows {
        let verdict = match (r.ratio, r.bar) {
            (Some(ratio), Some(bar)) if ratio < bar => "below the bar",
            _ => "",
        };
        lines.push([
            r.name.clone(),
            number(r.ours),
            number(r.theirs),
            r.unit.into(),
            r.ratio.map_or("-".into(), |x| format!("{x:.2}")),
            r.bar.map_or("-".into(), |x| format!("{x}")),
            verdict.into(),
        ]);
    }
    let width = |k: usize| lines.iter().map(|l| l[k].chars().count()).max().unwrap_or(0);
    let widths: [usize; 7] = std::array::from_fn(width);
    let mut text = String::new();
    for line in &lines {
        let cells = line.iter().zip(widths).enumerate().map(|(k, (cell, w))| match k {
            1 | 2 | 4 | 5 => format!("{cell:>w$}"),
            _ => format!("{cell:<w$}"),
        });
        text += cells.collect::<Vec<_>>().join("  ").trim_end();
        text.push('\n');
    }
    for r in rows.iter().filter(|r| !r.note.is_empty()) {
        text += &format!("{}: {}\n", r.name, r.note);
    }
    text
}

/// Four significant digits or so.
fn short(x: f64) -> String {
    match x.abs() {
        a if a >= 100.0 => format!("{x:.0}"),
        a if a >= 10.0 => format!("{x:.1}"),
        a if a >= 1.0 => format!("{x:.2}"),
        _ => format!("{x:.3}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ratio_above_one_means_ours_is_better() {
        assert_eq!(Row::new("a", 2.0, 4.0, "ms", Better::Lower).ratio, Some(2.0));
        assert_eq!(Row::new("a", 2.0, 4.0, "1/s", Better::Higher).ratio, Some(0.5));
    }

    #[test]
    fn the_table_says_which_bars_were_missed() {
        let alone = table(&[Row::alone("report", 0.5, "s")]);
        assert!(
            alone.lines().nth(1).is_some_and(|l| l.contains("0.500") && l.ends_with("s         -    -")),
            "{alone}"
        );
        let rows = [
            Row::new("step", 20.0, 10.0, "ms", Better::Lower).bar(1.0),
            Row::new("import", 0.5, 100.0, "ms", Better::Lower).bar(20.0),
            Row::skipped("epoch", "no rigs"),
        ];
        let text = table(&rows);
        let lines: Vec<&str> = text.lines().collect();
        assert!(lines[1].ends_with("0.50    1  below the bar"), "{text}");
        assert!(lines[2].ends_with("20"), "{text}");
        assert_eq!(lines[4], "epoch: no rigs");
    }

    #[test]
    fn rows_have_the_promised_keys() {
        let row = Row::new("a", 1.0, 2.0, "ms", Better::Lower);
        let text = serde_json::to_string(&row).unwrap();
        assert_eq!(text, r#"{"name":"a","ours":1.0,"theirs":2.0,"unit":"ms","ratio":2.0,"bar":null}"#);
    }
}
