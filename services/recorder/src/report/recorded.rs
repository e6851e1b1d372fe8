//! Recorded JSON → the data of the figures, in addition to the rows of the summary.

use crate::rows::{
    HealthRow, Mark, PlanRow, StateRow, closed, coded, first_row, no_reason, numbers,
};
use protocol::message::{Coded, Exposure, FallbackLevel, Reason, WHEELS_MAX};
use serde::{Deserialize, Deserializer};
use std::collections::BTreeMap;

/// A PlantState.
#[derive(Debug, Deserialize)]
pub(super) struct State {
    stamp: Mark,
    accepted_epoch: u64,
    #[serde(alias = "rung", deserialize_with = "coded")]
    fallback_level: FallbackLevel,
    reason: String,
    refused: u64,
    #[serde(deserialize_with = "numbers")]
    pose: [f64; 3],
    #[serde(deserialize_with = "numbers")]
    velocity: [f64; 3],
    #[serde(deserialize_with = "of_wheels")]
    wheel_speed: [f64; WHEELS_MAX],
    /// Why the gate has stopped, if it has; records of versions below 5 have no reason.
    #[serde(default = "no_reason", deserialize_with = "coded")]
    stop: Reason,
}

/// One number per wheel; missing ones are NaN.
fn of_wheels<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; WHEELS_MAX], D::Error> {
    let found = Vec::<Option<f64>>::deserialize(deserializer)?;
    Ok(std::array::from_fn(|wheel| found.get(wheel).copied().flatten().unwrap_or(f64::NAN)))
}

/// Measurements of one tick, and the gate's output in the period before.
#[derive(Debug, Clone, Copy)]
pub(super) struct StateTick {
    pub(super) tick: u64,
    /// x, y, yaw \[m, m, rad\].
    pub(super) pose: [f64; 3],
    /// Forward, left, yaw \[m/s, m/s, rad/s\].
    pub(super) velocity: [f64; 3],
    /// In the order of the robot file; NaN for a wheel that the robot has not \[rad/s\].
    pub(super) wheel_speed: [f64; WHEELS_MAX],
    pub(super) fallback_level: FallbackLevel,
}

/// Report of the gate about a period.
#[derive(Debug)]
pub(super) struct GateWords {
    pub(super) epoch: u64,
    pub(super) tick: u64,
    pub(super) fallback_level: FallbackLevel,
    pub(super) reason: String,
    /// Whether the gate slowed the robot.
    pub(super) is_slowed: bool,
    /// Number of commands rejected so far.
    pub(super) refused: u64,
}

impl State {
    pub(super) fn parts(self) -> (StateRow, StateTick, GateWords) {
        let Self {
            stamp,
            accepted_epoch,
            fallback_level,
            refused,
            pose,
            velocity,
            wheel_speed,
            stop,
            ..
        } = self;
        let told = if stop == Reason::None { self.reason } else { stop.text().to_owned() };
        let reason = Reason::of_word(&told).unwrap_or(Reason::None);
        (
            StateRow { stamp, accepted_epoch, fallback_level, reason, stop, pose, velocity },
            StateTick { tick: stamp.tick, pose, velocity, wheel_speed, fallback_level },
            GateWords {
                epoch: stamp.epoch,
                tick: stamp.tick,
                fallback_level,
                reason: told,
                is_slowed: reason.is_slowed(),
                refused,
            },
        )
    }
}

/// A Plan.
#[derive(Debug, Deserialize)]
pub(super) struct Plan {
    stamp: Mark,
    plant_epoch: u64,
    tick_nanos: u64,
    model_version: u64,
    learned_axes: u32,
    #[serde(deserialize_with = "first_row")]
    reference: [f64; 6],
    #[serde(deserialize_with = "numbers")]
    residual: [f64; 3],
    #[serde(deserialize_with = "numbers")]
    innovation: [f64; 3],
    #[serde(deserialize_with = "numbers")]
    disturbance: [f64; 3],
    #[serde(deserialize_with = "first_row")]
    variance: [f64; 3],
}

/// Model and plan of the controller at one tick.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct PlanTick {
    pub(super) tick: u64,
    /// From the receipt of the state to the finished command \[ns\].
    pub(super) tick_nanos: u64,
    /// Version of the learned model in use; 0 is the main model alone.
    pub(super) version: u64,
    /// Axes on which it is used: 1 forward, 2 left, 4 yaw, added up.
    pub(super) learned_axes: u32,
    /// x, y, yaw, forward, left and yaw velocity \[m, m, rad, m/s, m/s, rad/s\].
    pub(super) reference: [f64; 6],
    /// One-step error of the main model in the period before \[m/s, m/s, rad/s\].
    pub(super) residual: [f64; 3],
    /// The same of the whole model.
    pub(super) innovation: [f64; 3],
    /// Part of it that the observer predicted.
    pub(super) disturbance: [f64; 3],
    /// Variance of the learned residual of the period that begins \[(m/s)², (m/s)², (rad/s)²\].
    pub(super) variance: [f64; 3],
}

