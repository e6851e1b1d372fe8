//! The main model f: the believed dynamics with the speed loop closed, discretised exactly (eqs. 21 and 23).
//!
//! With i = `k_p` (`u_m` − ω) the axes separate, each of first order:
//!
//! ```text
//! λ v̇ = κ u − (κ + f) v      v⁺ = A v + B u,   A = e^{−(κ+f)T/λ},   B = κ/(κ+f) (1 − A)
//! ```

use crate::Velocity;
use crate::robot::{Robot, dynamics};

/// f for one robot and one period. Constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MainModel {
    /// A per axis \[–\].
    pub decay: Velocity,
    /// B per axis \[–\].
    pub gain: Velocity,
    /// T \[s\].
    pub period: f64,
}

impl MainModel {
    /// The main model of `robot` for a period of `period` \[s\].
    pub fn new(robot: &Robot, period: f64) -> Self {
        let stiffness = dynamics::speed_loop_stiffness(robot);
        let loss = stiffness + robot.body.axle_friction_nms;
        let decay = dynamics::axis_inertia(robot).map(|inertia| (-loss * period / inertia).exp());
        let gain = decay.map(|a| stiffness / loss * (1.0 - a));
        Self { decay, gain, period }
    }

    /// Velocity one period after `velocity` under `input` \[m/s, m/s, rad/s\].
    pub fn next_velocity(&self, velocity: &Velocity, input: &Velocity) -> Velocity {
        std::array::from_fn(|axis| self.decay[axis] * velocity[axis] + self.gain[axis] * input[axis])
    }

    /// Input that holds `velocity` against a constant residual \[m/s, m/s, rad/s\]: v = A v + B u + g.
    pub fn holding_input(&self, velocity: &Velocity, residual: &Velocity) -> Velocity {
        std::array::from_fn(|axis| ((1.0 - self.decay[axis]) * velocity[axis] - residual[axis]) / self.gain[axis])
    }
}

/// Names one main model and one layout of the learner's inputs: a residual of another is wrong, and refused.
///
/// FNV-1a over the numbers' bits and the layout's name.
pub fn fingerprint(model: &MainModel, layout: &str) -> u64 {
    let numbers = model.decay.iter().chain(&model.gain).chain(std::iter::once(&model.period));
    let bytes = numbers.flat_map(|value| value.to_bits().to_le_bytes()).chain(layout.bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_discretisation_is_exact_two_halves_make_a_whole() {
        let (whole, half) = (MainModel::new(&Robot::example(), 0.1), MainModel::new(&Robot::example(), 0.05));
        let (velocity, input) = ([1.0, -2.0, 0.5], [2.0, 1.0, -1.0]);
        let twice = half.next_velocity(&half.next_velocity(&velocity, &input), &input);
        for (a, b) in twice.iter().zip(whole.next_velocity(&velocity, &input)) {
            assert!((a - b).abs() < 1e-14);
        }
    }

    #[test]
    fn the_holding_input_holds() {
        let model = MainModel::new(&Robot::example(), 0.1);
        let (velocity, residual) = ([2.7, -0.3, 0.4], [-0.05, 0.02, 0.01]);
        let next = model.next_velocity(&velocity, &model.holding_input(&velocity, &residual));
        for axis in 0..3 {
            assert!((next[axis] + residual[axis] - velocity[axis]).abs() < 1e-14);
        }
    }

    #[test]
    fn another_mass_has_another_fingerprint() {
        let mut heavier = Robot::example();
        heavier.body.mass_kg += 1e-9;
        let print = |robot: &Robot, layout| fingerprint(&MainModel::new(robot, 0.1), layout);
        assert_ne!(print(&Robot::example(), "velocity-slip"), print(&heavier, "velocity-slip"));
        assert_ne!(print(&Robot::example(), "velocity-slip"), print(&Robot::example(), "velocity-input"));
    }
}
