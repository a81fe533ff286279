//! Articulation-XL2.0 (MagicArticulate, Puppeteer): one pickled list of dictionaries in an npz.

use std::ops::ControlFlow;

use super::super::archive::Archive;
use super::super::array_rig::{ArrayRig, SparseRows};
use super::super::budget::Budget;
use super::super::fault::PeerFault;
use super::super::numbers::Numbers;
use super::super::pickle::{self, View};
use super::super::{fields, npy};
use super::{Assets, Give, Wanted};

const LIST: &str = "arr_0";

pub(super) struct Articulation<'a> {
    archive: Archive<'a>,
    count: usize,
}

pub(super) fn open(mut archive: Archive<'_>) -> Result<Articulation<'_>, PeerFault> {
    let count = archive.objects(LIST, |header, _, _| objects(header))?;
    Ok(Articulation { archive, count })
}

fn objects(header: &npy::Header) -> Result<usize, PeerFault> {
    match header.shape[..] {
        [count] if header.dtype.kind == b'O' => Ok(count),
        _ => Err(PeerFault::field(LIST, "is no list of assets: an array of objects with one axis is wanted")),
    }
}

impl Assets for Articulation<'_> {
    fn count(&self) -> usize {
        self.count
    }

    fn each(&mut self, wanted: Wanted, give: Give<'_>) -> Result<(), PeerFault> {
        self.archive.objects(LIST, |header, input, budget: &mut Budget| {
            let count = objects(header)?;
            let mut item = 0;
            let mut ended = false;
            let mut each = |view: View<'_>| {
                let at = item;
                item += 1;
                if !wanted.has(at) {
                    return ControlFlow::Continue(());
                }
                let done = give(at, asset(view, wanted.extras));
                ended = done.is_break() || wanted.item.is_some();
                if ended { ControlFlow::Break(()) } else { done }
            };
            pickle::read(LIST, input, budget, Some(&mut each))?;
            match ended || item == count {
                true => Ok(()),
                false => Err(PeerFault::field(LIST, format!("has {item} assets, its header says {count}"))),
            }
        })
    }
}

/// One dictionary.
fn asset(view: View<'_>, extras: bool) -> Result<ArrayRig, PeerFault> {
    if !view.is_dict() {
        return Err(PeerFault::field(LIST, "has a member that is no dictionary"));
    }
    let vertices = array(view, "vertices")?.rows::<3>("vertices")?;
    let joints = array(view, "joints")?.rows::<3>("joints")?;
    let faces = fields::faces(&array(view, "faces")?.int_rows::<3>("faces")?, vertices.len())?;
    let bones = array(view, "bones")?.int_rows::<2>("bones")?;
    let root = match view.get("root_index") {
        Some(v) => Some(integer(v, "root_index")?),
        None => None,
    };
    let names = match view.get("joint_names") {
        Some(v) if !v.is_none() => v.texts("joint_names")?,
        _ => Vec::new(),
    };
    let mut rig = ArrayRig {
        name: view.get("uuid").and_then(View::text).unwrap_or_default().to_owned(),
        parents: fields::parents_of_bones(&bones, root, joints.len())?,
        weights: weights(view, vertices.len(), joints.len())?,
        names,
        joints,
        vertices,
        faces,
        ..ArrayRig::default()
    };
    if extras {
        for (field, name) in [("normals", "normals"), ("pc_w_norm", "points")] {
            if let Some(v) = view.get(field) {
                rig.extras.insert(name.to_owned(), v.numbers(field)?.array(field)?);
            }
        }
    }
    Ok(rig)
}

fn array<'a>(view: View<'a>, field: &str) -> Result<Numbers<'a>, PeerFault> {
    view.get(field).ok_or_else(|| PeerFault::field(field, "is missing"))?.numbers(field)
}

/// A number, or an array of one.
fn integer(view: View<'_>, field: &str) -> Result<i64, PeerFault> {
    match view.int() {
        Some(n) => Ok(n),
        None => match view.numbers(field)?.ints(field)?[..] {
            [n] => Ok(n),
            _ => Err(PeerFault::field(field, "is no single number")),
        },
    }
}

/// The matrix of weights: values with their rows and columns. The released data call those
/// `_row` and `_col`, the published writer `_rows` and `_cols`.
fn weights(view: View<'_>, vertices: usize, joints: usize) -> Result<Option<SparseRows>, PeerFault> {
    let key = |end: &str| format!("skinning_weights_{end}");
    if view.get(&key("value")).is_none_or(View::is_none) {
        return Ok(None);
    }
    let either = |a: &str, b: &str| if view.get(&key(a)).is_some() { key(a) } else { key(b) };
    let (row, column) = (either("row", "rows"), either("col", "cols"));
    let values = array(view, &key("value"))?.floats(&key("value"))?;
    let rows = array(view, &row)?.ints(&row)?;
    let columns = array(view, &column)?.ints(&column)?;
    if rows.len() != values.len() || columns.len() != values.len() {
        let reason = format!("has {} entries, its rows {} and columns {}", values.len(), rows.len(), columns.len());
        return Err(PeerFault::field(&key("value"), reason));
    }
    if let Some(shape) = view.get(&key("shape")) {
        let shape = match shape.members() {
            Some(members) => members.take(3).map(View::int).collect::<Option<Vec<_>>>().unwrap_or_default(),
            None => shape.numbers(&key("shape"))?.ints(&key("shape"))?,
        };
        if shape != [vertices as i64, joints as i64] {
            let reason = format!("is not {vertices} vertices by {joints} joints");
            return Err(PeerFault::field(&key("shape"), reason));
        }
    }
    let mut triples = Vec::with_capacity(values.len());
    for (at, &value) in values.iter().enumerate() {
        let vertex = fields::number(rows[at], vertices, || format!("`{row}`, entry {at},"), "vertex")?;
        let joint = fields::number(columns[at], joints, || format!("`{column}`, entry {at},"), "joint")?;
        if value != 0.0 {
            triples.push((vertex as u32, joint as u32, value));
        }
    }
    Ok(Some(SparseRows::from_triples(vertices, &triples)))
}
