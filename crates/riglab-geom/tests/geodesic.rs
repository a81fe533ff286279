//! Distances through bodies against exact ones, and how they bear missing faces.

use std::f64::consts::PI;

use riglab_core::{Mesh, Segment};
use riglab_geom::geodesic::GeodesicSolver;
use riglab_geom::voxel::SolidConfig;
use riglab_random::{Draw, Stream, stream};

/// A torus around y.
fn torus(major: f32, minor: f32, around: usize, across: usize) -> Mesh {
    let turn = |k: usize, n: usize| (k as f32 / n as f32 * std::f32::consts::TAU).sin_cos();
    let point = |i: usize, j: usize| {
        let ((s, c), (t, u)) = (turn(i, around), turn(j, across));
        [(major + minor * u) * c, minor * t, (major + minor * u) * s]
    };
    let positions = (0..around).flat_map(|i| (0..across).map(move |j| point(i, j))).collect();
    let at = |i: usize, j: usize| (i % around * across + j % across) as u32;
    let side = |i: usize, j: usize| {
        let [a, b, c, d] = [at(i, j), at(i, j + 1), at(i + 1, j + 1), at(i + 1, j)];
        [[a, b, c], [a, c, d]]
    };
    let triangles = (0..around).flat_map(|i| (0..across).flat_map(move |j| side(i, j))).collect();
    Mesh::new(positions, triangles).unwrap()
}

/// A ball, or with `straight` a capsule along y.
fn capsule(radius: f32, straight: f32, rings: usize) -> Mesh {
    let n = 2 * rings;
    let ring = |i: usize| {
        let angle = (i as f32 / rings as f32 - 0.5) * std::f32::consts::PI;
        [radius * angle.cos().max(0.0), radius * angle.sin() + if 2 * i < rings { -0.5 } else { 0.5 } * straight]
    };
    let point = |i: usize, k: usize| {
        let ([r, y], (s, c)) = (ring(i), (k as f32 / n as f32 * std::f32::consts::TAU).sin_cos());
        [r * c, y, r * s]
    };
    let positions = (0..=rings).flat_map(|i| (0..n).map(move |k| point(i, k))).collect();
    let at = |i: usize, k: usize| (i * n + k % n) as u32;
    let side =
        |i: usize, k: usize| [[at(i, k), at(i + 1, k), at(i + 1, k + 1)], [at(i, k), at(i + 1, k + 1), at(i, k + 1)]];
    let triangles = (0..rings).flat_map(|i| (0..n).flat_map(move |k| side(i, k))).collect();
    Mesh::new(positions, triangles).unwrap()
}

/// Boxes of 4 that make a U of rods of width 1: up along y, across along x, down again.
fn u_shape() -> Mesh {
    let outline: [[f32; 2]; 8] =
        [[0.0, 0.0], [1.0, 0.0], [1.0, 4.0], [3.0, 4.0], [3.0, 0.0], [4.0, 0.0], [4.0, 5.0], [0.0, 5.0]];
    let positions = [0.0, 1.0].into_iter().flat_map(|z| outline.map(|[x, y]| [x, y, z])).collect();
    let mut triangles = Vec::new();
    for [a, b, c, d] in [[0, 1, 2, 7], [7, 2, 3, 6], [3, 4, 5, 6]] {
        // Counter-clockwise as seen from z = 1.
        triangles.extend([[a + 8, b + 8, c + 8], [a + 8, c + 8, d + 8], [a, c, b], [a, d, c]]);
    }
    triangles.extend((0..8).flat_map(|k| {
        let next = (k + 1) % 8;
        [[k, next, next + 8], [k, next + 8, k + 8]]
    }));
    Mesh::new(positions, triangles).unwrap()
}

fn without_some(mesh: &Mesh, share: f32, seed: u64) -> Mesh {
    let mut random = stream(seed, "test", &[]);
    let kept = mesh.triangles().iter().filter(|_| random.unit() >= share).copied().collect();
    Mesh::new(mesh.positions().to_vec(), kept).unwrap()
}

fn point(p: [f32; 3]) -> [Segment; 1] {
    [Segment { a: p, b: p }]
}

fn config(resolution: usize) -> SolidConfig {
    SolidConfig { resolution, ..SolidConfig::default() }
}

/// The largest difference, in cells.
fn apart(got: &[f32], wanted: impl Iterator<Item = f64>, cell: f64) -> f64 {
    got.iter().zip(wanted).map(|(g, w)| (f64::from(*g) - w).abs() / cell).fold(0.0, f64::max)
}

