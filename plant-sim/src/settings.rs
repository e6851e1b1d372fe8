//! What a person may set of the simulated plant.

use crate::truth::Truth;
use driver::Start;
use driver::piped::Program;
use robot::Robot;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};

/// Longest delay that a link may be known to have \[ms\].
pub const LINK_DELAY_MILLIS_MAX: u64 = 10_000;

/// Everything the plant process is told.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// What the launcher tells every process.
    pub run: process::Run,
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Seed of noise and random forces.
    pub seed: u64,
    /// Delay that the link to the controller is known to have \[ms\].
    pub link_delay_millis: u64,
    /// Whether, in lock step, the clock waits for a recorder's credit.
    pub recorded: bool,
    /// Whether its gate starts armed; else the wheels stand until `coxswain arm`.
    #[serde(default = "armed")]
    pub armed: bool,
    /// Where and how it starts.
    pub start: Start,
    /// The robot as its gate knows it.
    pub robot: Robot,
    /// The robot as it is, and its world, if that is our own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<Truth>,
    /// The program that is the world, if it is another one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<Program>,
}

impl Settings {
    /// What its driver is told.
    pub fn driver(&self) -> driver::Settings<'_> {
        driver::Settings {
            run: &self.run,
            duration_s: self.duration_s,
            link_delay_millis: self.link_delay_millis,
            recorded: self.recorded,
            robot: &self.robot,
            armed: self.armed,
        }
    }
}

fn armed() -> bool {
    true
}

impl process::HasRun for Settings {
    fn run(&self) -> &process::Run {
        &self.run
    }
}

impl Check for Settings {
    fn check(&self) -> Result<(), Impossible> {
        self.robot.check().map_err(|e| Impossible {
            key: format!("robot.{}", e.key),
            expected: e.expected.into(),
        })?;
        self.truth
            .as_ref()
            .map_or(Ok(()), Truth::check)
            .map_err(|e| Impossible { key: format!("truth.{}", e.key), expected: e.expected })?;
        for (key, values) in
            [("start.pose", self.start.pose), ("start.velocity", self.start.velocity)]
        {
            if !values.iter().all(|value| value.is_finite()) {
                return Err(Impossible::new(key, "three finite numbers"));
            }
        }
        if self.link_delay_millis > LINK_DELAY_MILLIS_MAX {
            return Err(Impossible::new(
                "link_delay_millis",
                format!("at most {LINK_DELAY_MILLIS_MAX} ms"),
            ));
        }
        if self.truth.is_some() == self.program.is_some() {
            return Err(Impossible::new("truth", "either [truth] or [program]"));
        }
        if !(self.duration_s.is_finite() && self.duration_s > 0.0) {
            return Err(Impossible {
                key: "duration_s".into(),
                expected: "a finite number of seconds greater than 0".into(),
            });
        }
        Ok(())
    }
}
