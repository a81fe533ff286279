//! What is read with a file: the other half of a pair of rig text and OBJ, and the buffers of a glTF.

use std::path::{Path, PathBuf};

use riglab_asset::files_read;
use serde::Deserialize;

/// The files that an asset's file is read from, itself first. Buffers are those of a `.gltf` that lie in its folder, there or
/// not; a GLB that keeps any outside is not asked.
pub fn files_of(path: &Path) -> Vec<PathBuf> {
    let mut files = files_read(path);
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case("gltf")) {
        let folder = path.parent().unwrap_or(Path::new(""));
        let more: Vec<PathBuf> = buffers(path).into_iter().map(|buffer| folder.join(buffer)).collect();
        files.extend(more);
    }
    files
}

/// The checksum of an asset's file with those beside it; `own`, that of the file itself, where there are none.
pub fn whole_checksum(path: &Path, own: &str) -> String {
    let files = files_of(path);
    if files.len() < 2 {
        return own.to_owned();
    }
    let mut hash = blake3::Hasher::new();
    hash.update(own.as_bytes());
    for file in &files[1..] {
        let mut other = blake3::Hasher::new();
        // One that cannot be read was told by whoever needed it.
        let _ = std::fs::File::open(file).and_then(|open| other.update_reader(open).map(|_| ()));
        hash.update(other.finalize().as_bytes());
    }
    hash.finalize().to_hex().to_string()
}

#[derive(Default, Deserialize)]
struct Document {
    #[serde(default)]
    buffers: Vec<Buffer>,
}

#[derive(Deserialize)]
struct Buffer {
    uri: Option<String>,
}

/// The paths that a glTF's buffers name below its folder; what the importer refuses to follow is none.
fn buffers(path: &Path) -> Vec<PathBuf> {
    let bytes = std::fs::read(path).unwrap_or_default();
    let document: Document = serde_json::from_slice(&bytes).unwrap_or_default();
    let uris = document.buffers.into_iter().filter_map(|buffer| buffer.uri);
    let paths = uris.filter_map(|uri| String::from_utf8(percent_decoded(&uri)).ok());
    let below =
        |path: &String| !path.contains([':', '\0']) && !path.starts_with('/') && !path.split('/').any(|p| p == "..");
    let mut paths: Vec<PathBuf> = paths.filter(below).map(PathBuf::from).collect();
    paths.sort();
    paths.dedup();
    paths
}

fn percent_decoded(uri: &str) -> Vec<u8> {
    let digit = |b: Option<&u8>| b.and_then(|b| char::from(*b).to_digit(16)).map(|d| d as u8);
    let (bytes, mut out, mut i) = (uri.as_bytes(), Vec::new(), 0);
    while let Some(&byte) = bytes.get(i) {
        let code = (byte == b'%').then(|| Some((digit(bytes.get(i + 1))?, digit(bytes.get(i + 2))?))).flatten();
        out.push(code.map_or(byte, |(high, low)| 16 * high + low));
        i += if code.is_some() { 3 } else { 1 };
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gltf_is_known_with_its_buffers() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("a.gltf");
        let uris = r#"[{"uri": "of%20a/b.bin"}, {"uri": "data:,"}, {"uri": "../c.bin"}, {"uri": "http://d"}, {}]"#;
        std::fs::write(&path, format!(r#"{{"buffers": {uris}}}"#)).unwrap();
        let buffer = dir.path().join("of a/b.bin");
        assert_eq!(files_of(&path), [path.clone(), buffer.clone()]);
        std::fs::create_dir(dir.path().join("of a")).unwrap();
        let sum = |bytes: &[u8]| {
            std::fs::write(&buffer, bytes).unwrap();
            whole_checksum(&path, "own")
        };
        assert_ne!(sum(b"1"), sum(b"2"));
        assert_eq!(sum(b"1"), sum(b"1"));
        // What is whole in itself keeps its own.
        std::fs::write(&path, "no JSON").unwrap();
        assert_eq!(whole_checksum(&path, "own"), "own");
    }
}
