//! Samplers against values recorded from the public code of SkinTokens and UniRig, with the recorded
//! draws.

#[path = "common/golden.rs"]
mod golden;

use golden::{Golden, golden, table};
use riglab_core::{Mesh, SkinWeights};
use riglab_geom::{
    CloudConfig, CloudSampler, DenseConfig, DenseSampler, Place, SurfaceSampler, Transfer, farthest_points, near_bone,
};
use riglab_random::numpy_choice;

#[test]
fn skintokens() {
    for case in golden("skintokens", "sampler") {
        for group in case.groups() {
            match group.as_str() {
                "face_mask" => masks(&case),
                "uniform" => uniform(&case),
                "dense" => dense(&case),
                "fps" => farthest(&case),
                "transfer_k8" => transfer(&case),
                other => panic!("{}: unknown output `{other}`", case.name),
            }
        }
        case.done();
    }
}

/// Of every joint, for the two limits in the output's name.
fn masks(case: &Golden) {
    let (mesh, weights) = (case.mesh(), case.weights("in.skin"));
    let columns = weights.columns(case.shape("in.skin")[1]);
    for name in case.outputs("face_mask.") {
        let (reach, share) = name.rsplit_once('_').expect("two limits");
        let reach = reach.rsplit_once("mask.").expect("a limit").1;
        let config = DenseConfig {
            reach: reach.parse().expect("a number"),
            reach_share: share.parse().expect("a number"),
            ..DenseConfig::default()
        };
        let marked = columns.iter().flat_map(|column| near_bone(&mesh, column, &config));
        case.check(&name, marked.map(|m| f64::from(u8::from(m))));
    }
}

/// Places by the recorded draws, of triangles by their weight.
fn drawn(case: &Golden, mesh: &Mesh, draws: [&str; 2], weight: impl Fn(usize, f64) -> f64) -> Vec<Place> {
    let area = |t| f64::from(glam::Vec3::from(mesh.area_vector(t)).length());
    let mut sum = 0.0;
    let sums = (0..mesh.triangles().len()).map(|t| {
        sum += weight(t, area(t));
        sum
    });
    let sums: Vec<f64> = sums.collect();
    let sampler = SurfaceSampler::with_sums(mesh, &sums);
    let on_it = case.floats(draws[1]);
    let both = case.values(draws[0]).iter().zip(on_it.as_chunks::<2>().0);
    both.map(|(share, on_it)| Place::Surface(sampler.at(*share, *on_it))).collect()
}

fn uniform(case: &Golden) {
    let (mesh, weights) = (case.mesh(), case.weights("in.skin"));
    let sampler = CloudSampler::new(&mesh, &CloudConfig::skintokens());
    let places = drawn(case, &mesh, ["in.uniform.face_draws", "in.uniform.bary_draws"], |_, area| area);
    let cloud = sampler.at(places);
    case.check_points("out.uniform.vertices", &cloud.positions);
    case.check_points("out.uniform.normals", &cloud.normals);
    let found = cloud.weights(&mesh, &weights).unwrap();
    case.check("out.uniform.skin", table(&found, case.shape("in.skin")[1]));
}

/// Weights of the uniform cloud, told for the vertices.
fn transfer(case: &Golden) {
    let (mesh, weights) = (case.mesh(), case.weights("in.skin"));
    let sampler = CloudSampler::new(&mesh, &CloudConfig::skintokens());
    let places = drawn(case, &mesh, ["in.uniform.face_draws", "in.uniform.bary_draws"], |_, area| area);
    let cloud = sampler.at(places);
    let joints = case.shape("in.skin")[1];
    let known = table(&cloud.weights(&mesh, &weights).unwrap(), joints);
    let shares = Transfer::new(&cloud.positions, 8).shares(mesh.positions());
    let told = shares.iter().flat_map(|shares| {
        (0..joints).map(|j| shares.iter().map(|&(k, w)| f64::from(w) * known[k as usize * joints + j]).sum::<f64>())
    });
    case.check("out.transfer_k8", told.collect::<Vec<_>>());
}

