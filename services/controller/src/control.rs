//! One tick, as a block diagram: each block is a type with its own state.
//!
//! ```text
//!            observe                                answer
//!  state ─▶ measure ─▶ observe, select model ─▶ predict, optimise ─▶ guard ─▶ publish ─▶ command
//!           Watch      Knowledge                Planner              Guard    Publisher
//! ```
//!
//! Afterwards [`Controller::explain`] gives the plan behind the command, and
//! [`Controller::prepare_next`] does the work of the next tick that needs no new state.
//!
//! Between a state and its command nothing here allocates, locks, logs, blocks, or touches a file
//! or socket.

mod between_ticks;
mod decide;
mod goal_watch;
mod guard;
mod planner;
mod publisher;
mod reference_clock;
mod seen;
pub mod tuning;

use crate::adopt::{Candidate, Event, Expected, Handover};
use crate::complaints::LimitsInUse;
use crate::identified::Identified;
use crate::knowledge::{Knowledge, Period};
use crate::mpc::{MpcError, Solved};
use crate::reference::PointsError;
use crate::sensors::{Driven, SensorFault, Watch};
use crate::settings::{Method, Settings};
use goal_watch::GoalWatch;
use guard::Guard;
use model::foresight::Foresight;
use model::main_model::{MainModel, fingerprint};
use model::residual::bound;
use model::{State, Velocity};
use planner::Planner;
use protocol::message::{
    Command, FallbackLevel, GateState, ObstacleSource, Plan, PlantState, Reason, ResidualSample,
};
use publisher::Publisher;
use robot::{Limits, Obstacle};
use tuning::Tuned;

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

