//! Every augmentation against values recorded from the public code of SkinTokens and UniRig, with the
//! recorded draws.

#[path = "../../riglab-geom/tests/common/golden.rs"]
mod golden;

use glam::{Affine3A, Mat3A, Quat, Vec3A};
use golden::{Golden, after, golden, leading, table};
use riglab_augment::{
    Augmented, DiscretiseConfig, Draft, JitterConfig, LinearParts, Noise, PartConfig, about, delete, into_cube,
    keep_part, linear, pose, reconnect, rotation, signed_axes, trim, unit,
};
use riglab_core::{JointId, Rig, Spring, SpringJoint, Springs, Swing};
use riglab_geom::{normals_by_angle, triangle_normals};
use riglab_random::stream;
use serde_json::Value;

const AXES: [&str; 3] = ["x", "y", "z"];

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
    let input = |what: &str| case.input(group, what);
    let recorded = |what: &str| Some(input(what)).filter(|name| case.has(name));
    let frames = frames(case, &input("matrix_local"));
    let heads: Vec<[f32; 3]> = frames.iter().map(|f| f.translation.into()).collect();
    let rig = || case.rig(group, &heads, &input("skin"));
    let drawn = |keep: fn(f64, f64) -> bool| -> Vec<bool> {
        let rate = case.number_of(group, "rate");
        case.values(&input("draws")).iter().map(|draw| keep(*draw, rate)).collect()
    };
    match first_word(group) {
        "affine" => {
            let into = case.setting(group, "normalize_into").expect("a range");
            let into = [0, 1].map(|k| into[k].as_f64().expect("a range") as f32);
            let scale = recorded("scale").map_or(1.0, |name| case.floats(&name)[0]);
            let shift = recorded("shift").map_or([0.0; 3], |name| case.points(&name)[0]);
            compare(case, group, &done(rig(), |d| into_cube(d, into, scale, shift)));
        }
        "linear" => compare(case, group, &done(rig(), |d| linear(d, skintokens_matrix(case, group), true))),
        "delete" => {
            let keep = marked(&case.indices(&input("selected")), heads.len());
            compare(case, group, &done(rig(), |d| delete(d, &keep)));
        }
        "drop" => compare(case, group, &done(rig(), |d| keep_part(d, &drawn(|draw, rate| draw < rate)))),
        "collapse" => compare(case, group, &done(rig(), |d| reconnect(d, &drawn(|draw, rate| draw >= rate)))),
        "trim" => compare(case, group, &done(rig(), trim)),
        "lbs" => {
            let (turns, scales) = (case.points(&input("rotvec")), case.floats(&input("scale")));
            let local = turns
                .iter()
                .zip(&scales)
                .map(|(v, s)| Affine3A { matrix3: rotation(*v) * *s, translation: Vec3A::ZERO });
            let local: Vec<_> = frames.iter().zip(local).map(|(f, b)| in_world(f, b)).collect();
            compare(case, group, &done(rig(), |d| assert!(pose(d, &local))));
        }
        "jitter" => {
            let name = |what: &str| format!("out.{group}.{what}");
            if case.has(&name("vertices")) {
                let points = noisy(case, group, "vertex", "vertex_noise", rig().mesh().positions());
                case.check_points(&name("vertices"), &points);
            }
            if case.has(&name("vertex_normals")) {
                case.check_points(&name("vertex_normals"), &noisy_normals(case, group));
            }
        }
        "normalize" => {
            // With noise of its own, or that of `jitter`.
            let of = if recorded("scale_normal").is_some() { group } else { "jitter" };
            let normals: Vec<_> = noisy_normals(case, of).into_iter().map(unit).collect();
            case.check_points(&format!("out.{group}.vertex_normals"), &normals);
        }
        "discrete" => {
            let config = cells(case, group);
            let joints: Vec<_> = heads.iter().map(|h| h.map(|x| config.rounded(x))).collect();
            case.check_points(&format!("out.{group}.joints"), &joints);
        }
        "vertex" | "face" if case.has(&format!("out.{group}")) => {
            let mesh = case.mesh_of(group);
            let by = if first_word(group) == "vertex" { normals_by_angle } else { triangle_normals };
            case.check_points(&format!("out.{group}"), &by(&mesh));
        }
        "order" => ordered(case, group, rig()),
        "dfs" => case.elsewhere(&format!("out.{group}"), "compared by the tokenizer's tests"),
        _ => panic!("{}: unknown output `{group}`", case.name),
    }
}

