//! The training loop that every task shares.
//!
//! A [`Task`] says what a batch is, what its loss is and how to validate; [`train`] does the rest:
//! optimizer steps, precision, schedules, checkpoints, logs, progress, interruption.
//!
//! The one idea: **seeds, not state.** A batch is a function of its number, and everything random in
//! a step is drawn from a stream keyed by the run's seed and the step. So a run that was killed and
//! resumed is the unbroken run, bit for bit, whatever the number of loader threads.
//!
//! Several processes can train together ([`riglab_ranks::Ranks`]): they share the batches of a step, so that the run is
//! the same on one, two, four or eight of them.
//!
//! Holds: `metrics.jsonl` has one line a step or validation and nothing that depends on the clock
//! (times stand in `perf.jsonl`); checkpoints are complete or absent; what was written before an
//! error stays.
//!
//! Leaves out: rigs, and what a loss means.

mod beside;
mod checkpoint;
mod config;
mod error;
mod estimate;
mod interrupt;
mod logs;
mod prefetch;
mod progress;
mod run;
mod schedule;
mod sound;
mod step;
mod task;
mod tensorboard;
mod together;
mod trainer;

pub use beside::sides;
pub use checkpoint::{Checkpoint, State, named_by, without_best};
pub use config::{OneCycleConfig, Precision, ScheduleConfig, ScheduleKind, StartConfig, TrainConfig};
pub use error::TrainError;
pub use estimate::{Estimate, estimate, product_speed};
pub use interrupt::Interrupt;
pub use prefetch::{Prefetch, Source};
pub use progress::{Progress, Spinner, plain, tell};
pub use run::{Extended, Resumed, Run, RunInfo, below, other_companions, same_companions};
pub use schedule::{beta1, factor, first_apart};
pub use sound::unsound;
pub use task::{At, Better, Loss, LossOf, Task, Validation};
pub use tensorboard::TensorBoard;
pub use trainer::{Ended, Outcome, train};
