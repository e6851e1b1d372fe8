//! Two hosts whose cable is pulled: network namespaces if permitted, else a relay that stops
//! relaying.

use super::catalogue::Launch;
use super::exercise::{SETTLED, judge_tracking, judge_wheels, left_behind, worse};
use super::hosts::Hosts;
use super::measure::Measured;
use super::record::Record;
use super::session::{Home, Trouble};
use process::Stop;
use protocol::clock::monotonic_nanos;
use std::thread;
use std::time::{Duration, Instant};

/// Longest time from plugging the cable in to a fresh plan \[s\].
const BACK_WITHIN_S: f64 = 2.0;
/// How long the robot drives before the next cut.
const BETWEEN: Duration = Duration::from_millis(2500);
/// Far longer than the exercise takes: the drill ends both launches.
const DURATION_S: f64 = 5000.0;

/// Pulls the cable once for each length of `cuts` \[ms\], and judges the record of the plant's
/// host.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn partition(home: &Home<'_>, cuts: &[u64], stop: &Stop) -> Result<Measured, Trouble> {
    let hosts = Hosts::new()?;
    let mut control = home.launch_on(&hosts, "control", DURATION_S)?;
    control.wait_for_log("controller", "started", 1)?;
    let mut plant = home.launch_on(&hosts, "robot", DURATION_S)?;
    control.wait_for_log("controller", "answering a plant", 1)?;
    thread::sleep(SETTLED);
    let (mut pulled, mut healed) = (Vec::new(), Vec::new());
    for &millis in cuts {
        pulled.push(monotonic_nanos());
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
    let limits = home.limits()?;
    let fresh: Vec<u64> = record
        .of("state")
        .filter(|state| state.word("fallback_level") == "fresh plan")
        .map(|state| state.stamp("sent_nanos"))
        .collect();
    let notes = vec![format!("the two hosts are {}", hosts.kind())];
    let mut measured = Measured { injections: healed.len() as u64, notes, ..Measured::default() };
    for (index, ((&cut, &at), millis)) in pulled.iter().zip(&healed).zip(cuts).enumerate() {
        // Messages under way still arrive, and a cut may begin and end within a period. Pulling and
        // plugging the cable take time.
        let expected =
            ((*millis as f64 * 1e-3 / limits.period_s) as usize).saturating_sub(2).max(1);
        let felt = periods_without_an_answer(&record, cut, at);
        if felt < expected {
            measured.violations.push(format!(
                "cut {index}, of {millis} ms: {felt} periods without an answer, \
                 expected {expected} at least: the cut had no effect"
            ));
        }
        let took = fresh.iter().find(|&&fresh| fresh > at).map(|&fresh| (fresh - at) as f64 * 1e-9);
        if took.is_none_or(|took| took > BACK_WITHIN_S) {
            let back = took.map_or("never".to_owned(), |took| format!("after {took:.2} s"));
            measured.violations.push(format!(
                "cut {index}, of {millis} ms: driving again {back}, \
                 expected {BACK_WITHIN_S} s at most"
            ));
        }
        measured.worst_restart = worse(measured.worst_restart, took);
    }
    judge_wheels(&record, &limits, &mut measured);
    judge_tracking(home, &record, &Launch::default(), &mut measured)?;
    measured.violations.extend(left_behind(home, &[control.graph_name()?, plant.graph_name()?]));
    Ok(measured)
}

/// Number of periods between two times \[ns\] without an answer to their own state.
fn periods_without_an_answer(record: &Record, from: u64, until: u64) -> usize {
    let within =
        record.of("state").filter(|state| (from..until).contains(&state.stamp("sent_nanos")));
    within
        .filter(|state| state.count("accepted_tick").checked_add(1) != Some(state.stamp("tick")))
        .count()
}

fn wait(time: Duration, stop: &Stop) {
    let end = Instant::now() + time;
    while !stop.requested() && Instant::now() < end {
        thread::sleep(Duration::from_millis(5).min(end.saturating_duration_since(Instant::now())));
    }
}
