//! Where each bone works, as geometry says.

use riglab_core::{Mesh, Segment, Vec3};
use riglab_geom::{BLOCK, bone_distances};
use riglab_nn::fsq_cvae::REGION;

/// Vertices that bones are looked for at, at most.
const ASKED: usize = 2048;
/// A vertex is a bone's by its nearness to this power, over that of all bones.
const SHARP: i32 = 8;
/// Smaller shares are none.
const LEAST: f32 = 0.01;
/// No bone is nearer than this, in a cube from -1 to 1.
const NEAREST: f32 = 1e-4;

/// A surface as bones are looked for on it: some of its vertices, spread by number, with their areas.
pub struct Surface {
    points: Vec<(Vec3, f32)>,
}

impl Surface {
    /// Of a mesh in the cube.
    pub fn new(mesh: &Mesh) -> Self {
        Self::with(mesh, &areas(mesh))
    }

    /// As [`Self::new`], with the areas of the mesh's vertices.
    pub fn with(mesh: &Mesh, areas: &[f32]) -> Self {
        let all = mesh.positions().iter().copied().zip(areas.iter().copied());
        Self { points: all.step_by(mesh.positions().len().div_ceil(ASKED).max(1)).collect() }
    }
}

/// What of a surface lies nearest to each bone of a rig.
pub struct Regions {
    /// Places, each with its area and where its shares end.
    asked: Vec<(Vec3, f32, u32)>,
    /// Bones with their shares, one place after another.
    shares: Vec<(u32, f32)>,
    /// The first segment of each bone.
    segments: Vec<Segment>,
}

impl Regions {
    /// Of a surface and the segments of the bones.
    pub fn new(surface: &Surface, bones: &[Vec<Segment>]) -> Self {
        let (mut asked, mut shares) = (Vec::with_capacity(surface.points.len()), Vec::new());
        let (mut rows, mut near) = (Vec::new(), Vec::with_capacity(BLOCK));
        for points in surface.points.chunks(BLOCK) {
            near.clear();
            near.extend(points.iter().map(|own| own.0));
            bone_distances(&near, bones, &mut rows);
            let (mut least, mut sums) = ([f32::INFINITY; BLOCK], [0.0; BLOCK]);
            for row in &mut rows {
                row.iter_mut().for_each(|c| *c = c.max(NEAREST));
                least.iter_mut().zip(row).for_each(|(least, c)| *least = least.min(*c));
            }
            for row in &mut rows {
                row.iter_mut().zip(&least).for_each(|(c, least)| *c = (least / *c).powi(SHARP));
                sums.iter_mut().zip(row).for_each(|(sum, c)| *sum += *c);
            }
            for (k, &(p, area)) in points.iter().enumerate() {
                let own = (0u32..).zip(&rows).map(|(bone, row)| (bone, row[k] / sums[k]));
                shares.extend(own.filter(|(_, share)| *share > LEAST));
                asked.push((p, area, shares.len() as u32));
            }
        }
        let first = |bone: &Vec<Segment>| bone.first().copied().unwrap_or(Segment { a: [0.0; 3], b: [0.0; 3] });
        Self { asked, shares, segments: bones.iter().map(first).collect() }
    }

    /// Each place with its area and its bones' shares.
    fn places(&self) -> impl Iterator<Item = (Vec3, f32, &[(u32, f32)])> {
        let starts = std::iter::once(0).chain(self.asked.iter().map(|own| own.2));
        self.asked
            .iter()
            .zip(starts)
            .map(|(&(p, area, end), start)| (p, area, &self.shares[start as usize..end as usize]))
    }

