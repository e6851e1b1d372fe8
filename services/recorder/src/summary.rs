//! Rows → figures: the summary of a run.
//!
//! Time is tick × period. All figures by tick are over the last epoch of the plant: a restarted
//! plant begins again at the scenario's start, so that two epochs are two runs. Snapshots and
//! losses are over the whole record. A figure without data is null.

mod figures;
#[cfg(test)]
mod tests;

use crate::rows::{HealthRow, Mark, PlanRow, Rows, StateRow};
pub(crate) use figures::root_mean_square;
use figures::{Deviation, Window, largest, percentile, settled_at};
use process::atomic_file;
use protocol::message::{Exposure, FallbackLevel, Participant, Reason};
use protocol::topic::{TOPIC_COUNT, Topic};
use serde::ser::{Serialize, Serializer};
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};

/// Distance from the reference within which the robot has arrived \[m\].
pub const ARRIVAL_BAND_M: f64 = 0.10;

/// Further distances, with their names in the summary \[m\].
const ARRIVAL_BANDS: [(&str, f64); 3] = [("0.02", 0.02), ("0.05", 0.05), ("0.10", ARRIVAL_BAND_M)];

/// Difference from the reference speed within which the speed has settled \[m/s\].
pub const SPEED_BAND_MPS: f64 = 0.07;

/// Length of the start without position and heading figures \[ns\].
const START_NANOS: u64 = 3_000_000_000;

/// Length of the end with the steady figure \[ns\].
const STEADY_NANOS: u64 = 10_000_000_000;

/// Largest number of listed stops.
const STOPS_MAX: usize = 100;

/// Figures of a run, in the order of `summary.json`.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
pub struct Summary {
    /// First time after which the distance from the reference stays within [`ARRIVAL_BAND_M`] to
    /// the end \[s\].
    pub arrival_s: Option<f64>,
    /// The same for several distances, by distance \[m\].
    pub arrival_by_band_s: BTreeMap<&'static str, Option<f64>>,
    /// First time after which the speed stays within [`SPEED_BAND_MPS`] of the reference speed to
    /// the end \[s\].
    pub speed_settle_s: Option<f64>,
    /// Largest difference of speed and reference speed in the last 10 s \[m/s\].
    pub steady_speed_error_mps: Option<f64>,
    /// Source of the motion in these figures: "truth", or "measured" where the record has no truth.
    pub figures_of: &'static str,
    /// Distance from the reference from 3 s on, RMS \[m\].
    pub position_rmse_m: Option<f64>,
    /// Largest distance from the reference from 3 s on \[m\].
    pub position_max_m: Option<f64>,
    /// Wrapped difference of heading and reference heading from 3 s on, RMS \[rad\].
    pub heading_rmse_rad: Option<f64>,
    /// Time from the receipt of the state to the finished command, median \[µs\].
    pub tick_p50_us: Option<f64>,
    /// 99th percentile of that time \[µs\].
    pub tick_p99_us: Option<f64>,
    /// Largest such time \[µs\].
    pub tick_max_us: Option<f64>,
    /// Periods from the first accepted command on.
    pub periods: u64,
    /// Those in which no answer of a controller reached the wheels in time.
    pub periods_missed: u64,
    /// Periods in which the gate slowed the robot: for an obstacle, a zone, or lists that are too
    /// old.
    pub periods_slowed: u64,
    /// Periods by fallback level, as the plant reports.
    pub fallback_levels: FallbackLevels,
    /// When and why the gate stopped the robot, and when a person let it drive again.
    pub stops: Vec<StopFigure>,
    /// Time for which the machine suspended a simulator and its world stood still \[s\].
    pub world_stalled_s: f64,
    /// Model snapshots published, by all instances of the learner.
    pub snapshots_published: u64,
    /// Model snapshots adopted, by all instances of the controller.
    pub snapshots_adopted: u64,
    /// Messages lost, by topic and process. `recorder` counts messages that are not in the record
    /// although a later one is. The others are the numbers in the processes' health.
    pub losses: BTreeMap<&'static str, BTreeMap<String, u64>>,
    /// Messages that could not be written, usually because the disk was full, by topic; topics
    /// without any are left out.
    pub unwritten: BTreeMap<&'static str, u64>,
    /// Number of epochs of the plant in the record. Above 1, the figures are over the last one.
    pub plant_epochs: usize,
    /// Number of epochs of the controllers that sent commands.
    pub controller_epochs: usize,
    /// Number of files of the record: one more for each restart of the recorder.
    pub segments: usize,
    /// Errors of the processes, each once.
    pub told: Vec<String>,
    /// Largest access of unauthenticated peers that any process reported.
    #[serde(serialize_with = "in_words")]
    pub exposure: Exposure,
}

