//! A page's charts as files of their own, for papers: each as SVG that needs no page around it, and its numbers.

use crate::bars::escaped;
use crate::unit::TIMES_100;
use crate::{Bars, Block, By, Chart, Dots, Page, ReportError, Table};

/// A chart as files.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Figure {
    /// What its files are called, without an ending: small letters, digits and hyphens, like no other of its page. It is
    /// made of the title alone, so that a chart has the same name in every report. What is measured is a curve, bars or
    /// dots, and these say so behind their title.
    pub name: String,
    /// A file of SVG: dark on white, with letters that every system has.
    pub svg: String,
    /// All its numbers as comma-separated values, to be drawn anew in another style.
    pub csv: String,
}

/// Letters of a name at most.
const NAME: usize = 60;
/// How wide figures are in points: a chart as one of two columns of a paper, names with bars or dots as the text of one
/// column.
const COLUMN: f64 = 240.0;
const TEXT: f64 = 345.0;
/// Letters of a figure: of the same width and without serifs wherever it is opened.
const FONTS: &str = "Helvetica, Arial, 'Liberation Sans', 'DejaVu Sans', sans-serif";

impl Page {
    /// All charts of the page, in its order; those without anything to show are left out, as in the page. Quantities that
    /// share a chart there have one each ([`Chart::apart`]).
    ///
    /// # Errors
    /// When a chart cannot be drawn.
    pub fn figures(&self) -> Result<Vec<Figure>, ReportError> {
        let mut out: Vec<Figure> = Vec::new();
        let mut titles: Vec<(String, &str)> = Vec::new();
        let mut add = |title: &str, kind: &'static str, width: f64, svg: String, csv: String| {
            if !svg.is_empty() {
                titles.push((title.to_owned(), kind));
                out.push(Figure { name: String::new(), svg: alone(&svg, title, width), csv });
            }
        };
        for block in &self.blocks {
            match block {
                Block::Charts(own) => {
                    for chart in own.iter().flat_map(singles) {
                        add(&chart.title, "", COLUMN, chart.to_svg_for_paper()?, points(chart));
                    }
                }
                Block::Bars(own) => own.iter().for_each(|b| add(&b.title, "-bars", TEXT, b.to_svg(), lengths(b))),
                Block::Dots(own) => own.iter().for_each(|d| add(&d.title, "-dots", TEXT, d.to_svg(), values(d))),
                _ => {}
            }
        }
        out.iter_mut().zip(names(&titles)).for_each(|(figure, name)| figure.name = name);
        Ok(out)
    }
}

/// What a chart's files are called by its title, as long as it is the only one of the page that is called so; bars and dots
/// have what they are behind it.
pub fn figure_name(title: &str) -> String {
    named(title)
}

/// A chart as files have it: one a quantity.
fn singles(chart: &Chart) -> &[Chart] {
    if chart.apart.is_empty() { std::slice::from_ref(chart) } else { &chart.apart }
}

/// An element of a page as a file: what it takes from the page becomes its own.
fn alone(svg: &str, title: &str, width: f64) -> String {
    let svg = svg.replace("currentColor", "#000000").replace("\"sans-serif\"", &format!("\"{FONTS}\""));
    let inner = svg.find('>').map_or(svg.len(), |at| at + 1);
    let (open, rest) = svg.split_at(inner);
    let open = sized(open, width);
    let own = format!("\n<title>{}</title>\n<rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>", escaped(title));
    let mut file = format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n{open}{own}{}\n", rest.trim_end());
    file.retain(in_xml);
    file
}

/// The beginning of an element whose width and height are in pixels with a width in points, and a height that fits.
fn sized(open: &str, width: f64) -> String {
    let value = |key: &str| {
        let start = open.find(&format!(" {key}=\""))? + key.len() + 3;
        let length = open[start..].find('"')?;
        Some((start..start + length, open[start..start + length].parse::<f64>().ok()?))
    };
    let (Some((wide, w)), Some((high, h))) = (value("width"), value("height")) else { return open.to_owned() };
    let mut out = open.to_owned();
    // From behind, so that places before stay what they are.
    let mut places = [(wide, width), (high, width * h / w)];
    places.sort_by_key(|(place, _)| std::cmp::Reverse(place.start));
    places.into_iter().for_each(|(place, points)| out.replace_range(place, &format!("{points:.1}pt")));
    out
}

/// Whether XML knows a letter: pages forgive others, files do not.
fn in_xml(c: char) -> bool {
    !matches!(c, '\0'..='\u{8}' | '\u{b}' | '\u{c}' | '\u{e}'..='\u{1f}' | '\u{fffe}' | '\u{ffff}')
}

