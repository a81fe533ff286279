//! One part of a body: a tapered limb with an elliptical cross-section, or an ellipsoid.

use glam::Vec3;

use crate::turn::{across, turned};

/// Half extents of a cross-section, in metres: along the part's side and its up direction.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ring {
    pub side: f32,
    pub up: f32,
}

impl Ring {
    pub fn round(radius: f32) -> Self {
        Self { side: radius, up: radius }
    }

    pub fn oval(side: f32, up: f32) -> Self {
        Self { side, up }
    }

    pub fn scaled(self, by: f32) -> Self {
        Self { side: self.side * by, up: self.up * by }
    }

    pub fn min(self) -> f32 {
        self.side.min(self.up)
    }

    pub fn mean(self) -> f32 {
        0.5 * (self.side + self.up)
    }
}

/// How a half extent runs along the part: a cubic through both ends with given slopes, plus a belly
/// that leaves ends and slopes as they are.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Profile([f32; 5]);

impl Profile {
    /// From `r0` to `r1` with slopes `m0`, `m1` per unit of t; slopes are limited so that the
    /// profile stays between its ends. `belly` is added in the middle.
    pub fn new(r0: f32, r1: f32, m0: f32, m1: f32, belly: f32) -> Self {
        let rise = r1 - r0;
        // A slope of the same sign and at most three times the rise keeps a cubic monotone.
        let limit = |m: f32| if m * rise <= 0.0 { 0.0 } else { m.clamp(-3.0 * rise.abs(), 3.0 * rise.abs()) };
        let (m0, m1) = (limit(m0), limit(m1));
        let b = 16.0 * belly;
        Self([r0, m0, 3.0 * rise - 2.0 * m0 - m1 + b, m0 + m1 - 2.0 * rise - 2.0 * b, b])
    }

    fn at(&self, t: f32) -> f32 {
        let c = &self.0;
        c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * c[4])))
    }

    fn slope(&self, t: f32) -> f32 {
        let c = &self.0;
        c[1] + t * (2.0 * c[2] + t * (3.0 * c[3] + t * 4.0 * c[4]))
    }
}

/// A part of the body, held by one joint.
#[derive(Clone, Debug)]
pub(crate) struct Part {
    /// The joint it moves with.
    pub joint: u16,
    /// Start of the axis.
    pub a: Vec3,
    /// End of the axis.
    pub b: Vec3,
    /// Width of the fillet where it meets a part it grows from, in metres.
    pub blend: f32,
    axis: Vec3,
    length: f32,
    side: Vec3,
    up: Vec3,
    width: Profile,
    height: Profile,
    /// How far the rounded ends reach beyond `a` and `b`.
    caps: [f32; 2],
    thinnest: f32,
    /// The smaller half extent midway.
    slim: f32,
    mean: f32,
    reach: f32,
}

/// What a part says about a point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Distance {
    /// Distance to the part's surface in metres, to first order; negative inside.
    pub d: f32,
    /// Unit direction in which it grows.
    pub gradient: Vec3,
}

impl Part {
    /// A limb from `a` to `b` whose cross-section goes from one ring to the other. `hint` is the
    /// direction nearest to which the rings' side lies.
    pub fn limb(joint: u16, a: Vec3, b: Vec3, hint: Vec3, width: Profile, height: Profile) -> Self {
        let length = (b - a).length();
        let axis = if length > 0.0 { (b - a) / length } else { Vec3::Y };
        let side = across(axis, hint);
        let ends = [0.0, 1.0].map(|t| Ring::oval(width.at(t), height.at(t)));
        let middle = Ring::oval(width.at(0.5), height.at(0.5));
        let mean = (ends[0].mean() + ends[1].mean() + middle.mean()) / 3.0;
        let mut part = Self {
            joint,
            a,
            b,
            blend: 0.0,
            axis,
            length,
            side,
            up: axis.cross(side),
            width,
            height,
            caps: ends.map(Ring::min),
            thinnest: ends[0].min().min(ends[1].min()),
            slim: middle.min(),
            mean,
            reach: 0.0,
        };
        part.blend = 0.9 * part.thinnest.max(0.6 * part.mean.min(middle.min()));
        part.measure();
        part
    }

    /// An ellipsoid with half extents `radii` along the side nearest to `hint`, up, and the axis.
    pub fn ellipsoid(joint: u16, center: Vec3, axis: Vec3, hint: Vec3, radii: Vec3) -> Self {
        let flat = |r| Profile::new(r, r, 0.0, 0.0, 0.0);
        let mut part = Self::limb(joint, center, center + axis, hint, flat(radii.x), flat(radii.y));
        (part.b, part.length, part.caps) = (center, 0.0, [radii.z; 2]);
        part.thinnest = radii.min_element();
        part.mean = (radii.x + radii.y + radii.z) / 3.0;
        part.blend = 0.9 * part.thinnest;
        part.measure();
        part
    }

    fn measure(&mut self) {
        // Bellies may exceed both ends; sampled, with a margin for what lies between samples.
        let widest = (0..=8).map(|k| k as f32 / 8.0).map(|t| self.width.at(t).max(self.height.at(t)));
        self.reach = 1.02 * widest.fold(self.caps[0].max(self.caps[1]), f32::max);
    }

    /// Scales the part about the origin.
    pub fn scale(&mut self, by: f32) {
        (self.a, self.b) = (self.a * by, self.b * by);
        for profile in [&mut self.width, &mut self.height] {
            profile.0.iter_mut().for_each(|c| *c *= by);
        }
        self.caps.iter_mut().for_each(|c| *c *= by);
        for length in
            [&mut self.blend, &mut self.length, &mut self.thinnest, &mut self.slim, &mut self.mean, &mut self.reach]
        {
            *length *= by;
        }
    }

