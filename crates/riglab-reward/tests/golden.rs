//! Rewards against the hand-checked cases and the recorded random one.

#[path = "../../riglab-geom/tests/common/golden.rs"]
mod golden;

use glam::{DAffine3, DMat4};
use golden::{Golden, after, golden};
use riglab_geom::voxel::{Lattice, Voxels};
use riglab_reward::{Faults, RawWeights, containment, coverage, maps, motion, skinned, skinning, stretches};

#[test]
fn rewards() {
    for case in golden("grpo/rewards", "rewards") {
        for group in case.groups() {
            for name in case.outputs(&format!("{group}.")) {
                let got = output(&case, &group, &name[format!("out.{group}.").len()..]);
                case.check(&name, got);
            }
        }
        case.done();
    }
}

fn triples(case: &Golden, name: &str) -> Vec<[f64; 3]> {
    case.values(name).as_chunks::<3>().0.to_vec()
}

fn table(case: &Golden, name: &str) -> RawWeights {
    let joints = case.shape(name)[1];
    let row = |row: &[f64]| row.iter().enumerate().map(|(j, w)| (j as u16, *w)).collect::<Vec<_>>();
    RawWeights::new(case.values(name).chunks_exact(joints).map(row))
}

fn voxels(case: &Golden, of: &str) -> Voxels {
    let cells: Vec<[usize; 3]> = case.indices(&case.input(of, "occupied")).as_chunks::<3>().0.to_vec();
    let size = std::array::from_fn(|k| cells.iter().map(|c| c[k] + 1).max().unwrap());
    let origin = triples(case, &case.input(of, "origin"))[0];
    Voxels::new(Lattice { origin, cell: case.values(&case.input(of, "size"))[0], size }, cells)
}

fn matrices(all: &[f64]) -> Vec<DMat4> {
    all.as_chunks::<16>().0.iter().map(|m| DMat4::from_cols_array(m).transpose()).collect()
}

fn edges(case: &Golden, name: &str) -> Vec<[u32; 2]> {
    case.indices(name).as_chunks::<2>().0.iter().map(|e| e.map(|v| v as u32)).collect()
}

/// What a name without its group tells to compute: `vk_noroot_s5`, `sc_0.5_1`, `bad_mo_s1`.
fn output(case: &Golden, group: &str, name: &str) -> Vec<f64> {
    let words: Vec<&str> = name.split('_').collect();
    let is = |word: &str| words.contains(&word);
    // Steps and scales stand behind an s, exponents alone.
    let number = words.iter().find_map(|w| w.strip_prefix('s')?.parse::<f64>().ok());
    let exponents: Vec<f64> = words.iter().filter_map(|w| w.parse().ok()).collect();
    let exponents = <[f64; 2]>::try_from(exponents).unwrap_or([1.0, 1.0]);
    let unknown = || -> ! { panic!("{}: unknown output `{group}.{name}`", case.name) };
    match words[0] {
        "vj" => vec![covered(case, group, is("world"), if is("first") { 1 } else { usize::MAX })],
        "vk" => vec![contained(case, group, number.unwrap_or_else(|| unknown()) as usize, !is("noroot"))],
        "inside" => inside(case, group, number.unwrap_or_else(|| unknown()) as usize),
        "z" => vec![faults(case, group).unbound.powf(exponents[0])],
        "m" => vec![faults(case, group).crowded.powf(exponents[1])],
        "sc" => vec![skinning(&weighted(case, group), case.number_of(group, "beta"), exponents)],
        "poses" => {
            let rest = matrices(case.values(&case.input(group, "rest")));
            let poses = poses(case, group);
            let all = poses.iter().flat_map(|pose| pose.iter().zip(&rest).map(|(map, rest)| DMat4::from(*map) * *rest));
            all.flat_map(|m| m.transpose().to_cols_array()).collect()
        }
        "identity" => vec![Moving::of(case, group, "").still().moved(number.unwrap_or(1.0))],
        "posed" => {
            let moving = Moving::of(case, group, "");
            moving.poses.iter().flat_map(|p| skinned(&moving.positions, &moving.weights, p)).flatten().collect()
        }
        "max" => Moving::of(case, group, "").stretched(),
        "mo" => vec![Moving::of(case, group, "").moved(number.unwrap_or(1.0))],
        "total" => vec![total(case, group)],
        // With other weights, vertices or edges.
        _ => match name.rsplit_once("_mo_s").map(|(kind, scale)| (kind, scale.parse())) {
            Some((kind, Ok(scale))) => vec![Moving::of(case, group, kind).moved(scale)],
            _ => match name.strip_suffix("_max") {
                Some(kind) => Moving::of(case, group, kind).stretched(),
                None => unknown(),
            },
        },
    }
}

fn skeleton(case: &Golden, group: &str) -> (Vec<[f64; 3]>, Vec<Option<usize>>) {
    let parents = case.values(&case.input(group, "parents")).iter().map(|p| (*p >= 0.0).then_some(*p as usize));
    (triples(case, &case.input(group, "joints")), parents.collect())
}

fn covered(case: &Golden, group: &str, in_world: bool, most: usize) -> f64 {
    let (voxels, alpha) = (voxels(case, group), case.number_of(group, "alpha"));
    let alpha = if in_world { alpha * voxels.lattice().cell } else { alpha };
    let heads = skeleton(case, group).0;
    coverage(&voxels, &heads[..most.min(heads.len())], alpha)
}

fn contained(case: &Golden, group: &str, steps: usize, root: bool) -> f64 {
    let (heads, parents) = skeleton(case, group);
    containment(&voxels(case, group), &heads, &parents, steps, root)
}

