//! What a body plan describes: joints, the parts they hold, and pieces apart from the skin.
//!
//! A plan writes positions and cross-sections; how they become a surface and weights is none of
//! its business. Axes: y up, facing +z, the creature's left at +x. Units: metres.

use glam::Vec3;
use riglab_core::{HumanBone, Joint, JointId, Skeleton};

use crate::part::{Part, Profile, Ring};
use crate::piece::{Ball, Loft, Piece};
use crate::springs::{Bumper, Swinging};

/// One side of a creature that has two.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Side {
    Left,
    Right,
}

impl Side {
    pub const BOTH: [Self; 2] = [Self::Left, Self::Right];

    /// +1 on the left, -1 on the right: the sign of x.
    pub fn sign(self) -> f32 {
        match self {
            Self::Left => 1.0,
            Self::Right => -1.0,
        }
    }

    /// A vector given for the left side, on this side.
    pub fn of(self, v: Vec3) -> Vec3 {
        Vec3::new(self.sign() * v.x, v.y, v.z)
    }

    /// A human bone of this side, as VRM 1.0 names it.
    pub fn bone(self, part: &str) -> String {
        format!("{}{part}", self.word().to_lowercase())
    }

    /// "L" or "R", for names.
    pub fn letter(self) -> &'static str {
        &self.word()[..1]
    }

    /// "Left" or "Right", for names.
    pub fn word(self) -> &'static str {
        match self {
            Self::Left => "Left",
            Self::Right => "Right",
        }
    }
}

/// A point of a chain with the cross-section there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Node {
    pub at: Vec3,
    pub ring: Ring,
    /// Added to the half extents midway to the next node: a muscle, or a waist if negative.
    pub belly: f32,
}

impl Node {
    pub fn new(at: Vec3, ring: Ring) -> Self {
        Self { at, ring, belly: 0.0 }
    }

    pub fn round(at: Vec3, radius: f32) -> Self {
        Self::new(at, Ring::round(radius))
    }

    pub fn belly(self, belly: f32) -> Self {
        Self { belly, ..self }
    }
}

/// A creature before it has a surface.
#[derive(Clone, Debug, Default)]
pub(crate) struct Body {
    pub joints: Vec<Joint>,
    pub parts: Vec<Part>,
    pub pieces: Vec<Piece>,
    /// Whether each vertex of the skin follows one joint only, as on machines.
    pub rigid: bool,
    /// Joints whose flesh grows from that of another joint than their parent: a forearm from the
    /// twist joint of the upper arm, say.
    pub grown: Vec<(JointId, JointId)>,
    /// Joints whose weights reach further towards their parent than usual, and how many times as far.
    pub soft: Vec<(JointId, f32)>,
    /// Which joints are which human bones; empty for all but humanoid avatars.
    pub human: Vec<(HumanBone, JointId)>,
    /// Whether the skeleton has a joint on the ground, above the root, that holds nothing.
    pub rooted: bool,
    /// Chains that swing.
    pub swinging: Vec<Swinging>,
    /// Balls that stop them.
    pub bumpers: Vec<Bumper>,
}

impl Body {
    /// A body that is only a root joint.
    pub fn new(name: &str, at: Vec3) -> Self {
        Self { joints: vec![Joint { name: name.into(), parent: None, head: at.into() }], ..Self::default() }
    }

    /// The root.
    pub const ROOT: JointId = JointId(0);

    /// Adds a joint.
    pub fn joint(&mut self, parent: JointId, name: impl Into<String>, at: Vec3) -> JointId {
        self.joints.push(Joint { name: name.into(), parent: Some(parent), head: at.into() });
        JointId((self.joints.len() - 1) as u16)
    }

    /// Where a joint is.
    pub fn at(&self, joint: JointId) -> Vec3 {
        self.joints[joint.index()].head.into()
    }

    /// The joint of a name.
    pub fn named(&self, name: &str) -> Option<JointId> {
        self.joints.iter().position(|joint| joint.name == name).map(|k| JointId(k as u16))
    }

    /// Adds a chain of joints at all nodes but the last, which is the tip, and a limb along it whose
    /// outline is smooth from node to node. `hint` is the direction nearest to which the rings'
    /// side lies.
    ///
    /// `names` gives one name a joint.
    pub fn chain(
        &mut self,
        parent: JointId,
        names: impl IntoIterator<Item = String>,
        nodes: &[Node],
        hint: Vec3,
    ) -> Vec<JointId> {
        let chain = self.joints_along(parent, names, nodes);
        self.flesh(&chain, nodes, hint);
        chain
    }

    /// Adds the limb along joints that exist: one part from each node to the next.
    pub fn flesh(&mut self, chain: &[JointId], nodes: &[Node], hint: Vec3) {
        let sides = profiles(nodes, |ring| ring.side);
        let ups = profiles(nodes, |ring| ring.up);
        for (k, &joint) in chain.iter().enumerate() {
            let (a, b) = (nodes[k].at, nodes[k + 1].at);
            self.parts.push(Part::limb(joint.0, a, b, hint, sides[k], ups[k]));
        }
    }

    /// Adds a limb from a joint to a point.
    pub fn bone(&mut self, joint: JointId, to: Vec3, from_ring: Ring, to_ring: Ring, hint: Vec3) {
        let nodes = [Node::new(self.at(joint), from_ring), Node::new(to, to_ring)];
        self.flesh(&[joint], &nodes, hint);
    }

