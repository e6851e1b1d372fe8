//! Record of a run → what went wrong in it: written from the design, and sharing no code with the gate that it judges.
//!
//! | rule | what must hold                                                                                                        |
//! |------|-----------------------------------------------------------------------------------------------------------------------|
//! | a    | every wheel command is finite, within the wheels' speed, and changes no faster than the robot file permits; what a     |
//! |      | controller could not know is the only slack (`change`)                                                                 |
//! | b    | no command acts that answers a state older than 3 T, and none is accepted that answers one older than 1.5 T            |
//! | c    | of two controller epochs the greater takes over from the smaller, once in a period at most, and never the other way;   |
//! |      | of two writers of one epoch another is heard when the first has been silent                                            |
//! | d    | when nothing acts, from 3 T after the last good command on at the latest, the wheels slow down along the ramp to rest  |
//! | e    | every change of fallback level has its reason; the gate's brake is left after 3 good periods                                     |
//! | f    | what was sent is in the record or was counted as lost by it, for every topic and writer                                |
//! | g    | what acts is what its controller said for this moment: the input, or the entry of its tail for a state so old          |
//! | h    | the robot stays as near to its reference as physics allows (`tracking`, beside this module)                            |
//!
//! A takeover in the midst of a period is lawful: the tail of the dead controller acts until the first answer of its successor. What is
//! judged of the wheels is what the plant says in its Truth; rule f cannot be judged across the death of a recorder, which counts nothing
//! while it is dead.

mod change;
mod counting;
mod said;
mod wheels;

use super::record::{Message, Record};
use crate::assembly::Assembly;
pub(super) use change::body as commanded;
use said::Said;
use std::collections::BTreeMap;
use std::fmt;

/// What is promised of the age of what acts, and of the brake \[periods\].
const OLDEST_PERIODS: f64 = 3.0;
/// Ticks between a state and the end of the period in which an answer to it may still be accepted, when that is 1.5 T old at most.
const ACCEPTED_WITHIN_TICKS: u64 = 2;
/// Good periods that leaving the brake takes.
const GOOD_PERIODS: u64 = 3;

/// The robot's limits, as its file says them.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// T \[s\].
    pub period_s: f64,
    /// r \[m\].
    pub wheel_radius_m: f64,
    /// a + b \[m\].
    pub lever_m: f64,
    /// Largest speed of a wheel \[rad/s\].
    pub wheel_radps: f64,
    /// Largest change of the commanded body velocity \[m/s², m/s², rad/s²\].
    pub rate: [f64; 3],
    /// Ramp of the brake \[m/s², m/s², rad/s²\].
    pub brake: [f64; 3],
    /// What the links may take beyond 1.5 T \[periods, rounded up\].
    pub link_delay_periods: u64,
    /// Whether the wheels get what the gate lets through at once, and not after a dead time of the drive's own.
    pub at_once: bool,
}

impl Limits {
    /// Those of an assembled graph.
    pub fn of(assembly: &Assembly) -> Self {
        let robot = &assembly.robot;
        Self {
            period_s: assembly.scenario.period_millis * 1e-3,
            wheel_radius_m: robot.geometry.wheel_radius_m,
            lever_m: robot.geometry.half_track_m + robot.geometry.half_wheelbase_m,
            wheel_radps: robot.drive.wheel_speed_limit_radps,
            rate: [
                robot.limits.input_rate_mps2,
                robot.limits.input_rate_mps2,
                robot.limits.yaw_input_rate_radps2,
            ],
            brake: [
                robot.limits.brake_mps2,
                robot.limits.brake_mps2,
                robot.limits.yaw_brake_radps2,
            ],
            link_delay_periods: (assembly.link_delay_millis() as f64
                / assembly.scenario.period_millis)
                .ceil() as u64,
            at_once: (assembly.scenario.truth.as_ref())
                .is_some_and(|truth| truth.command_delay_s == 0.0),
        }
    }
}

/// What a rule is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// Finite wheel commands.
    Finite,
    /// Within the wheels' speed.
    Bounds,
    /// Within the rate of change that the robot file permits.
    Rate,
    /// Within what the gate promises of any command.
    Leap,
    /// Nothing older than 3 T acts, and nothing older than 1.5 T is accepted.
    Age,
    /// One controller epoch, and one writer of it.
    Epoch,
    /// The ramp of the brake.
    Ramp,
    /// A reason for every change of fallback level.
    Reason,
    /// Three good periods before the brake is left.
    Recovery,
    /// Sent = stored + lost.
    Count,
    /// What acts was said.
    Said,
    /// Near the reference.
    Tracking,
}

