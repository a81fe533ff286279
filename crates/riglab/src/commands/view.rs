//! `riglab view`

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::{Context, Result, bail};
use riglab_asset::rigging::UpAxis;
use riglab_asset::{Character, ImportOptions, import};
use riglab_core::{Bounds, JointId, Mesh, Rig, Skeleton};
use riglab_files::make_folder_of;
use riglab_render::{
    Palette, Picture, Theme, View, contact_sheet, joint_weights, render_mesh, render_parts, render_skeleton,
    render_weights,
};

use super::earlier::{Overwrite, Written};
use super::file_to_write;
use riglab_report::counted;

/// Draw a file: its skeleton through its mesh, and its weights.
///
/// From the front, the side and behind. The weights of a rig are shown in the colours of its joints; with --bone, those
/// of single joints as heat, grey where a joint holds nothing. A file without a rig shows its mesh.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab view fox.glb --png fox.png
  riglab view fox.glb --png tail.png --bone tail_2 --bone head
  riglab view fox.obj --png fox.png --up z
  riglab view corpus.npz --png one.png --item 12 --dark")]
pub struct Args {
    /// A model of any format that riglab reads.
    file: PathBuf,
    /// The picture to write.
    #[arg(long, value_name = "FILE", value_parser = file_to_write())]
    png: PathBuf,
    /// Show the weights of this joint, by its name; as often as needed.
    #[arg(long = "bone", value_name = "NAME")]
    bones: Vec<String>,
    /// The axis that points up in the file; in PLY and STL, which do not say, it often is z.
    #[arg(long, default_value = "y", value_name = "AXIS", allow_hyphen_values = true)]
    up: UpAxis,
    /// Pixels along the longer side of each picture.
    #[arg(long, default_value_t = 420, value_name = "N", value_parser = clap::value_parser!(u32).range(32..=2048))]
    size: u32,
    /// On near-black instead of white.
    #[arg(long)]
    dark: bool,
    /// Of a file of several assets this one, counted from 0.
    #[arg(long, value_name = "N")]
    item: Option<usize>,
    /// One of several characters in a file: its number, from 0, or the name of its root.
    #[arg(long, value_name = "WHICH")]
    character: Option<Character>,
    #[command(flatten)]
    overwrite: Overwrite,
}

/// Names of the sides, how far around they are, and how far above.
const SIDES: [(&str, f32, f32); 3] = [("front", 20.0, 8.0), ("side", 90.0, 8.0), ("back", 200.0, 8.0)];
/// Names of joints that are told where one is not there.
const TOLD: usize = 8;

pub fn run(args: &Args) -> Result<ExitCode> {
    if !args.png.extension().is_some_and(|e| e.eq_ignore_ascii_case("png")) {
        bail!("{}: only PNG is written; name it .png", args.png.display());
    }
    args.overwrite.keep_others(&args.png, Written::Picture)?;
    let options = ImportOptions { item: args.item, character: args.character.clone(), ..ImportOptions::default() };
    let imported = import(&args.file, &options)?;
    for warning in imported.warnings() {
        tell!("note: {}: {warning}", args.file.display());
    }
    let shown = args.file.display();
    let (mesh, rig) = turned(imported.mesh(), imported.rig(), args.up).with_context(|| shown.to_string())?;
    let heads = rig.iter().flat_map(|rig| rig.skeleton().heads().iter());
    let bounds = Bounds::of(mesh.positions().iter().chain(heads).copied());
    let bounds = bounds.with_context(|| format!("{shown}: there is nothing in it to draw"))?;
    let theme = if args.dark { Theme::Dark } else { Theme::Light };
    // What faces -z by its format is gone around, so that its front is one.
    let about = if imported.reading.faces_back { 180.0 } else { 0.0 };
    let seen = |yaw, pitch| sized(args.size, bounds).turned(yaw + about, pitch).framed(bounds).themed(theme);
    let views: Vec<(&str, View)> = SIDES.iter().map(|&(side, yaw, pitch)| (side, seen(yaw, pitch))).collect();
    let mut cells: Vec<(String, Picture)> = Vec::new();
    let mut row = |what: &str, draw: &dyn Fn(&View) -> Picture| {
        cells.extend(views.iter().map(|(side, view)| (format!("{what}, {side}"), draw(view))));
    };
    let what = match &rig {
        None if !args.bones.is_empty() => bail!("{shown}: there is no rig in it, and so no bone; leave --bone out"),
        None => {
            row("mesh", &|view| render_mesh(&mesh, view));
            "no rig".to_owned()
        }
        Some(rig) => {
            let joints = rig.skeleton().len();
            let joints = counted(joints, "joint");
            row(&joints, &|view| render_skeleton(rig, view));
            if args.bones.is_empty() {
                row("weights by joint", &|view| render_parts(rig, view));
            }
            for name in &args.bones {
                let joint = named(rig.skeleton(), name).with_context(|| shown.to_string())?;
                let weights = joint_weights(rig.weights(), joint);
                row(rig.skeleton().name(joint), &|view| render_weights(rig.mesh(), &weights, view, Palette::Paint));
            }
            joints
        }
    };
    let sheet = contact_sheet(&cells, SIDES.len(), theme);
    make_folder_of(&args.png)?;
    let written = riglab_files::write(&args.png, &sheet.to_png());
    written.with_context(|| format!("{} cannot be written", args.png.display()))?;
    say!("{}: {what}, {} vertices", args.png.display(), mesh.positions().len());
    Ok(ExitCode::SUCCESS)
}

