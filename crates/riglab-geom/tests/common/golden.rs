//! Recorded values of other code, read without tensors.
#![allow(dead_code)] // each test uses a part

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

use riglab_core::{Joint, JointId, Mesh, Rig, Skeleton, SkinWeights};
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;

/// One case: inputs and expected outputs, with the tolerance of each.
pub struct Golden {
    pub name: String,
    pub json: Value,
    arrays: BTreeMap<String, (Vec<usize>, Vec<f64>)>,
    checked: RefCell<BTreeSet<String>>,
}

/// The cases of a folder of `RIGLAB_GOLDEN` whose names start with `kind`; empty, with a word about it,
/// where there is no such folder. A folder without any such case is a fault.
pub fn golden(sub: &str, kind: &str) -> Vec<Golden> {
    let Some((dir, names)) = named(sub, kind, ".safetensors") else { return Vec::new() };
    names.iter().map(|name| Golden::read(&dir, name)).collect()
}

/// The same of cases that are lists in one JSON each, by name.
pub fn lists(sub: &str, kind: &str) -> Vec<(String, Value)> {
    let Some((dir, names)) = named(sub, kind, ".json") else { return Vec::new() };
    let read = |name: String| {
        let text = std::fs::read(dir.join(format!("{name}.json"))).expect("a readable case");
        (name, serde_json::from_slice(&text).expect("a case is JSON"))
    };
    names.into_iter().map(read).collect()
}

fn named(sub: &str, kind: &str, ending: &str) -> Option<(PathBuf, Vec<String>)> {
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/golden");
    let dir = std::env::var_os("RIGLAB_GOLDEN").map_or(shared, PathBuf::from).join(sub);
    let Ok(entries) = std::fs::read_dir(&dir) else {
        println!("skipped: no such folder {} (set RIGLAB_GOLDEN)", dir.display());
        return None;
    };
    let files = entries.filter_map(|e| e.ok()?.file_name().to_str()?.strip_suffix(ending).map(String::from));
    let mut names: Vec<String> = files.filter(|n| n.starts_with(kind)).collect();
    names.sort();
    assert!(!names.is_empty(), "{}: no case of {kind}", dir.display());
    Some((dir, names))
}

impl Golden {
    fn read(dir: &Path, name: &str) -> Self {
        let text = std::fs::read_to_string(dir.join(format!("{name}.json"))).expect("a case has a side file");
        let bytes = std::fs::read(dir.join(format!("{name}.safetensors"))).expect("a readable case");
        let tensors = SafeTensors::deserialize(&bytes).expect("a sound file");
        let array = |name: &str| {
            let t = tensors.tensor(name).expect("a listed tensor");
            let size = t.dtype().bitsize() / 8;
            let values = t.data().chunks_exact(size).map(|b| match t.dtype() {
                Dtype::F32 => f64::from(f32::from_le_bytes(b.try_into().expect("4"))),
                Dtype::F64 => f64::from_le_bytes(b.try_into().expect("8")),
                Dtype::I32 => f64::from(i32::from_le_bytes(b.try_into().expect("4"))),
                Dtype::I64 => i64::from_le_bytes(b.try_into().expect("8")) as f64,
                Dtype::U8 | Dtype::BOOL => f64::from(b[0]),
                other => panic!("{name}: numbers of type {other:?}"),
            });
            (t.shape().to_vec(), values.collect())
        };
        let arrays = tensors.names().into_iter().map(|n| (n.to_string(), array(n))).collect();
        let json = serde_json::from_str(&text).expect("side files are JSON");
        Self { name: name.into(), json, arrays, checked: RefCell::default() }
    }

    /// The groups of outputs: what stands between `out.` and the next dot but a number's.
    pub fn groups(&self) -> BTreeSet<String> {
        let group = |rest: &str| {
            let digit = |at: Option<usize>| at.and_then(|at| rest.as_bytes().get(at)).is_some_and(u8::is_ascii_digit);
            let dots = rest.match_indices('.').map(|(at, _)| at);
            let end = dots.into_iter().find(|at| !(digit(at.checked_sub(1)) && digit(Some(at + 1))));
            rest[..end.unwrap_or(rest.len())].to_owned()
        };
        self.arrays.keys().filter_map(|k| k.strip_prefix("out.")).map(group).collect()
    }

