//! Rewards against the hand-checked cases and the recorded random one.

#[path = "../../riglab-geom/tests/common/golden.rs"]
mod golden;

use glam::{DAffine3, DMat4};
use golden::{Golden, golden};
use riglab_geom::voxel::{Lattice, Voxels};
use riglab_reward::{Faults, RawWeights, containment, coverage, maps, motion, skinned, skinning, stretches};

#[test]
fn rewards() {
    for case in golden("grpo/rewards", "rewards") {
        row(&case);
        weights(&case);
        moving(&case);
        blob(&case);
        case.done();
    }
}

fn triples(case: &Golden, name: &str) -> Vec<[f64; 3]> {
    case.values(name).as_chunks::<3>().0.to_vec()
}

fn parents(case: &Golden, name: &str) -> Vec<Option<usize>> {
    case.values(name).iter().map(|p| (*p >= 0.0).then_some(*p as usize)).collect()
}

fn table(case: &Golden, name: &str) -> RawWeights {
    let joints = case.shape(name)[1];
    let row = |row: &[f64]| row.iter().enumerate().map(|(j, w)| (j as u16, *w)).collect::<Vec<_>>();
    RawWeights::new(case.values(name).chunks_exact(joints).map(row))
}

fn voxels(case: &Golden, of: &str) -> Voxels {
    let cells: Vec<[usize; 3]> = case.indices(&format!("in.{of}.occupied")).as_chunks::<3>().0.to_vec();
    let size = std::array::from_fn(|k| cells.iter().map(|c| c[k] + 1).max().unwrap());
    let origin = triples(case, &format!("in.{of}.origin"))[0];
    Voxels::new(Lattice { origin, cell: case.values(&format!("in.{of}.size"))[0], size }, cells)
}

/// The numbers in a name such as `sc_0.5_1`.
fn numbers(name: &str) -> Vec<f64> {
    name.split('_').skip(1).map(|x| x.trim_start_matches('s').parse().unwrap()).collect()
}

fn containments(case: &Golden, of: &str, voxels: &Voxels, heads: &[[f64; 3]], parents: &[Option<usize>]) {
    for name in case.outputs(&format!("{of}.vk_")) {
        let steps = name.rsplit_once("_s").unwrap().1.parse().unwrap();
        case.check(&name, [containment(voxels, heads, parents, steps, !name.contains("noroot"))]);
    }
}

fn row(case: &Golden) {
    let (voxels, heads, parents) =
        (voxels(case, "row"), triples(case, "in.row.joints"), parents(case, "in.row.parents"));
    let alpha = case.number("alpha");
    case.check("out.row.vj_voxel", [coverage(&voxels, &heads, alpha)]);
    case.check("out.row.vj_first_joint_only", [coverage(&voxels, &heads[..1], alpha)]);
    case.check("out.row.vj_world", [coverage(&voxels, &heads, alpha * voxels.lattice().cell)]);
    containments(case, "row", &voxels, &heads, &parents);
    let points = heads.iter().zip(&parents).flat_map(|(head, parent)| {
        let from = parent.map_or(*head, |p| heads[p]);
        (0..5).map(move |i| std::array::from_fn(|k| from[k] + 0.25 * f64::from(i) * (head[k] - from[k])))
    });
    case.check("out.row.inside_s4", points.map(|p| f64::from(u8::from(voxels.contains(p)))));
}

fn weights(case: &Golden) {
    let weights = table(case, "in.weights.w");
    let faults = Faults::of(&weights, case.number("beta"));
    for name in case.outputs("weights.") {
        let exponents: [f64; 2] = numbers(&name).try_into().unwrap();
        let got = match name.as_bytes()["out.weights.".len()] {
            b'z' => faults.unbound.powf(exponents[0]),
            b'm' => faults.crowded.powf(exponents[1]),
            _ => skinning(&weights, case.number("beta"), exponents),
        };
        case.check(&name, [got]);
    }
}

