//! Two controllers of one robot at once: one of the launcher, and a rival unknown to the launcher.
//!
//! | exercise        | what happens                                                               |
//! |-----------------|----------------------------------------------------------------------------|
//! | a greater epoch | a rival takes over; the first controller exits, and its successor, which   |
//! |                 | the launcher starts, takes over in the same way                            |
//! | equal epochs    | both have claimed the same epoch: the gate obeys the first until one of    |
//! |                 | the two is killed, and no period has commands of both                      |
//! | an old epoch    | a rival has taken over, is stopped, replaced, and continued: its commands  |
//! |                 | are then rejected, and it exits by itself                                  |

use super::catalogue::Launch;
use super::exercise::{SETTLED, judge_tracking, judge_wheels, left_behind};
use super::measure::Measured;
use super::record::{Message, Record};
use super::session::{Home, Session, Trouble, wait_for_text};
use process::Stop;
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use rustix::process::{Pid, Signal, kill_process};
use std::collections::BTreeSet;
use std::fs;
use std::os::unix::process::CommandExt;
use std::path::PathBuf;
use std::process::{Child, Command, ExitStatus, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Longest time until a replaced controller exits.
const LEAVES_WITHIN: Duration = Duration::from_secs(20);
/// Far longer than any exercise takes: the drill ends its launches \[s\].
const DURATION_S: f64 = 5000.0;
/// What a controller logs when it has claimed its epoch.
const ANSWERS: &str = "answering a plant";
/// How long a started controller takes to open its ports.
const OPENS_WITHIN: Duration = Duration::from_millis(400);
/// Attempts for one round in which two controllers have equal epochs. An attempt fails if one of
/// them was too slow.
const TRIES: u32 = 3;
/// Delay of the states to a controller that is to be stopped, so that it has one state that it has
/// not answered yet \[ms\]. Of a period of 20 ms it is long enough to be hit by seven stops of ten,
/// and short enough for an answer within the period.
const LATE_MILLIS: u64 = 14;
/// Fewest stops of such a controller. That all of them miss happens once in a thousand drills.
const STOPS_LEAST: u32 = 6;
/// Time after which a command from the instant of waking has been rejected.
const RECEIVED_WITHIN_NANOS: u64 = 200_000_000;

/// A controller unknown to the launcher. It does not outlive this value.
struct Rival {
    child: Child,
    folder: PathBuf,
}

impl Rival {
    /// Starts one with the settings of the launcher's own, but with its own log `name` and these
    /// faults on its links.
    fn start(session: &Session, name: &str, faults: &str) -> Result<Self, Trouble> {
        let folder = session.run().with_file_name(name);
        fs::create_dir(&folder)?;
        let mut settings: toml::Table =
            fs::read_to_string(session.run().join("settings/controller.toml"))?.parse()?;
        let run = settings
            .get_mut("run")
            .and_then(toml::Value::as_table_mut)
            .ok_or("the settings of the controller have no table run")?;
        run.insert("folder".into(), folder.to_string_lossy().into_owned().into());
        let links = run
            .get_mut("links")
            .and_then(toml::Value::as_table_mut)
            .ok_or("the settings of the controller have no links")?;
        links.insert("faults".into(), faults.parse::<toml::Table>()?.into());
        let file = folder.join("settings.toml");
        fs::write(&file, settings.to_string())?;
        let program =
            std::env::current_exe()?.with_file_name(graph::role::program(Participant::Controller));
        let mut command = Command::new(program);
        command.arg("--settings").arg(file).arg("--stop-with-stdin");
        let child = command
            .process_group(0)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        Ok(Self { child, folder })
    }

    /// Waits until its log contains `text`, and returns the log.
    fn wait_for(&mut self, text: &str) -> Result<String, Trouble> {
        wait_for_text(&mut self.child, &self.folder.join("controller.log"), text, 1)
    }

    /// Waits until it has claimed an epoch, and returns the epoch.
    fn claims(&mut self) -> Result<u64, Trouble> {
        epoch_in(&self.wait_for(ANSWERS)?)
    }

    fn signal(&self, signal: Signal) -> Result<(), Trouble> {
        Ok(kill_process(Pid::from_child(&self.child), signal)?)
    }

    /// How it has exited by itself; none if it does not exit.
    fn leaves(&mut self) -> Result<Option<ExitStatus>, Trouble> {
        let begin = Instant::now();
        while begin.elapsed() < LEAVES_WITHIN {
            if let Some(status) = self.child.try_wait()? {
                return Ok(Some(status));
            }
            thread::sleep(Duration::from_millis(5));
        }
        Ok(None)
    }
}

impl Drop for Rival {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The epoch that a controller has claimed first, from its log.
fn epoch_in(log: &str) -> Result<u64, Trouble> {
    let line = log.lines().find(|line| line.contains(ANSWERS)).unwrap_or_default();
    let epoch = line
        .split_whitespace()
        .find_map(|word| word.strip_prefix("controller_epoch=")?.parse().ok());
    epoch.ok_or_else(|| format!("no epoch in {line:?}").into())
}

/// A second controller joins a graph that has one, several times.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn greater_epoch(home: &Home<'_>, times: u32, stop: &Stop) -> Result<Measured, Trouble> {
    let mut measured = Measured::default();
    let mut session = home.launch("run", DURATION_S)?;
    for round in 0..times {
        session.wait_for_log("controller", ANSWERS, 1 + round as usize)?;
        thread::sleep(SETTLED);
        if stop.requested() {
            break;
        }
        let mut second = Rival::start(&session, &format!("second-{round}"), "")?;
        measured.injections += 1;
        // It answers, is replaced by the successor of the first controller, and exits by itself.
        if second.leaves()?.is_none() {
            measured.violations.push(format!(
                "round {round}: of two controllers none has left after {LEAVES_WITHIN:?}"
            ));
        }
    }
    thread::sleep(2 * SETTLED);
    conclude(home, &mut session, &mut measured).map(|_| measured)
}

/// Ends the launch, and judges what holds for each of these exercises. Returns the record.
fn conclude(
    home: &Home<'_>,
    session: &mut Session,
    measured: &mut Measured,
) -> Result<Record, Trouble> {
    session.end()?;
    let record = session.record()?;
    if record
        .of("state")
        .next_back()
        .is_none_or(|state| state.word("fallback_level") != "fresh plan")
    {
        measured.violations.push("it does not drive at the end".to_owned());
    }
    judge_wheels(&record, &home.limits()?, measured);
    judge_tracking(home, &record, &Launch::default(), measured)?;
    measured.violations.extend(left_behind(home, &[session.graph_name()?]));
    Ok(record)
}

/// Two controllers claim the same epoch, several times, each time in a new graph. Both start before
/// the plant.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn equal_epochs(home: &Home<'_>, times: u32, stop: &Stop) -> Result<Measured, Trouble> {
    let mut measured = Measured::default();
    for attempt in 0..TRIES * times {
        if measured.injections == u64::from(times) || stop.requested() {
            break;
        }
        let mut session = home.launch(&format!("run-{attempt}"), DURATION_S)?;
        let mut rival = session.pausing_at(Participant::Controller, |session| {
            let mut rival = Rival::start(session, &format!("rival-{attempt}"), "")?;
            rival.wait_for("started")?;
            thread::sleep(OPENS_WITHIN);
            Ok(rival)
        })?;
        session.wait_for_log("controller", ANSWERS, 1)?;
        let ours = epoch_in(&fs::read_to_string(session.run().join("controller.log"))?)?;
        if rival.claims()? != ours {
            session.end()?;
            continue; // one of the two had been obeyed before the other claimed its epoch
        }
        thread::sleep(SETTLED);
        let killed_at = monotonic_nanos();
        // Kills the two in turn, independent of which of them is obeyed.
        if attempt % 2 == 0 {
            rival.signal(Signal::KILL)?;
        } else {
            let pid = session
                .pid_of(Participant::Controller)
                .ok_or("the launcher's controller is gone")?;
            kill_process(pid, Signal::KILL)?;
            if rival.leaves()?.is_none() {
                measured.violations.push(format!(
                    "round {attempt}: the successor's epoch is greater, \
                     but the other one does not leave"
                ));
            }
        }
        measured.injections += 1;
        thread::sleep(2 * SETTLED);
        let record = conclude(home, &mut session, &mut measured)?;
        let found = judge_equals(&record, ours, killed_at);
        measured
            .violations
            .extend(found.into_iter().map(|found| format!("round {attempt}: {found}")));
    }
    if measured.injections < u64::from(times) && !stop.requested() {
        measured.violations.push(format!(
            "only {} of {times} times two controllers had equal epochs",
            measured.injections
        ));
    }
    Ok(measured)
}

