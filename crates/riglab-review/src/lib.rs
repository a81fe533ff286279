//! A local page of contact sheets on which a person accepts, rejects, re-categorises, marks faults of
//! skeletons and comments.
//!
//! [`Review::open`] takes a corpus, what `riglab curate` wrote beside it, and a file of decisions;
//! [`Server`] shows them to a browser on the same machine. The page itself is plain HTML, CSS and
//! JavaScript in `page/`, compiled in.
//!
//! The one idea: **the file of decisions is the state.** It is read anew before each decision and written
//! whole after it, before the page is told that it is saved; so a killed server, a reload, a second window or
//! an edit by hand loses nothing, and there is nothing to save at the end.
//!
//! Holds: the server listens on 127.0.0.1 alone; without the token of its address there is no answer but a
//! refusal, and neither for another host's name (a name that was rebound to this machine) nor for a request
//! of another site's page. What comes over the network is bounded in size, time and number. No path of a
//! request is ever a path of a file.
//!
//! Leaves out: accounts and encryption (it is for one person on one machine; over ssh, forward the port),
//! what decisions do to a corpus (`riglab-curate`).

mod deck;
mod error;
mod guard;
mod hold;
mod http;
mod ledger;
mod pictures;
mod review;
mod routes;
mod server;

pub use error::ReviewError;
pub use review::{Review, Tally};
pub use server::{Server, Stop};
