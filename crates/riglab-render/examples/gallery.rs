//! Draws every kind of picture of two generated rigs into a folder, and times the largest.
//!
//! `cargo run --release -p riglab-render --example gallery -- FOLDER`

use std::f32::consts::TAU;
use std::path::PathBuf;
use std::time::Instant;

use riglab_core::{Joint, JointId, Mesh, Rig, Skeleton, SkinWeights, Vec3};
use riglab_render::*;

fn main() -> std::io::Result<()> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "gallery".into()));
    std::fs::create_dir_all(&folder)?;
    let save = |name: &str, picture: &Picture| std::fs::write(folder.join(format!("{name}.png")), picture.to_png());
    let mut sheet = Vec::new();
    for (name, rig) in [("tube", tube(24, 40)), ("figure", figure())] {
        for theme in [Theme::Light, Theme::Dark] {
            let view = View::default().themed(theme);
            let middle = JointId(1);
            let values = joint_weights(rig.weights(), middle);
            let blurred = misplaced_weight(rig.weights(), &softer(rig.weights()));
            let cells = [
                ("mesh", render_mesh(rig.mesh(), &view)),
                ("skeleton", render_skeleton(&rig, &view)),
                ("parts", render_parts(&rig, &view)),
                ("weights, dusk", render_weights(rig.mesh(), &values, &view, Palette::Dusk)),
                ("weights, paint", render_weights(rig.mesh(), &values, &view, Palette::Paint)),
                ("errors", render_errors(rig.mesh(), &blurred, 0.5, &view)),
            ];
            let cells = cells.map(|(kind, picture)| (format!("{name}: {kind}"), picture));
            save(&format!("{name}-{theme:?}").to_lowercase(), &contact_sheet(&cells, 3, theme))?;
            let small = View::square(128).themed(theme);
            sheet.push((format!("{name}, {theme:?}"), render_parts(&rig, &small)));
            sheet.push((String::new(), render_skeleton(&rig, &small)));
        }
    }
    save("small", &contact_sheet(&sheet, 4, Theme::Light))?;
    let letters: String = (' '..='~').collect();
    let mut font = Picture::filled(600, 60, Theme::Light.background());
    for (row, line) in letters.as_bytes().chunks(48).enumerate() {
        font.write(std::str::from_utf8(line).expect("ASCII"), 6, 6 + 24 * row, 2, Theme::Light.ink());
    }
    save("font", &font)?;

    let large = tube(100, 100);
    let view = View::default();
    let values = joint_weights(large.weights(), JointId(1));
    let time = |what: &str, draw: &dyn Fn() -> Picture| {
        draw();
        let start = Instant::now();
        for _ in 0..20 {
            draw();
        }
        println!("{what}: {:.1} ms", start.elapsed().as_secs_f64() * 50.0);
    };
    println!("{} triangles, 512 x 512, {} threads", large.mesh().triangles().len(), rayon::current_num_threads());
    time("weights", &|| render_weights(large.mesh(), &values, &view, Palette::Dusk));
    time("parts", &|| render_parts(&large, &view));
    time("skeleton", &|| render_skeleton(&large, &view));
    let picture = render_parts(&large, &view);
    let start = Instant::now();
    let bytes = picture.to_png().len();
    println!("png: {:.1} ms, {bytes} bytes", start.elapsed().as_secs_f64() * 1e3);
    Ok(())
}

/// A bent tube of 2 * `around` * `along` triangles on 4 joints.
fn tube(around: usize, along: usize) -> Rig {
    let center = |t: f32| -> Vec3 { [0.5 * (2.5 * t).sin(), 2.0 * t, 0.4 * (1.5 * t).sin()] };
    let joints = (0..4usize).map(|j| (format!("joint{j}"), j.checked_sub(1), center(j as f32 / 3.5 + 0.02)));
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    let mut rows = Vec::new();
    for ring in 0..=along {
        let t = ring as f32 / along as f32;
        let [x, y, z] = center(t);
        let radius = 0.28 * (1.0 - 0.5 * t) * (1.0 - (2.0 * t - 1.0).powi(16)).max(0.02).sqrt();
        for k in 0..around {
            let (sin, cos) = (TAU * k as f32 / around as f32).sin_cos();
            positions.push([x + radius * cos, y, z + radius * sin]);
            let at = f64::from(t) * 3.5;
            rows.push((0..4u16).map(move |j| (j, (1.2 - (at - f64::from(j) - 0.5).abs()).max(0.0).powi(2))).collect());
            if ring < along {
                let [a, b] = [k, (k + 1) % around].map(|k| (ring * around + k) as u32);
                let up = around as u32;
                triangles.extend([[a, b, b + up], [a, b + up, a + up]]);
            }
        }
    }
    rig(joints, positions, triangles, rows)
}

