//! A page of blocks.

use base64::Engine;
use minijinja::value::Serde;
use minijinja::{Environment, Value, context};
use thiserror::Error;

use crate::bars::Bars;
use crate::chart::Chart;
use crate::table::Table;

/// Why a page cannot be made.
#[derive(Debug, Error)]
pub enum ReportError {
    /// A chart failed.
    #[error("a chart cannot be drawn: {0}")]
    Chart(String),
    /// The template failed: a fault of this crate.
    #[error("the page cannot be built: {0}")]
    Template(String),
}

/// A picture with a caption.
#[derive(Clone, Debug)]
pub struct Picture {
    /// What it shows.
    pub caption: String,
    /// The bytes of a PNG file.
    pub png: Vec<u8>,
}

/// A part of a page.
#[derive(Clone, Debug)]
pub enum Block {
    /// A heading.
    Heading(String),
    /// A paragraph.
    Text(String),
    /// Short facts: name and value.
    Facts(Vec<(String, String)>),
    /// A table.
    Table(Table),
    /// Charts side by side.
    Charts(Vec<Chart>),
    /// Bars side by side.
    Bars(Vec<Bars>),
    /// Pictures below each other, full width.
    Pictures(Vec<Picture>),
    /// Commands to copy.
    Code(String),
    /// Something long, folded away under a title.
    Folded(String, String),
}

/// A page with a title.
#[derive(Clone, Debug)]
pub struct Page {
    /// The title.
    pub title: String,
    /// One sentence below it.
    pub subtitle: String,
    /// The parts.
    pub blocks: Vec<Block>,
}

impl Page {
    /// The whole page as one HTML file.
    ///
    /// # Errors
    /// When a chart cannot be drawn.
    pub fn to_html(&self) -> Result<String, ReportError> {
        let blocks = self.blocks.iter().map(block).collect::<Result<Vec<_>, _>>()?;
        let mut env = Environment::new();
        env.add_template("page.html", include_str!("page.html")).map_err(fault)?;
        let page = env.get_template("page.html").map_err(fault)?;
        page.render(context! { title => self.title.as_str(), subtitle => self.subtitle.as_str(), blocks })
            .map_err(fault)
    }
}

fn block(block: &Block) -> Result<Value, ReportError> {
    Ok(match block {
        Block::Heading(text) => context! { kind => "heading", text => text.as_str() },
        Block::Text(text) => context! { kind => "text", text => text.as_str() },
        Block::Facts(facts) => context! { kind => "facts", facts => Value::from(Serde(facts)) },
        Block::Table(table) => context! { kind => "table", table => Value::from(Serde(table)) },
        Block::Charts(charts) => {
            let drawn = charts.iter().map(Chart::to_svg).collect::<Result<Vec<_>, _>>()?;
            let drawn: Vec<Value> = drawn.into_iter().filter(|s| !s.is_empty()).map(Value::from_safe_string).collect();
            context! { kind => "charts", charts => drawn }
        }
        Block::Bars(bars) => {
            let drawn = bars.iter().map(Bars::to_svg).filter(|s| !s.is_empty()).map(Value::from_safe_string);
            context! { kind => "charts", charts => drawn.collect::<Vec<_>>() }
        }
        Block::Pictures(pictures) => {
            let encode = |p: &Picture| {
                let png = base64::engine::general_purpose::STANDARD.encode(&p.png);
                context! { caption => p.caption.as_str(), png }
            };
            context! { kind => "pictures", pictures => pictures.iter().map(encode).collect::<Vec<_>>() }
        }
        Block::Code(text) => context! { kind => "code", text => text.as_str() },
        Block::Folded(title, text) => context! { kind => "folded", title => title.as_str(), text => text.as_str() },
    })
}

fn fault(e: minijinja::Error) -> ReportError {
    ReportError::Template(e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Cell;

    #[test]
    fn a_page_is_self_contained_and_escapes_what_it_is_given() {
        let mut table = Table::new("a & b", &["<x>", "y"]);
        table.row(vec![Cell::text("<script>"), Cell::number(0.5, 3).strong_if(true)]);
        let page = Page {
            title: "T <b>".into(),
            subtitle: "s".into(),
            blocks: vec![
                Block::Heading("h".into()),
                Block::Table(table),
                Block::Facts(vec![("k".into(), "v".into())]),
                Block::Pictures(vec![Picture { caption: "c".into(), png: vec![1, 2, 3] }]),
                Block::Folded("more".into(), "text".into()),
            ],
        };
        let html = page.to_html().unwrap();
        assert!(html.contains("&lt;script&gt;") && !html.contains("<script"));
        assert!(html.contains("data:image/png;base64,AQID") && html.contains("0.500"));
        assert!(!html.contains("http://") && !html.contains("https://"));
    }
}