/// One stop of the gate.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct StopFigure {
    /// Time of the first state that reports it \[s\].
    pub at_s: f64,
    /// Reason.
    #[serde(serialize_with = "reason_text")]
    pub reason: Reason,
    /// Time at which the gate was armed again, if it was \[s\].
    pub resumed_s: Option<f64>,
}

/// Periods by fallback level, every fallback level listed, the best first.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct FallbackLevels {
    counts: BTreeMap<FallbackLevel, u64>,
}

impl FallbackLevels {
    /// Periods on `fallback_level`.
    pub fn on(&self, fallback_level: FallbackLevel) -> u64 {
        self.counts.get(&fallback_level).copied().unwrap_or(0)
    }
}

impl Serialize for FallbackLevels {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_map(
            FallbackLevel::ALL
                .iter()
                .map(|&fallback_level| (fallback_level.text(), self.on(fallback_level))),
        )
    }
}

impl Summary {
    /// The same for a record without these messages of each topic, which could not be written.
    #[must_use]
    pub fn without(self, unwritten: [u64; TOPIC_COUNT]) -> Self {
        let named = Topic::ALL
            .into_iter()
            .map(|topic| (topic.name(), unwritten.get(topic.index()).copied().unwrap_or(0)));
        Self { unwritten: named.filter(|(_, count)| *count > 0).collect(), ..self }
    }

    /// Summarises the record of a run with this control period \[ns\].
    pub fn of(rows: &Rows, period_nanos: u64) -> Self {
        let epochs = plant_epochs(rows);
        let last = epochs.last().copied().unwrap_or(0);
        let deviations = deviations(rows, last, period_nanos);
        let window = Window::of(&deviations);
        let ticks = tick_times(rows, last);
        let fallback_levels = fallback_levels(rows, last);
        let arrived = |band| settled_at(&deviations, |deviation| deviation.position, band);
        Self {
            arrival_s: arrived(ARRIVAL_BAND_M),
            arrival_by_band_s: ARRIVAL_BANDS.map(|(name, band)| (name, arrived(band))).into(),
            speed_settle_s: settled_at(&deviations, |deviation| deviation.speed, SPEED_BAND_MPS),
            steady_speed_error_mps: largest(
                window.last(STEADY_NANOS).map(|deviation| deviation.speed),
            ),
            figures_of: if has_truth(rows, last) { "truth" } else { "measured" },
            position_rmse_m: root_mean_square(
                window.from(START_NANOS).map(|deviation| deviation.position),
            ),
            position_max_m: largest(window.from(START_NANOS).map(|deviation| deviation.position)),
            heading_rmse_rad: root_mean_square(
                window.from(START_NANOS).map(|deviation| deviation.heading),
            ),
            tick_p50_us: percentile(&ticks, 50).map(micros),
            tick_p99_us: percentile(&ticks, 99).map(micros),
            tick_max_us: percentile(&ticks, 100).map(micros),
            periods: fallback_levels.counts.values().sum(),
            periods_missed: fallback_levels
                .counts
                .iter()
                .filter(|(fallback_level, _)| is_missed(**fallback_level))
                .map(|(_, periods)| periods)
                .sum(),
            periods_slowed: states(rows, last).iter().filter(|row| row.reason.is_slowed()).count()
                as u64,
            fallback_levels,
            stops: stops(rows, last, period_nanos),
            world_stalled_s: stalled(rows),
            snapshots_published: snapshots(rows, Participant::Learner),
            snapshots_adopted: snapshots(rows, Participant::Controller),
            losses: losses(rows),
            unwritten: BTreeMap::new(),
            plant_epochs: epochs.len(),
            controller_epochs: rows.controller_epochs.len(),
            segments: rows.segments,
            told: rows.told.clone(),
            exposure: rows
                .healths
                .values()
                .map(|health| health.exposure)
                .max()
                .unwrap_or(Exposure::Closed),
        }
    }

