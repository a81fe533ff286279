//! Files over files over built-in files, and `--set` over all.

#![allow(missing_docs)]

use std::path::{Path, PathBuf};

use riglab_config::{Config, FaultKind, Loader};

const NONE: &[&str] = &[];

const PRESETS: &[(&str, &str)] = &[
    ("model/small.toml", "extends = 'base.toml'\nwidth = 64\n"),
    ("model/base.toml", "heads = 4\nwidth = 8\ndropout = 0.1\n"),
    ("model/large.toml", "width = 512\nheads = 16\n"),
    ("loop/a.toml", "extends = 'b.toml'\n"),
    ("loop/b.toml", "x.extends = 'a.toml'\n"),
];

/// A folder with files.
fn folder(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, text).unwrap();
    }
    folder
}

/// What went wrong, with the folder left out of the message.
fn message(folder: &Path, error: &riglab_config::ConfigError) -> String {
    error.to_string().replace(&folder.display().to_string(), "DIR")
}

#[test]
fn later_layers_win_and_tables_merge() {
    let dir = folder(&[
        ("a.toml", "extends = ['b.toml', 'c.toml']\nx = 'a'\n[t]\nd = [1]\n"),
        ("b.toml", "x = 'b'\ny = 'b'\nz = 'b'\n[t]\nk = 1\nd = [1, 2, 3]\n"),
        ("c.toml", "y = 'c'\n[t]\nk = 2\n[u]\n"),
    ]);
    let config = Config::load(dir.path().join("a.toml"), &["z=set", "t.k=3"], &[]).unwrap();
    assert_eq!(config.to_toml(), "x = \"a\"\ny = \"c\"\nz = \"set\"\n\n[t]\nd = [1]\nk = 3\n\n[u]\n");
    let shown = config.to_toml_with_origins().replace(&dir.path().display().to_string(), "DIR");
    assert_eq!(
        shown,
        "x = \"a\" # DIR/a.toml:2
y = \"c\" # DIR/c.toml:1
z = \"set\" # --set z=set

[t]
d = [1] # DIR/a.toml:4
k = 3 # --set t.k=3

[u]
"
    );
    assert_eq!(Config::from_toml_str("saved", &shown).unwrap(), config);
}

#[test]
fn names_are_looked_up_beside_the_file_then_in_the_roots_then_built_in() {
    let dir = folder(&[
        ("experiments/one/a.toml", "extends = ['../base.toml', 'near.toml']\n[m]\nextends = 'model/base.toml'\n"),
        ("experiments/base.toml", "from = 'base'\n"),
        ("configs/near.toml", "near = 'far'\n"),
        ("experiments/one/near.toml", "near = 'near'\n[large]\nextends = 'model/small.toml'\n"),
        ("configs/model/base.toml", "heads = 5\n"),
    ]);
    let roots = [dir.path().join("configs")];
    let loader = Loader::new().search(&roots).built_in(PRESETS);
    let config = loader.load(dir.path().join("experiments/one/a.toml"), NONE).unwrap();
    assert_eq!(
        config.to_toml(),
        "from = \"base\"\nnear = \"near\"\n\n[large]\ndropout = 0.1\nheads = 4\nwidth = 64\n\n[m]\nheads = 5\n"
    );
    let from = config.origin("from").unwrap();
    assert_eq!(from.name(), dir.path().join("experiments/base.toml").to_str().unwrap());
    assert_eq!(config.origin("large.heads").unwrap().to_string(), "built-in model/base.toml:1:9");
    // The experiment itself is looked up too.
    assert_eq!(loader.load("near.toml", NONE).unwrap().to_toml(), "near = \"far\"\n");
    assert_eq!(loader.load("model/large.toml", NONE).unwrap().to_toml(), "heads = 16\nwidth = 512\n");
}

#[test]
fn a_table_that_names_a_block_starts_from_it() {
    let dir = folder(&[
        ("base.toml", "[model]\nextends = 'model/small.toml'\nheads = 2\nkind.a.x = 1\n"),
        ("large.toml", "extends = 'base.toml'\n[model]\nextends = 'model/large.toml'\n"),
        ("wider.toml", "extends = 'base.toml'\n[model]\nwidth = 65\nkind = {extends = [], b = {}}\n"),
        ("both.toml", "extends = ['wider.toml', 'large.toml']\n"),
        ("list.toml", "[[m]]\nextends = 'model/large.toml'\n[[m]]\nextends = ['model/large.toml']\nheads = 1\n"),
    ]);
    let load = |name: &str| Loader::new().built_in(PRESETS).load(dir.path().join(name), NONE).unwrap();
    // No dropout, no kind, no heads of the small model.
    let large = "[model]\nheads = 16\nwidth = 512\n";
    assert_eq!(load("large.toml").to_toml(), large);
    assert_eq!(load("both.toml").to_toml(), large);
    let wider = "[model]\ndropout = 0.1\nheads = 2\nwidth = 65\n\n[model.kind.b]\n";
    assert_eq!(load("wider.toml").to_toml(), wider);
    assert_eq!(
        load("list.toml").to_toml(),
        "m = [\n    { heads = 16, width = 512 },\n    { heads = 1, width = 512 },\n]\n"
    );
}

