//! Zip archives of arrays (npz) and of torch (pt).

use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use zip::ZipArchive;
use zip::result::ZipError;

use super::array_rig::SparseRows;
use super::budget::Budget;
use super::fault::{PeerFault, shown};
use super::npy::{self, Header};
use super::numbers::Numbers;
use super::{pickle, zip_claims};

/// Members of an archive that are listed; honest ones have a few, those of torch some ten per asset.
const MEMBERS: usize = 5_000_000;

/// Where a file's bytes are.
#[derive(Clone, Copy)]
pub(crate) enum Input<'a> {
    /// In memory.
    Bytes(&'a [u8]),
    /// On disk: data sets are larger than memory.
    File(&'a Path),
}

/// What an archive is read from.
pub(crate) trait Seekable: Read + Seek {}
impl<T: Read + Seek> Seekable for T {}

impl<'a> Input<'a> {
    /// From the start.
    pub(crate) fn open(self) -> std::io::Result<Box<dyn Seekable + 'a>> {
        Ok(match self {
            Self::Bytes(bytes) => Box::new(Cursor::new(bytes)),
            Self::File(path) => Box::new(BufReader::new(File::open(path)?)),
        })
    }

    /// How many bytes.
    pub(crate) fn len(self) -> std::io::Result<u64> {
        match self {
            Self::Bytes(bytes) => Ok(bytes.len() as u64),
            Self::File(path) => Ok(std::fs::metadata(path)?.len()),
        }
    }
}

/// An open archive, and what its reader may hold.
pub(crate) struct Archive<'a> {
    zip: ZipArchive<Box<dyn Seekable + 'a>>,
    /// What may be held.
    pub budget: Budget,
    /// What may pass through.
    pub passing: Budget,
}

fn unreadable(e: impl std::fmt::Display) -> PeerFault {
    PeerFault::Zip(shown(&e.to_string()))
}

fn found<T>(file: Result<T, ZipError>, name: &str) -> Result<T, PeerFault> {
    file.map_err(|e| match e {
        ZipError::FileNotFound => PeerFault::field(&shown(name), "is missing"),
        e => unreadable(e),
    })
}

impl<'a> Archive<'a> {
    pub(crate) fn open(input: Input<'a>) -> Result<Self, PeerFault> {
        let length = input.len().map_err(unreadable)?;
        zip_claims::check(input)?;
        let zip = ZipArchive::new(input.open().map_err(unreadable)?).map_err(unreadable)?;
        if zip.len() > MEMBERS {
            return Err(unreadable(format!("it lists {} members", zip.len())));
        }
        Ok(Self { zip, budget: Budget::of(length), passing: Budget::passing(length) })
    }

    /// Names of the members.
    pub(crate) fn members(&self) -> impl Iterator<Item = &str> {
        self.zip.file_names()
    }

    /// Whether there is an array of this name.
    pub(crate) fn has(&self, field: &str) -> bool {
        self.zip.index_for_name(&format!("{field}.npy")).is_some()
    }

    /// The names of members, for messages.
    pub(crate) fn listed(&self) -> String {
        let mut names: Vec<&str> = self.members().collect();
        names.sort_unstable();
        let more = names.len().saturating_sub(8);
        names.truncate(8);
        let names: Vec<_> = names.into_iter().map(|n| format!("`{}`", shown(n))).collect();
        format!("{}{}", names.join(", "), if more > 0 { format!(" and {more} more") } else { String::new() })
    }

    /// Reads a member with `read`.
    fn member<T>(
        &mut self,
        name: &str,
        read: impl FnOnce(&mut dyn Read, &mut Budget, &mut Budget) -> Result<T, PeerFault>,
    ) -> Result<T, PeerFault> {
        let file = found(self.zip.by_name(name), name)?;
        read(&mut BufReader::new(file), &mut self.budget, &mut self.passing)
    }

    /// The bytes of a member.
    pub(crate) fn bytes(&mut self, name: &str) -> Result<Vec<u8>, PeerFault> {
        let mut file = found(self.zip.by_name(name), name)?;
        let size = file.size();
        self.budget.take(size, name)?;
        let mut out = Vec::with_capacity(size as usize);
        (&mut file).take(size).read_to_end(&mut out).map_err(unreadable)?;
        // At its end the sum is compared.
        match file.read(&mut [0]).map_err(unreadable)? {
            0 if out.len() as u64 == size => Ok(out),
            _ => Err(unreadable(format!("`{}` has not the {size} bytes it is said to have", shown(name)))),
        }
    }

