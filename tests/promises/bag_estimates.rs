//! Promise: a ROS 2 bag identifies a robot as a record of the same run does.

use crate::bags::{Bag, MS, STAMPED, TWIST, home, message, odometry, write};
use graph::assembly::robot_of;
use identify::excitation::{Room, motion};
use identify::fit::{Estimate, estimate};
use identify::log::Log;
use identify::log::bag::Topics;
use identify::parameter::Parameter;
use plant_sim::truth::{Sensor, Truth, World};
use promises::{Outcome, binaries, graph_file, repository, text_of};
use robot::Response;
use serde_json::Value;
use std::error::Error;
use std::process::Command;
use tempfile::TempDir;

/// A minute of a simulated robot, in steps of time as ROS 2 has them: odometry at 50 Hz whose times
/// vary by up to 3 ms, and commands without a time at 30 Hz.
fn asynchronous(truth: &Truth) -> Vec<Value> {
    let room =
        Room { size_m: [3.0, 3.0], speed_mps: 1.0, yaw_rate_radps: 1.5, acceleration: [1e3; 3] };
    let mut world = World::new(truth, driver::Start::default(), 7);
    let points = motion(&room, 60.0, 1.0 / 30.0, 7);
    let mut messages = Vec::new();
    let (mut now, mut measured) = (0_i64, 0_i64);
    for pair in points.windows(2) {
        let [from, to] = [pair[0].pose, pair[1].pose];
        let (sin, cos) = (0.5 * (from[2] + to[2])).sin_cos();
        let [x, y, yaw] = [0, 1, 2].map(|axis| 30.0 * (to[axis] - from[axis]));
        let input = [cos * x + sin * y, cos * y - sin * x, yaw];
        messages.push(message(now, 0, "/cmd_vel", TWIST, &input));
        let end = (pair[1].time_s * 1e9) as i64 / MS * MS;
        loop {
            let next =
                20 * MS * measured + MS * (measured * 7 % 7 - 3).max(0) * i64::from(measured > 0);
            let next =
                next + MS * [0, 3, -2, 1, -3][measured as usize % 5] * i64::from(measured > 0);
            let until = next.min(end);
            world.advance((until - now) as u64, input);
            now = until;
            if next >= end {
                break;
            }
            let seen = world.measure();
            messages.push(odometry(now, seen.pose, seen.velocity));
            measured += 1;
        }
    }
    messages.sort_by_key(|message| message[0].as_i64());
    messages
}

fn value(estimate: &Estimate, parameter: Parameter) -> Result<(f64, f64), Box<dyn Error>> {
    let found = estimate.of(parameter).ok_or_else(|| format!("{parameter}: not estimated"))?;
    Ok((found.value, found.half_width))
}

#[test]
fn gain_time_constant_and_dead_time_are_found_from_topics_with_times_of_their_own() -> Outcome {
    let truth = Truth {
        mass_kg: 22.0,
        command_delay_s: 0.053,
        sensor: Sensor {
            velocity_noise_mps: 0.005,
            yaw_rate_noise_radps: 0.005,
            position_noise_m: 0.002,
            heading_noise_rad: 0.002,
            ..Sensor::default()
        },
        ..Truth::default()
    };
    let home = home()?;
    let bags = write(home.path(), &[Bag::new(&asynchronous(&truth))])?;
    let log = Log::read(&bags, &Topics::default())?;
    log.check()?;
    let found = estimate(&log, &truth.wheels, [true; 3], None, &mut |_| {});
    // λ/(κ + f) of 22 kg, r = 50 mm; see plant-sim.
    let constant = (22.0 * 0.05 * 0.05 / 4.0 + 2e-3) / 0.082;
    for axis in 0..2 {
        let (gain, _) = value(&found, Parameter::Gain(axis, axis))?;
        let (time_constant, _) = value(&found, Parameter::TimeConstant(axis))?;
        let (dead_time, width) = value(&found, Parameter::DeadTime(axis))?;
        assert!((gain / (0.08 / 0.082) - 1.0).abs() < 0.03, "{gain}");
        assert!((time_constant / constant - 1.0).abs() < 0.1, "{time_constant} {constant}");
        assert!((dead_time - 0.053).abs() < 0.005, "{dead_time} ± {width}");
    }
    Ok(())
}

