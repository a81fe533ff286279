//! What several configs check.

/// A key and what is wrong with its value.
pub type Fault = (&'static str, String);

/// Refuses what is no probability.
pub(crate) fn probability(key: &'static str, p: f32) -> Result<(), Fault> {
    match (0.0..=1.0).contains(&p) {
        true => Ok(()),
        false => Err((key, format!("{key} = {p} is a probability: 0 to 1"))),
    }
}

/// Refuses what lies outside `low..=high`, and what is no number.
pub(crate) fn inside(key: &'static str, x: f32, low: f32, high: f32) -> Result<(), Fault> {
    match (low..=high).contains(&x) {
        true => Ok(()),
        false => Err((key, format!("{key} = {x} must lie in {low} to {high}"))),
    }
}

/// Refuses a range that falls or leaves `low..=high`.
pub(crate) fn range(key: &'static str, [a, b]: [f32; 2], low: f32, high: f32) -> Result<(), Fault> {
    match low <= a && a <= b && b <= high {
        true => Ok(()),
        false => Err((key, format!("{key} = [{a}, {b}] must rise within {low} to {high}"))),
    }
}

/// What becomes of colliders whose joint goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Colliders {
    /// The part of the body is gone, and they with it.
    Go,
    /// They move with the joint that takes over.
    Stay,
}
