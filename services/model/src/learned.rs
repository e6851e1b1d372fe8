//! The learned residual as the controller uses it: layout of the inputs, normalisation (eq. 36), posterior, and a physical bound.
//!
//! Predictions take the whole mean; linearisations only the slope of the kernel's linear part. The squared-exponential part is right where
//! there is data, but its slope is steep where old and new data disagree, and a plan that follows such a slope leads astray.

use crate::gp::normalisation::Normalisation;
use crate::gp::posterior::{Posterior, VarianceScratch};
use crate::{AXES, Velocity};
use serde::{Deserialize, Serialize};

/// Number of inputs of the Gaussian processes.
pub const INPUTS: usize = 6;

/// What the Gaussian processes see of a velocity and an input.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Layout {
    /// (v, u): the paper's.
    VelocityInput,
    /// (v, u − v): the slip between command and motion has an axis of its own, which suits a kernel with one length scale per axis.
    VelocitySlip,
}

impl Layout {
    /// Name in settings and fingerprints.
    pub const fn name(self) -> &'static str {
        match self {
            Self::VelocityInput => "velocity-input",
            Self::VelocitySlip => "velocity-slip",
        }
    }

    /// The inputs of the Gaussian processes, not normalised.
    pub fn inputs(self, velocity: &Velocity, input: &Velocity) -> [f64; INPUTS] {
        let [vx, vy, rate] = *velocity;
        let [ux, uy, turn] = *input;
        match self {
            Self::VelocityInput => [vx, vy, rate, ux, uy, turn],
            Self::VelocitySlip => [vx, vy, rate, ux - vx, uy - vy, turn - rate],
        }
    }
}

/// g with its Jacobians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Response {
    /// g \[m/s, m/s, rad/s\].
    pub mean: Velocity,
    /// ∂g/∂v, one row per axis of g.
    pub by_velocity: [Velocity; 3],
    /// ∂g/∂u, one row per axis of g.
    pub by_input: [Velocity; 3],
}

impl Response {
    /// No residual.
    pub const NONE: Self = Self { mean: [0.0; 3], by_velocity: [[0.0; 3]; 3], by_input: [[0.0; 3]; 3] };
}

/// A model of g that a prediction can use.
pub trait Residual: std::fmt::Debug {
    /// g at one velocity and input. Does not allocate.
    fn mean(&self, velocity: &Velocity, input: &Velocity) -> Velocity;

    /// g and its Jacobians. Does not allocate.
    fn response(&self, velocity: &Velocity, input: &Velocity) -> Response;
}

/// One learned model of g. Constant once made.
#[derive(Debug, Clone)]
pub struct Learned {
    /// What the processes see.
    pub layout: Layout,
    /// How it is scaled.
    pub normalisation: Normalisation<INPUTS>,
    /// Three Gaussian processes.
    pub posterior: Posterior<INPUTS>,
    /// Largest |g| that physics allows, per axis \[m/s, m/s, rad/s\].
    pub bound: Velocity,
}

impl Learned {
    /// Variance of g, without the noise of an observation \[(m/s)², (m/s)², (rad/s)²\]. O(n²), does not allocate.
    pub fn variance(&self, velocity: &Velocity, input: &Velocity, scratch: &mut VarianceScratch) -> Velocity {
        self.posterior.variance(&self.normalised(velocity, input), scratch)
    }

    fn normalised(&self, velocity: &Velocity, input: &Velocity) -> [f64; INPUTS] {
        self.normalisation.apply(&self.layout.inputs(velocity, input))
    }
}

impl Residual for Learned {
    /// O(n).
    fn mean(&self, velocity: &Velocity, input: &Velocity) -> Velocity {
        let mean = self.posterior.mean(&self.normalised(velocity, input));
        std::array::from_fn(|axis| mean[axis].clamp(-self.bound[axis], self.bound[axis]))
    }

    /// O(n). The Jacobians are those of the kernel's linear part alone; where the bound holds g, it does not vary.
    fn response(&self, velocity: &Velocity, input: &Velocity) -> Response {
        let mut response = Response { mean: self.mean(velocity, input), ..Response::NONE };
        let slope = self.posterior.slope();
        for axis in (0..AXES).filter(|&axis| response.mean[axis].abs() < self.bound[axis]) {
            for column in 0..AXES {
                let by_first = slope[axis][column] / self.normalisation.scale[column];
                let by_second = slope[axis][column + AXES] / self.normalisation.scale[column + AXES];
                response.by_input[axis][column] = by_second;
                response.by_velocity[axis][column] = match self.layout {
                    Layout::VelocityInput => by_first,
                    Layout::VelocitySlip => by_first - by_second,
                };
            }
        }
        response
    }
}
