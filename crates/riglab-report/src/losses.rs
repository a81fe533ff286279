//! Whether the losses of several runs are sums of the same parts with the same weights.
//!
//! A total is a number of its own weights: under others it is higher or lower without being worse or better. What is
//! comparable then are the parts, which are logged without their weights.

use std::collections::{BTreeMap, BTreeSet};

use riglab_config::Config;

/// What several runs minimise, by their resolved configs.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Losses {
    /// Settings in which they differ and that decide what the total is; none where totals are comparable.
    pub apart: Vec<String>,
    /// Settings in which they differ and that decide what the reward is, where one is maximised.
    rewards: Vec<String>,
    /// Names under which a part of the loss may be logged.
    parts: BTreeSet<String>,
}

/// The table of a config that says what is minimised, and the one that says what the rewards are.
const TABLE: &str = "loss";
const REWARDS: &str = "reward";
/// What totals of rewards are logged as.
const TOTALS: [&str; 3] = ["reward", "guarded_reward", "start_reward"];

impl Losses {
    /// Of the texts of `config.toml`; one that cannot be read is passed over.
    pub fn of<'a>(configs: impl IntoIterator<Item = &'a str>) -> Self {
        let read = |text: &str| Config::from_toml_str("config.toml", text).ok();
        let table = |key: &str| key.split('.').next().unwrap_or_default().to_owned();
        let own = |key: &str| key == "task" || [TABLE, REWARDS].contains(&table(key).as_str());
        let leaves = |config: Config| config.leaves().into_iter().map(|leaf| (leaf.path, leaf.value));
        let all: Vec<BTreeMap<String, String>> =
            configs.into_iter().filter_map(read).map(|c| leaves(c).filter(|(key, _)| own(key)).collect()).collect();
        let keys: BTreeSet<&String> = all.iter().flat_map(BTreeMap::keys).collect();
        let differs = |key: &&&String| all.iter().any(|of| of.get(**key) != all[0].get(**key));
        let apart = keys.iter().filter(differs).map(|key| (*key).clone());
        let (rewards, apart) = apart.partition(|key| table(key) == REWARDS);
        let part = |key: &&String| Some(format!("train/{}", key.split('.').nth(1)?));
        let parts = keys.iter().filter(|key| table(key) == TABLE).filter_map(part).collect();
        Self { apart, rewards, parts }
    }

    /// Whether charts of what was logged under the name are called for beside the total's: it is a part of it, and the
    /// totals are not comparable.
    pub fn replaces(&self, name: &str) -> bool {
        !self.apart.is_empty() && self.parts.contains(name)
    }

    /// The settings by which a number is another quantity in each run, so that none of them is the best; `None` where it is
    /// comparable. It is named as in the log, or by its path in an evaluation.
    pub fn apart_in(&self, name: &str) -> Option<String> {
        match self.apart.as_slice() {
            _ if is_reward(name) => (!self.rewards.is_empty()).then(|| listed(&self.rewards)),
            [] => None,
            _ if name != "train/loss" => None,
            apart if apart.iter().any(|key| key == "task") => Some("task".into()),
            apart => Some(listed(apart)),
        }
    }

    /// What is said below a chart of something that was logged; nothing where there is nothing to say.
    pub fn note(&self, name: &str) -> String {
        match self.apart_in(name) {
            Some(by) if is_reward(name) => format!(
                "Not comparable between lines: rewards are defined differently ({by}). Compare the parts, where these are \
                 defined alike."
            ),
            Some(by) => format!(
                "Not comparable between lines: losses are defined differently ({by}). Compare parts and validation."
            ),
            None if self.replaces(name) => "As it was logged, without its weight in the loss.".into(),
            None => String::new(),
        }
    }
}

