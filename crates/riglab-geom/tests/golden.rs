//! Samplers against values recorded from the public code of SkinTokens and UniRig, with the recorded
//! draws.

#[path = "common/golden.rs"]
mod golden;

use golden::{Golden, golden, table};
use riglab_core::{Mesh, SkinWeights};
use riglab_geom::{
    Cloud, CloudConfig, CloudSampler, DenseConfig, DenseSampler, Place, SurfaceSampler, Transfer, farthest_points,
    near_bone,
};
use riglab_random::numpy_choice;

#[test]
fn skintokens() {
    for case in golden("skintokens", "sampler") {
        for group in case.groups() {
            match group.split('_').next().unwrap_or(&group) {
                "face" if group.starts_with("face_mask") => masks(&case, &group),
                "uniform" => uniform(&case, &group),
                "dense" => dense(&case, &group),
                "fps" => farthest(&case, &group),
                "transfer" => transfer(&case, &group),
                _ => panic!("{}: unknown output `{group}`", case.name),
            }
        }
        case.done();
    }
}

/// The mesh of a group and its weights, with the number of joints.
fn skinned(case: &Golden, group: &str) -> (Mesh, SkinWeights, usize) {
    let skin = case.input(group, "skin");
    (case.mesh_of(group), case.weights(&skin), case.shape(&skin)[1])
}

