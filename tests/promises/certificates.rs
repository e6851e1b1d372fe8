//! Promise: with certificates the graph runs across hosts as it does without.

use graph::assembly::Assembly;
use graph::options::Options;
use promises::oracle::{Limits, acquit};
use promises::{
    Hosts, Launched, Outcome, Reader, Record, binaries, graph_file, launch_command, repository,
};
use std::error::Error;
use std::fs;
use std::io::Write;
use std::os::unix::fs::{DirBuilderExt, PermissionsExt};
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

fn home() -> std::io::Result<TempDir> {
    tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")
}

/// `coxswain certificates` for a robot at `addresses`, below `home`. Returns their folder.
fn certificates(home: &Path, addresses: &[String]) -> Result<PathBuf, Box<dyn Error>> {
    let folder = home.join("certificates");
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.args(["certificates", "--robot", "mecanum", "--host", "control", "--out"]).arg(&folder);
    for address in addresses {
        command.args(["--host", &format!("robot={address}")]);
    }
    if addresses.is_empty() {
        command.args(["--host", "robot"]);
    }
    let output = command.output()?;
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    for expected in
        ["new authority", "keep it off the robot", "valid until", "robot-host", "watcher"]
    {
        assert!(text.contains(expected), "{text}");
    }
    Ok(folder)
}

/// Makes `folder` for this user alone, whatever the umask of the user that runs the tests.
fn private(folder: &Path) -> std::io::Result<()> {
    fs::DirBuilder::new().recursive(true).mode(0o700).create(folder)
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

fn commands(folder: &Path) -> Result<Vec<String>, Box<dyn Error>> {
    let record = Record::read(folder)?;
    Ok(record
        .of("command")
        .map(|command| {
            format!(
                "{} {} {}",
                command.stamp("tick"),
                command.fields["input"],
                command.fields["tail"]
            )
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
        let (ended, home) = Launched::graph("two-hosts", &options)?.end()?;
        assert!(ended.status.success(), "{}", ended.text);
        commands(&home.path().join("run/robot"))
    };
    let (without, with) = (run(&[])?, run(&["--certificates", given])?);
    assert_eq!(without.len(), 101);
    assert_eq!(without, with);
    Ok(())
}

/// Largest difference between the errors of two equal drives over a network [m]. In five runs it
/// was 0.001, at 150 and 149 of 151 periods on fresh plans.
const SAME_WITHIN_M: f64 = 0.03;

/// A run on two hosts, watched from a third one.
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
        let deploy = format!("\"{}/deploy/", repository().display());
        let text = fs::read_to_string(graph_file("two-hosts"))?.replace("\"../", &deploy);
        let text = text.replace(
            "listen = [\"tcp/127.0.0.1:0\"]",
            &format!("listen = [\"tcp/{}:0\"]", hosts.address_towards(2)),
        );
        let launch = |tables: &str, options: &[&str], host| -> Result<Launched, Box<dyn Error>> {
            let home = home()?;
            let own = home.path().join("graph.toml");
            fs::write(&own, format!("{text}\n{tables}\n"))?;
            let command = launch_command(&own, &home.path().join("run"), options)?;
            Launched::by(hosts.on(host, command), home)
        };
        let here = format!("control={}", hosts.address());
        let there = format!("robot={}", hosts.far_address());
        let of = |host, address| ["--host", host, "--address", address, "--duration", "15"];
        let far = launch("", &[&of("control", &there), far].concat(), 1)?;
        far.wait_for_log("controller", "settings=", 1)?;
        let near = launch(tables, &[&of("robot", &here), near].concat(), 0)?;
        Ok(Self { near, far })
    }

    /// Waits for the end of both, and returns the record.
    fn end(self) -> Result<Record, Box<dyn Error>> {
        let ends = [self.near.end()?, self.far.end()?];
        for (ended, _) in &ends {
            assert!(ended.status.success(), "{}", ended.text);
        }
        Ok(Record::read(&ends[0].1.path().join("run"))?)
    }
}

/// Compares a run of 15 s with the expectation. Returns the median control tick [ns], and the error
/// of the position [m].
fn completed(record: &Record, kind: &str) -> Result<(u64, f64), Box<dyn Error>> {
    acquit(record, &Limits::of(&Assembly::read(&Options::of_graph(&graph_file("two-hosts")))?))?;
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
    let robot = of("robot", &["robot-host"])?;
    let control = of("control", &["control-host"])?;
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
    let (with_nanos, with_error) = completed(&drive.end()?, "with certificates")?;
    let drive = Drive::begin(&hosts, "", &["--insecure"], &["--insecure"])?;
    let (without_nanos, without_error) = completed(&drive.end()?, "without")?;
    // One run each gives little evidence for a ratio.
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
    let robot: &[&str] = &["--host", "robot"];
    let missing = refusal(&folder.path().join("none"), "two-hosts", robot)?;
    assert!(missing.contains("robot-host/certificate.pem"), "{missing}");
    let address =
        refusal(&given, "two-hosts", &["--host", "robot", "--address", "control=10.98.0.1:7447"])?;
    assert!(address.contains("10.98.0.1"), "{address}");
    let swapped = folder.path().join("swapped");
    carried(&given, &swapped, &["watcher"])?;
    fs::rename(swapped.join("watcher"), swapped.join("robot-host"))?;
    let swapped = refusal(&swapped, "two-hosts", robot)?;
    assert!(swapped.contains("watcher") && swapped.contains("robot-host"), "{swapped}");
    for (name, mode) in [
        ("", 0o777),
        ("robot-host", 0o777),
        ("robot-host/authority.pem", 0o666),
        ("robot-host/key.pem", 0o640),
    ] {
        let open = folder.path().join(format!("open-{mode:o}-{}", name.replace('/', "-")));
        carried(&given, &open, &["robot-host"])?;
        let path = open.join(name).components().collect::<PathBuf>();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode))?;
        let refused = refusal(&open, "two-hosts", robot)?;
        assert!(refused.contains(&path.display().to_string()), "{refused}");
    }
    Ok(())
}
