//! Why a log cannot be used.

use super::bag::BagError;
use super::table;
use recorder::reader::SourceError;
use std::path::PathBuf;

/// Why a log cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// A record cannot be read.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// A bag cannot be read.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// A message that no recorder writes.
    #[error("{}: message {number} of topic \"state\": {source}", path.display())]
    Message {
        /// The record.
        path: PathBuf,
        /// Number of the message within its topic, from 1.
        number: u64,
        /// The parse error.
        source: serde_json::Error,
    },
    /// A table cannot be read, or a row has the wrong columns.
    #[error("{}: {source}; expected the columns {}", path.display(), table::COLUMNS)]
    Table {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: csv::Error,
    },
    /// The clock runs backwards.
    #[error(
        "{place}: time_s = {time_s} after {before_s}: expected a clock that never runs backwards"
    )]
    Backwards {
        /// File and row.
        place: String,
        /// Time of the row \[s\].
        time_s: f64,
        /// Time of the row before \[s\].
        before_s: f64,
    },
    /// The period is unknown, or that of another log.
    #[error("{}: period {found}: expected {expected}", path.display())]
    Period {
        /// The file.
        path: PathBuf,
        /// The period.
        found: String,
        /// The expected one.
        expected: String,
    },
    /// Too little data.
    #[error("{usable_s:.1} s of data without a gap: expected at least {least_s} s{}", after(notes))]
    TooShort {
        /// Sum of all stretches that are long enough \[s\].
        usable_s: f64,
        /// The least \[s\].
        least_s: f64,
        /// What was left out.
        notes: Vec<String>,
    },
    /// The robot stood.
    #[error(
        "the robot does not move: its speed is {speed_mps:.4} m/s and {yaw_rate_radps:.4} rad/s \
         (rms); expected steps of the input on every axis, as `coxswain identify --drive` makes"
    )]
    NoMotion {
        /// Planar speed, rms \[m/s\].
        speed_mps: f64,
        /// Yaw rate, rms \[rad/s\].
        yaw_rate_radps: f64,
    },
    /// The input moves no axis.
    #[error(
        "the input moves no axis: expected steps of the input, as `coxswain identify --drive` makes"
    )]
    NoInput,
    /// A log was given twice.
    #[error("{}: expected each log once", .0.display())]
    Twice(PathBuf),
    /// Velocity and pose contradict each other.
    #[error(
        "{}: {axis}: the velocity is {factor:.3} times what the pose says (rms {velocity:.4} and \
         {from_pose:.4}): expected m, rad, m/s and rad/s, and the velocity in the body's frame",
        path.display()
    )]
    Unit {
        /// The file.
        path: PathBuf,
        /// Name of the axis.
        axis: &'static str,
        /// Ratio of the two.
        factor: f64,
        /// Measured velocity, rms.
        velocity: f64,
        /// Velocity that the poses give, rms.
        from_pose: f64,
    },
    /// The input has another unit.
    #[error(
        "{}: {axis}: the input is {factor:.3} times the velocity (rms {input:.4} and \
         {velocity:.4}): expected both in m/s, and in rad/s for yaw",
        path.display()
    )]
    InputUnit {
        /// The file.
        path: PathBuf,
        /// Name of the axis.
        axis: &'static str,
        /// Ratio of the two.
        factor: f64,
        /// Input, rms.
        input: f64,
        /// Measured velocity, rms.
        velocity: f64,
    },
    /// Another number of wheels.
    #[error("speeds of {found} wheels: expected {expected}, {source_of}")]
    WheelCount {
        /// Number of wheels in the log.
        found: usize,
        /// The expected one.
        expected: usize,
        /// What has the expected number.
        source_of: &'static str,
    },
    /// The wheel speeds have another unit, order or sign.
    #[error(
        "{}: {axis}: by the wheel speeds the velocity is {factor:.3} times the measured one (rms \
         {by_wheels:.4} and {velocity:.4}): expected rad/s, in the order and with the signs of the \
         robot file",
        path.display()
    )]
    WheelUnit {
        /// The file.
        path: PathBuf,
        /// Name of the axis.
        axis: &'static str,
        /// Ratio of the two.
        factor: f64,
        /// Velocity by the wheel speeds, rms.
        by_wheels: f64,
        /// Measured velocity, rms.
        velocity: f64,
    },
}

fn after(notes: &[String]) -> String {
    if notes.is_empty() { String::new() } else { format!(" ({})", notes.join("; ")) }
}
