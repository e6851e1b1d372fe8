//! What the gate knows of its surroundings, and the share of a twist that they allow.
//!
//! Obstacles come from the map, which is constant, and from lists. Each source sends whole lists: a
//! list replaces the one before it. No heap after set-up, no clock of its own.

use crate::Bounds;
use crate::protective::{Border, Braking, Stopping};
use protocol::message::{OBSTACLES_MAX, ObstacleSource, Reason};
use robot::{CORNERS_MAX, Encircled, Obstacle, Point, Robot, Shape, Surroundings, Velocity};

/// A list of obstacles that cannot be stored. The list before it stays, until it is too old.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected at most {OBSTACLES_MAX} obstacles, not {0}")]
pub struct TooManyObstacles(pub usize);

/// A twist that the surroundings have changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Slowed {
    /// Input of the wheels.
    pub input: Velocity,
    /// Why it is not the twist; [`Reason::None`] if it is.
    pub reason: Reason,
}

impl Slowed {
    /// An input that is not slowed.
    pub(crate) fn not(input: Velocity) -> Self {
        Self { input, reason: Reason::None }
    }
}

/// What the gate put out before a decision.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Before {
    /// Its last output.
    pub input: Velocity,
    /// Its output when the period began.
    pub begun_with: Velocity,
    /// Why the last output was not the command; [`Reason::None`] if it was.
    pub slowed: Reason,
    /// Time since the last output \[ns\].
    pub elapsed_nanos: u64,
}

/// The newest list of one source.
#[derive(Debug, Clone)]
struct List {
    /// As many as a list can have; the first `count` are in use.
    obstacles: Box<[Encircled]>,
    count: usize,
    /// Time of its arrival, and time for which it is valid \[ns\]; `None` before the first list.
    received: Option<(u64, u64)>,
}

/// Where the robot is, by the gate's own output since the last measurement.
#[derive(Debug, Clone, Copy)]
struct Seen {
    pose: [f64; 3],
    /// Time of this pose \[ns\].
    nanos: u64,
    /// The measured velocity, and the input that acted at that time.
    left_over: [Velocity; 2],
}

/// Surroundings of one robot.
#[derive(Debug, Clone)]
pub(crate) struct Protection {
    braking: Braking,
    /// In the body frame, with its clearance.
    footprint: Shape,
    standing: Vec<Encircled>,
    zones: Vec<(Encircled, f64)>,
    /// Outer normal of each edge, and its offset along it \[m\].
    fence: [(Point, f64); CORNERS_MAX],
    edges: usize,
    speed_without_obstacles_mps: f64,
    lists: [List; 2],
    seen: Option<Seen>,
}

impl Protection {
    /// `surroundings` of `robot`.
    pub(crate) fn new(surroundings: &Surroundings, robot: &Robot, period_nanos: u64) -> Self {
        let footprint = robot.footprint();
        let mut fence = [([0.0; 2], 0.0); CORNERS_MAX];
        let mut edges = 0;
        if let Some(area) = &surroundings.fence {
            let corners = area.corners();
            let ends = corners.iter().zip(corners.iter().cycle().skip(1));
            for (edge, (from, to)) in fence.iter_mut().zip(ends) {
                let [x, y] = [to[0] - from[0], to[1] - from[1]];
                let long = x.hypot(y);
                let normal = [y / long, -x / long];
                *edge = (normal, dot(normal, *from));
                edges += 1;
            }
        }
        let nowhere = Obstacle::standing(Shape::rectangle(0.0, 0.0)).encircled();
        let list = || List {
            obstacles: vec![nowhere; OBSTACLES_MAX].into_boxed_slice(),
            count: 0,
            received: None,
        };
        Self {
            braking: Braking::new(robot, period_nanos),
            footprint: footprint.shape().grown(footprint.clearance_m),
            standing: surroundings.obstacles.iter().copied().map(Obstacle::encircled).collect(),
            zones: surroundings
                .zones
                .iter()
                .map(|(shape, limit)| (Obstacle::standing(*shape).encircled(), *limit))
                .collect(),
            fence,
            edges,
            speed_without_obstacles_mps: surroundings.speed_without_obstacles_mps,
            lists: [list(), list()],
            seen: None,
        }
    }

