//! What configs say about augmentation.

use std::path::Path;

use riglab_augment::Recipe;
use riglab_config::Loader;

fn parse(text: &str) -> Result<Recipe, String> {
    let none: [&str; 0] = [];
    let search = [Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs")];
    let loader = Loader::new().search(&search);
    let recipe: Recipe = loader.parse("test.toml", text, &none).and_then(|c| c.get()).map_err(|e| e.to_string())?;
    recipe.validate().map_err(|(key, message)| format!("{key}: {message}"))?;
    Ok(recipe)
}

#[test]
fn config_files_are_the_presets() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../configs/augment");
    let files = std::fs::read_dir(folder).unwrap().count();
    assert_eq!(files, Recipe::presets().len(), "each file of configs/augment stands in Recipe::presets(), too");
    for (name, preset) in Recipe::presets() {
        assert_eq!(parse(&format!("extends = 'augment/{name}.toml'")).unwrap(), preset, "{name}");
    }
}

#[test]
fn a_preset_is_changed_by_what_stands_below_it() {
    let recipe = parse("extends = 'augment/unirig_ar.toml'\npose.degrees = 10\ncube.shift = 'inside'").unwrap();
    let mut wanted = Recipe::unirig_ar();
    wanted.pose.degrees = 10.0;
    wanted.cube.shift = riglab_augment::Shift::Inside;
    assert_eq!(recipe, wanted);
}

#[test]
fn values_that_make_no_sense_are_refused_by_their_key() {
    for (text, key) in [
        ("pose = { probability = 1.5 }", "pose.probability"),
        ("pose = { scale = [2.0, 1.0] }", "pose.scale"),
        ("delete = { up_to = -0.5 }", "delete.up_to"),
        ("part = { keep = 2.0 }", "part.keep"),
        ("reconnect = { share = nan }", "reconnect.share"),
        ("scale = { range = [0.0, 1.0] }", "scale.range"),
        ("turn_x = { probability = 1.0 }", "turn_x.degrees"),
        ("flip = { probability = [0.0, 2.0, 0.0] }", "flip.probability"),
        ("rotate = { degrees = 400.0 }", "rotate.degrees"),
        ("axes = { probability = -1.0 }", "axes.probability"),
        ("cube = { into = [1.0, 1.0] }", "cube.into"),
        ("cube = { shift = { up_to = -1.0 } }", "cube.shift"),
        ("jitter = { sigma = 5.0 }", "jitter.sigma"),
        ("joint_noise = { clip = inf }", "joint_noise.clip"),
        ("discretise = { cells = 0 }", "discretise.cells"),
        ("trim = { enable = true }", "trim"),
        ("poses = { degrees = 1.0 }", "poses"),
    ] {
        let fault = parse(text).unwrap_err();
        assert!(fault.contains(key), "{text}: {fault}");
    }
}
