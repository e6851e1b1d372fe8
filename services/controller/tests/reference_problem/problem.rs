//! The problem that peers are measured on: a base that lags behind its input, a Gaussian process of
//! the residual, a winding reference, and a push every forty periods.
//!
//! | here                               | what                                                |
//! |------------------------------------|-----------------------------------------------------|
//! | [`main_model`]                     | v̇ = (u − v)/τ by Runge–Kutta                       |
//! | [`Processes`]                      | g(v, u), three processes with fixed hyperparameters |
//! | [`settings`], [`inputs`]           | weights and limits                                  |
//! | [`plant`], [`reference`], [`kick`] | the world                                           |

#[path = "../../../model/tests/reference_problem/gp_data.rs"]
pub(crate) mod gp_data;

use controller::mpc::constraint::InputLimits;
use controller::reference::ReferencePoint;
use controller::settings::{
    DelaySetting, Identify, Linearise, Method, MpcSettings, Observers, SolverSetting, StateLimits,
    Weights,
};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::posterior::{Posterior, PosteriorError};
use model::learned::{Moment, Residual, Response};
use model::main_model::MainModel;
use model::{State, Velocity};
use robot::Robot;
use std::cell::Cell;
use std::time::{Duration, Instant};

/// T \[s\].
pub(crate) const PERIOD: f64 = 0.1;
const TIME_CONSTANT: Velocity = [0.25, 0.25, 0.2];
pub(crate) const LARGEST_INPUT: Velocity = [3.2, 3.2, 1.05];
const RIM_SPEED: f64 = 4.0;
const REFERENCE_SPEED: f64 = 2.7;

/// f.
pub(crate) fn main_model() -> MainModel {
    MainModel::lagging(&TIME_CONSTANT, PERIOD)
}

/// Limits of the inputs: a box, and the rim speed of four wheels.
pub(crate) fn inputs() -> InputLimits {
    let wheels = Robot::example().wheels;
    let (rim, wheels) = (wheels.scaled_rows(|_radius| 1.0), wheels.count());
    let wheel = rim.map(|row| row.map(|value| value / RIM_SPEED));
    let (change, rim_change) = (None, f64::INFINITY);
    InputLimits { wheel, current: None, wheels, input: LARGEST_INPUT, change, rim, rim_change }
}

/// Weights, and limits on the velocity; every input of the horizon is free.
pub(crate) fn settings(horizon: usize) -> MpcSettings {
    MpcSettings {
        horizon_steps: horizon,
        control_horizon_steps: horizon,
        weights: Weights {
            position: 20.0,
            heading: 10.0,
            velocity: 1.0,
            yaw_rate: 1.0,
            input: 0.5,
            input_change: 0.0,
            terminal_factor: 5.0,
        },
        state_limits: StateLimits {
            speed_mps: Some(3.4),
            yaw_rate_radps: Some(1.2),
            ..StateLimits::default()
        },
        observer_gain: 0.0,
        method: Method::Mpc,
        delay: DelaySetting::Ignored,
        linearise: Linearise::Expected,
        solver: SolverSetting::ActiveSet,
        identify: Identify::Off,
        observers: Observers::Gains,
        no_harm: false,
        budget_share: 1.0,
    }
}

/// The processes, whose accelerations act for one period, and the time spent in their evaluation.
#[derive(Debug)]
pub(crate) struct Processes {
    posterior: Posterior<6>,
    asked: Cell<Duration>,
}

impl Processes {
    /// Conditioned on the first `points` samples.
    pub(crate) fn new(points: usize) -> Result<Self, PosteriorError> {
        let (inputs, targets) = gp_data::gp_data(points, 7);
        let hyperparameters = [(1.0, 1.0), (1.1, 1.2), (0.9, 0.8)].map(|(stretch, variance)| {
            Hyperparameters::new(
                [2.0, 2.0, 1.0, 2.5, 2.5, 1.2].map(|length| length * stretch),
                variance,
                0.05 * 0.05,
            )
        });
        Ok(Self {
            posterior: Posterior::new(&inputs, &targets, &hyperparameters)?,
            asked: Cell::default(),
        })
    }

    /// Time spent in evaluations since the last call.
    pub(crate) fn take_time(&self) -> Duration {
        self.asked.take()
    }
}

