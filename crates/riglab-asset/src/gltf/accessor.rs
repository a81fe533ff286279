//! Accessors: typed elements in buffer views.
//!
//! Any component type, normalised or not, with gaps or without, sparse or dense. All bounds are
//! checked before anything is allocated, so a claimed count costs nothing unless the bytes are there.
//! What Draco compressed is put in place of what the accessors claim.

use std::cell::RefCell;
use std::collections::HashMap;
use std::rc::Rc;

use super::buffers::{Buffers, View};
use super::document::{Accessor, Document};
use crate::Fault;
use crate::budget::Budget;

/// Elements of one accessor: more than any rig has vertices. Of those without bytes of their own, which means zeros, what the
/// file may ask for in all ([`Budget`]) is less.
const MAX_COUNT: u64 = 1 << 24;

/// The accessors of a file.
pub(super) struct Accessors<'a> {
    document: &'a Document,
    buffers: Buffers<'a>,
    floats3: Cache<[f32; 3]>,
    floats4: Cache<[f32; 4]>,
    integers4: Cache<[u32; 4]>,
    /// Indices that [`Self::put_indices`] put in place.
    corners: Cache<u32>,
}

/// Decoded accessors, as several primitives or nodes may share one.
type Cache<T> = RefCell<HashMap<usize, Rc<[T]>>>;

/// What an accessor is used as, and what it has to be for that.
pub(super) struct Usage {
    pub(super) name: &'static str,
    shape: &'static str,
    components: &'static [Component],
    wanted: &'static str,
}

pub(super) const POSITION: Usage = Usage {
    name: "POSITION",
    shape: "VEC3",
    components: &[Component::F32, Component::I16, Component::U16, Component::I8, Component::U8],
    wanted: "VEC3 of floats or, quantised, of bytes or shorts",
};
pub(super) const JOINTS: Usage = Usage {
    name: "JOINTS",
    shape: "VEC4",
    components: &[Component::U8, Component::U16],
    wanted: "VEC4 of unsigned bytes or shorts",
};
pub(super) const WEIGHTS: Usage = Usage {
    name: "WEIGHTS",
    shape: "VEC4",
    components: &[Component::F32, Component::U8, Component::U16],
    wanted: "VEC4 of floats, unsigned bytes or shorts",
};
pub(super) const INDICES: Usage = Usage {
    name: "indices",
    shape: "SCALAR",
    components: &[Component::U8, Component::U16, Component::U32],
    wanted: "SCALAR of unsigned bytes, shorts or integers",
};
pub(super) const INVERSE_BIND: Usage =
    Usage { name: "inverse bind matrices", shape: "MAT4", components: &[Component::F32], wanted: "MAT4 of floats" };

const TIMES: Usage =
    Usage { name: "key times", shape: "SCALAR", components: &[Component::F32], wanted: "SCALAR of floats" };
const VECTORS: Usage =
    Usage { name: "animation values", shape: "VEC3", components: &[Component::F32], wanted: "VEC3 of floats" };
const ROTATIONS: Usage = Usage {
    name: "animation rotations",
    shape: "VEC4",
    components: &[Component::F32, Component::I8, Component::U8, Component::I16, Component::U16],
    wanted: "VEC4 of floats, or of normalised bytes or shorts",
};
#[cfg(feature = "fbx")]
const SHARES: Usage = Usage {
    name: "weights of morph targets",
    shape: "SCALAR",
    wanted: "SCALAR of floats, or of normalised bytes or shorts",
    ..ROTATIONS
};
const DIRECTION: Usage = Usage { name: "NORMAL or a morph target", ..POSITION };
#[cfg(feature = "fbx")]
const TEXCOORD: Usage = Usage {
    name: "TEXCOORD",
    shape: "VEC2",
    components: &[Component::F32, Component::I8, Component::U8, Component::I16, Component::U16],
    wanted: "VEC2 of floats, bytes or shorts",
};
const TANGENT: Usage = Usage { name: "TANGENT", shape: "VEC4", ..POSITION };
#[cfg(feature = "fbx")]
const COLOUR: Usage = Usage { name: "COLOR", wanted: "VEC3 or VEC4 of floats, unsigned bytes or shorts", ..WEIGHTS };

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Component {
    I8,
    U8,
    I16,
    U16,
    U32,
    F32,
}

