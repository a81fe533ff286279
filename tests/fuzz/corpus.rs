//! Fills `corpus/TARGET` with the seeds beside this file and the small files of the folders named:
//! `cargo run --example corpus -- FOLDER...` in this folder.

use std::fs;
use std::path::Path;

/// Larger files only slow the fuzzer down.
const SMALL: u64 = 64 << 10;

fn main() -> std::io::Result<()> {
    let here = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut folders = vec![here.join("seeds")];
    folders.extend(std::env::args().skip(1).map(Into::into));
    for (target, endings) in riglab_fuzz::TARGETS {
        let corpus = here.join("corpus").join(target);
        fs::create_dir_all(&corpus)?;
        let mut copied = 0;
        for entry in folders.iter().map(fs::read_dir).collect::<Result<Vec<_>, _>>()?.into_iter().flatten() {
            let path = entry?.path();
            let of_target = path.extension().is_some_and(|e| endings.iter().any(|w| e == *w));
            if of_target && path.metadata()?.len() <= SMALL {
                fs::copy(&path, corpus.join(path.file_name().unwrap_or_default()))?;
                copied += 1;
            }
        }
        println!("{target}: {copied} files");
    }
    Ok(())
}