impl Plan {
    pub(super) fn parts(self) -> (PlanRow, PlanTick) {
        let Self {
            stamp,
            plant_epoch,
            tick_nanos,
            model_version: version,
            learned_axes,
            reference,
            ..
        } = self;
        let Self { residual, innovation, disturbance, variance, .. } = self;
        let tick = PlanTick {
            tick: stamp.tick,
            tick_nanos,
            version,
            learned_axes,
            reference,
            residual,
            innovation,
            disturbance,
            variance,
        };
        (PlanRow { stamp, plant_epoch, tick_nanos, reference }, tick)
    }
}

/// A ResidualSample.
#[derive(Debug, Deserialize)]
pub(super) struct Sample {
    pub(super) stamp: Mark,
    pub(super) plant_epoch: u64,
    pub(super) usable: u32,
}

/// A ModelSnapshot.
#[derive(Debug, Deserialize)]
pub(super) struct Snapshot {
    pub(super) stamp: Mark,
    pub(super) version: u64,
    /// Variance of a new sample beyond that of the function; records of the first versions have
    /// none.
    #[serde(default)]
    pub(super) sample_variance: Option<[Option<f64>; 3]>,
}

/// A Goal.
#[derive(Debug, Deserialize)]
pub(super) struct Goal {
    pub(super) stamp: Mark,
    pub(super) id: u64,
    pub(super) plant_epoch: u64,
    pub(super) kind: String,
    pub(super) phase: String,
    #[serde(deserialize_with = "numbers")]
    pub(super) target: [f64; 3],
}

/// An Obstacles.
#[derive(Debug, Deserialize)]
pub(super) struct Obstacles {
    pub(super) stamp: Mark,
    pub(super) plant_epoch: u64,
    /// Velocity in x and y, radius, then x and y of the corners, per obstacle.
    #[serde(rename = "obstacles")]
    rows: Vec<Vec<Option<f64>>>,
}

/// The hull of its corners, grown by its radius.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Outline {
    /// x and y \[m\].
    pub(super) corners: Vec<(f64, f64)>,
    /// \[m\].
    pub(super) radius: f64,
    pub(super) moves: bool,
}

impl Obstacles {
    /// The outlines of the obstacles whose numbers are all known.
    pub(super) fn outlines(self) -> impl Iterator<Item = Outline> {
        self.rows.into_iter().filter_map(|numbers| {
            let numbers: Vec<f64> = numbers.into_iter().collect::<Option<_>>()?;
            let (&[x, y, radius], corners) = numbers.split_first_chunk()?;
            let mut corners: Vec<(f64, f64)> =
                corners.as_chunks().0.iter().map(|&[x, y]| (x, y)).collect();
            corners.dedup();
            (!corners.is_empty()).then_some(Outline {
                corners,
                radius,
                moves: x != 0.0 || y != 0.0,
            })
        })
    }
}

/// A Health.
#[derive(Debug, Deserialize)]
pub(super) struct Health {
    pub(super) stamp: Mark,
    pub(super) participant: String,
    stalled_nanos: u64,
    snapshots: u64,
    #[serde(default = "closed", deserialize_with = "coded")]
    exposure: Exposure,
    received: BTreeMap<String, u64>,
    lost: BTreeMap<String, u64>,
    #[serde(default)]
    pub(super) models_left: u64,
    #[serde(default)]
    pub(super) snapshots_refused: u64,
    #[serde(default)]
    pub(super) last_error: String,
}

impl Health {
    pub(super) fn row(&self) -> HealthRow {
        let Self { stamp, participant, stalled_nanos, snapshots, exposure, received, lost, .. } =
            self;
        let (participant, received, lost) = (participant.clone(), received.clone(), lost.clone());
        HealthRow {
            stamp: *stamp,
            participant,
            stalled_nanos: *stalled_nanos,
            snapshots: *snapshots,
            exposure: *exposure,
            received,
            lost,
            last_error: self.last_error.clone(),
        }
    }

    /// Number of messages lost on its links, on all topics.
    pub(super) fn lost(&self) -> u64 {
        self.lost.values().copied().fold(0, u64::saturating_add)
    }
}
