//! The simulated firmware of a base at a serial port: its process, its table, and the judge of it.
//!
//! Such a base has no truth message. The table of the firmware has what the motors did in every
//! step of 2 ms:
//!
//! | rule     | what must hold                                                                  |
//! |----------|---------------------------------------------------------------------------------|
//! | watchdog | the motors have no target once the last valid velocity line is too old          |
//! | stands   | twelve time constants later the robot stands                                    |
//! | fast     | no target and no speed is above the limit of the robot file                     |
//! | measured | each velocity in the record is one that the firmware has sent                   |

use super::record::Record;
use std::collections::HashSet;
use std::fs::{self, File};
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::thread;
use std::time::{Duration, Instant};

/// Name of its program.
pub const PROGRAM: &str = "serial-firmware";
/// Name of the program that drives it.
pub const DRIVER: &str = "serial-base";
/// A cable that damages, cuts off, loses and delays lines.
pub const BAD_CABLE: [&str; 8] =
    ["--garble", "0.1", "--truncate", "0.05", "--drop", "0.05", "--delay", "5"];
/// Time for which the driver's last velocity may act \[ns\].
pub const WATCHDOG_NANOS: u64 = 100_000_000;
/// Steps of 2 ms or more in which the simulated robot stands still after its motors have stopped:
/// twelve time constants.
const STANDS_WITHIN_STEPS: u32 = 300;
/// Highest speed that the robot file permits \[m/s\], with the rounding of a line.
const SPEED_MAX: f64 = 5.0 + 1e-6;
/// Speed at which the robot certainly drives \[m/s\].
pub const DRIVES: f64 = 0.5;
/// Speed below which it stands \[m/s\].
pub const STANDS: f64 = 1e-3;
/// Far longer than it takes to open a pseudo-terminal.
const OPENS_WITHIN: Duration = Duration::from_mins(2);

/// The simulated firmware, which is killed with this value, and whose port vanishes with it.
#[derive(Debug)]
pub struct Firmware {
    child: Child,
    port: PathBuf,
}

impl Firmware {
    /// Starts the program in the folder `programs`, with its port and table in `home`, and waits
    /// for its port.
    ///
    /// # Errors
    /// If it cannot be started.
    pub fn start(programs: &Path, home: &Path, options: &[&str]) -> io::Result<Self> {
        let port = port(home);
        let _ = fs::remove_file(&port);
        let mut command = Command::new(programs.join(PROGRAM));
        command.arg("--link").arg(&port).arg("--record").arg(home.join(TABLE)).args(options);
        let this = Self { child: command.stdin(Stdio::null()).spawn()?, port };
        let begin = Instant::now();
        while !this.port.exists() {
            if begin.elapsed() > OPENS_WITHIN {
                return Err(io::Error::new(io::ErrorKind::TimedOut, "the firmware has no port"));
            }
            thread::sleep(Duration::from_millis(5));
        }
        Ok(this)
    }
}

impl Drop for Firmware {
    fn drop(&mut self) {
        // The system gives the terminal of a dead firmware to the next one that is started. A link
        // that was left would lead the driver to the robot of another run.
        let _ = fs::remove_file(&self.port);
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// The table in a home.
const TABLE: &str = "firmware.csv";
/// More than two rows of it.
const TAIL_BYTES: u64 = 1024;

/// The port of the firmware in `home`.
pub fn port(home: &Path) -> PathBuf {
    home.join("port")
}

/// One step of the firmware.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Step {
    /// Time on the monotonic clock \[ns\].
    pub nanos: u64,
    /// Velocity that the motors are to reach \[m/s, m/s, rad/s\].
    pub target: [f64; 3],
    /// Velocity in the body \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Arrival of the last velocity line \[ns\].
    pub line_nanos: u64,
    /// Its validity \[ns\].
    pub valid_nanos: u64,
    /// Number of velocity lines that were rejected.
    pub rejected: u64,
    /// Whether the watchdog has stopped the motors.
    pub stopped_by_watchdog: bool,
}

impl Step {
    /// Planar speed \[m/s\].
    pub fn speed(&self) -> f64 {
        self.velocity[0].hypot(self.velocity[1])
    }

