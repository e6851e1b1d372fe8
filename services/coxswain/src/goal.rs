//! `coxswain go`, `hold` and `follow`: a goal for the robot while it drives.
//!
//! The goal takes the same way as a change of settings ([`crate::set`]): a file in the run
//! directory, to which the controller replies beside it. Then the command shows how far the robot
//! is, until it stands at its goal.

use crate::joined::{JoinError, Joined};
use crate::set::{Recipient, SetError, set};
use clap::Args;
use controller::goal::{Demand, GoalRequest};
use motion::limits::Stated;
use motion::{Heading, Waypoint};
use process::requests::Outcome;
use protocol::message::{GateState, Goal, GoalPhase, Participant, PlantState};
use serde::Deserialize;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use terminal::Terminal;

/// Longest wait for a message before the launch is checked.
const PATIENCE: Duration = Duration::from_millis(100);

/// The run, and how to wait.
#[derive(Debug, Clone, Args)]
pub struct GoalOptions {
    /// Largest speed on the way (m/s); by default, and at most, 70 % of that of the robot file.
    #[arg(long, value_name = "M/S")]
    pub speed: Option<f64>,
    /// Reject the goal if it cannot begin within this time of now (s).
    #[arg(long, value_name = "S")]
    pub valid: Option<f64>,
    /// Return when the controller has accepted the goal, not when the robot stands there. With --at
    /// it always does.
    #[arg(long)]
    pub no_wait: bool,
    #[command(flatten)]
    pub(crate) to: Recipient,
}

/// A pose to go to.
#[derive(Debug, Clone, Args)]
pub struct GoOptions {
    /// x in the world (m).
    #[arg(allow_negative_numbers = true)]
    pub x: f64,
    /// y in the world (m).
    #[arg(allow_negative_numbers = true)]
    pub y: f64,
    /// Heading in the world: radians, or degrees as in 90deg.
    #[arg(allow_hyphen_values = true, value_parser = angle)]
    pub yaw: f64,
    #[command(flatten)]
    options: GoalOptions,
}

/// A path to follow.
#[derive(Debug, Clone, Args)]
pub struct FollowOptions {
    /// CSV file with the columns x_m,y_m, and perhaps yaw_rad and speed_mps; its first point near
    /// the robot.
    pub file: PathBuf,
    /// Heading on the way: keep, tangent, given (by the column yaw_rad), or an angle. By default
    /// given if the file has headings, else keep.
    #[arg(long, value_name = "HEADING", allow_hyphen_values = true, value_parser = heading)]
    pub heading: Option<Heading>,
    #[command(flatten)]
    options: GoalOptions,
}

/// Why a goal was not reached.
#[derive(Debug, thiserror::Error)]
pub enum GoalError {
    /// It was not accepted.
    #[error(transparent)]
    Set(#[from] SetError),
    /// The launch cannot be watched.
    #[error(transparent)]
    Join(#[from] JoinError),
    /// The file is no path.
    #[error(
        "{}: {source}; expected the columns x_m,y_m, and perhaps yaw_rad and speed_mps",
        file.display()
    )]
    File {
        /// The file.
        file: PathBuf,
        /// The cause.
        source: csv::Error,
    },
    /// The goal has ended before it was reached.
    #[error("goal {id} is {phase}")]
    Ended {
        /// Its number.
        id: u64,
        /// Its last phase.
        phase: GoalPhase,
    },
}

impl GoalError {
    /// 2 if an argument is invalid or the controller rejects the goal, else 1.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Set(error) => error.exit_code(),
            Self::Join(error) => error.exit_code(),
            Self::File { .. } => 2,
            Self::Ended { .. } => 1,
        }
    }
}

/// `coxswain go`.
///
/// # Errors
/// [`GoalError`].
pub fn go(options: &GoOptions, base: &Path) -> Result<(), GoalError> {
    let to = [options.x, options.y, options.yaw];
    give(Demand::Pose { to }, &options.options, base)
}

/// `coxswain hold`.
///
/// # Errors
/// [`GoalError`].
pub fn hold(options: &GoalOptions, base: &Path) -> Result<(), GoalError> {
    give(Demand::Hold {}, options, base)
}

