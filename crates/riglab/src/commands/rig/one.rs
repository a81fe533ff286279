//! One model rigged.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, anyhow};
use riglab_asset::export::{self, ExportNote};
use riglab_asset::rigging::{Subject, SubjectOptions, name_joints};
use riglab_asset::{ImportOptions, import};
use riglab_core::{Bounds, Skeleton};
use riglab_files::make_folder_of;
use riglab_reward::Rewards;
use riglab_task::tokenrig::{Made, Rank, Wish};

use super::model::Model;
use super::{Bones, Common, given};

/// Reads `from`, rigs it, writes `to`.
pub fn rig(args: &Common, bones: &Bones, model: &Model, from: &Path, to: &Path) -> Result<()> {
    let start = Instant::now();
    let options = SubjectOptions {
        keep_rig: matches!(bones, Bones::Kept),
        up: args.up,
        // A skeleton that is given stands as the file does.
        to_front: matches!(bones, Bones::Predicted { .. }),
        max_triangles: args.max_triangles,
        import: ImportOptions::default(),
    };
    let subject = Subject::read(from, &options)?;
    for note in subject.notes() {
        tell!("note: {}: {note}", from.display());
    }
    let given = skeleton(args, bones, &subject, from)?;
    let class = match bones {
        Bones::Predicted { template, .. } => template.as_deref(),
        _ => None,
    };
    let wish = Wish {
        skeleton: given.as_ref(),
        class,
        samples: args.samples.map(usize::from),
        skins: args.skins.map(usize::from),
        rank: args.rank.into(),
        temperature: args.temperature,
        seed: args.seed,
    };
    let made = model.make(&subject, &wish, matches!(bones, Bones::Kept));
    let made = made.with_context(|| from.display().to_string())?;
    let draws = draws(&made, wish.rank);
    let (sample, likelihood, rewards) = (made.sample, made.taken().likelihood, made.taken().rewards);
    let weights = subject.agreed(&made.weights);
    // Weights that agree over seams are of more joints there; that those are cut again is no news.
    let said = |note: &&ExportNote| !matches!(note, ExportNote::InfluencesCut { .. });
    let joints = made.skeleton.len();
    let about = || from.display().to_string();
    let rig = match bones {
        Bones::Predicted { names, .. } => {
            let bounds = Bounds::of(subject.mesh().positions().iter().copied());
            let (skeleton, human) = name_joints(&made.skeleton, bounds, *names).with_context(about)?;
            subject.rigged(skeleton, weights).and_then(|rig| rig.with_humanoid(human))
        }
        Bones::Kept | Bones::Of(_) => subject.rigged(made.skeleton, weights),
    };
    let rig = rig.with_context(about)?;
    let exported = subject.attach(&rig, &args.export())?;
    for note in exported.notes.iter().filter(said) {
        tell!("note: {}: {note}", from.display());
    }
    let preview = if args.preview { Some(preview(&exported.bytes, from)?) } else { None };
    let bytes = preview.as_ref().unwrap_or(&exported.bytes);
    make_folder_of(to)?;
    export::write(to, bytes).with_context(|| format!("{} cannot be written", to.display()))?;
    let mesh = rig.mesh();
    if args.json {
        let of_export = exported.notes.iter().filter(said).map(ToString::to_string);
        let notes: Vec<String> = subject.notes().iter().map(ToString::to_string).chain(of_export).collect();
        let line = serde_json::json!({
            "file": from, "out": to, "joints": joints, "vertices": mesh.positions().len(),
            "triangles": mesh.triangles().len(), "checkpoint": model.card.name, "steps": model.card.state.step,
            "likelihood": likelihood, "sample": sample, "rewards": rewards, "samples": draws, "seconds": start.elapsed().as_secs_f64(),
            "notes": notes,
        });
        say!("{line}");
    } else {
        say!("{}: {joints} joints, {:.1} s", to.display(), start.elapsed().as_secs_f64());
        if draws.len() > 1 || rewards.is_some() {
            say!("  {}", taken(sample, args.rank.into(), &draws, rewards));
        }
    }
    Ok(())
}

/// What is known of each draw, for `--json`.
fn draws(made: &Made, rank: Rank) -> Vec<serde_json::Value> {
    let each = made.draws.iter().map(|draw| match rank {
        Rank::Likelihood | Rank::Consensus => serde_json::json!({ "likelihood": draw.likelihood }),
        Rank::Rewards => serde_json::json!({ "likelihood": draw.likelihood, "rewards": draw.rewards }),
    });
    each.collect()
}

/// Which of several was taken, and why.
fn taken(sample: usize, rank: Rank, draws: &[serde_json::Value], rewards: Option<Rewards>) -> String {
    let which = format!("sample {} of {}", sample + 1, draws.len());
    let Some(r) = rewards else {
        let why = if rank == Rank::Consensus { "the others agree with it most" } else { "the likeliest" };
        return format!("{which}: {why}");
    };
    let totals = draws.iter().filter_map(|d| d["rewards"]["total"].as_f64());
    let least = totals.fold(r.total, f64::min);
    let others = if draws.len() > 1 { format!(" (the worst: {least:.3})") } else { String::new() };
    format!(
        "{which} by rewards: R = {:.3} of 8{others}; joints throughout the body {:.3}, bones inside {:.3}, weights \
         whole {:.3}, motion smooth {:.3}",
        r.total, r.coverage, r.containment, r.skinning, r.motion
    )
}

/// With the motion that bends every joint.
fn preview(bytes: &[u8], from: &Path) -> Result<Vec<u8>> {
    let made = export::preview(bytes).map_err(|e| anyhow!("{}: {e}", from.display()))?;
    Ok(made.bytes)
}

/// The skeleton that stays, in the mesh's space.
fn skeleton(args: &Common, bones: &Bones, subject: &Subject, from: &Path) -> Result<Option<Skeleton>> {
    let shown = from.display();
    match bones {
        Bones::Predicted { .. } => Ok(None),
        Bones::Kept => {
            let rig = subject.old_rig().with_context(|| {
                format!("{shown} has no skeleton to keep; `riglab rig {shown} -o OUT.glb` makes one, --skeleton FILE takes one")
            })?;
            Ok(Some(rig.skeleton().clone()))
        }
        Bones::Of(file) => {
            let imported = import(file, &ImportOptions::default())?;
            let rig = imported.rig().with_context(|| format!("{}: there is no skeleton in it", file.display()))?;
            let stood = given::stood(rig.skeleton(), subject.mesh(), args.up, args.skeleton_up)?;
            if let Some(note) = stood.note {
                tell!("note: {}: {note}", file.display());
            }
            Ok(Some(stood.skeleton))
        }
    }
}
