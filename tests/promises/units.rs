//! Promise: the units for a real host restrict a graph to what it needs, grant it that, and are
//! valid for systemd.

use promises::{Outcome, binaries, repository};
use std::collections::BTreeMap;
use std::error::Error;
use std::fs;
use std::io::{self, Write};
use std::path::Path;
use std::process::Command;

/// Units, and the name under which each is checked.
const UNITS: [(&str, &str); 3] = [
    ("coxswain-robot.service", "coxswain-robot.service"),
    ("coxswain-control.service", "coxswain-control.service"),
    ("coxswain@.service", "coxswain@local.service"),
];

/// Largest exposure that `systemd-analyze security` may report, in tenths.
const EXPOSURE_MOST: &str = "20";

/// Required directives of every unit, and why.
const SAID: [(&str, &str, &str); 35] = [
    ("Type", "notify", "it is started once every process is ready"),
    ("WatchdogSec", "10", "loops that hang are noticed"),
    ("Restart", "on-failure", "and what has failed is started again"),
    ("RestartPreventExitStatus", "2", "but not what cannot be"),
    ("SuccessExitStatus", "143", "a launch that was asked to end says by which signal"),
    ("KillMode", "mixed", "the launcher ends its processes in order"),
    ("UMask", "0077", "nobody else reads what it makes"),
    ("StateDirectoryMode", "0700", "nor its runs"),
    ("RuntimeDirectoryMode", "0700", "nor its sockets"),
    (
        "RuntimeDirectoryPreserve",
        "yes",
        "the next launch finds what a killed one has left in shared memory",
    ),
    ("LimitRTPRIO", "49", "commands are on time"),
    ("LimitCORE", "0", "no memory is left on the disk"),
    ("RemoveIPC", "no", "iceoryx2: shared memory stays when another unit of the user stops"),
    ("PrivateIPC", "no", "iceoryx2: it is that of the machine"),
    ("PrivateTmp", "no", "iceoryx2: names are that of the machine"),
    ("NoNewPrivileges", "yes", ""),
    ("CapabilityBoundingSet", "", "not even for a real-time priority"),
    ("AmbientCapabilities", "", ""),
    ("ProtectSystem", "strict", ""),
    ("ProtectHome", "yes", ""),
    ("ProtectProc", "invisible", ""),
    ("ProtectClock", "yes", ""),
    ("ProtectKernelModules", "yes", ""),
    ("ProtectKernelTunables", "yes", ""),
    ("ProtectControlGroups", "yes", ""),
    ("PrivateUsers", "yes", ""),
    ("PrivateDevices", "yes", ""),
    ("DevicePolicy", "closed", ""),
    ("LockPersonality", "yes", ""),
    ("MemoryDenyWriteExecute", "yes", ""),
    ("RestrictNamespaces", "yes", ""),
    ("RestrictSUIDSGID", "yes", ""),
    ("SystemCallArchitectures", "native", ""),
    ("IPAddressDeny", "any", "nobody on the network"),
    ("IPAddressAllow", "localhost", "but who is named"),
];

/// Forbidden directives: they would refuse a real-time priority.
const UNSAID: [&str; 3] = ["RestrictRealtime", "DynamicUser", "PrivateNetwork"];

fn folder() -> std::path::PathBuf {
    repository().join("deploy/systemd")
}

/// The values of each key in a unit; a key may occur more than once.
fn directives(text: &str) -> BTreeMap<&str, Vec<&str>> {
    let mut values: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (key, value) in
        text.lines().filter(|line| !line.starts_with('#')).filter_map(|line| line.split_once('='))
    {
        values.entry(key).or_default().push(value);
    }
    values
}

#[test]
fn every_unit_contains_its_restrictions_and_the_needs_of_the_graph() -> Outcome {
    let mut found: Vec<String> = fs::read_dir(folder())?
        .flatten()
        .map(|entry| entry.file_name().to_string_lossy().into_owned())
        .filter(|name| name.ends_with(".service"))
        .collect();
    found.sort();
    assert_eq!(found, ["coxswain-control.service", "coxswain-robot.service", "coxswain@.service"]);
    for (unit, _) in UNITS {
        let text = fs::read_to_string(folder().join(unit))?;
        let keys = directives(&text);
        for (key, value, why) in SAID {
            assert_eq!(
                keys.get(key).map(Vec::as_slice),
                Some(&[value][..]),
                "{unit}: {key} ({why})"
            );
        }
        for key in UNSAID {
            assert!(!keys.contains_key(key), "{unit}: {key}");
        }
        let graph = keys
            .get("ExecStart")
            .and_then(|starts| starts.first()?.rsplit('/').next()?.split(' ').next())
            .ok_or("it starts nothing")?;
        assert!(
            graph == "%i.toml" || repository().join("deploy/graphs").join(graph).is_file(),
            "{unit} starts {graph}"
        );
        // The path of a socket in a graph's folder: user ids of up to five digits, a name of eight
        // characters.
        let runtime = keys
            .get("RuntimeDirectory")
            .and_then(|names| names.first())
            .ok_or("no runtime folder")?
            .replace("%i", "local");
        let root = format!("/run/{runtime}/coxswain-65534/abcdefgh");
        assert!(root.len() <= 49, "{unit}: {root} is too long for sockets in it");
        let temporary =
            keys.get("Environment").and_then(|values| values.first()).ok_or("no TMPDIR")?;
        assert_eq!(temporary.replace("%i", "local"), format!("TMPDIR=%t/{runtime}"), "{unit}");
    }
    Ok(())
}

/// Whether systemd's program is available here.
fn is_there(program: &str) -> bool {
    Command::new(program).arg("--version").output().is_ok_and(|output| output.status.success())
}

/// The units under the names for the check, with the launcher of these tests in place of the
/// installed one.
fn installed(home: &Path) -> Result<Vec<std::path::PathBuf>, Box<dyn Error>> {
    let launcher = binaries()?.join("coxswain");
    let install = |(unit, name): (&str, &str)| {
        let text = fs::read_to_string(folder().join(unit))?
            .replace("/usr/lib/coxswain/coxswain", &launcher.to_string_lossy());
        let place = home.join(name);
        fs::write(&place, text)?;
        Ok(place)
    };
    UNITS.into_iter().map(install).collect()
}

#[test]
fn systemd_accepts_every_unit_and_finds_none_exposed() -> Outcome {
    if !is_there("systemd-analyze") {
        // `.ci/run` installs it where it can.
        let names = UNITS.map(|(_, name)| name).join(", ");
        writeln!(
            io::stdout(),
            "no systemd-analyze: what {names} say is held against a list alone, syntax and \
            exposure were not looked at"
        )?;
        return Ok(());
    }
    let home = tempfile::tempdir()?;
    for unit in installed(home.path())? {
        let judged = Command::new("systemd-analyze")
            .args(["security", "--offline=true", "--no-pager", "--threshold", EXPOSURE_MOST])
            .arg(&unit)
            .output()?;
        let report = String::from_utf8_lossy(&judged.stdout);
        assert!(
            judged.status.success() && report.contains("Overall exposure level"),
            "{}: {report}",
            unit.display()
        );
        let verified = Command::new("systemd-analyze").arg("verify").arg(&unit).output()?;
        let report = String::from_utf8_lossy(&verified.stderr);
        let ours: Vec<&str> = report.lines().filter(|line| line.contains("coxswain")).collect();
        assert!(verified.status.success() && ours.is_empty(), "{}: {report}", unit.display());
    }
    Ok(())
}
