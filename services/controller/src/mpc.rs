//! The optimiser: a Gauss–Newton real-time iteration of the tracking problem (eqs. 24–26, 32–35).
//!
//! ```text
//! min  Σ_{k<N} |e(x_k)|²_Q + |u_k − t_k|²_R + |u_k − u_{k−1}|²_S  +  |e(x_N)|²_F  + ρ Σ s_k
//! s.t. x_{k+1} = f(x_k, a_k) + g(x_k, a_k) + d,  a_k = (1 − w) u_k + w u_{k−1}
//!      |J u_k| ≤ r ω_max,  |u_k| ≤ u_max,  |u_k − u_{k−1}| ≤ T u̇_max
//!      |J (u_k − u_{k−1})| ≤ T a in its place, for a drive with the ramp a
//!      |k_p J (u_k − v_k + (g + d)/(1 − A))/r| ≤ i_max (1 + s_k)
//!      |θ_k| ≤ θ_max (1 + s_k),  |v_k| ≤ v_max (1 + s_k),  s_k ≥ 0
//!      n·p_k ≤ b_k + s"_k  for each obstacle ([`around`]),  s"_k ≥ 0
//!      −w_r (1 + s'_k) ≤ nᵀ(p_k − p_r) ≤ w_l (1 + s'_k),  s'_k ≥ 0
//! x_0 given, u_{−1} the last command      n: across the reference's course, to the left
//! ```
//! At a chance level, bounds on the state are tightened by the expected prediction error
//! (`tightening`).
//!
//! The cost is on the deviation from the reference, and k counts along the prediction. (Eqs. 26 and
//! 32 write x(k|k) and omit the reference.) One iteration: shift the last plan, predict with it,
//! linearise, solve one convex quadratic program in stages, apply its first input.
//!
//! | here        | in the equations                                  | size  |
//! |-------------|---------------------------------------------------|-------|
//! | `target`    | t: input that holds the reference                 | N × 3 |
//! | `deviation` | u − t, free in the first C periods, then constant | C × 3 |
//!
//! ```
//! use controller::mpc::Mpc;
//! use controller::reference::ReferencePoint;
//! use controller::settings::MpcSettings;
//! use model::State;
//! use model::delay::Split;
//! use model::main_model::MainModel;
//! use model::predict::Belief;
//! use robot::{Robot, WHEELS_MAX};
//!
//! let settings: MpcSettings = toml::from_str(
//!     "horizon_steps = 10
//!      control_horizon_steps = 5
//!      observer_gain = 0.0
//!      weights = { position = 10.0, heading = 5.0, velocity = 1.0, yaw_rate = 0.5,
//!                  input = 0.1, input_change = 0.2, terminal_factor = 3.0 }",
//! )?;
//! let robot = Robot::example();
//! let main = MainModel::new(&robot, 0.1);
//! let (learned, foresight, disturbance, split) = (None, None, [0.0; 3], Split::default());
//! let belief = Belief { main: &main, learned, foresight, disturbance, split };
//! let mut mpc = Mpc::new(&settings, &robot, &main)?;
//! // The robot rests 0.2 m to the right of where it is to rest.
//! let (mut state, mut input) = (State { pose: [0.0, -0.2, 0.0], ..State::default() }, [0.0; 3]);
//! let reference = vec![ReferencePoint::default(); mpc.horizon() + 1];
//! mpc.begin_at(&state);
//! for _ in 0..20 {
//!     mpc.prepare(&reference, &belief); // before the state arrives
//!     assert!(mpc.iterate(&state, &input, &reference, &belief).outcome.usable());
//!     input = mpc.stages()[0].input;
//!     state = belief.predict(&state, &input);
//! }
//! assert!(state.pose[1].abs() < 1e-3);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

pub mod active_set;
pub mod around;
pub mod constraint;
mod cost;
mod expected;
#[cfg(feature = "faults")]
mod faulty;
mod inherit;
pub mod interior_point;
mod iteration;
mod limits;
#[cfg(test)]
mod oracle;
pub mod qp;
pub mod riccati;
pub mod solver;
mod target;
mod tightening;

use crate::reference::ReferencePoint;
#[cfg(feature = "faults")]
use crate::settings::SolverFaults;
use crate::settings::{Linearise, MpcSettings};
use around::Around;
use constraint::{InputLimits, Limits};
use expected::Expectation;
use interior_point::SolverError;
use model::learned::Moment;
use model::linearise::Linearised;
use model::lqr::NoGain;
use model::main_model::MainModel;
use model::predict::Belief;
use model::{State, Velocity};
use nalgebra::SMatrix;
use qp::{QuadraticProgram, Vector, WIDTH};
use robot::{Robot, Surroundings};
use solver::Solver;
use tightening::Tightening;

pub use cost::{Cost, TrackingError};
pub use solver::{Outcome, Status, Turn};

