//! Health, PlantState → one line for every fault, and for its end.

use protocol::message::{FallbackLevel, Health, Participant, Phase, PlantState, Reason};
use serde::Serialize;
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Largest number of stored lines.
const ENTRIES_MAX: usize = 60;
/// Shortest time between two lines of a continuing fault.
const COUNTS_EVERY: Duration = Duration::from_secs(1);
/// Ten heartbeats.
pub(super) const SILENCE: Duration = Duration::from_secs(1);

/// Kind of a line.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Sort {
    /// A fault.
    Fault,
    /// The end of a fault.
    Mended,
    /// A change.
    Note,
}

/// One line.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct Entry {
    /// Counts the lines of one gateway, from 1.
    n: u64,
    /// Simulated time \[s\].
    t: f64,
    sort: Sort,
    who: &'static str,
    text: String,
}

/// The last lines.
#[derive(Debug, Default)]
pub(super) struct Logbook {
    entries: VecDeque<Entry>,
    written: u64,
}

impl Logbook {
    pub(super) fn write(&mut self, seconds: f64, who: Participant, sort: Sort, text: String) {
        self.written += 1;
        self.entries.push_back(Entry {
            n: self.written,
            t: super::round(seconds),
            sort,
            who: who.text(),
            text,
        });
        if self.entries.len() > ENTRIES_MAX {
            self.entries.pop_front();
        }
    }

    /// The lines after the first `told`.
    pub(super) fn since(&self, told: u64) -> Vec<&Entry> {
        self.entries.iter().filter(|entry| entry.n > told).collect()
    }

    /// Number of lines written so far.
    pub(super) fn written(&self) -> u64 {
        self.written
    }
}

/// The last messages of one process, and the reported part of them.
#[derive(Debug)]
pub(super) struct Process {
    pub(super) health: Health,
    pub(super) heard: Instant,
    pub(super) starts: u32,
    silent: bool,
    counted: [u64; COUNTED.len()],
    counts_next: Instant,
}

/// Counters of a Health whose growth is reported: counter, kind, text for one, text for many.
type Counter = (fn(&Health) -> u64, Sort, &'static str, &'static str);
const COUNTED: [Counter; 5] = [
    (
        |health| health.lost.iter().sum(),
        Sort::Fault,
        "message lost on the way to it",
        "messages lost on the way to it",
    ),
    (
        |health| health.refused.iter().sum(),
        Sort::Fault,
        "malformed message refused",
        "malformed messages refused",
    ),
    (|health| health.deadlines_missed, Sort::Fault, "period missed", "periods missed"),
    (
        |health| health.snapshots_refused,
        Sort::Fault,
        "learned model refused",
        "learned models refused",
    ),
    (
        |health| health.models_left,
        Sort::Note,
        "axis where the learned model was dropped, because it was worse than none",
        "axes where the learned model was dropped",
    ),
];

impl Process {
    /// A process after its first message.
    pub(super) fn new(health: &Health, now: Instant) -> Self {
        Self {
            health: *health,
            heard: now,
            starts: 1,
            silent: false,
            counted: COUNTED.map(|(count, ..)| count(health)),
            counts_next: now,
        }
    }

    /// Processes its new health, and reports the changes.
    pub(super) fn take_in(
        &mut self,
        health: &Health,
        now: Instant,
        mut tell: impl FnMut(Sort, String),
    ) {
        let before = std::mem::replace(&mut self.health, *health);
        self.heard = now;
        let another = before.pid != health.pid;
        if another {
            self.starts += 1;
            self.counted = [0; COUNTED.len()];
            tell(Sort::Mended, format!("started again, as process {}", health.pid));
        } else if self.silent {
            tell(Sort::Mended, "sends messages again".to_owned());
        }
        self.silent = false;
        let (phase, error) = (health.phase(), health.last_error());
        if !error.is_empty() && (another || error != before.last_error()) {
            tell(if phase == Phase::Degraded { Sort::Fault } else { Sort::Note }, error.to_owned());
        } else if phase != before.phase() && phase == Phase::Degraded {
            tell(Sort::Fault, "runs with something missing".to_owned());
        } else if before.phase() == Phase::Degraded && phase == Phase::Running && !another {
            tell(Sort::Mended, "has recovered".to_owned());
        } else if phase != before.phase() && phase == Phase::Finished {
            tell(Sort::Note, "has finished".to_owned());
        }
        if now >= self.counts_next {
            self.tell_counts(now, tell);
        }
    }

