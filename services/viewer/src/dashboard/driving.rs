//! Keys → the robot, while the view drives it: `coxswain drive` inside of the view.
//!
//! Only the launch on this machine can be driven. Its goals are files, so nothing goes over the
//! network.

use ratatui::crossterm::event::KeyEvent;
use std::path::Path;
use std::time::Instant;
use teleop::keys::Key;
use teleop::steer::{Join, Steer, SteerError};

/// The robot that is driven, if there is one.
pub(super) struct Driving<'a> {
    join: &'a Join<'a>,
    steer: Option<Box<dyn Steer>>,
    /// The last news.
    told: Option<String>,
}

impl<'a> Driving<'a> {
    /// No robot is driven.
    pub(super) fn new(join: &'a Join<'a>) -> Self {
        Self { join, steer: None, told: None }
    }

    /// Whether keys drive the robot.
    pub(super) fn is_on(&self) -> bool {
        self.steer.is_some()
    }

    /// Begins to drive the launch with the run directory `run`, if it is on this machine.
    pub(super) fn begin(&mut self, run: Option<&Path>) {
        let Some(run) = run else {
            self.told = Some("cannot drive: this robot has no launch on this machine".to_owned());
            return;
        };
        match (self.join)(run) {
            Ok(steer) => (self.steer, self.told) = (Some(steer), None),
            Err(error) => self.told = Some(format!("cannot drive: {error}")),
        }
    }

    /// Takes a key that was pressed at `now`. Returns whether it was a key of driving.
    pub(super) fn press(&mut self, event: &KeyEvent, now: Instant) -> bool {
        let Some(steer) = &mut self.steer else {
            // The user has read it.
            self.told = None;
            return false;
        };
        let Some(key) = Key::of(event) else { return false };
        if key == Key::End {
            self.end();
        } else {
            let pressed = steer.press(key, now);
            self.take(pressed);
        }
        true
    }

    /// Gives the goal that is due at `now`.
    pub(super) fn step(&mut self, now: Instant) {
        if let Some(steer) = &mut self.steer {
            let stepped = steer.step(now);
            self.take(stepped);
        }
    }

    /// What to show of it at `now`.
    pub(super) fn line(&self, now: Instant) -> Option<String> {
        let Some(steer) = &self.steer else { return self.told.clone() };
        let told = self.told.as_ref().map_or_else(String::new, |told| format!("; {told}"));
        Some(format!("DRIVING, Esc ends: {}{told}", steer.line(now)))
    }

    /// Lets the robot stand, and drives it no more.
    pub(super) fn end(&mut self) {
        if let Some(steer) = self.steer.take() {
            self.told = steer.end().err().map(|error| error.to_string());
        }
    }

    fn take(&mut self, news: Result<Option<String>, SteerError>) {
        match news {
            Ok(news) => self.told = news.or(self.told.take()),
            Err(error) => (self.steer, self.told) = (None, Some(error.to_string())),
        }
    }
}
