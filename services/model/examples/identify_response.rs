//! Dead time and response of a robot from its commands and velocities alone:
//! `cargo run -p model --example identify_response`.
//!
//! The robot answers two periods late, and its forward gain is 0.8 of that of the main model.

use model::Velocity;
use model::delay::Sent;
use model::main_model::MainModel;
use model::response::ResponseEstimator;
use robot::Robot;
use std::collections::VecDeque;
use std::io::{self, Write};

const LATE_PERIODS: usize = 2;
const GAIN: f64 = 0.8;

fn main() -> io::Result<()> {
    let robot = Robot::example();
    let main = MainModel::new(&robot, 0.02);
    let mut estimator = ResponseEstimator::new(&main, &robot.wheels);
    let mut sent = Sent::always([0.0; 3]);
    let mut under_way = VecDeque::from(vec![[0.0; 3]; LATE_PERIODS]);
    let mut velocity: Velocity = [0.0; 3];
    for tick in 0..1000 {
        let phase = 0.02 * f64::from(tick);
        let command = [0.5 * (3.0 * phase).sin(), 0.3 * (5.0 * phase).cos(), 0.4 * phase.sin()];
        sent.push(command);
        under_way.push_back(command);
        let acting = under_way.pop_front().unwrap_or_default();
        velocity = main.next_velocity(&velocity, &[GAIN * acting[0], acting[1], acting[2]]);
        estimator.update(&sent, &velocity, None);
    }
    let axes = estimator.response().axes;
    let mut out = io::stdout();
    writeln!(out, "dead time {:.2} periods", estimator.delay().periods())?;
    for (axis, name) in ["forward", "left", "yaw"].into_iter().enumerate() {
        writeln!(out, "{name}: gain {:.3} of the main model", axes[axis].gain / main.gain[axis])?;
    }
    Ok(())
}