/// Names of files for titles and what stands behind them.
///
/// A paper names its figures by these, so they hang on nothing else that the page shows: titles whose words are the same
/// are told apart by a sum of the whole title, not by their order. Only what has the very same title is numbered.
fn names(titles: &[(String, &str)]) -> Vec<String> {
    let plain: Vec<String> = titles.iter().map(|(title, kind)| named(title) + kind).collect();
    let mut out: Vec<String> = Vec::new();
    for ((title, kind), name) in titles.iter().zip(&plain) {
        let shared = titles.iter().zip(&plain).any(|((other, _), taken)| taken == name && other != title);
        let name = if shared { summed(&words(title), title) + kind } else { name.clone() };
        let numbered = (2..).map(|n| format!("{name}-{n}"));
        let mut free = std::iter::once(name.clone()).chain(numbered);
        // A number is no other title's word.
        let free = free.find(|n| !out.contains(n) && (*n == name || !plain.contains(n)));
        out.push(free.unwrap_or_default());
    }
    out
}

/// A title as the name of a file. Where letters are lost, since there are too many or they are none that every file system
/// takes, a sum of all stands behind the rest.
fn named(title: &str) -> String {
    // The unit is no part of what a chart is of: it is not the same in all reports.
    let title = title.replace(TIMES_100, "");
    let words = words(&title);
    let lost = words.is_empty() || words.len() > NAME || title.chars().any(|c| c.is_alphanumeric() && !c.is_ascii());
    if lost { summed(&words, &title) } else { words }
}

/// Letters and digits of a title, with hyphens between its words.
fn words(title: &str) -> String {
    let letter = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { ' ' };
    let words: String = title.chars().map(letter).collect();
    words.split_whitespace().collect::<Vec<_>>().join("-")
}

/// Words, as many as there is room for, and the first digits of the title's BLAKE3 sum.
fn summed(words: &str, title: &str) -> String {
    let sum = &blake3::hash(title.as_bytes()).to_hex()[..8];
    let short = words[..words.len().min(NAME - sum.len() - 1)].trim_end_matches('-');
    format!("{}-{sum}", if short.is_empty() { "chart" } else { short })
}

fn points(chart: &Chart) -> String {
    let y = if chart.y.is_empty() { "value" } else { &chart.y };
    let mut out = Table::csv_line(&["line", &chart.x, y]);
    for series in &chart.series {
        for (x, y) in series.points.iter().filter(|(x, y)| x.is_finite() && y.is_finite()) {
            out += &Table::csv_line(&[&series.name, &x.to_string(), &y.to_string()]);
        }
    }
    out
}

fn lengths(bars: &Bars) -> String {
    let mut out = Table::csv_line(&["name", "value"]);
    bars.bars.iter().for_each(|(name, value)| out += &Table::csv_line(&[name, &value.to_string()]));
    out
}

