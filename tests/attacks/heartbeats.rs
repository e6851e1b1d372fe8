//! False heartbeats and too many heartbeats, by peers with a certificate that permits some.

use crate::driven::launched;
use crate::floods::port;
use crate::session::{Certificates, Failure, ROBOT, Shows, connect, failed, print};
use access::Role;
use bytemuck::Zeroable;
use promises::{Launched, Outcome, Record, graph_file, launch_command, signal};
use protocol::VERSION;
use protocol::clock::monotonic_nanos;
use protocol::message::{Health, Message, Participant, Phase};
use protocol::wire;
use rustix::process::Signal;
use std::fs;
use std::thread;
use std::time::{Duration, Instant};
use zenoh::qos::CongestionControl;
use zenoh::{Session, Wait};

/// The controller's log line about an adopted model, before its version.
const ADOPTED: &str = "model adopted version=";
/// A process id that no system uses.
const NO_PROCESS: u32 = u32::MAX;
/// Interval of the attacker's messages.
const LIES_EVERY: Duration = Duration::from_millis(50);
/// Pause before the next name: a router drops a message right behind another one of the same role.
const NEXT_AFTER: Duration = Duration::from_millis(2);
/// How long a robot drives on during an attack.
const LIES_FOR: Duration = Duration::from_secs(5);
/// How often the attacker declares too many tokens for [`SHOWS_FOR`]. Each time is followed by a
/// calm of the same length.
const SHOWS: usize = 3;
const SHOWS_FOR: Duration = Duration::from_secs(1);
/// Time for a robot to drive again.
const DRIVES_AGAIN_AFTER_S: f64 = 3.0;

/// A heartbeat: `participant`, as the process `pid`, is in `phase`.
fn heartbeat(participant: Participant, pid: u32, phase: Phase) -> Vec<u8> {
    heartbeat_of(0, 1, participant, pid, phase)
}

/// The same by `writer`, in `epoch`.
fn heartbeat_of(
    writer: u64,
    epoch: u64,
    participant: Participant,
    pid: u32,
    phase: Phase,
) -> Vec<u8> {
    let mut health = Health::zeroed();
    (health.stamp.version, health.stamp.kind, health.stamp.epoch, health.stamp.writer) =
        (VERSION, Health::KIND, epoch, writer);
    // Changes with each heartbeat, as in a running loop.
    (health.stamp.sent_nanos, health.stamp.sequence, health.heartbeat) =
        (monotonic_nanos(), monotonic_nanos(), monotonic_nanos());
    (health.participant, health.phase, health.pid) = (participant.code(), phase.code(), pid);
    let mut message = Vec::new();
    wire::encode(&health, &mut message);
    message
}

/// Publishes a heartbeat under the writer name `name`, as urgent: a router drops heartbeats that
/// arrive together as too many.
fn say(session: &Session, graph: &str, name: &str, message: Vec<u8>) -> Outcome {
    let put = session.put(format!("coxswain-link/{graph}/health/data/{name}"), message);
    put.congestion_control(CongestionControl::Drop).express(true).wait().map_err(failed)
}

/// Publishes the messages of `word` under each of `names` in turn, with a pause between them, for
/// `time`.
fn lie(
    session: &Session,
    graph: &str,
    names: &[&str],
    word: impl Fn() -> Vec<u8>,
    pause: Duration,
    time: Duration,
) -> Outcome {
    let begin = Instant::now();
    for name in names.iter().cycle() {
        if begin.elapsed() > time {
            break;
        }
        say(session, graph, name, word())?;
        thread::sleep(pause);
    }
    Ok(())
}

/// Ends a launch, and returns its output, its log and its record.
fn ended(launched: Launched) -> Result<(String, String, Record), Failure> {
    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(128 + Signal::TERM.as_raw()), "{}", ended.text);
    let log = fs::read_to_string(home.path().join("run/coxswain.log"))?;
    Ok((ended.text, log, Record::read(&home.path().join("run"))?))
}

