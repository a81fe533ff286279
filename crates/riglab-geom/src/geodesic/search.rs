//! The shortest ways from one bone to every node of a body.

use glam::Vec3A;
use riglab_core::Segment;

use super::body::Body;
use super::bridges::Bridges;

/// Ways are settled in layers of this length, in edges of a cell.
const LAYER: f32 = 0.25;
/// Longer than any way through a lattice.
const LAST_LAYER: usize = 1 << 18;
/// Seen from here: the bone itself. Other values are a node's number and 1.
const BONE: u32 = 0;
const NOWHERE: u32 = u32::MAX >> 1;
/// The bit of a corner that says that the way is sure. There are fewer nodes than lattices have cells.
const SETTLED: u32 = 1 << 31;

/// The best way to a node so far.
#[derive(Clone, Copy)]
struct Way {
    length: f32,
    /// From where the node is seen straight: the way's last corner; with [`SETTLED`].
    corner: u32,
}

impl Way {
    const NONE: Self = Self { length: f32::INFINITY, corner: NOWHERE };

    fn is_settled(self) -> bool {
        self.corner & SETTLED != 0
    }

    fn corner(self) -> u32 {
        self.corner & !SETTLED
    }
}

/// Segments, in the body's units.
pub(super) struct Bone(Vec<(Vec3A, Vec3A, f32)>);

impl Bone {
    pub(super) fn new(segments: &[Segment], body: &Body) -> Self {
        let inner = |s: &Segment| {
            let [a, b] = body.part(s);
            let squared = (b - a).length_squared();
            (a, b - a, if squared > 0.0 { 1.0 / squared } else { 0.0 })
        };
        Self(segments.iter().map(inner).collect())
    }

    /// The point nearest to another.
    #[inline]
    fn nearest(&self, p: Vec3A) -> Vec3A {
        let mut best = (f32::INFINITY, p);
        for &(a, along, inverse) in &self.0 {
            let q = a + along * ((p - a).dot(along) * inverse).clamp(0.0, 1.0);
            let d = (q - p).length_squared();
            if d < best.0 {
                best = (d, q);
            }
        }
        best.1
    }

    /// The straight distance of a point.
    pub(super) fn distance(&self, p: Vec3A) -> f32 {
        if self.0.is_empty() { f32::INFINITY } else { (self.nearest(p) - p).length() }
    }

    /// Occupied places that it runs through.
    fn cells(&self, body: &Body) -> Vec<u32> {
        let mut cells = Vec::new();
        // Those that are longer run past all places.
        let followed = self.0.iter().filter(|(_, along, _)| along.length() <= body.longest());
        for (a, along, _) in followed {
            let steps = (2.0 * along.length()).ceil().max(1.0);
            let at = |k: i32| body.at(*a + *along * (k as f32 / steps));
            // Points outside of the lattice are brought to its border; those do not count.
            let inside = |k: &i32| {
                (*a + *along * (*k as f32 / steps) - Vec3A::from(at(*k).map(|x| x as f32))).abs().max_element()
                    <= 0.5001
            };
            cells.extend((0..=steps as i32).filter(inside).filter_map(|k| body.node(at(k))));
        }
        cells.sort_unstable();
        cells.dedup();
        cells
    }
}

/// What a search needs; kept from bone to bone.
#[derive(Default)]
pub(super) struct Search {
    /// By node.
    ways: Vec<Way>,
    /// Nodes by their ways' lengths. One whose way was found to be shorter stands in several.
    layers: Vec<Vec<u32>>,
    /// The layer that is being settled.
    layer: usize,
}

