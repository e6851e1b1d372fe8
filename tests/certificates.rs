//! Promise: with certificates the graph runs over the network as it does without, on one machine
//! and across three.

use access::{Credentials, Role};
use bytemuck::Zeroable;
use coxswain::assembly::Assembly;
use coxswain::options::Options;
use network::threads;
use promises::oracle::{Limits, acquit};
use promises::{
    GIVES_UP_AFTER, Hosts, Launched, Outcome, Reader, Record, binaries, graph_file, launch_command,
    repository,
};
use protocol::message::{Command as Said, Message as _, ModelSnapshot, PlantState, SnapshotHead};
use protocol::topic::OnTopic;
use std::error::Error;
use std::fs;
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Barrier;
use std::thread;
use tempfile::TempDir;
use transport::{Carrier, Carriers, Identity, Links, Ports, Router, Since};

fn home() -> std::io::Result<TempDir> {
    tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")
}

/// `coxswain certificates` for a robot at `addresses`, below `home`. Returns their folder.
fn certificates(home: &Path, addresses: &[String]) -> Result<PathBuf, Box<dyn Error>> {
    let folder = home.join("certificates");
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.args(["certificates", "--robot", "mecanum", "--out"]).arg(&folder);
    for address in addresses {
        command.args(["--address", address]);
    }
    let output = command.output()?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    for said in ["new authority", "keep it off the robot", "valid until", "robot-host", "watcher"] {
        assert!(text.contains(said), "{text}");
    }
    Ok(folder)
}

/// Makes `folder` for this user alone, whatever the umask of the user that runs the tests.
fn private(folder: &Path) -> std::io::Result<()> {
    fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
}

/// Whether the launch into `home` has tried to connect without a certificate before any process
/// started.
fn tried_as_a_stranger(home: &TempDir) -> std::io::Result<bool> {
    Ok(fs::read_to_string(home.path().join("run/coxswain.log"))?
        .contains("the network rejects unauthenticated peers"))
}

/// Copies the certificates of `roles` for one machine from `certificates`.
fn carried(certificates: &Path, to: &Path, roles: &[&str]) -> Result<String, Box<dyn Error>> {
    for role in roles {
        private(&to.join(role))?;
        for file in ["certificate.pem", "key.pem", "authority.pem"] {
            fs::copy(certificates.join(role).join(file), to.join(role).join(file))?;
        }
    }
    Ok(to.to_str().ok_or("no text")?.to_owned())
}

/// Messages that each of two ends sends to the other.
const CROWD: u64 = 20_000;
/// Largest lead of the messages sent over those received: fewer than find room at the other end.
const LEAD_MAX: u64 = 200;

/// Sends `CROWD` messages and receives as many on one link, once `both` are connected.
fn crowd<S: OnTopic, H: OnTopic>(
    links: &Links,
    both: &Barrier,
    mut message: S,
) -> Result<Vec<u64>, Box<dyn Error + Send + Sync>> {
    let opened = Ports::open(links, Identity::new(1))
        .and_then(|ports| Ok((ports.sink::<S>()?, ports.source::<H>(Since::First)?)));
    both.wait();
    let (mut sink, mut source) = opened?;
    let (mut sent, mut received) = (0, Vec::new());
    while sent < CROWD || received.len() < CROWD as usize {
        if sent < CROWD && sent < received.len() as u64 + LEAD_MAX {
            sent += 1;
            message.stamp_mut().tick = sent;
            sink.send(&mut message)?;
        } else if !source.wait(GIVES_UP_AFTER)? {
            return Err(format!(
                "{sent} said and {} heard of {CROWD}, then nothing for {GIVES_UP_AFTER:?}",
                received.len()
            )
            .into());
        }
        while let Some(message) = source.next()? {
            received.push(message.stamp().tick);
        }
    }
    Ok(received)
}

/// A router with certificates, and the links of each role through it.
struct Meeting {
    folder: TempDir,
    given: PathBuf,
    router: Router,
    lock_step: bool,
}

impl Meeting {
    fn new(lock_step: bool) -> Result<Self, Box<dyn Error>> {
        let folder = home()?;
        let given = certificates(folder.path(), &[])?;
        let host = Credentials::in_folder(given.join(Role::RobotHost.name()));
        let router =
            Router::guarded(&["tls/127.0.0.1:0".to_owned()], &[], "crowd", &host, lock_step)?;
        Ok(Self { folder, given, router, lock_step })
    }

