//! The part of the plant that is the same for every robot: state, gate and clock around a [`Base`]
//! that reads its sensors and moves.
//!
//! | module         | what it holds                                                             |
//! |----------------|---------------------------------------------------------------------------|
//! | [`base`]       | [`Base`]: implemented by the author of a real or a simulated robot        |
//! | [`gated`]      | one period: base, gate and the published messages                         |
//! | [`run()`]      | the clock: real time or lock step                                         |
//! | [`main`]       | a process around a base, which a launch starts                            |
//! | `settings`     | settings of every driver, and of such a process                           |
//! | `surroundings` | obstacles of the robot's sensors and of planners, for controller and gate |
//! | `planner`      | lists of obstacles: planner ▶ gate, over a socket                         |
//! | `planner_list` | such a list, in JSON or TOML                                              |
//! | `orders`       | arm, resume and stop: operator ▶ gate, by files in the run directory      |
//! | [`piped`]      | a base that is another program, driven over its standard input and output |

pub mod base;
pub mod gated;
mod orders;
pub mod piped;
mod planner;
mod planner_list;
mod program;
pub mod run;
mod settings;
mod surroundings;

pub use base::{Base, BaseError, Sensors, TrueState};
pub use planner_list::{ImpossiblePlannerList, Listed, PlannerList, ScheduledList};
pub use program::main;
pub use run::{RunError, run};
pub use settings::{LINK_DELAY_MILLIS_MAX, ProgramSettings, Settings, Start, surroundings};
