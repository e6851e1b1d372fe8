//! Processes are started, restarted and ended as promised. Here the processes are shell scripts.

use bytemuck::Zeroable;
use graph::assembly::Assembly;
use graph::options::Options;
use graph::role::{START_ORDER, program};
use process::Pace;
use protocol::message::{Health, Participant, Phase};
use std::error::Error;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use supervisor::fleet::{Event, Fleet, FleetError, RunContext, settings_file};
use supervisor::watch::View;
use tempfile::TempDir;

type Outcome = Result<(), Box<dyn Error>>;

/// Runs until it receives SIGTERM, then notes its end in a file.
const OBEDIENT: &str = "trap 'echo $0 >> \"$(dirname \"$0\")/ended\"; exit 0' TERM; \
                        echo up >> \"$0.up\"; while :; do sleep 0.01; done";
/// Ignores SIGTERM, and sends one heartbeat for each word file.
const SPEAKS: &str = "trap '' TERM; echo up >> \"$0.up\"; while :; do \
                      [ -e \"$0.word\" ] && printf '\\001' >&0 && rm \"$0.word\"; \
                      sleep 0.01; done";
/// Ignores SIGTERM.
const DEAF: &str = "trap '' TERM; echo up >> \"$0.up\"; while :; do sleep 0.01; done";

fn options() -> Options {
    let graph = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/graphs/local.toml");
    Options { duration: Some(2.0), seed: Some(9), ..Options::of_graph(&graph) }
}

/// One test at a time. Otherwise a process that another test forks could hold a script open for
/// writing, and the script could not be run.
static SCRIPTS: Mutex<()> = Mutex::new(());

struct Fixture {
    context: RunContext,
    _folder: TempDir,
    _alone: MutexGuard<'static, ()>,
}

/// A context whose programs are all `script`, except that of `other.0`, which is `other.1`.
fn fixture(script: &str, other: (Participant, &str)) -> Result<Fixture, Box<dyn Error>> {
    let alone = SCRIPTS.lock().unwrap_or_else(PoisonError::into_inner);
    let folder = tempfile::tempdir()?;
    let (programs, run) = (folder.path().join("programs"), folder.path().join("run"));
    fs::create_dir(&programs)?;
    fs::create_dir_all(run.join("settings"))?;
    for role in START_ORDER {
        let body = if role == other.0 { other.1 } else { script };
        let file = programs.join(program(role));
        fs::write(&file, format!("#!/bin/sh\n{body}\n"))?;
        fs::set_permissions(&file, fs::Permissions::from_mode(0o755))?;
    }
    let assembly = Assembly::read(&options())?;
    let links = assembly.links("test", &folder.path().join("links"));
    Ok(Fixture {
        context: RunContext { assembly, links, programs, folder: run },
        _folder: folder,
        _alone: alone,
    })
}

fn start_all(fleet: &mut Fleet<'_>, context: &RunContext) -> Outcome {
    for role in START_ORDER {
        fleet.start(role)?;
    }
    for role in START_ORDER {
        let up = context.programs.join(format!("{}.up", program(role)));
        while !up.exists() {
            std::thread::sleep(Duration::from_millis(5));
        }
    }
    Ok(())
}

/// Tends the fleet until there is an event.
fn next_events(fleet: &mut Fleet<'_>) -> Result<Vec<Event>, FleetError> {
    next_events_beside(&View::default(), fleet)
}

