//! Promises: a log becomes a robot file and a report, and one that cannot be used becomes an error
//! that names its place, and no file.

use graph::scenario::Scenario;
use identify::command::{IdentifyError, identify};
use identify::excitation::{Room, motion};
use identify::log::bag::Topics;
use identify::log::{Log, LogError};
use plant_sim::truth::{Sensor, Truth, World};
use robot::Robot;
use std::error::Error;
use std::fmt::Write;
use std::path::{Path, PathBuf};
use tempfile::TempDir;

type Outcome = Result<(), Box<dyn Error>>;

const HEADER: &str = "time_s,x_m,y_m,yaw_rad,velocity_forward_mps,velocity_left_mps,\
     yaw_rate_radps,input_forward_mps,input_left_mps,input_yaw_radps";
const PERIOD_S: f64 = 0.05;

/// Rows of a table of `axes` moved for 30 s: time, pose, velocity, input.
fn rows(axes: [f64; 3]) -> Vec<[f64; 10]> {
    let room =
        Room { size_m: [3.0, 3.0], speed_mps: 1.0, yaw_rate_radps: 1.5, acceleration: [1e3; 3] };
    let truth = Truth {
        mass_kg: 22.0,
        command_delay_s: 0.06,
        sensor: Sensor { velocity_noise_mps: 0.005, position_noise_m: 0.002, ..Sensor::default() },
        ..Truth::default()
    };
    let mut world = World::new(&truth, driver::Start::default(), 3);
    let points = motion(&room, 30.0, PERIOD_S, 3);
    let mut rows = Vec::new();
    for pair in points.windows(2) {
        let [from, to] = [pair[0].pose, pair[1].pose];
        let (sin, cos) = (0.5 * (from[2] + to[2])).sin_cos();
        let [x, y, yaw] = [0, 1, 2].map(|axis| (to[axis] - from[axis]) / PERIOD_S);
        let [u, v, w] =
            [axes[0] * (cos * x + sin * y), axes[1] * (cos * y - sin * x), axes[2] * yaw];
        world.advance((PERIOD_S * 1e9) as u64, [u, v, w]);
        let measured = world.measure();
        let ([px, py, pw], [vx, vy, vw]) = (measured.pose, measured.velocity);
        rows.push([pair[1].time_s, px, py, pw, vx, vy, vw, u, v, w]);
    }
    rows
}

fn table(folder: &TempDir, rows: &[[f64; 10]]) -> Result<PathBuf, Box<dyn Error>> {
    table_named("log.csv", folder, rows)
}

fn table_named(
    name: &str,
    folder: &TempDir,
    rows: &[[f64; 10]],
) -> Result<PathBuf, Box<dyn Error>> {
    let mut text = format!("{HEADER}\n");
    for row in rows {
        let cells: Vec<String> = row.iter().map(f64::to_string).collect();
        writeln!(text, "{}", cells.join(","))?;
    }
    let path = folder.path().join(name);
    std::fs::write(&path, text)?;
    Ok(path)
}

/// The error of these rows. Nothing may be written.
fn refused(rows: &[[f64; 10]]) -> Result<LogError, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    match identify(&[table(&folder, rows)?], &Topics::default(), &Robot::example(), &out, false) {
        Err(IdentifyError::Log(error)) => {
            assert!(!out.exists(), "{error}");
            Ok(error)
        }
        other => Err(format!("{other:?}").into()),
    }
}

#[test]
fn a_table_becomes_a_robot_file_that_can_be_read_and_a_report() -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    identify(
        &[table(&folder, &rows([1.0; 3]))?],
        &Topics::default(),
        &Robot::example(),
        &out,
        false,
    )?;
    let robot = graph::assembly::robot_of(&out.join("robot.toml"))?;
    let response = robot.response.ok_or("no response")?;
    // λ/(κ + f) of 22 kg, r = 50 mm; see plant-sim.
    let constant = (22.0 * 0.05 * 0.05 / 4.0 + 2e-3) / 0.082;
    assert!((response.time_constant_s[0] / constant - 1.0).abs() < 0.1, "{response:?} {constant}");
    assert!((response.gain[0] / (0.08 / 0.082) - 1.0).abs() < 0.03, "{response:?}");
    assert!((response.dead_time_s - 0.06).abs() < 0.005, "{response:?}");
    assert_eq!(robot.wheels, Robot::example().wheels);
    let page = std::fs::read_to_string(out.join("report.html"))?;
    assert_eq!(page.matches("<svg role").count(), 6);
    Ok(())
}

