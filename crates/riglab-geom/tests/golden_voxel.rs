//! Voxels and the weights of their graph against values recorded from the public code of SkinTokens and
//! UniRig.

#[path = "common/golden.rs"]
mod golden;

use std::collections::BTreeSet;

use golden::{Golden, golden};
use riglab_core::{Joint, JointId, Mesh, Skeleton};
use riglab_geom::geodesic::{Kernel, VoxelSkinConfig, voxel_skin};
use riglab_geom::voxel::{Between, Lattice, Voxels, by_depth, fill, shell};

fn places(case: &Golden, name: &str) -> Vec<[usize; 3]> {
    case.indices(name).as_chunks::<3>().0.to_vec()
}

/// A star where the case has no tree: only positions are looked at then.
fn skeleton(case: &Golden, heads: Vec<[f32; 3]>) -> Skeleton {
    let parent = |j: usize| match case.has("in.parents") {
        true => case.values("in.parents")[j],
        false => 0.0,
    };
    let joints = heads.into_iter().enumerate().map(|(j, head)| Joint {
        name: format!("joint {j}"),
        parent: (j > 0).then(|| JointId(parent(j) as u16)),
        head,
    });
    Skeleton::new(joints.collect()).expect("a tree")
}

#[test]
fn skintokens() {
    for case in golden("skintokens", "voxel") {
        let origin: Vec<f64> = case.config("origin").as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect();
        let lattice = Lattice {
            origin: origin.try_into().unwrap(),
            cell: case.number("voxel_size"),
            size: [case.number("grid") as usize; 3],
        };
        let given = Voxels::new(lattice, places(&case, "in.grid_index"));
        let (mesh, skeleton) = (case.mesh(), skeleton(&case, case.points("in.joints")));
        let config = VoxelSkinConfig {
            kernel: Kernel::Square { alpha: case.number("alpha") },
            vertices_per_cell: case.number("vertex_query") as usize,
            cell_cost: case.number("grid_weight"),
            link: case.number("link_dis"),
            ..VoxelSkinConfig::skintokens()
        };
        assert!(case.number("grid_query") >= 27.0, "{}: each cell is joined to all around it", case.name);
        let weights = |config| voxel_skin(&mesh, &skeleton, &given, &config).weights;
        case.check("out.square", weights(config));
        case.check("out.square_segments", weights(VoxelSkinConfig { bones: true, ..config }));
        case.check("out.exp", weights(VoxelSkinConfig { kernel: Kernel::Exp, ..config }));
        case.elsewhere("out.square_demo_bug", "numbers of cells taken for positions");
        let hollow = Voxels::new(lattice, places(&case, "in.shell"));
        for (name, between) in [("out.fill_rigid", Between::All), ("out.fill_loose", Between::Two)] {
            let filled = fill(&hollow, between);
            case.check(name, filled.places().flatten().map(|x| x as f64));
        }
        let query = case.values("in.query").as_chunks::<3>().0;
        case.check("out.inside", query.iter().map(|p| f64::from(u8::from(given.contains(*p)))));
        case.check("out.pc", given.places().flat_map(|place| lattice.center(place)));
        case.done();
    }
}