    /// Writes `summary.json` into `folder` atomically.
    ///
    /// # Errors
    /// [`SummaryError`].
    pub fn write(&self, folder: &Path) -> Result<(), SummaryError> {
        let path = folder.join("summary.json");
        let write = || -> io::Result<()> {
            let mut json = serde_json::to_vec_pretty(self)?;
            json.push(b'\n');
            atomic_file::write(&path, &json)
        };
        write().map_err(|source| SummaryError { path: path.clone(), source })
    }
}

/// The summary cannot be written.
#[derive(Debug, thiserror::Error)]
#[error("{} cannot be written", path.display())]
pub struct SummaryError {
    /// The file.
    pub path: PathBuf,
    /// Error of the operating system.
    pub source: io::Error,
}

/// Epochs of the plant, the last one last.
fn plant_epochs(rows: &Rows) -> Vec<u64> {
    let mut epochs: Vec<u64> = rows
        .states
        .iter()
        .map(|row| row.stamp.epoch)
        .chain(rows.truths.iter().map(|row| row.stamp.epoch))
        .collect();
    epochs.sort_unstable();
    epochs.dedup();
    epochs
}

/// Time since tick 0 \[ns\] and distance from the reference \[m\] at every tick of the plant's last
/// epoch, in the order of time.
pub fn distances(rows: &Rows, period_nanos: u64) -> Vec<(u64, f64)> {
    let last = plant_epochs(rows).last().copied().unwrap_or(0);
    deviations(rows, last, period_nanos)
        .iter()
        .map(|deviation| (deviation.nanos, deviation.position))
        .collect()
}

/// Whether the record has the true position of the robot.
fn has_truth(rows: &Rows, epoch: u64) -> bool {
    rows.truths.iter().any(|truth| truth.stamp.epoch == epoch)
}

/// Deviation of the robot from the reference at every tick of an epoch that has both, in the order
/// of time. It is that of the true position, or of the measured one in a record without truth.
fn deviations(rows: &Rows, epoch: u64, period_nanos: u64) -> Vec<Deviation> {
    let plans = rows.plans.iter().filter(|plan| plan.plant_epoch == epoch);
    let plans: BTreeMap<u64, &PlanRow> = plans.map(|plan| (plan.stamp.tick, plan)).collect();
    let of = |stamp: &Mark, pose: &[f64; 3], velocity: &[f64; 3]| {
        let plan = plans.get(&stamp.tick).filter(|_| stamp.epoch == epoch)?;
        Some(Deviation::of(pose, velocity, plan, stamp.tick.saturating_mul(period_nanos)))
    };
    let mut deviations: Vec<Deviation> = if has_truth(rows, epoch) {
        rows.truths.iter().filter_map(|row| of(&row.stamp, &row.pose, &row.velocity)).collect()
    } else {
        rows.states.iter().filter_map(|row| of(&row.stamp, &row.pose, &row.velocity)).collect()
    };
    deviations.sort_by_key(|deviation| deviation.nanos);
    deviations
}

/// Duration of each tick of an epoch, in ascending order \[ns\].
fn tick_times(rows: &Rows, epoch: u64) -> Vec<u64> {
    let plans = rows.plans.iter().filter(|plan| plan.plant_epoch == epoch);
    let mut times: Vec<u64> = plans.map(|plan| plan.tick_nanos).collect();
    times.sort_unstable();
    times
}

