//! Prediction of the world from its present state, for the oracle: a controller that knows
//! everything but the future.

use nalgebra::Vector3;

use super::motion::{Motion, motion};
use super::parameters::Truth;
use super::schedule::{Conditions, Schedule};

/// Longest step of rolling wheels, whose fastest motion is friction at standstill \[ns\].
const ROLLING_STEP_NANOS: u64 = 4_000_000;
/// Longest step of slipping wheels, which are stiff \[ns\].
const SLIPPING_STEP_NANOS: u64 = 1_000_000;

/// The equations of motion of a [`World`](super::World), with the payload, faults and push of one
/// moment, and no random force.
///
/// A controller cannot measure slipping wheel speeds, lagging currents and integrals of the speed
/// loops. They start as in steady rolling.
#[derive(Debug, Clone)]
pub struct Preview {
    motion: Box<dyn Motion>,
    schedule: Schedule,
    now: Conditions,
    step_nanos: u64,
}

impl Preview {
    /// The world that the settings describe, at its start. Allocates.
    pub fn new(truth: &Truth) -> Self {
        let schedule = Schedule::new(truth);
        let now = schedule.at(0, Vector3::zeros(), Vector3::zeros());
        Self {
            motion: motion(truth, [[0.0; 3]; 2], &now),
            now,
            schedule,
            step_nanos: if truth.wheel_slip.is_some() {
                SLIPPING_STEP_NANOS
            } else {
                ROLLING_STEP_NANOS
            },
        }
    }

    /// Takes over the payload, faults and push of this time. Does not allocate.
    pub fn look(&mut self, now_nanos: u64) {
        self.now = self.schedule.at(now_nanos, Vector3::zeros(), Vector3::zeros());
    }

    /// Pose and body velocity after `duration_nanos`, from this state and under a constant input.
    /// Does not allocate.
    pub fn after(
        &self,
        duration_nanos: u64,
        pose: [f64; 3],
        velocity: [f64; 3],
        input: [f64; 3],
    ) -> ([f64; 3], [f64; 3]) {
        let given = Conditions { command: Vector3::from(input), ..self.now };
        let steps = duration_nanos.div_ceil(self.step_nanos).max(1);
        let step_s = duration_nanos as f64 * 1e-9 / steps as f64;
        let [pose, velocity] = self.motion.foretell([pose, velocity], steps, step_s, &given);
        (pose, velocity)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::{Payload, Push, Slope, WheelSlip, World};
    use driver::Start;

    const PERIOD_NANOS: u64 = 100_000_000;

    /// Difference between the prediction of one period and the world after it, for a moving world
    /// at `at_s`.
    fn error(truth: &Truth, at_s: u64) -> f64 {
        let mut world = World::new(truth, Start::default(), 1);
        world.advance(at_s * 1_000_000_000 - PERIOD_NANOS, [1.0, -0.4, 0.5]);
        world.advance(PERIOD_NANOS, [0.5, 0.8, -0.5]);
        let now = world.state();
        let mut preview = Preview::new(truth);
        preview.look(world.time_nanos());
        let (pose, velocity) = preview.after(PERIOD_NANOS, now.pose, now.velocity, [0.2, 1.0, 0.3]);
        world.advance(PERIOD_NANOS, [0.2, 1.0, 0.3]);
        let then = world.state();
        (Vector3::from(pose) - Vector3::from(then.pose)).norm()
            + (Vector3::from(velocity) - Vector3::from(then.velocity)).norm()
    }

    #[test]
    fn without_random_forces_the_prediction_is_exact() {
        let truth = Truth {
            mass_kg: 22.0,
            rolling_friction: 0.05,
            drag_n_s2_per_m2: 0.5,
            breakaway_factor: 2.5,
            deadband_radps: 1.5,
            motor_gain: vec![0.6],
            slope: Some(Slope { angle_rad: 0.1, direction_rad: 0.8 }),
            push: Some(Push { force_n: [0.0, 20.0], ..Push::default() }),
            payload: Some(Payload {
                mass_kg: 8.0,
                yaw_inertia_kg_m2: 0.1,
                offset_m: [0.08, 0.1],
                at_s: 1.0,
                until_s: None,
            }),
            ..Truth::default()
        };
        for at_s in [1, 2] {
            assert!(error(&truth, at_s) < 1e-3, "{} at {at_s} s", error(&truth, at_s));
        }
        let slipping = Truth {
            wheel_slip: Some(WheelSlip { grip: 0.6, slip_speed_scale_mps: 0.05 }),
            ..truth
        };
        assert!(error(&slipping, 2) < 0.03, "{}", error(&slipping, 2));
    }

    #[test]
    fn the_prediction_knows_a_payload_only_from_its_beginning() {
        let payload = Payload {
            mass_kg: 20.0,
            yaw_inertia_kg_m2: 0.0,
            offset_m: [0.0; 2],
            at_s: 1.0,
            until_s: None,
        };
        let mut preview = Preview::new(&Truth { payload: Some(payload), ..Truth::default() });
        let mut speed = |at| {
            preview.look(at);
            preview.after(PERIOD_NANOS, [0.0; 3], [0.0; 3], [1.0, 0.0, 0.0]).1[0]
        };
        let (before, just_before, after) = (speed(0), speed(999_999_999), speed(1_000_000_000));
        assert!(before == just_before && after < 0.7 * before, "{before} {just_before} {after}");
    }
}