/// One of the two writers of `epoch` was obeyed until `killed_at`, and all commands of the other
/// were rejected.
fn judge_equals(record: &Record, epoch: u64, killed_at: u64) -> Vec<String> {
    let mut found = Vec::new();
    let before = |message: &&Message| message.stamp("sent_nanos") < killed_at;
    let commands: Vec<&Message> = record
        .of("command")
        .filter(before)
        .filter(|command| command.stamp("epoch") == epoch)
        .collect();
    let spoke: BTreeSet<u64> = commands.iter().map(|command| command.stamp("writer")).collect();
    if spoke.len() != 2 {
        found.push(format!("{} writers published in epoch {epoch}, expected two", spoke.len()));
    }
    let acted: BTreeSet<u64> = record
        .of("truth")
        .filter(before)
        .map(|truth| truth.count("acting_writer"))
        .filter(|&writer| writer > 0)
        .collect();
    if acted.len() != 1 {
        found.push(format!(
            "{} of two writers of epoch {epoch} acted while both lived, expected one",
            acted.len()
        ));
    }
    let Some(last) = record.of("state").rfind(before) else { return found };
    // The commands of the last period may not have been judged yet.
    let judged = last.stamp("tick").saturating_sub(1);
    let rejected = commands
        .iter()
        .filter(|command| {
            !acted.contains(&command.stamp("writer")) && command.stamp("tick") < judged
        })
        .count() as u64;
    if last.count("refused") < rejected {
        found.push(format!(
            "{} commands were refused, expected the {rejected} of the second writer at least",
            last.count("refused")
        ));
    }
    found
}

