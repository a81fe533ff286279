//! Weights for vertices that have none.

use riglab_core::Vec3;

/// Distances computed at most for one set of vertices: under a second. Meshes in which millions of
/// vertices lack weights are not worth more.
const BUDGET: usize = 200_000_000;

/// For each vertex of `lacking` (rising) the nearest other vertex of `positions`; `None` where all
/// vertices are lacking or the search would take too long.
///
/// A sweep along the longest axis: candidates are visited outwards from the vertex and the search
/// ends where the axis alone is farther than the best.
pub(crate) fn nearest_others(positions: &[Vec3], lacking: &[u32]) -> Vec<Option<u32>> {
    // As nearly always: nothing to sort for.
    if lacking.is_empty() {
        return Vec::new();
    }
    let mut is_lacking = vec![false; positions.len()];
    for &v in lacking {
        is_lacking[v as usize] = true;
    }
    let axis = longest_axis(positions);
    let mut others: Vec<(f32, u32)> =
        (0u32..).zip(positions).filter(|(v, _)| !is_lacking[*v as usize]).map(|(v, p)| (p[axis], v)).collect();
    others.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut budget = BUDGET;
    lacking.iter().map(|&v| nearest(positions, &others, axis, positions[v as usize], &mut budget)).collect()
}

fn nearest(positions: &[Vec3], others: &[(f32, u32)], axis: usize, at: Vec3, budget: &mut usize) -> Option<u32> {
    let start = others.partition_point(|(x, _)| *x < at[axis]);
    let (below, above) = others.split_at(start);
    let (mut below, mut above) = (below.iter().rev().peekable(), above.iter().peekable());
    let mut best: Option<(f32, u32)> = None;
    loop {
        let along = |next: Option<&&(f32, u32)>| next.map_or(f32::INFINITY, |(x, _)| (x - at[axis]).abs());
        let (down, up) = (along(below.peek()), along(above.peek()));
        let Some(&(_, v)) = (if down < up { below.next() } else { above.next() }) else { break };
        if best.is_some_and(|(d, _)| down.min(up).powi(2) > d) {
            break;
        }
        *budget = budget.checked_sub(1)?;
        let d = squared_distance(positions[v as usize], at);
        // Of equally near ones the lowest number, so that the result does not hang on the sweep.
        if best.is_none_or(|(b, w)| d < b || (d == b && v < w)) {
            best = Some((d, v));
        }
    }
    best.map(|(_, v)| v)
}

fn longest_axis(positions: &[Vec3]) -> usize {
    let size = riglab_core::Bounds::of(positions.iter().copied()).map_or([0.0; 3], |b| b.size());
    (0..3).max_by(|&a, &b| size[a].total_cmp(&size[b])).unwrap_or(0)
}

fn squared_distance(a: Vec3, b: Vec3) -> f32 {
    (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sweep_finds_what_trying_all_finds() {
        // A scatter without pattern: multiples of irrational steps, wrapped.
        let positions: Vec<Vec3> =
            (0..500).map(|i| [0.618, 0.414, 0.732].map(|s| (i as f32 * s).fract() * (1.0 + s))).collect();
        let lacking: Vec<u32> = (0..500).filter(|i| i % 7 == 0).collect();
        let found = nearest_others(&positions, &lacking);
        for (&v, found) in lacking.iter().zip(found) {
            let distance = |w: u32| squared_distance(positions[v as usize], positions[w as usize]);
            let others = (0..500u32).filter(|w| w % 7 != 0);
            let best = others.min_by(|&a, &b| distance(a).total_cmp(&distance(b))).unwrap();
            assert_eq!(found, Some(best));
        }
    }

    #[test]
    fn without_others_there_is_none() {
        assert_eq!(nearest_others(&[[0.0; 3]; 2], &[0, 1]), [None, None]);
        assert_eq!(nearest_others(&[[0.0; 3]; 2], &[]), []);
    }
}
