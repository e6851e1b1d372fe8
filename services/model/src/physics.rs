//! Bayesian linear model of the residual, with features for the physics that the main model leaves
//! out. The weights are identified while driving.
//!
//! ```text
//! g_a = (1 − A_a) φ_aᵀ w_a + noise
//! ```
//! | features φ of an axis   | what they stand for                                           |
//! |-------------------------|---------------------------------------------------------------|
//! | u − v of all three axes | wrong inertia or loop gain; motors that differ                |
//! | its own v               | friction that grows with speed, a wrong wheel radius          |
//! | 1                       | a constant force                                              |
//! | J⁺ tanh(J v/v_s)        | Coulomb friction of the wheels                                |
//! | two products of ω       | the turning frame (Coriolis), a centre of mass off the middle |
//! | \|v\| v                 | drag                                                          |
//!
//! Yaw counts as the speed L ω. The weights of each axis vary about their prior as an
//! Ornstein–Uhlenbeck process of time constant τ. Weights that new data contradict, or no longer
//! excite, are forgotten. The posterior is that of a Kalman filter. It is exact except for R, the
//! variance of a sample, which follows the innovations:
//!
//! ```text
//! w ← ρ w    P ← ρ² P + (1 − ρ²) P₀    ρ = e^{−T/τ}
//! K = P φ/(φᵀ P φ + R)   w ← w + K e    P ← P − K φᵀ P    e = g − φᵀ w
//! ```
//! Reference: Rasmussen & Williams 2006, section 2.1; Särkkä, *Bayesian Filtering and Smoothing*,
//! 2013, section 3.2.

use crate::learned::{Moment, Residual, Response};
use crate::main_model::MainModel;
use crate::{AXES, Velocity};
use nalgebra::{SMatrix, SVector};
use robot::Wheels;
use serde::{Deserialize, Serialize};

/// Features of one axis.
const FEATURES: usize = 9;

/// Of these, those that are linear in velocity and input: u − v, and v.
const SLIP: [usize; AXES] = [0, 1, 2];
const SPEED: usize = 3;

/// Standard deviation of the weights before any sample \[–, –, m/s, m/s, –, –, s/m\].
const PRIOR: [f64; FEATURES] = [0.5, 0.5, 0.5, 0.3, 0.2, 0.2, 1.0, 1.0, 0.2];

/// τ \[s\].
const MEMORY_S: f64 = 20.0;

/// v_s: speed of a wheel's rim at which its friction is almost full \[m/s\].
const FULL_MPS: f64 = 0.05;

/// Smallest standard deviation of a sample \[m/s\].
const NOISE_LEAST_MPS: f64 = 1e-4;

/// Initial standard deviation of a sample \[m/s\].
const NOISE_FIRST_MPS: f64 = 0.01;

type Features = SVector<f64, FEATURES>;

#[derive(Debug, Clone, Copy)]
struct Axis {
    /// w.
    weights: Features,
    /// P.
    covariance: SMatrix<f64, FEATURES, FEATURES>,
    /// R \[(m/s)²\].
    noise: f64,
}

impl Axis {
    fn new() -> Self {
        Self { weights: Features::zeros(), covariance: prior(), noise: NOISE_FIRST_MPS.powi(2) }
    }

    /// Updates the weights with a sample; `kept` is ρ, `share` the weight of the sample in R.
    fn update(&mut self, features: &Features, target: f64, kept: f64, share: f64) {
        self.weights *= kept;
        self.covariance = self.covariance * kept.powi(2) + prior() * (1.0 - kept.powi(2));
        let error = target - features.dot(&self.weights);
        let direction = self.covariance * features;
        let along = features.dot(&direction);
        self.noise += share * ((error * error - along).max(0.0) - self.noise);
        self.noise = self.noise.max(NOISE_LEAST_MPS.powi(2));
        let gain = direction / (along + self.noise);
        self.weights += gain * error;
        self.covariance -= gain * direction.transpose();
    }
}

fn prior() -> SMatrix<f64, FEATURES, FEATURES> {
    SMatrix::from_diagonal(&Features::from(PRIOR.map(|deviation| deviation * deviation)))
}

/// Identified weights of one axis.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct FoundAxis {
    weights: [f64; FEATURES],
    covariance: [[f64; FEATURES]; FEATURES],
    noise: f64,
}

/// Identified weights of a drive. A later drive of the same robot can begin with them.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FoundPhysics {
    taken: u32,
    axes: [FoundAxis; AXES],
}

impl FoundPhysics {
    fn is_usable(&self) -> bool {
        self.axes.iter().all(|axis| {
            let numbers = axis.weights.iter().chain(axis.covariance.as_flattened());
            numbers.chain([&axis.noise]).all(|value| value.is_finite())
        })
    }
}

