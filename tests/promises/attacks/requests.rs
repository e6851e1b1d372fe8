//! Requests from other machines: operators stop the robot and give goals, planners give goals and
//! lists of obstacles, and all other peers are refused.

use super::session::{Certificates, Failure, ROBOT, Shows, connect, host, print, strangers};
use access::Role;
use controller::goal::{Demand, GoalRequest};
use graph::assembly::Assembly;
use graph::options::Options;
use network::requests::{RequestError, Requester};
use promises::oracle::{Limits, acquit};
use promises::{
    Hosts, Launched, Message, Outcome, Record, Screen, binaries, graph_with, launch_command, port,
    python, repository, signal, text_of, wait_until,
};
use protocol::message::Participant;
use rustix::process::Signal;
use std::fs;
use std::path::PathBuf;
use std::process::Command;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::thread;
use std::time::Duration;
use zenoh::Wait;

/// A goal to stand still.
fn hold() -> String {
    GoalRequest::of(Demand::Hold {}).text()
}

/// A robot whose bridge accepts requests.
struct Reached {
    launched: Launched,
    certificates: Certificates,
    graph: PathBuf,
    endpoint: String,
}

impl Reached {
    fn new() -> Result<Self, Failure> {
        let address = format!("127.0.0.1:{}", port::free()?);
        Self::at(&address, &address)
    }

    /// A robot whose bridge listens at `address`, which others reach at `from_outside`.
    fn at(address: &str, from_outside: &str) -> Result<Self, Failure> {
        let certificates = Certificates::new()?;
        let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
        let tables = format!("[requests]\nrobot = \"{address}\"\n");
        let graph = graph_with("local", &tables, home.path())?;
        let folder = certificates.folder();
        let given = folder.to_str().ok_or("no text")?;
        let options = ["--scenario", "goals", "--duration", "600", "--certificates", given];
        let command = launch_command(&graph, &home.path().join("run"), &options)?;
        let launched = Launched::by(command, home)?;
        launched.wait_for_controller(1)?;
        Ok(Self { launched, certificates, graph, endpoint: format!("tls/{from_outside}") })
    }

    fn requester(&self, role: &Role) -> Result<Requester, RequestError> {
        Requester::open(&self.endpoint, &self.certificates.of(role))
    }

    /// `coxswain ARGUMENTS` with the address and the certificates.
    fn command(&self, arguments: &[&str]) -> Result<Command, Failure> {
        let mut command = Command::new(binaries()?.join("coxswain"));
        let at = self.endpoint.trim_start_matches("tls/");
        command.args(arguments).args(["--at", at, "--certificates"]);
        command.arg(self.certificates.folder()).env("TMPDIR", self.launched.home());
        Ok(command)
    }

    /// Its exit code.
    fn tell(&self, arguments: &[&str]) -> Result<Option<i32>, Failure> {
        Ok(self.command(arguments)?.output()?.status.code())
    }

    /// What `coxswain status` on the robot's machine says of the robot.
    fn robot(&self) -> Option<serde_json::Value> {
        let mut command = Command::new(binaries().ok()?.join("coxswain"));
        let output =
            command.args(["status", "--json"]).env("TMPDIR", self.launched.home()).output();
        let mut status: serde_json::Value = serde_json::from_slice(&output.ok()?.stdout).ok()?;
        Some(status["robot"].take())
    }

    fn gate(&self) -> Option<String> {
        self.robot()?["gate"].as_str().map(str::to_owned)
    }

    /// Speed forward \[m/s\].
    fn speed(&self) -> Option<f64> {
        self.robot()?["velocity"][0].as_f64()
    }

    /// Presses the key `w` again and again, until the speed is as expected.
    fn hold_until(&self, keys: &mut Screen, what: &str, expected: fn(f64) -> bool) -> Outcome {
        self.launched.wait_until(what, || {
            for _ in 0..10 {
                let _ = keys.press("w");
                thread::sleep(Duration::from_millis(50));
            }
            self.speed().is_some_and(expected)
        })
    }

    fn end(self) -> Result<Record, Failure> {
        let certificates = Some(self.certificates.folder());
        let scenario = Some("goals".into());
        let options = Options { scenario, certificates, ..Options::of_graph(&self.graph) };
        let limits = Limits::of(&Assembly::read(&options)?);
        signal(self.launched.pid(), Signal::TERM)?;
        let (_, home) = self.launched.end()?;
        let record = Record::read(&home.path().join("run"))?;
        acquit(&record, &limits)?;
        Ok(record)
    }
}

