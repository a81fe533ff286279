//! What geometry alone says of bones' weights, before any code: the extension `prior`.
//!
//! Heat that the bones give the surface says how far each reaches and what is joined to what; the piece of surface
//! around a point says whether it is a part of its own, as of armour or a machine, which one bone moves as a whole; and
//! [`Regions`] say where each bone works and how large that is. Distances are straight: this is asked anew for each
//! skeleton that is drawn.

use rayon::prelude::*;
use riglab_core::{Mesh, Segment};
use riglab_geom::{BLOCK, HOTTEST, SurfaceHeat, bone_distances, pieces};
use riglab_nn::fsq_cvae::{PRIOR, REGION};

use super::prepare::Place;
use super::region::{Regions, Surface, areas};

/// Bones whose distances differ by less than this share are equally near.
const EQUAL: f32 = 1e-4;
/// Less heat than this is none.
const COLD: f32 = 1e-4;

/// Of a mesh and its bones.
pub struct Prior {
    /// Each bone's region.
    regions: Vec<[f32; REGION]>,
    /// The row of heat of each vertex, and its piece.
    places: Vec<(u32, u32)>,
    /// Shares of the heat, those of a row summing to 1.
    heat: Vec<[(f32, u32); HOTTEST]>,
    /// Where the bones of each piece begin.
    offsets: Vec<u32>,
    bones: Vec<BoneShare>,
    pieces: Vec<Piece>,
}

/// A bone of a piece.
#[derive(Clone, Copy)]
struct BoneShare {
    bone: u32,
    /// Its share of the piece's heat, by area.
    heat: f32,
    /// The share of the piece that it is nearest to.
    nearest: f32,
}

#[derive(Clone, Copy)]
struct Piece {
    /// The logarithm of its share of the surface, over 4.
    size: f32,
    /// The largest of its bones' shares of heat.
    most: f32,
}

/// What geometry says of a mesh, with the triangles that its surface points lie on.
#[derive(Clone, Copy)]
pub struct SurfacePrior<'a> {
    /// What it says.
    pub prior: &'a Prior,
    /// The mesh's triangles.
    pub triangles: &'a [[u32; 3]],
}

impl Prior {
    /// Of a mesh in the cube and the segments of its bones.
    pub fn new(mesh: &Mesh, bones: &[Vec<Segment>]) -> Self {
        let (near, distance) = nearest(mesh, bones);
        let surface = SurfaceHeat::new(mesh, &distance);
        let mut heat = surface.hottest(&near, bones.len());
        for row in &mut heat {
            let sum: f32 = row.iter().map(|(w, _)| w).sum();
            if sum > 0.0 && sum.is_finite() {
                row.iter_mut().for_each(|(w, _)| *w /= sum);
            } else {
                *row = [(0.0, u32::MAX); HOTTEST];
            }
        }
        let (areas, (of_vertices, count)) = (areas(mesh), pieces(mesh, &surface));
        let places: Vec<(u32, u32)> =
            surface.rows().iter().zip(&of_vertices).map(|(&row, &piece)| (row as u32, piece)).collect();

        let mut held: Vec<(u32, BoneShare)> = Vec::new();
        let mut sizes = vec![0.0f32; count];
        for ((&(row, piece), &area), near) in places.iter().zip(&areas).zip(&near) {
            sizes[piece as usize] += area;
            let hot = heat[row as usize].iter().filter(|(_, bone)| *bone != u32::MAX);
            held.extend(hot.map(|&(w, bone)| (piece, BoneShare { bone, heat: area * w, nearest: 0.0 })));
            let nearest = area / near.len().max(1) as f32;
            held.extend(near.iter().map(|&bone| (piece, BoneShare { bone, heat: 0.0, nearest })));
        }
        // Stable, so that sums are the same each time.
        held.par_sort_by_key(|(piece, own)| (*piece, own.bone));
        held.dedup_by(|new, sum| {
            let same = (new.0, new.1.bone) == (sum.0, sum.1.bone);
            if same {
                sum.1.heat += new.1.heat;
                sum.1.nearest += new.1.nearest;
            }
            same
        });
        let all: f32 = sizes.iter().sum();
        let mut pieces: Vec<Piece> =
            sizes.iter().map(|size| Piece { size: (size / all).max(1e-6).ln() / 4.0, most: 1e-6 }).collect();
        let mut offsets = vec![0; count + 1];
        for (piece, own) in &mut held {
            let at = *piece as usize;
            own.heat /= sizes[at];
            own.nearest /= sizes[at];
            pieces[at].most = pieces[at].most.max(own.heat);
            offsets[at + 1] += 1;
        }
        (0..count).for_each(|at| offsets[at + 1] += offsets[at]);
        let regions = Regions::new(&Surface::with(mesh, &areas), bones).under(|p| p);
        Self { regions, places, heat, offsets, bones: held.into_iter().map(|(_, own)| own).collect(), pieces }
    }

