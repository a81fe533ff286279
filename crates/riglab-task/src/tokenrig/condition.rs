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
    /// Of prefixes [b, p, d] and as many meshes.
    pub fn new<'a>(prefix: Tensor, meshes: impl IntoIterator<Item = &'a Mesh>) -> Self {
        Self { prefix, surfaces: meshes.into_iter().map(|mesh| Arc::new(Surface::new(mesh))).collect() }
    }

    /// Of several prefixes [b, p, d] of one mesh.
    pub fn of_one(prefix: Tensor, mesh: &Mesh) -> Self {
        let rows = prefix.size()[0] as usize;
        Self { prefix, surfaces: std::iter::repeat_n(Arc::new(Surface::new(mesh)), rows).collect() }
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