pub(super) fn gates(record: &Record) -> Vec<String> {
    let mut gates: Vec<String> =
        record.of("state").map(|state| state.word("gate").to_owned()).collect();
    gates.dedup();
    gates
}

#[test]
fn an_operator_on_another_machine_gives_goals_and_stops_the_robot() -> Outcome {
    let reached = Reached::new()?;
    assert_eq!(reached.tell(&["go", "6", "0", "0"])?, Some(0));
    assert_eq!(reached.tell(&["stop"])?, Some(0));
    assert_eq!(reached.tell(&["hold"])?, Some(2), "a stopped robot takes no goal");
    assert_eq!(reached.tell(&["resume"])?, Some(0));
    assert_eq!(reached.tell(&["hold"])?, Some(0));
    let record = reached.end()?;
    let gates = gates(&record);
    assert!(gates.ends_with(&["stopped".into(), "armed".into(), "driving".into()]), "{gates:?}");
    Ok(())
}

fn moves(speed: f64) -> bool {
    speed > 0.1
}

fn stands(speed: f64) -> bool {
    speed.abs() < 0.02
}

#[test]
fn an_operator_on_another_machine_drives_by_keyboard_and_a_lost_link_lets_the_robot_brake()
-> Outcome {
    let hosts = Hosts::with_relay()?;
    let reached = Reached::at(&hosts.address(), &hosts.far_address())?;
    let drive = reached.command(&["drive", "--dead-man", "1"])?;
    let mut keys = Screen::start(&drive, (100, 24))?;
    keys.wait_for(&["+0.00 +0.00 +0.00"])?;
    reached.hold_until(&mut keys, "motion", moves)?;
    // Without a key.
    reached.launched.wait_until("standstill", || reached.speed().is_some_and(stands))?;
    reached.hold_until(&mut keys, "motion", moves)?;
    hosts.pull_cable()?;
    reached.hold_until(&mut keys, "standstill with a key that is held", stands)?;
    hosts.plug_cable()?;
    reached.hold_until(&mut keys, "motion after the cut", moves)?;
    reached.launched.wait_until("a latched stop", || {
        keys.press("x").is_ok() && reached.gate().as_deref() == Some("stopped")
    })?;
    keys.press("\x1b")?;
    assert_eq!(keys.end()?.code(), Some(0), "{}", keys.text());
    keys.wait_until_restored()?;
    let record = reached.end()?;
    let kinds: Vec<&str> = record.of("goal").map(|goal| goal.word("kind")).collect();
    assert!(kinds.contains(&"velocity") && !kinds.contains(&"pose"), "{kinds:?}");
    Ok(())
}

#[test]
fn a_velocity_that_the_network_holds_up_moves_no_robot() -> Outcome {
    let hosts = Hosts::with_relay()?;
    let reached = Reached::at(&hosts.address(), &hosts.far_address())?;
    let velocity = Demand::Velocity { velocity: [0.5, 0.0, 0.0], valid_s: 0.4 };
    let velocity = GoalRequest::of(velocity).text();
    let mut code = None;
    // A cut of two seconds ends the session.
    for _ in 0..10 {
        let operator = reached.requester(&Role::Operator)?;
        operator.ask(Participant::Controller, &hold())?;
        hosts.pull_cable()?;
        let outcome = thread::scope(|scope| {
            let asked = scope.spawn(|| operator.ask(Participant::Controller, &velocity));
            thread::sleep(Duration::from_millis(900));
            hosts.plug_cable().map(|()| asked.join())
        })?;
        let outcome = outcome.map_err(|_| "a panic")?;
        let Ok(reply) = outcome else { continue };
        let reply: serde_json::Value = serde_json::from_slice(&reply)?;
        assert_eq!(reply["outcome"], "refused", "{reply}");
        code = reply["code"].as_str().map(str::to_owned);
        break;
    }
    assert_eq!(code.as_deref(), Some("ended"));
    let record = reached.end()?;
    let fastest = record.of("state").map(|state| state.numbers("velocity")[0].abs());
    assert!(fastest.fold(0.0, f64::max) < 0.05);
    Ok(())
}

