//! A model that is left and taken again, as the controller's Health tells it: with the real loop, over memory.

use crate::control::Controller;
use crate::control::tests::told;
use crate::run::run;
use bytemuck::Zeroable;
use model::Velocity;
use model::gp::hyperparameters::Hyperparameters;
use model::gp::posterior::Posterior;
use model::learned::{INPUTS, Layout, Moment};
use model::main_model::MainModel;
use model::robot::Robot;
use process::{Pace, Stop};
use protocol::message::{Command, Health, INPUTS_MAX, ModelSnapshot, PlantState, Rung, SnapshotHead};
use protocol::port::{Exchange, Identity, Ports, Since, Sink, Source};
use std::error::Error;
use std::thread;
use std::time::{Duration, Instant};

/// Far longer than anything here takes.
const GIVES_UP_AFTER: Duration = Duration::from_mins(1);

/// What the model says of the forward axis, per forward velocity.
const LEARNT: f64 = 0.05;

/// A snapshot that says g = 0.05 v forward, and nothing of the other axes.
fn snapshot(fingerprint: u64) -> Result<ModelSnapshot, Box<dyn Error>> {
    let mut head = SnapshotHead::zeroed();
    (head.version, head.fingerprint, head.inputs) = (1, fingerprint, INPUTS as u32);
    (head.input_scale, head.length_scale) = ([1.0; INPUTS_MAX], [[1.0; INPUTS_MAX]; 3]);
    (head.signal_variance, head.noise_variance, head.linear_variance) = ([1e-12; 3], [1e-8; 3], [1.0; 3]);
    let rows: Vec<Moment> = (0..12).map(|i| Moment { velocity: wave(i, 0.7), input: wave(i, 1.9), ..Moment::default() }).collect();
    let inputs: Vec<[f64; INPUTS]> = rows.iter().map(|at| Layout::VelocitySlip.inputs(at)).collect();
    let targets: Vec<Velocity> = rows.iter().map(|at| [LEARNT * at.velocity[0], 0.0, 0.0]).collect();
    let posterior = Posterior::new(&inputs, &targets, &[Hyperparameters::new([1.0; INPUTS], 1e-12, 1e-8).with_linear(1.0); 3])?;
    let mut snapshot = ModelSnapshot::new(head);
    for (row, (input, target)) in inputs.iter().zip(&targets).enumerate() {
        snapshot.push(input, *target, posterior.weights().map(|weights| weights[row]))?;
    }
    Ok(snapshot)
}

fn wave(i: u32, pace: f64) -> Velocity {
    [1.0, 2.0, 3.0].map(|k| (k * pace * f64::from(i)).sin())
}

/// A robot that drives to and fro, and what its controller says of itself.
struct Robotic {
    main: MainModel,
    states: Sink<PlantState>,
    commands: Source<Command>,
    health: Source<Health>,
    state: PlantState,
    said: Option<Health>,
}

impl Robotic {
    fn new(ports: &Ports) -> Result<Self, Box<dyn Error>> {
        let mut state = PlantState::zeroed();
        state.rung = Rung::FreshPlan.code();
        let main = MainModel::new(&Robot::example(), 0.1);
        let (states, commands, health) = (ports.sink()?, ports.source(Since::First)?, ports.source(Since::First)?);
        Ok(Self { main, states, commands, health, state, said: None })
    }

    /// Drives, with a residual of `gain` v forward, until the controller says that it is so with its model: (axes in use, times left).
    fn drive_until(&mut self, gain: f64, expected: (u64, u64)) -> Result<(), Box<dyn Error>> {
        let begin = Instant::now();
        while self.said.is_none_or(|health| (health.learned_axes, health.models_left) != expected) {
            if begin.elapsed() > GIVES_UP_AFTER {
                return Err(
                    format!("{expected:?} is never said: {:?}", self.said.map(|health| (health.learned_axes, health.models_left))).into()
                );
            }
            self.drive_on(gain)?;
        }
        Ok(())
    }

    fn drive_on(&mut self, gain: f64) -> Result<(), Box<dyn Error>> {
        let before = self.state.velocity[0];
        let after = (0.8 * self.state.stamp.tick as f64).sin();
        self.state.input[0] = (after - (self.main.decay[0] + gain) * before) / self.main.gain[0];
        self.state.velocity[0] = after;
        self.state.pose[0] += 0.1 * after;
        self.states.send(&mut self.state)?;
        while self.commands.next()?.is_none_or(|command| command.stamp.tick != self.state.stamp.tick) {
            self.commands.wait(Duration::from_millis(20))?;
        }
        self.state.stamp.tick += 1;
        while let Some(health) = self.health.next()? {
            self.said = Some(health);
        }
        Ok(())
    }
}

