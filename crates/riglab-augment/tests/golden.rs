//! Every augmentation against values recorded from the public code of SkinTokens and UniRig, with the
//! recorded draws.

#[path = "../../riglab-geom/tests/common/golden.rs"]
mod golden;

use glam::{Affine3A, Mat3A, Vec3A};
use golden::{Golden, golden, table};
use riglab_augment::{
    Augmented, DiscretiseConfig, Draft, LinearParts, Noise, about, delete, into_cube, keep_part, linear, pose,
    reconnect, rotation, signed_axes, trim, unit,
};
use riglab_core::{JointId, Rig, Spring, SpringJoint, Springs, Swing};
use riglab_geom::{normals_by_angle, triangle_normals};

#[test]
fn skintokens() {
    for case in golden("skintokens", "augment") {
        for group in case.groups() {
            skintokens_group(&case, &group);
        }
        case.done();
    }
}

fn skintokens_group(case: &Golden, group: &str) {
    let frames = frames(case, "in.matrix_local");
    let heads: Vec<[f32; 3]> = frames.iter().map(|f| f.translation.into()).collect();
    let rig = || case.rig(&heads, "in.skin");
    let number = |name: &str| case.values(name)[0] as f32;
    let range = || {
        let into = case.config("affine.normalize_into").as_array().expect("a range");
        [into[0].as_f64().unwrap() as f32, into[1].as_f64().unwrap() as f32]
    };
    match group {
        "affine" => compare(case, group, &done(rig(), |d| into_cube(d, range(), 1.0, [0.0; 3]))),
        "affine_rand" => {
            let (scale, shift) = (number("in.affine_rand.scale"), case.points("in.affine_rand.shift")[0]);
            compare(case, group, &done(rig(), |d| into_cube(d, range(), scale, shift)));
        }
        "linear" => {
            let angles = case.points("in.linear.angles_deg_xyz")[0];
            let perm = case.indices("in.linear.perm");
            let flip =
                |axis: &str| if case.config(&format!("linear.random_flip_{axis}_p")) == 1.0 { -1.0 } else { 1.0 };
            let parts = LinearParts {
                rotate: rotation(case.points("in.linear.rotvec")[0]),
                flip: Mat3A::from_diagonal(["x", "y", "z"].map(flip).into()),
                turns: std::array::from_fn(|axis| about(axis, -angles[axis])),
                scale: Mat3A::from_diagonal(case.points("in.linear.scale")[0].into()),
                axes: signed_axes([perm[0], perm[1], perm[2]], case.points("in.linear.sign")[0]),
            };
            compare(case, group, &done(rig(), |d| linear(d, parts.matrix(), true)));
        }
        "delete" => {
            let keep = marked(case.indices("in.delete.selected"), heads.len());
            compare(case, group, &done(rig(), |d| delete(d, &keep)));
        }
        "drop" => {
            let keep: Vec<bool> = case.values("in.drop.draws").iter().map(|x| *x < case.number("drop.rate")).collect();
            compare(case, group, &done(rig(), |d| keep_part(d, &keep)));
        }
        "collapse" => {
            let rate = case.number("collapse.rate");
            let keep: Vec<bool> = case.values("in.collapse.draws").iter().map(|x| *x >= rate).collect();
            compare(case, group, &done(rig(), |d| reconnect(d, &keep)));
        }
        "trim" => compare(case, group, &done(case.rig(&heads, "in.trim.skin"), trim)),
        "lbs" => {
            let (turns, scales) = (case.points("in.lbs.rotvec"), case.floats("in.lbs.scale"));
            let local = turns
                .iter()
                .zip(&scales)
                .map(|(v, s)| Affine3A { matrix3: rotation(*v) * *s, translation: Vec3A::ZERO });
            let local: Vec<_> = frames.iter().zip(local).map(|(f, b)| in_world(f, b)).collect();
            let result = done(rig(), |d| assert!(pose(d, &local)));
            case.check_points("out.lbs.vertices", result.rig.mesh().positions());
            case.check("out.lbs.matrix_local", matrices(result.motion.rest.iter().zip(&frames).map(|(r, f)| *r * *f)));
        }
        "jitter" => {
            let mut noisy = noisy(case, "vertex", "vertex_noise", rig().mesh().positions());
            case.check_points("out.jitter.vertices", &noisy);
            noisy = noisy_normals(case);
            case.check_points("out.jitter.vertex_normals", &noisy);
        }
        "normalize" => {
            let normals: Vec<_> = noisy_normals(case).into_iter().map(unit).collect();
            case.check_points("out.normalize.vertex_normals", &normals);
        }
        "discrete" => {
            let config = DiscretiseConfig { cells: case.number("discrete") as u32, ..DiscretiseConfig::default() };
            let joints: Vec<_> = heads.iter().map(|h| h.map(|x| config.rounded(x))).collect();
            case.check_points("out.discrete.joints", &joints);
        }
        "vertex_normals" => case.check_points("out.vertex_normals", &normals_by_angle(rig().mesh())),
        "face_normals" => case.check_points("out.face_normals", &triangle_normals(rig().mesh())),
        "order" => {
            for part in ["parents", "skin"] {
                case.elsewhere(&format!("out.order.{part}"), "joints of a rig stay in an order of parents first");
            }
        }
        "dfs_order" => case.elsewhere("out.dfs_order", "the order of joints is the tokenizer's"),
        other => panic!("{}: unknown output `{other}`", case.name),
    }
}

