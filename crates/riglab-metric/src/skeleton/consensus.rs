//! Of several skeletons for one shape the one that the others agree with most, where they have its joints, and where both
//! sides have them.

use glam::DVec3;
use rayon::prelude::*;

use super::{Joints, SkeletonConvention};

/// What a pair counts that cannot be compared: more than any two skeletons in the cube are apart.
const FARTHEST: f64 = 3.0 * 1.8;

/// The medoid: the candidate whose J2J + J2B + B2B to the other candidates and to `voters` ([`SkeletonConvention::Unirig`])
/// are the least on average, the first of equals. Draws of a model being samples of what it believes, that is the candidate
/// with the least expected distance from the truth (minimum Bayes risk).
pub fn consensus(candidates: &[Joints], voters: &[Joints]) -> Option<usize> {
    consensus_with(candidates, voters, &vec![0.0; candidates.len()])
}

/// As [`consensus`], where something else than the others speaks against each candidate, too: so much is added to its
/// average.
pub fn consensus_with(candidates: &[Joints], voters: &[Joints], besides: &[f64]) -> Option<usize> {
    let n = candidates.len();
    let all: Vec<&Joints> = candidates.iter().chain(voters).collect();
    let later = |a: usize| all[a + 1..].iter().map(|b| apart(all[a], b)).collect::<Vec<f64>>();
    let rows: Vec<Vec<f64>> = (0..n).into_par_iter().map(later).collect();
    // Sums, as averages are over as many others for all.
    let mut sums: Vec<f64> = besides.iter().map(|own| own * (all.len().max(2) - 1) as f64).collect();
    for (a, row) in rows.iter().enumerate() {
        for (b, apart) in (a + 1..).zip(row) {
            sums[a] += apart;
            if b < n {
                sums[b] += apart;
            }
        }
    }
    (0..n).min_by(|&a, &b| sums[a].total_cmp(&sums[b]))
}

/// How far skeletons are apart on average, each from each other one, as [`consensus`] counts it; 0 of fewer than two.
pub fn disagreement(all: &[Joints]) -> f64 {
    let pairs: Vec<(usize, usize)> = (0..all.len()).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
    let each: Vec<f64> = pairs.par_iter().map(|&(a, b)| apart(&all[a], &all[b])).collect();
    each.iter().sum::<f64>() / each.len().max(1) as f64
}

/// How far a skeleton is from others on average: the mean of J2J, J2B and B2B, as reports show them
/// ([`SkeletonConvention::Unirig`]); 0 where there are none. Of one that was made of draws of a model and these draws it tells
/// how sure the model is.
pub fn apart_from(own: &Joints, others: &[Joints]) -> f64 {
    others.iter().map(|other| apart(own, other) / 3.0).sum::<f64>() / others.len().max(1) as f64
}

/// J2J + J2B + B2B.
fn apart(a: &Joints, b: &Joints) -> f64 {
    let d = SkeletonConvention::Unirig.distances(a, b);
    let apart = d.j2j + d.j2b + d.b2b;
    if apart.is_finite() { apart } else { FARTHEST }
}

/// How near a joint has to be to count no more than another that is nearer, in the cube [-1, 1]³: about half a cell of 256.
const NEAR: f64 = 0.005;

/// Moves joints to where `voters` have them, all of whose votes count the same: the mean J2J to them falls. Each joint goes
/// to the geometric median (a step of Weiszfeld's a round) of the joints nearest to it, one of each voter, and of those it
/// is the nearest to; which these are is asked anew each round. The tree stays as it is.
pub fn refined(own: &Joints, voters: &[Joints], rounds: usize) -> Joints {
    let vectors = |joints: &Joints| joints.positions.iter().map(|&p| DVec3::from(p)).collect::<Vec<_>>();
    let mut joints = vectors(own);
    let voters: Vec<Vec<DVec3>> = voters.iter().map(vectors).filter(|v| !v.is_empty()).collect();
    for _ in 0..rounds {
        let mut sums = vec![(DVec3::ZERO, 0.0); joints.len()];
        for voter in &voters {
            let mut pull = |joint: usize, to: DVec3, share: usize| {
                let weight = 1.0 / (share as f64 * (joints[joint].distance(to) + NEAR));
                sums[joint].0 += weight * to;
                sums[joint].1 += weight;
            };
            for joint in 0..joints.len() {
                pull(joint, voter[nearest(voter, joints[joint])], joints.len());
            }
            for &to in voter {
                pull(nearest(&joints, to), to, voter.len());
            }
        }
        for (joint, (sum, weight)) in joints.iter_mut().zip(sums) {
            if weight > 0.0 {
                *joint = sum / weight;
            }
        }
    }
    Joints { positions: joints.iter().map(DVec3::to_array).collect(), parents: own.parents.clone() }
}

