//! The rpath to libtorch, and the commit that is built.

use std::process::Command;

#[path = "../../build/rpath.rs"]
mod rpath;

fn main() {
    rpath::main();
    // `include_dir!` (presets.rs) follows the files that are there, not those that are added.
    println!("cargo:rerun-if-changed=build.rs\ncargo:rerun-if-changed=../../build/rpath.rs");
    println!("cargo:rerun-if-changed=../../configs\ncargo:rerun-if-changed=../../experiments");
    let git = |args: &[&str]| {
        let out = Command::new("git").args(args).output().ok().filter(|out| out.status.success())?;
        Some(String::from_utf8_lossy(&out.stdout).trim().to_string())
    };
    // Sources that stand in no repository, or in somebody else's, are told by their version alone.
    let own = git(&["ls-files", "build.rs"]).is_some_and(|file| !file.is_empty());
    let commit = git(&["rev-parse", "--short=12", "HEAD"]).filter(|_| own);
    // A file that is not there would count as changed each time.
    let log = git(&["rev-parse", "--git-path", "logs/HEAD"]);
    if let Some(log) = log.filter(|log| std::path::Path::new(log).exists()) {
        println!("cargo:rerun-if-changed={log}");
    }
    let version = env!("CARGO_PKG_VERSION");
    let version = commit.map_or(version.to_string(), |commit| format!("{version} ({commit})"));
    println!("cargo:rustc-env=RIGLAB_VERSION={version}");
}