fn dense(case: &Golden) {
    let (mesh, weights) = (case.mesh(), case.weights("in.skin"));
    let marked: Vec<bool> = case.values("in.dense.mask").iter().map(|m| *m > 0.0).collect();
    let order: Vec<u32> = case.indices("in.dense.permutation").iter().map(|k| *k as u32).collect();
    let vertices = (case.number("num_vertex_samples") as usize).min(order.len());
    let config = DenseConfig { vertices, ..DenseConfig::default() };
    let whole = CloudSampler::new(&mesh, &CloudConfig::skintokens());
    let sampler = DenseSampler::new(&whole, &marked, &config);
    let mut places = sampler.vertices(&order[..vertices]);
    let within = |t: usize, area: f64| if marked[t] { area } else { 0.0 };
    places.extend(drawn(case, &mesh, ["in.dense.face_draws", "in.dense.bary_draws"], within));
    assert_eq!(places.len(), case.number("num_skin_samples") as usize);
    let cloud = whole.at(places);
    case.check_points("out.dense.vertices", &cloud.positions);
    case.check_points("out.dense.normals", &cloud.normals);
    let bone = case.number("dense_joint") as usize;
    case.check("out.dense.skin", column(&cloud.weights(&mesh, &weights).unwrap(), bone));
}

fn column(weights: &SkinWeights, joint: usize) -> Vec<f64> {
    let of = |p| weights.row(p).find(|(j, _)| j.index() == joint).map_or(0.0, |(_, w)| f64::from(w));
    (0..weights.rows()).map(of).collect()
}

fn farthest(case: &Golden) {
    let (points, count) = (case.points("in.fps.points"), case.shape("in.fps.points")[1]);
    for name in case.outputs("fps.") {
        let part = |ratio: f64| (count as f64 * ratio).round_ties_even() as usize;
        let picks = match name.strip_prefix("out.fps.").expect("a prefix") {
            "half" => part(0.5),
            "quarter" => part(0.25),
            // A share in figures; or a name that tells none, whose count is that of the picks.
            other => other.parse().map_or(case.shape(&name)[1], part),
        };
        let all = points.chunks(count).flat_map(|cloud| farthest_points(cloud, picks, 0));
        case.check(&name, all.map(|k| k as f64));
    }
}

#[test]
fn unirig() {
    for case in golden("unirig", "transforms") {
        let (mesh, weights) = (case.mesh(), case.weights("in.skin"));
        let sampler = CloudSampler::new(&mesh, &CloudConfig::unirig_ar());
        let squares = |_, area: f64| area * area;
        let cloud = sampler.at(drawn(&case, &mesh, ["in.sample.u", "in.sample.uv"], squares));
        let faces = cloud.places.iter().map(|p| match p {
            Place::Surface(s) => f64::from(s.triangle),
            Place::Vertex(_) => panic!("a vertex"),
        });
        case.check("out.sample.face", faces);
        case.check_points("out.sample.points", &cloud.positions);
        case.check_points("out.sample.normals", &cloud.normals);
        case.check("out.sample.skin", table(&cloud.weights(&mesh, &weights).unwrap(), case.shape("in.skin")[1]));
        let area = |t| glam::Vec3::from(mesh.area_vector(t)).length_squared();
        case.check("out.sample.face_weight", (0..mesh.triangles().len()).map(|t| f64::from(area(t))));
    }
}

#[test]
fn rows_of_the_shape_encoder() {
    for case in golden("unirig", "rng_choice") {
        for name in case.outputs("") {
            let (n, count) = name.strip_prefix("out.n").and_then(|s| s.split_once("_k")).expect("two numbers");
            let rows = numpy_choice(0, n.parse().expect("a number"), count.parse().expect("a number"));
            case.check(&name, rows.into_iter().map(f64::from));
        }
        case.done();
    }
}
