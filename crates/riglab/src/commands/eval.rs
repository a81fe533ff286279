//! `riglab eval`

use std::fs;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use anyhow::{Context, Result, anyhow};
use riglab_task::fsq_cvae::{Evaluation, Report, Row};
use riglab_train::{Checkpoint, Progress, Task};
use tch::Device;

use crate::presets;
use crate::registry::TaskConfig;

/// Evaluate a run's checkpoint on whole meshes of the test splits.
///
/// Prints the table; writes eval.json and pictures of the best and the worst into the run's folder.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab eval runs/fsq_cvae/001
  riglab eval runs/fsq_cvae/001 --checkpoint last --set eval.prefixes='[4, 32]' --json")]
pub struct Args {
    /// The run's folder.
    run: PathBuf,
    /// Which checkpoint: best, last or step-N.
    #[arg(long, default_value = "best")]
    checkpoint: String,
    /// Change a value of the run's config.
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Print eval.json instead of the table.
    #[arg(long)]
    json: bool,
    /// Where to write the result [default: RUN/eval.json]; pictures stand beside, in FILE without ending.
    #[arg(long, short, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Best and worst assets of each split to draw.
    #[arg(long, default_value_t = 2, value_name = "N")]
    pictures: usize,
}

pub fn run(args: &Args, threads: usize) -> Result<ExitCode> {
    riglab_torch::init(riglab_torch::Settings { threads });
    let config = TaskConfig::read(&presets::load(&args.run.join("config.toml").to_string_lossy(), &args.sets)?)?;
    let task = config.open(Device::Cpu)?;
    let checkpoint = Checkpoint::open(&args.run.join("checkpoints").join(&args.checkpoint))?;
    checkpoint.load_weights(task.params())?;
    let weights = task.params().weights();
    let total = task.evaluation_assets().map_err(|e| anyhow!(e))? as u64;
    let mut progress = Progress::new("evaluating", total, 0);
    let report = task.evaluate(weights, |done| progress.set(done as u64, String::new));
    progress.finish();
    let report = report.map_err(|e| anyhow!(e))?;
    let sheets = match args.pictures {
        0 => Vec::new(),
        each => task.gallery(weights, &report, each).map_err(|e| anyhow!(e))?,
    };
    let path = args.out.clone().unwrap_or_else(|| args.run.join("eval.json"));
    let folder = path.with_extension("");
    for (shown, png) in &sheets {
        fs::create_dir_all(&folder).with_context(|| format!("{} cannot be made", folder.display()))?;
        write(&folder.join(&shown.file), png)?;
    }
    let gallery = sheets.into_iter().map(|(shown, _)| shown).collect();
    let evaluation = Evaluation { checkpoint: checkpoint.state().clone(), report, gallery };
    let text = serde_json::to_string_pretty(&evaluation)? + "\n";
    write(&path, text.as_bytes())?;
    if args.json {
        print!("{text}")
    } else {
        print(&evaluation.report);
        eprintln!("next: riglab report {}", args.run.display());
    }
    Ok(ExitCode::SUCCESS)
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    riglab_files::write(path, bytes).with_context(|| format!("{} cannot be written", path.display()))
}

fn print(report: &Report) {
    say!("convention {}, decode rule: cut {}, top 4", report.convention, report.cut);
    for split in report.codebook.keys() {
        let rows: Vec<&Row> = report.rows.iter().filter(|r| r.split == *split).collect();
        say!("\n{split} ({} assets)", rows.first().map_or(0, |r| r.assets));
        say!(
            "{:28} {:>6} {:>7} {:>8} {:>8} {:>6} {:>6} {:>6}",
            "method",
            "tokens",
            "IoU",
            "per rig",
            "L1",
            "prec.",
            "recall",
            "mask"
        );
        for r in rows {
            let tokens = if r.tokens == 0 { String::new() } else { r.tokens.to_string() };
            let p = &r.pooled;
            say!(
                "{:28} {tokens:>6} {:>7.4} {:>8.4} {:>8.5} {:>6.3} {:>6.3} {:>6.3}",
                r.method,
                p.iou,
                r.per_rig.iou,
                p.l1,
                p.precision,
                p.recall,
                r.per_rig.mask_cover_bone
            );
        }
        let c = &report.codebook[split];
        say!(
            "codes: {} of {} tokens differ, utilisation {:.4}, perplexity {:.0}",
            c.distinct,
            c.tokens,
            c.utilisation,
            c.perplexity
        );
    }
}
