//! The residual g: the measured velocity minus that of the main model for the input that acted
//! (eqs. 27–29).
//!
//! Eq. 28 of the paper subtracts A x + B K x^f. Its sign contradicts the paper's own u = −K x^f
//! (eq. 23). Here the input is the one that was applied, independent of its source.

use crate::Velocity;
use crate::main_model::MainModel;
use robot::Robot;

/// Largest plausible error of the main model in one period, as a share of its physical range.
const SHARE: f64 = 0.25;

/// g = v⁺ − (A v + B u) \[m/s, m/s, rad/s\], per period.
pub fn residual(
    model: &MainModel,
    before: &Velocity,
    input: &Velocity,
    after: &Velocity,
) -> Velocity {
    let expected = model.next_velocity(before, input);
    std::array::from_fn(|axis| after[axis] - expected[axis])
}

/// Largest plausible |g| of `robot`, per axis and period \[m/s, m/s, rad/s\].
pub fn bound(model: &MainModel, robot: &Robot) -> Velocity {
    let limits = &robot.limits;
    let range = [limits.input_mps, limits.input_mps, limits.yaw_input_radps];
    std::array::from_fn(|axis| SHARE * model.gain[axis] * range[axis])
}
