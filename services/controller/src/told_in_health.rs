//! The controller's Health reports abandoned and refused models, stuck sensors and missed periods:
//! tests with the real loop, over memory.

use crate::control::Controller;
use crate::control::tests::told;
use crate::run::run;
use crate::sensors::SensorFault;
use crate::settings::{Identify, Settings};
use bytemuck::Zeroable;
use model::Velocity;
use model::gp::hyperparameters::Hyperparameters;
use model::gp::posterior::Posterior;
use model::learned::{INPUTS, Layout, Moment};
use model::main_model::MainModel;
use process::{Pace, Stop};
use protocol::message::{
    Command, FallbackLevel, GateState, Health, INPUTS_MAX, ModelSnapshot, PlantState, SnapshotHead,
};
use robot::Robot;
use std::error::Error;
use std::thread;
use std::time::{Duration, Instant};
use transport::{Exchange, Identity, Ports, Since, Sink, Source};

/// Far longer than any step here takes.
const GIVES_UP_AFTER: Duration = Duration::from_mins(1);

/// The model's residual on the forward axis, per forward velocity.
const LEARNT: f64 = 0.05;

/// A snapshot with g = 0.05 v forward, and zero on the other axes.
fn snapshot(fingerprint: u64) -> Result<ModelSnapshot, Box<dyn Error>> {
    let mut head = SnapshotHead::zeroed();
    (head.version, head.fingerprint, head.inputs) = (1, fingerprint, INPUTS as u32);
    (head.input_scale, head.length_scale) = ([1.0; INPUTS_MAX], [[1.0; INPUTS_MAX]; 3]);
    (head.signal_variance, head.noise_variance, head.linear_variance) =
        ([1e-12; 3], [1e-8; 3], [1.0; 3]);
    let rows: Vec<Moment> = (0..12)
        .map(|i| Moment { velocity: wave(i, 0.7), input: wave(i, 1.9), ..Moment::default() })
        .collect();
    let inputs: Vec<[f64; INPUTS]> =
        rows.iter().map(|at| Layout::VelocitySlip.inputs(at)).collect();
    let targets: Vec<Velocity> =
        rows.iter().map(|at| [LEARNT * at.velocity[0], 0.0, 0.0]).collect();
    let posterior = Posterior::new(
        &inputs,
        &targets,
        &[Hyperparameters::new([1.0; INPUTS], 1e-12, 1e-8).with_linear(1.0); 3],
    )?;
    let mut snapshot = ModelSnapshot::new(head);
    for (row, (input, target)) in inputs.iter().zip(&targets).enumerate() {
        snapshot.push(input, *target, posterior.weights().map(|weights| weights[row]))?;
    }
    Ok(snapshot)
}

fn wave(i: u32, pace: f64) -> Velocity {
    [1.0, 2.0, 3.0].map(|k| (k * pace * f64::from(i)).sin())
}

/// A robot that drives back and forth, and the last Health of its controller.
struct Robotic {
    main: MainModel,
    states: Sink<PlantState>,
    commands: Source<Command>,
    health: Source<Health>,
    state: PlantState,
    position_stuck: bool,
    answer: Option<Command>,
    last: Option<Health>,
}

impl Robotic {
    fn new(ports: &Ports) -> Result<Self, Box<dyn Error>> {
        let mut state = PlantState::zeroed();
        state.gate = GateState::Driving.code();
        (state.fallback_level, state.gate) =
            (FallbackLevel::FreshPlan.code(), GateState::Driving.code());
        let main = MainModel::new(&Robot::example(), 0.1);
        let (states, commands, health) =
            (ports.sink()?, ports.source(Since::First)?, ports.source(Since::First)?);
        Ok(Self {
            main,
            states,
            commands,
            health,
            state,
            position_stuck: false,
            answer: None,
            last: None,
        })
    }

    /// Drives, with a residual of `gain` v forward, until the controller's Health is as `expected`.
    fn drive_until(
        &mut self,
        gain: f64,
        expected: impl Fn(&Health) -> bool,
    ) -> Result<(), Box<dyn Error>> {
        let begin = Instant::now();
        while !self.last.as_ref().is_some_and(&expected) {
            if begin.elapsed() > GIVES_UP_AFTER {
                return Err(format!("what is expected is never said, but {:?}", self.last).into());
            }
            self.drive_on(gain)?;
        }
        Ok(())
    }

    /// The same for its model: (axes in use, times abandoned).
    fn drive_until_model(&mut self, gain: f64, expected: (u64, u64)) -> Result<(), Box<dyn Error>> {
        self.drive_until(gain, |health| (health.learned_axes, health.models_left) == expected)
    }

    fn drive_on(&mut self, gain: f64) -> Result<(), Box<dyn Error>> {
        let before = self.state.velocity[0];
        let after = (0.8 * self.state.stamp.tick as f64).sin();
        self.state.input[0] = (after - (self.main.decay[0] + gain) * before) / self.main.gain[0];
        self.state.velocity[0] = after;
        self.state.pose[0] += if self.position_stuck { 0.0 } else { 0.1 * after };
        self.states.send(&mut self.state)?;
        let begin = Instant::now();
        self.answer = None;
        while self.answer.is_none() && begin.elapsed() < GIVES_UP_AFTER {
            self.commands.wait(Duration::from_millis(20))?;
            self.answer =
                self.commands.next()?.filter(|command| command.stamp.tick == self.state.stamp.tick);
        }
        self.state.stamp.tick += 1;
        while let Some(health) = self.health.next()? {
            self.last = Some(health);
        }
        Ok(())
    }
}

