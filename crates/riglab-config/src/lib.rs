//! Layered TOML configuration that knows where each value was written.
