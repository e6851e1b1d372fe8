//! One tick: process the effect of the last input, answer the newest state, explain the answer.
//!
//! Between a state and its command nothing here allocates, locks, logs, blocks, or touches a file
//! or socket.

pub mod tuning;

use crate::adopt::{Candidate, Event, Expected, Handover};
use crate::currents::{Contradicted, Currents, Foretold};
use crate::explanations::Model;
use crate::fallback::{self, FallbackChoice};
use crate::identified::Identified;
use crate::knowledge::{Knowledge, Measured, Period};
use crate::loop_judge::{LoopJudge, Passed};
use crate::mpc::{Mpc, MpcError, Solved, Status, Turn};
use crate::reference::{PointsError, Reference, ReferencePoint};
use crate::sensors::{Driven, SensorFault, Watch};
use crate::settings::{Identify, Method, Settings};
use crate::tracking::TrackingJudge;
use gate::Bounds;
use gate::accept::{Situation, judge};
use model::delay::DELAY_MAX;
use model::foresight::Foresight;
use model::main_model::{MainModel, fingerprint};
use model::residual::bound;
use model::{State, Velocity};
use protocol::clock::monotonic_nanos;
use protocol::message::{
    Command, FallbackLevel, HORIZON_MAX, Plan, PlantState, Reason, ResidualSample, SolverStatus,
    TAIL_MAX,
};
use tuning::Tuned;

/// Iterations per period of a controller with foresight. It is meant to be accurate, not fast.
const FORESEEING_ITERATIONS: usize = 2;

/// The controller could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    /// The optimiser failed.
    #[error(transparent)]
    Mpc(#[from] MpcError),
    /// The reference failed.
    #[error(transparent)]
    Reference(#[from] PointsError),
    /// An oracle needs the simulator's own dynamics.
    #[error(
        "mpc.method = \"oracle\" needs the simulator's own dynamics, which only `coxswain \
         experiment` provides"
    )]
    NoForesight,
}

/// The previous state, to find the effect of the input in between.
#[derive(Debug, Clone, Copy)]
struct Before {
    tick: u64,
    state: State,
}

/// A command and its reason.
#[derive(Debug, Clone, Copy)]
struct Decision {
    fallback_level: FallbackLevel,
    reason: Reason,
    input: Velocity,
    /// Result of the optimiser, if it ran.
    solved: Option<Solved>,
}

/// The controller without its ports.
pub struct Controller {
    knowledge: Knowledge,
    watch: Watch,
    tracking: TrackingJudge,
    /// Limits that the gate enforces.
    bounds: Bounds,
    /// Time budget of an answer; `None` in lock step \[ns\].
    budget_nanos: Option<u64>,
    mpc: Mpc,
    method: Method,
    fallback_choice: FallbackChoice,
    /// Judges whether the plans hold the robot; `None` for a controller that uses plans alone.
    loop_judge: Option<LoopJudge>,
    currents: Currents,
    /// Motor currents that the last plans predicted, newest first.
    foretold: [Foretold; DELAY_MAX + 1],
    reference: Reference,
    /// The reference at the present tick and at as many later ticks as delay and horizon can need.
    points: Vec<ReferencePoint>,
    fingerprint: u64,
    plant_epoch: Option<u64>,
    before: Option<Before>,
    /// Tick for which plan and targets are ready.
    prepared_for: Option<u64>,
    /// The models in use at that time.
    prepared_with: [Model; 3],
    /// Input of the last answer.
    commanded: Velocity,
    fallback_level: FallbackLevel,
    /// Whether the optimiser was stopped in the last answer.
    out_of_time: bool,
    command: Command,
    plan: Box<Plan>,
}

impl Controller {
    /// Sets up the controller. Allocates all memory that a run needs.
    ///
    /// # Errors
    /// [`ControllerError`] if the weights, the solver or the reference are invalid.
    pub fn new(settings: &Settings) -> Result<Self, ControllerError> {
        Self::foreseeing(settings, None)
    }

