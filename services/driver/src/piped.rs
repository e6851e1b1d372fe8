//! A base that is another program, driven over its standard input and output: a simulator, or a
//! robot in another language.
//!
//! One JSON object per line, in both directions. The program ends when its input ends.
//!
//! ```text
//! driver ─▶ {"settings": {…}, "start": {"pose": [x, y, yaw], "velocity": […]}, "seed": 1}
//!        ◀─ {"ready": {"wheels": 4}}      or  {"refused": {"key": "…", "expected": "…"}}
//! driver ─▶ {"drive": [forward, left, yaw], "nanos": 2000000}                 no reply
//! driver ─▶ {"read": true}
//!        ◀─ {"pose": […], "velocity": […], "wheel_speed": […], "current": […],
//!            "truth": {"pose": […], "velocity": […]}}
//! ```
//! `settings` belongs to the program; the driver does not read it. A robot that is not simulated
//! omits `truth`. A robot without these sensors omits `wheel_speed` and `current`. Two more keys
//! are optional: `input_delay_s`, the known dead time to the motors, and `estop`, true while the
//! robot's own emergency stop is pressed.
//!
//! Units, frames and the order of the wheels are those of [`Sensors`].

use crate::base::per_wheel;
use crate::{Base, BaseError, Sensors, Start, TrueState};
use robot::{PerWheel, Velocity};
use serde::{Deserialize, Serialize};
use std::io::{self, BufRead, BufReader, BufWriter, Write};
use std::path::PathBuf;
use std::process::{Child, ChildStdin, ChildStdout, Command, Stdio};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError};
use std::thread;
use std::time::{Duration, Instant};

/// Longest time until the program is ready. It includes an installation at the first start.
const READY_WITHIN: Duration = Duration::from_mins(10);
/// Longest time for a reply.
const ANSWER_WITHIN: Duration = Duration::from_mins(1);
/// Longest time until the program ends after the end of its input.
const END_WITHIN: Duration = Duration::from_secs(2);
/// Longest part of a reply in an error message \[characters\].
const TOLD_MAX: usize = 120;

/// The program of the base, and its settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Program {
    /// File of the program.
    pub program: PathBuf,
    /// Its own settings.
    #[serde(default)]
    pub settings: toml::Table,
}

/// The first line to the program.
#[derive(Serialize)]
struct First<'a> {
    settings: &'a toml::Table,
    start: Start,
    seed: u64,
}

/// A velocity for a time.
#[derive(Serialize)]
struct Drive {
    drive: Velocity,
    nanos: u64,
}

/// Reply of the program to the first line.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum FirstAnswer {
    Ready { wheels: usize },
    Refused { key: String, expected: String },
}

/// Measurements of the sensors.
#[derive(Deserialize)]
struct Reading {
    pose: [f64; 3],
    velocity: Velocity,
    wheel_speed: Option<Vec<f64>>,
    current: Option<Vec<f64>>,
    #[serde(default)]
    input_delay_s: f64,
    #[serde(default)]
    estop: bool,
    truth: Option<Truth>,
}

/// The true state.
#[derive(Deserialize)]
struct Truth {
    pose: [f64; 3],
    velocity: Velocity,
}

/// The running program.
pub struct PipedBase {
    name: String,
    child: Child,
    input: Option<BufWriter<ChildStdin>>,
    answers: Receiver<io::Result<String>>,
    wheels: usize,
    truth: Option<TrueState>,
}

impl PipedBase {
    /// Starts the program of a base with so many `wheels`, and waits until it is ready. `seed` is
    /// the seed of its noise.
    ///
    /// # Errors
    /// [`BaseError`] if it does not start, rejects its settings, or has another number of wheels.
    pub fn start(
        told: &Program,
        wheels: usize,
        start: Start,
        seed: u64,
    ) -> Result<Self, BaseError> {
        let name = told.program.display().to_string();
        let mut child = Command::new(&told.program)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .map_err(|source| BaseError::Start { program: name.clone(), source })?;
        let input = child.stdin.take().map(BufWriter::new);
        let answers = read_lines(child.stdout.take());
        let mut this = Self { name, child, input, answers, wheels, truth: None };
        this.say(&First { settings: &told.settings, start, seed })?;
        match this.answer(READY_WITHIN)? {
            FirstAnswer::Ready { wheels } if wheels == this.wheels => Ok(this),
            FirstAnswer::Ready { wheels } => Err(BaseError::Answer {
                program: this.name.clone(),
                line: format!("wheels = {wheels}"),
                reason: format!("expected {}, as in the robot file", this.wheels),
            }),
            FirstAnswer::Refused { key, expected } => Err(BaseError::Refused { key, expected }),
        }
    }

