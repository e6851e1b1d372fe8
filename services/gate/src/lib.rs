//! The last check before the wheels: a command is accepted, or the stored tail is played, or the robot brakes.
//!
//! Used by the simulator and by any robot driver. No heap after start, no clock of its own (the caller passes the time), no
//! Gaussian process, no optimiser, no network.
//!
//! | module      | what it decides                                                        |
//! |-------------|------------------------------------------------------------------------|
//! | [`arbiter`] | which fallback level acts: a pure function of flags and time                     |
//! | [`accept`]  | whether one command may act at all                                     |
//! | [`machine`] | disarmed, armed, driving, stopped: whether commands may act at all        |
//! | [`Gate`]    | remembers what was accepted and turns both into an input for the wheels |
//!
//! ```text
//! age of the state that the last accepted command answered:
//! 0 ───────── T ───────── 2T ───────── 3T ─────────▶
//!   its input    tail[0]      tail[1]      brake
//! ```

pub mod accept;
pub mod arbiter;
mod bounds;
mod gate;
pub mod machine;

pub use bounds::Bounds;
pub use gate::{Acting, Decision, Gate};
pub use machine::{Machine, Order, OrderError};
