//! What every fuzz target does with its bytes, and which targets there are.

#[path = "../../../crates/riglab-asset/tests/common/peak.rs"]
mod peak;
mod zipped;

use riglab_asset::{ImportError, ImportOptions, Imported, Resample, TensorFile, import, import_bytes};
pub use zipped::mutate as mutate_archive;

/// The targets, each with the endings of the files it starts from.
pub const TARGETS: [(&str, &[&str]); 11] = [
    ("gltf", &["glb", "gltf", "vrm"]),
    ("obj", &["obj"]),
    ("ply", &["ply"]),
    ("stl", &["stl"]),
    ("fbx", &["fbx"]),
    ("npz", &["npz"]),
    ("pt", &["pt"]),
    ("ckpt", &["ckpt"]),
    ("h5", &["h5"]),
    ("rig_txt", &["txt", "pair"]),
    ("config_toml", &["toml"]),
];

/// Bytes as if they were a file of this name: imported with all there is to it, and looked at. What
/// comes out is finite, what does not is told in a sentence of some length, and memory keeps within
/// what the file may ask for.
pub fn asset(name: &str, bytes: &[u8]) {
    let options = ImportOptions { clips: Some(Resample::default()), ..ImportOptions::default() };
    let ((), peak) = peak::of(|| looked_at(name, import_bytes(name, bytes, &options)));
    assert!(peak.is_fair(bytes.len()), "{peak:?} for a file of {}", bytes.len());
}

/// As [`asset`], for the peers' formats, whose readers may hold less. Of files of several assets the
/// first is read, which asks for more than their number does.
pub fn peer(name: &str, bytes: &[u8]) {
    let options = ImportOptions { item: Some(0), ..ImportOptions::default() };
    let (imported, peak) = peak::of(|| import_bytes(name, bytes, &options));
    assert!(peak.is_lean(name, bytes.len()), "{peak:?} for a file of {}", bytes.len());
    looked_at(name, imported);
}

/// As [`peer`], of a checkpoint: every tensor is read.
pub fn checkpoint(bytes: &[u8]) {
    let work = || -> Result<(), ImportError> {
        let mut file = TensorFile::from_bytes("fuzz.ckpt", bytes)?;
        let names: Vec<String> = file.shapes().map(|(name, _)| name.to_owned()).collect();
        names.iter().try_for_each(|name| file.read(name).map(drop))
    };
    let (read, peak) = peak::of(work);
    assert!(peak.is_lean("fuzz.ckpt", bytes.len()), "{peak:?} for a file of {}", bytes.len());
    if let Err(error) = read {
        let text = error.to_string();
        assert!(text.starts_with("fuzz.ckpt") && text.len() < 1000, "{text}");
    }
}

/// A rig text alone or, with a byte 0 and an OBJ behind it, beside that OBJ in a folder.
pub fn rig_text(bytes: &[u8]) {
    let Some(end) = bytes.iter().position(|b| *b == 0) else { return peer("fuzz.txt", bytes) };
    static FOLDER: std::sync::LazyLock<tempfile::TempDir> =
        std::sync::LazyLock::new(|| tempfile::tempdir().expect("a folder for the pair"));
    let (text, mesh) = (FOLDER.path().join("fuzz_rig.txt"), FOLDER.path().join("fuzz.obj"));
    std::fs::write(&text, &bytes[..end]).expect("room for the text");
    std::fs::write(mesh, &bytes[end + 1..]).expect("room for the mesh");
    // Repairs read on where others refuse.
    let options = ImportOptions { repair: true, ..ImportOptions::default() };
    let (imported, peak) = peak::of(|| import(&text, &options));
    assert!(peak.is_lean("fuzz.txt", bytes.len()), "{peak:?} for a file of {}", bytes.len());
    looked_at(&text.to_string_lossy(), imported);
}

fn looked_at(name: &str, imported: Result<Imported, ImportError>) {
    match imported {
        Ok(imported) => {
            let shown = imported.inspect(true);
            assert!(shown.samples.iter().all(|s| s.position.iter().all(|x| x.is_finite())));
            assert!(shown.joints.iter().all(|j| j.head.iter().all(|x| x.is_finite())));
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.starts_with(name) && text.len() < 1000, "{text}");
        }
    }
}

/// Text as a configuration: read, written with the places of its values, and read again.
pub fn config(bytes: &[u8]) {
    let Ok(text) = std::str::from_utf8(bytes) else { return };
    match riglab_config::Config::from_toml_str("fuzz.toml", text) {
        Ok(config) => {
            let saved = config.to_toml_with_origins();
            let again = riglab_config::Config::from_toml_str("saved.toml", &saved).expect("what was saved loads");
            assert!(again == config, "{saved}");
        }
        Err(error) => assert!(error.to_string().starts_with("fuzz.toml")),
    }
}
