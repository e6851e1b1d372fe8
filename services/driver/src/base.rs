//! The interface that the author of a robot implements.

use robot::{Obstacle, PerWheel, Velocity, WHEELS_MAX};
use std::time::Duration;

/// A robot base: sensors out, body velocity in.
///
/// ```
/// use driver::{Base, BaseError, Sensors};
///
/// /// Follows every command at once.
/// #[derive(Default)]
/// struct Ideal {
///     sensors: Sensors,
/// }
///
/// impl Base for Ideal {
///     fn read(&mut self) -> Result<Sensors, BaseError> {
///         Ok(self.sensors)
///     }
///
///     fn drive(&mut self, velocity: [f64; 3], nanos: u64) -> Result<(), BaseError> {
///         self.sensors.velocity = velocity;
///         self.sensors.pose[2] += velocity[2] * nanos as f64 * 1e-9;
///         Ok(())
///     }
/// }
///
/// let mut base = Ideal::default();
/// base.drive([0.0, 0.0, 1.0], 1_000_000_000)?;
/// assert_eq!(base.read()?.pose[2], 1.0);
/// # Ok::<(), BaseError>(())
/// ```
///
/// Motors that take the speeds of wheels get them by the wheels of the robot file:
///
/// ```
/// # use driver::{Base, BaseError, Sensors};
/// # use robot::{PerWheel, Wheels};
/// struct Motors {
///     wheels: Wheels,
///     speeds_radps: PerWheel,
/// }
///
/// impl Base for Motors {
///     # fn read(&mut self) -> Result<Sensors, BaseError> { Ok(Sensors::default()) }
///     fn drive(&mut self, velocity: [f64; 3], _nanos: u64) -> Result<(), BaseError> {
///         self.speeds_radps = self.wheels.speeds(velocity);
///         Ok(())
///     }
/// }
/// # let wheels = Wheels::mecanum(0.05, 0.25, 0.3).map_err(|error| error.to_string());
/// # let mut base = Motors { wheels: wheels?, speeds_radps: PerWheel::default() };
/// # base.drive([1.0, 0.0, 0.0], 0).map_err(|error| error.to_string())?;
/// # assert_eq!(base.speeds_radps[..4], [20.0; 4]);
/// # Ok::<(), String>(())
/// ```
pub trait Base {
    /// The present measurements.
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be read any more: the driver ends.
    fn read(&mut self) -> Result<Sensors, BaseError>;

    /// Gives the wheels `velocity` (forward, left, yaw) \[m/s, m/s, rad/s\] for `nanos` \[ns\]. A
    /// simulated robot moves by that time. A real one passes the velocity on and returns at once.
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be driven any more: the driver ends.
    fn drive(&mut self, velocity: Velocity, nanos: u64) -> Result<(), BaseError>;

    /// Restarts the watchdog of the motors: the velocity of the next [`drive`](Self::drive) may act
    /// for `valid_nanos` \[ns\], unless another one follows. The driver calls it before each
    /// `drive`, at least every few milliseconds. A process that has died or hangs does not call it:
    /// then the hardware must stop the motors by itself. Without this method that does not happen.
    ///
    /// # Errors
    /// [`BaseError`] if the base cannot be reached any more: the driver ends.
    fn watchdog(&mut self, valid_nanos: u64) -> Result<(), BaseError> {
        let _ = valid_nanos;
        Ok(())
    }

    /// All obstacles that the robot's own sensors know now, in the world frame; `None` if it has no
    /// such sensors. Read once per control period, after [`read`](Self::read).
    fn obstacles(&mut self) -> Option<&[Obstacle]> {
        None
    }

    /// The true state, if the robot is simulated.
    fn truth(&self) -> Option<TrueState> {
        None
    }

    /// The velocity that the motors act on now \[m/s, m/s, rad/s\], if the base knows that it is
    /// not the last commanded one.
    fn acting(&self) -> Option<Velocity> {
        None
    }
}

/// Measurements of the sensors.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Sensors {
    /// x, y and yaw in the world \[m, m, rad\]; yaw is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: Velocity,
    /// Wheel speeds, if they are measured \[rad/s\].
    pub wheel_speed: Option<PerWheel>,
    /// Motor currents, if they are measured \[A\].
    pub current: Option<PerWheel>,
    /// Dead time from the gate's output to the motors, if the base knows it, else 0 \[s\].
    pub input_delay_s: f64,
    /// Whether the robot's own emergency stop is pressed.
    pub estop: bool,
}

// Messages and robot files have the same number of wheels at most.
const _: () = assert!(WHEELS_MAX == protocol::message::WHEELS_MAX);

/// `values` with one entry for each possible wheel. Entries beyond [`WHEELS_MAX`] are dropped.
pub fn per_wheel(values: &[f64]) -> PerWheel {
    let mut all = [0.0; WHEELS_MAX];
    all.iter_mut().zip(values).for_each(|(place, value)| *place = *value);
    all
}

/// The true state in a simulated world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrueState {
    /// x, y and yaw in the world \[m, m, rad\]; yaw is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: Velocity,
    /// Force of the world on the body, except that of the wheels \[N, N, N m\].
    pub force: [f64; 3],
}

/// The base cannot be driven any more.
#[derive(Debug, thiserror::Error)]
pub enum BaseError {
    /// The base rejects one of its settings.
    #[error("{key}: expected {expected}")]
    Refused {
        /// Dotted path of the setting.
        key: String,
        /// Expected value.
        expected: String,
    },
    /// The base is a program that could not be started.
    #[error("{program} cannot be started: {source}")]
    Start {
        /// File of the program.
        program: String,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The device file of the base cannot be used.
    #[error("{device}: expected {expected}, but: {source}")]
    Device {
        /// Device file.
        device: String,
        /// What it should be.
        expected: &'static str,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// The program or device has ended.
    #[error("{program} has ended: {reason}")]
    Ended {
        /// File of the program or device.
        program: String,
        /// Exit status, or the error.
        reason: String,
    },
    /// The program or device has not replied in time.
    #[error("{program} has not answered for {time:?}")]
    Silent {
        /// File of the program or device.
        program: String,
        /// Length of the wait.
        time: Duration,
    },
    /// The reply of the program or device does not fit the request.
    #[error("{program} answered {line:?}: {reason}")]
    Answer {
        /// File of the program or device.
        program: String,
        /// The beginning of the reply.
        line: String,
        /// The error in it.
        reason: String,
    },
}
