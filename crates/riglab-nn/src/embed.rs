//! Positional encodings of points.

use serde::{Deserialize, Serialize};
use tch::{Kind, Tensor};

/// How a coordinate becomes features.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EmbedConfig {
    /// Which encoding.
    pub kind: EmbedKind,
    /// How many frequencies, each twice the one before.
    pub frequencies: usize,
    /// The lowest frequency in radians per unit: π in the paper, 1 for plain features.
    pub base: f64,
}

impl Default for EmbedConfig {
    /// The paper's: phase-modulated, 8 frequencies from π.
    fn default() -> Self {
        Self { kind: EmbedKind::PhaseModulated, frequencies: 8, base: std::f64::consts::PI }
    }
}

/// The encodings known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EmbedKind {
    /// SkinTokens' PMPE: to each sine (cosine) a second one at a fixed frequency with a phase that
    /// depends on k is added, so that encodings of distant points differ even where the fast sines
    /// agree.
    PhaseModulated,
    /// Sines and cosines.
    Fourier,
}

/// x [.., 3] to [.., 3 + 6 n]: x, the sine part, the cosine part, each by coordinate, then frequency.
pub struct Embedding {
    kind: EmbedKind,
    n: usize,
    frequencies: Vec<f64>,
    phases: Vec<f64>,
}

impl Embedding {
    /// The tables of an encoding.
    pub fn new(config: &EmbedConfig) -> Self {
        let n = config.frequencies;
        let frequencies = (0..n).map(|k| config.base * (1u64 << k.min(62)) as f64).collect();
        // Phase k of n: 2π (n^(1 - (k + 1) / n) + (k + 1) / n).
        let phase = |k: usize| {
            let share = (k + 1) as f64 / n as f64;
            std::f64::consts::TAU * ((n as f64).powf(1.0 - share) + share)
        };
        Self { kind: config.kind, n, frequencies, phases: (0..n).map(phase).collect() }
    }

    /// Features of a point.
    pub fn width(&self) -> usize {
        3 + 6 * self.n
    }

    /// The frequencies.
    pub fn frequencies(&self) -> &[f64] {
        &self.frequencies
    }

    /// The phases (phase-modulated encoding only).
    pub fn phases(&self) -> &[f64] {
        &self.phases
    }

    /// Encodes positions x [.., 3], in their kind.
    pub fn forward(&self, x: &Tensor) -> Tensor {
        self.with_tables(x, &self.table(&self.frequencies, x), &self.table(&self.phases, x))
    }

    /// As [`Self::forward`] with tables given: released inference rounds them to bfloat16.
    pub fn with_tables(&self, x: &Tensor, frequencies: &Tensor, phases: &Tensor) -> Tensor {
        let flat = |t: Tensor| t.flatten(-2, -1);
        let fast = x.unsqueeze(-1) * frequencies;
        let (sin, cos) = match self.kind {
            EmbedKind::Fourier => (fast.sin(), fast.cos()),
            EmbedKind::PhaseModulated => {
                let slow = x.unsqueeze(-1) * std::f64::consts::FRAC_PI_2 + phases;
                (fast.sin() + slow.sin(), fast.cos() + slow.cos())
            }
        };
        Tensor::cat(&[x, &flat(sin), &flat(cos)], -1)
    }

    fn table(&self, values: &[f64], like: &Tensor) -> Tensor {
        let kind = if like.kind() == Kind::Double { Kind::Double } else { Kind::Float };
        Tensor::from_slice(values).to_kind(kind).to_device(like.device())
    }
}
