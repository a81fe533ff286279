//! Whole curations of small folders.

mod common;

use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::net::TcpListener;
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex};

use common::{copy, creatures, dropped, plain, run, run_shard, write};
use riglab_core::{Asset, Joint, Rig, Skeleton};
use riglab_curate::decisions::{Decision, Decisions, Verdict};
use riglab_curate::record::Record;
use riglab_curate::{
    Category, CurateConfig, CurateError, Funnel, Places, Reading, Shard, SplitBy, StageName, curate, listed,
    merge_shards,
};
use riglab_data::Corpus;

#[test]
fn a_folder_becomes_a_corpus_and_a_report() {
    let dir = tempfile::tempdir().unwrap();
    let mut all = creatures(6);
    all.push(copy(&all[1], "copy"));
    write(dir.path(), &all);
    std::fs::write(dir.path().join("broken.glb"), b"glTF").unwrap();
    let mut config = plain();
    config.report.kept = 4;
    config.report.dropped = 4;
    config.bones.min = 8;
    let out = tempfile::tempdir().unwrap();
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!(dropped(&funnel, "read"), ["broken.glb"]);
    assert_eq!(dropped(&funnel, "duplicates").len(), 1);
    let kept = 8 - 2 - dropped(&funnel, "bones").len();
    assert_eq!((funnel.assets, funnel.kept), (8, kept));
    let left: usize = funnel.stages.iter().map(|s| s.dropped.len()).sum();
    assert_eq!(left + funnel.kept, funnel.assets);
    assert_eq!(funnel.categories.values().sum::<usize>(), kept);
    let corpus = Corpus::open(&out.path().join("corpus.h5")).unwrap();
    assert_eq!(corpus.len(), kept);
    assert!(corpus.verify(|_| ()).unwrap().is_empty());
    assert!(corpus.texts("category").unwrap().iter().all(|c| c.parse::<Category>().is_ok()));
    let places = Places::of(&out.path().join("corpus.h5"));
    let page = std::fs::read_to_string(places.report()).unwrap();
    assert!(page.contains("The funnel") && page.contains("data:image/png") && !page.contains("http://127"));
    assert_eq!(std::fs::read_to_string(places.assets()).unwrap().lines().count(), 8);
    let again: riglab_curate::Funnel = serde_json::from_slice(&std::fs::read(places.funnel()).unwrap()).unwrap();
    assert_eq!(again, funnel);
}

#[test]
fn a_run_goes_on_where_it_was_broken_off_and_gives_the_same_bytes() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(8));
    let (one, two) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let funnel = run(dir.path(), one.path(), &plain()).unwrap();
    let places = |of: &tempfile::TempDir| Places::of(&of.path().join("corpus.h5"));
    let journal = std::fs::read_to_string(places(&one).journal()).unwrap();
    // Killed after some lines, in the middle of one.
    std::fs::create_dir_all(places(&two).work).unwrap();
    let cut = journal.lines().take(7).map(|l| l.len() + 1).sum::<usize>() + 30;
    // What was looked at is not looked at again: a mark in a record comes through.
    let marked = journal[..cut].replacen("\"notes\":[]", "\"notes\":[\"seen before\"]", 1);
    std::fs::write(places(&two).journal(), marked).unwrap();
    let resumed = run(dir.path(), two.path(), &plain()).unwrap();
    assert_eq!(resumed, funnel);
    assert!(std::fs::read_to_string(places(&two).assets()).unwrap().contains("seen before"));
    let sum = |of: &tempfile::TempDir| Corpus::open(&places(of).out).unwrap().checksum().unwrap();
    assert_eq!(sum(&one), sum(&two));
    // A file that has changed since is looked at again, one that has gone is forgotten.
    write(dir.path(), &[copy(&creatures(9)[8], &creatures(1)[0].name)]);
    std::fs::remove_file(dir.path().join(format!("{}.glb", creatures(2)[1].name))).unwrap();
    let changed = run(dir.path(), two.path(), &plain()).unwrap();
    assert_eq!(changed.assets, 7);
    assert_ne!(sum(&one), sum(&two));
}

#[test]
fn files_of_many_assets_give_each_and_go_on_too() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(5);
    riglab_asset::write(&all, dir.path().join("set.npz"), riglab_asset::Target::ARTICULATION_XL).unwrap();
    let out = tempfile::tempdir().unwrap();
    let funnel = run(dir.path(), out.path(), &plain()).unwrap();
    assert_eq!((funnel.assets, funnel.kept), (5, 5));
    let places = Places::of(&out.path().join("corpus.h5"));
    let whole = std::fs::read_to_string(places.journal()).unwrap();
    let cut = whole.lines().take(4).map(|l| l.len() + 1).sum::<usize>();
    std::fs::write(places.journal(), &whole[..cut]).unwrap();
    assert_eq!(run(dir.path(), out.path(), &plain()).unwrap(), funnel);
    // The set is another now: what was begun of it does not count.
    std::fs::write(places.journal(), &whole[..cut]).unwrap();
    riglab_asset::write(&all[2..], dir.path().join("set.npz"), riglab_asset::Target::ARTICULATION_XL).unwrap();
    assert_eq!(run(dir.path(), out.path(), &plain()).unwrap().assets, 3);
    assert_eq!(run(dir.path(), out.path(), &plain()).unwrap().assets, 3);
}

/// Eight creatures, and six of them once more.
fn with_copies() -> Vec<riglab_core::Asset> {
    let all = creatures(8);
    let copies: Vec<_> = (0..6).map(|k| copy(&all[k], &format!("copy_{k}"))).collect();
    all.into_iter().chain(copies).collect()
}