/// The largest extent of a mesh over its cells.
fn cell(mesh: &Mesh, resolution: usize) -> f64 {
    let axis = |k: usize| {
        let all = || mesh.positions().iter().map(|p| f64::from(p[k]));
        all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min)
    };
    (0..3).map(axis).fold(0.0, f64::max) / (resolution - 1) as f64
}

#[test]
fn in_convex_bodies_distances_are_straight() {
    for resolution in [48, 128] {
        for (mesh, bone) in [
            (capsule(1.0, 0.0, 32), Segment { a: [0.9, 0.0, 0.0], b: [0.9, 0.0, 0.0] }),
            (capsule(0.5, 2.0, 33), Segment { a: [0.0, -1.3, 0.0], b: [0.1, -0.4, 0.1] }),
        ] {
            let solver = GeodesicSolver::new(&mesh, &config(resolution));
            let got = solver.distances(&[[bone]], mesh.positions());
            let wanted = mesh.positions().iter().map(|p| f64::from(bone.nearest(*p).1));
            let most = apart(&got, wanted, cell(&mesh, resolution));
            assert!(most < 2.0, "{most} cells at {resolution}");
        }
    }
}

#[test]
fn a_bone_may_begin_far_off() {
    // Through the whole body, from farther and farther away.
    let mesh = capsule(0.5, 2.0, 33);
    for resolution in [48, 256] {
        let solver = GeodesicSolver::new(&mesh, &config(resolution));
        let of = |far: f32| {
            let bone = Segment { a: [0.0, -far, 0.0], b: [0.0, 1.3, 0.0] };
            (solver.distances(&[[bone]], mesh.positions()), bone)
        };
        for far in [4.0, 30.0, 60.0, 1e3, 1e6, 1e30] {
            let (got, bone) = of(far);
            // From within, as what is outside is as near to none.
            let wanted =
                mesh.positions().iter().map(|p| f64::from(Segment { a: [0.0, -4.0, 0.0], ..bone }.nearest(*p).1));
            let most = apart(&got, wanted, cell(&mesh, resolution));
            assert!(most < 2.0, "{most} cells at {resolution}, from {far}");
        }
    }
}

#[test]
fn around_a_torus_ways_hug_its_inner_side() {
    let (major, minor) = (1.0, 0.3);
    let mesh = torus(major, minor, 96, 32);
    for resolution in [64, 128, 196] {
        let solver = GeodesicSolver::new(&mesh, &config(resolution));
        // In the plane of symmetry, where shortest ways stay.
        let angles = (0..=60).map(|k| f64::from(k) / 60.0 * PI);
        let places: Vec<(f64, f64)> = angles.flat_map(|a| [0.75, 1.0, 1.25].map(|r| (a, r))).collect();
        let points: Vec<[f32; 3]> =
            places.iter().map(|(a, r)| [(r * a.cos()) as f32, 0.0, (r * a.sin()) as f32]).collect();
        let got = solver.distances(&[point([major, 0.0, 0.0])], &points);
        let inner = f64::from(major) - f64::from(minor);
        let exact = |(angle, r): &(f64, f64)| {
            let bend = angle - (inner / f64::from(major)).acos() - (inner / r).acos();
            let tangent = |r: f64| (r * r - inner * inner).max(0.0).sqrt();
            if bend > 0.0 {
                tangent(f64::from(major)) + tangent(*r) + inner * bend
            } else {
                (r * r + 1.0 - 2.0 * r * angle.cos()).sqrt()
            }
        };
        let most = apart(&got, places.iter().map(exact), cell(&mesh, resolution));
        println!("torus at {resolution}: {most:.2} cells");
        assert!(most < 2.0, "{most} cells at {resolution}");
    }
}

#[test]
fn around_corners_ways_turn_there() {
    let mesh = u_shape();
    for resolution in [50, 128] {
        let solver = GeodesicSolver::new(&mesh, &config(resolution));
        let from = [0.5, 0.2, 0.5];
        let points: Vec<[f32; 3]> = (0..40).map(|k| [3.5, 0.1 + 0.1 * k as f32, 0.1 + 0.02 * k as f32]).collect();
        let got = solver.distances(&[point(from)], &points);
        // Over both edges, at (1, 4) and (3, 4): unrolled, the way's plan and its rise along z are one triangle.
        let exact = |p: &[f32; 3]| {
            let plan = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
            let last = plan([3.0, 4.0], [f64::from(p[0]), f64::from(p[1])]);
            (plan([0.5, 0.2], [1.0, 4.0]) + 2.0 + last).hypot(f64::from(p[2] - from[2]))
        };
        let most = apart(&got, points.iter().map(exact), cell(&mesh, resolution));
        println!("corners at {resolution}: {most:.2} cells");
        assert!(most < 2.0, "{most} cells at {resolution}");
    }
}

