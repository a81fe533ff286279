//! What is known of an asset once it has been looked at.

use riglab_core::{Asset, Rig};
use serde::{Deserialize, Serialize};

use crate::Category;
use crate::categories::{Guess, by_rules};
use crate::config::CurateConfig;
use crate::read::ReadAsset;
use crate::repair::repair;
use crate::shape::Shape;
use crate::stages::dropped;

/// The stage of what cannot be read.
pub const READ: &str = "read";

/// An asset that has been looked at.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Its name in the folder.
    pub name: String,
    /// The file it is in.
    pub file: String,
    /// The stage that dropped it and why; `None` if it passed those that look at one asset.
    pub dropped: Option<(String, String)>,
    /// What the importer and the repairs say of it.
    pub notes: Vec<String>,
    /// What was measured; `None` for what could not be read.
    pub facts: Option<Facts>,
}

/// What was measured of an asset that could be read, after its repair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Facts {
    /// BLAKE3 of its file, in hexadecimal.
    pub checksum: String,
    /// Joints.
    pub joints: usize,
    /// Vertices.
    pub vertices: usize,
    /// Triangles.
    pub triangles: usize,
    /// Weights that are not 0.
    pub weights: usize,
    /// The tree of joints: see [`riglab_core::Skeleton::topology`].
    pub topology: u64,
    /// Repairs made here.
    pub repairs: usize,
    /// Where it came from.
    pub source: String,
    /// The category its source states; may be empty, or none of the eight.
    pub stated: String,
    /// The category by rules.
    pub rules: Category,
    /// What spoke for it.
    pub because: String,
    /// Its description, for duplicates: as repairs leave it without its motions.
    pub shape: Shape,
}

impl Record {
    /// Of what could not be read.
    pub fn refused(name: String, file: String, reason: String) -> Self {
        Self { name, file, dropped: Some((READ.into(), reason)), notes: Vec::new(), facts: None }
    }

    /// Looks at an asset: repairs it, asks the stages, describes it.
    pub fn of(mut read: ReadAsset, file: String, config: &CurateConfig) -> Self {
        let name = read.asset.name.clone();
        let still = without_motions(&mut read.asset, config);
        let repairs = match repair(&mut read.asset, &config.repair) {
            Ok(repairs) => repairs.len(),
            Err(e) => return Self::refused(name, file, format!("its repair failed: {e}")),
        };
        let rig: &Rig = &read.asset.rig;
        let Guess { category, because } = by_rules(rig, read.seen.vrm);
        let from = &read.asset.provenance;
        let facts = Facts {
            checksum: from.checksum.clone(),
            joints: rig.skeleton().len(),
            vertices: rig.mesh().positions().len(),
            triangles: rig.mesh().triangles().len(),
            weights: rig.weights().nonzero(),
            topology: rig.skeleton().topology(),
            repairs,
            source: from.source.clone(),
            stated: from.category.clone(),
            rules: category,
            because: because.into(),
            shape: Shape::of(still.as_ref().unwrap_or(rig)),
        };
        let dropped = dropped(rig, &read.seen, config).map(|(stage, why)| (stage.name().to_owned(), why));
        Self { name, file, dropped, notes: from.notes.clone(), facts: Some(facts) }
    }

    /// BLAKE3 of its file, in hexadecimal; empty for what cannot be read.
    pub fn checksum(&self) -> &str {
        self.facts.as_ref().map_or("", |f| &f.checksum)
    }

    /// What decisions know it by: the first 16 digits of its file's checksum; empty for what cannot be read.
    pub fn digest(&self) -> &str {
        self.checksum().get(..16).unwrap_or(self.checksum())
    }
}

/// An asset's rig as it is repaired without its motions, where it has some: which joints they leave in it is nothing by which
/// one character is told from another.
fn without_motions(asset: &mut Asset, config: &CurateConfig) -> Option<Rig> {
    if asset.clips.is_empty() {
        return None;
    }
    let clips = std::mem::take(&mut asset.clips);
    let mut still = asset.clone();
    asset.clips = clips;
    repair(&mut still, &config.repair).ok().map(|_| still.rig)
}

/// Of a triangle on one joint, for tests.
#[cfg(test)]
pub(crate) fn facts(checksum: &str, source: &str) -> Facts {
    Facts {
        checksum: checksum.into(),
        joints: 1,
        vertices: 3,
        triangles: 1,
        weights: 3,
        topology: 0,
        repairs: 0,
        source: source.into(),
        stated: String::new(),
        rules: Category::Humanoid,
        because: String::new(),
        shape: Shape { joints: 0, values: Vec::new() },
    }
}

#[cfg(test)]
mod tests {
    use riglab_core::{Clip, Joint, JointId, Mesh, Provenance, Skeleton, SkinWeights};

    use super::*;
    use crate::read::ImportFindings;

    #[test]
    fn motions_do_not_tell_characters_apart() {
        let record = |height: f32| {
            let joints = [(None, 0.0), (Some(JointId(0)), 0.0), (Some(JointId(1)), 1.0)].map(|(parent, y)| Joint {
                name: format!("{parent:?}"),
                parent,
                head: [0.0, y, 0.0],
            });
            let positions = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
            let mesh = Mesh::new(positions, vec![[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]).unwrap();
            let weights = SkinWeights::normalized((0..4).map(|_| (0..3).map(|j| (j, 1.0)))).unwrap();
            let rig = Rig::new(Skeleton::new(Vec::from(joints)).unwrap(), mesh, weights).unwrap();
            let map = |up| [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0, up, 0.0]];
            let clip = Clip::new("rise".into(), 30.0, 3, vec![map(0.0), map(height), map(height)]).unwrap();
            let asset = Asset { name: "a".into(), rig, clips: vec![clip], provenance: Provenance::default() };
            let read = ReadAsset { asset, seen: ImportFindings::default() };
            Record::of(read, "a.glb".into(), &CurateConfig::default()).facts.unwrap()
        };
        let [folded, apart] = [0.0, 3.0].map(record);
        assert_eq!((folded.joints, apart.joints), (2, 3));
        assert_eq!(folded.shape, apart.shape);
    }
}
