//! The emergency stop of the robot is pressed while it drives, and stays pressed for a time.
//!
//! | rule    | what must hold                                                                  |
//! |---------|---------------------------------------------------------------------------------|
//! | brakes  | the first state with the stop reports a stopped gate, and the wheels slow down  |
//! |         | along the ramp in the period of that state                                      |
//! | latched | the gate stays stopped while the stop is pressed, and after it, until `resume`  |
//! | orders  | no order is followed, and no goal is accepted, while the stop is pressed        |
//! | resumed | after it, `resume` works, and the robot reaches its goal                        |

use super::goals::planner::{Planner, status, tell, wait_until};
use super::goals::{DURATION_S, conclude};
use super::measure::Measured;
use super::oracle::{Limits, commanded};
use super::record::{Message, Record};
use super::session::{Home, Session, Trouble};
use process::requests::{Outcome, Settled};
use process::{Stop, Witness};
use protocol::message::Participant;
use std::collections::BTreeMap;

/// Where the robot drives to and fro \[m\].
const FAR_M: f64 = 3.5;
/// Exit code of a rejected order or goal.
const REJECTED: i32 = 2;
/// The gate decides every 2 ms: its first decision of a period may be that late \[s\].
const GRAIN_S: f64 = 0.002;
/// Rounding \[m/s, rad/s\].
const TOLERANCE: f64 = 1e-5;

/// Faults of `times` presses, for a robot that drives from 1 s on.
pub(super) fn faults(times: u32) -> String {
    let press = |index: u32| {
        // Spread over the period, and over the way.
        let from_s = 3.0 + 12.0 * f64::from(index) + 0.618 * f64::from(index % 7) / 7.0;
        format!("[[plant]]\nkind = \"emergency-stop\"\nfrom_s = {from_s:.4}\nmillis = 2000\n")
    };
    (0..times).map(press).collect()
}

/// Drives to and fro while the emergency stop is pressed `times` times.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn run(home: &Home<'_>, times: u32, stop: &Stop) -> Result<Measured, Trouble> {
    let witness = Witness::begin();
    let mut session = home.launch("run", DURATION_S)?;
    session.wait_for_log("controller", "answering a plant", 1)?;
    let mut measured = Measured::default();
    for round in 0..times {
        if stop.requested() {
            break;
        }
        let to = if round % 2 == 0 { FAR_M } else { -FAR_M };
        one(home, &session, (round, to), stop, &mut measured)?;
    }
    let record = conclude(home, &mut session, witness, false, &mut measured)?;
    let orders = (1..).map_while(|number| Settled::read(session.run(), Participant::Plant, number));
    let (orders, goals) = (orders.collect(), super::goals::planner::all_settled(session.run()));
    let moving = judge(&record, &home.limits()?, [orders, goals], &mut measured.violations);
    measured.injections = moving;
    if moving == 0 {
        measured.violations.push("the robot never moved: the exercise shows nothing".to_owned());
    }
    Ok(measured)
}

/// One press: on the way to x = `to`.
fn one(
    home: &Home<'_>,
    session: &Session,
    (round, to): (u32, f64),
    stop: &Stop,
    measured: &mut Measured,
) -> Result<(), Trouble> {
    let is_pressed = || Ok(status(home, session)?["robot"]["estop"] == true);
    let to = to.to_string();
    let mut going = Planner::start(home, session, "going", &["go", &to, "0", "0", "--speed", "1"])?;
    wait_until("a pressed stop", stop, is_pressed)?;
    let mut expect = |arguments: &[&str], expected: i32| -> Result<(), Trouble> {
        let code = tell(home, session, arguments, stop)?;
        if code != Some(expected) {
            let what = arguments.join(" ");
            let found = format!("press {round}: {what} ended with {code:?}, expected {expected}");
            measured.violations.push(found);
        }
        Ok(())
    };
    expect(&["resume"], REJECTED)?;
    expect(&["arm"], REJECTED)?;
    expect(&["go", "0", "0", "0"], REJECTED)?;
    wait_until("a released stop", stop, || Ok(!is_pressed()?))?;
    expect(&["go", "0", "0", "0"], REJECTED)?; // it is still latched
    expect(&["resume"], 0)?;
    if going.exit_code(stop)? != Some(0) {
        measured.violations.push(format!("press {round}: the goal before it was not reached"));
    }
    Ok(())
}

/// Judges every state, and returns how often the robot moved when the stop was pressed.
fn judge(
    record: &Record,
    limits: &Limits,
    requests: [Vec<Settled>; 2],
    violations: &mut Vec<String>,
) -> u64 {
    let by_tick = |topic| -> BTreeMap<u64, &Message> {
        record.of(topic).map(|message| (message.stamp("tick"), message)).collect()
    };
    let (states, truths) = (by_tick("state"), by_tick("truth"));
    let is_pressed = |tick: &u64| states.get(tick).is_some_and(|state| state.count("estop") == 1);
    let is_stopped =
        |tick: &u64| states.get(tick).is_some_and(|state| state.word("gate") == "stopped");
    // Ticks from which on an order or a goal acted.
    let followed = requests.map(|requests| -> Vec<u64> {
        let first = |one: &Settled| match one.answer.outcome {
            Outcome::Applied { acts_from_tick, .. } => Some(acts_from_tick),
            Outcome::Refused { .. } => None,
        };
        requests.iter().filter_map(first).collect()
    });
    for tick in followed.iter().flatten().filter(|tick| is_pressed(tick)) {
        violations.push(format!("a request was followed at tick {tick}, under a pressed stop"));
    }
    let [orders, _] = &followed;
    let mut moving = 0;
    for (tick, state) in &states {
        let Some(before) = tick.checked_sub(1) else { continue };
        if is_pressed(tick) && !is_stopped(tick) {
            let gate = state.word("gate");
            violations.push(format!("the gate is {gate} at tick {tick}, under a pressed stop"));
        }
        // The first state after an order reports it.
        let is_ordered = orders.contains(&before) || orders.contains(tick);
        if is_stopped(&before) && !is_stopped(tick) && !is_ordered {
            violations.push(format!("the gate left its stop at tick {tick} without an order"));
        }
        if !is_pressed(tick) || is_pressed(&before) {
            continue;
        }
        let command = |tick: u64| truths.get(&tick).and_then(|truth| commanded(truth, limits));
        let (Some(from), Some(to)) = (command(*tick), command(tick + 1)) else { continue };
        moving += u64::from(from.iter().any(|speed| speed.abs() > 0.1));
        for axis in 0..3 {
            let ramp = limits.brake[axis] * (limits.period_s - GRAIN_S);
            let left = (from[axis].abs() - ramp).max(0.0);
            if to[axis].abs() > left + TOLERANCE {
                violations.push(format!(
                    "axis {axis} commanded {:.3} when the stop was pressed at tick {tick}, then \
                     {:.3}, expected {left:.3} at most",
                    from[axis], to[axis]
                ));
            }
        }
    }
    moving
}
