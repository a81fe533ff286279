//! A page in other forms than HTML: Markdown, LaTeX and comma-separated values, from the same blocks.
//!
//! Charts are told by figures there: first, last, least and most of each line. Pictures and views of rigs are named,
//! and stand in the page alone.

use std::collections::{BTreeMap, BTreeSet};

use crate::chart::short;
use crate::plain::{latex, markdown};
use crate::ticks::code;
use crate::{Bars, Block, Cell, Chart, Dots, Page, Picture, Table};

impl Page {
    /// GitHub's Markdown.
    pub fn to_markdown(&self) -> String {
        let mut out = format!("# {}\n\n{}\n", markdown(&self.title), markdown(&self.subtitle));
        for block in &self.blocks {
            let text = match block {
                Block::Heading(text) => format!("## {}\n", markdown(text)),
                Block::Text(text) => format!("{}\n", markdown(text)),
                Block::Code(text) => fenced(text),
                Block::Folded(title, text) => {
                    format!("<details><summary>{}</summary>\n\n{}\n</details>\n", html(title), fenced(text))
                }
                _ => {
                    let tables = tables(block).iter().map(Table::to_markdown).collect::<Vec<_>>().join("\n");
                    let shown = shown(block, &self.blocks).into_iter().map(|text| format!("- {}\n", markdown(&text)));
                    tables + &shown.collect::<String>()
                }
            };
            if !text.is_empty() {
                out += &format!("\n{text}");
            }
        }
        out
    }

    /// LaTeX with the package booktabs, to be taken into a document: headings, sentences and tables. What is folded
    /// away in the page is left out, and so are sections of pictures with what is said of them.
    pub fn to_latex(&self) -> String {
        let one_line = |text: &str| text.replace(['\n', '\r'], " ");
        let mut labels = BTreeMap::new();
        let mut out = format!(
            "% {}\n% Needs \\usepackage{{booktabs}}, and textcomp where LaTeX is older than 2020.\n",
            one_line(&self.title)
        );
        out += &format!("\\section*{{{}}}\n{}\n", latex(&self.title), latex(&self.subtitle));
        let mut left_out = false;
        for (k, block) in self.blocks.iter().enumerate() {
            if let Block::Heading(_) = block {
                left_out = of_pictures(&self.blocks[k + 1..]);
            }
            match block {
                Block::Heading(text) | Block::Text(text) if left_out => {
                    out += &format!("% In the page: {}\n", one_line(text));
                }
                Block::Heading(text) => out += &format!("\n\\subsection*{{{}}}\n", latex(text)),
                Block::Text(text) => out += &format!("\n{}\n", latex(text)),
                Block::Code(text) => {
                    for line in text.lines() {
                        out += &format!("\n\\noindent{}\n", code(line));
                    }
                }
                Block::Folded(title, _) => out += &format!("% Left out: {}\n", one_line(title)),
                _ => {
                    for table in tables(block) {
                        let label = table.label();
                        let before = labels.entry(label.clone()).or_insert(0);
                        *before += 1;
                        let label = if *before == 1 { label } else { format!("{label}-{before}") };
                        out += &format!("\n{}", table.to_latex_as(&label));
                    }
                    shown(block, &self.blocks)
                        .iter()
                        .for_each(|text| out += &format!("% In the page: {}\n", one_line(text)));
                }
            }
        }
        out
    }

    /// A line a value: `table,row,column,value,published`. The row is named by its texts; `published` is 1 for values
    /// that others printed and 0 for those that were measured here; values that are undefined are left out. No two lines
    /// are of the same table, row and column.
    pub fn to_csv(&self) -> String {
        let mut out = Table::csv_line(&["table", "row", "column", "value", "published"]);
        let all: Vec<Table> = self.blocks.iter().flat_map(tables).collect();
        let captions = distinct(all.iter().map(|table| table.caption.clone()));
        for (table, caption) in all.iter().zip(&captions) {
            let named = |(n, row): (usize, &Vec<Cell>)| {
                let texts: Vec<&str> = row.iter().filter(|c| !c.number).map(|c| c.text.as_str()).collect();
                if texts.is_empty() { (n + 1).to_string() } else { texts.join(" / ") }
            };
            let names = distinct(table.rows.iter().enumerate().map(named));
            let heads = distinct(table.head.iter().cloned());
            for (row, name) in table.rows.iter().zip(&names) {
                for (head, cell) in heads.iter().zip(row) {
                    if cell.number && !cell.plain().is_empty() {
                        let published = if cell.published { "1" } else { "0" };
                        out += &Table::csv_line(&[caption, name, head, cell.plain(), published]);
                    }
                }
            }
        }
        out
    }

