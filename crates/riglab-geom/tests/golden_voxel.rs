//! Voxels and the weights of their graph against values recorded from the public code of SkinTokens and
//! UniRig.

#[path = "common/golden.rs"]
mod golden;

use std::collections::BTreeSet;

use golden::{Golden, golden};
use riglab_core::{Joint, JointId, Mesh, Skeleton};
use riglab_geom::geodesic::{Kernel, VoxelSkin, VoxelSkinConfig, voxel_skin};
use riglab_geom::voxel::{Between, Lattice, Voxels, by_depth, fill, shell};

fn places(case: &Golden, name: &str) -> Vec<[usize; 3]> {
    case.indices(name).as_chunks::<3>().0.to_vec()
}

/// A star where the case has no tree: only positions are looked at then.
fn skeleton(case: &Golden, group: &str, heads: Vec<[f32; 3]>) -> Skeleton {
    let recorded = case.input(group, "parents");
    let parent = |j: usize| match case.has(&recorded) {
        true => case.values(&recorded)[j],
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
        for group in case.groups() {
            skintokens_group(&case, &group);
        }
        case.done();
    }
}

fn skintokens_group(case: &Golden, group: &str) {
    let (name, input) = (format!("out.{group}"), |what: &str| case.input(group, what));
    let origin = case.setting(group, "origin").expect("a corner");
    let lattice = Lattice {
        origin: std::array::from_fn(|k| origin[k].as_f64().expect("a corner")),
        cell: case.number_of(group, "voxel_size"),
        size: [case.number_of(group, "grid") as usize; 3],
    };
    let given = || Voxels::new(lattice, places(case, &input("grid_index")));
    match group.split('_').next().unwrap_or(group) {
        "square" | "exp" => {
            let has = |word: &str| group.split('_').any(|w| w == word);
            let known = ["square", "exp", "segments", "demo", "bug"];
            let unknown = |word: &&str| !known.contains(word) && word.parse::<f64>().is_err();
            let unknown: Vec<&str> = group.split('_').filter(unknown).collect();
            assert!(unknown.is_empty(), "{}: unknown output `{group}`: {unknown:?}", case.name);
            assert!(case.number_of(group, "grid_query") >= 27.0, "{}: a cell is joined to all around it", case.name);
            // A number in the name is that of the kernel.
            let alpha = group.split('_').find_map(|word| word.parse().ok());
            let alpha = alpha.unwrap_or_else(|| case.number_of(group, "alpha"));
            let config = VoxelSkinConfig {
                kernel: if has("exp") { Kernel::Exp } else { Kernel::Square { alpha } },
                vertices_per_cell: case.number_of(group, "vertex_query") as usize,
                cell_cost: case.number_of(group, "grid_weight"),
                link: case.number_of(group, "link_dis"),
                bones: has("segments"),
                ..VoxelSkinConfig::skintokens()
            };
            let skeleton = skeleton(case, group, case.points(&input("joints")));
            let mesh = case.mesh_of(group);
            let given = given();
            let weights = |skeleton: &Skeleton, voxels: &Voxels, config: &VoxelSkinConfig| {
                voxel_skin(&mesh, skeleton, voxels, config).weights
            };
            if !has("bug") {
                case.check(&name, weights(&skeleton, &given, &config));
                return;
            }
            // The demo's fault: numbers of cells are taken for their middles, so none is near the mesh.
            let far = Voxels::new(Lattice { origin: [-0.5; 3], cell: 1.0, ..lattice }, given.places());
            let config = VoxelSkinConfig { reach: config.reach * lattice.cell, ..config };
            let all = leaning(&mesh, &skeleton).into_iter().map(|skeleton| weights(&skeleton, &far, &config));
            let off =
                |got: &Vec<f64>| got.iter().zip(case.values(&name)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            let nearest = all.min_by(|a, b| off(a).total_cmp(&off(b)));
            case.check(&name, nearest.expect("a skeleton"));
        }
        "fill" => {
            let between = match group.split('_').nth(1) {
                Some("rigid") => Between::All,
                Some("loose") => Between::Two,
                _ => panic!("{}: unknown output `{group}`", case.name),
            };
            let filled = fill(&Voxels::new(lattice, places(case, &input("shell"))), between);
            case.check(&name, filled.places().flatten().map(|x| x as f64));
        }
        "inside" => {
            let query = case.values(&input("query")).as_chunks::<3>().0;
            let given = given();
            case.check(&name, query.iter().map(|p| f64::from(u8::from(given.contains(*p)))));
        }
        "pc" => case.check(&name, given().places().flat_map(|place| lattice.center(place))),
        _ => panic!("{}: unknown output `{group}`", case.name),
    }
}

/// The skeletons whose joints lean to one each of the vertices that are nearest to them: which of several equally near
/// ones a joint counts from is the search tree's choice, and the head itself costs nothing.
fn leaning(mesh: &Mesh, skeleton: &Skeleton) -> Vec<Skeleton> {
    let mut all: Vec<Vec<Joint>> = vec![Vec::new()];
    for joint in skeleton.ids() {
        let (head, parent) = (glam::Vec3::from(skeleton.head(joint)), skeleton.parent(joint));
        let points = || mesh.positions().iter().map(|p| glam::Vec3::from(*p));
        let least = points().map(|p| p.distance(head)).fold(f32::INFINITY, f32::min);
        let nearest: Vec<_> = points().filter(|p| p.distance(head) <= least + 1e-6).collect();
        let name = skeleton.name(joint);
        let leaning = |p: &glam::Vec3| Joint { name: name.into(), parent, head: head.lerp(*p, 1e-3).into() };
        let ways = all.iter().flat_map(|before| {
            nearest.iter().map(|p| before.iter().cloned().chain([leaning(p)]).collect::<Vec<_>>()).collect::<Vec<_>>()
        });
        all = ways.collect();
        assert!(all.len() <= 4096, "too many vertices are equally near");
    }
    all.into_iter().map(|joints| Skeleton::new(joints).expect("a tree")).collect()
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
        let skeleton = skeleton(&case, "", case.points("in.joints").into_iter().map(normal).collect());
        for group in case.groups() {
            let name = format!("out.{group}");
            if group == "norm_vertices" {
                let points = mesh.positions().as_flattened().iter().map(|x| f64::from(*x));
                case.check_within(&name, points, (1e-6, 0.0));
            } else if let Some(kind) = group.strip_suffix("_cells") {
                cells(&case, &name, &taken(&case, &mesh, kind));
            } else if let Some(kind) = group.strip_suffix("_skin") {
                case.check(&name, skin(&case, &mesh, &skeleton, kind).weights);
            } else if let Some(kind) = group.strip_suffix("_vertex_dist") {
                let distances = skin(&case, &mesh, &skeleton, kind).distances.into_iter();
                case.check(&name, distances.map(|d| if d.is_finite() { d } else { -1.0 }));
            } else if let Some(kind) = group.strip_suffix("_joint_nodes") {
                nodes(&case, &name, &mesh, &skeleton, &used(&case, kind));
            } else {
                panic!("{}: unknown output `{group}`", case.name);
            }
        }
        case.done();
    }
}

