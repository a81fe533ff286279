//! Finite scalar quantisation: each latent axis is rounded to a few levels, and the code is their
//! mixed-radix number (SkinTokens 3.2, after Mentzer et al. 2023).
//!
//! With L levels on an axis, h = ⌊L / 2⌋ and ε = 1e-3:
//! half = (L - 1)(1 + ε) / 2, off = 0.5 for even L else 0, shift = atanh(off / half),
//! bound(z) = tanh(z + shift) half - off, code = round(bound) / h. Rounding is half to even.

use tch::{Kind, Tensor};

use crate::NnError;
use crate::layers::Linear;
use crate::params::{Role, Scope, Weights};

const EPS: f64 = 1e-3;

/// The quantiser without its projections.
#[derive(Clone, Debug)]
pub struct Fsq {
    levels: Vec<i64>,
}

impl Fsq {
    /// Levels of each axis, the first counting fastest in the code.
    ///
    /// # Errors
    /// [`NnError::Config`] without levels, with fewer than 2 on an axis, or more codes than 2^31.
    pub fn new(levels: &[i64]) -> Result<Self, NnError> {
        let size = levels.iter().try_fold(1i64, |n, &l| n.checked_mul(l)).filter(|&n| n <= 1 << 31);
        if levels.is_empty() || levels.iter().any(|&l| l < 2) || size.is_none() {
            return Err(NnError::Config(format!(
                "levels {levels:?}: give one or more axes of at least 2 levels, at most 2^31 codes in all"
            )));
        }
        Ok(Self { levels: levels.to_vec() })
    }

    /// How many codes.
    pub fn size(&self) -> i64 {
        self.levels.iter().product()
    }

    /// Levels of each axis.
    pub fn levels(&self) -> &[i64] {
        &self.levels
    }

    /// The weight of each axis in the code.
    pub fn basis(&self) -> Vec<i64> {
        let mut next = 1;
        self.levels
            .iter()
            .map(|l| {
                let this = next;
                next *= l;
                this
            })
            .collect()
    }

    /// z [.., axes] squeezed into the range that is rounded.
    pub fn bound(&self, z: &Tensor) -> Tensor {
        let each = |f: fn(f64) -> f64| self.per_axis(z, |l| f(l as f64));
        let half = each(|l| (l - 1.0) * (1.0 + EPS) / 2.0);
        let off = each(|l| if l % 2.0 == 0.0 { 0.5 } else { 0.0 });
        let shift = each(|l| if l % 2.0 == 0.0 { (0.5 / ((l - 1.0) * (1.0 + EPS) / 2.0)).atanh() } else { 0.0 });
        (z + shift).tanh() * half - off
    }

    /// z [.., axes] to codes in [-1, 1] with the straight-through gradient: rounded forward, as if
    /// not rounded backward.
    pub fn quantize(&self, z: &Tensor) -> Tensor {
        let bound = self.bound(z);
        let rounded = &bound + (bound.round() - &bound).detach();
        rounded / self.halves(z)
    }

    /// Codes [.., axes] to ids [..].
    pub fn ids(&self, codes: &Tensor) -> Tensor {
        let basis = Tensor::from_slice(&self.basis()).to_device(codes.device());
        (self.digits(codes) * basis).sum_dim_intlist(-1, false, Kind::Int64)
    }

    /// Codes [.., axes] to the level of each axis, whole numbers from 0.
    pub fn digits(&self, codes: &Tensor) -> Tensor {
        let halves = self.halves(codes);
        (codes * &halves + &halves).round().to_kind(Kind::Int64)
    }

    /// Ids [..] to the level of each axis [.., axes]; ids beyond the codebook wrap around.
    pub fn levels_of(&self, ids: &Tensor) -> Tensor {
        let device = ids.device();
        let per = ids.unsqueeze(-1).divide_tensor_mode(&Tensor::from_slice(&self.basis()).to_device(device), "floor");
        per.remainder_tensor(&Tensor::from_slice(&self.levels).to_device(device))
    }

    /// Ids [..] to codes [.., axes] of the given kind.
    pub fn codes(&self, ids: &Tensor, kind: Kind) -> Tensor {
        let levels = self.levels_of(ids).to_kind(kind);
        let halves = self.halves(&levels);
        (levels - &halves) / halves
    }

