//! What is drawn: a painted mesh, skeletons over it.

use glam::Vec3;
use rayon::prelude::*;
use riglab_core::{Mesh, Skeleton, SkinWeights};

use crate::color::{joint_lab, lab_to_linear};
use crate::raster::{Layer, REACH};
use crate::shade::{Paint, Solid, light};
use crate::skeleton::{self, BoneColors};
use crate::view::Projector;
use crate::{Palette, Picture, Rgb, Theme, View};

/// Samples along each side of a pixel.
const SAMPLES: usize = 2;

/// A mesh, its paint, and skeletons to be seen through it. Where there are skeletons the mesh is
/// drawn as glass.
///
/// ```
/// use riglab_core::{Joint, JointId, Mesh, Skeleton};
/// use riglab_render::{BoneColors, Palette, Rgb, Scene, View};
///
/// let mesh = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]])?;
/// let joint = |name: &str, parent, head| Joint { name: name.into(), parent, head };
/// let truth = Skeleton::new(vec![joint("a", None, [0.1; 3]), joint("b", Some(JointId(0)), [0.5; 3])])?;
/// let picture = Scene::of(&mesh)
///     .values(&[0.0, 0.5, 1.0], Palette::Dusk)
///     .skeleton(&truth, BoneColors::Plain(Rgb([220, 60, 40])))
///     .draw(&View::square(64));
/// assert_eq!(&picture.to_png()[1..4], b"PNG");
/// # Ok::<(), riglab_core::RigError>(())
/// ```
#[derive(Clone)]
pub struct Scene<'a> {
    mesh: Option<&'a Mesh>,
    coat: Coat<'a>,
    skeletons: Vec<(&'a Skeleton, BoneColors)>,
}

