//! What a robot did: samples at a constant period, in stretches without a gap.
//!
//! | module   | contents                                                       |
//! |----------|----------------------------------------------------------------|
//! | `record` | a record of a run (MCAP)                                       |
//! | `table`  | a table (CSV)                                                  |
//! | [`bag`]  | a bag of ROS 2 (MCAP or sqlite3)                               |
//! | `check`  | which data cannot be used                                      |
//! | `error`  | why a log cannot be used                                       |

pub mod bag;
mod check;
mod error;
mod record;
mod table;

pub use error::LogError;

use bag::Topics;
use robot::{AXES, PerWheel, Velocity, Wheels};
use std::path::{Path, PathBuf};

/// Names of the velocity axes.
pub const AXIS_NAMES: [&str; AXES] = ["forward", "left", "yaw"];

/// The robot at one time, and its input until then.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sample {
    /// Time \[s\].
    pub time_s: f64,
    /// Measured x, y, yaw in the world \[m, m, rad\].
    pub pose: [f64; AXES],
    /// Measured velocity in the body \[m/s, m/s, rad/s\].
    pub velocity: Velocity,
    /// Mean input of the period that ends at this time \[m/s, m/s, rad/s\].
    pub input: Velocity,
    /// Measured wheel speeds, if there are any \[rad/s\].
    pub wheel_speed: Option<PerWheel>,
}

impl Sample {
    fn is_finite(&self) -> bool {
        let numbers = [&[self.time_s], &self.pose[..], &self.velocity, &self.input];
        numbers.into_iter().all(is_finite)
    }
}

fn is_finite(numbers: &[f64]) -> bool {
    numbers.iter().all(|number| number.is_finite())
}

/// Samples without a gap, at a constant period.
pub type Stretch = Vec<Sample>;

/// What a robot did.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Log {
    /// Period of the samples \[s\].
    pub period_s: f64,
    /// In the order of time.
    pub stretches: Vec<Stretch>,
    /// The files that they are from, each with its number of stretches.
    pub files: Vec<(PathBuf, usize)>,
    /// Number of wheels whose speeds are measured; 0 if none are.
    pub wheels: usize,
    /// What was left out, and where.
    pub notes: Vec<String>,
    /// Whether the gate stopped the robot.
    pub is_stopped: bool,
}

impl Log {
    /// Reads logs of one robot, each a record, a run directory, a table (`.csv`) or a bag of ROS 2,
    /// of which these `topics` are read.
    ///
    /// # Errors
    /// [`LogError`].
    pub fn read(paths: &[PathBuf], topics: &Topics) -> Result<Self, LogError> {
        let mut log = Self::default();
        for (number, path) in paths.iter().enumerate() {
            if paths[..number].contains(path) {
                return Err(LogError::Twice(path.clone()));
            }
            let is_table = path.extension().is_some_and(|extension| extension == "csv");
            let part = if is_table {
                table::read(path)
            } else if bag::is_bag(path) {
                bag::read(path, topics)
            } else {
                record::read(path)
            };
            log.append(path, part?)?;
        }
        Ok(log)
    }

    /// Fails unless an estimate can be made from it.
    ///
    /// # Errors
    /// [`LogError`].
    pub fn check(&self) -> Result<(), LogError> {
        check::check(self)
    }

    /// Fails unless the wheel speeds, if there are any, are those of `wheels`.
    ///
    /// # Errors
    /// [`LogError::WheelCount`], [`LogError::WheelUnit`].
    pub fn check_wheels(&self, wheels: &Wheels) -> Result<(), LogError> {
        check::check_wheels(self, wheels)
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.stretches.iter().map(Vec::len).sum()
    }

    /// Whether there is no sample.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Time of all stretches \[s\].
    pub fn duration_s(&self) -> f64 {
        self.len() as f64 * self.period_s
    }

    /// Measured velocity, rms \[m/s, m/s, rad/s\].
    pub fn speed(&self) -> Velocity {
        check::rms(&self.stretches, self.period_s, |_, sample| sample.velocity)
    }

    /// Each file with its stretches.
    fn by_file(&self) -> impl Iterator<Item = (&Path, &[Stretch])> {
        let mut rest = &self.stretches[..];
        self.files.iter().map(move |(path, count)| {
            let (of_file, others) = rest.split_at((*count).min(rest.len()));
            rest = others;
            (path.as_path(), of_file)
        })
    }

    /// The first `share` of each stretch.
    #[must_use]
    pub fn first(&self, share: f64) -> Self {
        let mut first = self.clone();
        for stretch in &mut first.stretches {
            stretch.truncate((share * stretch.len() as f64) as usize);
        }
        first
    }

    fn append(&mut self, path: &Path, part: Self) -> Result<(), LogError> {
        let differs = (part.period_s - self.period_s).abs() > 1e-3 * part.period_s;
        if !self.stretches.is_empty() && differs {
            return Err(LogError::Period {
                path: path.to_owned(),
                found: format!("{:.4} s", part.period_s),
                expected: format!("{:.4} s, as in the first log", self.period_s),
            });
        }
        let (found, expected) = (part.wheels, self.wheels);
        if found > 0 && expected > 0 && found != expected {
            let source_of = "as in the logs before";
            return Err(LogError::WheelCount { found, expected, source_of });
        }
        self.wheels = found.max(expected);
        self.period_s = part.period_s;
        self.files.push((path.to_owned(), part.stretches.len()));
        self.stretches.extend(part.stretches);
        self.notes.extend(part.notes);
        self.is_stopped |= part.is_stopped;
        Ok(())
    }
}

