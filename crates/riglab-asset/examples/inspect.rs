//! Prints what was read from each file given, one JSON object a line; an error is an object with
//! `file` and `error`. With `--all-vertices`, every vertex is a sample.

use std::io::{self, Write};

use riglab_asset::{ImportOptions, import};

fn main() -> io::Result<()> {
    let (options, files): (Vec<String>, Vec<String>) = std::env::args().skip(1).partition(|a| a.starts_with("--"));
    let all_vertices = options.iter().any(|o| o == "--all-vertices");
    let mut out = io::BufWriter::new(io::stdout().lock());
    for file in files {
        match import(&file, &ImportOptions::default()) {
            Ok(imported) => serde_json::to_writer(&mut out, &imported.inspect(all_vertices))?,
            Err(error) => {
                let error = serde_json::json!({ "file": error.file, "error": error.fault.to_string() });
                serde_json::to_writer(&mut out, &error)?;
            }
        }
        writeln!(out)?;
    }
    out.flush()
}
