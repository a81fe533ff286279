//! One skeleton for a mesh of several that were drawn.

use riglab_core::Mesh;
use riglab_geom::{CloudConfig, CloudSampler};
use riglab_metric::{Joints, apart_from, consensus, refined, symmetrised};
use riglab_nn::generate::GenerateConfig;
use riglab_nn::perceiver::PerceiverConfig;
use riglab_random::stream;
use riglab_token::{Bones, Decoded, Template, Tokenizer};

use super::batch::{Batch, looked_at};
use super::evaluate::joints;

/// Draws, clouds and rounds at most: all draws of a mesh are kept, and each is compared with each.
const MOST: usize = 4096;

/// How many skeletons are drawn for a mesh, after which point clouds of it, and what is made of them (`eval.consensus` and
/// the keys after it).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Agreement {
    /// Skeletons of each mesh.
    pub draws: usize,
    /// Point clouds of each mesh that they are shared out to.
    pub clouds: usize,
    /// Whether every other cloud is seen in the mirror, x for -x. What is drawn after it only votes: the names of its
    /// sides are exchanged.
    pub mirror: bool,
    /// Rounds in which the joints of the one that is taken move to where the others have them.
    pub refine: usize,
}

/// What came of the draws for a mesh.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Agreed {
    /// The place of the draw that was taken.
    pub place: usize,
    /// How far what comes of it is from the draws that have a say, where there are several: see [`apart_from`].
    pub apart: Option<f64>,
    /// Its tokens and what they say with refined joints, where they move.
    pub refined: Option<(Vec<u32>, Decoded)>,
}

/// What is taken of the draws for a mesh.
pub(crate) struct Chosen<D> {
    /// Which it is.
    pub place: usize,
    /// As [`Agreed::apart`].
    pub apart: Option<f64>,
    /// The draw, refined.
    pub drawn: D,
}

impl Agreement {
    /// (key, message) of the first fault.
    pub fn validate(&self) -> Result<(), (&'static str, String)> {
        let most = |what: &str, n| format!("{n} {what}: give {MOST} at most");
        match *self {
            Self { draws: 0, .. } => {
                Err(("eval.consensus", "at least one skeleton is drawn: give 1 or more".to_owned()))
            }
            Self { clouds: 0, .. } => {
                Err(("eval.clouds", "a mesh is looked at once at least: give 1 or more".to_owned()))
            }
            Self { draws: n, .. } if n > MOST => Err(("eval.consensus", most("skeletons of each mesh", n))),
            Self { clouds: n, .. } if n > MOST => Err(("eval.clouds", most("point clouds of each mesh", n))),
            Self { refine: n, .. } if n > MOST => Err(("eval.refine", most("rounds", n))),
            _ => Ok(()),
        }
    }

    /// How many are drawn after each cloud, the first ones at most one more than the others; after no more clouds than
    /// there are draws.
    pub fn shares(&self) -> Vec<usize> {
        let clouds = self.clouds.min(self.draws);
        (0..clouds).map(|k| self.draws / clouds + usize::from(k < self.draws % clouds)).collect()
    }

    fn mirrored(&self, cloud: usize) -> bool {
        self.mirror && cloud % 2 == 1
    }

    /// The numbers of the clouds that are seen as they are.
    pub fn straight(&self) -> Vec<usize> {
        (0..self.clouds).filter(|&k| !self.mirrored(k)).collect()
    }

    /// Adds so many clouds of a mesh in the cube; `seed` and `key` say which points, the same of the first whatever their
    /// number.
    pub fn shapes(
        &self,
        how: (&CloudConfig, &PerceiverConfig),
        mesh: &Mesh,
        (seed, key): (u64, u64),
        clouds: usize,
        batch: &mut Batch,
    ) {
        let sampler = CloudSampler::new(mesh, how.0);
        for number in 0..clouds {
            let which = [key, number as u64];
            let mut random = stream(seed, "skeleton evaluation", if number == 0 { &which[..1] } else { &which });
            looked_at(how, &sampler, self.mirrored(number), &mut random, batch);
        }
    }

    /// Of each draw whether it is made after a cloud in the mirror, those of one cloud after those of another.
    pub fn draws_mirrored(&self) -> impl Iterator<Item = bool> {
        self.shares().into_iter().enumerate().flat_map(|(cloud, own)| std::iter::repeat_n(self.mirrored(cloud), own))
    }

