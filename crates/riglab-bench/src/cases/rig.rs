//! The whole of `riglab rig` on a mesh of 20,000 vertices, against the time asked for.
//!
//! Nothing usual rigs a mesh so, thus there is no other side: its column holds the bar. What is measured is the
//! program as a user starts it: reading, the model, weights of all vertices, writing. The first row has the model that
//! comes with the program; the second one the same network with starting weights, whose skeletons go on to the limits:
//! the longest that it can take.

use std::collections::{BTreeMap, BinaryHeap};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::Instant;

use anyhow::{Context as _, Result, bail, ensure};
use riglab_core::Vec3;
use riglab_synth::{Options, creature};
use riglab_task::tokenrig::Card;
use riglab_train::{Precision, State};
use tch::Kind;

use super::Context;
use super::subject::open_tokenrig;
use crate::recipe;
use crate::rounds::median;
use crate::row::{Better, Row};

const NAME: &str = "rig/20k";
const VERTICES: usize = 20_000;
/// Seconds that it may take on two threads.
const ASKED: f64 = 20.0;

pub fn run(context: &mut Context) -> Result<Vec<Row>> {
    let program = program()?;
    let mesh = context.path("creature.obj");
    let positions = write_mesh(&mesh)?;
    ensure!(positions == VERTICES, "a mesh of {positions} vertices");
    let mut rows = vec![measure(context, &program, &mesh, None)?];
    match context.corpus()? {
        None => rows.push(Row::skipped(format!("{NAME}/longest"), recipe::NO_RIGS)),
        Some(corpus) => {
            let model = context.path("starting.safetensors");
            write_model(&model, &corpus)?;
            rows.push(measure(context, &program, &mesh, Some(&model))?);
        }
    }
    Ok(rows)
}

fn measure(context: &Context, program: &Path, mesh: &Path, model: Option<&Path>) -> Result<Row> {
    let out = context.path("rigged.glb");
    let (mut seconds, mut said) = (Vec::new(), String::new());
    for _ in 0..context.rounds(3) {
        let mut command = Command::new(program);
        command
            .arg("--threads")
            .arg(context.threads.to_string())
            .arg("rig")
            .arg(mesh)
            .arg("-o")
            .arg(&out)
            .arg("--json");
        if let Some(model) = model {
            command.arg("--checkpoint").arg(model);
        }
        let start = Instant::now();
        let done = command.output().with_context(|| format!("cannot start {}", program.display()))?;
        seconds.push(start.elapsed().as_secs_f64());
        if !done.status.success() {
            let name = model.map_or(NAME.to_string(), |_| format!("{NAME}/longest"));
            return Ok(Row::failed(name, String::from_utf8_lossy(&done.stderr).trim()));
        }
        said = String::from_utf8_lossy(&done.stdout).trim().to_string();
        ensure!(out.metadata().is_ok_and(|m| m.len() > 0), "nothing was written");
        std::fs::remove_file(&out)?;
    }
    let (label, what) = match model {
        None => (NAME.to_string(), "the model that comes with the program"),
        Some(_) => (format!("{NAME}/longest"), "starting weights, skeletons of the most joints and tokens"),
    };
    let note = format!("{} threads, {what}; the other side is the bar; {seconds:.2?} s; {said}", context.threads);
    Ok(Row::new(label, median(&seconds), ASKED, "s", Better::Lower).bar(1.0).note(note))
}

/// The program beside this one, built first where cargo runs this.
pub(super) fn program() -> Result<PathBuf> {
    if let Some(cargo) = std::env::var_os("CARGO") {
        let mut build = Command::new(cargo);
        // Of the workspace, as this program was: by the package alone others of its dependencies would be built anew.
        build.args(["build", "--quiet", "--release", "--bin", "riglab"]).current_dir(recipe::root());
        ensure!(build.status()?.success(), "riglab cannot be built");
    }
    let beside = std::env::current_exe()?.with_file_name(format!("riglab{}", std::env::consts::EXE_SUFFIX));
    if !beside.is_file() {
        bail!("{} is missing; build it with `cargo build --release --bin riglab`", beside.display());
    }
    Ok(beside)
}

