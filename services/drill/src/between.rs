//! Hosts between which something fails for a time: what the robot did without an answer, and when
//! it drove again.
//!
//! Each host is launched by itself. Robot and controller meet in two network namespaces if the
//! system permits them and a cut is the fault, else through a relay on the loopback.

use super::catalogue::{Carrier, Failure, Launch};
use super::exercise::{SETTLED, judge_tracking, judge_wheels, left_behind, worse};
use super::hosts::{Cable, Hosts};
use super::measure::{Measured, measure};
use super::oracle::Limits;
use super::record::Record;
use super::session::{Home, Session, Trouble};
use certificates::issue::{Order, issue};
use graph::file::Processes;
use process::{Gap, Stop, Witness};
use protocol::clock::monotonic_nanos;
use protocol::message::Participant;
use runs::utc::unix_s;
use rustix::process::{Pid, Signal, kill_process};
use std::path::PathBuf;
use std::thread;
use std::time::{Duration, Instant, SystemTime};
use std::{fs, io};
use supervisor::fault_injector::Injected;

/// Longest time from the end of a failure to a fresh plan \[s\].
const BACK_WITHIN_S: f64 = 2.0;
/// The same if a whole host is launched again \[s\].
const LAUNCHED_WITHIN_S: f64 = 5.0;
/// How long the robot drives before the next failure.
const BETWEEN: Duration = Duration::from_millis(2500);
/// Far longer than the exercise takes: the drill ends all launches.
const DURATION_S: f64 = 5000.0;
/// Validity of the first certificates, and of the next ones \[s\]. The robot drives before they
/// expire. The last ones do not expire.
const VALID_S: [i64; 3] = [20, 8, 3600];
/// Interval of the hellos of a bridge.
const HELLO_EVERY_S: f64 = 0.5;
/// A certificate ends within this time after its last second begins \[s\].
const EXPIRES_WITHIN_S: f64 = 1.0;

/// One failure, and its times on the monotonic clock \[ns\].
#[derive(Debug, Clone, Copy)]
struct Felt {
    millis: u64,
    begin: u64,
    end: u64,
}

/// The launched hosts.
struct Graph<'a> {
    home: &'a Home<'a>,
    failure: Failure,
    hosts: Hosts,
    robot: Session,
    control: Session,
    training: Option<Session>,
    certificates: Option<Certificates>,
}

/// The certificates of the hosts.
struct Certificates {
    folder: PathBuf,
    /// Unix time \[s\].
    until_s: i64,
}

/// Lets `failure` happen once for each length \[ms\], and judges the record of the robot's host.
///
/// # Errors
/// If the exercise could not be done.
pub(super) fn run(
    home: &Home<'_>,
    failure: Failure,
    lengths: &[u64],
    stop: &Stop,
) -> Result<Measured, Trouble> {
    let witness = Witness::begin();
    let mut graph = Graph::launch(home, failure)?;
    let mut names = graph.names()?;
    let mut all = Vec::new();
    for (index, &millis) in lengths.iter().enumerate() {
        let stopped = graph.begin(index, stop)?;
        let begin = monotonic_nanos();
        wait(Duration::from_millis(millis), stop);
        let end = monotonic_nanos();
        graph.end(index + 1 == lengths.len(), stopped)?;
        names.extend(graph.names()?);
        all.push(Felt { millis, begin, end });
        wait(BETWEEN, stop);
        if stop.requested() {
            break;
        }
    }
    graph.robot.end()?;
    graph.control.end()?;
    graph.training.as_mut().map(Session::end).transpose()?;
    let gaps = witness.end();

    let record = graph.robot.record()?;
    let limits = home.limits()?;
    let mut measured = if failure.is_harmless() {
        judge_harmless(&record, failure, &limits, &all, &gaps)
    } else {
        judge_failures(&record, failure, &limits, &all)
    };
    judge_tracking(home, &record, &Launch::default(), &mut measured)?;
    measured.injections = all.len() as u64;
    measured.notes.push(format!("the two hosts are {}", graph.hosts.kind()));
    drop(graph);
    names.sort();
    names.dedup();
    measured.violations.extend(left_behind(home, &names));
    Ok(measured)
}

impl<'a> Graph<'a> {
    /// Launches all hosts, and waits until the robot drives.
    fn launch(home: &'a Home<'a>, failure: Failure) -> Result<Self, Trouble> {
        let hosts = if failure == Failure::Cut { Hosts::new()? } else { Hosts::with_relay()? };
        let certificates =
            (failure == Failure::Expiry).then(|| Certificates::new(home)).transpose()?;
        let launch = |name| {
            let folder = certificates.as_ref().map(|certificates| certificates.folder.as_path());
            home.launch_on(&hosts, (name, name), folder, DURATION_S)
        };
        let mut control = launch("control")?;
        control.wait_for_log("controller", "started", 1)?;
        let robot = launch("robot")?;
        let has_training = home.carrier() == Carrier::ThreeHosts;
        let mut training = has_training.then(|| launch("training")).transpose()?;
        control.wait_for_log("controller", "answering a plant", 1)?;
        if let Some(training) = &mut training {
            training.wait_for_log("learner", "started", 1)?;
        }
        thread::sleep(SETTLED);
        Ok(Self { home, failure, hosts, robot, control, training, certificates })
    }

