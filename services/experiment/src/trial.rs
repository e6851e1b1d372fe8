//! One closed loop: one scenario, contender, seed and start, in one process and in lock step.

use super::calibration::{Calibration, Interval};
use super::contender::Contender;
use super::figure;
use super::poison::Poison;
use crate::in_process::{self, InProcessError};
use controller::control::Controller;
use controller::reference::{PointsError, Reference};
use controller::settings::StateLimits;
use graph::assembly::Assembly;
use graph::scenario::Scenario;
use process::{Pulse, Stop};
use protocol::message::{
    FallbackLevel, ModelSnapshot, Participant, Phase, Plan, PlantState, ResidualSample, Truth,
};
use recorder::rows::Rows;
use recorder::summary::{self, Summary};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt::{self, Display, Formatter};
use std::path::Path;
use std::time::Duration;
use transport::{OpenError, Ports, ReceiveError, Since, Source};

/// Time between two checks of the witness whether it must end.
const PATIENCE: Duration = Duration::from_millis(5);

/// What is known at the start.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Start {
    /// Nothing.
    Cold,
    /// What an earlier run of the same variant with another seed has learned.
    Warm,
    /// What a run of another variant has learned.
    Stale,
}

impl Display for Start {
    fn fmt(&self, f: &mut Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Cold => "cold",
            Self::Warm => "warm",
            Self::Stale => "stale",
        })
    }
}

/// One row of a comparison.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Name of the scenario, with its variants.
    pub scenario: String,
    /// Name of the profile.
    pub profile: String,
    /// The contender.
    pub controller: Contender,
    /// What was known at the start.
    pub start: Start,
    /// Seed of noise and random forces.
    pub seed: u64,
    /// The deliberate fault, if there is one.
    pub poison: Option<Poison>,
    /// Length of the run \[s\].
    pub duration_s: f64,
    /// As in `summary.json`.
    pub arrival_s: Option<f64>,
    /// As in `summary.json`.
    pub arrival_by_band_s: BTreeMap<&'static str, Option<f64>>,
    /// As in `summary.json`.
    pub figures_of: &'static str,
    /// As in `summary.json`.
    pub speed_settle_s: Option<f64>,
    /// As in `summary.json`.
    pub steady_speed_error_mps: Option<f64>,
    /// As in `summary.json`.
    pub position_rmse_m: Option<f64>,
    /// As in `summary.json`.
    pub position_max_m: Option<f64>,
    /// Mean distance from the reference over the last 5 s \[m\].
    pub position_at_end_m: Option<f64>,
    /// Time from a change of the robot or its world in mid-run until the robot has recovered \[s\].
    ///
    /// It has recovered when the position RMSE from then to the end is at most 1.2 times the RMSE
    /// from 3 s to the change.
    pub recovery_s: Option<f64>,
    /// Time until the compensated delay stays within one period of the scenario's \[s\].
    pub delay_found_s: Option<f64>,
    /// As in `summary.json`.
    pub heading_rmse_rad: Option<f64>,
    /// RMS change of the applied planar input from one period to the next, divided by the period
    /// \[m/s²\].
    pub input_effort: f64,
    /// Share of ticks at which the truth was outside the scenario's corridor; none without a
    /// corridor.
    pub corridor_violations: Option<f64>,
    /// Position RMSE of each whole lap from 3 s on, for a reference that comes back \[m\].
    pub laps_rmse_m: Vec<f64>,
    /// The learner's 95 % interval of residual samples. The learner gave it before it had the
    /// sample.
    pub interval: Option<Interval>,
    /// Ticks at which the truth was outside the scenario's state limits, or the gate did not apply
    /// a controller's answer.
    pub constraint_violations: u64,
    /// Share of the ticks at which the learned model was used, per velocity axis.
    pub learned_share: [f64; 3],
    /// Share of the plans in whose place the simple controller drove.
    pub simple_share: f64,
    /// As in `summary.json`.
    pub tick_p50_us: Option<f64>,
    /// As in `summary.json`.
    pub tick_p99_us: Option<f64>,
}

