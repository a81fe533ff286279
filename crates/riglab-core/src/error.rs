//! What can be wrong with the parts of a rig.

use thiserror::Error;

/// Why a skeleton, mesh, weights or rig cannot exist. The numbers say where.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum RigError {
    /// A skeleton needs a root.
    #[error("the skeleton has no joints")]
    NoJoints,
    /// Joint numbers are 16 bits wide.
    #[error("the skeleton has {0} joints, the limit is {limit}", limit = u16::MAX)]
    TooManyJoints(usize),
    /// The first joint is the root, and the only one.
    #[error("joint {joint} (`{name}`) has no parent, but joint 0 is the root already")]
    SecondRoot {
        /// Its index.
        joint: usize,
        /// Its name.
        name: String,
    },
    /// Joint 0 must be the root.
    #[error("joint 0 (`{0}`) has a parent; the root comes first")]
    RootNotFirst(String),
    /// Parents come before their children.
    #[error("joint {joint} (`{name}`) has parent {parent}, which does not come before it")]
    ParentAfterChild {
        /// Its index.
        joint: usize,
        /// Its name.
        name: String,
        /// The parent's index.
        parent: usize,
    },
    /// Names identify joints.
    #[error("joint {joint} has the name `{name}`, which is empty or taken")]
    BadName {
        /// Its index.
        joint: usize,
        /// The name.
        name: String,
    },
    /// NaN or infinity in a joint's position.
    #[error("joint {joint} (`{name}`) has a position that is not finite")]
    JointNotFinite {
        /// Its index.
        joint: usize,
        /// Its name.
        name: String,
    },
    /// A mesh needs a vertex.
    #[error("the mesh has no vertices")]
    NoVertices,
    /// A mesh needs a triangle.
    #[error("the mesh has no triangles")]
    NoTriangles,
    /// Vertex numbers are 32 bits wide.
    #[error("the mesh has {0} vertices, the limit is {limit}", limit = u32::MAX)]
    TooManyVertices(usize),
    /// NaN or infinity in a vertex.
    #[error("vertex {0} has a position that is not finite")]
    VertexNotFinite(usize),
    /// A triangle names a vertex that does not exist.
    #[error("triangle {triangle} names vertex {vertex}, the mesh has {vertices}")]
    VertexOutOfRange {
        /// The triangle.
        triangle: usize,
        /// The vertex it names.
        vertex: u32,
        /// How many there are.
        vertices: usize,
    },
    /// Offsets of the sparse rows are not a partition.
    #[error("the weights' row offsets do not run from 0 to {0} without falling")]
    BadOffsets(usize),
    /// A row names a joint that does not exist.
    #[error("vertex {vertex} names joint {joint}, the skeleton has {joints}")]
    JointOutOfRange {
        /// The vertex.
        vertex: usize,
        /// The joint it names.
        joint: u16,
        /// How many there are.
        joints: usize,
    },
    /// Joints of a row rise strictly.
    #[error("vertex {vertex} names joint {joint} twice or out of order")]
    JointsNotRising {
        /// The vertex.
        vertex: usize,
        /// The joint.
        joint: u16,
    },
    /// Weights are positive and finite.
    #[error("vertex {vertex} has a weight of {weight}")]
    BadWeight {
        /// The vertex.
        vertex: usize,
        /// The weight.
        weight: f32,
    },
    /// Weights of a vertex sum to 1.
    #[error("the weights of vertex {vertex} sum to {sum}")]
    BadSum {
        /// The vertex.
        vertex: usize,
        /// Their sum.
        sum: f32,
    },
    /// One row of weights for each vertex.
    #[error("{rows} rows of weights for {vertices} vertices")]
    RowCount {
        /// Rows of weights.
        rows: usize,
        /// Vertices of the mesh.
        vertices: usize,
    },
    /// A pose has one rotation per joint.
    #[error("a pose of {pose} joints for a skeleton of {joints}")]
    PoseLength {
        /// Joints of the pose.
        pose: usize,
        /// Joints of the skeleton.
        joints: usize,
    },
    /// A human bone is a joint of the skeleton.
    #[error("the human bone {bone} is joint {joint}, the skeleton has {joints}")]
    HumanBoneOutOfRange {
        /// The bone.
        bone: crate::HumanBone,
        /// Its joint.
        joint: u16,
        /// How many there are.
        joints: usize,
    },
    /// Something about a spring.
    #[error("spring {spring} has {what}")]
    BadSpring {
        /// Its number.
        spring: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// Something about a collider.
    #[error("collider {collider} has {what}")]
    BadCollider {
        /// Its number.
        collider: usize,
        /// What is wrong.
        what: &'static str,
    },
    /// A group names colliders that exist, each once.
    #[error("collider group {0} names a collider that does not exist, or one twice")]
    BadColliderGroup(usize),
    /// A clip has whole frames, finite maps and a rate above 0.
    #[error("the clip `{name}` has {what}")]
    BadClip {
        /// Its name.
        name: String,
        /// What is wrong.
        what: &'static str,
    },
}