/// TokenRig's experiment with starting weights, as a file that the program takes.
fn write_model(to: &Path, corpus: &Path) -> Result<()> {
    let task = open_tokenrig(recipe::tokenrig(corpus, Precision::Fp32)?, corpus)?;
    let state = State { task: "tokenrig".into(), step: 0, seed: 0, skipped: 0, skipped_in_a_row: 0, best: None };
    let card = Card { name: "starting weights".into(), state, text: "Not trained.".into() };
    let bundle = task.rigger().bundle(&card).map_err(anyhow::Error::msg)?;
    Ok(bundle.write_to(&mut std::fs::File::create(to)?, Kind::Float)?)
}

/// A creature whose longest edges are halved until there are so many vertices, as OBJ. Gives how many.
fn write_mesh(to: &Path) -> Result<usize> {
    let made = creature(1, 0, &Options::default());
    let mesh = made.rig.mesh();
    let (positions, triangles) = refined(mesh.positions().to_vec(), mesh.triangles().to_vec(), VERTICES);
    let mut text = String::new();
    for [x, y, z] in &positions {
        writeln!(text, "v {x} {y} {z}")?;
    }
    for t in &triangles {
        let [a, b, c] = t.map(|v| v + 1);
        writeln!(text, "f {a} {b} {c}")?;
    }
    std::fs::write(to, text)?;
    Ok(positions.len())
}

/// Halves the longest edge, again and again: each adds a vertex.
fn refined(mut positions: Vec<Vec3>, mut triangles: Vec<[u32; 3]>, count: usize) -> (Vec<Vec3>, Vec<[u32; 3]>) {
    let length = |p: &[Vec3], a: u32, b: u32| -> f32 {
        let (a, b) = (p[a as usize], p[b as usize]);
        (0..3).map(|k| (a[k] - b[k]).powi(2)).sum()
    };
    let edge = |a: u32, b: u32| (a.min(b), a.max(b));
    let mut beside: BTreeMap<(u32, u32), Vec<usize>> = BTreeMap::new();
    let edges = |t: [u32; 3]| [edge(t[0], t[1]), edge(t[1], t[2]), edge(t[2], t[0])];
    for (k, t) in triangles.iter().enumerate() {
        edges(*t).into_iter().for_each(|e| beside.entry(e).or_default().push(k));
    }
    // Squared lengths as bits: those of numbers from 0 on are in order.
    let mut queue: BinaryHeap<(u32, (u32, u32))> =
        beside.keys().map(|&(a, b)| (length(&positions, a, b).to_bits(), (a, b))).collect();
    while positions.len() < count {
        let Some((_, (a, b))) = queue.pop() else { break };
        let Some(around) = beside.remove(&(a, b)) else { continue };
        let middle = positions.len() as u32;
        let (pa, pb) = (positions[a as usize], positions[b as usize]);
        positions.push([0, 1, 2].map(|k| 0.5 * (pa[k] + pb[k])));
        let mut fresh = vec![(a, middle), (b, middle)];
        for k in around {
            let old = triangles[k];
            let Some(other) = old.into_iter().find(|v| *v != a && *v != b) else { continue };
            let halves = [a, b].map(|from| old.map(|v| if v == from { middle } else { v }));
            for e in edges(old) {
                if let Some(own) = beside.get_mut(&e) {
                    own.retain(|t| *t != k);
                }
            }
            triangles[k] = halves[0];
            triangles.push(halves[1]);
            for (t, half) in [(k, halves[0]), (triangles.len() - 1, halves[1])] {
                edges(half).into_iter().for_each(|e| beside.entry(e).or_default().push(t));
            }
            fresh.push(edge(other, middle));
        }
        queue.extend(fresh.into_iter().map(|(a, b)| (length(&positions, a, b).to_bits(), (a, b))));
    }
    (positions, triangles)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halving_edges_keeps_the_surface_whole() {
        let corners = vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
        let faces = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let (positions, triangles) = refined(corners, faces, 100);
        assert_eq!((positions.len(), triangles.len()), (100, 196));
        // Each edge has its opposite once: closed, and turned the same way.
        let mut edges: Vec<(u32, u32)> =
            triangles.iter().flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]).collect();
        let mut opposite: Vec<(u32, u32)> = edges.iter().map(|&(a, b)| (b, a)).collect();
        edges.sort_unstable();
        opposite.sort_unstable();
        assert_eq!(edges, opposite);
        edges.dedup();
        assert_eq!(edges.len(), 3 * 196);
    }
}
