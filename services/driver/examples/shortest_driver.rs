//! The shortest driver: `cargo run -p driver --example shortest_driver`.
//!
//! [`Base`] is all that the author of a robot writes. [`GatedBase`] puts the gate in front of it.
//! Here a constant command arrives in the first 20 periods, then none.

use driver::gated::GatedBase;
use driver::{Base, BaseError, Sensors, Settings};
use process::Run;
use protocol::message::{Command, FallbackLevel, Reason};
use robot::Robot;
use std::error::Error;
use std::io::{self, Write};
use transport::Links;

const PERIOD_NANOS: u64 = 20_000_000;

/// A robot that follows each velocity at once. A real one reads its sensors, and writes to motors.
#[derive(Default)]
struct Ideal(Sensors);

impl Base for Ideal {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        Ok(self.0)
    }

    fn drive(&mut self, velocity: [f64; 3], nanos: u64) -> Result<(), BaseError> {
        let ([forward, left, rate], seconds) = (velocity, nanos as f64 * 1e-9);
        let (sin, cos) = self.0.pose[2].sin_cos();
        let step = [cos * forward - sin * left, sin * forward + cos * left, rate];
        self.0.pose = std::array::from_fn(|axis| self.0.pose[axis] + step[axis] * seconds);
        self.0.velocity = velocity;
        Ok(())
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let robot = Robot::example();
    let run = Run::new("/tmp", PERIOD_NANOS, Links::on_this_machine("example", "/tmp", true, 0));
    let settings = Settings {
        run: &run,
        duration_s: 1.0,
        link_delay_millis: 0,
        recorded: false,
        robot: &robot,
        armed: true,
        surroundings: None,
        lists: &[],
    };
    let mut driver = GatedBase::new(Ideal::default(), &settings, 1);
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.plant_epoch, command.stamp.epoch) = (1, 1);
    (command.fallback_level, command.input) = (FallbackLevel::FreshPlan.code(), [0.05, 0.0, 0.0]);
    for tick in 0..settings.ticks() {
        let now = tick * PERIOD_NANOS;
        let sensors = driver.read()?;
        let (state, _) = driver.begin_period(tick, now, &sensors);
        command.stamp.tick = tick;
        if tick < 20 {
            driver.offer(&command, now)?.map_err(Reason::text)?;
        }
        let level = driver.end_period(now + PERIOD_NANOS)?;
        if tick % 10 == 0 {
            writeln!(io::stdout(), "tick {tick} x {:.4} m, {level}", state.pose[0])?;
        }
    }
    Ok(())
}