/// What the witness of a trial keeps.
#[derive(Debug)]
struct Witnessed {
    rows: Rows,
    inputs: Vec<[f64; 3]>,
    truths: Vec<Truth>,
    violations: u64,
    /// Number of received plans, and of those that used the learned model, per velocity axis.
    plans: u64,
    /// Number of those from the simple controller.
    simple: u64,
    learned: [u64; 3],
    /// The delay that each plan compensated, with its time \[s\].
    delays: Vec<(f64, f64)>,
    calibration: Calibration,
}

/// Why a trial failed.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    /// The loop failed.
    #[error(transparent)]
    Loop(#[from] InProcessError),
    /// The witness could not subscribe.
    #[error(transparent)]
    Open(#[from] OpenError),
    /// The witness could not receive.
    #[error(transparent)]
    Receive(#[from] ReceiveError),
    /// The reference is impossible.
    #[error(transparent)]
    Reference(#[from] PointsError),
}

/// Runs `assembly` with its files in `folder`. `label` names the trial.
///
/// # Errors
/// [`TrialError`].
pub fn run(
    assembly: &Assembly,
    folder: &Path,
    label: (&str, &str, Contender, Start),
) -> Result<Row, TrialError> {
    let limits = assembly.scenario.mpc.state_limits;
    let corridor = Corridor::of(&assembly.scenario)?;
    let period = assembly.scenario.period_millis * 1e-3;
    let outside = |truth: &Truth| {
        limits.heading_rad.is_some_and(|limit| truth.pose[2].abs() > limit)
            || limits
                .speed_mps
                .is_some_and(|limit| truth.velocity[0].abs().max(truth.velocity[1].abs()) > limit)
            || limits.yaw_rate_radps.is_some_and(|limit| truth.velocity[2].abs() > limit)
            || corridor.as_ref().is_some_and(|corridor| corridor.is_left_by(truth))
    };
    let witnessed = in_process::drive(assembly, folder, |ports, run, stop| {
        let calibration = Calibration::new(Controller::expected(&assembly.controller(run.clone())));
        witness(ports, stop, calibration, period, outside)
    })??;
    let summary = Summary::of(&witnessed.rows, assembly.scenario.period_nanos());
    let distances = summary::distances(&witnessed.rows, assembly.scenario.period_nanos());
    let (scenario, profile, controller, start) = label;
    Ok(Row {
        scenario: scenario.to_owned(),
        profile: profile.to_owned(),
        controller,
        start,
        seed: assembly.scenario.seed,
        poison: None,
        duration_s: assembly.scenario.duration_s,
        arrival_s: summary.arrival_s,
        arrival_by_band_s: summary.arrival_by_band_s,
        figures_of: summary.figures_of,
        speed_settle_s: summary.speed_settle_s,
        steady_speed_error_mps: summary.steady_speed_error_mps,
        position_rmse_m: summary.position_rmse_m,
        position_max_m: summary.position_max_m,
        position_at_end_m: figure::at_end(&distances),
        recovery_s: figure::changes_at(assembly.scenario.truth.as_ref())
            .and_then(|at| figure::recovery(&distances, at)),
        delay_found_s: (assembly.scenario.truth.as_ref()).and_then(|truth| {
            figure::delay_found(&witnessed.delays, truth.command_delay_s, period)
        }),
        heading_rmse_rad: summary.heading_rmse_rad,
        input_effort: effort(&witnessed.inputs) / period,
        constraint_violations: witnessed.violations,
        corridor_violations: corridor.map(|corridor| corridor.left_for(&witnessed.truths)),
        laps_rmse_m: (assembly.scenario.reference.lap_s())
            .map_or_else(Vec::new, |lap_s| figure::laps(&distances, lap_s)),
        interval: witnessed.calibration.interval(),
        learned_share: witnessed.learned.map(|plans| plans as f64 / witnessed.plans.max(1) as f64),
        simple_share: witnessed.simple as f64 / witnessed.plans.max(1) as f64,
        tick_p50_us: summary.tick_p50_us,
        tick_p99_us: summary.tick_p99_us,
    })
}

/// The corridor in which a scenario wants the robot to stay.
struct Corridor {
    limits: StateLimits,
    reference: Reference,
}

impl Corridor {
    /// None if the scenario has no corridor.
    fn of(scenario: &Scenario) -> Result<Option<Self>, PointsError> {
        let limits = scenario.mpc.state_limits;
        if limits.corridor_left_m.or(limits.corridor_right_m).is_none() {
            return Ok(None);
        }
        let period = scenario.period_millis * 1e-3;
        let ticks = (scenario.duration_s / period).ceil() as usize;
        Ok(Some(Self {
            limits,
            reference: Reference::new(&scenario.reference, &scenario.start.pose, period, ticks)?,
        }))
    }

    fn is_left_by(&self, truth: &Truth) -> bool {
        let lateral = self.reference.at(truth.stamp.tick).lateral(&truth.pose);
        self.limits.corridor_left_m.is_some_and(|left| lateral > left)
            || self.limits.corridor_right_m.is_some_and(|right| -lateral > right)
    }

    /// Share of `truths` outside.
    fn left_for(&self, truths: &[Truth]) -> f64 {
        truths.iter().filter(|truth| self.is_left_by(truth)).count() as f64
            / truths.len().max(1) as f64
    }
}

/// Subscribes in place of the recorder, and keeps what the figures need.
fn witness(
    ports: &Ports,
    stop: &Stop,
    calibration: Calibration,
    period: f64,
    outside: impl Fn(&Truth) -> bool,
) -> Result<Witnessed, TrialError> {
    let mut pulse = Pulse::new(ports, Participant::Recorder)?;
    let mut states: Source<PlantState> = ports.source(Since::First)?;
    let mut truths: Source<Truth> = ports.source(Since::First)?;
    let mut plans: Source<Plan> = ports.source(Since::First)?;
    let mut samples: Source<ResidualSample> = ports.source(Since::First)?;
    let mut snapshots: Source<ModelSnapshot> = ports.source(Since::First)?;
    pulse.phase(Phase::Ready);
    let rows = Rows::of_segments(0);
    let mut kept = Witnessed {
        rows,
        inputs: Vec::new(),
        truths: Vec::new(),
        violations: 0,
        plans: 0,
        simple: 0,
        learned: [0; 3],
        delays: Vec::new(),
        calibration,
    };
    loop {
        let ending = stop.requested();
        while let Some(state) = states.next()? {
            let played = matches!(
                state.fallback_level(),
                FallbackLevel::Waiting
                    | FallbackLevel::FreshPlan
                    | FallbackLevel::ShiftedPlan
                    | FallbackLevel::Simple
            );
            kept.violations += u64::from(!played);
            kept.inputs.push(state.input);
            kept.rows.received_state(&state);
        }
        while let Some(truth) = truths.next()? {
            kept.violations += u64::from(outside(&truth));
            kept.rows.received_truth(&truth);
            kept.truths.push(truth);
        }
        while let Some(plan) = plans.next()? {
            kept.plans += 1;
            kept.simple += u64::from(plan.fallback_level == FallbackLevel::Simple.code());
            kept.delays
                .push((plan.stamp.tick as f64 * period, 1e-6 * f64::from(plan.delay_micros)));
            for (axis, used) in kept.learned.iter_mut().enumerate() {
                *used += u64::from(plan.learned_axes >> axis & 1);
            }
            kept.rows.received_plan(&plan);
        }
        while let Some(sample) = samples.next()? {
            kept.calibration.received_sample(&sample);
        }
        while let Some(snapshot) = snapshots.next()? {
            kept.calibration.received_snapshot(snapshot);
        }
        if ending {
            return Ok(kept);
        }
        plans.wait(PATIENCE)?;
    }
}

/// RMS change of the planar input from one period to the next \[m/s\].
fn effort(inputs: &[[f64; 3]]) -> f64 {
    let changes = inputs.windows(2).map(|pair| match pair {
        [before, after] => (after[0] - before[0]).powi(2) + (after[1] - before[1]).powi(2),
        _ => 0.0,
    });
    (changes.sum::<f64>() / inputs.len().max(2) as f64).sqrt()
}
