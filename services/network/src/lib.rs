//! Sessions with other machines over zenoh, and the telemetry that watchers read.
//!
//! | module        | contents                                                            |
//! |---------------|---------------------------------------------------------------------|
//! | [`threads`]   | the threads with which zenoh reads and writes its links, [`Client`] |
//! | `tls`         | [`guarded`]: a configuration of zenoh over TLS, with certificates   |
//! | `strangers`   | [`Breach`]: tests whether peers without a certificate are refused   |
//! | `quiet`       | a configuration of zenoh with explicit endpoints                    |
//! | [`telemetry`] | what anyone may watch                                               |
//! | [`requests`]  | what operators and planners request of a host                       |

mod quiet;
mod reason;
pub mod requests;
mod strangers;
pub mod telemetry;
pub mod threads;
mod tls;

pub(crate) use quiet::quiet;
pub use reason::first_line;
pub use strangers::{ATTEMPT_MILLIS, Breach, keeps_strangers_out};
pub use threads::Client;
pub use tls::{guarded, over_tls};
