//! The other real-time iteration: it linearises about the plan itself, so that all work but the
//! last step is done before the state arrives.
//!
//! ```text
//! before    shift ─ linearise along the plan ─ write the program ─ factorise
//! state ▶   surprise ─ gradient and bounds ─ solve ─ ▶ command
//! ```
//! The plan's states need not follow from each other under its inputs. The gap between two of them,
//! c, is closed to first order,
//!
//! ```text
//! x̄_0 = x_0      x̄_{k+1} = f(x_k, u_k) + A_k (x̄_k − x_k)
//! ```
//! and the program is written about x̄. When the state s_0 arrives, the deviation moves the
//! program, again to first order:
//!
//! ```text
//! δ_0 = s_0 − x̄_0      δ_{k+1} = A_k δ_k + (∂x⁺/∂g)_k δd  (+ C_0 δa₋₁ for k = 0)
//! ```
//!
//! Reference: Diehl, Bock & Schlöder, *A real-time iteration scheme for nonlinear optimization in
//! optimal feedback control*, 2005.

use super::iteration::move_by;
use super::qp::{STATE, WIDTH};
use super::solver::Turn;
use super::{Mpc, ReferencePoint, Solved, Spent, Status};
use crate::settings::Linearise;
use model::delay::Split;
use model::linearise::linearise;
use model::predict::Belief;
use model::{State, Velocity};
use nalgebra::SVector;
use protocol::clock::monotonic_nanos;
use std::f64::consts::PI;

/// The conditions for which the prepared program was written.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expectation {
    state: State,
    last_input: Velocity,
    disturbance: Velocity,
    split: Split,
    spent: Spent,
}

impl Expectation {
    /// Whether only quantities that enter the program linearly have changed; else the program must
    /// be written again.
    fn covers(&self, state: &State, last_input: &Velocity, belief: &Belief<'_>) -> bool {
        let turned = state.pose[2] - self.state.pose[2];
        self.last_input == *last_input && self.split == belief.split && turned.abs() < PI
    }
}

impl Mpc {
    /// Initialises the plan on the reference. `reference` begins at the next tick.
    pub fn begin_on(&mut self, reference: &[ReferencePoint]) {
        self.reset();
        let points = reference.iter().map(|point| State {
            pose: point.pose,
            velocity: point.velocity,
            ..State::default()
        });
        // The next shift moves them to their places.
        for (slot, point) in self
            .stages
            .iter_mut()
            .map(|stage| &mut stage.state)
            .skip(1)
            .chain([&mut self.terminal])
            .zip(points)
        {
            *slot = point;
        }
        self.planned = true;
    }

    /// With [`Linearise::Expected`]: does all work of the next iteration that does not need the
    /// state. Called after [`prepare`](Self::prepare), with the belief that holds from now on. If
    /// anything but the disturbance changes before the state arrives, the result must be
    /// [dropped](Self::forget_expectation). Does not allocate.
    pub fn expect(
        &mut self,
        last_input: &Velocity,
        reference: &[ReferencePoint],
        belief: &Belief<'_>,
    ) {
        self.expectation = None;
        if self.linearise == Linearise::Measured || !self.planned || belief.foresight.is_some() {
            return;
        }
        let begin = monotonic_nanos();
        self.follow_plan(last_input, belief);
        if !self.predictable() {
            return;
        }
        self.program.set_dynamics(&self.steps, &belief.split);
        self.close_gaps();
        self.propagate_variance(reference, belief);
        let linearised = monotonic_nanos();
        self.build(last_input, reference);
        self.solver.prepare(&self.program);
        self.expectation = self.stages.first().map(|stage| Expectation {
            state: stage.state,
            last_input: *last_input,
            disturbance: belief.disturbance,
            split: belief.split,
            spent: Spent {
                linearise_nanos: linearised - begin,
                solve_nanos: monotonic_nanos() - linearised,
            },
        });
    }

    /// The next answer is computed from the measured state alone.
    pub fn forget_expectation(&mut self) {
        self.expectation = None;
    }

    /// Solves the prepared program, which stays valid. Returns false if there is none.
    pub(super) fn rehearse_expected(&mut self) -> bool {
        if self.expectation.is_some() {
            let _answer = self.solver.finish(&self.program, &mut self.solution, &Turn::default());
        }
        self.expectation.is_some()
    }

