//! One module a body plan.

pub(crate) mod anime;
pub(crate) mod biped;
pub(crate) mod fish;
pub(crate) mod quadruped;