impl Search {
    /// Finds the ways from a bone to all cells.
    ///
    /// As Theta* finds ways on a grid that turn at any angle (Daniel et al. 2010), the lazy form: a cell first
    /// takes the corner of the cell it was reached from, and when its turn comes looks whether it sees it;
    /// if not, the best of its neighbours, or of their corners, is its corner. A bone is a corner of its own: its
    /// point nearest to each cell.
    pub(super) fn run(&mut self, body: &Body, bridges: &Bridges, bone: &Bone) {
        self.ways.clear();
        self.ways.resize(body.len(), Way::NONE);
        self.layer = 0;
        self.start(body, bone);
        while self.layer < self.layers.len() {
            // Cells of the layer may add others to it.
            let mut next = 0;
            while let Some(&cell) = self.layers[self.layer].get(next) {
                next += 1;
                let way = self.ways[cell as usize];
                if !way.is_settled() && layer_of(way.length) <= self.layer {
                    self.settle(body, bridges, bone, cell, way);
                }
            }
            self.layers[self.layer].clear();
            self.layer += 1;
        }
    }

    /// The way's length to a point near the middle of a cell.
    pub(super) fn length(&self, body: &Body, bone: &Bone, cell: u32, p: Vec3A) -> f32 {
        match self.ways[cell as usize].corner() {
            NOWHERE => f32::INFINITY,
            corner => self.through(body, bone, corner, p),
        }
    }

    /// From the cells that the bone runs through; from the cell nearest to a bone that runs through none.
    fn start(&mut self, body: &Body, bone: &Bone) {
        if bone.0.is_empty() {
            return;
        }
        let inside = bone.cells(body);
        let far = |cell: u32| {
            let middle = body.middle(cell);
            (bone.nearest(middle) - middle).length()
        };
        for &cell in &inside {
            self.offer(cell, far(cell), BONE);
        }
        if inside.is_empty() {
            let all = (0..body.len() as u32).map(|cell| (far(cell), cell));
            if let Some((length, cell)) = all.min_by(|a, b| a.0.total_cmp(&b.0)) {
                // A corner of its own.
                self.offer(cell, length, cell + 1);
            }
        }
    }

    /// The length of the way to `p` whose last corner is given.
    #[inline]
    fn through(&self, body: &Body, bone: &Bone, corner: u32, p: Vec3A) -> f32 {
        match corner {
            BONE => (bone.nearest(p) - p).length(),
            _ => self.ways[corner as usize - 1].length + (body.middle(corner - 1) - p).length(),
        }
    }

    /// Takes a way to a cell if it is shorter.
    #[inline]
    fn offer(&mut self, cell: u32, length: f32, corner: u32) {
        let best = &mut self.ways[cell as usize];
        if length < best.length {
            *best = Way { length, corner };
            self.queue(cell, length);
        }
    }

    fn queue(&mut self, cell: u32, length: f32) {
        // A way from a corner may be shorter than those of the layer: what it leads to is settled with them, as the
        // layers before are over.
        let layer = layer_of(length).max(self.layer);
        if layer >= self.layers.len() {
            self.layers.resize_with(layer + 1, Vec::new);
        }
        self.layers[layer].push(cell);
    }

    fn settle(&mut self, body: &Body, bridges: &Bridges, bone: &Bone, cell: u32, mut way: Way) {
        let middle = body.middle(cell);
        if !self.sees(body, bone, middle, way.corner) {
            way = match self.around(body, bone, cell, middle) {
                // Nothing around is settled yet, as at the end of a bone in a thin part: the way offered turns here.
                Way { length, .. } if length.is_infinite() => Way { corner: cell + 1, ..way },
                found => found,
            };
            if layer_of(way.length) > self.layer {
                self.ways[cell as usize] = way;
                self.queue(cell, way.length);
                return;
            }
        }
        let corner = way.corner;
        self.ways[cell as usize] = Way { corner: corner | SETTLED, ..way };
        // Where the way came from: for a corner the same for all neighbours.
        let (base, at) = match corner {
            BONE => (0.0, None),
            _ => (self.ways[corner as usize - 1].length, Some(body.middle(corner - 1))),
        };
        for other in body.beside(cell) {
            let best = self.ways[other as usize];
            // Offered already: a node is reached from several neighbours, which mostly have the same corner.
            if best.is_settled() || best.corner == corner {
                continue;
            }
            let p = body.middle(other);
            let length = base + (at.unwrap_or_else(|| bone.nearest(p)) - p).length();
            self.offer(other, length, corner);
        }
        for &(_, other, gap) in bridges.from(cell) {
            if !self.ways[other as usize].is_settled() {
                self.offer(other, way.length + gap, other + 1);
            }
        }
    }