    /// Adds an ellipsoid to a joint: half extents to the side, up and along `axis`.
    pub fn mass(&mut self, joint: JointId, center: Vec3, axis: Vec3, radii: Vec3) {
        self.parts.push(Part::ellipsoid(joint.0, center, axis, Vec3::X, radii));
    }

    /// Adds a sphere apart from the skin, such as an eye.
    pub fn ball(&mut self, joint: JointId, center: Vec3, radius: f32) {
        self.pieces.push(Piece::Ball(Ball::new(joint.0, center, radius)));
    }

    /// Adds an ellipsoid apart from the skin: half extents to the side, up and along `axis`.
    pub fn oval(&mut self, joint: JointId, center: Vec3, axis: Vec3, radii: Vec3) {
        self.pieces.push(Piece::Ball(Ball::oval(joint.0, center, axis, radii)));
    }

    /// Adds a loft apart from the skin.
    pub fn loft(&mut self, loft: Loft) {
        self.pieces.push(Piece::Loft(loft));
    }

    /// Joints at all nodes but the last, each below the one before.
    fn joints_along(
        &mut self,
        parent: JointId,
        names: impl IntoIterator<Item = String>,
        nodes: &[Node],
    ) -> Vec<JointId> {
        let mut above = parent;
        let mut chain = Vec::with_capacity(nodes.len() - 1);
        for (name, node) in names.into_iter().zip(&nodes[..nodes.len() - 1]) {
            above = self.joint(above, name, node.at);
            chain.push(above);
        }
        assert_eq!(chain.len() + 1, nodes.len(), "one name a joint");
        chain
    }

    /// Adds joints at all nodes but the last, and a loft along them apart from the skin: a strand of
    /// hair, a tentacle, a thin leg.
    pub fn strand(
        &mut self,
        parent: JointId,
        names: impl IntoIterator<Item = String>,
        nodes: &[Node],
        hint: Vec3,
    ) -> Vec<JointId> {
        let chain = self.joints_along(parent, names, nodes);
        let points: Vec<_> =
            (nodes.iter().enumerate()).map(|(k, node)| (node.at, node.ring, chain[k.min(chain.len() - 1)].0)).collect();
        self.loft(Loft::through(&points, hint));
        chain
    }

    /// Everything `by` times as large, about the origin. Plans think in shares of a creature's size.
    pub fn scaled(mut self, by: f32) -> Self {
        self.joints.iter_mut().for_each(|joint| joint.head = joint.head.map(|x| by * x));
        self.parts.iter_mut().for_each(|part| part.scale(by));
        self.pieces.iter_mut().for_each(|piece| piece.scale_by(by));
        self.bumpers.iter_mut().for_each(|bumper| bumper.scale(by));
        self
    }

    /// The joints as a tree. Where the body is rooted their numbers are one higher than here.
    pub fn skeleton(&self) -> Skeleton {
        let ground = self.rooted.then(|| Joint { name: "root".into(), parent: None, head: [0.0; 3] });
        let below = self.rooted.then_some(JointId(0));
        let own = self.joints.iter().map(|joint| {
            let parent = joint.parent.map(|p| self.numbered(p)).or(below);
            Joint { parent, ..joint.clone() }
        });
        let joints = ground.into_iter().chain(own).collect();
        Skeleton::new(joints).expect("plans name their joints apart and add parents first")
    }

    /// The number of a joint in the skeleton.
    pub fn numbered(&self, joint: JointId) -> JointId {
        JointId(joint.0 + u16::from(self.rooted))
    }

    /// For each joint the joint its flesh grows from: the nearest above it that has parts, as weights
    /// and fillets pass over joints without flesh, unless [`Body::grown`] says otherwise.
    pub fn fleshy_parents(&self) -> Vec<Option<u16>> {
        let mut fleshy = vec![false; self.joints.len()];
        for part in &self.parts {
            fleshy[usize::from(part.joint)] = true;
        }
        let mut above: Vec<Option<u16>> = Vec::with_capacity(self.joints.len());
        for joint in &self.joints {
            let parent = joint.parent.map(|p| p.index());
            above.push(parent.and_then(|p| if fleshy[p] { Some(p as u16) } else { above[p] }));
        }
        for &(joint, from) in &self.grown {
            above[joint.index()] = Some(from.0);
        }
        above
    }
}

/// Profiles of one half extent along a chain, with slopes that agree where parts meet.
fn profiles(nodes: &[Node], extent: impl Fn(Ring) -> f32) -> Vec<Profile> {
    let rise: Vec<(f32, f32)> = nodes
        .windows(2)
        .map(|w| (extent(w[1].ring) - extent(w[0].ring), (w[1].at - w[0].at).length().max(1e-6)))
        .collect();
    // Slope per metre at inner nodes; 0 at both ends, where a cap takes over.
    let slope = |k: usize| {
        if k == 0 || k == rise.len() {
            return 0.0;
        }
        let ((r0, l0), (r1, l1)) = (rise[k - 1], rise[k]);
        if r0 * r1 <= 0.0 { 0.0 } else { (r0 + r1) / (l0 + l1) }
    };
    (0..rise.len())
        .map(|k| {
            let (r0, r1, length) = (extent(nodes[k].ring), extent(nodes[k + 1].ring), rise[k].1);
            Profile::new(r0, r1, slope(k) * length, slope(k + 1) * length, nodes[k].belly)
        })
        .collect()
}
