//! What is saved loads back, and no text panics.

#![allow(missing_docs)]

use riglab_config::{Config, Loader};

const ALL: &str = r#"
int = -3
big = 18446744073709551615
small = -9223372036854775808
hex = 0xff
float = 1e-05
whole = 2.0
tiny = 5e-324
huge = 1.7976931348623157e308
nothing = -0.0
odd = [nan, -nan, inf, -inf]
text = "a \"quoted\" \\ line\nand\ttab \u0001 é 漢 # no comment"
long = """
two
lines"""
"odd key" = 1
"" = 2
'"' = 3
empty = []
nested = [[1, 2], [], ["x", [true]]]
tables = [{a = 1, b = {c = []}}, {}]
a.b.c = 1
a.d = {}
[z]
[z.y.x]
v = 1
[[w]]
k = 1
[[w]]
k.j = 2
"#;

#[test]
fn every_kind_of_value_survives() {
    let config = Config::from_toml_str("all.toml", ALL).unwrap();
    for text in [config.to_toml(), config.to_toml_with_origins()] {
        let again = Config::from_toml_str("again.toml", &text).unwrap_or_else(|e| panic!("{e}\n{text}"));
        assert_eq!(again, config);
        assert_eq!(again.to_toml(), config.to_toml());
        assert!(config.diff(&again).is_empty());
        // Others read it too, but for integers above 2^63.
        let plain: String = text.lines().filter(|l| !l.starts_with("big")).collect::<Vec<_>>().join("\n");
        assert!(plain.parse::<toml::Table>().is_ok(), "{plain}");
    }
    assert_eq!(config.get_at::<f64>("tiny").unwrap(), 5e-324);
    assert_eq!(config.get_at::<u32>("w[1].k.j").unwrap(), 2);
    assert!(config.contains("\"odd key\"") && !config.contains("w[2]"));
}

#[test]
fn the_resolved_config_needs_nothing_else() {
    let presets = [("m.toml", "x = 1\n[t]\ny = 2\n")];
    let config = Loader::new().built_in(&presets).parse("a.toml", "extends = 'm.toml'\nz = 3", &["t.y=4"]).unwrap();
    assert_eq!(Config::from_toml_str("config.toml", &config.to_toml_with_origins()).unwrap(), config);
}

#[test]
fn defaults_can_be_written_out() {
    #[derive(Debug, serde::Deserialize, serde::Serialize, PartialEq)]
    #[serde(default)]
    struct Model {
        width: usize,
        dropout: f32,
        kind: Kind,
        note: Option<String>,
    }
    #[derive(Debug, serde::Deserialize, serde::Serialize, PartialEq)]
    enum Kind {
        Plain,
        Deep { layers: u32, skip: Option<bool> },
    }
    impl Default for Model {
        fn default() -> Self {
            Self { width: 8, dropout: 0.1, kind: Kind::Plain, note: None }
        }
    }
    let text = "seed = 1\n[model]\nextends = []\nwidth = 9\nkind.Deep.layers = 2\n";
    let mut config = Config::from_toml_str("a.toml", text).unwrap();
    let model: Model = config.get_at("model").unwrap();
    config.fill("model", &model).unwrap();
    assert_eq!(
        config.to_toml_with_origins(),
        "seed = 1 # a.toml:1

[model]
dropout = 0.1 # default
width = 9 # a.toml:4

[model.kind.Deep]
layers = 2 # a.toml:5
"
    );
    assert_eq!(config.get_at::<Model>("model").unwrap(), model);
}

#[test]
fn origins_with_line_breaks_stay_comments() {
    let config = Loader::new().parse("a\nb = 1\n.toml", "x = 1", &["y=\"\"\"\nz = 1\n\"\"\""]).unwrap();
    assert_eq!(Config::from_toml_str("again", &config.to_toml_with_origins()).unwrap(), config);
}

/// Texts near TOML: pieces of the one above put together wrongly.
#[test]
fn no_text_panics() {
    #[derive(serde::Deserialize)]
    #[allow(dead_code)]
    struct Shape {
        int: u8,
        text: String,
        a: std::collections::BTreeMap<String, Vec<f32>>,
    }
    let mut state = 1u64;
    let mut next = |below: usize| {
        state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (state >> 33) as usize % below
    };
    let junk = [b'"', b'\'', b'[', b']', b'{', b'}', b'=', b'.', b'\n', b'#', b'\\', 0xc3, 0xff, 0, b'e', b'-', b','];
    let mut accepted = 0;
    for _ in 0..4000 {
        // A run of whole lines with up to three bytes changed.
        let lines: Vec<&str> = ALL.lines().collect();
        let start = next(lines.len());
        let run = &lines[start..start + 1 + next(lines.len() - start)];
        let mut bytes = (run.join("\n") + "\n").into_bytes();
        for _ in 0..next(4) {
            let at = next(bytes.len());
            bytes[at] = junk[next(junk.len())];
        }
        let text = String::from_utf8_lossy(&bytes);
        match Config::from_toml_str("x", &text) {
            Ok(config) => {
                accepted += 1;
                let saved = config.to_toml_with_origins();
                assert_eq!(Config::from_toml_str("y", &saved).unwrap(), config, "{text}");
                if let Err(error) = config.get::<Shape>() {
                    assert!(!error.to_string().is_empty());
                }
            }
            Err(error) => assert!(error.to_string().starts_with("x"), "{error}"),
        }
        let _ = Loader::new().parse("x", "int = 1\na.b = 2", &[text.lines().next().unwrap_or("")]);
    }
    assert!(accepted > 500, "{accepted}");
}

#[test]
fn every_prefix_of_a_text_is_handled() {
    for at in (0..=ALL.len()).filter(|&at| ALL.is_char_boundary(at)) {
        if let Err(error) = Config::from_toml_str("x", &ALL[..at]) {
            error.to_string();
        }
    }
}
