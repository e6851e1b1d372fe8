//! Planners that give goals without a pause.

use super::Given;
use super::planner::{tell, wait_for_replies};
use crate::measure::Measured;
use crate::session::{Home, Session, Trouble};
use process::Stop;
use process::requests::{Request, ask};
use protocol::message::Participant;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use std::thread;
use std::time::Duration;

/// Planners that are processes, and start as soon as the one before has its reply.
const PLANNERS: u64 = 2;
/// Pause of the planner that waits for no reply.
const PAUSE: Duration = Duration::from_millis(5);
/// Its goals for each process.
const MORE: u32 = 10;

/// Starts `times` planners, and gives ten times as many goals beside them.
pub(super) fn give(
    home: &Home<'_>,
    session: &Session,
    times: u32,
    seed: u64,
    stop: &Stop,
    measured: &mut Measured,
) -> Result<Given, Trouble> {
    thread::scope(|scope| {
        let planner = |index: u64| {
            move || -> Result<(), Trouble> {
                let mut random = Pcg64Mcg::seed_from_u64(seed ^ (index << 32));
                for _ in 0..times / PLANNERS as u32 {
                    let [x, y] = [0, 1].map(|_| random.random_range(-2.0..2.0).to_string());
                    let arguments = match random.random_range(0..3) {
                        0 => vec!["go", &x, &y, "1", "--no-wait"],
                        1 => vec!["drive", &x, &y, "0.5", "--for", "60", "--no-wait"],
                        _ => vec!["hold", "--no-wait"],
                    };
                    tell(home, session, &arguments, stop)?;
                }
                Ok(())
            }
        };
        let running: Vec<_> = (0..PLANNERS).map(|index| scope.spawn(planner(index))).collect();
        let mut random = Pcg64Mcg::seed_from_u64(seed);
        for _ in 0..times * MORE {
            let [x, y] = [0, 1].map(|_| random.random_range(-2.0..2.0));
            let text = format!("# goal\n[goal.pose]\nto = [{x}, {y}, 0.0]\n");
            ask(session.run(), Participant::Controller, &Request::new("flood", text))?;
            thread::sleep(PAUSE);
        }
        running.into_iter().try_for_each(|planner| {
            planner.join().unwrap_or_else(|_| Err("a planner panicked".into()))
        })
    })?;
    measured.injections += wait_for_replies(session.run(), stop)?;
    if tell(home, session, &["go", "0", "0", "0"], stop)? != Some(0) {
        measured.violations.push("after the flood the robot reaches no goal".to_owned());
    }
    Ok(Given::default())
}
