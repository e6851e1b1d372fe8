//! One step of the classical Runge–Kutta method of order four.
//!
//! Reference: Hairer, Nørsett, Wanner, *Solving Ordinary Differential Equations I*, 1993, II.1.

use core::ops::{Add, Mul};

/// The state of ẋ = `rate`(x) one step later.
///
/// x⁺ = x + h/6 (k₁ + 2 k₂ + 2 k₃ + k₄). Four calls of `rate`; does not allocate.
pub(super) fn runge_kutta<X: Copy + Add<Output = X> + Mul<f64, Output = X>>(
    state: X,
    step_s: f64,
    rate: impl Fn(&X) -> X,
) -> X {
    let half_s = 0.5 * step_s;
    let k1 = rate(&state);
    let k2 = rate(&(state + k1 * half_s));
    let k3 = rate(&(state + k2 * half_s));
    let k4 = rate(&(state + k3 * step_s));
    state + (k1 + (k2 + k3) * 2.0 + k4) * (step_s / 6.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector2;

    fn error_after_one_second(steps: u32) -> f64 {
        let step_s = 1.0 / f64::from(steps);
        let mut state = Vector2::new(1.0, 0.0);
        for _ in 0..steps {
            state = runge_kutta(state, step_s, |x| Vector2::new(x.y, -x.x));
        }
        (state - Vector2::new(1_f64.cos(), -1_f64.sin())).norm()
    }

    #[test]
    fn half_the_step_gives_a_sixteenth_of_the_error() {
        let ratio = error_after_one_second(50) / error_after_one_second(100);
        assert!((15.0..17.0).contains(&ratio), "{ratio}");
    }
}