/// Axes on which the input moves the robot.
pub fn moved(log: &Log) -> [bool; AXES] {
    let input = check::rms(&log.stretches, log.period_s, |_, sample| sample.input);
    std::array::from_fn(|axis| input[axis] > check::STANDING[axis])
}

/// Median step of `times`, so that single gaps do not matter \[s\].
fn median_period(path: &Path, times: &[f64], of: &str) -> Result<f64, LogError> {
    let mut steps: Vec<f64> = times
        .windows(2)
        .map(|pair| pair[1] - pair[0])
        .filter(|step| *step > 0.0 && step.is_finite())
        .collect();
    steps.sort_by(f64::total_cmp);
    let median = steps.get(steps.len() / 2).copied().unwrap_or(0.0);
    if (1e-3..=1.0).contains(&median) {
        return Ok(median);
    }
    Err(LogError::Period {
        path: path.to_owned(),
        found: format!("{median} s (median step of {of})"),
        expected: "0.001 to 1 s".to_owned(),
    })
}

/// Rows → stretches. A row that is not finite and a gap each end a stretch.
struct Cutter {
    period_s: f64,
    name: String,
    done: Vec<Stretch>,
    open: Stretch,
    /// Time of the last row, also of one that was left out \[s\].
    last_s: f64,
    /// Number of wheels whose speeds are measured.
    wheels: usize,
    /// Rows without them.
    without_wheels: usize,
    notes: Vec<String>,
    is_stopped: bool,
}

impl Cutter {
    fn new(path: &Path, period_s: f64, wheels: usize) -> Self {
        let name = path.display().to_string();
        Self {
            period_s,
            name,
            done: Vec::new(),
            open: Vec::new(),
            last_s: f64::NEG_INFINITY,
            wheels,
            without_wheels: 0,
            notes: Vec::new(),
            is_stopped: false,
        }
    }

    fn note(&mut self, place: &str, what: &str) {
        self.notes.push(format!("{} {place}: {what}", self.name));
    }

    /// Ends the stretch. One that is too short to be used is left out.
    fn cut(&mut self) {
        let stretch = std::mem::take(&mut self.open);
        let time = stretch.len() as f64 * self.period_s;
        if time >= check::STRETCH_MIN_S {
            self.done.push(stretch);
        } else if let Some(first) = stretch.first() {
            let place = format!("from {:.2} s on", first.time_s);
            self.note(&place, &format!("only {time:.2} s without a gap, left out"));
        }
    }

    /// The clock begins anew.
    fn restart(&mut self) {
        self.cut();
        self.last_s = f64::NEG_INFINITY;
    }

    /// Adds a row from `place`.
    fn add(&mut self, place: &str, mut sample: Sample) -> Result<(), LogError> {
        if !sample.is_finite() {
            self.note(place, "a number that is not finite, left out");
            self.cut();
            return Ok(());
        }
        let step = sample.time_s - self.last_s;
        if step == 0.0 {
            self.note(place, "the time of the row before, left out");
            return Ok(());
        }
        if step < 0.0 {
            let place = format!("{} {place}", self.name);
            let (time_s, before_s) = (sample.time_s, self.last_s);
            return Err(LogError::Backwards { place, time_s, before_s });
        }
        self.last_s = sample.time_s;
        if let Some(last) = self.open.last() {
            let step = sample.time_s - last.time_s;
            // The heading may be wrapped in the log. Here it is continuous.
            let turn = sample.pose[2] - last.pose[2];
            sample.pose[2] = last.pose[2] + turn.sin().atan2(turn.cos());
            if (step / self.period_s - 1.0).abs() > 0.5 {
                self.note(place, &format!("{step:.3} s since the row before"));
                self.cut();
            }
        }
        let speeds = sample.wheel_speed.filter(|speeds| is_finite(speeds));
        sample.wheel_speed = speeds.filter(|_| self.wheels > 0);
        self.without_wheels += usize::from(sample.wheel_speed.is_none());
        self.open.push(sample);
        Ok(())
    }

    fn finish(mut self) -> Log {
        self.cut();
        if self.wheels > 0 && self.without_wheels > 0 {
            let without = format!("{} rows without speeds of the wheels", self.without_wheels);
            self.note("as a whole", &without);
        }
        let mut notes = self.notes;
        let more = notes.len().saturating_sub(NOTES_MAX);
        notes.truncate(NOTES_MAX);
        if more > 0 {
            notes.push(format!("{}: and {more} more", self.name));
        }
        let Self { period_s, done: stretches, wheels, is_stopped, .. } = self;
        Log { period_s, stretches, wheels, notes, is_stopped, ..Log::default() }
    }
}

/// Most notes of one log.
const NOTES_MAX: usize = 10;
