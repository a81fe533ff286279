//! Tables outside of pages: for the terminal, Markdown, LaTeX and spreadsheets.

use std::ops::Range;

use crate::{Cell, Table, ticks};

/// Height that a table takes of a page in LaTeX at most, in points; pages of `article` have 550 on letter paper.
const PAGE: f64 = 500.0;

/// Letters of a terminal's line beyond which heads of tables are broken.
const TERMINAL: usize = 100;

impl Table {
    /// For a terminal: columns aligned by blanks, the best of a column with `*`. Where columns are many, long heads are
    /// broken at their blanks.
    pub fn to_text(&self) -> String {
        let mark = |cell: &Cell| format!("{}{}", cell.text, if cell.strong { "*" } else { "" });
        let lines: Vec<Vec<String>> = self.rows.iter().map(|row| row.iter().map(mark).collect()).collect();
        let heads = self.heads(&lines);
        let all = || heads.iter().chain(&lines);
        let widths: Vec<usize> = (0..self.head.len()).map(|k| widest(all(), k)).collect();
        let mut out = format!("{}\n", self.caption);
        for (n, line) in all().enumerate() {
            if n >= heads.len() && self.breaks.contains(&(n - heads.len())) {
                out.push('\n');
            }
            let mut text = String::new();
            for (k, (cell, &width)) in line.iter().zip(&widths).enumerate() {
                let gap = " ".repeat(width - cell.chars().count().min(width));
                let right = self.is_number(k);
                text += &if right { format!("{gap}{cell}  ") } else { format!("{cell}{gap}  ") };
            }
            out += &format!("  {}\n", text.trim_end());
        }
        if !self.note.is_empty() {
            out += &format!("  {}\n", self.note);
        }
        out
    }

    /// The lines of the heads above some rows: one, or several in a wide table, the last of which stand right above the rows.
    fn heads(&self, rows: &[Vec<String>]) -> Vec<Vec<String>> {
        let columns = 0..self.head.len();
        let whole = vec![self.head.clone()];
        let width = columns.clone().map(|k| widest(whole.iter().chain(rows), k) + 2).sum::<usize>();
        if width <= TERMINAL {
            return whole;
        }
        let broken: Vec<Vec<String>> = columns.map(|k| broken(&self.head[k], widest(rows.iter(), k))).collect();
        let height = broken.iter().map(Vec::len).max().unwrap_or(0);
        let at = |own: &Vec<String>, n: usize| (n + own.len()).checked_sub(height).map_or("", |n| &own[n]).to_owned();
        (0..height).map(|n| broken.iter().map(|own| at(own, n)).collect()).collect()
    }

    /// GitHub's Markdown: the best of a column bold, published numbers in italics.
    pub fn to_markdown(&self) -> String {
        let plain = markdown;
        let cell = |c: &Cell| match (c.strong, c.published, plain(&c.text)) {
            (_, _, text) if text.is_empty() => text,
            (true, _, text) => format!("**{text}**"),
            (_, true, text) => format!("*{text}*"),
            (.., text) => text,
        };
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let mut out = format!("**{}**\n\n", plain(&self.caption));
        out += &line(self.head.iter().map(|h| plain(h)).collect());
        let side = |k: usize| if self.is_number(k) { "--:" } else { ":--" };
        out += &line((0..self.head.len()).map(|k| side(k).to_owned()).collect());
        self.rows.iter().for_each(|row| out += &line(row.iter().map(cell).collect()));
        if !self.note.is_empty() {
            out += &format!("\n{}\n", plain(&self.note));
        }
        out
    }

    /// LaTeX with the package booktabs: the best of a column bold, published numbers in italics. Its label is `tab:` and
    /// its caption; a wide table is set smaller, one that even so is too wide for a page scaled (package graphicx). One
    /// that is too long for a page goes on in further tables of the same number: LaTeX cuts off what a page has no room
    /// for, and tables of the package longtable stand in no document of two columns.
    pub fn to_latex(&self) -> String {
        self.to_latex_as(&self.label())
    }

