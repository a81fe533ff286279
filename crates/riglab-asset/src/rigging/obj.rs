//! OBJ with its materials, as a document.

use std::cell::RefCell;
use std::collections::{BTreeSet, HashMap};
use std::path::Path;

use tobj::{LoadError, LoadOptions};

use super::SubjectNote;
use super::beside::Beside;
use super::mended::Mender;
use super::surface::linear;
use crate::Fault;
use crate::gltf::export::model::{Lie, Look, Model, Object, Patch, Picture};
use crate::wavefront::{self, Asked};

/// Reads an OBJ; material libraries and pictures are looked for in `folder`, if at all. Positions stay bit
/// for bit. Normals that are missing are the mean of the triangles around each place.
pub(crate) fn read(
    name: &str,
    bytes: &[u8],
    folder: Option<&Path>,
    notes: &mut Vec<SubjectNote>,
) -> Result<Model, Fault> {
    let options = LoadOptions { triangulate: true, single_index: true, ignore_points: true, ignore_lines: true };
    let beside = Beside::new(folder);
    let missing = RefCell::new(Vec::new());
    let load = |asked: Asked| {
        let lines = wavefront::obj(bytes, asked);
        missing.borrow_mut().clear();
        tobj::load_obj_buf(&mut &lines[..], &options, |library| {
            let (found, lacking) = libraries(&library.to_string_lossy(), &beside);
            missing.borrow_mut().extend(lacking);
            tobj::load_mtl_buf(&mut found.ok_or(LoadError::OpenFileFailed)?.as_slice())
        })
    };
    // Texture coordinates and normals that do not fit are no reason to refuse the surface.
    let loaded = load(Asked::All).or_else(|_| load(Asked::Looks));
    let (models, materials) = loaded.map_err(|e| wavefront::explain(bytes, &e.to_string()))?;
    notes.extend(missing.take().into_iter().map(SubjectNote::FileMissing));
    let mut model = Model { name: name.into(), ..Model::default() };
    let mut pictures = Pictures { beside: &beside, known: HashMap::new(), found: Vec::new(), notes };
    let materials = materials.unwrap_or_default();
    model.looks = materials.iter().map(|material| look(material, &mut pictures)).collect();
    model.pictures = pictures.found;
    let left: BTreeSet<String> = materials.iter().flat_map(left).collect();
    if !left.is_empty() {
        notes.push(SubjectNote::MapsLeft(left.into_iter().collect()));
    }
    let mut mender = Mender::default();
    for part in models {
        let patch = patch(&part, &mut mender).map_err(|reason| wavefront::explain(bytes, &reason))?;
        if patch.indices.is_empty() {
            continue;
        }
        // A change of material makes a part of its own, under the same name.
        match model.objects.last_mut().filter(|object| object.name == part.name) {
            Some(object) => object.patches.push(patch),
            None => model.objects.push(Object {
                name: part.name,
                group: None,
                hidden: false,
                patches: vec![patch],
                shapes: Vec::new(),
            }),
        }
    }
    mender.tell(notes);
    Ok(model)
}

/// The lines of the material libraries that a line names, one after another, and the names of those that are not there. A name
/// may have blanks, and a line may have several names: all of it is one, where that is there.
fn libraries(line: &str, beside: &Beside) -> (Option<Vec<u8>>, Vec<String>) {
    let named = |name: &str| beside.read(name).map(|bytes| wavefront::mtl(&bytes));
    if let Some(whole) = named(line) {
        return (Some(whole), Vec::new());
    }
    let (mut found, mut lacking) = (None, Vec::new());
    for name in line.split_whitespace() {
        match named(name) {
            Some(lines) => found.get_or_insert_with(Vec::new).extend(lines),
            None => lacking.push(name.to_owned()),
        }
    }
    if found.is_none() {
        lacking = vec![line.to_owned()];
    }
    (found, lacking)
}

