//! Sends a pose to the launch on this machine, and waits until the robot stands there:
//! `cargo run -p coxswain --example go -- X Y [YAW]`, in metres and radians.

use controller::goal::{Demand, GoalRequest};
use coxswain::goal::send;
use runs::registry;
use std::env;
use std::error::Error;
use std::io::{self, Write};
use std::process::ExitCode;

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let numbers: Result<Vec<f64>, _> = env::args().skip(1).map(|text| text.parse()).collect();
    let to = match numbers.as_deref() {
        Ok(&[x, y]) => [x, y, 0.0],
        Ok(&[x, y, yaw]) => [x, y, yaw],
        _ => {
            writeln!(io::stderr(), "go: expected X Y [YAW], as in go 2 1 1.57")?;
            return Ok(ExitCode::from(2));
        }
    };
    let request = GoalRequest::of(Demand::Pose { to });
    let accepted = send(&request, None, &registry::base())?;
    let mut out = io::stdout();
    writeln!(out, "goal {} accepted from tick {}", accepted.id, accepted.from_tick)?;
    let reached = accepted.until_reached(|goal, _| {
        let _ = writeln!(io::stdout(), "left {:.2} m, {:.1} s", goal.left_m, goal.left_s);
    })?;
    writeln!(out, "goal {} reached at tick {}", reached.id, reached.stamp.tick)?;
    Ok(ExitCode::SUCCESS)
}
