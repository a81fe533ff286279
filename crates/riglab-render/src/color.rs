//! Colours: mixing in linear light, ramps and distinct hues in OKLab, where equal steps look equal.

use std::sync::LazyLock;

use glam::Vec3;

/// A colour of the screen: red, green, blue as sRGB bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rgb(pub [u8; 3]);

impl Rgb {
    pub(crate) fn linear(self) -> Vec3 {
        Vec3::from(self.0.map(|byte| {
            let s = f32::from(byte) / 255.0;
            if s <= 0.04045 { s / 12.92 } else { ((s + 0.055) / 1.055).powf(2.4) }
        }))
    }

    pub(crate) fn from_linear(linear: Vec3) -> Self {
        let encode = |x: f32| ENCODED[(x.clamp(0.0, 1.0) * (ENCODED.len() - 1) as f32 + 0.5) as usize];
        Self([encode(linear.x), encode(linear.y), encode(linear.z)])
    }
}

/// sRGB bytes of linear values: fine enough that every byte is reached.
static ENCODED: LazyLock<Vec<u8>> = LazyLock::new(|| {
    let encode = |x: f32| if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
    (0..1 << 13).map(|i| (encode(i as f32 / 8191.0) * 255.0 + 0.5) as u8).collect()
});

/// How values from 0 to 1 turn into colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Palette {
    /// Violet, blue, green, yellow: lightness rises evenly, so order survives print and colour
    /// blindness. In the manner of viridis, from anchors of our own.
    #[default]
    Dusk,
    /// Pale, amber, red, crimson: lightness falls evenly. For errors, where 0 should look like nothing.
    Ember,
    /// Blue, cyan, green, yellow, red, as weight painting tools show it. Familiar, not evenly ordered.
    Paint,
}

/// Lightness, chroma and hue (degrees) in OKLab, evenly spaced.
const DUSK: [[f32; 3]; 6] = [
    [0.30, 0.13, 305.0],
    [0.42, 0.13, 275.0],
    [0.55, 0.11, 230.0],
    [0.68, 0.13, 170.0],
    [0.81, 0.17, 130.0],
    [0.94, 0.18, 107.0],
];
const EMBER: [[f32; 3]; 5] =
    [[0.93, 0.02, 95.0], [0.84, 0.13, 85.0], [0.70, 0.18, 55.0], [0.55, 0.21, 30.0], [0.38, 0.16, 15.0]];
const PAINT: [[f32; 3]; 5] =
    [[0.48, 0.22, 265.0], [0.76, 0.13, 205.0], [0.80, 0.21, 145.0], [0.90, 0.18, 105.0], [0.60, 0.23, 28.0]];

impl Palette {
    /// The colour of a value; values outside 0 to 1 have that of the nearer end, NaN that of 0.
    pub fn color(self, value: f32) -> Rgb {
        Rgb::from_linear(self.linear(value))
    }

    pub(crate) fn linear(self, value: f32) -> Vec3 {
        let anchors: &[[f32; 3]] = match self {
            Self::Dusk => &DUSK,
            Self::Ember => &EMBER,
            Self::Paint => &PAINT,
        };
        let value = if value.is_nan() { 0.0 } else { value.clamp(0.0, 1.0) };
        let at = value * (anchors.len() - 1) as f32;
        let low = (at as usize).min(anchors.len() - 2);
        let [a, b] = [anchors[low], anchors[low + 1]].map(lab);
        lab_to_linear(a.lerp(b, at - low as f32))
    }

    /// 256 colours from 0 to 1, in linear light.
    pub(crate) fn table(self) -> Vec<Vec3> {
        (0..256).map(|i| self.linear(i as f32 / 255.0)).collect()
    }
}

/// The colour of a joint by its number: the same in every picture, unlike those of its neighbours.
pub fn joint_color(joint: usize) -> Rgb {
    Rgb::from_linear(lab_to_linear(joint_lab(joint)))
}

/// Turning by the golden angle keeps any run of joints apart in hue; three lightnesses separate the
/// hues that come close after a full turn.
pub(crate) fn joint_lab(joint: usize) -> Vec3 {
    const GOLDEN_ANGLE: f32 = 137.508;
    let hue = (30.0 + GOLDEN_ANGLE * (joint % 4096) as f32) % 360.0;
    let (lightness, chroma) = [(0.72, 0.15), (0.58, 0.16), (0.83, 0.12)][joint % 3];
    lab([lightness, chroma, hue])
}

fn lab([lightness, chroma, hue]: [f32; 3]) -> Vec3 {
    let (sin, cos) = hue.to_radians().sin_cos();
    Vec3::new(lightness, chroma * cos, chroma * sin)
}

/// OKLab to linear sRGB as its author B. Ottosson defines it, cut to what a screen shows.
pub(crate) fn lab_to_linear(lab: Vec3) -> Vec3 {
    let l = (lab.x + 0.396_337_78 * lab.y + 0.215_803_76 * lab.z).powi(3);
    let m = (lab.x - 0.105_561_346 * lab.y - 0.063_854_17 * lab.z).powi(3);
    let s = (lab.x - 0.089_484_18 * lab.y - 1.291_485_5 * lab.z).powi(3);
    let rgb = Vec3::new(
        4.076_741_7 * l - 3.307_711_6 * m + 0.230_969_94 * s,
        -1.268_438 * l + 2.609_757_4 * m - 0.341_319_38 * s,
        -0.004_196_086_3 * l - 0.703_418_6 * m + 1.707_614_7 * s,
    );
    rgb.clamp(Vec3::ZERO, Vec3::ONE)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn luminance(rgb: Rgb) -> f32 {
        rgb.linear().dot(Vec3::new(0.2126, 0.7152, 0.0722))
    }

    #[test]
    fn bytes_survive_linear_light() {
        for byte in 0..=255 {
            let rgb = Rgb([byte; 3]);
            assert_eq!(Rgb::from_linear(rgb.linear()), rgb);
        }
    }

    #[test]
    fn white_and_grey_are_where_oklab_has_them() {
        assert!((lab_to_linear(Vec3::new(1.0, 0.0, 0.0)) - Vec3::ONE).abs().max_element() < 1e-3);
        let grey = lab_to_linear(Vec3::new(0.5, 0.0, 0.0));
        assert!((grey - Vec3::splat(0.125)).abs().max_element() < 1e-3);
    }

    #[test]
    fn ordered_palettes_change_lightness_one_way() {
        let steps: Vec<f32> = (0..=64).map(|i| i as f32 / 64.0).collect();
        assert!(steps.windows(2).all(|s| luminance(Palette::Dusk.color(s[0])) < luminance(Palette::Dusk.color(s[1]))));
        assert!(
            steps.windows(2).all(|s| luminance(Palette::Ember.color(s[0])) > luminance(Palette::Ember.color(s[1])))
        );
        assert_eq!(Palette::Dusk.color(f32::NAN), Palette::Dusk.color(0.0));
        assert_eq!(Palette::Dusk.color(9.0), Palette::Dusk.color(1.0));
    }

    #[test]
    fn joints_near_in_number_differ_in_colour() {
        for joint in 0..200 {
            for other in joint + 1..joint + 12 {
                let distance = joint_lab(joint).distance(joint_lab(other));
                assert!(distance > 0.05, "{joint} {other} {distance}");
            }
        }
    }
}
