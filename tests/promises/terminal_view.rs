//! Promise: on a terminal a person sees the robot drive, disconnect and return, and the terminal is
//! restored afterwards.

use promises::{Launched, Outcome, Screen, binaries, repository, signal, wait_until};
use rustix::process::Signal;
use std::env;
use std::error::Error;
use std::fs;
use std::process::Command;
use std::thread;
use std::time::Duration;
use viewer::dashboard::screen;
use viewer::dashboard::view::KEYS;

const SMALL: (u16, u16) = (80, 24);
const LARGE: (u16, u16) = (200, 60);

/// Variable that makes the test write the captures in `docs/watch.md` anew.
const CAPTURES: &str = "COXSWAIN_CAPTURES";
/// First tick of the captures: the effect of learning must be visible.
const CAPTURED_FROM: u64 = 150;
/// Variable that makes a test the program that panics.
const PANICS: &str = "COXSWAIN_TEST_PANICS";

/// `coxswain watch ARGUMENTS…` on a terminal, which looks for graphs in the home of `launched`.
fn command(launched: &Launched, arguments: &[&str]) -> Result<Command, Box<dyn Error>> {
    let mut command = Command::new(binaries()?.join("coxswain"));
    command
        .arg("watch")
        .args(arguments)
        .env("TMPDIR", launched.home())
        .env("TERM", "xterm-256color")
        .env_remove("NO_COLOR");
    Ok(command)
}

/// A robot that drives until the launch ends, and can be watched.
fn launch() -> Result<Launched, Box<dyn Error>> {
    let launched = Launched::new(&["--duration", "110"])?;
    launched.gateway_endpoint()?;
    Ok(launched)
}

/// The tick on the screen.
fn tick(shown: &str) -> Option<u64> {
    let (_, rest) = shown.split_once(" s, tick ")?;
    rest.split_whitespace().next()?.parse().ok()
}

/// Length of the whole path on the map \[m\].
fn whole_path(shown: &str) -> Option<f64> {
    let (_, rest) = shown.split_once("whole path, ")?;
    rest.split_whitespace().next()?.parse().ok()
}

/// Words on the screen of a robot that drives.
const DRIVING: [&str; 12] = [
    "mecanum at tcp/127.0.0.1:",
    " live",
    "robot in the middle, 10 m across",
    "Tracking error",
    "fresh plan",
    "of 100 ms",
    "missed ",
    "One-step error: main → learned",
    "Processes",
    "gateway",
    "Messages lost",
    "? help",
];

/// Waits until the robot has been driving with a learned model for a while. Returns the screen.
fn see_it_drive(view: &mut Screen) -> Result<String, Box<dyn Error>> {
    view.wait_for(&DRIVING)?;
    // By their rows: the last line, with the last event, may contain that one of them "is running".
    let is_at_work = |shown: &str, who: &str| shown.contains(&format!("{who:<10} running"));
    let shown = view.wait("all processes at work, and a model", |shown| {
        let all = ["plant", "controller", "learner", "recorder", "gateway"]
            .iter()
            .all(|who| is_at_work(shown, who));
        all && shown.contains("model ") && !shown.contains("main model alone")
    })?;
    let before = tick(&shown).ok_or("no tick")?;
    let from = if env::var_os(CAPTURES).is_some() { CAPTURED_FROM } else { before + 5 };
    view.wait("time to pass", |shown| tick(shown).is_some_and(|tick| tick >= from))?;
    view.settled()
}

