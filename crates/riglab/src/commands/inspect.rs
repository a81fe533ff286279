//! `riglab inspect`

use std::ops::ControlFlow;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Result;
use riglab_asset::{Character, Content, ImportOptions, Imported, import_each};
use riglab_core::Rig;

use riglab_report::counted;

/// Joints deeper than this are shown no further to the right.
const DEEPEST: usize = 60;

/// Show what a rigged file holds: joints, mesh, weights, repairs.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  riglab inspect fox.glb
  riglab inspect fox.glb --json --all-vertices > fox.json
  riglab inspect articulation_xlv2_test.npz --item 12")]
pub struct Args {
    /// GLB, glTF, VRM, FBX, OBJ, PLY, STL, rig text, npz, h5 or pt files.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Read one of several characters in a file: its number, from 0, or the name of its root.
    #[arg(long, value_name = "WHICH")]
    character: Option<Character>,
    /// One JSON object a line, in the file's own units and glTF's axes, of what the file holds: joints have the parents
    /// that it gives them, so there may be several roots; vertices, triangles and weights are those of skinned meshes,
    /// and `rigid_*` count rigid parts, which the rig, and the text, have besides. `shown_off` is how far the file shows the model
    /// from there, where its bind pose stands elsewhere.
    #[arg(long)]
    json: bool,
    /// With --json, every vertex of skinned meshes as a sample.
    #[arg(long, requires = "json")]
    all_vertices: bool,
    /// Of a file of several assets this one, counted from 0.
    #[arg(long, value_name = "N")]
    item: Option<usize>,
    /// Repair what takes a guess: joints of a rig text beside its tree go below the root, `NAME_dup_K`
    /// joints of RigNet's predictions back into NAME.
    #[arg(long)]
    repair: bool,
}

pub fn run(args: &Args) -> Result<ExitCode> {
    let mut failed = false;
    let mut broken = Ok(());
    let (item, character, repair) = (args.item, args.character.clone(), args.repair);
    let options = ImportOptions { item, character, repair, ..Default::default() };
    for file in &args.files {
        import_each(file, &options, |imported| {
            match imported {
                Ok(imported) if args.json => match serde_json::to_string(&imported.inspect(args.all_vertices)) {
                    Ok(line) => say!("{line}"),
                    Err(e) => {
                        broken = Err(e);
                        return ControlFlow::Break(());
                    }
                },
                Ok(imported) => print(&imported),
                Err(e) => {
                    tell!("error: {e}");
                    failed = true;
                }
            }
            ControlFlow::Continue(())
        });
    }
    broken?;
    Ok(if failed { ExitCode::FAILURE } else { ExitCode::SUCCESS })
}

/// What there is of human bones and springs, a line each.
pub fn body(rig: &Rig) -> Vec<String> {
    let mut lines = Vec::new();
    if !rig.humanoid().is_empty() {
        lines.push(format!("humanoid  {} bones", rig.humanoid().len()));
    }
    let springs = rig.springs();
    if !springs.is_empty() {
        let swinging = springs.by_joint(rig.skeleton().len()).iter().flatten().count();
        let (count, colliders) = (springs.springs().len(), springs.colliders().len());
        let (swinging, colliders) = (counted(swinging, "joint"), counted(colliders, "collider"));
        lines.push(format!("springs   {count} that swing {swinging}, {colliders}"));
    }
    lines
}

/// Where the file shows the model, if that is not where it is read: its bind pose is, and quantised meshes stand elsewhere
/// in it.
pub fn shown_elsewhere(imported: &Imported) -> Option<String> {
    let by = imported.reading.up.to_y(imported.reading.shown_off);
    let [x, y, z] = by;
    let digits = decimals(by.map(f32::abs));
    (by != [0.0; 3]).then(|| {
        format!("the file shows the model ({x:.digits$}, {y:.digits$}, {z:.digits$}) from its bind pose, which is read")
    })
}