#[test]
fn shards_merge_to_what_one_run_gives() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &with_copies());
    let out = tempfile::tempdir().unwrap();
    let whole = run(dir.path(), out.path(), &plain()).unwrap();
    let parts: Vec<_> = (1..=3)
        .map(|number| {
            let path = out.path().join(format!("part{number}.h5"));
            run_shard(dir.path(), &path, Some(Shard { number, of: 3 }), &plain()).unwrap();
            path
        })
        .collect();
    let merged = out.path().join("merged.h5");
    let funnel = merge_shards(&parts, &[], &Places::of(&merged), &plain(), &|_, _, _| ()).unwrap();
    assert_eq!(funnel, whole);
    assert_eq!(dropped(&funnel, "duplicates").len(), 6);
    let sum = |path| Corpus::open(path).unwrap().checksum().unwrap();
    assert_eq!(sum(&merged), sum(&out.path().join("corpus.h5")));
}

#[test]
fn what_was_merged_merges_again() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &with_copies());
    let out = tempfile::tempdir().unwrap();
    let whole = run(dir.path(), out.path(), &plain()).unwrap();
    let path = |name: &str| out.path().join(name);
    for number in 1..=3 {
        run_shard(dir.path(), &path(&format!("part{number}.h5")), Some(Shard { number, of: 3 }), &plain()).unwrap();
    }
    let merge = |of: &[&str], to: &str| {
        let (of, said): (Vec<PathBuf>, _) = (of.iter().map(|name| path(name)).collect(), Mutex::new(String::new()));
        let tell =
            |what: &str, _: usize, total: usize| said.lock().unwrap().push_str(if total == 0 { what } else { "" });
        let funnel = merge_shards(&of, &[], &Places::of(&path(to)), &plain(), &tell).unwrap();
        (funnel, said.into_inner().unwrap())
    };
    let (_, said) = merge(&["part3.h5", "part1.h5"], "some.h5");
    assert!(said.contains("shard 2/3 is missing"), "{said}");
    let (funnel, said) = merge(&["some.h5", "part2.h5"], "merged.h5");
    assert!(funnel == whole && !said.contains("missing"), "{said}");
    let sum = |path| Corpus::open(path).unwrap().checksum().unwrap();
    assert_eq!(sum(&path("merged.h5")), sum(&path("corpus.h5")));
}

#[test]
fn parts_that_no_file_falls_into_are_not_missing() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(2));
    let out = tempfile::tempdir().unwrap();
    let mut parts = Vec::new();
    for number in 1..=8 {
        let path = out.path().join(format!("part{number}.h5"));
        match run_shard(dir.path(), &path, Some(Shard { number, of: 8 }), &plain()) {
            Ok(_) => parts.push(path),
            Err(error) => assert!(matches!(error, CurateError::NothingLeft { assets: 0, .. }), "{error}"),
        }
    }
    assert!((1..=2).contains(&parts.len()));
    let merged = Places::of(&out.path().join("merged.h5"));
    let tell = |what: &str, _: usize, _: usize| assert!(!what.contains("missing"), "{what}");
    assert_eq!(merge_shards(&parts, &[], &merged, &plain(), &tell).unwrap().kept, 2);
    // By their names they may be given, too.
    let all: Vec<PathBuf> = (1..=8).map(|number| out.path().join(format!("part{number}.h5"))).collect();
    assert_eq!(merge_shards(&all, &[], &merged, &plain(), &tell).unwrap().kept, 2);
}

#[test]
fn splits_that_a_list_gave_stay_where_parts_merge() {
    let dir = tempfile::tempdir().unwrap();
    let (one, two) = (dir.path().join("one"), dir.path().join("two"));
    let all = creatures(12);
    for (folder, own) in [(&one, &all[..6]), (&two, &all[6..])] {
        std::fs::create_dir(folder).unwrap();
        write(folder, own);
    }
    let file = |k: usize| format!("{}.glb", all[k].name);
    let list = serde_json::json!({"mine": [file(0), file(1), file(2)], "test_new": [file(3), file(4)]});
    std::fs::write(one.join("split.json"), list.to_string()).unwrap();
    let (mut by_list, places) = (plain(), |name: &str| Places::of(&dir.path().join(name)));
    by_list.split.by = SplitBy::List;
    by_list.split.file = one.join("split.json").display().to_string();
    let parts = [places("one.h5").out, places("two.h5").out];
    run_shard(&one, &parts[0], None, &by_list).unwrap();
    run_shard(&two, &parts[1], None, &plain()).unwrap();
    assert_eq!(listed(&parts), parts[..1]);
    let merge = |of: &[PathBuf], out: &str| {
        merge_shards(of, &listed(of), &places(out), &plain(), &|_, _, _| ()).unwrap();
        let corpus = Corpus::open(&places(out).out).unwrap();
        let splits = corpus.texts("split").unwrap();
        corpus.names().unwrap().iter().cloned().zip(splits).collect::<BTreeMap<_, _>>()
    };
    let merged = merge(&parts, "merged.h5");
    let wanted = ["mine", "mine", "mine", "test_new", "test_new", ""];
    assert!((0..6).all(|k| merged[&file(k)] == wanted[k]), "{merged:?}");
    // The others get theirs among themselves, as they would alone.
    let alone = merge(&parts[1..], "alone.h5");
    assert!(alone.iter().all(|(name, split)| merged[name] == *split && !split.is_empty()), "{merged:?}");
    assert_eq!(listed(&[places("merged.h5").out, places("alone.h5").out]), [places("merged.h5").out]);
}