#[test]
fn a_role_that_floods_heartbeats_silences_no_process_and_imitates_no_other_role() -> Outcome {
    let certificates = Certificates::for_a_flood()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "20"])?;
    let learner = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Learner)))?;
    let key = format!("coxswain-link/{graph}/health/data/learner.flood");
    let (begin, mut sent) = (Instant::now(), 0_usize);
    launched.wait_until("five seconds of the flood", || {
        let burst = Instant::now();
        while burst.elapsed() < Duration::from_millis(500) {
            for (participant, phase) in
                [(Participant::Learner, Phase::Running), (Participant::Plant, Phase::Finished)]
            {
                let put = learner.put(&key, heartbeat(participant, NO_PROCESS, phase));
                sent += usize::from(put.congestion_control(CongestionControl::Drop).wait().is_ok());
            }
        }
        begin.elapsed() > LIES_FOR
    })?;
    let lasted = begin.elapsed().as_secs_f64();
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let log = fs::read_to_string(home.path().join("run/coxswain.log"))?;
    let record = Record::read(&home.path().join("run"))?;
    let forged: Vec<&str> = record
        .of("health")
        .filter(|health| health.count("pid") == u64::from(NO_PROCESS))
        .map(|health| health.word("participant"))
        .collect();
    let fresh =
        record.of("state").filter(|state| state.word("fallback_level") == "fresh plan").count();
    print(format_args!(
        "heartbeats: {sent} said by one role in {lasted:.1} s, {} of them recorded; {fresh} of \
        201 periods on fresh plans",
        forged.len()
    ));
    assert!(sent > 10_000, "{sent}");
    // The limits are fifty per second of one writer, and sixteen at once; the last may be received
    // a little after it was published.
    assert!(
        !forged.is_empty() && forged.len() as f64 <= 50.0 * (lasted + 1.0) + 16.0,
        "{} in {lasted} s",
        forged.len()
    );
    assert!(forged.iter().all(|participant| *participant == "learner"), "{forged:?}");
    assert!(
        log.contains(
            "rejected at the network: learner.mecanum publishes on health above the rate limit"
        ),
        "{log}"
    );
    assert!(
        log.contains(
            "learner publishes more on health than 50 messages a second from each of 4 writers"
        ),
        "{log}"
    );
    assert!(log.contains("learner publishes on health what its role may not publish"), "{log}");
    assert!(!ended.text.contains("is started again"), "{}", ended.text);
    assert_eq!(record.of("state").last().map(|state| state.stamp("tick")), Some(200));
    assert!(fresh > 150, "{fresh}");
    Ok(())
}

#[test]
fn a_process_that_hangs_is_killed_despite_false_heartbeats_under_its_certificate() -> Outcome {
    let certificates = Certificates::new()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "600"])?;
    let attacker = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Controller)))?;
    let pid = launched.process("controller", None)?;
    let word = || heartbeat(Participant::Controller, pid, Phase::Running);
    let lie_until = |what: &str, holds: &dyn Fn() -> bool| {
        launched.wait_until(what, || {
            thread::sleep(LIES_EVERY);
            say(&attacker, &graph, "controller.attacker", word()).is_ok() && holds()
        })
    };
    let begin = Instant::now();
    lie_until("some lies", &|| begin.elapsed() > Duration::from_secs(1))?;
    // Above these epochs there would be none left for its successor.
    for (writer, epoch) in [(1, u64::MAX), (2, i64::MAX as u64), (3, i64::MAX as u64 - 1)] {
        thread::sleep(LIES_EVERY);
        say(
            &attacker,
            &graph,
            "controller.attacker",
            heartbeat_of(writer, epoch, Participant::Controller, pid, Phase::Running),
        )?;
    }
    signal(pid, Signal::STOP)?;
    lie_until("the end of who hangs", &|| !launched.processes().contains(&pid))?;
    let answers = || {
        fs::read_to_string(launched.folder().join("controller.log"))
            .unwrap_or_default()
            .matches("answering a plant")
            .count()
    };
    lie_until("its successor", &|| answers() == 2)?;
    let (text, log, record) = ended(launched)?;
    assert_eq!(text.matches("controller has been silent").count(), 1, "{text}");
    assert_eq!(text.matches("is started again").count(), 1, "{text}");
    assert!(log.contains("hangs, and was killed"), "{log}");
    let epoch = record.of("plan").last().map(|plan| plan.stamp("epoch"));
    assert!(
        epoch.is_some_and(|epoch| epoch < u64::from(u32::MAX)),
        "{epoch:?} follows epochs that somebody else has said"
    );
    // The attacker has no number of its own.
    let lies = record
        .of("health")
        .filter(|health| health.count("pid") == u64::from(pid) && health.stamp("writer") == 0)
        .count();
    assert!(lies > 10, "nobody heard the lies");
    Ok(())
}

