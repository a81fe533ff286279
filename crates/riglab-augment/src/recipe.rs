//! All augmentations in their order, and the orders and values of papers and public code.

use riglab_core::{Asset, Clip, Rig, RigError};
use riglab_random::{Draw, stream};
use serde::{Deserialize, Serialize};

use crate::cube::{CubeConfig, Shift, into_cube};
use crate::delete::DeleteConfig;
use crate::discretise::DiscretiseConfig;
use crate::draft::{Augmented, Draft};
use crate::jitter::{JitterConfig, JointNoiseConfig};
use crate::linear::{AxesConfig, FlipConfig, LinearParts, RotateConfig, ScaleConfig, TurnConfig, linear};
use crate::part::PartConfig;
use crate::pose::PoseConfig;
use crate::reconnect::ReconnectConfig;
use crate::rules::Fault;
use crate::trim::TrimConfig;

/// What is done to a rig before it is sampled, in the order of the fields. Each has a probability of
/// its own and draws from a stream of its own, so that switching one does not change what another
/// draws. The default only normalises.
///
/// In a config this is a table, usually `[augment]`:
///
/// ```toml
/// [augment]
/// extends = "augment/skintokens_vae.toml"
/// pose = { probability = 1.0, degrees = 45.0 }
/// ```
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Recipe {
    /// Joints that hold nothing.
    pub trim: TrimConfig,
    /// Joints with their vertices, or subtrees.
    pub delete: DeleteConfig,
    /// All but a random part.
    pub part: PartConfig,
    /// Joints in between.
    pub reconnect: ReconnectConfig,
    /// A pose as the new rest.
    pub pose: PoseConfig,
    /// By axis; first of the parts of one matrix, which is about the origin.
    pub scale: ScaleConfig,
    /// By given angles about x, y and z.
    pub turn_x: TurnConfig,
    /// See `turn_x`.
    pub turn_y: TurnConfig,
    /// See `turn_x`.
    pub turn_z: TurnConfig,
    /// Mirroring.
    pub flip: FlipConfig,
    /// By a random vector.
    pub rotate: RotateConfig,
    /// Exchange of axes; last of the parts of one matrix.
    pub axes: AxesConfig,
    /// Into the cube.
    pub cube: CubeConfig,
    /// Noise on vertices and normals.
    pub jitter: JitterConfig,
    /// Noise on joints.
    pub joint_noise: JointNoiseConfig,
    /// Joints to the middle of their cells.
    pub discretise: DiscretiseConfig,
}

impl Recipe {
    /// Checks ranges.
    ///
    /// # Errors
    /// (key, message) of the first fault; keys as in the config, such as `pose.degrees`.
    pub fn validate(&self) -> Result<(), (String, String)> {
        // Named one by one: the compiler tells of a field that is added and not checked.
        let Self {
            trim: _,
            delete,
            part,
            reconnect,
            pose,
            scale,
            turn_x,
            turn_y,
            turn_z,
            flip,
            rotate,
            axes,
            cube,
            jitter,
            joint_noise,
            discretise,
        } = self;
        let at = |part: &'static str| move |(key, message): Fault| (format!("{part}.{key}"), message);
        delete.validate().map_err(at("delete"))?;
        part.validate().map_err(at("part"))?;
        reconnect.validate().map_err(at("reconnect"))?;
        pose.validate().map_err(at("pose"))?;
        scale.validate().map_err(at("scale"))?;
        turn_x.validate().map_err(at("turn_x"))?;
        turn_y.validate().map_err(at("turn_y"))?;
        turn_z.validate().map_err(at("turn_z"))?;
        flip.validate().map_err(at("flip"))?;
        rotate.validate().map_err(at("rotate"))?;
        axes.validate().map_err(at("axes"))?;
        cube.validate().map_err(at("cube"))?;
        jitter.validate().map_err(at("jitter"))?;
        joint_noise.validate().map_err(at("joint_noise"))?;
        discretise.validate().map_err(at("discretise"))
    }

