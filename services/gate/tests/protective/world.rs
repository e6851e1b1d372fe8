//! A robot among obstacles, behind its gate.

use gate::{Bounds, Gate};
use proptest::prelude::*;
use protocol::message::{Command, FallbackLevel, Reason};
use robot::{Footprint, Obstacle, Response, Robot, Shape, Surroundings, Velocity};

pub(crate) const PERIOD: u64 = 100_000_000;
pub(crate) const SLICE: u64 = 2_000_000;
pub(crate) const RESPONSE_S: f64 = 0.3;

pub(crate) fn robot() -> Robot {
    let mut robot = Robot::example();
    let response = Response { time_constant_s: [RESPONSE_S; 3], ..Response::default() };
    (robot.body, robot.drive, robot.response) = (None, None, Some(response));
    // A controller may command anything in every period.
    (robot.limits.input_rate_mps2, robot.limits.yaw_input_rate_radps2) = (1e3, 1e3);
    (robot.limits.brake_mps2, robot.limits.yaw_brake_radps2) = (2.0, 4.0);
    robot.footprint = Some(Footprint { length_m: 0.6, width_m: 0.4, clearance_m: 0.05 });
    robot
}

pub(crate) fn command(tick: u64, input: Velocity) -> Command {
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.stamp.epoch, command.stamp.tick, command.plant_epoch) = (1, tick, 7);
    (command.fallback_level, command.input) = (FallbackLevel::FreshPlan.code(), input);
    (command.tail, command.tail_len) = ([input; 4], 4);
    command
}

/// A robot behind its gate that follows the output with a lag.
pub(crate) struct World {
    pub(crate) gate: Gate,
    pub(crate) pose: [f64; 3],
    pub(crate) velocity: Velocity,
    pub(crate) lag_s: f64,
    pub(crate) tick: u64,
}

impl World {
    pub(crate) fn new(surroundings: &Surroundings, pose: [f64; 3], lag_s: f64) -> Self {
        let robot = robot();
        let gate = Gate::new(Bounds::new(&robot, PERIOD, 0), 7).among(surroundings, &robot);
        Self { gate, pose, velocity: [0.0; 3], lag_s, tick: 0 }
    }

    /// Begins a period with a command; without one the tail acts, and then the brake.
    pub(crate) fn begin(&mut self, input: Option<Velocity>) -> u64 {
        let now = self.tick * PERIOD;
        self.gate.begin_period(self.tick, now);
        self.gate.see_pose(&self.pose, &self.velocity);
        if let Some(input) = input {
            assert_eq!(self.gate.offer(&command(self.tick, input), now), Ok(()), "{input:?}");
        }
        now
    }

    /// One period; calls `each` with the pose, the output and its reason after every slice.
    pub(crate) fn period(
        &mut self,
        input: Option<Velocity>,
        mut each: impl FnMut(&[f64; 3], Velocity, Reason),
    ) -> (FallbackLevel, Reason) {
        let now = self.begin(input);
        for slice in 0..PERIOD / SLICE {
            let decision = self.gate.decide(now + slice * SLICE);
            self.follow(&decision.input);
            each(&self.pose, decision.input, decision.reason);
        }
        self.tick += 1;
        self.gate.end_period(now + PERIOD)
    }

    pub(crate) fn follow(&mut self, input: &Velocity) {
        let seconds = SLICE as f64 * 1e-9;
        let kept = if self.lag_s > 0.0 { (-seconds / self.lag_s).exp() } else { 0.0 };
        for (velocity, input) in self.velocity.iter_mut().zip(input) {
            *velocity = kept * *velocity + (1.0 - kept) * input;
        }
        let [ahead, left, yaw] = self.velocity.map(|value| value * seconds);
        let (sin, cos) = (self.pose[2] + 0.5 * yaw).sin_cos();
        let by = [cos * ahead - sin * left, sin * ahead + cos * left, yaw];
        self.pose.iter_mut().zip(by).for_each(|(value, by)| *value += by);
    }
}

pub(crate) fn standing(shapes: &[Shape]) -> Surroundings {
    let obstacles = shapes.iter().copied().map(Obstacle::standing).collect();
    Surroundings { obstacles, ..Surroundings::default() }
}

/// The footprint with its clearance.
pub(crate) fn footprint() -> Shape {
    let footprint = robot().footprint();
    footprint.shape().grown(footprint.clearance_m)
}

pub(crate) fn disc(x: f64, y: f64, radius: f64) -> Shape {
    Shape::hull(&[[x, y]], radius).unwrap_or(Shape::rectangle(0.0, 0.0))
}

pub(crate) fn shapes() -> impl Strategy<Value = Shape> {
    let corner = prop::array::uniform2(-0.7..0.7);
    let place = prop::array::uniform2(-2.5..2.5);
    (prop::collection::vec(corner, 1..=6), 0.0..0.4, place)
        .prop_filter_map("a shape", |(corners, radius, place)| {
            Shape::hull(&corners, radius).ok().map(|s| s.moved(place))
        })
}

pub(crate) fn twists() -> impl Strategy<Value = Velocity> {
    (-2.0..2.0, -2.0..2.0, prop_oneof![Just(0.0), -3.0..3.0]).prop_map(|(x, y, yaw)| [x, y, yaw])
}

/// One that brakes faster than a controller may change its commands.
pub(crate) fn slow_robot() -> Robot {
    let mut robot = robot();
    (robot.limits.input_rate_mps2, robot.limits.yaw_input_rate_radps2) = (2.0, 4.0);
    (robot.limits.brake_mps2, robot.limits.yaw_brake_radps2) = (5.0, 10.0);
    if let Some(response) = &mut robot.response {
        response.wheel_speed_limit_radps = Some(70.0);
    }
    robot
}
