//! Every topic to an MCAP file, and what is made from it: the summary, the report, tables.
//!
//! | module       | what it holds                                                           |
//! |--------------|-------------------------------------------------------------------------|
//! | [`run`]      | the loop: drains every topic, grants credit, ends the record            |
//! | [`settings`] | what a person may set                                                   |
//! | `store`      | where the record goes while the disk is full: nowhere, and is counted   |
//! | `changes`    | what a person has changed while the robot drove → channel `set`         |
//! | [`segment`]  | one MCAP file of the record, open for writing                           |
//! | [`reader`]   | MCAP files → messages                                                   |
//! | [`rows`]     | what the summary needs, read back from the files                        |
//! | [`summary`]  | rows → the figures of `summary.json`                                    |
//! | [`report`]   | records → one page with every figure                                    |
//! | [`export`]   | a record → one table (CSV) per topic                                    |
//! | `whole`      | bytes → a file that is there whole, or not at all                       |
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

mod changes;
pub mod export;
mod grant;
mod intake;
pub mod reader;
pub mod report;
pub mod rows;
pub mod run;
pub mod segment;
pub mod settings;
mod store;
pub mod summary;
pub mod visual;
mod whole;
