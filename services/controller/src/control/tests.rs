mod dead_times;
mod faults;
mod ramps;
mod tuning;

use super::*;
use crate::mpc::tests::settings;
use crate::reference::{Heading, PathSettings, ReferenceSettings};
use crate::settings::{
    LearnedSettings, Linearise, SolverFault, SolverFaultKind, SolverFaults, StateLimits,
};
use gate::{Bounds, Gate};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::normalisation::Normalisation;
use model::gp::posterior::{Posterior, VarianceScratch};
use model::learned::{INPUTS, Layout, Learned};
use model::predict::Belief;
use process::Run;
use protocol::message::{GateState, HORIZON_MAX, TAIL_MAX};
use transport::Links;

fn controller() -> Result<Controller, ControllerError> {
    Controller::new(&told())
}

pub(crate) fn told() -> Settings {
    let links = Links::on_this_machine("test", "/tmp", true, 0);
    Settings {
        run: Run { log: "off".into(), ..Run::new("/tmp", 100_000_000, links) },
        duration_s: 10.0,
        start: [0.0; 3],
        robot: robot::Robot::example(),
        reference: ReferenceSettings {
            path: PathSettings::Circle { radius_m: 2.0, speed_mps: 1.5 },
            heading: Heading::Tangent,
            ramp_s: 0.0,
            speed_factor: 1.0,
        },
        goals: Vec::new(),
        map: None,
        sees_obstacles: false,
        mpc: settings(),
        identified: None,
        learned: LearnedSettings {
            enabled: true,
            layout: Layout::VelocitySlip,
            every_ticks: 5,
            delay_ticks: 3,
            resumed: false,
        },
        solver_faults: SolverFaults::default(),
    }
}

#[test]
fn an_oracle_without_foresight_is_refused() {
    let mut settings = told();
    settings.mpc.method = Method::Oracle;
    assert!(matches!(Controller::new(&settings), Err(ControllerError::NoForesight)));
}

pub(super) fn state(tick: u64) -> PlantState {
    let mut state: PlantState = bytemuck::Zeroable::zeroed();
    state.gate = GateState::Driving.code();
    (state.stamp.epoch, state.stamp.tick, state.fallback_level) =
        (1, tick, FallbackLevel::FreshPlan.code());
    // Every reading differs from the others.
    state.pose[0] = 1e-9 * tick as f64;
    state
}

pub(super) fn answer(controller: &mut Controller, state: &PlantState) -> Command {
    let handover = Handover::default();
    controller.observe(state, &handover, 1);
    *controller.answer(state, &handover)
}

/// A model that always returns NaN.
fn nonsense() -> Result<Box<Candidate>, Box<dyn std::error::Error>> {
    let normalisation = Normalisation { mean: [f64::NAN; INPUTS], scale: [1.0; INPUTS] };
    let hyperparameters = [Hyperparameters::new([1.0; INPUTS], 1.0, 1e-2); 3];
    let posterior = Posterior::new(&[[0.0; INPUTS]], &[[0.1; 3]], &hyperparameters)?;
    let learned = Box::new(Learned {
        layout: Layout::VelocitySlip,
        normalisation,
        posterior,
        bound: [1.0; 3],
        sample_variance: [0.0; 3],
    });
    Ok(Box::new(Candidate {
        version: 1,
        plant_epoch: 1,
        effective_tick: 0,
        learned,
        scratch: VarianceScratch::new(1),
    }))
}

#[test]
fn a_model_that_returns_nan_is_never_used() -> Result<(), Box<dyn std::error::Error>> {
    let mut robot = Robotic::new(&told())?;
    for tick in 0..20 {
        drop(robot.controller.adopt(nonsense()?));
        let (_, command) = robot.drive(tick);
        let learned_axes = robot.controller.knowledge().learned_axes();
        assert_eq!((command.fallback_level(), learned_axes), (FallbackLevel::FreshPlan, 0));
        assert!(
            command
                .input
                .iter()
                .chain(command.tail().iter().flatten())
                .all(|value| value.is_finite()),
            "{command:?}"
        );
    }
    Ok(())
}

#[test]
fn a_state_that_is_not_finite_is_answered_with_the_brake() -> Result<(), Box<dyn std::error::Error>>
{
    let mut controller = controller()?;
    answer(&mut controller, &state(0));
    let mut blind = state(1);
    blind.velocity[1] = f64::NAN;
    let command = answer(&mut controller, &blind);
    assert_eq!((command.fallback_level(), command.input), (FallbackLevel::Brake, [0.0; 3]));
    assert_eq!(answer(&mut controller, &state(2)).fallback_level(), FallbackLevel::FreshPlan);
    Ok(())
}

