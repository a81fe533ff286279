//! What does not come along when a file becomes another: counted as files are written, told once at the end.

use std::collections::{HashMap, HashSet};
use std::fs::File;
use std::io::{Cursor, Read, Seek, SeekFrom};
use std::path::Path;

use riglab_asset::rigging::{Subject, SubjectOptions};
use riglab_asset::{ImportError, Imported, Target, is_gltf};
use riglab_core::{Asset, Rig};
use serde::Deserialize;
use serde::de::IgnoredAny;
use serde_json::Value;

use riglab_report::counted;

/// What the files have that were written so far, beside skeleton, mesh and weights.
///
/// What a format lacks of these three, as joint names, it tells itself.
#[derive(Clone, Debug, Default)]
pub struct Lost {
    files: usize,
    /// Those whose meshes became one, and how many they had.
    merged: usize,
    meshes: usize,
    animations: usize,
    springs: usize,
    human_bones: usize,
    morph_targets: usize,
    materials: usize,
    pictures: usize,
    uv_maps: usize,
    colour_sets: usize,
    cameras: usize,
    lights: usize,
    variants: usize,
    extras: usize,
    /// Of files that were written as FBX with their documents.
    #[cfg(feature = "fbx")]
    of_documents: riglab_asset::FbxLeft,
}

impl Lost {
    /// And what an FBX does not hold of a document.
    #[cfg(feature = "fbx")]
    pub fn with_document(mut self, left: riglab_asset::FbxLeft) -> Self {
        self.files += 1;
        self.of_documents.add(left);
        self
    }

    /// And of a file that is written by its rig alone, without its document.
    pub fn with(mut self, imported: &Imported, target: Target) -> Self {
        self.files += 1;
        if let Some(rig) = imported.rig() {
            self.add_body(rig, target);
        }
        let parts = &imported.reading.parts;
        let meshes = parts.iter().map(|part| part.node).collect::<HashSet<_>>().len();
        if meshes > 1 {
            self.merged += 1;
            self.meshes += meshes;
        }
        let source = Path::new(&imported.provenance.source);
        let ends = |ending: &str| source.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending));
        if is_gltf(source) {
            self.add(Document::read(source).unwrap_or_default());
        } else if ends("fbx") {
            if let Ok(subject) = subject(source) {
                self.animations += subject.animations_left();
                self.add(Document::of_subject(&subject).unwrap_or_default());
            }
        } else if ends("ply") {
            // The material that shows its colours is none of the file.
            self.add(Document { materials: Vec::new(), ..Document::with_looks(source).unwrap_or_default() });
        } else if ends("obj") {
            let text = std::fs::read(source).unwrap_or_default();
            let lines = || text.split(|b| *b == b'\n');
            self.materials += lines().filter(|l| l.starts_with(b"usemtl ")).collect::<HashSet<_>>().len();
            self.uv_maps += usize::from(lines().any(|l| l.starts_with(b"vt ")));
        }
        self
    }

    /// And what a document has.
    fn add(&mut self, document: Document) {
        let having = |attribute: &str| document.meshes.iter().filter(|mesh| mesh.has(attribute)).count();
        self.animations += document.animations.len();
        self.materials += document.materials.len();
        self.pictures += document.images.len();
        self.morph_targets += document.meshes.iter().map(Mesh::targets).sum::<usize>();
        self.uv_maps += having("TEXCOORD_0");
        self.colour_sets += having("COLOR_0");
        self.cameras += document.cameras.len();
        self.lights += document.listed("KHR_lights_punctual", "lights");
        self.variants += document.listed("KHR_materials_variants", "variants");
        self.extras += document.extras();
    }

    /// And of an asset of a corpus, which has no more than its rig and motions.
    pub fn with_asset(mut self, asset: &Asset, target: Target) -> Self {
        self.files += 1;
        if !target.holds_scenes() {
            self.animations += asset.clips.len();
        }
        self.add_body(&asset.rig, target);
        self
    }

    fn add_body(&mut self, rig: &Rig, target: Target) {
        // A GLB has both.
        if target != Target::GLB {
            self.springs += rig.springs().springs().len();
            self.human_bones += rig.humanoid().len();
        }
    }

    /// Tells it: a line for what is not written, and one for meshes that became one.
    pub fn tell(&self, input: &Path, target: Target) {
        self.lines(target).iter().for_each(|line| tell!("note: {}: {line}", input.display()));
    }

    fn lines(&self, target: Target) -> Vec<String> {
        let kinds = [
            (self.animations, "animation"),
            (self.springs, "spring"),
            (self.human_bones, "human bone"),
            (self.morph_targets, "morph target"),
            (self.materials, "material"),
            (self.pictures, "picture"),
            (self.uv_maps, "UV map"),
            (self.colour_sets, "colour set"),
            (self.cameras, "camera"),
            (self.lights, "light"),
            (self.variants, "material variant"),
        ];
        let mut lost: Vec<String> = kinds.iter().filter(|(n, _)| *n > 0).map(|(n, what)| counted(*n, what)).collect();
        lost.extend((self.extras > 0).then(|| format!("{} with extras", counted(self.extras, "object"))));
        #[cfg(feature = "fbx")]
        lost.extend(self.of_documents.parts());
        let mut lines = Vec::new();
        if let Some((last, others)) = lost.split_last() {
            let all = if others.is_empty() { last.clone() } else { format!("{} and {last}", others.join(", ")) };
            lines.push(format!("not written, as riglab's {target} files hold none: {all}"));
        }
        match (self.merged, self.files) {
            (0, _) => {}
            (_, 1) => lines.push(format!("{} meshes became one", self.meshes)),
            (merged, _) => lines.push(format!("{} of several meshes: they became one each", counted(merged, "file"))),
        }
        lines
    }
}