/// A part, or what is wrong with it.
fn patch(part: &tobj::Model, mender: &mut Mender) -> Result<Patch, String> {
    let mesh = &part.mesh;
    let positions: Vec<[f32; 3]> = mesh.positions.as_chunks().0.to_vec();
    if positions.as_flattened().iter().any(|x| !x.is_finite()) {
        return Err(format!("object `{}` has a coordinate that is not finite", part.name));
    }
    let mut indices = mesh.indices.clone();
    indices.truncate(indices.len() / 3 * 3);
    let count = positions.len();
    if let Some(v) = indices.iter().find(|v| **v as usize >= count) {
        return Err(format!("object `{}` names vertex {v} of {count}", part.name));
    }
    // Where a face leaves normals out, there are fewer than vertices, and whose they are is not known.
    let whole = |list: &[f32], per: usize| list.len() == per * count;
    let (mut coordinates, mut colours) = (Vec::new(), Vec::new());
    if whole(&mesh.texcoords, 2) {
        let sound = mender.coordinates(mesh.texcoords.as_chunks().0);
        coordinates.extend(sound.into_iter().map(|[u, v]| [u, 1.0 - v]));
    }
    if whole(&mesh.vertex_color, 3) {
        let opaque: Vec<[f32; 4]> = mesh.vertex_color.as_chunks().0.iter().map(|&[r, g, b]| [r, g, b, 1.0]).collect();
        let one = |c: f32| linear(c.clamp(0.0, 1.0));
        colours.extend(mender.colours(&opaque).into_iter().map(|[r, g, b, a]| [one(r), one(g), one(b), a]));
    }
    let own: &[f32] = if whole(&mesh.normals, 3) { &mesh.normals } else { &[] };
    let normals = super::normals::complete(own.as_chunks().0, &positions, indices.as_chunks().0);
    Ok(Patch { positions, normals, coordinates, colours, indices, look: mesh.material_id, ..Patch::default() })
}

/// Pictures by the name that materials give them.
struct Pictures<'a> {
    beside: &'a Beside,
    known: HashMap<String, Option<usize>>,
    found: Vec<Picture>,
    notes: &'a mut Vec<SubjectNote>,
}

impl Pictures<'_> {
    /// The picture that a line of a material names, and how it lies.
    fn number(&mut self, line: Option<&String>) -> (Option<usize>, Lie) {
        let Some(line) = line else { return (None, Lie::PLAIN) };
        let (lie, named) = options(line);
        if let Some(known) = self.known.get(named) {
            return (*known, lie);
        }
        let number = match self.beside.picture(named) {
            Ok(picture) => {
                self.found.push(picture);
                Some(self.found.len() - 1)
            }
            Err(note) => {
                self.notes.push(note);
                None
            }
        };
        self.known.insert(named.to_owned(), number);
        (number, lie)
    }
}

/// What stands before the name of a picture, such as `-s 2 2 2`, and the name, which may have blanks. Of options, the size of
/// the texture, its offset and whether it ends at its border count.
fn options(line: &str) -> (Lie, &str) {
    let (mut scale, mut offset, mut ends) = ([1.0; 2], [0.0; 2], false);
    let mut rest = line.trim();
    let word = |of: &str| of.split_whitespace().next().unwrap_or_default().len();
    while rest.starts_with('-') {
        let (option, mut behind) = rest.split_at(word(rest));
        behind = behind.trim_start();
        let most = match option {
            "-s" | "-o" | "-t" => 3,
            "-mm" => 2,
            "-blendu" | "-blendv" | "-cc" | "-clamp" | "-boost" | "-bm" | "-texres" | "-imfchan" | "-type" => 1,
            // A name that starts so.
            _ => break,
        };
        let mut numbers = Vec::new();
        for _ in 0..most {
            let (value, further) = behind.split_at(word(behind));
            let number = value.parse::<f32>().ok();
            // Of three numbers one or two may be left out, but for the name nothing is left out.
            if further.is_empty() || (most == 3 && number.is_none()) {
                break;
            }
            ends = if option == "-clamp" { value == "on" } else { ends };
            numbers.extend(number);
            behind = further.trim_start();
        }
        let of = match option {
            "-s" => Some(&mut scale),
            "-o" => Some(&mut offset),
            _ => None,
        };
        of.into_iter().for_each(|of| of.iter_mut().zip(&numbers).for_each(|(own, told)| *own = *told));
        rest = behind;
    }
    (Lie { ends: [ends; 2], ..Lie::from_below(scale, offset) }, rest)
}

/// The name of a file without folder, of whichever system, and ending.
pub(crate) fn stem(path: &str) -> String {
    let name = path.rsplit(['/', '\\']).next().unwrap_or_default();
    name.rsplit_once('.').map_or(name, |(stem, _)| stem).to_owned()
}

