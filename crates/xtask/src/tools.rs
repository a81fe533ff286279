//! cmake (and ninja, where there is no make) for the static HDF5.
//!
//! `.tools/bin/cmake` is where `.cargo/config.toml` sends the build: a small script that runs the
//! system's cmake, or the one fetched into the user's cache.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::fetch::{self, Source, Wheel};
use crate::preflight::{Found, wheels_run};
use crate::shell;

const CMAKE: Wheel = Wheel {
    requirement: "cmake==3.31.10",
    sha256: "2f766bb46367e5e0559fa33184653754bce044583a06014dcaebf8e6dff8a1f1",
    megabytes: 28,
};
const NINJA: Wheel = Wheel {
    requirement: "ninja==1.13.0",
    sha256: "fb46acf6b93b8dd0322adc3a4945452a4e774b75b91293bafcc7b7f8e6517dfa",
    megabytes: 1,
};
/// HDF5 2 asks for this much.
const CMAKE_MINIMUM: (u32, u32) = (3, 26);

/// Makes sure that `.tools/bin/cmake` works, unless the environment names another cmake.
pub fn ensure(found: &Found, source: &Source) -> Result<()> {
    if let Some(own) = shell::set_to("CMAKE", ".tools/bin/cmake") {
        if shell::output(&own, &["--version"]).is_none() {
            bail!("CMAKE is set to {}, which does not run; point it at a cmake or unset it", own.display());
        }
        return Ok(());
    }
    let script = shell::root().join(".tools/bin/cmake");
    let cmake = match system_cmake() {
        Some(path) => path,
        None if !wheels_run() => {
            let (major, minor) = CMAKE_MINIMUM;
            bail!("no cmake {major}.{minor} or newer: install one, or set CMAKE to one");
        }
        None => fetched("cmake-3.31.10", &CMAKE, source, "cmake/data/", "bin/cmake")?,
    };
    let ninja = match found.make {
        true => None,
        false => Some(fetched("ninja-1.13.0", &NINJA, source, "ninja-1.13.0.data/scripts/", "ninja")?),
    };
    let text = script_text(&cmake, ninja.as_deref());
    if fs::read_to_string(&script).is_ok_and(|old| old == text) {
        return Ok(());
    }
    let dir = script.parent().expect("the script is in a folder");
    fs::create_dir_all(dir)?;
    let new = tempfile::NamedTempFile::new_in(dir)?;
    fs::write(new.path(), text)?;
    fs::set_permissions(new.path(), fs::Permissions::from_mode(0o755))?;
    new.persist(&script).with_context(|| format!("cannot write {}", script.display()))?;
    Ok(())
}

fn script_text(cmake: &Path, ninja: Option<&Path>) -> String {
    let mut text = String::from("#!/bin/sh\n# Written by `cargo xtask setup`.\n");
    if let Some(dir) = ninja.and_then(Path::parent) {
        text += &format!("export CMAKE_GENERATOR=Ninja PATH={}:\"$PATH\"\n", quoted(dir));
    }
    text + &format!("exec {} \"$@\"\n", quoted(cmake))
}

/// A path as a shell reads it, whatever is in it.
fn quoted(path: &Path) -> String {
    format!("'{}'", path.display().to_string().replace('\'', "'\\''"))
}

/// The cmake on the user's path, if new enough.
fn system_cmake() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    let file = std::env::split_paths(&path).map(|d| d.join("cmake")).find(|f| f.is_file())?;
    let text = shell::output(&file, &["--version"])?;
    let mut numbers = text.split_whitespace().nth(2)?.split('.').map_while(|n| n.parse().ok());
    let version: (u32, u32) = (numbers.next()?, numbers.next()?);
    (version >= CMAKE_MINIMUM).then_some(file)
}

/// A tool out of a wheel, kept in the cache; gives the path of its program.
fn fetched(name: &str, wheel: &Wheel, source: &Source, prefix: &str, program: &str) -> Result<PathBuf> {
    let cache = fetch::cache()?;
    let home = cache.join(name);
    if !home.join(program).is_file() {
        let temp = fetch::temporary(&cache, ".tool-")?;
        fetch::need_space(&cache, 150, name)?;
        let file = wheel.fetch(source, temp.path())?;
        let made = temp.path().join("made");
        fetch::unpack(&file, |member| member.strip_prefix(prefix).map(|rest| made.join(rest)))?;
        for entry in fs::read_dir(made.join(program).parent().expect("a program is in a folder"))? {
            fs::set_permissions(entry?.path(), fs::Permissions::from_mode(0o755))?;
        }
        if let Err(e) = fs::rename(&made, &home)
            && !home.join(program).is_file()
        {
            return Err(e).with_context(|| format!("cannot put {name} at {}", home.display()));
        }
    }
    Ok(home.join(program))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_runs_a_program_whatever_its_folder_is_called() {
        let dir = tempfile::tempdir().unwrap();
        let odd = dir.path().join("o'neil $HOME");
        fs::create_dir(&odd).unwrap();
        let program = odd.join("cmake");
        fs::write(&program, "#!/bin/sh\necho \"ran $1\"\n").unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        let text = script_text(&program, Some(&odd.join("ninja")));
        assert_eq!(shell::output("sh", &["-c", &text, "sh", "it"]).as_deref(), Some("ran it"));
    }
}
