//! What pictures show, and that every rig gives one.

#![allow(missing_docs)]

use riglab_core::{Bounds, Joint, JointId, Mesh, Rig, Skeleton, SkinWeights, Vec3};
use riglab_render::*;

/// A square in the plane z = 0 from -1 to 1, its left half on joint 0 and its right half on joint 1.
fn square() -> Rig {
    let positions = vec![
        [-1.0, -1.0, 0.0],
        [0.0, -1.0, 0.0],
        [0.0, 1.0, 0.0],
        [-1.0, 1.0, 0.0],
        [0.0, -1.0, 0.0],
        [1.0, -1.0, 0.0],
        [1.0, 1.0, 0.0],
        [0.0, 1.0, 0.0],
    ];
    // The right half is wound the other way.
    let mesh = Mesh::new(positions, vec![[0, 1, 2], [0, 2, 3], [4, 6, 5], [4, 7, 6]]).unwrap();
    let weights = SkinWeights::normalized((0..8).map(|v| vec![(v / 4, 1.0)])).unwrap();
    Rig::new(skeleton(&[[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0]]), mesh, weights).unwrap()
}

fn skeleton(heads: &[Vec3]) -> Skeleton {
    let joint = |(j, &head): (usize, &Vec3)| Joint {
        name: j.to_string(),
        parent: j.checked_sub(1).map(|p| JointId(p as u16)),
        head,
    };
    Skeleton::new(heads.iter().enumerate().map(joint).collect()).unwrap()
}

fn front() -> View {
    View::square(100).turned(0.0, 0.0)
}

fn at(picture: &Picture, x: usize, y: usize) -> [u8; 3] {
    picture.pixels()[y * picture.width() + x]
}

/// Whether two colours differ by brightness at most: the shares of red, green and blue agree.
fn same_hue(a: [u8; 3], b: [u8; 3]) -> bool {
    let share = |c: [u8; 3]| c.map(|x| f32::from(x) / c.iter().map(|&x| f32::from(x)).sum::<f32>());
    share(a).iter().zip(share(b)).all(|(a, b)| (a - b).abs() < 0.05)
}

#[test]
fn weights_have_their_colours_and_none_is_grey() {
    let rig = square();
    let values = joint_weights(rig.weights(), JointId(1));
    assert_eq!(values, [0.0, 0.0, 0.0, 0.0, 1.0, 1.0, 1.0, 1.0]);
    let picture = render_weights(rig.mesh(), &values, &front(), Palette::Paint);
    let grey = at(&render_mesh(rig.mesh(), &front()), 30, 50);
    assert_eq!(at(&picture, 30, 50), grey);
    assert!(same_hue(at(&picture, 70, 50), Palette::Paint.color(1.0).0));
    assert_eq!(at(&picture, 2, 50), [255; 3]);
    // Nothing known about the right half.
    let short = render_weights(rig.mesh(), &[1.0; 4], &front(), Palette::Dusk);
    assert!(same_hue(at(&short, 30, 50), Palette::Dusk.color(1.0).0));
    assert_eq!(at(&short, 70, 50), grey);
    let nan = render_weights(rig.mesh(), &[f32::NAN; 8], &front(), Palette::Dusk);
    assert_eq!(at(&nan, 30, 50), grey);
}

#[test]
fn weights_have_a_legend_below_them() {
    let picture = render_weights(square().mesh(), &[0.0; 8], &front(), Palette::Dusk);
    let colours = [0.0, 0.5, 1.0].map(|share| Palette::Dusk.color(share).0);
    let below = &picture.pixels()[90 * picture.width()..];
    let near = |a: [u8; 3], b: [u8; 3]| a.iter().zip(b).all(|(a, b)| a.abs_diff(b) <= 8);
    assert!(colours.iter().all(|colour| below.iter().any(|pixel| near(*pixel, *colour))));
    // 0 and 1 stand beside it.
    assert!(below.iter().any(|pixel| *pixel == Theme::Light.ink().0));
}

#[test]
fn parts_have_the_colours_of_their_joints_on_both_windings() {
    let rig = square();
    let picture = render_parts(&rig, &front());
    assert!(same_hue(at(&picture, 30, 50), joint_color(0).0));
    assert!(same_hue(at(&picture, 70, 50), joint_color(1).0));
    let behind = render_parts(&rig, &front().turned(180.0, 0.0));
    assert!(same_hue(at(&behind, 30, 50), joint_color(1).0));
}

#[test]
fn winding_does_not_change_a_picture() {
    let rig = square();
    let turned = rig.mesh().triangles().iter().map(|[a, b, c]| [*a, *c, *b]).collect();
    let turned = Mesh::new(rig.mesh().positions().to_vec(), turned).unwrap();
    let view = View::square(64);
    let (a, b) = (render_mesh(rig.mesh(), &view), render_mesh(&turned, &view));
    let differ = |(a, b): (&[u8; 3], &[u8; 3])| a.iter().zip(b).any(|(a, b)| a.abs_diff(*b) > 2);
    assert!(!a.pixels().iter().zip(b.pixels()).any(differ));
}

