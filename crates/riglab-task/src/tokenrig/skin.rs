//! Weights of a skeleton's joints: of codes drawn for them, decoded, averaged, spread and cut.

use rayon::prelude::*;
use riglab_core::{DecodeRule, Mesh, Segment, Skeleton, SkinWeights, Vec3};
use riglab_geom::spread_weights;
use riglab_nn::generate::GenerateConfig;
use riglab_nn::params::Weights;
use riglab_random::stream;

use super::condition::Condition;
use super::skinner::Skinner;
use super::{RigSample, Rigger};
use crate::fsq_cvae::Prior;

/// Codes of each joint; `None` where it moves nothing.
pub type Codes = Vec<Option<Vec<i64>>>;

impl Rigger {
    /// Codes for the skeleton that was drawn, or given, of a shape as it was seen, one of each of its clouds in turn: its own,
    /// which are of the first, then draws until there are `count`. `key` seeds them.
    ///
    /// # Errors
    /// When the skeleton is no beginning of a sequence.
    pub fn skins(
        &self,
        w: &Weights,
        seen: &Condition,
        drawn: &RigSample,
        count: usize,
        key: u64,
    ) -> Result<Vec<Codes>, String> {
        let (eval, mut all) = (&self.config().eval, vec![drawn.codes.clone()]);
        let more = count.saturating_sub(1);
        if more > 0 && drawn.decoded.is_ok() {
            let how = GenerateConfig { sample: true, ..eval.generate.clone() };
            let mut streams: Vec<_> = (0..more as u64).map(|k| stream(eval.seed, "skins", &[key, k])).collect();
            let prompts = vec![drawn.skeleton.clone(); more];
            let of_clouds = match seen.rows() {
                1 => seen.first(1),
                n => seen.some(&(1..count).map(|k| k % n).collect::<Vec<_>>()),
            };
            let others = self.draw(w, &of_clouds, &prompts, &how, &mut streams)?;
            all.extend(others.into_iter().map(|d| d.codes));
        }
        Ok(all)
    }

    /// Weights of a mesh in the cube by codes of a skeleton's joints, the mean of several skins, pooled with what the
    /// auto-encoder says without any code where it can (`eval.without_codes`): spread, cut, the four largest kept,
    /// normalised. A vertex that no joint claims goes to the nearest bone. `key` seeds the points of its shape. Several
    /// are decoded in bfloat16 where the processor has it.
    ///
    /// # Errors
    /// When mesh and skeleton make no rig.
    pub fn skin(&self, mesh: &Mesh, skeleton: &Skeleton, skins: &[Codes], key: u64) -> Result<SkinWeights, String> {
        let hold = Hold { without_codes: self.config().eval.without_codes, ..Hold::default() };
        self.pooled_skin(mesh, skeleton, skins, key, hold)
    }

