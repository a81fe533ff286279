//! Columns that are other quantities at each point, such as a total of rewards under other weights: they are shown, but
//! neither ranked nor tested.

use crate::{MetricOf, Results};

impl Results {
    /// These columns, each with the settings that make it so.
    pub(crate) fn not_comparable(&self) -> Option<String> {
        let own = |m: &MetricOf| Some(format!("{} ({})", m.head(), self.losses.apart_in(&m.of)?));
        let own: Vec<String> = match self.mixed() {
            Some(_) => vec!["runs of other corpora".into()],
            None => self.metrics.iter().filter_map(own).collect(),
        };
        (!own.is_empty()).then(|| own.join(", "))
    }

    /// Whether points may be ranked and tested by a column.
    pub(crate) fn comparable(&self, column: usize) -> bool {
        self.losses.apart_in(&self.metrics[column].of).is_none() && self.mixed().is_none()
    }
}

#[cfg(test)]
mod tests {
    use crate::{Plan, Results};

    /// Two points of three seeds, whose rewards have a weight each; the second is better by far.
    fn results(weights: [f64; 2], corpora: [&str; 2]) -> Results {
        let dir = tempfile::tempdir().unwrap();
        let text = "[sweep]\nbase = 'b'\nseeds = [1, 2, 3]\n[[sweep.arms]]\nname = 'a'\n[[sweep.arms]]\nname = 'b'\n\
                    [[sweep.metrics]]\nof = 'eval/reward@val'\nname = 'reward'\nbetter = 'higher'\n\
                    [[sweep.metrics]]\nof = 'eval/motion@val'\nname = 'motion'\nbetter = 'higher'\n";
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
        }
        Results::read(dir.path(), &plan)
    }

    #[test]
    fn totals_of_other_rewards_are_neither_ranked_nor_tested() {
        let of = |weights| {
            let results = results(weights, ["a", "a"]);
            let (table, apart) = (results.table(), results.differences().unwrap());
            let tested: Vec<String> = apart.rows.iter().map(|row| row[0].text.clone()).collect();
            ([3, 4].map(|column| table.rows[1][column].strong), tested, table.note, apart.note)
        };
        let (strong, tested, note, of_tests) = of([5.0, 5.0]);
        assert_eq!((strong, tested), ([true, true], vec!["reward".to_owned(), "motion".into()]));
        assert!(!(note + &of_tests).contains("comparable"));
        let (strong, tested, note, of_tests) = of([5.0, 1.0]);
        assert_eq!((strong, tested), ([false, true], vec!["motion".to_owned()]));
        for note in [note, of_tests] {
            assert!(note.contains("not comparable between points: reward (reward.weights)."), "{note}");
        }
    }

    #[test]
    fn what_was_measured_on_other_assets_is_neither_ranked_nor_tested() {
        let results = results([5.0, 5.0], ["a", "b"]);
        let table = results.table();
        assert!(table.rows.iter().flatten().all(|cell| !cell.strong) && results.differences().is_none());
        assert!(table.note.contains("not comparable between points: runs of other corpora"), "{}", table.note);
    }
}
