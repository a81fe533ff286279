//! What rewards must not depend on, and what scoring many at a time must not change.

use riglab_core::{Mesh, Rig};
use riglab_reward::{Candidate, RawWeights, RewardConfig, Rewards, Scorer};
use riglab_synth::{Options, creature};

fn config() -> RewardConfig {
    RewardConfig { resolution: 64, ..RewardConfig::default() }
}

fn rig() -> Rig {
    creature(3, 1, &Options::default()).rig.normalized().0
}

fn parts(r: &Rewards) -> [f64; 5] {
    [r.coverage, r.containment, r.skinning, r.motion, r.total]
}

fn apart(a: &Rewards, b: &Rewards) -> f64 {
    parts(a).iter().zip(parts(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

#[test]
fn the_order_of_vertices_does_not_matter() {
    let rig = rig();
    let n = rig.mesh().positions().len();
    let old = |v: usize| (v * 7919 + 13) % n;
    assert!((0..n).map(old).collect::<std::collections::BTreeSet<_>>().len() == n);
    let mut new = vec![0u32; n];
    (0..n).for_each(|v| new[old(v)] = v as u32);
    let positions = (0..n).map(|v| rig.mesh().positions()[old(v)]).collect();
    let mut triangles: Vec<_> = rig.mesh().triangles().iter().map(|t| t.map(|v| new[v as usize])).collect();
    triangles.reverse();
    let mesh = Mesh::new(positions, triangles).unwrap();
    let candidate = Candidate::of(&rig);
    let weights = RawWeights::new((0..n).map(|v| {
        let (joints, weights) = candidate.weights().row(old(v));
        joints.iter().copied().zip(weights.iter().copied()).collect::<Vec<_>>()
    }));
    let moved = Candidate::new(candidate.heads().to_vec(), candidate.parents().to_vec(), weights).unwrap();
    let (a, b) = (Scorer::new(rig.mesh(), &config()).score(&candidate), Scorer::new(&mesh, &config()).score(&moved));
    assert!(apart(&a, &b) < 1e-12, "{a:?}\n{b:?}");
}

#[test]
fn the_order_of_joints_matters_only_to_the_poses() {
    let rig = rig();
    let candidate = Candidate::of(&rig);
    let n = candidate.heads().len();
    // Children after parents, but otherwise the other way round: by depth, the last first.
    let depth = |mut j: usize| {
        let mut depth = 0;
        while let Some(p) = candidate.parents()[j] {
            (j, depth) = (p, depth + 1);
        }
        depth
    };
    let mut order: Vec<usize> = (0..n).collect();
    order.sort_by_key(|j| (depth(*j), std::cmp::Reverse(*j)));
    let mut new = vec![0; n];
    order.iter().enumerate().for_each(|(k, j)| new[*j] = k);
    let heads = order.iter().map(|j| candidate.heads()[*j]).collect();
    let parents = order.iter().map(|j| candidate.parents()[*j].map(|p| new[p])).collect();
    let weights = RawWeights::new((0..candidate.weights().rows()).map(|v| {
        let (joints, weights) = candidate.weights().row(v);
        joints.iter().map(|j| new[usize::from(*j)] as u16).zip(weights.iter().copied()).collect::<Vec<_>>()
    }));
    let other = Candidate::new(heads, parents, weights).unwrap();
    let still = RewardConfig { pose_degrees: 0.0, ..config() };
    let scorer = Scorer::new(rig.mesh(), &still);
    let (a, b) = (scorer.score(&candidate), scorer.score(&other));
    assert!(apart(&a, &b) < 1e-9, "{a:?}\n{b:?}");
}

#[test]
fn moving_everything_changes_little_and_scaling_nothing() {
    let rig = rig();
    let scorer = Scorer::new(rig.mesh(), &config());
    let a = scorer.score(&Candidate::of(&rig));
    let moved = |map: &dyn Fn([f32; 3]) -> [f32; 3]| {
        let mesh = rig.mesh().with_positions(rig.mesh().positions().iter().map(|p| map(*p)).collect()).unwrap();
        let skeleton = rig.skeleton().with_heads(rig.skeleton().heads().iter().map(|p| map(*p)).collect()).unwrap();
        let rig = Rig::new(skeleton, mesh, rig.weights().clone()).unwrap();
        Scorer::new(rig.mesh(), &config()).score(&Candidate::of(&rig))
    };
    // Powers of two: exact. The equation of motion has lengths in the unit cube.
    let scaled = moved(&|p| p.map(|x| 64.0 * x));
    assert!(apart(&a, &scaled) < 1e-9, "{a:?}\n{scaled:?}");
    let shifted = moved(&|p| [p[0] + 0.125, p[1] - 3.0, p[2] + 1.0]);
    assert!(apart(&a, &shifted) < 2e-2, "{a:?}\n{shifted:?}");
    // A quarter turn about y, which the lattice bears but the poses do not.
    let turned = moved(&|[x, y, z]| [z, y, -x]);
    assert!((a.coverage - turned.coverage).abs() < 2e-3 && (a.containment - turned.containment).abs() < 2e-2);
    assert_eq!(a.skinning, turned.skinning);
}

#[test]
fn groups_are_scored_as_single_ones_and_what_is_undecodable_is_worth_nothing() {
    let rig = rig();
    let scorer = Scorer::new(rig.mesh(), &config());
    let candidate = Candidate::of(&rig);
    let lost = RawWeights::new((0..rig.mesh().positions().len()).map(|_| [(0, 0.01)]));
    let unheld = Candidate::new(vec![[9.0; 3]], vec![None], lost).unwrap();
    let other_mesh = Candidate::new(vec![[0.0; 3]], vec![None], RawWeights::new([[(0, 1.0)]])).unwrap();
    let group = [Some(candidate.clone()), None, Some(unheld), Some(other_mesh), Some(candidate.clone())];
    let rewards = scorer.score_group(&group);
    assert_eq!(rewards[0], scorer.score(&candidate));
    assert_eq!((rewards[0], rewards[1], rewards[3]), (rewards[4], Rewards::default(), Rewards::default()));
    let Rewards { coverage, containment, skinning, motion, total } = rewards[0];
    assert!(rewards[0].coverage > 0.5 && containment > 0.5 && skinning > 0.9 && motion > 0.3, "{:?}", rewards[0]);
    assert!((total - (5.0 * coverage + containment + skinning + motion)).abs() < 1e-12);
    assert!(rewards[2].coverage < 1e-3 && rewards[2].containment == 0.0 && rewards[2].skinning == 0.5);
    let alone = Candidate::skeleton(candidate.heads().to_vec(), candidate.parents().to_vec()).unwrap();
    let Rewards { skinning, motion, total, .. } = scorer.score(&alone);
    assert_eq!((skinning, motion, total), (0.0, 0.0, 5.0 * coverage + containment), "a skeleton alone");
    let with =
        |n| rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap().install(|| scorer.score_group(&group));
    assert_eq!(with(1), with(3));
}

#[test]
fn anything_has_finite_rewards() {
    for positions in
        [vec![[0.0; 3]; 3], vec![[-3e38; 3], [3e38; 3], [0.0, 0.0, 3e38]], vec![[1e-40; 3], [0.0; 3], [1.0; 3]]]
    {
        let mesh = Mesh::new(positions, vec![[0, 1, 2]]).unwrap();
        let scorer = Scorer::new(&mesh, &config());
        for head in [0.0, 1e300, -1e-300] {
            let weights = RawWeights::new([[(0, 1.0)], [(1, 0.0)], [(1, 1e-300)]]);
            let candidate = Candidate::new(vec![[head; 3]; 2], vec![None, Some(0)], weights).unwrap();
            let r = scorer.score(&candidate);
            assert!(parts(&r).iter().all(|x| x.is_finite() && *x >= 0.0), "{head}: {r:?}");
        }
    }
}
