//! The part of libtorch that tch lacks.
