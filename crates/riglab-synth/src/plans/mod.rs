//! One module a body plan.

pub(crate) mod anime;
pub(crate) mod biped;
pub(crate) mod bird;
pub(crate) mod dinosaur;
pub(crate) mod dragon;
pub(crate) mod fish;
pub(crate) mod fixture;
pub(crate) mod insect;
pub(crate) mod lizard;
pub(crate) mod machine;
pub(crate) mod monster;
pub(crate) mod prop;
pub(crate) mod quadruped;
pub(crate) mod snake;
pub(crate) mod spider;
