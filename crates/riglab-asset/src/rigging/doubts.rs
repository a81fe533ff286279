//! What looks wrong with a model: told, not mended, but for the facing of what is looked at.

use glam::DVec3;
use riglab_core::Mesh;

use super::pieces::{Piece, corners};
use super::{SubjectNote, UpAxis};

/// From this share of the largest area on, a group of pieces may be a character.
const LARGE: f64 = 0.3;
/// Gaps wider than this share of the whole part characters; in a crowd, of the two that they part.
const GAP: f64 = 0.05;
/// More groups than this are no crowd, but leaves, scales or hairs.
const CROWD: usize = 2048;
/// All of a crowd are at least so tall beside its tallest, and stand on one ground to within this share of its height.
const TALL: f64 = 0.5;
const GROUND: f64 = 0.1;
/// Posts are thinner and tiles flatter than characters: these are as tall as this share of their width, or this many
/// times it.
const HEIGHTS: [f64; 2] = [0.1, 6.0];
/// What is less than this share of the surface does not matter.
const MUCH: f64 = 0.25;
/// A model that stands on something has its lowest point this near to 0, as a share of its height.
const STANDS: f64 = 0.02;

/// What may be doubted of a model that should have y up, as the file's axis that was `given` for up has been turned there;
/// `about` tells whether the model was then turned round.
pub(super) fn doubts(mesh: &Mesh, pieces: &[Piece], given: UpAxis, about: bool, notes: &mut Vec<SubjectNote>) {
    let flat = (0..mesh.triangles().len() as u32).filter(|&t| {
        let [a, b, c] = corners(mesh, t);
        (b - a).cross(c - a) == DVec3::ZERO
    });
    let flat = flat.count();
    if flat > 0 {
        notes.push(SubjectNote::Flat { triangles: flat });
    }
    let (low, high) = bounds(pieces);
    let round = |[x, y, z]: [f32; 3]| if about { [-x, y, -z] } else { [x, y, z] };
    // Hardly any file has another axis up.
    let other = [(UpAxis::Y, [0.0, 1.0, 0.0]), (UpAxis::Z, [0.0, 0.0, 1.0])]
        .into_iter()
        .find(|(axis, up)| *axis != given && stands_along(mesh, low, high, round(given.to_y(*up))));
    if let Some((axis, _)) = other {
        notes.push(SubjectNote::LiesDown { axis, given });
    }
    let groups = characters(pieces, (high - low).length()).max(crowd(pieces));
    if groups > 1 {
        notes.push(SubjectNote::StandApart { groups });
    }
}

fn bounds(pieces: &[Piece]) -> (DVec3, DVec3) {
    pieces.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(low, high), p| (low.min(p.low), high.max(p.high)))
}

/// Whether `up`, an axis other than y, seems to point up.
///
/// A symmetric body says nothing of what is up: both y and z lie in its plane. What says something is where
/// models stand: on their origin, with most of the body above it. A model that stands so along z, is taller than it is
/// deep that way, and lies in the middle of y, was hardly made with y up. Models that float, and those that
/// were centred, are not told.
fn stands_along(mesh: &Mesh, low: DVec3, high: DVec3, up: [f32; 3]) -> bool {
    let size = high - low;
    let axis = (0..3).find(|&axis| up[axis] != 0.0).unwrap_or(1);
    let ground = if up[axis] > 0.0 { low[axis] } else { high[axis] };
    let on_origin = |axis: usize, ground: f64| ground.abs() <= STANDS * size[axis] && size[axis] > 0.0;
    let about_origin = |axis: usize| (low[axis] + high[axis]).abs() <= 0.5 * size[axis];
    // What stands on its head is as tall so.
    let tall = axis == 1 || size[axis] > 1.3 * size[1];
    let beside = (0..3).filter(|other| *other != axis).all(about_origin);
    if !(on_origin(axis, ground) && tall && beside && !on_origin(1, low[1])) {
        return false;
    }
    // Feet: what touches the ground is less than a body that lies on its side shows.
    mesh.positions().iter().filter(|p| (f64::from(p[axis]) - ground).abs() <= STANDS * size[axis]).count() >= 3
}

