//! The residual g: what was measured minus what the main model said of the input that the wheels really got (eqs. 27–29).
//!
//! Eq. 28 of the paper subtracts A x + B K x^f, whose sign contradicts its own u = −K x^f (eq. 23); here the input is the one
//! that was applied, whoever chose it.

use crate::Velocity;
use crate::main_model::MainModel;

/// g = v⁺ − (A v + B u) \[m/s, m/s, rad/s\], per period.
pub fn residual(model: &MainModel, before: &Velocity, input: &Velocity, after: &Velocity) -> Velocity {
    let expected = model.next_velocity(before, input);
    std::array::from_fn(|axis| after[axis] - expected[axis])
}
