//! All metrics of one asset: the one place that knows which a table has.

use riglab_core::{Clip, Mesh, Rig, Vec3};

use crate::motion::{farthest_motion, frames_of};
use crate::skin::farthest;
use crate::{
    Frames, Joints, Poses, Rows, SkeletonConvention, SkinConvention, Skins, clip_frames, connectivity, edges_of,
    local_shape_diameters, match_joints, motion, motion_of_frames, motion_poses, nearest_shares, ordered_by_position,
    tree_edit_distance,
};

/// Anymate's tolerance for joints, in [-1, 1]³.
const NEAR: f64 = 0.1;
/// Joints up to which they are matched, which takes their cube, and trees compared, where that is no more work; beyond, those
/// figures are undefined. Rigs have hundreds.
const MOST_JOINTS: usize = 1_500;

/// Whose table a number is for: what stands behind the `@` of a metric's name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// SkinTokens' tables: distances as RigNet's in percent of the longest side, weights as riglab reads the paper.
    Skintokens,
    /// UniRig's logged figures.
    Unirig,
    /// RigNet: with joints matched within half the local shape diameter, and tree edit distance.
    Rignet,
    /// MagicArticulate, after its merge.
    Magicarticulate,
    /// Puppeteer: skeletons as MagicArticulate, and its own figures of weights.
    Puppeteer,
    /// Anymate.
    Anymate,
    /// What no peer prints: exact distances, the true IoU of joints, trees compared without regard to the file's order.
    Riglab,
}

impl Preset {
    /// All, the default one first.
    pub const ALL: [Self; 7] = [
        Self::Skintokens,
        Self::Unirig,
        Self::Rignet,
        Self::Magicarticulate,
        Self::Puppeteer,
        Self::Anymate,
        Self::Riglab,
    ];

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Skintokens => "skintokens",
            Self::Unirig => "unirig",
            Self::Rignet => "rignet",
            Self::Magicarticulate => "magicarticulate",
            Self::Puppeteer => "puppeteer",
            Self::Anymate => "anymate",
            Self::Riglab => "riglab",
        }
    }

    /// The preset of that name.
    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|p| p.name() == name)
    }
}

/// A number with its metric and preset.
#[derive(Clone, Debug, PartialEq)]
pub struct Measure {
    /// Such as `j2j`.
    pub metric: &'static str,
    /// Whose formula.
    pub preset: Preset,
    /// NaN where it is undefined.
    pub value: f64,
}

impl Measure {
    /// `j2j@rignet`.
    pub fn name(&self) -> String {
        format!("{}@{}", self.metric, self.preset.name())
    }
}

/// Whether small or large values of a metric are the good ones; `None` for counts that are neither.
pub fn lower_is_better(metric: &str) -> Option<bool> {
    let base = metric.split('@').next().unwrap_or(metric);
    let starts = |all: &[&str]| all.iter().any(|s| base.starts_with(s));
    if matches!(base, "rows" | "joints" | "true_joints") {
        None
    } else {
        Some(!starts(&["joint_", "precision", "recall", "iou", "mask", "nearest", "connectivity", "dice"]))
    }
}

/// Whether a metric is one side of a trade-off: precision falls as recall rises, and a mask that covers everything covers
/// the truth. By it alone none of several systems is the best.
pub fn trades(metric: &str) -> bool {
    let base = metric.split('@').next().unwrap_or(metric);
    base.starts_with("mask_cover") || ["precision", "recall"].iter().any(|side| base.contains(side))
}

/// The truth of one asset, prepared once for all that is measured against it.
#[derive(Clone, Debug)]
pub struct Truth {
    /// Joints where the box of the mesh is [-1, 1] along its longest side.
    joints: Joints,
    to_mesh_cube: Map,
    /// The same for UniRig's box, of mesh and joints.
    whole: Joints,
    to_whole_cube: Map,
    vertices: Vec<[f64; 3]>,
    edges: Vec<[u32; 2]>,
    /// Half the local shape diameter at each joint; `NEAR` where no ray hits.
    tolerances: Vec<f64>,
    weights: Rows,
    poses: Poses,
    /// Of the asset's own clips; empty without any.
    frames: Frames,
}

