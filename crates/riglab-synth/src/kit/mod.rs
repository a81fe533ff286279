//! What plans are built from: figures, beasts, limbs, heads, wings.
//!
//! Points are given for the left side; what has two sides takes a [`crate::body::Side`].

pub(crate) mod arthropod;
pub(crate) mod beast;
pub(crate) mod head;
pub(crate) mod human;
pub(crate) mod limbs;
pub(crate) mod parts;
pub(crate) mod wings;
