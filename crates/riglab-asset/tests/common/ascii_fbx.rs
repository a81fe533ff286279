//! FBX files as text, made for tests.

use std::fmt::{Display, Write};

/// A matrix as FBX writes it: 16 numbers, the translation in the last four.
pub type Matrix = [f64; 16];

/// Scale by `s`, then move.
pub fn scaled_and_moved(s: f64, [x, y, z]: [f64; 3]) -> Matrix {
    [s, 0.0, 0.0, 0.0, 0.0, s, 0.0, 0.0, 0.0, 0.0, s, 0.0, x, y, z, 1.0]
}

pub fn moved(by: [f64; 3]) -> Matrix {
    scaled_and_moved(1.0, by)
}

/// One cluster: bone, weights by vertex, `Transform`, `TransformLink`.
pub struct Cluster<'a> {
    pub bone: u32,
    pub weights: &'a [(usize, f64)],
    pub transform: Matrix,
    pub link: Matrix,
}

/// A curve: node, property, axis, and keys (seconds, value).
pub type Curve<'a> = (u32, &'a str, &'a str, &'a [(f64, f64)]);

/// A file that grows; objects have numbers of the test's choice, 0 is the root.
pub struct Ascii {
    settings: String,
    objects: String,
    connections: String,
    last: u32,
}

impl Ascii {
    /// In centimetres, y up.
    pub fn new() -> Self {
        Self::with_space([(1, 1), (2, 1), (0, 1)], 1.0)
    }

    /// With the number and sign of the axes up, front and right, and the unit in centimetres.
    pub fn with_space(axes: [(i32, i32); 3], unit: f64) -> Self {
        let mut settings = format!("P: \"UnitScaleFactor\", \"double\", \"Number\", \"\",{unit}\n");
        for (name, (axis, sign)) in ["Up", "Front", "Coord"].into_iter().zip(axes) {
            writeln!(settings, "P: \"{name}Axis\", \"int\", \"Integer\", \"\",{axis}").unwrap();
            writeln!(settings, "P: \"{name}AxisSign\", \"int\", \"Integer\", \"\",{sign}").unwrap();
        }
        Self { settings, objects: String::new(), connections: String::new(), last: 1_000_000 }
    }

    /// A node of some kind (`LimbNode`, `Null`) with its attribute, and further properties.
    pub fn node(mut self, id: u32, name: &str, kind: &str, parent: u32, translation: [f64; 3], more: &str) -> Self {
        let attribute = self.next();
        let [x, y, z] = translation;
        write!(
            self.objects,
            "NodeAttribute: {attribute}, \"NodeAttribute::\", \"{kind}\" {{ TypeFlags: \"Skeleton\" }}\n\
             Model: {id}, \"Model::{name}\", \"{kind}\" {{\nVersion: 232\nProperties70: {{\n\
             P: \"Lcl Translation\", \"Lcl Translation\", \"\", \"A\",{x},{y},{z}\n{more}\n}}\n}}\n",
        )
        .unwrap();
        self.connect(attribute, id).connect(id, parent)
    }

    pub fn bone(self, id: u32, name: &str, parent: u32, translation: [f64; 3]) -> Self {
        self.node(id, name, "LimbNode", parent, translation, "")
    }

    /// A mesh on the node `id`, its geometry `id` + 1; polygons name vertices.
    pub fn mesh(mut self, id: u32, parent: u32, points: &[[f64; 3]], polygons: &[&[i32]], more: &str) -> Self {
        let corners = polygons.iter().flat_map(|p| {
            let (last, first) = p.split_last().unwrap();
            first.iter().copied().chain([!last])
        });
        let (points, corners) = (list(points.as_flattened()), list(&corners.collect::<Vec<_>>()));
        let geometry = id + 1;
        write!(
            self.objects,
            "Geometry: {geometry}, \"Geometry::\", \"Mesh\" {{\nVertices: {points}\nPolygonVertexIndex: {corners}\n}}\n\
             Model: {id}, \"Model::mesh{id}\", \"Mesh\" {{\nVersion: 232\nProperties70: {{\n{more}\n}}\n}}\n",
        )
        .unwrap();
        self.connect(geometry, id).connect(id, parent)
    }