    /// The same with a source of the true dynamics, which [`Method::Oracle`] uses.
    ///
    /// # Errors
    /// [`ControllerError`].
    pub fn foreseeing(
        settings: &Settings,
        foresight: Option<Box<dyn Foresight>>,
    ) -> Result<Self, ControllerError> {
        let foresight = if settings.mpc.method == Method::Oracle {
            Some(foresight.ok_or(ControllerError::NoForesight)?)
        } else {
            None
        };
        let period = settings.run.period_nanos as f64 * 1e-9;
        let main = MainModel::new(&settings.robot, period);
        let judged = settings.mpc.method == Method::Mpc
            && settings.mpc.identify != Identify::Off
            && settings.mpc.no_harm;
        let Tuned { mpc, reference, points, budget_nanos, .. } = Tuned::new(settings, None)?;
        Ok(Self {
            reference: reference.unwrap_or_default(),
            points,
            fingerprint: fingerprint(&main, settings.learned.layout.name()),
            watch: Watch::new(main, bound(&main, &settings.robot)),
            tracking: TrackingJudge::new(&settings.robot),
            bounds: Bounds::new(&settings.robot, settings.run.period_nanos, 0),
            budget_nanos,
            knowledge: Knowledge::new(settings, main, foresight),
            mpc,
            method: settings.mpc.method,
            fallback_choice: FallbackChoice::default(),
            loop_judge: judged.then(|| {
                let limits = &settings.robot.limits;
                let largest = [limits.input_mps, limits.input_mps, limits.yaw_input_radps];
                LoopJudge::new(period, settings.robot.geometry.lever_m(), largest)
            }),
            currents: Currents::new(&settings.robot, period),
            foretold: [Foretold::default(); DELAY_MAX + 1],
            plant_epoch: None,
            before: None,
            prepared_for: None,
            prepared_with: [Model::Main; 3],
            commanded: [0.0; 3],
            fallback_level: FallbackLevel::Waiting,
            out_of_time: false,
            command: bytemuck::Zeroable::zeroed(),
            plan: Box::new(bytemuck::Zeroable::zeroed()),
        })
    }

    /// Requirements on a snapshot for this controller.
    pub fn expected(settings: &Settings) -> Expected {
        let main = MainModel::new(&settings.robot, settings.run.period_nanos as f64 * 1e-9);
        Expected {
            fingerprint: fingerprint(&main, settings.learned.layout.name()),
            layout: settings.learned.layout,
            bound: bound(&main, &settings.robot),
        }
    }

    /// Version of the learned model in use; 0 is the main model alone.
    pub fn model_version(&self) -> u64 {
        self.knowledge.version()
    }

    /// Puts a model in use. Returns the one before, for another thread to free.
    pub fn adopt(&mut self, candidate: Box<Candidate>) -> Option<Box<Candidate>> {
        self.knowledge.adopt(candidate)
    }

    /// The current belief.
    pub fn knowledge(&self) -> &Knowledge {
        &self.knowledge
    }

    /// Starts from the parameters that an earlier run identified. Returns false, and starts without
    /// them, if they cannot be used.
    pub fn begin_with(&mut self, identified: &Identified) -> bool {
        self.knowledge.begin_with(identified)
    }