    /// The same under a label, which has to be the only one of its document.
    pub(crate) fn to_latex_as(&self, label: &str) -> String {
        let cell = |c: &Cell| match (c.strong, c.published, in_cell(c)) {
            (_, _, text) if text.is_empty() => text,
            (true, _, text) => format!("\\textbf{{{text}}}"),
            (_, true, text) => format!("\\textit{{{text}}}"),
            (.., text) => text,
        };
        let line = |cells: Vec<String>| format!("  {} \\\\\n", cells.join(" & "));
        let sides: String = (0..self.head.len()).map(|k| if self.is_number(k) { 'r' } else { 'l' }).collect();
        let fit = Fit::of(self);
        let mut out = String::new();
        if fit == Fit::Scaled {
            out += "% Needs \\usepackage{graphicx}, too: the table is scaled to the width of the text.\n";
        }
        let parts = self.parts(fit);
        let last = parts.len() - 1;
        for (part, rows) in parts.into_iter().enumerate() {
            out += if part > 0 { "\n" } else { "" };
            out += &format!("\\begin{{table}}\n\\centering{}\n", fit.size());
            out += &match part {
                0 => format!("\\caption{{{}}}\n\\label{{{label}}}\n", latex(&self.caption)),
                _ => format!("\\addtocounter{{table}}{{-1}}\\caption{{{} (continued)}}\n", latex(&self.caption)),
            };
            if fit == Fit::Scaled {
                out += "\\resizebox{\\ifdim\\width>\\linewidth\\linewidth\\else\\width\\fi}{!}{%\n";
            }
            out += &format!("\\begin{{tabular}}{{{sides}}}\n  \\toprule\n");
            out += &line(self.head.iter().map(|h| latex(h)).collect());
            out += "  \\midrule\n";
            for n in rows.clone() {
                if n > rows.start && self.breaks.contains(&n) {
                    out += "  \\midrule\n";
                }
                out += &line(self.rows[n].iter().map(cell).collect());
            }
            out += "  \\bottomrule\n\\end{tabular}";
            out += if fit == Fit::Scaled { "}\n" } else { "\n" };
            if part == last && !self.note.is_empty() {
                out += &format!("\n\\smallskip\\footnotesize {}\n", latex(&self.note));
            }
            out += "\\end{table}\n";
        }
        out
    }

    /// The rows that stand on a page each, with the caption, and with the note below the last.
    fn parts(&self, fit: Fit) -> Vec<Range<usize>> {
        let lines = |text: &str, letters: usize| text.chars().count().div_ceil(letters) as f64;
        let begun = 12.0 * lines(&self.caption, 70) + 45.0;
        let ended = 9.5 * lines(&self.note, 80) + 10.0;
        let heads: Vec<usize> = self.head.iter().map(|head| head.chars().count()).collect();
        let with = |widths: &[usize], n: usize| -> Vec<usize> {
            let own = |k: usize| self.rows[n].get(k).map_or(0, |cell| cell.text.chars().count());
            widths.iter().enumerate().map(|(k, width)| own(k).max(*width)).collect()
        };
        // Of the part that grows: where it begins, the lines between its rows, letters of its widest cells.
        let (mut parts, mut start, mut breaks, mut widths) = (Vec::new(), 0, 0, heads.clone());
        for n in 0..self.rows.len() {
            widths = with(&widths, n);
            breaks += usize::from(self.breaks.contains(&n));
            let below = if n + 1 == self.rows.len() { ended } else { 0.0 };
            let height = begun + fit.row(&widths) * (n + 1 - start) as f64 + 5.0 * breaks as f64 + below;
            if n > start && height > PAGE {
                parts.push(start..n);
                (start, breaks, widths) = (n, 0, with(&heads, n));
            }
        }
        parts.push(start..self.rows.len());
        parts
    }

    /// What a document refers to it by.
    pub(crate) fn label(&self) -> String {
        let letters =
            self.caption.chars().map(|c| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { ' ' });
        let words: String = letters.collect();
        let mut label = "tab:".to_owned();
        for word in words.split_whitespace() {
            if label.len() + word.len() > 60 {
                break;
            }
            label += if label.ends_with(':') { "" } else { "-" };
            label += word;
        }
        label
    }

    /// Comma-separated values as RFC 4180 has them, the heads first.
    pub fn to_csv(&self) -> String {
        let mut out = Self::csv_line(&self.head.iter().map(String::as_str).collect::<Vec<_>>());
        for row in &self.rows {
            out += &Self::csv_line(&row.iter().map(Cell::plain).collect::<Vec<_>>());
        }
        out
    }

