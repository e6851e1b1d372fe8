//! Gate, health and list of injected faults → events and their times.

use super::recorded::{GateWords, Goal, Health};
use process::requests::{Outcome, Settled};
use protocol::message::FallbackLevel;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Largest number of stored events; more are only counted.
const EVENTS_MAX: usize = 500;

/// Equal events within this number of ticks are one event.
const SAME_WITHIN_TICKS: u64 = 20;

/// One event, perhaps several times in a row.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Event {
    /// First tick.
    pub(super) tick: u64,
    /// Last tick.
    pub(super) until: u64,
    /// Description.
    pub(super) what: String,
    /// Number of occurrences.
    pub(super) count: u64,
}

/// Collects events in the order of the record.
#[derive(Debug, Default)]
pub(super) struct Log {
    events: Vec<Event>,
    more: u64,
    fallback_level: Option<FallbackLevel>,
    refused: Option<u64>,
    /// Number and phase of the last goal.
    goal: Option<(u64, String)>,
    /// By participant: its process instance and its last counters.
    roles: BTreeMap<String, Role>,
    /// Changes of settings, by process and number.
    changes: BTreeSet<(String, u64)>,
    /// Tick of the last message.
    tick: u64,
}

#[derive(Debug, Default)]
struct Role {
    writer: u64,
    models_left: u64,
    snapshots_refused: u64,
    lost: u64,
    last_error: String,
}

/// One line of `injected.jsonl`.
#[derive(Debug, Deserialize)]
struct Injected {
    kind: String,
    participant: Option<String>,
    nanos: u64,
    millis: Option<u64>,
}

impl Log {
    /// Drops the events of an earlier plant, but keeps the processes.
    pub(super) fn start_over(&mut self) {
        (self.events, self.more) = (Vec::new(), 0);
        (self.fallback_level, self.refused, self.goal, self.tick) = (None, None, None, 0);
    }

    /// Reads what the gate did in a period.
    pub(super) fn receive_gate(&mut self, words: &GateWords) {
        self.tick = self.tick.max(words.tick);
        let reason =
            if words.reason == "-" { String::new() } else { format!(" ({})", words.reason) };
        if self.fallback_level.replace(words.fallback_level) != Some(words.fallback_level)
            && !matches!(words.fallback_level, FallbackLevel::FreshPlan | FallbackLevel::Waiting)
        {
            self.note(words.tick, format!("fallback level: {}{reason}", words.fallback_level));
        }
        let refused = self.refused.replace(words.refused);
        if refused.is_some_and(|before| words.refused > before) {
            self.note(words.tick, format!("the gate rejected a command{reason}"));
        }
        if words.is_slowed {
            self.note(words.tick, format!("the gate slowed the robot{reason}"));
        }
    }

    /// Reads how far a goal is.
    pub(super) fn receive_goal(&mut self, goal: &Goal) {
        let now = (goal.id, goal.phase.clone());
        if self.goal.as_ref() != Some(&now) {
            let [x, y, yaw] = goal.target;
            let what = format!(
                "goal {} ({} to {x:.2} m, {y:.2} m, {yaw:.2} rad): {}",
                goal.id, goal.kind, goal.phase
            );
            self.note(goal.stamp.tick, what);
            self.goal = Some(now);
        }
    }

    /// Reads the health of a process.
    pub(super) fn receive_health(&mut self, health: &Health) {
        let (tick, who, lost) = (self.tick, &health.participant, health.lost());
        let mut told = Vec::new();
        let role = self
            .roles
            .entry(who.clone())
            .or_insert_with(|| Role { writer: health.stamp.writer, ..Role::default() });
        if role.writer != health.stamp.writer {
            *role = Role { writer: health.stamp.writer, ..Role::default() };
            told.push(format!("{who}: replaced by another process"));
        }
        if health.models_left > role.models_left {
            told.push(format!("{who}: dropped a model on an axis, where it was worse than none"));
        }
        if health.snapshots_refused > role.snapshots_refused {
            told.push(format!("{who}: rejected a model"));
        }
        if lost > role.lost {
            told.push(format!("{who}: lost messages on its links"));
        }
        if health.last_error != role.last_error && !health.last_error.is_empty() {
            told.push(format!("{who}: {}", health.last_error));
        }
        (role.models_left, role.snapshots_refused, role.lost) =
            (health.models_left, health.snapshots_refused, lost);
        role.last_error.clone_from(&health.last_error);
        for what in told {
            self.note(tick, what);
        }
    }

    /// Reads a change of settings, accepted or rejected. Skips repeated and unreadable ones.
    pub(super) fn receive_change(&mut self, json: &[u8]) {
        let Ok(settled) = serde_json::from_slice::<Settled>(json) else { return };
        if !self.changes.insert((settled.process.clone(), settled.number)) {
            return;
        }
        let tick = if let Outcome::Applied { acts_from_tick, .. } = settled.answer.outcome {
            acts_from_tick
        } else {
            self.tick
        };
        self.note(tick, settled.to_string());
    }

