//! Promise: every view of a robot that unauthenticated peers can reach shows that they can.

use promises::{
    Browser, Launched, Outcome, Reader, Record, Screen, binaries, graph_file, launch_command,
    repository, signal,
};
use protocol::message::Exposure;
use rustix::process::Signal;
use serde_json::Value;
use std::error::Error;
use std::fs;
use std::process::Command;

/// The local graph with `changes` to its text, in a home of its own, launched with `options`.
fn launch(changes: &[(&str, &str)], options: &[&str]) -> Result<Launched, Box<dyn Error>> {
    let home = tempfile::Builder::new().prefix("cx").tempdir_in("/tmp")?;
    let mut text = fs::read_to_string(graph_file("local"))?
        .replace("\"../", &format!("\"{}/deploy/", repository().display()));
    for (from, to) in changes {
        assert!(text.contains(from), "the graph file does not say {from:?}");
        text = text.replacen(from, to, 1);
    }
    let graph = home.path().join("graph.toml");
    fs::write(&graph, text)?;
    let command = launch_command(&graph, &home.path().join("run"), options)?;
    Launched::by(command, home)
}

/// `coxswain watch`, which looks for graphs in the home of `launched`.
fn watch(launched: &Launched) -> Result<Command, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command
        .arg("watch")
        .env("TMPDIR", launched.home())
        .env("TERM", "xterm-256color")
        .env_remove("NO_COLOR");
    Ok(command)
}

/// Asserts that launch, page, terminal, lines, record, summary and report show this exposure.
fn is_shown(changes: &[(&str, &str)], options: &[&str], exposure: Exposure) -> Outcome {
    let launched = launch(changes, &[options, &["--duration", "110"]].concat())?;
    let address = launched.page_address()?.replace("0.0.0.0", "127.0.0.1");
    let mut browser = Browser::start()?;
    browser.open(&address, 1280, 1120)?;
    browser.wait_for("document.getElementById('processes').children.length === 5")?;
    let on_page = "document.getElementById('insecure').dataset.exposure";
    browser.wait_for(&format!("{on_page} === '{}'", exposure.code()))?;
    // The stop button is for the robot's own machine.
    let is_local = launched.page_address()?.contains("127.0.0.1");
    let button = "document.getElementById('stop').offsetHeight > 0";
    browser.wait_for(&format!("({button}) === {is_local}"))?;
    let seen = browser.ask("document.getElementById('insecure').offsetHeight > 0")?;
    assert_eq!(seen, exposure != Exposure::Closed, "on the page");

    let mut lines = Reader::start(watch(&launched)?.arg("--plain"))?;
    let shown = |line: &String| line.contains("INSECURE");
    let wanted = |line: &String| {
        if exposure == Exposure::Closed {
            !shown(line)
        } else {
            line.ends_with(&format!("  INSECURE: {exposure}"))
        }
    };
    // The first line may come before any process has reported its health.
    let printed = lines.lines(25)?;
    assert!(printed.iter().skip(15).all(wanted), "{printed:?}");
    let mut screen = Screen::start(&watch(&launched)?, (80, 24))?;
    let shown = screen.wait_for(&[" live", "gateway    running"])?;
    let wanted = if exposure == Exposure::Closed {
        !shown.contains("INSECURE")
    } else {
        screen.wait_for(&[&format!("INSECURE: {exposure}")]).is_ok()
    };
    assert!(wanted, "{shown}");
    drop((browser, screen, lines));

    signal(launched.pid(), Signal::TERM)?;
    let (ended, home) = launched.end()?;
    assert_eq!(ended.status.code(), Some(143), "{}", ended.text);
    assert_eq!(ended.text.contains("INSECURE"), exposure != Exposure::Closed, "{}", ended.text);
    let run = home.path().join("run");
    let record = Record::read(&run)?;
    let other = if options.contains(&"--host") { "bridge" } else { "learner" };
    for who in ["plant", "controller", other, "recorder", "gateway"] {
        let reported =
            record.health_of(who).all(|health| health.word("exposure") == exposure.text());
        assert!(reported && record.health_of(who).count() > 0, "{who}");
    }
    assert_eq!(record.summary["exposure"], Value::from(exposure.text()));
    let report = fs::read_to_string(run.join("report.html"))?;
    let row = report.split_once("<tr data-key=\"exposure\">").ok_or("no row")?.1;
    let value = row.split_once("data-value=\"").ok_or("no value")?.1;
    assert!(value.starts_with(&format!("{exposure}\"")), "{value:.40}");
    let notes = report.matches("data-note=\"exposure\"").count();
    assert_eq!(notes, usize::from(exposure != Exposure::Closed));
    Ok(())
}

#[test]
fn every_view_shows_that_strangers_can_drive() -> Outcome {
    // The bridge listens for another host.
    let hosts = "[hosts.robot]\n\
                 processes = [\"plant\", \"controller\", \"recorder\", \"gateway\"]\n\
                 [hosts.training]\nprocesses = [\"learner\"]\n[[connections]]\n\
                 hosts = [\"robot\", \"training\"]\naddress = \"127.0.0.1:0\"\n[telemetry]";
    let changes = [("[telemetry]", hosts)];
    let options = ["--insecure", "--host", "robot", "--address", "training=0.0.0.0:0"];
    is_shown(&changes, &options, Exposure::Driven)
}

#[test]
fn every_view_shows_that_strangers_can_watch() -> Outcome {
    let changes = [
        ("listen = [\"tcp/127.0.0.1:0\"]", "listen = [\"tcp/0.0.0.0:0\"]"),
        ("listen = \"127.0.0.1:0\"", "listen = \"0.0.0.0:0\""),
    ];
    is_shown(&changes, &["--insecure"], Exposure::Watched)
}

#[test]
fn no_view_shows_an_exposure_that_does_not_exist() -> Outcome {
    // Permission alone lets no peer reach it.
    is_shown(&[], &["--insecure"], Exposure::Closed)
}
