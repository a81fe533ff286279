//! Every fault as the user reads it.

#![allow(missing_docs, dead_code)]

use std::collections::BTreeMap;
use std::num::NonZeroUsize;

use riglab_config::{Config, FaultKind, Loader};
use serde::Deserialize;
use serde::de::IgnoredAny;

#[derive(Debug, Deserialize)]
struct Experiment {
    model: Model,
    #[serde(default)]
    train: Train,
    #[serde(default)]
    sources: Vec<Source>,
}

#[derive(Debug, Deserialize)]
struct Model {
    width: usize,
    heads: u8,
    #[serde(default)]
    scale: f32,
    #[serde(default)]
    quantizer: Quantizer,
}

#[derive(Debug, Default, Deserialize, PartialEq)]
enum Quantizer {
    #[default]
    #[serde(rename = "none")]
    None,
    #[serde(rename = "fsq")]
    Fsq { levels: Vec<u32> },
    #[serde(rename = "vq")]
    Vq(Codebook),
}

#[derive(Debug, Deserialize, PartialEq)]
struct Codebook {
    codes: NonZeroUsize,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Train {
    steps: i64,
    lr: f64,
    betas: [f32; 2],
    resume: bool,
    note: Option<String>,
    by_kind: BTreeMap<String, f32>,
}

#[derive(Debug, Deserialize)]
struct Source {
    path: std::path::PathBuf,
}

/// The message for a text, and the kinds of its faults.
fn fault(text: &str) -> (String, Vec<FaultKind>) {
    let error = match Config::from_toml_str("a.toml", text) {
        Ok(config) => config.get::<Experiment>().expect_err(text),
        Err(error) => error,
    };
    (error.to_string(), error.faults().iter().map(|f| f.kind).collect())
}

/// The message of the one fault of a text with a sound `[model]` before it.
fn train_fault(text: &str) -> String {
    fault(&format!("[model]\nwidth = 8\nheads = 2\n{text}")).0
}

#[test]
fn unknown_keys_are_all_refused_with_the_nearest_known() {
    let (text, kinds) = fault("[model]\nwidht = 3\nheads = 2\n[train]\nfoo.bar = 1\n");
    assert_eq!(
        text,
        "a.toml:2:1: unknown key `model.widht`
  |
2 | widht = 3
  | ^^^^^

hint: did you mean `width`?

a.toml:1:1: `model.width` is missing
  |
1 | [model]
  | ^^^^^^^"
    );
    assert_eq!(kinds, [FaultKind::UnknownKey, FaultKind::MissingKey]);
    assert_eq!(
        train_fault("[train]\nfoo.bar = 1\nbetta = 2\n"),
        "a.toml:6:1: unknown key `train.betta`
  |
6 | betta = 2
  | ^^^^^

hint: did you mean `betas`?

a.toml:5:1: unknown key `train.foo`
  |
5 | foo.bar = 1
  | ^^^

hint: keys known here: `steps`, `lr`, `betas`, `resume`, `note`, `by_kind`"
    );
}

#[test]
fn a_missing_table_is_named_in_its_file() {
    assert_eq!(fault("").0, "a.toml: `model` is missing");
    assert_eq!(
        train_fault("[[sources]]\npath = 'x'\n[[sources]]\n"),
        "a.toml:6:1: `sources[1].path` is missing\n  |\n6 | [[sources]]\n  | ^^^^^^^^^^^"
    );
}

#[test]
fn wrong_types_say_what_should_be_and_what_is() {
    assert_eq!(
        train_fault("[train]\nlr = \".5\"\n"),
        "a.toml:5:6: `train.lr` should be a number, but is the string \".5\"
  |
5 | lr = \".5\"
  |      ^^^^"
    );
    let first = |text: &str| train_fault(text).lines().next().unwrap().to_owned();
    for (text, message) in [
        ("steps = 1.0", "5:9: `train.steps` should be a whole number, but is 1.0"),
        ("steps = [1]", "5:9: `train.steps` should be a whole number, but is an array of 1 value"),
        ("resume = 1", "5:10: `train.resume` should be `true` or `false`, but is 1"),
        ("note = 1", "5:8: `train.note` should be a string, but is 1"),
        ("betas = 1", "5:9: `train.betas` should be an array of 2 values, but is 1"),
        ("betas = [1, 'x']", "5:13: `train.betas[1]` should be a number, but is the string \"x\""),
        ("by_kind = {x = {}}", "5:16: `train.by_kind.x` should be a number, but is a table"),
        ("by_kind = {'a b' = []}", "5:20: `train.by_kind.\"a b\"` should be a number, but is an array of 0 values"),
    ] {
        assert_eq!(first(&format!("[train]\n{text}")), format!("a.toml:{message}"));
    }
    assert_eq!(fault("model = 3").0.lines().next().unwrap(), "a.toml:1:9: `model` should be a table, but is 3");
    assert_eq!(fault("model = 3").1, [FaultKind::WrongType]);
}

#[test]
fn ranges_are_named() {
    for (text, message) in [
        ("width = -1\nheads = 1", "a.toml:2:9: `model.width` should not be negative, but is -1"),
        ("width = 1\nheads = 256", "a.toml:3:9: `model.heads` should be a whole number from 0 to 255, but is 256"),
        (
            "width = 1\nheads = 1\nscale = 1e39",
            "a.toml:4:9: `model.scale` should be a number of at most 3.4028235e38, but is 1e39",
        ),
        (
            "width = 1\nheads = 1\nquantizer.vq.codes = 0",
            "a.toml:4:22: `model.quantizer.vq.codes` should be a nonzero usize, but is integer `0`",
        ),
    ] {
        let (shown, kinds) = fault(&format!("[model]\n{text}"));
        assert_eq!(shown.lines().next().unwrap(), message);
        assert_eq!(kinds, [FaultKind::OutOfRange], "{text}");
    }
    assert!(train_fault("[train]\nbetas = [1]").contains("`train.betas` should be an array of 2 values, but has 1\n"));
    let steps = train_fault("[train]\nsteps = 18446744073709551615");
    assert!(steps.contains("should be a whole number of at most 9223372036854775807, but is 18446744073709551615\n"));
}

#[test]
fn choices_are_checked_like_keys() {
    let model = |text: &str| fault(&format!("[model]\nwidth = 1\nheads = 1\n{text}\n")).0;
    assert_eq!(
        model("quantizer = 'fqs'"),
        "a.toml:4:13: `fqs` is no choice for `model.quantizer`
  |
4 | quantizer = 'fqs'
  |             ^^^^^

hint: did you mean `fsq`?"
    );
    assert_eq!(
        model("[model.quantizer.rvq]\ndepth = 1"),
        "a.toml:4:18: `rvq` is no choice for `model.quantizer`
  |
4 | [model.quantizer.rvq]
  |                  ^^^

hint: did you mean `vq`?"
    );
    assert_eq!(
        model("quantizer = 'fsq'"),
        "a.toml:4:13: `model.quantizer`: `fsq` needs settings
  |
4 | quantizer = 'fsq'
  |             ^^^^^

hint: write them under `model.quantizer.fsq`"
    );
    assert_eq!(
        model("[model.quantizer]\nfsq.levels = [8]\nvq.codes = 3"),
        "a.toml:6:1: `model.quantizer` should be one choice, but has `fsq` and `vq`
  |
6 | vq.codes = 3
  | ^^

hint: `extends = []` in `model.quantizer` drops what lower layers chose"
    );
    let first = |text: &str| model(text).lines().next().unwrap().to_owned();
    assert_eq!(first("quantizer.fsq.level = [1]"), "a.toml:4:15: unknown key `model.quantizer.fsq.level`");
    assert_eq!(
        first("quantizer.none.x = 1"),
        "a.toml:4:11: `model.quantizer.none` should be an empty table, the choice has no settings, but is a table"
    );
    assert_eq!(first("quantizer = 3"), "a.toml:4:13: `model.quantizer` should be one of `none`, `fsq`, `vq`, but is 3");
}

#[test]
fn choices_are_read_in_each_form() {
    let read = |text: &str| {
        let text = format!("width = 1\nheads = 1\n{text}");
        Config::from_toml_str("a", &text).unwrap().get::<Model>().unwrap().quantizer
    };
    assert_eq!(read("quantizer = 'none'"), Quantizer::None);
    assert_eq!(read("[quantizer.none]"), Quantizer::None);
    assert_eq!(read("quantizer.fsq.levels = [8, 5]"), Quantizer::Fsq { levels: vec![8, 5] });
    assert_eq!(read("quantizer.vq.codes = 5"), Quantizer::Vq(Codebook { codes: NonZeroUsize::new(5).unwrap() }));
}

#[test]
fn texts_that_are_not_toml_are_refused_at_the_place() {
    assert_eq!(
        fault("a = 1\nb = [1,\n").0,
        "a.toml:2:8: not TOML: unclosed array, expected `]`
  |
2 | b = [1,
  |        ^"
    );
    let first = |text: &str| fault(text).0.lines().next().unwrap().to_owned();
    assert_eq!(first("a = 1\na = 2"), "a.toml:2:1: not TOML: duplicate key");
    assert_eq!(
        first("= 2"),
        "a.toml:1:1: not TOML: unquoted keys cannot be empty, expected letters, numbers, `-`, `_`"
    );
    assert_eq!(first("a = 18446744073709551616"), "a.toml:1:5: this integer does not fit into 64 bits");
    assert_eq!(first("a = 1e999"), "a.toml:1:5: this number is too large for a 64-bit float");
    assert_eq!(
        fault("day = 2026-01-01").0,
        "a.toml:1:7: configs know no dates
  |
1 | day = 2026-01-01
  |       ^^^^^^^^^^

hint: write it as a string, in quotes"
    );
}

#[test]
fn a_task_reports_faults_of_its_own() {
    let config = Config::from_toml_str("small.toml", "[model]\nwidth = 100\n").unwrap();
    let model = config.table("model").unwrap();
    let error = model.invalid("width", "100 is not divisible by the 3 heads");
    assert_eq!(
        error.and(model.invalid("heads", "at least 1")).with_hint("the paper takes 12").to_string(),
        "small.toml:2:9: `model.width`: 100 is not divisible by the 3 heads
  |
2 | width = 100
  |         ^^^

small.toml:1:1: `model.heads` (not set, its default): at least 1
  |
1 | [model]
  | ^^^^^^^

hint: the paper takes 12"
    );
}

#[test]
fn a_fault_at_a_built_in_value_tells_what_a_person_set_against_it() {
    let built_in = [("small.toml", "[model]\nframe = true\nlevels = [8, 8, 8, 8]\nwidth = 8\n[train]\nlevels = 3\n")];
    let parse = |sets: &[&str]| {
        Loader::new().built_in(&built_in).parse("own.toml", "extends = 'small.toml'\n[model]\nwidth = 9", sets)
    };
    let said = |sets: &[&str], key: &str, message: &str| parse(sets).unwrap().invalid(key, message).to_string();
    let frames =
        said(&["model.levels=[8, 8]", "train.levels=4"], "model.frame", "give at least four levels, not fewer");
    assert!(frames.starts_with("built-in small.toml:2:9: `model.frame`: give at least four levels"), "{frames}");
    assert!(frames.ends_with("hint: `model.levels = [8, 8]` is from --set model.levels=[8, 8]"), "{frames}");
    // Other tables' keys count by their whole names, and what is built in explains nothing.
    let other = said(&["train.levels=4"], "model.frame", "more levels than train.levels = 4.");
    assert!(other.ends_with("hint: `train.levels = 4` is from --set train.levels=4"), "{other}");
    let file = said(&[], "model.levels", "too many for the width");
    assert!(file.ends_with("hint: `model.width = 9` is from own.toml:3:9"), "{file}");
    // Where a person set the value itself, that is the place.
    assert!(!said(&["model.frame=true", "model.levels=[8]"], "model.frame", "more levels").contains("hint"));
    assert!(!said(&[], "model.frame", "give at least four levels").contains("hint"));
}

#[test]
fn custom_types_report_at_their_value() {
    #[derive(Debug, Deserialize)]
    #[serde(try_from = "u32")]
    struct Even(u32);
    impl TryFrom<u32> for Even {
        type Error = String;
        fn try_from(n: u32) -> Result<Self, String> {
            if n.is_multiple_of(2) { Ok(Self(n)) } else { Err(format!("{n} is odd")) }
        }
    }
    let config = Config::from_toml_str("a.toml", "x.y = 2\nx.z = [4, 3]").unwrap();
    assert_eq!(config.get_at::<Even>("x.y").unwrap().0, 2);
    let error = config.get::<BTreeMap<String, BTreeMap<String, Vec<Even>>>>().unwrap_err().to_string();
    assert!(error.starts_with("a.toml:1:7: `x.y` should be an array, but is 2"), "{error}");
    let error = config.get_at::<Vec<Even>>("x.z").unwrap_err().to_string();
    assert!(error.starts_with("a.toml:2:11: `x.z[1]`: 3 is odd"), "{error}");
}

#[test]
fn a_value_for_an_array_is_told_how_to_be_one() {
    #[derive(Debug, Deserialize)]
    struct Start {
        parts: Vec<String>,
    }
    let said = |value: &str| {
        let config = Config::from_toml_str("a.toml", &format!("parts = {value}")).unwrap();
        config.get::<Start>().unwrap_err().to_string()
    };
    assert_eq!(
        said("'mesh_encoder'"),
        "a.toml:1:9: `parts` should be an array, but is the string \"mesh_encoder\"
  |
1 | parts = 'mesh_encoder'
  |         ^^^^^^^^^^^^^^

hint: put it in brackets: [\"mesh_encoder\"]"
    );
    for value in ["3", "true", "{ a = 1 }"] {
        let said = said(value);
        assert!(said.starts_with("a.toml:1:9: `parts` should be an array, but is "), "{said}");
        assert!(said.ends_with("hint: each of its values should be a string"), "{said}");
    }
}

#[test]
fn parts_are_read_one_at_a_time() {
    #[derive(Debug, Deserialize)]
    struct Outer {
        task: String,
        model: IgnoredAny,
    }
    let text = "task = 'fsq'\nseed = 18446744073709551615\n[model]\nwidth = 8\nheads = 2\nsub.x = 1\n";
    let config = Config::from_toml_str("a.toml", text).unwrap();
    assert_eq!(config.get_at::<&str>("task").unwrap(), "fsq");
    assert_eq!(config.get_at::<u64>("seed").unwrap(), u64::MAX);
    assert!(config.get::<Outer>().unwrap_err().to_string().starts_with("a.toml:2:1: unknown key `seed`"));
    assert_eq!(config.keys().collect::<Vec<_>>(), ["model", "seed", "task"]);
    assert_eq!(
        config.check_keys(&["task", "model", "sed"]).unwrap_err().to_string(),
        "a.toml:2:1: unknown key `seed`\n  |\n2 | seed = 18446744073709551615\n  | ^^^^\n\nhint: did you mean `sed`?"
    );
    let model = config.table("model").unwrap();
    assert!(model.get::<Model>().unwrap_err().to_string().starts_with("a.toml:6:1: unknown key `model.sub`"));
    assert_eq!(
        model.get_at::<u32>("sub.y").unwrap_err().to_string(),
        "a.toml:6:1: nothing sets `model.sub.y`\n  |\n6 | sub.x = 1\n  | ^^^"
    );
    assert!(config.table("modle").unwrap_err().to_string().ends_with("hint: there is `model`; is it misspelt?"));
    assert!(config.table("task").unwrap_err().to_string().contains("`task` should be a table, but is the string"));
}