/// "1 vertex", "2 vertices".
pub fn vertices(n: usize) -> String {
    if n == 1 { "1 vertex".into() } else { format!("{n} vertices") }
}

/// Digits after the point that show a model of such sides: four, and more where it is tiny.
fn decimals(size: [f32; 3]) -> usize {
    let longest = size.into_iter().fold(0.0, f32::max);
    // At least three digits that are not leading zeros.
    (4..12).find(|digits| longest >= 10f32.powi(2 - *digits)).unwrap_or(if longest > 0.0 { 12 } else { 4 }) as usize
}

fn print(imported: &Imported) {
    let from = &imported.provenance;
    let (mesh, reading) = (imported.mesh(), &imported.reading);
    say!("{}", from.source);
    let size = riglab_core::Bounds::of(mesh.positions().iter().copied()).map_or([0.0; 3], |b| b.size());
    let digits = decimals(size);
    let [x, y, z] = size;
    say!(
        "  mesh      {}, {}, {x:.digits$} x {y:.digits$} x {z:.digits$} units",
        vertices(mesh.positions().len()),
        counted(mesh.triangles().len(), "triangle"),
    );
    if let Content::Rigged(rig) = &imported.content {
        let weights = rig.weights();
        let most = weights.offsets().windows(2).map(|w| w[1] - w[0]).max().unwrap_or(0);
        let (joints, hold) = (counted(rig.skeleton().len(), "joint"), rig.skinned_joints(0.0).len());
        let holding = if hold == 1 { "holds" } else { "hold" };
        say!("  skeleton  {joints}, of which {hold} {holding} vertices");
        say!("  weights   {} not zero, at most {most} a vertex", weights.nonzero());
        for line in body(rig) {
            say!("  {line}");
        }
        say!("  tree");
        let children = rig.skeleton().children();
        let mut open = vec![(riglab_core::JointId(0), 0)];
        while let Some((joint, depth)) = open.pop() {
            let [x, y, z] = rig.skeleton().head(joint);
            say!(
                "    {:indent$}{}  ({x:.digits$}, {y:.digits$}, {z:.digits$})",
                "",
                rig.skeleton().name(joint),
                indent = 2 * usize::min(depth, DEEPEST)
            );
            open.extend(children[joint.index()].iter().rev().map(|&c| (c, depth + 1)));
        }
    } else {
        say!("  skeleton  none: {} joints", reading.joints.len());
    }
    for (name, value) in [("licence", &from.licence), ("author", &from.author)] {
        if !value.is_empty() {
            say!("  {name:9} {value}");
        }
    }
    if let Some(note) = shown_elsewhere(imported) {
        say!("  note      {note}");
    }
    for warning in imported.warnings() {
        say!("  warning   {warning}");
    }
}

#[cfg(test)]
mod tests {
    use riglab_asset::{ImportOptions, import_bytes};

    use super::{decimals, shown_elsewhere};

    #[test]
    fn a_model_that_is_shown_elsewhere_says_so() {
        let text = b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\n";
        let mut imported = import_bytes("a.obj", text, &ImportOptions::default()).unwrap();
        assert_eq!(shown_elsewhere(&imported), None);
        imported.reading.shown_off = [0.0, -0.5, 2.0];
        let wanted = "the file shows the model (0.0000, -0.5000, 2.0000) from its bind pose, which is read";
        assert_eq!(shown_elsewhere(&imported).as_deref(), Some(wanted));
    }

    #[test]
    fn tiny_models_are_shown_with_digits_that_tell_them() {
        assert_eq!([[2.0, 1.0, 0.0], [0.02, 0.01, 0.0], [0.0; 3]].map(decimals), [4, 4, 4]);
        assert_eq!([[0.005, 0.0, 0.0], [1.5e-9, 1e-9, 1e-9], [1e-30, 0.0, 0.0]].map(decimals), [5, 11, 12]);
    }
}
