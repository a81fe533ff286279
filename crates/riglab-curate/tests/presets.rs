//! The presets are valid, and say what their comments say.

use std::path::Path;

use riglab_config::Loader;
use riglab_curate::{CurateConfig, StageName};

fn preset(name: &str) -> CurateConfig {
    let configs = [Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs")];
    let path = configs[0].join("curation").join(name);
    let loaded = Loader::new().search(&configs).load(path, &[] as &[&str]).unwrap();
    let config: CurateConfig = loaded.get().unwrap();
    config.validate().unwrap();
    config
}

#[test]
fn all_presets_load() {
    let rig_xl = preset("rig_xl.toml");
    assert_eq!((rig_xl.bones.min, rig_xl.bones.max, rig_xl.tree.skeletons), (10, 256, 1));
    let vroid = preset("vroid.toml");
    assert!(vroid.humanoid.complete && vroid.weights == rig_xl.weights && vroid.stages.contains(&StageName::Humanoid));
    let any = preset("any.toml");
    assert_eq!(any, CurateConfig { stages: vec![StageName::Duplicates], ..CurateConfig::default() });
}
