//! The JSON of a glTF file, as far as rigs go.
//!
//! Plain structs instead of a complete model of the format: what does not touch a rig (materials,
//! pictures, cameras) cannot stop an import, and errors say where they are.

use std::collections::BTreeMap;
use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{MapAccess, Visitor};
use serde::{Deserialize, Deserializer};
use serde_json::Value;

use crate::Fault;
use crate::marked::unmarked;

/// Brackets within brackets that are still read. Real files need a dozen.
const MAX_DEPTH: usize = 100;

/// Values of the JSON in small files; larger ones may have one for every [`VALUE`] bytes. Two bytes of JSON can take
/// thirty of memory.
const MAX_VALUES: usize = 1 << 20;
const VALUE: usize = 8;

/// Nodes, which take hundreds of bytes each: more than any rig has joints.
const MAX_NODES: usize = 1 << 16;

#[derive(Debug, Default, Deserialize)]
#[serde(rename_all = "camelCase", default)]
pub(super) struct Document {
    #[serde(deserialize_with = "object")]
    pub asset: AssetInfo,
    pub extensions_required: Vec<String>,
    /// Parts of files read here are loose in their types: VRM in the wild is.
    pub extensions: Value,
    /// As loose: no rig needs them.
    pub scene: Value,
    pub scenes: Value,
    #[serde(deserialize_with = "objects")]
    pub buffers: Vec<Buffer>,
    #[serde(deserialize_with = "objects")]
    pub buffer_views: Vec<BufferView>,
    #[serde(deserialize_with = "objects")]
    pub accessors: Vec<Accessor>,
    #[serde(deserialize_with = "objects")]
    pub meshes: Vec<Mesh>,
    #[serde(deserialize_with = "objects")]
    pub nodes: Vec<Node>,
    #[serde(deserialize_with = "objects")]
    pub skins: Vec<Skin>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct AssetInfo {
    pub version: String,
    pub copyright: Value,
    pub extras: Value,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Buffer {
    pub byte_length: u64,
    pub uri: Option<String>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub byte_length: u64,
    pub byte_stride: Option<u32>,
    #[serde(default)]
    pub extensions: BTreeMap<String, Value>,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<usize>,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
    #[serde(default)]
    pub normalized: bool,
    pub count: u64,
    #[serde(rename = "type")]
    pub shape: String,
    #[serde(default, deserialize_with = "object_or_none")]
    pub sparse: Option<Sparse>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Sparse {
    pub count: u64,
    #[serde(deserialize_with = "object")]
    pub indices: SparseIndices,
    #[serde(deserialize_with = "object")]
    pub values: SparseValues,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseIndices {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: u64,
    pub component_type: u32,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct SparseValues {
    pub buffer_view: usize,
    #[serde(default)]
    pub byte_offset: u64,
}

#[derive(Debug, Deserialize)]
pub(super) struct Mesh {
    #[serde(default)]
    pub name: Value,
    /// Of morph targets; as loose as those of a node.
    #[serde(default)]
    pub weights: Value,
    #[serde(default, deserialize_with = "objects")]
    pub primitives: Vec<Primitive>,
}

#[derive(Debug, Deserialize)]
pub(super) struct Primitive {
    #[serde(default)]
    pub attributes: BTreeMap<String, usize>,
    pub indices: Option<usize>,
    pub mode: Option<u32>,
    /// Morph targets, as loose as their weights.
    #[serde(default)]
    pub targets: Value,
    #[serde(default)]
    pub extensions: BTreeMap<String, Value>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub name: Option<String>,
    pub children: Vec<usize>,
    pub mesh: Option<usize>,
    pub skin: Option<usize>,
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    pub weights: Value,
    pub extras: Value,
    pub extensions: Value,
}

#[derive(Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Skin {
    #[serde(default)]
    pub joints: Vec<usize>,
    pub inverse_bind_matrices: Option<usize>,
    pub skeleton: Option<usize>,
}

/// What is an object in the file. Structs are read from lists as well, member by member, but what a file is altered by goes by
/// the names of members.
struct Object<T>(T);

impl<'de, T: Deserialize<'de>> Deserialize<'de> for Object<T> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        object(from).map(Self)
    }
}

fn object<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<T, D::Error> {
    struct Members<T>(PhantomData<T>);
    impl<'de, T: Deserialize<'de>> Visitor<'de> for Members<T> {
        type Value = T;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("an object")
        }

        fn visit_map<A: MapAccess<'de>>(self, members: A) -> Result<T, A::Error> {
            T::deserialize(MapAccessDeserializer::new(members))
        }
    }
    from.deserialize_map(Members(PhantomData))
}

fn objects<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<Vec<T>, D::Error> {
    Ok(Vec::<Object<T>>::deserialize(from)?.into_iter().map(|Object(own)| own).collect())
}

fn object_or_none<'de, T: Deserialize<'de>, D: Deserializer<'de>>(from: D) -> Result<Option<T>, D::Error> {
    Ok(Option::<Object<T>>::deserialize(from)?.map(|Object(own)| own))
}

impl Accessor {
    /// What it says of its elements, without bytes; of its type no more than `letters` bytes, as copies may be many.
    pub(super) fn bare_copy(&self, letters: usize) -> Self {
        Self {
            buffer_view: None,
            byte_offset: 0,
            component_type: self.component_type,
            normalized: self.normalized,
            count: self.count,
            shape: self.shape.chars().take(letters).collect(),
            sparse: None,
        }
    }
}