#[test]
fn decisions_of_a_person_count() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(4);
    write(dir.path(), &[all.clone(), vec![copy(&all[0], "copy")]].concat());
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    run(dir.path(), out.path(), &config).unwrap();
    let places = Places::of(&out.path().join("corpus.h5"));
    let lines = std::fs::read_to_string(places.assets()).unwrap();
    let assets: Vec<serde_json::Value> = lines.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    let digest = |name: &str| assets.iter().find(|a| a["name"] == name).unwrap()["digest"].as_str().unwrap().to_owned();
    let file = |k: usize| format!("{}.glb", all[k].name);
    let mut decisions = Decisions::default();
    let mut set = |name: &str, verdict, category| {
        decisions.set(name, &digest(name), Decision { verdict, category, ..Decision::default() });
    };
    set(&file(1), Verdict::Reject, None);
    set(&file(2), Verdict::Open, Some(Category::Reptile));
    set("copy.glb", Verdict::Accept, None);
    decisions.set("lost.glb", "00", Decision { verdict: Verdict::Accept, ..Decision::default() });
    let path = out.path().join("decisions.tsv");
    decisions.write(&path).unwrap();
    config.decisions = path.display().to_string();
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!(dropped(&funnel, "decision"), [file(1)]);
    // The copy that was accepted stays; the other of the pair goes.
    assert_eq!(dropped(&funnel, "duplicates"), [file(0)]);
    assert_eq!(funnel.decisions, 3);
    assert!(funnel.warnings[0].contains("`lost.glb`"));
    let corpus = Corpus::open(&places.out).unwrap();
    let at = corpus.names().unwrap().iter().position(|n| *n == file(2)).unwrap();
    assert_eq!(corpus.texts("category").unwrap()[at], "reptile");
    assert!(corpus.asset(at).unwrap().provenance.notes.contains(&"category by decision".to_string()));
    drop(corpus);
    // What is accepted stays whatever its category.
    config.categories.keep = vec![Category::Reptile];
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!(Corpus::open(&places.out).unwrap().names().unwrap().to_vec(), ["copy.glb".to_owned(), file(2)]);
    assert_eq!(dropped(&funnel, "category"), [file(3)]);
}

#[test]
fn the_copy_whose_category_is_wanted_stays() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(1);
    write(dir.path(), &[copy(&all[0], "a"), copy(&all[0], "b")]);
    let manifest = r#"[{"file": "a.glb", "category": "humanoid"}, {"file": "b.glb", "category": "reptile"}]"#;
    std::fs::write(dir.path().join("manifest.json"), manifest).unwrap();
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    assert_eq!(dropped(&run(dir.path(), out.path(), &config).unwrap(), "duplicates"), ["b.glb"]);
    config.categories.keep = vec![Category::Reptile];
    assert_eq!(dropped(&run(dir.path(), out.path(), &config).unwrap(), "duplicates"), ["a.glb"]);
}

#[test]
fn the_copy_whose_category_by_rules_is_wanted_stays() {
    let dir = tempfile::tempdir().unwrap();
    let mut one = creatures(1).remove(0);
    one.provenance.category = String::new();
    let skeleton = one.rig.skeleton();
    let joints = skeleton.ids().map(|j| Joint {
        name: format!("CHICKEN_{}", j.0),
        parent: skeleton.parent(j),
        head: skeleton.head(j),
    });
    let rig = Rig::new(Skeleton::new(joints.collect()).unwrap(), one.rig.mesh().clone(), one.rig.weights().clone());
    write(dir.path(), &[Asset { rig: rig.unwrap(), name: "a".into(), ..one.clone() }, copy(&one, "b")]);
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    assert_eq!(dropped(&run(dir.path(), out.path(), &config).unwrap(), "duplicates"), ["b.glb"]);
    let lines = std::fs::read_to_string(Places::of(&out.path().join("corpus.h5")).assets()).unwrap();
    let rules =
        |line: &str| serde_json::from_str::<serde_json::Value>(line).unwrap()["rules"].as_str().unwrap().to_owned();
    let rules: Vec<String> = lines.lines().map(rules).collect();
    assert_ne!(rules[0], rules[1]);
    config.categories.keep = vec![rules[1].parse().unwrap()];
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!((dropped(&funnel, "duplicates"), funnel.kept), (vec!["a.glb"], 1));
}

#[test]
fn a_file_that_changes_on_the_way_is_not_taken() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(3);
    write(dir.path(), &all[..2]);
    // Of a single asset, and of several.
    let set = dir.path().join("set.npz");
    riglab_asset::write(&all, &set, riglab_asset::Target::ARTICULATION_XL).unwrap();
    let out = tempfile::tempdir().unwrap();
    let places = Places::of(&out.path().join("corpus.h5"));
    let first = format!("{}.glb", all[0].name);
    let change = |what: &str, done: usize, _: usize| {
        if (what, done) == ("comparing", 0) {
            write(dir.path(), &[Asset { name: all[0].name.clone(), ..copy(&all[2], "") }]);
            let turned: Vec<Asset> = all.iter().map(|a| copy(a, &a.name)).collect();
            riglab_asset::write(&turned, &set, riglab_asset::Target::ARTICULATION_XL).unwrap();
        }
    };
    let mut config = plain();
    config.stages = Vec::new();
    let said = curate(dir.path(), &places, None, &config, &change).unwrap_err();
    let CurateError::Changed { count, files, .. } = &said else { panic!("{said}") };
    assert_eq!((&count[..], files.len(), files.contains(&first)), ("4 assets", 4, true), "{said}");
    assert!(!places.out.exists());
    // The next run looks at them again.
    assert_eq!(run(dir.path(), out.path(), &config).unwrap().kept, 5);
    let corpus = Corpus::open(&places.out).unwrap();
    let (names, sums) = (corpus.names().unwrap().to_vec(), corpus.texts("checksum").unwrap());
    let at = names.iter().position(|name| *name == first).unwrap();
    assert_eq!(sums[at], blake3::hash(&std::fs::read(dir.path().join(&first)).unwrap()).to_hex().to_string());
}

