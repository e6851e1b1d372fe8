//! Time from an operator's stop over the network to the gate that brakes, in real time with
//! T = 20 ms: `cargo bench -p promises --bench stop_over_network [-- TRIALS]`.
//!
//! A robot drives to a goal far away. Each trial sends a stop over TLS to its bridge, on a session
//! that is open. The time ends when the plant sends the first state whose gate has stopped; the
//! output of that period is the first one on the brake. Both times are of the same clock.

#![expect(clippy::print_stdout, reason = "figures are what a bench is for")]

use access::{Credentials, Role};
use bridge::settings::Settings;
use certificates::issue::{Order, issue};
use controller::goal::{Demand, GoalRequest};
use network::requests::Requester;
use network::threads;
use process::read_settings;
use promises::{Launched, graph_with, launch_command};
use protocol::clock::monotonic_nanos;
use protocol::message::{GateState, Participant, PlantState};
use std::error::Error;
use std::net::TcpListener;
use std::thread;
use std::time::{Duration, SystemTime, UNIX_EPOCH};
use transport::{Identity, Ports, Source};

const PERIOD_NANOS: u64 = 20_000_000;
const TRIALS: usize = 1000;

/// Waits for a state whose gate is as expected; returns when it was sent \[ns\].
fn gate(states: &mut Source<PlantState>, expected: GateState) -> Result<u64, Box<dyn Error>> {
    loop {
        states.wait(Duration::from_secs(1))?;
        while let Some(state) = states.next()? {
            if state.gate() == expected {
                return Ok(state.stamp.sent_nanos);
            }
        }
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    threads::set()?;
    let trials = std::env::args().find_map(|text| text.parse().ok()).unwrap_or(TRIALS);
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let now_s = i64::try_from(SystemTime::now().duration_since(UNIX_EPOCH)?.as_secs())?;
    let order = Order {
        robot: "mecanum".to_owned(),
        hosts: [("robot".to_owned(), Vec::new())].into(),
        from_s: now_s - 3_600,
        until_s: now_s + 86_400,
    };
    let folder = home.path().join("certificates");
    issue(&home.path().join("authority"), &folder, &order)?;
    let port = TcpListener::bind("127.0.0.1:0")?.local_addr()?.port();
    let tables = format!("[requests]\nrobot = \"127.0.0.1:{port}\"\n");
    let graph = graph_with("local", &tables, home.path())?;
    let given = folder.to_str().ok_or("no text")?;
    let options = ["--scenario", "goals", "--duration", "10000", "--certificates", given];
    let command = launch_command(&graph, &home.path().join("run"), &options)?;
    let launched = Launched::by(command, home)?;
    launched.wait_for_controller(1)?;
    let file = launched.folder().join("settings/bridge.toml");
    let Settings { run, .. } = read_settings(&file)?;
    let ports = Ports::open(&run.links, Identity::new(0))?;
    let mut states = ports.watcher::<PlantState>()?;
    let endpoint = format!("tls/127.0.0.1:{port}");
    let credentials = Credentials::in_folder(folder.join(Role::Operator.to_string()));
    let operator = Requester::open(&endpoint, &credentials)?;
    let goal = Demand::Pose { to: [1e3, 0.0, 0.0] };
    let goal = GoalRequest::of(goal);
    operator.ask(Participant::Controller, &goal.text())?;
    let mut nanos = Vec::with_capacity(trials);
    for trial in 0..trials {
        gate(&mut states, GateState::Driving)?;
        // Another place within the period in each trial.
        thread::sleep(Duration::from_micros(PERIOD_NANOS / 1000 * (trial as u64 * 7 % 20) / 20));
        let begin = monotonic_nanos();
        operator.ask(Participant::Plant, "stop")?;
        nanos.push(gate(&mut states, GateState::Stopped)?.saturating_sub(begin));
        operator.ask(Participant::Plant, "resume")?;
    }
    nanos.sort_unstable();
    let share = |percent: usize| {
        let index = (nanos.len() * percent / 100).min(nanos.len().saturating_sub(1));
        nanos.get(index).copied().unwrap_or(0) as f64 * 1e-6
    };
    let beyond = nanos.iter().filter(|&&nanos| nanos > 2 * PERIOD_NANOS).count();
    println!(
        "stop over the network → gate on the brake, {} trials, T = 20 ms: {:.1} ms p50, {:.1} ms \
         p99, {:.1} ms at most; {beyond} above 2 T",
        nanos.len(),
        share(50),
        share(99),
        share(100)
    );
    Ok(())
}