/// How many large groups of pieces stand apart. Pieces whose boxes are nearer than a gap are of one group.
fn characters(pieces: &[Piece], diagonal: f64) -> usize {
    let gap = DVec3::splat(0.5 * GAP * diagonal);
    let mut groups: Vec<(DVec3, DVec3, f64)> = pieces.iter().map(|p| (p.low - gap, p.high + gap, p.area)).collect();
    // Most files have few pieces; of those with thousands, small ones are left to the large.
    groups.sort_by(|a, b| b.2.total_cmp(&a.2));
    groups.truncate(256);
    loop {
        let touch = |a: &(DVec3, DVec3, f64), b: &(DVec3, DVec3, f64)| a.0.cmple(b.1).all() && b.0.cmple(a.1).all();
        let pair = (0..groups.len())
            .find_map(|i| (i + 1..groups.len()).find(|&j| touch(&groups[i], &groups[j])).map(|j| (i, j)));
        let Some((i, j)) = pair else { break };
        let (low, high, area) = groups.remove(j);
        let own = &mut groups[i];
        *own = (own.0.min(low), own.1.max(high), own.2 + area);
    }
    let most = groups.iter().map(|g| g.2).fold(0.0, f64::max);
    groups.iter().filter(|g| g.2 >= LARGE * most && most > 0.0).count()
}

/// A group of pieces and the box around it.
#[derive(Clone, Copy)]
struct Group {
    low: DVec3,
    high: DVec3,
    area: f64,
}

impl Group {
    fn of(piece: &Piece) -> Self {
        Self { low: piece.low, high: piece.high, area: piece.area }
    }

    fn with(self, other: Self) -> Self {
        let (low, high) = (self.low.min(other.low), self.high.max(other.high));
        Self { low, high, area: self.area + other.area }
    }

    fn size(&self) -> DVec3 {
        self.high - self.low
    }

    /// Whether seen from above there is a gap between two.
    fn is_beside(&self, other: &Self) -> bool {
        let gap = (self.low - other.high).max(other.low - self.high);
        gap.x.max(gap.z) > GAP * self.with(*other).size().length()
    }

    /// Whether it may be a character that stands on the ground, beside others of a height.
    fn stands(&self, ground: f64, tallest: f64) -> bool {
        let DVec3 { x, y, z } = self.size();
        let [flat, thin] = HEIGHTS.map(|times| times * x.max(z));
        y >= TALL * tallest && self.low.y - ground <= GROUND * tallest && (flat..=thin).contains(&y)
    }
}

/// How many stand beside each other as a crowd does, however many there are; 0 where something else is large.
///
/// Beside a whole crowd the gaps in it are small, so each is measured against the two that it parts. Plates of armour,
/// leaves and planks lie apart so, too. What only a crowd does is that all that is large stands on one ground, about as
/// tall, nothing above anything else: a body has something over its feet.
fn crowd(pieces: &[Piece]) -> usize {
    let mut order: Vec<Group> = pieces.iter().map(Group::of).collect();
    order.sort_by(|a, b| b.area.total_cmp(&a.area));
    let mut groups: Vec<Group> = Vec::new();
    for mut own in order {
        // What grows may touch what it did not before.
        while let Some(near) = groups.iter().position(|other| !own.is_beside(other)) {
            own = own.with(groups.swap_remove(near));
        }
        groups.push(own);
        if groups.len() > CROWD {
            return 0;
        }
    }
    let most = groups.iter().map(|g| g.area).fold(0.0, f64::max);
    let total: f64 = groups.iter().map(|g| g.area).sum();
    groups.retain(|g| g.area >= LARGE * most && most > 0.0);
    let ground = groups.iter().map(|g| g.low.y).fold(f64::INFINITY, f64::min);
    let tallest = groups.iter().map(|g| g.size().y).fold(0.0, f64::max);
    let large: f64 = groups.iter().map(|g| g.area).sum();
    let all = large >= (1.0 - MUCH) * total && groups.iter().all(|g| g.stands(ground, tallest));
    if all { groups.len() } else { 0 }
}

/// The mesh with closed surfaces that face inwards turned round; tells how many triangles, if any.
///
/// Pieces inside others, as the inside of a mouth is, face inwards for good reason and are left: turned is what
/// is at least half as large as the largest closed piece, where that makes a good part of the surface.
pub(super) fn facing_out(mesh: Mesh, pieces: &[Piece], notes: &mut Vec<SubjectNote>) -> Mesh {
    let largest = pieces.iter().filter_map(|p| p.volume).map(f64::abs).fold(0.0, f64::max);
    let inwards = || pieces.iter().filter(|p| p.volume.is_some_and(|v| v < -0.5 * largest));
    let area: f64 = inwards().map(|p| p.area).sum();
    if area < MUCH * pieces.iter().map(|p| p.area).sum::<f64>() || area == 0.0 {
        return mesh;
    }
    let turned: Vec<u32> = inwards().flat_map(|p| p.triangles.iter().copied()).collect();
    notes.push(SubjectNote::InsideOut { triangles: turned.len(), of: mesh.triangles().len() });
    let (positions, mut triangles) = mesh.clone().into_parts();
    for t in turned {
        triangles[t as usize].swap(1, 2);
    }
    Mesh::new(positions, triangles).unwrap_or(mesh)
}

