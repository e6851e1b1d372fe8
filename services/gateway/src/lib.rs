//! What the robot does, shown to whoever wants to watch.
//!
//! | module         | what it holds                                                           |
//! |----------------|-------------------------------------------------------------------------|
//! | [`run`]        | the loop: newest messages of every topic → telemetry, and the live page |
//! | [`settings`]   | what a person may set: endpoints, robot, rates, the page                |
//! | [`addresses`]  | where those on the same machine find the endpoints and the page         |
//! | [`comparison`] | the same run without learning, which the page shows beside this one     |
//! | [`page`]       | the live page: what browsers are told, and how                          |
//! | `topic_relay`  | one topic on its way to the watchers, at its rate                       |
//!
//! Nobody waits for the gateway, and it takes nothing in: it reads as one who only looks on, and no word of a watcher reaches the graph.
//!
//! ```
//! use gateway::settings::Rates;
//! use std::time::Duration;
//!
//! let rates = Rates { state: 20.0, ..Rates::default() };
//! assert_eq!(Rates::interval(rates.state), Some(Duration::from_millis(50)));
//! assert_eq!(Rates::interval(0.0), None);
//! ```

pub mod addresses;
pub mod comparison;
pub mod page;
pub mod run;
pub mod settings;
mod topic_relay;
