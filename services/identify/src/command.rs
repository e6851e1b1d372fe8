//! `coxswain identify`: logs → robot file and report.

use crate::drive::{self, DriveError};
use crate::fit;
use crate::judgement::{prediction_error, untold};
use crate::log::bag::Topics;
use crate::log::{AXIS_NAMES, Log, LogError, moved};
use crate::numbers::Known;
use crate::reached::reached;
use crate::report::Page;
use crate::response::Response;
use crate::robot_file;
use crate::sensors::sensors;
use crate::tuned::{recommendation, variant};
use clap::Args;
use graph::assembly::robot_of;
use graph::options::pace;
use process::{Pace, atomic_file};
use robot::Robot;
use settings::SettingsError;
use std::path::{Path, PathBuf};
use std::time::Instant;
use std::{fs, io};
use terminal::Terminal;

/// Logs, or a graph to drive, and where the results go.
#[derive(Debug, Clone, Args)]
pub struct IdentifyOptions {
    /// Records, run directories, tables (.csv), or ROS 2 bags of one robot.
    #[arg(value_name = "LOG", required_unless_present = "drive", conflicts_with = "drive")]
    pub logs: Vec<PathBuf>,
    /// What is read of ROS 2 bags.
    #[command(flatten)]
    pub topics: Topics,
    /// Drive the robot or simulator of this graph file first: steps and sines of velocity within a
    /// rectangle around the scenario's start pose. Look that the robot stands there, and that the
    /// rectangle is free.
    #[arg(
        long,
        value_name = "GRAPH",
        conflicts_with_all = ["odometry", "command", "wheel_joints"]
    )]
    pub drive: Option<PathBuf>,
    /// Robot file with wheels and limits; with --drive by default that of the graph.
    #[arg(long, value_name = "FILE", required_unless_present = "drive")]
    pub robot: Option<PathBuf>,
    /// Folder of the results, new or empty: robot.toml, tuned.toml, report.html, and the drive.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// Only write the files of the drive, and print how to launch them. A graph with hosts, or a
    /// driver in another language, is driven so.
    #[arg(long, requires = "drive", conflicts_with = "pace")]
    pub prepare: bool,
    /// Length and width of the free rectangle, as 3x2 (m).
    #[arg(long, value_name = "SIZE", default_value = "2x2", requires = "drive", value_parser = size)]
    pub area: [f64; 2],
    /// Largest planar speed of the drive (m/s); by default 0.5, or less for a robot whose file
    /// allows less than 2 m/s².
    #[arg(long, value_name = "M/S", requires = "drive")]
    pub speed: Option<f64>,
    /// Largest yaw rate of the drive (rad/s).
    #[arg(long, value_name = "RAD/S", default_value_t = 1.0, requires = "drive")]
    pub yaw_rate: f64,
    /// Duration of the drive (s).
    #[arg(long, value_name = "SECONDS", default_value_t = 60.0, requires = "drive")]
    pub duration: f64,
    /// Seed of the drive.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "drive")]
    pub seed: u64,
    /// Pace of the drive: real-time, or lock-step for a simulator.
    #[arg(long, value_name = "PACE", requires = "drive", value_parser = pace)]
    pub pace: Option<Pace>,
    /// Change of the graph's scenario for the drive, as a line of TOML; may be given several times.
    #[arg(long = "set", value_name = "KEY=VALUE", requires = "drive")]
    pub changes: Vec<String>,
}

fn size(text: &str) -> Result<[f64; 2], String> {
    let sides = text.split_once('x').and_then(|(length, width)| {
        let side = |text: &str| text.parse().ok().filter(|side| (0.1..=1000.0).contains(side));
        Some([side(length)?, side(width)?])
    });
    sides.ok_or_else(|| "expected length and width in metres, such as 2x1.5".to_owned())
}