#[test]
fn without_an_eighth_of_the_faces_distances_stay() {
    let resolution = 96;
    let cases = [
        ("torus", torus(1.0, 0.3, 96, 32), [[1.0, 0.0, 0.0], [0.1, 0.05, -1.1]]),
        ("capsule", capsule(0.5, 2.0, 33), [[0.1, 0.9, 0.0], [0.0, -1.2, 0.2]]),
    ];
    for (name, mesh, bones) in cases {
        let (bones, points) = (bones.map(point), mesh.positions());
        let whole = GeodesicSolver::new(&mesh, &config(resolution)).distances(&bones, points);
        for seed in 0..3 {
            let torn = without_some(&mesh, 0.125, seed);
            let got = GeodesicSolver::new(&torn, &config(resolution)).distances(&bones, points);
            let most = apart(&got, whole.iter().map(|x| f64::from(*x)), cell(&mesh, resolution));
            println!("{name} {seed}: {most:.2} cells");
            assert!(most < 2.0, "{name}: {most} cells");
        }
    }
}

#[test]
fn pieces_hang_on_the_body_and_strange_bones_are_finite() {
    // Two capsules a gap of about three cells apart: ways cross it.
    let one = capsule(0.5, 1.0, 17);
    let shifted: Vec<[f32; 3]> = one.positions().iter().map(|p| [p[0] + 1.1, p[1], p[2]]).collect();
    let n = one.positions().len() as u32;
    let triangles = one.triangles().iter().copied().chain(one.triangles().iter().map(|t| t.map(|v| v + n)));
    let both = Mesh::new([one.positions(), &shifted].concat(), triangles.collect()).unwrap();
    let solver = GeodesicSolver::new(&both, &config(96));
    let far = f32::MAX;
    let bones = [point([0.0; 3]), point([9.0, 0.0, 0.0]), [Segment { a: [-far; 3], b: [far; 3] }]];
    let got = solver.distances(&bones, both.positions());
    assert!(got.iter().all(|d| d.is_finite() && *d >= 0.0));
    for (d, p) in got.iter().zip(both.positions()) {
        let straight = (p[0] * p[0] + p[1] * p[1] + p[2] * p[2]).sqrt();
        assert!((*d - straight).abs() < 0.15, "{p:?}: {d}, straight {straight}");
    }
    let nothing: [&[Segment]; 1] = [&[]];
    assert!(solver.distances(&nothing, &[[0.0; 3]])[0] > 10.0);
    let flat = Mesh::new(vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], vec![[0, 1, 2]]).unwrap();
    let got = GeodesicSolver::new(&flat, &config(32)).distances(&[point([0.0; 3])], flat.positions());
    assert!(got[0] < 0.05 && (got[1] - 1.0).abs() < 0.05 && (got[2] - 1.0).abs() < 0.05, "{got:?}");
}

/// Thin and torn bodies with bones of any kind: a bone's cell may be hidden from the bone by its own coarseness.
#[test]
fn bones_of_any_kind_in_any_body_have_finite_distances() {
    for seed in 0..60 {
        let mut random = stream(seed, "thin bodies", &[]);
        let point =
            |random: &mut Stream, side: f32| -> [f32; 3] { std::array::from_fn(|_| random.within(-side, side)) };
        let positions: Vec<[f32; 3]> = (0..60).map(|_| point(&mut random, 1.0)).collect();
        let triangles = (0..20).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mesh = Mesh::new(positions.clone(), triangles).unwrap();
        let config = SolidConfig { resolution: 24 + seed as usize % 3 * 20, ..SolidConfig::DEFAULT };
        let bones: Vec<[Segment; 1]> =
            (0..40).map(|_| [Segment { a: point(&mut random, 1.1), b: point(&mut random, 1.1) }]).collect();
        let found = GeodesicSolver::new(&mesh, &config).distances(&bones, &positions);
        // What no way leads to would be as far as the lattice's longest way.
        assert!(found.iter().all(|d| *d >= 0.0 && *d < 50.0), "seed {seed}");
        if seed % 10 == 0 {
            // A thread's search is kept from bone to bone, which must not show.
            let pool = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
            let with = |n| pool(n).install(|| GeodesicSolver::new(&mesh, &config).distances(&bones, &positions));
            assert!(with(1) == found && with(3) == found, "seed {seed}");
        }
    }
}
