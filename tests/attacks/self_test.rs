//! An endpoint that refuses no peer is found before any process depends on it.

use crate::session::{Certificates, Failure, Shows, router};
use access::Role;
use network::Breach;
use promises::{Ended, Launched, Outcome, graph_file, launch_command, signal};
use rustix::process::Signal;
use serde_json::json;
use std::path::Path;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;
use tempfile::TempDir;
use transport::{Router, self_test};
use zenoh::Wait;

const GRAPH: &str = "maze";

#[test]
fn a_correctly_configured_router_passes_its_self_test() -> Outcome {
    let certificates = Certificates::new()?;
    for role in [Role::RobotHost, Role::ControlHost] {
        for lock_step in [false, true] {
            Router::guarded(
                &["tcp/127.0.0.1:0".to_owned()],
                &[],
                GRAPH,
                &certificates.of(role),
                lock_step,
            )?
            .self_test()?;
        }
    }
    Ok(())
}

#[test]
fn a_router_with_a_wrong_configuration_fails_its_self_test() -> Outcome {
    let certificates = Certificates::new()?;
    let credentials = certificates.of(Role::RobotHost);
    let tested = |shows: Shows,
                  more: &[(&str, serde_json::Value)]|
     -> Result<Option<Breach>, Box<dyn std::error::Error>> {
        let (_session, endpoint) = router(&shows, more)?;
        Ok(self_test(&endpoint, GRAPH, &credentials).err())
    };
    let plain = tested(Shows::Nothing, &[])?;
    assert!(matches!(plain, Some(Breach::Plain { .. })), "{plain:?}");
    let asks_for_none = tested(Shows::NoCertificate(credentials.clone()), &[])?;
    assert!(matches!(asks_for_none, Some(Breach::NoCertificate { .. })), "{asks_for_none:?}");
    let no_roles = tested(Shows::Certificate(credentials.clone()), &[])?;
    assert!(
        matches!(no_roles, Some(Breach::WrongRole { role: "robot-host", topic: "residual", .. })),
        "{no_roles:?}"
    );
    let deny = json!({
        "enabled": true,
        "default_permission": "allow",
        "rules": [{
            "id": "r",
            "messages": ["put"],
            "flows": ["ingress"],
            "permission": "deny",
            "key_exprs": ["coxswain-link/*/residual/**"],
        }],
        "subjects": [{ "id": "s" }],
        "policies": [{ "rules": ["r"], "subjects": ["s"] }],
    });
    let any_length = tested(Shows::Certificate(credentials.clone()), &[("access_control", deny)])?;
    assert!(matches!(any_length, Some(Breach::Oversize { .. })), "{any_length:?}");
    let nobody = self_test("tls/127.0.0.1:1", GRAPH, &credentials);
    assert!(matches!(nobody, Err(Breach::Unknown { .. })), "{nobody:?}");
    Ok(())
}

/// Replaces the C library's `connect`: every connection to a port leads to one port at the same
/// address, as behind a packet filter that redirects.
const TURNED: &str = r#"
#define _GNU_SOURCE
#include <arpa/inet.h>
#include <dlfcn.h>
#include <stdlib.h>
int connect(int socket, const struct sockaddr *address, socklen_t length) {
    int (*original)(int, const struct sockaddr *, socklen_t) = dlsym(RTLD_NEXT, "connect");
    struct sockaddr_in turned;
    if (address->sa_family != AF_INET) return original(socket, address, length);
    turned = *(const struct sockaddr_in *)address;
    turned.sin_port = htons(atoi(getenv("TURNED_TO")));
    return original(socket, (const struct sockaddr *)&turned, sizeof turned);
}
"#;

