//! To a pose, clear of all obstacles that stand.

use model::Pose;
use motion::{
    Ground, Heading, Limits, Moment, Motion, MotionError, Path, Waypoint, along, along_in_motion,
    route, to_pose, to_standstill,
};
use robot::{Footprint, Obstacle, Point, Shape, Surroundings};

/// An obstacle that is slower counts as one that stands \[m/s\].
const STANDS_MPS: f64 = 0.05;
/// Interval at which a motion is checked for collisions \[s\].
const CHECK_EVERY_S: f64 = 0.02;

/// The times at which `motion` is checked \[s\].
fn checks(motion: &Motion) -> impl Iterator<Item = f64> + use<> {
    let last = (motion.duration_s() / CHECK_EVERY_S).ceil() as usize;
    (0..=last).map(|check| check as f64 * CHECK_EVERY_S)
}

/// Which of the obstacles that the robot sees count.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Counted {
    /// Those that stand.
    Standing,
    /// All, where they are now.
    All,
}

/// What a motion keeps clear of.
#[derive(Debug, Clone)]
pub(super) struct Clear {
    footprint: Footprint,
    obstacles: Vec<Obstacle>,
    fence: Option<Shape>,
    /// Each with its limit \[m/s\].
    zones: Vec<(Shape, f64)>,
}

impl Clear {
    /// Of the obstacles of the map, and of those of `seen` that count.
    pub(super) fn of(
        footprint: Footprint,
        map: &Surroundings,
        seen: &[Obstacle],
        counted: Counted,
    ) -> Self {
        let counts = |obstacle: &&Obstacle| {
            let [x, y] = obstacle.velocity_mps;
            counted == Counted::All || x.hypot(y) <= STANDS_MPS
        };
        let obstacles = map.obstacles.iter().chain(seen.iter().filter(counts)).copied().collect();
        Self { footprint, obstacles, fence: map.fence, zones: map.zones.clone() }
    }

    /// The motions from `begin` to `to`: straight if that is allowed. Otherwise the robot drives
    /// around the obstacles and slower in zones, and turns on the last part of the way. If it
    /// cannot do that without a stop, it stops first. From there it drives straight if that is
    /// allowed.
    pub(super) fn motions(
        &self,
        begin: &Moment,
        to: Pose,
        limits: &Limits,
    ) -> Result<Vec<Motion>, MotionError> {
        let straight = to_pose(begin, to, limits)?;
        if self.allows(&straight) {
            return Ok(vec![straight]);
        }
        let room = self.room(&self.footprint.shape(), &to);
        if room < 0.0 {
            return Err(MotionError::GoalBlocked { room_m: 0.0, needed_m: -room });
        }
        let [x, y, _] = begin.pose;
        if begin.velocity != [0.0; 3]
            && let Ok(points) = self.way([x, y], to)
            && let Some(motion) = self.without_stop(begin, turning_last(&points), limits)
        {
            return Ok(vec![motion]);
        }
        let stop = to_standstill(begin, limits)?;
        let from = stop.at(stop.duration_s()).pose;
        let straight = to_pose(&Moment::at_rest(from), to, limits)?;
        if self.allows(&straight) {
            return Ok(vec![stop, straight]);
        }
        let points = self.way([from[0], from[1]], to)?;
        self.after_stop(stop, turning_last(&points), limits)
    }

    /// The motions from `begin` along `path`: without a stop if that is possible.
    pub(super) fn along(
        &self,
        begin: &Moment,
        path: Path<'_>,
        limits: &Limits,
    ) -> Result<Vec<Motion>, MotionError> {
        match self.without_stop(begin, path, limits) {
            Some(motion) => Ok(vec![motion]),
            None => self.after_stop(to_standstill(begin, limits)?, path, limits),
        }
    }

