//! Metrics under every convention, baselines' figures and codebooks against reference values: all cases of all
//! files, and every output of a case, whichever it has.

use glam::DMat3;
use riglab_metric::{
    Codebook, Joints, Rows, SkeletonConvention, SkinConvention, SkinTally, Skins, compression_ratio,
    local_shape_diameters, match_joints, motion, nearest_shares, posed, tree_edit_distance,
};
use riglab_tests::{Golden, golden};
use tch::Kind;

#[test]
fn skeletons() {
    for (_, case) in golden("metrics", &["skeleton"]) {
        for id in case.ids() {
            let (a, b) = (joints(&case, &format!("{id}.in"), "_a"), joints(&case, &format!("{id}.in"), "_b"));
            for output in outputs(&case, &id) {
                let got = skeleton(&case, &id, &output, &a, &b);
                case.check_numbers(&format!("{id}.out.{output}"), &got);
            }
        }
        case.done();
    }
}

fn skeleton(case: &Golden, id: &str, output: &str, a: &Joints, b: &Joints) -> Vec<f64> {
    let distances = |c: SkeletonConvention| {
        let d = c.distances(a, b);
        vec![d.j2j, d.j2b, d.b2b]
    };
    let matched = |tolerances: &[f64]| {
        let m = match_joints(&a.positions, &b.positions, tolerances);
        vec![m.dice(), m.precision(), m.recall(), m.iou()]
    };
    match output {
        // What the peer's code prints in f32.
        "unirig_torch_f32" => distances(SkeletonConvention::Unirig),
        "exact_j2b" => distances(SkeletonConvention::Exact)[1..2].to_vec(),
        "magicarticulate_counts" => SkeletonConvention::Magicarticulate.joint_counts(a, b).map(|n| n as f64).to_vec(),
        "anymate_nearest" => {
            let j2j = SkeletonConvention::Anymate.distances(a, b).j2j;
            [vec![j2j], nearest_shares(&a.positions, &b.positions, 0.1).to_vec()].concat()
        }
        "match_010" => matched(&[0.1]),
        "match_tol" => matched(&numbers(case, &format!("{id}.in.tol_b"))),
        "ted" => vec![tree_edit_distance(&a.parents, &b.parents).map_or(f64::NAN, |edits| edits as f64)],
        name => {
            let convention = SkeletonConvention::ALL.into_iter().find(|c| c.name() == name);
            distances(convention.unwrap_or_else(|| panic!("{id}: nothing computes `{name}`")))
        }
    }
}

#[test]
fn skins() {
    for (_, case) in golden("metrics", &["skin"]) {
        for id in case.ids().into_iter().filter(|id| *id != "aggregate") {
            let [truth, predicted] = ["gt", "pred"].map(|side| rows(&case, &format!("{id}.in.skin_{side}")));
            let name = format!("{id}.in.edges");
            let edges: Vec<[u32; 2]> = match case.tensors.get(&name) {
                Some(edges) => pairs(&Vec::<i64>::try_from(edges.to_kind(Kind::Int64).view([-1])).unwrap()),
                None => Vec::new(),
            };
            let skins = Skins { truth: &truth, predicted: &predicted, edges: &edges };
            for output in outputs(&case, &id) {
                let convention = match output.as_str() {
                    "counts" => None,
                    "puppeteer_015" => Some(SkinConvention::Puppeteer),
                    "puppeteer_035" => Some(SkinConvention::PuppeteerModelsresource),
                    "puppeteer_015_filtered" => Some(SkinConvention::PuppeteerOneRing),
                    name => {
                        let found = SkinConvention::ALL.into_iter().find(|c| c.name() == name);
                        Some(found.unwrap_or_else(|| panic!("{id}: nothing computes `{name}`")))
                    }
                };
                let got = match convention {
                    Some(convention) => convention.figures(&skins).iter().map(|(_, v)| *v).collect(),
                    None => SkinTally::of_rows(&truth, &predicted).counts().map(|c| c as f64).to_vec(),
                };
                case.check_numbers(&format!("{id}.out.{output}"), &got);
            }
        }
        aggregate(&case);
        case.done();
    }
}

/// Means over some assets, and sums; checked where all of them are there.
fn aggregate(case: &Golden) {
    let assets = case.config("aggregate.assets").as_array().cloned().unwrap_or_default();
    let ids: Vec<String> = assets.iter().map(|i| format!("case{:03}", i.as_u64().unwrap())).collect();
    let there = |id: &String| case.tensors.contains_key(&format!("{id}.in.skin_gt"));
    if ids.is_empty() || !ids.iter().all(there) {
        case.aside("aggregate.out.", "its assets are not among the cases");
        return;
    }
    let tally = |id: &String| {
        let [truth, predicted] = ["gt", "pred"].map(|side| rows(case, &format!("{id}.in.skin_{side}")));
        SkinTally::of_rows(&truth, &predicted)
    };
    let tallies: Vec<SkinTally> = ids.iter().map(tally).collect();
    let mut pooled = SkinTally::default();
    tallies.iter().for_each(|t| pooled.add(t));
    let m = pooled.metrics();
    case.check_numbers("aggregate.out.pooled", &[m.l1, m.l1_var, m.precision, m.recall, m.iou]);
    let columns: Vec<[f64; 8]> = tallies.iter().map(|t| t.metrics().columns().map(|(_, v)| v)).collect();
    let mean = |k: usize| {
        let defined: Vec<f64> = columns.iter().map(|c| c[k]).filter(|v| !v.is_nan()).collect();
        defined.iter().sum::<f64>() / defined.len() as f64
    };
    case.check_numbers("aggregate.out.macro", &std::array::from_fn::<f64, 8, _>(mean));
}

