//! What a curation is told: the stages, in order, and a section for each.

use std::ops::RangeInclusive;

use serde::{Deserialize, Serialize};

use crate::categories::Category;
use crate::stages::StageName;

/// A whole curation. `configs/curation/` holds it as presets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CurateConfig {
    /// How files are read.
    pub import: ImportConfig,
    /// What is mended before the stages look.
    pub repair: RepairConfig,
    /// Which stages look, in this order; an asset is counted at the first that drops it.
    pub stages: Vec<StageName>,
    /// Stage `bones`.
    pub bones: BonesConfig,
    /// Stage `tree`.
    pub tree: TreeConfig,
    /// Stage `weights`.
    pub weights: WeightsConfig,
    /// Stage `size`.
    pub size: SizeConfig,
    /// Stage `objects`.
    pub objects: ObjectsConfig,
    /// Stage `outside`.
    pub outside: OutsideConfig,
    /// Stage `humanoid`.
    pub humanoid: HumanoidConfig,
    /// Stage `duplicates`; it compares assets and so comes last, wherever it is listed.
    pub duplicates: DuplicatesConfig,
    /// How categories are found.
    pub categories: CategoriesConfig,
    /// How splits are made.
    pub split: SplitConfig,
    /// A file of decisions made by a person; empty for none.
    pub decisions: String,
    /// The funnel report.
    pub report: ReportConfig,
}

/// How files are read.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ImportConfig {
    /// Loose roots become children of the largest tree's root (`false`), or all roots become children
    /// of a new one (`true`).
    pub virtual_root: bool,
    /// Each of several characters in a file is an asset of its own, judged by itself; a mesh that hangs on no joint is of none.
    pub split_characters: bool,
    /// Repair what takes a guess, as `riglab dataset import --repair`.
    pub repair: bool,
    /// Frames a second of motions that are kept; 0 keeps none.
    pub clips: f32,
}

/// What is mended. Weights that do not sum to 1, negative ones and vertices without are mended where files
/// are read, as are loose roots; this is what is left.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RepairConfig {
    /// Leave out control and IK bones: branches of joints without weight that do not hang on a joint with
    /// weight, or are named as controls. The root, human bones and springs stay.
    pub control_bones: bool,
    /// Leave out end joints too: branches without weight that hang on a joint with weight.
    pub end_bones: bool,
    /// Fold joints that stand where their parent stands into it, with their weights and children, unless motions that are kept
    /// (`import.clips`) move them otherwise than their parent.
    pub zero_length: bool,
    /// Two joints stand in one place if they are no farther apart than this share of the box's diagonal.
    pub zero_length_share: f32,
}

/// Stage `bones`: how many joints, after repair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct BonesConfig {
    /// At least.
    pub min: usize,
    /// At most.
    pub max: usize,
}

/// Stage `tree`: one connected tree.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TreeConfig {
    /// Skeletons that no skin connects, at most: several are several characters.
    pub skeletons: usize,
    /// Roots under one skin, at most; all but one were attached by the importer.
    pub roots: usize,
}

/// Stage `weights`: what the importer could not mend well.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct WeightsConfig {
    /// Joints that carry weight, at least.
    pub joints: usize,
    /// Share of the vertices without weight in the file, at most.
    pub unweighted: f32,
    /// Share of the vertices whose weights did not sum to 1, at most.
    pub unnormalised: f32,
    /// Whether weights that look like those of other vertices are dropped.
    pub far: bool,
}

/// Stage `size`: the mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SizeConfig {
    /// Vertices, at least and at most.
    pub vertices: [usize; 2],
    /// Triangles, at least and at most.
    pub triangles: [usize; 2],
}

/// Stage `objects`: one object, not a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ObjectsConfig {
    /// Unskinned meshes beside the rig (a floor, props), at most; they are not in the corpus.
    pub left_out: usize,
    /// Nodes that hold meshes of the rig, at most.
    pub parts: usize,
    /// Gap between pieces of the mesh, as a share of the box's diagonal, that makes them two objects.
    pub gap: f32,
}

/// Stage `outside`: joints far outside the mesh.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct OutsideConfig {
    /// How far outside the mesh's box, as a share of its diagonal, is far.
    pub distance: f32,
    /// Share of the joints that may be far outside. The root does not count: it often stands on the floor.
    pub share: f32,
}

/// Stage `humanoid`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct HumanoidConfig {
    /// Whether the file has to say which joints are the human bones that VRM asks for.
    pub complete: bool,
    /// Springs, at least.
    pub springs: usize,
}

/// Stage `duplicates`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DuplicatesConfig {
    /// How far two assets' descriptions may be apart, in units of their size: see [`crate::shape`].
    pub tolerance: f32,
}

/// How categories are found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct CategoriesConfig {
    /// What names the category of an asset whose source does not.
    pub by: Labeller,
    /// Whether a category that the source states (`manifest.json`) is kept, if it is one of the eight.
    pub trust_source: bool,
    /// Categories that are kept; empty for all.
    pub keep: Vec<Category>,
    /// The vision-language model, for `by = "vlm"`.
    pub vlm: VlmConfig,
}