#[test]
fn a_corpus_that_is_older_than_its_journal_is_not_merged() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(3);
    write(dir.path(), &all[..2]);
    let out = tempfile::tempdir().unwrap();
    let [part, other, merged] = ["part", "other", "merged"].map(|name| Places::of(&out.path().join(name)));
    let tell = |_: &str, _: usize, _: usize| ();
    curate(dir.path(), &part, None, &plain(), &tell).unwrap();
    write(dir.path(), &[Asset { name: all[0].name.clone(), ..all[2].clone() }]);
    curate(dir.path(), &other, None, &plain(), &tell).unwrap();
    // As if the part's own curation had been broken off after it looked at the file.
    std::fs::copy(other.journal(), part.journal()).unwrap();
    let merge = || merge_shards(std::slice::from_ref(&part.out), &[], &merged, &plain(), &tell);
    let said = merge().unwrap_err().to_string();
    assert!(said.contains(&format!("part: holds `{}.glb` as it was", all[0].name)), "{said}");
    curate(dir.path(), &part, None, &plain(), &tell).unwrap();
    assert_eq!(merge().unwrap().kept, 2);
}

#[test]
fn a_corpus_with_a_journal_that_was_begun_anew_is_not_merged() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(2));
    let out = tempfile::tempdir().unwrap();
    let [part, whole, merged] = ["part", "whole", "merged"].map(|name| Places::of(&out.path().join(name)));
    let tell = |_: &str, _: usize, _: usize| ();
    for places in [&part, &whole] {
        curate(dir.path(), places, None, &plain(), &tell).unwrap();
    }
    // A head, and the first file; what the other says of the second is not said of the part's.
    let journal = std::fs::read_to_string(part.journal()).unwrap();
    std::fs::write(part.journal(), journal.split_inclusive('\n').take(3).collect::<String>()).unwrap();
    let said = merge_shards(&[part.out.clone(), whole.out.clone()], &[], &merged, &plain(), &tell).unwrap_err();
    assert!(said.to_string().contains("part: holds `"), "{said}");
}

#[test]
fn a_merge_counts_what_its_parts_stages_dropped() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(6);
    write(dir.path(), &all);
    let out = tempfile::tempdir().unwrap();
    let mut joints: Vec<usize> = all.iter().map(|a| a.rig.skeleton().len()).collect();
    joints.sort_unstable();
    let (mut strict, mut loose) = (plain(), plain());
    strict.stages = vec![StageName::Bones];
    strict.bones.min = joints[3];
    loose.stages = vec![StageName::Weights, StageName::Duplicates];
    let part = out.path().join("part.h5");
    let few = run_shard(dir.path(), &part, None, &strict).unwrap();
    let merge = |part: &std::path::Path, config: &CurateConfig| {
        merge_shards(&[part.into()], &[], &Places::of(&out.path().join("merged.h5")), config, &|_, _, _| ()).unwrap()
    };
    let merged = merge(&part, &loose);
    let stages = |funnel: &Funnel| funnel.stages.iter().map(|stage| stage.stage.clone()).collect::<Vec<_>>().join(" ");
    assert_eq!(stages(&merged), "read decision bones duplicates");
    assert!(few.kept < 6 && dropped(&merged, "bones") == dropped(&few, "bones"));
    let last = merged.stages.last().unwrap();
    assert_eq!(last.came - last.dropped.len(), merged.kept);
    // Where the part's report is lost, its records say what they were dropped by.
    std::fs::remove_file(Places::of(&part).funnel()).unwrap();
    assert_eq!(stages(&merge(&part, &loose)), "read decision weights bones duplicates");
}

