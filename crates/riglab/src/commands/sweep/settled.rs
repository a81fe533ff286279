//! What the configs of a sweep's jobs leave to the machine that trains, `train.precision = "auto"`: one thing for all jobs,
//! or their differences would not be their arms' alone. The first machine to begin a job decides, since who writes the
//! configs need not be who trains: the login node of a cluster is often of another kind than the others.

use std::path::Path;

use anyhow::{Context, Result};
use riglab_files::write_first;
use riglab_sweep::{Job, Plan, SweepError};
use riglab_train::Precision;

use super::{settings_of, unsound};
use crate::registry::TaskConfig;

/// Holds what was decided, below the sweep's folder.
const DECIDED: &str = "precision.json";

/// Gives the jobs of a plan their whole configs. What they leave to the machine is as in those that the folder has of them,
/// where it is decided there: jobs that are said to be the same are no others on another machine.
pub fn configs(folder: &Path) -> Result<impl Fn(&Job) -> Result<String, SweepError> + '_, SweepError> {
    let there = Plan::read(folder)?;
    Ok(move |job: &Job| {
        let whole = || {
            let mut own = settings_of(&job.base, &job.sets)?;
            if let Some(plan) = there.as_ref().filter(|there| there.jobs.iter().any(|old| old.is(job)))
                && own.left().next().is_some()
            {
                own.settle_as(&mut written(plan, folder, job)?);
            }
            own.to_toml()
        };
        whole().map_err(|e| unsound(job, &e))
    })
}

/// Gives jobs their whole configs with nothing left open, to see which are the same: as the folder has decided, or this
/// machine would.
pub fn guesses(folder: &Path) -> impl Fn(&Job) -> Result<String, SweepError> {
    let auto = told(folder).unwrap_or_else(|| Precision::Auto.resolved());
    move |job| {
        let whole = settings_of(&job.base, &job.sets).and_then(|own| own.settled_to(auto).to_toml());
        whole.map_err(|e| unsound(job, &e))
    }
}

/// Decides what a job's config leaves to the machine, as for every job of the sweep, before it is trained from it.
pub fn settle(folder: &Path, plan: &Plan, job: &Job) -> Result<()> {
    // Of one that cannot be read the training tells.
    let Ok(mut config) = written(plan, folder, job) else { return Ok(()) };
    if config.left().next().is_none() {
        return Ok(());
    }
    let (text, path) = (config.settled_to(decided(folder, plan)?).to_toml()?, plan.config(folder, job));
    riglab_files::write(&path, text.as_bytes()).with_context(|| format!("{} cannot be written", path.display()))
}

/// The config that a folder has of a job.
fn written(plan: &Plan, folder: &Path, job: &Job) -> Result<TaskConfig> {
    settings_of(&plan.config(folder, job).to_string_lossy(), &[])
}

/// What `auto` is in a sweep.
fn decided(folder: &Path, plan: &Plan) -> Result<Precision> {
    let path = folder.join(DECIDED);
    if let Some(told) = told(folder) {
        return Ok(told);
    }
    let own = before(folder, plan).unwrap_or_else(|| Precision::Auto.resolved());
    let text = serde_json::to_string(&own)? + "\n";
    // Of several nodes that write at once, the first is heard.
    write_first(&path, text.as_bytes()).with_context(|| format!("{} cannot be written", path.display()))?;
    Ok(told(folder).unwrap_or(own))
}

fn told(folder: &Path) -> Option<Precision> {
    serde_json::from_str(&std::fs::read_to_string(folder.join(DECIDED)).ok()?).ok()
}

/// What it is in configs that were decided when they were written, as earlier versions did.
fn before(folder: &Path, plan: &Plan) -> Option<Precision> {
    let of = |job: &Job| {
        let mut own = settings_of(&job.base, &job.sets).ok()?;
        own.settle_as(&mut written(plan, folder, job).ok()?)
    };
    plan.jobs.iter().find_map(of)
}

#[cfg(test)]
mod tests {
    use riglab_sweep::SweepFile;

    use super::*;
    use crate::presets;

    fn plan(seeds: &str, precision: &str) -> Plan {
        let set = "'data.corpora' = ['rigs.h5'], 'train.precision'";
        let text =
            format!("[sweep]\nbase = 'quickstart/fsq_cvae.toml'\nseeds = {seeds}\nset = {{ {set} = '{precision}' }}\n");
        let file: SweepFile = presets::parse("s.toml", &text, &[]).unwrap().get_at("sweep").unwrap();
        Plan::new(file, &[]).unwrap()
    }

    fn precisions(folder: &Path, plan: &Plan) -> Vec<Precision> {
        let of = |job: &Job| written(plan, folder, job).unwrap().train().precision;
        plan.jobs.iter().map(of).collect()
    }

    #[test]
    fn all_jobs_of_a_sweep_have_the_precision_of_the_first() {
        let dir = tempfile::tempdir().unwrap();
        let here = Precision::Auto.resolved();
        let other = if here == Precision::Bf16 { Precision::Fp32 } else { Precision::Bf16 };
        let put = |folder: &Path, plan: &Plan| plan.settle(folder, configs(folder).unwrap()).map(drop);
        // Whoever writes the configs leaves it to who trains; the first node has another processor.
        let (one, two) = (plan("[0]", "auto"), plan("[0, 1]", "auto"));
        let folder = dir.path().join("nodes");
        put(&folder, &two).unwrap();
        assert_eq!(precisions(&folder, &two), [Precision::Auto; 2]);
        std::fs::write(folder.join(DECIDED), serde_json::to_string(&other).unwrap()).unwrap();
        settle(&folder, &two, &two.jobs[1]).unwrap();
        assert_eq!(precisions(&folder, &two), [Precision::Auto, other]);
        // Jobs that leave it open are those that say the same.
        let said = serde_json::to_string(&other).unwrap().trim_matches('"').to_owned();
        let of = |plan: &Plan| guesses(&folder)(&plan.jobs[0]).unwrap();
        assert_eq!(of(&two), of(&plan("[0, 1]", &said)));
        // The same jobs are no others here.
        put(&folder, &two).unwrap();
        settle(&folder, &two, &two.jobs[0]).unwrap();
        assert_eq!(precisions(&folder, &two), [other; 2]);
        // One that was decided when it was written.
        let folder = dir.path().join("earlier");
        one.settle(&folder, |job| {
            let own = settings_of(&job.base, &job.sets).and_then(|own| own.settled_to(other).to_toml());
            own.map_err(|e| unsound(job, &e))
        })
        .unwrap();
        put(&folder, &two).unwrap();
        two.jobs.iter().for_each(|job| settle(&folder, &two, job).unwrap());
        assert_eq!(precisions(&folder, &two), [other; 2]);
        // And one that nobody has decided yet.
        let folder = dir.path().join("here");
        put(&folder, &one).unwrap();
        settle(&folder, &one, &one.jobs[0]).unwrap();
        assert_eq!(precisions(&folder, &one), [here]);
        // What a file says itself is another setting.
        let said = serde_json::to_string(&other).unwrap().trim_matches('"').to_owned();
        assert!(configs(&folder).unwrap()(&plan("[0]", &said).jobs[0]).unwrap().contains(&said));
        assert!(put(&folder, &plan("[0]", &said)).is_err());
    }
}
