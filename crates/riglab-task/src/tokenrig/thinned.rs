//! Skeletons of more joints than a model reads: some of the joints stand for those beside them.

use std::borrow::Cow;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

use rayon::prelude::*;
use riglab_core::{DecodeRule, Joint, JointId, Mesh, Segment, Similarity, Skeleton, SkinWeights};
use riglab_token::{Encoded, Template};

use super::Rigger;
use super::skin::{Codes, Hold};

/// A given skeleton as the model reads it.
pub(super) struct ReadSkeleton<'a> {
    /// The joints that it reads: all of them, where it can.
    pub skeleton: Cow<'a, Skeleton>,
    /// Their sequence.
    pub encoded: Encoded,
    /// Of each given joint which of those stands for it, where some are left out.
    pub stands: Option<Vec<usize>>,
}

impl ReadSkeleton<'_> {
    /// How many of the joints that may hold something (`holders`: as for [`Rigger::read`]) were read, where not all were.
    pub(super) fn thinned(&self, holders: Option<&[bool]>) -> Option<usize> {
        let (mut next, mut read, mut all) = (0, 0, 0);
        for (j, &of) in self.stands.iter().flatten().enumerate() {
            // What is read stands for itself, and for joints after it.
            let own = of == next;
            next += usize::from(own);
            if holders.is_none_or(|able| able[j]) {
                (read, all) = (read + usize::from(own), all + 1);
            }
        }
        (read < all).then_some(read)
    }
}

