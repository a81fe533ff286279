//! The released tokenizers' own results: UniRig's and SkinTokens'.

#[path = "../../riglab-geom/tests/common/golden.rs"]
mod golden;

use std::collections::BTreeSet;

use golden::{Golden, golden, lists};
use riglab_token::{
    Bones, DecodeFault, Mask, Preset, Quantiser, Rule, Siblings, Spring, Template, Tokenizer, TokenizerConfig,
    Vocabulary, Walk, extraction_order,
};
use serde_json::Value;

fn array(v: &Value) -> &[Value] {
    v.as_array().map_or(&[], Vec::as_slice)
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

/// Nothing may be recorded that is not looked at.
fn only(v: &Value, known: &[&str], what: &str) {
    let unknown: Vec<_> = v.as_object().unwrap().keys().filter(|key| !known.contains(&key.as_str())).collect();
    assert!(unknown.is_empty(), "{what}: not compared: {unknown:?}");
}

/// A tokenizer with the classes and cells of a table, whose ids are those of the table.
fn tabled(table: &Value, config: TokenizerConfig) -> Tokenizer {
    let mut classes: Vec<(u64, String)> =
        table["cls"].as_object().unwrap().iter().map(|(name, id)| (id.as_u64().unwrap(), name.clone())).collect();
    classes.sort();
    let bins = table["num_discrete"].as_u64().map_or(config.bins, |bins| bins as u16);
    let classes = classes.into_iter().map(|(_, name)| name).collect();
    let end = |k: usize| table["range"][k].as_f64().map_or(config.range[k], |x| x as f32);
    let range = [end(0), end(1)];
    let tokenizer = Tokenizer::new(TokenizerConfig { bins, range, classes, ..config });
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
        assert!(table[name].is_null() || table[name].as_u64() == Some(u64::from(id)), "{name}: {table}");
    }
    for (part, name) in tokenizer.config().parts.iter().enumerate() {
        for told in [&table["parts"][name], &table[format!("part_{name}")]] {
            assert!(told.is_null() || told.as_u64() == Some(u64::from(ids.part(part))), "{name}: {table}");
        }
    }
    for (name, id) in table["cls"].as_object().unwrap() {
        assert_eq!(ids.class_named(name).map(|c| ids.class(c)), Some(id.as_u64().unwrap() as u32), "{name}");
    }
    tokenizer
}

fn unirig(table: &Value) -> Tokenizer {
    tabled(table, Preset::UnirigReleased.config())
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
    only(wanted, &["error", "joints", "p_joints", "parents", "tails", "names", "cls", "parts"], what);
    if wanted["error"].is_string() {
        assert!(found.is_err(), "{what}: {found:?}");
        return;
    }
    let found = found.unwrap_or_else(|e| panic!("{what}: {e}"));
    let has = |key: &str| wanted.get(key).is_some();
    if has("joints") {
        near(&found.joints, &wanted["joints"], what);
    }
    if has("p_joints") {
        // The root is its own.
        let of = |(joint, parent): (usize, &Option<usize>)| found.joints[parent.unwrap_or(joint)];
        let heads: Vec<_> = found.parents.iter().enumerate().map(of).collect();
        near(&heads, &wanted["p_joints"], &format!("{what}: parents' places"));
    }
    if has("parents") {
        assert_eq!(found.parents, parents(&wanted["parents"]), "{what}");
    }
    if has("tails") {
        near(&found.tails(), &wanted["tails"], &format!("{what}: tails"));
    }
    if has("names") {
        assert_eq!(found.names, strings(&wanted["names"]), "{what}");
    }
    if has("cls") {
        assert_eq!(found.class.as_deref(), wanted["cls"].as_str(), "{what}");
    }
    if has("parts") {
        let parts: Vec<Option<String>> =
            array(&wanted["parts"]).iter().map(|p| p.as_str().map(str::to_owned)).collect();
        assert_eq!(found.parts, parts, "{what}");
    }
}

