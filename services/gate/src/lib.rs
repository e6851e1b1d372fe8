//! The last check before the wheels: it accepts a command, plays the stored trajectory, or brakes.
//!
//! The simulator and all robot drivers use it. No heap after start, no clock of its own (the caller
//! passes the time), no Gaussian process, no optimiser, no network.
//!
//! | module         | what it decides                                                     |
//! |----------------|---------------------------------------------------------------------|
//! | [`arbiter`]    | which fallback level acts: a pure function of flags and time        |
//! | [`accept`]     | whether one command may act                                         |
//! | [`machine`]    | disarmed, armed, driving, stopped: whether any command may act      |
//! | [`list`]       | lists of obstacles: messages to shapes and back                     |
//! | [`protective`] | how much of a twist lets the footprint stop before an obstacle      |
//! | `protection`   | obstacles, zones and the border of the area, as the gate knows them |
//! | [`Gate`]       | stores the accepted command and computes the input of the wheels    |
//!
//! ```text
//! age of the state that the last accepted command answered:
//! 0 ───────── T ───────── 2T ───────── 3T ─────────▶
//!   its input    tail[0]      tail[1]      brake
//! ```

//! ```
//! use gate::{Bounds, Gate};
//! use protocol::message::{Command, FallbackLevel, Reason};
//! use robot::Robot;
//!
//! const PERIOD_NANOS: u64 = 20_000_000;
//! let mut gate = Gate::new(Bounds::new(&Robot::example(), PERIOD_NANOS, 0), 1);
//! gate.begin_period(0, 0); // the state of tick 0 is published
//!
//! let mut command: Command = bytemuck::Zeroable::zeroed();
//! (command.plant_epoch, command.stamp.epoch, command.stamp.tick) = (1, 1, 0);
//! (command.fallback_level, command.input) = (FallbackLevel::FreshPlan.code(), [0.05, 0.0, 0.0]);
//! assert_eq!(gate.offer(&command, 1_000_000), Ok(())); // 1 ms after the state
//! assert_eq!(gate.decide(1_000_000).input, [0.05, 0.0, 0.0]);
//!
//! // No further command arrives: from 3 periods after the state on, the gate brakes.
//! gate.begin_period(3, 3 * PERIOD_NANOS);
//! let decision = gate.decide(3 * PERIOD_NANOS);
//! assert_eq!(decision.fallback_level, FallbackLevel::Brake);
//! command.input = [f64::NAN; 3];
//! assert_eq!(gate.offer(&command, 3 * PERIOD_NANOS), Err(Reason::NotFinite));
//! ```

pub mod accept;
pub mod arbiter;
mod bounds;
mod gate;
pub mod list;
pub mod machine;
mod protection;
pub mod protective;

pub use bounds::Bounds;
pub use gate::{Acting, Decision, Gate};
pub use machine::{Machine, Order, OrderError};
pub use protection::TooManyObstacles;
