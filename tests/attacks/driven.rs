//! Attacks on a driving robot: recorded and forged commands in the controller's own role, and
//! unauthenticated connections while processes are killed.

use crate::session::{Certificates, Failure, Shows, connect, failed, print};
use access::Role;
use coxswain::assembly::Assembly;
use coxswain::options::Options;
use promises::oracle::{Limits, Rule, judge};
use promises::{Launched, Message, Outcome, Record, graph_file, signal};
use protocol::message::Command;
use protocol::wire;
use rustix::process::Signal;
use std::collections::BTreeMap;
use std::io::Write;
use std::net::TcpStream;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;
use std::time::Duration;
use zenoh::sample::Sample;
use zenoh::{Session, Wait};

/// The gate brakes when the acting command answers a state older than this [T].
const BRAKES_AFTER_PERIODS: f64 = 3.0;
/// Rounding error of an age in periods.
const ROUNDING: f64 = 1e-6;

/// A launch with every link over the network, its endpoint, and the name of its graph there.
pub(crate) fn launched(
    certificates: &Certificates,
    options: &[&str],
) -> Result<(Launched, String, String), Failure> {
    let folder = certificates.folder();
    let own = ["--certificates", folder.to_str().ok_or("no text")?];
    let options: Vec<&str> = own.iter().chain(options).copied().collect();
    let launched = Launched::graph("network", &options)?;
    let (endpoint, graph) = (launched.told("controller", "connect")?, launched.graph_name()?);
    launched.wait_for_log("controller", "answering a plant", 1)?;
    Ok((launched, endpoint, graph))
}

/// A received command, with its number on the link and its key.
type Stolen = (Command, Option<Vec<u8>>, String);

/// A way to falsify a genuine command.
type Forgery = (&'static str, fn(&mut Command));

/// All forgeries.
const FORGERIES: [Forgery; 6] = [
    ("again, word for word", |_| {}),
    ("by another writer", |command| {
        command.stamp.writer ^= 0x5eed;
        command.stamp.sequence += 1_000_000;
    }),
    ("of a lower epoch", |command| {
        command.stamp.writer ^= 0x5eed;
        command.stamp.epoch = command.stamp.epoch.saturating_sub(1);
        command.stamp.sequence += 1_000_000;
    }),
    ("to another plant", |command| {
        command.stamp.writer ^= 0x5eed;
        command.stamp.epoch += 1;
        command.plant_epoch = command.plant_epoch.wrapping_sub(1);
    }),
    ("to a state that is to come", |command| {
        command.stamp.writer ^= 0x5eed;
        command.stamp.epoch += 1;
        command.stamp.tick += 1_000;
    }),
    ("of a greater epoch, late", |command| {
        command.stamp.writer ^= 0x5eed;
        command.stamp.epoch += 1;
        command.stamp.tick = command.stamp.tick.saturating_sub(4);
    }),
];

/// How often commands acted, by their writer; writer 0 means that no command acted.
pub(crate) fn acted(record: &Record) -> BTreeMap<u64, usize> {
    let mut acted = BTreeMap::new();
    record
        .of("truth")
        .for_each(|truth| *acted.entry(truth.count("acting_writer")).or_default() += 1);
    acted
}

/// Age of the oldest state whose answer acted [T], and how often an answer by `writer` acted after
/// its answer to a later state. The second number shows commands that were repeated unchanged.
fn oldest(record: &Record, writer: u64, limits: &Limits) -> (f64, usize) {
    let (mut oldest, mut back, mut before) = (0.0_f64, 0, 0);
    for truth in record.of("truth") {
        oldest = oldest.max(truth.count("acting_age_nanos") as f64 * 1e-9 / limits.period_s);
        if truth.count("acting_writer") == writer {
            let answered = truth.count("acting_tick");
            oldest = oldest.max(truth.stamp("tick") as f64 - answered as f64);
            back += usize::from(answered < before);
            before = answered;
        }
    }
    (oldest, back)
}

/// Writer id of the launch's own controller.
pub(crate) fn genuine(record: &Record) -> Result<u64, Failure> {
    Ok(record.of("plan").next().ok_or("no plan")?.stamp("writer"))
}

#[test]
fn no_repeated_or_forged_command_under_the_controllers_certificate_ever_acts() -> Outcome {
    let certificates = Certificates::new()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "15"])?;
    let open = |role| connect(&endpoint, &Shows::Certificate(certificates.of(role)));
    // Only the recorder reads commands, and only the controller publishes them: this attacker has
    // stolen both certificates.
    let (thief, forger) = (open(Role::Recorder)?, open(Role::Controller)?);
    let stolen: Arc<Mutex<BTreeMap<u64, Stolen>>> = Arc::default();
    let hear = {
        let stolen = Arc::clone(&stolen);
        move |sample: Sample| {
            let key = sample.key_expr().as_str().to_owned();
            let number = sample.attachment().map(|number| number.to_bytes().to_vec());
            if let Ok(command) = wire::decode::<Command>(&sample.payload().to_bytes()) {
                let mut stolen = stolen.lock().unwrap_or_else(PoisonError::into_inner);
                // The first command was sent before any forgery, and each command is received
                // before it is repeated.
                if stolen
                    .values()
                    .next()
                    .is_none_or(|first| first.0.stamp.writer == command.stamp.writer)
                {
                    stolen.entry(command.stamp.sequence).or_insert((command, number, key));
                }
            }
        }
    };
    let data = format!("coxswain-link/{graph}/command/data");
    let _thief =
        thief.declare_subscriber(format!("{data}/*")).callback(hear).wait().map_err(failed)?;
    let mut sent = 0_usize;
    launched.wait_until("a hundred commands", || {
        let known: Vec<Stolen> =
            stolen.lock().unwrap_or_else(PoisonError::into_inner).values().cloned().collect();
        // The newest at once, and some older ones.
        for (command, number, key) in known.iter().rev().take(3).chain(known.iter().step_by(7)) {
            for (_, forge) in FORGERIES {
                sent += forged(&forger, *command, number.as_deref(), key, forge).unwrap_or(0);
            }
        }
        thread::sleep(Duration::from_millis(20));
        known.len() > 100
    })?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    let (acted, genuine) = (acted(&record), genuine(&record)?);
    let limits = Limits::of(&Assembly::read(&Options::of_graph(&graph_file("network")))?);
    let (oldest, back) = oldest(&record, genuine, &limits);
    let theirs: usize = acted
        .iter()
        .filter(|(writer, _)| ![0, genuine].contains(writer))
        .map(|(_, periods)| periods)
        .sum();
    let mut reasons: BTreeMap<&str, usize> = BTreeMap::new();
    record
        .of("state")
        .for_each(|state: &Message| *reasons.entry(state.word("reason")).or_default() += 1);
    let refused = record.of("state").next_back().map_or(0, |state| state.count("refused"));
    print(format_args!(
        "commands: {sent} said again or forged in 6 ways, {theirs} acted, {refused} refused by \
        the gate: {reasons:?}"
    ));
    print(format_args!(
        "the own controller's: the oldest state whose answer acted was {oldest:.2} T old, {back} \
        acted after one to a later state"
    ));
    assert!(sent > 1_000, "only {sent} were said");
    assert_eq!(theirs, 0, "{acted:?}");
    assert!(oldest <= BRAKES_AFTER_PERIODS + ROUNDING, "{oldest} T");
    assert_eq!(back, 0, "an old command acted again");
    // Forged commands are in the record as well, and no process counts them as lost.
    let violations: Vec<String> = judge(&record, &limits)
        .iter()
        .filter(|found| found.rule != Rule::Count)
        .map(ToString::to_string)
        .collect();
    assert_eq!(violations, [""; 0]);
    assert!(refused > 0, "{reasons:?}");
    assert!(
        acted.get(&genuine).is_some_and(|periods| *periods > 50),
        "the robot was driven by its own controller: {acted:?}"
    );
    Ok(())
}

