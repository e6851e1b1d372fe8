//! Promise: on its own machine a graph is private to its user: no other user reads or replaces its
//! files, or reaches its sockets.

use promises::{
    Launched, Outcome, binaries, graph_file, launch_command, repository, signal, wait_until,
};
use rustix::process::{Signal, geteuid};
use std::collections::{BTreeMap, BTreeSet};
use std::error::Error;
use std::fs;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr};
use std::os::unix::fs::{DirBuilderExt, MetadataExt, PermissionsExt, chown, symlink};
use std::path::{Path, PathBuf};
use std::process::Command;
use tempfile::TempDir;

/// Permissions of all users but the owner, in a mode.
const GROUP_AND_OTHERS: u32 = 0o077;

fn home() -> Result<TempDir, Box<dyn Error>> {
    Ok(tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?)
}

/// Launches `graph` with `options` under a umask that makes new files accessible to every user.
fn careless(graph: &str, options: &[&str]) -> Result<Launched, Box<dyn Error>> {
    let home = home()?;
    let plain = launch_command(&graph_file(graph), &home.path().join("run"), options)?;
    let mut command = Command::new("sh");
    command
        .args(["-c", "umask 0; exec \"$@\"", "sh"])
        .arg(plain.get_program())
        .args(plain.get_args());
    Launched::by(command, home)
}

/// Everything below `folder`, itself included.
fn below(folder: &Path) -> Vec<PathBuf> {
    let inside = fs::read_dir(folder).into_iter().flatten().flatten().map(|entry| entry.path());
    std::iter::once(folder.to_owned())
        .chain(inside.flat_map(|path| if path.is_symlink() { vec![path] } else { below(&path) }))
        .collect()
}

/// Waits until the robot drives on a learned model, so that all files have been made.
fn drives(launched: &Launched) -> Outcome {
    launched.wait_for_log("controller", "version=3 ", 1)
}

/// The same on two hosts.
fn hosts_drive(launched: &Launched) -> Outcome {
    launched.wait_for_log("control/controller", "version=3 ", 1)
}

#[test]
fn files_and_shared_memory_of_a_graph_are_private_to_its_user() -> Outcome {
    for (graph, host) in [("local", ""), ("two-hosts", "robot/")] {
        let launched = careless(graph, &["--duration", "110"])?;
        if host.is_empty() {
            drives(&launched)?;
        } else {
            hosts_drive(&launched)?;
        }
        let name = launched.told(&format!("{host}recorder"), "graph")?;
        let shared = fs::read_dir("/dev/shm")?.flatten().map(|entry| entry.path());
        let shared: Vec<PathBuf> =
            shared.filter(|path| path.to_string_lossy().contains(&name)).collect();
        assert!(shared.len() > 20, "{graph}: {shared:?}");
        let base = launched.home().join(format!("coxswain-{}", geteuid().as_raw()));
        // Sockets are in a folder that no other user can enter.
        let places = fs::read_dir(&base)?
            .flatten()
            .map(|entry| entry.path())
            .chain([base.clone()])
            .collect();
        let folders = [below(&launched.folder()), places];
        assert!(folders.iter().all(|found| found.len() > 2), "{graph}: {folders:?}");
        for path in shared.iter().chain(folders.iter().flatten()) {
            // A file that a process has just removed no longer counts.
            let Ok(found) = fs::symlink_metadata(path) else { continue };
            let (mode, owner) = (found.mode(), found.uid());
            assert_eq!(
                (mode & GROUP_AND_OTHERS, owner),
                (0, geteuid().as_raw()),
                "{graph}: {} has mode {mode:o}",
                path.display()
            );
        }
        signal(launched.pid(), Signal::TERM)?;
        let (ended, home) = launched.end()?;
        let left = below(&home.path().join("run"));
        let report = home.path().join("run").join(host).join("report.html");
        assert!(left.contains(&report), "{}", ended.text);
        let open = left.iter().find(|path| {
            fs::symlink_metadata(path).is_ok_and(|found| found.mode() & GROUP_AND_OTHERS != 0)
        });
        assert_eq!(open, None, "{graph}");
    }
    Ok(())
}