    /// An array of numbers or text; `None` where it is missing or a pickled `None`.
    pub(crate) fn numbers(&mut self, field: &str) -> Result<Option<Numbers<'static>>, PeerFault> {
        if !self.has(field) {
            return Ok(None);
        }
        self.member(&format!("{field}.npy"), |input, budget, _| {
            let header = npy::header(field, input)?;
            match header.dtype.kind {
                b'O' => no_object(field, input, budget).map(|()| None),
                _ => npy::numbers(field, header, input, budget).map(Some),
            }
        })
    }

    /// Names, in an array of text or of objects that are text; `None` as in [`Self::numbers`].
    pub(crate) fn texts(&mut self, field: &str) -> Result<Option<Vec<String>>, PeerFault> {
        if !self.has(field) {
            return Ok(None);
        }
        self.member(&format!("{field}.npy"), |input, budget, _| {
            let header = npy::header(field, input)?;
            if header.dtype.kind != b'O' {
                return npy::numbers(field, header, input, budget)?.texts(field).map(Some);
            }
            let read = pickle::read(field, input, budget, None)?;
            let (nodes, id) = read.ok_or_else(|| PeerFault::field(field, "is empty"))?;
            let view = pickle::View { nodes: &nodes, id };
            if is_missing(view) { Ok(None) } else { view.texts(field).map(Some) }
        })
    }

    /// As [`Self::numbers`], where the array must be there.
    pub(crate) fn required(&mut self, field: &str) -> Result<Numbers<'static>, PeerFault> {
        self.numbers(field)?.ok_or_else(|| PeerFault::field(field, "is missing"))
    }

    /// A dense matrix without its zeros, and its columns; `None` as in [`Self::numbers`].
    pub(crate) fn sparse(&mut self, field: &str) -> Result<Option<(usize, SparseRows)>, PeerFault> {
        if !self.has(field) {
            return Ok(None);
        }
        self.member(&format!("{field}.npy"), |input, budget, passing| {
            let header = npy::header(field, input)?;
            match header.dtype.kind {
                b'O' => no_object(field, input, budget).map(|()| None),
                _ => npy::sparse(field, header, input, budget, passing).map(Some),
            }
        })
    }

    /// Reads an array of objects with `read`, which is given the count in its header.
    pub(crate) fn objects<T>(
        &mut self,
        field: &str,
        read: impl FnOnce(&Header, &mut dyn Read, &mut Budget) -> Result<T, PeerFault>,
    ) -> Result<T, PeerFault> {
        self.member(&format!("{field}.npy"), |input, budget, _| read(&npy::header(field, input)?, input, budget))
    }
}

/// A pickled `None`, which stands for an array that is not there; any other object is refused.
fn no_object(field: &str, input: &mut dyn Read, budget: &mut Budget) -> Result<(), PeerFault> {
    let read = pickle::read(field, input, budget, None)?;
    let missing = read.as_ref().is_some_and(|(nodes, id)| is_missing(pickle::View { nodes, id: *id }));
    if missing { Ok(()) } else { Err(PeerFault::field(field, "holds objects where numbers should be")) }
}

/// Whether an object is `None`, or an array of nothing else.
fn is_missing(view: pickle::View<'_>) -> bool {
    let mut members = view.members().into_iter().flatten();
    view.is_none() || members.next().is_some_and(pickle::View::is_none) && members.next().is_none()
}

#[cfg(test)]
mod tests {
    use std::io::Write;

    use super::*;

    /// What is read of an npz whose `names` are an array of objects, of which the pickle lists these.
    fn names(members: &[u8]) -> Result<Option<Vec<String>>, PeerFault> {
        let mut header = b"{'descr': '|O', 'fortran_order': False, 'shape': (2,), }".to_vec();
        header.resize(117, b' ');
        header.push(b'\n');
        let array = b"\x80\x03cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\0\x85C\x01b\x87R(K\x01K\x02\x85\
            cnumpy\ndtype\nX\x02\0\0\0O8\x89\x88\x87R(K\x03X\x01\0\0\0|NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x3ftb\x89](";
        let mut zip = zip::ZipWriter::new(Cursor::new(Vec::new()));
        zip.start_file("names.npy", zip::write::SimpleFileOptions::default()).unwrap();
        zip.write_all(&[b"\x93NUMPY\x01\0\x76\0", &header[..], array, members, b"etb."].concat()).unwrap();
        let bytes = zip.finish().unwrap().into_inner();
        Archive::open(Input::Bytes(&bytes))?.texts("names")
    }

    #[test]
    fn names_may_be_objects_that_are_text() {
        let two = names(b"X\x01\0\0\0aX\x02\0\0\0\xc3\xa9").unwrap();
        assert_eq!(two, Some(vec!["a".to_owned(), "\u{e9}".to_owned()]));
        assert_eq!(names(b"N").unwrap(), None);
        let refused = names(b"X\x01\0\0\0aK\x02").unwrap_err().to_string();
        assert!(refused.contains("`names`") && refused.contains("no list of text"), "{refused}");
    }
}
