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
    let shared = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/golden");
    let dir = std::env::var_os("RIGLAB_GOLDEN").map_or(shared, PathBuf::from).join(sub);
    let Ok(entries) = std::fs::read_dir(&dir) else {
        println!("skipped: no such folder {} (set RIGLAB_GOLDEN)", dir.display());
        return Vec::new();
    };
    let files = entries.filter_map(|e| e.ok()?.file_name().to_str()?.strip_suffix(".safetensors").map(String::from));
    let mut names: Vec<String> = files.filter(|n| n.starts_with(kind)).collect();
    names.sort();
    assert!(!names.is_empty(), "{}: no case of {kind}", dir.display());
    names.iter().map(|name| Golden::read(&dir, name)).collect()
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

    /// The groups of outputs: what stands between `out.` and the next dot.
    pub fn groups(&self) -> BTreeSet<String> {
        let outputs = self.arrays.keys().filter_map(|k| k.strip_prefix("out."));
        outputs.map(|rest| rest.split('.').next().expect("one part").to_string()).collect()
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

    /// Compares with the expected array: |got - want| <= abs + rel |want|. Counts as compared.
    pub fn check(&self, name: &str, got: impl IntoIterator<Item = f64>) {
        let got: Vec<f64> = got.into_iter().collect();
        let want = self.values(name);
        let (abs, rel) = self.tolerance(name);
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
        // A star stands for anything, at the end or between dots.
        let fits = |pattern: &str| match pattern.split_once('*') {
            Some((first, last)) => {
                name.len() >= first.len() + last.len() && name.starts_with(first) && name.ends_with(last)
            }
            None => name == pattern,
        };
        let best = table.iter().filter(|(p, _)| fits(p)).max_by_key(|(p, _)| p.len());
        let (_, t) = best.unwrap_or_else(|| panic!("{}: no tolerance for `{name}`", self.name));
        (t["abs"].as_f64().expect("abs"), t["rel"].as_f64().unwrap_or(0.0))
    }

    pub fn mesh(&self) -> Mesh {
        let faces = self.indices("in.faces");
        let faces = faces.as_chunks::<3>().0.iter().map(|t| t.map(|v| v as u32));
        Mesh::new(self.points("in.vertices"), faces.collect()).expect("a mesh")
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

    /// The rig with joints at `heads` and the weights of a table.
    pub fn rig(&self, heads: &[[f32; 3]], weights: &str) -> Rig {
        let parents = self.values("in.parents");
        let joints = parents.iter().zip(heads).enumerate().map(|(j, (&parent, &head))| Joint {
            name: format!("joint {j}"),
            parent: (parent >= 0.0).then_some(JointId(parent as u16)),
            head,
        });
        let skeleton = Skeleton::new(joints.collect()).expect("a tree");
        Rig::new(skeleton, self.mesh(), self.weights(weights)).expect("parts that fit")
    }
}

/// A table of weights, row by row, zeros included.
pub fn table(weights: &SkinWeights, joints: usize) -> Vec<f64> {
    let mut out = vec![0.0; weights.rows() * joints];
    for (v, row) in out.chunks_exact_mut(joints).enumerate() {
        weights.row(v).for_each(|(j, w)| row[j.index()] = f64::from(w));
    }
    out
}
