//! Bars across, a name and a number each.

use std::fmt::Write;

/// Counts by name.
#[derive(Clone, Debug)]
pub struct Bars {
    /// What they show.
    pub title: String,
    /// Name and value of each, from the top; values that are no finite number above 0 have no bar.
    pub bars: Vec<(String, f64)>,
}

const WIDTH: f64 = 560.0;
/// Where bars begin, and how far the longest reaches.
const LEFT: f64 = 150.0;
const REACH: f64 = 350.0;
const ROW: f64 = 18.0;
const TOP: f64 = 30.0;

impl Bars {
    /// An SVG element that takes its text colour from the page; nothing without bars.
    pub fn to_svg(&self) -> String {
        if self.bars.is_empty() {
            return String::new();
        }
        let shown = |v: f64| if v.is_finite() && v > 0.0 { v } else { 0.0 };
        let most = self.bars.iter().map(|b| shown(b.1)).fold(0.0, f64::max);
        let height = TOP + ROW * self.bars.len() as f64 + 8.0;
        let mut svg = begun(WIDTH, height, &self.title);
        for (k, (name, value)) in self.bars.iter().enumerate() {
            let y = TOP + ROW * k as f64;
            let length = if most > 0.0 { REACH * shown(*value) / most } else { 0.0 };
            let (text, end) = (y + 12.0, LEFT + length + 6.0);
            // Writing to a String does not fail.
            let _ = writeln!(
                svg,
                "<text x=\"{}\" y=\"{text}\" text-anchor=\"end\">{}</text>\
                 <rect x=\"{LEFT}\" y=\"{}\" width=\"{length:.1}\" height=\"{}\" fill=\"#1f77b4\"/>\
                 <text x=\"{end:.1}\" y=\"{text}\">{value}</text>",
                LEFT - 8.0,
                escaped(name),
                y + 2.0,
                ROW - 5.0,
            );
        }
        svg + "</svg>"
    }
}

/// The beginning of an SVG element of that size, under a title.
pub(crate) fn begun(width: f64, height: f64, title: &str) -> String {
    format!(
        "<svg width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" xmlns=\"http://www.w3.org/2000/svg\" \
         font-family=\"sans-serif\" font-size=\"11\" fill=\"currentColor\">\n\
         <text x=\"{}\" y=\"18\" font-size=\"15\" text-anchor=\"middle\">{}</text>\n",
        width / 2.0,
        escaped(title)
    )
}

/// As text of an element.
pub(crate) fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_longest_bar_reaches_the_end_and_names_are_escaped() {
        let bars = Bars {
            title: "a <b>".into(),
            bars: vec![("x & y".into(), 4.0), ("z".into(), 1.0), ("n".into(), f64::NAN)],
        };
        let svg = bars.to_svg();
        assert!(svg.contains("width=\"350.0\"") && svg.contains("width=\"87.5\"") && svg.contains("width=\"0.0\""));
        assert!(svg.contains("x &amp; y") && svg.contains("a &lt;b&gt;") && svg.ends_with("</svg>"));
        assert_eq!(Bars { title: "t".into(), bars: vec![] }.to_svg(), "");
        assert!(Bars { title: "t".into(), bars: vec![("a".into(), 0.0)] }.to_svg().contains("width=\"0.0\""));
    }
}
