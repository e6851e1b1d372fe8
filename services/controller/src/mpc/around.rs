//! Half-spaces that keep the plan clear of obstacles.
//!
//! | here         | in the equations | meaning                                              |
//! |--------------|------------------|------------------------------------------------------|
//! | `distance_m` | d                | from the footprint to the obstacle, at that stage    |
//! | `normal`     | n                | unit vector along it, towards the obstacle           |
//! | `arm`        | r                | from the robot's centre to its nearest point         |
//! | `margin_of`  | m                | distance that the plan keeps; more if it moves       |
//!
//! A line between two convex shapes parts them, wherever they touch it. So a move of the pose by
//! (Δp, Δθ) changes the distance by −n·Δp − (r × n) Δθ, to first order. One row per stage and
//! obstacle:
//!
//! ```text
//! n·Δp + (r × n) Δθ ≤ d_{k+1} − b_{k+1} + s          b_0 = d_0
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

    /// Distance of the robot in `state`, at the start of period `k`, to an obstacle \[m\].
    pub(super) fn distance(&self, index: usize, k: usize, state: &State) -> f64 {
        self.separation(index, k, state).0
    }

    /// Writes the row of an obstacle about `state`, the end of period `k`. `before` is b at the
    /// start of that period \[m\]. Returns b at its end \[m\].
    pub(super) fn write(
        &self,
        index: usize,
        k: usize,
        state: &State,
        before: f64,
        row: &mut Row,
    ) -> f64 {
        if index >= self.count {
            (row.by_state, row.bounds[0]) = ([0.0; 3], 1.0);
            return f64::INFINITY;
        }
        let (distance, [x, y], arm) = self.separation(index, k + 1, state);
        row.by_state = [x, y, arm[0] * y - arm[1] * x].map(|value| value / SCALE_M);
        let least = self.approach(index, before);
        row.bounds[0] = (distance - least) / SCALE_M;
        least
    }

    /// Whether a row that has this `value` in the solution holds the plan.
    pub(super) fn holds(row: &Row, value: f64) -> bool {
        row.by_state != [0.0; 3] && value >= row.bounds[0] - HOLDS
    }

    /// b after one period.
    fn approach(&self, index: usize, before: f64) -> f64 {
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

    /// d, n and r at the start of period `k`.
    fn separation(&self, index: usize, k: usize, state: &State) -> (f64, Point, Point) {
        let (obstacle, _) = self.active[index.min(ACTIVE_MAX - 1)];
        let there = obstacle.after(k as f64 * self.period_s);
        let apart = self.footprint.placed(&state.pose).separation(&there.shape);
        let arm = [apart.nearest_m[0] - state.pose[0], apart.nearest_m[1] - state.pose[1]];
        (apart.distance_m, apart.normal, arm)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mpc::tests::settings;
    use crate::mpc::{Mpc, MpcError};
    use crate::reference::ReferencePoint;
    use crate::settings::MpcSettings;
    use model::main_model::MainModel;
    use model::predict::Belief;
    use robot::ImpossibleShape;

    const PERIOD_S: f64 = 0.1;

    fn disc(x: f64, y: f64, velocity_mps: Point) -> Result<Obstacle, ImpossibleShape> {
        Ok(Obstacle { shape: Shape::hull(&[[x, y]], 0.25)?, velocity_mps })
    }

    /// Drives along the x axis at 0.8 m/s for `ticks`, among `obstacles`. Returns the smallest
    /// distance of the footprint from them, and the last state.
    fn driven(obstacles: &[Obstacle], ticks: usize) -> Result<(f64, State), MpcError> {
        driven_by(true, 0.8, obstacles, ticks).map(|(least, _, state)| (least, state))
    }

    /// The same with another speed, and the largest speed; `knows` whether the program has rows for
    /// them.
    fn driven_by(
        knows: bool,
        speed_mps: f64,
        obstacles: &[Obstacle],
        ticks: usize,
    ) -> Result<(f64, f64, State), MpcError> {
        let robot = Robot::example();
        let main = MainModel::new(&robot, PERIOD_S);
        let belief = Belief {
            main: &main,
            learned: None,
            foresight: None,
            disturbance: [0.0; 3],
            delay_fraction: 0.0,
        };
        let settings = MpcSettings { horizon_steps: 20, control_horizon_steps: 10, ..settings() };
        let map = Surroundings::default();
        let mut mpc = if knows {
            Mpc::among_obstacles(&settings, &robot, &main, &map)?
        } else {
            Mpc::new(&settings, &robot, &main)?
        };
        let (mut state, mut input) = (State::default(), [0.0; 3]);
        let (mut least, mut fastest) = (f64::INFINITY, 0.0_f64);
        mpc.begin_at(&state);
        for tick in 0..ticks {
            let point = |k: usize| ReferencePoint {
                pose: [speed_mps * PERIOD_S * (tick + k) as f64, 0.0, 0.0],
                velocity: [speed_mps, 0.0, 0.0],
                course: 0.0,
            };
            let reference: Vec<ReferencePoint> = (0..=20).map(point).collect();
            let seconds = tick as f64 * PERIOD_S;
            let now: Vec<Obstacle> = obstacles.iter().map(|one| one.after(seconds)).collect();
            mpc.see_obstacles(now.iter().copied());
            mpc.prepare(&reference, &belief);
            assert!(mpc.iterate(&state, &input, &reference, &belief).outcome.usable(), "{tick}");
            input = mpc.stages()[0].input;
            state = belief.predict(&state, &input);
            fastest = fastest.max(state.velocity[0].hypot(state.velocity[1]));
            let footprint = robot.footprint().shape().placed(&state.pose);
            let apart = now
                .iter()
                .map(|one| footprint.separation(&one.after(PERIOD_S).shape).distance_m)
                .fold(f64::INFINITY, f64::min);
            least = least.min(apart);
        }
        Ok((least, fastest, state))
    }

    #[test]
    fn a_disc_beside_the_way_is_passed_without_a_touch() -> Result<(), Box<dyn std::error::Error>> {
        let (least, state) = driven(&[disc(2.5, 0.2, [0.0; 2])?], 70)?;
        assert!(least > 0.03, "{least}");
        assert!((state.pose[0] - 5.6).abs() < 0.1 && state.pose[1].abs() < 0.05, "{state:?}");
        Ok(())
    }

    #[test]
    fn a_disc_that_crosses_the_way_is_not_touched() -> Result<(), Box<dyn std::error::Error>> {
        for speed in [0.3, 0.6] {
            let meets_at = 2.5 / 0.8;
            let crossing = disc(2.5, -speed * meets_at, [0.0, speed])?;
            let (least, state) = driven(&[crossing], 80)?;
            assert!(least > 0.0, "at {speed} m/s: {least}");
            assert!((state.pose[0] - 6.4).abs() < 0.15, "{state:?}");
        }
        Ok(())
    }

    #[test]
    fn a_disc_that_comes_towards_a_robot_makes_it_give_way()
    -> Result<(), Box<dyn std::error::Error>> {
        let (least, _) = driven(&[disc(4.0, 0.1, [-0.5, 0.0])?], 70)?;
        assert!(least > 0.0, "{least}");
        Ok(())
    }

    #[test]
    fn obstacles_out_of_reach_change_no_bit() -> Result<(), Box<dyn std::error::Error>> {
        let far: Vec<Obstacle> = (0..64)
            .map(|i| disc(200.0 + f64::from(i), 90.0, [0.1, 0.0]))
            .collect::<Result<_, _>>()?;
        let ((_, with), (_, _, without)) = (driven(&far, 40)?, driven_by(false, 0.8, &far, 40)?);
        assert_eq!(with, without);
        assert_eq!(driven(&[], 40)?.1, without);
        Ok(())
    }

    #[test]
    fn a_robot_inside_an_obstacle_leaves_it() -> Result<(), Box<dyn std::error::Error>> {
        let (_, state) = driven(&[disc(-0.1, 0.0, [0.0; 2])?], 40)?;
        assert!(state.pose[0] > 2.0, "{state:?}");
        Ok(())
    }

    #[test]
    fn a_robot_that_stands_leaves_what_touches_it_slowly() -> Result<(), Box<dyn std::error::Error>>
    {
        for at in [[0.02, 0.05], [-0.25, 0.0], [0.0, 0.3]] {
            let touching = disc(at[0], at[1], [0.0; 2])?;
            let (_, fastest, state) = driven_by(true, 0.0, &[touching], 60)?;
            let footprint = Robot::example().footprint().shape().placed(&state.pose);
            let apart = footprint.separation(&touching.shape).distance_m;
            assert!(apart > 0.0 && fastest < 0.6, "{at:?}: {apart} m, {fastest} m/s");
        }
        Ok(())
    }
}
