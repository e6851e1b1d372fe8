//! Faults of planners, and of what they request, while the robot drives.
//!
//! | exercise       | what happens                                                              |
//! |----------------|---------------------------------------------------------------------------|
//! | absurd goals   | goals that no robot can do: each is rejected, and the robot goes on       |
//! | goal flood     | planners give goals without a pause: the newest one counts                |
//! | planner killed | it is killed before, while or after it gives a goal: the goal is done to  |
//! |                | its end, and a velocity ends at its time                                  |
//! | two planners   | two planners give goals in turn, and hang: the newer goal wins, and an    |
//! |                | older one is rejected                                                     |
//!
//! A planner is a process: a command of this same program. In each exercise the robot drives on
//! fresh plans alone. It obeys no goal out of turn, and in the end it stands where it should.

mod absurd;
mod flood;
mod killed;
pub(super) mod planner;
mod two;

use super::catalogue::{GoalFault, Launch};
use super::exercise::{judge_wheels, left_behind, worse};
use super::measure::{Measured, measure};
use super::oracle::commanded;
use super::record::{Message, Record};
use super::session::{Home, Session, Trouble};
use planner::all_settled;
use process::requests::{Outcome, Settled};
use process::{Stop, Witness};
use std::collections::BTreeMap;

/// Far longer than any exercise takes: the drill ends its launches \[s\].
pub(super) const DURATION_S: f64 = 5000.0;
/// Largest distance of a standing robot from its goal \[m\].
const NEAR_M: f64 = 0.05;
/// Speed below which the robot stands \[m/s, m/s, rad/s\].
const STANDS: f64 = 0.1;

/// Longest time that braking from the speed of a goal takes \[s\].
const BRAKES_WITHIN_S: f64 = 1.0;
/// Ticks after which a robot stands that has reached its goal.
const SETTLED_TICKS: u64 = 15;

/// Runs the exercise `times` times in one launch, and judges it.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn run(
    home: &Home<'_>,
    fault: GoalFault,
    times: u32,
    seed: u64,
    stop: &Stop,
) -> Result<Measured, Trouble> {
    let witness = Witness::begin();
    let mut session = home.launch("run", DURATION_S)?;
    session.wait_for_log("controller", "answering a plant", 1)?;
    let mut measured = Measured::default();
    let given = match fault {
        GoalFault::Absurd => absurd::give(home, &session, times, seed, stop, &mut measured)?,
        GoalFault::Flood => flood::give(home, &session, times, seed, stop, &mut measured)?,
        GoalFault::KilledPlanner => killed::give(home, &session, times, seed, stop, &mut measured)?,
        GoalFault::TwoPlanners => two::give(home, &session, times, seed, stop, &mut measured)?,
    };
    let record = conclude(home, &mut session, witness, true, &mut measured)?;
    let settled = all_settled(session.run());
    judge_order(&settled, &given, &mut measured.violations);
    judge_phases(&record, &settled, &mut measured.violations);
    judge_places(&record, &settled, home, &mut measured.violations)?;
    let period_s = home.limits()?.period_s;
    judge_velocities(&record, &settled, &given, period_s, &mut measured.violations);
    Ok(measured)
}

/// Numbers of requests whose goal is known.
#[derive(Debug, Default)]
struct Given {
    /// Goals that no robot can do.
    absurd: Vec<u64>,
    /// Velocities, with the time of validity \[s\].
    velocities: BTreeMap<u64, f64>,
}

/// Ends the launch and judges what holds for each exercise with goals. Returns the record.
///
/// If `undisturbed`, the robot must have driven on fresh plans alone.
pub(super) fn conclude(
    home: &Home<'_>,
    session: &mut Session,
    witness: Witness,
    undisturbed: bool,
    measured: &mut Measured,
) -> Result<Record, Trouble> {
    session.end()?;
    let gaps = witness.end();
    let record = session.record()?;
    if undisturbed {
        let launch = Launch { undisturbed, ..Launch::default() };
        let one = measure(&record, &launch, &home.limits()?, &[], &gaps);
        measured.violations.extend(one.violations);
        measured.excused += one.excused;
        measured.worst_reaction = worse(measured.worst_reaction, one.worst_reaction);
    } else {
        judge_wheels(&record, &home.limits()?, measured);
        let last = record.of("state").next_back();
        if last.is_none_or(|state| state.word("fallback_level") != "fresh plan") {
            measured.violations.push("it does not drive at the end".to_owned());
        }
    }
    measured.violations.extend(left_behind(home, &[session.graph_name()?]));
    Ok(record)
}

