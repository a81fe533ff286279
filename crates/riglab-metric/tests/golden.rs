//! UniRig's skeleton metrics against values recorded from its public code. Those of all other conventions are in
//! `golden_metrics` of the workspace's tests, beside what needs tensors.

#[path = "../../riglab-geom/tests/common/golden.rs"]
mod golden;

use golden::{Golden, golden};
use riglab_metric::{Joints, SkeletonConvention};

#[test]
fn unirig() {
    for case in golden("unirig", "metrics") {
        for pair in case.groups() {
            let [truth, predicted] = ["gt", "pred"].map(|side| joints(&case, &pair, side));
            let found = SkeletonConvention::Unirig.distances(&predicted, &truth);
            for (name, found) in [("j2j", found.j2j), ("j2b", found.j2b), ("b2b", found.b2b)] {
                let name = format!("out.{pair}.{name}");
                if predicted == truth {
                    rounded(&case, &name, found);
                } else {
                    case.check(&name, [found]);
                }
            }
        }
        case.done();
    }
}

/// Distances of a skeleton from itself: the code took them as roots of differences of squares in f32, which are
/// some 1e-4 where they should be 0.
fn rounded(case: &Golden, name: &str, found: f64) {
    let wanted = case.values(name)[0];
    assert!((found - wanted).abs() <= 5e-4, "{}: {name} is {found}, not {wanted}", case.name);
    case.elsewhere(name, "within what the code rounds");
}

/// Joints, and the parents that the bones tell: a row for each joint but the root, from its parent's place to its own.
fn joints(case: &Golden, pair: &str, side: &str) -> Joints {
    let rows = |what: &str| case.values(&format!("in.{pair}.{what}_{side}"));
    let positions = rows("joints").as_chunks::<3>().0.to_vec();
    let parent = |(bone, own): (&[f64; 6], &[f64; 3])| {
        assert_eq!(bone[3..], *own, "{}: bones of {pair}", case.name);
        let at = positions.iter().position(|p| *p == bone[..3]);
        assert!(at.is_some(), "{}: a bone of {pair} begins at no joint", case.name);
        at
    };
    let parents = std::iter::once(None).chain(rows("bones").as_chunks().0.iter().zip(&positions[1..]).map(parent));
    Joints { parents: parents.collect(), positions }
}
