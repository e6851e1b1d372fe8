//! One tick: take in what the last input did, answer the newest state, explain the answer.
//!
//! Between a state and its command nothing here allocates, locks, logs, blocks, or touches a file or socket.

use crate::adopt::{Candidate, Event, Expected, Handover};
use crate::fallback::Ladder;
use crate::mpc::{Mpc, MpcError, Solved};
use crate::reference::{PointsError, Reference, ReferencePoint};
use crate::settings::{Method, Settings};
use model::foresight::Foresight;
use model::learned::Residual;
use model::least_squares::LeastSquares;
use model::main_model::{MainModel, fingerprint};
use model::observer::{Observer, Sample};
use model::predict::Belief;
use model::residual::residual;
use model::{State, Velocity, wrap};
use protocol::message::{Command, HORIZON_MAX, Plan, PlantState, Reason, ResidualSample, Rung, SolverStatus, TAIL_MAX};

/// Largest believable share of its physical range that the main model can be wrong by in one period.
const RESIDUAL_SHARE: f64 = 0.25;

/// Time over which recursive least squares forgets \[s\].
const LEAST_SQUARES_MEMORY_S: f64 = 20.0;

/// Iterations in a period of a controller with foresight, which is to be as good as can be and not as fast.
const FORESEEING_ITERATIONS: usize = 2;

/// Of the proportional feedback of the pose, where nothing better is asked for \[1/s\].
const FEEDFORWARD_GAIN_PER_S: f64 = 2.0;