fn first_word(group: &str) -> &str {
    group.split('_').next().unwrap_or(group)
}

/// The matrix of what is done with certainty, or has a draw of the group's own.
fn skintokens_matrix(case: &Golden, group: &str) -> Mat3A {
    let input = |what: &str| case.input(group, what);
    let setting = |key: &str| match case.config(group) {
        Value::Object(own) => own.get(key).cloned(),
        _ => case.setting(group, key),
    };
    let is_on = |key: &str, draw: &str| {
        setting(key).is_some_and(|p| p.as_f64() == Some(1.0)) || case.has(&format!("in.{group}.{draw}"))
    };
    let mut parts = still();
    if is_on("random_rotate_p", "rotvec") {
        parts.rotate = rotation(case.points(&input("rotvec"))[0]);
    }
    let flip = |axis| if is_on(&format!("random_flip_{axis}_p"), &format!("flip_{axis}")) { -1.0 } else { 1.0 };
    parts.flip = Mat3A::from_diagonal(AXES.map(flip).into());
    for (axis, name) in AXES.iter().enumerate() {
        let key = format!("static_rotate_{name}");
        if is_on(&format!("{key}_p"), "angles_deg_xyz") {
            let drawn = Some(input("angles_deg_xyz")).filter(|name| case.has(name));
            let angle = drawn.map_or_else(|| setting(&key)?[0].as_f64(), |name| Some(case.values(&name)[axis]));
            parts.turns[axis] = about(axis, -angle.expect("an angle") as f32);
        }
    }
    if is_on("random_scale_p", "scale") {
        parts.scale = Mat3A::from_diagonal(case.points(&input("scale"))[0].into());
    }
    if is_on("random_transpose", "perm") {
        let perm = case.indices(&input("perm"));
        parts.axes = signed_axes([perm[0], perm[1], perm[2]], case.points(&input("sign"))[0]);
    }
    parts.matrix()
}

fn still() -> LinearParts {
    let same = Mat3A::IDENTITY;
    LinearParts { rotate: same, flip: same, turns: [same; 3], scale: same, axes: same }
}

/// Some of the joints in another order; what is left out leaves its weights to the nearest ancestor. A rig has parents
/// before children and its root first, so the order itself is brought about here.
fn ordered(case: &Golden, group: &str, rig: Rig) {
    let new = case.indices(&case.input(group, "new"));
    let keep = marked(&new, rig.skeleton().len());
    if !keep[0] {
        for name in case.outputs(&format!("{group}.")) {
            case.elsewhere(&name, "a rig does not lose its root");
        }
        return;
    }
    let Augmented { rig, motion, .. } = done(rig, |d| reconnect(d, &keep));
    let place = |joint: &usize| motion.origins.iter().position(|o| o.index() == *joint).expect("a joint that is kept");
    let places: Vec<usize> = new.iter().map(place).collect();
    for name in case.outputs(&format!("{group}.")) {
        let skeleton = rig.skeleton();
        let got: Vec<f64> = match name.rsplit_once('.').expect("a part").1 {
            "parents" => {
                let parent = |p: JointId| places.iter().position(|at| *at == p.index()).expect("a parent") as f64;
                places.iter().map(|at| skeleton.parents()[*at].map_or(-1.0, parent)).collect()
            }
            "skin" => {
                let weights = table(rig.weights(), places.len());
                let rows = weights.chunks_exact(places.len());
                rows.flat_map(|row| places.iter().map(|at| row[*at])).collect()
            }
            "joints" => places.iter().flat_map(|at| skeleton.heads()[*at].map(f64::from)).collect(),
            _ => panic!("{}: unknown output `{name}`", case.name),
        };
        case.check(&name, got);
    }
}

fn noisy(case: &Golden, group: &str, what: &str, draws: &str, points: &[[f32; 3]]) -> Vec<[f32; 3]> {
    let strength = case.values(&case.input(group, &format!("scale_{what}")))[0];
    let of = |key: &str| (case.number_of(group, &format!("{what}_{key}")) * strength) as f32;
    let noise = Noise { sigma: of("sigma"), clip: of("clip") };
    let draws = case.points(&case.input(group, draws));
    points.iter().zip(draws).map(|(p, d)| noise.on(*p, d)).collect()
}