/// The weights of all axes. Does not allocate.
#[derive(Debug, Clone)]
pub struct Physics {
    main: MainModel,
    wheels: Wheels,
    /// Converts a yaw rate to a speed \[–, –, m\].
    scale: Velocity,
    axes: [Axis; AXES],
    /// ρ.
    kept: f64,
    taken: u32,
}

impl Physics {
    /// The prior, about `main`, for a robot with these wheels.
    pub fn new(main: &MainModel, wheels: &Wheels) -> Self {
        Self {
            main: *main,
            wheels: *wheels,
            scale: [1.0, 1.0, wheels.lever_m()],
            axes: [Axis::new(); AXES],
            kept: (-main.period / MEMORY_S).exp(),
            taken: 0,
        }
    }

    /// The same without forgetting: for the data of one robot that does not change.
    #[must_use]
    pub fn lasting(self) -> Self {
        Self { kept: 1.0, ..self }
    }

    /// The weights identified so far.
    pub fn found(&self) -> FoundPhysics {
        let axes = self.axes.map(|axis| FoundAxis {
            weights: axis.weights.into(),
            covariance: axis.covariance.into(),
            noise: axis.noise,
        });
        FoundPhysics { taken: self.taken, axes }
    }

    /// Continues from weights that were `found` with the same main model. Returns false, and
    /// changes nothing, if they are not finite.
    pub fn begin_with(&mut self, found: &FoundPhysics) -> bool {
        let is_usable = found.is_usable();
        if is_usable {
            for (axis, found) in self.axes.iter_mut().zip(&found.axes) {
                *axis = Axis {
                    weights: found.weights.into(),
                    covariance: found.covariance.into(),
                    noise: found.noise,
                };
            }
            self.taken = found.taken;
        }
        is_usable
    }

    /// Updates the weights with one period and its residual. Ignores numbers that are not finite.
    pub fn update(&mut self, at: &Moment, residual: &Velocity) {
        let features = self.features(at);
        if !features.iter().all(|of| of.iter().all(|value| value.is_finite()))
            || !residual.iter().all(|value| value.is_finite())
        {
            return;
        }
        self.taken = self.taken.saturating_add(1);
        let period = self.main.period;
        let share = (1.0 / f64::from(self.taken)).max(period / MEMORY_S).min(0.1);
        for axis in 0..AXES {
            let target = self.scale[axis] * residual[axis];
            self.axes[axis].update(&features[axis], target, self.kept, share);
        }
    }

    /// (1 − A) φ of each axis \[m/s\].
    fn features(&self, at: &Moment) -> [Features; AXES] {
        let v: Velocity = std::array::from_fn(|axis| self.scale[axis] * at.velocity[axis]);
        let slip: Velocity =
            std::array::from_fn(|axis| self.scale[axis] * at.input[axis] - v[axis]);
        let mut turning = self.wheels.speeds(at.velocity);
        for (speed, radius) in turning.iter_mut().zip(self.wheels.radii_m()) {
            *speed = (*speed * radius / FULL_MPS).tanh() / radius;
        }
        let friction = self.wheels.body(&turning);
        let rate = at.velocity[2];
        std::array::from_fn(|axis| {
            let one = 1.0 - self.main.decay[axis];
            let lag = -self.main.period / self.main.decay[axis].ln();
            let turning = match axis {
                0 => [rate * v[1], rate * v[2]],
                1 => [-rate * v[0], rate * v[2]],
                _ => [rate * v[0], rate * v[1]],
            };
            Features::from([
                slip[0],
                slip[1],
                slip[2],
                v[axis],
                1.0,
                self.scale[axis] * friction[axis],
                lag * turning[0],
                lag * turning[1],
                v[axis].abs() * v[axis],
            ]) * one
        })
    }
}

impl Residual for Physics {
    fn mean(&self, at: &Moment) -> Velocity {
        let features = self.features(at);
        std::array::from_fn(|axis| features[axis].dot(&self.axes[axis].weights) / self.scale[axis])
    }