/// How far a joint may be from the image of another to be its partner, in the cube [-1, 1]³.
const PARTNERS: f64 = 0.2;

/// Moves joints that are partners across the plane x = `plane` to where both have them on average, one the image of the other
/// in the mirror; one that is its own partner onto the plane. `known`: the partners that are known, as by names, none or one a
/// joint; others are partners where each is the nearest to the image of the other. What has none stays.
pub fn symmetrised(own: &Joints, plane: f64, known: &[Option<usize>]) -> Joints {
    let joints: Vec<DVec3> = own.positions.iter().map(|&p| DVec3::from(p)).collect();
    let image = |p: DVec3| DVec3::new(2.0 * plane - p.x, p.y, p.z);
    let known = |joint: usize| known.get(joint).copied().flatten().filter(|&other| other < joints.len());
    // Distances of images are the same the other way round.
    let found: Vec<usize> = joints.iter().map(|&p| nearest(&joints, image(p))).collect();
    let partner = |joint: usize| match known(joint) {
        Some(other) => Some(other).filter(|&other| known(other) == Some(joint)),
        None => Some(found[joint]).filter(|&other| {
            let mutual = found[other] == joint && known(other).is_none();
            mutual && joints[other].distance(image(joints[joint])) <= PARTNERS
        }),
    };
    let place = |joint| partner(joint).map_or(joints[joint], |other| joints[joint].midpoint(image(joints[other])));
    Joints { positions: (0..joints.len()).map(|joint| place(joint).to_array()).collect(), parents: own.parents.clone() }
}

