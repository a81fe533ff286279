//! Line charts as SVG.

use plotters::element::DashedPathElement;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use crate::ReportError;
use crate::bars::label;
use crate::forms::figure;
use crate::labels::fitted;

/// One line.
#[derive(Clone, Debug)]
pub struct Series {
    /// What it is.
    pub name: String,
    /// Its points; non-finite ones are left out.
    pub points: Vec<(f64, f64)>,
}

/// Lines over one axis.
#[derive(Clone, Debug, Default)]
pub struct Chart {
    /// What it shows.
    pub title: String,
    /// The horizontal axis.
    pub x: String,
    /// The lines.
    pub series: Vec<Series>,
    /// A vertical axis by ratios, where values lie so far apart that it helps, and all above 0: it has no place for others.
    pub log: bool,
    /// The vertical axis; empty where the title says it. One by ratios says so besides.
    pub y: String,
    /// What has to be known to read it, below the lines' names; often empty.
    pub note: String,
    /// The same as charts of their own, one a quantity, where a page draws several quantities in one to save room; else
    /// empty. These are what become files ([`Page::figures`](crate::Page::figures)): which quantities share a chart
    /// depends on their sizes, and so on the run.
    pub apart: Vec<Chart>,
}

/// Distinct on white and on black, also for the colour-blind.
const COLORS: [RGBColor; 6] = [
    RGBColor(31, 119, 180),
    RGBColor(225, 112, 0),
    RGBColor(0, 145, 110),
    RGBColor(205, 60, 95),
    RGBColor(125, 95, 200),
    RGBColor(130, 130, 130),
];
/// Dashes and gaps of the lines that come after as many as there are colours, and of those after these. Each shows in the
/// legend's short line. Of four times as many lines as colours no two look alike.
const DASHES: [(i32, i32); 3] = [(7, 4), (3, 3), (11, 2)];
/// Lines of which so large a share is no farther apart than so many pixels lie on each other.
const ON_EACH_OTHER: (f64, f64) = (0.5, 1.5);
/// Points of a line at most; more are averaged.
const POINTS: usize = 240;
/// Where a chart is read: lengths in pixels, sizes of letters in the same.
#[derive(Clone, Copy, Debug)]
struct Look {
    /// Of a chart without its legend.
    size: (u32, u32),
    /// Letters of the axes and of the note.
    letters: i32,
    /// Room of the horizontal axis and of the vertical one.
    axes: (u32, u32),
    /// Height of a row of the legend, and its letters.
    legend: (u32, i32),
    /// Names in a row of the legend and letters of each that it takes. Long names stand in fewer columns, whole, before
    /// letters are left out.
    columns: [(usize, usize); 3],
}

/// In a page, where charts stand side by side.
const PAGE: Look =
    Look { size: (560, 300), letters: 11, axes: (34, 52), legend: (17, 12), columns: [(3, 26), (2, 38), (1, 80)] };
/// In a paper: letters are of 7 points where the chart is as wide as one of two columns, 240 points. Those of plotters are
/// of 1 / 1.24 of the size that it is given.
const PAPER: Look =
    Look { size: (440, 290), letters: 16, axes: (46, 66), legend: (20, 16), columns: [(3, 14), (2, 22), (1, 48)] };
/// How much larger the letters of a title are than those of axes at most, and how wide a letter is on average, as a share
/// of its size.
const TITLE: (f64, f64) = (1.3, 0.48);
/// Labels of an axis, about.
const LABELS: u32 = 6;
/// Those of the axis below, about.
const PLACES: u32 = 6;
/// From the least to the most, from where on an axis goes by ratios.
const FAR_APART: f64 = 10.0;

/// A line's name and its points.
type Line<'a> = (&'a str, Vec<(f64, f64)>);

/// What is drawn: lines, how each is broken, and what stands along the vertical axis.
struct Drawn<'a> {
    lines: &'a [Line<'a>],
    dashes: &'a [Option<(i32, i32)>],
    axis: &'a str,
    /// The label of a place along the axis of steps.
    place_of: &'a dyn Fn(f64) -> String,
}

impl Chart {
    /// An SVG element that takes its text colour from the page.
    ///
    /// # Errors
    /// When the chart cannot be drawn.
    pub fn to_svg(&self) -> Result<String, ReportError> {
        self.drawn(&PAGE)
    }

