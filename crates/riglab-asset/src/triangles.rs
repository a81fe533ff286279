//! Triangles out of index lists.

/// The triangles of `indices` under a glTF mode 4 (list), 5 (strip) or 6 (fan); a rest that makes no
/// whole triangle is dropped. Others have none.
///
/// Every second triangle of a strip is turned round, so that all face the same way.
pub(crate) fn from_indices(indices: &[u32], mode: u32) -> Vec<[u32; 3]> {
    match mode {
        4 => indices.as_chunks::<3>().0.to_vec(),
        5 => {
            let turned = |(i, w): (usize, &[u32])| if i % 2 == 0 { [w[0], w[1], w[2]] } else { [w[0], w[2], w[1]] };
            indices.windows(3).enumerate().map(turned).collect()
        }
        6 => match indices {
            [hub, rim @ ..] => rim.windows(2).map(|w| [*hub, w[0], w[1]]).collect(),
            [] => Vec::new(),
        },
        _ => Vec::new(),
    }
}

/// What [`keep_proper`] dropped.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Dropped {
    /// Triangles that name a vertex twice.
    pub collapsed: usize,
    /// Triangles over the same three vertices as one before, either way round.
    pub repeated: usize,
}

/// Triangles of a bucket that are compared each with each.
const SMALL: usize = 12;

/// Drops triangles that name a vertex twice and repeated ones; the rest keep their order. All
/// vertices are below `vertices`.
///
/// Buckets by lowest vertex instead of a hash set: a bucket holds a handful, and this runs over every
/// triangle ever imported.
pub(crate) fn keep_proper(triangles: &mut Vec<[u32; 3]>, vertices: usize) -> Dropped {
    let before = triangles.len();
    triangles.retain(|[a, b, c]| a != b && b != c && c != a);
    let collapsed = before - triangles.len();

    // Counting sort: `start[v]..start[v + 1]` are the slots of triangles whose lowest vertex is v.
    let mut start = vec![0u32; vertices + 2];
    for t in triangles.iter() {
        start[lowest(t) + 2] += 1;
    }
    for v in 2..start.len() {
        start[v] += start[v - 1];
    }
    // One step behind: filling a bucket moves its start to where the next begins.
    let mut bucketed = vec![(0u64, 0u32); triangles.len()];
    for (i, t) in (0u32..).zip(triangles.iter()) {
        let slot = &mut start[lowest(t) + 1];
        let (middle, high) = others(t);
        bucketed[*slot as usize] = (u64::from(middle) << 32 | u64::from(high), i);
        *slot += 1;
    }
    let mut repeats = Vec::new();
    for v in 0..vertices {
        let bucket = &mut bucketed[start[v] as usize..start[v + 1] as usize];
        // Nearly all are small and without repeats, which is seen faster than they are sorted.
        let repeated = |(at, (key, _)): (usize, &(u64, u32))| bucket[..at].iter().any(|(other, _)| other == key);
        if bucket.len() <= SMALL && !bucket.iter().enumerate().any(repeated) {
            continue;
        }
        bucket.sort_unstable();
        repeats.extend(bucket.windows(2).filter(|w| w[0].0 == w[1].0).map(|w| w[1].1));
    }
    if !repeats.is_empty() {
        repeats.sort_unstable();
        let mut next = repeats.iter().peekable();
        let mut i = 0u32;
        triangles.retain(|_| {
            i += 1;
            next.next_if_eq(&&(i - 1)).is_none()
        });
    }
    Dropped { collapsed, repeated: repeats.len() }
}

/// Gives the vertices of triangles new numbers from 0 in the order of the old ones, which come back.
/// All are below `count`.
pub(crate) fn renumber(triangles: &mut [[u32; 3]], count: usize) -> Vec<u32> {
    let corners = triangles.as_flattened_mut();
    let mut used;
    // A small part of a large set: the work must not grow with the set.
    if corners.len() < count / 8 {
        used = corners.to_vec();
        used.sort_unstable();
        used.dedup();
        for v in corners {
            *v = used.partition_point(|u| u < v) as u32;
        }
    } else {
        let mut number = vec![0u32; count];
        for v in corners.iter() {
            number[*v as usize] = 1;
        }
        used = Vec::new();
        for (v, number) in (0u32..).zip(&mut number).filter(|(_, n)| **n > 0) {
            *number = used.len() as u32;
            used.push(v);
        }
        for v in corners {
            *v = number[*v as usize];
        }
    }
    used
}

fn lowest(t: &[u32; 3]) -> usize {
    t[0].min(t[1]).min(t[2]) as usize
}

/// The two corners above the lowest, rising.
fn others(&[a, b, c]: &[u32; 3]) -> (u32, u32) {
    let (low, high) = (a.min(b), a.max(b));
    (low.max(c.min(high)), high.max(c))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn strips_keep_their_facing_and_fans_their_hub() {
        assert_eq!(from_indices(&[0, 1, 2, 3], 5), [[0, 1, 2], [1, 3, 2]]);
        assert_eq!(from_indices(&[9, 1, 2, 3], 6), [[9, 1, 2], [9, 2, 3]]);
        assert_eq!(from_indices(&[0, 1, 2, 3], 4), [[0, 1, 2]]);
        assert!(from_indices(&[0, 1], 5).is_empty() && from_indices(&[], 6).is_empty());
    }

    #[test]
    fn collapsed_and_repeated_triangles_go() {
        let mut t = vec![[0, 1, 2], [3, 3, 1], [2, 1, 0], [1, 2, 3], [3, 1, 2], [0, 2, 3], [1, 2, 3]];
        assert_eq!(keep_proper(&mut t, 4), Dropped { collapsed: 1, repeated: 3 });
        assert_eq!(t, [[0, 1, 2], [1, 2, 3], [0, 2, 3]]);
        assert_eq!(keep_proper(&mut t, 4), Dropped::default());
        assert_eq!(keep_proper(&mut Vec::new(), 0), Dropped::default());
    }

    #[test]
    fn both_ways_to_renumber_agree() {
        let triangles = [[7, 3, 5], [3, 7, 9]];
        for count in [10, 1000] {
            let mut renumbered = triangles;
            assert_eq!(renumber(&mut renumbered, count), [3, 5, 7, 9]);
            assert_eq!(renumbered, [[2, 0, 1], [0, 2, 3]]);
        }
    }
}