#[test]
fn a_corpus_is_of_the_shard_that_it_was_made_of() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(12));
    let out = tempfile::tempdir().unwrap();
    let places = Places::of(&out.path().join("corpus.h5"));
    let shard = |number, of| Some(Shard { number, of });
    let told = || std::fs::read_to_string(places.work.join("shard.json")).unwrap_or_default();
    let others = Mutex::new(Vec::new());
    // Another run begins meanwhile, and finds this one at work.
    let meanwhile = |what: &str, _: usize, _: usize| {
        if what == "comparing" {
            others.lock().unwrap().push(run_shard(dir.path(), &places.out, shard(1, 3), &plain()));
        }
    };
    curate(dir.path(), &places, shard(2, 2), &plain(), &meanwhile).unwrap();
    let others = others.into_inner().unwrap();
    assert!(!others.is_empty() && others.iter().all(|other| matches!(other, Err(CurateError::Busy(_)))));
    assert_eq!(told(), r#"[{"number":2,"of":2}]"#);
    // One that is broken off leaves the corpus, and whose it is.
    let kept: Vec<String> = Corpus::open(&places.out).unwrap().names().unwrap().to_vec();
    let gone = |what: &str, _: usize, _: usize| {
        if what == "comparing" {
            creatures(12).iter().for_each(|a| drop(std::fs::remove_file(dir.path().join(format!("{}.glb", a.name)))));
        }
    };
    let broken = curate(dir.path(), &places, None, &plain(), &gone);
    assert!(matches!(broken, Err(CurateError::Changed { .. })));
    assert_eq!(told(), r#"[{"number":2,"of":2}]"#);
    assert_eq!(Corpus::open(&places.out).unwrap().names().unwrap().to_vec(), kept);
    write(dir.path(), &creatures(12));
    run_shard(dir.path(), &places.out, None, &plain()).unwrap();
    assert_eq!(told(), "");
}

#[test]
fn a_file_of_one_asset_gives_its_name_where_characters_are_split() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(2);
    std::fs::create_dir(dir.path().join("asset1")).unwrap();
    riglab_asset::write(&all[..1], dir.path().join("fox_rig.txt"), riglab_asset::Target::RIGNET).unwrap();
    riglab_asset::write(&all[1..], dir.path().join("asset1/raw_data.npz"), riglab_asset::Target::UNIRIG).unwrap();
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.import.split_characters = true;
    run(dir.path(), out.path(), &config).unwrap();
    let corpus = Corpus::open(&out.path().join("corpus.h5")).unwrap();
    assert_eq!(corpus.names().unwrap().to_vec(), ["asset1/raw_data.npz", "fox_rig.txt"]);
}

#[test]
fn copies_that_stay_are_in_one_split() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(24);
    // The same bytes under another name.
    let copies: Vec<_> = all.iter().map(|a| riglab_core::Asset { name: format!("z{}", a.name), ..a.clone() }).collect();
    write(dir.path(), &[all.clone(), copies].concat());
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.stages = Vec::new();
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!(funnel.kept, 48);
    let corpus = Corpus::open(&out.path().join("corpus.h5")).unwrap();
    let of: BTreeMap<String, String> =
        corpus.names().unwrap().iter().cloned().zip(corpus.texts("split").unwrap()).collect();
    assert!(of.values().collect::<std::collections::BTreeSet<_>>().len() > 1);
    assert!(all.iter().all(|a| of[&format!("{}.glb", a.name)] == of[&format!("z{}.glb", a.name)]), "{of:?}");
    assert!(funnel.warnings.iter().any(|w| w.starts_with("24 assets are equal to another")), "{:?}", funnel.warnings);
}

#[test]
fn sources_are_those_of_the_manifest_and_an_earlier_corpus_is_none() {
    let dir = tempfile::tempdir().unwrap();
    let models = dir.path().join("models");
    std::fs::create_dir_all(models.join("old_models")).unwrap();
    let all = creatures(2);
    std::fs::write(models.join("a.glb"), riglab_asset::to_glb(&all[0])).unwrap();
    std::fs::write(models.join("old_models/b.glb"), riglab_asset::to_glb(&all[1])).unwrap();
    let url = format!("https://x.org/3d{}/fox", models.display());
    std::fs::write(models.join("manifest.json"), format!(r#"[{{"file": "a.glb", "source": "{url}"}}]"#)).unwrap();
    let named = models.join("../models/corpus.h5");
    let [one, two] = [0, 1].map(|_| run_shard(&models, &named, None, &plain()).unwrap());
    assert_eq!((one.assets, &one), (2, &two));
    let sources = Corpus::open(&named).unwrap().texts("source").unwrap();
    assert_eq!(sources, [url, "old_models/b.glb".to_owned()]);
}

#[test]
fn splits_by_source_and_by_list() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(12);
    write(dir.path(), &all);
    let entry = |k: usize| serde_json::json!({"file": format!("{}.glb", all[k].name), "source": format!("s{}", k % 4)});
    std::fs::write(
        dir.path().join("manifest.json"),
        serde_json::to_vec(&(0..12).map(entry).collect::<Vec<_>>()).unwrap(),
    )
    .unwrap();
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.split.by = SplitBy::Source;
    run(dir.path(), out.path(), &config).unwrap();
    let corpus = Corpus::open(&out.path().join("corpus.h5")).unwrap();
    let of = |split: &str| -> std::collections::BTreeSet<String> {
        let (splits, sources) = (corpus.texts("split").unwrap(), corpus.texts("source").unwrap());
        splits.into_iter().zip(sources).filter(|(s, _)| s == split).map(|(_, s)| s).collect()
    };
    assert!(of("test_new").len() == 1 && of("test_new").is_disjoint(&of("train")));
    drop(corpus);
    let list = out.path().join("split.json");
    std::fs::write(&list, format!(r#"{{"mine": ["{}.glb"]}}"#, all[3].name)).unwrap();
    config.split.by = SplitBy::List;
    config.split.file = list.display().to_string();
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!((funnel.splits["mine"], funnel.splits[""]), (1, 11));
}

#[test]
fn nothing_left_is_an_error_with_a_report() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(2));
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.bones.min = 5000;
    let error = run(dir.path(), out.path(), &config).unwrap_err();
    assert!(matches!(error, CurateError::NothingLeft { assets: 2, .. }), "{error}");
    assert!(Places::of(&out.path().join("corpus.h5")).report().is_file());
    assert!(!out.path().join("corpus.h5").exists());
}

#[test]
fn an_endpoint_that_is_down_leaves_rules_and_says_so() {
    let dir = tempfile::tempdir().unwrap();
    let mut all = creatures(3);
    all.iter_mut().for_each(|a| a.provenance.category = String::new());
    write(dir.path(), &all);
    let port = TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port();
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.categories.by = riglab_curate::Labeller::Vlm;
    config.categories.vlm.model = "seer".into();
    config.categories.vlm.url = format!("http://127.0.0.1:{port}/v1");
    config.categories.vlm.wait_s = 0.01;
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!(funnel.labelled_by["rules (no answer)"], 3);
    assert!(funnel.vlm.unwrap().gave_up);
    let told = funnel.warnings.join("; ");
    assert!(told.contains("`seer` named no category for 3 of 3 assets") && told.contains("does not answer"), "{told}");
    let corpus = Corpus::open(&out.path().join("corpus.h5")).unwrap();
    let notes = corpus.asset(0).unwrap().provenance.notes;
    assert!(notes.iter().any(|n| n.starts_with("category by rules (no answer): ")), "{notes:?}");
}

/// A server on this machine that says the same to everyone, and how often it was asked.
fn oracle(answer: &'static str) -> (String, Arc<AtomicUsize>) {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let (url, asked) = (format!("http://{}/v1", listener.local_addr().unwrap()), Arc::new(AtomicUsize::new(0)));
    let count = asked.clone();
    std::thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            let (mut text, mut buffer) = (String::new(), [0; 1 << 16]);
            // The body is JSON on one line, and ends with its last bracket.
            while !text.ends_with('}') {
                let n = stream.read(&mut buffer).unwrap();
                text += &String::from_utf8_lossy(&buffer[..n]);
            }
            count.fetch_add(1, Ordering::SeqCst);
            let body = serde_json::json!({"choices": [{"message": {"content": answer}}]}).to_string();
            let head = format!("HTTP/1.1 200 OK\r\nContent-Length: {}\r\nConnection: close\r\n\r\n", body.len());
            let _ = stream.write_all((head + &body).as_bytes());
        }
    });
    (url, asked)
}

