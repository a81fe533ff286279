use std::collections::BTreeSet;

use super::*;

/// A skeleton of (name, parent, head).
fn skeleton(joints: &[(&str, &str, [f32; 3])]) -> Skeleton {
    let number = |name: &str| joints.iter().position(|(n, _, _)| *n == name).map(|at| JointId(at as u16));
    let joints = joints.iter().map(|&(name, parent, head)| Joint { name: name.into(), parent: number(parent), head });
    Skeleton::new(joints.collect()).unwrap()
}

/// A body with collars, two fingers and a thumb; left at +x.
fn body() -> Skeleton {
    let mut joints: Vec<(String, String, [f32; 3])> = [
        ("hips", "", [0.0, 1.0, 0.0]),
        ("spine", "hips", [0.0, 1.15, 0.0]),
        ("chest", "spine", [0.0, 1.3, 0.0]),
        ("neck", "chest", [0.0, 1.5, 0.0]),
        ("head", "neck", [0.0, 1.6, 0.02]),
        ("end", "head", [0.0, 1.8, 0.02]),
    ]
    .map(|(name, parent, head)| (name.to_owned(), parent.to_owned(), head))
    .to_vec();
    for (side, x) in [("right", -1.0f32), ("left", 1.0)] {
        let chain: [(&str, &str, [f32; 3]); 16] = [
            ("UpperLeg", "hips", [0.1, 0.95, 0.0]),
            ("LowerLeg", "UpperLeg", [0.1, 0.5, 0.01]),
            ("Foot", "LowerLeg", [0.1, 0.08, 0.0]),
            ("Toes", "Foot", [0.1, 0.02, 0.12]),
            ("Shoulder", "chest", [0.05, 1.45, 0.0]),
            ("UpperArm", "Shoulder", [0.18, 1.45, 0.0]),
            ("LowerArm", "UpperArm", [0.45, 1.45, 0.0]),
            ("Hand", "LowerArm", [0.7, 1.45, 0.0]),
            ("ThumbMetacarpal", "Hand", [0.73, 1.44, 0.03]),
            ("ThumbProximal", "ThumbMetacarpal", [0.76, 1.43, 0.06]),
            ("IndexProximal", "Hand", [0.79, 1.45, 0.03]),
            ("IndexIntermediate", "IndexProximal", [0.82, 1.45, 0.03]),
            ("MiddleProximal", "Hand", [0.79, 1.45, 0.01]),
            ("MiddleIntermediate", "MiddleProximal", [0.83, 1.45, 0.01]),
            ("RingProximal", "Hand", [0.78, 1.45, -0.02]),
            ("RingIntermediate", "RingProximal", [0.81, 1.45, -0.02]),
        ];
        for (name, parent, [a, b, c]) in chain {
            let parent = if matches!(parent, "hips" | "chest") { parent.into() } else { format!("{side}{parent}") };
            joints.push((format!("{side}{name}"), parent, [x * a, b, c]));
        }
    }
    let joints: Vec<(&str, &str, [f32; 3])> = joints.iter().map(|(n, p, h)| (n.as_str(), p.as_str(), *h)).collect();
    skeleton(&joints)
}

/// That each bone found is the joint of that name; gives how many there are.
fn right_bones(skeleton: &Skeleton, human: &Humanoid) -> usize {
    for (bone, joint) in human.iter() {
        assert_eq!(skeleton.name(joint), bone.name());
    }
    human.len()
}

#[test]
fn a_body_is_read_off_its_tree() {
    let body = body();
    let human = humanoid(&body, None).unwrap();
    assert!(human.is_complete());
    assert_eq!(right_bones(&body, &human), body.len() - 1, "all but the end of the head");
}

#[test]
fn sides_follow_the_way_a_body_looks() {
    let body = body();
    // Half a turn, and a quarter: left stays left.
    for turn in [|[x, y, z]: [f32; 3]| [-x, y, -z], |[x, y, z]: [f32; 3]| [z, y, -x]] {
        let turned = body.with_heads(body.heads().iter().map(|h| turn(*h)).collect()).unwrap();
        assert!(right_bones(&turned, &humanoid(&turned, None).unwrap()) > 30);
    }
    // In any unit.
    let huge = body.with_heads(body.heads().iter().map(|h| h.map(|x| 1e6 * x)).collect()).unwrap();
    assert_eq!(right_bones(&huge, &humanoid(&huge, None).unwrap()), body.len() - 1);
}

