//! The released tokenizers' own results: UniRig's and SkinTokens'.

use std::path::PathBuf;

use riglab_token::{
    Bones, DecodeFault, Mask, Preset, Quantiser, Rule, Siblings, Spring, Tokenizer, TokenizerConfig, Walk,
    extraction_order,
};
use safetensors::SafeTensors;
use serde_json::Value;

fn golden(file: &str) -> Option<Vec<u8>> {
    let default = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/golden");
    let folder = std::env::var_os("RIGLAB_GOLDEN").map_or(default, PathBuf::from);
    if !folder.is_dir() {
        println!("skipped: no such folder: {} (set RIGLAB_GOLDEN)", folder.display());
        return None;
    }
    Some(std::fs::read(folder.join(file)).unwrap_or_else(|e| panic!("{file}: {e}")))
}

fn json(file: &str) -> Option<Value> {
    golden(file).map(|bytes| serde_json::from_slice(&bytes).unwrap())
}

fn strings(v: &Value) -> Vec<String> {
    v.as_array().unwrap().iter().map(|s| s.as_str().unwrap().to_owned()).collect()
}

fn ids(v: &Value) -> Vec<u32> {
    v.as_array().unwrap().iter().map(|x| x.as_u64().unwrap() as u32).collect()
}

fn parents(v: &Value) -> Vec<Option<usize>> {
    v.as_array().unwrap().iter().map(|p| p.as_u64().map(|p| p as usize)).collect()
}

fn points(v: &Value) -> Vec<[f64; 3]> {
    let point = |p: &Value| std::array::from_fn(|k| p[k].as_f64().unwrap());
    v.as_array().unwrap().iter().map(point).collect()
}

/// The released tokenizer with a table of classes.
fn unirig(table: &Value) -> Tokenizer {
    let mut classes: Vec<(u64, String)> =
        table["cls"].as_object().unwrap().iter().map(|(name, id)| (id.as_u64().unwrap(), name.clone())).collect();
    classes.sort();
    let tokenizer = Tokenizer::new(TokenizerConfig {
        bins: table["num_discrete"].as_u64().unwrap() as u16,
        classes: classes.into_iter().map(|(_, name)| name).collect(),
        ..Preset::UnirigReleased.config()
    });
    let ids = tokenizer.vocabulary();
    for (name, id) in [
        ("branch", ids.branch()),
        ("bos", ids.bos()),
        ("eos", ids.eos()),
        ("pad", ids.pad()),
        ("spring", ids.spring()),
        ("cls_none", ids.no_class()),
        ("vocab", ids.len() as u32),
    ] {
        assert_eq!(table[name].as_u64(), Some(u64::from(id)), "{name}");
    }
    for (name, id) in table["cls"].as_object().unwrap() {
        assert_eq!(ids.class_named(name).map(|c| ids.class(c)), Some(id.as_u64().unwrap() as u32), "{name}");
    }
    tokenizer
}

fn near(found: &[[f32; 3]], wanted: &Value, what: &str) {
    let wanted = points(wanted);
    assert_eq!(found.len(), wanted.len(), "{what}");
    for (a, b) in found.iter().zip(&wanted) {
        for k in 0..3 {
            assert!((f64::from(a[k]) - b[k]).abs() <= 1e-6, "{what}: {a:?} {b:?}");
        }
    }
}

fn compare(tokenizer: &Tokenizer, ids: &[u32], wanted: &Value, what: &str) {
    let found = tokenizer.decode(ids);
    if wanted["error"].is_string() {
        assert!(found.is_err(), "{what}: {found:?}");
        return;
    }
    let found = found.unwrap_or_else(|e| panic!("{what}: {e}"));
    near(&found.joints, &wanted["joints"], what);
    assert_eq!(found.parents, parents(&wanted["parents"]), "{what}");
    near(&found.tails(), &wanted["tails"], &format!("{what}: tails"));
    assert_eq!(found.names, strings(&wanted["names"]), "{what}");
    assert_eq!(found.class.as_deref(), wanted["cls"].as_str(), "{what}");
    let parts: Vec<Option<String>> =
        wanted["parts"].as_array().unwrap().iter().map(|p| p.as_str().map(str::to_owned)).collect();
    assert_eq!(found.parts, parts, "{what}");
}

