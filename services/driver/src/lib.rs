//! The part of the plant that is the same for every robot: state, gate and clock around a [`Base`]
//! that reads its sensors and moves.
//!
//! | module    | what it holds                                                              |
//! |-----------|----------------------------------------------------------------------------|
//! | [`base`]  | [`Base`]: implemented by the author of a real or a simulated robot         |
//! | [`gated`] | one period: base, gate and the published messages                          |
//! | [`run()`] | the clock: real time or lock step                                          |
//! | `orders`  | arm and resume: operator ▶ gate, by files in the run directory             |
//! | [`piped`] | a base that is another program, driven over its standard input and output  |

pub mod base;
pub mod gated;
mod orders;
pub mod piped;
pub mod run;

pub use base::{Base, BaseError, Sensors, TrueState};
pub use run::{RunError, run};

use process::Run;
use robot::Robot;
use serde::{Deserialize, Serialize};

/// Settings of every driver.
#[derive(Debug, Clone)]
pub struct Settings<'a> {
    /// Settings that the launcher gives to every process.
    pub run: &'a Run,
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Known delay of the link to the controller \[ms\].
    pub link_delay_millis: u64,
    /// Whether, in lock step, the clock waits for the credit of a recorder.
    pub recorded: bool,
    /// The robot as its gate believes it to be.
    pub robot: &'a Robot,
    /// Whether the gate starts armed. Otherwise the wheels stand still until `coxswain arm`.
    pub armed: bool,
}

impl Settings<'_> {
    /// Length of the run in periods.
    pub fn ticks(&self) -> u64 {
        (self.duration_s * 1e9 / self.run.period_nanos as f64).round() as u64
    }
}

/// Pose and velocity of a simulated robot at its start; finite numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Start {
    /// x, y and heading in the world \[m, m, rad\].
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
}