/// Runs a controller while `drive` is its robot, until both end. Returns the controller's last
/// Health.
fn beside_a_controller(
    settings: &Settings,
    drive: impl FnOnce(&Ports, &mut Robotic) -> Result<(), Box<dyn Error>>,
) -> Result<Health, Box<dyn Error>> {
    // A folder of its own keeps what the controller saves at its end.
    let folder = tempfile::tempdir()?;
    let mut settings = settings.clone();
    settings.run.folder = folder.path().to_owned();
    let (exchange, stop) = (Exchange::new(false, Duration::from_secs(1)), Stop::new());
    let ports = Ports::in_memory(&exchange, Identity::new(7));
    let mut robot = Robotic::new(&ports)?;
    thread::scope(|scope| {
        let controller = scope.spawn(|| {
            let connect = |identity| Ok(Ports::in_memory(&exchange, identity));
            run(&settings, connect, &stop).map_err(|error| error.to_string())
        });
        let driven = drive(&ports, &mut robot);
        stop.request();
        controller.join().map_err(|_| "the controller has panicked")??;
        driven
    })?;
    while let Some(health) = robot.health.next()? {
        robot.last = Some(health);
    }
    robot.last.ok_or_else(|| "the controller has said nothing of itself".into())
}

#[test]
fn periods_in_which_the_optimiser_was_stopped_are_counted() -> Result<(), Box<dyn Error>> {
    const TICKS: u64 = 40;
    let mut settings = told();
    settings.run.pace = Pace::RealTime;
    // A period that is always long enough, with a very small share for the optimiser.
    (settings.run.period_nanos, settings.mpc.budget_share) = (100_000_000_000, 1e-12);
    settings.duration_s = 6000.0;
    let health = beside_a_controller(&settings, |_, robot| {
        for _ in 0..TICKS {
            robot.drive_on(0.0)?;
            assert_eq!(
                robot.answer.map(|answer| answer.fallback_level()),
                Some(FallbackLevel::Simple)
            );
        }
        Ok(())
    })?;
    assert_eq!((health.deadlines_missed, health.deadlines_met), (TICKS, 0));
    Ok(())
}

#[test]
fn a_stuck_sensor_is_named() -> Result<(), Box<dyn Error>> {
    let mut settings = told();
    settings.run.pace = Pace::RealTime;
    let health = beside_a_controller(&settings, |_, robot| {
        robot.position_stuck = true;
        robot.drive_until(0.0, |health| !health.last_error().is_empty())
    })?;
    assert_eq!(health.last_error(), SensorFault::Position.text());
    Ok(())
}

#[test]
fn refused_snapshots_are_counted_and_the_last_good_one_stays() -> Result<(), Box<dyn Error>> {
    let damages: [fn(&mut SnapshotHead); 4] = [
        |head| head.fingerprint ^= 1,
        |head| head.version = 0,
        |head| head.score_main[1] = f64::NAN,
        |head| head.noise_variance[2] = 1e9,
    ];
    let mut settings = told();
    settings.run.pace = Pace::RealTime;
    let fingerprint = Controller::expected(&settings).fingerprint;
    let health = beside_a_controller(&settings, |ports, robot| {
        let mut snapshots = ports.sink::<ModelSnapshot>()?;
        snapshots.send(&mut snapshot(fingerprint)?)?;
        robot.drive_until(LEARNT, |health| health.model_version == 1)?;
        for (damage, count) in damages.iter().zip(1..) {
            let mut bad = snapshot(fingerprint)?;
            bad.head.version = 2;
            damage(&mut bad.head);
            snapshots.send(&mut bad)?;
            robot.drive_until(LEARNT, |health| health.snapshots_refused == count)?;
        }
        robot.drive_on(LEARNT)
    })?;
    assert_eq!(
        (health.model_version, health.snapshots, health.snapshots_refused),
        (1, 1, damages.len() as u64)
    );
    Ok(())
}

#[test]
fn a_model_that_becomes_worse_is_abandoned_and_used_again_and_health_reports_it()
-> Result<(), Box<dyn Error>> {
    let mut settings = told();
    settings.run.pace = Pace::RealTime;
    // The identified response would explain as much.
    settings.mpc.identify = Identify::Off;
    let fingerprint = Controller::expected(&settings).fingerprint;
    beside_a_controller(&settings, |ports, robot| {
        let mut snapshots = ports.sink::<ModelSnapshot>()?;
        robot.drive_until_model(LEARNT, (0, 0))?;
        snapshots.send(&mut snapshot(fingerprint)?)?;
        robot.drive_until_model(LEARNT, (1, 0))?;
        robot.drive_until_model(-LEARNT, (0, 1))?;
        robot.drive_until_model(LEARNT, (1, 1))
    })?;
    Ok(())
}