    /// Whether what becomes of a mesh hangs on its skeleton: whether vertices go with joints, or are posed by them.
    pub fn reads_skeletons(&self) -> bool {
        self.delete.probability > 0.0 || self.part.probability > 0.0 || self.pose.probability > 0.0
    }

    /// Augments a rig by the draws of a seed and an index, say a step and an asset: same numbers, same
    /// bytes.
    ///
    /// # Errors
    /// None that a valid rig and a validated recipe can give; kept so that a fault of this crate costs
    /// a sample and not a run.
    pub fn apply(&self, rig: Rig, seed: u64, index: &[u64]) -> Result<Augmented, RigError> {
        self.applied(rig, seed, index)?.close()
    }

    /// As [`Self::apply`], for networks, which see rigs in [-1, 1]³: where the recipe does not set rigs into its cube, they
    /// are set into this one last. Where it does, they stay where its scale, its shift and noise have left them, as in the
    /// public code, and so do joints in the middle of their cells.
    ///
    /// # Errors
    /// As [`Self::apply`].
    pub fn apply_in_cube(&self, rig: Rig, seed: u64, index: &[u64]) -> Result<Augmented, RigError> {
        let mut draft = self.applied(rig, seed, index)?;
        if !self.cube.enabled {
            into_cube(&mut draft, CubeConfig::default().into, 1.0, [0.0; 3]);
        }
        draft.close()
    }

    fn applied(&self, rig: Rig, seed: u64, index: &[u64]) -> Result<Draft, RigError> {
        let Self {
            trim,
            delete,
            part,
            reconnect,
            pose,
            scale,
            turn_x,
            turn_y,
            turn_z,
            flip,
            rotate,
            axes,
            cube,
            jitter,
            joint_noise,
            discretise,
        } = self;
        let mut draft = Draft::open(rig);
        let of = |purpose: &str| stream(seed, purpose, index);
        trim.apply(&mut draft);
        delete.apply(&mut draft, &mut of("augment delete"));
        part.apply(&mut draft, &mut of("augment part"));
        reconnect.apply(&mut draft, &mut of("augment reconnect"));
        pose.apply(&mut draft, &mut of("augment pose"));
        let mut about_y = of("augment turn");
        // Once this stream told first whether to turn about x; runs of that time turned about y by what follows.
        about_y.unit();
        let parts = LinearParts {
            scale: scale.draw(&mut of("augment scale")),
            turns: [
                turn_x.draw(0, &mut of("augment turn x")),
                turn_y.draw(1, &mut about_y),
                turn_z.draw(2, &mut of("augment turn z")),
            ],
            flip: flip.draw(&mut of("augment flip")),
            rotate: rotate.draw(&mut of("augment rotate")),
            axes: axes.draw(&mut of("augment axes")),
        };
        linear(&mut draft, parts.matrix(), flip.keep_winding);
        cube.apply(&mut draft, &mut of("augment cube"));
        jitter.apply(&mut draft, &mut of("augment jitter"))?;
        joint_noise.apply(&mut draft, &mut of("augment joint noise"));
        discretise.apply(&mut draft, &mut of("augment discretise"));
        Ok(draft)
    }

    /// As [`Self::apply`], of an asset with its motions, whatever its units: steps see it in the cube, and it comes back
    /// to where it was.
    ///
    /// # Errors
    /// As [`Self::apply`], for clips of another rig, and where what comes back lies beyond the greatest numbers.
    pub fn apply_to_asset(&self, asset: Asset, seed: u64, index: &[u64]) -> Result<Asset, RigError> {
        let (rig, into) = asset.rig.normalized();
        let back = into.inverse();
        let varied = self.apply(rig, seed, index)?;
        let clip = |clip: &Clip| varied.clip(&clip.transformed(into)?)?.transformed(back);
        let clips = asset.clips.iter().map(clip).collect::<Result<_, _>>()?;
        Ok(Asset { rig: varied.rig.transformed(back)?, clips, ..asset })
    }

