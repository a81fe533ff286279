//! A page of blocks.

use base64::Engine;
use minijinja::value::Serde;
use minijinja::{Environment, Value, context};
use thiserror::Error;

use crate::bars::Bars;
use crate::chart::Chart;
use crate::dots::Dots;
use crate::table::Table;
use crate::ticks;
use crate::view::{Turntable, script};

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
    /// What its file is called, where it has one beside the page.
    pub file: Option<String>,
    /// The bytes of a PNG file.
    pub png: Vec<u8>,
}

/// A rig that a reader can turn, with a caption.
#[derive(Clone, Debug)]
pub struct Turned {
    /// What it shows.
    pub caption: String,
    /// The rig, or several of one mesh.
    pub view: Turntable,
}

/// Bytes of a page's views at most; those beyond are left out and counted.
const VIEWS: usize = 9 << 20;

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
    /// Rows for a spreadsheet alone, too many for a page: see [`Page::sheet`].
    Sheet(Table),
    /// Charts side by side.
    Charts(Vec<Chart>),
    /// Bars side by side.
    Bars(Vec<Bars>),
    /// Repeated measurements, one picture below the other or side by side.
    Dots(Vec<Dots>),
    /// Pictures below each other, full width.
    Pictures(Vec<Picture>),
    /// Rigs to be turned, side by side where there is room.
    Views(Vec<Turned>),
    /// Commands to copy.
    Code(String),
    /// Something long, folded away under a title.
    Folded(String, String),
}

/// What a page tells of. Its HTML says so, or one command would take another's page for an earlier one of its own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PageKind {
    /// Of runs.
    Report,
    /// Of predictions and true rigs.
    Comparison,
    /// Of rigs by rewards.
    Rewards,
    /// Of a sweep.
    Sweep,
    /// Of a curation.
    Curation,
}

impl PageKind {
    const MARK: &str = "<meta name=\"riglab\" content=\"";

    fn name(self) -> &'static str {
        match self {
            Self::Report => "report",
            Self::Comparison => "comparison",
            Self::Rewards => "rewards",
            Self::Sweep => "sweep",
            Self::Curation => "curation",
        }
    }

    /// Whether a file is a page of this kind. Of one that was written before pages said theirs the title tells, as far as it
    /// does: that of several runs is called as a comparison is, and others have titles of their own.
    pub fn is(self, html: &str) -> bool {
        if !html.starts_with("<!doctype html>") || !html.contains("content=\"default-src 'none'; img-src data:") {
            return false;
        }
        let head = html.split("</title>").next().unwrap_or_default();
        if let Some((_, mark)) = head.split_once(Self::MARK) {
            return mark.split('"').next() == Some(self.name());
        }
        match (self, head.rsplit('>').next().unwrap_or_default()) {
            (Self::Comparison | Self::Report, "Comparison") | (Self::Rewards, "Rewards") => true,
            (Self::Curation, "Curation") => true,
            (Self::Report | Self::Sweep, title) => !["Comparison", "Rewards", "Curation"].contains(&title),
            _ => false,
        }
    }
}

/// A page with a title.
#[derive(Clone, Debug)]
pub struct Page {
    /// What it tells of.
    pub kind: PageKind,
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
        let mut room = VIEWS;
        let blocks = self.blocks.iter().map(|b| block(b, &mut room)).collect::<Result<Vec<_>, _>>()?;
        let script = if room < VIEWS { Value::from_safe_string(script()) } else { Value::from("") };
        let mut env = Environment::new();
        env.add_template("page.html", include_str!("page.html")).map_err(fault)?;
        env.add_filter("code", |text: &str| Value::from_safe_string(ticks::html(text)));
        let page = env.get_template("page.html").map_err(fault)?;
        let (kind, title, subtitle) = (self.kind.name(), self.title.as_str(), self.subtitle.as_str());
        page.render(context! { kind, title, subtitle, blocks, script }).map_err(fault)
    }
}

/// A block for the template; `room` is how many bytes of views the page can still take.
fn block(block: &Block, room: &mut usize) -> Result<Value, ReportError> {
    Ok(match block {
        Block::Heading(text) => context! { kind => "heading", text => text.as_str() },
        Block::Text(text) => context! { kind => "text", text => text.as_str() },
        Block::Facts(facts) => context! { kind => "facts", facts => Value::from(Serde(facts)) },
        Block::Table(table) => {
            let right: Vec<bool> = (0..table.head.len()).map(|k| table.is_number(k)).collect();
            context! { kind => "table", table => Value::from(Serde(table)), right }
        }
        Block::Sheet(_) => context! { kind => "sheet" },
        Block::Charts(charts) => {
            let drawn = charts.iter().map(Chart::to_svg).collect::<Result<Vec<_>, _>>()?;
            let drawn: Vec<Value> = drawn.into_iter().filter(|s| !s.is_empty()).map(Value::from_safe_string).collect();
            context! { kind => "charts", charts => drawn }
        }
        Block::Bars(bars) => {
            let drawn = bars.iter().map(Bars::to_svg).filter(|s| !s.is_empty()).map(Value::from_safe_string);
            context! { kind => "charts", charts => drawn.collect::<Vec<_>>() }
        }
        Block::Dots(dots) => {
            let drawn = dots.iter().map(Dots::to_svg).filter(|s| !s.is_empty()).map(Value::from_safe_string);
            context! { kind => "charts", charts => drawn.collect::<Vec<_>>() }
        }
        Block::Pictures(pictures) => {
            let encode = |p: &Picture| {
                context! { caption => p.caption.as_str(), png => base64(&p.png) }
            };
            context! { kind => "pictures", pictures => pictures.iter().map(encode).collect::<Vec<_>>() }
        }
        Block::Views(views) => {
            let mut shown = Vec::new();
            for turned in views {
                let data = base64(turned.view.to_bytes());
                let titles: Vec<String> =
                    turned.view.versions().unwrap_or_default().into_iter().map(|(title, _)| title).collect();
                let bytes = data.len().unwrap_or(0);
                if bytes > *room || titles.is_empty() {
                    continue;
                }
                *room -= bytes;
                let same = turned.view.same_joints();
                shown.push(context! { caption => turned.caption.as_str(), titles, same, data });
            }
            let left_out = views.len() - shown.len();
            context! { kind => "views", views => shown, left_out }
        }
        Block::Code(text) => context! { kind => "code", text => text.as_str() },
        Block::Folded(title, text) => context! { kind => "folded", title => title.as_str(), text => text.as_str() },
    })
}