#[test]
fn motions() {
    for (_, case) in golden("metrics", &["motion"]) {
        for id in case.ids() {
            let joints = joints(&case, &format!("{id}.in"), "");
            let vertices = points(&case, &format!("{id}.in.vertices"));
            let turns = numbers(&case, &format!("{id}.in.rotations"));
            // Matrices are stored by rows.
            let turns: Vec<DMat3> =
                turns.as_chunks::<9>().0.iter().map(|m| DMat3::from_cols_array(m).transpose()).collect();
            let poses: Vec<Vec<DMat3>> = turns.chunks(joints.positions.len()).map(<[DMat3]>::to_vec).collect();
            let [truth, predicted] = ["gt", "pred"].map(|side| rows(&case, &format!("{id}.in.skin_{side}")));
            for output in outputs(&case, &id) {
                let all = |weights: &Rows| -> Vec<f64> {
                    poses.iter().flat_map(|p| posed(&vertices, &joints, p, weights)).flatten().collect()
                };
                let got = match output.as_str() {
                    "posed_gt" => all(&truth),
                    "posed_pred" => all(&predicted),
                    "motion" => {
                        let m = motion(&vertices, &joints, &poses, &truth, &predicted);
                        vec![m.mean, m.max, m.mean_max, m.mse, m.rms]
                    }
                    name => panic!("{id}: nothing computes `{name}`"),
                };
                case.check_numbers(&format!("{id}.out.{output}"), &got);
            }
        }
        case.done();
    }
}

#[test]
fn codebooks_and_diameters() {
    for (_, case) in golden("metrics", &["misc"]) {
        for id in case.ids() {
            let has = |input: &str| case.tensors.contains_key(&format!("{id}.in.{input}"));
            if has("indices") {
                let size = case.number(&format!("{id}.codebook")) as i64;
                let mut codebook = Codebook::default();
                codebook.add(Vec::<i64>::try_from(case.get(&format!("{id}.in.indices"))).unwrap());
                case.check_numbers(&format!("{id}.out"), &[codebook.utilisation(size), codebook.perplexity()]);
            } else if has("faces") {
                let faces = Vec::<i64>::try_from(case.get(&format!("{id}.in.faces")).view([-1])).unwrap();
                let faces: Vec<[u32; 3]> =
                    faces.as_chunks::<3>().0.iter().map(|f| f.map(|v| u32::try_from(v).unwrap())).collect();
                let joints = joints(&case, &format!("{id}.in"), "");
                let found = local_shape_diameters(&points(&case, &format!("{id}.in.vertices")), &faces, &joints);
                case.check_numbers(&format!("{id}.out.lsd"), &found);
            } else {
                let [n, t] = ["vertices", "tokens"].map(|k| case.number(&format!("{id}.{k}")) as usize);
                let bits = case.config(&format!("{id}.bits")).as_array().unwrap();
                let ratio = |b: &serde_json::Value| compression_ratio(n, t, 1 << b.as_i64().unwrap());
                case.check_numbers(&format!("{id}.out.ratio_by_bits"), &bits.iter().map(ratio).collect::<Vec<_>>());
            }
        }
        case.done();
    }
}

/// The outputs of a case.
fn outputs(case: &Golden, id: &str) -> Vec<String> {
    let prefix = format!("{id}.out.");
    case.names(&prefix).map(String::from).collect()
}

fn numbers(case: &Golden, name: &str) -> Vec<f64> {
    Vec::<f64>::try_from(case.get(name).to_kind(Kind::Double).view([-1])).unwrap()
}

fn points(case: &Golden, name: &str) -> Vec<[f64; 3]> {
    numbers(case, name).as_chunks().0.to_vec()
}

fn rows(case: &Golden, name: &str) -> Rows {
    let table = case.get(name);
    let columns = table.size()[1] as usize;
    Rows::dense(&Vec::<f32>::try_from(table.to_kind(Kind::Float).view([-1])).unwrap(), columns)
}

fn pairs(flat: &[i64]) -> Vec<[u32; 2]> {
    flat.as_chunks::<2>().0.iter().map(|p| p.map(|v| u32::try_from(v).unwrap())).collect()
}

fn joints(case: &Golden, inputs: &str, side: &str) -> Joints {
    let parents = Vec::<i64>::try_from(case.get(&format!("{inputs}.parents{side}"))).unwrap();
    Joints {
        positions: points(case, &format!("{inputs}.joints{side}")),
        parents: parents.into_iter().map(|p| usize::try_from(p).ok()).collect(),
    }
}