    /// Processes the effect of the last input, and returns the sample for the learner.
    pub fn observe(
        &mut self,
        state: &PlantState,
        handover: &Handover,
        controller_epoch: u64,
    ) -> ResidualSample {
        if self.plant_epoch != Some(state.stamp.epoch) {
            self.start_over(state, handover, controller_epoch);
        }
        let now = Measured { pose: state.pose, velocity: state.velocity };
        let mut sample: ResidualSample = bytemuck::Zeroable::zeroed();
        sample.stamp.tick = state.stamp.tick;
        sample.plant_epoch = state.stamp.epoch;
        sample.fingerprint = self.fingerprint;
        let ours = matches!(
            state.fallback_level(),
            FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan | FallbackLevel::Simple
        );
        let seen = self.watch_sensors(
            state,
            &Driven { acted: state.input, commanded: ours.then_some(self.commanded) },
            handover,
        );
        if seen {
            self.judge_tracking(state, handover);
        }
        let input_known = state.input.iter().all(|value| value.is_finite()) && seen;
        if let Some(before) =
            self.before.filter(|before| before.tick + 1 == state.stamp.tick && input_known)
        {
            let Before { tick, state: before } = before;
            let period = Period { tick, before, given: state.input, after: now };
            self.knowledge.observe(&period);
            self.watch_loop(state);
            sample.pose = before.pose;
            sample.velocity = before.velocity;
            (sample.input, sample.input_before) = (self.knowledge.state().acted, before.acted);
            sample.residual = self.knowledge.residual();
            sample.usable = u32::from(ours);
        } else if seen {
            // An input that is not finite is replaced by the last command: the best estimate.
            let known = if input_known { state.input } else { self.knowledge.last_command() };
            self.knowledge.resume(&now, known);
        } else if state.input.iter().all(|value| value.is_finite()) {
            // The next input starts from the acting input, also when the sensors are not trusted.
            self.knowledge.drive_blind(state.input);
        }
        self.before =
            seen.then(|| Before { tick: state.stamp.tick, state: self.knowledge.state() });
        sample
    }

    /// Judges whether the robot is too far from its reference.
    fn judge_tracking(&mut self, state: &PlantState, handover: &Handover) {
        let (tick, before) = (state.stamp.tick, self.tracking.request());
        let reference = self.reference.at(tick).pose;
        let request = self.tracking.judge(&state.pose, &reference, state.fallback_level());
        if request != before && request != Reason::None {
            handover.note(Event::Stop { tick, reason: request });
        }
    }

    /// Compares the effect of the last period's input with the prediction.
    fn watch_loop(&mut self, state: &PlantState) {
        let by_plans =
            matches!(state.fallback_level(), FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan);
        if by_plans {
            let foretold = &self.foretold[self.knowledge.delay().whole()];
            self.currents.look(foretold, state.current());
            self.mpc.drop_current_rows(self.currents.dropped());
        }
        let Some(judge) = &mut self.loop_judge else { return };
        let believed = self.knowledge.state();
        match state.fallback_level() {
            FallbackLevel::Waiting | FallbackLevel::Brake | FallbackLevel::LatchedStop => {
                judge.reset();
            }
            FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan | FallbackLevel::Simple
                if by_plans || judge.prefers_simple() =>
            {
                let point = self.mpc.limits().admitted(&self.reference.at(state.stamp.tick));
                judge.look(&Passed {
                    given: state.input,
                    acted: believed.acted,
                    pose: believed.pose,
                    velocity: believed.velocity,
                    point: &point,
                });
            }
            _ => judge.pass_over(&believed.pose),
        }
    }

    /// Whether the simple controller drives because plans would not hold the robot.
    fn prefers_simple(&self) -> bool {
        self.loop_judge.as_ref().is_some_and(LoopJudge::prefers_simple)
    }

    /// The limit on a motor's current that the measured current contradicts, if there is one.
    pub fn contradicted_limit(&self) -> Option<Contradicted> {
        self.currents.contradicted()
    }

    /// Whether the measurements are plausible.
    fn watch_sensors(&mut self, state: &PlantState, driven: &Driven, handover: &Handover) -> bool {
        let (before, fault) = (self.watch.fault(), self.watch.look(state, driven));
        if fault != before {
            handover.note(Event::Sensors { tick: state.stamp.tick, fault });
        }
        fault.is_none()
    }

    /// The fault of the newest state, if there is one.
    pub fn sensor_fault(&self) -> Option<SensorFault> {
        self.watch.fault()
    }

    /// Whether the optimiser was stopped in the last answer because its time was used up.
    pub fn ran_out_of_time(&self) -> bool {
        self.out_of_time
    }

