//! Dead time: the time from a command to the first response of the robot.
//!
//! ```text
//! δ = (n + w) T,  0 ≤ w < 1        acting in period k:  w c_{k−n−1} + (1 − w) c_{k−n}
//! ```
//! c is the output of the gate to the wheels in each period.

use crate::Velocity;
use serde::{Deserialize, Serialize};

/// Longest dead time that is compensated \[periods\].
pub const DELAY_MAX: usize = 8;

/// δ in periods, from 0 to [`DELAY_MAX`].
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
pub struct Delay(f64);

impl Delay {
    /// The valid dead time nearest to `periods`.
    pub fn of_periods(periods: f64) -> Self {
        Self(periods.max(0.0).min(DELAY_MAX as f64))
    }

    /// δ/T.
    pub fn periods(self) -> f64 {
        self.0
    }

    /// n: number of periods that a new command cannot change any more.
    pub fn whole(self) -> usize {
        self.0 as usize
    }

    /// w: share of the previous command in the acting input.
    pub fn fraction(self) -> f64 {
        self.0.fract()
    }
}

/// The commands of the last periods. Does not allocate.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sent {
    /// Newest first: that of the period which has just ended.
    commands: [Velocity; DELAY_MAX + 2],
}

impl Sent {
    /// A history in which `input` was always sent.
    pub fn always(input: Velocity) -> Self {
        Self { commands: [input; DELAY_MAX + 2] }
    }

    /// Appends the `command` of one more period.
    pub fn push(&mut self, command: Velocity) {
        self.commands.rotate_right(1);
        self.commands[0] = command;
    }

    /// The command of the period that has just ended.
    pub fn last(&self) -> Velocity {
        self.commands[0]
    }

    /// Input that acted in the period that has just ended.
    pub fn acted(&self, delay: Delay) -> Velocity {
        self.mixed(delay.whole(), delay.fraction())
    }

    /// Input that will act in the period that begins `ahead` periods from now, for `ahead` < n. It
    /// consists of commands that are already sent.
    pub fn under_way(&self, delay: Delay, ahead: usize) -> Velocity {
        self.mixed(delay.whole().saturating_sub(ahead + 1), delay.fraction())
    }

    /// The command of `age` periods ago, and w of the one before it.
    fn mixed(&self, age: usize, delay_fraction: f64) -> Velocity {
        let (newer, older) = (&self.commands[age], &self.commands[age + 1]);
        std::array::from_fn(|axis| {
            delay_fraction * older[axis] + (1.0 - delay_fraction) * newer[axis]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn counted() -> Sent {
        let mut sent = Sent::default();
        for k in 1..=4 {
            sent.push([f64::from(k), 0.0, 0.0]);
        }
        sent
    }

    #[test]
    fn commands_under_way_act_in_the_order_in_which_they_were_sent() {
        let delay = Delay::of_periods(2.25);
        // Next period: c_{−2} and a quarter of the one before; then c_{−1}.
        let acting: Vec<f64> = (0..2).map(|ahead| counted().under_way(delay, ahead)[0]).collect();
        assert_eq!(acting, [0.75 * 3.0 + 0.25 * 2.0, 0.75 * 4.0 + 0.25 * 3.0]);
    }

    #[test]
    fn the_acting_input_is_the_command_of_one_dead_time_ago() {
        assert_eq!(counted().acted(Delay::default())[0], 4.0);
        assert_eq!(counted().acted(Delay::of_periods(2.25))[0], 0.75 * 2.0 + 0.25 * 1.0);
        // The longest dead time: no command was sent that long ago.
        assert_eq!(counted().acted(Delay::of_periods(1e9))[0], 0.0);
    }
}
