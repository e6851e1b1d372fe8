//! Promise: any number of watchers can watch, through losses and reconnections, at no cost to the
//! robot.

use promises::{
    Browser, Launched, Outcome, Reader, Record, binaries, python, repository, signal, wait_until,
};
use protocol::message::FallbackLevel;
use rustix::process::Signal;
use std::error::Error;
use std::process::{Command, Stdio};

/// `coxswain watch ARGUMENTS… --plain`, which looks for graphs in the home of `launched`.
fn watch(launched: &Launched, arguments: &[&str]) -> Result<Reader, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command.arg("watch").args(arguments).arg("--plain").env("TMPDIR", launched.home());
    Reader::start(&mut command)
}

/// The tick in a line.
fn tick(line: &str) -> Option<u64> {
    line.strip_prefix("tick")?.split_whitespace().next()?.parse().ok()
}

/// All commands of a run.
fn commands(record: &Record) -> Vec<String> {
    record
        .of("command")
        .map(|command| {
            format!(
                "{} {} {}",
                command.stamp("tick"),
                command.fields["input"],
                command.fields["tail"]
            )
        })
        .collect()
}

#[test]
fn a_watcher_sees_every_period_of_a_slow_robot_and_ends_on_request() -> Outcome {
    let launched = Launched::new(&["--duration", "6"])?;
    launched.gateway_endpoint()?;
    let mut watcher = watch(&launched, &[])?;
    let lines = watcher.lines(20)?;
    let ticks: Vec<u64> = lines.iter().filter_map(|line| tick(line)).collect();
    assert_eq!(ticks.len(), lines.len(), "{lines:?}");
    assert!(ticks.is_sorted_by(|earlier, later| earlier < later), "{ticks:?}");
    assert!(lines.iter().any(|line| line.contains(FallbackLevel::FreshPlan.text())), "{lines:?}");
    signal(watcher.pid(), Signal::INT)?;
    assert_eq!(watcher.end()?.code(), Some(0));
    let (ended, _home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    assert!(ended.text.contains("coxswain watch tcp/127.0.0.1:"), "{}", ended.text);
    Ok(())
}

#[test]
fn a_robot_that_disconnects_and_returns_is_reported_once_each() -> Outcome {
    let launched = Launched::new(&["--duration", "15"])?;
    let endpoint = launched.gateway_endpoint()?;
    let mut watcher = watch(&launched, &[])?;
    watcher.lines(5)?;
    let gateway = launched.process("gateway", None)?;
    signal(gateway, Signal::STOP)?;
    watcher.wait_for_error(&endpoint, 1)?;
    // A stopped gateway is killed and restarted; its watchers reconnect at the same address.
    signal(gateway, Signal::KILL)?;
    launched.process("gateway", Some(gateway))?;
    watcher.wait_for_error(&endpoint, 2)?;
    watcher.lines(5)?;
    let errors = watcher.errors();
    // The line about its return has its name.
    assert_eq!(
        (errors.matches(&endpoint).count(), errors.matches("mecanum").count()),
        (2, 1),
        "{errors}"
    );
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{}", ended.text);
    let record = Record::read(&home.path().join("run"))?;
    assert_eq!(record.of("state").count(), 151, "the robot did not notice");
    assert_eq!(record.summary["periods_missed"], 0);
    Ok(())
}

/// Events beside a run.
#[derive(Debug, Clone, Copy)]
enum Beside {
    Nothing,
    Watcher,
    StoppedWatcher,
    KilledWatcher,
    StoppedGateway,
    Stranger,
    Browser,
    StoppedBrowser,
    KilledBrowser,
}

/// Length of the runs in lock step \[s\].
const LENGTH_S: f64 = 100.0;

/// All commands of a run in lock step with this event beside it.
fn commands_beside(beside: Beside) -> Result<Vec<String>, Box<dyn Error>> {
    let looks = matches!(beside, Beside::Browser | Beside::StoppedBrowser | Beside::KilledBrowser);
    let mut browser = if looks { Some(Browser::start()?) } else { None };
    let launched = Launched::new(&["--pace", "lock-step", "--duration", &LENGTH_S.to_string()])?;
    let mut watcher = None;
    if let Some(browser) = &mut browser {
        let seen = look_on(browser, &launched)?;
        match beside {
            Beside::StoppedBrowser => browser.signal(Signal::STOP)?,
            Beside::KilledBrowser => browser.signal(Signal::KILL)?,
            _ => browser.wait_for(&format!(
                "parseFloat(document.getElementById('time').innerText) > {seen}"
            ))?,
        }
    } else if !matches!(beside, Beside::Nothing) {
        launched.gateway_endpoint()?;
        let watcher = watcher.insert(match beside {
            Beside::Stranger => stranger(&launched)?,
            _ => watch(&launched, &[])?,
        });
        // It is at work, and the run is not over.
        watcher.lines(3)?;
        match beside {
            Beside::StoppedWatcher => signal(watcher.pid(), Signal::STOP)?,
            Beside::KilledWatcher => signal(watcher.pid(), Signal::KILL)?,
            Beside::StoppedGateway => signal(launched.process("gateway", None)?, Signal::STOP)?,
            _ => {}
        }
    }
    let (ended, home) = launched.end()?;
    assert!(ended.status.success(), "{beside:?}: {}", ended.text);
    if let (Beside::Stranger, Some(stranger)) = (beside, watcher) {
        assert!(!stranger.errors().contains("received a forged message"), "{}", stranger.errors());
    }
    if let (Beside::StoppedBrowser, Some(browser)) = (beside, browser) {
        browser.signal(Signal::CONT)?;
    }
    Ok(commands(&Record::read(&home.path().join("run"))?))
}

/// Opens the live page of a running launch. Returns the time up to which the browser has seen it
/// \[s\].
fn look_on(browser: &mut Browser, launched: &Launched) -> Result<f64, Box<dyn Error>> {
    browser.open(&launched.page_address()?, 1280, 1120)?;
    browser.wait_for("parseFloat(document.getElementById('time').innerText) > 0")?;
    let seen = browser
        .ask("parseFloat(document.getElementById('time').innerText)")?
        .as_f64()
        .ok_or("no time")?;
    assert!(seen < LENGTH_S, "the run was over before anybody looked");
    Ok(seen)
}

/// Publishes on every key of the gateway what a process of the graph could publish there.
fn stranger(launched: &Launched) -> Result<Reader, Box<dyn Error>> {
    let mut command = Command::new(python()?);
    command.arg("-B").arg(repository().join("tests/python/stranger.py"));
    Reader::start(
        command.arg(launched.gateway_endpoint()?).arg(repository().join("protocol/vectors")),
    )
}

/// With any events beside a run in lock step, every command equals that of a run without events.
fn nothing_changes_beside(others: &[Beside]) -> Outcome {
    let unwatched = commands_beside(Beside::Nothing)?;
    assert_eq!(unwatched.len(), 1001);
    for &beside in others {
        let watched = commands_beside(beside)?;
        for (ours, theirs) in unwatched.iter().zip(&watched) {
            assert_eq!(ours, theirs, "{beside:?}");
        }
        assert_eq!(watched.len(), unwatched.len(), "{beside:?}");
    }
    Ok(())
}

#[test]
fn in_lock_step_no_watcher_stranger_or_stopped_gateway_delays_or_changes_a_run() -> Outcome {
    use Beside::{KilledWatcher, StoppedGateway, StoppedWatcher, Stranger, Watcher};
    nothing_changes_beside(&[Watcher, StoppedWatcher, KilledWatcher, StoppedGateway, Stranger])
}

#[test]
fn in_lock_step_no_watching_stopped_or_killed_browser_delays_or_changes_a_run() -> Outcome {
    nothing_changes_beside(&[Beside::Browser, Beside::StoppedBrowser, Beside::KilledBrowser])
}

#[test]
fn a_failure_to_watch_is_reported_clearly() -> Outcome {
    let home = tempfile::tempdir()?;
    for (arguments, code, told) in [
        (&["--plain"][..], 1, "coxswain watch"),
        (&["mailbox", "--plain"], 2, "mailbox"),
        (&["tcp/127.0.0.1:1", "--plain"], 1, "tcp/127.0.0.1:1"),
        (&["tcp/127.0.0.1:1", "--robot", "A B", "--plain"], 2, "A B"),
        (&["tcp/127.0.0.1:1"], 2, "--plain"),
    ] {
        let output = Command::new(binaries()?.join("coxswain"))
            .arg("watch")
            .args(arguments)
            .env("TMPDIR", home.path())
            .output()?;
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {text}");
        assert!(text.contains(told), "{arguments:?}: {text}");
    }
    Ok(())
}

#[test]
fn a_pipe_that_is_closed_ends_the_watcher_quietly() -> Outcome {
    let launched = Launched::new(&["--duration", "5"])?;
    launched.gateway_endpoint()?;
    let mut command = Command::new(binaries()?.join("coxswain"));
    command
        .args(["watch", "--plain"])
        .env("TMPDIR", launched.home())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    let mut child = command.spawn()?;
    drop(child.stdout.take());
    let mut status = None;
    let ended = wait_until("the end of the watcher", || {
        status = child.try_wait().ok().flatten();
        status.is_some()
    });
    let _ = child.kill();
    ended?;
    assert_eq!(status.and_then(|status| status.code()), Some(0));
    launched.end()?;
    Ok(())
}
