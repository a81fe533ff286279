//! The rpath to libtorch, shared by every package that links it: binaries, tests and examples find
//! it at run time without LD_LIBRARY_PATH, from any folder. Likewise to MPI, where it is asked for.

pub(crate) fn main() {
    println!("cargo:rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    if let Ok(lib) = std::env::var("DEP_TCH_LIBTORCH_LIB") {
        // The cache itself, not the workspace's link: a copied binary keeps working.
        let lib = std::fs::canonicalize(&lib).unwrap_or_else(|e| panic!("libtorch at {lib}: {e}"));
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());
    }
    if std::env::var_os("CARGO_FEATURE_MPI").is_some() {
        mpi();
    }
}

/// The rpath to the MPI of `mpicc`, which may stand anywhere: in a cluster's module or a Python environment.
fn mpi() {
    println!("cargo:rerun-if-env-changed=MPICC");
    println!("cargo:rerun-if-env-changed=PATH");
    let compiler = std::env::var("MPICC").unwrap_or_else(|_| "mpicc".into());
    let Ok(out) = std::process::Command::new(&compiler).arg("-show").output() else { return };
    for word in String::from_utf8_lossy(&out.stdout).split_whitespace() {
        if let Some(folder) = word.strip_prefix("-L") {
            println!("cargo:rustc-link-arg=-Wl,-rpath,{folder}");
        }
    }
}
