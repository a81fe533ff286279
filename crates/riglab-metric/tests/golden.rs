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
            // Distances are shares of the range, which is [-1, 1] in the product.
            let end = |k: usize| case.config("continuous_range")[k].as_f64().unwrap_or([-1.0, 1.0][k]);
            let share = 2.0 / (end(1) - end(0));
            let samples = case.config("samples_per_bone").as_u64().unwrap_or(100);
            let [truth, predicted] = ["gt", "pred"].map(|side| joints(&case, &pair, side));
            let found = SkeletonConvention::Unirig.distances(&predicted, &truth);
            for name in case.outputs(&format!("{pair}.")) {
                let found = share
                    * match name.rsplit_once('.').expect("a part").1 {
                        "j2j" => found.j2j,
                        "j2b" if samples == 100 => found.j2b,
                        "b2b" if samples == 100 => found.b2b,
                        _ => panic!("{}: unknown output `{name}`", case.name),
                    };
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
    let rows = |what: &str| case.values(&case.input(pair, &format!("{what}_{side}")));
    let positions = rows("joints").as_chunks::<3>().0.to_vec();
    let bones = rows("bones").as_chunks::<6>().0;
    let mut parents = vec![None; positions.len()];
    let mut is_ended = vec![false; positions.len()];
    for (row, bone) in bones.iter().enumerate() {
        let [from, to] = [&bone[..3], &bone[3..]];
        let parent = positions.iter().position(|p| p[..] == *from);
        assert!(parent.is_some(), "{}: a bone of {pair} begins at no joint", case.name);
        // The joints in order, behind the root; else whichever no bone ends at yet.
        let fits = |joint: &usize| positions.get(*joint).is_some_and(|p| p[..] == *to) && !is_ended[*joint];
        let joint = std::iter::once(row + 1).chain(0..positions.len()).find(fits);
        let joint = joint.unwrap_or_else(|| panic!("{}: a bone of {pair} ends at no joint", case.name));
        (parents[joint], is_ended[joint]) = (parent, true);
    }
    Joints { parents, positions }
}
