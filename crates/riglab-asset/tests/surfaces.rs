//! Meshes of scans and prints in, PLY and STL: the same as of an OBJ, and rigged as it is.

use std::collections::BTreeSet;
use std::fmt::Write;

use riglab_asset::export::ExportOptions;
use riglab_asset::rigging::{Subject, SubjectNote, SubjectOptions, UpAxis};
use riglab_asset::{Fault, ImportOptions, Imported, import_bytes, is_model_file, model_endings};
use riglab_core::{Joint, Mesh, Skeleton, SkinWeights, Vec3};

/// A tube of quads with lids of many corners: vertices and polygons. Its middle is away from the origin, and no coordinate is
/// written the same as text and as a sum of powers of two.
fn tube() -> (Vec<Vec3>, Vec<Vec<usize>>) {
    let (around, rings) = (7, 5);
    let at = |ring: usize, k: usize| {
        let angle = k as f32 * std::f32::consts::TAU / around as f32;
        [0.1 + angle.cos(), ring as f32 / 3.0, angle.sin() - 0.2]
    };
    let vertices = (0..rings).flat_map(|ring| (0..around).map(move |k| at(ring, k))).collect();
    let vertex = |ring: usize, k: usize| ring * around + k % around;
    let side = |ring: usize, k: usize| {
        vec![vertex(ring, k), vertex(ring + 1, k), vertex(ring + 1, k + 1), vertex(ring, k + 1)]
    };
    let mut faces: Vec<_> = (0..rings - 1).flat_map(|ring| (0..around).map(move |k| side(ring, k))).collect();
    faces.push((0..around).map(|k| vertex(0, k)).collect());
    faces.push((0..around).rev().map(|k| vertex(rings - 1, k)).collect());
    (vertices, faces)
}

/// It as a file of each kind, by name.
fn files() -> Vec<(&'static str, Vec<u8>)> {
    let (vertices, faces) = tube();
    let mut obj = String::new();
    let head = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\n\
             property uchar red\nproperty uchar green\nproperty uchar blue\nproperty float u\nproperty float v\n\
             element face {}\nproperty list uchar int vertex_indices\nend_header\n",
            vertices.len(),
            faces.len()
        )
    };
    let mut text = head("ascii");
    let (mut little, mut big) = (head("binary_little_endian").into_bytes(), head("binary_big_endian").into_bytes());
    for p in &vertices {
        let [x, y, z] = p;
        writeln!(obj, "v {x} {y} {z}").unwrap();
        writeln!(text, "{x} {y} {z} 255 128 0 {x} {y}").unwrap();
        little.extend(p.iter().flat_map(|x| x.to_le_bytes()).chain([255, 128, 0]));
        little.extend([x, y].iter().flat_map(|x| x.to_le_bytes()));
        big.extend(p.iter().flat_map(|x| x.to_be_bytes()).chain([255, 128, 0]));
        big.extend([x, y].iter().flat_map(|x| x.to_be_bytes()));
    }
    let (mut solid, mut facets, mut count) = (String::from("solid tube\n"), Vec::new(), 0u32);
    for face in &faces {
        let words = |from: usize| face.iter().map(|v| format!(" {}", v + from)).collect::<String>();
        writeln!(obj, "f{}", words(1)).unwrap();
        writeln!(text, "{}{}", face.len(), words(0)).unwrap();
        for out in [&mut little, &mut big] {
            out.push(face.len() as u8);
        }
        little.extend(face.iter().flat_map(|v| (*v as i32).to_le_bytes()));
        big.extend(face.iter().flat_map(|v| (*v as i32).to_be_bytes()));
        for w in face[1..].windows(2) {
            let corners = [face[0], w[0], w[1]].map(|v| vertices[v]);
            let lines: String = corners.iter().map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).collect();
            writeln!(solid, "facet normal 0 0 0\nouter loop\n{lines}endloop\nendfacet").unwrap();
            facets.extend([[0.0; 3]].iter().chain(&corners).flatten().flat_map(|x: &f32| x.to_le_bytes()));
            facets.extend([0; 2]);
            count += 1;
        }
    }
    solid += "endsolid tube\n";
    let binary = [[b' '; 80].as_slice(), &count.to_le_bytes(), &facets].concat();
    vec![
        ("a.obj", obj.into_bytes()),
        ("text.ply", text.into_bytes()),
        ("little.ply", little),
        ("big.ply", big),
        ("text.stl", solid.into_bytes()),
        ("binary.STL", binary),
    ]
}

fn imported(name: &str, bytes: &[u8]) -> Imported {
    import_bytes(name, bytes, &ImportOptions::default()).unwrap()
}

/// Corners of each triangle, from the lowest on.
fn corners(mesh: &Mesh) -> BTreeSet<[[u32; 3]; 3]> {
    let turned = |t: usize| {
        let mut own = mesh.corners(t).map(|p| p.map(|x| (x + 0.0).to_bits()));
        let lowest = (0..3).min_by_key(|&k| own[k]).unwrap();
        own.rotate_left(lowest);
        own
    };
    (0..mesh.triangles().len()).map(turned).collect()
}

