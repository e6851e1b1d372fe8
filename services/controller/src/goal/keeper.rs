//! Plans the way to a pose anew when an obstacle has come to stand in it, or holds the robot up.

use super::clear::{Clear, Counted};
use super::{Course, Demand, GoalError, GoalRequest, Outlook};
use model::Pose;
use robot::{Robot, Surroundings};

/// Interval between two reviews of the way \[s\].
const REVIEW_EVERY_S: f64 = 0.5;
/// Number of reviews in a row at which the robot is held up, until the way is planned anew.
const HELD_UP_REVIEWS: u32 = 3;

/// The pose that the robot drives to, and its way.
#[derive(Debug)]
struct Kept {
    id: u64,
    request: GoalRequest,
    way: Vec<Pose>,
    /// Number of reviews in a row at which an obstacle held the robot up.
    held_up: u32,
    /// Whether the last attempt has failed: it is told once.
    has_failed: bool,
}

/// Reviews the way to the present goal.
#[derive(Debug, Default)]
pub struct Keeper {
    kept: Option<Kept>,
    /// Tick of the last review.
    reviewed_at: u64,
}

impl Keeper {
    /// The control thread follows the goal `id` by a course with this way.
    pub fn keep(&mut self, id: u64, request: &GoalRequest, way: Vec<Pose>) {
        let is_pose = matches!(request.goal, Demand::Pose { .. });
        self.kept = is_pose.then(|| Kept {
            id,
            request: request.clone(),
            way,
            held_up: 0,
            has_failed: false,
        });
    }

    /// The control thread follows another way to the same goal.
    pub fn take_way(&mut self, way: Vec<Pose>) {
        if let Some(kept) = &mut self.kept {
            kept.way = way;
        }
    }

    /// Whether the way is to be reviewed at `tick`.
    pub fn is_due(&mut self, tick: u64, period_s: f64) -> bool {
        let every = (REVIEW_EVERY_S / period_s).ceil() as u64;
        // A plant that has restarted counts its ticks anew.
        let is_due = tick >= self.reviewed_at + every || tick < self.reviewed_at;
        if is_due {
            self.reviewed_at = tick;
        }
        is_due && self.kept.is_some()
    }

    /// A new course, if the way needs one. The present one stays where there is no other.
    ///
    /// # Errors
    /// [`GoalError`] if there is no other way, once until there is one.
    pub fn review(
        &mut self,
        outlook: &Outlook,
        robot: &Robot,
        map: &Surroundings,
        period_s: f64,
    ) -> Result<Option<Course>, GoalError> {
        let Some(kept) = self.kept.as_mut() else { return Ok(None) };
        if outlook.goal != Some(kept.id) {
            self.kept = None; // reached, or another goal has come
            return Ok(None);
        }
        kept.held_up = if outlook.held_up { kept.held_up + 1 } else { 0 };
        let waits = kept.held_up >= HELD_UP_REVIEWS;
        let clear = Clear::of(robot.footprint(), map, &outlook.obstacles, Counted::Standing);
        if !waits && clear.allows_poses(kept.rest(&outlook.pose)) {
            return Ok(None);
        }
        // What holds the robot up is in the way, also if it moves.
        let counted = if waits { Counted::All } else { Counted::Standing };
        kept.held_up = 0;
        let course =
            Course::around(&kept.request, kept.id, outlook, robot, (map, counted), period_s);
        let was_told = std::mem::replace(&mut kept.has_failed, course.is_err());
        match course {
            Err(_) if was_told => Ok(None),
            course => course.map(Some),
        }
    }
}

