//! The body under a surface as it comes.

use rayon::prelude::*;
use riglab_core::Mesh;

use super::lattice::{Lattice, Voxels};
use super::shell::shell;
use super::{orient, rays};

/// How a body is made of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SolidConfig {
    /// Cells along the longest side of the mesh's box.
    pub resolution: usize,
    /// From what share of directions a cell's middle must be inside, above.
    pub inside: f64,
    /// Which cells that the surface touches count besides.
    pub shell: Shell,
}

/// Cells that the surface touches, as part of the body.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shell {
    /// None: what is thinner than a cell has holes or is lost.
    Without,
    /// Those away from all cells that are inside, with the ones that join them to the body: capes, hair and
    /// blades stay, and a body is as large as it is.
    Thin,
    /// All: a body grows by three quarters of a cell.
    Whole,
}

impl SolidConfig {
    /// 196 cells as in UniRig and SkinTokens, inside from more than half of the directions, thin parts kept.
    pub const DEFAULT: Self = Self { resolution: 196, inside: 0.5, shell: Shell::Thin };
}

impl Default for SolidConfig {
    /// [`Self::DEFAULT`].
    fn default() -> Self {
        Self::DEFAULT
    }
}

/// The cells of a mesh's body.
///
/// A cell is inside where most of 26 directions say so, each by what a ray enters and leaves: the winding
/// number of Jacobson et al. (2013), summed over few directions. An open end closes by a flat lid, holes
/// smaller than their distance do no harm, pieces in one another count once, and pieces that face inwards are
/// turned. Whatever the number of threads, the result is the same.
pub fn solid(mesh: &Mesh, config: &SolidConfig) -> Voxels {
    solid_in(mesh, Lattice::around(mesh, config.resolution), config)
}

/// The same in a given lattice.
fn solid_in(mesh: &Mesh, lattice: Lattice, config: &SolidConfig) -> Voxels {
    let votes = rays::votes(mesh, &orient::turned(mesh), &lattice);
    let least = config.inside.clamp(0.0, 1.0) * f64::from(rays::TOTAL);
    let word = |cells: &[u16]| {
        let bits = cells.iter().enumerate().map(|(bit, v)| u64::from(f64::from(*v) > least) << bit);
        bits.fold(0, |word, bit| word | bit)
    };
    let words = votes.par_chunks(64).with_min_len(1024).map(word).collect();
    let mut voxels = Voxels::from_words(lattice, words);
    match config.shell {
        Shell::Without => {}
        Shell::Thin => add_thin(&mut voxels, &shell(mesh, &lattice)),
        Shell::Whole => voxels.add(&shell(mesh, &lattice)),
    }
    voxels
}