/// The same, beside the last messages of the processes.
fn next_events_beside(view: &View, fleet: &mut Fleet<'_>) -> Result<Vec<Event>, FleetError> {
    loop {
        let events = fleet.tend(view, Instant::now())?;
        if !events.is_empty() {
            return Ok(events);
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn ended(context: &RunContext) -> Vec<String> {
    let text = fs::read_to_string(context.programs.join("ended")).unwrap_or_default();
    let name = |line: &str| {
        PathBuf::from(line).file_name().map(|name| name.to_string_lossy().into_owned())
    };
    text.lines().filter_map(name).collect()
}

#[test]
fn the_plant_ends_first_and_the_recorder_last() -> Outcome {
    let Fixture { context, .. } = &fixture(OBEDIENT, (Participant::Plant, OBEDIENT))?;
    let mut fleet = Fleet::new(context)?;
    start_all(&mut fleet, context)?;
    let complaints = fleet.end(|_| Duration::from_mins(1), || false);
    assert_eq!(complaints, [""; 0]);
    let order = ended(context);
    assert_eq!(order.len(), 6, "{order:?}");
    assert_eq!(order.first().map(String::as_str), Some("plant-sim"));
    assert_eq!(order.last().map(String::as_str), Some("recorder"));
    Ok(())
}

#[test]
fn a_process_that_ignores_sigterm_is_killed_and_the_others_end_in_order() -> Outcome {
    let Fixture { context, .. } = &fixture(OBEDIENT, (Participant::Controller, DEAF))?;
    let mut fleet = Fleet::new(context)?;
    start_all(&mut fleet, context)?;
    let patience = |role| {
        if role == Participant::Controller {
            Duration::from_millis(50)
        } else {
            Duration::from_mins(1)
        }
    };
    let complaints = fleet.end(patience, || false);
    assert!(
        matches!(
            &complaints[..],
            [only] if only.starts_with("controller") && only.ends_with("was killed")
        ),
        "{complaints:?}"
    );
    let mut order = ended(context);
    // Processes of one row end in any order.
    order.get_mut(1..3).ok_or("too few have ended")?.sort();
    assert_eq!(order, ["plant-sim", "gateway", "learner", "bridge", "recorder"]);
    Ok(())
}

#[test]
fn an_urgent_end_does_not_wait_for_the_processes() -> Outcome {
    let Fixture { context, .. } = &fixture(DEAF, (Participant::Plant, DEAF))?;
    let mut fleet = Fleet::new(context)?;
    start_all(&mut fleet, context)?;
    assert_eq!(fleet.end(|_| Duration::from_hours(1), || true).len(), 6);
    Ok(())
}

#[test]
fn a_process_that_dies_is_restarted_at_once_in_a_higher_epoch() -> Outcome {
    let Fixture { context, .. } = &fixture(OBEDIENT, (Participant::Learner, "exit 7"))?;
    let mut fleet = Fleet::new(context)?;
    assert_eq!(fleet.start(Participant::Learner)?, 0);
    let events = next_events(&mut fleet)?;
    let [Event::Died { role, ending, wait }, again] = &events[..] else {
        return Err(format!("{events:?}").into());
    };
    assert_eq!(
        (*role, ending.to_string(), *wait),
        (Participant::Learner, "exit code 7".into(), Duration::ZERO)
    );
    assert_eq!(*again, Event::Restarted { role: Participant::Learner, epoch_floor: 1 });
    let received: learner::Settings =
        settings::read(&settings_file(&context.folder, Participant::Learner))?;
    assert!(received.run.restarted);
    assert_eq!(received.run.epoch_floor, 1);
    fleet.end(|_| Duration::from_mins(1), || false);
    Ok(())
}

#[test]
fn a_process_that_dies_repeatedly_ends_the_run_with_its_last_output() -> Outcome {
    let Fixture { context, .. } =
        &mut fixture(OBEDIENT, (Participant::Controller, "echo out of memory; exit 7"))?;
    context.assembly.graph.processes.controller.restarts_per_minute = 2;
    let mut fleet = Fleet::new(context)?;
    fleet.start(Participant::Controller)?;
    let error = loop {
        match next_events(&mut fleet) {
            Ok(_) => {}
            Err(error) => break error,
        }
    };
    let FleetError::TooManyDeaths { role, per_minute, last_words, .. } = &error else {
        return Err(error.into());
    };
    assert_eq!((*role, *per_minute), (Participant::Controller, 2));
    assert!(last_words.ends_with("out of memory"), "{error}");
    Ok(())
}

/// Lets `role` die until the fleet gives it up.
fn give_up(role: Participant, pace: Pace) -> Result<Option<String>, Box<dyn Error>> {
    let Fixture { context, .. } = &mut fixture(OBEDIENT, (role, "exit 7"))?;
    let processes = &mut context.assembly.graph.processes;
    (processes.gateway.restarts_per_minute, processes.learner.restarts_per_minute) = (2, 2);
    context.assembly.graph.pace = pace;
    let mut fleet = Fleet::new(context)?;
    fleet.start(role)?;
    let given_up = loop {
        match next_events(&mut fleet) {
            Err(FleetError::TooManyDeaths { .. }) => return Ok(None),
            events => {
                if let [Event::GivenUp { role: who, ending }] = &events?[..] {
                    assert_eq!(*who, role);
                    break ending.to_string();
                }
            }
        }
    };
    assert_eq!(fleet.tend(&View::default(), Instant::now())?, [], "it stays down");
    Ok(Some(given_up))
}

#[test]
fn a_process_that_the_robot_does_not_need_is_given_up_and_the_run_goes_on() -> Outcome {
    let expected = Some("exit code 7".to_owned());
    assert_eq!(give_up(Participant::Gateway, Pace::LockStep)?, expected);
    assert_eq!(give_up(Participant::Learner, Pace::RealTime)?, expected);
    assert_eq!(
        give_up(Participant::Learner, Pace::LockStep)?,
        None,
        "in lock step the clock would wait for it for ever"
    );
    Ok(())
}

#[test]
fn a_silent_process_is_restarted_unless_the_launcher_was_stopped() -> Outcome {
    let Fixture { context, .. } = &fixture(SPEAKS, (Participant::Plant, DEAF))?;
    let mut fleet = Fleet::new(context)?;
    fleet.start(Participant::Controller)?;
    assert!(!fleet.is_ready(Participant::Controller, Instant::now())?, "it has said nothing");
    assert_eq!(fleet.heartbeats(Participant::Controller), None);
    let processes_by_role = fleet.processes_by_role();
    let pid = || processes_by_role.lock().get(&Participant::Controller).map(|pid| pid.as_raw_pid());
    let first = pid().ok_or("nobody plays the controller")?;
    let (round, mut now) = (Duration::from_millis(20), Instant::now());
    let mut tend = |fleet: &mut Fleet<'_>, passed: Duration| {
        now += passed;
        fleet.tend(&View::default(), now)
    };
    let word = context.programs.join(format!("{}.word", program(Participant::Controller)));
    for _ in 0..50 {
        fs::write(&word, "")?;
        while word.exists() {
            std::thread::sleep(Duration::from_millis(1));
        }
        for _ in 0..15 {
            assert_eq!(tend(&mut fleet, round)?, [], "it has spoken");
        }
    }
    assert!(fleet.is_ready(Participant::Controller, Instant::now())?);
    assert_eq!(fleet.heartbeats(Participant::Controller), Some((u32::try_from(first)?, 50)));
    assert_eq!(
        tend(&mut fleet, Duration::from_mins(1))?,
        [],
        "the launcher was stopped for a minute, not the controller"
    );
    // The pause counts as a short round; this time had passed since the last heartbeat.
    let passed = Duration::from_millis(40) + round * 14;
    let mut rounds = 0;
    let silence = loop {
        rounds += 1;
        if let [Event::Hung { role: Participant::Controller, silence }] =
            tend(&mut fleet, round)?[..]
        {
            break silence;
        }
        assert!(rounds < 100, "nobody noticed");
    };
    assert!(
        (Duration::from_millis(400)..Duration::from_millis(450)).contains(&silence),
        "{silence:?}"
    );
    assert_eq!(silence, passed + round * rounds);
    while pid() == Some(first) || pid().is_none() {
        std::thread::sleep(Duration::from_millis(1));
        tend(&mut fleet, Duration::ZERO)?;
    }
    assert!(
        fs::read_to_string(format!("/proc/{first}/stat")).is_err(),
        "it is dead and buried before its successor starts"
    );
    fleet.end(|_| Duration::ZERO, || true);
    Ok(())
}

#[test]
fn a_plant_that_finishes_ends_the_run_and_one_that_fails_does_not() -> Outcome {
    for (script, finished) in [("exit 0", true), ("exit 1", false)] {
        let Fixture { context, .. } = &fixture(OBEDIENT, (Participant::Plant, script))?;
        let mut fleet = Fleet::new(context)?;
        fleet.start(Participant::Plant)?;
        assert_eq!(
            next_events(&mut fleet)?.first() == Some(&Event::Finished),
            finished,
            "{script}"
        );
        fleet.end(|_| Duration::from_mins(1), || false);
    }
    Ok(())
}

#[test]
fn a_plant_that_has_reported_its_end_and_is_killed_then_ends_the_run() -> Outcome {
    for (phase, finished) in [(Phase::Finished, true), (Phase::Running, false)] {
        let Fixture { context, .. } = &fixture(OBEDIENT, (Participant::Plant, "kill -KILL $$"))?;
        let mut fleet = Fleet::new(context)?;
        fleet.start(Participant::Plant)?;
        let mut view = View::default();
        view.update_health(&Health {
            participant: Participant::Plant.code(),
            phase: phase.code(),
            ..Health::zeroed()
        });
        let events = next_events_beside(&view, &mut fleet)?;
        assert_eq!(events.first() == Some(&Event::Finished), finished, "{phase:?}: {events:?}");
        fleet.end(|_| Duration::from_mins(1), || false);
    }
    Ok(())
}

#[test]
fn a_death_before_readiness_is_reported_with_the_last_output() -> Outcome {
    let Fixture { context, .. } =
        &fixture(OBEDIENT, (Participant::Recorder, "echo disk full >&2; exit 1"))?;
    let mut fleet = Fleet::new(context)?;
    fleet.start(Participant::Recorder)?;
    let error = loop {
        match fleet.is_ready(Participant::Recorder, Instant::now()) {
            Ok(_) => std::thread::sleep(Duration::from_millis(5)),
            Err(error) => break error.to_string(),
        }
    };
    assert_eq!(error, "recorder ended with exit code 1 before it was ready\n    disk full");
    Ok(())
}

#[test]
fn every_process_can_read_its_settings() -> Outcome {
    let Fixture { context, .. } = &fixture(OBEDIENT, (Participant::Plant, OBEDIENT))?;
    let mut fleet = Fleet::new(context)?;
    start_all(&mut fleet, context)?;
    let file = |role| settings_file(&context.folder, role);
    let plant: plant_sim::Settings = settings::read(&file(Participant::Plant))?;
    let controller: controller::Settings = settings::read(&file(Participant::Controller))?;
    let learner: learner::Settings = settings::read(&file(Participant::Learner))?;
    let recorder: recorder::settings::Settings = settings::read(&file(Participant::Recorder))?;
    let gateway: gateway::settings::Settings = settings::read(&file(Participant::Gateway))?;
    assert_eq!(
        (gateway.telemetry, gateway.rates),
        (context.assembly.graph.telemetry.clone(), context.assembly.graph.rates)
    );
    assert_eq!((plant.seed, plant.truth), (9, context.assembly.scenario.truth.clone()));
    assert_eq!(
        (controller.robot, controller.mpc),
        (context.assembly.robot, context.assembly.scenario.mpc)
    );
    assert_eq!(learner.learner, context.assembly.scenario.learner);
    assert_eq!(recorder.run.links, context.links);
    fleet.end(|_| Duration::from_mins(1), || false);
    Ok(())
}
