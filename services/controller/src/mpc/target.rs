//! Target calculation: the input that would hold the reference under the whole belief. Because of
//! this, the weight on the input's distance from it causes no offset.
//!
//! A steady-state target: v = A v + B t + g(v, t) + d for the reference velocity v, seen from the
//! predicted heading. It has no spike where the reference has a corner, unlike an inversion of the
//! dynamics.

use super::Formulation;
use crate::reference::ReferencePoint;
use model::predict::Belief;
use model::{State, Velocity};

/// The reference's velocity as a body velocity of a robot with heading `yaw`.
pub(super) fn velocity_to_hold(point: &ReferencePoint, yaw: f64) -> Velocity {
    let (sin, cos) = (point.pose[2] - yaw).sin_cos();
    let [forward, left, rate] = point.velocity;
    [cos * forward - sin * left, sin * forward + cos * left, rate]
}

/// The input target for the reference at its `point`. It is either the holding input, one Newton
/// step better than `before`, or the reference velocity itself. Does not allocate.
pub(super) fn of(
    formulation: Formulation,
    belief: &Belief<'_>,
    point: &ReferencePoint,
    expected: &State,
    before: &Velocity,
) -> Velocity {
    match formulation {
        Formulation::Holding => {
            let held = State { velocity: velocity_to_hold(point, expected.pose[2]), ..*expected };
            improve(belief, &held, before)
        }
        Formulation::Plain => point.velocity,
    }
}

/// One Newton step per axis from `before` towards the input that holds the velocity of `held`. Does
/// not allocate.
fn improve(belief: &Belief<'_>, held: &State, before: &Velocity) -> Velocity {
    let (main, velocity) = (belief.main, &held.velocity);
    let guess = if before.iter().all(|&value| value == 0.0) {
        main.holding_input(velocity, &belief.disturbance)
    } else {
        *before
    };
    let (next, gain) = belief.velocity_and_gain(held, &guess);
    std::array::from_fn(|axis| {
        // A learned gain that nearly cancels the main model's gain is too small to divide by.
        guess[axis] + (velocity[axis] - next[axis]) / gain[axis].max(0.3 * main.gain[axis])
    })
}