    /// The same for a paper: smaller, so that its letters are larger in a column.
    pub(crate) fn to_svg_for_paper(&self) -> Result<String, ReportError> {
        self.drawn(&PAPER)
    }

    /// Whether all values of all lines are above 0.
    fn is_positive(&self) -> bool {
        let mut points = self.series.iter().flat_map(|s| &s.points);
        points.all(|(x, y)| !x.is_finite() || !y.is_finite() || *y > 0.0)
    }

    fn drawn(&self, look: &Look) -> Result<String, ReportError> {
        let lines: Vec<Line> = self.series.iter().map(|s| (s.name.as_str(), thinned(&s.points))).collect();
        let lines: Vec<_> = lines.into_iter().filter(|(_, points)| !points.is_empty()).collect();
        let all = || lines.iter().flat_map(|(_, p)| p.iter());
        let range = |f: fn(&(f64, f64)) -> f64| {
            all().map(f).fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)))
        };
        let ((x0, x1), (y0, y1)) = (range(|p| p.0), range(|p| p.1));
        if !(x0.is_finite() && y0.is_finite() && y1 < f64::MAX / 2.0 && y0 > f64::MIN / 2.0) {
            return Ok(String::new());
        }
        let most = y1.abs().max(y0.abs());
        // Of what does not change, a strip that labels can tell apart.
        let pad = match y1 - y0 > 1e-4 * most {
            true => (0.05 * (y1 - y0)).max(1e-300),
            false if most == 0.0 => 0.5,
            false => (0.02 * most).max(1e-9),
        };
        // Between steps there is nothing, so nothing is named there.
        let whole = all().all(|p| p.0.fract() == 0.0);
        // A single place stands in the middle.
        let (x0, x1) = if x1 > x0 { (x0, x1) } else { (x0 - 1.0, x0 + 1.0) };
        let (columns, letters) = look.columns(&lines);
        let rows = if lines.len() > 1 { lines.len().div_ceil(columns) as u32 } else { 0 };
        let note = look.wrapped(&self.note);
        let line = look.letters as u32 + 4;
        // The mean of neighbours may be above 0 where one of them is not.
        let by_ratio = self.log && self.is_positive() && y1 > FAR_APART * y0;
        let axis: Vec<&str> =
            [self.y.as_str(), if by_ratio { "log scale" } else { "" }].into_iter().filter(|t| !t.is_empty()).collect();
        let axis = axis.join(", ");
        let dashes = {
            let place = |y: f64| if by_ratio { y.ln() } else { y };
            let (low, high) = if by_ratio { (place(y0), place(y1)) } else { (y0 - pad, y1 + pad) };
            look.dashes(&lines, |y| (place(y) - low) / (high - low))
        };
        let below = rows * look.legend.0 + if note.is_empty() { 0 } else { line * note.len() as u32 + 6 };
        let mut svg = String::new();
        {
            let root = SVGBackend::with_string(&mut svg, (look.size.0, look.size.1 + below)).into_drawing_area();
            let (plot, below) = root.split_vertically(look.size.1);
            let mut builder = ChartBuilder::on(&plot);
            builder.margin(8).margin_right(24).x_label_area_size(look.axes.0);
            // What stands along the axis takes a line.
            builder.y_label_area_size(look.axes.1 + if axis.is_empty() { 0 } else { line });
            builder.caption(&self.title, ("sans-serif", look.title(&self.title)));
            let step = (x1 - x0) / f64::from(PLACES);
            let place_of = |v: f64| if whole && v.fract() != 0.0 { String::new() } else { spaced(v, step) };
            let drawn = Drawn { lines: &lines, dashes: &dashes, axis: &axis, place_of: &place_of };
            if by_ratio {
                let axis = (y0 * 0.9..y1 * 1.1).log_scale().with_key_points(ticks_by_ratio(y0 * 0.9, y1 * 1.1));
                self.draw(builder.build_cartesian_2d(x0..x1, axis).map_err(fault)?, &drawn, look, &short)?;
            } else {
                let chart = builder.build_cartesian_2d(x0..x1, y0 - pad..y1 + pad);
                let apart = (y1 - y0 + 2.0 * pad) / f64::from(LABELS);
                self.draw(chart.map_err(fault)?, &drawn, look, &|v| spaced(v, apart))?;
            }
            if rows > 0 {
                look.legend(&below, &drawn, columns, letters)?;
            }
            for (k, text) in note.into_iter().enumerate() {
                let style = ("sans-serif", look.letters).into_text_style(&look.size).color(&BLACK);
                let y = rows * look.legend.0 + line * k as u32 + 4;
                below.draw(&Text::new(text, (8, y as i32), style)).map_err(fault)?;
            }
            root.present().map_err(fault)?;
        }
        let told = self.series.iter().filter_map(|s| {
            let mut points = s.points.iter().map(|p| p.1).filter(|v| v.is_finite());
            let first = points.next()?;
            Some(format!("{} from {} to {}", s.name, figure(first), figure(points.next_back().unwrap_or(first))))
        });
        let label = label(&format!("{} over {}", self.title, self.x), &told.collect::<Vec<_>>());
        Ok(svg.replacen("<svg ", &format!("<svg {label} "), 1).replace("#000000", "currentColor"))
    }

    fn draw<'a, Y>(
        &self,
        mut chart: ChartContext<'a, SVGBackend<'a>, Cartesian2d<plotters::coord::types::RangedCoordf64, Y>>,
        drawn: &Drawn,
        look: &Look,
        label_of: &dyn Fn(f64) -> String,
    ) -> Result<(), ReportError>
    where
        Y: plotters::coord::ranged1d::ValueFormatter<f64> + Ranged<ValueType = f64> + 'a,
    {
        let label = ("sans-serif", look.letters).into_text_style(&look.size).color(&BLACK);
        let mut mesh = chart.configure_mesh();
        if !drawn.axis.is_empty() {
            mesh.y_desc(drawn.axis);
        }
        mesh.axis_desc_style(label.clone())
            .bold_line_style(RGBColor(128, 128, 128).mix(0.25))
            .light_line_style(TRANSPARENT)
            .axis_style(RGBColor(128, 128, 128))
            .x_desc(&self.x)
            .x_labels(PLACES as usize)
            .y_labels(LABELS as usize)
            .x_label_style(label.clone())
            .y_label_style(label.clone().pos(Pos::new(HPos::Right, VPos::Center)))
            .x_label_formatter(&|v| (drawn.place_of)(*v))
            .y_label_formatter(&|v| label_of(*v))
            .draw()
            .map_err(fault)?;
        for (k, ((_, points), dashes)) in drawn.lines.iter().zip(drawn.dashes).enumerate() {
            let (style, line) = (color(k).stroke_width(2), points.iter().copied());
            let drawn = match *dashes {
                None => chart.draw_series(LineSeries::new(line, style)).map(drop),
                Some((dash, gap)) => chart.draw_series(DashedLineSeries::new(line, dash, gap, style)).map(drop),
            };
            drawn.map_err(fault)?;
            if let [point] = points[..] {
                chart.draw_series([mark(point, k)]).map_err(fault)?;
            }
        }
        Ok(())
    }
}

