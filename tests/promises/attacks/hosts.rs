//! Attacks on the bridge of a driving robot's host. The bridge's own tests count what it rejects.

use super::session::{
    Certificates, Failure, HOUR_S, ROBOT, Shows, connect, host, print, router, strangers,
};
use access::Role;
use bytemuck::Zeroable;
use graph::assembly::Assembly;
use graph::options::Options;
use network::{Breach, keeps_strangers_out};
use process::read_settings;
use promises::oracle::{Limits, acquit};
use promises::{Launched, Outcome, Record, graph_file, launch_command, port, repository};
use protocol::message::{Command, Message, ModelSnapshot, SnapshotHead};
use protocol::{VERSION, wire};
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::io::Write;
use std::net::TcpStream;
use std::thread;
use std::time::{Duration, Instant};
use zenoh::{Session, Wait};

/// Length of the flood.
const FLOOD_LASTS: Duration = Duration::from_secs(5);

/// The endpoint at which the bridge with these settings meets its first remote.
fn endpoint(launched: &Launched, settings: &str) -> Result<String, Failure> {
    let settings: bridge::settings::Settings =
        read_settings(&launched.folder().join(settings)).map_err(|error| error.to_string())?;
    let remote = settings.remotes.first().ok_or("no remote")?;
    Ok(remote.meeting.endpoint().to_owned())
}

/// A message of `host`, as its bridge would send it to the robot's.
fn forge<T: Message>(session: &Session, graph: &str, host: &str, topic: &str, mut message: T) {
    let stamp = message.stamp_mut();
    (stamp.version, stamp.kind, stamp.writer, stamp.epoch) = (VERSION, T::KIND, 7, u64::MAX);
    let mut bytes = Vec::new();
    wire::encode(&message, &mut bytes);
    // A refused peer fails to publish.
    let _ = session.put(format!("coxswain-link/{graph}/{host}/robot/{topic}"), bytes).wait();
}

#[test]
fn no_peer_but_the_other_host_reaches_the_bridge_of_a_driving_robot() -> Outcome {
    let certificates = Certificates::new()?;
    let folder = certificates.folder();
    let given = folder.to_str().ok_or("no text")?;
    let launched = Launched::graph("two-hosts", &["--duration", "15", "--certificates", given])?;
    launched.wait_for_log("control/controller", "controller_epoch=", 1)?;
    let endpoint = endpoint(&launched, "robot/settings/bridge.toml")?;
    let address = endpoint.split_once('/').ok_or("no address")?.1.to_owned();
    let mut peers = strangers(&certificates, "control")?;
    for (name, role) in [
        ("watcher", Role::Watcher),
        ("driver", Role::Driver),
        ("host of no connection", host("training")),
        ("the other host, a second time", host("control")),
    ] {
        peers.push((name, Shows::Certificate(certificates.of(&role))));
    }
    let (mut forged, mut half_open) = (0, Vec::new());
    for (name, shows) in peers {
        let Ok(session) = connect(&endpoint, &shows) else {
            print(format_args!("{name}: no session"));
            continue;
        };
        for tick in 0..100 {
            let mut command = Command::zeroed();
            command.stamp.tick = tick;
            forge(&session, "two-hosts", "control", "command", command);
            forged += 1;
        }
        print(format_args!("{name}: a session"));
    }
    for _ in 0..50 {
        if let Ok(mut stream) = TcpStream::connect(&address) {
            let _ = stream.write_all(b"no handshake");
            half_open.push(stream);
        }
    }
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run/robot"))?;
    let options = Options::of_graph(&graph_file("two-hosts"));
    acquit(&record, &Limits::of(&Assembly::read(&options)?))?;
    let writers: BTreeSet<u64> =
        record.of("truth").map(|truth| truth.count("acting_writer")).collect();
    let genuine = record.of("plan").next().ok_or("no plan")?.stamp("writer");
    assert!(writers.iter().all(|writer| [0, genuine].contains(writer)), "{writers:?}");
    let fresh =
        record.of("state").filter(|state| state.word("fallback_level") == "fresh plan").count();
    print(format_args!("{forged} forged commands; {fresh} of 151 periods on fresh plans"));
    assert!(fresh > 130, "{fresh} of 151 periods on fresh plans");
    Ok(())
}

#[test]
fn an_endpoint_that_accepts_strangers_fails_the_self_test() -> Outcome {
    let certificates = Certificates::new()?;
    let credentials = certificates.of(&host("robot"));
    let tested = |shows: Shows| -> Result<Option<Breach>, Failure> {
        let (_session, endpoint) = router(&shows, &[])?;
        Ok(keeps_strangers_out(&endpoint, &credentials).err())
    };
    let plain = tested(Shows::Nothing)?;
    assert!(matches!(plain, Some(Breach::Plain { .. })), "{plain:?}");
    let asks_for_none = tested(Shows::NoCertificate(credentials.clone()))?;
    assert!(matches!(asks_for_none, Some(Breach::NoCertificate { .. })), "{asks_for_none:?}");
    assert_eq!(tested(Shows::Certificate(credentials.clone()))?, None);
    Ok(())
}

