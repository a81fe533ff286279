//! One model rigged.

use std::path::Path;
use std::time::Instant;

use anyhow::{Context, Result, anyhow, ensure};
use riglab_asset::export::{self, ExportNote};
use riglab_asset::rigging::{
    Subject, SubjectNote, SubjectOptions, UpAxis, human_bones, humanoid, name_added, name_bones, name_joints,
    name_others,
};
use riglab_asset::{ImportOptions, is_vrm};
use riglab_core::{Bounds, Humanoid, Rig, RigError, Skeleton, Vec3};
use riglab_files::make_folder_of;
use riglab_report::counted;
use riglab_report::shell::command;
use riglab_reward::{RewardConfig, Rewards};
use riglab_task::tokenrig::{BODIES, GeneratedRig, Placed, Rank, RigRequest, many_bodies};
use riglab_token::Template;
use riglab_train::Spinner;

use super::model::Model;
use super::{Bones, Common, Given, file_name, given, in_line, is_fbx};

/// Reads `from`, rigs it, writes `to`. `read`: what the file of the skeleton holds, where there is one.
pub fn rig(
    args: &Common,
    (bones, read): (&Bones, Option<&given::Read>),
    model: &Model,
    from: &Path,
    to: &Path,
) -> Result<()> {
    let start = Instant::now();
    let options = SubjectOptions {
        keep_rig: bones.keeps_rig(),
        up: args.up,
        // A skeleton that is given stands as the file does.
        to_front: matches!(bones, Bones::Predicted { .. }),
        max_triangles: args.max_triangles,
        import: ImportOptions::default(),
    };
    // Of a folder the bar tells.
    let spinner = |what: &str| {
        let name = from.file_name().unwrap_or_default().to_string_lossy();
        (!args.input.is_dir()).then(|| Spinner::new(&format!("{what} {name}")))
    };
    let reading = spinner("reading");
    let subject = Subject::read(from, &options)?;
    drop(reading);
    let mut notes = Vec::new();
    let mut of_vrm = None;
    for note in subject.notes() {
        let said = match (note, bones) {
            // Which of it is there again is known when all is written.
            (SubjectNote::Stripped(ExportNote::VrmDropped { parts }), Bones::Predicted { .. }) => {
                of_vrm = Some(parts.clone());
                continue;
            }
            (SubjectNote::RigIgnored { joints }, Bones::Given { from: Given::Kept, .. }) => {
                let joints = counted(*joints, "joint");
                format!("the file already has a rig ({joints}): its joints are kept, its weights are made anew")
            }
            (note, _) => note.to_string(),
        };
        noted(from, &mut notes, said);
    }
    let (given, said) = skeleton(args, (bones, read), &subject, (from, &options))?;
    notes.extend(said);
    let class = match bones {
        Bones::Predicted { template, .. } => template.as_deref().map(|told| model.template(told)),
        _ => None,
    };
    let holders = subject.old_rig().filter(|_| bones.keeps_rig()).map(holders);
    let held = holders.iter().flatten().filter(|held| **held).count();
    if let Some(all) = holders.as_ref().map(Vec::len).filter(|all| held > 0 && 2 * held < *all) {
        let note = format!(
            "{} of its {all} joints influence no vertex and stay so; give --skeleton {} for weights on all of them",
            all - held,
            from.display()
        );
        noted(from, &mut notes, note);
    }
    let wish = RigRequest {
        skeleton: given.as_ref(),
        complete: bones.completed(),
        class,
        human: Some(&human_bones),
        samples: args.samples.map(usize::from),
        skins: args.skins.map(usize::from),
        rank: match args.rank.into() {
            // Nothing is left to agree on.
            Rank::Consensus if given.is_some() => Rank::Likelihood,
            rank => rank,
        },
        temperature: args.temperature,
        influences: Some(args.export().influences.most()),
        holders: holders.as_deref(),
        seed: args.seed,
    };
    let making = spinner("rigging");
    let made = model.make(&subject, &wish, bones.keeps_rig());
    drop(making);
    let made = made.with_context(|| from.display().to_string())?;
    let draws = draws(&made, wish.rank);
    let (sample, likelihood, rewards) = (made.sample, made.taken().likelihood, made.taken().rewards);
    let weights = subject.with_rigid_parts(subject.agreed(&made.weights));
    let fbx = to.extension().is_some_and(|of| of.eq_ignore_ascii_case("fbx"));
    // Weights that agree over seams are of more joints there; that those are cut again is no news. An FBX is no VRM, whatever
    // it lacks.
    let said = |note: &&ExportNote| match note {
        ExportNote::InfluencesCut { .. } => false,
        ExportNote::NotHuman { .. } => !fbx,
        _ => true,
    };
    let joints = made.skeleton.len();
    let added = given.as_ref().filter(|_| wish.complete).map(|given| joints - given.len());
    let about = || from.display().to_string();
    if let Some(read) = made.thinned {
        let (all, hold) = if held > 0 { (held, " that hold vertices") } else { (joints, "") };
        let note = format!(
            "{all} joints{hold} are more than this model reads, or take more tokens: it gave weights to {read} of them, which \
             share these with the others beside them by distance; check hair, clothes and fingers"
        );
        noted(from, &mut notes, note);
    }
    if let Some(others) = made.beside {
        let (those, they) =
            if others == 1 { ("1 separate part", "it") } else { (&*format!("{others} separate parts"), "they") };
        let note = format!(
            "the skeleton that its samples agreed on was no human body, but most were one when {those} beside the body had been \
             left out: the skeleton was made so, and {they} got weights on it; check what is held or worn"
        );
        noted(from, &mut notes, note);
    }
    let degrees = made.yaw.in_degrees();
    if degrees != 0 {
        let note = format!(
            "the mesh seems not to face along z: it was rigged turned by {degrees} degrees about y, and is written as it \
             stood"
        );
        noted(from, &mut notes, note);
    }
    // Sides are told as it was looked at.
    let heads = made.skeleton.heads().iter().map(|&p| made.yaw.apply(p)).collect();
    let seen = made.skeleton.with_heads(heads).with_context(about)?;
    let bounds = Bounds::of(subject.mesh().positions().iter().map(|&p| made.yaw.apply(p)));
    let rig = match bones {
        Bones::Predicted { names, .. } => {
            let template = class.and_then(Template::of);
            if let Some(note) = template.zip(made.placed).and_then(|(t, placed)| of_template(t, placed)) {
                noted(from, &mut notes, note);
            }
            if let Some(note) = of_bodies(&made, humanoid(&seen, bounds).is_some(), class) {
                noted(from, &mut notes, note);
            }
            // Formats that do not say what is up, in which it often is z.
            let may_lie = args.up == UpAxis::Y
                && from.extension().is_some_and(|e| ["obj", "ply", "stl"].iter().any(|of| e.eq_ignore_ascii_case(of)));
            if let Some(note) = of_apart(&made, may_lie) {
                noted(from, &mut notes, note);
            }
            if joints >= model.most_joints() {
                let note = format!(
                    "it got {joints} joints, the most that this network writes: check it before you use it; a wrong up axis \
                     (--up), several characters in one file, or a network that has not learned enough cause this"
                );
                noted(from, &mut notes, note);
            }
            let named = template.filter(|_| !matches!(made.placed, Some(Placed::Lost | Placed::Without)));
            let (named, human) = match (names, named) {
                (None, Some(template)) => by_template(&seen, template, bounds),
                // What they are is known, better than their places tell.
                (Some(style), Some(template)) => {
                    by_template(&seen, template, bounds).and_then(|(_, human)| name_bones(&seen, bounds, human, *style))
                }
                (names, None) => name_joints(&seen, bounds, names.unwrap_or_default()),
            }
            .with_context(about)?;
            let skeleton = named.with_heads(made.skeleton.heads().to_vec()).with_context(about)?;
            subject.rigged(skeleton, weights).and_then(|rig| rig.with_humanoid(human))
        }
        Bones::Given { .. } => {
            let first = given.as_ref().map_or(0, Skeleton::len);
            let named = name_added(&seen, first, bounds).with_context(about)?;
            let skeleton = named.with_heads(made.skeleton.heads().to_vec()).with_context(about)?;
            subject.rigged(skeleton, weights)
        }
    };
    let rig = rig.with_context(about)?;
    let writing = spinner("writing");
    let exported = subject.attach(&rig, &args.export())?;
    drop(writing);
    if let Some(note) = of_vrm.and_then(|parts| left_of_vrm(parts, rig.humanoid().len())) {
        noted(from, &mut notes, note);
    }
    for note in exported.notes.iter().filter(said) {
        tell!("note: {}: {note}", in_line(from.display()));
    }
    let bytes = if args.preview { preview(&exported.bytes, from)? } else { exported.bytes };
    if to.extension().is_some_and(|of| of.eq_ignore_ascii_case("vrm")) && !is_vrm(&bytes) {
        let note = format!("{} is a plain GLB, as there is no data of VRM in it", to.display());
        noted(from, &mut notes, note);
    }
    let bytes = &export::made_of(bytes, &file_name(from));
    #[cfg(feature = "fbx")]
    let fbx = if is_fbx(to) { Some(as_fbx(bytes, from, &mut notes)?) } else { None };
    #[cfg(feature = "fbx")]
    let bytes = fbx.as_ref().unwrap_or(bytes);
    make_folder_of(to).with_context(about)?;
    export::write(to, bytes).with_context(|| format!("{} cannot be written", to.display()))?;
    let mesh = rig.mesh();
    if args.json {
        notes.extend(exported.notes.iter().filter(said).map(ToString::to_string));
        let line = serde_json::json!({
            "file": from.to_string_lossy(), "out": to.to_string_lossy(), "joints": joints, "added": added, "vertices": mesh.positions().len(),
            "triangles": mesh.triangles().len(), "checkpoint": model.card.name, "steps": model.card.state.step,
            "weights_by": model.of_weights().map(|own| &own.name),
            "joints_read": made.thinned, "beside": made.beside, "likelihood": likelihood, "apart": sure(&made), "sample": sample, "rewards": rewards, "samples": draws, "seconds": start.elapsed().as_secs_f64(),
            "template": made.placed.map(told_placed), "notes": notes,
        });
        say!("{line}");
    } else {
        let of_them = added.map_or(String::new(), |added| format!(", {added} of them added"));
        say!("{}: {joints} joints{of_them}, {:.1} s", in_line(to.display()), start.elapsed().as_secs_f64());
        if draws.len() > 1 || rewards.is_some() {
            say!("  {}", taken(sample, wish.rank, (&draws, sure(&made)), rewards));
        }
    }
    Ok(())
}