#[cfg(test)]
mod tests {
    use super::super::pieces::{pieces, tests::tetrahedron};
    use super::super::twins;
    use super::*;

    fn notes(mesh: &Mesh) -> Vec<SubjectNote> {
        let mut notes = Vec::new();
        let pieces = pieces(mesh, &twins(mesh.positions()));
        doubts(mesh, &pieces, UpAxis::Y, false, &mut notes);
        facing_out(mesh.clone(), &pieces, &mut notes);
        notes
    }

    fn both(a: (Vec<[f32; 3]>, Vec<[u32; 3]>), b: (Vec<[f32; 3]>, Vec<[u32; 3]>)) -> Mesh {
        let from = a.0.len() as u32;
        let triangles = a.1.into_iter().chain(b.1.into_iter().map(|t| t.map(|v| v + from))).collect();
        Mesh::new([a.0, b.0].concat(), triangles).unwrap()
    }

    #[test]
    fn two_that_stand_apart_are_told_and_a_hat_is_not() {
        let of = |x: f32, size: f32| notes(&both(tetrahedron([0.0; 3], 1.0), tetrahedron([x, 0.0, 0.0], size)));
        assert_eq!(of(3.0, 1.0), [SubjectNote::StandApart { groups: 2 }]);
        assert!(of(3.0, 0.2).is_empty() && of(1.01, 1.0).is_empty());
    }

    /// So many copies of pieces on a grid on the ground, each piece a tetrahedron by its place and size.
    fn rows([wide, deep]: [usize; 2], step: [f32; 2], pieces: &[([f32; 3], f32)]) -> Mesh {
        let (mut positions, mut triangles): (Vec<[f32; 3]>, Vec<[u32; 3]>) = (Vec::new(), Vec::new());
        for (i, k) in (0..wide).flat_map(|i| (0..deep).map(move |k| (i, k))) {
            for &([x, y, z], size) in pieces {
                let (own, faces) = tetrahedron([x + step[0] * i as f32, y, z + step[1] * k as f32], size);
                let from = positions.len() as u32;
                positions.extend(own);
                triangles.extend(faces.iter().map(|t| t.map(|v| v + from)));
            }
        }
        Mesh::new(positions, triangles).unwrap()
    }

    #[test]
    fn a_crowd_is_told_however_many_there_are() {
        // A body, a head that floats over it, and buttons.
        let one = [([0.0; 3], 1.0), ([0.1, 1.05, 0.1], 0.5), ([0.3, 0.5, 0.5], 0.02), ([0.3, 0.6, 0.5], 0.02)];
        for [wide, deep] in [[3, 1], [10, 1], [12, 12], [40, 20]] {
            let told = notes(&rows([wide, deep], [1.5, 1.4], &one));
            assert_eq!(told, [SubjectNote::StandApart { groups: wide * deep }]);
        }
        // Some are half as tall, and some float a little.
        let few = [([0.0; 3], 1.0), ([1.5, 0.05, 0.0], 0.6), ([3.0, 0.0, 0.0], 0.9)];
        assert_eq!(notes(&rows([4, 1], [4.5, 1.0], &few)), [SubjectNote::StandApart { groups: 12 }]);
    }

    #[test]
    fn one_model_of_many_pieces_is_no_crowd() {
        // Plates that hang over each other, as armour and a robot's do; leaves in the air; steps of a stair.
        let plates = [([0.0, 0.0, 0.0], 0.4), ([0.6, 0.0, 0.0], 0.4), ([0.2, 0.6, 0.0], 0.5), ([0.2, 1.3, 0.0], 0.4)];
        let robot = rows([1, 1], [1.0; 2], &plates);
        let arms = rows([1, 1], [1.0; 2], &[plates[2], ([-0.5, 0.7, 0.0], 0.4), ([0.9, 0.7, 0.0], 0.4)]);
        let leaves: Vec<_> = (0..40).map(|k| ([0.3 * k as f32, (0.2 * k as f32).sin(), 0.0], 0.2)).collect();
        let stair: Vec<_> = (0..9).map(|k| ([1.2 * k as f32, 0.7 * k as f32, 0.0], 1.0)).collect();
        // A body that is larger than all the little ones on the ground around it.
        let chicks: Vec<_> = (0..6).map(|k| ([4.2 + 0.3 * k as f32, 0.0, 0.0], 0.2)).chain([([0.0; 3], 4.0)]).collect();
        let alone = |of: &[([f32; 3], f32)]| rows([1, 1], [1.0; 2], of);
        for mesh in [robot, arms, alone(&leaves), alone(&stair), alone(&chicks)] {
            assert!(crowd(&pieces(&mesh, &twins(mesh.positions()))) < 2);
        }
    }