/// Sends one falsified command, under the key of the forger and under the key of the stolen role.
fn forged(
    forger: &Session,
    mut command: Command,
    number: Option<&[u8]>,
    key: &str,
    forge: fn(&mut Command),
) -> Result<usize, Failure> {
    forge(&mut command);
    let mut out = Vec::new();
    wire::encode(&command, &mut out);
    let own = key.rsplit_once('/').map_or(key, |(data, _)| data).to_owned() + "/controller.forger";
    // With shorter pauses most would not even reach the gate.
    thread::sleep(Duration::from_micros(300));
    forger.put(own, out.clone()).wait().map_err(failed)?;
    thread::sleep(Duration::from_micros(300));
    let put = forger.put(key, out);
    match number {
        Some(number) => put.attachment(number).wait().map_err(failed)?,
        None => put.wait().map_err(failed)?,
    }
    Ok(2)
}

/// Connects to `address` and sends bytes that are no TLS, a hundred times a second, while
/// `while_knocking` runs. Returns how often.
fn knocking<T>(
    address: &str,
    while_knocking: impl FnOnce() -> Result<T, Failure>,
) -> Result<(T, usize), Failure> {
    let over = AtomicBool::new(false);
    let knock = || {
        let mut knocks = 0;
        while !over.load(Ordering::Acquire) {
            if let Ok(mut stream) = TcpStream::connect(address) {
                // The write may fail.
                let _ = stream.write_all(b"let me in");
                knocks += 1;
            }
            thread::sleep(Duration::from_millis(10));
        }
        knocks
    };
    thread::scope(|scope| {
        let knocker = scope.spawn(knock);
        let done = while_knocking();
        over.store(true, Ordering::Release);
        Ok((done?, knocker.join().map_err(|_| "it panicked")?))
    })
}

#[test]
fn processes_killed_during_a_flood_of_connections_return_and_no_other_ends() -> Outcome {
    let certificates = Certificates::new()?;
    let (launched, _, _) = launched(&certificates, &["--duration", "30"])?;
    let endpoint = launched.told_a_person("listening at ")?;
    let address = endpoint.split_once('/').ok_or("no endpoint")?.1.to_owned();
    let ((), knocks) = knocking(&address, || {
        // By then the queue of connections is so long that none is accepted for a minute.
        thread::sleep(Duration::from_secs(5));
        signal(launched.process("controller", None)?, Signal::KILL)?;
        launched.wait_for_log("controller", "answering a plant", 2)?;
        signal(launched.process("recorder", None)?, Signal::KILL)?;
        launched.wait_for_log("recorder", "started", 2)?;
        thread::sleep(Duration::from_secs(5));
        Ok(())
    })?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    let fallback_levels: Vec<&str> =
        record.of("state").map(|state| state.word("fallback_level")).collect();
    let missed = fallback_levels
        .iter()
        .skip(1)
        .filter(|fallback_level| **fallback_level != "fresh plan")
        .count();
    print(format_args!(
        "{knocks} knocks; controller and recorder killed: {missed} of {} periods without a fresh \
        plan",
        fallback_levels.len()
    ));
    assert!(knocks > 500, "{knocks}");
    let back = fallback_levels
        .iter()
        .rev()
        .take(50)
        .filter(|fallback_level| **fallback_level == "fresh plan")
        .count();
    assert!(back > 45, "{back} of the last 50 periods are on fresh plans: {}", ended.text);
    // The restarts of the controller and of the recorder.
    assert_eq!(ended.text.matches("is started again").count(), 2, "{}", ended.text);
    Ok(())
}
