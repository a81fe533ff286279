//! Where a shape is its own image in the mirror, left for right, as it stands or turned about the vertical.

use glam::{DVec3, Vec3A};
use rayon::prelude::*;
use riglab_core::Vec3;

/// Degrees between turns that are tried first.
const STEP: i32 = 5;
/// Turns next to the best of them, in degrees.
const BESIDE: i32 = 2;
/// So many times less like its image a shape has to be as it stands, or it stands well enough.
const WORSE: f64 = 1.25;
/// What is like its image is no farther from it than so many times as its points are from each other.
const ALIKE: f64 = 2.0;
/// As [`ALIKE`], of what is its own image as it stands: nothing but the sampling of points may make a difference, which is 1.
const SAME: f64 = 1.3;
/// A smaller turn, in degrees, is none.
const LEAST: i32 = 10;

/// A turn about y.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Yaw {
    degrees: i32,
}

impl Yaw {
    /// All stays as it is.
    pub const NONE: Self = Self { degrees: 0 };

    /// So many degrees, by which z turns to x.
    pub fn degrees(degrees: i32) -> Self {
        Self { degrees: (degrees + 180).rem_euclid(360) - 180 }
    }

    /// Degrees, from -180 on and below 180.
    pub fn in_degrees(self) -> i32 {
        self.degrees
    }

    /// The image of a point. Quarter turns round nothing.
    pub fn apply(self, [x, y, z]: Vec3) -> Vec3 {
        match self.degrees {
            0 => [x, y, z],
            90 => [z, y, -x],
            -90 => [-z, y, x],
            -180 => [-x, y, -z],
            degrees => {
                let (sin, cos) = libm::sincos(f64::from(degrees).to_radians());
                let (x, z) = (f64::from(x), f64::from(z));
                [(cos * x + sin * z) as f32, y, (cos * z - sin * x) as f32]
            }
        }
    }

    /// The turn back.
    pub fn inverse(self) -> Self {
        Self::degrees(-self.degrees)
    }

    /// This turn and half a turn more.
    pub fn about(self) -> Self {
        Self::degrees(self.degrees + 180)
    }
}

/// The turn of at most 90 degrees (from -90 on and below 90) by which points come to lie alike on both sides of a plane of constant x; none where they
/// do nearly as well as they stand, and where no turn does.
///
/// A shape's likeness to its mirror image is the mean distance of a mirrored point from the nearest that is not, over planes
/// through the middle of the points' extent and through their mean. Time grows with the square of the number of points: some
/// hundred, drawn from the surface, tell enough.
pub fn symmetric_yaw(points: &[Vec3]) -> Option<Yaw> {
    let points = sound(points)?;
    let best = |turns: Vec<i32>| {
        let apart: Vec<f64> = turns.par_iter().map(|&turn| unlike(&points, turn).0).collect();
        turns.into_iter().zip(apart).min_by(|a, b| a.1.total_cmp(&b.1))
    };
    let (turn, _) = best((-90..90).step_by(STEP as usize).collect())?;
    let (turn, least) = best((turn - BESIDE..=turn + BESIDE).collect())?;
    let turned = turn.abs() >= LEAST && least <= ALIKE * spacing(&points) && unlike(&points, 0).0 > WORSE * least;
    turned.then(|| half_turn(turn))
}

/// A turn in degrees as the one from -90 on and below 90 whose mirror is the same: half a turn more exchanges its sides.
fn half_turn(degrees: i32) -> Yaw {
    Yaw::degrees((degrees + 90).rem_euclid(180) - 90)
}

/// The x of the plane in whose mirror points lie alike as they stand; `None` where there is none. Likeness and time are those
/// of [`symmetric_yaw`].
pub fn mirror_plane(points: &[Vec3]) -> Option<f64> {
    let points = sound(points)?;
    let (apart, plane) = unlike(&points, 0);
    (apart < SAME * spacing(&points)).then_some(plane)
}

/// Points that can be compared; `None` where they cannot.
fn sound(points: &[Vec3]) -> Option<Vec<DVec3>> {
    let sound = points.len() > 1 && points.iter().flatten().all(|x| x.is_finite());
    sound.then(|| points.iter().map(|&p| DVec3::from(p.map(f64::from))).collect())
}

/// The mean distance of a point from the nearest other one.
fn spacing(points: &[DVec3]) -> f64 {
    let nearest = |own: usize| {
        let others = points.iter().enumerate().filter(|(k, _)| *k != own);
        others.map(|(_, p)| p.distance_squared(points[own])).fold(f64::INFINITY, f64::min).sqrt()
    };
    (0..points.len()).map(nearest).sum::<f64>() / points.len() as f64
}

/// How far points are from their image in the mirror, whose normal turns to x by `turn` degrees, and how far along the normal
/// that stands.
fn unlike(points: &[DVec3], turn: i32) -> (f64, f64) {
    let (sin, cos) = libm::sincos(f64::from(turn).to_radians());
    let normal = DVec3::new(cos, 0.0, sin);
    let along: Vec<f64> = points.iter().map(|p| p.dot(normal)).collect();
    let (low, high) = along.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), &x| (l.min(x), h.max(x)));
    let near: Vec<Vec3A> = points.iter().map(|p| p.as_vec3a()).collect();
    let mean = along.iter().sum::<f64>() / points.len() as f64;
    let through = |middle: f64| {
        let image = |(p, x): (&DVec3, &f64)| (*p - normal * (2.0 * (x - middle))).as_vec3a();
        let nearest = |at: Vec3A| near.iter().map(|p| p.distance_squared(at)).fold(f32::INFINITY, f32::min);
        points.iter().zip(&along).map(|of| f64::from(nearest(image(of)).sqrt())).sum::<f64>() / points.len() as f64
    };
    let [middle, mean] = [0.5 * (low + high), mean].map(|at| (through(at), at));
    if mean.0 < middle.0 { mean } else { middle }
}