#[test]
fn each_format_gives_the_mesh_that_an_obj_gives() {
    let files = files();
    let obj = imported(files[0].0, &files[0].1);
    assert_eq!((obj.mesh().positions().len(), obj.mesh().triangles().len()), (35, 66));
    for (name, bytes) in &files {
        let own = imported(name, bytes);
        assert!(own.rig().is_none() && own.warnings() == obj.warnings(), "{name}: {:?}", own.warnings());
        assert_eq!(own.mesh().positions().len(), 35, "{name}");
        assert_eq!(corners(own.mesh()), corners(obj.mesh()), "{name}");
        assert!(is_model_file(name.as_ref()), "{name}");
        let shown = own.inspect(false);
        assert_eq!((shown.vertices, shown.file_triangles, shown.joints.len()), (35, 66, 0), "{name}");
    }
    // By its bytes a PLY is known under any name.
    assert_eq!(imported("a.glb", &files[2].1).mesh(), imported("a.ply", &files[2].1).mesh());
    assert!(["ply", "stl"].iter().all(|ending| model_endings().any(|of| of == *ending)));
}

#[test]
fn what_is_attached_reads_back_and_looks_stay() {
    for (name, bytes) in files() {
        let subject = Subject::from_bytes(name, &bytes, None, &SubjectOptions::default()).unwrap();
        assert_eq!(subject.notes(), [], "{name}");
        let joint = |name: &str, parent: Option<u16>, head: Vec3| Joint {
            name: name.into(),
            parent: parent.map(riglab_core::JointId),
            head,
        };
        let joints = vec![joint("root", None, [0.1, 0.0, -0.2]), joint("tip", Some(0), [0.1, 1.0, -0.2])];
        let rows = subject.mesh().positions().iter().map(|[_, y, _]| {
            let share = f64::from(*y) / 1.5;
            [(0, 1.0 - share), (1, share)].into_iter().filter(|(_, weight)| *weight > 0.0).collect::<Vec<_>>()
        });
        let rig = subject.rigged(Skeleton::new(joints).unwrap(), SkinWeights::normalized(rows).unwrap()).unwrap();
        let exported = subject.attach(&rig, &ExportOptions::default()).unwrap();
        let back = imported("back.glb", &exported.bytes);
        let own = back.rig().unwrap();
        assert_eq!((own.skeleton(), own.mesh()), (rig.skeleton(), rig.mesh()), "{name}");
        let json = String::from_utf8_lossy(&exported.bytes).into_owned();
        let looks = ["COLOR_0", "TEXCOORD_0", "\"baseColorFactor\":[1.0,1.0,1.0,1.0]"].map(|of| json.contains(of));
        assert_eq!(looks, [name.ends_with(".ply"); 3], "{name}");
        assert!(json.contains("NORMAL"), "{name}");
    }
}

/// A format that does not say what is up is read as it is, told where it seems to stand along z, and turned when asked.
#[test]
fn what_stands_along_z_is_told_and_turned_when_asked() {
    // Two legs of a figure that is thin across, and its head.
    let feet = [-0.5, -0.2, 0.2, 0.5].into_iter().flat_map(|x| [[x, -0.1, 0.0], [x, 0.1, 0.0]]);
    let points: Vec<[f32; 3]> = feet.chain([[0.0, 0.0, 2.0], [0.1, 0.1, 2.0]]).collect();
    let mut text = String::from("solid figure\n");
    for t in [[0, 1, 8], [2, 3, 8], [4, 5, 9], [6, 7, 9]] {
        let lines: String =
            t.iter().map(|&v: &usize| points[v]).map(|[x, y, z]| format!("vertex {x} {y} {z}\n")).collect();
        writeln!(text, "facet normal 0 0 0\nouter loop\n{lines}endloop\nendfacet").unwrap();
    }
    text += "endsolid\n";
    let read = |up: UpAxis| {
        let options = SubjectOptions { up, ..SubjectOptions::default() };
        Subject::from_bytes("figure.stl", text.as_bytes(), None, &options).unwrap()
    };
    let (lying, standing) = (read(UpAxis::Y), read(UpAxis::Z));
    assert!(
        lying.notes().contains(&SubjectNote::LiesDown { axis: UpAxis::Z, given: UpAxis::Y }),
        "{:?}",
        lying.notes()
    );
    assert!(!standing.notes().iter().any(|n| matches!(n, SubjectNote::LiesDown { .. })), "{:?}", standing.notes());
    let stood: Vec<Vec3> = lying.mesh().positions().iter().map(|p| UpAxis::Z.to_y(*p)).collect();
    assert_eq!(standing.mesh().positions(), stood);
}

#[test]
fn what_is_no_surface_is_told_in_a_sentence() {
    let fault = |name: &str, bytes: &[u8]| {
        let read = import_bytes(name, bytes, &ImportOptions::default()).unwrap_err();
        let rigged = Subject::from_bytes(name, bytes, None, &SubjectOptions::default()).unwrap_err();
        assert_eq!(read, rigged);
        assert!(read.to_string().starts_with(name), "{read}");
        read.fault
    };
    let points =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n";
    assert_eq!(fault("a.ply", format!("{points}0 0 0\n").as_bytes()), Fault::NoMesh);
    assert_eq!(fault("a.stl", b"solid\nendsolid\n"), Fault::NoMesh);
    assert_eq!(fault("a.stl", &[0; 84]), Fault::NoMesh);
    assert!(matches!(fault("a.ply", b"# nothing of a scan"), Fault::Ply(_)));
    assert!(matches!(fault("a.stl", b"nothing for printing"), Fault::Stl(_)));
    assert_eq!(fault("a.ply", b""), Fault::Empty);
    let claims = points.replace("vertex 1", "vertex 4000000000");
    let said = fault("a.ply", claims.as_bytes()).to_string();
    assert!(said.contains("4000000000 rows of `vertex`") && said.ends_with("in Blender for example"), "{said}");
}
