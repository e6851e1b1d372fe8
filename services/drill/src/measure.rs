//! Record of a run with faults → reaction times, restart times, and violations.
//!
//! | figure         | what it is                                                                  |
//! |----------------|-----------------------------------------------------------------------------|
//! | worst reaction | age of the oldest state, in periods, whose answer still acted on the        |
//! |                | wheels; from 3 on the gate must brake                                       |
//! | worst restart  | from the end of a process to its successor in use: a fresh plan of new      |
//! |                | epochs acted, a snapshot was published, or the process reported ready       |
//!
//! | restart of        | killed, at most | stopped for good, at most (first to be found hung)   |
//! |-------------------|-----------------|------------------------------------------------------|
//! | plant, controller | 1 s             | 1 s in all                                           |
//! | recorder, gateway | 1 s             | 1 s and [`hung_after`](Processes::hung_after), 2.5 s |
//! | learner           | 5 s             | 5 s and the same                                     |

pub mod excuse;

use super::catalogue::Launch;
use super::oracle::{Limits, Rule, Violation, judge};
use super::record::{Message, Record};
use excuse::{Timeline, Unseen, unseen, unseen_in_lock_step};
use graph::file::{Processes, is_needed};
use process::Gap;
use protocol::message::Participant;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt;
use std::ops::Range;
use supervisor::fault_injector::Injected;

/// Longest restart time \[s\].
const BACK_WITHIN_S: f64 = 1.0;
/// Longest restart time of the learner, which is in use when it has published a model \[s\].
const LEARNER_BACK_WITHIN_S: f64 = 5.0;
/// If a process ends this soon after its predecessor, it was still starting. The restart time then
/// counts from its own end. In the catalogue the two ends are at most 300 ms apart, plus one period
/// for the phase \[ns\].
const EARLY_NANOS: u64 = 350_000_000;
/// Longest time for which a command acts \[periods\].
const BRAKES_AFTER: u64 = 3;
/// Longest time below a fresh plan that a fault of at most half a second may cause \[s\].
const BELOW_AT_MOST_S: f64 = 2.5;

/// Result of an exercise.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Measured {
    /// Number of injected faults.
    pub injections: u64,
    /// The violations, one line each.
    pub violations: Vec<String>,
    /// Worst reaction \[T\].
    pub worst_reaction: Option<f64>,
    /// Worst restart \[s\].
    pub worst_restart: Option<f64>,
    /// Periods below a fresh plan in which the machine let no process run. Counted only where no
    /// process that the robot needs was disturbed.
    pub excused: usize,
    /// Largest distance from the reference, as a share of its bound.
    pub tracking: Option<f64>,
    /// Why the exercise cannot be done on this machine.
    pub impossible: Option<&'static str>,
    /// Other measurements, one sentence each.
    pub notes: Vec<String>,
}

impl Measured {
    /// Result of an exercise that could not be done.
    pub fn not_done(trouble: impl fmt::Display) -> Self {
        Self { violations: vec![format!("it could not be done: {trouble}")], ..Self::default() }
    }
}

/// Judges a launch with faults. `gaps` are the times in which the machine let no process run.
pub fn measure(
    record: &Record,
    launch: &Launch,
    limits: &Limits,
    injected: &[Injected],
    gaps: &[Gap],
) -> Measured {
    let within = |windows: &[Range<u64>], tick| {
        windows.iter().any(|ticks| acts_until(ticks).contains(&tick))
    };
    // Where the gate slows the robot before an obstacle, it changes what the controller sent.
    let slowed: BTreeSet<(u64, u64)> = record
        .of("state")
        .filter(|state| is_slowed(state))
        .map(|state| (state.stamp("epoch"), state.stamp("tick")))
        .collect();
    // The controller is not responsible for what a link has changed.
    let known = |found: &Violation| match found.rule {
        Rule::AsCommanded => {
            within(&launch.misquoted, found.tick) || slowed.contains(&(found.epoch, found.tick))
        }
        // A slowed input is one that the controller does not know. Rule `Leap` still holds.
        Rule::Rate => {
            within(&launch.misquoted, found.tick)
                || within(&launch.misled, found.tick)
                || [0, 1]
                    .iter()
                    .any(|ago| slowed.contains(&(found.epoch, found.tick.saturating_sub(*ago))))
        }
        _ => false,
    };
    let mut violations: Vec<String> = judge(record, limits)
        .iter()
        .filter(|found| !known(found))
        .map(ToString::to_string)
        .collect();
    let worst_restart =
        launch.restarts.and_then(|who| judge_restarts(record, who, injected, &mut violations));
    let states = states(record);
    let excused = judge_driving(&states, launch, limits.period_s, gaps, &mut violations);
    let excused = if launch.undisturbed { excused } else { 0 };
    let fallen = states.iter().filter(|state| fell(state)).count() as u64;
    if let Some(asked) = launch.answered.filter(|&asked| asked != fallen) {
        violations.push(format!(
            "{fallen} periods were answered without the optimiser, expected {asked}"
        ));
    }
    let in_the_dark = if launch.undisturbed {
        judge_instances(&states, &mut violations);
        let unseen = if launch.lock_step {
            unseen_in_lock_step(record, &states)
        } else {
            unseen(record, &states, limits.period_s, gaps)
        };
        judge_unseen(unseen, &mut violations)
    } else {
        0
    };
    let injections = if launch.answered.is_some() { fallen } else { injected.len() as u64 };
    let excused = excused + in_the_dark;
    Measured {
        injections,
        violations,
        worst_reaction: worst_reaction(record, limits),
        worst_restart,
        excused,
        ..Measured::default()
    }
}

