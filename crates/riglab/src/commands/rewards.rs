//! `riglab rewards`

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Result, anyhow, bail};
use rayon::prelude::*;
use riglab_compare::{CompareError, Named, Truths};
use riglab_core::Rig;
use riglab_metric::statistics::{Mean, Paired};
use riglab_report::{Cell, PageKind, Table};
use riglab_reward::{Candidate, RewardConfig, Rewards, Scorer};
use riglab_train::Progress;
use serde::Serialize;
use serde_json::{Value, json};

use super::alike::by_reason;
use super::earlier::Written;
use super::forms::{Form, Forms, systems};
use crate::presets;

/// Judge rigs by the geometric rewards of GRPO, without true ones.
///
/// Every rig is judged on its own mesh (SkinTokens, section 3.4.1): joints near all of the body, bones inside it, every vertex
/// bound by at most four bones, a surface that stays whole in random poses. Of two systems whose files have the same names,
/// the differences are tested, rig by rig.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab rewards fox.glb
  riglab rewards out/ --assets                        # every rig, the worst first
  riglab rewards before=out/a after=out/b
  riglab rewards rigs.h5 --split test_new --config runs/grpo/001 -o rewards.csv

Training judges weights before small ones are cut and each vertex's add up to 1; a file holds them after it. So here
`skinning` is lowered only by vertices that no bone holds, or more than four.")]
pub struct Args {
    /// Rigged files, folders of them, or corpora; NAME=DIR names a system in the tables.
    #[arg(required = true, value_name = "[NAME=]DIR")]
    systems: Vec<String>,
    /// Of a corpus, this split alone.
    #[arg(long)]
    split: Option<String>,
    /// Judge by the `[reward]` of an experiment, or of a run's folder, instead of the paper's values.
    #[arg(long, value_name = "EXPERIMENT")]
    config: Option<String>,
    /// Change a setting of the rewards, as in experiments: `--set reward.weights.motion=0`.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Show every rig, the worst first, instead of means.
    #[arg(long)]
    assets: bool,
    #[command(flatten)]
    forms: Forms,
}

/// A rig and what it is worth.
#[derive(Debug, Serialize)]
struct ScoredRig {
    name: String,
    joints: usize,
    vertices: usize,
    #[serde(flatten)]
    rewards: Rewards,
}

/// The rigs of a system.
#[derive(Debug, Serialize)]
struct System {
    name: String,
    from: PathBuf,
    rigs: Vec<ScoredRig>,
    /// What cannot be judged, and why.
    unread: Vec<(String, String)>,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let files = args.forms.files(Written::Rewards)?;
    let config = settings(args.config.as_deref(), &args.sets)?;
    let mut found = Vec::new();
    for (name, path) in systems(&args.systems)? {
        let rigs = Truths::open(&path, args.split.as_deref()).map_err(unjudged)?;
        rigs.notes.iter().for_each(|note| tell!("note: {note}"));
        found.push((name, path, rigs));
    }
    // A file may hold many.
    let total = found.iter().map(|(.., rigs)| rigs.len() as u64).sum();
    let mut progress = Progress::new("judging", total, 0);
    let mut done = 0;
    let mut tick = |more: usize| {
        done += more as u64;
        progress.set(total.min(done), String::new);
    };
    let systems: Vec<System> = found
        .into_iter()
        .map(|(name, from, rigs)| {
            let (rigs, unread) = judge(&rigs, &config, &mut tick);
            System { name, from, rigs, unread }
        })
        .collect();
    progress.finish();
    for System { name, unread, .. } in &systems {
        by_reason(&format!("warning: {name}: not judged: "), unread).0.iter().for_each(|line| tell!("{line}"));
    }
    args.forms.write(&files, |form| text(form, &systems, &config, args.assets))?;
    let any = systems.iter().any(|system| !system.rigs.is_empty());
    Ok(if any { ExitCode::SUCCESS } else { ExitCode::FAILURE })
}

/// Why nothing can be judged: no rig is compared with another here.
fn unjudged(e: CompareError) -> anyhow::Error {
    match e {
        CompareError::NoTruth(path, why) => anyhow!("{}: no rig to judge{why}", path.display()),
        e => e.into(),
    }
}

