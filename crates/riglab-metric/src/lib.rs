//! Metrics under named conventions, and baselines without learning.
