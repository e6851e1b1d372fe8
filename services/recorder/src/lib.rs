//! Every topic to an MCAP file, and the summary made from it.
//!
//! | module       | what it holds                                                           |
//! |--------------|-------------------------------------------------------------------------|
//! | [`run`]      | the loop: drains every topic, grants credit, ends the record            |
//! | [`settings`] | what a person may set                                                   |
//! | `store`      | where the record goes while the disk is full: nowhere, and is counted   |
//! | [`segment`]  | one MCAP file of the record, open for writing                           |
//! | [`rows`]     | what the summary needs, read back from the files                        |
//! | [`summary`]  | rows → the figures of `summary.json`                                    |
//! | `grant`      | how far the plant's clock may run ahead of the record, in lock step     |
//! | `intake`     | a reader for each topic                                                 |
//! | [`visual`]   | states and plans → what public viewers draw                             |
//!
//! ```
//! use recorder::{rows::Rows, segment, summary::Summary};
//!
//! // What is in a folder can be summed up again at any time; in an empty one nobody has arrived.
//! let folder = std::env::temp_dir().join("no such run");
//! let rows = Rows::read(&segment::paths(&folder))?;
//! let summary = Summary::of(&rows, 100_000_000);
//! assert_eq!((summary.arrival_s, summary.periods), (None, 0));
//! # Ok::<(), recorder::rows::ReadError>(())
//! ```

mod grant;
mod intake;
pub mod rows;
pub mod run;
pub mod segment;
pub mod settings;
mod store;
pub mod summary;
pub mod visual;