fn noisy(case: &Golden, what: &str, draws: &str, points: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let strength = case.values(&format!("in.jitter.scale_{what}"))[0];
    let of = |key: &str| (case.number(&format!("jitter.{what}_{key}")) * strength) as f32;
    let noise = Noise { sigma: of("sigma"), clip: of("clip") };
    let draws = case.points(&format!("in.jitter.{draws}"));
    points.iter().zip(draws).map(|(p, d)| noise.on(*p, d)).collect()
}

fn noisy_normals(case: &Golden) -> Vec<[f32; 3]> {
    noisy(case, "normal", "vertex_normal_noise", &normals_by_angle(&case.mesh()))
}

#[test]
fn unirig() {
    for case in golden("unirig", "transforms") {
        for group in case.groups() {
            unirig_group(&case, &group);
        }
        case.done();
    }
}

fn unirig_group(case: &Golden, group: &str) {
    let heads = case.points("in.joints");
    let rig = || with_tails(case.rig(&heads, "in.skin"), &case.points("in.tails"));
    let (kind, rest) = group.split_once('_').unwrap_or((group, ""));
    match kind {
        "affine" => {
            let numbers = numbers(case.config(group).as_str().expect("words"));
            let (into, scale, shift) = match (rest, numbers.as_slice()) {
                ("" | "unit", [low, high, ..]) => ([*low, *high], 1.0, 0.0),
                ("fixed_scale_shift", [scale, shift]) => ([-1.0, 1.0], *scale, *shift),
                _ => panic!("{}: unknown output `{group}`", case.name),
            };
            compare(case, group, &done(rig(), |d| into_cube(d, into, scale, [shift; 3])));
        }
        "linear" => {
            let mut parts = LinearParts {
                rotate: Mat3A::IDENTITY,
                flip: Mat3A::IDENTITY,
                turns: [Mat3A::IDENTITY; 3],
                scale: Mat3A::IDENTITY,
                axes: Mat3A::IDENTITY,
            };
            let mut words = rest.split('_');
            while let Some(word) = words.next() {
                let axis = |letter: &str| "xyz".find(letter).unwrap_or_else(|| panic!("{}: `{group}`", case.name));
                match word {
                    "flip" => {
                        let mut signs = [1.0; 3];
                        words.next().expect("axes").chars().for_each(|c| signs[axis(&c.to_string())] = -1.0);
                        parts.flip = Mat3A::from_diagonal(signs.into());
                    }
                    "scale" => {
                        let scale = *numbers(case.config("linear").as_str().expect("words")).last().expect("a scale");
                        parts.scale = Mat3A::from_diagonal([scale; 3].into());
                    }
                    turn => {
                        let (letter, degrees) = turn.split_at(1);
                        let degrees: f32 = degrees.parse().unwrap_or_else(|_| panic!("{}: `{group}`", case.name));
                        parts.turns[axis(letter)] = about(axis(letter), -degrees);
                    }
                }
            }
            compare(case, group, &done(rig(), |d| linear(d, parts.matrix(), true)));
        }
        "collapse" => {
            let keep = case.config("collapse_keep").as_array().expect("joints").iter();
            let keep = marked(keep.map(|j| j.as_u64().unwrap() as usize).collect(), heads.len());
            compare(case, group, &done(rig(), |d| reconnect(d, &keep)));
        }
        "drop" => {
            let keep = numbers(case.config("drop_part_keep").as_str().expect("words"));
            let keep = marked(keep.into_iter().map(|j| j as usize).collect(), heads.len());
            let rig = with_tails(case.rig(&heads, "in.skin_sparse"), &case.points("in.tails"));
            compare(case, group, &done(rig, |d| keep_part(d, &keep)));
        }
        "joint" => {
            let config = DiscretiseConfig::default();
            let round =
                |name: &str| -> Vec<_> { case.points(name).iter().map(|h| h.map(|x| config.rounded(x))).collect() };
            case.check_points("out.joint_discrete.joints", &round("in.joints"));
            case.check_points("out.joint_discrete.tails", &round("in.tails"));
            case.check("out.joint_discrete.parents", case.values("in.parents").to_vec());
        }
        "tail" => case.elsewhere(&format!("out.{group}.tails"), "a rig's joints have no tails of their own"),
        "sample" => {
            for part in ["face", "face_weight", "normals", "points", "skin"] {
                case.elsewhere(&format!("out.sample.{part}"), "see the sampler's tests");
            }
        }
        other => panic!("{}: unknown output `{other}` of {group}", case.name),
    }
}