fn values(dots: &Dots) -> String {
    let by = dots.by.as_ref();
    let line = |name: &str, by: Option<&str>, value: &str| match by {
        Some(by) => Table::csv_line(&[name, by, value]),
        None => Table::csv_line(&[name, value]),
    };
    let mut out = line("name", by.map(|by| by.name.as_str()), "value");
    for (n, (name, own)) in dots.lines.iter().enumerate() {
        for (k, value) in own.iter().enumerate().filter(|(_, v)| v.is_finite()) {
            let label = |by: &By| by.of.get(n).and_then(|of| of.get(k)).cloned().unwrap_or_default();
            out += &line(name, by.map(label).as_deref(), &value.to_string());
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Series;

    fn chart(title: &str, name: &str) -> Chart {
        let line = Series { name: name.into(), points: vec![(1.0, 0.5), (2.0, f64::NAN), (3.0, 0.123_456_789)] };
        Chart { title: title.into(), x: "step".into(), series: vec![line.clone(), line], ..Chart::default() }
    }

    fn page(blocks: Vec<Block>) -> Page {
        Page { kind: crate::PageKind::Report, title: "t".into(), subtitle: "s".into(), blocks }
    }

    #[test]
    fn every_chart_becomes_a_file_that_needs_no_page() {
        let bars = Bars { title: "a & b".into(), bars: vec![("x <y>".into(), 2.0)] };
        let dots = Dots { title: "IoU".into(), lines: vec![("arm".into(), vec![0.5, 0.25])], digits: 2, by: None };
        let of = vec![vec!["3".into(), "7".into()]];
        let seeds = Dots { title: "L1".into(), by: Some(By { name: "seed".into(), of }), ..dots.clone() };
        let empty = Chart { title: "nothing".into(), ..Chart::default() };
        let charts = Block::Charts(vec![chart("loss \u{1}<1>", "one, \"two\" & <three>"), empty]);
        let figures = page(vec![charts, Block::Bars(vec![bars]), Block::Dots(vec![dots, seeds])]).figures().unwrap();
        assert_eq!(
            figures.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(),
            ["loss-1", "a-b-bars", "iou-dots", "l1-dots"]
        );
        for figure in &figures {
            let svg = &figure.svg;
            assert!(svg.starts_with("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<svg ") && svg.ends_with("</svg>\n"));
            assert!(
                svg.contains("xmlns=\"http://www.w3.org/2000/svg\"") && svg.contains("fill=\"#FFFFFF\"/>"),
                "{svg}"
            );
            let width = if figure.name == "loss-1" { "240.0pt" } else { "345.0pt" };
            assert!(svg.contains(&format!(" width=\"{width}\" height=\"")) && svg.contains(" viewBox=\"0 0 "), "{svg}");
            assert!(!svg.contains("currentColor") && !svg.contains("\"sans-serif\"") && svg.contains("Helvetica"));
        }
        assert!(figures[0].svg.contains("<title>loss &lt;1&gt;</title>"));
        assert_eq!(figures[0].csv.lines().nth(1), Some("\"one, \"\"two\"\" & <three>\",1,0.5"));
        assert!(figures[0].csv.contains(",3,0.123456789\r\n") && !figures[0].csv.contains("NaN"));
        assert_eq!(figures[1].csv, "name,value\r\nx <y>,2\r\n");
        assert_eq!(figures[2].csv, "name,value\r\narm,0.5\r\narm,0.25\r\n");
        assert_eq!(figures[3].csv, "name,seed,value\r\narm,3,0.5\r\narm,7,0.25\r\n");
    }

    #[test]
    fn figures_are_xml() {
        let odd = "</svg>\u{0}\u{8}\u{fffe} & \"quoted\" <a> 骨 \u{1b}[0m";
        let charts = Block::Charts(vec![Chart { y: odd.into(), note: odd.into(), ..chart(odd, odd) }]);
        let bars = Block::Bars(vec![Bars { title: odd.into(), bars: vec![(odd.into(), 1.0)] }]);
        let dots =
            Block::Dots(vec![Dots { title: odd.into(), lines: vec![(odd.into(), vec![1.0])], digits: 1, by: None }]);
        for figure in page(vec![charts, bars, dots]).figures().unwrap() {
            let mut depth = 0;
            // Every element is closed, and no letter is one that XML does not have.
            for tag in figure.svg.split('<').skip(2) {
                let (tag, text) = tag.split_once('>').unwrap();
                assert!(!text.contains('>'), "{text}");
                depth += if tag.starts_with('/') { -1 } else { i32::from(!tag.ends_with('/')) };
            }
            assert_eq!(depth, 0, "{}", figure.svg);
            let bad = |c: char| (c < ' ' && !matches!(c, '\t' | '\n' | '\r')) || matches!(c, '\u{fffe}' | '\u{ffff}');
            assert!(!figure.svg.contains(bad), "{:?}", figure.svg);
        }
    }

    fn names_of(titles: &[&str]) -> Vec<String> {
        let charts = titles.iter().map(|title| chart(title, "x")).collect();
        page(vec![Block::Charts(charts)]).figures().unwrap().into_iter().map(|figure| figure.name).collect()
    }

    #[test]
    fn names_are_told_apart_and_never_empty() {
        let long = "long ".repeat(40);
        let names = names_of(&["a", "a-2", "a", "骨", "骨格", "", &long, &(long.clone() + "er"), "loss", "loss"]);
        assert_eq!(names[..3], ["a", "a-2", "a-3"]);
        assert!(names[3..6].iter().all(|name| name.starts_with("chart-")), "{names:?}");
        assert!(names[6..8].iter().all(|name| name.starts_with("long-long") && name.len() <= NAME), "{names:?}");
        assert_eq!(names[8..], ["loss", "loss-2"]);
        let set: std::collections::BTreeSet<&String> = names.iter().collect();
        assert_eq!(set.len(), names.len(), "{names:?}");
    }

    #[test]
    fn a_chart_has_one_name_whatever_is_beside_it() {
        let long = "IoU of what was validated in the end, pooled over all bones, by codes kept";
        let titles =
            ["train/loss", "eval/iou@val", "eval/j2j × 100@val", "骨", &format!("{long}, a"), &format!("{long}, b")];
        let all = names_of(&titles);
        assert_eq!(all[..3], ["train-loss", "eval-iou-val", "eval-j2j-val"]);
        for (title, name) in titles.iter().zip(&all) {
            assert_eq!(names_of(&[title])[0], *name);
        }
        let mut turned = titles;
        turned.reverse();
        assert!(names_of(&turned).iter().eq(all.iter().rev()));
        // Of words that are the same, none takes the other's name when their order changes.
        let (one, other) = (names_of(&["a b", "A/b"]), names_of(&["A/b", "a b"]));
        assert!(one[0] == other[1] && one[1] == other[0] && one[0] != one[1], "{one:?} {other:?}");
    }

    #[test]
    fn what_shares_a_chart_in_a_page_has_a_file_each() {
        let apart = vec![chart("train/bce", "bce"), chart("train/mse", "mse")];
        let charts = vec![Chart { apart, ..chart("in a step: bce, mse", "bce") }];
        let figures = page(vec![Block::Charts(charts)]).figures().unwrap();
        assert_eq!(figures.iter().map(|f| f.name.as_str()).collect::<Vec<_>>(), ["train-bce", "train-mse"]);
        assert!(figures[1].svg.contains("<title>train/mse</title>") && figures[1].csv.contains("\r\nmse,1,0.5"));
    }
}