#[test]
fn a_person_sees_the_robot_drive_at_both_sizes_and_the_keys_match_the_help() -> Outcome {
    let launched = launch()?;
    let mut view = Screen::start(&command(&launched, &[])?, SMALL)?;
    let small = see_it_drive(&mut view)?;

    view.press("f")?;
    let went = whole_path(&view.wait_for(&["whole path, "])?).ok_or("no path")?;
    view.wait("the robot to go on", |shown| whole_path(shown).is_some_and(|goes| goes > went))?;
    view.press("0-")?;
    view.wait_for(&["robot in the middle, 14 m across"])?;
    view.press("+")?;
    view.wait_for(&["robot in the middle, 10 m across"])?;

    view.press(" ")?;
    view.wait_for(&["HELD, space resumes"])?;
    let held = view.settled()?;
    thread::sleep(Duration::from_secs(1));
    assert_eq!(view.text(), held, "a held picture stands still");
    view.press(" ")?;
    view.wait("the picture to go on", |shown| {
        !shown.contains("HELD") && tick(shown) > tick(&held)
    })?;

    view.press("?")?;
    let help: Vec<&str> = KEYS.iter().flat_map(|(keys, what)| [*keys, *what]).collect();
    view.wait_for(&help)?;
    view.press("h")?;
    view.wait("help to go", |shown| !shown.contains(" Help "))?;

    view.resize(LARGE)?;
    view.wait_for(&["Events", "with what is learned", "last error", "Tick [ms]"])?;
    view.wait_for(&DRIVING)?;
    let large = view.settled()?;
    assert!(
        large.lines().count() == usize::from(LARGE.1)
            && large.lines().any(|line| line.chars().count() == usize::from(LARGE.0)),
        "{large}"
    );
    view.resize((20, 5))?;
    view.wait("figures alone", |shown| shown.contains("error ") && !shown.contains("Map"))?;
    view.resize(SMALL)?;
    view.wait_for(&DRIVING)?;

    view.press("q")?;
    assert_eq!(view.end()?.code(), Some(0), "{}", view.text());
    view.wait_until_restored()?;
    assert_eq!(view.text().trim(), "", "nothing is left on the first screen");
    if env::var_os(CAPTURES).is_some() {
        capture(&small, &large)?;
    }
    Ok(())
}

/// Replaces the screens in `docs/watch.md`, each in the code block below its size.
fn capture(small: &str, large: &str) -> Outcome {
    let page = repository().join("docs/watch.md");
    let mut text = fs::read_to_string(&page)?;
    for (size, shown) in [("80×24", small), ("200×60", large)] {
        let heading = text.find(&format!("\n## {size}\n")).ok_or("the size has no heading")?;
        let fence = |from: usize| text[from..].find("\n```").map(|at| from + at + 1);
        let open = fence(heading).ok_or("no code block")?;
        let close = fence(open).ok_or("the code block has no end")?;
        let shown: Vec<&str> = shown.lines().map(str::trim_end).collect();
        text.replace_range(open..close, &format!("```\n{}\n", shown.join("\n")));
    }
    Ok(fs::write(page, text)?)
}

#[test]
fn a_disconnected_robot_is_greyed_and_shown_again_when_it_returns() -> Outcome {
    let launched = launch()?;
    let mut view = Screen::start(&command(&launched, &[])?, SMALL)?;
    view.wait_for(&DRIVING)?;
    let is_grey = |screen: &vt100::Screen| {
        let cells =
            (1..23).flat_map(|row| (0..80).filter_map(move |column| screen.cell(row, column)));
        cells.filter(|cell| !cell.contents().trim().is_empty()).all(vt100::Cell::dim)
    };
    assert!(!view.with(is_grey));
    let killed = launched.process("gateway", None)?;
    signal(killed, Signal::KILL)?;
    let gateway = launched.process("gateway", Some(killed))?;
    let second = |line: &str| line.contains("gateway ") && line.contains("#2");
    view.wait("the second gateway", |shown| shown.contains(" live") && shown.lines().any(second))?;

    signal(gateway, Signal::STOP)?;
    let lost = view.wait_for(&["LOST for ", "waiting for it", "Tracking error", "fresh plan"])?;
    wait_until("a grey picture", || view.with(is_grey))?;
    // Keys work meanwhile.
    view.press("?")?;
    view.wait_for(&[" Help "])?;
    view.press("?")?;
    // The launcher may have done so already.
    let _ = signal(gateway, Signal::KILL);
    let back = view.wait_for(&["live: the robot is back"])?;
    assert!(tick(&back) > tick(&lost), "{back}");
    wait_until("colours", || !view.with(is_grey))?;
    view.press("\x1b")?;
    assert_eq!(view.end()?.code(), Some(0));
    view.wait_until_restored()
}

