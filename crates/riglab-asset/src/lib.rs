//! Rigged files in and out.