/// The lists of a glTF that no rig has, by their lengths.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Document {
    animations: Vec<IgnoredAny>,
    materials: Vec<Object>,
    images: Vec<IgnoredAny>,
    meshes: Vec<Mesh>,
    cameras: Vec<IgnoredAny>,
    nodes: Vec<Object>,
    scenes: Vec<Object>,
    extensions: Value,
    extras: Value,
}

/// Anything that may have data of its own.
#[derive(Default, Deserialize)]
#[serde(default)]
struct Object {
    extras: Value,
}

/// Extras that say what is told by another name: names of morph targets, and human bones as riglab writes them.
const TOLD: [&str; 2] = ["targetNames", "riglabHumanBone"];

/// Whether extras say something.
fn say(extras: &Value) -> bool {
    match extras {
        Value::Null => false,
        Value::Object(members) => members.keys().any(|key| !TOLD.contains(&key.as_str())),
        _ => true,
    }
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Mesh {
    primitives: Vec<Primitive>,
    extras: Value,
}

#[derive(Default, Deserialize)]
#[serde(default)]
struct Primitive {
    targets: Vec<IgnoredAny>,
    attributes: HashMap<String, IgnoredAny>,
}

impl Mesh {
    fn has(&self, attribute: &str) -> bool {
        self.primitives.iter().any(|p| p.attributes.contains_key(attribute))
    }

    /// The primitives of a mesh have the same ones.
    fn targets(&self) -> usize {
        self.primitives.iter().map(|p| p.targets.len()).max().unwrap_or(0)
    }
}

impl Document {
    /// How long a list of an extension of the document is.
    fn listed(&self, extension: &str, list: &str) -> usize {
        self.extensions[extension][list].as_array().map_or(0, Vec::len)
    }

    /// How many objects say something in their extras.
    fn extras(&self) -> usize {
        let objects = self.nodes.iter().chain(&self.scenes).chain(&self.materials).map(|object| &object.extras);
        objects.chain(self.meshes.iter().map(|mesh| &mesh.extras)).chain([&self.extras]).filter(|of| say(of)).count()
    }

    /// Of a file that was imported before; `None` where it is not as it was.
    fn read(path: &Path) -> Option<Self> {
        Self::of(File::open(path).ok()?)
    }

    /// Of a file of another format, as the document that it becomes when it is rigged.
    fn with_looks(path: &Path) -> Option<Self> {
        Self::of_subject(&subject(path).ok()?)
    }

    fn of_subject(subject: &Subject) -> Option<Self> {
        Self::of(Cursor::new(subject.document()?))
    }

    fn of(mut file: impl Read + Seek) -> Option<Self> {
        let (mut head, mut json) = ([0; 20], Vec::new());
        file.read_exact(&mut head).ok()?;
        if head.starts_with(b"glTF") {
            // Magic, version and length of the file, then length and kind of the first chunk.
            let length = u32::from_le_bytes(head[12..16].try_into().ok()?);
            file.take(length.into()).read_to_end(&mut json).ok()?;
        } else {
            file.seek(SeekFrom::Start(0)).ok()?;
            file.read_to_end(&mut json).ok()?;
        }
        serde_json::from_slice(json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(&json)).ok()
    }
}

/// A model that becomes a document, of any size: what limits it is there for what is to be rigged.
pub(super) fn subject(path: &Path) -> Result<Subject, ImportError> {
    Subject::read(path, &SubjectOptions { max_triangles: usize::MAX, ..SubjectOptions::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_lost_is_told_by_kind() {
        let one = Lost { files: 1, merged: 1, meshes: 3, animations: 2, springs: 3, pictures: 1, ..Lost::default() };
        let wanted = [
            "not written, as riglab's obj files hold none: 2 animations, 3 springs and 1 picture",
            "3 meshes became one",
        ];
        assert_eq!(one.lines(Target::OBJ), wanted);
        let many = Lost { files: 9, merged: 4, meshes: 12, materials: 7, ..Lost::default() };
        let wanted = [
            "not written, as riglab's anymate files hold none: 7 materials",
            "4 files of several meshes: they became one each",
        ];
        assert_eq!(many.lines(Target::ANYMATE), wanted);
        let extras = |extras| Lost { files: 1, extras, ..Lost::default() }.lines(Target::OBJ);
        assert!(extras(1)[0].ends_with(": 1 object with extras") && extras(2)[0].ends_with(": 2 objects with extras"));
        assert!(Lost { files: 2, ..Lost::default() }.lines(Target::GLB).is_empty());
    }

    fn told(name: &str, bytes: &[u8]) -> Vec<String> {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        let imported = riglab_asset::import(&path, &Default::default()).unwrap();
        Lost::default().with(&imported, Target::OBJ).lines(Target::OBJ)
    }

    #[test]
    fn a_scan_loses_its_colours_and_no_material() {
        let columns = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue", "float u", "float v"];
        let columns: String = columns.map(|of| format!("property {of}\n")).concat();
        let rows = "0 0 0 9 9 9 0 0\n1 0 0 9 9 9 1 0\n0 1 0 9 9 9 0 1\n3 0 1 2\n";
        let head = format!("ply\nformat ascii 1.0\nelement vertex 3\n{columns}element face 1\n");
        let ply = format!("{head}property list uchar int vertex_index\nend_header\n{rows}");
        let wanted = "not written, as riglab's obj files hold none: 1 UV map and 1 colour set";
        assert_eq!(told("a.ply", ply.as_bytes()), [wanted]);
    }

    #[cfg(feature = "fbx")]
    #[test]
    fn an_fbx_loses_its_material_and_coordinates() {
        let fbx = "; FBX 7.4.0 project file\nFBXHeaderExtension: {\nFBXVersion: 7400\n}\nObjects: {\n\
            Geometry: 2, \"Geometry::\", \"Mesh\" {\nVertices: *9 { a: 0,0,0,1,0,0,0,1,0 }\n\
            PolygonVertexIndex: *3 { a: 0,1,-3 }\nLayerElementUV: 0 {\nName: \"map\"\n\
            MappingInformationType: \"ByPolygonVertex\"\nReferenceInformationType: \"Direct\"\n\
            UV: *6 { a: 0,0,1,0,0,1 }\n}\nLayer: 0 {\nLayerElement: {\nType: \"LayerElementUV\"\nTypedIndex: 0\n}\n}\n}\n\
            Model: 1, \"Model::body\", \"Mesh\" {\nVersion: 232\n}\nMaterial: 5, \"Material::cloth\", \"\" {\nVersion: 102\n}\n\
            }\nConnections: {\nC: \"OO\",1,0\nC: \"OO\",2,1\nC: \"OO\",5,1\n}\n";
        let wanted = "not written, as riglab's obj files hold none: 1 material and 1 UV map";
        assert_eq!(told("a.fbx", fbx.as_bytes()), [wanted]);
    }

    #[test]
    fn what_a_scene_has_beside_its_meshes_is_counted() {
        let json = r#"{"cameras": [{}], "extras": {"made": "here"}, "nodes": [{"extras": {"riglabHumanBone": "head"}},
            {"extras": 3}, {"extras": {}}], "meshes": [{"extras": {"targetNames": ["a"]}}, {"extras": {"targetNames": [], "b": 1}}],
            "extensions": {"KHR_lights_punctual": {"lights": [{}, {}]}, "KHR_materials_variants": {"variants": [{}, {}, {}]}}}"#;
        let mut lost = Lost { files: 1, ..Lost::default() };
        lost.add(Document::of(Cursor::new(json)).unwrap());
        assert_eq!((lost.cameras, lost.lights, lost.variants, lost.extras), (1, 2, 3, 3));
        assert_eq!(Document::of(Cursor::new(r#"{"extensions": [], "images": []}"#)).unwrap().listed("a", "b"), 0);
    }

    #[test]
    fn a_document_is_counted_in_both_its_forms() {
        let dir = tempfile::tempdir().unwrap();
        let json = r#"{"asset": {"version": "2.0"}, "animations": [{}, {}], "images": [{"uri": "a.png"}],
            "meshes": [{"primitives": [{"targets": [{}, {}]}, {"targets": [{}, {}], "attributes": {"TEXCOORD_0": 3}}]},
                {"primitives": []}]}"#;
        let mut glb = b"glTF\x02\0\0\0".to_vec();
        glb.extend((20 + json.len() as u32).to_le_bytes());
        glb.extend((json.len() as u32).to_le_bytes());
        glb.extend(b"JSON");
        glb.extend(json.as_bytes());
        let (plain, binary) = (dir.path().join("a.gltf"), dir.path().join("a.glb"));
        std::fs::write(&plain, json).unwrap();
        std::fs::write(&binary, [&glb[..], b"more"].concat()).unwrap();
        for path in [plain, binary] {
            let found = Document::read(&path).unwrap();
            let targets: usize = found.meshes.iter().map(Mesh::targets).sum();
            assert_eq!(found.meshes.iter().map(|mesh| mesh.has("TEXCOORD_0")).collect::<Vec<_>>(), [true, false]);
            assert_eq!((found.animations.len(), found.materials.len(), found.images.len(), targets), (2, 0, 1, 2));
        }
    }
}
