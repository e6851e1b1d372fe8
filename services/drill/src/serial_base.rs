//! A base at a serial port: its driver, its firmware and its cable fail while it drives.
//!
//! | exercise      | what happens                                                                 |
//! |---------------|------------------------------------------------------------------------------|
//! | driver killed | the watchdog of the firmware stops the motors; the launcher starts another   |
//! | driver hangs  | the same, once the launcher has found it                                     |
//! | firmware dies | the driver ends, and its successor finds the firmware that is started again  |
//! | bad cable     | lines are damaged, cut off, lost and late, while driver and controller die   |
//!
//! After each fault the robot must drive again. The judge is [`firmware`].

use super::catalogue::SerialFault;
use super::exercise::{SETTLED, left_behind, worse};
use super::firmware::{self, BAD_CABLE, DRIVER, DRIVES, Firmware, Step};
use super::goals::DURATION_S;
use super::measure::Measured;
use super::session::{Home, INTERRUPTED, Session, Trouble};
use process::Stop;
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::process::{Signal, kill_process};
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant};

/// Longest time from a fault to a velocity of the next driver \[s\]: the driver finds a silent port
/// or is found to hang within half a second, starts, and the gate waits for good periods.
const BACK_WITHIN_S: f64 = 2.5;
/// Far longer than a robot needs until it drives.
const DRIVES_WITHIN: Duration = Duration::from_mins(1);

/// Lets the base fail `times` times while it drives, and judges it.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn run(
    home: &Home<'_>,
    fault: SerialFault,
    times: u32,
    seed: u64,
    stop: &Stop,
) -> Result<Measured, Trouble> {
    let seed_text = seed.to_string();
    let noise = match fault {
        SerialFault::BadCable => [&BAD_CABLE[..], &["--seed", &seed_text]].concat(),
        _ => Vec::new(),
    };
    let programs = programs()?;
    let start = || Firmware::start(&programs, home.folder(), &noise);
    let mut firmware = Some(start()?);
    let mut session = home.launch("run", DURATION_S)?;
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let (mut measured, mut fates) = (Measured::default(), Vec::new());
    for round in 0..times {
        wait_until_it_drives(home, stop)?;
        thread::sleep(Duration::from_micros(random.random_range(0..100_000)));
        let at = monotonic_nanos();
        fates.push(at);
        let controller = graph::role::program(Participant::Controller);
        let before = session.pid_named(controller);
        match fault {
            SerialFault::KilledFirmware => {
                drop(firmware.take());
                thread::sleep(SETTLED);
                firmware = Some(start()?);
            }
            SerialFault::StoppedDriver => signal(&session, DRIVER, Signal::STOP)?,
            SerialFault::BadCable if round % 2 == 1 => {
                signal(&session, controller, Signal::KILL)?;
                // The driver lives on, and its robot brakes: no time is measured.
                fates.pop();
                wait(stop, || session.pid_named(controller).is_some_and(|it| Some(it) != before))?;
            }
            SerialFault::KilledDriver | SerialFault::BadCable => {
                signal(&session, DRIVER, Signal::KILL)?;
            }
        }
        measured.injections += 1;
        if fates.last() == Some(&at) {
            wait(stop, || {
                firmware::steps(home.folder()).is_ok_and(|steps| drives_again(&steps, at))
            })?;
        } else {
            wait_until_it_drives(home, stop)?;
        }
    }
    session.end()?;
    drop(firmware);
    let (record, steps) = (session.record()?, firmware::steps(home.folder())?);
    measured.violations.extend(firmware::judge(&steps));
    measured.violations.extend(firmware::unsent(&record, &steps));
    for (number, &at) in fates.iter().enumerate() {
        let Some(seconds) = back(&steps, at) else {
            measured.violations.push(format!("plant was never in use again after fault {number}"));
            continue;
        };
        if seconds > BACK_WITHIN_S {
            measured.violations.push(format!(
                "plant was in use again {seconds:.2} s after fault {number}, expected \
                 {BACK_WITHIN_S} s at most"
            ));
        }
        measured.worst_restart = worse(measured.worst_restart, Some(seconds));
    }
    let is_bad = fault == SerialFault::BadCable;
    let rejected = steps.iter().map(|step| step.rejected).max().unwrap_or(0);
    if is_bad && rejected == 0 {
        measured.violations.push("the cable damaged no velocity line".to_owned());
    }
    if is_bad {
        measured.notes.push(format!("the firmware rejected {rejected} velocity lines"));
    }
    measured.violations.extend(left_behind(home, &[session.graph_name()?]));
    Ok(measured)
}

/// The folder of this program, which has the others beside it.
fn programs() -> Result<PathBuf, Trouble> {
    let own = std::env::current_exe()?;
    Ok(own.parent().ok_or("this program has no folder")?.to_path_buf())
}

/// Sends `signal` to the process of the launch that is called `program`.
fn signal(session: &Session, program: &str, signal: Signal) -> Result<(), Trouble> {
    let begin = Instant::now();
    loop {
        if let Some(pid) = session.pid_named(program) {
            return Ok(kill_process(pid, signal)?);
        }
        if begin.elapsed() > DRIVES_WITHIN {
            return Err(format!("the launcher never started {program}").into());
        }
        thread::sleep(Duration::from_millis(1));
    }
}

/// Waits until the robot drives, at a time after now.
fn wait_until_it_drives(home: &Home<'_>, stop: &Stop) -> Result<(), Trouble> {
    let now = monotonic_nanos();
    let drives = |step: Step| step.line_nanos > now && step.speed() > DRIVES;
    wait(stop, || firmware::newest(home.folder()).is_some_and(drives))
}

/// Whether the motors rested after a fault at `nanos`, and a later velocity line drives the robot.
fn drives_again(steps: &[Step], nanos: u64) -> bool {
    let mut later = steps.iter().filter(|step| step.nanos > nanos);
    let Some(rests) = later.by_ref().find(|step| step.target == [0.0; 3]) else { return false };
    later.any(|step| step.line_nanos > rests.nanos && step.speed() > DRIVES)
}

/// Waits until `happens`.
fn wait(stop: &Stop, happens: impl Fn() -> bool) -> Result<(), Trouble> {
    let begin = Instant::now();
    while !happens() {
        if stop.requested() {
            return Err(INTERRUPTED.into());
        }
        if begin.elapsed() > DRIVES_WITHIN {
            return Err("the robot does not drive".into());
        }
        thread::sleep(Duration::from_millis(50));
    }
    Ok(())
}

/// Time from a fault at `nanos` until the motors have a target from a later velocity line, after a
/// step without one \[s\].
fn back(steps: &[Step], nanos: u64) -> Option<f64> {
    let mut later = steps.iter().filter(|step| step.nanos > nanos);
    let rests = later.by_ref().find(|step| step.target == [0.0; 3])?;
    let again = later.find(|step| step.nanos > rests.nanos && step.target != [0.0; 3])?;
    Some((again.nanos - nanos) as f64 * 1e-9)
}
