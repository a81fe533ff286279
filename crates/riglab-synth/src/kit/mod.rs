//! What plans are built from: figures, legs, wings, heads, things worn.

pub(crate) mod human;
