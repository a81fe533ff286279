//! Dots on a line, a line a name: how far apart repeated measurements lie, beside the differences between names.

use std::fmt::Write;

use crate::bars::{begun, escaped};
use crate::labels::fitted;

/// Repeated measurements by name, on one axis.
#[derive(Clone, Debug, Default)]
pub struct Dots {
    /// What was measured.
    pub title: String,
    /// Name and measurements of each line, from the top; values that are not finite are left out.
    pub lines: Vec<(String, Vec<f64>)>,
    /// Digits after the point of the numbers beside the lines.
    pub digits: usize,
    /// What tells the measurements of a line apart, where something does.
    pub by: Option<By>,
}

/// What tells repeated measurements apart, such as seeds.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct By {
    /// What it is called.
    pub name: String,
    /// What it is of each measurement of each line, in their order.
    pub of: Vec<Vec<String>>,
}

const WIDTH: f64 = 560.0;
/// Where the axis begins and ends; means stand behind it.
const AXIS: (f64, f64) = (170.0, 480.0);
const ROW: f64 = 20.0;
const TOP: f64 = 30.0;
/// Letters of a name beside its line at most; longer ones stand above the lines, of so many letters.
const LETTERS: (usize, usize) = (28, 84);

impl Dots {
    /// An SVG element that takes its text colour from the page; nothing without values. The axis reaches from the least
    /// value to the most, not from zero; a stroke marks each line's mean.
    pub fn to_svg(&self) -> String {
        let finite: Vec<(&str, Vec<f64>)> = self
            .lines
            .iter()
            .map(|(name, own)| (name.as_str(), own.iter().copied().filter(|v| v.is_finite()).collect()))
            .collect();
        let all = || finite.iter().flat_map(|(_, own)| own.iter().copied());
        let (least, most) = (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
        // Halves, because the difference of two finite numbers need not be finite.
        if !(least / 2.0).is_finite() || !(most / 2.0 - least / 2.0).is_finite() {
            return String::new();
        }
        let span = most / 2.0 - least / 2.0;
        let place = |v: f64| {
            let share = if span > 0.0 { (v / 2.0 - least / 2.0) / span } else { 0.5 };
            AXIS.0 + share * (AXIS.1 - AXIS.0)
        };
        let digits = self.digits;
        let names: Vec<&str> = finite.iter().map(|(name, _)| *name).collect();
        let above = names.iter().any(|name| name.chars().count() > LETTERS.0);
        let names = fitted(&names, if above { LETTERS.1 } else { LETTERS.0 });
        let row = if above { 2.0 * ROW } else { ROW };
        let bottom = TOP + row * finite.len() as f64 + 4.0;
        let height = bottom + 38.0;
        let told = finite.iter().map(|(name, own)| match own.len() {
            0 => format!("{name} without a value"),
            1 => format!("{name} {:.digits$}", mean(own)),
            n => format!("{name} {:.digits$}, the mean of {n}", mean(own)),
        });
        let mut svg = begun(WIDTH, height, &self.title, &told.collect::<Vec<_>>());
        for (k, ((_, own), name)) in finite.iter().zip(names).enumerate() {
            let y = TOP + row * (k + 1) as f64 - ROW / 2.0;
            let (x, up, anchor) = if above { (12.0, 14.0, "start") } else { (AXIS.0 - 12.0, -4.0, "end") };
            // Writing to a String does not fail.
            let _ = write!(
                svg,
                "<text x=\"{x}\" y=\"{:.1}\" text-anchor=\"{anchor}\">{}</text>\
                 <line x1=\"{}\" y1=\"{y:.1}\" x2=\"{}\" y2=\"{y:.1}\" stroke=\"currentColor\" stroke-opacity=\"0.2\"/>",
                y - up,
                escaped(&name),
                AXIS.0,
                AXIS.1,
            );
            for v in own {
                let _ = write!(
                    svg,
                    "<circle cx=\"{:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"#1f77b4\" fill-opacity=\"0.6\"/>",
                    place(*v)
                );
            }
            if own.is_empty() {
                let _ = writeln!(svg, "<text x=\"{}\" y=\"{:.1}\">–</text>", AXIS.1 + 12.0, y + 4.0);
                continue;
            }
            let mean = mean(own);
            let _ = writeln!(
                svg,
                "<line x1=\"{0:.1}\" y1=\"{1:.1}\" x2=\"{0:.1}\" y2=\"{2:.1}\" stroke=\"#e17000\" stroke-width=\"2\"/>\
                 <text x=\"{3}\" y=\"{4:.1}\">{mean:.digits$}</text>",
                place(mean),
                y - 7.0,
                y + 7.0,
                AXIS.1 + 12.0,
                y + 4.0,
            );
        }
        let ends = if span > 0.0 { vec![least, most] } else { vec![least] };
        for end in ends {
            let _ = write!(
                svg,
                "<text x=\"{:.1}\" y=\"{:.1}\" text-anchor=\"middle\" fill-opacity=\"0.7\">{end:.digits$}</text>",
                place(end),
                bottom + 11.0,
            );
        }
        svg + &key(bottom + 28.0) + "</svg>"
    }
}

/// Of values whose sum need not be finite.
fn mean(own: &[f64]) -> f64 {
    own.iter().map(|v| v / own.len() as f64).sum()
}

/// What dots and strokes are, on a line of that height.
fn key(y: f64) -> String {
    let (dot, stroke) = (AXIS.0 + 4.0, AXIS.0 + 104.0);
    format!(
        "<circle cx=\"{dot}\" cy=\"{y:.1}\" r=\"4\" fill=\"#1f77b4\" fill-opacity=\"0.6\"/>\
         <text x=\"{}\" y=\"{text:.1}\">one value</text>\
         <line x1=\"{stroke}\" y1=\"{:.1}\" x2=\"{stroke}\" y2=\"{:.1}\" stroke=\"#e17000\" stroke-width=\"2\"/>\
         <text x=\"{}\" y=\"{text:.1}\">their mean, the number on the right</text>",
        dot + 10.0,
        y - 7.0,
        y + 7.0,
        stroke + 10.0,
        text = y + 4.0,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_axis_reaches_from_the_least_to_the_most() {
        let dots = Dots {
            title: "a <b>".into(),
            lines: vec![("x & y".into(), vec![0.5, 0.7, f64::NAN]), ("none".into(), vec![]), ("z".into(), vec![0.9])],
            digits: 2,
            ..Dots::default()
        };
        let svg = dots.to_svg();
        assert_eq!(svg.matches("<circle").count(), 3 + 1, "and one in the key");
        assert!(
            svg.contains("aria-label=\"a &lt;b&gt;: x &amp; y 0.60, the mean of 2, none without a value, z 0.90\"")
        );
        assert!(svg.contains("cx=\"170.0\"") && svg.contains("cx=\"325.0\"") && svg.contains("cx=\"480.0\""), "{svg}");
        assert!(
            svg.contains("a &lt;b&gt;") && svg.contains("x &amp; y") && svg.contains(">0.60<") && svg.contains(">–<")
        );
    }

    #[test]
    fn nothing_one_value_and_extremes_are_drawn_or_left_out() {
        let of = |values: Vec<f64>| {
            Dots { title: "t".into(), lines: vec![("n".repeat(99), values)], digits: 3, by: None }.to_svg()
        };
        assert_eq!(of(vec![]), "");
        assert_eq!(of(vec![f64::INFINITY]), "");
        assert!(of(vec![2.0]).contains("cx=\"325.0\""));
        let wide = of(vec![f64::MIN, f64::MAX]);
        assert!(!wide.contains("NaN") && !wide.contains("inf") && wide.contains("…"));
    }

    #[test]
    fn long_names_stand_whole_above_their_lines() {
        let names = ["baseline, as in the paper, dice=0.5", "baseline, as in the paper, dice=2.0"];
        let lines = names.map(|name| (name.to_owned(), vec![1.0, 2.0])).to_vec();
        let svg = Dots { title: "t".into(), lines, digits: 1, by: None }.to_svg();
        assert!(names.iter().all(|name| svg.contains(&format!("text-anchor=\"start\">{name}<"))), "{svg}");
        assert!(svg.contains("their mean"));
    }
}
