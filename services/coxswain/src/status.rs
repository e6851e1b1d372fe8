//! `coxswain status`: what the robot does now, in a few lines or as JSON.

use crate::joined::{JoinError, Joined};
use clap::Args;
use protocol::message::{GateState, Goal, Plan, PlantState};
use protocol::view::View;
use serde::{Serialize, Serializer};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// Longest wait for the first state and the first plan.
const PATIENCE: Duration = Duration::from_secs(2);
/// Time after the state in which plan and goal arrive.
const SETTLE: Duration = Duration::from_millis(250);

/// The run, and the form of the answer.
#[derive(Debug, Clone, Args)]
pub struct StatusOptions {
    /// Print JSON.
    #[arg(long)]
    pub json: bool,
    /// The run directory; by default that of the launch that runs on this machine.
    #[arg(long, value_name = "DIR")]
    pub run: Option<PathBuf>,
}

/// What the robot does now. A part without a message is missing.
#[derive(Debug, Default, Serialize)]
struct Status {
    run: PathBuf,
    #[serde(skip_serializing_if = "Option::is_none")]
    robot: Option<RobotStatus>,
    #[serde(skip_serializing_if = "Option::is_none")]
    controller: Option<ControllerStatus>,
    #[serde(skip_serializing_if = "Option::is_none", serialize_with = "viewed")]
    goal: Option<Goal>,
}

#[derive(Debug, Serialize)]
struct RobotStatus {
    tick: u64,
    time_s: f64,
    gate: &'static str,
    #[serde(skip_serializing_if = "Option::is_none")]
    stop: Option<&'static str>,
    estop: bool,
    pose: [f64; 3],
    velocity: [f64; 3],
    fallback_level: &'static str,
}

#[derive(Debug, Serialize)]
struct ControllerStatus {
    position_error_m: f64,
    model_version: u64,
    tick_micros: f64,
}

/// Prints what the robot of the launch that `options` name does now. The graphs of this machine are
/// in `base`.
///
/// # Errors
/// [`JoinError`] if there is no launch to ask.
pub fn run(options: &StatusOptions, base: &Path) -> Result<(), JoinError> {
    let joined = Joined::new(options.run.as_deref(), base)?;
    let status = Status::of(&joined)?;
    if options.json {
        let json = serde_json::to_string_pretty(&status);
        terminal::print(json.unwrap_or_default());
    } else {
        status.print();
    }
    Ok(())
}

impl Status {
    fn of(joined: &Joined) -> Result<Self, JoinError> {
        let mut states = joined.watcher::<PlantState>()?;
        let mut plans = joined.watcher::<Plan>()?;
        let mut goals = joined.watcher::<Goal>()?;
        let mut status = Self { run: joined.folder.clone(), ..Self::default() };
        let mut until = Instant::now() + PATIENCE;
        while Instant::now() < until {
            joined.check()?;
            plans.wait(SETTLE / 10)?;
            if let Some(state) = states.latest()? {
                if status.robot.is_none() {
                    until = Instant::now() + SETTLE;
                }
                status.robot = Some(RobotStatus::of(&state, joined.period_s));
            }
            status.controller = plans.latest()?.map(|plan| (&plan).into()).or(status.controller);
            status.goal = goals.latest()?.or(status.goal);
        }
        Ok(status)
    }

    fn print(&self) {
        terminal::print(format_args!("run         {}", self.run.display()));
        match &self.robot {
            None => terminal::print("robot       no state: the plant does not run here"),
            Some(robot) => {
                let stop = robot.stop.map(|stop| format!(": {stop}")).unwrap_or_default();
                let estop = if robot.estop { ", emergency stop pressed" } else { "" };
                let [x, y, yaw] = robot.pose;
                let [forward, left, rate] = robot.velocity;
                terminal::print(format_args!("gate        {}{stop}{estop}", robot.gate));
                terminal::print(format_args!(
                    "robot       x {x:.3} m, y {y:.3} m, yaw {yaw:.3} rad at {:.1} s (tick {})",
                    robot.time_s, robot.tick
                ));
                terminal::print(format_args!(
                    "velocity    forward {forward:.3} m/s, left {left:.3} m/s, turning {rate:.3} \
                     rad/s; {}",
                    robot.fallback_level
                ));
            }
        }
        if let Some(controller) = &self.controller {
            terminal::print(format_args!(
                "controller  {:.1} mm from the reference, model {}, {:.0} µs for its answer",
                1e3 * controller.position_error_m,
                controller.model_version,
                controller.tick_micros
            ));
        }
        match &self.goal {
            None => terminal::print("goal        none: the reference of the scenario"),
            Some(goal) => terminal::print(format_args!(
                "goal        {} ({}): {}, {:.0} %, {:.2} m and {:.1} s left",
                goal.id,
                goal.kind(),
                goal.phase(),
                100.0 * goal.progress,
                goal.left_m,
                goal.left_s
            )),
        }
    }
}

impl RobotStatus {
    fn of(state: &PlantState, period_s: f64) -> Self {
        Self {
            tick: state.stamp.tick,
            time_s: state.stamp.tick as f64 * period_s,
            gate: state.gate().text(),
            stop: (state.gate() == GateState::Stopped).then(|| state.stop().text()),
            estop: state.estop == 1,
            pose: state.pose,
            velocity: state.velocity,
            fallback_level: state.fallback_level().text(),
        }
    }
}

impl From<&Plan> for ControllerStatus {
    fn from(plan: &Plan) -> Self {
        Self {
            position_error_m: plan.position_error(),
            model_version: plan.model_version,
            tick_micros: plan.tick_nanos as f64 * 1e-3,
        }
    }
}

#[expect(clippy::ref_option, reason = "serde passes fields so")]
fn viewed<S: Serializer>(goal: &Option<Goal>, serializer: S) -> Result<S::Ok, S::Error> {
    goal.as_ref().map(View).serialize(serializer)
}
