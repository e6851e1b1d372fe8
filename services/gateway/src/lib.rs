//! Shared memory → watchers: the robot's state over the network, and the live page.
//!
//! | module         | what it holds                                                           |
//! |----------------|-------------------------------------------------------------------------|
//! | [`run`]        | the loop: newest messages of every topic → telemetry, and the live page |
//! | [`settings`]   | settings of the gateway: endpoints, robot, rates, the page              |
//! | [`addresses`]  | addresses of the endpoints and the page, for this machine               |
//! | [`comparison`] | the same run without learning, which the page shows beside this one     |
//! | [`page`]       | the live page: its events, and their delivery to browsers               |
//! | `topic_relay`  | one topic on its way to the watchers, at its rate                       |
//!
//! No process waits for the gateway. It is a passive subscriber, and no message of a watcher
//! reaches the graph. One request acts: the stop button of the page, on the robot's own machine.
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
