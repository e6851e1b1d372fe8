//! messages of a run → its present state and its events, for everything that shows a run.
//!
//! | module    | what it holds                                     |
//! |-----------|---------------------------------------------------|
//! | `event`   | what happened, by type, and its text              |
//! | `process` | the last Health of a process, and what it changed |
//! | `run`     | the newest messages, and the last events          |
//!
//! The live page, the terminal view and the lines of `coxswain watch --plain` keep one [`RunView`]
//! each. Each of them adds only what it draws: rows, curves, and the choice of what is shown.

mod event;
mod process;
mod run;

pub use event::{Counter, Event, Sort, What};
pub use process::{Process, SILENCE};
pub use run::{EVENTS_MAX, RunView, SeenObstacles};