#[test]
fn unirig() {
    for case in golden("unirig", "voxel_skin") {
        let (low, high) = bounds(&case.points("in.vertices"));
        let longest = (0..3).map(|k| high[k] - low[k]).fold(0.0, f64::max);
        let normal = |p: [f32; 3]| -> [f32; 3] {
            std::array::from_fn(|k| (2.0 * (f64::from(p[k]) - 0.5 * (low[k] + high[k])) / longest) as f32)
        };
        let mesh = case.mesh();
        let mesh = mesh.with_positions(mesh.positions().iter().map(|p| normal(*p)).collect()).unwrap();
        close(&case, "out.norm_vertices", mesh.positions().as_flattened(), 1e-6);
        let skeleton = skeleton(&case, case.points("in.joints").into_iter().map(normal).collect());
        let surface = |grid: usize| fill(&shell(&mesh, &Lattice::unirig(&mesh, grid)), Between::Two);
        for group in case.groups().iter().filter_map(|group| group.strip_suffix("_cells")) {
            let (from, grid) = group.rsplit_once("_g").expect("a grid");
            let grid = grid.parse().expect("a number");
            let found = match from {
                "open3d" => surface(grid),
                "pyrender" => by_depth(&mesh, grid),
                other => panic!("{}: unknown cells `{other}`", case.name),
            };
            cells(&case, &format!("out.{group}_cells"), &found);
        }
        // "out.open3d_g20_cells for ..."
        let told = case.config("cells_used").as_str().expect("cells that skins are of");
        let grid = told.split("_g").nth(1).and_then(|s| s.split('_').next()?.parse().ok()).expect("a grid");
        let kinds = case.groups();
        for name in kinds.iter().filter_map(|group| group.strip_suffix("_skin")).filter(|name| !name.contains("full")) {
            let skin = voxel_skin(&mesh, &skeleton, &surface(grid), &kind(&case, name));
            case.check(&format!("out.{name}_skin"), skin.weights);
            let distances = skin.distances.into_iter().map(|d| if d.is_finite() { d } else { -1.0 });
            case.check(&format!("out.{name}_vertex_dist"), distances);
            case.elsewhere(&format!("out.{name}_joint_nodes"), "told by the distances");
        }
        full(&case, &mesh, &skeleton, grid);
        case.done();
    }
}

/// What a kind of skin changes of the case's config: the kernel of its name, or what the config says of the name in
/// words ("vertex_query 27, alpha 0.3").
fn kind(case: &Golden, name: &str) -> VoxelSkinConfig {
    let said = case.config(name).as_str().unwrap_or_default();
    let number = |key: &str| {
        let said = said.split(", ").find_map(|part| part.strip_prefix(key)?.trim().parse().ok());
        said.unwrap_or_else(|| case.number(key))
    };
    assert!(number("grid_query") >= 7.0, "{}: {name}: each cell is joined to those beside it", case.name);
    let kernel = match name {
        "exp" => Kernel::Exp,
        _ => Kernel::Square { alpha: number("alpha") },
    };
    VoxelSkinConfig {
        vertices_per_cell: number("vertex_query") as usize,
        cell_cost: number("grid_weight"),
        link: 1.001 * number("link_dis"),
        kernel,
        ..VoxelSkinConfig::unirig()
    }
}

/// From the mesh to the weights, with cells by the surface and by depth images.
fn full(case: &Golden, mesh: &Mesh, skeleton: &Skeleton, grid: usize) {
    let config = kind(case, "square");
    let at = |voxels: &Voxels| voxel_skin(mesh, skeleton, voxels, &config).weights;
    let surface = |grid| fill(&shell(mesh, &Lattice::unirig(mesh, grid)), Between::Two);
    case.check("out.full_open3d_skin", at(&surface(grid)));
    case.check("out.full_pyrender_skin", at(&by_depth(mesh, grid)));
}

fn bounds(points: &[[f32; 3]]) -> ([f64; 3], [f64; 3]) {
    let pick = |f: fn(f64, f64) -> f64, start: f64| {
        std::array::from_fn(|k| points.iter().map(|p| f64::from(p[k])).fold(start, f))
    };
    (pick(f64::min, f64::INFINITY), pick(f64::max, f64::NEG_INFINITY))
}

fn close(case: &Golden, name: &str, got: &[f32], most: f64) {
    let want = case.values(name);
    assert!(got.iter().zip(want).all(|(g, w)| (f64::from(*g) - w).abs() <= most), "{}: {name}", case.name);
    case.elsewhere(name, "within rounding of its own");
}

/// Middles of cells, as sets.
fn cells(case: &Golden, name: &str, got: &Voxels) {
    let lattice = got.lattice();
    let wanted: BTreeSet<_> =
        case.values(name).as_chunks::<3>().0.iter().map(|p| lattice.find(*p).expect("a cell")).collect();
    let got: BTreeSet<_> = got.places().collect();
    let differ: Vec<_> = got.symmetric_difference(&wanted).collect();
    assert!(differ.is_empty(), "{}: {name}: {} of {}: {differ:?}", case.name, differ.len(), wanted.len());
    case.elsewhere(name, "equal as sets");
}