#[test]
fn unirig_tokenizes_and_reads_as_released() {
    let Some(cases) = json("unirig/tokenizer_cases.json") else { return };
    for case in cases["cases"].as_array().unwrap() {
        let what = case["id"].as_str().unwrap();
        let tokenizer = unirig(&cases["tables"][case["tokenizer"].as_str().unwrap()]);
        let (joints, parents, names) = (points(&case["joints"]), parents(&case["parents"]), strings(&case["names"]));
        let bones = Bones { joints: &joints, parents: &parents, names: &names };
        let wanted = &case["expected"];
        // Without its order step the released tokenizer cannot work at all.
        if case["use_order"] == false {
            assert_eq!(wanted["error"], "TypeError", "{what}");
            continue;
        }
        let found = tokenizer.encode_bones(&bones, case["cls"].as_str());
        if wanted["error"].is_string() {
            assert!(found.is_err(), "{what}");
            continue;
        }
        let found = found.unwrap_or_else(|e| panic!("{what}: {e}"));
        let order: Vec<usize> = ids(&wanted["order"]).into_iter().map(|j| j as usize).collect();
        assert_eq!(found.order, order, "{what}");
        assert_eq!(found.ids, ids(&wanted["ids"]), "{what}");
        compare(&tokenizer, &found.ids, &wanted["detokenize"], what);
        let (first, count) = walk(&tokenizer, &found.ids);
        assert_eq!(first.map(|at| at as u64), wanted["grammar_violation_at"].as_u64(), "{what}");
        assert_eq!(Some(count as u64), wanted["bones_in_sequence"].as_u64(), "{what}");
    }
}

#[test]
fn bones_are_taken_in_the_order_of_the_release() {
    let Some(cases) = json("unirig/bone_order.json") else { return };
    for case in cases["cases"].as_array().unwrap() {
        let what = case["id"].as_str().unwrap();
        let bones = case["bones"].as_array().unwrap();
        let names: Vec<&str> = bones.iter().map(|b| b[0].as_str().unwrap()).collect();
        let place = |name: &Value| names.iter().position(|n| Some(*n) == name.as_str());
        let parents: Vec<Option<usize>> = bones.iter().map(|b| place(&b[1])).collect();
        let first = place(&case["first_listed"]).unwrap();
        let order = extraction_order(&parents, first).unwrap();
        assert_eq!(order.iter().map(|&b| names[b].to_owned()).collect::<Vec<_>>(), strings(&case["order"]), "{what}");
    }
    assert_eq!(extraction_order(&[Some(1), Some(0)], 0), None);
    assert_eq!(extraction_order(&[None, Some(7)], 0), None);
    assert_eq!(extraction_order(&[], 0), None);
}

/// The first id that may not follow, and the points.
fn walk(tokenizer: &Tokenizer, ids: &[u32]) -> (Option<usize>, usize) {
    let mut walk = Walk::new(tokenizer.vocabulary());
    let mut mask = Mask::none(tokenizer.vocabulary().len());
    let mut first = None;
    for (at, &id) in ids.iter().enumerate() {
        walk.allowed(&mut mask);
        if first.is_none() && !mask.allows(id) {
            first = Some(at);
        }
        if walk.advance(id).is_err() {
            break;
        }
    }
    (first, walk.points())
}

#[test]
fn unirigs_grammar_is_as_released() {
    let (Some(cases), Some(tables)) = (json("unirig/grammar_cases.json"), json("unirig/tokenizer_cases.json")) else {
        return;
    };
    let sets = cases["sets"].as_array().unwrap();
    for case in cases["sequences"].as_array().unwrap() {
        let what = case["id"].as_str().unwrap();
        let tokenizer = unirig(&tables["tables"][case["tokenizer"].as_str().unwrap()]);
        let sequence = ids(&case["ids"]);
        let mut walk = Walk::new(tokenizer.vocabulary());
        let mut mask = Mask::none(tokenizer.vocabulary().len());
        let mut sound = true;
        for (at, wanted) in case["allowed_after_prefix"].as_array().unwrap().iter().enumerate() {
            let wanted = &sets[wanted.as_u64().unwrap() as usize];
            if wanted.is_string() {
                assert!(!sound, "{what} at {at}");
            } else {
                walk.allowed(&mut mask);
                let ranges = wanted.as_array().unwrap();
                let wanted: Vec<u32> = ranges.iter().map(ids).flat_map(|r| r[0]..=r[1]).collect();
                assert_eq!(mask.iter().collect::<Vec<_>>(), wanted, "{what} at {at}");
            }
            if let Some(&id) = sequence.get(at) {
                sound &= walk.advance(id).is_ok();
            }
        }
        if let Some(bones) = case["bones_in_sequence"].as_u64() {
            assert_eq!(walk.points() as u64, bones, "{what}");
        }
        if !case["detokenize"].is_string() {
            compare(&tokenizer, &sequence, &case["detokenize"], what);
        }
    }
    for case in cases["detokenize_only"].as_array().unwrap() {
        let tokenizer = unirig(&tables["tables"][case["tokenizer"].as_str().unwrap()]);
        compare(&tokenizer, &ids(&case["ids"]), &case["detokenize"], case["id"].as_str().unwrap());
    }
}

