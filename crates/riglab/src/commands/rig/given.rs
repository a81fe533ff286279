//! How the joints of another file stand in a model.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use riglab_asset::rigging::UpAxis;
use riglab_asset::{ImportOptions, import, is_model_file, read_arrays};
use riglab_core::{Bounds, Joint, JointId, Mesh, Skeleton, Vec3};

/// A skeleton that was read, with what was repaired or is doubtful.
pub type Read = (Skeleton, Vec<String>);

/// Reads a skeleton: of a rigged file, or of a file of joints alone, as a rig text without mesh and weights or what a
/// skeleton stage predicts. Where the file shows it, as a model is that is read without its rig; with what was repaired or is
/// doubtful.
pub fn read(file: &Path) -> Result<Read> {
    match import(file, &ImportOptions::default()) {
        Ok(imported) => {
            let rig = imported.rig().with_context(|| format!("{}: there is no skeleton in it", file.display()))?;
            let (own, by) = (rig.skeleton(), imported.reading.shown_off);
            let heads = own.heads().iter().map(|p| std::array::from_fn(|k| p[k] + by[k])).collect();
            Ok((own.with_heads(heads)?, imported.provenance.notes))
        }
        Err(e) if is_model_file(file) => Err(e.into()),
        // What is no rig may have joints all the same; if not, why it is no rig is the fault.
        Err(e) => joints_of(file).map(|own| (own, Vec::new())).map_err(|_| e.into()),
    }
}

/// The skeleton of a file of arrays.
fn joints_of(file: &Path) -> Result<Skeleton> {
    let mut all = read_arrays(file)?;
    ensure!(all.len() == 1, "{}: it holds {} assets", file.display(), all.len());
    let own = all.swap_remove(0)?;
    let count = own.joints.len();
    let roots = own.parents.iter().filter(|parent| parent.is_none()).count();
    ensure!(own.parents.len() == count && roots == 1, "{}: its joints are no tree", file.display());
    // Parents first, else in the order of the file.
    let (mut order, mut place) = (Vec::with_capacity(count), vec![None; count]);
    while order.len() < count {
        let before = order.len();
        for joint in 0..count {
            if place[joint].is_none() && own.parents[joint].is_none_or(|parent| place[parent].is_some()) {
                place[joint] = Some(u16::try_from(order.len())?);
                order.push(joint);
            }
        }
        ensure!(order.len() > before, "{}: its joints are no tree", file.display());
    }
    let joints = order.into_iter().map(|joint| Joint {
        name: own.names.get(joint).cloned().unwrap_or_else(|| format!("joint_{joint}")),
        parent: own.parents[joint].and_then(|parent| place[parent]).map(JointId),
        head: own.up.to_y(own.joints[joint]),
    });
    Ok(Skeleton::new(joints.collect())?)
}

/// Room around a model in which joints count as within it, as a share of its longest side: ends of bones stand out.
const ROOM: f32 = 0.1;

/// A skeleton in a model's axes.
pub struct Stood {
    pub skeleton: Skeleton,
    /// What a person should know of it.
    pub note: Option<String>,
}

/// Sets a skeleton upright as the model is. A file in the model's own space has the model's axis `up`; one that was made
/// of the model when it stood (as `riglab rig` writes) has y up. Which it is is asked of the joints, unless it is told.
pub fn stood(skeleton: &Skeleton, mesh: &Mesh, up: UpAxis, told: Option<UpAxis>) -> Result<Stood> {
    let within = |axis: UpAxis| share_within(skeleton, mesh, axis);
    let axis = told.unwrap_or(if within(UpAxis::Y) > within(up) { UpAxis::Y } else { up });
    let turned = skeleton.with_heads(skeleton.heads().iter().map(|&p| axis.to_y(p)).collect())?;
    let count = (within(axis) * skeleton.len() as f32).round() as usize;
    let note = if count * 2 < skeleton.len() {
        Some(format!(
            "only {count} of its {} joints lie within the model; is it of the same space and unit? --skeleton-up tells \
             which axis points up in it",
            skeleton.len()
        ))
    } else if let Some(note) = tiny(&turned, mesh) {
        Some(note)
    } else if told.is_none() && axis != up {
        Some(format!("its joints lie within the model with {axis} up, not with {up}; --skeleton-up says otherwise"))
    } else {
        None
    };
    Ok(Stood { skeleton: turned, note })
}

/// A skeleton takes up less than this share of its model where it is told in another unit: a hand's of a whole body is
/// larger.
const TINY: f32 = 0.05;

/// What to say of joints that all lie in one spot of the model.
fn tiny(skeleton: &Skeleton, mesh: &Mesh) -> Option<String> {
    let size = |points: &[Vec3]| Bounds::of(points.iter().copied()).map(|b| b.diagonal());
    let (own, model) = (size(skeleton.heads())?, size(mesh.positions())?);
    let note = || {
        format!(
            "its {} joints lie in one spot, within {:.3} of the model's size; is it in another unit? Scale one of the two, as \
             metres are 1000 millimetres",
            skeleton.len(),
            own / model
        )
    };
    (skeleton.len() > 2 && own < TINY * model).then(note)
}