/// p -> scale · (p - center)
#[derive(Clone, Copy, Debug)]
struct Map {
    center: [f64; 3],
    scale: f64,
}

impl Map {
    fn into_cube(points: impl Iterator<Item = Vec3>) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
        for p in points {
            for k in 0..3 {
                low[k] = low[k].min(f64::from(p[k]));
                high[k] = high[k].max(f64::from(p[k]));
            }
        }
        let longest = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let scale = if longest > 0.0 { 2.0 / longest } else { 1.0 };
        Self { center: std::array::from_fn(|k| (low[k] + high[k]) / 2.0), scale }
    }

    fn apply(&self, p: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|k| (p[k] - self.center[k]) * self.scale)
    }

    fn joints(&self, joints: &Joints) -> Joints {
        Joints { positions: joints.positions.iter().map(|p| self.apply(p)).collect(), parents: joints.parents.clone() }
    }
}

impl Truth {
    /// Of the asset `name`, whose poses hang on the name.
    pub fn new(name: &str, rig: &Rig) -> Self {
        let mesh = rig.mesh();
        let to_mesh_cube = Map::into_cube(mesh.positions().iter().copied());
        let to_whole_cube = Map::into_cube(mesh.positions().iter().chain(rig.skeleton().heads()).copied());
        let own = Joints::of(rig.skeleton());
        let joints = to_mesh_cube.joints(&own);
        let vertices: Vec<[f64; 3]> = wide(mesh).map(|p| to_mesh_cube.apply(&p)).collect();
        let half = |d: f64| if d.is_nan() { NEAR } else { d / 2.0 };
        let tolerances = local_shape_diameters(&vertices, mesh.triangles(), &joints).into_iter().map(half).collect();
        Self {
            whole: to_whole_cube.joints(&own),
            to_mesh_cube,
            to_whole_cube,
            edges: edges_of(mesh.triangles()),
            tolerances,
            weights: Rows::of(rig.weights(), rig.skeleton().len()),
            poses: motion_poses(name, &joints.parents),
            frames: Frames::new(),
            vertices,
            joints,
        }
    }

    /// Of an asset with clips: weights are also tried in frames of these.
    #[must_use]
    pub fn moving(mut self, clips: &[Clip]) -> Self {
        let Map { center, scale } = self.to_mesh_cube;
        self.frames = clip_frames(clips, scale, center.map(|c| -scale * c));
        self
    }

    /// How many joints.
    pub fn joints(&self) -> usize {
        self.joints.positions.len()
    }

