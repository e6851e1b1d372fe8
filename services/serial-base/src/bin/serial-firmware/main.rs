//! A simulated firmware at a pseudo-terminal, for tests and for a first try without hardware.
//!
//! | module     | what it holds                                                        |
//! |------------|----------------------------------------------------------------------|
//! | `terminal` | the pseudo-terminal that stands for the serial port                  |
//! | `motors`   | the robot: watchdog, acceleration, odometry                          |
//! | `noise`    | a bad cable: lines that are damaged, cut off, lost or late           |
//! | `record`   | what the motors did, as a table                                      |

mod motors;
mod noise;
mod record;
mod terminal;

use clap::Parser;
use motors::Motors;
use noise::{Cable, Noise};
use record::Record;
use robot::Robot;
use rustix::time::{ClockId, clock_gettime};
use serial_base::line::{SensorLine, VelocityLine};
use serial_base::port::Lines;
use std::path::PathBuf;
use std::thread;
use std::time::Duration;
use terminal::Terminal;

/// Interval of the control loop.
const STEP: Duration = Duration::from_millis(2);
/// Steps from one sensor line to the next.
const STEPS_PER_LINE: u64 = 5;

/// The firmware of a simulated base, at a pseudo-terminal in place of a serial port. It is the
/// robot of deploy/robots/mecanum.toml, and runs until it is ended.
#[derive(Debug, Parser)]
#[command(version)]
struct Arguments {
    /// Symbolic link to create, which leads to the pseudo-terminal: `port` of the driver.
    #[arg(long, value_name = "FILE")]
    link: PathBuf,
    /// Table to write: what the motors did in each step.
    #[arg(long, value_name = "FILE")]
    record: Option<PathBuf>,
    #[command(flatten)]
    noise: Noise,
}

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    // Before the link: the table exists as soon as the port does.
    let mut record = arguments.record.as_deref().map(Record::create).transpose()?;
    let terminal = Terminal::open(&arguments.link)?;
    let mut firmware = Firmware::new(&arguments.noise);
    for step in 0.. {
        let now = nanos();
        firmware.step(&terminal, now, step % STEPS_PER_LINE == 0)?;
        if let Some(record) = &mut record {
            record.write(now, &firmware.motors, firmware.rejected)?;
        }
        // After the row: a firmware that is killed in between has sent nothing that has none.
        firmware.send(&terminal, now)?;
        thread::sleep(STEP);
    }
    Ok(())
}

/// The monotonic clock \[ns\].
fn nanos() -> u64 {
    let now = clock_gettime(ClockId::Monotonic);
    now.tv_sec as u64 * 1_000_000_000 + now.tv_nsec as u64
}

struct Firmware {
    robot: Robot,
    motors: Motors,
    lines: Lines,
    /// From the driver, and to it.
    incoming: Cable,
    outgoing: Cable,
    /// Sequence number of the next sensor line.
    sequence: u32,
    /// Number of velocity lines that were rejected.
    rejected: u32,
}

impl Firmware {
    fn new(noise: &Noise) -> Self {
        Self {
            robot: Robot::example(),
            motors: Motors::default(),
            lines: Lines::default(),
            incoming: Cable::new(noise, 1),
            outgoing: Cable::new(noise, 2),
            sequence: 0,
            rejected: 0,
        }
    }

    fn step(&mut self, terminal: &Terminal, now: u64, sends: bool) -> anyhow::Result<()> {
        let incoming = &mut self.incoming;
        self.lines.take(&terminal.receive()?, |line| incoming.put(now, line));
        while let Some(line) = self.incoming.take(now) {
            match VelocityLine::decode(&line) {
                Ok(velocity) => self.motors.command(now, &velocity),
                Err(_) => self.rejected += 1,
            }
        }
        self.motors.advance(now);
        if sends {
            let mut text = String::new();
            self.sensed().encode(&mut text);
            self.outgoing.put(now, text.trim_end().as_bytes());
            self.sequence += 1;
        }
        Ok(())
    }

    /// Sends the lines that have arrived at the end of the cable.
    fn send(&mut self, terminal: &Terminal, now: u64) -> anyhow::Result<()> {
        while let Some(mut line) = self.outgoing.take(now) {
            line.push(b'\n');
            terminal.send(&line)?;
        }
        Ok(())
    }

    fn sensed(&self) -> SensorLine {
        let speeds = self.robot.wheels.speeds(self.motors.velocity());
        SensorLine {
            sequence: self.sequence,
            pose: self.motors.pose_micro(),
            velocity: self.motors.velocity_micro(),
            estop: false,
            watchdog: self.motors.stopped_by_watchdog(),
            rejected: self.rejected,
            wheels: self.robot.wheels.count(),
            wheel_speed: speeds.map(serial_base::line::millionths),
        }
    }
}