/// Result of a launch of `graph` with certificates, in which all connections to its own endpoints
/// lead to `endpoint`.
fn launched_behind(
    endpoint: &str,
    graph: &str,
    certificates: &Path,
) -> Result<(Ended, TempDir), Failure> {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let (source, library) = (home.path().join("turned.c"), home.path().join("turned.so"));
    std::fs::write(&source, TURNED)?;
    assert!(
        Command::new("gcc")
            .args(["-shared", "-fPIC", "-o"])
            .args([&library, &source])
            .arg("-ldl")
            .status()?
            .success()
    );
    let options = ["--certificates", certificates.to_str().ok_or("no text")?];
    let mut command = launch_command(&graph_file(graph), &home.path().join("run"), &options)?;
    let port = endpoint.rsplit_once(':').ok_or("no endpoint")?.1;
    command.env("LD_PRELOAD", &library).env("TURNED_TO", port);
    // If the library may not run from there, the loader would only print an error.
    let loads = Command::new("true").env("LD_PRELOAD", &library).output()?;
    assert!(loads.stderr.is_empty(), "{}", String::from_utf8_lossy(&loads.stderr));
    Launched::by(command, home)?.end()
}

/// Asserts that the launch ended for `reason`, and the plant was never started.
fn assert_never_drove(launched: &(Ended, TempDir), reason: &str) {
    let (ended, home) = launched;
    assert!(!ended.status.success() && ended.text.contains(reason), "{reason}: {}", ended.text);
    assert!(!home.path().join("run/plant.log").exists(), "{}", ended.text);
}

#[test]
fn no_robot_drives_if_its_router_accepts_strangers() -> Outcome {
    let certificates = Certificates::new()?;
    let (_open, endpoint) = router(&Shows::Nothing, &[])?;
    let launched = launched_behind(&endpoint, "network", &certificates.folder())?;
    assert_never_drove(&launched, "a peer without TLS was accepted at ");
    assert!(
        !launched.1.path().join("run/recorder.log").exists(),
        "somebody was started: {}",
        launched.0.text
    );
    Ok(())
}

#[test]
fn no_robot_drives_if_strangers_or_other_roles_can_watch() -> Outcome {
    let certificates = Certificates::new()?;
    let gateway = certificates.of(Role::Gateway);
    let doors = [
        (Shows::Nothing, "a peer without TLS was accepted at "),
        (Shows::NoCertificate(gateway.clone()), "a peer without a certificate was accepted at "),
        (Shows::Certificate(gateway), "the role gateway receives at "),
    ];
    for (shows, reason) in doors {
        let (session, endpoint) = router(&shows, &[])?;
        let ended = AtomicBool::new(false);
        let launched = thread::scope(|scope| {
            let talks = scope.spawn(|| -> Result<(), zenoh::Error> {
                while !ended.load(Ordering::Relaxed) {
                    session.put("coxswain/mecanum/health", "to whoever listens").wait()?;
                    thread::sleep(Duration::from_millis(20));
                }
                Ok(())
            });
            let launched = launched_behind(&endpoint, "local", &certificates.folder())
                .map_err(|error| error.to_string());
            ended.store(true, Ordering::Relaxed);
            talks
                .join()
                .map_err(|_| "it panicked".to_owned())?
                .map_err(|error| error.to_string())?;
            launched
        })?;
        assert_never_drove(&launched, reason);
    }
    Ok(())
}

#[test]
fn a_gateway_killed_during_its_self_test_repeats_it_before_it_accepts_watchers() -> Outcome {
    let certificates = Certificates::new()?;
    let folder = certificates.folder();
    let launched = Launched::graph(
        "local",
        &["--certificates", folder.to_str().ok_or("no text")?, "--duration", "2"],
    )?;
    // The gateway's next step takes a second.
    launched.wait_for_log("gateway", "the live page is served", 1)?;
    signal(launched.process("gateway", None)?, Signal::KILL)?;
    launched.wait_for_log("gateway", "watchers may connect", 1)?;
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let log = std::fs::read_to_string(home.path().join("run/gateway.log"))?;
    let (tried, welcome) =
        (log.find("the telemetry rejects unauthenticated peers"), log.find("watchers may connect"));
    assert!(tried.is_some() && tried < welcome, "{log}");
    Ok(())
}
