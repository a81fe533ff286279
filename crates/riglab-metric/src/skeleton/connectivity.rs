//! Whether predicted parents are those of the truth.

/// Precision and recall of parents.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Connectivity {
    /// Edges of the truth that were predicted, in either direction, over all predicted.
    pub precision: f64,
    /// The same over the truth's.
    pub recall: f64,
}

/// Anymate's figures for parents predicted for the *true* joints: a predicted pair is right if it is an edge of the
/// truth in either direction, and an edge of the truth is missed if no prediction has it. A joint that is its own
/// parent, or has none, is a root and no pair.
///
/// NaN where a side has no pair.
pub fn connectivity(predicted: &[Option<usize>], truth: &[Option<usize>]) -> Connectivity {
    let pairs = |parents: &[Option<usize>]| {
        let pair = |(j, p): (usize, &Option<usize>)| p.filter(|p| *p != j).map(|p| [j.min(p), j.max(p)]);
        let mut pairs: Vec<[usize; 2]> = parents.iter().enumerate().filter_map(pair).collect();
        pairs.sort_unstable();
        pairs
    };
    let (p, g) = (pairs(predicted), pairs(truth));
    let share = |of: &[[usize; 2]], within: &[[usize; 2]]| {
        of.iter().filter(|e| within.binary_search(e).is_ok()).count() as f64 / of.len() as f64
    };
    Connectivity { precision: share(&p, &g), recall: share(&g, &p) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn direction_does_not_matter() {
        // The chain 0-1-2 read from its other end.
        let c = connectivity(&[Some(1), Some(2), None], &[None, Some(0), Some(1)]);
        assert_eq!((c.precision, c.recall), (1.0, 1.0));
        let c = connectivity(&[None, Some(0), Some(0)], &[None, Some(0), Some(1)]);
        assert_eq!((c.precision, c.recall), (0.5, 0.5));
        assert!(connectivity(&[None], &[Some(0)]).recall.is_nan());
    }
}