/// The samples of `log` as messages: a command begins with the period whose mean input it is.
fn exported(log: &Log) -> Vec<Value> {
    let period = (log.period_s * 1e9).round() as i64;
    let mut messages = Vec::new();
    for sample in log.stretches.iter().flatten() {
        let nanos = (sample.time_s * 1e9).round() as i64;
        messages.push(message(nanos - period, 0, "/cmd_vel", STAMPED, &sample.input));
        messages.push(odometry(nanos, sample.pose, sample.velocity));
    }
    messages.sort_by_key(|message| message[0].as_i64());
    messages
}

/// The response that `coxswain identify` finds in the record of a drive, and in a bag of it, which
/// is `bag0` in the folder.
fn of_record_and_bag(
    graph: &str,
    options: &[&str],
) -> Result<(TempDir, [Response; 2]), Box<dyn Error>> {
    let home = home()?;
    let identify = |out: &str, options: &[&str]| -> Result<Response, Box<dyn Error>> {
        let mut command = Command::new(binaries()?.join("coxswain"));
        command.current_dir(repository()).env("TMPDIR", home.path()).arg("identify");
        text_of(command.args(options).arg("--out").arg(home.path().join(out)))?;
        let robot = robot_of(&home.path().join(out).join("robot.toml"))?;
        robot.response.ok_or_else(|| "no response".into())
    };
    let drive = ["--drive", graph, "--pace", "lock-step", "--area", "3x3"];
    let record = identify("driven", &[&drive, options].concat())?;
    let log = Log::read(&[home.path().join("driven/run")], &Topics::default())?;
    let sqlite = Bag { storage: "sqlite3", ..Bag::new(&exported(&log)) };
    write(home.path(), &[sqlite])?;
    let path = |name: &str| home.path().join(name).display().to_string();
    let bag = identify("of-bag", &[&path("bag0"), "--robot", &path("driven/driven-robot.toml")])?;
    Ok((home, [record, bag]))
}

#[test]
fn a_run_as_a_bag_identifies_as_its_record_does_and_becomes_a_model() -> Outcome {
    let graph = graph_file("local").display().to_string();
    let (home, [record, bag]) = of_record_and_bag(&graph, &["--duration", "30"])?;
    // The widths of the intervals are about 1 %, and 2 ms.
    for axis in 0..3 {
        assert!((bag.gain[axis] / record.gain[axis] - 1.0).abs() < 0.01, "{bag:?} {record:?}");
        let ratio = bag.time_constant_s[axis] / record.time_constant_s[axis];
        assert!((ratio - 1.0).abs() < 0.01, "{bag:?} {record:?}");
    }
    assert!((bag.dead_time_s - record.dead_time_s).abs() < 0.002, "{bag:?} {record:?}");
    let mut learn = Command::new(binaries()?.join("coxswain"));
    learn.current_dir(repository()).env("TMPDIR", home.path()).args(["learn", "--graph", &graph]);
    learn.arg(home.path().join("bag0")).arg("--to").arg(home.path().join("model.bin"));
    text_of(&mut learn)?;
    assert!(home.path().join("model.bin").is_file());
    Ok(())
}

/// ```sh
/// cargo test --release -p promises --test promises bag_estimates:: -- --ignored --nocapture
/// ```
#[test]
#[ignore = "docs/identification.md has its figures"]
#[expect(clippy::print_stdout, reason = "its figures are read by people")]
fn figures_of_the_rosbot_xl() -> Outcome {
    let options = ["--speed", "0.5", "--set", "period_millis=20"];
    let graph = repository().join("deploy/worlds/robots/graphs/rosbot-xl.toml");
    let (_, [record, bag]) = of_record_and_bag(&graph.display().to_string(), &options)?;
    println!("record {record:?}\nbag    {bag:?}");
    Ok(())
}
