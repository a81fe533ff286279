//! Whether bones run inside the body.

use riglab_geom::voxel::Voxels;

/// Bone-mesh containment (SkinTokens 3.4.1):
///
/// ```text
/// R_vk = 1/(B (s + 1)) Σ_b Σ_{i=0..s} [J_parent + i/s (J_b - J_parent) in an occupied cell]
/// ```
///
/// over the bones from each joint's parent to the joint. The root is a bone of no length, if `root` says so; a
/// skeleton of one joint always is. With `steps` = 0 only the joints count. 0 without a joint.
pub fn containment(voxels: &Voxels, heads: &[[f64; 3]], parents: &[Option<usize>], steps: usize, root: bool) -> f64 {
    let (mut inside, mut points) = (0usize, 0usize);
    let single = heads.len() == 1;
    for (head, parent) in heads.iter().zip(parents) {
        let from = match parent {
            Some(parent) => heads[*parent],
            None if root || single => *head,
            None => continue,
        };
        for i in 0..=steps {
            let share = if steps == 0 { 1.0 } else { i as f64 / steps as f64 };
            let p = std::array::from_fn(|k| from[k] + share * (head[k] - from[k]));
            inside += usize::from(voxels.contains(p));
        }
        points += steps + 1;
    }
    if points == 0 { 0.0 } else { inside as f64 / points as f64 }
}

#[cfg(test)]
mod tests {
    use riglab_geom::voxel::Lattice;

    use super::*;

    #[test]
    fn counts_points_of_bones() {
        let lattice = Lattice { origin: [0.0; 3], cell: 1.0, size: [4, 1, 1] };
        let voxels = Voxels::new(lattice, [[0, 0, 0], [1, 0, 0]]);
        let heads = [[0.5, 0.5, 0.5], [3.5, 0.5, 0.5]];
        // 0.5, 1.25 | 2, 2.75, 3.5
        let parents = [None, Some(0)];
        assert_eq!(containment(&voxels, &heads, &parents, 4, false), 2.0 / 5.0);
        assert_eq!(containment(&voxels, &heads, &parents, 4, true), 7.0 / 10.0);
        assert_eq!(containment(&voxels, &heads[..1], &[None], 4, false), 1.0);
        assert_eq!(containment(&voxels, &heads, &parents, 0, true), 0.5);
        assert_eq!(containment(&voxels, &[], &[], 4, true), 0.0);
    }
}
