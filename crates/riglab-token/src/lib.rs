//! Skeletons as tokens, and the grammar of what may follow (UniRig 3.1, SkinTokens 3.3).
//!
//! A sequence is `bos class joints… eos`. A joint that hangs on the one before it costs three
//! coordinate tokens; any other is a `branch` with the coordinates of its parent and its own. Skeletons
//! of known make (Mixamo, VRoid) begin with named parts, so a model learns which joint is the left hand; what
//! hangs where the template has it needs no branch.
//!
//! The one idea: **a sequence names joints by where they are.** That is what makes it learnable, and what
//! makes it ambiguous where two joints fall into one cell. [`Tokenizer::encode`] of the default preset
//! therefore moves a joint to the next free cell where its place would give another tree, so that every
//! skeleton comes back with its own topology; the released tokenizers do not ([`Preset`]).
//!
//! Holds: the strict [`Grammar`] accepts all that the tokenizer writes, and what it accepts decodes to one
//! tree within the limits. Leaves out: tensors, and where in space a skeleton should stand (normalise it
//! first, to the range of the [`Quantiser`]).

mod cells;
mod config;
mod decode;
mod encode;
mod error;
mod grammar;
mod mask;
mod order;
mod quantise;
mod rig;
mod tails;
mod template;
mod vocabulary;
mod walk;

pub use config::{Classes, Merge, Preset, Siblings, Spring, TokenizerConfig};
pub use decode::Decoded;
pub use encode::{Bones, Encoded, Tokenizer, naive_length};
pub use error::{DecodeFault, EncodeFault, GrammarFault};
pub use grammar::{Grammar, Limits, Parents};
pub use mask::Mask;
pub use order::extraction_order;
pub use quantise::{Quantiser, Rule};
pub use rig::{RigGrammar, SkeletonGrammar, SkinIds, SkinRule};
pub use template::{Part, Template};
pub use vocabulary::Vocabulary;
pub use walk::Walk;