    /// Each bone's region, as [`Regions::under`] gives it where nothing is moved.
    pub fn regions(&self) -> &[[f32; REGION]] {
        &self.regions
    }

    /// About how many bytes it takes.
    pub fn bytes(&self) -> usize {
        size_of_val(&*self.heat) + size_of_val(&*self.places) + size_of_val(&*self.bones)
    }
}

impl SurfacePrior<'_> {
    /// Adds what it says of a bone at a place, [`PRIOR`] numbers: heat's share, its logarithm, of the piece the bone's
    /// share of the heat and of what is nearest, the piece's size, and both shares of heat over those of the bone that has
    /// most.
    pub fn tell(&self, place: &Place, bone: usize, out: &mut Vec<f32>) {
        const { assert!(PRIOR == 7) };
        let own = self.prior;
        let of_vertex = |v: u32| {
            let row = &own.heat[own.places[v as usize].0 as usize];
            let heat = row.iter().find(|(_, b)| *b as usize == bone).map_or(0.0, |(w, _)| *w);
            (heat, row[0].0)
        };
        let (vertex, (heat, most)) = match place {
            Place::Vertex(v) => (*v, of_vertex(*v)),
            Place::Surface(p) => {
                let corners = self.triangles[p.triangle as usize];
                let told = corners.into_iter().zip(p.barycentric).map(|(v, share)| (of_vertex(v), share));
                let sum = told.fold((0.0, 0.0), |sum, ((heat, most), s)| (sum.0 + s * heat, sum.1 + s * most));
                (corners[0], sum)
            }
        };
        let at = own.places[vertex as usize].1 as usize;
        let piece = own.pieces[at];
        let bones = &own.bones[own.offsets[at] as usize..own.offsets[at + 1] as usize];
        let held = bones.binary_search_by_key(&(bone as u32), |held| held.bone).map(|k| bones[k]);
        let held = held.unwrap_or(BoneShare { bone: 0, heat: 0.0, nearest: 0.0 });
        out.extend([heat, heat.max(COLD).ln() / 4.0, held.heat, held.nearest, piece.size]);
        out.extend([heat / most.max(1e-6), held.heat / piece.most]);
    }
}

/// Of each vertex the bones that are nearest, one or several equally so, and how far they are.
fn nearest(mesh: &Mesh, bones: &[Vec<Segment>]) -> (Vec<Vec<u32>>, Vec<f64>) {
    let each = mesh.positions().par_chunks(BLOCK).map_init(Vec::new, |rows, points| {
        bone_distances(points, bones, rows);
        let of_vertex = |k: usize| {
            let far = || rows.iter().map(|row| row[k]);
            let least = far().fold(f32::INFINITY, f32::min);
            let limit = least * (1.0 + EQUAL) + 1e-7;
            let near = (0u32..).zip(far()).filter(|(_, far)| *far <= limit).map(|(bone, _)| bone);
            (near.collect(), f64::from(least))
        };
        (0..points.len()).map(of_vertex).collect::<Vec<_>>()
    });
    each.flatten_iter().unzip()
}