/// What a sequence writes before each joint: parts and springs (`None`) by the joint's place, and whether there is a
/// branch.
fn marks(tokenizer: &Tokenizer, ids: &[u32]) -> (Vec<(usize, Option<String>)>, Vec<bool>) {
    let words: &Vocabulary = tokenizer.vocabulary();
    let names = &tokenizer.config().parts;
    let (mut parts, mut branches) = (Vec::new(), Vec::new());
    let (mut at, mut branch) = (0, false);
    while at < ids.len() {
        let id = ids[at];
        if id < words.branch() {
            at += if branch { 6 } else { 3 };
            branches.push(std::mem::take(&mut branch));
            continue;
        }
        branch |= id == words.branch();
        if id == words.spring() {
            parts.push((branches.len(), None));
        }
        if let Some(part) = (0..names.len()).find(|part| words.part(*part) == id) {
            parts.push((branches.len(), Some(names[part].clone())));
        }
        at += 1;
    }
    (parts, branches)
}

#[test]
fn unirig_tokenizes_and_reads_as_released() {
    for (file, cases) in lists("unirig", "tokenizer_cases") {
        only(&cases, &["what", "source", "tables", "templates", "tolerance", "notes", "cases"], &file);
        for (class, parts) in cases["templates"].as_object().into_iter().flatten() {
            for (part, names) in parts.as_object().unwrap() {
                assert_eq!(template(class, part), strings(names), "{file}: {class} {part}");
            }
        }
        for case in array(&cases["cases"]) {
            unirig_case(&cases["tables"], case);
        }
    }
}

/// The joints of a part of a template.
fn template(class: &str, part: &str) -> Vec<String> {
    let template = Template::of(class).unwrap_or_else(|| panic!("no template {class}"));
    let part = template.parts.iter().find(|p| p.name == part).unwrap_or_else(|| panic!("no part {part} of {class}"));
    part.joints.iter().map(|name| (*name).to_owned()).collect()
}

fn unirig_case(tables: &Value, case: &Value) {
    let what = case["id"].as_str().unwrap();
    only(case, &["id", "tokenizer", "cls", "names", "parents", "joints", "note", "use_order", "expected"], what);
    let tokenizer = unirig(&tables[case["tokenizer"].as_str().unwrap()]);
    let (joints, tree, names) = (points(&case["joints"]), parents(&case["parents"]), strings(&case["names"]));
    let bones = Bones { joints: &joints, parents: &tree, names: &names };
    let wanted = &case["expected"];
    let known = ["error", "order", "parents", "parts_bias", "branch", "ids", "detokenize", "grammar_violation_at"];
    only(wanted, &[&known[..], &["bones_in_sequence"]].concat(), what);
    // Without its order step the released tokenizer cannot work at all.
    if case["use_order"] == false {
        assert_eq!(wanted["error"], "TypeError", "{what}");
        return;
    }
    let found = tokenizer.encode_bones(&bones, case["cls"].as_str());
    if wanted["error"].is_string() {
        assert!(found.is_err(), "{what}");
        return;
    }
    let found = found.unwrap_or_else(|e| panic!("{what}: {e}"));
    let has = |key: &str| wanted.get(key).is_some();
    if has("order") {
        let order: Vec<usize> = ids(&wanted["order"]).into_iter().map(|j| j as usize).collect();
        assert_eq!(found.order, order, "{what}");
    }
    if has("parents") {
        let place = |joint: usize| found.order.iter().position(|j| *j == joint);
        let ordered: Vec<_> = found.order.iter().map(|j| tree[*j].and_then(place)).collect();
        assert_eq!(ordered, parents(&wanted["parents"]), "{what}");
    }
    let (parts, branches) = marks(&tokenizer, &found.ids);
    if has("parts_bias") {
        let told = array(&wanted["parts_bias"]).iter();
        let told = told.map(|p| (p[0].as_u64().unwrap() as usize, p[1].as_str().map(str::to_owned)));
        // One behind the last joint is never written.
        let told: Vec<_> = told.filter(|(at, part)| *at < joints.len() || part.is_some()).collect();
        assert_eq!(parts, told, "{what}: parts");
        for p in array(&wanted["parts_bias"]) {
            assert!(p[0].as_u64().unwrap() <= joints.len() as u64, "{what}: parts");
        }
    }
    if has("branch") {
        let branches: Vec<u32> = branches.into_iter().map(u32::from).collect();
        assert_eq!(branches, ids(&wanted["branch"]), "{what}: branches");
    }
    if has("ids") {
        assert_eq!(found.ids, ids(&wanted["ids"]), "{what}");
    }
    if has("detokenize") {
        compare(&tokenizer, &found.ids, &wanted["detokenize"], what);
    }
    let (first, count) = walk(&tokenizer, &found.ids);
    if has("grammar_violation_at") {
        assert_eq!(first.map(|at| at as u64), wanted["grammar_violation_at"].as_u64(), "{what}");
    }
    if has("bones_in_sequence") {
        assert_eq!(Some(count as u64), wanted["bones_in_sequence"].as_u64(), "{what}");
    }
}

