//! Sweeps: many runs from one file, on one machine or by the tasks of a cluster.
//!
//! The one idea: **the runs' folders are the state.** A [`Plan`] lists all jobs before the first begins, each with
//! its resolved config; what a job has come to is read from its run folder ([`State`]) and from nothing else but the
//! list of failed attempts ([`retry`] has them count no more). So a sweep that was killed at any moment goes on by
//! looking again, and its table is the same.
//!
//! [`run`] keeps as many jobs running as processors and memory allow; one that fails is tried once more and never
//! stops the rest; one that outlived a killed sweep, training or evaluating, is left to end. [`run_one`] does one job alone, for whoever has
//! machines of his own for each. [`Results`] are the runs' own numbers, by seed,
//! with tables of mean and spread.
//!
//! Holds: every job has a row in the results, failed ones with the reason; jobs join others only where these would have
//! the same settings and find the same corpora now, and runs of different corpora, or beside networks of the same name with
//! other weights, or that were trained on what they are tested on, are named below their table. Only jobs that failed may get
//! other settings; what they left is kept apart.
//! Leaves out: what a run does. Whoever calls says how a job's config is made and which commands train and evaluate.

mod absent;
mod attempts;
mod companions;
mod comparable;
mod corpora;
mod error;
mod figures;
mod file;
mod plan;
mod pool;
mod results;
mod seeds;
mod settle;
mod state;
mod unit;
mod values;

pub use attempts::{Attempt, attempts, record, retry};
pub use error::SweepError;
pub use figures::may_be_called;
pub use file::{Arm, Better, FigureOf, MetricOf, SweepFile, name_tests};
pub use plan::{Job, Plan};
pub use pool::{Budget, Ended, Event, Stage, run, run_one};
pub use results::{Outcome, Results};
pub use settle::{Fit, REPLACED};
pub use state::{State, hold_evaluation, is_held, is_trained};
