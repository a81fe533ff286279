//! A prediction in the truth's coordinates, on its vertices and joints.

use riglab_core::{Bounds, Rig, Vec3};
use riglab_metric::{Joints, Rows};
use rstar::RTree;
use rstar::primitives::GeomWithData;

use crate::Prediction;

/// Vertices in the truth's order are off by no more than this share of the longest side.
const SAME_PLACE: f64 = 2e-3;
/// Boxes are the same within this share of the longest side; those of points, which miss corners, within the second.
const SAME_BOX: f64 = 0.02;
const SAME_BOX_OF_POINTS: f64 = 0.06;
/// A vertex takes the weights of a predicted one no farther than this.
const NEAR: f64 = 0.05;
/// Share of vertices that may have none so near.
const FAR: f64 = 0.01;
/// Joints are the same within this share: what 16-bit numbers and printed decimals do to them.
const SAME_JOINT: f64 = 5e-3;
/// Share of joints that lie in the box, enlarged by a tenth, where a skeleton comes without mesh.
const INSIDE: f64 = 0.9;
/// Joints that span less of what the true ones do are in no cube.
const LEAST_SPAN: f64 = 0.25;
/// A cube is taken where its joints' span is nearer to the true one than as they are, by this many doublings: the next cube
/// is one away.
const CLEARLY: f64 = 0.5;

/// What can be measured.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// The joints in the truth's coordinates.
    pub joints: Joints,
    /// The weights of the truth's vertices on its joints, or why there are none.
    pub weights: Result<Rows, String>,
    /// The parents of the truth's joints, where the prediction has the same joints.
    pub parents: Option<Vec<Option<usize>>>,
    /// What was moved, scaled or matched by position.
    pub notes: Vec<String>,
}

/// p -> scale · (p - from) + to
#[derive(Clone, Copy)]
struct Map {
    scale: f64,
    from: [f64; 3],
    to: [f64; 3],
}

impl Map {
    const NONE: Self = Self { scale: 1.0, from: [0.0; 3], to: [0.0; 3] };

    fn of(&self, p: [f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| self.scale * (p[k] - self.from[k]) + self.to[k])
    }
}

/// A box in f64.
struct Box3 {
    center: [f64; 3],
    size: [f64; 3],
    longest: f64,
}

impl Box3 {
    fn of(points: impl IntoIterator<Item = Vec3>) -> Option<Self> {
        let bounds = Bounds::of(points)?;
        let center = std::array::from_fn(|k| (f64::from(bounds.min[k]) + f64::from(bounds.max[k])) / 2.0);
        let size: [f64; 3] = std::array::from_fn(|k| f64::from(bounds.max[k]) - f64::from(bounds.min[k]));
        Some(Self { center, longest: size.into_iter().fold(0.0, f64::max), size })
    }
}

/// Brings a prediction onto the true rig.
///
/// Vertices in the truth's order are taken as they are, others by position; a mesh of another place or size is moved
/// and scaled to the truth's box. A skeleton without mesh is taken to be in the truth's coordinates if it fits them, or in
/// a cube of side 2 or 1 around the mesh if there its joints span clearly more nearly what the true ones do.
///
/// # Errors
/// A sentence, where the mesh is another one or the coordinates cannot be told.
pub fn fit(prediction: &Prediction, truth: &Rig) -> Result<Fitted, String> {
    if prediction.joints.positions.is_empty() {
        return Err("it has no joints".into());
    }
    let positions = truth.mesh().positions();
    let whole = Box3::of(positions.iter().copied()).ok_or("the truth has no vertex")?;
    let longest = whole.longest.max(f64::MIN_POSITIVE);
    let mut notes = Vec::new();
    let mut order = Ok(Order::Same);
    let map = if prediction.vertices.is_empty() {
        order = Err("it has no vertices: weights cannot be compared".to_owned());
        place_of_joints(&prediction.joints, truth, &whole, &mut notes)?
    } else {
        place_of_mesh(prediction, positions, &whole, &mut order, &mut notes)?
    };
    let joints = Joints {
        positions: prediction.joints.positions.iter().map(|p| map.of(*p)).collect(),
        parents: prediction.joints.parents.clone(),
    };
    let same = same_joints(&joints, &prediction.names, truth, longest);
    let fit = if prediction.unfit_weights.is_empty() { order } else { Err(prediction.unfit_weights.clone()) };
    let weights = fit.and_then(|order| {
        let rows = prediction.weights.as_ref().ok_or("it has no weights")?;
        let order = match order {
            Order::Same => None,
            Order::Nearest => {
                Some(nearest(&prediction.vertices, map, positions, longest, prediction.is_mesh, &mut notes)?)
            }
        };
        on_truth(rows, order.as_deref(), &same, truth.skeleton().len())
    });
    Ok(Fitted { parents: parents(&joints, &same, truth.skeleton().len()), joints, weights, notes })
}