/// A scenario of the drill with the variant that comes out has the weights of the profile that it
/// names, and a sound period and horizon.
#[test]
fn the_tuned_variant_has_the_weights_of_its_profile() -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    let (table, robot) = (table(&folder, &rows([1.0; 3]))?, Robot::example());
    identify(&[table], &Topics::default(), &robot, &out, false)?;
    let scenarios = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../deploy/scenarios");
    let variants = folder.path().join("variants");
    std::fs::create_dir(&variants)?;
    std::fs::copy(scenarios.join("figure-eight.toml"), folder.path().join("eight.toml"))?;
    std::fs::copy(out.join("tuned.toml"), variants.join("tuned.toml"))?;
    let tuned = Scenario::named(folder.path(), "eight+tuned", None, &[])?;
    let profile = (tuned.period_millis < 50.0).then_some("agile");
    let profile = Scenario::named(&scenarios, "figure-eight", profile, &[])?;
    assert_eq!(tuned.mpc.weights, profile.mpc.weights);
    assert!(tuned.mpc.control_horizon_steps <= tuned.mpc.horizon_steps);
    assert_eq!(tuned.learner.layout, profile.learner.layout);
    Ok(())
}

#[test]
fn an_axis_that_does_not_move_keeps_what_the_robot_file_says() -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    identify(
        &[table(&folder, &rows([1.0, 0.0, 0.0]))?],
        &Topics::default(),
        &Robot::example(),
        &out,
        false,
    )?;
    let text = std::fs::read_to_string(out.join("robot.toml"))?;
    let robot = graph::assembly::robot_of(&out.join("robot.toml"))?;
    let constant = (15.0 * 0.05 * 0.05 / 4.0 + 2e-3) / 0.082;
    let left = robot.response.ok_or("no response")?.time_constant_s[1];
    assert!((left / constant - 1.0).abs() < 1e-2, "{left} {constant}");
    assert!(text.contains("# Not told by the data: left"), "{text}");
    Ok(())
}

#[test]
fn gaps_and_numbers_that_are_none_are_left_out_and_named() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut rows = rows([1.0; 3]);
    rows[100][4] = f64::NAN;
    rows.drain(300..320);
    rows.insert(420, rows[419]);
    let log = Log::read(&[table(&folder, &rows)?], &Topics::default())?;
    assert_eq!(log.stretches.len(), 3);
    assert_eq!(log.notes.len(), 3, "{:?}", log.notes);
    let lines = ["line 102", "line 302", "line 422"];
    for (note, line) in log.notes.iter().zip(lines) {
        assert!(note.contains(line), "{note}");
    }
    Ok(())
}

#[test]
fn a_log_that_cannot_be_used_is_refused_by_its_reason() -> Outcome {
    let good = rows([1.0; 3]);
    let mut backwards = good.clone();
    backwards[50][0] = 0.1;
    assert!(matches!(refused(&backwards)?, LogError::Backwards { .. }));
    let scaled = |columns: std::ops::Range<usize>, factor: f64| {
        let mut rows = good.clone();
        for row in &mut rows {
            row[columns.clone()].iter_mut().for_each(|value| *value *= factor);
        }
        rows
    };
    assert!(matches!(refused(&scaled(4..6, 1000.0))?, LogError::Unit { axis: "forward", .. }));
    assert!(matches!(refused(&scaled(6..7, 57.3))?, LogError::Unit { axis: "yaw", .. }));
    assert!(matches!(refused(&scaled(7..9, 1000.0))?, LogError::InputUnit { .. }));
    assert!(matches!(refused(&scaled(1..10, 0.0))?, LogError::NoMotion { .. }));
    assert!(matches!(refused(&scaled(7..10, 0.0))?, LogError::NoInput));
    assert!(matches!(refused(&good[..100])?, LogError::TooShort { .. }));
    assert!(matches!(refused(&scaled(0..1, 1e3))?, LogError::Period { .. }));
    Ok(())
}

