//! Promise: a service manager is notified by the loops themselves that the robot drives, and gets
//! no notification once a loop has stopped.

use promises::{Launched, Outcome, graph_file, graph_with, launch_command, signal, wait_until};
use rustix::process::Signal;
use std::error::Error;
use std::fs;
use std::io;
use std::os::unix::net::UnixDatagram;
use std::thread;
use std::time::{Duration, Instant};

/// Timeout of the watchdog \[µs\]: it must be notified four times as often.
const PATIENCE_MICROS: u64 = 2_000_000;
/// Notifications on their way when a loop stops have arrived by then.
const UNDER_WAY: Duration = Duration::from_secs(2);
/// Time without notifications: longer than the timeout of the watchdog.
const SILENT: Duration = Duration::from_secs(3);

/// The service manager's end of the socket.
struct Manager {
    socket: UnixDatagram,
    received: Vec<String>,
}

impl Manager {
    /// Receives all pending notifications.
    fn listen(&mut self) -> io::Result<usize> {
        let mut message = [0; 256];
        let mut count = 0;
        loop {
            match self.socket.recv(&mut message) {
                Ok(length) => {
                    self.received.push(
                        String::from_utf8_lossy(message.get(..length).unwrap_or_default())
                            .into_owned(),
                    );
                    count += 1;
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => return Ok(count),
                Err(error) => return Err(error),
            }
        }
    }

    /// Waits until `what` has arrived `times` more times.
    fn wait_for(&mut self, launched: &Launched, what: &str, times: usize) -> Outcome {
        let count = |received: &[String]| {
            received.iter().filter(|message| message.as_str() == what).count()
        };
        let before = count(&self.received);
        launched.wait_until(&format!("{times} more {what}"), || {
            self.listen().is_ok() && count(&self.received) >= before + times
        })
    }

    /// Asserts that nothing arrives for a while.
    fn receives_nothing(&mut self) -> Outcome {
        thread::sleep(UNDER_WAY);
        self.listen()?;
        let (begin, before) = (Instant::now(), self.received.len());
        while begin.elapsed() < SILENT {
            self.listen()?;
            if let Some(message) = self.received.get(before) {
                return Err(format!("a loop has stopped, and {message} came").into());
            }
            thread::sleep(Duration::from_millis(20));
        }
        Ok(())
    }
}

/// Whether the kernel reports a process as stopped.
fn is_stopped(pid: u32) -> bool {
    fs::read_to_string(format!("/proc/{pid}/stat")).is_ok_and(|stat| stat.contains(") T "))
}

#[test]
fn only_the_loops_notify_the_watchdog() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let path = home.path().join("notify");
    let socket = UnixDatagram::bind(&path)?;
    socket.set_nonblocking(true)?;
    let mut manager = Manager { socket, received: Vec::new() };
    // A launcher that does not restart: a process that hangs continues to hang.
    let patient = ["plant", "controller"]
        .map(|role| format!("[processes.{role}]\nhung_after_millis = 600000\n"))
        .concat();
    let graph = graph_with("local", &patient, home.path())?;
    let mut command = launch_command(&graph, &home.path().join("run"), &["--duration", "600"])?;
    command
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", PATIENCE_MICROS.to_string())
        .env_remove("WATCHDOG_PID");
    let launched = Launched::by(command, home)?;

    manager.wait_for(&launched, "READY=1", 1)?;
    manager.wait_for(&launched, "WATCHDOG=1", 5)?;
    assert_eq!(
        manager.received.first().map(String::as_str),
        Some("READY=1"),
        "{:?}",
        manager.received
    );
    for (program, name) in [("controller", "the control loop"), ("plant-sim", "the gate's loop")] {
        let pid = launched.process(program, None)?;
        signal(pid, Signal::STOP)?;
        wait_until("that it stands still", || is_stopped(pid))?;
        manager.receives_nothing().map_err(|error| format!("{name}: {error}"))?;
        signal(pid, Signal::CONT)?;
        manager
            .wait_for(&launched, "WATCHDOG=1", 2)
            .map_err(|error| format!("{name} turns again: {error}"))?;
    }
    // A learner drives nothing, and the launcher restarts a stopped one.
    let learner = launched.process("learner", None)?;
    signal(learner, Signal::STOP)?;
    wait_until("that it stands still", || is_stopped(learner))?;
    manager.wait_for(&launched, "WATCHDOG=1", 3)?;

    for pid in launched.processes() {
        let environment = fs::read(format!("/proc/{pid}/environ")).unwrap_or_default();
        let is_set = String::from_utf8_lossy(&environment).contains("NOTIFY_SOCKET");
        assert!(!is_set, "a process of the graph could speak for the launcher");
    }
    signal(launched.pid(), Signal::TERM)?;
    let (ended, _home) = launched.end()?;
    manager.listen()?;
    assert_eq!(manager.received.last().map(String::as_str), Some("STOPPING=1"), "{}", ended.text);
    assert_eq!(manager.received.iter().filter(|message| *message == "READY=1").count(), 1);
    Ok(())
}

#[test]
fn the_watchdog_of_another_process_is_not_notified_and_a_missing_manager_is_named() -> Outcome {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let path = home.path().join("notify");
    let socket = UnixDatagram::bind(&path)?;
    socket.set_nonblocking(true)?;
    let mut manager = Manager { socket, received: Vec::new() };
    let mut command =
        launch_command(&graph_file("local"), &home.path().join("run"), &["--duration", "3"])?;
    command.env("NOTIFY_SOCKET", &path).env("WATCHDOG_USEC", "100000").env("WATCHDOG_PID", "1");
    let (ended, home) = Launched::by(command, home)?.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    manager.listen()?;
    assert_eq!(manager.received, ["READY=1", "STOPPING=1"]);

    let mut command = launch_command(&graph_file("local"), &home.path().join("again"), &[])?;
    let output = command
        .env("TMPDIR", home.path())
        .env("NOTIFY_SOCKET", home.path().join("nobody"))
        .output()?;
    let errors = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{errors}");
    assert!(errors.contains("NOTIFY_SOCKET") && !home.path().join("again").exists(), "{errors}");
    Ok(())
}

#[test]
fn a_restart_by_the_launcher_does_not_silence_the_watchdog_for_good() -> Result<(), Box<dyn Error>>
{
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let path = home.path().join("notify");
    let socket = UnixDatagram::bind(&path)?;
    socket.set_nonblocking(true)?;
    let mut manager = Manager { socket, received: Vec::new() };
    let mut command =
        launch_command(&graph_file("local"), &home.path().join("run"), &["--duration", "600"])?;
    command
        .env("NOTIFY_SOCKET", &path)
        .env("WATCHDOG_USEC", PATIENCE_MICROS.to_string())
        .env_remove("WATCHDOG_PID");
    let launched = Launched::by(command, home)?;
    manager.wait_for(&launched, "WATCHDOG=1", 2)?;
    let controller = launched.process("controller", None)?;
    signal(controller, Signal::STOP)?;
    launched.process("controller", Some(controller))?;
    manager.wait_for(&launched, "WATCHDOG=1", 3)
}
