//! From codes to weights, on one mesh.

use std::sync::Arc;

use rayon::prelude::*;
use riglab_core::{Mesh, Rig, Segment, Skeleton, SkinWeights};
use riglab_geom::Transfer;
use riglab_random::{Draw, Stream};
use tch::{Kind, Tensor};

use crate::fsq_cvae::{Coder, Frozen, Point, Prepared, Prior, SurfacePrior};

/// Vertices that tell one at which no weights were asked.
const NEIGHBOURS: usize = 8;

/// Points that tell a vertex, and how much each.
type Shares = Vec<(u32, f32)>;

/// A mesh in the cube, its shape read once, ready for the weights of any codes.
pub struct Skinner<'a> {
    vae: &'a Frozen,
    /// The mesh, with one joint that holds it all.
    prepared: Arc<Prepared>,
    points: Arc<Vec<Point>>,
    shape: Tensor,
    half: bool,
    /// Of each vertex, where not all were asked, the points that tell it.
    shares: Option<Arc<Vec<Shares>>>,
}

impl<'a> Skinner<'a> {
    /// Codes are asked for weights at `most` vertices; the others are told by the eight nearest of those, as released.
    /// `random` draws which, and the points that the shape is read by.
    ///
    /// # Errors
    /// When the mesh makes no rig.
    pub fn new(vae: &'a Frozen, mesh: &Mesh, most: usize, random: &mut Stream) -> Result<Self, String> {
        let n = mesh.positions().len();
        let at_root = SkinWeights::normalized((0..n).map(|_| [(0, 1.0)])).map_err(|e| e.to_string())?;
        let root = riglab_core::Joint { name: "root".into(), parent: None, head: [0.0; 3] };
        let skeleton = Skeleton::new(vec![root]).map_err(|e| e.to_string())?;
        let bare = Rig::new(skeleton, mesh.clone(), at_root).map_err(|e| e.to_string())?;
        let prepared = Prepared::of(String::new(), bare, false);
        let mut asked: Vec<u32> = (0..n as u32).collect();
        if n > most {
            random.shuffled(&mut asked);
            asked.truncate(most);
        }
        let points: Vec<Point> = asked.iter().map(|&v| prepared.vertex(v)).collect();
        let shape = vae.with(|coder| coder.shape(&prepared, random));
        let shares = (n > most).then(|| {
            let places: Vec<_> = points.iter().map(|p| p.position).collect();
            Arc::new(Transfer::new(&places, NEIGHBOURS).shares(mesh.positions()))
        });
        Ok(Self { vae, prepared: Arc::new(prepared), points: Arc::new(points), shape, half: false, shares })
    }

    /// The same, for another thread.
    pub fn another(&self) -> Self {
        let (prepared, points, shares) = (self.prepared.clone(), self.points.clone(), self.shares.clone());
        Self { vae: self.vae, prepared, points, shape: self.shape.shallow_clone(), half: self.half, shares }
    }

    /// What `of` gives of some items with it, in their order: the items are shared out among the threads there are, on the
    /// processor.
    pub fn each<T: Sync, R: Send>(&self, items: &[T], of: impl Fn(&Self, &T) -> R + Sync) -> Vec<R> {
        let threads = riglab_torch::threads_on(self.shape.device()).min(items.len()).max(1);
        let jobs = (0..threads).map(|t| {
            let (own, of) = (self.another(), &of);
            // One of each few: neighbours are alike, and so is what they cost.
            move || items.iter().skip(t).step_by(threads).map(|item| of(&own, item)).collect::<Vec<_>>()
        });
        let mut found: Vec<_> =
            riglab_torch::side_by_side(jobs.collect::<Vec<_>>()).into_iter().map(Vec::into_iter).collect();
        (0..items.len()).filter_map(|k| found[k % threads].next()).collect()
    }

    /// Weights are computed in bfloat16, see [`Frozen::with_half`].
    #[must_use]
    pub fn half(self) -> Self {
        Self { shape: self.shape.to_kind(Kind::BFloat16), half: true, ..self }
    }

    /// Whether the auto-encoder is told what geometry alone says, and so has something to say without codes.
    pub fn has_prior(&self) -> bool {
        self.vae.config().model.extensions.prior
    }

    /// What geometry alone says of some bones, for an auto-encoder that is told.
    pub fn prior(&self, segments: &[Vec<Segment>]) -> Option<Prior> {
        self.has_prior().then(|| Prior::new(self.prepared.rig.mesh(), segments))
    }

    /// Raw shares of each vertex, a row a vertex, a column a bone: `segments` and `codes` are those of each, as many codes
    /// of each as of the others; `prior` is [`Self::prior`] of the same bones.
    pub fn raw(&self, segments: &[Vec<Segment>], codes: &[&[i64]], prior: Option<&Prior>) -> Vec<f32> {
        self.of_vertices(self.at_places(segments, codes, prior), segments.len())
    }

    /// As [`Self::raw`], at the places where the auto-encoder is asked: of large meshes fewer than there are vertices.
    pub fn at_places(&self, segments: &[Vec<Segment>], codes: &[&[i64]], prior: Option<&Prior>) -> Vec<f32> {
        let Some(first) = codes.first() else { return Vec::new() };
        let size = [codes.len() as i64, first.len() as i64];
        let decode = |coder: Coder<'_>| {
            let ids = Tensor::from_slice(&codes.concat()).view(size).to_device(coder.device);
            // Not in the kind of the weights: frames that codes tell are finer than bfloat16 holds.
            let codes = coder.net.fsq().codes(&ids, Kind::Float);
            let told = prior.map(|prior| SurfacePrior { prior, triangles: self.prepared.rig.mesh().triangles() });
            coder.decode(&self.shape, &codes, &self.points, segments, told)
        };
        if self.half { self.vae.with_half(decode) } else { self.vae.with(decode) }
    }

    /// Shares of each vertex, `m` of each, by those at places; a mean of skins is taken before.
    pub fn of_vertices(&self, known: Vec<f32>, m: usize) -> Vec<f32> {
        let Some(shares) = self.shares.as_ref().filter(|_| !known.is_empty()) else { return known };
        let mut out = vec![0.0; shares.len() * m];
        out.par_chunks_exact_mut(m).zip(shares.par_iter()).for_each(|(row, shares)| {
            for &(k, share) in shares {
                let known = &known[k as usize * m..(k as usize + 1) * m];
                row.iter_mut().zip(known).for_each(|(w, known)| *w += share * known);
            }
        });
        out
    }
}