/// The rewards that an experiment or a run's folder asks for, or the paper's, with changes.
fn settings(config: Option<&str>, sets: &[String]) -> Result<RewardConfig> {
    if let Some(other) = sets.iter().find(|set| !set.starts_with("reward.")) {
        bail!("--set {other}: settings of rewards begin with `reward.`, such as reward.weights.motion=0");
    }
    let loaded = match config {
        Some(name) => {
            let run = PathBuf::from(name).join("config.toml");
            let file = run.to_str().filter(|_| run.is_file()).unwrap_or(name);
            // Changes alone make no rewards of an experiment that has none.
            if !presets::load(file, &[])?.contains("reward") {
                bail!("{name} has no [reward] to judge by: give an experiment or a run of task grpo");
            }
            presets::load(file, sets)?
        }
        None => presets::parse("--set", "", sets)?,
    };
    if !loaded.contains("reward") {
        return Ok(RewardConfig::default());
    }
    let own: RewardConfig = loaded.get_at("reward")?;
    own.validate().map_err(|(key, message)| loaded.invalid(&format!("reward.{key}"), message))?;
    Ok(own)
}

/// What rigs are worth, and which cannot be judged.
fn judge(rigs: &Truths, config: &RewardConfig, tick: &mut dyn FnMut(usize)) -> (Vec<ScoredRig>, Vec<(String, String)>) {
    let (mut judged, mut unread) = (Vec::new(), rigs.unread.clone());
    rigs.each(|some: Vec<Named>| {
        // A few at a time, so that there is progress to show.
        for few in some.chunks(rayon::current_num_threads()) {
            let of = |(name, asset): &Named| match asset {
                Ok(asset) => Ok(one(name, &asset.rig, config)),
                Err(why) => Err((name.clone(), why.clone())),
            };
            for own in few.par_iter().map(of).collect::<Vec<_>>() {
                match own {
                    Ok(own) => judged.push(own),
                    Err(own) => unread.push(own),
                }
            }
            tick(few.len());
        }
        ControlFlow::Continue(())
    });
    (judged, unread)
}

fn one(name: &str, rig: &Rig, config: &RewardConfig) -> ScoredRig {
    let rewards = Scorer::new(rig.mesh(), config).score(&Candidate::of(rig));
    ScoredRig { name: name.into(), joints: rig.skeleton().len(), vertices: rig.mesh().positions().len(), rewards }
}

/// What was asked for, in a form.
fn text(form: Form, systems: &[System], config: &RewardConfig, assets: bool) -> Result<String> {
    match form {
        Form::Json => return Ok(serde_json::to_string_pretty(&to_json(systems, config))? + "\n"),
        Form::Csv => return Ok(every(systems, config).to_csv()),
        _ => {}
    }
    let mut tables = vec![means(systems, config)];
    if assets {
        tables.push(every(systems, config));
    }
    tables.extend(pairs(systems).map(|pairs| differences(systems, &pairs)));
    let names: Vec<&str> = systems.iter().map(|system| system.name.as_str()).collect();
    form.of(tables, PageKind::Rewards, "Rewards", &names.join(", "))
}

/// Digits after the point.
const DIGITS: usize = 4;

/// The total and its parts, as columns are headed.
fn heads() -> impl Iterator<Item = &'static str> {
    std::iter::once("R").chain(Rewards::PARTS.iter().map(|part| part.name))
}

/// The total and its parts.
fn figures(rewards: &Rewards) -> Vec<f64> {
    std::iter::once(rewards.total).chain(rewards.parts()).collect()
}

/// A row a system.
fn means(systems: &[System], config: &RewardConfig) -> Table {
    let head: Vec<&str> = ["system", "rigs", "not judged"].into_iter().chain(heads()).collect();
    let mut table = Table::new("Rewards: means over rigs", &[&head[..], &["95 % of R", "lowest R", "of"]].concat());
    for System { name, rigs, unread, .. } in systems {
        let mut row = vec![Cell::text(name), Cell::count(rigs.len()), Cell::count(unread.len())];
        let column = |k: usize| rigs.iter().map(|rig| figures(&rig.rewards)[k]).collect::<Vec<f64>>();
        let totals = Mean::of(&column(0));
        row.extend((0..heads().count()).map(|k| Cell::number(Mean::of(&column(k)).mean, DIGITS)));
        row.push(interval(totals.low, totals.high));
        let lowest = rigs.iter().min_by(|a, b| a.rewards.total.total_cmp(&b.rewards.total));
        row.push(Cell::number(lowest.map_or(f64::NAN, |rig| rig.rewards.total), DIGITS));
        row.push(Cell::text(lowest.map_or("", |rig| &rig.name)));
        table.row(row);
    }
    let asked = Rewards::PARTS.iter().map(|part| format!("{} ({}): {}", part.name, part.symbol, part.asks));
    table.note = format!("{}; {}.", total(config), asked.collect::<Vec<_>>().join("; "));
    table
}