impl Component {
    fn of(accessor: usize, number: u32) -> Result<Self, Fault> {
        Ok(match number {
            5120 => Self::I8,
            5121 => Self::U8,
            5122 => Self::I16,
            5123 => Self::U16,
            5125 => Self::U32,
            5126 => Self::F32,
            found => return Err(Fault::ComponentType { accessor, found }),
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::U32 | Self::F32 => 4,
        }
    }
}

/// An accessor whose bounds are checked: element `i` lies at `i * stride`.
struct Elements<'b> {
    component: Component,
    normalized: bool,
    count: usize,
    /// Bytes of one, without the gap behind it.
    size: usize,
    stride: usize,
    /// `None`: zeros.
    bytes: Option<&'b [u8]>,
    replaced: Option<Replaced<'b>>,
}

/// Elements of a sparse accessor that stand elsewhere: their numbers, and their bytes without gaps.
type Replaced<'b> = (Vec<u32>, &'b [u8]);

impl<'a> Accessors<'a> {
    pub(super) fn new(document: &'a Document, buffers: Buffers<'a>) -> Self {
        let (floats3, floats4, integers4, corners) = Default::default();
        Self { document, buffers, floats3, floats4, integers4, corners }
    }

    /// What the file may still ask for.
    pub(super) fn budget(&self) -> &Budget {
        self.buffers.budget()
    }

    /// How many indices an accessor stands for: those put in place, else as many as it claims.
    pub(super) fn index_count(&self, number: usize) -> Result<usize, Fault> {
        match self.corners.borrow().get(&number) {
            Some(corners) => Ok(corners.len()),
            None => self.claimed(number),
        }
    }

    /// How many elements an accessor claims, within limits; whether the bytes are there is not checked.
    fn claimed(&self, number: usize) -> Result<usize, Fault> {
        let accessor = self.get(number)?;
        let (count, limit) = (accessor.count, MAX_COUNT);
        let too_large = || Fault::TooLarge { what: format!("accessor {number}"), count, limit };
        usize::try_from(count).ok().filter(|_| count <= limit).ok_or_else(too_large)
    }

    /// Whether an accessor has bytes of its own.
    pub(super) fn has_bytes(&self, number: usize) -> Result<bool, Fault> {
        Ok(self.get(number)?.buffer_view.is_some())
    }

    pub(super) fn positions(&self, number: usize) -> Result<Rc<[[f32; 3]]>, Fault> {
        cached(&self.floats3, number, || self.floats(number, &POSITION, usize::MAX))
    }

    /// Normals, or what morph targets add to them or to positions; not kept.
    pub(super) fn directions(&self, number: usize) -> Result<Vec<[f32; 3]>, Fault> {
        self.floats(number, &DIRECTION, usize::MAX)
    }

    /// Tangents, the fourth component the side; not kept.
    pub(super) fn tangents(&self, number: usize) -> Result<Vec<[f32; 4]>, Fault> {
        self.floats(number, &TANGENT, usize::MAX)
    }

    /// Texture coordinates; not kept.
    #[cfg(feature = "fbx")]
    pub(super) fn coordinates(&self, number: usize) -> Result<Vec<[f32; 2]>, Fault> {
        self.floats(number, &TEXCOORD, usize::MAX)
    }

    /// Colours with alpha, which is 1 where there is none; not kept.
    #[cfg(feature = "fbx")]
    pub(super) fn colours(&self, number: usize) -> Result<Vec<[f32; 4]>, Fault> {
        if self.get(number)?.shape == "VEC3" {
            let all = self.floats(number, &Usage { shape: "VEC3", ..COLOUR }, usize::MAX)?;
            return Ok(all.into_iter().map(|[r, g, b]| [r, g, b, 1.0]).collect());
        }
        self.floats(number, &COLOUR, usize::MAX)
    }

    /// The floats of an accessor of vectors, one after another, and how many make one; not kept.
    pub(super) fn numbers(&self, number: usize) -> Result<(Vec<f32>, usize), Fault> {
        let usage = |shape: &'static str| Usage { shape, ..INVERSE_BIND };
        Ok(match self.get(number)?.shape.as_str() {
            "VEC2" => (self.floats::<2>(number, &usage("VEC2"), usize::MAX)?.into_flattened(), 2),
            "VEC3" => (self.floats::<3>(number, &usage("VEC3"), usize::MAX)?.into_flattened(), 3),
            _ => (self.floats::<4>(number, &usage("VEC4"), usize::MAX)?.into_flattened(), 4),
        })
    }