    /// Binds the mesh on node `mesh`.
    pub fn skin(mut self, mesh: u32, clusters: &[Cluster<'_>]) -> Self {
        let skin = self.next();
        writeln!(self.objects, "Deformer: {skin}, \"Deformer::\", \"Skin\" {{ Version: 101 }}").unwrap();
        self = self.connect(skin, mesh + 1);
        for Cluster { bone, weights, transform, link } in clusters {
            let cluster = self.next();
            let (vertices, weights): (Vec<usize>, Vec<f64>) = weights.iter().copied().unzip();
            write!(self.objects, "Deformer: {cluster}, \"SubDeformer::\", \"Cluster\" {{\nVersion: 100\n").unwrap();
            if !vertices.is_empty() {
                write!(self.objects, "Indexes: {}\nWeights: {}\n", list(&vertices), list(&weights)).unwrap();
            }
            write!(self.objects, "Transform: {}\nTransformLink: {}\n}}\n", list(transform), list(link)).unwrap();
            self = self.connect(cluster, skin).connect(*bone, cluster);
        }
        self
    }

    /// A blend shape of the mesh on node `mesh` that moves one vertex; `id` is its channel's, which animations move.
    pub fn shape(mut self, mesh: u32, id: u32, vertex: usize, by: [f64; 3]) -> Self {
        let (deformer, shape) = (self.next(), self.next());
        write!(
            self.objects,
            "Geometry: {shape}, \"Geometry::s{id}\", \"Shape\" {{\nIndexes: {}\nVertices: {}\n}}\n\
             Deformer: {deformer}, \"Deformer::\", \"BlendShape\" {{\n}}\n\
             Deformer: {id}, \"SubDeformer::s{id}\", \"BlendShapeChannel\" {{\nFullWeights: *1 {{ a: 100 }}\n}}\n",
            list(&[vertex]),
            list(&by),
        )
        .unwrap();
        self.connect(deformer, mesh + 1).connect(id, deformer).connect(shape, id)
    }

    /// An animation: keys (seconds, value) of axes of properties of nodes, with straight lines between. `span` is the time
    /// that the file gives it, where it gives one.
    pub fn motion(mut self, name: &str, span: Option<[f64; 2]>, curves: &[Curve<'_>]) -> Self {
        // Ticks of a second.
        let ticks = |seconds: f64| (seconds * 46_186_158_000.0) as i64;
        let (stack, layer) = (self.next(), self.next());
        let span = span.map_or(String::new(), |[start, end]| {
            let time = |name: &str, at| format!("P: \"{name}\", \"KTime\", \"Time\", \"\",{}\n", ticks(at));
            time("LocalStart", start) + &time("LocalStop", end)
        });
        write!(
            self.objects,
            "AnimationStack: {stack}, \"AnimStack::{name}\", \"\" {{\nProperties70: {{\n{span}}}\n}}\n\
             AnimationLayer: {layer}, \"AnimLayer::Base\", \"\" {{\n}}\n"
        )
        .unwrap();
        self = self.connect(layer, stack);
        for (node, property, axis, keys) in curves {
            let (values, curve) = (self.next(), self.next());
            let (times, heights): (Vec<i64>, Vec<f64>) = keys.iter().map(|(at, value)| (ticks(*at), *value)).unzip();
            // What axes without keys have.
            let still = if *property == "Lcl Scaling" { 1 } else { 0 };
            let axes =
                ["X", "Y", "Z"].map(|axis| format!("P: \"d|{axis}\", \"Number\", \"\", \"A\",{still}\n")).concat();
            write!(
                self.objects,
                "AnimationCurveNode: {values}, \"AnimCurveNode::V\", \"\" {{\nProperties70: {{\n{axes}}}\n}}\n\
                 AnimationCurve: {curve}, \"AnimCurve::\", \"\" {{\nKeyVer: 4008\nKeyTime: {}\nKeyValueFloat: {}\n\
                 KeyAttrFlags: *1 {{ a: 4 }}\nKeyAttrDataFloat: *4 {{ a: 0,0,0,0 }}\nKeyAttrRefCount: *1 {{ a: {} }}\n}}\n",
                list(&times),
                list(&heights),
                keys.len(),
            )
            .unwrap();
            self = self.connect(values, layer);
            writeln!(self.connections, "C: \"OP\",{values},{node},\"{property}\"").unwrap();
            writeln!(self.connections, "C: \"OP\",{curve},{values},\"{axis}\"").unwrap();
        }
        self
    }

    pub fn connect(mut self, what: u32, to: u32) -> Self {
        writeln!(self.connections, "C: \"OO\",{what},{to}").unwrap();
        self
    }

    fn next(&mut self) -> u32 {
        self.last += 1;
        self.last
    }

    pub fn bytes(&self) -> Vec<u8> {
        let Self { settings, objects, connections, .. } = self;
        format!(
            "; FBX 7.4.0 project file\nFBXHeaderExtension: {{\nFBXHeaderVersion: 1003\nFBXVersion: 7400\n}}\n\
             GlobalSettings: {{\nVersion: 1000\nProperties70: {{\n{settings}}}\n}}\n\
             Objects: {{\n{objects}}}\nConnections: {{\n{connections}}}\n"
        )
        .into_bytes()
    }
}

fn list<T: Display>(values: &[T]) -> String {
    let text: Vec<String> = values.iter().map(ToString::to_string).collect();
    format!("*{} {{ a: {} }}", values.len(), text.join(","))
}

/// The corners of a tetrahedron, and its sides.
pub const TETRAHEDRON: [[f64; 3]; 4] = [[0.0; 3], [10.0, 0.0, 0.0], [0.0, 25.0, 0.0], [0.0, 0.0, 10.0]];
pub const SIDES: [&[i32]; 4] = [&[0, 2, 1], &[0, 1, 3], &[0, 3, 2], &[1, 2, 3]];

/// A tetrahedron on two bones, `hips` (1) at (0, 10, 0) and `tip` (2) at (0, 20, 0); the mesh is on node 10.
pub fn tiny(file: Ascii) -> Ascii {
    let (hips, tip) = ([0.0, 10.0, 0.0], [0.0, 20.0, 0.0]);
    file.bone(1, "hips", 0, hips).bone(2, "tip", 1, hips).mesh(10, 0, &TETRAHEDRON, &SIDES, "").skin(
        10,
        &[
            Cluster {
                bone: 1,
                weights: &[(0, 1.0), (1, 0.5), (3, 0.25)],
                transform: moved(hips.map(|x| -x)),
                link: moved(hips),
            },
            Cluster {
                bone: 2,
                weights: &[(1, 0.5), (2, 1.0), (3, 0.75)],
                transform: moved(tip.map(|x| -x)),
                link: moved(tip),
            },
        ],
    )
}