/// `coxswain follow`.
///
/// # Errors
/// [`GoalError`].
pub fn follow(options: &FollowOptions, base: &Path) -> Result<(), GoalError> {
    let points = read(&options.file)
        .map_err(|source| GoalError::File { file: options.file.clone(), source })?;
    let has_yaw = points.iter().any(|point| point.yaw.is_some());
    let by_file = if has_yaw { Heading::Given } else { Heading::Keep };
    let heading = options.heading.unwrap_or(by_file);
    give(Demand::Path { points, heading }, &options.options, base)
}

/// Gives the goal to the controller, and shows how far the robot is until it stands there.
///
/// # Errors
/// [`GoalError`].
pub(crate) fn give(goal: Demand, options: &GoalOptions, base: &Path) -> Result<(), GoalError> {
    let limits = Stated { speed_mps: options.speed, ..Stated::default() };
    let request = GoalRequest { goal, limits, valid_s: options.valid };
    let kind = request.goal.kind();
    let tell = |id: u64, tick: u64| {
        terminal::print(format_args!("goal {id} ({kind}): accepted at tick {tick}"));
    };
    // Another machine's goal is followed with `coxswain watch`.
    if options.to.at.is_some() {
        let settled = options.to.send(base, Participant::Controller, &request.text())?;
        if let Outcome::Applied { acts_from_tick, .. } = settled.answer.outcome {
            tell(settled.number, acts_from_tick);
        }
        return Ok(());
    }
    let accepted = send(&request, options.to.run.as_deref(), base)?;
    let id = accepted.id;
    tell(id, accepted.from_tick);
    if options.no_wait {
        return Ok(());
    }
    let mut terminal = Terminal::new();
    let reached = accepted.until_reached(|goal, state| {
        terminal.progress(Instant::now(), || Some(line(goal, state)));
    })?;
    terminal.say(format_args!("goal {id}: reached at tick {}", reached.stamp.tick));
    Ok(())
}

/// Gives a goal to the controller of a launch on this machine, and waits until it is accepted. The
/// launch is that with the run directory `run`, or the only one that runs. `base` is the directory
/// of the running graphs, [`runs::registry::base`].
///
/// # Errors
/// [`GoalError`] if there is no such launch, or the controller rejects the goal.
pub fn send(request: &GoalRequest, run: Option<&Path>, base: &Path) -> Result<Accepted, GoalError> {
    let joined = Joined::new(run, base)?;
    // Its first messages are not missed.
    let (goals, states) = (joined.watcher()?, joined.watcher()?);
    let settled = set(Some(&joined.folder), base, Participant::Controller, &request.text())?;
    let from_tick = match settled.answer.outcome {
        Outcome::Applied { acts_from_tick, .. } => acts_from_tick,
        // `set` returns it as an error.
        Outcome::Refused { code, reason } => {
            return Err(SetError::Refused { role: Participant::Controller, code, reason }.into());
        }
    };
    Ok(Accepted { id: settled.number, from_tick, joined, goals, states })
}

/// A goal that the controller has accepted.
pub struct Accepted {
    /// Its number.
    pub id: u64,
    /// First tick at which the robot follows it.
    pub from_tick: u64,
    joined: Joined,
    goals: transport::Source<Goal>,
    states: transport::Source<PlantState>,
}

impl Accepted {
    /// Waits until the robot stands at the goal, and returns its last message. `on_the_way` is
    /// called with each message before, and the newest state of the robot.
    ///
    /// # Errors
    /// [`GoalError`] if the goal ends before it is reached, or the launch ends.
    pub fn until_reached(
        mut self,
        mut on_the_way: impl FnMut(&Goal, Option<&PlantState>),
    ) -> Result<Goal, GoalError> {
        let id = self.id;
        loop {
            self.goals.wait(PATIENCE).map_err(JoinError::from)?;
            self.joined.check()?;
            let state = self.states.latest().map_err(JoinError::from)?;
            let Some(goal) = self.goals.latest().map_err(JoinError::from)? else { continue };
            match goal.phase() {
                // A later goal has taken its place.
                _ if goal.id > id => {
                    return Err(GoalError::Ended { id, phase: GoalPhase::Preempted });
                }
                _ if goal.id < id => {}
                GoalPhase::Active => on_the_way(&goal, state.as_ref()),
                GoalPhase::Reached => return Ok(goal),
                phase => return Err(GoalError::Ended { id, phase }),
            }
        }
    }
}