    /// Of the draws for a mesh, those of one cloud after those of another, the one that the others agree with most, `None`
    /// where none can be taken. It is refined, and made its own image in the mirror at x = `plane` where there is one, where
    /// the tokens of what comes of it pass `fits`.
    pub fn of<'a>(
        &self,
        tokenizer: &Tokenizer,
        drawn: impl Iterator<Item = Option<&'a Decoded>>,
        plane: Option<f64>,
        fits: impl Fn(&[u32]) -> bool,
    ) -> Option<Agreed> {
        let (mut places, mut candidates, mut voters) = (Vec::new(), Vec::new(), Vec::new());
        for (place, (decoded, mirrored)) in drawn.zip(self.draws_mirrored()).enumerate() {
            let Some(decoded) = decoded else { continue };
            if mirrored {
                voters.push(joints_in_the_mirror(decoded));
            } else {
                places.push((place, decoded));
                candidates.push(joints(decoded));
            }
        }
        let at = consensus(&candidates, &voters)?;
        let (place, decoded) = places[at];
        let own = candidates[at].clone();
        voters.append(&mut candidates);
        // What has no bones says nothing of where joints are.
        voters.retain(|v| v.positions.len() > 1);
        let moved = || {
            let mut joints = refined(&own, &voters, self.refine);
            if let Some(plane) = plane {
                joints = symmetrised(&joints, plane, &partners(&decoded.names, decoded.class.as_deref()));
            }
            let joints = joints.positions;
            let bones = Bones { joints: &joints, parents: &decoded.parents, names: &decoded.names };
            let ids = tokenizer.encode_bones(&bones, decoded.class.as_deref()).ok()?.ids;
            let said = tokenizer.decode(&ids).ok()?;
            fits(&ids).then_some((ids, said))
        };
        let moves = self.refine > 0 || plane.is_some();
        let refined = (moves && own.positions.len() > 1).then(moved).flatten();
        let found = refined.as_ref().map_or(decoded, |(_, said)| said);
        let apart = (voters.len() > 1).then(|| apart_from(&joints(found), &voters));
        Some(Agreed { place, apart, refined })
    }

    /// What a report says of how skeletons are drawn and one is made of several, where it is not as the papers do.
    pub fn told(&self, generate: &GenerateConfig) -> String {
        let clouds = self.shares().len();
        let mirror = if self.mirror { ", every other one mirrored" } else { "" };
        let all = [
            (true, generate.draws(self.draws)),
            (clouds > 1, format!("from {clouds} point clouds{mirror}")),
            (
                self.draws > 1 && self.refine > 0,
                "the chosen one's joints moved to where the others have them".to_owned(),
            ),
        ];
        let said = all.into_iter().filter(|(so, said)| *so && !said.is_empty()).map(|(_, said)| said);
        said.collect::<Vec<_>>().join("; ")
    }
}

/// Of the joints of a class that a template tells, which is whose on the other side; not of others.
pub(crate) fn partners(names: &[String], class: Option<&str>) -> Vec<Option<usize>> {
    let Some(template) = class.and_then(Template::of) else { return Vec::new() };
    let place = |other: &str| names.iter().position(|name| name == other);
    names.iter().map(|name| template.mirrored(name).and_then(place)).collect()
}

/// The joints of a draw, turned back from the mirror that its cloud was seen in.
pub(crate) fn joints_in_the_mirror(decoded: &Decoded) -> Joints {
    let mut seen = joints(decoded);
    seen.positions.iter_mut().for_each(|p| p[0] = -p[0]);
    seen
}

#[cfg(test)]
mod tests {
    use riglab_token::TokenizerConfig;

    use super::*;

    const PLAIN: Agreement = Agreement { draws: 3, clouds: 1, mirror: false, refine: 0 };

    /// A chain to the right, of x.
    fn chain(x: [f32; 3]) -> Decoded {
        let names = (0..3).map(|k| format!("bone_{k}")).collect();
        let joints = x.map(|x| [x, 0.0, 0.0]).to_vec();
        Decoded { joints, parents: vec![None, Some(0), Some(1)], names, class: None, parts: Vec::new() }
    }

    fn agreed(agreement: Agreement, drawn: &[Option<Decoded>]) -> Option<Agreed> {
        let tokenizer = Tokenizer::new(TokenizerConfig::default());
        agreement.of(&tokenizer, drawn.iter().map(Option::as_ref), None, |ids| ids.len() < 20)
    }

    fn of(lengths: &[f32]) -> Vec<Option<Decoded>> {
        lengths.iter().map(|&l| (l != 0.0).then(|| chain([0.0, l / 2.0, l]))).collect()
    }

