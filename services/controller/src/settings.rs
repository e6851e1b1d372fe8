//! Settings of the controller.

#[cfg(feature = "faults")]
mod solver_fault;

use crate::goal::schedule::{self, Scheduled};
use crate::reference::{PLACE_MAX, ReferenceSettings, is_place};
use model::learned::Layout;
use protocol::message::HORIZON_MAX;
use robot::{Map, Robot, Surroundings};
use serde::{Deserialize, Serialize};
use settings::{Check, Impossible};
use std::path::PathBuf;

#[cfg(feature = "faults")]
pub use solver_fault::{SolverFault, SolverFaultKind, SolverFaults};

/// Largest probability that a bound can be required to hold with.
const CHANCE_LEVEL_MAX: f64 = 0.999_999;

/// Longest run \[periods\]: the longest scenario at its shortest period.
const PERIODS_MAX: f64 = 1e7;

/// All settings of the controller process.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Settings that every process gets from the launcher.
    pub run: process::Run,
    /// Length of the run that the reference must cover \[s\].
    pub duration_s: f64,
    /// Pose at which the reference begins (x, y, yaw) \[m, m, rad\].
    pub start: [f64; 3],
    /// The robot as believed.
    pub robot: Robot,
    /// The reference trajectory.
    pub reference: ReferenceSettings,
    /// Goals of the scenario.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub goals: Vec<Scheduled>,
    /// Known obstacles, zones and the border of the area.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub map: Option<Map>,
    /// Whether lists of obstacles can arrive. In lock step the plant then sends one per period.
    #[serde(default)]
    pub sees_obstacles: bool,
    /// The optimiser and the fallback.
    pub mpc: MpcSettings,
    /// Use of learned models.
    pub learned: LearnedSettings,
    /// Result of an earlier run's identification, to start from.
    #[serde(default)]
    pub identified: Option<PathBuf>,
    /// Injected faults of the optimiser.
    #[cfg(feature = "faults")]
    #[serde(default, skip_serializing_if = "SolverFaults::is_empty")]
    pub solver_faults: SolverFaults,
}

/// Use of learned models.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct LearnedSettings {
    /// Whether there is a learner.
    pub enabled: bool,
    /// Inputs of the Gaussian processes.
    pub layout: Layout,
    /// P: in lock step, ticks between two snapshots.
    pub every_ticks: u64,
    /// D: in lock step, ticks from the last learned sample to the effect of the model.
    pub delay_ticks: u64,
    /// Whether the learner starts with a snapshot of an earlier run, which takes effect at tick D
    /// in lock step.
    #[serde(default)]
    pub resumed: bool,
}

/// Horizon, weights, limits.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MpcSettings {
    /// N: horizon, the number of periods that a plan covers \[periods\].
    pub horizon_steps: usize,
    /// Number of free inputs; later inputs keep the last one's distance from the target
    /// \[periods\].
    pub control_horizon_steps: usize,
    /// Weights of the stage cost.
    pub weights: Weights,
    /// Bounds on the predicted state, soft.
    #[serde(default)]
    pub state_limits: StateLimits,
    /// Largest ℓ of the disturbance observer, 0 to 1; a smaller one is used where it predicts
    /// better. With 0 there is no observer.
    pub observer_gain: f64,
    /// Observers that estimate the disturbance.
    #[serde(default)]
    pub observers: Observers,
    /// Method that computes answers.
    #[serde(default)]
    pub method: Method,
    /// Compensation of the dead time from command to wheels.
    #[serde(default)]
    pub delay: DelaySetting,
    /// Point about which the prediction is linearised.
    #[serde(default)]
    pub linearise: Linearise,
    /// Solver of the quadratic program.
    #[serde(default)]
    pub solver: SolverSetting,
    /// Parameters of the robot that are identified while it drives, and used where they predict
    /// better.
    #[serde(default)]
    pub identify: Identify,
    /// Whether a learned model is used, on each axis, only while it predicts better than the
    /// alternative without it. With `false` it is used from the first one on, to measure the cost.
    /// If the response is identified, plans that do not hold the robot are replaced by the simple
    /// controller.
    #[serde(default = "yes")]
    pub no_harm: bool,
    /// Share of the period that an answer may take in real time, from the receipt of its state. An
    /// optimiser that has not finished by then is stopped, and a lower fallback level answers. In
    /// lock step only its iterations are limited.
    #[serde(default = "half")]
    pub budget_share: f64,
}