    /// Reads the list of injected process faults, if there is one in `folder`. `tick_at` returns
    /// the tick of a time.
    pub(super) fn read_injected(&mut self, folder: &Path, tick_at: impl Fn(u64) -> Option<u64>) {
        let list = fs::read_to_string(folder.join("injected.jsonl")).unwrap_or_default();
        for injected in list.lines().filter_map(|line| serde_json::from_str::<Injected>(line).ok())
        {
            let Some(tick) = tick_at(injected.nanos) else { continue };
            let whom = injected
                .participant
                .map_or_else(String::new, |participant| format!(" {participant}"));
            let lasts =
                injected.millis.map_or_else(String::new, |millis| format!(" for {millis} ms"));
            self.note(tick, format!("injected: {}{whom}{lasts}", injected.kind));
        }
    }

    fn note(&mut self, tick: u64, what: String) {
        let mut recent = self.events.iter_mut().rev().take(8);
        let same = recent.find(|event| {
            event.what == what && tick.saturating_sub(event.until) <= SAME_WITHIN_TICKS
        });
        if let Some(event) = same {
            (event.until, event.count) = (event.until.max(tick), event.count + 1);
        } else if self.events.len() < EVENTS_MAX {
            self.events.push(Event { tick, until: tick, what, count: 1 });
        } else {
            self.more += 1;
        }
    }

    /// The events in the order of time, and the number of further ones.
    pub(super) fn finish(mut self) -> (Vec<Event>, u64) {
        self.events.sort_by_key(|event| event.tick);
        (self.events, self.more)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rows::Mark;

    fn gate(tick: u64, fallback_level: FallbackLevel, refused: u64) -> GateWords {
        GateWords {
            epoch: 1,
            tick,
            fallback_level,
            reason: "too old".into(),
            is_slowed: false,
            refused,
        }
    }

    #[test]
    fn repeated_events_are_one_event_with_their_number() {
        let mut log = Log::default();
        for tick in 0..100 {
            log.receive_gate(&gate(tick, FallbackLevel::FreshPlan, tick));
        }
        log.receive_gate(&gate(300, FallbackLevel::FreshPlan, 100));
        let (events, more) = log.finish();
        assert_eq!((events.len(), more), (2, 0), "{events:?}");
        assert_eq!((events[0].tick, events[0].until, events[0].count), (1, 99, 99));
        assert_eq!((events[1].tick, events[1].count), (300, 1));
    }

    #[test]
    fn a_stretch_in_which_the_gate_slows_the_robot_is_one_event() {
        let mut log = Log::default();
        for tick in 0..200 {
            let is_slowed = (40..90).contains(&tick) || (150..160).contains(&tick);
            log.receive_gate(&GateWords { is_slowed, ..gate(tick, FallbackLevel::FreshPlan, 0) });
        }
        let (events, _) = log.finish();
        let stretches: Vec<_> = events.iter().map(|event| (event.tick, event.until)).collect();
        assert_eq!(stretches, [(40, 89), (150, 159)], "{events:?}");
    }

    #[test]
    fn each_phase_of_a_goal_is_one_event() {
        let mut log = Log::default();
        let goal = |tick, id, phase: &str| Goal {
            stamp: Mark { tick, ..Mark::default() },
            id,
            plant_epoch: 1,
            kind: "pose".into(),
            phase: phase.into(),
            target: [1.0, 2.0, 0.5],
        };
        for tick in 0..30 {
            log.receive_goal(&goal(tick, 1, if tick < 20 { "under way" } else { "reached" }));
        }
        log.receive_goal(&goal(30, 2, "under way"));
        let (events, _) = log.finish();
        assert_eq!(events.iter().map(|event| event.tick).collect::<Vec<_>>(), [0, 20, 30]);
    }

    #[test]
    fn leaving_fresh_plans_is_an_event_and_returning_is_not() {
        let mut log = Log::default();
        for (tick, fallback_level) in [
            (0, FallbackLevel::Waiting),
            (1, FallbackLevel::FreshPlan),
            (2, FallbackLevel::StoredTail),
            (3, FallbackLevel::Brake),
            (60, FallbackLevel::FreshPlan),
        ] {
            log.receive_gate(&gate(tick, fallback_level, 0));
        }
        let (events, _) = log.finish();
        let told: Vec<_> = events.iter().map(|event| event.what.as_str()).collect();
        assert_eq!(
            told,
            ["fallback level: stored tail (too old)", "fallback level: brake (too old)"]
        );
    }
}