    /// Names of the graphs in shared memory.
    fn names(&self) -> Result<Vec<String>, Trouble> {
        let sessions = [&self.robot, &self.control].into_iter().chain(&self.training);
        sessions.map(Session::graph_name).collect()
    }

    /// Begins the failure. Returns the process that is stopped, if one is.
    fn begin(&mut self, index: usize, stop: &Stop) -> Result<Option<Pid>, Trouble> {
        let session = if index.is_multiple_of(2) { &self.robot } else { &self.control };
        match self.failure {
            Failure::Cut => self.hosts.set(Cable::Pulled)?,
            Failure::Slow(bits_per_s) => self.hosts.set(Cable::Slow(bits_per_s))?,
            Failure::OtherVersion => self.hosts.set(Cable::OtherVersion)?,
            Failure::Expiry => {
                if let Some(certificates) = &self.certificates {
                    let left = certificates.until_s - unix_s(SystemTime::now());
                    wait(Duration::from_secs(u64::try_from(left).unwrap_or(0)), stop);
                }
            }
            Failure::KilledBridge => drop(signal_bridge(session, Signal::KILL)?),
            Failure::StoppedBridge => return signal_bridge(session, Signal::STOP).map(Some),
            Failure::LostController => self.control.kill_all()?,
            Failure::LostLearner => {
                self.training.as_mut().map(Session::kill_all).transpose()?;
            }
        }
        Ok(None)
    }

    /// Ends the failure; `is_last` if there is no other one.
    fn end(&mut self, is_last: bool, stopped: Option<Pid>) -> Result<(), Trouble> {
        match self.failure {
            Failure::Cut | Failure::Slow(_) | Failure::OtherVersion => {
                self.hosts.set(Cable::Plugged)?;
            }
            Failure::Expiry => {
                if let Some(certificates) = &mut self.certificates {
                    certificates.renew(self.home, if is_last { VALID_S[2] } else { VALID_S[1] })?;
                }
                for session in [&self.robot, &self.control] {
                    signal_bridge(session, Signal::KILL)?;
                }
            }
            Failure::KilledBridge => {}
            Failure::StoppedBridge => {
                let running = [&self.robot, &self.control];
                let mut running = running.into_iter().map(|one| one.pid_of(Participant::Bridge));
                if let Some(pid) = stopped.filter(|&pid| running.any(|one| one == Some(pid))) {
                    kill_process(pid, Signal::CONT)?;
                }
            }
            Failure::LostController => self.control = self.launch_again("control")?,
            Failure::LostLearner => self.training = Some(self.launch_again("training")?),
        }
        Ok(())
    }

    fn launch_again(&self, name: &str) -> Result<Session, Trouble> {
        let run = format!("{name}-{}", monotonic_nanos());
        let mut session = self.home.launch_on(&self.hosts, (name, &run), None, DURATION_S)?;
        session.wait_for_log("coxswain", "graph=", 1)?;
        Ok(session)
    }
}

fn signal_bridge(session: &Session, signal: Signal) -> Result<Pid, Trouble> {
    let bridge = session.pid_of(Participant::Bridge).ok_or("no bridge is running")?;
    kill_process(bridge, signal)?;
    Ok(bridge)
}

impl Certificates {
    fn new(home: &Home<'_>) -> Result<Self, Trouble> {
        let mut new = Self { folder: home.folder().join("certificates"), until_s: 0 };
        new.renew(home, VALID_S[0])?;
        Ok(new)
    }

    /// Replaces all certificates by ones that are valid for `valid_s`.
    fn renew(&mut self, home: &Home<'_>, valid_s: i64) -> Result<(), Trouble> {
        let now_s = unix_s(SystemTime::now());
        let order = Order {
            robot: "mecanum".to_owned(),
            hosts: ["robot", "control"].map(|host| (host.to_owned(), Vec::new())).into(),
            from_s: now_s - 60,
            until_s: now_s + valid_s,
        };
        match fs::remove_dir_all(&self.folder) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error.into()),
            _ => {}
        }
        issue(&home.folder().join("authority"), &self.folder, &order)?;
        self.until_s = order.until_s;
        Ok(())
    }
}

/// The robot was undisturbed, and a lost learner was in use again.
fn judge_harmless(
    record: &Record,
    failure: Failure,
    limits: &Limits,
    all: &[Felt],
    gaps: &[Gap],
) -> Measured {
    let learner = (failure == Failure::LostLearner).then_some(Participant::Learner);
    let ends = |felt: &Felt| Injected {
        kind: "lost host".to_owned(),
        participant: learner,
        pid: None,
        nanos: felt.end,
        millis: None,
    };
    let ends: Vec<Injected> = all.iter().map(ends).collect();
    let launch = Launch { undisturbed: true, restarts: learner, ..Launch::default() };
    measure(record, &launch, limits, &ends, gaps)
}