    /// A line of comma-separated values.
    pub(crate) fn csv_line(fields: &[&str]) -> String {
        let field = |text: &&str| -> String {
            if text.contains(['"', ',', '\n', '\r']) {
                format!("\"{}\"", text.replace('"', "\"\""))
            } else {
                (*text).into()
            }
        };
        fields.iter().map(field).collect::<Vec<_>>().join(",") + "\r\n"
    }

    /// Whether a column's cells are numbers, all but the empty ones.
    pub(crate) fn is_number(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().filter_map(|row| row.get(column)).peekable();
        cells.peek().is_some() && cells.all(|c| c.number)
    }
}

/// Letters of the widest cell of a column.
fn widest<'a>(lines: impl Iterator<Item = &'a Vec<String>>, column: usize) -> usize {
    lines.filter_map(|line| line.get(column)).map(|cell| cell.chars().count()).max().unwrap_or(0)
}

/// A text in lines of at most so many letters, as far as its words allow.
fn broken(text: &str, letters: usize) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    // A word that stands alone anyhow leaves room for others.
    let longest = text.split(' ').map(|word| word.chars().count()).max().unwrap_or(0).max(letters);
    for word in text.split(' ') {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= longest => *line += &format!(" {word}"),
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// How a table fits between the margins of a page in LaTeX.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fit {
    /// As it is.
    Plain,
    /// With smaller letters and less between columns.
    Small,
    /// With the smallest that are read without pain.
    Smallest,
    /// Only scaled.
    Scaled,
}

impl Fit {
    /// By letters and columns, as wide as letters are on average, in points; `article` has a text of 345.
    fn of(table: &Table) -> Self {
        let cells = |k: usize| table.rows.iter().filter_map(move |row| row.get(k)).map(|c| c.text.chars().count());
        let width = |(k, head): (usize, &String)| cells(k).max().unwrap_or(0).max(head.chars().count());
        let letters: usize = table.head.iter().enumerate().map(width).sum();
        let fits = |letter: f64, gap: f64| letter * letters as f64 + 2.0 * gap * table.head.len() as f64 <= 345.0;
        match (fits(5.2, 6.0), fits(4.7, 3.0), fits(3.9, 2.0)) {
            (true, ..) => Self::Plain,
            (_, true, _) => Self::Small,
            (.., true) => Self::Smallest,
            _ => Self::Scaled,
        }
    }

    /// Height of a row between others whose widest cells have so many letters, in points. What is scaled to the width is as
    /// much lower; letters are taken for narrow ones, so that it is rather higher.
    fn row(self, letters: &[usize]) -> f64 {
        match self {
            Self::Plain => 12.0,
            Self::Small => 11.0,
            Self::Smallest => 8.0,
            Self::Scaled => {
                let wide = 4.2 * letters.iter().sum::<usize>() as f64 + 12.0 * letters.len() as f64;
                12.0 * (345.0 / wide).min(1.0)
            }
        }
    }

    /// Letters and what is left free on either side of a column.
    fn size(self) -> &'static str {
        match self {
            Self::Plain | Self::Scaled => "",
            Self::Small => "\\small\\setlength{\\tabcolsep}{3pt}",
            Self::Smallest => "\\scriptsize\\setlength{\\tabcolsep}{2pt}",
        }
    }
}

/// A text that Markdown shows as it is, in one line, with what stands between backticks as code.
pub(crate) fn markdown(text: &str) -> String {
    let mut out = ticks::markdown(text, plain_markdown);
    if let Some(at) = begins(&out) {
        out.insert(at, '\\');
    }
    out
}

/// Where a line begins that would be a quotation, an item of a list or a rule: what a backslash belongs before.
fn begins(line: &str) -> Option<usize> {
    let ends = |rest: &str| rest.is_empty() || rest.starts_with(char::is_whitespace);
    match line.chars().next()? {
        '>' => Some(0),
        '-' | '+' if ends(&line[1..]) || line.chars().all(|c| matches!(c, '-' | ' ')) => Some(0),
        '0'..='9' => {
            let at = line.find(|c: char| !c.is_ascii_digit())?;
            (line[at..].starts_with(['.', ')']) && ends(&line[at + 1..])).then_some(at)
        }
        _ => None,
    }
}

