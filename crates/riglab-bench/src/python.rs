//! Python for the other sides: an environment for each set of packages, kept in the user's cache.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::OnceLock;

use anyhow::{Context, Result, bail};

use crate::side::Side;

/// Packages that are installed together.
pub struct Environment {
    /// What messages call it.
    pub name: &'static str,
    /// As pip takes them.
    pub requirements: &'static [&'static str],
    /// The only Python that has wheels for it, if there is just one: major and minor version.
    pub version: Option<(u32, u32)>,
    /// About how much disk it takes, for the message.
    pub gigabytes: f64,
    /// A module whose import shows that it works.
    pub probe: &'static str,
    /// Its Python, once it was asked for.
    found: OnceLock<PathBuf>,
}

/// Blender as a module.
pub static BLENDER: Environment = Environment {
    name: "Blender 5.0.1",
    requirements: &["bpy==5.0.1"],
    version: Some((3, 11)),
    gigabytes: 1.2,
    probe: "bpy",
    found: OnceLock::new(),
};

/// What Python users read glTF with.
pub static ARRAYS: Environment = Environment {
    name: "trimesh and pygltflib",
    requirements: &["trimesh==5.2.0", "pygltflib==1.16.5", "numpy==2.4.6"],
    version: None,
    gigabytes: 0.1,
    probe: "trimesh, pygltflib",
    found: OnceLock::new(),
};

/// What Python users make training samples with.
pub static SAMPLES: Environment = Environment {
    name: "trimesh, scipy and h5py",
    requirements: &["trimesh==5.2.0", "numpy==2.4.6", "scipy==1.17.1", "h5py==3.16.0"],
    version: None,
    gigabytes: 0.3,
    probe: "trimesh, numpy, scipy, h5py",
    found: OnceLock::new(),
};

/// What the twins of networks need.
pub static TORCH: Environment = Environment {
    name: "PyTorch 2.11.0",
    // Plain pip on purpose: torch does not import without its CUDA libraries.
    requirements: &["torch==2.11.0", "numpy==2.4.6", "h5py==3.16.0"],
    version: None,
    gigabytes: 5.0,
    probe: "torch, numpy, h5py",
    found: OnceLock::new(),
};

/// What the twins of language models need.
pub static TRANSFORMERS: Environment = Environment {
    name: "PyTorch 2.11.0 and transformers 5.23.0",
    requirements: &["torch==2.11.0", "transformers==5.23.0", "numpy==2.4.6", "scipy==1.17.1"],
    version: None,
    gigabytes: 5.3,
    probe: "torch, transformers, numpy, scipy",
    found: OnceLock::new(),
};

/// The oldest Python that all of these have wheels for.
const OLDEST: (u32, u32) = (3, 11);

impl Environment {
    /// Starts a program of `python/` that answers requests.
    pub fn start(&self, script: &str) -> Result<Side> {
        let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("python");
        let mut command = Command::new(self.python()?);
        command.arg(dir.join(script)).env("PYTHONDONTWRITEBYTECODE", "1");
        Side::start(self.name, command)
    }

    /// The Python that has the packages; installs them the first time.
    fn python(&self) -> Result<&Path> {
        if let Some(found) = self.found.get() {
            return Ok(found);
        }
        let python = self.find()?;
        Ok(self.found.get_or_init(|| python))
    }

    fn find(&self) -> Result<PathBuf> {
        if let Some(own) = std::env::var_os("RIGLAB_BENCH_PYTHON").filter(|v| !v.is_empty()) {
            if imports(Path::new(&own), self.probe) {
                return Ok(own.into());
            }
            eprintln!("note: RIGLAB_BENCH_PYTHON cannot import {}; taking our own environment", self.probe);
        }
        let base = self.base()?;
        let home = cache()?.join(format!("bench-venv-{}", self.key(base.version)));
        let python = home.join("bin/python");
        if !python.is_file() {
            self.install(&base, &home)?;
        }
        Ok(python)
    }

    fn install(&self, base: &Base, home: &Path) -> Result<()> {
        eprintln!("installing {} in {} (once, about {} GB)", self.name, home.display(), self.gigabytes);
        let cache = home.parent().context("it lies in the cache")?;
        let temp = tempfile::Builder::new().prefix(".bench-venv-").tempdir_in(cache)?;
        let made = temp.path().join("venv");
        // pip from outside: Debian's Python has no ensurepip.
        run(Command::new(&base.program).args(["-m", "venv", "--without-pip"]).arg(&made))?;
        let mut pip = Command::new(&base.program);
        pip.args(["-m", "pip", "--python"]).arg(made.join("bin/python"));
        pip.args(["install", "--quiet", "--disable-pip-version-check", "--no-cache-dir", "--only-binary=:all:"]);
        run(pip.args(self.requirements)).with_context(|| {
            format!("{} could not be installed; is there a network, and does pip reach its index?", self.name)
        })?;
        if !imports(&made.join("bin/python"), self.probe) {
            bail!("{} was installed, but `import {}` fails with {}", self.name, self.probe, base.program.display());
        }
        put_in_place(&made, home, "bin/python")
    }

