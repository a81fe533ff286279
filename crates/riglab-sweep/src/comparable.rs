//! Columns that are other quantities at each point, such as a total of rewards under other weights, or of other assets, or of
//! assets that runs were trained on: they are shown, but neither ranked nor tested.

use riglab_report::counted;

use crate::values::{EVALUATION, Numbers};
use crate::{MetricOf, Results};

/// Why a column of other assets is none to rank by.
const OTHER: &str = "runs of other corpora";

/// Why a column of assets that a run was trained on is none to rank by.
const SEEN: &str = "assets that runs were trained on";

impl Results {
    /// These columns, each with the settings that make it so.
    pub(crate) fn not_comparable(&self) -> Option<String> {
        let reasons: Vec<Option<String>> = self.metrics.iter().map(|m| self.apart_in(m)).collect();
        if let Some(Some(first)) = reasons.first()
            && [OTHER, SEEN].contains(&first.as_str())
            && reasons.iter().all(|reason| reason.as_ref() == Some(first))
        {
            return Some(first.clone());
        }
        let own = self.metrics.iter().zip(reasons);
        let own: Vec<String> = own.filter_map(|(m, reason)| Some(format!("{} ({})", m.head(), reason?))).collect();
        (!own.is_empty()).then(|| own.join(", "))
    }

    /// Why points may be neither ranked nor tested by a column.
    fn apart_in(&self, metric: &MetricOf) -> Option<String> {
        let of = &metric.of;
        match (self.is_mixed(of), of.starts_with(EVALUATION) && self.has_seen()) {
            (true, _) => Some(OTHER.into()),
            (false, true) => Some(SEEN.into()),
            (false, false) => self.losses.apart_in(of),
        }
    }

    /// Whether a run was evaluated on assets that were trained on.
    fn has_seen(&self) -> bool {
        self.numbers.iter().any(|numbers| !numbers.seen.is_empty())
    }

    /// Sentences on evaluations that say nothing of new assets, as these were trained on, and on those with other models than
    /// the runs': with these runs.
    pub fn not_their_own(&self) -> Vec<String> {
        let runs =
            || self.outcomes.iter().zip(&self.numbers).map(|(o, n)| (format!("{}, seed {}", o.point, o.seed), n));
        let seen = |(run, numbers): (String, &Numbers)| {
            let first = numbers.seen.first()?;
            let such_as = if numbers.seen.len() > 1 { ", such as" } else { "," };
            Some(format!("{run} ({}{such_as} `{first}`)", counted(numbers.seen.len(), "asset")))
        };
        let seen: Vec<String> = runs().filter_map(seen).collect();
        let other = |(run, numbers): (String, &Numbers)| {
            (!numbers.other_models.is_empty()).then(|| format!("{run} ({})", numbers.other_models.join("; ")))
        };
        let others: Vec<String> = runs().filter_map(other).collect();
        let said = |what: &str, runs: Vec<String>| (!runs.is_empty()).then(|| format!("{what}: {}", runs.join("; ")));
        let seen = said("evaluated on assets that were trained on, of which figures say nothing of new assets", seen);
        seen.into_iter().chain(said("evaluated with other models than they were trained with", others)).collect()
    }

    /// Whether a number is not of the same assets in all runs: one of their evaluations by what these looked at, else by what
    /// they learned from, to which their validation belongs.
    fn is_mixed(&self, of: &str) -> bool {
        let groups = if of.starts_with(EVALUATION) { self.evaluation_groups() } else { self.training_groups() };
        groups.is_some()
    }

    /// Whether points may be ranked and tested by a column.
    pub(crate) fn comparable(&self, column: usize) -> bool {
        self.apart_in(&self.metrics[column]).is_none()
    }
}

#[cfg(test)]
mod tests {
    use crate::{Plan, Results};

