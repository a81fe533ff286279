//! Archives that stay archives: a member is changed, and the sums are made anew. Blind changes of an
//! archive's bytes nearly always end at its sums.

use std::io::{Cursor, Read, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipArchive, ZipWriter};

/// What a member may unpack to.
const MEMBER: u64 = 1 << 18;

/// Members of an archive at most.
const MEMBERS: usize = 256;

/// How many bytes at a member's start say what it holds; the rest of large ones is data.
const START: usize = 256;

/// A mutator for libFuzzer: changes one member of the archive in `data[..size]`, or, once in eight times
/// and where there is no archive, any bytes. Gives the new size, at most `most`.
pub fn mutate(data: &mut [u8], size: usize, most: usize, seed: u32) -> usize {
    let [which, how, pack, _] = seed.to_le_bytes();
    let archive = if how % 8 == 0 { None } else { members(&data[..size]) };
    let changed = archive.and_then(|mut members| {
        let chosen = usize::from(which) % members.len().max(1);
        change(&mut members.get_mut(chosen)?.1, how % 2 == 0);
        packed(&members, if pack % 2 == 0 { CompressionMethod::Stored } else { CompressionMethod::Deflated })
    });
    match changed {
        Some(archive) if archive.len() <= most => {
            data[..archive.len()].copy_from_slice(&archive);
            archive.len()
        }
        _ => libfuzzer_sys::fuzzer_mutate(data, size, most),
    }
}

/// Changes a member anywhere, with room to grow, or at its start alone.
fn change(content: &mut Vec<u8>, start: bool) {
    if start && content.len() > START {
        let length = libfuzzer_sys::fuzzer_mutate(&mut content[..START], START, START);
        content.drain(length..START);
    } else {
        let length = content.len();
        let most = length + length / 4 + 64;
        content.resize(most, 0);
        let length = libfuzzer_sys::fuzzer_mutate(content, length, most);
        content.truncate(length);
    }
}

fn members(archive: &[u8]) -> Option<Vec<(String, Vec<u8>)>> {
    let mut zip = ZipArchive::new(Cursor::new(archive)).ok().filter(|zip| zip.len() <= MEMBERS)?;
    let count = zip.len();
    let member = |at| {
        let file = zip.by_index(at).ok()?;
        let (name, mut content) = (file.name().to_owned(), Vec::new());
        file.take(MEMBER).read_to_end(&mut content).ok()?;
        Some((name, content))
    };
    (0..count).map(member).collect()
}

fn packed(members: &[(String, Vec<u8>)], method: CompressionMethod) -> Option<Vec<u8>> {
    let mut zip = ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in members {
        zip.start_file(name.as_str(), SimpleFileOptions::default().compression_method(method)).ok()?;
        zip.write_all(content).ok()?;
    }
    Some(zip.finish().ok()?.into_inner())
}