#[test]
fn another_user_reads_nothing_of_a_graph_in_shared_memory() -> Outcome {
    if !geteuid().is_root() {
        // Only root can become another user for a moment; the test above checks the modes for every
        // user.
        return Ok(());
    }
    let launched = careless("local", &["--duration", "110"])?;
    drives(&launched)?;
    let name = launched.graph_name()?;
    let read = |user: u32| -> Result<(usize, usize), Box<dyn Error>> {
        let output = Command::new("setpriv")
            .args([
                &format!("--reuid={user}"),
                "--regid=65534",
                "--clear-groups",
                "--inh-caps=-all",
                "--",
            ])
            .args([
                "sh",
                "-c",
                "for f in /dev/shm/*\"$0\"*; do if head -c 1 \"$f\" >/dev/null 2>&1; then echo \
                read; else echo kept; fi; done",
            ])
            .arg(&name)
            .output()?;
        let text = String::from_utf8(output.stdout)?;
        Ok((text.matches("read").count(), text.matches("kept").count()))
    };
    let (own, _) = read(0)?;
    assert!(own > 20, "their user reads {own} files");
    let (others, kept) = read(65_534)?;
    assert!(others == 0 && kept > 20, "another user reads {others} of {}", others + kept);
    Ok(())
}

/// Runs `coxswain launch` with a second of the local graph into `out`, and with temporary files in
/// `temporary`. Returns its exit code and its output.
fn launch(out: &Path, temporary: &Path) -> Result<(Option<i32>, String), Box<dyn Error>> {
    let mut command =
        launch_command(&graph_file("local"), out, &["--duration", "1", "--pace", "lock-step"])?;
    let output = command.env("TMPDIR", temporary).output()?;
    Ok((output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned()))
}

#[test]
fn a_folder_that_is_not_private_is_refused_before_anything_is_made_there() -> Outcome {
    let (home, elsewhere) = (home()?, home()?);
    let at = |name: &str| home.path().join(name);
    let private = |name: &str| fs::DirBuilder::new().mode(0o700).create(at(name));
    let open = |name: &str, mode| {
        private(name)?;
        fs::set_permissions(at(name), fs::Permissions::from_mode(mode))
    };
    open("readable", 0o755)?;
    open("group", 0o770)?;
    open("world", 0o777)?;
    symlink(elsewhere.path(), at("link"))?;
    let mut refused =
        vec![("readable", "755"), ("group", "770"), ("world", "777"), ("link", "--out")];
    if geteuid().is_root() {
        private("foreign")?;
        chown(at("foreign"), Some(65_534), None)?;
        refused.push(("foreign", "65534"));
    }
    open("replaceable", 0o777)?;
    private("replaceable/run")?;
    refused.push(("replaceable/run", "777"));
    private("replaceable/deep")?;
    private("replaceable/deep/run")?;
    refused.push(("replaceable/deep/run", "777"));
    for (name, expected) in refused {
        let (code, text) = launch(&at(name), home.path())?;
        assert_eq!(code, Some(2), "{name}: {text}");
        assert!(
            text.contains(expected) && text.contains(name) && text.contains("--out"),
            "{name}: {text}"
        );
        assert_eq!(fs::read_dir(at(name))?.count(), 0, "{name}");
    }
    // The folder for temporary files is made in the folder that TMPDIR names.
    let base = format!("coxswain-{}", geteuid().as_raw());
    open(&base, 0o750)?;
    let (code, text) = launch(&at("new"), home.path())?;
    assert_eq!(code, Some(1), "{text}");
    assert!(text.contains("750") && text.contains("TMPDIR"), "{text}");
    assert!(!at("new").exists() && fs::read_dir(at(&base))?.count() == 0);
    fs::remove_dir(at(&base))?;
    private("mine")?;
    let (code, text) = launch(&at("mine"), home.path())?;
    assert_eq!(code, Some(0), "{text}");
    Ok(())
}

/// A socket of this machine, as the kernel lists it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Listening {
    address: SocketAddr,
    inode: u64,
}

/// Every socket that waits for peers: of TCP those that listen, of UDP all.
fn listening() -> Result<Vec<Listening>, Box<dyn Error>> {
    let mut found = Vec::new();
    for (table, listens) in
        [("tcp", Some("0A")), ("tcp6", Some("0A")), ("udp", None), ("udp6", None)]
    {
        let text = fs::read_to_string(Path::new("/proc/net").join(table)).unwrap_or_default();
        for line in text.lines().skip(1) {
            let fields: Vec<&str> = line.split_whitespace().collect();
            let [_, local, _, state, _, _, _, _, _, inode, ..] = fields.as_slice() else {
                return Err(line.into());
            };
            if listens.is_none_or(|listens| listens == *state) {
                found.push(Listening {
                    address: address(local).ok_or("no address")?,
                    inode: inode.parse()?,
                });
            }
        }
    }
    Ok(found)
}