#[test]
fn a_model_names_what_no_source_names_and_is_asked_once() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(4);
    write(dir.path(), &all);
    let entry = serde_json::json!([{"file": format!("{}.glb", all[0].name), "category": "aquatic"}]);
    std::fs::write(dir.path().join("manifest.json"), entry.to_string()).unwrap();
    let (url, asked) = oracle("Arthropod");
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.categories.by = riglab_curate::Labeller::Vlm;
    config.categories.vlm.model = "seer".into();
    config.categories.vlm.url = url;
    config.categories.vlm.pixels = 32;
    let funnel = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!((funnel.labelled_by["vlm"], funnel.labelled_by["source"]), (3, 1));
    assert_eq!((funnel.categories["arthropod"], funnel.categories["aquatic"]), (3, 1));
    assert_eq!(asked.load(Ordering::SeqCst), 3);
    // Again, with what is wanted narrowed down: nothing is asked twice.
    config.categories.keep = vec![Category::Arthropod];
    let again = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!((again.kept, dropped(&again, "category").len()), (3, 1));
    assert_eq!((asked.load(Ordering::SeqCst), again.vlm.unwrap().cached), (3, 3));
}

#[test]
fn what_the_manifest_says_now_counts() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(2);
    write(dir.path(), &all);
    let names = [0, 1].map(|k| format!("{}.glb", all[k].name));
    let say = |category: &str| {
        let text = serde_json::json!([
            {"file": names[0], "category": category, "license": "MIT"}, {"file": names[1], "category": 7},
            {"file": "gone.glb"}
        ]);
        std::fs::write(dir.path().join("manifest.json"), text.to_string()).unwrap();
    };
    let out = tempfile::tempdir().unwrap();
    let path = out.path().join("corpus.h5");
    let category = || Corpus::open(&path).unwrap().texts("category").unwrap()[0].clone();
    let mut seen = Vec::new();
    for wanted in ["aquatic", "reptile"] {
        say(wanted);
        let funnel = run(dir.path(), out.path(), &plain()).unwrap();
        assert_eq!(category(), wanted);
        seen.push(std::fs::read_to_string(Places::of(&path).journal()).unwrap().lines().count());
        let told = funnel.warnings.join("; ");
        for part in ["1 entry is of a wrong form", "did you mean `licence`?", "not there: `gone.glb`"] {
            assert!(told.contains(part), "{part}: {told}");
        }
    }
    // The one file of which something else is said was looked at again.
    assert_eq!(seen[1], seen[0] + 2);
    say("plane");
    let told = run(dir.path(), out.path(), &plain()).unwrap().warnings.join("; ");
    assert!(told.contains("`plane` (1)"), "{told}");
}

#[cfg(unix)]
#[test]
fn a_name_that_is_no_utf8_is_curated_and_its_double_a_line() {
    use std::os::unix::ffi::OsStrExt;
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(3);
    write(dir.path(), &all);
    for (asset, name) in all[..2].iter().zip([b"a\xff.glb", b"a\xfe.glb"]) {
        let to = dir.path().join(std::ffi::OsStr::from_bytes(name));
        std::fs::rename(dir.path().join(format!("{}.glb", asset.name)), to).unwrap();
    }
    let out = tempfile::tempdir().unwrap();
    for _ in 0..2 {
        let funnel = run(dir.path(), out.path(), &plain()).unwrap();
        assert_eq!((funnel.assets, funnel.kept), (3, 2));
        let why = &funnel.stage("read").unwrap().dropped[0].1;
        assert!(why.contains("named alike"), "{why}");
    }
}