#[test]
fn bones_are_taken_in_the_order_of_the_release() {
    for (file, cases) in lists("unirig", "bone_order") {
        for case in array(&cases["cases"]) {
            let what = format!("{file}: {}", case["id"]);
            // The world's matrix turns what siblings are sorted by, which is one value for all of them.
            only(case, &["id", "bones", "first_listed", "matrix_world", "order", "note"], &what);
            let bones = array(&case["bones"]);
            let names: Vec<&str> = bones.iter().map(|b| b[0].as_str().unwrap()).collect();
            let place = |name: &Value| names.iter().position(|n| Some(*n) == name.as_str());
            let parents: Vec<Option<usize>> = bones.iter().map(|b| place(&b[1])).collect();
            let first = if case["first_listed"].is_string() { place(&case["first_listed"]).unwrap() } else { 0 };
            let order = extraction_order(&parents, first).unwrap();
            let order: Vec<_> = order.iter().map(|&b| names[b].to_owned()).collect();
            assert_eq!(order, strings(&case["order"]), "{what}");
        }
    }
    assert_eq!(extraction_order(&[Some(1), Some(0)], 0), None);
    assert_eq!(extraction_order(&[None, Some(7)], 0), None);
    assert_eq!(extraction_order(&[], 0), None);
}

/// SkinTokens goes the same way through a tree.
#[test]
fn joints_are_counted_depth_first() {
    for case in golden("skintokens", "augment") {
        for group in case.groups().into_iter().filter(|group| group.starts_with("dfs_order")) {
            let parents: Vec<_> = case
                .values(&case.input(&group, "parents"))
                .iter()
                .map(|p| (*p >= 0.0).then_some(*p as usize))
                .collect();
            let root = parents.iter().position(Option::is_none).unwrap();
            let order = extraction_order(&parents, root).unwrap();
            case.check(&format!("out.{group}"), order.into_iter().map(|j| j as f64));
        }
    }
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
    let tables: Vec<Value> = lists("unirig", "tokenizer_cases").into_iter().map(|(_, c)| c["tables"].clone()).collect();
    for (file, cases) in lists("unirig", "grammar_cases") {
        let known = ["what", "source", "tolerance", "notes", "tables", "sets", "sequences", "detokenize_only"];
        only(&cases, &known, &file);
        // Tables are those of the tokenizer's cases.
        let tokenizer = |case: &Value| {
            let name = case["tokenizer"].as_str().unwrap();
            let all = std::iter::once(&cases["tables"]).chain(&tables);
            unirig(all.map(|tables| &tables[name]).find(|t| t.is_object()).unwrap_or_else(|| panic!("no table {name}")))
        };
        for case in array(&cases["sequences"]) {
            grammar_case(&tokenizer(case), array(&cases["sets"]), case);
        }
        for case in array(&cases["detokenize_only"]) {
            let (tokenizer, what) = (tokenizer(case), case["id"].as_str().unwrap());
            only(case, &["id", "tokenizer", "ids", "first_forbidden", "detokenize", "note"], what);
            let sequence = ids(&case["ids"]);
            if case.get("first_forbidden").is_some() {
                let (first, _) = walk(&tokenizer, &sequence);
                assert_eq!(first.map(|at| at as u64), case["first_forbidden"].as_u64(), "{what}");
            }
            if case.get("detokenize").is_some() {
                compare(&tokenizer, &sequence, &case["detokenize"], what);
            }
        }
    }
}

