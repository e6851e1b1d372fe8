//! The disturbance observer: per axis, what no model explains.
//!
//! ```text
//! innovation = v⁺ − (f(v, u) + g(v, u) + d)      d ← d + ℓ · innovation
//! ```
//! In the steady state d is the constant part of what is left, which makes the controller offset-free.

use crate::Velocity;

/// d. Does not allocate.
#[derive(Debug, Clone)]
pub struct Observer {
    gain: f64,
    /// Largest |d| that physics allows.
    bound: Velocity,
    disturbance: Velocity,
    innovation: Velocity,
}

impl Observer {
    /// An observer of gain ℓ: 0 never corrects, 1 believes the last period alone. |d| stays within `bound` \[m/s, m/s, rad/s\].
    pub fn new(gain: f64, bound: Velocity) -> Self {
        Self { gain, bound, disturbance: [0.0; 3], innovation: [0.0; 3] }
    }

    /// d \[m/s, m/s, rad/s\], per period.
    pub fn disturbance(&self) -> Velocity {
        self.disturbance
    }

    /// Last one-step error, before d was corrected \[m/s, m/s, rad/s\].
    pub fn innovation(&self) -> Velocity {
        self.innovation
    }

    /// Takes in one period: the part of the residual that the models leave \[m/s, m/s, rad/s\].
    pub fn update(&mut self, left: &Velocity) {
        for axis in 0..3 {
            self.innovation[axis] = left[axis] - self.disturbance[axis];
            let corrected = self.disturbance[axis] + self.gain * self.innovation[axis];
            self.disturbance[axis] = corrected.clamp(-self.bound[axis], self.bound[axis]);
        }
    }

    /// Forgets everything: the robot has been put somewhere else.
    pub fn reset(&mut self) {
        *self = Self::new(self.gain, self.bound);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_constant_disturbance_is_found() {
        let mut observer = Observer::new(0.5, [1.0; 3]);
        for _ in 0..60 {
            observer.update(&[0.1, -0.2, 0.3]);
        }
        for (found, truth) in observer.disturbance().iter().zip([0.1, -0.2, 0.3]) {
            assert!((found - truth).abs() < 1e-12);
        }
    }

    #[test]
    fn one_absurd_sample_moves_it_no_further_than_physics_allows() {
        let mut observer = Observer::new(0.5, [0.2; 3]);
        observer.update(&[1000.0, -1000.0, 0.0]);
        assert_eq!(observer.disturbance(), [0.2, -0.2, 0.0]);
    }
}
