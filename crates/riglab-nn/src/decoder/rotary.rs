//! Rotary positions (RoPE): pairs of channels turned by an angle that grows with the place.

use tch::{Device, Kind, Tensor};

use super::steps::floats;

/// cos and sin of every place and channel, each [t, 1, e]: channel k turns with k + e / 2 (Qwen's pairing).
pub struct Angles {
    cos: Tensor,
    sin: Tensor,
}

impl Angles {
    /// Of places [t] for heads of width e: angle = place · theta^(-2k / e).
    pub fn new(places: &[i64], width: i64, theta: f64, kind: Kind, device: Device) -> Self {
        let half = width / 2;
        let speeds: Vec<f64> = (0..half).map(|k| theta.powf(-2.0 * k as f64 / width as f64)).collect();
        let places: Vec<f64> = places.iter().map(|&p| p as f64).collect();
        let angles = Tensor::from_slice(&places).unsqueeze(1) * Tensor::from_slice(&speeds).unsqueeze(0);
        let both = Tensor::cat(&[&angles, &angles], 1).unsqueeze(1);
        let of = |t: Tensor| t.to_kind(kind).to_device(device);
        Self { cos: of(both.cos()), sin: of(both.sin()) }
    }

    /// Those of `count` places from `start` on.
    pub fn of(&self, start: i64, count: i64) -> Self {
        Self { cos: self.cos.narrow(0, start, count), sin: self.sin.narrow(0, start, count) }
    }

    /// The same tensors.
    pub fn shared(&self) -> Self {
        Self { cos: self.cos.shallow_clone(), sin: self.sin.shallow_clone() }
    }

    /// Cosines and sines, [t, 1, e] each.
    pub fn both(&self) -> (&Tensor, &Tensor) {
        (&self.cos, &self.sin)
    }

    /// Cosines and sines as plain numbers, [t, e] each.
    pub fn floats(&self) -> [Vec<f32>; 2] {
        [&self.cos, &self.sin].map(floats)
    }

    /// x [.., t, h, e] turned.
    pub fn turn(&self, x: &Tensor) -> Tensor {
        let halves = x.chunk(2, -1);
        let across = Tensor::cat(&[&halves[1].neg(), &halves[0]], -1);
        x * &self.cos + across * &self.sin
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn products_depend_on_how_far_apart_places_are() {
        let x = |seed: f64| (Tensor::arange(8, (Kind::Double, Device::Cpu)) * seed).sin().view([1, 1, 8]);
        let at = |place: i64| Angles::new(&[place], 8, 1e4, Kind::Double, Device::Cpu);
        let product = |a: i64, b: i64| (at(a).turn(&x(1.3)) * at(b).turn(&x(0.7))).sum(Kind::Double).double_value(&[]);
        assert!((product(3, 10) - product(103, 110)).abs() < 1e-9);
        assert!((product(3, 10) - product(3, 11)).abs() > 1e-3);
        assert!((at(0).turn(&x(1.3)) - x(1.3)).abs().max().double_value(&[]) < 1e-15);
    }
}