    /// The names of all arrays, inputs too.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.arrays.keys().map(String::as_str)
    }

    /// The full names of the outputs that start so.
    pub fn outputs(&self, start: &str) -> Vec<String> {
        let start = format!("out.{start}");
        self.arrays.keys().filter(|k| k.starts_with(&start)).cloned().collect()
    }

    pub fn has(&self, name: &str) -> bool {
        self.arrays.contains_key(name)
    }

    pub fn shape(&self, name: &str) -> &[usize] {
        &self.array(name).0
    }

    fn array(&self, name: &str) -> &(Vec<usize>, Vec<f64>) {
        self.arrays.get(name).unwrap_or_else(|| panic!("{}: no array `{name}`", self.name))
    }

    pub fn values(&self, name: &str) -> &[f64] {
        &self.array(name).1
    }

    pub fn floats(&self, name: &str) -> Vec<f32> {
        self.values(name).iter().map(|x| *x as f32).collect()
    }

    /// Rows of three.
    pub fn points(&self, name: &str) -> Vec<[f32; 3]> {
        self.values(name).as_chunks::<3>().0.iter().map(|p| p.map(|x| x as f32)).collect()
    }

    pub fn indices(&self, name: &str) -> Vec<usize> {
        self.values(name).iter().map(|x| *x as usize).collect()
    }

    /// A number of the config, by a path like `lbs.rate`.
    pub fn number(&self, path: &str) -> f64 {
        self.config(path).as_f64().unwrap_or_else(|| panic!("{}: `{path}` is no number", self.name))
    }

    pub fn config(&self, path: &str) -> &Value {
        path.split('.').fold(&self.json["config"], |v, key| &v[key])
    }

    /// The input of a group: under the group's own name, or a shorter one that it begins with (`in.drop.draws` of
    /// `drop_half`), else that of all groups.
    pub fn input(&self, group: &str, what: &str) -> String {
        let own = shorter(group).map(|name| format!("in.{name}.{what}")).find(|name| self.has(name));
        own.unwrap_or_else(|| format!("in.{what}"))
    }

    /// What the config has for a group under a key: in the group's object, as `GROUP_key`, or in words ("alpha 0.3"),
    /// of the group's own name or a shorter one that it begins with; else what it has for all groups.
    pub fn setting(&self, group: &str, key: &str) -> Option<Value> {
        let of = |name: &str| {
            let own = self.config(name);
            let words = own.as_str().and_then(|text| after(text, key).first().copied()).map(Value::from);
            [own[key].clone(), self.config(&format!("{name}_{key}")).clone()]
                .into_iter()
                .find(|v| !v.is_null())
                .or(words)
        };
        let all = || Some(self.config(key).clone()).filter(|v| !v.is_null() && !v.is_object());
        shorter(group).find_map(of).or_else(all)
    }

    /// The same, a number.
    pub fn number_of(&self, group: &str, key: &str) -> f64 {
        let found = self.setting(group, key).and_then(|v| v.as_f64());
        found.unwrap_or_else(|| panic!("{}: no number `{key}` for {group}", self.name))
    }

    /// Compares with the expected array: |got - want| <= abs + rel |want|. Counts as compared.
    pub fn check(&self, name: &str, got: impl IntoIterator<Item = f64>) {
        self.check_within(name, got, self.tolerance(name));
    }

    /// The same within a tolerance, (abs, rel), where the case has none.
    pub fn check_within(&self, name: &str, got: impl IntoIterator<Item = f64>, (abs, rel): (f64, f64)) {
        let got: Vec<f64> = got.into_iter().collect();
        let want = self.values(name);
        assert_eq!(got.len(), want.len(), "{}: size of `{name}`", self.name);
        for (at, (g, w)) in got.iter().zip(want).enumerate() {
            let most = abs + rel * w.abs();
            assert!((g - w).abs() <= most, "{}: `{name}`[{at}] is {g}, not {w}", self.name);
        }
        self.checked.borrow_mut().insert(name.into());
    }

    pub fn check_points(&self, name: &str, got: &[[f32; 3]]) {
        self.check(name, got.as_flattened().iter().map(|x| f64::from(*x)));
    }

    /// Counts as compared, with a reason why it is not.
    pub fn elsewhere(&self, name: &str, why: &str) {
        println!("{}: {name}: {why}", self.name);
        self.checked.borrow_mut().insert(name.into());
    }

    /// Ends a case: everything must have been compared.
    pub fn done(&self) {
        let checked = self.checked.borrow();
        let left: Vec<_> = self.arrays.keys().filter(|k| k.starts_with("out.") && !checked.contains(*k)).collect();
        assert!(left.is_empty(), "{}: not compared: {left:?}", self.name);
        println!("{}: {} arrays agree", self.name, checked.len());
    }

    fn tolerance(&self, name: &str) -> (f64, f64) {
        let table = self.json["tolerance"].as_object().expect("a case has tolerances");
        let best = table.iter().filter(|(p, _)| fits(p, name)).max_by_key(|(p, _)| p.len());
        let (_, t) = best.unwrap_or_else(|| panic!("{}: no tolerance for `{name}`", self.name));
        (t["abs"].as_f64().expect("abs"), t["rel"].as_f64().unwrap_or(0.0))
    }

    pub fn mesh(&self) -> Mesh {
        self.mesh_of("")
    }

    /// The mesh of a group.
    pub fn mesh_of(&self, group: &str) -> Mesh {
        let faces = self.indices(&self.input(group, "faces"));
        let faces = faces.as_chunks::<3>().0.iter().map(|t| t.map(|v| v as u32));
        Mesh::new(self.points(&self.input(group, "vertices")), faces.collect()).expect("a mesh")
    }

    /// The weights of a table, each row divided by its sum; an empty one is held by the root.
    pub fn weights(&self, name: &str) -> SkinWeights {
        let joints = self.shape(name)[1];
        let rows = self.values(name).chunks_exact(joints).map(|row| {
            let root = if row.iter().sum::<f64>() > 0.0 { 0.0 } else { 1.0 };
            std::iter::once((0, root)).chain(row.iter().enumerate().map(|(j, w)| (j as u16, *w))).collect::<Vec<_>>()
        });
        SkinWeights::normalized(rows).expect("weights")
    }

    /// The rig of a group, with joints at `heads` and the weights of a table.
    pub fn rig(&self, group: &str, heads: &[[f32; 3]], weights: &str) -> Rig {
        let parents = self.values(&self.input(group, "parents"));
        let joints = parents.iter().zip(heads).enumerate().map(|(j, (&parent, &head))| Joint {
            name: format!("joint {j}"),
            parent: (parent >= 0.0).then_some(JointId(parent as u16)),
            head,
        });
        let skeleton = Skeleton::new(joints.collect()).expect("a tree");
        Rig::new(skeleton, self.mesh_of(group), self.weights(weights)).expect("parts that fit")
    }
}