    #[test]
    fn posts_of_a_fence_and_tiles_are_no_crowd() {
        let of = |size: DVec3| {
            let piece = |k: usize| {
                let low = DVec3::new(2.0 * k as f64 * size.x, 0.0, 0.0);
                Piece { triangles: Vec::new(), low, high: low + size, area: 1.0, volume: None }
            };
            crowd(&(0..30).map(piece).collect::<Vec<_>>())
        };
        assert_eq!(of(DVec3::new(1.0, 2.0, 0.5)), 30);
        assert_eq!([of(DVec3::new(0.1, 1.0, 0.05)), of(DVec3::new(1.0, 0.05, 1.0))], [0, 0]);
    }

    #[test]
    fn what_faces_inwards_is_turned_and_an_inner_shell_is_not() {
        let inwards = |mut of: (Vec<[f32; 3]>, Vec<[u32; 3]>)| {
            of.1.iter_mut().for_each(|t| t.swap(1, 2));
            of
        };
        let out = both(inwards(tetrahedron([0.0; 3], 1.0)), tetrahedron([0.1; 3], 0.1));
        assert_eq!(notes(&out), [SubjectNote::InsideOut { triangles: 4, of: 8 }]);
        assert!(notes(&both(tetrahedron([0.0; 3], 1.0), inwards(tetrahedron([0.1; 3], 0.1)))).is_empty());
    }

    #[test]
    fn a_figure_that_stands_on_z_is_told_and_one_on_y_is_not() {
        // Two legs of four corners each on the ground and a head, thin across.
        let mut points = Vec::new();
        for x in [-0.5, -0.2, 0.2, 0.5] {
            points.extend([[x, -0.1, 0.0], [x, 0.1, 0.0]]);
        }
        points.extend([[0.0, 0.0, 2.0], [0.1, 0.1, 2.0]]);
        let triangles = vec![[0, 1, 8], [2, 3, 8], [4, 5, 9], [6, 7, 9]];
        // As a file in which `axis` is up is looked at whose user says that `given` is.
        let told = |axis: UpAxis, given: UpAxis| {
            let at = points.iter().map(|p| given.to_y(axis.from_y(UpAxis::Z.to_y(*p)))).collect();
            let mesh = Mesh::new(at, triangles.clone()).unwrap();
            let mut notes = Vec::new();
            doubts(&mesh, &pieces(&mesh, &twins(mesh.positions())), given, false, &mut notes);
            notes.into_iter().find_map(|note| match note {
                SubjectNote::LiesDown { axis, given: told } if told == given => Some(axis),
                _ => None,
            })
        };
        assert_eq!(told(UpAxis::Z, UpAxis::Y), Some(UpAxis::Z));
        for given in [UpAxis::X, UpAxis::MinusX, UpAxis::MinusY, UpAxis::Z, UpAxis::MinusZ] {
            assert_eq!(told(UpAxis::Y, given), Some(UpAxis::Y), "{given}");
        }
        for given in UpAxis::ALL {
            assert_eq!(told(given, given), None, "{given}");
        }
        // A VRM 0.x is turned round once it stands.
        let round = |[x, y, z]: [f32; 3]| [-x, y, -z];
        let at = points.iter().map(|p| round(*p)).collect();
        let mesh = Mesh::new(at, triangles.clone()).unwrap();
        let mut notes = Vec::new();
        doubts(&mesh, &pieces(&mesh, &twins(mesh.positions())), UpAxis::Y, true, &mut notes);
        assert!(notes.contains(&SubjectNote::LiesDown { axis: UpAxis::Z, given: UpAxis::Y }), "{notes:?}");
    }

    #[test]
    fn triangles_without_area_are_counted() {
        let mesh = Mesh::new(vec![[0.0; 3], [1.0; 3], [2.0; 3], [0.0, 1.0, 0.0]], vec![[0, 1, 2], [0, 1, 3]]).unwrap();
        assert_eq!(notes(&mesh), [SubjectNote::Flat { triangles: 1 }]);
    }
}