    fn links(&self, role: Role) -> Links {
        Links {
            carriers: Carriers::all(Carrier::Network),
            connect: self.router.own_endpoints().to_vec(),
            credentials: Some(Credentials::in_folder(self.given.join(role.name()))),
            ..Links::on_this_machine("crowd", self.folder.path().to_owned(), self.lock_step, 60_000)
        }
    }
}

/// Routers limit the rate of snapshots, and of pieces of them.
#[test]
fn snapshots_of_a_megabyte_cross_a_link_with_certificates_whole_and_in_order_in_real_time()
-> Outcome {
    let meeting = Meeting::new(false)?;
    let ports = |role| Ports::open(&meeting.links(role), Identity::new(1));
    let (learner, controller, recorder) =
        (ports(Role::Learner)?, ports(Role::Controller)?, ports(Role::Recorder)?);
    let mut sink = learner.sink::<ModelSnapshot>()?;
    let mut sources =
        [controller.source::<ModelSnapshot>(Since::First)?, recorder.source(Since::First)?];
    let point = [0.25; 6];
    for version in 1..=3 {
        let mut snapshot =
            ModelSnapshot::new(SnapshotHead { version, inputs: 6, ..SnapshotHead::zeroed() });
        (0..12_000).try_for_each(|_| snapshot.push(&point, [1.0; 3], [2.0; 3]))?;
        assert!(snapshot.byte_len() > 1_000_000);
        sink.send(&mut snapshot)?;
    }
    for source in &mut sources {
        for version in 1..=3 {
            assert!(source.wait(GIVES_UP_AFTER)?, "snapshot {version} does not come");
            let snapshot = source.next()?.ok_or("nothing has come")?;
            assert_eq!((snapshot.head.version, snapshot.byte_len() > 1_000_000), (version, true));
        }
        assert_eq!(source.tally().lost, 0);
    }
    Ok(())
}

#[test]
fn messages_in_both_directions_at_once_cross_a_link_with_certificates_whole() -> Outcome {
    let meeting = Meeting::new(true)?;
    let (robot, controller, both) =
        (meeting.links(Role::Robot), meeting.links(Role::Controller), Barrier::new(2));
    let (robot, controller) = thread::scope(|scope| {
        let robot = scope.spawn(|| crowd::<PlantState, Said>(&robot, &both, PlantState::zeroed()));
        let controller =
            scope.spawn(|| crowd::<Said, PlantState>(&controller, &both, Said::zeroed()));
        (robot.join(), controller.join())
    });
    for received in [robot, controller] {
        let received = received.map_err(|_| "it panicked")?.map_err(|error| error.to_string())?;
        assert!(received.iter().copied().eq(1..=CROWD), "{} heard", received.len());
    }
    Ok(())
}

#[test]
fn a_program_without_the_setting_of_zenohs_threads_sets_it_itself() -> Outcome {
    let folder = home()?;
    let given = certificates(folder.path(), &[])?;
    let options = [
        "--certificates",
        given.to_str().ok_or("no text")?,
        "--pace",
        "lock-step",
        "--duration",
        "1",
    ];
    let mut command = launch_command(&graph_file("network"), &folder.path().join("run"), &options)?;
    command.env_remove(threads::VARIABLE);
    let (ended, _home) = Launched::by(command, folder)?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    Ok(())
}

fn commands(folder: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let record = Record::read(folder)?;
    Ok(record
        .of("command")
        .map(|command| {
            format!("{} {} {}", command.stamp("tick"), command.says["input"], command.says["tail"])
        })
        .collect())
}

#[test]
fn in_lock_step_certificates_change_no_bit() -> Outcome {
    let folder = home()?;
    let given = certificates(folder.path(), &[])?;
    let given = given.to_str().ok_or("no text")?;
    let run = |options: &[&str]| -> Result<Vec<String>, Box<dyn Error>> {
        let options: Vec<&str> =
            ["--pace", "lock-step", "--duration", "10"].iter().chain(options).copied().collect();
        let (ended, home) = Launched::graph("network", &options)?.end()?;
        assert!(ended.status.success(), "{}", ended.text);
        let logged = ended.text.contains("certificates of robot mecanum")
            && ended.text.contains("listening at tls/");
        assert_eq!(logged, options.contains(&"--certificates"), "{}", ended.text);
        assert_eq!(tried_as_a_stranger(&home)?, logged, "{}", ended.text);
        commands(&home.path().join("run"))
    };
    let (without, with) = (run(&[])?, run(&["--certificates", given])?);
    assert_eq!(without.len(), 101);
    assert_eq!(without, with);
    Ok(())
}

/// Largest difference between the errors of two equal drives over a network [m]. In five runs it
/// was 0.001, at 150 and 149 of 151 periods on fresh plans.
const SAME_WITHIN_M: f64 = 0.03;

