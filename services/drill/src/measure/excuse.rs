//! Times in which the machine let no process run ↔ periods that were missed.
//!
//! A gap excuses a missed period only if the two overlap in time. If the state that reports a
//! period is in the record, its begin and end are known. While the recorder is dead, neither the
//! period nor its time is recorded, but both are bounded:
//!
//! - The plant counts its missed periods in its Health, ten times a second. The periods that it
//!   counts between two Healths, less the recorded missed periods, were missed unseen.
//! - The plant's clock never runs fast. So the state of tick k came at least (k − a) T after that
//!   of an earlier tick a. It came at least (b − k) T before that of a later tick b.
//!
//! So between two Healths a gap excuses at most as many unseen periods as it overlaps. A gap of
//! length L overlaps ⌈L/T⌉ + 1 periods at most, however uncertain their time is. Three missed
//! periods in a row make the gate brake, and leaving the brake takes three more.

use super::super::record::{Message, Record};
use super::{BRAKES_AFTER, is_missed};
use process::Gap;
use std::collections::BTreeMap;
use std::ops::RangeInclusive;

/// Periods that leaving the brake takes.
const RECOVERS_WITHIN: u64 = 3;
/// Largest delay of a state that the plant does not take out of its clock \[ns\].
const LATE_NANOS: u64 = 5_000_000;

/// Periods that were missed while the recorder was dead.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Unseen {
    /// Periods that the plant has counted as missed and that are not in the record.
    pub missed: u64,
    /// Those of them that no gap can explain.
    pub unexcused: u64,
}

/// Times of the recorded states of one plant epoch \[ns\].
#[derive(Debug, Default)]
pub(super) struct Timeline {
    sent: BTreeMap<u64, u64>,
    period_nanos: u64,
}

impl Timeline {
    /// The timeline of the states of `epoch`.
    pub(super) fn of(states: &[&Message], epoch: u64, period_s: f64) -> Self {
        let of_epoch = states.iter().filter(|state| state.stamp("epoch") == epoch);
        Self {
            sent: of_epoch.map(|state| (state.stamp("tick"), state.stamp("sent_nanos"))).collect(),
            period_nanos: (period_s * 1e9).round() as u64,
        }
    }

    /// Bounds of the period before `tick`: its earliest begin and its latest end \[ns\].
    fn period_before(&self, tick: u64) -> (u64, u64) {
        let begins = tick.saturating_sub(1);
        let sent = |tick: u64| self.sent.get(&tick).copied();
        let begin = sent(begins).unwrap_or_else(|| {
            self.sent.range(..begins).next_back().map_or(0, |(&known, &at)| {
                (at + (begins - known) * self.period_nanos).saturating_sub(LATE_NANOS)
            })
        });
        let end = sent(tick).unwrap_or_else(|| {
            self.sent.range(tick..).next().map_or(u64::MAX, |(&known, &at)| {
                (at + LATE_NANOS).saturating_sub((known - tick) * self.period_nanos)
            })
        });
        (begin, end)
    }

    /// Whether a gap overlaps the period that the state of `tick` reports.
    pub(super) fn is_excused(&self, tick: u64, gaps: &[Gap]) -> bool {
        gaps.iter().any(|gap| self.overlaps(tick, gap))
    }

    fn overlaps(&self, tick: u64, gap: &Gap) -> bool {
        let (begin, end) = self.period_before(tick);
        gap.from_nanos < end && begin < gap.to_nanos
    }

    /// The tick whose state the plant was about to publish when it sent a Health at `at` \[ns\].
    /// The plant sends Health at the end of a period, after it has counted that period.
    fn tick_after(&self, at: u64) -> u64 {
        let entry = |(&tick, &sent): (&u64, &u64)| (tick, sent);
        let next = self.sent.iter().map(entry).find(|&(_, sent)| sent > at);
        let before = self.sent.iter().map(entry).rev().find(|&(_, sent)| sent <= at);
        let Some((before, begun)) = before else { return next.map_or(0, |(tick, _)| tick) };
        let periods = (at - begun + self.period_nanos / 2) / self.period_nanos.max(1);
        let guess = before + periods.max(1);
        match next {
            Some((tick, sent)) if sent - at < self.period_nanos / 2 => tick,
            Some((tick, _)) => guess.min((tick - 1).max(before + 1)),
            None => guess,
        }
    }
}

