//! The base behind a serial port: measurements in, velocities and watchdog out.

use crate::line::{Refusal, SensorLine, VelocityLine, millionths};
use crate::port::Port;
use driver::base::per_wheel;
use driver::{Base, BaseError, ProgramSettings, Sensors, Start};
use process::{Pace, Repeated};
use robot::{PerWheel, Velocity};
use serde::Deserialize;
use settings::{Check, Impossible};
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// Longest time until the first sensor line. A microcontroller may have restarted when the port
/// was opened.
const FIRST_WITHIN: Duration = Duration::from_secs(3);
/// Without a sensor line for this time the driver ends. The controller brakes earlier, because the
/// measurements do not change.
const SILENT_AFTER: Duration = Duration::from_millis(500);
/// Slowest port. A velocity line goes out every 8 ms, as a rule, and takes half of that time.
const BAUD_MIN: u32 = 115_200;
/// Fastest port that Linux has.
const BAUD_MAX: u32 = 4_000_000;

/// `[driver.settings]` of the graph file.
#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SerialSettings {
    /// Device file of the port, such as `/dev/ttyUSB0`.
    pub port: PathBuf,
    /// Baud rate. A port over USB ignores it as a rule.
    #[serde(default = "baud")]
    pub baud: u32,
}

fn baud() -> u32 {
    BAUD_MIN
}

impl Check for SerialSettings {
    fn check(&self) -> Result<(), Impossible> {
        if !self.port.is_absolute() {
            return Err(Impossible::new("port", "an absolute path, such as /dev/ttyUSB0"));
        }
        if !(BAUD_MIN..=BAUD_MAX).contains(&self.baud) {
            return Err(Impossible::new("baud", format!("{BAUD_MIN} to {BAUD_MAX}")));
        }
        Ok(())
    }
}

/// A line, or an event that a line reports, which is logged with its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, thiserror::Error)]
enum Fault {
    #[error("sensor lines {0}")]
    Refused(Refusal),
    #[error("sensor lines that are too long")]
    TooLong,
    #[error("sensor lines lost")]
    Lost,
    #[error("sensor lines that came twice")]
    Twice,
    #[error("velocity lines that the base rejected")]
    Rejected,
    #[error("velocity lines not sent because the port was busy")]
    Busy,
    #[error("stops of the motors by the watchdog of the base")]
    Watchdog,
}

/// A base at a serial port.
#[derive(Debug)]
pub struct SerialBase {
    port: Port,
    /// Number of wheels of the robot file.
    wheels: usize,
    world_from_odometry: Transform,
    /// The newest measurements, and when they arrived.
    sensed: SensorLine,
    arrived: Instant,
    faults: Repeated<Fault>,
    /// Sequence number of the next velocity line.
    sequence: u32,
    valid_millis: u16,
    /// Time from which on the next velocity line may be sent.
    next_line: Instant,
    text: String,
}

impl SerialBase {
    /// Opens the port, and waits for the first measurements.
    ///
    /// # Errors
    /// [`BaseError`] if it is no serial port, or the base does not fit the robot file.
    pub fn open(settings: &ProgramSettings<SerialSettings>) -> Result<Self, BaseError> {
        if settings.run.pace != Pace::RealTime {
            return Err(BaseError::Refused {
                key: "run.pace".into(),
                expected: "real-time: a real base does not wait".into(),
            });
        }
        let SerialSettings { port, baud } = &settings.base;
        Self::at(Port::open(port, *baud)?, settings.robot.wheels.count(), settings.start)
    }

    /// A base of so many `wheels` at `port`, which stands at `start` by definition.
    fn at(port: Port, wheels: usize, start: Start) -> Result<Self, BaseError> {
        let now = Instant::now();
        let mut this = Self {
            port,
            wheels,
            world_from_odometry: Transform::default(),
            sensed: SensorLine::default(),
            arrived: now,
            faults: Repeated::default(),
            sequence: 0,
            valid_millis: 0,
            next_line: now,
            text: String::new(),
        };
        while !this.receive(None)? {
            let left = FIRST_WITHIN.saturating_sub(now.elapsed());
            if left.is_zero() {
                return Err(this.silent(FIRST_WITHIN));
            }
            this.port.wait(left);
        }
        this.world_from_odometry = Transform::between(this.sensed.pose_m(), start.pose);
        Ok(this)
    }

    /// Takes the lines that have arrived after the one with the number `last`. Returns whether
    /// there is a measurement among them.
    fn receive(&mut self, mut last: Option<u32>) -> Result<bool, BaseError> {
        let (faults, before) = (&mut self.faults, self.sensed);
        let (mut newest, mut restarted) = (None, false);
        let too_long = self.port.receive(|line| match SensorLine::decode(line) {
            Err(refusal) => faults.note(Fault::Refused(refusal), 1),
            Ok(sensed) => {
                match last.map(|last| i64::from(sensed.sequence) - i64::from(last)) {
                    Some(0) => return faults.note(Fault::Twice, 1),
                    Some(..0) => restarted = true,
                    Some(step) if step > 1 => faults.note(Fault::Lost, step as u64 - 1),
                    _ => {}
                }
                last = Some(sensed.sequence);
                newest = Some(sensed);
            }
        })?;
        if too_long > 0 {
            faults.note(Fault::TooLong, too_long);
        }
        let Some(sensed) = newest else { return Ok(false) };
        if restarted {
            return Err(self.port.ended(&"its line numbers begin again: the base has restarted"));
        }
        if sensed.wheels != 0 && sensed.wheels != self.wheels {
            return Err(BaseError::Answer {
                program: self.port.name().to_owned(),
                line: format!("{} wheel speeds", sensed.wheels),
                reason: format!("expected none or {}, as in the robot file", self.wheels),
            });
        }
        self.count(&before, &sensed);
        (self.sensed, self.arrived) = (sensed, Instant::now());
        Ok(true)
    }