/// What went with the old rig of a VRM, where the new one has so many human bones of its own.
fn left_of_vrm(mut parts: Vec<&'static str>, human: usize) -> Option<String> {
    if human == 0 {
        return Some(ExportNote::VrmDropped { parts }.to_string());
    }
    parts.retain(|part| *part != "humanoid");
    let made = format!("its {} are of the new rig", counted(human, "human bone"));
    let gone = (!parts.is_empty()).then_some(ExportNote::VrmDropped { parts });
    gone.map(|gone| format!("{made}; {gone}"))
}

/// What a person should know of a template that was asked for.
fn of_template(template: &Template, placed: Placed) -> Option<String> {
    let class = template.class;
    match placed {
        Placed::Written { left_out: 0 } => None,
        Placed::Written { left_out } => Some(format!(
            "{left_out} joints beside those of `{class}` were left out, as this network has learned from too few such rigs to \
             tell what they are"
        )),
        Placed::Voted { bodies, draws } => Some(format!(
            "with --template this network wrote no body; the joints of `{class}` were placed where {bodies} of {draws} samples \
             without it show a human body"
        )),
        Placed::Without => Some(format!(
            "this network wrote no body as `{class}` has it, and too few without --template to place its joints by: it was \
             rigged without it"
        )),
        Placed::Lost => Some(format!(
            "what this network wrote with --template is no body as `{class}` has it; --samples 64 without --rank picks \
             samples that are bodies"
        )),
    }
}

