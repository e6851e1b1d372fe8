//! Planners that are killed before, while or after they give a goal.

use super::Given;
use super::planner::{Planner, all_settled, requested, status, tell, wait_for_replies, wait_until};
use crate::measure::Measured;
use crate::session::{Home, Session, Trouble};
use process::Stop;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::process::Signal;
use std::fs;
use std::thread;
use std::time::Duration;

/// Longest time from the start of a planner to its goal \[µs\].
const BEFORE_MICROS: u64 = 150_000;
/// Longest time from the acceptance of a goal to the kill \[µs\].
const AFTER_MICROS: u64 = 600_000;
/// How long the robot stands before the next goal.
const STANDS_FOR: Duration = Duration::from_millis(500);

/// Kills `times` planners: on a path, with a velocity, and to a pose in turn.
pub(super) fn give(
    home: &Home<'_>,
    session: &Session,
    times: u32,
    seed: u64,
    stop: &Stop,
    measured: &mut Measured,
) -> Result<Given, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (mut given, mut orphans) = (Given::default(), 0);
    let file = home.folder().join("path.csv");
    fs::write(&file, "x_m,y_m\n0.3,0\n1.2,0.4\n0.8,1\n0,0.7\n")?;
    let path = file.to_string_lossy();
    for round in 0..times {
        if stop.requested() {
            break;
        }
        if tell(home, session, &["go", "0", "0", "0"], stop)? != Some(0) {
            measured.violations.push(format!("round {round}: the robot does not come back"));
        }
        let valid_s: f64 = random.random_range(0.3..1.5);
        let text = valid_s.to_string();
        let arguments = match round % 3 {
            0 => vec!["follow", &path],
            1 => vec!["drive", "0.6", "-0.3", "0.8", "--for", &text],
            _ => vec!["go", "1.2", "-0.5", "90deg"],
        };
        let before = requested(session.run());
        let planner = Planner::start(home, session, "killed", &arguments)?;
        if random.random_range(0..4) == 0 {
            thread::sleep(Duration::from_micros(random.random_range(0..BEFORE_MICROS)));
        } else {
            wait_until("a goal", stop, || Ok(all_settled(session.run()).len() as u64 > before))?;
            thread::sleep(Duration::from_micros(random.random_range(0..AFTER_MICROS)));
        }
        planner.signal(Signal::KILL)?;
        drop(planner);
        measured.injections += 1;
        let id = wait_for_replies(session.run(), stop)?;
        if id == before {
            continue; // it was killed before it gave its goal
        }
        orphans += 1;
        wait_until("a goal without its planner", stop, || {
            let status = status(home, session)?;
            let ended = !matches!(status["goal"]["phase"].as_str(), None | Some("active"));
            Ok(status["goal"]["id"] == id && ended)
        })?;
        if round % 3 == 1 {
            given.velocities.insert(id, valid_s);
        }
        thread::sleep(STANDS_FOR);
    }
    let (of, kills) = (orphans, measured.injections);
    measured.notes.push(format!("{of} of {kills} planners were killed after they gave a goal"));
    if orphans == 0 {
        measured.violations.push("no goal lost its planner: the exercise shows nothing".to_owned());
    }
    Ok(given)
}