/// How many of the joints lie within a model's box, as a share.
fn share_within(skeleton: &Skeleton, mesh: &Mesh, axis: UpAxis) -> f32 {
    let Some(bounds) = Bounds::of(mesh.positions().iter().copied()) else { return 0.0 };
    let room = ROOM * bounds.size().into_iter().fold(0.0, f32::max);
    let inside = |p: Vec3| (0..3).all(|k| p[k] >= bounds.min[k] - room && p[k] <= bounds.max[k] + room);
    let count = skeleton.heads().iter().filter(|p| inside(axis.to_y(**p))).count();
    count as f32 / skeleton.len().max(1) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn joints_alone_are_a_skeleton() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("own_rig.txt");
        std::fs::write(&file, "joints tip 0 2 0\njoints base 0 0 1\nroot base\nhier base tip\n").unwrap();
        let (own, notes) = read(&file).unwrap();
        assert!(notes.is_empty());
        assert_eq!(
            (own.names(), own.heads()),
            (&["base".to_owned(), "tip".into()][..], &[[0.0, 0.0, 1.0], [0.0, 2.0, 0.0]][..])
        );
        assert_eq!(own.parents(), [None, Some(JointId(0))]);
        // What is wrong is told of the file as it is.
        std::fs::write(&file, "joints tip 0 2\n").unwrap();
        assert!(read(&file).unwrap_err().to_string().contains("own_rig.txt"));
        assert!(read(&dir.path().join("none.glb")).is_err());
    }

    /// A tower from the ground to a height of 4, and a chain up its middle.
    fn tower() -> (Mesh, Skeleton) {
        let corners = vec![[-0.5, 0.0, -0.5], [0.5, 0.0, -0.5], [0.0, 0.0, 0.5], [0.0, 4.0, 0.0]];
        let mesh = Mesh::new(corners, vec![[0, 1, 2], [0, 3, 1], [1, 3, 2], [2, 3, 0]]).unwrap();
        let joint = |k: u16| Joint {
            name: format!("j{k}"),
            parent: k.checked_sub(1).map(JointId),
            head: [0.0, f32::from(k), 0.1],
        };
        (mesh, Skeleton::new((0..4).map(joint).collect()).unwrap())
    }

    /// The skeleton as a file has it whose `axis` points up.
    fn lying(skeleton: &Skeleton, axis: UpAxis) -> Skeleton {
        skeleton.with_heads(skeleton.heads().iter().map(|&p| axis.from_y(p)).collect()).unwrap()
    }

    #[test]
    fn joints_come_to_stand_whichever_way_their_file_lies() {
        let (mesh, skeleton) = tower();
        for up in UpAxis::ALL {
            // In the model's own space, and upright already.
            for axis in [up, UpAxis::Y] {
                let stood = stood(&lying(&skeleton, axis), &mesh, up, None).unwrap();
                assert_eq!(stood.skeleton.heads(), skeleton.heads(), "{up} {axis}");
                assert_eq!(stood.note.is_some(), axis != up, "{up} {axis}");
            }
        }
        // Neither: it has to be told.
        let odd = lying(&skeleton, UpAxis::MinusX);
        assert!(stood(&odd, &mesh, UpAxis::Z, None).unwrap().note.unwrap().contains("--skeleton-up"));
        let told = stood(&odd, &mesh, UpAxis::Z, Some(UpAxis::MinusX)).unwrap();
        assert_eq!((told.skeleton.heads(), told.note), (skeleton.heads(), None));
    }

    #[test]
    fn joints_in_another_unit_are_told() {
        let (mesh, skeleton) = tower();
        let metres = skeleton.with_heads(skeleton.heads().iter().map(|p| p.map(|x| x / 100.0)).collect()).unwrap();
        let note = stood(&metres, &mesh, UpAxis::Y, None).unwrap().note.unwrap();
        assert!(note.contains("another unit"), "{note}");
        assert_eq!(stood(&skeleton, &mesh, UpAxis::Y, None).unwrap().note, None);
    }

    #[test]
    fn where_both_would_do_the_models_own_axis_counts() {
        let (mesh, skeleton) = tower();
        let low =
            skeleton.with_heads(vec![[0.0, 0.1, 0.0], [0.0, 0.2, 0.0], [0.0, 0.3, 0.0], [0.1, 0.3, 0.0]]).unwrap();
        let stood = stood(&lying(&low, UpAxis::Z), &mesh, UpAxis::Z, None).unwrap();
        assert_eq!((stood.skeleton.heads(), stood.note), (low.heads(), None));
    }
}
