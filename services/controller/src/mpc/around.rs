//! Half-spaces that keep the plan clear of obstacles.
//!
//! | here         | in the equations | meaning                                              |
//! |--------------|------------------|------------------------------------------------------|
//! | `distance_m` | d                | from a corner of the footprint to the line           |
//! | `normal`     | n                | unit vector across the line, towards the obstacle    |
//! | `arm_m`      | r                | from the robot's centre to the corner                |
//! | `margin_of`  | m                | distance that the plan keeps; more if it moves       |
//!
//! A line between two convex shapes parts them, at that stage. They do not touch as long as all
//! corners of the footprint stay before it, which is also the condition of the gate. A move of the
//! pose by (Δp, Δθ) changes the distance of a corner by −n·Δp − (r × n) Δθ, to first order. The two
//! corners that are nearest to the line have a row each. With one alone, a turn that moves this one
//! away and the other one through the line would seem to lead away from the obstacle.
//!
//! ```text
//! n·Δp + (r × n) Δθ ≤ d_{k+1} − b_{k+1} + s          b_0: distance at the start of the plan
//! b_{k+1} = max(m, b_k − T c(b_k − m))               outside the margin
//! b_{k+1} = b_k + (1 − e^{−T/θ}) (m − b_k)           inside it, back to it with θ = 0.2 s
//! b_{k+1} ≤ b_k + T v                                where it touches, with v = 0.3 m/s
//! c τ + c²/2a = D                                    for the largest closing speed c(D)
//! ```
//! b is the fastest approach from now on whose braking ramp still ends before the margin, as the
//! gate requires it. It is a discrete barrier condition (Zeng, Zhang, Sreenath, American Control
//! Conference 2021) along the horizon, and does not depend on the plan. At most [`ACTIVE_MAX`]
//! obstacles count: those nearest to the robot that the plan can reach.

use super::qp::Row;
use model::State;
use robot::{Encircled, Footprint, Obstacle, Point, Robot, Shape, Surroundings};
use std::f64::consts::SQRT_2;

/// Most obstacles of one program.
pub const ACTIVE_MAX: usize = 8;
/// Corners of the footprint that have a row for an obstacle.
pub const CORNERS: usize = 2;
/// Distance beyond the clearance of the gate, so that the gate does not act \[m\].
const BEYOND_CLEARANCE_M: f64 = 0.03;
/// Distance that is a bound of 1 in a row \[m\].
const SCALE_M: f64 = 0.1;
/// Distance by which an obstacle may be farther than the plan reaches \[m\].
const SPARE_M: f64 = 0.3;
/// Time for which an obstacle may move otherwise than predicted: its margin grows by that way \[s\].
const UNSURE_S: f64 = 0.3;
/// θ: time in which a robot inside the margin returns to it \[s\].
const RETURN_S: f64 = 0.2;
/// v: largest speed at which the plan leaves an obstacle that touches the robot \[m/s\].
const LEAVES_MPS: f64 = 0.3;
/// A row whose bound is closer than this, in units of its bound, holds the plan.
const HOLDS: f64 = 1e-3;

/// One corner of the footprint before the line to an obstacle.
#[derive(Debug, Clone, Copy)]
struct Corner {
    distance_m: f64,
    arm_m: Point,
}

/// One obstacle along the plan.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Approach {
    /// b \[m\].
    least_m: f64,
    normal: Point,
    /// Those nearest to the line, the nearest one first.
    corners: [Option<Corner>; CORNERS],
}

impl Approach {
    /// Keeps `corner` if it is one of the nearest.
    fn consider(&mut self, corner: Corner) {
        let mut other = Some(corner);
        for nearest in &mut self.corners {
            if let Some(one) = other
                && nearest.is_none_or(|nearest| one.distance_m < nearest.distance_m)
            {
                std::mem::swap(nearest, &mut other);
            }
        }
    }

    /// Writes the row of one corner.
    pub(super) fn write(&self, corner: usize, row: &mut Row) {
        let Some(Corner { distance_m, arm_m }) = self.corners.get(corner).copied().flatten() else {
            (row.by_state, row.bounds[0]) = ([0.0; 3], 1.0);
            return;
        };
        let [x, y] = self.normal;
        row.by_state = [x, y, arm_m[0] * y - arm_m[1] * x].map(|value| value / SCALE_M);
        row.bounds[0] = (distance_m - self.least_m) / SCALE_M;
    }
}

/// Obstacles around a plan. Does not allocate after set-up.
pub(super) struct Around {
    footprint: Shape,
    /// m of an obstacle that stands \[m\].
    margin_m: f64,
    /// a \[m/s²\].
    brake_mps2: f64,
    /// τ: until a command has slowed the robot \[s\].
    wait_s: f64,
    period_s: f64,
    /// Largest speed of the robot \[m/s\].
    speed_mps: f64,
    standing: Vec<Encircled>,
    /// The nearest obstacles where they are when the plan begins, and their distances.
    active: [(Obstacle, f64); ACTIVE_MAX],
    count: usize,
}