/// A second controller takes over. It is stopped until a successor of the first one has taken over,
/// and then continued; several times.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn old_epoch(
    home: &Home<'_>,
    times: u32,
    seed: u64,
    stop: &Stop,
) -> Result<Measured, Trouble> {
    let mut random = Pcg64Mcg::seed_from_u64(seed);
    let late = format!(
        "[[fault]]\ntopic = \"state\"\nat = \"reader\"\nkind = \"delay\"\nmillis = {LATE_MILLIS}\n"
    );
    let (mut measured, mut woken) = (Measured::default(), Vec::new());
    let mut session = home.launch("run", DURATION_S)?;
    for round in 0..times.max(STOPS_LEAST) {
        let so_far = round as usize;
        session.wait_for_log("controller", ANSWERS, 1 + so_far)?;
        thread::sleep(SETTLED);
        if stop.requested() {
            break;
        }
        let mut second = Rival::start(&session, &format!("second-{round}"), &late)?;
        let epoch = second.claims()?;
        session.wait_for_log("controller", "has taken over", 1 + so_far)?;
        second.signal(Signal::STOP)?;
        session.wait_for_log("controller", ANSWERS, 2 + so_far)?;
        thread::sleep(Duration::from_micros(random.random_range(0..SETTLED.as_micros() as u64)));
        woken.push((epoch, monotonic_nanos()));
        second.signal(Signal::CONT)?;
        measured.injections += 1;
        match second.leaves()? {
            Some(status) if status.code().is_some() => {}
            Some(status) => measured
                .violations
                .push(format!("round {round}: woken in an old epoch, it ended with {status}")),
            None => measured.violations.push(format!(
                "round {round}: woken in an old epoch, it has not left after {LEAVES_WITHIN:?}"
            )),
        }
    }
    thread::sleep(2 * SETTLED);
    let record = conclude(home, &mut session, &mut measured)?;
    let sent = judge_woken(&record, &woken, &mut measured.violations);
    measured.notes.push(format!(
        "{sent} commands of {} that were woken reached the gate in an old epoch, and were refused",
        woken.len()
    ));
    Ok(measured)
}

/// No command that was sent in an old `epoch` after it was continued has acted, and all were
/// rejected. Returns the number of such commands.
fn judge_woken(record: &Record, woken: &[(u64, u64)], violations: &mut Vec<String>) -> u64 {
    let mut sent = 0;
    for &(epoch, at) in woken {
        let of_epoch = |message: &&Message| {
            message.stamp("epoch") == epoch && message.stamp("sent_nanos") > at
        };
        let commands = record.of("command").filter(of_epoch).count() as u64;
        let acted = record
            .of("truth")
            .filter(|truth| truth.stamp("sent_nanos") > at && truth.count("acting_epoch") == epoch)
            .count();
        if acted > 0 {
            violations.push(format!("epoch {epoch} was over, and acted in {acted} periods"));
        }
        let refused = |until: u64| {
            record
                .of("state")
                .take_while(|state| state.stamp("sent_nanos") < until)
                .last()
                .map_or(0, |state| state.count("refused"))
        };
        let more = refused(at + RECEIVED_WITHIN_NANOS).saturating_sub(refused(at));
        if more < commands {
            violations.push(format!(
                "{more} commands were refused after epoch {epoch} was woken, \
                 expected the {commands} that it sent"
            ));
        }
        sent += commands;
    }
    if sent == 0 && !woken.is_empty() {
        violations
            .push("no command was sent in an old epoch: the exercise shows nothing".to_owned());
    }
    sent
}
