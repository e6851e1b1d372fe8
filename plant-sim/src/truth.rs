//! The true world: the real behaviour of the robot, unknown to every controller.
//!
//! ```text
//! body-velocity command ─▶ delay ─▶ speed loops ─▶ motors ─▶ wheels ─▶ body ─▶ sensors
//!                                                              ▲         ▲
//!                                               friction, patches, grip  │
//!                                   drag, slope, push, random force, turning frame
//! ```
//!
//! | file          | subject                                                     |
//! |---------------|-------------------------------------------------------------|
//! | `parameters`  | the settings of a world, as a scenario names them           |
//! | `check`       | which settings are possible                                 |
//! | `geometry`    | wheels and body: J, where the wheels stand                  |
//! | `dynamics`    | the equations of motion                                     |
//! | `integrate`   | one Runge–Kutta step                                        |
//! | `motion`      | equations and state of a robot with any number of wheels    |
//! | `schedule`    | changes during a run                                        |
//! | `disturbance` | the bounded random force                                    |
//! | `delay`       | the time that a command takes from the gate to the motors   |
//! | `sensors`     | noise and quantisation                                      |
//! | `world`       | all of it on one integer clock                              |
//! | `preview`     | prediction of the world                                     |
//!
//! Everything here is a function of settings, seed and inputs: no clock, thread, I/O or log. It
//! shares no code with the model of the controller, so that an error in one does not hide in the
//! other. Only the rows of J come from the crate `robot`; tests here derive them anew.
//!
//! SI units. The body frame is x forward, y left, yaw counter-clockwise. Wheels are in the order of
//! the settings.

mod check;
mod delay;
mod disturbance;
mod dynamics;
mod geometry;
mod integrate;
mod motion;
mod parameters;
mod preview;
mod schedule;
mod sensors;
mod world;

pub use check::Impossible;
pub use parameters::{
    Fault, Patch, Payload, Pressed, Push, RandomForce, Sensor, Slippery, Slope, Stuck, StuckSensor,
    Truth, Wheel, WheelSlip,
};
pub use preview::Preview;
pub use sensors::Measurement;
pub use world::{TrueState, World};