#[test]
fn periods_whose_optimiser_had_to_be_stopped_are_counted_one_by_one() -> Result<(), Box<dyn Error>> {
    const TICKS: u64 = 40;
    let (exchange, stop) = (Exchange::new(false, Duration::from_secs(1)), Stop::new());
    let ports = Ports::in_memory(&exchange, Identity::new(7));
    let mut settings = told();
    settings.run.pace = Pace::RealTime;
    // A period that nothing takes, of which the optimiser has next to nothing.
    (settings.run.period_nanos, settings.mpc.budget_share) = (100_000_000_000, 1e-12);
    settings.duration_s = 6000.0;
    let mut robot = Robotic::new(&ports)?;
    thread::scope(|scope| {
        let controller = scope.spawn(|| {
            let connect = |identity| Ok(Ports::in_memory(&exchange, identity));
            run(&settings, connect, &stop).map_err(|error| error.to_string())
        });
        let mut drive = || -> Result<(), Box<dyn Error>> {
            for _ in 0..TICKS {
                robot.drive_on(0.0)?;
            }
            Ok(())
        };
        let driven = drive();
        stop.request();
        controller.join().map_err(|_| "the controller has panicked")??;
        driven
    })?;
    while let Some(health) = robot.health.next()? {
        robot.said = Some(health);
    }
    let said = robot.said.ok_or("the controller has said nothing of itself")?;
    assert_eq!((said.deadlines_missed, said.deadlines_met), (TICKS, 0));
    Ok(())
}

#[test]
fn a_stuck_sensor_is_named() -> Result<(), Box<dyn Error>> {
    let (exchange, stop) = (Exchange::new(false, Duration::from_secs(1)), Stop::new());
    let ports = Ports::in_memory(&exchange, Identity::new(7));
    let mut settings = told();
    settings.run.pace = Pace::RealTime;
    let (mut states, mut commands, mut health) =
        (ports.sink::<PlantState>()?, ports.source::<Command>(Since::First)?, ports.source::<Health>(Since::First)?);
    thread::scope(|scope| {
        let controller = scope.spawn(|| {
            let connect = |identity| Ok(Ports::in_memory(&exchange, identity));
            run(&settings, connect, &stop).map_err(|error| error.to_string())
        });
        let mut drive = || -> Result<(), Box<dyn Error>> {
            let mut state = PlantState::zeroed();
            (state.rung, state.velocity) = (Rung::FreshPlan.code(), [1.0, 0.0, 0.0]);
            for tick in 0..10 {
                state.stamp.tick = tick;
                states.send(&mut state)?;
                let answer = loop {
                    commands.wait(Duration::from_millis(20))?;
                    if let Some(command) = commands.next()? {
                        break command;
                    }
                };
                assert_eq!(answer.rung() == Rung::Brake, tick >= 3, "{tick}");
            }
            Ok(())
        };
        let driven = drive();
        stop.request();
        controller.join().map_err(|_| "the controller has panicked")??;
        driven
    })?;
    let mut said = None;
    while let Some(health) = health.next()? {
        said = Some(health);
    }
    assert_eq!(said.ok_or("nothing is said")?.last_error(), crate::sensors::SensorFault::Position.text());
    Ok(())
}

#[test]
fn a_model_that_turns_worse_is_left_and_taken_again_and_health_says_so() -> Result<(), Box<dyn Error>> {
    let (exchange, stop) = (Exchange::new(false, Duration::from_secs(1)), Stop::new());
    let ports = Ports::in_memory(&exchange, Identity::new(7));
    let mut settings = told();
    settings.run.pace = Pace::RealTime;
    let fingerprint = Controller::expected(&settings).fingerprint;
    let mut robot = Robotic::new(&ports)?;
    let mut snapshots = ports.sink::<ModelSnapshot>()?;
    thread::scope(|scope| {
        let controller = scope.spawn(|| {
            let connect = |identity| Ok(Ports::in_memory(&exchange, identity));
            run(&settings, connect, &stop).map_err(|error| error.to_string())
        });
        let mut drive = || -> Result<(), Box<dyn Error>> {
            robot.drive_until(LEARNT, (0, 0))?;
            snapshots.send(&mut snapshot(fingerprint)?)?;
            robot.drive_until(LEARNT, (1, 0))?;
            robot.drive_until(-LEARNT, (0, 1))?;
            robot.drive_until(LEARNT, (1, 1))
        };
        let driven = drive();
        stop.request();
        controller.join().map_err(|_| "the controller has panicked")??;
        driven
    })
}
