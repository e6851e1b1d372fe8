//! The residual g: what was measured minus what the main model said of the input that acted (eqs. 27–29).
//!
//! Eq. 28 of the paper subtracts A x + B K x^f, whose sign contradicts its own u = −K x^f (eq. 23); here the input is the one
//! that was applied, whoever chose it.

use crate::Velocity;
use crate::main_model::MainModel;
use robot::Robot;

/// Largest believable share of its physical range that the main model can be wrong by in one period.
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

/// Largest |g| that is believable of `robot`, per axis and period \[m/s, m/s, rad/s\].
pub fn bound(model: &MainModel, robot: &Robot) -> Velocity {
    let limits = &robot.limits;
    let range = [limits.input_mps, limits.input_mps, limits.yaw_input_radps];
    std::array::from_fn(|axis| SHARE * model.gain[axis] * range[axis])
}