    /// Answers `state`, the newest that was [observed](Self::observe). The answer has the highest
    /// fallback level whose command the gate would accept.
    pub fn answer(&mut self, state: &PlantState, handover: &Handover) -> &mut Command {
        let tick = state.stamp.tick;
        self.mpc.take_turn(Turn {
            tick: Some(tick),
            until: self.budget_nanos.map(|budget| monotonic_nanos() + budget),
        });
        let measured = self.knowledge.state();
        if self.prepared_for != Some(tick) {
            self.prepare(tick, &measured);
        }
        let mut decision = if self.watch.fault().is_none() && measured.is_finite() {
            self.plan_for(tick, &measured)
        } else {
            self.brake(Reason::BadState)
        };
        self.write_command(state, decision.fallback_level, decision.input);
        while let Err(reason) = self.judged(state)
            && decision.fallback_level != FallbackLevel::Brake
        {
            decision = Decision {
                solved: decision.solved,
                ..self.next_fallback_level(decision.fallback_level, reason, &measured)
            };
            self.write_command(state, decision.fallback_level, decision.input);
        }
        let Decision { fallback_level, reason, input, solved } = decision;
        if fallback_level != self.fallback_level {
            handover.note(Event::FallbackLevel { tick, fallback_level, reason });
            self.fallback_level = fallback_level;
        }
        self.foretold.rotate_right(1);
        self.foretold[0] =
            if matches!(fallback_level, FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan) {
                self.mpc.foretold_currents()
            } else {
                Foretold::default()
            };
        self.out_of_time = solved.is_some_and(|solved| solved.outcome.status == Status::OutOfTime);
        self.write_outcome(solved);
        self.commanded = input;
        &mut self.command
    }

    /// The gate's decision on the command, as far as it can be predicted here.
    fn judged(&self, state: &PlantState) -> Result<(), Reason> {
        let acting = self.mpc.limits().clamp(&self.knowledge.last_command());
        let situation = Situation {
            plant_epoch: state.stamp.epoch,
            tick: state.stamp.tick,
            age_nanos: Some(0),
            accepted: None,
            writer: None,
            acting,
            begun_with: acting,
        };
        judge(&self.command, &situation, &self.bounds)
    }

    /// Drops a plan that the gate would refuse, and answers with the LQR. If the gate would refuse
    /// that too, the robot brakes.
    fn next_fallback_level(
        &mut self,
        from: FallbackLevel,
        reason: Reason,
        measured: &State,
    ) -> Decision {
        self.mpc.reset();
        self.fallback_choice.reset();
        if from == FallbackLevel::Simple {
            return self.brake(reason);
        }
        Decision {
            fallback_level: FallbackLevel::Simple,
            reason,
            input: self.lqr(measured),
            solved: None,
        }
    }

    /// Brakes to standstill, as fast as inputs may change.
    fn brake(&self, reason: Reason) -> Decision {
        let input = self.mpc.limits().reach(&[0.0; 3], &self.knowledge.last_command());
        Decision { fallback_level: FallbackLevel::Brake, reason, input, solved: None }
    }

    /// The last answer.
    pub fn last_answer(&self) -> &Command {
        &self.command
    }

    /// Prepares for `tick` with the current belief. Called after the previous answer has been sent,
    /// or from `state` for a first state.
    fn prepare(&mut self, tick: u64, state: &State) {
        self.knowledge.look(tick);
        self.knowledge.settle_delay();
        if self.prepared_for.is_none() {
            self.mpc.begin_at(state);
        }
        self.mpc.shift();
        self.aim(tick);
        self.prepared_for = Some(tick);
    }

    /// Computes the targets and the expected errors of the plan that begins at `tick`.
    fn aim(&mut self, tick: u64) {
        for (slot, offset) in self.points.iter_mut().zip(0..) {
            *slot = self.reference.at(tick + offset);
        }
        self.mpc.aim(planned(&self.points, &self.knowledge), &self.knowledge.belief());
        let under_way = self.knowledge.delay().whole();
        self.mpc.expect_errors(under_way, |at| self.knowledge.step_variance(at));
    }