fn noisy_normals(case: &Golden, group: &str) -> Vec<[f32; 3]> {
    noisy(case, group, "normal", "vertex_normal_noise", &normals_by_angle(&case.mesh_of(group)))
}

/// Cells by the config, else by a number at the end of the group's name, else as many as usual.
fn cells(case: &Golden, group: &str) -> DiscretiseConfig {
    let named = || group.rsplit_once('_')?.1.parse().ok();
    let told = case.config(group).as_u64().or_else(named).or_else(|| case.config("discrete").as_u64());
    let usual = DiscretiseConfig::default();
    DiscretiseConfig { cells: told.map_or(usual.cells, |cells| cells as u32), ..usual }
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
    let input = |what: &str| case.input(group, what);
    let (heads, tails) = (case.points(&input("joints")), case.points(&input("tails")));
    let rig_by = |weights: &str| with_tails(case.rig(group, &heads, weights), &tails);
    let rig = || rig_by(&input("skin"));
    match first_word(group) {
        "affine" => {
            let into = said(case, group, "into").try_into().unwrap_or([-1.0, 1.0]);
            let scale = said(case, group, "scale").first().map_or(1.0, |scale| *scale);
            let shift = by_axis(&said(case, group, "shift")).unwrap_or([0.0; 3]);
            compare(case, group, &done(rig(), |d| into_cube(d, into, scale, shift)));
        }
        "linear" => compare(case, group, &done(rig(), |d| linear(d, unirig_matrix(case, group), true))),
        "collapse" => {
            let keep = marked(&kept(case, group).0, heads.len());
            compare(case, group, &done(rig(), |d| reconnect(d, &keep)));
        }
        "drop" => {
            let (joints, weights) = kept(case, group);
            let rig = rig_by(&weights.unwrap_or_else(|| input("skin")));
            let mut keep = marked(&joints, heads.len());
            for joint in (0..heads.len()).rev().filter(|j| joints.contains(j)) {
                let up = std::iter::successors(Some(joint), |j| Some(rig.skeleton().parents()[*j]?.index()));
                up.for_each(|j| keep[j] = true);
            }
            let enough =
                keep.iter().filter(|k| **k).count() as f32 >= PartConfig::default().at_least * heads.len() as f32;
            // What has noise keeps its normals, as all does there: next to none.
            let noise = JitterConfig { sigma: 0.0, normal_sigma: 1e-9, probability: 1.0, ..JitterConfig::default() };
            let part = |d: &mut Draft| {
                noise.apply(d, &mut stream(0, "golden", &[])).expect("normals");
                if enough {
                    keep_part(d, &keep);
                }
            };
            compare(case, group, &done(rig, part));
        }
        "joint" if group.starts_with("joint_discrete") => {
            let config = cells(case, group);
            for name in case.outputs(&format!("{group}.")) {
                let part = name.rsplit_once('.').expect("a part").1;
                match part {
                    "joints" | "tails" => {
                        let points = case.points(&input(part));
                        let round: Vec<_> = points.iter().map(|h| h.map(|x| config.rounded(x))).collect();
                        case.check_points(&name, &round);
                    }
                    "parents" => case.elsewhere(&name, "rounding places leaves the tree"),
                    _ => panic!("{}: unknown output `{name}`", case.name),
                }
            }
        }
        "tail" => {
            // A tail at the head of an only child; of others as in the file, or at the own head.
            let [connect, copy] = ["connect", "copy"].map(|word| group.split('_').any(|w| w == word));
            assert!(connect || copy, "{}: unknown output `{group}`", case.name);
            let rig = rig();
            let (found, children) = (rig.skeleton().tails(), rig.skeleton().children());
            let tail = |j: usize| match (connect && children[j].len() == 1, copy) {
                (true, _) => found[j],
                (_, true) => heads[j],
                _ => tails[j],
            };
            let rig = with_tails(rig, &(0..heads.len()).map(tail).collect::<Vec<_>>());
            compare(case, group, &done(rig, |_| ()));
        }
        "sample" => {
            for name in case.outputs(&format!("{group}.")) {
                case.elsewhere(&name, "compared by the sampler's tests");
            }
        }
        _ => panic!("{}: unknown output `{group}`", case.name),
    }
}