/// The place of the nearest, of at least one; the first of equals.
fn nearest(of: &[DVec3], to: DVec3) -> usize {
    let squared = |&k: &usize| of[k].distance_squared(to);
    (0..of.len()).min_by(|a, b| squared(a).total_cmp(&squared(b))).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chain(length: f64, joints: usize) -> Joints {
        let positions = (0..joints).map(|k| [0.0, length * k as f64 / (joints - 1).max(1) as f64, 0.0]).collect();
        Joints { positions, parents: (0..joints).map(|k| k.checked_sub(1)).collect() }
    }

    #[test]
    fn the_one_in_the_middle_is_taken() {
        let candidates = [chain(0.2, 3), chain(1.0, 3), chain(1.1, 3), chain(1.05, 3), chain(1.2, 3)];
        assert_eq!(consensus(&candidates, &[]), Some(3));
        assert_eq!(consensus(&[chain(1.0, 3), chain(1.0, 3)], &[]), Some(0), "the first of equals");
    }

    #[test]
    fn disagreement_is_the_mean_over_pairs() {
        let apart = |a: f64, b: f64| disagreement(&[chain(a, 3), chain(b, 3)]);
        assert_eq!(disagreement(&[chain(1.0, 3)]), 0.0);
        // By this convention bones are a little apart from themselves.
        assert!(apart(1.0, 1.0) < apart(1.0, 1.1) && apart(1.0, 1.1) < apart(1.0, 1.3));
        let all = disagreement(&[chain(1.0, 3), chain(1.1, 3), chain(1.3, 3)]);
        let mean = (apart(1.0, 1.1) + apart(1.1, 1.3) + apart(1.0, 1.3)) / 3.0;
        assert!((all - mean).abs() < 1e-12);
        let (own, others) = (chain(1.0, 3), [chain(1.1, 3), chain(1.3, 3)]);
        let from = |others: &[Joints]| apart_from(&own, others);
        assert!((from(&others) - (apart(1.0, 1.1) + apart(1.0, 1.3)) / 6.0).abs() < 1e-12 && from(&[]) == 0.0);
    }

    #[test]
    fn voters_count_and_are_not_taken() {
        let candidates = [chain(0.2, 3), chain(1.0, 3), chain(1.1, 3)];
        assert_eq!(consensus(&candidates, &[]), Some(1));
        let voters = [chain(0.3, 3), chain(0.25, 3), chain(0.2, 3), chain(0.2, 3)];
        assert_eq!(consensus(&candidates, &voters), Some(0));
        assert_eq!(consensus(&[], &voters), None);
    }

    #[test]
    fn what_has_no_bones_is_farthest_from_all() {
        assert_eq!(consensus(&[chain(1.0, 1), chain(0.3, 3), chain(1.0, 3)], &[]), Some(1));
        assert_eq!(consensus(&[chain(1.0, 1)], &[]), Some(0));
        assert_eq!(consensus(&[], &[]), None);
    }

    #[test]
    fn joints_go_to_the_median_of_what_others_say() {
        // Most say 1, one is far off: a mean would be pulled away.
        let voters: Vec<Joints> = [0.99, 1.0, 1.0, 1.01, 1.6].map(|length| chain(length, 3)).into();
        let moved = refined(&chain(0.9, 3), &voters, 20);
        assert_eq!(moved.parents, chain(1.0, 3).parents);
        for (moved, median) in moved.positions.iter().zip(chain(1.0, 3).positions) {
            assert!(DVec3::from(*moved).distance(DVec3::from(median)) < 0.01, "{moved:?} {median:?}");
        }
        assert_eq!(refined(&chain(0.9, 3), &voters, 0), chain(0.9, 3));
        assert_eq!(refined(&chain(0.9, 3), &[], 5), chain(0.9, 3), "nobody says otherwise");
    }

    #[test]
    fn partners_become_images_of_each_other() {
        let positions = vec![[0.12, 0.0, 0.0], [0.5, 1.0, 0.0], [-0.3, 1.1, 0.1], [0.9, 0.3, 0.0], [0.1, -0.6, 0.0]];
        let own = Joints { positions, parents: vec![None, Some(0), Some(0), Some(1), Some(0)] };
        let moved = |known: &[Option<usize>]| {
            let moved = symmetrised(&own, 0.1, known);
            assert_eq!(moved.parents, own.parents);
            moved.positions
        };
        let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-12);
        let by_place = moved(&[]);
        let expected = [[0.1, 0.0, 0.0], [0.5, 1.05, 0.05], [-0.3, 1.05, 0.05], [0.9, 0.3, 0.0], [0.1, -0.6, 0.0]];
        assert!(by_place.iter().zip(expected).all(|(a, b)| near(*a, b)), "{by_place:?}");
        // What is known is not asked for, and is of no other's: a hand without a partner, and one that is far from its own.
        let known = moved(&[Some(0), None, Some(3), Some(2), Some(7)]);
        assert!(near(known[1], own.positions[1]) && near(known[4], own.positions[4]), "{known:?}");
        assert!(near(known[3], [0.7, 0.7, 0.05]) && near(known[2], [-0.5, 0.7, 0.05]), "{known:?}");
        assert!(symmetrised(&Joints { positions: Vec::new(), parents: Vec::new() }, 0.0, &[]).positions.is_empty());
    }

    #[test]
    fn the_mean_distance_to_voters_falls() {
        use riglab_random::{Draw, stream};
        let mut random = stream(5, "test", &[]);
        let mut tree = |joints: usize| {
            let mut at = || [(); 3].map(|()| f64::from(random.unit()) - 0.5);
            Joints {
                positions: (0..joints).map(|_| at()).collect(),
                parents: (0..joints).map(|j| j.checked_sub(1)).collect(),
            }
        };
        let (own, voters) = (tree(7), [5, 7, 9, 11].map(&mut tree));
        let mean = |of: &Joints| {
            let apart = |v: &Joints| SkeletonConvention::Unirig.distances(of, v).j2j;
            voters.iter().map(apart).sum::<f64>() / voters.len() as f64
        };
        let (before, once, often) = (mean(&own), mean(&refined(&own, &voters, 1)), mean(&refined(&own, &voters, 8)));
        assert!(often < once && once < before, "{before} {once} {often}");
    }
}