/// Writes an asset as a glTF with its buffer in a file of its own.
fn gltf(folder: &std::path::Path, asset: &riglab_core::Asset) -> std::path::PathBuf {
    let glb = riglab_asset::to_glb(asset);
    let number = |at: usize| u32::from_le_bytes(glb[at..at + 4].try_into().unwrap()) as usize;
    let end = 20 + number(12);
    let mut document: serde_json::Value = serde_json::from_slice(&glb[20..end]).unwrap();
    document["buffers"][0]["uri"] = "a.bin".into();
    std::fs::write(folder.join("a.gltf"), document.to_string()).unwrap();
    std::fs::write(folder.join("a.bin"), &glb[end + 8..end + 8 + number(end)]).unwrap();
    folder.join("a.bin")
}

#[test]
fn a_gltf_is_its_buffers_too() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(2);
    write(dir.path(), &all[1..]);
    let buffer = gltf(dir.path(), &all[0]);
    let out = tempfile::tempdir().unwrap();
    let path = out.path().join("corpus.h5");
    let of = |column: &str| {
        let corpus = Corpus::open(&path).unwrap();
        let at = corpus.names().unwrap().iter().position(|n| n == "a.gltf").unwrap();
        corpus.texts(column).unwrap()[at].clone()
    };
    assert_eq!(run(dir.path(), out.path(), &plain()).unwrap().kept, 2);
    let was = (of("digest"), of("checksum"));
    // A vertex moved a little: the text is the same.
    let mut bytes = std::fs::read(&buffer).unwrap();
    let at = (0..bytes.len()).step_by(4).find(|&at| {
        let x = f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        (0.1..1.0).contains(&x)
    });
    bytes[at.unwrap()] ^= 1;
    std::fs::write(&buffer, &bytes).unwrap();
    run(dir.path(), out.path(), &plain()).unwrap();
    assert!(of("digest") != was.0 && of("checksum") != was.1);
    std::fs::remove_file(&buffer).unwrap();
    for _ in 0..2 {
        let funnel = run(dir.path(), out.path(), &plain()).unwrap();
        assert_eq!((funnel.kept, dropped(&funnel, "read")), (1, vec!["a.gltf"]));
        let why = &funnel.stage("read").unwrap().dropped[0].1;
        assert!(why.contains("a.bin") && why.contains("missing"), "{why}");
    }
}

#[test]
fn a_shard_tells_of_its_own_files_alone() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(12));
    let out = tempfile::tempdir().unwrap();
    let mut decisions = Decisions::default();
    for k in 0..20 {
        let decision = Decision { verdict: Verdict::Accept, ..Decision::default() };
        decisions.set(&format!("gone{k}.glb"), "00", decision);
    }
    let mut config = plain();
    let path = out.path().join("d.tsv");
    decisions.write(&path).unwrap();
    config.decisions = path.display().to_string();
    let part = |number| {
        let shard = Shard { number, of: 2 };
        let funnel = run_shard(dir.path(), &out.path().join(format!("{number}.h5")), Some(shard), &config).unwrap();
        let told = funnel.warnings.into_iter().filter(|w| w.contains("is decided about")).count();
        (told, (0..20).filter(|k| shard.has(&format!("gone{k}.glb"))).count())
    };
    let (one, two) = (part(1), part(2));
    assert_eq!((one.0, two.0, one.0 + two.0), (one.1, two.1, 20));
}

#[test]
fn a_decision_is_about_no_copy_in_another_shard() {
    let dir = tempfile::tempdir().unwrap();
    let all = creatures(12);
    write(dir.path(), &all);
    let shard = |number| Shard { number, of: 2 };
    let own = format!("{}.glb", all[0].name);
    let of = 2 - u64::from(shard(1).has(&own));
    let copied = (0..).map(|k| format!("copy_{k}.glb")).find(|name| !shard(of).has(name)).unwrap();
    std::fs::copy(dir.path().join(&own), dir.path().join(&copied)).unwrap();
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    run(dir.path(), out.path(), &config).unwrap();
    let places = |name: &str| Places::of(&out.path().join(name));
    let lines = std::fs::read_to_string(places("corpus.h5").assets()).unwrap();
    let lines = lines.lines().map(|line| serde_json::from_str::<serde_json::Value>(line).unwrap());
    let digest =
        lines.filter(|a| a["name"] == copied).map(|a| a["digest"].as_str().unwrap().to_owned()).next().unwrap();
    let mut decisions = Decisions::default();
    decisions.set(&copied, &digest, Decision { verdict: Verdict::Reject, ..Decision::default() });
    let path = out.path().join("decisions.tsv");
    decisions.write(&path).unwrap();
    config.decisions = path.display().to_string();
    let whole = run(dir.path(), out.path(), &config).unwrap();
    assert_eq!((dropped(&whole, "decision"), whole.kept), (vec![copied.as_str()], all.len()));
    let kept = format!("`{own}` is kept, and is byte for byte `{copied}`, which a person rejected");
    assert!(whole.warnings.iter().any(|told| told.starts_with(&kept)), "{:?}", whole.warnings);
    let parts = [1, 2].map(|number| {
        let part = out.path().join(format!("part{number}.h5"));
        run_shard(dir.path(), &part, Some(shard(number)), &config).unwrap();
        part
    });
    let merge = |parts: &[PathBuf]| merge_shards(parts, &[], &places("merged.h5"), &config, &|_, _, _| ()).unwrap();
    assert_eq!(merge(&parts), whole);
    // The copy's part is not there, so nothing is known of it.
    let part = merge(&parts[of as usize - 1..of as usize]);
    assert!(dropped(&part, "decision").is_empty() && !part.warnings.iter().any(|told| told.contains(&copied)));
    assert!(Corpus::open(&places("merged.h5").out).unwrap().names().unwrap().contains(&own));
    // Once it is there no more, its file has another name.
    std::fs::remove_file(dir.path().join(&copied)).unwrap();
    assert_eq!(dropped(&run(dir.path(), out.path(), &config).unwrap(), "decision"), [own]);
}