impl Rigger {
    /// A skeleton as the model reads it; one of more joints or tokens than it takes is thinned out, see [`Thinning`].
    /// `holders`: whether each joint may hold anything; any may where it is not told.
    ///
    /// # Errors
    /// As [`Self::given`], where not even few of the joints can be read.
    pub(super) fn read<'a>(
        &self,
        skeleton: &'a Skeleton,
        map: Similarity,
        holders: Option<&[bool]>,
    ) -> Result<ReadSkeleton<'a>, String> {
        let mut thinning = Thinning::new(skeleton, holders);
        // What has too many joints need not be written to be known not to fit.
        let hopeless =
            |t: &Thinning| t.left > self.config.limits.joints || t.least_tokens() > self.config.limits.tokens;
        if !hopeless(&thinning) {
            let encoded = self.encoded(skeleton, map)?;
            if self.reads(&encoded, skeleton.len()) {
                return Ok(ReadSkeleton { skeleton: Cow::Borrowed(skeleton), encoded, stands: None });
            }
        }
        while thinning.contract() {
            if hopeless(&thinning) {
                continue;
            }
            let (left, stands) = thinning.made(skeleton)?;
            let encoded = self.encoded(&left, map)?;
            if self.reads(&encoded, left.len()) {
                return Ok(ReadSkeleton { skeleton: Cow::Owned(left), encoded, stands: Some(stands) });
            }
        }
        // Not even its root is within the limits: which says how far it is from them.
        self.given(skeleton, map).map(|encoded| ReadSkeleton {
            skeleton: Cow::Borrowed(skeleton),
            encoded,
            stands: None,
        })
    }

    /// Weights for all joints of a skeleton, in the cube, by codes of those that were read; `map`: into the cube. As
    /// [`Self::pooled_skin`] of these where they are all, else [`shared_out`].
    ///
    /// # Errors
    /// As [`Self::skin`].
    pub(super) fn read_skin(
        &self,
        (mesh, whole): (&Mesh, &Skeleton),
        (read, map): (&ReadSkeleton<'_>, Similarity),
        skins: &[Codes],
        key: u64,
        (holders, hold): (Option<&[bool]>, Hold<'_>),
    ) -> Result<SkinWeights, String> {
        let Some(stands) = &read.stands else {
            return self.pooled_skin(mesh, whole, skins, key, Hold { holders, ..hold });
        };
        let heads = read.skeleton.heads().iter().map(|&p| map.apply(p)).collect();
        let left = read.skeleton.with_heads(heads).map_err(|e| e.to_string())?;
        // What stands for a joint that may hold something may do so.
        let mut able = vec![false; left.len()];
        stands.iter().enumerate().for_each(|(j, &of)| able[of] |= holders.is_none_or(|holders| holders[j]));
        let weights = self.pooled_skin(mesh, &left, skins, key, Hold { holders: Some(&able), ..hold })?;
        shared_out(mesh, whole, (&weights, stands), holders, hold.influences)
    }
}

/// Takes joints out of a skeleton one by one, each into its parent, which then stands for it: first those that hold nothing,
/// then those that are no part of the skeleton's template (hair and clothes of an avatar), of these always the one that is
/// nearest to its parent. Chains become coarser so, and keep where they end.
struct Thinning {
    heads: Vec<glam::Vec3>,
    /// The parent among those that are left.
    parents: Vec<Option<usize>>,
    /// Those that hang on a joint, with some that are gone, and how many of them are left.
    children: Vec<Vec<usize>>,
    living: Vec<usize>,
    /// In which of three kinds a joint is taken; the root is in none.
    kinds: Vec<u8>,
    gone: Vec<bool>,
    left: usize,
    /// Joints that are left and have no children.
    tips: usize,
    /// Joints whose parents the sequence need not tell, at most: those of a template.
    told: usize,
    /// Joints by when they are taken, the next one first; what hangs elsewhere by now is out of date.
    next: BinaryHeap<Reverse<Next>>,
}

/// A joint that may be taken out: its kind, the length of its bone in bits, which are in the order of numbers as it is not
/// negative, the joint, and its parent.
type Next = (u8, u32, usize, usize);

impl Thinning {
    fn new(skeleton: &Skeleton, holders: Option<&[bool]>) -> Self {
        let names = skeleton.names();
        let template = Template::detect(names);
        let kind = |j: usize| match (holders.is_none_or(|able| able[j]), template.is_some_and(|t| t.has(&names[j]))) {
            (false, _) => 0,
            (true, false) => 1,
            (true, true) => 2,
        };
        let count = skeleton.len();
        let mut thinning = Self {
            heads: skeleton.heads().iter().map(|&p| p.into()).collect(),
            parents: skeleton.parents().iter().map(|p| p.map(JointId::index)).collect(),
            children: vec![Vec::new(); count],
            living: vec![0; count],
            kinds: (0..count).map(kind).collect(),
            gone: vec![false; count],
            left: count,
            tips: 0,
            told: template.map_or(0, |t| t.joints().count()),
            next: BinaryHeap::with_capacity(count),
        };
        for joint in 0..count {
            if let Some(parent) = thinning.parents[joint] {
                thinning.children[parent].push(joint);
                thinning.living[parent] += 1;
                thinning.offer(joint, parent);
            }
        }
        thinning.tips = thinning.living.iter().filter(|living| **living == 0).count();
        thinning
    }

    fn offer(&mut self, joint: usize, parent: usize) {
        let away = (self.heads[joint] - self.heads[parent]).length();
        self.next.push(Reverse((self.kinds[joint], away.to_bits(), joint, parent)));
    }

    /// Takes out the next one; `false` where the root alone is left.
    fn contract(&mut self) -> bool {
        let (joint, parent) = loop {
            let Some(Reverse((_, _, joint, parent))) = self.next.pop() else { return false };
            if !self.gone[joint] && self.parents[joint] == Some(parent) {
                break (joint, parent);
            }
        };
        self.gone[joint] = true;
        self.left -= 1;
        self.tips -= usize::from(self.living[joint] == 0);
        self.living[parent] = self.living[parent] - 1 + self.living[joint];
        self.tips += usize::from(self.living[parent] == 0);
        for child in std::mem::take(&mut self.children[joint]) {
            if !self.gone[child] {
                self.parents[child] = Some(parent);
                self.children[parent].push(child);
                self.offer(child, parent);
            }
        }
        true
    }

    /// Tokens that the sequence of what is left has at least: three a joint, with the start, the class and the end; four more
    /// of each joint that cannot come right after its parent, as only one of several children does.
    fn least_tokens(&self) -> usize {
        3 * self.left + 3 + 4 * self.tips.saturating_sub(1 + self.told)
    }

    /// What is left, and of each joint which of those stands for it.
    fn made(&self, whole: &Skeleton) -> Result<(Skeleton, Vec<usize>), String> {
        let (mut places, mut joints) = (Vec::with_capacity(self.gone.len()), Vec::with_capacity(self.left));
        for j in 0..self.gone.len() {
            // Parents come before their children: theirs is known.
            let above = self.parents[j].map(|parent| places[parent]);
            places.push(match above.filter(|_| self.gone[j]) {
                Some(stands) => stands,
                None => joints.len(),
            });
            if !self.gone[j] {
                let parent = above.map(|parent: usize| JointId(parent as u16));
                joints.push(Joint { name: whole.names()[j].clone(), parent, head: whole.heads()[j] });
            }
        }
        Ok((Skeleton::new(joints).map_err(|e| e.to_string())?, places))
    }
}

/// Weights of all joints by those of the ones that stand for them: each shares what it holds of a vertex out among the joints
/// that it stands for, by the fourth power of how near their bones are, as the best rule by straight distances does
/// ([`super::told`]), of whom so many `influences` hold a vertex at most. Weights were cut before: no piece of one is. `holders`
/// as for [`Rigger::read`]; what stands for none that may hold anything keeps what it has.
///
/// # Errors
/// When the weights cannot be those of a skeleton.
pub(super) fn shared_out(
    mesh: &Mesh,
    whole: &Skeleton,
    (weights, stands): (&SkinWeights, &[usize]),
    holders: Option<&[bool]>,
    influences: usize,
) -> Result<SkinWeights, String> {
    let rule = DecodeRule { cut: 0.0, influences };
    let segments = whole.segments();
    let mut groups = vec![Vec::new(); stands.iter().max().map_or(0, |most| most + 1)];
    let able = |j: &usize| holders.is_none_or(|able| able[*j]);
    (0..stands.len()).filter(able).for_each(|j| groups[stands[j]].push(j));
    for (j, &stands) in stands.iter().enumerate() {
        // Nobody else can hold it.
        if groups[stands].is_empty() {
            groups[stands].push(j);
        }
    }
    let near = |j: usize, v: usize| {
        let d = Segment::nearest_of(&segments[j], mesh.positions()[v]).1.max(NEAR);
        d.powi(-4)
    };
    let row = |v: usize| -> Vec<(u16, f64)> {
        let (mut joints, mut row) = (Vec::new(), Vec::new());
        for (stands, weight) in weights.row(v) {
            let own = &groups[stands.index()];
            let shares: Vec<f32> = own.iter().map(|&j| if own.len() > 1 { near(j, v) } else { 1.0 }).collect();
            let sum: f32 = shares.iter().sum();
            joints.extend(own.iter().map(|&j| j as u16));
            row.extend(shares.iter().map(|share| weight * share / sum));
        }
        rule.apply(&mut row);
        joints.into_iter().zip(row.into_iter().map(f64::from)).filter(|(_, w)| *w > 0.0).collect()
    };
    let rows: Vec<_> = (0..weights.rows()).into_par_iter().map(row).collect();
    SkinWeights::normalized(rows).map_err(|e| e.to_string())
}

/// Nothing is nearer to a bone than this, in the cube of side 2: half of a cell of the tokens.
const NEAR: f32 = 1.0 / 256.0;

#[cfg(test)]
mod tests {
    use riglab_nn::tokenrig::Head;
    use riglab_random::{Draw, stream};

    use super::*;
    use crate::tokenrig::testing::{tetrahedron, untrained};
    use crate::tokenrig::{Rank, RigRequest};

    /// A chain of joints up the y axis, at these heights.
    fn chain(heights: &[f32]) -> Skeleton {
        let joint = |(k, &y): (usize, &f32)| Joint {
            name: format!("j{k}"),
            parent: k.checked_sub(1).map(|p| JointId(p as u16)),
            head: [0.0, y, 0.0],
        };
        Skeleton::new(heights.iter().enumerate().map(joint).collect()).unwrap()
    }

    /// What is left of a skeleton of so many joints, and what stands for each.
    fn thinned(skeleton: &Skeleton, holders: Option<&[bool]>, left: usize) -> (Vec<String>, Vec<usize>) {
        let mut thinning = Thinning::new(skeleton, holders);
        while thinning.left > left && thinning.contract() {}
        let (left, stands) = thinning.made(skeleton).unwrap();
        (left.names().to_vec(), stands)
    }

    #[test]
    fn the_joint_nearest_to_its_parent_goes_first_and_those_that_hold_nothing_before_it() {
        let skeleton = chain(&[0.0, 1.0, 1.1, 3.0, 3.5]);
        assert_eq!(
            thinned(&skeleton, None, 4),
            (["j0", "j1", "j3", "j4"].map(String::from).into(), vec![0, 1, 1, 2, 3])
        );
        // The next is the tip; what hung on a joint that went hangs on what stands for it.
        assert_eq!(thinned(&skeleton, None, 3), (["j0", "j1", "j3"].map(String::from).into(), vec![0, 1, 1, 2, 2]));
        assert_eq!(thinned(&skeleton, None, 1), (vec!["j0".into()], vec![0; 5]));
        let holders = [true, true, true, false, true];
        assert_eq!(thinned(&skeleton, Some(&holders), 4).1, [0, 1, 2, 2, 3]);
        // Of those that hold something it is told how many are read, where one is not.
        let mut rigger = untrained(Head::Levels, true);
        let mut told = |joints, holders| {
            (rigger.config.limits.joints, rigger.config.limits.tokens) = (joints, 100);
            rigger.read(&skeleton, Similarity::NONE, holders).unwrap().thinned(holders)
        };
        assert_eq!([told(5, None), told(4, None), told(3, None)], [None, Some(4), Some(3)]);
        assert_eq!([told(4, Some(&holders)), told(3, Some(&holders))], [None, Some(3)]);
        assert!(!{
            let mut one = Thinning::new(&chain(&[0.0]), None);
            one.contract()
        });
    }

    /// A tree whose bones have one of few lengths, so that many are equal.
    fn tree(seed: u64, count: usize) -> Skeleton {
        let mut random = stream(seed, "test", &[]);
        let joint = |k: usize| Joint {
            name: format!("j{k}"),
            parent: (k > 0).then(|| JointId(random.below(k) as u16)),
            head: std::array::from_fn(|_| random.below(4) as f32 / 4.0),
        };
        Skeleton::new((0..count).map(joint).collect()).unwrap()
    }

    /// Which joints are taken one after another, each looked for among all of them.
    fn plainly(skeleton: &Skeleton, holders: &[bool]) -> Vec<usize> {
        let at = |j: usize| glam::Vec3::from(skeleton.heads()[j]);
        let mut parents: Vec<Option<usize>> = skeleton.parents().iter().map(|p| p.map(JointId::index)).collect();
        let (mut left, mut out): (Vec<usize>, _) = ((0..parents.len()).collect(), Vec::new());
        loop {
            let away = |j: usize| Some((holders[j], (at(j) - at(parents[j]?)).length()));
            let open = left.iter().filter_map(|&j| Some((j, away(j)?)));
            let next = open.min_by(|(_, a), (_, b)| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
            let Some((next, _)) = next else { return out };
            let parent = parents[next];
            left.retain(|&j| j != next);
            left.iter().filter(|&&j| parents[j] == Some(next)).copied().collect::<Vec<_>>().into_iter().for_each(|j| {
                parents[j] = parent;
            });
            out.push(next);
        }
    }

    #[test]
    fn joints_go_in_the_order_of_looking_for_each_among_all() {
        for seed in 0..30 {
            let skeleton = tree(seed, 60);
            let mut random = stream(seed, "holders", &[]);
            let holders: Vec<bool> = (0..60).map(|_| random.chance(0.7)).collect();
            let mut thinning = Thinning::new(&skeleton, Some(&holders));
            for next in plainly(&skeleton, &holders) {
                let tips = (0..60).filter(|&j| !thinning.gone[j]);
                let tips =
                    tips.filter(|&j| (0..60).all(|c| thinning.gone[c] || thinning.parents[c] != Some(j))).count();
                assert_eq!(thinning.tips, tips);
                assert!(thinning.contract() && thinning.gone[next], "{seed}: {next}");
            }
            assert!(!thinning.contract() && thinning.left == 1);
        }
        // As many joints as there can be, in a chain and about one.
        let most = usize::from(u16::MAX);
        let about = |k: usize| Joint {
            name: format!("j{k}"),
            parent: (k > 0).then_some(JointId(0)),
            head: [k as f32, 0.0, 0.0],
        };
        for skeleton in [
            chain(&(0..most).map(|k| k as f32).collect::<Vec<_>>()),
            Skeleton::new((0..most).map(about).collect()).unwrap(),
        ] {
            assert_eq!(thinned(&skeleton, None, 1).1, vec![0; most]);
        }
    }

    #[test]
    fn what_is_read_is_the_first_that_fits_of_all_that_are_thinned() {
        let mut rigger = untrained(Head::Levels, true);
        (rigger.config.limits.joints, rigger.config.limits.tokens) = (12, 45);
        for seed in 0..20 {
            let skeleton = tree(seed, 30);
            let read = rigger.read(&skeleton, Similarity::NONE, None).unwrap();
            let mut thinning = Thinning::new(&skeleton, None);
            let wanted = loop {
                assert!(thinning.contract());
                let (left, stands) = thinning.made(&skeleton).unwrap();
                let encoded = rigger.encoded(&left, Similarity::NONE).unwrap();
                assert!(thinning.least_tokens() <= encoded.ids.len(), "{seed}");
                if rigger.reads(&encoded, left.len()) {
                    break (left, encoded, stands);
                }
            };
            assert_eq!((&*read.skeleton, &read.encoded, read.stands.as_ref()), (&wanted.0, &wanted.1, Some(&wanted.2)));
        }
    }

    #[test]
    fn parts_of_a_template_stay_longest() {
        let template = Template::ALL.iter().find(|t| t.class == "mixamo").unwrap();
        let mut joints: Vec<Joint> = template
            .joints()
            .enumerate()
            .map(|(k, (name, parent, _))| Joint {
                name: name.into(),
                parent: parent.map(|p| JointId(p as u16)),
                head: [0.0, 0.01 * k as f32, 0.0],
            })
            .collect();
        let body = joints.len();
        let hair = (0..3u16).map(|k| Joint {
            name: format!("hair{k}"),
            parent: Some(JointId(if k == 0 { 5 } else { body as u16 + k - 1 })),
            head: [f32::from(k + 1), 0.0, 0.0],
        });
        joints.extend(hair);
        let (left, stands) = thinned(&Skeleton::new(joints).unwrap(), None, body);
        assert!(left.iter().all(|name| template.has(name)) && stands[body..] == [5; 3], "{stands:?}");
    }

    #[test]
    fn weights_are_shared_out_by_distance_among_what_stands_together() {
        let mesh = tetrahedron();
        let whole = chain(&[-1.0, -0.5, 1.0]);
        // The first two stand for themselves, the second for the third.
        let weights = SkinWeights::normalized((0..4).map(|_| [(0, 0.25), (1, 0.75)])).unwrap();
        let of = |holders: Option<&[bool]>, influences| {
            let all = shared_out(&mesh, &whole, (&weights, &[0, 1, 1]), holders, influences).unwrap();
            let row = |v: usize| -> Vec<(usize, f32)> { all.row(v).map(|(j, w)| (j.index(), w)).collect() };
            (0..4).map(row).collect::<Vec<_>>()
        };
        for row in of(None, 4) {
            let [root, stands, other] = row[..] else { panic!("{row:?}") };
            assert!((root.1 - 0.25).abs() < 1e-6 && (stands.1 + other.1 - 0.75).abs() < 1e-6, "{row:?}");
        }
        // The second vertex is above, the first below: the nearer bone has more.
        let rows = of(None, 4);
        assert!(rows[1][2].1 > rows[0][2].1, "{rows:?}");
        // What may hold nothing gets nothing, the rest has all of it.
        assert!(of(Some(&[true, true, false]), 4).iter().all(|row| row[..] == [(0, 0.25), (1, 0.75)]));
        assert!(of(Some(&[true, false, true]), 4).iter().all(|row| row[..] == [(0, 0.25), (2, 0.75)]));
        assert!(of(Some(&[true, false, false]), 4).iter().all(|row| row[..] == [(0, 0.25), (1, 0.75)]));
        assert!(of(None, 2).iter().all(|row| row.len() == 2));
    }

    #[test]
    fn a_skeleton_of_more_joints_than_the_model_reads_keeps_them_all() {
        let (mesh, mut rigger) = (tetrahedron(), untrained(Head::Levels, true));
        // What is read is cut, and what it stands for is not cut again.
        rigger.config.eval.cut = 0.4;
        let most = rigger.most_joints();
        let heights: Vec<f32> = (0..3 * most).map(|k| -0.9 + 1.8 * k as f32 / (3 * most) as f32).collect();
        let skeleton = chain(&heights);
        let wish = RigRequest { skeleton: Some(&skeleton), rank: Rank::Likelihood, ..RigRequest::default() };
        let made = rigger.make(&mesh, &wish).unwrap();
        assert_eq!((&made.skeleton, made.weights.rows()), (&skeleton, 4));
        assert!((0..4).any(|v| made.weights.row(v).any(|(_, w)| w < 0.4)));
        assert!(made.thinned.is_some_and(|read| (1..=most).contains(&read)), "{:?}", made.thinned);
        let few = chain(&heights[..2]);
        assert_eq!(rigger.make(&mesh, &RigRequest { skeleton: Some(&few), ..wish }).unwrap().thinned, None);
        // Joints are added to what is read whole alone.
        let whole = RigRequest { skeleton: Some(&skeleton), complete: true, ..RigRequest::default() };
        assert!(rigger.make(&mesh, &whole).unwrap_err().contains("reads at most 6 joints"));
    }
}
