//! From a body to a rig with about as many triangles as were asked for.

use std::ops::RangeInclusive;

use riglab_core::{Humanoid, JointId, Mesh, Rig, SkinWeights};

use crate::body::Body;
use crate::cells::{Cells, Sizes};
use crate::field::Field;
use crate::net::{Polygon, polygons};
use crate::part::Part;
use crate::piece::{Limits, PieceMesh};
use crate::skin::{self, Row};
use crate::springs::springs;
use crate::surface::{Surface, components};
use crate::turn::pow;

/// How a body is meshed and skinned.
#[derive(Clone, Debug)]
pub(crate) struct Finish {
    /// Triangles to aim at.
    pub target: u32,
    /// Triangles that are accepted.
    pub accepted: RangeInclusive<u32>,
    /// How far cell sizes follow thickness: 0 gives one size everywhere, 1 as many triangles
    /// around a finger as around the chest.
    pub adaption: f32,
    /// Reach of a joint's weights along a limb, in radii.
    pub softness: f32,
}

/// How often the cell size is corrected. Triangles go with its inverse square, so few will do.
const CORRECTIONS: usize = 6;

/// Share of the target that need not be corrected: it was drawn anyway, and each try costs an octree.
const NEAR_ENOUGH: f32 = 0.10;

/// The same outside the accepted range, which may be too narrow to hit.
const CLOSE: f32 = 0.03;

/// Mesh and weights of a body.
pub(crate) fn assemble(body: &Body, finish: &Finish) -> PieceMesh {
    let field = Field::new(body);
    let mut care = vec![1.0; body.joints.len()];
    let target = finish.target as f32;
    let mut scale = first_scale(body, finish);
    let mut best: Option<(f32, Cells, Vec<Polygon>, f32)> = None;
    let mut last: Option<(f32, f32)> = None;
    for _ in 0..CORRECTIONS {
        let cells = Cells::new(&field, &sizes(body, finish, scale, &care));
        let polygons = polygons(&cells);
        let skin: usize = polygons.iter().map(|p| p.sides() - 2).sum();
        let apart: usize = pieces(body, finish, scale).map(|p| p.triangles.len()).sum();
        let count = (skin + apart) as f32;
        let miss = (count / target).max(target / count);
        let tried = scale;
        // Triangles fall with the square of the scale, but slower where thin parts hold out.
        let fall = last.map_or(2.0, |(s, n)| libm::logf(n / count) / libm::logf(tried / s)).clamp(0.7, 2.0);
        scale *= pow(count / target, 1.0 / fall);
        if best.as_ref().is_none_or(|(least, ..)| miss < *least) {
            best = Some((miss, cells, polygons, tried));
        }
        let allowed = finish.accepted.contains(&(count as u32));
        let near = miss < 1.0 + if allowed { NEAR_ENOUGH } else { CLOSE };
        // Thin parts may need small cells whatever the scale: then nothing changes any more.
        if near || last.is_some_and(|(_, n)| (count - n).abs() < 0.005 * count) {
            break;
        }
        last = Some((tried, count));
    }
    let (_, mut cells, mut polygons, scale) = best.expect("at least one try");
    let softness = if body.rigid { 0.0 } else { finish.softness };
    let mut before: Option<(usize, Surface, Vec<Row>)> = None;
    for tries in 0.. {
        let surface = if polygons.is_empty() { Surface::default() } else { Surface::new(&field, &cells, &polygons) };
        let rows = skin::weights(body, &surface, softness);
        let faults = Faults::of(body, &surface, &rows);
        match next(tries, faults.count, before.as_ref().map(|(broken, ..)| *broken)) {
            Next::Take => return joined(surface, rows, pieces(body, finish, scale)),
            Next::TakeEarlier => {
                let (_, surface, rows) = before.expect("it was compared with");
                return joined(surface, rows, pieces(body, finish, scale));
            }
            Next::Again => before = Some((faults.count, surface, rows)),
        }
        (care.iter_mut().zip(faults.joints)).filter(|(_, fault)| *fault).for_each(|(care, _)| *care *= 0.7);
        cells = Cells::new(&field, &sizes(body, finish, scale, &care));
        polygons = crate::net::polygons(&cells);
    }
    unreachable!("the last try returns")
}