#[test]
fn poses() {
    for case in golden("unirig", "lbs_fk") {
        let (heads, frames) = (case.points("in.joints"), frames(&case, "in.matrix_local"));
        let basis = self::frames(&case, "in.matrix_basis");
        let posed = |local: Vec<Affine3A>| {
            let rig = with_tails(case.rig(&heads, "in.skin"), &case.points("in.tails"));
            done(rig, |d| assert!(pose(d, &local)))
        };
        for group in case.groups() {
            match group.as_str() {
                "posed" => {
                    compare(&case, &group, &posed(frames.iter().zip(&basis).map(|(f, b)| in_world(f, *b)).collect()))
                }
                "posed_no_rest_rotation" => compare(&case, &group, &posed(basis.clone())),
                "pose_matrix" => {
                    let result = posed(frames.iter().zip(&basis).map(|(f, b)| in_world(f, *b)).collect());
                    case.check(
                        "out.pose_matrix",
                        matrices(result.motion.rest.iter().zip(&frames).map(|(r, f)| *r * *f)),
                    );
                }
                "pose_matrix_no_rest_rotation" => {
                    let at = |h: &[f32; 3]| Affine3A::from_translation((*h).into());
                    let rest = posed(basis.clone()).motion.rest;
                    case.check(
                        "out.pose_matrix_no_rest_rotation",
                        matrices(rest.iter().zip(&heads).map(|(r, h)| *r * at(h))),
                    );
                }
                "basis_rotation" => {
                    let rows =
                        case.points("in.rotvec").into_iter().flat_map(|v| rotation(v).transpose().to_cols_array());
                    case.check("out.basis_rotation", rows.map(f64::from));
                }
                name => {
                    let known = ["lbs_unnormalised", "matrix_quaternion_wxyz", "quaternion_matrix", "quaternion_wxyz"];
                    assert!(known.contains(&name), "{}: unknown output `{name}`", case.name);
                    case.elsewhere(
                        &format!("out.{name}"),
                        "no augmentation: weights of a rig sum to 1, turns are matrices",
                    );
                }
            }
        }
        case.done();
    }
}