/// The numbers of a group under a word: recorded, of its object or text in the config, or of its name.
fn said(case: &Golden, group: &str, word: &str) -> Vec<f32> {
    let recorded = format!("in.{group}.{word}");
    if case.has(&recorded) {
        return case.floats(&recorded);
    }
    let found = match case.config(group) {
        Value::String(words) => after(words, word),
        Value::Object(all) => match all.iter().find(|(key, _)| key.ends_with(word)).map(|(_, v)| v) {
            Some(Value::Array(list)) => list.iter().filter_map(Value::as_f64).collect(),
            Some(other) => other.as_f64().into_iter().collect(),
            None => Vec::new(),
        },
        _ => after(&group.replace('_', " "), word),
    };
    found.into_iter().map(|x| x as f32).collect()
}

/// One number for all axes, or one for each.
fn by_axis(numbers: &[f32]) -> Option<[f32; 3]> {
    match *numbers {
        [] => None,
        [all] => Some([all; 3]),
        [x, y, z] => Some([x, y, z]),
        _ => panic!("for three axes: {numbers:?}"),
    }
}

/// The matrix by the words of a group's name, such as `linear_x90_flip_yz_scale`.
fn unirig_matrix(case: &Golden, group: &str) -> Mat3A {
    let mut parts = still();
    let mut words = group.split('_').skip(1).peekable();
    while let Some(word) = words.next() {
        let number = |text: &str| -> Option<f32> { text.parse().ok() };
        let axis = AXES.iter().position(|axis| word.starts_with(axis));
        if word == "flip" {
            let mut signs = [1.0; 3];
            while let Some(axes) = words.next_if(|w| w.chars().all(|c| "xyz".contains(c))) {
                axes.chars().for_each(|c| signs["xyz".find(c).expect("an axis")] = -1.0);
            }
            parts.flip = Mat3A::from_diagonal(signs.into());
        } else if word == "rotate" || word == "rotvec" {
            parts.rotate = rotation(case.points(&case.input(group, "rotvec"))[0]);
        } else if let Some(told) = word.strip_prefix("scale") {
            let own = number(told).map_or_else(|| said(case, group, "scale"), |scale| vec![scale]);
            let all = || by_axis(&said(case, "linear", "scale")).expect("a scale");
            while words.next_if(|w| number(w).is_some()).is_some() {}
            parts.scale = Mat3A::from_diagonal(by_axis(&own).unwrap_or_else(all).into());
        } else if let Some((axis, degrees)) = axis.and_then(|axis| Some((axis, number(&word[1..])?))) {
            parts.turns[axis] = about(axis, -degrees);
        } else {
            panic!("{}: `{word}` of unknown output `{group}`", case.name);
        }
    }
    parts.matrix()
}

/// Which joints a group keeps, and the weights that are told beside them.
fn kept(case: &Golden, group: &str) -> (Vec<usize>, Option<String>) {
    let recorded = case.input(group, "keep");
    if case.has(&recorded) {
        return (case.indices(&recorded), None);
    }
    match case.setting(group, "keep") {
        Some(Value::Array(joints)) => (joints.iter().map(|j| j.as_u64().expect("a joint") as usize).collect(), None),
        Some(Value::String(words)) => {
            let weights = words.split_whitespace().find(|w| w.starts_with("in."));
            (leading(&words).into_iter().map(|j| j as usize).collect(), weights.map(str::to_owned))
        }
        other => panic!("{}: {group} keeps {other:?}", case.name),
    }
}

#[test]
fn poses() {
    for case in golden("unirig", "lbs_fk") {
        for group in case.groups() {
            poses_group(&case, &group);
        }
        case.done();
    }
}