fn grammar_case(tokenizer: &Tokenizer, sets: &[Value], case: &Value) {
    let what = case["id"].as_str().unwrap();
    let known =
        ["id", "tokenizer", "ids", "allowed_after_prefix", "first_forbidden", "bones_in_sequence", "detokenize"];
    only(case, &[&known[..], &["note"]].concat(), what);
    let sequence = ids(&case["ids"]);
    let mut walk = Walk::new(tokenizer.vocabulary());
    let mut mask = Mask::none(tokenizer.vocabulary().len());
    let (mut sound, mut first) = (true, None);
    let allowed = array(&case["allowed_after_prefix"]);
    for at in 0..=sequence.len() {
        walk.allowed(&mut mask);
        match allowed.get(at).map(|set| &sets[set.as_u64().unwrap() as usize]) {
            Some(Value::Array(ranges)) => {
                assert!(sound, "{what} at {at}");
                let wanted: Vec<u32> = ranges.iter().map(ids).flat_map(|r| r[0]..=r[1]).collect();
                assert_eq!(mask.iter().collect::<Vec<_>>(), wanted, "{what} at {at}");
            }
            // The code fails.
            Some(_) => assert!(!sound, "{what} at {at}"),
            None => {}
        }
        let Some(&id) = sequence.get(at) else { break };
        if first.is_none() && !mask.allows(id) {
            first = Some(at as u64);
        }
        sound &= walk.advance(id).is_ok();
    }
    assert!(allowed.len() <= sequence.len() + 1, "{what}");
    if case.get("first_forbidden").is_some() {
        assert_eq!(first, case["first_forbidden"].as_u64(), "{what}");
    }
    match &case["bones_in_sequence"] {
        Value::Null => {}
        Value::String(_) => assert!(!sound, "{what}"),
        bones => assert_eq!(Some(walk.points() as u64), bones.as_u64(), "{what}"),
    }
    if case["detokenize"].is_object() {
        compare(tokenizer, &sequence, &case["detokenize"], what);
    }
}

#[test]
fn quantisers_are_as_released() {
    for case in golden("unirig", "quantizer") {
        for group in case.groups() {
            quantised(&case, &group, Quantiser { bins: 256, low: -1.0, high: 1.0, rule: Rule::RoundF32 });
        }
        case.done();
    }
    for case in golden("skintokens", "coordinate_quantise") {
        let end = |k: usize| case.config("range")[k].as_f64().unwrap() as f32;
        let bins = case.number("cells") as u16;
        for group in case.groups() {
            quantised(&case, &group, Quantiser { bins, low: end(0), high: end(1), rule: Rule::RoundF64 });
        }
        case.done();
    }
}

/// One output, whose name tells what it is and how the quantiser is other than usual: `paper_ids`, `decoded_128`,
/// `ids_half_range`.
fn quantised(case: &Golden, group: &str, usual: Quantiser) {
    let (mut q, mut of, mut all) = (usual, None, false);
    for word in group.split('_') {
        match word {
            "ids" | "decoded" | "back" | "centres" | "requantised" => of = Some(word),
            "all" => all = true,
            "paper" => q.rule = Rule::Floor,
            "half" => (q.low, q.high) = (-0.5, 0.5),
            "unit" => (q.low, q.high) = (0.0, 1.0),
            "range" => {}
            bins => q.bins = bins.parse().unwrap_or_else(|_| panic!("{}: unknown output `{group}`", case.name)),
        }
    }
    let name = format!("out.{group}");
    let given = || {
        let names = ["x", "values"].map(|what| case.input(group, what));
        names.iter().find(|name| case.has(name)).map(|name| case.values(name)).expect("coordinates")
    };
    let cells = || 0..case.values(&name).len() as u32;
    let coordinate = |cell: u32| f64::from(q.coordinate(cell));
    let cell = |x: &f64| q.cell(*x);
    let exact = (0.0, 0.0);
    let near = (1e-7, 0.0);
    match of {
        Some("ids") => case.check_within(&name, given().iter().map(|x| f64::from(cell(x))), exact),
        Some("requantised") => case.check_within(&name, cells().map(|k| f64::from(cell(&coordinate(k)))), exact),
        Some("centres") => case.check_within(&name, cells().map(coordinate), near),
        Some("decoded" | "back") if all => case.check_within(&name, cells().map(coordinate), near),
        Some(_) => case.check_within(&name, given().iter().map(|x| coordinate(u32::from(cell(x)))), near),
        None => panic!("{}: unknown output `{group}`", case.name),
    }
}