const fn yes() -> bool {
    true
}

const fn half() -> f64 {
    0.5
}

/// Observers that estimate the disturbance, which is the part of the residual that no model
/// explains. On each axis the observer that predicts best is used.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Observers {
    /// Plain observers of several gains.
    #[default]
    Gains,
    /// The same, and Kalman filters of several ratios, which model the disturbance as a ramp.
    Kalman,
}

/// Parameters that least squares identify while the robot drives, except the dead time.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Identify {
    /// Nothing.
    Off,
    /// Time constant, gain and offset of each axis.
    #[default]
    Response,
    /// The same, and physical effects: friction, drag, the turning frame, coupled axes.
    Physics,
}

/// Method that computes answers. All but the first are for comparison.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Model predictive control with the learned models that arrive.
    #[default]
    Mpc,
    /// The input that holds the reference by the main model, and a proportional feedback of the
    /// pose.
    FeedforwardP,
    /// Model predictive control with the plant's own dynamics as model. Only `coxswain experiment`
    /// provides these dynamics.
    Oracle,
}

/// Point about which the prediction of each period is linearised.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Linearise {
    /// The prediction from the measured state.
    #[default]
    Measured,
    /// The plan itself, before the state arrives. After the state has arrived, only its effect is
    /// computed.
    Expected,
}

/// Solver of each period's quadratic program.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum SolverSetting {
    /// Our own dual active-set method; Clarabel if it has no answer.
    #[default]
    ActiveSet,
    /// Clarabel alone.
    Clarabel,
}

/// Compensation of the dead time from command to wheels.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum DelaySetting {
    /// The dead time is identified from the gate's output and the velocity that followed, and
    /// compensated.
    #[default]
    Estimated,
    /// The dead time is known, and compensated \[s\].
    KnownS(f64),
    /// No compensation.
    Ignored,
}

/// Weights of the stage cost. Position and planar velocity have the same weight in both directions.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Weights {
    /// On each component of the position error \[1/m²\].
    pub position: f64,
    /// On the heading error \[1/rad²\].
    pub heading: f64,
    /// On each component of the planar velocity error \[s²/m²\].
    pub velocity: f64,
    /// On the yaw rate error \[s²/rad²\].
    pub yaw_rate: f64,
    /// On the input's distance from its target.
    pub input: f64,
    /// On the input's change from one period to the next.
    pub input_change: f64,
    /// The terminal cost, in multiples of the stage cost.
    pub terminal_factor: f64,
}

/// Bounds on the predicted state. Violations are penalised, but never make the problem infeasible.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StateLimits {
    /// Largest |yaw| in the world \[rad\].
    pub heading_rad: Option<f64>,
    /// Largest forward and left speed \[m/s\].
    pub speed_mps: Option<f64>,
    /// Largest |yaw rate| \[rad/s\].
    pub yaw_rate_radps: Option<f64>,
    /// Largest distance to the left of the reference, across its course \[m\].
    pub corridor_left_m: Option<f64>,
    /// Largest distance to the right of it \[m\].
    pub corridor_right_m: Option<f64>,
    /// Probability with which each bound is to hold in each predicted period. Bounds are tightened
    /// by the number of standard deviations of the prediction that a normal distribution needs.
    /// 0.5, or no value, uses the mean alone.
    pub chance_level: Option<f64>,
}

impl MpcSettings {
    /// Largest gain of the observers of a controller that has some: that of the settings, or 1 if
    /// they have none.
    pub fn offset_free_gain(&self) -> f64 {
        if self.observer_gain > 0.0 { self.observer_gain } else { 1.0 }
    }