/// What R is.
fn total(config: &RewardConfig) -> String {
    let weighted = config.weights.named().filter(|(_, weight)| *weight != 0.0);
    let terms = weighted.map(|(name, weight)| if weight == 1.0 { name.into() } else { format!("{weight} {name}") });
    let most: f64 = config.weights.all().iter().sum();
    format!("R = {}, at most {most}", terms.collect::<Vec<String>>().join(" + "))
}

/// A row a rig, the worst of each system first.
fn every(systems: &[System], config: &RewardConfig) -> Table {
    let head: Vec<&str> = ["system", "rig", "joints", "vertices"].into_iter().chain(heads()).collect();
    let mut table = Table::new("Rewards: rigs, the worst first", &head);
    for System { name, rigs, .. } in systems {
        let mut sorted: Vec<&ScoredRig> = rigs.iter().collect();
        sorted.sort_by(|a, b| a.rewards.total.total_cmp(&b.rewards.total));
        for rig in sorted {
            let mut row = vec![Cell::text(name), Cell::text(&rig.name)];
            row.extend([rig.joints, rig.vertices].map(Cell::count));
            row.extend(figures(&rig.rewards).into_iter().map(|x| Cell::number(x, DIGITS).with_digits(x.to_string())));
            table.row(row);
        }
        table.line();
    }
    table.note = format!("{}.", total(config));
    table
}

/// Of two systems, the rigs of the same name: the first's and the second's.
fn pairs(systems: &[System]) -> Option<Vec<[&Rewards; 2]>> {
    let [a, b] = systems else { return None };
    let [of_a, of_b] = [a, b].map(|system| system.rigs.iter().map(|rig| rig.name.as_str()).collect::<Vec<_>>());
    let both = |(k, other): (usize, usize)| [&a.rigs[k].rewards, &b.rigs[other].rewards];
    let pairs: Vec<_> = riglab_compare::pairs(&of_a, &of_b).into_iter().map(both).collect();
    (!pairs.is_empty()).then_some(pairs)
}

/// Of each reward, second minus first.
fn tests(pairs: &[[&Rewards; 2]]) -> Vec<(&'static str, Paired)> {
    let column = |side: usize, k: usize| pairs.iter().map(|pair| figures(pair[side])[k]).collect::<Vec<f64>>();
    heads().enumerate().map(|(k, name)| (name, Paired::of(&column(1, k), &column(0, k)))).collect()
}

fn differences(systems: &[System], pairs: &[[&Rewards; 2]]) -> Table {
    let caption = format!("{} minus {}, rig by rig", systems[1].name, systems[0].name);
    let mut table = Table::new(caption, &["reward", "rigs", "difference", "95 % interval", "p", "better", "worse"]);
    for (name, test) in tests(pairs) {
        let [worse, _, better] = test.smaller_equal_larger;
        let p = Cell::number(test.p, DIGITS);
        table.row(vec![
            Cell::text(name),
            Cell::count(test.n),
            Cell::difference(test.difference, DIGITS),
            interval(test.low, test.high),
            p,
            Cell::count(better),
            Cell::count(worse),
        ]);
    }
    table.note =
        "Above 0 the latter is better. p: sign flips of the differences, as in `riglab compare`. Rigs that only one \
                  system has are left out."
            .into();
    table
}

fn interval(low: f64, high: f64) -> Cell {
    let text = |x: f64| Cell::number(x, DIGITS).text;
    Cell::none().with_text(if low.is_finite() { format!("{} .. {}", text(low), text(high)) } else { "–".into() })
}

