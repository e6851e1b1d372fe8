//! The Jacobians of one predicted step, with those of the learned model.
//!
//! With W = e ∂v⁺/∂· + (1 − e) ∂v/∂· for the mean velocity v̄, and θ' = θ + T ω̄/2 for the mid-step
//! heading:
//!
//! ```text
//! ∂v⁺/∂v = A + ∂g/∂v          ∂p⁺/∂· = T R(θ') W_xy + T R'(θ') v̄ ∂θ'/∂·
//! ∂v⁺/∂u = B + ∂g/∂u          ∂θ⁺/∂· = ∂θ/∂· + T W_ω
//! ∂v⁺/∂u₋ = ∂g/∂u₋
//! ```
//! The difference of two commands that replace each other within the period moves the pose alone:
//! there W is the drift per difference ([`crate::delay`]), and ∂v⁺ = 0.
//!
//! A main model with a [`Motion`] of its own has the pose Jacobians of that motion.

use crate::delay::Acting;
use crate::foresight;
use crate::learned::Moment;
use crate::main_model::Motion;
use crate::predict::{Belief, add, advance};
use crate::{State, Velocity};
use nalgebra::{Matrix3, RowVector3, SMatrix, Vector3};

/// A predicted step and how it varies. Rows and columns: x, y, yaw, forward, left, yaw rate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Linearised {
    /// The predicted state.
    pub next: State,
    /// ∂x⁺/∂x.
    pub by_state: SMatrix<f64, 6, 6>,
    /// ∂x⁺/∂u.
    pub by_input: SMatrix<f64, 6, 3>,
    /// ∂x⁺/∂u₋, of the input that acted in the period before.
    pub by_acted: SMatrix<f64, 6, 3>,
    /// ∂x⁺ per difference of the command before and the new one, of which each acts in a part of
    /// the period. u stays the same.
    pub by_difference: SMatrix<f64, 6, 3>,
    /// ∂x⁺/∂g: how a residual of the step moves its end.
    pub by_residual: SMatrix<f64, 6, 3>,
}

/// Predicts one step and differentiates it. Does not allocate.
pub fn linearise(belief: &Belief<'_>, state: &State, acting: impl Into<Acting>) -> Linearised {
    let acting = acting.into();
    if let Some(foresight) = belief.foresight {
        return foresight::linearise(belief, foresight, state, &acting);
    }
    let input = &acting.input;
    let response = belief.response(&Moment::new(state, input));
    let next = advance(belief, state, &acting, &response.mean);

    let velocity_by_velocity = Matrix3::from_fn(|row, column| {
        response.by_velocity[row][column] + if row == column { belief.main.decay[row] } else { 0.0 }
    });
    let velocity_by_input = Matrix3::from_fn(|row, column| {
        response.by_input[row][column] + if row == column { belief.main.gain[row] } else { 0.0 }
    });
    let velocity_by_acted = Matrix3::from_fn(|row, column| response.by_before[row][column]);
    if let Motion::RungeKutta(nodes) = &belief.main.motion {
        let moved = nodes.displace(state, input);
        return Linearised {
            next,
            by_state: of_state(&moved.by_heading, &moved.by_velocity, &velocity_by_velocity),
            by_input: of_input(&moved.by_input, &velocity_by_input),
            by_acted: of_input(&Matrix3::zeros(), &velocity_by_acted),
            by_difference: SMatrix::zeros(),
            by_residual: of_input(&Matrix3::zeros(), &Matrix3::identity()),
        };
    }
    let mean = add(&belief.main.mean_velocity(&state.velocity, &next.velocity), &acting.drift);
    let share = Matrix3::from_diagonal(&Vector3::from(belief.main.end_share));
    let mean_by_velocity = Matrix3::identity() - share + share * velocity_by_velocity;
    let (pose_by_mean, by_heading) = displacement(belief.main.period, state, &mean);
    let drift = Matrix3::from_diagonal(&Vector3::from(belief.split.drift));
    let driven = |velocity: &Matrix3<f64>| of_input(&(pose_by_mean * (share * velocity)), velocity);
    Linearised {
        next,
        by_state: of_state(&by_heading, &(pose_by_mean * mean_by_velocity), &velocity_by_velocity),
        by_input: driven(&velocity_by_input),
        by_acted: driven(&velocity_by_acted),
        by_difference: of_input(&(pose_by_mean * drift), &Matrix3::zeros()),
        by_residual: driven(&Matrix3::identity()),
    }
}

