//! The files of one run → the data of its figures and of its column of the table.
//!
//! Figures are over the last epoch of the plant, like those of the summary: a restarted plant
//! begins again at the scenario's start.

use super::ReportError;
use super::events::{Event, Log};
use super::recorded::{
    Goal, Health, Obstacles, Outline, Plan, PlanTick, Sample, Snapshot, State, StateTick,
};
use crate::changes;
use crate::reader::{self, Head, SourceError};
use crate::rows::{Mark, Rows, TruthRow};
use crate::summary::Summary;
use mcap::Message;
use protocol::topic::Topic;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Longest plausible period \[ns\].
const PERIOD_NANOS_MAX: u64 = 3_600_000_000_000;

/// Distance between two drawn outlines of an obstacle that moves, and of one that stands \[m\].
const MOVING_CELL_M: f64 = 0.25;
const STANDING_CELL_M: f64 = 0.01;

/// Largest number of drawn outlines.
const OUTLINES_MAX: usize = 500;

/// A published model.
#[derive(Debug, Clone, Copy)]
pub(super) struct Published {
    /// Tick of the publication, as far as the record shows it.
    pub(super) tick: u64,
    pub(super) version: u64,
}

/// One record.
#[derive(Debug)]
pub(super) struct Record {
    /// Its name in legends.
    pub(super) name: String,
    /// Its files.
    pub(super) files: Vec<PathBuf>,
    /// Those that end early.
    pub(super) ended_early: Vec<PathBuf>,
    /// Number of messages that could not be read.
    pub(super) passed_over: u64,
    pub(super) head: Head,
    /// \[s\].
    pub(super) period: f64,
    pub(super) summary: Summary,
    /// Topics of which there is at least one message.
    pub(super) topics: BTreeSet<Topic>,
    /// By tick.
    pub(super) states: Vec<StateTick>,
    /// By tick.
    pub(super) truths: Vec<TruthRow>,
    /// By tick.
    pub(super) plans: Vec<PlanTick>,
    /// Usable ticks in order: the learner can learn from the period before.
    pub(super) usable: Vec<u64>,
    /// In the order of the record.
    pub(super) published: Vec<Published>,
    /// By version, where the record has it \[(m/s)², (m/s)², (rad/s)²\].
    pub(super) sample_variance: BTreeMap<u64, [f64; 3]>,
    /// Targets of the goals \[m, m, rad\].
    pub(super) goals: Vec<[f64; 3]>,
    /// Where obstacles were.
    pub(super) obstacles: Vec<Outline>,
    pub(super) events: Vec<Event>,
    /// Number of further events.
    pub(super) events_more: u64,
}

impl Record {
    /// Reads the record at `path`: a file, or a run directory.
    pub(super) fn read(path: &Path) -> Result<Self, ReportError> {
        let files = reader::files(path)?;
        let mut reading = Reading { rows: Rows::of_segments(files.len()), ..Reading::default() };
        let ended_early = reader::all_messages(&files, |message| {
            reading.take(message);
            Ok::<(), ReportError>(())
        })?;
        let first = files.first().map_or(path, PathBuf::as_path);
        let head = reader::head(first)
            .map_err(|source| SourceError::Read { path: first.to_owned(), source })?;
        if reading.states.is_empty() {
            return Err(ReportError::NoStates { path: path.to_owned() });
        }
        let period_nanos = head.period_nanos.filter(|&nanos| nanos <= PERIOD_NANOS_MAX);
        let period_nanos =
            period_nanos.ok_or_else(|| ReportError::NoPeriod { path: first.to_owned() })?;
        reading.read_injected(path, &head, period_nanos);
        Ok(reading.finish(name_of(path), files, ended_early, head, period_nanos))
    }

    /// Time of a tick \[s\].
    pub(super) fn time(&self, tick: u64) -> f64 {
        tick as f64 * self.period
    }

    /// The period in milliseconds, for display \[ms\].
    pub(super) fn period_millis(&self) -> f64 {
        (1e6 * self.period).round() / 1e3
    }

    /// Whether a learned model was in use at any time.
    pub(super) fn learned(&self) -> bool {
        self.plans.iter().any(|plan| plan.version > 0 && plan.learned_axes > 0)
    }

