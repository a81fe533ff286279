//! What is at the edge: one joint, all in one place, outside, too many.

use riglab_token::{Bones, Classes, DecodeFault, EncodeFault, Grammar, Limits, Parents, Preset, Template, Tokenizer};

fn riglab() -> Tokenizer {
    Tokenizer::new(Preset::Riglab.config())
}

fn bones<'a>(joints: &'a [[f64; 3]], parents: &'a [Option<usize>]) -> Bones<'a> {
    Bones { joints, parents, names: &[] }
}

#[test]
fn a_single_joint_comes_back_and_the_releases_say_what_they_lack() {
    let (joints, parents) = ([[0.1, -0.2, 0.3]], [None]);
    let encoded = riglab().encode_bones(&bones(&joints, &parents), None).unwrap();
    assert_eq!((encoded.ids.len(), riglab().decode(&encoded.ids).unwrap().parents), (6, vec![None]));
    let released = Tokenizer::new(Preset::UnirigReleased.config());
    let ids = released.encode_bones(&bones(&joints, &parents), Some("articulationxl")).unwrap().ids;
    assert_eq!(released.decode(&ids).unwrap_err(), DecodeFault::TooFew(1));
    assert_eq!(riglab().encode_bones(&bones(&[], &[]), None).unwrap_err(), EncodeFault::Empty);
    assert!(EncodeFault::Empty.to_string().contains("no joint"));
}

#[test]
fn joints_in_one_place_keep_their_tree_by_moving() {
    let parents: Vec<Option<usize>> = (0..30).map(|j: usize| j.checked_sub(1).map(|p| p / 2)).collect();
    let joints = vec![[0.5, 0.5, 0.5]; 30];
    let encoded = riglab().encode_bones(&bones(&joints, &parents), None).unwrap();
    let decoded = riglab().decode(&encoded.ids).unwrap();
    let mut place = [0; 30];
    encoded.order.iter().enumerate().for_each(|(at, &joint)| place[joint] = at);
    for (at, &joint) in encoded.order.iter().enumerate() {
        assert_eq!(decoded.parents[at], parents[joint].map(|p| place[p]));
    }
    assert!(encoded.moved > 0);
    // Where there are fewer cells than joints to be told apart, it is refused.
    let mut coarse = Preset::Riglab.config();
    coarse.bins = 2;
    let comb: Vec<Option<usize>> = (0..40usize).map(|j| if j < 20 { j.checked_sub(1) } else { Some(j - 20) }).collect();
    let fault = Tokenizer::new(coarse).encode_bones(&bones(&[[0.0; 3]; 40], &comb), None).unwrap_err();
    assert!(matches!(fault, EncodeFault::NoCell { bins: 2, .. }) && fault.to_string().contains("too close"), "{fault}");
}

#[test]
fn joints_outside_come_to_the_border_and_are_counted() {
    let joints = [[0.0, 0.0, 0.0], [3.0, 0.0, -9.0], [f64::INFINITY, 0.0, 0.0], [f64::NAN, 0.0, 0.5]];
    let encoded = riglab().encode_bones(&bones(&joints, &[None, Some(0), Some(0), Some(0)]), None).unwrap();
    assert_eq!(encoded.clamped, 3);
    let decoded = riglab().decode(&encoded.ids).unwrap();
    assert!(decoded.joints.iter().flatten().all(|x| x.abs() <= 1.0));
    let far = encoded.order.iter().position(|&j| j == 1).unwrap();
    let (last, first) = (1.0 - 1.0 / 256.0, -1.0 + 1.0 / 256.0);
    assert!((decoded.joints[far][0] - last).abs() < 1e-6 && (decoded.joints[far][2] - first).abs() < 1e-6);
}

#[test]
fn no_joint_follows_the_last_that_the_limits_allow() {
    let joints: Vec<[f64; 3]> = (0..5).map(|j| [0.0, f64::from(j) / 8.0, 0.0]).collect();
    let parents: Vec<Option<usize>> = (0..5).map(|j: usize| j.checked_sub(1)).collect();
    let ids = riglab().encode_bones(&bones(&joints, &parents), None).unwrap().ids;
    for limits in [Limits { joints: 4, tokens: 2048 }, Limits { joints: 256, tokens: ids.len() - 1 }] {
        let mut grammar = Grammar::new(&riglab(), limits, Parents::Existing);
        let fault = ids.iter().find_map(|&id| grammar.advance(id).err()).unwrap();
        assert!(fault.to_string().contains("may not follow"), "{fault}");
        // It stands as before, and can still end.
        grammar.advance(riglab().vocabulary().eos()).unwrap();
        assert_eq!((grammar.joints(), grammar.is_done()), (4, true));
    }
}

#[test]
fn trees_that_are_none_are_refused() {
    let joints = [[0.0; 3], [0.1; 3], [0.2; 3]];
    for (parents, joint) in [
        ([None, None, Some(0)], 1),
        ([Some(0), Some(0), Some(1)], 0),
        ([None, Some(2), Some(0)], 1),
        ([None, Some(0), Some(2)], 2),
        ([None, Some(0), Some(9)], 2),
    ] {
        let fault = riglab().encode_bones(&bones(&joints, &parents), None).unwrap_err();
        assert_eq!(fault, EncodeFault::NotATree { joint });
    }
    let short = riglab().encode_bones(&bones(&joints, &[None]), None).unwrap_err();
    assert_eq!(short, EncodeFault::Lengths { joints: 3, parents: 1, names: 0 });
}

#[test]
fn a_template_whose_class_has_no_token_keeps_its_tree() {
    let template = Template::of("mixamo").unwrap();
    let (names, parents): (Vec<String>, Vec<Option<usize>>) =
        template.joints().map(|(name, parent, _)| (name.to_owned(), parent)).unzip();
    let joints: Vec<[f64; 3]> = (0..names.len()).map(|k| [k as f64 / 64.0, (k % 7) as f64 / 8.0, 0.0]).collect();
    for (classes, known) in [(vec!["vroid".to_owned()], false), (vec!["mixamo".to_owned()], true)] {
        let mut config = Preset::Riglab.config();
        (config.lenient, config.classes, config.class) = (true, classes, Classes::AsGiven);
        let tokenizer = Tokenizer::new(config);
        let bones = Bones { joints: &joints, parents: &parents, names: &names };
        let encoded = tokenizer.encode_bones(&bones, Some("mixamo")).unwrap();
        let branches = encoded.ids.iter().filter(|id| **id == tokenizer.vocabulary().branch()).count();
        assert_eq!(branches == 0, known, "{branches}");
        let decoded = tokenizer.decode(&encoded.ids).unwrap();
        let mut place = vec![0; names.len()];
        encoded.order.iter().enumerate().for_each(|(at, &joint)| place[joint] = at);
        for (at, &joint) in encoded.order.iter().enumerate() {
            assert_eq!(decoded.parents[at], parents[joint].map(|p| place[p]), "{}", names[joint]);
        }
    }
}
