//! Which triangle is seen at each sample.
//!
//! Only visibility is found here, shading looks at each sample once afterwards: overdraw costs
//! little, and what a surface looks like stays out of the inner loop.

use std::collections::HashSet;
use std::ops::Range;

use glam::Vec3;
use rayon::prelude::*;

/// Triangles in samples: x right, y down, z towards the viewer.
pub(crate) struct Triangles<'a> {
    pub positions: &'a [Vec3],
    pub triangles: &'a [[u32; 3]],
}

/// What is seen at a sample.
#[derive(Clone, Copy)]
pub(crate) struct Hit {
    /// Towards the viewer; -inf where nothing is.
    pub depth: f32,
    pub triangle: u32,
    /// Shares of the triangle's second and third corner.
    pub shares: [f32; 2],
}

impl Hit {
    const NOTHING: Self = Self { depth: f32::NEG_INFINITY, triangle: u32::MAX, shares: [0.0; 2] };

    pub fn is_some(&self) -> bool {
        self.triangle != u32::MAX
    }
}

/// What is seen in a picture of samples.
pub(crate) struct Layer {
    width: usize,
    height: usize,
    /// Row by row.
    hits: Vec<Hit>,
    /// The first to the last column that has a hit, for each row that has one.
    spans: Vec<Option<Range<isize>>>,
}

/// How far from a sample its surroundings are looked at.
pub(crate) const REACH: isize = 2;

/// Rows that one thread fills while they are in its cache. The result does not depend on it.
const BAND: usize = 32;

/// Scenes of more triangles are looked through for equal ones, which takes longer than to fill a few twice.
const MANY: usize = 50_000;

impl Layer {
    /// Finds the nearest triangle at every sample; of two at the same depth, the first.
    pub fn render(width: usize, height: usize, scene: &Triangles<'_>) -> Self {
        let mut hits = vec![Hit::NOTHING; width * height];
        let mut spans = vec![None; height];
        let bands = hits.par_chunks_mut(BAND * width).zip(spans.par_chunks_mut(BAND));
        bands.zip(bins(height, scene)).enumerate().for_each(|(band, ((hits, spans), bin))| {
            for triangle in bin {
                fill(hits, width, band * BAND, triangle, scene.corners(triangle));
            }
            spans.iter_mut().zip(hits.chunks(width)).for_each(|(to, row)| *to = span(row));
        });
        Self { width, height, hits, spans }
    }

    /// The columns outside which nothing is within [`REACH`] of any sample of these rows: most of a
    /// picture is nothing, and this is quickly said.
    pub fn columns_near(&self, rows: Range<usize>) -> Range<isize> {
        let rows = rows.start.saturating_sub(REACH as usize)..(rows.end + REACH as usize).min(self.height);
        let spans = rows.filter_map(|y| self.spans[y].clone());
        let union = |a: Range<isize>, b: Range<isize>| a.start.min(b.start)..a.end.max(b.end);
        spans.reduce(union).map_or(0..0, |span| span.start - REACH..span.end + REACH)
    }

    /// The hit at a sample; nothing outside.
    pub fn at(&self, x: isize, y: isize) -> &Hit {
        let inside = x >= 0 && y >= 0 && x < self.width as isize && y < self.height as isize;
        if inside { &self.hits[y as usize * self.width + x as usize] } else { &Hit::NOTHING }
    }

    /// Whether a sample is nearer by more than `step` than another surface seen `reach` to a side of it.
    pub fn stands_out(&self, x: isize, y: isize, reach: isize, step: f32) -> bool {
        let depth = self.at(x, y).depth;
        self.around(x, y, reach).any(|hit| hit.is_some() && depth - hit.depth > step)
    }

    /// Whether something is at a sample that is `reach` to a side.
    pub fn touches_something(&self, x: isize, y: isize, reach: isize) -> bool {
        self.around(x, y, reach).any(Hit::is_some)
    }

    /// Whether nothing is at a sample that is `reach` to a side.
    pub fn touches_nothing(&self, x: isize, y: isize, reach: isize) -> bool {
        self.around(x, y, reach).any(|hit| !hit.is_some())
    }

    fn around(&self, x: isize, y: isize, reach: isize) -> impl Iterator<Item = &Hit> {
        debug_assert!(reach <= REACH);
        [(1, 0), (-1, 0), (0, 1), (0, -1)].into_iter().map(move |(dx, dy)| self.at(x + reach * dx, y + reach * dy))
    }
}

fn span(row: &[Hit]) -> Option<Range<isize>> {
    let first = row.iter().position(Hit::is_some)? as isize;
    let last = row.iter().rposition(Hit::is_some)? as isize;
    Some(first..last + 1)
}