    /// The plan of a tick.
    pub(super) fn plan_at(&self, tick: u64) -> Option<&PlanTick> {
        self.plans
            .binary_search_by_key(&tick, |plan| plan.tick)
            .ok()
            .and_then(|index| self.plans.get(index))
    }

    /// Position of the robot at each tick: the true one, or the measured one in a record without
    /// truth.
    pub(super) fn motion(&self) -> Box<dyn Iterator<Item = (u64, [f64; 3], [f64; 3])> + '_> {
        if self.truths.is_empty() {
            Box::new(self.states.iter().map(|state| (state.tick, state.pose, state.velocity)))
        } else {
            Box::new(self.truths.iter().map(|truth| (truth.stamp.tick, truth.pose, truth.velocity)))
        }
    }

    /// Last time in the record \[s\].
    pub(super) fn end(&self) -> f64 {
        self.states.last().map_or(0.0, |state| self.time(state.tick))
    }
}

/// Name of the run directory for the record of a run, that of the file for any other.
fn name_of(path: &Path) -> String {
    let absolute = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let stem =
        absolute.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let folder = if absolute.is_dir() {
        Some(absolute.as_path())
    } else {
        absolute.parent().filter(|_| stem == "record")
    };
    folder.and_then(Path::file_name).map_or(stem, |name| name.to_string_lossy().into_owned())
}

/// Data read so far.
#[derive(Debug, Default)]
struct Reading {
    rows: Rows,
    /// Last epoch of the plant.
    epoch: u64,
    topics: BTreeSet<Topic>,
    states: Vec<StateTick>,
    plans: Vec<PlanTick>,
    usable: Vec<u64>,
    published: Vec<Published>,
    sample_variance: BTreeMap<u64, [f64; 3]>,
    /// By number.
    goals: BTreeMap<u64, [f64; 3]>,
    /// By cell.
    obstacles: BTreeMap<Vec<i64>, Outline>,
    log: Log,
    passed_over: u64,
    /// Tick of the last state.
    tick: u64,
    /// Clock and tick of the first state.
    began: Option<(u64, u64)>,
}

#[derive(Deserialize)]
struct Stamped {
    stamp: Mark,
}

impl Reading {
    fn take(&mut self, message: &Message<'_>) {
        if message.channel.topic == changes::CHANNEL {
            // Each file repeats the earlier changes.
            return self.log.receive_change(&message.data);
        }
        let Some(topic) =
            Topic::ALL.into_iter().find(|topic| topic.name() == message.channel.topic)
        else {
            return;
        };
        match self.add(topic, &message.data, message.log_time) {
            Ok(()) => {
                self.topics.insert(topic);
            }
            Err(error) => {
                tracing::warn!(topic = topic.name(), %error, "message skipped");
                self.passed_over += 1;
            }
        }
    }

    fn add(&mut self, topic: Topic, json: &[u8], sent_nanos: u64) -> Result<(), serde_json::Error> {
        match topic {
            Topic::State => {
                let (row, state, words) = serde_json::from_slice::<State>(json)?.parts();
                if self.rows.add_state(row) && self.belongs(words.epoch) {
                    self.states.push(state);
                    self.tick = state.tick;
                    self.began.get_or_insert((sent_nanos, state.tick));
                    self.log.receive_gate(&words);
                }
            }
            Topic::Truth => {
                let row: TruthRow = serde_json::from_slice(json)?;
                self.rows.add_truth(row);
            }
            Topic::Plan => {
                let (row, plan) = serde_json::from_slice::<Plan>(json)?.parts();
                if self.rows.add_plan(row) && self.belongs(row.plant_epoch) {
                    self.plans.push(plan);
                }
            }
            Topic::Residual => {
                let sample: Sample = serde_json::from_slice(json)?;
                if self.rows.count(topic, sample.stamp)
                    && sample.usable == 1
                    && self.belongs(sample.plant_epoch)
                {
                    self.usable.push(sample.stamp.tick);
                }
            }
            Topic::Snapshot => {
                let Snapshot { stamp, version, sample_variance } = serde_json::from_slice(json)?;
                if self.rows.count(topic, stamp) {
                    self.published.push(Published { tick: self.tick, version });
                    if let Some(variance) = sample_variance {
                        self.sample_variance
                            .insert(version, variance.map(|variance| variance.unwrap_or(f64::NAN)));
                    }
                }
            }
            Topic::Health => {
                let health: Health = serde_json::from_slice(json)?;
                if self.rows.add_health(health.row()) {
                    self.log.receive_health(&health);
                }
            }
            Topic::Command => {
                let Stamped { stamp } = serde_json::from_slice(json)?;
                self.rows.add_command(stamp);
            }
            Topic::Goal => {
                let goal: Goal = serde_json::from_slice(json)?;
                if self.rows.count(topic, goal.stamp) && self.belongs(goal.plant_epoch) {
                    self.goals.insert(goal.id, goal.target);
                    self.log.receive_goal(&goal);
                }
            }
            Topic::Obstacles => {
                let list: Obstacles = serde_json::from_slice(json)?;
                if self.rows.count(topic, list.stamp) && self.belongs(list.plant_epoch) {
                    for outline in list.outlines() {
                        self.add_obstacle(outline);
                    }
                }
            }
            Topic::Credit => {}
        }
        Ok(())
    }