    fn say(&mut self, what: &impl Serialize) -> Result<(), BaseError> {
        let Some(input) = &mut self.input else { return Err(self.ended()) };
        let written = serde_json::to_writer(&mut *input, what)
            .map_err(io::Error::from)
            .and_then(|()| input.write_all(b"\n"));
        written.map_err(|_| self.ended())
    }

    fn answer<T: for<'de> Deserialize<'de>>(&mut self, within: Duration) -> Result<T, BaseError> {
        if let Some(input) = &mut self.input
            && input.flush().is_err()
        {
            return Err(self.ended());
        }
        match self.answers.recv_timeout(within) {
            Ok(Ok(line)) => serde_json::from_str(&line).map_err(|error| BaseError::Answer {
                program: self.name.clone(),
                line: line.chars().take(TOLD_MAX).collect(),
                reason: error.to_string(),
            }),
            Err(RecvTimeoutError::Timeout) => {
                let _ = self.child.kill();
                Err(BaseError::Silent { program: self.name.clone(), time: within })
            }
            Ok(Err(_)) | Err(RecvTimeoutError::Disconnected) => Err(self.ended()),
        }
    }

    /// The error of a program that does not read its input any more.
    fn ended(&mut self) -> BaseError {
        let reason = match self.wait() {
            Ok(status) => status.to_string(),
            Err(error) => error.to_string(),
        };
        BaseError::Ended { program: self.name.clone(), reason }
    }

    /// The values of a sensor that has one for each wheel.
    fn per_wheel(
        &self,
        key: &str,
        values: Option<Vec<f64>>,
    ) -> Result<Option<PerWheel>, BaseError> {
        match values {
            Some(values) if values.len() != self.wheels => Err(BaseError::Answer {
                program: self.name.clone(),
                line: format!("{key} = {values:?}"),
                reason: format!("expected {} numbers", self.wheels),
            }),
            values => Ok(values.map(|values| per_wheel(&values))),
        }
    }

    /// Waits for the end of the program, whose input has ended; kills it if that takes too long.
    fn wait(&mut self) -> io::Result<std::process::ExitStatus> {
        self.input = None;
        let begin = Instant::now();
        while begin.elapsed() < END_WITHIN {
            if let Some(status) = self.child.try_wait()? {
                return Ok(status);
            }
            thread::sleep(Duration::from_millis(5));
        }
        self.child.kill()?;
        self.child.wait()
    }
}

impl Drop for PipedBase {
    fn drop(&mut self) {
        let _ = self.wait();
    }
}

/// Lines of the program's output. A thread of its own reads them, so that a wait can time out.
fn read_lines(output: Option<ChildStdout>) -> Receiver<io::Result<String>> {
    let (sender, lines) = mpsc::sync_channel(1);
    thread::spawn(move || {
        for line in output.map(BufReader::new).into_iter().flat_map(BufRead::lines) {
            if sender.send(line).is_err() {
                return;
            }
        }
    });
    lines
}

impl Base for PipedBase {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        self.say(&serde_json::json!({ "read": true }))?;
        let reading: Reading = self.answer(ANSWER_WITHIN)?;
        self.truth = reading.truth.map(|truth| TrueState {
            pose: truth.pose,
            velocity: truth.velocity,
            ..TrueState::default()
        });
        Ok(Sensors {
            pose: reading.pose,
            velocity: reading.velocity,
            wheel_speed: self.per_wheel("wheel_speed", reading.wheel_speed)?,
            current: self.per_wheel("current", reading.current)?,
            input_delay_s: reading.input_delay_s,
            estop: reading.estop,
        })
    }

    fn drive(&mut self, velocity: Velocity, nanos: u64) -> Result<(), BaseError> {
        self.say(&Drive { drive: velocity, nanos })
    }

    fn truth(&self) -> Option<TrueState> {
        self.truth
    }
}
