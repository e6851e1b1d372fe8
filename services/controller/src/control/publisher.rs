//! Publish: a decision → the command, and afterwards the plan behind it.

use super::Decision;
use super::planner::Planner;
use crate::knowledge::Knowledge;
use crate::mpc::{Mpc, Solved, Status};
use model::{AXES, State, Velocity};
use protocol::message::{
    Command, FallbackLevel, HORIZON_MAX, Plan, PlantState, Reason, SolverStatus, TAIL_MAX,
};

/// The last answer.
pub(super) struct Publisher {
    command: Command,
    plan: Box<Plan>,
    /// Fallback level of the last answer.
    fallback_level: FallbackLevel,
    /// Whether the optimiser was stopped in the last answer.
    out_of_time: bool,
}

impl Publisher {
    pub(super) fn new() -> Self {
        Self {
            command: bytemuck::Zeroable::zeroed(),
            plan: Box::new(bytemuck::Zeroable::zeroed()),
            fallback_level: FallbackLevel::Waiting,
            out_of_time: false,
        }
    }

    /// The last command.
    pub(super) fn command(&self) -> &Command {
        &self.command
    }

    /// The same, to be sent.
    pub(super) fn command_mut(&mut self) -> &mut Command {
        &mut self.command
    }

    /// Input of the last command.
    pub(super) fn commanded(&self) -> Velocity {
        self.command.input
    }

    /// Whether the optimiser was stopped in the last answer because its time was used up.
    pub(super) fn ran_out_of_time(&self) -> bool {
        self.out_of_time
    }

    /// Writes the command of a decision, with its tail, for the gate to judge.
    pub(super) fn write_command(
        &mut self,
        state: &PlantState,
        decision: &Decision,
        model_version: u64,
        stop: Reason,
        mpc: &Mpc,
    ) {
        let Decision { fallback_level, input, .. } = *decision;
        let command = &mut self.command;
        command.stamp.tick = state.stamp.tick;
        command.plant_epoch = state.stamp.epoch;
        command.model_version = model_version;
        command.fallback_level = fallback_level.code();
        command.stop = stop.code();
        command.input = input;
        // Without a plan the input is held: the gate plays at most two periods of it before it
        // brakes. A robot that brakes continues to brake.
        let planned =
            matches!(fallback_level, FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan);
        let brakes = fallback_level == FallbackLevel::Brake;
        let (mut before, mut next) = (input, mpc.stages().iter().skip(1));
        command.tail = [[0.0; AXES]; TAIL_MAX];
        command.tail_len = TAIL_MAX as u32;
        for slot in &mut command.tail {
            let desired =
                if planned { next.next().map_or(before, |stage| stage.input) } else { input };
            // Beyond the free inputs the target may jump with the reference; the wheels cannot.
            let limits = mpc.limits();
            before = if brakes { limits.brake(&before) } else { limits.reach(&desired, &before) };
            *slot = before;
        }
    }

    /// Settles on a decision. Returns whether its fallback level is another one than before.
    pub(super) fn settle(&mut self, decision: &Decision) -> bool {
        self.out_of_time =
            decision.solved.is_some_and(|solved| solved.outcome.status == Status::OutOfTime);
        self.write_outcome(decision.solved);
        let before = std::mem::replace(&mut self.fallback_level, decision.fallback_level);
        before != decision.fallback_level
    }

    fn write_outcome(&mut self, solved: Option<Solved>) {
        let plan = &mut self.plan;
        plan.status = solved.map_or(SolverStatus::NotRun, |solved| solved.outcome.code()).code();
        plan.iterations = solved.map_or(0, |solved| solved.outcome.iterations);
        plan.linearise_nanos = solved.map_or(0, |solved| solved.since.linearise_nanos);
        plan.solve_nanos = solved.map_or(0, |solved| solved.since.solve_nanos);
    }

    /// The plan behind the last answer, with its costs: `measured` is the state it began at.
    pub(super) fn explain(
        &mut self,
        tick_nanos: u64,
        measured: &State,
        planner: &Planner,
        knowledge: &mut Knowledge,
    ) -> &mut Plan {
        self.write_prediction(measured, planner, knowledge);
        let plan = &mut self.plan;
        plan.tick_nanos = tick_nanos;
        plan.stamp.tick = self.command.stamp.tick;
        plan.plant_epoch = self.command.plant_epoch;
        plan.model_version = self.command.model_version;
        plan.fallback_level = self.command.fallback_level;
        plan.learned_axes = knowledge.learned_axes();
        plan.delay_micros =
            (1e6 * knowledge.delay().periods() * knowledge.main().period).round() as u32;
        plan.disturbance = knowledge.disturbance();
        plan.innovation = knowledge.innovation();
        plan.residual = knowledge.residual();
        plan
    }

    fn write_prediction(&mut self, measured: &State, planner: &Planner, knowledge: &mut Knowledge) {
        let (plan, mpc, under_way) = (&mut self.plan, &planner.mpc, knowledge.delay().whole());
        plan.horizon = (under_way + mpc.horizon()).min(HORIZON_MAX) as u32;
        for (k, (state, acting)) in knowledge.under_way(measured).enumerate() {
            (plan.predicted[k], plan.input[k]) = (state.to_array(), acting.input);
        }
        let states =
            mpc.stages().iter().map(|stage| &stage.state).chain(std::iter::once(mpc.terminal()));
        for (slot, state) in plan.predicted.iter_mut().skip(under_way).zip(states) {
            *slot = state.to_array();
        }
        for (slot, stage) in plan.input.iter_mut().skip(under_way).zip(mpc.stages()) {
            *slot = stage.input;
        }
        for (slot, point) in plan.reference.iter_mut().zip(planner.points()) {
            *slot =
                State { pose: point.pose, velocity: point.velocity, ..State::default() }.to_array();
        }
        knowledge.write_variance(plan, &measured.acted);
    }
}