/// A goal is followed if, and only if, a robot can do it and it is newer than the one before.
fn judge_order(settled: &[Settled], given: &Given, violations: &mut Vec<String>) {
    let mut newest = 0;
    for one in settled {
        let asked = one.request.asked_unix_nanos;
        let is_absurd = given.absurd.contains(&one.number);
        let expected = !is_absurd && asked >= newest;
        match &one.answer.outcome {
            Outcome::Applied { .. } if !expected => violations.push(format!(
                "goal {} was followed: {}",
                one.number,
                if is_absurd { "no robot can do it" } else { "a newer one had been followed" }
            )),
            Outcome::Refused { reason, .. } if expected => {
                violations.push(format!("goal {} was rejected: {reason}", one.number));
            }
            _ => {}
        }
        if let Outcome::Applied { .. } = &one.answer.outcome {
            newest = newest.max(asked);
        }
    }
}

/// Numbers of the followed goals, with their first ticks.
fn followed(settled: &[Settled]) -> BTreeMap<u64, u64> {
    let first = |one: &Settled| match one.answer.outcome {
        Outcome::Applied { acts_from_tick, .. } => Some((one.number, acts_from_tick)),
        Outcome::Refused { .. } => None,
    };
    settled.iter().filter_map(first).collect()
}

/// The robot has one goal after the other, and each ends: a later one preempts it, or the robot
/// reaches it.
fn judge_phases(record: &Record, settled: &[Settled], violations: &mut Vec<String>) {
    let followed = followed(settled);
    let (mut present, mut last) = (0, BTreeMap::new());
    for goal in record.of("goal") {
        let (id, phase) = (goal.count("id"), goal.word("phase"));
        if !followed.contains_key(&id) {
            violations.push(format!("goal {id} is {phase}, but it was not accepted"));
        }
        // The end of the one before is published in the same period.
        if id < present && phase != "preempted" {
            violations.push(format!("goal {id} is {phase} after goal {present}"));
        }
        present = present.max(id);
        last.insert(id, phase);
    }
    let newest = followed.keys().next_back();
    for id in followed.keys() {
        let phase = last.get(id).copied().unwrap_or("never published");
        if phase != "reached" && (phase != "preempted" || Some(id) == newest) {
            violations.push(format!("goal {id} ended as {phase}"));
        }
    }
}

/// Each velocity ends at its time, by the clock of the plant.
fn judge_velocities(
    record: &Record,
    settled: &[Settled],
    given: &Given,
    period_s: f64,
    violations: &mut Vec<String>,
) {
    let followed = followed(settled);
    for (id, valid_s) in &given.velocities {
        let Some(first) = followed.get(id) else { continue };
        let ended = record
            .of("goal")
            .find(|goal| goal.count("id") == *id && goal.word("phase") != "active");
        let lasted = ended.map(|goal| goal.stamp("tick").saturating_sub(*first) as f64 * period_s);
        if lasted.is_none_or(|lasted| lasted > valid_s + BRAKES_WITHIN_S) {
            let lasted = lasted.map_or("without end".to_owned(), |lasted| format!("{lasted:.2} s"));
            violations.push(format!("goal {id}, valid for {valid_s:.2} s, acted {lasted}"));
        }
    }
}

/// The robot stands at each goal that it has reached, until the next goal.
fn judge_places(
    record: &Record,
    settled: &[Settled],
    home: &Home<'_>,
    violations: &mut Vec<String>,
) -> Result<(), Trouble> {
    let (limits, followed) = (home.limits()?, followed(settled));
    let reached: BTreeMap<u64, &Message> = record
        .of("goal")
        .filter(|goal| goal.word("phase") == "reached")
        .map(|goal| (goal.count("id"), goal))
        .collect();
    for (id, goal) in reached {
        let next = followed.range(id + 1..).next().map_or(u64::MAX, |(_, tick)| *tick);
        let Some(truth) = record.of("truth").rfind(|truth| truth.stamp("tick") < next) else {
            continue;
        };
        let (is, target) = (truth.numbers("pose"), goal.numbers("target"));
        let off = match (is.as_slice(), target.as_slice()) {
            (&[x, y, _], &[to_x, to_y, _]) => (x - to_x).hypot(y - to_y),
            _ => f64::INFINITY,
        };
        let wheels = commanded(truth, &limits).unwrap_or([f64::INFINITY; 3]);
        // A goal that was given at the instant of arrival leaves no time to settle.
        let settled = truth.stamp("tick") > goal.stamp("tick") + SETTLED_TICKS;
        if settled && (off > NEAR_M || wheels.iter().any(|wheel| wheel.abs() > STANDS)) {
            violations.push(format!(
                "goal {id} was reached, but the robot is {off:.3} m away and commanded {wheels:.2?}"
            ));
        }
    }
    Ok(())
}