/// The same in a word, for `--json`.
fn told_placed(placed: Placed) -> &'static str {
    match placed {
        Placed::Written { .. } => "written",
        Placed::Voted { .. } => "voted",
        Placed::Without => "without",
        Placed::Lost => "lost",
    }
}

/// Where many draws are human bodies and the one that was taken has another tree: what makes one of them.
fn of_bodies(made: &GeneratedRig, human: bool, class: Option<&str>) -> Option<String> {
    let (bodies, draws) = (made.bodies.filter(|_| !human && class.is_none())?, made.draws.len());
    (bodies >= BODIES && many_bodies(bodies, draws)).then(|| {
        format!("{bodies} of {draws} samples are human bodies, but the one taken is not; --template mixamo makes one")
    })
}

/// What is as far from its draws is mostly wrong: 39 of 90 real models are, of which 28 have a J2J above .08, as 2 of the others
/// have (`experiments/README.md`, does disagreement between samples reveal a wrong skeleton).
const FAR: f64 = 0.055;

/// So few draws tell nothing of how sure the model is.
const FEW: usize = 8;

/// How far the skeleton is from its draws, where there are enough to tell.
fn sure(made: &GeneratedRig) -> Option<f64> {
    made.apart.filter(|_| made.draws.len() >= FEW)
}

