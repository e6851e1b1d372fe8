//! Promise: on a network with certificates exactly those take part who should, and nobody else moves the robot.

#[path = "attacks/matrix.rs"]
mod matrix;
#[path = "attacks/session.rs"]
mod session;
