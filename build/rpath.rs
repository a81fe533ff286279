//! The rpath to libtorch, shared by every package that links it: binaries, tests and examples find
//! it at run time without LD_LIBRARY_PATH, from any folder.

fn main() {
    println!("cargo:rerun-if-env-changed=DEP_TCH_LIBTORCH_LIB");
    if let Ok(lib) = std::env::var("DEP_TCH_LIBTORCH_LIB") {
        // The cache itself, not the workspace's link: a copied binary keeps working.
        let lib = std::fs::canonicalize(&lib).unwrap_or_else(|e| panic!("libtorch at {lib}: {e}"));
        println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());
    }
}
