//! What a skeleton's tokens are told of the joints before them.

use tch::{Device, Kind, Tensor};

use crate::embed::{EmbedConfig, EmbedKind, Embedding};
use crate::layers::Linear;
use crate::params::{Role, Scope, Weights};

/// Octaves with which places are told.
const OCTAVES: usize = 6;
/// Numbers that are told.
const PLACE: usize = 14;
/// Where the last place is that was written whole, the one before it, and what is known of the next, the axes in the order
/// of the sequence; 1 for each of the first two that is known; and which axis of the third follows.
pub(super) type Place = [f32; PLACE];

/// Goes along the ids of a skeleton. A joint's parent stands before it: as the joint before, or named after a branch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Walk {
    /// The last and the one before.
    whole: [Option<[f32; 3]>; 2],
    next: [f32; 3],
    known: usize,
}

impl Walk {
    /// Takes an id, and says what is told of what follows. Ids below `bins` are cells.
    pub fn take(&mut self, id: i64, bins: i64) -> Place {
        if (0..bins).contains(&id) {
            self.next[self.known] = (2.0 * id as f32 + 1.0) / bins as f32 - 1.0;
            self.known += 1;
            if self.known == 3 {
                self.whole = [Some(self.next), self.whole[0]];
                (self.next, self.known) = ([0.0; 3], 0);
            }
        } else {
            // What is no cell stands between joints.
            (self.next, self.known) = ([0.0; 3], 0);
        }
        let mut out = [0.0; PLACE];
        for (k, place) in self.whole.iter().enumerate() {
            if let Some(place) = place {
                out[3 * k..3 * k + 3].copy_from_slice(place);
                out[9 + k] = 1.0;
            }
        }
        out[6..9].copy_from_slice(&self.next);
        out[11 + self.known] = 1.0;
        out
    }
}

/// What tells them.
pub(super) struct Places {
    embedding: Embedding,
    linear: Linear,
}

impl Places {
    pub fn new(at: Scope, width: usize, std: f64) -> Self {
        let kind = EmbedConfig { kind: EmbedKind::Fourier, frequencies: OCTAVES, base: std::f64::consts::FRAC_PI_2 };
        let embedding = Embedding::new(&kind);
        let linear = Linear::plain(at, Role::Projection, 3 * embedding.width() + PLACE - 9, width, std);
        Self { embedding, linear }
    }

    /// What telling places adds, [.., d], of a shape [..]; nothing where a place is all 0.
    pub fn tell(&self, w: &Weights, told: &[Place], shape: &[i64]) -> Tensor {
        let device = w.tensors().first().map_or(Device::Cpu, Tensor::device);
        let told = Tensor::from_slice(told.as_flattened()).view([shape, &[PLACE as i64]].concat().as_slice());
        let told = told.to_device(device);
        let flags = told.narrow(-1, 9, PLACE as i64 - 9);
        let mut parts: Vec<Tensor> = [0, 3, 6].map(|at| self.embedding.forward(&told.narrow(-1, at, 3))).into();
        let known = flags.narrow(-1, 2, 3).sum_dim_intlist([-1i64].as_slice(), true, None::<Kind>);
        parts.push(flags);
        self.linear.forward(w, &(Tensor::cat(&parts, -1) * known).to_kind(w.kind()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_told_as_they_are_written() {
        let mut walk = Walk::default();
        let mut last = [0.0; PLACE];
        // A begin, a joint, half of another.
        for id in [20, 0, 3, 1, 2, 2] {
            last = walk.take(id, 4);
        }
        let first = [-0.75, 0.75, -0.25];
        assert_eq!(last[..3], first);
        assert_eq!(last[3..], [0.0, 0.0, 0.0, 0.25, 0.25, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]);
        last = walk.take(1, 4);
        assert_eq!(
            (&last[..3], &last[3..6], &last[9..]),
            (&[0.25, 0.25, -0.25][..], &first[..], &[1.0, 1.0, 1.0, 0.0, 0.0][..])
        );
        // A branch names a place before its own, which is the parent of what follows.
        for id in [21, 0, 3, 1] {
            last = walk.take(id, 4);
        }
        assert_eq!((&last[..3], &last[3..6]), (&first[..], &[0.25, 0.25, -0.25][..]));
    }
}
