//! The `riglab` command.
//!
//! Results go to standard output, progress and messages to standard error. Exit codes: 0 done, 1
//! failed, 2 wrong use, 130 interrupted by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP.

#[macro_use]
mod say;

mod commands;
mod memory;
mod offered;
mod parting;
mod presets;
mod registry;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// The version, with the commit that was built where sources know it.
const VERSION: &str = env!("RIGLAB_VERSION");

/// Training research for automatic rigging: corpora, models, evaluation, reports.
#[derive(Parser)]
#[command(version = VERSION, about, propagate_version = true, max_term_width = 100)]
struct Cli {
    /// Threads that compute; 0 takes all processors. With 1, what a network is given is prepared on up to two others beside it.
    #[arg(long, global = true, default_value_t = 0, value_name = "N", value_parser = clap::value_parser!(u16).range(..=4096))]
    threads: u16,
    #[command(subcommand)]
    command: Command,
}

#[derive(Subcommand)]
enum Command {
    Rig(commands::rig::RigArgs),
    Skin(commands::rig::SkinArgs),
    Inspect(commands::inspect::Args),
    View(commands::view::Args),
    Convert(commands::convert::Args),
    Strip(commands::strip::Args),
    Simulate(commands::simulate::Args),
    Synth(commands::synth::Args),
    Curate(commands::curate::Args),
    Review(commands::review::Args),
    Dataset(commands::dataset::Args),
    Tokens(commands::tokens::Args),
    Train(commands::train::Args),
    Eval(commands::eval::Args),
    Sweep(commands::sweep::Args),
    Compare(commands::compare::Args),
    Rewards(commands::rewards::Args),
    Report(commands::report::Args),
    Checkpoint(commands::checkpoint::Args),
    Doctor(commands::doctor::Args),
    Completions(commands::completions::Args),
    #[command(hide = true)]
    SlurmTask(commands::slurm::task::Args),
}

/// Takes files that are half-written along when the process is asked to leave, and tells how to go on where there is a way.
fn leave_clean() {
    // Where signals cannot be listened to, the default ends the process all the same.
    let _ = riglab_files::on_signals(|signal| {
        parting::tell();
        riglab_files::leave(signal.code().into())
    });
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    memory::ends_in_a_sentence();
    // Training, sweeps, reviews and tasks of a cluster leave by their own rules, and so does who waits for these.
    let own_rules = match &cli.command {
        Command::Curate(args) => args.waits(),
        Command::Train(_) | Command::Sweep(_) | Command::Review(_) | Command::SlurmTask(_) => true,
        _ => false,
    };
    if !own_rules {
        leave_clean();
    }
    let threads = usize::from(cli.threads);
    let computes = match &cli.command {
        Command::Train(_) | Command::Eval(_) | Command::Rig(_) | Command::Skin(_) | Command::SlurmTask(_) => true,
        Command::Simulate(args) => args.computes(),
        _ => false,
    };
    if threads != 1 && computes {
        riglab_torch::wait_patiently();
    }
    // A network sets up its own threads, and so does a curation; jobs of a sweep are processes.
    let sets_up = matches!(cli.command, Command::Curate(_) | Command::Sweep(_) | Command::Doctor(_));
    if threads > 0 && !computes && !sets_up {
        let _ = rayon::ThreadPoolBuilder::new().num_threads(threads).build_global();
    }
    let done = match cli.command {
        Command::Rig(args) => commands::rig::rig(&args, threads),
        Command::Skin(args) => commands::rig::skin(&args, threads),
        Command::Checkpoint(args) => commands::checkpoint::run(&args),
        Command::Inspect(args) => commands::inspect::run(&args),
        Command::View(args) => commands::view::run(&args),
        Command::Convert(args) => commands::convert::run(&args),
        Command::Strip(args) => commands::strip::run(&args),
        Command::Simulate(args) => commands::simulate::run(&args, threads),
        Command::Synth(args) => commands::synth::run(&args),
        Command::Compare(args) => commands::compare::run(&args),
        Command::Rewards(args) => commands::rewards::run(&args),
        Command::Report(args) => commands::report::run(&args),
        Command::Curate(args) => commands::curate::run(&args, threads),
        Command::SlurmTask(args) => commands::slurm::task::run(&args, threads),
        Command::Review(args) => commands::review::run(&args),
        Command::Dataset(args) => commands::dataset::run(&args),
        Command::Doctor(args) => commands::doctor::run(&args, threads),
        Command::Completions(args) => commands::completions::run(&args),
        Command::Tokens(args) => commands::tokens::run(&args),
        Command::Train(args) => commands::train::run(&args, threads),
        Command::Sweep(args) => commands::sweep::run(&args, threads),
        Command::Eval(args) => commands::eval::run(&args, threads),
    };
    match done {
        Ok(code) => code,
        Err(e) => {
            tell!("error: {e:#}");
            ExitCode::FAILURE
        }
    }
}
