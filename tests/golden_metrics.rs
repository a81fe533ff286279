//! Skin metrics and codebook figures against reference values.

use std::collections::{BTreeMap, BTreeSet};

use riglab_metric::{Codebook, Joints, SkeletonConvention, SkinTally, compression_ratio};
use riglab_tests::{Golden, golden};
use tch::Kind;

#[test]
fn skin_metrics() {
    for (_, case) in golden("metrics", &["skin"]) {
        let ids: BTreeSet<&str> = case.names("").filter_map(|n| n.split_once(".in.").map(|(id, _)| id)).collect();
        let mut tallies = BTreeMap::new();
        for id in ids {
            let dense = |name: &str| Vec::<f32>::try_from(case.get(&format!("{id}.in.{name}")).view([-1])).unwrap();
            let joints = case.get(&format!("{id}.in.skin_gt")).size()[1] as usize;
            let tally = SkinTally::of(&dense("skin_gt"), &dense("skin_pred"), joints);
            if case.tensors.contains_key(&format!("{id}.out.skintokens")) {
                close(&case, &format!("{id}.out.skintokens"), &tally.metrics().columns().map(|(_, v)| v));
                close(&case, &format!("{id}.out.counts"), &tally.counts().map(|c| c as f64));
            }
            tallies.insert(id.to_string(), tally);
        }
        assert!(!tallies.is_empty());
        // The aggregate is over assets of a larger set; it is checked where all of them are there.
        let assets = case.config("aggregate.assets").as_array().cloned().unwrap_or_default();
        let of =
            assets.iter().map(|i| tallies.get(&format!("case{:03}", i.as_u64().unwrap()))).collect::<Option<Vec<_>>>();
        if let Some(of) = of.filter(|of| !of.is_empty()) {
            let mut pooled = SkinTally::default();
            of.into_iter().for_each(|t| pooled.add(t));
            let m = pooled.metrics();
            close(&case, "aggregate.out.pooled", &[m.l1, m.l1_var, m.precision, m.recall, m.iou]);
        }
    }
}

#[test]
fn skeleton_distances() {
    for (_, case) in golden("metrics", &["skeleton"]) {
        let ids: BTreeSet<&str> = case.names("").filter_map(|n| n.split_once(".in.").map(|(id, _)| id)).collect();
        assert!(!ids.is_empty());
        for id in ids {
            let joints = |side: &str| {
                let flat = case.get(&format!("{id}.in.joints_{side}")).to_kind(Kind::Double).view([-1]);
                let flat = Vec::<f64>::try_from(flat).unwrap();
                let parents = Vec::<i64>::try_from(case.get(&format!("{id}.in.parents_{side}"))).unwrap();
                Joints {
                    positions: flat.as_chunks().0.to_vec(),
                    parents: parents.into_iter().map(|p| usize::try_from(p).ok()).collect(),
                }
            };
            let (a, b) = (joints("a"), joints("b"));
            for (name, convention) in [("unirig", SkeletonConvention::Unirig), ("rignet", SkeletonConvention::Rignet)] {
                let d = convention.distances(&a, &b);
                close(&case, &format!("{id}.out.{name}"), &[d.j2j, d.j2b, d.b2b]);
            }
        }
    }
}

#[test]
fn codebook_figures() {
    for (_, case) in golden("metrics", &["misc"]) {
        let mut seen = 0;
        for (id, config) in case.json["config"].as_object().unwrap() {
            let Some(size) = config.get("codebook").and_then(serde_json::Value::as_i64) else { continue };
            let mut codebook = Codebook::default();
            codebook.add(Vec::<i64>::try_from(case.get(&format!("{id}.in.indices"))).unwrap());
            close(&case, &format!("{id}.out"), &[codebook.utilisation(size), codebook.perplexity()]);
            seen += 1;
        }
        assert!(seen > 0);
        let [n, t] = ["compression.vertices", "compression.tokens"].map(|k| case.number(k) as usize);
        let bits = case.config("compression.bits").as_array().unwrap();
        let ratios: Vec<f64> = bits.iter().map(|b| compression_ratio(n, t, 1 << b.as_i64().unwrap())).collect();
        close(&case, "compression.out.ratio_by_bits", &ratios);
    }
}

/// Compares a vector, NaN equal to NaN.
fn close(case: &Golden, name: &str, got: &[f64]) {
    let want = Vec::<f64>::try_from(case.get(name).to_kind(Kind::Double)).unwrap();
    assert_eq!(got.len(), want.len(), "{name}");
    for (k, (g, w)) in got.iter().zip(&want).enumerate() {
        let fits = (g.is_nan() && w.is_nan()) || (g - w).abs() <= 2e-6 + 2e-5 * w.abs();
        assert!(fits, "{} {name} column {k}: {g}, expected {w}", case.name);
    }
}
