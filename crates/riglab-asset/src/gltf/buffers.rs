//! Buffers and the views into them.
//!
//! Views that meshopt compressed are decoded here, once: the accessor reader above sees plain ones.

use std::borrow::Cow;
use std::cell::OnceCell;
use std::fs::File;
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use base64::Engine;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};

use super::document::{BufferView, Document};
use super::{extensions, meshopt};
use crate::Fault;
use crate::budget::Budget;

/// Writers disagree on padding, and nothing hangs on it.
const BASE64: GeneralPurpose = GeneralPurpose::new(
    &base64::alphabet::STANDARD,
    GeneralPurposeConfig::new()
        .with_decode_padding_mode(DecodePaddingMode::Indifferent)
        .with_decode_allow_trailing_bits(true),
);

/// The bytes of a file's buffers, loaded when first needed.
pub(super) struct Buffers<'a> {
    document: &'a Document,
    binary: Option<&'a [u8]>,
    folder: Option<&'a Path>,
    loaded: Vec<OnceCell<Cow<'a, [u8]>>>,
    /// By view.
    decoded: Vec<OnceCell<Vec<u8>>>,
    budget: Budget,
}

/// A run of bytes that accessors draw from.
#[derive(Clone, Copy)]
pub(super) struct View<'b> {
    pub(super) bytes: &'b [u8],
    /// Bytes from one element to the next; `None`: without a gap.
    pub(super) stride: Option<usize>,
}

/// What a uri stands for.
pub(super) struct Outside {
    pub(super) bytes: Vec<u8>,
    /// Its media type, where the uri says it.
    pub(super) kind: Option<String>,
}

impl<'a> Buffers<'a> {
    pub(super) fn new(
        document: &'a Document,
        binary: Option<&'a [u8]>,
        folder: Option<&'a Path>,
        budget: Budget,
    ) -> Self {
        let loaded = document.buffers.iter().map(|_| OnceCell::new()).collect();
        let decoded = document.buffer_views.iter().map(|_| OnceCell::new()).collect();
        Self { document, binary, folder, loaded, decoded, budget }
    }

    /// What the file may still ask for.
    pub(super) fn budget(&self) -> &Budget {
        &self.budget
    }