/// A name, and the shorter ones that it begins with: `a_b_c`, `a_b`, `a`.
fn shorter(name: &str) -> impl Iterator<Item = &str> {
    std::iter::successors(Some(name), |name| Some(name.rsplit_once('_')?.0))
}

/// Whether a name is as a pattern says, where a star stands for anything.
fn fits(pattern: &str, name: &str) -> bool {
    match pattern.split_once('*') {
        None => name == pattern,
        Some((first, rest)) => name
            .strip_prefix(first)
            .is_some_and(|left| (0..=left.len()).any(|at| left.is_char_boundary(at) && fits(rest, &left[at..]))),
    }
}

/// The numbers that follow a word in a text, up to the next word: 0.1 of `shift` in "scale 2, shift 0.1 on each".
pub fn after(text: &str, word: &str) -> Vec<f64> {
    let of_a_word = |c: char| c.is_alphanumeric() || c == '_';
    let whole = |at: &usize| !text[..*at].ends_with(of_a_word) && !text[at + word.len()..].starts_with(of_a_word);
    match text.match_indices(word).map(|(at, _)| at).find(whole) {
        Some(at) => leading(&text[at + word.len()..]),
        None => Vec::new(),
    }
}

/// The numbers that a text begins with.
pub fn leading(text: &str) -> Vec<f64> {
    let between = |c: char| c.is_whitespace() || ",;:=()[]".contains(c);
    text.split(between).filter(|w| !w.is_empty()).map_while(|w| w.trim_end_matches('.').parse().ok()).collect()
}

/// A table of weights, row by row, zeros included.
pub fn table(weights: &SkinWeights, joints: usize) -> Vec<f64> {
    let mut out = vec![0.0; weights.rows() * joints];
    for (v, row) in out.chunks_exact_mut(joints).enumerate() {
        weights.row(v).for_each(|(j, w)| row[j.index()] = f64::from(w));
    }
    out
}