#[test]
fn a_plant_of_another_epoch_begins_without_memory() -> Result<(), Box<dyn std::error::Error>> {
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

#[test]
fn a_dead_time_that_the_driver_reports_is_compensated_from_the_start()
-> Result<(), Box<dyn std::error::Error>> {
    let mut controller = controller()?;
    for (epoch, reported_s, periods) in
        [(1, 0.2, 2), (2, 0.0, 0), (3, f64::NAN, 0), (4, -0.3, 0), (5, 0.5, 5)]
    {
        let mut first = state(0);
        (first.stamp.epoch, first.input_delay_s) = (epoch, reported_s);
        answer(&mut controller, &first);
        assert_eq!(controller.knowledge().delay().whole(), periods, "{reported_s} s");
    }
    Ok(())
}

const PERIOD_NANOS: u64 = 100_000_000;

/// A robot that matches the belief, behind its gate.
pub(super) struct Robotic {
    pub(super) controller: Controller,
    gate: Gate,
    pub(super) state: State,
    input: Velocity,
    fallback_level: FallbackLevel,
    /// State at which its sensors are stuck.
    stuck: Option<State>,
}

impl Robotic {
    pub(super) fn new(settings: &Settings) -> Result<Self, ControllerError> {
        let gate = Gate::new(Bounds::new(&settings.robot, PERIOD_NANOS, 0), 1);
        Ok(Self {
            controller: Controller::new(settings)?,
            gate,
            state: State::default(),
            input: [0.0; 3],
            fallback_level: FallbackLevel::Waiting,
            stuck: None,
        })
    }

    /// One period: the gate's decision on the answer, and the answer.
    pub(super) fn drive(&mut self, tick: u64) -> (Result<(), Reason>, Command) {
        self.gate.begin_period(tick, tick * PERIOD_NANOS);
        let seen = self.stuck.unwrap_or(self.state);
        let mut measured = state(tick);
        (measured.pose, measured.velocity, measured.input) = (seen.pose, seen.velocity, self.input);
        measured.fallback_level = self.fallback_level.code();
        let command = answer(&mut self.controller, &measured);
        self.controller.explain(0);
        self.controller.prepare_next();
        let verdict = self.gate.offer(&command, tick * PERIOD_NANOS);
        self.input = self.gate.decide(tick * PERIOD_NANOS).input;
        self.fallback_level = self.gate.end_period((tick + 1) * PERIOD_NANOS).0;
        self.state = self.controller.knowledge().belief().predict(&self.state, &self.input);
        (verdict, command)
    }
}

/// A model with this number of points on the inputs of a drive. Each point has its own target.
fn learned(points: usize) -> Result<Box<Candidate>, Box<dyn std::error::Error>> {
    let normalisation = Normalisation { mean: [0.0; INPUTS], scale: [1.0; INPUTS] };
    let wave = |index: usize, axis: usize| (0.37 * index as f64 * (axis + 1) as f64).sin();
    let inputs: Vec<[f64; INPUTS]> =
        (0..points).map(|index| std::array::from_fn(|axis| 2.0 * wave(index, axis))).collect();
    let targets: Vec<[f64; 3]> =
        (0..points).map(|index| std::array::from_fn(|axis| 0.05 * wave(index, axis + 2))).collect();
    let posterior =
        Posterior::new(&inputs, &targets, &[Hyperparameters::new([1.0; INPUTS], 0.05, 1e-2); 3])?;
    let learned = Box::new(Learned {
        layout: Layout::VelocitySlip,
        normalisation,
        posterior,
        bound: [1.0; 3],
        sample_variance: [1e-4; 3],
    });
    Ok(Box::new(Candidate {
        version: 1,
        plant_epoch: 1,
        effective_tick: 0,
        learned,
        scratch: VarianceScratch::new(points),
    }))
}

#[test]
fn from_a_state_to_its_command_nothing_is_allocated() -> Result<(), Box<dyn std::error::Error>> {
    for linearise in [Linearise::Measured, Linearise::Expected] {
        let mut settings = told();
        settings.mpc.linearise = linearise;
        nothing_is_allocated(&settings)?;
    }
    Ok(())
}

fn nothing_is_allocated(settings: &Settings) -> Result<(), Box<dyn std::error::Error>> {
    let mut robot = Robotic::new(settings)?;
    robot.controller.adopt(learned(100)?);
    let handover = Handover::default();
    let mut fresh = 0;
    for tick in 0..80 {
        if tick % 20 == 10 {
            // Now limits are active.
            robot.state.pose[1] += 0.8;
        }
        let mut measured = state(tick);
        (measured.pose, measured.velocity, measured.input) =
            (robot.state.pose, robot.state.velocity, robot.input);
        let heap = allocation_counter::measure(|| {
            robot.controller.observe(&measured, &handover, 1);
            let command = robot.controller.answer(&measured, &handover);
            (robot.input, fresh) = (
                command.input,
                fresh + u32::from(command.fallback_level() == FallbackLevel::FreshPlan),
            );
        });
        let after = allocation_counter::measure(|| {
            robot.controller.explain(0);
            robot.controller.prepare_next();
        });
        assert_eq!(
            (heap.count_total, after.count_total),
            (0, 0),
            "tick {tick}: {} and {} bytes",
            heap.bytes_total,
            after.bytes_total
        );
        robot.state = robot.controller.knowledge().belief().predict(&robot.state, &robot.input);
    }
    assert_eq!(fresh, 80);
    Ok(())
}

/// The robot holds its input in the tick without an answer, so nothing but the tick differs from
/// what the prepared program was written for.
#[test]
fn after_a_skipped_tick_no_program_of_the_earlier_tick_is_used()
-> Result<(), Box<dyn std::error::Error>> {
    let mut settings = told();
    settings.mpc.linearise = Linearise::Expected;
    let (mut skips, mut forgets) = (Robotic::new(&settings)?, Robotic::new(&settings)?);
    for tick in 0..20 {
        assert_eq!(skips.drive(tick).1, forgets.drive(tick).1);
    }
    forgets.controller.planner.mpc.forget_expectation();
    let mut later = state(21);
    (later.pose, later.velocity) = (skips.state.pose, skips.state.velocity);
    later.input = skips.input;
    let (ours, theirs) =
        (answer(&mut skips.controller, &later), answer(&mut forgets.controller, &later));
    assert_eq!((ours.input, ours.tail), (theirs.input, theirs.tail));
    Ok(())
}