/// The optimiser could not be built.
#[derive(Debug, thiserror::Error)]
pub enum MpcError {
    /// The weights give no LQR gain.
    #[error(transparent)]
    NoGain(#[from] NoGain),
    /// The solver refused the problem's structure.
    #[error(transparent)]
    Solver(#[from] SolverError),
}

/// Form of the tracking problem.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Formulation {
    /// As in the module's head: e in the reference's frame, t holds the reference.
    #[default]
    Holding,
    /// As in most toolboxes, for comparisons with them: e is the plain difference between state and
    /// reference, t the reference's velocity.
    Plain,
}

/// One predicted period.
#[derive(Debug, Clone, Copy, Default)]
pub struct Stage {
    /// Predicted state at its start.
    pub state: State,
    /// Planned input.
    pub input: Velocity,
    /// Input that would hold the reference.
    pub target: Velocity,
}

/// Result of one iteration.
#[derive(Debug, Clone, Copy)]
pub struct Solved {
    /// Status of the solver, after the check of its answer.
    pub outcome: Outcome,
    /// Time spent before the state arrived.
    pub ahead: Spent,
    /// Time spent after the state arrived.
    pub since: Spent,
}

/// Time spent.
#[derive(Debug, Clone, Copy, Default)]
pub struct Spent {
    /// Prediction and linearisation \[ns\].
    pub linearise_nanos: u64,
    /// Quadratic program, written and solved \[ns\].
    pub solve_nanos: u64,
}

/// The present plan, predicted and linearised: the point about which a program is written.
#[derive(Clone, Copy)]
struct PresentPlan<'a> {
    stages: &'a [Stage],
    terminal: &'a State,
    last_input: &'a Velocity,
    /// From the first stage on.
    reference: &'a [ReferencePoint],
    tightening: Option<&'a Tightening>,
}

impl PresentPlan<'_> {
    /// State at the start of period `k`; after the last one the terminal state.
    fn state(&self, k: usize) -> &State {
        self.stages.get(k).map_or(self.terminal, |stage| &stage.state)
    }
}

/// The optimiser with all its memory: set up once, then in place.
pub struct Mpc {
    horizon: usize,
    blocks: usize,
    formulation: Formulation,
    linearise: Linearise,
    cost: Cost,
    limits: Limits,
    stages: Vec<Stage>,
    steps: Vec<Linearised>,
    /// The horizon's last state.
    terminal: State,
    /// Whether these states belong to a plan.
    planned: bool,
    /// u − t of each free period.
    deviation: Vec<Velocity>,
    /// Disturbance for which the targets were computed.
    target_disturbance: Velocity,
    tightening: Option<Tightening>,
    program: QuadraticProgram,
    /// The state and belief for which `program` was prepared, before the state arrived.
    expectation: Option<Expectation>,
    solver: Solver,
    solution: Vec<f64>,
    /// Displacement of the states.
    moves: Vec<Vector>,
    turn: Turn,
    /// The input before the last plan.
    last_input: Velocity,
    held_by_obstacle: bool,
}

impl Mpc {
    /// Sets up the optimiser for one robot, period and horizon.
    ///
    /// # Errors
    /// [`MpcError`] if the weights are ill-posed or the solver refuses the problem.
    pub fn new(settings: &MpcSettings, robot: &Robot, main: &MainModel) -> Result<Self, MpcError> {
        Self::formulated(Formulation::Holding, settings, &InputLimits::of(robot, main.period), main)
    }

    /// The same with rows for obstacles: those of `map`, and those that are
    /// [seen](Self::see_obstacles).
    ///
    /// # Errors
    /// [`MpcError`] if the weights are ill-posed or the solver refuses the problem.
    pub fn among_obstacles(
        settings: &MpcSettings,
        robot: &Robot,
        main: &MainModel,
        map: &Surroundings,
    ) -> Result<Self, MpcError> {
        let around = Around::new(robot, map, main.period);
        let inputs = InputLimits::of(robot, main.period);
        Self::built(Formulation::Holding, settings, &inputs, main, Some(around))
    }

    /// The same for another formulation, or for input limits other than a robot's.
    ///
    /// # Errors
    /// [`MpcError`] if the weights are ill-posed or the solver refuses the problem.
    pub fn formulated(
        formulation: Formulation,
        settings: &MpcSettings,
        inputs: &InputLimits,
        main: &MainModel,
    ) -> Result<Self, MpcError> {
        Self::built(formulation, settings, inputs, main, None)
    }