/// Why nothing was identified.
#[derive(Debug, thiserror::Error)]
pub enum IdentifyError {
    /// A file cannot be used.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// A log cannot be used.
    #[error(transparent)]
    Log(#[from] LogError),
    /// The drive cannot be prepared.
    #[error(transparent)]
    Drive(#[from] DriveError),
    /// The folder is not empty.
    #[error("{}: expected a new or empty folder", .0.display())]
    NotEmpty(PathBuf),
    /// An option is out of its range.
    #[error("--{option} {value}: expected {expected}")]
    Option {
        /// The option.
        option: &'static str,
        /// Its value.
        value: f64,
        /// The range.
        expected: &'static str,
    },
    /// Another number of wheels.
    #[error("--wheel-joints: {found} joints: expected {expected}, as the robot file has wheels")]
    WheelJoints {
        /// Number of joints.
        found: usize,
        /// Number of wheels of the robot.
        expected: usize,
    },
    /// The gate stopped the robot during the drive.
    #[error(
        "the gate stopped the robot during the drive ({}): drive slower (--speed), or \
         give more room (--area); the record is kept", .0.join("; ")
    )]
    Stopped(Vec<String>),
    /// The result is no robot.
    #[error(
        "the identified {key} is not possible ({found}): expected {expected}; is the sign of an \
         input or a velocity wrong?"
    )]
    Impossible {
        /// The key of the robot file.
        key: &'static str,
        /// The identified response.
        found: String,
        /// Expected values.
        expected: &'static str,
    },
    /// The velocity is far beyond the limits of the robot.
    #[error(
        "{axis}: the velocity is {velocity:.3} (rms), and the robot file allows inputs of {limit}: \
         expected m/s and rad/s"
    )]
    TooFast {
        /// Name of the axis.
        axis: &'static str,
        /// Measured velocity, rms.
        velocity: f64,
        /// Largest input of the robot file.
        limit: f64,
    },
    /// A result cannot be written.
    #[error("{} cannot be written: {source}", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: io::Error,
    },
}

impl IdentifyError {
    /// 1 if the system reports a write error or the drive failed, else 2.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Write { .. } | Self::Drive(DriveError::Write { .. }) | Self::Stopped(_) => 1,
            _ => 2,
        }
    }
}

/// What is to be driven, or what is known already.
#[derive(Debug)]
pub enum Plan {
    /// The logs, and the robot as its file states it.
    Logs(Vec<PathBuf>, Box<Robot>),
    /// A launch, the record that it leaves, and the robot.
    Drive(Box<drive::Drive>),
    /// How to launch the drive, and what to do then.
    Prepared(String),
}

impl IdentifyOptions {
    /// Reads the files that these options name, and writes those of a drive.
    ///
    /// # Errors
    /// [`IdentifyError`]; nothing was created then, unless the system reports a write error.
    pub fn plan(&self) -> Result<Plan, IdentifyError> {
        let ranges = [
            ("speed", self.speed.unwrap_or(drive::SPEED_MPS), 0.01, 10.0, "0.01 to 10 m/s"),
            ("yaw-rate", self.yaw_rate, 0.01, 10.0, "0.01 to 10 rad/s"),
            ("duration", self.duration, 15.0, 600.0, "15 to 600 s"),
        ];
        for (option, value, least, most, expected) in ranges {
            if !(least..=most).contains(&value) {
                return Err(IdentifyError::Option { option, value, expected });
            }
        }
        check_empty(&self.out)?;
        let Some(graph) = &self.drive else {
            let robot = self.robot.as_deref().map(robot_of).transpose()?;
            let robot = robot.unwrap_or_else(Robot::example);
            let (found, expected) = (self.topics.wheel_joints.len(), robot.wheels.count());
            if found > 0 && found != expected {
                return Err(IdentifyError::WheelJoints { found, expected });
            }
            return Ok(Plan::Logs(self.logs.clone(), Box::new(robot)));
        };
        let out = std::path::absolute(&self.out).unwrap_or_else(|_| self.out.clone());
        let drive = drive::prepare(graph, self, &out)?;
        if self.prepare {
            return Ok(Plan::Prepared(drive.instructions()));
        }
        Ok(Plan::Drive(Box::new(drive)))
    }
}

fn check_empty(folder: &Path) -> Result<(), IdentifyError> {
    let entries = fs::read_dir(folder).map(|mut entries| entries.next().is_some());
    if entries.unwrap_or(folder.exists()) {
        return Err(IdentifyError::NotEmpty(folder.to_owned()));
    }
    Ok(())
}

fn create(folder: &Path) -> Result<(), IdentifyError> {
    fs::create_dir_all(folder)
        .map_err(|source| IdentifyError::Write { path: folder.to_owned(), source })
}

/// Share of the data from which the response that is checked is estimated.
const USED: f64 = 0.75;