/// What names categories.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Labeller {
    /// Rules over skeleton and shape.
    #[default]
    Rules,
    /// A vision-language model, and the rules where it gives no answer.
    Vlm,
}

/// A vision-language model behind an OpenAI-compatible endpoint.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VlmConfig {
    /// Up to and with `/v1`; `/chat/completions` follows.
    pub url: String,
    /// The model's name.
    pub model: String,
    /// The environment variable that holds the key; empty or unset for none.
    pub key_from: String,
    /// What is asked. `{categories}` stands for the list.
    pub prompt: String,
    /// Pixels along a side of each view.
    pub pixels: u32,
    /// Views: degrees around the subject.
    pub views: Vec<f32>,
    /// Seconds until an answer is given up.
    pub timeout_s: f64,
    /// How often a question is asked again after a fault or a senseless answer.
    pub retries: u32,
    /// Seconds before the first repetition, doubled each time; an endpoint's `Retry-After` goes before.
    pub wait_s: f64,
    /// Seconds waited at most.
    pub wait_most_s: f64,
    /// Questions asked at once.
    pub parallel: usize,
    /// Faults in a row after which nothing more is asked.
    pub give_up_after: usize,
}

/// How splits are made.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct SplitConfig {
    /// What stays together.
    pub by: SplitBy,
    /// Seed, for all but `list`.
    pub seed: u64,
    /// JSON object of lists of names by split, for `list`.
    pub file: String,
}

/// What stays together in a split.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SplitBy {
    /// Skeletons of one topology: `test_new` has topologies that training has not seen.
    #[default]
    Topology,
    /// Assets of one source: `test_new` has sources that training has not seen.
    Source,
    /// As a file says.
    List,
}

/// The funnel report.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct ReportConfig {
    /// Pictures of kept assets; 0 for none.
    pub kept: usize,
    /// Pictures of dropped assets of each stage; 0 for none.
    pub dropped: usize,
    /// Pixels along a side of a picture.
    pub pixels: u32,
}

impl Default for CurateConfig {
    fn default() -> Self {
        Self {
            import: ImportConfig::default(),
            repair: RepairConfig::default(),
            stages: StageName::ALL.to_vec(),
            bones: BonesConfig::default(),
            tree: TreeConfig::default(),
            weights: WeightsConfig::default(),
            size: SizeConfig::default(),
            objects: ObjectsConfig::default(),
            outside: OutsideConfig::default(),
            humanoid: HumanoidConfig::default(),
            duplicates: DuplicatesConfig::default(),
            categories: CategoriesConfig::default(),
            split: SplitConfig::default(),
            decisions: String::new(),
            report: ReportConfig::default(),
        }
    }
}

impl Default for RepairConfig {
    fn default() -> Self {
        Self { control_bones: true, end_bones: false, zero_length: true, zero_length_share: 1e-5 }
    }
}

impl Default for BonesConfig {
    fn default() -> Self {
        Self { min: 1, max: 65_535 }
    }
}

impl Default for TreeConfig {
    fn default() -> Self {
        Self { skeletons: 1_000_000, roots: 1_000_000 }
    }
}

impl Default for WeightsConfig {
    fn default() -> Self {
        Self { joints: 1, unweighted: 1.0, unnormalised: 1.0, far: false }
    }
}

impl Default for SizeConfig {
    fn default() -> Self {
        Self { vertices: [1, 100_000_000], triangles: [1, 100_000_000] }
    }
}

impl Default for ObjectsConfig {
    fn default() -> Self {
        Self { left_out: 1_000_000, parts: 1_000_000, gap: 1.0 }
    }
}

impl Default for OutsideConfig {
    fn default() -> Self {
        Self { distance: 1.0, share: 1.0 }
    }
}

impl Default for DuplicatesConfig {
    fn default() -> Self {
        Self { tolerance: crate::shape::TOLERANCE }
    }
}

impl Default for CategoriesConfig {
    fn default() -> Self {
        Self { by: Labeller::Rules, trust_source: true, keep: Vec::new(), vlm: VlmConfig::default() }
    }
}

impl Default for VlmConfig {
    fn default() -> Self {
        Self {
            url: "http://127.0.0.1:8000/v1".into(),
            model: String::new(),
            key_from: "OPENAI_API_KEY".into(),
            prompt: "The pictures show one 3D model from several sides. Which of these is it: {categories}? \
                     Answer with that one word alone."
                .into(),
            pixels: 256,
            views: vec![32.0, 152.0, 272.0],
            timeout_s: 60.0,
            retries: 4,
            wait_s: 1.0,
            wait_most_s: 60.0,
            parallel: 4,
            give_up_after: 8,
        }
    }
}

impl Default for ReportConfig {
    fn default() -> Self {
        Self { kept: 60, dropped: 12, pixels: 160 }
    }
}

