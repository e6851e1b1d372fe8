//! MCAP files → rows: the data of the summary, read back from the segments of a record.
//!
//! A segment that was cut off by a kill -9 is read as far as it goes.

use crate::reader;
use protocol::message::{Coded, Exposure, FallbackLevel, Plan, PlantState, Reason, Stamp, Truth};
use protocol::topic::Topic;
use serde::Deserialize;
use serde::de::{Deserializer, Error as _};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Path, PathBuf};

/// Largest number of stored process errors.
const TOLD_MAX: usize = 50;

/// A segment cannot be opened.
#[derive(Debug, thiserror::Error)]
#[error("{} cannot be read", path.display())]
pub struct ReadError {
    /// The file.
    pub path: PathBuf,
    /// Error of the operating system.
    pub source: std::io::Error,
}

/// A recorded stamp.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Deserialize)]
pub struct Mark {
    /// Process instance.
    pub writer: u64,
    /// Its epoch.
    pub epoch: u64,
    /// Counts the messages of one writer and epoch on one topic, from 1.
    pub sequence: u64,
    /// Control period.
    pub tick: u64,
}

impl From<&Stamp> for Mark {
    fn from(stamp: &Stamp) -> Self {
        Self {
            writer: stamp.writer,
            epoch: stamp.epoch,
            sequence: stamp.sequence,
            tick: stamp.tick,
        }
    }
}

/// Report of the plant about the period that ended with this state.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct StateRow {
    /// Stamp; the epoch is that of the plant.
    pub stamp: Mark,
    /// Epoch of the last accepted command, 0 before the first.
    pub accepted_epoch: u64,
    /// Fallback level of the period. Records of earlier versions have the alias.
    #[serde(alias = "rung", deserialize_with = "coded")]
    pub fallback_level: FallbackLevel,
    /// Why the gate did not play the answer of the controller as it is, if it did not. A reason of
    /// another version counts as none.
    #[serde(default = "no_reason", deserialize_with = "known_reason")]
    pub reason: Reason,
    /// Why the gate has stopped, if it has; records of versions below 5 do not tell.
    #[serde(default = "no_reason", deserialize_with = "coded")]
    pub stop: Reason,
    /// Measured x, y, yaw \[m, m, rad\].
    #[serde(deserialize_with = "numbers")]
    pub pose: [f64; 3],
    /// Measured forward, left, yaw \[m/s, m/s, rad/s\].
    #[serde(deserialize_with = "numbers")]
    pub velocity: [f64; 3],
}

/// The true state at the start of a period.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct TruthRow {
    /// Stamp; the epoch is that of the plant.
    pub stamp: Mark,
    /// x, y, yaw \[m, m, rad\].
    #[serde(deserialize_with = "numbers")]
    pub pose: [f64; 3],
    /// Forward, left, yaw \[m/s, m/s, rad/s\].
    #[serde(deserialize_with = "numbers")]
    pub velocity: [f64; 3],
}

/// Reference of the controller at the start of a period, and the duration of its answer.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
pub struct PlanRow {
    /// Stamp; the epoch is that of the controller.
    pub stamp: Mark,
    /// Epoch of the plant.
    pub plant_epoch: u64,
    /// From the receipt of the state to the finished command \[ns\].
    pub tick_nanos: u64,
    /// x, y, yaw, forward, left and yaw velocity of the reference at this tick
    /// \[m, m, rad, m/s, m/s, rad/s\].
    #[serde(deserialize_with = "first_row")]
    pub reference: [f64; 6],
}

/// Health of one process instance.
#[derive(Debug, Clone, PartialEq, Deserialize)]
pub struct HealthRow {
    /// Stamp.
    pub stamp: Mark,
    /// Its role.
    pub participant: String,
    /// Time removed from the clock of a simulator \[ns\].
    pub stalled_nanos: u64,
    /// Model snapshots published or adopted.
    pub snapshots: u64,
    /// Access of unauthenticated peers; records of the first versions have none.
    #[serde(default = "closed", deserialize_with = "coded")]
    pub exposure: Exposure,
    /// Messages received, by topic.
    pub received: BTreeMap<String, u64>,
    /// Messages lost on its links, by topic.
    pub lost: BTreeMap<String, u64>,
    /// Its last error, empty if all is well.
    #[serde(default)]
    pub last_error: String,
}