/// How predicted vertices stand to true ones.
enum Order {
    Same,
    Nearest,
}

fn place_of_mesh(
    prediction: &Prediction,
    truth: &[Vec3],
    whole: &Box3,
    order: &mut Result<Order, String>,
    notes: &mut Vec<String>,
) -> Result<Map, String> {
    let own = Box3::of(prediction.vertices.iter().copied()).ok_or("it has no vertices")?;
    let what = if prediction.is_mesh { "mesh" } else { "points" };
    let onto = Map {
        scale: if own.longest > 0.0 { whole.longest / own.longest } else { 1.0 },
        from: own.center,
        to: whole.center,
    };
    let moved = format!("its {what} was moved and scaled by {} to the truth's box", short(onto.scale));
    if prediction.vertices.len() == truth.len() {
        let off = |map: Map| {
            let apart = |(p, t): (&Vec3, &Vec3)| distance(map.of(p.map(f64::from)), t.map(f64::from));
            prediction.vertices.iter().zip(truth).map(apart).fold(0.0, f64::max)
        };
        if off(Map::NONE) <= SAME_PLACE * whole.longest {
            return Ok(Map::NONE);
        }
        if off(onto) <= SAME_PLACE * whole.longest {
            notes.push(moved);
            return Ok(onto);
        }
    }
    *order = Ok(Order::Nearest);
    let room = if prediction.is_mesh { SAME_BOX } else { SAME_BOX_OF_POINTS } * whole.longest;
    let sizes = |scale: f64| (0..3).all(|k| (scale * own.size[k] - whole.size[k]).abs() <= room);
    if sizes(1.0) && distance(own.center, whole.center) <= room {
        return Ok(Map::NONE);
    }
    if !sizes(onto.scale) {
        let shown = |b: &Box3| b.size.map(short).join(" x ");
        return Err(format!(
            "its {what} has other proportions ({}, the truth {}): turned, posed or another mesh",
            shown(&own),
            shown(whole)
        ));
    }
    notes.push(moved);
    Ok(onto)
}

/// Where a skeleton without mesh lies: in the truth's coordinates, or in a cube around the truth. Often its joints would fit
/// several of them. What tells is how far they span, beside how far the true ones do: figures are of no account, and a cube,
/// in which a small skeleton would grow, has to be the clearly better guess.
fn place_of_joints(joints: &Joints, truth: &Rig, whole: &Box3, notes: &mut Vec<String>) -> Result<Map, String> {
    let narrow = |p: &[f64; 3]| p.map(|x| x as f32);
    let own = Box3::of(joints.positions.iter().map(narrow)).ok_or("it has no joints")?;
    let true_span = Box3::of(truth.skeleton().heads().iter().copied()).map_or(0.0, |b| b.longest);
    // Of a truth without bones the mesh alone says how far joints may span.
    let true_span = if true_span > 0.0 { true_span } else { whole.longest };
    let inside = |map: &Map| {
        let within = |p: &&[f64; 3]| {
            let p = map.of(**p);
            (0..3).all(|k| (p[k] - whole.center[k]).abs() <= 0.5 * whole.size[k] + 0.1 * whole.longest)
        };
        joints.positions.iter().filter(within).count() as f64 >= INSIDE * joints.positions.len() as f64
    };
    // Of the true joints' span, and how often that has to be doubled or halved.
    let span = |map: &Map| own.longest * map.scale / true_span;
    let apart = |map: &Map| span(map).log2().abs();
    let in_cube = |side: f64| (side, Map { scale: whole.longest / side, from: [0.0; 3], to: whole.center });
    let cubes = [1.0, 2.0].map(in_cube).into_iter().filter(|(_, map)| inside(map) && span(map) >= LEAST_SPAN);
    let cube = cubes.min_by(|(_, a), (_, b)| apart(a).total_cmp(&apart(b)));
    let as_it_is = inside(&Map::NONE);
    match cube {
        Some((side, map)) if !as_it_is || apart(&Map::NONE) > apart(&map) + CLEARLY => {
            notes.push(format!(
                "it has no mesh: its joints are taken to be in a cube of side {side} around the truth's, where they span \
                 {:.2} of what the true ones do",
                span(&map)
            ));
            Ok(map)
        }
        _ if as_it_is => {
            notes.push("it has no mesh: its joints are taken to be in the truth's coordinates".into());
            Ok(Map::NONE)
        }
        _ => Err("it has no mesh, and its joints lie neither in the truth's box nor in a cube of side 1 or 2".into()),
    }
}