/// Where draws disagree: that the skeleton is to be looked at.
fn of_apart(made: &GeneratedRig, may_lie: bool) -> Option<String> {
    let apart = sure(made).filter(|apart| *apart >= FAR)?;
    Some(format!(
        "its samples disagree (by {:.1} % of the model's size; some 2 % where this network is sure): check the skeleton \
         before you use it{}",
        100.0 * apart,
        if may_lie { "; where z points up in the file, as in most scans and prints, give --up z" } else { "" }
    ))
}

/// Joints of a template keep their names, which say what they are; others get one by place.
fn by_template(
    skeleton: &Skeleton,
    template: &Template,
    mesh: Option<Bounds>,
) -> Result<(Skeleton, Humanoid), RigError> {
    let named = name_others(skeleton, |name| template.has(name), mesh)?;
    let mut human = Humanoid::default();
    for (joint, name) in named.ids().zip(named.names()) {
        if let Some(Ok(bone)) = template.bone(name).map(str::parse) {
            human.insert(bone, joint);
        }
    }
    Ok((named, human))
}

/// Says something of a model, and keeps it for `--json`.
fn noted(from: &Path, notes: &mut Vec<String>, note: String) {
    tell!("note: {}: {note}", in_line(from.display()));
    notes.push(note);
}

/// Of each joint of a rig that stays whether it holds anything. Others go on so: roots on the ground, ends, and what
/// controls others in Rigify's rigs, which may be bound in spaces of their own.
fn holders(rig: &Rig) -> Vec<bool> {
    let mut holders = vec![false; rig.skeleton().len()];
    let held = (0..rig.weights().rows()).flat_map(|v| rig.weights().row(v));
    held.filter(|(_, weight)| *weight > 0.0).for_each(|(joint, _)| holders[joint.index()] = true);
    holders
}

/// What is known of each draw, for `--json`.
fn draws(made: &GeneratedRig, rank: Rank) -> Vec<serde_json::Value> {
    let each = made.draws.iter().map(|draw| match rank {
        Rank::Likelihood | Rank::Consensus => serde_json::json!({ "likelihood": draw.likelihood }),
        Rank::Rewards => serde_json::json!({ "likelihood": draw.likelihood, "rewards": draw.rewards }),
    });
    each.collect()
}

/// Which of several was taken, and why.
fn taken(
    sample: usize,
    rank: Rank,
    (draws, apart): (&[serde_json::Value], Option<f64>),
    rewards: Option<Rewards>,
) -> String {
    let which = format!("sample {} of {}", sample + 1, draws.len());
    let Some(r) = rewards else {
        let why = if rank == Rank::Consensus { "the closest to the others" } else { "the likeliest" };
        let apart = apart
            .map_or(String::new(), |apart| format!(" (on average {:.1} % of the model's size apart)", 100.0 * apart));
        return format!("{which}: {why}{apart}");
    };
    let totals = draws.iter().filter_map(|d| d["rewards"]["total"].as_f64());
    let least = totals.fold(r.total, f64::min);
    let others = if draws.len() > 1 { format!(" (the worst: {least:.3})") } else { String::new() };
    let most: f64 = RewardConfig::default().weights.all().iter().sum();
    let parts = Rewards::PARTS.iter().zip(r.parts());
    let parts: Vec<String> = parts.map(|(part, r)| format!("{} {} {r:.3}", part.name, part.symbol)).collect();
    format!("{which} by rewards: R = {:.3} of {most}{others}; {}", r.total, parts.join(", "))
}