fn inside(case: &Golden, group: &str, steps: usize) -> Vec<f64> {
    let (voxels, (heads, parents)) = (voxels(case, group), skeleton(case, group));
    let points = heads.iter().zip(&parents).flat_map(|(head, parent)| {
        let from = parent.map_or(*head, |p| heads[p]);
        let share = move |i: usize| i as f64 / steps as f64;
        (0..=steps).map(move |i| std::array::from_fn(|k| from[k] + share(i) * (head[k] - from[k])))
    });
    points.map(|p| f64::from(u8::from(voxels.contains(p)))).collect()
}

fn weighted(case: &Golden, group: &str) -> RawWeights {
    let named = ["w", "weights"].map(|what| case.input(group, what));
    table(case, named.iter().find(|name| case.has(name)).expect("weights"))
}

fn faults(case: &Golden, group: &str) -> Faults {
    Faults::of(&weighted(case, group), case.number_of(group, "beta"))
}

/// Maps from rest to each pose: of matrices, else of turns.
fn poses(case: &Golden, group: &str) -> Vec<Vec<DAffine3>> {
    let recorded = case.input(group, "poses");
    if !case.has(&recorded) {
        let (heads, parents) = skeleton(case, group);
        let turns = triples(case, &case.input(group, "rotvec"));
        return turns.chunks_exact(heads.len()).map(|t| maps(&heads, &parents, t)).collect();
    }
    let rest = matrices(case.values(&case.input(group, "rest")));
    let map = |(pose, rest): (&DMat4, &DMat4)| DAffine3::from_mat4(*pose * rest.inverse());
    matrices(case.values(&recorded)).chunks_exact(rest.len()).map(|p| p.iter().zip(&rest).map(map).collect()).collect()
}

/// What moves, and how.
struct Moving {
    positions: Vec<[f64; 3]>,
    edges: Vec<[u32; 2]>,
    weights: RawWeights,
    poses: Vec<Vec<DAffine3>>,
}

impl Moving {
    /// A group's, with what is recorded of a kind in its stead.
    fn of(case: &Golden, group: &str, kind: &str) -> Self {
        let own = |what: &str| Some(case.input(group, &format!("{what}_{kind}"))).filter(|name| case.has(name));
        let any = |what: &str| own(what).unwrap_or_else(|| case.input(group, what));
        assert!(
            kind.is_empty() || ["weights", "vertices", "edges"].iter().any(|what| own(what).is_some()),
            "{}: unknown output of `{kind}` in {group}",
            case.name
        );
        let skin = case.input(group, "skin");
        Self {
            positions: triples(case, &any("vertices")),
            edges: edges(case, &any("edges")),
            weights: table(case, &if case.has(&skin) { skin } else { any("weights") }),
            poses: poses(case, group),
        }
    }

    fn still(self) -> Self {
        let joints = self.poses[0].len();
        Self { poses: vec![vec![DAffine3::IDENTITY; joints]], ..self }
    }

    fn moved(&self, scale: f64) -> f64 {
        motion(&self.positions, &self.edges, &self.weights, &self.poses, scale)
    }

    fn stretched(&self) -> Vec<f64> {
        stretches(&self.positions, &self.edges, &self.weights, &self.poses)
    }
}

/// The weighted sum, by the config's weights and what it says of the group: "5*vj + vk(s=20, ...) + sc + mo(s=1)".
fn total(case: &Golden, group: &str) -> f64 {
    let said = case.config(&format!("cases.{group}")).as_str().unwrap_or_default();
    let of = |part: &str, usual: f64| {
        let told = said.split(&format!("{part}(")).nth(1);
        told.and_then(|text| after(text, "s").first().copied()).unwrap_or(usual)
    };
    let weight = |part: &str, usual: f64| case.config("weights")[part].as_f64().unwrap_or(usual);
    let sc = skinning(&weighted(case, group), case.number_of(group, "beta"), [1.0, 1.0]);
    weight("vj", 5.0) * covered(case, group, false, usize::MAX)
        + weight("vk", 1.0) * contained(case, group, of("vk", 20.0) as usize, true)
        + weight("sc", 1.0) * sc
        + weight("mo", 1.0) * Moving::of(case, group, "").moved(of("mo", 1.0))
}

/// UniRig's blend skinning divides weights by the same sum: what a rig, whose weights sum to 1, cannot show.
#[test]
fn weights_that_do_not_sum_to_one() {
    for case in golden("unirig", "lbs_fk") {
        for group in case.groups().into_iter().filter(|group| group.starts_with("lbs_unnormalised")) {
            let input = |what: &str| case.input(&group, what);
            let (rest, basis) =
                (matrices(case.values(&input("matrix_local"))), matrices(case.values(&input("matrix_basis"))));
            let mut posed: Vec<DMat4> = Vec::new();
            for (joint, parent) in case.values(&input("parents")).iter().enumerate() {
                let above = if *parent < 0.0 {
                    DMat4::IDENTITY
                } else {
                    posed[*parent as usize] * rest[*parent as usize].inverse()
                };
                posed.push(above * rest[joint] * basis[joint]);
            }
            let maps: Vec<_> =
                posed.iter().zip(&rest).map(|(m, rest)| DAffine3::from_mat4(*m * rest.inverse())).collect();
            let skin = table(&case, &input("skin_unnormalised"));
            let got = skinned(&triples(&case, &input("vertices")), &skin, &maps);
            case.check(&format!("out.{group}"), got.into_iter().flatten());
        }
    }
}