    /// Turns the part about a line through `center`.
    pub fn turn(&mut self, center: Vec3, axis: Vec3, degrees: f32) {
        for p in [&mut self.a, &mut self.b] {
            *p = center + turned(*p - center, axis, degrees);
        }
        for v in [&mut self.axis, &mut self.side, &mut self.up] {
            *v = turned(*v, axis, degrees);
        }
    }

    /// The cross-section at the part's start and end.
    pub fn rings(&self) -> [Ring; 2] {
        [0.0, 1.0].map(|t| Ring::oval(self.width.at(t), self.height.at(t)))
    }

    /// The directions of side and axis.
    pub fn frame(&self) -> (Vec3, Vec3) {
        (self.side, self.axis)
    }

    /// How far the rounded ends reach beyond `a` and `b`.
    pub fn caps(&self) -> [f32; 2] {
        self.caps
    }

    /// Size in metres of the largest cells that mostly show the part unbroken. A lattice has a point
    /// inside every circle of radius r if its step is at most r times the root of two; a limb's end
    /// may be somewhat thinner, and then its tip can come off. An ellipsoid is a bump on something else, and
    /// may get lost.
    pub fn visible_at(&self) -> f32 {
        if self.length > 0.0 { 1.3 * self.slim.min(1.5 * self.thinnest) } else { 3.0 * self.mean }
    }

    /// Typical half extent, in metres.
    pub fn mean(&self) -> f32 {
        self.mean
    }

    /// Roughly the area of its surface, in square metres.
    pub fn area(&self) -> f32 {
        2.0 * std::f32::consts::PI * self.mean * (self.length + 0.6 * (self.caps[0] + self.caps[1]))
    }

    /// No point of the part is further than this from its axis.
    pub fn reach(&self) -> f32 {
        self.reach
    }

    /// Distance from a point to the axis, a segment.
    pub fn axis_distance(&self, p: Vec3) -> f32 {
        let q = p - self.a;
        let s = q.dot(self.axis).clamp(0.0, self.length);
        (q - self.axis * s).length()
    }

    /// A box around the part.
    pub fn bounds(&self) -> (Vec3, Vec3) {
        (self.a.min(self.b) - self.reach, self.a.max(self.b) + self.reach)
    }

    /// The distance of a point from the surface: the ellipse equation of its cross-section divided
    /// by its gradient, exact on the surface and on the axes of an ellipsoid, and near the truth
    /// elsewhere.
    pub fn distance(&self, p: Vec3) -> Distance {
        let q = p - self.a;
        let s = q.dot(self.axis);
        let along = s.clamp(0.0, self.length);
        let t = if self.length > 0.0 { along / self.length } else { 0.0 };
        let over = s - along;
        let (u, v) = (q.dot(self.side), q.dot(self.up));
        let (w, h) = (self.width.at(t), self.height.at(t));
        let cap = if over < 0.0 { self.caps[0] } else { self.caps[1] };
        let (x, y, z) = (u / w, v / h, over / cap);
        let k0 = (x * x + y * y + z * z).sqrt();
        if k0 < 1e-4 {
            return Distance { d: -w.min(h), gradient: self.up };
        }
        let mut slant = z / cap;
        if over == 0.0 && self.length > 0.0 {
            slant = -(x * x * self.width.slope(t) / w + y * y * self.height.slope(t) / h) / self.length;
        }
        let n = self.side * (x / w) + self.up * (y / h) + self.axis * slant;
        let k1 = n.length();
        Distance { d: k0 * (k0 - 1.0) / k1, gradient: n / k1 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn flat(r: f32) -> Profile {
        Profile::new(r, r, 0.0, 0.0, 0.0)
    }

    #[test]
    fn a_capsule_measures_true_distance() {
        let part = Part::limb(0, Vec3::ZERO, Vec3::Y, Vec3::X, flat(0.2), flat(0.2));
        for (p, d) in
            [(Vec3::new(0.5, 0.5, 0.0), 0.3), (Vec3::new(0.0, 1.5, 0.0), 0.3), (Vec3::new(0.0, 0.5, 0.1), -0.1)]
        {
            assert!((part.distance(p).d - d).abs() < 1e-5);
        }
    }

    #[test]
    fn the_gradient_is_that_of_the_distance_on_the_surface() {
        let taper = Profile::new(0.1, 0.3, 0.2, 0.1, 0.05);
        let part = Part::limb(0, Vec3::ZERO, Vec3::new(0.2, 0.9, 0.1), Vec3::X, taper, flat(0.15));
        let mut p = Vec3::new(0.4, 0.4, 0.3);
        for _ in 0..20 {
            let here = part.distance(p);
            p -= here.gradient * here.d;
        }
        let here = part.distance(p);
        assert!(here.d.abs() < 1e-4);
        for axis in [Vec3::X, Vec3::Y, Vec3::Z] {
            let step = 1e-3;
            let slope = (part.distance(p + axis * step).d - part.distance(p - axis * step).d) / (2.0 * step);
            assert!((slope - here.gradient.dot(axis)).abs() < 0.02, "{slope} {:?}", here.gradient);
        }
    }

    #[test]
    fn a_profile_keeps_between_its_ends() {
        let p = Profile::new(0.1, 0.3, 9.0, -1.0, 0.0);
        for k in 0..=20 {
            let r = p.at(k as f32 / 20.0);
            assert!((0.1..=0.3001).contains(&r));
        }
        assert!((Profile::new(0.2, 0.2, 0.0, 0.0, 0.1).at(0.5) - 0.3).abs() < 1e-6);
    }
}