    /// As [`Self::skin`], where something else is wanted.
    ///
    /// # Errors
    /// As [`Self::skin`].
    pub(super) fn pooled_skin(
        &self,
        mesh: &Mesh,
        skeleton: &Skeleton,
        skins: &[Codes],
        key: u64,
        hold: Hold<'_>,
    ) -> Result<SkinWeights, String> {
        let eval = &self.config().eval;
        let mut random = stream(eval.seed, "skin evaluation", &[key]);
        let skinner = Skinner::new(self.vae(), mesh, eval.vertices, &mut random)?;
        // What bfloat16 is off by is far below what skins differ by.
        let half = skins.len() > 1 && riglab_torch::multiplies_bf16() && self.device() == tch::Device::Cpu;
        let skinner = if half { skinner.half() } else { skinner };
        let all = skeleton.segments();
        let able: Vec<usize> = (0..skeleton.len()).filter(|&j| hold.holders.is_none_or(|able| able[j])).collect();
        let claims = |j: &usize| skins.iter().any(|codes| codes.get(*j).is_some_and(Option::is_some));
        let claimed: Vec<usize> = able.iter().copied().filter(claims).collect();
        let segments: Vec<Vec<Segment>> = claimed.iter().map(|&j| all[j].clone()).collect();
        let mut priors = Priors::default();
        let mut raw = mean(&skinner, &mut priors, &claimed, &segments, skins);
        if hold.without_codes > 0.0 && skinner.has_prior() && !raw.is_empty() {
            let (all, none): (Vec<usize>, Vec<&[i64]>) = (0..claimed.len()).map(|c| (c, &[][..])).unzip();
            priors.add(&skinner, &segments, &all);
            let without = skinner.raw(&segments, &none, priors.of(&all));
            pool(&mut raw, &without, claimed.len(), hold.without_codes);
        }
        let far = f64::from(eval.spread);
        if far > 0.0 && !raw.is_empty() {
            let distance: Vec<f64> =
                mesh.positions().par_iter().map(|&p| far * f64::from(to_nearest(&segments, p).1)).collect();
            raw = spread_weights(mesh, &raw, &distance);
        }
        let rule = DecodeRule { cut: eval.cut, influences: hold.influences };
        let of_able: Vec<Vec<Segment>> = able.iter().map(|&j| all[j].clone()).collect();
        let m = claimed.len();
        let mut row = vec![0.0; m];
        let rows = (0..mesh.positions().len()).map(|v| {
            if !raw.is_empty() {
                row.copy_from_slice(&raw[v * m..(v + 1) * m]);
            }
            rule.apply(&mut row);
            let held = row.iter().zip(&claimed).filter(|(w, _)| **w > 0.0);
            let mut own: Vec<(u16, f64)> = held.map(|(w, &j)| (j as u16, f64::from(*w))).collect();
            if own.is_empty() {
                own.push((able[to_nearest(&of_able, mesh.positions()[v]).0] as u16, 1.0));
            }
            own
        });
        SkinWeights::normalized(rows).map_err(|e| e.to_string())
    }
}

/// What weights a skin may have.
#[derive(Clone, Copy, Debug)]
pub(super) struct Hold<'a> {
    /// The share of what the auto-encoder says without any code (`eval.without_codes`).
    pub without_codes: f32,
    /// Joints that hold a vertex, at most.
    pub influences: usize,
    /// Of each joint whether it may hold anything; any may where it is not told. One at least.
    pub holders: Option<&'a [bool]>,
}

impl Default for Hold<'_> {
    fn default() -> Self {
        Self { without_codes: 0.0, influences: 4, holders: None }
    }
}

/// Codes in the order of a skeleton's joints: of joint `order[k]` there are the k-th.
pub(super) fn in_order(codes: Codes, order: &[usize], joints: usize) -> Codes {
    let mut own = vec![None; joints];
    codes.into_iter().zip(order).for_each(|(codes, &joint)| own[joint] = codes);
    own
}

/// What geometry alone says of some of the joints that are claimed, for an auto-encoder that is told: the same for the
/// same joints.
#[derive(Default)]
struct Priors(Vec<(Vec<usize>, Prior)>);

impl Priors {
    /// Looks it up for some columns of `segments`, once.
    fn add(&mut self, skinner: &Skinner<'_>, segments: &[Vec<Segment>], columns: &[usize]) {
        if self.of(columns).is_none()
            && let Some(prior) = skinner.prior(&some(segments, columns))
        {
            self.0.push((columns.to_vec(), prior));
        }
    }

    fn of(&self, columns: &[usize]) -> Option<&Prior> {
        self.0.iter().find(|(own, _)| own == columns).map(|(_, prior)| prior)
    }
}

fn some(segments: &[Vec<Segment>], columns: &[usize]) -> Vec<Vec<Segment>> {
    columns.iter().map(|&c| segments[c].clone()).collect()
}

