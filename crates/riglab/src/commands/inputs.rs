//! What a command takes of a folder.

use std::cell::Cell;
use std::path::Path;

use riglab_files::Below;
use riglab_report::counted;

/// The files of `folder` and those below it that are `wanted`, but for those in `out`, the folder or file that is written
/// to, where it lies below the inputs: what an earlier call wrote there is no input. That and what cannot be read is told.
pub fn below(folder: &Path, out: &Path, what: &str, wanted: impl Fn(&Path) -> bool) -> Below {
    let real = |path: &Path| path.canonicalize().ok();
    // A folder, or a file that holds all.
    let within = real(out).filter(|out| real(folder).is_some_and(|folder| *out != folder && out.starts_with(folder)));
    let own = |path: &Path| within.as_ref().is_some_and(|out| real(path).is_some_and(|path| path.starts_with(out)));
    let passed = Cell::new(0);
    let found = riglab_files::below(folder, |path| {
        let (wanted, own) = (wanted(path), own(path));
        passed.set(passed.get() + usize::from(wanted && own));
        wanted && !own
    });
    if passed.get() > 0 {
        let place = if out.is_dir() { "in the output folder " } else { "written before, " };
        tell!("note: not taken as input: {} {place}{}", counted(passed.get(), what), out.display());
    }
    if let Some(hidden) = found.left_aside() {
        tell!("note: {hidden}");
    }
    for (path, why) in &found.unread {
        tell!("left out: {}: {why}", path.display());
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_written_below_the_inputs_is_no_input() {
        let dir = tempfile::tempdir().unwrap();
        for name in ["a.glb", "sub/b.glb", "out/a.glb", "out/sub/b.glb"] {
            let path = dir.path().join(name);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"x").unwrap();
        }
        let taken = |out: &Path| {
            let files = below(dir.path(), out, "model", |_| true).files;
            files.iter().map(|f| f.strip_prefix(dir.path()).unwrap().to_str().unwrap().to_owned()).collect::<Vec<_>>()
        };
        assert_eq!(taken(&dir.path().join("out")), ["a.glb", "sub/b.glb"]);
        assert_eq!(taken(&dir.path().join("sub/b.glb")), ["a.glb", "out/a.glb", "out/sub/b.glb"]);
        // Beside the inputs, above them, or not there yet.
        for out in [dir.path(), dir.path().parent().unwrap(), &dir.path().join("new")] {
            assert_eq!(taken(out).len(), 4);
        }
    }
}
