//! Networks beside the trained ones: what was trained with other weights of the same name is not put side by side without
//! a word. A run that a config names may have been trained on while a sweep went on.

use std::collections::BTreeMap;
use std::path::Path;

use serde_json::Value;

use crate::corpora::short;
use crate::{Job, Results};

/// The key of the weights that a run began with; what it computes with beside its own has keys in `run.json`.
const START: &str = "train.start.from";

/// Weights that a run computed with or began with.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Companion {
    /// The key that names them.
    key: String,
    /// What it says.
    named: String,
    /// What took them: another network takes others of the same file.
    taken_by: String,
}

/// Their checksums.
pub(crate) type Companions = BTreeMap<Companion, String>;

/// Those of a run, by its `run.json` and its config.
pub(crate) fn companions(run: &Path, info: &Value) -> Companions {
    let config: toml::Table =
        std::fs::read_to_string(run.join("config.toml")).ok().and_then(|text| text.parse().ok()).unwrap_or_default();
    let value = |key: &str| {
        let mut steps = key.split('.');
        let first = config.get(steps.next()?)?;
        steps.try_fold(first, |table, step| table.get(step))
    };
    let named = |key: &str| value(key)?.as_str().map(str::to_owned);
    let network = ["train.start.parts", "model", "tokenizer"].map(|key| value(key).map(toml::Value::to_string));
    let network = network.into_iter().flatten().collect::<Vec<_>>().join(" ");
    let own = info["companions"].as_array().into_iter().flatten();
    let own = own.filter_map(|pair| Some((pair[0].as_str()?, pair[1].as_str()?)));
    let all = own.chain(info["start"].as_str().map(|sum| (START, sum)));
    let known = all.filter(|(_, sum)| !sum.is_empty());
    let of = |key: &str| Companion {
        key: key.to_owned(),
        named: named(key).unwrap_or_default(),
        taken_by: if key == START { network.clone() } else { String::new() },
    };
    known.map(|(key, sum)| (of(key), sum.to_owned())).collect()
}

impl Results {
    /// A sentence for each network that finished runs name alike and had with different weights, by their checksums.
    pub fn retrained(&self) -> Vec<String> {
        let mut found: BTreeMap<&Companion, Vec<(&str, usize, &Job)>> = BTreeMap::new();
        for (job, numbers) in self.plan.jobs.iter().zip(&self.numbers) {
            for (named, sum) in &numbers.companions {
                let groups = found.entry(named).or_default();
                match groups.iter_mut().find(|(own, ..)| own == sum) {
                    Some((_, count, _)) => *count += 1,
                    None => groups.push((sum, 1, job)),
                }
            }
        }
        let of = |(sum, count, job): &(&str, usize, &Job)| {
            let more = if *count > 1 { format!(" and {} more", count - 1) } else { String::new() };
            format!("{}{more} with {}", job.shown(), short(sum))
        };
        let several = found.into_iter().filter(|(_, groups)| groups.len() > 1);
        let sentence = |(Companion { key, named, .. }, groups): (&Companion, Vec<(&str, usize, &Job)>)| {
            let named = if named.is_empty() { String::new() } else { format!(" ({named})") };
            let groups: Vec<String> = groups.iter().map(of).collect();
            format!("not all runs had the same weights of `{key}`{named}: {}", groups.join("; "))
        };
        several.map(sentence).collect()
    }
}

#[cfg(test)]
mod tests {
    use crate::{Plan, Results};

    #[test]
    fn runs_beside_other_weights_of_the_same_name_are_told() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [0, 1, 2]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let put = |job: usize, skin: (&str, &str), start: &str| {
            let run = dir.path().join(&plan.jobs[job].folder);
            std::fs::create_dir_all(&run).unwrap();
            let config = format!("[skin]\nrun = '{}'\n[train.start]\nfrom = 'runs/first'\n", skin.0);
            std::fs::write(run.join("config.toml"), config).unwrap();
            let info = serde_json::json!({"outcome": "finished", "companions": [["skin.run", skin.1]], "start": start});
            std::fs::write(run.join("run.json"), info.to_string()).unwrap();
        };
        let said = || Results::read(dir.path(), &plan).retrained();
        // Arms may be about other networks; a version that did not know what a run began with says nothing of it.
        let (ae, own) = (("runs/ae", "0123456789abcdef"), ("runs/own", "fedcba9876543210"));
        (0..3).for_each(|job| put(job, ae, ""));
        (3..6).for_each(|job| put(job, own, "11112222333344445555"));
        assert!(said().is_empty());
        put(2, ("runs/ae", "aaaabbbbccccdddd"), "66667777888899990000");
        let wanted = [
            "not all runs had the same weights of `skin.run` (runs/ae): `a`, seed 0 and 1 more with 0123456789ab; \
             `a`, seed 2 with aaaabbbbcccc",
            "not all runs had the same weights of `train.start.from` (runs/first): `a`, seed 2 with 666677778888; \
             `b`, seed 0 and 2 more with 111122223333",
        ];
        assert_eq!(said(), wanted);
        // Another network takes others of the same file.
        let config = dir.path().join(&plan.jobs[2].folder).join("config.toml");
        let text = std::fs::read_to_string(&config).unwrap() + "[model]\nwidth = 3\n";
        std::fs::write(&config, text).unwrap();
        assert_eq!(said(), wanted[..1]);
        let note = Results::read(dir.path(), &plan).table().note;
        assert!(note.contains(&wanted[0].replacen('n', "N", 1)), "{note}");
    }
}