    /// Two points of three seeds, whose rewards have a weight each; the second is better by far. `corpora`: what each learned
    /// from; all are evaluated on `t`.
    fn results(weights: [f64; 2], corpora: [&str; 2]) -> Results {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2, 3]\nevaluate = true\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\n\
                    [[sweep.metrics]]\nof = 'eval/reward@val'\nname = 'reward'\nbetter = 'higher'\n\
                    [[sweep.metrics]]\nof = 'eval/motion@val'\nname = 'motion'\nbetter = 'higher'\n\
                    [[sweep.metrics]]\nof = 'eval.json:iou'\nname = 'IoU'\nbetter = 'higher'\n";
        let config = riglab_config::Config::from_toml_str("s.toml", text).unwrap();
        let plan = Plan::new(config.get_at("sweep").unwrap(), &[]).unwrap();
        for (k, job) in plan.jobs.iter().enumerate() {
            let run = dir.path().join(&job.folder);
            std::fs::create_dir_all(&run).unwrap();
            let (point, seed) = (k / 3, (k % 3) as f64 / 100.0);
            let worth = point as f64 + seed;
            let line = format!("{{\"step\":1,\"eval/reward@val\":{worth},\"eval/motion@val\":{worth}}}\n");
            std::fs::write(run.join("metrics.jsonl"), line).unwrap();
            let config = format!("task = 'grpo'\n[reward]\nweights = [{:?}]\n", weights[point]);
            std::fs::write(run.join("config.toml"), config).unwrap();
            let info = format!("{{\"outcome\": \"finished\", \"data\": [[\"c.h5\", \"{}\", 12]]}}", corpora[point]);
            std::fs::write(run.join("run.json"), info).unwrap();
            let evaluation = format!("{{\"iou\": {worth}, \"data\": [[\"t.h5\", \"t\", 12, 3]]}}");
            std::fs::write(run.join("eval.json"), evaluation).unwrap();
        }
        Results::read(dir.path(), &plan)
    }

    #[test]
    fn totals_of_other_rewards_are_neither_ranked_nor_tested() {
        let of = |weights| {
            let results = results(weights, ["a", "a"]);
            let (table, apart) = (results.table(), results.differences().unwrap());
            let tested: Vec<String> = apart.rows.iter().map(|row| row[0].text.clone()).collect();
            ([3, 4, 5].map(|column| table.rows[1][column].strong), tested, table.note, apart.note)
        };
        let (strong, tested, note, of_tests) = of([5.0, 5.0]);
        assert_eq!((strong, tested), ([true; 3], ["reward", "motion", "IoU"].map(String::from).to_vec()));
        assert!(!(note + &of_tests).contains("comparable"));
        let (strong, tested, note, of_tests) = of([5.0, 1.0]);
        assert_eq!((strong, tested), ([false, true, true], ["motion", "IoU"].map(String::from).to_vec()));
        for note in [note, of_tests] {
            assert!(note.contains("not comparable between points: reward (reward.weights)."), "{note}");
        }
    }

    #[test]
    fn what_was_measured_on_assets_that_were_trained_on_is_neither_ranked_nor_tested() {
        let mut results = results([5.0, 5.0], ["a", "a"]);
        assert!(results.not_their_own().is_empty());
        results.numbers[1].seen = vec!["fox".into(), "cat".into()];
        results.numbers[4].seen = vec!["fox".into()];
        results.numbers[5].other_models = vec!["skin.run names another model".into()];
        let (table, apart) = (results.table(), results.differences().unwrap());
        assert_eq!([3, 4, 5].map(|column| table.rows[1][column].strong), [true, true, false]);
        assert!(apart.rows.iter().all(|row| row[0].text != "IoU") && apart.rows.len() == 2);
        let said = "not comparable between points: IoU (assets that runs were trained on).";
        assert!(table.note.contains(said) && apart.note.contains(said), "{}", table.note);
        let said = "Evaluated on assets that were trained on, of which figures say nothing of new assets: a, seed 2 (2 assets, \
                    such as `fox`); b, seed 2 (1 asset, `fox`). Evaluated with other models than they were trained with: b, \
                    seed 3 (skin.run names another model).";
        assert!(table.note.ends_with(said), "{}", table.note);
    }

    #[test]
    fn what_was_measured_on_other_assets_is_neither_ranked_nor_tested() {
        let mut results = results([5.0, 5.0], ["a", "b"]);
        // Validation belongs to what was learned from; the evaluations are all of the same.
        let (table, apart) = (results.table(), results.differences().unwrap());
        assert_eq!([3, 4, 5].map(|column| table.rows[1][column].strong), [false, false, true]);
        assert_eq!(apart.rows.iter().map(|row| row[0].text.as_str()).collect::<Vec<_>>(), ["IoU"]);
        let said = "between points: reward (runs of other corpora), motion (runs of other corpora).";
        assert!(table.note.contains(said) && apart.note.contains(said), "{}", table.note);
        assert!(table.note.contains("Not all runs learned from the same corpora: `a`, seed 1 and 2 more of c.h5 (a)"));
        for numbers in &mut results.numbers[..3] {
            numbers.evaluated_on = [("other.h5".to_owned(), "o".to_owned())].into();
        }
        let table = results.table();
        assert!(table.rows.iter().flatten().all(|cell| !cell.strong) && results.differences().is_none());
        assert!(table.note.contains("not comparable between points: runs of other corpora"), "{}", table.note);
    }
}