/// Ticks whose truth depends on messages received in `ticks`: the tail of the last command acts
/// until the brake.
pub(super) fn acts_until(ticks: &Range<u64>) -> Range<u64> {
    ticks.start..ticks.end + BRAKES_AFTER
}

/// Age of the oldest state whose answer acted \[T\].
pub fn worst_reaction(record: &Record, limits: &Limits) -> Option<f64> {
    let acting = record.of("truth").filter(|truth| truth.count("acting_epoch") > 0);
    acting
        .map(|truth| truth.count("acting_age_nanos") as f64 * 1e-9 / limits.period_s)
        .reduce(f64::max)
}

/// States in the order of time, each once.
fn states(record: &Record) -> Vec<&Message> {
    let mut seen = BTreeSet::new();
    record
        .of("state")
        .filter(|state| seen.insert((state.stamp("epoch"), state.stamp("tick"))))
        .collect()
}

/// No plant and no controller was restarted, since no fault ended one.
fn judge_instances(states: &[&Message], violations: &mut Vec<String>) {
    let plants: BTreeSet<u64> = states.iter().map(|state| state.stamp("epoch")).collect();
    let controllers: BTreeSet<u64> = states
        .iter()
        .map(|state| state.count("accepted_epoch"))
        .filter(|&epoch| epoch > 0)
        .collect();
    for (who, count) in [("plants", plants.len()), ("controllers", controllers.len())] {
        if count > 1 {
            violations.push(format!(
                "{count} {who} one after the other, expected one: \
                 no process that the robot needs was touched"
            ));
        }
    }
}

/// No period was missed while the recorder was dead, except those that a gap excuses. Returns the
/// number of excused periods.
fn judge_unseen(unseen: Unseen, violations: &mut Vec<String>) -> usize {
    let Unseen { missed, unexcused } = unseen;
    if unexcused > 0 {
        violations.push(format!(
            "{missed} periods were missed that are not in the record, {unexcused} of them without \
             a late wake-up at that time: no process that the robot needs was touched"
        ));
    }
    (missed - unexcused) as usize
}

/// Whether the robot is latched because it was too far from its reference.
pub(super) fn is_stopped_astray(state: &Message) -> bool {
    state.word("fallback_level") == "latched stop"
        && matches!(state.word("reason"), "position error" | "heading error")
}

/// Whether the gate slowed the robot before an obstacle in the period that `state` reports.
pub(super) fn is_slowed(state: &Message) -> bool {
    state.word("reason") == "protective stop"
}

/// Whether no controller answered the period in time.
fn is_missed(state: &Message) -> bool {
    matches!(state.word("fallback_level"), "stored tail" | "brake" | "latched stop")
}

/// Whether the answer came from a controller whose optimiser had no plan.
fn fell(state: &Message) -> bool {
    matches!(state.word("fallback_level"), "shifted plan" | "simple controller")
}

/// The longest restart time of `who`. Each restart that took too long is a violation.
fn judge_restarts(
    record: &Record,
    who: Participant,
    injected: &[Injected],
    violations: &mut Vec<String>,
) -> Option<f64> {
    let hung_after = Processes::default().hung_after(who).as_millis() as u64;
    let ends = |fault: &&Injected| {
        fault.participant == Some(who) && fault.millis.is_none_or(|millis| millis > hung_after)
    };
    let ended: Vec<&Injected> = injected.iter().filter(ends).collect();
    let back = comebacks(record, who);
    let (mut worst, mut since) = (None, None);
    for (index, &fault) in ended.iter().enumerate() {
        let at = fault.nanos;
        let next = back.iter().copied().find(|&back| back > at);
        let again = ended.get(index + 1).map(|fault| fault.nanos);
        if let Some(again) = again.filter(|&again| next.is_none_or(|next| next > again)) {
            // It ended again while it restarted: either on purpose, or because it was late.
            since = since.or((again - at > EARLY_NANOS).then_some(fault));
            continue;
        }
        let Some(next) = next else {
            violations.push(format!("{who} was never in use again after fault {index}"));
            continue;
        };
        let since = since.take().unwrap_or(fault);
        let (took, limit) = ((next - since.nanos) as f64 * 1e-9, back_within_s(who, since));
        if took > limit {
            violations.push(format!(
                "{who} was in use again {took:.2} s after fault {index}, expected {limit} s at most"
            ));
        }
        worst = Some(took.max(worst.unwrap_or(0.0)));
    }
    worst
}

