use riglab_core::{Joint, JointId, Rig, Shape, Spring, SpringJoint, Swing};
use riglab_synth::{Options, creature as synthetic};

use super::*;

/// A creature with springs.
pub(crate) fn creature() -> Rig {
    let options = Options { triangles: 400..=800, ..Options::default() };
    let mut all = (0..40).map(|index| synthetic(3, index, &options).rig);
    all.find(|rig| Simulation::new(rig.skeleton(), rig.springs()).swinging() > 3).expect("some creatures have springs")
}

const REST: DAffine3 = DAffine3::IDENTITY;

fn shifted(x: f64, y: f64, z: f64) -> DAffine3 {
    DAffine3::from_translation(DVec3::new(x, y, z))
}

/// A post of length 1 with a chain of `count` bones of length 0.5 along +x at its top.
fn chain(count: u16, swing: Swing) -> (Skeleton, Springs) {
    let joint =
        |(name, parent, head): (String, Option<u16>, [f32; 3])| Joint { name, parent: parent.map(JointId), head };
    let post = [("post".to_string(), None, [0.0; 3])].into_iter();
    let bones = (0..count).map(|k| (format!("bone {k}"), Some(k), [0.5 * f32::from(k), 1.0, 0.0]));
    let skeleton = Skeleton::new(post.chain(bones).map(joint).collect()).unwrap();
    let bone = |k| SpringJoint { joint: JointId(k + 1), tail: Some([0.5 * f32::from(k + 1), 1.0, 0.0]), swing };
    let spring = Spring { joints: (0..count).map(bone).collect(), ..Spring::default() };
    (skeleton, Springs::new(vec![spring], vec![], vec![]).unwrap())
}

fn with(springs: Springs, colliders: Vec<Collider>, center: Option<u16>) -> Springs {
    let (mut own, _, _) = springs.into_parts();
    let all = (0..colliders.len()).collect();
    own[0].groups = vec![0];
    own[0].center = center.map(JointId);
    Springs::new(own, colliders, vec![all]).unwrap()
}

fn tail(simulation: &Simulation, joint: usize) -> DVec3 {
    simulation.maps()[joint].transform_point3(DVec3::new(0.5 * joint as f64, 1.0, 0.0))
}

fn lasting(skeleton: &Skeleton, springs: &Springs, motion: &[DAffine3], seconds: f64) -> Simulation {
    let mut simulation = Simulation::new(skeleton, springs);
    for _ in 0..(60.0 * seconds) as usize {
        simulation.step(motion, 1.0 / 60.0).unwrap();
    }
    simulation
}

#[test]
fn without_motion_and_gravity_nothing_moves() {
    let (skeleton, springs) = chain(3, Swing::default());
    let simulation = lasting(&skeleton, &springs, &[REST; 4], 1.0);
    assert!(simulation.maps().iter().all(|m| m.abs_diff_eq(REST, 1e-12)));
}

#[test]
fn gravity_without_stiffness_hangs_a_chain() {
    let swing = Swing { stiffness: 0.0, gravity_power: 2.0, ..Swing::default() };
    let (skeleton, springs) = chain(2, swing);
    let simulation = lasting(&skeleton, &springs, &[REST; 3], 8.0);
    assert!(tail(&simulation, 1).distance(DVec3::new(0.0, 0.5, 0.0)) < 1e-3, "{}", tail(&simulation, 1));
    assert!(tail(&simulation, 2).distance(DVec3::new(0.0, 0.0, 0.0)) < 1e-3);
}

