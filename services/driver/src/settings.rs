//! Settings of every driver, and of a process that is a driver.

use crate::ScheduledList;
use ::settings::{Check, Impossible};
use process::{HasRun, Run};
use robot::{ImpossibleMap, Map, Robot, Surroundings};
use serde::{Deserialize, Serialize};

/// Largest value of `link_delay_millis` \[ms\].
pub const LINK_DELAY_MILLIS_MAX: u64 = 10_000;

/// Settings of every driver.
#[derive(Debug, Clone)]
pub struct Settings<'a> {
    /// Settings that the launcher gives to every process.
    pub run: &'a Run,
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Known delay of the link to the controller \[ms\].
    pub link_delay_millis: u64,
    /// Whether, in lock step, the clock waits for the credit of a recorder.
    pub recorded: bool,
    /// The robot as its gate believes it to be.
    pub robot: &'a Robot,
    /// Whether the gate starts armed. Otherwise the wheels stand still until `coxswain arm`.
    pub armed: bool,
    /// Shapes of the map. With them, also empty ones, the gate slows the robot before obstacles.
    pub surroundings: Option<&'a Surroundings>,
    /// Lists of obstacles that a planner is taken to send at their times.
    pub lists: &'a [ScheduledList],
}

impl Settings<'_> {
    /// Length of the run in periods.
    pub fn ticks(&self) -> u64 {
        (self.duration_s * 1e9 / self.run.period_nanos as f64).round() as u64
    }
}

impl Check for Settings<'_> {
    fn check(&self) -> Result<(), Impossible> {
        self.robot.check().map_err(|e| Impossible::new(e.key, e.expected).under("robot"))?;
        if self.link_delay_millis > LINK_DELAY_MILLIS_MAX {
            let expected = format!("at most {LINK_DELAY_MILLIS_MAX} ms");
            return Err(Impossible::new("link_delay_millis", expected));
        }
        ScheduledList::check(self.lists)?;
        if !(self.duration_s.is_finite() && self.duration_s > 0.0) {
            let expected = "a finite number of seconds greater than 0";
            return Err(Impossible::new("duration_s", expected));
        }
        Ok(())
    }
}

/// Pose and velocity of a robot at its start; finite numbers.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Start {
    /// x, y and heading in the world \[m, m, rad\].
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
}

impl Check for Start {
    fn check(&self) -> Result<(), Impossible> {
        for (key, values) in [("pose", self.pose), ("velocity", self.velocity)] {
            if !values.iter().all(|value| value.is_finite()) {
                return Err(Impossible::new(key, "three finite numbers"));
            }
        }
        Ok(())
    }
}

/// Settings of a process that is a driver, as a launch writes them.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProgramSettings<S> {
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// Known delay of the link to the controller \[ms\].
    pub link_delay_millis: u64,
    /// Whether, in lock step, the clock waits for the credit of a recorder.
    pub recorded: bool,
    /// Whether the gate starts armed.
    pub armed: bool,
    /// Pose at which the scenario starts. A real robot stands there by definition.
    pub start: Start,
    /// Settings that the launcher gives to every process.
    pub run: Run,
    /// The robot as its gate believes it to be.
    pub robot: Robot,
    /// Known obstacles, zones and the border of the area.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<Map>,
    /// Lists of obstacles that a planner is taken to send at their times.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub lists: Vec<ScheduledList>,
    /// Settings of the base: `[driver.settings]` of the graph file.
    pub base: S,
}

impl<S> ProgramSettings<S> {
    /// The part that every driver has, with the shapes of the map.
    pub fn driver<'a>(&'a self, surroundings: Option<&'a Surroundings>) -> Settings<'a> {
        Settings {
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

    /// The shapes of the map; without one, there are none before the first list of obstacles.
    ///
    /// # Errors
    /// [`Impossible`] names the key of the map that is wrong.
    pub fn surroundings(&self) -> Result<Surroundings, Impossible> {
        surroundings(self.map.as_ref())
    }
}

/// The shapes of `map`; none without a map.
///
/// # Errors
/// [`Impossible`] names the key of the map that is wrong.
pub fn surroundings(map: Option<&Map>) -> Result<Surroundings, Impossible> {
    let shapes = map.map(Map::surroundings).transpose();
    let impossible = |error: ImpossibleMap| Impossible::new(error.key, error.expected).under("map");
    shapes.map(Option::unwrap_or_default).map_err(impossible)
}

impl<S> HasRun for ProgramSettings<S> {
    fn run(&self) -> &Run {
        &self.run
    }
}

impl<S: Check> Check for ProgramSettings<S> {
    fn check(&self) -> Result<(), Impossible> {
        self.surroundings()?;
        self.driver(None).check()?;
        self.start.check().map_err(|impossible| impossible.under("start"))?;
        self.base.check().map_err(|impossible| impossible.under("base"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::{Outline, Zone};

    #[test]
    fn a_wrong_map_is_refused_by_its_key() {
        let disc = |radius_m| Outline { corners_m: vec![[0.0; 2]], radius_m };
        let zone = Zone { corners_m: vec![[0.0; 2]], radius_m: 1.0, speed_mps: -1.0 };
        for (map, key) in [
            (Map { obstacles: vec![disc(1.0), disc(-1.0)], ..Map::default() }, "obstacles.1"),
            (Map { zones: vec![zone], ..Map::default() }, "zones.0.speed_mps"),
            (Map { fence_m: vec![[0.0; 2]], ..Map::default() }, "fence_m"),
        ] {
            let key = format!("map.{key}");
            assert_eq!(surroundings(Some(&map)).err().map(|error| error.key), Some(key));
        }
    }
}