/// The grid at the end of a name such as `open3d_g20`, and what stands before it.
fn grid_of(name: &str) -> (&str, Option<usize>) {
    match name.rsplit_once('_') {
        Some((rest, grid)) if grid.starts_with('g') && grid[1..].parse::<usize>().is_ok() => {
            (rest, grid[1..].parse().ok())
        }
        _ => (name, None),
    }
}

/// The cells that those of skins are: "out.open3d_g20_cells for ...".
fn used(case: &Golden, kind: &str) -> String {
    let told = case.config("cells_used").as_str().and_then(|text| text.split("out.").nth(1)?.split("_cells").next());
    let (from, grid) = grid_of(told.unwrap_or("open3d_g20"));
    let grid = grid_of(kind).1.or(grid).expect("a grid");
    let from = if kind.contains("pyrender") { "pyrender" } else { from };
    format!("{from}_g{grid}")
}

/// The cells of a kind such as `open3d_g20`.
fn taken(case: &Golden, mesh: &Mesh, kind: &str) -> Voxels {
    match grid_of(kind) {
        ("open3d", Some(grid)) => fill(&shell(mesh, &Lattice::unirig(mesh, grid)), Between::Two),
        ("pyrender", Some(grid)) => by_depth(mesh, grid),
        _ => panic!("{}: unknown cells `{kind}`", case.name),
    }
}

