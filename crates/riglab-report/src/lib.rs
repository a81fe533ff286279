//! Reports: tables, charts and pictures in one self-contained page.
//!
//! A [`Page`] is a list of blocks that any command can fill; [`Page::to_html`] turns it into one
//! HTML file that works offline, in light and dark, on a phone and on a wide screen.
//!
//! A [`Table`] alone can be text, Markdown, LaTeX and comma-separated values, too.
//!
//! [`RunView`] reads what every run folder holds; what is special to a task, the task adds.
//!
//! Holds: no network request, no script; every text is escaped.
//! Leaves out: what the numbers mean, where they come from.

mod bars;
mod chart;
mod page;
mod plain;
pub mod published;
mod run;
mod table;

pub use bars::Bars;
pub use chart::{Chart, Series};
pub use page::{Block, Page, Picture, ReportError};
pub use run::RunView;
pub use table::{Cell, Table};
