//! Running other programs.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use anyhow::{Context, Result, bail};

/// The root of the workspace.
pub fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("crates/xtask has two ancestors").to_path_buf()
}

/// What a variable of the environment names, unless that is the workspace's `own`: `.cargo/config.toml` sets it to this for
/// everything that cargo starts, us included.
pub fn set_to(variable: &str, own: &str) -> Option<PathBuf> {
    std::env::var_os(variable).map(PathBuf::from).filter(|set| *set != root().join(own))
}

/// A program of the workspace, built for release.
pub fn built(name: &str) -> PathBuf {
    // Cargo is started in the root, so that one that is not whole is below it.
    let target = std::env::var_os("CARGO_TARGET_DIR").unwrap_or_else(|| "target".into());
    root().join(target).join("release").join(name)
}

/// Runs cargo in the workspace; its output goes to the user.
pub fn cargo(args: &[&str]) -> Result<()> {
    run(&mut cargo_command(args))
}

/// Cargo in the workspace, told to the user.
pub fn cargo_command(args: &[&str]) -> Command {
    eprintln!("$ cargo {}", args.join(" "));
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(args).current_dir(root());
    command
}

/// Runs a command to its end; an exit code other than 0 is an error.
pub fn run(command: &mut Command) -> Result<()> {
    let name = command.get_program().to_string_lossy().into_owned();
    let status = command.status().with_context(|| format!("cannot start `{name}`"))?;
    if !status.success() {
        bail!("`{name}` ended with {status}");
    }
    Ok(())
}

/// Standard output of a command that succeeds, else `None`.
pub fn output(program: impl AsRef<OsStr>, args: &[&str]) -> Option<String> {
    let out = Command::new(program).args(args).output().ok()?;
    out.status.success().then(|| String::from_utf8_lossy(&out.stdout).trim().to_string())
}