/// Adds the cells of a shell that have no cell of the body around them, and those beside such ones.
fn add_thin(body: &mut Voxels, shell: &Voxels) {
    let around = |voxels: &Voxels, place: [usize; 3]| {
        (0..27).any(|s| {
            let step = [s / 9 - 1, s / 3 % 3 - 1, s % 3 - 1];
            voxels.is_occupied(std::array::from_fn(|k| place[k] as isize + step[k]))
        })
    };
    let places: Vec<[usize; 3]> = shell.places().collect();
    let lattice = *body.lattice();
    let away: Vec<[usize; 3]> = places.par_iter().copied().filter(|p| !around(body, *p)).collect();
    if away.is_empty() {
        return;
    }
    let thin = Voxels::new(lattice, away);
    let joining: Vec<[usize; 3]> = places.par_iter().copied().filter(|p| around(&thin, *p)).collect();
    body.add(&Voxels::new(lattice, joining));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bodies::{capsule, joined, turned_on_a_lathe, turned_over, without_some};

    const BARE: SolidConfig = SolidConfig { resolution: 64, inside: 0.5, shell: Shell::Without };

    fn near(got: f64, wanted: f64, share: f64) {
        assert!((got / wanted - 1.0).abs() < share, "{got}, not {wanted}");
    }

    #[test]
    fn volumes_of_a_sphere_and_a_capsule() {
        let ball = 4.0 / 3.0 * std::f64::consts::PI;
        near(solid(&capsule(1.0, 0.0, 40), &BARE).volume(), ball, 0.01);
        near(solid(&capsule(1.0, 2.0, 41), &BARE).volume(), ball + 2.0 * std::f64::consts::PI, 0.01);
        // The mean over directions of half a cell's width, |x| + |y| + |z| of a unit vector, is 3/4.
        let grown = ball * (1.0 + 0.75 * 2.0 / 63.0f64).powi(3);
        near(solid(&capsule(1.0, 0.0, 40), &SolidConfig { shell: Shell::Whole, ..BARE }).volume(), grown, 0.02);
    }

    #[test]
    fn an_open_tube_is_as_full_as_a_closed_one() {
        let tube = turned_on_a_lathe(&[[0.5, 0.0], [0.5, 1.5], [0.5, 3.0]], 48);
        let mut body = solid(&tube, &SolidConfig { resolution: 96, ..BARE });
        near(body.volume(), std::f64::consts::PI * 0.25 * 3.0, 0.03);
        // A sleeve: one end closed, the other open.
        let sleeve = turned_on_a_lathe(&[[0.0, 0.0], [0.5, 0.0], [0.5, 3.0]], 48);
        body = solid(&sleeve, &SolidConfig { resolution: 96, ..BARE });
        near(body.volume(), std::f64::consts::PI * 0.25 * 3.0, 0.03);
    }

    #[test]
    fn an_eighth_of_the_faces_changes_little() {
        for mesh in [capsule(1.0, 0.0, 40), capsule(0.4, 2.0, 41), turned_over(&capsule(1.0, 1.0, 31), |t| t % 3 == 0)]
        {
            let whole = solid(&mesh, &BARE);
            for seed in 0..3 {
                let torn = solid_in(&without_some(&mesh, 0.125, seed), *whole.lattice(), &BARE);
                near(torn.volume(), whole.volume(), 0.02);
                let differs = whole.indices().filter(|i| !torn.has(*i)).count();
                near(1.0 + differs as f64 / whole.count() as f64, 1.0, 0.02);
            }
        }
    }

    #[test]
    fn pieces_in_one_another_and_inside_out_make_one_body() {
        let eye = turned_over(&capsule(0.3, 0.0, 12), |_| true);
        let head = capsule(1.0, 0.0, 40);
        let both = joined(&[head.clone(), eye]);
        assert_eq!(solid(&both, &BARE), solid(&head, &BARE));
    }

    #[test]
    fn sheets_stay_by_their_shell() {
        let sheet = Mesh::new(vec![[0.0; 3], [4.0, 0.0, 0.0], [0.0, 3.0, 0.0]], vec![[0, 1, 2]]).unwrap();
        assert_eq!(solid(&sheet, &BARE).count(), 0);
        let shell = solid(&sheet, &SolidConfig { shell: Shell::Whole, ..BARE });
        assert!(shell.count() > 1000 && shell.lattice().size[2] == 1);
        assert_eq!(solid(&sheet, &SolidConfig { shell: Shell::Thin, ..BARE }), shell);
        let ball = capsule(1.0, 0.0, 40);
        assert_eq!(solid(&ball, &SolidConfig { shell: Shell::Thin, ..BARE }), solid(&ball, &BARE));
        let nothing = Mesh::new(vec![[1e30; 3]], vec![[0; 3]]).unwrap();
        assert_eq!(solid(&nothing, &SolidConfig::default()).count(), 1);
    }

    #[test]
    fn threads_do_not_change_the_body() {
        let mesh = without_some(&capsule(1.0, 1.0, 61), 0.125, 1);
        let with = |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| solid(&mesh, &BARE));
        assert_eq!(with(1), with(3));
    }
}
