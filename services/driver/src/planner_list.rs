//! The list of obstacles that a planner sends: JSON, or TOML in a scenario.

use ::settings::Impossible;
use gate::list::{self, ImpossibleList};
use protocol::message::{OBSTACLES_MAX, ObstacleSource, Obstacles};
use robot::{Obstacle, Point, Shape};
use serde::{Deserialize, Serialize};

/// All obstacles that a planner knows now, in the world frame.
///
/// ```
/// use driver::{Listed, PlannerList};
///
/// let disc = Listed { corners_m: vec![[2.0, 0.5]], radius_m: 0.3, velocity_mps: [0.0, -0.4] };
/// let list = PlannerList { valid_s: 0.5, age_s: 0.0, obstacles: vec![disc] };
/// assert_eq!(list.message()?.rows()[0][..5], [0.0, -0.4, 0.3, 2.0, 0.5]);
/// # Ok::<(), driver::ImpossiblePlannerList>(())
/// ```
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlannerList {
    /// Time after its arrival from which the list is too old: then the robot slows down \[s\].
    pub valid_s: f64,
    /// Age of what it shows when it is sent \[s\].
    #[serde(default)]
    pub age_s: f64,
    /// The obstacles, at most 64.
    pub obstacles: Vec<Listed>,
}

/// The convex hull of corners, grown by a radius, with a velocity.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Listed {
    /// 1 to 8 corners: 1 is the centre of a disc \[m\].
    pub corners_m: Vec<Point>,
    /// Radius by which the hull is grown \[m\].
    #[serde(default)]
    pub radius_m: f64,
    /// Its velocity in the world \[m/s, m/s\].
    #[serde(default)]
    pub velocity_mps: Point,
}

/// A list that cannot be used, as a whole.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ImpossiblePlannerList {
    /// Too many obstacles.
    #[error("expected at most {OBSTACLES_MAX} obstacles, not {0}")]
    TooMany(usize),
    /// A number of it.
    #[error(transparent)]
    List(#[from] ImpossibleList),
}

impl PlannerList {
    /// The list as a message, without plant epoch and stamp.
    ///
    /// # Errors
    /// [`ImpossiblePlannerList`] names the first value that is wrong.
    pub fn message(&self) -> Result<Box<Obstacles>, ImpossiblePlannerList> {
        if self.obstacles.len() > OBSTACLES_MAX {
            return Err(ImpossiblePlannerList::TooMany(self.obstacles.len()));
        }
        let mut known = Vec::with_capacity(OBSTACLES_MAX);
        for (index, one) in self.obstacles.iter().enumerate() {
            let shape = Shape::hull(&one.corners_m, one.radius_m)
                .map_err(|error| ImpossibleList::Shape(index, error))?;
            known.push(Obstacle { shape, velocity_mps: one.velocity_mps });
        }
        let mut message: Box<Obstacles> = Box::new(bytemuck::Zeroable::zeroed());
        message.source = ObstacleSource::Planner.code();
        (message.age_s, message.valid_s) = (self.age_s, self.valid_s);
        list::write(&known, &mut message);
        list::read(&message, &mut known)?;
        Ok(message)
    }
}

/// A list of a planner in a scenario, and when it arrives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ScheduledList {
    /// Time since the start of the run \[s\].
    pub at_s: f64,
    /// The list.
    pub list: PlannerList,
}

impl ScheduledList {
    /// Checks the lists of a scenario.
    ///
    /// # Errors
    /// [`Impossible`] names the first bad one.
    pub fn check(lists: &[Self]) -> Result<(), Impossible> {
        for (index, Self { at_s, list }) in lists.iter().enumerate() {
            if !(at_s.is_finite() && *at_s >= 0.0) {
                let key = format!("lists[{index}].at_s");
                return Err(Impossible::new(key, "a finite number of seconds, at least 0"));
            }
            list.message().map_err(|error| {
                Impossible::new(format!("lists[{index}].list"), error.to_string())
            })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disc() -> Listed {
        Listed { corners_m: vec![[1.0, 2.0]], radius_m: 0.3, velocity_mps: [0.1, 0.0] }
    }

    #[test]
    fn a_bad_list_is_rejected_as_a_whole_with_the_place_of_its_error() {
        let list = |obstacles| PlannerList { valid_s: 1.0, age_s: 0.0, obstacles };
        let bad = |change: fn(&mut Listed)| {
            let mut bad = disc();
            change(&mut bad);
            list(vec![disc(), bad])
        };
        for wrong in [
            bad(|one| one.corners_m.clear()),
            bad(|one| one.corners_m = vec![[0.0; 2]; 9]),
            bad(|one| one.corners_m[0][1] = f64::NAN),
            bad(|one| one.radius_m = -1.0),
        ] {
            let error = wrong.message().err();
            let is_named =
                matches!(error, Some(ImpossiblePlannerList::List(ImpossibleList::Shape(1, _))));
            assert!(is_named, "{error:?}");
        }
        let fast = bad(|one| one.velocity_mps[0] = 1e9).message();
        let is_named =
            matches!(fast, Err(ImpossiblePlannerList::List(ImpossibleList::Velocity(1, _))));
        assert!(is_named, "{fast:?}");
        let many = list(vec![disc(); OBSTACLES_MAX + 1]).message();
        assert_eq!(many.err(), Some(ImpossiblePlannerList::TooMany(OBSTACLES_MAX + 1)));
        let forever = PlannerList { valid_s: f64::INFINITY, ..list(vec![]) };
        assert!(forever.message().is_err());
        let scheduled = ScheduledList { at_s: -1.0, list: list(vec![]) };
        let refused = ScheduledList::check(&[scheduled]).err().map(|error| error.key);
        assert_eq!(refused.as_deref(), Some("lists[0].at_s"));
    }

    #[test]
    fn json_and_toml_have_the_same_keys() -> Result<(), Box<dyn std::error::Error>> {
        let json = r#"{"valid_s": 1.0, "obstacles": [
            {"corners_m": [[1.0, 2.0]], "radius_m": 0.3, "velocity_mps": [0.1, 0.0]}]}"#;
        let toml = "valid_s = 1.0\n[[obstacles]]\ncorners_m = [[1.0, 2.0]]\nradius_m = 0.3\n\
                    velocity_mps = [0.1, 0.0]\n";
        let list: PlannerList = serde_json::from_str(json)?;
        assert_eq!(list, toml::from_str(toml)?);
        assert_eq!(list.obstacles, [disc()]);
        let unknown = r#"{"valid_s": 1.0, "obstacles": [], "version": 2}"#;
        assert!(serde_json::from_str::<PlannerList>(unknown).is_err());
        Ok(())
    }
}