/// What GitHub's Markdown would read as markup, behind a backslash.
fn plain_markdown(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let (mut before, mut rest) = (None, text.chars());
    while let Some(c) = rest.next() {
        let next = rest.as_str().chars().next();
        let is_markup = match c {
            '\\' | '|' | '`' | '<' | '*' | '[' | '~' | '$' => true,
            // Within a word it is a letter.
            '_' => ![before, next].iter().all(|side| side.is_some_and(char::is_alphanumeric)),
            '&' => next.is_some_and(|c| c == '#' || c.is_ascii_alphanumeric()),
            // Around a heading.
            '#' => before.is_none_or(char::is_whitespace),
            _ => false,
        };
        if is_markup {
            out.push('\\');
        }
        out.push(if matches!(c, '\n' | '\r') { ' ' } else { c });
        before = Some(c);
    }
    out
}

/// What LaTeX shows in a cell: the hyphens of numbers as what they mean.
fn in_cell(cell: &Cell) -> String {
    if cell.number { latex(&cell.text.replace('-', "−")) } else { latex(&cell.text) }
}

/// A text in LaTeX: hyphens before numbers become minus signs, what stands between backticks code.
pub(crate) fn latex(text: &str) -> String {
    ticks::latex(text, plain_latex)
}

fn plain_latex(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    let mut before = ' ';
    let mut rest = text.chars();
    while let Some(c) = rest.next() {
        let ahead = rest.as_str().trim_start_matches('.');
        let minus = c == '-' && matches!(before, ' ' | '(') && ahead.starts_with(|c: char| c.is_ascii_digit());
        out.push(if minus { '−' } else { c });
        before = c;
    }
    verbatim(&out)
}

/// A text that LaTeX shows as it is, wherever it stands: behind the end of a row a bare `[` begins an argument
/// and a bare `*` belongs to it.
pub(crate) fn verbatim(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => out.extend(['\\', c]),
            '\\' => out += "\\textbackslash{}",
            '[' | '*' => out.extend(['{', c, '}']),
            '~' => out += "\\textasciitilde{}",
            '^' => out += "\\textasciicircum{}",
            '<' | '>' | '|' => out += &format!("${c}$"),
            // Two would become a dash, and an option could not be copied.
            '-' if out.ends_with('-') => out += "{}-",
            '±' => out += "$\\pm$",
            '–' => out += "--",
            '×' => out += "$\\times$",
            '²' => out += "$^2$",
            '³' => out += "$^3$",
            '−' => out += "$-$",
            '≥' => out += "$\\geq$",
            '≤' => out += "$\\leq$",
            '≈' => out += "$\\approx$",
            '→' => out += "$\\rightarrow$",
            '∞' => out += "$\\infty$",
            '…' => out += "\\ldots{}",
            '\n' => out.push(' '),
            c => match greek(c) {
                Some(name) => out += &format!("$\\{name}$"),
                None => out.push(c),
            },
        }
    }
    out
}