#[test]
fn skeletons_are_seen_through_the_mesh() {
    let rig = square();
    let picture = render_skeleton(&rig, &front());
    assert!(same_hue(at(&picture, 28, 50), joint_color(0).0));
    assert!(same_hue(at(&picture, 72, 50), joint_color(1).0));
    let other = skeleton(&[[0.0, 0.6, 0.0], [0.0, -0.6, 0.0]]);
    let red = Rgb([230, 40, 30]);
    let two = Scene::of(rig.mesh())
        .skeleton(rig.skeleton(), BoneColors::Plain(Rgb([30, 90, 230])))
        .skeleton(&other, BoneColors::Plain(red))
        .draw(&front());
    assert!(same_hue(at(&two, 50, 24), red.0), "{:?}", at(&two, 50, 24));
    let alone = Scene::empty().skeleton(&other, BoneColors::ByJoint).draw(&front());
    assert_ne!(at(&alone, 50, 50), [255; 3]);
}

#[test]
fn a_shared_frame_keeps_pictures_comparable() {
    let rig = square();
    let frame = Bounds { min: [-2.0; 3], max: [2.0; 3] };
    let picture = render_mesh(rig.mesh(), &front().framed(frame));
    // Half as large as the frame: from 28 to 72.
    assert_eq!((at(&picture, 26, 50), at(&picture, 50, 26)), ([255; 3], [255; 3]));
    assert_ne!(at(&picture, 31, 50), [255; 3]);
}

#[test]
fn misplaced_weight_is_a_share() {
    let rows = |rows: &[&[(u16, f64)]]| SkinWeights::normalized(rows.iter().map(|r| r.to_vec())).unwrap();
    let a = rows(&[&[(0, 1.0)], &[(0, 0.5), (1, 0.5)], &[(2, 1.0)]]);
    let b = rows(&[&[(0, 1.0)], &[(0, 1.0)], &[(1, 1.0)], &[(0, 1.0)]]);
    assert_eq!(misplaced_weight(&a, &b), [0.0, 0.5, 1.0, 1.0]);
    assert_eq!(misplaced_weight(&b, &a), [0.0, 0.5, 1.0, 1.0]);
}

#[test]
fn pictures_do_not_depend_on_the_number_of_threads() {
    let rig = square();
    let draw = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| render_skeleton(&rig, &View::square(200)))
    };
    assert!(draw(1) == draw(3));
}

#[test]
fn png_files_read_back() {
    let picture = render_parts(&square(), &View { width: 61, height: 40, ..View::default() });
    let file = picture.to_png();
    let read = image::load_from_memory(&file).unwrap().into_rgb8();
    assert_eq!(read.dimensions(), (61, 40));
    assert_eq!(read.as_raw().as_slice(), picture.pixels().as_flattened());
    let mut other = std::io::Cursor::new(Vec::new());
    read.write_to(&mut other, image::ImageFormat::Png).unwrap();
    assert!(riglab_render::is_own_png(&file) && !riglab_render::is_own_png(other.get_ref()));
}

#[test]
fn every_rig_gives_a_picture() {
    let shapes: [&[Vec3]; 7] = [
        &[[0.0; 3]],
        &[[1.0, 2.0, 3.0], [1.0, 2.0, 3.0], [1.0, 2.0, 3.0]],
        &[[0.0; 3], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]],
        &[[f32::MAX; 3], [f32::MIN; 3], [f32::MAX, 0.0, f32::MIN]],
        &[[1e-45, 0.0, 0.0], [0.0, 1e-45, 0.0], [0.0; 3]],
        &[[1e30, 0.0, 0.0], [0.0, 1e-30, 0.0], [0.0, 1.0, 0.0]],
        &[[0.0; 3], [0.0, 0.0, 5.0], [0.0, 0.0, 9.0]],
    ];
    let nowhere = Bounds { min: [1e38; 3], max: [-1e38; 3] };
    let point = Bounds { min: [0.0; 3], max: [0.0; 3] };
    let views = [
        View::square(40),
        View { width: 0, height: 3, ..View::default() },
        View { yaw_deg: f32::INFINITY, pitch_deg: f32::NAN, ..View::square(30) },
        View::square(20).turned(0.0, 0.0),
        View::square(20).framed(nowhere),
        View::square(20).framed(point),
        View::square(20).framed(Bounds { min: [f32::NAN; 3], max: [f32::INFINITY; 3] }),
    ];
    for points in shapes {
        let last = points.len() as u32 - 1;
        let mesh = Mesh::new(points.to_vec(), vec![[0, last.min(1), last], [0, 0, 0]]).unwrap();
        let weights = SkinWeights::normalized(vec![vec![(0, 1.0)]; points.len()]).unwrap();
        let rig = Rig::new(skeleton(points), mesh, weights).unwrap();
        for view in &views {
            let view = view.clone().themed(Theme::Dark);
            render_skeleton(&rig, &view);
            render_parts(&rig, &view);
            for limit in [0.0, -1.0, f32::NAN, 1.0, f32::INFINITY] {
                render_errors(rig.mesh(), &[f32::INFINITY, f32::NAN, -1.0], limit, &view).to_png();
            }
        }
    }
}
