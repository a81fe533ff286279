//! What the notebooks need, in an environment of their own, and a test that runs them.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::{fetch, preflight, shell};

/// As pip takes them.
const REQUIREMENTS: [&str; 5] =
    ["h5py==3.16.0", "numpy==2.4.6", "pandas==3.1.1", "matplotlib==3.11.2", "scikit-learn==1.9.1"];
/// Its folder in the cache, where the test looks for it; another set of requirements has another number.
const FOLDER: &str = "notebooks-venv-1";

/// Installs the environment where there is none, runs the test of all notebooks, and says how to open them.
pub fn run() -> Result<()> {
    let python = ensure()?;
    shell::cargo(&["test", "--release", "--workspace", "--test", "notebooks", "--", "--nocapture"])?;
    let python = python.display();
    println!(
        "The notebooks run with {python}. To open them: {python} -m pip install notebook, then\n\
         {python} -m notebook notebooks/ (without pip in it: python3 -m pip --python {python} install notebook)"
    );
    Ok(())
}

/// The environment's Python.
fn ensure() -> Result<PathBuf> {
    let cache = fetch::cache()?;
    let home = cache.join(FOLDER);
    let python = home.join("bin/python");
    if works(&python) {
        return Ok(python);
    }
    fetch::need_space(&cache, 700, FOLDER)?;
    eprintln!("installing {} in {} (once, about 0.5 GB)", REQUIREMENTS.join(", "), home.display());
    let temp = tempfile::Builder::new().prefix(".notebooks-").tempdir_in(&cache)?;
    let made = temp.path().join("venv");
    let base = preflight::python()?;
    // pip from outside: Debian's Python has no ensurepip.
    shell::run(Command::new(&base).args(["-m", "venv", "--without-pip"]).arg(&made))?;
    let mut pip = Command::new(&base);
    pip.args(["-m", "pip", "--python"]).arg(made.join("bin/python"));
    pip.args(["install", "--quiet", "--disable-pip-version-check", "--no-cache-dir", "--only-binary=:all:"]);
    shell::run(pip.args(REQUIREMENTS)).context("is there a network, and does pip reach its index?")?;
    if !works(&made.join("bin/python")) {
        bail!("the packages were installed, but Python cannot import them");
    }
    // What an earlier version left half-done goes.
    if home.exists() {
        fs::remove_dir_all(&home)?;
    }
    match fs::rename(&made, &home) {
        Err(e) if !python.exists() => Err(e).with_context(|| format!("cannot put it at {}", home.display())),
        _ => Ok(python),
    }
}

fn works(python: &Path) -> bool {
    let mut command = Command::new(python);
    let command = command.args(["-c", "import h5py, numpy, pandas, matplotlib, sklearn"]);
    command.stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success())
}