/// States of an epoch, by tick.
fn states(rows: &Rows, epoch: u64) -> Vec<&StateRow> {
    let mut states: Vec<&StateRow> =
        rows.states.iter().filter(|state| state.stamp.epoch == epoch).collect();
    states.sort_by_key(|state| state.stamp.tick);
    states
}

/// Stops of an epoch, at most [`STOPS_MAX`].
fn stops(rows: &Rows, epoch: u64, period_nanos: u64) -> Vec<StopFigure> {
    let mut stops: Vec<StopFigure> = Vec::new();
    let mut before = Reason::None;
    for state in states(rows, epoch) {
        let seconds = state.stamp.tick.saturating_mul(period_nanos) as f64 / 1e9;
        if state.stop != before
            && let Some(open) = stops.last_mut().filter(|_| before != Reason::None)
        {
            open.resumed_s = Some(seconds);
        }
        if state.stop != before && state.stop != Reason::None {
            if stops.len() == STOPS_MAX {
                break;
            }
            stops.push(StopFigure { at_s: seconds, reason: state.stop, resumed_s: None });
        }
        before = state.stop;
    }
    stops
}

/// Counts the periods of an epoch from the first accepted command on.
///
/// The period of that command counts if the plant reports that the command acted in it.
fn fallback_levels(rows: &Rows, epoch: u64) -> FallbackLevels {
    let mut fallback_levels = FallbackLevels::default();
    for state in states(rows, epoch).into_iter().skip_while(|state| {
        state.accepted_epoch == 0 || state.fallback_level == FallbackLevel::Waiting
    }) {
        *fallback_levels.counts.entry(state.fallback_level).or_default() += 1;
    }
    fallback_levels
}

/// Whether the gate, not a controller, chose what the wheels got.
fn is_missed(fallback_level: FallbackLevel) -> bool {
    match fallback_level {
        FallbackLevel::Waiting
        | FallbackLevel::StoredTail
        | FallbackLevel::Brake
        | FallbackLevel::LatchedStop => true,
        FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan | FallbackLevel::Simple => false,
    }
}

fn snapshots(rows: &Rows, participant: Participant) -> u64 {
    let of_it = rows.healths.values().filter(|health| health.participant == participant.text());
    of_it.map(|health| health.snapshots).fold(0, u64::saturating_add)
}

fn stalled(rows: &Rows) -> f64 {
    rows.healths.values().map(|health| health.stalled_nanos).fold(0, u64::saturating_add) as f64
        / 1e9
}

/// Losses by topic and process. Of the processes' reports, only those of readers of the topic
/// count.
fn losses(rows: &Rows) -> BTreeMap<&'static str, BTreeMap<String, u64>> {
    let recorder = Participant::Recorder.text();
    let mut losses: BTreeMap<&'static str, BTreeMap<String, u64>> = BTreeMap::new();
    for topic in Topic::ALL {
        let of_topic = losses.entry(topic.name()).or_default();
        if topic != Topic::Credit {
            of_topic
                .insert(recorder.to_owned(), rows.missing.get(topic.name()).copied().unwrap_or(0));
        }
        let counted =
            |counts: &BTreeMap<String, u64>| counts.get(topic.name()).copied().unwrap_or(0);
        let readers = |health: &&HealthRow| {
            health.participant != recorder
                && (counted(&health.received) > 0 || counted(&health.lost) > 0)
        };
        for health in rows.healths.values().filter(readers) {
            let lost = of_topic.entry(health.participant.clone()).or_default();
            *lost = lost.saturating_add(counted(&health.lost));
        }
    }
    losses
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes fields so")]
fn reason_text<S: Serializer>(reason: &Reason, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(reason.text())
}

#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes fields so")]
fn in_words<S: Serializer>(exposure: &Exposure, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(exposure.text())
}

fn micros(nanos: u64) -> f64 {
    nanos as f64 * 1e-3
}