/// A run over three hosts.
struct Drive {
    /// The launches on the robot's machine and on the controller's.
    near: Launched,
    far: Launched,
}

impl Drive {
    /// Launches both. The robot publishes its telemetry over its cable to the third host, the
    /// watcher's. `tables` goes into its graph file, the rest into the command line.
    fn begin(
        hosts: &Hosts,
        tables: &str,
        near: &[&str],
        far: &[&str],
    ) -> Result<Self, Box<dyn Error>> {
        let graphs = repository().join("deploy/graphs");
        let text = fs::read_to_string(graph_file("plant-host"))?
            .replace("\"../", &format!("\"{}/../", graphs.display()));
        let shown = format!(
            "[telemetry]\nlisten = [\"tcp/{}:0\"]\nrobot = \"mecanum\"\n",
            hosts.address_towards(2)
        );
        let launch =
            |graph: Option<&Path>, options: &[&str], host| -> Result<Launched, Box<dyn Error>> {
                let home = home()?;
                let own = home.path().join("robot.toml");
                fs::write(&own, format!("{text}\n{tables}\n{shown}[processes.gateway]\n"))?;
                let command =
                    launch_command(graph.unwrap_or(&own), &home.path().join("run"), options)?;
                Launched::by(hosts.on(host, command), home)
            };
        let (here, there) = (hosts.endpoint(), hosts.far_endpoint());
        let far =
            launch(Some(&graph_file("control-host")), &[far, &["--connect", &there]].concat(), 1)?;
        far.wait_for_log("controller", "started", 1)?;
        let near = launch(None, &[near, &["--duration", "15", "--listen", &here]].concat(), 0)?;
        Ok(Self { near, far })
    }

    /// Waits for the end of both, and returns the record. Either both have tried to connect without
    /// a certificate, and report no exposure; or neither has, and both report one.
    fn end(self, with_certificates: bool) -> Result<Record, Box<dyn Error>> {
        let ends = [self.near.end()?, self.far.end()?];
        for (ended, home) in &ends {
            assert!(ended.status.success(), "{}", ended.text);
            assert_eq!(tried_as_a_stranger(home)?, with_certificates, "{}", ended.text);
            assert_eq!(!ended.text.contains("INSECURE"), with_certificates, "{}", ended.text);
        }
        Ok(Record::read(&ends[0].1.path().join("run"))?)
    }
}

/// Compares a run of 15 s with the expectation. Returns the median control tick [ns], and the error
/// of the position [m].
fn completed(record: &Record, kind: &str) -> Result<(u64, f64), Box<dyn Error>> {
    acquit(record, &Limits::of(&Assembly::read(&Options::of_graph(&graph_file("plant-host")))?))?;
    assert_eq!(record.of("state").last().map(|state| state.stamp("tick")), Some(150), "{kind}");
    for topic in ["command", "residual", "snapshot", "plan", "health", "truth"] {
        assert!(
            record.of(topic).count() > 5,
            "{kind}: {topic} is not recorded on the robot's machine"
        );
    }
    assert!(record.summary["snapshots_adopted"].as_u64() > Some(0), "{kind}: {}", record.summary);
    let fresh =
        record.of("state").filter(|state| state.word("fallback_level") == "fresh plan").count();
    let mut ticks: Vec<u64> = record.of("plan").map(|plan| plan.count("tick_nanos")).collect();
    ticks.sort_unstable();
    let middle = ticks.get(ticks.len() / 2).copied().ok_or("no plan")?;
    let error = record.summary["position_rmse_m"].as_f64().ok_or("no error")?;
    let line = format!(
        "{kind}: {fresh} of 151 periods on fresh plans, control tick p50 {} us, position error \
        {error:.3} m",
        middle / 1000
    );
    writeln!(std::io::stderr(), "{line}")?;
    assert!(fresh >= 140, "{line}");
    Ok((middle, error))
}