/// Data of the summary.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Rows {
    /// In the order of the record.
    pub states: Vec<StateRow>,
    /// In the order of the record.
    pub truths: Vec<TruthRow>,
    /// In the order of the record.
    pub plans: Vec<PlanRow>,
    /// The last one of each process instance, by writer.
    pub healths: BTreeMap<u64, HealthRow>,
    /// Errors of the processes in the order of the record, each once.
    pub told: Vec<String>,
    /// Epochs of the controllers that sent commands.
    pub controller_epochs: BTreeSet<u64>,
    /// Number of messages by topic that are not in the record, although a later one is.
    pub missing: BTreeMap<&'static str, u64>,
    /// Number of files of the record.
    pub segments: usize,
    /// Last sequence number by topic, writer and epoch.
    last: HashMap<(Topic, u64, u64), u64>,
}

#[derive(Deserialize)]
struct Stamped {
    stamp: Mark,
}

impl Rows {
    /// No rows, of this number of files.
    pub fn of_segments(segments: usize) -> Self {
        Self { segments, ..Self::default() }
    }

    /// Reads the files of one record, in the order in which they were written.
    ///
    /// # Errors
    /// [`ReadError`] if one cannot be opened. A damaged file is not an error: it is read as far as
    /// it goes.
    pub fn read(segments: &[PathBuf]) -> Result<Self, ReadError> {
        let mut rows = Self::of_segments(segments.len());
        for path in segments {
            rows.read_segment(path).map_err(|source| ReadError { path: path.clone(), source })?;
        }
        Ok(rows)
    }

    /// Adds a state that was received, not read.
    pub fn received_state(&mut self, state: &PlantState) {
        self.states.push(StateRow {
            stamp: (&state.stamp).into(),
            accepted_epoch: state.accepted_epoch,
            fallback_level: state.fallback_level(),
            reason: state.reason(),
            stop: state.stop(),
            pose: state.pose,
            velocity: state.velocity,
        });
    }

    /// Adds a truth that was received, not read.
    pub fn received_truth(&mut self, truth: &Truth) {
        self.truths.push(TruthRow {
            stamp: (&truth.stamp).into(),
            pose: truth.pose,
            velocity: truth.velocity,
        });
    }

    /// Adds a plan that was received, not read.
    pub fn received_plan(&mut self, plan: &Plan) {
        let [reference, ..] = plan.reference;
        self.plans.push(PlanRow {
            stamp: (&plan.stamp).into(),
            plant_epoch: plan.plant_epoch,
            tick_nanos: plan.tick_nanos,
            reference,
        });
    }

    fn read_segment(&mut self, path: &Path) -> std::io::Result<()> {
        reader::messages(path, |message| {
            if let Err(error) = self.add(&message.channel.topic, &message.data) {
                tracing::warn!(
                    path = %path.display(),
                    topic = message.channel.topic,
                    %error,
                    "message skipped"
                );
            }
            Ok(())
        })
        .map(drop)
    }

    /// Adds one recorded message, unless it is there already. A restarted recorder receives the
    /// last message of some topics again.
    fn add(&mut self, topic: &str, json: &[u8]) -> Result<(), serde_json::Error> {
        let Some(topic) = Topic::ALL.into_iter().find(|known| known.name() == topic) else {
            return Ok(());
        };
        match topic {
            Topic::State => {
                self.add_state(serde_json::from_slice(json)?);
            }
            Topic::Truth => {
                self.add_truth(serde_json::from_slice(json)?);
            }
            Topic::Plan => {
                self.add_plan(serde_json::from_slice(json)?);
            }
            Topic::Health => {
                self.add_health(serde_json::from_slice(json)?);
            }
            Topic::Command => {
                let Stamped { stamp } = serde_json::from_slice(json)?;
                self.add_command(stamp);
            }
            _ => {
                let Stamped { stamp } = serde_json::from_slice(json)?;
                self.count(topic, stamp);
            }
        }
        Ok(())
    }

