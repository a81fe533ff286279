//! The forms of `--set`.

#![allow(missing_docs)]

use riglab_config::{ConfigError, Loader};

fn set(sets: &[&str]) -> Result<String, ConfigError> {
    let text = "n = 1\nl = [1, {x = 2}]\n[t]\nk = 1\n";
    Loader::new().parse("a.toml", text, sets).map(|config| config.to_toml())
}

/// The line that differs after one argument.
fn changed(text: &str) -> String {
    let (before, after) = (set(&[]).unwrap(), set(&[text]).unwrap());
    after.lines().filter(|line| !line.is_empty() && !before.contains(line)).collect::<Vec<_>>().join("; ")
}

#[test]
fn values_are_toml_or_bare_words() {
    for (text, line) in [
        ("t.k=2", "k = 2"),
        ("t.k = 2 ", "k = 2"),
        ("t.k=-1_000", "k = -1000"),
        ("t.k=0x10", "k = 16"),
        ("t.k=1e-4", "k = 0.0001"),
        ("t.k=inf", "k = inf"),
        ("t.k=true", "k = true"),
        ("t.k=\"x y\"", "k = \"x y\""),
        ("t.k='='", "k = \"=\""),
        ("t.k=[1,2]", "k = [1, 2]"),
        ("t.k=[\"a\", 'b']", "k = [\"a\", \"b\"]"),
        ("t.k={a=1, b.c=2}", "[t.k]; a = 1; [t.k.b]; c = 2"),
        ("t={z=1}", "z = 1"),
        ("t.k=word", "k = \"word\""),
        ("t.k=two words", "k = \"two words\""),
        ("t.k=a=b", "k = \"a=b\""),
        ("t.k=1.2.3", "k = \"1.2.3\""),
        // A time limit, and a folder named by a day: no key is a time or date.
        ("t.k=12:00:00", "k = \"12:00:00\""),
        ("t.k=2026-01-01", "k = \"2026-01-01\""),
        ("t.k=runs/x.toml", "k = \"runs/x.toml\""),
        ("t.k=1 # no comment", "k = \"1 # no comment\""),
        ("t.k=True", "k = \"True\""),
        ("t.k=\"\"", "k = \"\""),
        ("t.\"a=b\".'c d'=3", "[t.\"a=b\"]; \"c d\" = 3"),
        ("l=[]", "l = []"),
        ("new.deep.key=1", "[new.deep]; key = 1"),
    ] {
        assert_eq!(changed(text), line, "{text}");
    }
}

#[test]
fn later_arguments_win() {
    assert!(set(&["t.k=2", "t.k=3", "t.j=4"]).unwrap().ends_with("[t]\nj = 4\nk = 3\n"));
}

#[test]
fn bad_forms_are_refused() {
    for (text, message) in [
        ("t.k", "--set t.k: there is no `=`\n\nhint: write `--set key.path=value`"),
        ("t.k=", "--set t.k=: there is no value after the `=`\n\nhint: write `\"\"` for an empty string"),
        ("t.k=[1,", "--set t.k=[1,: this value is not TOML\n\nhint: quote it for the shell: `--set 'layers=[1, 2]'`"),
        (
            "=3",
            "--set =3: this is no path of keys before the `=`\n\nhint: write `--set key.path=value`, such as `model.width=384`",
        ),
        (
            "l.x=3",
            "--set l.x=3: `l` is an array of 2 values (set at a.toml:2:5) and has no keys\n\nhint: set the whole array: `--set 'l=[..]'`",
        ),
        ("n.x.y=3", "--set n.x.y=3: `n` is 1 (set at a.toml:1:5) and has no keys"),
    ] {
        assert_eq!(set(&[text]).unwrap_err().to_string(), message);
    }
    for text in [
        "",
        "=",
        "a..b=1",
        "a b=1",
        "[a]=1",
        "#=1",
        "a.=1",
        "a\n=1",
        "'a=1",
        "a=\"x",
        "a={",
        "a='",
        "a=x\ny",
        "a=[2026-01-01]",
    ] {
        assert!(set(&[text]).is_err(), "{text}");
    }
    // An inline table is meant to replace.
    assert_eq!(changed("n={x=1}"), "[n]; x = 1");
}

#[test]
fn a_misspelt_argument_is_named_where_it_was_given() {
    #[derive(Debug, serde::Deserialize)]
    #[allow(dead_code)]
    struct Only {
        steps: u32,
    }
    let config = Loader::new().parse("a.toml", "steps = 3", &["step=4", "steps=x"]).unwrap();
    assert_eq!(
        config.get::<Only>().unwrap_err().to_string(),
        "--set step=4: unknown key `step`

hint: did you mean `steps`?

--set steps=x: `steps` should be a whole number from 0 to 4294967295, but is the string \"x\""
    );
}
