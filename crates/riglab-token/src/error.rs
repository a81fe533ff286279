//! What can be wrong with skeletons and sequences.

use thiserror::Error;

/// Why a skeleton has no sequence.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum EncodeFault {
    /// Nothing to write.
    #[error("the skeleton has no joint")]
    Empty,
    /// Arrays of several lengths.
    #[error("{joints} joints, {parents} parents and {names} names: give one of each for every joint, or no names")]
    Lengths {
        /// Joints.
        joints: usize,
        /// Parents.
        parents: usize,
        /// Names.
        names: usize,
    },
    /// Two roots, or a parent after its child.
    #[error("joint {joint} has no parent before it: the joints are no tree with parents first")]
    NotATree {
        /// Which joint.
        joint: usize,
    },
    /// The released order step needs unique names.
    #[error("two joints are named `{0}`, so the joints of a template cannot be told")]
    TwoOfOneName(String),
    /// A template whose joints hang on each other in another order.
    #[error("joint `{0}` of the template stands before its parent; the skeleton is not of this template")]
    TemplateOutOfOrder(String),
    /// More joints near one place than cells.
    #[error("no cell is free for joint {joint}: the joints are too close together for {bins} cells")]
    NoCell {
        /// Which joint.
        joint: usize,
        /// Cells of a coordinate.
        bins: u16,
    },
}

/// Why a sequence is no skeleton.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum DecodeFault {
    /// It begins with something else.
    #[error("the sequence does not begin with <bos>")]
    NoBos,
    /// It was cut off.
    #[error("the sequence does not end with <eos>: it was cut off")]
    NoEos,
    /// An id that cannot stand there.
    #[error("token {at} is {word} where {wanted} should be")]
    Unexpected {
        /// Which token.
        at: usize,
        /// What it is.
        word: String,
        /// What should be there.
        wanted: &'static str,
    },
    /// The sequence ends within a joint.
    #[error("the sequence ends within joint {0}")]
    Cut(usize),
    /// Too few joints.
    #[error("the sequence has {0} joints, too few for a skeleton")]
    TooFew(usize),
    /// A part without its joints.
    #[error("part `{part}` has {wanted} joints, but only {left} are left")]
    ShortPart {
        /// Which part.
        part: String,
        /// Joints of the template.
        wanted: usize,
        /// Joints of the sequence that have no name yet.
        left: usize,
    },
    /// A branch from nowhere.
    #[error("joint {0} branches off where no joint before it is")]
    NoParent(usize),
}

/// Why an id may not follow.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GrammarFault {
    /// It is not among those allowed.
    #[error("token {at} ({word}) may not follow")]
    Forbidden {
        /// Which token.
        at: usize,
        /// What it is.
        word: String,
    },
}
