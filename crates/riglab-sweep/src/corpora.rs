//! The corpora that runs read: what comes of different ones is not put side by side without a word.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde_json::Value;

use crate::state::info;
use crate::values::evaluation;
use crate::{Job, Plan, Results, State, SweepError, attempts};

/// Corpora by path and checksum.
pub(crate) type Corpora = BTreeSet<(String, String)>;

/// What a run was trained on, by its `run.json`.
pub(crate) fn trained_on(info: &Value) -> Corpora {
    listed(info, |_| true)
}

/// What a run was evaluated on, by its `eval.json`: the corpora that have assets of it, as far as it says how many.
pub(crate) fn looked_at(evaluation: &Value) -> Corpora {
    listed(evaluation, |corpus| corpus[3] != 0)
}

fn listed(of: &Value, counts: impl Fn(&&Value) -> bool) -> Corpora {
    let word = |v: &Value| v.as_str().unwrap_or_default().to_owned();
    let all = of["data"].as_array().into_iter().flatten();
    all.filter(counts).map(|d| (word(&d[0]), word(&d[1]))).collect()
}

impl Plan {
    /// Whether jobs that are still to be done, with those that failed and are begun `again`, find the corpora that others
    /// have read. `now` gives those that a job would read, by path and checksum, as far as they are there. Writes nothing.
    ///
    /// # Errors
    /// When one has changed; what `now` has for an error.
    pub fn same_corpora(
        &self,
        folder: &Path,
        again: impl Fn(&Job) -> bool,
        mut now: impl FnMut(&Job) -> Result<Vec<(String, String)>, SweepError>,
    ) -> Result<(), SweepError> {
        let failed = attempts(folder);
        let mut before = BTreeMap::new();
        for job in &self.jobs {
            let run = folder.join(&job.folder);
            let evaluated = match State::of(folder, self, job, &failed) {
                // Of one that failed nothing is in the table.
                State::Failed(_) => continue,
                State::Finished => listed(&evaluation(&run).unwrap_or_default(), |_| true),
                // An evaluation of before, which does not count, is made again.
                _ => Corpora::new(),
            };
            for (path, sum) in trained_on(&info(&run)).into_iter().chain(evaluated) {
                before.entry(path).or_insert((sum, job));
            }
        }
        if before.is_empty() {
            return Ok(());
        }
        for job in self.left(folder, again) {
            for (corpus, sum) in now(job)? {
                let Some((other, by)) = before.get(&corpus).filter(|(other, _)| *other != sum) else { continue };
                let (read, left) = (by.shown(), job.shown());
                return Err(SweepError::Corpus { corpus, read, before: short(other), left, after: short(&sum) });
            }
        }
        Ok(())
    }
}

impl Results {
    /// Sentences where the finished runs did not all learn from the same corpora, or were not all evaluated on the same ones,
    /// which they are by their checksums.
    pub fn mixed(&self) -> Vec<String> {
        let said = |what: &str, groups: String| format!("not all runs {what} the same corpora: {groups}");
        match (self.training_groups(), self.evaluation_groups()) {
            (Some(trained), Some(evaluated)) if trained == evaluated => vec![said("are of", trained)],
            (trained, evaluated) => {
                let trained = trained.map(|groups| said("learned from", groups));
                trained.into_iter().chain(evaluated.map(|groups| said("were evaluated on", groups))).collect()
            }
        }
    }

    /// Whether runs learned from different corpora because their settings say so, none of which has changed since.
    pub fn is_meant(&self) -> bool {
        let all = self.numbers.iter().flat_map(|numbers| &numbers.trained_on);
        let different: BTreeSet<&(String, String)> = all.collect();
        let paths: BTreeSet<&str> = different.iter().map(|(path, _)| path.as_str()).collect();
        self.evaluation_groups().is_none() && paths.len() == different.len()
    }

    /// The runs by what they learned from, where that is not the same for all.
    pub fn training_groups(&self) -> Option<String> {
        self.groups(self.numbers.iter().map(|numbers| &numbers.trained_on))
    }

    /// The runs by what they were evaluated on, where that is not the same for all.
    pub fn evaluation_groups(&self) -> Option<String> {
        self.groups(self.numbers.iter().map(|numbers| &numbers.evaluated_on))
    }

    /// The runs by corpora, where these are not the same for all. `of`: each job's, none where it does not say.
    fn groups<'a>(&'a self, of: impl Iterator<Item = &'a Corpora>) -> Option<String> {
        let mut groups: Vec<(BTreeSet<&String>, usize, &Corpora, &Job)> = Vec::new();
        // Old runs may not say it.
        let known = self.plan.jobs.iter().zip(of);
        let known = known.filter(|(_, corpora)| !corpora.is_empty());
        for (job, corpora) in known {
            let sums: BTreeSet<&String> = corpora.iter().map(|(_, sum)| sum).collect();
            match groups.iter_mut().find(|(own, ..)| *own == sums) {
                Some((_, count, ..)) => *count += 1,
                None => groups.push((sums, 1, corpora, job)),
            }
        }
        let of = |(_, count, corpora, job): &(BTreeSet<&String>, usize, &Corpora, &Job)| {
            let corpora = corpora.iter().map(|(path, sum)| format!("{path} ({})", short(sum))).collect::<Vec<_>>();
            let more = if *count > 1 { format!(" and {} more", count - 1) } else { String::new() };
            format!("{}{more} of {}", job.shown(), corpora.join(", "))
        };
        let groups: Vec<String> = groups.iter().map(of).collect();
        (groups.len() > 1).then(|| groups.join("; "))
    }
}

