//! Obstacles of the simulated world. They stand or move along lines, and the robot does not push
//! them: a judge compares the true places of both.

use driver::{Base, BaseError, Sensors, TrueState};
use protocol::message::OBSTACLES_MAX;
use robot::{ImpossibleShape, Obstacle, Point, Shape};
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};

/// Largest range of a sensor, and speed of an obstacle.
const LARGEST: f64 = 1e3;
/// Latest time at which one appears or turns round \[s\].
const TIME_MAX_S: f64 = 1e6;

/// The obstacles, and how the robot sees them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ObstacleSettings {
    /// Distance from the robot's centre up to which its sensor sees an obstacle \[m\].
    pub range_m: f64,
    /// The obstacles.
    pub list: Vec<Moving>,
    /// Discs that appear beside or on the robot.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub appearing: Vec<Appearing>,
}

impl Default for ObstacleSettings {
    fn default() -> Self {
        Self { range_m: 5.0, list: Vec::new(), appearing: Vec::new() }
    }
}

/// One obstacle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Moving {
    /// 1 to 8 corners at the start of the run: 1 is the centre of a disc \[m\].
    pub corners_m: Vec<Point>,
    /// Radius by which their hull is grown \[m\].
    #[serde(default)]
    pub radius_m: f64,
    /// Its velocity in the world \[m/s, m/s\].
    #[serde(default)]
    pub velocity_mps: Point,
    /// Time after which it turns round, each time \[s\]; by default it never does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub turns_after_s: Option<f64>,
}

/// A disc that appears at a place seen from the robot, and stands there for a time.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Appearing {
    /// Its centre when it appears: forward and left of the robot's centre \[m\].
    pub at_m: Point,
    /// Its radius \[m\].
    pub radius_m: f64,
    /// Begin \[s\].
    pub from_s: f64,
    /// End \[s\].
    pub until_s: f64,
}

/// An obstacle that does not exist.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImpossibleObstacle {
    /// Its shape.
    #[error("list[{0}]: {1}")]
    Shape(usize, ImpossibleShape),
    /// One of its numbers, or the range of the sensor.
    #[error("{key}: expected {expected}")]
    Value {
        /// The key.
        key: String,
        /// Values that it can have.
        expected: &'static str,
    },
}

impl ObstacleSettings {
    /// The obstacles, checked.
    ///
    /// # Errors
    /// [`ImpossibleObstacle`] names the first key that is wrong.
    pub fn crowd(&self) -> Result<Crowd, ImpossibleObstacle> {
        let impossible = |key: String, expected| Err(ImpossibleObstacle::Value { key, expected });
        if !(0.0..=LARGEST).contains(&self.range_m) {
            return impossible("range_m".into(), "0 to 1000 m");
        }
        let mut moving = Vec::with_capacity(self.list.len());
        for (index, one) in self.list.iter().enumerate() {
            let shape = Shape::hull(&one.corners_m, one.radius_m)
                .map_err(|error| ImpossibleObstacle::Shape(index, error))?;
            let key = |key| format!("list[{index}].{key}");
            if !one.velocity_mps.iter().all(|velocity| velocity.abs() <= LARGEST) {
                return impossible(key("velocity_mps"), "two numbers from -1000 to 1000 m/s");
            }
            if !one.turns_after_s.is_none_or(|time| (1e-3..=TIME_MAX_S).contains(&time)) {
                return impossible(key("turns_after_s"), "0.001 to 1000000 s");
            }
            moving.push((
                Obstacle { shape, velocity_mps: one.velocity_mps },
                one.turns_after_s.unwrap_or(f64::INFINITY),
            ));
        }
        let mut appearing = Vec::with_capacity(self.appearing.len());
        for (index, one) in self.appearing.iter().enumerate() {
            let key = |key| format!("appearing[{index}].{key}");
            if !one.at_m.iter().all(|place| place.abs() <= LARGEST) {
                return impossible(key("at_m"), "two numbers from -1000 to 1000 m");
            }
            if !(0.0..=LARGEST).contains(&one.radius_m) {
                return impossible(key("radius_m"), "0 to 1000 m");
            }
            if !(0.0..one.until_s.min(TIME_MAX_S)).contains(&one.from_s) {
                return impossible(key("from_s"), "a time that is not negative, before until_s");
            }
            appearing.push((*one, None));
        }
        Ok(Crowd { moving, appearing, range_m: self.range_m })
    }
}