    #[test]
    fn of_the_draws_for_a_mesh_the_medoid_is_given() {
        let taken = |lengths: &[f32]| agreed(PLAIN, &of(lengths)).map(|a| (a.place, a.refined));
        assert_eq!(taken(&[0.1, 0.9, 0.5]), Some((2, None)), "the middle one");
        assert_eq!(taken(&[0.0, 0.0, 0.7]), Some((2, None)), "the only one");
        assert_eq!(taken(&[0.0; 3]), None);
    }

    #[test]
    fn draws_are_shared_out_to_clouds() {
        let of = |draws, clouds| Agreement { draws, clouds, ..PLAIN }.shares();
        assert_eq!(of(12, 4), [3; 4]);
        assert_eq!(of(11, 4), [3, 3, 3, 2]);
        assert_eq!(of(2, 8), [1, 1], "no cloud that nothing is drawn after");
        assert_eq!(Agreement { clouds: 5, mirror: true, ..PLAIN }.straight(), [0, 2, 4]);
        assert_eq!(Agreement { clouds: 2, ..PLAIN }.straight(), [0, 1]);
        let mirrored = Agreement { draws: 5, clouds: 2, mirror: true, ..PLAIN };
        assert_eq!(mirrored.draws_mirrored().collect::<Vec<_>>(), [false, false, false, true, true]);
        assert_eq!(Agreement { clouds: 0, ..PLAIN }.validate().unwrap_err().0, "eval.clouds");
        assert_eq!(Agreement { draws: 0, ..PLAIN }.validate().unwrap_err().0, "eval.consensus");
        assert_eq!(Agreement { draws: 9_999_999, ..PLAIN }.validate().unwrap_err().0, "eval.consensus");
        assert_eq!(Agreement { clouds: 9_999_999, ..PLAIN }.validate().unwrap_err().0, "eval.clouds");
        assert_eq!(Agreement { refine: 9_999_999, ..PLAIN }.validate().unwrap_err().0, "eval.refine");
    }

    #[test]
    fn what_is_drawn_in_the_mirror_votes_turned_back_and_is_not_taken() {
        let mirror = Agreement { draws: 6, clouds: 2, mirror: true, refine: 0 };
        // Straight ones to the right, mirrored ones to the left: most say .5.
        let drawn = of(&[0.1, 0.5, 0.9, -0.5, -0.5, -0.5]);
        assert_eq!(agreed(mirror, &drawn).unwrap().place, 1);
        let drawn = of(&[0.1, 0.5, 0.9, -0.1, -0.1, -0.1]);
        assert_eq!(agreed(mirror, &drawn).unwrap().place, 0);
        assert_eq!(agreed(mirror, &of(&[0.0, 0.0, 0.0, -0.1, -0.1, -0.1])), None);
    }

    #[test]
    fn refined_joints_are_where_most_have_them_and_are_a_sequence() {
        let refine = Agreement { draws: 5, refine: 20, ..PLAIN };
        let middle = [0.2, 0.3, 0.32, 0.34, 0.9].map(|middle| Some(chain([-0.5, middle, 0.95])));
        let own = agreed(refine, &middle).unwrap();
        let (ids, said) = own.refined.unwrap();
        let apart = |drawn: &[Option<Decoded>]| agreed(refine, drawn).unwrap().apart.unwrap();
        assert!(apart(&middle) > 1.5 * apart(&middle[1..4]), "{} {}", apart(&middle), apart(&middle[1..4]));
        let tokenizer = Tokenizer::new(TokenizerConfig::default());
        assert_eq!(tokenizer.decode(&ids).unwrap(), said);
        assert_eq!((said.parents, said.class), (vec![None, Some(0), Some(1)], None));
        let found: Vec<f32> = said.joints.iter().map(|p| p[0]).collect();
        assert!(found.iter().zip([-0.5, 0.32, 0.95]).all(|(a, b)| (a - b).abs() < 0.02), "{found:?}");
        // What does not fit is left as it was drawn, and what has no bone has nothing to refine.
        let refused = refine.of(&tokenizer, middle.iter().map(Option::as_ref), None, |_| false).unwrap();
        assert_eq!((refused.place, refused.refined), (own.place, None));
        let own = middle[0].clone().unwrap();
        let point = Decoded { joints: vec![[0.5; 3]], parents: vec![None], names: vec!["bone_0".into()], ..own };
        let alone = agreed(Agreement { draws: 1, ..refine }, &[Some(point)]).unwrap();
        assert_eq!((alone.refined, alone.apart), (None, None));
    }