/// Checks whatever is recorded of a result.
fn compare(case: &Golden, group: &str, result: &Augmented) {
    let (rig, motion) = (&result.rig, &result.motion);
    let prefix = format!("out.{group}.");
    for part in [
        "vertices",
        "joints",
        "parents",
        "faces",
        "skin",
        "tails",
        "matrix",
        "matrix_local",
        "vertex_normals",
        "face_normals",
    ] {
        let name = format!("{prefix}{part}");
        if !case.has(&name) {
            continue;
        }
        let flat = |points: &[[f32; 3]]| points.as_flattened().iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
        let got: Vec<f64> = match part {
            "vertices" => flat(rig.mesh().positions()),
            "joints" => flat(rig.skeleton().heads()),
            "parents" => rig.skeleton().parents().iter().map(|p| p.map_or(-1.0, |p| f64::from(p.0))).collect(),
            "faces" => rig.mesh().triangles().as_flattened().iter().map(|v| f64::from(*v)).collect(),
            "skin" => table(rig.weights(), rig.skeleton().len()),
            "tails" => {
                let joints = rig.springs().springs().iter().flat_map(|s| &s.joints);
                flat(&joints.map(|j| j.tail.expect("a tail")).collect::<Vec<_>>())
            }
            "matrix" => matrices([motion.world]),
            "matrix_local" => {
                let mut frames = frames(case, "in.matrix_local");
                if group.ends_with("no_rest_rotation") {
                    frames.iter_mut().for_each(|f| f.matrix3 = Mat3A::IDENTITY);
                }
                // The normalisation of UniRig's public code moves frames without scaling them.
                let unscaled = |m: Affine3A| {
                    let scale = if group.starts_with("affine") { motion.world.matrix3.x_axis.length() } else { 1.0 };
                    Affine3A { matrix3: m.matrix3 * (1.0 / scale), ..m }
                };
                matrices(motion.rest.iter().zip(&motion.origins).map(|(r, o)| unscaled(*r * frames[o.index()])))
            }
            "vertex_normals" if group == "drop_part" => {
                case.elsewhere(&name, "normals are those of what is left, here those of the whole");
                continue;
            }
            "vertex_normals" => flat(&normals_by_angle(rig.mesh())),
            "face_normals" => flat(&triangle_normals(rig.mesh())),
            other => unreachable!("{other}"),
        };
        case.check(&name, got);
    }
}

fn done<T>(rig: Rig, step: impl FnOnce(&mut Draft) -> T) -> Augmented {
    let mut draft = Draft::open(rig);
    step(&mut draft);
    draft.close().expect("a rig")
}

fn marked(joints: Vec<usize>, count: usize) -> Vec<bool> {
    (0..count).map(|j| joints.contains(&j)).collect()
}

/// The numbers in a text.
fn numbers(text: &str) -> Vec<f32> {
    text.split(|c: char| !(c.is_ascii_digit() || c == '.' || c == '-')).filter_map(|w| w.parse().ok()).collect()
}

/// Affine maps from 4x4 matrices by rows.
fn frames(case: &Golden, name: &str) -> Vec<Affine3A> {
    let affine = |m: &[f64; 16]| {
        let column = |c: usize| Vec3A::from_array([m[c] as f32, m[4 + c] as f32, m[8 + c] as f32]);
        Affine3A { matrix3: Mat3A::from_cols(column(0), column(1), column(2)), translation: column(3) }
    };
    case.values(name).as_chunks::<16>().0.iter().map(affine).collect()
}

/// 4x4 matrices by rows.
fn matrices(maps: impl IntoIterator<Item = Affine3A>) -> Vec<f64> {
    let rows = |m: Affine3A| glam::Mat4::from(m).transpose().to_cols_array().map(f64::from);
    maps.into_iter().flat_map(rows).collect()
}

/// A map in a joint's own axes as one along the world's.
fn in_world(frame: &Affine3A, local: Affine3A) -> Affine3A {
    let axes = Affine3A { translation: Vec3A::ZERO, ..*frame };
    axes * local * axes.inverse()
}

/// The rig with a spring whose joints keep the tails.
fn with_tails(rig: Rig, tails: &[[f32; 3]]) -> Rig {
    let joint = |(j, &tail)| SpringJoint { joint: JointId(j as u16), tail: Some(tail), swing: Swing::default() };
    let joints = tails.iter().enumerate().map(joint).collect();
    let springs = Springs::new(vec![Spring { joints, ..Spring::default() }], Vec::new(), Vec::new()).unwrap();
    rig.with_springs(springs).unwrap()
}