    /// Rows that stand in no other form, as comma-separated values a column a head; `None` for a page without a
    /// sheet.
    pub fn sheet(&self) -> Option<String> {
        self.blocks.iter().find_map(|block| match block {
            Block::Sheet(table) => Some(table.to_csv()),
            _ => None,
        })
    }
}

/// A block's figures as tables.
fn tables(block: &Block) -> Vec<Table> {
    match block {
        Block::Table(table) => vec![table.clone()],
        Block::Facts(facts) => {
            let mut table = Table::new("Facts", &["fact", "value"]);
            facts.iter().for_each(|(name, value)| table.row(vec![Cell::text(name), Cell::text(value)]));
            vec![table]
        }
        Block::Charts(charts) => charts.iter().filter_map(of_chart).collect(),
        Block::Bars(bars) => bars.iter().map(of_bars).collect(),
        Block::Dots(dots) => dots.iter().map(of_dots).collect(),
        _ => Vec::new(),
    }
}

/// Whether a section, whose blocks these begin with, is of pictures and what is said of them alone.
fn of_pictures(blocks: &[Block]) -> bool {
    let section = || blocks.iter().take_while(|b| !matches!(b, Block::Heading(_)));
    let others = |b: &Block| !tables(b).is_empty() || matches!(b, Block::Code(_));
    section().any(|b| matches!(b, Block::Pictures(_) | Block::Views(_))) && !section().any(others)
}

/// What a block shows in the page alone. A rig that is there as a picture and to be turned is named once.
fn shown(block: &Block, page: &[Block]) -> Vec<String> {
    let (mut pictured, mut turned) = (BTreeSet::new(), BTreeSet::new());
    for other in page {
        match other {
            Block::Pictures(pictures) => pictured.extend(pictures.iter().map(|p| p.caption.as_str())),
            Block::Views(views) => turned.extend(views.iter().map(|v| v.caption.as_str())),
            _ => {}
        }
    }
    let picture = |p: &Picture| {
        let what = if turned.contains(p.caption.as_str()) { "Picture and view" } else { "Picture" };
        let file = p.file.as_ref().map_or(String::new(), |file| format!(" (`{file}`)"));
        format!("{what}: {}{file}", p.caption)
    };
    match block {
        Block::Pictures(pictures) => pictures.iter().map(picture).collect(),
        Block::Views(views) => {
            let alone = views.iter().filter(|v| !pictured.contains(v.caption.as_str()));
            alone.map(|v| format!("View: {}", v.caption)).collect()
        }
        _ => Vec::new(),
    }
}

/// Names of which no two are the same: what comes again is numbered.
fn distinct(names: impl Iterator<Item = String>) -> Vec<String> {
    let (mut taken, mut next): (BTreeSet<String>, BTreeMap<String, usize>) = Default::default();
    let mut free = |name: String| {
        let mut own = name.clone();
        while !taken.insert(own.clone()) {
            let number = next.entry(name.clone()).or_insert(1);
            *number += 1;
            own = format!("{name} ({number})");
        }
        own
    };
    names.map(&mut free).collect()
}

fn of_chart(chart: &Chart) -> Option<Table> {
    let mut table = Table::new(&*chart.title, &["line", "first", "last", "least", "most"]);
    for series in &chart.series {
        let points: Vec<(f64, f64)> = series.points.iter().copied().filter(|p| p.1.is_finite()).collect();
        let (Some(first), Some(last)) = (points.first(), points.last()) else { continue };
        let least = points.iter().map(|p| p.1).fold(f64::INFINITY, f64::min);
        let most = points.iter().map(|p| p.1).fold(f64::NEG_INFINITY, f64::max);
        let values = [first.1, last.1, least, most].map(|v| Cell::none().with_text(figure(v)));
        table.row(std::iter::once(Cell::text(&series.name)).chain(values).collect());
    }
    table.note = format!("Over {}; the HTML report has the full lines. {}", chart.x, chart.note).trim_end().to_owned();
    (!table.rows.is_empty()).then_some(table)
}