#[cfg(test)]
mod tests {
    use riglab_core::Vec3;
    use riglab_geom::SurfacePoint;

    use super::*;

    /// A strip of quads along x from `from` to `to`, at a height.
    fn strip(from: f32, to: f32, y: f32, out: &mut (Vec<Vec3>, Vec<[u32; 3]>)) {
        let first = out.0.len() as u32;
        let count = 10u32;
        for k in 0..=count {
            let x = from + (to - from) * k as f32 / count as f32;
            out.0.extend([[x, y, -0.1], [x, y, 0.1]]);
        }
        for k in 0..count {
            let a = first + 2 * k;
            out.1.extend([[a, a + 1, a + 2], [a + 1, a + 3, a + 2]]);
        }
    }

    fn told(prior: &Prior, mesh: &Mesh, place: Place, bone: usize) -> Vec<f32> {
        let mut out = Vec::new();
        SurfacePrior { prior, triangles: mesh.triangles() }.tell(&place, bone, &mut out);
        assert_eq!(out.len(), PRIOR);
        out
    }

    #[test]
    fn a_piece_belongs_to_the_bone_it_lies_at_and_heat_falls_from_bone_to_bone() {
        // A long strip with two bones end to end, and a short piece above the second.
        let mut made = (Vec::new(), Vec::new());
        strip(-1.0, 1.0, 0.0, &mut made);
        strip(0.4, 0.6, 0.3, &mut made);
        let mesh = Mesh::new(made.0, made.1).unwrap();
        let bone = |a: f32, b: f32| vec![Segment { a: [a, 0.05, 0.0], b: [b, 0.05, 0.0] }];
        let prior = Prior::new(&mesh, &[bone(-1.0, 0.0), bone(0.0, 1.0)]);
        assert!(prior.bytes() > 0);
        let of = |v: u32, bone| told(&prior, &mesh, Place::Vertex(v), bone);
        // Heat, along the strip: vertices 0, 4, .. 20 are one in five of it.
        let heat: Vec<f32> = [0, 4, 8, 12, 16, 20].map(|v| of(v, 0)[0]).to_vec();
        assert!(heat.windows(2).all(|w| w[0] > w[1]) && heat[0] > 0.9 && heat[5] < 0.1, "{heat:?}");
        assert!((of(8, 0)[0] + of(8, 1)[0] - 1.0).abs() < 1e-5);
        // The hottest bone's share over its own is 1.
        assert!((of(0, 0)[5] - 1.0).abs() < 1e-6 && of(20, 0)[5] < 0.2);
        // The short piece is the second bone's, as a whole; half of the strip is the first's.
        let piece = of(30, 1);
        assert!(piece[2] > 0.99 && piece[3] == 1.0 && piece[6] == 1.0, "{piece:?}");
        assert_eq!(of(30, 0)[2..4], [0.0, 0.0]);
        assert!((of(0, 0)[3] - 0.5).abs() < 0.1 && of(0, 0)[4] > piece[4], "the strip is larger");
        // Between vertices it is what they say, in proportion.
        let (a, b) = (of(0, 0), of(2, 0));
        let between = Place::Surface(SurfacePoint { triangle: 0, barycentric: [0.5, 0.0, 0.5] });
        assert!((told(&prior, &mesh, between, 0)[0] - 0.5 * (a[0] + b[0])).abs() < 1e-6);
    }

    #[test]
    fn whatever_the_mesh_is_like_numbers_are_finite() {
        // No area at all, and bones of no length in one place.
        let mesh = Mesh::new(vec![[0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        let point = vec![Segment { a: [0.0; 3], b: [0.0; 3] }];
        let prior = Prior::new(&mesh, &[point.clone(), point]);
        for v in 0..3 {
            for bone in 0..2 {
                assert!(told(&prior, &mesh, Place::Vertex(v), bone).iter().all(|x| x.is_finite()));
            }
        }
        assert!(prior.regions().iter().flatten().all(|x| x.is_finite()));
        assert!(Prior::new(&mesh, &[]).regions().is_empty());
    }
}