#[test]
fn a_killed_learner_returns_and_stays_despite_many_other_writers_in_its_role() -> Outcome {
    let certificates = Certificates::new()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "600"])?;
    let attacker = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Learner)))?;
    let names: Vec<String> = (0..8).map(|name| format!("learner.{name}")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let word = || heartbeat(Participant::Learner, NO_PROCESS, Phase::Running);
    let lie_for = |time: Duration| lie(&attacker, &graph, &names, word, NEXT_AFTER, time);
    lie_for(Duration::from_secs(1))?;
    let pid = launched.process("learner", None)?;
    launched.wait_for_log("controller", ADOPTED, 1)?;
    signal(pid, Signal::KILL)?;
    let adopted = || {
        let log = fs::read_to_string(launched.folder().join("controller.log")).unwrap_or_default();
        log.rsplit_once(ADOPTED).and_then(|(_, rest)| rest.split(' ').next()?.parse::<u64>().ok())
    };
    let before = adopted();
    // Longer than the learner's place is kept. The second time it is longer than a starting process
    // may be silent.
    lie_for(LIES_FOR)?;
    let next = launched.process("learner", Some(pid))?;
    lie_for(2 * LIES_FOR)?;
    // One may have been on its way when the first was killed.
    launched.wait_until("new models", || {
        lie_for(LIES_EVERY).is_ok() && adopted() > before.map(|before| before + 1)
    })?;
    assert!(launched.processes().contains(&next), "the second has gone as well");
    let (text, log, record) = ended(launched)?;
    assert_eq!(text.matches("is started again").count(), 1, "{text}");
    assert!(!text.contains("has been silent"), "{text}");
    assert!(
        log.contains(
            "learner publishes more on health than 50 messages a second from each of 4 writers"
        ),
        "{log}"
    );
    let of = |pid: u32| {
        record.of("health").filter(move |health| health.count("pid") == u64::from(pid)).count()
    };
    print(format_args!(
        "heartbeats by eight names: {} recorded, {} of the learner, {} of its successor",
        of(NO_PROCESS),
        of(pid),
        of(next)
    ));
    assert!(of(NO_PROCESS) > 50);
    Ok(())
}

#[test]
fn tokens_of_another_protocol_version_prevent_no_restart() -> Outcome {
    let certificates = Certificates::new()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "600"])?;
    let attacker = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Learner)))?;
    let ports = format!("coxswain-link/{graph}/health/writer");
    let others = ["1/Health/newest-wins", "4/Sonnet/newest-wins", "4/Health/lossless"];
    let show = |other| {
        attacker
            .liveliness()
            .declare_token(format!("{ports}/{other}/learner.{}", monotonic_nanos()))
            .wait()
            .map_err(failed)
    };
    let _tokens = others.map(show).into_iter().collect::<Result<Vec<_>, _>>()?;
    for (role, says) in [("recorder", "started"), ("controller", "answering a plant")] {
        let count = fs::read_to_string(launched.folder().join(format!("{role}.log")))?
            .matches(says)
            .count();
        signal(launched.process(role, None)?, Signal::KILL)?;
        launched.wait_for_log(role, says, count + 1)?;
    }
    // As long as they would take to end because of what they observe.
    thread::sleep(LIES_FOR / 2);
    let (text, _, record) = ended(launched)?;
    assert_eq!(text.matches("is started again").count(), 2, "{text}");
    assert_eq!(
        record.of("state").last().map(|state| state.word("fallback_level")),
        Some("fresh plan")
    );
    Ok(())
}