/// Identifies the robot of `logs`, whose file states `given`, and writes robot file and report into
/// `out`. Of bags, `topics` are read. Prints the parameters. A drive in which the gate stopped the
/// robot is not used.
///
/// # Errors
/// [`IdentifyError`]; no file was written then.
pub fn identify(
    logs: &[PathBuf],
    topics: &Topics,
    given: &Robot,
    out: &Path,
    is_drive: bool,
) -> Result<(), IdentifyError> {
    let log = Log::read(logs, topics)?;
    if log.is_stopped && is_drive {
        return Err(IdentifyError::Stopped(log.notes));
    }
    log.check()?;
    check_speed(&log, given)?;
    log.check_wheels(&given.wheels)?;
    let mut terminal = Terminal::new();
    for note in &log.notes {
        terminal.say(format_args!("identify: {note}"));
    }
    let wheels = &given.wheels;
    let axes = moved(&log);
    let mut progress = |what: &str| {
        terminal.progress(Instant::now(), || Some(format!("identify: {what}")));
    };
    let used = log.first(USED);
    progress("three quarters of the data");
    let first = fit::estimate(&used, wheels, axes, None, &mut progress);
    let estimate = fit::estimate(&log, wheels, axes, Some(&first.response), &mut progress);
    let stated = stated(given);
    let ahead = |response: &Response| {
        [1, 10].map(|steps| prediction_error(&log, USED, wheels, response, steps))
    };
    let errors = [("identified", ahead(&first.response)), ("robot file given", ahead(&stated))];
    let source = logs.iter().map(|path| path.display().to_string()).collect::<Vec<_>>().join(", ");
    let beside = fit::beside(&log, wheels, &estimate.response);
    let sensors = sensors(&log, wheels, &beside);
    let reached = reached(log.period_s, &beside);
    let known = Known { estimate: &estimate, reached: &reached, sensors: &sensors, wheels };
    let untold = untold(&known);
    let robot = robot_file::robot(given, &estimate);
    let recommended = recommendation(&robot.response.unwrap_or_default(), axes);
    robot.check().map_err(|impossible| IdentifyError::Impossible {
        key: impossible.key,
        found: format!("{:?}", robot.response.unwrap_or_default()),
        expected: impossible.expected,
    })?;
    let page = Page {
        source: &source,
        log: &log,
        held_out_from: USED,
        known: &known,
        checked: &first.response,
        errors: &errors,
        untold: &untold,
        recommended: &recommended,
    };
    let robot_path = out.join("robot.toml");
    let text = robot_file::text(&robot, &known, &untold, (&log, &source), &recommended).map_err(
        |error| IdentifyError::Write { path: robot_path.clone(), source: io::Error::other(error) },
    )?;
    create(out)?;
    let write = |path: &Path, text: &str| {
        atomic_file::write(path, text.as_bytes())
            .map_err(|source| IdentifyError::Write { path: path.to_owned(), source })
    };
    let report = out.join("report.html");
    write(&report, &page.html())?;
    let tuned = out.join("tuned.toml");
    write(&tuned, &variant(&recommended, &source))?;
    write(&robot_path, &text)?;
    print(&known, &errors, &untold);
    terminal::print(format_args!(
        "recommended: period {} ms, horizon {} periods, weights of the profile {}",
        recommended.period_millis, recommended.horizon_steps, recommended.profile
    ));
    terminal::print(robot_path.display());
    terminal::print(tuned.display());
    terminal::print(report.display());
    Ok(())
}

/// Fails if the robot is far faster than its file allows: all numbers may have another unit.
///
/// # Errors
/// [`IdentifyError::TooFast`].
pub fn check_speed(log: &Log, given: &Robot) -> Result<(), IdentifyError> {
    let planar = given.limits.input_mps;
    let limits = [planar, planar, given.limits.yaw_input_radps];
    let velocity = log.speed();
    for axis in 0..3 {
        let (velocity, limit) = (velocity[axis], limits[axis]);
        if velocity > 3.0 * limit {
            return Err(IdentifyError::TooFast { axis: AXIS_NAMES[axis], velocity, limit });
        }
    }
    Ok(())
}

/// What the given robot file says, as a response.
fn stated(given: &Robot) -> Response {
    let stated = robot_file::stated(given);
    let mut response = Response {
        time_constant_s: stated.time_constant_s,
        dead_time_s: [stated.dead_time_s; 3],
        ..Response::default()
    };
    for (axis, gain) in stated.gain.into_iter().enumerate() {
        response.gain[axis][axis] = gain;
    }
    response
}

fn print(known: &Known<'_>, errors: &[(&str, [[f64; 3]; 2])], untold: &[String]) {
    for number in known.response().iter().chain(&known.others()) {
        terminal::print(number);
    }
    for (name, [one, ten]) in errors {
        terminal::print(format_args!(
            "held out, {name}: 1 step {:.4} {:.4} {:.4}, 10 steps {:.4} {:.4} {:.4} \
             (rms; m/s, m/s, rad/s)",
            one[0], one[1], one[2], ten[0], ten[1], ten[2]
        ));
    }
    for line in untold {
        terminal::print(format_args!("not told: {line}"));
    }
}