fn of_bars(bars: &Bars) -> Table {
    let mut table = Table::new(&*bars.title, &["name", "value"]);
    for (name, value) in &bars.bars {
        table.row(vec![Cell::text(name), Cell::none().with_text(figure(*value))]);
    }
    table
}

fn of_dots(dots: &Dots) -> Table {
    let most = dots.lines.iter().map(|(_, own)| own.len()).max().unwrap_or(0);
    let head = std::iter::once("name".to_owned()).chain((1..=most).map(|k| format!("value {k}"))).collect();
    let mut table = Table { caption: dots.title.clone(), head, ..Table::default() };
    for (name, own) in &dots.lines {
        let values = (0..most).map(|k| match own.get(k) {
            Some(v) => Cell::none().with_text(figure(*v)),
            None => Cell::none(),
        });
        table.row(std::iter::once(Cell::text(name)).chain(values).collect());
    }
    table
}

/// A number with four digits or so.
pub(crate) fn figure(value: f64) -> String {
    match value.abs() {
        a if a >= 1000.0 || value == 0.0 || (value.fract() == 0.0 && a < 1e6) => format!("{value:.0}"),
        a if a >= 0.01 => format!("{value:.4}"),
        a if a.is_finite() => format!("{value:.3e}"),
        _ => short(value),
    }
}

/// A block of code whose fence is longer than any in it.
fn fenced(text: &str) -> String {
    let longest = text.split(|c| c != '`').map(str::len).max().unwrap_or(0);
    let fence = "`".repeat((longest + 1).max(3));
    format!("{fence}\n{}\n{fence}\n", text.trim_end())
}