    /// The figures of a predicted skeleton, given in the rig's own units.
    pub fn skeleton(&self, predicted: &Joints) -> Vec<Measure> {
        let (p, g) = (self.to_mesh_cube.joints(predicted), &self.joints);
        let few = p.positions.len().max(g.positions.len()) <= MOST_JOINTS;
        let matched = |tolerances: &[f64]| {
            let unknown = [f64::NAN; 4];
            let of = |m: crate::Matched| [m.dice(), m.precision(), m.recall(), m.iou()];
            if few { of(match_joints(&p.positions, &g.positions, tolerances)) } else { unknown }
        };
        let ted = |a: &[Option<usize>], b: &[Option<usize>]| {
            let edits = if few { tree_edit_distance(a, b) } else { None };
            edits.map_or(f64::NAN, |edits| edits as f64)
        };
        let mut out = Vec::new();
        let mut add = |preset, figures: &[(&'static str, f64)]| {
            out.extend(figures.iter().map(|&(metric, value)| Measure { metric, preset, value }));
        };
        let distances = |convention: SkeletonConvention, scale: f64| {
            let d = match convention {
                SkeletonConvention::Unirig => convention.distances(&self.to_whole_cube.joints(predicted), &self.whole),
                _ => convention.distances(&p, g),
            };
            [("j2j", scale * d.j2j), ("j2b", scale * d.j2b), ("b2b", scale * d.b2b)]
        };
        let rignet = distances(SkeletonConvention::Rignet, 1.0);
        add(Preset::Skintokens, &rignet.map(|(name, d)| (name, 100.0 * d)));
        add(Preset::Unirig, &distances(SkeletonConvention::Unirig, 1.0));
        add(Preset::Rignet, &rignet);
        let [dice, precision, recall, iou] = matched(&self.tolerances);
        add(
            Preset::Rignet,
            &[
                ("joint_dice", dice),
                ("joint_precision", precision),
                ("joint_recall", recall),
                ("ted", ted(&p.parents, &g.parents)),
            ],
        );
        let merged = distances(SkeletonConvention::Magicarticulate, 1.0);
        add(Preset::Magicarticulate, &merged);
        add(Preset::Puppeteer, &merged);
        add(Preset::Anymate, &distances(SkeletonConvention::Anymate, 1.0));
        let [dice, precision, recall, iou_010] = matched(&[NEAR]);
        let [nearest_precision, nearest_recall] = nearest_shares(&p.positions, &g.positions, NEAR);
        add(
            Preset::Anymate,
            &[
                ("joint_dice", dice),
                ("joint_precision", precision),
                ("joint_recall", recall),
                ("nearest_precision", nearest_precision),
                ("nearest_recall", nearest_recall),
            ],
        );
        add(Preset::Riglab, &distances(SkeletonConvention::Exact, 1.0));
        let sorted = ted(&ordered_by_position(&p), &ordered_by_position(g));
        let (count, wanted) = (p.positions.len() as f64, g.positions.len() as f64);
        add(
            Preset::Riglab,
            &[
                ("joint_iou", iou),
                ("joint_iou_010", iou_010),
                ("ted", sorted),
                ("joints_off", (count - wanted).abs() / wanted),
            ],
        );
        out
    }

    /// The figures of parents predicted for the true joints.
    pub fn parents(&self, predicted: &[Option<usize>]) -> Vec<Measure> {
        let c = connectivity(predicted, &self.joints.parents);
        let measure = |(metric, value)| Measure { metric, preset: Preset::Anymate, value };
        [("connectivity_precision", c.precision), ("connectivity_recall", c.recall)].map(measure).to_vec()
    }

    /// The figures of weights predicted for the true vertices and joints; `None` if they are not as many.
    pub fn skin(&self, predicted: &Rows) -> Option<Vec<Measure>> {
        let (truth, edges) = (&self.weights, &self.edges);
        if (predicted.len(), predicted.columns()) != (truth.len(), truth.columns()) {
            return None;
        }
        let skins = Skins { truth, predicted, edges };
        let moved = motion(&self.vertices, &self.joints, &self.poses, truth, predicted);
        let mut out = Vec::new();
        let mut add = |preset, figures: crate::Figures| {
            out.extend(figures.into_iter().map(|(metric, value)| Measure { metric, preset, value }));
        };
        add(Preset::Skintokens, SkinConvention::Skintokens.figures(&skins));
        add(Preset::Skintokens, vec![("motion", moved.mean)]);
        add(Preset::Unirig, SkinConvention::Unirig.figures(&skins));
        add(Preset::Unirig, vec![("motion_mse", moved.mse)]);
        add(Preset::Rignet, SkinConvention::Rignet.figures(&skins));
        add(Preset::Rignet, vec![("motion", moved.mean), ("motion_mean_max", moved.mean_max)]);
        add(Preset::Puppeteer, SkinConvention::Puppeteer.figures(&skins));
        let renamed = |convention: SkinConvention, names: [&'static str; 4]| {
            names.into_iter().zip(convention.figures(&skins)).map(|(name, (_, v))| (name, v)).take(3).collect()
        };
        add(
            Preset::Puppeteer,
            renamed(SkinConvention::PuppeteerModelsresource, ["precision_035", "recall_035", "l1_035", ""]),
        );
        add(
            Preset::Puppeteer,
            renamed(SkinConvention::PuppeteerOneRing, ["precision_ring", "recall_ring", "l1_ring", ""]),
        );
        add(Preset::Anymate, SkinConvention::Anymate.figures(&skins));
        add(Preset::Riglab, vec![("motion_max", moved.max), ("motion_rms", moved.rms)]);
        if !self.frames.is_empty() {
            let clips = motion_of_frames(&self.vertices, &self.frames, truth, predicted);
            add(Preset::Unirig, vec![("clips_mse", clips.mse)]);
            add(Preset::Riglab, vec![("clips", clips.mean)]);
        }
        Some(out)
    }

    /// What an asset is given that failed, where failures are to count: of each figure that has a bound the worst that
    /// there is, since a wrong bone is worse than none. Shares (precision, recall, IoU, Dice, masks) have 0; distances of
    /// weights, and of what they move, have what the worst weights of sum 1 have: see [`farthest`] and
    /// [`farthest_motion`]. NaN is the variance of weights' distances, whose worst is not known. Skeletons may be any
    /// distance off: distances, `ted` and `joints_off` are those of one joint at the centre of the box.
    pub fn worst(&self) -> Vec<Measure> {
        let one = Joints { positions: vec![self.to_mesh_cube.center], parents: vec![None] };
        let mut skin: Vec<Measure> = Vec::new();
        for weights in farthest(&self.weights) {
            let figures = self.skin(&weights).unwrap_or_default();
            if skin.is_empty() {
                skin = figures;
                continue;
            }
            skin.iter_mut().zip(figures).for_each(|(m, other)| m.value = m.value.max(other.value));
        }
        let posed = farthest_motion(&self.vertices, &frames_of(&self.joints, &self.poses), &self.weights);
        let clips = farthest_motion(&self.vertices, &self.frames, &self.weights);
        let mut moved = posed.figures();
        moved.extend([("clips", clips.mean), ("clips_mse", clips.mse)]);
        // A mean of neighbours' weights is bounded as a vertex' own is.
        moved.extend(skin.iter().find(|m| m.name() == "l1@puppeteer").map(|m| ("l1_ring", m.value)));
        moved.push(("l1_var", f64::NAN));
        for m in &mut skin {
            m.value = moved.iter().find(|(name, _)| *name == m.metric).map_or(m.value, |(_, worst)| *worst);
        }
        let mut all = [self.skeleton(&one), skin].concat();
        let shares = all.iter_mut().filter(|m| lower_is_better(m.metric) == Some(false) && !m.value.is_nan());
        shares.for_each(|m| m.value = 0.0);
        all
    }
}

fn wide(mesh: &Mesh) -> impl Iterator<Item = [f64; 3]> + '_ {
    mesh.positions().iter().map(|p| p.map(f64::from))
}