    /// Keeps an outline unless there is one in the same cell.
    fn add_obstacle(&mut self, outline: Outline) {
        let cell_m = if outline.moves { MOVING_CELL_M } else { STANDING_CELL_M };
        let cell = |value: f64| (value / cell_m).round() as i64;
        let corners = outline.corners.iter().flat_map(|&(x, y)| [cell(x), cell(y)]);
        let key = corners.chain([cell(outline.radius)]).collect();
        if self.obstacles.len() < OUTLINES_MAX {
            self.obstacles.entry(key).or_insert(outline);
        }
    }

    /// Whether a message of this epoch of the plant belongs to its last run. The first message of a
    /// new epoch ends the run before.
    fn belongs(&mut self, epoch: u64) -> bool {
        if epoch > self.epoch {
            self.epoch = epoch;
            (self.states, self.plans, self.usable, self.published) =
                (Vec::new(), Vec::new(), Vec::new(), Vec::new());
            (self.goals, self.obstacles) = (BTreeMap::new(), BTreeMap::new());
            (self.tick, self.began) = (0, None);
            self.log.start_over();
        }
        epoch == self.epoch
    }

    /// In real time the machine's clock gives the tick at which a fault was injected.
    fn read_injected(&mut self, path: &Path, head: &Head, period_nanos: u64) {
        let folder = if path.is_dir() { Some(path) } else { path.parent() };
        let (Some((began, first)), Some(folder), "real-time") =
            (self.began, folder, head.pace.as_str())
        else {
            return;
        };
        let last = self.tick;
        self.log.read_injected(folder, |nanos| {
            let tick = first.saturating_add(nanos.checked_sub(began)? / period_nanos);
            (tick <= last).then_some(tick)
        });
    }

    fn finish(
        mut self,
        name: String,
        files: Vec<PathBuf>,
        ended_early: Vec<PathBuf>,
        head: Head,
        period_nanos: u64,
    ) -> Record {
        self.states.sort_by_key(|state| state.tick);
        self.states.dedup_by_key(|state| state.tick);
        self.plans.sort_by_key(|plan| plan.tick);
        self.plans.dedup_by_key(|plan| plan.tick);
        self.usable.sort_unstable();
        self.usable.dedup();
        let summary = Summary::of(&self.rows, period_nanos);
        let epoch = self.epoch;
        let mut truths = self.rows.truths;
        truths.retain(|truth| truth.stamp.epoch == epoch);
        truths.sort_by_key(|truth| truth.stamp.tick);
        let (events, events_more) = self.log.finish();
        Record {
            name,
            files,
            ended_early,
            passed_over: self.passed_over,
            head,
            period: period_nanos as f64 / 1e9,
            summary,
            topics: self.topics,
            states: self.states,
            truths,
            plans: self.plans,
            usable: self.usable,
            published: self.published,
            sample_variance: self.sample_variance,
            goals: self.goals.into_values().collect(),
            obstacles: self.obstacles.into_values().collect(),
            events,
            events_more,
        }
    }
}