/// How far the robot is.
fn line(goal: &Goal, state: Option<&PlantState>) -> String {
    let (percent, left_m, left_s) = (100.0 * goal.progress, goal.left_m, goal.left_s);
    let gate = state.map_or(GateState::Driving, PlantState::gate);
    let waits = match gate {
        GateState::Driving | GateState::Armed => String::new(),
        shut => format!("; waits: the gate is {shut}"),
    };
    format!("goal {}: {percent:.0} %, {left_m:.2} m and {left_s:.1} s left{waits}", goal.id)
}

/// A row of a path file.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    x_m: f64,
    y_m: f64,
    #[serde(default)]
    yaw_rad: Option<f64>,
    #[serde(default)]
    speed_mps: Option<f64>,
}

fn read(file: &Path) -> Result<Vec<Waypoint>, csv::Error> {
    let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_path(file)?;
    reader
        .deserialize()
        .map(|row| {
            row.map(|Row { x_m, y_m, yaw_rad: yaw, speed_mps }| Waypoint {
                position: [x_m, y_m],
                yaw,
                speed_mps,
            })
        })
        .collect()
}

/// An angle in radians, or in degrees as in `90deg`.
fn angle(text: &str) -> Result<f64, String> {
    let (number, unit) = match text.strip_suffix("deg") {
        Some(degrees) => (degrees, 1.0_f64.to_radians()),
        None => (text.strip_suffix("rad").unwrap_or(text), 1.0),
    };
    let value: Result<f64, _> = number.trim().parse();
    let value = value.ok().filter(|value| value.is_finite());
    value.map(|value| value * unit).ok_or_else(|| "expected an angle as in 1.57 or 90deg".into())
}

fn heading(text: &str) -> Result<Heading, String> {
    match text {
        "keep" => Ok(Heading::Keep),
        "tangent" => Ok(Heading::Tangent),
        "given" => Ok(Heading::Given),
        _ => angle(text)
            .map(Heading::FixedRad)
            .map_err(|_| "expected keep, tangent, given, or an angle as in 90deg".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;
    use std::fs;

    #[test]
    fn an_angle_is_in_radians_or_degrees() {
        assert_eq!(angle("1.5"), Ok(1.5));
        assert_eq!(angle("1.5rad"), Ok(1.5));
        assert_eq!(angle("90deg"), Ok(FRAC_PI_2));
        assert_eq!(angle("-90 deg"), Ok(-FRAC_PI_2));
        for wrong in ["", "deg", "north", "nan", "inf", "1e999"] {
            assert!(angle(wrong).is_err(), "{wrong}");
        }
        assert_eq!(heading("tangent"), Ok(Heading::Tangent));
        assert_eq!(heading("-90deg"), Ok(Heading::FixedRad(-FRAC_PI_2)));
        assert!(heading("sideways").is_err());
    }

    #[test]
    fn a_path_file_has_positions_and_perhaps_headings_and_speeds()
    -> Result<(), Box<dyn std::error::Error>> {
        let folder = tempfile::tempdir()?;
        let file = folder.path().join("path.csv");
        fs::write(&file, "x_m,y_m\n0, 1\n2.5,-1\n")?;
        let points = read(&file)?;
        assert_eq!(points.len(), 2);
        assert_eq!(points[1], Waypoint::at([2.5, -1.0]));
        fs::write(&file, "x_m,y_m,speed_mps\n0,1,0.5\n2,1,\n")?;
        let speeds: Vec<_> = read(&file)?.into_iter().map(|point| point.speed_mps).collect();
        assert_eq!(speeds, [Some(0.5), None]);
        fs::write(&file, "x_m,y_m,yaw_rad\n0,1,3\n")?;
        assert_eq!(read(&file)?[0].yaw, Some(3.0));
        for wrong in ["x_m,y_m\n1\n", "x_m,y_m\n1,north\n", "x,y\n1,2\n"] {
            fs::write(&file, wrong)?;
            assert!(read(&file).is_err(), "{wrong}");
        }
        Ok(())
    }
}