#[cfg(test)]
mod tests {
    use riglab_core::{Joint, JointId, Skeleton, SkinWeights};

    use super::*;

    /// A bar along y of length 10, held by a chain of three joints.
    fn bar() -> Rig {
        let joint = |k: u16| Joint {
            name: format!("{k}"),
            parent: k.checked_sub(1).map(JointId),
            head: [0.5, 1.0 + 4.0 * f32::from(k), 0.5],
        };
        let skeleton = Skeleton::new((0..3).map(joint).collect()).unwrap();
        let ring = |y: f32| [[0.0, y, 0.0], [1.0, y, 0.0], [1.0, y, 1.0], [0.0, y, 1.0]];
        let positions: Vec<Vec3> = (0..=10).flat_map(|y| ring(y as f32)).collect();
        let side = |r: u32, k: u32| {
            let (a, b) = (4 * r + k, 4 * r + (k + 1) % 4);
            [[a, b, a + 4], [b, b + 4, a + 4]]
        };
        let triangles = (0..10).flat_map(|r| (0..4).flat_map(move |k| side(r, k))).collect();
        let rows = (0..=10u16).flat_map(|y| [(); 4].map(|()| vec![(y / 4, 1.0), ((y / 4 + 1).min(2), 0.5)]));
        let mesh = Mesh::new(positions, triangles).unwrap();
        Rig::new(skeleton, mesh, SkinWeights::normalized(rows).unwrap()).unwrap()
    }

    fn value(of: &[Measure], name: &str) -> f64 {
        of.iter().find(|m| m.name() == name).unwrap_or_else(|| panic!("{name}")).value
    }

