//! A robot for tests of the dashboard: it drives a circle of 2 m.

use super::picture::Picture;
use network::telemetry::{Telemetry, TelemetryMessage};
use protocol::message::{
    FallbackLevel, Goal, GoalPhase, Health, Obstacles, Participant, Phase, Plan, PlantState,
};
use protocol::topic::Topic;
use std::time::Instant;

/// Its name.
pub(crate) const ROBOT: &str = "specimen";
/// One-step error of its main model.
pub(crate) const RESIDUAL: [f64; 3] = [0.08, -0.06, 0.03];
/// One-step error of its whole model.
pub(crate) const INNOVATION: [f64; 3] = [0.008, -0.004, 0.002];
/// Number of states that its controller has lost, and that its recorder has lost.
pub(crate) const LOST: u64 = 3;
/// Its control period \[ns\].
const PERIOD_NANOS: u64 = 100_000_000;

fn telemetry(message: TelemetryMessage) -> Telemetry {
    Telemetry { robot: ROBOT.into(), period_nanos: PERIOD_NANOS, message }
}

/// Its pose at a tick.
fn pose(tick: u64) -> [f64; 3] {
    let angle = tick as f64 * 0.05;
    [2.0 * angle.cos(), 2.0 * angle.sin(), angle + std::f64::consts::FRAC_PI_2]
}

pub(crate) fn state(tick: u64) -> Telemetry {
    let mut state: PlantState = bytemuck::Zeroable::zeroed();
    (state.stamp.tick, state.stamp.epoch, state.fallback_level, state.pose) =
        (tick, 1, FallbackLevel::FreshPlan.code(), pose(tick));
    telemetry(TelemetryMessage::State(Box::new(state)))
}

pub(crate) fn plan(tick: u64) -> Telemetry {
    let mut plan: Box<Plan> = Box::new(bytemuck::Zeroable::zeroed());
    (plan.stamp.tick, plan.plant_epoch, plan.horizon, plan.fallback_level) =
        (tick, 1, 10, FallbackLevel::FreshPlan.code());
    (plan.tick_nanos, plan.model_version, plan.learned_axes, plan.status) = (412_300, 7, 7, 1);
    (plan.residual, plan.innovation) = (RESIDUAL, INNOVATION);
    for (ahead, (predicted, reference)) in
        plan.predicted.iter_mut().zip(&mut plan.reference).enumerate()
    {
        let [x, y, yaw] = pose(tick + ahead as u64);
        *reference = [x, y, yaw, 1.0, 0.0, 0.5];
        *predicted = [x, y + 0.0321, yaw, 1.0, 0.0, 0.5];
    }
    telemetry(TelemetryMessage::Plan(plan))
}

pub(crate) fn health(who: Participant) -> Telemetry {
    let mut health: Box<Health> = Box::new(bytemuck::Zeroable::zeroed());
    (health.participant, health.phase, health.pid) =
        (who.code(), Phase::Running.code(), 4000 + who.code());
    (health.stamp.epoch, health.deadlines_met, health.model_version) = (1, 1234, 7);
    if matches!(who, Participant::Controller | Participant::Recorder) {
        health.lost[Topic::State.index()] = LOST;
    }
    if who == Participant::Learner {
        health.set_last_error("the fit was given up");
    }
    telemetry(TelemetryMessage::Health(health))
}

/// A disc of 0.3 m at (1, 1), valid for half a second.
pub(crate) fn obstacles() -> Telemetry {
    let mut list: Box<Obstacles> = Box::new(bytemuck::Zeroable::zeroed());
    (list.valid_s, list.count) = (0.5, 1);
    list.obstacles[0] = [1.0; protocol::message::OBSTACLE_NUMBERS];
    (list.obstacles[0][0], list.obstacles[0][1], list.obstacles[0][2]) = (0.0, 0.0, 0.3);
    telemetry(TelemetryMessage::Obstacles(list))
}

/// A goal at (0, 0) that the robot is on the way to.
pub(crate) fn goal() -> Telemetry {
    let mut goal: Box<Goal> = Box::new(bytemuck::Zeroable::zeroed());
    (goal.id, goal.phase) = (4, GoalPhase::Active.code());
    telemetry(TelemetryMessage::Goal(goal))
}

/// Its picture after 12.3 s, at `now`.
pub(crate) fn picture(now: Instant) -> Picture {
    let mut picture = Picture::new("tcp/127.0.0.1:7448");
    for tick in 0..=123 {
        picture.receive(state(tick), now);
        picture.receive(plan(tick), now);
    }
    for &who in Participant::ALL {
        picture.receive(health(who), now);
    }
    picture
}
