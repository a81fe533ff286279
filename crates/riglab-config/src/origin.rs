//! Where a key or value was written.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

/// A text that keys and values come from.
#[derive(Debug)]
pub(crate) struct Source {
    /// Path, built-in name, `--set a.b=c` or `default`.
    pub name: String,
    pub kind: SourceKind,
    /// What spans count bytes in.
    pub text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum SourceKind {
    File,
    BuiltIn,
    /// The name says it all: a `--set` argument, a default.
    Label,
}

/// The place where a key or value was written.
///
/// Displays as `path:line:column` (from 1, columns in characters), `built-in name:line:column`,
/// `--set a.b=c`, or `default` after [`Config::fill`](crate::Config::fill).
#[derive(Clone, Debug)]
pub struct Origin {
    source: Arc<Source>,
    /// Empty at 0 for the text as a whole.
    span: Range<usize>,
}

/// The most characters of a line that are shown around a fault.
const SHOWN: usize = 100;

impl Origin {
    pub(crate) fn new(source: &Arc<Source>, span: Range<usize>) -> Self {
        Self { source: source.clone(), span }
    }

    /// The text as a whole.
    pub(crate) fn whole(source: &Arc<Source>) -> Self {
        Self::new(source, 0..0)
    }

    /// Whether it comes with the program, as no person's file or `--set` does.
    pub(crate) fn is_built_in(&self) -> bool {
        self.source.kind == SourceKind::BuiltIn
    }

    pub(crate) fn is_whole(&self) -> bool {
        self.span == (0..0)
    }

    /// The file's path, the built-in file's name, `--set a.b=c` or `default`.
    pub fn name(&self) -> &str {
        &self.source.name
    }

    /// Line and column, from 1; `None` for what is in no file, and for a file as a whole.
    pub fn line_column(&self) -> Option<(usize, usize)> {
        if self.source.kind == SourceKind::Label || self.is_whole() {
            return None;
        }
        let before = &self.source.text[..floor_char_boundary(&self.source.text, self.span.start)];
        let line_start = before.rfind('\n').map_or(0, |at| at + 1);
        let line = before.matches('\n').count() + 1;
        Some((line, before[line_start..].trim_start_matches('\u{feff}').chars().count() + 1))
    }

    /// The place without its column, on one line: for comments.
    pub(crate) fn brief(&self) -> String {
        let mut text = self.prefix().to_owned() + &self.source.name;
        if let Some((line, _)) = self.line_column() {
            text += &format!(":{line}");
        }
        text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect()
    }

    fn prefix(&self) -> &'static str {
        if self.source.kind == SourceKind::BuiltIn { "built-in " } else { "" }
    }

    /// The line with carets under what is meant, where the text is not shown anyway.
    pub(crate) fn snippet(&self) -> Option<String> {
        let (line, column) = self.line_column()?;
        let text = self.source.text.lines().nth(line - 1).unwrap_or("").trim_start_matches('\u{feff}');
        let start = column - 1;
        let spanned = self.source.text.get(self.span.clone()).unwrap_or("");
        let width = spanned.lines().next().unwrap_or("").chars().count().max(1);
        // A long line is shown from a little before the fault.
        let long = text.chars().count() > SHOWN;
        let skip = if long { start.saturating_sub(SHOWN / 3) } else { 0 };
        let shown: String = text.chars().skip(skip).take(SHOWN).map(|c| if c.is_control() { ' ' } else { c }).collect();
        let carets = "^".repeat(width.min((skip + SHOWN).saturating_sub(start)).max(1));
        let number = line.to_string();
        let gutter = " ".repeat(number.len());
        let indent = " ".repeat(start - skip);
        Some(format!("{gutter} |\n{number} | {shown}\n{gutter} | {indent}{carets}"))
    }
}

impl fmt::Display for Origin {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.prefix(), self.source.name)?;
        match self.line_column() {
            Some((line, column)) => write!(f, ":{line}:{column}"),
            None => Ok(()),
        }
    }
}

fn floor_char_boundary(text: &str, at: usize) -> usize {
    (0..=at.min(text.len())).rev().find(|&i| text.is_char_boundary(i)).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn source(text: &str) -> Arc<Source> {
        Arc::new(Source { name: "a.toml".into(), kind: SourceKind::File, text: text.into() })
    }

    #[test]
    fn columns_count_characters() {
        let s = source("x = 1\r\nö = \"é\"\r\n");
        let at = s.text.find('"').unwrap();
        let origin = Origin::new(&s, at..at + 4);
        assert_eq!(origin.to_string(), "a.toml:2:5");
        assert_eq!(origin.snippet().unwrap(), "  |\n2 | ö = \"é\"\n  |     ^^^");
    }

    #[test]
    fn long_lines_are_cut_around_the_fault() {
        let s = source(&format!("a = [{}, x]", "1, ".repeat(500)));
        let at = s.text.find('x').unwrap();
        let snippet = Origin::new(&s, at..at + 1).snippet().unwrap();
        let lines: Vec<&str> = snippet.lines().collect();
        assert!(lines[1].len() <= 4 + SHOWN);
        assert_eq!(lines[1].find('x'), lines[2].find('^'));
    }

    #[test]
    fn a_place_past_the_end_is_shown() {
        let s = source("a = [");
        assert_eq!(Origin::new(&s, 5..5).snippet().unwrap(), "  |\n1 | a = [\n  |      ^");
    }
}