impl Look {
    /// How many names stand in a row of the legend, and of how many letters: as many as have room whole.
    fn columns(&self, lines: &[Line]) -> (usize, usize) {
        let longest = lines.iter().map(|(name, _)| name.chars().count()).max().unwrap_or(0);
        self.columns.into_iter().find(|(_, letters)| longest <= *letters).unwrap_or(self.columns[2])
    }

    /// What each line is, below the axis, where no line runs.
    fn legend(
        &self,
        below: &DrawingArea<SVGBackend, plotters::coord::Shift>,
        Drawn { lines, dashes, .. }: &Drawn,
        columns: usize,
        letters: usize,
    ) -> Result<(), ReportError> {
        let (left, (row, size)) = (self.axes.1 as i32 + 8, self.legend);
        let width = (self.size.0 as i32 - left) / columns as i32;
        let names = fitted(&lines.iter().map(|(name, _)| *name).collect::<Vec<_>>(), letters);
        for (k, (((_, points), dashes), name)) in lines.iter().zip(*dashes).zip(names).enumerate() {
            let style = color(k).stroke_width(3);
            let (x, y) = (left + width * (k % columns) as i32, row as i32 * (k / columns) as i32 + 6);
            let line = [(x, y), (x + 16, y)];
            match (points.len(), *dashes) {
                (1, _) => below.draw(&mark((x + 8, y), k)),
                (_, None) => below.draw(&PathElement::new(line, style)),
                (_, Some((dash, gap))) => below.draw(&DashedPathElement::new(line, dash, gap, style)),
            }
            .map_err(fault)?;
            let style = ("sans-serif", size).into_text_style(&self.size).color(&BLACK);
            let style = style.pos(Pos::new(HPos::Left, VPos::Center));
            below.draw(&Text::new(name, (x + 21, y), style)).map_err(fault)?;
        }
        Ok(())
    }