    /// SkinTokens' skeleton model (paper, 4.1.2). The paper gives no range of the scale; this is the
    /// public code's.
    pub fn skintokens_ar() -> Self {
        Self {
            trim: TrimConfig { enabled: true },
            delete: DeleteConfig { probability: 0.5, up_to: 0.5, subtrees: 0.5 },
            pose: PoseConfig { probability: 0.5, degrees: 30.0, scale: [1.0, 1.0] },
            scale: ScaleConfig { probability: 0.5, range: [0.7, 1.3], uniform: false },
            rotate: RotateConfig { probability: 0.2, degrees: 15.0 },
            jitter: JitterConfig { probability: 1.0, sigma: 1e-3, ..JitterConfig::default() },
            joint_noise: JointNoiseConfig { probability: 1.0, sigma: 1e-2, clip: 0.0 },
            ..Self::default()
        }
    }

    /// SkinTokens' auto-encoder: as [`Self::skintokens_ar`], with joints connected to new parents.
    pub fn skintokens_vae() -> Self {
        Self { reconnect: ReconnectConfig { probability: 0.5, share: 0.3, up_to: true }, ..Self::skintokens_ar() }
    }

    /// What UniRig's public code trains its skeleton model with; its quarter turns are about the vertical
    /// axis, which is z there.
    pub fn unirig_ar() -> Self {
        Self {
            part: PartConfig { probability: 0.5, keep: 0.5, at_least: 0.25 },
            pose: PoseConfig { probability: 0.5, degrees: 60.0, scale: [1.0, 1.0] },
            scale: ScaleConfig { probability: 0.5, range: [0.33, 3.33], uniform: false },
            turn_y: TurnConfig { probability: 0.75, degrees: vec![90.0, 180.0, 270.0] },
            rotate: RotateConfig { probability: 0.5, degrees: 90.0 },
            cube: CubeConfig {
                scale_probability: 0.5,
                scale: [0.5, 1.0],
                shift_probability: 0.5,
                shift: Shift::UpTo(0.1),
                ..CubeConfig::default()
            },
            jitter: JitterConfig {
                probability: 0.5,
                sigma: 0.005,
                clip: 0.01,
                normal_sigma: 0.02,
                normal_clip: 0.04,
                strength: [0.0, 1.0],
            },
            ..Self::default()
        }
    }

    /// What UniRig's public code trains its skin model with.
    pub fn unirig_skin() -> Self {
        Self {
            reconnect: ReconnectConfig { probability: 0.05, share: 0.5, up_to: false },
            pose: PoseConfig { probability: 0.05, degrees: 30.0, scale: [1.0, 1.0] },
            turn_y: TurnConfig { probability: 0.05, degrees: vec![90.0, 180.0, 270.0] },
            cube: CubeConfig { scale_probability: 0.05, scale: [0.85, 1.0], ..CubeConfig::default() },
            jitter: JitterConfig {
                probability: 0.5,
                sigma: 1e-4,
                clip: 2e-4,
                normal_sigma: 0.01,
                normal_clip: 0.02,
                strength: [0.0, 1.0],
            },
            joint_noise: JointNoiseConfig { probability: 0.5, sigma: 1.0 / 128.0, clip: 1.0 / 128.0 },
            discretise: DiscretiseConfig { probability: 0.5, ..DiscretiseConfig::default() },
            ..Self::default()
        }
    }

    /// UniRig's test sets with a star: random rotation, scale and motion of rigs that are not trained
    /// on, nothing else. Their ranges were not published; these are those of the training.
    pub fn unirig_starred() -> Self {
        Self {
            pose: PoseConfig { probability: 1.0, degrees: 60.0, scale: [1.0, 1.0] },
            scale: ScaleConfig { probability: 1.0, range: [0.33, 3.33], uniform: false },
            rotate: RotateConfig { probability: 1.0, degrees: 90.0 },
            ..Self::default()
        }
    }

    /// The presets by the names that configs extend, as `augment/NAME.toml`.
    pub fn presets() -> [(&'static str, Self); 5] {
        [
            ("skintokens_ar", Self::skintokens_ar()),
            ("skintokens_vae", Self::skintokens_vae()),
            ("unirig_ar", Self::unirig_ar()),
            ("unirig_skin", Self::unirig_skin()),
            ("unirig_starred", Self::unirig_starred()),
        ]
    }
}
