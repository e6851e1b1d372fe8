//! What is known of the place before the robot drives: the content of a map file.

use crate::{Obstacle, Point, Shape};
use serde::{Deserialize, Serialize};

/// Most obstacles of a map, and most zones.
pub const MAP_MAX: usize = 1000;
/// Largest speed of a zone \[m/s\].
const LARGEST_MPS: f64 = 1e3;

/// Known obstacles, zones and the border of the area, in the world frame.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Map {
    /// Largest speed while the newest list of obstacles is too old \[m/s\].
    pub speed_without_obstacles_mps: f64,
    /// Corners of the area that the robot does not leave; its hull counts. None: no border \[m\].
    pub fence_m: Vec<Point>,
    /// Obstacles that stand.
    pub obstacles: Vec<Outline>,
    /// Areas with a speed limit.
    pub zones: Vec<Zone>,
}

/// The convex hull of corners, grown by a radius.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Outline {
    /// 1 to 8 corners: 1 is the centre of a disc \[m\].
    pub corners_m: Vec<Point>,
    /// Radius by which the hull is grown \[m\].
    #[serde(default)]
    pub radius_m: f64,
}

/// An area with a speed limit.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Zone {
    /// 1 to 8 corners \[m\].
    pub corners_m: Vec<Point>,
    /// Radius by which the hull is grown \[m\].
    #[serde(default)]
    pub radius_m: f64,
    /// Largest speed of a robot that touches the area \[m/s\].
    pub speed_mps: f64,
}

/// A map that does not exist.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{key}: {expected}")]
pub struct ImpossibleMap {
    /// Dotted path of the first key that is wrong.
    pub key: String,
    /// Values that it can have.
    pub expected: String,
}

/// The shapes of a map.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Surroundings {
    /// Obstacles that stand.
    pub obstacles: Vec<Obstacle>,
    /// Areas, and the speed limit of each \[m/s\].
    pub zones: Vec<(Shape, f64)>,
    /// The area that the robot does not leave.
    pub fence: Option<Shape>,
    /// Largest speed while the newest list of obstacles is too old \[m/s\].
    pub speed_without_obstacles_mps: f64,
}

impl Map {
    /// Its shapes.
    ///
    /// # Errors
    /// [`ImpossibleMap`] names the first key that is wrong.
    pub fn surroundings(&self) -> Result<Surroundings, ImpossibleMap> {
        let impossible = |key: String, expected: String| ImpossibleMap { key, expected };
        for (key, count) in [("obstacles", self.obstacles.len()), ("zones", self.zones.len())] {
            if count > MAP_MAX {
                return Err(impossible(key.into(), format!("at most {MAP_MAX}, not {count}")));
            }
        }
        let shape = |key: String, corners: &[Point], radius: f64| {
            Shape::hull(corners, radius).map_err(|error| impossible(key, error.to_string()))
        };
        let speed = |key: String, value: f64| {
            let allowed = (0.0..=LARGEST_MPS).contains(&value);
            allowed.then_some(value).ok_or_else(|| impossible(key, "0 to 1000 m/s".into()))
        };
        let obstacles = self.obstacles.iter().enumerate().map(|(index, outline)| {
            shape(format!("obstacles.{index}"), &outline.corners_m, outline.radius_m)
                .map(Obstacle::standing)
        });
        let zones = self.zones.iter().enumerate().map(|(index, zone)| {
            let key = format!("zones.{index}");
            let limit = speed(format!("{key}.speed_mps"), zone.speed_mps)?;
            Ok((shape(key, &zone.corners_m, zone.radius_m)?, limit))
        });
        let key = || "fence_m".to_owned();
        let fence = match self.fence_m.as_slice() {
            [] => None,
            corners => Some(shape(key(), corners, 0.0)?),
        };
        if fence.is_some_and(|fence| fence.corners().len() < 3) {
            return Err(impossible(key(), "3 to 8 corners that are not on one line".into()));
        }
        Ok(Surroundings {
            obstacles: obstacles.collect::<Result<_, _>>()?,
            zones: zones.collect::<Result<_, _>>()?,
            fence,
            speed_without_obstacles_mps: speed(
                "speed_without_obstacles_mps".into(),
                self.speed_without_obstacles_mps,
            )?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_maps_are_refused_by_key() {
        let disc = |radius_m| Outline { corners_m: vec![[0.0; 2]], radius_m };
        let refused = |map: Map| map.surroundings().err().map(|error| error.key);
        let obstacles = vec![disc(0.2), disc(f64::NAN)];
        let bad = Map { obstacles, ..Map::default() };
        assert_eq!(refused(bad).as_deref(), Some("obstacles.1"));
        let line = Map { fence_m: vec![[0.0; 2], [1.0, 0.0], [2.0, 0.0]], ..Map::default() };
        assert_eq!(refused(line).as_deref(), Some("fence_m"));
        let fast = Map { speed_without_obstacles_mps: -1.0, ..Map::default() };
        assert_eq!(refused(fast).as_deref(), Some("speed_without_obstacles_mps"));
        let many = Map { obstacles: vec![disc(0.1); MAP_MAX + 1], ..Map::default() };
        assert_eq!(refused(many).as_deref(), Some("obstacles"));
    }
}