impl Check for ObstacleSettings {
    fn check(&self) -> Result<(), Impossible> {
        if self.list.len() + self.appearing.len() > OBSTACLES_MAX {
            return Err(Impossible::new("list", format!("at most {OBSTACLES_MAX} obstacles")));
        }
        self.crowd().map(drop).map_err(|error| match error {
            ImpossibleObstacle::Shape(index, error) => {
                Impossible::new(format!("list[{index}]"), error.to_string())
            }
            ImpossibleObstacle::Value { key, expected } => Impossible::new(key, expected),
        })
    }
}

/// Checked obstacles.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Crowd {
    /// At the start, and the time after which it turns round \[s\].
    moving: Vec<(Obstacle, f64)>,
    /// With its place in the world, from its begin on.
    appearing: Vec<(Appearing, Option<Obstacle>)>,
    range_m: f64,
}

impl Crowd {
    /// Lets what is due at `seconds` after the start appear at a robot at `pose`.
    fn appear(&mut self, seconds: f64, pose: &[f64; 3]) {
        let (sin, cos) = pose[2].sin_cos();
        for (one, place) in &mut self.appearing {
            if place.is_none() && (one.from_s..one.until_s).contains(&seconds) {
                let [ahead, left] = one.at_m;
                let centre =
                    [pose[0] + cos * ahead - sin * left, pose[1] + sin * ahead + cos * left];
                *place = Shape::hull(&[centre], one.radius_m).map(Obstacle::standing).ok();
            }
        }
    }

    /// What has appeared and is there at `seconds` after the start.
    fn appeared(&self, seconds: f64) -> impl Iterator<Item = Obstacle> {
        let there = self.appearing.iter().filter(move |(one, _)| seconds < one.until_s);
        there.filter_map(|(_, place)| *place)
    }

    /// Every obstacle at `seconds` after the start \[s\].
    pub fn at(&self, seconds: f64) -> impl Iterator<Item = Obstacle> {
        self.moving.iter().map(move |(obstacle, turns_after)| {
            if turns_after.is_infinite() {
                return obstacle.after(seconds);
            }
            let (turns, rest) =
                (seconds.div_euclid(*turns_after), seconds.rem_euclid(*turns_after));
            let returns = turns.rem_euclid(2.0) > 0.5;
            let way = if returns { turns_after - rest } else { rest };
            let sign = if returns { -1.0 } else { 1.0 };
            let velocity_mps = obstacle.velocity_mps.map(|velocity| sign * velocity);
            Obstacle { velocity_mps, ..obstacle.after(way) }
        })
    }
}

/// A simulated base among obstacles.
#[derive(Debug)]
pub struct Among<B> {
    base: B,
    crowd: Crowd,
    /// Time since the start \[ns\].
    nanos: u64,
    /// The obstacles that the sensor sees now.
    seen: Vec<Obstacle>,
}

impl<B> Among<B> {
    /// `base` among `crowd`.
    pub fn new(base: B, crowd: Crowd) -> Self {
        let seen = Vec::with_capacity(crowd.moving.len() + crowd.appearing.len());
        Self { base, crowd, nanos: 0, seen }
    }
}

