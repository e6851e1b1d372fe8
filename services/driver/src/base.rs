//! What a robot's author implements.

use protocol::message::WHEELS_MAX;
use robot::Velocity;

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
pub trait Base {
    /// What the sensors show now.
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

    /// What is really so, if the robot is simulated.
    fn truth(&self) -> Option<TrueState> {
        None
    }

    /// The velocity that the motors act on now, if the base knows that it is another than the one
    /// it was given last \[m/s, m/s, rad/s\].
    fn acting(&self) -> Option<Velocity> {
        None
    }
}

/// What the sensors show.
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
    /// Dead time from the gate's output to the motors that the base knows of, else 0 \[s\].
    pub input_delay_s: f64,
    /// Whether the robot's own emergency stop is pressed.
    pub estop: bool,
}

/// One number per wheel, in the order of the robot file; 0 for wheels that the robot does not have.
pub type PerWheel = [f64; WHEELS_MAX];

/// `values` with a place for every possible wheel. More than there are places for are left out.
pub fn per_wheel(values: &[f64]) -> PerWheel {
    let mut all = [0.0; WHEELS_MAX];
    all.iter_mut().zip(values).for_each(|(place, value)| *place = *value);
    all
}

/// What is really so in a simulated world.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TrueState {
    /// x, y and yaw in the world \[m, m, rad\]; yaw is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: Velocity,
    /// Force of the world beside the wheels \[N, N, N m\].
    pub force: [f64; 3],
}

/// The base can be driven no longer.
#[derive(Debug, thiserror::Error)]
pub enum BaseError {
    /// It refuses one of its settings.
    #[error("{key}: expected {expected}")]
    Refused {
        /// Which.
        key: String,
        /// What it would take.
        expected: String,
    },
    /// It is a program that could not be started.
    #[error("{program} cannot be started: {source}")]
    Start {
        /// Which.
        program: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// It has ended.
    #[error("{program} has ended: {reason}")]
    Ended {
        /// Which.
        program: String,
        /// How.
        reason: String,
    },
    /// It has not answered in time.
    #[error("{program} has not answered for {seconds} s")]
    Silent {
        /// Which.
        program: String,
        /// How long.
        seconds: u64,
    },
    /// It has answered something else than what was asked.
    #[error("{program} answered {line:?}: {reason}")]
    Answer {
        /// Which.
        program: String,
        /// What it answered, from its beginning.
        line: String,
        /// What is wrong with that.
        reason: String,
    },
}
