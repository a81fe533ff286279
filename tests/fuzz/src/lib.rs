//! What every fuzz target does with its bytes, and which targets there are.

#[path = "../../../crates/riglab-asset/tests/common/peak.rs"]
mod peak;

use riglab_asset::{ImportOptions, Resample, import_bytes};

/// The targets, each with the endings of the files it starts from.
pub const TARGETS: [(&str, &[&str]); 4] =
    [("gltf", &["glb", "gltf", "vrm"]), ("obj", &["obj"]), ("fbx", &["fbx"]), ("config_toml", &["toml"])];

/// Bytes as if they were a file of this name: imported with all there is to it, and looked at. What comes out is finite, what does not is
/// told in a sentence of some length, and memory keeps within what the file may ask for.
pub fn asset(name: &str, bytes: &[u8]) {
    let options = ImportOptions { clips: Some(Resample::default()), ..ImportOptions::default() };
    let ((), peak) = peak::of(|| match import_bytes(name, bytes, &options) {
        Ok(imported) => {
            let shown = imported.inspect(true);
            assert!(shown.samples.iter().all(|s| s.position.iter().all(|x| x.is_finite())));
            assert!(shown.joints.iter().all(|j| j.head.iter().all(|x| x.is_finite())));
        }
        Err(error) => {
            let text = error.to_string();
            assert!(text.starts_with(name) && text.len() < 1000, "{text}");
        }
    });
    assert!(peak.is_fair(bytes.len()), "{peak:?} for a file of {}", bytes.len());
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