/// A standing figure of capsules, one for each bone.
fn figure() -> Rig {
    let mut joints: Vec<(String, Option<usize>, Vec3)> = Vec::new();
    let mut add = |name: &str, parent: Option<usize>, head: Vec3| {
        joints.push((name.to_owned(), parent, head));
        joints.len() - 1
    };
    let hips = add("hips", None, [0.0, 1.0, 0.0]);
    let chest = add("chest", Some(hips), [0.0, 1.3, 0.0]);
    let neck = add("neck", Some(chest), [0.0, 1.55, 0.0]);
    add("head", Some(neck), [0.0, 1.75, 0.02]);
    for (side, x) in [("left", 1.0f32), ("right", -1.0)] {
        let thigh = add(&format!("{side} thigh"), Some(hips), [0.11 * x, 0.93, 0.0]);
        let shin = add(&format!("{side} shin"), Some(thigh), [0.13 * x, 0.5, 0.02]);
        let foot = add(&format!("{side} foot"), Some(shin), [0.14 * x, 0.08, 0.0]);
        add(&format!("{side} toes"), Some(foot), [0.15 * x, 0.03, 0.16]);
        let shoulder = add(&format!("{side} shoulder"), Some(chest), [0.2 * x, 1.5, 0.0]);
        let elbow = add(&format!("{side} elbow"), Some(shoulder), [0.45 * x, 1.38, -0.02]);
        let hand = add(&format!("{side} hand"), Some(elbow), [0.68 * x, 1.28, 0.05]);
        for finger in 0..4 {
            let y = 1.27 - 0.022 * finger as f32;
            let base = add(&format!("{side} finger{finger}"), Some(hand), [0.76 * x, y, 0.1 - 0.02 * finger as f32]);
            add(&format!("{side} tip{finger}"), Some(base), [0.81 * x, y - 0.02, 0.12 - 0.02 * finger as f32]);
        }
    }
    let mut positions = Vec::new();
    let mut triangles = Vec::new();
    let mut rows: Vec<Vec<(u16, f64)>> = Vec::new();
    for (joint, (name, parent, head)) in joints.iter().enumerate() {
        let Some(parent) = *parent else { continue };
        let length = (0..3).map(|k| (head[k] - joints[parent].2[k]).powi(2)).sum::<f32>().sqrt();
        let radius = if name == "head" { 0.12 } else { (0.32 * length).clamp(0.012, 0.085) };
        let owners = [parent as u16, joint as u16];
        capsule(joints[parent].2, *head, radius, owners, &mut positions, &mut triangles, &mut rows);
    }
    rig(joints.into_iter(), positions, triangles, rows)
}

/// Adds an ellipsoid around a bone, held by its two ends.
fn capsule(
    a: Vec3,
    b: Vec3,
    radius: f32,
    owners: [u16; 2],
    positions: &mut Vec<Vec3>,
    triangles: &mut Vec<[u32; 3]>,
    rows: &mut Vec<Vec<(u16, f64)>>,
) {
    const RINGS: usize = 16;
    const AROUND: usize = 20;
    let (a, b) = (glam::Vec3::from(a), glam::Vec3::from(b));
    let axis = (b - a).normalize_or(glam::Vec3::Y);
    let (u, v) = axis.any_orthonormal_pair();
    let first = positions.len() as u32;
    for ring in 0..=RINGS {
        let angle = std::f32::consts::PI * ring as f32 / RINGS as f32;
        let along = -angle.cos();
        let center = 0.5 * (a + b) + axis * along * (0.5 * (b - a).length() + 0.6 * radius);
        for k in 0..AROUND {
            let (sin, cos) = (TAU * k as f32 / AROUND as f32).sin_cos();
            positions.push((center + radius * angle.sin().max(0.01) * (u * cos + v * sin)).into());
            let share = f64::from(((along + 1.0) * 0.5).powi(3));
            rows.push(vec![(owners[0], 1.0 - share), (owners[1], share)]);
            if ring < RINGS {
                let at = |ring: usize, k: usize| first + (ring * AROUND + k % AROUND) as u32;
                triangles.push([at(ring, k), at(ring, k + 1), at(ring + 1, k + 1)]);
                triangles.push([at(ring, k), at(ring + 1, k + 1), at(ring + 1, k)]);
            }
        }
    }
}

fn rig(
    joints: impl Iterator<Item = (String, Option<usize>, Vec3)>,
    positions: Vec<Vec3>,
    triangles: Vec<[u32; 3]>,
    rows: Vec<Vec<(u16, f64)>>,
) -> Rig {
    let joint = |(name, parent, head): (String, Option<usize>, Vec3)| Joint {
        name,
        parent: parent.map(|p| JointId(p as u16)),
        head,
    };
    let skeleton = Skeleton::new(joints.map(joint).collect()).expect("a tree");
    let mesh = Mesh::new(positions, triangles).expect("a mesh");
    Rig::new(skeleton, mesh, SkinWeights::normalized(rows).expect("weights")).expect("a rig")
}

/// Weights with their contrast taken down: a prediction that is nearly right.
fn softer(weights: &SkinWeights) -> SkinWeights {
    let row = |v| weights.row(v).map(|(joint, w)| (joint.0, f64::from(w).powf(0.4))).collect::<Vec<_>>();
    SkinWeights::normalized((0..weights.rows()).map(row)).expect("still weights")
}