fn to_json(systems: &[System], config: &RewardConfig) -> Value {
    let mean = |system: &System| {
        let all: Vec<Rewards> = system.rigs.iter().map(|rig| rig.rewards).collect();
        let mut own = json!(system);
        own["mean"] = json!(Rewards::mean(&all));
        own
    };
    let mut out = json!({ "reward": config, "systems": systems.iter().map(mean).collect::<Vec<_>>() });
    if let Some(pairs) = pairs(systems) {
        let tests = tests(&pairs).into_iter().map(|(name, test)| (name.to_owned(), json!(test)));
        out["second_minus_first"] = tests.collect::<serde_json::Map<_, _>>().into();
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn system(name: &str, rigs: &[(&str, f64)]) -> System {
        let of = |&(name, coverage): &(&str, f64)| ScoredRig {
            name: name.into(),
            joints: 3,
            vertices: 8,
            rewards: Rewards::of([coverage, 0.5, 1.0, 0.25], RewardConfig::default().weights.all()),
        };
        let unread = vec![("odd.glb".into(), "it holds no skeleton".into())];
        System { name: name.into(), from: name.into(), rigs: rigs.iter().map(of).collect(), unread }
    }

    #[test]
    fn the_papers_rewards_are_those_without_settings() {
        assert_eq!(settings(None, &[]).unwrap(), RewardConfig::default());
        let own = settings(None, &["reward.weights.motion=0".into(), "reward.resolution=32".into()]).unwrap();
        assert_eq!((own.weights.all(), own.resolution), ([5.0, 1.0, 1.0, 0.0], 32));
        let quick = settings(Some("skintokens/grpo_quick.toml"), &[]).unwrap();
        assert_eq!(settings(Some("skintokens/grpo_quick.toml"), &["reward.beta=0.2".into()]).unwrap().beta, 0.2);
        assert!(quick.resolution > 0);
    }

    #[test]
    fn wrong_settings_are_refused_where_they_were_written() {
        let of = |config: Option<&str>, set: &str| settings(config, &[set.into()]).unwrap_err().to_string();
        assert!(of(None, "train.steps=3").contains("begin with `reward.`"));
        assert!(of(None, "reward.mution=3").contains("mution"));
        assert!(of(None, "reward.poses=0").contains("reward.poses"));
        for sets in [&[][..], &["reward.beta=0.2".to_owned()]] {
            let said = settings(Some("quickstart/tokenrig.toml"), sets).unwrap_err().to_string();
            assert!(said.contains("has no [reward]") && said.contains("task grpo"), "{said}");
        }
    }

    #[test]
    fn means_name_the_worst_and_say_what_the_total_is() {
        let text = means(&[system("ours", &[("a.glb", 0.5), ("b.glb", 0.25)])], &RewardConfig::default()).to_text();
        for shown in [
            "ours",
            "3.6250",
            "0.3750",
            "3.0000",
            "b.glb",
            "R = 5 coverage + containment + skinning + motion, at most 8",
        ] {
            assert!(text.contains(shown), "{shown}: {text}");
        }
    }

    #[test]
    fn every_rig_is_a_row_the_worst_first() {
        let csv = every(&[system("ours", &[("a.glb", 0.5), ("b.glb", 0.25)])], &RewardConfig::default()).to_csv();
        let rows: Vec<&str> = csv.lines().collect();
        assert_eq!(rows[0], "system,rig,joints,vertices,R,coverage,containment,skinning,motion");
        assert_eq!(rows[1..3], ["ours,b.glb,3,8,3,0.25,0.5,1,0.25", "ours,a.glb,3,8,4.25,0.5,0.5,1,0.25"]);
    }

    #[test]
    fn two_systems_are_tested_on_rigs_of_the_same_name() {
        let two = [
            system("before", &[("x/a.glb", 0.5), ("x/b.glb", 0.25), ("c.glb", 0.0)]),
            system("after", &[("x/a.fbx", 0.75), ("x/b.fbx", 0.5), ("d.fbx", 1.0)]),
        ];
        let found = pairs(&two).unwrap();
        assert_eq!(found.len(), 2);
        let (name, test) = tests(&found)[0];
        assert_eq!((name, test.n, test.difference), ("R", 2, 1.25));
        assert!(differences(&two, &found).to_text().contains("after minus before"));
        // Names that are the same come before those that are so without what systems add.
        let exact = ["before", "after"].map(|name| system(name, &[("a.glb", 0.5), ("a_skeleton.glb", 0.25)]));
        assert_eq!(pairs(&exact).unwrap().len(), 2);
        assert!(tests(&pairs(&exact).unwrap()).iter().all(|(_, test)| test.difference == 0.0));
        // One system, three of them, and none in common.
        assert!(pairs(&two[..1]).is_none());
        assert!(pairs(&[system("a", &[("a.glb", 0.5)]), system("b", &[("b.glb", 0.5)])]).is_none());
        let twice = [system("a", &[("a.glb", 0.5)]), system("b", &[("a.glb", 0.5), ("a.fbx", 0.25)])];
        assert!(pairs(&twice).is_none());
        let [one, two] = twice;
        assert!(pairs(&[two, one]).is_none());
    }
}