    #[test]
    fn the_truth_scores_best() {
        let (rig, truth) = (bar(), Truth::new("bar", &bar()));
        let mut own = truth.skeleton(&Joints::of(rig.skeleton()));
        own.extend(truth.parents(&Joints::of(rig.skeleton()).parents));
        own.extend(truth.skin(&Rows::of(rig.weights(), 3)).unwrap());
        for m in own {
            let best = match lower_is_better(m.metric) {
                Some(true) => 0.0,
                Some(false) => 1.0,
                None => continue,
            };
            let room = match m.name().as_str() {
                name if name.contains("_ring") => 0.5, // a mean over neighbours
                // UniRig misses the parents' ends; these two are logarithms of weights, not of their difference.
                "j2b@unirig" => 0.01,
                "bce@unirig" | "cross_entropy@anymate" => 1.0,
                _ => 1e-4,
            };
            assert!((m.value - best).abs() < room, "{} {}", m.name(), m.value);
        }
    }

    #[test]
    fn units_are_those_of_each_table() {
        let (rig, truth) = (bar(), Truth::new("bar", &bar()));
        // Shifted by a tenth of the longest side.
        let mut shifted = Joints::of(rig.skeleton());
        shifted.positions.iter_mut().for_each(|p| p[0] += 1.0);
        let m = truth.skeleton(&shifted);
        let close =
            |name: &str, want: f64| assert!((value(&m, name) - want).abs() < 1e-6, "{name} {}", value(&m, name));
        close("j2j@skintokens", 10.0);
        close("j2j@rignet", 0.1);
        close("j2j@unirig", 0.1);
        close("j2j@anymate", 0.2);
        close("j2b@riglab", 0.1);
        // The bar is 0.2 thick in this cube: half of its diameter is about 0.12, less than the shift of 0.2.
        close("joint_dice@rignet", 0.0);
    }

    #[test]
    fn a_failure_that_counts_is_bad_but_finite_where_it_can_be() {
        let worst = Truth::new("bar", &bar()).worst();
        assert!(value(&worst, "j2j@skintokens") > 10.0 && value(&worst, "recall@skintokens") == 0.0);
        assert!(value(&worst, "j2b@skintokens").is_nan() && value(&worst, "l1_var@skintokens").is_nan());
        // One joint in the middle of a chain of three is near the middle one.
        assert_eq!(value(&worst, "joint_recall@anymate"), 0.0);
        assert!(Truth::new("bar", &bar()).skin(&Rows::dense(&[1.0], 1)).is_none());
    }

    #[test]
    fn no_weights_are_worse_than_those_of_a_failure() {
        use riglab_random::{Draw, stream};
        let rig = bar();
        let truth = Truth::new("bar", &rig);
        let (worst, vertices) = (truth.worst(), rig.mesh().positions().len());
        let mut random = stream(3, "test", &[]);
        for round in 0..300 {
            // Of one bone, of none, of some.
            let mut row = || {
                let power = [0.2, 1.0, 20.0][round % 3];
                let row = [(); 3].map(|()| libm::powf(random.unit(), power));
                let sum: f32 = row.iter().sum();
                match round % 5 {
                    0 => [(); 3].map(|()| 0.0),
                    1 => std::array::from_fn(|k| f32::from(row[k] >= row.iter().copied().fold(0.0, f32::max))),
                    _ => row.map(|w| w / sum),
                }
            };
            let weights: Vec<f32> = (0..vertices).flat_map(|_| row()).collect();
            for m in truth.skin(&Rows::dense(&weights, 3)).unwrap() {
                let bound = value(&worst, &m.name());
                let sound = match lower_is_better(m.metric) {
                    Some(true) => bound.is_nan() || m.value <= bound + 1e-6,
                    Some(false) => m.value.is_nan() || m.value >= bound,
                    None => true,
                };
                assert!(sound, "{} {} is worse than {bound}", m.name(), m.value);
            }
        }
        // What has no weights is not the worst, nor is what a bone holds that it should not.
        let none = truth.skin(&Rows::new((0..vertices).map(|_| []), 3)).unwrap();
        for name in ["l1@unirig", "l2@unirig", "smooth_l1@unirig", "bce@unirig", "zero_l1@unirig", "l1@skintokens"] {
            assert!(value(&none, name) < value(&worst, name), "{name}");
        }
        assert!(value(&none, "mask_050@unirig") > 0.0 && value(&worst, "mask_050@unirig") == 0.0);
    }
}
