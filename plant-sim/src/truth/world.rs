//! The true robot on one integer clock.

use core::ops::Range;

use driver::Start;
use nalgebra::Vector3;
use robot::PerWheel;

use super::delay::DelayLine;
use super::disturbance::Disturbance;
use super::motion::{Motion, motion};
use super::parameters::Truth;
use super::schedule::{Conditions, Schedule, nanos, window};
use super::sensors::{Measurement, Sensors};

/// Number of steps for which a random force is held: a millisecond.
const STEPS_PER_FORCE: u64 = 1_000_000 / World::STEP_NANOS;

/// Separates the random numbers of the sensors from those of the random force.
const SENSOR_STREAM: u64 = 0x5e05_0125_a3d1_90c7;

/// The true state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueState {
    /// x, y and heading in the world \[m, m, rad\]; the heading is not wrapped.
    pub pose: [f64; 3],
    /// Body velocity (forward, left, yaw) \[m/s, m/s, rad/s\].
    pub velocity: [f64; 3],
    /// Wheel speeds \[rad/s\].
    pub wheel_speed: PerWheel,
    /// Motor currents \[A\].
    pub current: PerWheel,
    /// F of the equations of motion: turning frame, drag, slope, push and random force, on the body
    /// in its own frame \[N, N, N m\].
    pub force: [f64; 3],
}

/// A robot, its world and its sensors.
///
/// Same settings, start, seed and inputs give the same bits. They depend neither on how the time is
/// divided into calls of [`World::advance`] nor on how often the sensors are read. Nothing
/// allocates after [`World::new`].
///
/// ```
/// use driver::Start;
/// use plant_sim::truth::{Truth, World};
///
/// let truth = Truth { drag_n_s2_per_m2: 0.5, ..Truth::default() };
/// assert_eq!(truth.check(), Ok(()));
/// let mut world = World::new(&truth, Start::default(), 1);
/// world.advance(2_000_000_000, [1.0, 0.0, 0.0]);
/// assert!(world.state().pose[0] > 1.0);
/// ```
#[derive(Debug, Clone)]
pub struct World {
    motion: Box<dyn Motion>,
    schedule: Schedule,
    disturbance: Disturbance,
    delay: DelayLine,
    sensors: Sensors,
    pressed: Vec<Range<u64>>,
    conditions: Conditions,
    /// Dead time that the driver reports \[s\].
    reported_delay_s: f64,
    steps: u64,
    /// Requested time that is not yet simulated; less than a step.
    owed_nanos: u64,
    /// Sum of the inputs of the steps since [`World::take_mean_input`], and their number.
    input_sum: Vector3<f64>,
    input_steps: u64,
}

impl World {
    /// Length of a step \[ns\].
    pub const STEP_NANOS: u64 = 100_000;

    /// Longest command delay \[s\].
    pub(super) const LONGEST_DELAY_S: f64 = 10.0;

    /// A world at time zero, with zero commands on their way to the motors.
    ///
    /// `truth` must have passed [`Truth::check`]; otherwise the numbers are meaningless. Allocates.
    pub fn new(truth: &Truth, start: Start, seed: u64) -> Self {
        let schedule = Schedule::new(truth);
        let disturbance = Disturbance::new(truth.random_force.as_ref(), seed);
        let conditions = schedule.at(0, disturbance.force(), Vector3::zeros());
        let delay_nanos = nanos(truth.command_delay_s.clamp(0.0, Self::LONGEST_DELAY_S));
        let delay_steps = (delay_nanos + Self::STEP_NANOS / 2) / Self::STEP_NANOS;
        Self {
            motion: motion(truth, [start.pose, start.velocity], &conditions),
            schedule,
            disturbance,
            delay: DelayLine::new(delay_steps as usize),
            sensors: Sensors::new(truth, seed ^ SENSOR_STREAM),
            pressed: (truth.pressed.iter())
                .map(|pressed| window(pressed.from_s, pressed.until_s))
                .collect(),
            conditions,
            reported_delay_s: truth.reported_delay_s,
            steps: 0,
            owed_nanos: 0,
            input_sum: Vector3::zeros(),
            input_steps: 0,
        }
    }

    /// Advances the time under this body-velocity command (forward, left, yaw; m/s, m/s, rad/s).
    ///
    /// Time advances in whole steps of [`World::STEP_NANOS`]. The rest of a duration is added to
    /// the next one, so the clock never drifts from the sum of the durations. The command begins at
    /// the first step that this call completes. A component of the command that is not finite
    /// counts as zero; the gate accepts none.
    ///
    /// Four evaluations of the equations of motion per step; does not allocate.
    pub fn advance(&mut self, duration_nanos: u64, input: [f64; 3]) {
        let input = Vector3::from(input).map(|part| if part.is_finite() { part } else { 0.0 });
        let due_nanos = self.owed_nanos.saturating_add(duration_nanos);
        for _ in 0..due_nanos / Self::STEP_NANOS {
            self.step(input);
        }
        self.owed_nanos = due_nanos % Self::STEP_NANOS;
    }

    /// The true state.
    pub fn state(&self) -> TrueState {
        self.motion.state(&self.conditions)
    }

    /// The sensors' measurement; each has noise of its own. Does not allocate.
    pub fn measure(&mut self) -> Measurement {
        self.sensors.measure(&self.state(), self.time_nanos())
    }

    /// Dead time that the driver reports \[s\].
    pub fn reported_delay_s(&self) -> f64 {
        self.reported_delay_s
    }

    /// Whether the emergency stop is pressed.
    pub fn is_emergency_stop_pressed(&self) -> bool {
        let now = self.time_nanos();
        self.pressed.iter().any(|window| window.contains(&now))
    }

    /// Body-velocity command that the speed loops followed in the last step: the command of one
    /// delay ago.
    pub fn input_applied(&self) -> [f64; 3] {
        self.conditions.command.into()
    }

    /// Mean of [`World::input_applied`] over the steps since the last call; the input of the last
    /// step if there was none.
    pub fn take_mean_input(&mut self) -> [f64; 3] {
        let mean = match self.input_steps {
            0 => self.conditions.command,
            steps => self.input_sum / steps as f64,
        };
        self.input_sum = Vector3::zeros();
        self.input_steps = 0;
        mean.into()
    }

    /// Simulated time: whole steps since the start \[ns\].
    pub fn time_nanos(&self) -> u64 {
        self.steps * Self::STEP_NANOS
    }

    fn step(&mut self, input: Vector3<f64>) {
        if self.steps > 0 && self.steps.is_multiple_of(STEPS_PER_FORCE) {
            self.disturbance.next();
        }
        let arrived = self.delay.pass(input);
        let given = self.schedule.at(self.time_nanos(), self.disturbance.force(), arrived);
        self.motion.step(Self::STEP_NANOS as f64 * 1e-9, &given);
        self.conditions = given;
        self.input_sum += arrived;
        self.input_steps += 1;
        self.steps += 1;
    }
}