fn poses_group(case: &Golden, group: &str) {
    let input = |what: &str| case.input(group, what);
    let (heads, frames) = (case.points(&input("joints")), frames(case, &input("matrix_local")));
    let turns = |what: &str| case.points(&input(what)).into_iter().map(rotation);
    let posed = || {
        let basis = self::frames(case, &input("matrix_basis"));
        let local = match has_no_frames(group) {
            true => basis,
            false => frames.iter().zip(&basis).map(|(f, b)| in_world(f, *b)).collect(),
        };
        let rig = with_tails(case.rig(group, &heads, &input("skin")), &case.points(&input("tails")));
        done(rig, |d| assert!(pose(d, &local)))
    };
    let name = format!("out.{group}");
    if group.starts_with("posed") {
        compare(case, group, &posed());
    } else if group.starts_with("pose_matrix") {
        case.check(&name, posed_frames(case, group, &posed()));
    } else if group.starts_with("basis_rotation") || group.starts_with("quaternion_matrix") {
        let what = if group.starts_with("basis") { "rotvec" } else { "axis_angle" };
        let rows = turns(what).flat_map(|m| m.transpose().to_cols_array());
        case.check(&name, rows.map(f64::from).collect::<Vec<_>>());
    } else if group.contains("quaternion_wxyz") {
        // Either sign is the same turn.
        let signed = |(m, want): (Mat3A, &[f64; 4])| {
            let q = Quat::from_mat3a(&m);
            let q = [q.w, q.x, q.y, q.z].map(f64::from);
            let same: f64 = q.iter().zip(want).map(|(a, b)| a * b).sum();
            q.map(|x| if same < 0.0 { -x } else { x })
        };
        let wanted = case.values(&name).as_chunks::<4>().0;
        case.check(&name, turns("axis_angle").zip(wanted).flat_map(signed).collect::<Vec<_>>());
    } else if group.starts_with("lbs_unnormalised") {
        case.elsewhere(&name, "weights of a rig sum to 1; compared by the rewards' tests");
    } else {
        panic!("{}: unknown output `{group}`", case.name);
    }
}

/// Whether a group takes the joints' frames for turned as the world is.
fn has_no_frames(group: &str) -> bool {
    group.contains("no_rest_rotation")
}

/// Where the frames of joints are after all.
fn posed_frames(case: &Golden, group: &str, result: &Augmented) -> Vec<f64> {
    let mut frames = frames(case, &case.input(group, "matrix_local"));
    if has_no_frames(group) {
        frames.iter_mut().for_each(|f| f.matrix3 = Mat3A::IDENTITY);
    }
    let motion = &result.motion;
    // The normalisation of UniRig's public code moves frames without scaling them.
    let unscaled = |m: Affine3A| {
        let scale = if group.starts_with("affine") { motion.world.matrix3.x_axis.length() } else { 1.0 };
        Affine3A { matrix3: m.matrix3 * (1.0 / scale), ..m }
    };
    matrices(motion.rest.iter().zip(&motion.origins).map(|(r, o)| unscaled(*r * frames[o.index()])))
}

/// Checks whatever is recorded of a result.
fn compare(case: &Golden, group: &str, result: &Augmented) {
    let rig = &result.rig;
    for name in case.outputs(&format!("{group}.")) {
        let flat = |points: &[[f32; 3]]| points.as_flattened().iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
        let normals = result.normals.as_ref();
        let got: Vec<f64> = match name.rsplit_once('.').expect("a part").1 {
            "vertices" => flat(rig.mesh().positions()),
            "joints" => flat(rig.skeleton().heads()),
            "parents" => rig.skeleton().parents().iter().map(|p| p.map_or(-1.0, |p| f64::from(p.0))).collect(),
            "faces" => rig.mesh().triangles().as_flattened().iter().map(|v| f64::from(*v)).collect(),
            "skin" => table(rig.weights(), rig.skeleton().len()),
            "tails" => {
                let joints = rig.springs().springs().iter().flat_map(|s| &s.joints);
                flat(&joints.map(|j| j.tail.expect("a tail")).collect::<Vec<_>>())
            }
            "matrix" => matrices([result.motion.world]),
            "matrix_local" => posed_frames(case, group, result),
            "vertex_normals" => normals.map_or_else(|| flat(&normals_by_angle(rig.mesh())), |n| flat(&n.vertices)),
            "face_normals" => normals.map_or_else(|| flat(&triangle_normals(rig.mesh())), |n| flat(&n.triangles)),
            _ => panic!("{}: unknown output `{name}`", case.name),
        };
        case.check(&name, got);
    }
}

fn done<T>(rig: Rig, step: impl FnOnce(&mut Draft) -> T) -> Augmented {
    let mut draft = Draft::open(rig);
    step(&mut draft);
    draft.close().expect("a rig")
}

fn marked(joints: &[usize], count: usize) -> Vec<bool> {
    (0..count).map(|j| joints.contains(&j)).collect()
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