/// `0100007F:1F90` is 127.0.0.1:8080: words of the machine's own byte order.
fn address(text: &str) -> Option<SocketAddr> {
    let (ip, port) = text.split_once(':')?;
    let words = ip.as_bytes().chunks(8).map(|word| {
        u32::from_str_radix(std::str::from_utf8(word).ok()?, 16).ok().map(u32::to_ne_bytes)
    });
    let bytes: Vec<u8> = words.collect::<Option<Vec<_>>>()?.concat();
    let ip = match bytes.len() {
        4 => IpAddr::V4(Ipv4Addr::from(<[u8; 4]>::try_from(bytes).ok()?)),
        _ => IpAddr::V6(Ipv6Addr::from(<[u8; 16]>::try_from(bytes).ok()?)),
    };
    Some(SocketAddr::new(ip, u16::from_str_radix(port, 16).ok()?))
}

/// Addresses where the launch and its processes wait for peers.
fn waits_at(launched: &Launched) -> Result<BTreeSet<SocketAddr>, Box<dyn Error>> {
    let mut own = BTreeMap::new();
    for pid in launched.processes().into_iter().chain([launched.pid()]) {
        for descriptor in fs::read_dir(format!("/proc/{pid}/fd"))?.flatten() {
            let target =
                fs::read_link(descriptor.path()).unwrap_or_default().to_string_lossy().into_owned();
            if let Some(inode) =
                target.strip_prefix("socket:[").and_then(|rest| rest.strip_suffix(']'))
            {
                own.insert(inode.parse::<u64>()?, pid);
            }
        }
    }
    Ok(listening()?
        .into_iter()
        .filter(|socket| own.contains_key(&socket.inode))
        .map(|socket| socket.address)
        .collect())
}

#[test]
fn no_other_machine_reaches_a_socket_of_a_launch_without_an_explicit_setting() -> Outcome {
    for graph in ["local", "two-hosts"] {
        let launched = Launched::graph(graph, &["--duration", "110"])?;
        if graph == "local" {
            drives(&launched)?;
        } else {
            hosts_drive(&launched)?;
        }
        let at = waits_at(&launched)?;
        assert!(at.len() >= 2, "{graph}: {at:?}");
        assert!(at.iter().all(|address| address.ip().is_loopback()), "{graph}: {at:?}");
    }
    // With an explicit setting it listens there, and this test would detect it.
    let launched = Launched::graph(
        "two-hosts",
        &["--host", "robot", "--insecure", "--address", "control=0.0.0.0:0"],
    )?;
    launched.wait_for_log("bridge", "endpoint=", 1)?;
    let at = waits_at(&launched)?;
    assert!(at.iter().any(|address| address.ip().is_unspecified()), "{at:?}");
    Ok(())
}

#[test]
fn an_address_that_others_can_reach_is_refused_without_an_explicit_setting() -> Outcome {
    let home = home()?;
    let text = fs::read_to_string(graph_file("local"))?
        .replace("\"../", &format!("\"{}/deploy/", repository().display()));
    for (from, to, key) in [
        ("listen = [\"tcp/127.0.0.1:0\"]", "listen = [\"tcp/[::]:0\"]", "telemetry.listen"),
        ("listen = \"127.0.0.1:0\"", "listen = \"0.0.0.0:0\"", "page.listen"),
    ] {
        let graph = home.path().join("graph.toml");
        fs::write(&graph, text.replacen(from, to, 1))?;
        let output = Command::new(binaries()?.join("coxswain"))
            .arg("launch")
            .arg(&graph)
            .env("TMPDIR", home.path())
            .output()?;
        let errors = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{errors}");
        assert!(errors.contains(key) && errors.contains("--insecure"), "{errors}");
    }
    wait_until("the end of what was refused", || {
        fs::read_dir(home.path()).is_ok_and(|entries| entries.count() == 1)
    })
}
