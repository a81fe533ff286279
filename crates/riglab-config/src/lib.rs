//! Layered TOML configuration that knows where each value was written.
//!
//! An experiment is one TOML file that names building blocks and changes what it is about:
//!
//! ```toml
//! task = "fsq_cvae"
//! [model]
//! extends = "model/fsq_cvae/small.toml"   # this table starts from that file
//! width = 384
//! ```
//!
//! The one idea: **layers are merged as trees in which every key and value keeps its place**
//! ([`Origin`]: file, line and column, or the `--set` text), and the tree is turned into structs by
//! a deserialiser of our own, so that whatever is wrong is reported where it was written: unknown
//! keys with the nearest known one, wrong types, ranges, missing keys, and by [`Config::invalid`]
//! the faults only a task can see.
//!
//! The rules of layers:
//! - `extends = "a.toml"` or `["a.toml", "b.toml"]`, in any table: the content of those files, later
//!   over earlier, then the table's own keys over them. Names are looked up beside the file that
//!   says it, then in the search roots, then among the files built into the program.
//! - Tables merge key by key; scalars and arrays replace.
//! - A table that says `extends` is a choice of block: it replaces what lower layers had there
//!   instead of adding to it, so that nothing of the block chosen before leaks into the new one.
//!   `extends = []` starts from nothing.
//! - `--set a.b=c` comes last, in order.
//!
//! Holds: [`Config::to_toml`] loads back to an equal tree; merging is associative; no input panics.
//! Integers are taken from `i64::MIN` to `u64::MAX`, so a seed may be any 64 bits.
//! Leaves out: what keys mean, environment variables, dates, and unknown keys inside types that
//! serde reads through a buffer (`flatten`, `untagged`, internally tagged enums); use externally
//! tagged ones.
//!
//! ```
//! use riglab_config::{Config, Loader};
//!
//! #[derive(serde::Deserialize)]
//! struct Model { width: usize, heads: usize }
//!
//! let presets = [("model/small.toml", "width = 256\nheads = 4\n")];
//! let loader = Loader::new().built_in(&presets);
//! let text = "[model]\nextends = 'model/small.toml'\nwidth = 384\n";
//! let config = loader.parse("experiment.toml", text, &["model.heads=6"])?;
//! let model: Model = config.get_at("model")?;
//! assert_eq!((model.width, model.heads), (384, 6));
//! assert_eq!(config.origin("model.width").unwrap().to_string(), "experiment.toml:3:9");
//!
//! let error = Config::from_toml_str("a.toml", "widht = 3\nheads = 4\n")?.get::<Model>().err().unwrap();
//! assert!(error.to_string().contains("did you mean `width`?"));
//! # Ok::<(), riglab_config::ConfigError>(())
//! ```

mod bounds;
mod config;
mod de;
mod diff;
mod error;
mod key;
mod loader;
mod nearest;
mod origin;
mod parse;
mod set;
mod tree;
mod write;

pub use config::Config;
pub use diff::Difference;
pub use error::{ConfigError, Fault, FaultKind};
pub use loader::Loader;
pub use origin::Origin;
pub use write::Leaf;
