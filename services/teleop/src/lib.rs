//! Keyboard teleoperation: keys → velocity goals that end by themselves.
//!
//! | module       | what it does                                                     |
//! |--------------|------------------------------------------------------------------|
//! | [`keys`]     | a key event → what it requests; the list of keys                 |
//! | [`dead_man`] | keys over time → goals; without a key the robot brakes           |
//! | [`steer`]    | what a view needs to drive a robot                               |
//!
//! None reads a terminal or a clock, and none sends a goal: events and times are arguments.
//!
//! ```
//! use controller::goal::Demand;
//! use std::time::{Duration, Instant};
//! use teleop::dead_man::{DeadMan, Speeds};
//! use teleop::keys::Direction;
//!
//! let begin = Instant::now();
//! let mut dead_man = DeadMan::new(Duration::from_millis(600), Speeds::default());
//! dead_man.drive(Direction::Forward, begin);
//! let Some(Demand::Velocity { velocity, valid_s }) = dead_man.due(begin) else { panic!() };
//! assert_eq!((velocity, valid_s), ([0.3, 0.0, 0.0], 0.6));
//! assert_eq!(dead_man.velocity(begin + Duration::from_secs(1)), [0.0; 3]);
//! ```

pub mod dead_man;
pub mod keys;
pub mod steer;