/// ∂x⁺/∂x of its blocks; the pose goes on from where it was.
fn of_state(
    pose_by_heading: &Vector3<f64>,
    pose_by_velocity: &Matrix3<f64>,
    velocity_by_velocity: &Matrix3<f64>,
) -> SMatrix<f64, 6, 6> {
    let mut by_state = SMatrix::<f64, 6, 6>::identity();
    let mut heading_column = by_state.fixed_view_mut::<3, 1>(0, 2);
    heading_column += pose_by_heading;
    by_state.fixed_view_mut::<3, 3>(0, 3).copy_from(pose_by_velocity);
    by_state.fixed_view_mut::<3, 3>(3, 3).copy_from(velocity_by_velocity);
    by_state
}

/// ∂x⁺ by an input, of its blocks.
pub(crate) fn of_input(pose: &Matrix3<f64>, velocity: &Matrix3<f64>) -> SMatrix<f64, 6, 3> {
    let mut by = SMatrix::<f64, 6, 3>::zeros();
    by.fixed_view_mut::<3, 3>(0, 0).copy_from(pose);
    by.fixed_view_mut::<3, 3>(3, 0).copy_from(velocity);
    by
}

/// World displacement and turn per mean velocity, row by row, and the same per mid-step heading.
pub(crate) fn displacement(
    period: f64,
    state: &State,
    mean: &Velocity,
) -> (Matrix3<f64>, Vector3<f64>) {
    let (sin, cos) = (state.pose[2] + 0.5 * period * mean[2]).sin_cos();
    let turned = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0) * period;
    let by_heading =
        Vector3::new(-sin * mean[0] - cos * mean[1], cos * mean[0] - sin * mean[1], 0.0) * period;
    (turned + by_heading * RowVector3::new(0.0, 0.0, 0.5 * period), by_heading)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::delay::Delay;
    use crate::gp::hyperparameters::Hyperparameters;
    use crate::gp::normalisation::Normalisation;
    use crate::gp::posterior::{Posterior, PosteriorError};
    use crate::learned::{
        INPUTS, INPUTS_WITH_HEADING, INPUTS_WITH_HISTORY, INPUTS_WITH_PLACE, Layout, Learned,
        Residual,
    };
    use crate::main_model::MainModel;
    use proptest::prelude::*;
    use robot::Robot;

    /// A learned model of some residual, in any layout. It is almost linear, because only the
    /// linear part is differentiated.
    fn learned<const D: usize>(layout: Layout) -> Result<Learned<D>, PosteriorError> {
        let repeated = |values: [f64; INPUTS]| std::array::from_fn(|i| values[i % INPUTS]);
        let normalisation = Normalisation {
            mean: repeated([0.5, 0.0, 0.0, 0.1, 0.0, 0.0]),
            scale: repeated([2.0, 1.0, 1.5, 1.0, 0.5, 2.0]),
        };
        let wave = |i: usize, k: f64| (1.7 * k * i as f64).sin() * 2.0;
        let three = |i: usize, [a, b, c]: [f64; 3]| [wave(i, a), wave(i, b), wave(i, c)];
        let moment = |i: usize| Moment {
            velocity: three(i, [1.0, 1.3, 0.7]),
            input: three(i, [0.3, 1.9, 2.3]),
            before: three(i, [0.9, 1.1, 0.2]),
            heading: wave(i, 0.4),
            position: [wave(i, 0.6), wave(i, 0.8)],
        };
        let inputs: Vec<[f64; D]> =
            (0..40).map(|i| normalisation.apply(&layout.inputs(&moment(i)))).collect();
        let target = |Moment { velocity: v, input: u, before, heading, .. }| {
            [
                0.1 * v[0].tanh() + 0.05 * before[0] + 0.02 * heading.cos(),
                0.05 * v[1] * u[2],
                0.1 * (u[0] - v[0]).sin() - 0.07 * before[2],
            ]
        };
        let targets: Vec<[f64; 3]> = (0..40).map(|i| target(moment(i))).collect();
        let posterior = Posterior::new(
            &inputs,
            &targets,
            &[Hyperparameters::new([1.5; D], 1e-18, 1e-4).with_linear(0.04); 3],
        )?;
        Ok(Learned { layout, normalisation, posterior, bound: [1.0; 3], sample_variance: [0.0; 3] })
    }

    proptest! {
        #[test]
        fn jacobians_match_finite_differences(
            pose in prop::array::uniform3(-3.0..3.0), velocity in prop::array::uniform3(-2.0..2.0),
            input in prop::array::uniform3(-2.0..2.0),
            acted in prop::array::uniform3(-2.0..2.0),
            command_before in prop::array::uniform3(-2.0..2.0),
            dead_time in prop_oneof![Just(0.0), 0.0..1.0],
            layout in 0..5_usize,
            lagging in any::<bool>()
        ) {
            let main = if lagging {
                MainModel::lagging(&[0.25, 0.3, 0.2], 0.1)
            } else {
                MainModel::new(&Robot::example(), 0.1)
            };
            let input_alone = learned::<INPUTS>(Layout::VelocityInput);
            let slip = learned::<INPUTS>(Layout::VelocitySlip);
            let history = learned::<INPUTS_WITH_HISTORY>(Layout::VelocitySlipHistory);
            let heading = learned::<INPUTS_WITH_HEADING>(Layout::VelocitySlipHeading);
            let place = learned::<INPUTS_WITH_PLACE>(Layout::VelocitySlipPlace);
            let (Ok(input_alone), Ok(slip), Ok(history), Ok(heading), Ok(place)) =
                (input_alone, slip, history, heading, place)
            else {
                return Err(TestCaseError::fail("no posterior"));
            };
            let learned: &dyn Residual =
                [&input_alone as &dyn Residual, &slip, &history, &heading, &place][layout];
            let belief = Belief {
                learned: Some(learned),
                disturbance: [0.01, -0.02, 0.03],
                split: Delay::of_periods(dead_time, &main).split(),
                ..Belief::of(&main)
            };
            let drift = |difference: [f64; 3]| -> [f64; 3] {
                std::array::from_fn(|axis| belief.split.drift[axis] * difference[axis])
            };
            let at = |x: [f64; 6], [input, acted, difference]: [[f64; 3]; 3]| {
                let pose = [x[0], x[1], x[2]];
                let velocity = [x[3], x[4], x[5]];
                let acting = Acting { input, drift: drift(difference) };
                belief.predict(&State { pose, velocity, acted }, acting).to_array()
            };
            let acting = Acting { input, drift: drift(command_before) };
            let state = State { pose, velocity, acted };
            let exact = linearise(&belief, &state, acting);
            prop_assert_eq!(exact.next, belief.predict(&state, acting));
            let step = 1e-5;
            for axis in 0..3 {
                let pushed = |by: f64| {
                    let disturbance = std::array::from_fn(|other| {
                        belief.disturbance[other] + if other == axis { by } else { 0.0 }
                    });
                    Belief { disturbance, ..belief }.predict(&state, acting).to_array()
                };
                let (ahead, behind) = (pushed(step), pushed(-step));
                for row in 0..6 {
                    let numeric = (ahead[row] - behind[row]) / (2.0 * step);
                    prop_assert!((numeric - exact.by_residual[(row, axis)]).abs() < 1e-8);
                }
            }
            // The heading has no Jacobian in the last two layouts, the position in the last one.
            let is_without =
                |column| layout == 4 && column < 3 || layout == 3 && column == 2;
            for column in (0..15).filter(|&column| !is_without(column)) {
                let moved = |by: f64| {
                    let (mut x, mut u) = (state.to_array(), [input, acted, command_before]);
                    if column < 6 { x[column] += by } else { u[column / 3 - 2][column % 3] += by }
                    at(x, u)
                };
                let (ahead, behind) = (moved(step), moved(-step));
                for row in 0..6 {
                    let numeric = (ahead[row] - behind[row]) / (2.0 * step);
                    let analytic = match column {
                        0..6 => exact.by_state[(row, column)],
                        6..9 => exact.by_input[(row, column - 6)],
                        9..12 => exact.by_acted[(row, column - 9)],
                        _ => exact.by_difference[(row, column - 12)],
                    };
                    prop_assert!(
                        (numeric - analytic).abs() < 1e-8,
                        "row {row} column {column}: {analytic} is not {numeric}"
                    );
                }
            }
        }
    }
}