/// As high and wide as what is drawn takes, from whichever side; never narrow, for the captions.
fn sized(size: u32, bounds: Bounds) -> View {
    let [x, y, z] = bounds.size().map(f64::from);
    let wide = x.hypot(z);
    let high = y + 0.14 * wide;
    let side = |own: f64, other: f64| {
        let share = if own < other { own / other } else { 1.0 };
        (f64::from(size) * share.max(0.45)) as u32
    };
    View { width: side(wide, high), height: side(high, wide), ..View::default() }
}

/// Mesh and rig with y up.
fn turned(mesh: &Mesh, rig: Option<&Rig>, up: UpAxis) -> Result<(Mesh, Option<Rig>)> {
    let turn = |mesh: &Mesh| mesh.with_positions(mesh.positions().iter().map(|&p| up.to_y(p)).collect());
    let rig = rig.map(|rig| {
        let skeleton = rig.skeleton();
        let skeleton = skeleton.with_heads(skeleton.heads().iter().map(|&p| up.to_y(p)).collect())?;
        Rig::new(skeleton, turn(rig.mesh())?, rig.weights().clone())
    });
    Ok((turn(mesh)?, rig.transpose()?))
}

/// The joint of a name, or of the only name that it is part of, whatever the case.
fn named(skeleton: &Skeleton, name: &str) -> Result<JointId> {
    let names = skeleton.names();
    if let Some(at) = names.iter().position(|own| own == name) {
        return Ok(JointId(at as u16));
    }
    let small = name.to_lowercase();
    let near: Vec<usize> = (0..names.len()).filter(|&at| names[at].to_lowercase().contains(&small)).collect();
    if let [only] = near[..] {
        return Ok(JointId(only as u16));
    }
    let (some, all): (Vec<&String>, usize) = match near.is_empty() {
        true => (names.iter().take(TOLD).collect(), names.len()),
        false => (near.iter().take(TOLD).map(|&at| &names[at]).collect(), near.len()),
    };
    let more = if all > some.len() { format!(" and {} more", all - some.len()) } else { String::new() };
    let some: Vec<String> = some.iter().map(|name| format!("`{name}`")).collect();
    bail!("no joint is called `{name}`; there are {}{more} (`riglab inspect` lists all)", some.join(", "))
}

#[cfg(test)]
mod tests {
    use riglab_core::Joint;

    use super::*;

    #[test]
    fn joints_are_found_by_name_or_by_a_part_that_only_one_has() {
        let joint = |name: &str, parent| Joint { name: name.into(), parent, head: [0.0; 3] };
        let joints = vec![joint("Hips", None), joint("LeftArm", Some(JointId(0))), joint("LeftLeg", Some(JointId(0)))];
        let skeleton = Skeleton::new(joints).unwrap();
        assert_eq!(named(&skeleton, "LeftArm").unwrap(), JointId(1));
        assert_eq!(named(&skeleton, "leg").unwrap(), JointId(2));
        let text = named(&skeleton, "left").unwrap_err().to_string();
        assert!(text.contains("`LeftArm`, `LeftLeg` ("), "{text}");
        assert!(named(&skeleton, "tail").unwrap_err().to_string().contains("`Hips`"));
    }
}