impl<B: Base> Base for Among<B> {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        let sensors = self.base.read()?;
        let pose = self.base.truth().map_or(sensors.pose, |truth| truth.pose);
        let centre = Shape::rectangle(0.0, 0.0).placed(&pose);
        self.seen.clear();
        let seconds = self.nanos as f64 * 1e-9;
        self.crowd.appear(seconds, &pose);
        let near = (self.crowd.at(seconds).chain(self.crowd.appeared(seconds)))
            .filter(|one| centre.separation(&one.shape).distance_m <= self.crowd.range_m);
        self.seen.extend(near);
        Ok(sensors)
    }

    fn drive(&mut self, velocity: [f64; 3], nanos: u64) -> Result<(), BaseError> {
        self.nanos += nanos;
        self.base.drive(velocity, nanos)
    }

    fn watchdog(&mut self, valid_nanos: u64) -> Result<(), BaseError> {
        self.base.watchdog(valid_nanos)
    }

    fn obstacles(&mut self) -> Option<&[Obstacle]> {
        Some(&self.seen)
    }

    fn truth(&self) -> Option<TrueState> {
        self.base.truth()
    }

    fn acting(&self) -> Option<[f64; 3]> {
        self.base.acting()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_obstacle_that_turns_round_comes_back_to_its_start() -> Result<(), ImpossibleObstacle> {
        let one = Moving {
            corners_m: vec![[1.0, 0.0]],
            radius_m: 0.2,
            velocity_mps: [0.5, 0.0],
            turns_after_s: Some(2.0),
        };
        let crowd = ObstacleSettings { list: vec![one], ..ObstacleSettings::default() }.crowd()?;
        let at = |seconds| -> Vec<(f64, f64)> {
            crowd.at(seconds).map(|o| (o.shape.corners()[0][0], o.velocity_mps[0])).collect()
        };
        assert_eq!(at(0.0), [(1.0, 0.5)]);
        assert_eq!(at(1.0), [(1.5, 0.5)]);
        assert_eq!(at(3.0), [(1.5, -0.5)]);
        assert_eq!(at(4.0), [(1.0, 0.5)]);
        Ok(())
    }

    #[test]
    fn an_obstacle_appears_where_the_robot_is_and_stands_there() -> Result<(), ImpossibleObstacle> {
        let one = Appearing { at_m: [1.0, 0.5], radius_m: 0.2, from_s: 2.0, until_s: 3.0 };
        let settings = ObstacleSettings { appearing: vec![one], ..ObstacleSettings::default() };
        let mut crowd = settings.crowd()?;
        let mut seen = |seconds, pose| -> Vec<Point> {
            crowd.appear(seconds, &pose);
            crowd.appeared(seconds).map(|o| o.shape.corners()[0]).collect()
        };
        assert!(seen(1.9, [0.0; 3]).is_empty());
        let there = seen(2.0, [4.0, 0.0, std::f64::consts::FRAC_PI_2]);
        assert!((there[0][0] - 3.5).abs() < 1e-9 && (there[0][1] - 1.0).abs() < 1e-9, "{there:?}");
        assert_eq!(seen(2.9, [9.0; 3]), there);
        assert!(seen(3.0, [4.0, 0.0, 0.0]).is_empty());
        let late = Appearing { from_s: 3.0, ..one };
        let settings = ObstacleSettings { appearing: vec![late], ..ObstacleSettings::default() };
        assert!(matches!(settings.crowd(), Err(ImpossibleObstacle::Value { .. })));
        Ok(())
    }

    #[test]
    fn impossible_obstacles_are_refused_by_key() {
        let one = Moving {
            corners_m: vec![[1.0, 0.0]],
            radius_m: 0.2,
            velocity_mps: [0.5, 0.0],
            turns_after_s: None,
        };
        let refused = |list: Vec<Moving>| {
            ObstacleSettings { list, ..ObstacleSettings::default() }.crowd().err()
        };
        let bad = Moving { corners_m: vec![], ..one.clone() };
        assert!(matches!(
            refused(vec![one.clone(), bad]),
            Some(ImpossibleObstacle::Shape(1, ImpossibleShape::Corners(0)))
        ));
        let bad = Moving { turns_after_s: Some(0.0), ..one };
        assert!(matches!(refused(vec![bad]), Some(ImpossibleObstacle::Value { .. })));
    }
}
