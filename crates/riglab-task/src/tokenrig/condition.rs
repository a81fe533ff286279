//! What draws are conditioned on.

use std::sync::Arc;

use riglab_core::Mesh;
use tch::Tensor;

use crate::fsq_cvae::Surface;

/// Shapes as the decoder reads them, and the surface of each, for a model whose codes are told what lies near a joint's
/// bones.
pub struct Condition {
    /// [b, p, d]
    prefix: Tensor,
    /// One a row of the prefix, or none.
    surfaces: Vec<Arc<Surface>>,
}

/// Without surfaces.
impl From<Tensor> for Condition {
    fn from(prefix: Tensor) -> Self {
        Self { prefix, surfaces: Vec::new() }
    }
}

impl Condition {
    /// Of prefixes [b, p, d] and as many meshes; one that follows itself is looked at once.
    pub fn new<'a>(prefix: Tensor, meshes: impl IntoIterator<Item = &'a Mesh>) -> Self {
        let mut last: Option<(&Mesh, Arc<Surface>)> = None;
        let surface = |mesh: &'a Mesh| {
            let known = last.take().filter(|(before, _)| std::ptr::eq(*before, mesh));
            let (_, surface) = last.insert(known.unwrap_or_else(|| (mesh, Arc::new(Surface::new(mesh)))));
            surface.clone()
        };
        Self { prefix, surfaces: meshes.into_iter().map(surface).collect() }
    }

    /// How many shapes.
    pub fn rows(&self) -> usize {
        self.prefix.size()[0] as usize
    }

    /// The shapes, [b, p, d].
    pub fn prefix(&self) -> &Tensor {
        &self.prefix
    }

    /// Some of the shapes, each as often as it is named.
    pub fn some(&self, rows: &[usize]) -> Self {
        if rows.iter().copied().eq(0..self.rows()) {
            return Self { prefix: self.prefix.shallow_clone(), surfaces: self.surfaces.clone() };
        }
        let numbers: Vec<i64> = rows.iter().map(|&row| row as i64).collect();
        let prefix = self.prefix.index_select(0, &Tensor::from_slice(&numbers).to_device(self.prefix.device()));
        Self { prefix, surfaces: rows.iter().filter_map(|&row| self.surfaces.get(row).cloned()).collect() }
    }

    /// The first of the shapes.
    pub fn first(&self, count: usize) -> Self {
        self.some(&(0..count).collect::<Vec<_>>())
    }

    /// The first `count` of each, one after another.
    pub fn firsts(all: &[Self], count: usize) -> Self {
        let own: Vec<Self> = all.iter().map(|own| own.first(count)).collect();
        let prefix = Tensor::cat(&own.iter().map(|own| &own.prefix).collect::<Vec<_>>(), 0);
        Self { prefix, surfaces: own.into_iter().flat_map(|own| own.surfaces).collect() }
    }

    /// The surface of what is drawn in a row, where one shape may stand for all.
    pub fn surface(&self, row: usize) -> Option<&Surface> {
        self.surfaces.get(if self.rows() == 1 { 0 } else { row }).map(|surface| &**surface)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tokenrig::testing::tetrahedron;

    #[test]
    fn rows_keep_their_surfaces() {
        let (a, b) = (tetrahedron(), tetrahedron());
        let rows = |seen: &Condition| Vec::<f32>::try_from(seen.prefix().view([-1])).unwrap();
        let prefix = Tensor::from_slice(&[0.0f32, 1.0, 2.0]).view([3, 1, 1]);
        let all = Condition::new(prefix.shallow_clone(), [&a, &a, &b]);
        let same = |x: &Condition, k: usize, y: &Condition, l: usize| {
            std::ptr::eq(x.surface(k).unwrap(), y.surface(l).unwrap())
        };
        assert!(same(&all, 0, &all, 1) && !same(&all, 1, &all, 2), "a mesh that follows itself is looked at once");
        let some = all.some(&[2, 0, 2]);
        assert_eq!(rows(&some), [2.0, 0.0, 2.0]);
        assert!(same(&some, 0, &all, 2) && same(&some, 1, &all, 0) && same(&some, 2, &all, 2));
        let firsts = Condition::firsts(&[all.some(&[2, 1]), all.some(&[1, 2])], 1);
        assert_eq!(rows(&firsts), [2.0, 1.0]);
        assert!(same(&firsts, 0, &all, 2) && same(&firsts, 1, &all, 1));
        // One shape stands for all that is drawn.
        assert!(same(&all.some(&[2]), 7, &all, 2) && all.surface(7).is_none());
        assert!(Condition::from(prefix).some(&[1]).surface(0).is_none());
    }
}
