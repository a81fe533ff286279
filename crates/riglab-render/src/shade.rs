//! What a surface looks like where it is seen.

use glam::Vec3;

use crate::raster::{Hit, Layer, Triangles};

/// Triangles in samples with normals and colours.
#[derive(Default)]
pub(crate) struct Solid {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    /// Unit, at the vertices: x right, y down, z towards the viewer; pointing either way.
    pub normals: Vec<Vec3>,
    pub paint: Paint,
}

/// Colours of a surface, linear.
pub(crate) enum Paint {
    /// One for all.
    Plain(Vec3),
    /// By vertex.
    Colors(Vec<Vec3>),
    /// By vertex, as a place in a table of colours; NaN and below `from` have the plain colour.
    Values { values: Vec<f32>, from: f32, table: Vec<Vec3>, plain: Vec3 },
}

impl Default for Paint {
    fn default() -> Self {
        Self::Colors(Vec::new())
    }
}

impl Solid {
    /// The triangles with smooth normals of their own: the area-weighted mean around each vertex.
    pub fn smooth(positions: Vec<Vec3>, triangles: Vec<[u32; 3]>, paint: Paint) -> Self {
        let mut normals = vec![Vec3::ZERO; positions.len()];
        for corners in &triangles {
            let [a, b, c] = corners.map(|v| positions[v as usize]);
            let area = (b - a).cross(c - a);
            if area.is_finite() {
                corners.iter().for_each(|&v| normals[v as usize] += area);
            }
        }
        let normals = normals.into_iter().map(|n| n.normalize_or(Vec3::Z)).collect();
        Self { positions, triangles, normals, paint }
    }

    pub fn render(&self, width: usize, height: usize) -> Layer {
        Layer::render(width, height, &Triangles { positions: &self.positions, triangles: &self.triangles })
    }

    /// The unit normal at a hit, towards the viewer.
    ///
    /// Surfaces may be wound either way and inconsistently: each corner's normal is taken on the side
    /// of the triangle's face that is seen.
    pub fn normal(&self, hit: &Hit) -> Vec3 {
        let corners = self.triangles[hit.triangle as usize];
        let [a, b, c] = corners.map(|v| self.positions[v as usize]);
        let face = (b - a).cross(c - a);
        let face = if face.z < 0.0 { -face } else { face };
        let normals = corners.map(|v| self.normals[v as usize]);
        let normal = mix(normals.map(|n| if n.dot(face) < 0.0 { -n } else { n }), hit);
        let normal = normal.normalize_or(Vec3::Z);
        // Interpolation may turn a normal away just where its triangle is still seen.
        if normal.z < 0.0 { normal.with_z(0.0).normalize_or(Vec3::Z) } else { normal }
    }

    /// The colour at a hit, unlit.
    pub fn color(&self, hit: &Hit) -> Vec3 {
        let corners = self.triangles[hit.triangle as usize];
        match &self.paint {
            Paint::Plain(color) => *color,
            Paint::Colors(colors) => mix(corners.map(|v| colors[v as usize]), hit),
            Paint::Values { values, from, table, plain } => {
                // Values are mixed, not colours: a ramp stays on its palette and the limit stays sharp.
                let value = mix(corners.map(|v| Vec3::splat(values[v as usize])), hit).x;
                if value < *from || value.is_nan() {
                    return *plain;
                }
                let at = value.clamp(0.0, 1.0) * (table.len() - 1) as f32;
                table[(at + 0.5) as usize]
            }
        }
    }
}

fn mix([a, b, c]: [Vec3; 3], hit: &Hit) -> Vec3 {
    let [share_b, share_c] = hit.shares;
    a * (1.0 - share_b - share_c) + b * share_b + c * share_c
}

/// How bright a surface is: a key light from the upper left, a weak one from the right, and the sky.
/// Kept between about 0.45 and 1.1, and near 1 where the eye looks straight on, so that colours that
/// mean something read as in their legend.
pub(crate) fn light(normal: Vec3) -> f32 {
    const KEY: Vec3 = Vec3::new(-0.45, -0.60, 0.66);
    const FILL: Vec3 = Vec3::new(0.84, -0.10, 0.53);
    let sky = 0.5 - 0.5 * normal.y;
    0.45 + 0.52 * normal.dot(KEY).max(0.0) + 0.14 * normal.dot(FILL).max(0.0) + 0.10 * sky
}
