//! Pictures of rigs, drawn on the CPU.
//!
//! For reports, galleries and quick looks: no window, no graphics driver, the same bytes on every
//! machine of a kind and for any number of threads.
//!
//! The one idea: **visibility first, looks afterwards.** A z-buffer finds the triangle behind each
//! of 2 x 2 samples a pixel, then each sample is painted and lit once; so a new kind of picture is a
//! new paint. `cargo run --release -p riglab-render --example gallery` draws them all and times a
//! mesh of 20,000 triangles.
//!
//! Holds: whatever is a [`Mesh`] or [`Skeleton`](riglab_core::Skeleton) gives a picture, with
//! triangles of no area, a single point or the largest coordinates too. Axes are those of glTF, y up
//! and front +z. Surfaces are lit from both sides, as their winding may be inconsistent.
//! Leaves out: textures, shadows, perspective, text beyond ASCII.
//!
//! ```
//! # use riglab_core::{Joint, Mesh, Rig, Skeleton, SkinWeights};
//! # let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]])?;
//! # let skeleton = Skeleton::new(vec![Joint { name: "a".into(), parent: None, head: [0.1; 3] }])?;
//! # let rig = Rig::new(skeleton, mesh, SkinWeights::normalized(vec![vec![(0, 1.0)]; 3])?)?;
//! use riglab_render::{Theme, View, contact_sheet, render_parts, render_skeleton};
//!
//! let view = View::square(128).framed(rig.bounds());
//! let cells = [("skeleton", render_skeleton(&rig, &view)), ("parts", render_parts(&rig, &view))];
//! let png: Vec<u8> = contact_sheet(&cells, 2, Theme::Light).to_png();
//! # assert!(png.len() > 100);
//! # Ok::<(), riglab_core::RigError>(())
//! ```

mod color;
mod font;
mod legend;
mod picture;
mod raster;
mod scene;
mod shade;
mod sheet;
mod skeleton;
mod view;

pub use color::{Palette, Rgb, joint_color};
pub use picture::{Picture, is_own_png};
pub use scene::Scene;
pub use sheet::contact_sheet;
pub use skeleton::BoneColors;
pub use view::{Theme, View};

use riglab_core::{JointId, Mesh, Rig, SkinWeights};

/// Weights below this are shown as none.
pub const WEIGHT_SHOWN: f32 = 0.01;

/// A mesh in grey.
pub fn render_mesh(mesh: &Mesh, view: &View) -> Picture {
    Scene::of(mesh).draw(view)
}

/// A mesh painted by the weight of each vertex, from 0 to 1, with a legend; grey below [`WEIGHT_SHOWN`]
/// and where there is no number. For one joint of a rig the values are [`joint_weights`].
pub fn render_weights(mesh: &Mesh, values: &[f32], view: &View, palette: Palette) -> Picture {
    let mut picture = Scene::of(mesh).values_from(values, palette, WEIGHT_SHOWN).draw(view);
    picture.legend(palette, 0.0, 1.0, view.theme);
    picture
}

/// A mesh painted by an error of each vertex, from 0 to `limit` and what is beyond, with a legend.
pub fn render_errors(mesh: &Mesh, errors: &[f32], limit: f32, view: &View) -> Picture {
    let limit = if limit > 0.0 { limit } else { f32::MIN_POSITIVE };
    let shares: Vec<f32> = errors.iter().map(|e| e / limit).collect();
    let mut picture = Scene::of(mesh).values(&shares, Palette::Ember).draw(view);
    picture.legend(Palette::Ember, 0.0, limit, view.theme);
    picture
}

/// A rig's skeleton through its mesh, each joint in its [`joint_color`].
pub fn render_skeleton(rig: &Rig, view: &View) -> Picture {
    Scene::of(rig.mesh()).skeleton(rig.skeleton(), BoneColors::ByJoint).draw(view)
}

/// A rig's mesh painted in the colours of its joints, mixed by weight: the usual picture of a skin.
pub fn render_parts(rig: &Rig, view: &View) -> Picture {
    Scene::of(rig.mesh()).parts(rig.weights()).draw(view)
}

/// The weight of one joint on every vertex.
pub fn joint_weights(weights: &SkinWeights, joint: JointId) -> Vec<f32> {
    let of_row = |v| weights.row(v).find(|(j, _)| *j == joint).map_or(0.0, |(_, w)| w);
    (0..weights.rows()).map(of_row).collect()
}

/// The share of each vertex's weight that is on another joint than it should be, from 0 to 1: half
/// the sum of |w - w'| over joints. For pictures; measured numbers come from `riglab-metric`.
/// Vertices that only one of the two has count as wholly wrong.
pub fn misplaced_weight(a: &SkinWeights, b: &SkinWeights) -> Vec<f32> {
    let shared = |v| {
        let of_b = |joint| b.row(v).find(|(j, _)| *j == joint).map_or(0.0, |(_, w)| w);
        a.row(v).map(|(joint, w)| w.min(of_b(joint))).sum::<f32>()
    };
    let both = a.rows().min(b.rows());
    (0..a.rows().max(b.rows())).map(|v| if v < both { (1.0 - shared(v)).max(0.0) } else { 1.0 }).collect()
}