impl Kept {
    /// The way from the place nearest to `pose` on.
    fn rest(&self, pose: &Pose) -> &[Pose] {
        let distance = |place: &Pose| (place[0] - pose[0]).hypot(place[1] - pose[1]);
        let nearest = self
            .way
            .iter()
            .enumerate()
            .min_by(|(_, a), (_, b)| distance(a).total_cmp(&distance(b)));
        nearest.and_then(|(index, _)| self.way.get(index..)).unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::driving;
    use super::*;
    use robot::{Obstacle, Shape};
    use std::error::Error;

    const PERIOD_S: f64 = 0.02;

    fn to_pose() -> GoalRequest {
        GoalRequest::of(Demand::Pose { to: [4.0, 0.0, 0.0] })
    }

    fn followed() -> Result<(Keeper, Course), Box<dyn Error>> {
        let (robot, map) = (Robot::example(), Surroundings::default());
        let mut course = Course::new(&to_pose(), 7, &driving(), &robot, &map, PERIOD_S)?;
        let mut keeper = Keeper::default();
        keeper.keep(7, &to_pose(), std::mem::take(&mut course.way));
        Ok((keeper, course))
    }

    fn disc(velocity_mps: [f64; 2]) -> Result<Obstacle, Box<dyn Error>> {
        Ok(Obstacle { shape: Shape::hull(&[[2.5, 0.1]], 0.3)?, velocity_mps })
    }

    fn reviewed(keeper: &mut Keeper, outlook: &Outlook) -> Option<Course> {
        let map = Surroundings::default();
        keeper.review(outlook, &Robot::example(), &map, PERIOD_S).unwrap_or_default()
    }

    #[test]
    fn an_obstacle_in_the_way_gives_another_course() -> Result<(), Box<dyn Error>> {
        let (mut keeper, _) = followed()?;
        let clear = Outlook { goal: Some(7), ..driving() };
        assert!(reviewed(&mut keeper, &clear).is_none());
        let blocked = Outlook { obstacles: vec![disc([0.0; 2])?], ..clear };
        let course = reviewed(&mut keeper, &blocked).ok_or("a new course")?;
        assert_eq!((course.goal.id, course.goal.target), (7, [4.0, 0.0, 0.0]));
        keeper.take_way(course.way);
        assert!(reviewed(&mut keeper, &blocked).is_none(), "the new way is clear");
        Ok(())
    }

    #[test]
    fn an_obstacle_that_moves_counts_once_it_holds_the_robot_up() -> Result<(), Box<dyn Error>> {
        let (mut keeper, _) = followed()?;
        let outlook = Outlook { goal: Some(7), obstacles: vec![disc([0.3, 0.0])?], ..driving() };
        assert!(reviewed(&mut keeper, &outlook).is_none());
        let held_up = Outlook { held_up: true, ..outlook };
        let courses = [0; 3].map(|_| reviewed(&mut keeper, &held_up).is_some());
        assert_eq!(courses, [false, false, true]);
        Ok(())
    }

    #[test]
    fn a_goal_that_an_obstacle_covers_is_told_once_and_its_way_stays() -> Result<(), Box<dyn Error>>
    {
        let (mut keeper, _) = followed()?;
        let covered = Obstacle::standing(Shape::hull(&[[4.0, 0.0]], 0.3)?);
        let outlook = Outlook { goal: Some(7), obstacles: vec![covered], ..driving() };
        let (robot, map) = (Robot::example(), Surroundings::default());
        let told = [0; 3]
            .map(|_| keeper.review(&outlook, &robot, &map, PERIOD_S).map(|way| way.is_some()));
        assert!(matches!(told, [Err(_), Ok(false), Ok(false)]), "{told:?}");
        Ok(())
    }

    #[test]
    fn a_goal_that_is_reached_is_not_reviewed_any_more() -> Result<(), Box<dyn Error>> {
        let (mut keeper, _) = followed()?;
        assert!(keeper.is_due(100, PERIOD_S) && !keeper.is_due(101, PERIOD_S));
        assert!(reviewed(&mut keeper, &Outlook { goal: None, ..driving() }).is_none());
        assert!(!keeper.is_due(200, PERIOD_S));
        Ok(())
    }
}
