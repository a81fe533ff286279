//! Where networks compute.

use anyhow::{Result, anyhow, bail};
use tch::Device;

/// Says it where the option does not.
const VARIABLE: &str = "RIGLAB_DEVICE";

/// The option of commands that compute with networks.
#[derive(clap::Args)]
pub struct DeviceArgs {
    /// Where to compute: `cpu`, or `cuda:0` and so on [default: cpu, but of a run that goes on where it was begun].
    #[arg(long, env = VARIABLE, hide_env_values = true, value_name = "DEVICE")]
    device: Option<String>,
}

/// Where nothing says otherwise.
const DEFAULT: &str = "cpu";

impl DeviceArgs {
    /// The device, ready to compute. Call it after `riglab_torch::init`, before any tensor is made.
    ///
    /// # Errors
    /// What the option may be, or what this machine lacks.
    pub fn device(&self) -> Result<Device> {
        let name = self.asked().unwrap_or(DEFAULT);
        riglab_torch::device(name).map_err(|e| anyhow!("--device {name}: {e}"))
    }

    /// What a job of this command on another machine is to be told: nothing where it was not asked for here, so that the
    /// job's own surroundings say.
    pub fn asked(&self) -> Option<&str> {
        // A variable that is set to nothing says nothing.
        self.device.as_deref().filter(|name| !name.trim().is_empty())
    }

    /// That of commands that are several processes at times: those share processors alone.
    ///
    /// # Errors
    /// As [`Self::device`]; for a GPU asked of several.
    pub fn of_ranks(&self, ranks: &riglab_ranks::Ranks) -> Result<Device> {
        let device = self.device()?;
        if ranks.size() > 1 && device != Device::Cpu {
            bail!("--device {}: ranks train on processors; start it without mpirun for one GPU", name(device));
        }
        Ok(device)
    }
}

/// Its name, as the option takes it.
pub fn name(device: Device) -> String {
    match device {
        Device::Cuda(number) => format!("cuda:{number}"),
        _ => "cpu".into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_variable_asks_for_nothing() {
        let asked = |device: Option<&str>| DeviceArgs { device: device.map(str::to_owned) }.asked().map(str::to_owned);
        assert_eq!([asked(None), asked(Some("")), asked(Some(" "))], [None, None, None]);
        assert_eq!(asked(Some("cuda:0")), Some("cuda:0".into()));
    }
}