    /// Whether an accessor has floats that are not finite; not where it cannot be read.
    pub(super) fn is_broken(&self, number: usize) -> bool {
        let broken = |elements: Result<Elements<'_>, Fault>| elements.is_ok_and(|e| e.is_broken());
        let usage = |shape: &'static str| Usage { shape, ..INVERSE_BIND };
        match self.document.accessors.get(number).map(|accessor| accessor.shape.as_str()) {
            Some("SCALAR") => broken(self.elements::<1>(number, &usage("SCALAR"))),
            Some("VEC2") => broken(self.elements::<2>(number, &usage("VEC2"))),
            Some("VEC3") => broken(self.elements::<3>(number, &usage("VEC3"))),
            Some("VEC4") => broken(self.elements::<4>(number, &usage("VEC4"))),
            _ => false,
        }
    }

    pub(super) fn weights(&self, number: usize) -> Result<Rc<[[f32; 4]]>, Fault> {
        cached(&self.floats4, number, || self.floats(number, &WEIGHTS, usize::MAX))
    }

    pub(super) fn joints(&self, number: usize) -> Result<Rc<[[u32; 4]]>, Fault> {
        cached(&self.integers4, number, || self.integers(number, &JOINTS))
    }

    pub(super) fn indices(&self, number: usize) -> Result<Vec<u32>, Fault> {
        if let Some(corners) = self.corners.borrow().get(&number) {
            return Ok(corners.to_vec());
        }
        Ok(self.integers::<1>(number, &INDICES)?.into_iter().map(|[index]| index).collect())
    }

    /// The first `wanted` matrices, column by column.
    pub(super) fn matrices(&self, number: usize, wanted: usize) -> Result<Vec<[f32; 16]>, Fault> {
        self.floats(number, &INVERSE_BIND, wanted)
    }

    /// The times of an animation's keys.
    pub(super) fn times(&self, number: usize) -> Result<Vec<f32>, Fault> {
        Ok(self.floats::<1>(number, &TIMES, usize::MAX)?.into_iter().flatten().collect())
    }

    /// Translations or scales of an animation.
    pub(super) fn vectors(&self, number: usize) -> Result<Vec<[f32; 3]>, Fault> {
        self.floats(number, &VECTORS, usize::MAX)
    }

    /// Rotations of an animation.
    pub(super) fn rotations(&self, number: usize) -> Result<Vec<[f32; 4]>, Fault> {
        self.floats(number, &ROTATIONS, usize::MAX)
    }

    /// Weights of morph targets over time.
    #[cfg(feature = "fbx")]
    pub(super) fn shares(&self, number: usize) -> Result<Vec<f32>, Fault> {
        Ok(self.floats::<1>(number, &SHARES, usize::MAX)?.into_iter().flatten().collect())
    }