#[test]
fn a_writer_under_a_learners_name_silences_that_learner_alone_and_is_reported() -> Outcome {
    let certificates = Certificates::for_a_flood()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "600"])?;
    let attacker = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Learner)))?;
    let name =
        port(&attacker, &format!("coxswain-link/{graph}/health"), ("writer", Role::Learner))?;
    let pid = launched.process("learner", None)?;
    let key = format!("coxswain-link/{graph}/health/data/{name}");
    let word = || heartbeat(Participant::Learner, NO_PROCESS, Phase::Running);
    let (begin, from, mut sent) = (Instant::now(), monotonic_nanos(), 0_usize);
    while begin.elapsed() < LIES_FOR {
        sent += usize::from(
            attacker.put(&key, word()).congestion_control(CongestionControl::Drop).wait().is_ok(),
        );
    }
    let flood = from..monotonic_nanos();
    // Then the greatest number: every later message of the learner counts as a repetition. Behind
    // the flood several attempts may be needed.
    launched.wait_until("a word of whom nobody hears", || {
        thread::sleep(LIES_EVERY);
        let put =
            attacker.put(&key, word()).attachment(u64::MAX.to_le_bytes()).express(true).wait();
        let log = fs::read_to_string(launched.folder().join("coxswain.log")).unwrap_or_default();
        put.is_ok() && log.contains("runs, but its heartbeats do not arrive")
    })?;
    assert!(launched.processes().contains(&pid), "it has been killed");
    let (text, log, record) = ended(launched)?;
    assert!(!text.contains("is started again") && !text.contains("has been silent"), "{text}");
    assert!(text.contains("learner runs, but its last"), "{text}");
    assert_eq!(text.matches("heartbeats did not arrive on the graph's links").count(), 1, "{text}");
    assert!(log.contains("learner.mecanum publishes on health above the rate limit"), "{log}");
    let heard = |participant: &str| {
        let of = |health: &&promises::Message| {
            flood.contains(&health.stamp("sent_nanos"))
                && health.count("pid") != u64::from(NO_PROCESS)
        };
        record.health_of(participant).filter(of).count()
    };
    let states = || record.of("state").filter(|state| state.stamp("sent_nanos") > flood.start);
    let fresh = states().filter(|state| state.word("fallback_level") == "fresh plan").count();
    print(format_args!(
        "heartbeats: {sent} said under the learner's own name in 5 s; meanwhile \
        recorded {} of the learner, {} of the plant, {} of the \
         controller; {fresh} of {} periods on fresh plans since",
        heard("learner"),
        heard("plant"),
        heard("controller"),
        states().count()
    ));
    assert!(sent > 10_000, "{sent}");
    assert!(heard("plant") > 10 && heard("controller") > 10, "they are silenced as well");
    assert!(fresh * 10 >= states().count() * 9, "{fresh} of {}", states().count());
    let models: Vec<u64> = record.of("plan").map(|plan| plan.count("model_version")).collect();
    assert!(
        models.len() > 50 && models.last() > models.iter().nth_back(50),
        "no new models come: {models:?}"
    );
    Ok(())
}