/// Longest permitted restart time of `who` after `fault` \[s\].
fn back_within_s(who: Participant, fault: &Injected) -> f64 {
    let way = if who == Participant::Learner { LEARNER_BACK_WITHIN_S } else { BACK_WITHIN_S };
    let stopped = fault.millis.is_some() && !is_needed(who);
    if stopped { way + Processes::default().hung_after(who).as_secs_f64() } else { way }
}

/// When each instance of `who` was in use for the first time, on the monotonic clock \[ns\].
fn comebacks(record: &Record, who: Participant) -> Vec<u64> {
    let mut seen = BTreeSet::new();
    let first = |instance: (u64, u64), at: u64| seen.insert(instance).then_some(at);
    let mut back: Vec<u64> = match who {
        Participant::Plant | Participant::Controller => {
            let fresh =
                record.of("state").filter(|state| state.word("fallback_level") == "fresh plan");
            let instances = fresh.map(|state| {
                ((state.stamp("epoch"), state.count("accepted_epoch")), state.stamp("sent_nanos"))
            });
            let mut first = first;
            instances.filter_map(|(instance, at)| first(instance, at)).collect()
        }
        Participant::Learner => {
            let mut first = first;
            record
                .of("snapshot")
                .filter_map(|snapshot| {
                    first((snapshot.stamp("writer"), 0), snapshot.stamp("sent_nanos"))
                })
                .collect()
        }
        Participant::Recorder | Participant::Gateway | Participant::Bridge => {
            let ready = record
                .health_of(who.text())
                .filter(|health| matches!(health.word("phase"), "ready" | "running"));
            let mut first = first;
            ready
                .filter_map(|health| first((health.stamp("writer"), 0), health.stamp("sent_nanos")))
                .collect()
        }
    };
    back.sort_unstable();
    back
}

/// Whether the robot drove where it should have, and at the end of the run. Returns the number of
/// excused periods below a fresh plan.
fn judge_driving(
    states: &[&Message],
    launch: &Launch,
    period_s: f64,
    gaps: &[Gap],
    violations: &mut Vec<String>,
) -> usize {
    // A robot that is known to leave its path ends latched, as it should.
    let stops = |state: &Message| launch.goes_astray.is_some() && is_stopped_astray(state);
    let below = |state: &Message| {
        !matches!(state.word("fallback_level"), "fresh plan" | "waiting") && !stops(state)
    };
    let epochs: BTreeSet<u64> = states.iter().map(|state| state.stamp("epoch")).collect();
    let timelines: BTreeMap<u64, Timeline> =
        epochs.into_iter().map(|epoch| (epoch, Timeline::of(states, epoch, period_s))).collect();
    let excused = |state: &Message| {
        let timeline = timelines.get(&state.stamp("epoch"));
        !launch.lock_step
            && timeline.is_some_and(|timeline| timeline.is_excused(state.stamp("tick"), gaps))
    };
    let (mut unexcused, mut count) = (Vec::new(), 0);
    let mut before = false; // whether the previous period was below a fresh plan, and excused
    for (index, state) in states.iter().enumerate() {
        if !below(state) {
            before = false;
            continue;
        }
        // Leaving an excused brake takes further periods.
        before = excused(state) || before && state.word("reason") == "recovering";
        if before {
            count += 1;
        } else {
            unexcused.push(index);
        }
    }
    if launch.undisturbed || launch.answered.is_some() {
        for state in unexcused
            .iter()
            .filter_map(|&index| states.get(index))
            .filter(|state| launch.undisturbed || !fell(state))
        {
            let (tick, fallback_level, reason) =
                (state.stamp("tick"), state.word("fallback_level"), state.word("reason"));
            let expected = if launch.undisturbed {
                "fresh plans alone: no process that the robot needs was touched"
            } else {
                "an answer of the controller"
            };
            violations
                .push(format!("{fallback_level} ({reason}) at tick {tick}, expected {expected}"));
        }
    }
    match states.last() {
        None => violations.push("nothing is in the record".to_owned()),
        Some(_) if states.iter().all(|state| state.word("fallback_level") == "waiting") => {
            violations.push("it never drove".to_owned());
        }
        Some(_) if unexcused.last() == Some(&(states.len() - 1)) => {
            violations.push("it does not drive at the end".to_owned());
        }
        Some(_) => {}
    }
    if !launch.lock_step {
        judge_stretches(states, below, violations);
    }
    count
}

/// No time below a fresh plan is too long.
fn judge_stretches(
    states: &[&Message],
    below: impl Fn(&Message) -> bool,
    violations: &mut Vec<String>,
) {
    let mut begin = None;
    for state in states {
        let now = state.stamp("sent_nanos");
        if !below(state) {
            begin = None;
            continue;
        }
        let lasted = now.saturating_sub(*begin.get_or_insert(now)) as f64 * 1e-9;
        if lasted > BELOW_AT_MOST_S {
            violations.push(format!(
                "below a fresh plan for {lasted:.1} s until tick {}, \
                 expected {BELOW_AT_MOST_S} s at most",
                state.stamp("tick")
            ));
            return;
        }
    }
}

#[cfg(test)]
mod tests;
