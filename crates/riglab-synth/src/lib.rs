//! Procedural rigged creatures.
