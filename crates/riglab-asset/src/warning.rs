//! What an importer repaired or wants known.

use std::fmt;

/// Something a person or a curation rule may want to know about a file that was imported all the
/// same. Its text is a sentence without a full stop.
#[derive(Clone, Debug, PartialEq)]
pub enum Warning {
    /// Bytes after the length in the GLB header were ignored.
    TrailingBytes(usize),
    /// The file has a mesh, but no skin.
    NoSkeleton,
    /// The nodes of some skins' joints stand in another pose than the bind pose, which was read.
    RestIsNotBind {
        /// How large the first of them is there, by what it is in the bind pose; 1 where it is about the same.
        size: f64,
        /// How far joints stand there from where they were bound, at most, as a share of the mesh's size; 0 where that is not
        /// known, as in another size.
        off: f64,
        /// Which skins.
        skins: Vec<usize>,
    },
    /// Bind poses that contradict each other: moving the mesh by them would bend it, so the mesh was
    /// left as it is stored and the joints moved to it.
    Bent {
        /// Which skins.
        skins: Vec<usize>,
    },
    /// At rest a mesh has another shape than the file shows: scales of joints, which rest leaves out, squash or mirror it.
    Reshaped {
        /// Which skins.
        skins: Vec<usize>,
        /// Whether any is larger in one direction than in another, by what the file shows.
        squashed: bool,
        /// Whether left and right are exchanged.
        mirrored: bool,
    },
    /// Joints or nodes above them have a scale of 0: what lies below stands nowhere, so the bind
    /// pose alone was read.
    ZeroScale {
        /// Which nodes.
        nodes: Vec<NodeName>,
    },
    /// Joints without a name, or with that of another, got a new one.
    Renamed {
        /// How many.
        joints: usize,
        /// The first one's node, name in the file, and new name.
        first: (usize, String, String),
    },
    /// Several roots under one skin.
    SeveralRoots {
        /// Their names.
        roots: Vec<String>,
        /// What was done.
        remedy: String,
    },
    /// Several skeletons that no skin connects: several characters, or parts bound one by one.
    SeparateSkeletons {
        /// How many.
        skeletons: usize,
        /// The names of all roots.
        roots: Vec<String>,
        /// What was done.
        remedy: String,
    },
    /// Joints that nothing connects to the root became its children, as was asked for.
    Attached {
        /// Their names.
        joints: Vec<String>,
        /// The root's name.
        root: String,
    },
    /// Copies of branching joints, as RigNet's predictions have them, were folded back, as was asked for.
    FoldedCopies {
        /// Their names.
        joints: Vec<String>,
    },
    /// A skeleton of one joint.
    SingleJoint,
    /// More joints than most methods take.
    ManyJoints(usize),
    /// Too few triangles to enclose anything.
    FewTriangles(usize),
    /// Unskinned meshes at or below a joint were bound to it with weight 1.
    RigidParts {
        /// The nodes that hold them.
        nodes: Vec<NodeName>,
        /// The joints they hang on, one a node.
        joints: Vec<String>,
    },
    /// Unskinned meshes elsewhere, or flattened by a scale of 0, are not of the rig.
    LeftOut {
        /// The nodes that hold them.
        nodes: Vec<NodeName>,
    },
    /// Meshes that are colliders by the names of their nodes were left out of a file without a skeleton.
    Colliders {
        /// The nodes that hold them.
        nodes: Vec<NodeName>,
    },
    /// Meshes that a file without a skeleton does not show were left out.
    Unseen {
        /// The nodes that hold them.
        nodes: Vec<NodeName>,
    },
    /// Meshes that an extension draws several times were read once, as their nodes stand.
    Instanced {
        /// The nodes that hold them.
        nodes: Vec<NodeName>,
        /// How often each is drawn.
        times: Vec<u64>,
    },
    /// Primitives of points or lines, or without positions, are not of the mesh.
    NoSurface {
        /// How many.
        primitives: usize,
        /// The nodes that hold nothing else and hang on no joint: nothing moves them with the model.
        still: Vec<NodeName>,
    },
    /// Triangles that name a vertex twice, or the same vertices as another, are no part of the mesh. What is written into the
    /// model's own document keeps them.
    Degenerate {
        /// Those that name a vertex twice.
        collapsed: usize,
        /// Those that repeat another.
        repeated: usize,
    },
    /// Vertices without weight took the weights of the nearest that has some.
    Unweighted {
        /// How many.
        vertices: usize,
    },
    /// Weights were divided by their sum.
    NotNormalised {
        /// How many vertices.
        vertices: usize,
        /// Smallest and largest sum.
        sums: (f64, f64),
    },
    /// Negative weights were set to 0.
    NegativeWeights {
        /// How many vertices.
        vertices: usize,
    },
    /// Weights of a joint named twice in a vertex were added.
    DuplicateInfluences {
        /// How many vertices.
        vertices: usize,
    },
    /// The file has z up; the rig has y up, as all rigs.
    TurnedUp,
    /// The mesh stands so far from the origin that its places are rounded to few.
    Far {
        /// How many places single precision has along its largest side.
        steps: usize,
    },
    /// Joints lie outside the mesh.
    JointsOutside {
        /// How many.
        outside: usize,
        /// Of how many.
        joints: usize,
    },
    /// Weights are on joints far from their vertices.
    FarWeights {
        /// Mean distance to the heaviest bone over that to the nearest.
        ratio: f64,
    },
    /// Joints out of range, but without weight, were ignored.
    UnusedJointIndex {
        /// How many vertices.
        vertices: usize,
    },
    /// Animations that cannot be read were left out.
    ClipsLeftOut {
        /// Name and reason of each.
        clips: Vec<String>,
    },
    /// Animations were longer than is kept; their beginning was read.
    ClipsCut {
        /// The name of each.
        clips: Vec<String>,
        /// Frames kept.
        frames: usize,
    },
    /// Parts of a VRM extension that are broken were left out or brought into range.
    Vrm {
        /// `humanoid` or `springs`.
        part: &'static str,
        /// A phrase for each.
        dropped: Vec<String>,
    },
}