/// What is wrong with a value: its path and a sentence.
pub type Invalid = (&'static str, String);

impl CurateConfig {
    /// Checks what belongs together.
    ///
    /// # Errors
    /// The first value that cannot be, by its path.
    pub fn validate(&self) -> Result<(), Invalid> {
        let mut seen = Vec::new();
        for stage in &self.stages {
            if seen.contains(stage) {
                return Err(("stages", format!("`{}` is listed twice", stage.name())));
            }
            seen.push(*stage);
        }
        range("bones.min", self.bones.min..=self.bones.max)?;
        range("size.vertices", self.size.vertices[0]..=self.size.vertices[1])?;
        range("size.triangles", self.size.triangles[0]..=self.size.triangles[1])?;
        for (path, share) in [
            ("weights.unweighted", self.weights.unweighted),
            ("weights.unnormalised", self.weights.unnormalised),
            ("outside.share", self.outside.share),
            ("objects.gap", self.objects.gap),
        ] {
            if !(0.0..=1.0).contains(&share) {
                return Err((path, format!("{share} is no share from 0 to 1")));
            }
        }
        if !(self.outside.distance >= 0.0 && self.outside.distance.is_finite()) {
            return Err(("outside.distance", "a distance is 0 or more".into()));
        }
        if !(1e-6..=0.1).contains(&self.duplicates.tolerance) {
            return Err(("duplicates.tolerance", "a tolerance is from 0.000001 to 0.1".into()));
        }
        if !(0.0..=0.01).contains(&self.repair.zero_length_share) {
            return Err(("repair.zero_length_share", "the share is from 0 to 0.01".into()));
        }
        if !(self.import.clips == 0.0 || (0.01..=1000.0).contains(&self.import.clips)) {
            return Err(("import.clips", "a rate is between 0.01 and 1000 frames a second, or 0".into()));
        }
        if self.split.by == SplitBy::List && self.split.file.is_empty() {
            return Err(("split.by", "`list` takes a file: set split.file".into()));
        }
        if !(16..=1024).contains(&self.report.pixels) {
            return Err(("report.pixels", "a picture has from 16 to 1024 pixels along a side".into()));
        }
        if self.categories.by == Labeller::Vlm { self.categories.vlm.validate() } else { Ok(()) }
    }
}

impl VlmConfig {
    fn validate(&self) -> Result<(), Invalid> {
        let seconds = |s: f64| (0.0..=86_400.0).contains(&s);
        if self.model.is_empty() {
            return Err(("categories.vlm.model", "give the name of the model to ask".into()));
        }
        if !(self.url.starts_with("http://") || self.url.starts_with("https://")) {
            return Err(("categories.vlm.url", "an address starts with http:// or https://".into()));
        }
        if self.views.is_empty() || self.views.len() > 16 || !self.views.iter().all(|v| v.is_finite()) {
            return Err(("categories.vlm.views", "give from 1 to 16 angles".into()));
        }
        if !(16..=2048).contains(&self.pixels) {
            return Err(("categories.vlm.pixels", "a view has from 16 to 2048 pixels along a side".into()));
        }
        if !(seconds(self.wait_s) && seconds(self.wait_most_s) && self.timeout_s > 0.0 && seconds(self.timeout_s)) {
            return Err(("categories.vlm.timeout_s", "times are seconds, at most a day".into()));
        }
        if !(1..=256).contains(&self.parallel) || self.give_up_after == 0 || self.retries > 100 {
            return Err((
                "categories.vlm.parallel",
                "parallel is from 1 to 256, give_up_after at least 1, retries at most 100".into(),
            ));
        }
        Ok(())
    }
}

fn range(path: &'static str, range: RangeInclusive<usize>) -> Result<(), Invalid> {
    if range.is_empty() { Err((path, format!("{} to {} is empty", range.start(), range.end()))) } else { Ok(()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_default_is_valid_and_keeps_every_rig() {
        let config = CurateConfig::default();
        assert_eq!(config.validate(), Ok(()));
        assert_eq!(config.stages.last(), Some(&StageName::Duplicates));
    }

    #[test]
    fn what_cannot_be_is_told_by_its_path() {
        let fault = |change: fn(&mut CurateConfig)| {
            let mut config = CurateConfig::default();
            change(&mut config);
            config.validate().unwrap_err().0
        };
        assert_eq!(fault(|c| c.bones = BonesConfig { min: 9, max: 3 }), "bones.min");
        assert_eq!(fault(|c| c.stages.push(StageName::Tree)), "stages");
        assert_eq!(fault(|c| c.outside.share = 1.5), "outside.share");
        assert_eq!(fault(|c| c.duplicates.tolerance = f32::NAN), "duplicates.tolerance");
        assert_eq!(fault(|c| c.split.by = SplitBy::List), "split.by");
        assert_eq!(fault(|c| c.categories.by = Labeller::Vlm), "categories.vlm.model");
    }
}