/// The predicted vertex nearest to each true one.
fn nearest(
    vertices: &[Vec3],
    map: Map,
    truth: &[Vec3],
    longest: f64,
    is_mesh: bool,
    notes: &mut Vec<String>,
) -> Result<Vec<usize>, String> {
    let points = vertices.iter().enumerate().map(|(v, p)| GeomWithData::new(map.of(p.map(f64::from)), v)).collect();
    let tree = RTree::bulk_load(points);
    let (mut far, mut farthest) = (0usize, 0.0f64);
    let mut found = Vec::with_capacity(truth.len());
    for p in truth {
        let p = p.map(f64::from);
        let near = tree.nearest_neighbor(p).ok_or("it has no vertices")?;
        let d = distance(*near.geom(), p);
        far += usize::from(d > NEAR * longest);
        farthest = farthest.max(d);
        found.push(near.data);
    }
    let what = if is_mesh { "vertices" } else { "points" };
    let (share, count) = (far as f64 / truth.len() as f64, vertices.len());
    if share > FAR {
        return Err(format!(
            "{:.0} % of the truth's vertices have none of its {count} {what} within {:.0} % of the longest side",
            100.0 * share,
            100.0 * NEAR
        ));
    }
    notes.push(format!(
        "weights of the truth's {} vertices are those of the nearest of its {count} {what}, at most {:.2} % of the \
         longest side away",
        truth.len(),
        100.0 * farthest / longest
    ));
    Ok(found)
}

/// The true joint that each predicted one is, by place and, where several are there, by name.
fn same_joints(joints: &Joints, names: &[String], truth: &Rig, longest: f64) -> Vec<Option<usize>> {
    let heads: Vec<[f64; 3]> = truth.skeleton().heads().iter().map(|h| h.map(f64::from)).collect();
    let mut taken = vec![false; heads.len()];
    let mut same = vec![None; joints.positions.len()];
    let candidates = |p: [f64; 3]| {
        let near = heads.iter().enumerate().map(move |(g, h)| (distance(p, *h), g));
        near.filter(|(d, _)| *d <= SAME_JOINT * longest).collect::<Vec<_>>()
    };
    // Names first, over all: a joint without a name of the truth must not take the place of one that has it.
    for by_name in [true, false] {
        for (j, p) in joints.positions.iter().enumerate() {
            if same[j].is_some() {
                continue;
            }
            let named = |g: usize| names.get(j).is_some_and(|n| *n == truth.skeleton().names()[g]);
            let fits = candidates(*p).into_iter().filter(|(_, g)| !taken[*g] && (!by_name || named(*g)));
            if let Some((_, g)) = fits.min_by(|a, b| a.0.total_cmp(&b.0)) {
                (same[j], taken[g]) = (Some(g), true);
            }
        }
    }
    same
}