    /// Checks that the controller can be built.
    ///
    /// # Errors
    /// [`Impossible`] names the first impossible setting.
    pub fn check(&self) -> Result<(), Impossible> {
        let impossible = |key: &str, expected: &str| {
            Err(Impossible { key: key.into(), expected: expected.into() })
        };
        if !(3..=HORIZON_MAX).contains(&self.horizon_steps) {
            return impossible("horizon_steps", &format!("3 to {HORIZON_MAX} periods"));
        }
        if !(1..=self.horizon_steps).contains(&self.control_horizon_steps) {
            return impossible(
                "control_horizon_steps",
                &format!("1 to horizon_steps = {} periods", self.horizon_steps),
            );
        }
        let weights = &self.weights;
        for (key, value) in [
            ("weights.position", weights.position),
            ("weights.heading", weights.heading),
            ("weights.velocity", weights.velocity),
            ("weights.yaw_rate", weights.yaw_rate),
            ("weights.input", weights.input),
            ("weights.terminal_factor", weights.terminal_factor),
        ] {
            if !(value.is_finite() && value > 0.0) {
                return impossible(key, "a finite number greater than 0");
            }
        }
        if !(weights.input_change.is_finite() && weights.input_change >= 0.0) {
            return impossible("weights.input_change", "a finite number of at least 0");
        }
        let limits = &self.state_limits;
        for (key, limit) in [
            ("state_limits.heading_rad", limits.heading_rad),
            ("state_limits.speed_mps", limits.speed_mps),
            ("state_limits.yaw_rate_radps", limits.yaw_rate_radps),
            ("state_limits.corridor_left_m", limits.corridor_left_m),
            ("state_limits.corridor_right_m", limits.corridor_right_m),
        ] {
            if limit.is_some_and(|value| !(value.is_finite() && value > 0.0)) {
                return impossible(key, "a finite number greater than 0, or no limit at all");
            }
        }
        if limits.chance_level.is_some_and(|level| !(0.5..=CHANCE_LEVEL_MAX).contains(&level)) {
            return impossible(
                "state_limits.chance_level",
                "0.5 (the mean alone) to 0.999999, or nothing",
            );
        }
        if let DelaySetting::KnownS(seconds) = self.delay
            && !(seconds.is_finite() && seconds >= 0.0)
        {
            return impossible("delay.known-s", "a finite number of seconds of at least 0");
        }
        if !(0.0..=1.0).contains(&self.observer_gain) {
            return impossible(
                "observer_gain",
                "a number from 0 (never corrects) to 1 (uses the last period alone)",
            );
        }
        if !(self.budget_share > 0.0 && self.budget_share <= 1.0) {
            return impossible(
                "budget_share",
                "a share of the period, greater than 0 and at most 1",
            );
        }
        Ok(())
    }
}

impl process::HasRun for Settings {
    fn run(&self) -> &process::Run {
        &self.run
    }
}

impl Settings {
    /// The shapes of the map; none without one. The map has been checked.
    pub(crate) fn surroundings(&self) -> Surroundings {
        let shapes = self.map.as_ref().map(Map::surroundings);
        shapes.and_then(Result::ok).unwrap_or_default()
    }
}

impl Check for Settings {
    fn check(&self) -> Result<(), Impossible> {
        self.robot.check().map_err(|e| Impossible {
            key: format!("robot.{}", e.key),
            expected: e.expected.into(),
        })?;
        self.reference.check().map_err(|e| e.under("reference"))?;
        self.mpc.check().map_err(|e| e.under("mpc"))?;
        schedule::check(&self.goals)?;
        let shapes = self.map.as_ref().map(Map::surroundings).transpose();
        shapes.map_err(|e| Impossible::new(e.key, e.expected).under("map"))?;
        #[cfg(feature = "faults")]
        self.solver_faults.check().map_err(|e| e.under("solver_faults"))?;
        if !is_place(&self.start) {
            return Err(Impossible::new(
                "start",
                format!("three numbers x, y, yaw of at most {PLACE_MAX}, either way"),
            ));
        }
        let periods = self.duration_s * 1e9 / self.run.period_nanos as f64;
        if !(periods > 0.0 && periods <= PERIODS_MAX) {
            return Err(Impossible::new(
                "duration_s",
                format!(
                    "more than 0 s, and at most {PERIODS_MAX} periods, the capacity of the \
                     reference"
                ),
            ));
        }
        if self.learned.every_ticks == 0 || self.learned.delay_ticks == 0 {
            return Err(Impossible {
                key: "learned.every_ticks".into(),
                expected: "every_ticks and delay_ticks of at least 1".into(),
            });
        }
        Ok(())
    }
}
