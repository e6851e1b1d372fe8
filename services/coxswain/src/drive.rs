//! `coxswain drive`: a body velocity for a time, or the keyboard.
//!
//! ```text
//!  key thread ─▶ loop ─▶ keys held by `teleop::dead_man` ─▶ request ─▶ controller
//!                                    x: latched stop ─▶ request ─▶ plant
//! ```
//! A request is a file on the machine of the launch, or with `--at` a query over the network.

mod keyboard;
mod steering;
mod way;

use crate::goal::{GoalError, GoalOptions, give};
use crate::joined::JoinError;
use crate::set::{Recipient, SetError, address};
use clap::Args;
use controller::goal::Demand;
use std::io;
use std::ops::RangeInclusive;
use std::path::Path;
use std::time::{Duration, Instant};
use steering::Steering;
use teleop::dead_man::{DeadMan, Speeds};
use teleop::steer::{Steer, SteerError};
use way::Way;

/// Dead-man time, if no other is given \[s\].
const DEAD_MAN_DEFAULT_S: f64 = 0.6;
/// Range of the dead-man time \[s\].
const DEAD_MAN_S: RangeInclusive<f64> = 0.2..=5.0;

/// A body velocity, or how to drive by keyboard.
#[derive(Debug, Clone, Args)]
pub struct DriveOptions {
    /// Velocity forward and to the left (m/s), and counter-clockwise (rad/s). Without it, the
    /// keyboard drives the robot.
    #[arg(num_args = 3, value_names = ["FORWARD", "LEFT", "RATE"], allow_negative_numbers = true)]
    pub velocity: Vec<f64>,
    /// Time for which the velocity is valid; then the robot brakes (s).
    #[arg(long = "for", value_name = "SECONDS", default_value_t = 1.0, requires = "velocity")]
    pub valid_s: f64,
    /// By keyboard: time for which a key acts; then the robot brakes. It must be longer than the
    /// time before the terminal repeats a held key (s).
    #[arg(
        long = "dead-man",
        value_name = "SECONDS",
        default_value_t = DEAD_MAN_DEFAULT_S,
        conflicts_with = "velocity",
        value_parser = dead_man_time
    )]
    pub dead_man_s: f64,
    /// Largest speed; by default, and at most, 70 % of that of the robot file. By keyboard: speed at
    /// the start, by default 0.3 (m/s).
    #[arg(long, value_name = "M/S")]
    pub speed: Option<f64>,
    /// Return when the controller has accepted the velocity, not when the robot stands.
    #[arg(long, requires = "velocity")]
    pub no_wait: bool,
    /// By keyboard with --at: host and port for the latched stop, if the plant runs on another host
    /// than the controller.
    #[arg(
        long,
        value_name = "HOST:PORT",
        requires = "at",
        conflicts_with = "velocity",
        value_parser = address
    )]
    pub stop_at: Option<String>,
    #[command(flatten)]
    to: Recipient,
}

/// Why the robot was not driven, or not any more.
#[derive(Debug, thiserror::Error)]
pub enum DriveError {
    /// The velocity was not driven to its end.
    #[error(transparent)]
    Goal(#[from] GoalError),
    /// The launch cannot be watched, or has ended.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// A request cannot be written.
    #[error(transparent)]
    Set(#[from] SetError),
    /// There are no keys.
    #[error(
        "the standard input is no terminal: expected one for the keys, or a velocity, as in \
         `coxswain drive 0.3 0 0`"
    )]
    NoTerminal,
    /// The keys have no speed.
    #[error("--speed {speed}: expected a finite number of m/s above 0")]
    Speed {
        /// The argument.
        speed: f64,
    },
    /// Reading from the terminal or changing its mode failed.
    #[error("the terminal cannot be used: {0}")]
    Terminal(#[source] io::Error),
}

impl DriveError {
    /// 2 if an argument is invalid or the controller rejects the velocity, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Goal(error) => error.exit_code(),
            Self::Join(error) => error.exit_code(),
            Self::Set(error) => error.exit_code(),
            Self::NoTerminal | Self::Speed { .. } => 2,
            Self::Terminal(_) => 1,
        }
    }
}

/// Joins the launch with the run directory `run`, to drive it by keyboard from another program. The
/// graphs of this machine are in `base`.
///
/// # Errors
/// [`DriveError`] if there is no such launch.
pub fn join(run: &Path, base: &Path) -> Result<Box<dyn Steer>, SteerError> {
    let dead_man = DeadMan::new(Duration::from_secs_f64(DEAD_MAN_DEFAULT_S), Speeds::default());
    let way = Way::on_this_machine(Some(run), base, Instant::now()).map_err(DriveError::from)?;
    Ok(Box::new(Steering::new(way, dead_man)))
}

/// `coxswain drive`, with the graphs of this machine in `base`.
///
/// # Errors
/// [`DriveError`].
pub fn run(options: &DriveOptions, base: &Path) -> Result<(), DriveError> {
    let &[forward, left, rate] = options.velocity.as_slice() else {
        return keyboard::run(options, base);
    };
    let (velocity, valid_s) = ([forward, left, rate], options.valid_s);
    let goal = GoalOptions {
        speed: options.speed,
        valid: None,
        no_wait: options.no_wait,
        to: options.to.clone(),
    };
    Ok(give(Demand::Velocity { velocity, valid_s }, &goal, base)?)
}

fn dead_man_time(text: &str) -> Result<f64, String> {
    let seconds = text.parse().ok().filter(|seconds| DEAD_MAN_S.contains(seconds));
    seconds.ok_or_else(|| {
        format!("expected a number of seconds from {} to {}", DEAD_MAN_S.start(), DEAD_MAN_S.end())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Arguments {
        #[command(flatten)]
        options: DriveOptions,
    }

    fn parsed(arguments: &[&str]) -> Option<DriveOptions> {
        let arguments = ["drive"].iter().chain(arguments);
        Arguments::try_parse_from(arguments).ok().map(|arguments| arguments.options)
    }

    #[test]
    fn a_velocity_has_three_numbers_or_the_keyboard_drives() {
        let velocity = |arguments: &[&str]| parsed(arguments).map(|options| options.velocity);
        assert_eq!(velocity(&[]), Some(Vec::new()));
        assert_eq!(velocity(&["-0.3", "0", "-1", "--for", "2"]), Some(vec![-0.3, 0.0, -1.0]));
        for wrong in [&["1"][..], &["1", "2"], &["1", "2", "3", "4"], &["1", "2", "north"]] {
            assert_eq!(velocity(wrong), None, "{wrong:?}");
        }
    }

    #[test]
    fn options_of_the_other_way_to_drive_are_refused() {
        assert_eq!(parsed(&["--dead-man", "1.5"]).map(|options| options.dead_man_s), Some(1.5));
        for wrong in [
            &["--for", "2"][..],
            &["--no-wait"],
            &["1", "0", "0", "--dead-man", "1"],
            &["--dead-man", "0"],
            &["--dead-man", "nan"],
            &["--dead-man", "60"],
            &["--stop-at", "10.0.0.1:7451"],
            &["--at", "10.0.0.1:7451"],
        ] {
            assert!(parsed(wrong).is_none(), "{wrong:?}");
        }
    }
}
