//! What holds for any augmentation of any rig: small wild ones, generated creatures, real and hard files.

use std::path::{Path, PathBuf};

use rayon::prelude::*;
use riglab_asset::{ImportOptions, import, is_rig_file};
use riglab_augment::{
    Augmented, AxesConfig, CubeConfig, DeleteConfig, DiscretiseConfig, FlipConfig, JitterConfig, JointNoiseConfig,
    PartConfig, PoseConfig, Recipe, ReconnectConfig, RotateConfig, ScaleConfig, Shift, TrimConfig, TurnConfig, about,
};
use riglab_core::{
    Collider, HumanBone, Humanoid, Joint, JointId, Mesh, Rig, Shape, Skeleton, SkinWeights, Spring, SpringJoint,
    Springs, Swing, skin,
};
use riglab_random::{Draw, Stream, stream};
use riglab_synth::{Options, creatures};

/// Any recipe: each step off, sometimes or always, with ranges up to what is allowed.
fn any_recipe(random: &mut Stream) -> Recipe {
    let p = |random: &mut Stream| [0.0, 0.5, 1.0][random.below(3)];
    let recipe = Recipe {
        trim: TrimConfig { enabled: random.chance(0.5) },
        delete: DeleteConfig { probability: p(random), up_to: random.unit(), subtrees: 0.5 },
        part: PartConfig { probability: p(random), keep: random.unit(), at_least: 0.5 * random.unit() },
        reconnect: ReconnectConfig { probability: p(random), share: random.unit(), up_to: random.chance(0.5) },
        pose: PoseConfig {
            probability: p(random),
            degrees: random.within(0.0, 180.0),
            scale: [0.5, random.within(0.5, 2.0)],
        },
        scale: ScaleConfig { probability: p(random), range: [0.01, 100.0], uniform: random.chance(0.2) },
        turn_x: TurnConfig { probability: p(random), degrees: vec![90.0, 33.0] },
        turn_y: TurnConfig { probability: p(random), degrees: vec![-180.0] },
        turn_z: TurnConfig { probability: p(random), degrees: vec![90.0] },
        flip: FlipConfig { probability: [p(random), 0.5, 0.5], keep_winding: random.chance(0.5) },
        rotate: RotateConfig { probability: p(random), degrees: random.within(0.0, 180.0) },
        axes: AxesConfig { probability: p(random) },
        cube: CubeConfig {
            enabled: random.chance(0.7),
            scale_probability: p(random),
            scale: [0.01, random.within(0.1, 100.0)],
            shift_probability: p(random),
            shift: if random.chance(0.5) { Shift::Inside } else { Shift::UpTo(0.5) },
            ..CubeConfig::default()
        },
        jitter: JitterConfig {
            probability: p(random),
            sigma: random.unit(),
            normal_sigma: p(random),
            ..JitterConfig::default()
        },
        joint_noise: JointNoiseConfig { probability: p(random), sigma: random.unit(), clip: 0.1 },
        discretise: DiscretiseConfig { probability: p(random), ..DiscretiseConfig::default() },
    };
    recipe.validate().expect("within what is allowed");
    recipe
}

