//! Python environments in the user's cache, made once and shared by all clones.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::{fetch, preflight, shell};

/// An environment.
pub struct Venv {
    /// Its folder in the cache; another set of requirements has another number.
    pub folder: &'static str,
    /// As pip takes them.
    pub requirements: &'static [&'static str],
    /// What it takes on disk.
    pub megabytes: u64,
    /// Python that succeeds where all is there.
    pub check: &'static str,
}

impl Venv {
    /// Makes it where there is none; gives its folder.
    pub fn ensure(&self) -> Result<PathBuf> {
        let cache = fetch::cache()?;
        let home = cache.join(self.folder);
        if self.works(&home) {
            return Ok(home);
        }
        let temp = fetch::temporary(&cache, ".venv-")?;
        fetch::need_space(&cache, self.megabytes * 7 / 5, self.folder)?;
        let list = self.requirements.join(", ");
        eprintln!("installing {list} in {} (once, about {} MB)", home.display(), self.megabytes);
        let made = temp.path().join("venv");
        let base = preflight::python()?;
        // pip from outside: Debian's Python has no ensurepip.
        shell::run(Command::new(&base).args(["-m", "venv", "--without-pip"]).arg(&made))?;
        let mut pip = Command::new(&base);
        pip.args(["-m", "pip", "--python"]).arg(made.join("bin/python"));
        pip.args(["install", "--quiet", "--disable-pip-version-check", "--no-cache-dir", "--only-binary=:all:"]);
        shell::run(pip.args(self.requirements)).context("is there a network, and does pip reach its index?")?;
        if !self.works(&made) {
            bail!("the packages were installed, but do not work");
        }
        // What an earlier version left half-done goes.
        if home.exists() {
            fs::remove_dir_all(&home)?;
        }
        match fs::rename(&made, &home) {
            Err(e) if !self.works(&home) => Err(e).with_context(|| format!("cannot put it at {}", home.display())),
            _ => Ok(home),
        }
    }

    fn works(&self, home: &Path) -> bool {
        let mut command = Command::new(home.join("bin/python"));
        let command = command.args(["-c", self.check]);
        command.stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success())
    }
}
