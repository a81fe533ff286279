//! A rig with its name and where it came from.

use crate::{Clip, Rig};

/// A rig as a corpus keeps it.
#[derive(Clone, Debug, PartialEq)]
pub struct Asset {
    /// Identifies the asset in its corpus; usually the file's name.
    pub name: String,
    /// The rig.
    pub rig: Rig,
    /// Motions of it, where they were asked for; each has the rig's joints.
    pub clips: Vec<Clip>,
    /// Where it came from and what was done to it.
    pub provenance: Provenance,
}

/// Where an asset came from and what was done to it on the way in.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Provenance {
    /// Path or address of the source.
    pub source: String,
    /// Licence as an SPDX name where known, else as stated; empty when unknown.
    pub licence: String,
    /// Who is to be credited; empty when unknown.
    pub author: String,
    /// Kind of creature or object, as the source states it; empty when unknown.
    pub category: String,
    /// BLAKE3 of the source's bytes, in hexadecimal.
    pub checksum: String,
    /// What the importer repaired or wants known, one sentence each.
    pub notes: Vec<String>,
}
