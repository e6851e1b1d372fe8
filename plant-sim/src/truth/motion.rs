//! The motion of a robot with any number of wheels. The equations know the number when they are
//! compiled; here is the one place that chooses among them.

use nalgebra::{SVector, Vector3};
use robot::PerWheel;

use super::dynamics::{Dynamics, State};
use super::integrate::runge_kutta;
use super::parameters::Truth;
use super::schedule::Conditions;
use super::world::TrueState;

/// Equations and state of one robot.
pub(super) trait Motion: std::fmt::Debug + Send + Sync {
    /// Advances by `step_s` \[s\]. Does not allocate.
    fn step(&mut self, step_s: f64, given: &Conditions);

    /// The true state.
    fn state(&self, given: &Conditions) -> TrueState;

    /// Pose and body velocity after so many steps, from these values. Wheels, currents and
    /// integrals begin as in steady rolling. Does not allocate.
    fn foretell(
        &self,
        from: [[f64; 3]; 2],
        steps: u64,
        step_s: f64,
        given: &Conditions,
    ) -> [[f64; 3]; 2];

    /// A copy.
    fn copied(&self) -> Box<dyn Motion>;
}

impl Clone for Box<dyn Motion> {
    fn clone(&self) -> Self {
        self.as_ref().copied()
    }
}

/// The motion of the robot of `truth` from this pose and velocity.
pub(super) fn motion(truth: &Truth, from: [[f64; 3]; 2], given: &Conditions) -> Box<dyn Motion> {
    match truth.wheels.count() {
        3 => Box::new(Moving::<3>::new(truth, from, given)),
        5 => Box::new(Moving::<5>::new(truth, from, given)),
        6 => Box::new(Moving::<6>::new(truth, from, given)),
        7 => Box::new(Moving::<7>::new(truth, from, given)),
        8 => Box::new(Moving::<8>::new(truth, from, given)),
        _ => Box::new(Moving::<4>::new(truth, from, given)),
    }
}

/// A robot with W wheels.
#[derive(Debug, Clone)]
struct Moving<const W: usize> {
    dynamics: Dynamics<W>,
    state: State<W>,
}

impl<const W: usize> Moving<W> {
    fn new(truth: &Truth, from: [[f64; 3]; 2], given: &Conditions) -> Self {
        let dynamics = Dynamics::new(truth);
        Self { state: dynamics.consistent(&dynamics.rolling_at(from), given), dynamics }
    }
}

impl<const W: usize> Motion for Moving<W> {
    fn step(&mut self, step_s: f64, given: &Conditions) {
        self.state = stepped(&self.dynamics, self.state, step_s, given);
    }

    fn state(&self, given: &Conditions) -> TrueState {
        let State { pose, velocity, wheel_speed, current, .. } = self.state;
        TrueState {
            pose: pose.into(),
            velocity: velocity.into(),
            wheel_speed: per_wheel(wheel_speed.as_slice()),
            current: per_wheel(current.as_slice()),
            force: self.dynamics.force(&self.state, given).into(),
        }
    }

    fn foretell(
        &self,
        from: [[f64; 3]; 2],
        steps: u64,
        step_s: f64,
        given: &Conditions,
    ) -> [[f64; 3]; 2] {
        let start = self.dynamics.rolling_at(from);
        let mut state = self.dynamics.at_steady_rolling(&start, given);
        for _ in 0..steps {
            state = stepped(&self.dynamics, state, step_s, given);
        }
        [state.pose.into(), state.velocity.into()]
    }

    fn copied(&self) -> Box<dyn Motion> {
        Box::new(self.clone())
    }
}

fn stepped<const W: usize>(
    dynamics: &Dynamics<W>,
    state: State<W>,
    step_s: f64,
    given: &Conditions,
) -> State<W> {
    let next = runge_kutta(state, step_s, |state| dynamics.rate(state, given));
    dynamics.consistent(&next, given)
}

fn per_wheel(values: &[f64]) -> PerWheel {
    std::array::from_fn(|wheel| values.get(wheel).copied().unwrap_or(0.0))
}

impl<const W: usize> Dynamics<W> {
    /// Wheels that roll as the body moves, without currents.
    fn rolling_at(&self, [pose, velocity]: [[f64; 3]; 2]) -> State<W> {
        let velocity = Vector3::from(velocity);
        State {
            pose: Vector3::from(pose),
            velocity,
            wheel_speed: self.wheels_at(&velocity),
            current: SVector::zeros(),
            integral: SVector::zeros(),
        }
    }
}