#[test]
fn bodies_on_four_legs_and_trees_are_no_humanoids() {
    let mut joints: Vec<(String, &str, [f32; 3])> = vec![
        ("hips".into(), "", [0.0, 1.0, -0.8]),
        ("spine".into(), "hips", [0.0, 1.0, 0.0]),
        ("chest".into(), "spine", [0.0, 1.05, 0.6]),
        ("head".into(), "chest", [0.0, 1.4, 1.0]),
        ("tail".into(), "hips", [0.0, 0.9, -1.2]),
        ("tail end".into(), "tail", [0.0, 0.8, -1.6]),
    ];
    let legs: Vec<String> = ["fl", "fr", "bl", "br"].map(String::from).to_vec();
    let knees: Vec<String> = legs.iter().map(|l| format!("{l} knee")).collect();
    for (at, leg) in legs.iter().enumerate() {
        let (x, z) = (if at % 2 == 0 { 0.2 } else { -0.2 }, if at < 2 { 0.6 } else { -0.8 });
        joints.push((leg.clone(), if at < 2 { "chest" } else { "hips" }, [x, 0.9, z]));
        joints.push((knees[at].clone(), leg, [x, 0.45, z]));
        joints.push((format!("{leg} foot"), &knees[at], [x, 0.05, z]));
    }
    let joints: Vec<(&str, &str, [f32; 3])> = joints.iter().map(|(n, p, h)| (n.as_str(), *p, *h)).collect();
    let animal = skeleton(&joints);
    assert_eq!(humanoid(&animal, None), None);
    let (named, human) = name_joints(&animal, None, NameStyle::Mixamo).unwrap();
    assert!(human.is_empty());
    let of = |name: &str| {
        let at = animal.names().iter().position(|n| n == name).unwrap();
        named.names()[at].as_str()
    };
    assert_eq!(["hips", "tail", "tail end"].map(of), ["root", "tail_1", "tail_2"]);
    assert_eq!(["fl", "fl foot", "br knee"].map(of), ["leg_1_l_1", "leg_1_l_3", "leg_2_r_2"]);

    let chain = skeleton(&[("a", "", [0.0; 3]), ("b", "a", [0.0, 1.0, 0.0]), ("c", "b", [0.0, 2.0, 0.0])]);
    assert_eq!(humanoid(&chain, None), None);
    let one = skeleton(&[("a", "", [0.0; 3])]);
    assert_eq!(name_joints(&one, None, NameStyle::Vrm).unwrap().0.names(), ["root"]);
}

#[test]
fn legs_beside_the_hips_are_those_of_a_body_whose_tree_is_none() {
    // As rigs whose feet are led: a root on the ground holds the legs and, beside them, the hips.
    let body = body();
    let mut joints = vec![Joint { name: "root".into(), parent: None, head: [0.0; 3] }];
    joints.extend(body.ids().map(|joint| {
        let parent = match body.name(joint) {
            "hips" | "leftUpperLeg" | "rightUpperLeg" => JointId(0),
            _ => JointId(body.parent(joint).unwrap().0 + 1),
        };
        Joint { name: body.name(joint).to_owned(), parent: Some(parent), head: body.head(joint) }
    }));
    let led = Skeleton::new(joints).unwrap();
    assert_eq!(humanoid(&led, None), None, "no engine moves such a tree as a body");
    let human = human_bones(&led, None).unwrap();
    assert!(human.is_complete() && right_bones(&led, &human) > 30);
    // Of a body both say the same.
    assert_eq!(human_bones(&body, None), humanoid(&body, None));
}

#[test]
fn joints_that_are_called_well_keep_their_names() {
    let body = body();
    let named = name_others(&body, |name| name.starts_with("left"), None).unwrap();
    for (own, name) in body.names().iter().zip(named.names()) {
        assert_eq!(own == name, own.starts_with("left"), "{own} {name}");
    }
    assert_eq!((named.heads(), named.parents()), (body.heads(), body.parents()));
}

#[test]
fn names_are_unlike_and_stable_and_leave_the_tree_alone() {
    let body = body();
    for style in ["keep", "mixamo", "vrm", "plain"].map(|s| s.parse::<NameStyle>().unwrap()) {
        let (named, _) = name_joints(&body, None, style).unwrap();
        assert_eq!((named.heads(), named.parents()), (body.heads(), body.parents()));
        assert_eq!(named.names().iter().collect::<BTreeSet<_>>().len(), body.len());
        assert_eq!(named, name_joints(&body, None, style).unwrap().0);
        let hips = match style {
            NameStyle::Keep | NameStyle::Vrm => "hips",
            NameStyle::Mixamo => "mixamorig:Hips",
            NameStyle::Plain => "root",
        };
        assert_eq!(named.names()[0], hips);
    }
    assert_eq!("VRM".parse(), Ok(NameStyle::Vrm), "in any case");
    assert!("maya".parse::<NameStyle>().is_err());
}

#[test]
fn joints_that_were_added_are_named_by_place_and_others_keep_their_names() {
    let chain = [("leg_1", "", [0.0; 3]), ("spine_2", "leg_1", [0.0, 1.0, 0.0]), ("x", "spine_2", [0.0, 2.0, 0.0])];
    let chain = skeleton(&chain);
    let plain = name_joints(&chain, None, NameStyle::Plain).unwrap().0;
    let named = name_added(&chain, 2, None).unwrap();
    assert_eq!(named.names()[..2], *chain.names()[..2].to_vec());
    assert!(named.names()[2].starts_with(&plain.names()[2]) && named.parents() == chain.parents());
    assert_eq!(name_added(&chain, 3, None).unwrap(), chain, "none");
}

#[test]
fn bones_that_are_known_are_named_whatever_their_places_say() {
    let joint = |name: &str, parent, head| Joint { name: name.into(), parent, head };
    let joints = vec![joint("a", None, [0.0; 3]), joint("b", Some(JointId(0)), [0.0, 1.0, 0.0])];
    let skeleton = Skeleton::new(joints).unwrap();
    let mut human = Humanoid::default();
    human.insert("neck".parse().unwrap(), JointId(1));
    let (named, kept) = name_bones(&skeleton, None, human.clone(), NameStyle::Vrm).unwrap();
    assert_eq!((named.names()[1].as_str(), &kept), ("neck", &human));
    assert_eq!(name_bones(&skeleton, None, human, NameStyle::Keep).unwrap().0, skeleton);
    assert_eq!(name_joints(&skeleton, None, NameStyle::Vrm).unwrap().1, Humanoid::default(), "its places say nothing");
}
