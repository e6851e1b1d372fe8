//! messages → the newest of each kind, and the last events.

use crate::event::{Event, What};
use crate::process::Process;
use protocol::message::{
    Exposure, Goal, GoalPhase, Health, ObstacleSource, Obstacles, Participant, PlantState,
};
use std::collections::{BTreeMap, VecDeque};
use std::time::{Duration, Instant};

/// Largest number of stored events.
pub const EVENTS_MAX: usize = 60;

/// Time after its validity for which a list of obstacles is still shown.
const SHOWN_AFTER: Duration = Duration::from_secs(1);

/// The last list of obstacles of one source.
#[derive(Debug, Clone, PartialEq)]
pub struct SeenObstacles {
    /// The list.
    pub list: Box<Obstacles>,
    /// When it was received.
    pub received: Instant,
}

/// The present state of one robot and its processes, and what happened last.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RunView {
    /// Newest state.
    pub state: Option<Box<PlantState>>,
    /// The present goal, or the last one.
    pub goal: Option<Goal>,
    /// Obstacles, by source.
    pub obstacles: BTreeMap<ObstacleSource, SeenObstacles>,
    /// The processes that have sent a Health.
    pub processes: BTreeMap<Participant, Process>,
    events: VecDeque<Event>,
    noted: u64,
}

impl RunView {
    /// Takes in a measured state. Returns whether it begins a new run: it is the state of another
    /// plant.
    pub fn receive_state(&mut self, state: &PlantState) -> bool {
        let Some(before) = self.state.replace(Box::new(*state)) else { return false };
        let another =
            (before.stamp.writer, before.stamp.epoch) != (state.stamp.writer, state.stamp.epoch);
        if another {
            self.obstacles.clear();
            self.note(Participant::Plant, What::NewRun(state.stamp.epoch));
        }
        let (from, to, cause) = (before.fallback_level(), state.fallback_level(), state.cause());
        if (from, before.cause()) != (to, cause) {
            self.note(Participant::Plant, What::Level(from, to, cause));
        }
        if from == to && state.refused > before.refused && !another {
            self.note(Participant::Plant, What::Refused(state.reason()));
        }
        another
    }

    /// Takes in the present goal, or the end of one.
    pub fn receive_goal(&mut self, goal: &Goal) {
        let before = self.goal.replace(*goal).map(|before| (before.id, before.phase));
        if before != Some((goal.id, goal.phase)) {
            self.note(Participant::Controller, What::Goal(*goal));
        }
    }

    /// Takes in a list of obstacles.
    pub fn receive_obstacles(&mut self, list: &Obstacles, now: Instant) {
        let seen = SeenObstacles { list: Box::new(*list), received: now };
        self.obstacles.insert(list.source(), seen);
    }

    /// Takes in the Health of a process. Of a process of another version nothing is known.
    pub fn receive_health(&mut self, health: &Health, now: Instant) {
        let Some(who) = health.participant() else { return };
        let changes = if let Some(process) = self.processes.get_mut(&who) {
            process.update(health, now)
        } else {
            self.processes.insert(who, Process::new(health, now));
            let (phase, error) = (health.phase(), health.last_error());
            if error.is_empty() { Vec::new() } else { vec![What::Error(phase, error.to_owned())] }
        };
        for what in changes {
            self.note(who, what);
        }
    }

    /// Reports the processes that have become silent.
    pub fn look_for_silence(&mut self, now: Instant) {
        let processes = self.processes.iter_mut();
        let silent: Vec<Participant> = processes
            .filter_map(|(who, process)| process.falls_silent(now).then_some(*who))
            .collect();
        for who in silent {
            self.note(who, What::Silent);
        }
    }

    /// Drops the lists of obstacles that are too old to be shown. Returns whether there were any.
    pub fn drop_old_obstacles(&mut self, now: Instant) -> bool {
        let before = self.obstacles.len();
        self.obstacles.retain(|_, seen| {
            let valid = Duration::try_from_secs_f64(seen.list.valid_s).unwrap_or_default();
            now.saturating_duration_since(seen.received) <= valid.saturating_add(SHOWN_AFTER)
        });
        self.obstacles.len() < before
    }

    /// Adds an event.
    pub fn note(&mut self, who: Participant, what: What) {
        self.noted += 1;
        if self.events.len() == EVENTS_MAX {
            self.events.pop_front();
        }
        self.events.push_back(Event { number: self.noted, tick: self.tick(), who, what });
    }

    /// The last events after the first `told`, oldest first.
    pub fn events_since(&self, told: u64) -> impl DoubleEndedIterator<Item = &Event> {
        self.events.iter().filter(move |event| event.number > told)
    }

    /// Number of events so far.
    pub fn noted(&self) -> u64 {
        self.noted
    }

    /// Control period of the newest state; 0 before the first.
    pub fn tick(&self) -> u64 {
        self.state.as_ref().map_or(0, |state| state.stamp.tick)
    }

    /// The worst exposure that the processes report.
    pub fn exposure(&self) -> Exposure {
        let exposures = self.processes.values().map(|process| process.health.exposure());
        exposures.max().unwrap_or(Exposure::Closed)
    }

    /// Target of the goal that the robot is on the way to, or stands at \[m\].
    pub fn target(&self) -> Option<[f64; 2]> {
        let is_shown =
            |goal: &&Goal| matches!(goal.phase(), GoalPhase::Active | GoalPhase::Reached);
        let [x, y, _] = self.goal.as_ref().filter(is_shown)?.target;
        (x.is_finite() && y.is_finite()).then_some([x, y])
    }
}

#[cfg(test)]
mod tests;