/// How often cells are made smaller where flesh fell through them.
const CARES: usize = 3;

/// What comes after a surface.
#[derive(Debug, PartialEq)]
enum Next {
    Take,
    TakeEarlier,
    Again,
}

/// What comes after a surface with so many faults, where the one before it, of larger cells, had `earlier`. What smaller
/// cells do not mend is no fault of the cells; what they tear open is.
fn next(tries: usize, faults: usize, earlier: Option<usize>) -> Next {
    match earlier {
        Some(earlier) if faults > earlier => Next::TakeEarlier,
        Some(earlier) if faults == earlier => Next::Take,
        _ if faults == 0 || tries == CARES => Next::Take,
        _ => Next::Again,
    }
}

/// Where the skin fell to pieces because its cells are too large for it.
struct Faults {
    /// Gaps in the skin, and joints whose flesh is not to be seen.
    count: usize,
    /// The joints it happened at.
    joints: Vec<bool>,
}

impl Faults {
    fn of(body: &Body, surface: &Surface, rows: &[Row]) -> Self {
        let roots = components(surface.positions.len(), &surface.triangles);
        let gaps = roots.iter().enumerate().filter(|&(v, &root)| v as u32 == root).count().saturating_sub(1);
        // A joint whose vertices are in two pieces has the gap in its midst.
        let mut piece: Vec<Option<u32>> = vec![None; body.joints.len()];
        let mut joints = vec![false; body.joints.len()];
        for (row, &root) in rows.iter().zip(&roots) {
            let most = row.iter().copied().reduce(|a, b| if b.1 > a.1 { b } else { a });
            let Some((joint, _)) = most else { continue };
            let joint = usize::from(joint);
            joints[joint] |= *piece[joint].get_or_insert(root) != root;
        }
        let hidden = body.parts.iter().map(|part| usize::from(part.joint)).filter(|&joint| piece[joint].is_none());
        let hidden: Vec<usize> = hidden.collect();
        hidden.iter().for_each(|&joint| joints[joint] = true);
        // A gap just between two joints is nobody's: all take care.
        if !joints.contains(&true) {
            joints.fill(true);
        }
        Self { count: gaps + hidden.len(), joints }
    }
}

/// The rig of an assembled body.
pub(crate) fn rig(body: &Body, assembled: PieceMesh) -> Rig {
    let PieceMesh { positions, triangles, weights } = assembled;
    let mesh = Mesh::new(positions.into_iter().map(Into::into).collect(), triangles).expect("finite and in range");
    let number = |joint: u16| body.numbered(JointId(joint));
    let rows =
        weights.into_iter().map(|row| row.into_iter().map(|(j, w)| (number(j).0, f64::from(w))).collect::<Vec<_>>());
    let weights = SkinWeights::normalized(rows).expect("every vertex has a joint");
    let rig = Rig::new(body.skeleton(), mesh, weights).expect("one row a vertex, joints of the body");
    let mut humanoid = Humanoid::default();
    for &(bone, joint) in &body.human {
        humanoid.insert(bone, body.numbered(joint));
    }
    let rig = rig.with_humanoid(humanoid).expect("joints of the body");
    rig.with_springs(springs(body).renumbered(|joint| body.numbered(joint))).expect("chains in the order of joints")
}

/// Cell size per metre of thickness to the power of the adaption, from the area to cover.
fn first_scale(body: &Body, finish: &Finish) -> f32 {
    let skin = body.parts.iter().map(|p| (p.area(), p.mean()));
    let apart = body.pieces.iter().map(|p| (p.area(), p.scale()));
    // Two triangles a cell; near thinner parts cells are smaller than wanted, on average two thirds.
    let wanted: f32 = skin.chain(apart).map(|(area, r)| area / pow(r, 2.0 * finish.adaption)).sum();
    (2.0 * wanted / (0.40 * finish.target as f32)).sqrt()
}

