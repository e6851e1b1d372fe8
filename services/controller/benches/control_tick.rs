//! One control tick of the paper's scenario: observe, answer, explain; with the main model alone
//! and with a learned one of 120 points. Then the preparation of a model of 200 points. Then a tick
//! among eight obstacles beside one without. Then a
//! million ticks on a circle, with a push off it every forty ticks, and their allocations and page
//! faults.
//!
//! `cargo bench -p controller --bench control_tick`
#![expect(clippy::print_stdout, reason = "figures are what a bench is for")]

use controller::adopt::{Candidate, Expected, Handover, prepare};
use controller::control::Controller;
use controller::settings::{
    DelaySetting, Identify, LearnedSettings, Linearise, Method, MpcSettings, Observers, Settings,
    SolverFaults, SolverSetting, StateLimits, Weights,
};
use criterion::{Criterion, criterion_group};
use model::gp::hyperparameters::Hyperparameters;
use model::gp::normalisation::Normalisation;
use model::gp::posterior::{Posterior, PosteriorError, VarianceScratch};
use model::learned::{INPUTS, Layout, Learned};
use model::{AXES, State};
use process::Run;
use protocol::clock::monotonic_nanos;
use protocol::message::{
    FallbackLevel, GateState, INPUTS_MAX, ModelSnapshot, ObstacleSource, PlantState, SnapshotHead,
};
use robot::{ImpossibleShape, Obstacle, Robot, Shape, Wheels};
use std::error::Error;
use std::hint::black_box;
use transport::Links;

const POINTS: usize = 120;
/// Largest change of a velocity that a model may explain.
const BOUND: [f64; AXES] = [0.5; AXES];
const TICKS: u64 = 1_000_000;
/// Number of them that are not measured.
const WARM_UP: u64 = 100;

