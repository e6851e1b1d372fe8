//! What every process of the graph does at its start and end.
//!
//! | module       | what it holds                                                                     |
//! |--------------|-----------------------------------------------------------------------------------|
//! | `run`        | [`Run`]: what the launcher tells every process, the table `[run]` of its settings |
//! | `start`      | [`main`]: arguments, settings, log, stop signals, body, exit code                 |
//! | `stop`       | [`Stop`]: the request to end, and who may make it                                 |
//! | `lifeline`   | [`Lifeline`]: the same heartbeat, told to the launcher alone                      |
//! | `pulse`      | [`Pulse`]: the heartbeat that goes out as `Health`                                |
//! | `owner`      | [`keep_to_user`]: nobody else reads what this process makes                       |
//! | [`atomic_file`] | files that a reader never sees in part                                        |
//! | `priority`   | [`go_first`]: what a command waits for runs before everything else                |
//! | `scheduling` | [`Scheduling`]: processors, locked memory and priority, as a person sets them     |
//! | `witness`    | [`Witness`]: when the machine let nobody run                                      |
//! | `seat`       | [`Seat`]: a thread held on its processor                                          |
//! | [`refusals`] | who and what is turned away at the network ▶ a few lines in the log               |
//! | [`requests`] | a person ▶ a running process: changes to its settings                             |

pub mod atomic_file;
mod lifeline;
mod owner;
mod priority;
mod pulse;
pub mod refusals;
pub mod requests;
mod run;
mod scheduling;
mod seat;
mod start;
mod stop;
mod witness;

pub use lifeline::Lifeline;
pub use owner::keep_to_user;
pub use priority::{PRIORITY, give_way, go_first, may_go_first, step_back};
pub use pulse::Pulse;
pub use run::{HasRun, Pace, Run};
pub use scheduling::{Scheduling, SchedulingError};
pub use seat::Seat;
pub use start::{main, read_settings};
pub use stop::Stop;
pub use witness::{Gap, Witness};
