//! What logged names mean that no table has as a head.

/// Of any task: names without what stands before and behind, and what is said of them.
const ANY: [(&str, &str); 3] = [
    ("j2j_all", "J2J of all assets, of which one whose skeleton cannot be compared counts as the cube's edge"),
    ("iou_rule", "IoU after the decode rule"),
    ("l1_rule", "L1 after the decode rule"),
];

/// Of GRPO, whose rewards have symbols in the paper.
const GRPO: [(&str, &str); 7] = [
    ("coverage", "R_vj"),
    ("containment", "R_vk"),
    ("skinning", "R_sc"),
    ("motion", "R_mo"),
    ("start_j2j", "j2j_all of the model that the run started from"),
    ("start_reward", "the reward of the model that the run started from"),
    ("guarded_reward", "the reward, where j2j_all has not worsened beyond guard.worse"),
];

/// Of UniRig's skin stage, whose batches seldom have a spring bone in them.
const UNIRIG_SKIN: [(&str, &str); 3] = [
    ("attributes", "the error of spring bones' attributes, 0 in steps whose rigs have no spring bones"),
    (
        "attributes_vs_mean",
        "that error as a multiple of what the mean of all these bones has; below 1 the network tells bones apart",
    ),
    ("physics", "how far what moves in a simulation is from where the true weights and attributes take it"),
];

/// What is said of a logged value, such as `eval/j2j_all@val`, of a task; nothing of those that say it by themselves.
pub fn explained(task: &str, name: &str) -> Option<&'static str> {
    let bare = bare(name);
    let own: &[_] = match task {
        "grpo" => &GRPO,
        "unirig_skin" => &UNIRIG_SKIN,
        _ => &[],
    };
    own.iter().chain(&ANY).find(|(known, _)| *known == bare).map(|(_, said)| *said)
}

/// The same of several as sentences; none for none.
pub(crate) fn glossary(task: &str, names: &[&str]) -> String {
    let mut said: Vec<String> = Vec::new();
    for name in names {
        let own = explained(task, name).map(|text| format!("{}: {text}.", bare(name)));
        said.extend(own.filter(|own| !said.contains(own)));
    }
    said.join(" ")
}

/// Without a unit behind it, either.
fn bare(name: &str) -> &str {
    let name = name.split('@').next().unwrap_or(name);
    let name = name.rsplit('/').next().unwrap_or(name);
    name.strip_suffix(crate::TIMES_100).unwrap_or(name)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_explained_by_task_wherever_they_were_logged() {
        let said = |task, name| explained(task, name).unwrap_or_default();
        assert!(["eval/j2j_all@val", "j2j_all@val", "eval/j2j_all × 100@val"].iter().all(|n| said("t", n).len() > 20));
        assert_eq!([said("grpo", "train/motion"), said("grpo", "eval/motion@val")], ["R_mo"; 2]);
        // A loss of its own there.
        assert_eq!([said("unirig_skin", "train/motion"), said("grpo", "eval/j2j@val")], [""; 2]);
        assert!(said("unirig_skin", "train/attributes").contains("0 in steps whose rigs have no spring bones"));
        assert_eq!(said("tokenrig", "train/attributes"), "");
        let all = ["eval/coverage@val", "eval/reward@val", "eval/skinning@val", "eval/coverage@val"];
        assert_eq!(glossary("grpo", &all), "coverage: R_vj. skinning: R_sc.");
    }
}