impl fmt::Display for Warning {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // A line, whatever the names are that it quotes.
        f.write_str(&Sentence(self).to_string().replace(char::is_control, " "))
    }
}

/// What a warning says, with names as the file has them.
struct Sentence<'a>(&'a Warning);

impl fmt::Display for Sentence<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.sentence(f)
    }
}

impl Warning {
    fn sentence(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TrailingBytes(n) => write!(f, "{n} trailing bytes after the length in the header were ignored"),
            Self::NoSkeleton => f.write_str("the file has a mesh but no skin: there is no skeleton and no rig"),
            Self::RestIsNotBind { skins, size, off } => {
                let skins = numbered("skin", skins);
                write!(
                    f,
                    "the file shows another pose than the bind pose ({}); the bind pose was used",
                    Some3(&skins)
                )?;
                if *size != 1.0 {
                    write!(f, ", in which the model has {} of the size that the file shows", rounded(1.0 / size))?;
                }
                if *off > FEW {
                    let percent = 100.0 * off;
                    write!(
                        f,
                        ", in which joints are up to {percent:.0} % of the model's size from where the file shows them"
                    )?;
                }
                Ok(())
            }
            Self::Bent { skins } => write!(
                f,
                "the rest pose would bend the mesh, as bind poses contradict each other ({}); \
                 the mesh was left as stored and the joints put where it was bound",
                Some3(&numbered("skin", skins))
            ),
            Self::Reshaped { skins, squashed, mirrored } => {
                let shape = match (squashed, mirrored) {
                    (true, true) => "squashed and mirrored",
                    (false, true) => "mirrored",
                    _ => "squashed",
                };
                write!(
                    f,
                    "at rest the model is {shape} by what the file shows ({}), as scales of joints are left out there; apply them \
                     in the program that it comes from",
                    Some3(&numbered("skin", skins))
                )
            }
            Self::ZeroScale { nodes } => write!(
                f,
                "joints, or nodes above them, have a scale of 0 ({}); only their bind pose was read",
                Some3(&told(nodes))
            ),
            Self::Renamed { joints, first: (node, from, to) } => {
                let more = if *joints > 1 { format!("; {} more were renamed", joints - 1) } else { String::new() };
                write!(f, "the joint of node {node} had no unique name: `{from}` became `{to}`{more}")
            }
            Self::SeveralRoots { roots, remedy } => {
                write!(f, "the skeleton has {} roots ({}); {remedy}", roots.len(), Some3(roots))
            }
            Self::SeparateSkeletons { skeletons, roots, remedy } => {
                write!(
                    f,
                    "{skeletons} separate skeletons in one file (roots {}); {remedy}; `--character 0` of `riglab view`, \
                     `inspect` and `convert` takes one alone, by its number or the name of its root; `riglab dataset import \
                     --split-characters` and `riglab curate --set import.split_characters=true` take each",
                    Some3(roots)
                )
            }
            Self::Attached { joints, root } => write!(
                f,
                "joints that nothing connects to the root ({}) became children of {}",
                Some3(&quoted(joints)),
                Some3(&quoted(std::slice::from_ref(root)))
            ),
            Self::FoldedCopies { joints } => write!(
                f,
                "copies of branching joints ({}) were folded back into the joints that they copy",
                Some3(&quoted(joints))
            ),
            Self::SingleJoint => f.write_str("the skeleton has a single joint"),
            Self::ManyJoints(n) => write!(f, "the skeleton has {n} joints, more than the usual limit of {MANY_JOINTS}"),
            Self::FewTriangles(n) => write!(f, "the mesh has only {n} triangle{}", if *n == 1 { "" } else { "s" }),
            Self::RigidParts { nodes, joints } => {
                write!(
                    f,
                    "unskinned meshes became rigid parts of the joints they hang on: {}",
                    Some3(&nodes.iter().zip(joints).map(|(n, j)| format!("{n} on `{j}`")).collect::<Vec<_>>())
                )
            }
            Self::LeftOut { nodes } => {
                let nodes = told(nodes);
                write!(
                    f,
                    "unskinned meshes that are hidden or hang on no joint are not rigged: {}; what is written of a glTF's own \
                     document keeps them as they are, all else lacks them",
                    Some3(&nodes)
                )
            }
            Self::Colliders { nodes } => {
                let nodes = told(nodes);
                write!(f, "meshes that are colliders by name stay as they are, without a skin: {}", Some3(&nodes))
            }
            Self::Unseen { nodes } => {
                let nodes = told(nodes);
                write!(
                    f,
                    "meshes that the file does not show (in no scene or another one, hidden, or lower levels of detail) stay as \
                     they are, without a skin: {}",
                    Some3(&nodes)
                )
            }
            Self::Instanced { nodes, times } => {
                let each: Vec<_> =
                    nodes.iter().zip(times).map(|(node, times)| format!("{node}: {times} times")).collect();
                write!(
                    f,
                    "meshes that EXT_mesh_gpu_instancing draws several times were read once, as their nodes stand ({}); make \
                     real copies of them first, in the program that the file comes from",
                    Some3(&each)
                )
            }
            Self::NoSurface { primitives, still } => {
                let are = of_number(
                    *primitives,
                    "primitive of points or lines, or without positions, is",
                    "primitives of points or lines, or without positions, are",
                );
                write!(
                    f,
                    "{are} not looked at; what is written of a glTF's own document has them still, moving with the surface near \
                     them"
                )?;
                match still.is_empty() {
                    true => Ok(()),
                    false => write!(
                        f,
                        ", but for what no skin binds and no surface is beside, which stays where it is: {}",
                        Some3(&told(still))
                    ),
                }
            }
            Self::Degenerate { collapsed, repeated } => {
                let kinds = [
                    (*collapsed, of_number(*collapsed, "that names a vertex twice", "that name a vertex twice")),
                    (*repeated, of_number(*repeated, "repeated one", "repeated ones")),
                ];
                let told: Vec<String> = kinds.into_iter().filter(|(n, _)| *n > 0).map(|(_, kind)| kind).collect();
                write!(
                    f,
                    "degenerate triangles are ignored: {}; they stay in the file when a rig is added",
                    told.join(", ")
                )
            }
            Self::Unweighted { vertices } => {
                let lack = of_number(*vertices, "vertex has no weight; it", "vertices have no weight; they");
                write!(f, "{lack} took those of the nearest vertex with weights")
            }
            Self::NotNormalised { vertices, sums: (low, high) } => {
                let vertices = of_number(*vertices, "vertex", "vertices");
                write!(f, "weights of {vertices} were normalised; they summed to {low:.4} up to {high:.4}")
            }
            Self::NegativeWeights { vertices } => {
                write!(f, "negative weights of {} were set to 0", of_number(*vertices, "vertex", "vertices"))
            }
            Self::DuplicateInfluences { vertices } => {
                write!(
                    f,
                    "duplicate joints in {}: their weights were added",
                    of_number(*vertices, "vertex", "vertices")
                )
            }
            Self::ClipsLeftOut { clips } => write!(f, "animations were left out: {}", Some3(clips)),
            Self::ClipsCut { clips, frames } => {
                write!(f, "animations were cut after {frames} frames: {}", Some3(clips))
            }
            Self::Vrm { part, dropped } => {
                write!(f, "what is broken in the VRM {part} was left out: {}", Some3(dropped))
            }
            Self::Far { steps } => write!(
                f,
                "it stands so far from the origin that its places are rounded to {steps} along its largest side: move it to the \
                 origin in the program that it comes from"
            ),
            Self::TurnedUp => f.write_str("the file has z up; it was turned so that y is up"),
            Self::JointsOutside { outside, joints } => write!(
                f,
                "{outside} of {joints} joints lie outside the mesh's box by more than a tenth of it; \
                 skeleton and mesh may be misaligned"
            ),
            Self::FarWeights { ratio } => write!(
                f,
                "vertices lie {ratio:.1} times as far from the bone of their largest weight as from the nearest; \
                 the weights may be those of other vertices"
            ),
            Self::UnusedJointIndex { vertices } => {
                let vertices = of_number(*vertices, "vertex", "vertices");
                write!(f, "joint indices out of range, but without weight, were ignored in {vertices}")
            }
        }
    }
}