    /// Prepares for the tick after the last answered one: shifts the plan and computes its targets
    /// with the present model.
    pub fn prepare_next(&mut self) {
        if let (Some(before), Some(_)) = (self.before, self.prepared_for) {
            self.prepare(before.tick + 1, &before.state);
            if self.method == Method::Mpc {
                self.mpc.expect(
                    &self.commanded,
                    planned(&self.points, &self.knowledge),
                    &self.knowledge.belief(),
                );
                self.prepared_with = self.knowledge.models();
            }
        }
    }

    /// Rehearses the next answer, shortly before its state is expected. The answer then finds its
    /// code and data in the caches, whatever else the machine has run meanwhile. Nothing that the
    /// answer depends on changes.
    pub fn rehearse(&mut self) {
        if self.prepared_for.is_some() {
            self.mpc.rehearse(
                &self.knowledge.last_command(),
                planned(&self.points, &self.knowledge),
                &self.knowledge.belief(),
            );
        }
    }

    /// The plan behind the last answer, with its costs. Called after the command has been sent.
    pub fn explain(&mut self, tick_nanos: u64) -> &mut Plan {
        self.write_prediction();
        let plan = &mut self.plan;
        plan.tick_nanos = tick_nanos;
        plan.stamp.tick = self.command.stamp.tick;
        plan.plant_epoch = self.command.plant_epoch;
        plan.model_version = self.command.model_version;
        plan.fallback_level = self.command.fallback_level;
        plan.learned_axes = self.knowledge.learned_axes();
        plan.delay_micros =
            (1e6 * self.knowledge.delay().periods() * self.knowledge.main().period).round() as u32;
        plan.disturbance = self.knowledge.disturbance();
        plan.innovation = self.knowledge.innovation();
        plan.residual = self.knowledge.residual();
        plan
    }

    fn plan_for(&mut self, tick: u64, measured: &State) -> Decision {
        if self.method == Method::FeedforwardP {
            let input = self.simple(measured);
            return Decision {
                fallback_level: FallbackLevel::FreshPlan,
                reason: Reason::None,
                input,
                solved: None,
            };
        }
        self.knowledge.look(tick);
        let (belief, last, begin) = (
            self.knowledge.belief(),
            self.knowledge.last_command(),
            self.knowledge.ahead(measured),
        );
        let points = planned(&self.points, &self.knowledge);
        if self.prepared_with != self.knowledge.models() {
            self.mpc.forget_expectation();
        }
        let mut solved = self.mpc.iterate(&begin, &last, points, &belief);
        if self.knowledge.foresees() {
            for _ in 1..FORESEEING_ITERATIONS {
                solved = self.mpc.iterate(&begin, &last, points, &belief);
            }
        }
        if self.prefers_simple() {
            self.fallback_choice.look(solved.outcome);
            let (fallback_level, reason, input) =
                (FallbackLevel::Simple, Reason::NoPlan, self.simple(measured));
            return Decision { fallback_level, reason, input, solved: Some(solved) };
        }
        let (fallback_level, input) = self
            .fallback_choice
            .choose(solved.outcome, &self.mpc, &last)
            .unwrap_or_else(|| (FallbackLevel::Simple, self.lqr(measured)));
        let reason = if fallback_level == FallbackLevel::FreshPlan {
            Reason::None
        } else {
            Reason::SolverFailed
        };
        Decision { fallback_level, reason, input, solved: Some(solved) }
    }

    /// The command without a plan: the LQR on the main model.
    fn lqr(&self, measured: &State) -> Velocity {
        let begin = self.knowledge.ahead(measured);
        let point = planned(&self.points, &self.knowledge).first().copied().unwrap_or_default();
        let disturbance = self.knowledge.disturbance();
        let main_target =
            self.mpc.main_target(self.knowledge.main(), &point, begin.pose[2], &disturbance);
        fallback::lqr(&self.mpc, &begin, &point, &main_target, &self.knowledge.last_command())
    }

    /// Command of the simple controller, for a robot that plans do not hold.
    fn simple(&self, measured: &State) -> Velocity {
        let point = self.points.first().copied().unwrap_or_default();
        let last = self.knowledge.last_command();
        fallback::simple(&self.mpc, self.knowledge.main(), &measured.pose, &point, &last)
    }