    /// Time without a valid velocity line \[ns\].
    fn age(&self) -> u64 {
        self.nanos - self.line_nanos
    }
}

/// The steps so far, of all firmwares that were started in `home`.
///
/// # Errors
/// If there is no table, or a row of it has other columns.
pub fn steps(home: &Path) -> io::Result<Vec<Step>> {
    let text = fs::read_to_string(home.join(TABLE))?;
    let whole = text.rfind('\n').map_or("", |end| &text[..end]);
    let wrong = |row: &str| io::Error::new(io::ErrorKind::InvalidData, row.to_owned());
    whole.lines().skip(1).map(|row| step(row).ok_or_else(|| wrong(row))).collect()
}

/// The newest step of a firmware in `home`, if there is one. It does not read the whole table.
pub fn newest(home: &Path) -> Option<Step> {
    let mut file = File::open(home.join(TABLE)).ok()?;
    let length = file.seek(SeekFrom::End(0)).ok()?;
    file.seek(SeekFrom::Start(length.saturating_sub(TAIL_BYTES))).ok()?;
    let mut tail = String::new();
    file.read_to_string(&mut tail).ok()?;
    let whole = &tail[..tail.rfind('\n')?];
    step(whole[whole.rfind('\n')?..].trim_start())
}

fn step(row: &str) -> Option<Step> {
    let cells: Vec<&str> = row.split(',').collect();
    let number = |place: usize| cells.get(place)?.parse::<f64>().ok();
    let count = |place: usize| cells.get(place)?.parse::<u64>().ok();
    Some(Step {
        nanos: count(0)?,
        target: [number(1)?, number(2)?, number(3)?],
        velocity: [number(4)?, number(5)?, number(6)?],
        line_nanos: count(8)?,
        valid_nanos: count(9)? * 1_000_000,
        rejected: count(10)?,
        stopped_by_watchdog: count(11)? > 0,
    })
}

/// What the motors did against the rules.
pub fn judge(steps: &[Step]) -> Vec<String> {
    let (mut overdue, mut found) = (0, Vec::new());
    for step in steps {
        let (age, nanos) = (step.age(), step.nanos);
        let fastest = step.speed().max(step.target[0].hypot(step.target[1]));
        if fastest > SPEED_MAX {
            found.push(format!("{fastest:.3} m/s at {nanos} ns, expected {SPEED_MAX:.0} at most"));
        }
        if step.valid_nanos > WATCHDOG_NANOS {
            let valid = step.valid_nanos;
            found.push(format!("a line valid for {valid} ns at {nanos} ns"));
        }
        if age >= WATCHDOG_NANOS && step.target != [0.0; 3] {
            found.push(format!("a target at {nanos} ns, {age} ns after the last velocity line"));
        }
        overdue = if age < WATCHDOG_NANOS { 0 } else { overdue + 1 };
        if overdue >= STANDS_WITHIN_STEPS && step.speed() >= STANDS {
            found.push(format!("it moves at {nanos} ns, {age} ns after the last velocity line"));
        }
    }
    found
}

/// Velocities in `record` that the firmware has never had.
pub fn unsent(record: &Record, steps: &[Step]) -> Vec<String> {
    let bits = |velocity: [f64; 3]| velocity.map(|value| (value + 0.0).to_bits());
    let sent: HashSet<_> = steps.iter().map(|step| bits(step.velocity)).collect();
    let measured = record.of("state").filter_map(|state| {
        let velocity: [f64; 3] = state.numbers("velocity").try_into().ok()?;
        let tick = state.stamp("tick");
        (!sent.contains(&bits(velocity)))
            .then(|| format!("the velocity {velocity:?} at tick {tick} was never sent"))
    });
    measured.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A robot that stops one step after its last line is too old.
    fn good() -> Vec<Step> {
        let step = |number: u64| {
            let line_nanos = number.min(100) * 2_000_000;
            let nanos = number * 2_000_000;
            let acts = nanos - line_nanos < WATCHDOG_NANOS;
            let velocity = if number < 200 { [1.0, 0.0, 0.0] } else { [0.0; 3] };
            Step {
                nanos,
                target: if acts { [1.0, 0.0, 0.0] } else { [0.0; 3] },
                velocity,
                line_nanos,
                valid_nanos: WATCHDOG_NANOS,
                rejected: 0,
                stopped_by_watchdog: !acts,
            }
        };
        (1..1000).map(step).collect()
    }

    #[test]
    fn a_watchdog_that_is_late_or_missing_and_a_robot_that_is_too_fast_are_found() {
        assert_eq!(judge(&good()), [""; 0]);
        let change = |change: &dyn Fn(&mut Step)| {
            let mut steps = good();
            steps.iter_mut().for_each(change);
            judge(&steps).len()
        };
        assert!(change(&|step| step.target = [1.0, 0.0, 0.0]) > 100);
        assert!(change(&|step| step.velocity = [0.01, 0.0, 0.0]) > 100);
        assert!(change(&|step| step.velocity = [6.0, 0.0, 0.0]) > 100);
        assert!(change(&|step| step.valid_nanos = 2 * WATCHDOG_NANOS) > 100);
    }
}