    /// A buffer view as it is; `from` says who asks for it.
    pub(super) fn view(&self, number: usize, from: impl Fn() -> String) -> Result<View<'_>, Fault> {
        self.buffers.view(number, from)
    }

    /// Whether an accessor's integers mean shares of the largest.
    pub(super) fn normalized(&self, number: usize) -> Result<bool, Fault> {
        Ok(self.get(number)?.normalized)
    }

    /// Puts decoded positions in the place of an accessor's; false where there are some already.
    pub(super) fn put_positions(&self, number: usize, values: Vec<[f32; 3]>) -> Result<bool, Fault> {
        self.put(&self.floats3, number, values)
    }

    /// As above, of WEIGHTS.
    pub(super) fn put_weights(&self, number: usize, values: Vec<[f32; 4]>) -> Result<bool, Fault> {
        self.put(&self.floats4, number, values)
    }

    /// As above, of JOINTS.
    pub(super) fn put_joints(&self, number: usize, values: Vec<[u32; 4]>) -> Result<bool, Fault> {
        self.put(&self.integers4, number, values)
    }

    /// As above, of indices.
    pub(super) fn put_indices(&self, number: usize, values: Vec<u32>) -> Result<bool, Fault> {
        self.put(&self.corners, number, values)
    }

    fn put<T>(&self, cache: &Cache<T>, number: usize, values: Vec<T>) -> Result<bool, Fault> {
        self.budget().spend(values.len(), size_of::<T>())?;
        let new = !cache.borrow().contains_key(&number);
        if new {
            cache.borrow_mut().insert(number, values.into());
        }
        Ok(new)
    }

    /// Whether there is such an accessor; `from` says who names it.
    pub(super) fn check(&self, number: usize, from: impl FnOnce() -> String) -> Result<(), Fault> {
        let count = self.document.accessors.len();
        if number < count {
            return Ok(());
        }
        Err(Fault::Reference { from: from(), to: "accessor", index: number, count })
    }

    fn get(&self, number: usize) -> Result<&'a Accessor, Fault> {
        self.check(number, || "something".into())?;
        Ok(&self.document.accessors[number])
    }

    fn floats<const N: usize>(&self, number: usize, usage: &Usage, most: usize) -> Result<Vec<[f32; N]>, Fault> {
        let e = self.elements::<N>(number, usage)?;
        self.budget().spend(e.count.min(most), size_of::<[f32; N]>())?;
        let whole = |x: f32, largest: f32| if e.normalized { (x / largest).max(-1.0) } else { x };
        Ok(match e.component {
            Component::F32 => e.decode(most, f32::from_le_bytes),
            Component::I8 => e.decode(most, |b| whole(i8::from_le_bytes(b).into(), 127.0)),
            Component::U8 => e.decode(most, |[b]| whole(b.into(), 255.0)),
            Component::I16 => e.decode(most, |b| whole(i16::from_le_bytes(b).into(), 32767.0)),
            Component::U16 => e.decode(most, |b| whole(u16::from_le_bytes(b).into(), 65535.0)),
            Component::U32 => e.decode(most, |b| u32::from_le_bytes(b) as f32),
        })
    }

    fn integers<const N: usize>(&self, number: usize, usage: &Usage) -> Result<Vec<[u32; N]>, Fault> {
        let e = self.elements::<N>(number, usage)?;
        self.budget().spend(e.count, size_of::<[u32; N]>())?;
        Ok(match e.component {
            Component::U8 | Component::I8 => e.decode(usize::MAX, |[b]| b.into()),
            Component::U16 | Component::I16 => e.decode(usize::MAX, |b| u16::from_le_bytes(b).into()),
            Component::U32 | Component::F32 => e.decode(usize::MAX, u32::from_le_bytes),
        })
    }

    /// Checks type and bounds. What Draco decoded does not count: it is no part of these bytes, and another use than as
    /// indices may name the same accessor.
    fn elements<const N: usize>(&self, number: usize, usage: &Usage) -> Result<Elements<'_>, Fault> {
        let accessor = self.get(number)?;
        let count = self.claimed(number)?;
        let component = Component::of(number, accessor.component_type)?;
        if accessor.shape != usage.shape || !usage.components.contains(&component) {
            let shape: String = accessor.shape.chars().take(20).collect();
            let found = format!("{shape} of component type {}", accessor.component_type);
            return Err(Fault::AccessorType { accessor: number, used: usage.name, found, wanted: usage.wanted });
        }
        let size = N * component.size();
        let dense = match accessor.buffer_view {
            Some(view) => Some(self.span(number, view, accessor.byte_offset, accessor.count, size, true)?),
            None => None,
        };
        Ok(Elements {
            component,
            normalized: accessor.normalized,
            count,
            size,
            stride: dense.map_or(size, |(stride, _)| stride),
            bytes: dense.map(|(_, bytes)| bytes),
            replaced: self.replaced(number, accessor, count, size)?,
        })
    }

    /// The numbers and bytes of a sparse accessor's replacements.
    fn replaced(
        &self,
        number: usize,
        accessor: &Accessor,
        count: usize,
        size: usize,
    ) -> Result<Option<Replaced<'_>>, Fault> {
        let Some(sparse) = &accessor.sparse else { return Ok(None) };
        let component = Component::of(number, sparse.indices.component_type)?;
        let (indices, values) = (&sparse.indices, &sparse.values);
        let (_, bytes) =
            self.span(number, indices.buffer_view, indices.byte_offset, sparse.count, component.size(), false)?;
        let (_, values) = self.span(number, values.buffer_view, values.byte_offset, sparse.count, size, false)?;
        let numbers: Vec<u32> = match component {
            Component::U8 => bytes.iter().map(|b| (*b).into()).collect(),
            Component::U16 => bytes.as_chunks().0.iter().map(|b| u16::from_le_bytes(*b).into()).collect(),
            Component::U32 => bytes.as_chunks().0.iter().map(|b| u32::from_le_bytes(*b)).collect(),
            _ => {
                let found = format!("component type {}", sparse.indices.component_type);
                let (used, wanted) = ("sparse indices", INDICES.wanted);
                return Err(Fault::AccessorType { accessor: number, used, found, wanted });
            }
        };
        match numbers.iter().find(|i| **i as usize >= count) {
            Some(&index) => Err(Fault::SparseIndex { accessor: number, index: index as usize, count }),
            None => Ok(Some((numbers, values))),
        }
    }

    /// Stride and bytes of `count` elements of `size` bytes, from the first byte of the first to the
    /// last byte of the last.
    fn span(
        &self,
        accessor: usize,
        view_number: usize,
        offset: u64,
        count: u64,
        size: usize,
        strided: bool,
    ) -> Result<(usize, &[u8]), Fault> {
        let view = self.buffers.view(view_number, || format!("accessor {accessor}"))?;
        let stride = view.stride.filter(|_| strided).unwrap_or(size);
        if stride < size {
            return Err(Fault::Stride { accessor, stride, size });
        }
        let span = || {
            let start = usize::try_from(offset).ok()?;
            let gaps = usize::try_from(count.saturating_sub(1)).ok()?.checked_mul(stride)?;
            let length = if count == 0 { 0 } else { gaps.checked_add(size)? };
            view.bytes.get(start..start.checked_add(length)?)
        };
        let bytes = span().ok_or(Fault::AccessorBounds {
            accessor,
            count,
            offset,
            view: view_number,
            found: view.bytes.len(),
        })?;
        Ok((stride, bytes))
    }
}

