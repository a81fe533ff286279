//! Models as folders of runs that did not train them.

use std::path::Path;

use anyhow::{Result, anyhow};
use riglab_task::bundle::Card;
use riglab_task::released::Imported;
use riglab_train::{Checkpoint, Run, RunInfo, State};

/// A run's folder that holds the weights as its best checkpoint; `how` they came there.
pub(super) fn folder(out: &Path, model: &Imported, card: &Card, how: &str) -> Result<()> {
    let settings = match model {
        Imported::TokenRig(rigger) => {
            let (skin, vae) = (out.join("auto_encoder"), rigger.vae());
            let run = Run::create(&skin, &toml::to_string(vae.config())?)?;
            let state = State { task: "fsq_cvae".into(), ..card.state.clone() };
            vae.plant(run.dir(), &state).map_err(|e| anyhow!(e))?;
            about(&run, "fsq_cvae", how, vae.tensors().iter().map(|(_, t)| t.numel()).sum())?;
            let mut config = rigger.config().clone();
            config.skin.run = skin;
            toml::to_string(&config)?
        }
        other => other.settings().map_err(|e| anyhow!(e))?,
    };
    let run = Run::create(out, &settings)?;
    Checkpoint::plant(run.dir(), model.params(), &card.state)?;
    riglab_files::write(&run.path("card.md"), card.text.as_bytes())?;
    about(&run, model.task(), how, model.params().numel())
}

fn about(run: &Run, task: &str, how: &str, parameters: usize) -> Result<()> {
    let mut info = RunInfo::new(crate::VERSION, task, 1, "cpu");
    (info.parameters, info.ended, info.outcome) = (parameters, RunInfo::now(), how.into());
    Ok(run.write_info(&info)?)
}
