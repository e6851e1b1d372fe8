//! The optimiser alone: `cargo run -p controller --example mpc`.
//!
//! A robot that follows the main model starts 0.5 m beside a circle, and drives onto it.

use controller::mpc::Mpc;
use controller::reference::{Heading, PathSettings, Reference, ReferenceSettings};
use controller::settings::MpcSettings;
use model::State;
use model::main_model::MainModel;
use model::predict::Belief;
use robot::Robot;
use std::error::Error;
use std::io::{self, Write};

const PERIOD_S: f64 = 0.1;
const HORIZON: usize = 10;

fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::example();
    let main = MainModel::new(&robot, PERIOD_S);
    let settings: MpcSettings = toml::from_str(
        "horizon_steps = 10\ncontrol_horizon_steps = 5\nobserver_gain = 0.0\n\
         weights = { position = 10.0, heading = 5.0, velocity = 1.0, yaw_rate = 0.5, \
         input = 0.1, input_change = 0.2, terminal_factor = 3.0 }",
    )?;
    let path = PathSettings::Circle { radius_m: 2.0, speed_mps: 0.8 };
    let path =
        ReferenceSettings { path, heading: Heading::Tangent, ramp_s: 0.0, speed_factor: 1.0 };
    let reference = Reference::new(&path, &[0.0; 3], PERIOD_S, 100)?;
    let belief = Belief::of(&main);
    let mut mpc = Mpc::new(&settings, &robot, &main)?;
    let (mut state, mut input) = (State { pose: [0.0, -0.5, 0.0], ..State::default() }, [0.0; 3]);
    mpc.begin_at(&state);
    let mut out = io::stdout();
    for tick in 0..60 {
        let points: Vec<_> = (tick..).take(HORIZON + 1).map(|tick| reference.at(tick)).collect();
        mpc.prepare(&points, &belief);
        let solved = mpc.iterate(&state, &input, &points, &belief);
        input = mpc.stages()[0].input;
        if tick % 10 == 0 {
            let [x, y] = [0, 1].map(|axis| state.pose[axis] - points[0].pose[axis]);
            writeln!(out, "tick {tick} error {:.4} m, {:?}", x.hypot(y), solved.outcome.status)?;
        }
        state = belief.predict(&state, &input);
    }
    Ok(())
}