impl Triangles<'_> {
    fn corners(&self, triangle: u32) -> [Vec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }
}

/// The triangles that touch each band of rows, in order.
fn bins(height: usize, scene: &Triangles<'_>) -> Vec<Vec<u32>> {
    let mut bins = vec![Vec::new(); height.div_ceil(BAND)];
    let mut known = HashSet::new();
    let many = scene.triangles.len() > MANY;
    for triangle in 0..scene.triangles.len() as u32 {
        let corners = scene.corners(triangle);
        // Of two in one place the first is seen: meshes that stand in one another need not be filled each.
        if many && !known.insert(corners.map(|p| p.to_array().map(f32::to_bits))) {
            continue;
        }
        let [a, b, c] = corners.map(|p| p.y);
        let (top, bottom) = (a.min(b).min(c), a.max(b).max(c));
        // Casts of floats saturate, and NaN is 0.
        if bottom >= 0.0 && top < height as f32 {
            let last = (bottom as usize / BAND).min(bins.len() - 1);
            for bin in &mut bins[(top as usize / BAND).min(last)..=last] {
                bin.push(triangle);
            }
        }
    }
    bins
}

/// Fills the samples of a band, whose first row is `top`, that a triangle covers.
fn fill(hits: &mut [Hit], width: usize, top: usize, triangle: u32, [a, b, c]: [Vec3; 3]) {
    let (ab, ac) = ((b - a).truncate(), (c - a).truncate());
    let area = ab.perp_dot(ac);
    if !area.is_finite() || area == 0.0 {
        return;
    }
    let rows = hits.len() / width;
    let (min, max) = (a.min(b).min(c), a.max(b).max(c));
    // A sample is at the middle of its cell.
    let cells = |low: f32, high: f32, offset: usize, count: usize| {
        let [low, high] = [low - 0.5, high - 0.5].map(|x| x - offset as f32);
        (low.ceil().max(0.0) as usize, (high.floor().min(count as f32 - 1.0) + 1.0).max(0.0) as usize)
    };
    let (left, right) = cells(min.x, max.x, 0, width);
    let (first, end) = cells(min.y, max.y, top, rows);
    // Shares of b and c are linear in x and y.
    let step_b = ac.y / area;
    let step_c = -ab.y / area;
    for row in first..end {
        let y = (top + row) as f32 + 0.5 - a.y;
        let x = left as f32 + 0.5 - a.x;
        let start_b = (x * ac.y - y * ac.x) / area;
        let start_c = (y * ab.x - x * ab.y) / area;
        for column in stretch([start_b, start_c], [step_b, step_c], left..right) {
            let along = (column - left) as f32;
            let (share_b, share_c) = (start_b + along * step_b, start_c + along * step_c);
            if share_b >= 0.0 && share_c >= 0.0 && share_b + share_c <= 1.0 {
                let depth = a.z + share_b * (b.z - a.z) + share_c * (c.z - a.z);
                let hit = &mut hits[row * width + column];
                if depth > hit.depth {
                    *hit = Hit { depth, triangle, shares: [share_b, share_c] };
                }
            }
        }
    }
}