    /// Of each bone the centre of its region and the deviation from it, by area, with places moved by a map. A bone
    /// that nothing is near to has its own place.
    pub fn under(&self, map: impl Fn(Vec3) -> Vec3) -> Vec<[f32; REGION]> {
        const { assert!(REGION == 6) };
        // Of each the area, and its first and second moments.
        let mut sums = vec![[0.0f64; 7]; self.segments.len()];
        for (p, area, shares) in self.places() {
            let p = map(p).map(f64::from);
            for &(bone, share) in shares {
                let (sum, w) = (&mut sums[bone as usize], f64::from(share) * f64::from(area));
                sum[0] += w;
                for k in 0..3 {
                    sum[1 + k] += w * p[k];
                    sum[4 + k] += w * p[k] * p[k];
                }
            }
        }
        let region = |(sum, segment): (&[f64; 7], &Segment)| -> [f32; REGION] {
            if sum[0] > 1e-9 {
                let center: [f64; 3] = std::array::from_fn(|k| sum[1 + k] / sum[0]);
                let square = |k: usize| sum[4 + k] / sum[0] - center[k] * center[k];
                std::array::from_fn(|k| if k < 3 { center[k] } else { square(k - 3).max(0.0).sqrt() } as f32)
            } else {
                let (a, b) = (map(segment.a), map(segment.b));
                let size = |k: usize| (0.3 * (a[k] - b[k]).abs()).max(0.02);
                std::array::from_fn(|k| if k < 3 { 0.5 * (a[k] + b[k]) } else { size(k - 3) })
            }
        };
        sums.iter().zip(&self.segments).map(region).collect()
    }

    /// Of each bone its share of all area, and the largest share that it has of any place.
    pub fn shares(&self) -> Vec<[f32; 2]> {
        let (mut out, mut all) = (vec![[0.0f32; 2]; self.segments.len()], 0.0);
        for (_, area, shares) in self.places() {
            all += area;
            for &(bone, share) in shares {
                let [sum, most] = &mut out[bone as usize];
                (*sum, *most) = (*sum + share * area, most.max(share));
            }
        }
        out.iter_mut().for_each(|own| own[0] /= all.max(1e-9));
        out
    }
}

/// The area of each vertex, none quite 0.
pub fn areas(mesh: &Mesh) -> Vec<f32> {
    let mut areas = vec![1e-9; mesh.positions().len()];
    for (t, corners) in mesh.triangles().iter().enumerate() {
        let area = mesh.area_vector(t).iter().map(|x| x * x).sum::<f32>().sqrt() / 3.0;
        corners.iter().for_each(|&v| areas[v as usize] += area);
    }
    areas
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn regions_are_what_lies_nearest_and_move_with_it() {
        // Two squares, at x = -1 and x = 1, each with a bone; a third bone far above both.
        let square = |x: f32| [[x, 0.0, 0.0], [x, 1.0, 0.0], [x, 1.0, 1.0], [x, 0.0, 1.0]];
        let positions = [square(-1.0), square(1.0)].concat();
        let mesh = Mesh::new(positions, vec![[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]]).unwrap();
        let bone = |x: f32, y: f32| vec![Segment { a: [x, y, 0.5], b: [x, y + 0.4, 0.5] }];
        let regions = Regions::new(&Surface::new(&mesh), &[bone(-1.0, 0.3), bone(1.0, 0.3), bone(0.0, 20.0)]);
        let near = |found: &[f32], want: &[f32]| {
            assert!(found.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-2), "{found:?}, expected {want:?}");
        };
        let found = regions.under(|p| p);
        near(&found[0], &[-1.0, 0.5, 0.5, 0.0, 0.5, 0.5]);
        near(&found[1], &[1.0, 0.5, 0.5, 0.0, 0.5, 0.5]);
        near(&found[2], &[0.0, 20.2, 0.5, 0.02, 0.12, 0.02]);
        let moved = regions.under(|p| p.map(|x| 2.0 * x));
        near(&moved[0], &[-2.0, 1.0, 1.0, 0.0, 1.0, 1.0]);
        near(&moved[2], &[0.0, 40.4, 1.0, 0.02, 0.24, 0.02]);
        let shares = regions.shares();
        near(&shares.concat(), &[0.5, 1.0, 0.5, 1.0, 0.0, 0.0]);
    }
}