/// The words of pictures that [`look`] does not ask for, but for those that say again what the colour does.
fn left(material: &tobj::Material) -> Vec<String> {
    let own = [
        ("map_Ka", &material.ambient_texture),
        ("map_Ks", &material.specular_texture),
        ("map_Bump", &material.normal_texture),
        ("map_Ns", &material.shininess_texture),
        ("map_d", &material.dissolve_texture),
    ];
    let own = own.into_iter().filter(|(_, of)| of.is_some() && **of != material.diffuse_texture);
    let more = material.unknown_param.keys().filter(|word| word.starts_with("map_") || *word == "disp");
    own.map(|(word, _)| word.to_owned()).chain(more.cloned()).collect()
}

fn look(material: &tobj::Material, pictures: &mut Pictures<'_>) -> Look {
    let unit = |x: f32| if x.is_finite() { x.clamp(0.0, 1.0) } else { 0.0 };
    let extra = |name: &str| material.unknown_param.get(name).and_then(|v| v.parse::<f32>().ok()).map(unit);
    let plain = Look::plain(&material.name);
    let (picture, colour_lies) = pictures.number(material.diffuse_texture.as_ref());
    let (normals, normals_lie) = pictures.number(material.unknown_param.get("norm"));
    let [r, g, b] = match (material.diffuse, picture) {
        // Black under a picture is what exporters write that know of no factor.
        (Some([0.0, 0.0, 0.0]) | None, Some(_)) => [1.0; 3],
        (Some(colour), _) => colour.map(unit),
        (None, None) => [0.8; 3],
    };
    // As is a file that says 0 of everything.
    let alpha = material.dissolve.map(unit).filter(|d| *d > 0.0).unwrap_or(1.0);
    // The width of the highlight that the exponent `Ns` stands for.
    let shininess = material.shininess.filter(|s| s.is_finite() && *s >= 0.0);
    let roughness = shininess.map_or(plain.roughness, |s| (2.0 / (s + 2.0)).sqrt().sqrt());
    Look {
        colour: [r, g, b, alpha],
        picture,
        normals,
        lies: [colour_lies, normals_lie, Lie::PLAIN],
        glow: material.emissive.map_or([0.0; 3], |e| e.map(unit)),
        metallic: extra("Pm").unwrap_or(0.0),
        roughness: extra("Pr").unwrap_or(roughness),
        transparent: alpha < 1.0
            || (material.dissolve_texture.is_some() && material.dissolve_texture == material.diffuse_texture),
        ..plain
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const QUAD: &str = "o a\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0.25\nvt 1\nvt 0 1 0\n";

    #[test]
    fn files_are_called_by_their_stems() {
        let all = [
            ("C:\\work\\a.b.png", "a.b"),
            ("../tex/skin.jpg", "skin"),
            ("plain", "plain"),
            ("tex/", ""),
            (".png", ""),
            ("", ""),
        ];
        for (name, wanted) in all {
            assert_eq!(stem(name), wanted, "{name}");
        }
    }

    #[test]
    fn materials_pictures_and_coordinates_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let png = b"\x89PNG\r\n\x1a\n and so on";
        std::fs::write(folder.path().join("skin one.png"), png).unwrap();
        let library = "newmtl cloth\nKd 0.2 0.4 2\nNs 0\nd 0.5\nnewmtl skin\nKd 0 0 0\nmap_Kd -s 1 1 1 C:\\x\\skin one.png\n\
            map_Bump none.png\nnorm gone.png\n";
        std::fs::write(folder.path().join("a.mtl"), library).unwrap();
        let text = format!("mtllib a.mtl\n{QUAD}usemtl cloth\nf 1/1 2/2 3/3\nusemtl skin\nf 1/1 3/3 4/4\n");
        let mut notes = Vec::new();
        let model = read("m", text.as_bytes(), Some(folder.path()), &mut notes).unwrap();
        assert_eq!((model.objects.len(), model.objects[0].patches.len(), model.looks.len()), (1, 2, 2));
        let [cloth, skin] = [&model.looks[0], &model.looks[1]];
        assert_eq!((cloth.colour, cloth.roughness, cloth.transparent), ([0.2, 0.4, 1.0, 0.5], 1.0, true));
        assert_eq!((skin.colour, skin.picture, skin.normals), ([1.0; 4], Some(0), None));
        assert_eq!(model.pictures[0].bytes, png);
        let left = SubjectNote::MapsLeft(vec!["map_Bump".into()]);
        assert_eq!(notes, [SubjectNote::FileMissing("gone.png".into()), left]);
        std::fs::write(folder.path().join("gone.png"), b"no picture").unwrap();
        notes.clear();
        read("m", text.as_bytes(), Some(folder.path()), &mut notes).unwrap();
        assert_eq!(notes[0], SubjectNote::OtherPicture("gone.png".into()));
        let first = &model.objects[0].patches[0];
        assert_eq!(first.coordinates, [[0.0, 1.0], [1.0, 0.75], [1.0, 1.0]]);
        assert_eq!((first.normals.as_slice(), first.look), (&[[0.0, 0.0, 1.0]; 3][..], Some(0)));
    }

    #[test]
    fn options_before_a_picture_place_it_and_are_no_part_of_its_name() {
        let lie = |offset, scale| Lie { offset, scale, ..Lie::PLAIN };
        // From the upper left corner: v = 1 - (4 (1 - w) + 0.25).
        let placed = (Lie { ends: [true; 2], ..lie([0.5, -3.25], [2.0, 4.0]) }, "a b.png");
        assert_eq!(options("-s 2 4 1 -o .5 .25 -clamp on a b.png"), placed);
        assert_eq!(options("-clamp off a.png"), (Lie::PLAIN, "a.png"));
        assert_eq!(options("-mm 0 1 -o 0.5 -bm 2 a b.png"), (lie([0.5, 0.0], [1.0; 2]), "a b.png"));
        for plain in ["a.png", "-s 1 1 1 a.png", "-s 0 0 a.png", "-s inf a.png", "-s a.png", "-type sphere a.png"] {
            assert_eq!(options(plain), (Lie::PLAIN, "a.png"), "{plain}");
        }
        assert_eq!((options("-a.png").1, options("-s 2").1, options("-clamp").1), ("-a.png", "2", ""));
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("a.png"), b"\x89PNG\r\n\x1a\n and so on").unwrap();
        let library = "newmtl m\nmap_Kd -s 4 4 1 a.png\nnewmtl n\nmap_Kd a.png\n";
        std::fs::write(folder.path().join("a.mtl"), library).unwrap();
        let text = format!("mtllib a.mtl\n{QUAD}usemtl m\nf 1/1 2/2 3/3\n");
        let model = read("m", text.as_bytes(), Some(folder.path()), &mut Vec::new()).unwrap();
        assert_eq!((model.pictures.len(), &model.pictures[0].name[..]), (1, "a"));
        let glb = String::from_utf8_lossy(&model.into_glb().unwrap()).into_owned();
        assert!(glb.contains(r#""KHR_texture_transform":{"offset":[0.0,-3.0],"scale":[4.0,4.0]}"#), "{glb}");
        assert!(glb.contains(r#""extensionsUsed":["KHR_texture_transform"]"#), "{glb}");
    }

    #[test]
    fn odd_lines_of_a_library_cost_no_other_looks() {
        let folder = tempfile::tempdir().unwrap();
        let library = "newmtl a\nKd 0.8\nillum none\nmap_Kd\nnewmtl b\nKd spectral x.rfl\nKe .5\n";
        std::fs::write(folder.path().join("a b.mtl"), library).unwrap();
        let text = format!("mtllib\ta b.mtl\n{QUAD}usemtl\ta\nf 1 2 3\nusemtl\nusemtl b\nf 1 3 4\nl 1 2 3\n");
        let mut notes = Vec::new();
        let model = read("m", text.as_bytes(), Some(folder.path()), &mut notes).unwrap();
        assert!(notes.is_empty(), "{notes:?}");
        let patches = &model.objects[0].patches;
        assert_eq!(patches.iter().map(|p| (p.look, p.indices.len())).collect::<Vec<_>>(), [(Some(0), 3), (Some(1), 3)]);
        assert_eq!((model.looks[0].colour, model.looks[1].glow), ([0.8, 0.8, 0.8, 1.0], [0.5; 3]));
    }

    #[test]
    fn a_line_may_name_several_libraries() {
        let folder = tempfile::tempdir().unwrap();
        for (name, material) in [("a", "cloth"), ("b", "skin"), ("b c", "hair")] {
            std::fs::write(folder.path().join(format!("{name}.mtl")), format!("newmtl {material}\nKd 1 0 0\n"))
                .unwrap();
        }
        let looks = |line: &str| {
            let (mut notes, text) = (Vec::new(), format!("mtllib {line}\n{QUAD}usemtl skin\nf 1 2 3\n"));
            let model = read("m", text.as_bytes(), Some(folder.path()), &mut notes).unwrap();
            (model.looks.into_iter().map(|look| look.name).collect::<Vec<_>>().join(" "), notes)
        };
        let missing = |name: &str| vec![SubjectNote::FileMissing(name.into())];
        assert_eq!(looks("a.mtl b.mtl"), ("cloth skin".into(), vec![]));
        assert_eq!(looks("a.mtl gone.mtl"), ("cloth".into(), missing("gone.mtl")));
        // A name that has blanks.
        assert_eq!(looks("b c.mtl"), ("hair".into(), vec![]));
        assert_eq!(looks("no name.mtl"), (String::new(), missing("no name.mtl")));
    }

    #[test]
    fn what_some_vertices_lack_costs_the_others_nothing() {
        const VERTICES: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n";
        let read = |text: &str| {
            let mut notes = Vec::new();
            let mut model = read("m", text.as_bytes(), None, &mut notes).unwrap();
            let patches = model.objects.iter_mut().map(|object| object.patches.remove(0));
            (patches.collect::<Vec<_>>(), notes)
        };
        // The second face has no coordinates, one of the third are none; what stands from the end keeps its place.
        let faces = "vt 0 .25\nvt 1 .25\nvt 0 1\nf 1/1 2/2 3/-1\nf 1 3 4\nvt nan 0\nf 1/1 2/2 4/4\n";
        let (patches, notes) = read(&format!("{VERTICES}{faces}o bare\nf 1 2 3\n"));
        let mut told: Vec<_> =
            patches[0].positions.iter().zip(&patches[0].coordinates).map(|(p, c)| (p[1], *c)).collect();
        told.truncate(3);
        assert_eq!(told, [(0.0, [0.0, 0.75]), (0.0, [1.0, 0.75]), (1.0, [0.0, 0.0])]);
        assert_eq!(patches[0].coordinates[3..], [[0.0, 1.0]; 4]);
        // Who has none at all gets none.
        assert!(patches[1].coordinates.is_empty());
        assert_eq!(notes, [SubjectNote::Mended { coordinates: 4, colours: 0 }]);
        let coloured = "v 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0 nan .5 .5\nv 0 1 0 0 1 x\nv 2 0 0 0 0 1\nf 1 2 3\nf 3 4 5\n";
        let (patches, notes) = read(&format!("{coloured}o bare\nv 0 0 1\nv 0 1 1\nv 1 1 1\nf 6 7 8\n"));
        let white = [1.0; 4];
        assert_eq!(patches[0].colours, [[1.0, 0.0, 0.0, 1.0], white, white, white, [0.0, 0.0, 1.0, 1.0]]);
        assert!(patches[1].colours.is_empty());
        assert_eq!(notes, [SubjectNote::Mended { coordinates: 0, colours: 3 }]);
    }

    #[test]
    fn what_does_not_fit_the_surface_is_left_out() {
        let text = format!("mtllib none.mtl\n{QUAD}usemtl x\nf 1/1 2/99 3/3\n");
        let mut notes = Vec::new();
        let model = read("m", text.as_bytes(), None, &mut notes).unwrap();
        let patch = &model.objects[0].patches[0];
        assert!(patch.coordinates.is_empty() && patch.normals.len() == 3 && patch.look.is_none());
        assert_eq!(notes, [SubjectNote::FileMissing("none.mtl".into())]);
        // Colours behind positions, names in another encoding, some faces without coordinates.
        let text = b"o caf\xe9\nv 0 0 0 1 0 0\nv 1 0 0 0 2 0\nv 0 1 0 0 0 1\nvt 0 0\nf 1 2/1 3\nf 1/1 2/1 3/1\n";
        let model = read("m", text, None, &mut Vec::new()).unwrap();
        let patch = &model.objects[0].patches[0];
        assert_eq!(patch.colours[1], [0.0, 1.0, 0.0, 1.0]);
        assert_eq!(patch.coordinates.len(), patch.positions.len());
        for broken in ["v 0 0\n", "v 0 0 nan\nv 0 0 0\nv 1 0 0\nf 1 2 3\n", "v 0 0 0\nf 1 2 3\n", "f 0 0 0\n"] {
            assert!(matches!(read("m", broken.as_bytes(), None, &mut Vec::new()), Err(Fault::Obj(_))), "{broken}");
        }
    }
}
