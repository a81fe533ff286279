//! What the notebooks need, in an environment of their own, and a test that runs them.

use anyhow::Result;

use crate::shell;
use crate::venv::Venv;

/// The test looks for it in the cache by its folder.
const VENV: Venv = Venv {
    folder: "notebooks-venv-1",
    requirements: &["h5py==3.16.0", "numpy==2.4.6", "pandas==3.1.1", "matplotlib==3.11.2", "scikit-learn==1.9.1"],
    megabytes: 500,
    check: "import h5py, numpy, pandas, matplotlib, sklearn",
};

/// Installs the environment where there is none, runs the test of all notebooks, and says how to open them.
pub fn run() -> Result<()> {
    let python = VENV.ensure()?.join("bin/python");
    shell::cargo(&["test", "--release", "--workspace", "--test", "notebooks", "--", "--nocapture"])?;
    let python = python.display();
    println!(
        "The notebooks run with {python}. To open them: python3 -m pip --python {python} install notebook, then\n\
         {python} -m notebook notebooks/"
    );
    Ok(())
}