/// One thing that went wrong.
#[derive(Debug, Clone, PartialEq)]
pub struct Violation {
    /// What was violated.
    pub rule: Rule,
    /// Epoch of the plant; of rule f, the writer.
    pub epoch: u64,
    /// When.
    pub tick: u64,
    /// What was found.
    pub found: String,
    /// What was expected.
    pub expected: String,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { rule, epoch, tick, found, expected } = self;
        write!(f, "{rule:?} at tick {tick} of epoch {epoch}: {found}, expected {expected}")
    }
}

/// Everything that went wrong in a run. Nothing is good.
pub fn judge(record: &Record, limits: &Limits) -> Vec<Violation> {
    let mut violations = Vec::new();
    let truths = by_epoch(record, "truth");
    let states = by_epoch(record, "state");
    let said = Said::of(record);
    let none = BTreeMap::new();
    for (&epoch, ticks) in &truths {
        wheels::judge(epoch, ticks, limits, &mut violations);
        change::judge(epoch, ticks, states.get(&epoch).unwrap_or(&none), limits, &mut violations);
        if limits.at_once {
            said.judge(epoch, ticks, limits, &mut violations);
        }
    }
    for (&epoch, ticks) in &states {
        judge_fallback_levels(epoch, ticks, truths.get(&epoch).unwrap_or(&none), &mut violations);
        judge_accepted(epoch, ticks, limits, &mut violations);
    }
    counting::judge(record, &mut violations);
    violations
}

/// Fails with everything that went wrong in a run.
///
/// # Errors
/// One line for each violation.
pub fn acquit(record: &Record, limits: &Limits) -> Result<(), String> {
    let violations = judge(record, limits);
    if violations.is_empty() {
        Ok(())
    } else {
        Err(violations.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n"))
    }
}

pub(super) type Ticks<'a> = BTreeMap<u64, &'a Message>;

/// Messages of the plant by epoch and tick; what a restarted recorder got twice is there once.
pub(super) fn by_epoch<'a>(record: &'a Record, topic: &'a str) -> BTreeMap<u64, Ticks<'a>> {
    let mut epochs: BTreeMap<u64, Ticks<'a>> = BTreeMap::new();
    for message in record.of(topic) {
        epochs.entry(message.stamp("epoch")).or_default().insert(message.stamp("tick"), message);
    }
    epochs
}

/// Rule b, of what was accepted in one plant epoch.
fn judge_accepted(
    epoch: u64,
    states: &Ticks<'_>,
    limits: &Limits,
    violations: &mut Vec<Violation>,
) {
    let accepted = |state: &Message| (state.count("accepted_epoch"), state.count("accepted_tick"));
    for (&tick, state) in states {
        let Some(before) = tick.checked_sub(1).and_then(|before| states.get(&before)) else {
            continue;
        };
        let within = ACCEPTED_WITHIN_TICKS + limits.link_delay_periods;
        let (_, answered) = accepted(state);
        if accepted(before) != accepted(state) && answered.saturating_add(within) < tick {
            let (found, expected) = (
                format!("an answer to tick {answered} was accepted"),
                format!("none to a tick before {}", tick - within),
            );
            violations.push(Violation { rule: Rule::Age, epoch, tick, found, expected });
        }
    }
}

/// Rule e, of one plant epoch.
fn judge_fallback_levels(
    epoch: u64,
    states: &Ticks<'_>,
    truths: &Ticks<'_>,
    violations: &mut Vec<Violation>,
) {
    // The state of tick k tells of the period of tick k - 1.
    let answered = |tick: u64| {
        states
            .get(&tick)
            .is_some_and(|state| state.count("accepted_tick").checked_add(1) == Some(tick))
    };
    for (&tick, state) in states {
        let Some(before) = tick.checked_sub(1).and_then(|before| states.get(&before)) else {
            continue;
        };
        let (from, to) = (before.word("fallback_level"), state.word("fallback_level"));
        if from == to {
            continue;
        }
        let explained =
            if to == "fresh plan" { answered(tick) } else { state.word("reason") != "-" };
        if !explained {
            let (found, expected) = (
                format!("{from} became {to}"),
                "a reason, or a command that was accepted".to_owned(),
            );
            violations.push(Violation { rule: Rule::Reason, epoch, tick, found, expected });
        }
        let braked_by_the_gate = from == "brake"
            && truths.get(&(tick - 1)).is_none_or(|truth| truth.count("acting_epoch") == 0);
        // A state that is not in the record says nothing against its period.
        let good = |tick: &u64| !states.contains_key(tick) || answered(*tick);
        let good = (1..=GOOD_PERIODS)
            .take_while(|&ago| tick.checked_sub(ago).as_ref().is_some_and(good))
            .count() as u64;
        if braked_by_the_gate && good < GOOD_PERIODS {
            let (found, expected) =
                (format!("{to} after {good} good periods on the brake"), format!("{GOOD_PERIODS}"));
            violations.push(Violation { rule: Rule::Recovery, epoch, tick, found, expected });
        }
    }
}