/// Whether a number is a total of rewards, or how much one has changed.
fn is_reward(name: &str) -> bool {
    let bare = name.split('@').next().and_then(|name| name.rsplit('/').next()).unwrap_or_default();
    // Of a path the keys: what stands in brackets are conditions.
    let outside = |part: &'_ str| part.rsplit(']').next().unwrap_or_default().to_owned();
    let keys: Vec<String> = name.split('[').map(outside).collect();
    let keys: Vec<&str> = keys.iter().flat_map(|part| part.split(['.', ':'])).filter(|key| !key.is_empty()).collect();
    TOTALS.contains(&bare) || keys.contains(&"reward") || keys.ends_with(&["rewards", "total"])
}

/// The first of some settings, and how many more there are.
fn listed(keys: &[String]) -> String {
    match keys {
        [] => String::new(),
        [first] => first.clone(),
        [first, others @ ..] => format!("{first} and {} more", others.len()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn totals_of_other_weights_are_told_from_those_of_the_same() {
        let config = |dice: &str, seed: u64| {
            format!(
                "task = 't'\n[train]\nseed = {seed}\n[loss]\nbce = 1.0\ndice = {dice}\n[loss.physics]\nweight = 5.0\n"
            )
        };
        let of = |texts: &[String]| Losses::of(texts.iter().map(String::as_str));
        let same = of(&[config("0.5", 1), config("0.5", 2)]);
        assert!(same.apart.is_empty() && !same.replaces("train/dice"));
        assert_eq!((same.note("train/loss"), same.note("train/dice")), (String::new(), String::new()));
        let other = of(&[config("0.5", 1), config("2.0", 1), config("0.5", 1)]);
        assert_eq!(other.apart, ["loss.dice"]);
        let shown = ["train/bce", "train/dice", "train/physics"];
        assert!(shown.iter().all(|name| other.replaces(name)));
        assert!(["train/loss", "train/tokens", "eval/dice@val"].iter().all(|name| !other.replaces(name)));
        assert!(other.note("train/loss").starts_with("Not comparable between lines: "), "{}", other.note("train/loss"));
        assert!(other.note("train/loss").contains("(loss.dice)"));
        assert!(other.note("train/dice").contains("without its weight") && other.note("eval/iou@val").is_empty());
    }

    #[test]
    fn rewards_of_other_weights_are_told_without_a_word_of_the_loss() {
        let of = |weight: f64| Losses::of(["[reward]\nweights = [5.0]", &format!("[reward]\nweights = [{weight:?}]")]);
        let other = of(1.0);
        for name in ["eval/reward@val", "eval/guarded_reward@val"] {
            assert!(other.note(name).contains("rewards are defined differently (reward.weights)"), "{name}");
            assert!(of(5.0).note(name).is_empty());
        }
        for name in ["rows[skeletons.split=val].rewards.total", "gains[split=val].reward.mean"] {
            let path = format!("eval.json:report.{name}");
            assert_eq!((other.apart_in(&path), of(5.0).apart_in(&path)), (Some("reward.weights".into()), None));
        }
        for name in ["rows[skeletons.split=val].rewards.motion", "rows[of=reward].skeletons.j2j", "total"] {
            assert_eq!(other.apart_in(&format!("eval.json:report.{name}")), None, "{name}");
        }
        assert!(["train/loss", "eval/motion@val"].iter().all(|name| other.note(name).is_empty()));
        assert!(other.apart.is_empty() && !other.replaces("train/weights"));
    }

    #[test]
    fn other_tasks_have_other_losses_and_what_is_no_config_is_passed_over() {
        let of = |texts: &[&str]| Losses::of(texts.iter().copied());
        assert_eq!(of(&["task = 'a'", "task = 'b'\n[loss]\nx = 1"]).apart, ["loss.x", "task"]);
        assert!(of(&["task = 'a'", "task = 'b'\n[loss]\nx = 1"]).note("train/loss").contains("(task)"));
        let many = of(&["[loss]\na = 1\nb = 1\nc = 1", "[loss]\na = 2\nb = 2\nc = 2"]);
        assert!(many.note("train/loss").contains("(loss.a and 2 more)"));
        assert_eq!(of(&["task = 'a'", "[[["]), of(&["task = 'a'"]));
        assert_eq!(of(&[]), Losses::default());
    }
}