    /// Sets pose and body velocity, as measured at `now`, when `input` acted.
    pub(crate) fn see_pose(
        &mut self,
        pose: &[f64; 3],
        velocity: &Velocity,
        input: &Velocity,
        now: u64,
    ) {
        if pose.iter().chain(velocity).all(|value| value.is_finite()) {
            self.seen = Some(Seen { pose: *pose, nanos: now, left_over: [*velocity, *input] });
        }
    }

    /// Replaces the list of `source`.
    ///
    /// # Errors
    /// [`TooManyObstacles`].
    pub(crate) fn see_obstacles(
        &mut self,
        source: ObstacleSource,
        obstacles: &[Obstacle],
        now: u64,
        valid_nanos: u64,
    ) -> Result<(), TooManyObstacles> {
        if obstacles.len() > OBSTACLES_MAX {
            return Err(TooManyObstacles(obstacles.len()));
        }
        let [robot, planner] = &mut self.lists;
        let list = match source {
            ObstacleSource::Robot => robot,
            ObstacleSource::Planner => planner,
        };
        for (slot, obstacle) in list.obstacles.iter_mut().zip(obstacles) {
            *slot = obstacle.encircled();
        }
        (list.count, list.received) = (obstacles.len(), Some((now, valid_nanos)));
        Ok(())
    }

    /// Moves the pose until `now`, under `input`.
    pub(crate) fn predict(&mut self, input: &Velocity, now: u64) {
        let Some(seen) = &mut self.seen else { return };
        let seconds = now.saturating_sub(seen.nanos) as f64 * 1e-9;
        let [ahead, left, yaw] = input.map(|value| value * seconds);
        let (sin, cos) = (seen.pose[2] + 0.5 * yaw).sin_cos();
        let by = [cos * ahead - sin * left, sin * ahead + cos * left, yaw];
        seen.pose.iter_mut().zip(by).for_each(|(value, by)| *value += by);
        seen.nanos = seen.nanos.max(now);
    }

    /// The input at `now` when the command is `twist`.
    ///
    /// It is the twist times the share that the surroundings allow. On the way to that share it
    /// falls no faster than the ramp of the brake. If an input on the way is not allowed itself,
    /// the ramp brakes all axes. From the first slowed output on, until the output is the twist
    /// again, no axis changes by more than the change limit of one period, or the ramp.
    pub(crate) fn slow(
        &self,
        bounds: &Bounds,
        twist: &Velocity,
        before: &Before,
        now: u64,
    ) -> Slowed {
        let (mut share, mut reason) = self.share(twist, now);
        let asked = bounds.in_reach(&before.begun_with, twist);
        if before.slowed != Reason::None {
            let reached = bounds.share_in_reach(&before.begun_with, twist);
            if reason == Reason::None && (reached < share || asked != *twist) {
                reason = before.slowed;
            }
            share = share.min(reached);
        }
        if reason == Reason::None {
            return Slowed::not(*twist);
        }
        let goal = twist.map(|value| share * value);
        let input = bounds.slowed(&before.input, &asked, &goal, before.elapsed_nanos);
        let allowed =
            input == goal || (bounds.contain(&input) && self.share(&input, now).1 == Reason::None);
        let input =
            if allowed { input } else { bounds.braked(&before.input, before.elapsed_nanos) };
        Slowed { input, reason }
    }

