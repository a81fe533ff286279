//! From where a rig is seen.

use glam::DVec3;
use riglab_core::{Bounds, Vec3};

use crate::Rgb;

/// An orthographic view that fits its subject into the picture. Axes as in glTF: y up, front +z.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Width in pixels, 1 to 4096.
    pub width: u32,
    /// Height in pixels, 1 to 4096.
    pub height: u32,
    /// How far the viewer walks around the subject, from the front (+z) towards +x, in degrees.
    pub yaw_deg: f32,
    /// How far the viewer rises above the subject, in degrees.
    pub pitch_deg: f32,
    /// Colours of what is not the subject.
    pub theme: Theme,
    /// The box that fills the picture; `None` for what is drawn. Pictures to be compared share one.
    pub frame: Option<Bounds>,
}

/// Colours of what is not the subject.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Theme {
    /// On white, as paper and reports are.
    #[default]
    Light,
    /// On near-black.
    Dark,
}

impl Default for View {
    /// Three quarters from the front, a little from above, 512 by 512, on white.
    fn default() -> Self {
        Self { width: 512, height: 512, yaw_deg: 32.0, pitch_deg: 14.0, theme: Theme::Light, frame: None }
    }
}

impl View {
    /// The default view as a square of `size` pixels.
    pub fn square(size: u32) -> Self {
        Self { width: size, height: size, ..Self::default() }
    }

    /// The same from another side.
    #[must_use]
    pub fn turned(self, yaw_deg: f32, pitch_deg: f32) -> Self {
        Self { yaw_deg, pitch_deg, ..self }
    }

    /// The same with a box that fills the picture.
    #[must_use]
    pub fn framed(self, frame: Bounds) -> Self {
        Self { frame: Some(frame), ..self }
    }

    /// The same with other colours around.
    #[must_use]
    pub fn themed(self, theme: Theme) -> Self {
        Self { theme, ..self }
    }

    pub(crate) fn pixels(&self) -> (usize, usize) {
        (self.width.clamp(1, 4096) as usize, self.height.clamp(1, 4096) as usize)
    }
}

impl Theme {
    /// What is behind everything.
    pub fn background(self) -> Rgb {
        match self {
            Self::Light => Rgb([255, 255, 255]),
            Self::Dark => Rgb([24, 26, 31]),
        }
    }

    /// Text and outlines.
    pub fn ink(self) -> Rgb {
        match self {
            Self::Light => Rgb([40, 42, 48]),
            Self::Dark => Rgb([222, 224, 228]),
        }
    }
}

/// Space around the subject, as a share of the picture.
const MARGIN: f64 = 0.06;

/// The map from a rig's space to pixels.
///
/// In f64: finite f32 coordinates of any size stay finite through sums and products here.
pub(crate) struct Projector {
    right: DVec3,
    up: DVec3,
    /// Towards the viewer.
    toward: DVec3,
    center: DVec3,
    scale: f64,
    middle: (f64, f64),
}

impl Projector {
    /// Fits `points` (or the view's frame) into a picture of `width` by `height` samples.
    pub fn fit(view: &View, (width, height): (usize, usize), points: impl Iterator<Item = Vec3>) -> Self {
        let finite = |degrees: f32| if degrees.is_finite() { f64::from(degrees).to_radians() } else { 0.0 };
        let (sin_yaw, cos_yaw) = finite(view.yaw_deg).sin_cos();
        let (sin_pitch, cos_pitch) = finite(view.pitch_deg).sin_cos();
        let right = DVec3::new(cos_yaw, 0.0, -sin_yaw);
        let toward = DVec3::new(sin_yaw * cos_pitch, sin_pitch, cos_yaw * cos_pitch);
        let mut this = Self {
            right,
            up: toward.cross(right),
            toward,
            center: DVec3::ZERO,
            scale: 1.0,
            middle: (width as f64 / 2.0, height as f64 / 2.0),
        };
        let (min, max) = match view.frame {
            Some(frame) => this.extent(corners(frame).into_iter()),
            None => this.extent(points),
        };
        if min.x <= max.x {
            this.center = 0.5 * (min + max);
            let room = 1.0 - 2.0 * MARGIN;
            let size = max - min;
            let fit = (size.x / (width as f64 * room)).max(size.y / (height as f64 * room));
            // Seen end on, a line is framed by its depth; a point by nothing.
            let fit = if fit > 0.0 { fit } else { size.z / (width as f64 * room) };
            this.scale = if fit > 0.0 { (1.0 / fit).min(1e60) } else { 1.0 };
        }
        this
    }

    /// The box around points in view axes, from +inf to -inf without any finite point.
    fn extent(&self, points: impl Iterator<Item = Vec3>) -> (DVec3, DVec3) {
        let empty = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        points.map(|p| self.turn(p)).filter(|p| p.is_finite()).fold(empty, |(min, max), p| (min.min(p), max.max(p)))
    }

    fn turn(&self, p: Vec3) -> DVec3 {
        let p = DVec3::from(p.map(f64::from));
        DVec3::new(self.right.dot(p), self.up.dot(p), self.toward.dot(p))
    }

    /// Samples to the right, samples down, samples towards the viewer.
    pub fn project(&self, p: Vec3) -> glam::Vec3 {
        let p = self.scale * (self.turn(p) - self.center);
        glam::Vec3::new((self.middle.0 + p.x) as f32, (self.middle.1 - p.y) as f32, p.z as f32)
    }
}

fn corners(bounds: Bounds) -> [Vec3; 8] {
    std::array::from_fn(|i| std::array::from_fn(|k| if i >> k & 1 == 0 { bounds.min[k] } else { bounds.max[k] }))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn project(view: &View, points: &[Vec3], p: Vec3) -> glam::Vec3 {
        Projector::fit(view, (100, 100), points.iter().copied()).project(p)
    }

    #[test]
    fn the_front_shows_x_to_the_right_and_y_up() {
        let view = View::default().turned(0.0, 0.0);
        let p = |q| project(&view, &[[-1.0; 3], [1.0; 3]], q);
        assert!((p([0.0; 3]) - glam::Vec3::new(50.0, 50.0, 0.0)).length() < 1e-4);
        assert!((p([1.0, 1.0, 1.0]) - glam::Vec3::new(94.0, 6.0, 44.0)).length() < 1e-4);
    }

    #[test]
    fn yaw_walks_towards_x_and_pitch_rises() {
        let view = View::default().turned(90.0, 0.0);
        let points = [[-1.0; 3], [1.0; 3]];
        assert!(project(&view, &points, [1.0, 0.0, 0.0]).z > 43.0); // nearest
        assert!(project(&view, &points, [0.0, 0.0, 1.0]).x < 7.0); // the front is to the left
        let above = View::default().turned(0.0, 90.0);
        assert!(project(&above, &points, [0.0, 1.0, 0.0]).z > 43.0);
    }

    #[test]
    fn extremes_stay_finite() {
        let view = View { yaw_deg: f32::NAN, ..View::default() };
        for points in [vec![[f32::MAX; 3], [f32::MIN; 3]], vec![[1e-44; 3], [0.0; 3]], vec![[3.0; 3]], vec![]] {
            for p in points.iter().chain(&[[0.0; 3]]) {
                assert!(!project(&view, &points, *p).is_nan());
            }
        }
    }
}
