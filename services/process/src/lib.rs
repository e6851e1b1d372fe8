//! Start, supervision and end of every process of the graph.
//!
//! | module       | contents                                                                      |
//! |--------------|-------------------------------------------------------------------------------|
//! | `run`        | [`Run`]: settings from the launcher for every process, the table `[run]`      |
//! | `start`      | [`main`]: arguments, settings, log, stop signals, body, exit code             |
//! | `stop`       | [`Stop`]: the stop request and its sources                                    |
//! | `lifeline`   | [`Lifeline`]: the heartbeat, sent only to the launcher                        |
//! | `pulse`      | [`Pulse`]: the heartbeat, published as `Health`                               |
//! | `owner`      | [`keep_to_user`]: new files are private to their user                         |
//! | [`atomic_file`] | files that a reader never sees in part                                     |
//! | `priority`   | [`go_first`]: real-time priority for the threads on the path of a command     |
//! | `scheduling` | [`Scheduling`]: settings of processors, locked memory and priority            |
//! | `witness`    | [`Witness`]: detects stalls of the machine                                    |
//! | `seat`       | [`Seat`]: pins a thread to its processor                                      |
//! | `repeated`   | [`Repeated`]: events without end ▶ a few lines in the log                     |
//! | [`requests`] | operator ▶ a running process: changes to its settings                         |
//! | [`lists`]    | planner ▶ plant: lists of obstacles                                           |

pub mod atomic_file;
mod lifeline;
pub mod lists;
mod owner;
mod priority;
mod pulse;
mod repeated;
pub mod requests;
mod run;
mod scheduling;
mod seat;
mod start;
mod stop;
mod witness;

pub use lifeline::Lifeline;
pub use owner::keep_to_user;
pub use priority::{PRIORITY, give_way, go_before_everything, go_first, may_go_first, step_back};
pub use pulse::Pulse;
pub use repeated::Repeated;
pub use run::{HasRun, Pace, Run};
pub use scheduling::{Scheduling, SchedulingError};
pub use seat::Seat;
pub use start::{log_filter, main, read_settings};
pub use stop::Stop;
pub use witness::{Gap, Witness};
