//! The GLB container: a header, a JSON chunk, and mostly a binary one.

use crate::Fault;

const HEADER: usize = 12;
const JSON: &[u8] = b"JSON";
const BINARY: &[u8] = b"BIN\0";

/// The chunks that matter.
pub(super) struct Chunks<'a> {
    pub(super) json: &'a [u8],
    pub(super) binary: Option<&'a [u8]>,
    /// Bytes after the end by the header.
    pub(super) trailing: usize,
}

/// Takes a GLB apart. Unknown chunks are skipped, as the format asks for.
pub(super) fn chunks(bytes: &[u8]) -> Result<Chunks<'_>, Fault> {
    let (Some(version), Some(claimed)) = (word(bytes, 4), word(bytes, 8)) else {
        return Err(Fault::ShortHeader(bytes.len()));
    };
    if version != 2 {
        return Err(Fault::GlbVersion(version));
    }
    let claimed = claimed as usize;
    let Some(body) = bytes.get(..claimed) else {
        return Err(Fault::Truncated { claimed, found: bytes.len() });
    };
    let mut chunks = Chunks { json: &[], binary: None, trailing: bytes.len() - claimed };
    let mut rest = body.get(HEADER..).unwrap_or_default();
    let mut number = 0;
    while let Some((head, after)) = rest.split_at_checked(8) {
        let length = word(head, 0).unwrap_or_default() as usize;
        let Some((data, next)) = after.split_at_checked(length) else {
            return Err(Fault::ChunkLength { chunk: number, claimed: length, left: after.len() });
        };
        match (number, &head[4..]) {
            (0, JSON) => chunks.json = data,
            (0, _) => return Err(Fault::NoJsonChunk),
            (_, BINARY) if chunks.binary.is_none() => chunks.binary = Some(data),
            _ => {}
        }
        rest = next;
        number += 1;
    }
    if number == 0 {
        return Err(Fault::NoJsonChunk);
    }
    Ok(chunks)
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    bytes.get(at..)?.first_chunk().map(|b| u32::from_le_bytes(*b))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn glb(version: u32, length: u32, chunks: &[(&[u8], u32, &[u8])]) -> Vec<u8> {
        let mut bytes = [b"glTF".as_slice(), &version.to_le_bytes(), &length.to_le_bytes()].concat();
        for (kind, length, data) in chunks {
            bytes.extend([&length.to_le_bytes(), *kind, *data].concat());
        }
        bytes
    }

    #[test]
    fn unknown_chunks_are_skipped_and_trailing_bytes_counted() {
        let bytes =
            glb(2, 12 + 10 + 9 + 11, &[(JSON, 2, b"{}"), (b"XXXX", 1, b"?"), (BINARY, 3, b"abc"), (b"", 7, b"")]);
        let chunks = chunks(&bytes).unwrap();
        assert_eq!((chunks.json, chunks.binary, chunks.trailing), (b"{}".as_slice(), Some(b"abc".as_slice()), 4));
    }

    #[test]
    fn each_fault_has_its_error() {
        let whole = glb(2, 22, &[(JSON, 2, b"{}")]);
        for cut in 4..whole.len() {
            let fault = chunks(&whole[..cut]).err();
            let expected =
                if cut < 12 { Fault::ShortHeader(cut) } else { Fault::Truncated { claimed: 22, found: cut } };
            assert_eq!(fault, Some(expected));
        }
        assert_eq!(chunks(&glb(1, 12, &[])).err(), Some(Fault::GlbVersion(1)));
        assert_eq!(chunks(&glb(2, 12, &[])).err(), Some(Fault::NoJsonChunk));
        assert_eq!(chunks(&glb(2, 0, &[])).err(), Some(Fault::NoJsonChunk));
        assert_eq!(chunks(&glb(2, 22, &[(BINARY, 2, b"{}")])).err(), Some(Fault::NoJsonChunk));
        let long = glb(2, 22, &[(JSON, 3, b"{}")]);
        assert_eq!(chunks(&long).err(), Some(Fault::ChunkLength { chunk: 0, claimed: 3, left: 2 }));
    }
}
