//! Surfaces for tests.

use riglab_core::Mesh;
use riglab_random::{Draw, stream};

/// A box around `center`, `half` to each side, facing outwards.
pub(crate) fn cube(center: [f32; 3], half: f32) -> Mesh {
    let corner = |i: usize| [0, 1, 2].map(|k| center[k] + if i >> k & 1 == 1 { half } else { -half });
    let sides = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]];
    let triangles = sides.iter().flat_map(|[a, b, c, d]| [[*a, *b, *c], [*a, *c, *d]]).collect();
    Mesh::new((0..8).map(corner).collect(), triangles).unwrap()
}

pub(crate) fn joined(parts: &[Mesh]) -> Mesh {
    let (mut positions, mut triangles) = (Vec::new(), Vec::new());
    for part in parts {
        let n = positions.len() as u32;
        positions.extend(part.positions());
        triangles.extend(part.triangles().iter().map(|t| t.map(|v| v + n)));
    }
    Mesh::new(positions, triangles).unwrap()
}

pub(crate) fn turned_over(mesh: &Mesh, which: impl Fn(usize) -> bool) -> Mesh {
    let turn = |(t, [a, b, c]): (usize, &[u32; 3])| if which(t) { [*a, *c, *b] } else { [*a, *b, *c] };
    Mesh::new(mesh.positions().to_vec(), mesh.triangles().iter().enumerate().map(turn).collect()).unwrap()
}

/// A surface of revolution around y: rings of given (radius, y).
pub(crate) fn turned_on_a_lathe(profile: &[[f32; 2]], around: usize) -> Mesh {
    let point = |[r, y]: [f32; 2], k: usize| {
        let angle = k as f32 / around as f32 * std::f32::consts::TAU;
        [r * angle.cos(), y, r * angle.sin()]
    };
    let positions = profile.iter().flat_map(|p| (0..around).map(|k| point(*p, k))).collect();
    let at = |ring: usize, k: usize| (ring * around + k % around) as u32;
    let side = |ring: usize, k: usize| {
        let [a, b, c, d] = [at(ring, k), at(ring + 1, k), at(ring + 1, k + 1), at(ring, k + 1)];
        [[a, b, c], [a, c, d]]
    };
    let triangles = (0..profile.len() - 1).flat_map(|r| (0..around).flat_map(move |k| side(r, k))).collect();
    Mesh::new(positions, triangles).unwrap()
}

/// A capsule along y around the origin; a sphere without a straight part.
pub(crate) fn capsule(radius: f32, straight: f32, rings: usize) -> Mesh {
    let arc = |k: usize| {
        let angle = (k as f32 / rings as f32 - 0.5) * std::f32::consts::PI;
        let y = radius * angle.sin() + if 2 * k < rings { -0.5 } else { 0.5 } * straight;
        [radius * angle.cos().max(0.0), y]
    };
    turned_on_a_lathe(&(0..=rings).map(arc).collect::<Vec<_>>(), 2 * rings)
}

/// Without some of its triangles.
pub(crate) fn without_some(mesh: &Mesh, share: f32, seed: u64) -> Mesh {
    let mut random = stream(seed, "test", &[]);
    let kept = mesh.triangles().iter().filter(|_| random.unit() >= share).copied().collect();
    Mesh::new(mesh.positions().to_vec(), kept).unwrap()
}