    /// How each line is broken: once colours come again, and where it lies on lines before it, whose colours then show in
    /// its gaps. `place` is where on the vertical axis a value is, as a share of it.
    fn dashes(&self, lines: &[Line], place: impl Fn(f64) -> f64) -> Vec<Option<(i32, i32)>> {
        let height = f64::from(self.size.1 - self.axes.0);
        let on = |a: &[(f64, f64)], b: &[(f64, f64)]| {
            let apart = |at: &(f64, f64)| Some(height * (place(at.1) - place(at_x(b, at.0)?)).abs());
            let near = a.iter().filter(|at| apart(at).is_some_and(|pixels| pixels <= ON_EACH_OTHER.1));
            near.count() as f64 >= ON_EACH_OTHER.0 * a.len() as f64
        };
        let class = |k: usize| match lines.len() <= COLORS.len() {
            true => lines[..k].iter().filter(|(_, before)| on(&lines[k].1, before)).count(),
            false => k / COLORS.len(),
        };
        (0..lines.len()).map(|k| dashes(class(k))).collect()
    }

    /// The letters of a title, which are smaller where it is long.
    fn title(&self, title: &str) -> f64 {
        let fits = f64::from(self.size.0 - 16) / (TITLE.1 * title.chars().count().max(1) as f64);
        fits.clamp(f64::from(self.letters - 3), TITLE.0 * f64::from(self.letters))
    }

    /// A text in lines that fit below a chart.
    fn wrapped(&self, text: &str) -> Vec<String> {
        let room = (f64::from(self.size.0 - 16) / (TITLE.1 * f64::from(self.letters))) as usize;
        let mut lines: Vec<String> = Vec::new();
        for word in text.split_whitespace() {
            match lines.last_mut() {
                Some(line) if line.chars().count() + 1 + word.chars().count() <= room => *line += &format!(" {word}"),
                _ => lines.push(word.into()),
            }
        }
        lines
    }
}

fn color(line: usize) -> RGBColor {
    COLORS[line % COLORS.len()]
}

/// How lines of a class are broken; `None` for those that are not.
fn dashes(class: usize) -> Option<(i32, i32)> {
    let before = [None].into_iter().chain(DASHES.map(Some));
    before.cycle().nth(class).flatten()
}

/// The value of a line at a place between its ends.
fn at_x(points: &[(f64, f64)], x: f64) -> Option<f64> {
    let after = points.partition_point(|p| p.0 < x);
    let (b, a) = (points.get(after)?, points.get(after.saturating_sub(1))?);
    match b.0 == x {
        true => Some(b.1),
        false => (after > 0).then(|| a.1 + (b.1 - a.1) * (x - a.0) / (b.0 - a.0)),
    }
}

/// What stands for a line of one point: a dot, and once colours come again rings, each wider.
fn mark<At>(at: At, line: usize) -> Circle<At, i32> {
    match (line / COLORS.len()) as i32 {
        0 => Circle::new(at, 3, color(line).filled()),
        again => Circle::new(at, 1 + 2 * again, color(line).stroke_width(1)),
    }
}

/// Where an axis by ratios is labelled: 1, 2 and 5 of each power of ten where these are few, else the powers, all or
/// every so many.
fn ticks_by_ratio(low: f64, high: f64) -> Vec<f64> {
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let within = |at: &[f64], step: usize| -> Vec<f64> {
        let all = powers.clone().step_by(step).flat_map(|p| at.iter().map(move |m| m * 10f64.powi(p)));
        all.filter(|v| (low..=high).contains(v)).collect()
    };
    let fine = within(&[1.0, 2.0, 5.0], 1);
    if fine.len() <= 8 { fine } else { within(&[1.0], (powers.clone().count() / 8).max(1)) }
}

fn fault(e: impl std::fmt::Display) -> ReportError {
    ReportError::Chart(e.to_string())
}

