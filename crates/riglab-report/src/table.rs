//! Tables of text and numbers.

use serde::Serialize;

/// One cell.
#[derive(Clone, Debug, Serialize)]
pub struct Cell {
    /// What it shows.
    pub text: String,
    /// Numbers stand to the right.
    pub number: bool,
    /// The best of its column.
    pub strong: bool,
    /// Published by others, not measured here.
    pub published: bool,
    /// The number for comma-separated values, where readers are shown something else, such as `< 0.001`.
    pub digits: Option<String>,
}

impl Cell {
    /// A text.
    pub fn text(text: impl Into<String>) -> Self {
        Self { text: text.into(), number: false, strong: false, published: false, digits: None }
    }

    /// A number with that many digits after the point; `–` where it is undefined.
    pub fn number(value: f64, digits: usize) -> Self {
        // What rounding leaves nothing of has no sign.
        let scale = 10f64.powi(digits as i32);
        let value = if (value * scale).abs() < 0.5 { 0.0 } else { value };
        let text = if value.is_finite() { format!("{value:.digits$}") } else { "–".into() };
        Self { number: true, ..Self::text(text) }
    }

    /// A difference with its sign; nothing that is shown as 0 has one.
    pub fn difference(value: f64, digits: usize) -> Self {
        let shown = Self::number(value, digits);
        let above = value > 0.0 && shown.text.contains(|c| matches!(c, '1'..='9'));
        let text = if above { format!("+{}", shown.text) } else { shown.text.clone() };
        shown.with_text(text)
    }

    /// A whole number.
    pub fn count(value: usize) -> Self {
        Self { number: true, ..Self::text(value.to_string()) }
    }

    /// An empty number.
    pub fn none() -> Self {
        Self { number: true, ..Self::text("") }
    }

    /// The same with another text.
    pub fn with_text(mut self, text: impl Into<String>) -> Self {
        self.text = text.into();
        self
    }

    /// The same, with a number that is written in its stead where programs read.
    pub fn with_digits(mut self, digits: impl Into<String>) -> Self {
        self.digits = Some(digits.into());
        self
    }

    /// What programs read: the number, else the text; nothing for a number that is undefined.
    pub(crate) fn plain(&self) -> &str {
        let text = self.digits.as_deref().unwrap_or(&self.text);
        if self.number && text == "–" { "" } else { text }
    }

    /// Marked as the best.
    pub fn strong_if(mut self, strong: bool) -> Self {
        self.strong = strong;
        self
    }
}

/// A table with a caption.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Table {
    /// What it shows.
    pub caption: String,
    /// Column heads.
    pub head: Vec<String>,
    /// Rows, each with a cell a column.
    pub rows: Vec<Vec<Cell>>,
    /// Rows before which a line is drawn.
    pub breaks: Vec<usize>,
    /// What has to be known to read it.
    pub note: String,
}

impl Table {
    /// Without rows.
    pub fn new(caption: impl Into<String>, head: &[&str]) -> Self {
        Self { caption: caption.into(), head: head.iter().map(|h| (*h).to_string()).collect(), ..Self::default() }
    }

    /// Adds a row.
    pub fn row(&mut self, cells: Vec<Cell>) {
        self.rows.push(cells);
    }

    /// Draws a line before the next row.
    pub fn line(&mut self) {
        self.breaks.push(self.rows.len());
    }

    /// Leaves out columns that no row has anything in.
    pub(crate) fn without_empty_columns(mut self) -> Self {
        let filled = |k: usize| self.rows.iter().any(|row| row.get(k).is_some_and(|cell| !cell.text.is_empty()));
        let keep: Vec<bool> = (0..self.head.len()).map(filled).collect();
        let of = |k: usize| keep.get(k).copied().unwrap_or(true);
        for row in &mut self.rows {
            *row = std::mem::take(row).into_iter().enumerate().filter(|(k, _)| of(*k)).map(|(_, cell)| cell).collect();
        }
        self.head = self.head.into_iter().enumerate().filter(|(k, _)| of(*k)).map(|(_, head)| head).collect();
        self
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn columns_without_anything_can_be_left_out() {
        let mut table = Table::new("t", &["name", "a", "b", "c"]);
        table.row(vec![Cell::text("x"), Cell::none(), Cell::number(1.0, 0), Cell::none()]);
        table.row(vec![Cell::text("y"), Cell::none(), Cell::none(), Cell::number(f64::NAN, 0)]);
        let table = table.without_empty_columns();
        let row = |k: usize| table.rows[k].iter().map(|c| c.text.as_str()).collect::<Vec<_>>();
        assert_eq!(table.head, ["name", "b", "c"]);
        assert_eq!([row(0), row(1)], [["x", "1", ""], ["y", "", "–"]]);
    }

    #[test]
    fn differences_have_signs_and_zero_has_none() {
        let shown = [0.25, -0.25, 0.00004, -0.00004, -0.0, f64::NAN].map(|v| Cell::difference(v, 3).text);
        assert_eq!(shown, ["+0.250", "-0.250", "0.000", "0.000", "0.000", "–"]);
        assert_eq!(Cell::difference(-0.4, 0).text, "0");
        assert_eq!(Cell::number(-0.00004, 4).text, "0.0000");
    }
}
