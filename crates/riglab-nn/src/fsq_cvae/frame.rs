//! The extension `frame`: the first three axes of a bone's codes are told, not learned.
//!
//! Bones differ in size a hundredfold: a finger is as wide as one cell of eight levels over the whole
//! rig. In its own frame it looks like an arm. The frame is the mean and the deviation of the points
//! that the bone moves, weighted by their weights. On the first three axes, the first [`SLOTS`] codes
//! hold it (first digit of the centre, size, second and third digit of the centre), and each code
//! after them holds where its query point lies in that frame. The other axes are learned.
//!
//! The decoder knows all this from the codes alone: with fewer of them, the frame is coarser.
//!
//! With the extension `prior` regions are known beforehand. Alone, they are the frames, and no axis is told.

use tch::{Kind, Tensor};

/// Codes that hold the frame.
pub const SLOTS: usize = 4;
/// Features of a position in a frame.
const PLACE: usize = 3 + 6 * OCTAVES;
/// Features of a point in a frame.
pub const POINT: usize = PLACE + 2;
/// Features of a token: of the frame, and of its own place.
pub const TOKEN: usize = 3 + 6 * OCTAVES + 3 + PLACE;

/// The centre lies in [-REACH, REACH]³: augmentation may leave the cube.
const REACH: f64 = 1.5;
/// Smallest and largest deviation that is told, by axis, in a cube from -1 to 1.
pub const SIZES: (f64, f64) = (0.004, 0.6);
/// Places are told up to this many deviations from the centre.
const SPAN: f64 = 2.2;
/// Fourier octaves of positions.
const OCTAVES: usize = 6;
/// Beyond this many deviations, points look alike.
const FAR: f64 = 8.0;

/// Where bones are and how large, as their codes tell.
pub struct Frame {
    /// [m, 1, 3]
    center: Tensor,
    /// [m, 1, 3]
    size: Tensor,
    /// [m, k, 3]: where the query points of codes from slot [`SLOTS`] on lie, in deviations from the
    /// centre.
    places: Tensor,
    /// Codes there are.
    codes: i64,
}

/// Frames to codes and back.
pub struct FrameCoder {
    levels: [f64; 3],
}

impl FrameCoder {
    /// For codes whose first three axes have these levels.
    pub fn new(levels: &[i64]) -> Self {
        Self { levels: std::array::from_fn(|k| levels[k] as f64) }
    }

    /// The first three axes [m, k, 3] of the codes of clouds [m, n, 3] with weights [m, n], whose
    /// queries are at `places` [m, k, 3]. `off` [m, 6]: how far off the frame is told, in deviations and in e-folds of size.
    pub fn tell(&self, positions: &Tensor, weights: &Tensor, places: &Tensor, off: Option<&Tensor>) -> Tensor {
        let _no_grad = tch::no_grad_guard();
        let frame = self.encode(positions, weights, off);
        let (k, slots) = (places.size()[1], (SLOTS as i64).min(places.size()[1]));
        let local = self.hear(&frame).local(&places.narrow(1, slots, k - slots));
        let levels = self.row(&local, |l| l - 1.0);
        let digits = ((local.clamp(-SPAN, SPAN) / SPAN + 1.0) * 0.5 * levels).round();
        let halves = self.halves(&digits);
        Tensor::cat(&[frame.narrow(1, 0, slots), (digits - &halves) / halves], 1)
    }

    /// What codes [m, k, axes] say: of the frame, the middle of what is still open.
    pub fn hear(&self, codes: &Tensor) -> Frame {
        let _no_grad = tch::no_grad_guard();
        let codes = codes.narrow(2, 0, 3);
        let halves = self.halves(&codes);
        let digits = (&codes * &halves + &halves).round();
        let levels = self.row(&digits, |l| l);
        let count = codes.size()[1];
        let slot = |k: i64| digits.narrow(1, k, 1);
        let mut cell = levels.reciprocal();
        let mut share = slot(0) * &cell;
        for k in [2, 3] {
            if k < count {
                cell = &cell / &levels;
                share += slot(k) * &cell;
            }
        }
        share += cell * 0.5;
        let (small, large) = SIZES;
        let size = if count > 1 { slot(1) / (&levels - 1.0) } else { share.full_like(0.5) };
        let first = count.min(SLOTS as i64);
        Frame {
            center: share * (2.0 * REACH) - REACH,
            size: (size * (large / small).ln()).exp() * small,
            places: (digits.narrow(1, first, count - first) / (&levels - 1.0) * 2.0 - 1.0) * SPAN,
            codes: count,
        }
    }

    /// The frame of clouds [m, n, 3] with weights [m, n], as all its codes tell it.
    pub fn of(&self, positions: &Tensor, weights: &Tensor) -> Frame {
        self.hear(&self.encode(positions, weights, None))
    }