/// A small rig without sense: any tree, any triangles, points of very different size, joints without
/// weight, human bones and springs.
fn any_rig(random: &mut Stream) -> Rig {
    let size = [1.0, 1e-30, 1e-6, 1e4, 1e20, 3e38][random.below(6)];
    let point = |random: &mut Stream| match random.below(8) {
        0 => [0.0; 3],
        _ => std::array::from_fn(|_| size * random.within(-1.0, 1.0)),
    };
    let (joints, vertices) = (1 + random.below(12), 1 + random.below(30));
    let joint = |j: usize| Joint {
        name: format!("j{j}"),
        parent: (j > 0).then(|| JointId(random.below(j) as u16)),
        head: point(random),
    };
    let skeleton = Skeleton::new((0..joints).map(joint).collect()).unwrap();
    let positions = (0..vertices).map(|_| point(random)).collect();
    let triangles = (0..1 + random.below(30)).map(|_| std::array::from_fn(|_| random.below(vertices) as u32)).collect();
    let weight = |random: &mut Stream| (random.below(joints) as u16, 1e-6 + f64::from(random.unit()).powi(9));
    let mut rows: Vec<Vec<(u16, f64)>> = Vec::new();
    for _ in 0..vertices {
        rows.push((0..1 + random.below(4)).map(|_| weight(random)).collect());
    }
    let rig = Rig::new(skeleton, Mesh::new(positions, triangles).unwrap(), SkinWeights::normalized(rows).unwrap());
    let mut humanoid = Humanoid::default();
    HumanBone::all().take(random.below(55)).for_each(|bone| {
        humanoid.insert(bone, JointId(random.below(joints) as u16));
    });
    let mut ids: Vec<u16> = (0..joints as u16).collect();
    random.shuffled(&mut ids);
    let spring = |ids: &[u16]| {
        let mut ids = ids.to_vec();
        ids.sort_unstable();
        let swing = Swing { hit_radius: size, ..Swing::default() };
        let joints = ids.iter().map(|&j| SpringJoint { joint: JointId(j), tail: Some([size; 3]), swing });
        Spring { joints: joints.collect(), groups: vec![0], center: Some(JointId(ids[0])), ..Spring::default() }
    };
    let ball = |&j: &u16| Collider { joint: JointId(j), shape: Shape::Sphere { center: [size; 3], radius: size } };
    let springs = Springs::new(
        ids.chunks(3).map(spring).collect(),
        ids.iter().map(ball).collect(),
        vec![(0..joints).step_by(2).collect()],
    );
    rig.unwrap().with_humanoid(humanoid).unwrap().with_springs(springs.unwrap()).unwrap()
}

/// The constructors checked the rig; these are the promises besides.
fn check(what: &str, before: &Rig, after: &Augmented) {
    let (rig, motion) = (&after.rig, &after.motion);
    let joints = rig.skeleton().len();
    assert!(joints <= before.skeleton().len() && motion.origins.len() == joints && motion.rest.len() == joints);
    for (new, old) in rig.skeleton().ids().zip(&motion.origins) {
        assert_eq!(rig.skeleton().name(new), before.skeleton().name(*old), "{what}: joints are not those they were");
    }
    assert!(rig.mesh().positions().len() <= before.mesh().positions().len());
    assert!(rig.humanoid().len() <= before.humanoid().len());
    if let Some(normals) = &after.normals {
        assert_eq!(normals.vertices.len(), rig.mesh().positions().len());
        assert_eq!(normals.triangles.len(), rig.mesh().triangles().len());
        for n in normals.vertices.iter().chain(&normals.triangles) {
            assert!((glam::Vec3::from(*n).length() - 1.0).abs() < 1e-3, "{what}: {n:?}");
        }
    }
}

/// A sequence of recipes, the same twice; each result is the next one's rig.
fn sequence(what: &str, rig: Rig, seed: u64, recipes: &[Recipe]) {
    let mut rig = rig;
    for (k, recipe) in recipes.iter().enumerate() {
        let apply = |rig: Rig| recipe.apply(rig, seed, &[k as u64]);
        let after = apply(rig.clone()).unwrap_or_else(|e| panic!("{what}, recipe {k} of seed {seed}: {e}\n{recipe:?}"));
        check(what, &rig, &after);
        assert_eq!(apply(rig).unwrap(), after, "{what}: another result of the same seed");
        rig = after.rig;
    }
}

#[test]
fn any_sequence_of_any_steps_on_any_rig_gives_a_rig() {
    (0..1500u64).into_par_iter().for_each(|seed| {
        let mut random = stream(seed, "any", &[]);
        let rig = any_rig(&mut random);
        let recipes: Vec<_> = (0..4).map(|_| any_recipe(&mut random)).collect();
        sequence("a wild rig", rig, seed, &recipes);
    });
}

#[test]
fn creatures_stay_rigs_under_presets_and_anything() {
    let all = creatures(3, 0..8, &Options::default());
    all.into_par_iter().enumerate().for_each(|(k, asset)| {
        on_rig(&asset.name, asset.rig, k as u64);
    });
}

