//! Keys over time → goals.
//!
//! A terminal reports no release of a key. So each key gives a velocity that is valid for the
//! dead-man time, and a held key renews it by its repetition. The velocity of a goal ends at the
//! same time in the controller, so a dead terminal stops the robot too:
//!
//! ```text
//!  keys      w            w  w  w  w  w
//!  goals     ├───────────┤├──────┼──────┼────────┤ brakes
//!              dead-man time  renewed      dead-man time after the last key, at most
//! ```

use crate::keys::Direction;
use controller::goal::Demand;
use std::time::{Duration, Instant};

/// Share of the dead-man time after which a held key renews its goal.
const RENEW: f64 = 1.0 / 3.0;
/// One step of the speeds.
const STEP: f64 = 1.25;
/// Smallest and largest share of the speeds.
const SHARES: [f64; 2] = [0.1, 10.0];

/// Speeds of the keys.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Speeds {
    /// Along the ground \[m/s\].
    pub ground_mps: f64,
    /// Of the heading \[rad/s\].
    pub yaw_rate_radps: f64,
}

impl Default for Speeds {
    /// Slow enough for a first try.
    fn default() -> Self {
        Self { ground_mps: 0.3, yaw_rate_radps: 0.5 }
    }
}

/// A velocity of the body (forward, left, yaw) \[m/s, m/s, rad/s\], and when it ends.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Until {
    velocity: [f64; 3],
    end: Instant,
}

/// The pressed key, and the goal for it.
#[derive(Debug, Clone, PartialEq)]
pub struct DeadMan {
    time: Duration,
    speeds: Speeds,
    share: f64,
    /// Direction of the last key, and when it ends.
    pressed: Option<(Direction, Instant)>,
    /// The last goal.
    given: Option<Until>,
    /// Whether the robot shall stand.
    stand: bool,
}

impl DeadMan {
    /// No key is pressed. A velocity ends `time` after the last key.
    pub fn new(time: Duration, speeds: Speeds) -> Self {
        Self { time, speeds, share: 1.0, pressed: None, given: None, stand: false }
    }

    /// A key for `direction` was pressed at `now`, or repeated. The last key alone counts.
    pub fn drive(&mut self, direction: Direction, now: Instant) {
        self.pressed = Some((direction, now + self.time));
        self.stand = false;
    }

    /// The robot shall stand.
    pub fn stand(&mut self) {
        (self.pressed, self.stand) = (None, true);
    }

    /// The robot has been stopped in another way: no goal is valid any more.
    pub fn stopped(&mut self) {
        (self.pressed, self.given, self.stand) = (None, None, false);
    }

    /// Larger speeds.
    pub fn faster(&mut self) {
        self.share = (self.share * STEP).min(SHARES[1]);
    }

    /// Smaller speeds.
    pub fn slower(&mut self) {
        self.share = (self.share / STEP).max(SHARES[0]);
    }

    /// The speeds of the keys.
    pub fn speeds(&self) -> Speeds {
        Speeds {
            ground_mps: self.share * self.speeds.ground_mps,
            yaw_rate_radps: self.share * self.speeds.yaw_rate_radps,
        }
    }

    /// Velocity that the keys request at `now` (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub fn velocity(&self, now: Instant) -> [f64; 3] {
        self.wanted(now).map_or([0.0; 3], |wanted| wanted.velocity)
    }

    /// Whether the last goal still moves the robot at `now`.
    pub fn is_moving(&self, now: Instant) -> bool {
        self.given.is_some_and(|given| given.end > now)
    }

    /// The goal that is due at `now`, once. Call it only when the goal before has its reply: then
    /// no goal waits behind another.
    pub fn due(&mut self, now: Instant) -> Option<Demand> {
        if std::mem::take(&mut self.stand) {
            self.given = None;
            return Some(Demand::Hold {});
        }
        let wanted = self.wanted(now)?;
        let is_new = self.given.is_none_or(|given| {
            given.velocity != wanted.velocity
                || wanted.end.saturating_duration_since(given.end) >= self.time.mul_f64(RENEW)
        });
        if !is_new {
            return None;
        }
        self.given = Some(wanted);
        let valid_s = wanted.end.saturating_duration_since(now).as_secs_f64();
        Some(Demand::Velocity { velocity: wanted.velocity, valid_s })
    }

    fn wanted(&self, now: Instant) -> Option<Until> {
        let (direction, end) = self.pressed.filter(|(_, end)| *end > now)?;
        let Speeds { ground_mps, yaw_rate_radps } = self.speeds();
        let velocity = match direction {
            Direction::Forward => [ground_mps, 0.0, 0.0],
            Direction::Back => [-ground_mps, 0.0, 0.0],
            Direction::Left => [0.0, ground_mps, 0.0],
            Direction::Right => [0.0, -ground_mps, 0.0],
            Direction::TurnLeft => [0.0, 0.0, yaw_rate_radps],
            Direction::TurnRight => [0.0, 0.0, -yaw_rate_radps],
        };
        Some(Until { velocity, end })
    }
}

#[cfg(test)]
mod tests;