    /// The codes [m, [`SLOTS`], 3] of a frame.
    fn encode(&self, positions: &Tensor, weights: &Tensor, off: Option<&Tensor>) -> Tensor {
        let _no_grad = tch::no_grad_guard();
        let w = weights.unsqueeze(-1);
        let total = w.sum_dim_intlist([1i64].as_slice(), true, None::<Kind>).clamp_min(1e-6);
        let mean = |x: Tensor| (x * &w).sum_dim_intlist([1i64].as_slice(), true, None::<Kind>) / &total;
        let (mut center, (small, large)) = (mean(positions.shallow_clone()), SIZES);
        let mut size = mean((positions - &center).square()).sqrt().clamp(small, large);
        if let Some(off) = off {
            center += off.narrow(1, 0, 3).unsqueeze(1) * &size;
            size *= off.narrow(1, 3, 3).unsqueeze(1).exp();
        }

        let levels = self.row(&center, |l| l);
        let digit = |share: &Tensor| (share * &levels).floor();
        let share = ((center + REACH) / (2.0 * REACH)).clamp(0.0, 1.0 - 1e-6);
        let first = digit(&share);
        let rest = share * &levels - &first;
        let second = digit(&rest);
        let third = digit(&(rest * &levels - &second));
        let size = (size.clamp(small, large).log() - small.ln()) / (large / small).ln();
        let size = (size * (&levels - 1.0)).round();
        let halves = self.halves(&first);
        (Tensor::cat(&[first, size, second, third], 1) - &halves) / halves
    }

    fn halves(&self, like: &Tensor) -> Tensor {
        self.row(like, |l| (l / 2.0).floor())
    }

    fn row(&self, like: &Tensor, f: impl Fn(f64) -> f64) -> Tensor {
        Tensor::from_slice(&self.levels.map(f)).to_kind(like.kind()).to_device(like.device())
    }
}

impl Frame {
    /// Frames known beforehand: `regions` [m, 6], centre and deviation of each, beside `codes` codes.
    pub fn known(regions: &Tensor, codes: i64) -> Self {
        let (small, large) = SIZES;
        let center = regions.narrow(1, 0, 3).unsqueeze(1);
        let size = regions.narrow(1, 3, 3).clamp(small, large).unsqueeze(1);
        Self { places: center.narrow(1, 0, 0), center, size, codes }
    }

    /// Positions [m, n, 3] in deviations from the centre.
    fn local(&self, positions: &Tensor) -> Tensor {
        (positions - &self.center) / &self.size
    }

    /// What networks are told of points [m, n, 3]: [m, n, [`POINT`]].
    pub fn point_features(&self, positions: &Tensor) -> Tensor {
        let norm = |x: Tensor| x.square().sum_dim_intlist([-1i64].as_slice(), true, None::<Kind>);
        let local = self.local(positions);
        let far = norm(local.shallow_clone()).log1p() * 0.5;
        let away = norm(positions - &self.center).sqrt();
        Tensor::cat(&[place_features(&local), far, away], -1)
    }

    /// What networks are told beside the codes: [m, k, [`TOKEN`]].
    pub fn token_features(&self) -> Tensor {
        let center = &self.center;
        let shared = [octaves(center, std::f64::consts::FRAC_PI_2), center.shallow_clone(), self.size.log() * 0.5];
        let shared = Tensor::cat(&shared, -1).expand([-1, self.codes, -1], false);
        let slots = self.codes - self.places.size()[1];
        Tensor::cat(&[shared, place_features(&self.places).constant_pad_nd([0, 0, slots, 0])], -1)
    }
}

/// Positions in a frame [.., 3] as [.., [`PLACE`]]: of points and of tokens alike, so that attention
/// finds who is near whom.
fn place_features(local: &Tensor) -> Tensor {
    let local = local.clamp(-FAR, FAR);
    Tensor::cat(&[octaves(&local, std::f64::consts::PI / FAR), &local * 0.5], -1)
}

/// Sines and cosines of x [.., 3] at OCTAVES frequencies from `base`.
fn octaves(x: &Tensor, base: f64) -> Tensor {
    let frequencies: Vec<f64> = (0..OCTAVES).map(|k| base * f64::from(1u32 << k)).collect();
    let angles = x.unsqueeze(-1) * Tensor::from_slice(&frequencies).to_kind(x.kind()).to_device(x.device());
    let angles = angles.flatten(-2, -1);
    Tensor::cat(&[angles.sin(), angles.cos()], -1)
}

#[cfg(test)]
mod tests {
    use tch::Device;

    use super::*;
    use crate::fsq::Fsq;

    fn cloud() -> (Tensor, Tensor) {
        // Two bones of 200 points: a finger and a trunk.
        tch::manual_seed(1);
        let x = Tensor::randn([2, 200, 3], (Kind::Float, Device::Cpu));
        let size = Tensor::from_slice(&[0.01f32, 0.02, 0.03, 0.3, 0.5, 0.1]).view([2, 1, 3]);
        let center = Tensor::from_slice(&[0.71f32, -0.2, 0.33, 0.0, 0.1, -1.2]).view([2, 1, 3]);
        (x * size + center, Tensor::rand([2, 200], (Kind::Float, Device::Cpu)))
    }

    fn most(a: &Tensor, b: &Tensor) -> f64 {
        (a - b).abs().max().double_value(&[])
    }

