//! The model of the robot, and how its error is learned. Pure: no clock, thread, input, output or
//! logging.
//!
//! | module          | what it computes                                                        |
//! |-----------------|-------------------------------------------------------------------------|
//! | [`dynamics`]    | inertia and speed-loop stiffness of a mecanum base (eqs. 10–21)         |
//! | [`main_model`]  | f: the exact discretisation of the believed dynamics, axis by axis      |
//! | [`lqr`]         | the gain K of u = −K x^f (eq. 23) and its cost-to-go                    |
//! | [`residual`]    | g: the measured velocity minus that of f (eqs. 27–29)                   |
//! | [`runge_kutta`] | one period of the pose by the method of most toolboxes                  |
//! | [`gp`]          | Gaussian-process regression of g                                        |
//! | [`physics`]     | Bayesian linear model of g with physical features                       |
//! | [`learned`]     | g as the controller uses it: layout of the inputs, normalisation, bound |
//! | [`delay`]       | the dead time from a command to its response                            |
//! | [`response`]    | dead time, time constant and gain, identified while driving             |
//! | [`observer`]    | gains of the disturbance observers: plain and Kalman                    |
//! | [`predict`]     | one step of f + g + d                                                   |
//! | [`linearise`]   | its Jacobians                                                           |
//! | [`covariance`]  | covariance of the state along a prediction                              |
//! | [`foresight`]   | the robot's own dynamics in place of f + g                              |
//!
//! Frame: x forward, y left, yaw counter-clockwise (REP-103). SI units. Wheels: front-right,
//! front-left, rear-left, rear-right.

pub mod covariance;
pub mod delay;
pub mod dynamics;
pub mod foresight;
pub mod gp;
pub mod learned;
pub mod linearise;
pub mod lqr;
pub mod main_model;
pub mod observer;
pub mod physics;
pub mod predict;
pub mod residual;
pub mod response;
pub mod runge_kutta;

pub use robot::{AXES, Velocity};

/// x, y and yaw in the world \[m, m, rad\].
pub type Pose = [f64; 3];

/// The state x of the controller: pose in the world and velocity in the body; and the input that
/// acted in the period before it.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct State {
    /// Pose in the world.
    pub pose: Pose,
    /// Body velocity.
    pub velocity: Velocity,
    /// Input that acted in the period that ends here \[m/s, m/s, rad/s\].
    pub acted: Velocity,
}

impl State {
    /// Whether every number is finite.
    pub fn is_finite(&self) -> bool {
        self.pose.iter().chain(&self.velocity).all(|value| value.is_finite())
    }

    /// x, y, yaw, forward, left, yaw rate.
    pub fn to_array(&self) -> [f64; 6] {
        let ([x, y, yaw], [forward, left, rate]) = (self.pose, self.velocity);
        [x, y, yaw, forward, left, rate]
    }
}

/// The angle in (−π, π] that differs from `angle` by whole turns \[rad\].
pub fn wrap(angle: f64) -> f64 {
    let turn = std::f64::consts::TAU;
    let wrapped = angle - turn * (angle / turn).round();
    if wrapped <= -std::f64::consts::PI { wrapped + turn } else { wrapped }
}
