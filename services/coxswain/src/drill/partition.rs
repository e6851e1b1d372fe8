//! Two hosts whose cable is pulled: namespaces where they are permitted, else a relay that falls silent.

use super::exercise::{SETTLED, judge_wheels, left_behind, worse};
use super::hosts::Hosts;
use super::measure::Measured;
use super::session::{Home, Place, Trouble};
use process::Stop;
use protocol::clock::monotonic_nanos;
use std::thread;
use std::time::{Duration, Instant};

/// Longest way back to a fresh plan, once the cable is in again \[s\].
const BACK_WITHIN_S: f64 = 2.0;
/// How long it drives after that, before the cable is pulled once more.
const BETWEEN: Duration = Duration::from_millis(2500);
/// Far longer than it takes: both launches are asked to end.
const DURATION_S: f64 = 5000.0;

/// Pulls the cable for so many milliseconds each, and judges what the plant's host recorded.
///
/// # Errors
/// If it could not be done.
pub(super) fn partition(home: &Home, cuts: &[u64], stop: &Stop) -> Result<Measured, Trouble> {
    let hosts = Hosts::new()?;
    let mut control = home.launch_on(&hosts, Place::Control, "control", DURATION_S)?;
    control.wait_for_log("controller", "started", 1)?;
    let mut plant = home.launch_on(&hosts, Place::Plant, "plant", DURATION_S)?;
    control.wait_for_log("controller", "answering a plant", 1)?;
    thread::sleep(SETTLED);
    let mut healed = Vec::new();
    for &millis in cuts {
        hosts.pull_cable()?;
        wait(Duration::from_millis(millis), stop);
        hosts.plug_cable()?;
        healed.push(monotonic_nanos());
        wait(BETWEEN, stop);
        if stop.requested() {
            break;
        }
    }
    plant.end()?;
    control.end()?;

    let record = plant.record()?;
    let fresh: Vec<u64> =
        record.of("state").filter(|state| state.word("rung") == "fresh plan").map(|state| state.stamp("sent_nanos")).collect();
    let mut measured = Measured { injections: healed.len() as u64, ..Measured::default() };
    for (index, (&at, millis)) in healed.iter().zip(cuts).enumerate() {
        let took = fresh.iter().find(|&&fresh| fresh > at).map(|&fresh| (fresh - at) as f64 * 1e-9);
        if took.is_none_or(|took| took > BACK_WITHIN_S) {
            let back = took.map_or("never".to_owned(), |took| format!("after {took:.2} s"));
            measured.violations.push(format!("cut {index}, of {millis} ms: driving again {back}, expected {BACK_WITHIN_S} s at most"));
        }
        measured.worst_restart = worse(measured.worst_restart, took);
    }
    judge_wheels(&record, &home.limits()?, &mut measured);
    measured.violations.extend(left_behind(home, &[control.graph_name()?, plant.graph_name()?]));
    Ok(measured)
}

fn wait(time: Duration, stop: &Stop) {
    let end = Instant::now() + time;
    while !stop.requested() && Instant::now() < end {
        thread::sleep(Duration::from_millis(5).min(end.saturating_duration_since(Instant::now())));
    }
}
