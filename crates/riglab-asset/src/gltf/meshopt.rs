//! `EXT_meshopt_compression` and its Khronos successor: buffer views in meshoptimizer's codecs.

use meshopt::{
    decode_filter_color, decode_filter_exp, decode_filter_oct, decode_filter_quat, decode_index_buffer,
    decode_index_sequence, decode_vertex_buffer,
};
use serde::Deserialize;
use serde_json::Value;

/// What a compressed buffer view says of itself.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Settings {
    pub(super) buffer: usize,
    #[serde(default)]
    pub(super) byte_offset: u64,
    pub(super) byte_length: u64,
    byte_stride: usize,
    count: u64,
    mode: Mode,
    #[serde(default)]
    filter: Filter,
}

#[derive(Clone, Copy, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "UPPERCASE")]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq)]
#[serde(rename_all = "UPPERCASE")]
enum Filter {
    #[default]
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// Decoded bytes for each byte of the file, at most. A block of 256 vertices takes a quarter of a byte
/// for each of a vertex's at least, an index a byte for three of four.
const MOST: u64 = 1024;

/// Decodes a buffer view as `EXT_meshopt_compression` holds it, by the extension's settings: elements
/// without gaps.
///
/// # Errors
/// Settings or bytes that are not what the extension defines.
pub fn decode_meshopt(settings: &Value, bytes: &[u8]) -> Result<Vec<u8>, String> {
    Settings::read(settings)?.decode(bytes)
}

impl Settings {
    pub(super) fn read(value: &Value) -> Result<Self, String> {
        Self::deserialize(value).map_err(|e| e.to_string())
    }

    /// How many bytes come out of `bytes`, as far as that can be.
    pub(super) fn size(&self, bytes: &[u8]) -> Result<usize, String> {
        let size = (self.byte_stride as u64).saturating_mul(self.count);
        let most = MOST.saturating_mul(bytes.len() as u64);
        usize::try_from(size).ok().filter(|_| size <= most).ok_or_else(|| {
            format!("{} elements of {} bytes cannot come from {} bytes", self.count, self.byte_stride, bytes.len())
        })
    }