    /// The Jacobians are those of the linear features.
    fn response(&self, at: &Moment) -> Response {
        let mut response = Response { mean: self.mean(at), ..Response::NONE };
        for axis in 0..AXES {
            let weights = self.axes[axis].weights * (1.0 - self.main.decay[axis]);
            for column in SLIP {
                let slope = weights[column] * self.scale[column] / self.scale[axis];
                response.by_input[axis][column] = slope;
                response.by_velocity[axis][column] = -slope;
            }
            response.by_velocity[axis][axis] += weights[SPEED];
        }
        response
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use robot::Robot;

    fn physics() -> Physics {
        let robot = Robot::example();
        Physics::new(&MainModel::new(&robot, 0.02), &robot.wheels)
    }

    /// A moment of a drive that excites every axis.
    fn moment(k: usize) -> Moment {
        let wave = |axis: usize, rate: f64| (rate * 0.02 * k as f64 + axis as f64).sin();
        let velocity: Velocity = std::array::from_fn(|axis| wave(axis, 1.0 + axis as f64));
        let input =
            std::array::from_fn(|axis| velocity[axis] + 0.3 * wave(axis, 5.0 + axis as f64));
        Moment { velocity, input, before: input, ..Moment::default() }
    }

    /// Root mean square of the prediction error of `physics` for `truth` in the periods `from` to
    /// `to`. It learns from the same periods.
    fn missed(
        physics: &mut Physics,
        (from, to): (usize, usize),
        truth: impl Fn(&Moment) -> Velocity,
    ) -> f64 {
        let mut squared = 0.0;
        for k in from..to {
            let (at, g) = (moment(k), truth(&moment(k)));
            let predicted = physics.mean(&at);
            squared += (0..AXES).map(|axis| (g[axis] - predicted[axis]).powi(2)).sum::<f64>();
            physics.update(&at, &g);
        }
        (squared / (to - from) as f64).sqrt()
    }

    /// Root mean square of `truth`.
    fn spread(truth: impl Fn(&Moment) -> Velocity) -> f64 {
        let squares = (0..1000).flat_map(|k| truth(&moment(k))).map(|value| value * value);
        (squares.sum::<f64>() / 1000.0).sqrt()
    }

    /// Residual of a robot that is 50 % heavier, with Coulomb friction, drag, and the turning
    /// frame.
    fn heavy(at: &Moment) -> Velocity {
        let [x, y, rate] = at.velocity;
        let drag = |v: f64| 0.1 * v.abs() * v;
        std::array::from_fn(|axis| {
            let slip = at.input[axis] - at.velocity[axis];
            let turning = [rate * y, -rate * x, 0.0][axis];
            let friction = 0.1 * (at.velocity[axis] / 0.02).tanh();
            0.05 * (-0.3 * slip - friction - drag(at.velocity[axis]) + 0.1 * turning)
        })
    }

    #[test]
    fn friction_drag_and_the_turning_frame_are_identified() {
        let mut physics = physics();
        let all = spread(heavy);
        missed(&mut physics, (0, 1000), heavy);
        let left = missed(&mut physics, (1000, 2000), heavy);
        assert!(left < 0.15 * all, "{left} m/s of {all} m/s");
    }

    #[test]
    fn weights_that_new_data_contradict_are_forgotten() {
        let lighter = |at: &Moment| heavy(at).map(|value| -value);
        let mut physics = physics();
        missed(&mut physics, (0, 2000), heavy);
        let first = missed(&mut physics, (2000, 2050), lighter);
        missed(&mut physics, (2050, 3000), lighter);
        let last = missed(&mut physics, (3000, 3100), lighter);
        assert!(last < 0.5 * first, "{first} m/s, {last} m/s");
    }

    #[test]
    fn a_later_drive_continues_from_the_weights_of_an_earlier_one() {
        let (mut earlier, mut later) = (physics(), physics());
        missed(&mut earlier, (0, 500), heavy);
        assert!(later.begin_with(&earlier.found()));
        for k in 500..510 {
            assert_eq!(later.mean(&moment(k)), earlier.mean(&moment(k)));
        }
        missed(&mut earlier, (500, 600), heavy);
        missed(&mut later, (500, 600), heavy);
        assert_eq!(later.found(), earlier.found());
        let mut of = earlier.found();
        of.axes[1].weights[2] = f64::NAN;
        assert!(!later.begin_with(&of));
        assert_eq!(later.found(), earlier.found());
    }

    #[test]
    fn numbers_that_are_not_finite_are_ignored() {
        let mut physics = physics();
        physics.update(&Moment { input: [f64::NAN; 3], ..moment(1) }, &[0.0; 3]);
        physics.update(&moment(1), &[f64::INFINITY; 3]);
        assert_eq!(physics.mean(&moment(1)), [0.0; 3]);
    }

    #[test]
    fn the_jacobians_are_the_slopes_of_the_linear_features() {
        let mut physics = physics();
        missed(&mut physics, (0, 500), |at| std::array::from_fn(|axis| 0.02 * at.input[axis]));
        let at = moment(700);
        let response = physics.response(&at);
        for axis in 0..AXES {
            let mut moved = at;
            moved.input[axis] += 1e-3;
            let slope = (physics.mean(&moved)[axis] - physics.mean(&at)[axis]) / 1e-3;
            assert!((slope - response.by_input[axis][axis]).abs() < 1e-6);
        }
    }
}