    /// Counts what the base reports in `sensed` and not yet in the line before.
    fn count(&mut self, before: &SensorLine, sensed: &SensorLine) {
        let rejected = sensed.rejected.saturating_sub(before.rejected);
        if rejected > 0 {
            self.faults.note(Fault::Rejected, u64::from(rejected));
        }
        // Before the first velocity the motors stand anyway.
        if sensed.watchdog && !before.watchdog && self.sequence > 0 {
            self.faults.note(Fault::Watchdog, 1);
        }
    }

    fn silent(&self, time: Duration) -> BaseError {
        BaseError::Silent { program: self.port.name().to_owned(), time }
    }

    fn send(&mut self, velocity: Velocity) -> Result<(), BaseError> {
        let Self { sequence, valid_millis, .. } = *self;
        let line = VelocityLine { sequence, velocity: velocity.map(millionths), valid_millis };
        self.text.clear();
        line.encode(&mut self.text);
        if self.port.send(&self.text)? {
            self.sequence += 1;
        } else {
            self.faults.note(Fault::Busy, 1);
        }
        Ok(())
    }
}

impl Base for SerialBase {
    fn read(&mut self) -> Result<Sensors, BaseError> {
        self.receive(Some(self.sensed.sequence))?;
        self.faults.due(Instant::now()).iter().for_each(tell);
        if self.arrived.elapsed() > SILENT_AFTER {
            return Err(self.silent(SILENT_AFTER));
        }
        Ok(Sensors {
            pose: self.world_from_odometry.of(self.sensed.pose_m()),
            velocity: self.sensed.velocity.map(|value| f64::from(value) * 1e-6),
            wheel_speed: self.sensed.wheel_speed_radps(),
            current: None,
            input_delay_s: 0.0,
            estop: self.sensed.estop,
        })
    }

    fn watchdog(&mut self, valid_nanos: u64) -> Result<(), BaseError> {
        self.valid_millis = u16::try_from(valid_nanos / 1_000_000).unwrap_or(u16::MAX);
        Ok(())
    }

    /// Sends `velocity`, unless the last line takes more than half of the time since then.
    fn drive(&mut self, velocity: Velocity, _: u64) -> Result<(), BaseError> {
        let now = Instant::now();
        if now >= self.next_line {
            self.send(velocity)?;
            self.next_line = now + 2 * self.port.time_of(self.text.len());
        }
        Ok(())
    }
}

impl Drop for SerialBase {
    fn drop(&mut self) {
        // Without this line the watchdog stops the motors, a little later.
        let _ = self.send([0.0; 3]);
        self.faults.rest().iter().for_each(tell);
    }
}

/// Logs the number of faults of one kind.
fn tell((fault, count): &(Fault, u64)) {
    tracing::warn!(count, %fault, "serial port");
}

impl SensorLine {
    fn pose_m(&self) -> [f64; 3] {
        self.pose.map(|value| value as f64 * 1e-6)
    }

    fn wheel_speed_radps(&self) -> Option<PerWheel> {
        let speeds = self.wheel_speed.map(|value| f64::from(value) * 1e-6);
        (self.wheels > 0).then(|| per_wheel(&speeds))
    }
}

/// A turn, then a shift, of poses (x, y, yaw).
#[derive(Debug, Clone, Copy, Default)]
struct Transform([f64; 3]);

impl Transform {
    /// The transform that takes the pose `from` to the pose `to`.
    fn between(from: [f64; 3], to: [f64; 3]) -> Self {
        let turn = to[2] - from[2];
        let [x, y, _] = Self([0.0, 0.0, turn]).of(from);
        Self([to[0] - x, to[1] - y, turn])
    }

    fn of(&self, [x, y, yaw]: [f64; 3]) -> [f64; 3] {
        let (Self([dx, dy, turn]), (sin, cos)) = (self, self.0[2].sin_cos());
        [cos * x - sin * y + dx, sin * x + cos * y + dy, yaw + turn]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_stands_at_the_start_of_its_scenario_and_moves_from_there() {
        let world_from_odometry = Transform::between([3.0, 4.0, 1.0], [0.0, -1.0, 1.0]);
        assert_eq!(world_from_odometry.of([3.0, 4.0, 1.0]), [0.0, -1.0, 1.0]);
        let quarter = std::f64::consts::FRAC_PI_2;
        let turned = Transform::between([3.0, 4.0, 0.0], [0.0, -1.0, quarter]);
        let [x, y, yaw] = turned.of([3.5, 4.0, 7.0]);
        assert!(x.abs() < 1e-12 && (y + 0.5).abs() < 1e-12 && yaw == 7.0 + quarter, "{x} {y}");
    }
}
