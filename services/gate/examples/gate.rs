//! The gate alone: `cargo run -p gate --example gate`.
//!
//! It accepts one command with a tail, and receives no further one. It plays the tail, then brakes.

use gate::{Bounds, Gate};
use protocol::message::{Command, FallbackLevel};
use robot::Robot;
use std::io::{self, Write};

const PERIOD_NANOS: u64 = 20_000_000;

fn main() -> io::Result<()> {
    let mut gate = Gate::new(Bounds::new(&Robot::example(), PERIOD_NANOS, 0), 1);
    let mut command: Command = bytemuck::Zeroable::zeroed();
    (command.plant_epoch, command.stamp.epoch, command.stamp.tick) = (1, 1, 0);
    (command.fallback_level, command.input) = (FallbackLevel::FreshPlan.code(), [0.05, 0.0, 0.0]);
    command.tail_len = 2;
    (command.tail[0], command.tail[1]) = ([0.04, 0.0, 0.0], [0.03, 0.0, 0.0]);
    let mut out = io::stdout();
    for tick in 0..6 {
        let now = tick * PERIOD_NANOS;
        gate.begin_period(tick, now);
        if tick == 0 {
            writeln!(out, "offered: {:?}", gate.offer(&command, now))?;
        }
        let decision = gate.decide(now);
        let [forward, ..] = decision.input;
        writeln!(out, "tick {tick} forward {forward:.3} m/s, {}", decision.fallback_level)?;
        gate.end_period(now + PERIOD_NANOS);
    }
    Ok(())
}