/// A GLB as FBX; what that does not hold is told.
#[cfg(feature = "fbx")]
fn as_fbx(glb: &[u8], from: &Path, notes: &mut Vec<String>) -> Result<Vec<u8>> {
    let made = riglab_asset::glb_to_fbx(glb).with_context(|| from.display().to_string())?;
    if let Some(note) = made.left.note() {
        noted(from, notes, note);
    }
    Ok(made.bytes)
}

/// With the motion that bends every joint.
fn preview(bytes: &[u8], from: &Path) -> Result<Vec<u8>> {
    let made = export::preview(bytes).map_err(|e| anyhow!("{}: {e}", from.display()))?;
    Ok(made.bytes)
}

/// The skeleton that stays, in the mesh's space, and what a person should know of it.
fn skeleton(
    args: &Common,
    (bones, read): (&Bones, Option<&given::Read>),
    subject: &Subject,
    (from, options): (&Path, &SubjectOptions),
) -> Result<(Option<Skeleton>, Vec<String>)> {
    let Bones::Given { from: given, complete } = bones else { return Ok((None, Vec::new())) };
    match given {
        // A rig that gets more joints does not stay: it is read beside the bare model.
        Given::Kept if *complete => {
            let whole = Subject::read(from, &SubjectOptions { keep_rig: true, ..options.clone() })?;
            // The bare model stands where the file shows it, its rig where it was bound.
            let by = whole.shown_off();
            let shown = |p: &Vec3| -> Vec3 { std::array::from_fn(|k| p[k] + by[k]) };
            ensure!(
                alike(whole.mesh().positions().iter().map(shown), subject.mesh().positions().iter().copied()),
                "{}: the model is shown in another pose than that in which its skeleton holds it; save it at rest, then \
                 complete it",
                from.display()
            );
            let own = kept(&whole, from)?;
            Ok((Some(own.with_heads(own.heads().iter().map(shown).collect())?), Vec::new()))
        }
        Given::Kept => kept(subject, from).map(|own| (Some(own), Vec::new())),
        Given::File(file) => {
            let (skeleton, notes) = read.with_context(|| format!("{} was not read", file.display()))?;
            let mut notes = notes.clone();
            let stood = given::stood(skeleton, subject.mesh(), args.up, args.skeleton_up)?;
            notes.extend(stood.note);
            notes.iter().for_each(|note| tell!("note: {}: {note}", in_line(file.display())));
            Ok((Some(stood.skeleton), notes))
        }
    }
}

/// The skeleton that a model has.
fn kept(subject: &Subject, from: &Path) -> Result<Skeleton> {
    let rig = subject.old_rig().with_context(|| {
        let makes = command(["rig", &from.to_string_lossy(), "-o", "OUT.glb"]);
        format!("{} has no skeleton to keep; `{makes}` makes one, --skeleton FILE takes one", from.display())
    })?;
    Ok(rig.skeleton().clone())
}

/// Whether the vertices of two meshes take up the same room, but for a twentieth.
fn alike(a: impl Iterator<Item = Vec3>, b: impl Iterator<Item = Vec3>) -> bool {
    let (Some(a), Some(b)) = (Bounds::of(a), Bounds::of(b)) else { return false };
    let room = 0.05 * a.diagonal();
    (0..3).all(|k| (a.min[k] - b.min[k]).abs() <= room && (a.max[k] - b.max[k]).abs() <= room)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_a_vrm_only_what_is_not_there_again_is_told_as_gone() {
        let parts = || vec!["humanoid", "firstPerson"];
        let gone = " (of VRM) referred to the old rig and";
        assert_eq!(left_of_vrm(parts(), 0).unwrap(), format!("humanoid, firstPerson{gone} were removed with it"));
        let told = left_of_vrm(parts(), 18).unwrap();
        assert_eq!(told, format!("its 18 human bones are of the new rig; firstPerson{gone} was removed with it"));
        assert_eq!(left_of_vrm(vec!["humanoid"], 18), None);
    }
}