    /// `stop`, and from its end along `path`.
    fn after_stop(
        &self,
        stop: Motion,
        path: Path<'_>,
        limits: &Limits,
    ) -> Result<Vec<Motion>, MotionError> {
        let from = stop.at(stop.duration_s()).pose;
        let path = along(from, path, limits, |pose| self.speed_at(pose))?;
        Ok(vec![stop, path])
    }

    /// The points of a way around the obstacles, with the heading of the last one.
    fn way(&self, from: Point, to: Pose) -> Result<Vec<Waypoint>, MotionError> {
        let corners = route(from, [to[0], to[1]], &self.ground())?;
        let mut points = vec![Waypoint::at(from)];
        points.extend(corners.into_iter().map(Waypoint::at));
        if let Some(last) = points.last_mut() {
            last.yaw = Some(to[2]);
        }
        Ok(points)
    }

    /// The motion from `begin` onto `path` without a stop, if there is one. Where it leaves the
    /// path it touches nothing.
    fn without_stop(&self, begin: &Moment, path: Path<'_>, limits: &Limits) -> Option<Motion> {
        let shape = self.footprint.shape().grown(self.footprint.clearance_m);
        let is_clear = |pose: &Pose| self.is_open() || self.room(&shape, pose) >= 0.0;
        along_in_motion(begin, path, limits, |pose| self.speed_at(pose), is_clear)
    }

    /// Whether there is nothing to keep clear of.
    fn is_open(&self) -> bool {
        self.obstacles.is_empty() && self.fence.is_none()
    }

    /// Largest speed of the robot at `pose`, by the zones \[m/s\].
    pub(super) fn speed_at(&self, pose: &[f64; 3]) -> f64 {
        if self.zones.is_empty() {
            return f64::INFINITY;
        }
        let placed = self.footprint.shape().grown(self.footprint.clearance_m).placed(pose);
        let touched =
            self.zones.iter().filter(|(zone, _)| placed.separation(zone).distance_m <= 0.0);
        touched.map(|&(_, limit)| limit).fold(f64::INFINITY, f64::min)
    }

    /// Whether the robot is slow enough in every zone on `motion`.
    fn keeps_zones(&self, motion: &Motion) -> bool {
        self.zones.is_empty()
            || checks(motion).all(|at_s| {
                let Moment { pose, velocity: [x, y, _], .. } = motion.at(at_s);
                x.hypot(y) <= self.speed_at(&pose)
            })
    }

    /// Whether the robot touches nothing on `motion`, and keeps the speeds of the zones.
    fn allows(&self, motion: &Motion) -> bool {
        self.touches_nothing(motion) && self.keeps_zones(motion)
    }

    fn touches_nothing(&self, motion: &Motion) -> bool {
        let shape = self.footprint.shape().grown(self.footprint.clearance_m);
        self.is_open() || checks(motion).all(|at_s| self.room(&shape, &motion.at(at_s).pose) >= 0.0)
    }

    /// Whether the robot touches nothing at any of `poses`.
    pub(super) fn allows_poses(&self, poses: &[Pose]) -> bool {
        let shape = self.footprint.shape();
        poses.iter().all(|pose| self.room(&shape, pose) >= 0.0)
    }

    /// Distance of `shape` at `pose` to the nearest obstacle, or to the border \[m\].
    fn room(&self, shape: &Shape, pose: &[f64; 3]) -> f64 {
        let placed = shape.placed(pose);
        let to_obstacles = self
            .obstacles
            .iter()
            .map(|obstacle| placed.separation(&obstacle.shape).distance_m)
            .fold(f64::INFINITY, f64::min);
        let border = Ground { obstacles: &[], ..self.ground() };
        let to_border = placed.corners().iter().map(|corner| border.room(*corner));
        to_border.map(|room| room - shape.radius_m()).fold(to_obstacles, f64::min)
    }

    fn ground(&self) -> Ground<'_> {
        let Footprint { length_m, width_m, clearance_m } = self.footprint;
        Ground {
            obstacles: &self.obstacles,
            fence: self.fence.as_ref(),
            outer_m: 0.5 * length_m.hypot(width_m) + clearance_m,
            inner_m: 0.5 * length_m.min(width_m),
        }
    }
}