    fn built(
        formulation: Formulation,
        settings: &MpcSettings,
        inputs: &InputLimits,
        main: &MainModel,
        around: Option<Around>,
    ) -> Result<Self, MpcError> {
        let (horizon, blocks) = (settings.horizon_steps, settings.control_horizon_steps);
        let limits = Limits::new(inputs, &settings.state_limits, horizon, blocks, main);
        let limits = limits.around(around);
        let cost = Cost::new(settings, formulation, main)?;
        let program = QuadraticProgram::new(
            horizon,
            blocks,
            limits.slacks(),
            limits.rows(),
            Limits::with_slacks(cost.penalties()),
        );
        let solver = Solver::new(settings.solver, &program)?;
        let still = Linearised {
            next: State::default(),
            by_state: SMatrix::identity(),
            by_input: SMatrix::zeros(),
            by_acted: SMatrix::zeros(),
            by_difference: SMatrix::zeros(),
            by_residual: SMatrix::zeros(),
        };
        Ok(Self {
            horizon,
            blocks,
            formulation,
            linearise: settings.linearise,
            cost,
            limits,
            stages: vec![Stage::default(); horizon],
            steps: vec![still; horizon],
            terminal: State::default(),
            planned: false,
            deviation: vec![[0.0; 3]; blocks],
            target_disturbance: [0.0; 3],
            tightening: Tightening::at(settings.state_limits.chance_level, horizon),
            solution: vec![0.0; program.unknowns()],
            moves: vec![[0.0; WIDTH]; horizon + 1],
            program,
            expectation: None,
            solver,
            turn: Turn::default(),
            last_input: [0.0; 3],
            held_by_obstacle: false,
        })
    }

    /// The same with these faults of the solver.
    #[cfg(feature = "faults")]
    #[must_use]
    pub fn with_faults(mut self, faults: SolverFaults) -> Self {
        self.solver.inject(faults);
        self
    }

    /// Sets the tick and the deadline of the next iterations. At first no fault happens, and no
    /// clock is read.
    pub fn take_turn(&mut self, turn: Turn) {
        self.turn = turn;
    }

    /// Drops the last plan.
    pub fn reset(&mut self) {
        self.deviation.fill([0.0; 3]);
        self.stages.fill(Stage::default());
        (self.planned, self.expectation, self.held_by_obstacle) = (false, None, false);
    }

    /// Expects the robot to have the heading of `state`, before there is a plan.
    pub fn begin_at(&mut self, state: &State) {
        for stage in &mut self.stages {
            stage.state = *state;
        }
        self.terminal = *state;
        (self.planned, self.expectation) = (false, None);
    }

    /// Plans anew from `state`, because the robot has not done what the present plan says. A plan
    /// that leads past an obstacle where the gate stops the robot would never end otherwise.
    pub fn begin_again(&mut self, state: &State) {
        self.deviation.fill([0.0; 3]);
        self.begin_at(state);
    }

    /// N.
    pub fn horizon(&self) -> usize {
        self.horizon
    }

    /// Weights, LQR gain and tracking error.
    pub fn cost(&self) -> &Cost {
        &self.cost
    }

    /// The predicted periods of the last plan.
    pub fn stages(&self) -> &[Stage] {
        &self.stages
    }

    /// The terminal state of the last plan.
    pub fn terminal(&self) -> &State {
        &self.terminal
    }

    /// Does the work that needs no new state: moves the last plan on by one period, so that its
    /// second input becomes the first, and computes its targets ([`aim`](Self::aim)). `reference`
    /// begins at the next tick. Does not allocate.
    pub fn prepare(&mut self, reference: &[ReferencePoint], belief: &Belief<'_>) {
        self.shift();
        self.aim(reference, belief);
    }

    /// Computes the targets of the plan. `reference` begins at the plan's first tick. A program
    /// that was written for other targets is dropped. Does not allocate.
    pub fn aim(&mut self, reference: &[ReferencePoint], belief: &Belief<'_>) {
        self.expectation = None;
        for (stage, point) in self.stages.iter_mut().zip(reference) {
            stage.target = self.limits.clamp(&target::of(
                self.formulation,
                belief,
                point,
                &stage.state,
                &stage.target,
            ));
        }
        self.target_disturbance = belief.disturbance;
    }

    /// Sets the expected error of each step, before [`iterate`](Self::iterate): `noise` gives the
    /// variance of the residual of one period. The first state of the plan is `under_way` periods
    /// ahead of the measured one. Does not allocate.
    pub fn expect_errors(&mut self, under_way: usize, mut noise: impl FnMut(&Moment) -> Velocity) {
        let Some(tightening) = &mut self.tightening else { return };
        tightening.wait_for(under_way);
        for (k, stage) in self.stages.iter().enumerate() {
            tightening.set_noise(k, noise(&Moment::new(&stage.state, &stage.input)));
        }
    }

    fn shift(&mut self) {
        self.deviation.rotate_left(1);
        if let [.., before, last] = self.deviation.as_mut_slice() {
            *last = *before;
        }
        self.stages.rotate_left(1);
        if let [.., before, last] = self.stages.as_mut_slice() {
            (last.target, last.state) = (before.target, self.terminal);
        }
    }

    /// Input that holds `point` by the main model and a disturbance alone, for a robot with heading
    /// `yaw`.
    pub fn main_target(
        &self,
        main: &MainModel,
        point: &ReferencePoint,
        yaw: f64,
        disturbance: &Velocity,
    ) -> Velocity {
        self.limits.clamp(&main.holding_input(&target::velocity_to_hold(point, yaw), disturbance))
    }
}

#[cfg(test)]
pub(crate) mod tests;
