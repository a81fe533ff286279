//! Bars across, a name and a number each.

use std::fmt::Write;

use crate::forms::figure;

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
        let told: Vec<String> = self.bars.iter().map(|(name, value)| format!("{name} {}", figure(*value))).collect();
        let mut svg = begun(WIDTH, height, &self.title, &told);
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

/// The beginning of an SVG element of that size, under a title, with what it tells whoever does not see it.
pub(crate) fn begun(width: f64, height: f64, title: &str, told: &[String]) -> String {
    // A long title has smaller letters, of a width of 0.56 of their size.
    let size = ((width - 16.0) / (0.56 * title.chars().count().max(1) as f64)).clamp(8.0, 15.0);
    format!(
        "<svg {} width=\"{width}\" height=\"{height}\" viewBox=\"0 0 {width} {height}\" xmlns=\"http://www.w3.org/2000/svg\" \
         font-family=\"sans-serif\" font-size=\"11\" fill=\"currentColor\">\n\
         <text x=\"{}\" y=\"18\" font-size=\"{size:.1}\" text-anchor=\"middle\">{}</text>\n",
        label(title, told),
        width / 2.0,
        escaped(title)
    )
}

/// Attributes of a picture for readers of screens: its title and what is in it, so many parts at most.
pub(crate) fn label(title: &str, told: &[String]) -> String {
    const PARTS: usize = 24;
    let left = told.len().saturating_sub(PARTS);
    let rest = if left > 0 { format!(", and {left} more") } else { String::new() };
    let parts = told.iter().take(PARTS).cloned().collect::<Vec<_>>().join(", ");
    let colon = if title.is_empty() || parts.is_empty() { "" } else { ": " };
    format!("role=\"img\" aria-label=\"{}\"", escaped(&format!("{title}{colon}{parts}{rest}")))
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
        assert!(svg.starts_with("<svg role=\"img\" aria-label=\"a &lt;b&gt;: x &amp; y 4, z 1, n NaN\""), "{svg}");
        assert!(svg.contains("x &amp; y") && svg.contains("a &lt;b&gt;") && svg.ends_with("</svg>"));
        assert!(svg.contains("font-size=\"15.0\" text-anchor=\"middle\">a &lt;b&gt;<"), "{svg}");
        let long = Bars { title: "t".repeat(80), ..bars }.to_svg();
        assert!(long.contains("font-size=\"12.1\" text-anchor=\"middle\">tttt"), "{long}");
        let many = vec!["x".to_owned(); 30];
        assert!(label("t", &many).ends_with("x, and 6 more\"") && label("", &[]).ends_with("aria-label=\"\""));
        assert_eq!(Bars { title: "t".into(), bars: vec![] }.to_svg(), "");
        assert!(Bars { title: "t".into(), bars: vec![("a".into(), 0.0)] }.to_svg().contains("width=\"0.0\""));
    }
}