#[test]
fn real_and_hard_files_stay_rigs_under_presets_and_anything() {
    for (variable, default) in [("RIGLAB_RIGS", "rigs"), ("RIGLAB_RIGS_HARD", "rigs_hard")] {
        let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared").join(default);
        let folder = std::env::var_os(variable).map_or(shared, PathBuf::from);
        let Ok(entries) = std::fs::read_dir(&folder) else {
            println!("skipped: no such folder {} (set {variable})", folder.display());
            continue;
        };
        let mut files: Vec<_> = entries.map(|e| e.unwrap().path()).filter(|p| is_rig_file(p)).collect();
        files.sort();
        let rigs = files.par_iter().enumerate().filter_map(|(k, file)| {
            // Files that are to be refused, and those without a skeleton, are no matter here.
            let rig = import(file, &ImportOptions::default()).ok()?.rig()?.clone();
            on_rig(&file.display().to_string(), rig, k as u64);
            Some(())
        });
        let count = rigs.count();
        println!("{count} rigs of {} files", files.len());
        assert!(count > 0);
    }
}

/// One preset and two wild recipes in a row, by seed.
fn on_rig(what: &str, rig: Rig, seed: u64) {
    let mut random = stream(seed, "on a file", &[]);
    let presets = Recipe::presets();
    let preset = presets[seed as usize % presets.len()].1.clone();
    sequence(what, rig, seed, &[preset, any_recipe(&mut random), any_recipe(&mut random)]);
}

#[test]
fn another_index_is_another_rig() {
    let rig = creatures(1, 0..1, &Options::default()).remove(0).rig;
    for (name, recipe) in Recipe::presets() {
        let of = |seed, index: &[u64]| recipe.apply(rig.clone(), seed, index).unwrap();
        assert_ne!(of(1, &[0]), of(1, &[1]), "{name}");
        assert_ne!(of(1, &[0, 5]), of(1, &[0, 6]), "{name}");
        assert_ne!(of(1, &[0]), of(2, &[0]), "{name}");
    }
}

#[test]
fn a_step_that_is_switched_off_does_not_change_what_others_draw() {
    let rig = creatures(1, 0..1, &Options::default()).remove(0).rig;
    let all = Recipe::unirig_ar();
    let joints = |recipe: &Recipe, k| recipe.apply(rig.clone(), 4, &[k]).unwrap().motion.origins;
    let quiet = Recipe { pose: PoseConfig::default(), jitter: JitterConfig::default(), ..all.clone() };
    let kept: Vec<_> = (0..20).map(|k| joints(&all, k)).collect();
    assert_eq!(kept, (0..20).map(|k| joints(&quiet, k)).collect::<Vec<_>>());
    assert!(kept.iter().any(|k| k.len() < rig.skeleton().len()));
}

#[test]
fn turns_about_one_axis_do_not_change_those_about_another() {
    let rig = creatures(1, 0..1, &Options::default()).remove(0).rig;
    let turn = |degrees: &[f32]| TurnConfig { probability: 0.5, degrees: degrees.to_vec() };
    let (quarters, none) = (turn(&[90.0, 180.0, 270.0]), turn(&[0.0]));
    let world = |recipe: &Recipe, k| recipe.apply(rig.clone(), 4, &[k]).unwrap().motion.world.matrix3;
    let cube = CubeConfig { enabled: false, ..CubeConfig::default() };
    let plain = Recipe { cube, ..Recipe::default() };
    let about_x = Recipe { turn_x: quarters.clone(), ..plain.clone() };
    let about_y = Recipe { turn_y: quarters.clone(), ..plain.clone() };
    let about_z = Recipe { turn_z: quarters, ..plain };
    for k in 0..20 {
        let with_x = |recipe: &Recipe| world(&Recipe { turn_x: none.clone(), ..recipe.clone() }, k);
        let with_y = |recipe: &Recipe| world(&Recipe { turn_y: none.clone(), ..recipe.clone() }, k);
        assert_eq!(world(&about_x, k), with_y(&about_x));
        assert_eq!(world(&about_y, k), with_x(&about_y));
        assert_eq!((world(&about_z, k), world(&about_z, k)), (with_x(&about_z), with_y(&about_z)));
        // Runs that turned about y alone are repeated by these draws.
        let mut random = stream(4, "augment turn", &[k]);
        random.unit();
        let angle = if random.chance(0.5) { [90.0, 180.0, 270.0][random.below(3)] } else { 0.0 };
        assert_eq!(world(&about_y, k), about(1, -angle));
    }
}

