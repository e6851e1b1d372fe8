//! Promise: every reference is driven on fresh plans alone, with learner and observer, under noise
//! and tight rates.

use experiment::in_process;
use graph::assembly::Assembly;
use graph::options::Options;
use promises::{Outcome, repository};
use protocol::message::FallbackLevel;
use recorder::summary::Summary;
use std::error::Error;
use std::fs;

/// Drives the paper's robot along `reference` (TOML) for 12 s in lock step, with `change` applied
/// to the assembly.
fn drive(reference: &str, change: impl Fn(&mut Assembly)) -> Result<Summary, Box<dyn Error>> {
    let folder = tempfile::tempdir()?;
    let paper = fs::read_to_string(repository().join("deploy/scenarios/paper.toml"))?;
    let own = "path.paper-curve.speed_mps = 2.7\nheading = \"tangent\"";
    assert!(paper.contains(own));
    let file = folder.path().join("scenario.toml");
    fs::write(
        &file,
        paper.replace(own, reference).replace("duration_s = 25.0", "duration_s = 12.0"),
    )?;
    let mut options = Options::of_graph(&repository().join("deploy/graphs/local.toml"));
    options.scenario = Some(file);
    let mut assembly = Assembly::read(&options)?;
    assembly.scenario.start.pose = [0.0; 3];
    assembly.scenario.mpc.observer_gain = 0.3;
    assembly.scenario.mpc.state_limits.heading_rad = None;
    change(&mut assembly);
    let run = folder.path().join("run");
    fs::create_dir(&run)?;
    Ok(in_process::run(&assembly, &run)?)
}

fn is_driven_well(name: &str, summary: &Summary, rmse_m: f64) {
    assert_eq!(
        summary.fallback_levels.on(FallbackLevel::FreshPlan),
        summary.periods,
        "{name}: {:?}",
        summary.fallback_levels
    );
    assert_eq!(summary.periods, 120, "{name}");
    assert!(
        summary.position_rmse_m.is_some_and(|error| error < rmse_m),
        "{name}: {:?} m",
        summary.position_rmse_m
    );
}

#[test]
fn every_reference_is_driven_on_fresh_plans_alone() -> Outcome {
    for (reference, rmse_m) in [
        ("path.circle = { radius_m = 1.5, speed_mps = 1.0 }\nheading = \"tangent\"", 0.05),
        (
            "path.figure-eight = { length_m = 4.0, width_m = 2.0, lap_s = 10.0 }\n\
            heading = { fixed-rad = 0.4 }",
            0.05,
        ),
        ("path.square = { side_m = 2.0, speed_mps = 1.0 }\nheading = { fixed-rad = 0.0 }", 0.15),
        (
            "path.stop-and-go = \
            { stretch_m = 2.0, speed_mps = 1.5, acceleration_mps2 = 2.0, pause_s = 1.0 }\n\
            heading = \"tangent\"",
            0.10,
        ),
        (
            "path.point-to-point = \
            { to = [2.0, 1.0, 0.5], speed_mps = 1.0, acceleration_mps2 = 1.0 }\n\
            heading = \"given\"",
            0.05,
        ),
    ] {
        is_driven_well(reference, &drive(reference, |_| {})?, rmse_m);
    }
    Ok(())
}

#[test]
fn points_of_a_file_are_driven() -> Outcome {
    let points = tempfile::NamedTempFile::new()?;
    fs::write(points.path(), "time_s,x_m,y_m,yaw_rad\n0,0,0,0\n4,3,0,0\n8,3,2,0.5\n12,0,2,0.5\n")?;
    let reference = format!("path.points.file = {:?}\nheading = \"given\"", points.path());
    is_driven_well("points", &drive(&reference, |_| {})?, 0.15);
    Ok(())
}

#[test]
fn corners_under_a_tight_rate_are_no_reason_to_refuse_a_plan() -> Outcome {
    let square = "path.square = { side_m = 2.0, speed_mps = 2.0 }\nheading = { fixed-rad = 0.0 }";
    let summary = drive(square, |assembly| assembly.robot.limits.input_rate_mps2 = 10.0)?;
    is_driven_well("square", &summary, 0.5);
    Ok(())
}

#[test]
fn noise_and_a_late_motor_do_not_stop_the_drive() -> Outcome {
    let circle = "path.circle = { radius_m = 1.5, speed_mps = 1.0 }\nheading = \"tangent\"";
    let summary = drive(circle, |assembly| {
        let truth = assembly.scenario.truth.get_or_insert_default();
        truth.sensor.velocity_noise_mps = 0.02;
        truth.sensor.yaw_rate_noise_radps = 0.02;
        truth.sensor.position_noise_m = 0.005;
        truth.command_delay_s = 0.02;
    })?;
    is_driven_well("noise", &summary, 0.10);
    Ok(())
}
