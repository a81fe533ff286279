//! A glTF document that is being altered: its JSON as it stands, and one run of bytes.
//!
//! Everything is looked at through `get`, so members that other programs added, or wrote with other
//! types, stay as they are.

use serde_json::{Value, json};

/// What a buffer view is for: vertices and indices, as the GPU takes them.
pub(super) const ARRAY: u32 = 34962;
pub(super) const ELEMENTS: u32 = 34963;
/// Component types.
pub(super) const U8: u32 = 5121;
pub(super) const U16: u32 = 5123;
pub(super) const U32: u32 = 5125;
pub(super) const F32: u32 = 5126;

/// A document whose views all lie in one run of bytes.
#[derive(Debug)]
pub(super) struct Draft {
    pub(super) json: Value,
    /// How many bytes there are already, elsewhere: those of the file, which can be read meanwhile.
    pub(super) base: usize,
    /// What comes behind them.
    pub(super) binary: Vec<u8>,
}

/// Elements as an accessor shows them.
#[derive(Clone, Copy)]
pub(super) struct Layout {
    pub(super) component: u32,
    pub(super) shape: &'static str,
    /// Bytes of an element.
    pub(super) size: usize,
}

pub(super) const SCALAR: Layout = Layout { component: F32, shape: "SCALAR", size: 4 };
pub(super) const VEC2: Layout = Layout { component: F32, shape: "VEC2", size: 8 };
pub(super) const VEC3: Layout = Layout { component: F32, shape: "VEC3", size: 12 };
pub(super) const VEC4: Layout = Layout { component: F32, shape: "VEC4", size: 16 };
pub(super) const MAT4: Layout = Layout { component: F32, shape: "MAT4", size: 64 };

impl Draft {
    pub(super) fn new(json: Value) -> Self {
        Self { json, base: 0, binary: Vec::new() }
    }

    /// Takes the bytes out; what is added comes behind them.
    pub(super) fn freeze(&mut self) -> Vec<u8> {
        self.binary.resize(self.binary.len().next_multiple_of(8), 0);
        self.base += self.binary.len();
        std::mem::take(&mut self.binary)
    }

    /// A list at the top of the document; empty where there is none.
    pub(super) fn list(&self, name: &str) -> &[Value] {
        self.json.get(name).and_then(Value::as_array).map_or(&[], Vec::as_slice)
    }

    /// The same, to be changed. What has another type than a list is none.
    pub(super) fn list_mut(&mut self, name: &str) -> &mut [Value] {
        self.json.get_mut(name).and_then(Value::as_array_mut).map_or(&mut [], Vec::as_mut_slice)
    }

    /// Adds to a list at the top of the document; gives the number of what was added.
    pub(super) fn push(&mut self, name: &str, value: Value) -> usize {
        if !self.json.get(name).is_some_and(Value::is_array) {
            self.json[name] = json!([]);
        }
        let list = self.json[name].as_array_mut().expect("made above");
        list.push(value);
        list.len() - 1
    }

    /// Sets an extension of the document, and lists it as used.
    pub(super) fn extend_with(&mut self, name: &str, value: Value) {
        if !self.json.get("extensions").is_some_and(Value::is_object) {
            self.json["extensions"] = json!({});
        }
        self.json["extensions"][name] = value;
        self.uses(name);
    }

    /// Lists an extension as used.
    pub(super) fn uses(&mut self, name: &str) {
        if !self.list("extensionsUsed").iter().any(|used| used == name) {
            self.push("extensionsUsed", json!(name));
        }
    }

    /// Hangs a node on another, before its other children or behind them.
    pub(super) fn add_child(&mut self, parent: usize, child: usize, first: bool) {
        let Some(parent) = self.list_mut("nodes").get_mut(parent) else { return };
        match parent.get_mut("children").and_then(Value::as_array_mut) {
            Some(children) => children.insert(if first { 0 } else { children.len() }, json!(child)),
            None => parent["children"] = json!([child]),
        }
    }

    /// Adds bytes as a view; gives its number.
    pub(super) fn view(&mut self, bytes: &[u8], target: Option<u32>, stride: Option<usize>) -> usize {
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        let mut view = json!({"buffer": 0, "byteOffset": self.base + self.binary.len(), "byteLength": bytes.len()});
        if let Some(target) = target {
            view["target"] = json!(target);
        }
        if let Some(stride) = stride {
            view["byteStride"] = json!(stride);
        }
        self.binary.extend_from_slice(bytes);
        self.push("bufferViews", view)
    }

