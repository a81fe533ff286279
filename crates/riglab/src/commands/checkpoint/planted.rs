//! Models as folders of runs that did not train them.

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use riglab_files::Unfinished;
use riglab_task::bundle::Card;
use riglab_task::released::Imported;
use riglab_task::tokenrig::AUTO_ENCODER;
use riglab_train::{Checkpoint, Run, RunInfo, State};

use super::anywhere;

/// A new folder of a run that holds the weights as its best checkpoint; `how` they came there. It is there whole or not at
/// all, and works wherever it is moved to.
pub(super) fn folder(out: &Path, model: &Imported, card: &Card, how: &str) -> Result<()> {
    free(out)?;
    riglab_files::make_folder_of(out)?;
    let unmade = || format!("{} cannot be made", out.display());
    let unfinished = Unfinished::folder_beside(out).with_context(unmade)?;
    write(unfinished.path(), model, card, how)?;
    unfinished.finish().with_context(unmade)
}

/// Refuses a folder that is there and holds something.
pub(super) fn free(out: &Path) -> Result<()> {
    let empty = |dir: &Path| std::fs::read_dir(dir).is_ok_and(|mut entries| entries.next().is_none());
    if out.exists() && !empty(out) {
        bail!("{} exists; give the name of a new folder", out.display());
    }
    Ok(())
}

fn write(dir: &Path, model: &Imported, card: &Card, how: &str) -> Result<()> {
    let settings = match model {
        Imported::TokenRig(rigger) => {
            let vae = rigger.vae();
            let mut of_vae = vae.config().clone();
            anywhere(&mut of_vae.data, &mut of_vae.train);
            let run = Run::create(&dir.join(AUTO_ENCODER), &toml::to_string(&of_vae)?)?;
            let state = State { task: "fsq_cvae".into(), ..card.state.clone() };
            vae.plant(run.dir(), &state).map_err(|e| anyhow!(e))?;
            about(&run, "fsq_cvae", how, vae.tensors().iter().map(|(_, t)| t.numel()).sum())?;
            let mut config = rigger.config().clone();
            config.skin.run = AUTO_ENCODER.into();
            anywhere(&mut config.data, &mut config.train);
            toml::to_string(&config)?
        }
        other => other.settings().map_err(|e| anyhow!(e))?,
    };
    let run = Run::create(dir, &settings)?;
    Checkpoint::plant(run.dir(), model.params(), &card.state)?;
    riglab_files::write(&run.path("card.md"), card.text.as_bytes())?;
    about(&run, model.task(), how, model.params().numel())
}

fn about(run: &Run, task: &str, how: &str, parameters: usize) -> Result<()> {
    let mut info = RunInfo::new(crate::VERSION, task, 1, "cpu");
    (info.parameters, info.ended, info.outcome) = (parameters, RunInfo::now(), how.into());
    Ok(run.write_info(&info)?)
}
