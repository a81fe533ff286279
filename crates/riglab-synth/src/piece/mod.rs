//! Pieces apart from the skin: eyes, sheets such as fins and cloth, and lofts such as horns and boxes.
//!
//! A sheet thinner than a cell would cost more triangles than the rest of the body, so it is laid
//! out as a grid instead, as an artist would: open with one layer, or closed with two that meet at
//! the rim. The same holds for thin hair and for edges that must stay sharp.

mod ball;
mod loft;
mod sheet;

use glam::Vec3;

pub(crate) use ball::Ball;
pub(crate) use loft::Loft;
pub(crate) use sheet::Sheet;

/// How finely pieces may be divided at most. Where few triangles are wished for, an eye or a horn must not take them all;
/// where many are, whoever is made of pieces alone has no other place for them.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    /// Of balls, from pole to pole.
    rings: u32,
    /// Of lofts, around a quarter.
    quarters: u32,
    /// Of lofts, from section to section.
    steps: u32,
    /// Of sheets, from one control point to the next.
    patch: usize,
}

impl Limits {
    /// For a creature of about so many triangles.
    pub fn of(triangles: u32) -> Self {
        let times = (triangles as f32 / ENOUGH).sqrt().max(1.0);
        let most = |usual: f32| (usual * times) as u32;
        Self { rings: most(24.0), quarters: most(12.0), steps: most(48.0), patch: most(64.0) as usize }
    }
}

/// Up to so many triangles the least limits are enough for all creatures.
const ENOUGH: f32 = 14_000.0;

/// A component of the mesh that is not part of the skin.
#[derive(Clone, Debug)]
pub(crate) enum Piece {
    Ball(Ball),
    Sheet(Sheet),
    Loft(Loft),
}

/// A control point of a sheet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Control {
    pub at: Vec3,
    /// The joint that holds the sheet here.
    pub joint: u16,
}

/// The triangles of a piece, with up to four weights a vertex.
#[derive(Clone, Debug, Default)]
pub(crate) struct PieceMesh {
    pub positions: Vec<Vec3>,
    pub triangles: Vec<[u32; 3]>,
    pub weights: Vec<Vec<(u16, f32)>>,
}

impl Piece {
    /// Triangles with edges of about `edge` metres, within limits.
    pub fn mesh(&self, edge: f32, limits: Limits) -> PieceMesh {
        match self {
            Self::Ball(ball) => ball.mesh(edge, limits),
            Self::Sheet(sheet) => sheet.mesh(edge, limits),
            Self::Loft(loft) => loft.mesh(edge, limits),
        }
    }

    /// Scales the piece about the origin.
    pub fn scale_by(&mut self, by: f32) {
        match self {
            Self::Ball(ball) => (ball.center, ball.radii) = (ball.center * by, ball.radii * by),
            Self::Sheet(sheet) => {
                sheet.thickness *= by;
                sheet.ribs.iter_mut().flatten().for_each(|control| control.at *= by);
            }
            Self::Loft(loft) => loft.scale_by(by),
        }
    }

    /// Turns what joints with `moves` hold about a line through `center`.
    pub fn turn(&mut self, moves: &dyn Fn(u16) -> bool, center: Vec3, axis: Vec3, degrees: f32) {
        match self {
            Self::Ball(ball) => ball.turn(moves, center, axis, degrees),
            Self::Sheet(sheet) => sheet.turn(moves, center, axis, degrees),
            Self::Loft(loft) => loft.turn(moves, center, axis, degrees),
        }
    }

    /// Roughly its area in square metres, both layers of a closed sheet counted.
    pub fn area(&self) -> f32 {
        match self {
            Self::Ball(ball) => 4.0 * std::f32::consts::PI * ball.radii.length_squared() / 3.0,
            Self::Sheet(sheet) => {
                let (u, v) = sheet.extent();
                u * v * if sheet.thickness > 0.0 { 2.0 } else { 1.0 }
            }
            Self::Loft(loft) => loft.area(),
        }
    }

    /// The size a cell of the skin would have beside it, in metres.
    pub fn scale(&self) -> f32 {
        match self {
            Self::Ball(ball) => ball.mean(),
            Self::Sheet(sheet) => {
                let (u, v) = sheet.extent();
                0.25 * u.min(v)
            }
            Self::Loft(loft) => loft.thickness(),
        }
    }
}

/// Joints with shares, each joint once.
fn blended(shares: impl IntoIterator<Item = (u16, f32)>) -> Vec<(u16, f32)> {
    let mut row: Vec<(u16, f32)> = Vec::with_capacity(4);
    for (joint, share) in shares {
        match row.iter_mut().find(|(known, _)| *known == joint) {
            Some((_, w)) => *w += share,
            None if share > 0.0 => row.push((joint, share)),
            None => {}
        }
    }
    row
}

fn smooth(t: f32) -> f32 {
    t * t * (3.0 - 2.0 * t)
}

/// Catmull-Rom between the middle two of four points.
fn spline(t: f32, [a, b, c, d]: [Vec3; 4]) -> Vec3 {
    let (t2, t3) = (t * t, t * t * t);
    0.5 * (2.0 * b + (c - a) * t + (2.0 * a - 5.0 * b + 4.0 * c - d) * t2 + (3.0 * b - a - 3.0 * c + d) * t3)
}
