//! `riglab strip`

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_asset::{ImportOptions, Warning, export, import};

use super::earlier::{Overwrite, Written};
use super::file_to_write;

/// Take the rig out of a file: skins, weights, joints with the empty nodes on them, their animations, humanoid and springs of
/// VRM.
///
/// The mesh stands as the file shows it; where that is another pose than it was bound in, it stands as it was bound, and a
/// warning says so. Materials, pictures, morph targets and names stay.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab strip fox.glb bare.glb
  riglab strip avatar.vrm avatar.glb
  riglab strip --in-place fox.glb fox.glb")]
pub struct Args {
    /// GLB, glTF or VRM.
    input: PathBuf,
    /// The GLB to write; one that riglab wrote is replaced when the new one is whole.
    #[arg(value_parser = file_to_write())]
    output: PathBuf,
    /// Let the output take the place of the input.
    #[arg(long)]
    in_place: bool,
    #[command(flatten)]
    overwrite: Overwrite,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let Args { input, output, in_place, overwrite } = args;
    if input.is_dir() {
        bail!("{} is a folder; one file is stripped at a time", input.display());
    }
    if !output.extension().is_some_and(|e| e.eq_ignore_ascii_case("glb")) {
        bail!("{}: only GLB is written, with all that belongs to it inside; name it .glb", output.display());
    }
    let same = export::same_file(input, output);
    if !in_place && same {
        bail!(
            "{} is the input itself\n\nhint: give another name, or --in-place to replace it by the stripped file",
            output.display()
        );
    }
    // In its own place it is what it was; what else is there stays.
    if !same {
        overwrite.keep_others(output, Written::Glb)?;
    }
    for warning in import(input, &ImportOptions::default())?.warnings() {
        let told = matches!(
            warning,
            Warning::RestIsNotBind { .. } | Warning::Bent { .. } | Warning::Reshaped { .. } | Warning::Instanced { .. }
        );
        if told {
            tell!("warning: {}: {warning}", input.display());
        }
    }
    riglab_files::make_folder_of(output)?;
    let stripped = export::strip(input, &ImportOptions::default())?;
    export::write(output, &stripped.bytes).with_context(|| format!("{} cannot be written", output.display()))?;
    for note in &stripped.notes {
        tell!("note: {note}");
    }
    say!("{}", output.display());
    Ok(ExitCode::SUCCESS)
}
