//! One iteration of sequential quadratic programming: predict along the present plan, write the
//! program about it, solve it, and apply its solution to the plan.

use super::qp::Vector;
use super::{
    Formulation, Mpc, Outcome, PresentPlan, Solved, Spent, Stage, Status, TrackingError, Turn,
};
use crate::reference::ReferencePoint;
use model::linearise::{Linearised, linearise};
use model::predict::Belief;
use model::{State, Velocity};
use protocol::clock::monotonic_nanos;

impl Mpc {
    /// One iteration from the measured `state`: predicts with the present plan, improves it, and
    /// predicts again to first order. If a program is ready for the [expected](Self::expect) state,
    /// only that is solved.
    ///
    /// [`prepare`](Self::prepare) has been called for the same `reference`, which holds the points
    /// of the present tick and the N after it; `last_input` is the last command. If the outcome is
    /// not usable, the plan stays the shifted one.
    pub fn iterate(
        &mut self,
        state: &State,
        last_input: &Velocity,
        reference: &[ReferencePoint],
        belief: &Belief<'_>,
    ) -> Solved {
        self.last_input = *last_input;
        if let Some(solved) = self.iterate_expected(state, last_input, belief) {
            return solved;
        }
        let begin = monotonic_nanos();
        self.roll_out(state, last_input, belief);
        if !self.predictable() {
            self.reset();
            let outcome = Outcome { status: Status::Unpredictable, iterations: 0 };
            let since = Spent { linearise_nanos: monotonic_nanos() - begin, solve_nanos: 0 };
            return Solved { outcome, ahead: Spent::default(), since };
        }
        self.propagate_variance(reference, belief);
        let linearised = monotonic_nanos();
        self.program.set_dynamics(&self.steps, &belief.split);
        self.build(last_input, reference);
        let mut outcome = self.solver.solve(&self.program, &mut self.solution, &self.turn);
        self.take(&mut outcome);
        let since = Spent {
            linearise_nanos: linearised - begin,
            solve_nanos: monotonic_nanos() - linearised,
        };
        Solved { outcome, ahead: Spent::default(), since }
    }

    /// Does one whole iteration on the expected state, and leaves the plan unchanged. Other work
    /// may have evicted code and data from the processor's caches since the last iteration; the
    /// rehearsal loads them again. Called after [`prepare`](Self::prepare).
    pub fn rehearse(
        &mut self,
        last_input: &Velocity,
        reference: &[ReferencePoint],
        belief: &Belief<'_>,
    ) {
        if self.rehearse_expected() {
            return;
        }
        let Some(expected) = self.stages.first().map(|stage| stage.state) else { return };
        self.roll_out(&expected, last_input, belief);
        if self.predictable() {
            self.program.set_dynamics(&self.steps, &belief.split);
            self.propagate_variance(reference, belief);
            self.build(last_input, reference);
            let _answer = self.solver.solve(&self.program, &mut self.solution, &Turn::default());
        }
    }

    pub(super) fn predictable(&self) -> bool {
        let finite = |stage: &Stage| {
            stage.state.is_finite()
                && stage.input.iter().chain(&stage.target).all(|value| value.is_finite())
        };
        let linear = |step: &Linearised| {
            step.by_state.iter().chain(step.by_input.iter()).all(|value| value.is_finite())
        };
        self.terminal.is_finite() && self.stages.iter().all(finite) && self.steps.iter().all(linear)
    }

    /// Inputs and states along the present plan, and the Jacobians there.
    pub(super) fn roll_out(&mut self, state: &State, last_input: &Velocity, belief: &Belief<'_>) {
        let (mut at, mut before) = (*state, *last_input);
        for k in 0..self.horizon {
            self.settle_input(k, belief);
            let (Some(stage), Some(step)) = (self.stages.get_mut(k), self.steps.get_mut(k)) else {
                return;
            };
            stage.state = at;
            *step = linearise(belief, &at, belief.acting(&before, &stage.input));
            (at, before) = (step.next, stage.input);
        }
        self.terminal = at;
        self.planned = true;
    }

