//! Changes during a run: payload, faults and push, by simulated time.

use core::ops::Range;

use nalgebra::{Vector2, Vector3};
use robot::{PerWheel, WHEELS_MAX};

use super::parameters::{Fault, Payload, Push, Truth};

/// Constants of the equations of motion in one step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Conditions {
    /// m, with the payload if it is on \[kg\].
    pub(super) mass_kg: f64,
    /// `I_z` about the robot's centre, with the payload if it is on \[kg m²\].
    pub(super) yaw_inertia_kg_m2: f64,
    /// S: mass times place of the centre of mass, forward and left of the robot's centre \[kg m\].
    pub(super) mass_moment: Vector2<f64>,
    /// Delivered torque of each motor per requested torque.
    pub(super) motor_gain: PerWheel,
    /// Constant force in the world's x and y, and about the vertical axis \[N, N, N m\].
    pub(super) push_in_world: Vector3<f64>,
    /// Random force in the body frame \[N, N, N m\].
    pub(super) random_force: Vector3<f64>,
    /// Grip of the floor, as a multiple of that at other times.
    pub(super) grip: f64,
    /// Body velocity requested from the speed loops \[m/s, m/s, rad/s\].
    pub(super) command: Vector3<f64>,
}

/// The run's timetable.
#[derive(Debug, Clone)]
pub(super) struct Schedule {
    mass_kg: f64,
    yaw_inertia_kg_m2: f64,
    motor_gain: PerWheel,
    payload: Option<(Range<u64>, Payload)>,
    push: Option<(Range<u64>, Push)>,
    /// Time, wheel and its new gain; in the order in which they begin.
    faults: Vec<(Range<u64>, usize, f64)>,
    /// Time, and the floor's grip then.
    slippery: Vec<(Range<u64>, f64)>,
}

impl Schedule {
    /// The timetable of the settings. Allocates, here only.
    pub(super) fn new(truth: &Truth) -> Self {
        let fault =
            |fault: &Fault| (window(fault.at_s, fault.until_s), fault.wheel.index(), fault.gain);
        let mut faults: Vec<_> = truth.faults.iter().map(fault).collect();
        faults.sort_by_key(|(window, ..)| window.start);
        let mut motor_gain = [1.0; WHEELS_MAX];
        motor_gain.iter_mut().zip(&truth.motor_gain).for_each(|(to, from)| *to = *from);
        Self {
            mass_kg: truth.mass_kg,
            yaw_inertia_kg_m2: truth.yaw_inertia_kg_m2,
            motor_gain,
            payload: truth.payload.map(|payload| (window(payload.at_s, payload.until_s), payload)),
            push: truth.push.map(|push| (window(push.from_s, push.until_s), push)),
            faults,
            slippery: truth
                .slippery
                .iter()
                .map(|slippery| (window(slippery.from_s, slippery.until_s), slippery.grip_factor))
                .collect(),
        }
    }

    /// The conditions at this time, with this random force and command. O(faults); does not
    /// allocate.
    pub(super) fn at(
        &self,
        now_nanos: u64,
        random_force: Vector3<f64>,
        command: Vector3<f64>,
    ) -> Conditions {
        let mut conditions = Conditions {
            mass_kg: self.mass_kg,
            yaw_inertia_kg_m2: self.yaw_inertia_kg_m2,
            mass_moment: Vector2::zeros(),
            motor_gain: self.motor_gain,
            push_in_world: Vector3::zeros(),
            random_force,
            grip: 1.0,
            command,
        };
        if let Some((window, payload)) = &self.payload
            && window.contains(&now_nanos)
        {
            conditions.mass_kg += payload.mass_kg;
            let offset = Vector2::from(payload.offset_m);
            conditions.yaw_inertia_kg_m2 +=
                payload.yaw_inertia_kg_m2 + payload.mass_kg * offset.norm_squared();
            conditions.mass_moment = payload.mass_kg * offset;
        }
        if let Some((window, push)) = &self.push
            && window.contains(&now_nanos)
        {
            let [x, y] = push.force_n;
            conditions.push_in_world = Vector3::new(x, y, push.torque_nm);
        }
        for (window, wheel, gain) in &self.faults {
            if window.contains(&now_nanos) {
                conditions.motor_gain[*wheel] = *gain;
            }
        }
        for (_, grip) in self.slippery.iter().filter(|(window, _)| window.contains(&now_nanos)) {
            conditions.grip *= grip;
        }
        conditions
    }
}

/// From one time to another \[s\], or without end.
pub(super) fn window(from_s: f64, until_s: Option<f64>) -> Range<u64> {
    nanos(from_s)..until_s.map_or(u64::MAX, nanos)
}

/// Seconds as nanoseconds, rounded; a negative time is the start.
pub(super) fn nanos(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::truth::{Slippery, Wheel};

    fn at(truth: &Truth, seconds: f64) -> Conditions {
        Schedule::new(truth).at(nanos(seconds), Vector3::zeros(), Vector3::zeros())
    }

    #[test]
    fn a_payload_adds_mass_only_between_its_times() {
        let payload = Payload {
            mass_kg: 5.0,
            yaw_inertia_kg_m2: 0.1,
            offset_m: [0.0; 2],
            at_s: 2.0,
            until_s: Some(3.0),
        };
        let truth = Truth { payload: Some(payload), ..Truth::default() };
        assert!((at(&truth, 1.999_9).mass_kg - 15.0).abs() < 1e-12);
        assert!((at(&truth, 2.0).mass_kg - 20.0).abs() < 1e-12);
        assert!((at(&truth, 2.0).yaw_inertia_kg_m2 - 0.7).abs() < 1e-12);
        assert!((at(&truth, 3.0).mass_kg - 15.0).abs() < 1e-12);
    }

    #[test]
    fn the_latest_fault_of_a_wheel_counts_in_any_order_of_the_settings() {
        let fault = |gain, at_s| Fault { wheel: Wheel::RearLeft, gain, at_s, until_s: None };
        let truth = Truth { faults: vec![fault(1.0, 3.0), fault(0.0, 1.0)], ..Truth::default() };
        assert_eq!(at(&truth, 0.9).motor_gain, [1.0; WHEELS_MAX]);
        assert_eq!(at(&truth, 1.0).motor_gain, [1.0, 1.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0]);
        assert_eq!(at(&truth, 3.0).motor_gain, [1.0; WHEELS_MAX]);
    }

    #[test]
    fn motor_gain_and_grip_recover_at_the_end_of_a_fault() {
        let fault = Fault { wheel: Wheel::RearLeft, gain: 0.0, at_s: 1.0, until_s: Some(2.0) };
        let slippery = Slippery { grip_factor: 0.2, from_s: 1.0, until_s: Some(2.0) };
        let truth = Truth { faults: vec![fault], slippery: vec![slippery], ..Truth::default() };
        assert_eq!((at(&truth, 1.5).motor_gain[2], at(&truth, 1.5).grip), (0.0, 0.2));
        assert_eq!((at(&truth, 2.0).motor_gain[2], at(&truth, 2.0).grip), (1.0, 1.0));
    }

    #[test]
    fn a_push_begins_and_ends() {
        let push = Push { force_n: [3.0, -1.0], torque_nm: 0.2, from_s: 1.0, until_s: Some(2.0) };
        let truth = Truth { push: Some(push), ..Truth::default() };
        assert_eq!(at(&truth, 0.5).push_in_world, Vector3::zeros());
        assert_eq!(at(&truth, 1.0).push_in_world, Vector3::new(3.0, -1.0, 0.2));
        assert_eq!(at(&truth, 2.0).push_in_world, Vector3::zeros());
    }
}