/// Periods that the plant counted as missed while no recorder was running.
pub fn unseen(record: &Record, states: &[&Message], period_s: f64, gaps: &[Gap]) -> Unseen {
    let epoch = states.last().map_or(0, |state| state.stamp("epoch"));
    let timeline = Timeline::of(states, epoch, period_s);
    let missed: BTreeMap<u64, bool> =
        states.iter().map(|state| (state.stamp("tick"), is_missed(state))).collect();
    // A restarted recorder may get a Health twice. Before the first period the count is zero.
    let healths: BTreeMap<u64, (u64, u64)> = record
        .health_of("plant")
        .filter(|health| health.count("deadlines_met") + health.count("deadlines_missed") > 0)
        .map(|health| {
            let at = health.stamp("sent_nanos");
            (health.stamp("sequence"), (at, health.count("deadlines_missed")))
        })
        .collect();
    let gaps = merged(gaps);
    let (mut told, mut counted, mut all) = (0, 0, Unseen::default());
    for &(at, count) in healths.values() {
        let until = timeline.tick_after(at);
        if until <= told {
            continue; // no period has ended since the previous Health
        }
        let ticks = told + 1..=until;
        let seen = missed.range(ticks.clone()).filter(|&(_, &missed)| missed).count() as u64;
        let unseen = count.saturating_sub(counted).saturating_sub(seen);
        if unseen > 0 {
            all.missed += unseen;
            let excused = excusable(&timeline, ticks, &gaps);
            all.unexcused += unseen.saturating_sub(excused);
        }
        (told, counted) = (until, count);
    }
    all
}

/// The same in lock step, where no gap is an excuse and no time bounds a period.
pub fn unseen_in_lock_step(record: &Record, states: &[&Message]) -> Unseen {
    let counted =
        record.health_of("plant").next_back().map_or(0, |health| health.count("deadlines_missed"));
    let seen = states.iter().filter(|state| is_missed(state)).count() as u64;
    let missed = counted.saturating_sub(seen);
    Unseen { missed, unexcused: missed }
}

/// How many of the unrecorded periods that these ticks report are explained by gaps.
fn excusable(timeline: &Timeline, ticks: RangeInclusive<u64>, gaps: &[Gap]) -> u64 {
    let dark: Vec<u64> = ticks.filter(|tick| !timeline.sent.contains_key(tick)).collect();
    let of_gap = |gap: &Gap| {
        let overlapped = dark.iter().filter(|&&tick| timeline.overlaps(tick, gap)).count() as u64;
        let most = (gap.to_nanos - gap.from_nanos).div_ceil(timeline.period_nanos.max(1)) + 1;
        let missed = overlapped.min(most);
        if missed >= BRAKES_AFTER { missed + RECOVERS_WITHIN } else { missed }
    };
    gaps.iter().map(of_gap).sum::<u64>().min(dark.len() as u64)
}

/// Gaps of all processors, merged: gaps that touch become one gap of the machine.
fn merged(gaps: &[Gap]) -> Vec<Gap> {
    let mut sorted = gaps.to_vec();
    sorted.sort_by_key(|gap| gap.from_nanos);
    let mut merged: Vec<Gap> = Vec::new();
    for gap in sorted {
        match merged.last_mut() {
            Some(last) if gap.from_nanos <= last.to_nanos => {
                last.to_nanos = last.to_nanos.max(gap.to_nanos);
            }
            _ => merged.push(gap),
        }
    }
    merged
}
