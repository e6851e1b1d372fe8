//! Two planners of one robot: the newer goal wins.

use super::Given;
use super::planner::{Planner, all_settled, requested, wait_for_replies, wait_until};
use crate::measure::Measured;
use crate::session::{Home, Session, Trouble};
use process::Stop;
use process::requests::{Outcome, Request, ask};
use protocol::message::Participant;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::process::Signal;
use std::thread;
use std::time::Duration;

/// Longest pause between two goals \[µs\].
const PAUSE_MICROS: u64 = 600_000;
/// Time from the start of a planner until it is stopped, at most \[µs\].
const HANGS_AFTER_MICROS: u64 = 80_000;
/// Longest time by which a late request is older than the present one \[ns\].
const LATE_NANOS: u64 = 5_000_000_000;

/// Two planners give goals in turn, `times` times. Every third one hangs, and goes on after the
/// other has given a goal; and every third time a goal comes late that was requested before.
pub(super) fn give(
    home: &Home<'_>,
    session: &Session,
    times: u32,
    seed: u64,
    stop: &Stop,
    measured: &mut Measured,
) -> Result<Given, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut planners = Vec::new();
    let mut hung = 0;
    for round in 0..times {
        if stop.requested() {
            break;
        }
        let before = all_settled(session.run()).len();
        let hangs = (round % 3 == 1)
            .then(|| start(home, session, &mut random, &mut planners))
            .transpose()?;
        if let Some(index) = hangs {
            thread::sleep(Duration::from_micros(random.random_range(0..HANGS_AFTER_MICROS)));
            signal(&planners, index, Signal::STOP)?;
            hung += 1;
        }
        start(home, session, &mut random, &mut planners)?;
        wait_until("a goal", stop, || Ok(all_settled(session.run()).len() > before))?;
        if let Some(index) = hangs {
            // Both have given their goal, or the second one has while the first one hangs.
            wait_for_replies(session.run(), stop)?;
            signal(&planners, index, Signal::CONT)?;
        }
        measured.injections += 1;
        if round % 3 == 2 {
            let newest = all_settled(session.run()).last().map(|one| one.request.asked_unix_nanos);
            let late = Request {
                asked_unix_nanos: newest
                    .unwrap_or(0)
                    .saturating_sub(random.random_range(1..LATE_NANOS)),
                ..Request::new("late", "# goal\n[goal.pose]\nto = [9.0, 9.0, 0.0]\n")
            };
            ask(session.run(), Participant::Controller, &late)?;
            wait_for_replies(session.run(), stop)?;
        }
        thread::sleep(Duration::from_micros(random.random_range(0..PAUSE_MICROS)));
    }
    let mut outcomes = Vec::new();
    for (name, planner) in &mut planners {
        outcomes.push((name.clone(), planner.exit_code(stop)?));
    }
    judge_codes(session, &outcomes, measured);
    let late = requested(session.run()) - all_settled(session.run()).len() as u64;
    measured.notes.push(format!("{hung} planners hung, {late} requests have no reply"));
    Ok(Given::default())
}

/// Starts a planner that goes somewhere, and returns its index.
fn start(
    home: &Home<'_>,
    session: &Session,
    random: &mut Pcg64Mcg,
    planners: &mut Vec<(String, Planner)>,
) -> Result<usize, Trouble> {
    let [x, y, yaw] = [0, 1, 2].map(|_| random.random_range(-1.5..1.5_f64).to_string());
    let name = format!("planner-{}", planners.len());
    let planner = Planner::start(home, session, &name, &["go", &x, &y, &yaw])?;
    planners.push((name, planner));
    Ok(planners.len() - 1)
}

fn signal(planners: &[(String, Planner)], index: usize, signal: Signal) -> Result<(), Trouble> {
    planners.get(index).ok_or("no planner")?.1.signal(signal)
}

/// Each planner learns what has become of its goal: the last one is reached, and of two goals at
/// most one. A rejected goal has exit code 2.
fn judge_codes(session: &Session, outcomes: &[(String, Option<i32>)], measured: &mut Measured) {
    let settled = all_settled(session.run());
    let is_applied = |outcome: &Outcome| matches!(outcome, Outcome::Applied { .. });
    let newest = settled.iter().rfind(|one| is_applied(&one.answer.outcome));
    for (name, code) in outcomes {
        let Some(one) = settled.iter().find(|one| one.request.who == *name) else {
            measured.violations.push(format!("{name} ended with {code:?}, and gave no goal"));
            continue;
        };
        let expected: &[i32] = if !is_applied(&one.answer.outcome) {
            &[2]
        } else if newest.is_some_and(|newest| newest.number == one.number) {
            &[0]
        } else {
            &[0, 1] // reached, or preempted
        };
        if !code.is_some_and(|code| expected.contains(&code)) {
            measured.violations.push(format!(
                "{name} ended with {code:?}, expected one of {expected:?}: goal {}",
                one.number
            ));
        }
    }
    let late = settled.iter().filter(|one| !is_applied(&one.answer.outcome)).count();
    measured.notes.push(format!("{late} of {} goals came late", settled.len()));
}