    /// The view's bytes, elements without gaps.
    pub(super) fn decode(&self, bytes: &[u8]) -> Result<Vec<u8>, String> {
        self.size(bytes)?;
        let count = self.count as usize;
        if self.mode == Mode::Attributes {
            let mut decoded = vertices(bytes, self.byte_stride, count)?;
            self.filter.apply(self.byte_stride, &mut decoded)?;
            return Ok(decoded);
        }
        if self.filter != Filter::None {
            return Err(format!("the filter {:?} is for attributes, not for indices", self.filter));
        }
        if self.mode == Mode::Triangles && !count.is_multiple_of(3) {
            return Err(format!("{count} indices are no triangles"));
        }
        let failed = |e: meshopt::Error| e.to_string();
        match (self.mode, self.byte_stride) {
            (Mode::Triangles, 2) => decode_index_buffer::<u16>(bytes, count).map(|v| flat(&v, u16::to_le_bytes)),
            (Mode::Triangles, 4) => decode_index_buffer::<u32>(bytes, count).map(|v| flat(&v, u32::to_le_bytes)),
            (_, 2) => decode_index_sequence::<u16>(bytes, count).map(|v| flat(&v, u16::to_le_bytes)),
            (_, 4) => decode_index_sequence::<u32>(bytes, count).map(|v| flat(&v, u32::to_le_bytes)),
            (_, stride) => return Err(format!("indices of {stride} bytes: they have 2 or 4")),
        }
        .map_err(failed)
    }
}

impl Filter {
    /// Filters turn numbers that compress well into those of the accessor, in place.
    fn apply(self, stride: usize, bytes: &mut [u8]) -> Result<(), String> {
        match (self, stride) {
            (Self::None, _) => {}
            (Self::Octahedral, 4) => in_place(bytes, |[b]: [u8; 1]| b as i8, |x| [x as u8], decode_filter_oct::<i8>),
            (Self::Octahedral, 8) => in_place(bytes, i16::from_le_bytes, i16::to_le_bytes, decode_filter_oct::<i16>),
            (Self::Quaternion, 8) => in_place(bytes, i16::from_le_bytes, i16::to_le_bytes, decode_filter_quat),
            (Self::Color, 4) => in_place(bytes, |[b]: [u8; 1]| b, |x| [x], decode_filter_color::<u8>),
            (Self::Color, 8) => in_place(bytes, u16::from_le_bytes, u16::to_le_bytes, decode_filter_color::<u16>),
            // Each component alone, so elements of one do for all strides.
            (Self::Exponential, s) if s.is_multiple_of(4) => {
                in_place(bytes, u32::from_le_bytes, u32::to_le_bytes, decode_filter_exp::<1>);
            }
            (filter, stride) => return Err(format!("the filter {filter:?} does not fit elements of {stride} bytes")),
        }
        Ok(())
    }
}

/// A filter of elements of `N` components of `SIZE` bytes, applied to bytes.
fn in_place<T: Copy + Default, const SIZE: usize, const N: usize>(
    bytes: &mut [u8],
    from: impl Fn([u8; SIZE]) -> T,
    to: impl Fn(T) -> [u8; SIZE],
    filter: impl Fn(&mut [[T; N]]),
) {
    let (components, _) = bytes.as_chunks_mut::<SIZE>();
    let values: Vec<T> = components.iter().map(|b| from(*b)).collect();
    let mut elements: Vec<[T; N]> = values.as_chunks::<N>().0.to_vec();
    filter(&mut elements);
    for (slot, value) in components.iter_mut().zip(elements.as_flattened()) {
        *slot = to(*value);
    }
}

fn flat<T: Copy, const SIZE: usize>(values: &[T], to: impl Fn(T) -> [u8; SIZE]) -> Vec<u8> {
    values.iter().flat_map(|v| to(*v)).collect()
}

/// An element of a size known when compiled, as the decoder's safe interface wants it.
#[derive(Clone, Copy)]
struct Element<const WORDS: usize>([[u8; 4]; WORDS]);

impl<const WORDS: usize> Default for Element<WORDS> {
    fn default() -> Self {
        Self([[0; 4]; WORDS])
    }
}

/// Elements of `stride` bytes, which the codec wants to be a multiple of 4 up to 256.
fn vertices(bytes: &[u8], stride: usize, count: usize) -> Result<Vec<u8>, String> {
    fn of<const WORDS: usize>(bytes: &[u8], count: usize) -> Result<Vec<u8>, String> {
        let elements: Vec<Element<WORDS>> = decode_vertex_buffer(bytes, count).map_err(|e| e.to_string())?;
        Ok(elements.iter().flat_map(|e| e.0).flatten().collect())
    }
    macro_rules! by_stride {
        ($($words:literal)*) => {
            match stride {
                $(s if s == 4 * $words => of::<$words>(bytes, count),)*
                other => Err(format!("elements of {other} bytes: the codec has multiples of 4 up to 256")),
            }
        };
    }
    by_stride!(1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
               33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64)
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    fn settings(mode: &str, filter: &str, stride: usize, count: usize) -> Settings {
        let value = json!({"buffer": 0, "byteLength": 1, "byteStride": stride, "count": count,
                           "mode": mode, "filter": filter});
        Settings::read(&value).unwrap()
    }

    #[test]
    fn what_the_encoder_wrote_comes_back() {
        let positions: Vec<[f32; 3]> = (0..300).map(|i| [i as f32, 0.5 * i as f32, -1.0]).collect();
        let encoded = meshopt::encode_vertex_buffer(&positions).unwrap();
        let plain = flat(positions.as_flattened(), f32::to_le_bytes);
        assert_eq!(settings("ATTRIBUTES", "NONE", 12, 300).decode(&encoded).unwrap(), plain);

        let indices: Vec<u32> = (0..99).flat_map(|i| [i, i + 1, i + 2]).collect();
        let encoded = meshopt::encode_index_buffer(&indices, 101).unwrap();
        let found = settings("TRIANGLES", "NONE", 4, 297).decode(&encoded).unwrap();
        // Triangles may be turned, corners are the same.
        let corners: Vec<u32> = found.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect();
        let sorted = |t: &[u32]| {
            let mut t = t.to_vec();
            t.sort_unstable();
            t
        };
        assert!(corners.chunks(3).zip(indices.chunks(3)).all(|(a, b)| sorted(a) == sorted(b)));
    }

    #[test]
    fn exponents_are_filtered() {
        let values = [[0.5f32, -3.0, 1000.0], [0.0, 0.25, -0.125]];
        let words = meshopt::encode_filter_exp(&values, 15, meshopt::EncodeExpMode::Separate);
        let encoded = meshopt::encode_vertex_buffer(&words).unwrap();
        let found = settings("ATTRIBUTES", "EXPONENTIAL", 12, 2).decode(&encoded).unwrap();
        let found: Vec<f32> = found.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        assert!(found.iter().zip(values.as_flattened()).all(|(a, b)| (a - b).abs() <= 1e-3 * b.abs()), "{found:?}");
    }

    #[test]
    fn impossible_claims_are_refused() {
        let bytes = [0xa0u8; 40];
        for (mode, filter, stride, count) in [
            ("ATTRIBUTES", "NONE", 12, usize::MAX),
            ("ATTRIBUTES", "NONE", 12, 1 << 30),
            ("ATTRIBUTES", "NONE", 7, 4),
            ("ATTRIBUTES", "NONE", 0, 4),
            ("ATTRIBUTES", "NONE", 260, 4),
            ("ATTRIBUTES", "QUATERNION", 4, 4),
            ("TRIANGLES", "NONE", 4, 4),
            ("TRIANGLES", "NONE", 3, 3),
            ("INDICES", "OCTAHEDRAL", 4, 3),
        ] {
            assert!(settings(mode, filter, stride, count).decode(&bytes).is_err(), "{mode} {filter} {stride} {count}");
        }
        assert!(Settings::read(&json!({})).unwrap_err().contains("buffer"));
    }
}