/// A node of a file: its number there, from 0, and what it is called. Displays as "node 3 `Sword`".
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NodeName {
    /// Its number.
    pub number: usize,
    /// Its name; empty where it has none.
    pub name: String,
}

impl fmt::Display for NodeName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "node {}", self.number)?;
        // Names come from the file and may be of any length.
        let name: String = self.name.chars().take(40).map(|c| if c.is_control() { ' ' } else { c }).collect();
        let cut = if self.name.chars().count() > 40 { "..." } else { "" };
        if name.trim().is_empty() { Ok(()) } else { write!(f, " `{name}{cut}`") }
    }
}

/// What most published methods take as the most joints of a skeleton.
pub(crate) const MANY_JOINTS: usize = 256;

/// A share of a model's size that is worth telling.
const FEW: f64 = 0.03;

/// "a, b, c and 5 more".
struct Some3<'a>(&'a [String]);

impl fmt::Display for Some3<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let shown = self.0.len().min(3);
        for (i, name) in self.0[..shown].iter().enumerate() {
            if i > 0 {
                f.write_str(", ")?;
            }
            // Names come from the file and may be of any length.
            for c in name.chars().take(80) {
                write!(f, "{c}")?;
            }
        }
        match self.0.len() - shown {
            0 => Ok(()),
            more => write!(f, " and {more} more"),
        }
    }
}