#[test]
fn a_hand_reckoned_step_agrees() {
    // The post jumps by 1 in y. The tail stays at (0.5, 1), is pulled by 0.5 / 2 along x and by 1 / 4 down.
    let swing = Swing { stiffness: 0.5, gravity_power: 0.5, ..Swing::default() };
    let (skeleton, springs) = chain(1, swing);
    let mut simulation = Simulation::new(&skeleton, &springs);
    simulation.step(&[shifted(0.0, 1.0, 0.0); 2], 0.5).unwrap();
    let way = DVec3::new(0.75, -1.25, 0.0).normalize();
    assert!(tail(&simulation, 1).distance(DVec3::new(0.0, 2.0, 0.0) + 0.5 * way) < 1e-12);
    // In three-vrm the bone is as long as from the new head to the old tail; what shows is its direction alone.
    let mut lagging = Simulation::new(&skeleton, &springs).with_lengths(Lengths::Lagging);
    lagging.step(&[shifted(0.0, 1.0, 0.0); 2], 0.5).unwrap();
    assert!(tail(&lagging, 1).distance(tail(&simulation, 1)) < 1e-12);
    simulation.step(&[shifted(0.0, 1.0, 0.0); 2], 0.5).unwrap();
    lagging.step(&[shifted(0.0, 1.0, 0.0); 2], 0.5).unwrap();
    assert!(tail(&lagging, 1).distance(tail(&simulation, 1)) > 1e-3);
}

#[test]
fn a_center_hides_its_motion() {
    let (skeleton, springs) = chain(2, Swing::default());
    let springs = with(springs, vec![], Some(0));
    let mut simulation = Simulation::new(&skeleton, &springs);
    for frame in 0..60 {
        let motion = shifted(0.1 * f64::from(frame), 0.0, 0.0);
        let maps = simulation.step(&[motion; 3], 1.0 / 60.0).unwrap();
        assert!(maps.iter().all(|m| m.abs_diff_eq(motion, 1e-9)), "{frame}");
    }
}

#[test]
fn colliders_keep_tails_out() {
    let swing = Swing { stiffness: 0.0, gravity_power: 2.0, hit_radius: 0.1, ..Swing::default() };
    let (skeleton, springs) = chain(2, swing);
    // Where the tails would hang.
    let ball = Shape::Sphere { center: [0.0, 0.4, 0.0], radius: 0.3 };
    let rod = Shape::Capsule { from: [-1.0, 0.0, 0.0], to: [1.0, 0.0, 0.0], radius: 0.1 };
    let colliders = [ball, rod].map(|shape| Collider { joint: JointId(0), shape });
    let springs = with(springs, colliders.to_vec(), None);
    let simulation = lasting(&skeleton, &springs, &[REST; 3], 8.0);
    assert!(tail(&simulation, 1).distance(DVec3::new(0.0, 0.4, 0.0)) > 0.399, "{}", tail(&simulation, 1));
    // Bones come back to their length after each collider, and so a little way in.
    assert!(tail(&simulation, 2).y > 0.15, "{}", tail(&simulation, 2));
}

#[test]
fn a_rig_that_grows_keeps_its_shape() {
    let (skeleton, springs) = chain(2, Swing { stiffness: 0.0, ..Swing::default() });
    let motion = DAffine3::from_scale(DVec3::splat(3.0));
    let mut simulation = Simulation::new(&skeleton, &springs);
    simulation.reset(&[motion; 3]).unwrap();
    assert!(simulation.maps().iter().all(|m| m.abs_diff_eq(motion, 1e-12)));
    simulation.step(&[motion; 3], 0.1).unwrap();
    assert!(simulation.maps().iter().all(|m| m.abs_diff_eq(motion, 1e-9)));
    // A joint that grows by itself, within its parent.
    let own = DAffine3 { translation: DVec3::new(0.0, -1.0, 0.0), ..DAffine3::from_scale(DVec3::splat(2.0)) };
    simulation.reset(&[REST, own, own]).unwrap();
    simulation.step(&[REST, own, own], 0.1).unwrap();
    assert!(simulation.maps()[1].abs_diff_eq(own, 1e-9) && simulation.maps()[2].abs_diff_eq(own, 1e-9));
}

#[test]
fn what_hangs_on_a_spring_goes_along_and_follows_its_own_motion() {
    let (skeleton, springs) = chain(2, Swing { stiffness: 0.0, gravity_power: 2.0, ..Swing::default() });
    let (mut own, _, _) = springs.into_parts();
    own[0].joints.truncate(1);
    let springs = Springs::new(own, vec![], vec![]).unwrap();
    // The second bone turns about its head, to +y.
    let turn = DAffine3::from_rotation_z(std::f64::consts::FRAC_PI_2);
    let head = DVec3::new(0.5, 1.0, 0.0);
    let turned = DAffine3::from_translation(head) * turn * DAffine3::from_translation(-head);
    let simulation = lasting(&skeleton, &springs, &[REST, REST, turned], 8.0);
    // The first hangs down, so what was +y in it is +x.
    assert!(tail(&simulation, 2).distance(DVec3::new(0.5, 0.5, 0.0)) < 1e-3, "{}", tail(&simulation, 2));
}