#[test]
fn for_networks_rigs_lie_where_the_cube_leaves_them_or_else_in_it() {
    let rig = creatures(1, 0..1, &Options::default()).remove(0).rig;
    let of = |recipe: &Recipe| recipe.apply_in_cube(rig.clone(), 1, &[]).unwrap();
    let longest = |rig: &Rig| rig.bounds().size().into_iter().fold(0.0, f32::max);
    let cube = CubeConfig {
        scale_probability: 1.0,
        scale: [0.5, 0.5],
        shift_probability: 1.0,
        shift: Shift::UpTo(0.1),
        ..CubeConfig::default()
    };
    let scaled = of(&Recipe { cube, ..Recipe::default() });
    assert!((longest(&scaled.rig) - 1.0).abs() < 1e-5 && scaled.rig.bounds().center() != [0.0; 3]);
    let cells = DiscretiseConfig { probability: 1.0, ..DiscretiseConfig::default() };
    let noise = JitterConfig { probability: 1.0, sigma: 0.05, ..JitterConfig::default() };
    let rounded = of(&Recipe { jitter: noise, discretise: cells.clone(), ..Recipe::default() });
    let middle = |x: &f32| (x * 128.0 - 0.5).fract() == 0.0;
    assert!(rounded.rig.skeleton().heads().as_flattened().iter().all(middle));
    let cube = CubeConfig { enabled: false, ..CubeConfig::default() };
    let large =
        Recipe { cube, scale: ScaleConfig { probability: 1.0, range: [3.0, 3.0], uniform: true }, ..Recipe::default() };
    let own = large.apply(rig.clone(), 1, &[]).unwrap();
    let set = of(&large);
    assert!((longest(&own.rig) - 3.0 * longest(&rig)).abs() < 1e-3 && (longest(&set.rig) - 2.0).abs() < 1e-5);
    // What is known of the way there holds, too.
    let moved = set.motion.world.transform_point3a(rig.skeleton().heads()[0].into());
    assert!(moved.distance(set.rig.skeleton().heads()[0].into()) < 1e-5);
}

#[test]
fn the_default_only_normalises() {
    let rig = creatures(1, 0..1, &Options::default()).remove(0).rig;
    let after = Recipe::default().apply(rig.clone(), 1, &[]).unwrap().rig;
    let wanted = rig.normalized().0;
    let close = |a: &[[f32; 3]], b: &[[f32; 3]]| {
        a.as_flattened().iter().zip(b.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6)
    };
    assert!(close(after.mesh().positions(), wanted.mesh().positions()));
    assert!(close(after.skeleton().heads(), wanted.skeleton().heads()));
    assert_eq!((after.weights(), after.mesh().triangles()), (wanted.weights(), wanted.mesh().triangles()));
}

#[test]
fn a_mirrored_creature_keeps_its_outside_and_changes_sides() {
    let rig = creatures(1, 0..1, &Options::default()).remove(0).rig;
    let mut humanoid = Humanoid::default();
    humanoid.insert("leftHand".parse().unwrap(), JointId(3));
    let rig = rig.with_humanoid(humanoid).unwrap();
    let flip = FlipConfig { probability: [1.0, 0.0, 0.0], keep_winding: false };
    let after = Recipe { flip, ..Recipe::default() }.apply(rig.clone(), 1, &[]).unwrap().rig;
    assert_eq!(after.humanoid().joint("rightHand".parse().unwrap()), Some(JointId(3)));
    let volume = |mesh: &Mesh| -> f32 {
        let of = |t| glam::Vec3::from(mesh.corners(t)[0]).dot(mesh.area_vector(t).into());
        (0..mesh.triangles().len()).map(of).sum()
    };
    assert!(volume(rig.mesh()) > 0.0 && volume(after.mesh()) > 0.0);
}