/// Launches two hosts that meet at a zenoh router with this access control.
fn meeting(
    certificates: &Certificates,
    control: &[(&str, Value)],
) -> Result<(Launched, Session), Failure> {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let (session, endpoint) =
        router(&Shows::Certificate(certificates.of(&host("training"))), control)?;
    let address = endpoint.split_once('/').ok_or("no address")?.1;
    let deploy = format!("\"{}/", repository().join("deploy").display());
    let text = fs::read_to_string(graph_file("two-hosts"))?.replace("\"../", &deploy);
    let text = text.replace("address = \"127.0.0.1:7447\"", &format!("router = \"{address}\""));
    let file = home.path().join("graph.toml");
    fs::write(&file, text)?;
    let folder = certificates.folder();
    let given = folder.to_str().ok_or("no text")?;
    let options = ["--duration", "8", "--certificates", given];
    let command = launch_command(&file, &home.path().join("run"), &options)?;
    let launched = Launched::by(command, home)?;
    Ok((launched, session))
}

#[test]
fn hosts_meet_at_a_zenoh_router_that_checks_their_names_and_at_no_other() -> Outcome {
    let certificates = Certificates::new()?;
    let hosts = ["robot", "control"].map(str::to_owned);
    let control = access::of_meeting_point("two-hosts", ROBOT, &hosts);
    let (launched, _router) = meeting(&certificates, &[("access_control", control)])?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run/robot"))?;
    let fresh =
        record.of("state").filter(|state| state.word("fallback_level") == "fresh plan").count();
    print(format_args!("at a zenoh router {fresh} of 81 periods are on fresh plans"));
    assert!(fresh > 65, "{fresh} of 81 periods on fresh plans");
    let (launched, _router) = meeting(&certificates, &[])?;
    let (ended, home) = launched.end()?;
    assert!(!ended.status.success(), "{}", ended.text);
    assert!(!home.path().join("run/robot/plant.log").exists(), "{}", ended.text);
    Ok(())
}

/// Validity of certificates that end while the robot drives [s].
const ENDS_AFTER_S: i64 = 15;

#[test]
fn when_a_certificate_ends_while_driving_the_robot_brakes() -> Outcome {
    let certificates = Certificates::new()?;
    let short = certificates.issue("authority", "short", ROBOT, (-HOUR_S, ENDS_AFTER_S))?;
    let given = short.to_str().ok_or("no text")?;
    let launched = Launched::graph("two-hosts", &["--duration", "25", "--certificates", given])?;
    launched.wait_for_log("control/controller", "controller_epoch=", 1)?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run/robot"))?;
    let options = Options::of_graph(&graph_file("two-hosts"));
    acquit(&record, &Limits::of(&Assembly::read(&options)?))?;
    let levels: Vec<&str> = record.of("state").map(|state| state.word("fallback_level")).collect();
    assert!(levels.contains(&"fresh plan"), "{levels:?}");
    assert_eq!(levels.last(), Some(&"brake"), "{levels:?}");
    Ok(())
}

/// Plant and controller on one host, the learner on the other one, whose certificate the attacker
/// holds.
const GRAPH: &str = "name = \"flooded\"\nrobot = \"DEPLOY/robots/mecanum.toml\"\n\
    scenario = \"DEPLOY/scenarios/paper-20ms.toml\"\npace = \"real-time\"\n\
    [hosts.robot]\nprocesses = [\"plant\", \"controller\", \"recorder\"]\n\
    [hosts.training]\nprocesses = [\"learner\"]\n\
    [[connections]]\nhosts = [\"robot\", \"training\"]\naddress = \"127.0.0.1:0\"\n";

#[test]
fn a_flood_by_another_host_costs_the_local_processes_no_fresh_plan() -> Outcome {
    let certificates = Certificates::new()?;
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let deploy = repository().join("deploy");
    let file = home.path().join("graph.toml");
    fs::write(&file, GRAPH.replace("DEPLOY", &deploy.display().to_string()))?;
    let port = port::free()?;
    let address = format!("training=127.0.0.1:{port}");
    let folder = certificates.folder();
    let given = folder.to_str().ok_or("no text")?;
    let options =
        ["--host", "robot", "--address", &address, "--duration", "12", "--certificates", given];
    let command = launch_command(&file, &home.path().join("run"), &options)?;
    let launched = Launched::by(command, home)?;
    launched.wait_for_controller(1)?;
    let endpoint = format!("tls/127.0.0.1:{port}");
    let session = connect(&endpoint, &Shows::Certificate(certificates.of(&host("training"))))?;
    let hello = format!("{{\"version\":{VERSION},\"instance\":7,\"lock_step\":false}}");
    let key = "coxswain-link/flooded/training/robot/hello";
    session.put(key, hello).wait().map_err(super::session::failed)?;
    thread::sleep(Duration::from_secs(1));
    let (begin, mut sent) = (Instant::now(), 0_u64);
    let head = SnapshotHead { inputs: 6, ..SnapshotHead::zeroed() };
    while begin.elapsed() < FLOOD_LASTS {
        forge(&session, "flooded", "training", "snapshot", ModelSnapshot::new(head));
        sent += 1;
    }
    drop(session);
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    let states: Vec<&str> =
        record.of("state").skip(10).map(|state| state.word("fallback_level")).collect();
    let fresh = states.iter().filter(|level| **level == "fresh plan").count();
    print(format_args!(
        "{sent} messages for {ROBOT}; {fresh} of {} periods on fresh plans",
        states.len()
    ));
    assert!(sent > 10_000, "{sent}");
    // On a busy machine a thread may wait longer than a period.
    assert!(fresh * 100 >= states.len() * 95, "{fresh} of {}", states.len());
    Ok(())
}