fn numbers<const B: usize, T>(tensors: &SafeTensors, name: &str, of: fn([u8; B]) -> T) -> Vec<T> {
    let view = tensors.tensor(name).unwrap_or_else(|e| panic!("{name}: {e}"));
    view.data().as_chunks::<B>().0.iter().map(|b| of(*b)).collect()
}

#[test]
fn quantisers_are_as_released() {
    let Some(bytes) = golden("unirig/quantizer.safetensors") else { return };
    let all = SafeTensors::deserialize(&bytes).unwrap();
    let x = numbers(&all, "in.x", f32::from_le_bytes);
    let of = |bins, low, high, rule| Quantiser { bins, low, high, rule };
    for (suffix, q) in [
        ("", of(256, -1.0, 1.0, Rule::RoundF32)),
        ("_128", of(128, -1.0, 1.0, Rule::RoundF32)),
        ("_half_range", of(256, -0.5, 0.5, Rule::RoundF32)),
    ] {
        let ids = numbers(&all, &format!("out.ids{suffix}"), i64::from_le_bytes);
        let back = numbers(&all, &format!("out.decoded{suffix}"), f32::from_le_bytes);
        for ((x, id), back) in x.iter().zip(ids).zip(back) {
            assert_eq!(i64::from(q.cell(f64::from(*x))), id, "{x} {suffix}");
            assert!((q.coordinate(id as u32) - back).abs() <= 1e-7, "{x} {suffix}");
        }
    }
    let paper = of(256, -1.0, 1.0, Rule::Floor);
    let ids = numbers(&all, "out.paper_ids", i64::from_le_bytes);
    let back = numbers(&all, "out.paper_decoded", f32::from_le_bytes);
    for ((x, id), back) in x.iter().zip(ids).zip(back) {
        assert_eq!(i64::from(paper.cell(f64::from(*x))), id, "{x}");
        assert!((paper.coordinate(id as u32) - back).abs() <= 1e-7, "{x}");
    }
    let Some(bytes) = golden("skintokens/coordinate_quantise.safetensors") else { return };
    let all = SafeTensors::deserialize(&bytes).unwrap();
    let q = of(256, -1.0, 1.0, Rule::RoundF64);
    let values = numbers(&all, "in.values", f64::from_le_bytes);
    let ids = numbers(&all, "out.ids", i64::from_le_bytes);
    let back = numbers(&all, "out.back", f32::from_le_bytes);
    for ((x, id), back) in values.iter().zip(ids).zip(back) {
        assert_eq!(i64::from(q.cell(*x)), id, "{x}");
        assert!((q.coordinate(id as u32) - back).abs() <= 1e-7, "{x}");
    }
    let again = numbers(&all, "out.requantised", i64::from_le_bytes);
    for (cell, again) in again.into_iter().enumerate() {
        assert_eq!(i64::from(q.cell(f64::from(q.coordinate(cell as u32)))), again, "{cell}");
    }
}

