//! Two launches of one robot at once: one drives, and the other reports why it does not.

use super::catalogue::Launch;
use super::exercise::{judge_tracking, left_behind, worse};
use super::measure::{Measured, measure};
use super::session::{Home, Trouble};
use process::{Stop, Witness};
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::thread;
use std::time::Duration;

/// Length of a run \[s\].
const DURATION_S: f64 = 2.0;
/// Every second pair starts at the same time; the others start up to this far apart \[µs\].
const APART_MICROS: u64 = 50_000;

/// Exit code of the launch that does not get the run directory.
const REFUSED: i32 = 2;
/// What it prints.
const REFUSAL: &str = "expected a new or empty folder";

/// Two launches that compete for one run directory, several times.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn compete(
    home: &Home<'_>,
    times: u32,
    seed: u64,
    stop: &Stop,
) -> Result<Measured, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let mut measured = Measured::default();
    let mut names = Vec::new();
    for round in 0..times {
        if stop.requested() {
            break;
        }
        let witness = Witness::begin();
        let apart = Duration::from_micros(if round % 2 == 0 {
            0
        } else {
            random.random_range(0..APART_MICROS)
        });
        let mut sessions = Vec::new();
        for place in ["one", "other"] {
            let name = format!("{place}-{round}");
            let run = format!("run-{round}");
            sessions.push((home.launch_beside(&name, &run, DURATION_S)?, name));
            thread::sleep(apart);
        }
        measured.injections += 1;
        let mut drove = Vec::new();
        for (session, name) in &mut sessions {
            let status = session.wait(DURATION_S, stop)?;
            let output = home.output(name);
            if status.success() {
                drove.push(&*session);
            } else if status.code() != Some(REFUSED) || !output.contains(REFUSAL) {
                measured.violations.push(format!(
                    "round {round}: {name} ended with {status}: {}; \
                     expected exit code {REFUSED} and {REFUSAL:?}",
                    output.lines().next_back().unwrap_or_default(),
                ));
            }
        }
        let gaps = witness.end();
        if drove.len() != 1 {
            measured.violations.push(format!(
                "round {round}: {} of two launches drove, expected one",
                drove.len()
            ));
        }
        for session in drove {
            let launch = Launch { undisturbed: true, ..Launch::default() };
            let record = session.record()?;
            let mut one = measure(&record, &launch, &home.limits()?, &[], &gaps);
            judge_tracking(home, &record, &launch, &mut one)?;
            measured
                .violations
                .extend(one.violations.into_iter().map(|found| format!("round {round}: {found}")));
            measured.excused += one.excused;
            measured.worst_reaction = worse(measured.worst_reaction, one.worst_reaction);
            measured.tracking = worse(measured.tracking, one.tracking);
            names.push(session.graph_name()?);
        }
    }
    measured.violations.extend(left_behind(home, &names));
    Ok(measured)
}

/// Two independent launches: both must drive as a single launch does.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn side_by_side(home: &Home<'_>, stop: &Stop) -> Result<Measured, Trouble> {
    let witness = Witness::begin();
    let mut sessions =
        [home.launch("first", 2.0 * DURATION_S)?, home.launch("second", 2.0 * DURATION_S)?];
    let mut measured = Measured { injections: 1, ..Measured::default() };
    let mut names = Vec::new();
    for session in &mut sessions {
        let status = session.wait(2.0 * DURATION_S, stop)?;
        if !status.success() {
            measured.violations.push(format!("a launch ended with {status}"));
        }
        names.push(session.graph_name()?);
    }
    let gaps = witness.end();
    let launch = Launch { undisturbed: true, ..Launch::default() };
    for session in &sessions {
        let record = session.record()?;
        let mut one = measure(&record, &launch, &home.limits()?, &[], &gaps);
        judge_tracking(home, &record, &launch, &mut one)?;
        measured.violations.extend(one.violations);
        measured.excused += one.excused;
        measured.worst_reaction = worse(measured.worst_reaction, one.worst_reaction);
        measured.tracking = worse(measured.tracking, one.tracking);
    }
    measured.violations.extend(left_behind(home, &names));
    Ok(measured)
}