    /// A buffer view; `from` says who asks for it.
    pub(super) fn view(&self, number: usize, from: impl Fn() -> String) -> Result<View<'_>, Fault> {
        let views = &self.document.buffer_views;
        let view = views.get(number).ok_or_else(|| Fault::Reference {
            from: from(),
            to: "buffer view",
            index: number,
            count: views.len(),
        })?;
        let bytes = self.decoded(number, view)?.map_or_else(
            || self.run(number, view.buffer, view.byte_offset, view.byte_length),
            |decoded| Ok(decoded.as_slice()),
        )?;
        // A stride of 0 is not allowed, and written by some to say that there is none.
        let stride = view.byte_stride.filter(|s| *s > 0).map(|s| s as usize);
        Ok(View { bytes, stride })
    }

    /// The bytes of a compressed view; its own buffer is then a mere claim, whether there or not.
    fn decoded(&self, number: usize, view: &BufferView) -> Result<Option<&Vec<u8>>, Fault> {
        let Some((extension, settings)) = extensions::meshopt(&view.extensions) else { return Ok(None) };
        if let Some(known) = self.decoded[number].get() {
            return Ok(Some(known));
        }
        let failed = |reason| Fault::Compressed { what: format!("buffer view {number}"), extension, reason };
        let settings = meshopt::Settings::read(settings).map_err(failed)?;
        let bytes = self.run(number, settings.buffer, settings.byte_offset, settings.byte_length)?;
        self.budget.spend(settings.size(bytes).map_err(failed)?, 1)?;
        let decoded = settings.decode(bytes).map_err(failed)?;
        Ok(Some(self.decoded[number].get_or_init(|| decoded)))
    }

    /// A run of bytes of a buffer, for a view.
    fn run(&self, view: usize, buffer: usize, offset: u64, length: u64) -> Result<&[u8], Fault> {
        let bytes = self.bytes(buffer, view)?;
        let span = || {
            let start = usize::try_from(offset).ok()?;
            bytes.get(start..start.checked_add(usize::try_from(length).ok()?)?)
        };
        span().ok_or(Fault::ViewBounds { view, offset, length, buffer, found: bytes.len() })
    }

    /// A whole buffer, for a view.
    pub(super) fn bytes(&self, number: usize, view: usize) -> Result<&[u8], Fault> {
        let cell = self.loaded.get(number).ok_or_else(|| Fault::Reference {
            from: format!("buffer view {view}"),
            to: "buffer",
            index: number,
            count: self.loaded.len(),
        })?;
        if let Some(bytes) = cell.get() {
            return Ok(bytes);
        }
        let bytes = self.load(number)?;
        Ok(cell.get_or_init(|| bytes))
    }

    /// The bytes of a buffer, at most as many as it claims: what follows is padding or not its own.
    fn load(&self, number: usize) -> Result<Cow<'a, [u8]>, Fault> {
        let buffer = &self.document.buffers[number];
        let claimed = usize::try_from(buffer.byte_length).unwrap_or(usize::MAX);
        let Some(uri) = &buffer.uri else {
            let binary = self.binary.filter(|_| number == 0).ok_or(Fault::NoBinaryChunk(number))?;
            return Ok(Cow::Borrowed(&binary[..claimed.min(binary.len())]));
        };
        let mut bytes = match uri.strip_prefix("data:") {
            Some(data) => from_data(data).map_err(|reason| Fault::Base64 { buffer: number, reason })?,
            None => {
                let bytes = self.external(number, uri, buffer.byte_length)?;
                self.budget.add_buffer(bytes.len());
                bytes
            }
        };
        bytes.truncate(claimed);
        Ok(Cow::Owned(bytes))
    }

    /// What a picture's uri stands for: the data in it, or a file in the folder of at most `limit` bytes.
    pub(super) fn outside(&self, picture: usize, uri: &str, limit: u64) -> Result<Outside, Fault> {
        let Some(data) = uri.strip_prefix("data:") else {
            let bytes = self.external(picture, uri, limit.saturating_add(1))?;
            let count = bytes.len() as u64;
            let too_large = || Fault::TooLarge { what: format!("image {picture}"), count, limit };
            return if count > limit { Err(too_large()) } else { Ok(Outside { bytes, kind: None }) };
        };
        let bytes = from_data(data).map_err(|reason| Fault::Base64 { buffer: picture, reason })?;
        let kind = data.split([';', ',']).next().map(str::to_ascii_lowercase);
        Ok(Outside { bytes, kind })
    }

    /// Nothing is opened before it is sure to lie in the folder.
    fn external(&self, buffer: usize, uri: &str, claimed: u64) -> Result<Vec<u8>, Fault> {
        let shown = || uri.chars().take(200).collect::<String>();
        let path = local_path(uri).map_err(|refused| match refused {
            Refused::Scheme => Fault::UriScheme { buffer, uri: shown() },
            Refused::Outside => Fault::UriOutside { buffer, uri: shown() },
        })?;
        let failed = |reason: String| Fault::BufferFile { buffer, uri: shown(), reason };
        let folder = self.folder.ok_or_else(|| failed("the folder of the file is not known".into()))?;
        let resolve = |path: &Path| path.canonicalize().map_err(|e| failed(e.to_string()));
        let (folder, path) = (resolve(folder)?, resolve(&folder.join(path))?);
        // A link may lead anywhere.
        if !path.starts_with(&folder) {
            return Err(Fault::UriOutside { buffer, uri: shown() });
        }
        read_at_most(&path, claimed).map_err(|e| failed(e.to_string()))
    }
}

