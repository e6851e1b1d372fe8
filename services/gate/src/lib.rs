//! The last check before the wheels: it accepts a command, plays the stored trajectory, or brakes.
//!
//! The simulator and all robot drivers use it. No heap after start, no clock of its own (the caller
//! passes the time), no Gaussian process, no optimiser, no network.
//!
//! | module      | what it decides                                                        |
//! |-------------|------------------------------------------------------------------------|
//! | [`arbiter`] | which fallback_level acts: a pure function of flags and time                     |
//! | [`accept`]  | whether one command may act                                            |
//! | [`machine`] | disarmed, armed, driving, stopped: whether any command may act         |
//! | [`Gate`]    | stores the accepted command and computes the input of the wheels       |
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