/// Maps from rest to each pose, of 4 × 4 matrices by rows.
fn poses(case: &Golden, poses: &[f64], rest: &str) -> Vec<Vec<DAffine3>> {
    let matrices = |all: &[f64]| -> Vec<DMat4> {
        all.as_chunks::<16>().0.iter().map(|m| DMat4::from_cols_array(m).transpose()).collect()
    };
    let rest = matrices(case.values(rest));
    let map = |(pose, rest): (&DMat4, &DMat4)| DAffine3::from_mat4(*pose * rest.inverse());
    matrices(poses).chunks_exact(rest.len()).map(|pose| pose.iter().zip(&rest).map(map).collect()).collect()
}

fn edges(case: &Golden, name: &str) -> Vec<[u32; 2]> {
    case.indices(name).as_chunks::<2>().0.iter().map(|e| e.map(|v| v as u32)).collect()
}

fn moving(case: &Golden) {
    let poses = poses(case, case.values("in.motion.poses"), "in.motion.rest");
    let (positions, all) = (triples(case, "in.motion.vertices"), edges(case, "in.motion.edges"));
    let good = table(case, "in.motion.weights");
    case.check("out.motion.posed", poses.iter().flat_map(|p| skinned(&positions, &good, p)).flatten());
    case.check("out.motion.max_per_pose", stretches(&positions, &all, &good, &poses));
    for name in case.outputs("motion.mo_s") {
        let scale = name.rsplit_once("_s").unwrap().1.parse().unwrap();
        case.check(&name, [motion(&positions, &all, &good, &poses, scale)]);
    }
    let still = [vec![DAffine3::IDENTITY; 2]];
    case.check("out.motion.identity_s1", [motion(&positions, &all, &good, &still, 1.0)]);
    for kind in ["bad", "unbound", "zero_edge"] {
        let (mut positions, mut all) = (positions.clone(), all.clone());
        if kind == "zero_edge" {
            (positions, all) =
                (triples(case, "in.motion.vertices_zero_edge"), edges(case, "in.motion.edges_zero_edge"));
        }
        let weights = table(case, &format!("in.motion.weights_{kind}"));
        case.check(&format!("out.motion.{kind}_max"), stretches(&positions, &all, &weights, &poses));
        case.check(&format!("out.motion.{kind}_mo_s1"), [motion(&positions, &all, &weights, &poses, 1.0)]);
    }
}

fn blob(case: &Golden) {
    let voxels = voxels(case, "blob");
    let (heads, parents) = (triples(case, "in.blob.joints"), parents(case, "in.blob.parents"));
    let turns = triples(case, "in.blob.rotvec");
    let ours: Vec<Vec<DAffine3>> = turns.chunks_exact(heads.len()).map(|t| maps(&heads, &parents, t)).collect();
    let rest: Vec<DMat4> =
        case.values("in.blob.rest").as_chunks::<16>().0.iter().map(|m| DMat4::from_cols_array(m).transpose()).collect();
    let matrices = ours.iter().flat_map(|pose| pose.iter().zip(&rest).map(|(map, rest)| DMat4::from(*map) * *rest));
    case.check("out.blob.poses", matrices.flat_map(|m| m.transpose().to_cols_array()));
    let (alpha, positions) = (case.number("alpha"), triples(case, "in.blob.vertices"));
    let (all, skin) = (edges(case, "in.blob.edges"), table(case, "in.blob.skin"));
    case.check("out.blob.vj_voxel", [coverage(&voxels, &heads, alpha)]);
    case.check("out.blob.vj_world", [coverage(&voxels, &heads, alpha * voxels.lattice().cell)]);
    containments(case, "blob", &voxels, &heads, &parents);
    let sc = skinning(&table(case, "in.blob.weights"), case.number("beta"), [1.0, 1.0]);
    case.check("out.blob.sc", [sc]);
    case.check("out.blob.max_per_pose", stretches(&positions, &all, &skin, &ours));
    let mo = motion(&positions, &all, &skin, &ours, 1.0);
    case.check("out.blob.mo_s1", [mo]);
    let total = 5.0 * coverage(&voxels, &heads, alpha) + containment(&voxels, &heads, &parents, 20, true) + sc + mo;
    case.check("out.blob.total", [total]);
}