/// What LaTeX calls a Greek letter, as names of settings have them: pdflatex knows none of them in a text.
fn greek(c: char) -> Option<&'static str> {
    const SMALL: [&str; 25] = [
        "alpha", "beta", "gamma", "delta", "epsilon", "zeta", "eta", "theta", "iota", "kappa", "lambda", "mu", "nu",
        "xi", "omicron", "pi", "rho", "varsigma", "sigma", "tau", "upsilon", "phi", "chi", "psi", "omega",
    ];
    Some(match c {
        'µ' => "mu",
        'ϵ' => "epsilon",
        'ϕ' => "phi",
        // LaTeX has no name for what looks like a Latin letter.
        'ο' => return None,
        'α'..='ω' => SMALL[c as usize - 'α' as usize],
        'Γ' => "Gamma",
        'Δ' => "Delta",
        'Θ' => "Theta",
        'Λ' => "Lambda",
        'Ξ' => "Xi",
        'Π' => "Pi",
        'Σ' => "Sigma",
        'Φ' => "Phi",
        'Ψ' => "Psi",
        'Ω' => "Omega",
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut t = Table::new("A & B", &["name", "x_1"]);
        t.row(vec![Cell::text("a|b, \"c\""), Cell::number(0.5, 2).strong_if(true)]);
        t.line();
        t.row(vec![Cell::text("ours"), Cell::number(f64::NAN, 2)]);
        t.row(vec![Cell::text("theirs"), Cell { published: true, ..Cell::number(12.0, 2) }]);
        t.note = "100 %".into();
        t
    }

    #[test]
    fn text_is_aligned() {
        let text = table().to_text();
        assert_eq!(
            text,
            "A & B\n  name        x_1\n  a|b, \"c\"  0.50*\n\n  ours          –\n  theirs    12.00\n  100 %\n"
        );
    }

    #[test]
    fn heads_of_wide_tables_are_broken_at_blanks() {
        let mut t = Table::new("t", &["metric @rignet", "heat diffusion, top 4", "n"]);
        t.row(vec![Cell::text("j2j × 100"), Cell::number(12.5, 2), Cell::count(3)]);
        t.line();
        t.row(vec![Cell::text("iou"), Cell::number(0.5, 2), Cell::count(3)]);
        assert!(t.to_text().starts_with("t\n  metric @rignet  heat diffusion, top 4  n\n"), "{}", t.to_text());
        t.row(vec![Cell::text("x".repeat(TERMINAL)), Cell::number(0.5, 2), Cell::count(3)]);
        let text = t.to_text();
        let lines: Vec<&str> = text.lines().map(|line| line.trim_start_matches(' ')).collect();
        assert_eq!(lines[1..3], ["heat", "diffusion,"]);
        assert!(lines[3].starts_with("metric @rignet  ") && lines[3].ends_with("      top 4  n"), "{text}");
        assert!(lines[5].is_empty() && lines[6].starts_with("iou"), "{text}");
        assert!(lines.iter().skip(1).all(|line| line.chars().count() <= TERMINAL + 2 + 10 + 3));
        assert_eq!((broken("", 3), broken("a b", 3)), (vec![String::new()], vec!["a b".to_owned()]));
    }

    #[test]
    fn markdown_and_latex_escape_what_would_break_them() {
        let (markdown, latex) = (table().to_markdown(), table().to_latex());
        assert!(markdown.contains("| a\\|b, \"c\" | **0.50** |\n") && markdown.contains("| :-- | --: |"));
        assert!(markdown.contains("| theirs | *12.00* |"));
        // Names and facts are anybody's.
        let texts = [
            ("_idle_ __a, a_b _c", "\\_idle\\_ \\_\\_a, a_b \\_c"),
            ("a&lt;b &#60; R&D a & b", "a\\&lt;b \\&#60; R\\&D a & b"),
            ("~~a~~ $x$", "\\~\\~a\\~\\~ \\$x\\$"),
            ("# a # b#c #", "\\# a \\# b#c \\#"),
            ("> a > b", "\\> a > b"),
            ("- a - b", "\\- a - b"),
            ("---", "\\---"),
            ("--set -0.5 -x", "--set -0.5 -x"),
            ("-0.25", "-0.25"),
            ("12. a 3. b", "12\\. a 3. b"),
            ("1) a", "1\\) a"),
            ("1.5", "1.5"),
        ];
        texts.iter().for_each(|(text, shown)| assert_eq!(super::markdown(text), *shown));
        assert!(latex.contains("\\caption{A \\& B}") && latex.contains("{lr}") && latex.contains("x\\_1"));
        assert!(latex.contains("a$|$b, \"c\" & \\textbf{0.50} \\\\\n  \\midrule\n") && latex.contains("100 \\%"));
        assert!(latex.contains("\\textit{12.00}"));
    }

    #[test]
    fn greek_letters_and_arrows_are_formulas_in_latex() {
        assert_eq!(
            latex("α = 1 → Δλ ≈ ∞…"),
            "$\\alpha$ = 1 $\\rightarrow$ $\\Delta$$\\lambda$ $\\approx$ $\\infty$\\ldots{}"
        );
        assert_eq!(latex("ς, σ, ω, µ"), "$\\varsigma$, $\\sigma$, $\\omega$, $\\mu$");
        assert_eq!(latex("ο, é"), "ο, é");
    }

    #[test]
    fn wide_tables_of_latex_become_smaller_and_the_widest_are_scaled() {
        let of = |columns: usize| {
            let head: Vec<String> = (0..columns).map(|k| format!("a head {k}")).collect();
            Table { head, ..Table::default() }.to_latex()
        };
        assert!(!of(6).contains("tabcolsep") && !of(6).contains("resizebox"));
        assert!(of(7).contains("\\small\\setlength{\\tabcolsep}"));
        assert!(of(9).contains("\\scriptsize") && !of(9).contains("resizebox"));
        let scaled = of(20);
        assert!(scaled.starts_with("% Needs \\usepackage{graphicx}") && scaled.contains("\\end{tabular}}\n"));
        assert_eq!(scaled.matches('{').count(), scaled.matches('}').count());
    }

    #[test]
    fn long_tables_of_latex_go_on_in_others_of_the_same_number() {
        let of = |rows: usize, columns: usize, note: &str| {
            let head: Vec<String> = (0..columns).map(|k| format!("a head {k}")).collect();
            let mut table = Table { caption: "A long one".into(), head, note: note.into(), ..Table::default() };
            (0..rows).for_each(|n| table.row(vec![Cell::text(format!("row {n}."))]));
            table
        };
        let latex = of(245, 3, "a note").to_latex();
        assert_eq!(latex.matches("\\begin{table}").count(), 7);
        assert_eq!(latex.matches("(continued)").count(), 6);
        assert_eq!(latex.matches("\\addtocounter{table}{-1}\\caption").count(), 6);
        assert_eq!((latex.matches("\\label").count(), latex.matches("a note").count()), (1, 1));
        assert!(latex.find("a note") > latex.find("row 244."));
        assert_eq!(latex.matches("a head 0 &").count(), 7, "heads stand above each");
        assert!((0..245).all(|n| latex.contains(&format!("row {n}."))));
        assert_eq!(latex.matches('{').count(), latex.matches('}').count());
        let parts = |table: &Table| table.parts(Fit::of(table)).len();
        // Smaller rows, more of them; a long note takes room.
        assert!([3, 7, 9, 20].map(|columns| parts(&of(60, columns, ""))) == [2, 2, 2, 1]);
        assert_eq!((parts(&of(30, 3, "")), parts(&of(30, 3, &"note ".repeat(200)))), (1, 2));
        // One long cell does not make the rows of other pages lower.
        let mut wide = of(300, 3, "");
        wide.rows[0][0].text = "wide ".repeat(60);
        let ranges = wide.parts(Fit::of(&wide));
        let rows: Vec<usize> = ranges.iter().map(Range::len).collect();
        assert!(Fit::of(&wide) == Fit::Scaled && rows.len() > 3 && rows[0] > 100 && rows[1..].iter().all(|n| *n <= 36));
        assert_eq!((parts(&of(0, 3, "")), parts(&of(1, 3, &"note ".repeat(2000)))), (1, 1));
    }

    #[test]
    fn negative_numbers_of_latex_have_a_minus_and_options_and_dates_none() {
        let mut t = Table::new("t", &["setting", "x"]);
        t.row(vec![Cell::text("a-1 of 2026-11-28"), Cell::difference(-0.25, 2)]);
        t.row(vec![Cell::text("weights of -.5"), Cell::none().with_text("-0.052 .. -0.048")]);
        t.row(vec![Cell::text("--set a=1"), Cell::none().with_text("2.5e-4")]);
        let latex = t.to_latex();
        assert!(latex.contains("a-1 of 2026-11-28 & $-$0.25 \\\\"), "{latex}");
        assert!(latex.contains("weights of $-$.5 & $-$0.052 .. $-$0.048 \\\\"), "{latex}");
        assert!(latex.contains("-{}-set a=1 & 2.5e$-$4 \\\\"), "{latex}");
        assert_eq!(super::latex("(95 % interval -0.1 to +0.2)"), "(95 \\% interval $-$0.1 to +0.2)");
        assert_eq!(verbatim("head -3 x"), "head -3 x", "a command stays as it is typed");
    }

    #[test]
    fn a_row_may_begin_with_a_bracket_or_a_star() {
        let mut t = Table::new("t", &["values", "x"]);
        t.row(vec![Cell::text("[1, 2]"), Cell::number(0.5, 1)]);
        t.row(vec![Cell::text("*"), Cell::number(0.5, 1)]);
        let latex = t.to_latex();
        assert!(latex.contains("  \\midrule\n  {[}1, 2] & 0.5 \\\\\n  {*} & 0.5 \\\\\n"), "{latex}");
    }

    #[test]
    fn spreadsheets_get_numbers_and_nothing_where_there_is_none() {
        assert_eq!(table().to_csv(), "name,x_1\r\n\"a|b, \"\"c\"\"\",0.50\r\nours,\r\ntheirs,12.00\r\n");
    }
}
