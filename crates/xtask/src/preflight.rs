//! What must be on the machine before anything is fetched: a C++ compiler that links, and Python
//! with pip. Each fault is one sentence with its remedy.

use std::ffi::{OsStr, OsString};
use std::path::Path;

use anyhow::{Result, bail};

use crate::shell;

/// What the check found.
pub struct Found {
    /// A build tool for cmake is on the path (`make`); else ninja is fetched.
    pub make: bool,
}

/// Checks the compiler; Python is checked only when something has to be fetched.
pub fn check() -> Result<Found> {
    if !wheels_run() && crate::libtorch::own().is_none() {
        bail!(
            "set-up knows libtorch for Linux on x86_64 only, this is {} on {}; \
                 point LIBTORCH at a libtorch {} of your own",
            std::env::consts::OS,
            std::env::consts::ARCH,
            crate::libtorch::VERSION
        );
    }
    compiler()?;
    Ok(Found { make: shell::output("make", &["--version"]).is_some() })
}

/// Whether what is fetched runs here.
pub fn wheels_run() -> bool {
    std::env::consts::OS == "linux" && std::env::consts::ARCH == "x86_64"
}

/// Compiles and links a C++17 program: a compiler without its library or linker shows here, not
/// after ten minutes.
fn compiler() -> Result<()> {
    let cxx: OsString = std::env::var_os("CXX").unwrap_or_else(|| "c++".into());
    let shown = cxx.to_string_lossy().into_owned();
    let words = words(&cxx);
    let compiler = |args: &[&str]| {
        let mut command = std::process::Command::new(&words[0]);
        command.args(&words[1..]).args(args);
        command
    };
    if !compiler(&["--version"]).output().is_ok_and(|out| out.status.success()) {
        bail!("no C++ compiler: `{shown}` does not run; install one (Debian, Ubuntu: apt install g++) or set CXX");
    }
    let dir = tempfile::tempdir()?;
    let source = dir.path().join("probe.cpp");
    std::fs::write(&source, "#include <optional>\nint main() { std::optional<int> x = 0; return *x; }\n")?;
    let binary = dir.path().join("probe");
    let args = ["-std=c++17", path(&source), "-o", path(&binary)];
    let out = compiler(&args).output()?;
    if !out.status.success() {
        let message = String::from_utf8_lossy(&out.stderr);
        let line = message.lines().find(|l| l.contains("error")).unwrap_or("no message");
        bail!(
            "`{shown}` cannot build a C++17 program ({line}); install a working one (Debian, Ubuntu: apt install g++)"
        );
    }
    Ok(())
}

/// The program and arguments that a variable such as `CXX` names, as the crates that build C++ read it: the path of a
/// program, in which there may be spaces, or words such as `ccache g++`.
fn words(variable: &OsStr) -> Vec<OsString> {
    let text = variable.to_string_lossy();
    match Path::new(variable).exists() || text.trim().is_empty() {
        true => vec![variable.to_owned()],
        false => text.split_whitespace().map(Into::into).collect(),
    }
}

/// The Python that can fetch wheels.
pub fn python() -> Result<OsString> {
    let python: OsString = std::env::var_os("PYTHON").unwrap_or_else(|| "python3".into());
    let shown = python.to_string_lossy().into_owned();
    if shell::output(&python, &["--version"]).is_none() {
        bail!(
            "no Python 3: `{shown}` does not run; install it (Debian, Ubuntu: apt install python3 python3-pip), set PYTHON, or fetch the wheels elsewhere and run `cargo xtask setup --wheels DIR`"
        );
    }
    if shell::output(&python, &["-m", "pip", "--version"]).is_none() {
        bail!(
            "`{shown}` has no pip; install it (Debian, Ubuntu: apt install python3-pip), or fetch the wheels elsewhere and run `cargo xtask setup --wheels DIR`"
        );
    }
    Ok(python)
}

fn path(p: &Path) -> &str {
    p.to_str().expect("temporary paths are UTF-8")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_compiler_may_be_several_words() {
        let of = |text: &str| words(OsStr::new(text));
        assert_eq!(of("g++"), ["g++"]);
        assert_eq!(of(" ccache  g++ "), ["ccache", "g++"]);
        let dir = tempfile::tempdir().unwrap();
        let odd = dir.path().join("my g++");
        std::fs::write(&odd, "").unwrap();
        assert_eq!(words(odd.as_os_str()), [odd.as_os_str()]);
        assert_eq!(of(""), [""]);
    }
}
