//! Reports: tables, charts and pictures in one self-contained page.
//!
//! A [`Page`] is a list of blocks that any command can fill; [`Page::to_html`] turns it into one
//! HTML file that works offline, in light and dark, on a phone and on a wide screen.
//!
//! The same page can be Markdown, LaTeX and comma-separated values; so can a [`Table`] alone, and text for a terminal.
//! Its charts can be files of their own ([`Page::figures`]), for a paper.
//!
//! [`RunView`] reads what every run folder holds; what is special to a task, the task adds. A task also fills
//! [`Findings`], from which come spread, categories, published numbers, and the comparison of several runs
//! ([`versus`]).
//!
//! Holds: no network request, and no script but that of [`Turntable`]s, rigs that a reader can turn; every text is escaped.
//! Leaves out: what the numbers mean, where they come from.

mod bars;
mod chart;
mod columns;
mod dots;
mod evaluated;
mod figures;
mod findings;
mod forms;
mod glossary;
mod labels;
mod losses;
mod page;
mod plain;
pub mod published;
mod run;
pub mod shell;
mod table;
mod ticks;
mod unit;
mod versus;
mod view;

pub use bars::Bars;
pub use chart::{Chart, Series};
pub use columns::Columns;
pub use dots::{By, Dots};
pub use evaluated::{Checkpoints, OwnCut, own_cut, own_cuts, speaks_for};
pub use figures::{Figure, figure_name};
pub use findings::{Beside, Findings, Metric, Single, Total};
pub use glossary::explained;
pub use losses::Losses;
pub use page::{Block, Page, PageKind, Picture, ReportError, Turned};
pub use run::{RunError, RunView};
pub use table::{Cell, Table};
pub use unit::{TIMES_100, in_unit, told};
pub use versus::{Compared, Refusal, versus};
pub use view::Turntable;

/// "1 joint", "2 joints".
pub fn counted(n: usize, what: &str) -> String {
    format!("{n} {what}{}", if n == 1 { "" } else { "s" })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_no_plural() {
        assert_eq!([0, 1, 2].map(|n| counted(n, "thread")), ["0 threads", "1 thread", "2 threads"]);
    }
}