fn settings() -> Settings {
    let links = Links::on_this_machine("bench", "/tmp", true, 0);
    Settings {
        run: Run { log: "off".into(), ..Run::new("/tmp", 100_000_000, links) },
        duration_s: 25.0,
        start: [0.0; 3],
        robot: Robot::example(),
        reference: controller::reference::ReferenceSettings {
            path: controller::reference::PathSettings::PaperCurve { speed_mps: 2.7 },
            heading: controller::reference::Heading::Tangent,
            ramp_s: 0.0,
            speed_factor: 1.0,
        },
        goals: Vec::new(),
        map: None,
        sees_obstacles: false,
        mpc: MpcSettings {
            horizon_steps: 5,
            control_horizon_steps: 3,
            weights: Weights {
                position: 10.0,
                heading: 5.0,
                velocity: 2.0,
                yaw_rate: 1.0,
                input: 0.05,
                input_change: 0.2,
                terminal_factor: 3.0,
            },
            state_limits: StateLimits { heading_rad: Some(1.047), ..StateLimits::default() },
            observer_gain: 0.0,
            method: Method::Mpc,
            delay: DelaySetting::Estimated,
            identify: Identify::Response,
            observers: Observers::Gains,
            no_harm: true,
            linearise: Linearise::Measured,
            solver: SolverSetting::ActiveSet,
            budget_share: 0.5,
        },
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

/// Wheel speeds that belong to the velocity.
fn measure_wheels(state: &mut PlantState, wheels: &Wheels) {
    (state.wheels, state.wheel_speed_valid) = (wheels.count() as u32, 1);
    state.wheel_speed = wheels.speeds(state.velocity);
}

const NORMALISATION: Normalisation<INPUTS> =
    Normalisation { mean: [0.0; INPUTS], scale: [0.5; INPUTS] };
const HYPERPARAMETERS: Hyperparameters<INPUTS> = Hyperparameters::new([4.0; INPUTS], 0.01, 1e-5);

/// Normalised inputs along a drive at the scenario's speed, and the residuals of the main model
/// there.
fn data(points: usize) -> (Vec<[f64; INPUTS]>, Vec<[f64; AXES]>) {
    let wave = |i: usize, k: f64| (k * i as f64).sin();
    let inputs: Vec<[f64; INPUTS]> = (0..points)
        .map(|i| {
            [
                2.7 + 0.3 * wave(i, 0.7),
                0.2 * wave(i, 1.1),
                0.2 * wave(i, 0.3),
                0.3,
                0.0,
                0.1 * wave(i, 1.9),
            ]
        })
        .collect();
    let targets = (0..points)
        .map(|i| [-0.09 + 0.01 * wave(i, 0.9), 0.02 * wave(i, 1.3), 0.02 * wave(i, 0.2)])
        .collect();
    (inputs.iter().map(|input| NORMALISATION.apply(input)).collect(), targets)
}

/// A learned model with this number of points.
fn candidate(points: usize) -> Result<Box<Candidate>, PosteriorError> {
    let (inputs, targets) = data(points);
    let posterior = Posterior::new(&inputs, &targets, &[HYPERPARAMETERS; AXES])?;
    let learned = Box::new(Learned {
        layout: Layout::VelocitySlip,
        normalisation: NORMALISATION,
        posterior,
        bound: BOUND,
        sample_variance: [0.0; AXES],
    });
    Ok(Box::new(Candidate {
        version: 1,
        plant_epoch: 1,
        effective_tick: 0,
        learned,
        scratch: VarianceScratch::new(points),
    }))
}

/// The same in the form that a learner sends.
fn snapshot(points: usize) -> Result<ModelSnapshot, Box<dyn Error>> {
    let mut head: SnapshotHead = bytemuck::Zeroable::zeroed();
    (head.version, head.inputs, head.input_scale) = (1, INPUTS as u32, [0.5; INPUTS_MAX]);
    head.length_scale = [[4.0; INPUTS_MAX]; AXES];
    (head.signal_variance, head.noise_variance) = ([0.01; AXES], [1e-5; AXES]);
    let (inputs, targets) = data(points);
    let posterior = Posterior::new(&inputs, &targets, &[HYPERPARAMETERS; AXES])?;
    let mut snapshot = ModelSnapshot::new(head);
    for (i, (input, target)) in inputs.iter().zip(&targets).enumerate() {
        snapshot.push(input, *target, posterior.weights().map(|weights| weights[i]))?;
    }
    Ok(snapshot)
}

/// From a snapshot to a model for the control thread: checked, with its posterior computed again.
/// Runs on a thread beside the control thread.
fn adoption() -> Result<(), Box<dyn Error>> {
    let expected = Expected { fingerprint: 0, layout: Layout::VelocitySlip, bound: BOUND };
    let snapshot = snapshot(200)?;
    prepare(&snapshot, &expected)?;
    let mut criterion = Criterion::default().configure_from_args();
    criterion.bench_function("adoption of 200 points", |bencher| {
        bencher.iter(|| prepare(black_box(&snapshot), &expected));
    });
    Ok(())
}

fn control_tick(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("control tick");
    for learned in [false, true] {
        let Ok(mut controller) = Controller::new(&settings()) else { return };
        if learned && let Ok(candidate) = candidate(POINTS) {
            drop(controller.adopt(candidate));
        }
        let handover = Handover::default();
        let mut state: PlantState = bytemuck::Zeroable::zeroed();
        state.gate = GateState::Driving.code();
        (state.stamp.epoch, state.stamp.tick, state.fallback_level) =
            (1, 0, FallbackLevel::FreshPlan.code());
        (state.velocity, state.input) = ([2.7, 0.0, 0.0], [2.7, 0.0, 0.0]);
        measure_wheels(&mut state, &Robot::example().wheels);
        group.bench_function(if learned { "120 points" } else { "main model" }, |bencher| {
            bencher.iter(|| {
                state.stamp.tick = (state.stamp.tick + 1) % 200;
                state.pose = [0.27 * state.stamp.tick as f64, 0.0, 0.0];
                black_box(controller.observe(&state, &handover, 1));
                black_box(controller.answer(&state, &handover));
                black_box(controller.explain(0));
                controller.prepare_next();
            });
        });
    }
    group.finish();
}

/// Page faults of this thread so far.
fn page_faults() -> Result<u64, Box<dyn Error>> {
    let stat = std::fs::read_to_string("/proc/thread-self/stat")?;
    // After the name: state, five numbers, flags, minor faults, those of children, major ones.
    let behind_name = stat.rsplit_once(')').ok_or("no name in /proc/thread-self/stat")?.1;
    let fields: Vec<&str> = behind_name.split_whitespace().collect();
    let of = |place: usize| {
        fields
            .get(place)
            .and_then(|field| field.parse::<u64>().ok())
            .ok_or("no faults in /proc/thread-self/stat")
    };
    Ok(of(7)? + of(9)?)
}

/// Checks that a million ticks, including the optimiser at its limits, cause no allocation and no
/// page fault. Measures their times.
fn million_ticks() -> Result<(), Box<dyn Error>> {
    let mut settings = settings();
    settings.duration_s = 1e-9 * (TICKS * settings.run.period_nanos) as f64;
    settings.reference.path =
        controller::reference::PathSettings::Circle { radius_m: 2.0, speed_mps: 1.5 };
    let mut controller = Controller::new(&settings)?;
    drop(controller.adopt(candidate(16)?));
    let handover = Handover::default();
    let mut measured: PlantState = bytemuck::Zeroable::zeroed();
    measured.gate = GateState::Driving.code();
    measured.stamp.epoch = 1;
    let (mut robot, mut fresh, mut times) = (State::default(), 0_u64, vec![1; TICKS as usize]);
    let mut drive = |ticks: std::ops::Range<u64>| {
        for tick in ticks {
            if tick.is_multiple_of(40) {
                robot.pose[1] += 0.5;
            }
            (measured.stamp.tick, measured.fallback_level) =
                (tick, FallbackLevel::FreshPlan.code());
            (measured.pose, measured.velocity, measured.input) =
                (robot.pose, robot.velocity, robot.acted);
            measure_wheels(&mut measured, &settings.robot.wheels);
            let begin = monotonic_nanos();
            controller.observe(&measured, &handover, 1);
            let command = controller.answer(&measured, &handover);
            let (input, is_fresh) =
                (command.input, command.fallback_level() == FallbackLevel::FreshPlan);
            times[tick as usize] = monotonic_nanos() - begin;
            fresh += u64::from(is_fresh);
            black_box(controller.explain(0));
            controller.prepare_next();
            robot = controller.knowledge().belief().predict(&robot, &input);
        }
    };
    drive(0..WARM_UP);
    let before = page_faults()?;
    let heap = allocation_counter::measure(|| drive(WARM_UP..TICKS));
    let faults = page_faults()? - before;
    times.sort_unstable();
    let micros = |share: f64| 1e-3 * times[(share * (TICKS - 1) as f64) as usize] as f64;
    let [p50, p99, p9999] = [0.5, 0.99, 0.9999].map(micros);
    println!(
        "{{\"ticks\":{TICKS},\"fresh_plans\":{fresh},\"allocations\":{},\"page_faults\":{faults},\
         \"answer_p50_us\":{p50},\"answer_p99_us\":{p99},\"answer_p9999_us\":{p9999}}}",
        heap.count_total
    );
    if heap.count_total > 0 || faults > 0 {
        return Err(format!(
            "{} bytes were allocated, {faults} pages were missing",
            heap.bytes_total
        )
        .into());
    }
    Ok(())
}

/// Discs around the robot.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Around {
    /// None, and no tick is prepared for any.
    Nothing,
    /// None, but each tick is prepared for them.
    Prepared,
    /// An alley of standing discs along the circle, 0.35 m beside the robot's centre. The nearest
    /// eight are in the program.
    Alley,
    /// Eight that move with the robot, close around it.
    Enclosed,
}

impl Around {
    const ALL: [Self; 4] = [Self::Nothing, Self::Prepared, Self::Alley, Self::Enclosed];
    const RADIUS_M: f64 = 0.2;
    const APART_M: f64 = 0.55;

    /// Its discs, around a robot on the circle of radius 2 m about (0, 2).
    fn write(self, robot: &State, discs: &mut Vec<Obstacle>) -> Result<(), ImpossibleShape> {
        discs.clear();
        let mut add = |centre: [f64; 2], velocity_mps: [f64; 2]| {
            let shape = Shape::hull(&[centre], Self::RADIUS_M)?;
            discs.push(Obstacle { shape, velocity_mps });
            Ok(())
        };
        match self {
            Self::Nothing | Self::Prepared => Ok(()),
            Self::Alley => (0..36).try_for_each(|i| {
                let (y, x) = (std::f64::consts::PI / 18.0 * f64::from(i)).sin_cos();
                let side = if i % 2 == 0 { Self::APART_M } else { -Self::APART_M };
                add([(2.0 + side) * x, 2.0 + (2.0 + side) * y], [0.0; 2])
            }),
            Self::Enclosed => {
                let (sin, cos) = robot.pose[2].sin_cos();
                let [forward, left, _] = robot.velocity;
                let velocity = [cos * forward - sin * left, sin * forward + cos * left];
                (0..8).try_for_each(|i| {
                    let (y, x) = (std::f64::consts::FRAC_PI_4 * f64::from(i)).sin_cos();
                    let [centre_x, centre_y, _] = robot.pose;
                    add([centre_x + Self::APART_M * x, centre_y + Self::APART_M * y], velocity)
                })
            }
        }
    }
}

/// Median times of a whole tick on a circle, with N = 20, T = 20 ms and 100 learned points, for each
/// arrangement of discs. No tick allocates.
fn obstacles() -> Result<(), Box<dyn Error>> {
    const MEASURED: usize = 20_000;
    let mut settings = settings();
    settings.run.period_nanos = 20_000_000;
    settings.duration_s = 0.02 * MEASURED as f64 + 10.0;
    settings.reference.path =
        controller::reference::PathSettings::Circle { radius_m: 2.0, speed_mps: 1.0 };
    (settings.mpc.horizon_steps, settings.mpc.control_horizon_steps) = (20, 10);
    let mut without = f64::NAN;
    for around in Around::ALL {
        settings.sees_obstacles = around != Around::Nothing;
        let mut controller = Controller::new(&settings)?;
        drop(controller.adopt(candidate(100)?));
        let handover = Handover::default();
        let mut measured: PlantState = bytemuck::Zeroable::zeroed();
        (measured.gate, measured.stamp.epoch) = (GateState::Driving.code(), 1);
        let (mut robot, mut times) = (State::default(), Vec::with_capacity(MEASURED));
        let (mut discs, mut held) = (Vec::with_capacity(36), 0_u64);
        // Iterations of the solver, and times to linearise and to solve [ns], means.
        let mut sums = [0.0; 3];
        let mut tick_once = |tick: usize| -> Result<(), ImpossibleShape> {
            (measured.stamp.tick, measured.fallback_level) =
                (tick as u64, FallbackLevel::FreshPlan.code());
            (measured.pose, measured.velocity, measured.input) =
                (robot.pose, robot.velocity, robot.acted);
            measure_wheels(&mut measured, &settings.robot.wheels);
            around.write(&robot, &mut discs)?;
            let begin = monotonic_nanos();
            if !discs.is_empty() {
                controller.see_obstacles(ObstacleSource::Robot, &discs, tick as u64);
            }
            controller.observe(&measured, &handover, 1);
            let input = controller.answer(&measured, &handover).input;
            let plan = controller.explain(0);
            let of_plan = [u64::from(plan.iterations), plan.linearise_nanos, plan.solve_nanos];
            controller.prepare_next();
            if tick >= WARM_UP as usize {
                times.push(monotonic_nanos() - begin);
                for (sum, value) in sums.iter_mut().zip(of_plan) {
                    *sum += value as f64 / MEASURED as f64;
                }
                held += u64::from(controller.is_held_by_obstacle());
            }
            robot = controller.knowledge().belief().predict(&robot, &input);
            Ok(())
        };
        (0..WARM_UP as usize).try_for_each(&mut tick_once)?;
        let mut done = Ok(());
        let heap = allocation_counter::measure(|| {
            done = (WARM_UP as usize..WARM_UP as usize + MEASURED).try_for_each(&mut tick_once);
        });
        done?;
        if heap.count_total > 0 {
            return Err(format!("{} bytes were allocated", heap.bytes_total).into());
        }
        times.sort_unstable();
        let median = 1e-3 * times[times.len() / 2] as f64;
        if around == Around::Nothing {
            without = median;
        }
        let [iterations, linearise, solve] = sums;
        println!(
            "{{\"around\":\"{around:?}\",\"tick_us\":{median:.1},\"of_none\":{:.2},\
             \"held_share\":{:.2},\"iterations\":{iterations:.0},\"linearise_us\":{:.1},\
             \"solve_us\":{:.1}}}",
            median / without,
            held as f64 / MEASURED as f64,
            1e-3 * linearise,
            1e-3 * solve
        );
    }
    Ok(())
}

criterion_group!(benches, control_tick);

fn main() -> Result<(), Box<dyn Error>> {
    benches();
    adoption()?;
    obstacles()?;
    Criterion::default().configure_from_args().final_summary();
    million_ticks()
}
