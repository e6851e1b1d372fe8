//! The whole controller, without its ports:
//! `cargo run -p controller --example closed_loop RUN/settings/controller.toml`.
//!
//! The file is one that a launch has written. The robot follows the main model of the controller.

use controller::Settings;
use controller::adopt::Handover;
use controller::control::Controller;
use controller::reference::Reference;
use model::State;
use protocol::message::{GateState, PlantState};
use std::env;
use std::error::Error;
use std::io::{self, Write};
use std::path::Path;
use std::process::ExitCode;

fn main() -> Result<ExitCode, Box<dyn Error>> {
    let Some(file) = env::args().nth(1) else {
        writeln!(io::stderr(), "closed_loop: expected the settings of a controller")?;
        return Ok(ExitCode::from(2));
    };
    let settings: Settings = settings::read(Path::new(&file))?;
    let period = settings.run.period_nanos as f64 * 1e-9;
    let ticks = (settings.duration_s / period) as u64;
    let reference = Reference::new(&settings.reference, &settings.start, period, ticks as usize)?;
    let (mut controller, handover) = (Controller::new(&settings)?, Handover::default());
    let mut robot = State { pose: settings.start, ..State::default() };
    let mut measured: PlantState = bytemuck::Zeroable::zeroed();
    measured.gate = GateState::Driving.code();
    measured.stamp.epoch = 1;
    for tick in 0..ticks {
        (measured.stamp.tick, measured.pose, measured.velocity) =
            (tick, robot.pose, robot.velocity);
        controller.observe(&measured, &handover, 1);
        let command = controller.answer(&measured, &handover);
        let (input, level) = (command.input, command.fallback_level());
        controller.prepare_next();
        if tick % 10 == 9 {
            let point = reference.at(tick);
            let [x, y] = [0, 1].map(|axis| robot.pose[axis] - point.pose[axis]);
            writeln!(io::stdout(), "tick {tick} error {:.4} m, {level}", x.hypot(y))?;
        }
        robot = controller.knowledge().belief().predict(&robot, &input);
        (measured.input, measured.fallback_level) = (input, level.code());
        measured.controller_epoch = 1;
    }
    Ok(ExitCode::SUCCESS)
}