#[cfg(test)]
mod tests {
    use riglab_random::{Draw, stream};

    use super::*;

    /// A body alike on both sides of x = 0, with its arms to the sides, a nose and feet in front.
    fn body() -> Vec<Vec3> {
        let mut random = stream(0, "test", &[]);
        let mut points = Vec::new();
        let mut filled = |count: usize, low: [f32; 3], high: [f32; 3]| {
            for _ in 0..count {
                let p: Vec3 = std::array::from_fn(|k| random.within(low[k], high[k]));
                points.extend([p, [-p[0], p[1], p[2]]]);
            }
        };
        filled(80, [0.0, -0.2, -0.1], [0.2, 0.8, 0.1]);
        filled(50, [0.2, 0.5, -0.05], [0.9, 0.6, 0.05]);
        filled(50, [0.05, -1.0, -0.05], [0.2, -0.2, 0.05]);
        filled(20, [0.05, -1.0, 0.0], [0.2, -0.9, 0.35]);
        points
    }

    #[test]
    fn a_turned_body_is_turned_back_up_to_half_a_turn() {
        let body = body();
        assert_eq!(symmetric_yaw(&body), None, "it stands as it should");
        // What stands nearly sideways is turned by no more than a quarter turn either way.
        assert_eq!([-92, -90, 89, 91].map(|turn| half_turn(turn).in_degrees()), [88, -90, 89, -89]);
        for degrees in [-130, -90, -89, -88, -45, 17, 60, 88, 89, 90, 91, 92, 163] {
            let turned: Vec<Vec3> = body.iter().map(|&p| Yaw::degrees(degrees).apply(p)).collect();
            let found = symmetric_yaw(&turned).unwrap_or_else(|| panic!("{degrees}"));
            assert!((-90..90).contains(&found.in_degrees()), "{degrees}: {found:?}");
            let left = (degrees + found.in_degrees()).rem_euclid(180);
            assert!(left.min(180 - left) <= 1, "{degrees}: {found:?}");
        }
    }

    #[test]
    fn what_is_round_or_has_no_symmetry_stays() {
        let mut random = stream(1, "test", &[]);
        let mut points = |square: bool| -> Vec<Vec3> {
            let corner =
                |random: &mut riglab_random::Stream| -> Vec3 { std::array::from_fn(|_| random.within(-1.0, 1.0)) };
            (0..400).map(|_| corner(&mut random)).filter(|p| square || p[0].hypot(p[2]) < 1.0).collect()
        };
        assert_eq!(symmetric_yaw(&points(true)), None);
        assert_eq!(symmetric_yaw(&points(false)), None);
        assert_eq!(symmetric_yaw(&[]), None);
        assert_eq!(symmetric_yaw(&[[0.0; 3]; 9]), None);
        assert_eq!(symmetric_yaw(&[[0.0, f32::NAN, 0.0]; 9]), None);
    }

    #[test]
    fn what_is_its_own_image_as_it_stands_has_a_plane() {
        let body = body();
        let moved: Vec<Vec3> = body.iter().map(|p| [p[0] + 0.25, p[1], p[2]]).collect();
        assert!((mirror_plane(&moved).unwrap() - 0.25).abs() < 1e-6);
        // One arm is enough to tell that it is not: what is a quarter of the body has no image.
        let without: Vec<Vec3> = body.iter().copied().filter(|p| p[0] < 0.2).collect();
        assert_eq!(mirror_plane(&without), None);
        let turned: Vec<Vec3> = body.iter().map(|&p| Yaw::degrees(30).apply(p)).collect();
        assert_eq!(mirror_plane(&turned), None);
        assert_eq!(mirror_plane(&[]), None);
        assert_eq!(mirror_plane(&[[0.0; 3]; 9]), None);
        assert_eq!(mirror_plane(&[[0.0, f32::NAN, 0.0]; 9]), None);
    }

    #[test]
    fn quarter_turns_round_nothing_and_all_go_back() {
        let p = [0.1f32, 0.2, -0.3];
        assert_eq!(Yaw::degrees(90).apply(p), [-0.3, 0.2, -0.1]);
        for degrees in (-360..360).step_by(30) {
            let yaw = Yaw::degrees(degrees);
            let back = yaw.inverse().apply(yaw.apply(p));
            assert!(back.iter().zip(p).all(|(a, b)| (a - b).abs() < 1e-7), "{degrees}");
            if degrees % 90 == 0 {
                assert_eq!(back, p);
            }
            let half = yaw.about().apply(p);
            assert!(half.iter().zip(yaw.apply(p)).zip([-1.0, 1.0, -1.0]).all(|((a, b), s)| (a - s * b).abs() < 1e-7));
        }
    }
}
