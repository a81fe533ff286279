//! A mesh of a format that holds one mesh and no rig, as scans (PLY) and prints (STL) are.

use riglab_core::Vec3;

use crate::influences::Repairs;
use crate::{Binding, Part, Reading, VertexSet, Warning, triangles};

/// Vertices and triangles of a file. Lists other than positions are empty or as long as those.
#[derive(Debug, Default, PartialEq)]
pub(crate) struct Surface {
    pub(crate) positions: Vec<Vec3>,
    /// Of any length.
    pub(crate) normals: Vec<Vec3>,
    /// From the lower left corner of the picture.
    pub(crate) coordinates: Vec<[f32; 2]>,
    /// As pictures have them, with alpha, from 0 to 1.
    pub(crate) colours: Vec<[f32; 4]>,
    /// Each names vertices that there are.
    pub(crate) triangles: Vec<[u32; 3]>,
    /// Numbers of the vertices in the file, rising.
    pub(crate) numbers: Vec<u32>,
    /// How many vertices there are in the file.
    pub(crate) stored: usize,
    /// Files of pictures, by name.
    pub(crate) pictures: Vec<String>,
    /// What of the file is not read, in words.
    pub(crate) left: Vec<String>,
}

impl Surface {
    /// Without vertices that no triangle names, of which scans have some. All that triangles name are below the number of
    /// positions.
    ///
    /// # Errors
    /// The number in the file of a vertex that triangles name and that lies nowhere.
    pub(crate) fn used(mut self) -> Result<Self, u32> {
        self.stored = self.positions.len();
        self.numbers = triangles::renumber(&mut self.triangles, self.stored);
        if self.numbers.len() < self.stored {
            self.positions = picked(&self.positions, &self.numbers);
            self.normals = picked(&self.normals, &self.numbers);
            self.coordinates = picked(&self.coordinates, &self.numbers);
            self.colours = picked(&self.colours, &self.numbers);
        }
        match self.positions.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
            Some(at) => Err(self.numbers[at]),
            None => Ok(self),
        }
    }

    pub(crate) fn into_reading(mut self) -> Reading {
        let mut reading = Reading::default();
        let stored = self.triangles.len();
        if stored == 0 {
            return reading;
        }
        let count = self.positions.len();
        let dropped = triangles::keep_proper(&mut self.triangles, count);
        if dropped != triangles::Dropped::default() {
            let (collapsed, repeated) = (dropped.collapsed, dropped.repeated);
            reading.warnings.push(Warning::Degenerate { collapsed, repeated });
        }
        let used = (0..count as u32).collect();
        reading.parts.push(Part { node: 0, primitive: 0, vertex_set: 0, used, triangles: self.triangles, stored });
        reading.vertex_sets.push(VertexSet {
            numbers: self.numbers,
            positions: self.positions,
            weights: None,
            unweighted: Vec::new(),
            repairs: Repairs::default(),
            stored: self.stored,
            binding: Binding::Free,
        });
        reading
    }
}

/// Those of a list by their numbers; of an empty one none.
fn picked<T: Copy>(all: &[T], numbers: &[u32]) -> Vec<T> {
    if all.is_empty() { Vec::new() } else { numbers.iter().map(|&v| all[v as usize]).collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn surface() -> Surface {
        Surface {
            positions: vec![[f32::NAN; 3], [0.0; 3], [1.0, 0.0, 0.0], [9.0; 3], [0.0, 1.0, 0.0]],
            coordinates: (0..5).map(|v| [v as f32, 0.0]).collect(),
            triangles: vec![[1, 2, 4], [2, 2, 4], [4, 2, 1]],
            ..Surface::default()
        }
    }

    #[test]
    fn vertices_that_no_triangle_names_are_left_out_wherever_they_lie() {
        let used = surface().used().unwrap();
        assert_eq!((used.stored, &used.numbers[..]), (5, &[1, 2, 4][..]));
        assert_eq!(used.positions, [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
        assert_eq!(used.coordinates, [[1.0, 0.0], [2.0, 0.0], [4.0, 0.0]]);
        assert_eq!((used.triangles[0], used.normals.len()), ([0, 1, 2], 0));
        let nowhere = Surface { triangles: vec![[1, 2, 0]], ..surface() };
        assert_eq!(nowhere.used(), Err(0));
    }

    #[test]
    fn a_reading_has_each_triangle_once_and_tells_of_the_others() {
        let reading = surface().used().unwrap().into_reading();
        assert_eq!((reading.parts[0].triangles.as_slice(), reading.parts[0].stored), (&[[0, 1, 2]][..], 3));
        assert_eq!(reading.warnings, [Warning::Degenerate { collapsed: 1, repeated: 1 }]);
        assert!(Surface::default().used().unwrap().into_reading().parts.is_empty());
    }
}