    fn start_over(&mut self, state: &PlantState, handover: &Handover, controller_epoch: u64) {
        handover.note(Event::Plant { epoch: state.stamp.epoch, controller_epoch });
        self.plant_epoch = Some(state.stamp.epoch);
        self.before = None;
        self.watch.reset();
        self.tracking.reset();
        self.knowledge.reset();
        self.mpc.reset();
        self.prepared_for = None;
        self.fallback_choice.reset();
        self.currents.reset();
        self.mpc.drop_current_rows(self.currents.dropped());
        self.foretold = [Foretold::default(); DELAY_MAX + 1];
        if let Some(judge) = &mut self.loop_judge {
            judge.reset();
        }
    }

    fn write_command(
        &mut self,
        state: &PlantState,
        fallback_level: FallbackLevel,
        input: Velocity,
    ) {
        let command = &mut self.command;
        command.stamp.tick = state.stamp.tick;
        command.plant_epoch = state.stamp.epoch;
        command.model_version = self.knowledge.version();
        command.fallback_level = fallback_level.code();
        command.stop = self.tracking.request().code();
        command.input = input;
        // Without a plan the input is held: the gate plays at most two periods of it before it
        // brakes. A robot that brakes continues to brake.
        let planned =
            matches!(fallback_level, FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan);
        let held = if fallback_level == FallbackLevel::Brake { [0.0; 3] } else { input };
        let limits = self.mpc.limits();
        let (mut before, mut next) = (input, self.mpc.stages().iter().skip(1));
        command.tail = [[0.0; 3]; TAIL_MAX];
        command.tail_len = TAIL_MAX as u32;
        for slot in &mut command.tail {
            let desired =
                if planned { next.next().map_or(before, |stage| stage.input) } else { held };
            // Beyond the free inputs the target may jump with the reference; the wheels cannot.
            before = limits.reach(&desired, &before);
            *slot = before;
        }
    }

    fn write_outcome(&mut self, solved: Option<Solved>) {
        let plan = &mut self.plan;
        plan.status = solved.map_or(SolverStatus::NotRun, |solved| solved.outcome.code()).code();
        plan.iterations = solved.map_or(0, |solved| solved.outcome.iterations);
        plan.linearise_nanos = solved.map_or(0, |solved| solved.since.linearise_nanos);
        plan.solve_nanos = solved.map_or(0, |solved| solved.since.solve_nanos);
    }

    fn write_prediction(&mut self) {
        let measured = self.before.map_or(State::default(), |before| before.state);
        let under_way = self.knowledge.delay().whole();
        let plan = &mut self.plan;
        plan.horizon = (under_way + self.mpc.horizon()).min(HORIZON_MAX) as u32;
        for (k, (state, acting)) in self.knowledge.under_way(&measured).enumerate() {
            (plan.predicted[k], plan.input[k]) = (state.to_array(), acting);
        }
        let states = self
            .mpc
            .stages()
            .iter()
            .map(|stage| &stage.state)
            .chain(std::iter::once(self.mpc.terminal()));
        for (slot, state) in plan.predicted.iter_mut().skip(under_way).zip(states) {
            *slot = state.to_array();
        }
        for (slot, stage) in plan.input.iter_mut().skip(under_way).zip(self.mpc.stages()) {
            *slot = stage.input;
        }
        for (slot, point) in plan.reference.iter_mut().zip(&self.points) {
            *slot =
                State { pose: point.pose, velocity: point.velocity, ..State::default() }.to_array();
        }
        self.knowledge.write_variance(plan, &measured.acted);
    }
}

/// The part of `points` that can still be changed. It begins where the inputs under way end.
fn planned<'a>(points: &'a [ReferencePoint], knowledge: &Knowledge) -> &'a [ReferencePoint] {
    points.get(knowledge.delay().whole()..).unwrap_or(points)
}

#[cfg(test)]
pub(crate) mod tests;