/// A path along which the robot turns to the heading of the last point from the point before it.
fn turning_last(points: &[Waypoint]) -> Path<'_> {
    Path { points, heading: Heading::Given }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::{Robot, Shape};
    use std::error::Error;

    fn clear(discs: &[([f64; 2], f64)]) -> Result<Clear, Box<dyn Error>> {
        let discs = discs
            .iter()
            .map(|(centre, radius)| Shape::hull(&[*centre], *radius).map(Obstacle::standing));
        let obstacles = discs.collect::<Result<_, _>>()?;
        let map = Surroundings { obstacles, ..Surroundings::default() };
        Ok(Clear::of(Robot::example().footprint(), &map, &[], Counted::Standing))
    }

    fn touches(clear: &Clear, motions: &[Motion]) -> bool {
        let shape = clear.footprint.shape();
        motions.iter().any(|motion| {
            (0..=2000).any(|i| {
                let pose = motion.at(motion.duration_s() * f64::from(i) / 2000.0).pose;
                clear.room(&shape, &pose) < 0.0
            })
        })
    }

    #[test]
    fn a_pose_behind_an_obstacle_is_reached_without_touching_it() -> Result<(), Box<dyn Error>> {
        let limits = Limits::of(&Robot::example());
        let clear = clear(&[([2.0, 0.1], 0.4), ([2.0, -0.9], 0.3)])?;
        let motions = clear.motions(&Moment::default(), [4.0, 0.0, 1.5], &limits)?;
        assert!(!touches(&clear, &motions));
        let last = motions.last().map(|motion| motion.at(motion.duration_s()).pose);
        let [x, y, yaw] = last.unwrap_or_default();
        assert!((x - 4.0).abs() < 1e-6 && y.abs() < 1e-6 && (yaw - 1.5).abs() < 1e-6);
        Ok(())
    }

    #[test]
    fn a_robot_that_moves_drives_around_an_obstacle_without_a_stop() -> Result<(), Box<dyn Error>> {
        let limits = Limits::of(&Robot::example());
        let clear = clear(&[([2.5, 0.1], 0.4)])?;
        let begin = Moment { velocity: [1.0, 0.0, 0.2], ..Moment::default() };
        let motions = clear.motions(&begin, [5.0, 0.0, 1.5], &limits)?;
        assert!(motions.len() == 1 && !touches(&clear, &motions));
        let driven = checks(&motions[0]).filter(|at_s| *at_s < motions[0].duration_s() - 0.6);
        let slowest = driven.map(|at_s| {
            let [x, y, _] = motions[0].at(at_s).velocity;
            x.hypot(y)
        });
        assert!(slowest.fold(f64::MAX, f64::min) > 0.3);
        Ok(())
    }

    #[test]
    fn an_obstacle_beside_the_way_changes_nothing() -> Result<(), Box<dyn Error>> {
        let limits = Limits::of(&Robot::example());
        let motions =
            clear(&[([2.0, 2.0], 0.4)])?.motions(&Moment::default(), [4.0, 0.0, 0.0], &limits)?;
        let straight = to_pose(&Moment::default(), [4.0, 0.0, 0.0], &limits)?;
        assert_eq!(motions.len(), 1);
        assert!((motions[0].duration_s() - straight.duration_s()).abs() < 1e-12);
        Ok(())
    }

    #[test]
    fn a_pose_in_an_obstacle_is_refused() -> Result<(), Box<dyn Error>> {
        let limits = Limits::of(&Robot::example());
        let motions =
            clear(&[([4.0, 0.0], 0.3)])?.motions(&Moment::default(), [4.0, 0.2, 0.0], &limits);
        assert!(matches!(motions, Err(MotionError::GoalBlocked { .. })));
        Ok(())
    }
}
