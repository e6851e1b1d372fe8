//! What every robot driver does, whatever the robot: the plant's part of the graph, around a
//! [`Base`] that reads its sensors and moves.
//!
//! | module    | what it holds                                                              |
//! |-----------|----------------------------------------------------------------------------|
//! | [`base`]  | [`Base`]: what a robot's author implements, for a real or a simulated robot |
//! | [`gated`] | one period: base, gate, what is published                                  |
//! | [`run()`] | the clock: real time or lock step                                          |
//! | `orders`  | arm and resume: a person ▶ the gate, by files in the folder of the run     |
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

/// What every driver is told.
#[derive(Debug, Clone)]
pub struct Settings<'a> {
    /// What the launcher tells every process.
    pub run: &'a Run,
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Delay that the link to the controller is known to have \[ms\].
    pub link_delay_millis: u64,
    /// Whether, in lock step, the clock waits for a recorder's credit.
    pub recorded: bool,
    /// The robot as its gate knows it.
    pub robot: &'a Robot,
    /// Whether the gate starts armed; else the wheels stand until a person arms it.
    pub armed: bool,
}

impl Settings<'_> {
    /// Length of the run in periods.
    pub fn ticks(&self) -> u64 {
        (self.duration_s * 1e9 / self.run.period_nanos as f64).round() as u64
    }
}

/// Where and how a simulated robot begins; finite numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Start {
    /// x, y and heading in the world \[m, m, rad\].
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
}