/// Of every joint, for the two limits in the output's name.
fn masks(case: &Golden, group: &str) {
    let (mesh, weights, joints) = skinned(case, group);
    let columns = weights.columns(joints);
    for name in case.outputs(&format!("{group}.")) {
        let limits = name[format!("out.{group}.").len()..].split_once('_').expect("two limits");
        let config = DenseConfig {
            reach: limits.0.parse().expect("a number"),
            reach_share: limits.1.parse().expect("a number"),
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

/// A cloud by the draws of a group, or those of `uniform`.
fn cloud(case: &Golden, mesh: &Mesh, group: &str) -> Cloud {
    let own = case.has(&case.input(group, "face_draws"));
    let draws = ["face_draws", "bary_draws"].map(|what| case.input(if own { group } else { "uniform" }, what));
    let places = drawn(case, mesh, draws.each_ref().map(String::as_str), |_, area| area);
    CloudSampler::new(mesh, &CloudConfig::skintokens()).at(places)
}

fn uniform(case: &Golden, group: &str) {
    let (mesh, weights, joints) = skinned(case, group);
    let cloud = cloud(case, &mesh, group);
    let skin = table(&cloud.weights(&mesh, &weights).unwrap(), joints);
    sampled(case, group, &cloud, &skin);
}

/// Checks whatever is recorded of a cloud.
fn sampled(case: &Golden, group: &str, cloud: &Cloud, skin: &[f64]) {
    for name in case.outputs(&format!("{group}.")) {
        match name.rsplit_once('.').expect("a part").1 {
            "vertices" | "points" => case.check_points(&name, &cloud.positions),
            "normals" => case.check_points(&name, &cloud.normals),
            "skin" => case.check(&name, skin.to_vec()),
            "face" => {
                let faces = cloud.places.iter().map(|p| match p {
                    Place::Surface(s) => f64::from(s.triangle),
                    Place::Vertex(_) => panic!("a vertex"),
                });
                case.check(&name, faces);
            }
            "face_weight" => {
                let mesh = case.mesh_of(group);
                let area = |t| glam::Vec3::from(mesh.area_vector(t)).length_squared();
                case.check(&name, (0..mesh.triangles().len()).map(|t| f64::from(area(t))));
            }
            _ => panic!("{}: unknown output `{name}`", case.name),
        }
    }
}

/// Weights of the uniform cloud, told for the vertices by as many points as the name says.
fn transfer(case: &Golden, group: &str) {
    let (mesh, weights, joints) = skinned(case, group);
    let count = group.split('_').find_map(|word| word.strip_prefix('k')?.parse().ok()).unwrap_or(8);
    let cloud = cloud(case, &mesh, group);
    let known = table(&cloud.weights(&mesh, &weights).unwrap(), joints);
    let shares = Transfer::new(&cloud.positions, count).shares(mesh.positions());
    let told = shares.iter().flat_map(|shares| {
        (0..joints).map(|j| shares.iter().map(|&(k, w)| f64::from(w) * known[k as usize * joints + j]).sum::<f64>())
    });
    case.check(&format!("out.{group}"), told.collect::<Vec<_>>());
}

fn dense(case: &Golden, group: &str) {
    let (mesh, weights, _) = skinned(case, group);
    let input = |what: &str| case.input(group, what);
    let marked: Vec<bool> = case.values(&input("mask")).iter().map(|m| *m > 0.0).collect();
    let order: Vec<u32> = case.indices(&input("permutation")).iter().map(|k| *k as u32).collect();
    let vertices = (case.number_of(group, "num_vertex_samples") as usize).min(order.len());
    let config = DenseConfig { vertices, ..DenseConfig::default() };
    let whole = CloudSampler::new(&mesh, &CloudConfig::skintokens());
    let sampler = DenseSampler::new(&whole, &marked, &config);
    let mut places = sampler.vertices(&order[..vertices]);
    let within = |t: usize, area: f64| if marked[t] { area } else { 0.0 };
    places.extend(drawn(case, &mesh, [&input("face_draws"), &input("bary_draws")], within));
    assert_eq!(places.len(), case.number_of(group, "num_skin_samples") as usize);
    let cloud = whole.at(places);
    // The joint is named beside the group, not in it.
    let bone = case.setting(group, "joint").and_then(|j| j.as_u64());
    let bone = bone.unwrap_or_else(|| case.number("dense_joint") as u64) as usize;
    sampled(case, group, &cloud, &column(&cloud.weights(&mesh, &weights).unwrap(), bone));
}

fn column(weights: &SkinWeights, joint: usize) -> Vec<f64> {
    let of = |p| weights.row(p).find(|(j, _)| j.index() == joint).map_or(0.0, |(_, w)| f64::from(w));
    (0..weights.rows()).map(of).collect()
}

fn farthest(case: &Golden, group: &str) {
    let name = case.input(group, "points");
    let (points, shape) = (case.points(&name), case.shape(&name));
    let count = shape[shape.len() - 2];
    for name in case.outputs(&format!("{group}.")) {
        let part = |ratio: f64| (count as f64 * ratio).round_ties_even() as usize;
        let picks = match &name[format!("out.{group}.").len()..] {
            "half" => part(0.5),
            "quarter" => part(0.25),
            "third" => part(1.0 / 3.0),
            "all" => count,
            // A share in figures; or a name that tells none, whose count is that of the picks.
            other => other.parse().map_or(*case.shape(&name).last().expect("picks"), part),
        };
        let all = points.chunks(count).flat_map(|cloud| farthest_points(cloud, picks, 0));
        case.check(&name, all.map(|k| k as f64));
    }
}

#[test]
fn unirig() {
    for case in golden("unirig", "transforms") {
        for group in case.groups().into_iter().filter(|group| group.starts_with("sample")) {
            let (mesh, weights, joints) = skinned(&case, &group);
            let squares = |_, area: f64| area * area;
            let places = drawn(&case, &mesh, [&case.input(&group, "u"), &case.input(&group, "uv")], squares);
            let cloud = CloudSampler::new(&mesh, &CloudConfig::unirig_ar()).at(places);
            sampled(&case, &group, &cloud, &table(&cloud.weights(&mesh, &weights).unwrap(), joints));
        }
    }
}

/// How many of how many, and the seed where it is not 0, are in the output's name.
#[test]
fn rows_of_the_shape_encoder() {
    for case in golden("unirig", "rng_choice") {
        for name in case.outputs("") {
            let (mut seed, mut of) = (0, [None; 2]);
            for word in name["out.".len()..].split('_') {
                let at = word.find(|c: char| c.is_ascii_digit()).expect("a number");
                let number = word[at..].parse().expect("a number");
                match &word[..at] {
                    "n" => of[0] = Some(number),
                    "k" => of[1] = Some(number),
                    "s" | "seed" => seed = number,
                    _ => panic!("{}: unknown output `{name}`", case.name),
                }
            }
            let [n, count] = of.map(|number| number.expect("two numbers"));
            let rows = numpy_choice(seed, n as u32, count as usize);
            case.check(&name, rows.into_iter().map(f64::from));
        }
        case.done();
    }
}
