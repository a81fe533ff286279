//! Pictures of rigs, drawn on the CPU.