/// Why a controller could not be set up.
#[derive(Debug, thiserror::Error)]
pub enum ControllerError {
    /// Its optimiser.
    #[error(transparent)]
    Mpc(#[from] MpcError),
    /// Its reference.
    #[error(transparent)]
    Reference(#[from] PointsError),
    /// Only the simulator's own dynamics make an oracle.
    #[error("mpc.method = \"oracle\" needs the simulator's own dynamics, which `coxswain experiment` alone hands out")]
    NoForesight,
}

/// The state before the present one, to see what the input in between did.
#[derive(Debug, Clone, Copy)]
struct Before {
    tick: u64,
    state: State,
}

/// The controller without its ports.
pub struct Controller {
    main: MainModel,
    mpc: Mpc,
    method: Method,
    foresight: Option<Box<dyn Foresight>>,
    least_squares: LeastSquares,
    ladder: Ladder,
    observer: Observer,
    reference: Reference,
    /// The reference at the present tick and the N after it.
    points: Vec<ReferencePoint>,
    fingerprint: u64,
    active: Option<Box<Candidate>>,
    plant_epoch: Option<u64>,
    before: Option<Before>,
    /// Tick that plan and targets are ready for.
    prepared_for: Option<u64>,
    /// Input commanded last, until the plant reports what the wheels got.
    last_input: Velocity,
    residual: Velocity,
    rung: Rung,
    command: Command,
    plan: Box<Plan>,
}

impl Controller {
    /// Sets everything up. Allocates all that a run needs.
    ///
    /// # Errors
    /// [`ControllerError`] if the weights, the solver or the reference refuse.
    pub fn new(settings: &Settings) -> Result<Self, ControllerError> {
        Self::foreseeing(settings, None)
    }

    /// The same with somebody who knows what the robot will do, whom [`Method::Oracle`] asks.
    ///
    /// # Errors
    /// [`ControllerError`].
    pub fn foreseeing(settings: &Settings, foresight: Option<Box<dyn Foresight>>) -> Result<Self, ControllerError> {
        let foresight = if settings.mpc.method == Method::Oracle { Some(foresight.ok_or(ControllerError::NoForesight)?) } else { None };
        let period = settings.run.period_nanos as f64 * 1e-9;
        let main = MainModel::new(&settings.robot, period);
        let mpc = Mpc::new(&settings.mpc, &settings.robot, &main)?;
        let ticks = (settings.duration_s / period).ceil() as usize + mpc.horizon() + 1;
        Ok(Self {
            reference: Reference::new(&settings.reference, &settings.start, period, ticks)?,
            points: vec![ReferencePoint::default(); mpc.horizon() + 1],
            fingerprint: fingerprint(&main, settings.learned.layout.name()),
            main,
            mpc,
            method: settings.mpc.method,
            foresight,
            least_squares: LeastSquares::new(1.0 - period / LEAST_SQUARES_MEMORY_S, Self::expected(settings).bound),
            ladder: Ladder::default(),
            observer: Observer::new(settings.mpc.observer_gain, Self::expected(settings).bound),
            active: None,
            plant_epoch: None,
            before: None,
            prepared_for: None,
            last_input: [0.0; 3],
            residual: [0.0; 3],
            rung: Rung::Waiting,
            command: bytemuck::Zeroable::zeroed(),
            plan: Box::new(bytemuck::Zeroable::zeroed()),
        })
    }

    /// What a snapshot must be for this controller to use it.
    pub fn expected(settings: &Settings) -> Expected {
        let main = MainModel::new(&settings.robot, settings.run.period_nanos as f64 * 1e-9);
        let limits = &settings.robot.limits;
        let range = [limits.input_mps, limits.input_mps, limits.yaw_input_radps];
        Expected {
            fingerprint: fingerprint(&main, settings.learned.layout.name()),
            layout: settings.learned.layout,
            bound: std::array::from_fn(|axis| RESIDUAL_SHARE * main.gain[axis] * range[axis]),
        }
    }

    /// Version of the learned model in use; 0 is the main model alone.
    pub fn model_version(&self) -> u64 {
        self.active.as_ref().map_or(0, |active| active.version)
    }

    /// Puts a model in use, and gives back the one before, for somebody else to free.
    pub fn adopt(&mut self, candidate: Box<Candidate>) -> Option<Box<Candidate>> {
        let learned = &candidate.learned;
        self.observer.replay(|velocity, input| learned.mean(velocity, input));
        self.active.replace(candidate)
    }

    /// Takes in what the last input did, and says what there is to learn from it.
    pub fn observe(&mut self, state: &PlantState, handover: &Handover, controller_epoch: u64) -> ResidualSample {
        if self.plant_epoch != Some(state.stamp.epoch) {
            self.start_over(state, handover, controller_epoch);
        }
        let now = State { pose: state.pose, velocity: state.velocity };
        let mut sample: ResidualSample = bytemuck::Zeroable::zeroed();
        sample.stamp.tick = state.stamp.tick;
        sample.plant_epoch = state.stamp.epoch;
        sample.fingerprint = self.fingerprint;
        let input_known = state.input.iter().all(|value| value.is_finite()) && now.is_finite();
        if let Some(before) = self.before.filter(|before| before.tick + 1 == state.stamp.tick && input_known) {
            self.residual = residual(&self.main, &before.state.velocity, &state.input, &now.velocity);
            self.look(before.tick);
            let learned = self.belief().residual(&before.state, &state.input);
            self.look(state.stamp.tick);
            let observed = Sample { velocity: before.state.velocity, input: state.input, residual: self.residual };
            self.observer.update(observed, &learned);
            if self.method == Method::LeastSquaresMpc {
                self.least_squares.update(&before.state.velocity, &state.input, &self.residual);
            }
            sample.pose = before.state.pose;
            sample.velocity = before.state.velocity;
            sample.input = state.input;
            sample.residual = self.residual;
            sample.usable = u32::from(matches!(state.rung(), Rung::FreshPlan | Rung::ShiftedPlan | Rung::Lqr));
        }
        if input_known {
            self.last_input = state.input;
        }
        self.before = now.is_finite().then_some(Before { tick: state.stamp.tick, state: now });
        sample
    }

    /// The answer to `state`.
    pub fn answer(&mut self, state: &PlantState, handover: &Handover) -> &mut Command {
        let tick = state.stamp.tick;
        let measured = State { pose: state.pose, velocity: state.velocity };
        if self.prepared_for != Some(tick) {
            self.prepare(tick, &measured);
        }
        let (rung, reason, input, solved) = if measured.is_finite() {
            self.plan_for(&measured)
        } else {
            (Rung::Brake, Reason::BadState, self.mpc.limits().reach(&[0.0; 3], &self.last_input), None)
        };
        if rung != self.rung {
            handover.note(Event::Rung { tick, rung, reason });
            self.rung = rung;
        }
        self.write_command(state, rung, input);
        self.write_outcome(solved);
        self.last_input = input;
        &mut self.command
    }

    /// Gets ready for `tick`, with what is known now: called after the answer before it has gone, or for a first state from `state`.
    fn prepare(&mut self, tick: u64, state: &State) {
        for (slot, offset) in self.points.iter_mut().zip(0..) {
            *slot = self.reference.at(tick + offset);
        }
        if self.prepared_for.is_none() {
            self.mpc.begin_at(state);
        }
        self.look(tick);
        let belief = Belief {
            main: &self.main,
            learned: learned(self.method, self.active.as_deref(), &self.least_squares),
            foresight: self.foresight.as_deref(),
            disturbance: self.observer.disturbance(),
        };
        self.mpc.prepare(&self.points, &belief);
        self.prepared_for = Some(tick);
    }

    /// Gets ready for the tick after the one that was answered last: shifts the plan and works its targets out with the present model.
    pub fn prepare_next(&mut self) {
        if let (Some(before), Some(_)) = (self.before, self.prepared_for) {
            self.prepare(before.tick + 1, &before.state);
        }
    }

    /// Rehearses the next answer, shortly before its state is expected: it then finds everything at hand, whatever else the machine has
    /// done meanwhile. Nothing that the answer depends on changes.
    pub fn rehearse(&mut self) {
        if self.prepared_for.is_some() {
            let belief = Belief {
                main: &self.main,
                learned: learned(self.method, self.active.as_deref(), &self.least_squares),
                foresight: self.foresight.as_deref(),
                disturbance: self.observer.disturbance(),
            };
            self.mpc.rehearse(&self.last_input, &self.points, &belief);
        }
    }

    /// The plan behind the last answer, with what it took; called after the command has gone.
    pub fn explain(&mut self, tick_nanos: u64) -> &mut Plan {
        self.write_prediction();
        let plan = &mut self.plan;
        plan.tick_nanos = tick_nanos;
        plan.stamp.tick = self.command.stamp.tick;
        plan.plant_epoch = self.command.plant_epoch;
        plan.model_version = self.command.model_version;
        plan.rung = self.command.rung;
        plan.disturbance = self.observer.disturbance();
        plan.innovation = self.observer.innovation();
        plan.residual = self.residual;
        plan
    }

    fn belief(&self) -> Belief<'_> {
        let learned = learned(self.method, self.active.as_deref(), &self.least_squares);
        Belief { main: &self.main, learned, foresight: self.foresight.as_deref(), disturbance: self.observer.disturbance() }
    }

    /// Lets the foresight, if there is one, take the world as it is at `tick`.
    fn look(&mut self, tick: u64) {
        if let Some(foresight) = &mut self.foresight {
            foresight.look(tick);
        }
    }

    fn plan_for(&mut self, measured: &State) -> (Rung, Reason, Velocity, Option<Solved>) {
        if self.method == Method::FeedforwardP {
            return self.feed_forward(measured);
        }
        let belief = Belief {
            main: &self.main,
            learned: learned(self.method, self.active.as_deref(), &self.least_squares),
            foresight: self.foresight.as_deref(),
            disturbance: self.observer.disturbance(),
        };
        let mut solved = self.mpc.iterate(measured, &self.last_input, &self.points, &belief);
        for _ in 1..if self.foresight.is_some() { FORESEEING_ITERATIONS } else { 1 } {
            solved = self.mpc.iterate(measured, &self.last_input, &self.points, &belief);
        }
        let point = self.points.first().copied().unwrap_or_default();
        let main_target = self.mpc.main_target(&self.main, &point, measured.pose[2], &self.observer.disturbance());
        let (rung, input) = self.ladder.choose(solved.outcome, &self.mpc, measured, &point, &main_target, &self.last_input);
        let reason = if rung == Rung::FreshPlan { Reason::None } else { Reason::SolverFailed };
        (rung, reason, input, Some(solved))
    }

    /// What an engineer would try first: the input that holds the reference, and more of it where the robot is behind.
    fn feed_forward(&self, measured: &State) -> (Rung, Reason, Velocity, Option<Solved>) {
        let point = self.points.first().copied().unwrap_or_default();
        let target = self.mpc.main_target(&self.main, &point, measured.pose[2], &self.observer.disturbance());
        let (sin, cos) = measured.pose[2].sin_cos();
        let [x, y] = [point.pose[0] - measured.pose[0], point.pose[1] - measured.pose[1]];
        let behind = [cos * x + sin * y, cos * y - sin * x, wrap(point.pose[2] - measured.pose[2])];
        let wished = std::array::from_fn(|axis| target[axis] + FEEDFORWARD_GAIN_PER_S * behind[axis]);
        (Rung::FreshPlan, Reason::None, self.mpc.limits().reach(&wished, &self.last_input), None)
    }

    fn start_over(&mut self, state: &PlantState, handover: &Handover, controller_epoch: u64) {
        handover.note(Event::Plant { epoch: state.stamp.epoch, controller_epoch });
        self.plant_epoch = Some(state.stamp.epoch);
        self.before = None;
        self.last_input = state.input;
        self.residual = [0.0; 3];
        self.observer.reset();
        self.least_squares.reset();
        self.mpc.reset();
        self.prepared_for = None;
        self.ladder.reset();
    }

    fn write_command(&mut self, state: &PlantState, rung: Rung, input: Velocity) {
        let command = &mut self.command;
        command.stamp.tick = state.stamp.tick;
        command.plant_epoch = state.stamp.epoch;
        command.model_version = self.active.as_ref().map_or(0, |active| active.version);
        command.rung = rung.code();
        command.input = input;
        // Without a plan the input is held: the gate plays two periods of it at most before it brakes.
        let planned = matches!(rung, Rung::FreshPlan | Rung::ShiftedPlan);
        let limits = self.mpc.limits();
        let (mut before, mut next) = (input, self.mpc.stages().iter().skip(1));
        command.tail = [[0.0; 3]; TAIL_MAX];
        command.tail_len = TAIL_MAX as u32;
        for slot in &mut command.tail {
            let wished = if planned { next.next().map_or(before, |stage| stage.input) } else { input };
            // Beyond the free inputs the target may leap where the reference does; the wheels cannot.
            before = limits.reach(&wished, &before);
            *slot = before;
        }
    }

    fn write_outcome(&mut self, solved: Option<Solved>) {
        let plan = &mut self.plan;
        plan.status = solved.map_or(SolverStatus::NotRun, |solved| solved.outcome.code()).code();
        plan.iterations = solved.map_or(0, |solved| solved.outcome.iterations);
        plan.linearise_nanos = solved.map_or(0, |solved| solved.linearise_nanos);
        plan.solve_nanos = solved.map_or(0, |solved| solved.solve_nanos);
    }

    fn write_prediction(&mut self) {
        let plan = &mut self.plan;
        plan.horizon = self.mpc.horizon().min(HORIZON_MAX) as u32;
        let states = self.mpc.stages().iter().map(|stage| &stage.state).chain(std::iter::once(self.mpc.terminal()));
        for (slot, state) in plan.predicted.iter_mut().zip(states) {
            *slot = state.to_array();
        }
        for (slot, point) in plan.reference.iter_mut().zip(&self.points) {
            *slot = State { pose: point.pose, velocity: point.velocity }.to_array();
        }
        for (slot, stage) in plan.input.iter_mut().zip(self.mpc.stages()) {
            *slot = stage.input;
        }
        let Some(active) = self.active.as_deref_mut() else {
            plan.variance.fill([0.0; 3]);
            return;
        };
        for (slot, stage) in plan.variance.iter_mut().zip(self.mpc.stages()) {
            *slot = active.learned.variance(&stage.state.velocity, &stage.input, &mut active.scratch);
        }
    }
}

/// What is believed beside the main model.
fn learned<'a>(method: Method, active: Option<&'a Candidate>, least_squares: &'a LeastSquares) -> Option<&'a dyn Residual> {
    match method {
        Method::Mpc => active.map(|active| &active.learned as &dyn Residual),
        Method::LeastSquaresMpc => Some(least_squares),
        Method::FeedforwardP | Method::Oracle => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::mpc::tests::settings;
    use crate::reference::{Heading, PathSettings, ReferenceSettings};
    use crate::settings::LearnedSettings;
    use model::gp::hyperparameters::Hyperparameters;
    use model::gp::normalisation::Normalisation;
    use model::gp::posterior::{Posterior, VarianceScratch};
    use model::learned::{INPUTS, Layout, Learned};
    use process::{Pace, Run};
    use protocol::port::Links;

    fn controller() -> Result<Controller, ControllerError> {
        Controller::new(&told())
    }

    fn told() -> Settings {
        let links = Links::on_this_machine("test", "/tmp", true, 0);
        Settings {
            run: Run {
                links,
                folder: "/tmp".into(),
                log: "off".into(),
                epoch_floor: 0,
                restarted: false,
                period_nanos: 100_000_000,
                pace: Pace::LockStep,
            },
            duration_s: 10.0,
            start: [0.0; 3],
            robot: model::robot::Robot::example(),
            reference: ReferenceSettings { path: PathSettings::Circle { radius_m: 2.0, speed_mps: 1.5 }, heading: Heading::Tangent },
            mpc: settings(),
            learned: LearnedSettings { enabled: true, layout: Layout::VelocitySlip, every_ticks: 5, delay_ticks: 3, resumed: false },
        }
    }

    #[test]
    fn an_oracle_without_foresight_is_refused() {
        let mut settings = told();
        settings.mpc.method = Method::Oracle;
        assert!(matches!(Controller::new(&settings), Err(ControllerError::NoForesight)));
    }

    fn state(tick: u64) -> PlantState {
        let mut state: PlantState = bytemuck::Zeroable::zeroed();
        (state.stamp.epoch, state.stamp.tick, state.rung) = (1, tick, Rung::FreshPlan.code());
        state
    }

    fn answer(controller: &mut Controller, state: &PlantState) -> Command {
        let handover = Handover::default();
        controller.observe(state, &handover, 1);
        *controller.answer(state, &handover)
    }

    /// A model whose every answer is not a number.
    fn nonsense() -> Result<Box<Candidate>, Box<dyn std::error::Error>> {
        let normalisation = Normalisation { mean: [f64::NAN; INPUTS], scale: [1.0; INPUTS] };
        let hyperparameters = [Hyperparameters::new([1.0; INPUTS], 1.0, 1e-2); 3];
        let posterior = Posterior::new(&[[0.0; INPUTS]], &[[0.1; 3]], &hyperparameters)?;
        let learned = Learned { layout: Layout::VelocitySlip, normalisation, posterior, bound: [1.0; 3] };
        Ok(Box::new(Candidate { version: 1, plant_epoch: 1, effective_tick: 0, learned, scratch: VarianceScratch::new(1) }))
    }

    #[test]
    fn a_model_that_says_nonsense_costs_the_plan_but_neither_the_lqr_nor_the_tail() -> Result<(), Box<dyn std::error::Error>> {
        let mut controller = controller()?;
        assert_eq!(answer(&mut controller, &state(0)).rung(), Rung::FreshPlan);
        let good = nonsense()?;
        drop(controller.adopt(good));
        let command = answer(&mut controller, &state(1));
        assert_eq!(command.rung(), Rung::Lqr);
        assert!(command.input.iter().chain(command.tail().iter().flatten()).all(|value| value.is_finite()), "{command:?}");
        assert_eq!(command.tail().len(), TAIL_MAX);
        controller.active = None;
        controller.observer.reset();
        assert_eq!(answer(&mut controller, &state(2)).rung(), Rung::FreshPlan, "once the model is gone the plan is back");
        Ok(())
    }

    #[test]
    fn a_state_that_is_no_number_is_answered_with_the_brake() -> Result<(), Box<dyn std::error::Error>> {
        let mut controller = controller()?;
        answer(&mut controller, &state(0));
        let mut blind = state(1);
        blind.velocity[1] = f64::NAN;
        let command = answer(&mut controller, &blind);
        assert_eq!((command.rung(), command.input), (Rung::Brake, [0.0; 3]));
        assert_eq!(answer(&mut controller, &state(2)).rung(), Rung::FreshPlan);
        Ok(())
    }

    #[test]
    fn a_plant_of_another_epoch_begins_with_nothing_remembered() -> Result<(), Box<dyn std::error::Error>> {
        let (mut used, mut fresh) = (controller()?, controller()?);
        for tick in 0..10 {
            let mut moving = state(tick);
            (moving.velocity, moving.input) = ([1.0, 0.2, 0.1], [1.4, 0.0, 0.2]);
            answer(&mut used, &moving);
        }
        let mut reborn = state(0);
        reborn.stamp.epoch = 2;
        let (ours, theirs) = (answer(&mut used, &reborn), answer(&mut fresh, &reborn));
        assert_eq!((ours.input, ours.tail), (theirs.input, theirs.tail));
        Ok(())
    }
}