    /// Codes [.., axes] of which some are as many levels off as `by` [.., axes] says, as far as levels reach. Gradients
    /// pass as if they were not.
    pub fn off(&self, codes: &Tensor, by: &Tensor) -> Tensor {
        let halves = self.halves(codes);
        let last = self.per_axis(codes, |l| (l - 1) as f64);
        let digits = (codes.detach() * &halves + &halves + by).clamp_tensor(Some(last.zeros_like()), Some(last));
        codes + ((digits - &halves) / halves - codes.detach())
    }

    fn halves(&self, like: &Tensor) -> Tensor {
        self.per_axis(like, |l| (l / 2) as f64)
    }

    fn per_axis(&self, like: &Tensor, f: impl Fn(i64) -> f64) -> Tensor {
        let values: Vec<f64> = self.levels.iter().map(|&l| f(l)).collect();
        Tensor::from_slice(&values).to_kind(like.kind()).to_device(like.device())
    }
}

/// The quantiser between its projections: latent to axes, and codes back to latent.
pub struct ProjectedFsq {
    fsq: Fsq,
    project_in: Linear,
    project_out: Linear,
    octaves: usize,
}

impl ProjectedFsq {
    /// `octaves` > 0 (an extension) gives the codes to the second projection with their Fourier
    /// features at π, 2π, ...; 0 is the paper's.
    ///
    /// # Errors
    /// As [`Fsq::new`].
    pub fn new(mut at: Scope, levels: &[i64], latent: usize, octaves: usize) -> Result<Self, NnError> {
        let fsq = Fsq::new(levels)?;
        let axes = levels.len();
        let project_in = Linear::new(at.sub("project_in"), Role::Projection, latent, axes, true);
        let project_out = Linear::new(at.sub("project_out"), Role::Projection, axes * (1 + 2 * octaves), latent, true);
        Ok(Self { fsq, project_in, project_out, octaves })
    }

    /// The quantiser.
    pub fn fsq(&self) -> &Fsq {
        &self.fsq
    }

    /// latent [.., l] to what is rounded, [.., axes], in at least f32.
    pub fn project(&self, w: &Weights, latent: &Tensor) -> Tensor {
        let z = self.project_in.forward(w, latent);
        if z.kind() == Kind::Double { z } else { z.to_kind(Kind::Float) }
    }

    /// latent [.., l] to codes [.., axes]. `bias` [.., axes], where given, is
    /// added before rounding. Computes in at least f32.
    pub fn encode(&self, w: &Weights, latent: &Tensor, bias: Option<&Tensor>) -> Tensor {
        let mut z = self.project(w, latent);
        if let Some(bias) = bias {
            z += bias;
        }
        self.fsq.quantize(&z)
    }

    /// Codes [.., axes] to latent [.., l], in the weights' kind.
    pub fn decode(&self, w: &Weights, codes: &Tensor) -> Tensor {
        let mut features = vec![codes.shallow_clone()];
        for k in 0..self.octaves {
            let angle = codes * (std::f64::consts::PI * f64::from(1u32 << k));
            features.push(angle.sin());
            features.push(angle.cos());
        }
        self.project_out.forward(w, &Tensor::cat(&features, -1).to_kind(w.kind()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_id_survives_the_way_to_its_code_and_back() {
        for levels in [vec![8, 8, 8, 5, 5, 5], vec![3, 4], vec![2]] {
            let fsq = Fsq::new(&levels).unwrap();
            let ids = Tensor::arange(fsq.size().min(5000), (Kind::Int64, tch::Device::Cpu));
            assert!(fsq.ids(&fsq.codes(&ids, Kind::Float)).equal(&ids));
        }
    }

    #[test]
    fn codes_that_are_off_stay_within_reach_and_pass_gradients() {
        let fsq = Fsq::new(&[8, 5]).unwrap();
        let codes = fsq.codes(&Tensor::from_slice(&[7i64, 2, 8]), Kind::Float).set_requires_grad(true);
        let by = Tensor::from_slice(&[1.0f32, -1.0, 0.0, 1.0, -1.0, 2.0]).view([3, 2]);
        let off = fsq.off(&codes, &by);
        let digits = Vec::<i64>::try_from(fsq.digits(&off).view([-1])).unwrap();
        assert_eq!(digits, [7, 0, 2, 1, 0, 3]);
        off.sum(Kind::Float).backward();
        assert!(codes.grad().equal(&codes.ones_like()));
    }

    #[test]
    fn impossible_levels_are_refused() {
        assert!(Fsq::new(&[]).is_err());
        assert!(Fsq::new(&[8, 1]).is_err());
        assert!(Fsq::new(&[1 << 16, 1 << 16]).is_err());
    }
}