    /// A Python with pip that the packages have wheels for.
    fn base(&self) -> Result<Base> {
        let wanted = |v: (u32, u32)| self.version.map_or(v >= OLDEST, |only| v == only);
        let first = std::env::var("PYTHON").ok();
        let exact = self.version.map(|(a, b)| format!("python{a}.{b}"));
        let names = first.into_iter().chain(exact).chain(["python3".into(), "python".into()]);
        let mut found = Vec::new();
        for name in names {
            let Some(version) = version(&name) else { continue };
            found.push(format!("{name} is {}.{}", version.0, version.1));
            if !wanted(version) {
                continue;
            }
            if !succeeds(Command::new(&name).args(["-m", "pip", "--version"])) {
                found.push("without pip".into());
                continue;
            }
            return Ok(Base { program: name.into(), version });
        }
        let wanted = match self.version {
            Some((a, b)) => format!("Python {a}.{b}"),
            None => format!("Python {}.{} or newer", OLDEST.0, OLDEST.1),
        };
        let found = if found.is_empty() { "no Python on the path".into() } else { found.join(", ") };
        bail!("{} needs {wanted} with pip ({found}); install it, or point PYTHON at one", self.name)
    }

    /// FNV-1a of what makes the environment what it is.
    fn key(&self, version: (u32, u32)) -> String {
        let text = format!("{}.{} {}", version.0, version.1, self.requirements.join(" "));
        let hash =
            text.bytes().fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0100_0000_01b3));
        format!("{hash:016x}")
    }
}

/// A Python on the path.
struct Base {
    program: PathBuf,
    version: (u32, u32),
}

fn version(program: &str) -> Option<(u32, u32)> {
    let script = "import sys; print(*sys.version_info[:2])";
    let out = Command::new(program).args(["-c", script]).stderr(Stdio::null()).output().ok()?;
    let text = String::from_utf8_lossy(&out.stdout).into_owned();
    let mut numbers = text.split_whitespace().map_while(|n| n.parse().ok());
    Some((numbers.next()?, numbers.next()?))
}

fn imports(python: &Path, modules: &str) -> bool {
    succeeds(Command::new(python).args(["-c", &format!("import {modules}")]))
}

fn succeeds(command: &mut Command) -> bool {
    command.stdout(Stdio::null()).stderr(Stdio::null()).status().is_ok_and(|s| s.success())
}

fn run(command: &mut Command) -> Result<()> {
    let name = command.get_program().to_string_lossy().into_owned();
    // Standard output is for the table.
    let out = command.stdout(Stdio::null()).status().with_context(|| format!("cannot start `{name}`"))?;
    if !out.success() {
        let arguments: Vec<_> = command.get_args().map(|a| a.to_string_lossy()).collect();
        bail!("`{name} {}` ended with {out}", arguments.join(" "));
    }
    Ok(())
}

/// Moves a finished environment to where it is looked for; `within` tells whether one is there.
pub fn put_in_place(made: &Path, home: &Path, within: &str) -> Result<()> {
    match fs::rename(made, home) {
        Err(e) if !home.join(within).exists() => Err(e).context("cannot put the environment in place"),
        // Put there, or someone else was faster.
        _ => Ok(()),
    }
}

/// The cache that set-up uses too.
pub fn cache() -> Result<PathBuf> {
    let set = |name: &str| std::env::var_os(name).map(PathBuf::from).filter(|path| path.is_absolute());
    let base = set("XDG_CACHE_HOME").or_else(|| Some(set("HOME")?.join(".cache")));
    let dir = base.context("neither XDG_CACHE_HOME nor HOME is set")?.join("riglab");
    fs::create_dir_all(&dir).with_context(|| format!("cannot make {}", dir.display()))?;
    Ok(dir)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn other_requirements_or_pythons_are_other_environments() {
        let keys = [BLENDER.key((3, 11)), TORCH.key((3, 11)), TORCH.key((3, 12))];
        assert!(keys[0] != keys[1] && keys[1] != keys[2]);
    }

    #[test]
    fn an_impossible_python_is_refused_in_a_sentence() {
        let never = Environment {
            name: "Blender 5.0.1",
            requirements: &[],
            version: Some((2, 1)),
            gigabytes: 0.0,
            probe: "",
            found: OnceLock::new(),
        };
        let e = never.base().err().map(|e| e.to_string()).unwrap_or_default();
        assert!(e.contains("Blender 5.0.1 needs Python 2.1 with pip"), "{e}");
    }
}