#[test]
fn odd_input_stays_finite() {
    let wild =
        Swing { stiffness: 1e30, drag: 0.0, gravity_power: -1e30, gravity_direction: [0.0; 3], hit_radius: 1e30 };
    let limp = Swing { stiffness: 0.0, drag: 1.0, gravity_power: 0.0, ..wild };
    let flat = DAffine3::from_scale(DVec3::new(1.0, 0.0, 1.0));
    let nothing = DAffine3::from_scale(DVec3::ZERO);
    let mirrored = DAffine3::from_scale(DVec3::new(-1.0, 1.0, 1.0));
    let far = shifted(1e38, -1e38, 1e38);
    let at_head = Collider { joint: JointId(2), shape: Shape::Sphere { center: [0.0, 1.0, 0.0], radius: 1e30 } };
    let no_rod = Shape::Capsule { from: [0.5, 1.0, 0.0], to: [0.5, 1.0, 0.0], radius: 0.2 };
    for swing in [wild, limp, Swing::default()] {
        let (skeleton, springs) = chain(3, swing);
        // A collider on a bone of the very chain, and a center that swings itself.
        let springs = with(springs, vec![at_head, Collider { joint: JointId(3), shape: no_rod }], Some(3));
        let (mut own, colliders, groups) = springs.into_parts();
        own[0].joints[1].tail = Some(skeleton.head(JointId(2)));
        let springs = Springs::new(own, colliders, groups).unwrap();
        let mut simulation = Simulation::new(&skeleton, &springs);
        assert_eq!(simulation.swinging(), 2, "one has no length");
        for motion in [REST, flat, nothing, mirrored, far, REST] {
            for seconds in [0.0, 1e-300, 1.0 / 60.0, 1e6] {
                let maps = simulation.step(&[motion; 4], seconds).unwrap();
                assert!(maps.iter().all(|m| m.is_finite()), "{motion} {seconds}");
                let maps = simulation.step(&[REST, motion, REST, motion], seconds).unwrap();
                assert!(maps.iter().all(|m| m.is_finite()), "{motion} {seconds}");
            }
        }
    }
}

#[test]
fn in_no_time_nothing_swings() {
    let (skeleton, springs) = chain(1, Swing::default());
    let mut simulation = Simulation::new(&skeleton, &springs);
    simulation.step(&[shifted(0.0, 0.3, 0.0); 2], 0.1).unwrap();
    let before = tail(&simulation, 1);
    simulation.step(&[shifted(0.0, 0.3, 0.0); 2], 0.0).unwrap();
    assert_eq!(tail(&simulation, 1), before);
    simulation.step(&[shifted(1.0, 0.3, 0.0); 2], 0.0).unwrap();
    assert!(tail(&simulation, 1).distance(before + DVec3::X) < 1e-12, "carried along");
}

#[test]
fn what_cannot_be_followed_is_refused() {
    let (skeleton, springs) = chain(1, Swing::default());
    let mut simulation = Simulation::new(&skeleton, &springs);
    let error = |e: Result<&[DAffine3], SimulationError>| e.unwrap_err().to_string();
    assert!(error(simulation.step(&[REST], 0.1)).contains("a pose of 1 joints for a skeleton of 2"));
    assert!(error(simulation.step(&[REST, shifted(f64::NAN, 0.0, 0.0)], 0.1)).contains("joint 1"));
    assert!(error(simulation.step(&[REST; 2], -0.1)).contains("-0.1 seconds"));
    assert!(error(simulation.step(&[REST; 2], f64::INFINITY)).contains("seconds"));
    assert!(error(simulation.reset(&[])).contains("a pose of 0"));
}
