//! Constraint tightening: reduces the bounds on the state so that each holds with a given
//! probability, not only on average.
//!
//! ```text
//! aᵀx_k ≤ 1 − Φ⁻¹(level) √(aᵀ Σ_k a)
//! ```
//! Σ_k comes from [`model::covariance`], with the gain of the LQR for the controller's reaction to
//! a deviation. It belongs to the plan as predicted in this period, and has no gradient. The
//! variance of a single step is evaluated before the state arrives, after the last answer has been
//! sent.
//!
//! With a transport delay, the controller cannot react to errors of the periods under way. They are
//! added, and count as errors of the first step.

use model::Velocity;
use model::covariance::{Covariance, Feedback, deviation, propagate, quantile};
use model::linearise::Linearised;
use nalgebra::SVector;

/// Σ along the horizon. Does not allocate after set-up.
pub(super) struct Tightening {
    /// Φ⁻¹(level).
    deviations: f64,
    /// Variance of each step.
    noise: Vec<Velocity>,
    /// Σ_0 to Σ_N.
    covariance: Vec<Covariance>,
    /// Whole periods of the transport delay.
    under_way: usize,
    /// Σ of the errors in these periods.
    unanswered: Covariance,
}

impl Tightening {
    /// `None` if only the mean counts.
    pub(super) fn at(level: Option<f64>, horizon: usize) -> Option<Self> {
        let level = level.filter(|&level| level > 0.5)?;
        Some(Self {
            deviations: quantile(level),
            noise: vec![[0.0; 3]; horizon],
            covariance: vec![Covariance::zeros(); horizon + 1],
            under_way: 0,
            unanswered: Covariance::zeros(),
        })
    }

    /// Sets the number of periods under way.
    pub(super) fn wait_for(&mut self, under_way: usize) {
        self.under_way = under_way;
    }

    /// Sets the variance of step `k`. A variance that is not finite does not tighten.
    pub(super) fn set_noise(&mut self, k: usize, noise: Velocity) {
        if let Some(slot) = self.noise.get_mut(k) {
            *slot =
                noise.map(|variance| if variance.is_finite() { variance.max(0.0) } else { 0.0 });
        }
    }

    /// Computes the errors that can occur in the periods under way.
    pub(super) fn leave_unanswered(&mut self, step: &Linearised) {
        self.unanswered = Covariance::zeros();
        let noise = self.noise.first().copied().unwrap_or_default();
        for _ in 0..self.under_way {
            self.unanswered = propagate(&self.unanswered, step, &Feedback::zeros(), &noise);
        }
    }

    /// Σ_{k+1} from Σ_k.
    pub(super) fn propagate(&mut self, k: usize, step: &Linearised, feedback: &Feedback) {
        if let (Some([before, after]), Some(noise)) =
            (self.covariance.get_mut(k..k + 2), self.noise.get(k))
        {
            *after = propagate(before, step, feedback, noise);
        }
    }

    /// Tightening of a bound on aᵀx_k.
    pub(super) fn margin(&self, k: usize, direction: &SVector<f64, 6>) -> f64 {
        let margin = self.covariance.get(k).map_or(0.0, |covariance| {
            self.deviations * deviation(&(covariance + self.unanswered), direction)
        });
        if margin.is_finite() { margin } else { 0.0 }
    }
}

#[cfg(test)]
mod tests {
    use crate::mpc::tests::{circle, settings};
    use crate::mpc::{Mpc, MpcError};
    use crate::settings::StateLimits;
    use model::State;
    use model::main_model::MainModel;
    use model::predict::Belief;
    use robot::Robot;

    const WIDTH_M: f64 = 0.05;

    /// Distance of the plan to the left at the end of each period. It starts 4 cm to the left of
    /// the reference, in a corridor of 5 cm.
    fn lateral(level: Option<f64>, under_way: usize) -> Result<Vec<f64>, MpcError> {
        let limits = StateLimits {
            corridor_left_m: Some(WIDTH_M),
            corridor_right_m: Some(1.0),
            chance_level: level,
            ..StateLimits::default()
        };
        let main = MainModel::new(&Robot::example(), 0.1);
        let belief = Belief::of(&main);
        let mut mpc = Mpc::new(
            &crate::settings::MpcSettings { state_limits: limits, ..settings() },
            &Robot::example(),
            &main,
        )?;
        let reference = circle(0, 7);
        let state =
            State { pose: [0.0, 0.04, 0.0], velocity: [1.5, 0.0, 0.75], acted: [1.5, 0.0, 0.75] };
        mpc.begin_at(&state);
        mpc.prepare(&reference, &belief);
        mpc.expect_errors(under_way, |_| [4e-3, 4e-3, 0.0]);
        assert!(mpc.iterate(&state, &[1.5, 0.0, 0.75], &reference, &belief).outcome.usable());
        let states = mpc.stages().iter().skip(1).map(|stage| stage.state).chain([*mpc.terminal()]);
        Ok(states
            .zip(reference.iter().skip(1))
            .map(|(state, point)| point.lateral(&state.pose))
            .collect())
    }

    #[test]
    fn in_a_corridor_a_chance_level_keeps_the_plan_further_inside() -> Result<(), MpcError> {
        let (mean_alone, tightened) = (lateral(None, 0)?, lateral(Some(0.999), 0)?);
        for (tightened, mean_alone) in tightened.iter().zip(&mean_alone).skip(1) {
            assert!(
                tightened + 1e-3 < *mean_alone,
                "{tightened} is not further inside than {mean_alone}"
            );
        }
        Ok(())
    }

    #[test]
    fn at_level_one_half_no_bound_is_tightened() -> Result<(), MpcError> {
        assert_eq!(lateral(Some(0.5), 0)?, lateral(None, 0)?);
        Ok(())
    }

    #[test]
    fn periods_under_way_require_more_distance() -> Result<(), MpcError> {
        let (at_once, later) = (lateral(Some(0.99), 0)?, lateral(Some(0.99), 2)?);
        assert!(later[2] < at_once[2], "{later:?} {at_once:?}");
        Ok(())
    }
}