/// Bytes as letters that need no escapes, neither in an attribute nor in a script.
fn base64(bytes: &[u8]) -> Value {
    Value::from_safe_string(base64::engine::general_purpose::STANDARD.encode(bytes))
}

fn fault(e: minijinja::Error) -> ReportError {
    ReportError::Template(e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Cell;

    #[test]
    fn a_page_with_views_has_the_script_once_and_no_more_than_it_can_take() {
        let view = crate::view::tests_rig();
        let turned = |n: usize| Block::Views(vec![Turned { caption: "c <i>".into(), view: view.clone() }; n]);
        let kind = PageKind::Report;
        let html = |blocks| Page { kind, title: "t".into(), subtitle: "s".into(), blocks }.to_html().unwrap();
        let page = html(vec![turned(1), turned(2)]);
        assert_eq!((page.matches("<canvas").count(), page.matches("PALETTES = ").count()), (3, 1));
        assert!(page.contains("c &lt;i&gt;") && page.contains("Misplaced weight"));
        // The data cannot end its element, and what cannot be asked for is forbidden besides.
        assert!(!page.contains("b </script>") && page.contains("default-src 'none'"));
        assert!(!page.contains("http://") && !page.contains("https://"));
        let mut room = 1000;
        let taken = block(&turned(9), &mut room).unwrap().to_string();
        assert!(room < 1000 && taken.contains("left_out") && !taken.contains("\"left_out\": 0"), "{taken}");
    }

    #[test]
    fn a_page_says_what_it_tells_of() {
        use PageKind::{Comparison, Curation, Report, Rewards, Sweep};
        let all = [Report, Comparison, Rewards, Sweep, Curation];
        let html = |kind, title: &str| {
            let page = Page { kind, title: title.into(), subtitle: "s".into(), blocks: Vec::new() };
            page.to_html().unwrap()
        };
        let taken = |html: &str| all.into_iter().filter(|kind| kind.is(html)).collect::<Vec<_>>();
        for kind in all {
            assert_eq!(taken(&html(kind, "Comparison")), [kind]);
        }
        let old = |title: &str| html(Report, title).replace("<meta name=\"riglab\" content=\"report\">\n", "");
        assert!(!old("t").contains("\"riglab\""));
        assert_eq!(taken(&old("Comparison")), [Report, Comparison]);
        assert_eq!(taken(&old("Rewards")), [Rewards]);
        assert_eq!(taken(&old("Curation")), [Curation]);
        assert_eq!(taken(&old("runs/a &amp; b")), [Report, Sweep]);
        assert_eq!(taken("<!doctype html>\n<title>Rewards</title>"), []);
    }

    #[test]
    fn a_page_is_self_contained_and_escapes_what_it_is_given() {
        let mut table = Table::new("a & b", &["<x>", "y"]);
        table.row(vec![Cell::text("<script>"), Cell::number(0.5, 3).strong_if(true)]);
        let page = Page {
            kind: PageKind::Report,
            title: "T <b>".into(),
            subtitle: "s".into(),
            blocks: vec![
                Block::Heading("h".into()),
                Block::Text("see `a <b>`".into()),
                Block::Table(table),
                Block::Facts(vec![("k".into(), "v".into())]),
                Block::Pictures(vec![Picture { caption: "c".into(), file: None, png: vec![1, 2, 3] }]),
                Block::Folded("more".into(), "text".into()),
            ],
        };
        let html = page.to_html().unwrap();
        assert!(html.contains("&lt;script&gt;") && !html.contains("<script"));
        assert!(html.contains("data:image/png;base64,AQID") && html.contains("0.500"));
        assert!(html.contains("<p>see <code>a &lt;b&gt;</code></p>"));
        // Only what is no number may take several lines; a caption is no wider than the screen.
        assert!(html.contains("<td class=\"\"><span>&lt;script&gt;</span></td><td class=\"number strong\">0.500</td>"));
        assert!(html.contains("<caption><span>a &amp; b</span></caption>"));
        assert!(!html.contains("http://") && !html.contains("https://"));
    }
}
