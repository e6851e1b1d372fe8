//! Promise: held keys drive the robot, and without a key it stands. The terminal is restored after
//! any end.

use crate::goals::{coxswain, end, fastest, launch, status};
use promises::{Launched, Outcome, Screen, binaries, signal, sweep_after};
use rustix::process::Signal;
use std::error::Error;
use std::fs;
use std::process::{Command, Stdio};
use std::time::Duration;

/// How many goals have a reply.
fn goals_given(launched: &Launched) -> usize {
    let files = fs::read_dir(launched.folder().join("set")).into_iter().flatten().flatten();
    let names = files.filter_map(|file| file.file_name().into_string().ok());
    names.filter(|name| name.starts_with("controller-") && name.ends_with(".answer.json")).count()
}

/// Presses `key` again and again, until `goals` goals were given and the robot moves.
fn hold_until_moving(launched: &Launched, keys: &mut Screen, key: &str, goals: usize) -> Outcome {
    launched.wait_until("motion", || {
        for _ in 0..10 {
            let _ = keys.press(key);
            std::thread::sleep(Duration::from_millis(50));
        }
        let moves = |status: serde_json::Value| fastest(&status).is_some_and(|speed| speed > 0.1);
        goals_given(launched) >= goals && status(launched).is_ok_and(moves)
    })
}

/// Waits until the robot stands and its goal has ended, and returns its status.
fn wait_until_standing(launched: &Launched) -> Result<serde_json::Value, Box<dyn Error>> {
    let mut last = serde_json::Value::Null;
    launched.wait_until("standstill", || {
        last = status(launched).unwrap_or_default();
        last["goal"]["phase"] != "active" && fastest(&last).is_some_and(|speed| speed < 0.02)
    })?;
    Ok(last)
}

#[test]
fn held_keys_drive_and_without_a_key_the_robot_stands() -> Outcome {
    let launched = launch()?;
    launched.wait_for_controller(1)?;
    let drive = coxswain(&launched, &["drive", "--dead-man", "2"])?;
    let mut keys = Screen::start(&drive, (100, 24))?;
    keys.wait_for(&["+0.00 +0.00 +0.00"])?;

    // The arrow to the left.
    hold_until_moving(&launched, &mut keys, "\x1b[D", 3)?;
    let state = wait_until_standing(&launched)?;
    let goal = (&state["goal"]["kind"], &state["goal"]["phase"]);
    assert_eq!(
        (goal, &state["robot"]["gate"]),
        ((&"velocity".into(), &"reached".into()), &"driving".into())
    );
    let [x, y] = [0, 1].map(|axis| state["robot"]["pose"][axis].as_f64().unwrap_or_default());
    assert!(y > 0.2 && x.abs() < 0.1, "it drives to the left alone: {x} m, {y} m");

    // A killed program stops it as well.
    hold_until_moving(&launched, &mut keys, "q", 1)?;
    signal(keys.pid(), Signal::KILL)?;
    wait_until_standing(&launched)?;

    let mut keys = Screen::start(&drive, (100, 24))?;
    keys.wait_for(&["+0.00 +0.00 +0.00"])?;
    hold_until_moving(&launched, &mut keys, "w", 1)?;
    keys.press(" ")?;
    let state = wait_until_standing(&launched)?;
    assert_eq!(state["goal"]["kind"], "hold", "{state}");
    hold_until_moving(&launched, &mut keys, "s", 1)?;
    keys.press("x")?;
    launched.wait_until("a latched stop", || {
        status(&launched).is_ok_and(|status| status["robot"]["gate"] == "stopped")
    })?;
    // A rejected goal does not end it.
    let before = goals_given(&launched);
    launched.wait_until("a rejected goal", || {
        keys.press("w").is_ok() && goals_given(&launched) > before
    })?;
    keys.press("\x1b")?;
    assert_eq!(keys.end()?.code(), Some(0), "{}", keys.text());
    keys.wait_until_restored()?;
    let record = end(launched)?;
    let ended = record.of("truth").next_back().ok_or("no truth")?;
    assert!(ended.numbers("velocity").iter().all(|velocity| velocity.abs() < 0.05));
    Ok(())
}

#[test]
fn the_terminal_view_drives_after_its_key_and_watches_again() -> Outcome {
    let launched = launch()?;
    let endpoint = launched.gateway_endpoint()?;
    launched.wait_for_controller(1)?;
    let mut view = Screen::start(&coxswain(&launched, &["watch", &endpoint])?, (100, 30))?;
    view.wait_for(&[" live"])?;
    // Before its key the view drives nothing.
    view.press("dw")?;
    view.press("k")?;
    view.wait_for(&["+0.00 +0.00 +0.00"])?;
    assert_eq!(goals_given(&launched), 0);
    hold_until_moving(&launched, &mut view, "d", 1)?;
    // Esc ends driving, not the view.
    view.press("\x1b")?;
    let state = wait_until_standing(&launched)?;
    let y = state["robot"]["pose"][1].as_f64().ok_or("no pose")?;
    assert!(y < -0.05, "it drives to the right: {y} m");
    view.press("?")?;
    view.wait_for(&[" Help "])?;
    view.press("?q")?;
    assert_eq!(view.end()?.code(), Some(0), "{}", view.text());
    view.wait_until_restored()?;
    end(launched)?;
    Ok(())
}

#[test]
fn driving_by_keyboard_restores_the_terminal_after_any_end() -> Outcome {
    let launched = launch()?;
    launched.wait_for_controller(1)?;
    let drive = coxswain(&launched, &["drive"])?;
    for way in ["\x1b", "\x03", "INT", "TERM", "HUP"] {
        let mut keys = Screen::start(&drive, (80, 24))?;
        keys.wait_for(&["+0.00 +0.00 +0.00"])?;
        match way {
            "INT" => signal(keys.pid(), Signal::INT)?,
            "TERM" => signal(keys.pid(), Signal::TERM)?,
            "HUP" => signal(keys.pid(), Signal::HUP)?,
            key => keys.press(key)?,
        }
        assert_eq!(keys.end()?.code(), Some(0), "{way:?}: {}", keys.text());
        keys.wait_until_restored().map_err(|error| format!("{way:?}: {error}"))?;
    }
    let mut keys = Screen::start(&drive, (80, 24))?;
    keys.wait_for(&["+0.00 +0.00 +0.00"])?;
    let pid = launched.pid();
    signal(pid, Signal::TERM)?;
    assert_eq!(keys.end()?.code(), Some(1), "the launch has ended: {}", keys.text());
    keys.wait_until_restored()?;
    // The launch could not remove what was in use. The next one does.
    let (_, home) = launched.end()?;
    sweep_after(home.path())
}

#[test]
fn without_a_terminal_there_are_no_keys() -> Outcome {
    let home = tempfile::tempdir()?;
    let mut drive = Command::new(binaries()?.join("coxswain"));
    drive.arg("drive").env("TMPDIR", home.path()).stdin(Stdio::null());
    assert_eq!(drive.output()?.status.code(), Some(2));
    Ok(())
}