#[test]
fn a_planner_gives_goals_and_neither_stops_the_robot_nor_changes_settings() -> Outcome {
    let reached = Reached::new()?;
    let (planner, operator) =
        (reached.requester(&Role::Planner)?, reached.requester(&Role::Operator)?);
    let hold = hold();
    planner.ask(Participant::Controller, &hold)?;
    let weights = "mpc.weights.position = 20\n";
    for (requester, to, text) in [
        (&planner, Participant::Plant, "stop"),
        (&planner, Participant::Controller, weights),
        (&planner, Participant::Learner, hold.as_str()),
        (&operator, Participant::Controller, weights),
        (&operator, Participant::Learner, "learner.every_ticks = 3\n"),
    ] {
        let outcome = requester.ask(to, text);
        assert!(matches!(outcome, Err(RequestError::Rejected(_))), "{to} {text}: {outcome:?}");
    }
    // The process itself rejects what is no order, and no goal.
    operator.ask(Participant::Plant, "jump")?;
    operator.ask(Participant::Controller, "# goal\nabsurd = true\n")?;
    let record = reached.end()?;
    assert_eq!(gates(&record).last().map(String::as_str), Some("driving"));
    Ok(())
}

#[test]
fn nobody_else_requests_anything() -> Outcome {
    let reached = Reached::new()?;
    let mut peers = strangers(&reached.certificates, "robot")?;
    for (name, role) in
        [("watcher", Role::Watcher), ("driver", Role::Driver), ("host", host("control"))]
    {
        peers.push((name, Shows::Certificate(reached.certificates.of(&role))));
    }
    // A planner that uses the key of an operator, or all keys.
    peers.push(("planner", Shows::Certificate(reached.certificates.of(&Role::Planner))));
    let mut replies = 0;
    for (name, shows) in &peers {
        let Ok(session) = connect(&reached.endpoint, shows) else { continue };
        print(format_args!("{name}: a session"));
        let of_planners: &[&str] = if *name == "planner" { &[] } else { &["planner/plant"] };
        for key in ["operator/plant", "*/plant", "operator/*", "**"].iter().chain(of_planners) {
            let key = format!("coxswain-request/{ROBOT}/{key}");
            let asked = session.get(key).payload("stop").timeout(Duration::from_secs(1)).wait();
            replies += asked.map_or(0, |answers| answers.iter().count());
            // A value instead of a query.
            let _ = session.put(format!("coxswain-request/{ROBOT}/operator/plant"), "stop").wait();
        }
    }
    assert_eq!(replies, 0);
    // The permitted one still arrives.
    reached.requester(&Role::Operator)?.ask(Participant::Controller, &hold())?;
    let folder = reached.launched.folder().join("set");
    let names = |start: &str| -> Result<usize, Failure> {
        let files = fs::read_dir(&folder)?.flatten();
        Ok(files.filter(|file| file.file_name().to_string_lossy().starts_with(start)).count())
    };
    assert_eq!((names("plant-")?, names("controller-")?), (0, 2), "request and reply of one goal");
    let record = reached.end()?;
    assert!(!gates(&record).contains(&"stopped".to_owned()));
    Ok(())
}

#[test]
fn a_list_of_obstacles_acts_only_if_it_comes_from_a_planner_and_is_correct() -> Outcome {
    let reached = Reached::new()?;
    let (planner, operator) =
        (reached.requester(&Role::Planner)?, reached.requester(&Role::Operator)?);
    let list =
        |x: f64| format!("{{\"valid_s\": 600, \"obstacles\": [{{\"corners_m\": [[{x}, 0]]}}]}}");
    planner.ask(Participant::Plant, &list(50.0))?;
    for bad in ["nonsense", "stop\n", "[]", &list(1e9), &" ".repeat(1 << 17)] {
        let outcome = planner.ask(Participant::Plant, bad);
        assert!(matches!(outcome, Err(RequestError::Rejected(_))), "{outcome:?}");
    }
    let reply: serde_json::Value =
        serde_json::from_slice(&operator.ask(Participant::Plant, &list(40.0))?)?;
    assert_eq!(reply["outcome"], "refused", "an operator sends orders alone: {reply}");
    // As fast as the session allows.
    for number in 0..200 {
        planner.ask(Participant::Plant, &list(50.0 + f64::from(number)))?;
    }
    // The last one acts from the next period on.
    thread::sleep(Duration::from_secs(1));
    let record = reached.end()?;
    assert!(record.of("obstacles").all(|list| list.word("source") == "planner"));
    let x = |list: &Message| list.fields["obstacles"][0][3].as_f64();
    let places: Vec<f64> = record.of("obstacles").filter_map(x).collect();
    assert_eq!(places.last(), Some(&249.0), "the newest one wins: {places:?}");
    assert!(!places.contains(&40.0) && places.is_sorted(), "{places:?}");
    Ok(())
}

