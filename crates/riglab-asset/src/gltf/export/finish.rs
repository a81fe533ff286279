//! What a changed document no longer needs goes: nodes, accessors, views, bytes.

use serde_json::{Value, json};

use super::draft::{Draft, index, remove};
use super::packed::forget_extension;
use super::references::{self, Kind, SINGLE_ROOT};
use crate::Fault;

/// Renumbers what stays of one kind. `stays` is by old number.
fn renumber(draft: &mut Draft, kind: Kind, list: &str, stays: &[bool]) {
    if stays.iter().all(|s| *s) {
        return;
    }
    let mut next = 0;
    let numbers: Vec<usize> = stays
        .iter()
        .map(|stays| {
            next += usize::from(*stays);
            next.saturating_sub(1)
        })
        .collect();
    references::visit(draft, &mut |found, value| {
        if found == kind
            && let Some(number) = index(value).and_then(|n| numbers.get(n))
        {
            *value = json!(number);
        }
    });
    let mut keep = stays.iter();
    if let Some(all) = draft.json.get_mut(list).and_then(Value::as_array_mut) {
        all.retain(|_| keep.next().copied().unwrap_or(true));
        if all.is_empty() {
            remove(&mut draft.json, list);
        }
    }
}

/// Drops nodes that nothing names any more.
pub(super) fn drop_nodes(draft: &mut Draft, gone: &[bool]) {
    let mut stays: Vec<bool> = gone.iter().map(|g| !g).collect();
    stays.resize(draft.list("nodes").len(), true);
    renumber(draft, Kind::Node, "nodes", &stays);
}

/// Drops accessors, then views, that nothing names, and brings the bytes of the rest together. `base` are
/// the bytes that the draft has elsewhere.
pub(super) fn finish(mut draft: Draft, base: &[u8]) -> Result<Draft, Fault> {
    if !has_single_root(&draft) {
        forget_extension(&mut draft.json, SINGLE_ROOT);
    }
    if references::unknown(&draft).is_empty() {
        for (kind, list) in [(Kind::Accessor, "accessors"), (Kind::View, "bufferViews")] {
            let mut used = vec![false; draft.list(list).len()];
            references::visit(&mut draft, &mut |found, value| {
                if found == kind
                    && let Some(used) = index(value).and_then(|n| used.get_mut(n))
                {
                    *used = true;
                }
            });
            renumber(&mut draft, kind, list, &used);
        }
    }
    gather(draft, base)
}

/// Whether node 0 is the only root of the only scene.
fn has_single_root(draft: &Draft) -> bool {
    matches!(draft.list("scenes"), [scene] if scene["nodes"] == json!([0]))
}

/// Copies the runs of bytes that views show, each once, however many views overlap.
fn gather(mut draft: Draft, base: &[u8]) -> Result<Draft, Fault> {
    let total = base.len() + draft.binary.len();
    let mut runs: Vec<(usize, usize)> = Vec::with_capacity(draft.list("bufferViews").len());
    for (view, value) in draft.list("bufferViews").iter().enumerate() {
        let number = |key: &str| value.get(key).and_then(Value::as_u64).unwrap_or(0);
        let (offset, length) = (number("byteOffset"), number("byteLength"));
        let end = offset.checked_add(length).and_then(|end| usize::try_from(end).ok()).filter(|end| *end <= total);
        let end = end.ok_or(Fault::ViewBounds { view, offset, length, buffer: 0, found: total })?;
        runs.push((offset as usize, end));
    }
    let mut order: Vec<usize> = (0..runs.len()).collect();
    order.sort_by_key(|&v| runs[v]);
    let mut binary: Vec<u8> = Vec::new();
    // The run being copied: its start and end before, and its start after.
    let mut open: Option<(usize, usize, usize)> = None;
    let copy = |binary: &mut Vec<u8>, from: usize, to: usize| {
        let split = base.len();
        binary.extend_from_slice(&base[from.min(split)..to.min(split)]);
        binary.extend_from_slice(&draft.binary[from.max(split) - split..to.max(split) - split]);
    };
    let mut starts = vec![0; runs.len()];
    for view in order {
        let (from, to) = runs[view];
        let (start, end, new) = match open {
            Some((start, end, new)) if from <= end => {
                if to > end {
                    copy(&mut binary, end, to);
                }
                (start, end.max(to), new)
            }
            _ => {
                // As it was aligned before.
                while binary.len() % 8 != from % 8 {
                    binary.push(0);
                }
                let new = binary.len();
                copy(&mut binary, from, to);
                (from, to, new)
            }
        };
        starts[view] = new + (from - start);
        open = Some((start, end, new));
    }
    for (view, start) in draft.list_mut("bufferViews").iter_mut().zip(starts) {
        view["byteOffset"] = json!(start);
    }
    draft.binary = binary;
    draft.base = 0;
    Ok(draft)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_nothing_names_goes_and_shared_bytes_stay_shared() {
        let view = |from: usize, length: usize| json!({"buffer": 0, "byteOffset": from, "byteLength": length});
        let json = json!({
            "accessors": [{"bufferView": 0}, {"bufferView": 1}, {"bufferView": 2}],
            "bufferViews": [view(0, 8), view(4, 3), view(16, 4), view(6, 4)],
            "images": [{"bufferView": 3}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 2, "NORMAL": 1}}]}],
        });
        let base: Vec<u8> = (0..16).collect();
        let draft = Draft { json, base: 16, binary: vec![16, 17, 18, 19] };
        let draft = finish(draft, &base).unwrap();
        assert_eq!(draft.json["accessors"], json!([{"bufferView": 0}, {"bufferView": 1}]));
        assert_eq!(draft.json["meshes"][0]["primitives"][0]["attributes"], json!({"POSITION": 1, "NORMAL": 0}));
        let bytes = |n: usize| {
            let view = &draft.json["bufferViews"][n];
            let [from, length] = ["byteOffset", "byteLength"].map(|k| view[k].as_u64().unwrap() as usize);
            draft.binary[from..from + length].to_vec()
        };
        assert_eq!([bytes(0), bytes(1), bytes(2)], [vec![4, 5, 6], vec![16, 17, 18, 19], vec![6, 7, 8, 9]]);
        assert_eq!(draft.json["images"][0]["bufferView"], 2);
        assert_eq!(draft.binary.len(), 4 + 6 + 6 + 4, "{:?}", draft.binary);
    }

    #[test]
    fn a_document_with_an_unknown_extension_keeps_its_numbers() {
        let left = |says: Value| {
            let json = json!({
                "accessors": [{}, {}], "extensionsUsed": ["ACME_rope", "ACME_stamp"],
                "meshes": [{"primitives": [{"extensions": {"ACME_rope": says}, "extras": {"extensions": {"ACME_stamp": 1}}}]}],
            });
            finish(Draft::new(json), &[]).unwrap().list("accessors").len()
        };
        assert_eq!(left(json!({"knots": 1})), 2);
        // One that says nothing names nothing.
        assert_eq!(left(json!({})), 0);
    }

    #[test]
    fn a_file_of_more_roots_is_not_called_one_of_a_single_root() {
        let used = |roots: Value| {
            let json = json!({"scenes": [{"nodes": roots}], "extensionsUsed": ["GODOT_single_root"]});
            finish(Draft::new(json), &[]).unwrap().list("extensionsUsed").len()
        };
        assert_eq!([json!([0]), json!([0, 1]), json!([1])].map(used), [1, 0, 0]);
    }
}