/// Weights on the truth's vertices and joints.
fn on_truth(rows: &Rows, order: Option<&[usize]>, same: &[Option<usize>], joints: usize) -> Result<Rows, String> {
    let mut holds = vec![false; same.len()];
    rows.iter().flatten().for_each(|(j, _)| holds[*j as usize] = true);
    let others = holds.iter().zip(same).filter(|(holds, same)| **holds && same.is_none()).count();
    if others > 0 {
        let held = holds.iter().filter(|h| **h).count();
        return Err(format!(
            "{others} of its {held} joints that hold vertices are not in the true rig, so weights are not compared"
        ));
    }
    let row = |v: usize| {
        let own = rows.row(v).iter();
        own.filter_map(|(j, w)| Some((same[*j as usize]? as u32, *w))).collect::<Vec<_>>()
    };
    Ok(match order {
        Some(order) => Rows::new(order.iter().map(|v| row(*v)), joints),
        None => Rows::new((0..rows.len()).map(row), joints),
    })
}

/// The parents of the true joints, if the prediction has all of them and no others.
fn parents(joints: &Joints, same: &[Option<usize>], count: usize) -> Option<Vec<Option<usize>>> {
    if same.len() != count || same.iter().any(Option::is_none) {
        return None;
    }
    let mut out = vec![None; count];
    for (j, parent) in joints.parents.iter().enumerate() {
        out[same[j]?] = parent.and_then(|p| same[p]);
    }
    Some(out)
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum::<f64>().sqrt()
}