    /// Adds a recorded state. False if it is there already.
    pub(crate) fn add_state(&mut self, row: StateRow) -> bool {
        let new = self.count(Topic::State, row.stamp);
        if new {
            self.states.push(row);
        }
        new
    }

    /// Adds a recorded truth. False if it is there already.
    pub(crate) fn add_truth(&mut self, row: TruthRow) -> bool {
        let new = self.count(Topic::Truth, row.stamp);
        if new {
            self.truths.push(row);
        }
        new
    }

    /// Adds a recorded plan. False if it is there already.
    pub(crate) fn add_plan(&mut self, row: PlanRow) -> bool {
        let new = self.count(Topic::Plan, row.stamp);
        if new {
            self.plans.push(row);
        }
        new
    }

    /// Adds a recorded Health. False if it is there already.
    pub(crate) fn add_health(&mut self, row: HealthRow) -> bool {
        let new = self.count(Topic::Health, row.stamp);
        if new {
            let told = format!("{}: {}", row.participant, row.last_error);
            let is_more = !row.last_error.is_empty() && self.told.len() < TOLD_MAX;
            if is_more && !self.told.contains(&told) {
                self.told.push(told);
            }
            self.healths.insert(row.stamp.writer, row);
        }
        new
    }

    /// Adds the stamp of a recorded command. False if it is there already.
    pub(crate) fn add_command(&mut self, stamp: Mark) -> bool {
        let new = self.count(Topic::Command, stamp);
        if new {
            self.controller_epochs.insert(stamp.epoch);
        }
        new
    }

    /// Counts the messages missing before this one. False if the message is not new.
    pub(crate) fn count(&mut self, topic: Topic, stamp: Mark) -> bool {
        let last = self.last.entry((topic, stamp.writer, stamp.epoch)).or_default();
        if stamp.sequence <= *last {
            return false;
        }
        let missing = self.missing.entry(topic.name()).or_default();
        // Stamps of an unauthenticated peer may have any value: the count saturates.
        *missing = missing.saturating_add(stamp.sequence - *last - 1);
        *last = stamp.sequence;
        true
    }
}

pub(crate) fn no_reason() -> Reason {
    Reason::None
}

/// A reason, recorded as its word; none if the word is not known.
pub(crate) fn known_reason<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Reason, D::Error> {
    let word = String::deserialize(deserializer)?;
    Ok(Reason::of_word(&word).unwrap_or(Reason::None))
}

/// A coded field, recorded as its word.
pub(crate) fn coded<'de, D: Deserializer<'de>, E: Coded>(deserializer: D) -> Result<E, D::Error> {
    let word = String::deserialize(deserializer)?;
    E::of_word(&word).ok_or_else(|| D::Error::custom(format_args!("{word:?} is no known word")))
}

/// A number that is not finite is recorded as null.
fn number(value: Option<f64>) -> f64 {
    value.unwrap_or(f64::NAN)
}

pub(crate) fn numbers<'de, D: Deserializer<'de>, const N: usize>(
    deserializer: D,
) -> Result<[f64; N], D::Error>
where
    [Option<f64>; N]: Deserialize<'de>,
{
    <[Option<f64>; N]>::deserialize(deserializer).map(|values| values.map(number))
}

pub(crate) fn first_row<'de, D: Deserializer<'de>, const N: usize>(
    deserializer: D,
) -> Result<[f64; N], D::Error>
where
    [Option<f64>; N]: Deserialize<'de>,
{
    let rows = Vec::<[Option<f64>; N]>::deserialize(deserializer)?;
    rows.first().map(|row| row.map(number)).ok_or_else(|| D::Error::custom("no row"))
}

pub(crate) fn closed() -> Exposure {
    Exposure::Closed
}
