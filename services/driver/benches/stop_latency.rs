//! Time from an operator's stop to the first braking output of the gate, in real time:
//! `cargo bench -p driver --bench stop_latency [-- TRIALS]`.
//!
//! Each trial writes the request as `coxswain stop` does, to a driver that runs as in its process.
//! A controller answers every state with 1 m/s. The time ends when the base gets less than that.
//! The start of the command `coxswain` itself is not part of it.

#![expect(clippy::print_stdout, reason = "figures are what a bench is for")]

use driver::{Base, BaseError, Sensors, Settings, run};
use process::requests::{Request, ask, welcome};
use process::{Run, Stop};
use protocol::clock::monotonic_nanos;
use protocol::message::{Command, FallbackLevel, Participant, PlantState};
use robot::Robot;
use std::error::Error;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;
use std::time::Duration;
use transport::{Exchange, Identity, Links, Ports, Since};

const PERIOD_NANOS: u64 = 20_000_000;
const SPEED: f64 = 1.0;
const TRIALS: usize = 1000;

/// A base that notes when it gets its full speed last, and less than that first.
#[derive(Default)]
struct Noting {
    sensors: Sensors,
    /// Time of the newest output at full speed, and of the first one below it after that \[ns\].
    full: Arc<AtomicU64>,
    below: Arc<AtomicU64>,
}

impl Base for Noting {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        Ok(self.sensors)
    }

    fn drive(&mut self, velocity: [f64; 3], _: u64) -> Result<(), BaseError> {
        let now = monotonic_nanos();
        if velocity[0] >= SPEED {
            self.full.store(now, Ordering::Release);
            self.below.store(0, Ordering::Release);
        } else if self.below.load(Ordering::Acquire) == 0 {
            self.below.store(now, Ordering::Release);
        }
        Ok(())
    }
}

/// Answers each state until `stop`.
fn answer(ports: &Ports, stop: &Stop) -> Result<(), Box<dyn Error + Send + Sync>> {
    let (mut states, mut commands) =
        (ports.source::<PlantState>(Since::First)?, ports.sink::<Command>()?);
    commands.set_epoch(1);
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.fallback_level, command.input) = (FallbackLevel::FreshPlan.code(), [SPEED, 0.0, 0.0]);
    while !stop.requested() {
        states.wait(Duration::from_millis(5))?;
        if let Some(state) = states.latest()? {
            (command.plant_epoch, command.stamp.tick) = (state.stamp.epoch, state.stamp.tick);
            commands.send(&mut command)?;
        }
    }
    Ok(())
}

fn order(folder: &Path, given: &str) -> Result<u64, Box<dyn Error>> {
    let request = Request { who: "bench".into(), asked_unix_nanos: 0, change: given.into() };
    let begin = monotonic_nanos();
    let asked = ask(folder, Participant::Plant, &request)?;
    while asked.answer().is_none() {
        thread::sleep(Duration::from_millis(1));
    }
    Ok(begin)
}

/// Waits until `value` is above `least`, and returns it.
fn above(value: &AtomicU64, least: u64) -> u64 {
    loop {
        let now = value.load(Ordering::Acquire);
        if now > least {
            return now;
        }
        thread::sleep(Duration::from_millis(1));
    }
}

fn measure(folder: &Path, base: &Noting, trials: usize) -> Result<Vec<u64>, Box<dyn Error>> {
    let (full, below) = (&base.full, &base.below);
    let mut nanos = Vec::with_capacity(trials);
    for trial in 0..trials {
        let driving = above(full, monotonic_nanos());
        // Another place within the period in each trial.
        thread::sleep(Duration::from_micros(PERIOD_NANOS / 1000 * (trial as u64 * 7 % 20) / 20));
        let begin = order(folder, "stop")?;
        nanos.push(above(below, driving).saturating_sub(begin));
        order(folder, "resume")?;
    }
    nanos.sort_unstable();
    Ok(nanos)
}

fn main() -> Result<(), Box<dyn Error>> {
    let trials = std::env::args().find_map(|text| text.parse().ok()).unwrap_or(TRIALS);
    let folder = tempfile::tempdir()?;
    welcome(folder.path())?;
    let links = Links::on_this_machine("bench", folder.path(), false, 0);
    let process_run = Run::new(folder.path(), PERIOD_NANOS, links);
    let robot = Robot::example();
    let settings = Settings {
        run: &process_run,
        duration_s: 1e5,
        link_delay_millis: 0,
        recorded: false,
        robot: &robot,
        armed: true,
        surroundings: None,
        lists: &[],
    };
    let (exchange, stop) = (Exchange::new(false, Duration::from_secs(1)), Stop::new());
    let base = Noting::default();
    let (full, below) = (Arc::clone(&base.full), Arc::clone(&base.below));
    let watched = Noting { full, below, ..Noting::default() };
    let nanos = thread::scope(|scope| {
        let plant = Ports::in_memory(&exchange, Identity::new(1));
        let controller = Ports::in_memory(&exchange, Identity::new(2));
        let stop = &stop;
        let settings = &settings;
        scope.spawn(move || run(base, settings, &plant, Identity::new(1), stop));
        scope.spawn(move || answer(&controller, stop));
        let nanos = measure(folder.path(), &watched, trials);
        stop.request();
        nanos
    })?;
    let share = |percent: usize| {
        let index = (nanos.len() * percent / 100).min(nanos.len().saturating_sub(1));
        nanos.get(index).copied().unwrap_or(0) as f64 * 1e-6
    };
    let beyond = nanos.iter().filter(|&&nanos| nanos > PERIOD_NANOS).count();
    println!(
        "stop → first braking output, {} trials, T = {} ms: {:.1} ms p50, {:.1} ms p99, {:.1} ms \
         at most; {beyond} above T",
        nanos.len(),
        PERIOD_NANOS / 1_000_000,
        share(50),
        share(99),
        share(100)
    );
    Ok(())
}