    fn tell_counts(&mut self, now: Instant, mut tell: impl FnMut(Sort, String)) {
        for ((count, sort, one, many), told) in COUNTED.iter().zip(&mut self.counted) {
            let newest = count(&self.health);
            let more = newest.saturating_sub(*told);
            *told = newest;
            if more > 0 {
                tell(*sort, format!("{more} {}", if more == 1 { one } else { many }));
                self.counts_next = now + COUNTS_EVERY;
            }
        }
    }

    /// Whether it has become silent since the last check. A finished process may be silent.
    pub(super) fn falls_silent(&mut self, now: Instant) -> bool {
        let silent = now.saturating_duration_since(self.heard) > SILENCE
            && self.health.phase() != Phase::Finished;
        !std::mem::replace(&mut self.silent, silent) && silent
    }

    /// Whether it is silent.
    pub(super) fn is_silent(&self) -> bool {
        self.silent
    }
}

/// The change of the gate's fallback level, if there is one.
pub(super) fn gate_change(before: &PlantState, state: &PlantState) -> Option<(Sort, String)> {
    let (from, to) = (before.fallback_level(), state.fallback_level());
    if from == to {
        return None;
    }
    let sort = match to {
        FallbackLevel::FreshPlan => Sort::Mended,
        FallbackLevel::Waiting => Sort::Note,
        _ if from < to => Sort::Fault,
        _ => Sort::Note,
    };
    let untold = to == FallbackLevel::FreshPlan || state.cause() == Reason::None;
    let why = if untold { String::new() } else { format!(" ({})", state.cause()) };
    Some((sort, format!("{from} → {to}{why}")))
}

#[cfg(test)]
mod tests {
    use super::*;
    use bytemuck::Zeroable;

    fn health(pid: u32, phase: Phase, error: &str) -> Health {
        let mut health = Health { pid, phase: phase.code(), ..Health::zeroed() };
        health.set_last_error(error);
        health
    }

    #[test]
    fn a_restart_an_error_silence_and_a_loss_are_reported_once_each() {
        let begin = Instant::now();
        let after = |millis| begin + Duration::from_millis(millis);
        let mut process = Process::new(&health(1, Phase::Running, ""), begin);
        let mut reported = Vec::new();
        let mut hear = |process: &mut Process, health: &Health, millis| {
            process.take_in(health, after(millis), |sort, text| reported.push((sort, text)));
        };
        for millis in [100, 200] {
            hear(&mut process, &health(1, Phase::Degraded, "no disk"), millis);
        }
        hear(&mut process, &health(1, Phase::Running, ""), 300);
        assert!(
            !process.falls_silent(after(1200))
                && process.falls_silent(after(1400))
                && !process.falls_silent(after(1500))
        );
        let mut again = health(2, Phase::Running, "");
        for (lost, millis) in [(0, 1600), (3, 1700), (4, 1800), (5, 1900), (5, 2900)] {
            again.lost[0] = lost;
            hear(&mut process, &again, millis);
        }
        assert_eq!(process.starts, 2);
        let texts: Vec<&str> = reported.iter().map(|(_, text)| text.as_str()).collect();
        let expected = [
            "no disk",
            "has recovered",
            "started again, as process 2",
            "3 messages lost on the way to it",
            "2 messages lost on the way to it",
        ];
        assert_eq!(texts, expected);
    }

    #[test]
    fn a_change_of_the_gates_fallback_level_is_reported() {
        let state = |fallback_level: FallbackLevel, reason: Reason| PlantState {
            fallback_level: fallback_level.code(),
            reason: reason.code(),
            ..PlantState::zeroed()
        };
        let fresh = state(FallbackLevel::FreshPlan, Reason::None);
        let brake = state(FallbackLevel::Brake, Reason::Missing);
        assert_eq!(gate_change(&fresh, &fresh), None);
        assert_eq!(
            gate_change(&fresh, &brake),
            Some((Sort::Fault, "fresh plan → brake (command missing)".to_owned()))
        );
        assert_eq!(
            gate_change(&brake, &fresh),
            Some((Sort::Mended, "brake → fresh plan".to_owned()))
        );
    }

    #[test]
    fn a_logbook_keeps_the_last_lines_and_reports_each_once() {
        let mut logbook = Logbook::default();
        for line in 0..100 {
            logbook.write(0.0, Participant::Plant, Sort::Note, format!("{line}"));
        }
        assert_eq!(
            (
                logbook.since(0).len(),
                logbook.since(99).len(),
                logbook.since(logbook.written()).len()
            ),
            (ENTRIES_MAX, 1, 0)
        );
    }
}
