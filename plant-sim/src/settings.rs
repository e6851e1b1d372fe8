//! Settings of the simulated plant.

use crate::obstacles::ObstacleSettings;
use crate::truth::Truth;
use driver::piped::Program;
use driver::{ScheduledList, Start};
use robot::{Map, Robot, Surroundings};
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};

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
    /// Known obstacles, zones and the border of the area.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<Map>,
    /// Obstacles of the world, if the robot has a sensor for them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub obstacles: Option<ObstacleSettings>,
    /// Lists of obstacles that a planner is taken to send at their times.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lists: Vec<ScheduledList>,
}

impl Settings {
    /// Settings of the driver, whose gate knows `surroundings`.
    pub fn driver<'a>(&'a self, surroundings: Option<&'a Surroundings>) -> driver::Settings<'a> {
        driver::Settings {
            run: &self.run,
            duration_s: self.duration_s,
            link_delay_millis: self.link_delay_millis,
            recorded: self.recorded,
            robot: &self.robot,
            armed: self.armed,
            surroundings,
            lists: &self.lists,
        }
    }

    /// Whether the robot has a sensor for obstacles. With lists of the scenario it has one that
    /// sees nothing: its list of each period tells the controller that no other one is missing.
    pub fn sees_obstacles(&self) -> bool {
        self.obstacles.is_some() || !self.lists.is_empty()
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
        self.driver(None).check()?;
        driver::surroundings(self.map.as_ref())?;
        self.start.check().map_err(|impossible| impossible.under("start"))?;
        self.truth
            .as_ref()
            .map_or(Ok(()), Truth::check)
            .map_err(|e| Impossible { key: format!("truth.{}", e.key), expected: e.expected })?;
        if let Some(obstacles) = &self.obstacles {
            obstacles.check().map_err(|impossible| impossible.under("obstacles"))?;
        }
        if self.truth.is_some() == self.program.is_some() {
            return Err(Impossible::new("truth", "either [truth] or [program]"));
        }
        Ok(())
    }
}
