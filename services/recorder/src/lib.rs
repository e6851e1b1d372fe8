//! Every topic to an MCAP file, and its products: the summary, the report, tables.
//!
//! | module       | what it holds                                                           |
//! |--------------|-------------------------------------------------------------------------|
//! | [`run`]      | the loop: drains every topic, grants credit, ends the record            |
//! | [`settings`] | settings of the recorder process                                        |
//! | `store`      | destination of the record: a file, or counters while the disk is full   |
//! | `changes`    | changes of settings during the run → channel `set`                      |
//! | [`segment`]  | one MCAP file of the record, open for writing                           |
//! | [`reader`]   | MCAP files → messages                                                   |
//! | [`chunks`]   | chunks of a file that are damaged                                       |
//! | [`rows`]     | the data of the summary, read back from the files                       |
//! | [`summary`]  | rows → the figures of `summary.json`                                    |
//! | [`report`]   | records → one page with every figure                                    |
//! | [`export`]   | a record → one table (CSV) per topic                                    |
//! | `grant`      | in lock step, the lead of the plant's clock over the record             |
//! | `intake`     | a reader for each topic                                                 |
//! | [`visual`]   | states and plans → channels for public viewers                          |
//!
//! ```
//! use recorder::{rows::Rows, segment, summary::Summary};
//!
//! // The files in a folder can be summarised again at any time. Without files nothing has arrived.
//! let folder = std::env::temp_dir().join("no such run");
//! let rows = Rows::read(&segment::paths(&folder))?;
//! let summary = Summary::of(&rows, 100_000_000);
//! assert_eq!((summary.arrival_s, summary.periods), (None, 0));
//! # Ok::<(), recorder::rows::ReadError>(())
//! ```

mod changes;
pub mod chunks;
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
