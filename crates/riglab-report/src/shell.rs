//! Commands that a reader copies into a shell.

/// A call of `riglab` with these arguments, each quoted for a POSIX shell where it has to be. The program goes by its
/// name: where it lay on the machine of a run is of no use elsewhere.
pub fn command<'a>(arguments: impl IntoIterator<Item = &'a str>) -> String {
    shell_words::join(std::iter::once("riglab").chain(arguments))
}

/// An argument as a shell reads it.
pub fn quoted(argument: &str) -> String {
    shell_words::quote(argument).into_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_back_what_was_given() {
        let plain = ["train", "quickstart/fsq_cvae.toml", "--threads", "2", "--run", "runs/a-1"];
        assert_eq!(command(plain), "riglab train quickstart/fsq_cvae.toml --threads 2 --run runs/a-1");
        let list = ["train", "a.toml", "--set", "data.corpora=[\"corpus.h5\"]"];
        assert_eq!(command(list), "riglab train a.toml --set 'data.corpora=[\"corpus.h5\"]'");
        for odd in ["it's", "a b", "", "$HOME", "x;y", "*", "~", "a\nb", "\\", "骨"] {
            let script = format!("riglab() {{ printf %s \"$1\"; }}\n{}", command([odd]));
            let said = std::process::Command::new("sh").args(["-c", &script]).output().unwrap();
            assert_eq!(String::from_utf8(said.stdout).unwrap(), odd);
        }
    }
}
