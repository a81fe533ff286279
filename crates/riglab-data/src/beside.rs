//! The checksum of a file with what is read beside it: the other half of a pair of rig text and OBJ, and the buffers of a glTF.

use std::path::Path;

use riglab_asset::files_of;

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

/// What a file on disk may have as an asset's checksum: that of the file itself, and with those beside it. Empty where it
/// cannot be read.
pub fn checksums(path: &Path) -> Vec<String> {
    let mut hash = blake3::Hasher::new();
    let read = std::fs::File::open(path).and_then(|open| hash.update_reader(open).map(|_| ()));
    let own = read.map(|()| hash.finalize().to_hex().to_string());
    own.map_or_else(|_| Vec::new(), |own| vec![whole_checksum(path, &own), own])
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
        let own = blake3::hash(b"no JSON").to_hex().to_string();
        assert_eq!((checksums(&path), checksums(dir.path())), (vec![own.clone(), own], Vec::new()));
    }
}
