//! `KHR_draco_mesh_compression`: a primitive's triangles and attributes in one run of bytes.

use std::collections::BTreeMap;

use draco_core::{DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointAttribute};
use serde::Deserialize;
use serde_json::Value;

/// Points and faces of a primitive: more than any rig has.
const MOST: u64 = 1 << 22;

/// What a compressed primitive says of itself.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Settings {
    pub(super) buffer_view: usize,
    /// The attribute's number in the compressed mesh, by its name in glTF.
    pub(super) attributes: BTreeMap<String, u32>,
}

impl Settings {
    pub(super) fn read(value: &Value) -> Result<Self, String> {
        Self::deserialize(value).map_err(|e| e.to_string())
    }
}

/// Decodes a primitive as `KHR_draco_mesh_compression` holds it: corners, three a triangle, and the
/// components of all points for each of some attributes, by their numbers in the compressed mesh.
///
/// # Errors
/// What is wrong with the bytes, or an attribute that is not there.
pub fn decode_draco(bytes: &[u8], attributes: &[u32]) -> Result<(Vec<u32>, Vec<Vec<f32>>), String> {
    let mesh = Decoded::new(bytes, MOST)?;
    let part = |&number: &u32| mesh.components(number).map(|(values, _)| values);
    Ok((mesh.corners(), attributes.iter().map(part).collect::<Result<_, _>>()?))
}

/// A decoded primitive.
pub(super) struct Decoded(Mesh);

impl Decoded {
    /// `most` points and faces are decoded, and never more than any rig has.
    pub(super) fn new(bytes: &[u8], most: u64) -> Result<Self, String> {
        let most = most.min(MOST);
        let limits = DecodeLimits::default().with_max_points(most).with_max_faces(most);
        let mut mesh = Mesh::new();
        MeshDecoder::new()
            .decode(&mut DecoderBuffer::new(bytes).with_limits(limits), &mut mesh)
            .map_err(|e| e.to_string())?;
        Ok(Self(mesh))
    }

    pub(super) fn points(&self) -> usize {
        self.0.num_points()
    }

    /// Corners of triangles, three each.
    pub(super) fn corners(&self) -> Vec<u32> {
        self.0.faces().iter().flat_map(|face| face.map(|point| point.0)).collect()
    }

    /// All components of an attribute, which has as many as an accessor of a shape, as they are stored.
    pub(super) fn values(&self, number: u32, shape: &str) -> Result<Vec<f32>, String> {
        let attribute = self.0.attribute_by_unique_id(number).ok_or(format!("it has no attribute {number}"))?;
        let components = match shape {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            _ => return Err(format!("an attribute cannot be {}", shape.chars().take(20).collect::<String>())),
        };
        if usize::from(attribute.num_components()) != components {
            return Err(format!("attribute {number} has {} components, not {components}", attribute.num_components()));
        }
        Ok(attribute.read_f32s(self.points(), components))
    }

    /// `N` components of every point, as they are stored; whole numbers up to 65535 are exact.
    pub(super) fn attribute<const N: usize>(&self, number: u32, normalized: bool) -> Result<Vec<[f32; N]>, String> {
        let (mut values, attribute) = self.components(number)?;
        if usize::from(attribute.num_components()) != N {
            return Err(format!("attribute {number} has {} components, not {N}", attribute.num_components()));
        }
        let largest = match attribute.data_type() {
            DataType::Int8 => 127.0,
            DataType::Uint8 => 255.0,
            DataType::Int16 => 32767.0,
            DataType::Uint16 => 65535.0,
            _ => 1.0,
        };
        if normalized && largest > 1.0 {
            values.iter_mut().for_each(|v| *v = (*v / largest).max(-1.0));
        }
        Ok(values.as_chunks::<N>().0.to_vec())
    }

    /// All components of every point of an attribute, as they are stored.
    fn components(&self, number: u32) -> Result<(Vec<f32>, &PointAttribute), String> {
        let attribute = self.0.attribute_by_unique_id(number).ok_or(format!("it has no attribute {number}"))?;
        Ok((attribute.read_f32s(self.points(), attribute.num_components().into()), attribute))
    }
}

/// Values as the bytes of an accessor of a component type, and their stride where elements have gaps:
/// vertices start at multiples of 4.
pub(super) fn element_bytes(values: &[f32], components: usize, component_type: u32) -> (Vec<u8>, Option<usize>) {
    let width = match component_type {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        _ => 4,
    };
    let stride = (components * width).next_multiple_of(4);
    let mut bytes = Vec::with_capacity(values.len() * 4);
    for element in values.chunks(components.max(1)) {
        for &value in element {
            match component_type {
                5120 => bytes.extend((value as i8).to_le_bytes()),
                5121 => bytes.extend((value as u8).to_le_bytes()),
                5122 => bytes.extend((value as i16).to_le_bytes()),
                5123 => bytes.extend((value as u16).to_le_bytes()),
                5125 => bytes.extend((value as u32).to_le_bytes()),
                _ => bytes.extend(value.to_le_bytes()),
            }
        }
        bytes.resize(bytes.len().next_multiple_of(4), 0);
    }
    (bytes, (stride != components * width).then_some(stride))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_start_at_multiples_of_4() {
        assert_eq!(
            element_bytes(&[1.0, 2.0, 255.0, 4.0, 5.0, 6.0], 3, 5121),
            (vec![1, 2, 255, 0, 4, 5, 6, 0], Some(4))
        );
        assert_eq!(element_bytes(&[1.0, 2.0], 2, 5123), (vec![1, 0, 2, 0], None));
    }
}