#[test]
fn blocks_can_be_chosen_on_the_command_line() {
    let text = "[model]\nextends = 'model/small.toml'\n";
    let set = |sets: &[&str]| Loader::new().built_in(PRESETS).parse("a.toml", text, sets).map(|c| c.to_toml());
    let large = set(&["model.extends=model/large.toml", "model.heads=3"]).unwrap();
    assert_eq!(large, "[model]\nheads = 3\nwidth = 512\n");
    assert_eq!(
        set(&["model.extends=model/larg.toml"]).unwrap_err().to_string(),
        "--set model.extends=model/larg.toml: `extends` names `model/larg.toml`, which does not exist

hint: did you mean `model/large.toml`?"
    );
    assert_eq!(
        set(&["extends=model/large.toml"]).unwrap_err().to_string(),
        "--set extends=model/large.toml: the experiment's own `extends` cannot be set

hint: name the other file as the experiment"
    );
}

#[test]
fn a_name_without_folder_or_ending_is_known() {
    let said = |name: &str| Loader::new().built_in(PRESETS).load(name, NONE).unwrap_err().to_string();
    for name in ["small", "small.toml", "blocks/small.toml"] {
        assert!(said(name).ends_with("did you mean `model/small.toml`?"), "{}", said(name));
    }
    assert!(!said("smallest").contains("did you mean"), "{}", said("smallest"));
}

#[test]
fn no_folder_is_meant_by_a_name() {
    let dir = folder(&[("nope.toml/a.toml", "")]);
    let said = |name: &str| Config::load(dir.path().join(name), NONE, &[]).unwrap_err().to_string();
    assert!(!said("nope.tom").contains("did you mean"), "{}", said("nope.tom"));
}

#[test]
fn circles_name_the_chain() {
    let dir = folder(&[
        ("a.toml", "extends = 'sub/b.toml'\n"),
        ("sub/b.toml", "\n[x]\nextends = '../c.toml'\n"),
        ("c.toml", "extends = ['./sub/../a.toml']\n"),
        ("self.toml", "extends = 'self.toml'\n"),
    ]);
    let error = Config::load(dir.path().join("a.toml"), NONE, &[]).unwrap_err();
    assert_eq!(error.faults()[0].kind, FaultKind::Cycle);
    assert_eq!(
        message(dir.path(), &error),
        "DIR/c.toml:1:12: `extends` goes in a circle: DIR/a.toml -> DIR/sub/b.toml -> DIR/c.toml -> DIR/a.toml
  |
1 | extends = ['./sub/../a.toml']
  |            ^^^^^^^^^^^^^^^^^"
    );
    assert!(Config::load(dir.path().join("self.toml"), NONE, &[]).is_err());
    let error = Loader::new().built_in(PRESETS).load("loop/a.toml", NONE).unwrap_err();
    let circle = "built-in loop/b.toml:1:13: `extends` goes in a circle: loop/a.toml -> loop/b.toml -> loop/a.toml\n";
    assert!(error.to_string().starts_with(circle), "{error}");
    // The same file twice is no circle.
    let twice = "a.extends = 'model/base.toml'\nb.extends = 'model/base.toml'\n";
    assert!(Loader::new().built_in(PRESETS).parse("x", twice, NONE).is_ok());
}

#[test]
fn missing_and_unreadable_files_are_named() {
    let dir = folder(&[
        ("a.toml", "x = 1\nextends = 'basse.toml'\n"),
        ("base.toml", ""),
        ("far.toml", "extends = ['elsewhere/entirely.toml']"),
        ("three.toml", "extends = [3]"),
        ("latin.toml", "extends = 'bytes.toml'"),
    ]);
    std::fs::write(dir.path().join("bytes.toml"), b"x = '\xff'").unwrap();
    let roots: Vec<PathBuf> = vec![dir.path().join("configs")];
    let fault = |name: &str| message(dir.path(), &Config::load(dir.path().join(name), NONE, &roots).unwrap_err());
    assert_eq!(
        fault("a.toml"),
        "DIR/a.toml:2:11: `extends` names `basse.toml`, which does not exist
  |
2 | extends = 'basse.toml'
  |           ^^^^^^^^^^^^

hint: did you mean `base.toml`?"
    );
    assert_eq!(
        fault("far.toml").lines().last().unwrap(),
        "hint: looked for `DIR/elsewhere/entirely.toml`, `DIR/configs/elsewhere/entirely.toml`"
    );
    assert_eq!(
        fault("three.toml").lines().next().unwrap(),
        "DIR/three.toml:1:12: `extends` should be a path or an array of paths, but is 3"
    );
    assert_eq!(
        fault("latin.toml").lines().next().unwrap(),
        "DIR/latin.toml:1:11: DIR/bytes.toml:1: a letter that is not UTF-8; save the file as UTF-8"
    );
    let folder = Loader::new().load(dir.path(), &[] as &[&str]).unwrap_err().to_string();
    assert!(folder.contains("a folder, not a file") && folder.contains("TOML file"), "{folder}");
    std::fs::write(dir.path().join("config.toml"), "").unwrap();
    let run = Loader::new().load(dir.path(), &[] as &[&str]).unwrap_err().to_string();
    assert!(run.contains("its config is `") && run.contains("config.toml"), "{run}");
    assert_eq!(fault("bsae.toml"), "DIR/bsae.toml: no such file\n\nhint: did you mean `DIR/base.toml`?");
    assert_eq!(
        Config::from_toml_str("t", "extends = 'x.toml'").unwrap_err().to_string(),
        "t:1:11: `extends` names `x.toml`, which does not exist
  |
1 | extends = 'x.toml'
  |           ^^^^^^^^

hint: a text can only extend built-in files"
    );
}
