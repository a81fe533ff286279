//! Compiles the shim against the headers of the libtorch that torch-sys links.

use std::path::Path;

const FILES: [&str; 10] = [
    "shim.cpp",
    "attention.cpp",
    "block.cpp",
    "dropout.cpp",
    "linear.cpp",
    "recompute.cpp",
    "rows.cpp",
    "hooks.cpp",
    "parts.cpp",
    "memory.cpp",
];

fn main() {
    for file in FILES.iter().chain(&["shim.h", "linear.h"]) {
        println!("cargo:rerun-if-changed=src/{file}");
    }
    let Ok(lib) = std::env::var("DEP_TCH_LIBTORCH_LIB") else {
        panic!("torch-sys did not say where libtorch is; run `cargo xtask setup` in the root of the workspace");
    };
    let lib = std::fs::canonicalize(&lib).unwrap_or_else(|e| panic!("libtorch at {lib}: {e}"));
    let include = lib.parent().unwrap_or(Path::new("/")).join("include");
    cc::Build::new()
        .cpp(true)
        .std("c++17")
        .warnings(false) // libtorch's headers have theirs
        .define("NDEBUG", None) // as libtorch was built: some of its classes are larger without
        .include(&include)
        .include(include.join("torch/csrc/api/include"))
        .files(FILES.map(|file| format!("src/{file}")))
        .compile("riglab_shim");
    // Tests of this crate find libtorch as all packages do (build/rpath.rs).
    println!("cargo:rustc-link-arg=-Wl,-rpath,{}", lib.display());
}
