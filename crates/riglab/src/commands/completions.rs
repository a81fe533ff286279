//! `riglab completions`

use std::process::ExitCode;

use anyhow::Result;
use clap::CommandFactory;
use clap_complete::{Shell, generate};

/// Write a script by which a shell completes commands, options and file names.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab completions bash > ~/.local/share/bash-completion/completions/riglab
  riglab completions zsh > ~/.zfunc/_riglab       # with ~/.zfunc in fpath
  riglab completions fish > ~/.config/fish/completions/riglab.fish")]
pub struct Args {
    /// The shell.
    #[arg(value_enum)]
    shell: Shell,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    say!("{}", script(args.shell).trim_end());
    Ok(ExitCode::SUCCESS)
}

fn script(shell: Shell) -> String {
    let mut script = Vec::new();
    generate(shell, &mut crate::Cli::command(), "riglab", &mut script);
    String::from_utf8_lossy(&script).into_owned()
}

#[cfg(test)]
mod tests {
    use clap::ValueEnum;

    use super::*;

    #[test]
    fn every_shell_learns_commands_and_options() {
        for &shell in Shell::value_variants() {
            let script = script(shell);
            assert!(["dataset", "rewards", "skip-existing"].iter().all(|word| script.contains(word)), "{shell}");
        }
    }
}