    /// The largest allowed share of `twist` at `now`, and what bounds it; [`Reason::None`] if
    /// nothing does.
    fn share(&self, twist: &Velocity, now: u64) -> (f64, Reason) {
        let mut allowed = Allowed { share: 1.0, reason: Reason::None };
        let Some(seen) = &self.seen else {
            // Without a pose nothing is known of the surroundings.
            allowed.bound(Reason::ProtectiveStop, |_| twist.iter().all(|value| *value == 0.0));
            return (allowed.share, allowed.reason);
        };
        let stopping =
            Stopping::new(&self.braking, &self.footprint, &seen.pose, twist, &seen.left_over);
        let footprint = self.footprint.placed(&seen.pose);
        let circle = footprint.circle();
        if self.lists.iter().any(|list| list.is_too_old(now)) {
            allowed.bound(Reason::ObstaclesUnknown, |share| {
                stopping.keeps(self.speed_without_obstacles_mps, share)
            });
        }
        for (normal, offset) in &self.fence[..self.edges] {
            let farthest = footprint.corners().iter().map(|corner| dot(*normal, *corner));
            let farthest = farthest.fold(f64::NEG_INFINITY, f64::max) + footprint.radius_m();
            let border =
                Border { distance_m: offset - farthest, normal: *normal, approach_mps: 0.0 };
            allowed.bound(Reason::Geofence, |share| stopping.stops_before(&border, share));
        }
        for (zone, limit_mps) in &self.zones {
            if let Some(border) = border(&footprint, circle, zone, 0.0, &stopping) {
                allowed.bound(Reason::SpeedZone, |share| {
                    stopping.slows_before(&border, *limit_mps, share)
                });
            }
        }
        let listed = self.lists.iter().flat_map(|list| {
            let age = list.age_s(now);
            list.obstacles[..list.count].iter().map(move |obstacle| (obstacle, age))
        });
        for (obstacle, age) in self.standing.iter().map(|obstacle| (obstacle, 0.0)).chain(listed) {
            if let Some(border) = border(&footprint, circle, obstacle, age, &stopping) {
                allowed
                    .bound(Reason::ProtectiveStop, |share| stopping.stops_before(&border, share));
            }
        }
        (allowed.share, allowed.reason)
    }
}

impl List {
    fn is_too_old(&self, now: u64) -> bool {
        self.received.is_some_and(|(at, valid)| now.saturating_sub(at) > valid)
    }

    /// Time for which its obstacles have moved since it arrived. They are not predicted beyond its
    /// validity \[s\].
    fn age_s(&self, now: u64) -> f64 {
        self.received.map_or(0.0, |(at, valid)| now.saturating_sub(at).min(valid) as f64 * 1e-9)
    }
}

/// The largest share so far, and what bounds it.
struct Allowed {
    share: f64,
    reason: Reason,
}

impl Allowed {
    fn bound(&mut self, reason: Reason, condition: impl Fn(f64) -> bool) {
        let share = Stopping::largest_share(self.share, condition);
        if share < self.share {
            (self.share, self.reason) = (share, reason);
        }
    }
}

/// The border to an obstacle of a list that is `age` \[s\] old; `None` if it is out of reach.
fn border(
    footprint: &Shape,
    (centre, radius_m): (Point, f64),
    obstacle: &Encircled,
    age: f64,
    stopping: &Stopping<'_>,
) -> Option<Border> {
    let velocity = obstacle.obstacle.velocity_mps;
    let there = [0, 1].map(|axis| obstacle.centre[axis] + age * velocity[axis]);
    let apart = (there[0] - centre[0]).hypot(there[1] - centre[1]);
    let reach = stopping.reach_m(velocity[0].hypot(velocity[1]));
    if apart - radius_m - obstacle.radius_m > reach {
        return None;
    }
    let separation = footprint.separation(&obstacle.obstacle.after(age).shape);
    let approach_mps = (-dot(velocity, separation.normal)).max(0.0);
    let (distance_m, normal) = (separation.distance_m, separation.normal);
    (distance_m <= reach).then_some(Border { distance_m, normal, approach_mps })
}

fn dot(a: Point, b: Point) -> f64 {
    a[0] * b[0] + a[1] * b[1]
}