/// SkinTokens' configurations of a file, by the tables in its config: as shipped, and with an order. The released code
/// knows templates or siblings by (z, x, y), which leaves parts and springs out.
fn skintokens(config: &Value) -> Vec<(String, Tokenizer)> {
    let tables = config.as_object().unwrap().iter().filter(|(_, table)| table["cls"].is_object());
    let tokenizer = |(kind, table): (&String, &Value)| {
        let released = Preset::SkintokensReleased.config();
        let order = Some(&table["order"]).filter(|order| !order.is_null()).map(Value::to_string);
        let config = match order {
            None => released,
            Some(words) if words.contains("xyz") => TokenizerConfig { siblings: Siblings::Zxy, ..released },
            Some(_) => TokenizerConfig { templates: true, spring: Spring::WithClass, ..released },
        };
        (kind.clone(), tabled(table, config))
    };
    tables.map(tokenizer).collect()
}

#[test]
fn skintokens_tokenizes_and_reads_as_released() {
    for case in golden("skintokens", "tokenizer_skeletons") {
        let config = &case.json["config"];
        for (key, names) in config.as_object().unwrap() {
            if let Some((class, part)) = key.split_once('_').filter(|_| names.is_array()) {
                assert_eq!(template(class, part), strings(names), "{key}");
            }
        }
        let kinds = skintokens(config);
        let recorded: BTreeSet<&str> = case.names().filter_map(|name| name.splitn(3, '.').nth(2)).collect();
        for what in &recorded {
            let told = &config["skeletons"][*what];
            assert!(told.is_object(), "{}: {what} has arrays, but no word in the config", case.name);
            let mut known: Vec<String> = ["cls", "names", "joints"].map(String::from).to_vec();
            for (kind, tokenizer) in &kinds {
                skeleton(&case, what, kind, tokenizer);
                let keys = ["decoded_cls", "decoded_names", "bones_counted", "wrong_parents_after_roundtrip"];
                known.extend(keys.map(|key| format!("{key}_{kind}")));
            }
            only(told, &known.iter().map(String::as_str).collect::<Vec<_>>(), what);
        }
        for what in config["skeletons"].as_object().unwrap().keys().filter(|what| !recorded.contains(what.as_str())) {
            println!("{}: {what}: told of without its arrays", case.name);
        }
        case.done();
    }
}

fn skeleton(case: &Golden, what: &str, kind: &str, tokenizer: &Tokenizer) {
    let told = &case.json["config"]["skeletons"][what];
    let joints = case.values(&format!("in.joints.{what}")).as_chunks::<3>().0.to_vec();
    let parents: Vec<_> =
        case.values(&format!("in.parents.{what}")).iter().map(|p| (*p >= 0.0).then_some(*p as usize)).collect();
    let class = told["cls"].as_str();
    let names = names(&case.json["config"], &told["names"], class, joints.len());
    // As shipped, a class is only written where it has a token.
    let bones = Bones { joints: &joints, parents: &parents, names: &names };
    let found = tokenizer.encode_bones(&bones, class).unwrap_or_else(|e| panic!("{what}: {e}"));
    let back = tokenizer.decode(&found.ids).unwrap_or_else(|e| panic!("{what} {kind}: {e}"));
    let check = |name: String, got: Vec<f64>| {
        if case.has(&name) {
            case.check(&name, got);
        }
    };
    check(format!("out.ids_{kind}.{what}"), found.ids.iter().map(|id| f64::from(*id)).collect());
    // That of the templates goes without a kind.
    let order: Vec<f64> = found.order.iter().map(|j| *j as f64).collect();
    check(format!("out.order_{kind}.{what}"), order.clone());
    if kind == "parts" {
        check(format!("out.order.{what}"), order);
    }
    let number = |p: &Option<usize>| p.map_or(-1.0, |p| p as f64);
    check(format!("out.parents_{kind}.{what}"), back.parents.iter().map(number).collect());
    let name = format!("out.joints_{kind}.{what}");
    if case.has(&name) {
        case.check_within(&name, back.joints.as_flattened().iter().map(|x| f64::from(*x)), (1e-6, 0.0));
    }

    let told = |key: &str| told.get(format!("{key}_{kind}"));
    if let Some(wanted) = told("decoded_cls") {
        assert_eq!(back.class.as_deref(), wanted.as_str(), "{what} {kind}");
    }
    if let Some(wanted) = told("decoded_names") {
        let shown = format!("{} .. {} ({})", back.names[0], back.names[back.names.len() - 1], back.names.len());
        assert_eq!(Some(&*shown), wanted.as_str(), "{what} {kind}");
    }
    if let Some(wanted) = told("bones_counted") {
        let mut walk = Walk::new(tokenizer.vocabulary());
        found.ids.iter().for_each(|&id| walk.advance(id).unwrap());
        assert_eq!(wanted.as_u64(), Some(walk.joints() as u64), "{what} {kind}");
    }
    if let Some(wanted) = told("wrong_parents_after_roundtrip") {
        let place = |joint: usize| found.order.iter().position(|j| *j == joint);
        let given = found.order.iter().map(|j| parents[*j].and_then(place));
        let wrong = given.zip(&back.parents).filter(|(given, back)| given != *back).count();
        assert_eq!(wanted.as_u64(), Some(wrong as u64), "{what} {kind}");
    }
    if let Some(wanted) = case.json["config"]["skeletons"][what].get("joints") {
        assert_eq!(wanted.as_u64(), Some(joints.len() as u64), "{what}");
    }
}

