//! The robot's own dynamics in place of f + g, for the oracle of a comparison. The oracle knows
//! everything but the future.
//!
//! Jacobians are finite differences. One symmetry is exact: a displacement of the start displaces
//! the end by as much. A different floor a little further on changes the prediction, not its slope.
//!
//! ```text
//! ∂x⁺/∂p = (1, 0)      ∂x⁺/∂z ≈ (F(z + h) − F(z − h)) / 2h   for z = θ, v, u
//! ```

use crate::delay::Acting;
use crate::linearise::{Linearised, displacement, of_input};
use crate::predict::Belief;
use crate::{AXES, State, Velocity};
use nalgebra::{Matrix3, SMatrix, Vector3};

/// h \[rad, m/s, rad/s\].
const STEP: f64 = 1e-3;

/// A model that knows what the robot and its world will do.
pub trait Foresight: std::fmt::Debug + Send {
    /// Copies the state of the world at the beginning of `tick`.
    fn look(&mut self, tick: u64);

    /// The state one period after `state` under `input`. Its heading continues that of `state`,
    /// without a jump of 2π.
    fn predict(&self, state: &State, input: &Velocity) -> State;
}

/// The foreseen state, moved by the disturbance in `belief`. The disturbance covers what the
/// foresight does not know, such as a random force.
pub(crate) fn advance(
    belief: &Belief<'_>,
    foresight: &dyn Foresight,
    state: &State,
    acting: &Acting,
) -> State {
    let Acting { input, drift } = acting;
    let mut next = foresight.predict(state, input);
    let (main, disturbance) = (belief.main, &belief.disturbance);
    let [forward, left, turn]: Velocity = std::array::from_fn(|axis| {
        main.period * (main.end_share[axis] * disturbance[axis] + drift[axis])
    });
    let (sin, cos) = (0.5 * (state.pose[2] + next.pose[2])).sin_cos();
    next.pose = [
        next.pose[0] + cos * forward - sin * left,
        next.pose[1] + sin * forward + cos * left,
        next.pose[2] + turn,
    ];
    next.velocity = std::array::from_fn(|axis| next.velocity[axis] + disturbance[axis]);
    next.acted = *input;
    next
}

/// v⁺, and how each axis of it varies with its own input. 7 predictions.
pub(crate) fn velocity_and_gain(
    belief: &Belief<'_>,
    foresight: &dyn Foresight,
    state: &State,
    input: &Velocity,
) -> (Velocity, Velocity) {
    let gain = std::array::from_fn(|axis| {
        let acting = |by| Acting::from(&moved(input, axis, by));
        slope(|by| advance(belief, foresight, state, &acting(by)))[axis + AXES]
    });
    (advance(belief, foresight, state, &Acting::from(input)).velocity, gain)
}

/// Predicts one step and differentiates it. 15 predictions; does not allocate.
pub(crate) fn linearise(
    belief: &Belief<'_>,
    foresight: &dyn Foresight,
    state: &State,
    acting: &Acting,
) -> Linearised {
    let mut by_state = SMatrix::<f64, 6, 6>::identity();
    let turned = |by: f64| State { pose: moved(&state.pose, 2, by), ..*state };
    by_state
        .column_mut(2)
        .copy_from_slice(&slope(|by| advance(belief, foresight, &turned(by), acting)));
    let mut by_input = SMatrix::<f64, 6, 3>::zeros();
    for axis in 0..AXES {
        let faster = |by: f64| State { velocity: moved(&state.velocity, axis, by), ..*state };
        by_state
            .column_mut(axis + AXES)
            .copy_from_slice(&slope(|by| advance(belief, foresight, &faster(by), acting)));
        by_input.column_mut(axis).copy_from_slice(&slope(|by| {
            let input = moved(&acting.input, axis, by);
            advance(belief, foresight, state, &Acting { input, ..*acting })
        }));
    }
    let next = advance(belief, foresight, state, acting);
    let main = belief.main;
    let mean = main.mean_velocity(&state.velocity, &next.velocity);
    let (pose_by_mean, _) = displacement(main.period, state, &mean);
    let share = |of: &Velocity| pose_by_mean * Matrix3::from_diagonal(&Vector3::from(*of));
    Linearised {
        next,
        by_state,
        by_input,
        by_acted: SMatrix::zeros(),
        by_difference: of_input(&share(&belief.split.drift), &Matrix3::zeros()),
        by_residual: of_input(&share(&main.end_share), &Matrix3::identity()),
    }
}

/// Central difference of a state at 0.
fn slope(of: impl Fn(f64) -> State) -> [f64; 2 * AXES] {
    let (ahead, behind) = (of(STEP).to_array(), of(-STEP).to_array());
    std::array::from_fn(|row| (ahead[row] - behind[row]) / (2.0 * STEP))
}

fn moved(values: &[f64; AXES], at: usize, by: f64) -> [f64; AXES] {
    std::array::from_fn(|axis| if axis == at { values[axis] + by } else { values[axis] })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::linearise::linearise;
    use crate::main_model::MainModel;
    use robot::Robot;

    /// Predicts with the main model.
    #[derive(Debug)]
    struct Believer(MainModel);

    impl Foresight for Believer {
        fn look(&mut self, _tick: u64) {}

        fn predict(&self, state: &State, input: &Velocity) -> State {
            Belief::of(&self.0).predict(state, input)
        }
    }

    #[test]
    fn foresight_of_the_main_model_predicts_like_the_main_model() {
        let main = MainModel::new(&Robot::example(), 0.1);
        let believer = Believer(main);
        let (state, input) = (
            State { pose: [0.3, -0.2, 0.7], velocity: [1.2, -0.4, 0.3], ..State::default() },
            [1.0, 0.5, -0.6],
        );
        for (disturbance, tolerance) in [([0.0; 3], 1e-9), ([0.01, -0.02, 0.03], 1e-3)] {
            let belief = Belief { disturbance, ..Belief::of(&main) };
            let foreseen = Belief { foresight: Some(&believer), ..belief };
            let (believed, ours) =
                (linearise(&belief, &state, &input), linearise(&foreseen, &state, &input));
            for (a, b) in believed.next.to_array().iter().zip(ours.next.to_array()) {
                assert!((a - b).abs() < tolerance, "{a} is not {b}");
            }
            assert!((believed.by_state - ours.by_state).amax() < 1e-5 + tolerance);
            assert!((believed.by_input - ours.by_input).amax() < 1e-5 + tolerance);
            for (a, b) in foreseen.residual(&state, &input).iter().zip([0.0; 3]) {
                assert!((a - b).abs() < 1e-12, "the observer's part is not the model's");
            }
        }
    }
}