/// What skins say of the joints that some of them claim, in the mean; a row a vertex, a column a joint. Each is decoded
/// by itself: what a bone is given depends on the others.
fn mean(
    skinner: &Skinner<'_>,
    priors: &mut Priors,
    claimed: &[usize],
    segments: &[Vec<Segment>],
    skins: &[Codes],
) -> Vec<f32> {
    let m = claimed.len();
    let columns = |codes: &Codes| -> Vec<usize> {
        (0..m).filter(|&c| codes.get(claimed[c]).is_some_and(Option::is_some)).collect()
    };
    let asked: Vec<(Vec<usize>, &Codes)> = skins.iter().map(|codes| (columns(codes), codes)).collect();
    asked.iter().for_each(|(columns, _)| priors.add(skinner, segments, columns));
    let told = |skinner: &Skinner<'_>, (columns, codes): &(Vec<usize>, &Codes)| {
        let own: Vec<&[i64]> = columns.iter().filter_map(|&c| codes[claimed[c]].as_deref()).collect();
        skinner.at_places(&some(segments, columns), &own, priors.of(columns))
    };
    let mut out = Vec::new();
    // As many at a time as there are threads: each takes a row a place.
    for some in asked.chunks(tch::get_num_threads().max(1) as usize) {
        for (raw, (columns, _)) in skinner.each(some, told).into_iter().zip(some) {
            if raw.is_empty() {
                continue;
            }
            out.resize(raw.len() / columns.len() * m, 0.0);
            out.par_chunks_exact_mut(m).zip(raw.par_chunks_exact(columns.len())).for_each(|(out, raw)| {
                columns.iter().zip(raw).for_each(|(&c, w)| out[c] += w / skins.len() as f32);
            });
        }
    }
    skinner.of_vertices(out, m)
}

/// Rows of weights `said`, of `m` each, pooled with `others` of the same: said^(1 - share) others^share, summing to 1.
/// What one of them is sure not to hold, neither holds.
fn pool(said: &mut [f32], others: &[f32], m: usize, share: f32) {
    const NONE: f32 = 1e-6;
    said.par_chunks_exact_mut(m).zip(others.par_chunks_exact(m)).for_each(|(said, others)| {
        let sums = [said.iter().sum::<f32>(), others.iter().sum()].map(|sum| sum.max(NONE));
        for (w, other) in said.iter_mut().zip(others) {
            *w = (*w / sums[0] + NONE).powf(1.0 - share) * (other / sums[1] + NONE).powf(share);
        }
        let sum: f32 = said.iter().sum();
        said.iter_mut().for_each(|w| *w /= sum);
    });
}