#[test]
fn two_corpora_do_not_share_the_folder_beside_them() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(2));
    let out = tempfile::tempdir().unwrap();
    let path = |name: &str| out.path().join(name);
    let curate = |name: &str| run_shard(dir.path(), &path(name), None, &plain());
    curate("x.h5").unwrap();
    curate("x.h5").unwrap();
    for name in ["x.hdf5", "x"] {
        let said = curate(name).unwrap_err().to_string();
        assert!(
            said.contains(name) && said.contains("x.curation beside it is that of") && said.contains("x.h5"),
            "{said}"
        );
    }
    curate("part.h5").unwrap();
    let merge = |name: &str| merge_shards(&[path("part.h5")], &[], &Places::of(&path(name)), &plain(), &|_, _, _| ());
    assert!(matches!(merge("x.hdf5"), Err(CurateError::OfAnother { .. })));
    // Where that corpus is no more, the folder is nobody's.
    std::fs::remove_file(path("x.h5")).unwrap();
    merge("x.hdf5").unwrap();
    assert!(matches!(curate("x.h5"), Err(CurateError::OfAnother { .. })));
}

#[test]
fn how_files_were_read_is_kept_with_what_came_of_them() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(4));
    let out = tempfile::tempdir().unwrap();
    let mut config = plain();
    config.repair.control_bones = !config.repair.control_bones;
    let mut other = config.clone();
    other.import.virtual_root = true;
    let part = |number: usize, config: &CurateConfig| {
        let path = out.path().join(format!("part{number}.h5"));
        run_shard(dir.path(), &path, None, config).unwrap();
        path
    };
    let merged = Places::of(&out.path().join("merged.h5"));
    let kept = |second: &CurateConfig| {
        merge_shards(&[part(1, &config), part(2, second)], &[], &merged, &plain(), &|_, _, _| ()).unwrap();
        Reading::of(&merged)
    };
    assert_eq!(kept(&config), Some(Reading { import: config.import.clone(), repair: config.repair.clone() }));
    assert_eq!(kept(&other), None);
}

#[test]
fn a_damaged_shard_is_not_merged() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(4));
    let out = tempfile::tempdir().unwrap();
    let part = out.path().join("part.h5");
    run_shard(dir.path(), &part, None, &plain()).unwrap();
    // A coordinate that is nowhere else.
    let corpus = Corpus::open(&part).unwrap();
    let vertex = corpus.asset(0).unwrap().rig.mesh().positions()[0];
    drop(corpus);
    let mut bytes = std::fs::read(&part).unwrap();
    let wanted: Vec<u8> = vertex.iter().flat_map(|x| x.to_le_bytes()).collect();
    let at = bytes.windows(12).position(|w| w == wanted).unwrap();
    bytes[at] ^= 1;
    std::fs::write(&part, &bytes).unwrap();
    let merged = Places::of(&out.path().join("merged.h5"));
    let said = merge_shards(&[part], &[], &merged, &plain(), &|_, _, _| ()).unwrap_err().to_string();
    assert!(said.contains("part.h5") && said.contains("damaged"), "{said}");
    assert!(!merged.out.exists());
}

#[cfg(unix)]
#[test]
fn a_link_that_leads_in_a_circle_is_a_line() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(2));
    std::os::unix::fs::symlink(dir.path(), dir.path().join("again")).unwrap();
    let out = tempfile::tempdir().unwrap();
    let funnel = run(dir.path(), out.path(), &plain()).unwrap();
    assert_eq!((dropped(&funnel, "read"), funnel.kept), (vec!["again"], 2));
    let parts = |dir: &std::path::Path| {
        [1, 2].map(|number| {
            let path = out.path().join(format!("part{number}.h5"));
            let _ = run_shard(dir, &path, Some(Shard { number, of: 2 }), &plain());
            path
        })
    };
    let merge = |parts: &[PathBuf]| {
        merge_shards(parts, &[], &Places::of(&out.path().join("merged.h5")), &plain(), &|_, _, _| ()).unwrap()
    };
    assert_eq!(merge(&parts(dir.path())), funnel);
    // What has gone since is in no part any more.
    std::fs::remove_file(dir.path().join("again")).unwrap();
    std::fs::remove_file(dir.path().join(format!("{}.glb", creatures(1)[0].name))).unwrap();
    let merged = merge(&parts(dir.path()));
    assert_eq!((merged.assets, merged.kept), (1, 1));
}

#[test]
fn records_are_small() {
    let dir = tempfile::tempdir().unwrap();
    write(dir.path(), &creatures(1));
    let out = tempfile::tempdir().unwrap();
    run(dir.path(), out.path(), &plain()).unwrap();
    let journal = std::fs::read_to_string(Places::of(&out.path().join("corpus.h5")).journal()).unwrap();
    let line = journal.lines().nth(1).unwrap();
    let record: serde_json::Value = serde_json::from_str(line).unwrap();
    let record: Record = serde_json::from_value(record["asset"].clone()).unwrap();
    assert!(line.len() < 4096 && record.facts.is_some(), "{}", line.len());
}