pub(crate) fn short(sum: &str) -> String {
    sum.chars().take(12).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_of_a_corpus_that_changed_are_refused_or_named() {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2, 3, 4]\nevaluate = true\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        let trained = |seed: usize, sum: &str, outcome: &str| {
            let run = dir.path().join(&plan.jobs[seed - 1].folder);
            std::fs::create_dir_all(&run).unwrap();
            let info = format!("{{\"outcome\": \"{outcome}\", \"data\": [[\"c.h5\", \"{sum}\", 12]]}}");
            std::fs::write(run.join("run.json"), info).unwrap();
        };
        let evaluated = |seed: usize, sum: &str| {
            let path = dir.path().join(&plan.jobs[seed - 1].folder).join("eval.json");
            std::fs::write(path, format!("{{\"data\": [[\"c.h5\", \"{sum}\", 12]]}}")).unwrap();
        };
        let check = |sum: &str, retry: bool| {
            plan.same_corpora(
                dir.path(),
                |_| retry,
                |_| Ok(vec![("c.h5".into(), sum.into()), ("d.h5".into(), "9".into())]),
            )
        };
        let mixed = || Results::read(dir.path(), &plan).mixed();
        plan.same_corpora(dir.path(), |_| false, |_| panic!("nothing was read yet")).unwrap();
        // A run that failed has nothing in the table.
        trained(4, "0000", "no room");
        for _ in 0..2 {
            let failed = crate::Attempt { job: 3, stage: "train".into(), reason: "x".into(), given_up: false };
            crate::record(dir.path(), &failed).unwrap();
        }
        check("aaaabbbbccccdddd", false).unwrap();
        trained(1, "aaaabbbbccccdddd", "finished");
        check("aaaabbbbccccdddd", false).unwrap();
        let said = check("eeeeffff0000", false).unwrap_err().to_string();
        let wanted = "c.h5 has changed: `base`, seed 1 read it when its checksum was aaaabbbbcccc, and `base`, seed 1 would \
                      read it with eeeeffff0000; put the old file back, or give the sweep a folder of its own with -o";
        assert_eq!(said, wanted, "trained, and still to be evaluated");
        evaluated(1, "aaaabbbbccccdddd");
        let said = check("eeeeffff0000", false).unwrap_err().to_string();
        assert!(said.contains("and `base`, seed 2 would read it with eeeeffff0000"), "{said}");
        assert!(mixed().is_empty());
        for seed in [2, 3] {
            trained(seed, "eeeeffff0000", "finished");
            evaluated(seed, "eeeeffff0000");
        }
        check("1111", false).unwrap();
        assert!(check("1111", true).unwrap_err().to_string().contains("and `base`, seed 4 would read it with 1111"));
        let said = mixed().remove(0);
        let wanted = "not all runs are of the same corpora: `base`, seed 1 of c.h5 (aaaabbbbcccc); `base`, seed 2 and 1 \
                      more of c.h5 (eeeeffff0000)";
        assert_eq!(said, wanted);
        let results = Results::read(dir.path(), &plan);
        assert!(
            results.table().note.ends_with(&format!("{}.", said.replacen('n', "N", 1))),
            "{}",
            results.table().note
        );
        // What was evaluated on the same is another matter than what learned from the same.
        evaluated(3, "aaaabbbbccccdddd");
        let [trained, tested] = &mixed()[..] else { panic!("{:?}", mixed()) };
        assert!(trained.starts_with("not all runs learned from the same corpora: `base`, seed 1 of"), "{trained}");
        assert!(trained.contains("; `base`, seed 2 and 1 more of"), "{trained}");
        let wanted = "not all runs were evaluated on the same corpora: `base`, seed 1 and 1 more of c.h5 (aaaabbbbcccc); \
                      `base`, seed 2 of c.h5 (eeeeffff0000)";
        assert_eq!(tested, wanted);
        evaluated(2, "aaaabbbbccccdddd");
        assert_eq!(mixed(), std::slice::from_ref(trained));
        let mut results = Results::read(dir.path(), &plan);
        assert!(!results.is_meant(), "one corpus that has changed");
        results.numbers[0].trained_on = [("other.h5".to_owned(), "99".to_owned())].into();
        assert!(results.is_meant());
        // A corpus without a test asset is none of the evaluation's.
        let path = dir.path().join(&plan.jobs[2].folder).join("eval.json");
        std::fs::write(path, r#"{"data": [["c.h5", "aaaabbbbccccdddd", 12, 3], ["d.h5", "99", 7, 0]]}"#).unwrap();
        assert_eq!(mixed(), std::slice::from_ref(trained));
        // What evaluations saw that are to be made again is no word on what they see then.
        let path = dir.path().join(&plan.jobs[0].folder).join("eval.json");
        std::fs::write(path, r#"{"data": [["t.h5", "1", 3, 1]]}"#).unwrap();
        let now = |plan: &Plan| plan.same_corpora(dir.path(), |_| true, |_| Ok(vec![("t.h5".into(), "2".into())]));
        assert!(now(&plan).unwrap_err().to_string().starts_with("t.h5 has changed"));
        let mut other = plan.clone();
        other.sweep.evaluate_with.insert("data.test".into(), vec!["a"].into());
        now(&other).unwrap();
    }
}