/// The columns of a row outside which no share can be as it has to be inside a triangle: a sliver's box is mostly empty,
/// and a polygon of many corners is cut into slivers. Wider by what rounding may be off, so that the test at each sample
/// decides as if all were looked at.
fn stretch([b, c]: [f32; 2], [step_b, step_c]: [f32; 2], columns: Range<usize>) -> Range<usize> {
    const ROUNDING: f32 = 1e-6;
    let count = columns.len() as f32;
    let (mut from, mut to) = (0.0f32, count);
    let [size_b, size_c] = [(b, step_b), (c, step_c)].map(|(x, step)| x.abs() + count * step.abs());
    let sum = (1.0 - b - c, -(step_b + step_c), 1.0 + size_b + size_c);
    // Each is at least 0 inside. Where one is no number, `max` and `min` keep the other side.
    for (start, step, size) in [(b, step_b, size_b), (c, step_c, size_c), sum] {
        let (crossing, slack) = (-start / step, 1.0 + ROUNDING * size / step.abs());
        if step > 0.0 {
            from = from.max(crossing - slack);
        } else if step < 0.0 {
            to = to.min(crossing + slack + 1.0);
        }
    }
    // Casts saturate.
    let [from, to] = [from, to].map(|along| columns.start + (along as usize).min(columns.len()));
    from..to.max(from)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn render(positions: &[[f32; 3]]) -> Layer {
        let positions: Vec<Vec3> = positions.iter().map(|&p| p.into()).collect();
        let triangles: Vec<[u32; 3]> = (0..positions.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        Layer::render(70, 70, &Triangles { positions: &positions, triangles: &triangles })
    }

    #[test]
    fn two_halves_of_a_square_cover_it_once_and_whole() {
        let [a, b, c, d] = [[10.0, 10.0, 0.0], [60.0, 10.0, 0.0], [60.0, 60.0, 0.0], [10.0, 60.0, 0.0]];
        let layer = render(&[a, b, c, a, d, c]);
        let seen = layer.hits.iter().filter(|hit| hit.is_some()).count();
        assert_eq!(seen, 2500);
        assert_eq!((layer.at(59, 10).triangle, layer.at(10, 59).triangle), (0, 1));
        assert!(!layer.at(60, 10).is_some() && !layer.at(-1, 0).is_some());
        assert!(layer.touches_something(60, 59, 1) && layer.touches_nothing(59, 59, 1));
        assert_eq!(layer.columns_near(60..62), 8..62);
        assert_eq!((layer.columns_near(62..70), layer.columns_near(0..8)), (0..0, 0..0));
    }

    #[test]
    fn the_nearer_triangle_is_seen_whatever_the_order() {
        let near = [[0.0, 0.0, 5.0], [70.0, 0.0, 5.0], [0.0, 70.0, 5.0]];
        let far = near.map(|[x, y, _]| [x, y, 1.0]);
        assert_eq!(render(&[near, far].concat()).at(5, 5).triangle, 0);
        assert_eq!(render(&[far, near].concat()).at(5, 5).triangle, 1);
        let hit = *render(&near).at(34, 0);
        assert!((hit.shares[0] - 34.5 / 70.0).abs() < 1e-5 && hit.depth == 5.0);
    }

    /// Slivers and others, in and beyond the picture; every second one is of a fan about one hub.
    fn many_triangles(count: u32) -> Vec<[f32; 3]> {
        let mut state = 1u32;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1 << 24) as f32
        };
        let mut points = Vec::new();
        for k in 0..count {
            let [a, b] = [0, 1].map(|_| [120.0 * next() - 25.0, 120.0 * next() - 25.0, next()]);
            let near = 10f32.powi(-((k % 9) as i32));
            let (hub, shift) = (if k % 2 == 0 { [35.3, 34.1, 0.5] } else { a }, 20.0 * near * (next() - 0.5));
            points.extend([hub, b, [b[0] + shift, b[1] + 20.0 * near * next(), next()]]);
        }
        points
    }

    #[test]
    fn stretches_leave_out_nothing_that_is_covered() {
        for points in many_triangles(20_000).as_chunks::<3>().0 {
            let [a, b, c] = points.map(Vec3::from);
            let (ab, ac) = ((b - a).truncate(), (c - a).truncate());
            let area = ab.perp_dot(ac);
            if area == 0.0 {
                continue;
            }
            let steps = [ac.y / area, -ab.y / area];
            for row in 0..70 {
                let (x, y) = (0.5 - a.x, row as f32 + 0.5 - a.y);
                let starts = [(x * ac.y - y * ac.x) / area, (y * ab.x - x * ab.y) / area];
                let within = stretch(starts, steps, 0..70);
                for column in (0..70usize).filter(|column| !within.contains(column)) {
                    let [b, c] = [0, 1].map(|k| starts[k] + column as f32 * steps[k]);
                    assert!(!(b >= 0.0 && c >= 0.0 && b + c <= 1.0), "{points:?}: {column} in {row}");
                }
            }
        }
    }

    #[test]
    fn triangles_in_one_place_are_filled_once() {
        let few = many_triangles(300);
        let times = MANY / 300 + 1;
        let (once, often) = (render(&few), render(&few.repeat(times)));
        assert!(once.hits.iter().zip(&often.hits).all(|(a, b)| (a.triangle, a.depth) == (b.triangle, b.depth)));
        let positions: Vec<Vec3> = few.repeat(times).into_iter().map(Vec3::from).collect();
        let triangles: Vec<[u32; 3]> = (0..positions.len() as u32 / 3).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let bins = bins(70, &Triangles { positions: &positions, triangles: &triangles });
        assert!(bins.iter().all(|bin| bin.len() <= 300));
    }

    #[test]
    fn hostile_corners_do_not_panic() {
        let odd = [0.0, -1.0, 35.0, 1e-38, 1e30, -3e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        let points: Vec<[f32; 3]> = odd.iter().flat_map(|&x| odd.map(|y| [x, y, x])).collect();
        for shift in 1..points.len() {
            let all: Vec<[f32; 3]> =
                (0..points.len()).flat_map(|i| [0, shift, 2 * shift].map(|s| points[(i + s) % points.len()])).collect();
            render(&all);
        }
    }
}