/// The robot felt each failure, and drove again in time after it.
fn judge_failures(record: &Record, failure: Failure, limits: &Limits, all: &[Felt]) -> Measured {
    let mut measured = Measured::default();
    let limit_s = match failure {
        Failure::LostController => LAUNCHED_WITHIN_S,
        _ => BACK_WITHIN_S,
    };
    for (index, felt) in all.iter().enumerate() {
        let (millis, begin) = (felt.millis, felt.begin);
        // The launcher ends a stopped bridge that it finds to hang.
        let hung_after = Processes::default().hung_after(Participant::Bridge);
        let hung_at = begin + hung_after.as_nanos() as u64;
        let end = if failure == Failure::StoppedBridge { felt.end.min(hung_at) } else { felt.end };
        // Messages under way still arrive, and a failure may begin and end within a period.
        let unfelt_s = match failure {
            Failure::OtherVersion => HELLO_EVERY_S,
            Failure::Expiry => EXPIRES_WITHIN_S,
            _ => 0.0,
        };
        let felt_from = begin + (unfelt_s * 1e9) as u64;
        let expected = match failure {
            Failure::Slow(_) => 0,
            _ => periods_between(record, felt_from, end, limits.period_s).saturating_sub(2).max(1),
        };
        let back = back_after(record, begin, end);
        let unanswered = periods_without_an_answer(record, begin, back.unwrap_or(u64::MAX));
        if unanswered < expected {
            measured.violations.push(format!(
                "failure {index}, of {millis} ms: {unanswered} periods without an answer, \
                 expected {expected} at least: it had no effect"
            ));
        }
        let took = back.map(|back| (back - end) as f64 * 1e-9);
        if took.is_none_or(|took| took > limit_s) {
            let back = took.map_or("never".to_owned(), |took| format!("after {took:.2} s"));
            measured.violations.push(format!(
                "failure {index}, of {millis} ms: driving again {back}, \
                 expected {limit_s} s at most"
            ));
        }
        measured.worst_restart = worse(measured.worst_restart, took);
    }
    judge_wheels(record, limits, &mut measured);
    measured
}

/// When the robot was on a fresh plan again after a failure \[ns\].
fn back_after(record: &Record, begin: u64, end: u64) -> Option<u64> {
    let mut later = record.of("state").filter(|state| state.stamp("sent_nanos") > begin);
    let is_fresh = |level: &str| level == "fresh plan";
    let lost = later.find(|state| !is_fresh(state.word("fallback_level")));
    let lost = lost.map_or(begin, |state| state.stamp("sent_nanos"));
    let fresh = record.of("state").filter(|state| is_fresh(state.word("fallback_level")));
    fresh.map(|state| state.stamp("sent_nanos")).find(|&at| at > lost.max(end))
}

/// Number of periods that the plant began between two times \[ns\], by its ticks: they go on where
/// states are lost, and stand still with a simulator that the machine suspends. Without a later
/// state of the same plant it is that of the time.
fn periods_between(record: &Record, from: u64, until: u64, period_s: f64) -> usize {
    let first = |at: u64| record.of("state").find(|state| state.stamp("sent_nanos") >= at);
    match (first(from), first(until)) {
        (Some(a), Some(b)) if a.stamp("epoch") == b.stamp("epoch") => {
            b.stamp("tick").saturating_sub(a.stamp("tick")) as usize
        }
        _ => (until.saturating_sub(from) as f64 * 1e-9 / period_s) as usize,
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::record::Message;
    use serde_json::json;
    use std::ops::Range;

    const PERIOD: u64 = 20_000_000;

    /// 40 states of a plant that stands still for `stalled` periods before tick 5, without those of
    /// the ticks `lost`. From tick `restarts` on they are those of another epoch.
    fn record(stalled: u64, lost: Range<u64>, restarts: u64) -> Record {
        let state = |tick: u64| {
            let sent = PERIOD * (tick + if tick < 5 { 0 } else { stalled });
            let (epoch, tick) = if tick < restarts { (1, tick) } else { (2, tick - restarts) };
            let stamp = json!({"sent_nanos": sent, "tick": tick, "epoch": epoch});
            Message { topic: "state".to_owned(), fields: json!({ "stamp": stamp }) }
        };
        Record::of_messages((0..40).filter(|tick| !lost.contains(tick)).map(state).collect())
    }

    #[test]
    fn periods_are_those_of_the_plant_also_where_states_are_lost_or_it_stood_still() {
        let periods = |record: &Record| periods_between(record, 0, 15 * PERIOD, 0.02);
        assert_eq!(periods(&record(0, 0..0, 40)), 15);
        assert_eq!(periods(&record(4, 0..0, 40)), 11, "stood still for 4 periods");
        assert_eq!(periods(&record(0, 3..14, 40)), 15, "states that the recorder lost");
        assert_eq!(periods(&record(0, 0..0, 12)), 15, "a restarted plant");
        assert_eq!(periods(&record(0, 10..40, 40)), 15, "no later state");
    }
}