/// SkinTokens' two configurations: as shipped, and with templates.
fn skintokens() -> [(&'static str, Tokenizer); 2] {
    let released = Preset::SkintokensReleased.config();
    let parts = TokenizerConfig {
        classes: ["vroid", "mixamo", "articulation"].map(String::from).to_vec(),
        templates: true,
        spring: Spring::WithClass,
        siblings: Siblings::AsGiven,
        ..released.clone()
    };
    [("released", Tokenizer::new(released)), ("parts", Tokenizer::new(parts))]
}

#[test]
fn skintokens_tokenizes_and_reads_as_released() {
    let (Some(side), Some(bytes)) =
        (json("skintokens/tokenizer_skeletons.json"), golden("skintokens/tokenizer_skeletons.safetensors"))
    else {
        return;
    };
    let all = SafeTensors::deserialize(&bytes).unwrap();
    let config = &side["config"];
    let mut compared = 0;
    for (what, case) in config["skeletons"].as_object().unwrap() {
        // Some are told of without their arrays.
        if all.tensor(&format!("in.joints.{what}")).is_err() {
            continue;
        }
        compared += 1;
        let flat = numbers(&all, &format!("in.joints.{what}"), f64::from_le_bytes);
        let joints = flat.as_chunks::<3>().0.to_vec();
        let parent = |p: i64| usize::try_from(p).ok();
        let parents: Vec<_> =
            numbers(&all, &format!("in.parents.{what}"), i64::from_le_bytes).into_iter().map(parent).collect();
        let class = case["cls"].as_str();
        let names = names(config, &case["names"], class, joints.len());
        for (kind, tokenizer) in skintokens() {
            // As shipped, a class is only written where it has a token.
            let bones = Bones { joints: &joints, parents: &parents, names: &names };
            let found = tokenizer.encode_bones(&bones, class).unwrap_or_else(|e| panic!("{what}: {e}"));
            let wanted = numbers(&all, &format!("out.ids_{kind}.{what}"), i64::from_le_bytes);
            assert_eq!(found.ids.iter().map(|&id| i64::from(id)).collect::<Vec<_>>(), wanted, "{what} {kind}");
            if kind == "parts" {
                let order = numbers(&all, &format!("out.order.{what}"), i64::from_le_bytes);
                assert_eq!(found.order.iter().map(|&j| j as i64).collect::<Vec<_>>(), order, "{what}");
            }
            let back = tokenizer.decode(&found.ids).unwrap_or_else(|e| panic!("{what} {kind}: {e}"));
            let wanted_parents: Vec<_> = numbers(&all, &format!("out.parents_{kind}.{what}"), i64::from_le_bytes)
                .into_iter()
                .map(parent)
                .collect();
            assert_eq!(back.parents, wanted_parents, "{what} {kind}");
            let wanted_joints = numbers(&all, &format!("out.joints_{kind}.{what}"), f32::from_le_bytes);
            for (a, b) in back.joints.as_flattened().iter().zip(wanted_joints) {
                assert!((a - b).abs() <= 1e-6, "{what} {kind}");
            }
            assert_eq!(back.class.as_deref(), case[format!("decoded_cls_{kind}")].as_str(), "{what} {kind}");
            let shown = format!("{} .. {} ({})", back.names[0], back.names[back.names.len() - 1], back.names.len());
            assert_eq!(Some(&*shown), case[format!("decoded_names_{kind}")].as_str(), "{what} {kind}");
            let mut walk = Walk::new(tokenizer.vocabulary());
            found.ids.iter().for_each(|&id| walk.advance(id).unwrap());
            assert_eq!(case[format!("bones_counted_{kind}")].as_u64(), Some(walk.joints() as u64), "{what} {kind}");
        }
    }
    assert_eq!(compared, all.names().iter().filter(|n| n.starts_with("in.joints.")).count());
}

/// The names of a case: listed, or those of its class' template and some more.
fn names(config: &Value, said: &Value, class: Option<&str>, count: usize) -> Vec<String> {
    if said.is_array() {
        return strings(said);
    }
    let mut all: Vec<String> = match class {
        Some(class @ ("mixamo" | "vroid")) => {
            ["body", "hand"].iter().flat_map(|part| strings(&config[format!("{class}_{part}")])).collect()
        }
        _ => (0..count).map(|j| format!("j{j}")).collect(),
    };
    if let Some((_, more)) = said.as_str().unwrap().split_once("then ") {
        all.extend(more.split(", ").map(str::to_owned));
    }
    all.truncate(count);
    all
}

#[test]
fn skintokens_grammar_is_as_released() {
    let Some(bytes) = golden("skintokens/tokenizer_grammar.safetensors") else { return };
    let all = SafeTensors::deserialize(&bytes).unwrap();
    let lengths = numbers(&all, "in.prefix_lengths", i64::from_le_bytes);
    let flat = numbers(&all, "in.prefix_ids", i64::from_le_bytes);
    let allowed = all.tensor("out.allowed").unwrap().data().to_vec();
    let bones = numbers(&all, "out.bones", i64::from_le_bytes);
    let unirig = numbers(&all, "out.bones_unirig", i64::from_le_bytes);
    let [_, (_, tokenizer)] = skintokens();
    let width = tokenizer.vocabulary().len();
    let mut start = 0;
    for (case, length) in lengths.into_iter().enumerate() {
        let mut walk = Walk::new(tokenizer.vocabulary());
        let prefix = &flat[start..start + length as usize];
        prefix.iter().for_each(|&id| walk.advance(id as u32).unwrap());
        start += length as usize;
        let mut mask = Mask::none(width);
        walk.allowed(&mut mask);
        let wanted: Vec<u32> = (0..width as u32).filter(|&id| allowed[case * width + id as usize] != 0).collect();
        assert_eq!(mask.iter().collect::<Vec<_>>(), wanted, "{prefix:?}");
        assert_eq!((walk.joints() as i64, walk.points() as i64), (bones[case], unirig[case]), "{prefix:?}");
    }
}

#[test]
fn a_first_id_other_than_bos_is_refused() {
    let [(_, tokenizer), _] = skintokens();
    assert_eq!(Walk::new(tokenizer.vocabulary()).advance(3), Err(DecodeFault::NoBos));
}
