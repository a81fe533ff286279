//! Which triangle is seen at each sample.
//!
//! Only visibility is found here, shading looks at each sample once afterwards: overdraw costs
//! little, and what a surface looks like stays out of the inner loop.

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
    for triangle in 0..scene.triangles.len() as u32 {
        let [a, b, c] = scene.corners(triangle).map(|p| p.y);
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
        for column in left..right {
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
