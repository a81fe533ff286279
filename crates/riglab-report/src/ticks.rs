//! What stands between backticks in sentences and captions, such as commands and names of rows, as each form shows it.

use crate::plain::verbatim;

/// A part of a text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Part<'a> {
    /// As it is.
    Plain(&'a str),
    /// What stood between two backticks of one line.
    Code(&'a str),
}

/// The parts of a text in their order. A backtick without another is one.
pub(crate) fn parts(text: &str) -> Vec<Part<'_>> {
    let mut out = Vec::new();
    let (mut rest, mut from) = (text, 0);
    while let Some(open) = rest[from..].find('`').map(|at| from + at) {
        let inner = &rest[open + 1..];
        match inner.find('`') {
            Some(end) if end > 0 && !inner[..end].contains('\n') => {
                out.extend([Part::Plain(&rest[..open]), Part::Code(&inner[..end])]);
                (rest, from) = (&inner[end + 1..], 0);
            }
            _ => from = open + 1,
        }
    }
    out.push(Part::Plain(rest));
    out.retain(|part| *part != Part::Plain(""));
    out
}

/// In a page.
pub(crate) fn html(text: &str) -> String {
    let shown = |part| match part {
        Part::Plain(text) => escaped(text),
        Part::Code(text) => format!("<code>{}</code>", escaped(text)),
    };
    parts(text).into_iter().map(shown).collect()
}

/// In LaTeX: `plain` shows the rest.
pub(crate) fn latex(text: &str, plain: impl Fn(&str) -> String) -> String {
    // Two backticks would become an opening quote, and one a single one.
    let lone = |text: &str| plain(text).replace('`', "\\texttt{\\char96}");
    let shown = |part| match part {
        Part::Plain(text) => lone(text),
        Part::Code(text) => code(text),
    };
    parts(text).into_iter().map(shown).collect()
}

/// What is typed, in LaTeX: a bare `'` would be a closing quote, which no shell takes for one.
pub(crate) fn code(text: &str) -> String {
    format!("\\texttt{{{}}}", verbatim(text).replace('\'', "\\textquotesingle{}"))
}

/// In Markdown: `plain` shows the rest. A bar in code would end the cell of a table.
pub(crate) fn markdown(text: &str, plain: impl Fn(&str) -> String) -> String {
    let shown = |part| match part {
        Part::Plain(text) => plain(text),
        Part::Code(text) if text.contains('|') => plain(&format!("`{text}`")),
        Part::Code(text) => format!("`{text}`"),
    };
    parts(text).into_iter().map(shown).collect()
}

fn escaped(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#x27;",
            c => out.push(c),
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plain;

    #[test]
    fn pairs_are_code_and_a_single_one_is_not() {
        use Part::{Code, Plain};
        assert_eq!(parts("row `a` and `b`."), [Plain("row "), Code("a"), Plain(" and "), Code("b"), Plain(".")]);
        assert_eq!(parts("a ` b"), [Plain("a ` b")]);
        assert_eq!(parts("``"), [Plain("``")]);
        assert_eq!(parts("a `b\nc` d"), [Plain("a `b\nc` d")]);
        assert!(parts("").is_empty());
    }

    #[test]
    fn each_form_shows_code_and_still_escapes_it() {
        let text = "row `a_b <--set>` & `";
        assert_eq!(html(text), "row <code>a_b &lt;--set&gt;</code> &amp; `");
        assert_eq!(plain::latex(text), "row \\texttt{a\\_b $<$-{}-set$>$} \\& \\texttt{\\char96}");
        assert_eq!(plain::latex("don't `a 'b'`"), "don't \\texttt{a \\textquotesingle{}b\\textquotesingle{}}");
        assert_eq!(plain::latex("``"), "\\texttt{\\char96}\\texttt{\\char96}");
        assert_eq!(plain::markdown(text), "row `a_b <--set>` & \\`");
        assert_eq!(plain::markdown("`a|b`"), "\\`a\\|b\\`");
    }
}