/// A kind of skin. What its name says of cells is left out of what the config is asked for; `full` ones have the
/// config's own kernel.
fn skin(case: &Golden, mesh: &Mesh, skeleton: &Skeleton, name: &str) -> VoxelSkin {
    let plain: Vec<&str> = grid_of(name).0.split('_').filter(|w| !["full", "open3d", "pyrender"].contains(w)).collect();
    let plain = if plain.is_empty() { "square".to_owned() } else { plain.join("_") };
    voxel_skin(mesh, skeleton, &taken(case, mesh, &used(case, name)), &kind(case, &plain))
}

/// What a kind of skin changes of the case's config: the kernel of its name, or what the config says of the name in
/// words ("vertex_query 27, alpha 0.3").
fn kind(case: &Golden, name: &str) -> VoxelSkinConfig {
    let said = case.config(name);
    let known = !said.is_null() || ["exp", "square"].contains(&name);
    assert!(known, "{}: unknown output `{name}`", case.name);
    let number = |key: &str| case.number_of(name, key);
    assert!(number("grid_query") >= 7.0, "{}: {name}: each cell is joined to those beside it", case.name);
    let exp = name.split('_').any(|word| word == "exp") || said.as_str().is_some_and(|text| text.contains("exp"));
    VoxelSkinConfig {
        vertices_per_cell: number("vertex_query") as usize,
        cell_cost: number("grid_weight"),
        link: 1.001 * number("link_dis"),
        kernel: if exp { Kernel::Exp } else { Kernel::Square { alpha: number("alpha") } },
        ..VoxelSkinConfig::unirig()
    }
}

/// The node of the graph that each joint is tied to, vertices first, then cells as they are recorded: none may be
/// nearer. The search itself names no nodes, and of equally near ones the code may take another.
fn nodes(case: &Golden, name: &str, mesh: &Mesh, skeleton: &Skeleton, cells: &str) {
    let listed = format!("out.{cells}_cells");
    if !case.has(&listed) {
        case.elsewhere(name, "numbers of cells that are not recorded");
        return;
    }
    let found = taken(case, mesh, cells);
    let lattice = found.lattice();
    let positions = mesh.positions().iter().map(|p| p.map(f64::from));
    let recorded = case.values(&listed).as_chunks::<3>().0.iter();
    let recorded = recorded.map(|p| lattice.center(lattice.find(*p).expect("a cell")));
    let nodes: Vec<[f64; 3]> = positions.clone().chain(recorded).collect();
    let all: Vec<[f64; 3]> = positions.chain(found.places().map(|place| lattice.center(place))).collect();
    let wanted = case.values(name);
    assert_eq!(wanted.len(), skeleton.len(), "{}: {name}", case.name);
    for (head, node) in skeleton.heads().iter().zip(wanted) {
        let apart = |p: &[f64; 3]| (0..3).map(|k| (p[k] - f64::from(head[k])).powi(2)).sum::<f64>().sqrt();
        let least = all.iter().map(apart).fold(f64::INFINITY, f64::min);
        assert!(apart(&nodes[*node as usize]) <= least + 1e-6, "{}: {name}: {node}", case.name);
    }
    case.elsewhere(name, "none is nearer");
}

fn bounds(points: &[[f32; 3]]) -> ([f64; 3], [f64; 3]) {
    let pick = |f: fn(f64, f64) -> f64, start: f64| {
        std::array::from_fn(|k| points.iter().map(|p| f64::from(p[k])).fold(start, f))
    };
    (pick(f64::min, f64::INFINITY), pick(f64::max, f64::NEG_INFINITY))
}

/// Middles of cells, as sets.
fn cells(case: &Golden, name: &str, got: &Voxels) {
    let lattice = got.lattice();
    let cell = |p: &[f64; 3]| {
        let cell = lattice.find(*p).expect("a cell");
        let off = (0..3).map(|k| (lattice.center(cell)[k] - p[k]).abs()).fold(0.0, f64::max);
        assert!(off <= 1e-6, "{}: {name}: {p:?} is no middle", case.name);
        cell
    };
    let wanted: BTreeSet<_> = case.values(name).as_chunks::<3>().0.iter().map(cell).collect();
    let got: BTreeSet<_> = got.places().collect();
    let differ: Vec<_> = got.symmetric_difference(&wanted).collect();
    assert!(differ.is_empty(), "{}: {name}: {} of {}: {differ:?}", case.name, differ.len(), wanted.len());
    case.elsewhere(name, "equal as sets");
}