fn inputs_of(at: &Moment) -> [f64; 6] {
    std::array::from_fn(|i| if i < 3 { at.velocity[i] } else { at.input[i - 3] })
}

impl Residual for Processes {
    fn mean(&self, at: &Moment) -> Velocity {
        self.posterior.mean(&inputs_of(at)).map(|acceleration| PERIOD * acceleration)
    }

    fn response(&self, at: &Moment) -> Response {
        let begin = Instant::now();
        let answer = self.posterior.mean_and_gradient(&inputs_of(at));
        self.asked.set(self.asked.get() + begin.elapsed());
        let [by_velocity, by_input] = [0, 3].map(|first| {
            answer
                .gradient
                .map(|of_axis| std::array::from_fn(|column| PERIOD * of_axis[first + column]))
        });
        Response {
            mean: answer.mean.map(|acceleration| PERIOD * acceleration),
            by_velocity,
            by_input,
            ..Response::NONE
        }
    }
}

/// The true state one period later.
pub(crate) fn plant(state: &State, input: &Velocity) -> State {
    const SLICES: u32 = 20;
    let slope = |x: &[f64; 6]| -> [f64; 6] {
        let (sin, cos) = x[2].sin_cos();
        let velocity = [x[3], x[4], x[5]];
        let missed = gp_data::residual(velocity, *input);
        let pose = [cos * x[3] - sin * x[4], sin * x[3] + cos * x[4], x[5]];
        std::array::from_fn(|i| {
            if i < 3 {
                pose[i]
            } else {
                (input[i - 3] - x[i]) / TIME_CONSTANT[i - 3] + missed[i - 3]
            }
        })
    };
    let (mut x, step) = (state.to_array(), PERIOD / f64::from(SLICES));
    for _ in 0..SLICES {
        let along = |by: f64, slope: &[f64; 6]| -> [f64; 6] {
            std::array::from_fn(|i| x[i] + by * slope[i])
        };
        let first = slope(&x);
        let second = slope(&along(step / 2.0, &first));
        let third = slope(&along(step / 2.0, &second));
        let fourth = slope(&along(step, &third));
        x = std::array::from_fn(|i| {
            x[i] + step / 6.0 * (first[i] + 2.0 * second[i] + 2.0 * third[i] + fourth[i])
        });
    }
    State { pose: [x[0], x[1], x[2]], velocity: [x[3], x[4], x[5]], acted: *input }
}

/// Pose and velocity per period along y = −½ x sin(x/20), at constant speed.
pub(crate) fn reference(periods: usize) -> Vec<ReferencePoint> {
    const SLICES: u32 = 20;
    let slope = |x: f64| -0.5 * (x / 20.0).sin() - x / 40.0 * (x / 20.0).cos();
    let bend = |x: f64| -0.05 * (x / 20.0).cos() + x / 800.0 * (x / 20.0).sin();
    let along = |x: f64| 1.0 / (1.0 + slope(x).powi(2)).sqrt();
    let step = REFERENCE_SPEED * PERIOD / f64::from(SLICES);
    let mut x = 0.0;
    let mut next = || {
        let steep = slope(x);
        let curvature = bend(x) / (1.0 + steep * steep).powf(1.5);
        let pose = [x, -0.5 * x * (x / 20.0).sin(), steep.atan()];
        for _ in 0..SLICES {
            let first = along(x);
            let second = along(x + step / 2.0 * first);
            let third = along(x + step / 2.0 * second);
            let fourth = along(x + step * third);
            x += step / 6.0 * (first + 2.0 * second + 2.0 * third + fourth);
        }
        ReferencePoint {
            pose,
            velocity: [REFERENCE_SPEED, 0.0, REFERENCE_SPEED * curvature],
            course: pose[2],
        }
    };
    (0..periods).map(|_| next()).collect()
}

/// A push of the pose, to alternate sides, which makes limits active.
pub(crate) fn kick(period: usize, state: &mut State) {
    if period.is_multiple_of(40) {
        let side = if (period / 40).is_multiple_of(2) { 1.0 } else { -1.0 };
        state.pose[1] += side * 0.8;
        state.pose[2] += side * 0.25;
    }
}