#[test]
fn a_false_report_that_the_remote_plant_has_finished_ends_no_run() -> Outcome {
    let certificates = Certificates::new()?;
    let folder = certificates.folder();
    let own = ["--certificates", folder.to_str().ok_or("no text")?];
    let home = || tempfile::Builder::new().prefix("cx").tempdir_in("/tmp");
    let launch = |graph: &str, name: &str, options: &[&str]| -> Result<Launched, Failure> {
        let home = home()?;
        // A name of its own: other tests run on this machine as well.
        let text = fs::read_to_string(graph_file(graph))?
            .replace("graph = \"mecanum\"", &format!("graph = \"{name}\""));
        let graphs = graph_file(graph).parent().ok_or("no folder")?.display().to_string();
        fs::write(
            home.path().join("graph.toml"),
            text.replace("\"../", &format!("\"{graphs}/../")),
        )?;
        let mut command =
            launch_command(&home.path().join("graph.toml"), &home.path().join("run"), &own)?;
        command.args(options);
        Launched::by(command, home)
    };
    let name = format!("{ROBOT}-{}", std::process::id());
    let near = launch("plant-host", &name, &["--duration", "20", "--listen", "tcp/127.0.0.1:0"])?;
    let endpoint = near.told_a_person("listening at ")?.replace("tls/", "tcp/");
    let far = launch("control-host", &name, &["--connect", &endpoint])?;
    far.wait_for_log("controller", "answering a plant", 1)?;
    let door = far.told("controller", "connect")?;
    let attacker = connect(&door, &Shows::Certificate(certificates.of(Role::Learner)))?;
    let word = || heartbeat(Participant::Plant, NO_PROCESS, Phase::Finished);
    lie(&attacker, &name, &["learner.attacker"], word, LIES_EVERY, LIES_FOR)?;
    assert!(!far.processes().is_empty(), "it has ended");
    let (ended, home) = near.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let (far_ended, far_home) = far.end()?;
    assert!(far_ended.status.success(), "{}", far_ended.text);
    let log = fs::read_to_string(far_home.path().join("run/coxswain.log"))?;
    assert!(log.contains("learner publishes on health what its role may not publish"), "{log}");
    let record = Record::read(&home.path().join("run"))?;
    let fallback_levels: Vec<&str> =
        record.of("state").map(|state| state.word("fallback_level")).collect();
    assert_eq!(record.of("state").last().map(|state| state.stamp("tick")), Some(200));
    let last = fallback_levels
        .iter()
        .rev()
        .take(50)
        .filter(|fallback_level| **fallback_level == "fresh plan")
        .count();
    assert!(last > 45, "{last} of the last 50 periods on fresh plans");
    Ok(())
}

#[test]
fn thousands_of_tokens_kill_no_process_and_the_robot_drives_on_afterwards() -> Outcome {
    let certificates = Certificates::for_a_flood()?;
    let (launched, endpoint, graph) = launched(&certificates, &["--duration", "600"])?;
    let gateway = connect(&endpoint, &Shows::Certificate(certificates.of(Role::Gateway)))?;
    let (mut shown, mut floods) = (0_usize, Vec::new());
    for _ in 0..SHOWS {
        thread::sleep(SHOWS_FOR);
        let (begin, from) = (Instant::now(), monotonic_nanos());
        while begin.elapsed() < SHOWS_FOR {
            let key = format!("coxswain-link/{graph}/state/reader/gateway.{:x}", monotonic_nanos());
            let token = gateway.liveliness().declare_token(key).wait();
            shown += usize::from(token.is_ok());
        }
        floods.push(from..monotonic_nanos());
    }
    drop(gateway);
    thread::sleep(Duration::from_secs_f64(2.0 * DRIVES_AGAIN_AFTER_S));
    let (text, _, record) = ended(launched)?;
    let fallback_levels = |wanted: &dyn Fn(u64) -> bool| -> Vec<&str> {
        record
            .of("state")
            .filter(|state| wanted(state.stamp("sent_nanos")))
            .map(|state| state.word("fallback_level"))
            .collect()
    };
    let fresh = |fallback_levels: &[&str]| {
        fallback_levels.iter().filter(|fallback_level| **fallback_level == "fresh plan").count()
    };
    let during = fallback_levels(&|nanos| floods.iter().any(|flood| flood.contains(&nanos)));
    let driven_again =
        floods.last().map_or(0, |flood| flood.end) + (DRIVES_AGAIN_AFTER_S * 1e9) as u64;
    let after = fallback_levels(&|nanos| nanos > driven_again);
    print(format_args!(
        "tokens: {shown} shown in {SHOWS} s by one role; {} of {} periods on fresh plans \
        meanwhile, {} of {} afterwards",
        fresh(&during),
        during.len(),
        fresh(&after),
        after.len()
    ));
    assert!(shown > 500, "{shown}");
    assert!(!text.contains("is started again") && !text.contains("has been silent"), "{text}");
    assert!(after.len() > 10 && fresh(&after) * 10 >= after.len() * 9, "{after:?}");
    Ok(())
}
