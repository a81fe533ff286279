//! libtorch for the CPU, cut out of PyTorch's wheel.
//!
//! The registries hold no CPU build for Linux, but the CPU half of the CUDA wheel works alone once
//! the two small CUDA libraries it names are beside it. It is kept in the user's cache, so clones
//! share it, and linked as `.libtorch` into the workspace, where `.cargo/config.toml` expects it.

use std::fs;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::fetch::{self, Source, Wheel};
use crate::shell;

/// The version of libtorch. tch 0.24 goes with it: raise both together (workspace `Cargo.toml`).
pub const VERSION: &str = "2.11.0";

const TORCH: Wheel = Wheel {
    requirement: "torch==2.11.0",
    sha256: "7aa2f9bbc6d4595ba72138026b2074be1233186150e9292865e04b7a63b8c67a",
    megabytes: 531,
};
const CUDA: [Wheel; 2] = [
    Wheel {
        requirement: "nvidia-cuda-runtime==13.0.96",
        sha256: "7f82250d7782aa23b6cfe765ecc7db554bd3c2870c43f3d1821f1d18aebf0548",
        megabytes: 3,
    },
    Wheel {
        requirement: "nvidia-cuda-cupti==13.0.85",
        sha256: "4eb01c08e859bf924d222250d2e8f8b8ff6d3db4721288cf35d14252a4d933c8",
        megabytes: 11,
    },
];
const LIBRARIES: [&str; 5] = ["libc10.so", "libtorch_cpu.so", "libgomp.so.1", "libcudart.so.13", "libcupti.so.13"];
/// Wheels and unpacked files together, at the peak.
const NEEDED_MB: u64 = 1_200;

/// The libtorch that the environment names, if it names one.
pub fn own() -> Option<PathBuf> {
    shell::set_to("LIBTORCH", ".libtorch")
}

/// Makes sure that `.libtorch` leads to a complete libtorch.
pub fn ensure(source: &Source) -> Result<()> {
    if let Some(own) = own() {
        if !own.join("lib").is_dir() {
            bail!(
                "LIBTORCH is set to {}, which has no folder `lib`; point it at a libtorch {VERSION} or unset it",
                own.display()
            );
        }
        return Ok(());
    }
    let cache = fetch::cache()?;
    let home = cache.join(format!("libtorch-{VERSION}-cpu-{}", std::env::consts::ARCH));
    if !home.join("build-version").is_file() {
        install(&cache, &home, source)?;
    }
    fetch::symlink(&home, &shell::root().join(".libtorch"))
}

fn install(cache: &Path, home: &Path, source: &Source) -> Result<()> {
    // First, as it may make room.
    let temp = fetch::temporary(cache, ".libtorch-")?;
    fetch::need_space(cache, NEEDED_MB, "libtorch")?;
    eprintln!("setting up libtorch {VERSION} in {} (once; all clones share it)", home.display());
    let made = temp.path().join("libtorch");
    let (include, lib) = (made.join("include"), made.join("lib"));
    for wheel in [&TORCH, &CUDA[0], &CUDA[1]] {
        let file = wheel.fetch(source, temp.path())?;
        fetch::unpack(&file, |name| {
            if let Some(rest) = name.strip_prefix("torch/include/") {
                return Some(include.join(rest));
            }
            let base = name.rsplit('/').next().unwrap_or(name);
            LIBRARIES.contains(&base).then(|| lib.join(base))
        })?;
        if file.starts_with(temp.path()) {
            fs::remove_file(&file)?;
        }
    }
    for name in LIBRARIES {
        if !lib.join(name).is_file() {
            bail!("the wheels do not hold {name}; nothing was installed");
        }
    }
    // torch-sys links `-ltorch`, whose own library would pull in CUDA: a linker script stands in for it.
    fs::write(lib.join("libtorch.so"), "INPUT ( -ltorch_cpu )\n")?;
    std::os::unix::fs::symlink("libgomp.so.1", lib.join("libgomp.so"))?;
    // Last, since it marks the folder as complete; torch-sys reads it for its version check.
    fs::write(made.join("build-version"), format!("{VERSION}+cpu\n"))?;
    match fs::rename(&made, home) {
        Ok(()) => Ok(()),
        // Another clone was faster.
        Err(_) if home.join("build-version").is_file() => Ok(()),
        // A folder without the mark is left over from an older layout.
        Err(_) if home.is_dir() => {
            fs::remove_dir_all(home)?;
            fs::rename(&made, home).with_context(|| format!("cannot put libtorch at {}", home.display()))
        }
        Err(e) => Err(e).with_context(|| format!("cannot put libtorch at {}", home.display())),
    }
}