fn quoted(names: &[String]) -> Vec<String> {
    names.iter().map(|name| format!("`{name}`")).collect()
}

/// So many of something.
pub(crate) fn of_number(n: usize, one: &str, many: &str) -> String {
    format!("{n} {}", if n == 1 { one } else { many })
}

/// A number to two digits.
pub(crate) fn rounded(x: f64) -> String {
    let digits = (1.0 - x.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{x:.digits$}")
}

fn told(nodes: &[NodeName]) -> Vec<String> {
    nodes.iter().map(NodeName::to_string).collect()
}

fn numbered(kind: &str, numbers: &[usize]) -> Vec<String> {
    numbers.iter().map(|n| format!("{kind} {n}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_is_told_as_one_and_none_not_at_all() {
        let degenerate = |collapsed, repeated| Warning::Degenerate { collapsed, repeated }.to_string();
        assert_eq!(
            degenerate(0, 4608),
            "degenerate triangles are ignored: 4608 repeated ones; they stay in the file when a rig is added"
        );
        assert!(degenerate(1, 1).contains(": 1 that names a vertex twice, 1 repeated one;"), "{}", degenerate(1, 1));
        let posed = |size, off| Warning::RestIsNotBind { skins: vec![0], size, off }.to_string();
        assert!(posed(1.0, 0.02).ends_with("(skin 0); the bind pose was used"));
        let far = "used, in which joints are up to 34 % of the model's size from where the file shows them";
        assert!(posed(1.0, 0.341).ends_with(far), "{}", posed(1.0, 0.341));
        let unweighted = |vertices| Warning::Unweighted { vertices }.to_string();
        assert!(unweighted(1).starts_with("1 vertex has no weight; it took"));
        assert!(unweighted(2).starts_with("2 vertices have no weight; they took"));
        let renamed = Warning::Renamed { joints: 1, first: (7, "a\n\x1b[2Jb".into(), "a__[2Jb".into()) }.to_string();
        assert_eq!(renamed, "the joint of node 7 had no unique name: `a  [2Jb` became `a__[2Jb`");
    }
}
