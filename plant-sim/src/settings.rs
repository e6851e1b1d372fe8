//! Settings of the simulated plant.

use crate::truth::Truth;
use driver::Start;
use driver::piped::Program;
use robot::Robot;
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};

/// Largest value of `link_delay_millis` \[ms\].
pub const LINK_DELAY_MILLIS_MAX: u64 = 10_000;

/// All settings of the plant process.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Settings that the launcher gives to every process.
    pub run: process::Run,
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Seed of noise and random forces.
    pub seed: u64,
    /// Known delay of the link to the controller \[ms\].
    pub link_delay_millis: u64,
    /// Whether, in lock step, the clock waits for the credit of a recorder.
    pub recorded: bool,
    /// Whether its gate starts armed. Otherwise the wheels stand still until `coxswain arm`.
    #[serde(default = "armed")]
    pub armed: bool,
    /// Pose and velocity at the start.
    pub start: Start,
    /// The robot as the gate believes it to be.
    pub robot: Robot,
    /// The true robot and its world, unless the world is another program.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub truth: Option<Truth>,
    /// The program that simulates the world, unless it is [`truth`](Self::truth).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub program: Option<Program>,
}

impl Settings {
    /// Settings of the driver.
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