    /// Computes the plan from the state, if the prepared program covers it.
    pub(super) fn iterate_expected(
        &mut self,
        state: &State,
        last_input: &Velocity,
        belief: &Belief<'_>,
    ) -> Option<Solved> {
        let begin = monotonic_nanos();
        let expected = self
            .expectation
            .take()
            .filter(|expected| expected.covers(state, last_input, belief))?;
        self.surprise(&expected, state, &belief.disturbance);
        self.correct_targets(belief);
        let mut outcome = self.solver.finish(&self.program, &mut self.solution, &self.turn);
        self.take(&mut outcome);
        if !self.predictable() {
            self.reset();
            outcome.status = Status::Unpredictable;
        }
        let since = Spent { linearise_nanos: 0, solve_nanos: monotonic_nanos() - begin };
        Some(Solved { outcome, ahead: expected.spent, since })
    }

    /// Moves the plan's states, and the program with them, by the deviation from the expected
    /// state.
    fn surprise(&mut self, expected: &Expectation, state: &State, disturbance: &Velocity) {
        let less =
            |a: &Velocity, b: &Velocity| SVector::<f64, 3>::from_fn(|axis, _| a[axis] - b[axis]);
        let (acted, disturbance) =
            (less(&state.acted, &expected.state.acted), less(disturbance, &expected.disturbance));
        let mut moved = SVector::<f64, STATE>::from(state.to_array())
            - SVector::from(expected.state.to_array());
        let mut dynamics = self.steps.iter();
        let states =
            self.stages.iter_mut().map(|stage| &mut stage.state).chain([&mut self.terminal]);
        for (k, (slot, state)) in self.moves.iter_mut().zip(states).enumerate() {
            *slot = [0.0; WIDTH];
            slot[..STATE].copy_from_slice(moved.as_slice());
            move_by(state, slot);
            let Some(step) = dynamics.next() else { break };
            moved = step.by_state * moved + step.by_residual * disturbance;
            if k == 0 {
                moved += step.by_acted * acted;
            }
        }
        self.program.displace(&self.moves);
        self.limits.displace(&self.moves, &mut self.program);
    }

    /// Inputs of the present plan, and the Jacobians along its states.
    fn follow_plan(&mut self, last_input: &Velocity, belief: &Belief<'_>) {
        let (mut before, mut acted) = (*last_input, None);
        for k in 0..self.horizon {
            self.settle_input(k, belief);
            let (Some(stage), Some(step)) = (self.stages.get_mut(k), self.steps.get_mut(k)) else {
                return;
            };
            stage.state.acted = acted.unwrap_or(stage.state.acted);
            let acting = belief.acting(&before, &stage.input);
            *step = linearise(belief, &stage.state, acting);
            (before, acted) = (stage.input, Some(acting.input));
        }
        self.terminal.acted = acted.unwrap_or(self.terminal.acted);
    }

    /// Replaces the plan's states by x̄.
    fn close_gaps(&mut self) {
        let mut gap = SVector::<f64, 6>::zeros();
        let states = self
            .stages
            .iter_mut()
            .map(|stage| &mut stage.state)
            .skip(1)
            .chain([&mut self.terminal]);
        for (slot, step) in states.zip(&self.steps) {
            let made_up = SVector::<f64, 6>::from(step.next.to_array()) + step.by_state * gap;
            gap = made_up - SVector::<f64, 6>::from(slot.to_array());
            for axis in 0..3 {
                (slot.pose[axis], slot.velocity[axis]) = (made_up[axis], made_up[axis + 3]);
            }
        }
    }

    /// Updates the inputs' distance from the corrected targets. The inputs stay unchanged.
    fn correct_targets(&mut self, belief: &Belief<'_>) {
        for k in 0..self.horizon {
            let corrected = self.corrected_target(k, belief);
            let Some(stage) = self.stages.get_mut(k) else { return };
            self.cost.move_target(k, &stage.target, &corrected, &mut self.program);
            stage.target = corrected;
            if let Some(deviation) = self.deviation.get_mut(k) {
                *deviation = std::array::from_fn(|axis| stage.input[axis] - corrected[axis]);
            }
        }
    }
}
