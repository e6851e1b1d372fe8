//! The nearest values within the limits.

use super::{Limits, dot};
use crate::reference::ReferencePoint;
use model::Velocity;

impl Limits {
    /// The nearest input in the same direction that the wheels can follow; NaN counts as 0.
    pub fn clamp(&self, input: &Velocity) -> Velocity {
        let boxed: Velocity = std::array::from_fn(|axis| {
            let desired = if input[axis].is_nan() { 0.0 } else { input[axis] };
            desired.clamp(-self.inputs.input[axis], self.inputs.input[axis])
        });
        let load = self.inputs.wheel.iter().map(|row| dot(row, &boxed).abs()).fold(1.0, f64::max);
        boxed.map(|value| value / load)
    }

    /// `point` within the bounds on the state: changes its heading and velocity, not its position.
    pub fn admitted(&self, point: &ReferencePoint) -> ReferencePoint {
        let heading = self.heading.unwrap_or(f64::INFINITY);
        let mut admitted = *point;
        admitted.pose[2] = point.pose[2].clamp(-heading, heading);
        admitted.velocity = self.slowed(&point.velocity);
        admitted
    }

    /// `velocity` within the bounds on the state.
    pub fn slowed(&self, velocity: &Velocity) -> Velocity {
        std::array::from_fn(|axis| {
            let most = self.speed[axis].unwrap_or(f64::INFINITY);
            velocity[axis].clamp(-most, most)
        })
    }

    /// The nearest input to `desired` that can be reached from `last` in one period; in the same
    /// direction, if the drive ramps its command.
    pub fn reach(&self, desired: &Velocity, last: &Velocity) -> Velocity {
        let (desired, last) = (self.clamp(desired), self.clamp(last));
        if self.ramp.is_some() {
            let by: Velocity = std::array::from_fn(|axis| desired[axis] - last[axis]);
            let load = self.changes.iter().map(|row| dot(row, &by).abs()).fold(1.0, f64::max);
            return std::array::from_fn(|axis| last[axis] + by[axis] / load);
        }
        self.near(&desired, &last)
    }

    /// The input after `last` of a robot that brakes, as fast as inputs may change. The ramp of the
    /// drive does not count: a drive that has one brakes with it anyway, and no robot brakes more
    /// slowly because of an error in what was identified.
    pub fn brake(&self, last: &Velocity) -> Velocity {
        self.near(&[0.0; 3], &self.clamp(last))
    }

    /// The nearest input to `desired` within the largest change of each axis from `last`.
    fn near(&self, desired: &Velocity, last: &Velocity) -> Velocity {
        let Some(change) = self.inputs.change else { return *desired };
        let near: Velocity = std::array::from_fn(|axis| {
            desired[axis].clamp(last[axis] - change[axis], last[axis] + change[axis])
        });
        self.clamp(&near)
    }
}
