//! Seeded augmentation of rigs.