#[test]
fn three_hosts_connect_with_certificates_alone_and_the_robot_drives_as_without() -> Outcome {
    let hosts = Hosts::with_others(2)?;
    let folder = home()?;
    let (towards_control, towards_watcher) = (hosts.address_towards(1), hosts.address_towards(2));
    let given = certificates(folder.path(), &[towards_control, towards_watcher.clone()])?;
    let of = |machine: &str, roles: &[&str]| carried(&given, &folder.path().join(machine), roles);
    let robot = of("robot", &["robot-host", "robot", "recorder", "gateway"])?;
    let control = of("control", &["control-host", "controller", "learner"])?;
    let watcher = of("watcher", &["watcher"])?;

    // A graph file may contain the folder of the certificates as well.
    let drive = Drive::begin(
        &hosts,
        &format!("[certificates]\nfolder = \"{robot}\""),
        &[],
        &["--certificates", &control],
    )?;
    let endpoint = drive.near.gateway_endpoint()?;
    assert!(endpoint.starts_with(&format!("tls/{towards_watcher}:")), "{endpoint}");

    let mut watch = Command::new(binaries()?.join("coxswain"));
    watch.args(["watch", &endpoint, "--plain", "--certificates", &watcher]);
    let mut seen = Reader::start(&mut hosts.on(2, watch))?;
    let lines = seen.lines(20)?;
    assert!(lines.iter().any(|line| line.contains("fresh plan")), "{lines:?}");
    for shows in [&[][..], &["--certificates", &robot]] {
        let mut stranger = Command::new(binaries()?.join("coxswain"));
        stranger.args(["watch", &endpoint, "--plain"]).args(shows);
        let output = hosts.on(2, stranger).output()?;
        assert!(!output.status.success(), "{shows:?}: {}", String::from_utf8_lossy(&output.stdout));
    }
    let (with_nanos, with_error) = completed(&drive.end(true)?, "with certificates")?;
    let drive = Drive::begin(&hosts, "", &["--insecure"], &["--insecure"])?;
    let (without_nanos, without_error) = completed(&drive.end(false)?, "without")?;
    // One run each gives little evidence for a ratio: `docs/certificates_tick.py` alternates many.
    writeln!(
        std::io::stderr(),
        "control tick with certificates to without: {:.2}",
        with_nanos as f64 / without_nanos as f64
    )?;
    assert!(
        (with_error - without_error).abs() < SAME_WITHIN_M,
        "{with_error} m with certificates, {without_error} m without"
    );
    Ok(())
}

#[test]
fn unusable_certificates_are_refused_before_any_process_starts() -> Outcome {
    let folder = home()?;
    let given = certificates(folder.path(), &[])?;
    let refusal = |certificates: &Path,
                   graph: &str,
                   options: &[&str]|
     -> Result<String, Box<dyn Error>> {
        let out = folder.path().join("run");
        let mut command = launch_command(&graph_file(graph), &out, options)?;
        let output = command
            .arg("--certificates")
            .arg(certificates)
            .env("TMPDIR", folder.path())
            .output()?;
        assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(!out.exists());
        Ok(String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let missing = refusal(&folder.path().join("none"), "network", &[])?;
    assert!(
        missing.contains("certificates.folder") && missing.contains("robot-host/certificate.pem"),
        "{missing}"
    );
    let output = launch_command(
        &graph_file("network"),
        &folder.path().join("run"),
        &["--listen", "tls/127.0.0.1:0"],
    )?
    .output()?;
    let text = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        output.status.code() == Some(2)
            && text.contains("network.listen = \"tls/127.0.0.1:0\": expected certificates"),
        "{text}"
    );
    let address = refusal(&given, "plant-host", &["--listen", "tcp/10.98.0.1:7447"])?;
    assert!(
        address.contains("--address 10.98.0.1") && address.contains("network.listen"),
        "{address}"
    );
    let swapped = folder.path().join("swapped");
    carried(&given, &swapped, &["robot-host", "controller", "learner", "recorder", "watcher"])?;
    fs::rename(swapped.join("watcher"), swapped.join("robot"))?;
    let swapped = refusal(&swapped, "network", &[])?;
    assert!(swapped.contains("is for the role watcher, expected one for robot"), "{swapped}");
    let other = folder.path().join("other");
    private(&other)?;
    certificates(&other, &[])?;
    let mixed = folder.path().join("mixed");
    carried(&given, &mixed, &["robot-host", "robot", "learner", "recorder"])?;
    carried(&other.join("certificates"), &mixed, &["controller"])?;
    let mixed = refusal(&mixed, "network", &[])?;
    assert!(mixed.contains("make all of them together"), "{mixed}");
    for (name, mode) in [
        ("", 0o777),
        ("controller", 0o777),
        ("controller/authority.pem", 0o666),
        ("robot-host/key.pem", 0o640),
    ] {
        let open = folder.path().join(format!("open-{mode:o}-{}", name.replace('/', "-")));
        carried(&given, &open, &["robot-host", "robot", "controller", "learner", "recorder"])?;
        let path = open.join(name).components().collect::<PathBuf>();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode))?;
        let refused = refusal(&open, "network", &[])?;
        assert!(
            refused.contains(&format!("{} has mode {mode:o}", path.display()))
                && refused.contains("expected"),
            "{refused}"
        );
    }
    Ok(())
}