#[test]
fn one_log_in_another_unit_is_named_among_others() -> Outcome {
    let folder = tempfile::tempdir()?;
    let good = rows([1.0; 3]);
    let mut degrees = good.clone();
    for row in &mut degrees {
        row[6] *= 57.3;
    }
    let names = [("a.csv", &good), ("b.csv", &good), ("c.csv", &degrees), ("d.csv", &good)];
    let logs: Vec<PathBuf> = names
        .iter()
        .map(|(name, rows)| table_named(name, &folder, rows))
        .collect::<Result<_, _>>()?;
    let found = Log::read(&logs, &Topics::default())?.check();
    let Err(LogError::Unit { path, axis: "yaw", .. }) = found else {
        return Err(format!("{found:?}").into());
    };
    assert_eq!(path, logs[2]);
    Ok(())
}

#[test]
fn a_log_in_millimetres_is_faster_than_the_robot() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut rows = rows([1.0; 3]);
    for row in &mut rows {
        for column in [1, 2, 4, 5, 7, 8] {
            row[column] *= 1e3;
        }
    }
    let (logs, out) = ([table(&folder, &rows)?], folder.path().join("out"));
    let found = identify(&logs, &Topics::default(), &Robot::example(), &out, false);
    assert!(matches!(found, Err(IdentifyError::TooFast { axis: "forward", .. })), "{found:?}");
    assert!(!out.exists());
    Ok(())
}

/// A table with the speeds of the first `wheels` wheels, times `factor`. In the rows of `without`,
/// that of the last wheel is missing.
fn table_with_wheels(
    folder: &TempDir,
    (wheels, factor): (usize, f64),
    without: &[usize],
) -> Result<PathBuf, Box<dyn Error>> {
    let robot = Robot::example();
    let names: Vec<String> = (1..=wheels).map(|wheel| format!(",wheel_{wheel}_radps")).collect();
    let mut text = format!("{HEADER}{}\n", names.concat());
    for (number, row) in rows([1.0; 3]).iter().enumerate() {
        let [.., ahead, left, yaw, _, _, _] = *row;
        let speeds = robot.wheels.speeds([ahead, left, yaw]);
        let mut cells: Vec<String> = row.iter().map(f64::to_string).collect();
        cells.extend(speeds.iter().take(wheels).map(|speed| (factor * speed).to_string()));
        if without.contains(&number) {
            cells.pop();
            cells.push(String::new());
        }
        writeln!(text, "{}", cells.join(","))?;
    }
    let path = folder.path().join("wheels.csv");
    std::fs::write(&path, text)?;
    Ok(path)
}

#[test]
fn wheel_speeds_of_other_wheels_or_in_another_unit_are_refused() -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    let error = |wheels, factor| {
        let table = table_with_wheels(&folder, (wheels, factor), &[])?;
        let found = identify(&[table], &Topics::default(), &Robot::example(), &out, false);
        assert!(!out.exists(), "{found:?}");
        match found {
            Err(IdentifyError::Log(error)) => Ok(error),
            other => Err(Box::<dyn Error>::from(format!("{other:?}"))),
        }
    };
    assert!(matches!(error(3, 1.0)?, LogError::WheelCount { found: 3, expected: 4, .. }));
    // Revolutions per minute.
    let found = error(4, 9.549)?;
    assert!(matches!(found, LogError::WheelUnit { axis: "forward", .. }), "{found}");
    Ok(())
}

#[test]
fn a_row_without_a_wheel_leaves_the_others() -> Outcome {
    let folder = tempfile::tempdir()?;
    let out = folder.path().join("out");
    let table = table_with_wheels(&folder, (4, 1.0), &[100, 101])?;
    let log = Log::read(std::slice::from_ref(&table), &Topics::default())?;
    assert_eq!((log.wheels, log.stretches.len(), log.notes.len()), (4, 1, 1));
    identify(&[table], &Topics::default(), &Robot::example(), &out, false)?;
    let text = std::fs::read_to_string(out.join("robot.toml"))?;
    assert!(text.contains("wheel radius (0.0500 in the robot file)"), "{text}");
    Ok(())
}

#[test]
fn a_table_with_other_columns_is_refused_with_the_expected_ones() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("log.csv");
    std::fs::write(&path, "t,x,y\n0,0,0\n0.1,0,0\n")?;
    assert!(matches!(Log::read(&[path], &Topics::default()), Err(LogError::Table { .. })));
    let missing = folder.path().join("none.csv");
    assert!(matches!(Log::read(&[missing], &Topics::default()), Err(LogError::Table { .. })));
    Ok(())
}
