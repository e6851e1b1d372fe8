//! Carries messages between this host and others: shared memory on one side, zenoh on the other.
//!
//! One bridge runs on each host of a graph. It has one zenoh session for each other host, and one
//! thread for each topic that it sends. zenoh's thread writes what arrives into shared memory:
//!
//! ```text
//!  shared memory ─▶ outgoing ─▶ link ══ zenoh, TLS ══ link ─▶ incoming ─▶ shared memory
//! ```
//!
//! | module      | contents                                                                    |
//! |-------------|-----------------------------------------------------------------------------|
//! | [`settings`] | the hosts, their processes, and where they meet                            |
//! | `run`       | opens all parts, watches them, reports                                      |
//! | `link`      | the zenoh session with one other host                                       |
//! | `config`    | the configuration of that session                                           |
//! | `keys`      | the keys of messages                                                        |
//! | `piece`     | messages ↔ pieces with labels                                               |
//! | `outgoing`  | shared memory ▶ link, one topic                                             |
//! | `window`    | pieces that the other host has not acknowledged yet                         |
//! | `incoming`  | link ▶ shared memory, one topic                                             |
//! | `rate`      | the largest number of messages that is accepted per second                  |
//! | `requests`  | requests of operators and planners ▶ files in the run directory             |
//! | `hello`     | what two bridges tell each other about themselves                           |
//!
//! In real time the newest message wins and nothing waits for the network. In lock step nothing is
//! lost: a piece that is not acknowledged is sent again, and a full window stops the writer.

mod config;
mod hello;
mod incoming;
mod keys;
mod link;
mod outgoing;
mod piece;
mod rate;
mod requests;
mod run;
pub mod settings;
mod window;

pub use run::{BridgeError, run};