/// The joint whose bones are nearest to a point, and how far they are.
fn to_nearest(segments: &[Vec<Segment>], p: Vec3) -> (usize, f32) {
    let all = segments.iter().map(|bone| Segment::nearest_of(bone, p).1).enumerate();
    all.min_by(|a, b| a.1.total_cmp(&b.1)).unwrap_or((0, f32::INFINITY))
}

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::Head;

    use super::*;
    use crate::tokenrig::testing::{tetrahedron, untrained, with_prior};

    #[test]
    fn vertices_beyond_the_limit_are_told_by_their_neighbours() {
        let mesh = tetrahedron();
        let mut rigger = untrained(Head::Levels, true);
        let skeleton =
            riglab_core::Skeleton::new(vec![riglab_core::Joint { name: "root".into(), parent: None, head: [0.0; 3] }])
                .unwrap();
        rigger.config.eval.vertices = 2;
        let weights = rigger.skin(&mesh, &skeleton, &[vec![Some(vec![3, 5])]], 0).unwrap();
        assert_eq!((weights.rows(), weights.nonzero()), (4, 4));
    }

    #[test]
    fn joints_that_may_hold_nothing_hold_nothing() {
        let (mesh, mut rigger) = (tetrahedron(), untrained(Head::Levels, true));
        rigger.config.eval.cut = 0.0;
        let joint = |name: &str, parent, head| riglab_core::Joint { name: name.into(), parent, head };
        let joints = vec![
            joint("root", None, [-0.8, -0.8, -0.8]),
            joint("tip", Some(riglab_core::JointId(0)), [0.8, 0.8, -0.8]),
        ];
        let skeleton = riglab_core::Skeleton::new(joints).unwrap();
        let of = |hold: Hold<'_>, codes| {
            let weights = rigger.pooled_skin(&mesh, &skeleton, &[codes], 0, hold).unwrap();
            [0, 1].map(|joint| (0..4).filter(|&v| weights.row(v).any(|(j, _)| j.index() == joint)).count())
        };
        let both = || vec![Some(vec![3, 5]), Some(vec![7, 1])];
        assert_eq!(of(Hold::default(), both()), [4, 4]);
        let one = Hold { holders: Some(&[false, true]), ..Hold::default() };
        assert_eq!(of(one, both()), [0, 4]);
        // Nor where no other joint has codes: vertices go to the nearest of those that may.
        assert_eq!(of(one, vec![Some(vec![3, 5]), None]), [0, 4]);
        let [root, tip] = of(Hold { influences: 1, ..Hold::default() }, both());
        assert_eq!(root + tip, 4);
    }

    #[test]
    fn spread_weights_change_less_over_the_surface() {
        let mesh = tetrahedron();
        let mut rigger = untrained(Head::Levels, true);
        let joint = |name: &str, parent, head| riglab_core::Joint { name: name.into(), parent, head };
        let joints = vec![
            joint("root", None, [-0.8, -0.8, -0.8]),
            joint("tip", Some(riglab_core::JointId(0)), [0.8, 0.8, -0.8]),
        ];
        let skeleton = riglab_core::Skeleton::new(joints).unwrap();
        let mut weights_of_root = |spread| {
            rigger.config.eval.spread = spread;
            rigger.config.eval.cut = 0.0;
            let weights = rigger.skin(&mesh, &skeleton, &[vec![Some(vec![3, 5]), Some(vec![7, 1])]], 0).unwrap();
            let of = |v| weights.row(v).find(|(j, _)| j.index() == 0).map_or(0.0, |(_, w)| w);
            (0..4).map(of).collect::<Vec<f32>>()
        };
        let range = |w: &[f32]| w.iter().fold(0.0, |a: f32, &x| a.max(x)) - w.iter().fold(1.0, |a: f32, &x| a.min(x));
        let [none, some, much] = [0.0, 0.5, 10.0].map(&mut weights_of_root);
        assert!(range(&none) > range(&some) && range(&some) > range(&much), "{none:?} {some:?} {much:?}");
        rigger.config.eval.spread = -0.5;
        assert_eq!(rigger.config.validate().unwrap_err().0, "eval.spread");
    }

    #[test]
    fn several_skins_count_by_their_mean() {
        let (mesh, rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let skinner = Skinner::new(rigger.vae(), &mesh, 100, &mut stream(0, "test", &[])).unwrap();
        let segments =
            vec![vec![Segment { a: [-0.8; 3], b: [0.8, 0.8, -0.8] }], vec![Segment { a: [0.0; 3], b: [0.1; 3] }]];
        let [a, b, c] = [vec![3, 5], vec![7, 1], vec![0, 11]];
        // Of joints 0 and 2; joint 1 is claimed by none, joint 2 by two of three.
        let skins = [
            vec![Some(a.clone()), None, Some(b.clone())],
            vec![Some(c.clone()), None, None],
            vec![Some(a.clone()), None, Some(c.clone())],
        ];
        let both = |first: &[i64], second: &[i64]| skinner.raw(&segments, &[first, second], None);
        let (ab, c_alone, ac) = (both(&a, &b), skinner.raw(&segments[..1], &[&c], None), both(&a, &c));
        let found = mean(&skinner, &mut Priors::default(), &[0, 2], &segments, &skins);
        for v in 0..4 {
            let want = [(ab[2 * v] + c_alone[v] + ac[2 * v]) / 3.0, (ab[2 * v + 1] + ac[2 * v + 1]) / 3.0];
            assert!((0..2).all(|k| (found[2 * v + k] - want[k]).abs() < 1e-5), "{found:?} {want:?}");
        }
        assert_eq!(mean(&skinner, &mut Priors::default(), &[0, 2], &segments, &skins[..1]), ab);
        assert!(mean(&skinner, &mut Priors::default(), &[], &[], &skins).is_empty());
    }

    #[test]
    fn bones_of_a_prior_are_read_among_those_that_a_skin_claims() {
        let (mesh, rigger) = (tetrahedron(), with_prior(Head::Levels));
        let skinner = Skinner::new(rigger.vae(), &mesh, 100, &mut stream(0, "test", &[])).unwrap();
        let segments =
            vec![vec![Segment { a: [-0.8; 3], b: [0.8, 0.8, -0.8] }], vec![Segment { a: [0.0; 3], b: [0.1; 3] }]];
        let raw = |segments: &[Vec<Segment>], codes: &[&[i64]]| {
            skinner.raw(segments, codes, skinner.prior(segments).as_ref())
        };
        // The second joint is claimed by one skin of two.
        let skins = [vec![Some(vec![3, 5]), Some(vec![7, 1])], vec![Some(vec![0, 11]), None]];
        let (both, first) = (raw(&segments, &[&[3, 5], &[7, 1]]), raw(&segments[..1], &[&[0, 11]]));
        let mut priors = Priors::default();
        let found = mean(&skinner, &mut priors, &[0, 1], &segments, &skins);
        assert!(priors.0.len() == 2 && priors.of(&[0]).is_some() && priors.of(&[1]).is_none());
        for v in 0..4 {
            let want = [(both[2 * v] + first[v]) / 2.0, both[2 * v + 1] / 2.0];
            assert!((0..2).all(|k| (found[2 * v + k] - want[k]).abs() < 1e-5), "{found:?} {want:?}");
        }
    }

    #[test]
    fn weights_are_pooled_with_what_is_said_without_codes() {
        let near = |a: &[f32], b: &[f32]| assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-3), "{a:?} {b:?}");
        let pooled = |share| {
            // Rows that do not sum to 1 count as if they did; one says nothing.
            let mut said = vec![1.6, 0.4, 0.0, 1.0, 0.0, 0.0];
            pool(&mut said, &[0.25, 0.25, 0.1, 0.9, 0.2, 0.8], 2, share);
            said
        };
        near(&pooled(0.0), &[0.8, 0.2, 0.0, 1.0, 0.5, 0.5]);
        near(&pooled(0.5), &[2.0 / 3.0, 1.0 / 3.0, 0.0, 1.0, 1.0 / 3.0, 2.0 / 3.0]);
        near(&pooled(1.0), &[0.5, 0.5, 0.1, 0.9, 0.2, 0.8]);

        // It counts where the auto-encoder has something to say without codes, and only there.
        let mesh = tetrahedron();
        let joint = |name: &str, parent, head| riglab_core::Joint { name: name.into(), parent, head };
        let joints = vec![
            joint("root", None, [-0.8, -0.8, -0.8]),
            joint("tip", Some(riglab_core::JointId(0)), [0.8, 0.8, -0.8]),
        ];
        let skeleton = riglab_core::Skeleton::new(joints).unwrap();
        for (mut rigger, changes) in [(with_prior(Head::Levels), true), (untrained(Head::Levels, true), false)] {
            let mut weights = |share| {
                (rigger.config.eval.without_codes, rigger.config.eval.cut) = (share, 0.0);
                let weights = rigger.skin(&mesh, &skeleton, &[vec![Some(vec![3, 5]), Some(vec![7, 1])]], 0).unwrap();
                (0..4).flat_map(|v| weights.row(v).map(|(_, w)| w).collect::<Vec<f32>>()).collect::<Vec<f32>>()
            };
            let [none, half, all] = [0.0, 0.5, 1.0].map(&mut weights);
            assert_eq!(none != half && half != all, changes, "{none:?} {half:?} {all:?}");
            rigger.config.eval.without_codes = 1.5;
            assert_eq!(rigger.config.validate().unwrap_err().0, "eval.without_codes");
        }
    }

    #[test]
    fn draws_for_a_skeleton_are_added_to_its_own_codes() {
        let (mesh, rigger) = (tetrahedron(), untrained(Head::Levels, true));
        let prefix = rigger.condition(rigger.params().weights(), &[(&mesh, 0)]);
        let (how, streams) = (GenerateConfig::default(), &mut [stream(0, "test", &[])]);
        let drawn = rigger.draw(rigger.params().weights(), &prefix, &[rigger.free()], &how, streams).unwrap().remove(0);
        let skins = |count| rigger.skins(rigger.params().weights(), &prefix, &drawn, count, 0).unwrap();
        assert_eq!(skins(1), std::slice::from_ref(&drawn.codes));
        let skins = [skins(5), skins(5)];
        assert_eq!(skins[0], skins[1]);
        let skins = &skins[0];
        assert_eq!((skins.len(), &skins[0]), (5, &drawn.codes));
        assert!(skins.iter().all(|codes| codes.len() == drawn.codes.len()) && skins[1] != skins[2]);
        assert_eq!(in_order(skins[1].clone(), &[2, 0], 3)[1], None);
    }
}