fn read_at_most(path: &Path, limit: u64) -> io::Result<Vec<u8>> {
    // A pipe would wait for ever, and must not even be opened.
    if !path.metadata()?.is_file() {
        return Err(io::Error::other("not a regular file"));
    }
    let mut bytes = Vec::new();
    File::open(path)?.take(limit).read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn from_data(data: &str) -> Result<Vec<u8>, String> {
    let (kind, text) = data.split_once(',').ok_or("no comma")?;
    if !kind.to_ascii_lowercase().ends_with(";base64") {
        return Err("it is not marked as such".into());
    }
    BASE64.decode(text).map_err(|e| e.to_string())
}

#[derive(Debug, PartialEq)]
enum Refused {
    Scheme,
    Outside,
}

/// The files in a folder that the buffers of a document are in, there or not; none where it is no document.
pub(crate) fn buffers_named(document: &[u8], folder: &Path) -> Vec<PathBuf> {
    #[derive(Default, serde::Deserialize)]
    struct Named {
        #[serde(default)]
        buffers: Vec<Buffer>,
    }
    #[derive(serde::Deserialize)]
    struct Buffer {
        uri: Option<String>,
    }
    let named: Named = serde_json::from_slice(super::document::body(document)).unwrap_or_default();
    let uris = named.buffers.into_iter().filter_map(|buffer| buffer.uri);
    let mut files: Vec<PathBuf> = uris.filter_map(|uri| Some(folder.join(local_path(&uri).ok()?))).collect();
    files.sort();
    files.dedup();
    files
}

/// The relative path that a uri names, percent signs decoded.
fn local_path(uri: &str) -> Result<PathBuf, Refused> {
    let decoded = percent_decoded(uri);
    let path = std::str::from_utf8(&decoded).map_err(|_| Refused::Scheme)?;
    // `http:`, `file:`, and drives of Windows.
    if path.contains([':', '\0']) {
        return Err(Refused::Scheme);
    }
    let parts = || path.split(['/', '\\']);
    if parts().next() == Some("") || parts().any(|part| part == "..") {
        return Err(Refused::Outside);
    }
    Ok(parts().collect())
}

/// `%20` and the like; a percent sign that is none is left, as some writers do not encode at all.
fn percent_decoded(uri: &str) -> Vec<u8> {
    let digit = |b: Option<&u8>| b.and_then(|b| char::from(*b).to_digit(16)).map(|d| d as u8);
    let bytes = uri.as_bytes();
    let mut out = Vec::with_capacity(bytes.len());
    let mut i = 0;
    while let Some(&byte) = bytes.get(i) {
        match (byte, digit(bytes.get(i + 1)), digit(bytes.get(i + 2))) {
            (b'%', Some(high), Some(low)) => {
                out.push(16 * high + low);
                i += 3;
            }
            _ => {
                out.push(byte);
                i += 1;
            }
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_paths_below_the_folder_are_taken() {
        assert_eq!(local_path("parts%20of/a%C3%A9%25.bin"), Ok(PathBuf::from("parts of/aé%.bin")));
        assert_eq!(local_path("50%.bin"), Ok(PathBuf::from("50%.bin")));
        for outside in ["../a", "a/../../b", "%2e%2e/a", "%2e%2e%2fa", "/etc/passwd", "\\\\host\\a", "a\\..\\b", "%2Fa"]
        {
            assert_eq!(local_path(outside), Err(Refused::Outside), "{outside}");
        }
        for scheme in ["http://a/b", "file:///a", "C:\\a", "c%3a/a", "a%00", "%ff"] {
            assert_eq!(local_path(scheme), Err(Refused::Scheme), "{scheme}");
        }
    }

    #[test]
    fn files_of_buffers_are_those_that_are_followed() {
        let uris = r#"[{"uri": "of%20a/b.bin"}, {"uri": "data:,"}, {"uri": "../c.bin"}, {"uri": "http://d"}, {}]"#;
        let document = format!(r#"{{"buffers": {uris}}}"#);
        assert_eq!(buffers_named(document.as_bytes(), Path::new("x")), [PathBuf::from("x/of a/b.bin")]);
        assert!(buffers_named(b"no JSON", Path::new("x")).is_empty());
    }

    #[test]
    fn data_uris_are_base64_with_or_without_padding() {
        assert_eq!(from_data("application/octet-stream;base64,AAE="), Ok(vec![0, 1]));
        assert_eq!(from_data(";base64,AAE"), Ok(vec![0, 1]));
        for bad in ["base64", "text/plain,abc", ";base64,A*E="] {
            assert!(from_data(bad).is_err(), "{bad}");
        }
    }
}