    /// Adds elements as a view and an accessor over all of it; gives the accessor's number.
    pub(super) fn accessor(&mut self, bytes: &[u8], layout: Layout, target: Option<u32>) -> usize {
        let view = self.view(bytes, target, None);
        let Layout { component, shape, size } = layout;
        let count = bytes.len() / size;
        let accessor = json!({"bufferView": view, "componentType": component, "type": shape, "count": count});
        self.push("accessors", accessor)
    }

    /// Adds the times of frames at a steady rate, in seconds from 0.
    pub(super) fn times(&mut self, frames: usize, rate: f32) -> usize {
        let times: Vec<f32> = (0..frames).map(|frame| (frame as f64 / f64::from(rate)) as f32).collect();
        let bytes: Vec<u8> = times.iter().flat_map(|t| t.to_le_bytes()).collect();
        let number = self.accessor(&bytes, SCALAR, None);
        let bounds = times.first().zip(times.last());
        let own = &mut self.list_mut("accessors")[number];
        (own["min"], own["max"]) =
            bounds.map_or((json!([]), json!([])), |(first, last)| (json!([first]), json!([last])));
        number
    }

    /// Adds vectors of floats; positions get the bounds that glTF asks for.
    pub(super) fn vectors(&mut self, of: &[[f32; 3]], bounds: bool, target: Option<u32>) -> usize {
        // An iterator over bytes would take several times as long; see the benchmark `export`.
        let mut bytes = Vec::with_capacity(VEC3.size * of.len());
        of.as_flattened().iter().for_each(|x| bytes.extend_from_slice(&x.to_le_bytes()));
        let number = self.accessor(&bytes, VEC3, target);
        if bounds && !of.is_empty() {
            let bound = |pick: fn(f32, f32) -> f32| -> [f32; 3] {
                std::array::from_fn(|k| of.iter().map(|p| p[k]).reduce(pick).unwrap_or(0.0))
            };
            self.list_mut("accessors")[number]["min"] = json!(bound(f32::min));
            self.list_mut("accessors")[number]["max"] = json!(bound(f32::max));
        }
        number
    }

    /// The document as a GLB; nothing lies elsewhere. Fails with its length where that is more than the
    /// format can say.
    pub(super) fn into_glb(mut self) -> Result<Vec<u8>, usize> {
        debug_assert_eq!(self.base, 0);
        if self.binary.is_empty() {
            self.json.as_object_mut().map(|top| top.remove("buffers"));
        } else {
            if !self.json["buffers"][0].is_object() {
                self.json["buffers"] = json!([{}]);
            }
            self.json["buffers"][0]["byteLength"] = json!(self.binary.len());
        }
        container(self.json.to_string().into_bytes(), self.binary)
    }
}

/// Header, JSON chunk, binary chunk.
pub(in crate::gltf) fn container(mut json: Vec<u8>, mut bytes: Vec<u8>) -> Result<Vec<u8>, usize> {
    json.resize(json.len().next_multiple_of(4), b' ');
    bytes.resize(bytes.len().next_multiple_of(4), 0);
    let chunks: Vec<(&[u8; 4], Vec<u8>)> =
        [(b"JSON", json), (b"BIN\0", bytes)].into_iter().filter(|(_, chunk)| !chunk.is_empty()).collect();
    let total = 12 + chunks.iter().map(|(_, chunk)| 8 + chunk.len()).sum::<usize>();
    let length = u32::try_from(total).map_err(|_| total)?;
    let mut out = Vec::with_capacity(total);
    out.extend(b"glTF");
    out.extend(2u32.to_le_bytes());
    out.extend(length.to_le_bytes());
    for (kind, chunk) in chunks {
        out.extend((chunk.len() as u32).to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    Ok(out)
}

/// A number that names something.
pub(super) fn index(value: &Value) -> Option<usize> {
    value.as_u64().and_then(|n| usize::try_from(n).ok())
}

/// Takes a member away.
pub(super) fn remove(from: &mut Value, key: &str) -> Option<Value> {
    from.as_object_mut().and_then(|o| o.remove(key))
}
