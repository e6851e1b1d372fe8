//! The other real-time iteration: linearised about the plan itself, so that all but the last step is done before the state comes.
//!
//! ```text
//! before    shift ─ linearise along the plan ─ condense ─ write the program ─ factorise
//! state ▶   surprise ─ gradient and bounds ─ solve ─ ▶ command
//! ```
//! The plan's states need not follow from each other under its inputs: what is missing between two of them, c, is made up to first order,
//!
//! ```text
//! x̄_0 = x_0      x̄_{k+1} = f(x_k, u_k) + A_k (x̄_k − x_k)
//! ```
//! and the program is written about x̄. How it depends on what is still to come is linear, and written with it ([`Surprise`]).
//!
//! Reference: Diehl, Bock & Schlöder, *A real-time iteration scheme for nonlinear optimization in optimal feedback control*, 2005.

use super::condense::Surprise;
use super::solver::Turn;
use super::{Mpc, ReferencePoint, Solved, Spent, Status};
use crate::settings::Linearise;
use model::linearise::linearise;
use model::predict::Belief;
use model::{State, Velocity};
use nalgebra::SVector;
use protocol::clock::monotonic_nanos;
use std::f64::consts::PI;

/// What the program that is ready was written for.
#[derive(Debug, Clone, Copy)]
pub(super) struct Expectation {
    state: State,
    last_input: Velocity,
    disturbance: Velocity,
    carry: f64,
    spent: Spent,
}

impl Expectation {
    /// Whether what has come is what the program depends on linearly; else it has to be written anew.
    fn covers(&self, state: &State, last_input: &Velocity, belief: &Belief<'_>) -> bool {
        let turned = state.pose[2] - self.state.pose[2];
        self.last_input == *last_input && self.carry == belief.carry && turned.abs() < PI
    }
}

impl Mpc {
    /// Expects the robot on its reference, and along it a plan; `reference` begins at the tick that comes next.
    pub fn begin_on(&mut self, reference: &[ReferencePoint]) {
        self.reset();
        let points = reference.iter().map(|point| State { pose: point.pose, velocity: point.velocity, ..State::default() });
        // The coming shift moves them to where they belong.
        for (slot, point) in self.stages.iter_mut().map(|stage| &mut stage.state).skip(1).chain([&mut self.terminal]).zip(points) {
            *slot = point;
        }
        self.planned = true;
    }

    /// With [`Linearise::Expected`]: does all of the next iteration that does not need the state. Called after [`prepare`](Self::prepare),
    /// with what is believed from now on; should anything but the disturbance change before the state comes, it is to be
    /// [forgotten](Self::forget_expectation). Does not allocate.
    pub fn expect(&mut self, last_input: &Velocity, reference: &[ReferencePoint], belief: &Belief<'_>) {
        self.expectation = None;
        if self.linearise == Linearise::Measured || !self.planned || belief.foresight.is_some() {
            return;
        }
        let begin = monotonic_nanos();
        self.follow_plan(last_input, belief);
        if !self.predictable() {
            return;
        }
        self.condensed.propagate(&self.steps, belief.carry);
        self.condensed.propagate_surprise(&self.steps, self.stages.iter().map(|stage| stage.state), belief.main);
        self.close_gaps();
        self.beware(reference, belief);
        let linearised = monotonic_nanos();
        self.build(last_input, reference);
        self.solver.prepare(&self.program);
        self.expectation = self.stages.first().map(|stage| Expectation {
            state: stage.state,
            last_input: *last_input,
            disturbance: belief.disturbance,
            carry: belief.carry,
            spent: Spent { linearise_nanos: linearised - begin, solve_nanos: monotonic_nanos() - linearised },
        });
    }

    /// The next answer is found from the measured state alone.
    pub fn forget_expectation(&mut self) {
        self.expectation = None;
    }

    /// Solves the program that is ready, and makes it ready again. Nothing to rehearse if there is none.
    pub(super) fn rehearse_expected(&mut self) -> bool {
        if self.expectation.is_some() {
            let _answer = self.solver.finish(&self.program, &mut self.solution, &Turn::default());
            self.solver.prepare(&self.program);
        }
        self.expectation.is_some()
    }

    /// From the state to the plan, if the program that is ready covers it.
    pub(super) fn iterate_expected(&mut self, state: &State, last_input: &Velocity, belief: &Belief<'_>) -> Option<Solved> {
        let begin = monotonic_nanos();
        let expected = self.expectation.take().filter(|expected| expected.covers(state, last_input, belief))?;
        let surprise = Surprise::new((state, &belief.disturbance), (&expected.state, &expected.disturbance));
        self.program.take_in(&surprise.0);
        self.correct_targets(belief);
        let mut outcome = self.solver.finish(&self.program, &mut self.solution, &self.turn);
        if outcome.usable() && !self.program.satisfied_by(&self.solution, 1e-6) {
            outcome.status = Status::Wrong;
        }
        for (k, stage) in self.stages.iter_mut().enumerate() {
            stage.state = self.condensed.surprised(k, &stage.state, &surprise);
        }
        self.terminal = self.condensed.surprised(self.horizon, &self.terminal, &surprise);
        if outcome.usable() {
            self.apply();
        }
        if !self.predictable() {
            self.reset();
            outcome.status = Status::Unpredictable;
        }
        let since = Spent { linearise_nanos: 0, solve_nanos: monotonic_nanos() - begin };
        Some(Solved { outcome, ahead: expected.spent, since })
    }

    /// Inputs of the present plan, and the Jacobians along its states.
    fn follow_plan(&mut self, last_input: &Velocity, belief: &Belief<'_>) {
        let (mut before, mut acted) = (*last_input, None);
        for k in 0..self.horizon {
            self.settle_input(k, belief);
            let (Some(stage), Some(step)) = (self.stages.get_mut(k), self.steps.get_mut(k)) else { return };
            stage.state.acted = acted.unwrap_or(stage.state.acted);
            let acting = belief.acting(&before, &stage.input);
            *step = linearise(belief, &stage.state, &acting);
            (before, acted) = (stage.input, Some(acting));
        }
    }

    /// x̄ in place of the plan's states.
    fn close_gaps(&mut self) {
        let mut gap = SVector::<f64, 6>::zeros();
        let states = self.stages.iter_mut().map(|stage| &mut stage.state).skip(1).chain([&mut self.terminal]);
        for (slot, step) in states.zip(&self.steps) {
            let made_up = SVector::<f64, 6>::from(step.next.to_array()) + step.by_state * gap;
            gap = made_up - SVector::<f64, 6>::from(slot.to_array());
            for axis in 0..3 {
                (slot.pose[axis], slot.velocity[axis]) = (made_up[axis], made_up[axis + 3]);
            }
        }
    }

    /// The inputs stay, and their distance from the target is another one.
    fn correct_targets(&mut self, belief: &Belief<'_>) {
        for k in 0..self.horizon {
            let block = k.min(self.blocks - 1);
            let corrected = self.corrected_target(k, belief);
            let Some(stage) = self.stages.get_mut(k) else { return };
            self.cost.move_target(3 * block, &stage.target, &corrected, &mut self.program);
            stage.target = corrected;
            if let Some(deviation) = self.deviation.get_mut(k) {
                *deviation = std::array::from_fn(|axis| stage.input[axis] - corrected[axis]);
            }
        }
    }
}