fn html(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Series, Turned};

    fn page() -> Page {
        let mut table = Table::new("Distances", &["split", "method", "J2J"]);
        table.row(vec![Cell::text("a_b"), Cell::text("x, y"), Cell::number(0.5, 2)]);
        table.row(vec![Cell::text("a_b"), Cell::text("theirs"), Cell { published: true, ..Cell::number(1.5, 2) }]);
        table.row(vec![Cell::text("a_b"), Cell::text("none"), Cell::number(f64::NAN, 2)]);
        let line = Series { name: "loss".into(), points: vec![(1.0, 2.0), (2.0, f64::NAN), (3.0, 0.25)] };
        Page {
            kind: crate::PageKind::Report,
            title: "T <b>".into(),
            subtitle: "1 < 2".into(),
            blocks: vec![
                Block::Heading("H_1".into()),
                Block::Facts(vec![("steps".into(), "7".into())]),
                Block::Table(table),
                Block::Charts(vec![Chart {
                    title: "loss".into(),
                    x: "step".into(),
                    series: vec![line],
                    log: true,
                    ..Chart::default()
                }]),
                Block::Pictures(vec![Picture { caption: "best".into(), file: None, png: vec![1] }]),
                Block::Code("riglab train --set a='[1]'".into()),
                Block::Folded("all".into(), "```\nx".into()),
            ],
        }
    }

    #[test]
    fn markdown_has_every_block_and_no_markup_of_its_texts() {
        let text = page().to_markdown();
        assert!(text.starts_with("# T \\<b>\n\n1 \\< 2\n\n## H_1\n"), "{text}");
        assert!(text.contains("| a_b | theirs | *1.50* |") && text.contains("| steps | 7 |"), "{text}");
        assert!(text.contains("| loss | 2 | 0.2500 | 0.2500 | 2 |") && text.contains("- Picture: best"), "{text}");
        assert!(text.contains("````\n```\nx\n````"), "{text}");
    }

    #[test]
    fn latex_escapes_what_would_break_it() {
        let text = page().to_latex();
        assert!(text.contains("\\section*{T $<$b$>$}") && text.contains("\\subsection*{H\\_1}"), "{text}");
        assert!(text.contains("a\\_b & theirs & \\textit{1.50}") && text.contains("\\texttt{riglab train"), "{text}");
        assert_eq!(text.matches("\\begin{table}").count(), text.matches("\\end{table}").count());
        assert!(text.contains("riglab train -{}-set"), "an option keeps its two hyphens: {text}");
        // Each table's braces are paired.
        assert_eq!(text.matches('{').count(), text.matches('}').count());
    }

    #[test]
    fn latex_says_nothing_of_pictures_that_it_does_not_have() {
        let picture = || Block::Pictures(vec![Picture { caption: "the best".into(), file: None, png: vec![1] }]);
        let (heading, text) =
            (|text: &str| Block::Heading(text.into()), |text: &str| Block::Text(format!("Said of {text}.")));
        let mut page = page();
        let table = page.blocks[2].clone();
        page.blocks =
            vec![heading("Pictures"), text("pictures"), picture(), heading("Both"), text("both"), picture(), table];
        let latex = page.to_latex();
        let shown: Vec<&str> = latex.lines().filter(|l| !l.starts_with('%')).collect();
        let shown = shown.join("\n");
        assert!(!shown.contains("Pictures") && !shown.contains("Said of pictures"), "{shown}");
        assert!(shown.contains("\\subsection*{Both}") && shown.contains("Said of both"), "{shown}");
        assert_eq!(latex.matches("% In the page: Picture: the best").count(), 2);
        assert!(page.to_markdown().contains("Said of pictures"));
    }

    #[test]
    fn a_rig_that_is_pictured_and_can_be_turned_is_named_once_with_its_file() {
        let picture =
            |caption: &str, file: &str| Picture { caption: caption.into(), file: Some(file.into()), png: vec![1] };
        let view = |caption: &str| Turned { caption: caption.into(), view: crate::view::tests_rig() };
        let mut page = page();
        page.blocks = vec![
            Block::Pictures(vec![picture("the best", "a_0.png"), picture("the worst", "a_1.png")]),
            Block::Views(vec![view("the best"), view("another")]),
        ];
        let listed = |text: String, mark: &str| -> Vec<String> {
            text.lines().filter_map(|line| Some(line.strip_prefix(mark)?.to_owned())).collect()
        };
        let all = ["Picture and view: the best (`a_0.png`)", "Picture: the worst (`a_1.png`)", "View: another"];
        assert_eq!(listed(page.to_markdown(), "- "), all);
        assert_eq!(listed(page.to_latex(), "% In the page: "), all);
    }

    #[test]
    fn tables_of_latex_have_labels_that_differ() {
        let mut page = page();
        page.blocks.push(page.blocks[2].clone());
        let text = page.to_latex();
        let labels: Vec<&str> = text.lines().filter(|l| l.starts_with("\\label")).collect();
        assert_eq!(labels, ["facts", "distances", "loss", "distances-2"].map(|l| format!("\\label{{tab:{l}}}")));
    }

    #[test]
    fn csv_has_the_number_of_what_readers_are_shown_a_bound_of() {
        let mut page = page();
        let Block::Table(table) = &mut page.blocks[2] else { panic!("a table") };
        table.row(vec![Cell::text("a_b"), Cell::text("p"), Cell::none().with_text("< 0.001").with_digits("2.500e-4")]);
        let last = table.rows.len() - 1;
        assert_eq!(table.to_csv().lines().nth(1 + last), Some("a_b,p,2.500e-4"));
        assert!(page.to_csv().contains("Distances,a_b / p,J2J,2.500e-4,0\r\n"), "{}", page.to_csv());
        assert!(page.to_markdown().contains("| a_b | p | < 0.001 |".replace('<', "\\<").as_str()));
    }

    #[test]
    fn no_two_lines_of_csv_are_of_the_same_table_row_and_column() {
        let mut table = Table::new("a", &["name", "x", "x"]);
        (0..3).for_each(|_| table.row(vec![Cell::text("b"), Cell::number(1.0, 0), Cell::number(2.0, 0)]));
        let page = Page {
            kind: crate::PageKind::Report,
            title: "t".into(),
            subtitle: "s".into(),
            blocks: vec![Block::Table(table.clone()), Block::Table(table)],
        };
        let csv = page.to_csv();
        let mut keys: Vec<&str> = csv.lines().map(|line| line.rsplitn(3, ',').last().unwrap()).collect();
        assert_eq!(keys[1..4], ["a,b,x", "a,b,x (2)", "a,b (2),x"]);
        keys.sort_unstable();
        keys.dedup();
        assert_eq!(keys.len(), 1 + 2 * 3 * 2);
    }

    #[test]
    fn csv_has_a_line_a_value_and_says_which_were_published() {
        let text = page().to_csv();
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "table,row,column,value,published");
        assert_eq!(lines[1], "Distances,\"a_b / x, y\",J2J,0.50,0");
        assert_eq!(lines[2], "Distances,a_b / theirs,J2J,1.50,1");
        assert_eq!(lines[3], "loss,loss,first,2,0");
        assert_eq!(lines.len(), 7);
    }
}
