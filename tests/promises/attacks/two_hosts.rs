//! Requests to a robot whose plant and controller have hosts of their own, from a third machine: a
//! goal goes to the host of the controller, a stop to that of the plant.

use super::requests::gates;
use super::session::{Certificates, Failure};
use access::Role;
use graph::assembly::Assembly;
use graph::options::Options;
use promises::oracle::{Limits, acquit};
use promises::{
    Launched, Outcome, Record, Screen, binaries, graph_with, launch_command, port, signal,
    wait_until,
};
use rustix::process::Signal;
use std::path::PathBuf;
use std::process::Command;
use std::thread;
use std::time::Duration;

/// Both hosts, with a launch each, as on machines of their own.
struct TwoHosts {
    robot: Launched,
    control: Launched,
    certificates: Certificates,
    graph: PathBuf,
    /// Where the hosts of the plant and of the controller accept requests.
    plant_at: String,
    controller_at: String,
}

impl TwoHosts {
    fn new() -> Result<Self, Failure> {
        let certificates = Certificates::new()?;
        let folder = certificates.folder();
        let given = folder.to_str().ok_or("no text")?;
        let address = || port::free().map(|port| format!("127.0.0.1:{port}"));
        let (meeting, plant_at, controller_at) = (address()?, address()?, address()?);
        let tables = format!("[requests]\nrobot = \"{plant_at}\"\ncontrol = \"{controller_at}\"\n");
        let mut graph = PathBuf::new();
        let mut launch = |host: &str, other: &str| -> Result<Launched, Failure> {
            let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
            graph = graph_with("two-hosts", &tables, home.path())?;
            let to = format!("{other}={meeting}");
            let options = ["--host", host, "--address", &to, "--certificates", given];
            let mut command = launch_command(&graph, &home.path().join("run"), &options)?;
            command.args(["--scenario", "goals", "--duration", "600"]);
            Launched::by(command, home)
        };
        let (control, robot) = (launch("control", "robot")?, launch("robot", "control")?);
        control.wait_for_controller(1)?;
        Ok(Self { robot, control, certificates, graph, plant_at, controller_at })
    }

    /// `coxswain ARGUMENTS` to the host at `at`, with the certificate of `role`.
    fn command(&self, role: &Role, at: &str, arguments: &[&str]) -> Result<Command, Failure> {
        let mut command = Command::new(binaries()?.join("coxswain"));
        command.args(arguments).args(["--at", at, "--certificates"]);
        command.arg(self.certificates.folder().join(role.to_string()));
        Ok(command)
    }

    /// Its exit code.
    fn tell(&self, role: &Role, at: &str, arguments: &[&str]) -> Result<Option<i32>, Failure> {
        Ok(self.command(role, at, arguments)?.output()?.status.code())
    }

    /// State of the gate and speed forward \[m/s\], on the robot's machine.
    fn robot(&self) -> Option<(String, f64)> {
        let mut command = Command::new(binaries().ok()?.join("coxswain"));
        let output = command.args(["status", "--json"]).env("TMPDIR", self.robot.home()).output();
        let status: serde_json::Value = serde_json::from_slice(&output.ok()?.stdout).ok()?;
        let robot = &status["robot"];
        Some((robot["gate"].as_str()?.to_owned(), robot["velocity"][0].as_f64()?))
    }

    fn wait_until_it_moves(&self, mut meanwhile: impl FnMut()) -> Outcome {
        wait_until("motion", || {
            meanwhile();
            self.robot().is_some_and(|(_, speed)| speed > 0.1)
        })
    }

    fn end(self) -> Result<Record, Failure> {
        let certificates = Some(self.certificates.folder());
        let scenario = Some("goals".into());
        let options = Options { scenario, certificates, ..Options::of_graph(&self.graph) };
        let limits = Limits::of(&Assembly::read(&options)?);
        signal(self.robot.pid(), Signal::TERM)?;
        let (_, home) = self.robot.end()?;
        signal(self.control.pid(), Signal::TERM)?;
        self.control.end()?;
        let record = Record::read(&home.path().join("run"))?;
        acquit(&record, &limits)?;
        Ok(record)
    }
}

#[test]
fn a_goal_acts_at_the_controllers_host_and_a_stop_at_the_plants() -> Outcome {
    let hosts = TwoHosts::new()?;
    let (operator, planner) = (Role::Operator, Role::Planner);
    let (plant_at, controller_at) = (hosts.plant_at.as_str(), hosts.controller_at.as_str());

    assert_eq!(hosts.tell(&operator, controller_at, &["go", "300", "0", "0"])?, Some(0));
    hosts.wait_until_it_moves(|| {})?;
    // Each at the wrong host, and a stop without the right to it.
    for (role, at, arguments) in [
        (&operator, plant_at, &["hold"][..]),
        (&operator, controller_at, &["stop"]),
        (&planner, plant_at, &["stop"]),
        (&planner, controller_at, &["stop"]),
        (&planner, plant_at, &["resume"]),
    ] {
        assert_eq!(hosts.tell(role, at, arguments)?, Some(2), "{role} {arguments:?}");
    }
    let driving = hosts.robot().ok_or("no status")?;
    assert!(driving.0 == "driving" && driving.1 > 0.1, "{driving:?}");

    assert_eq!(hosts.tell(&operator, plant_at, &["stop"])?, Some(0));
    wait_until("standstill", || {
        hosts.robot().is_some_and(|(gate, speed)| gate == "stopped" && speed.abs() < 0.02)
    })?;
    assert_eq!(hosts.tell(&operator, controller_at, &["hold"])?, Some(2), "it is stopped");
    assert_eq!(hosts.tell(&operator, plant_at, &["resume"])?, Some(0));
    hosts.wait_until_it_moves(|| {})?;
    assert_eq!(hosts.tell(&planner, controller_at, &["hold"])?, Some(0));
    wait_until("standstill", || hosts.robot().is_some_and(|(_, speed)| speed.abs() < 0.02))?;

    let record = hosts.end()?;
    let gates = gates(&record);
    let stopped = gates.iter().filter(|gate| *gate == "stopped").count();
    assert!(stopped == 1 && gates.last().is_some_and(|gate| gate == "driving"), "{gates:?}");
    let goals = record.of("goal").map(|goal| goal.word("kind").to_owned());
    let mut goals: Vec<String> = goals.collect();
    goals.dedup();
    assert_eq!(goals, ["pose", "hold"], "the robot's host records the goals of the other one");
    Ok(())
}

#[test]
fn the_keys_of_an_operator_drive_two_hosts_and_stop_at_that_of_the_plant() -> Outcome {
    let hosts = TwoHosts::new()?;
    let drive = ["drive", "--dead-man", "1", "--stop-at", &hosts.plant_at];
    let drive = hosts.command(&Role::Operator, &hosts.controller_at, &drive)?;
    let mut keys = Screen::start(&drive, (100, 24))?;
    keys.wait_for(&["+0.00 +0.00 +0.00"])?;
    hosts.wait_until_it_moves(|| {
        for _ in 0..10 {
            let _ = keys.press("w");
            thread::sleep(Duration::from_millis(50));
        }
    })?;
    keys.press("x")?;
    wait_until("a latched stop", || hosts.robot().is_some_and(|(gate, _)| gate == "stopped"))?;
    keys.press("\x1b")?;
    assert_eq!(keys.end()?.code(), Some(0), "{}", keys.text());
    keys.wait_until_restored()?;
    assert_eq!(gates(&hosts.end()?).last().map(String::as_str), Some("stopped"));
    Ok(())
}