/// A robot before an obstacle is held up if its reference is farther ahead than this, and than it
/// drives in this time \[m, s\].
const HELD_UP: (f64, f64) = (0.25, 0.5);
/// A reference that is slower stands \[m/s\].
const STANDS_MPS: f64 = 0.01;

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
///
/// ```
/// use controller::Settings;
/// use controller::adopt::Handover;
/// use controller::control::Controller;
/// use model::State;
/// use process::Run;
/// use protocol::message::{GateState, PlantState};
/// use transport::Links;
///
/// let links = Links::on_this_machine("example", "/tmp", true, 0);
/// let mut settings: toml::Table = toml::from_str(
///     "duration_s = 5.0
///      start = [0.0, 0.0, 0.0]
///      learned = { enabled = false, layout = 'velocity-slip', every_ticks = 5, delay_ticks = 3 }
///      [reference]
///      path.circle = { radius_m = 2.0, speed_mps = 0.8 }
///      heading = 'tangent'
///      [mpc]
///      horizon_steps = 10
///      control_horizon_steps = 5
///      observer_gain = 0.3
///      weights = { position = 10.0, heading = 5.0, velocity = 1.0, yaw_rate = 0.5,
///                  input = 0.1, input_change = 0.2, terminal_factor = 3.0 }",
/// )?;
/// settings.insert("run".into(), toml::Value::try_from(Run::new("/tmp", 100_000_000, links))?);
/// settings.insert("robot".into(), toml::Value::try_from(robot::Robot::example())?);
/// let settings: Settings = settings.try_into()?;
/// let (mut controller, handover) = (Controller::new(&settings)?, Handover::default());
/// let (mut robot, mut state) = (State::default(), <PlantState as bytemuck::Zeroable>::zeroed());
/// (state.stamp.epoch, state.gate) = (1, GateState::Driving.code());
/// for tick in 0..50 {
///     (state.stamp.tick, state.pose, state.velocity) = (tick, robot.pose, robot.velocity);
///     controller.observe(&state, &handover, 1);
///     let command = *controller.answer(&state, &handover);
///     controller.prepare_next(); // in the rest of the period
///     robot = controller.knowledge().belief().predict(&robot, &command.input);
///     (state.input, state.fallback_level) = (command.input, command.fallback_level);
/// }
/// let [x, y, _] = robot.pose;
/// assert!((x.hypot(y - 2.0) - 2.0).abs() < 0.01, "on the circle around (0, 2)");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
pub struct Controller {
    method: Method,
    fingerprint: u64,
    plant_epoch: Option<u64>,
    before: Option<Before>,
    watch: Watch,
    knowledge: Knowledge,
    planner: Planner,
    guard: Guard,
    publisher: Publisher,
    goal: GoalWatch,
    /// Whether an obstacle holds the robot up.
    held_up: bool,
    /// Whether the robot holds its pose when a plant starts, in place of the reference.
    holds_at_start: bool,
    gate: GateState,
    /// Limits of the inputs, and of the gate's ramp.
    limits: Limits,
    period_s: f64,
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
        let method = settings.mpc.method;
        let foresight = if method == Method::Oracle {
            Some(foresight.ok_or(ControllerError::NoForesight)?)
        } else {
            None
        };
        let main = MainModel::new(&settings.robot, settings.run.period_nanos as f64 * 1e-9);
        Ok(Self {
            method,
            fingerprint: fingerprint(&main, settings.learned.layout.name()),
            plant_epoch: None,
            before: None,
            watch: Watch::new(main, bound(&main, &settings.robot)),
            knowledge: Knowledge::new(settings, main, foresight),
            planner: Planner::new(
                Tuned::new(settings, None)?,
                method,
                settings.run.period_nanos as f64 * 1e-9,
            ),
            guard: Guard::new(settings),
            publisher: Publisher::new(),
            goal: GoalWatch::default(),
            held_up: false,
            holds_at_start: false,
            gate: GateState::Armed,
            limits: settings.robot.limits,
            period_s: settings.run.period_nanos as f64 * 1e-9,
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
        self.gate = state.gate();
        let braking = self.braking_periods(&state.velocity);
        let by_obstacle = state.reason().is_slowed() || self.is_held_by_obstacle();
        self.held_up = by_obstacle && self.is_behind(state);
        if by_obstacle {
            self.guard.approach_reference();
        }
        let waits = self.held_up || matches!(self.gate, GateState::Disarmed | GateState::Stopped);
        self.planner.let_reference_wait(waits, state.stamp.tick, braking, &mut self.knowledge);
        if state.reason().is_slowed() {
            self.planner.plan_again(state, &mut self.knowledge);
        }
        // Other goals wait. A velocity would move the robot long after its time.
        if waits && self.goal.is_past_velocity(state.stamp.tick) {
            self.goal.abort();
            self.planner.hold_now(state.pose, &mut self.knowledge);
        }
        let all_measured = state.wheel_speed().len() == self.knowledge.wheels();
        let wheel_speed = all_measured.then_some(&state.wheel_speed);
        let now = self.knowledge.measured(state.pose, state.velocity, wheel_speed);
        let mut sample: ResidualSample = bytemuck::Zeroable::zeroed();
        sample.stamp.tick = state.stamp.tick;
        sample.plant_epoch = state.stamp.epoch;
        sample.fingerprint = self.fingerprint;
        let ours = matches!(
            state.fallback_level(),
            FallbackLevel::FreshPlan | FallbackLevel::ShiftedPlan | FallbackLevel::Simple
        ) && !state.reason().is_slowed();
        let commanded = ours.then(|| self.publisher.commanded());
        let seen = self.measure(state, &Driven { acted: state.input, commanded }, handover);
        if seen && !by_obstacle {
            self.guard.judge_tracking(state, &self.planner, handover);
        }
        let input_known = state.input.iter().all(|value| value.is_finite()) && seen;
        if let Some(before) =
            self.before.filter(|before| before.tick + 1 == state.stamp.tick && input_known)
        {
            let Before { tick, state: before } = before;
            let ramp = self.knowledge.ramp_mps2();
            self.knowledge.observe(&Period { tick, before, given: state.input, after: now });
            let rate_mps2 = self.knowledge.ramp_mps2();
            if rate_mps2 != ramp {
                handover.note(Event::Ramp { tick: state.stamp.tick, rate_mps2 });
            }
            self.guard.watch_period(state, &mut self.planner, &self.knowledge);
            self.knowledge.write_sample(&before, &mut sample);
            sample.usable = u32::from(ours && !self.guard.slides());
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

    /// Takes the obstacles that `source` knew at `tick`. Does not allocate.
    pub fn see_obstacles(&mut self, source: ObstacleSource, obstacles: &[Obstacle], tick: u64) {
        self.planner.seen.replace(source, obstacles, tick);
    }

    /// Whether an obstacle holds the last plan.
    pub fn is_held_by_obstacle(&self) -> bool {
        self.planner.mpc.is_held_by_obstacle()
    }

    /// Whether the reference is far ahead of the robot, along its course; far away, if it stands. A
    /// robot that is beside a reference that moves passes the obstacle.
    fn is_behind(&self, state: &PlantState) -> bool {
        let reference = self.planner.reference_at(state.stamp.tick);
        let (sin, cos) = reference.course.sin_cos();
        let [x, y] = [0, 1].map(|axis| reference.pose[axis] - state.pose[axis]);
        let speed = reference.velocity[0].hypot(reference.velocity[1]);
        let ahead = if speed > STANDS_MPS { cos * x + sin * y } else { x.hypot(y) };
        ahead > HELD_UP.0.max(HELD_UP.1 * speed)
    }

    /// Time that the gate's ramp needs to a standstill \[periods\].
    fn braking_periods(&self, velocity: &Velocity) -> f64 {
        let Limits { input_mps, yaw_input_radps, brake_mps2, yaw_brake_radps2, .. } = self.limits;
        let top = [(input_mps, brake_mps2), (input_mps, brake_mps2)];
        let axes = top.into_iter().chain([(yaw_input_radps, yaw_brake_radps2)]);
        let periods = velocity.iter().zip(axes).map(|(speed, (top, brake))| {
            // A measurement that is not possible is not believed.
            let speed = speed.abs();
            if speed <= 2.0 * top { speed / (brake * self.period_s) } else { 0.0 }
        });
        periods.fold(0.0, f64::max)
    }

    /// Whether the measurements are plausible.
    fn measure(&mut self, state: &PlantState, driven: &Driven, handover: &Handover) -> bool {
        let (before, fault) = (self.watch.fault(), self.watch.look(state, driven));
        if fault != before {
            handover.note(Event::Sensors { tick: state.stamp.tick, fault });
        }
        fault.is_none()
    }

    /// What the last answer says of the limits.
    pub fn limits_in_use(&self) -> LimitsInUse {
        LimitsInUse {
            contradicted: self.guard.contradicted_limit(),
            reached: self.planner.mpc.reached_limit(),
        }
    }

    /// The fault of the newest state, if there is one.
    pub fn sensor_fault(&self) -> Option<SensorFault> {
        self.watch.fault()
    }

    /// Whether the optimiser was stopped in the last answer because its time was used up.
    pub fn ran_out_of_time(&self) -> bool {
        self.publisher.ran_out_of_time()
    }

    /// Answers `state`, the newest that was [observed](Self::observe). The answer has the highest
    /// fallback level whose command the gate would accept.
    pub fn answer(&mut self, state: &PlantState, handover: &Handover) -> &mut Command {
        let (tick, measured) = (state.stamp.tick, self.knowledge.state());
        self.planner.begin_answer(tick, &measured, &mut self.knowledge);
        let mut decision = if self.watch.fault().is_none() && measured.is_finite() {
            self.decide(&measured)
        } else {
            self.brake(Reason::BadState)
        };
        self.write(state, &decision);
        while let Err(reason) = self.judged(state)
            && decision.fallback_level != FallbackLevel::Brake
        {
            decision = Decision {
                solved: decision.solved,
                ..self.next_fallback_level(decision.fallback_level, reason, &measured)
            };
            self.write(state, &decision);
        }
        if self.goal.has_goal() {
            let reference_tick = self.planner.reference_tick(tick);
            let reference = self.planner.reference();
            self.goal.look(reference_tick, self.period_s, &measured, reference);
        }
        let Decision { fallback_level, reason, .. } = decision;
        if self.publisher.settle(&decision) {
            handover.note(Event::FallbackLevel { tick, fallback_level, reason });
        }
        self.guard.keep_foretold_currents(fallback_level, &self.planner.mpc);
        self.publisher.command_mut()
    }

    fn write(&mut self, state: &PlantState, decision: &Decision) {
        let (version, stop) = (self.knowledge.version(), self.guard.stop_request());
        self.publisher.write_command(state, decision, version, stop, &self.planner.mpc);
    }

    /// The gate's decision on the command, as far as it can be predicted here.
    fn judged(&self, state: &PlantState) -> Result<(), Reason> {
        let acting = self.planner.mpc.limits().clamp(&self.knowledge.last_command());
        self.guard.judge(self.publisher.command(), state, acting)
    }

    /// The last answer.
    pub fn last_answer(&self) -> &Command {
        self.publisher.command()
    }

    /// The plan behind the last answer, with its costs. Called after the command has been sent.
    pub fn explain(&mut self, tick_nanos: u64) -> &mut Plan {
        let measured = self.before.map_or(State::default(), |before| before.state);
        self.publisher.explain(tick_nanos, &measured, &self.planner, &mut self.knowledge)
    }

    /// Prepares for the tick after the last answered one: shifts the plan and computes its targets
    /// with the present model.
    pub fn prepare_next(&mut self) {
        if let Some(Before { tick, state }) = self.before.filter(|_| self.planner.has_begun()) {
            let commanded = self.publisher.commanded();
            self.planner.prepare_ahead(tick + 1, &state, &commanded, &mut self.knowledge);
        }
    }

    /// Rehearses the next answer, shortly before its state is expected. The answer then finds its
    /// code and data in the caches, whatever else the machine has run meanwhile. Nothing that the
    /// answer depends on changes.
    pub fn rehearse(&mut self) {
        self.planner.rehearse(&self.knowledge);
    }

    fn start_over(&mut self, state: &PlantState, handover: &Handover, controller_epoch: u64) {
        handover.note(Event::Plant { epoch: state.stamp.epoch, controller_epoch });
        self.plant_epoch = Some(state.stamp.epoch);
        self.before = None;
        self.watch.reset();
        self.knowledge.reset(state.input_delay_s);
        self.guard.reset();
        self.planner.reset();
        self.goal.abort();
        if self.holds_at_start {
            self.planner.hold(state.pose);
        }
        self.planner.drop_current_rows(self.guard.dropped_current_rows());
    }
}

#[cfg(test)]
pub(crate) mod tests;
