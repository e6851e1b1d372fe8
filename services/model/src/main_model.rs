//! The main model f: the believed dynamics with the speed loop closed, discretised exactly (eqs. 21
//! and 23).
//!
//! With i = `k_p` (`u_m` − ω) the axes separate, each of first order:
//!
//! ```text
//! λ v̇ = κ u − (κ + f) v      v⁺ = A v + B u,   A = e^{−(κ+f)T/λ},   B = κ/(κ+f) (1 − A)
//! ```
//!
//! A robot file may state the response itself, with a time constant τ and a gain K per axis:
//! A = e^{−T/τ}, B = K (1 − A).

use crate::Velocity;
use crate::dynamics;
use crate::runge_kutta::RungeKutta;
use robot::Robot;

/// f for one robot and one period. Constant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MainModel {
    /// A per axis \[–\].
    pub decay: Velocity,
    /// B per axis \[–\].
    pub gain: Velocity,
    /// e per axis: weight of the end velocity in the mean velocity of a period \[–\].
    pub end_share: Velocity,
    /// T \[s\].
    pub period: f64,
    /// How the pose follows from the velocity.
    pub motion: Motion,
}

/// How the pose of a period follows from its velocity.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Motion {
    /// By the mean velocity at the mid-step heading, with the learned residual.
    MeanVelocity,
    /// By the main model alone.
    RungeKutta(RungeKutta),
}

impl MainModel {
    /// The main model of `robot` for a period of `period` \[s\].
    pub fn new(robot: &Robot, period: f64) -> Self {
        let (decay, gain) = if let (Some(body), Some(drive)) = (&robot.body, &robot.drive) {
            let stiffness = dynamics::speed_loop_stiffness(drive);
            let loss = stiffness + body.axle_friction_nms;
            let inertia = dynamics::axis_inertia(robot, body);
            let decay = inertia.map(|inertia| (-loss * period / inertia).exp());
            (decay, decay.map(|a| stiffness / loss * (1.0 - a)))
        } else {
            // A robot file without motors has a response.
            let response = robot.response.unwrap_or_default();
            let decay = response.time_constant_s.map(|constant| (-period / constant).exp());
            (decay, std::array::from_fn(|axis| response.gain[axis] * (1.0 - decay[axis])))
        };
        Self { decay, gain, end_share: decay.map(end_share), period, motion: Motion::MeanVelocity }
    }

    /// A base whose axes follow their inputs with a `time_constant` \[s\] each, discretised by
    /// Runge–Kutta. Nothing else is known of it.
    pub fn lagging(time_constant: &Velocity, period: f64) -> Self {
        let nodes = RungeKutta::new(time_constant, period);
        let gain = nodes.gain(time_constant);
        let decay = gain.map(|gain| 1.0 - gain);
        Self {
            decay,
            gain,
            end_share: decay.map(end_share),
            period,
            motion: Motion::RungeKutta(nodes),
        }
    }

    /// Mean velocity of a period that began with `velocity` and ended with `next`, v̄ = (1 − e) v +
    /// e v⁺ \[m/s, m/s, rad/s\].
    pub fn mean_velocity(&self, velocity: &Velocity, next: &Velocity) -> Velocity {
        std::array::from_fn(|axis| {
            velocity[axis] + self.end_share[axis] * (next[axis] - velocity[axis])
        })
    }

    /// Velocity one period after `velocity` under `input` \[m/s, m/s, rad/s\].
    pub fn next_velocity(&self, velocity: &Velocity, input: &Velocity) -> Velocity {
        std::array::from_fn(|axis| {
            self.decay[axis] * velocity[axis] + self.gain[axis] * input[axis]
        })
    }

    /// Input that holds `velocity` against a constant residual \[m/s, m/s, rad/s\]: v = A v + B u +
    /// g.
    pub fn holding_input(&self, velocity: &Velocity, residual: &Velocity) -> Velocity {
        std::array::from_fn(|axis| {
            ((1.0 - self.decay[axis]) * velocity[axis] - residual[axis]) / self.gain[axis]
        })
    }
}

/// e of an axis that decays by A in a period. The velocity in between is an exponential, and most
/// of its change comes early:
///
/// ```text
/// v̄ = φ v + (1 − φ) v_∞,   φ = (1 − A)/(−ln A),   v⁺ = A v + (1 − A) v_∞
/// ⇒   e = (1 − φ)/(1 − A)
/// ```
/// ½ for a slow axis, 1 for one that responds at once.
fn end_share(decay: f64) -> f64 {
    let rate = -decay.ln();
    if rate < 1e-4 { 0.5 } else { (1.0 - (1.0 - decay) / rate) / (1.0 - decay) }
}

/// Identifies one main model and one layout of the learner's inputs. A learned model with another
/// fingerprint is wrong, and rejected.
///
/// FNV-1a over the numbers' bits and the layout's name.
pub fn fingerprint(model: &MainModel, layout: &str) -> u64 {
    let numbers = model.decay.iter().chain(&model.gain).chain(std::iter::once(&model.period));
    let bytes = numbers.flat_map(|value| value.to_bits().to_le_bytes()).chain(layout.bytes());
    bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_discretisation_is_exact_two_halves_make_a_whole() {
        let (whole, half) =
            (MainModel::new(&Robot::example(), 0.1), MainModel::new(&Robot::example(), 0.05));
        let (velocity, input) = ([1.0, -2.0, 0.5], [2.0, 1.0, -1.0]);
        let twice = half.next_velocity(&half.next_velocity(&velocity, &input), &input);
        for (a, b) in twice.iter().zip(whole.next_velocity(&velocity, &input)) {
            assert!((a - b).abs() < 1e-14);
        }
    }

    #[test]
    fn the_mean_velocity_is_that_of_the_exponential_in_between() {
        let whole = MainModel::new(&Robot::example(), 0.1);
        let slices = 10_000_u32;
        let slice = MainModel::new(&Robot::example(), 0.1 / f64::from(slices));
        let (start, input) = ([1.0, -2.0, 0.5], [2.0, 1.0, -1.0]);
        let (mut velocity, mut sum) = (start, [0.0; 3]);
        for _ in 0..slices {
            let next = slice.next_velocity(&velocity, &input);
            sum = std::array::from_fn(|axis| {
                sum[axis] + 0.5 * (velocity[axis] + next[axis]) / f64::from(slices)
            });
            velocity = next;
        }
        let mean = whole.mean_velocity(&start, &whole.next_velocity(&start, &input));
        for axis in 0..3 {
            assert!((mean[axis] - sum[axis]).abs() < 1e-7, "{} is not {}", mean[axis], sum[axis]);
        }
        assert!((end_share(1.0 - 1e-9) - 0.5).abs() < 1e-6);
    }

    #[test]
    fn the_holding_input_keeps_the_velocity_constant() {
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
        heavier.body =
            heavier.body.map(|body| robot::Body { mass_kg: body.mass_kg + 1e-9, ..body });
        let print = |robot: &Robot, layout| fingerprint(&MainModel::new(robot, 0.1), layout);
        assert_ne!(print(&Robot::example(), "velocity-slip"), print(&heavier, "velocity-slip"));
        assert_ne!(
            print(&Robot::example(), "velocity-slip"),
            print(&Robot::example(), "velocity-input")
        );
    }
}
