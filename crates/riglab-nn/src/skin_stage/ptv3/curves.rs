//! Codes of lattice cells along space-filling curves.

/// A curve through the cells of a cube with 2^bits cells a side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Curve {
    /// z-order: the bits of x, y, z in turn, x highest.
    Z,
    /// The same with x and y exchanged.
    ZTrans,
    /// Hilbert's curve (Skilling 2004).
    Hilbert,
    /// The same with x and y exchanged.
    HilbertTrans,
}

impl Curve {
    /// All, in the order in which the backbone takes turns.
    pub const ALL: [Self; 4] = [Self::Z, Self::ZTrans, Self::Hilbert, Self::HilbertTrans];

    /// The code of a cell of cloud `batch`: the cloud's number above 3 `bits` bits of the place along the
    /// curve. At most 16 bits an axis; what a coordinate has beyond is ignored.
    pub fn code(self, [x, y, z]: [u32; 3], batch: usize, bits: u32) -> i64 {
        let axes = match self {
            Self::Z | Self::Hilbert => [x, y, z],
            Self::ZTrans | Self::HilbertTrans => [y, x, z],
        };
        let place = match self {
            Self::Z | Self::ZTrans => interleaved(axes, bits),
            Self::Hilbert | Self::HilbertTrans => interleaved(transposed(axes, bits), bits),
        };
        ((batch as i64) << (3 * bits)) | place
    }
}

/// The axes' bits in turn, highest first.
fn interleaved(axes: [u32; 3], bits: u32) -> i64 {
    (0..bits).rev().fold(0, |code, b| axes.iter().fold(code, |code, a| code << 1 | i64::from(a >> b & 1)))
}

/// Skilling's transform: axes to the transposed Hilbert index.
fn transposed(mut x: [u32; 3], bits: u32) -> [u32; 3] {
    for b in (1..bits).rev() {
        let (q, low) = (1 << b, (1 << b) - 1);
        for k in 0..3 {
            if x[k] & q != 0 {
                x[0] ^= low;
            } else {
                let t = (x[0] ^ x[k]) & low;
                x[0] ^= t;
                x[k] ^= t;
            }
        }
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let t = (1..bits).filter(|b| x[2] >> b & 1 == 1).fold(0, |t, b| t ^ ((1 << b) - 1));
    x.map(|a| a ^ t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hilbert_goes_from_neighbour_to_neighbour() {
        for bits in 1..=4 {
            let n = 1u32 << bits;
            let mut cells: Vec<[u32; 3]> = (0..n.pow(3)).map(|i| [i / (n * n), i / n % n, i % n]).collect();
            cells.sort_by_key(|c| Curve::Hilbert.code(*c, 0, bits));
            for pair in cells.windows(2) {
                let step: u32 = (0..3).map(|k| pair[0][k].abs_diff(pair[1][k])).sum();
                assert_eq!(step, 1, "{pair:?}");
            }
        }
    }

    #[test]
    fn clouds_come_one_after_another() {
        assert_eq!(Curve::Z.code([1, 0, 0], 0, 1), 4);
        assert_eq!(Curve::ZTrans.code([1, 0, 0], 0, 1), 2);
        assert!(Curve::Hilbert.code([0; 3], 1, 5) > Curve::Hilbert.code([31; 3], 0, 5));
    }
}