impl Document {
    /// Reads and checks the version; references are checked where they are followed.
    pub(super) fn parse(json: &[u8]) -> Result<Self, Fault> {
        let json = text(json)?;
        let (depth, values) = extent(json.as_bytes());
        if depth > MAX_DEPTH {
            return Err(Fault::JsonDepth(MAX_DEPTH));
        }
        let too_large = |what: &str, count: usize, limit: usize| Fault::TooLarge {
            what: what.into(),
            count: count as u64,
            limit: limit as u64,
        };
        let limit = MAX_VALUES.max(json.len() / VALUE);
        if values > limit {
            return Err(too_large("the values of the JSON", values, limit));
        }
        let Object(document): Object<Self> = serde_json::from_str(json).map_err(|_| explain(json))?;
        let nodes = document.nodes.len();
        if nodes > MAX_NODES {
            return Err(too_large("the nodes", nodes, MAX_NODES));
        }
        match document.asset.version.split('.').next() {
            Some("2") => Ok(document),
            _ => Err(Fault::Version(document.asset.version)),
        }
    }
}

/// The JSON without what writers put around it: a byte-order mark, and zeros instead of blanks.
pub(super) fn body(json: &[u8]) -> &[u8] {
    let json = unmarked(json).trim_ascii_end();
    &json[..json.len() - json.iter().rev().take_while(|b| **b == 0).count()]
}

/// The same as text.
pub(super) fn text(json: &[u8]) -> Result<&str, Fault> {
    // Before serde, which does not look at what it skips.
    std::str::from_utf8(body(json)).map_err(|error| {
        let reason = format!("byte {} is no letter of UTF-8, which glTF is written in", error.valid_up_to());
        Fault::Json { path: String::new(), reason }
    })
}

/// Reads once more, slower, keeping track of where it is.
fn explain(json: &str) -> Fault {
    let mut reader = serde_json::Deserializer::from_str(json);
    match serde_path_to_error::deserialize::<_, Object<Document>>(&mut reader) {
        Err(error) => {
            let path = error.path().to_string();
            let path = if path == "." { String::new() } else { path };
            // Keys and texts come from the file and may be of any length.
            Fault::Json { path: cut(&path), reason: cut(&error.into_inner().to_string()) }
        }
        // Sound but for what follows it.
        Ok(_) => match reader.end() {
            Err(error) => Fault::Json { path: String::new(), reason: error.to_string() },
            Ok(()) => Fault::Json { path: String::new(), reason: "not readable".into() },
        },
    }
}

/// A text short enough for a message, with its end, which says where.
fn cut(text: &str) -> String {
    const HALF: usize = 150;
    let length = text.chars().count();
    if length <= 2 * HALF {
        return text.to_owned();
    }
    let (start, end) = (text.chars().take(HALF), text.chars().skip(length - HALF));
    start.chain("...".chars()).chain(end).collect()
}

/// How deep brackets nest, and about how many values there are; strings left out.
fn extent(json: &[u8]) -> (usize, usize) {
    let (mut depth, mut deepest, mut values) = (0usize, 0, 1);
    let mut bytes = json.iter();
    while let Some(byte) = bytes.next() {
        match byte {
            b'[' | b'{' => {
                depth += 1;
                values += 1;
                deepest = deepest.max(depth);
            }
            b']' | b'}' => depth = depth.saturating_sub(1),
            b',' => values += 1,
            b'"' => {
                while let Some(byte) = bytes.next() {
                    match byte {
                        b'\\' => drop(bytes.next()),
                        b'"' => break,
                        _ => {}
                    }
                }
            }
            _ => {}
        }
    }
    (deepest, values)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn brackets_in_strings_do_not_nest() {
        assert_eq!(extent(br#"{"a\"[,[[":[1,[2]],"b":{}}"#), (3, 7));
        assert_eq!(extent(b"]]]][\"[[["), (1, 2));
    }

    #[test]
    fn errors_say_where() {
        let fault = |json: &str| Document::parse(json.as_bytes()).unwrap_err().to_string();
        let text = fault(r#"{"asset":{"version":"2.0"},"accessors":[{"bufferView":-1}]}"#);
        assert!(text.starts_with("invalid JSON at accessors[0].bufferView: invalid value: integer `-1`"), "{text}");
        assert!(fault("{} x").contains("trailing characters"), "{}", fault("{} x"));
        assert!(fault("{\"nodes\":[").contains("EOF"), "{}", fault("{\"nodes\":["));
        assert_eq!(fault(r#"{"asset":{"version":"1.0"}}"#), Fault::Version("1.0".into()).to_string());
        assert_eq!(fault("{}"), Fault::Version(String::new()).to_string());
        let long = "é".repeat(1000);
        for json in [format!(r#"{{"{long}":1"#), format!(r#"{{"accessors":[{{"componentType":"{long}"}}]}}"#)] {
            let text = fault(&json);
            assert!(text.chars().count() < 500 && text.ends_with(|c: char| c.is_ascii_digit()), "{text}");
        }
        // What has members is no list of them.
        let version = r#""asset":{"version":"2.0"}"#;
        for (own, place) in [
            (r#""bufferViews":[[0,0,120,null,{}]]"#, "bufferViews[0]"),
            (r#""meshes":[{"primitives":[[{}]]}]"#, "meshes[0].primitives[0]"),
            (r#""nodes":[{},[]]"#, "nodes[1]"),
        ] {
            let text = fault(&format!("{{{version},{own}}}"));
            assert!(text.starts_with(&format!("invalid JSON at {place}: invalid type: sequence, expected")), "{text}");
        }
        assert!(fault(r#"["2.0"]"#).contains("sequence, expected an object"), "{}", fault(r#"["2.0"]"#));
        let deep = format!("{{\"extras\":{}", "[".repeat(10_000));
        assert_eq!(fault(&deep), Fault::JsonDepth(MAX_DEPTH).to_string());
    }
}