impl Elements<'_> {
    /// Whether floats are not finite: those of the elements, or what takes their place.
    fn is_broken(&self) -> bool {
        let any = |bytes: &[u8]| bytes.as_chunks().0.iter().any(|b| !f32::from_le_bytes(*b).is_finite());
        let own = self.bytes.is_some_and(|bytes| bytes.chunks(self.stride).any(|e| any(&e[..self.size.min(e.len())])));
        own || self.replaced.as_ref().is_some_and(|(_, values)| any(values))
    }

    /// The first `most` elements at most; `SIZE` is that of the component.
    fn decode<T: Copy + Default, const N: usize, const SIZE: usize>(
        &self,
        most: usize,
        convert: impl Fn([u8; SIZE]) -> T,
    ) -> Vec<[T; N]> {
        debug_assert_eq!(self.component.size(), SIZE);
        let element = |bytes: &[u8]| {
            let (components, _) = bytes.as_chunks::<SIZE>();
            std::array::from_fn(|k| convert(components[k]))
        };
        let count = self.count.min(most);
        let mut elements: Vec<[T; N]> = match self.bytes {
            Some(bytes) => (0..count).map(|i| element(&bytes[i * self.stride..][..N * SIZE])).collect(),
            None => vec![[T::default(); N]; count],
        };
        if let Some((numbers, values)) = &self.replaced {
            for (&i, value) in numbers.iter().zip(values.chunks_exact(N * SIZE)) {
                if let Some(slot) = elements.get_mut(i as usize) {
                    *slot = element(value);
                }
            }
        }
        elements
    }
}

fn cached<T: Clone>(
    cache: &Cache<T>,
    number: usize,
    read: impl FnOnce() -> Result<Vec<T>, Fault>,
) -> Result<Rc<[T]>, Fault> {
    if let Some(known) = cache.borrow().get(&number) {
        return Ok(Rc::clone(known));
    }
    let elements: Rc<[T]> = read()?.into();
    cache.borrow_mut().insert(number, Rc::clone(&elements));
    Ok(elements)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_draco_decoded_counts_as_indices_and_as_nothing_else() {
        let json = br#"{"asset": {"version": "2.0"}, "buffers": [{"byteLength": 16}],
            "bufferViews": [{"buffer": 0, "byteLength": 16}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "type": "VEC4", "count": 1}]}"#;
        let document = Document::parse(json).unwrap();
        let buffers = Buffers::new(&document, Some(&[0; 16]), None, Budget::new(json.len()));
        let accessors = Accessors::new(&document, buffers);
        assert!(accessors.put_indices(0, (0..12).collect()).unwrap());
        assert_eq!((accessors.index_count(0).unwrap(), accessors.indices(0).unwrap().len()), (12, 12));
        // As rotations of an animation, which may name the accessor too, it is the one that its bytes are.
        assert_eq!(accessors.rotations(0).unwrap(), [[0.0; 4]]);
    }
}