/// Cell sizes for a scale; `care` by joint, below 1, makes those smaller that show parts which are thin
/// for them.
fn sizes(body: &Body, finish: &Finish, scale: f32, care: &[f32]) -> Sizes {
    let shown_at = |part: &Part| care[usize::from(part.joint)] * part.visible_at();
    let at_part = body.parts.iter().map(|p| shown_at(p).min(scale * pow(p.mean(), finish.adaption)));
    Sizes::new(at_part.collect())
}

fn pieces<'a>(body: &'a Body, finish: &'a Finish, scale: f32) -> impl Iterator<Item = PieceMesh> + 'a {
    let limits = Limits::of(finish.target);
    body.pieces.iter().map(move |p| p.mesh(0.75 * scale * pow(p.scale(), finish.adaption), limits))
}

/// The skin's vertices and triangles come first.
fn joined(surface: Surface, rows: Vec<Row>, pieces: impl Iterator<Item = PieceMesh>) -> PieceMesh {
    let mut mesh = PieceMesh { positions: surface.positions, triangles: surface.triangles, weights: rows };
    for piece in pieces {
        let first = mesh.positions.len() as u32;
        mesh.positions.extend(piece.positions);
        mesh.weights.extend(piece.weights);
        mesh.triangles.extend(piece.triangles.into_iter().map(|t| t.map(|v| v + first)));
    }
    mesh
}

#[cfg(test)]
mod tests {
    use std::collections::HashMap;

    use super::*;
    use crate::dice::Dice;
    use crate::plan::Plan;

    #[test]
    fn skins_are_closed() {
        for plan in Plan::ALL {
            for index in 0..2 {
                let mut dice = Dice::new(riglab_random::stream(2, "skins", &[index]));
                let mut body = plan.body(&mut dice, 3_000);
                body.pieces.clear();
                let finish = Finish { target: 3_000, accepted: 2_000..=8_000, adaption: 0.6, softness: 0.6 };
                let mut edges: HashMap<(u32, u32), i32> = HashMap::new();
                for t in assemble(&body, &finish).triangles {
                    for k in 0..3 {
                        let (a, b) = (t[k], t[(k + 1) % 3]);
                        *edges.entry((a.min(b), a.max(b))).or_default() += if a < b { 1 } else { -1 };
                    }
                }
                assert!(edges.values().all(|&n| n == 0), "{} {index}: an edge with one side", plan.name());
            }
        }
    }

    #[test]
    fn smaller_cells_are_tried_while_they_mend_and_given_up_where_they_tear() {
        assert_eq!([next(0, 0, None), next(0, 2, None), next(1, 1, Some(2))], [Next::Take, Next::Again, Next::Again]);
        assert_eq!([next(1, 2, Some(2)), next(CARES, 1, Some(2))], [Next::Take, Next::Take]);
        assert_eq!([next(1, 3, Some(2)), next(CARES, 3, Some(2))], [Next::TakeEarlier, Next::TakeEarlier]);
    }

    #[test]
    fn limbs_do_not_come_off() {
        // None of 336 bodies of 2,000 and 4,000 triangles was in pieces, when counted.
        let target = 4_000;
        let mut broken = Vec::new();
        for plan in Plan::ALL {
            for index in 0..3 {
                let mut dice = Dice::new(riglab_random::stream(9, "limbs", &[index]));
                let mut body = plan.body(&mut dice, target);
                body.pieces.clear();
                let finish = Finish { target, accepted: 2_000..=8_000, adaption: 0.6, softness: 0.6 };
                let mesh = assemble(&body, &finish);
                let found = components(mesh.positions.len(), &mesh.triangles);
                if found.iter().any(|&c| c != 0) {
                    broken.push((plan.name(), index));
                }
            }
        }
        assert!(broken.is_empty(), "in pieces: {broken:?}");
    }
}