impl Around {
    /// Those of the map; the others are [chosen](Self::choose).
    pub(super) fn new(robot: &Robot, map: &Surroundings, period_s: f64) -> Self {
        let Footprint { clearance_m, .. } = robot.footprint();
        let nothing = Obstacle::standing(Shape::rectangle(0.0, 0.0));
        Self {
            footprint: robot.footprint().shape(),
            margin_m: clearance_m + BEYOND_CLEARANCE_M,
            brake_mps2: robot.limits.brake_mps2,
            wait_s: robot.response_time_s() + period_s,
            period_s,
            // Both planar axes at once.
            speed_mps: SQRT_2 * robot.limits.input_mps,
            standing: map.obstacles.iter().copied().map(Obstacle::encircled).collect(),
            active: [(nothing, f64::INFINITY); ACTIVE_MAX],
            count: 0,
        }
    }

    /// Chooses the nearest obstacles for a plan over `horizon` periods from `state` on: those of
    /// the map, and `seen`, which are where they will be then.
    pub(super) fn choose(
        &mut self,
        state: &State,
        horizon: usize,
        seen: impl Iterator<Item = Obstacle>,
    ) {
        self.count = 0;
        let ahead_s = horizon as f64 * self.period_s;
        let (_, radius_m) = self.footprint.circle();
        let near = |one: &Encircled| {
            let [x, y] = one.obstacle.velocity_mps;
            let reach = (self.speed_mps + x.hypot(y)) * ahead_s + self.margin_m + SPARE_M;
            let apart = (one.centre[0] - state.pose[0]).hypot(one.centre[1] - state.pose[1]);
            let distance = apart - one.radius_m - radius_m;
            (distance <= reach).then_some(distance)
        };
        let (mut active, mut count) = (self.active, 0);
        for one in self.standing.iter().copied().chain(seen.map(Obstacle::encircled)) {
            let Some(distance) = near(&one) else { continue };
            let place = active[..count].partition_point(|(_, other)| *other <= distance);
            if place == ACTIVE_MAX {
                continue;
            }
            count = (count + 1).min(ACTIVE_MAX);
            active[place..count].rotate_right(1);
            active[place] = (one.obstacle, distance);
        }
        (self.active, self.count) = (active, count);
    }

    /// Number of obstacles in the program.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// The obstacles from the robot in `state`, at the start of the plan.
    pub(super) fn approaches(&self, state: &State) -> [Approach; ACTIVE_MAX] {
        let mut approaches = [Approach::default(); ACTIVE_MAX];
        for (index, approach) in approaches.iter_mut().enumerate().take(self.count) {
            let (here, there) = self.shapes(index, 0, state);
            approach.least_m = here.separation(&there).distance_m;
        }
        approaches
    }

    /// Continues the `approach` to an obstacle from the start of period `k` to its end, where the
    /// plan has `state`.
    pub(super) fn advance(&self, index: usize, k: usize, state: &State, approach: &mut Approach) {
        if index >= self.count {
            return;
        }
        let (here, there) = self.shapes(index, k + 1, state);
        let normal = here.separation(&there).normal;
        let line_m = -there.extent_m(normal.map(|value| -value)) - here.radius_m();
        *approach = Approach {
            least_m: self.least(index, approach.least_m),
            normal,
            corners: [None; CORNERS],
        };
        for corner in here.corners() {
            let distance_m = line_m - normal[0] * corner[0] - normal[1] * corner[1];
            let arm_m = [corner[0] - state.pose[0], corner[1] - state.pose[1]];
            approach.consider(Corner { distance_m, arm_m });
        }
    }

    /// Whether a row that has this `value` in the solution holds the plan.
    pub(super) fn holds(row: &Row, value: f64) -> bool {
        row.by_state != [0.0; 3] && value >= row.bounds[0] - HOLDS
    }

    /// b after one period.
    fn least(&self, index: usize, before: f64) -> f64 {
        let margin_m = self.margin_of(index);
        let room = before - margin_m;
        if room >= 0.0 {
            return margin_m.max(before - self.period_s * self.closing_speed(room));
        }
        let back = (1.0 - (-self.period_s / RETURN_S).exp()) * -room;
        before + if before < 0.0 { back.min(LEAVES_MPS * self.period_s) } else { back }
    }

    /// m of an obstacle \[m\].
    fn margin_of(&self, index: usize) -> f64 {
        let (obstacle, _) = self.active[index.min(ACTIVE_MAX - 1)];
        let [x, y] = obstacle.velocity_mps;
        self.margin_m + UNSURE_S * x.hypot(y)
    }

    /// c(D) for D = `room` \[m\]; 0 without room \[m/s\].
    fn closing_speed(&self, room: f64) -> f64 {
        let (a, wait) = (self.brake_mps2, self.wait_s);
        a * ((wait * wait + 2.0 * room.max(0.0) / a).sqrt() - wait)
    }

    /// The footprint in `state`, and an obstacle at the start of period `k`.
    fn shapes(&self, index: usize, k: usize, state: &State) -> (Shape, Shape) {
        let (obstacle, _) = self.active[index.min(ACTIVE_MAX - 1)];
        let there = obstacle.after(k as f64 * self.period_s).shape;
        (self.footprint.placed(&state.pose), there)
    }
}

#[cfg(test)]
mod tests;
