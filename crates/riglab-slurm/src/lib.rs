//! Jobs of a Slurm cluster.
//!
//! The one idea: **Slurm is asked, the work's own folder is believed.** A [`Script`] is the same few lines for
//! whatever is run; what a task has come to is read from the folder it works in, what is queued from `squeue`
//! ([`Queue`]), and all that is written down here is which jobs were submitted ([`Submission`]) and where each start of
//! a task stood ([`Task`]). So a controller that was restarted, a node that failed and a call made twice need no care.
//!
//! A task that is told to leave - before its time ends, by `--signal`, or because another job takes its place - saves,
//! and puts itself back into the queue; one that was begun several times at the same place is given up.
//!
//! Holds: every value that the cluster has a default for is left to it; nothing is started by words of a shell but
//! what `[slurm]` has in `prologue`.
//! Leaves out: what a task does, and accounting (`sacct`), which not every cluster has.
//!
//! Written for Slurm 20.11 and later; tested with 22.05.

mod cluster;
mod config;
mod error;
mod ledger;
mod script;
mod task;

pub use cluster::{Queue, Queued, array_size, queue, state, submit};
pub use config::SlurmConfig;
pub use error::SlurmError;
pub use ledger::{Submission, record, submissions};
pub use script::Script;
pub use task::{Start, Stuck, Task, attend, attend_steps, starts};