fn short(x: f64) -> String {
    format!("{x:.3}")
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Mesh, Skeleton, SkinWeights};

    use super::*;

    /// A strip of 2 x 11 vertices along x, of length 10, on a chain of three joints.
    fn strip() -> Rig {
        let joint = |k: u16| Joint {
            name: ["a", "b", "c"][usize::from(k)].into(),
            parent: k.checked_sub(1).map(JointId),
            head: [4.0 * f32::from(k) + 1.0, 0.5, 0.0],
        };
        let positions: Vec<Vec3> = (0..11).flat_map(|x| [[x as f32, 0.0, 0.0], [x as f32, 1.0, 0.0]]).collect();
        let triangles = (0..10u32).flat_map(|x| [[2 * x, 2 * x + 1, 2 * x + 2], [2 * x + 1, 2 * x + 3, 2 * x + 2]]);
        let rows = (0..22u16).map(|v| [(v / 8, 1.0), ((v / 8 + 1).min(2), 1.0)]);
        let mesh = Mesh::new(positions, triangles.collect()).unwrap();
        let skeleton = Skeleton::new((0..3).map(joint).collect()).unwrap();
        Rig::new(skeleton, mesh, SkinWeights::normalized(rows).unwrap()).unwrap()
    }

    fn own(rig: &Rig) -> Prediction {
        Prediction {
            files: Vec::new(),
            joints: Joints::of(rig.skeleton()),
            names: rig.skeleton().names().to_vec(),
            vertices: rig.mesh().positions().to_vec(),
            is_mesh: true,
            weights: Some(Rows::of(rig.weights(), rig.skeleton().len())),
            unfit_weights: String::new(),
        }
    }

    #[test]
    fn the_truth_fits_itself_without_a_word() {
        let (rig, fitted) = (strip(), fit(&own(&strip()), &strip()).unwrap());
        assert_eq!(fitted.weights, Ok(Rows::of(rig.weights(), 3)));
        assert_eq!(fitted.parents, Some(vec![None, Some(0), Some(1)]));
        assert!(fitted.notes.is_empty());
    }

    #[test]
    fn another_place_size_and_order_are_undone_and_told() {
        let rig = strip();
        let mut p = own(&rig);
        let smaller = |x: [f64; 3]| [0.1 * x[0] - 0.5, 0.1 * x[1] - 0.05, 0.1 * x[2]];
        p.vertices.iter_mut().for_each(|v| *v = smaller(v.map(f64::from)).map(|x| x as f32));
        p.joints.positions.iter_mut().for_each(|j| *j = smaller(*j));
        let fitted = fit(&p, &rig).unwrap();
        assert!(fitted.notes[0].contains("scaled by 10.000"), "{:?}", fitted.notes);
        assert_eq!(fitted.weights, Ok(Rows::of(rig.weights(), 3)));
        assert!(distance(fitted.joints.positions[2], [9.0, 0.5, 0.0]) < 1e-5);
        // Every vertex twice, the last first.
        p.vertices = p.vertices.iter().rev().flat_map(|v| [*v, *v]).collect();
        p.weights = Some(Rows::new((0..44).map(|k| p.weights.as_ref().unwrap().row(21 - k / 2).to_vec()), 3));
        let fitted = fit(&p, &rig).unwrap();
        assert_eq!(fitted.weights, Ok(Rows::of(rig.weights(), 3)));
        assert!(fitted.notes[1].contains("nearest of its 44 vertices"), "{:?}", fitted.notes);
    }

    #[test]
    fn another_mesh_is_refused_and_another_skeleton_has_no_weights() {
        let rig = strip();
        let mut turned = own(&rig);
        turned.vertices.iter_mut().for_each(|v| *v = [v[1], v[0], v[2]]);
        assert!(fit(&turned, &rig).unwrap_err().contains("other proportions"));
        let mut moved = own(&rig);
        moved.joints.positions[1][1] += 0.3;
        let fitted = fit(&moved, &rig).unwrap();
        assert!(fitted.weights.unwrap_err().contains("1 of its 3 joints") && fitted.parents.is_none());
        let mut sparse = own(&rig);
        sparse.vertices.truncate(3);
        sparse.vertices[1] = [10.0, 1.0, 0.0];
        sparse.weights = Some(Rows::dense(&[1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0], 3));
        assert!(fit(&sparse, &rig).unwrap().weights.unwrap_err().contains("within 5 %"));
        assert!(fit(&Prediction::default(), &rig).unwrap_err().contains("no joints"));
        let unfit = Prediction { unfit_weights: "of another".into(), ..own(&rig) };
        assert_eq!(fit(&unfit, &rig).unwrap().weights.unwrap_err(), "of another");
    }

    #[test]
    fn a_skeleton_alone_finds_its_cube() {
        let rig = strip();
        let alone = |f: &dyn Fn(f64) -> f64| {
            let mut p = Prediction { joints: Joints::of(rig.skeleton()), ..Prediction::default() };
            p.joints.positions.iter_mut().for_each(|j| *j = [f(j[0] - 5.0), f(j[1] - 0.5), f(j[2])]);
            fit(&p, &rig)
        };
        for (scale, side) in [(0.2, "2"), (0.1, "1")] {
            let fitted = alone(&|x| scale * x).unwrap();
            assert!(fitted.notes[0].contains(&format!("side {side} ")), "{:?}", fitted.notes);
            assert!(distance(fitted.joints.positions[2], [9.0, 0.5, 0.0]) < 1e-5);
            assert!(fitted.weights.is_err());
        }
        assert!(alone(&|x| 1e6 * x + 3e6).unwrap_err().contains("neither"));
    }

    #[test]
    fn a_skeleton_alone_that_fits_as_it_is_is_not_blown_up() {
        // A square of side 2 around a chain in its middle that spans 0.7.
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: k.checked_sub(1).map(JointId),
            head: [0.35 * f32::from(k) - 0.35, 0.1, 0.0],
        };
        let corners = vec![[-1.0, -1.0, 0.0], [1.0, -1.0, 0.0], [1.0, 1.0, 0.0], [-1.0, 1.0, 0.0]];
        let mesh = Mesh::new(corners, vec![[0, 1, 2], [0, 2, 3]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0u16, 1.0)]; 4]).unwrap();
        let rig = Rig::new(Skeleton::new((0..3).map(joint).collect()).unwrap(), mesh, weights).unwrap();
        let alone = |by: f64| {
            let mut joints = Joints::of(rig.skeleton());
            joints.positions.iter_mut().for_each(|j| *j = j.map(|x| by * x));
            let fitted = fit(&Prediction { joints, ..Prediction::default() }, &rig).unwrap();
            (fitted.joints.positions[2][0], fitted.notes[0].clone())
        };
        let near = |x: f64, wanted: f64| assert!((x - wanted).abs() < 1e-6, "{x}");
        // The true one, and others that no cube makes clearly more like it.
        for by in [1.0, 0.6, 1.5, 2.5, 0.1] {
            let (x, note) = alone(by);
            near(x, by * 0.35);
            assert!(note.ends_with("in the truth's coordinates"), "{by}: {note}");
        }
        // Half as large, it is in a cube of side 1, and told so.
        let (x, note) = alone(0.5);
        near(x, 0.35);
        assert!(note.contains("side 1 ") && note.ends_with("span 1.00 of what the true ones do"), "{note}");
    }
}