    #[test]
    fn a_named_make_keeps_its_names() {
        let tokenizer = Tokenizer::new(TokenizerConfig::default());
        let joints: Vec<[f64; 3]> = (0..3).map(|k| [0.0, 0.3 * f64::from(k) - 0.5, 0.0]).collect();
        let bones = Bones { joints: &joints, parents: &[None, Some(0), Some(1)], names: &[] };
        let ids = tokenizer.encode_bones(&bones, Some("mixamo")).unwrap().ids;
        let drawn = tokenizer.decode(&ids).unwrap();
        // Moved nowhere by others that say the same: the same tokens again.
        let three = [Some(&drawn); 3].into_iter();
        let own = Agreement { refine: 3, ..PLAIN }.of(&tokenizer, three, None, |_| true).unwrap();
        assert_eq!(own.refined, Some((ids, drawn.clone())));
    }

    #[test]
    fn both_sides_are_images_of_each_other_where_the_mesh_is_its_own() {
        let tokenizer = Tokenizer::new(TokenizerConfig::default());
        // A root and a hand on either side, the right one lower: x and y.
        let joints = [[0.0, 0.0], [0.5, 0.4], [-0.46, 0.3]].map(|[x, y]| [x, y, 0.0]);
        let drawn = Decoded { joints: joints.to_vec(), parents: vec![None, Some(0), Some(0)], ..chain([0.0; 3]) };
        let agreed = |plane| PLAIN.of(&tokenizer, [Some(&drawn); 3].into_iter(), plane, |_| true).unwrap().refined;
        assert_eq!(agreed(None), None, "nothing moves");
        let found = agreed(Some(0.0)).unwrap().1.joints;
        let hand = |side: f32| found.iter().find(|p| p[0] * side > 0.1).unwrap();
        let cell = 2.0 / 256.0;
        assert!(
            (hand(1.0)[0] + hand(-1.0)[0]).abs() <= cell && (hand(1.0)[1] - hand(-1.0)[1]).abs() < 1e-6,
            "{found:?}"
        );
        assert!((hand(1.0)[0] - 0.48).abs() <= cell && (hand(1.0)[1] - 0.35).abs() <= cell, "{found:?}");
    }

    #[test]
    fn what_a_template_names_is_told_by_its_names() {
        let names = ["mixamorig:Hips", "mixamorig:LeftArm", "tail", "mixamorig:RightArm", "mixamorig:LeftHand"];
        let names = names.map(str::to_owned);
        assert_eq!(partners(&names, Some("mixamo")), [Some(0), Some(3), None, Some(1), None]);
        assert_eq!(partners(&names, None), []);
    }

    #[test]
    fn the_first_cloud_is_the_same_whatever_comes_after_and_the_mirror_turns_positions_and_normals() {
        let corners = [[-0.8, -0.8, -0.8], [0.8, -0.8, -0.8], [0.0, 0.8, 0.0], [0.0, 0.0, 0.8]];
        let mesh = Mesh::new(corners.to_vec(), vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]]).unwrap();
        let (cloud, model) = (
            CloudConfig { points: 64, ..CloudConfig::default() },
            PerceiverConfig { tokens: 4, drawn: 2, ..PerceiverConfig::default() },
        );
        let clouds = |agreement: Agreement, count| {
            let mut batch = Batch::default();
            agreement.shapes((&cloud, &model), &mesh, (0, 7), count, &mut batch);
            batch
        };
        let (one, two) = (clouds(PLAIN, 1), clouds(PLAIN, 2));
        let mirrored = clouds(Agreement { mirror: true, ..PLAIN }, 2);
        let n = one.cloud.len();
        assert_eq!((one.rigs, two.rigs, two.cloud.len()), (1, 2, 2 * n));
        assert_eq!(one.cloud, two.cloud[..n]);
        assert_ne!(one.cloud, two.cloud[n..], "sampled anew");
        assert_eq!(one.cloud, mirrored.cloud[..n]);
        for (plain, seen) in two.cloud[n..].chunks(3).zip(mirrored.cloud[n..].chunks(3)) {
            assert_eq!(seen, [-plain[0], plain[1], plain[2]]);
        }
        assert_eq!(two.picks, mirrored.picks);
    }

    #[test]
    fn a_report_says_what_was_done() {
        let plain = GenerateConfig::default();
        assert_eq!(PLAIN.told(&plain), "");
        let all = Agreement { draws: 64, clouds: 8, mirror: true, refine: 5 };
        let cooler = GenerateConfig { temperature: 0.8, ..plain.clone() };
        assert_eq!(
            all.told(&cooler),
            "temperature 0.8; from 8 point clouds, every other one mirrored; the chosen one's joints moved to \
             where the others have them"
        );
        assert_eq!(Agreement { draws: 1, ..all }.told(&plain), "");
        let two = Agreement { draws: 2, refine: 0, ..all };
        assert_eq!(two.told(&plain), "from 2 point clouds, every other one mirrored");
    }
}
