//! Record of a run → what went wrong in it.
//!
//! The rules come from the design. This module shares no code with the gate that it judges.
//!
//! | rule | what must hold                                                                        |
//! |------|---------------------------------------------------------------------------------------|
//! | a    | every wheel command is finite, within the wheels' speed, and changes no faster than   |
//! |      | the robot file permits; the only slack is what a controller could not know (`change`) |
//! | b    | no command acts that answers a state older than 3 T, and none is accepted that        |
//! |      | answers one older than 1.5 T                                                          |
//! | c    | of two controller epochs the greater takes over from the smaller, at most once in a   |
//! |      | period, and never the other way; of two writers of one epoch the second is obeyed     |
//! |      | only when the first has been silent                                                   |
//! | d    | when nothing acts, the wheels slow down along the ramp to rest; this begins at most   |
//! |      | 3 T after the last good command                                                       |
//! | e    | every change of fallback level has its reason; the gate leaves its brake after 3 good |
//! |      | periods                                                                               |
//! | f    | for every topic and writer, each message sent is in the record or counted as lost     |
//! | g    | what acts is what its controller sent for this period: the input, or the entry of its |
//! |      | tail for a state of that age                                                          |
//! | h    | the robot stays as near to its reference as physics allows (`tracking`, beside this   |
//! |      | module)                                                                               |
//!
//! A takeover within a period is permitted: the tail of the dead controller acts until the first
//! answer of its successor. The wheels are judged by what the plant publishes in its Truth. Rule f
//! cannot be judged across the death of a recorder, because a dead recorder counts nothing.

mod change;
mod commanded;
mod counting;
mod wheels;

use super::record::{Message, Record};
pub(super) use change::body as commanded;
use commanded::Commanded;
use graph::assembly::Assembly;
use robot::Wheels;
use std::collections::BTreeMap;
use std::fmt;

/// Largest age of a state whose answer acts; from there on the gate brakes \[periods\].
const OLDEST_PERIODS: f64 = 3.0;
/// Ticks from a state to the end of the period in which its answer may still be accepted. An
/// accepted answer is at most 1.5 T old.
const ACCEPTED_WITHIN_TICKS: u64 = 2;
/// Good periods that leaving the brake takes.
const GOOD_PERIODS: u64 = 3;

/// The robot's limits, from its file.
#[derive(Debug, Clone, Copy)]
pub struct Limits {
    /// T \[s\].
    pub period_s: f64,
    /// The wheels.
    pub wheels: Wheels,
    /// Largest speed of a wheel \[rad/s\].
    pub wheel_radps: f64,
    /// Largest change of the commanded body velocity \[m/s², m/s², rad/s²\].
    pub rate: [f64; 3],
    /// Ramp of the brake \[m/s², m/s², rad/s²\].
    pub brake: [f64; 3],
    /// Permitted delay of the links beyond 1.5 T \[periods, rounded up\].
    pub link_delay_periods: u64,
    /// Whether the wheels get the gate's output at once, and not after a dead time of the drive.
    pub at_once: bool,
}

impl Limits {
    /// The limits of an assembled graph.
    pub fn of(assembly: &Assembly) -> Self {
        let robot = &assembly.robot;
        Self {
            period_s: assembly.scenario.period_millis * 1e-3,
            wheels: robot.wheels,
            wheel_radps: robot.wheel_speed_limit_radps(),
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
    /// Within what the gate guarantees for any command.
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
    /// The acting command was sent by the controller.
    AsCommanded,
    /// Near the reference.
    Tracking,
}

/// One violation of a rule.
#[derive(Debug, Clone, PartialEq)]
pub struct Violation {
    /// The violated rule.
    pub rule: Rule,
    /// Epoch of the plant; for rule f, the writer.
    pub epoch: u64,
    /// The tick of the violation.
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

/// All violations in a run; empty if there is none.
pub fn judge(record: &Record, limits: &Limits) -> Vec<Violation> {
    let mut violations = Vec::new();
    let truths = by_epoch(record, "truth");
    let states = by_epoch(record, "state");
    let commands = Commanded::of(record);
    let none = BTreeMap::new();
    for (&epoch, ticks) in &truths {
        wheels::judge(epoch, ticks, limits, &mut violations);
        change::judge(epoch, ticks, states.get(&epoch).unwrap_or(&none), limits, &mut violations);
        if limits.at_once {
            commands.judge(epoch, ticks, limits, &mut violations);
        }
    }
    for (&epoch, ticks) in &states {
        judge_fallback_levels(epoch, ticks, truths.get(&epoch).unwrap_or(&none), &mut violations);
        judge_accepted(epoch, ticks, limits, &mut violations);
    }
    counting::judge(record, &mut violations);
    violations
}

/// Fails with all violations in a run.
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

/// Messages of the plant by epoch and tick. Messages that a restarted recorder got twice are there
/// once.
pub(super) fn by_epoch<'a>(record: &'a Record, topic: &'a str) -> BTreeMap<u64, Ticks<'a>> {
    let mut epochs: BTreeMap<u64, Ticks<'a>> = BTreeMap::new();
    for message in record.of(topic) {
        epochs.entry(message.stamp("epoch")).or_default().insert(message.stamp("tick"), message);
    }
    epochs
}

/// Rule b, for the accepted commands of one plant epoch.
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
    // The state of tick k reports the period of tick k - 1.
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
        // A latched stop keeps the brake.
        let braked_by_the_gate = from == "brake"
            && to != "latched stop"
            && truths.get(&(tick - 1)).is_none_or(|truth| truth.count("acting_epoch") == 0);
        // A state that is missing from the record is no evidence against its period.
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
