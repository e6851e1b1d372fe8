//! One step of the whole model: f + g + d for the velocity, and the pose that follows from it.
//!
//! ```text
//! v⁺ = A v + B u + g(v, u) + d
//! v̄ = (1 − e) v + e v⁺ + drift
//! θ⁺ = θ + T ω̄
//! p⁺ = p + T R(θ + T ω̄/2) v̄
//! ```
//! This is the mean velocity of the period at its mid-step heading, with e of the main model, and
//! the drift of an input that changes within it ([`crate::delay`]). A main model with a [`Motion`]
//! of its own moves the pose by that instead. Section 4.1 of the paper iterates the main model
//! alone and adds g afterwards. Here g is fed back into the prediction, as in the paper's eq. 32.

use crate::delay::{Acting, Split};
use crate::foresight::{self, Foresight};
use crate::learned::{Moment, Residual, Response};
use crate::main_model::{MainModel, Motion};
use crate::residual::residual;
use crate::{AXES, State, Velocity};

/// The model of one tick: main model, learned residual if there is one, and disturbance.
#[derive(Debug, Clone, Copy)]
pub struct Belief<'a> {
    /// f.
    pub main: &'a MainModel,
    /// g.
    pub learned: Option<&'a dyn Residual>,
    /// Prediction that replaces f + g, for the oracle.
    pub foresight: Option<&'a dyn Foresight>,
    /// d, per period \[m/s, m/s, rad/s\].
    pub disturbance: Velocity,
    /// The effect of a dead time that ends within a period.
    pub split: Split,
}

impl<'a> Belief<'a> {
    /// The main model alone.
    pub fn of(main: &'a MainModel) -> Self {
        Self {
            main,
            learned: None,
            foresight: None,
            disturbance: [0.0; AXES],
            split: Split::default(),
        }
    }
}

impl Belief<'_> {
    /// g from one state under one input, without d.
    pub fn residual(&self, state: &State, input: &Velocity) -> Velocity {
        match self.foresight {
            Some(foresight) => residual(
                self.main,
                &state.velocity,
                input,
                &foresight.predict(state, input).velocity,
            ),
            None => {
                self.learned.map_or([0.0; AXES], |learned| learned.mean(&Moment::new(state, input)))
            }
        }
    }

    /// v⁺ of an input that has acted for long, and the slope of each axis by its own input. Does
    /// not allocate.
    pub fn velocity_and_gain(&self, state: &State, input: &Velocity) -> (Velocity, Velocity) {
        if let Some(foresight) = self.foresight {
            return foresight::velocity_and_gain(self, foresight, state, input);
        }
        let response = self.response(&Moment { before: *input, ..Moment::new(state, input) });
        let expected = self.main.next_velocity(&state.velocity, input);
        let velocity = std::array::from_fn(|axis| {
            expected[axis] + response.mean[axis] + self.disturbance[axis]
        });
        (
            velocity,
            std::array::from_fn(|axis| {
                self.main.gain[axis]
                    + response.by_input[axis][axis]
                    + response.by_before[axis][axis]
            }),
        )
    }

    /// The learned g with its Jacobians.
    pub(crate) fn response(&self, at: &Moment) -> Response {
        self.learned.map_or(Response::NONE, |learned| learned.response(at))
    }

    /// What acts when `input` is commanded after `before`.
    pub fn acting(&self, before: &Velocity, input: &Velocity) -> Acting {
        self.split.acting(before, input)
    }

    /// The state one period later, under the input that acts. Does not allocate.
    pub fn predict(&self, state: &State, acting: impl Into<Acting>) -> State {
        let acting = acting.into();
        match self.foresight {
            Some(foresight) => foresight::advance(self, foresight, state, &acting),
            None => advance(self, state, &acting, &self.residual(state, &acting.input)),
        }
    }
}

/// The state one period later, for a known residual.
pub(crate) fn advance(
    belief: &Belief<'_>,
    state: &State,
    acting: &Acting,
    residual: &Velocity,
) -> State {
    let Acting { input, drift } = acting;
    let expected = belief.main.next_velocity(&state.velocity, input);
    let velocity: Velocity =
        std::array::from_fn(|axis| expected[axis] + residual[axis] + belief.disturbance[axis]);
    if let Motion::RungeKutta(nodes) = &belief.main.motion {
        return State { pose: nodes.displace(state, input).pose, velocity, acted: *input };
    }
    let mean = add(&belief.main.mean_velocity(&state.velocity, &velocity), drift);
    let period = belief.main.period;
    let [x, y, yaw] = state.pose;
    let (sin, cos) = (yaw + 0.5 * period * mean[2]).sin_cos();
    let pose = [
        x + period * (cos * mean[0] - sin * mean[1]),
        y + period * (sin * mean[0] + cos * mean[1]),
        yaw + period * mean[2],
    ];
    State { pose, velocity, acted: *input }
}

/// Sum of two velocities.
pub(crate) fn add(a: &Velocity, b: &Velocity) -> Velocity {
    std::array::from_fn(|axis| a[axis] + b[axis])
}