    #[test]
    fn a_frame_survives_its_codes_and_sharpens_with_each() {
        let (x, w) = cloud();
        let total = w.sum_dim_intlist(1i64, true, None::<Kind>).unsqueeze(-1);
        let center = (&x * w.unsqueeze(-1)).sum_dim_intlist(1i64, true, None::<Kind>) / total;
        let places = x.narrow(1, 0, 10);
        for levels in [[8, 8, 8, 5, 5, 5], [5, 6, 7, 8, 8, 8]] {
            let coder = FrameCoder::new(&levels);
            let codes = coder.tell(&x, &w, &places, None);
            // They are codes: each level of each axis is whole and within reach.
            let full = Tensor::cat(&[&codes, &codes.zeros_like()], -1);
            let fsq = Fsq::new(&levels).unwrap();
            assert!(most(&fsq.codes(&fsq.ids(&full), Kind::Float), &full) < 1e-6);

            let coarsest = levels[..3].iter().min().copied().unwrap() as f64;
            let error = |k: i64| most(&coder.hear(&codes.narrow(1, 0, k)).center.squeeze(), &center.squeeze());
            for (k, digits) in [(1, 1), (2, 1), (3, 2), (4, 3), (10, 3)] {
                assert!(error(k) < REACH * 1.001 / coarsest.powi(digits), "{k} codes: off by {}", error(k));
            }
            let frame = coder.hear(&codes);
            let spread = frame.local(&x).std_dim(1, true, false);
            let (least, largest) = (spread.min().double_value(&[]), spread.max().double_value(&[]));
            assert!(least > 0.5 && largest < 2.0, "{least} to {largest}");
            // Places are told to half a cell.
            let local = frame.local(&places.narrow(1, 4, 6)).clamp(-SPAN, SPAN);
            assert!(most(&frame.places, &local) < SPAN / (coarsest - 1.0) * 1.001);
        }
    }

    #[test]
    fn a_frame_is_told_as_far_off_as_is_asked() {
        let (x, w) = cloud();
        let coder = FrameCoder::new(&[8, 8, 8, 5, 5, 5]);
        let told = |off: &[f32]| {
            let off = Tensor::from_slice(off).view([1, 6]).expand([2, 6], false);
            coder.hear(&coder.tell(&x, &w, &x.narrow(1, 0, 4), Some(&off)))
        };
        let (own, off) = (told(&[0.0; 6]), told(&[0.5, -0.5, 0.0, 0.7, 0.0, -0.7]));
        assert!(most(&own.center, &coder.of(&x, &w).center) == 0.0 && most(&own.size, &coder.of(&x, &w).size) == 0.0);
        let mean = |x: Tensor| {
            let w = w.unsqueeze(-1);
            (x * &w).sum_dim_intlist(1i64, true, None::<Kind>) / w.sum_dim_intlist(1i64, true, None::<Kind>)
        };
        let deviation = mean((&x - mean(x.shallow_clone())).square()).sqrt();
        let by = &off.center - &own.center;
        let want = Tensor::from_slice(&[0.5f32, -0.5, 0.0]).view([1, 1, 3]) * deviation;
        assert!(most(&by, &want) <= 2.0 * REACH / 512.0 * 1.001, "{by} {want}");
        let step = (SIZES.1 / SIZES.0).ln() / 7.0;
        let by = (&off.size / &own.size).log();
        assert!(most(&by, &Tensor::from_slice(&[0.7f32, 0.0, -0.7]).view([1, 1, 3])) <= step * 1.001, "{by}");
        assert!(by.narrow(2, 0, 1).min().double_value(&[]) >= 0.0 && by.narrow(2, 2, 1).max().double_value(&[]) <= 0.0);
    }

    #[test]
    fn a_known_frame_is_the_one_that_codes_tell() {
        let (x, w) = cloud();
        let told = FrameCoder::new(&[8, 8, 8, 5, 5, 5]).of(&x, &w);
        let regions = Tensor::cat(&[&told.center, &told.size], -1).squeeze_dim(1);
        let known = Frame::known(&regions, 3);
        assert!(most(&known.point_features(&x), &told.point_features(&x)) < 1e-5);
        assert_eq!(known.token_features().size(), [2, 3, TOKEN as i64]);
        assert_eq!(Frame::known(&regions, 0).token_features().size(), [2, 0, TOKEN as i64]);
        // Sizes beyond those that are told are told as the nearest.
        let flat = Frame::known(&regions.zeros_like(), 1);
        assert!((flat.size.max().double_value(&[]) - SIZES.0).abs() < 1e-6);
    }

    #[test]
    fn features_have_the_widths_told() {
        let (x, w) = cloud();
        let coder = FrameCoder::new(&[8, 8, 8, 5, 5, 5]);
        let codes = coder.tell(&x, &w, &x.narrow(1, 0, 9), None);
        for k in [1, 4, 9] {
            let frame = coder.hear(&codes.narrow(1, 0, k));
            assert_eq!(frame.point_features(&x).size(), [2, 200, POINT as i64]);
            assert_eq!(frame.token_features().size(), [2, k, TOKEN as i64]);
        }
        assert_eq!(coder.of(&x, &w).center.size(), [2, 1, 3]);
    }
}
