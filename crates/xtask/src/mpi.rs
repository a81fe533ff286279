//! riglab with MPI: what building it needs, and its test.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};

use crate::shell;
use crate::venv::Venv;

/// MPICH, for who has no MPI, and the library by which its header is read.
const VENV: Venv = Venv {
    folder: "mpi-venv-1",
    requirements: &["mpich==5.0.2", "libclang==18.1.1"],
    megabytes: 150,
    check: "import os, sys, clang; assert os.path.exists(os.path.join(sys.prefix, 'bin', 'mpicc'))",
};

/// Builds riglab with MPI and tests it.
pub fn run() -> Result<()> {
    prepare()?;
    // The test's build is the program's, too.
    shell::cargo(&[
        "test",
        "--release",
        "--workspace",
        "--features",
        "riglab/mpi",
        "--test",
        "mpi",
        "--",
        "--nocapture",
    ])?;
    let program = shell::built("riglab");
    let launcher = which("mpirun").unwrap_or_else(|| "mpirun".into());
    println!(
        "{} trains as several processes now:\n  {launcher} -n 2 {0} train CONFIG --set train.accumulate=2",
        program.display()
    );
    Ok(())
}

/// Sees to it that `mpicc` and libclang are found by what is started from here.
pub fn prepare() -> Result<()> {
    let has_mpi = which("mpicc").is_some();
    let has_clang = std::env::var_os("LIBCLANG_PATH").is_some() || clang();
    if has_mpi && has_clang {
        return Ok(());
    }
    let home = VENV.ensure()?;
    if !has_clang {
        let code = "import clang, os; print(os.path.join(os.path.dirname(clang.__file__), 'native'))";
        let path = shell::output(home.join("bin/python"), &["-c", code])
            .context("libclang was installed, but is not found")?;
        // SAFETY: no other thread runs yet.
        unsafe { std::env::set_var("LIBCLANG_PATH", path) };
    }
    if !has_mpi {
        let path = std::env::var_os("PATH").unwrap_or_default();
        let all = std::iter::once(home.join("bin")).chain(std::env::split_paths(&path));
        // SAFETY: as above.
        unsafe { std::env::set_var("PATH", std::env::join_paths(all)?) };
        if which("mpicc").is_none() {
            bail!("MPICH was installed in {}, but its mpicc does not start", home.display());
        }
    }
    Ok(())
}

/// A program on the path.
fn which(program: &str) -> Option<String> {
    let path = std::env::var_os("PATH")?;
    let found = std::env::split_paths(&path).map(|dir| dir.join(program)).find(|file| file.is_file())?;
    Some(found.display().to_string())
}

/// Whether the system has a libclang, by which bindings are made from headers.
fn clang() -> bool {
    let multiarch = format!("/usr/lib/{}-linux-gnu", std::env::consts::ARCH);
    let llvm = entries(Path::new("/usr/lib")).into_iter().filter(|dir| name(dir).starts_with("llvm-"));
    let mut folders: Vec<PathBuf> = vec!["/usr/lib".into(), "/usr/lib64".into(), multiarch.into()];
    folders.extend(llvm.map(|dir| dir.join("lib")));
    // libclang-cpp is another library.
    let is_clang = |file: &PathBuf| {
        let name = name(file);
        name.starts_with("libclang.so") || (name.starts_with("libclang-") && !name.starts_with("libclang-cpp"))
    };
    folders.iter().any(|dir| entries(dir).iter().any(is_clang))
}

fn entries(dir: &Path) -> Vec<PathBuf> {
    std::fs::read_dir(dir).into_iter().flatten().flatten().map(|entry| entry.path()).collect()
}

fn name(path: &Path) -> String {
    path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()
}
