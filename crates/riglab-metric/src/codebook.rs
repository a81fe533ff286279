//! How a codebook is used, and what it saves.

use std::collections::HashMap;

/// Codes seen over a set of assets, all of a bone's tokens kept.
#[derive(Clone, Debug, Default)]
pub struct Codebook {
    counts: HashMap<i64, u64>,
    tokens: u64,
}

impl Codebook {
    /// Adds codes.
    pub fn add(&mut self, codes: impl IntoIterator<Item = i64>) {
        for code in codes {
            *self.counts.entry(code).or_default() += 1;
            self.tokens += 1;
        }
    }

    /// How many tokens were added: few of them cannot use many codes.
    pub fn tokens(&self) -> u64 {
        self.tokens
    }

    /// How many different codes were seen.
    pub fn distinct(&self) -> usize {
        self.counts.len()
    }

    /// Distinct codes over all `size` of the codebook.
    pub fn utilisation(&self, size: i64) -> f64 {
        self.counts.len() as f64 / size as f64
    }

    /// exp of the entropy: how many codes, equally used, would be as varied.
    pub fn perplexity(&self) -> f64 {
        let mut counts: Vec<u64> = self.counts.values().copied().collect();
        counts.sort_unstable(); // sums in fixed order
        let n = self.tokens as f64;
        let entropy: f64 = counts.iter().map(|&c| c as f64 / n).map(|p| -p * p.ln()).sum();
        entropy.exp()
    }
}

/// Bits of dense 16-bit weights of a bone over bits of its tokens: N · 16 / (T · ⌈log2 C⌉). The mesh
/// that decoding needs as well is not counted. SkinTokens' Table 2 prints the ratio with one bit
/// more a token.
pub fn compression_ratio(vertices: usize, tokens: usize, codes: i64) -> f64 {
    let bits = (codes.max(2) as f64).log2().ceil();
    vertices as f64 * 16.0 / (tokens as f64 * bits)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_use_of_k_codes_has_perplexity_k() {
        let mut c = Codebook::default();
        c.add([3, 4, 5, 3, 4, 5]);
        assert!((c.perplexity() - 3.0).abs() < 1e-12);
        assert_eq!((c.utilisation(6), c.tokens(), c.distinct()), (0.5, 6, 3));
    }

    #[test]
    fn the_papers_size() {
        assert!((compression_ratio(6247, 32, 64_000) - 195.2).abs() < 0.1);
        assert!((compression_ratio(6247, 32, 32_768) - 208.2).abs() < 0.1);
    }
}