    fn sees(&self, body: &Body, bone: &Bone, middle: Vec3A, corner: u32) -> bool {
        let to = match corner {
            BONE => bone.nearest(middle),
            _ => body.middle(corner - 1),
        };
        body.sees(middle, to)
    }

    /// The shortest way through settled neighbours: by their corners where those are seen, else by
    /// themselves.
    fn around(&self, body: &Body, bone: &Bone, node: u32, middle: Vec3A) -> Way {
        let mut best = Way::NONE;
        let mut hidden = [NOWHERE; 4];
        let mut count = 0;
        body.around(node, |other| {
            let way = self.ways[other as usize];
            if !way.is_settled() {
                return;
            }
            let by_itself = way.length + (body.middle(other) - middle).length();
            if by_itself < best.length {
                best = Way { length: by_itself, corner: other + 1 };
            }
            let corner = way.corner();
            if corner == best.corner || hidden.contains(&corner) {
                return;
            }
            let length = self.through(body, bone, corner, middle);
            if length < best.length {
                if self.sees(body, bone, middle, corner) {
                    best = Way { length, corner };
                } else {
                    hidden[count % hidden.len()] = corner;
                    count += 1;
                }
            }
        });
        best
    }
}

/// Ways of bones far beyond any body share the last layer: there must not be one for each cell of the way there.
fn layer_of(length: f32) -> usize {
    ((length / LAYER) as usize).min(LAST_LAYER)
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;
    use crate::voxel::{Lattice, Voxels};

    /// Thin and bent, of several pieces: ways turn often, and some are found late.
    fn body(seed: u64) -> Body {
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [40, 36, 44] };
        let mut random = stream(seed, "bent body", &[]);
        let mut cells = Vec::new();
        for _ in 0..4 {
            let mut at = lattice.size.map(|n| random.below(n));
            for _ in 0..12 {
                let (axis, up, length) = (random.below(3), random.below(2), 3 + random.below(12));
                for _ in 0..length {
                    at[axis] = if up == 1 { at[axis] + 1 } else { at[axis].saturating_sub(1) };
                    at[axis] = at[axis].min(lattice.size[axis] - 1);
                    let thick = 1 + random.below(3);
                    cells.extend((0..thick * thick).map(|i| [at[0], at[1] + i / thick, at[2] + i % thick]));
                }
            }
        }
        Body::new(&Voxels::new(lattice, cells))
    }

    #[test]
    fn all_of_a_body_is_reached_whatever_was_searched_before() {
        let mut kept = Search::default();
        for seed in 0..20 {
            let body = body(seed);
            let bridges = Bridges::new(&body);
            let mut random = stream(seed, "bones", &[]);
            for _ in 0..8 {
                let point = |random: &mut riglab_random::Stream| [0; 3].map(|_| random.within(0.0, 44.0));
                let bone = Bone::new(&[Segment { a: point(&mut random), b: point(&mut random) }], &body);
                let mut fresh = Search::default();
                kept.run(&body, &bridges, &bone);
                fresh.run(&body, &bridges, &bone);
                for node in 0..body.len() as u32 {
                    let length = |search: &Search| search.length(&body, &bone, node, body.middle(node));
                    let (got, wanted) = (length(&kept), length(&fresh));
                    assert!(got.is_finite() && got == wanted, "{seed}, node {node}: {got}, not {wanted}");
                }
            }
        }
    }
}