    /// Target and input of period `k` of the present plan.
    pub(super) fn settle_input(&mut self, k: usize, belief: &Belief<'_>) {
        let (target, last_block) = (self.corrected_target(k, belief), self.blocks - 1);
        let Some(stage) = self.stages.get_mut(k) else { return };
        stage.target = target;
        stage.input = target;
        if let Some(deviation) = self.deviation.get_mut(k.min(last_block)) {
            let desired = std::array::from_fn(|axis| target[axis] + deviation[axis]);
            stage.input = self.limits.clamp(&desired);
            if k <= last_block {
                *deviation = std::array::from_fn(|axis| stage.input[axis] - target[axis]);
            }
        }
    }

    /// The holding input is linear in the disturbance. The disturbance was corrected after the
    /// targets were computed.
    pub(super) fn corrected_target(&self, k: usize, belief: &Belief<'_>) -> Velocity {
        let target = self.stages.get(k).map_or([0.0; 3], |stage| stage.target);
        if self.formulation == Formulation::Plain {
            return target;
        }
        let corrected = std::array::from_fn(|axis| {
            target[axis]
                + (self.target_disturbance[axis] - belief.disturbance[axis])
                    / belief.main.gain[axis]
        });
        self.limits.clamp(&corrected)
    }

    pub(super) fn build(&mut self, last_input: &Velocity, reference: &[ReferencePoint]) {
        let (stages, terminal) = (&self.stages, &self.terminal);
        let plan = PresentPlan {
            stages,
            terminal,
            last_input,
            reference,
            tightening: self.tightening.as_ref(),
        };
        self.cost.write(&plan, &mut self.program);
        self.limits.write(&plan, &mut self.program);
    }

    /// Propagates the variance of the prediction, if bounds are tightened.
    pub(super) fn propagate_variance(&mut self, reference: &[ReferencePoint], belief: &Belief<'_>) {
        let Some(tightening) = &mut self.tightening else { return };
        if let Some(step) = self.steps.first() {
            tightening.leave_unanswered(step);
        }
        for (k, ((stage, step), point)) in
            self.stages.iter().zip(&self.steps).zip(reference).enumerate()
        {
            let mut feedback = self.cost.feedback(&TrackingError::new(&stage.state, point));
            for (axis, before) in belief.split.before.iter().enumerate() {
                feedback.row_mut(axis).scale_mut(1.0 - before);
            }
            tightening.propagate(k, step, &feedback);
        }
    }

    /// Applies a usable solution to the plan, if it keeps the limits: inputs exactly, states to
    /// first order.
    pub(super) fn take(&mut self, outcome: &mut Outcome) {
        if !outcome.usable() {
            return;
        }
        self.program.follow(&self.solution, &mut self.moves);
        if !self.program.satisfied_by(&self.solution, &self.moves, 1e-6) {
            outcome.status = Status::Wrong;
            return;
        }
        self.held_by_obstacle = self.limits.held_by_obstacle(&self.program, &self.moves);
        let (change, _) = self.solution.as_chunks::<3>();
        let free = change.get(..self.blocks).unwrap_or_default();
        for (deviation, change) in self.deviation.iter_mut().zip(free) {
            *deviation = std::array::from_fn(|axis| deviation[axis] + change[axis]);
        }
        let last = free.last().copied().unwrap_or_default();
        let changes = free.iter().chain(std::iter::repeat(&last));
        for ((stage, change), moved) in self.stages.iter_mut().zip(changes).zip(&self.moves) {
            let input = std::array::from_fn(|axis| stage.input[axis] + change[axis]);
            stage.input = self.limits.clamp(&input);
            move_by(&mut stage.state, moved);
        }
        if let Some(moved) = self.moves.last() {
            move_by(&mut self.terminal, moved);
        }
    }
}

/// Adds the x part of ξ to a state.
pub(super) fn move_by(state: &mut State, by: &Vector) {
    for axis in 0..3 {
        state.pose[axis] += by[axis];
        state.velocity[axis] += by[axis + 3];
    }
}