/// At most [`POINTS`] points, each the mean of its neighbours.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let good: Vec<(f64, f64)> = points.iter().copied().filter(|(x, y)| x.is_finite() && y.is_finite()).collect();
    let group = good.len().div_ceil(POINTS).max(1);
    let mean = |c: &[(f64, f64)]| {
        let n = c.len() as f64;
        (c.iter().map(|p| p.0).sum::<f64>() / n, c.iter().map(|p| p.1).sum::<f64>() / n)
    };
    good.chunks(group).map(mean).collect()
}

/// A number for an axis.
pub(crate) fn short(v: f64) -> String {
    let a = v.abs();
    match a {
        _ if a >= 10_000.0 => format!("{:.0}k", v / 1000.0),
        _ if a >= 100.0 || v == 0.0 => format!("{v:.0}"),
        _ if a >= 0.01 => {
            let text = format!("{v:.3}");
            text.trim_end_matches('0').trim_end_matches('.').to_string()
        }
        _ => format!("{v:.0e}"),
    }
}

/// A number for an axis on which labels are about so far apart: no two of them are alike.
fn spaced(v: f64, apart: f64) -> String {
    if apart >= 1000.0 || v == 0.0 {
        return short(v);
    }
    // Ticks lie at 1, 2 or 5 times a power of ten.
    let digits = (-apart.log10()).ceil().max(0.0) as usize + 1;
    if digits > 7 {
        return format!("{v:.2e}");
    }
    let text = format!("{v:.digits$}");
    text.trim_end_matches('0').trim_end_matches('.').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn many_points_are_averaged_and_holes_left_out() {
        let points: Vec<(f64, f64)> = (0..1000).map(|i| (f64::from(i), if i == 7 { f64::NAN } else { 1.0 })).collect();
        let thin = thinned(&points);
        assert!(thin.len() <= POINTS && thin.iter().all(|p| p.1 == 1.0));
    }

    #[test]
    fn empty_and_flat_charts_do_not_fail() {
        let chart = |points| Chart {
            title: "t".into(),
            x: "step".into(),
            series: vec![Series { name: "a".into(), points }],
            ..Chart::default()
        };
        assert_eq!(chart(vec![]).to_svg().unwrap(), "");
        assert!(chart(vec![(1.0, 2.0)]).to_svg().unwrap().starts_with("<svg"));
        let log = Chart { log: true, ..chart(vec![(0.0, 0.0), (1.0, 1e-3), (2.0, 10.0)]) };
        let svg = log.to_svg().unwrap();
        assert!(svg.contains("currentColor"));
        assert!(svg.starts_with("<svg role=\"img\" aria-label=\"t over step: a from 0 to 10\""), "{svg}");
    }

    #[test]
    fn axes_by_ratio_have_labels_whatever_they_span() {
        assert_eq!(ticks_by_ratio(0.9, 12.0), [1.0, 2.0, 5.0, 10.0]);
        assert_eq!(ticks_by_ratio(0.5, 2200.0), [1.0, 10.0, 100.0, 1000.0]);
        for (low, decades) in [(3e-7, 12), (1e-3, 1), (40.0, 30)] {
            let ticks = ticks_by_ratio(low, low * 10f64.powi(decades));
            assert!((3..=12).contains(&ticks.len()), "{ticks:?}");
        }
        let line = |points: &[(f64, f64)]| Series { name: "a".into(), points: points.to_vec() };
        let chart = |series| Chart { x: "step".into(), series, log: true, ..Chart::default() };
        // A loss that falls to half is read off a plain axis.
        let near = chart(vec![line(&[(0.0, 2.0), (1.0, 1.0)])]).to_svg().unwrap();
        assert!(near.contains("\n1.2\n") && near.contains("\n1.8\n"), "{near}");
        // Of a line that falls below 0 nothing is left out, whatever the others are.
        let below = chart(vec![line(&[(0.0, 100.0), (1.0, 1.0)]), line(&[(0.0, 1.0), (1.0, -5.0), (2.0, f64::NAN)])]);
        let below = below.to_svg().unwrap();
        assert!(!below.contains("log scale") && below.contains("a from 1 to -5"), "{below}");
        // Each of several lines is named once.
        let named = chart(vec![line(&[(0.0, 1.0), (1.0, 2.0)]); 4]).to_svg().unwrap();
        assert_eq!(named.matches("\na\n").count(), 4);
    }

    #[test]
    fn labels_of_a_plain_axis_differ() {
        // The labels beside the vertical axis: those that end at the same place.
        for (low, high) in [(0.0031, 0.0039), (14_200.0, 14_900.0), (12.0, 12.0), (1e6, 1e6), (-0.5, 0.25), (0.0, 3e-9)]
        {
            let series = vec![Series { name: "a".into(), points: vec![(1.0, low), (2.0, high)] }];
            let svg = Chart { x: "step".into(), series, ..Chart::default() }.to_svg().unwrap();
            let mut labels: Vec<&str> =
                svg.split("text-anchor=\"end\"").skip(1).filter_map(|t| t.split('\n').nth(1)).collect();
            let all = labels.len();
            labels.sort_unstable();
            labels.dedup();
            assert!(all >= 3 && labels.len() == all, "{low} to {high}: {labels:?}");
        }
    }

    #[test]
    fn steps_have_labels_of_their_own_and_what_is_between_them_none() {
        for steps in
            [&[500.0][..], &[20_000.0], &[1.0, 2.0], &[10_000.0, 10_500.0, 11_000.0], &[1e5, 1.02e5], &[0.0, 4e4]]
        {
            let points = steps.iter().map(|&x| (x, 0.001 * x)).collect();
            let series = vec![Series { name: "a".into(), points }];
            let svg = Chart { x: "step".into(), series, ..Chart::default() }.to_svg().unwrap();
            // The labels below: those that are centred, but for the axis' own name.
            let centred = svg.split("text-anchor=\"middle\"").skip(1).filter_map(|t| t.split('\n').nth(1));
            let mut labels: Vec<&str> = centred.filter(|t| t.starts_with(|c: char| c.is_ascii_digit())).collect();
            let all = labels.len();
            labels.sort_unstable();
            labels.dedup();
            assert!(all >= 2 && labels.len() == all, "{steps:?}: {labels:?}");
            assert!(labels.iter().all(|t| !t.contains('.')), "{steps:?}: {labels:?}");
        }
    }

    #[test]
    fn lines_of_one_colour_differ_in_their_dashes() {
        let chart = |count: usize, points: usize| {
            let line = |k: usize| (0..points).map(|x| (x as f64, k as f64)).collect();
            let series = (0..count).map(|k| Series { name: format!("line {k}"), points: line(k) }).collect();
            Chart { x: "step".into(), series, ..Chart::default() }.to_svg().unwrap()
        };
        // Strokes of the first and the second colour, in the plot and, wider, in the legend.
        let strokes = |svg: &str, color: &str, width: u32| {
            svg.matches(&format!("stroke=\"{color}\" stroke-width=\"{width}\"")).count()
        };
        let (first, second) = ("#1F77B4", "#E17000");
        let seven = chart(COLORS.len() + 1, 2);
        assert_eq!((strokes(&seven, second, 2), strokes(&seven, second, 3)), (1, 1));
        assert!(strokes(&seven, first, 2) > 10 && strokes(&seven, first, 3) == 3, "the seventh is broken");
        // What the legend shows of lines that share a colour.
        let more = [13, 19].map(|count| strokes(&chart(count, 2), first, 3));
        assert_eq!(more, [1 + 2 + 3, 1 + 2 + 3 + 2]);
        let kinds: std::collections::BTreeSet<_> = (0..4).map(dashes).collect();
        assert_eq!(kinds.len(), 4);
        // Lines of one point.
        let dots = chart(COLORS.len() + 1, 1);
        assert_eq!(dots.matches("<circle").count(), 2 * (COLORS.len() + 1));
        assert_eq!(strokes(&dots, first, 1), 2, "{dots}");
    }

    #[test]
    fn a_line_on_another_is_broken_so_that_both_show() {
        let line = |name: &str, f: fn(f64) -> f64| {
            let points = (0..40).map(|x| (f64::from(x), f(f64::from(x)))).collect();
            Series { name: name.into(), points }
        };
        let dashes = |series: Vec<Series>, log: bool| {
            let svg = Chart { x: "step".into(), series, log, ..Chart::default() }.to_svg().unwrap();
            // Strokes of a legend's line: one of a whole line.
            COLORS.map(|RGBColor(r, g, b)| {
                svg.matches(&format!("stroke=\"#{r:02X}{g:02X}{b:02X}\" stroke-width=\"3\"")).count()
            })
        };
        let apart = vec![line("a", |x| x), line("b", |x| 40.0 - x), line("c", |_| 20.0)];
        assert_eq!(dashes(apart, false)[..3], [1, 1, 1]);
        let on = |more: f64| {
            vec![
                line("a", |x| x),
                line("b", |x| x + 1e-3),
                Series { name: "c".into(), points: vec![(0.0, more), (39.0, 39.0 + more)] },
            ]
        };
        let both = dashes(on(0.0), false);
        assert!(both[0] == 1 && both[1] > 1 && both[2] > 1 && both[1] != both[2], "{both:?}");
        assert_eq!(dashes(on(5.0), false)[2], 1);
        // What lies on the floor of a plain axis is apart by ratios.
        let far =
            || vec![line("a", |x| 1e-3 * (x + 1.0)), line("b", |x| 1e-2 * (x + 1.0)), line("c", |x| 1e3 * (x + 1.0))];
        assert!(dashes(far(), false)[1] > 1 && dashes(far(), true)[1] == 1);
        assert_eq!(
            [at_x(&[(1.0, 2.0), (3.0, 6.0)], 2.0), at_x(&[(1.0, 2.0)], 1.0), at_x(&[(1.0, 2.0)], 0.5)],
            [Some(4.0), Some(2.0), None]
        );
        assert_eq!((at_x(&[(1.0, 2.0)], 2.0), at_x(&[], 2.0)), (None, None));
    }

    #[test]
    fn an_axis_by_ratios_says_so() {
        let chart = |high: f64, y: &str| {
            let series = vec![Series { name: "a".into(), points: vec![(0.0, 1.0), (1.0, high)] }];
            Chart { x: "step".into(), series, log: true, y: y.into(), ..Chart::default() }.to_svg().unwrap()
        };
        assert!(chart(100.0, "").contains("\nlog scale\n") && chart(100.0, "loss").contains("\nloss, log scale\n"));
        assert!(!chart(2.0, "").contains("log scale") && chart(2.0, "loss").contains("\nloss\n"));
    }

    #[test]
    fn long_names_stand_whole_in_fewer_columns() {
        let of = |name: &str| PAGE.columns(&[(name, vec![]), ("a", vec![])]);
        assert_eq!(
            [of(&"n".repeat(26)).0, of(&"n".repeat(27)).0, of(&"n".repeat(39)).0, of(&"n".repeat(99)).0],
            [3, 2, 1, 1]
        );
        let names = ["baseline, as in the paper, dice=0.5", "baseline, as in the paper, dice=2.0"];
        let series = names.map(|name| Series { name: name.into(), points: vec![(0.0, 1.0), (1.0, 2.0)] }).to_vec();
        let svg = Chart { x: "step".into(), series, ..Chart::default() }.to_svg().unwrap();
        assert!(names.iter().all(|name| svg.contains(&format!("\n{name}\n"))), "{svg}");
    }

    #[test]
    fn what_has_to_be_known_stands_below_in_lines_that_fit() {
        let line = Series { name: "a".into(), points: vec![(0.0, 1.0), (1.0, 2.0)] };
        let chart = Chart {
            title: "t".repeat(80),
            x: "step".into(),
            series: vec![line],
            y: "IoU <pooled>".into(),
            note: "word ".repeat(60),
            ..Chart::default()
        };
        let plain = Chart { y: String::new(), note: String::new(), ..chart.clone() };
        let [page, paper] = [chart.to_svg().unwrap(), chart.to_svg_for_paper().unwrap()];
        for (svg, look) in [(&page, PAGE), (&paper, PAPER)] {
            let words: Vec<&str> = svg.lines().filter(|l| l.starts_with("word")).collect();
            let wide = words.iter().map(|l| l.len()).max().unwrap();
            assert!(
                words.len() >= 3 && TITLE.1 * (wide as f64) * f64::from(look.letters) <= f64::from(look.size.0),
                "{words:?}"
            );
            assert!(svg.contains("IoU &lt;pooled&gt;"), "{svg}");
        }
        assert!(!plain.to_svg().unwrap().contains("word"));
        assert_eq!((PAGE.title("loss").round(), PAGE.title(&"t".repeat(200))), (14.0, 8.0));
    }

    #[test]
    fn axis_numbers_are_short() {
        assert_eq!([0.0, 0.05, 1.5, 250.0, 14_000.0, 0.001].map(short), ["0", "0.05", "1.5", "250", "14k", "1e-3"]);
    }
}