/// The names of a case: listed, or those of its class' template and some more.
fn names(config: &Value, said: &Value, class: Option<&str>, count: usize) -> Vec<String> {
    if said.is_array() {
        return strings(said);
    }
    let named = |part: &str| config[format!("{}_{part}", class?)].as_array().map(|_| class.unwrap());
    let mut all: Vec<String> = match named("body") {
        Some(class) => ["body", "hand"].iter().flat_map(|part| strings(&config[format!("{class}_{part}")])).collect(),
        None => (0..count).map(|j| format!("j{j}")).collect(),
    };
    if let Some((_, more)) = said.as_str().unwrap().split_once("then ") {
        all.extend(more.split(", ").map(str::to_owned));
    }
    all.truncate(count);
    all
}

#[test]
fn skintokens_grammar_is_as_released() {
    for case in golden("skintokens", "tokenizer_grammar") {
        // Which ids there are follows from how many classes have one.
        let released = Preset::SkintokensReleased.config();
        let first = Tokenizer::new(released.clone()).vocabulary().no_class() as usize + 1;
        let width = case.number("vocab") as usize;
        let classes = (first..width).map(|k| format!("class {k}")).collect();
        let tokenizer = Tokenizer::new(TokenizerConfig { classes, ..released });
        assert_eq!(tokenizer.vocabulary().len(), width, "{}", case.name);
        let (mut allowed, mut joints, mut points) = (Vec::new(), Vec::new(), Vec::new());
        let mut left = &case.indices("in.prefix_ids")[..];
        for length in case.indices("in.prefix_lengths") {
            let mut walk = Walk::new(tokenizer.vocabulary());
            let (prefix, rest) = left.split_at(length);
            left = rest;
            prefix.iter().for_each(|&id| walk.advance(id as u32).unwrap());
            let mut mask = Mask::none(width);
            walk.allowed(&mut mask);
            allowed.extend((0..width as u32).map(|id| f64::from(u8::from(mask.allows(id)))));
            joints.push(walk.joints() as f64);
            points.push(walk.points() as f64);
        }
        assert!(left.is_empty(), "{}", case.name);
        for (name, got) in [("allowed", allowed), ("bones", joints), ("bones_unirig", points)] {
            let name = format!("out.{name}");
            if case.has(&name) {
                case.check(&name, got);
            }
        }
        case.done();
    }
}

#[test]
fn a_first_id_other_than_bos_is_refused() {
    let tokenizer = Tokenizer::new(Preset::SkintokensReleased.config());
    assert_eq!(Walk::new(tokenizer.vocabulary()).advance(3), Err(DecodeFault::NoBos));
}
