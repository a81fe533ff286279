//! Node for the other sides that exist in JavaScript or WebAssembly only: packages in the user's cache.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

use anyhow::{Context, Result, bail};

use crate::python::{cache, put_in_place};
use crate::side::Side;

/// Packages, as npm takes them.
const PACKAGES: [&str; 4] =
    ["draco3d@1.5.9", "meshoptimizer@1.3.0", "three@0.187.0", "@pixiv/three-vrm-springbone@3.5.5"];

/// Starts a program of `node/` that answers requests.
pub fn start(name: &str, script: &str) -> Result<Side> {
    let packages = packages()?;
    let dir = Path::new(env!("CARGO_MANIFEST_DIR")).join("node");
    let mut command = Command::new("node");
    command.arg(dir.join(script)).env("RIGLAB_NODE_MODULES", packages.join("node_modules"));
    Side::start(name, command)
}

/// The folder with the packages; installs them the first time.
fn packages() -> Result<PathBuf> {
    let cache = cache()?;
    let home = cache.join(format!("bench-node-{}", PACKAGES.join("-").replace(['@', '.', '/'], "_")));
    if home.join("node_modules").is_dir() {
        return Ok(home);
    }
    for tool in ["node", "npm"] {
        let found = Command::new(tool).arg("--version").stdout(Stdio::null()).stderr(Stdio::null()).status();
        if !found.is_ok_and(|s| s.success()) {
            bail!("the other side needs Node with npm, and `{tool}` is not on the path");
        }
    }
    eprintln!("installing {} in {} (once)", PACKAGES.join(" and "), home.display());
    let temp = tempfile::Builder::new().prefix(".bench-node-").tempdir_in(&cache)?;
    let made = temp.path().join("node");
    std::fs::create_dir(&made)?;
    let mut npm = Command::new("npm");
    npm.args(["install", "--no-audit", "--no-fund", "--no-package-lock", "--ignore-scripts", "--prefix"]);
    let out = npm.arg(&made).args(PACKAGES).stdout(Stdio::null()).stderr(Stdio::piped()).output();
    let out = out.context("cannot start `npm`")?;
    if !out.status.success() {
        let said = String::from_utf8_lossy(&out.stderr);
        bail!("npm could not install {}; is there a network?\n{}", PACKAGES.join(" and "), said.trim_end());
    }
    put_in_place(&made, &home, "node_modules")?;
    Ok(home)
}