#[test]
fn clips_move_an_augmented_rig_as_they_moved_the_rig() {
    let rig = creatures(2, 0..1, &Options::default()).remove(0).rig;
    let joints = rig.skeleton().len();
    let mut random = stream(1, "clip", &[]);
    let map = |random: &mut Stream| {
        let turn = riglab_augment::rotation(std::array::from_fn(|_| random.within(-1.0, 1.0)));
        let [x, y, z] = turn.to_cols_array_2d();
        [x, y, z, std::array::from_fn(|_| random.unit())]
    };
    let maps = (0..2 * joints).map(|_| map(&mut random)).collect();
    let clip = riglab_core::Clip::new("dance".into(), 30.0, joints, maps).unwrap();
    let recipe = Recipe {
        pose: PoseConfig { probability: 1.0, ..PoseConfig::default() },
        rotate: RotateConfig { probability: 1.0, degrees: 90.0 },
        scale: ScaleConfig { probability: 1.0, ..ScaleConfig::default() },
        ..Recipe::default()
    };
    let after = recipe.apply(rig.clone(), 1, &[]).unwrap();
    let (old, new) =
        (skin(&rig, &clip.frame(1)).unwrap(), skin(&after.rig, &after.clip(&clip).unwrap().frame(1)).unwrap());
    let mut compared = 0;
    for v in 0..old.len() {
        // Where several joints hold a vertex, the mean of the posed places has no way back.
        if rig.weights().row(v).len() == 1 {
            let want = after.motion.world.transform_point3(old[v].into());
            assert!((want - glam::Vec3::from(new[v])).length() < 1e-4, "vertex {v}: {:?}, not {want}", new[v]);
            compared += 1;
        }
    }
    assert!(compared > 10, "{compared}");
    let short = riglab_core::Clip::new("short".into(), 30.0, 1, clip.maps()[..1].to_vec()).unwrap();
    assert!(after.clip(&short).is_err());
}

#[test]
fn an_asset_comes_back_to_where_it_was_with_its_motions() {
    let mut asset = creatures(2, 0..1, &Options::default()).remove(0);
    let large = riglab_core::Similarity { scale: 100.0, shift: [30.0, -20.0, 500.0] };
    let joints = asset.rig.skeleton().len();
    let moved = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [0.1, 0.2, 0.3]];
    let clip = riglab_core::Clip::new("turn".into(), 30.0, joints, vec![moved; joints]).unwrap();
    asset.clips = vec![clip.transformed(large).unwrap()];
    asset.rig = asset.rig.transformed(large).unwrap();
    let same = Recipe::default().apply_to_asset(asset.clone(), 1, &[]).unwrap();
    assert_eq!((&same.name, &same.provenance), (&asset.name, &asset.provenance));
    let posed = |a: &riglab_core::Asset| skin(&a.rig, &a.clips[0].frame(0)).unwrap();
    for (old, new) in [
        (asset.rig.mesh().positions().to_vec(), same.rig.mesh().positions().to_vec()),
        (asset.rig.skeleton().heads().to_vec(), same.rig.skeleton().heads().to_vec()),
        (posed(&asset), posed(&same)),
    ] {
        let off = old.iter().zip(&new).map(|(a, b)| (glam::Vec3::from(*a) - glam::Vec3::from(*b)).length());
        assert!(off.fold(0.0, f32::max) < 1e-3, "of a creature 200 units long");
    }
    // One that is wider than the greatest number comes back, too; what a step takes beyond it is refused.
    let wide = asset.rig.normalized().0;
    let bounds = wide.bounds();
    let reach = f32::MAX / bounds.min.iter().chain(&bounds.max).fold(1.0f32, |most, x| most.max(x.abs()));
    for share in [0.9, 0.5] {
        let rig = wide.transformed(riglab_core::Similarity { scale: share * reach, shift: [0.0; 3] }).unwrap();
        let huge = riglab_core::Asset { rig, clips: Vec::new(), ..asset.clone() };
        let same = Recipe::default().apply_to_asset(huge.clone(), 1, &[]).unwrap();
        let off = |a: &[[f32; 3]], b: &[[f32; 3]]| {
            a.as_flattened()
                .iter()
                .zip(b.as_flattened())
                .fold(0.0f32, |most, (a, b)| most.max((a / reach - b / reach).abs()))
        };
        assert!(off(same.rig.mesh().positions(), huge.rig.mesh().positions()) < 1e-5, "{share}");
        let opened = Recipe::default().apply(huge.rig.clone(), 1, &[]).unwrap().rig.bounds().size();
        assert!((opened.into_iter().fold(0.0, f32::max) - 2.0).abs() < 1e-4, "{share}: {opened:?}");
        let _ = Recipe::unirig_starred().apply_to_asset(huge, 1, &[]);
    }
    let starred = Recipe::unirig_starred().apply_to_asset(asset.clone(), 1, &[]).unwrap();
    assert_ne!(starred.rig.skeleton().heads(), asset.rig.skeleton().heads());
    assert_eq!(starred.rig.skeleton().names(), asset.rig.skeleton().names());
}
