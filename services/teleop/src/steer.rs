//! How a program drives a robot by keys, without knowing how goals get there.

use crate::keys::Key;
use std::error::Error;
use std::path::Path;
use std::time::Instant;

/// Why it failed, as a sentence.
pub type SteerError = Box<dyn Error>;

/// Gives what the keys request to one launch.
pub trait Steer {
    /// Applies a key that was pressed at `now`. Returns what is new for the user.
    ///
    /// # Errors
    /// [`SteerError`] if the launch cannot be driven any more.
    fn press(&mut self, key: Key, now: Instant) -> Result<Option<String>, SteerError>;

    /// Gives the goal that is due at `now`, and takes replies. Call it every few milliseconds.
    /// Returns what is new for the user.
    ///
    /// # Errors
    /// [`SteerError`] if the launch cannot be driven any more.
    fn step(&mut self, now: Instant) -> Result<Option<String>, SteerError>;

    /// The keys and the robot at `now`, in one line.
    fn line(&self, now: Instant) -> String;

    /// Lets the robot stand, if a key still moves it. Returns within about a second.
    ///
    /// # Errors
    /// [`SteerError`] if that cannot be requested.
    fn end(self: Box<Self>) -> Result<(), SteerError>;
}

/// Joins the launch with a run directory on this machine.
pub type Join<'a> = dyn Fn(&Path) -> Result<Box<dyn Steer>, SteerError> + 'a;