/// How the mesh is painted, before its paint is made ready for one view.
#[derive(Clone)]
enum Coat<'a> {
    Plain,
    Values { values: &'a [f32], palette: Palette, from: f32 },
    Parts(&'a SkinWeights),
}

impl<'a> Scene<'a> {
    /// A mesh in grey.
    pub fn of(mesh: &'a Mesh) -> Self {
        Self { mesh: Some(mesh), coat: Coat::Plain, skeletons: Vec::new() }
    }

    /// No mesh: for skeletons alone.
    pub fn empty() -> Self {
        Self { mesh: None, coat: Coat::Plain, skeletons: Vec::new() }
    }

    /// Paints the mesh by a value for each vertex, from 0 to 1. Vertices without one (a shorter
    /// slice, or NaN) stay grey.
    #[must_use]
    pub fn values(self, values: &'a [f32], palette: Palette) -> Self {
        Self { coat: Coat::Values { values, palette, from: f32::NEG_INFINITY }, ..self }
    }

    /// [`Scene::values`], grey where the value is below `from`.
    #[must_use]
    pub fn values_from(self, values: &'a [f32], palette: Palette, from: f32) -> Self {
        Self { coat: Coat::Values { values, palette, from }, ..self }
    }

    /// Paints each vertex in the colours of its joints, mixed by its weights.
    #[must_use]
    pub fn parts(self, weights: &'a SkinWeights) -> Self {
        Self { coat: Coat::Parts(weights), ..self }
    }

    /// Adds a skeleton.
    #[must_use]
    pub fn skeleton(mut self, skeleton: &'a Skeleton, colors: BoneColors) -> Self {
        self.skeletons.push((skeleton, colors));
        self
    }

    /// Draws the picture.
    pub fn draw(&self, view: &View) -> Picture {
        let (width, height) = view.pixels();
        let samples = (SAMPLES * width, SAMPLES * height);
        let vertices = self.mesh.iter().flat_map(|mesh| mesh.positions());
        let points = vertices.chain(self.skeletons.iter().flat_map(|(s, _)| s.heads()));
        let projector = Projector::fit(view, samples, points.copied());
        let seen = |solid: Solid| Seen { layer: solid.render(samples.0, samples.1), solid };
        let surface = self.mesh.map(|mesh| {
            let positions = mesh.positions().iter().map(|&p| projector.project(p)).collect();
            seen(Solid::smooth(positions, mesh.triangles().to_vec(), self.paint(mesh, view.theme)))
        });
        let bones = (!self.skeletons.is_empty())
            .then(|| seen(skeleton::solid(&self.skeletons, &projector, samples.0.min(samples.1))));
        let samples = Samples {
            ghost: bones.is_some(),
            surface,
            bones,
            background: view.theme.background().linear(),
            ink: Rgb([24, 25, 30]).linear(),
            step: (samples.0 + samples.1) as f32 * STEP,
        };
        let mut pixels = vec![[0; 3]; width * height];
        pixels.par_chunks_mut(width).enumerate().for_each(|(row, pixels)| {
            samples.row(row, pixels);
        });
        Picture::from_pixels(width, height, pixels)
    }

    fn paint(&self, mesh: &Mesh, theme: Theme) -> Paint {
        let plain = clay(theme);
        let count = mesh.positions().len();
        match self.coat {
            Coat::Plain => Paint::Plain(plain),
            Coat::Values { values, palette, from } => {
                let values = (0..count).map(|v| values.get(v).copied().unwrap_or(f32::NAN)).collect();
                Paint::Values { values, from, table: palette.table(), plain }
            }
            Coat::Parts(weights) => {
                let color = |v| {
                    // Mixed in OKLab: an even share of two joints looks even.
                    let mixed: Vec3 = weights.row(v).map(|(joint, w)| w * joint_lab(joint.index())).sum();
                    lab_to_linear(mixed)
                };
                Paint::Colors((0..count).map(|v| if v < weights.rows() { color(v) } else { plain }).collect())
            }
        }
    }
}

/// Paint of what has no colour of its own.
fn clay(theme: Theme) -> Vec3 {
    let rgb = match theme {
        Theme::Light => Rgb([206, 208, 212]),
        Theme::Dark => Rgb([150, 154, 162]),
    };
    rgb.linear()
}

/// How far one surface must be behind another for a line between them, as a share of the picture.
const STEP: f32 = 0.012;

/// A solid and where it is seen.
struct Seen {
    solid: Solid,
    layer: Layer,
}

/// All that the colour of a sample depends on.
struct Samples {
    surface: Option<Seen>,
    bones: Option<Seen>,
    /// Whether the surface is drawn as glass.
    ghost: bool,
    background: Vec3,
    ink: Vec3,
    step: f32,
}

impl Samples {
    /// Fills a row of pixels.
    fn row(&self, row: usize, pixels: &mut [[u8; 3]]) {
        let near = |seen: &Option<Seen>| {
            let rows = row * SAMPLES..(row + 1) * SAMPLES;
            let columns = seen.as_ref().map_or(0..0, |seen| seen.layer.columns_near(rows));
            columns.start.max(0) as usize / SAMPLES..(columns.end.max(0) as usize).div_ceil(SAMPLES)
        };
        let (surface, bones) = (near(&self.surface), near(&self.bones));
        let background = Rgb::from_linear(self.background).0;
        for (column, pixel) in pixels.iter_mut().enumerate() {
            let with_bones = bones.contains(&column);
            *pixel = if with_bones || surface.contains(&column) {
                self.pixel(column, row, with_bones).0
            } else {
                background
            };
        }
    }

    fn pixel(&self, column: usize, row: usize, with_bones: bool) -> Rgb {
        let mut sum = Vec3::ZERO;
        for k in 0..SAMPLES * SAMPLES {
            let (x, y) = (column * SAMPLES + k % SAMPLES, row * SAMPLES + k / SAMPLES);
            sum += self.color(x as isize, y as isize, with_bones);
        }
        Rgb::from_linear(sum / (SAMPLES * SAMPLES) as f32)
    }

    fn color(&self, x: isize, y: isize, with_bones: bool) -> Vec3 {
        let behind = self.surface.as_ref().map_or(self.background, |surface| self.surface_color(surface, x, y));
        let Some(Seen { solid, layer }) = self.bones.as_ref().filter(|_| with_bones) else { return behind };
        let hit = layer.at(x, y);
        // A pixel of ink sets bones off from the mesh, around them, and from bones further back, on
        // them: the smallest joints keep their colour.
        let ink = match hit.is_some() {
            true => layer.stands_out(x, y, REACH, 0.3 * self.step),
            false => layer.touches_something(x, y, REACH),
        };
        match (ink, hit.is_some()) {
            (true, _) => self.ink,
            (false, true) => solid.color(hit) * (0.25 + 0.85 * light(solid.normal(hit))),
            (false, false) => behind,
        }
    }

    fn surface_color(&self, surface: &Seen, x: isize, y: isize) -> Vec3 {
        let hit = surface.layer.at(x, y);
        if !hit.is_some() {
            return self.background;
        }
        let normal = surface.solid.normal(hit);
        let lit = surface.solid.color(hit) * light(normal);
        let edge = surface.layer.touches_nothing(x, y, 1) || surface.layer.stands_out(x, y, 1, self.step);
        if self.ghost {
            // Glass is seen where the eye grazes it.
            let alpha = 0.30 + 0.45 * (1.0 - normal.z).powi(2);
            return self.background.lerp(lit, if edge { 0.85 } else { alpha });
        }
        if edge { lit.lerp(self.ink, 0.55) } else { lit }
    }
}