#[test]
fn the_terminal_is_restored_after_any_end_of_the_view() -> Outcome {
    let launched = launch()?;
    for way in ["q", "\x1b", "\x03", "INT", "TERM", "HUP"] {
        let mut view = Screen::start(&command(&launched, &[])?, SMALL)?;
        view.wait_for(&[" live"])?;
        assert!(view.with(|screen| screen.alternate_screen() && screen.hide_cursor()));
        match way {
            "INT" => signal(view.pid(), Signal::INT)?,
            "TERM" => signal(view.pid(), Signal::TERM)?,
            "HUP" => signal(view.pid(), Signal::HUP)?,
            keys => view.press(keys)?,
        }
        assert_eq!(view.end()?.code(), Some(0), "{way:?}: {}", view.text());
        view.wait_until_restored().map_err(|error| format!("{way:?}: {error}"))?;
    }
    // A closed terminal leaves no process behind.
    let mut view = Screen::start(&command(&launched, &[])?, SMALL)?;
    view.wait_for(&[" live"])?;
    view.unplug();
    assert_eq!(view.end()?.code(), Some(0));
    Ok(())
}

#[test]
#[expect(clippy::panic, reason = "it is about a panic")]
fn a_panic_restores_the_terminal_and_is_reported() -> Outcome {
    if env::var_os(PANICS).is_some() {
        let mut screen = screen::Screen::take()?;
        screen.draw(|frame| frame.render_widget("a picture", frame.area()))?;
        panic!("told after the picture");
    }
    let mut command = Command::new(env::current_exe()?);
    command
        .args([
            "--exact",
            "terminal_view::a_panic_restores_the_terminal_and_is_reported",
            "--nocapture",
        ])
        .env(PANICS, "1")
        .env("RUST_BACKTRACE", "0");
    let mut view = Screen::start(&command, SMALL)?;
    assert_eq!(view.end()?.code(), Some(101));
    view.wait_until_restored()?;
    let told = view.wait_for(&["told after the picture"])?;
    assert!(!told.contains("a picture\n"), "{told}");
    Ok(())
}

#[test]
fn no_color_is_respected() -> Outcome {
    let launched = launch()?;
    let is_coloured = |screen: &vt100::Screen| {
        let mut cells =
            (0..24).flat_map(|row| (0..80).filter_map(move |column| screen.cell(row, column)));
        cells.any(|cell| {
            (cell.fgcolor(), cell.bgcolor()) != (vt100::Color::Default, vt100::Color::Default)
        })
    };
    for (no_color, coloured) in [("", true), ("1", false)] {
        let mut view = Screen::start(command(&launched, &[])?.env("NO_COLOR", no_color), SMALL)?;
        view.wait_for(&DRIVING)?;
        assert_eq!(view.with(is_coloured), coloured, "NO_COLOR={no_color}: {}", view.text());
    }
    Ok(())
}

#[test]
fn without_a_robot_the_terminal_is_not_changed() -> Outcome {
    let home = tempfile::tempdir()?;
    for (arguments, kind, code, told) in [
        (&[][..], "xterm", 1, "--plain"),
        (&["tcp/127.0.0.1:1"], "xterm", 1, "tcp/127.0.0.1:1"),
        (&["mailbox"], "xterm", 2, "mailbox"),
        (&["tcp/127.0.0.1:1"], "dumb", 2, "--plain"),
    ] {
        let mut command = Command::new(binaries()?.join("coxswain"));
        command.arg("watch").args(arguments).env("TMPDIR", home.path()).env("TERM", kind);
        let mut view = Screen::start(&command, SMALL)?;
        assert_eq!(view.end()?.code(), Some(code), "{arguments:?}: {}", view.text());
        // Lines are as long as the terminal is wide.
        view.wait(told, |shown| shown.replace('\n', "").contains(told))?;
        view.wait_until_restored()?;
    }
    Ok(())
}
