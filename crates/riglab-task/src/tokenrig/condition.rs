//! What draws are conditioned on.

use std::sync::Arc;

use riglab_core::Mesh;
use riglab_nn::tokenrig::TokenRigConfig;
use tch::Tensor;

use super::told::Sight;

/// Shapes as the decoder reads them, and the mesh of each, for a model whose codes are told of it.
pub struct Condition {
    /// [b, p, d]
    prefix: Tensor,
    /// One a row of the prefix, or none.
    sights: Vec<Arc<Sight>>,
}

/// Without meshes.
impl From<Tensor> for Condition {
    fn from(prefix: Tensor) -> Self {
        Self { prefix, sights: Vec::new() }
    }
}

impl Condition {
    /// Of prefixes [b, p, d] and as many meshes, of which a model may have codes told; one that follows itself is looked at
    /// once.
    pub fn new<'a>(prefix: Tensor, model: &TokenRigConfig, meshes: impl IntoIterator<Item = &'a Mesh>) -> Self {
        let mut last: Option<(&Mesh, Option<Arc<Sight>>)> = None;
        let sight = |mesh: &'a Mesh| {
            let known = last.take().filter(|(before, _)| std::ptr::eq(*before, mesh));
            let (_, sight) = last.insert(known.unwrap_or_else(|| (mesh, Sight::of(model, mesh).map(Arc::new))));
            sight.clone()
        };
        Self { prefix, sights: meshes.into_iter().filter_map(sight).collect() }
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
            return Self { prefix: self.prefix.shallow_clone(), sights: self.sights.clone() };
        }
        let numbers: Vec<i64> = rows.iter().map(|&row| row as i64).collect();
        let prefix = self.prefix.index_select(0, &Tensor::from_slice(&numbers).to_device(self.prefix.device()));
        Self { prefix, sights: rows.iter().filter_map(|&row| self.sights.get(row).cloned()).collect() }
    }

    /// The first of the shapes.
    pub fn first(&self, count: usize) -> Self {
        self.some(&(0..count).collect::<Vec<_>>())
    }

    /// The first `count` of each, one after another.
    pub fn firsts(all: &[Self], count: usize) -> Self {
        let own: Vec<Self> = all.iter().map(|own| own.first(count)).collect();
        let prefix = Tensor::cat(&own.iter().map(|own| &own.prefix).collect::<Vec<_>>(), 0);
        Self { prefix, sights: own.into_iter().flat_map(|own| own.sights).collect() }
    }

    /// The mesh of what is drawn in a row, where one shape may stand for all.
    pub fn sight(&self, row: usize) -> Option<&Sight> {
        self.sights.get(if self.rows() == 1 { 0 } else { row }).map(|sight| &**sight)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tokenrig::testing::tetrahedron;

    #[test]
    fn rows_keep_their_meshes() {
        let (a, b) = (tetrahedron(), tetrahedron());
        let rows = |seen: &Condition| Vec::<f32>::try_from(seen.prefix().view([-1])).unwrap();
        let prefix = Tensor::from_slice(&[0.0f32, 1.0, 2.0]).view([3, 1, 1]);
        let model = TokenRigConfig { tell_region: true, ..TokenRigConfig::default() };
        let all = Condition::new(prefix.shallow_clone(), &model, [&a, &a, &b]);
        let same =
            |x: &Condition, k: usize, y: &Condition, l: usize| std::ptr::eq(x.sight(k).unwrap(), y.sight(l).unwrap());
        assert!(same(&all, 0, &all, 1) && !same(&all, 1, &all, 2), "a mesh that follows itself is looked at once");
        let some = all.some(&[2, 0, 2]);
        assert_eq!(rows(&some), [2.0, 0.0, 2.0]);
        assert!(same(&some, 0, &all, 2) && same(&some, 1, &all, 0) && same(&some, 2, &all, 2));
        let firsts = Condition::firsts(&[all.some(&[2, 1]), all.some(&[1, 2])], 1);
        assert_eq!(rows(&firsts), [2.0, 1.0]);
        assert!(same(&firsts, 0, &all, 2) && same(&firsts, 1, &all, 1));
        // One shape stands for all that is drawn.
        assert!(same(&all.some(&[2]), 7, &all, 2) && all.sight(7).is_none());
        let plain = Condition::new(prefix.shallow_clone(), &TokenRigConfig::default(), [&a, &a, &b]);
        assert!(plain.sight(0).is_none() && Condition::from(prefix).some(&[1]).sight(0).is_none());
    }
}