#[test]
fn a_flood_of_goals_delays_no_stop() -> Outcome {
    let reached = Reached::new()?;
    let operator = reached.requester(&Role::Operator)?;
    let (ends, sent) = (AtomicBool::new(false), AtomicUsize::new(0));
    let planners = (0..4).map(|_| reached.requester(&Role::Planner));
    let planners = planners.collect::<Result<Vec<_>, _>>()?;
    let absurd = "# goal\n[goal.pose]\nto = [nan, 1e9, 0.0]\n".to_owned();
    let texts = [hold(), absurd, format!("# goal\n{}", "x".repeat(300_000))];
    let outcome = thread::scope(|scope| -> Outcome {
        for (index, planner) in planners.iter().enumerate() {
            let (ends, sent, texts) = (&ends, &sent, &texts);
            scope.spawn(move || {
                while !ends.load(Ordering::Relaxed) {
                    let number = sent.fetch_add(1, Ordering::Relaxed);
                    let _ = planner.ask(Participant::Controller, &texts[(number + index) % 3]);
                }
            });
        }
        let flooded = (0..5).try_for_each(|_| -> Outcome {
            let before = sent.load(Ordering::Relaxed);
            wait_until("more goals", || sent.load(Ordering::Relaxed) > before + 20)?;
            for order in ["stop", "resume"] {
                let reply = operator.ask(Participant::Plant, order)?;
                let reply: serde_json::Value = serde_json::from_slice(&reply)?;
                assert_eq!(reply["outcome"], "applied", "{order}: {reply}");
                // Both orders between two states would show in none.
                if order == "stop" {
                    wait_until("a stopped gate", || reached.gate().as_deref() == Some("stopped"))?;
                }
            }
            Ok(())
        });
        ends.store(true, Ordering::Relaxed);
        flooded
    });
    outcome?;
    print(format_args!("{} requests of planners", sent.load(Ordering::Relaxed)));
    let record = reached.end()?;
    let stops = gates(&record).iter().filter(|gate| *gate == "stopped").count();
    assert_eq!(stops, 5);
    Ok(())
}

#[test]
fn a_program_in_python_gives_goals_orders_and_lists_over_the_network() -> Outcome {
    let reached = Reached::new()?;
    let mut script = Command::new(python()?);
    script.arg("-B").arg(repository().join("tests/python/over_network.py"));
    script.arg(reached.endpoint.trim_start_matches("tls/")).arg(reached.certificates.folder());
    script.env("PYTHONPATH", repository().join("deploy/clients/python"));
    let found: serde_json::Value = serde_json::from_str(&text_of(&mut script)?)?;
    let expected = serde_json::json!({
        "pose": 1,
        "absurd": "syntax",
        "stop": true,
        "goal of a stopped robot": "gate",
        "resume": true,
        "resume again": "gate",
        "hold": 4,
        "late velocity": "out-of-date",
        "progress": true,
        "stop of a planner": true,
        "hold of a planner": 6,
        "bad list": true,
        "list of an operator": true,
        "watcher": true,
        "nobody there": true,
    });
    assert_eq!(found, expected);
    thread::sleep(Duration::from_millis(500));
    let record = reached.end()?;
    let gates = gates(&record);
    assert!(gates.ends_with(&["stopped".into(), "armed".into(), "driving".into()]), "{gates:?}");
    let sources: Vec<&str> = record.of("obstacles").map(|list| list.word("source")).collect();
    assert_eq!(sources, ["planner"]);
    Ok(())
}

#[test]
fn requests_from_the_network_need_certificates() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let graph = graph_with("local", "[requests]\nrobot = \"127.0.0.1:1\"\n", home.path())?;
    let mut command = launch_command(&graph, &home.path().join("run"), &["--duration", "1"])?;
    assert_eq!(command.output()?.status.code(), Some(2));
    Ok(())
}
