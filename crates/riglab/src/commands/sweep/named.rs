//! What a sweep's file says: its table, the configs that jobs start from, and what they ask of a cluster.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use riglab_config::{Config, ConfigError, FaultKind};
use riglab_slurm::SlurmConfig;
use riglab_sweep::SweepFile;

use crate::commands::shown;
use crate::commands::slurm::{is_of_cluster, settings};
use crate::presets;

/// The table `[sweep]`. Its changes say of which tables they choose another block: jobs have nothing of the former one.
pub fn file_of(config: &Config) -> Result<SweepFile, ConfigError> {
    let arms = config.get_at::<SweepFile>("sweep")?.arms.len();
    let places = ["set", "product", "zip", "evaluate_with"].into_iter().map(|place| format!("sweep.{place}"));
    let places = places.chain((0..arms).map(|arm| format!("sweep.arms[{arm}].set")));
    places.fold(config.clone(), |config, place| config.with_choices(&place)).get_at("sweep")
}

/// Refuses changes of single jobs, or of all, that are about a cluster: its array asks for the same for each of them.
pub fn without_cluster(config: &Config, file: &SweepFile) -> Result<(), ConfigError> {
    let of = |place: &str, keys: Vec<&String>| keys.into_iter().map(|key| (place.to_owned(), key.clone())).collect();
    let places: Vec<Vec<(String, String)>> = [
        of("sweep.set", file.set.keys().collect()),
        of("sweep.product", file.product.keys().collect()),
        of("sweep.zip", file.zip.keys().collect()),
        of("sweep.evaluate_with", file.evaluate_with.keys().collect()),
    ]
    .into_iter()
    .chain(file.arms.iter().enumerate().map(|(k, arm)| of(&format!("sweep.arms[{k}].set"), arm.set.keys().collect())))
    .collect();
    match places.into_iter().flatten().find(|(_, key)| is_of_cluster(key)) {
        Some((place, key)) => Err(config.invalid(
            &format!("{place}.\"{key}\""),
            "the jobs of a sweep are tasks of one array, which asks the cluster for the same for all of them: write it into \
             the table [slurm] of the sweep's file",
        )),
        None => Ok(()),
    }
}

/// What the jobs ask of a cluster: the table [slurm] of the sweep's file over those of the configs that they start from.
pub fn asks<'a>(config: &Config, bases: impl Iterator<Item = &'a String>) -> Result<SlurmConfig> {
    let table = |config: &Config| match config.contains("slurm") {
        true => config.get_at::<toml::Table>("slurm"),
        false => Ok(toml::Table::new()),
    };
    let (whole, own) = (settings(config)?, table(config)?);
    let mut found: Option<(&str, SlurmConfig)> = None;
    for base in bases {
        let base_config = presets::load(base, &[])?;
        settings(&base_config)?;
        let mut all = table(&base_config)?;
        all.extend(own.clone());
        let slurm: SlurmConfig = all.try_into().with_context(|| format!("{base}, [slurm]"))?;
        let invalid = |(key, message)| anyhow!("{base}, with [slurm] of the sweep's file: `{key}`: {message}");
        slurm.validate().map_err(invalid)?;
        match &found {
            Some((first, other)) if *other != slurm => bail!(
                "{first} and {base} have different tables [slurm], and the jobs of a sweep are tasks of one array: write what \
                 is to hold for all of them into [slurm] of the sweep's file"
            ),
            _ => found = Some((base, slurm)),
        }
    }
    Ok(found.map_or(whole, |(_, slurm)| slurm))
}

/// Where the config is that a sweep's file names under a key; that there is none is told at the key.
pub fn based(config: &Config, key: &str, file: &Path, named: &str) -> Result<String, ConfigError> {
    if named.is_empty() {
        return Err(config.invalid(key, "it names no config; `riglab train --list` shows the built-in ones"));
    }
    let loaded = presets::load_beside(Some(file), named, &[]).err();
    let missing = loaded.as_ref().and_then(|e| e.faults().first()).filter(|f| f.origin.is_none());
    match missing.filter(|f| f.kind == FaultKind::Unreadable) {
        Some(fault) => Err(config.invalid(key, &fault.message).with_hint(&fault.hint)),
        None => Ok(beside(file, named)),
    }
}

/// Where the config is that a sweep's file names: as named if it is there, else beside the file if it is there, as what a config
/// extends; else as named, for a built-in one.
fn beside(file: &Path, named: &str) -> String {
    let own = file.parent().unwrap_or(Path::new("")).join(named);
    if !Path::new(named).is_file() && own.is_file() { shown(&own) } else { named.to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_asked_of_a_cluster_is_no_change_of_jobs() {
        let said = |more: &str| {
            let text = format!("[sweep]\nbase = 'b'\nseeds = [0]\n{more}\n");
            let config = presets::parse("s.toml", &text, &[]).unwrap();
            without_cluster(&config, &file_of(&config).unwrap()).map_err(|e| e.to_string())
        };
        assert_eq!(said("set = { 'train.steps' = 3 }"), Ok(()));
        for (place, more) in [
            ("set", "set = { 'slurm.time' = '8:00:00' }"),
            ("evaluate_with", "evaluate = true\nevaluate_with = { 'slurm.time' = '8:00:00' }"),
            ("arms[0].set", "[[sweep.arms]]\nname = 'a'\nset = { slurm = { cpus = 4 } }"),
        ] {
            let said = said(more).unwrap_err();
            assert!(said.contains(&format!("sweep.{place}")) && said.contains("the table [slurm]"), "{said}");
        }
    }

    #[test]
    fn a_base_is_looked_for_beside_its_sweep() {
        let folder = tempfile::tempdir().unwrap();
        let (file, own) = (folder.path().join("s.toml"), folder.path().join("base_of_it.toml"));
        std::fs::write(&own, "").unwrap();
        assert_eq!(beside(&file, "base_of_it.toml"), shown(&own));
        assert_eq!(beside(&file, &shown(&own)), shown(&own));
        // Files of the working folder are meant where there are such, and built-in ones where there is none.
        assert_eq!(beside(&file, "Cargo.toml"), "Cargo.toml");
        assert_eq!(beside(&file, "quickstart/fsq_cvae.toml"), "quickstart/fsq_cvae.toml");
    }

    #[test]
    fn a_base_that_is_nowhere_is_told_at_its_key_with_what_lies_near() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("s.toml");
        std::fs::write(folder.path().join("base_of_it.toml"), "").unwrap();
        let said = |named: &str| {
            let text = format!("[sweep]\nbase = 'quickstart/fsq_cvae.toml'\n[[sweep.arms]]\nbase = '{named}'\n");
            let config = presets::parse("s.toml", &text, &[]).unwrap();
            based(&config, "sweep.arms[0].base", &file, named).map_err(|e| e.to_string())
        };
        let near = said("base_off_it.toml").unwrap_err();
        assert!(near.starts_with("s.toml:4:8: `sweep.arms[0].base`: base_off_it.toml: no such file"), "{near}");
        assert!(near.ends_with("hint: did you mean `base_of_it.toml`?"), "{near}");
        let nowhere = said("elsewhere.toml").unwrap_err();
        let tried = shown(&folder.path().join("elsewhere.toml"));
        assert!(nowhere.contains(&format!("`{tried}`")) && nowhere.contains("built-in"), "{nowhere}");
        assert_eq!(said("base_of_it.toml").unwrap(), shown(&folder.path().join("base_of_it.toml")));
        assert_eq!(said("quickstart/fsq_cvae.toml").unwrap(), "quickstart/fsq_cvae.toml");
    }
}
