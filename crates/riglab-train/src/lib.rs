//! The training loop: schedules, checkpoints, logs, exact resume.
